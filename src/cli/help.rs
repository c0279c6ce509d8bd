//! Examples and exit codes below the help of each subcommand, and in its page of the manual.

use clap::Command;

/// Examples of the command itself, and of each subcommand by its name.
const EXAMPLES: &[(&str, &str)] = &[
    (
        "handcast",
        "\
handcast demo                         # all of it, on the clip built in
handcast run clip.mp4                 # your own clip
handcast decode hand.fba -o hand.glb  # a stream to an animated hand
handcast help encode                  # what a subcommand takes, with examples",
    ),
    (
        "demo",
        "\
handcast demo
handcast demo -o out
handcast view out/hand.fba --clip out/demo.avi --open",
    ),
    (
        "run",
        "\
handcast run clip.mp4                     # into clip-handcast
handcast run clip.mp4 -o out --view back  # the hand from behind
handcast run pictures/ -o out --mask masks/
ffmpeg -i clip.webm -f yuv4mpegpipe - | handcast run - -o out",
    ),
    (
        "live",
        "\
handcast live                      # the first camera; prints an address
handcast live --list
handcast live --bind 0.0.0.0:8747  # also for others on the same network
handcast live clip.mp4 --loop --record hand.fba",
    ),
    (
        "track",
        "\
handcast track clip.mp4 -o poses.jsonl --overlay seen.mp4
handcast track selfie.mp4 -o poses.jsonl --mirror --smooth
handcast track long.mp4 -o poses.jsonl --from 1:05 --until 1:20
handcast track clip.mp4 -o hand.glb --person person.toml",
    ),
    (
        "fit",
        "\
handcast fit open-hand.jpg -o person.toml --debug stages/
handcast fit clip.mp4 -o person.toml --from 0:12.5
handcast run clip.mp4 -o out --person person.toml",
    ),
    (
        "import",
        "\
handcast import recording.landmarks.jsonl -o poses.jsonl
handcast import results.json -o poses.jsonl --image-size 1280x720
handcast import poses.jsonl -o hand.glb",
    ),
    (
        "net",
        "\
handcast net
handcast net --net mediapipe-0.10.21-*.whl
handcast run clip.mp4 -o out --net mediapipe-0.10.21-*.whl",
    ),
    (
        "encode",
        "\
handcast encode poses.jsonl -o hand.fba --bitrate 1.5
handcast encode hand.bvh -o hand.fba --max-error 3mm
handcast encode poses.jsonl -o hand.mp4 --clip clip.mp4
handcast track clip.mp4 -o - | handcast encode - --live -o hand.fba",
    ),
    (
        "decode",
        "\
handcast decode hand.fba -o hand.glb
handcast decode hand.fba -o wave.vrma  # for any VRM avatar
handcast decode hand.fba -o small.glb --quantize --tolerance 0.2 --names vrm
handcast decode hand.fba -o mine.glb --mesh my-hand.glb",
    ),
    (
        "inspect",
        "\
handcast inspect hand.fba
handcast inspect hand.fba --verbose  # each bit
handcast inspect hand.fba --json",
    ),
    (
        "compare",
        "\
handcast compare poses.jsonl hand.fba
handcast compare poses.jsonl hand.fba --tolerance 1 --quiet && echo alike",
    ),
    (
        "view",
        "\
handcast view hand.fba --open
handcast view hand.fba --clip clip.mp4
handcast view poses.jsonl -o page.html",
    ),
    (
        "render",
        "\
handcast render hand.fba -o sheet.png
handcast render hand.fba -o pose.png --at 1.5 --transparent
handcast render hand.glb -o hand.webp --turntable
handcast render hand.fba -o hand.gif --frames 40",
    ),
    (
        "send",
        "\
handcast send hand.fba --vmc 127.0.0.1
handcast send hand.fba --vmc 192.168.1.20:39539 --loop --speed 0.5",
    ),
    (
        "pose",
        "\
handcast pose --list
handcast pose asl:A -o a.png
handcast pose spread -o hand.glb --quantize",
    ),
    (
        "spell",
        "\
handcast spell HELLO -o hello.glb
handcast spell \"GOOD DAY\" -o day.png  # a sheet of its letters
handcast spell HELLO -o hello.jsonl --labels hello.letters",
    ),
    (
        "synth",
        "\
handcast synth -o clip.avi --motion fist
handcast synth -o signs/ --motion signs --random-hand --seed 7 --masks m/
handcast synth -o two.avi --two-hands --meet",
    ),
    (
        "corpus",
        "\
handcast corpus clips/ -o out --jobs 8
handcast corpus clips/ -o out --match \"*.mp4\" --retry",
    ),
    (
        "fidelity",
        "\
handcast fidelity -o report.html  # of the clip built in
handcast fidelity clip.mp4 -o report.html
handcast fidelity poses.jsonl --loss 5% --intra 1",
    ),
    (
        "bench",
        "\
handcast bench fit
handcast bench sizes recordings/
handcast bench track --scaling",
    ),
    ("bench choices", "handcast bench choices recordings/"),
    (
        "bench codec",
        "\
handcast bench codec recordings/ --svg curve.svg
handcast bench codec recordings/ --bitrate 1.5",
    ),
    ("bench corpus", "handcast bench corpus clips/ --jobs 8"),
    (
        "bench gaps",
        "\
handcast bench gaps counting.jsonl flexions.jsonl
handcast bench gaps poses.jsonl --target-rms 0.45 --seeds 10 --json",
    ),
    ("bench fit", "handcast bench fit --persons 10 --verbose"),
    (
        "bench labels",
        "\
handcast bench labels poses.jsonl --counts clip.counts
handcast bench labels hello.jsonl --letters hello.letters",
    ),
    ("bench live", "handcast bench live --readers 100 --seconds 10"),
    (
        "bench sizes",
        "\
handcast bench sizes
handcast bench sizes recordings/ --target-rms 0.4 --json",
    ),
    (
        "bench track",
        "\
handcast bench track --optimisers simplex,powell --json t.json --svg t.svg
handcast bench track clip.mp4 --no-methods --counts clip.counts
handcast bench track --scaling",
    ),
    ("bench tuning", "handcast bench tuning -o tuning.md"),
    (
        "completions",
        "\
source <(handcast completions bash)  # in ~/.bashrc
handcast completions zsh > ~/.zfunc/_handcast",
    ),
    (
        "man",
        "\
handcast man -o man
man -l man/handcast-run.1",
    ),
];

