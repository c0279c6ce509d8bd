//! The prior: how likely a state is before the frame is looked at.

use std::f64::consts::FRAC_PI_2;

use super::super::evidence::Evidence;
use super::super::normal_equations::NormalEquations;
use super::super::projection::{FREE, SCALE, THUMB_MCP, TURN};
use super::super::state::{HAND_LENGTH, ModelState};
use super::geometry::spread;
use handcast_hand::{Finger, FreeAngles, thumb_mcp_from_cmc, thumb_mcp_slope};
use handcast_vision::tuning::tuning;

/// The open hand: the posture to which others are compared.
#[derive(Clone, Debug, PartialEq)]
pub struct OpenState {
    /// Its state.
    pub state: ModelState,
    /// How far its wrist is from the forearm's cut towards the fingers, hand lengths; `None` where that is not known.
    pub behind: Option<f64>,
}

/// The prior of a frame's state.
#[derive(Clone, Copy, Debug)]
pub struct Prior<'a> {
    /// The state predicted for this frame.
    pub predicted: &'a ModelState,
    /// The open hand.
    pub open: &'a OpenState,
}

tuning! {
    /// The prior's standard deviations: of motion since the last frame, of the posture from that of the open hand, and
    /// of what flexions have to do with one another.
    pub struct PriorTuning {
        /// Standard deviation of a joint angle's change from the predicted one.
        ["rad", "spec/registration.md 5, Prior; handcast bench track --no-methods on rendered sequences"]
        pub angle_motion: f64 = 0.5,
        /// Change of a joint angle that counts as a jump: more costs hardly more.
        ["rad", "spec/registration.md 5, Prior; handcast bench track --no-methods on rendered sequences"]
        pub angle_jump: f64 = 0.3,
        /// Standard deviation of the wrist's place from the predicted one.
        ["hand lengths", "chosen by eye"]
        pub wrist_motion: f64 = 0.3,
        /// Standard deviation of the turn about the optical axis from the predicted one.
        ["rad", "chosen by eye"]
        pub turn_motion: f64 = 0.3,
        /// Standard deviation of the turn about either other axis from the predicted one.
        ["rad", "spec/experiments.md, Firm priors; handcast bench track CLIP --no-methods"]
        pub tilt_motion: f64 = 0.06,
        /// Standard deviation of the logarithm of the scale from that of the predicted one.
        ["1", "chosen by eye"]
        pub scale_motion: f64 = 0.04,
        /// Standard deviation of a long finger's abduction from that of the open hand, which shrinks as the finger
        /// bends (eq. 3).
        ["rad", "spec/experiments.md, Firm priors; handcast bench track CLIP --no-methods"]
        pub abduction: f64 = 0.07,
        /// Standard deviation of the thumb's abduction from that of the open hand.
        ["rad", "spec/experiments.md, Cupped palm and thumb prior"]
        pub thumb_abduction: f64 = 0.15,
        /// MCP flexion per PIP flexion of a long finger.
        ["1", "spec/registration.md 5, Prior"]
        pub flexion_ratio: f64 = 0.8,
        /// Standard deviation of MCP flexion from that share of PIP flexion.
        ["rad", "spec/registration.md 5, Prior"]
        pub flexion_ratio_deviation: f64 = 0.15,
        /// Standard deviation of the thumb's MCP flexion from eq. (5).
        ["rad", "spec/experiments.md, Cupped palm and thumb prior"]
        pub thumb_mcp: f64 = 0.2,
        /// The thumb's IP flexion per MCP flexion.
        ["1", "spec/registration.md 5, Prior"]
        pub thumb_ratio: f64 = 0.8,
        /// Standard deviation of the thumb's IP flexion from that share of its MCP flexion.
        ["rad", "spec/registration.md 5, Prior"]
        pub thumb_ratio_deviation: f64 = 0.2,
        /// Standard deviation of a flexion from that of the open hand, while it is near to it.
        ["rad", "spec/registration.md 5, Prior; handcast bench track --no-methods on rendered sequences"]
        pub open_flexion: f64 = 0.10,
        /// The same for a flexion less than that of the open hand: fingers hardly bend backwards.
        ["rad", "spec/registration.md 5, Prior; handcast bench track --no-methods on rendered sequences"]
        pub open_extension: f64 = 0.05,
        /// Difference from the open hand's flexion at which that prior has faded.
        ["rad", "spec/registration.md 5, Prior; handcast bench track --no-methods on rendered sequences"]
        pub open_reach: f64 = 0.2,
        /// Flexion of the first and the middle joint of a long finger in a fist.
        ["rad", "fists recorded by a headset and scripted ones: 80 to 90 and 90 to 100 degrees"]
        pub closed: [f64; 2] = [1.5, 1.7],
        /// Standard deviation of a flexion from that of a fist, while it is near to it, where a finder sees joints.
        ["rad", "spec/experiments.md, Fist prior"]
        pub closed_flexion: f64 = 0.45,
        /// Difference from the fist's flexion at which that prior has faded.
        ["rad", "spec/experiments.md, Fist prior"]
        pub closed_reach: f64 = 0.4,
        /// Standard deviation of the tilt from that of the open hand. Silhouettes hardly show it, and wrong postures
        /// seek it.
        ["rad", "spec/experiments.md, Firm priors; handcast bench track CLIP --no-methods"]
        pub tilt: f64 = 0.05,
        /// Tilt beyond which more costs hardly more while the fingers are as in the open hand.
        ["rad", "spec/experiments.md, Refined sizes, limited tilt, weaker shading"]
        pub tilt_reach: f64 = 0.2,
        /// How much farther that is for fingers whose MCP and PIP joints are together a radian from the open hand; it
        /// goes with the square. Bent fingers and a tilt are easily taken for each other.
        ["rad per rad²", "spec/experiments.md, Refined sizes, limited tilt, weaker shading"]
        pub tilt_reach_bent: f64 = 1.0,
        /// Standard deviation of the logarithm of the scale from that of the open hand.
        ["1", "spec/registration.md 5, Prior"]
        pub scale: f64 = 0.2,
        /// Standard deviation of the wrist's distance from the forearm's cut.
        ["hand lengths", "spec/registration.md 5, Prior; handcast bench track CLIP --no-methods"]
        pub wrist: f64 = 0.02,
    }
}

