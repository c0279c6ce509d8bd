//! Registration by gradients: damped Gauss-Newton on the distances between the outlines of the model and of
//! the image.
//!
//! In each round the points of the model's outline are paired with the nearest points of the silhouette's
//! outline, those of the silhouette's with the nearest of the model's, and the edges of fingers in front of
//! the hand with edges of luminance. The distances along the normals, robustly weighted (Geman & McClure
//! 1985), and what is believed before looking ([`Belief`]) make a quadratic in the 21 parameters; its minimum
//! under the biomechanical constraints is the next state.

use nalgebra::{SMatrix, SVector};

use super::appearance::Appearance;
use super::cover::Cover;
use super::evidence::Evidence;
use super::model::{HandModel, ModelState};
use super::objective::NonOverlap;
use super::outline::{self, OutlinePoint};
use super::projection::{COLUMNS, FREE, PARAMETERS, ProjectedSphere, SCALE, TURN};
use super::register::OpenState;
use crate::hand::{Domain, Finger};

/// How registration by gradients searches and what it believes. Lengths are in hand lengths in the image,
/// weights are inverse squares of standard deviations.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct RefineOptions {
    /// Most rounds of pairing and solving.
    pub rounds: usize,
    /// A round that moves nothing by more than this (hand lengths, radians) is the last.
    pub precision: f64,
    /// Standard deviation of an outline of the image.
    pub noise: f64,
    /// Length of outline over which its errors go together.
    pub correlation: f64,
    /// Distance at which a pair counts as an outlier, in the first round and in the last.
    pub outlier: [f64; 2],
    /// Weight of an inner edge against one of the silhouette.
    pub inner: f64,
    /// How far inner edges are looked for.
    pub inner_reach: f64,
    /// Standard deviation of a joint angle's change from what was predicted, radians.
    pub angle_motion: f64,
    /// Change that counts as a jump, radians: more costs no more.
    pub jump: f64,
    /// Of the wrist's, hand lengths.
    pub wrist_motion: f64,
    /// Of the turn's about the optical axis, radians.
    pub turn_motion: f64,
    /// Of the turn's about the other two, radians.
    pub tilt_motion: f64,
    /// Of the logarithm of the scale's.
    pub scale_motion: f64,
    /// Standard deviation of abduction from that of the open hand, radians.
    pub abduction: f64,
    /// Standard deviation of MCP flexion from 0.8 PIP flexion, radians.
    pub uneven: f64,
    /// Standard deviation of a flexion from that of the open hand, radians, while it is near to it.
    pub rest: f64,
    /// The same for a flexion that is less than that of the open hand: fingers hardly bend backwards.
    pub backwards: f64,
    /// Flexion that counts as no longer near to that of the open hand, radians.
    pub rest_reach: f64,
    /// Standard deviations squared that a non-overlap rate of 1 is worth when postures are compared.
    pub rate_worth: f64,
    /// Independent samples of luminance that the hand is worth when postures are compared.
    pub shade_worth: f64,
    /// Standard deviation of the tilt from that of the open hand, radians.
    pub tilt: f64,
    /// Standard deviation of the logarithm of the scale from that of the open hand.
    pub size: f64,
    /// Standard deviation of the wrist's distance from the forearm's cut, hand lengths.
    pub wrist: f64,
}

impl Default for RefineOptions {
    fn default() -> Self {
        Self {
            rounds: 8,
            precision: 1e-3,
            noise: 0.008,
            correlation: 0.04,
            outlier: [0.10, 0.04],
            inner: 0.0,
            inner_reach: 0.03,
            angle_motion: 0.25,
            jump: 0.3,
            wrist_motion: 0.3,
            turn_motion: 0.3,
            tilt_motion: 0.10,
            scale_motion: 0.08,
            abduction: 0.4,
            uneven: 0.15,
            rest: 0.10,
            backwards: 0.05,
            rest_reach: 0.2,
            rate_worth: 4000.0,
            shade_worth: 200.0,
            tilt: 0.3,
            size: 0.5,
            wrist: 0.05,
        }
    }
}

/// What is believed before looking.
#[derive(Clone, Copy, Debug)]
pub struct Belief<'a> {
    /// The state predicted for this frame.
    pub predicted: &'a ModelState,
    /// The open hand.
    pub open: &'a OpenState,
}

