//! Registration of the model on one silhouette: the downhill simplex under biomechanical constraints,
//! in hierarchical order (paper 6.3, 6.4.4, 6.5).

use nalgebra::{UnitQuaternion, Vector3};

use super::model::{HandModel, ModelState};
use super::objective::{Forearm, NonOverlap, Window};
use super::simplex::Downhill;
use crate::hand::{Domain, Finger};
use crate::vision::Mask;

/// How registration searches.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct RegistrationOptions {
    /// Rounds of global and finger-by-finger minimisation.
    pub rounds: usize,
    /// Evaluations allowed to one minimisation of the global parameters.
    pub global_evaluations: usize,
    /// Evaluations allowed to one minimisation of a finger.
    pub finger_evaluations: usize,
    /// A non-overlap rate above this is a poor optimum: start again from larger simplices (6.4.3).
    pub poor_rate: f64,
    /// A non-overlap rate above this is doubtful: postures are tried that are not near the last one.
    pub doubtful_rate: f64,
    /// Cost of a joint being 1 rad away from where it was in the last frame. Where the silhouette says
    /// nothing (a finger in front of the palm) this and `rest_weight` decide.
    pub motion_weight: f64,
    /// Cost of a joint being 1 rad away from a relaxed posture.
    pub rest_weight: f64,
    /// Cost of the wrist being one hand length nearer to the forearm's cut, or farther from it, than in
    /// the open hand. A fist on a forearm looks much like a stretched hand farther down.
    pub wrist_weight: f64,
    /// Cost of the scale changing by a factor e between frames.
    pub scale_weight: f64,
    /// Cost of the scale being a factor e away from that of the open hand.
    pub size_weight: f64,
    /// Cost of 1 rad of rotation out of the image plane, which a silhouette shows poorly.
    pub tilt_weight: f64,
}

impl Default for RegistrationOptions {
    fn default() -> Self {
        Self {
            rounds: 2,
            global_evaluations: 120,
            finger_evaluations: 70,
            poor_rate: 0.08,
            doubtful_rate: 0.04,
            motion_weight: 0.002,
            rest_weight: 0.002,
            wrist_weight: 1.5,
            scale_weight: 0.5,
            size_weight: 0.05,
            tilt_weight: 0.040,
        }
    }
}

/// The open hand: the posture to which others are compared.
#[derive(Clone, Debug, PartialEq)]
pub struct OpenState {
    /// Its state.
    pub state: ModelState,
    /// Where its silhouette was cut from the forearm.
    pub forearm: Option<Forearm>,
}

/// The outcome for one silhouette.
#[derive(Clone, Debug)]
pub struct Registered {
    /// The best state found.
    pub state: ModelState,
    /// Non-overlap rate there (eq. 7).
    pub rate: f64,
    /// Intersection over union there.
    pub iou: f64,
    /// Evaluations of the functional.
    pub evaluations: usize,
    /// Whether the search was started again from larger simplices.
    pub restarted: bool,
}

/// A model with everything needed to register it on silhouettes.
#[derive(Clone, Debug)]
pub struct Registration {
    model: HandModel,
    options: RegistrationOptions,
    domain: Domain,
    objective: NonOverlap,
    downhill: Downhill,
}

/// Simplex edges (eq. 9): wrist as a fraction of the hand in pixels, log scale, rotations and angles in rad.
const WRIST_STEP: f64 = 0.04;
const SCALE_STEP: f64 = 0.03;
const TURN_STEP: f64 = 0.08;
const TILT_STEP: f64 = 0.15;
const ANGLE_STEP: f64 = 0.25;

impl Registration {
    /// A registration of `model`.
    pub fn new(model: HandModel, options: RegistrationOptions) -> Self {
        let downhill = Downhill::new(2e-3, 200);
        Self { model, options, domain: Domain::free(), objective: NonOverlap::default(), downhill }
    }

    /// The model.
    pub fn model(&self) -> &HandModel {
        &self.model
    }

    /// The model, to draw it.
    pub fn model_mut(&mut self) -> &mut HandModel {
        &mut self.model
    }

