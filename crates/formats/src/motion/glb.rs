//! Animated hands as glTF ([`handcast_gltf`]), binary or as one document of JSON: mesh, skeleton and one animation, or a rig made
//! elsewhere that moves.
//!
//! Reading takes files of any program ([`handcast_gltf::import`]). The poses are those at the keys; between them a player
//! interpolates.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use super::format::{is_json, names_any};
use super::{
    ContentError, Format, Keeps, Lost, Motion, MotionError, WriteError, WriteOptions, Writer, Written, vrma,
};
use handcast_gltf::{
    Clip, GltfError, ImportOptions, Imported, JointMap, as_document, export, import, retarget,
};
use handcast_hand::{ClipHand, JointAngle, PoseClip, Side, TimedPose};
use handcast_limits::Limits;

/// Its row.
pub(crate) static FORMAT: Format = Format {
    id: "glb",
    name: "animated hand (glTF)",
    kind: "glb",
    ending: ".glb",
    hands: 2,
    sniff: |bytes| bytes.starts_with(b"glTF") && !vrma::names_extension(bytes),
    read: |bytes, limits| Ok(read(&FORMAT, bytes, limits)?.into()),
    write: Some(Writer {
        keeps: Keeps::all(Lost::Bridged),
        write: |clip, options, out| {
            let Written { bytes, notes } = write_glb(clip, options)?;
            out.write_all(&bytes)?;
            Ok(notes)
        },
    }),
};

/// The same as JSON, with all data in it.
pub(crate) static DOCUMENT: Format = Format {
    id: "gltf",
    name: "animated hand (glTF as JSON)",
    kind: "glb",
    ending: ".gltf",
    hands: 2,
    sniff: |bytes| is_json(bytes) && names_any(bytes, &["asset", "accessors", "bufferViews"]),
    read: |bytes, limits| Ok(read(&DOCUMENT, bytes, limits)?.into()),
    write: Some(Writer {
        keeps: Keeps::all(Lost::Bridged),
        write: |clip, options, out| {
            let Written { bytes, notes } = write_glb(clip, options)?;
            out.write_all(&as_document(&bytes)?)?;
            Ok(notes)
        },
    }),
};

/// A hand made elsewhere that is moved in place of the built-in one.
#[derive(Clone, Debug)]
pub struct Rig {
    /// Where it was read: files it refers to are looked for in the same folder, and messages name it.
    pub path: PathBuf,
    /// The file.
    pub bytes: Vec<u8>,
    /// Which of its joints is which, where names do not tell.
    pub map: Option<JointMap>,
}

/// How far each of two hands of unknown places is put to its side, metres: hands in each other could not be told apart.
const ASIDE: f64 = 0.15;

fn read(format: &'static Format, bytes: &[u8], limits: &Limits) -> Result<Motion, ContentError> {
    let mut options = ImportOptions::default();
    options.limits = limits.clone();
    Ok(motion(format, import(bytes, &options)?))
}

impl Motion {
    /// As [`Motion::parse_within`], of a .glb or .gltf file whose joints a map names. Files that a .gltf refers to are
    /// opened as there.
    ///
    /// # Errors
    /// See [`MotionError`].
    pub fn parse_mapped(
        path: &Path,
        bytes: &[u8],
        map: &JointMap,
        limits: &Limits,
    ) -> Result<Self, MotionError> {
        let format = if is_json(bytes) { &DOCUMENT } else { &FORMAT };
        let mut options = ImportOptions::default();
        (options.folder, options.map, options.limits) = (path.parent(), Some(map), limits.clone());
        let read = import(bytes, &options).map_err(ContentError::from);
        let sound = read.and_then(|found| motion(format, found).sound(limits));
        sound.map_err(|reason| MotionError::Content { path: path.into(), reason })
    }
}

/// The content of a file of glTF with what it refers to, which lies beside it.
pub(super) fn with_files<'a>(
    path: &Path,
    bytes: &'a [u8],
    limits: &Limits,
) -> Result<Cow<'a, [u8]>, ContentError> {
    Ok(match path.parent() {
        Some(folder) if is_json(bytes) => handcast_gltf::with_buffers(bytes, folder, limits)?,
        _ => bytes.into(),
    })
}

/// What an import found, as a motion.
pub(super) fn motion(format: &'static Format, found: Imported) -> Motion {
    let mut clip = PoseClip::default();
    clip.header.rate = found.rate;
    let told = |angle: &JointAngle| found.hands.iter().all(|hand| hand.angles.contains(angle));
    let angles = JointAngle::ALL.into_iter().filter(told).collect();
    let two = found.hands.len() > 1;
    for hand in found.hands {
        clip.header.hands.push(ClipHand { side: hand.side, morphology: hand.morphology });
        clip.frames.extend(hand.poses.into_iter().map(|(time, pose)| TimedPose::new(time, pose)));
    }
    if two && !found.placed {
        for frame in &mut clip.frames {
            // A person who faces the camera has the left hand at +x.
            frame.pose.translation.x = if frame.pose.side == Side::Left { ASIDE } else { -ASIDE };
        }
    }
    let (placed, notes) = (found.placed, found.notes);
    Motion { keyed: true, placed, angles, notes, ..Motion::of(format, clip) }
}

/// The poses at the keys of a GLB, of every hand.
///
/// # Errors
/// See [`handcast_gltf::import`].
pub fn clip_from_glb(glb: &[u8]) -> Result<PoseClip, GltfError> {
    Ok(motion(&FORMAT, import(glb, &ImportOptions::default())?).clip)
}

/// Writes the valid poses, as [`WriteOptions::gltf`] says; on [`WriteOptions::rig`] where there is one, with a note when
/// it has no hand of a side.
///
/// # Errors
/// [`WriteError::Glb`], [`WriteError::Rig`].
pub fn write_glb(clip: &PoseClip, options: &WriteOptions) -> Result<Written, WriteError> {
    let clip = Clip::of(clip, &options.morphology);
    let Some(Rig { path, bytes, map }) = &options.rig else {
        return Ok(export(&clip, &options.gltf)?.into());
    };
    let moved = retarget(&clip, bytes, path.parent(), map.as_ref(), &options.gltf)
        .map_err(|reason| WriteError::Rig { path: path.clone(), reason })?;
    let mut written = Written::from(moved.glb);
    written.notes.extend(moved.lacking.iter().map(|lacking| format!("{}: {lacking}", path.display())));
    if moved.sides.len() < clip.hands.len() {
        let names: Vec<_> = moved.sides.iter().map(|s| s.name()).collect();
        written.notes.push(format!("{}: only its {} hand moves", path.display(), names.join(" and ")));
    }
    Ok(written)
}
