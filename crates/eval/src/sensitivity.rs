//! What each tuning constant of tracking is worth: rendered clips tracked with it halved and doubled.

use std::fmt::Write as _;

use handcast_hand::{Joint, Morphology, Side, Skeleton};
use handcast_media::Frame;
use handcast_track::pipeline::{ClipOptions, Tracker};
use image::RgbImage;
use rayon::prelude::*;

use crate::synth::{ScriptedMotion, Synth, SynthError, SynthOptions, random_morphology};

/// The motions of the clips.
const MOTIONS: [ScriptedMotion; 4] =
    [ScriptedMotion::FlexIndex, ScriptedMotion::Fist, ScriptedMotion::Rotate, ScriptedMotion::Signs];
/// Size of their pictures, pixels.
const SIZE: (u32, u32) = (320, 240);

/// A rendered clip and its truth.
pub struct Scene {
    synth: Synth,
    frames: Vec<RgbImage>,
}

/// How well clips were tracked. A frame without a pose counts with the pose shown in its place, a clip that was refused
/// with 45° and 100 mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Score {
    /// Mean error of the joint angles, degrees.
    pub angle: f64,
    /// Mean distance of the fingertips, millimetres, the wrists brought together.
    pub tip: f64,
    /// Clips refused.
    pub refused: usize,
}

/// Error of a refused clip.
const REFUSED: (f64, f64) = (45.0, 100.0);

/// The clips: four motions of `hands` made-up hands, `frames` frames each.
///
/// # Errors
/// See [`SynthError`].
pub fn scenes(hands: u64, frames: usize) -> Result<Vec<Scene>, SynthError> {
    let of = |(motion, seed): (ScriptedMotion, u64)| {
        let morphology = random_morphology(seed);
        let compression = Some(85);
        let options = SynthOptions {
            motion,
            frames,
            size: SIZE,
            seed,
            compression,
            morphology,
            ..SynthOptions::default()
        };
        let synth = Synth::new(options)?;
        let frames = (0..synth.frames()).map(|i| synth.render(i).image).collect();
        Ok(Scene { synth, frames })
    };
    let hands = (1..=hands).flat_map(|seed| MOTIONS.map(|motion| (motion, seed)));
    hands.collect::<Vec<_>>().into_par_iter().map(of).collect()
}

impl Scene {
    /// Mean errors of angles (degrees) and fingertips (millimetres); `None` when the clip was refused.
    fn track(&self, options: &ClipOptions) -> Option<(f64, f64)> {
        let mut tracker = Tracker::new(options.clone());
        let mut poses = Vec::new();
        for (index, image) in self.frames.iter().enumerate() {
            let frame = Frame { index, time: self.synth.time(index), image: image.clone() };
            poses.extend(tracker.push(frame).ok()?);
        }
        poses.extend(tracker.finish().ok()?);
        if poses.is_empty() {
            return None;
        }
        let truth: &Morphology = &self.synth.options().morphology;
        let skeleton = Skeleton::new(truth, Side::Right);
        let (mut angles, mut tips) = (0.0, 0.0);
        for (i, found) in poses.iter().enumerate() {
            let real = self.synth.pose(i.min(self.frames.len() - 1));
            let off = found.pose.angles.iter().zip(&real.angles).map(|(a, b)| (a - b).abs());
            angles += off.sum::<f64>().to_degrees() / real.angles.len() as f64;
            let mut placed = found.pose.clone();
            (placed.side, placed.translation) = (Side::Right, real.translation);
            let [a, b] = [&placed, &real].map(|pose| skeleton.frames(pose));
            let ends: Vec<Joint> =
                Joint::ALL.into_iter().filter(|j| j.webxr_name().ends_with("tip")).collect();
            let away = ends.iter().map(|&j| (a.position(j) - b.position(j)).norm());
            tips += 1e3 * away.sum::<f64>() / ends.len() as f64;
        }
        let count = poses.len() as f64;
        Some((angles / count, tips / count))
    }
}

/// How well the clips are tracked with these options.
pub fn score(options: &ClipOptions, scenes: &[Scene]) -> Score {
    let all: Vec<Option<(f64, f64)>> = scenes.par_iter().map(|scene| scene.track(options)).collect();
    let mean = |pick: fn((f64, f64)) -> f64| {
        all.iter().map(|found| pick(found.unwrap_or(REFUSED))).sum::<f64>() / all.len().max(1) as f64
    };
    Score {
        angle: mean(|(angle, _)| angle),
        tip: mean(|(_, tip)| tip),
        refused: all.iter().filter(|found| found.is_none()).count(),
    }
}

