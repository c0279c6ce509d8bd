//! Hands sent while they move: messages, and the two ends of a transport.
//!
//! [`wire`] has the messages that the planes of a live stream travel in, [`transport`] what gives and takes them.

pub mod transport;
pub mod wire;
