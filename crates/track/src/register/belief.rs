//! What is believed before looking.

use std::f64::consts::FRAC_PI_2;

use super::super::evidence::Evidence;
use super::super::model::ModelState;
use super::super::objective::Forearm;
use super::super::projection::{FREE, SCALE, THUMB_MCP, TURN};
use super::{HAND, Quadratic, spread};
use handcast_hand::{Finger, thumb_mcp_from_cmc, thumb_mcp_slope};

/// The open hand: the posture to which others are compared.
#[derive(Clone, Debug, PartialEq)]
pub struct OpenState {
    /// Its state.
    pub state: ModelState,
    /// Where its silhouette was cut from the forearm.
    pub forearm: Option<Forearm>,
}

/// What is believed of a frame before looking at it.
#[derive(Clone, Copy, Debug)]
pub struct Belief<'a> {
    /// The state predicted for this frame.
    pub predicted: &'a ModelState,
    /// The open hand.
    pub open: &'a OpenState,
}

/// How firmly it is believed: standard deviations.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct BeliefOptions {
    /// Of a joint angle's change from what was predicted, radians.
    pub angle_motion: f64,
    /// Change that counts as a jump, radians: more costs no more.
    pub jump: f64,
    /// Of the wrist's place from what was predicted, hand lengths.
    pub wrist_motion: f64,
    /// Of the turn's about the optical axis, radians.
    pub turn_motion: f64,
    /// Of the turn's about the other two, radians.
    pub tilt_motion: f64,
    /// Of the logarithm of the scale's.
    pub scale_motion: f64,
    /// Of a finger's abduction from that of the open hand, which goes as the finger bends, radians.
    pub abduction: f64,
    /// Of the thumb's abduction from that of the open hand, radians.
    pub thumb_abduction: f64,
    /// Of MCP flexion from 0.8 PIP flexion, radians.
    pub uneven: f64,
    /// Of the thumb's MCP flexion from eq. (5), radians.
    pub thumb_mcp: f64,
    /// Of the thumb's IP flexion from 0.8 of its MCP flexion, radians.
    pub thumb_uneven: f64,
    /// Of a flexion from that of the open hand, radians, while it is near to it.
    pub rest: f64,
    /// The same for a flexion that is less than that of the open hand: fingers hardly bend backwards.
    pub backwards: f64,
    /// Flexion that counts as no longer near to that of the open hand, radians.
    pub rest_reach: f64,
    /// Of the tilt from that of the open hand, radians. Silhouettes hardly show it, and wrong postures seek it.
    pub tilt: f64,
    /// Tilt beyond which more costs hardly more while the fingers are as in the open hand, radians.
    pub tilt_reach: f64,
    /// How much farther that is for fingers whose MCP and PIP joints are together a radian from the open hand, radians;
    /// it goes with the square. Bent fingers and a tilt are easily taken for each other.
    pub tilt_reach_bent: f64,
    /// Of the logarithm of the scale from that of the open hand.
    pub size: f64,
    /// Of the wrist's distance from the forearm's cut, hand lengths.
    pub wrist: f64,
}

impl Default for BeliefOptions {
    fn default() -> Self {
        Self {
            angle_motion: 0.5,
            jump: 0.3,
            wrist_motion: 0.3,
            turn_motion: 0.3,
            tilt_motion: 0.06,
            scale_motion: 0.04,
            abduction: 0.07,
            thumb_abduction: 0.15,
            uneven: 0.15,
            thumb_mcp: 0.2,
            thumb_uneven: 0.2,
            rest: 0.10,
            backwards: 0.05,
            rest_reach: 0.2,
            tilt: 0.05,
            tilt_reach: 0.2,
            tilt_reach_bent: 1.0,
            size: 0.2,
            wrist: 0.02,
        }
    }
}

impl BeliefOptions {
    /// Of free joint angle `i`, a flexion, being `off` from that of the open hand, radians.
    fn of_flexion(&self, i: usize, off: f64) -> Doubt {
        if off < 0.0 && i > 2 { firm(self.backwards) } else { fading(self.rest, self.rest_reach) }
    }
}

/// What a belief holds against a residual.
#[derive(Clone, Copy, Debug)]
struct Doubt {
    /// The residual counts as its square times this.
    weight: f64,
    /// The residual at which it has a quarter of that weight left, and from which on it soon costs no more.
    reach: f64,
}

/// Standard deviation `deviation`, whatever the residual.
fn firm(deviation: f64) -> Doubt {
    Doubt { weight: 1.0 / (deviation * deviation), reach: f64::INFINITY }
}

/// The same near 0 only (Geman & McClure 1985).
fn fading(deviation: f64, reach: f64) -> Doubt {
    Doubt { reach, ..firm(deviation) }
}

impl Doubt {
    /// How far beyond reach: 1 plus the square of the residual in reaches.
    fn beyond(&self, residual: f64) -> f64 {
        1.0 + (residual / self.reach).powi(2)
    }

    /// The weight of least squares whose slope is that of the cost.
    fn weight(&self, residual: f64) -> f64 {
        self.weight / self.beyond(residual).powi(2)
    }

