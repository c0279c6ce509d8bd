//! The formats of motions and persons; and how files of any kind come and go: whole or not at all ([`atomic`], [`unfinished`]), within
//! limits ([`whole`]), line by line ([`lines`]).

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
