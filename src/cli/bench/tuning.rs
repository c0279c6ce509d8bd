//! `handcast bench tuning`: what each tuning constant of tracking is worth.

use std::path::PathBuf;

use anyhow::ensure;
use handcast_eval::sensitivity::{Row, markdown, measure, rows, scenes, score};
use handcast_track::pipeline::ClipOptions;

use crate::cli::common::{progress, write_output};

/// Measures tracking with each of its constants halved and doubled, on rendered clips
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Constants whose name begins like this [default: all]
    #[arg(long, value_name = "PATH", default_value = "", hide_default_value = true)]
    only: String,
    /// Made-up hands, each with its four clips, 1 to 50
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u8).range(1..=50))]
    hands: u8,
    /// Frames of each clip, 10 to 1000
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = clap::value_parser!(u32).range(10..=1000))]
    frames: u32,
    /// Table to write, as Markdown (- for standard output)
    #[arg(short, long, value_name = "FILE", default_value = "-")]
    output: PathBuf,
    /// Neither progress nor report; warnings are told all the same
    #[arg(short, long)]
    quiet: bool,
}

/// Runs the measurement.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let mut all: Vec<Row> = rows().into_iter().filter(|row| row.path.starts_with(&args.only)).collect();
    ensure!(!all.is_empty(), "no constant begins with {}", args.only);
    let scenes = scenes(args.hands.into(), args.frames as usize)?;
    let base = score(&ClipOptions::default(), &scenes);
    let bar = progress(!args.quiet, Some(all.len() as u64));
    for row in &mut all {
        measure(row, &scenes);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let only = if args.only.is_empty() { String::new() } else { format!(" --only {}", args.only) };
    let command = format!("handcast bench tuning --hands {} --frames {}{only}", args.hands, args.frames);
    write_output(&args.output, markdown(&all, Some((base, command))).as_bytes())
}
