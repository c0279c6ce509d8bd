//! The table of motion formats: what they are called, how they are told apart, and who reads and writes them.
//!
//! Each format is one module with its reader, its writer and its row; [`FORMATS`] lists the rows.
//!
//! ```
//! use handcast_hand::{HandPose, PoseClip, PoseHeader, Side, TimedPose};
//! use handcast_formats::motion::{Format, Motion, WriteOptions};
//!
//! let poses = [0.0, 0.1].map(|time| TimedPose::new(time, HandPose::neutral(Side::Left)));
//! let clip = PoseClip { header: PoseHeader::one(Side::Left, None, None), frames: poses.to_vec() };
//! for format in Format::written() {
//!     let file = format.write(&clip, &WriteOptions::default())?;
//!     assert_eq!(Format::sniffed(&file.bytes), Some(format), "{}", format.name);
//!     assert_eq!(Motion::parse("-".as_ref(), &file.bytes)?.clip.frames.len(), 2);
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::io;
use std::path::Path;

use super::{ContentError, Motion, WriteError, WriteOptions, Written, bap, bvh, csv, glb, json, stream};
use crate::landmarks::{mediapipe, points, pose_format, still, webxr};
use crate::poses;
use handcast_hand::PoseClip;
use handcast_limits::Limits;

/// Reads a whole file.
type Read = fn(&[u8], &Limits) -> Result<Motion, ContentError>;
/// Writes a whole file; gives what is worth saying of it.
type Write = fn(&PoseClip, &WriteOptions, &mut dyn io::Write) -> Result<Vec<String>, WriteError>;

/// A format of motions.
#[derive(Debug)]
#[non_exhaustive]
pub struct Format {
    /// Short name, by which it is asked for.
    pub id: &'static str,
    /// In words.
    pub name: &'static str,
    /// What reports call it; formats of the same content share it.
    pub kind: &'static str,
    /// Ending of a file's name, with its dot.
    pub ending: &'static str,
    /// Most hands in a file: 1 or 2.
    pub hands: usize,
    /// Whether this is the start of such a file, whatever its name.
    pub(crate) sniff: fn(&[u8]) -> bool,
    pub(crate) read: Read,
    /// `None` for formats that are read only.
    pub(crate) write: Option<Write>,
}

/// All of them; those that are written come first.
pub static FORMATS: [&Format; 12] = [
    &glb::FORMAT,
    &poses::FORMAT,
    &json::FORMAT,
    &csv::FORMAT,
    &bvh::FORMAT,
    &webxr::FORMAT,
    &points::FORMAT,
    &pose_format::FORMAT,
    &bap::FORMAT,
    &stream::FORMAT,
    &mediapipe::FORMAT,
    &still::FORMAT,
];

impl PartialEq for Format {
    fn eq(&self, other: &Self) -> bool {
        self.id == other.id
    }
}

impl Eq for Format {}

/// How far into a file a format is looked for, bytes.
const HEAD: usize = 400;

/// The first bytes of a text, without blanks before them.
pub(crate) fn head(bytes: &[u8]) -> &[u8] {
    let start = bytes.trim_ascii_start();
    &start[..start.len().min(HEAD)]
}

/// Whether a word is in a text.
pub(crate) fn says(text: &[u8], word: &str) -> bool {
    text.windows(word.len()).any(|w| w == word.as_bytes())
}

