//! Which nodes of a rig are the joints of a hand: by a map, by what a VRM avatar says of its bones, or by their names.

use std::borrow::Cow;

use nalgebra::Vector3;
use serde_json::Value;

use super::document::RigDocument;
use super::hand::RigHand;
use super::{JointMap, RigError, body};
use crate::names::{Reading, readings};
use handcast_hand::landmarks::{JointPoints, tell_side};
use handcast_hand::{Finger, Joint, Morphology, Side};
use handcast_limits::quoted;

/// How much better one side must fit than the other for the joints' places to tell them apart.
const TELLING: f64 = 1.1;

/// Joints found for a side (or for an unknown one).
#[derive(Default)]
pub(super) struct Found {
    pub(super) joints: [Option<usize>; 25],
    pub(super) palm: Option<usize>,
}

/// How good a node's claim to be a joint is; what is greater wins.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Claim {
    /// A map, or the avatar, says so.
    told: bool,
    /// Something visible hangs on it: not a control of the rig it was made with.
    carries: bool,
    /// It hangs on the wrist that was found.
    below: bool,
    /// Its name is known as it is.
    exact: bool,
}

/// Claims to be each joint, the palm last: of the left hand, the right one, and one whose side is not told.
struct Claims([[Vec<(Claim, usize)>; 26]; 3]);

impl Claims {
    fn new() -> Self {
        Self(std::array::from_fn(|_| std::array::from_fn(|_| Vec::new())))
    }

    fn put(&mut self, joint: Option<Joint>, side: Option<Side>, node: usize, claim: Claim) {
        self.0[side.map_or(2, |s| s as usize)][joint.map_or(25, Joint::index)].push((claim, node));
    }

    fn found(mut self, document: &RigDocument) -> Result<[Found; 3], RigError> {
        let mut out: [Found; 3] = Default::default();
        for (claims, found) in self.0.iter_mut().zip(&mut out) {
            let wrist = best(document, &claims[Joint::Wrist.index()], Joint::Wrist.webxr_name())?;
            for (k, claims) in claims.iter_mut().enumerate() {
                for (claim, node) in claims.iter_mut() {
                    claim.below = wrist.is_some_and(|wrist| document.is_below(*node, wrist));
                }
                let joint = Joint::ALL.get(k).map_or("palm", |joint| joint.webxr_name());
                *found.joints.get_mut(k).unwrap_or(&mut found.palm) = best(document, claims, joint)?;
            }
        }
        Ok(out)
    }
}

/// The node with the best claim; several as good are refused.
fn best(document: &RigDocument, claims: &[(Claim, usize)], joint: &str) -> Result<Option<usize>, RigError> {
    let Some((most, node)) = claims.iter().max_by_key(|(claim, _)| *claim) else { return Ok(None) };
    match claims.iter().find(|(claim, other)| claim == most && other != node) {
        Some((_, other)) => {
            let [one, other] = [other, node].map(|node| quoted(&document.names[*node]));
            Err(RigError::NoHand { what: format!("{one} and {other} are both the {joint}") })
        }
        None => Ok(Some(*node)),
    }
}

/// The hands of a rig, and what is worth saying of those that are none. `shown` gives the joints of a hand in frames of its motion,
/// where the file has one that is read: they may tell its side where the hand at rest does not.
pub(super) fn find(
    document: &RigDocument,
    map: Option<&JointMap>,
    shown: &dyn Fn(&Found) -> Vec<JointPoints>,
) -> Result<(Vec<RigHand>, Vec<String>), RigError> {
    let (bones, mut notes) = human_bones(&document.json, document.names.len());
    let found = match map {
        Some(map) => mapped(document, map)?,
        None => named(document, &bones)?,
    };
    let mut hands = Vec::new();
    let mut missing = None;
    for (side, group) in [Some(Side::Left), Some(Side::Right), None].into_iter().zip(found) {
        // A map says what it says.
        let lacking_thumb = || lacking_thumb(&group).filter(|_| map.is_none()).map(Some);
        match lacking(&group).or_else(lacking_thumb) {
            Some(what) => {
                let of = side.map_or(String::new(), |side| format!("{} hand: ", side.name()));
                missing = missing.or(what.map(|what| format!("{of}{what}")));
            }
            None => {
                let side = match side {
                    Some(side) => side,
                    None => untold_side(document, &group, map, shown)?,
                };
                hands.push(RigHand::new(document, side, group));
            }
        }
    }
    if hands.is_empty() {
        return Err(RigError::NoHand { what: missing.unwrap_or_else(|| names(document)) });
    }
    notes.extend(missing.map(|what| format!("{what}; it is left out")));
    hands.iter().try_for_each(|hand| hand.check_scales(document))?;
    if let Some(stands) = body::stands(document, &bones, &hands) {
        hands.iter_mut().filter(|hand| hand.arm.is_some()).for_each(|hand| hand.body = stands);
    }
    Ok((hands, notes))
}

