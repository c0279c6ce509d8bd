//! `handcast bench gaps`: what a stream is off by where pictures are missing, with the last pose held and with gaps bridged.

use std::path::PathBuf;

use anyhow::{Context, ensure};
use handcast_codec::mapping::Profile;
use handcast_codec::{decode_poses, encode_bridged};
use handcast_fba::DecoderOptions;
use handcast_fba::plan::{PlanOptions, Target};
use handcast_formats::motion::Motion;
use handcast_hand::random::Random;
use handcast_hand::{Finger, HandPose, Joint, JointAngle, PoseClip, Skeleton};

use crate::cli::common::limits;
use crate::cli::usage::positive;

/// Measures what a stream is off by where pictures are missing: a fifth of the frames of poses that have all of them is left out,
/// and what is decoded is compared with all
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Motions of one hand (.jsonl and all that `encode` reads), with a pose in each frame, as tracked ones have
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// Root mean square error that the encoder aims at, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.4, value_parser = positive)]
    target_rms: f64,
    /// Which frames are missing is chosen at random this many times
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// Print the table as JSON
    #[arg(long)]
    json: bool,
}

/// Frames that are missing in a row; 0 stands for each of them by chance.
const BURSTS: [usize; 12] = [0, 1, 2, 3, 4, 5, 6, 8, 11, 15, 22, 30];
/// One of so many frames is missing.
const OF: usize = 5;

/// What was measured in one way of doing it.
#[derive(Default, serde::Serialize)]
struct Errors {
    kbit_per_s: f64,
    /// Joint angles ever other than 0 over all frames, degrees.
    rms_deg: f64,
    /// The same in missing frames.
    missing_rms_deg: f64,
    missing_p99_deg: f64,
    /// Fingertips in missing frames as a viewer sees them, with the wrist's way, millimetres.
    missing_tips_mm: f64,
    missing_tips_p99_mm: f64,
}

/// A row of the table.
#[derive(serde::Serialize)]
struct Row {
    /// Frames in a row; 0 where each is left out by chance.
    burst: usize,
    held: Errors,
    bridged: Errors,
}

/// Differences of all clips.
#[derive(Default)]
struct Sums {
    bits: f64,
    seconds: f64,
    squares: f64,
    count: usize,
    missing: Vec<f64>,
    tips: Vec<f64>,
}

impl Sums {
    fn errors(mut self) -> Errors {
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let squares: Vec<f64> = self.missing.iter().map(|degrees| degrees * degrees).collect();
        Errors {
            kbit_per_s: self.bits / 1e3 / self.seconds.max(1e-9),
            rms_deg: (self.squares / self.count.max(1) as f64).sqrt(),
            missing_rms_deg: mean(&squares).sqrt(),
            missing_tips_mm: mean(&self.tips),
            missing_p99_deg: p99(&mut self.missing),
            missing_tips_p99_mm: p99(&mut self.tips),
        }
    }
}

fn p99(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get((values.len() * 99 / 100).min(values.len().saturating_sub(1))).copied().unwrap_or(0.0)
}

/// Prints the table.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let read = |path: &PathBuf| {
        let name = path.display();
        let clip = Motion::read_within(path, limits())?.clip;
        ensure!(clip.header.hands.len() == 1, "{name}: two hands");
        ensure!(clip.frames.iter().filter(|f| f.valid).count() > 2 * OF, "{name}: too few poses");
        Ok(clip)
    };
    let clips: Vec<PoseClip> = args.inputs.iter().map(read).collect::<anyhow::Result<_>>()?;
    let plan = PlanOptions { mode: Target::Rms(args.target_rms), ..PlanOptions::default() };
    let mut rows = Vec::new();
    for burst in BURSTS {
        let [mut held, mut bridged] = [Sums::default(), Sums::default()];
        for (clip, seed) in clips.iter().flat_map(|clip| (0..args.seeds).map(move |seed| (clip, seed))) {
            let missing = missing(clip.frames.len(), burst, seed);
            measure(clip, &missing, &plan, 0.0, &mut held)?;
            measure(clip, &missing, &plan, f64::INFINITY, &mut bridged)?;
        }
        rows.push(Row { burst, held: held.errors(), bridged: bridged.errors() });
    }
    if args.json {
        outln!("{}", serde_json::to_string_pretty(&rows)?);
        return Ok(());
    }
    outln!(
        "| missing in a row | | kbit/s | ° RMS, all frames | missing ones | 99 % | fingertips there, mm | 99 % |\n\
         |---|---|---:|---:|---:|---:|---:|---:|"
    );
    for Row { burst, held, bridged } in &rows {
        let name = if *burst == 0 { "by chance".to_owned() } else { burst.to_string() };
        print(&name, "held", held);
        print("", "interpolated", bridged);
    }
    Ok(())
}

