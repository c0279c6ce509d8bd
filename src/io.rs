//! Frame sources, and pose sources and sinks.

mod lines;
pub mod person;
pub mod poses;
