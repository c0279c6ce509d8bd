//! Frame-to-frame tracking: each registration starts where the motion of the picture leads (paper 7), or without
//! one that of the last frames (6.4.2).

use image::RgbImage;
use nalgebra::{UnitQuaternion, Vector3};

use super::camera::PinholeCamera;
use super::evidence::{Evidence, SizeMismatch};
use super::fit::{Fit, View};
use super::forearm::Forearm;
use super::model::HandModel;
use super::register::{
    Face, OpenState, Prior, Registered, Registration, RegistrationOptions, largest_difference,
};
use super::sighted::SightedPose;
use super::state::ModelState;
use handcast_hand::{Domain, FREE_ANGLES, FreeAngles, Morphology, Side};
use handcast_vision::Mask;
use handcast_vision::sighting::Sighting;
use handcast_vision::tuning::tuning;

/// Intersection over union below which a hand counts as lost, unless the options say otherwise.
pub const LOST_IOU: f64 = 0.60;

/// How a hand is tracked.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct TrackerOptions {
    /// The search of each frame.
    pub registration: RegistrationOptions,
    /// Intersection over union below which the hand is lost in that frame.
    pub lost_iou: f64,
    /// The camera, for perspective; without, the projection is orthographic.
    pub camera: Option<PinholeCamera>,
    /// The tuning constants of what is around the search.
    pub tuning: TrackerTuning,
}

impl Default for TrackerOptions {
    fn default() -> Self {
        Self {
            registration: RegistrationOptions::default(),
            lost_iou: LOST_IOU,
            camera: None,
            tuning: TrackerTuning::default(),
        }
    }
}

impl TrackerOptions {
    /// Sets [`TrackerOptions::registration`].
    #[must_use]
    pub fn with_registration(mut self, registration: RegistrationOptions) -> Self {
        self.registration = registration;
        self
    }

    /// Sets [`TrackerOptions::lost_iou`].
    #[must_use]
    pub fn with_lost_iou(mut self, lost_iou: f64) -> Self {
        self.lost_iou = lost_iou;
        self
    }

    /// Sets [`TrackerOptions::camera`].
    #[must_use]
    pub fn with_camera(mut self, camera: PinholeCamera) -> Self {
        self.camera = Some(camera);
        self
    }

    /// Sets [`TrackerOptions::tuning`].
    #[must_use]
    pub fn with_tuning(mut self, tuning: TrackerTuning) -> Self {
        self.tuning = tuning;
        self
    }
}

