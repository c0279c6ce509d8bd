//! `handcast decode`: an FBA stream to an animated hand, poses or BAP text.

use std::path::PathBuf;

use anyhow::Context;
use handcast::bap::mapping::Profile;
use handcast::bap::text::{self, BapFile};
use handcast::codec::{DecodedPlanes, DecodedStream, decode_planes, decode_poses};
use handcast::fba::{DecoderOptions, PlaneKind};
use handcast::hand::{JointAngle, Morphology, limits};
use handcast::io::person::read_person;

use super::common::{StreamArgs, read_input, write_output};
use super::poses_out::{OutArgs, Output};

/// Largest stream that is read at once, bytes.
const MAX_STREAM: u64 = 1 << 30;

/// Turns an FBA stream into an animated hand (.glb), poses, other programs' motion files or BAP text
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Stream (.fba, or - for standard input)
    input: PathBuf,
    /// File to write: .glb, .jsonl, .json, .csv, .bvh, .webxr.json, .landmarks.jsonl or .bap
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Sizes of the person's hand (the stream does not carry them)
    #[arg(long, value_name = "FILE")]
    person: Option<PathBuf>,
    #[command(flatten)]
    stream: StreamArgs,
    /// Do not let the hand model fill in end joints that the stream leaves out
    #[arg(long)]
    sent_only: bool,
    #[command(flatten)]
    out: OutArgs,
    /// Say nothing on success
    #[arg(short, long)]
    quiet: bool,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let name = args.input.display();
    let person = args.person.as_deref().map(read_person).transpose()?;
    let bytes = read_input(&args.input, MAX_STREAM)?;
    let options = DecoderOptions { sent_only: args.sent_only, ..args.stream.options() };
    let format = Output::motion(&args.output, args.out.to)?;
    // The BAPs as they were sent, not those of the poses.
    if format.id == "bap" {
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
    let mut decoded = decode_poses(&bytes, args.stream.profile.map(Profile::from), options)
        .with_context(|| format!("{name}"))?;
    for damage in &decoded.damage {
        eprintln!("handcast: {name}: {damage}; the last pose is held");
    }
    warn_if_implausible(&decoded, &args.input.display().to_string());
    let morphology = person.map(|p| p.morphology);
    for hand in &mut decoded.clip.header.hands {
        hand.morphology.clone_from(&morphology);
    }
    decoded.clip.header.made_by = Some(format!("handcast {} decode", env!("CARGO_PKG_VERSION")));
    let facts = stream_facts(&decoded, bytes.len());
    let summary = {
        let hands: Vec<_> = decoded.clip.header.hands.iter().map(|h| h.side.name()).collect();
        let seconds = decoded.clip.frames.last().map_or(0.0, |f| f.time);
        format!("{} hand, {} planes, {seconds:.2} s", hands.join(" and "), decoded.planes.len())
    };
    let morphology = morphology.unwrap_or_else(Morphology::default);
    write_output(&args.output, &args.out.bytes(decoded.clip, &morphology, format, facts)?)?;
    if !args.quiet {
        eprintln!("{}: {summary}", args.output.display());
    }
    Ok(())
}

/// What the file of a decoded stream says about the stream.
pub fn stream_facts(decoded: &DecodedStream, bytes: usize) -> serde_json::Map<String, serde_json::Value> {
    let planes = &decoded.planes;
    let quants = planes.iter().map(|p| p.quant);
    let bits: u64 = planes.iter().map(|p| p.end_bit.saturating_sub(p.first_bit)).sum();
    let seconds = (planes.last().map_or(0.0, |p| p.time) - planes.first().map_or(0.0, |p| p.time))
        + decoded.rate.recip();
    let facts = serde_json::json!({
        "stream_bytes": bytes,
        "stream_bits": bits,
        "bits_per_second": (bits as f64 / seconds.max(1e-9)).round(),
        "planes": planes.len(),
        "intra_planes": planes.iter().filter(|p| p.kind == PlaneKind::Intra).count(),
        "quantiser_indices": [quants.clone().min(), quants.max()],
        "frames_per_second": decoded.rate,
        "profile": match decoded.profile {
            Profile::Arm => "arm",
            _ => "hand",
        },
        "damaged_places": decoded.damage.len(),
    });
    match facts {
        serde_json::Value::Object(facts) => facts,
        _ => serde_json::Map::new(),
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
        eprintln!(
            "handcast: {name}: {} reaches {:.0}°, which no hand does: was the stream made with other base \
             steps (--steps)?",
            angle.name(),
            value.to_degrees()
        );
    }
}
