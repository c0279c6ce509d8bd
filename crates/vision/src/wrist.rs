//! Where the hand ends and the forearm begins.

use super::geometry::{
    distance, dot, facing, line_direction, minus, moved, pixel_centre, quarter_turn, unit,
};
use super::mask::Mask;
use super::morphology::{Components, DistanceMap};
use super::tuning::tuning;

tuning! {
    /// How palm and wrist are found in an arm. Palm radii are those of the largest circle inscribed in the palm.
    pub struct WristTuning {
        /// Palm.
        pub palm: PalmTuning,
        /// Direction of an arm that ends within the picture.
        pub blunt_end: BluntEndTuning,
        /// Direction of the forearm.
        pub forearm: ForearmTuning,
        /// Place of the wrist.
        pub cut: CutTuning,
        /// A cross-section that ends this near to the image border may go on beyond it.
        ["pixels", "chosen by eye on the three real clips"]
        pub border: f64 = 2.0,
        /// A hand that reaches the image border no farther than this from the cut is not clipped.
        ["palm radii", "chosen by eye on the three real clips"]
        pub border_margin: f64 = 0.3,
    }
}

tuning! {
    /// How the palm is told from fingers and forearm: by circles inscribed in the arm.
    pub struct PalmTuning {
        /// Smallest radius of the palm's circle.
        ["radii of the largest circle", "chosen by eye on the three real clips"]
        pub min_radius: f64 = 0.6,
        /// Shortest stretch of the image border that an arm enters by: a finger that touches the border is none.
        ["radii of the largest circle", "chosen by eye on the three real clips"]
        pub min_entry: f64 = 0.8,
        /// A circle that no other outgrows within this distance behind it is the palm's, not the root of a finger.
        ["radii of the circle", "chosen by eye on the three real clips"]
        pub lead: f64 = 1.35,
        /// The same behind closed fingers, which are nearly as wide as the palm; the forearm is thinner than the palm
        /// so near to it.
        ["radii of the circle", "chosen by eye on the stills of closed fingers"]
        pub closed_lead: f64 = 2.6,
        /// How much larger a circle must be to be the palm's behind closed fingers.
        ["1", "chosen by eye on the stills of closed fingers"]
        pub closed_growth: f64 = 1.03,
    }
}

tuning! {
    /// How fingers are found in an arm that ends within the picture: they are thin and far from the thickest place.
    pub struct BluntEndTuning {
        /// Distance of fingers from the centre of the largest circle.
        ["radii of the largest circle", "chosen by eye on the three real clips"]
        pub finger_distance: f64 = 1.5,
        /// Largest radius of the circles inscribed in fingers.
        ["radii of the largest circle", "chosen by eye on the three real clips"]
        pub finger_radius: f64 = 0.5,
        /// Smallest area of fingers; with less it is a fist.
        ["squared radii of the largest circle", "chosen by eye on the three real clips"]
        pub min_finger_area: f64 = 0.05,
    }
}

tuning! {
    /// How the direction of the forearm is found: by a line through the middles of its cross-sections.
    pub struct ForearmTuning {
        /// Rounds of cross-sections, each across the direction found by the one before.
        ["rounds", "chosen by eye on the three real clips"]
        pub rounds: usize = 2,
        /// Distance of the first cross-section from the palm's centre.
        ["palm radii", "chosen by eye on the three real clips"]
        pub from: f64 = 1.3,
        /// Distance below which the last lies.
        ["palm radii", "chosen by eye on the three real clips"]
        pub to: f64 = 3.2,
        /// Distance from one to the next.
        ["palm radii", "chosen by eye on the three real clips"]
        pub step: f64 = 0.1,
        /// Length of a cross-section to either side.
        ["palm radii", "chosen by eye on the three real clips"]
        pub reach: f64 = 2.0,
        /// Fewest cross-sections that make a line.
        ["sections", "chosen by eye on the three real clips"]
        pub min_sections: usize = 6,
        /// Cross-sections up to which the line has no weight against the direction of the palm from where the arm
        /// enters the picture.
        ["sections", "chosen by eye on the three real clips"]
        pub weightless_sections: f64 = 4.0,
        /// Cross-sections beyond those at which the line has all the weight.
        ["sections", "chosen by eye on the three real clips"]
        pub full_weight_sections: f64 = 10.0,
    }
}

tuning! {
    /// How the wrist is found: as the cross-section of least cost behind the palm.
    pub struct CutTuning {
        /// Expected distance of the wrist from the palm's centre. The circle of an open hand touches both sides of a
        /// palm some 84 mm wide, and its centre lies some 45 mm above the wrist crease; in a fist the circle is
        /// larger and lies lower.
        ["palm radii", "a palm of 84 mm, the wrist crease 45 mm below its centre"]
        pub distance: f64 = 1.05,
        /// Distance of the first cross-section from the palm's centre.
        ["palm radii", "chosen by eye on the three real clips"]
        pub from: f64 = 0.7,
        /// Distance of the last.
        ["palm radii", "chosen by eye on the three real clips"]
        pub to: f64 = 1.8,
        /// Distance from one to the next.
        ["palm radii", "chosen by eye on the three real clips"]
        pub step: f64 = 0.02,
        /// Length of a cross-section to either side.
        ["palm radii", "chosen by eye on the three real clips"]
        pub reach: f64 = 2.5,
        /// Width of a wrist, for cross-sections that the image border cuts.
        ["palm radii", "chosen by eye on the three real clips"]
        pub hidden_width: f64 = 1.4,
        /// Cost of the width of a cross-section.
        ["1 / palm radius", "chosen by eye on the three real clips"]
        pub width_cost: f64 = 0.5,
        /// Cost of the squared distance from the expected one.
        ["1 / squared palm radius", "chosen by eye on the three real clips"]
        pub distance_cost: f64 = 0.8,
        /// Cost of the squared distance from the cut of the frame before.
        ["1 / squared palm radius", "chosen by eye on the three real clips"]
        pub prior_cost: f64 = 0.6,
        /// Squared distance from the cut of the frame before beyond which the cost stays the same: a jump.
        ["squared palm radii", "chosen by eye on the three real clips"]
        pub prior_limit: f64 = 0.09,
        /// An arm that ends nearer to the palm's centre than this shows no wrist.
        ["expected distances", "chosen by eye on the three real clips"]
        pub min_forearm: f64 = 0.9,
    }
}

