//! BAP text ([`handcast_fba::bap::text`]): a header and, for each frame, a line of masks and a line of values.
//!
//! ```text
//! 3.2 poses 25 2
//! 0 0 … 1 …
//! 0 1200 -350 …
//! 0 0 … 1 …
//! 1 1300 -350 …
//! ```
//!
//! Header: version, name, frames per second, number of frames. Joint angles are in 1e-5 rad.

use std::io::Write;

use super::format::head;
use super::{BapTrack, ContentError, Format, Keeps, Lost, Motion, Times, WriteError, WriteOptions, Writer};
use handcast_codec::mapping::Profile;
use handcast_codec::{bap_frames, on_ticks};
use handcast_fba::bap::text;
use handcast_hand::PoseClip;
use handcast_hand::clip::MAX_RATE;
use handcast_limits::Limits;

/// Its row.
pub(crate) static FORMAT: Format = Format {
    id: "bap",
    name: "BAP text",
    kind: "bap_text",
    ending: ".bap",
    hands: 2,
    sniff,
    read: |bytes, limits| Ok(read(bytes, limits)?.into()),
    write: Some(Writer {
        keeps: Keeps { times: Times::Skipping, sizes: false, ..Keeps::all(Lost::Bridged) },
        write,
    }),
};

/// A header of four words, all but the name numbers.
fn sniff(bytes: &[u8]) -> bool {
    let head = String::from_utf8_lossy(head(bytes));
    let header = head.lines().map(str::trim).find(|line| !line.is_empty() && !line.starts_with('#'));
    let words: Vec<&str> = header.unwrap_or_default().split_whitespace().collect();
    let [version, _name, rate, count] = words[..] else { return false };
    [version, rate].iter().all(|word| word.parse::<f64>().is_ok()) && count.parse::<u64>().is_ok()
}

fn read(bytes: &[u8], limits: &Limits) -> Result<Motion, ContentError> {
    let words = text::text_of(bytes);
    let told = text::Reader::new(&words)?.told();
    let track = BapTrack::from_text(&words)?;
    if track.rate > MAX_RATE {
        return Err(ContentError::Rate { rate: track.rate });
    }
    let found = track.frames.len();
    let mut motion = Motion::from_baps(&FORMAT, track, limits)?;
    if told != Some(found as u64) {
        let told = told.map_or("no number of frames".to_owned(), |told| format!("{told} frames"));
        motion.notes.push(format!("its header tells {told}, {found} follow"));
    }
    Ok(motion)
}

/// The valid poses on even ticks, in profile `hand`.
fn write(clip: &PoseClip, options: &WriteOptions, out: &mut dyn Write) -> Result<Vec<String>, WriteError> {
    let rate = options.rate_of(clip)?;
    let frames = bap_frames(&on_ticks(clip, rate, 0.0), Profile::Hand)?.into_iter().collect();
    BapTrack { rate, frames }.write_text(&options.title, out)?;
    Ok(Vec::new())
}
