//! Animations for VRM avatars: `.vrma`, a GLB with the extension `VRMC_vrm_animation` 1.0.
//!
//! The file has no mesh but the nodes of a humanoid in the T-pose, with the axes of the model. What moves are the hands and their
//! fingers, by rotation alone: a player lays these turns over an avatar of any proportions. The rest of the body is there
//! because the extension wants the bones that every avatar has; no track moves it.
//!
//! Sources: VRM 1.0 (`humanoid.md`, `tpose.md`), VRMC_vrm_animation 1.0.

use std::collections::{BTreeSet, HashMap};

use gltf_json::scene::Node;
use gltf_json::{Index, Scene};
use nalgebra::{UnitQuaternion, Vector3};
use serde::Deserialize;
use serde_json::{Map, Value, json};

use super::animation::{Channels, moves};
use super::export::{check_clip, facts, generator};
use super::import::Facts;
use super::source::Source;
use super::tracks::{NodeTrack, moving, read_tracks};
use super::writer::{Writer, glb};
use super::{Clip, ExportOptions, GltfError, HandTrack, Imported, ImportedHand, JointNames};
use handcast_hand::humanoid::{self, BONES, JOINTS, TPose};
use handcast_hand::turns::PosesFromTurns;
use handcast_hand::{Finger, HandFrames, Joint, JointAngle, Morphology, Side, Skeleton};
use handcast_limits::Limits;

/// The extension.
pub(super) const EXTENSION: &str = "VRMC_vrm_animation";
/// Rotations that stay this close to the T-pose are the T-pose, radians.
const AT_REST: f64 = 1e-6;
/// Bones of the palm, which humanoids do not have. Where they bend a node without anything below it says by how much, for
/// those who read the poses back: players of the extension look at the bones of humanoids alone.
const PALMS: [Joint; 4] =
    [Joint::IndexMetacarpal, Joint::MiddleMetacarpal, Joint::RingMetacarpal, Joint::PinkyMetacarpal];

/// The name of a bone of a hand.
fn bone_name(bone: usize, side: Side) -> String {
    JointNames::Vrm.name(JOINTS[bone], side, 2)
}

/// Writes the clip as an animation for VRM avatars: the turns of hands and fingers against the T-pose, for a person who faces
/// the camera and whose arms rest. Where the hands are is left to the avatar. Of `options` the rotation tolerance, quantising
/// and extras count.
///
/// # Errors
/// Those of [`super::export`].
pub fn export_vrma(clip: &Clip, options: &ExportOptions) -> Result<Vec<u8>, GltfError> {
    let sides = check_clip(clip)?;
    let mut writer = Writer::new(generator());
    let mut channels = Channels::new(options);
    let mut bones = Map::new();
    let anybody = Morphology::default();
    let sizes = clip.hands.first().map_or(&anybody, |hand| &hand.morphology);
    let body = humanoid::body(sizes.hand_length);
    for joint in &body {
        let from = joint.above.map_or_else(Vector3::zeros, |above| body[above].place);
        push_node(&mut writer, &mut bones, joint.name.to_owned(), joint.above, joint.place - from);
    }
    // Both hands are bones that every avatar has.
    for side in [Side::Left, Side::Right] {
        let track = clip.hands.iter().zip(&sides).find(|(_, told)| **told == side).map(|(track, _)| track);
        let elbow = format!("{}LowerArm", side.name());
        let elbow = body.iter().position(|joint| joint.name == elbow);
        let first = writer.root.nodes.len();
        let t_pose = TPose::new(track.map_or(sizes, |track| &track.morphology), side);
        for bone in 0..(if track.is_some() { BONES } else { 1 }) {
            let above = humanoid::above(bone).map_or(elbow, |above| Some(first + above));
            push_node(&mut writer, &mut bones, bone_name(bone, side), above, t_pose.offsets()[bone]);
        }
        if let Some(track) = track {
            push_track(&mut channels, &mut writer, track, &t_pose, first);
            push_palms(&mut channels, &mut writer, track, &t_pose, first);
        }
    }
    writer.root.push(channels.finish());
    let scene = Scene { extensions: None, extras: None, name: None, nodes: vec![Index::new(0)] };
    let scene = writer.root.push(scene);
    writer.root.scene = Some(scene);
    writer.root.extensions_used.push(EXTENSION.into());
    let facts = json!({ "handcast": facts(clip, &sides, options) });
    writer.root.asset.extras = Some(serde_json::value::to_raw_value(&facts)?);
    finish(writer, &json!({ "specVersion": "1.0", "humanoid": { "humanBones": bones } }))
}

