//! `handcast completions` and `handcast man`: what shells and `man` know of the command.

use std::fs;
use std::io::Write as _;
use std::path::PathBuf;

use anyhow::Context;
use clap::Args as ClapArgs;
use clap_complete::Shell;
use handcast_formats::atomic::AtomicFile;

use super::help;
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
    let page = page(command, &name)?;
    AtomicFile::write_all_to(folder.join(format!("{name}.1")), &page)?;
    command.get_subcommands().filter(|sub| sub.get_name() != "help").try_for_each(|sub| write(folder, sub))
}

/// The page of one command, in the sections that `man` has for them.
fn page(command: &clap::Command, name: &str) -> std::io::Result<Vec<u8>> {
    let man = clap_mangen::Man::new(command.clone());
    let mut page = Vec::new();
    man.render_title(&mut page)?;
    man.render_name_section(&mut page)?;
    man.render_synopsis_section(&mut page)?;
    man.render_description_section(&mut page)?;
    man.render_options_section(&mut page)?;
    if command.get_subcommands().any(|sub| !sub.is_hide_set()) {
        man.render_subcommands_section(&mut page)?;
    }
    // Pages are called handcast-bench-codec.
    let path = name.strip_prefix("handcast-").unwrap_or(name).replace('-', " ");
    writeln!(page, ".SH \"EXIT STATUS\"\n{}", escaped(help::exit_codes(&path)))?;
    // Lines stay lines.
    writeln!(page, ".SH EXAMPLES\n.nf")?;
    for line in help::examples(&path) {
        writeln!(page, "{}", escaped(line))?;
    }
    writeln!(page, ".fi")?;
    man.render_version_section(&mut page)?;
    Ok(page)
}

/// Text as it stands in a page: what `man` would take for its own is not taken so.
fn escaped(text: &str) -> String {
    let text = text.replace('\\', "\\e").replace('-', "\\-").replace('~', "\\(ti");
    if text.starts_with(['.', '\'']) { format!("\\&{text}") } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_have_examples_line_by_line() {
        let mut command = crate::cli::command();
        command.build();
        let sub = command.find_subcommand("inspect").unwrap();
        let page = String::from_utf8(page(sub, "handcast-inspect").unwrap()).unwrap();
        let [status, examples, version] = [
            ".SH \"EXIT STATUS\"\n0 done, 1 failed, 2 wrong usage, 130 ended by a signal\n",
            "\n.SH EXAMPLES\n.nf\nhandcast inspect hand.fba\n",
            ".SH VERSION",
        ]
        .map(|words| page.find(words).unwrap_or_else(|| panic!("{words}: {page}")));
        assert!(status < examples && examples < version);
        assert!(page.contains("\nhandcast inspect hand.fba \\-\\-json\n.fi\n"), "{page}");
        assert_eq!(escaped(".a\\b"), "\\&.a\\eb");
    }
}
