//! `handcast encode`: poses to an FBA stream.

use std::error::Error;
use std::io::{BufRead, Cursor, Read as _, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use handcast_codec::notices;
use handcast_codec::{
    EncodedEnd, PoseEncoder, PoseEncoderOptions, PosesToStreamError, TipError, poses_on_ticks,
};
use handcast_fba::bap::{StepTable, epf, text};
use handcast_fba::inspect::Inspector;
use handcast_fba::plan::{PlanOptions, PlanReport};
use handcast_fba::{DecoderOptions, EncodeError, encode_epf};
use handcast_formats::motion::{Format, Motion, at_even_times, even_rate};
use handcast_formats::mp4::{MuxOptions, mux, pictures_end_at, pictures_start_at, starts_at, unwrapped};
use handcast_formats::poses::PoseReader;
use handcast_hand::{PoseClip, Side};

use super::common::{
    RateArgs, busy, check_seen, check_span, check_terminal, counted, ending, limits, open_input, read_filled,
    read_input, read_piece, told_kind, told_name, warn_of_uneven_times, write_output,
};
use super::given;
use super::glb_out::read_map;
use super::out::Stdout;

/// Turns poses, BAP text, an animated hand or any other motion into an FBA stream
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Poses (.jsonl, .json, .csv), BAP text (.bap), animated hands and rigs (.glb, .gltf, .vrma, .bvh), joint
    /// positions (all that `import` reads), or a stream to code anew (.fba, .mp4); - for standard input
    input: PathBuf,
    /// Stream to write (.fba, .mp4, or - for standard output). In an MP4 file it is a track of MPEG-4 visual, with a start
    /// code at each I plane, in a visual object sequence
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Clip (.mp4) whose tracks stand beside the stream's, untouched (.mp4 only)
    #[arg(long, alias = "with-video", value_name = "FILE", conflicts_with = "epf")]
    clip: Option<PathBuf>,
    /// Which joint of a .glb or .gltf is which, where names do not tell (.toml)
    #[arg(long, value_name = "FILE")]
    map: Option<PathBuf>,
    /// Take a stream (.fba, or that in an .mp4) over as it is, byte for byte, in place of coding it anew
    #[arg(long, conflicts_with_all = CODING)]
    copy: bool,
    /// Encoder parameter file that makes every choice (.bap input only)
    #[arg(long, value_name = "FILE", conflicts_with_all = ["rate", "ranges", "derive"])]
    epf: Option<PathBuf>,
    /// Print the account of the stream as JSON
    #[arg(long)]
    json: bool,
    /// Neither progress nor report; warnings are told all the same
    #[arg(short, long)]
    quiet: bool,
    #[command(flatten)]
    rate: RateArgs,
}

impl Args {
    /// How the stream is read.
    fn decoder(&self) -> DecoderOptions {
        let (steps, ranges) = (self.rate.steps.into(), self.rate.ranges.into());
        DecoderOptions { steps, ranges, ..DecoderOptions::default() }
    }
}

/// Options that say how a stream is made, by the names of their fields.
const CODING: [&str; 12] = [
    "rate",
    "epf",
    "map",
    "intra",
    "live",
    "resync",
    "no_resync",
    "no_sizes",
    "repeat_sizes",
    "derive",
    "wrapper",
    "profile",
];

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    encode(args).map_err(|error| match args.rate.quant {
        Some(quant) if error.chain().any(is_out_of_range) => error
            .context(format!("--quant {quant} is too fine for this motion, a larger one reaches further")),
        _ => error,
    })
}

