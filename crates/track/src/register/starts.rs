//! Other postures that might explain the silhouette as well.

use super::super::model::ModelState;
use super::postures::{self, Postures};
use super::{HAND, Quadratic, Registered, Registration, Scene, in_plane};
use handcast_hand::Finger;

/// Rounds in which the hand is moved as a whole before its fingers are tried elsewhere.
const RIGID_ROUNDS: usize = 2;
/// Difference of every joint angle below which a posture is the present one, radians.
const SAME: f64 = 0.2;
/// Gain of non-overlap rate for which a finger is put elsewhere.
const LEAST_GAIN: f64 = 0.005;
/// Flexion, abduction and PIP or IP flexion of the closed thumb and of a closed finger, radians.
const CLOSED: [[f64; 3]; 2] = [[0.35, 0.7, 0.8], [1.4, 0.0, 1.7]];
/// Postures that are tried between open and closed.
const POSTURES: u32 = 5;
/// Difference of every joint angle, or of the tilt, within which a hand is reached by moving on, radians.
const NEAR: f64 = 0.15;
/// Difference of a joint angle from which on a known posture is another one, radians.
const OTHER: f64 = 0.35;

impl Registration {
    /// `state`, moved as a whole to the silhouette, with those fingers in other postures that overlap better there;
    /// `None` when there are none. `around` is the quadratic of the first round.
    pub(super) fn bent(
        &mut self,
        scene: &mut Scene<'_>,
        state: &ModelState,
        around: &Quadratic,
    ) -> Option<ModelState> {
        let mut bent = state.clone();
        for round in 0..RIGID_ROUNDS {
            let mut quadratic =
                if round == 0 { around.clone() } else { self.linearise(scene, &bent, 0.0, None) };
            quadratic.hold_fingers();
            self.step(&quadratic, scene.belief, &mut bent);
        }
        let window = scene.evidence.window();
        let mut rate = self.objective.rate(scene.model, &bent, window);
        let mut changed = false;
        for finger in Finger::ALL {
            self.objective.hold_rest(scene.model, &bent, finger, window);
            let first = 3 * finger as usize;
            let mut better = None;
            for which in 0..postures::count(finger) {
                let posture = postures::posture(finger, which, &scene.belief.open.state.free);
                if posture.iter().zip(&bent.free[first..]).all(|(a, b)| (a - b).abs() < SAME) {
                    continue;
                }
                let mut other = bent.clone();
                other.free[first..first + 3].copy_from_slice(&posture);
                if finger == Finger::Thumb {
                    other.thumb_mcp = 0.0;
                }
                self.bring_inside(scene.belief, &mut other);
                let found = self.objective.rate_of_finger(scene.model, &other, finger, window);
                if found < rate - if better.is_none() { LEAST_GAIN } else { 0.0 } {
                    (rate, better) = (found, Some(other));
                }
            }
            if let Some(better) = better {
                (bent, changed) = (better, true);
            }
        }
        changed.then_some(bent)
    }

    /// `state` with the thumb bent across the palm, where eq. (5) holds: a thumb that is not seen is not straight.
    pub(super) fn bent_thumb(&self, scene: &Scene<'_>, state: &ModelState) -> ModelState {
        let mut bent = ModelState { thumb_mcp: 0.0, ..state.clone() };
        let across = postures::count(Finger::Thumb) - 1;
        bent.free[..3].copy_from_slice(&postures::posture(Finger::Thumb, across, &state.free));
        self.bring_inside(scene.belief, &mut bent);
        bent
    }

    /// The best start among hands that face the camera as the open one did, with all four long fingers closed
    /// by the same share, the thumb with them or not, if it is promising: when they close together, one finger at
    /// a time gains little.
    pub(super) fn closing(
        &mut self,
        scene: &mut Scene<'_>,
        state: &ModelState,
        present: f64,
    ) -> Option<ModelState> {
        let open = &scene.belief.open.state;
        let start = facing(scene, state);
        let tilt = start.rotation.angle_to(&state.rotation);
        let mut best = (present + 2.0 * self.options.promising, None);
        for (posture, with_thumb) in (0..=POSTURES).flat_map(|p| [(p, false), (p, true)]) {
            let share = f64::from(posture) / f64::from(POSTURES);
            let mut s = start.clone();
            if with_thumb {
                for (v, closed) in s.free.iter_mut().zip(CLOSED[0]) {
                    *v = share * closed;
                }
                s.thumb_mcp = 0.0;
            }
            for finger in Finger::LONG {
                let first = 3 * finger as usize;
                s.free[first] = share * CLOSED[1][0];
                s.free[first + 1] = (1.0 - 0.7 * share) * open.free[first + 1];
                s.free[first + 2] = share * CLOSED[1][2];
            }
            self.bring_inside(scene.belief, &mut s);
            let moved = s.free.iter().zip(&state.free).map(|(a, b)| (a - b).abs()).fold(tilt, f64::max);
            let rate = self.objective.rate(scene.model, &s, scene.evidence.window());
            if rate < best.0 && moved > NEAR {
                best = (rate, Some(s));
            }
        }
        best.1
    }

    /// Starts from known postures whose silhouettes are like the present one, the hand facing the camera, in the image
    /// turned as it is or a little each way.
    pub(super) fn try_known_postures(
        &mut self,
        scene: &mut Scene<'_>,
        state: &mut ModelState,
        best: &mut Registered,
    ) {
        let [compared, refined] = self.options.known;
        if refined == 0 {
            return;
        }
        let facings = postures::turned(&facing(scene, state));
        let mut starts = std::mem::take(&mut self.starts);
        starts.clear();
        let postures =
            self.postures.get_or_insert_with(|| Postures::new(scene.model, scene.belief.open, &self.domain));
        for (&(free, thumb_mcp), facing) in postures.nearest(scene.evidence.window(), &facings, compared) {
            if free.iter().zip(&state.free).any(|(a, b)| (a - b).abs() > OTHER) {
                starts.push((0.0, ModelState { free, thumb_mcp, ..facing.clone() }));
            }
        }
        for (cost, start) in &mut starts {
            *cost = self.judge(scene, start).cost;
        }
        starts.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        for (_, start) in starts.iter().take(refined) {
            self.start_from(scene, start.clone(), state, best);
        }
        self.starts = starts;
    }
}

/// The hand of `state` turned to face the camera as the open one did, its wrist as far from the cut.
fn facing(scene: &Scene<'_>, state: &ModelState) -> ModelState {
    let open = &scene.belief.open.state;
    let relative = state.rotation * open.rotation.inverse();
    let rotation = in_plane(&relative) * open.rotation;
    let mut start = ModelState { rotation, ..state.clone() };
    if let (Some(now), Some(then)) = (scene.evidence.window().forearm(), &scene.belief.open.forearm) {
        let along = (then.behind(open) - now.behind(&start)) * HAND * start.scale;
        start.wrist = [start.wrist[0] + along * now.axis[0], start.wrist[1] + along * now.axis[1]];
    }
    start
}
