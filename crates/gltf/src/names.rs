//! What other programs call the joints of a hand.

use std::collections::{HashMap, HashSet};
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
    let kept = |c: char| c.is_ascii_alphanumeric() || !c.is_ascii() && c.is_alphabetic();
    let narrow = |c: char| match c {
        '０'..='９' => char::from(b'0' + (u32::from(c) - u32::from('０')) as u8),
        other => other.to_ascii_lowercase(),
    };
    let short: String = name.chars().map(narrow).filter(|c| kept(*c)).collect();
    if let Some(rest) = short.strip_prefix("mixamorig") {
        return rest.trim_start_matches(|c: char| c.is_ascii_digit()).to_owned();
    }
    let short = ["bip001", "bip01"].iter().find_map(|p| short.strip_prefix(p)).unwrap_or(&short);
    match short.strip_prefix("xrhandjoint") {
        Some(rest) => rest.strip_suffix("ext").unwrap_or(rest).to_owned(),
        None => short.to_owned(),
    }
}

/// A name without the number that a tool hung on it: `_015` of Sketchfab, `.001` of Blender.
pub(super) fn unnumbered(name: &str) -> Option<&str> {
    let bare = name.trim_end_matches(|c: char| c.is_ascii_digit());
    let number = &name[bare.len()..];
    match bare.as_bytes().last() {
        Some(b'_') if number.starts_with('0') => bare.strip_suffix('_'),
        Some(b'.') if number.len() == 3 => bare.strip_suffix('.'),
        _ => None,
    }
}

/// What a name may stand for as [`plain`] has it, and whether it is the name as it is: not without what Rigify, Reallusion,
/// VRoid and Oculus put before it, or a number behind it.
fn forms(name: &str) -> Vec<(String, bool)> {
    // What stands before a colon is a name space.
    let name = name.rsplit(':').next().unwrap_or(name);
    let mut forms = vec![(plain(name), true)];
    for text in std::iter::successors(Some(name), |text| unnumbered(text)) {
        let short = plain(text);
        for before in ["def", "ccbase", "jbip"] {
            forms.extend(short.strip_prefix(before).map(|rest| (rest.to_owned(), false)));
        }
        forms.extend(text.strip_prefix("b_").map(|rest| (plain(rest), false)));
        forms.push((short, false));
    }
    forms
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
/// | Blender, by hand | `Hand.L`, `Thumb1.L`, `Index1.L`, `Index3_L` |
/// | MikuMikuDance | `左手首`, `左親指０`, `左人指１`, `左人指３` |
/// | Oculus | `b_l_wrist`, `b_l_thumb1`, `b_l_index1`, `b_l_index3`; tip `b_l_index_null` |
/// | Reallusion | `CC_Base_L_Hand`, `CC_Base_L_Thumb1`, `CC_Base_L_Index1`, `CC_Base_L_Index3` |
///
/// The thumb of Unity and VRM 0, `LeftThumbProximal`, `LeftThumbIntermediate`, `LeftThumbDistal`, is told from others by the
/// names beside it: see [`readings`].
fn spellings(joint: Joint, side: Side) -> Vec<String> {
    let (word, letter) = (side.name(), &side.name()[..1]);
    let sign = if side == Side::Left { '左' } else { '右' };
    let Some((finger, at)) = place(joint) else {
        return vec![
            format!("{word}hand"),
            format!("{word}wrist"),
            format!("{letter}hand"),
            format!("hand{letter}"),
            format!("{sign}手首"),
        ];
    };
    let number = finger as usize + 1;
    let bone = match (finger == Finger::Thumb, at) {
        (_, 0) | (true, 1) => "metacarpal",
        (true, 2) | (false, 1) => "proximal",
        (false, 2) => "medial",
        (_, 3) => "distal",
        _ => "tip",
    };
    let mut out = vec![format!("{word}finger{number}{bone}")];
    if at == 0 {
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
        let digit = if finger == Finger::Thumb { at - 1 } else { at };
        out.push(format!("{sign}{}{digit}", ["親指", "人指", "中指", "薬指", "小指"][finger as usize]));
        if finger == Finger::Index {
            out.push(format!("{sign}人差指{digit}"));
        }
    }
    let also: &[&str] = match finger {
        Finger::Middle => &["middle", "mid"],
        Finger::Pinky => &["pinky", "little"],
        _ => &[finger.name()],
    };
    for name in also {
        match at {
            0 => out.extend([format!("{word}inhand{name}"), format!("{name}metacarpal{letter}")]),
            1..=3 => out.extend([
                format!("{name}0{at}{letter}"),
                format!("f{name}0{at}{letter}"),
                format!("{name}{at}{letter}"),
                format!("{word}{name}{at}"),
                format!("{word}hand{name}{at}"),
                format!("{letter}{name}{at}"),
            ]),
            _ => out.extend([format!("{name}4{letter}"), format!("{letter}{name}null")]),
        }
    }
    out
}

/// What a name says by itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Reading {
    /// The joint, `None` for the palm.
    pub(super) joint: Option<Joint>,
    /// The side where it tells.
    pub(super) side: Option<Side>,
    /// Not a name that something was cut off to understand it.
    pub(super) exact: bool,
    thumb: ThumbWord,
}

