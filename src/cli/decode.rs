//! `handcast decode`: an FBA stream to an animated hand, poses or BAP text.

use std::io::BufRead;
use std::path::PathBuf;

use anyhow::Context;
use handcast_codec::mapping::Profile;
use handcast_codec::notices;
use handcast_codec::{
    Damage, DecodedStream, PoseDecoder, PoseDecoderOptions, decode_baps, decode_poses_within, hands_of_record,
};
use handcast_fba::DecoderOptions;
use handcast_fba::bap::text;
use handcast_formats::motion::span;
use handcast_formats::mp4;
use handcast_formats::person::read_person;
use handcast_hand::{JointAngle, Morphology, PoseHeader, Side, TimedPose, limits};
use handcast_limits::Limit;

use super::common::{
    self, StreamArgs, check_is_stream, counted, open_input, read_piece, read_stream, told_name,
};
use super::given;
use super::poses_out::{Lines, OutArgs, write_whole};

/// Turns an FBA stream into an animated hand (.glb), poses, other programs' motion files or BAP text
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Stream (.fba, .mp4, or - for standard input)
    input: PathBuf,
    /// File to write: .glb, .gltf, .jsonl, .json, .csv, .bvh, .vrma, .webxr.json, .landmarks.jsonl, .pose or .bap
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Sizes of the person's hand, instead of those that the stream carries
    #[arg(long, value_name = "FILE")]
    person: Option<PathBuf>,
    /// Neither progress nor report; warnings are told all the same
    #[arg(short, long)]
    quiet: bool,
    #[command(flatten)]
    stream: StreamArgs,
    /// Do not let the hand model fill in end joints that the stream leaves out
    #[arg(long)]
    sent_only: bool,
    #[command(flatten)]
    out: OutArgs,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let name = args.input.display();
    let person = args.person.as_deref().map(read_person).transpose()?;
    let options = DecoderOptions { sent_only: args.sent_only, ..args.stream.options() };
    let format = args.out.motion(&args.output)?;
    let morphology = person.map(|p| p.morphology);
    if args.output.as_os_str() == "-" && format.id == "jsonl" && args.out.fps.is_none() && !args.out.centre {
        return decode_lines(args, options, morphology.as_ref());
    }
    let (bytes, start) = read_stream(&args.input)?;
    // The BAPs as they were sent, not those of the poses, unless these are to be changed.
    if format.id == "bap" && args.out.is_all() {
        given::note_idle("BAP text has the values that were sent", &["person", "profile"]);
        return write_baps(args, &bytes, options);
    }
    let profile = args.stream.profile.map(Profile::from);
    let options = PoseDecoderOptions::default()
        .with_decoder(options)
        .with_profile(profile)
        .with_limits(common::limits());
    let mut decoded = decode_poses_within(&bytes, options).with_context(|| format!("{name}"))?;
    let long = common::limits().check(Limit::Seconds, span(&decoded.clip));
    long.with_context(|| format!("{name}"))?;
    tell_of_damage(&name, &decoded.damage, "pose is");
    let notices = notices::of_stream(decoded.passed_over, decoded.streams, decoded.trailing);
    notices.iter().for_each(|notice| errln!("handcast: {name}: {notice}"));
    if morphology.is_none() {
        tell_of_sizes(&name, &decoded.resized, "the last ones");
    }
    warn_of_profile(&decoded, &args.input.display().to_string());
    warn_if_implausible(&decoded, &args.input.display().to_string());
    decoded.clip.header = told(decoded.clip.header, morphology.as_ref());
    decoded.clip.shift(start);
    let facts = stream_facts(&decoded, bytes.len());
    let seconds = decoded.clip.frames.last().map_or(0.0, |f| f.time);
    let told = decoded.clip.header.hands.iter().find_map(|hand| hand.morphology.clone());
    let morphology = morphology.or(told).unwrap_or_default();
    let sides = args.out.write(&args.output, decoded.clip, &morphology, format, facts)?;
    if !args.quiet {
        let hands: Vec<_> = sides.iter().map(|side| side.name()).collect();
        let (hands, planes) = (hands.join(" and "), counted(decoded.totals.planes, "plane"));
        errln!("{}: {hands} hand, {planes}, {seconds:.2} s", told_name(&args.output));
    }
    Ok(())
}

