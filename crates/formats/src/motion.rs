//! Any file with the motion of hands: streams, BAP text, GLB, BVH, poses, tables, joint positions of other trackers.
//!
//! ```no_run
//! use handcast_formats::motion::Motion;
//!
//! let motion = Motion::read("hand.glb".as_ref())?;
//! println!("{}, {} poses", motion.kind.name(), motion.clip.frames.len());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod bvh;
mod csv;

use std::fs::File;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::import::{ImportOptions, ImportReport, import};
use super::landmarks::{LandmarkClip, LandmarkFileError, WEBXR_FORMAT};
use super::poses::{PoseReader, PosesError, json_message};
use handcast_codec::mapping::Profile;
use handcast_codec::{decode_planes, poses_from_frames};
use handcast_fba::bap::BapFrame;
use handcast_fba::bap::text::{self, BapFile, TextError};
use handcast_fba::plan::TimedBapFrame;
use handcast_fba::{DecoderOptions, SyntaxError};
use handcast_gltf::{Clip, GltfError, HandTrack, import_poses};
use handcast_hand::landmarks::LandmarkError;
use handcast_hand::{ClipHand, JointAngle, Morphology, PoseClip, TimedPose};

pub use bvh::{BvhError, read_bvh};
pub use csv::{TableError, read_csv};

/// Largest file that is read, bytes.
pub const MAX_BYTES: u64 = 1 << 30;

/// What a file is, told by its name and its first byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum MotionKind {
    /// FBA stream (`.fba`).
    Stream,
    /// BAP text (`.bap`).
    BapText,
    /// Animated hand this program wrote (`.glb`).
    Glb,
    /// Biovision hierarchy this program wrote (`.bvh`).
    Bvh,
    /// Poses, as lines (`.jsonl`) or one document (`.json`).
    Poses,
    /// Joint angles as a table (`.csv`).
    Table,
    /// Joint positions (`.landmarks.jsonl`, WebXR `.json`), solved for poses.
    Landmarks,
}

impl MotionKind {
    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Stream => "FBA stream",
            Self::BapText => "BAP text",
            Self::Glb => "animated hand (glTF)",
            Self::Bvh => "BVH",
            Self::Poses => "poses",
            Self::Table => "table of angles",
            Self::Landmarks => "joint positions",
        }
    }

    /// Whether instants between two poses of the file are defined by interpolation, so that poses may be
    /// missing where interpolation gives them back.
    pub fn is_keyed(self) -> bool {
        self == Self::Glb
    }

    /// Whether it tells this joint angle. 21 points show neither twists nor how the palm bends.
    pub fn carries(self, angle: JointAngle) -> bool {
        let unseen = || angle.name().ends_with("twisting") || angle.name().contains("0_flexion");
        self != Self::Landmarks || !unseen()
    }
}

/// The BAP frames of a stream or BAP text.
#[derive(Clone, Debug, PartialEq)]
pub struct BapTrack {
    /// Frames per second.
    pub rate: f64,
    /// The frames; skipped ones are left out.
    pub frames: Vec<TimedBapFrame>,
}

impl From<&BapFile> for BapTrack {
    fn from(file: &BapFile) -> Self {
        let timed =
            |&(number, baps): &(u32, BapFrame)| TimedBapFrame { time: f64::from(number) / file.rate, baps };
        Self { rate: file.rate, frames: file.frames.iter().map(timed).collect() }
    }
}

impl BapTrack {
    /// The frames as BAP text, numbered by their times.
    pub fn to_text(&self, name: &str) -> BapFile {
        let number = |f: &TimedBapFrame| ((f.time * self.rate).round() as u32, f.baps);
        let frames = self.frames.iter().map(number).collect();
        BapFile { version: "3.2".into(), name: name.to_owned(), rate: self.rate, frames }
    }
}

/// What was read.
#[derive(Clone, Debug)]
pub struct Motion {
    /// What the file is.
    pub kind: MotionKind,
    /// The poses; none when a stream or BAP text moves no hand.
    pub clip: PoseClip,
    /// The BAPs behind them, of streams and BAP text.
    pub baps: Option<BapTrack>,
    /// Whether it says where the wrist is: not in profile `arm`, nor in joint positions without a unit.
    pub placed: bool,
    /// What solving for poses found, of joint positions.
    pub import: Option<ImportReport>,
}

