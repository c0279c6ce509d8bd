//! What every target of a reader shares: memory that a reader may take, panics that the library catches, and mutations
//! that keep a file's frame whole.

#![allow(dead_code)]

use std::alloc::System;
use std::sync::Once;

use cap::Cap;

#[path = "mutate.rs"]
pub mod mutate;

/// What any input may take besides four times its size, bytes (spec/limits.md).
const MEMORY: usize = 64 << 20;

/// Beyond the limit no memory is given, which ends the program: a finding.
#[global_allocator]
static ALLOCATOR: Cap<System> = Cap::new(System, usize::MAX);

/// Runs a check within the memory that an input of this size may take.
pub fn within(data: &[u8], check: fn(&[u8])) {
    static CAUGHT: Once = Once::new();
    CAUGHT.call_once(let_caught_panics_pass);
    let limit = ALLOCATOR.allocated() + MEMORY + 4 * data.len();
    ALLOCATOR.set_limit(limit).expect("more than there is now");
    check(data);
    ALLOCATOR.set_limit(usize::MAX).expect("no limit");
}

/// The fuzzer ends at any panic. Those of the H.264 decoder are caught by `handcast_media` and told as damage, as
/// spec/limits.md says; all others stay findings.
fn let_caught_panics_pass() {
    let ending = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let theirs = panic.location().is_some_and(|place| place.file().contains("rusty_h264"));
        if !theirs {
            ending(panic);
        }
    }));
}
