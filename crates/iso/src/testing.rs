//! Tables for tests.

use crate::boxed;

/// Numbers of four bytes each.
pub fn words(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_be_bytes()).collect()
}

/// The box of a table: version and flags, then words.
pub fn table(kind: &[u8; 4], rest: &[u32]) -> Vec<u8> {
    boxed(kind, &words(&[&[0], rest].concat()))
}
