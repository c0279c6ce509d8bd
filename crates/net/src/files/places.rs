//! Where package managers put the networks.

use std::env;
use std::path::{Path, PathBuf};

/// Folders of installed packages that carry the networks, the nearest first: those of the current folder, of the active
/// environment, of the interpreters that would be started, of the user, of the system.
pub(super) fn installed() -> Vec<PathBuf> {
    let mut places = Vec::new();
    if let Ok(folder) = env::current_dir() {
        for folder in folder.ancestors() {
            places.push(folder.join("node_modules/@mediapipe/hands"));
        }
    }
    for prefix in prefixes() {
        for packages in packages(&prefix) {
            places.push(packages.join("mediapipe/modules"));
        }
        places.push(prefix.join("lib/node_modules/@mediapipe/hands"));
    }
    places.retain(|place| place.is_dir());
    let mut seen = std::collections::HashSet::new();
    places.retain(|place| seen.insert(place.clone()));
    places
}

/// Where programs and their packages are installed together.
fn prefixes() -> Vec<PathBuf> {
    let mut prefixes: Vec<PathBuf> =
        ["VIRTUAL_ENV", "CONDA_PREFIX"].into_iter().filter_map(env::var_os).map(PathBuf::from).collect();
    for folder in env::split_paths(&env::var_os("PATH").unwrap_or_default()) {
        for name in ["python3", "python", "node", "python.exe", "node.exe"] {
            let program = folder.join(name);
            if program.is_file() {
                // The link's folder is an environment's, the file's the interpreter's own.
                let real = program.canonicalize().unwrap_or_else(|_| program.clone());
                prefixes.extend([&program, &real].into_iter().filter_map(|p| prefix(p)));
            }
        }
    }
    if let Some(home) = env::home_dir() {
        prefixes.push(home.join(".local"));
        prefixes.extend(children(&home.join(".pyenv/versions")));
        prefixes.extend(children(&home.join("Library/Python")));
        prefixes.extend(children(&home.join("AppData/Roaming/Python")));
        prefixes.extend(children(&home.join(".nvm/versions/node")));
    }
    prefixes.extend(["/usr/local", "/usr", "/opt/homebrew"].map(PathBuf::from));
    prefixes
}

/// `…` of `…/bin/program`, and of `…\program` where programs have no folder of their own.
fn prefix(program: &Path) -> Option<PathBuf> {
    let folder = program.parent()?;
    let own = folder.file_name().is_some_and(|name| name == "bin" || name == "Scripts");
    if own { folder.parent().map(Path::to_owned) } else { Some(folder.to_owned()) }
}

/// Folders of Python packages of one installation.
fn packages(prefix: &Path) -> Vec<PathBuf> {
    let mut found = vec![prefix.join("Lib/site-packages"), prefix.join("site-packages")];
    for library in ["lib", "lib64"] {
        for folder in children(&prefix.join(library)) {
            if folder.file_name().is_some_and(|name| name.to_string_lossy().starts_with("python")) {
                found.push(folder.join("site-packages"));
                found.push(folder.join("dist-packages"));
            }
        }
    }
    found
}

/// What is in a folder, the highest version first.
fn children(folder: &Path) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> =
        std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
    found.sort();
    found.reverse();
    found
}
