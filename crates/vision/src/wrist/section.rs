//! Cross-sections of an arm: the direction of the forearm, and the wrist.

use super::{InscribedCircle, Wrist, WristTuning};
use crate::geometry::{facing, line_direction, moved, quarter_turn, unit};
use crate::mask::Mask;

/// Distance of the points at which a cross-section is sampled, pixels.
const SECTION_STEP: f64 = 0.5;
/// Shortest way from one cross-section to the next, palm radii.
const MIN_STEP: f64 = 1e-3;

/// Start and end of the arm across the axis at `origin`, in pixels from it; `None` outside the arm.
pub(crate) fn cross_section(arm: &Mask, origin: [f64; 2], axis: [f64; 2], reach: f64) -> Option<(f64, f64)> {
    let across = quarter_turn(axis);
    let inside = |s: f64| {
        let [x, y] = moved(origin, across, s);
        x >= 0.0 && y >= 0.0 && arm.get(x as u32, y as u32)
    };
    // The axis may miss the arm by a little where the arm bends.
    let limit = (reach / SECTION_STEP) as i32;
    let first = (0..limit / 2)
        .flat_map(|k| [f64::from(k) * SECTION_STEP, -f64::from(k) * SECTION_STEP])
        .find(|&s| inside(s))?;
    let edge = |direction: f64| {
        let mut s = first;
        for _ in 0..limit.saturating_mul(2) {
            if !inside(s + direction * SECTION_STEP) {
                break;
            }
            s += direction * SECTION_STEP;
        }
        s + direction * 0.5 * SECTION_STEP
    };
    Some((edge(-1.0), edge(1.0)))
}

/// Direction of the forearm just behind the palm, by a line through the middles of its cross-sections.
pub(super) fn forearm_direction(
    arm: &Mask,
    palm: &InscribedCircle,
    axis: [f64; 2],
    tuning: &WristTuning,
) -> [f64; 2] {
    let forearm = &tuning.forearm;
    let step = forearm.step.max(MIN_STEP);
    let mut axis = axis;
    for _ in 0..forearm.rounds {
        let mut points = Vec::new();
        let mut t = forearm.from;
        while t < forearm.to {
            let at = moved(palm.centre, axis.map(|v| v * t), -palm.radius);
            let cut = cross_section(arm, at, axis, forearm.reach * palm.radius);
            t += step;
            let Some((low, high)) = cut else { continue };
            let ends = [low, high].map(|s| moved(at, quarter_turn(axis), s));
            // Cut by the image border, a section has no true middle.
            if !ends.into_iter().any(|end| at_border(arm, end, tuning.border)) {
                let middle = 0.5 * (low + high);
                points.push(moved(at, quarter_turn(axis), middle));
            }
        }
        if points.len() < forearm.min_sections {
            return axis;
        }
        let Some(line) = line_direction(&points) else { return axis };
        let line = facing(line, axis);
        // The shorter the visible forearm, the less its line weighs.
        let weight = (points.len() as f64 - forearm.weightless_sections) / forearm.full_weight_sections;
        let weight = weight.clamp(0.0, 1.0);
        let blended = [0, 1].map(|i| axis[i] * (1.0 - weight) + line[i] * weight);
        axis = unit(blended).unwrap_or(axis);
    }
    axis
}

/// Whether a point lies so near the image border that the arm may go on beyond it.
fn at_border(arm: &Mask, [x, y]: [f64; 2], near: f64) -> bool {
    x < near || y < near || x > f64::from(arm.width()) - near || y > f64::from(arm.height()) - near
}