/// The header of decoded poses, with the person's sizes if they are given.
fn told(mut header: PoseHeader, morphology: Option<&Morphology>) -> PoseHeader {
    for hand in header.hands.iter_mut().filter(|_| morphology.is_some()) {
        hand.morphology = morphology.cloned();
    }
    header.made_by = Some(format!("handcast {} decode", env!("CARGO_PKG_VERSION")));
    header
}

/// Writes poses to standard output as the bytes of the stream come.
fn decode_lines(args: &Args, options: DecoderOptions, morphology: Option<&Morphology>) -> anyhow::Result<()> {
    let name = args.input.display();
    let mut input = open_input(&args.input)?;
    let head = input.fill_buf().with_context(|| format!("cannot read {name}"))?;
    let mut start = 0.0;
    if mp4::is_mp4(head) {
        // The tables of an MP4 file may be at its end.
        let file = read_piece(input, &args.input)?;
        start = mp4::starts_at(&file);
        let stream = mp4::unwrapped(&file).with_context(|| format!("{name}"))?.into_owned();
        input = Box::new(std::io::Cursor::new(stream));
    } else {
        check_is_stream(&args.input, head)?;
    }
    let told_profile = args.stream.profile.map(Profile::from);
    let mut decoder = PoseDecoder::new(
        PoseDecoderOptions::default()
            .with_decoder(options)
            .with_profile(told_profile)
            .with_limits(common::limits()),
    );
    let mut lines = Lines::default();
    let header = |decoder: &PoseDecoder| {
        let mut header = told(decoder.header(), morphology);
        header.hands.retain(|hand| args.out.wants(hand.side));
        header
    };
    let mut found = false;
    loop {
        let piece = input.fill_buf().with_context(|| format!("cannot read {name}"))?;
        let count = piece.len();
        let poses = if count > 0 { decoder.push(piece) } else { decoder.finish() };
        let poses = poses.with_context(|| format!("{name}"))?;
        let late = |pose: TimedPose| TimedPose { time: pose.time + start, ..pose };
        let wanted = poses.into_iter().filter(|pose| args.out.wants(pose.pose.side));
        let mut poses = wanted.map(late).peekable();
        found |= poses.peek().is_some();
        lines.write(|| header(&decoder), poses)?;
        if count == 0 {
            break;
        }
        input.consume(count);
    }
    args.out.check_found(found).with_context(|| format!("{name}"))?;
    tell_of_damage(&name, decoder.damage(), "pose is");
    let (streams, trailing) = decoder.streams();
    for notice in notices::of_stream(decoder.passed_over(), streams, trailing) {
        errln!("handcast: {name}: {notice}");
    }
    if let (None, Some(header)) = (morphology, lines.header()) {
        // Those known when it was written.
        let resized = decoder.resized();
        tell_of_sizes(&name, &resized, &shown_sizes(header, &resized));
    }
    Ok(())
}

/// The sizes that a header gives these hands.
fn shown_sizes(header: &PoseHeader, sides: &[Side]) -> String {
    let told = sides.iter().filter_map(|&side| header.hand(side)?.morphology.as_ref());
    let lengths: Vec<_> = told.map(|sizes| format!("{:.0}", 1e3 * sizes.hand_length)).collect();
    match lengths.as_slice() {
        [] => "those of the mean hand".into(),
        [length] => format!("those of a hand {length} mm long"),
        both => format!("those of hands {} mm long", both.join(" and ")),
    }
}

/// Says that poses are not all of hands of the same sizes.
fn tell_of_sizes(name: &impl std::fmt::Display, resized: &[Side], shown: &str) {
    if let Some(notice) = notices::of_sizes(resized, shown) {
        errln!("handcast: {name}: {notice} (decode them from files of their own, or with --person)");
    }
}

