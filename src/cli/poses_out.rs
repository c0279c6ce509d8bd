//! Poses to the file a command was asked for, told by its name's ending or `--to`.

use std::io::{BufWriter, Write};
use std::path::Path;

use anyhow::{Context, bail, ensure};
use handcast_codec::clip_rate;
use handcast_formats::atomic::AtomicFile;
use handcast_formats::export;
use handcast_formats::poses::PoseWriter;
use handcast_hand::{HandMesh, HandPose, Morphology, PoseClip, PoseHeader, Side, Skeleton, TimedPose};
use handcast_render::{Style, preview_sheet, still};
use image::ImageFormat;

use super::common::{Hand, ending, write_output};
use super::glb_out::GlbArgs;
use super::out::Stdout;

/// Most poses a new frame rate may make.
const MAX_POSES: f64 = 4_000_000.0;

/// Kinds of files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// Mesh, skeleton and animation (.glb)
    Glb,
    /// Poses, a line each (.jsonl)
    Jsonl,
    /// Poses with joint angles in degrees by name (.json)
    Json,
    /// Joint angles in degrees by name (.csv)
    Csv,
    /// Biovision hierarchy (.bvh)
    Bvh,
    /// Frames of 25 joints shaped like WebXR's (.webxr.json)
    Webxr,
    /// 21 landmarks a line (.landmarks.jsonl)
    Landmarks,
    /// BAP text (.bap)
    Bap,
    /// A picture, or a sheet of moments (.png)
    Png,
}

impl Format {
    /// What a file of this name holds; `--to` comes first.
    pub fn of(path: &Path, to: Option<Format>, allowed: &[Format]) -> anyhow::Result<Self> {
        let name = path.file_name().and_then(|n| n.to_str()).unwrap_or_default().to_ascii_lowercase();
        let told = match ending(path).as_str() {
            _ if to.is_some() => to,
            _ if name.ends_with(".webxr.json") => Some(Self::Webxr),
            _ if name.ends_with(".landmarks.jsonl") => Some(Self::Landmarks),
            "glb" => Some(Self::Glb),
            "jsonl" => Some(Self::Jsonl),
            "json" => Some(Self::Json),
            "csv" => Some(Self::Csv),
            "bvh" => Some(Self::Bvh),
            "bap" => Some(Self::Bap),
            "png" => Some(Self::Png),
            _ => None,
        };
        match told.filter(|format| allowed.contains(format)) {
            Some(format) => Ok(format),
            None => {
                let names: Vec<_> = allowed.iter().map(|f| f.ending()).collect();
                bail!("{}: cannot write this kind, allowed are {}", path.display(), names.join(", "))
            }
        }
    }

    fn ending(self) -> &'static str {
        match self {
            Self::Glb => ".glb",
            Self::Jsonl => ".jsonl",
            Self::Json => ".json",
            Self::Csv => ".csv",
            Self::Bvh => ".bvh",
            Self::Webxr => ".webxr.json",
            Self::Landmarks => ".landmarks.jsonl",
            Self::Bap => ".bap",
            Self::Png => ".png",
        }
    }

    /// What every command with poses writes.
    pub const MOTIONS: [Format; 7] = [
        Format::Glb,
        Format::Jsonl,
        Format::Json,
        Format::Csv,
        Format::Bvh,
        Format::Webxr,
        Format::Landmarks,
    ];
}

/// What is written, and how.
#[derive(Debug, clap::Args)]
pub struct OutArgs {
    /// Kind of file, where the name's ending does not tell
    #[arg(long, value_enum, value_name = "FORMAT")]
    pub to: Option<Format>,
    /// Write this many frames a second, interpolated, in place of the frames there are
    #[arg(long, value_name = "HZ", value_parser = frame_rate)]
    pub fps: Option<f64>,
    /// Write this hand alone
    #[arg(long, value_enum, value_name = "HAND")]
    pub only: Option<Hand>,
    #[command(flatten)]
    pub glb: GlbArgs,
}

fn frame_rate(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if (0.1..=1000.0).contains(&v) => Ok(v),
        _ => Err("allowed 0.1 to 1000 frames per second".into()),
    }
}

impl OutArgs {
    /// The hand and the instants asked for.
    pub fn chosen(&self, mut clip: PoseClip) -> anyhow::Result<PoseClip> {
        if let Some(hand) = self.only {
            let side = Side::from(hand);
            clip.header.hands.retain(|h| h.side == side);
            clip.frames.retain(|f| f.pose.side == side);
            ensure!(!clip.frames.is_empty(), "there is no {} hand", side.name());
        }
        let Some(rate) = self.fps else { return Ok(clip) };
        let times = || clip.frames.iter().map(|f| f.time);
        let span = times().fold(0.0, f64::max) - times().fold(f64::INFINITY, f64::min);
        ensure!(span * rate <= MAX_POSES, "--fps {rate}: more than {MAX_POSES} poses");
        Ok(clip.even(rate))
    }

