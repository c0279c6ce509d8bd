//! The table of motion formats: what they are called, how they are told apart, and who reads and writes them.
//!
//! Each format is one module with its reader, its writer and its row; [`FORMATS`] lists the rows.
//!
//! ```
//! use handcast_hand::{Finger, HandPose, PoseClip, PoseHeader, Side, TimedPose};
//! use handcast_formats::motion::{Format, Motion, WriteOptions};
//!
//! let mut bent = HandPose::neutral(Side::Left);
//! bent.set(Finger::Index.base_flexion(), 0.2);
//! let poses = [0.0, 0.1].map(|time| TimedPose::new(time, bent.clone()));
//! let clip = PoseClip { header: PoseHeader::one(Side::Left, None, None), frames: poses.to_vec() };
//! for format in Format::written() {
//!     let file = format.write(&clip, &WriteOptions::default())?;
//!     assert_eq!(Format::sniffed(&file.bytes), Some(format), "{}", format.name);
//!     assert_eq!(Motion::parse("-".as_ref(), &file.bytes)?.clip.frames.len(), 2);
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::fmt;
use std::io;
use std::path::Path;

use super::{
    Content, ContentError, Keeps, WriteError, WriteOptions, Written, bap, bvh, check_poses, csv, glb, json,
    stream, vrma,
};
use crate::landmarks::{iwer, leap, mano, mediapipe, points, pose_format, still, webxr, xr};
use crate::lines::unmarked;
use crate::poses;
use handcast_hand::PoseClip;
use handcast_limits::{Limits, quoted};

/// Reads a whole file.
type Read = fn(&[u8], &Limits) -> Result<Content, ContentError>;
/// Writes a whole file; gives what is worth saying of it.
type Write = fn(&PoseClip, &WriteOptions, &mut dyn io::Write) -> Result<Vec<String>, WriteError>;

/// How a format is written.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Writer {
    pub keeps: Keeps,
    pub write: Write,
}

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
    pub(crate) write: Option<Writer>,
}

