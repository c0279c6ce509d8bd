//! `handcast bench codec`: rate and error of the codec on recorded motion.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use handcast::bap::mapping::{PoseMapper, Profile};
use handcast::fba::plan::{PlanOptions, PlanReport, RateMode, TimedBapFrame, encode_clip};
use handcast::hand::{Finger, HandPose, JointAngle};
use handcast::io::import::{ImportOptions, import};
use handcast::io::landmarks::LandmarkClip;

/// Rate and error of the codec on recorded motion
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder with landmark recordings (.landmarks.jsonl), searched with its subfolders; files of still
    /// poses (.json) are strung together to sign-dense motion
    dir: PathBuf,
    /// Root mean square error aimed at, degrees
    #[arg(long, default_value_t = 0.5)]
    target_rms: f64,
    /// Quantiser index and plain rounding instead
    #[arg(long)]
    quant: Option<u8>,
    /// Kilobits per second instead
    #[arg(long)]
    bitrate: Option<f64>,
    /// Only files whose path contains this
    #[arg(long)]
    only: Option<String>,
    /// Code frame by frame without look-ahead
    #[arg(long)]
    live: bool,
}

/// Frames per second at which motion is coded.
const RATE: f64 = 30.0;

/// Prints the table.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let mut files = Vec::new();
    collect(&args.dir, &mut files)?;
    files.sort();
    files.retain(|file| args.only.as_ref().is_none_or(|part| file.to_string_lossy().contains(part)));
    if files.is_empty() {
        bail!("no recordings in {}", args.dir.display());
    }
    println!(
        "{:<34} {:>6} {:>7} {:>8} {:>6} {:>6} {:>6}  {:>5} {:>5} {:>5} {:>5} {:>5} {:>5} {:>5}",
        "clip",
        "frames",
        "planes",
        "kbit/s",
        "rms",
        "rms29",
        "max",
        "start",
        "head",
        "mask",
        "range",
        "I",
        "P",
        "flush"
    );
    let mut sums: Vec<[f64; 4]> = Vec::new();
    for file in &files {
        let frames = motion(file).with_context(|| format!("{}", file.display()))?;
        let mode = match (args.quant, args.bitrate) {
            (Some(quant), _) => RateMode::Quant(quant),
            (None, Some(rate)) => RateMode::Bitrate(rate),
            (None, None) => RateMode::TargetRms(args.target_rms),
        };
        let (_, report) =
            encode_clip(&frames, &PlanOptions { mode, live: args.live, ..PlanOptions::default() })?;
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        print(name.trim_end_matches(".landmarks.jsonl"), &report);
        sums.push([report.kbit_per_s(), report.rms_degrees, report.rms_all_degrees, report.max_degrees]);
    }
    let mean = |column: usize| sums.iter().map(|row| row[column]).sum::<f64>() / sums.len() as f64;
    println!(
        "{:<34} {:>6} {:>7} {:>8.3} {:>6.3} {:>6.3} {:>6.3}",
        "mean",
        "",
        "",
        mean(0),
        mean(1),
        mean(2),
        mean(3)
    );
    Ok(())
}

fn print(name: &str, report: &PlanReport) {
    let per_second = |bits: u64| bits as f64 / report.seconds;
    let b = &report.bits;
    println!(
        "{:<34} {:>6} {:>7} {:>8.3} {:>6.3} {:>6.3} {:>6.3}  {:>5.0} {:>5.0} {:>5.0} {:>5.0} {:>5.0} {:>5.0} {:>5.0}  q {:?} l {:.4} sent {}",
        name,
        report.frames,
        report.planes,
        report.kbit_per_s(),
        report.rms_degrees,
        report.rms_all_degrees,
        report.max_degrees,
        per_second(b.start_codes),
        per_second(b.headers),
        per_second(b.masks),
        per_second(b.ranges),
        per_second(b.intra_values),
        per_second(b.predicted_values),
        per_second(b.flush),
        report.quants,
        report.lambda,
        report.sent.len(),
    );
}

