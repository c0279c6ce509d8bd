//! Joints that a finder has seen in the picture, as residuals.

use nalgebra::Vector3;

use super::super::model::HandModel;
use super::super::normal_equations::NormalEquations;
use super::super::projection::{COLUMNS, FREE, ProjectedSphere, parameter};
use super::super::state::{HAND_LENGTH, ModelState};
use super::prior::Loss;
use super::sizes::SizeEquations;
use crate::View;
use handcast_hand::landmarks::{LANDMARKS_21, TIP_INSIDE, TIPS_21};
use handcast_hand::{Finger, Shape, Side};
use handcast_vision::sighting::JOINTS;
use handcast_vision::tuning::tuning;

tuning! {
    /// What joints seen by a finder tell. Their depth is not used: it is worse than what outlines tell.
    pub struct LandmarkTuning {
        /// How far inside the tips finders have them.
        ["end bones", "MediaPipe's fingertips on rendered hands: 3 % of the hand's length inside the end"]
        pub inside_tip: f64 = TIP_INSIDE,
        /// Standard deviation of a joint's place.
        ["hand lengths", "errors of MediaPipe's joints on rendered hands: median 2 %; with 3 % places are worse there, with 1.5 % angles"]
        pub deviation: f64 = 0.02,
        /// The same of joints that the hand hides: DIP and tip of folded fingers seen from the back. The thumb's are believed
        /// there, though they are 6 % off: without them it stays behind the palm where it is out.
        ["hand lengths", "errors of MediaPipe's joints on rendered hands, root mean square: 8.2 %; of a palm's folded fingers 3.4 %"]
        pub hidden_deviation: f64 = 0.08,
        /// The same of the PIP joints of such fingers.
        ["hand lengths", "errors of MediaPipe's joints there: 4 %"]
        pub folded_deviation: f64 = 0.04,
        /// Least sine of the angle between the outer knuckles, seen from the wrist, of a hand whose back is seen.
        ["1", "chosen: a third of that of a hand that faces the camera"]
        pub facing: f64 = 0.15,
        /// Distance at which a joint counts as an outlier (Geman & McClure 1985).
        ["hand lengths", "chosen by eye: a finger taken for its neighbour"]
        pub outlier: f64 = 0.12,
        /// Mean distance of the joints of the model from those seen, up to which other postures are hardly tried.
        ["hand lengths", "54 rendered clips with networks: angles and places are about as good as with all hypotheses"]
        pub agrees: f64 = 0.045,
        /// Every so many frames they are tried all the same.
        ["frames", "chosen: a posture that is wrong though its joints agree is found within a few frames"]
        pub tried_every: usize = 4,
        /// How far ahead of the wrist finders have it.
        ["hand lengths", "constant offset of MediaPipe's wrist on rendered hands: 8 to 9 % where they face the camera"]
        pub wrist_ahead: f64 = 0.09,
        /// How far from the knuckles of the long fingers to their next joints finders have them.
        ["first phalanges", "MediaPipe's MCP joints on rendered hands, palm or back: 0.14 to 0.20, less where they are bent"]
        pub beyond_knuckles: f64 = 0.14,
        /// The same of the thumb's MCP joint.
        ["first phalanges", "MediaPipe's on rendered hands: 0.13"]
        pub beyond_thumb_mcp: f64 = 0.13,
        /// Frames as which no more difference counts: a finder errs alike in frames that are alike.
        ["frames", "rendered hands: with 4, differences of sizes are taken for the finder's"]
        pub offset_prior: f64 = 150.0,
        /// Frames that the offsets are a mean of, at most.
        ["frames", "chosen: twenty seconds of video"]
        pub offset_memory: f64 = 600.0,
        /// Difference of the flexions from those of the open hand up to which offsets are learnt.
        ["rad", "chosen by eye"]
        pub learnt_within: f64 = 0.5,
    }
}

/// Joints whose offset from the model's is learnt: those of the palm, which move as one.
const OF_PALM: [usize; 6] = [0, 1, 5, 9, 13, 17];

