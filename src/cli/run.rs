//! `handcast run` and `handcast demo`: a clip of a hand to a stream and an animated hand, with a report.

use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use handcast::codec::{decode_poses, encode_poses};
use handcast::fba::DecoderOptions;
use handcast::fidelity::{AngleError, angle_error};
use handcast::hand::{HandMesh, Person, Side, Skeleton};
use handcast::io::atomic::AtomicFile;
use handcast::io::avi::MjpegWriter;
use handcast::io::frames::FrameSource;
use handcast::io::person::write_person;
use handcast::io::poses::{PoseClip, TimedPose};
use handcast::pipeline::{ClipSink, ClipStart, TrackedClip, TrackedFrame, draw_overlay, track_clip};
use handcast::render::{Style, preview_sheet};
use handcast::track::View;
use image::codecs::png::PngEncoder;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::common::{RateArgs, TrackArgs};
use super::decode::stream_facts;
use super::glb_out::GlbArgs;

/// Tracks the hand in a clip and writes stream, animated hand, overlay, preview and report
#[derive(Debug, clap::Args)]
pub struct Args {
    /// MP4/MOV, AVI, animated GIF/PNG/WebP, Y4M (- for standard input), a folder or "glob" of pictures
    clip: PathBuf,
    #[command(flatten)]
    work: Work,
}

/// The same on the clip built into the program, whose true poses are known
#[derive(Debug, clap::Args)]
pub struct DemoArgs {
    #[command(flatten)]
    work: Work,
}

/// What both do.
#[derive(Debug, clap::Args)]
struct Work {
    /// Folder for the results
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    #[command(flatten)]
    track: TrackArgs,
    #[command(flatten)]
    rate: RateArgs,
    #[command(flatten)]
    glb: GlbArgs,
    /// Leave out the overlay and the preview
    #[arg(long)]
    no_pictures: bool,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
    /// No progress bar, no report on standard output
    #[arg(short, long)]
    quiet: bool,
}

/// Runs `handcast run`.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let name = args.clip.display().to_string();
    args.work.in_output(|work| work.run(&args.clip, &name, None))
}

/// The demo clip and its true poses, made by `handcast synth` (fixtures/README.md).
pub(super) const DEMO_CLIP: &[u8] = include_bytes!("../../fixtures/demo.avi");
pub(super) const DEMO_POSES: &[u8] = include_bytes!("../../fixtures/demo.poses.jsonl");

/// Runs `handcast demo`.
pub fn demo(args: &DemoArgs) -> anyhow::Result<()> {
    args.work.in_output(|work| {
        let clip = work.output.join("demo.avi");
        AtomicFile::write_all_to(&clip, DEMO_CLIP)?;
        let reader = handcast::io::poses::PoseReader::new(DEMO_POSES)?;
        work.run(&clip, "the built-in clip", Some(PoseClip::from_reader(reader)?))
    })
}

/// What is known of a finished run. The fields are the keys of report.json.
#[derive(Debug, serde::Serialize)]
struct Report {
    clip: String,
    frames: usize,
    tracked_frames: usize,
    mean_iou: f64,
    worst_iou: f64,
    worst_frame: usize,
    hand: &'static str,
    view: View,
    view_assumed: bool,
    open_frame: usize,
    fit_iou: f64,
    seconds: f64,
    frames_per_second: f64,
    stream_bytes: usize,
    kbit_per_s: f64,
    planes: u64,
    coding_rms_deg: f64,
    coding_max_deg: f64,
    evaluations_per_frame: f64,
    restarts: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    truth: Option<AngleError>,
    /// Frames per second of each stage.
    fps: Stages,
    wall_seconds: f64,
    lost: Vec<usize>,
}

#[derive(Debug, serde::Serialize)]
struct Stages {
    decode: f64,
    segment: f64,
    track: f64,
    overlay: f64,
    encode: f64,
    decode_stream: f64,
    gltf: f64,
    total: f64,
}

