//! Registration by gradients: damped Gauss-Newton on the distances between the outlines of the model and of
//! the image, from several starts.
//!
//! In each round the points of the model's outline are paired with the nearest points of the silhouette's
//! outline, and those of the silhouette's with the nearest of the model's. The distances along the normals,
//! robustly weighted (Geman & McClure 1985), and what is believed before looking ([`Belief`]) make a quadratic
//! in the 22 parameters; its minimum under the biomechanical constraints is the next state.
//!
//! Outlines have many local minima: a finger that looks shorter may be bent towards the camera or away from
//! it, and a fist looks like a tilted hand. Other postures are therefore tried where they might explain the
//! silhouette as well, and compared by non-overlap rate (eq. 7), belief and shading. In the later rounds shading
//! turns the bones, too.

mod belief;
mod columns;
mod contact;
mod motion;
mod postures;
mod quadratic;
mod sizes;
mod starts;

pub use belief::{Belief, BeliefOptions, OpenState};

use std::f64::consts::FRAC_PI_2;
use std::ops::Range;

use nalgebra::{UnitQuaternion, Vector3};

use super::appearance::{Appearance, Shaded};
use super::evidence::Evidence;
use super::model::{HandModel, ModelState};
use super::objective::NonOverlap;
use super::outline::{self, OutlinePoint};
use super::projection::{ProjectedSphere, SCALE};
use columns::Columns;
use handcast_hand::{Domain, Shape};
use motion::Motion;
use postures::Postures;
use quadratic::PointSums;
pub(super) use quadratic::Quadratic;
use sizes::Sizes;

/// The length in which distances are measured, metres: that of an average hand.
const HAND: f64 = 0.19;
/// Distance of points along outlines, hand lengths.
const SPACING: f64 = 0.02;
/// Cosine of the largest angle between paired normals.
const FACING: f64 = 0.4;
/// Longest step of a round: hand lengths of the wrist, radians.
const LONGEST: f64 = 0.35;
/// Rounds after which a start may be given up.
const FIRST_ROUNDS: usize = 3;
/// Progress from which on shading is looked at.
const REFINED: f64 = 0.4;
/// Movement in a coarse round after which the fine ones may begin.
const COARSELY: f64 = 0.03;
/// Difference of a joint angle from the open hand within which the hand is nearly open, radians.
const NEARLY_OPEN: f64 = 0.3;
/// Frames among which the other starts are divided while all is as usual.
const TURNS: usize = 3;
/// Share of a new frame in what is usual when it costs less, and when it costs more: wrong postures last, and
/// must not become usual soon.
const LEARNING: f64 = 0.3;
const FORGETTING: f64 = 0.05;
/// Predicted change of a joint angle from which on the last state is a start of its own, radians.
const MOVING: f64 = 0.05;

/// How registration searches. Lengths are in hand lengths in the image.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct RegistrationOptions {
    /// Most rounds of pairing and solving from one start.
    pub rounds: usize,
    /// A round that moves nothing by more than this (hand lengths, radians) is the last.
    pub precision: f64,
    /// Standard deviation of an outline of the image.
    pub noise: f64,
    /// Length of outline over which its errors go together.
    pub correlation: f64,
    /// Distance at which a pair counts as an outlier, in the first round and in the last.
    pub outlier: [f64; 2],
    /// Half the number of standard deviations squared that a non-overlap rate of 1 is worth when postures are
    /// compared.
    pub rate_worth: f64,
    /// Independent samples of luminance that the hand is worth when postures are compared.
    pub shade_worth: f64,
    /// Independent samples of luminance that the hand is worth when it is moved to where shading explains more.
    pub shade_pull: f64,
    /// How much worse than the best a start may be after its first rounds.
    pub hopeless: f64,
    /// How many of the known postures with the most similar silhouettes, each in the best of three turns, are compared,
    /// and how many of those are refined.
    pub known: [usize; 2],
    /// Standard deviation of how deep fingers may be in one another, metres.
    pub contact: f64,
    /// How much more than usual a frame may cost before everything is tried on it.
    pub doubt: f64,
    /// Hands whose fingers close together are tried when their non-overlap rate, before any refinement, is above
    /// that of the present one by no more than twice this.
    pub promising: f64,
    /// Whether the sizes of the hand are refined while it is tracked.
    pub refine_sizes: bool,
    /// What is believed before looking.
    pub belief: BeliefOptions,
}

