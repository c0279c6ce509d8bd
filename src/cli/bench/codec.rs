//! `handcast bench codec`: rate and error of the codec on recorded and made-up motion.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use handcast_codec::for_hands;
use handcast_codec::mapping::{PoseMapper, Profile};
use handcast_eval::synth::sign_dense;
use handcast_fba::PlaneBits;
use handcast_fba::plan::{PlanOptions, PlanReport, Target, TimedBapFrame, encode_clip};
use handcast_formats::import::{ImportOptions, import};
use handcast_formats::landmarks::LandmarkClip;
use handcast_hand::shapes::ShapeLibrary;
use handcast_hand::{HandPose, Side};

use super::baselines::Baselines;
use super::curve;
use crate::cli::common::write_output;
use crate::cli::usage::positive;

/// Measures rate and error of the codec on recorded motion, against other ways to store it
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder with landmark recordings (.landmarks.jsonl), searched with its subfolders; files of still
    /// poses (.json) are strung together to sign-dense motion
    dir: PathBuf,
    /// Root mean square error aimed at, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.5, value_parser = positive)]
    target_rms: f64,
    /// Quantiser index and plain rounding instead; higher is coarser
    #[arg(long, value_name = "0-31", conflicts_with = "bitrate", value_parser = clap::value_parser!(u8).range(0..=31))]
    quant: Option<u8>,
    /// Kilobits per second instead
    #[arg(long, value_name = "KBPS", value_parser = positive)]
    bitrate: Option<f64>,
    /// Only files whose path contains this
    #[arg(long, value_name = "TEXT")]
    only: Option<String>,
    /// Write the rate-distortion curve of codec and baselines
    #[arg(long, value_name = "FILE.svg")]
    svg: Option<PathBuf>,
}

/// Frames per second at which motion is coded.
pub const RATE: f64 = 30.0;
/// Seconds and seed of sign-dense motion.
const SIGN_DENSE: (f64, u64) = (60.0, 1);
/// Quantiser index of the textbook encoder that sign-dense motion is compared with.
const TEXTBOOK_QUANT: u8 = 10;

/// A clip to measure.
pub struct CodedMotion {
    pub name: String,
    /// The folder it is in.
    group: String,
    /// Made of still poses.
    dense: bool,
    pub frames: Vec<TimedBapFrame>,
}

/// Prints the tables.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let motions = motions(&args.dir, args.only.as_deref())?;
    let mode = match (args.quant, args.bitrate) {
        (Some(quant), _) => Target::Quant(quant),
        (None, Some(rate)) => Target::Bitrate(rate),
        (None, None) => Target::Rms(args.target_rms),
    };
    let (recorded, mut dense): (Vec<CodedMotion>, Vec<CodedMotion>) =
        motions.into_iter().partition(|m| !m.dense);
    let mut rows = Vec::new();
    outln!("{:<34} {:>6}   {:^28}   {:^28}", "recorded motion", "", "offline", "live");
    outln!(
        "{:<34} {:>6}   {:>8} {:>6} {:>6} {:>5}   {:>8} {:>6} {:>6} {:>5}",
        "clip",
        "frames",
        "kbit/s",
        "rms",
        "max",
        "sent",
        "kbit/s",
        "rms",
        "max",
        "sent"
    );
    for motion in &recorded {
        let row = Row::measure(motion, mode)?;
        outln!(
            "{:<34} {:>6}   {}   {}",
            motion.name,
            motion.frames.len(),
            cells(&row.offline),
            cells(&row.live)
        );
        rows.push(row);
    }
    let mut groups: Vec<&str> = recorded.iter().map(|motion| motion.group.as_str()).collect();
    groups.dedup();
    if groups.len() > 1 {
        for group in groups {
            print_mean(&format!("mean of {group}"), rows.iter().filter(|row| row.group == group));
        }
    }
    if !rows.is_empty() {
        print_mean("mean", rows.iter());
        outln!();
        print_bits_head("bits per second");
        print_bits("offline, mean", rows.iter().map(|row| &row.offline));
        print_bits("live, mean", rows.iter().map(|row| &row.live));
        outln!();
        compare(&rows);
    }
    dense.push(built_in()?);
    outln!("\n{:<34} {:>8} {:>6} {:>6}", "sign-dense motion", "kbit/s", "rms", "max");
    let mut reports = Vec::new();
    for motion in &dense {
        reports.push(dense_rows(motion)?);
    }
    outln!();
    print_bits_head("bits per second");
    for (column, name) in ["textbook, mean", "planned, mean", "live, mean"].into_iter().enumerate() {
        print_bits(name, reports.iter().map(|row| &row[column]));
    }
    if let Some(path) = &args.svg {
        let motions = if recorded.is_empty() { &dense } else { &recorded };
        let svg = curve::draw(motions)?;
        write_output(path, svg.as_bytes())?;
        errln!("{}: rate over error, mean of {} clips", path.display(), motions.len());
    }
    Ok(())
}

