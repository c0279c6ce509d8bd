//! Joints that a finder has seen in the picture, as residuals.

use nalgebra::Vector3;

use super::super::normal_equations::NormalEquations;
use super::super::projection::{COLUMNS, FREE, ProjectedSphere, parameter};
use super::super::state::{HAND_LENGTH, ModelState};
use super::prior::Loss;
use handcast_hand::{Finger, Shape};
use handcast_vision::sighting::JOINTS;
use handcast_vision::tuning::tuning;

tuning! {
    /// What joints seen by a finder tell. Their depth is not used: it is worse than what outlines tell.
    pub struct LandmarkTuning {
        /// Standard deviation of a joint's place.
        ["hand lengths", "errors of MediaPipe's joints on rendered hands: median 2 %, 90th percentile 5 %"]
        pub deviation: f64 = 0.04,
        /// Distance at which a joint counts as an outlier (Geman & McClure 1985).
        ["hand lengths", "chosen by eye: a finger taken for its neighbour"]
        pub outlier: f64 = 0.12,
        /// Standard deviation of the difference between a joint of the model and what the finder calls by its name.
        ["hand lengths", "constant offsets of MediaPipe's joints on rendered hands: 9 % at the wrist, 2 to 7 % else"]
        pub offset: f64 = 0.04,
        /// Frames that the offsets are a mean of, at most.
        ["frames", "chosen: ten seconds of video"]
        pub offset_memory: f64 = 300.0,
        /// Difference of the flexions from those of the open hand up to which offsets are learnt.
        ["rad", "chosen by eye"]
        pub learnt_within: f64 = 0.5,
    }
}

/// Joints whose offset from the model's is learnt: those of the palm, which move as one.
const OF_PALM: [usize; 6] = [0, 1, 5, 9, 13, 17];

/// The finger and the place on it, from the palm outwards, of each joint but the wrist.
fn on_finger(joint: usize) -> Option<(Finger, usize)> {
    let number = joint.checked_sub(1)?;
    Some((*Finger::ALL.get(number / 4)?, number % 4))
}

/// Places of joints in the image, pixels of the reduced image.
pub type JointPlaces = [[f64; 2]; JOINTS];

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
        Self { tuning, ..Self::default() }
    }

    /// Where the model has a joint, pixels.
    fn place(&self, spheres: &[ProjectedSphere], state: &ModelState, joint: usize) -> [f64; 2] {
        let at = match on_finger(joint).and_then(|(f, k)| spheres.get(Shape::finger_spheres(f)[k])) {
            Some(sphere) => [sphere.disc.x, sphere.disc.y],
            None => state.wrist,
        };
        let [x, y] = self.offsets[joint];
        let off = state.rotation * Vector3::new(x, y, 0.0) * (HAND_LENGTH * state.scale);
        [at[0] + off.x, at[1] - off.y]
    }

    /// Gives each residual: its gradient by parameter, its value in pixels, its loss.
    fn residuals(
        &self,
        spheres: &[ProjectedSphere],
        state: &ModelState,
        seen: &JointPlaces,
        mut add: impl FnMut(&[(usize, f64)], f64, Loss),
    ) {
        let hand = HAND_LENGTH * state.scale;
        let loss = Loss::geman_mcclure(self.tuning.deviation * hand, self.tuning.outlier * hand);
        for (joint, to) in seen.iter().enumerate() {
            let at = self.place(spheres, state, joint);
            let sphere = on_finger(joint).and_then(|(f, k)| spheres.get(Shape::finger_spheres(f)[k]));
            for axis in 0..2 {
                let mut gradient = [(axis, 1.0); COLUMNS];
                let mut count = 1;
                if let Some(sphere) = sphere {
                    count = if sphere.finger.is_some() { COLUMNS } else { FREE };
                    for (c, slot) in gradient.iter_mut().enumerate().take(count) {
                        let of = sphere.finger.map_or(c, |f| parameter(f, c));
                        *slot = (of, sphere.columns[c][axis]);
                    }
                    // The last column is the thumb's alone.
                    if sphere.finger.is_some_and(|f| f != Finger::Thumb) {
                        count -= 1;
                    }
                }
                add(&gradient[..count], at[axis] - to[axis], loss);
            }
        }
    }

    pub(super) fn add_to(
        &self,
        equations: &mut NormalEquations,
        spheres: &[ProjectedSphere],
        state: &ModelState,
        seen: &JointPlaces,
    ) {
        self.residuals(spheres, state, seen, |gradient, residual, loss| {
            equations.add(gradient, residual, loss.weight(residual));
        });
    }

    /// Half the sum of squares in standard deviations, outliers limited.
    pub(super) fn cost(&self, spheres: &[ProjectedSphere], state: &ModelState, seen: &JointPlaces) -> f64 {
        let mut sum = 0.0;
        self.residuals(spheres, state, seen, |_, residual, loss| sum += loss.cost(residual));
        sum
    }

    /// Mean distance of the joints from those of the model, hand lengths.
    pub(super) fn distance(
        &self,
        spheres: &[ProjectedSphere],
        state: &ModelState,
        seen: &JointPlaces,
    ) -> f64 {
        let hand = HAND_LENGTH * state.scale;
        let away = |(joint, to): (usize, &[f64; 2])| {
            let at = self.place(spheres, state, joint);
            (at[0] - to[0]).hypot(at[1] - to[1]) / hand
        };
        seen.iter().enumerate().map(away).sum::<f64>() / JOINTS as f64
    }

    /// Learns where the finder has the joints of the palm, from a hand that is about open.
    pub(super) fn learn(&mut self, spheres: &[ProjectedSphere], state: &ModelState, seen: &JointPlaces) {
        let t = self.tuning;
        self.learnt = (self.learnt + 1.0).min(t.offset_memory);
        // The prior, no offset, counts as so many frames.
        let prior = (t.deviation / t.offset).powi(2);
        let share = 1.0 / (self.learnt + prior);
        let hand = HAND_LENGTH * state.scale;
        for joint in OF_PALM {
            let at = self.place(spheres, state, joint);
            let off = [(seen[joint][0] - at[0]) / hand, (at[1] - seen[joint][1]) / hand];
            let residual = state.rotation.inverse() * Vector3::new(off[0], off[1], 0.0);
            for (k, offset) in self.offsets[joint].iter_mut().enumerate() {
                *offset += share * residual[k];
            }
        }
    }
}