impl Report {
    fn text(&self) -> String {
        use std::fmt::Write as _;
        let mut t = String::new();
        let assumed = if self.view_assumed { " (palm assumed; see --hand, --view)" } else { "" };
        let view = if self.view == View::Palm { "palm" } else { "back" };
        let _ = writeln!(t, "{}: {} of {} frames tracked", self.clip, self.tracked_frames, self.frames);
        let _ = writeln!(
            t,
            "  hand        {} hand, {view}{assumed}; fitted on frame {}, overlap {:.3}",
            self.hand, self.open_frame, self.fit_iou
        );
        let _ = writeln!(
            t,
            "  overlap     mean IoU {:.3}, worst {:.3} (frame {})",
            self.mean_iou, self.worst_iou, self.worst_frame
        );
        if let Some(truth) = &self.truth {
            let _ = writeln!(
                t,
                "  truth       joint angles off by {:.2}° on average, {:.2}° RMS",
                truth.mean_deg, truth.rms_deg
            );
        }
        let _ = writeln!(
            t,
            "  stream      {} bytes, {:.2} kbit/s; coding error {:.2}° RMS, {:.2}° at most",
            self.stream_bytes, self.kbit_per_s, self.coding_rms_deg, self.coding_max_deg
        );
        let f = &self.fps;
        let _ = writeln!(
            t,
            "  frames/s    decode {:.0}, segment {:.0}, track {:.0}, encode {:.0}, decode stream {:.0}, glTF {:.0}; whole run {:.1}",
            f.decode, f.segment, f.track, f.encode, f.decode_stream, f.gltf, f.total
        );
        t
    }
}

impl Work {
    /// Makes the output folder for the work, and takes it away again if the work fails and leaves it empty.
    fn in_output(&self, work: impl FnOnce(&Self) -> anyhow::Result<()>) -> anyhow::Result<()> {
        let fresh = !self.output.exists();
        std::fs::create_dir_all(&self.output)
            .with_context(|| format!("cannot make the folder {}", self.output.display()))?;
        let result = work(self);
        if result.is_err() && fresh {
            // Fails, as it should, when there is something in it.
            let _ = std::fs::remove_dir(&self.output);
        }
        result
    }

    fn run(&self, path: &Path, name: &str, truth: Option<PoseClip>) -> anyhow::Result<()> {
        let begun = Instant::now();
        let glb_out = self.glb.read()?;
        let options = self.track.clip_options()?;
        let (source, masks) = self.track.open(path)?;
        let mut sink = Sink::new(self, source.as_ref());
        let clip = track_clip(source, masks, &options, &mut sink)?;
        let (overlay, overlay_time) = sink.finish()?;

        let poses = PoseClip { header: clip.header(), frames: clip.poses() };
        poses.write(&self.output.join("poses.jsonl"))?;
        let person = Person { name: None, hand: Some(clip.side()), morphology: clip.morphology().clone() };
        write_person(&self.output.join("person.toml"), &person)?;
        if let Some(overlay) = overlay {
            overlay.commit()?;
        }
        let stage = Instant::now();
        let encoded = encode_poses(&poses, self.rate.profile.into(), &self.rate.plan())?;
        let encode = stage.elapsed();
        let plan = &encoded.report;
        let stream_path = self.output.join("hand.fba");
        AtomicFile::write_all_to(&stream_path, &encoded.stream)?;

        // From here on only what the file holds counts.
        let stage = Instant::now();
        let bytes = std::fs::read(&stream_path)?;
        let options = DecoderOptions {
            steps: self.rate.steps.into(),
            ranges: self.rate.ranges.into(),
            ..DecoderOptions::default()
        };
        let mut decoded = decode_poses(&bytes, Some(self.rate.profile.into()), options)?;
        let decode_stream = stage.elapsed();
        for hand in &mut decoded.clip.header.hands {
            hand.morphology = Some(clip.morphology().clone());
        }
        decoded.clip.header.made_by = Some(format!("handcast {}", env!("CARGO_PKG_VERSION")));
        let coding = angle_error(&encoded.clip, &decoded.clip, decoded.rate);
        let sent = encoded.clip.frames.iter().filter(|f| f.valid).count();
        if coding.frames < sent {
            bail!("only {} of {sent} poses came back out of the stream", coding.frames);
        }

        let stage = Instant::now();
        let facts = stream_facts(&decoded, bytes.len());
        let glb = glb_out.write(&decoded.clip, clip.morphology(), facts)?;
        let gltf = stage.elapsed();

        AtomicFile::write_all_to(self.output.join("hand.glb"), &glb)?;
        if !self.no_pictures {
            write_preview(&decoded.clip, clip.side(), &clip, &self.output.join("preview.png"))?;
        }

        let n = clip.frames.len();
        let per_second = |time: Duration| n as f64 / time.as_secs_f64().max(1e-9);
        let (mean_iou, worst_iou) = clip.iou();
        let wall = begun.elapsed();
        let report = Report {
            clip: name.to_owned(),
            frames: n,
            tracked_frames: clip.tracked_frames(),
            mean_iou,
            worst_iou,
            worst_frame: (0..n)
                .min_by(|&a, &b| clip.frames[a].1.iou.total_cmp(&clip.frames[b].1.iou))
                .unwrap_or(0),
            hand: clip.side().name(),
            view: clip.start.view,
            view_assumed: clip.start.assumed,
            open_frame: clip.start.frame,
            fit_iou: clip.start.fit.iou,
            seconds: plan.seconds,
            frames_per_second: decoded.rate,
            stream_bytes: bytes.len(),
            kbit_per_s: plan.kbit_per_s(),
            planes: plan.planes,
            coding_rms_deg: coding.rms_deg,
            coding_max_deg: coding.max_deg,
            evaluations_per_frame: clip.frames.iter().map(|f| f.1.evaluations).sum::<usize>() as f64
                / n as f64,
            restarts: clip.frames.iter().filter(|f| f.1.restarted).count(),
            truth: truth.map(|truth| angle_error(&truth, &poses, decoded.rate)),
            fps: Stages {
                decode: per_second(clip.timings.decode),
                segment: per_second(clip.timings.segment),
                track: per_second(clip.timings.track),
                overlay: per_second(overlay_time),
                encode: per_second(encode),
                decode_stream: per_second(decode_stream),
                gltf: per_second(gltf),
                total: per_second(wall),
            },
            wall_seconds: wall.as_secs_f64(),
            lost: (0..n).filter(|&i| !clip.frames[i].1.valid).collect(),
        };
        let json = serde_json::to_string_pretty(&report)?;
        AtomicFile::write_all_to(self.output.join("report.json"), json.as_bytes())?;
        let text = report.text();
        AtomicFile::write_all_to(self.output.join("report.txt"), text.as_bytes())?;
        if self.json {
            outln!("{json}");
        } else if !self.quiet {
            out!("{text}");
            outln!("  results     {}", self.output.display());
        }
        Ok(())
    }
}

