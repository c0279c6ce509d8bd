//! `handcast bench labels`: what tracked poses show, against what is known of the clip.

use std::path::PathBuf;

use anyhow::{Context, ensure};
use handcast_eval::fidelity::{CountLabels, CountReport, LetterLabels, LetterReport, Letters};
use handcast_formats::poses::read_poses;
use handcast_hand::{HandPose, PoseClip, count_extended};

use super::track::known::{check_ranges, labelled, percent, without};

/// Numbers of fingers and letters that tracked poses show, against labels of the clip
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Poses of the clip, one a frame: what `handcast track` writes
    poses: PathBuf,
    /// Ranges of frames and how many fingers they show, lines such as `120-150 3`
    #[arg(long, value_name = "FILE", required_unless_present = "letters")]
    counts: Option<PathBuf>,
    /// Ranges of frames and the letter of American Sign Language they show, lines such as `58-82 I`
    #[arg(long, value_name = "FILE")]
    letters: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Default, serde::Serialize)]
struct Report {
    #[serde(skip_serializing_if = "Option::is_none")]
    counts: Option<CountReport>,
    #[serde(skip_serializing_if = "Option::is_none")]
    letters: Option<LetterReport>,
}

/// The pose of a frame, if a hand was seen there.
fn pose_of(clip: &PoseClip, frame: usize) -> Option<&HandPose> {
    clip.frames.get(frame).filter(|f| f.valid).map(|f| &f.pose)
}

/// Runs the comparison.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let clip = read_poses(&args.poses)?;
    let name = args.poses.display().to_string();
    ensure!(
        clip.header.hands.len() < 2,
        "{name}: two hands, allowed is one: their frames are labelled apart"
    );
    let mut report = Report::default();
    if let Some(path) = &args.counts {
        let labels = CountLabels::read(path)?;
        let ranges = labels.ranges().iter().map(|r| [r.first, r.last]);
        check_ranges("counts", path, ranges, clip.frames.len())?;
        report.counts = Some(labels.score(|frame| pose_of(&clip, frame).map(count_extended)));
    }
    if let Some(path) = &args.letters {
        let labels = LetterLabels::read(path)?;
        let ranges = labels.ranges().iter().map(|r| [r.first, r.last]);
        check_ranges("letters", path, ranges, clip.frames.len())?;
        let letters = Letters::builtin().context("the library of hand shapes")?;
        let said = |frame: usize| Some(letters.nearest(pose_of(&clip, frame)?)?.0);
        report.letters = Some(labels.score(said));
    }
    if args.json {
        out!("{}\n", serde_json::to_string_pretty(&report)?);
        return Ok(());
    }
    let mut text = String::new();
    if let Some(counts) = &report.counts {
        labelled(&mut text, "poses", &name, counts);
    }
    if let Some(letters) = &report.letters {
        text += &table(letters);
    }
    out!("{}", text.trim_start());
    Ok(())
}

fn table(report: &LetterReport) -> String {
    let (share, frames) = (percent(report.share), report.frames);
    let mut text =
        format!("\nnearest letter the one shown in {share} of {frames} frames{}\n", without(report.missed));
    for r in &report.ranges {
        let said: Vec<String> = r.said.iter().map(|(letter, count)| format!("{letter}×{count}")).collect();
        let frames = format!("{}-{}", r.first, r.last);
        let share = percent(Some(r.right as f64 / r.frames as f64));
        text += &format!(
            "  {frames:>11}: {} shown, nearest in {share:>7} of {:>3} frames{}: {}\n",
            r.letter,
            r.frames,
            without(r.missed),
            said.join(" ")
        );
    }
    text
}
