//! Folders for results that the command line does not name.

use std::ffi::OsStr;
use std::path::{Component, Path, PathBuf};

use clap::ArgMatches;

/// What a folder named after a clip ends with.
const ENDING: &str = "-handcast";
/// The folder of `demo`.
pub const DEMO: &str = "handcast-demo";

/// The folder that `run` or `demo` writes into where the command line, whose subcommand's arguments these are, names none; `None` of
/// all other commands.
pub fn folder(name: &str, arguments: &ArgMatches) -> Option<PathBuf> {
    if !["run", "demo"].contains(&name) || arguments.contains_id("output") {
        return None;
    }
    if name == "demo" {
        Some(DEMO.into())
    } else {
        arguments.get_one("clip").map(|clip: &PathBuf| folder_of(clip))
    }
}

/// Says where results go that no folder was named for.
///
/// # Errors
/// The folder has the results of another clip.
pub fn tell(matches: &ArgMatches) -> anyhow::Result<()> {
    let Some((name, arguments)) = matches.subcommand() else { return Ok(()) };
    let Some(folder) = folder(name, arguments) else { return Ok(()) };
    if name == "run"
        && let Some(clip) = arguments.get_one::<PathBuf>("clip")
        && let Some(other) = reported(&folder).filter(|other| *other != clip.display().to_string())
    {
        refuse!("{} has the results of {other}: name a folder with -o", folder.display());
    }
    if !arguments.get_flag("quiet") {
        errln!("handcast: {name} writes into the folder {}; -o DIR names another one", folder.display());
    }
    Ok(())
}

/// The clip whose results are in a folder.
fn reported(folder: &Path) -> Option<String> {
    let report = std::fs::read(folder.join("report.json")).ok()?;
    let report: serde_json::Value = serde_json::from_slice(&report).ok()?;
    report["clip"].as_str().map(str::to_owned)
}

/// The folder for the results of a clip: in the current folder, named after it, or after the last folder on the way of a pattern.
pub fn folder_of(clip: &Path) -> PathBuf {
    let told = |part: &OsStr| !part.to_string_lossy().contains(['*', '?', '[']) && part != "-";
    let last = clip.components().rev().find_map(|part| match part {
        Component::Normal(part) if told(part) => Some(part),
        _ => None,
    });
    let name = match last {
        Some(file) if clip.file_name() == Some(file) && !clip.is_dir() => Path::new(file).file_stem(),
        folder => folder,
    };
    let mut folder = name.unwrap_or(OsStr::new("clip")).to_owned();
    folder.push(ENDING);
    folder.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_named_after_clips() {
        for (clip, folder) in [
            ("clip.mp4", "clip-handcast"),
            ("a/b.c/clip.of.me.avi", "clip.of.me-handcast"),
            ("pictures/", "pictures-handcast"),
            ("a.b/*.png", "a.b-handcast"),
            ("*.png", "clip-handcast"),
            ("-", "clip-handcast"),
            ("..", "clip-handcast"),
        ] {
            assert_eq!(folder_of(Path::new(clip)), Path::new(folder), "{clip}");
        }
    }

    #[test]
    fn only_run_and_demo_without_a_folder_get_one() {
        let of = |line: &str| {
            let matches = crate::cli::command().try_get_matches_from(line.split(' ')).unwrap();
            let (name, arguments) = matches.subcommand().unwrap();
            folder(name, arguments).map(|folder| folder.display().to_string())
        };
        assert_eq!(of("handcast run a/clip.mp4").unwrap(), "clip-handcast");
        assert_eq!(of("handcast --max-nodes 9 run -q -- -x.avi").unwrap(), "-x-handcast");
        assert_eq!(of("handcast demo").unwrap(), DEMO);
        assert_eq!(of("handcast run clip.mp4 -o out"), None);
        assert_eq!(of("handcast demo --output=out"), None);
        assert_eq!(of("handcast track run -o a.jsonl"), None);
    }
}