/// The nodes that a map names.
fn mapped(document: &RigDocument, map: &JointMap) -> Result<[Found; 3], RigError> {
    let mut claims = Claims::new();
    for (name, joint, side) in map.entries() {
        let node = node_of(document, name)?;
        let claim = Claim { told: true, carries: true, below: false, exact: true };
        claims.put(joint, side, node, claim);
    }
    claims.found(document)
}

/// The node of a name; joints of a skin come before other nodes. A node without a name of its own is its number after `#`.
fn node_of(document: &RigDocument, name: &str) -> Result<usize, RigError> {
    let wrong = |what: String| Err(RigError::Map { what });
    let all: Vec<usize> = (0..document.names.len()).filter(|&n| document.names[n] == name).collect();
    let joints: Vec<usize> = all.iter().copied().filter(|&n| document.is_joint[n]).collect();
    match if joints.is_empty() { &all } else { &joints }.as_slice() {
        [node] => Ok(*node),
        [] => {
            let count = document.names.len();
            match name.strip_prefix('#').map(str::parse::<usize>) {
                Some(Ok(node)) if node < count => Ok(node),
                Some(Ok(node)) => wrong(format!("node {node} of {count}")),
                _ => wrong(format!("no node is named {}; {}", quoted(name), names(document))),
            }
        }
        several => {
            let numbers: Vec<String> = several.iter().take(8).map(|node| format!("\"#{node}\"")).collect();
            let (count, numbers) = (several.len(), numbers.join(", "));
            wrong(format!("{count} nodes are named {}: say which by its number, {numbers}", quoted(name)))
        }
    }
}

/// The joints of skins by what an avatar says of its bones, and by their names.
fn named(document: &RigDocument, bones: &[(Cow<str>, usize)]) -> Result<[Found; 3], RigError> {
    let mut claims = Claims::new();
    let mut put = |read: Option<Reading>, node: usize, told: bool| {
        let Some(Reading { joint, side, exact, .. }) = read else { return };
        let claim = Claim { told, carries: document.carries[node], below: false, exact };
        claims.put(joint, side, node, claim);
    };
    for (read, (_, node)) in readings(bones.iter().map(|(name, _)| name.as_ref())).into_iter().zip(bones) {
        put(read, *node, true);
    }
    let of_names = |node: &usize| document.is_joint[*node] && !bones.iter().any(|(_, bone)| bone == node);
    let nodes: Vec<usize> = (0..document.names.len()).filter(of_names).collect();
    let reads = readings(nodes.iter().map(|&node| document.names[node].as_str()));
    reads.into_iter().zip(nodes).for_each(|(read, node)| put(read, node, false));
    claims.found(document)
}

