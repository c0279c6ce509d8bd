//! Where the hand ends and the forearm begins.

use super::geometry::{
    distance, dot, facing, line_direction, minus, moved, pixel_centre, quarter_turn, unit,
};
use super::mask::Mask;
use super::morphology::{Components, DistanceMap};

/// The wrist in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wrist {
    /// Middle of the cut, in pixels.
    pub centre: [f64; 2],
    /// Unit vector from the forearm to the hand.
    pub axis: [f64; 2],
    /// Length of the cut within the arm, in pixels.
    pub width: f64,
}

impl Wrist {
    /// Signed distance of a point to the cut, in pixels: positive on the hand's side.
    pub fn side(&self, point: [f64; 2]) -> f64 {
        dot(minus(point, self.centre), self.axis)
    }

    /// The two ends of the cut.
    pub fn ends(&self) -> [[f64; 2]; 2] {
        let half = 0.5 * self.width;
        [half, -half].map(|s| moved(self.centre, quarter_turn(self.axis), s))
    }
}

/// A circle inscribed in a silhouette: the largest round its centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InscribedCircle {
    /// Centre, pixels.
    pub centre: [f64; 2],
    /// Radius, pixels: the centre's distance to the background.
    pub radius: f64,
}

/// Distance from the centre of the palm's circle to the wrist, in radii of that circle. The circle of an open
/// hand touches both sides of a palm some 84 mm wide, and its centre lies some 45 mm above the wrist crease; in a
/// fist the circle is larger and lies lower.
const WRIST_DISTANCE: f64 = 1.05;
/// Width of a wrist in radii of the palm's circle, for sections that the image border cuts.
const WRIST_WIDTH: f64 = 1.4;

/// Cuts the forearm from an arm.
///
/// The arm is followed from its far end, the fingers, to the side where it leaves the picture (or to its blunt
/// end); the palm is the first large inscribed circle on the way, and the wrist the narrowest place behind it.
/// `prior`, the wrist of the frame before, pulls the cut towards itself. Gives the hand, and the wrist if there is a
/// forearm or an end of one; without, the hand is the arm.
pub fn cut_forearm(arm: &Mask, prior: Option<&Wrist>) -> (Mask, Option<Wrist>) {
    let cut = cut_arm(arm, prior);
    (cut.hand, cut.wrist)
}

/// An arm cut at the wrist.
pub(super) struct ArmCut {
    pub(super) hand: Mask,
    pub(super) wrist: Option<Wrist>,
    /// The largest circle inscribed in the palm.
    pub(super) palm: Option<InscribedCircle>,
}

/// As [`cut_forearm`], with the palm.
pub(super) fn cut_arm(arm: &Mask, prior: Option<&Wrist>) -> ArmCut {
    match find_wrist(arm, prior) {
        Some((Some(wrist), palm)) => {
            ArmCut { hand: hand_side(arm, &wrist, &palm), wrist: Some(wrist), palm: Some(palm) }
        }
        Some((None, palm)) => ArmCut { hand: arm.clone(), wrist: None, palm: Some(palm) },
        None => ArmCut { hand: arm.clone(), wrist: None, palm: None },
    }
}

/// The part of `arm` beyond the wrist that holds the palm.
fn hand_side(arm: &Mask, wrist: &Wrist, palm: &InscribedCircle) -> Mask {
    let mut beyond = Mask::new(arm.width(), arm.height());
    for y in 0..arm.height() {
        for (start, end) in arm.runs(y) {
            // The cut crosses a row once: solve for x instead of testing every pixel.
            let row = f64::from(y) + 0.5;
            let at = |x: u32| wrist.side([f64::from(x) + 0.5, row]) > 0.0;
            let (first, last) = (at(start), at(end - 1));
            if first && last {
                beyond.fill_span(y, start as i32, end as i32);
            } else if first || last {
                let crossing =
                    wrist.centre[0] - (row - wrist.centre[1]) * wrist.axis[1] / wrist.axis[0] - 0.5;
                let (from, to) = if first {
                    (start as i32, crossing.ceil() as i32)
                } else {
                    (crossing.floor() as i32 + 1, end as i32)
                };
                beyond.fill_span(y, from.max(start as i32), to.min(end as i32));
            }
        }
    }
    let parts = Components::of(&beyond, true);
    let [px, py] = palm.centre.map(|v| v as u32);
    let chosen = parts
        .spans()
        .find(|&(_, y, start, end)| y == py && (start..end).contains(&px))
        .map(|span| span.0)
        .or(parts.largest());
    let mut hand = Mask::new(arm.width(), arm.height());
    parts.draw(&mut hand, |i, _| Some(i) == chosen);
    hand
}

