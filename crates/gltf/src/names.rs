//! What other programs call the joints of a hand.

use std::collections::HashMap;
use std::sync::OnceLock;

use handcast_hand::{Finger, Joint, Side};

/// Which names the joint nodes bear.
///
/// A convention that lacks a joint gets a name in its own manner, so that all 25 nodes always have one:
///
/// | convention | wrist, index base, index tip of a left hand | lacks |
/// |---|---|---|
/// | `webxr` | `wrist`, `index-finger-phalanx-proximal`, `index-finger-tip` | – |
/// | `openxr` | `Wrist_L`, `Index_Proximal_L`, `Index_Tip_L` | has one more, `Palm_L` |
/// | `vrm` | `leftHand`, `leftIndexProximal`, `leftIndexTip` | tips, metacarpals of the long fingers |
/// | `mixamo` | `mixamorig:LeftHand`, `…LeftHandIndex1`, `…LeftHandIndex4` | metacarpals (`…Index0`) |
/// | `hanim` | `l_radiocarpal`, `l_metacarpophalangeal_2`, `l_carpal_distal_phalanx_2_tip` | – |
/// | `mpeg4` | `l_wrist`, `l_index1`, `l_index_tip` | tips |
///
/// WebXR names do not tell the sides apart: with two hands in a file, `left-` or `right-` stands before each.
/// Sources: `XRHandJoint` of WebXR Hand Input; `XrHandJointEXT` of OpenXR, spelled as rigs spell it; human bones
/// of VRM 1.0; the skeleton of Mixamo; joints and sites of ISO/IEC 19774-1:2019; the angle names of
/// ISO/IEC 14496-2, table of BAPs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum JointNames {
    /// WebXR Hand Input.
    #[default]
    WebXr,
    /// OpenXR hand tracking.
    OpenXr,
    /// VRM 1.0.
    Vrm,
    /// Mixamo.
    Mixamo,
    /// H-Anim 2.
    HAnim,
    /// MPEG-4 body animation.
    Mpeg4,
}

/// `Index`, `Middle`, …; the little finger is `Little` to some and `Pinky` to others.
fn capital(finger: Finger, little: &'static str) -> &'static str {
    ["Thumb", "Index", "Middle", "Ring", little][finger as usize]
}

/// The finger a joint belongs to and its place: 0 the metacarpal of a long finger, 1 to 3 the three bones of
/// the chain, 4 the tip. `None` for the wrist.
pub(super) fn place(joint: Joint) -> Option<(Finger, usize)> {
    Finger::ALL.into_iter().find_map(|finger| {
        let joints = Joint::of(finger);
        let at = joints.iter().position(|&j| j == joint)?;
        Some((finger, at + 5 - joints.len()))
    })
}

impl JointNames {
    /// All conventions.
    pub const ALL: [JointNames; 6] = [
        JointNames::WebXr,
        JointNames::OpenXr,
        JointNames::Vrm,
        JointNames::Mixamo,
        JointNames::HAnim,
        JointNames::Mpeg4,
    ];

    /// The name of a joint of the hand of `side` in a file with `hands` hands.
    pub fn name(self, joint: Joint, side: Side, hands: usize) -> String {
        let left = side == Side::Left;
        let word = if left { "Left" } else { "Right" };
        let letter = if left { 'l' } else { 'r' };
        let Some((finger, at)) = place(joint) else {
            return match self {
                JointNames::WebXr => format!("{}wrist", prefix(side, hands)),
                JointNames::OpenXr => format!("Wrist_{}", letter.to_ascii_uppercase()),
                JointNames::Vrm => format!("{}Hand", side.name()),
                JointNames::Mixamo => format!("mixamorig:{word}Hand"),
                JointNames::HAnim => format!("{letter}_radiocarpal"),
                JointNames::Mpeg4 => format!("{letter}_wrist"),
            };
        };
        let thumb = finger == Finger::Thumb;
        let bone = match (thumb, at) {
            (_, 0) | (true, 1) => "Metacarpal",
            (true, 2) | (false, 1) => "Proximal",
            (false, 2) => "Intermediate",
            (_, 3) => "Distal",
            _ => "Tip",
        };
        match self {
            JointNames::WebXr => format!("{}{}", prefix(side, hands), joint.webxr_name()),
            JointNames::OpenXr => {
                format!("{}_{bone}_{}", capital(finger, "Little"), letter.to_ascii_uppercase())
            }
            JointNames::Vrm => format!("{}{}{bone}", side.name(), capital(finger, "Little")),
            JointNames::Mixamo => format!("mixamorig:{word}Hand{}{at}", capital(finger, "Pinky")),
            JointNames::HAnim => {
                let number = finger as usize + 1;
                match (thumb, at) {
                    (_, 0) | (true, 1) => format!("{letter}_carpometacarpal_{number}"),
                    (true, 2) | (false, 1) => format!("{letter}_metacarpophalangeal_{number}"),
                    (true, 3) => format!("{letter}_carpal_interphalangeal_{number}"),
                    (false, 2) => format!("{letter}_carpal_proximal_interphalangeal_{number}"),
                    (false, 3) => format!("{letter}_carpal_distal_interphalangeal_{number}"),
                    _ => format!("{letter}_carpal_distal_phalanx_{number}_tip"),
                }
            }
            JointNames::Mpeg4 if at == 4 => format!("{letter}_{}_tip", finger.name()),
            JointNames::Mpeg4 => format!("{letter}_{}{at}", finger.name()),
        }
    }

    /// The name of the middle of the palm, for the one convention that has it.
    pub fn palm(self, side: Side) -> Option<&'static str> {
        (self == JointNames::OpenXr).then_some(match side {
            Side::Left => "Palm_L",
            Side::Right => "Palm_R",
        })
    }
}

