//! Poses to an FBA stream and back: the BAP mapping and the bitstream in one step.
//!
//! Three poses encoded, and decoded again:
//!
//! ```
//! use handcast_codec::mapping::Profile;
//! use handcast_codec::{decode_poses, encode_poses};
//! use handcast_fba::DecoderOptions;
//! use handcast_fba::plan::{PlanOptions, Target};
//! use handcast_hand::{HandPose, JointAngle, PoseClip, Side, TimedPose};
//!
//! let bend = JointAngle::Index2Flexion;
//! let mut clip = PoseClip::default();
//! clip.header.rate = Some(30.0);
//! for (frame, degrees) in [0.0, 20.0, 45.0].into_iter().enumerate() {
//!     let pose = HandPose::neutral(Side::Right).with_degrees(bend, degrees);
//!     clip.frames.push(TimedPose::new(frame as f64 / 30.0, pose));
//! }
//! let options = PlanOptions { mode: Target::MaxError(1.0), ..PlanOptions::default() };
//! let encoded = encode_poses(&clip, Profile::Hand, &options)?;
//!
//! let decoded = decode_poses(&encoded.stream, None, DecoderOptions::default())?;
//! assert_eq!(decoded.clip.frames.len(), 3);
//! let last = decoded.clip.frames[2].pose.angle(bend).to_degrees();
//! assert!((last - 45.0).abs() <= 1.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Streamed, pose by pose, without waiting for the end on either side: [`PoseEncoder`] and [`PoseDecoder`]. Hands that
//! come and go before a camera: [`LivePoseEncoder`].

mod beat;
mod clip;
mod damage;
mod decoder;
mod encoder;
mod error;
mod gains;
mod guard;
mod live;
pub mod mapping;
pub mod notices;
pub mod packets;
mod person;
mod shown;
pub mod ties;
mod timeline;
mod tips;

pub use clip::{
    DecodedBaps, DecodedStream, EncodedClip, Gap, bap_frames, clip_rate, decode_baps, decode_planes,
    decode_poses, decode_poses_within, encode_bridged, encode_poses, gaps, on_ticks, poses_from_frames,
    poses_from_frames_within, poses_keep, poses_on_ticks,
};
pub use damage::Damage;
pub use decoder::{FADE, PlaneTotals, PoseDecoder, PoseDecoderOptions};
pub use encoder::{EncodedEnd, PoseEncoder, PoseEncoderOptions};
pub use error::{PosesToStreamError, StreamToPosesError};
pub use gains::for_hands;
pub use live::{LivePlane, LivePoseEncoder, LivePoseEncoderOptions};
pub use person::{hands_of_record, record_of, skin_tone_of_record};
pub use shown::Shown;
pub use tips::TipError;