/// Where a search ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refined {
    /// Non-overlap rate (eq. 7).
    pub rate: f64,
    /// Intersection over union.
    pub iou: f64,
    /// What belief holds against the state: half the sum of squares in standard deviations.
    pub disbelief: f64,
    /// Luminance that shading leaves unexplained, mean square in levels; `None` without a picture.
    pub unexplained: Option<f64>,
    /// Rounds done.
    pub rounds: usize,
}

type Normal = SMatrix<f64, PARAMETERS, PARAMETERS>;
type Right = SVector<f64, PARAMETERS>;

/// The quadratic ½ xᵀ A x − bᵀ x of one round.
#[derive(Clone, Debug)]
struct Quadratic {
    a: Normal,
    b: Right,
}

impl Quadratic {
    fn new() -> Self {
        Self { a: Normal::zeros(), b: Right::zeros() }
    }

    /// Adds ½ w (residual + slopes · x)² for slopes given by parameter.
    fn add(&mut self, terms: &[(usize, f64)], residual: f64, weight: f64) {
        for &(i, si) in terms {
            self.b[i] -= weight * si * residual;
            for &(j, sj) in terms {
                self.a[(i, j)] += weight * si * sj;
            }
        }
    }

    /// The same for the slopes of a point of the outline, which may move with two fingers.
    fn add_point(&mut self, slopes: &[(Option<Finger>, [f64; COLUMNS]); 2], residual: f64, weight: f64) {
        let mut terms = [(0, 0.0); 2 * COLUMNS - FREE];
        for (k, term) in terms.iter_mut().enumerate().take(FREE) {
            *term = (k, slopes[0].1[k] + slopes[1].1[k]);
        }
        let mut n = FREE;
        for (finger, values) in slopes {
            if let Some(finger) = finger {
                let first = FREE + 3 * *finger as usize;
                for k in 0..3 {
                    if values[FREE + k] == 0.0 {
                        continue;
                    }
                    match terms[FREE..n].iter_mut().find(|t| t.0 == first + k) {
                        Some(term) => term.1 += values[FREE + k],
                        None => {
                            terms[n] = (first + k, values[FREE + k]);
                            n += 1;
                        }
                    }
                }
            }
        }
        self.add(&terms[..n], residual, weight);
    }
}

/// Registers a model on evidence. Holds the buffers, so that it allocates nothing once they have grown.
#[derive(Clone, Debug)]
pub struct Refiner {
    options: RefineOptions,
    domain: Domain,
    objective: NonOverlap,
    cover: Cover,
    appearance: Appearance,
    spheres: Vec<ProjectedSphere>,
    outline: Vec<OutlinePoint>,
    /// The outer points of the outline: position and normal, for pairing.
    outer: Vec<[f32; 5]>,
}

impl Refiner {
    /// A search with these options.
    pub fn new(options: RefineOptions) -> Self {
        Self {
            options,
            domain: Domain::free(),
            objective: NonOverlap::default(),
            cover: Cover::default(),
            appearance: Appearance::default(),
            spheres: Vec::new(),
            outline: Vec::new(),
            outer: Vec::new(),
        }
    }

    /// The options.
    pub fn options(&self) -> &RefineOptions {
        &self.options
    }

    /// Evaluations of the non-overlap rate so far.
    pub fn evaluations(&self) -> usize {
        self.objective.evaluations()
    }

    /// Moves `state` to where model and evidence agree best.
    pub fn refine(
        &mut self,
        model: &mut HandModel,
        evidence: &Evidence,
        belief: &Belief<'_>,
        state: &mut ModelState,
    ) -> Refined {
        let hand = HAND * state.scale;
        let mut done = self.options.rounds;
        for round in 0..self.options.rounds {
            let quadratic = self.linearise(model, evidence, belief, state, round);
            let step = self.solve(&quadratic, state, hand);
            *state = state.stepped(&step);
            self.bring_inside(&belief.open.state.free, state);
            let moved = step.iter().enumerate().map(|(i, v)| if i < SCALE { v / hand } else { *v });
            if moved.fold(0.0, |m: f64, v| m.max(v.abs())) < self.options.precision {
                done = round + 1;
                break;
            }
        }
        self.judge(model, evidence, belief, state, done)
    }