/// Words for bones of the thumb that conventions disagree about.
#[derive(Clone, Copy, Debug, PartialEq)]
enum ThumbWord {
    None,
    /// The first bone of the thumb to Unity and VRM 0, the second one to others.
    Proximal,
    /// The second bone to Unity and VRM 0, unknown to others.
    Intermediate,
}

/// Every name that is understood.
fn table() -> &'static HashMap<String, (Meaning, ThumbWord)> {
    static KNOWN: OnceLock<HashMap<String, (Meaning, ThumbWord)>> = OnceLock::new();
    KNOWN.get_or_init(|| {
        let mut known = HashMap::from([("palm".to_owned(), (None, None))]);
        for names in JointNames::ALL {
            for side in [Side::Left, Side::Right] {
                let told = Some(side);
                if let Some(palm) = names.palm(side) {
                    known.insert(plain(palm), (None, told));
                }
                for joint in Joint::ALL {
                    let name = names.name(joint, side, 2);
                    let name = plain(name.rsplit(':').next().unwrap_or_default());
                    match names {
                        JointNames::WebXr => {
                            known.insert(plain(joint.webxr_name()), (Some(joint), None));
                        }
                        // As the interface itself has them, without a side: XR_HAND_JOINT_INDEX_TIP_EXT.
                        JointNames::OpenXr => {
                            known.insert(name[..name.len() - 1].to_owned(), (Some(joint), None));
                        }
                        _ => {}
                    }
                    known.insert(name, (Some(joint), told));
                }
            }
        }
        for (side, joint) in [Side::Left, Side::Right].into_iter().flat_map(|s| Joint::ALL.map(|j| (s, j))) {
            for spelling in spellings(joint, side) {
                known.entry(spelling).or_insert((Some(joint), Some(side)));
            }
        }
        let mut out = HashMap::with_capacity(known.len() + 16);
        for (name, meaning) in known {
            // A proximal phalanx is always the second bone.
            let word = meaning.0 == Some(Joint::ThumbProximal)
                && name.contains("proximal")
                && !name.contains("phalanx");
            if word {
                let intermediate = name.replace("proximal", "intermediate");
                out.insert(intermediate, (meaning, ThumbWord::Intermediate));
            }
            out.insert(name, (meaning, if word { ThumbWord::Proximal } else { ThumbWord::None }));
        }
        out
    })
}

fn reading(name: &str) -> Option<Reading> {
    // Names of nodes are the file's; no known one is longer than this.
    if name.len() > 64 {
        return None;
    }
    forms(name).into_iter().find_map(|(form, exact)| {
        let ((joint, side), thumb) = table().get(&form).copied()?;
        // `palm.001` may be anything.
        (exact || joint.is_some() || side.is_some()).then_some(Reading { joint, side, exact, thumb })
    })
}

/// The joint a node's name stands for in any convention.
pub fn meaning(name: &str) -> Option<Meaning> {
    let read = reading(name).filter(|read| read.thumb != ThumbWord::Intermediate)?;
    Some((read.joint, read.side))
}

/// What the names of one skeleton stand for, in their order. Proximal, intermediate and distal bone of a thumb are its three
/// bones where one of a side is intermediate, or none the metacarpal; else the proximal one is the second.
pub(super) fn readings<'a>(names: impl IntoIterator<Item = &'a str>) -> Vec<Option<Reading>> {
    let mut all: Vec<Option<Reading>> = names.into_iter().map(reading).collect();
    for side in [Some(Side::Left), Some(Side::Right), None] {
        let of_side = |read: &&Reading| read.side == side;
        let any = |test: &dyn Fn(&Reading) -> bool| all.iter().flatten().filter(of_side).any(test);
        let shifted = any(&|read| read.thumb == ThumbWord::Intermediate)
            || !any(&|read| read.joint == Some(Joint::ThumbMetacarpal));
        if !shifted {
            continue;
        }
        for read in all.iter_mut().flatten().filter(|read| read.side == side) {
            if read.thumb == ThumbWord::Proximal {
                read.joint = Some(Joint::ThumbMetacarpal);
            }
        }
    }
    all
}

