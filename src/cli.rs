//! Arguments, progress and exit codes; one file per subcommand.
//!
//! Exit codes: 0 success, 1 the work failed, 2 the command line was wrong (clap's own code, and `usage`).

#[macro_use]
mod out;
#[macro_use]
mod usage;

#[cfg(feature = "bench")]
mod bench;
mod beside;
mod common;
mod compare;
mod corpus;
mod decode;
mod demo_clip;
mod encode;
mod ending;
mod fidelity;
mod files;
mod first;
mod fit;
mod given;
mod glb_out;
mod help;
mod import;
mod inspect;
mod length;
mod live;
mod loss;
mod manual;
mod motion;
mod net;
mod overlay;
mod part;
mod pose;
mod poses_out;
mod receivers;
mod render;
mod resume;
mod run;
mod send;
mod spell;
mod summary;
mod synth;
mod track;
mod tracking;
mod unnamed;
mod view;

use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{ArgMatches, CommandFactory as _, FromArgMatches as _, Parser, Subcommand};
use handcast_codec::StreamToPosesError;
use handcast_eval::fidelity::FidelityError;
use handcast_fba::{ErrorKind, SyntaxError};
use handcast_formats::motion::{ContentError, MotionError};
use handcast_media::FrameError;
use handcast_track::pipeline::ClipError;

/// MPEG-4 hand animation: a gesture made here moves a hand there.
#[derive(Debug, Parser)]
#[command(name = "handcast", version, propagate_version = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    limits: common::LimitArgs,
}

#[derive(Debug, Subcommand)]
enum Command {
    // The whole way.
    Demo(run::DemoArgs),
    Run(run::Args),
    Live(Box<live::Args>),
    // To poses.
    Track(track::Args),
    Fit(fit::Args),
    Import(import::Args),
    Net(net::Args),
    // Streams.
    Encode(encode::Args),
    Decode(decode::Args),
    Inspect(inspect::Args),
    Compare(compare::Args),
    // What moves, shown.
    View(view::Args),
    Render(render::Args),
    Send(send::Args),
    // Made-up hands.
    Pose(pose::Args),
    Spell(spell::Args),
    Synth(synth::Args),
    // Many clips, and measurements.
    Corpus(Box<corpus::Args>),
    Fidelity(fidelity::Args),
    #[cfg(feature = "bench")]
    Bench(bench::Args),
    Completions(manual::CompletionsArgs),
    Man(manual::ManArgs),
}

/// The command line. Of `import` the old name `--axes` is that of the points that are read, not of a .glb; single poses may be
/// written as pictures.
fn command() -> clap::Command {
    let pictures = |command: clap::Command| {
        command.mut_arg(poses_out::TO, |to| to.value_parser(poses_out::Output::parser(true)))
    };
    let unless = |default: &'static str| {
        move |of: clap::Command| {
            let words = format!("Folder for the results [default: {default}]");
            of.mut_arg("output", |output| output.help(words))
        }
    };
    help::with_examples(with_negative_numbers(Cli::command()))
        .mut_subcommand("run", unless("the clip's name with -handcast, in the current folder"))
        .mut_subcommand("demo", unless(unnamed::DEMO))
        .mut_subcommand("import", |import| {
            import.mut_arg(glb_out::AXES, |axes| axes.alias(clap::builder::Resettable::Reset)).mut_arg("map", |map| {
                map.requires(clap::builder::Resettable::Reset).help(
                    "Which joint is which where names do not tell: of --mesh, or without one of a .glb or .gltf that is read (.toml)",
                )
            })
        })
        .mut_subcommand("pose", pictures)
        .mut_subcommand("spell", pictures)
}

/// The command where a number below what is allowed is told as such, not taken for an option.
fn with_negative_numbers(command: clap::Command) -> clap::Command {
    command.mut_subcommands(|sub| with_negative_numbers(sub.allow_negative_numbers(true)))
}

/// The arguments of the command line. What is wrong with them ends the program, as what only asks for help does.
fn matches() -> ArgMatches {
    let line: Vec<OsString> = std::env::args_os().collect();
    let matches = command().try_get_matches_from(&line);
    matches.unwrap_or_else(|error| first::advised(error, &line, &command()).exit())
}

/// Runs the command line and returns the exit code.
pub fn main() -> ExitCode {
    let matches = matches();
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    cli.limits.set();
    given::keep(&matches);
    let done = ending::without_traces(|| {
        ending::on_signals()?;
        unnamed::tell(&matches)
            .and_then(|()| files::keep_inputs(&matches))
            .and_then(|()| files::check_outputs(&matches))
            .and_then(|()| run(cli.command))
    });
    match done {
        Ok(code) => code,
        Err(error) => {
            let words = shortened(message(&error));
            let hints = [hint(&error).to_owned(), told_hint(&words), input_hint(&error, &words, &matches)];
            errln!("handcast: {words}{}", hints.concat());
            poses_out::tell_of_journal();
            ExitCode::from(if usage::is_usage(&error) { 2 } else { 1 })
        }
    }
}