/// All of them; those that are written come first.
pub static FORMATS: [&Format; 20] = [
    &glb::FORMAT,
    &poses::FORMAT,
    &json::FORMAT,
    &csv::FORMAT,
    &bvh::FORMAT,
    &vrma::FORMAT,
    &glb::DOCUMENT,
    &webxr::FORMAT,
    &points::FORMAT,
    &pose_format::FORMAT,
    &bap::FORMAT,
    &stream::FORMAT,
    &mano::NPZ,
    &mano::NPY,
    &mano::FORMAT,
    &leap::FORMAT,
    &iwer::FORMAT,
    &mediapipe::FORMAT,
    &still::FORMAT,
    &xr::FORMAT,
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

/// How far into a file of JSON names are looked for, bytes.
const JSON_HEAD: usize = 4096;

/// The start of a file of JSON that may name its format late; empty where it is no JSON.
pub(crate) fn json_head(bytes: &[u8]) -> &[u8] {
    let start = bytes.trim_ascii_start();
    let json = matches!(start.first(), Some(b'{' | b'['));
    if json { &start[..start.len().min(JSON_HEAD)] } else { &[] }
}

/// Whether this is the start of an object or a list of JSON.
pub(crate) fn is_json(bytes: &[u8]) -> bool {
    !json_head(bytes).is_empty()
}

/// Whether one of these names has a value in the start of a file of JSON.
pub(crate) fn names_any(bytes: &[u8], names: &[&str]) -> bool {
    let start = json_head(bytes);
    let named = |name: &str| {
        let quoted = format!("\"{name}\"");
        let windows = start.windows(quoted.len()).enumerate();
        windows
            .filter(|(_, w)| *w == quoted.as_bytes())
            .any(|(at, w)| start[at + w.len()..].trim_ascii_start().first() == Some(&b':'))
    };
    names.iter().any(|name| named(name))
}

/// Content that is none of the formats: what it is, as far as that is known.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NotKnown(What);

#[derive(Clone, Debug, PartialEq, Eq)]
enum What {
    /// JSON: what names it has, and what was tried.
    Json { found: String, tried: String },
    /// A kind of [`OTHERS`].
    Other(&'static str),
}

impl fmt::Display for NotKnown {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match &self.0 {
            What::Json { found, tried } => {
                write!(f, "JSON {found} is none of the formats that are read; tried were {tried}")
            }
            What::Other(what) => f.write_str(what),
        }
    }
}

/// Most names that are told.
const TOLD: usize = 6;

/// Files that are none of the formats: bytes from a place on, what they tell, and the way out. The first that fits counts.
const OTHERS: [(usize, &[u8], &str); 34] = [
    (0, b"\x1f\x8b", "gzip: unpack it first"),
    (0, b"BZh", "bzip2: unpack it first"),
    (0, b"\xfd7zXZ", "xz: unpack it first"),
    (0, b"(\xb5/\xfd", "zstd: unpack it first"),
    (0, b"7z\xbc\xaf", "7z: unpack it first"),
    // The first entry of a spreadsheet is one of these.
    (30, b"[Content_Types]", SPREADSHEET),
    (30, b"docProps/", SPREADSHEET),
    (30, b"xl/", SPREADSHEET),
    (30, b"mimetypeapplication/vnd.oasis", SPREADSHEET),
    (0, b"PK\x03\x04", "zip: unpack it first"),
    (0, b"\x80\x02", PICKLE),
    (0, b"\x80\x03", PICKLE),
    (0, b"\x80\x04\x95", PICKLE),
    (0, b"\x80\x05\x95", PICKLE),
    (0, b"\x89HDF\r\n", "HDF5 (.h5, .mat of MATLAB 7.3): put its arrays into an .npz with np.savez"),
    (0, b"MATLAB 5.0", "MATLAB (.mat): put its arrays into an .npz with np.savez"),
    (0, b"PAR1", "Parquet: save the table as CSV"),
    (0, b"\x02\x50", "C3D: write its joints as landmark lines, which spec/landmarks.md describes"),
    (0, b"PathFileType", "TRC: write its joints as landmark lines, which spec/landmarks.md describes"),
    (0, b"Kaydara FBX", FBX),
    (0, b"; FBX", FBX),
    (0, b"BLENDER", "Blender: export it as .glb or .bvh"),
    (0, b"PXR-USDC", USD),
    (0, b"#usda", USD),
    (0, b"<", "XML or HTML (.eaf …): no kind of it is read"),
    (0, b"\xff\xfe", WIDE),
    (0, b"\xfe\xff", WIDE),
    (4, b"ftyp", "an MP4 file without a stream of FBA; of a clip `handcast track` makes poses"),
    (0, b"\x89PNG", PICTURES),
    (0, b"\xff\xd8\xff", PICTURES),
    (0, b"GIF8", PICTURES),
    (0, b"RIFF", PICTURES),
    (0, b"\x1a\x45\xdf\xa3", PICTURES),
    (0, b"YUV4MPEG2", PICTURES),
];
const SPREADSHEET: &str = "a spreadsheet: save it as CSV";
const PICKLE: &str = "a pickle of Python: write arrays with np.savez, and what else there is with json.dump";
const FBX: &str = "FBX: export it as .glb or .bvh";
const USD: &str = "USD: export it as .glb or .bvh";
const WIDE: &str = "UTF-16 text: save it as UTF-8 (tables of poses alone are read as they are)";
const PICTURES: &str = "pictures or a video: `handcast track` makes poses of them";

/// What [`OTHERS`] say of content.
fn other(bytes: &[u8]) -> Option<NotKnown> {
    let fits =
        |(at, magic, _): &&(usize, &[u8], _)| bytes.get(*at..).is_some_and(|rest| rest.starts_with(magic));
    OTHERS.iter().find(fits).map(|(_, _, what)| NotKnown(What::Other(what)))
}

impl NotKnown {
    /// What content is that no format knows; `None` where one does, and where nothing is known of it.
    pub(crate) fn of(bytes: &[u8]) -> Option<Self> {
        // Damaged poses are told as such.
        let ours = says(head(bytes), poses::NAME);
        if ours || Format::sniffed(bytes).is_some() { None } else { Self::among(bytes, |_| true) }
    }

    /// What content is that no format of joint positions knows.
    pub(crate) fn joints(bytes: &[u8]) -> Option<Self> {
        Self::among(bytes, |format| format.kind == "landmarks")
    }

    fn among(bytes: &[u8], which: impl Fn(&Format) -> bool) -> Option<Self> {
        if !is_json(bytes) {
            return other(bytes);
        }
        let json = |format: &&&Format| format.ending.contains(".json") && which(format);
        let mut tried: Vec<&str> = Vec::new();
        for format in FORMATS.iter().filter(json) {
            if !tried.contains(&format.name) {
                tried.push(format.name);
            }
        }
        let names: Vec<String> = first_names(json_head(bytes)).iter().map(|name| quoted(name)).collect();
        let found = match names.as_slice() {
            [] => "with no names in it,".to_owned(),
            [one] => format!("with the name {one}"),
            several => format!("with the names {}", several.join(", ")),
        };
        Some(Self(What::Json { found, tried: tried.join(", ") }))
    }
}

/// The first names in the outermost object of a text, or of the first object in a list.
fn first_names(text: &[u8]) -> Vec<String> {
    let text = String::from_utf8_lossy(text);
    let (mut names, mut depth, mut outer) = (Vec::new(), 0usize, None);
    let mut rest = text.char_indices();
    while let Some((at, c)) = rest.next() {
        match c {
            '{' | '[' => {
                depth += 1;
                outer = outer.or((c == '{').then_some(depth));
            }
            '}' | ']' => {
                depth = depth.saturating_sub(1);
                if outer.is_some_and(|outer| depth < outer) {
                    break;
                }
            }
            '"' => {
                let mut escaped = false;
                let end = rest.find(|(_, c)| {
                    let ends = *c == '"' && !escaped;
                    escaped = *c == '\\' && !escaped;
                    ends
                });
                let Some((end, _)) = end else { break };
                let named = text[end + 1..].trim_start().starts_with(':');
                if named && outer == Some(depth) && names.len() < TOLD {
                    names.push(text[at + 1..end].to_owned());
                }
            }
            _ => {}
        }
    }
    names
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
        let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
        let fits = |format: &&Self| name.ends_with(format.ending);
        // The first of equals.
        FORMATS.into_iter().rev().filter(fits).max_by_key(|format| format.ending.len())
    }

    /// The format that this content is of, as far as its start tells. A byte order mark before it tells nothing.
    pub fn sniffed(bytes: &[u8]) -> Option<&'static Self> {
        let bytes = unmarked(bytes);
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
        let writer = self.write.ok_or(WriteError::ReadOnly { format: self.name })?;
        if clip.frames.iter().any(|pose| pose.valid) {
            check_poses(clip)?;
        }
        let mut notes = (writer.write)(clip, options, out)?;
        notes.extend(writer.keeps.notes(clip, options, self.ending));
        Ok(notes)
    }

    /// The endings of names of files that are read, for messages.
    pub fn endings() -> String {
        let mut endings: Vec<&str> = Vec::new();
        // Streams are read out of MP4 files, too.
        for ending in FORMATS.iter().map(|format| format.ending).chain([".mp4"]) {
            if !endings.contains(&ending) {
                endings.push(ending);
            }
        }
        endings.join(", ")
    }
}

