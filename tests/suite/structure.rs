//! The walls between the crates, the length of functions, and what those who need little must not compile.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

/// What each crate may use of the others: only crates above it, so arrows go one way.
const USES: [(&str, &[&str]); 20] = [
    ("limits", &[]),
    ("iso", &[]),
    ("fba", &[]),
    ("hand", &[]),
    ("js", &[]),
    ("picture", &[]),
    ("codec", &["fba", "hand", "limits"]),
    ("gltf", &["hand", "limits"]),
    ("formats", &["codec", "fba", "gltf", "hand", "iso", "limits"]),
    ("media", &["iso", "limits", "picture"]),
    ("vision", &["picture"]),
    ("net", &["vision"]),
    ("vmc", &["hand"]),
    ("track", &["hand", "limits", "media", "picture", "vision"]),
    ("render", &["hand", "picture", "track", "vision"]),
    ("view", &["hand", "js", "limits", "media", "picture"]),
    ("live", &["codec", "fba", "hand", "js"]),
    ("web", &["codec", "fba", "hand", "live", "media", "track"]),
    ("corpus", &["codec", "fba", "formats", "hand", "limits", "media", "track", "view"]),
    ("eval", &["codec", "fba", "formats", "gltf", "hand", "media", "render", "track", "view", "vision"]),
];

/// What is not part of the workspace, because few need what it brings.
const APART: [&str; 2] = ["moq", "python"];

/// Crates that the library may bring along without the command.
const MOST_CRATES: usize = 61;

/// Names that the root of the facade may have.
const MOST_NAMES: usize = 60;

/// Lines that a function may have.
const MOST_LINES: usize = 80;

