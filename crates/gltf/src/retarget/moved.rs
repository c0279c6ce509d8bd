//! The way back: the poses of a rig that moves, whoever moved it.
//!
//! A hand that hangs on no arm is where the file has it. On an arm that moves it is where it is seen from a camera at the
//! height of the hips and [`CAMERA`] before them, which goes along with the body and sees it face to face as it stands at rest;
//! on an arm that rests the file does not tell.

use std::collections::BTreeSet;

use nalgebra::{Quaternion, Similarity3, UnitQuaternion, Vector3};
use serde_json::{Map, Value, json};

use super::JointMap;
use super::document::{RigDocument, placed, vanishing};
use super::find::{Found, find};
use super::hand::{Bind, RigHand, Sizes};
use crate::GltfError;
use crate::import::{Facts, ImportedHand};
use crate::source::Source;
use crate::tracks::{NodeTrack, Tracks, moving, read_tracks};
use handcast_hand::landmarks::JointPoints;
use handcast_hand::turns::PosesFromTurns;
use handcast_hand::{Finger, HandFrames, HandPose, Joint, Morphology, Skeleton};
use handcast_limits::Limits;

/// Where `asset.extras` tells which nodes of a rig are the joints of a hand: by the joints' names, their own names, or their
/// numbers where several have one name.
pub(crate) const RIG_NODES: &str = "nodes";
/// Where it tells how the body of the rig stands, where that is not upright and facing +Z: a quaternion, x first.
const RIG_BODY: &str = "body";
/// How far before the hips of a body the camera stands, metres.
const CAMERA: f64 = 1.5;
/// How far off rotations may be that are told against the mean hand's palm, radians.
const UNLIKE: f64 = 1.5 * std::f64::consts::PI / 180.0;
/// In how many frames of a motion the side of a hand is looked for.
const SHOWN: usize = 32;
/// Places that stay this close to one another are one, metres.
const AT_REST: f64 = 1e-5;

/// Keeps in the facts of a hand what tells those who read the poses back how it moves.
pub(super) fn keep(facts: &mut Value, document: &RigDocument, hand: &RigHand) {
    let name = |joint: Option<Joint>| joint.map_or("palm", Joint::webxr_name).to_owned();
    let told = |node: usize| -> Value {
        let own = &document.names[node];
        let unique = !own.is_empty() && document.names.iter().filter(|name| *name == own).count() == 1;
        if unique { own.as_str().into() } else { node.into() }
    };
    let nodes = hand.nodes().map(|(joint, node)| (name(joint), told(node))).collect::<Map<_, _>>();
    facts[RIG_NODES] = nodes.into();
    if hand.body != UnitQuaternion::identity() {
        facts[RIG_BODY] = json!(<[f64; 4]>::from(hand.body.coords));
    }
}

fn body_in(facts: &Value) -> UnitQuaternion<f64> {
    let told = serde_json::from_value::<[f64; 4]>(facts[RIG_BODY].clone()).ok();
    let turn = told.and_then(|[x, y, z, w]| UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-6));
    turn.unwrap_or_default()
}

/// What was read of a rig.
pub(crate) struct FoundPoses {
    pub(crate) hands: Vec<ImportedHand>,
    /// Whether it tells where the wrists are.
    pub(crate) placed: bool,
    /// Instants a second that were made of few keys.
    pub(crate) rate: Option<f64>,
    pub(crate) notes: Vec<String>,
}

/// A rig that moves.
pub(crate) struct MovedRig<'a> {
    source: &'a Source<'a>,
    document: RigDocument,
}

/// One of its hands.
struct MovedHand {
    hand: RigHand,
    bind: Bind,
    sizes: Sizes,
    told: bool,
    /// What its arm hangs on.
    hips: Option<usize>,
    /// The hand with all angles zero, for joints that the rig lacks.
    neutral: HandFrames,
}

impl<'a> MovedRig<'a> {
    pub(crate) fn of(source: &'a Source<'a>) -> Result<Self, GltfError> {
        Ok(Self { source, document: RigDocument::of_motion(source)? })
    }

    /// The poses of the hands that the facts of a file tell of; `None` where nodes have other names by now.
    ///
    /// # Errors
    /// [`GltfError::Rig`] where these make no hand; what keys may do wrong.
    pub(crate) fn told(&self, facts: &Facts, limits: &Limits) -> Result<Option<FoundPoses>, GltfError> {
        let mut hands = Vec::new();
        for (side, told) in facts.moved() {
            let Some(nodes) = self.nodes(&told[RIG_NODES]) else { return Ok(None) };
            let hand = RigHand::of_nodes(&self.document, side, nodes, body_in(told))?;
            hands.push(MovedHand::new(&self.document, hand, facts.morphology(side))?);
        }
        let (nodes, tracks, note) = self.tracks(&joints(&hands), limits)?;
        let times = tracks.times.clone();
        let mut found = self.poses(&hands, &nodes, &tracks, &times)?;
        found.notes.extend(note);
        Ok(Some(found))
    }

