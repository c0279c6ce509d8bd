//! Where the real material is, for tests that use it when it is there.

#![allow(dead_code)] // each test file uses its own part

pub mod command;
pub mod glb;
pub mod hand;

use std::path::PathBuf;

/// The file `name` under the folder of shared material; `None`, saying so, when it is not there.
pub fn shared(name: &str) -> Option<PathBuf> {
    let root = std::env::var_os("HANDCAST_SHARED")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared")), PathBuf::from);
    let path = root.join(name);
    if path.exists() {
        return Some(path);
    }
    assert!(std::env::var_os("CI").is_none(), "{} is missing, and CI must not skip", path.display());
    println!("skipped: {} is not there", path.display());
    None
}
