//! Frame-to-frame tracking: each registration starts where the last one ended (paper 6.4.2).

use super::fit::Fit;
use super::model::{Camera, HandModel, ModelState};
use super::objective::Forearm;
use super::register::{OpenState, Registration, RegistrationOptions};
use crate::vision::Mask;

/// Intersection over union below which a hand counts as lost, unless the options say otherwise.
pub const LOST_IOU: f64 = 0.60;

/// When a hand counts as lost.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct TrackerOptions {
    /// The search of each frame.
    pub registration: RegistrationOptions,
    /// Intersection over union below which the hand is lost in that frame.
    pub lost_iou: f64,
    /// The camera, for perspective; without, the projection is orthographic.
    pub camera: Option<Camera>,
}

impl Default for TrackerOptions {
    fn default() -> Self {
        Self { registration: RegistrationOptions::default(), lost_iou: LOST_IOU, camera: None }
    }
}

/// What the tracker says of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackedState {
    /// The state found; of a lost frame the last good one.
    pub state: ModelState,
    /// Intersection over union of model and silhouette, 0 when there was no silhouette.
    pub iou: f64,
    /// Whether the hand was found.
    pub valid: bool,
    /// Evaluations of the functional.
    pub evaluations: usize,
    /// Whether registration started again from larger simplices.
    pub restarted: bool,
}

/// Follows one hand from silhouette to silhouette.
#[derive(Clone, Debug)]
pub struct Tracker {
    registration: Registration,
    lost_iou: f64,
    open: OpenState,
    last: ModelState,
    lost: usize,
}

impl Tracker {
    /// A tracker of the fitted hand, which starts from where the fit found it.
    pub fn new(fit: &Fit, options: TrackerOptions) -> Self {
        let mut model = HandModel::new(&fit.morphology, fit.side);
        if let Some(camera) = options.camera {
            model = model.with_camera(camera);
        }
        Self {
            registration: Registration::new(model, options.registration),
            lost_iou: options.lost_iou,
            open: OpenState { state: fit.state.clone(), forearm: fit.forearm },
            last: fit.state.clone(),
            lost: 0,
        }
    }

    /// Goes back to the open hand of the fit, to track again from there in the other direction of time.
    pub fn rewind(&mut self) {
        self.last = self.open.state.clone();
        self.lost = 0;
    }

    /// The model that is being registered.
    pub fn model_mut(&mut self) -> &mut HandModel {
        self.registration.model_mut()
    }

    /// Registers the model on the next silhouette, cut from its forearm at `forearm`.
    ///
    /// While the hand is lost every frame is tried from the last good posture and from the open hand,
    /// both brought to the silhouette's centroid, so that tracking resumes when the hand comes back.
    pub fn track(&mut self, silhouette: &Mask, forearm: Option<Forearm>) -> TrackedState {
        let mut best = self.registration.register(silhouette, forearm, &self.last, &self.open);
        let lost_now = best.as_ref().is_none_or(|b| b.iou < self.lost_iou);
        if lost_now && best.is_some() {
            let mut evaluations = best.as_ref().map_or(0, |b| b.evaluations);
            for start in [&self.open.state, &self.last] {
                let mut start = start.clone();
                if let Some((x, y)) = silhouette.centroid() {
                    let (mx, my) = self.registration.centroid_of(&start, silhouette);
                    start.wrist = [start.wrist[0] + x - mx, start.wrist[1] + y - my];
                }
                if let Some(found) = self.registration.register(silhouette, forearm, &start, &self.open) {
                    evaluations += found.evaluations;
                    if best.as_ref().is_none_or(|b| found.rate < b.rate) {
                        best = Some(found);
                    }
                }
            }
            if let Some(best) = &mut best {
                best.evaluations = evaluations;
            }
        }
        match best {
            Some(found) if found.iou >= self.lost_iou => {
                self.lost = 0;
                self.last = found.state.clone();
                TrackedState {
                    state: found.state,
                    iou: found.iou,
                    valid: true,
                    evaluations: found.evaluations,
                    restarted: found.restarted,
                }
            }
            other => {
                self.lost += 1;
                TrackedState {
                    state: self.last.clone(),
                    iou: other.as_ref().map_or(0.0, |f| f.iou),
                    valid: false,
                    evaluations: other.as_ref().map_or(0, |f| f.evaluations),
                    restarted: other.is_some_and(|f| f.restarted),
                }
            }
        }
    }

    /// Frames since the hand was lost; 0 while it is tracked.
    pub fn frames_lost(&self) -> usize {
        self.lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::{Finger, Morphology, Side};
    use nalgebra::UnitQuaternion;

    fn fit() -> Fit {
        let mut free = [0.0; 15];
        for (finger, degrees) in Finger::LONG.into_iter().zip([10.0f64, 0.0, 8.0, 18.0]) {
            free[3 * finger as usize + 1] = degrees.to_radians();
        }
        Fit {
            morphology: Morphology::default(),
            side: Side::Right,
            state: ModelState {
                wrist: [160.0, 210.0],
                scale: 800.0,
                rotation: UnitQuaternion::identity(),
                free,
            },
            forearm: None,
            iou: 1.0,
            evaluations: 0,
        }
    }

    #[test]
    fn loss_is_reported_and_the_hand_found_again_elsewhere() {
        let fit = fit();
        let mut model = HandModel::new(&fit.morphology, fit.side);
        let mut draw = |dx: f64| {
            let mut state = fit.state.clone();
            state.wrist[0] += dx;
            let mut mask = Mask::new(400, 240);
            model.draw(&state, [0.0, 0.0], &mut mask);
            mask
        };
        let mut tracker = Tracker::new(&fit, TrackerOptions::default());
        assert!(tracker.track(&draw(2.0), None).valid);
        for _ in 0..3 {
            assert!(!tracker.track(&Mask::new(400, 240), None).valid);
        }
        let bar = Mask::from_fn(400, 240, |x, y| (100..300).contains(&x) && (100..104).contains(&y));
        assert!(!tracker.track(&bar, None).valid);
        assert_eq!(tracker.frames_lost(), 4);
        let back = tracker.track(&draw(90.0), None);
        assert!(back.valid && back.iou > 0.9, "{back:?}");
        assert!((back.state.wrist[0] - 250.0).abs() < 4.0);
        assert_eq!(tracker.frames_lost(), 0);
    }
}
