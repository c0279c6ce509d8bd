//! `handcast bench corpus`: what a corpus costs, in time and in bytes.

use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use handcast_codec::decode_poses;
use handcast_corpus::{Choice, Corpus, Kind, Outcome, Settings, Worker};
use handcast_fba::DecoderOptions;
use handcast_formats::motion::{Format, WriteOptions};

use crate::cli::common::{RateArgs, Scratch, limits};
use crate::cli::corpus::cores;
use crate::cli::tracking::TrackArgs;

/// Measures time and bytes of a folder of clips and motions: clips an hour, streams beside the inputs and .pose files, and, where
/// no motions are among them, what a million clips of ten seconds cost at that
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder with clips and motion files
    input: PathBuf,
    /// Inputs that are worked on at a time, 1 to 1024 [default: one for each core]
    #[arg(short, long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    #[command(flatten)]
    track: TrackArgs,
    #[command(flatten)]
    rate: RateArgs,
}

/// What was measured. The fields are the keys of the JSON report.
#[derive(Debug, Default, serde::Serialize)]
struct Cost {
    inputs: u64,
    failed: u64,
    /// Clips that were tracked; what else was done are motions.
    clips: u64,
    /// Of motion in all streams.
    seconds: f64,
    jobs: usize,
    wall_seconds: f64,
    /// Of all cores; none where the system does not tell.
    cpu_seconds: Option<f64>,
    /// Of these clips; none without one.
    clips_per_hour: Option<f64>,
    input_bytes: u64,
    stream_bytes: u64,
    /// The decoded poses as `.pose` files.
    pose_bytes: u64,
    /// The same through zstd -19.
    pose_zstd_bytes: u64,
}

/// Seconds of a clip, and how many of them.
const CLIP: f64 = 10.0;
const CLIPS: f64 = 1e6;

impl Cost {
    /// Whether clips alone were done: motions need no tracking, and tell nothing of what clips cost.
    fn is_of_clips(&self) -> bool {
        self.clips > 0 && self.clips + self.failed == self.inputs
    }

    /// Bytes of a million clips, in units of 10⁹.
    fn gigabytes(&self, bytes: u64) -> f64 {
        bytes as f64 / self.seconds * CLIP * CLIPS / 1e9
    }
}

/// Runs the measurement.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let folder = Scratch::new("corpus")?;
    let (track, finder) = args.track.settings()?;
    let settings = Settings { track, encode: args.rate.settings() };
    let mut corpus = Corpus::open(&args.input, &folder.0, &settings, &Choice::default())?;
    let worker =
        Worker::new(&args.input, &folder.0, &settings).with_finder(finder).with_limits(limits().clone());
    let mut cost = Cost { jobs: args.jobs.map_or_else(cores, usize::from), ..Cost::default() };
    let mut streams = Vec::new();
    let before = cpu_seconds();
    let begun = std::time::Instant::now();
    corpus.run(&worker, cost.jobs, &mut |_, outcome| match outcome {
        Outcome::Done(entry) => {
            cost.inputs += 1;
            cost.clips += u64::from(entry.kind == Kind::Clip);
            cost.seconds += entry.seconds;
            cost.input_bytes += entry.input_bytes;
            cost.stream_bytes += entry.bytes;
            streams.push(entry.stream.clone());
        }
        Outcome::Failed(failure) => {
            cost.inputs += 1;
            cost.failed += 1;
            errln!("handcast: {}: {}", failure.name, failure.error);
        }
    })?;
    cost.wall_seconds = begun.elapsed().as_secs_f64();
    cost.cpu_seconds = before.zip(cpu_seconds()).map(|(before, after)| after - before);
    cost.clips_per_hour = (cost.clips > 0).then(|| 3600.0 * cost.clips as f64 / cost.wall_seconds);
    ensure!(cost.seconds > 0.0, "{}: no clip and no motion that could be done in it", args.input.display());
    for stream in &streams {
        let pose = pose_file(&folder.0.join(stream))?;
        cost.pose_bytes += pose.len() as u64;
        cost.pose_zstd_bytes += zstd::bulk::compress(&pose, 19)?.len() as u64;
    }
    if args.track.json {
        outln!("{}", serde_json::to_string_pretty(&cost)?);
    } else {
        print(&cost);
    }
    Ok(())
}

fn print(cost: &Cost) {
    let Cost { inputs, failed, clips, seconds, jobs, wall_seconds, .. } = cost;
    outln!(
        "{inputs} inputs, {clips} of them clips, {failed} failed, {seconds:.1} s of motion; {jobs} at a time"
    );
    let speed = cost.clips_per_hour.map_or_else(|| "–".to_owned(), |clips| format!("{clips:.0}"));
    outln!("{wall_seconds:.2} s, {speed} clips an hour");
    if let Some(cpu) = cost.cpu_seconds {
        outln!("{cpu:.2} s of cores, {:.3} for a second of motion", cpu / seconds);
        if cost.is_of_clips() {
            outln!("a million clips of 10 s: {:.0} core-hours", cpu / seconds * CLIP * CLIPS / 3600.0);
        }
    }
    let million = |bytes| match cost.is_of_clips() {
        true => format!("{:.2} GB", cost.gigabytes(bytes)),
        false => "–".to_owned(),
    };
    outln!("\n| | bytes | kbit/s | ratio | a million clips of 10 s |\n|---|---:|---:|---:|---:|");
    for (name, bytes) in [
        ("inputs", cost.input_bytes),
        (".pose", cost.pose_bytes),
        (".pose, zstd -19", cost.pose_zstd_bytes),
        ("streams", cost.stream_bytes),
    ] {
        let (rate, ratio) = (bytes as f64 * 8e-3 / seconds, bytes as f64 / cost.stream_bytes as f64);
        outln!("| {name} | {bytes} | {rate:.2} | {ratio:.1} | {} |", million(bytes));
    }
}

/// The poses of a stream as a `.pose` file.
fn pose_file(stream: &Path) -> anyhow::Result<Vec<u8>> {
    let name = || stream.display().to_string();
    let decoded = decode_poses(&std::fs::read(stream).with_context(name)?, None, DecoderOptions::default())?;
    let format = Format::by_id("pose").context("no format pose")?;
    Ok(format.write(&decoded.clip, &WriteOptions::default()).with_context(name)?.bytes)
}

/// Clock ticks a second in which Linux counts a process's time for its readers (USER_HZ).
const TICKS: f64 = 100.0;

/// Seconds of all cores that this process has had, in proc(5)'s `utime` and `stime`.
fn cpu_seconds() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // The second field is the program's name in brackets, which may hold anything.
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace().skip(11);
    let mut ticks = || fields.next()?.parse::<f64>().ok();
    Some((ticks()? + ticks()?) / TICKS)
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn work_costs_time_of_cores() {
        let before = cpu_seconds().unwrap();
        let begun = std::time::Instant::now();
        let mut x = 1u64;
        while cpu_seconds().unwrap() < before + 0.05 {
            x = std::hint::black_box(x).wrapping_mul(3);
            assert!(begun.elapsed().as_secs() < 60);
        }
    }
}