/// What stands before WebXR names of one of two hands.
fn prefix(side: Side, hands: usize) -> &'static str {
    match (hands, side) {
        (..=1, _) => "",
        (_, Side::Left) => "left-",
        (_, Side::Right) => "right-",
    }
}

/// What a node's name says: the joint, `None` for the palm; the side where it tells.
pub type Meaning = (Option<Joint>, Option<Side>);

/// Letters and digits in lower case, without the words conventions put before and after.
fn plain(name: &str) -> String {
    // What stands before a colon is a name space.
    let name = name.rsplit(':').next().unwrap_or(name);
    let short: String =
        name.chars().filter(char::is_ascii_alphanumeric).map(|c| c.to_ascii_lowercase()).collect();
    let short = ["mixamorig", "bip001", "bip01"].iter().find_map(|p| short.strip_prefix(p)).unwrap_or(&short);
    match short.strip_prefix("xrhandjoint") {
        Some(rest) => rest.strip_suffix("ext").unwrap_or(rest).to_owned(),
        None => short.to_owned(),
    }
}

/// What other programs call a joint beside the conventions of [`JointNames`], as [`plain`] has it. These names are read,
/// never written:
///
/// | program | wrist, thumb base, index knuckle and end joint of a left hand |
/// |---|---|
/// | Rokoko Studio | `LeftHand`, `LeftFinger1Metacarpal`, `LeftFinger2Proximal`, `LeftFinger2Distal` |
/// | OptiTrack Motive, Poser, DAZ | `LHand`, `LThumb1`, `LIndex1`, `LIndex3`; `lMid1` |
/// | Perception Neuron | `LeftHand`, `LeftHandThumb1`, `LeftHandIndex1`, `LeftHandIndex3`; metacarpal `LeftInHandIndex` |
/// | Xsens MVN | `LeftHand`, `LeftFirstMC`, `LeftSecondPP`, `LeftSecondDP` |
/// | Character Studio | `Bip01 L Hand`, `Bip01 L Finger0`, `Bip01 L Finger1`, `Bip01 L Finger12` |
/// | Unreal | `hand_l`, `thumb_01_l`, `index_01_l`, `index_03_l`; metacarpal `index_metacarpal_l` |
/// | Rigify | `hand.L`, `thumb.01.L`, `f_index.01.L`, `f_index.03.L`; metacarpal `palm.01.L` |
/// | SMPL-X | `left_wrist`, `left_thumb1`, `left_index1`, `left_index3` |
fn spellings(joint: Joint, side: Side) -> Vec<String> {
    let (word, letter) = (side.name(), &side.name()[..1]);
    let Some((finger, at)) = place(joint) else {
        return vec![
            format!("{word}hand"),
            format!("{word}wrist"),
            format!("{letter}hand"),
            format!("hand{letter}"),
        ];
    };
    let name = finger.name();
    let (thumb, number) = (finger == Finger::Thumb, finger as usize + 1);
    let bone = match (thumb, at) {
        (_, 0) | (true, 1) => "metacarpal",
        (true, 2) | (false, 1) => "proximal",
        (false, 2) => "medial",
        (_, 3) => "distal",
        _ => "tip",
    };
    let mut out = vec![format!("{word}finger{number}{bone}")];
    if at == 0 {
        out.push(format!("{word}inhand{name}"));
        out.push(format!("{name}metacarpal{letter}"));
        out.push(format!("palm0{}{letter}", number - 1));
    }
    let ordinal = ["first", "second", "third", "fourth", "fifth"][finger as usize];
    if at < 4 {
        let short = match bone {
            "metacarpal" => "mc",
            "proximal" => "pp",
            "medial" => "mp",
            _ => "dp",
        };
        out.push(format!("{word}{ordinal}{short}"));
    }
    if (1..4).contains(&at) {
        let behind = if at == 1 { String::new() } else { (at - 1).to_string() };
        out.push(format!("{letter}finger{}{behind}", number - 1));
        out.push(format!("{name}0{at}{letter}"));
        out.push(format!("f{name}0{at}{letter}"));
        out.push(format!("{word}{name}{at}"));
        if finger == Finger::Middle {
            out.push(format!("{letter}mid{at}"));
        }
    }
    out
}

