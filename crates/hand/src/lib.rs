//! The articulated hand: skeleton, pose, constraints, morphology, shapes.
//!
//! # Frames and signs
//!
//! The *hand frame* of a right hand has its origin in the wrist, +X towards the thumb (radial), +Y
//! towards the fingertips (distal) and +Z out of the palm (palmar); metres. A left hand is the mirror
//! image in the plane x = 0. Angles are radians with the anatomical signs of [`JointAngle`], the same
//! for both hands; the signs of the MPEG-4 standard live in `handcast_codec::mapping` only.

pub mod anthropometry;
mod bridge;
pub mod clip;
mod constraints;
mod extended;
pub mod humanoid;
pub mod jacobian;
pub mod landmarks;
mod mesh;
mod morphology;
mod pose;
mod quadratic;
pub mod random;
mod shape;
pub mod shapes;
pub mod sizes;
mod skeleton;
pub mod smooth;
mod srgb;
pub mod turns;

pub use bridge::{Bridged, MAX_GAP};
pub use clip::{
    Absence, ClipHand, FrameCheck, MAX_FRAMES, MAX_TIME, PoseClip, PoseClipError, PoseHeader, TimedPose,
    nearest_in_time, usual_step,
};
pub use constraints::{
    AngleLimits, DIP_FROM_PIP, Domain, FREE_ANGLES, FreeAngles, HalfSpace, limits, palm_from_mcp, palm_slope,
    thumb_mcp_from_cmc, thumb_mcp_slope,
};
pub use extended::{
    LEAST_REACH, THUMB_OUT, count_extended, count_extended_of, extended_fingers, extended_fingers_of,
};
pub use jacobian::{Jacobian, moved_by};
pub use mesh::{Crease, HandMesh, LINE_POINTS, Mark, Nail, PackedHand, SkinMarks, SkinnedSurface};
pub use mesh::{NAIL_BED, PLAIN_SKIN, SkinMaps, nearest_skin_tone, noise, palm_of, skin_tone};
pub use morphology::{FOREARMS, WEB_LENGTHS, WEB_ROOTS};
pub use morphology::{FingerMorphology, Morphology, MorphologyError, Person};
pub use pose::{Degrees, PoseData, WristData};
pub use pose::{Finger, HandPose, JointAngle, JointAngles, Side};
pub use pose::{mirror_rotation, mirror_vector};
pub use shape::{MAX_HULL_SPHERES, Primitive, Shape, Sphere};
pub use skeleton::{HandFrames, Joint, Skeleton};
pub use srgb::{linear_from_srgb, srgb_from_linear};
