//! Where the real material is, for tests that need it. Such tests are `#[ignore]`d: who asks for them has it.

pub mod command;
pub mod files;
pub mod glb;
pub mod hand;
pub mod python;
pub mod vrm;
pub mod y4m;

use std::path::PathBuf;

/// The file or folder `name` under the folder of shared material, which `HANDCAST_SHARED` names, `../shared` otherwise.
///
/// # Panics
/// It is not there.
pub fn shared(name: &str) -> PathBuf {
    let root = std::env::var_os("HANDCAST_SHARED")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared")), PathBuf::from);
    let path = root.join(name);
    assert!(
        path.exists(),
        "{} is not there: HANDCAST_SHARED names the folder of shared material, by default ../shared",
        path.display()
    );
    path
}