/// One clip, measured.
struct Row<'a> {
    group: &'a str,
    offline: PlanReport,
    live: PlanReport,
    others: Baselines,
}

impl<'a> Row<'a> {
    fn measure(motion: &'a CodedMotion, mode: Target) -> anyhow::Result<Self> {
        let (offline, live) = (encode(motion, mode, false)?, encode(motion, mode, true)?);
        let others = Baselines::measure(&motion.frames, offline.rms_degrees)?;
        Ok(Self { group: &motion.group, offline, live, others })
    }
}

/// Encodes a motion and says what it costs.
pub fn encode(motion: &CodedMotion, mode: Target, live: bool) -> anyhow::Result<PlanReport> {
    let options = for_hands(PlanOptions { mode, live, ..PlanOptions::default() });
    Ok(encode_clip(&motion.frames, &options).with_context(|| motion.name.clone())?.1)
}

fn cells(report: &PlanReport) -> String {
    format!(
        "{:>8.3} {:>6.3} {:>6.3} {:>5}",
        report.kbit_per_s(),
        report.rms_degrees,
        report.max_degrees,
        report.sent.len()
    )
}

/// Mean rates and errors; of the largest errors the largest.
fn print_mean<'a>(name: &str, rows: impl Iterator<Item = &'a Row<'a>> + Clone) {
    let count = rows.clone().count() as f64;
    let half = |of: fn(&'a Row<'a>) -> &'a PlanReport| {
        let mean =
            |value: fn(&PlanReport) -> f64| rows.clone().map(|row| value(of(row))).sum::<f64>() / count;
        let max = rows.clone().map(|row| of(row).max_degrees).fold(0.0, f64::max);
        let (rate, rms) = (mean(PlanReport::kbit_per_s), mean(|report| report.rms_degrees));
        format!("{rate:>8.3} {rms:>6.3} {max:>6.3} {:>5}", "")
    };
    outln!("{name:<34} {:>6}   {}   {}", "", half(|row| &row.offline), half(|row| &row.live));
}

fn print_bits_head(name: &str) {
    outln!(
        "{name:<34} {:>7} {:>7} {:>7} {:>7} {:>8} {:>8} {:>7}",
        "start",
        "headers",
        "masks",
        "ranges",
        "I values",
        "P values",
        "flush"
    );
}

/// Mean bits per second by use.
fn print_bits<'a>(name: &str, reports: impl Iterator<Item = &'a PlanReport> + Clone) {
    let count = reports.clone().count() as f64;
    let mean = |part: fn(&PlaneBits) -> u64| {
        reports.clone().map(|report| part(&report.bits) as f64 / report.seconds).sum::<f64>() / count
    };
    outln!(
        "{name:<34} {:>7.0} {:>7.0} {:>7.0} {:>7.0} {:>8.0} {:>8.0} {:>7.0}",
        mean(|bits| bits.start_codes),
        mean(|bits| bits.headers),
        mean(|bits| bits.masks),
        mean(|bits| bits.ranges),
        mean(|bits| bits.intra_values),
        mean(|bits| bits.predicted_values),
        mean(|bits| bits.flush),
    );
}