    fn cost(&self, residual: f64) -> f64 {
        0.5 * self.weight * residual * residual / self.beyond(residual)
    }
}

impl Belief<'_> {
    /// Adds the terms ½ w (residual + slopes · step)² around `state` whose slopes are those of
    /// [`Belief::against`].
    pub(super) fn add_to(
        &self,
        quadratic: &mut Quadratic,
        o: &BeliefOptions,
        evidence: &Evidence,
        state: &ModelState,
    ) {
        self.terms(o, evidence, state, |slopes, residual, doubt| {
            quadratic.add(slopes, residual, doubt.weight(residual));
        });
    }

    /// What is held against `state`: half the sum of squares in standard deviations.
    pub(super) fn against(&self, o: &BeliefOptions, evidence: &Evidence, state: &ModelState) -> f64 {
        let mut sum = 0.0;
        self.terms(o, evidence, state, |_, residual, doubt| sum += doubt.cost(residual));
        sum
    }

    /// Gives each belief as slopes by parameter, residual and doubt.
    fn terms(
        &self,
        o: &BeliefOptions,
        evidence: &Evidence,
        state: &ModelState,
        mut add: impl FnMut(&[(usize, f64)], f64, Doubt),
    ) {
        let hand = HAND * state.scale;
        let (predicted, open) = (self.predicted, &self.open.state);
        for k in 0..2 {
            add(&[(k, 1.0)], state.wrist[k] - predicted.wrist[k], firm(o.wrist_motion * hand));
        }
        add(&[(SCALE, 1.0)], (state.scale / predicted.scale).ln(), firm(o.scale_motion));
        add(&[(SCALE, 1.0)], (state.scale / open.scale).ln(), firm(o.size));
        let turned = (state.rotation * predicted.rotation.inverse()).scaled_axis();
        for (k, deviation) in [o.tilt_motion, o.tilt_motion, o.turn_motion].into_iter().enumerate() {
            add(&[(TURN + k, 1.0)], turned[k], firm(deviation));
        }
        let tilted = (state.rotation * open.rotation.inverse()).scaled_axis();
        let flexions = Finger::LONG.into_iter().flat_map(|f| [3 * f as usize, 3 * f as usize + 2]);
        let bent: f64 = flexions.map(|i| (state.free[i] - open.free[i]).abs()).sum();
        let reach = o.tilt_reach + o.tilt_reach_bent * bent * bent;
        for k in 0..2 {
            add(&[(TURN + k, 1.0)], tilted[k], fading(o.tilt, reach));
        }
        for i in 0..15 {
            add(&[(FREE + i, 1.0)], state.free[i] - predicted.free[i], fading(o.angle_motion, o.jump));
            if i % 3 != 1 {
                let off = state.free[i] - open.free[i];
                add(&[(FREE + i, 1.0)], off, o.of_flexion(i, off));
            }
        }
        add(&[(FREE + 1, 1.0)], state.free[1] - open.free[1], firm(o.thumb_abduction));
        for finger in Finger::LONG {
            let i = 3 * finger as usize;
            let (flexion, opened) = (state.free[i], open.free[i + 1]);
            let off = state.free[i + 1] - spread(opened, flexion);
            let with_bend = if (0.0..FRAC_PI_2).contains(&flexion) { opened / FRAC_PI_2 } else { 0.0 };
            add(&[(FREE + i + 1, 1.0), (FREE + i, with_bend)], off, firm(o.abduction));
            let uneven = 0.8 * state.free[i + 2] - state.free[i];
            add(&[(FREE + i + 2, 0.8), (FREE + i, -1.0)], uneven, firm(o.uneven));
        }
        add(&[(THUMB_MCP, 1.0)], state.thumb_mcp - predicted.thumb_mcp, fading(o.angle_motion, o.jump));
        add(&[(THUMB_MCP, 1.0)], state.thumb_mcp, firm(o.thumb_mcp));
        let mcp = thumb_mcp_from_cmc(state.free[0]) + state.thumb_mcp;
        let slopes = [(FREE, -0.8 * thumb_mcp_slope(state.free[0])), (FREE + 2, 1.0), (THUMB_MCP, -0.8)];
        add(&slopes, state.free[2] - 0.8 * mcp, firm(o.thumb_uneven));
        if let (Some(now), Some(then)) = (evidence.window().forearm(), &self.open.forearm) {
            let off = now.behind(state) - then.behind(open);
            let slopes = [(0, now.axis[0] / hand), (1, now.axis[1] / hand), (SCALE, -now.behind(state))];
            add(&slopes, off, firm(o.wrist));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn least_squares_and_cost_have_the_same_slope() {
        for doubt in [firm(0.2), fading(0.1, 0.3)] {
            for residual in [-0.8, -0.05, 0.0, 0.2, 0.5] {
                let h = 1e-6;
                let slope = (doubt.cost(residual + h) - doubt.cost(residual - h)) / (2.0 * h);
                assert!((slope - doubt.weight(residual) * residual).abs() < 1e-4, "{doubt:?} {residual}");
            }
        }
        assert!(fading(0.1, 0.3).cost(3.0) > fading(0.1, 0.3).cost(1.0));
    }
}
