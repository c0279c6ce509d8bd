//! The way back: the poses of a rig that [`super::retarget`] moved.

use nalgebra::{Isometry3, Quaternion, Similarity3, UnitQuaternion};
use serde_json::{Map, Value, json};

use super::document::RigDocument;
use super::hand::{Bind, RigHand};
use crate::GltfError;
use handcast_hand::turns::PosesFromTurns;
use handcast_hand::{Finger, HandFrames, HandPose, Joint, Morphology, Side, Skeleton};
use handcast_limits::Limits;

/// Where `asset.extras` tells which nodes of a rig are the joints of a hand: their numbers by the joints' names.
pub(crate) const RIG_NODES: &str = "nodes";
/// Where it tells how the body of the rig stands, where that is not upright and facing +Z: a quaternion, x first.
const RIG_BODY: &str = "body";

/// Keeps in the facts of a hand what tells those who read the poses back how it moves.
pub(super) fn keep(facts: &mut Value, hand: &RigHand) {
    let name = |joint: Option<Joint>| joint.map_or("palm", Joint::webxr_name).to_owned();
    let nodes = hand.nodes().map(|(joint, node)| (name(joint), node.into())).collect::<Map<_, _>>();
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

/// A rig that was moved.
pub(crate) struct MovedRig(RigDocument);

/// One of its hands.
pub(crate) struct MovedHand<'a> {
    document: &'a RigDocument,
    hand: RigHand,
    bind: Bind,
    /// The hand with all angles zero, for joints that the rig lacks.
    neutral: HandFrames,
}

impl MovedRig {
    /// Reads the rig at rest.
    ///
    /// # Errors
    /// Those of [`super::retarget`] for a rig.
    pub(crate) fn read(glb: &[u8], limits: &Limits) -> Result<Self, GltfError> {
        Ok(Self(RigDocument::read(glb, None, limits)?))
    }

    /// The hand of `side` that moves as the `facts` of it in the file tell.
    ///
    /// # Errors
    /// [`GltfError::Rig`] where these make no hand.
    pub(crate) fn hand(
        &self,
        side: Side,
        facts: &Value,
        morphology: &Morphology,
    ) -> Result<MovedHand<'_>, GltfError> {
        let document = &self.0;
        let node = |name: &str| facts[RIG_NODES].get(name)?.as_u64()?.try_into().ok();
        let joints = Joint::ALL.map(|j| node(j.webxr_name()));
        let hand = RigHand::of_nodes(document, side, joints, node("palm"), body_in(facts))?;
        let bind = hand.bind(document, morphology)?;
        let neutral = Skeleton::new(morphology, side).local_frames(&[0.0; 29]);
        Ok(MovedHand { document, hand, bind, neutral })
    }
}

impl MovedHand<'_> {
    /// Whether the rig has the bone of this finger in the palm.
    pub(crate) fn has_palm(&self, finger: Finger) -> bool {
        let bone = Joint::of(finger).first().copied();
        self.hand.nodes().any(|(joint, _)| joint.is_some() && joint == bone)
    }

    /// The pose when each node is where `local` says, given its number and rest, against the node above it; `reader` has
    /// read the poses before.
    pub(crate) fn pose(
        &self,
        reader: &mut PosesFromTurns,
        local: impl Fn(usize, &Isometry3<f64>) -> Isometry3<f64>,
    ) -> HandPose {
        let mut world = self.document.world.clone();
        for &node in &self.document.order {
            let rest = self.document.locals[node];
            let here = Similarity3::from_isometry(local(node, &rest.isometry), rest.scaling());
            let above = self.document.parents[node].map_or_else(Similarity3::identity, |p| world[p]);
            world[node] = above * here;
        }
        let turns = self.hand.orientations(self.document, &self.bind, &self.neutral, &world);
        let at = |joint: Joint| turns[joint.index()];
        let mut pose = reader.pose(|joint| at(joint.parent().unwrap_or(Joint::Wrist)).inverse() * at(joint));
        pose.rotation = at(Joint::Wrist);
        if let Some(wrist) = self.hand.wrist() {
            pose.translation = world[wrist].isometry.translation.vector;
        }
        pose
    }
}