fn run(command: Command) -> anyhow::Result<ExitCode> {
    match command {
        Command::Demo(args) => run::demo(args),
        Command::Run(args) => run::run(args),
        Command::Live(args) => live::run(&args),
        Command::Track(args) => track::run(&args),
        Command::Fit(args) => fit::run(&args),
        Command::Import(args) => import::run(&args),
        Command::Net(args) => net::run(&args),
        Command::Encode(args) => encode::run(&args),
        Command::Decode(args) => decode::run(&args),
        Command::Inspect(args) => inspect::run(&args),
        Command::Compare(args) => return compare::run(&args),
        Command::View(args) => view::run(&args),
        Command::Render(args) => render::run(&args),
        Command::Send(args) => send::run(&args),
        Command::Pose(args) => pose::run(&args),
        Command::Spell(args) => spell::run(&args),
        Command::Synth(args) => synth::run(&args),
        Command::Corpus(args) => corpus::run(&args),
        Command::Fidelity(args) => fidelity::run(&args),
        #[cfg(feature = "bench")]
        Command::Bench(args) => bench::run(&args),
        Command::Completions(args) => manual::completions(&args),
        Command::Man(args) => manual::man(&args),
    }
    .map(|()| ExitCode::SUCCESS)
}

/// What the command line offers against an error, to follow it; the library does not know the arguments.
fn hint(error: &anyhow::Error) -> &'static str {
    let never_open = |cause: &(dyn std::error::Error + 'static)| {
        let clip = match cause.downcast_ref() {
            Some(FidelityError::Clip(clip)) => Some(clip),
            _ => cause.downcast_ref::<ClipError>(),
        };
        matches!(clip, Some(ClipError::NeverOpen { .. }))
    };
    let no_networks = |cause: &(dyn std::error::Error + 'static)| {
        matches!(cause.downcast_ref(), Some(handcast_net::Error::NotInstalled))
    };
    let clips = |cause: &(dyn std::error::Error + 'static)| {
        matches!(cause.downcast_ref(), Some(FrameError::Clips { .. }))
    };
    if error.chain().any(clips) {
        "; `handcast corpus` takes a folder of clips"
    } else if error.chain().any(never_open) {
        "; sizes are given with --person FILE, made by `handcast fit`"
    } else if error.chain().any(no_networks) {
        "; they are given with --net FILE, and brought by `pip download --no-deps --only-binary=:all: \
         --python-version 3.11 --platform manylinux_2_28_x86_64 mediapipe==0.10.21`"
    } else {
        ""
    }
}

/// The same against what an input is: a clip where a motion is read, a stream that was cut or damaged.
fn input_hint(error: &anyhow::Error, message: &str, matches: &ArgMatches) -> String {
    let Some((name, of_sub)) = matches.subcommand() else { return String::new() };
    let damaged = |cause: &(dyn std::error::Error + 'static)| -> bool {
        let decoded = match cause.downcast_ref() {
            Some(MotionError::Content { reason: ContentError::Stream(error), .. }) => Some(error),
            _ => cause.downcast_ref(),
        };
        let syntax = match decoded {
            Some(StreamToPosesError::Syntax(error)) => Some(error),
            _ => cause.downcast_ref(),
        };
        syntax.is_some_and(|error: &SyntaxError| {
            let broken = [ErrorKind::Incomplete, ErrorKind::Damaged].contains(&error.kind());
            broken && !matches!(error, SyntaxError::NoObject { .. })
        })
    };
    // What inspect tells goes on behind damage as it is.
    if name != "inspect" && error.chain().any(damaged) {
        // Matches know of options that were not given in debug builds alone.
        let command = command();
        let mut options = command.find_subcommand(name).into_iter().flat_map(clap::Command::get_arguments);
        return match options.any(|option| option.get_id() == "conceal") {
            true => "; --conceal goes on behind damage".to_owned(),
            false => "; `handcast decode --conceal` makes poses of what is whole".to_owned(),
        };
    }
    let of_motions = ["import", "encode", "decode", "inspect", "compare", "view", "render", "send"];
    if !of_motions.contains(&name) || usage::is_usage(error) || message.contains("`handcast track`") {
        return String::new();
    }
    let clip = ["input", "a", "b"].into_iter().any(|id| {
        let path = of_sub.try_get_one::<PathBuf>(id).ok().flatten();
        path.is_some_and(|path| {
            message.contains(&path.display().to_string()) && handcast_media::is_clip(path)
        })
    });
    if clip {
        "; of clips and folders of pictures `handcast track` makes poses".to_owned()
    } else {
        String::new()
    }
}