/// Whether a value, or a change, is beyond what the quantiser can say, and not beyond what others can.
fn is_out_of_range(error: &(dyn Error + 'static)) -> bool {
    let beyond = |error: &EncodeError| matches!(error, EncodeError::OutOfRange { further: true, .. });
    match error.downcast_ref() {
        Some(PosesToStreamError::Encode(error)) => beyond(error),
        _ => error.downcast_ref().is_some_and(beyond),
    }
}

fn encode(args: &Args) -> anyhow::Result<()> {
    let name = args.input.display();
    let mut plan = args.rate.plan();
    if ending(&args.output) == "mp4" {
        given::note_idle("an MP4 file has a start code at each I plane", &["no_resync"]);
        plan.resync = true;
        plan.wrapper = plan.wrapper.or(Some(SIMPLE_FBA));
    }
    if let Some(other) = told_kind(&args.output, &["fba", "mp4"]) {
        refuse!("{}: a stream is no {other} file, allowed are .fba, .mp4 and -", args.output.display());
    }
    check_terminal(&args.output, "a stream")?;
    if args.clip.is_some() && ending(&args.output) != "mp4" {
        refuse!("--clip: a stream stands beside a clip in an .mp4 alone");
    }
    if args.copy {
        return copy(args);
    }
    let (head, input) = begun(&args.input)?;
    if args.map.is_some() && Format::of(&args.input, &head).is_none_or(|format| format.kind != "glb") {
        refuse!("--map names joints of a .glb or .gltf: {name} is none");
    }
    if args.epf.is_none() && Format::of(&args.input, &head).is_some_and(|format| format.id == "jsonl") {
        return encode_lines(PoseReader::new(input).with_context(|| format!("{name}"))?, args, &plan);
    }
    let bytes = read_piece(input, &args.input)?;
    if let Some(epf) = &args.epf {
        return encode_by_epf(args, epf, &bytes, &plan);
    }
    let mut motion = match &args.map {
        Some(map) => Motion::parse_mapped(&args.input, &bytes, &read_map(map)?, limits())?,
        None => Motion::parse_within(&args.input, &bytes, limits())?,
    };
    tell_of_reading(&motion, &args.input);
    if motion.format.id == "fba" && plan.steps != StepTable::Standard {
        refuse!(
            "{name}: --steps says how a stream is written, and this one is read with those of the standard: if it has \
             others, decode it to poses first (decode --steps)"
        );
    }
    // In an MP4 file times count from where its pictures and sounds begin, which its first picture may come behind.
    let start = (start_of(&motion.clip, args) - pictures_start_at(&bytes)).max(0.0);
    let coded = match &motion.baps {
        Some(baps) => {
            given::note_idle(
                format_args!("{name} has its values in BAPs of its own"),
                &["profile", "max_gap"],
            );
            // What the stream before told of hands travels on.
            if args.rate.no_sizes {
                motion.clip.header.forget_person();
            }
            if let Some(notice) = notices::of_rate(baps.rate) {
                errln!("handcast: {name}: {notice}");
            }
            let coded = baps.encode(&motion.clip.header, plan);
            let (bytes, report) = coded.with_context(|| format!("{name}"))?;
            EncodedEnd { bytes, report, tips: None, bridged: 0 }
        }
        None if motion.keyed => {
            warn_of_uneven_times(&motion.clip, even_rate(&motion.clip));
            let even = at_even_times(motion.clip, limits());
            even.map_err(anyhow::Error::from)
                .and_then(|clip| encoded(clip, args, &plan))
                .with_context(|| format!("{name}"))?
        }
        None => encoded(motion.clip, args, &plan).with_context(|| format!("{name}"))?,
    };
    deliver(args, &coded.bytes, [start, coded.report.seconds])?;
    say(args, &coded)
}

/// Takes a stream over, which is read to its end to know that it is one.
fn copy(args: &Args) -> anyhow::Result<()> {
    let name = args.input.display();
    let bytes = read_filled(&args.input)?;
    let stream = unwrapped(&bytes).with_context(|| format!("{name}"))?;
    let (mut planes, mut seconds) = (0, 0.0);
    let mut inspector = Inspector::new(&stream, args.decoder());
    while let Some(plane) = inspector.next() {
        let frame = plane.with_context(|| format!("{name}: --copy is for sound streams"))?.frame;
        planes += usize::from(frame.object_mask != 0);
        let ticks = f64::from(frame.skipped) + 1.0;
        seconds = frame.time + ticks / inspector.decoder().rate().per_second().max(f64::MIN_POSITIVE);
    }
    if planes == 0 {
        bail!("{name} holds no stream: --copy takes one over as it is");
    }
    // A file tells when its stream begins, a clip's pictures when theirs do.
    let start = (starts_at(&bytes) - pictures_start_at(&bytes)).max(0.0);
    deliver(args, &stream, [start, seconds])?;
    if !args.quiet {
        let planes = counted(planes, "plane");
        errln!("{}: {planes}, {} bytes, as they were", told_name(&args.output), stream.len());
    }
    Ok(())
}

/// Says what is worth knowing of how a motion was read, and what to do about it.
fn tell_of_reading(motion: &Motion, path: &Path) {
    let name = path.display();
    motion.notes.iter().for_each(|note| errln!("handcast: {name}: {note}"));
    if motion.import.as_ref().is_some_and(|report| report.trembling().is_some()) {
        errln!(
            "handcast: {name}: handcast import --smooth steadies them: encode the poses that it writes, in place of this file"
        );
    }
}

/// Most bytes of an input that are looked at to tell what it is.
const HEAD: u64 = 1 << 16;

/// What an input begins with, and the whole of it: the first line of a pipe, which may come in pieces and after which
/// nothing may come for long.
fn begun(path: &Path) -> anyhow::Result<(Vec<u8>, Box<dyn BufRead>)> {
    let mut input = open_input(path)?;
    let mut head = Vec::new();
    let mut start = input.by_ref().take(HEAD);
    let read = if path.is_file() { start.read_to_end(&mut head) } else { start.read_until(b'\n', &mut head) };
    read.with_context(|| format!("cannot read {}", path.display()))?;
    let whole = Cursor::new(head.clone()).chain(input);
    Ok((head, Box::new(whole)))
}

/// The profile and level of a stream in an MP4 file where none is asked for: Simple FBA, level 1.
const SIMPLE_FBA: u8 = 0x63;

/// Seconds at which the poses of a clip begin, which a stream does not tell, and an .mp4 beside a clip not where they begin before
/// it: that is said.
fn start_of(clip: &PoseClip, args: &Args) -> f64 {
    let first = clip.frames.iter().map(|frame| frame.time).fold(f64::INFINITY, f64::min);
    if (args.clip.is_none() || first < 0.0)
        && let Some(notice) = notices::of_start(clip)
    {
        errln!("handcast: {notice}");
    }
    if first.is_finite() { first.max(0.0) } else { 0.0 }
}

/// Seconds by which a stream may end before the clip beside it, or behind it, without a word.
const APART: f64 = 0.5;

/// Writes the stream, into an MP4 file if its name says so; it begins at `start`, and lasts for so many `seconds`.
fn deliver(args: &Args, stream: &[u8], [start, seconds]: [f64; 2]) -> anyhow::Result<()> {
    if ending(&args.output) != "mp4" {
        return write_output(&args.output, stream);
    }
    let clip = args.clip.as_deref().map(|path| read_input(path, None)).transpose()?;
    // Only beside a clip it matters when the stream begins.
    let start = if clip.is_some() { start } else { 0.0 };
    if let (Some(path), Some(clip)) = (&args.clip, &clip)
        && let Some(end) = pictures_end_at(clip)
    {
        let begin = pictures_start_at(clip) + start;
        let (stream, name) = (begin + seconds, path.display());
        if stream > end + APART {
            errln!(
                "handcast: the stream ends at {stream:.2} s, the pictures of {name} at {end:.2} s: are the poses those of this clip?"
            );
        } else if stream < end - APART {
            errln!(
                "handcast: the stream is beside the pictures of {name} from {begin:.2} to {stream:.2} s, of {end:.2} s"
            );
        }
    }
    let options = MuxOptions::default().with_decoder(args.decoder()).with_start(start).with_clip(clip);
    let file = mux(stream, &options);
    let file = match &args.clip {
        Some(path) => file.with_context(|| format!("--clip {}", path.display()))?,
        None => file?,
    };
    write_output(&args.output, &file)
}

/// Encodes pose lines; live, to standard output, each as it comes where the header says the rate.
fn encode_lines(reader: PoseReader<impl BufRead>, args: &Args, plan: &PlanOptions) -> anyhow::Result<()> {
    let name = args.input.display();
    match reader.header().rate {
        Some(rate) if plan.live && args.output.as_os_str() == "-" => pass_on(reader, rate, args, plan),
        _ => {
            let mut clip = reader.into_clip_within(limits()).with_context(|| format!("{name}"))?;
            if args.rate.no_sizes {
                clip.header.forget_person();
            }
            let start = start_of(&clip, args);
            let coded = encoded(clip, args, plan).with_context(|| format!("{name}"))?;
            deliver(args, &coded.bytes, [start, coded.report.seconds])?;
            say(args, &coded)
        }
    }
}

/// Encodes pose lines to standard output as they come. A stream has the hands that it began with: one that a later header
/// tells of begins another.
fn pass_on(
    mut reader: PoseReader<impl BufRead>,
    rate: f64,
    args: &Args,
    plan: &PlanOptions,
) -> anyhow::Result<()> {
    let name = args.input.display();
    let pass = |bytes: &[u8]| Stdout.write_all(bytes).and_then(|()| Stdout.flush());
    let end = |encoder: PoseEncoder| {
        let end = encoder.finish().with_context(|| format!("{name}"))?;
        pass(&end.bytes)?;
        say(args, &end)
    };
    let mut current: Option<(PoseEncoder, Vec<Side>)> = None;
    while let Some(pose) = reader.next() {
        let pose = pose.with_context(|| format!("{name}"))?;
        let hands = || reader.header().hands.iter().map(|hand| hand.side);
        if let Some((encoder, _)) = current.take_if(|(_, begun)| !hands().eq(begun.iter().copied())) {
            end(encoder)?;
        }
        let (encoder, _) = match &mut current {
            Some(current) => current,
            None => {
                let hands: Vec<Side> = hands().collect();
                let mut header = reader.header().clone();
                if args.rate.no_sizes {
                    header.forget_person();
                }
                let options =
                    PoseEncoderOptions::default().with_profile(args.rate.profile.into()).with_plan(*plan);
                let options =
                    options.with_hands(&hands).with_sizes(&header.hands).with_skin_tone(header.skin_tone);
                current.insert((PoseEncoder::new(options.with_rate(rate))?, hands))
            }
        };
        pass(&encoder.push(&pose).with_context(|| format!("{name}, pose at {} s", pose.time))?)?;
    }
    match current {
        Some((encoder, _)) => end(encoder),
        None => check_seen(name, &PoseClip::default()),
    }
}

/// Says what the stream costs.
fn say(args: &Args, coded: &EncodedEnd) -> anyhow::Result<()> {
    let EncodedEnd { report, tips, bridged, .. } = coded;
    let tips = *tips;
    let notice = notices::of_report(args.rate.plan().mode, args.rate.live, report, tips);
    if let Some(notice) = &notice {
        errln!("handcast: {notice}");
    }
    if args.json {
        let mut account = account(report, tips);
        account["bridged"] = (*bridged).into();
        account["notice"] = notice.into();
        let account = serde_json::to_string(&account)?;
        // The stream itself may be on standard output.
        if args.output.as_os_str() == "-" { errln!("{account}") } else { outln!("{account}") }
    } else if !args.quiet {
        errln!(
            "{}: {} in {}, {} bytes, {:.2} kbit/s, {:.2}° RMS, {:.2}° at most{}{}",
            told_name(&args.output),
            counted(report.frames, "frame"),
            counted(report.planes, "plane"),
            report.bytes,
            report.kbit_per_s(),
            report.rms_degrees,
            report.max_degrees,
            report.derived_degrees.map_or_else(String::new, |[rms, max]| {
                format!("; angles left to the decoder {rms:.2}° RMS, {max:.2}° at most")
            }),
            tips.map_or_else(String::new, |tips| format!("; fingertips {}", off(&tips)))
        );
    }
    Ok(())
}

/// The stream of BAP text with the choices of an encoder parameter file.
fn encode_by_epf(args: &Args, epf: &Path, bytes: &[u8], plan: &PlanOptions) -> anyhow::Result<()> {
    let name = args.input.display();
    if Format::of(&args.input, bytes).is_none_or(|format| format.id != "bap") {
        refuse!("{name}: --epf goes with a .bap file");
    }
    let file = text::read_bytes(bytes).with_context(|| format!("{name}"))?;
    let words = read_input(epf, None)?;
    let frames = epf::read(String::from_utf8_lossy(&words).trim_start_matches('\u{feff}'))
        .with_context(|| format!("{}", epf.display()))?;
    let stream = encode_epf(&file, &frames, plan.steps)?;
    if frames.len() != file.frames.len() {
        let [names, has] = [frames.len(), file.frames.len()];
        errln!("handcast: {} names {names} planes, {name} has {has} frames", epf.display());
    }
    deliver(args, &stream, [0.0; 2])?;
    if !args.quiet {
        let planes = counted(frames.len(), "plane");
        errln!("{}: {planes}, {} bytes", told_name(&args.output), stream.len());
    }
    Ok(())
}

/// The stream of poses, which are let go before it is planned.
fn encoded(mut clip: PoseClip, args: &Args, plan: &PlanOptions) -> anyhow::Result<EncodedEnd> {
    check_seen(args.input.display(), &clip)?;
    let profile = args.rate.profile.into();
    notices::of_poses(&clip, profile, args.rate.max_gap())
        .iter()
        .for_each(|notice| errln!("handcast: {notice}"));
    if args.rate.no_sizes {
        clip.header.forget_person();
    }
    let mut encoder = PoseEncoder::for_clip(&clip, profile, plan)?;
    check_span(&clip, encoder.rate())?;
    warn_of_uneven_times(&clip, encoder.rate());
    let mut stream = encoder.push_all(poses_on_ticks(&clip, encoder.rate(), args.rate.max_gap()))?;
    drop(clip);
    let bar = busy(!args.quiet && !args.json, "encoding");
    let end = encoder.finish()?;
    bar.finish_and_clear();
    stream.extend(end.bytes);
    Ok(EncodedEnd { bytes: stream, ..end })
}

/// How far fingertips are off as a viewer sees them, in words.
pub fn off(tips: &TipError) -> String {
    let TipError { mean_mm, p99_mm, max_mm, .. } = tips;
    let wrist = if tips.placed { "way" } else { "turn" };
    format!(
        "{mean_mm:.1} mm off on average, {p99_mm:.1} mm in 99 of 100, {max_mm:.1} mm at most, with the wrist's {wrist}"
    )
}

/// The same for programs.
pub fn tips_mm(tips: &TipError) -> serde_json::Value {
    // The 99th percentile is the edge of a bin 1 % wide.
    let p99 = (100.0 * tips.p99_mm).round() / 100.0;
    serde_json::json!({ "mean": tips.mean_mm, "p99": p99, "max": tips.max_mm, "sizes": tips.sizes_mm })
}

/// What the stream costs and how far off it is.
pub fn account(report: &PlanReport, tips: Option<TipError>) -> serde_json::Value {
    let bits = &report.bits;
    let coded = [bits.headers, bits.masks, bits.ranges, bits.intra_values, bits.predicted_values, bits.flush];
    let coded = coded.iter().sum::<u64>() + report.filler;
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
        "derived_deg": report.derived_degrees.map(|[rms, max]| serde_json::json!({ "rms": rms, "max": max })),
        "tips_mm": tips.map(|tips| tips_mm(&tips)),
        "bits": {
            // With the record, the stream's end, and what fills up bytes before them.
            "start_codes": (8 * report.bytes as u64).saturating_sub(coded),
            "headers": bits.headers,
            "masks": bits.masks,
            "ranges": bits.ranges,
            "intra_values": bits.intra_values,
            "predicted_values": bits.predicted_values,
            "flush": bits.flush,
            "filler": report.filler,
        },
        "quantiser_indices": report.quants,
    })
}
