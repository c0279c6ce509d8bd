//! TensorFlow Lite networks in pure Rust, and the finding of hands with them.

mod error;
pub mod files;
mod graph;
pub mod hands;
mod kernels;
pub mod model;
#[cfg(any(test, feature = "test-support"))]
pub mod testing;

pub use error::{Error, Result};
pub use graph::{Network, Port};
