//! What several test programs need.

use std::path::PathBuf;

/// The shared data at `path`; `None`, with a line on stderr, where there are none. In CI they must be
/// there.
pub fn shared(path: &str) -> Option<PathBuf> {
    let root = std::env::var_os("HANDCAST_SHARED")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared"), PathBuf::from);
    let full = root.join(path);
    if full.exists() {
        return Some(full);
    }
    assert!(std::env::var_os("CI").is_none(), "{} is missing", full.display());
    eprintln!("skipped: {} is missing", full.display());
    None
}
