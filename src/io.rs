//! Frame sources, and pose sources and sinks.

pub mod import;
pub mod landmarks;
mod lines;
pub mod person;
pub mod poses;