impl Default for RegistrationOptions {
    fn default() -> Self {
        Self {
            rounds: 6,
            precision: 2e-3,
            noise: 0.009,
            correlation: 0.04,
            outlier: [0.10, 0.04],
            rate_worth: 3000.0,
            shade_worth: 200.0,
            shade_pull: 50.0,
            hopeless: 100.0,
            known: [8, 2],
            contact: 0.001,
            doubt: 100.0,
            promising: 0.05,
            refine_sizes: true,
            belief: BeliefOptions::default(),
        }
    }
}

/// The outcome for one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Registered {
    /// Non-overlap rate (eq. 7).
    pub rate: f64,
    /// Intersection over union.
    pub iou: f64,
    /// What postures are compared by; smaller is better.
    pub cost: f64,
}

/// What one frame is registered with.
struct Scene<'a> {
    model: &'a mut HandModel,
    evidence: &'a Evidence,
    belief: &'a Belief<'a>,
}

/// Registers a model on evidence. Holds the buffers, so that it allocates nothing once they have grown.
#[derive(Clone, Debug)]
pub struct Registration {
    options: RegistrationOptions,
    domain: Domain,
    objective: NonOverlap,
    appearance: Appearance,
    spheres: Vec<ProjectedSphere>,
    outline: Vec<OutlinePoint>,
    columns: Columns,
    motion: Motion,
    /// Those of the model, once a hand has been seen.
    sizes: Option<Sizes>,
    /// Drawn at the first frame.
    postures: Option<Postures>,
    /// Postures to be tried, by cost.
    starts: Vec<(f64, ModelState)>,
    /// What the last frames cost on average.
    usual: Option<f64>,
    /// Whose turn it is.
    frame: usize,
}

impl Registration {
    /// A registration with these options.
    pub fn new(options: RegistrationOptions) -> Self {
        Self {
            options,
            domain: Domain::free(),
            objective: NonOverlap::default(),
            appearance: Appearance::default(),
            spheres: Vec::new(),
            outline: Vec::new(),
            columns: Columns::default(),
            motion: Motion::default(),
            sizes: None,
            postures: None,
            starts: Vec::new(),
            usual: None,
            frame: 0,
        }
    }

    /// Evaluations of the non-overlap rate so far.
    pub fn evaluations(&self) -> usize {
        self.objective.evaluations()
    }

    /// Moves `state`, the last one, to where model and evidence agree best: from the predicted state and from the
    /// same with fingers in other postures; and, in turns while all is as usual, from the last state, from a
    /// thumb bent across the palm, from hands whose fingers close together, and from known postures with similar
    /// silhouettes.
    pub fn register(
        &mut self,
        model: &mut HandModel,
        evidence: &Evidence,
        belief: &Belief<'_>,
        state: &mut ModelState,
    ) -> Registered {
        let scene = &mut Scene { model, evidence, belief };
        let last = std::mem::replace(state, belief.predicted.clone());
        let around = self.linearise(scene, state, 0.0, None);
        let mut best = self.refine(scene, state, 0..self.options.rounds, Some(&around));
        let doubtful = self.usual.is_none_or(|usual| best.cost > usual + self.options.doubt);
        self.frame = (self.frame + 1) % TURNS;
        let frame = self.frame;
        let due = |turn: usize| doubtful || frame == turn;
        if due(0) && last.free.iter().zip(&belief.predicted.free).any(|(a, b)| (a - b).abs() > MOVING) {
            self.start_from(scene, last, state, &mut best);
        }
        if let Some(bent) = self.bent(scene, belief.predicted, &around) {
            self.start_from(scene, bent, state, &mut best);
        }
        if due(1)
            && let Some(closing) = self.closing(scene, state, best.rate)
        {
            self.start_from(scene, closing, state, &mut best);
        }
        if due(0) && state.thumb_mcp.abs() > 2.0 * self.options.belief.thumb_mcp {
            let thumb = self.bent_thumb(scene, state);
            self.start_from(scene, thumb, state, &mut best);
        }
        if due(2) {
            self.try_known_postures(scene, state, &mut best);
        }
        let usual = self.usual.get_or_insert(best.cost);
        *usual += if best.cost < *usual { LEARNING } else { FORGETTING } * (best.cost - *usual);
        best
    }

    /// Forgets what is usual and what the hand looked like: the next frame is doubtful.
    pub fn forget_usual(&mut self) {
        self.usual = None;
        self.motion.forget();
    }

