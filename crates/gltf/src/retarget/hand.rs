//! A hand of a rig: how its bones lie at rest, and where a pose puts them.

use nalgebra::{Matrix3, Rotation3, Similarity3, Translation3, UnitQuaternion, Vector3};

use super::document::RigDocument;
use super::find::{Found, lacking};
use super::{RigError, body};
use crate::names::place;
use handcast_hand::{
    Finger, HandFrames, Joint, JointAngle, Morphology, Side, Skeleton, mirror_rotation, mirror_vector,
};
use handcast_limits::quoted;

/// A hand of the rig.
pub(super) struct RigHand {
    pub(super) side: Side,
    /// Node of each joint, in the order of [`Joint::ALL`].
    joints: [Option<usize>; 25],
    /// A palm joint that does not hang below the wrist, and so must be carried along.
    palm: Option<usize>,
    /// The node of the arm that the wrist hangs on; without one the wrist travels.
    pub(super) arm: Option<usize>,
    /// How the body that the hand hangs on stands in the world: from a person upright (+Y) who faces +Z.
    pub(super) body: UnitQuaternion<f64>,
}

/// The sizes of a hand of a rig at rest.
pub(super) struct Sizes {
    /// `None` where they are not those of a hand.
    pub(super) morphology: Option<Morphology>,
    /// Metres in a unit of the file.
    pub(super) metres: f64,
    /// Whether that is a unit that people work in.
    pub(super) meant: bool,
}

impl Sizes {
    /// Metres in a unit of the file, as far as it is one that people work in.
    pub(super) fn unit(&self) -> f64 {
        if self.meant { self.metres } else { 1.0 }
    }
}

/// Metres in units that rigs are made in, and the lengths of hands, metres.
const UNITS: [f64; 4] = [1.0, 0.01, 0.001, 0.0254];
const HAND_LENGTHS: std::ops::Range<f64> = 0.1..0.3;

/// Orientation of the bones at rest, as the axes of [`HandFrames`] have them.
pub(super) struct Bind([Option<UnitQuaternion<f64>>; 25]);

impl RigHand {
    pub(super) fn new(document: &RigDocument, side: Side, group: Found) -> Self {
        let wrist = group.joints[Joint::Wrist.index()];
        let palm = group
            .palm
            .filter(|&p| wrist.is_some_and(|w| !document.is_below(p, w) && !document.is_below(w, p)));
        let knuckle = group.joints[Joint::MiddleProximal.index()];
        let arm =
            wrist.zip(knuckle).and_then(|(wrist, knuckle)| body::arm(document, wrist, knuckle, group.palm));
        Self { side, joints: group.joints, palm, arm, body: UnitQuaternion::identity() }
    }

    /// The hand whose joints are at these nodes, on a body that stands like this.
    pub(super) fn of_nodes(
        document: &RigDocument,
        side: Side,
        group: Found,
        body: UnitQuaternion<f64>,
    ) -> Result<Self, RigError> {
        let count = document.names.len();
        if let Some(node) = group.joints.iter().chain(&[group.palm]).flatten().find(|&&node| node >= count) {
            return Err(RigError::NoHand { what: format!("node {node} of {count}") });
        }
        if let Some(lack) = lacking(&group) {
            return Err(RigError::NoHand { what: lack.unwrap_or_else(|| "no joint is told".into()) });
        }
        let hand = Self { body, ..Self::new(document, side, group) };
        hand.check_scales(document)?;
        Ok(hand)
    }

    /// Refuses a hand that scales above it would shear.
    pub(super) fn check_scales(&self, document: &RigDocument) -> Result<(), RigError> {
        match self.nodes().find_map(|(_, node)| document.sheared_by(node)) {
            Some(node) => Err(RigError::File {
                what: format!(
                    "node {node} ({}), above a joint of the hand, has scales that are not equal and positive",
                    quoted(&document.names[node])
                ),
            }),
            None => Ok(()),
        }
    }

    /// The node of the wrist.
    pub(super) fn wrist(&self) -> Option<usize> {
        self.joints[Joint::Wrist.index()]
    }