/// The knuckles of the long fingers.
const KNUCKLES: [usize; 4] = [5, 9, 13, 17];
/// The MCP joint of the thumb.
const THUMB_MCP: usize = 2;

/// The sphere of the shape at each joint but the wrist.
fn sphere_of(joint: usize) -> Option<usize> {
    let number = joint.checked_sub(1)?;
    let finger = *Finger::ALL.get(number / 4)?;
    Some(Shape::finger_spheres(finger)[number % 4])
}

/// The change of a place in the image, pixels, by each column of a finger's spheres; of the palm's without finger.
type ByPose = (Option<Finger>, [[f64; 2]; COLUMNS]);

/// Places of joints in the image, pixels of the reduced image.
pub type JointPlaces = [[f64; 2]; JOINTS];

impl LandmarkTuning {
    /// The loss of a joint whose place has such a standard deviation, hand lengths, of a hand of so many pixels: outliers of all
    /// cost the same.
    fn loss(&self, deviation: f64, hand: f64) -> Loss {
        let reach = self.outlier * deviation / self.deviation;
        Loss::geman_mcclure(deviation * hand, reach * hand)
    }
}

/// Standard deviations of the places of joints seen of a hand of this side, hand lengths: of what the hand hides a finder tells
/// little.
fn deviations(seen: &JointPlaces, side: Side, tuning: &LandmarkTuning) -> [f64; JOINTS] {
    let mut deviations = [tuning.deviation; JOINTS];
    let (view, sine) = View::of_joints(seen, side);
    if view == View::Palm || sine < tuning.facing {
        return deviations;
    }
    let from = |a: usize, b: usize| [0, 1].map(|k| seen[b][k] - seen[a][k]);
    let along = |[x, y]: [f64; 2], [u, v]: [f64; 2]| x * u + y * v;
    let ahead = from(0, 9);
    for knuckle in KNUCKLES {
        let [pip, dip, tip] = [knuckle + 1, knuckle + 2, knuckle + 3];
        if along(from(pip, tip), ahead) < 0.0 {
            deviations[pip] = tuning.folded_deviation;
            deviations[dip] = tuning.hidden_deviation;
            deviations[tip] = tuning.hidden_deviation;
        }
    }
    deviations
}

/// Compares joints of the model with those seen.
#[derive(Clone, Debug, Default)]
pub(super) struct Landmarks {
    tuning: LandmarkTuning,
    /// From the model's joint to the finder's, hand frame, hand lengths.
    offsets: [[f64; 2]; JOINTS],
    learnt: f64,
}

impl Landmarks {
    pub(super) fn new(tuning: LandmarkTuning) -> Self {
        let mut offsets = [[0.0; 2]; JOINTS];
        offsets[0][1] = tuning.wrist_ahead;
        Self { tuning, offsets, learnt: 0.0 }
    }

    /// How far beyond a joint the finder has it, bones.
    fn beyond(&self, joint: usize) -> f64 {
        match joint {
            THUMB_MCP => self.tuning.beyond_thumb_mcp,
            _ if KNUCKLES.contains(&joint) => self.tuning.beyond_knuckles,
            _ => 0.0,
        }
    }

    /// The spheres that a joint moves with, and their shares; `None` for the wrist.
    fn spheres_of(&self, joint: usize) -> Option<[(usize, f64); 2]> {
        let sphere = sphere_of(joint)?;
        let beyond = self.beyond(joint);
        let next = if beyond > 0.0 { sphere_of(joint + 1)? } else { sphere };
        Some([(sphere, 1.0 - beyond), (next, beyond)])
    }

    /// How a joint moves with the pose; `None` for the wrist.
    fn by_pose(&self, joint: usize, spheres: &[ProjectedSphere]) -> Option<ByPose> {
        let [(own, share), (next, beyond)] = self.spheres_of(joint)?;
        let (own, next) = (spheres.get(own)?, spheres.get(next)?);
        let mixed = |c: usize| [0, 1].map(|k| share * own.columns[c][k] + beyond * next.columns[c][k]);
        Some((own.finger, std::array::from_fn(mixed)))
    }