    /// Searches from another start, unless its first rounds lead nowhere near, and keeps what it finds where
    /// that is better than `best` at `state`.
    fn start_from(
        &mut self,
        scene: &mut Scene<'_>,
        mut other: ModelState,
        state: &mut ModelState,
        best: &mut Registered,
    ) {
        let rounds = self.options.rounds;
        let first = FIRST_ROUNDS.min(rounds);
        if self.refine(scene, &mut other, 0..first, None).cost > best.cost + self.options.hopeless {
            return;
        }
        let found = self.refine(scene, &mut other, first..rounds, None);
        if found.cost < best.cost {
            (*state, *best) = (other, found);
        }
    }

    /// Learns what the hand of `state` looks like where it is nearly open, and refines the sizes of `model`. Whether they
    /// changed.
    pub(super) fn learn(
        &mut self,
        model: &mut HandModel,
        evidence: &Evidence,
        open: &OpenState,
        state: &ModelState,
    ) -> bool {
        let bent = state.free.iter().zip(&open.state.free).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        if evidence.has_picture() && bent <= NEARLY_OPEN {
            model.project_moving(state, &mut self.spheres);
            self.appearance.learn(&shaded(model, &self.spheres, state, evidence));
        }
        if !self.options.refine_sizes {
            return false;
        }
        let mut sizes = self.sizes.take().unwrap_or_else(|| Sizes::new(model.morphology()));
        let due = sizes.is_due();
        if due {
            let axis = evidence.window().forearm().map(|f| f.axis);
            let frame = sizes.begin(model, state, open, axis);
            let belief = Belief { predicted: state, open };
            let scene = &mut Scene { model, evidence, belief: &belief };
            let pose = self.linearise(scene, state, 1.0, Some(frame));
            sizes.learn(&pose);
            model.set_morphology(&sizes.morphology());
        }
        self.sizes = Some(sizes);
        due
    }

    /// Moves `state` in these rounds of all. `around`, if known, is the first quadratic.
    fn refine(
        &mut self,
        scene: &mut Scene<'_>,
        state: &mut ModelState,
        rounds: Range<usize>,
        mut around: Option<&Quadratic>,
    ) -> Registered {
        let last = (self.options.rounds.max(2) - 1) as f64;
        let mut settled = false;
        for round in rounds {
            let progress = round as f64 / last;
            if settled && progress <= REFINED {
                continue;
            }
            let quadratic = match around.take() {
                Some(quadratic) => quadratic,
                None => &self.linearise(scene, state, progress, None),
            };
            let moved = self.step(quadratic, scene.belief, state);
            if moved < self.options.precision && progress > REFINED {
                break;
            }
            settled = moved < COARSELY;
        }
        self.judge(scene, state)
    }

    /// How well `state` agrees with the evidence and with what is believed.
    fn judge(&mut self, scene: &mut Scene<'_>, state: &ModelState) -> Registered {
        let o = &self.options;
        let rate = self.objective.rate(scene.model, state, scene.evidence.window());
        let iou = self.objective.last_iou(scene.evidence.window());
        let mut cost = o.rate_worth * rate + scene.belief.against(&o.belief, scene.evidence, state);
        scene.model.project_moving(state, &mut self.spheres);
        cost += contact::against(&self.spheres, self.options.contact);
        if o.shade_worth > 0.0 && scene.evidence.has_picture() {
            let shaded = shaded(scene.model, &self.spheres, state, scene.evidence);
            let unexplained = self.appearance.unexplained(&shaded);
            // The likelihood of samples whose noise is what is left unexplained.
            cost += unexplained.map_or(0.0, |u| 0.5 * o.shade_worth * u.ln());
        }
        Registered { rate, iou, cost }
    }