#[cfg(test)]
mod tests {
    use super::super::Motion;
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
            ("a.vrma", "vrma"),
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
    fn what_is_no_known_json_is_told_by_its_names() {
        let told = |text: &str| NotKnown::of(text.as_bytes()).map(|what| what.to_string());
        let message = told("[{\"a \\\"b\\\":\": {\"c\": 1}, \"d\": \"e\", \"f\": []}, {\"g\": 2}]").unwrap();
        assert!(
            message.contains("with the names \"a \\\\\\\"b\\\\\\\":\", \"d\", \"f\" is none"),
            "{message}"
        );
        assert!(
            message.contains("MediaPipe") && message.contains("Leap") && message.contains("MANO"),
            "{message}"
        );
        assert!(told("{\"one\": 1").unwrap().contains("with the name \"one\""));
        for known in
            ["", "HIERARCHY", "{\"format\":\"handcast-poses\"}", "[{\"keypoints\":[", "{\"hand_pose\": ["]
        {
            assert_eq!(told(known), None, "{known}");
        }
    }

    #[test]
    fn files_of_other_kinds_are_told_by_their_first_bytes() {
        for (at, magic, what) in OTHERS {
            let before = if at == 4 { vec![0, 0, 0, 108] } else { b"PK\x03\x04".repeat(at)[..at].to_vec() };
            let bytes = [&before, magic, &[0; 100]].concat();
            let told = NotKnown::of(&bytes).map(|what| what.to_string());
            assert_eq!(told.as_deref(), Some(what), "{}", bytes.escape_ascii());
            for name in ["a.csv", "a.jsonl", "-"] {
                let refused = Motion::parse(Path::new(name), &bytes).unwrap_err().to_string();
                assert_eq!(refused, format!("{name}: {what}"));
            }
        }
        assert_eq!(NotKnown::of(b"words"), None);
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
            ("{\"format\":\"landmarks21\",\"joints\":[\"mcp\"]}", "landmarks"),
            ("{\"format\":\"webxr-hands\"}", "webxr"),
            ("[{\"jointPositions\":[]}]", "webxr-poses"),
            ("{\"handedness\":[],\n \"landmarks\": []}", "mediapipe"),
            ("[{\"worldLandmarks\":[[", "mediapipe"),
            ("{\"fps\":30}\n{\"multiHandLandmarks\":null}", "mediapipe"),
            ("[[{\"keypoints\":[{", "mediapipe"),
            ("{\"global_orient\": [0, 0, 0], \"hand_pose\": [", "mano"),
            ("PK\u{3}\u{4}\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\u{8}\0\0\0pose.npy", "npz"),
            ("{\"metadata\":{},\"frames\":[[\"id\",{\"pointables\":[[", "leap"),
            ("{\"schema\":[[0,{\"hasHand\":true}]],\"frames\":[]}", "iwer"),
            ("{\"left\":{\"joints\":[", "xr-joints"),
            ("\u{feff}time,hand,x,y,z,qx,qy,qz,qw\n", "csv"),
            ("HIERARCHY\nROOT a", "bvh"),
            ("# a note\n3.2 wave 25 1\n0 1\n0 5\n", "bap"),
            ("glTF", "glb"),
            ("{\"asset\":{\"version\":\"2.0\"}", "gltf"),
            ("{\"accessors\":[{\"bufferView\":0", "gltf"),
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
