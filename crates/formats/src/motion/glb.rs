//! Animated hands as binary glTF ([`handcast_gltf`]): mesh, skeleton and one animation, or a rig made elsewhere that
//! moves.
//!
//! Reading takes files that this program wrote: the names of the joints, the side in the wrist's `extras` and the sizes
//! in `asset.extras` tell what is what. The poses are those at the keys; between them a player interpolates.

use std::path::PathBuf;

use super::{ContentError, Format, Keeps, Lost, Motion, WriteError, WriteOptions, Writer, Written, vrma};
use handcast_gltf::{Clip, GltfError, JointMap, export, import_poses_within, retarget};
use handcast_hand::{ClipHand, PoseClip, TimedPose};
use handcast_limits::Limits;

/// Its row.
pub(crate) static FORMAT: Format = Format {
    id: "glb",
    name: "animated hand (glTF)",
    kind: "glb",
    ending: ".glb",
    hands: 2,
    sniff: |bytes| bytes.starts_with(b"glTF") && !vrma::names_extension(bytes),
    read: |bytes, limits| Ok(read(bytes, limits)?.into()),
    write: Some(Writer {
        keeps: Keeps::all(Lost::Bridged),
        write: |clip, options, out| {
            let Written { bytes, notes } = write_glb(clip, options)?;
            out.write_all(&bytes)?;
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

fn read(bytes: &[u8], limits: &Limits) -> Result<Motion, ContentError> {
    Ok(Motion { keyed: true, ..Motion::of(&FORMAT, clip_within(bytes, limits)?) })
}

/// The poses at the keys of a GLB that this program wrote, of every hand.
///
/// # Errors
/// See [`handcast_gltf::import_poses`].
pub fn clip_from_glb(glb: &[u8]) -> Result<PoseClip, GltfError> {
    clip_within(glb, &Limits::default())
}

pub(super) fn clip_within(glb: &[u8], limits: &Limits) -> Result<PoseClip, GltfError> {
    let mut clip = PoseClip::default();
    for hand in import_poses_within(glb, limits)? {
        clip.header.hands.push(ClipHand { side: hand.side, morphology: hand.morphology });
        clip.frames.extend(hand.poses.into_iter().map(|(time, pose)| TimedPose::new(time, pose)));
    }
    Ok(clip)
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
    if moved.sides.len() < clip.hands.len() {
        let names: Vec<_> = moved.sides.iter().map(|s| s.name()).collect();
        written.notes.push(format!("{}: only its {} hand moves", path.display(), names.join(" and ")));
    }
    Ok(written)
}
