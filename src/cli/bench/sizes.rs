//! `handcast bench sizes`: the same motion in several formats, each at an error no larger than the stream's.

mod formats;
mod gltfpack;

use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use handcast_eval::fidelity::{CompareOptions, HandDifference, compare};
use handcast_formats::motion::Motion;
use handcast_hand::PoseClip;

use self::gltfpack::Packer;
use crate::cli::demo_clip;
use crate::cli::usage::{positive, within};

/// Measures the size of the same motion as JSON, BAP text, BVH, glTF, gltfpack, floats and integers through zstd, and as a stream
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    motion: MotionArgs,
    /// gltfpack [default: HANDCAST_GLTFPACK, that of --node, or on the PATH]
    #[arg(long, value_name = "FILE")]
    gltfpack: Option<PathBuf>,
    /// Folder with unpack.js and its packages (npm ci), which read back what gltfpack writes
    #[arg(long, value_name = "DIR", default_value = "tests/node")]
    node: PathBuf,
    /// Print the table as JSON
    #[arg(long)]
    json: bool,
}

/// Which motions are stored, and how exactly.
#[derive(Debug, clap::Args)]
pub struct MotionArgs {
    /// Motions: poses, landmark recordings, streams …; folders are searched with their subfolders for .jsonl, .fba,
    /// .bap, .glb, .bvh and .csv files [default: the motion of the built-in clip]
    motions: Vec<PathBuf>,
    /// Root mean square error the stream aims at, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.5, value_parser = positive)]
    pub target_rms: f64,
    /// Frames per second to which every motion is brought first, 1 to 240
    #[arg(long, value_name = "HZ", default_value_t = 30.0, value_parser = frame_rate)]
    pub fps: f64,
}

fn frame_rate(text: &str) -> Result<f64, String> {
    within(text, 1.0..=240.0, "frames per second")
}

impl MotionArgs {
    /// The motions of files and folders, or the built-in clip's, at so many frames per second.
    pub fn samples(&self) -> anyhow::Result<Vec<Sample>> {
        let fps = self.fps;
        if self.motions.is_empty() {
            let clip = demo_clip::poses()?;
            return Ok(vec![Sample { name: "the built-in clip".into(), clip: clip.even(fps) }]);
        }
        let mut files = Vec::new();
        for path in &self.motions {
            if path.is_dir() {
                let before = files.len();
                collect(path, &mut files)?;
                ensure!(files.len() > before, "{}: no motion in it", path.display());
            } else {
                files.push(path.clone());
            }
        }
        files.sort();
        files.dedup();
        files.iter().map(|file| sample(file, fps)).collect()
    }
}

/// A motion to store.
pub struct Sample {
    pub name: String,
    pub clip: PoseClip,
}

impl Sample {
    fn frames(&self) -> usize {
        self.clip.frames.len()
    }
}

/// A format's size and error, of one motion or of all.
#[derive(Clone, Copy, Debug, Default)]
struct Measure {
    bytes: usize,
    /// Of the angles that are ever other than 0, degrees, weighted by `frames`.
    squares: f64,
    frames: usize,
    max_deg: f64,
}

impl Measure {
    /// A size with the error that was measured otherwise: RMS and largest, degrees.
    fn new(bytes: usize, frames: usize, [rms, max_deg]: [f64; 2]) -> Self {
        Self { bytes, squares: rms * rms * frames as f64, frames, max_deg }
    }

    /// A size with the error of what was read back.
    fn of(sample: &Sample, bytes: usize, back: &PoseClip, keyed: bool) -> anyhow::Result<Self> {
        let options = CompareOptions { keyed: [false, keyed], reference: true, ..CompareOptions::default() };
        let found = compare(&sample.clip, back, &options);
        let frames: usize = found.hands.iter().map(|h| h.frames).sum();
        ensure!(
            frames == sample.frames(),
            "{}: {frames} of {} poses came back",
            sample.name,
            sample.frames()
        );
        let squares = |h: &HandDifference| h.moving_rms_deg.map_or(0.0, |rms| rms * rms * h.frames as f64);
        let squares = found.hands.iter().map(squares).sum();
        Ok(Self { bytes, squares, frames, max_deg: found.max_deg() })
    }

