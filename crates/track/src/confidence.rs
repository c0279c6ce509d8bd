//! How far a tracked pose can be trusted.

use super::model::HandModel;
use super::state::ModelState;
use super::tracker::TrackedState;
use handcast_hand::{Finger, FreeAngles, Morphology, Side};
use handcast_vision::Mask;
use handcast_vision::tuning::tuning;

/// Length of a hand in the small drawing, pixels.
const HAND: f64 = 80.0;
/// Side of the small drawing: a hand fits in it in any direction round its middle.
const SIDE: u32 = 192;
/// Least range of overlaps that tells anything.
const LEAST_RANGE: f64 = 1e-6;

tuning! {
    /// What confidence is made of (spec/tracking.md, section 4).
    pub struct ConfidenceTuning {
        /// Intersection over union from which the overlap is as good as can be.
        ["1", "spec/tracking.md 4, errors by confidence"]
        pub good_iou: f64 = 0.95,
        /// Share of a stretched finger's area that must be seen in outline for its angles to be well known.
        ["1", "spec/tracking.md 4, errors by confidence"]
        pub well_seen: f64 = 0.6,
        /// Share of a stretched finger that is not hidden in the palm and its web.
        ["1", "chosen by eye"]
        pub stretched: f64 = 0.8,
        /// Factor when no finger is seen in outline: wrist and knuckles are.
        ["1", "spec/tracking.md 4, errors by confidence"]
        pub fist: f64 = 0.15,
        /// Factor in a frame that needed hypotheses from elsewhere.
        ["1", "spec/tracking.md 4, errors by confidence"]
        pub restarted: f64 = 0.7,
        /// Factor right after the hand was found again.
        ["1", "chosen by eye"]
        pub found_again: f64 = 0.5,
        /// Frames until that factor has grown to 1.
        ["frames", "chosen by eye"]
        pub found_frames: usize = 5,
        /// Change of a joint angle within a frame that is hardly a motion.
        ["rad", "chosen by eye"]
        pub jump: f64 = 0.6,
        /// Factor after such a jump.
        ["1", "chosen by eye"]
        pub jumped: f64 = 0.7,
        /// Frames that this factor lasts.
        ["frames", "chosen by eye"]
        pub jump_frames: usize = 3,
        /// Power to which the product is raised.
        ["1", "rendered hands with networks: of the frames from 0.5 to 0.75 a finger is off by more than 40° in 4 % (half that it was fitted on) and 8 % (other half); 35 % with 1"]
        pub sharpness: f64 = 2.4,
    }
}

/// Rates tracked states, from 0 (nothing is known: the hand is lost; little: most fingers are guesses, bent in
/// front of the palm, or the overlap is poor, or the hand has just been found) over 0.5 (a finger may be one) to 1 (an outline that the model
/// fills, all five fingers seen in it, found without trouble).
///
/// It is a power ([`ConfidenceTuning::sharpness`]) of the product of
/// * the overlap: 0 at the IoU where the hand counts as lost, 1 from [`ConfidenceTuning::good_iou`] on;
/// * what the outline shows of the fingers: of each the part of its projection that the rest of the hand does
///   not cover and that lies in the picture, as a share of its stretched area, up to [`ConfidenceTuning::well_seen`];
/// * steadiness: less for some frames after the hand was found again, where registration had to start elsewhere, and
///   for some frames after a joint jumped.
///
/// Allocates nothing after the first state.
#[derive(Clone, Debug)]
pub struct Confidence {
    model: HandModel,
    tuning: ConfidenceTuning,
    lost_iou: f64,
    /// Pixels of the small drawing per metre.
    scale: f64,
    /// Area of each stretched finger in the small drawing, pixels.
    stretched: [f64; Finger::COUNT],
    drawn: Mask,
    /// Size of the pictures, pixels; `None` where hands are in them as a whole.
    picture: Option<[u32; 2]>,
    /// The picture in the small drawing.
    inside: Mask,
    last: Option<FreeAngles>,
    since_found: usize,
    since_jump: usize,
}

impl Confidence {
    /// For hands of these sizes that count as lost below an IoU of `lost_iou`.
    pub fn new(morphology: &Morphology, side: Side, lost_iou: f64) -> Self {
        Self::tuned(morphology, side, lost_iou, ConfidenceTuning::default())
    }

