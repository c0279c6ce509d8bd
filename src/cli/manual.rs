//! `handcast completions` and `handcast man`: what shells and `man` know of the command.

use std::fs;
use std::io::Write as _;
use std::path::PathBuf;

use anyhow::Context;
use clap::Args as ClapArgs;
use clap_complete::Shell;
use handcast_formats::atomic::AtomicFile;

use super::out::Stdout;

/// Prints what completes this command in a shell.
#[derive(Debug, ClapArgs)]
pub struct CompletionsArgs {
    /// The shell.
    #[arg(value_enum)]
    shell: Shell,
}

/// Prints the completions.
pub fn completions(args: &CompletionsArgs) -> anyhow::Result<()> {
    let mut command = super::command();
    let name = command.get_name().to_owned();
    // What makes them breaks down where it cannot write.
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut command, name, &mut text);
    Stdout.write_all(&text).context("standard output")
}

/// Writes the manual: a page of the command and one of each subcommand.
#[derive(Debug, ClapArgs)]
pub struct ManArgs {
    /// Folder for the pages (handcast.1, handcast-run.1 …).
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
}

/// Writes the pages.
pub fn man(args: &ManArgs) -> anyhow::Result<()> {
    fs::create_dir_all(&args.output).with_context(|| args.output.display().to_string())?;
    let mut command = super::command();
    command.build();
    write(&args.output, &command)
}

/// The page of a command and those of its subcommands.
fn write(folder: &std::path::Path, command: &clap::Command) -> anyhow::Result<()> {
    let name = command.get_display_name().unwrap_or_else(|| command.get_name()).to_owned();
    let mut page = Vec::new();
    clap_mangen::Man::new(command.clone()).render(&mut page)?;
    AtomicFile::write_all_to(folder.join(format!("{name}.1")), &page)?;
    command.get_subcommands().filter(|sub| sub.get_name() != "help").try_for_each(|sub| write(folder, sub))
}
