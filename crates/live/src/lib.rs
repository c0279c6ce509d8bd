//! Hands sent while they move: messages, the two ends of a transport, and a room behind one port.
//!
//! [`wire`] has the messages that the planes of a live stream travel in, [`transport`] what gives and takes them; both
//! compile for wasm32. With the feature `server`, [`server`] is a room of senders and viewers that browsers and programs
//! come to, [`client`] the way there from a program; with `sender`, [`sender`] makes planes of a tracker's poses.

#[cfg(feature = "server")]
pub mod client;
#[cfg(feature = "server")]
pub mod crowd;
#[cfg(feature = "server")]
pub mod lossy;
#[cfg(feature = "page")]
pub mod page;
#[cfg(feature = "server")]
mod room;
#[cfg(feature = "sender")]
pub mod sender;
#[cfg(feature = "server")]
pub mod server;
pub mod transport;
pub mod wire;
