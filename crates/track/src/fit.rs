//! Fit of the model to a person's hand from one silhouette of the open hand (paper 5.2 and 6.4.2).

use nalgebra::{UnitQuaternion, Vector3};

use super::camera::PinholeCamera;
use super::forearm::Forearm;
use super::model::HandModel;
use super::objective::{NonOverlap, Window};
use super::simplex::Downhill;
use super::state::ModelState;
use handcast_hand::{
    FREE_ANGLES, Finger, FingerMorphology, FreeAngles, Joint, JointAngle, Morphology, Side, limits,
};
use handcast_vision::sighting::JOINTS;
use handcast_vision::tuning::tuning;
use handcast_vision::{Chirality, Halves, Mask};

/// Which face of the hand the camera sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum View {
    /// The palm.
    Palm,
    /// The back of the hand.
    Back,
}

impl View {
    /// `palm` or `back`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Palm => "palm",
            Self::Back => "back",
        }
    }

    /// The view of a hand whose thumb is on the right of the image when the fingers point up
    /// (`thumb_right`). A silhouette shows that much and no more.
    pub fn of(side: Side, thumb_right: bool) -> Self {
        if (side == Side::Right) == thumb_right { View::Palm } else { View::Back }
    }

    /// The view of a hand whose joints a finder has seen at these places, in pixels to the right and down, and how surely: the
    /// sine of the angle from the one knuckle to the other, seen from the wrist; near 0 the hand shows its edge.
    pub(super) fn of_joints(points: &[[f64; 2]; JOINTS], side: Side) -> (Self, f64) {
        let from_wrist = |k: usize| [0, 1].map(|c| points[k][c] - points[0][c]);
        let (index, little) = (from_wrist(5), from_wrist(17));
        let lengths = index[0].hypot(index[1]) * little[0].hypot(little[1]);
        // Negative means that the index finger is clockwise from the little one, on the right.
        let sine = (index[0] * little[1] - index[1] * little[0]) / lengths.max(1e-9);
        (Self::of(side, sine < 0.0), sine.abs())
    }

    /// The side of a hand seen like this.
    pub fn side(self, thumb_right: bool) -> Side {
        if (self == View::Palm) == thumb_right { Side::Right } else { Side::Left }
    }

    /// The side of the thumb, which who names hand and view has named.
    pub fn told_thumb(side: Option<Side>, view: Option<Self>) -> Option<Chirality> {
        let right = View::of(side?, true) == view?;
        Some(if right { Chirality::RightPalmOrLeftBack } else { Chirality::LeftPalmOrRightBack })
    }

    /// Side and view of a hand whose thumb is on the right or not, with what is known of it, and whether
    /// the view had to be assumed. `side` counts before `view`.
    pub fn settle(side: Option<Side>, view: Option<View>, thumb_right: bool) -> (Side, View, bool) {
        match (side, view) {
            (Some(side), _) => (side, View::of(side, thumb_right), false),
            (None, Some(view)) => (view.side(thumb_right), view, false),
            (None, None) => (View::Palm.side(thumb_right), View::Palm, true),
        }
    }
}

/// The landmarks of an open hand in the image, from which the fit starts: pixels, y down.
#[derive(Clone, Debug, PartialEq)]
pub struct OpenHand {
    /// The wrist.
    pub wrist: [f64; 2],
    /// Tips of thumb, index, middle, ring and little finger.
    pub tips: [[f64; 2]; Finger::COUNT],
    /// Directions of the five fingers, from base to tip, unit length.
    pub directions: [[f64; 2]; Finger::COUNT],
    /// Half the width of each finger.
    pub radii: [f64; Finger::COUNT],
}

impl OpenHand {
    /// Whether the thumb is on the right when the fingers point up.
    pub fn thumb_right(&self) -> bool {
        let from_wrist = |finger: Finger| [0, 1].map(|k| self.tips[finger as usize][k] - self.wrist[k]);
        let (axis, thumb) = (from_wrist(Finger::Middle), from_wrist(Finger::Thumb));
        // y points down: positive cross product means clockwise from the axis, to the right.
        axis[0] * thumb[1] - axis[1] * thumb[0] > 0.0
    }

    /// Mean distance of the long fingertips from the wrist, pixels: it is largest where they are straight, and the hand is near.
    pub fn reach(&self) -> f64 {
        let distance = |tip: &[f64; 2]| (tip[0] - self.wrist[0]).hypot(tip[1] - self.wrist[1]);
        self.tips[1..].iter().map(distance).sum::<f64>() / Finger::LONG.len() as f64
    }

