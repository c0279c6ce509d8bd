//! glTF export of poses with mesh and skin, and the way back.
//!
//! A GLB holds, for each hand, a skinned mesh with textures of its skin, 25 joint nodes named as [`JointNames`] says, and one animation
//! for all. Right-handed, +Y up, metres, the camera frame of the poses. Joint nodes have the axes that [`NodeAxes`]
//! says, whatever their names. A joint that keeps still has no track: its node says where it is.
//!
//! [`retarget`] puts the same motion on a rig made elsewhere, [`export_vrma`] writes it for VRM avatars. [`import`] reads the poses
//! of all of these, and of rigs that other programs moved.

mod animation;
mod axes;
mod container;
mod export;
mod import;
mod keys;
mod names;
mod png;
mod retarget;
mod root;
mod skin;
mod source;
mod tracks;
mod vrma;
mod writer;

pub use axes::NodeAxes;
pub use export::export;
pub use import::{ImportOptions, Imported, ImportedHand, import, import_poses};
pub use names::{JointNames, meaning as joint_named, meanings as joints_named};
pub use retarget::{CheckedRig, JointMap, MapError, Retargeted, RigError, check_rig, retarget};
pub use skin::Skins;
pub use source::{as_document, with_buffers};
pub use vrma::export_vrma;

use thiserror::Error;

use handcast_hand::{HandPose, Morphology, PoseClip, Side};
use handcast_limits::Limits;

/// Hands and how they move.
#[derive(Clone, Debug, Default)]
pub struct Clip {
    /// One track, or one for each side.
    pub hands: Vec<HandTrack>,
    /// Colour of their skin, sRGB, where it is known.
    pub skin: Option<[u8; 3]>,
    /// Frames per second, where it is known: keys that interpolation gives back may be left out.
    pub rate: Option<f64>,
    /// Seconds that were taken off all times.
    pub start: f64,
}

/// What `asset.extras` calls [`Clip::rate`] and [`Clip::start`].
const FRAME_RATE: &str = "frames_per_second";
const START: &str = "start";

/// Seconds up to which a clip may begin: single precision tells milliseconds apart for some hours from there.
pub const LATEST_START: f64 = 16_384.0;

impl Clip {
    /// The valid poses of a clip, and its skin; hands of unknown sizes get those of `fallback`. A clip that begins before 0, or
    /// after [`LATEST_START`], is counted from its first frame on: times of glTF are not negative, and single.
    pub fn of(clip: &PoseClip, fallback: &Morphology) -> Self {
        let first = clip.frames.iter().map(|f| f.time).fold(f64::INFINITY, f64::min);
        let start = if (0.0..=LATEST_START).contains(&first) { 0.0 } else { first };
        let hands = clip.header.hands.iter().map(|info| HandTrack {
            morphology: info.morphology.as_ref().unwrap_or(fallback).clone(),
            poses: clip.of(info.side).filter(|f| f.valid).map(|f| (f.time - start, f.pose.clone())).collect(),
        });
        let hands: Vec<HandTrack> = hands.filter(|hand| !hand.poses.is_empty()).collect();
        let start = if start.is_finite() { start } else { 0.0 };
        let rate = clip.header.rate.or_else(|| hands.iter().find_map(HandTrack::rate));
        Self { hands, skin: clip.header.skin(), rate, start }
    }
}

/// One hand and how it moves.
#[derive(Clone, Debug)]
pub struct HandTrack {
    /// The person's sizes.
    pub morphology: Morphology,
    /// Times in seconds, strictly increasing and not negative, with poses of one side.
    pub poses: Vec<(f64, HandPose)>,
}

/// How far intervals may be from the mean one in an even motion, as a share of it.
const UNEVEN: f64 = 0.1;

impl HandTrack {
    /// Poses a second, where they are evenly spread.
    fn rate(&self) -> Option<f64> {
        let [(first, _), .., (last, _)] = self.poses.as_slice() else { return None };
        let mean = (last - first) / (self.poses.len() - 1) as f64;
        let even = |pair: &[(f64, HandPose)]| (pair[1].0 - pair[0].0 - mean).abs() <= UNEVEN * mean;
        self.poses.windows(2).all(even).then_some(1.0 / mean)
    }
}