/// Why a motion could not be read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum MotionError {
    /// The file could not be opened or read.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file is larger than [`MAX_BYTES`].
    #[error("{path}: larger than the {MAX_BYTES} bytes allowed")]
    TooLarge {
        /// The file.
        path: PathBuf,
    },
    /// The name's ending is not one of a motion.
    #[error(
        "{path}: no kind of motion this program reads; allowed are .fba, .bap, .glb, .bvh, .jsonl, .json and .csv"
    )]
    Kind {
        /// The file.
        path: PathBuf,
    },
    /// Joint positions cannot be read; the reason names the file.
    #[error(transparent)]
    Landmarks(#[from] LandmarkFileError),
    /// The content is wrong.
    #[error("{path}: {reason}")]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong and where.
        reason: ContentError,
    },
}

/// What is wrong with the content of a file.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ContentError {
    /// A stream.
    #[error(transparent)]
    Stream(#[from] SyntaxError),
    /// BAP text.
    #[error(transparent)]
    BapText(#[from] TextError),
    /// A GLB.
    #[error(transparent)]
    Glb(#[from] GltfError),
    /// A BVH file.
    #[error(transparent)]
    Bvh(#[from] BvhError),
    /// A table.
    #[error(transparent)]
    Table(#[from] TableError),
    /// Poses.
    #[error(transparent)]
    Poses(#[from] PosesError),
    /// A document of poses that is no JSON.
    #[error("poses: line {}: {}", .0.line(), json_message(.0))]
    Json(#[from] serde_json::Error),
    /// A document of poses without a list of frames.
    #[error("poses: the document has no list \"frames\"")]
    NoFrames,
    /// Joint positions that are not those of a hand.
    #[error(transparent)]
    Landmarks(#[from] LandmarkError),
    /// There is no plane or frame.
    #[error("it holds no frame")]
    Empty,
}

impl Motion {
    /// Reads a file of any kind.
    ///
    /// # Errors
    /// See [`MotionError`].
    pub fn read(path: &Path) -> Result<Self, MotionError> {
        let bytes = read_bytes(path)?;
        let kind = kind_of(path, &bytes).ok_or_else(|| MotionError::Kind { path: path.into() })?;
        let parsed = match kind {
            // Has limits and line numbers of its own.
            MotionKind::Landmarks => landmarks(&LandmarkClip::read_all(path)?),
            kind => parse(kind, &bytes),
        };
        parsed.map_err(|reason| MotionError::Content { path: path.into(), reason })
    }

    fn of(kind: MotionKind, clip: PoseClip) -> Self {
        Self { kind, clip, baps: None, placed: true, import: None }
    }
}

fn read_bytes(path: &Path) -> Result<Vec<u8>, MotionError> {
    let io_error = |source| MotionError::Io { path: path.into(), source };
    let mut bytes = Vec::new();
    File::open(path).map_err(io_error)?.take(MAX_BYTES + 1).read_to_end(&mut bytes).map_err(io_error)?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(MotionError::TooLarge { path: path.into() });
    }
    Ok(bytes)
}

/// The kind of a file with this name and content.
fn kind_of(path: &Path, bytes: &[u8]) -> Option<MotionKind> {
    let ending = path.extension()?.to_str()?.to_ascii_lowercase();
    Some(match ending.as_str() {
        "fba" => MotionKind::Stream,
        "bap" => MotionKind::BapText,
        "glb" => MotionKind::Glb,
        "bvh" => MotionKind::Bvh,
        "csv" => MotionKind::Table,
        "jsonl" | "json" => {
            let start = bytes.trim_ascii_start();
            let head = start.get(..start.len().min(400)).unwrap_or_default();
            let says = |word: &[u8]| head.windows(word.len()).any(|w| w == word);
            let points =
                start.first() == Some(&b'[') || says(b"\"landmarks2") || says(WEBXR_FORMAT.as_bytes());
            if points { MotionKind::Landmarks } else { MotionKind::Poses }
        }
        _ => return None,
    })
}

fn parse(kind: MotionKind, bytes: &[u8]) -> Result<Motion, ContentError> {
    let text = || String::from_utf8_lossy(bytes);
    Ok(match kind {
        MotionKind::Stream => {
            let decoded = decode_planes(bytes, DecoderOptions::default())?;
            let frames =
                decoded.planes.iter().map(|p| TimedBapFrame { time: p.time, baps: p.baps }).collect();
            from_baps(kind, BapTrack { rate: decoded.rate, frames })?
        }
        MotionKind::BapText => from_baps(kind, BapTrack::from(&text::read(&text())?))?,
        MotionKind::Glb => Motion::of(kind, clip_from_glb(bytes)?),
        MotionKind::Bvh => Motion::of(kind, read_bvh(&text())?),
        MotionKind::Table => Motion::of(kind, read_csv(&text())?),
        MotionKind::Poses | MotionKind::Landmarks => Motion::of(kind, poses(bytes)?),
    })
}

/// The poses at the keys of a GLB that this program wrote, of every hand.
///
/// # Errors
/// See [`import_poses`].
pub fn clip_from_glb(glb: &[u8]) -> Result<PoseClip, GltfError> {
    let mut clip = PoseClip::default();
    for hand in import_poses(glb)? {
        clip.header.hands.push(ClipHand { side: hand.side, morphology: hand.morphology });
        clip.frames.extend(hand.poses.into_iter().map(|(time, pose)| TimedPose::new(time, pose)));
    }
    Ok(clip)
}

/// The valid poses of a clip as [`handcast_gltf::export`] takes them; hands of unknown sizes get those of `fallback`.
pub fn gltf_clip(clip: &PoseClip, fallback: &Morphology) -> Clip {
    let hands = clip.header.hands.iter().map(|info| HandTrack {
        morphology: info.morphology.as_ref().unwrap_or(fallback).clone(),
        poses: clip.of(info.side).filter(|f| f.valid).map(|f| (f.time, f.pose.clone())).collect(),
    });
    Clip { hands: hands.filter(|hand| !hand.poses.is_empty()).collect() }
}

fn from_baps(kind: MotionKind, baps: BapTrack) -> Result<Motion, ContentError> {
    if baps.frames.is_empty() {
        return Err(ContentError::Empty);
    }
    let (clip, profile) = poses_from_frames(&baps.frames, baps.rate, None, true);
    Ok(Motion { placed: profile == Profile::Hand, baps: Some(baps), ..Motion::of(kind, clip) })
}

/// Pose lines, or the same as one document whose header holds the frames.
fn poses(bytes: &[u8]) -> Result<PoseClip, ContentError> {
    let first = bytes.trim_ascii_start().split(|&b| b == b'\n').next().unwrap_or_default();
    let header: Result<serde_json::Value, _> = serde_json::from_slice(first);
    let one_document = match &header {
        Ok(header) => header.get("frames").is_some(),
        Err(_) => !bytes.trim_ascii().is_empty(),
    };
    if !one_document {
        return Ok(PoseReader::new(bytes)?.into_clip()?);
    }
    let mut document: serde_json::Value = serde_json::from_slice(bytes)?;
    let frames = document.as_object_mut().and_then(|object| object.remove("frames"));
    let Some(serde_json::Value::Array(frames)) = frames else { return Err(ContentError::NoFrames) };
    let mut lines = document.to_string();
    for frame in frames {
        lines.push('\n');
        lines.push_str(&frame.to_string());
    }
    Ok(PoseReader::new(lines.as_bytes())?.into_clip()?)
}

/// The poses of all hands, and what solving for them found.
fn landmarks(hands: &[LandmarkClip]) -> Result<Motion, ContentError> {
    let mut clip = PoseClip::default();
    let mut found: Option<ImportReport> = None;
    for points in hands {
        let (of_hand, report) = import(points, &ImportOptions::default())?;
        clip.header.rate = clip.header.rate.or(of_hand.header.rate);
        clip.header.made_by = clip.header.made_by.or(of_hand.header.made_by);
        clip.header.hands.extend(of_hand.header.hands);
        clip.frames.extend(of_hand.frames);
        found = Some(match found {
            Some(before) => before.with(&report),
            None => report,
        });
    }
    clip.frames.sort_by(|a, b| a.time.total_cmp(&b.time));
    let placed = hands.iter().all(|points| points.metres.is_some());
    Ok(Motion { placed, import: found, ..Motion::of(MotionKind::Landmarks, clip) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export;
    use handcast_gltf::JointNames;
    use handcast_hand::{HandPose, PoseHeader, Side};
    use nalgebra::{UnitQuaternion, Vector3};

    pub(super) fn clip(sides: &[Side]) -> PoseClip {
        let mut clip = PoseClip { header: PoseHeader::default(), frames: Vec::new() };
        clip.header.rate = Some(25.0);
        for &side in sides {
            clip.header.hands.push(ClipHand { side, morphology: None });
            for i in 0..30 {
                let t = f64::from(i) / 25.0;
                let mut pose = HandPose::neutral(side);
                for (k, angle) in JointAngle::ALL.into_iter().enumerate() {
                    let size = if angle.name().ends_with("2_flexion") { 1.5 } else { 0.3 };
                    pose.set(angle, size * (0.5 - 0.5 * (2.0 * t + k as f64).cos()));
                }
                pose.rotation = UnitQuaternion::from_euler_angles(0.9 * t, 2.5 * t, 3.0 * t);
                pose.translation = Vector3::new(0.1 * t, -0.2, -0.5 + t);
                clip.frames.push(TimedPose::new(t, pose));
            }
        }
        clip
    }

    pub(super) fn worst(a: &PoseClip, b: &PoseClip) -> f64 {
        assert_eq!(a.frames.len(), b.frames.len());
        let mut worst = 0.0f64;
        for side in [Side::Left, Side::Right] {
            for (a, b) in a.of(side).zip(b.of(side)) {
                assert!((a.time - b.time).abs() < 1e-5);
                assert!((a.pose.translation - b.pose.translation).norm() < 1e-5);
                assert!(a.pose.rotation.angle_to(&b.pose.rotation) < 1e-5);
                let off = |angle| (a.pose.angle(angle) - b.pose.angle(angle)).abs();
                worst = JointAngle::ALL.into_iter().map(off).fold(worst, f64::max);
            }
        }
        worst
    }

    #[test]
    fn every_written_kind_is_read_again() {
        let folder = tempfile::tempdir().unwrap();
        let both = clip(&[Side::Left, Side::Right]);
        let path = |name: &str| folder.path().join(name);
        std::fs::write(path("x.csv"), export::csv(&both).unwrap()).unwrap();
        let bvh = export::bvh(&both, &Morphology::default(), JointNames::OpenXr, 25.0).unwrap();
        std::fs::write(path("x.bvh"), bvh).unwrap();
        super::super::poses::write_poses(&path("x.jsonl"), &both).unwrap();
        let lines = std::fs::read_to_string(path("x.jsonl")).unwrap();
        let (header, frames) = lines.split_once('\n').unwrap();
        let frames = frames.trim_end().replace('\n', ",");
        let document = format!("{},\"frames\":[{frames}]}}", header.strip_suffix('}').unwrap());
        std::fs::write(path("x.json"), document).unwrap();
        for (name, tolerance) in [("x.csv", 2e-6), ("x.bvh", 2e-6), ("x.jsonl", 2e-7), ("x.json", 2e-7)] {
            let back = Motion::read(&path(name)).unwrap();
            assert!(worst(&both, &back.clip) < tolerance, "{name}");
            assert!(back.placed && back.baps.is_none());
        }
    }

    #[test]
    fn kinds_are_told_by_name_and_content() {
        let kind = |name: &str, text: &str| kind_of(Path::new(name), text.as_bytes());
        assert_eq!(kind("a.FBA", ""), Some(MotionKind::Stream));
        assert_eq!(kind("a.jsonl", "{\"format\":\"handcast-poses\"}"), Some(MotionKind::Poses));
        assert_eq!(kind("a.jsonl", " {\"format\":\"landmarks21\"}"), Some(MotionKind::Landmarks));
        assert_eq!(kind("a.json", "[{}]"), Some(MotionKind::Landmarks));
        assert_eq!(kind("a.mp4", ""), None);
        assert_eq!(kind("fba", ""), None);
        assert!(!MotionKind::Landmarks.carries(JointAngle::Index1Twisting));
        assert!(!MotionKind::Landmarks.carries(JointAngle::Pinky0Flexion));
        assert!(MotionKind::Landmarks.carries(JointAngle::Pinky1Flexion));
    }

    #[test]
    fn broken_files_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        for (name, text, words) in [
            ("a.fba", "nothing", "bit"),
            ("a.bap", "", "header"),
            ("a.glb", "glTF", "gltf"),
            ("a.bvh", "HIERARCHY", "bvh"),
            ("a.csv", "time,hand\n", "table"),
            ("a.json", "{\"format\":\"handcast-poses\"\n}", "frames"),
            ("a.jsonl", "{}\n", "format"),
            ("b.jsonl", "{\"format\":\"landmarks21\"}\n", "landmarks"),
            ("a.txt", "x", "allowed are"),
        ] {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            let message = Motion::read(&path).unwrap_err().to_string();
            assert!(message.contains(words) && message.contains(name), "{message}");
        }
        let missing = Motion::read(&folder.path().join("none.fba")).unwrap_err().to_string();
        assert!(missing.contains("none.fba"), "{missing}");
    }
}