    /// Area of the polygon of wrist and fingertips, square pixels: it is largest where the hand is spread, faces the
    /// camera, and is near.
    pub fn spread(&self) -> f64 {
        let [thumb, index, middle, ring, little] = self.tips;
        let corners = [self.wrist, thumb, index, middle, ring, little];
        let next = corners.iter().cycle().skip(1);
        let twice: f64 = corners.iter().zip(next).map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum();
        0.5 * twice.abs()
    }
}

/// A person's hand as found in one image.
#[derive(Clone, Debug)]
pub struct Fit {
    /// Sizes, metres, at the hand length that was given.
    pub morphology: Morphology,
    /// Left or right.
    pub side: Side,
    /// Where and how the hand is in the image.
    pub state: ModelState,
    /// Where the silhouette was cut from the forearm.
    pub forearm: Option<Forearm>,
    /// Intersection over union of the fitted model and the silhouette.
    pub iou: f64,
    /// Evaluations of the non-overlap rate.
    pub evaluations: usize,
}

impl Fit {
    /// The angle of a finger in the plane of the palm, radians: its abduction, of the thumb its CMC flexion.
    pub fn in_plane(&self, finger: Finger) -> f64 {
        self.state.free[in_plane_slot(finger)]
    }
}

/// Where the angle of a finger in the plane of the palm is in [`handcast_hand::Domain::FREE`].
fn in_plane_slot(finger: Finger) -> usize {
    if finger == Finger::Thumb { finger.free_base() } else { finger.free_abduction() }
}

/// The angle of a finger in the plane of the palm: abduction, of the thumb the flexion of its CMC joint.
fn in_plane_angle(finger: Finger) -> JointAngle {
    if finger == Finger::Thumb { finger.base_flexion() } else { finger.abduction() }
}

/// How the fit searches.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct FitOptions {
    /// Wrist to middle fingertip, metres: the scale that one image cannot show.
    pub hand_length: f64,
    /// The camera, for perspective; without, the projection is orthographic.
    pub camera: Option<PinholeCamera>,
    /// Rounds over palm and fingers.
    pub rounds: usize,
    /// The tuning constants.
    pub tuning: FitTuning,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self { hand_length: 0.189, camera: None, rounds: 3, tuning: FitTuning::default() }
    }
}

impl FitOptions {
    /// Sets [`FitOptions::hand_length`].
    #[must_use]
    pub fn with_hand_length(mut self, hand_length: f64) -> Self {
        self.hand_length = hand_length;
        self
    }

    /// Sets [`FitOptions::camera`].
    #[must_use]
    pub fn with_camera(mut self, camera: PinholeCamera) -> Self {
        self.camera = Some(camera);
        self
    }

    /// Sets [`FitOptions::rounds`].
    #[must_use]
    pub fn with_rounds(mut self, rounds: usize) -> Self {
        self.rounds = rounds;
        self
    }

    /// Sets [`FitOptions::tuning`].
    #[must_use]
    pub fn with_tuning(mut self, tuning: FitTuning) -> Self {
        self.tuning = tuning;
        self
    }
}

