//! `handcast decode`: an FBA stream to an animated hand, poses or BAP text.

use std::path::PathBuf;

use anyhow::{Context, bail};
use handcast::bap::mapping::Profile;
use handcast::bap::text::{self, BapFile};
use handcast::codec::{DecodedPlanes, DecodedStream, decode_planes, decode_poses};
use handcast::fba::DecoderOptions;
use handcast::gltf::ExportOptions;
use handcast::hand::{JointAngle, Morphology, limits};
use handcast::io::person::read_person;
use handcast::io::poses::{PoseClip, PoseWriter};

use super::common::{ProfileArg, Ranges, Steps, ending, read_input, to_glb, write_output};

/// Largest stream that is read at once, bytes.
const MAX_STREAM: u64 = 1 << 30;

/// Turns an FBA stream into an animated hand (.glb), poses (.jsonl, .json) or BAP text (.bap)
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Stream (.fba, or - for standard input)
    input: PathBuf,
    /// File to write: .glb, .jsonl, .json or .bap
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Sizes of the person's hand (the stream does not carry them)
    #[arg(long, value_name = "FILE")]
    person: Option<PathBuf>,
    /// Where position and rotation of the hand travelled [default: as the stream's masks tell]
    #[arg(long, value_enum)]
    profile: Option<ProfileArg>,
    /// Base quantiser steps the stream was made with; the stream does not tell
    #[arg(long, value_enum, default_value_t = Steps::Standard)]
    steps: Steps,
    /// Reading of the range codes the stream was made with; the stream does not tell
    #[arg(long, value_enum, default_value_t = Ranges::Divided)]
    ranges: Ranges,
    /// Go on after damage, holding the last pose
    #[arg(long)]
    conceal: bool,
    /// Do not let the hand model fill in end joints that the stream leaves out
    #[arg(long)]
    sent_only: bool,
    /// Drop keys of the animation that interpolation reproduces within this many degrees (.glb)
    #[arg(long, value_name = "DEG", default_value_t = 0.0)]
    tolerance: f64,
    /// Joints and animation only, no mesh (.glb)
    #[arg(long)]
    anim_only: bool,
    /// Say nothing on success
    #[arg(short, long)]
    quiet: bool,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let name = args.input.display();
    let person = args.person.as_deref().map(read_person).transpose()?;
    let bytes = read_input(&args.input, MAX_STREAM)?;
    let options = DecoderOptions {
        steps: args.steps.into(),
        ranges: args.ranges.into(),
        conceal: args.conceal,
        sent_only: args.sent_only,
        ..DecoderOptions::default()
    };
    let kind = ending(&args.output);
    if kind == "bap" {
        let DecodedPlanes { planes, rate, cut } =
            decode_planes(&bytes, options).with_context(|| format!("{name}"))?;
        if let Some(error) = cut {
            eprintln!("handcast: {name}: {error}");
        }
        let frames = planes.iter().map(|p| ((p.time * rate).round() as u32, p.baps)).collect();
        let stem = args.input.file_stem().and_then(|s| s.to_str()).unwrap_or("stream").replace(' ', "_");
        let file = BapFile { version: "3.2".into(), name: stem, rate, frames };
        write_output(&args.output, text::write(&file).as_bytes())?;
        if !args.quiet {
            eprintln!("{}: {} frames at {rate} frames/s", args.output.display(), planes.len());
        }
        return Ok(());
    }
    if !matches!(kind.as_str(), "glb" | "jsonl" | "json") {
        bail!("{}: cannot write .{kind}, allowed are .glb, .jsonl, .json and .bap", args.output.display());
    }
    let mut decoded =
        decode_poses(&bytes, args.profile.map(Profile::from), options).with_context(|| format!("{name}"))?;
    for damage in &decoded.damage {
        eprintln!("handcast: {name}: {damage}; the last pose is held");
    }
    warn_if_implausible(&decoded, &args.input.display().to_string());
    let morphology = person.map(|p| p.morphology);
    for hand in &mut decoded.clip.header.hands {
        hand.morphology.clone_from(&morphology);
    }
    decoded.clip.header.made_by = Some(format!("handcast {} decode", env!("CARGO_PKG_VERSION")));
    let file = match kind.as_str() {
        "glb" => {
            let mut export = ExportOptions::default();
            export.animation_only = args.anim_only;
            export.rotation_tolerance = args.tolerance.to_radians();
            export.translation_tolerance = args.tolerance.to_radians() * 0.1;
            export.extras.insert("stream_bytes".into(), bytes.len().into());
            export.extras.insert("planes".into(), decoded.planes.len().into());
            export.extras.insert("frames_per_second".into(), decoded.rate.into());
            to_glb(&decoded.clip, &morphology.unwrap_or_else(Morphology::default), &export)?
        }
        "jsonl" => lines(&decoded.clip)?,
        _ => one_document(&decoded.clip)?,
    };
    write_output(&args.output, &file)?;
    if !args.quiet {
        let hands: Vec<_> = decoded.clip.header.hands.iter().map(|h| h.side.name()).collect();
        eprintln!(
            "{}: {} hand, {} planes, {:.2} s",
            args.output.display(),
            hands.join(" and "),
            decoded.planes.len(),
            decoded.clip.frames.last().map_or(0.0, |f| f.time)
        );
    }
    Ok(())
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
        eprintln!(
            "handcast: {name}: {} reaches {:.0}°, which no hand does: was the stream made with other base \
             steps (--steps)?",
            angle.name(),
            value.to_degrees()
        );
    }
}

fn lines(clip: &PoseClip) -> anyhow::Result<Vec<u8>> {
    let mut writer = PoseWriter::new(Vec::new(), clip.header.clone())?;
    for frame in &clip.frames {
        writer.write(frame)?;
    }
    Ok(writer.finish()?)
}

/// The lines of a pose file as one JSON document: the header, with the frames in it.
fn one_document(clip: &PoseClip) -> anyhow::Result<Vec<u8>> {
    let bytes = lines(clip)?;
    let mut values = serde_json::Deserializer::from_slice(&bytes).into_iter::<serde_json::Value>();
    let mut document = values.next().context("no header")??;
    let frames: Vec<_> = values.collect::<Result<_, _>>()?;
    if let Some(object) = document.as_object_mut() {
        object.insert("frames".into(), frames.into());
    }
    let mut text = serde_json::to_vec(&document)?;
    text.push(b'\n');
    Ok(text)
}
