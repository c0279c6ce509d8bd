//! `handcast bench labels`: what tracked poses show, against what is known of the clip.

use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use handcast_codec::clip_rate;
use handcast_eval::fidelity::{CountLabels, CountReport, LetterLabels, LetterReport, Letters};
use handcast_formats::motion::Motion;
use handcast_hand::{HandPose, PoseClip, count_extended, nearest_in_time};

use super::super::common::limits;
use super::track::known::{check_ranges, labelled, percent, without};

/// Compares numbers of fingers and letters that tracked poses show with labels of the clip
#[derive(Debug, clap::Args)]
#[command(group = clap::ArgGroup::new("known").required(true).multiple(true).args(["counts", "letters"]))]
pub struct Args {
    /// Poses of the clip, one a frame, as `handcast track` writes them; with --frames any motion
    poses: PathBuf,
    /// Poses of the clip, one a frame, by whose times frames are found in a motion that has others: in a decoded stream, or where
    /// poses of lost hands are left out
    #[arg(long, value_name = "FILE")]
    frames: Option<PathBuf>,
    /// Ranges of frames and how many fingers they show, lines such as `120-150 3`
    #[arg(long, value_name = "FILE")]
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

/// The poses of a clip by its frames.
struct ByFrame {
    clip: PoseClip,
    /// Seconds of the frames, where the poses are not one a frame, and how far from them a pose may be.
    times: Option<(Vec<f64>, f64)>,
}

/// How far a pose may be from the time of a frame, in intervals of frames.
const NEAR: f64 = 0.55;

impl ByFrame {
    fn read(args: &Args) -> anyhow::Result<Self> {
        let read = |path: &Path| -> anyhow::Result<PoseClip> {
            let clip = Motion::read_within(path, limits())?.clip;
            ensure!(
                clip.header.hands.len() < 2,
                "{}: two hands, allowed is one: their frames are labelled apart",
                path.display()
            );
            Ok(clip)
        };
        let frames = args.frames.as_deref().map(read).transpose()?;
        let timed =
            |clip: PoseClip| (clip.frames.iter().map(|frame| frame.time).collect(), NEAR / clip_rate(&clip));
        let times = frames.map(timed);
        Ok(Self { clip: read(&args.poses)?, times })
    }

    fn count(&self) -> usize {
        self.times.as_ref().map_or(self.clip.frames.len(), |(times, _)| times.len())
    }

    /// That frames seem to have no pose, where poses are taken for one a frame: those behind them would be taken for others.
    fn gaps(&self) -> Option<String> {
        let rate = clip_rate(&self.clip);
        let steps = self.clip.frames.windows(2).filter(|_| self.times.is_none());
        let missing: Vec<(f64, usize)> = steps
            .map(|pair| (pair[0].time, ((pair[1].time - pair[0].time) * rate).round() as usize))
            .filter(|(_, ticks)| *ticks > 1)
            .map(|(time, ticks)| (time, ticks - 1))
            .collect();
        let (first, _) = missing.first()?;
        let count: usize = missing.iter().map(|(_, frames)| frames).sum();
        Some(format!(
            "{count} frames have no pose, the first of them behind {first:.3} s: poses are counted as one a frame, so that \
             later ones are taken for frames before them (--frames finds frames by their times)"
        ))
    }

    /// The pose of a frame, if a hand was seen there.
    fn pose(&self, frame: usize) -> Option<&HandPose> {
        let found = match &self.times {
            None => self.clip.frames.get(frame),
            Some((times, most)) => {
                let time = *times.get(frame)?;
                let frames = &self.clip.frames;
                let near = nearest_in_time(frames, time, |other| other.time).map(|at| &frames[at]);
                near.filter(|other| (other.time - time).abs() <= *most)
            }
        };
        found.filter(|found| found.valid).map(|found| &found.pose)
    }
}

/// Runs the comparison.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let poses = ByFrame::read(args)?;
    let name = args.poses.display().to_string();
    if let Some(notice) = poses.gaps() {
        errln!("handcast: {name}: {notice}");
    }
    let mut report = Report::default();
    if let Some(path) = &args.counts {
        let labels = CountLabels::read(path)?;
        let ranges = labels.ranges().iter().map(|r| [r.first, r.last]);
        check_ranges("counts", path, ranges, poses.count())?;
        report.counts = Some(labels.score(|frame| poses.pose(frame).map(count_extended)));
    }
    if let Some(path) = &args.letters {
        let labels = LetterLabels::read(path)?;
        let ranges = labels.ranges().iter().map(|r| [r.first, r.last]);
        check_ranges("letters", path, ranges, poses.count())?;
        let letters = Letters::builtin().context("the library of hand shapes")?;
        let said = |frame: usize| Some(letters.nearest(poses.pose(frame)?)?.0);
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