tuning! {
    /// How an open hand is fitted.
    pub struct FitTuning {
        /// How far around the silhouette the model may lie: share of the silhouette's larger side.
        ["1", "chosen by eye"]
        pub margin: f64 = 0.2,
        /// Length of a hand in the image from which on it is first looked for at half the size.
        ["pixels", "handcast bench fit"]
        pub coarse_from: f64 = 200.0,
        /// MCP flexion of the long fingers of an open hand, which a picture of it hardly shows.
        ["°", "mean of spread hands recorded by a Leap Motion sensor"]
        pub open_mcp: f64 = 3.0,
        /// Their PIP flexion.
        ["°", "mean of spread hands recorded by a Leap Motion sensor"]
        pub open_pip: f64 = 6.0,
        /// Abduction of an open hand's thumb out of the palm.
        ["°", "mean of spread hands recorded by a Leap Motion sensor"]
        pub open_thumb: f64 = 10.0,
        /// Share of its static limits that an angle in the plane of the palm may have at the start.
        ["1", "chosen by eye"]
        pub start_limit: f64 = 0.9,
        /// Least and largest breadth of a finger at the start, over the mean's.
        ["1", "chosen by eye"]
        pub start_breadth: [f64; 2] = [0.6, 1.6],
        /// Least and largest length of a finger at the start, over the mean's.
        ["1", "chosen by eye"]
        pub start_length: [f64; 2] = [0.6, 1.5],
        /// A simplex whose values differ by less than this fraction is done.
        ["1", "handcast bench fit"]
        pub tolerance: f64 = 1e-3,
        /// Most evaluations of one minimisation.
        ["evaluations", "handcast bench fit"]
        pub evaluations: usize = 220,
        /// Factor of the first steps of the palm's last minimisation.
        ["1", "handcast bench fit"]
        pub last_spread: f64 = 0.3,
        /// First steps (eq. 9) of the palm: the wrist's place (x and y, hand lengths), turn in the image (rad), logarithms
        /// of the wrist's breadth, of the palm's breadth and of its length.
        ["hand lengths, rad, 1", "handcast bench fit"]
        pub palm_steps: [f64; PALM_PARAMETERS] = [0.04, 0.04, 0.06, 0.15, 0.08, 0.08],
        /// Weight of the palm's prior against a non-overlap rate of 1.
        ["1", "handcast bench fit"]
        pub palm_prior: f64 = 0.1,
        /// Weight of how far the long fingertips are from where the outline has them, squared, against a non-overlap rate of 1, where
        /// a fit without it has put a finger elsewhere.
        ["1 / hand lengths²", "rendered hands by another mesh: no finger is taken for its neighbour"]
        pub tips: f64 = 10.0,
        /// Distance of a fingertip that costs nothing, and beyond which a finger is elsewhere.
        ["hand lengths", "chosen: half a finger's breadth and what the outline's tips are off"]
        pub tip_error: f64 = 0.06,
        /// First steps of a finger: its base (x and y, finger lengths), logarithms of its length and of its breadth at the
        /// base and at the tip, angle in the plane of the palm (rad), web (bones), and of the thumb IP flexion (rad).
        ["finger lengths, rad, 1", "handcast bench fit"]
        pub finger_steps: [f64; THUMB_PARAMETERS] = [0.06, 0.06, 0.08, 0.1, 0.1, 0.08, 0.1, 0.15],
        /// Webs of the mean hand: the thumb's, and those between the long fingers, half way along the first phalanges.
        ["bones", "fits of rendered and real hands with a weak prior find 0.8 to 1.2 for the thumb, 0.35 to 0.6 for the others; the thumb's is the best of four values for the rendered ones"]
        pub mean_webs: [f64; 2] = [0.95, 0.48],
        /// How much longer the long fingers' end phalanges of the mean hand are than their bones: flesh reaches beyond these.
        ["hand lengths", "pulp of 4 mm beyond the bones of Buchholz et al. 1992"]
        pub pulp: f64 = 0.022,
        /// Least and largest web.
        ["bones", "chosen by eye"]
        pub webs: [f64; 2] = [0.05, 1.2],
        /// The prior of a finger.
        pub finger_prior: FingerPriorTuning,
    }
}

tuning! {
    /// Weights in the prior of a finger, of squared differences from the mean hand.
    pub struct FingerPriorTuning {
        /// Of the whole, against a non-overlap rate of 1.
        ["1", "handcast bench fit"]
        pub weight: f64 = 0.02,
        /// Of its base, in finger lengths; the logarithm of its length counts 1.
        ["1", "handcast bench fit"]
        pub base: f64 = 8.0,
        /// Of the logarithms of its radii.
        ["1", "handcast bench fit"]
        pub radius: f64 = 0.3,
        /// Of its web, in bones.
        ["1", "rendered hands by another mesh: knuckles 3 to 5 % of the hand nearer to the truth"]
        pub web: f64 = 2.0,
        /// Of the thumb's IP flexion, in radians.
        ["1", "handcast bench fit"]
        pub thumb_flexion: f64 = 0.3,
    }
}

impl FitTuning {
    /// The mean hand as an outline shows it: fingertips with their pulp, in fingers of the same length.
    fn mean_hand(&self, hand_length: f64) -> Morphology {
        let mut mean = Morphology::average(hand_length);
        let [thumb, long] = self.mean_webs;
        mean.webs = [thumb, long, long, long];
        for finger in &mut mean.fingers[1..] {
            let [first, middle, end] = finger.bones;
            let longer = end + self.pulp * hand_length;
            let rest = 1.0 - (longer - end) / (first + middle);
            finger.bones = [rest * first, rest * middle, longer];
        }
        mean
    }

    /// The free angles of an open hand, radians, where a picture hardly shows them.
    fn relaxed(&self) -> FreeAngles {
        let mut free = [0.0; FREE_ANGLES];
        for finger in Finger::LONG {
            free[finger.free_base()] = self.open_mcp.to_radians();
            free[finger.free_outer()] = self.open_pip.to_radians();
        }
        free[Finger::Thumb.free_abduction()] = self.open_thumb.to_radians();
        free
    }
}

/// Parameters of the palm.
const PALM_PARAMETERS: usize = 6;
/// Parameters of the thumb; the other fingers have one less.
const THUMB_PARAMETERS: usize = 8;