/// As [`meaning`], of all the names of one skeleton, in their order: names of the thumb's bones that programs disagree about
/// are told by those beside them, and where one is known as it is, those with a number behind it are none.
pub fn meanings<'a>(names: impl IntoIterator<Item = &'a str>) -> Vec<Option<Meaning>> {
    let reads = readings(names);
    let meaning = |read: &Reading| (read.joint, read.side);
    let known: HashSet<Meaning> = reads.iter().flatten().filter(|read| read.exact).map(meaning).collect();
    let told = |read: Reading| Some(meaning(&read)).filter(|meaning| read.exact || !known.contains(meaning));
    reads.into_iter().map(|read| read.and_then(told)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_with_a_number_behind_them_are_others_beside_the_name_itself() {
        let index = Some((Some(Joint::IndexDistal), Some(Side::Right)));
        assert_eq!(meanings(["Index3.R", "Index3.R.001"]), [index, None]);
        assert_eq!(meanings(["Index3.R_01", "spine"]), [index, None]);
    }

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
            ["Hand.L", "Thumb1.L", "Index1_L", "Index3.L"],
            ["左手首", "左親指０", "左人指１", "左人指３"],
            ["b_l_wrist", "b_l_thumb1", "b_l_index1", "b_l_index3"],
            ["CC_Base_L_Hand", "CC_Base_L_Thumb1", "CC_Base_L_Index1", "CC_Base_L_Index3"],
            ["DEF-hand.L", "DEF-thumb.01.L", "DEF-f_index.01.L", "DEF-f_index.03.L.001"],
            ["J_Bip_L_Hand", "J_Bip_L_Thumb1", "J_Bip_L_Index1", "J_Bip_L_Index3"],
            ["mixamorig9LeftHand", "mixamorig9LeftHandThumb1", "LeftHandIndex1.001", "LeftHandIndex3_00"],
            ["mixamorig:LeftHand_034", "mixamorigLeftHandThumb1_035", "f_index.01.L_0412", "lIndex3_01"],
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
            ("b_r_pinky_null", Joint::PinkyTip),
            ("右小指２", Joint::PinkyIntermediate),
            ("CC_Base_R_Mid1", Joint::MiddleProximal),
            ("RightHandLittle3", Joint::PinkyDistal),
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
    fn thumbs_are_told_by_the_names_beside_them() {
        let joints = |names: &[&str]| -> Vec<Option<Joint>> {
            meanings(names.iter().copied()).into_iter().map(|told| told?.0).collect()
        };
        let (first, second, third) = (Joint::ThumbMetacarpal, Joint::ThumbProximal, Joint::ThumbDistal);
        let all = [Some(first), Some(second), Some(third)];
        assert_eq!(joints(&["LeftThumbProximal", "LeftThumbIntermediate", "LeftThumbDistal"]), all);
        assert_eq!(joints(&["Thumb Proximal.L", "Thumb Intermediate.L", "Thumb Distal.L"]), all);
        assert_eq!(joints(&["leftThumbMetacarpal", "leftThumbProximal", "leftThumbDistal"]), all);
        assert_eq!(joints(&["thumb-metacarpal", "thumb-phalanx-proximal", "thumb-phalanx-distal"]), all);
        assert_eq!(joints(&["l_thumb1", "leftThumbProximal", "l_thumb3"]), all);
        // Two bones; and a metacarpal of the other hand, which says nothing of this one.
        assert_eq!(joints(&["LeftThumbProximal", "LeftThumbDistal"]), [Some(first), Some(third)]);
        assert_eq!(joints(&["LeftThumbProximal", "rightThumbMetacarpal"]), [Some(first); 2]);
        assert_eq!(joints(&["LeftThumb2", "LeftThumb3"]), [Some(second), Some(third)]);
        assert_eq!(meaning("LeftThumbIntermediate"), None);
    }

    #[test]
    fn what_is_cut_off_a_name_is_told() {
        let exact = |name: &str| reading(name).map(|read| read.exact);
        assert_eq!(exact("hand.L"), Some(true));
        assert_eq!(exact("Rig:mixamorig2:LeftHand"), Some(true));
        assert_eq!(exact("DEF-hand.L"), Some(false));
        assert_eq!(exact("hand.L.001"), Some(false));
        for other in
            ["palm.001", "palm_01", "hand", "Hand_1", "Armature", "Bone.001", "index_01", "ik_hand_l"]
        {
            assert_eq!(exact(other), None, "{other}");
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
