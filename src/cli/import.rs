//! `handcast import`: other trackers' joint positions to poses.

use std::path::PathBuf;

use anyhow::{Context, bail};
use clap::Args as ClapArgs;
use handcast_formats::import::{ImportOptions, import};
use handcast_formats::landmarks::LandmarkClip;
use handcast_formats::person::{read_person, write_person};
use handcast_hand::landmarks::SolverOptions;
use handcast_hand::smooth::SmoothOptions;
use handcast_hand::{Morphology, Person};

use super::common::{HandOrAuto, ending, hand_length};
use super::poses_out::{OutArgs, Output};
use super::tracking::smoothing;

/// Turns joint positions (21 landmarks, 25 or 26 XR joints) into poses of the hand model.
#[derive(Debug, ClapArgs)]
pub struct Args {
    /// Landmark JSON lines, or WebXR poses as JSON.
    input: PathBuf,
    /// File to write: poses (.jsonl), or .glb, .json, .csv, .bvh, .webxr.json, .landmarks.jsonl, .bap.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Which hand; auto takes the file's word, or tries both.
    #[arg(long, value_enum, default_value = "auto")]
    hand: HandOrAuto,
    /// Use this person's sizes instead of measuring them in the recording.
    #[arg(long, value_name = "FILE")]
    person: Option<PathBuf>,
    /// Write the sizes to a person file (.toml or .json).
    #[arg(long, value_name = "FILE")]
    save_person: Option<PathBuf>,
    /// Length of the hand, millimetres, when the file's unit is unknown or wrong.
    #[arg(long, value_name = "MM", value_parser = hand_length)]
    hand_length_mm: Option<f64>,
    /// Keep the couplings of the tracker's model: end joints follow middle joints, the palm is cupped as fingers
    /// bend. For joints of hands that handcast tracked.
    #[arg(long)]
    tie: bool,
    /// Do not let fingers and thumb twist.
    #[arg(long)]
    no_twist: bool,
    /// Static joint limits only, without the couplings between neighbouring fingers.
    #[arg(long)]
    limits_only: bool,
    /// Bridge gaps up to this many seconds.
    #[arg(long, value_name = "S", default_value_t = 0.25)]
    max_gap: f64,
    /// Smooth with a 1€ filter: cut-off at rest in Hz, and its growth in Hz per degree per second.
    #[arg(
        long,
        value_name = "MIN_CUTOFF,BETA",
        num_args = 0..=1,
        default_missing_value = "1.5,0.0175",
        value_parser = smoothing
    )]
    smooth: Option<SmoothOptions>,
    #[command(flatten)]
    out: OutArgs,
    /// Say nothing on success.
    #[arg(short, long)]
    quiet: bool,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let format = Output::motion(&args.output, args.out.to)?;
    if matches!(ending(&args.input).as_str(), "glb" | "gltf") && args.input.is_file() {
        bail!(
            "{}: joint positions are read (.landmarks.jsonl, WebXR .json), not glTF: encode, view, render and compare \
             read hands that this program wrote",
            args.input.display()
        );
    }
    let clip = LandmarkClip::read(&args.input)?;
    let person = args.person.as_deref().map(read_person).transpose()?;
    let options = ImportOptions {
        side: args.hand.known(),
        morphology: person.map(|p| p.morphology),
        hand_length: args.hand_length_mm,
        solver: SolverOptions {
            tie: args.tie,
            twists: !args.no_twist,
            dynamic: !args.limits_only,
            ..SolverOptions::default()
        },
        max_gap: args.max_gap,
        smooth: args.smooth,
    };
    let (poses, report) = import(&clip, &options).with_context(|| format!("{}", args.input.display()))?;
    let measured = poses.header.hands.first().cloned();
    args.out.write(&args.output, poses, &Morphology::default(), format, serde_json::Map::new())?;
    if let (Some(path), Some(info)) = (&args.save_person, measured)
        && let Some(morphology) = info.morphology
    {
        write_person(path, &Person { name: None, hand: Some(report.side), morphology })?;
    }
    if let Some(trial) = report.trial
        && trial.ratio() < 1.1
    {
        eprintln!(
            "handcast: left and right fit almost alike ({:.1} and {:.1} mm): give --hand if {} is wrong",
            trial.left * 1e3,
            trial.right * 1e3,
            report.side.name()
        );
    }
    if !args.quiet {
        eprintln!(
            "{} hand: {} frames solved, {} bridged, {} lost, {} points missing; joints {:.2} mm from the \
             points on average, {:.1} mm at most",
            report.side.name(),
            report.solved,
            report.bridged,
            report.lost,
            report.missing_points,
            report.mean_distance * 1e3,
            report.max_distance * 1e3
        );
    }
    Ok(())
}