/// Fits sizes, position, scale, orientation and abduction to the silhouette of an open hand: flexions
/// are taken as those of a relaxed open hand (the paper takes zero) and the optical axis as perpendicular to the palm (6.4.2). The first state
/// is read off `open`; the downhill simplex on the non-overlap rate refines palm and fingers in turn, with a cost
/// for leaving the anthropometric means. `None` when the silhouette is empty.
pub fn fit_open_hand(
    silhouette: &Mask,
    forearm: Option<Forearm>,
    open: &OpenHand,
    side: Side,
    view: View,
    options: &FitOptions,
) -> Option<Fit> {
    let tuning = &options.tuning;
    let window = Window::around(silhouette, forearm, tuning.margin)?;
    let fit = |tips: f64| {
        let mut fitter = Fitter::start(open, side, view, tips, options);
        fitter.run(silhouette, forearm, &window, options)?;
        let strays = fitter.strays();
        Some((fitter.finish(&window, forearm, options.hand_length)?, strays))
    };
    let (first, strays) = fit(0.0)?;
    if !strays || tuning.tips <= 0.0 {
        return Some(first);
    }
    // Outlines of narrow hands overlap a little less with every finger in its neighbour's place.
    let (second, _) = fit(tuning.tips)?;
    Some(if second.iou > first.iou { second } else { first })
}

/// The mean hand as large as the long fingers found so far: they are seen whole, and one picture shows no scale.
fn resized(average: &Morphology, found: &Morphology) -> Morphology {
    let longer = |&finger: &Finger| (found.finger(finger).length() / average.finger(finger).length()).ln();
    let mean = Finger::LONG.iter().map(longer).sum::<f64>() / Finger::LONG.len() as f64;
    average.scaled(mean.exp())
}

/// Squared difference of the logarithms of two sizes.
fn squared_log_ratio(a: f64, b: f64) -> f64 {
    (a / b).ln().powi(2)
}

/// Half the palm's thickness, which is the thumb's diameter (paper 5.2).
fn thickness(thumb_radii: &[f64; 4]) -> f64 {
    thumb_radii[1]
}

/// Landmarks of a hand whose place in the image is known.
struct Placed<'a> {
    open: &'a OpenHand,
    /// Pixels per metre.
    scale: f64,
    /// Turn in the image, radians.
    turn: f64,
    /// 1 where the thumb is on the right when the fingers point up, else −1.
    lateral: f64,
}

impl Placed<'_> {
    /// The angle of a finger in the plane of the palm, radians, within this share of its limits.
    fn in_plane(&self, finger: Finger, limit: f64) -> f64 {
        let d = self.open.directions[finger as usize];
        // Direction in the hand frame of a right palm: radial component first.
        let (s, c) = self.turn.sin_cos();
        let along = -d[0] * s - d[1] * c;
        let radial = self.lateral * (d[0] * c - d[1] * s);
        let outward = radial.atan2(along);
        let angle = match finger {
            Finger::Thumb => std::f64::consts::FRAC_PI_4 - outward,
            Finger::Index | Finger::Middle => outward,
            Finger::Ring | Finger::Pinky => -outward,
        };
        let l = limits(in_plane_angle(finger));
        angle.clamp(limit * l.min, limit * l.max)
    }

    /// Gives a finger the breadth that it has in the image, and a long finger the length that brings its tip to where
    /// it is.
    fn size(&self, finger: Finger, f: &mut FingerMorphology, tuning: &FitTuning) {
        let i = finger as usize;
        let radius = self.open.radii[i] / self.scale;
        let [least, largest] = tuning.start_breadth;
        let widen = (radius / f.radii[1]).clamp(least, largest);
        f.radii = f.radii.map(|r| r * widen);
        if finger != Finger::Thumb {
            let (s, c) = self.turn.sin_cos();
            let p = [self.open.tips[i][0] - self.open.wrist[0], self.open.wrist[1] - self.open.tips[i][1]];
            let tip = [self.lateral * (p[0] * c + p[1] * s) / self.scale, (p[1] * c - p[0] * s) / self.scale];
            let length = (tip[0] - f.base[0]).hypot(tip[1] - f.base[1]);
            let [least, largest] = tuning.start_length;
            let stretch = (length / f.length()).clamp(least, largest);
            f.bones = f.bones.map(|b| b * stretch);
        }
    }
}

/// A fit on its way.
struct Fitter<'a> {
    tuning: &'a FitTuning,
    /// The mean hand, of the length that was given.
    average: Morphology,
    morphology: Morphology,
    state: ModelState,
    model: HandModel,
    objective: NonOverlap,
    downhill: Downhill,
    /// Tips of the long fingers in the picture, pixels.
    tips: LongTips,
    /// What a stray tip costs.
    tips_weight: f64,
}

/// Pixels, or one number for each, of the tips of the long fingers.
type LongTips<T = [f64; 2]> = [T; Finger::LONG.len()];

