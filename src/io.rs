//! Frame sources, and pose sources and sinks.

pub mod atomic;
pub mod avi;
pub mod frames;