    /// The nodes of the wrist and the knuckles.
    pub(super) fn palm_nodes(&self) -> impl Iterator<Item = usize> {
        let knuckles = Finger::LONG.into_iter().map(Joint::base);
        std::iter::once(Joint::Wrist).chain(knuckles).filter_map(|joint| self.joints[joint.index()])
    }

    /// The nodes that move, with their joints (`None` for the palm).
    pub(super) fn nodes(&self) -> impl Iterator<Item = (Option<Joint>, usize)> {
        let joints = Joint::ALL.into_iter().zip(self.joints).filter_map(|(j, n)| n.map(|n| (Some(j), n)));
        joints.chain(self.palm.map(|n| (None, n)))
    }

    /// The joint angles that its bones show.
    pub(super) fn angles(&self) -> impl Iterator<Item = JointAngle> {
        let has = |joint: Joint| self.joints[joint.index()].is_some();
        let of = move |finger: Finger| {
            let joints = Joint::of(finger);
            let chain = &joints[joints.len() - 4..];
            let palm = finger.palm_flexion().filter(|_| has(joints[0]));
            let base = [finger.base_flexion(), finger.abduction(), finger.twisting()]
                .map(|a| Some(a).filter(|_| has(chain[0])));
            let bends = [(finger.middle_flexion(), chain[1]), (finger.end_flexion(), chain[2])];
            let bends = bends.map(|(angle, joint)| Some(angle).filter(|_| has(joint)));
            [palm].into_iter().chain(base).chain(bends).flatten().collect::<Vec<_>>()
        };
        let told: Vec<JointAngle> = Finger::ALL.into_iter().flat_map(of).collect();
        JointAngle::ALL.into_iter().filter(move |angle| told.contains(angle))
    }

    /// The sizes of the hand at rest: its joints in the frame of the wrist that `bind` tells. Breadths, and what it lacks, have the
    /// mean proportions.
    pub(super) fn sizes(&self, document: &RigDocument, bind: &Bind) -> Sizes {
        let turn = bind.0[Joint::Wrist.index()].unwrap_or_default().inverse();
        let place = |joint: Joint| self.rest(document, joint).map(|rest| rest.isometry.translation.vector);
        let wrist = place(Joint::Wrist).unwrap_or_default();
        let at = |joint: Joint| {
            let v = turn * (place(joint)? - wrist);
            Some(if self.side == Side::Left { mirror_vector(v) } else { v })
        };
        let bone = |joint: &Joint| {
            let next = *Joint::ALL.get(joint.index() + 1)?;
            Some((at(next)? - at(*joint)?).norm()).filter(|length| *length > 1e-9)
        };
        let mean = Morphology::default();
        // What is there over what the mean hand has of it.
        let chain = |f: &Finger| {
            let joints = Joint::of(*f);
            joints[joints.len() - 4..].iter().zip(mean.finger(*f).bones)
        };
        let told = Finger::LONG.iter().flat_map(chain).filter_map(|(joint, mean)| Some((bone(joint)?, mean)));
        let (sum, of) = told.fold((0.0, 0.0), |(a, b), (bone, mean)| (a + bone, b + mean));
        let length = mean.hand_length * if of > 0.0 { sum / of } else { 0.0 };
        let unit = UNITS.into_iter().find(|unit| HAND_LENGTHS.contains(&(length * unit)));
        let metres = unit.unwrap_or(if length > 1e-9 { mean.hand_length / length } else { 1.0 });
        let mut sizes = Morphology::average(length * metres);
        for finger in Finger::ALL {
            let joints = Joint::of(finger);
            let sized = &mut sizes.fingers[finger as usize];
            if let Some(base) = at(Joint::base(finger)) {
                sized.base = (base * metres).into();
                sized.metacarpal = at(joints[0]).map_or(sized.metacarpal, |inner| (inner * metres).into());
            }
            for (size, joint) in sized.bones.iter_mut().zip(&joints[joints.len() - 4..]) {
                *size = bone(joint).map_or(*size, |length| length * metres);
            }
        }
        let middle = sizes.finger(Finger::Middle);
        sizes.hand_length = middle.base[1] + middle.length();
        let sound = sizes.validate().is_ok();
        Sizes { morphology: sound.then_some(sizes), metres, meant: unit.is_some() }
    }

