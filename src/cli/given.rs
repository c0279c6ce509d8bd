//! Which options stand on the command line, to say of those that change nothing.

use std::sync::OnceLock;

use clap::ArgMatches;
use clap::parser::ValueSource;

static GIVEN: OnceLock<Vec<String>> = OnceLock::new();

/// Keeps which options were given, those of subcommands included.
pub fn keep(matches: &ArgMatches) {
    let mut given = Vec::new();
    let mut level = Some(matches);
    while let Some(matches) = level {
        let on_line = |id: &&str| matches.value_source(id) == Some(ValueSource::CommandLine);
        given.extend(matches.ids().map(clap::Id::as_str).filter(on_line).map(str::to_owned));
        level = matches.subcommand().map(|(_, below)| below);
    }
    // The first of two calls holds; there is one.
    let _ = GIVEN.set(given);
}

/// Of these options, by the names of their fields, those that were given, as they are written.
pub fn among(ids: &[&str]) -> Vec<String> {
    let given = GIVEN.get().map_or(&[][..], Vec::as_slice);
    let written = |id: &str| format!("--{}", id.replace('_', "-"));
    ids.iter().filter(|id| given.iter().any(|other| other == *id)).map(|id| written(id)).collect()
}

/// Says that a rate that was given as `id` changes nothing, where a clip tells another one.
pub fn note_idle_rate(name: impl std::fmt::Display, told: Option<f64>, given: f64, id: &str) {
    if let Some(told) = told.filter(|told| (told - given).abs() > 1e-6) {
        note_idle(format_args!("{name} says {told} pictures per second"), &[id]);
    }
}

/// Says which of these options were given and change nothing, and why.
pub fn note_idle(why: impl std::fmt::Display, ids: &[&str]) {
    let idle = among(ids);
    if !idle.is_empty() {
        let verb = if idle.len() > 1 { "change" } else { "changes" };
        errln!("handcast: {why}: {} {verb} nothing", idle.join(", "));
    }
}
