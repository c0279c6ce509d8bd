//! Frame sources, and pose sources and sinks.

pub mod atomic;
pub mod avi;
pub mod frames;
mod lines;
pub mod person;
pub mod poses;