    /// The same with other tuning constants.
    pub fn tuned(morphology: &Morphology, side: Side, lost_iou: f64, tuning: ConfidenceTuning) -> Self {
        let scale = HAND / morphology.hand_length;
        let stretched = Finger::ALL.map(|finger| {
            let f = morphology.finger(finger);
            let breadth = 2.0 * f.radii.iter().sum::<f64>() / f.radii.len() as f64;
            tuning.stretched * f.length() * breadth * scale * scale
        });
        let mut confidence = Self {
            model: HandModel::new(morphology, side),
            tuning,
            lost_iou,
            scale,
            stretched,
            drawn: Mask::new(SIDE, SIDE),
            picture: None,
            inside: Mask::new(SIDE, SIDE),
            last: None,
            since_found: 0,
            since_jump: 0,
        };
        confidence.reset();
        confidence
    }

    /// For pictures of this size, pixels: of fingers beyond their borders nothing is seen.
    #[must_use]
    pub fn within(self, width: u32, height: u32) -> Self {
        Self { picture: Some([width, height]), ..self }
    }

    /// Forgets the states so far: to be called where the clip jumps or runs the other way.
    pub fn reset(&mut self) {
        self.last = None;
        self.since_found = self.tuning.found_frames;
        self.since_jump = self.tuning.jump_frames;
    }

    /// The confidence in the next state, 0 to 1.
    pub fn of(&mut self, tracked: &TrackedState) -> f64 {
        if !tracked.valid {
            self.last = None;
            self.since_found = 0;
            return 0.0;
        }
        let t = self.tuning;
        let free = &tracked.state.free;
        let jumped = self.last.is_some_and(|last| last.iter().zip(free).any(|(a, b)| (a - b).abs() > t.jump));
        self.since_jump = if jumped { 0 } else { self.since_jump + 1 };
        self.last = Some(*free);
        let overlap =
            ((tracked.iou - self.lost_iou) / (t.good_iou - self.lost_iou).max(LEAST_RANGE)).clamp(0.0, 1.0);
        let share = (self.since_found as f64 / t.found_frames as f64).min(1.0);
        self.since_found += 1;
        let mut steady = t.found_again + (1.0 - t.found_again) * share;
        if tracked.restarted {
            steady *= t.restarted;
        }
        if self.since_jump < t.jump_frames {
            steady *= t.jumped;
        }
        let seen = self.visible(&tracked.state);
        let seen = seen.iter().map(|v| (v / t.well_seen).min(1.0)).sum::<f64>() / seen.len() as f64;
        (overlap * steady * (t.fist + (1.0 - t.fist) * seen)).powf(t.sharpness)
    }

    /// Of each finger, thumb first, the area of its projection that nothing else of the hand covers and that lies in the
    /// picture, as a share of the area of the stretched finger, 0 to about 1.
    pub fn visible(&mut self, state: &ModelState) -> [f64; Finger::COUNT] {
        let small = ModelState { wrist: [0.0, 0.0], scale: self.scale, ..state.clone() };
        // The middle of the hand, half way to where the middle finger would reach, is put in the middle.
        let ahead = small.rotation * nalgebra::Vector3::new(0.0, 0.5 * HAND, 0.0);
        let half = 0.5 * f64::from(SIDE);
        let origin = [ahead.x - half, -ahead.y - half];
        let cut = self.draw_picture(state, origin);
        let Self { model, drawn, inside, stretched, .. } = self;
        let area = |drawn: &Mask| f64::from(if cut { drawn.overlap(inside) } else { drawn.area() });
        drawn.clear();
        model.draw(&small, origin, drawn);
        let whole = area(drawn);
        let mut visible = [0.0; Finger::COUNT];
        for (finger, share) in Finger::ALL.into_iter().zip(&mut visible) {
            drawn.clear();
            model.draw_without(&small, finger, origin, drawn);
            *share = (whole - area(drawn)) / stretched[finger as usize];
        }
        visible
    }

