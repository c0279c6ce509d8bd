//! Poses of one hand to the file a command was asked for, told by its name's ending.

use std::path::Path;

use anyhow::{Context, bail};
use handcast::gltf::ExportOptions;
use handcast::hand::{HandMesh, HandPose, Morphology, Side, Skeleton};
use handcast::io::poses::{PoseClip, PoseHeader, TimedPose};
use handcast::render::{Film, Style, preview_sheet};
use image::ImageFormat;

use super::common::{ending, to_glb, write_output};

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

/// Writes `.jsonl` (poses), `.glb` (mesh and animation) or `.png` (one picture, or a sheet of moments).
pub fn write(motion: Motion, path: &Path, cell: (u32, u32)) -> anyhow::Result<()> {
    let header = PoseHeader::one(motion.side, Some(motion.morphology.clone()), motion.rate);
    let frames = motion.poses.into_iter().map(|(t, pose)| TimedPose::new(t, pose)).collect();
    let clip = PoseClip { header, frames };
    match ending(path).as_str() {
        "jsonl" => Ok(clip.write(path)?),
        "glb" => write_output(path, &to_glb(&clip, &motion.morphology, &ExportOptions::default())?),
        "png" => {
            let mesh = HandMesh::generate(&motion.morphology, motion.side);
            let skeleton = Skeleton::new(&motion.morphology, motion.side);
            let frames: Vec<_> = clip.frames.iter().map(|f| (f.time, skeleton.frames(&f.pose))).collect();
            let style = Style::default();
            let picture = match frames.as_slice() {
                [_] => Film::new(&mesh, &frames, cell, false).picture(0, &style),
                several => preview_sheet(&mesh, several, MOMENTS.0, MOMENTS.1, cell, &style),
            };
            let mut bytes = std::io::Cursor::new(Vec::new());
            picture.write_to(&mut bytes, ImageFormat::Png).with_context(|| path.display().to_string())?;
            write_output(path, &bytes.into_inner())
        }
        _ => bail!("{}: the name must end in .jsonl, .glb or .png", path.display()),
    }
}