/// Where the arm comes from: the middle of the longest stretch of it along the image border.
fn entry(arm: &Mask) -> Option<([f64; 2], f64)> {
    let (w, h) = (arm.width(), arm.height());
    if w < 2 || h < 2 {
        return None;
    }
    // Once round the border, clockwise from the upper left corner.
    let border: Vec<(u32, u32)> = (0..w)
        .map(|x| (x, 0))
        .chain((1..h).map(|y| (w - 1, y)))
        .chain((0..w - 1).rev().map(|x| (x, h - 1)))
        .chain((1..h - 1).rev().map(|y| (0, y)))
        .collect();
    let inside = |i: usize| border.get(i % border.len()).is_some_and(|p| arm.get(p.0, p.1));
    let start = (0..border.len()).find(|&i| !inside(i))?;
    let (mut best, mut run) = (None, 0usize);
    for i in start..=start + border.len() {
        if inside(i) {
            run += 1;
        } else {
            if run > 0 && best.is_none_or(|(length, _)| run > length) {
                best = Some((run, i - run));
            }
            run = 0;
        }
    }
    let (length, first) = best?;
    // Across a corner the middle of the chord, not of the way round it.
    let (a, b) = (border.get(first % border.len())?, border.get((first + length - 1) % border.len())?);
    let chord = distance(pixel_centre(a.0, a.1), pixel_centre(b.0, b.1)) + 1.0;
    Some(([a.0 + b.0, a.1 + b.1].map(|sum| (f64::from(sum) + 1.0) / 2.0), chord))
}

/// The circles inscribed in the arm round each of its pixels, in row order.
///
/// What lies outside the image counts as background: an arm that runs along the border would else seem as thick
/// as it could be.
fn inscribed_circles(arm: &Mask) -> Vec<InscribedCircle> {
    let Some(bounds) = arm.bounds() else { return Vec::new() };
    let inner = arm.cropped(bounds);
    let mut framed = Mask::new(inner.width() + 2, inner.height() + 2);
    for y in 0..inner.height() {
        for (start, end) in inner.runs(y) {
            framed.fill_span(y + 1, start as i32 + 1, end as i32 + 1);
        }
    }
    let map = DistanceMap::to_value(&framed, false);
    let mut out = Vec::with_capacity(arm.area() as usize);
    for y in 0..framed.height() {
        for (start, end) in framed.runs(y) {
            for x in start..end {
                let centre = [x + bounds.x0, y + bounds.y0].map(|v| f64::from(v) - 0.5);
                out.push(InscribedCircle { centre, radius: f64::from(map.squared(x, y)).sqrt() - 0.5 });
            }
        }
    }
    out
}

/// The wrist and the palm's circle.
fn find_wrist(arm: &Mask, prior: Option<&Wrist>) -> Option<(Option<Wrist>, InscribedCircle)> {
    let circles = inscribed_circles(arm);
    let largest = circles.iter().map(|c| c.radius).fold(0.0, f64::max);
    let large: Vec<InscribedCircle> =
        circles.iter().filter(|c| c.radius > PALM_RADIUS * largest).copied().collect();
    let centroid = arm.centroid()?;
    // A finger that touches the border is no forearm.
    let from_border = entry(arm).filter(|(_, chord)| *chord > 0.8 * largest);
    let (towards, forearm) = match (from_border, prior) {
        (Some((at, _)), _) => (unit(minus(centroid, at))?, true),
        (None, Some(wrist)) => (wrist.axis, false),
        (None, None) => (blunt_end(&circles, centroid)?, false),
    };
    let mut axis = towards;
    let mut palm = first_palm(&large, axis)?;
    if let Some((at, _)) = from_border {
        // The centroid lies to one side in a spread hand; from the palm the forearm's direction is known better.
        axis = unit(minus(palm.centre, at)).unwrap_or(axis);
        palm = first_palm(&large, axis)?;
    }
    if forearm {
        axis = forearm_direction(arm, &palm, axis);
    }
    Some((narrowest_section(arm, &palm, axis, prior), palm))
}

