//! Files that a command line names: what it reads is not to be overwritten by what it writes.

use std::fs::{File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use clap::ArgMatches;
use handcast_corpus::RUN_RESULTS;
use handcast_formats::atomic::AtomicFile;

use super::unnamed;

/// The arguments, of any subcommand, that name what is written. All other paths are read.
const WRITTEN: [&str; 10] =
    ["output", "overlay", "debug", "save_person", "poses", "masks", "json", "svg", "record", "labels"];

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
    let mut streamed = 0;
    for id in matches.ids() {
        // Arguments of other types are no paths.
        let Ok(Some(paths)) = matches.try_get_many::<PathBuf>(id.as_str()) else { continue };
        let writes = WRITTEN.contains(&id.as_str());
        let list = if writes { &mut written } else { &mut read };
        let (standard, named): (Vec<_>, Vec<_>) = paths.partition(|path| path.as_os_str() == "-");
        list.extend(named.into_iter().cloned());
        streamed += if writes { standard.len() } else { 0 };
    }
    ensure!(streamed < 2, "-: two outputs, and one standard output");
    written.extend(unnamed::folder(name, matches));
    if ["run", "demo"].contains(&name) {
        let files = written.iter().flat_map(|folder| RUN_RESULTS.map(|file| folder.join(file)));
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

/// Arguments that name folders, and a file that is made in them.
const FOLDERS: [(&str, &str); 2] = [("debug", "fit.png"), ("masks", "00000.png")];

/// What a command makes in the folder that its output is; nothing of those that write a file.
fn made_in(name: &str, output: &Path) -> &'static [&'static str] {
    match name {
        "run" | "demo" => &RUN_RESULTS,
        "corpus" => &["manifest.jsonl"],
        "man" => &["handcast.1"],
        "synth" if output.extension().is_none() => &["00000.png"],
        _ => &[],
    }
}

/// Makes sure that what the command line says to write can be written, before the work.
///
/// # Errors
/// Names the file.
pub fn check_outputs(matches: &ArgMatches) -> anyhow::Result<()> {
    let (mut name, mut matches) = ("", matches);
    while let Some((sub, of_sub)) = matches.subcommand() {
        (name, matches) = (sub, of_sub);
    }
    if let Some(folder) = unnamed::folder(name, matches) {
        try_folder(&folder, &RUN_RESULTS)?;
    }
    for id in WRITTEN {
        let Ok(Some(paths)) = matches.try_get_many::<PathBuf>(id) else { continue };
        for path in paths.filter(|path| path.as_os_str() != "-") {
            let inside = match FOLDERS.iter().find(|(folder, _)| *folder == id) {
                Some((_, file)) => std::slice::from_ref(file),
                None if id == "output" => made_in(name, path),
                None => &[],
            };
            if !inside.is_empty() {
                try_folder(path, inside)?;
            } else if !is_passed_on(path) {
                try_file(path)?;
            }
        }
    }
    Ok(())
}

/// Whether what is there is not tried: opening a pipe would wait for its reader, and closing it tell that there is nothing. Of a
/// folder whose name ends like none of the files that are written, the command says what is allowed.
fn is_passed_on(path: &Path) -> bool {
    std::fs::metadata(path)
        .is_ok_and(|found| if found.is_dir() { path.extension().is_none() } else { !found.is_file() })
}

/// Makes sure that a file can be written, and leaves none.
pub fn try_file(path: &Path) -> anyhow::Result<()> {
    AtomicFile::create(path).map(drop).context("cannot write")
}

/// Makes sure that files can be written into a folder, or that it can be made.
fn try_folder(folder: &Path, files: &[&str]) -> anyhow::Result<()> {
    if folder.exists() {
        return files.iter().try_for_each(|file| try_file(&folder.join(file)));
    }
    let is_there = |above: &&Path| above.as_os_str().is_empty() || above.exists();
    match folder.ancestors().zip(folder.ancestors().skip(1)).find(|(_, above)| is_there(above)) {
        // A file of its name can be made where the folder can.
        Some((missing, _)) => try_file(missing),
        None => Ok(()),
    }
}

/// Moves what a run that was ended has left, NAME.partial.KIND, out of the way of one that begins anew, to NAME.partial.old.KIND or
/// the first of NAME.partial.old2.KIND … that is free, and says so; `what` it is. An empty file goes.
///
/// # Errors
/// Another run writes it, or it cannot be moved.
pub fn set_aside(rest: &Path, what: &str) -> anyhow::Result<()> {
    check_free(rest)?;
    if std::fs::metadata(rest).is_ok_and(|found| found.len() == 0) {
        return std::fs::remove_file(rest).with_context(|| format!("cannot remove {}", rest.display()));
    }
    let kind = rest.extension().unwrap_or_default().to_string_lossy();
    let named = |n: usize| {
        let number = if n == 1 { String::new() } else { n.to_string() };
        rest.with_extension(format!("old{number}.{kind}"))
    };
    let mut n = 1;
    while named(n).symlink_metadata().is_ok() {
        n += 1;
    }
    let aside = named(n);
    let (from, to) = (rest.display(), aside.display());
    std::fs::rename(rest, &aside).with_context(|| format!("cannot move {from} to {to}"))?;
    errln!("handcast: {from} had the {what} of a run that was ended; they are now in {to}");
    Ok(())
}

/// A new file, NAME.partial.KIND, that this run writes piece by piece, until it is closed.
///
/// # Errors
/// Another run writes it, or it cannot be written.
pub fn begin_partial(path: &Path) -> anyhow::Result<File> {
    let file = claimed(File::options().write(true).create(true).truncate(false), path)?;
    // Of another run nothing is taken away.
    file.set_len(0).with_context(|| format!("cannot write {}", path.display()))?;
    Ok(file)
}

/// The same file to be gone on with.
///
/// # Errors
/// Those of [`begin_partial`].
pub fn go_on_with_partial(path: &Path) -> anyhow::Result<File> {
    claimed(File::options().append(true), path)
}

/// That no other run writes a file.
pub fn check_free(path: &Path) -> anyhow::Result<()> {
    match claim(File::options().read(true), path) {
        Err(error) if error.kind() == io::ErrorKind::ResourceBusy => bail!(busy(path)),
        // Whether it can be written is seen when it is.
        _ => Ok(()),
    }
}

/// Opens what a run writes piece by piece, for this one.
fn claimed(options: &mut OpenOptions, path: &Path) -> anyhow::Result<File> {
    match claim(options, path) {
        Err(error) if error.kind() == io::ErrorKind::ResourceBusy => bail!(busy(path)),
        opened => opened.with_context(|| format!("cannot write {}", path.display())),
    }
}

fn busy(path: &Path) -> String {
    format!("{}: another run is writing it", path.display())
}

/// Opens a file for this run; [`io::ErrorKind::ResourceBusy`] where another one writes it.
#[cfg(not(windows))]
fn claim(options: &mut OpenOptions, path: &Path) -> io::Result<File> {
    let file = options.open(path)?;
    if handcast_formats::atomic::claim(&file) { Ok(file) } else { Err(io::ErrorKind::ResourceBusy.into()) }
}

/// The same. A lock would keep others from reading, too; so the file is opened in such a way that nobody else may write it.
#[cfg(windows)]
fn claim(options: &mut OpenOptions, path: &Path) -> io::Result<File> {
    use std::os::windows::fs::OpenOptionsExt as _;
    const SHARE_READ: u32 = 1;
    const SHARE_DELETE: u32 = 4;
    const SHARING_VIOLATION: i32 = 32;
    options.share_mode(SHARE_READ | SHARE_DELETE).open(path).map_err(|error| match error.raw_os_error() {
        Some(SHARING_VIOLATION) => io::ErrorKind::ResourceBusy.into(),
        _ => error,
    })
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
