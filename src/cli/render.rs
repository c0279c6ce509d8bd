//! `handcast render`: pictures of poses without a browser.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use clap::Args as ClapArgs;
use handcast::codec::decode_poses;
use handcast::fba::DecoderOptions;
use handcast::gltf::import_poses;
use handcast::hand::{HandMesh, HandPose, Morphology, Side, Skeleton};
use handcast::io::atomic::AtomicFile;
use handcast::io::person::read_person;
use handcast::io::poses::PoseClip;
use handcast::render::{Film, Style, preview_sheet};
use image::codecs::gif::{GifEncoder, Repeat};
use image::codecs::png::PngEncoder;
use image::codecs::webp::WebPEncoder;
use image::{Delay, Frame, RgbaImage};

use super::common::{ending, read_input};

use super::common::Hand;

/// Most bytes of a GLB file or stream that are read.
const MAX_BYTES: u64 = 256 << 20;

/// Draws the moving hand of a pose file, an FBA stream or a GLB made by this program
#[derive(Debug, ClapArgs)]
pub struct Args {
    /// Poses (.jsonl), stream (.fba) or animated hand (.glb)
    input: PathBuf,
    /// Picture to write: .png or .webp (contact sheet; one picture with --at), or .gif (animation)
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Width and height of one picture, pixels
    #[arg(long, default_value = "320x360", value_name = "WxH", value_parser = super::synth::size)]
    size: (u32, u32),
    /// Number of pictures: of a contact sheet, by default 12, or of an animation, by default all
    #[arg(long, value_name = "N")]
    frames: Option<usize>,
    /// One picture of the pose at this time, seconds
    #[arg(long, value_name = "S")]
    at: Option<f64>,
    /// Turn once round the hand in the course of the motion
    #[arg(long)]
    turntable: bool,
    /// Which hand, if the file has two
    #[arg(long, value_enum)]
    hand: Option<Hand>,
    /// Sizes of the person's hand, instead of the file's
    #[arg(long, value_name = "FILE")]
    person: Option<PathBuf>,
    /// Transparent background (not in animations)
    #[arg(long)]
    transparent: bool,
}

/// One hand's motion out of a file.
struct Motion {
    side: Side,
    morphology: Option<Morphology>,
    poses: Vec<(f64, HandPose)>,
}

fn read(path: &Path, hand: Option<Hand>) -> anyhow::Result<Motion> {
    let wanted = |side: Side| match hand {
        None => true,
        Some(Hand::Left) => side == Side::Left,
        Some(Hand::Right) => side == Side::Right,
    };
    let missing = || format!("{}: has no such hand", path.display());
    let clip = match ending(path).as_str() {
        "glb" => {
            let bytes = read_input(path, MAX_BYTES)?;
            let hands = import_poses(&bytes).with_context(|| format!("{}", path.display()))?;
            let found = hands.into_iter().find(|h| wanted(h.side)).with_context(missing)?;
            return Ok(Motion { side: found.side, morphology: found.morphology, poses: found.poses });
        }
        "fba" => {
            let bytes = read_input(path, MAX_BYTES)?;
            let decoded = decode_poses(&bytes, None, DecoderOptions::default());
            decoded.with_context(|| format!("{}", path.display()))?.clip
        }
        _ => PoseClip::read(path)?,
    };
    let info = clip.header.hands.iter().find(|h| wanted(h.side)).with_context(missing)?;
    let poses = clip.of(info.side).filter(|f| f.valid).map(|f| (f.time, f.pose.clone())).collect();
    Ok(Motion { side: info.side, morphology: info.morphology.clone(), poses })
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let motion = read(&args.input, args.hand)?;
    ensure!(!motion.poses.is_empty(), "{}: no pose in it", args.input.display());
    ensure!(
        (1..=4096).contains(&args.size.0) && (1..=4096).contains(&args.size.1),
        "picture of {} x {} pixels, allowed 1 to 4096 a side",
        args.size.0,
        args.size.1
    );
    let morphology = match &args.person {
        Some(path) => read_person(path)?.morphology,
        None => motion.morphology.unwrap_or_default(),
    };
    let mesh = HandMesh::generate(&morphology, motion.side);
    let skeleton = Skeleton::new(&morphology, motion.side);
    let mut style = Style::default();
    if args.transparent {
        style.background = None;
    }
    let frames: Vec<_> = motion.poses.iter().map(|(time, pose)| (*time, skeleton.frames(pose))).collect();
    let extension = ending(&args.output);
    let mut file = AtomicFile::create(&args.output).with_context(|| format!("{}", args.output.display()))?;
    match extension.as_str() {
        "png" | "webp" => {
            let picture: RgbaImage = match args.at {
                Some(at) => {
                    let nearest = frames
                        .iter()
                        .min_by(|a, b| (a.0 - at).abs().total_cmp(&(b.0 - at).abs()))
                        .context("no pose")?;
                    Film::new(&mesh, std::slice::from_ref(nearest), args.size, args.turntable)
                        .picture(0, &style)
                }
                None => preview_sheet(&mesh, &frames, args.frames.unwrap_or(12), 4, args.size, &style),
            };
            if extension == "png" {
                picture.write_with_encoder(PngEncoder::new(&mut file))?;
            } else {
                picture.write_with_encoder(WebPEncoder::new_lossless(&mut file))?;
            }
        }
        "gif" => {
            let count = args.frames.unwrap_or(frames.len()).clamp(1, frames.len());
            let chosen: Vec<_> = (0..count).map(|i| frames[i * frames.len() / count].clone()).collect();
            let film = Film::new(&mesh, &chosen, args.size, args.turntable);
            let mut encoder = GifEncoder::new_with_speed(&mut file, 10);
            encoder.set_repeat(Repeat::Infinite)?;
            for i in 0..count {
                let until = chosen.get(i + 1).map_or(chosen[i].0 + 0.04, |next| next.0);
                let pause = ((until - chosen[i].0).clamp(0.02, 10.0) * 1000.0).round() as u32;
                let delay = Delay::from_numer_denom_ms(pause, 1);
                encoder.encode_frame(Frame::from_parts(film.picture(i, &style), 0, 0, delay))?;
            }
        }
        other => bail!("cannot write .{other} pictures: give .png, .webp or .gif"),
    }
    file.commit().with_context(|| format!("{}", args.output.display()))
}
