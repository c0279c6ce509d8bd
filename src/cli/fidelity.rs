//! `handcast fidelity`: the round trip measured at every seam, as text, JSON and a page.

use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use handcast_codec::clip_rate;
use handcast_eval::fidelity::{
    FidelityOptions, FidelityReport, ImportSeam, MeasuredClip, RoundTrip, gallery, measure, measure_clip,
    measure_mirrored, of_tracking, page,
};
use handcast_formats::motion::{Format, Motion};
use handcast_formats::mp4;
use handcast_hand::PoseClip;
use handcast_media::{FrameSource, Part};

use super::beside::{check_times, notice_of_truth};
use super::common::{
    RateArgs, Scratch, busy, check_span, ending, limits, read_input, tell_shortfall, write_output,
};
use super::demo_clip;
use super::given;
use super::loss::{self, LossArgs};
use super::tracking::{OF_CLIPS, TrackArgs};
use super::usage::positive;

/// Measures the round trip of a clip or of poses at every seam, and writes a page about it
///
/// Clips are tracked first; their true poses are taken from --truth, or from CLIP.poses.jsonl beside the clip, where
/// `handcast synth` writes them. Without input the clip built into the program is measured.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Clip (video, folder or glob of pictures), or motion: .jsonl, .json, .csv, .fba, .bap, .glb, .gltf, .vrma, .bvh, joints
    /// of other programs (all that import reads)
    input: Option<PathBuf>,
    /// Report to write: a page (.html) or its facts (.json; of --loss facts alone)
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// True poses of the clip, in its camera's frame; the joint angles ever other than 0 in them are measured, in the frames that
    /// have one
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// Leave out the mirrored clip and motion, with the other hand
    #[arg(long, alias = "no-mirror")]
    no_symmetry: bool,
    /// Leave out the rate over the error, which codes the motion two dozen times
    #[arg(long)]
    no_curve: bool,
    /// Frames per second of inputs that do not say (folders)
    #[arg(long, value_name = "HZ", default_value_t = 30.0, value_parser = positive)]
    input_fps: f64,
    #[command(flatten)]
    track: TrackArgs,
    #[command(flatten)]
    rate: RateArgs,
    #[command(flatten)]
    loss: LossArgs,
}

/// True poses, and the file that they are of.
struct Truth(PathBuf, PoseClip);

impl Truth {
    fn read(path: &Path) -> anyhow::Result<Self> {
        Ok(Self(path.to_owned(), Motion::read_within(path, limits())?.clip))
    }

    /// Makes sure that they may be of a clip: both are counted from their first instant.
    fn check(&self, source: &dyn FrameSource) -> anyhow::Result<()> {
        let Self(file, poses) = self;
        let first = poses.frames.first().map_or(0.0, |pose| pose.time);
        let mut times: Vec<f64> = poses.frames.iter().map(|pose| pose.time - first).collect();
        times.dedup();
        check_times(file, "true poses", &times, source, Part::WHOLE)
    }
}

/// What is measured.
enum Input {
    /// A clip, the name it goes by, and its true poses, if they are known.
    Clip(PathBuf, String, Option<Truth>),
    /// Poses from a file.
    Poses(Box<Motion>, String),
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let page_wanted = match &args.output {
        None => false,
        Some(path) => match ending(path).as_str() {
            "html" | "htm" => true,
            "json" => false,
            _ => refuse!("{}: cannot write this kind, allowed are .html and .json", path.display()),
        },
    };
    if args.loss.loss.is_some() && page_wanted {
        refuse!("losses are written as facts: give the report a name that ends in .json");
    }
    // Kept until the clip has been read.
    let folder = match &args.input {
        Some(_) => None,
        None => Some(Scratch::new("fidelity")?),
    };
    let options = FidelityOptions {
        profile: args.rate.profile.into(),
        plan: args.rate.plan(),
        max_gap: args.rate.max_gap(),
        curve: !args.no_curve,
        mirror: !args.no_symmetry,
    };
    let input = input(args, folder.as_ref())?;
    if let Some(share) = args.loss.loss {
        let clip = match input {
            Input::Poses(motion, _) => motion.clip,
            Input::Clip(path, ..) => found(args, &path)?,
        };
        let to = (args.output.as_deref(), args.track.json, args.track.quiet);
        return loss::run(&args.loss, share, &clip, &args.rate, to);
    }
    let (report, trip, measured) = match input {
        Input::Poses(motion, name) => {
            let (mut report, trip) = measure(&name, &motion.clip, &options)?;
            report.import = motion.import.as_ref().map(ImportSeam::from);
            (report, trip, None)
        }
        Input::Clip(path, name, truth) => tracked(args, &path, &name, truth.as_ref(), &options)?,
    };
    let json = serde_json::to_string_pretty(&report)?;
    if let Some(path) = &args.output {
        if page_wanted {
            write_output(path, page(&report, &gallery(&trip, measured.as_ref())).as_bytes())?;
        } else {
            write_output(path, json.as_bytes())?;
        }
    }
    if args.track.json {
        outln!("{json}");
    } else if !args.track.quiet {
        out!("{report}");
        if let Some(path) = &args.output {
            outln!("  report      {}", path.display());
        }
    }
    Ok(())
}