    /// Where the finder would see the joints of the model, pixels.
    fn places(&self, model: &HandModel, state: &ModelState) -> JointPlaces {
        let joints = model.joints(state);
        let mut places = LANDMARKS_21.map(|joint| joints[joint.index()]);
        for tip in TIPS_21 {
            let (inner, end) = (places[tip - 1], places[tip]);
            places[tip] = [0, 1].map(|k| end[k] + self.tuning.inside_tip * (inner[k] - end[k]));
        }
        for joint in [THUMB_MCP].into_iter().chain(KNUCKLES) {
            let (at, next, beyond) = (places[joint], places[joint + 1], self.beyond(joint));
            places[joint] = [0, 1].map(|k| at[k] + beyond * (next[k] - at[k]));
        }
        for (place, [x, y]) in places.iter_mut().zip(self.offsets) {
            let off = state.rotation * Vector3::new(x, y, 0.0) * (HAND_LENGTH * state.scale);
            *place = [place[0] + off.x, place[1] - off.y];
        }
        places
    }

    /// How far each joint of the model is from where it was seen, pixels, and the loss of that.
    fn differences(
        &self,
        model: &HandModel,
        state: &ModelState,
        seen: &JointPlaces,
    ) -> [([f64; 2], Loss); JOINTS] {
        let hand = HAND_LENGTH * state.scale;
        let (places, deviations) = (self.places(model, state), deviations(seen, model.side(), &self.tuning));
        std::array::from_fn(|joint| {
            let away = [0, 1].map(|k| places[joint][k] - seen[joint][k]);
            (away, self.tuning.loss(deviations[joint], hand))
        })
    }

    /// Gives each residual: its gradient by parameter, its value in pixels, its loss.
    fn residuals(
        &self,
        (model, spheres): (&HandModel, &[ProjectedSphere]),
        state: &ModelState,
        seen: &JointPlaces,
        mut add: impl FnMut(&[(usize, f64)], f64, Loss),
    ) {
        for (joint, (away, loss)) in self.differences(model, state, seen).into_iter().enumerate() {
            let by_pose = self.by_pose(joint, spheres);
            for axis in 0..2 {
                let mut gradient = [(axis, 1.0); COLUMNS];
                let mut count = 1;
                if let Some((finger, columns)) = &by_pose {
                    count = if finger.is_some() { COLUMNS } else { FREE };
                    for (c, slot) in gradient.iter_mut().enumerate().take(count) {
                        *slot = (finger.map_or(c, |f| parameter(f, c)), columns[c][axis]);
                    }
                    // The last column is the thumb's alone.
                    if finger.is_some_and(|f| f != Finger::Thumb) {
                        count -= 1;
                    }
                }
                add(&gradient[..count], away[axis], loss);
            }
        }
    }

    /// Adds the joints of the fingers to what tells of the sizes.
    pub(super) fn add_to_sizes(
        &self,
        sizes: &mut SizeEquations,
        (model, spheres): (&HandModel, &[ProjectedSphere]),
        state: &ModelState,
        seen: &JointPlaces,
    ) {
        for (joint, (away, loss)) in self.differences(model, state, seen).into_iter().enumerate() {
            let Some(of) = self.spheres_of(joint) else { continue };
            let Some((finger, columns)) = self.by_pose(joint, spheres) else { continue };
            for (axis, residual) in away.into_iter().enumerate() {
                let gradient = (finger, columns.map(|column| column[axis]));
                sizes.add_joint((of, axis), residual, loss.weight(residual), &gradient);
            }
        }
    }

    pub(super) fn add_to(
        &self,
        equations: &mut NormalEquations,
        (model, spheres): (&HandModel, &[ProjectedSphere]),
        state: &ModelState,
        seen: &JointPlaces,
    ) {
        self.residuals((model, spheres), state, seen, |gradient, residual, loss| {
            equations.add(gradient, residual, loss.weight(residual));
        });
    }

    /// Half the sum of squares in standard deviations, outliers limited.
    pub(super) fn cost(
        &self,
        (model, spheres): (&HandModel, &[ProjectedSphere]),
        state: &ModelState,
        seen: &JointPlaces,
    ) -> f64 {
        let mut sum = 0.0;
        self.residuals((model, spheres), state, seen, |_, residual, loss| sum += loss.cost(residual));
        sum
    }

