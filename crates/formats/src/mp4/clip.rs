//! A clip whose tracks come along: its media are copied as they are, and its tables say where they are now.

use super::boxes::{Box4, Boxes, Out, u32_at, u64_at};
use super::{Mp4Error, malformed};

/// An MP4 file, as far as it is kept.
pub struct Clip<'a> {
    moov: &'a [u8],
    /// Media boxes, header included, and where they begin in the file.
    media: Vec<Box4<'a>>,
    /// Ticks a second of the movie.
    pub timescale: u32,
    /// Number of a track that it does not have.
    pub next_track: u32,
}

impl<'a> Clip<'a> {
    /// Reads the boxes of a file.
    ///
    /// # Errors
    /// What is missing, damaged or in fragments.
    pub fn parse(file: &'a [u8]) -> Result<Self, Mp4Error> {
        if !super::is_mp4(file) {
            return Err(malformed("the clip is no MP4 file"));
        }
        // Readers take the first stream of a file.
        if super::stream_in(file)?.is_some() {
            return Err(Mp4Error::Unsupported { what: "a clip that has a stream already is" });
        }
        let (mut moov, mut media) = (None, Vec::new());
        for found in Boxes::new(file) {
            let found = found?;
            match &found.kind {
                // Readers take the first.
                b"moov" => moov = moov.or(Some(found.content)),
                b"moof" => return Err(Mp4Error::Unsupported { what: "a clip in fragments is" }),
                b"mdat" => media.push(found),
                _ => {}
            }
        }
        let moov = moov.ok_or_else(|| malformed("the clip has no moov box"))?;
        let mvhd =
            Boxes::new(moov).find(b"mvhd")?.ok_or_else(|| malformed("the clip has no mvhd box"))?.content;
        let wide = mvhd.first() == Some(&1);
        let whole = mvhd.len() >= if wide { 112 } else { 100 };
        let timescale = u32_at(mvhd, if wide { 20 } else { 12 }).filter(|&scale| whole && scale > 0);
        let timescale = timescale.ok_or_else(|| malformed("the clip's mvhd box is cut"))?;
        let mut next_track = 1;
        for track in Boxes::new(moov) {
            let track = track?;
            if &track.kind == b"trak"
                && let Some(header) = Boxes::new(track.content).find(b"tkhd")?
            {
                let at = if header.content.first() == Some(&1) { 20 } else { 12 };
                next_track = next_track.max(u32_at(header.content, at).unwrap_or(0).saturating_add(1));
            }
        }
        Ok(Self { moov, media, timescale, next_track })
    }

    /// Bytes of all media boxes.
    pub fn media_length(&self) -> u64 {
        self.media.iter().map(|media| media.whole.len() as u64).sum()
    }

    /// Writes the media boxes.
    pub fn media(&self, out: &mut Out) {
        for media in &self.media {
            // The last one may say that it goes on to the end of the file.
            let told =
                u32_at(media.whole, 0).filter(|&length| length > 0).unwrap_or(media.whole.len() as u32);
            out.u32(told);
            out.bytes(media.whole.get(4..).unwrap_or_default());
        }
    }

    /// Writes the movie with one more track, where the media boxes begin at byte `at`; `duration` of that track in
    /// ticks of the movie.
    ///
    /// # Errors
    /// Tables that are cut, chunks outside of the media, offsets that do not fit their tables.
    pub fn moov(&self, out: &mut Out, at: u64, duration: u64, track: &[u8]) -> Result<(), Mp4Error> {
        let mut content = Out::default();
        let mut result = Ok(());
        for found in Boxes::new(self.moov) {
            let found = found?;
            match &found.kind {
                b"mvhd" => content.bytes(&self.mvhd(found.whole, duration)),
                _ => result = result.and(self.moved(found, at, &mut content)),
            }
        }
        result?;
        content.bytes(track);
        let content = content.into_bytes();
        out.of(b"moov", |out| out.bytes(&content));
        Ok(())
    }

    /// The movie's header with a duration that the new track fits in, and the number of a further track.
    fn mvhd(&self, whole: &[u8], duration: u64) -> Vec<u8> {
        let mut bytes = whole.to_vec();
        let wide = bytes.get(8) == Some(&1);
        if wide {
            let longest = u64_at(&bytes, 32).unwrap_or(0).max(duration);
            bytes.get_mut(32..40).into_iter().for_each(|slot| slot.copy_from_slice(&longest.to_be_bytes()));
        } else {
            let longest = u64::from(u32_at(&bytes, 24).unwrap_or(0)).max(duration).min(u32::MAX.into());
            let longest = (longest as u32).to_be_bytes();
            bytes.get_mut(24..28).into_iter().for_each(|slot| slot.copy_from_slice(&longest));
        }
        let length = (bytes.len() as u32).to_be_bytes();
        if bytes.starts_with(&[0; 4]) {
            bytes.get_mut(..4).into_iter().for_each(|slot| slot.copy_from_slice(&length));
        }
        let (end, next) = (bytes.len(), self.next_track.saturating_add(1).to_be_bytes());
        bytes.get_mut(end - 4..).into_iter().for_each(|slot| slot.copy_from_slice(&next));
        bytes
    }

    /// Copies a box, with the places of chunks as they are now.
    fn moved(&self, found: Box4<'_>, at: u64, out: &mut Out) -> Result<(), Mp4Error> {
        match &found.kind {
            b"trak" | b"mdia" | b"minf" | b"stbl" => {
                let mut content = Out::default();
                for inner in Boxes::new(found.content) {
                    self.moved(inner?, at, &mut content)?;
                }
                let content = content.into_bytes();
                out.of(&found.kind, |out| out.bytes(&content));
            }
            b"stco" | b"co64" => {
                let wide = &found.kind == b"co64";
                let cut = || malformed("a table of chunks of the clip is cut");
                let count = u32_at(found.content, 4).ok_or_else(cut)?;
                let mut places = Out::default();
                for chunk in 0..count as usize {
                    let old = match wide {
                        true => u64_at(found.content, 8 + chunk * 8),
                        false => u32_at(found.content, 8 + chunk * 4).map(u64::from),
                    };
                    let new = self.place(old.ok_or_else(cut)?, at)?;
                    match wide {
                        true => places.u64(new),
                        false => places.u32(u32::try_from(new).map_err(|_| Mp4Error::Unsupported {
                            what: "a clip of more than 4 GiB with a table of 32 bits is",
                        })?),
                    }
                }
                let places = places.into_bytes();
                out.full(&found.kind, 0, |out| {
                    out.u32(count);
                    out.bytes(&places);
                });
            }
            // One that goes on to the end of what holds it is followed by others now.
            _ if u32_at(found.whole, 0) == Some(0) => out.of(&found.kind, |out| out.bytes(found.content)),
            _ => out.bytes(found.whole),
        }
        Ok(())
    }

    /// Where byte `old` of the clip's file is, when its media boxes begin at `at`.
    fn place(&self, old: u64, at: u64) -> Result<u64, Mp4Error> {
        let mut before = at;
        for media in &self.media {
            let (from, length) = (media.at as u64, media.whole.len() as u64);
            if (from..=from + length).contains(&old) {
                return Ok(before + old - from);
            }
            before += length;
        }
        Err(malformed(format!("a chunk of the clip at byte {old} lies outside of its media")))
    }
}