impl PriorTuning {
    /// Of a flexion of `finger` that is `residual` radians more than that of the open hand.
    fn of_flexion(&self, finger: Finger, residual: f64) -> Loss {
        if residual < 0.0 && finger != Finger::Thumb {
            Loss::quadratic(self.open_extension)
        } else {
            Loss::geman_mcclure(self.open_flexion, self.open_reach)
        }
    }
}

/// What a residual costs.
#[derive(Clone, Copy, Debug)]
pub(super) struct Loss {
    /// Information of a small residual: one over its variance.
    information: f64,
    /// The residual at which its weight has fallen to a quarter, and from which on more soon costs no more.
    reach: f64,
}

impl Loss {
    /// That of a normal distribution of this standard deviation.
    fn quadratic(deviation: f64) -> Self {
        Self { information: 1.0 / (deviation * deviation), reach: f64::INFINITY }
    }

    /// The same near 0 only (Geman & McClure 1985).
    pub(super) fn geman_mcclure(deviation: f64, reach: f64) -> Self {
        Self { reach, ..Self::quadratic(deviation) }
    }

    /// 1 plus the square of the residual in reaches.
    fn beyond(&self, residual: f64) -> f64 {
        1.0 + (residual / self.reach).powi(2)
    }

    /// The weight of least squares whose gradient is that of the cost.
    pub(super) fn weight(&self, residual: f64) -> f64 {
        self.information / self.beyond(residual).powi(2)
    }

    pub(super) fn cost(&self, residual: f64) -> f64 {
        0.5 * self.information * residual * residual / self.beyond(residual)
    }
}

