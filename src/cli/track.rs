//! `handcast track`: the poses of the hands in a clip.

use std::path::PathBuf;

use super::common::ending;
use super::poses_out::{Journal, Lines, OutArgs, Output};
use super::tracking::TrackArgs;

/// Tracks the hands in a clip and writes their poses, with confidence and overlap frame by frame
#[derive(Debug, clap::Args)]
pub struct Args {
    /// MP4/MOV, AVI, animated GIF/PNG/WebP, Y4M (- for standard input), a folder or "glob" of pictures
    clip: PathBuf,
    /// File to write: .jsonl (with confidence, overlap and validity), .json, .csv, .bvh, .webxr.json,
    /// .landmarks.jsonl, .pose, .bap or .glb
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// What was tracked drawn over the clip (.avi): green is sure, orange doubtful, red lost, pink touching
    #[arg(long, value_name = "FILE")]
    overlay: Option<PathBuf>,
    /// Frames per second of clips that do not say (folders)
    #[arg(long, value_name = "RATE", default_value_t = 30.0)]
    input_fps: f64,
    #[command(flatten)]
    track: TrackArgs,
    #[command(flatten)]
    out: OutArgs,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let format = Output::motion(&args.output, args.out.to)?;
    if let Some(path) = &args.overlay {
        anyhow::ensure!(ending(path) == "avi", "{}: the overlay is an .avi", path.display());
    }
    // What is wrong with a rig is said before the work.
    args.out.glb.read()?;
    let piped = args.output.as_os_str() == "-";
    let flows = piped && format.id == "jsonl" && args.out.fps.is_none() && args.out.only.is_none();
    let journal = (!piped).then(|| Journal::beside(&args.output));
    let lines = if flows { Some(Lines::default()) } else { journal.as_ref().map(Journal::lines) };
    let tracked = args.track.track(&args.clip, args.input_fps, args.overlay.clone(), lines)?;
    let summary = tracked.summary(&args.clip.display().to_string());
    let facts = match serde_json::to_value(&summary)? {
        serde_json::Value::Object(facts) => facts,
        _ => serde_json::Map::new(),
    };
    if !flows {
        args.out.write(&args.output, tracked.poses(), &tracked.morphology(), format, facts)?;
    }
    if let Some(overlay) = tracked.overlay {
        overlay.file.commit()?;
    }
    drop(journal);
    // Poses on standard output leave no room for words.
    let words = !piped && !args.track.quiet;
    if args.track.json && piped {
        eprintln!("{}", serde_json::to_string_pretty(&summary)?);
    } else if args.track.json {
        outln!("{}", serde_json::to_string_pretty(&summary)?);
    } else if words {
        out!("{}{}", summary.text(&args.track), summary.speed(""));
        outln!("  results     {}", args.output.display());
    }
    Ok(())
}
