//! Folders for results that the command line does not name.

use std::ffi::{OsStr, OsString};
use std::path::{Component, Path, PathBuf};

use clap::ArgMatches;
use clap::parser::ValueSource;

/// What a folder named after a clip ends with.
const ENDING: &str = "-handcast";

/// Whether the folder for the results is one that the command line does not name.
fn is_unnamed(matches: &ArgMatches) -> bool {
    matches.value_source("output") == Some(ValueSource::DefaultValue)
}

/// The command line with the folder that `run` writes to where it names none, which is called after the clip.
pub fn with_results(line: &[OsString], matches: &ArgMatches) -> Option<Vec<OsString>> {
    let ("run", run) = matches.subcommand()? else { return None };
    let clip = run.get_one::<PathBuf>("clip").filter(|_| is_unnamed(run))?;
    let at = line.iter().skip(1).position(|word| word == "run")? + 2;
    let mut named = line.to_vec();
    let mut word = OsString::from("--output=");
    word.push(results_of(clip));
    named.insert(at, word);
    Some(named)
}

/// Says where results go that no folder was named for.
///
/// # Errors
/// The folder has the results of another clip.
pub fn tell(before: &ArgMatches, matches: &ArgMatches) -> anyhow::Result<()> {
    let (Some((_, unnamed)), Some((name @ ("run" | "demo"), sub))) =
        (before.subcommand(), matches.subcommand())
    else {
        return Ok(());
    };
    let Some(folder) = sub.get_one::<PathBuf>("output").filter(|_| is_unnamed(unnamed)) else {
        return Ok(());
    };
    if name == "run"
        && let Some(clip) = sub.get_one::<PathBuf>("clip")
        && let Some(other) = reported(folder).filter(|other| *other != clip.display().to_string())
    {
        refuse!("{} has the results of {other}: name a folder with -o", folder.display());
    }
    if !sub.get_flag("quiet") {
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
fn results_of(clip: &Path) -> OsString {
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
    folder
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
            assert_eq!(results_of(Path::new(clip)), folder, "{clip}");
        }
    }

    #[test]
    fn only_a_run_without_a_folder_gets_one() {
        let with = |line: &str| {
            let words: Vec<OsString> = line.split(' ').map(OsString::from).collect();
            let matches = crate::cli::command().try_get_matches_from(&words).unwrap();
            with_results(&words, &matches).map(|words| words.join(OsStr::new(" ")))
        };
        assert_eq!(
            with("handcast run a/clip.mp4").unwrap(),
            "handcast run --output=clip-handcast a/clip.mp4"
        );
        assert_eq!(
            with("handcast --max-nodes 9 run -q -- -x.avi").unwrap(),
            "handcast --max-nodes 9 run --output=-x-handcast -q -- -x.avi"
        );
        assert_eq!(with("handcast run clip.mp4 -o out"), None);
        assert_eq!(with("handcast demo"), None);
        assert_eq!(with("handcast track run -o a.jsonl"), None);
    }
}
