//! `handcast spell`: finger spelling.

use std::fmt::Write as _;
use std::path::PathBuf;

use clap::Args as ClapArgs;
use handcast_hand::shapes::{ShownLetter, Spelling, SpellingTempo};

use super::common::write_output;
use super::pose::{HandArgs, size};
use super::poses_out::{Motion, OutArgs, Output, write};
use super::usage::within;

/// Spells a word with the fingers (American Sign Language; J and Z without their movement).
#[derive(Debug, ClapArgs)]
pub struct Args {
    /// Letters, digits and spaces.
    #[arg(value_parser = text)]
    text: String,
    /// File to write: .glb, .gltf, .jsonl, .json, .csv, .bvh, .vrma, .webxr.json, .landmarks.jsonl, .pose, .bap or .png (a sheet with a picture of each letter; of --fps, of moments).
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Frames in which letters are held, for `bench labels --letters`: lines such as `58-82 I`; digits in lines that are notes
    #[arg(long, value_name = "FILE")]
    labels: Option<PathBuf>,
    /// Frames per second, now `--fps`.
    #[arg(long, value_name = "HZ", hide = true, conflicts_with = "fps", value_parser = rate)]
    rate: Option<f64>,
    /// How much faster than two to three letters a second, 0.1 to 10.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = speed)]
    speed: f64,
    /// Size of one picture of a sheet, pixels, 16 to 4096 a side.
    #[arg(long, value_name = "WxH", default_value = "200x240", value_parser = size)]
    size: (u32, u32),
    #[command(flatten)]
    hand: HandArgs,
    #[command(flatten)]
    out: OutArgs,
}

/// Frames per second where none are asked for.
const RATE: f64 = 30.0;

fn text(text: &str) -> Result<String, String> {
    if (1..=1000).contains(&text.trim().len()) {
        Ok(text.into())
    } else {
        Err("allowed 1 to 1000 characters".into())
    }
}

fn rate(text: &str) -> Result<f64, String> {
    within(text, 1.0..=1000.0, "frames per second")
}

fn speed(text: &str) -> Result<f64, String> {
    within(text, 0.1..=10.0, "")
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let side = args.hand.side();
    let tempo = SpellingTempo::default().faster(args.speed);
    let spelling = Spelling::new(&args.hand.library()?, &args.text, side, tempo);
    let spelling = spelling.map_err(|error| args.hand.no_shape(error))?;
    // Made at the rate that is written, nothing is interpolated.
    let rate = args.out.fps.or(args.rate).unwrap_or(RATE);
    if let Some(path) = &args.labels {
        let text = labels(&spelling, rate);
        write_output(path, text.as_bytes())?;
        if text.lines().all(|line| line.starts_with('#')) {
            errln!(
                "handcast: {}: no letter A to Z is held for a frame, so that `bench labels` finds no ranges in it",
                path.display()
            );
        }
    }
    let frames = (spelling.duration() * rate).ceil() as usize;
    let mut times: Vec<f64> = (0..=frames).map(|i| i as f64 / rate).collect();
    let mut shown = spelling.shown().peekable();
    if args.out.output(&args.output)? == Output::Picture && args.out.fps.is_none() && shown.peek().is_some() {
        times = shown.map(|letter| 0.5 * (letter.from + letter.to)).collect();
    }
    let poses = times.into_iter().map(|time| (time, spelling.pose(time))).collect();
    let motion = Motion { side, morphology: args.hand.morphology()?, poses, rate: Some(rate) };
    write(motion, &args.output, &args.out, args.size)
}

/// The frames in which letters are held.
fn labels(spelling: &Spelling, rate: f64) -> String {
    let mut text = format!("# {rate} frames/s\n");
    for ShownLetter { letter, from, to } in spelling.shown() {
        let (first, last) = ((from * rate).ceil() as u64, (to * rate).floor() as u64);
        // At a low rate it may lie between two frames.
        if first <= last {
            let note = if letter.is_ascii_digit() { "# " } else { "" };
            // Writing to memory does not fail.
            let _ = writeln!(text, "{note}{first}-{last} {letter}");
        }
    }
    text
}