    fn add(&mut self, other: &Self) {
        self.bytes += other.bytes;
        self.squares += other.squares;
        self.frames += other.frames;
        self.max_deg = self.max_deg.max(other.max_deg);
    }

    fn rms_deg(&self) -> f64 {
        (self.squares / self.frames.max(1) as f64).sqrt()
    }
}

/// A row of the table.
#[derive(serde::Serialize)]
struct Row {
    format: String,
    bytes: usize,
    kbit_per_s: f64,
    /// Its size over that of the stream.
    ratio: f64,
    rms_deg: f64,
    max_deg: f64,
}

#[derive(serde::Serialize)]
struct Table {
    motions: usize,
    seconds: f64,
    frames_per_second: f64,
    rows: Vec<Row>,
    /// Formats that are missing, and why.
    left_out: Vec<String>,
}

/// Prints the table.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let samples = args.motion.samples()?;
    let told = args.gltfpack.clone().or_else(|| std::env::var_os("HANDCAST_GLTFPACK").map(PathBuf::from));
    let packer = Packer::find(told.as_deref(), &args.node);
    let mut left_out = Vec::new();
    let packer = match packer {
        Ok(packer) => Some(packer),
        Err(reason) => {
            left_out.push(format!("gltfpack -cc: {reason:#}"));
            None
        }
    };
    let mut totals: Vec<(&'static str, Measure)> = Vec::new();
    for sample in &samples {
        let rows = formats::measure(sample, args.motion.target_rms, packer.as_ref())
            .with_context(|| sample.name.clone())?;
        for (format, measure) in rows {
            match totals.iter_mut().find(|(name, _)| *name == format) {
                Some((_, total)) => total.add(&measure),
                None => totals.push((format, measure)),
            }
        }
    }
    let ours = totals.iter().find(|(name, _)| *name == formats::OURS).context("no stream")?.1;
    let seconds = ours.frames as f64 / args.motion.fps;
    let rows = totals.iter().map(|(format, m)| Row {
        format: (*format).to_owned(),
        bytes: m.bytes,
        kbit_per_s: m.bytes as f64 * 8e-3 / seconds,
        ratio: m.bytes as f64 / ours.bytes as f64,
        rms_deg: m.rms_deg(),
        max_deg: m.max_deg,
    });
    let table = Table {
        motions: samples.len(),
        seconds,
        frames_per_second: args.motion.fps,
        rows: rows.collect(),
        left_out,
    };
    if args.json {
        outln!("{}", serde_json::to_string_pretty(&table)?);
    } else {
        print(&table);
    }
    Ok(())
}

fn print(table: &Table) {
    let Table { motions, seconds, frames_per_second, .. } = table;
    let plural = if *motions == 1 { "" } else { "s" };
    outln!("{motions} motion{plural}, {seconds:.1} s at {frames_per_second} frames/s; the stream is 1\n");
    outln!("| format | bytes | kbit/s | ratio | error, ° RMS | max ° |");
    outln!("|---|---:|---:|---:|---:|---:|");
    for row in &table.rows {
        let Row { format, bytes, kbit_per_s, ratio, rms_deg, max_deg } = row;
        outln!("| {format} | {bytes} | {kbit_per_s:.2} | {ratio:.2} | {rms_deg:.4} | {max_deg:.3} |");
    }
    for reason in &table.left_out {
        outln!("\nleft out: {reason}");
    }
}

fn collect(dir: &Path, files: &mut Vec<PathBuf>) -> anyhow::Result<()> {
    for entry in std::fs::read_dir(dir).with_context(|| format!("cannot list {}", dir.display()))? {
        let path = entry?.path();
        let ending = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
        if path.is_dir() {
            collect(&path, files)?;
        } else if ["jsonl", "fba", "bap", "glb", "bvh", "csv"].contains(&ending) {
            files.push(path);
        }
    }
    Ok(())
}

fn sample(file: &Path, fps: f64) -> anyhow::Result<Sample> {
    let motion = Motion::read(file)?;
    let name = file.display().to_string();
    let clip = motion.clip.even(fps);
    if clip.frames.len() < 2 {
        bail!("{name}: no motion of a hand in it");
    }
    Ok(Sample { name, clip })
}
