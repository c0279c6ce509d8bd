//! The body that a hand of a rig hangs on: whether there is an arm, and which way it faces.

use std::borrow::Cow;
use std::collections::BTreeMap;

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::document::RigDocument;
use super::hand::RigHand;
use crate::names::unnumbered;
use handcast_hand::Side;

/// Lengths of a forearm, and of an upper arm, over that from the wrist to the middle knuckle.
const ARM_BONE: std::ops::Range<f64> = 1.2..6.0;
/// Nodes this close to one another are in one place, over the same length.
const SAME_PLACE: f64 = 0.05;
/// Nodes above the wrist among which an arm is looked for by its name: there may be twisting bones between.
const TWISTS: usize = 3;
/// Cosine of how far the axes of a body may be from those of the world.
const ALIGNED: f64 = 0.8;
/// Bodies that are turned by no more than this are not, radians: what single precision makes of one that stands straight.
const STRAIGHT: f64 = 3e-6;
/// What hips are called.
pub(super) const HIPS: [&str; 3] = ["hips", "hip", "pelvis"];

/// The words of a name, in lower case: what other signs part, and capitals after small letters.
pub(super) fn words(name: &str) -> Vec<String> {
    let mut out: Vec<String> = Vec::new();
    let mut before = ' ';
    for c in name.chars() {
        let begins = !before.is_alphabetic() || before.is_lowercase() && c.is_uppercase();
        if c.is_alphabetic() {
            match out.last_mut() {
                Some(word) if !begins => word.extend(c.to_lowercase()),
                _ => out.push(c.to_lowercase().collect()),
            }
        }
        before = c;
    }
    out
}

/// Whether a name is that of a bone of an arm.
fn names_arm(name: &str) -> bool {
    const ENDS: [&str; 7] = ["forearm", "lowerarm", "upperarm", "elbow", "shoulder", "ひじ", "腕"];
    const WORDS: [&str; 5] = ["arm", "clavicle", "radius", "ulna", "humerus"];
    words(name)
        .iter()
        .any(|word| WORDS.contains(&word.as_str()) || ENDS.iter().any(|end| word.ends_with(end)))
}

/// The node of the arm that a wrist hangs on: one named so, a joint as long as a forearm that carries some of the mesh, or a
/// chain of two bones as long as those of an arm. `palm` may lie between.
pub(super) fn arm(
    document: &RigDocument,
    wrist: usize,
    knuckle: usize,
    palm: Option<usize>,
) -> Option<usize> {
    let up = |node: &usize| document.parents.get(*node).copied().flatten();
    let place = |node: usize| document.world[node].isometry.translation.vector;
    let above = || std::iter::successors(up(&wrist), up).filter(|node| Some(*node) != palm);
    if let Some(named) = above().take(TWISTS).find(|&node| names_arm(&document.names[node])) {
        return Some(named);
    }
    let unit = (place(knuckle) - place(wrist)).norm().max(1e-9);
    let next = |from: usize| {
        let mut nodes = std::iter::successors(up(&from), up).filter(|node| Some(*node) != palm);
        let far = |node: &usize| (place(from) - place(*node)).norm() > SAME_PLACE * unit;
        let node = nodes.find(far)?;
        ARM_BONE.contains(&((place(from) - place(node)).norm() / unit)).then_some(node)
    };
    let forearm = next(wrist)?;
    let of_mesh = document.is_joint[forearm] && document.carries[forearm];
    (of_mesh || next(forearm).is_some()).then_some(forearm)
}

/// Where the shoulder is of an arm that a wrist hangs on by `arm`, its forearm: where the upper arm begins, by names.
fn shoulder(document: &RigDocument, arm: usize) -> Option<Vector3<f64>> {
    let is_collar = |name: &str| words(name).iter().any(|w| w == "clavicle" || w.ends_with("shoulder"));
    let up = |node: &usize| document.parents.get(*node).copied().flatten();
    let named = |node: &usize| names_arm(&document.names[*node]) && !is_collar(&document.names[*node]);
    let upper = std::iter::successors(Some(arm), up).take(2 * TWISTS).filter(named).last()?;
    (upper != arm).then(|| document.world[upper].isometry.translation.vector)
}

/// How the body stands that hands on arms belong to, from a person upright (+Y) who faces +Z: up is the axis of the world
/// nearest to the way from the hips to the head, left from what names call right to what they call left ([`across`]); of a body with
/// one hand and no such names the axis nearest to the way from or to the shoulder from the middle of the body. `None` where it stands
/// like that, or bones do not tell.
pub(super) fn stands(
    document: &RigDocument,
    bones: &[(Cow<str>, usize)],
    hands: &[RigHand],
) -> Option<UnitQuaternion<f64>> {
    let place = |node: usize| document.world[node].isometry.translation.vector;
    let bone = |wanted: &[&str]| {
        let told = |name: &&str| bones.iter().find(|(bone, _)| bone == *name).map(|(_, node)| *node);
        let named = |name: &&str| {
            let is = |node: &usize| words(&document.names[*node]).iter().any(|word| word == *name);
            (0..document.names.len()).find(|node| document.is_joint[*node] && is(node))
        };
        wanted.iter().find_map(told).or_else(|| wanted.iter().find_map(named)).map(place)
    };
    let (low, high) = (bone(&[&HIPS[..], &["spine"]].concat()), bone(&["head", "neck"]));
    let on_arm = |side: Side| hands.iter().find(|hand| hand.side == side && hand.arm.is_some());
    let (left, right) = (on_arm(Side::Left), on_arm(Side::Right));
    if left.is_none() && right.is_none() {
        return None;
    }
    let up = axis(low.zip(high).map_or_else(Vector3::y, |(low, high)| high - low))?;
    let level = |v: Vector3<f64>| (v - up * v.dot(&up)).try_normalize(1e-9);
    let wrists: Vec<usize> = hands.iter().filter_map(RigHand::wrist).collect();
    let left = match (across(document, &wrists, &level), left, right) {
        (Some(left), ..) => left,
        (None, Some(left), Some(right)) => level(place(left.wrist()?) - place(right.wrist()?))?,
        (None, Some(left), None) => axis(level(shoulder(document, left.arm?)? - low.or(high)?)?)?,
        (None, None, right) => axis(level(low.or(high)? - shoulder(document, right?.arm?)?)?)?,
    };
    let turn = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[left, up, left.cross(&up)]));
    Some(UnitQuaternion::from_rotation_matrix(&turn)).filter(|turn| turn.angle() > STRAIGHT)
}