/// A bone's node, which hangs on the node `above`.
fn push_node(
    writer: &mut Writer,
    bones: &mut Map<String, Value>,
    name: String,
    above: Option<usize>,
    offset: Vector3<f64>,
) {
    let number = push_plain_node(writer, name.clone(), above, offset);
    bones.insert(name, json!({ "node": number }));
}

/// A node that hangs on the node `above`; its number.
fn push_plain_node(writer: &mut Writer, name: String, above: Option<usize>, offset: Vector3<f64>) -> usize {
    let number = writer.root.nodes.len();
    if let Some(above) = above.and_then(|above| writer.root.nodes.get_mut(above)) {
        above.children.get_or_insert_default().push(Index::new(number as u32));
    }
    let translation = Some(offset.cast::<f32>().into());
    writer.root.push(Node { name: Some(name), translation, ..Default::default() });
    number
}

fn push_track(channels: &mut Channels, writer: &mut Writer, track: &HandTrack, t_pose: &TPose, first: usize) {
    let skeleton = Skeleton::new(&track.morphology, t_pose.side());
    let times: Vec<f64> = track.poses.iter().map(|(time, _)| *time).collect();
    let turns: Vec<_> = track.poses.iter().map(|(_, pose)| t_pose.turns(&skeleton.frames(pose))).collect();
    for bone in 0..BONES {
        let keys: Vec<UnitQuaternion<f64>> = turns.iter().map(|turns| turns[bone]).collect();
        // Without any track the clip would lose its duration: the hand always has one.
        if bone == 0 || moves(&keys, &UnitQuaternion::identity(), AT_REST) {
            channels.rotation(writer, &times, keys, Index::new((first + bone) as u32));
        }
    }
}

/// The bones of the palm that bend.
fn push_palms(channels: &mut Channels, writer: &mut Writer, track: &HandTrack, t_pose: &TPose, hand: usize) {
    let side = t_pose.side();
    let skeleton = Skeleton::new(&track.morphology, side);
    let neutral = skeleton.local_frames(&[0.0; JointAngle::COUNT]);
    let rest = TPose::hand(side);
    let times: Vec<f64> = track.poses.iter().map(|(time, _)| *time).collect();
    let frames: Vec<_> = track.poses.iter().map(|(_, pose)| skeleton.local_frames(&pose.angles)).collect();
    for joint in PALMS {
        let bend = |frames: &HandFrames| rest * frames.get(joint).rotation * rest.inverse();
        let keys: Vec<UnitQuaternion<f64>> = frames.iter().map(bend).collect();
        if !moves(&keys, &UnitQuaternion::identity(), AT_REST) {
            continue;
        }
        let offset = rest * (neutral.position(joint) - neutral.position(Joint::Wrist));
        let node = push_plain_node(writer, JointNames::Vrm.name(joint, side, 2), Some(hand), offset);
        channels.rotation(writer, &times, keys, Index::new(node as u32));
    }
}

/// The file, with the extension that its types do not know.
fn finish(writer: Writer, extension: &Value) -> Result<Vec<u8>, GltfError> {
    let (root, mut bytes) = writer.into_parts();
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    let mut document = serde_json::to_value(&root)?;
    document["extensions"][EXTENSION] = extension.clone();
    document["buffers"] = json!([{ "byteLength": bytes.len() }]);
    glb(serde_json::to_vec(&document)?, &bytes)
}

/// What a document says of the extension.
#[derive(Deserialize)]
struct Document {
    #[serde(default)]
    extensions: Extensions,
}