/// The joint a node's name stands for in any convention.
pub fn meaning(name: &str) -> Option<Meaning> {
    static KNOWN: OnceLock<HashMap<String, Meaning>> = OnceLock::new();
    let known = KNOWN.get_or_init(|| {
        let mut known = HashMap::from([("palm".to_owned(), (None, None))]);
        for names in JointNames::ALL {
            for side in [Side::Left, Side::Right] {
                let told = Some(side);
                if let Some(palm) = names.palm(side) {
                    known.insert(plain(palm), (None, told));
                }
                for joint in Joint::ALL {
                    known.insert(plain(&names.name(joint, side, 2)), (Some(joint), told));
                    match names {
                        JointNames::WebXr => {
                            known.insert(plain(joint.webxr_name()), (Some(joint), None));
                        }
                        // As the interface itself has them, without a side: XR_HAND_JOINT_INDEX_TIP_EXT.
                        JointNames::OpenXr => {
                            let mut bare = plain(&names.name(joint, side, 2));
                            bare.pop();
                            known.insert(bare, (Some(joint), None));
                        }
                        _ => {}
                    }
                }
            }
        }
        for (side, joint) in [Side::Left, Side::Right].into_iter().flat_map(|s| Joint::ALL.map(|j| (s, j))) {
            for spelling in spellings(joint, side) {
                known.entry(spelling).or_insert((Some(joint), Some(side)));
            }
        }
        known
    });
    // Names of nodes are the file's; no known one is longer than this.
    (name.len() <= 64).then(|| known.get(&plain(name)).copied()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn every_name_is_unique_and_understood() {
        for names in JointNames::ALL {
            let mut seen = HashSet::new();
            for side in [Side::Left, Side::Right] {
                for joint in Joint::ALL {
                    let name = names.name(joint, side, 2);
                    assert_eq!(meaning(&name), Some((Some(joint), Some(side))), "{name}");
                    assert!(seen.insert(name));
                }
            }
        }
    }

    #[test]
    fn spellings_of_other_programs_are_understood() {
        let joints = [Joint::Wrist, Joint::ThumbMetacarpal, Joint::IndexProximal, Joint::IndexDistal];
        for names in [
            ["LeftHand", "LeftFinger1Metacarpal", "LeftFinger2Proximal", "LeftFinger2Distal"],
            ["LHand", "LThumb1", "LIndex1", "LIndex3"],
            ["Skeleton:LeftHand", "Skeleton:LeftHandThumb1", "LeftHandIndex1", "LeftHandIndex3"],
            ["LeftHand", "LeftFirstMC", "LeftSecondPP", "LeftSecondDP"],
            ["Bip01 L Hand", "Bip01 L Finger0", "Bip01 L Finger1", "Bip01 L Finger12"],
            ["hand_l", "thumb_01_l", "index_01_l", "index_03_l"],
            ["hand.L", "thumb.01.L", "f_index.01.L", "f_index.03.L"],
            ["left_wrist", "left_thumb1", "left_index1", "left_index3"],
        ] {
            for (name, joint) in names.into_iter().zip(joints) {
                assert_eq!(meaning(name), Some((Some(joint), Some(Side::Left))), "{name}");
            }
        }
        for (name, joint) in [
            ("RightInHandRing", Joint::RingMetacarpal),
            ("rMid2", Joint::MiddleIntermediate),
            ("palm.04.R", Joint::PinkyMetacarpal),
            ("RightFinger5Tip", Joint::PinkyTip),
        ] {
            assert_eq!(meaning(name), Some((Some(joint), Some(Side::Right))), "{name}");
        }
        // One spelling, one joint.
        let mut all = HashSet::new();
        for (side, joint) in [Side::Left, Side::Right].into_iter().flat_map(|s| Joint::ALL.map(|j| (s, j))) {
            for spelling in spellings(joint, side).into_iter().collect::<HashSet<_>>() {
                assert!(all.insert(spelling.clone()), "{spelling}");
                assert_eq!(meaning(&spelling), Some((Some(joint), Some(side))), "{spelling}");
            }
        }
    }

    #[test]
    fn names_are_those_of_the_conventions() {
        let name = |names: JointNames, joint| names.name(joint, Side::Left, 1);
        assert_eq!(name(JointNames::WebXr, Joint::ThumbProximal), "thumb-phalanx-proximal");
        assert_eq!(name(JointNames::OpenXr, Joint::PinkyTip), "Little_Tip_L");
        assert_eq!(name(JointNames::Vrm, Joint::ThumbMetacarpal), "leftThumbMetacarpal");
        assert_eq!(name(JointNames::Vrm, Joint::PinkyProximal), "leftLittleProximal");
        assert_eq!(name(JointNames::Mixamo, Joint::ThumbMetacarpal), "mixamorig:LeftHandThumb1");
        assert_eq!(name(JointNames::Mixamo, Joint::PinkyDistal), "mixamorig:LeftHandPinky3");
        assert_eq!(name(JointNames::HAnim, Joint::IndexDistal), "l_carpal_distal_interphalangeal_2");
        assert_eq!(name(JointNames::Mpeg4, Joint::RingMetacarpal), "l_ring0");
        assert_eq!(name(JointNames::Mpeg4, Joint::ThumbMetacarpal), "l_thumb1");
        let of = |text| meaning(text).map(|(joint, side)| (joint.map(Joint::webxr_name), side));
        assert_eq!(of("XR_HAND_JOINT_LITTLE_DISTAL_EXT"), Some((Some("pinky-finger-phalanx-distal"), None)));
        assert_eq!(of("mixamorigRightHandIndex2").map(|m| m.1), Some(Some(Side::Right)));
        assert_eq!(of("Palm_R"), Some((None, Some(Side::Right))));
        assert_eq!(of("Armature"), None);
    }
}
