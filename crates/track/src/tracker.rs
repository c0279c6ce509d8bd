//! Frame-to-frame tracking: each registration starts where the motion of the picture leads (paper 7), or without
//! one that of the last frames (6.4.2).

use image::RgbImage;
use nalgebra::{UnitQuaternion, Vector3};

use super::evidence::{Evidence, SizeMismatch};
use super::fit::{Fit, View};
use super::model::{Camera, HandModel, ModelState};
use super::objective::Forearm;
use super::register::{Belief, OpenState, Registered, Registration, RegistrationOptions};
use handcast_hand::{Domain, Morphology, Side};
use handcast_vision::Mask;

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
    /// Whether registration started again, from the open hand and from the last posture elsewhere.
    pub restarted: bool,
}

/// Follows one hand from frame to frame.
#[derive(Clone, Debug)]
pub struct HandTracker {
    registration: Registration,
    /// The model in the image, to be drawn.
    model: HandModel,
    /// The model in the reduced image, to be registered.
    small: HandModel,
    /// How many times smaller the reduced image is.
    factor: u32,
    evidence: Evidence,
    domain: Domain,
    lost_iou: f64,
    /// The open hand; like all states kept here, in the reduced image.
    open: OpenState,
    /// The last state, and the one before it when both frames were tracked.
    last: ModelState,
    before: Option<ModelState>,
    lost: usize,
}

/// Intersection over union below which other starts are tried.
const DOUBTFUL_IOU: f64 = 0.80;
/// Longest hand in the images in which it is registered, pixels.
const LONGEST: f64 = 150.0;
/// Distance of a hand from the camera where nothing tells it, metres.
const USUAL_DISTANCE: f64 = 0.5;
/// Share of the motion between the last two frames that is expected to go on.
const PERSISTENCE: f64 = 0.8;

impl HandTracker {
    /// A tracker of the fitted hand, which starts from where the fit found it.
    pub fn new(fit: &Fit, options: TrackerOptions) -> Self {
        let mut model = HandModel::new(&fit.morphology, fit.side);
        if let Some(camera) = options.camera {
            model = model.with_camera(camera);
        }
        let hand = fit.state.scale * fit.morphology.hand_length;
        let factor = if options.camera.is_some() { (hand / LONGEST).ceil().max(1.0) as u32 } else { 1 };
        let small = match options.camera {
            Some(camera) => model.clone().with_camera(camera.reduced(factor)),
            None => model.clone(),
        };
        let open = fit.state.reduced(factor.into());
        let forearm = fit.forearm.map(|f| f.reduced(factor));
        Self {
            registration: Registration::new(options.registration),
            model,
            small,
            factor,
            evidence: Evidence::default(),
            domain: Domain::free(),
            lost_iou: options.lost_iou,
            last: open.clone(),
            open: OpenState { state: open, forearm },
            before: None,
            lost: 0,
        }
    }

