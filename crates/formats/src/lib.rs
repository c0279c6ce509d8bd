//! The formats of motions and persons.

pub mod atomic;
mod batches;
mod decimal;
pub mod import;
pub mod landmarks;
pub mod lines;
pub mod motion;
pub mod mp4;
pub mod person;
pub mod poses;
pub mod unfinished;
pub mod whole;
