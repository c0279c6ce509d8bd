//! First tries: command lines that are refused, and how what they seem to mean is written.

use std::ffi::OsString;
use std::path::Path;

use clap::Command;
use clap::builder::StyledStr;
use clap::error::{ContextKind, ContextValue, Error, ErrorKind};
use handcast_corpus::CLIP_ENDINGS;
use handcast_formats::motion::Format;

/// The error of a command line, with what to write in its place where that can be told. `command` is the whole command.
pub fn advised(mut error: Error, line: &[OsString], command: &Command) -> Error {
    let words: Vec<String> = line.iter().skip(1).map(|word| word.to_string_lossy().into_owned()).collect();
    let told = |kind: ContextKind| match error.get(kind) {
        Some(ContextValue::String(word)) => Some(word.clone()),
        _ => None,
    };
    let tips = match error.kind() {
        ErrorKind::InvalidSubcommand => {
            told(ContextKind::InvalidSubcommand).map(|word| subcommand(&word, &words))
        }
        ErrorKind::UnknownArgument => told(ContextKind::InvalidArg).map(|word| {
            let called = Called::find(command, &words);
            if word.starts_with('-') { called.option(&word, &words) } else { called.surplus(&word, &words) }
        }),
        _ => None,
    };
    let Some(tips) = tips else { return error };
    if let Some(ContextValue::StyledStrs(mut others)) = error.remove(ContextKind::Suggested) {
        // That a mistyped option might be a value sends people astray.
        others.retain(|tip| !tip.to_string().contains("as a value"));
        if !others.is_empty() {
            error.insert(ContextKind::Suggested, ContextValue::StyledStrs(others));
        }
    }
    if !tips.is_empty() {
        error.remove(ContextKind::SuggestedSubcommand);
        if error.remove(ContextKind::SuggestedArg).is_some() {
            // It has what was suggested.
            error.remove(ContextKind::Usage);
        }
        let tips = tips.into_iter().map(StyledStr::from).collect();
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(tips));
    }
    error
}

/// A word as it is written in a shell.
fn shown(word: &str) -> String {
    if word.contains(|c: char| c.is_whitespace() || c.is_control() || c == '"') {
        format!("{word:?}")
    } else {
        word.to_owned()
    }
}

/// Endings of pictures that stand alone.
const PICTURES: [&str; 4] = ["png", "jpg", "jpeg", "bmp"];

/// What a name in the place of a subcommand seems to mean.
fn subcommand(word: &str, words: &[String]) -> Vec<String> {
    let after = words.iter().skip_while(|other| *other != word).nth(1);
    let next = after.map(String::as_str).filter(|next| !next.starts_with('-'));
    let other = match word {
        "convert" => {
            "import (joint positions, poses), encode (to a stream) or decode (from one) convert files"
        }
        "play" | "show" | "open" => "view shows a motion, render draws it",
        "export" => "decode writes other formats from a stream, import from poses and joint positions",
        "camera" | "serve" | "stream" => "live sends the hands before a camera",
        _ => return file(word, next).into_iter().collect(),
    };
    vec![other.to_owned()]
}

/// What may be done with a file, or what is named like one; `next` follows it on the command line.
fn file(word: &str, next: Option<&str>) -> Option<String> {
    let path = Path::new(word);
    let ending = super::common::ending(path);
    let name = shown(word);
    let motion = |name: &str| Format::by_name(Path::new(name));
    let written = next.filter(|next| motion(next).is_some()).map(shown);
    if path.is_dir() || CLIP_ENDINGS.contains(&ending.as_str()) {
        let what = if path.is_dir() { "a folder, of pictures perhaps" } else { "a clip" };
        return Some(match written {
            Some(output) => format!("{name} is {what}: handcast track {name} -o {output}"),
            None => format!(
                "{name} is {what}: handcast run {name} -o DIR (all results), or handcast track {name} -o FILE.glb"
            ),
        });
    }
    if PICTURES.contains(&ending.as_str()) {
        return Some(format!(
            "{name} is a picture: handcast fit {name} -o person.toml (the sizes of its hand)"
        ));
    }
    match motion(word).map(|format| format.id) {
        Some("fba") => {
            let output = written.unwrap_or_else(|| "hand.glb".into());
            Some(format!("{name} is a stream: handcast decode {name} -o {output}"))
        }
        Some(_) => Some(match written {
            Some(output) if motion(&output).is_none_or(|format| format.id != "fba") => {
                format!("{name} is a motion: handcast import {name} -o {output}")
            }
            output => {
                let output = output.unwrap_or_else(|| "hand.fba".into());
                format!("{name} is a motion: handcast encode {name} -o {output}, or handcast view {name}")
            }
        }),
        None => path.is_file().then(|| {
            format!(
                "what is to be done with {name} stands before it: handcast run {name} (a clip), handcast decode {name} (a \
                 stream), handcast import {name} (joint positions)"
            )
        }),
    }
}