    fn rest(&self, document: &RigDocument, joint: Joint) -> Option<Similarity3<f64>> {
        Some(document.rest[self.joints[joint.index()]?])
    }

    /// How the bones lie at rest. Left hands are looked at in the mirror.
    pub(super) fn bind(&self, document: &RigDocument, morphology: &Morphology) -> Result<Bind, RigError> {
        let mirror = |v: Vector3<f64>| if self.side == Side::Left { mirror_vector(v) } else { v };
        let at = |joint: Joint| self.rest(document, joint).map(|w| mirror(w.isometry.translation.vector));
        let model = Skeleton::new(morphology, Side::Right).local_frames(&[0.0; 29]);
        let ours = |joint: Joint| at(joint).map(|_| model.position(joint).coords);
        let flat = || RigError::NoHand { what: "wrist and knuckles do not span a palm".into() };
        let palm = |points: &dyn Fn(Joint) -> Option<Vector3<f64>>| palm_axes(points).ok_or_else(flat);
        let hand = palm(&at)? * palm(&ours)?.inverse();
        let mut out = [None; 25];
        out[Joint::Wrist.index()] = Some(hand);
        for finger in Finger::ALL {
            let joints = Joint::of(finger);
            let rest = model.get(joints[joints.len() - 4]).rotation;
            // What the joint is turned about its bone when its angles are zero: the thumb's pronation.
            let twist = pointing(&(rest * Vector3::y())).inverse() * rest;
            let mut above: Option<UnitQuaternion<f64>> = None;
            for &joint in joints {
                if at(joint).is_none() {
                    continue;
                }
                let turn = match (place(joint), self.bone(document, joint)) {
                    (Some((_, 0)), _) => hand,
                    (Some((_, 1..=3)), Some(bone)) => {
                        let bone = mirror(bone);
                        let turn = match above {
                            None => hand * pointing(&hand.inverse_transform_vector(&bone)) * twist,
                            Some(above) => carried(&above, &bone),
                        };
                        above = Some(turn);
                        turn
                    }
                    _ => above.unwrap_or(hand),
                };
                out[joint.index()] = Some(turn);
            }
        }
        if self.side == Side::Left {
            out = out.map(|turn| turn.map(|t| mirror_rotation(&t)));
        }
        Ok(Bind(out))
    }

    /// Direction of a finger bone at rest: to the next joint, or, of an end bone without a tip, along the
    /// axis of the joint that the bone before has.
    fn bone(&self, document: &RigDocument, joint: Joint) -> Option<Vector3<f64>> {
        let position = |j: Joint| self.rest(document, j).map(|w| w.isometry.translation.vector);
        let unit = |v: Vector3<f64>| v.try_normalize(1e-9);
        let here = self.rest(document, joint)?;
        let next = *Joint::ALL.get(joint.index() + 1)?;
        if next.parent() == Some(joint)
            && let Some(to) = position(next)
        {
            return unit(to - here.isometry.translation.vector);
        }
        let before = self.rest(document, joint.parent()?)?;
        let bone = unit(here.isometry.translation.vector - before.isometry.translation.vector)?;
        Some(here.isometry.rotation * (before.isometry.rotation.inverse() * bone))
    }

