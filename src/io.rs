//! Frame sources, and pose sources and sinks.

pub mod atomic;
pub mod avi;
pub mod export;
pub mod frames;
pub mod import;
pub mod landmarks;
pub mod lines;
pub mod motion;
pub mod person;
pub mod poses;