fn input(args: &Args, folder: Option<&Scratch>) -> anyhow::Result<Input> {
    let truth = args.truth.as_deref().map(Truth::read).transpose()?;
    if let Some(folder) = folder {
        let clip = folder.0.join("demo.avi");
        demo_clip::write(&clip)?;
        let built_in = Truth(clip.clone(), demo_clip::poses()?);
        return Ok(Input::Clip(clip, "the built-in clip".into(), Some(truth.unwrap_or(built_in))));
    }
    let path = args.input.as_deref().context("no input")?;
    let name =
        path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned());
    // Everything else is a clip; an MP4 file with a stream alone is none.
    if Format::by_name(path).is_some() || holds_stream_alone(path) {
        if args.truth.is_some() {
            refuse!("{name}: --truth goes with clips; to compare two motions: handcast compare");
        }
        given::note_idle(format_args!("{name} is no clip"), &OF_CLIPS);
        let motion = Motion::read_within(path, limits())?;
        ensure!(!motion.clip.frames.is_empty(), "{name}: it moves no hand");
        check_span(&motion.clip, clip_rate(&motion.clip)).with_context(|| name.clone())?;
        return Ok(Input::Poses(Box::new(motion), name));
    }
    let beside = path.with_extension("poses.jsonl");
    let truth = match truth {
        None if beside.is_file() => Some(Truth::read(&beside)?),
        truth => truth,
    };
    Ok(Input::Clip(path.to_owned(), name, truth))
}

/// Whether a file is an MP4 file with a stream, but no clip.
fn holds_stream_alone(path: &Path) -> bool {
    ending(path) == "mp4"
        && std::fs::metadata(path).is_ok_and(|file| file.len() <= mp4::STREAM_ALONE_BYTES)
        && read_input(path, None).is_ok_and(|bytes| mp4::is_stream_alone(&bytes))
}

/// The poses of a clip.
fn found(args: &Args, path: &Path) -> anyhow::Result<PoseClip> {
    let (source, masks) = args.track.open(path, args.input_fps)?;
    let joints = args.track.joints(source.as_ref(), Part::WHOLE)?;
    let track = args.track.options(joints.as_ref())?;
    let bar = args.track.progress(path, source.as_ref());
    let measured = measure_clip(source, masks, &track, None, &mut |read| bar.set_position(read as u64))
        .with_context(|| path.display().to_string())?;
    bar.finish_and_clear();
    tell_shortfall(path, measured.clip.shortfall.as_deref());
    Ok(PoseClip { header: measured.clip.header(), frames: measured.clip.poses() })
}

/// Tracks a clip, also in the mirror, and measures the rest of the way with the poses found.
fn tracked(
    args: &Args,
    path: &Path,
    name: &str,
    truth: Option<&Truth>,
    options: &FidelityOptions,
) -> anyhow::Result<(FidelityReport, RoundTrip, Option<MeasuredClip>)> {
    let (source, masks) = args.track.open(path, args.input_fps)?;
    truth.map(|truth| truth.check(source.as_ref())).transpose()?;
    let (file, truth) = truth.map(|Truth(file, poses)| (file, poses)).unzip();
    let joints = args.track.joints(source.as_ref(), Part::WHOLE)?;
    let track = args.track.options(joints.as_ref())?;
    let bar = args.track.progress(path, source.as_ref());
    let mut measured = measure_clip(source, masks, &track, truth, &mut |read| bar.set_position(read as u64))
        .with_context(|| path.display().to_string())?;
    bar.finish_and_clear();
    tell_shortfall(path, measured.clip.shortfall.as_deref());
    if measured.seam.hands > 1 {
        errln!("handcast: {name}: two hands; the first is measured, --hand chooses");
    }
    if let Some((truth, file)) = truth.zip(file) {
        let found = measured.clip.hands.first().context("no hand was found")?;
        ensure!(
            truth.of(found.start.side).next().is_some(),
            "the true poses are not of the {} hand that was found (see --hand, --view)",
            found.start.side.name()
        );
        if let Some(notice) = notice_of_truth(file, truth, found, &measured.clip.times) {
            errln!("handcast: {notice}");
        }
    }
    if options.mirror {
        let (source, masks) = args.track.open(path, args.input_fps)?;
        measured.seam.mirror = Some(measure_mirrored(source, masks, &track, truth, &measured)?);
    }
    let poses = PoseClip { header: measured.clip.header(), frames: measured.clip.poses() };
    let bar = busy(!args.track.quiet && !args.track.json, "measuring");
    let (mut report, trip) = measure(name, &poses, options)?;
    bar.finish_and_clear();
    report.latency.splice(0..0, of_tracking(&measured.clip.timings.frames));
    report.tracking = Some(measured.seam.clone());
    Ok((report, trip, Some(measured)))
}