    /// Moves `state` to where model and evidence agree best, trying for each finger a posture that is not near.
    pub fn search(
        &mut self,
        model: &mut HandModel,
        evidence: &Evidence,
        belief: &Belief<'_>,
        state: &mut ModelState,
    ) -> Refined {
        let last = state.clone();
        *state = belief.predicted.clone();
        let mut best = self.refine(model, evidence, belief, state);
        let mut bent = last.clone();
        self.bend_fingers(model, evidence, belief, &mut bent);
        let found = self.refine(model, evidence, belief, &mut bent);
        if self.cost(&found) < self.cost(&best) {
            (*state, best) = (bent, found);
        }
        let mut closing = self.closing(model, evidence, belief, state);
        let found = self.refine(model, evidence, belief, &mut closing);
        if self.cost(&found) < self.cost(&best) {
            (*state, best) = (closing, found);
        }
        best
    }

    /// The best start among hands that face the camera as the open one did, with all four long fingers
    /// closed by the same share: when they close together, one finger at a time gains little.
    fn closing(
        &mut self,
        model: &mut HandModel,
        evidence: &Evidence,
        belief: &Belief<'_>,
        state: &ModelState,
    ) -> ModelState {
        let open = &belief.open.state;
        let relative = state.rotation * open.rotation.inverse();
        let turn = 2.0 * relative.k.atan2(relative.w);
        let rotation = nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::z_axis(), turn) * open.rotation;
        let mut start = ModelState { rotation, ..state.clone() };
        if let (Some(now), Some(then)) = (evidence.window().forearm(), &belief.open.forearm) {
            let along = (then.behind(open) - now.behind(&start)) * HAND * start.scale;
            start.wrist = [start.wrist[0] + along * now.axis[0], start.wrist[1] + along * now.axis[1]];
        }
        let mut best = (f64::INFINITY, start.clone());
        for step in 0..=5 {
            let share = 0.2 * f64::from(step);
            let mut s = start.clone();
            for finger in Finger::LONG {
                let first = 3 * finger as usize;
                s.free[first] = share * CLOSED[1][0];
                s.free[first + 2] = share * CLOSED[1][2];
                s.free[first + 1] = (1.0 - 0.7 * share) * open.free[first + 1];
            }
            self.bring_inside(&open.free, &mut s);
            let rate = self.objective.rate(model, &s, evidence.window());
            if rate < best.0 {
                best = (rate, s);
            }
        }
        best.1
    }

    /// What a state costs when postures are compared.
    fn cost(&self, refined: &Refined) -> f64 {
        let shade = refined.unexplained.map_or(0.0, |u| 0.5 * self.options.shade_worth * u.ln());
        self.options.rate_worth * refined.rate + refined.disbelief + shade
    }

    /// Gives each finger the better of two postures, the others held: the nearest to where it is, and the best
    /// that is far from it; false when none is far.
    fn bend_fingers(
        &mut self,
        model: &mut HandModel,
        evidence: &Evidence,
        belief: &Belief<'_>,
        state: &mut ModelState,
    ) -> bool {
        let mut any = false;
        for finger in Finger::ALL {
            self.objective.hold_rest(model, state, finger, evidence.window());
            let first = 3 * finger as usize;
            let closed = CLOSED[usize::from(finger != Finger::Thumb)];
            let mut best = (f64::INFINITY, None);
            let now = state.free[first + 2] / closed[2];
            for step in 0..=5 {
                let share = 0.2 * f64::from(step);
                if (share - now).abs() < 0.15 {
                    continue;
                }
                let mut s = state.clone();
                s.free[first] = share * closed[0];
                s.free[first + 2] = share * closed[2];
                if finger == Finger::Thumb {
                    s.free[first + 1] = share * closed[1];
                }
                self.bring_inside(&belief.open.state.free, &mut s);
                let rate = self.objective.rate_of_finger(model, &s, finger, evidence.window());
                if rate < best.0 {
                    best = (rate, Some(s));
                }
            }
            let Some(mut other) = best.1 else { continue };
            let mut near = state.clone();
            let a = self.refine_finger(model, evidence, belief, &mut near, finger);
            let b = self.refine_finger(model, evidence, belief, &mut other, finger);
            let better = self.cost(&b) + 1.0 < self.cost(&a);
            any |= better;
            *state = if better { other } else { near };
        }
        any
    }

    /// Moves one finger to where model and evidence agree best, the rest of the hand held.
    fn refine_finger(
        &mut self,
        model: &mut HandModel,
        evidence: &Evidence,
        belief: &Belief<'_>,
        state: &mut ModelState,
        finger: Finger,
    ) -> Refined {
        let hand = HAND * state.scale;
        let own = FREE + 3 * finger as usize..FREE + 3 * finger as usize + 3;
        for _ in 0..FINGER_ROUNDS {
            let mut quadratic = self.linearise(model, evidence, belief, state, self.options.rounds / 2);
            for i in (0..PARAMETERS).filter(|i| !own.contains(i)) {
                quadratic.a[(i, i)] += HELD;
            }
            let step = self.solve(&quadratic, state, hand);
            *state = state.stepped(&step);
            self.bring_inside(&belief.open.state.free, state);
        }
        self.judge(model, evidence, belief, state, FINGER_ROUNDS)
    }

    /// How well `state` agrees with the evidence and with belief.
    pub fn judge(
        &mut self,
        model: &mut HandModel,
        evidence: &Evidence,
        belief: &Belief<'_>,
        state: &ModelState,
        rounds: usize,
    ) -> Refined {
        let rate = self.objective.rate(model, state, evidence.window());
        let mut disbelief = 0.0;
        self.believe(belief, evidence, state, &mut |_, residual, weight| {
            disbelief += 0.5 * weight * residual * residual;
        });
        let unexplained = if self.options.shade_worth > 0.0 { self.unexplained(model, evidence, state) } else { None };
        Refined { rate, iou: self.objective.last_iou(evidence.window()), disbelief, unexplained, rounds }
    }

    fn unexplained(&mut self, model: &mut HandModel, evidence: &Evidence, state: &ModelState) -> Option<f64> {
        let window = evidence.window();
        model.project_moving(state, &mut self.spheres);
        let silhouette = window.silhouette();
        let size = [silhouette.width(), silhouette.height()];
        let primitives = model.shape().primitives();
        self.cover.draw(primitives, &self.spheres, state.scale, window.origin(), size);
        self.appearance.unexplained(primitives, &self.spheres, &self.cover, evidence, state.scale)
    }

    /// The quadratic around `state`.
    fn linearise(
        &mut self,
        model: &mut HandModel,
        evidence: &Evidence,
        belief: &Belief<'_>,
        state: &ModelState,
        round: usize,
    ) -> Quadratic {
        let hand = HAND * state.scale;
        self.outline_of(model, evidence, state);
        let o = &self.options;
        let progress = round as f64 / (o.rounds.max(2) - 1) as f64;
        let outlier = hand * o.outlier[0] * (o.outlier[1] / o.outlier[0]).powf(progress);
        let robust = |distance: f64| (1.0 + (distance / outlier).powi(2)).powi(-2);
        // A pixel of outline counts for this much.
        let per_pixel = 1.0 / (o.correlation * hand) / (o.noise * hand).powi(2);
        let mut quadratic = Quadratic::new();
        for p in &self.outline {
            if p.inner {
                if o.inner > 0.0 {
                    let found = edge_near(evidence, p, o.inner_reach * hand);
                    if let Some((offset, strength)) = found {
                        let slopes = p.slopes(&self.spheres, p.normal);
                        quadratic.add_point(&slopes, -offset, o.inner * strength * per_pixel * p.length);
                    }
                }
                continue;
            }
            let Some(q) = evidence.nearest(p.position) else { continue };
            let normal = q.normal.map(f64::from);
            let facing = normal[0] * p.normal[0] + normal[1] * p.normal[1];
            if facing < FACING {
                continue;
            }
            let away = [p.position[0] - f64::from(q.position[0]), p.position[1] - f64::from(q.position[1])];
            let residual = away[0] * normal[0] + away[1] * normal[1];
            let weight = robust(away[0].hypot(away[1])) * per_pixel * p.length;
            quadratic.add_point(&p.slopes(&self.spheres, normal), residual, weight);
        }
        self.pair_image(evidence, hand, per_pixel, robust, &mut quadratic);
        self.believe(belief, evidence, state, &mut |terms, residual, weight| {
            quadratic.add(terms, residual, weight);
        });
        quadratic
    }

    /// The visible outline of the model at `state`.
    fn outline_of(&mut self, model: &mut HandModel, evidence: &Evidence, state: &ModelState) {
        let window = evidence.window();
        self.objective.rate(model, state, window);
        model.project_moving(state, &mut self.spheres);
        let silhouette = window.silhouette();
        let size = [silhouette.width(), silhouette.height()];
        let primitives = model.shape().primitives();
        self.cover.draw(primitives, &self.spheres, state.scale, window.origin(), size);
        outline::trace(
            primitives,
            &self.spheres,
            (self.objective.drawn(), window.origin()),
            &self.cover,
            (SPACING * HAND * state.scale, STEP, state.scale),
            &mut self.outline,
        );
        if let Some(forearm) = window.forearm() {
            self.outline.retain(|p| p.inner || forearm.side(p.position) > 3.0);
        }
        self.outer.clear();
        for (i, p) in self.outline.iter().enumerate().filter(|(_, p)| !p.inner) {
            let ([x, y], [nx, ny]) = (p.position, p.normal);
            self.outer.push([x as f32, y as f32, nx as f32, ny as f32, i as f32]);
        }
    }

    /// Pairs points of the image's outline with the nearest of the model's that face the same way.
    fn pair_image(
        &self,
        evidence: &Evidence,
        hand: f64,
        per_pixel: f64,
        robust: impl Fn(f64) -> f64,
        quadratic: &mut Quadratic,
    ) {
        let stride = (SPACING * hand).round().max(1.0) as usize;
        for q in evidence.points().iter().step_by(stride) {
            let [x, y] = q.position;
            let [nx, ny] = q.normal;
            let mut best = (f32::INFINITY, usize::MAX);
            for p in &self.outer {
                let (dx, dy) = (p[0] - x, p[1] - y);
                let facing = p[2] * nx + p[3] * ny;
                // Points that face another way are the farther for it.
                let d = dx * dx + dy * dy;
                if facing > FACING as f32 && d < best.0 {
                    best = (d, p[4] as usize);
                }
            }
            let Some(p) = self.outline.get(best.1) else { continue };
            let normal = [f64::from(nx), f64::from(ny)];
            let away = [p.position[0] - f64::from(x), p.position[1] - f64::from(y)];
            let residual = away[0] * normal[0] + away[1] * normal[1];
            let weight = robust(away[0].hypot(away[1])) * per_pixel * stride as f64;
            quadratic.add_point(&p.slopes(&self.spheres, normal), residual, weight);
        }
    }

    /// Gives the terms of belief: slopes by parameter, residual, weight.
    fn believe(
        &self,
        belief: &Belief<'_>,
        evidence: &Evidence,
        state: &ModelState,
        add: &mut dyn FnMut(&[(usize, f64)], f64, f64),
    ) {
        let o = &self.options;
        let hand = HAND * state.scale;
        let weight = |deviation: f64| 1.0 / (deviation * deviation);
        let (predicted, open) = (belief.predicted, &belief.open.state);
        for k in 0..2 {
            add(&[(k, 1.0)], state.wrist[k] - predicted.wrist[k], weight(o.wrist_motion * hand));
        }
        add(&[(SCALE, 1.0)], (state.scale / predicted.scale).ln(), weight(o.scale_motion));
        add(&[(SCALE, 1.0)], (state.scale / open.scale).ln(), weight(o.size));
        let turned = (state.rotation * predicted.rotation.inverse()).scaled_axis();
        for (k, deviation) in [o.tilt_motion, o.tilt_motion, o.turn_motion].into_iter().enumerate() {
            add(&[(TURN + k, 1.0)], turned[k], weight(deviation));
        }
        let tilted = (state.rotation * open.rotation.inverse()).scaled_axis();
        for k in 0..2 {
            add(&[(TURN + k, 1.0)], tilted[k], weight(o.tilt));
        }
        for i in 0..15 {
            let off = state.free[i] - predicted.free[i];
            let near = 1.0 + (off / o.jump).powi(2);
            add(&[(FREE + i, 1.0)], off, weight(o.angle_motion) / (near * near));
        }
        for finger in Finger::ALL {
            let i = 3 * finger as usize + 1;
            add(&[(FREE + i, 1.0)], state.free[i] - open.free[i], weight(o.abduction));
        }
        for i in (0..15).filter(|i| i % 3 != 1) {
            let off = state.free[i] - open.free[i];
            let weight = if off < 0.0 && i > 2 {
                weight(o.backwards)
            } else {
                weight(o.rest) / (1.0 + (off / o.rest_reach).powi(2)).powi(2)
            };
            add(&[(FREE + i, 1.0)], off, weight);
        }
        for finger in Finger::LONG {
            let i = 3 * finger as usize;
            let uneven = 0.8 * state.free[i + 2] - state.free[i];
            add(&[(FREE + i + 2, 0.8), (FREE + i, -1.0)], uneven, weight(o.uneven));
        }
        if let (Some(now), Some(then)) = (evidence.window().forearm(), &belief.open.forearm) {
            let off = now.behind(state) - then.behind(open);
            let terms = [(0, now.axis[0] / hand), (1, now.axis[1] / hand), (SCALE, -now.behind(state))];
            add(&terms, off, weight(o.wrist));
        }
    }

    /// The step to the minimum of the quadratic, bounded, with violated constraints made stiff.
    fn solve(&self, quadratic: &Quadratic, state: &ModelState, hand: f64) -> [f64; PARAMETERS] {
        let Quadratic { mut a, mut b } = quadratic.clone();
        for i in 0..PARAMETERS {
            a[(i, i)] *= 1.0 + DAMPING;
        }
        let mut step = [0.0; PARAMETERS];
        let half_spaces = self.domain.half_spaces();
        let mut active = [false; 64];
        for _ in 0..4 {
            let Some(factor) = a.cholesky() else { return [0.0; PARAMETERS] };
            let x = factor.solve(&b);
            step.copy_from_slice(x.as_slice());
            let mut violated = false;
            for (h, active) in half_spaces.iter().zip(&mut active).filter(|(_, a)| !**a) {
                let excess = h.excess(&state.free);
                let grown = excess + h.terms.iter().map(|&(i, c)| c * step[FREE + i]).sum::<f64>();
                if grown > 1e-6 {
                    (*active, violated) = (true, true);
                    for &(i, ci) in &h.terms {
                        b[FREE + i] -= STIFF * ci * excess;
                        for &(j, cj) in &h.terms {
                            a[(FREE + i, FREE + j)] += STIFF * ci * cj;
                        }
                    }
                }
            }
            if !violated {
                break;
            }
        }
        let most = step.iter().enumerate().map(|(i, v)| v.abs() / if i < SCALE { hand } else { 1.0 });
        let most = most.fold(0.0, f64::max);
        let shrink = (LONGEST / most).min(1.0);
        step.map(|v| v * shrink)
    }

    /// Removes what is left of violated constraints.
    fn bring_inside(&self, open: &[f64; 15], state: &mut ModelState) {
        let t = self.domain.clip_segment(open, &state.free);
        for (v, from) in state.free.iter_mut().zip(open) {
            *v = from + t * (*v - from);
        }
    }
}

