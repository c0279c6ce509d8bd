//! `handcast-moq bench`: what relays cost, on this machine alone.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::ensure;
use handcast_moq::trial::{Link, Relay, Sender, ages, joins, kill, program};

/// One way between two relays that are apart.
const APART: Duration = Duration::from_millis(20);

/// What relays cost, on this machine alone.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// The relay, unmodified: cargo install moq-relay --version =0.17.10 [default: what HANDCAST_MOQ_RELAY names, else moq-relay]
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
    /// Seconds that each viewer reads
    #[arg(long, value_name = "S", default_value_t = 20)]
    seconds: u32,
    /// Joiners, one after the other
    #[arg(long, value_name = "N", default_value_t = 24)]
    joiners: u16,
}

/// A value that so many of 100 keep to.
fn at(sorted: &[u32], percent: usize) -> u32 {
    sorted.get((sorted.len().saturating_sub(1)) * percent / 100).copied().unwrap_or_default()
}

impl Args {
    /// Prints what a viewer of a relay and those who join there see.
    fn tell(&self, what: &str, relay: &Relay) -> anyhow::Result<()> {
        let ages = ages(relay, Duration::from_secs(self.seconds.into()))?;
        let joins = joins(relay, usize::from(self.joiners).max(1))?;
        ensure!(!ages.is_empty(), "{what}: nothing is seen");
        println!(
            "{what:28} age p50 {} ms, p95 {} ms, p99 {} ms; a joiner sees a hand after {} ms, at most {} ms",
            at(&ages, 50),
            at(&ages, 95),
            at(&ages, 99),
            at(&joins, 50),
            at(&joins, 100)
        );
        Ok(())
    }
}

/// Runs the measurement.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let program = args.program.clone().unwrap_or_else(program);
    {
        let first = Relay::start(&program, None)?;
        let second = Relay::start(&program, Some((first.port, &first)))?;
        let _sender = Sender::at(&[&first])?;
        args.tell("one relay", &first)?;
        args.tell("two relays", &second)?;
    }
    for percent in [0, 1, 5] {
        let first = Relay::start(&program, None)?;
        let link = Link::start(first.port, APART, f64::from(percent) / 100.0)?;
        let second = Relay::start(&program, Some((link.port, &first)))?;
        let _sender = Sender::at(&[&first])?;
        args.tell(&format!("two, 20 ms apart, {percent} % lost"), &second)?;
    }
    let back: Vec<u128> = kill(&program)?.iter().map(|viewer| viewer.back.as_millis()).collect();
    println!("{:28} viewers are back after {back:?} ms", "a relay is killed");
    Ok(())
}
