//! `handcast encode`: poses to an FBA stream.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use handcast_codec::ties::hand_ties;
use handcast_codec::{PoseEncoder, clip_rate, poses_on_ticks};
use handcast_fba::FrameRate;
use handcast_fba::bap::{epf, text};
use handcast_fba::encode_epf;
use handcast_fba::plan::{PlanOptions, PlanReport, encode_clip};
use handcast_formats::motion::{BapTrack, clip_from_glb};
use handcast_formats::poses::PoseReader;
use handcast_hand::PoseClip;

use super::common::{RateArgs, ending, open_input, read_input, warn_of_far_hands, write_output};

/// Largest input that is read, bytes.
const MAX_INPUT: u64 = 1 << 30;

/// Turns poses, BAP text or an animated hand into an FBA stream
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Poses (.jsonl, or - for standard input), BAP text (.bap), or a GLB made by this program (.glb)
    input: PathBuf,
    /// Stream to write (.fba, or - for standard output)
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Encoder parameter file that makes every choice (.bap input only)
    #[arg(long, value_name = "FILE", conflicts_with_all = ["rate", "ranges", "derive"])]
    epf: Option<PathBuf>,
    #[command(flatten)]
    rate: RateArgs,
    /// Print the account of the stream as JSON
    #[arg(long)]
    json: bool,
    /// Say nothing on success
    #[arg(short, long)]
    quiet: bool,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let name = args.input.display();
    let read = || read_input(&args.input, MAX_INPUT);
    let plan = args.rate.plan();
    let (stream, report) = match (ending(&args.input).as_str(), &args.epf) {
        ("bap", Some(path)) => return encode_as_told(args, path, &plan),
        ("bap", None) => {
            let file = text::read(&String::from_utf8_lossy(&read()?)).with_context(|| format!("{name}"))?;
            let rate = FrameRate::nearest(file.rate)
                .with_context(|| format!("{name}: {} frames/s cannot be written", file.rate))?;
            let frames = BapTrack::from(&file).frames;
            encode_clip(&frames, &PlanOptions { rate, ties: hand_ties(), ..plan })?
        }
        (_, Some(_)) => bail!("{name}: --epf goes with a .bap file"),
        ("glb", _) => encoded(from_glb(&read()?).with_context(|| format!("{name}"))?, args, &plan)?,
        ("jsonl" | "json" | "", _) => {
            let reader = PoseReader::new(open_input(&args.input, MAX_INPUT)?);
            let clip = reader.and_then(PoseReader::into_clip).with_context(|| format!("{name}"))?;
            encoded(clip, args, &plan)?
        }
        (other, _) => bail!("{name}: cannot encode .{other}, allowed are .jsonl, .bap and .glb"),
    };
    write_output(&args.output, &stream)?;
    say(args, &report)
}

/// Says what the stream costs.
fn say(args: &Args, report: &PlanReport) -> anyhow::Result<()> {
    if let Some(wanted) = args.rate.bitrate
        && !args.quiet
    {
        say_what_the_rate_cost(wanted, report);
    }
    if args.json {
        let account = serde_json::to_string(&account(report))?;
        // The stream itself may be on standard output.
        if args.output.as_os_str() == "-" { eprintln!("{account}") } else { outln!("{account}") }
    } else if !args.quiet {
        eprintln!(
            "{}: {} frames in {} planes, {} bytes, {:.2} kbit/s, {:.2}° RMS, {:.2}° at most",
            args.output.display(),
            report.frames,
            report.planes,
            report.bytes,
            report.kbit_per_s(),
            report.rms_degrees,
            report.max_degrees
        );
    }
    Ok(())
}

/// Writes the stream of BAP text for which an encoder parameter file makes every choice.
fn encode_as_told(args: &Args, parameters: &Path, plan: &PlanOptions) -> anyhow::Result<()> {
    let words = read_input(&args.input, MAX_INPUT)?;
    let file =
        text::read(&String::from_utf8_lossy(&words)).with_context(|| args.input.display().to_string())?;
    let words = read_input(parameters, MAX_INPUT)?;
    let frames =
        epf::read(&String::from_utf8_lossy(&words)).with_context(|| parameters.display().to_string())?;
    let stream = encode_epf(&file, &frames, plan.steps)?;
    write_output(&args.output, &stream)?;
    if !args.quiet {
        eprintln!("{}: {} planes, {} bytes", args.output.display(), frames.len(), stream.len());
    }
    Ok(())
}

/// The stream of poses, which are let go before it is planned.
fn encoded(clip: PoseClip, args: &Args, plan: &PlanOptions) -> anyhow::Result<(Vec<u8>, PlanReport)> {
    let profile = args.rate.profile.into();
    if !args.quiet {
        warn_of_far_hands(&clip, profile);
    }
    let mut encoder = PoseEncoder::for_clip(&clip, profile, plan)?;
    let mut stream = Vec::new();
    for pose in poses_on_ticks(&clip, encoder.rate()) {
        stream.extend(encoder.push(&pose)?);
    }
    drop(clip);
    let end = encoder.finish()?;
    stream.extend(end.bytes);
    Ok((stream, end.report))
}

/// Largest error in degrees up to which a bit rate counts as held without harm.
const HARMLESS: f64 = 5.0;

/// Warns when the rate was missed, or held only with errors that show.
fn say_what_the_rate_cost(wanted: f64, report: &PlanReport) {
    let mean = report.kbit_per_s();
    let ([least, most], worst) = (report.window_kbit_per_s.unwrap_or([mean; 2]), report.max_degrees);
    if most > 1.05 * wanted || report.windows_missed > Some(0) {
        eprintln!(
            "handcast: {wanted} kbit/s could not be held: {least:.2} to {most:.2} kbit/s over ten seconds, with errors \
             up to {worst:.1} degrees"
        );
    } else if worst > HARMLESS {
        eprintln!("handcast: {wanted} kbit/s could not be held without errors of up to {worst:.1} degrees");
    }
}

/// What the stream costs and how far off it is.
pub fn account(report: &PlanReport) -> serde_json::Value {
    serde_json::json!({
        "frames": report.frames,
        "planes": report.planes,
        "intra_planes": report.intra_planes,
        "seconds": report.seconds,
        "stream_bytes": report.bytes,
        "kbit_per_s": report.kbit_per_s(),
        "window_kbit_per_s": report.window_kbit_per_s,
        "windows_missed": report.windows_missed,
        "resting_seconds": report.resting_seconds,
        "coding_rms_deg": report.rms_degrees,
        "coding_max_deg": report.max_degrees,
        "bits": {
            "start_codes": report.bits.start_codes,
            "headers": report.bits.headers,
            "masks": report.bits.masks,
            "ranges": report.bits.ranges,
            "intra_values": report.bits.intra_values,
            "predicted_values": report.bits.predicted_values,
            "flush": report.bits.flush,
            "filler": report.filler,
        },
        "quantiser_indices": report.quants,
    })
}

/// The poses of a GLB this program wrote.
fn from_glb(bytes: &[u8]) -> anyhow::Result<PoseClip> {
    let mut clip = clip_from_glb(bytes)?;
    // Keys may have been dropped: back to an even time base.
    let rate = clip_rate(&clip).round().clamp(1.0, 255.0);
    let sides: Vec<_> = clip.header.hands.iter().map(|h| h.side).collect();
    let frames = sides.iter().flat_map(|&side| clip.resampled(side, rate, f64::INFINITY)).collect();
    clip.header.rate = Some(rate);
    clip.frames = frames;
    Ok(clip)
}