/// Flexion, abduction and PIP or IP flexion of the closed thumb and of a closed finger, radians.
const CLOSED: [[f64; 3]; 2] = [[0.35, 0.7, 0.8], [1.4, 0.0, 1.7]];
/// The length in which distances are measured, metres: that of an average hand.
const HAND: f64 = 0.19;
/// Distance of points along outlines, hand lengths.
const SPACING: f64 = 0.025;
/// Least step of depth at an inner edge, metres.
const STEP: f64 = 0.006;
/// Cosine of the largest angle between paired normals.
const FACING: f64 = 0.4;
/// Share added to the diagonal.
const DAMPING: f64 = 1e-3;
/// Rounds in which one finger alone is refined.
const FINGER_ROUNDS: usize = 3;
/// Weight that holds a parameter.
const HELD: f64 = 1e12;
/// Weight of a violated constraint.
const STIFF: f64 = 1e6;
/// Longest step: hand lengths of the wrist, radians.
const LONGEST: f64 = 0.35;

/// The strongest edge of luminance near a point of an inner outline: its offset along the normal, pixels, and
/// its strength from 0 to 1.
fn edge_near(evidence: &Evidence, p: &OutlinePoint, reach: f64) -> Option<(f64, f64)> {
    let n = reach.ceil().clamp(2.0, 16.0) as i32;
    let at = |k: f64| evidence.luma([p.position[0] + k * p.normal[0], p.position[1] + k * p.normal[1]]);
    let mut best = (0.0f64, 0.0);
    for k in -n..=n {
        let k = f64::from(k);
        let slope = (at(k + 1.5)? - at(k - 1.5)?).abs() * (1.0 - 0.5 * k.abs() / f64::from(n));
        if slope > best.0 {
            best = (slope, k);
        }
    }
    (best.0 > 8.0).then(|| (best.1, (best.0 / 40.0).min(1.0)))
}
