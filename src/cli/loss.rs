//! `handcast fidelity --loss`: what a live stream comes to when packets of it are lost.

use std::path::Path;

use handcast_eval::fidelity::{LossOptions, loss};
use handcast_hand::PoseClip;

use super::common::{RateArgs, write_output};
use super::given;
use super::usage::within;

/// How packets are lost.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Losses")]
pub struct LossArgs {
    /// Send the poses live and lose this share of the packets, as 5% or 0.05; measures what is shown, and that alone
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub loss: Option<f64>,
    /// Mean number of packets lost in a row, 1 to 1000
    #[arg(long, value_name = "N", default_value_t = 1.0, requires = "loss", value_parser = burst)]
    burst: f64,
    /// Runs, each with losses of its own, 1 to 1000000
    #[arg(long, value_name = "N", default_value_t = 50, requires = "loss", value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    seeds: u64,
    /// How many packets before it those are that each packet has a copy of, as 1 or 1,4; 0 for no copies
    #[arg(long, value_name = "N", value_delimiter = ',', default_value = "1", requires = "loss")]
    copies: Vec<u8>,
    /// After each N packets a parity of them, which brings back one of them; 0 for none
    #[arg(long, value_name = "N", default_value_t = 0, requires = "loss")]
    parity: u8,
    /// The stream's bytes as they are, not numbered: gaps show by what damaged values betray
    #[arg(long, requires = "loss", conflicts_with_all = ["copies", "parity"])]
    unnumbered: bool,
}

/// A share as a number or in percent.
pub fn share(text: &str) -> Result<f64, String> {
    let value = match text.strip_suffix('%') {
        Some(percent) => percent.trim().parse::<f64>().map(|value| value / 100.0),
        None => text.parse::<f64>(),
    };
    match value {
        Ok(value) if (0.0..=0.9).contains(&value) => Ok(value),
        _ => Err("allowed 0% to 90%, or 0 to 0.9".into()),
    }
}

/// Packets.
fn burst(text: &str) -> Result<f64, String> {
    within(text, 1.0..=1000.0, "packets")
}

/// Measures, and writes the report.
pub fn run(
    args: &LossArgs,
    share: f64,
    clip: &PoseClip,
    rate: &RateArgs,
    (output, json, quiet): (Option<&Path>, bool, bool),
) -> anyhow::Result<()> {
    given::note_idle("losses are those of a live stream", &["max_gap"]);
    let options = LossOptions::default()
        .with_share(share)
        .with_burst(args.burst)
        .with_seeds(args.seeds)
        .with_copies((!args.unnumbered).then(|| args.copies.iter().copied().filter(|&n| n > 0).collect()))
        .with_parity(args.parity)
        .with_profile(rate.profile.into())
        .with_plan(rate.plan_of(true));
    let report = loss(clip, &options)?;
    let facts = serde_json::to_string_pretty(&report)?;
    if let Some(path) = output {
        write_output(path, facts.as_bytes())?;
    }
    if json {
        outln!("{facts}");
    } else if !quiet {
        out!("{report}");
    }
    Ok(())
}