fn print(name: &str, how: &str, errors: &Errors) {
    let Errors { kbit_per_s, rms_deg, missing_rms_deg, .. } = errors;
    outln!(
        "| {name} | {how} | {kbit_per_s:.3} | {rms_deg:.3} | {missing_rms_deg:.2} | {:.1} | {:.1} | {:.1} |",
        errors.missing_p99_deg,
        errors.missing_tips_mm,
        errors.missing_tips_p99_mm
    );
}

/// Which of so many frames are missing: the first and the last never are.
fn missing(frames: usize, burst: usize, seed: u64) -> Vec<bool> {
    let mut random = Random::new(seed, burst as u64);
    let mut out = vec![false; frames];
    if burst == 0 {
        out.iter_mut().for_each(|missing| *missing = random.below(OF) == 0);
    } else {
        for part in out.chunks_exact_mut(OF * burst) {
            let from = random.below((OF - 1) * burst);
            part[from..from + burst].fill(true);
        }
    }
    if let Some(first) = out.first_mut() {
        *first = false;
    }
    if let Some(last) = out.last_mut() {
        *last = false;
    }
    out
}

/// Adds what is off where these frames of a clip are left out before it is coded.
fn measure(
    clip: &PoseClip,
    missing: &[bool],
    plan: &PlanOptions,
    max_gap: f64,
    sums: &mut Sums,
) -> anyhow::Result<()> {
    let mut gaps = clip.clone();
    let mut kept = missing.iter();
    gaps.frames.retain(|_| !kept.next().copied().unwrap_or(false));
    let coded = encode_bridged(&gaps, Profile::Hand, plan, max_gap)?;
    let found = decode_poses(&coded.stream, None, DecoderOptions::default())?.clip;
    sums.bits += 8.0 * coded.stream.len() as f64;
    sums.seconds += coded.report.seconds;
    let hand = clip.header.hands.first().context("no hand")?;
    let skeleton = Skeleton::new(&hand.morphology.clone().unwrap_or_default(), hand.side);
    let tips = |pose: &HandPose| {
        let frames = skeleton.frames(pose);
        Finger::ALL.map(|finger| frames.position(Joint::tip(finger)))
    };
    let valid = || clip.frames.iter().filter(|f| f.valid);
    let moves = |angle: &JointAngle| valid().any(|f| f.pose.angle(*angle) != 0.0);
    let moving: Vec<JointAngle> = JointAngle::ALL.into_iter().filter(moves).collect();
    let start = clip.frames.first().map_or(0.0, |f| f.time);
    for (given, missing) in clip.frames.iter().zip(missing).filter(|(given, _)| given.valid) {
        let tick = ((given.time - start) * coded.clip.header.rate.unwrap_or(30.0)).round() as usize;
        let Some(shown) = found.frames.get(tick) else { continue };
        for &angle in &moving {
            let off = (given.pose.angle(angle) - shown.pose.angle(angle)).to_degrees().abs();
            sums.squares += off * off;
            sums.count += 1;
            if *missing {
                sums.missing.push(off);
            }
        }
        if *missing {
            let pairs = tips(&given.pose).into_iter().zip(tips(&shown.pose));
            sums.tips.extend(pairs.map(|(a, b)| (a - b).norm() * 1e3));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fifth_is_missing_in_bursts_of_the_length_asked_for() {
        for burst in BURSTS {
            let missing = missing(3000, burst, 4);
            let share = missing.iter().filter(|m| **m).count() as f64 / 3000.0;
            assert!((share - 0.2).abs() < 0.02, "{burst}: {share}");
            assert!(!missing[0] && !missing[2999]);
            let longest = missing.split(|m| !m).map(<[bool]>::len).max();
            assert!(burst == 0 || longest >= Some(burst));
        }
    }
}
