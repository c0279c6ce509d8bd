//! `handcast track`: the poses of the hands in a clip.

use std::path::PathBuf;

use super::files::check_free;
use super::overlay;
use super::part::PartArgs;
use super::poses_out::{Journal, Lines, OutArgs};
use super::resume::Resumed;
use super::summary::Summary;
use super::tracking::{Poses, TrackArgs};
use super::usage::positive;

/// Tracks the hands in a clip and writes their poses, with confidence and overlap frame by frame
#[derive(Debug, clap::Args)]
pub struct Args {
    /// MP4/MOV, AVI, animated GIF/PNG/WebP, Y4M (- for standard input), a folder, "glob" or %03d pattern of pictures
    clip: PathBuf,
    /// File to write: .jsonl (with confidence, overlap and validity), .json, .csv, .bvh, .vrma, .webxr.json,
    /// .landmarks.jsonl, .pose, .bap, .glb or .gltf
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// What was tracked drawn over the clip (.mp4, .avi), its pictures as they are looked at, 640 pixels a side at most: green is
    /// sure, orange doubtful, red lost, pink touching
    #[arg(long, value_name = "FILE")]
    overlay: Option<PathBuf>,
    /// Go on from FILE.partial.jsonl, which a run that was ended left beside FILE: with the same clip and options, only
    /// the first seconds and those not tracked yet are tracked
    #[arg(long, conflicts_with_all = ["overlay", "mask"])]
    resume: bool,
    /// Frames per second of clips that do not say (folders)
    #[arg(long, value_name = "HZ", default_value_t = 30.0, value_parser = positive)]
    input_fps: f64,
    #[command(flatten)]
    part: PartArgs,
    #[command(flatten)]
    track: TrackArgs,
    #[command(flatten)]
    out: OutArgs,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let format = args.out.motion(&args.output)?;
    let part = args.part.part()?;
    if let Some(told) = args.track.told_side().filter(|side| !args.out.wants(*side)) {
        refuse!("--hand {} tracks no other hand, and --only leaves that out", told.name());
    }
    if let Some(path) = &args.overlay {
        overlay::check(path)?;
    }
    // What is wrong with a rig is said before the work.
    args.out.glb.read()?;
    let piped = args.output.as_os_str() == "-";
    // Pose lines as they come need not be kept.
    let as_they_come = format.id == "jsonl" && args.out.is_all();
    let flows = piped && as_they_come;
    let mut journal = (!piped).then(|| Journal::beside(&args.output));
    let mut resumed = match (&mut journal, args.resume) {
        (Some(journal), true) => {
            check_free(journal.path())?;
            Some(Resumed::read(journal.path())?)
        }
        (None, true) => refuse!("--resume goes on from a file beside --output, which - has none of"),
        (journal, false) => {
            journal.as_mut().map_or(Ok(()), |journal| journal.move_rest())?;
            None
        }
    };
    let lines = match &journal {
        _ if flows => Some(Lines::default()),
        Some(journal) => Some(journal.lines(resumed.as_ref().map(Resumed::joint))),
        None => None,
    };
    let kept = resumed.as_ref().zip(journal.as_ref().map(Journal::path));
    let poses = Poses { lines, keep: !as_they_come };
    let tracked = args.track.track(&args.clip, args.input_fps, part, args.overlay.clone(), poses, kept);
    let mut tracked = match &mut journal {
        Some(journal) => journal.of(tracked)?,
        None => tracked?,
    };
    let mut summary = tracked.summary(&args.clip.display().to_string());
    summary.resumed_at = resumed.as_ref().map(Resumed::joint);
    let facts = match serde_json::to_value(&summary)? {
        serde_json::Value::Object(facts) => facts,
        _ => serde_json::Map::new(),
    };
    match &journal {
        _ if flows => {}
        Some(journal) if as_they_come => {
            let mut header = tracked.header();
            resumed.iter().for_each(|resumed| resumed.add_hands(&mut header));
            journal.copy_to(&args.output, &header, |side, time| tracked.not_yet(side, time))?;
        }
        _ => {
            let poses = tracked.take_poses();
            let poses = match resumed.take() {
                Some(resumed) => resumed.joined(poses),
                None => poses,
            };
            args.out.write(&args.output, poses, &tracked.morphology(), format, facts)?;
        }
    }
    journal.into_iter().for_each(Journal::done);
    let drawn = tracked.overlay.as_ref().map(|overlay| overlay.in_words(tracked.clip_size));
    if let Some(overlay) = tracked.overlay {
        overlay.file.commit()?;
    }
    tell(args, &summary, drawn.as_deref())
}

/// Reports what was tracked.
fn tell(args: &Args, summary: &Summary, drawn: Option<&str>) -> anyhow::Result<()> {
    let piped = args.output.as_os_str() == "-";
    // Poses on standard output leave no room for words.
    let words = !piped && !args.track.quiet;
    if args.track.json && piped {
        errln!("{}", serde_json::to_string_pretty(summary)?);
    } else if args.track.json {
        outln!("{}", serde_json::to_string_pretty(summary)?);
    } else if words {
        out!("{}{}", summary.text(args.track.smooths()), summary.speed(""));
        outln!("  results     {}", args.output.display());
        if let (Some(drawn), Some(path)) = (drawn, &args.overlay) {
            outln!("  overlay     {}{drawn}", path.display());
        }
    }
    Ok(())
}
