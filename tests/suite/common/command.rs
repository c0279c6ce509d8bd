//! Runs the command itself.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The program: that of the build, or the one that `HANDCAST_BINARY` names, so that builds of other profiles are held to
/// the same.
pub fn program() -> PathBuf {
    std::env::var_os("HANDCAST_BINARY").map_or_else(|| env!("CARGO_BIN_EXE_handcast").into(), PathBuf::from)
}

pub fn handcast(args: &[&str]) -> Output {
    let mut command = Command::new(program());
    // Whatever networks the machine has.
    command.args(args).env("HANDCAST_NET", "none").output().expect("the command runs")
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

pub fn path(p: &Path) -> &str {
    p.to_str().expect("a path in UTF-8")
}

/// Runs it successfully, and gives what it printed.
pub fn done(args: &[&str]) -> String {
    let out = handcast(args);
    assert!(out.status.success(), "{args:?}: {}", text(&out.stderr));
    text(&out.stdout)
}

/// Fails with exit code 1, says all of `words`, and leaves nothing under `output`.
pub fn refused(args: &[&str], output: &Path, words: &[&str]) {
    failed(1, args, output, words);
}

/// The same of a command line that is wrong, whatever is in the files: exit code 2.
pub fn misused(args: &[&str], output: &Path, words: &[&str]) {
    failed(2, args, output, words);
}

fn failed(code: i32, args: &[&str], output: &Path, words: &[&str]) {
    let out = handcast(args);
    let message = text(&out.stderr);
    assert_eq!(out.status.code(), Some(code), "{args:?}: {message}");
    for word in words {
        assert!(message.contains(word), "{args:?} should say {word:?}: {message}");
    }
    assert!(!message.contains("panicked"), "{message}");
    assert!(!output.exists(), "{} is left behind", output.display());
}