fn collect(dir: &Path, files: &mut Vec<PathBuf>) -> anyhow::Result<()> {
    for entry in std::fs::read_dir(dir).with_context(|| format!("cannot list {}", dir.display()))? {
        let path = entry?.path();
        let name = path.to_string_lossy();
        if path.is_dir() {
            collect(&path, files)?;
        } else if name.ends_with(".landmarks.jsonl") || name.ends_with(".json") {
            files.push(path);
        }
    }
    Ok(())
}

/// The motion of a file as BAP frames at [`RATE`].
fn motion(file: &Path) -> anyhow::Result<Vec<TimedBapFrame>> {
    let clip = LandmarkClip::read(file)?;
    let stills = file.extension().is_some_and(|extension| extension == "json");
    let (clip, _) = import(&clip, &ImportOptions::default())?;
    let poses: Vec<(f64, HandPose)> =
        clip.frames.into_iter().filter(|frame| frame.valid).map(|frame| (frame.time, frame.pose)).collect();
    let poses = if stills { sign_dense(&poses, 60.0, 1) } else { resample(&poses) };
    let mut mapper = PoseMapper::new(Profile::Hand);
    Ok(poses.into_iter().map(|(time, pose)| TimedBapFrame { time, baps: mapper.frame(&[pose]) }).collect())
}

/// Poses at even times, interpolated between their neighbours.
fn resample(poses: &[(f64, HandPose)]) -> Vec<(f64, HandPose)> {
    let (Some(first), Some(last)) = (poses.first(), poses.last()) else { return Vec::new() };
    let count = ((last.0 - first.0) * RATE).floor() as usize + 1;
    let mut out = Vec::with_capacity(count);
    let mut index = 0;
    for tick in 0..count {
        let time = first.0 + tick as f64 / RATE;
        while index + 2 < poses.len() && poses[index + 1].0 <= time {
            index += 1;
        }
        let (a, b) = (&poses[index], &poses[(index + 1).min(poses.len() - 1)]);
        let share = if b.0 > a.0 { ((time - a.0) / (b.0 - a.0)).clamp(0.0, 1.0) } else { 0.0 };
        out.push((tick as f64 / RATE, a.1.interpolated(&b.1, share)));
    }
    out
}

/// Motion as dense as signing: still poses in random order, minimum-jerk transitions of 0.15 to 0.5 s
/// between them, holds of 0.1 to 0.6 s, noise of 0.4° on the 20 angles that the tracker moves.
fn sign_dense(poses: &[(f64, HandPose)], seconds: f64, seed: u64) -> Vec<(f64, HandPose)> {
    let mut random = Random(seed);
    let moving: Vec<JointAngle> = Finger::ALL
        .into_iter()
        .flat_map(|finger| {
            [finger.base_flexion(), finger.abduction(), finger.middle_flexion(), finger.end_flexion()]
        })
        .collect();
    let mut out = Vec::new();
    let mut from = poses[0].1.clone();
    let (mut start, mut end, mut hold) = (0.0, 0.0, 0.3);
    let mut to = from.clone();
    for tick in 0..(seconds * RATE) as usize {
        let time = tick as f64 / RATE;
        while time >= end + hold {
            start = end + hold;
            end = start + 0.15 + 0.35 * random.unit();
            hold = 0.1 + 0.5 * random.unit();
            from = to;
            to = poses[(random.unit() * poses.len() as f64) as usize % poses.len()].1.clone();
        }
        let u = if end > start { ((time - start) / (end - start)).clamp(0.0, 1.0) } else { 1.0 };
        let share = u * u * u * (10.0 + u * (6.0 * u - 15.0));
        let mut pose = HandPose::neutral(poses[0].1.side);
        for &angle in &moving {
            let noise = 0.4f64.to_radians() * random.normal();
            pose.set(angle, from.angle(angle) + share * (to.angle(angle) - from.angle(angle)) + noise);
        }
        out.push((time, pose));
    }
    out
}

/// A small generator (splitmix64), so that the motion is the same everywhere.
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.unit()).cos()
    }
}