    /// The bytes of a file. `facts` go into the extras of a GLB.
    pub fn bytes(
        &self,
        clip: PoseClip,
        morphology: &Morphology,
        format: Format,
        facts: serde_json::Map<String, serde_json::Value>,
    ) -> anyhow::Result<Vec<u8>> {
        let clip = self.chosen(clip)?;
        let rate = self.fps.unwrap_or_else(|| clip_rate(&clip));
        Ok(match format {
            Format::Glb => self.glb.read()?.write(&clip, morphology, facts)?,
            Format::Jsonl => write_to(Vec::new(), &clip)?,
            Format::Json => one_document(&clip)?,
            Format::Csv => export::csv(&clip)?.into_bytes(),
            Format::Bvh => export::bvh(&clip, morphology, self.glb.names.into(), rate)?.into_bytes(),
            Format::Webxr => {
                let mut text = serde_json::to_vec(&export::webxr(&clip, morphology)?)?;
                text.push(b'\n');
                text
            }
            Format::Landmarks => export::landmarks21(&clip, morphology)?.into_bytes(),
            Format::Bap | Format::Png => bail!("cannot write {} from here", format.ending()),
        })
    }
}

/// Writes a pose file line by line, or to standard output for `-`.
pub fn write_lines(clip: &PoseClip, path: &Path) -> anyhow::Result<()> {
    let cannot = || format!("cannot write {}", path.display());
    if path.as_os_str() == "-" {
        return write_to(BufWriter::new(Stdout), clip).map(drop);
    }
    // Numbers are written one by one: a buffer of its own spares the file's checks.
    let file = AtomicFile::create(path).with_context(cannot)?;
    let written = write_to(BufWriter::new(file), clip)?;
    let file = written.into_inner().map_err(|error| error.into_error()).with_context(cannot)?;
    file.commit().with_context(cannot)
}

fn write_to<W: Write>(writer: W, clip: &PoseClip) -> anyhow::Result<W> {
    let mut writer = PoseWriter::new(writer, clip.header.clone())?;
    clip.frames.iter().try_for_each(|frame| writer.write(frame))?;
    Ok(writer.finish()?)
}

/// The lines of a pose file as one JSON document: the header, with the frames in it.
fn one_document(clip: &PoseClip) -> anyhow::Result<Vec<u8>> {
    let bytes = write_to(Vec::new(), clip)?;
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

/// One hand and how it moves.
pub struct Motion {
    pub side: Side,
    pub morphology: Morphology,
    pub poses: Vec<(f64, HandPose)>,
    /// Frames per second, of more than one pose.
    pub rate: Option<f64>,
}

/// Pictures on a sheet of moments, and in one of its rows.
const MOMENTS: (usize, u32) = (24, 6);

/// Writes any kind of [`Format::MOTIONS`], or `.png` (one picture, or a sheet of moments).
pub fn write(motion: Motion, path: &Path, out: &OutArgs, cell: (u32, u32)) -> anyhow::Result<()> {
    let allowed: Vec<Format> = Format::MOTIONS.into_iter().chain([Format::Png]).collect();
    let format = Format::of(path, out.to, &allowed)?;
    let mut header = PoseHeader::one(motion.side, Some(motion.morphology.clone()), motion.rate);
    header.made_by = Some(format!("handcast {}", env!("CARGO_PKG_VERSION")));
    let frames = motion.poses.into_iter().map(|(t, pose)| TimedPose::new(t, pose)).collect();
    let clip = PoseClip { header, frames };
    if format != Format::Png {
        let mut facts = serde_json::Map::new();
        facts.insert("frames_per_second".into(), motion.rate.into());
        return write_output(path, &out.bytes(clip, &motion.morphology, format, facts)?);
    }
    let mesh = HandMesh::generate(&motion.morphology, motion.side);
    let skeleton = Skeleton::new(&motion.morphology, motion.side);
    let clip = out.chosen(clip)?;
    let frames: Vec<_> = clip.frames.iter().map(|f| (f.time, skeleton.frames(&f.pose))).collect();
    let style = Style::default();
    let picture = match frames.as_slice() {
        [(_, frames)] => still(&mesh, frames, cell, &style),
        several => preview_sheet(&mesh, several, MOMENTS.0, MOMENTS.1, cell, &style),
    };
    let mut bytes = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut bytes, ImageFormat::Png).with_context(|| path.display().to_string())?;
    write_output(path, &bytes.into_inner())
}
