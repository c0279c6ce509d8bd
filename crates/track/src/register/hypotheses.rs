//! Hypotheses: other postures that might explain the silhouette as well.

use super::super::normal_equations::NormalEquations;
use super::super::state::{HAND_LENGTH, ModelState};
use super::geometry::in_plane;
use super::postures::PostureLibrary;
use super::solver::{Registered, Scene, Solver};
use handcast_hand::{Finger, FreeAngles};
use handcast_vision::tuning::tuning;

tuning! {
    /// Which hypotheses are tried besides the predicted state, and when.
    pub struct HypothesisTuning {
        /// How much more than the mean of the last frames one may cost before every hypothesis is tried on it.
        ["1", "spec/experiments.md, Speed: by 20 instead nothing changes"]
        pub unlikely_beyond: f64 = 100.0,
        /// Share of a new frame in that mean when it costs less.
        ["1", "chosen by eye"]
        pub mean_falls: f64 = 0.3,
        /// Share of a new frame in that mean when it costs more: wrong postures last, and must not become the mean
        /// soon.
        ["1", "chosen by eye"]
        pub mean_rises: f64 = 0.05,
        /// Predicted change of a joint angle from which on the last state is a hypothesis of its own.
        ["rad", "chosen by eye"]
        pub moving: f64 = 0.05,
        /// The thumb's MCP flexion beyond eq. (5) from which on it is tried across the palm.
        ["rad", "spec/registration.md 5, Hypotheses"]
        pub thumb_beyond: f64 = 0.4,
        /// Rounds in which the hand is moved as a whole before its fingers are tried in other postures.
        ["rounds", "spec/experiments.md, Firm priors"]
        pub rigid_rounds: usize = 2,
        /// Difference of every joint angle below which a finger's posture is the present one.
        ["rad", "chosen by eye"]
        pub same: f64 = 0.2,
        /// Gain of non-overlap rate for which a finger is put in another posture.
        ["1", "chosen by eye"]
        pub least_gain: f64 = 0.005,
        /// MCP and PIP flexion together from which on the end of a long finger may be before the palm, where outlines do
        /// not tell how far it is folded.
        ["rad", "chosen by eye"]
        pub folded_from: f64 = 0.9,
        /// How much more and less the PIP of such a finger is flexed in hypotheses.
        ["rad", "spec/registration.md 5, Hypotheses"]
        pub folded_by: f64 = 0.6,
        /// Cost that such a hypothesis must gain, and that it may cost more before any round.
        ["1", "spec/registration.md 5, Hypotheses"]
        pub folded_gain: f64 = 8.0,
        /// Flexion, abduction and IP flexion of the closed thumb.
        ["rad", "chosen by eye"]
        pub closed_thumb: [f64; 3] = [0.35, 0.7, 0.8],
        /// MCP and PIP flexion of a closed long finger.
        ["rad", "chosen by eye"]
        pub closed_finger: [f64; 2] = [1.4, 1.7],
        /// Share of the open hand's abduction that a closed finger has lost.
        ["1", "chosen by eye"]
        pub closed_adduction: f64 = 0.7,
        /// Steps from the open hand to the closed one.
        ["steps", "spec/registration.md 5, Hypotheses"]
        pub closing_steps: u32 = 5,
        /// How much more than that of the present state the non-overlap rate of a closing hand may be, before any round.
        ["1", "spec/experiments.md, Speed"]
        pub promising: f64 = 0.1,
        /// Difference of every joint angle, and of the tilt, within which a closing hand is reached by moving on.
        ["rad", "chosen by eye"]
        pub near: f64 = 0.15,
        /// Known postures, those with the most similar silhouettes, that are compared by cost.
        ["postures", "handcast bench track --no-methods on rendered sequences: 12 are no better and take 5 % longer"]
        pub known_compared: usize = 8,
        /// How many of these are refined.
        ["postures", "spec/registration.md 5, Hypotheses"]
        pub known_refined: usize = 2,
        /// Difference of a joint angle from which on a known posture is another one.
        ["rad", "chosen by eye"]
        pub known_differs: f64 = 0.35,
    }
}

