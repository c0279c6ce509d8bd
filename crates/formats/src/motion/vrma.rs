//! Animations for VRM avatars ([`handcast_gltf::export_vrma`]): hands and fingers against the T-pose, without places.

use super::{ContentError, Format, Motion, WriteError, WriteOptions, glb};
use handcast_gltf::{Clip, export_vrma};
use handcast_hand::PoseClip;
use handcast_limits::Limits;

/// Its row. It is a GLB as well, and told apart by its extension.
pub(crate) static FORMAT: Format = Format {
    id: "vrma",
    name: "animation for VRM avatars",
    kind: "vrma",
    ending: ".vrma",
    hands: 2,
    sniff: |bytes| bytes.starts_with(b"glTF") && names_extension(bytes),
    read,
    write: Some(write),
};

/// Whether the document of a GLB, which comes first, names the extension.
pub(super) fn names_extension(bytes: &[u8]) -> bool {
    let length =
        bytes.get(12..16).and_then(|word| word.try_into().ok()).map_or(0, u32::from_le_bytes) as usize;
    let document = bytes.get(20..).unwrap_or_default();
    super::format::says(&document[..length.min(document.len())], "\"VRMC_vrm_animation\"")
}

fn read(bytes: &[u8], limits: &Limits) -> Result<Motion, ContentError> {
    Ok(Motion { keyed: true, placed: false, ..Motion::of(&FORMAT, glb::clip_within(bytes, limits)?) })
}

fn write(
    clip: &PoseClip,
    options: &WriteOptions,
    out: &mut dyn std::io::Write,
) -> Result<Vec<String>, WriteError> {
    out.write_all(&export_vrma(&Clip::of(clip, &options.morphology), &options.gltf)?)?;
    Ok(Vec::new())
}