/// Examples of a subcommand, lines of a shell; none of one that is not known.
pub fn examples(name: &str) -> impl Iterator<Item = &'static str> {
    let found = EXAMPLES.iter().find(|(known, _)| *known == name);
    found.map_or("", |(_, lines)| lines).lines()
}

/// What the exit codes of a subcommand mean.
pub fn exit_codes(name: &str) -> &'static str {
    match name {
        "compare" => {
            "0 they are the same, 1 they are not, or a file cannot be read, 2 wrong usage, 130 ended by a signal"
        }
        _ => "0 done, 1 failed, 2 wrong usage, 130 ended by a signal",
    }
}

/// A command with examples and exit codes below its help and that of all its subcommands.
pub fn with_examples(command: Command) -> Command {
    // Whoever calls the command alone sees its own, too.
    let text = text(&command, command.get_name());
    command.after_help(text).mut_subcommands(|sub| {
        let name = sub.get_name().to_owned();
        dressed(sub, &name).mut_subcommands(|below| {
            let name = format!("{name} {}", below.get_name());
            dressed(below, &name)
        })
    })
}

fn dressed(command: Command, name: &str) -> Command {
    let text = text(&command, name);
    command.after_long_help(text)
}

/// Examples and exit codes as they stand below the help of a subcommand.
fn text(command: &Command, name: &str) -> String {
    use std::fmt::Write as _;
    let header = *command.get_styles().get_header();
    let mut text = format!("{header}Examples:{header:#}\n");
    for line in examples(name) {
        // Writing to memory does not fail.
        let _ = writeln!(text, "  {line}");
    }
    let _ = write!(text, "\n{header}Exit codes:{header:#} {}", exit_codes(name));
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The command lines of `handcast` in a line of a shell.
    fn calls(line: &str) -> Vec<Vec<&str>> {
        let line = line.split("  # ").next().unwrap_or_default().trim();
        let parts = line.split(" | ").flat_map(|part| part.split(" && "));
        // What is behind < and > goes to the shell, and so do quotes.
        let words = parts.map(|part| {
            let own = part.split([' ']).take_while(|word| !["<", ">"].contains(word));
            own.filter(|word| !word.is_empty()).map(|word| word.trim_matches('"')).collect::<Vec<_>>()
        });
        words.filter(|words| words.first() == Some(&"handcast")).collect()
    }

    fn check(command: &Command, name: &str) -> usize {
        let lines: Vec<&str> = examples(name).collect();
        assert!((1..=4).contains(&lines.len()), "{name}");
        assert!(lines.iter().all(|line| line.len() <= 78), "{name}: {lines:?}");
        let own = format!("handcast {name}");
        let shown = name == "handcast" || lines.iter().any(|line| line.contains(&own));
        assert!(shown, "{name} is not in its examples");
        let help = command.clone().render_long_help().to_string();
        assert!(help.contains("Examples:") && help.contains("Exit codes: 0 "), "{name}: {help}");
        for line in lines {
            for mut call in calls(line) {
                // Of the subcommand that clap makes there is nothing to be parsed.
                if call[1] == "help" {
                    continue;
                }
                if let Some(at) = call.iter().position(|word| *word == "GOOD") {
                    // Two words in quotes.
                    call.remove(at);
                }
                let parsed = crate::cli::command().try_get_matches_from(&call);
                assert!(parsed.is_ok(), "{line}: {}", parsed.unwrap_err());
            }
        }
        1
    }

    #[test]
    fn every_subcommand_has_examples_that_it_takes() {
        let command = crate::cli::command();
        let mut count = check(&command, "handcast");
        for sub in command.get_subcommands() {
            let name = sub.get_name();
            count += check(sub, name);
            count += sub
                .get_subcommands()
                .map(|below| check(below, &format!("{name} {}", below.get_name())))
                .sum::<usize>();
        }
        // None is left over, as far as all of the program is built.
        let all = EXAMPLES.iter().filter(|(name, _)| cfg!(feature = "bench") || !name.starts_with("bench"));
        assert_eq!(count, all.count());
    }

    #[test]
    fn short_help_leaves_limits_out_and_options_stand_under_their_headings() {
        let mut command = crate::cli::command();
        command.build();
        for sub in command.get_subcommands_mut().filter(|sub| sub.get_name() != "help") {
            let short = sub.render_help().to_string();
            assert!(!short.contains("--max-bytes") && !short.contains("Limits:"), "{short}");
            assert!(sub.render_long_help().to_string().contains("--max-bytes"), "{}", sub.get_name());
            for arg in sub.get_arguments().filter(|arg| arg.get_long().is_some()) {
                let own = [
                    "output",
                    "quiet",
                    "json",
                    "size",
                    "clip",
                    "vmc",
                    "speed",
                    "no-pictures",
                    "open",
                    "turntable",
                ];
                let long = arg.get_long().unwrap_or_default();
                if own.contains(&long) && !(sub.get_name() == "live" && long == "size") {
                    assert_eq!(arg.get_help_heading(), None, "{} --{long}", sub.get_name());
                }
            }
        }
    }
}