tuning! {
    /// Tracking around the search of a frame.
    pub struct TrackerTuning {
        /// Intersection over union below which the open hand and the last state are tried at the silhouette's centroid.
        ["1", "spec/registration.md 5, Hypotheses"]
        pub recovery_iou: f64 = 0.80,
        /// Longest hand in the images in which it is registered.
        ["pixels", "spec/tracking.md 7; handcast bench track --scaling"]
        pub longest_hand: f64 = 150.0,
        /// Share of the motion between the last two frames that goes on, where no picture tells.
        ["1", "chosen by eye"]
        pub persistence: f64 = 0.8,
        /// Distance from the camera of a hand that has not been seen open.
        ["m", "chosen by eye: at arm's length or a little less"]
        pub distance: f64 = 0.5,
        /// Height of its wrist in the image, from above: share of the image's height.
        ["1", "chosen by eye"]
        pub wrist_height: f64 = 0.75,
        /// Difference of a joint angle from which on the posture that a finder has seen is a hypothesis of its own.
        ["rad", "chosen by eye"]
        pub sighted_differs: f64 = 0.35,
        /// The same for a direction of the hand.
        ["rad", "chosen by eye"]
        pub sighted_turned: f64 = 0.35,
        /// Mean distance of the joints of the model from those that a finder has seen, up to which the hand is
        /// there whatever its overlap.
        ["hand lengths", "chosen by eye"]
        pub agrees: f64 = 0.06,
        /// Least overlap of a hand of which that is said.
        ["1", "chosen by eye"]
        pub agreeing_iou: f64 = 0.3,
        /// Turn from what a finder has seen from which on the hand is sought there alone, too.
        ["rad", "chosen: a quarter turn is no error of a finder's, palm for back is"]
        pub contradicted: f64 = 1.4,
        /// Share of the distance of the joints that must remain for what is found there to be the hand.
        ["1", "chosen: palms taken for backs have every joint on the wrong side"]
        pub nearer: f64 = 0.6,
        /// How much less it may overlap.
        ["1", "chosen by eye: wrong postures overlap well, too"]
        pub overlaps_less: f64 = 0.05,
        /// Intersection over union below which a hand may have been turned over.
        ["1", "rendered hands that turn over: 0.88 at most where that was missed"]
        pub turned_below: f64 = 0.9,
        /// Every so many of such frames in a row the open hand is tried turned over.
        ["frames", "chosen for speed"]
        pub turned_every: usize = 5,
        /// How much more it must overlap then, and reach.
        ["1", "chosen: an open hand in sight, thumb and all, and nothing less"]
        pub turned_gain: [f64; 2] = [0.04, 0.92],
        /// Largest difference of a joint angle from the open hand then.
        ["rad", "chosen: the same"]
        pub turned_open: f64 = 0.6,
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
    /// Mean distance of the model's joints from those that a finder has seen, hand lengths; `None` where it saw none.
    pub joints_away: Option<f64>,
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
    tuning: TrackerTuning,
    /// The open hand; like all states kept here, in the reduced image.
    open: OpenState,
    /// The last state, and the one before it when both frames were tracked.
    last: ModelState,
    before: Option<ModelState>,
    lost: usize,
    /// How often it counts as lost where it begins.
    begins_lost: usize,
    /// Rotation of the open hand where it begins.
    begins_turned: UnitQuaternion<f64>,
    /// Frames in a row that were badly explained.
    unexplained: usize,
    /// Made when it is needed, for these sizes.
    sighted: Option<SightedPose>,
    /// How the last frame was explained.
    found: Option<Registered>,
}

/// Wrist, pixels, and focal length, pixels, where nothing is known of the camera: it looks at 320×240 pixels.
const UNKNOWN_CAMERA: ([f64; 2], f64) = ([160.0, 120.0], 280.0);

impl HandTracker {
    /// A tracker of the fitted hand, which starts from where the fit found it.
    pub fn new(fit: &Fit, options: TrackerOptions) -> Self {
        let mut model = HandModel::new(&fit.morphology, fit.side);
        if let Some(camera) = options.camera {
            model = model.with_camera(camera);
        }
        let hand = fit.state.scale * fit.morphology.hand_length;
        let longest = options.tuning.longest_hand;
        let factor = if options.camera.is_some() { (hand / longest).ceil().max(1.0) as u32 } else { 1 };
        let small = match options.camera {
            Some(camera) => model.clone().with_camera(camera.reduced(factor)),
            None => model.clone(),
        };
        let open = fit.state.reduced(factor.into());
        let behind = fit.forearm.map(|f| f.reduced(factor).behind(&open));
        Self {
            begins_lost: 0,
            begins_turned: open.rotation,
            unexplained: 0,
            sighted: None,
            found: None,
            evidence: Evidence::new(options.registration.tuning.evidence),
            registration: Registration::new(options.registration),
            model,
            small,
            factor,
            domain: Domain::free(),
            lost_iou: options.lost_iou,
            tuning: options.tuning,
            last: open.clone(),
            open: OpenState { state: open, behind },
            before: None,
            lost: 0,
        }
    }

    /// A tracker of a hand of these sizes that has not been seen open: it begins as if the hand were lost, at
    /// [`TrackerTuning::distance`] from the camera, and finds its posture among the known ones.
    pub fn without_fit(morphology: &Morphology, side: Side, view: View, options: TrackerOptions) -> Self {
        let (wrist, focal) = options.camera.map_or(UNKNOWN_CAMERA, |c| {
            ([0.5 * f64::from(c.width), options.tuning.wrist_height * f64::from(c.height)], c.focal)
        });
        let facing = match view {
            View::Palm => 0.0,
            View::Back => std::f64::consts::PI,
        };
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), facing);
        let state = ModelState { rotation, ..ModelState::facing(wrist, focal / options.tuning.distance) };
        let mut tracker = Self::from_state(morphology, side, state, options);
        tracker.begins_lost = 0;
        tracker
    }

    /// A tracker of a hand of these sizes that has not been fitted: it begins as if the hand were lost, and `open` is
    /// what it would look like open, there.
    pub fn from_state(
        morphology: &Morphology,
        side: Side,
        open: ModelState,
        options: TrackerOptions,
    ) -> Self {
        let (morphology, forearm) = (morphology.clone(), None);
        let fit = Fit { morphology, side, state: open, forearm, iou: 0.0, evaluations: 0 };
        let mut tracker = Self::new(&fit, options);
        (tracker.lost, tracker.begins_lost) = (1, 1);
        tracker
    }

    /// Takes the forearms of silhouettes to be cut at the wrist: who found the hand says where that is.
    pub fn cut_at_wrist(&mut self) {
        self.open.behind = Some(0.0);
    }

    /// Goes back to the open hand of the fit, to track again from there in the other direction of time.
    pub fn rewind(&mut self) {
        if self.open.state.rotation != self.begins_turned {
            self.open.state.rotation = self.begins_turned;
            self.registration.exchange_face(&mut Face::default());
        }
        self.unexplained = 0;
        self.last = self.open.state.clone();
        self.before = None;
        self.lost = self.begins_lost;
        self.registration.forget();
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
    /// While the hand is lost or overlaps badly every frame is tried from the last good posture and from the open
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
        self.track_sighted(silhouette, forearm, image, None)
    }

    /// As [`HandTracker::track`], with what a finder has seen of the hand: its joints are residuals beside the
    /// outline, and its posture is one more hypothesis.
    ///
    /// # Errors
    /// Those of [`HandTracker::track`].
    pub fn track_sighted(
        &mut self,
        silhouette: &Mask,
        forearm: Option<Forearm>,
        image: Option<&RgbImage>,
        sighting: Option<&Sighting>,
    ) -> Result<TrackedState, SizeMismatch> {
        let evaluated = self.registration.evaluations();
        if !self.evidence.load(silhouette, forearm, image, self.factor)? {
            return Ok(self.report_loss(0.0, 0, false));
        }
        self.evidence.set_joints(sighting.map(|s| &s.points), self.factor);
        let seen = sighting.and_then(|s| self.sighted_state(s));
        let (state, found, restarted) = match seen {
            Some(seen) => self.beside(seen),
            None => self.without_sighting(),
        };
        let evaluations = self.registration.evaluations() - evaluated;
        let joints_away = self.registration.joints_away(&self.small, &self.evidence, &state);
        self.found = Some(found);
        let agrees = joints_away.is_some_and(|away| away < self.tuning.agrees);
        if found.iou < if agrees { self.tuning.agreeing_iou } else { self.lost_iou } {
            return Ok(self.report_loss(found.iou, evaluations, restarted));
        }
        // A hand that is there by its joints alone has a wrong outline.
        if found.iou >= self.lost_iou
            && self.registration.learn(&mut self.small, &self.evidence, &self.open, &state)
        {
            self.model.set_morphology(self.small.morphology());
            self.sighted = None;
        }
        self.registration.remember(&self.small, &self.evidence, &state);
        let before = std::mem::replace(&mut self.last, state.clone());
        self.before = (self.lost == 0 && !restarted).then_some(before);
        self.lost = 0;
        let state = state.reduced(1.0 / f64::from(self.factor));
        Ok(TrackedState { state, iou: found.iou, valid: true, evaluations, restarted, joints_away })
    }

    /// The state found from where the picture leads; where that overlaps badly, or the hand was lost, also from the
    /// open hand and the last posture at the silhouette's centroid. And whether that was needed.
    fn without_sighting(&mut self) -> (ModelState, Registered, bool) {
        let predicted = self.predicted();
        let mut state = self.last.clone();
        let mut found = self.search(&predicted, &mut state, None);
        let restarted = self.lost > 0 || found.iou < self.tuning.recovery_iou;
        if restarted {
            for hypothesis in [self.open.state.clone(), self.last.clone()] {
                let mut other = self.centred(hypothesis);
                let again = self.search(&other.clone(), &mut other, None);
                if again.iou > found.iou {
                    (state, found) = (other, again);
                }
            }
        }
        if let Some((turned, again)) = self.turned_over(&state, found.iou) {
            return (turned, again, true);
        }
        (state, found, restarted)
    }

    /// The open hand turned over, where that is what the picture shows, and not the hand of `state`, which overlaps by
    /// `iou`. It is what the open hand looks like from then on.
    fn turned_over(&mut self, state: &ModelState, iou: f64) -> Option<(ModelState, Registered)> {
        let t = self.tuning;
        self.unexplained = if iou < t.turned_below { self.unexplained + 1 } else { 0 };
        if self.unexplained == 0 || !self.unexplained.is_multiple_of(t.turned_every) {
            return None;
        }
        let (open, progress) = (self.open.state.clone(), self.registration.progress());
        let along = |rotation: &UnitQuaternion<f64>| {
            let axis = rotation * Vector3::y();
            axis.y.atan2(axis.x)
        };
        let turn = along(&state.rotation) - along(&open.rotation);
        let [gain, least] = t.turned_gain;
        let over = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::PI);
        let mut face = Face::default();
        self.registration.exchange_face(&mut face);
        // The arm where it was, or where the hand seems to point.
        for turn in [0.0, turn] {
            let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn) * open.rotation * over;
            let hypothesis = self.centred(ModelState { rotation, scale: state.scale, ..open.clone() });
            let mut turned = hypothesis.clone();
            self.open.state.rotation = rotation;
            let found = self.search(&hypothesis, &mut turned, None);
            if found.iou >= least.max(iou + gain)
                && largest_difference(&turned.free, &open.free) <= t.turned_open
            {
                return Some((turned, found));
            }
            self.registration.exchange_face(&mut Face::default());
        }
        self.registration.exchange_face(&mut face);
        self.open.state.rotation = open.rotation;
        self.registration.go_back(progress);
        None
    }

    /// The state that a sighting shows.
    fn sighted_state(&mut self, sighting: &Sighting) -> Option<ModelState> {
        let Self { sighted, small, factor, .. } = self;
        let sighted = sighted.get_or_insert_with(|| SightedPose::new(small.morphology(), small.side()));
        sighted.state(small, sighting, f64::from(*factor))
    }

    /// The same where a finder has `seen` the hand: a lost one is sought there alone.
    fn beside(&mut self, seen: ModelState) -> (ModelState, Registered, bool) {
        let restarted = self.lost > 0;
        let predicted = if restarted { seen.clone() } else { self.predicted() };
        let mut state = if restarted { seen.clone() } else { self.last.clone() };
        let differs = largest_difference(&seen.free, &predicted.free) > self.tuning.sighted_differs
            || seen.rotation.angle_to(&predicted.rotation) > self.tuning.sighted_turned;
        let found = self.search(&predicted, &mut state, differs.then(|| seen.clone()));
        if !restarted && seen.rotation.angle_to(&state.rotation) > self.tuning.contradicted {
            let progress = self.registration.progress();
            let mut other = seen.clone();
            let again = self.search(&seen, &mut other, None);
            if self.is_nearer(&other, &state) && again.iou > found.iou - self.tuning.overlaps_less {
                return (other, again, true);
            }
            self.registration.go_back(progress);
        }
        (state, found, restarted)
    }

    /// Whether the joints that a finder has seen are much nearer to those of one state than to those of the other.
    fn is_nearer(&self, state: &ModelState, other: &ModelState) -> bool {
        let away = |state| self.registration.joints_away(&self.small, &self.evidence, state);
        away(state).zip(away(other)).is_some_and(|(one, other)| one < self.tuning.nearer * other)
    }

    /// Frames since the hand was lost; 0 while it is tracked.
    pub fn frames_lost(&self) -> usize {
        self.lost
    }

    /// How the last frame with a silhouette was explained. Of hands of either side on the same frames costs tell which is
    /// likelier.
    pub(super) fn found(&self) -> Option<Registered> {
        self.found
    }

    /// Largest difference of a joint angle from the open hand in the last state, radians.
    pub(super) fn bent(&self) -> f64 {
        largest_difference(&self.last.free, &self.open.state.free)
    }

    /// Free angles of the last state, radians.
    pub(super) fn free(&self) -> FreeAngles {
        self.last.free
    }

    fn report_loss(&mut self, iou: f64, evaluations: usize, restarted: bool) -> TrackedState {
        self.lost += 1;
        self.before = None;
        self.registration.forget();
        let state = self.last.reduced(1.0 / f64::from(self.factor));
        TrackedState { state, iou, valid: false, evaluations, restarted, joints_away: None }
    }

    fn search(
        &mut self,
        predicted: &ModelState,
        state: &mut ModelState,
        other: Option<ModelState>,
    ) -> Registered {
        let prior = Prior { predicted, open: &self.open };
        self.registration.register_beside(&mut self.small, &self.evidence, &prior, state, other)
    }

    /// Where the picture has gone since the last frame; without one, where the motion between the last two frames
    /// leads.
    fn predicted(&mut self) -> ModelState {
        let prior = Prior { predicted: &self.last, open: &self.open };
        let followed = self.registration.follow(&mut self.small, &self.evidence, &prior);
        followed.unwrap_or_else(|| self.extrapolated())
    }

    /// Where the motion between the last two frames leads.
    fn extrapolated(&self) -> ModelState {
        let Some(before) = &self.before else { return self.last.clone() };
        let persistence = self.tuning.persistence;
        let on = |now: f64, then: f64| now + persistence * (now - then);
        let mut state = self.last.clone();
        for k in 0..2 {
            state.wrist[k] = on(self.last.wrist[k], before.wrist[k]);
        }
        for k in 0..FREE_ANGLES {
            state.free[k] = on(self.last.free[k], before.free[k]);
        }
        state.thumb_mcp = on(self.last.thumb_mcp, before.thumb_mcp);
        state.bring_inside(&self.domain, &self.open.state.free);
        state
    }

    /// `state` moved so that the centroids of model and silhouette meet: eq. 7 is flat where nothing overlaps
    /// (6.2.1).
    fn centred(&mut self, mut state: ModelState) -> ModelState {
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
    use handcast_vision::sighting::Region;

    fn fit() -> Fit {
        let mut free = [0.0; FREE_ANGLES];
        for (finger, degrees) in Finger::LONG.into_iter().zip([10.0f64, 0.0, 8.0, 18.0]) {
            free[finger.free_abduction()] = degrees.to_radians();
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

    /// The open hand and the same from behind, drawn.
    fn both_faces() -> [(ModelState, Mask); 2] {
        let fit = fit();
        let mut model = HandModel::new(&fit.morphology, fit.side);
        let over = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::PI);
        [UnitQuaternion::identity(), over].map(|over| {
            let state = ModelState { rotation: fit.state.rotation * over, ..fit.state.clone() };
            let mut mask = Mask::new(400, 240);
            model.draw(&state, [0.0, 0.0], &mut mask);
            (state, mask)
        })
    }

    #[test]
    fn a_hand_that_is_turned_over_is_found_again() {
        let [(_, palm), (turned, back)] = both_faces();
        let mut tracker = HandTracker::new(&fit(), TrackerOptions::default());
        for _ in 0..3 {
            assert!(tracker.track(&palm, None, None).unwrap().valid);
        }
        let frames = 2 * tracker.tuning.turned_every;
        let last = (0..frames).map(|_| tracker.track(&back, None, None).unwrap()).last().unwrap();
        assert!(last.iou > 0.92 && last.state.rotation.angle_to(&turned.rotation) < 0.3, "{last:?}");
        // On the way back it is the hand that it was.
        tracker.rewind();
        assert!(tracker.track(&palm, None, None).unwrap().iou > 0.92);
    }

    #[test]
    fn a_finder_that_sees_the_other_face_is_believed_where_its_joints_are() {
        use handcast_hand::Joint;
        use handcast_hand::landmarks::LANDMARKS_21;
        let [(_, palm), (turned, back)] = both_faces();
        let fit = fit();
        let model = HandModel::new(&fit.morphology, fit.side);
        let joints: [[f64; 2]; Joint::COUNT] = model.joints(&turned);
        let points = LANDMARKS_21.map(|joint| joints[joint.index()]);
        let camera = PinholeCamera { width: 400, height: 240, focal: 400.0 };
        let frames = model.skeleton().frames(&turned.to_pose(fit.side, &camera));
        let world = LANDMARKS_21.map(|joint| {
            let p = frames.position(joint) - frames.position(Joint::Wrist);
            [p.x, -p.y, -p.z]
        });
        let region = Region::of_joints(&points);
        let sighting = Sighting { points, world: Some(world), presence: 1.0, right: 1.0, region, age: 0 };
        let mut tracker = HandTracker::new(&fit, TrackerOptions::default());
        for _ in 0..3 {
            assert!(tracker.track(&palm, None, None).unwrap().valid);
        }
        let found = tracker.track_sighted(&back, None, None, Some(&sighting)).unwrap();
        assert!(found.restarted && found.state.rotation.angle_to(&turned.rotation) < 0.3, "{found:?}");
    }

    /// The open hand, nearer.
    fn open() -> ModelState {
        ModelState { scale: 900.0, ..fit().state }
    }

    /// The sizes found on 30 open frames of `truth`, turned in the image, after a fit that found `fitted`.
    fn found_on_open_frames(truth: &Morphology, fitted: Morphology, turn: f64) -> Morphology {
        let mut state = open();
        state.rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn) * state.rotation;
        let (side, forearm) = (Side::Right, None);
        let fit = Fit { morphology: fitted, side, state: state.clone(), forearm, iou: 1.0, evaluations: 0 };
        let mut tracker = HandTracker::new(&fit, TrackerOptions::default());
        let mut model = HandModel::new(truth, side);
        for i in 0..30 {
            let mut moved = state.clone();
            moved.wrist[0] += f64::from(i);
            let mut mask = Mask::new(400, 240);
            model.draw(&moved, [0.0, 0.0], &mut mask);
            assert!(tracker.track(&mask, None, None).unwrap().valid);
        }
        tracker.morphology().clone()
    }

    #[test]
    fn sizes_that_the_fit_missed_are_found_on_open_frames() {
        let truth = Morphology::default();
        let (shorter, wider) = (0.94_f64, 1.08_f64);
        // Not the middle finger, whose length is a part of the hand's, which the fit was told.
        let fingers = [Finger::Index, Finger::Ring, Finger::Pinky];
        let mut left = Vec::new();
        for (turn, i) in [-0.2, 0.0, 0.2].into_iter().flat_map(|turn| (0..3).map(move |i| (turn, i))) {
            let [short, wide] = [i, (i + 1) % 3].map(|i| fingers[i] as usize);
            let mut fitted = truth.clone();
            fitted.fingers[short].bones = fitted.fingers[short].bones.map(|b| shorter * b);
            fitted.fingers[wide].radii = fitted.fingers[wide].radii.map(|r| wider * r);
            let found = found_on_open_frames(&truth, fitted, turn);
            let length = found.fingers[short].length() / truth.fingers[short].length();
            let width = found.fingers[wide].radii[2] / truth.fingers[wide].radii[2];
            left.extend([length.ln().abs() / shorter.ln().abs(), width.ln().abs() / wider.ln()]);
            let middle =
                |m: &Morphology| m.finger(Finger::Middle).base[1] + m.finger(Finger::Middle).length();
            assert!((middle(&found) / middle(&truth) - 1.0).abs() < 0.005);
        }
        // Most of what the fit missed: it is the prior, too.
        let mean = left.iter().sum::<f64>() / left.len() as f64;
        assert!(mean < 0.5 && left.iter().all(|&l| l < 1.0), "{mean} of {left:?}");
    }

    #[test]
    fn a_forearm_narrower_than_the_wrist_is_found() {
        let truth = Morphology { forearm: 0.7, ..Morphology::default() };
        let state = open();
        let side = Side::Right;
        let forearm = Forearm { cut: [160.0, 225.0], axis: [0.0, -1.0] };
        let fit = Fit {
            morphology: Morphology::default(),
            side,
            state: state.clone(),
            forearm: Some(forearm),
            iou: 1.0,
            evaluations: 0,
        };
        let mut tracker = HandTracker::new(&fit, TrackerOptions::default());
        let mut model = HandModel::new(&truth, side);
        let mut first = 0.0;
        for i in 0..30 {
            let mut moved = state.clone();
            moved.wrist[0] += f64::from(i);
            let mut arm = Mask::new(400, 240);
            model.draw(&moved, [0.0, 0.0], &mut arm);
            model.draw_forearm(&forearm, [0.0, 0.0], &mut arm);
            let hand = Mask::from_fn(400, 240, |x, y| arm.get(x, y) && y < 225);
            let tracked = tracker.track(&hand, Some(forearm), None).unwrap();
            assert!(tracked.valid);
            if i == 0 {
                first = tracked.iou;
            } else if i == 29 {
                assert!(tracked.iou > first, "{first} {}", tracked.iou);
            }
        }
        let found = tracker.morphology().forearm;
        assert!((0.6..0.85).contains(&found), "{found}");
    }
}