/// What is kept from frame to frame.
#[derive(Clone, Debug, Default)]
pub(super) struct Hypotheses {
    /// Drawn at the first frame that asks for it.
    pub(super) library: Option<PostureLibrary>,
    /// Known postures to be tried, by cost.
    known: Vec<(f64, ModelState)>,
}

impl Hypotheses {
    /// Tries known postures whose silhouettes are like the present one, the hand facing the camera, in the image
    /// turned as it is or a little each way.
    pub(super) fn try_known(
        &mut self,
        solver: &mut Solver,
        scene: &mut Scene<'_>,
        state: &mut ModelState,
        best: &mut Registered,
    ) {
        let HypothesisTuning { known_compared, known_refined, known_differs, .. } = solver.tuning.hypotheses;
        if known_refined == 0 {
            return;
        }
        let tuning = &solver.tuning.postures;
        let facings = tuning.turned(&facing(scene, state));
        let mut known = std::mem::take(&mut self.known);
        known.clear();
        let library = self.library.get_or_insert_with(|| {
            PostureLibrary::new(tuning, scene.model, scene.prior.open, &solver.domain)
        });
        for (&(free, thumb_mcp), facing) in library.nearest(scene.evidence.window(), &facings, known_compared)
        {
            if largest_difference(&free, &state.free) > known_differs {
                known.push((0.0, ModelState { free, thumb_mcp, ..facing.clone() }));
            }
        }
        for (cost, hypothesis) in &mut known {
            *cost = solver.score(scene, hypothesis).cost;
        }
        known.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        for (_, hypothesis) in known.iter().take(known_refined) {
            solver.try_hypothesis(scene, hypothesis.clone(), state, best);
        }
        self.known = known;
    }
}

/// Largest difference of two postures' free angles, radians.
pub(in super::super) fn largest_difference(a: &FreeAngles, b: &FreeAngles) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// `state`, moved as a whole to the silhouette, with those fingers in other postures that overlap better there;
/// `None` when there are none. `first` are the normal equations around `state`.
pub(super) fn bent_fingers(
    solver: &mut Solver,
    scene: &mut Scene<'_>,
    state: &ModelState,
    first: &NormalEquations,
) -> Option<ModelState> {
    let mut bent = state.clone();
    for round in 0..solver.tuning.hypotheses.rigid_rounds {
        let mut equations =
            if round == 0 { first.clone() } else { solver.linearise(scene, &bent, 0.0, None) };
        equations.hold_angles();
        solver.step(&equations, scene.prior, &mut bent);
    }
    let mut rate = solver.objective.rate(scene.model, &bent, scene.evidence.window());
    let mut changed = false;
    for finger in Finger::ALL {
        if let Some(better) = best_posture(solver, scene, &bent, finger, &mut rate) {
            (bent, changed) = (better, true);
        }
    }
    changed.then_some(bent)
}

/// `state` with `finger` in that of its postures which overlaps best, if one is better than `rate`, the present
/// non-overlap rate, which it then replaces.
fn best_posture(
    solver: &mut Solver,
    scene: &mut Scene<'_>,
    state: &ModelState,
    finger: Finger,
    rate: &mut f64,
) -> Option<ModelState> {
    let HypothesisTuning { same, least_gain, .. } = solver.tuning.hypotheses;
    let window = scene.evidence.window();
    solver.objective.hold_rest(scene.model, state, finger, window);
    let mut better = None;
    for which in 0..solver.tuning.postures.count(finger) {
        let posture = solver.tuning.postures.posture(finger, which, &scene.prior.open.state.free);
        if posture.iter().zip(&state.free[finger.range()]).all(|(a, b)| (a - b).abs() < same) {
            continue;
        }
        let mut other = state.clone();
        other.free[finger.range()].copy_from_slice(&posture);
        if finger == Finger::Thumb {
            other.thumb_mcp = 0.0;
        }
        solver.bring_inside(scene.prior, &mut other);
        let found = solver.objective.rate_of_finger(scene.model, &other, finger, window);
        if found < *rate - if better.is_none() { least_gain } else { 0.0 } {
            (*rate, better) = (found, Some(other));
        }
    }
    better
}