/// Direction from a blunt end to the fingers, for an arm that ends within the picture (a sleeve): fingers are
/// thin, so the mean of the thin parts lies towards them.
fn blunt_end(circles: &[InscribedCircle], centroid: [f64; 2]) -> Option<[f64; 2]> {
    let mut largest = InscribedCircle { centre: centroid, radius: 0.0 };
    for c in circles {
        if c.radius > largest.radius {
            largest = *c;
        }
    }
    let (mut n, mut sum) = (0.0, [0.0; 2]);
    for c in circles {
        let out = distance(c.centre, largest.centre);
        if out > 1.5 * largest.radius && c.radius < 0.5 * largest.radius {
            n += 1.0;
            sum = [sum[0] + c.centre[0], sum[1] + c.centre[1]];
        }
    }
    if n < 0.05 * largest.radius * largest.radius {
        // A fist: the only hint is where most of it lies from its thickest place.
        return unit(minus(centroid, largest.centre));
    }
    unit(minus(sum.map(|v| v / n), largest.centre))
}

/// The palm's circle has at least this share of the radius of the largest in the arm.
const PALM_RADIUS: f64 = 0.6;
/// A circle not outgrown within this many of its radii is the palm's, not the root of a finger.
const PALM_LEAD: f64 = 1.35;
/// Closed fingers are nearly as wide as the palm, whose centre lies this many of their circles' radii behind; the
/// forearm is thinner than the palm so near to it.
const CLOSED_LEAD: f64 = 2.6;
/// How much larger a circle must be to be the palm's behind closed fingers.
const CLOSED_GROWTH: f64 = 1.03;

/// The first large circle met from the far end of the arm.
fn first_palm(circles: &[InscribedCircle], axis: [f64; 2]) -> Option<InscribedCircle> {
    let along = |c: &InscribedCircle| dot(c.centre, axis);
    let high = circles.iter().map(along).fold(f64::NEG_INFINITY, f64::max);
    let low = circles.iter().map(along).fold(f64::INFINITY, f64::min);
    if low > high {
        return None;
    }
    // The largest circle for every pixel of distance along the axis.
    let none = InscribedCircle { centre: [0.0; 2], radius: 0.0 };
    let mut slices = vec![none; (high - low) as usize + 1];
    for c in circles {
        if let Some(slice) = slices.get_mut((high - along(c)) as usize)
            && c.radius > slice.radius
        {
            *slice = *c;
        }
    }
    let mut best = none;
    for (s, slice) in slices.iter().enumerate() {
        let passed = s as f64 - (high - along(&best));
        if best.radius > 0.0 && passed > CLOSED_LEAD * best.radius {
            break;
        }
        let needed = if passed > PALM_LEAD * best.radius { CLOSED_GROWTH } else { 1.0 };
        if slice.radius > needed * best.radius {
            best = *slice;
        }
    }
    (best.radius > 0.0).then_some(best)
}

/// Start and end of the arm across the axis at `origin`, in pixels from it; `None` outside the arm.
pub(super) fn cross_section(arm: &Mask, origin: [f64; 2], axis: [f64; 2], reach: f64) -> Option<(f64, f64)> {
    const STEP: f64 = 0.5;
    let across = quarter_turn(axis);
    let inside = |s: f64| {
        let [x, y] = moved(origin, across, s);
        x >= 0.0 && y >= 0.0 && arm.get(x as u32, y as u32)
    };
    // The axis may miss the arm by a little where the arm bends.
    let limit = (reach / STEP) as i32;
    let first =
        (0..limit / 2).flat_map(|k| [f64::from(k) * STEP, -f64::from(k) * STEP]).find(|&s| inside(s))?;
    let edge = |direction: f64| {
        let mut s = first;
        for _ in 0..limit * 2 {
            if !inside(s + direction * STEP) {
                break;
            }
            s += direction * STEP;
        }
        s + direction * 0.5 * STEP
    };
    Some((edge(-1.0), edge(1.0)))
}