/// The progress bar and the overlay.
struct Sink {
    bar: ProgressBar,
    /// `None` when no overlay is wanted.
    overlay: Option<PathBuf>,
    rate: f64,
    writer: Option<MjpegWriter<AtomicFile>>,
    time: Duration,
}

impl Sink {
    fn new(work: &Work, source: &dyn FrameSource) -> Self {
        let show = !work.quiet && !work.json && std::io::stderr().is_terminal();
        let target = if show { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        let bar = ProgressBar::with_draw_target(source.info().frames.map(|n| n as u64), target);
        if let Ok(style) = ProgressStyle::with_template("{msg:10} {wide_bar} {pos}/{len} {per_sec} {eta}") {
            bar.set_style(style);
        }
        bar.set_message("looking");
        Self {
            bar,
            overlay: (!work.no_pictures).then(|| work.output.join("overlay.avi")),
            rate: source.info().rate.unwrap_or(work.track.fps),
            writer: None,
            time: Duration::ZERO,
        }
    }

    /// The overlay, complete but not yet under its name, and the time it took.
    fn finish(self) -> anyhow::Result<(Option<AtomicFile>, Duration)> {
        self.bar.finish_and_clear();
        let file = self.writer.map(MjpegWriter::finish).transpose()?;
        Ok((file, self.time))
    }

    fn draw(&mut self, frame: &mut TrackedFrame<'_>) -> anyhow::Result<()> {
        let Some(path) = &self.overlay else { return Ok(()) };
        let picture = draw_overlay(frame);
        let writer = match &mut self.writer {
            Some(writer) => writer,
            empty => {
                let file = AtomicFile::create(path)?;
                let rate = MjpegWriter::<AtomicFile>::rate_of(self.rate);
                empty.insert(MjpegWriter::new(file, picture.dimensions(), rate, 80)?)
            }
        };
        Ok(writer.write(&picture)?)
    }
}

impl ClipSink for Sink {
    fn read(&mut self, index: usize) {
        self.bar.set_position(index as u64 + 1);
    }

    fn fitted(&mut self, _start: &ClipStart) {
        self.bar.set_message("tracking");
    }

    fn tracked(&mut self, mut frame: TrackedFrame<'_>) -> Result<(), String> {
        let begun = Instant::now();
        let drawn = self.draw(&mut frame).map_err(|e| format!("overlay: {e:#}"));
        self.time += begun.elapsed();
        drawn
    }
}

/// A contact sheet of the decoded hand.
fn write_preview(decoded: &PoseClip, side: Side, clip: &TrackedClip, path: &Path) -> anyhow::Result<()> {
    let mesh = HandMesh::generate(clip.morphology(), side);
    let skeleton = Skeleton::new(clip.morphology(), side);
    let frames: Vec<_> = decoded.of(side).map(|f: &TimedPose| (f.time, skeleton.frames(&f.pose))).collect();
    let sheet = preview_sheet(&mesh, &frames, 12, 4, (320, 320), &Style::default());
    let mut file = AtomicFile::create(path)?;
    sheet.write_with_encoder(PngEncoder::new(&mut file))?;
    file.commit().with_context(|| format!("cannot write {}", path.display()))
}
