//! Files that a command line names: what it reads is not to be overwritten by what it writes.

use std::path::{Path, PathBuf};

use anyhow::ensure;
use clap::ArgMatches;

/// The arguments, of any subcommand, that name what is written. All other paths are read.
const WRITTEN: [&str; 9] =
    ["output", "overlay", "debug", "save_person", "poses", "masks", "json", "svg", "record"];
/// What `run` and `demo` write into their output folder.
pub const RESULTS: [&str; 8] = [
    "poses.jsonl",
    "person.toml",
    "overlay.avi",
    "hand.fba",
    "hand.glb",
    "preview.png",
    "report.json",
    "report.txt",
];

/// Makes sure that nothing the command line says to write is also read, or written twice.
///
/// # Errors
/// Names the two.
pub fn keep_inputs(matches: &ArgMatches) -> anyhow::Result<()> {
    let (mut name, mut matches) = ("", matches);
    while let Some((sub, of_sub)) = matches.subcommand() {
        (name, matches) = (sub, of_sub);
    }
    let (mut written, mut read) = (Vec::new(), Vec::new());
    for id in matches.ids() {
        // Arguments of other types are no paths.
        let Ok(Some(paths)) = matches.try_get_many::<PathBuf>(id.as_str()) else { continue };
        let list = if WRITTEN.contains(&id.as_str()) { &mut written } else { &mut read };
        list.extend(paths.filter(|path| path.as_os_str() != "-").cloned());
    }
    if ["run", "demo"].contains(&name) {
        let files = written.iter().flat_map(|folder| RESULTS.map(|file| folder.join(file)));
        written = files.collect();
    }
    for (i, output) in written.iter().enumerate() {
        let Some(place) = place(output) else { continue };
        let same = |other: &&PathBuf| self::place(other).is_some_and(|other| other == place);
        if let Some(input) = read.iter().find(same) {
            let (output, input) = (output.display(), input.display());
            anyhow::bail!("{output} would overwrite the input {input}: give the output another name");
        }
        ensure!(!written[..i].iter().any(|o| same(&o)), "{}: two outputs of one name", output.display());
    }
    Ok(())
}

/// Where a file or folder is, or would be; `None` for devices, which nothing is lost in.
fn place(path: &Path) -> Option<PathBuf> {
    match std::fs::metadata(path) {
        Ok(found) if !found.is_file() && !found.is_dir() => None,
        Ok(_) => path.canonicalize().ok(),
        Err(_) => {
            let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
            Some(folder.canonicalize().ok()?.join(path.file_name()?))
        }
    }
}