    /// The node of each joint, and of the palm; `None` where a name is gone, or another node has it, too.
    fn nodes(&self, told: &Value) -> Option<Found> {
        let node = |name: &str| -> Option<Option<usize>> {
            match told.get(name) {
                None => Some(None),
                Some(Value::String(own)) => {
                    let mut named =
                        (0..self.document.names.len()).filter(|&n| self.document.names[n] == *own);
                    named.next().filter(|_| named.next().is_none()).map(Some)
                }
                Some(number) => Some(number.as_u64().and_then(|number| number.try_into().ok())),
            }
        };
        let joints = Joint::ALL.map(|joint| node(joint.webxr_name()));
        let found = Found { joints: joints.map(Option::flatten), palm: node("palm")? };
        joints.iter().all(Option::is_some).then_some(found)
    }

    /// The poses of the hands whose joints a map, the bones of an avatar, or their names tell.
    ///
    /// # Errors
    /// [`GltfError::Rig`] where they do not; what keys may do wrong.
    pub(crate) fn named(
        mut self,
        map: Option<&JointMap>,
        facts: &Facts,
        limits: &Limits,
    ) -> Result<FoundPoses, GltfError> {
        let (hands, mut notes) = find(&self.document, map, &|group| self.shown(group, limits))?;
        // Who moved it had it as it is bound; ours are moved from where nodes stand.
        self.document = self.document.at_bound_rest(self.source, &hands);
        let mut moved = Vec::new();
        for hand in hands {
            let sizes = facts.morphology(hand.side);
            moved.push(MovedHand::new(&self.document, hand, sizes)?);
        }
        let (nodes, tracks, note) = self.tracks(&joints(&moved), limits)?;
        let (times, rate) = match facts.rate {
            Some(_) => (tracks.times.clone(), None),
            None => tracks.instants(limits)?,
        };
        let found = self.poses(&moved, &nodes, &tracks, &times)?;
        notes.extend(note);
        notes.extend(found.notes);
        notes.extend(moved.iter().filter_map(MovedHand::note));
        if let Some(rate) = rate {
            notes
                .push(format!("its keys are few or no straight ones: poses are taken {rate} times a second"));
        }
        Ok(FoundPoses { notes, rate, ..found })
    }

    /// Some nodes, and those above them.
    fn and_above(&self, nodes: impl IntoIterator<Item = usize>) -> BTreeSet<usize> {
        let up = |node: &usize| self.document.parents[*node];
        nodes.into_iter().flat_map(|node| std::iter::successors(Some(node), up)).collect()
    }

    /// What moves these nodes and those above them, which are given, too, and what is worth saying of that.
    fn tracks(
        &self,
        joints: &BTreeSet<usize>,
        limits: &Limits,
    ) -> Result<(Vec<usize>, Tracks, Option<String>), GltfError> {
        let nodes = self.and_above(joints.iter().copied());
        let (animation, note) = moving(&self.source.document, joints, &nodes)?;
        let nodes: Vec<usize> = nodes.into_iter().collect();
        let tracks = read_tracks(&animation, &self.source.bytes, &nodes, limits)?;
        Ok((nodes, tracks, note))
    }

    /// Where all nodes are in the world, time by time.
    fn play(
        &self,
        nodes: &[usize],
        tracks: &Tracks,
        times: &[f64],
        mut seen: impl FnMut(f64, &[Similarity3<f64>]),
    ) -> Result<(), GltfError> {
        let document = &self.document;
        let mut track_of: Vec<Option<&NodeTrack>> = vec![None; document.names.len()];
        nodes.iter().zip(&tracks.nodes).for_each(|(&node, track)| track_of[node] = Some(track));
        let order: Vec<usize> =
            document.order.iter().copied().filter(|&node| track_of[node].is_some()).collect();
        let mut world = document.world.clone();
        for &time in times {
            for &node in &order {
                let rest = &document.locals[node];
                let here = track_of[node].map_or(*rest, |track| track.at(rest, time));
                world[node] = match document.parents[node] {
                    Some(above) => placed(&world[above], &here).ok_or_else(|| vanishing(node))?,
                    None => here,
                };
            }
            seen(time, &world);
        }
        Ok(())
    }

    /// Where the joints of a hand are in some frames of the motion; none where it has none that can be read.
    fn shown(&self, group: &Found, limits: &Limits) -> Vec<JointPoints> {
        let mut shown = Vec::new();
        let mut show = || -> Result<(), GltfError> {
            let joints: BTreeSet<usize> = group.joints.iter().copied().flatten().collect();
            let (nodes, tracks, _) = self.tracks(&joints, limits)?;
            let every = tracks.times.len().div_ceil(SHOWN).max(1);
            let times: Vec<f64> = tracks.times.iter().copied().step_by(every).collect();
            self.play(&nodes, &tracks, &times, |_, world| {
                let at = |node: usize| world[node].isometry.translation.vector.into();
                shown.push(group.joints.map(|node| node.map(at)));
            })
        };
        if show().is_err() {
            shown.clear();
        }
        shown
    }