    /// The quadratic around `state`; `progress` goes from 0 in the first round to 1 in the last. `sizes`, if given, is
    /// filled with the pairs of outline points.
    fn linearise(
        &mut self,
        scene: &mut Scene<'_>,
        state: &ModelState,
        progress: f64,
        sizes: Option<&mut sizes::Frame>,
    ) -> Quadratic {
        let hand = HAND * state.scale;
        let window = scene.evidence.window();
        self.objective.rate(scene.model, state, window);
        let turns = scene.model.project_moving(state, &mut self.spheres);
        if let Some(forearm) = window.forearm() {
            scene.model.add_forearm(state, forearm.axis, &mut self.spheres);
        }
        let forearm = window.forearm().map(|_| &Shape::FOREARM[..]);
        outline::trace(
            scene.model.shape().hulls().chain(forearm),
            &self.spheres,
            (self.objective.drawn(), window.origin()),
            SPACING * hand,
            &mut self.outline,
        );
        if let Some(forearm) = window.forearm() {
            self.outline.retain(|p| forearm.side(p.position) > 3.0);
        }
        let o = &self.options;
        let mut pairs = Pairs {
            spheres: &self.spheres,
            outlier: hand * o.outlier[0] * (o.outlier[1] / o.outlier[0]).powf(progress),
            per_pixel: 1.0 / (o.correlation * hand) / (o.noise * hand).powi(2),
            sums: PointSums::new(),
            sizes,
        };
        for p in &self.outline {
            if let Some(q) = scene.evidence.nearest(p.position)
                && dot(q.normal.map(f64::from), p.normal) > FACING
            {
                pairs.add(p, q.position.map(f64::from), q.normal.map(f64::from), p.length);
            }
        }
        let refined = progress > REFINED;
        let per_pixel = scene.evidence.points_per_pixel();
        let stride = (2.0 * SPACING * hand * per_pixel).round().max(1.0);
        self.columns.load(&self.outline);
        let mut near = None;
        for q in scene.evidence.points().iter().step_by(stride as usize) {
            near = self.columns.nearest(q, near);
            if let Some(p) = near.and_then(|i| self.outline.get(i)) {
                pairs.add(p, q.position.map(f64::from), q.normal.map(f64::from), stride / per_pixel);
            }
        }
        let mut quadratic = pairs.sums.into_quadratic();
        scene.belief.add_to(&mut quadratic, &o.belief, scene.evidence, state);
        contact::add_to(&mut quadratic, &self.spheres, self.options.contact);
        if refined && scene.evidence.has_picture() {
            let shaded = shaded(scene.model, &self.spheres, state, scene.evidence);
            self.appearance.pull(&shaded, &turns, o.shade_pull, &mut quadratic);
        }
        quadratic
    }

    /// Moves `state` to the minimum of the quadratic, but not too far; gives the largest movement (hand
    /// lengths, radians).
    fn step(&self, quadratic: &Quadratic, belief: &Belief<'_>, state: &mut ModelState) -> f64 {
        let step = quadratic.minimum(&state.free, self.domain.half_spaces());
        let hand = HAND * state.scale;
        let moved = step.iter().enumerate().map(|(i, v)| v.abs() / if i < SCALE { hand } else { 1.0 });
        let most = moved.fold(0.0, f64::max);
        let shrink = (LONGEST / most).min(1.0);
        *state = state.stepped(&step.map(|v| v * shrink));
        self.bring_inside(belief, state);
        most
    }

    /// Brings the free angles inside the constraints, on the way to the open hand.
    fn bring_inside(&self, belief: &Belief<'_>, state: &mut ModelState) {
        state.bring_inside(&self.domain, &belief.open.state.free);
    }
}

/// The model of `state`, projected to `spheres`, in front of the picture.
fn shaded<'a>(
    model: &'a HandModel,
    spheres: &'a [ProjectedSphere],
    state: &ModelState,
    evidence: &'a Evidence,
) -> Shaded<'a> {
    Shaded { primitives: model.shape().primitives(), spheres, scale: state.scale, evidence }
}

/// Abduction of a finger whose base is bent by `flexion`, where that of the open hand is `open`, radians: eq. (3), a
/// finger at a right angle to the palm does not spread.
fn spread(open: f64, flexion: f64) -> f64 {
    open * (1.0 - flexion / FRAC_PI_2).clamp(0.0, 1.0)
}

/// The part of a rotation that turns about the optical axis.
fn in_plane(rotation: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    let turn = 2.0 * rotation.k.atan2(rotation.w);
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn)
}

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// Pairs of outline points as residuals.
struct Pairs<'a> {
    spheres: &'a [ProjectedSphere],
    /// Distance at which a pair counts as an outlier, pixels.
    outlier: f64,
    /// Weight of a pixel of outline.
    per_pixel: f64,
    sums: PointSums,
    sizes: Option<&'a mut sizes::Frame>,
}

