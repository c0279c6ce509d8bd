//! Rooms that outgrow a machine: the two ends of a live transport over Media over QUIC.
//!
//! A sender is a broadcast `ROOM/NAME` with one track, `planes`. A group of it is an I period, a frame one message of
//! [`handcast_live::wire`] or a few behind one another: the first says hello and holds the I plane, the short form of planes goes
//! on within the group. So relays, which know nothing of hands, give a joiner the current period from its beginning, and drop
//! periods, not planes, where a link is slow.

mod bridge;
mod error;
mod freshness;
mod mailbox;
mod options;
pub mod page;
mod publisher;
mod subscriber;
pub mod trial;

pub use bridge::bridge;
pub use error::transport_error;
pub use options::MoqOptions;
pub use publisher::MoqPublisher;
pub use subscriber::MoqSubscriber;

/// Name of a sender's track.
pub const TRACK: &str = "planes";
