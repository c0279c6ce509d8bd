//! Where package managers put the networks.

use std::cmp::Reverse;
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
        for library in ["lib/node_modules", "node_modules"] {
            places.push(prefix.join(library).join("@mediapipe/hands"));
        }
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
    let named = |variable: &str| env::var_os(variable).filter(|value| !value.is_empty()).map(PathBuf::from);
    prefixes.extend(named("APPDATA").map(|folder| folder.join("npm")));
    let programs = named("LOCALAPPDATA").map(|folder| children(&folder.join("Programs/Python")));
    prefixes.extend(programs.into_iter().flatten());
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
    found.sort_by_cached_key(|path| Reverse(in_numbers(&path.to_string_lossy())));
    found
}

/// A name as text and the numbers behind it, by which `3.12` is more than `3.9`.
fn in_numbers(name: &str) -> Vec<(String, u64)> {
    let is_digit = |c: char| c.is_ascii_digit();
    let mut parts = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let (text, behind) = rest.split_at(rest.find(is_digit).unwrap_or(rest.len()));
        let (digits, behind) = behind.split_at(behind.find(|c| !is_digit(c)).unwrap_or(behind.len()));
        // Without digits 0, and with more than any version has the most there is.
        let number = if digits.is_empty() { 0 } else { digits.parse().unwrap_or(u64::MAX) };
        parts.push((text.to_owned(), number));
        rest = behind;
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn higher_versions_come_first() {
        let dir = tempfile::tempdir().unwrap();
        let names = ["python3.12", "python3.9", "python3", "Python39", "v8.1.0", "v20.11.1"];
        for name in names {
            std::fs::create_dir_all(dir.path().join("lib").join(name)).unwrap();
        }
        let found = children(&dir.path().join("lib"));
        let found: Vec<_> = found.iter().map(|path| path.file_name().unwrap().to_str().unwrap()).collect();
        assert_eq!(found, ["v20.11.1", "v8.1.0", "python3.12", "python3.9", "python3", "Python39"]);
        let packages = packages(dir.path());
        let place =
            |version: &str| packages.iter().position(|p| p.ends_with(format!("{version}/site-packages")));
        assert!(place("python3.12").unwrap() < place("python3.9").unwrap());
        assert!(in_numbers("Python312") > in_numbers("Python39"));
        assert!(in_numbers("99999999999999999999999") > in_numbers("9"));
    }
}
