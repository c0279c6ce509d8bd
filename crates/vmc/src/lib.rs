//! Poses of hands as packets of the VMC protocol: OSC over UDP.
//!
//! [`HandBones`] turns a pose into bones, [`packet`] bones into the bytes of an OSC bundle, [`VmcSender`] sends both hands.
//!
//! Source: the specification of the VMC protocol for marionettes (receivers), version 2.7; axes and rest pose of bones: VRM 1.0,
//! `tpose.md`.

mod bones;
mod error;
mod packet;
mod sender;

pub use bones::{Bone, HandBones};
pub use error::VmcError;
pub use handcast_hand::humanoid::BONES;
pub use packet::{MAX_PACKET, packet};
pub use sender::{PORT, Sent, VmcSender};
