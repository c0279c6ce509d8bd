//! A clip whose tracks come along: its media are copied as they are, and its tables say where they are now.

use handcast_iso::{
    MediaBox, all, behind_dates, child, children, needed, outermost, rows, u32_at, u64_at, unsigned,
};

use super::boxes::{self, Out};
use super::{Mp4Error, malformed};

/// An MP4 file, as far as it is kept.
pub struct Clip<'a> {
    moov: &'a [u8],
    /// Media boxes, header included, and where they begin in the file.
    media: Vec<MediaBox<'a>>,
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
        for found in outermost(file) {
            let found = found?;
            match &found.kind {
                // Readers take the first.
                b"moov" => moov = moov.or(Some(found.content)),
                b"moof" => {
                    return Err(Mp4Error::Unsupported {
                        what: "a clip in fragments (`ffmpeg -i CLIP -c copy WHOLE.mp4` joins them) is",
                    });
                }
                b"mdat" => media.push(found),
                _ => {}
            }
        }
        let moov = moov.ok_or_else(|| malformed("the clip has no moov box"))?;
        let mvhd = needed(moov, b"mvhd")?;
        let whole = mvhd.len() >= if mvhd.first() == Some(&1) { 112 } else { 100 };
        let timescale = behind_dates(mvhd).ok().filter(|&scale| whole && scale > 0);
        let timescale = timescale.ok_or_else(|| malformed("the clip's mvhd box is cut"))?;
        let mut next_track = 1;
        for track in all(moov, b"trak") {
            if let Some(header) = child(track?, b"tkhd")? {
                next_track = next_track.max(behind_dates(header).unwrap_or(0).saturating_add(1));
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
        for found in children(self.moov) {
            let found = found?;
            match &found.kind {
                b"mvhd" => content.of(b"mvhd", |out| out.bytes(&self.mvhd(found.content, duration))),
                _ => result = result.and(self.moved(found, at, &mut content)),
            }
        }
        result?;
        content.bytes(track);
        let content = content.into_bytes();
        out.of(b"moov", |out| out.bytes(&content));
        Ok(())
    }

    /// The movie's header with a duration that the new track fits in, and the number of a further track. Where the duration needs
    /// it, its times become long (8.2.2).
    fn mvhd(&self, content: &[u8], duration: u64) -> Vec<u8> {
        let was_long = content.first() == Some(&1);
        let long = was_long || boxes::is_long(duration);
        let size = if was_long { 8 } else { 4 };
        let time = |at: usize| {
            let time = if was_long { u64_at(content, at) } else { u32_at(content, at).map(u64::from) };
            time.unwrap_or(0)
        };
        let mut out = Out::default();
        out.u32(u32_at(content, 0).unwrap_or(0) | boxes::version_of(long));
        let longest = time(8 + 2 * size).max(duration);
        boxes::times(&mut out, [time(4), time(4 + size)], self.timescale, longest, long);
        out.bytes(content.get(8 + 3 * size..).unwrap_or_default());
        let mut bytes = out.into_bytes();
        let next = self.next_track.saturating_add(1).to_be_bytes();
        bytes.last_chunk_mut().into_iter().for_each(|slot| *slot = next);
        bytes
    }

    /// Copies a box, with the places of chunks as they are now.
    fn moved(&self, found: MediaBox<'_>, at: u64, out: &mut Out) -> Result<(), Mp4Error> {
        match &found.kind {
            b"trak" | b"mdia" | b"minf" | b"stbl" => {
                let mut content = Out::default();
                for inner in children(found.content) {
                    self.moved(inner?, at, &mut content)?;
                }
                let content = content.into_bytes();
                out.of(&found.kind, |out| out.bytes(&content));
            }
            b"stco" | b"co64" => {
                let (name, width) = if &found.kind == b"co64" { ("co64", 8) } else { ("stco", 4) };
                let chunks = rows(found.content, name, width)?;
                let (count, mut places) = (chunks.len() as u32, Out::default());
                for chunk in chunks {
                    let new = self.place(unsigned(chunk), at)?;
                    match width {
                        8 => places.u64(new),
                        _ => places.u32(u32::try_from(new).map_err(|_| Mp4Error::Unsupported {
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