    /// Mean distance of the joints from those of the model, hand lengths.
    pub(super) fn distance(&self, model: &HandModel, state: &ModelState, seen: &JointPlaces) -> f64 {
        let hand = HAND_LENGTH * state.scale;
        let away = |(at, to): ([f64; 2], &[f64; 2])| (at[0] - to[0]).hypot(at[1] - to[1]) / hand;
        self.places(model, state).into_iter().zip(seen).map(away).sum::<f64>() / JOINTS as f64
    }

    /// Learns where the finder has the joints of the palm, from a hand that is about open.
    pub(super) fn learn(&mut self, model: &HandModel, state: &ModelState, seen: &JointPlaces) {
        let t = self.tuning;
        self.learnt = (self.learnt + 1.0).min(t.offset_memory);
        let share = 1.0 / (self.learnt + t.offset_prior);
        let hand = HAND_LENGTH * state.scale;
        let places = self.places(model, state);
        for joint in OF_PALM {
            let at = places[joint];
            let off = [(seen[joint][0] - at[0]) / hand, (at[1] - seen[joint][1]) / hand];
            let residual = state.rotation.inverse() * Vector3::new(off[0], off[1], 0.0);
            for (k, offset) in self.offsets[joint].iter_mut().enumerate() {
                *offset += share * residual[k];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::projection::PARAMETERS;
    use super::super::testing::open;
    use super::*;
    use handcast_hand::Morphology;

    #[test]
    fn joints_behind_the_palm_are_believed_less() {
        let t = LandmarkTuning::default();
        let model = HandModel::new(&Morphology::default(), Side::Right);
        let mut state = open().state;
        let index = Finger::Index;
        let seen = |state: &ModelState| Landmarks::new(t).places(&model, state);
        // The other hand seen so shows its back.
        for side in [Side::Right, Side::Left] {
            assert_eq!(deviations(&seen(&state), side, &t), [t.deviation; JOINTS]);
        }
        (state.free[index.free_base()], state.free[index.free_outer()]) = (1.5, 1.7);
        assert_eq!(deviations(&seen(&state), Side::Right, &t), [t.deviation; JOINTS]);
        let mut expected = [t.deviation; JOINTS];
        (expected[6], expected[7], expected[8]) =
            (t.folded_deviation, t.hidden_deviation, t.hidden_deviation);
        assert_eq!(deviations(&seen(&state), Side::Left, &t), expected);
        // Its edge shows neither.
        let edge = seen(&state).map(|[x, y]| [0.05 * x, y]);
        assert_eq!(deviations(&edge, Side::Left, &t), [t.deviation; JOINTS]);
    }

    #[test]
    fn knuckles_move_as_their_derivatives_say() {
        let model = HandModel::new(&Morphology::default(), Side::Right);
        let landmarks = Landmarks::new(LandmarkTuning::default());
        let mut state = open().state;
        // Not where the flexions that follow from it begin.
        Finger::ALL.iter().for_each(|finger| state.free[finger.free_base()] = 0.3);
        let mut spheres = Vec::new();
        model.project_moving(&state, &mut spheres);
        for joint in [THUMB_MCP].into_iter().chain(KNUCKLES) {
            let (finger, columns) = landmarks.by_pose(joint, &spheres).unwrap();
            let finger = finger.unwrap();
            let own = if finger == Finger::Thumb { COLUMNS } else { COLUMNS - 1 };
            for (column, by) in columns.into_iter().enumerate().take(own) {
                let at = |h: f64| {
                    let mut step = [0.0; PARAMETERS];
                    step[parameter(finger, column)] = h;
                    landmarks.places(&model, &state.stepped(&step))[joint]
                };
                let (before, after) = (at(-1e-4), at(1e-4));
                for axis in 0..2 {
                    let slope = (after[axis] - before[axis]) / 2e-4;
                    assert!(
                        (slope - by[axis]).abs() < 0.01 * (1.0 + slope.abs()),
                        "{joint} {column}: {slope} {by:?}"
                    );
                }
            }
        }
    }
}