    fn poses(
        &self,
        hands: &[MovedHand],
        nodes: &[usize],
        tracks: &Tracks,
        times: &[f64],
    ) -> Result<FoundPoses, GltfError> {
        let document = &self.document;
        // Scales of a joint without another below change no pose.
        let above = self.and_above(joints(hands).into_iter().filter_map(|joint| document.parents[joint]));
        for (node, track) in nodes.iter().zip(&tracks.nodes).filter(|(node, _)| above.contains(node)) {
            track.check_scales(*node, &document.names[*node])?;
        }
        let mut readers: Vec<PosesFromTurns> = hands.iter().map(MovedHand::reader).collect();
        let mut poses: Vec<Vec<(f64, HandPose)>> = vec![Vec::with_capacity(times.len()); hands.len()];
        self.play(nodes, tracks, times, |time, world| {
            for ((hand, reader), poses) in hands.iter().zip(&mut readers).zip(&mut poses) {
                poses.push((time, hand.pose(document, reader, world)));
            }
        })?;
        let moves = |poses: &[(f64, HandPose)]| {
            poses.iter().any(|(_, pose)| (pose.translation - poses[0].1.translation).norm() > AT_REST)
        };
        // Of two arms one may rest.
        let on_arm = |hand: &&MovedHand| hand.hand.arm.is_some();
        let placed = hands.iter().zip(&poses).any(|(hand, poses)| !on_arm(&hand) || moves(poses));
        let mut notes = Vec::new();
        if !placed {
            for (_, pose) in poses.iter_mut().flatten() {
                pose.translation = Vector3::zeros();
            }
        } else if hands.iter().any(|hand| on_arm(&hand)) {
            notes.push(format!(
                "where wrists are is told by a camera {CAMERA} m before the hips, which goes along with the body"
            ));
        }
        let read = |(hand, poses): (&MovedHand, Vec<(f64, HandPose)>)| ImportedHand {
            side: hand.hand.side,
            morphology: hand.sizes.morphology.clone(),
            angles: hand.hand.angles().collect(),
            poses,
        };
        let hands = hands.iter().zip(poses).map(read).collect();
        Ok(FoundPoses { hands, placed, rate: None, notes })
    }
}

/// The nodes of some hands.
fn joints(hands: &[MovedHand]) -> BTreeSet<usize> {
    hands.iter().flat_map(|hand| hand.hand.nodes()).map(|(_, node)| node).collect()
}

impl MovedHand {
    fn new(document: &RigDocument, hand: RigHand, told: Option<Morphology>) -> Result<Self, GltfError> {
        let is_told = told.is_some();
        let mean = told.clone().unwrap_or_default();
        let bind = hand.bind(document, &mean)?;
        let sizes = match told {
            Some(morphology) => {
                let metres = hand.sizes(document, &bind).unit();
                Sizes { morphology: Some(morphology), metres, meant: true }
            }
            None => hand.sizes(document, &bind),
        };
        let neutral = Skeleton::new(&mean, hand.side).local_frames(&[0.0; 29]);
        let hips = hand.arm.map(|arm| document.hips(arm));
        Ok(Self { hand, bind, sizes, told: is_told, hips, neutral })
    }

    /// What is worth saying of its sizes.
    fn note(&self) -> Option<String> {
        let side = self.hand.side.name();
        match (&self.sizes.morphology, self.told, self.sizes.meant) {
            (_, true, _) => None,
            (Some(sizes), _, true) => Some(format!(
                "sizes of the {side} hand are measured on the rig at rest: {:.0} mm long",
                sizes.hand_length * 1e3
            )),
            (Some(_), _, false) => Some(format!(
                "the {side} hand at rest is as long as no hand: its sizes and places are scaled by {:.3e}",
                self.sizes.metres
            )),
            (None, ..) => {
                Some(format!("the {side} hand at rest has no sizes of a hand: it gets the mean ones"))
            }
        }
    }

    fn reader(&self) -> PosesFromTurns {
        let off = if self.told { 0.0 } else { UNLIKE };
        PosesFromTurns::new(self.hand.side).without_palms(|finger| !self.has_palm(finger)).off_by(off)
    }

    /// Whether the rig has the bone of this finger in the palm.
    fn has_palm(&self, finger: Finger) -> bool {
        let bone = Joint::of(finger).first().copied();
        self.hand.nodes().any(|(joint, _)| joint.is_some() && joint == bone)
    }

    /// The pose when nodes are here in the world; `reader` has read the poses before.
    fn pose(
        &self,
        document: &RigDocument,
        reader: &mut PosesFromTurns,
        world: &[Similarity3<f64>],
    ) -> HandPose {
        let turns = self.hand.orientations(document, &self.bind, &self.neutral, world);
        let at = |joint: Joint| turns[joint.index()];
        let mut pose = reader.pose(|joint| at(joint.parent().unwrap_or(Joint::Wrist)).inverse() * at(joint));
        pose.rotation = at(Joint::Wrist);
        let place = |node: usize| world[node].isometry.translation.vector * self.sizes.metres;
        if let Some(wrist) = self.hand.wrist() {
            pose.translation = match self.hips {
                None => place(wrist),
                Some(hips) => {
                    self.hand.body.inverse() * (place(wrist) - place(hips)) - Vector3::new(0.0, 0.0, CAMERA)
                }
            };
        }
        pose
    }
}