/// Options by names that others give them: what is meant, and what it is called, of which a subcommand may have some.
const OPTIONS: [(&str, &str, &[&str]); 6] = [
    ("--rms", "the error aimed at", &["target-rms"]),
    ("--quality", "how exact a stream is", &["max-error", "target-rms"]),
    ("--rate", "kilobits per second", &["bitrate"]),
    ("--fps", "frames per second of inputs that do not say", &["input-fps"]),
    ("--hand", "the one hand of two", &["only"]),
    ("--format", "the kind of file, where the name's ending does not tell", &["to"]),
];

/// The subcommand that was called.
struct Called<'a> {
    command: &'a Command,
    /// How it is called, as in `handcast bench codec`.
    name: String,
    /// Number of words to its name, those of options before it included.
    begins: usize,
}

impl<'a> Called<'a> {
    fn find(command: &'a Command, words: &[String]) -> Self {
        let mut called = Self { command, name: command.get_name().to_owned(), begins: 0 };
        for (i, word) in words.iter().enumerate() {
            if let Some(sub) = called.command.find_subcommand(word) {
                called = Self { command: sub, name: format!("{} {word}", called.name), begins: i + 1 };
            }
        }
        called
    }

    fn has(&self, long: &str) -> bool {
        self.command.get_arguments().any(|arg| arg.get_long() == Some(long))
    }

    fn takes_input(&self) -> bool {
        self.command.get_positionals().next().is_some()
    }

    /// What an option that there is not seems to mean.
    fn option(&self, option: &str, words: &[String]) -> Vec<String> {
        let option = option.split('=').next().unwrap_or(option);
        if ["-i", "--input", "--in", "--file"].contains(&option) {
            return self.input(option, words);
        }
        let Some((_, what, names)) = OPTIONS.iter().find(|(name, ..)| *name == option) else {
            return Vec::new();
        };
        let names: Vec<String> =
            names.iter().filter(|name| self.has(name)).map(|name| format!("--{name}")).collect();
        if names.is_empty() { Vec::new() } else { vec![format!("{what}: {}", names.join(" or "))] }
    }

    /// An input that is named with an option.
    fn input(&self, option: &str, words: &[String]) -> Vec<String> {
        let value = words.iter().skip_while(|word| *word != option).nth(1);
        let value = value.map(String::as_str).filter(|value| !value.starts_with('-'));
        if self.begins == 0 {
            let tip = "the input is named without an option, behind a subcommand: handcast run CLIP";
            let about = value.and_then(|value| file(value, None));
            return std::iter::once(tip.to_owned()).chain(about).collect();
        }
        if !self.takes_input() {
            return Vec::new();
        }
        let value = value.map_or_else(|| "FILE".to_owned(), shown);
        vec![format!("the input is named without an option: {} {value}", self.name)]
    }

