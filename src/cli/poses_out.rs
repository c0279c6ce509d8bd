//! Poses of one hand to the file a command was asked for, told by its name's ending.

use std::path::Path;

use anyhow::{Context, bail};
use handcast::gltf::{self, Clip, ExportOptions, HandTrack};
use handcast::hand::{HandMesh, HandPose, Morphology, Side, Skeleton};
use handcast::io::atomic::AtomicFile;
use handcast::io::poses::{PoseClip, PoseHeader, TimedPose};
use handcast::render::{Style, camera_around, preview_sheet, render_hand};
use image::{ImageFormat, RgbaImage};
use nalgebra::{Point3, Vector3};

/// One hand and how it moves.
pub struct Motion {
    pub side: Side,
    pub morphology: Morphology,
    pub poses: Vec<(f64, HandPose)>,
    /// Frames per second, of more than one pose.
    pub rate: Option<f64>,
}

/// Writes `.jsonl` (poses), `.glb` (mesh and animation) or `.png` (one picture, or a sheet of moments).
pub fn write(motion: Motion, path: &Path, cell: (u32, u32)) -> anyhow::Result<()> {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    let to = || path.display().to_string();
    match ending.as_str() {
        "jsonl" => {
            let header = PoseHeader::one(motion.side, Some(motion.morphology), motion.rate);
            let frames = motion.poses.into_iter().map(|(t, pose)| TimedPose::new(t, pose)).collect();
            PoseClip { header, frames }.write(path)?;
        }
        "glb" => {
            let track = HandTrack { morphology: motion.morphology, poses: motion.poses };
            let bytes = gltf::export(&Clip { hands: vec![track] }, &ExportOptions::default())?;
            AtomicFile::write_all_to(path, &bytes).with_context(to)?;
        }
        "png" => {
            let mut bytes = std::io::Cursor::new(Vec::new());
            picture(&motion, cell).write_to(&mut bytes, ImageFormat::Png).with_context(to)?;
            AtomicFile::write_all_to(path, &bytes.into_inner()).with_context(to)?;
        }
        _ => bail!("{}: the name must end in .jsonl, .glb or .png", path.display()),
    }
    Ok(())
}

/// Pictures on a sheet of moments, and in one of its rows.
const MOMENTS: (usize, u32) = (24, 6);

fn picture(motion: &Motion, cell: (u32, u32)) -> RgbaImage {
    let mesh = HandMesh::generate(&motion.morphology, motion.side);
    let skeleton = Skeleton::new(&motion.morphology, motion.side);
    let frames: Vec<_> = motion.poses.iter().map(|(t, pose)| (*t, skeleton.frames(pose))).collect();
    let style = Style::default();
    match frames.as_slice() {
        [(_, frames)] => {
            let mut skinned = Default::default();
            mesh.skin(frames, &mut skinned);
            let points: Vec<_> =
                skinned.positions.iter().map(|p| Point3::from(Vector3::from(*p).cast::<f64>())).collect();
            let camera = camera_around(&points, -Vector3::z(), Vector3::y(), cell, 0.06);
            render_hand(&mesh, frames, &camera, cell, &style)
        }
        several => preview_sheet(&mesh, several, MOMENTS.0, MOMENTS.1, cell, &style),
    }
}