/// Direction of the forearm just behind the palm, by a line through the middles of its cross-sections.
fn forearm_direction(arm: &Mask, palm: &InscribedCircle, axis: [f64; 2]) -> [f64; 2] {
    let mut axis = axis;
    for _ in 0..2 {
        let mut points = Vec::new();
        let mut t = 1.3;
        while t < 3.2 {
            let at = moved(palm.centre, axis.map(|v| v * t), -palm.radius);
            let cut = cross_section(arm, at, axis, 2.0 * palm.radius);
            t += 0.1;
            let Some((low, high)) = cut else { continue };
            let ends = [low, high].map(|s| moved(at, quarter_turn(axis), s));
            // Cut by the image border, a section has no true middle.
            if !ends.into_iter().any(|end| at_border(arm, end)) {
                let middle = 0.5 * (low + high);
                points.push(moved(at, quarter_turn(axis), middle));
            }
        }
        if points.len() < 6 {
            return axis;
        }
        let Some(line) = line_direction(&points) else { return axis };
        let line = facing(line, axis);
        // The shorter the visible forearm, the less its line weighs.
        let weight = ((points.len() as f64 - 4.0) / 10.0).clamp(0.0, 1.0);
        let blended = [0, 1].map(|i| axis[i] * (1.0 - weight) + line[i] * weight);
        axis = unit(blended).unwrap_or(axis);
    }
    axis
}

/// Whether a point lies so near the image border that the arm may go on beyond it.
fn at_border(arm: &Mask, [x, y]: [f64; 2]) -> bool {
    x < 2.0 || y < 2.0 || x > f64::from(arm.width()) - 2.0 || y > f64::from(arm.height()) - 2.0
}

/// The wrist: a narrow cross-section behind the palm, near the expected distance.
fn narrowest_section(
    arm: &Mask,
    palm: &InscribedCircle,
    axis: [f64; 2],
    prior: Option<&Wrist>,
) -> Option<Wrist> {
    let radius = palm.radius;
    let mut best: Option<(f64, Wrist)> = None;
    let mut t = 0.7;
    while t <= 1.8 {
        let at = moved(palm.centre, axis.map(|v| v * t), -radius);
        let Some((low, high)) = cross_section(arm, at, axis, 2.5 * radius) else {
            // Beyond the end of the arm.
            break;
        };
        let point = |s: f64| moved(at, quarter_turn(axis), s);
        let (centre, width, narrow) = match (at_border(arm, point(low)), at_border(arm, point(high))) {
            (false, false) => (point(0.5 * (low + high)), high - low, (high - low) / radius),
            // The hidden end is taken to be as far from the axis as the visible one.
            (true, false) => (at, 2.0 * high.max(0.0), WRIST_WIDTH),
            (false, true) => (at, 2.0 * (-low).max(0.0), WRIST_WIDTH),
            (true, true) => (point(0.5 * (low + high)), high - low, WRIST_WIDTH),
        };
        let mut cost = 0.5 * narrow + 0.8 * (t - WRIST_DISTANCE).powi(2);
        if let Some(prior) = prior {
            // Between frames a wrist moves little; a jump costs the same however far it goes.
            cost += 0.6 * (prior.side(centre) / radius).powi(2).min(0.09);
        }
        if best.is_none_or(|(least, _)| cost < least) {
            best = Some((cost, Wrist { centre, axis, width }));
        }
        t += 0.02;
    }
    // An arm that ends before the wrist is expected shows no wrist.
    best.filter(|_| t > 0.9 * WRIST_DISTANCE).map(|(_, wrist)| wrist)
}
