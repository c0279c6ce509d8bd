//! **handcast** moves a hand somewhere else: it finds hands in video, codes their joint angles as an MPEG-4 stream of one
//! to two kilobits per second, and turns that stream back into animated glTF hands.
//!
//! # From a clip to a stream to a hand
//!
//! ```no_run
//! use handcast::Target;
//!
//! let poses = handcast::track("clip.mp4")?;
//! std::fs::write("hand.fba", handcast::encode(&poses, Target::Rms(0.5))?)?;
//!
//! let bytes = std::fs::read("hand.fba")?;
//! let person = poses.person().unwrap_or_default(); // instead of the sizes that the stream carries
//! std::fs::write("hand.glb", handcast::decode(&bytes)?.with_person(&person).to_glb()?)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! [`PoseClip::frames`] has the poses of both hands, one for each hand and moment.
//!
//! # Files
//!
//! [`formats::motion`] reads and writes all that the command does, and tells by their content what files are:
//!
//! ```no_run
//! use handcast::formats::motion::{Format, Motion, WriteOptions};
//!
//! let motion = Motion::read("poses.jsonl".as_ref())?;
//! let avatar = Format::by_name("wave.vrma".as_ref()).ok_or("no such format")?;
//! std::fs::write("wave.vrma", avatar.write(&motion.clip, &WriteOptions::default())?.bytes)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # As it happens
//!
//! [`Tracker`], [`LivePoseEncoder`] and [`PoseDecoder`] are pushed into and give what is known so far; each has a `finish`.
//! Memory stays the same whatever the length.
//!
//! ```no_run
//! use handcast::{Frame, LivePoseEncoder, LivePoseEncoderOptions, PoseDecoder, Tracker};
//! # fn camera() -> Vec<Frame> { Vec::new() }
//! # struct Socket;
//! # impl Socket { fn send(&mut self, _: Vec<u8>) {} fn receive(&mut self) -> Option<Vec<u8>> { None } }
//! # let (mut socket, mut other_end) = (Socket, Socket);
//!
//! let mut tracker = Tracker::new(Default::default());
//! let mut encoder = LivePoseEncoder::new(LivePoseEncoderOptions::default().with_rate(30.0));
//! let mut frames = camera().into_iter();
//! loop {
//!     let frame = frames.next();
//!     let ended = frame.is_none();
//!     // What the tracker still holds when the camera ends: all of a short clip.
//!     let poses = match frame {
//!         Some(frame) => tracker.push(frame)?,
//!         None => tracker.finish()?,
//!     };
//!     if let Some(last) = poses.last() {
//!         for plane in encoder.push(last.time, &poses, &tracker.header(None))? {
//!             socket.send(plane.bytes);
//!         }
//!     }
//!     if ended {
//!         break;
//!     }
//! }
//! encoder.finish()?.into_iter().for_each(|end| socket.send(end.bytes));
//!
//! let mut decoder = PoseDecoder::new(Default::default());
//! while let Some(bytes) = other_end.receive() {
//!     for pose in decoder.push(&bytes)? {
//!         println!("{:.2} s: {:?}", pose.time, pose.pose.side);
//!     }
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # A hand without a camera
//!
//! ```
//! use handcast::{HandPose, JointAngle, PoseClip, Side, Target, TimedPose};
//!
//! let fist = |t: f64| HandPose::neutral(Side::Right).with_degrees(JointAngle::Index1Flexion, 80.0 * t);
//! let frames = (0..30).map(|i| f64::from(i) / 30.0).map(|t| TimedPose::new(t, fist(t)));
//! let clip = PoseClip::of_frames(frames, Some(30.0));
//!
//! let stream = handcast::encode(&clip, Target::Rms(0.5))?;
//! let hand = handcast::decode(&stream)?;
//! assert_eq!(hand.clip().frames.len(), 30);
//! assert!(hand.to_glb()?.starts_with(b"glTF"));
//! # Ok::<(), handcast::Error>(())
//! ```
//!
//! # What can be switched off
//!
//! | feature | brings | default |
//! |---|---|---|
//! | `h264` | MP4 decoded in the process; without it through `ffmpeg` | yes |
//! | `pictures` | PNG, GIF, WebP, BMP, PNM and folders of pictures as clips | yes |
//! | `parallel` | several cores for planning and fitting; the results are the same without | yes |
//! | `formats` | motion files: JSON, CSV, BVH, WebXR, landmarks | yes |
//! | `cli` | the command | yes |
//! | `bench` | `handcast bench`, with zstd as a yardstick | yes |
//!
//! A decoder of streams alone is the crate [`codec`], which compiles for the web as well.
#![doc = ""]
#![doc = include_str!("../ARCHITECTURE.md")]

mod error;
mod front;

pub use error::Error;
pub use front::{Decoded, decode, encode, track};

pub use handcast_codec::{
    DecodedStream, EncodedClip, EncodedEnd, LivePlane, LivePoseEncoder, LivePoseEncoderOptions, PoseDecoder,
    PoseDecoderOptions, PoseEncoder, PoseEncoderOptions, decode_poses, encode_poses,
};
pub use handcast_fba::plan::{PlanOptions, PlanReport, Target};
pub use handcast_fba::{DecoderOptions, ErrorKind};
pub use handcast_hand::{
    Finger, HandPose, Joint, JointAngle, Morphology, Person, PoseClip, PoseHeader, Side, Skeleton, TimedPose,
};
pub use handcast_media::{Frame, FrameSource, OpenOptions, open};
pub use handcast_track::View;
pub use handcast_track::pipeline::{
    ClipEnd, ClipOptions, ClipSink, Start, TrackedClip, TrackedFrame, Tracker, track_clip, track_frames,
};

// The rooms behind the front door.
pub use handcast_codec as codec;
pub use handcast_fba as fba;
#[cfg(feature = "formats")]
pub use handcast_formats as formats;
pub use handcast_gltf as gltf;
pub use handcast_hand as hand;
pub use handcast_media as media;
pub use handcast_picture as picture;
pub use handcast_track as tracking;
pub use handcast_vision as vision;