/// Distance of the points at which a cross-section is sampled, pixels.
const SECTION_STEP: f64 = 0.5;
/// Shortest way from one cross-section to the next, palm radii.
const MIN_STEP: f64 = 1e-3;

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

/// Cuts the forearm from an arm.
///
/// The arm is followed from its far end, the fingers, to the side where it leaves the picture (or to its blunt
/// end); the palm is the first large inscribed circle on the way, and the wrist the narrowest place behind it.
/// `prior`, the wrist of the frame before, pulls the cut towards itself. Gives the hand, and the wrist if there is a
/// forearm or an end of one; without, the hand is the arm.
pub fn cut_forearm(arm: &Mask, prior: Option<&Wrist>, tuning: &WristTuning) -> (Mask, Option<Wrist>) {
    let cut = cut_arm(arm, prior, tuning);
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
pub(super) fn cut_arm(arm: &Mask, prior: Option<&Wrist>, tuning: &WristTuning) -> ArmCut {
    match find_wrist(arm, prior, tuning) {
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
fn find_wrist(
    arm: &Mask,
    prior: Option<&Wrist>,
    tuning: &WristTuning,
) -> Option<(Option<Wrist>, InscribedCircle)> {
    let circles = inscribed_circles(arm);
    let largest = circles.iter().map(|c| c.radius).fold(0.0, f64::max);
    let large: Vec<InscribedCircle> =
        circles.iter().filter(|c| c.radius > tuning.palm.min_radius * largest).copied().collect();
    let centroid = arm.centroid()?;
    // A finger that touches the border is no forearm.
    let from_border = entry(arm).filter(|(_, chord)| *chord > tuning.palm.min_entry * largest);
    let (towards, forearm) = match (from_border, prior) {
        (Some((at, _)), _) => (unit(minus(centroid, at))?, true),
        (None, Some(wrist)) => (wrist.axis, false),
        (None, None) => (blunt_end(&circles, centroid, &tuning.blunt_end)?, false),
    };
    let mut axis = towards;
    let mut palm = first_palm(&large, axis, &tuning.palm)?;
    if let Some((at, _)) = from_border {
        // The centroid lies to one side in a spread hand; from the palm the forearm's direction is known better.
        axis = unit(minus(palm.centre, at)).unwrap_or(axis);
        palm = first_palm(&large, axis, &tuning.palm)?;
    }
    if forearm {
        axis = forearm_direction(arm, &palm, axis, tuning);
    }
    Some((narrowest_section(arm, &palm, axis, prior, tuning), palm))
}

/// Direction from a blunt end to the fingers, for an arm that ends within the picture (a sleeve): fingers are
/// thin, so the mean of the thin parts lies towards them.
fn blunt_end(circles: &[InscribedCircle], centroid: [f64; 2], tuning: &BluntEndTuning) -> Option<[f64; 2]> {
    let mut largest = InscribedCircle { centre: centroid, radius: 0.0 };
    for c in circles {
        if c.radius > largest.radius {
            largest = *c;
        }
    }
    let (mut n, mut sum) = (0.0, [0.0; 2]);
    for c in circles {
        let out = distance(c.centre, largest.centre);
        if out > tuning.finger_distance * largest.radius && c.radius < tuning.finger_radius * largest.radius {
            n += 1.0;
            sum = [sum[0] + c.centre[0], sum[1] + c.centre[1]];
        }
    }
    if n < tuning.min_finger_area * largest.radius * largest.radius {
        // A fist: the only hint is where most of it lies from its thickest place.
        return unit(minus(centroid, largest.centre));
    }
    unit(minus(sum.map(|v| v / n), largest.centre))
}

/// The first large circle met from the far end of the arm.
fn first_palm(circles: &[InscribedCircle], axis: [f64; 2], tuning: &PalmTuning) -> Option<InscribedCircle> {
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
        if best.radius > 0.0 && passed > tuning.closed_lead * best.radius {
            break;
        }
        let needed = if passed > tuning.lead * best.radius { tuning.closed_growth } else { 1.0 };
        if slice.radius > needed * best.radius {
            best = *slice;
        }
    }
    (best.radius > 0.0).then_some(best)
}

/// Start and end of the arm across the axis at `origin`, in pixels from it; `None` outside the arm.
pub(super) fn cross_section(arm: &Mask, origin: [f64; 2], axis: [f64; 2], reach: f64) -> Option<(f64, f64)> {
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
fn forearm_direction(arm: &Mask, palm: &InscribedCircle, axis: [f64; 2], tuning: &WristTuning) -> [f64; 2] {
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
fn narrowest_section(
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