/// Name and node of each bone of a VRM avatar, 1.0 or 0.x; none of another file. With a note on one that is no node.
fn human_bones(json: &Value, count: usize) -> (Vec<(Cow<'_, str>, usize)>, Vec<String>) {
    let bones = |extension: &str| &json["extensions"][extension]["humanoid"]["humanBones"];
    let node = |bone: &Value| bone["node"].as_u64().map(|node| node as usize);
    let newer = bones("VRMC_vrm").as_object().into_iter().flatten();
    let newer = newer.filter_map(|(name, bone)| Some((Cow::from(name), node(bone)?)));
    let older = bones("VRM").as_array().into_iter().flatten();
    let older = older.filter_map(|bone| Some((Cow::from(bone["bone"].as_str()?), node(bone)?)));
    let mut all: Vec<_> = newer.collect();
    if all.is_empty() {
        all = older.collect();
    }
    let wrong = all.iter().find(|(_, node)| *node >= count);
    let note =
        wrong.map(|(name, node)| format!("bone {} of the avatar is node {node} of {count}", quoted(name)));
    all.retain(|(_, node)| *node < count);
    (all, note.into_iter().collect())
}

/// Names of joints that messages list.
const LISTED: usize = 16;

/// Names of joints, first of those that look like a hand's.
fn names(document: &RigDocument) -> String {
    const WORDS: [&str; 15] = [
        "hand", "wrist", "finger", "thumb", "index", "middle", "mid", "ring", "pinky", "little", "palm",
        "phalan", "digit", "指", "手",
    ];
    let joints = document.names.iter().zip(&document.is_joint).filter(|(_, joint)| **joint);
    let joints: Vec<&String> = joints.map(|(name, _)| name).collect();
    if joints.is_empty() {
        return "no node is a joint of a skin".into();
    }
    let looks = |name: &&String| {
        let name = name.to_lowercase();
        WORDS.iter().any(|word| name.contains(word))
    };
    let (mut shown, others): (Vec<&String>, Vec<&String>) = joints.into_iter().partition(looks);
    shown.extend(others);
    let listed: Vec<String> = shown.iter().take(LISTED).map(|name| quoted(name)).collect();
    let more = match shown.len() - listed.len() {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    format!("joints are named {}{more}", listed.join(", "))
}

/// What a group lacks to be a hand; `Some(None)` when it has nothing at all.
pub(super) fn lacking(group: &Found) -> Option<Option<String>> {
    if group.joints.iter().all(Option::is_none) {
        return Some(None);
    }
    let has = |joint: Joint| group.joints[joint.index()].is_some();
    let needed = [Joint::Wrist, Joint::IndexProximal, Joint::MiddleProximal];
    let lost = needed.into_iter().find(|j| !has(*j)).or_else(|| {
        (!has(Joint::PinkyProximal) && !has(Joint::RingProximal)).then_some(Joint::PinkyProximal)
    });
    Some(Some(format!("no joint is the {}", lost?.webxr_name())))
}

/// That a thumb without its base is one whose names were taken for others.
fn lacking_thumb(group: &Found) -> Option<String> {
    let has = |joint: Joint| group.joints[joint.index()].is_some();
    let headless = !has(Joint::ThumbMetacarpal) && (has(Joint::ThumbProximal) || has(Joint::ThumbDistal));
    headless.then(|| format!("no joint is the {}", Joint::ThumbMetacarpal.webxr_name()))
}

/// The side of a hand whose names do not tell: from the wrist's `extras`, or the axes of WebXR (+Y out of the back of the hand) where
/// the joints have them, else from where the joints lie.
fn untold_side(
    document: &RigDocument,
    group: &Found,
    map: Option<&JointMap>,
    shown: &dyn Fn(&Found) -> Vec<JointPoints>,
) -> Result<Side, RigError> {
    if let Some(side) = map.and_then(|m| m.hand) {
        return Ok(side);
    }
    // Files of this program say it.
    let said =
        |wrist: usize| serde_json::from_value(document.json["nodes"][wrist]["extras"]["side"].clone()).ok();
    if let Some(side) = group.joints[Joint::Wrist.index()].and_then(said) {
        return Ok(side);
    }
    let world = |joint: Joint| Some(document.world[group.joints[joint.index()]?]);
    let position = |joint: Joint| world(joint).map(|w| w.isometry.translation.vector);
    let back = || -> Option<f64> {
        let knuckle = world(Joint::MiddleProximal)?;
        let bone = position(Joint::MiddleIntermediate)? - position(Joint::MiddleProximal)?;
        let axis = |v: Vector3<f64>| knuckle.isometry.rotation * v;
        if axis(-Vector3::z()).dot(&bone) < 0.95 * bone.norm() {
            return None;
        }
        let last = position(Joint::PinkyProximal).or(position(Joint::RingProximal))?;
        let across = position(Joint::IndexProximal)? - last;
        // Of a right hand, thumb side × fingers looks out of the palm.
        let palm = across.cross(&bone).normalize();
        Some(-palm.dot(&axis(Vector3::y()))).filter(|d| d.abs() > 0.7)
    };
    if let Some(right) = back() {
        return Ok(if right > 0.0 { Side::Right } else { Side::Left });
    }
    // Rigs have any unit.
    let palm =
        position(Joint::Wrist).zip(position(Joint::MiddleProximal)).map_or(0.0, |(a, b)| (b - a).norm());
    let mean = Morphology::default().finger(Finger::Middle).base_vector().norm();
    let metres = if palm > 1e-9 { mean / palm } else { 1.0 };
    let tell = |frames: &[JointPoints]| {
        let scaled = |points: &JointPoints| points.map(|point| point.map(|at| at * metres));
        let trial = tell_side(&frames.iter().map(scaled).collect::<Vec<_>>()).ok()?;
        (trial.ratio() >= TELLING).then(|| trial.side())
    };
    let still = std::array::from_fn(|i| position(Joint::ALL[i]).map(Into::into));
    tell(&[still]).or_else(|| tell(&shown(group))).ok_or(RigError::NoSide)
}