impl Pairs<'_> {
    /// Adds the distance of `p` from the image's outline at `position`, along its normal.
    fn add(&mut self, p: &OutlinePoint, position: [f64; 2], normal: [f64; 2], length: f64) {
        let away = [p.position[0] - position[0], p.position[1] - position[1]];
        let robust = (1.0 + dot(away, away) / (self.outlier * self.outlier)).powi(-2);
        let mut weight = robust * self.per_pixel * length;
        let (slopes, distance) = (p.slopes(self.spheres, normal), dot(away, normal));
        if let Some(sizes) = &mut self.sizes {
            weight *= sizes.openness(&slopes);
            sizes.add(p, (normal, distance), weight, &slopes);
        }
        self.sums.add(&slopes, distance, weight);
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use handcast_hand::{Finger, Morphology, Side};
    use handcast_vision::Mask;
    use nalgebra::UnitQuaternion;

    pub(super) fn open() -> OpenState {
        let mut free = [0.0; 15];
        for (finger, degrees) in Finger::LONG.into_iter().zip([10.0f64, 0.0, 8.0, 18.0]) {
            free[3 * finger as usize + 1] = degrees.to_radians();
        }
        let state = ModelState { free, ..ModelState::facing([160.0, 210.0], 900.0) };
        OpenState { state, forearm: None }
    }

    /// Tracks a motion of the true state from the open hand in steps and gives the last outcome and the truth.
    fn follow(frames: usize, motion: impl Fn(f64, &mut ModelState)) -> (Registered, ModelState, ModelState) {
        let mut model = HandModel::new(&Morphology::default(), Side::Right);
        let mut registration = Registration::new(RegistrationOptions::default());
        let mut evidence = Evidence::default();
        let open = open();
        let mut state = open.state.clone();
        let mut last = None;
        for i in 1..=frames {
            let mut truth = open.state.clone();
            motion(i as f64 / frames as f64, &mut truth);
            let mut image = Mask::new(320, 240);
            model.draw(&truth, [0.0, 0.0], &mut image);
            assert!(evidence.load(&image, None, None, 1).unwrap());
            let predicted = state.clone();
            let belief = Belief { predicted: &predicted, open: &open };
            let found = registration.register(&mut model, &evidence, &belief, &mut state);
            assert!(Domain::free().is_feasible(&state.free, 1e-9));
            last = Some((found, truth));
        }
        let (found, truth) = last.unwrap();
        (found, state, truth)
    }

    #[test]
    fn follows_translation_and_rotation() {
        let (found, state, truth) = follow(6, |t, s| {
            s.wrist[0] += 25.0 * t;
            s.rotation = UnitQuaternion::from_euler_angles(0.0, 0.0, 0.3 * t);
        });
        assert!(found.iou > 0.97, "{}", found.iou);
        assert!((state.wrist[0] - truth.wrist[0]).abs() < 1.5);
        let off = (state.rotation * truth.rotation.inverse()).scaled_axis();
        // A silhouette shows turns in its plane; tilts it hardly shows.
        assert!(off.z.abs() < 0.02 && off.x.hypot(off.y) < 0.1, "{off:?}");
    }

    #[test]
    fn follows_the_flexion_of_each_finger() {
        for finger in [Finger::Index, Finger::Middle, Finger::Ring] {
            let first = 3 * finger as usize;
            let (found, state, truth) = follow(10, |t, s| {
                s.free[first] = 0.9 * t;
                s.free[first + 1] *= 1.0 - 0.9 * t / std::f64::consts::FRAC_PI_2;
                s.free[first + 2] = 1.1 * t;
                // Eq. (4): the middle finger comes along.
                let middle = &mut s.free[3 * Finger::Middle as usize];
                *middle = middle.max(0.5 * t);
            });
            assert!(found.iou > 0.98, "{} {}", finger.name(), found.iou);
            // The finger's end is in front of the palm: without a picture only belief tells how far it is bent.
            let off = |k: usize| (state.free[first + k] - truth.free[first + k]).abs();
            assert!(off(0) < 0.25 && off(2) < 0.5, "{} {:?}", finger.name(), state.free);
        }
    }

    #[test]
    fn a_hand_that_has_jumped_to_a_fist_is_found() {
        let (found, state, truth) = follow(1, |_, s| {
            for finger in Finger::LONG {
                let first = 3 * finger as usize;
                (s.free[first], s.free[first + 1], s.free[first + 2]) = (1.3, 0.0, 1.6);
            }
        });
        assert!(found.iou > 0.9, "{}", found.iou);
        for finger in Finger::LONG {
            let first = 3 * finger as usize;
            assert!((state.free[first] - truth.free[first]).abs() < 0.4, "{:?}", state.free);
        }
    }
}