    /// Draws the picture into the small drawing, whose corner is `origin` from the wrist; whether it has a border there.
    fn draw_picture(&mut self, state: &ModelState, origin: [f64; 2]) -> bool {
        let Some(picture) = self.picture else { return false };
        let reduced = self.scale / state.scale;
        let first = [0, 1].map(|c| -reduced * state.wrist[c] - origin[c]);
        let last = [0, 1].map(|c| first[c] + reduced * f64::from(picture[c]));
        let side = f64::from(SIDE);
        if first.iter().all(|x| *x <= 0.0) && last.iter().all(|x| *x >= side) {
            return false;
        }
        // Pixels whose middles are in the picture.
        let range = |c: usize| {
            let [from, to] = [first[c], last[c]].map(|x| (x - 0.5).clamp(0.0, side).ceil());
            (from as u32, to as u32)
        };
        let ((left, right), (top, bottom)) = (range(0), range(1));
        self.inside.clear();
        for y in top..bottom {
            self.inside.fill_span(y, left as i32, right as i32);
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::FREE_ANGLES;
    use nalgebra::{UnitQuaternion, Vector3};

    fn tracked(bent: &[Finger], iou: f64) -> TrackedState {
        let mut free = [0.0; FREE_ANGLES];
        for (finger, degrees) in Finger::LONG.into_iter().zip([12.0f64, 0.0, 9.0, 20.0]) {
            free[finger.free_abduction()] = degrees.to_radians();
        }
        for &finger in bent {
            free[finger.free_base()] = 1.4;
            free[finger.free_abduction()] *= 0.2;
            free[finger.free_outer()] = 1.6;
        }
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.7);
        let state = ModelState { rotation, free, ..ModelState::facing([300.0, 200.0], 900.0) };
        TrackedState { state, iou, valid: iou > 0.6, evaluations: 1, restarted: false, joints_away: None }
    }

    fn fresh() -> Confidence {
        Confidence::new(&Morphology::default(), Side::Right, 0.6)
    }

    #[test]
    fn an_open_hand_is_sure_and_a_fist_is_not() {
        let open = fresh().of(&tracked(&[], 0.97));
        let one = fresh().of(&tracked(&[Finger::Middle], 0.97));
        let fist = fresh().of(&tracked(&Finger::LONG, 0.97));
        println!("{open} {one} {fist}");
        assert!(open > 0.95 && one < 0.9 && one > 0.5 && fist < 0.25 && fist > 0.005, "{open} {one} {fist}");
        assert!(fresh().of(&tracked(&[], 0.75)) < 0.5);
        assert_eq!(fresh().of(&tracked(&[], 0.3)), 0.0);
    }

    #[test]
    fn the_way_the_hand_points_and_its_size_do_not_matter() {
        let seen = fresh().visible(&tracked(&[Finger::Ring], 0.9).state);
        for turn in 0..8 {
            let mut state = tracked(&[Finger::Ring], 0.9).state;
            state.rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), f64::from(turn) * 0.8);
            state.scale = 300.0 + 100.0 * f64::from(turn);
            let other = fresh().visible(&state);
            for (a, b) in seen.iter().zip(other) {
                assert!((a - b).abs() < 0.12, "{turn}: {seen:?} {other:?}");
            }
        }
    }

    #[test]
    fn fingers_beyond_the_border_are_not_seen() {
        let open = tracked(&[], 0.97);
        let sure = fresh().of(&open);
        // The wrist at (300, 200), the fingers up and to the left of it, 170 pixels long.
        assert_eq!(fresh().within(640, 480).of(&open), sure);
        let seen = |wrist: [f64; 2]| {
            let mut moved = open.clone();
            moved.state.wrist = wrist;
            (fresh().within(640, 480).visible(&moved.state), fresh().within(640, 480).of(&moved))
        };
        let (fingers, half) = seen([300.0, 60.0]);
        assert!(half < 0.5 && fingers[Finger::Middle as usize] < 0.3, "{half} {fingers:?}");
        let (fingers, none) = seen([300.0, 30.0]);
        assert!(none < 0.05 && fingers[Finger::Middle as usize] == 0.0, "{none} {fingers:?}");
        let (_, outside) = seen([-2000.0, 9000.0]);
        assert!(outside < 0.05, "{outside}");
    }

    #[test]
    fn confidence_is_low_for_a_while_after_loss_and_jumps() {
        let mut c = fresh();
        let open = tracked(&[], 0.97);
        let sure = c.of(&open);
        c.of(&tracked(&[], 0.2));
        let back: Vec<f64> = (0..7).map(|_| c.of(&open)).collect();
        assert!(
            back[0] < 0.55 * sure && back.windows(2).all(|w| w[1] >= w[0]) && back[6] == sure,
            "{back:?}"
        );
        let mut other = open.clone();
        other.state.free[Finger::Index.free_base()] += 1.0;
        assert!(c.of(&other) < 0.75 * sure);
        assert!(c.of(&TrackedState { restarted: true, ..other.clone() }) < 0.55 * sure);
        c.reset();
        assert_eq!(c.of(&open), sure);
    }
}