    /// A tracker of a hand of these sizes that has not been seen open: it begins as if the hand were lost, half
    /// a metre from the camera, and finds its posture among the known ones.
    pub fn without_fit(morphology: &Morphology, side: Side, view: View, options: TrackerOptions) -> Self {
        let (wrist, focal) = options.camera.map_or(([160.0, 120.0], 280.0), |c| {
            ([0.5 * f64::from(c.width), 0.75 * f64::from(c.height)], c.focal)
        });
        let facing = match view {
            View::Palm => 0.0,
            View::Back => std::f64::consts::PI,
        };
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), facing);
        let state = ModelState { rotation, ..ModelState::facing(wrist, focal / USUAL_DISTANCE) };
        let (morphology, forearm) = (morphology.clone(), None);
        let mut tracker =
            Self::new(&Fit { morphology, side, state, forearm, iou: 0.0, evaluations: 0 }, options);
        tracker.lost = 1;
        tracker
    }

    /// Goes back to the open hand of the fit, to track again from there in the other direction of time.
    pub fn rewind(&mut self) {
        self.last = self.open.state.clone();
        self.before = None;
        self.lost = 0;
        self.registration.forget_usual();
    }

    /// The sizes of the hand, as refined so far.
    pub fn morphology(&self) -> &Morphology {
        self.model.morphology()
    }

    /// The model in the image of the frames, to project or draw its states.
    pub fn model_mut(&mut self) -> &mut HandModel {
        &mut self.model
    }

    /// Registers the model on the next silhouette, cut from its forearm at `forearm`; `image`, of the same
    /// size, shows what is inside it.
    ///
    /// While the hand is lost or in doubt every frame is tried from the last good posture and from the open
    /// hand too, both brought to the silhouette's centroid, so that tracking resumes when the hand comes back.
    ///
    /// # Errors
    /// `image` has another size than `silhouette`; the tracker then stays as it was.
    pub fn track(
        &mut self,
        silhouette: &Mask,
        forearm: Option<Forearm>,
        image: Option<&RgbImage>,
    ) -> Result<TrackedState, SizeMismatch> {
        let evaluated = self.registration.evaluations();
        if !self.evidence.load(silhouette, forearm, image, self.factor)? {
            return Ok(self.miss(0.0, 0, false));
        }
        let predicted = self.predicted();
        let mut state = self.last.clone();
        let mut found = self.search(&predicted, &mut state);
        let restarted = self.lost > 0 || found.iou < DOUBTFUL_IOU;
        if restarted {
            for start in [self.open.state.clone(), self.last.clone()] {
                let mut other = self.brought_to_silhouette(start);
                let again = self.search(&other.clone(), &mut other);
                if again.iou > found.iou {
                    (state, found) = (other, again);
                }
            }
        }
        let evaluations = self.registration.evaluations() - evaluated;
        if found.iou < self.lost_iou {
            return Ok(self.miss(found.iou, evaluations, restarted));
        }
        if self.registration.learn(&mut self.small, &self.evidence, &self.open, &state) {
            self.model.set_morphology(self.small.morphology());
        }
        self.registration.remember(&self.small, &self.evidence, &state);
        let before = std::mem::replace(&mut self.last, state.clone());
        self.before = (self.lost == 0 && !restarted).then_some(before);
        self.lost = 0;
        let state = state.reduced(1.0 / f64::from(self.factor));
        Ok(TrackedState { state, iou: found.iou, valid: true, evaluations, restarted })
    }

    /// Frames since the hand was lost; 0 while it is tracked.
    pub fn frames_lost(&self) -> usize {
        self.lost
    }

    fn miss(&mut self, iou: f64, evaluations: usize, restarted: bool) -> TrackedState {
        self.lost += 1;
        self.before = None;
        self.registration.forget_usual();
        let state = self.last.reduced(1.0 / f64::from(self.factor));
        TrackedState { state, iou, valid: false, evaluations, restarted }
    }

    fn search(&mut self, predicted: &ModelState, state: &mut ModelState) -> Registered {
        let belief = Belief { predicted, open: &self.open };
        self.registration.register(&mut self.small, &self.evidence, &belief, state)
    }

    /// Where the picture has gone since the last frame; without one, where the motion between the last two frames
    /// leads.
    fn predicted(&mut self) -> ModelState {
        let belief = Belief { predicted: &self.last, open: &self.open };
        let followed = self.registration.follow(&mut self.small, &self.evidence, &belief);
        followed.unwrap_or_else(|| self.going_on())
    }

    /// Where the motion between the last two frames leads.
    fn going_on(&self) -> ModelState {
        let Some(before) = &self.before else { return self.last.clone() };
        let on = |now: f64, then: f64| now + PERSISTENCE * (now - then);
        let mut state = self.last.clone();
        for k in 0..2 {
            state.wrist[k] = on(self.last.wrist[k], before.wrist[k]);
        }
        for k in 0..15 {
            state.free[k] = on(self.last.free[k], before.free[k]);
        }
        state.thumb_mcp = on(self.last.thumb_mcp, before.thumb_mcp);
        state.bring_inside(&self.domain, &self.open.state.free);
        state
    }

    /// `state` moved so that the centroids of model and silhouette meet: eq. 7 is flat where nothing overlaps
    /// (6.2.1).
    fn brought_to_silhouette(&mut self, mut state: ModelState) -> ModelState {
        let silhouette = self.evidence.silhouette();
        let mut drawn = Mask::new(silhouette.width(), silhouette.height());
        self.small.draw(&state, [0.0, 0.0], &mut drawn);
        let [mx, my] = drawn.centroid().unwrap_or(state.wrist);
        let [x, y] = silhouette.centroid().unwrap_or([mx, my]);
        state.wrist = [state.wrist[0] + x - mx, state.wrist[1] + y - my];
        state
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::Finger;

    fn fit() -> Fit {
        let mut free = [0.0; 15];
        for (finger, degrees) in Finger::LONG.into_iter().zip([10.0f64, 0.0, 8.0, 18.0]) {
            free[3 * finger as usize + 1] = degrees.to_radians();
        }
        Fit {
            morphology: Morphology::default(),
            side: Side::Right,
            state: ModelState { free, ..ModelState::facing([160.0, 210.0], 800.0) },
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
        let mut tracker = HandTracker::new(&fit, TrackerOptions::default());
        assert!(tracker.track(&draw(2.0), None, None).unwrap().valid);
        for _ in 0..3 {
            assert!(!tracker.track(&Mask::new(400, 240), None, None).unwrap().valid);
        }
        let bar = Mask::from_fn(400, 240, |x, y| (100..300).contains(&x) && (100..104).contains(&y));
        assert!(!tracker.track(&bar, None, None).unwrap().valid);
        assert_eq!(tracker.frames_lost(), 4);
        let small = RgbImage::new(200, 120);
        assert!(tracker.track(&draw(90.0), None, Some(&small)).is_err());
        let back = tracker.track(&draw(90.0), None, None).unwrap();
        assert!(back.valid && back.iou > 0.9, "{back:?}");
        assert!((back.state.wrist[0] - 250.0).abs() < 4.0);
        assert_eq!(tracker.frames_lost(), 0);
    }
}