    /// Registers the model on `silhouette`, cut from its forearm at `forearm`, starting from `start`;
    /// `rest` is the open hand, with the cut of its forearm. `None` when the silhouette is empty.
    pub fn register(
        &mut self,
        silhouette: &Mask,
        forearm: Option<Forearm>,
        start: &ModelState,
        rest: &OpenState,
    ) -> Option<Registered> {
        let window = Window::around(silhouette, forearm, 0.35)?;
        let before = self.objective.evaluations();
        let mut state = start.clone();
        // Eq. 7 is flat where nothing overlaps: bring the centroids together first (6.2.1).
        if self.objective.rate(&mut self.model, &state, &window) > 0.6 {
            let model = self.centroid_of(&state, silhouette);
            let image = silhouette.centroid().unwrap_or(model);
            state.wrist = [state.wrist[0] + image.0 - model.0, state.wrist[1] + image.1 - model.1];
        }
        let prior =
            Prior { start: state.clone(), rest: rest.clone(), forearm, options: self.options.clone() };
        let mut spread = 1.0;
        let mut cost = self.search(&mut state, &window, &prior, spread);
        if self.objective.rate(&mut self.model, &state, &window) > self.options.doubtful_rate {
            let mut closing = self.closing(&state, &window, &prior);
            // The jump itself is not held against it.
            let jumped = Prior { start: closing.clone(), ..prior.clone() };
            let other = self.search(&mut closing, &window, &jumped, spread);
            if other + JUMP < cost - prior.motion(&state) {
                (state, cost) = (closing, other);
            }
        }
        let mut rate = self.objective.rate(&mut self.model, &state, &window);
        let restarted = rate > self.options.poor_rate;
        if restarted {
            spread = 2.5;
            let mut again = state.clone();
            let other = self.search(&mut again, &window, &prior, spread);
            if other < cost {
                (state, cost) = (again, other);
            }
            debug_assert!(cost.is_finite());
            rate = self.objective.rate(&mut self.model, &state, &window);
        }
        Some(Registered {
            iou: self.objective.last_iou(&window),
            rate,
            evaluations: self.objective.evaluations() - before,
            restarted,
            state,
        })
    }

    /// The centroid of the model's silhouette in an image of the size of `like`; the wrist when none of
    /// it is in the image.
    pub fn centroid_of(&mut self, state: &ModelState, like: &Mask) -> (f64, f64) {
        let mut drawn = Mask::new(like.width(), like.height());
        self.model.draw(state, [0.0, 0.0], &mut drawn);
        drawn.centroid().unwrap_or((state.wrist[0], state.wrist[1]))
    }