#[derive(Default, Deserialize)]
struct Extensions {
    #[serde(rename = "VRMC_vrm_animation")]
    animation: Option<Animation>,
}

#[derive(Deserialize)]
struct Animation {
    humanoid: Humanoid,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Humanoid {
    human_bones: HashMap<String, Bone>,
}

#[derive(Deserialize)]
struct Bone {
    node: usize,
}

/// The node of each bone of a humanoid, by its name; `None` for a file without the extension.
///
/// # Errors
/// [`GltfError::Unsupported`] where the extension says something else.
pub(super) fn bones_of(text: &[u8]) -> Result<Option<Bones>, GltfError> {
    let document: Document = serde_json::from_slice(text)
        .map_err(|error| GltfError::Unsupported { what: format!("{EXTENSION}: {error}") })?;
    let nodes = |animation: Animation| {
        animation.humanoid.human_bones.into_iter().map(|(name, bone)| (name, bone.node)).collect()
    };
    Ok(document.extensions.animation.map(nodes).map(Bones))
}

/// Nodes of the bones of a humanoid.
pub(super) struct Bones(HashMap<String, usize>);

/// The poses of the hands with fingers that an animation turns, from any program. Where the hands are it does not tell: they stay
/// at the origin.
///
/// # Errors
/// [`GltfError::Unsupported`] for an animation that turns no hand with fingers, nodes that hang in a circle, and what keys may do wrong.
pub(super) fn read(
    source: &Source,
    bones: &Bones,
    facts: &Facts,
    limits: &Limits,
) -> Result<Imported, GltfError> {
    let document = &source.document;
    let count = document.nodes().len();
    if let Some((name, node)) = bones.0.iter().find(|(_, node)| **node >= count) {
        return Err(GltfError::Unsupported { what: format!("bone {name} is node {node} of {count}") });
    }
    let all: Vec<usize> = (0..count).collect();
    let none = || GltfError::Unsupported { what: format!("{EXTENSION}: it turns no hand with fingers") };
    let of_hands =
        |side: Side| (0..BONES).filter_map(move |bone| bones.0.get(&bone_name(bone, side)).copied());
    let hands: BTreeSet<usize> = of_hands(Side::Left).chain(of_hands(Side::Right)).collect();
    let (animation, note) =
        if hands.is_empty() { return Err(none()) } else { moving(document, &hands, &hands)? };
    let mut found =
        Imported { hands: Vec::new(), placed: false, rate: facts.rate, notes: Vec::from_iter(note) };
    let tracks = read_tracks(&animation, &source.bytes, &all, limits)?.nodes;
    let skeleton = Nodes::of(document)?;
    for side in [Side::Left, Side::Right] {
        let nodes: [Option<usize>; BONES] =
            std::array::from_fn(|bone| bones.0.get(&bone_name(bone, side)).copied());
        // Fingers at rest need no tracks, as long as something tells how long they rest.
        let fingers = nodes[1..].iter().any(Option::is_some);
        let palms = palms(document, side, nodes[0], &tracks);
        let own = nodes.iter().chain(&palms).flatten().copied();
        let own: Vec<usize> = own.filter(|&node| tracks[node].turns()).collect();
        if nodes[0].is_none() || !fingers || own.is_empty() {
            continue;
        }
        let own = read_tracks(&animation, &source.bytes, &own, limits)?;
        let (times, rate) = if facts.rate.is_some() { (own.times, None) } else { own.instants(limits)? };
        found.rate = found.rate.or(rate);
        let morphology = facts.morphology(side);
        let t_pose = TPose::new(&morphology.clone().unwrap_or_default(), side);
        // A humanoid has no bones in the palm.
        let told = palms.iter().any(Option::is_some);
        let mut reader = PosesFromTurns::new(side).without_palms(|_| !told);
        let pose = |&time: &f64| {
            let turns = skeleton.turns(&tracks, time);
            // A bone that is not there is not turned against the one above it.
            let mut world = [UnitQuaternion::identity(); BONES];
            for (bone, node) in nodes.iter().enumerate() {
                let above = humanoid::above(bone).map_or_else(UnitQuaternion::identity, |above| world[above]);
                world[bone] = node.map_or(above, |node| turns[node]);
            }
            let frames = t_pose.orientations(&world);
            let frame = |joint: Joint| match JOINTS.iter().position(|j| *j == joint) {
                Some(bone) => frames[bone],
                None => {
                    let palm = PALMS.iter().position(|palm| *palm == joint).and_then(|k| palms[k]);
                    palm.map_or(frames[0], |node| turns[node] * TPose::hand(side))
                }
            };
            let mut pose =
                reader.pose(|joint| frame(joint.parent().unwrap_or(joint)).inverse() * frame(joint));
            pose.rotation = frames[0];
            (time, pose)
        };
        let poses = times.iter().map(pose).collect();
        let angles = JointAngle::ALL.into_iter();
        let angles = angles.filter(|angle| told || !is_of_palm(*angle)).collect();
        found.hands.push(ImportedHand { side, morphology, angles, poses });
    }
    if found.hands.is_empty() { Err(none()) } else { Ok(found) }
}

fn is_of_palm(angle: JointAngle) -> bool {
    Finger::LONG.iter().any(|finger| finger.palm_flexion() == Some(angle))
}

/// The bones of the palm that a hand of this file has besides those of humanoids: nodes that hang on the hand's and turn.
fn palms(
    document: &::gltf::Document,
    side: Side,
    hand: Option<usize>,
    tracks: &[NodeTrack],
) -> [Option<usize>; PALMS.len()] {
    let below =
        hand.and_then(|hand| document.nodes().nth(hand)).map(|hand| hand.children().collect::<Vec<_>>());
    let below = below.unwrap_or_default();
    PALMS.map(|joint| {
        let name = JointNames::Vrm.name(joint, side, 2);
        let node = below.iter().find(|node| node.name() == Some(&name))?.index();
        tracks[node].turns().then_some(node)
    })
}

/// The nodes of a document at rest.
struct Nodes {
    /// Rotation against the node above, and that node.
    locals: Vec<(UnitQuaternion<f64>, Option<usize>)>,
    /// Rotation in space.
    world: Vec<UnitQuaternion<f64>>,
    /// So that each comes after the one above it.
    order: Vec<usize>,
}

impl Nodes {
    fn of(document: &::gltf::Document) -> Result<Self, GltfError> {
        let mut locals = Vec::with_capacity(document.nodes().len());
        for node in document.nodes() {
            let (_, [x, y, z, w], _) = node.transform().decomposed();
            let turn = nalgebra::Quaternion::new(w, x, y, z).cast::<f64>();
            let turn = UnitQuaternion::try_new(turn, 1e-6).ok_or_else(|| GltfError::Unsupported {
                what: format!("node {} has a rotation of length 0", node.index()),
            })?;
            locals.push((turn, None));
        }
        let mut children = vec![Vec::new(); locals.len()];
        for node in document.nodes() {
            for child in node.children() {
                children[node.index()].push(child.index());
                if locals[child.index()].1.replace(node.index()).is_some() {
                    let what = format!("node {} has two parents", child.index());
                    return Err(GltfError::Unsupported { what });
                }
            }
        }
        let mut order: Vec<usize> = (0..locals.len()).filter(|&node| locals[node].1.is_none()).collect();
        let mut next = 0;
        while let Some(&node) = order.get(next) {
            order.append(&mut children[node]);
            next += 1;
        }
        let mut hangs = vec![false; locals.len()];
        order.iter().for_each(|&node| hangs[node] = true);
        if let Some(node) = hangs.iter().position(|hangs| !hangs) {
            return Err(GltfError::Unsupported { what: format!("node {node} hangs below itself") });
        }
        let mut nodes = Self { world: vec![UnitQuaternion::identity(); locals.len()], locals, order };
        nodes.world = nodes.turned(|node| nodes.locals[node].0);
        Ok(nodes)
    }