fn cargo(args: &[&str]) -> String {
    let program = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let out = Command::new(program)
        .args(args)
        .args(["--locked", "--offline"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    assert!(out.status.success(), "cargo {args:?}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

/// The crates of ours that a package names as dependencies of a kind.
fn named(package: &Value, dev: bool) -> BTreeSet<String> {
    let all = package["dependencies"].as_array().unwrap().iter();
    let of_kind = all.filter(|d| (d["kind"] == "dev") == dev);
    let ours = of_kind.filter_map(|d| d["name"].as_str()).filter(|name| name.starts_with("handcast"));
    ours.map(short).collect()
}

/// A crate of ours without what all of them begin with, as they call each other.
fn short(name: &str) -> String {
    name.strip_prefix("handcast-").unwrap_or(name).to_owned()
}

fn set(names: &[&str]) -> BTreeSet<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

#[test]
fn arrows_between_crates_go_one_way() {
    let facts: Value =
        serde_json::from_str(&cargo(&["metadata", "--no-deps", "--format-version", "1"])).unwrap();
    let packages: BTreeMap<&str, &Value> =
        facts["packages"].as_array().unwrap().iter().map(|p| (p["name"].as_str().unwrap(), p)).collect();
    let folders = std::fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("crates")).unwrap();
    let mut folders: BTreeSet<String> =
        folders.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    assert!(APART.iter().all(|apart| folders.remove(*apart)));
    assert_eq!(folders, USES.iter().map(|(name, _)| (*name).to_owned()).collect());
    assert_eq!(packages.len(), 1 + USES.len(), "the crates, and the root above them: {packages:?}");

    let mut above = BTreeSet::new();
    for (name, allowed) in USES {
        let allowed = set(allowed);
        assert!(allowed.is_subset(&above), "{name} may use only crates above it: {allowed:?}");
        above.insert(name.to_owned());
        let package = packages[format!("handcast-{name}").as_str()];
        let used = &named(package, false) | &named(package, true);
        assert_eq!(used, allowed, "what {name} and its tests use, and what they may use");
    }
    let root = packages["handcast"];
    assert!(named(root, false).is_subset(&above) && named(root, true).is_empty());
}

/// The crates that a line of text names in backticks.
fn ticked(line: &str) -> BTreeSet<String> {
    line.split('`').skip(1).step_by(2).map(short).collect()
}

#[test]
fn what_crates_use_is_told_as_it_is() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut uses = BTreeMap::new();
    for place in ["".to_owned()].into_iter().chain(APART.map(|apart| format!("crates/{apart}/"))) {
        let manifest = format!("{place}Cargo.toml");
        let facts = cargo(&["metadata", "--no-deps", "--format-version", "1", "--manifest-path", &manifest]);
        let facts: Value = serde_json::from_str(&facts).unwrap();
        let packages = facts["packages"].as_array().unwrap();
        uses.extend(packages.iter().map(|p| (short(p["name"].as_str().unwrap()), named(p, false))));
    }
    let map = std::fs::read_to_string(root.join("ARCHITECTURE.md")).unwrap();
    for (name, used) in uses.iter().filter(|(name, _)| *name != "handcast") {
        let row = map.lines().find(|line| line.starts_with(&format!("| [`{name}`](crates/{name}) |")));
        let cell = row.and_then(|row| row.rsplit('|').nth(1)).unwrap_or_default();
        assert_eq!(ticked(cell), *used, "what {name} uses, in ARCHITECTURE.md and in fact");
        // That of `js` is the npm package's.
        if name == "js" {
            continue;
        }
        let readme = std::fs::read_to_string(root.join(format!("crates/{name}/README.md"))).unwrap();
        let told = |begin: &str| {
            ticked(readme.lines().find_map(|line| line.strip_prefix(begin)).unwrap_or_default())
        };
        let by: BTreeSet<String> =
            uses.iter().filter(|(_, used)| used.contains(name)).map(|(by, _)| by.clone()).collect();
        assert_eq!(told("* Uses: "), *used, "what {name} uses, in its README and in fact");
        assert_eq!(told("* Used by: "), by, "what uses {name}, in its README and in fact");
    }
}

/// Crates that a package and its features bring along, itself included, by name and version.
fn tree(args: &[&str]) -> BTreeSet<String> {
    let tree = cargo(&[&["tree", "-e", "normal", "--prefix", "none"], args].concat());
    let crates = tree.lines().filter_map(|line| {
        let mut words = line.split_whitespace();
        Some(format!("{} {}", words.next()?, words.next()?))
    });
    crates.collect()
}

#[test]
fn the_codec_brings_no_command_no_pictures_and_no_c() {
    let found = tree(&["-p", "handcast-codec"]);
    let has = |name: &str| found.iter().any(|c| c.split(' ').next() == Some(name));
    assert!(has("handcast-codec") && has("handcast-fba") && has("handcast-hand"), "{found:?}");
    for name in ["clap", "image", "zstd", "zstd-sys"] {
        assert!(!has(name), "{name} in {found:?}");
    }
}

#[test]
fn the_library_without_the_command_is_small() {
    let found = tree(&["-p", "handcast", "--no-default-features"]);
    assert!(found.contains(concat!("handcast v", env!("CARGO_PKG_VERSION"))), "{found:?}");
    assert!(found.len() <= MOST_CRATES, "{} crates, at most {MOST_CRATES}: {found:?}", found.len());
}

/// Names that a source file re-exports: those of its `pub use`, braces opened.
fn exported(source: &str) -> Vec<&str> {
    let uses = source.split("pub use ").skip(1).map(|rest| rest.split(';').next().unwrap_or(rest));
    let names = uses.flat_map(|path| match path.split_once('{') {
        Some((_, names)) => names.trim_end_matches('}').split(',').collect::<Vec<_>>(),
        None => vec![path],
    });
    names.map(str::trim).filter(|name| !name.is_empty()).collect()
}

#[test]
fn the_front_door_has_few_names() {
    let source =
        "mod a;\npub use a::B;\npub use a::{\n    C, D,\n    E,\n};\nuse a::F;\npub use handcast_a as a;\n";
    assert_eq!(exported(source), ["a::B", "C", "D", "E", "handcast_a as a"]);
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/lib.rs");
    let source = std::fs::read_to_string(root).unwrap();
    let defined = source.lines().filter(|line| line.starts_with("pub ") && !line.starts_with("pub use"));
    assert_eq!(defined.count(), 0, "what the root shows is defined in its modules and crates");
    let names = exported(&source);
    assert!(
        (30..=MOST_NAMES).contains(&names.len()),
        "{} names, at most {MOST_NAMES}: {names:?}",
        names.len()
    );
}

/// Name of the function that a line of formatted source begins.
fn function(line: &str) -> Option<&str> {
    let mut words = line.split_whitespace();
    let before = ["const", "async", "unsafe", "extern", "\"C\"", "default"];
    let first = words.find(|word| !before.contains(word) && *word != "pub" && !word.starts_with("pub("))?;
    let name = (first == "fn").then(|| words.next())??;
    name.split(|c: char| !c.is_alphanumeric() && c != '_').next()
}

/// Functions of formatted source: name, first line from 1, number of lines from `fn` to the closing brace.
fn functions(source: &str) -> Vec<(&str, usize, usize)> {
    let lines: Vec<&str> = source.lines().collect();
    let mut found = Vec::new();
    for (first, line) in lines.iter().enumerate() {
        let Some(name) = function(line) else { continue };
        let indent = &line[..line.len() - line.trim_start().len()];
        let opens = lines[first..].iter().position(|l| l.ends_with(['{', '}', ';']));
        let Some(opens) = opens.map(|n| first + n).filter(|&n| lines[n].ends_with('{')) else { continue };
        let closes = lines[opens + 1..].iter().position(|l| l.strip_prefix(indent) == Some("}"));
        let last = opens + 1 + closes.unwrap_or_else(|| panic!("{name} in line {} has no end", first + 1));
        found.push((name, first + 1, last - first + 1));
    }
    found
}

#[test]
fn functions_are_counted_from_fn_to_brace() {
    let source = "\
pub(crate) const fn one() -> u8 { 1 }
trait T {
    fn declared(
        &self,
    );
    async fn two(
        a: u8,
    ) -> u8
    where
        u8: Copy,
    {
        if a > 1 {
        }
        fn inner() {
        }
    }
}
let fnord = 1;
// fn comment() {
";
    assert_eq!(functions(source), [("two", 6, 11), ("inner", 14, 2)]);
}

/// All Rust files of the workspace and of the fuzz targets.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let passed = path.file_name().is_some_and(|n| n == "target" || n == "node_modules");
        if path.is_dir() && !passed {
            sources(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

#[test]
fn no_function_is_longer_than_eighty_lines() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = Vec::new();
    for folder in ["src", "crates", "tests", "benches", "fuzz"] {
        sources(&root.join(folder), &mut files);
    }
    let (mut count, mut long) = (0, Vec::new());
    for file in &files {
        let source = std::fs::read_to_string(file).unwrap();
        for (name, line, length) in functions(&source) {
            count += 1;
            if length > MOST_LINES {
                let file = file.strip_prefix(root).unwrap().display();
                long.push(format!("{file}:{line}: {name} has {length} lines"));
            }
        }
    }
    assert!(files.len() > 150 && count > 2000, "{count} functions in {} files", files.len());
    long.sort();
    assert!(long.is_empty(), "at most {MOST_LINES} lines:\n{}", long.join("\n"));
}
