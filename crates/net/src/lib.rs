//! TensorFlow Lite networks in pure Rust, and the finding of hands with them.

mod error;
mod graph;
mod kernels;
pub mod model;

pub use error::{Error, Result};
pub use graph::{Network, Port};
pub use kernels::tiles;