impl Format {
    /// Those that are written.
    pub fn written() -> impl Iterator<Item = &'static Self> {
        FORMATS.into_iter().filter(|format| format.write.is_some())
    }

    /// The format of this short name.
    pub fn by_id(id: &str) -> Option<&'static Self> {
        FORMATS.into_iter().find(|format| format.id == id)
    }

    /// The format that a file of this name has: that of the longest ending that fits, in any case.
    pub fn by_name(path: &Path) -> Option<&'static Self> {
        let name = path.file_name()?.to_str()?.to_ascii_lowercase();
        let fits = |format: &&Self| name.ends_with(format.ending);
        // The first of equals.
        FORMATS.into_iter().rev().filter(fits).max_by_key(|format| format.ending.len())
    }

    /// The format that this content is of, as far as its start tells.
    pub fn sniffed(bytes: &[u8]) -> Option<&'static Self> {
        FORMATS.into_iter().find(|format| (format.sniff)(bytes))
    }

    /// The format of a file: what its content tells, or else its name.
    pub fn of(path: &Path, bytes: &[u8]) -> Option<&'static Self> {
        Self::sniffed(bytes).or_else(|| Self::by_name(path))
    }

    /// The bytes of a file with the poses of a clip.
    ///
    /// # Errors
    /// See [`WriteError`]; [`WriteError::ReadOnly`] where this program does not write the format.
    pub fn write(&self, clip: &PoseClip, options: &WriteOptions) -> Result<Written, WriteError> {
        let mut bytes = Vec::new();
        let notes = self.write_to(clip, options, &mut bytes)?;
        Ok(Written { bytes, notes })
    }

    /// As [`Format::write`], into `out`, frame by frame where the format allows (all but glTF). Gives what is worth
    /// saying of the file ([`Written::notes`]). What was written before an error stays in `out`.
    ///
    /// # Errors
    /// Those of [`Format::write`], and [`WriteError::Io`].
    pub fn write_to(
        &self,
        clip: &PoseClip,
        options: &WriteOptions,
        out: &mut dyn io::Write,
    ) -> Result<Vec<String>, WriteError> {
        let write = self.write.ok_or(WriteError::ReadOnly { format: self.name })?;
        write(clip, options, out)
    }

    /// The endings of names of files that are read, for messages.
    pub fn endings() -> String {
        let mut endings: Vec<&str> = FORMATS.iter().map(|format| format.ending).collect();
        endings.dedup();
        endings.join(", ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_told_apart() {
        for (i, format) in FORMATS.into_iter().enumerate() {
            assert_eq!(Format::by_id(format.id), Some(format));
            assert!(FORMATS[..i].iter().all(|other| other.id != format.id), "{}", format.id);
            assert!(format.ending.starts_with('.') && (1..=2).contains(&format.hands));
        }
        let named = |name: &str| Format::by_name(Path::new(name)).map(|format| format.id);
        for (name, id) in [
            ("a.FBA", "fba"),
            ("a.bap", "bap"),
            ("a.json", "json"),
            ("a.webxr.json", "webxr"),
            ("a.jsonl", "jsonl"),
            ("b/a.Landmarks.jsonl", "landmarks"),
            ("a.pose", "pose"),
        ] {
            assert_eq!(named(name), Some(id), "{name}");
        }
        assert_eq!(named("a.mp4"), None);
        assert_eq!(named("fba"), None);
    }

    #[test]
    fn content_comes_before_the_name() {
        let told = |name: &str, text: &str| Format::of(Path::new(name), text.as_bytes()).map(|f| f.id);
        let lines = "{\"format\":\"handcast-poses\",\"version\":1}\n{}\n";
        for (text, id) in [
            (lines, "jsonl"),
            ("{\n \"format\": \"handcast-poses\",\n \"frames\": []}", "json"),
            ("{\"format\":\"handcast-poses\",\"frames\":[]}", "json"),
            (" {\"format\":\"landmarks21\"}", "landmarks"),
            ("{\"format\":\"webxr-hands\"}", "webxr"),
            ("[{}]", "webxr-poses"),
            ("{\"handedness\":[],\n \"landmarks\": []}", "mediapipe"),
            ("[{\"worldLandmarks\":[[", "mediapipe"),
            ("{\"fps\":30}\n{\"multiHandLandmarks\":null}", "mediapipe"),
            ("[[{\"keypoints\":[{", "mediapipe"),
            ("\u{feff}time,hand,x,y,z,qx,qy,qz,qw\n", "csv"),
            ("HIERARCHY\nROOT a", "bvh"),
            ("# a note\n3.2 wave 25 1\n0 1\n0 5\n", "bap"),
            ("glTF", "glb"),
            ("\0\0\u{1}", "fba"),
        ] {
            for name in ["-", "a.csv", "a.xyz", "a.fba"] {
                assert_eq!(told(name, text), Some(id), "{text:?}");
            }
        }
        assert_eq!(told("a.csv", "these are words\n"), Some("csv"));
        assert_eq!(told("a.bap", ""), Some("bap"));
        assert_eq!(told("-", "these are four words\n"), None);
    }
}