/// Tries each long finger whose end may be before the palm folded more and less, and keeps what costs clearly less: a fast
/// finger's shading is not followed, and outlines are the same.
pub(super) fn try_folded(
    solver: &mut Solver,
    scene: &mut Scene<'_>,
    state: &mut ModelState,
    best: &mut Registered,
) {
    let HypothesisTuning { folded_from, folded_by, folded_gain, .. } = solver.tuning.hypotheses;
    for finger in Finger::LONG {
        let outer = finger.free_outer();
        for by in [folded_by, -folded_by] {
            if state.free[finger.free_base()] + state.free[outer] < folded_from {
                break;
            }
            let mut other = state.clone();
            other.free[outer] += by;
            solver.bring_inside(scene.prior, &mut other);
            let mut found = solver.score(scene, &other);
            if found.cost < best.cost + folded_gain {
                found = solver.refine(scene, &mut other, 0..solver.tuning.rounds.most, None);
                if found.cost < best.cost - folded_gain {
                    (*state, *best) = (other, found);
                }
            }
        }
    }
}

/// `state` with the thumb bent across the palm, where eq. (5) holds: a thumb that is not seen is not straight.
pub(super) fn bent_thumb(solver: &Solver, scene: &Scene<'_>, state: &ModelState) -> ModelState {
    let mut bent = ModelState { thumb_mcp: 0.0, ..state.clone() };
    let tuning = &solver.tuning.postures;
    let across = tuning.posture(Finger::Thumb, tuning.count(Finger::Thumb) - 1, &state.free);
    bent.free[Finger::Thumb.range()].copy_from_slice(&across);
    solver.bring_inside(scene.prior, &mut bent);
    bent
}

/// The best of the hands that face the camera as the open one did, with all four long fingers closed
/// by the same share, the thumb with them or not, if it is promising: when they close together, one finger at
/// a time gains little. `present` is the non-overlap rate of `state`.
pub(super) fn closing_hand(
    solver: &mut Solver,
    scene: &mut Scene<'_>,
    state: &ModelState,
    present: f64,
) -> Option<ModelState> {
    let t = solver.tuning.hypotheses;
    let open = &scene.prior.open.state;
    let facing = facing(scene, state);
    let tilt = facing.rotation.angle_to(&state.rotation);
    let mut best = (present + t.promising, None);
    for (step, with_thumb) in (0..=t.closing_steps).flat_map(|p| [(p, false), (p, true)]) {
        let share = f64::from(step) / f64::from(t.closing_steps);
        let mut closing = facing.clone();
        if with_thumb {
            for (v, closed) in closing.free[Finger::Thumb.range()].iter_mut().zip(t.closed_thumb) {
                *v = share * closed;
            }
            closing.thumb_mcp = 0.0;
        }
        for finger in Finger::LONG {
            let abduction = finger.free_abduction();
            closing.free[finger.free_base()] = share * t.closed_finger[0];
            closing.free[abduction] = (1.0 - t.closed_adduction * share) * open.free[abduction];
            closing.free[finger.free_outer()] = share * t.closed_finger[1];
        }
        solver.bring_inside(scene.prior, &mut closing);
        let moved = largest_difference(&closing.free, &state.free).max(tilt);
        let rate = solver.objective.rate(scene.model, &closing, scene.evidence.window());
        if rate < best.0 && moved > t.near {
            best = (rate, Some(closing));
        }
    }
    best.1
}

/// The hand of `state` turned to face the camera as the open one did, its wrist as far from the cut.
fn facing(scene: &Scene<'_>, state: &ModelState) -> ModelState {
    let open = &scene.prior.open.state;
    let relative = state.rotation * open.rotation.inverse();
    let rotation = in_plane(&relative) * open.rotation;
    let mut facing = ModelState { rotation, ..state.clone() };
    if let (Some(now), Some(then)) = (scene.evidence.window().forearm(), scene.prior.open.behind) {
        let along = (then - now.behind(&facing)) * HAND_LENGTH * facing.scale;
        facing.wrist = [facing.wrist[0] + along * now.axis[0], facing.wrist[1] + along * now.axis[1]];
    }
    facing
}