impl Prior<'_> {
    /// Adds the terms ½ w (residual + gradient · step)² around `state` whose gradients are those of [`Prior::cost`].
    pub(super) fn add_to(
        &self,
        equations: &mut NormalEquations,
        tuning: &PriorTuning,
        evidence: &Evidence,
        state: &ModelState,
    ) {
        self.residuals(tuning, evidence, state, |gradient, residual, loss| {
            equations.add(gradient, residual, loss.weight(residual));
        });
    }

    /// The negative logarithm of the prior, but for a constant: half the sum of squares in standard deviations.
    pub(super) fn cost(&self, tuning: &PriorTuning, evidence: &Evidence, state: &ModelState) -> f64 {
        let mut sum = 0.0;
        self.residuals(tuning, evidence, state, |_, residual, loss| sum += loss.cost(residual));
        sum
    }

    /// Gives each residual: its gradient by parameter, its value, its loss.
    fn residuals(
        &self,
        tuning: &PriorTuning,
        evidence: &Evidence,
        state: &ModelState,
        mut add: impl FnMut(&[(usize, f64)], f64, Loss),
    ) {
        self.global(tuning, state, &mut add);
        self.posture(tuning, state, &mut add);
        if evidence.joints().is_some() {
            closed(tuning, state, &mut add);
        }
        if let (Some(now), Some(then)) = (evidence.window().forearm(), self.open.behind) {
            let hand = HAND_LENGTH * state.scale;
            let residual = now.behind(state) - then;
            let gradient = [(0, now.axis[0] / hand), (1, now.axis[1] / hand), (SCALE, -now.behind(state))];
            add(&gradient, residual, Loss::quadratic(tuning.wrist));
        }
    }

    /// Those of place, scale and rotation.
    fn global(&self, t: &PriorTuning, state: &ModelState, add: &mut impl FnMut(&[(usize, f64)], f64, Loss)) {
        let hand = HAND_LENGTH * state.scale;
        let (predicted, open) = (self.predicted, &self.open.state);
        for k in 0..2 {
            add(&[(k, 1.0)], state.wrist[k] - predicted.wrist[k], Loss::quadratic(t.wrist_motion * hand));
        }
        add(&[(SCALE, 1.0)], (state.scale / predicted.scale).ln(), Loss::quadratic(t.scale_motion));
        add(&[(SCALE, 1.0)], (state.scale / open.scale).ln(), Loss::quadratic(t.scale));
        let turned = (state.rotation * predicted.rotation.inverse()).scaled_axis();
        for (k, deviation) in [t.tilt_motion, t.tilt_motion, t.turn_motion].into_iter().enumerate() {
            add(&[(TURN + k, 1.0)], turned[k], Loss::quadratic(deviation));
        }
        let tilted = (state.rotation * open.rotation.inverse()).scaled_axis();
        let bent = bend(&state.free, &open.free);
        let reach = t.tilt_reach + t.tilt_reach_bent * bent * bent;
        for k in 0..2 {
            add(&[(TURN + k, 1.0)], tilted[k], Loss::geman_mcclure(t.tilt, reach));
        }
    }

    /// Those of the joint angles.
    fn posture(&self, t: &PriorTuning, state: &ModelState, add: &mut impl FnMut(&[(usize, f64)], f64, Loss)) {
        let (predicted, open) = (self.predicted, &self.open.state);
        let motion = Loss::geman_mcclure(t.angle_motion, t.angle_jump);
        for finger in Finger::ALL {
            for i in finger.range() {
                add(&[(FREE + i, 1.0)], state.free[i] - predicted.free[i], motion);
                if i != finger.free_abduction() {
                    let residual = state.free[i] - open.free[i];
                    add(&[(FREE + i, 1.0)], residual, t.of_flexion(finger, residual));
                }
            }
        }
        let thumb = Finger::Thumb;
        let i = thumb.free_abduction();
        add(&[(FREE + i, 1.0)], state.free[i] - open.free[i], Loss::quadratic(t.thumb_abduction));
        for finger in Finger::LONG {
            let [base, abduction, outer] = [finger.free_base(), finger.free_abduction(), finger.free_outer()];
            let (flexion, opened) = (state.free[base], open.free[abduction]);
            let residual = state.free[abduction] - spread(opened, flexion);
            let with_bend = if (0.0..FRAC_PI_2).contains(&flexion) { opened / FRAC_PI_2 } else { 0.0 };
            let gradient = [(FREE + abduction, 1.0), (FREE + base, with_bend)];
            add(&gradient, residual, Loss::quadratic(t.abduction));
            let uneven = t.flexion_ratio * state.free[outer] - state.free[base];
            let gradient = [(FREE + outer, t.flexion_ratio), (FREE + base, -1.0)];
            add(&gradient, uneven, Loss::quadratic(t.flexion_ratio_deviation));
        }
        add(&[(THUMB_MCP, 1.0)], state.thumb_mcp - predicted.thumb_mcp, motion);
        add(&[(THUMB_MCP, 1.0)], state.thumb_mcp, Loss::quadratic(t.thumb_mcp));
        let (base, outer) = (thumb.free_base(), thumb.free_outer());
        let mcp = thumb_mcp_from_cmc(state.free[base]) + state.thumb_mcp;
        let gradient = [
            (FREE + base, -t.thumb_ratio * thumb_mcp_slope(state.free[base])),
            (FREE + outer, 1.0),
            (THUMB_MCP, -t.thumb_ratio),
        ];
        let residual = state.free[outer] - t.thumb_ratio * mcp;
        add(&gradient, residual, Loss::quadratic(t.thumb_ratio_deviation));
    }
}

/// Those of folded fingers, which are folded wholly where nothing is seen of them. Without joints that a finder sees, fingers
/// that are folded are not told as well from others.
fn closed(t: &PriorTuning, state: &ModelState, add: &mut impl FnMut(&[(usize, f64)], f64, Loss)) {
    let loss = Loss::geman_mcclure(t.closed_flexion, t.closed_reach);
    for finger in Finger::LONG {
        for (i, fist) in [finger.free_base(), finger.free_outer()].into_iter().zip(t.closed) {
            add(&[(FREE + i, 1.0)], state.free[i] - fist, loss);
        }
    }
}

/// How far the flexions of the long fingers are from those of the open hand, together, radians.
fn bend(free: &FreeAngles, open: &FreeAngles) -> f64 {
    let flexions = Finger::LONG.into_iter().flat_map(|f| [f.free_base(), f.free_outer()]);
    flexions.map(|i| (free[i] - open[i]).abs()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn least_squares_and_cost_have_the_same_gradient() {
        for loss in [Loss::quadratic(0.2), Loss::geman_mcclure(0.1, 0.3)] {
            for residual in [-0.8, -0.05, 0.0, 0.2, 0.5] {
                let h = 1e-6;
                let slope = (loss.cost(residual + h) - loss.cost(residual - h)) / (2.0 * h);
                assert!((slope - loss.weight(residual) * residual).abs() < 1e-4, "{loss:?} {residual}");
            }
        }
        let loss = Loss::geman_mcclure(0.1, 0.3);
        assert!(loss.cost(3.0) > loss.cost(1.0));
    }
}
