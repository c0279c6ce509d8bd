//! Hand motion in the browser: what the WebAssembly modules beside `dist/handcast.js` are made of.
//!
//! [`StreamPlayer`] turns the bytes of a stream into rows of numbers that JavaScript reads from memory: joint angles, the
//! wrist, and the world matrices of 25 joints. [`sizes`] is a hand's morphology as numbers, [`surface`] the skin of such
//! a hand; with the feature `track`, `sender` makes planes of a camera's pictures. The exports themselves are in [`abi`].

pub mod abi;
#[cfg(feature = "decoder")]
mod player;
mod row;
#[cfg(feature = "track")]
pub mod sender;
pub mod sizes;
#[cfg(feature = "surface")]
pub mod surface;

#[cfg(feature = "decoder")]
pub use player::{PlayerError, PlayerOptions, StreamFacts, StreamPlayer};
pub use row::{ANGLES, JOINTS, ROW, WRIST, write_row};