    /// Rotations in space when those against the nodes above are these.
    fn turned(&self, local: impl Fn(usize) -> UnitQuaternion<f64>) -> Vec<UnitQuaternion<f64>> {
        let mut world = vec![UnitQuaternion::identity(); self.locals.len()];
        for &node in &self.order {
            world[node] =
                self.locals[node].1.map_or_else(UnitQuaternion::identity, |above| world[above]) * local(node);
        }
        world
    }

    /// How each node is turned from its rest at a time, in space.
    fn turns(&self, tracks: &[NodeTrack], time: f64) -> Vec<UnitQuaternion<f64>> {
        let world = self.turned(|node| tracks[node].turn_at(time).unwrap_or(self.locals[node].0));
        world.iter().zip(&self.world).map(|(world, rest)| world * rest.inverse()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import_poses;
    use handcast_hand::{HandPose, JointAngle};

    fn clip(sides: &[Side]) -> Clip {
        let pose = |side: Side, k: usize| {
            let mut pose = HandPose::neutral(side);
            for finger in handcast_hand::Finger::ALL {
                pose.set(finger.base_flexion(), 0.1 * k as f64);
                pose.set(finger.middle_flexion(), 0.15 * k as f64);
                pose.set(finger.abduction(), 0.02 * k as f64);
            }
            pose.rotation = UnitQuaternion::from_euler_angles(0.1 * k as f64, 0.4, -0.2);
            (0.04 * k as f64, pose)
        };
        let track = |&side: &Side| HandTrack {
            morphology: Morphology::average(0.18),
            poses: (0..8).map(|k| pose(side, k)).collect(),
        };
        Clip { hands: sides.iter().map(track).collect(), ..Clip::default() }
    }

    #[test]
    fn poses_come_back() {
        for sides in [&[Side::Left][..], &[Side::Right], &[Side::Right, Side::Left]] {
            let clip = clip(sides);
            let hands = import_poses(&export_vrma(&clip, &ExportOptions::default()).unwrap()).unwrap();
            assert_eq!(hands.len(), sides.len());
            for hand in hands {
                let truth = clip.hands.iter().find(|h| h.poses[0].1.side == hand.side).unwrap();
                assert_eq!(hand.morphology.as_ref(), Some(&truth.morphology));
                assert_eq!(hand.poses.len(), truth.poses.len());
                for ((time, pose), (true_time, true_pose)) in hand.poses.iter().zip(&truth.poses) {
                    assert!((time - true_time).abs() < 1e-6);
                    assert!(pose.rotation.angle_to(&true_pose.rotation) < 1e-5);
                    for angle in JointAngle::ALL {
                        let off = (pose.angle(angle) - true_pose.angle(angle)).abs();
                        assert!(off < 1e-4, "{} at {time}: {off}", angle.name());
                    }
                }
            }
        }
    }

    /// A little finger that closes with its palm, of which the file tells nothing.
    #[test]
    fn fingers_turn_as_told_by_angles_of_hands() {
        let mut clip = clip(&[Side::Left]);
        let closing = |k: usize| {
            let t = k as f64 / 40.0;
            let pose = HandPose::neutral(Side::Left)
                .with_degrees(JointAngle::Pinky0Flexion, 3.0 + 23.0 * t)
                .with_degrees(JointAngle::Pinky1Flexion, 12.0 + 68.0 * t)
                .with_degrees(JointAngle::Pinky1Abduction, 15.0 * (1.0 - t));
            (0.04 * k as f64, pose)
        };
        clip.hands[0].poses = (0..=40).map(closing).collect();
        let told = export_vrma(&clip, &ExportOptions::default()).unwrap();
        // Ours tell of the palm beside the bones of avatars.
        for ((_, pose), (_, truth)) in import_poses(&told).unwrap()[0].poses.iter().zip(&clip.hands[0].poses)
        {
            for angle in JointAngle::ALL {
                assert!((pose.angle(angle) - truth.angle(angle)).abs() < 1e-5, "{}", angle.name());
            }
        }
        let length = u32::from_le_bytes(told[12..16].try_into().unwrap()) as usize;
        let text = String::from_utf8(told[20..20 + length].to_vec()).unwrap();
        let renamed = text.replace("leftLittleMetacarpal", "somethingOfTheirs");
        let hands = import_poses(&glb(renamed.into(), &told[28 + length..]).unwrap()).unwrap();
        assert!(!hands[0].angles.contains(&JointAngle::Pinky0Flexion));
        let skeleton = Skeleton::new(&clip.hands[0].morphology, Side::Left);
        for ((time, pose), (_, truth)) in hands[0].poses.iter().zip(&clip.hands[0].poses) {
            let [found, wanted] =
                [pose, truth].map(|pose| skeleton.frames(pose).get(Joint::PinkyProximal).rotation);
            assert!(found.angle_to(&wanted) < 1e-5, "{time}");
            assert!(pose.angle(JointAngle::Pinky1Abduction).to_degrees().abs() < 21.0, "{time}");
            assert!(pose.angle(JointAngle::Pinky1Twisting).to_degrees().abs() < 15.0, "{time}");
        }
    }

    #[test]
    fn a_hand_at_rest_comes_back() {
        let mut clip = clip(&[Side::Left]);
        for (_, pose) in &mut clip.hands[0].poses {
            *pose = HandPose::neutral(Side::Left);
        }
        let hands = import_poses(&export_vrma(&clip, &ExportOptions::default()).unwrap()).unwrap();
        assert_eq!(hands.len(), 1);
        let poses = &hands[0].poses;
        assert_eq!(poses.last().map(|(time, _)| (time * 1e3).round()), Some(280.0));
        assert!(poses.iter().all(|(_, pose)| pose.angles.iter().all(|angle| angle.abs() < 1e-6)));
    }

    #[test]
    fn only_hands_and_fingers_turn_and_nothing_shifts() {
        let bytes = export_vrma(&clip(&[Side::Left, Side::Right]), &ExportOptions::default()).unwrap();
        let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let document: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
        let bones = &document["extensions"][EXTENSION]["humanoid"]["humanBones"];
        assert_eq!(bones.as_object().unwrap().len(), 13 + 2 * BONES);
        let name = |node: &Value| {
            document["nodes"][node.as_u64().unwrap() as usize]["name"].as_str().unwrap().to_owned()
        };
        for (bone, node) in bones.as_object().unwrap() {
            assert_eq!(bone, &name(&node["node"]));
        }
        assert_eq!(bones["hips"]["node"], 0);
        for channel in document["animations"][0]["channels"].as_array().unwrap() {
            assert_eq!(channel["target"]["path"], "rotation");
            let name = name(&channel["target"]["node"]);
            let moving = ["Hand", "Thumb", "Index", "Middle", "Ring", "Little"];
            assert!(moving.iter().any(|word| name.contains(word)), "{name}");
        }
        assert!(document["nodes"].as_array().unwrap().iter().all(|node| node.get("rotation").is_none()));
    }

    #[test]
    fn wrong_files_are_refused() {
        let good = export_vrma(&clip(&[Side::Left]), &ExportOptions::default()).unwrap();
        let length = u32::from_le_bytes(good[12..16].try_into().unwrap()) as usize;
        let changed = |change: &dyn Fn(&mut Value)| {
            let mut document: Value = serde_json::from_slice(&good[20..20 + length]).unwrap();
            change(&mut document);
            let bytes = glb(serde_json::to_vec(&document).unwrap(), &good[28 + length..]).unwrap();
            import_poses(&bytes).unwrap_err().to_string()
        };
        let bones = |document: &mut Value| document["extensions"][EXTENSION]["humanoid"]["humanBones"].take();
        assert!(
            changed(&|d| {
                d["extensions"][EXTENSION]["humanoid"]["humanBones"]["hips"]["node"] = 9999.into();
            })
            .contains("bone hips is node 9999")
        );
        assert!(
            changed(&|d| {
                bones(d);
                d["extensions"][EXTENSION]["humanoid"]["humanBones"] = json!({});
            })
            .contains("turns no hand with fingers")
        );
        assert!(
            changed(&|d| {
                d["extensions"][EXTENSION] = json!({});
            })
            .contains("humanoid")
        );
        assert!(
            changed(&|d| {
                d["nodes"][1]["children"] = json!([0]);
            })
            .contains("node 0 hangs below itself")
        );
    }
}