/// The same motion stored in other ways.
fn compare(rows: &[Row<'_>]) {
    outln!("{:<58} {:>8} {:>8}", "the same motion in other forms, mean", "kbit/s", "times");
    let mean = |bytes: &dyn Fn(&Row<'_>) -> usize| {
        rows.iter().map(|row| bytes(row) as f64 * 8e-3 / row.offline.seconds).sum::<f64>() / rows.len() as f64
    };
    let codec = mean(&|row| row.offline.bytes);
    let print = |name: &str, rate: f64| outln!("{name:<58} {rate:>8.3} {:>8.1}", rate / codec);
    print("32-bit floats", mean(&|row| row.others.f32));
    print("16-bit floats", mean(&|row| row.others.f16));
    print("32-bit floats, whole clip through zstd -19", mean(&|row| row.others.f32_zstd));
    print("16-bit floats, whole clip through zstd -19", mean(&|row| row.others.f16_zstd));
    print("integer differences of the same error, through zstd -19", mean(&|row| row.others.deltas_zstd));
    print("FBA, live, I plane every 5 s", mean(&|row| row.live.bytes));
    print("FBA, offline, I plane every 5 s", codec);
}

/// A textbook encoder, the planner at no more error than that, and live.
fn dense_rows(motion: &CodedMotion) -> anyhow::Result<[PlanReport; 3]> {
    let textbook = encode(motion, Target::Quant(TEXTBOOK_QUANT), false)?;
    let aim = Target::Rms(textbook.rms_degrees);
    let rows = [encode(motion, aim, false)?, encode(motion, aim, true)?];
    let [planned, live] = rows;
    let name = &motion.name;
    for (how, report) in [("quantiser 10", &textbook), ("planned", &planned), ("live", &live)] {
        outln!(
            "{:<34} {:>8.3} {:>6.3} {:>6.3}",
            format!("{name}: {how}"),
            report.kbit_per_s(),
            report.rms_degrees,
            report.max_degrees
        );
    }
    Ok([textbook, planned, live])
}

/// Sign-dense motion of the shapes that come with the program.
fn built_in() -> anyhow::Result<CodedMotion> {
    let library = ShapeLibrary::builtin()?;
    let names: Vec<String> = library.names().map(str::to_owned).collect();
    let poses: Vec<HandPose> =
        names.iter().map(|name| Ok(library.get(name)?.pose(Side::Right))).collect::<anyhow::Result<_>>()?;
    Ok(CodedMotion {
        name: "built-in shapes".into(),
        group: String::new(),
        dense: true,
        frames: dense(&poses),
    })
}

fn dense(poses: &[HandPose]) -> Vec<TimedBapFrame> {
    let (seconds, seed) = SIGN_DENSE;
    bap_frames(sign_dense(poses, seconds, RATE, seed))
}

fn bap_frames(poses: Vec<(f64, HandPose)>) -> Vec<TimedBapFrame> {
    let mut mapper = PoseMapper::new(Profile::Hand);
    poses.into_iter().map(|(time, pose)| TimedBapFrame { time, baps: mapper.frame(&[pose]) }).collect()
}

/// The motions under a folder, sorted by path.
pub fn motions(dir: &Path, only: Option<&str>) -> anyhow::Result<Vec<CodedMotion>> {
    let mut files = Vec::new();
    collect(dir, &mut files)?;
    files.sort();
    files.retain(|file| only.is_none_or(|part| file.to_string_lossy().contains(part)));
    if files.is_empty() {
        bail!("no recordings in {}", dir.display());
    }
    files.iter().map(|file| motion(file).with_context(|| format!("{}", file.display()))).collect()
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

/// The motion of a file at [`RATE`].
fn motion(file: &Path) -> anyhow::Result<CodedMotion> {
    let still = file.extension().is_some_and(|extension| extension == "json");
    let (clip, _) = import(&LandmarkClip::read(file)?, &ImportOptions::default())?;
    let poses: Vec<(f64, HandPose)> =
        clip.frames.into_iter().filter(|frame| frame.valid).map(|frame| (frame.time, frame.pose)).collect();
    let frames = if still {
        dense(&poses.into_iter().map(|(_, pose)| pose).collect::<Vec<_>>())
    } else {
        bap_frames(resample(&poses))
    };
    let name = |part: Option<&std::ffi::OsStr>| part.unwrap_or_default().to_string_lossy().into_owned();
    let file_name = name(file.file_name());
    Ok(CodedMotion {
        name: file_name.trim_end_matches(".landmarks.jsonl").to_owned(),
        group: name(file.parent().and_then(Path::file_name)),
        dense: still,
        frames,
    })
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
