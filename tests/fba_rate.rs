//! A bit rate asked for is held: within 5 % over any ten seconds after the first two.

mod common;

use handcast::bap::mapping::{PoseMapper, Profile};
use handcast::fba::DecoderOptions;
use handcast::fba::inspect::Inspector;
use handcast::fba::plan::{PlanOptions, RateMode, TimedBapFrame, encode_clip};
use handcast::hand::shapes::{ShapeLibrary, minimum_jerk};
use handcast::hand::{HandPose, Side};
use handcast::io::import::{ImportOptions, import};
use handcast::io::landmarks::LandmarkClip;
use handcast::synth::sign_dense;

const RATE: f64 = 30.0;

fn frames(poses: Vec<HandPose>) -> Vec<TimedBapFrame> {
    let mut mapper = PoseMapper::new(Profile::Hand);
    let frame = |(tick, pose)| TimedBapFrame { time: tick as f64 / RATE, baps: mapper.frame(&[pose]) };
    poses.into_iter().enumerate().map(frame).collect()
}

/// Smallest and largest rate over ten seconds, kbit/s, from two seconds on: as the stream itself shows it.
fn extremes(stream: &[u8], frames: usize) -> [f64; 2] {
    let mut bits = vec![0; frames];
    let mut last = 32;
    for plane in Inspector::new(stream, DecoderOptions::default()) {
        let plane = plane.unwrap();
        let tick = (plane.frame.time * RATE).round() as usize;
        bits[tick] += plane.frame.end_bit - last;
        last = plane.frame.end_bit;
    }
    let sums: Vec<f64> =
        bits[60..].windows(300).map(|window| window.iter().sum::<u64>() as f64 / 1e4).collect();
    [sums.iter().copied().fold(f64::INFINITY, f64::min), sums.iter().copied().fold(0.0, f64::max)]
}

fn assert_held(what: &str, motion: &[TimedBapFrame], kbit_per_s: f64) {
    let mut held = true;
    for live in [false, true] {
        let options = PlanOptions { mode: RateMode::Bitrate(kbit_per_s), live, ..PlanOptions::default() };
        let (stream, report) = encode_clip(motion, &options).unwrap();
        let [least, most] = extremes(&stream, motion.len());
        println!(
            "{what}, live {live}: {least:.3} to {most:.3} of {kbit_per_s} kbit/s at {:.2}° RMS, {:.1}° at most, q {:?}",
            report.rms_degrees, report.max_degrees, report.quants
        );
        held &= least >= 0.95 * kbit_per_s && most <= 1.05 * kbit_per_s;
    }
    assert!(held, "{what}: not within 5 %");
}

#[test]
fn on_made_up_motion() {
    let library = ShapeLibrary::builtin().unwrap();
    let shapes: Vec<HandPose> =
        library.names().map(|name| library.get(name).unwrap().pose(Side::Right)).collect();
    let motion = frames(sign_dense(&shapes, 40.0, RATE, 7).into_iter().map(|(_, pose)| pose).collect());
    assert_held("made up", &motion, 1.5);
}

#[test]
fn on_recorded_motion() {
    let mut poses: Vec<HandPose> = Vec::new();
    for name in ["leap/grab", "markers/ring-flexion-trial2", "leap/rollandpitchcropped"] {
        let Some(path) = common::shared(&format!("data/motion/{name}.landmarks.jsonl")) else { return };
        let (clip, _) = import(&LandmarkClip::read(&path).unwrap(), &ImportOptions::default()).unwrap();
        let mut tick = 0.0;
        let mut part = Vec::new();
        for frame in clip.frames.iter().filter(|frame| frame.valid) {
            if frame.time - clip.frames[0].time >= tick / RATE {
                part.push(frame.pose.clone());
                tick += 1.0;
            }
        }
        // Half a second from the end of one recording to the start of the next.
        if let (Some(from), Some(to)) = (poses.last().cloned(), part.first()) {
            poses.extend((1..15).map(|i| from.interpolated(to, minimum_jerk(f64::from(i) / 15.0))));
        }
        poses.extend(part);
    }
    let back = poses.clone().into_iter().rev();
    let looped: Vec<HandPose> = poses.iter().cloned().chain(back).collect();
    assert_held("recorded", &frames(looped), 1.6);
}