    /// The best start among hands that face the camera as the open one did, with all four fingers closed
    /// by the same share: when they close together, one finger at a time gains little, and tilting the
    /// hand gains more.
    fn closing(&mut self, state: &ModelState, window: &Window, prior: &Prior) -> ModelState {
        let Self { model, objective, domain, .. } = self;
        let open = &prior.rest.state;
        let relative = state.rotation * open.rotation.inverse();
        let turn = 2.0 * relative.k.atan2(relative.w);
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn) * open.rotation;
        let mut start = ModelState { scale: open.scale, rotation, ..state.clone() };
        if let (Some(now), Some(then)) = (&prior.forearm, &prior.rest.forearm) {
            let along = (then.behind(open) - now.behind(&start)) * 0.19 * start.scale;
            start.wrist = [start.wrist[0] + along * now.axis[0], start.wrist[1] + along * now.axis[1]];
        }
        let mut best = (f64::INFINITY, start.clone());
        for share in [0.0, 0.25, 0.5, 0.75, 1.0] {
            let mut s = start.clone();
            for finger in Finger::LONG {
                let first = 3 * finger as usize;
                s.free[first] = share * f64::to_radians(80.0);
                s.free[first + 2] = share * f64::to_radians(98.0);
                s.free[first + 1] = (1.0 - 0.7 * share) * open.free[first + 1];
            }
            let inside = domain.clip_segment(&open.free, &s.free);
            for (v, from) in s.free.iter_mut().zip(&open.free) {
                *v = from + inside * (*v - from);
            }
            let value = objective.rate(model, &s, window) + prior.cost(&s) - prior.motion(&s);
            if value < best.0 {
                best = (value, s);
            }
        }
        best.1
    }

    /// Global position, then scale and rotation, then each finger; twice by default.
    fn search(&mut self, state: &mut ModelState, window: &Window, prior: &Prior, spread: f64) -> f64 {
        let mut cost = f64::INFINITY;
        for round in 0..self.options.rounds {
            if round == 0 {
                self.minimise_global(state, window, prior, spread, false);
            }
            self.minimise_global(state, window, prior, spread / (1 + round) as f64, true);
            for finger in Finger::ALL {
                cost = self.minimise_finger(state, finger, window, prior, spread / (1 + round) as f64);
            }
        }
        cost
    }

    /// Translation and rotation in the image plane, or with `all` scale and tilts too.
    fn minimise_global(
        &mut self,
        state: &mut ModelState,
        window: &Window,
        prior: &Prior,
        spread: f64,
        all: bool,
    ) {
        let Self { model, objective, downhill, options, .. } = self;
        let origin = state.clone();
        let hand = 0.19 * origin.scale;
        let at = |p: &[f64]| {
            let mut s = origin.clone();
            s.wrist = [origin.wrist[0] + hand * p[0], origin.wrist[1] + hand * p[1]];
            let tilt = if all { [p[4], p[5]] } else { [0.0, 0.0] };
            s.rotation = origin.turned([tilt[0], tilt[1], p[2]]);
            if all {
                s.scale = origin.scale * p[3].exp();
            }
            s
        };
        let steps = [WRIST_STEP, WRIST_STEP, TURN_STEP, SCALE_STEP, TILT_STEP, TILT_STEP].map(|v| v * spread);
        let n = if all { 6 } else { 3 };
        let mut p = [0.0; 6];
        downhill.max_evaluations =
            if all { options.global_evaluations } else { options.global_evaluations / 2 };
        downhill.minimise(
            &mut p[..n],
            &steps[..n],
            |_, _| 1.0,
            |p| {
                let s = at(p);
                objective.rate(model, &s, window) + prior.cost(&s)
            },
        );
        *state = at(&p);
    }

    /// The three free angles of one finger, from where they are and from a few typical postures.
    fn minimise_finger(
        &mut self,
        state: &mut ModelState,
        finger: Finger,
        window: &Window,
        prior: &Prior,
        spread: f64,
    ) -> f64 {
        let Self { model, objective, downhill, options, domain, .. } = self;
        objective.hold_rest(model, state, finger, window);
        let first = 3 * finger as usize;
        let mut trial = state.clone();
        let mut scratch = state.free;
        let free = state.free;
        let mut cost = |p: &[f64]| {
            trial.free[first..first + 3].copy_from_slice(p);
            objective.rate_of_finger(model, &trial, finger, window) + prior.cost(&trial)
        };
        let mut target = free;
        let mut inside = |from: &[f64], to: &[f64]| {
            scratch[first..first + 3].copy_from_slice(from);
            target[first..first + 3].copy_from_slice(to);
            domain.clip_segment(&scratch, &target)
        };
        let current = [free[first], free[first + 1], free[first + 2]];
        let mut starts = [(0.0, current); 1 + POSTURES];
        starts[0].0 = cost(&current);
        let rest = [
            prior.rest.state.free[first],
            prior.rest.state.free[first + 1],
            prior.rest.state.free[first + 2],
        ];
        for (start, posture) in starts[1..].iter_mut().zip(postures(finger, &current, &rest)) {
            let t = inside(&current, &posture);
            let p = std::array::from_fn(|i| current[i] + t * (posture[i] - current[i]));
            *start = (cost(&p), p);
        }
        // The posture of the last frame always gets its chance, and the best of the others.
        starts[1..].sort_by(|a, b| a.0.total_cmp(&b.0));
        downhill.max_evaluations = options.finger_evaluations;
        let steps = [ANGLE_STEP * spread, 0.5 * ANGLE_STEP * spread, ANGLE_STEP * spread];
        let mut best = (f64::INFINITY, current);
        for (_, start) in &starts[..2] {
            let mut p = *start;
            let (value, _) = downhill.minimise(&mut p, &steps, &mut inside, &mut cost);
            if value < best.0 {
                best = (value, p);
            }
        }
        state.free[first..first + 3].copy_from_slice(&best.1);
        best.0
    }
}

const POSTURES: usize = 6;

/// Starts in the basins that a finger crosses while it closes: as in the open hand, stretched, half
/// closed, closed, and the first two with the present abduction (long fingers) or bent (thumb).
fn postures(finger: Finger, current: &[f64; 3], rest: &[f64; 3]) -> [[f64; 3]; POSTURES] {
    let d = f64::to_radians;
    match finger {
        Finger::Thumb => [
            *rest,
            [d(0.0), d(0.0), d(5.0)],
            [d(15.0), d(20.0), d(15.0)],
            [d(35.0), d(20.0), d(30.0)],
            [d(50.0), d(45.0), d(50.0)],
            [d(20.0), d(50.0), d(20.0)],
        ],
        _ => {
            let (now, open) = (current[1], rest[1]);
            [
                *rest,
                [d(5.0), now, d(8.0)],
                [d(35.0), now, d(55.0)],
                [d(20.0), 0.7 * open, d(40.0)],
                [d(50.0), 0.5 * open, d(75.0)],
                [d(75.0), 0.3 * open, d(95.0)],
            ]
        }
    }
}

/// How much better a posture must be that is not reached by moving on from the last one.
const JUMP: f64 = 0.004;

/// What is believed before looking: postures change little between frames and tend to the relaxed.
#[derive(Clone)]
struct Prior {
    start: ModelState,
    rest: OpenState,
    forearm: Option<Forearm>,
    options: RegistrationOptions,
}