    /// The first of the words behind its name that is neither an option nor the value of one.
    fn first_input<'w>(&self, own: &'w [String]) -> Option<&'w String> {
        let mut is_value = false;
        own.iter().find(|word| {
            let of_option = std::mem::replace(&mut is_value, self.takes_value(word));
            !of_option && !word.starts_with('-')
        })
    }

    /// Whether the word behind this one is its value.
    fn takes_value(&self, word: &str) -> bool {
        let is_it = |arg: &clap::Arg| match word.strip_prefix("--") {
            Some(long) => arg.get_long() == Some(long),
            None => arg
                .get_short()
                .is_some_and(|short| word.strip_prefix('-') == Some(short.encode_utf8(&mut [0; 4]))),
        };
        let arg = self.command.get_arguments().find(|arg| is_it(arg));
        arg.is_some_and(|arg| arg.get_action().takes_values() && !arg.is_require_equals_set())
    }

    /// What a word too many seems to mean: where no output is named, it is that.
    fn surplus(&self, word: &str, words: &[String]) -> Vec<String> {
        let own = words.get(self.begins..).unwrap_or_default();
        let named = own.iter().any(|word| word.starts_with("-o") || word.starts_with("--output"));
        // Words to be spelt have no ending.
        let text = self.command.get_name() == "spell" && Path::new(word).extension().is_none();
        if named || text || !self.has("output") {
            return Vec::new();
        }
        let input = if self.takes_input() { self.first_input(own) } else { None };
        let input = input
            .filter(|input| *input != word)
            .map_or_else(String::new, |input| format!(" {}", shown(input)));
        vec![format!("outputs are named with -o: {}{input} -o {}", self.name, shown(word))]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(line: &str) -> String {
        let words: Vec<OsString> = line.split_whitespace().map(OsString::from).collect();
        let error = crate::cli::command().try_get_matches_from(&words).unwrap_err();
        let error = advised(error, &words, &crate::cli::command());
        assert_eq!(error.exit_code(), 2, "{line}");
        error.to_string()
    }

    #[test]
    fn files_in_the_place_of_subcommands_tell_what_to_do_with_them() {
        for (line, words) in [
            (
                "handcast demo.avi",
                "demo.avi is a clip: handcast run demo.avi -o DIR (all results), or handcast track demo.avi -o FILE.glb",
            ),
            ("handcast clip.mp4 out.glb", "handcast track clip.mp4 -o out.glb"),
            ("handcast hand.fba", "hand.fba is a stream: handcast decode hand.fba -o hand.glb"),
            ("handcast hand.fba a.bvh", "handcast decode hand.fba -o a.bvh"),
            ("handcast poses.jsonl", "handcast encode poses.jsonl -o hand.fba, or handcast view poses.jsonl"),
            ("handcast hand.bvh x.fba", "handcast encode hand.bvh -o x.fba"),
            ("handcast hand.bvh x.glb", "handcast import hand.bvh -o x.glb"),
            ("handcast open.jpg", "handcast fit open.jpg -o person.toml"),
            ("handcast src", "handcast run src -o DIR"),
            ("handcast Cargo.toml", "what is to be done with Cargo.toml stands before it"),
            ("handcast convert a b", "import"),
            ("handcast -i demo.avi", "handcast run demo.avi -o DIR"),
        ] {
            let said = said(line);
            assert!(said.contains(words), "{line}: {said}");
            assert!(!said.contains("similar subcommand"), "{line}: {said}");
        }
        assert!(said("handcast trak").contains("'track'"));
        assert!(!said("handcast frobnicate").contains("tip"));
    }

    #[test]
    fn words_too_many_are_outputs() {
        for (line, words) in [
            ("handcast track demo.avi out.jsonl", "-o: handcast track demo.avi -o out.jsonl"),
            ("handcast spell HELLO a.glb", "-o: handcast spell HELLO -o a.glb"),
            ("handcast run --view back demo.avi -q out", "-o: handcast run demo.avi -o out"),
            ("handcast demo out", "-o: handcast demo -o out"),
        ] {
            let said = said(line);
            assert!(said.contains(words), "{line}: {said}");
        }
        for line in [
            "handcast spell HELLO WORLD",
            "handcast inspect a.fba b.fba",
            "handcast track a.avi b.jsonl -o c.jsonl",
        ] {
            let said = said(line);
            assert!(said.contains("unexpected argument") && !said.contains("tip"), "{line}: {said}");
        }
    }

    #[test]
    fn options_by_other_names_are_told() {
        for (line, words) in [
            ("handcast encode a -o b --rms 3", "the error aimed at: --target-rms"),
            ("handcast encode a -o b --quality 3", "--max-error or --target-rms"),
            ("handcast encode a -o b --rate 3", "--bitrate"),
            ("handcast live --quality 3", "how exact a stream is: --target-rms"),
            ("handcast run a --fps 60", "--input-fps"),
            ("handcast demo --fps=60", "--input-fps"),
            ("handcast fidelity a --fps 60", "--input-fps"),
            ("handcast decode a -o b.glb --hand left", "--only"),
            ("handcast track -i x", "the input is named without an option: handcast track x"),
            ("handcast encode a -o b --overlay", "unexpected argument '--overlay'"),
        ] {
            let said = said(line);
            assert!(said.contains(words), "{line}: {said}");
            assert!(!said.contains("as a value") && !said.contains("--quiet"), "{line}: {said}");
        }
    }

    #[cfg(feature = "bench")]
    #[test]
    fn measurements_refuse_numbers_too() {
        for (line, words) in [
            ("handcast bench codec --input x", "without an option: handcast bench codec x"),
            ("handcast bench codec D --target-rms -1", "invalid value '-1'"),
            ("handcast bench codec D --quant 40", "invalid value '40'"),
            ("handcast bench sizes --fps 0", "allowed 1 to 240"),
            ("handcast bench fit --persons 0", "invalid value '0'"),
        ] {
            assert!(said(line).contains(words), "{line}: {}", said(line));
        }
    }

    #[test]
    fn numbers_below_what_is_allowed_are_told_as_such() {
        for line in [
            "handcast encode a -o b --target-rms -1",
            "handcast decode a -o b.glb --tolerance -1",
            "handcast send a --vmc h --speed -1",
        ] {
            let said = said(line);
            assert!(said.contains("invalid value '-1'") && said.contains("allowed"), "{line}: {said}");
        }
    }

    #[test]
    fn options_that_do_nothing_alone_are_refused() {
        for (line, words) in [
            ("handcast synth -o a.avi --meet", "--two-hands"),
            ("handcast synth -o a.avi --roughness 1", "--masks"),
            ("handcast render a.fba -o a.png --at 1 --turntable", "--turntable"),
        ] {
            assert!(said(line).contains(words), "{line}");
        }
    }
}
