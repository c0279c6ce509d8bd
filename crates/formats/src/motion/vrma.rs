//! Animations for VRM avatars ([`handcast_gltf::export_vrma`]): hands and fingers against the T-pose, without places.

use super::{ContentError, Format, Keeps, Lost, Motion, WriteError, WriteOptions, Writer, glb};
use handcast_gltf::{Clip, ImportOptions, export_vrma, import};
use handcast_hand::{Finger, JointAngle, PoseClip};
use handcast_limits::Limits;

/// Its row. It is a GLB as well, and told apart by its extension.
pub(crate) static FORMAT: Format = Format {
    id: "vrma",
    name: "animation for VRM avatars",
    kind: "vrma",
    ending: ".vrma",
    hands: 2,
    sniff: |bytes| bytes.starts_with(b"glTF") && names_extension(bytes),
    read: |bytes, limits| Ok(read(bytes, limits)?.into()),
    write: Some(Writer { keeps: Keeps::all(Lost::Bridged), write }),
};

/// Whether the document of a GLB, which comes first, names the extension.
pub(super) fn names_extension(bytes: &[u8]) -> bool {
    let length =
        bytes.get(12..16).and_then(|word| word.try_into().ok()).map_or(0, u32::from_le_bytes) as usize;
    let document = bytes.get(20..).unwrap_or_default();
    super::format::says(&document[..length.min(document.len())], "\"VRMC_vrm_animation\"")
}

/// Ways of a wrist that are told of, metres.
const MOVED: f64 = 0.005;
/// Bends of a palm that are told of, radians.
const TOLD: f64 = 0.5 * std::f64::consts::PI / 180.0;

fn read(bytes: &[u8], limits: &Limits) -> Result<Motion, ContentError> {
    let mut options = ImportOptions::default();
    options.limits = limits.clone();
    Ok(glb::motion(&FORMAT, import(bytes, &options)?))
}

fn write(
    clip: &PoseClip,
    options: &WriteOptions,
    out: &mut dyn std::io::Write,
) -> Result<Vec<String>, WriteError> {
    out.write_all(&export_vrma(&Clip::of(clip, &options.morphology), &options.gltf)?)?;
    let palms = Finger::LONG.into_iter().filter_map(Finger::palm_flexion);
    let bent = |angle: &JointAngle| clip.frames.iter().any(|f| f.valid && f.pose.angle(*angle).abs() > TOLD);
    let names: Vec<&str> = palms.filter(bent).map(JointAngle::name).collect();
    let flat = (!names.is_empty()).then(|| {
        format!(
            "avatars have no bones in the palm: fingers turn as they do, the palm itself stays flat ({}); read back \
             they are told",
            names.join(", ")
        )
    });
    let moves = clip.header.hands.iter().any(|hand| {
        let mut places = clip.of(hand.side).filter(|f| f.valid).map(|f| f.pose.translation);
        let first = places.next();
        places.any(|place| first.is_some_and(|first| (place - first).norm() > MOVED))
    });
    let way = moves.then(|| {
        "an avatar's arms say where its hands are: the way of the wrist is left out, also where this file is read back".to_owned()
    });
    Ok(flat.into_iter().chain(way).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::tests::feasible;
    use handcast_hand::Side;

    #[test]
    fn two_hands_are_beside_one_another() {
        let [left, right] = [Side::Left, Side::Right].map(feasible);
        let mut both = left.clone();
        both.header.hands.extend(right.header.hands.clone());
        both.frames.extend(right.frames.clone());
        for (clip, aside) in [(left, 0.0), (both, 0.15)] {
            let file = FORMAT.write(&clip, &WriteOptions::default()).unwrap();
            let back = Motion::parse("-".as_ref(), &file.bytes).unwrap();
            assert!(!back.placed);
            for frame in &back.clip.frames {
                let x = if frame.pose.side == Side::Left { aside } else { -aside };
                assert_eq!(frame.pose.translation.as_slice(), [x, 0.0, 0.0]);
            }
        }
    }
}