    /// Where the nodes are, in the world and in the order of [`RigHand::nodes`], when the hand of the skeleton
    /// has these frames.
    pub(super) fn placed(
        &self,
        document: &RigDocument,
        bind: &Bind,
        metres: f64,
        frames: &HandFrames,
    ) -> Vec<Similarity3<f64>> {
        // What turns each joint from its rest, and where it then is.
        let mut turns = [UnitQuaternion::identity(); 25];
        let mut positions = [Vector3::zeros(); 25];
        let mut out = Vec::with_capacity(26);
        let rest_of = |joint: Joint| self.rest(document, joint).unwrap_or_else(Similarity3::identity);
        let mut push = |node: usize, turn: &UnitQuaternion<f64>, position: Vector3<f64>| {
            let mut world = document.rest[node];
            world.isometry.rotation = turn * world.isometry.rotation;
            world.isometry.translation = Translation3::from(position);
            out.push(world);
        };
        for joint in Joint::ALL {
            let Some(node) = self.joints[joint.index()] else { continue };
            let rest = bind.0[joint.index()].unwrap_or_default();
            let turn = self.body * frames.get(joint).rotation * rest.inverse();
            let here = rest_of(joint).isometry.translation.vector;
            let above = std::iter::successors(joint.parent(), |j| j.parent())
                .find(|j| self.joints[j.index()].is_some());
            let position = match above {
                Some(above) => {
                    let arm = here - rest_of(above).isometry.translation.vector;
                    positions[above.index()] + turns[above.index()] * arm
                }
                None if self.arm.is_some() => here,
                None => frames.get(joint).translation.vector / metres,
            };
            (turns[joint.index()], positions[joint.index()]) = (turn, position);
            push(node, &turn, position);
        }
        if let Some(node) = self.palm {
            let wrist = Joint::Wrist.index();
            let arm = document.rest[node].isometry.translation.vector
                - rest_of(Joint::Wrist).isometry.translation.vector;
            push(node, &turns[wrist], positions[wrist] + turns[wrist] * arm);
        }
        out
    }
}

impl RigHand {
    /// [`RigHand::placed`] the other way: how the frames of the skeleton's joints are turned when the nodes are at
    /// `world`. What the rig lacks is, against the joint above it, as in `neutral`.
    pub(super) fn orientations(
        &self,
        document: &RigDocument,
        bind: &Bind,
        neutral: &HandFrames,
        world: &[Similarity3<f64>],
    ) -> [UnitQuaternion<f64>; 25] {
        let mut out = [UnitQuaternion::identity(); 25];
        for joint in Joint::ALL {
            out[joint.index()] = match (self.joints[joint.index()], joint.parent()) {
                (Some(node), _) => {
                    let turn =
                        world[node].isometry.rotation * document.rest[node].isometry.rotation.inverse();
                    self.body.inverse() * turn * bind.0[joint.index()].unwrap_or_default()
                }
                (None, Some(above)) => {
                    out[above.index()] * neutral.get(above).rotation.inverse() * neutral.get(joint).rotation
                }
                (None, None) => UnitQuaternion::identity(),
            };
        }
        out
    }
}

/// Axes of a right palm: +Y from the wrist to the middle knuckle, +Z out of it.
fn palm_axes(at: &dyn Fn(Joint) -> Option<Vector3<f64>>) -> Option<UnitQuaternion<f64>> {
    let y = (at(Joint::MiddleProximal)? - at(Joint::Wrist)?).try_normalize(1e-9)?;
    let last = at(Joint::PinkyProximal).or_else(|| at(Joint::RingProximal))?;
    let z = (at(Joint::IndexProximal)? - last).cross(&y).try_normalize(1e-9)?;
    Some(axes(y.cross(&z), y, z))
}

fn axes(x: Vector3<f64>, y: Vector3<f64>, z: Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, z])))
}

/// The turn about z and then x that takes +Y to a direction: abduction and flexion of a finger's base.
fn pointing(direction: &Vector3<f64>) -> UnitQuaternion<f64> {
    let about = UnitQuaternion::from_scaled_axis;
    let (z, x) = (f64::atan2(-direction.x, direction.y), direction.z.clamp(-1.0, 1.0).asin());
    about(Vector3::z() * z) * about(Vector3::x() * x)
}

/// The axes of a bone in this direction that bends, as far as it can, about the x axis of the one before.
fn carried(above: &UnitQuaternion<f64>, bone: &Vector3<f64>) -> UnitQuaternion<f64> {
    let x = above * Vector3::x();
    match (x - bone * x.dot(bone)).try_normalize(1e-6) {
        Some(x) => axes(x, *bone, x.cross(bone)),
        None => *above,
    }
}