/// What to write.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct ExportOptions {
    /// Names of the joint nodes.
    pub names: JointNames,
    /// Axes of the joint nodes.
    pub axes: NodeAxes,
    /// Leave out mesh and skin: joints, which stand with straight fingers, and animation only.
    pub animation_only: bool,
    /// Name of the animation.
    pub animation: String,
    /// Keys that interpolation reproduces this closely are left out: radians for rotations, of each joint against the one
    /// above it. 0 keeps all, and so does a track whose own key times would take more than is spared.
    pub rotation_tolerance: f64,
    /// The same for the wrist's translation, metres of the world.
    pub translation_tolerance: f64,
    /// Store rotations as normalised shorts, and the mesh as `KHR_mesh_quantization` allows: positions in
    /// steps of a few micrometres, normals and weights as bytes. Rotations are off by at most 6e-5 rad.
    pub quantize: bool,
    /// Skin colour, sRGB, in place of the clip's; where neither says, that of tone 3.
    pub skin: Option<[u8; 3]>,
    /// Pixels a side of the textures of the skin, 16 to 4096, in quantised files at most 512; without them it has one
    /// colour.
    pub texture: Option<usize>,
    /// Facts to keep in `asset.extras`, next to those the export writes itself.
    pub extras: serde_json::Map<String, serde_json::Value>,
    /// What a rig may hold that is moved.
    pub limits: Limits,
    /// What is kept from file to file.
    pub skins: Skins,
}

impl Default for ExportOptions {
    fn default() -> Self {
        Self {
            names: JointNames::default(),
            axes: NodeAxes::default(),
            animation_only: false,
            animation: "motion".into(),
            rotation_tolerance: 0.0,
            translation_tolerance: 0.0,
            quantize: false,
            skin: None,
            texture: Some(1024),
            extras: serde_json::Map::new(),
            limits: Limits::default(),
            skins: Skins::default(),
        }
    }
}

/// Why a file cannot be written or read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum GltfError {
    /// The clip has no hand, or a hand no pose.
    #[error("gltf: {what} is empty")]
    Empty {
        /// What is empty.
        what: &'static str,
    },
    /// More than one track for a side, or poses of both sides in one track.
    #[error("gltf: {what} of the {} hand, allowed one track a side", side.name())]
    Sides {
        /// What is wrong.
        what: &'static str,
        /// Which side.
        side: Side,
    },
    /// A time is negative, not finite, or not after the one before it (in `f32`, as glTF stores it).
    #[error("gltf: time {time} s of pose {index} does not follow {previous} s")]
    Time {
        /// Number of the pose in its track.
        index: usize,
        /// Its time.
        time: f64,
        /// The time before it; 0 for the first.
        previous: f64,
    },
    /// A pose holds a number that is not finite.
    #[error("gltf: pose {index} of the {} hand is not finite", side.name())]
    Pose {
        /// Number of the pose in its track.
        index: usize,
        /// Which side.
        side: Side,
    },
    /// The person's sizes are out of range.
    #[error("gltf: {0}")]
    Morphology(#[from] handcast_hand::MorphologyError),
    /// The file would be larger than GLB allows.
    #[error("gltf: {bytes} bytes, allowed at most 4294967295")]
    Size {
        /// How large.
        bytes: usize,
    },
    /// The user's rig cannot be used.
    #[error(transparent)]
    Rig(#[from] RigError),
    /// More than a reader takes.
    #[error("gltf: {0}")]
    Excess(#[from] handcast_limits::Excess),
    /// JSON could not be written.
    #[error("gltf: cannot write json: {0}")]
    Json(#[from] serde_json::Error),
    /// The bytes are no valid glTF.
    #[error("gltf: cannot read: {0}")]
    Syntax(#[source] Box<::gltf::Error>),
    /// The file is valid, but not one this program can take poses from.
    #[error("gltf: {what}")]
    Unsupported {
        /// What is missing or different.
        what: String,
    },
}