/// The wrist: a narrow cross-section behind the palm, near the expected distance.
pub(super) fn narrowest_section(
    arm: &Mask,
    palm: &InscribedCircle,
    axis: [f64; 2],
    prior: Option<&Wrist>,
    tuning: &WristTuning,
) -> Option<Wrist> {
    let (radius, cut) = (palm.radius, &tuning.cut);
    let step = cut.step.max(MIN_STEP);
    let hidden = |end: [f64; 2]| at_border(arm, end, tuning.border);
    let mut best: Option<(f64, Wrist)> = None;
    let mut t = cut.from;
    while t <= cut.to {
        let at = moved(palm.centre, axis.map(|v| v * t), -radius);
        let Some((low, high)) = cross_section(arm, at, axis, cut.reach * radius) else {
            // Beyond the end of the arm.
            break;
        };
        let point = |s: f64| moved(at, quarter_turn(axis), s);
        let (centre, width, narrow) = match (hidden(point(low)), hidden(point(high))) {
            (false, false) => (point(0.5 * (low + high)), high - low, (high - low) / radius),
            // The hidden end is taken to be as far from the axis as the visible one.
            (true, false) => (at, 2.0 * high.max(0.0), cut.hidden_width),
            (false, true) => (at, 2.0 * (-low).max(0.0), cut.hidden_width),
            (true, true) => (point(0.5 * (low + high)), high - low, cut.hidden_width),
        };
        let mut cost = cut.width_cost * narrow + cut.distance_cost * (t - cut.distance).powi(2);
        if let Some(prior) = prior {
            // Between frames a wrist moves little; a jump costs the same however far it goes.
            cost += cut.prior_cost * (prior.side(centre) / radius).powi(2).min(cut.prior_limit);
        }
        if best.is_none_or(|(least, _)| cost < least) {
            best = Some((cost, Wrist { centre, axis, width }));
        }
        t += step;
    }
    // An arm that ends before the wrist is expected shows no wrist.
    best.filter(|_| t > cut.min_forearm * cut.distance).map(|(_, wrist)| wrist)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::distance;

    #[test]
    fn a_bar_has_its_width_as_cross_section_whichever_way_it_points() {
        let centre = [100.0, 90.0];
        for step in 0..12 {
            let angle = 0.5 * f64::from(step);
            let axis = [angle.cos(), angle.sin()];
            let bar = Mask::from_fn(200, 180, |x, y| {
                let d = [f64::from(x) + 0.5 - centre[0], f64::from(y) + 0.5 - centre[1]];
                let (along, off) = (d[0] * axis[0] + d[1] * axis[1], d[0] * axis[1] - d[1] * axis[0]);
                along.abs() < 60.0 && off.abs() < 15.0
            });
            // From beside its middle, too.
            for off in [0.0, 11.0, -20.0] {
                let origin = moved(centre, quarter_turn(axis), off);
                let (low, high) = cross_section(&bar, origin, axis, 50.0).unwrap();
                assert!((low + 15.0 + off).abs() < 1.3 && (high - 15.0 + off).abs() < 1.3, "{angle} {off}");
            }
            assert_eq!(cross_section(&bar, moved(centre, axis, 70.0), axis, 50.0), None);
        }
    }

    #[test]
    fn a_forearm_is_followed_and_cut_at_its_waist() {
        // A palm, its forearm slanting down to the border, thinner 45 pixels behind the palm's centre.
        let palm = InscribedCircle { centre: [100.0, 60.0], radius: 40.0 };
        let axis = [0.3f64.sin(), -(0.3f64.cos())];
        let arm = Mask::from_fn(240, 260, |x, y| {
            let p = [f64::from(x) + 0.5, f64::from(y) + 0.5];
            let d = [p[0] - palm.centre[0], p[1] - palm.centre[1]];
            let behind = -(d[0] * axis[0] + d[1] * axis[1]);
            let off = (d[0] * axis[1] - d[1] * axis[0]).abs();
            distance(p, palm.centre) < palm.radius || behind > 0.0 && off < 26.0 + 0.1 * (behind - 45.0).abs()
        });
        let tuning = WristTuning::default();
        let found = forearm_direction(&arm, &palm, [0.0, -1.0], &tuning);
        assert!(distance(found, axis) < 0.05, "{found:?} {axis:?}");
        let wrist = narrowest_section(&arm, &palm, found, None, &tuning).unwrap();
        assert!(distance(wrist.centre, moved(palm.centre, axis, -45.0)) < 5.0, "{wrist:?}");
        assert!((wrist.width - 52.0).abs() < 3.0, "{wrist:?}");
    }
}