/// How far the model's long fingertips are from these places, hand lengths.
fn tip_errors(model: &HandModel, state: &ModelState, tips: &LongTips) -> LongTips<f64> {
    let joints = model.joints(state);
    let hand = state.scale * model.morphology().hand_length;
    std::array::from_fn(|i| {
        let found = joints[Joint::tip(Finger::LONG[i]).index()];
        (found[0] - tips[i][0]).hypot(found[1] - tips[i][1]) / hand
    })
}

impl<'a> Fitter<'a> {
    /// The mean hand, as wide, as long and turned as the landmarks have it.
    fn start(open: &OpenHand, side: Side, view: View, tips_weight: f64, options: &'a FitOptions) -> Self {
        let tuning = &options.tuning;
        let average = tuning.mean_hand(options.hand_length);
        let mut morphology = average.clone();
        let to = |p: [f64; 2]| [p[0] - open.wrist[0], open.wrist[1] - p[1]];
        let middle = to(open.tips[Finger::Middle as usize]);
        let scale = middle[0].hypot(middle[1]) / options.hand_length;
        // The mean of the middle and ring fingers' directions steadies the axis (6.4.2 takes the
        // axis of inertia of the silhouette).
        let ring = to(open.tips[Finger::Ring as usize]);
        let lateral = if open.thumb_right() { 1.0 } else { -1.0 };
        let axis = [middle[0] + ring[0], middle[1] + ring[1]];
        // On the average hand that mean lies this far to the side of the little finger.
        let lean = (morphology.finger(Finger::Ring).base[0] / (2.0 * options.hand_length)).atan();
        let turn = (-axis[0]).atan2(axis[1]) + lateral * lean;
        let facing = match view {
            View::Palm => UnitQuaternion::identity(),
            View::Back => UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::PI),
        };
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn) * facing;
        let mut free = tuning.relaxed();
        let placed = Placed { open, scale, turn, lateral };
        for finger in Finger::ALL {
            free[in_plane_slot(finger)] = placed.in_plane(finger, tuning.start_limit);
            placed.size(finger, &mut morphology.fingers[finger as usize], tuning);
        }
        let state = ModelState { rotation, free, ..ModelState::facing(open.wrist, scale) };
        let mut model = HandModel::new(&morphology, side);
        if let Some(camera) = options.camera {
            model = model.with_camera(camera);
        }
        morphology.palm_radius = thickness(&morphology.fingers[0].radii);
        Self {
            tuning,
            average,
            morphology,
            state,
            model,
            objective: NonOverlap::default(),
            downhill: Downhill::new(tuning.tolerance, tuning.evaluations),
            tips: Finger::LONG.map(|finger| open.tips[finger as usize]),
            tips_weight,
        }
    }

    /// All rounds; `None` when the silhouette is empty.
    fn run(
        &mut self,
        silhouette: &Mask,
        forearm: Option<Forearm>,
        window: &Window,
        options: &FitOptions,
    ) -> Option<()> {
        let tuning = self.tuning;
        let rounds = options.rounds.max(1);
        // Where a hand lies is seen as well at half the size, in a third of the time.
        let coarse = if self.state.scale * options.hand_length > tuning.coarse_from { rounds - 1 } else { 0 };
        if coarse > 0 {
            let half = forearm.map(|f| Forearm { cut: f.cut.map(|v| 0.5 * v), ..f });
            let mut halved = Mask::default();
            silhouette.reduce_into(2, Halves::All, &mut halved);
            let window = Window::around(&halved, half, tuning.margin)?;
            self.rescale(0.5, options.camera);
            (0..coarse).for_each(|round| self.round(&window, round));
            self.rescale(2.0, options.camera);
        }
        (coarse..rounds).for_each(|round| self.round(window, round));
        self.palm(&resized(&self.average, &self.morphology), window, tuning.last_spread);
        Some(())
    }

    /// Whether a long finger is not where the outline has it.
    fn strays(&self) -> bool {
        tip_errors(&self.model, &self.state, &self.tips).iter().any(|error| *error > self.tuning.tip_error)
    }

    /// Palm and fingers in turn; the search narrows from round to round.
    fn round(&mut self, window: &Window, round: usize) {
        let spread = 1.0 / (1 + round) as f64;
        let average = resized(&self.average, &self.morphology);
        self.palm(&average, window, spread);
        for finger in Finger::ALL {
            self.finger(&average, finger, window, spread);
        }
    }

    /// Goes over to an image `factor` times the size; `camera` is that of the full size.
    fn rescale(&mut self, factor: f64, camera: Option<PinholeCamera>) {
        self.state.wrist = self.state.wrist.map(|v| v * factor);
        self.state.scale *= factor;
        self.tips = self.tips.map(|tip| tip.map(|v| v * factor));
        if let Some(camera) = camera {
            self.model.set_camera(if factor < 1.0 { camera.reduced(2) } else { camera });
        }
    }

    /// Minimises the non-overlap rate plus `weight` times `prior`, what is unlikely of a hand, over the
    /// parameters that `change` understands: 0 leaves everything as it is.
    fn minimise(
        &mut self,
        window: &Window,
        steps: &[f64],
        change: impl Fn(&[f64], &mut Morphology, &mut ModelState),
        weight: f64,
        prior: impl Fn(&Morphology, &ModelState) -> f64,
    ) {
        let Self { tuning, morphology, state, model, objective, downhill, tips, tips_weight, .. } = self;
        let strays = |model: &HandModel, state: &ModelState| {
            let beyond = |error: f64| (error - tuning.tip_error).max(0.0).powi(2);
            *tips_weight * tip_errors(model, state, tips).map(beyond).iter().sum::<f64>()
        };
        let at = |p: &[f64]| {
            let (mut m, mut s) = (morphology.clone(), state.clone());
            change(p, &mut m, &mut s);
            (m, s)
        };
        let mut p = [0.0; THUMB_PARAMETERS];
        let p = &mut p[..steps.len()];
        objective.begin();
        downhill.minimise(
            p,
            steps,
            |_, _| 1.0,
            |p| {
                let (m, s) = at(p);
                if m.validate().is_err() {
                    return f64::MAX;
                }
                model.set_morphology(&m);
                let cost = objective.rate_beside(model, &s, window) + weight * prior(&m, &s);
                if *tips_weight > 0.0 { cost + strays(model, &s) } else { cost }
            },
        );
        let (m, s) = at(p);
        model.set_morphology(&m);
        (*morphology, *state) = (m, s);
    }

    /// Wrist position, orientation in the image, wrist breadth, length and breadth of the palm.
    fn palm(&mut self, average: &Morphology, window: &Window, spread: f64) {
        let hand = self.morphology.hand_length * self.state.scale;
        let change = |p: &[f64], m: &mut Morphology, s: &mut ModelState| {
            m.wrist_half_width *= p[3].exp();
            for f in &mut m.fingers[1..] {
                f.base[0] *= p[4].exp();
                f.base[1] *= p[5].exp();
            }
            s.wrist = [s.wrist[0] + hand * p[0], s.wrist[1] + hand * p[1]];
            s.rotation = s.turned([0.0, 0.0, p[2]]);
        };
        let steps = self.tuning.palm_steps.map(|v| v * spread);
        self.minimise(window, &steps, change, self.tuning.palm_prior, |m, _| {
            let long = m.fingers[1..].iter().zip(&average.fingers[1..]);
            squared_log_ratio(m.wrist_half_width, average.wrist_half_width)
                + long.map(|(a, b)| squared_log_ratio(a.base[1], b.base[1])).sum::<f64>()
        });
    }

    /// Base, length, radii and direction of one finger and the web on its thumb's side; of the thumb also the
    /// bend of its end joint, and the palm's thickness, which is its diameter (paper 5.2).
    fn finger(&mut self, average: &Morphology, finger: Finger, window: &Window, spread: f64) {
        let i = finger as usize;
        let thumb = finger == Finger::Thumb;
        let mean = &average.fingers[i];
        let length = mean.length();
        let web = i.saturating_sub(1);
        let webs = self.tuning.webs;
        let (slot, outer) = (in_plane_slot(finger), Finger::Thumb.free_outer());
        let (swing, bend) = (limits(in_plane_angle(finger)), limits(JointAngle::Thumb3Flexion));
        let change = |p: &[f64], m: &mut Morphology, s: &mut ModelState| {
            let f = &mut m.fingers[i];
            f.base[0] += length * p[0];
            f.base[1] += length * p[1];
            f.bones = f.bones.map(|b| b * p[2].exp());
            // Width at the base and at the tip apart: how much fingers taper differs between people.
            for (k, r) in f.radii.iter_mut().enumerate() {
                let t = k as f64 / 3.0;
                *r *= ((1.0 - t) * p[3] + t * p[4]).exp();
            }
            m.webs[web] = (m.webs[web] + p[6]).clamp(webs[0], webs[1]);
            s.free[slot] = (s.free[slot] + p[5]).clamp(swing.min, swing.max);
            if thumb {
                f.metacarpal = f.base;
                m.palm_radius = thickness(&f.radii);
                s.free[outer] = (s.free[outer] + p[7]).clamp(bend.min, bend.max);
            }
        };
        let steps = self.tuning.finger_steps.map(|v| v * spread);
        let steps = &steps[..if thumb { THUMB_PARAMETERS } else { THUMB_PARAMETERS - 1 }];
        let t = self.tuning.finger_prior;
        self.minimise(window, steps, change, t.weight, |m, s| {
            let f = &m.fingers[i];
            t.base * ((f.base[0] - mean.base[0]) / length).powi(2)
                + t.base * ((f.base[1] - mean.base[1]) / length).powi(2)
                + squared_log_ratio(f.length(), length)
                + t.radius
                    * f.radii.iter().zip(&mean.radii).map(|(a, b)| squared_log_ratio(*a, *b)).sum::<f64>()
                + t.web * (m.webs[web] - average.webs[web]).powi(2)
                + t.thumb_flexion * s.free[outer].powi(2)
        });
    }

    /// Brings the hand to the given length: sizes scaled one way, the image scale the other.
    fn finish(mut self, window: &Window, forearm: Option<Forearm>, hand_length: f64) -> Option<Fit> {
        let middle = self.morphology.finger(Finger::Middle);
        let found = middle.base[0].hypot(middle.base[1]) + middle.length();
        let factor = hand_length / found;
        let mut morphology = self.morphology.scaled(factor);
        morphology.hand_length = hand_length;
        for finger in Finger::ALL {
            morphology.fingers[finger as usize].place_metacarpal(finger);
        }
        self.state.scale /= factor;
        self.model.set_morphology(&morphology);
        morphology.validate().ok()?;
        self.objective.rate(&mut self.model, &self.state, window);
        Some(Fit {
            side: self.model.side(),
            forearm,
            iou: self.objective.last_iou(window),
            evaluations: self.objective.evaluations(),
            morphology,
            state: self.state,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pulp_makes_end_phalanges_longer_and_no_finger() {
        let tuning = FitTuning::default();
        let (mean, bones) = (tuning.mean_hand(0.189), Morphology::average(0.189));
        mean.validate().unwrap();
        for finger in Finger::ALL {
            let (of, before) = (mean.finger(finger), bones.finger(finger));
            assert!((of.length() - before.length()).abs() < 1e-12, "{finger:?}");
            let pulp = if finger == Finger::Thumb { 0.0 } else { tuning.pulp * 0.189 };
            assert!((of.bones[2] - before.bones[2] - pulp).abs() < 1e-12, "{finger:?}");
        }
        // Bones of another size are those of the mean hand in that size.
        let found = mean.scaled(1.2);
        let palm = resized(&mean, &found).fingers.map(|f| f.base);
        assert!(
            palm.iter()
                .flatten()
                .zip(found.fingers.map(|f| f.base).iter().flatten())
                .all(|(a, b)| (a - b).abs() < 1e-12)
        );
    }

    /// Landmarks read off the true model, and its silhouette.
    fn scene(morphology: &Morphology, side: Side, state: &ModelState) -> (Mask, OpenHand) {
        let mut model = HandModel::new(morphology, side);
        let mut mask = Mask::new(480, 360);
        model.draw(state, [0.0, 0.0], &mut mask);
        let joints = model.joints(state);
        let open = OpenHand {
            wrist: joints[0],
            tips: Finger::ALL.map(|f| joints[Joint::tip(f).index()]),
            directions: Finger::ALL.map(|f| {
                let chain = Joint::of(f);
                let a = joints[chain[chain.len() - 3].index()];
                let b = joints[Joint::tip(f).index()];
                let n = (b[0] - a[0]).hypot(b[1] - a[1]);
                [(b[0] - a[0]) / n, (b[1] - a[1]) / n]
            }),
            radii: Finger::ALL.map(|f| state.scale * morphology.finger(f).radii[1]),
        };
        (mask, open)
    }

    fn open_state(turn: f64, facing: UnitQuaternion<f64>) -> ModelState {
        let mut free = [0.0; FREE_ANGLES];
        for (finger, degrees) in Finger::LONG.into_iter().zip([12.0f64, 2.0, 9.0, 20.0]) {
            free[finger.free_abduction()] = degrees.to_radians();
        }
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn) * facing;
        ModelState { rotation, free, ..ModelState::facing([240.0, 280.0], 1150.0) }
    }

    #[test]
    fn a_hand_is_spread_by_its_fingers_and_its_thumb() {
        let spread = |state: &ModelState| scene(&Morphology::default(), Side::Right, state).1.spread();
        let open = open_state(0.0, UnitQuaternion::identity());
        let turned = open_state(0.7, UnitQuaternion::identity());
        assert!((spread(&turned) / spread(&open) - 1.0).abs() < 1e-6);
        let mut closer = open.clone();
        closer.free[Finger::Index.free_abduction()] = 0.0;
        assert!(spread(&closer) < spread(&open));
        let mut thumb_beside = open.clone();
        thumb_beside.free[Finger::Thumb.free_base()] += 0.4;
        assert!(spread(&thumb_beside) < spread(&open));
        let far = ModelState { scale: 0.5 * open.scale, ..open.clone() };
        assert!((spread(&far) / spread(&open) - 0.25).abs() < 1e-6);
    }

    #[test]
    fn a_hand_reaches_farthest_with_straight_fingers() {
        let reach = |state: &ModelState| scene(&Morphology::default(), Side::Right, state).1.reach();
        let open = open_state(0.0, UnitQuaternion::identity());
        assert!((reach(&open_state(0.7, UnitQuaternion::identity())) / reach(&open) - 1.0).abs() < 1e-6);
        let mut bent = open.clone();
        bent.free[Finger::Ring.free_base()] += 0.6;
        assert!(reach(&bent) < reach(&open));
        let far = ModelState { scale: 0.5 * open.scale, ..open.clone() };
        assert!((reach(&far) / reach(&open) - 0.5).abs() < 1e-6);
    }

    /// How many of these fits have a finger elsewhere: of a narrow hand, whose wrist is taken for up to a fifth of a hand from
    /// where it is.
    fn strays(tuning: FitTuning) -> usize {
        let mut morphology = Morphology::default();
        let mut state = open_state(0.0, UnitQuaternion::identity());
        for finger in Finger::LONG {
            state.free[finger.free_abduction()] *= 0.3;
            morphology.fingers[finger as usize].base[0] *= 0.8;
            morphology.fingers[finger as usize].bones = morphology.finger(finger).bones.map(|b| 0.8 * b);
            morphology.fingers[finger as usize].radii = morphology.finger(finger).radii.map(|b| 0.8 * b);
        }
        let (mask, open) = scene(&morphology, Side::Right, &state);
        let options = FitOptions { tuning, ..FitOptions::default() };
        let hand = 0.189 * state.scale;
        let stray = |[x, y]: [f64; 2]| {
            let moved =
                OpenHand { wrist: [open.wrist[0] + x * hand, open.wrist[1] + y * hand], ..open.clone() };
            let fit = fit_open_hand(&mask, None, &moved, Side::Right, View::Palm, &options).unwrap();
            let joints = HandModel::new(&fit.morphology, Side::Right).joints(&fit.state);
            Finger::LONG.into_iter().any(|finger| {
                let (a, b) = (joints[Joint::tip(finger).index()], open.tips[finger as usize]);
                (a[0] - b[0]).hypot(a[1] - b[1]) > 0.08 * hand
            })
        };
        let places = [-0.2, -0.15, 0.15, 0.2].into_iter().flat_map(|x| [-0.1, 0.0, 0.1].map(|y| [x, y]));
        places.filter(|place| stray(*place)).count()
    }

    #[test]
    fn no_finger_is_taken_for_its_neighbour() {
        let without = strays(FitTuning { tips: 0.0, ..FitTuning::default() });
        println!("{without} of 12 without what fingertips cost");
        assert!(without > 1);
        assert_eq!(strays(FitTuning::default()), 0);
    }

    #[test]
    fn recovers_lengths_angles_and_wrist_of_a_known_hand() {
        let mut morphology = Morphology::average(0.189);
        for (f, (stretch, widen)) in morphology.fingers.iter_mut().zip([
            (1.05, 1.1),
            (0.93, 1.0),
            (1.0, 0.95),
            (1.06, 1.05),
            (0.92, 1.1),
        ]) {
            f.bones = f.bones.map(|b| b * stretch);
            f.radii = f.radii.map(|r| r * widen);
        }
        for (side, view) in [(Side::Right, View::Palm), (Side::Left, View::Back), (Side::Left, View::Palm)] {
            let facing = match view {
                View::Palm => UnitQuaternion::identity(),
                View::Back => UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::PI),
            };
            for turn in [0.0, 0.5, -0.7] {
                let state = open_state(turn, facing);
                let (mask, open) = scene(&morphology, side, &state);
                assert_eq!(View::of(side, open.thumb_right()), view);
                let fit = fit_open_hand(&mask, None, &open, side, view, &FitOptions::default()).unwrap();
                assert!(fit.iou > 0.96, "iou {}", fit.iou);
                let hand = 0.189 * state.scale;
                let wrist = (fit.state.wrist[0] - 240.0).hypot(fit.state.wrist[1] - 280.0) / hand;
                assert!(wrist < 0.04, "wrist off by {wrist} hand lengths");
                for finger in Finger::LONG {
                    let found = fit.state.scale * fit.morphology.finger(finger).length();
                    let truth = state.scale * morphology.finger(finger).length();
                    assert!((found / truth - 1.0).abs() < 0.08, "{} {found} {truth}", finger.name());
                    let i = finger.free_abduction();
                    let off = (fit.state.free[i] - state.free[i]).to_degrees();
                    assert!(off.abs() < 8.0, "{} {off}", finger.name());
                }
            }
        }
    }
}
