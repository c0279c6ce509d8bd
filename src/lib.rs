//! MPEG-4 hand animation: video of a hand to a BAP stream, and back to an animated glTF hand.

#![forbid(unsafe_code)]
#![warn(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

pub mod bap;
pub mod codec;
pub mod fba;
pub mod fidelity;
pub mod gltf;
pub mod hand;
pub mod io;
pub mod pipeline;
mod random;
pub mod render;
pub mod synth;
mod threads;
pub mod track;
pub mod tuning;
pub mod view;
pub mod vision;