/// A constant, and the scores with half and double of it.
#[derive(Clone, Debug)]
pub struct Row {
    /// Where it stands in the options.
    pub path: String,
    /// What it is.
    pub meaning: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// The default, or several.
    pub default: String,
    /// Where the default comes from.
    pub source: &'static str,
    /// With half and with double, where that was measured.
    pub scores: Option<[Score; 2]>,
}

/// Every constant of tracking, without scores.
pub fn rows() -> Vec<Row> {
    let mut rows = Vec::new();
    ClipOptions::default().visit(&mut |c| {
        let values: Vec<String> = c.value.values().iter().map(|v| number(*v)).collect();
        let (meaning, unit, source) = (c.meaning, c.unit, c.source);
        rows.push(Row { path: c.path, meaning, unit, default: values.join(", "), source, scores: None });
    });
    rows
}

/// A number as it is written: the shortest decimal of its single precision.
fn number(value: f64) -> String {
    format!("{}", value as f32)
}

/// The options with one constant multiplied by `factor`.
pub fn scaled(path: &str, factor: f64) -> ClipOptions {
    let mut options = ClipOptions::default();
    options.visit(&mut |c| {
        if c.path == path {
            c.value.scale(factor);
        }
    });
    options
}

/// Measures a constant halved and doubled.
pub fn measure(row: &mut Row, scenes: &[Scene]) {
    row.scores = Some([0.5, 2.0].map(|factor| score(&scaled(&row.path, factor), scenes)));
}

/// The text before the table in `spec/tuning.md`.
const ABOUT: &str = "# Tuning constants of tracking

Every constant of segmentation, fit, registration and of what surrounds them: where it stands in the options
(`ClipOptions`), its unit, its default and where that comes from. This file is written by `handcast bench tuning -o
spec/tuning.md`; a test holds names, units, defaults and sources against the code.

The last columns say what happens with half and with double the value (whole numbers rounded, several scaled together): mean
error of the joint angles in degrees and distance of the fingertips in millimetres, over rendered clips (index finger,
fist, turn, signs; made-up hands; 320 x 240), tracked from the pictures alone. A refused clip counts as 45
degrees and 100 mm. Differences below 0.1 degrees and 0.4 mm are what the lowest bits of the pictures make. Constants of two hands,
of long clips, of finders and of confidence do not show in these clips.
";

/// The content of `spec/tuning.md`.
pub fn markdown(rows: &[Row], base: Option<(Score, String)>) -> String {
    let mut text = ABOUT.to_owned();
    if let Some((base, command)) = base {
        let (angle, tip) = (base.angle, base.tip);
        let _ = write!(text, "\nMeasured with `{command}`; with the defaults {angle:.2}° and {tip:.2} mm.\n");
    }
    text.push_str(
        "\n| name | what | unit | default | source | half | double |\n|---|---|---|---|---|---|---|\n",
    );
    let cell = |score: Score| {
        let refused = if score.refused > 0 { format!(", {} refused", score.refused) } else { String::new() };
        format!("{:.2}°, {:.2} mm{refused}", score.angle, score.tip)
    };
    for row in rows {
        let [half, double] = row.scores.map_or([String::from("–"), String::from("–")], |s| s.map(cell));
        let meaning = row.meaning.replace('|', "\\|");
        let _ = writeln!(
            text,
            "| `{}` | {meaning} | {} | {} | {} | {half} | {double} |",
            row.path, row.unit, row.default, row.source
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Names, units, defaults and sources of `spec/tuning.md` are those of the code. `REGENERATE=1` writes the file
    /// anew, without scores.
    #[test]
    fn the_table_is_that_of_the_code() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../spec/tuning.md");
        let rows = rows();
        if std::env::var_os("REGENERATE").is_some() {
            std::fs::write(path, markdown(&rows, None)).unwrap();
        }
        let told = |text: &str| -> Vec<String> {
            let lines = text.lines().filter(|line| line.starts_with("| `"));
            lines.map(|line| line.split(" | ").take(5).collect::<Vec<_>>().join(" | ")).collect()
        };
        let file = std::fs::read_to_string(path).unwrap();
        assert_eq!(told(&file), told(&markdown(&rows, None)));
        assert!(rows.len() > 150);
    }
}