/// Says what was passed over, and what is held there.
fn tell_of_damage(name: &impl std::fmt::Display, damage: &Damage, held: &str) {
    notices::of_damage(damage, held).iter().for_each(|notice| errln!("handcast: {name}: {notice}"));
}

/// Writes the BAPs of a stream as text.
fn write_baps(args: &Args, bytes: &[u8], options: DecoderOptions) -> anyhow::Result<()> {
    let name = args.input.display();
    let decoded = decode_baps(bytes, options, common::limits()).with_context(|| format!("{name}"))?;
    let rate = decoded.rate;
    tell_of_damage(&name, &decoded.damage, "values are");
    for notice in notices::of_stream(decoded.passed_over, decoded.streams, decoded.trailing) {
        errln!("handcast: {name}: {notice}");
    }
    if hands_of_record(&decoded.record).iter().any(|hand| hand.morphology.is_some()) {
        errln!("handcast: BAP text has no place for the person's sizes, which the stream carries");
    }
    let rows = decoded.frames.len();
    let frames = decoded.frames.iter().scan(0, |next, frame| {
        // A damaged clock may go back.
        let number = ((frame.time * rate).round() as u32).max(*next);
        *next = number.saturating_add(1);
        Some((number, frame.baps))
    });
    let stem = args.input.file_stem().and_then(|s| s.to_str()).unwrap_or("stream");
    write_whole(&args.output, |out| Ok(text::write_frames(stem, rate, frames, out)?))?;
    if !args.quiet {
        let rows = counted(rows, "frame");
        let rate = (1e3 * rate).round() / 1e3;
        errln!("{}: {rows} at {rate} frames/s", told_name(&args.output));
    }
    Ok(())
}

/// What the file of a decoded stream says about the stream.
pub fn stream_facts(decoded: &DecodedStream, bytes: usize) -> serde_json::Map<String, serde_json::Value> {
    let totals = &decoded.totals;
    let seconds = totals.times.map_or(0.0, |[first, last]| last - first) + decoded.rate.recip();
    let facts = serde_json::json!({
        "stream_bytes": bytes,
        "kbit_per_s": 8e-3 * bytes as f64 / seconds.max(1e-9),
        "planes": totals.planes,
        "intra_planes": totals.intra_planes,
        "quantiser_indices": totals.quants,
        "frames_per_second": decoded.rate,
        "profile": profile_name(decoded.profile),
        "damaged_places": decoded.damage.count(),
    });
    match facts {
        serde_json::Value::Object(facts) => facts,
        _ => serde_json::Map::new(),
    }
}

/// What `--profile` calls it.
fn profile_name(profile: Profile) -> &'static str {
    match profile {
        Profile::Arm => "arm",
        _ => "hand",
    }
}

/// With another profile than that of its masks a stream leaves the wrist where it is.
fn warn_of_profile(decoded: &DecodedStream, name: &str) {
    if let Some(carried) = decoded.carried.filter(|carried| *carried != decoded.profile) {
        let [carried, told] = [carried, decoded.profile].map(profile_name);
        errln!(
            "handcast: {name}: its masks carry the wrist as --profile {carried} has it: with --profile {told} it does not \
             move"
        );
    }
}

/// The step table is recorded nowhere in the stream: with the wrong one, angles leave what joints can do.
fn warn_if_implausible(decoded: &DecodedStream, name: &str) {
    let slack = 30f64.to_radians();
    let mut worst: Option<(f64, JointAngle, f64)> = None;
    for frame in &decoded.clip.frames {
        for angle in JointAngle::ALL {
            let (value, l) = (frame.pose.angle(angle), limits(angle));
            let beyond = (value - l.max).max(l.min - value) - slack;
            if beyond > 0.0 && worst.is_none_or(|(most, ..)| beyond > most) {
                worst = Some((beyond, angle, value));
            }
        }
    }
    if let Some((_, angle, value)) = worst {
        errln!(
            "handcast: {name}: {} reaches {:.0}°, which no hand does: was the stream made with other base \
             steps (--steps)?",
            angle.name(),
            value.to_degrees()
        );
    }
}