/// From the right of a body to its left: the median of the ways between joints that are called alike but for their side, above the
/// `wrists`. Arms may hang in different ways, and names be wrong here and there.
fn across(
    document: &RigDocument,
    wrists: &[usize],
    level: &dyn Fn(Vector3<f64>) -> Option<Vector3<f64>>,
) -> Option<Vector3<f64>> {
    // One of each side, or none where several are called so.
    let mut pairs: BTreeMap<String, [Option<Option<usize>>; 2]> = BTreeMap::new();
    for (node, name) in document.names.iter().enumerate().filter(|(node, _)| document.is_joint[*node]) {
        if wrists.iter().any(|&wrist| document.is_below(node, wrist)) {
            continue;
        }
        let Some((side, alike)) = sided(name) else { continue };
        let slot = &mut pairs.entry(alike).or_default()[side as usize];
        *slot = Some(if slot.is_none() { Some(node) } else { None });
    }
    let place = |node: usize| document.world[node].isometry.translation.vector;
    let way = |pair: &[Option<Option<usize>>; 2]| {
        let [left, right] = [pair[0]??, pair[1]??];
        level(place(left) - place(right))
    };
    let ways: Vec<Vector3<f64>> = pairs.values().filter_map(way).collect();
    let rough = level(ways.iter().sum())?;
    let up = ways.iter().map(|way| rough.cross(way)).max_by(|a, b| a.norm().total_cmp(&b.norm()))?;
    let Some(up) = up.try_normalize(1e-12) else { return Some(rough) };
    let mut angles: Vec<f64> =
        ways.iter().map(|way| rough.cross(way).dot(&up).atan2(rough.dot(way))).collect();
    angles.sort_by(f64::total_cmp);
    let middle = (angles[(angles.len() - 1) / 2] + angles[angles.len() / 2]) / 2.0;
    Some(UnitQuaternion::from_scaled_axis(up * middle) * rough)
}

/// The side that a name tells, and the name without it.
fn sided(name: &str) -> Option<(Side, String)> {
    const SIDES: [(Side, [&str; 3]); 2] =
        [(Side::Left, ["left", "l", "左"]), (Side::Right, ["right", "r", "右"])];
    let name = std::iter::successors(Some(name), |name| unnumbered(name)).last().unwrap_or(name);
    let mut rest = words(name);
    for (side, called) in SIDES {
        let is = |word: &String| called.contains(&word.as_str());
        if let Some(at) = rest.iter().position(is) {
            rest[at] = "*".into();
        } else if let Some(short) = rest.first().and_then(|word| word.strip_prefix(called[2])) {
            rest[0] = format!("*{short}");
        } else {
            continue;
        }
        let digits: String = name.chars().filter(char::is_ascii_digit).collect();
        return Some((side, format!("{} {digits}", rest.join(" "))));
    }
    None
}

/// The axis of the world, either way, along which a vector points.
fn axis(v: Vector3<f64>) -> Option<Vector3<f64>> {
    let v = v.try_normalize(1e-9)?;
    let k = v.iamax();
    let mut out = Vector3::zeros();
    out[k] = v[k].signum();
    (v[k].abs() >= ALIGNED).then_some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_tell_sides() {
        let alike = |left: &str, right: &str| {
            let [(a, left), (b, right)] = [left, right].map(|name| sided(name).unwrap());
            assert_eq!((a, b), (Side::Left, Side::Right));
            assert_eq!(left, right);
        };
        alike("mixamorig:LeftUpLeg", "mixamorig:RightUpLeg");
        alike("thigh.L", "thigh.R");
        alike("J_Bip_L_UpperArm", "J_Bip_R_UpperArm");
        alike("Bip01 L Thigh", "Bip01 R Thigh");
        alike("calf_l", "calf_r");
        alike("左ひざ", "右ひざ");
        alike("mixamorig:LeftArm_07", "mixamorig:RightArm_031");
        assert_ne!(sided("LeftToe1"), sided("LeftToe2"));
        assert_eq!(sided("Hips"), None);
    }

    #[test]
    fn arms_are_known_by_their_names() {
        for name in [
            "LeftForeArm",
            "mixamorig:LeftForeArm",
            "lowerarm_l",
            "leftLowerArm",
            "forearm.L",
            "DEF-forearm.L.001",
            "Bip01 L Forearm",
            "lForearmBend",
            "l_elbow",
            "左ひじ",
            "arm",
            "RightArm_023",
            "CC_Base_L_Forearm",
        ] {
            assert!(names_arm(name), "{name}");
        }
        for name in ["Armature", "Root", "armature_01", "Charmaine", "Hand_L", "swarm", "Bone", ""] {
            assert!(!names_arm(name), "{name}");
        }
    }
}