impl Prior {
    /// The part of the cost that is for moving since the last frame.
    fn motion(&self, state: &ModelState) -> f64 {
        let moved: f64 = state.free.iter().zip(&self.start.free).map(|(a, b)| (a - b) * (a - b)).sum();
        let grown = (state.scale / self.start.scale).ln();
        self.options.motion_weight * moved + self.options.scale_weight * grown * grown
    }

    fn cost(&self, state: &ModelState) -> f64 {
        let o = &self.options;
        let mut cost = self.motion(state);
        for finger in Finger::ALL {
            let abduction = 3 * finger as usize + 1;
            let off = state.free[abduction] - self.rest.state.free[abduction];
            cost += o.rest_weight * off * off;
        }
        for finger in Finger::LONG {
            // Knuckle and middle joint bend together when nothing says otherwise.
            let first = 3 * finger as usize;
            let uneven = 0.8 * state.free[first + 2] - state.free[first];
            cost += 0.5 * o.rest_weight * uneven * uneven;
        }
        let tilt = (state.rotation * self.rest.state.rotation.inverse()).scaled_axis();
        if let (Some(now), Some(open)) = (&self.forearm, &self.rest.forearm) {
            let off = now.behind(state) - open.behind(&self.rest.state);
            cost += o.wrist_weight * off * off;
        }
        let size = (state.scale / self.rest.state.scale).ln();
        cost += o.size_weight * size * size;
        cost + o.tilt_weight * (tilt.x * tilt.x + tilt.y * tilt.y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::{Morphology, Side};

    fn open() -> ModelState {
        let mut free = [0.0; 15];
        for (finger, degrees) in Finger::LONG.into_iter().zip([10.0f64, 0.0, 8.0, 18.0]) {
            free[3 * finger as usize + 1] = degrees.to_radians();
        }
        ModelState { wrist: [160.0, 210.0], scale: 900.0, rotation: UnitQuaternion::identity(), free }
    }

    fn rest() -> OpenState {
        OpenState { state: open(), forearm: None }
    }

    fn silhouette(model: &mut HandModel, state: &ModelState) -> Mask {
        let mut mask = Mask::new(320, 240);
        model.draw(state, [0.0, 0.0], &mut mask);
        mask
    }

    /// Tracks a motion of the true state from `open()` in steps and returns the last registration and truth.
    fn follow(frames: usize, motion: impl Fn(f64, &mut ModelState)) -> (Registered, ModelState) {
        let morphology = Morphology::default();
        let mut registration =
            Registration::new(HandModel::new(&morphology, Side::Right), RegistrationOptions::default());
        let mut model = HandModel::new(&morphology, Side::Right);
        let mut last = None;
        let mut start = open();
        for i in 1..=frames {
            let mut truth = open();
            motion(i as f64 / frames as f64, &mut truth);
            let image = silhouette(&mut model, &truth);
            let found = registration.register(&image, None, &start, &rest()).unwrap();
            assert!(Domain::free().is_feasible(&found.state.free, 1e-9));
            start = found.state.clone();
            last = Some((found, truth));
        }
        last.unwrap()
    }

    #[test]
    fn follows_translation_and_rotation() {
        let (found, truth) = follow(6, |t, s| {
            s.wrist[0] += 25.0 * t;
            s.rotation = UnitQuaternion::from_euler_angles(0.0, 0.0, 0.3 * t);
        });
        assert!(found.iou > 0.95, "{}", found.iou);
        assert!((found.state.wrist[0] - truth.wrist[0]).abs() < 3.0);
        assert!(found.state.rotation.angle_to(&truth.rotation) < 0.06);
    }

    #[test]
    fn follows_the_flexion_of_each_finger() {
        for finger in [Finger::Index, Finger::Middle, Finger::Ring] {
            let first = 3 * finger as usize;
            let (found, truth) = follow(8, |t, s| {
                s.free[first] = 0.9 * t;
                s.free[first + 2] = 1.0 * t;
                // Eq. (4): the middle finger comes along.
                let middle = &mut s.free[3 * Finger::Middle as usize];
                *middle = middle.max(0.5 * t);
            });
            assert!(found.iou > 0.93, "{} {}", finger.name(), found.iou);
            let bend = |s: &ModelState| s.free[first] + s.free[first + 2];
            println!("{} {} {}", finger.name(), bend(&found.state), bend(&truth));
            assert!((bend(&found.state) - bend(&truth)).abs() < 0.45, "{}", finger.name());
        }
    }

    #[test]
    fn an_empty_silhouette_is_not_registered() {
        let mut registration = Registration::new(
            HandModel::new(&Morphology::default(), Side::Right),
            RegistrationOptions::default(),
        );
        assert!(registration.register(&Mask::new(320, 240), None, &open(), &rest()).is_none());
    }
}