/// The same against what the message tells: a limit that may be raised, joints whose names tell nothing.
fn told_hint(message: &str) -> String {
    use handcast_limits::Limit;
    if message.contains("; a joint map says which is which") {
        return "; `import`, `encode` and --mesh take one with --map FILE.toml".to_owned();
    }
    if message.contains("when scaled alike") {
        return "; a mask is as wide and as high as its frame, in pixels".to_owned();
    }
    if message.contains(" m long, and its numbers look like ") {
        return "; `handcast import --hand-length-mm 190` brings a file of any unit to a hand of that length"
            .to_owned();
    }
    if message.contains("encode: frame rate ") {
        let (file, fps) = if message.contains("at most 255") { ("fewer", 60) } else { ("more", 1) };
        return format!("; `handcast import POSES -o {file}.jsonl --fps {fps}` makes {file} frames of it");
    }
    let told = |limit: &Limit| message.contains(&format!(" {}, allowed at most ", limit.unit()));
    let flag = match Limit::ALL.into_iter().find(told) {
        Some(Limit::Bytes | Limit::PipedBytes) => "--max-bytes",
        Some(Limit::Instants | Limit::Frames) => "--max-instants",
        Some(Limit::Seconds) => "--max-seconds",
        Some(Limit::Nodes) => "--max-nodes",
        _ => return String::new(),
    };
    format!("; {flag} raises that")
}

/// Longest message, characters: inputs are echoed in many, and may be of any length.
const LONGEST: usize = 1000;

/// A message on one line, cut in the middle if it is long. What steers a terminal, as a stranger's names may, is shown
/// escaped.
fn shortened(mut message: String) -> String {
    if message.contains('\n') {
        let lines: Vec<&str> = message.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
        message = lines.join(" ");
    }
    if message.contains(char::is_control) {
        let shown = |c: char| if c.is_control() { c.escape_default().collect() } else { String::from(c) };
        message = message.chars().map(shown).collect();
    }
    let count = message.chars().count();
    if count <= LONGEST {
        return message;
    }
    let start: String = message.chars().take(LONGEST * 2 / 3).collect();
    let end: String = message.chars().skip(count - LONGEST / 4).collect();
    format!("{start} … {end}")
}

/// An error and its causes. Many errors end with the words of their cause, or begin with the name of the file that
/// was told already, which is not to be said twice.
fn message(error: &anyhow::Error) -> String {
    let mut parts: Vec<String> = Vec::new();
    for cause in error.chain().map(ToString::to_string) {
        match parts.last_mut() {
            Some(last) if last.ends_with(&cause) => {}
            Some(last) if cause.starts_with(&format!("{last}: ")) => *last = cause,
            _ => parts.push(cause),
        }
    }
    parts.join(": ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_are_said_once() {
        let error = anyhow::anyhow!("no such file").context("x.fba: no such file").context("cannot go on");
        assert_eq!(message(&error), "cannot go on: x.fba: no such file");
        let error = anyhow::anyhow!("x.avi: cut").context("x.avi");
        assert_eq!(message(&error), "x.avi: cut");
    }

    #[test]
    fn old_names_of_options_are_taken_and_not_shown() {
        for (line, id, old) in [
            ("decode x.fba -o x.glb --axes webxr", "glb_axes", "--axes "),
            ("import x.json -o x.glb --axes webxr --glb-axes webxr", "input_axes", "--axes "),
            ("encode x.jsonl -o x.mp4 --with-video x.mp4", "clip", "--with-video"),
            ("corpus x -o y --only *.mp4", "only", "--only"),
            ("fidelity x.jsonl --no-mirror", "no_symmetry", "--no-mirror"),
            ("live --fps 25", "input_fps", "--fps"),
            ("render x.fba -o x.png --hand left", "hand", "--hand "),
        ] {
            let matches = command().try_get_matches_from(format!("handcast {line}").split(' ')).unwrap();
            let (name, given) = matches.subcommand().unwrap();
            assert_eq!(given.value_source(id), Some(clap::parser::ValueSource::CommandLine), "{line}");
            let mut command = command();
            let help = command.find_subcommand_mut(name).unwrap().render_long_help().to_string();
            assert!(
                !help.contains(&format!("{old}<")) && !help.contains(&format!("\n      {}\n", old.trim())),
                "{help}"
            );
        }
    }

    #[test]
    fn long_messages_are_cut_in_the_middle() {
        assert_eq!(shortened("short".into()), "short");
        assert_eq!(shortened("a\n b\u{1b}]0;c\u{7}".into()), "a b\\u{1b}]0;c\\u{7}");
        let cut = shortened(format!("person: {}: end", "ä".repeat(500_000)));
        assert!(cut.starts_with("person: ä") && cut.ends_with("ä: end"), "{cut}");
        assert!(cut.chars().count() < LONGEST);
    }

    #[test]
    fn limits_are_told_with_the_flag_that_raises_them() {
        for (limit, flag) in [
            (handcast_limits::Limit::Instants, "; --max-instants raises that"),
            (handcast_limits::Limit::PipedBytes, "; --max-bytes raises that"),
            (handcast_limits::Limit::Side, ""),
        ] {
            let excess = handcast_limits::DEFAULT.check(limit, 1e12).unwrap_err();
            assert_eq!(told_hint(&format!("x: {excess}")), flag);
        }
        assert_eq!(told_hint("no such file"), "");
    }

    #[test]
    fn the_command_line_is_sound() {
        command().debug_assert();
    }
}
