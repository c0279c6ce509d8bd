//! Fingers, palm and wrist of an open hand, from its silhouette.

use thiserror::Error;

use super::geometry::{
    cross, crossing, distance, dot, facing, line_direction, mean, minus, moved, pixel_centre, quarter_turn,
    unit,
};
use super::mask::{Mask, PixelRect};
use super::morphology::{Components, open_disc};
use super::segment::Silhouette;
use super::tuning::tuning;
use super::wrist::{InscribedCircle, cross_section};

tuning! {
    /// How fingers, palm and wrist of an open hand are found. Palm radii are those of the largest circle inscribed in
    /// the palm.
    pub struct PartsTuning {
        /// Radius of the disc of the top-hat. A finger has a quarter of the palm's radius, two fingers side by side
        /// half of it.
        ["palm radii", "paper, 5.1 (a little wider than a finger)"]
        pub top_hat_radius: f64 = 0.36,
        /// Smallest connected part of the top-hat that is looked at.
        ["squared palm radii", "chosen by eye on real clips and stills"]
        pub min_residue: f64 = 0.08,
        /// What is a finger.
        pub finger: FingerTuning,
        /// How far a palm may reach from its centre; fingers side by side reach farther.
        ["palm radii", "chosen by eye on the stills of closed fingers"]
        pub closed_reach: f64 = 2.0,
        /// Which finger is the thumb.
        pub thumb: ThumbTuning,
        /// Sine of the least angle at which the axes of hand and finger cross.
        ["1", "chosen by eye on real clips and stills"]
        pub min_crossing: f64 = 0.05,
        /// Crossings from the first to below the second distance behind the palm's centre count for the wrist: nearly
        /// parallel axes cross anywhere.
        ["palm radii", "paper, 5.1 for the crossings; their range by eye on real clips and stills"]
        pub crossing_range: [f64; 2] = [-0.5, 4.0],
        /// Length to either side of the cross-section that measures the palm's width.
        ["palm radii", "chosen by eye on real clips and stills"]
        pub width_reach: f64 = 2.0,
        /// Lengths from web to tip of thumb, index, middle, ring and little finger of a flat open hand.
        ["palm radii", "chosen by eye on real clips and stills"]
        pub free_lengths: [f64; 5] = [1.05, 1.45, 1.6, 1.5, 1.1],
    }
}

tuning! {
    /// What shape makes a part of the top-hat a finger: its axis is a line through the middles of its cross-sections.
    pub struct FingerTuning {
        /// Rounds of cross-sections, each across the axis found by the one before.
        ["rounds", "chosen by eye on real clips and stills"]
        pub rounds: usize = 3,
        /// Cross-sections.
        ["sections", "chosen by eye on real clips and stills"]
        pub sections: usize = 16,
        /// Where the first begin, from the inner end.
        ["1 (share of the part's length)", "chosen by eye on real clips and stills"]
        pub sections_from: f64 = 0.2,
        /// Length over which they are spread: neither the slanting base nor the round tip shows the axis.
        ["1 (share of the part's length)", "chosen by eye on real clips and stills"]
        pub sections_span: f64 = 0.65,
        /// Length of a cross-section to either side.
        ["palm radii", "chosen by eye on real clips and stills"]
        pub reach: f64 = 1.0,
        /// Width below which a cross-section is that of one finger.
        ["palm radii", "chosen by eye on real clips and stills"]
        pub max_width: f64 = 1.2,
        /// Distance from the axis below which the middle of a cross-section counts.
        ["palm radii", "chosen by eye on real clips and stills"]
        pub max_offset: f64 = 0.5,
        /// Fewest cross-sections that make an axis.
        ["sections", "chosen by eye on real clips and stills"]
        pub min_sections: usize = 6,
        /// The base is where the part ends within this distance of the axis: the middle of the finger, not the deepest
        /// corner of its web.
        ["radii of the finger", "chosen by eye on real clips and stills"]
        pub base_offset: f64 = 0.35,
        /// Least distance of the tip from the palm's centre.
        ["palm radii", "chosen by eye on real clips and stills"]
        pub min_tip: f64 = 1.25,
        /// How much farther than its base the tip is from the palm's centre, at least.
        ["palm radii", "chosen by eye on real clips and stills"]
        pub min_outward: f64 = 0.3,
        /// Least length over width.
        ["1", "chosen by eye on real clips and stills"]
        pub min_elongation: f64 = 1.1,
        /// Smallest and largest radius.
        ["palm radii", "chosen by eye on real clips and stills"]
        pub radii: [f64; 2] = [0.05, 0.45],
        /// Least length.
        ["palm radii", "chosen by eye on real clips and stills"]
        pub min_length: f64 = 0.45,
    }
}

tuning! {
    /// How the thumb is told from the little finger: of the two outer fingers it stands off farther. Its web is wide,
    /// its axis turned away from that of its neighbour, and it leaves the palm lower.
    pub struct ThumbTuning {
        /// How much the angle between the axes of finger and neighbour counts against the distance of their bases.
        ["palm radii / radian", "chosen by eye on real clips and stills"]
        pub turn_weight: f64 = 0.5,
        /// How much the height of the base above the palm's centre, along the middle finger, counts against that
        /// distance.
        ["1", "chosen by eye on real clips and stills"]
        pub height_weight: f64 = 0.7,
        /// How much farther than the little finger the thumb stands off, at least.
        ["palm radii", "chosen by eye on real clips and stills"]
        pub min_margin: f64 = 0.15,
        /// Half the width of what is left out as thumb where the hand's inertia axis is measured: a spread thumb would
        /// turn the axis of a hand that is nearly as wide as long.
        ["radii of the thumb", "chosen by eye on real clips and stills"]
        pub half_width: f64 = 2.0,
    }
}

/// One finger of the open hand's silhouette. Points and lengths in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FingerPart {
    /// Middle of the finger where it leaves the palm (the web, not the knuckle).
    pub base: [f64; 2],
    /// End of the finger on its axis.
    pub tip: [f64; 2],
    /// Unit vector from base to tip: the inertia axis of the finger.
    pub axis: [f64; 2],
    /// Distance from base to tip.
    pub length: f64,
    /// Half the width over the middle of the finger.
    pub radius: f64,
}

/// The line about which the moment of inertia of an area is smallest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InertiaAxis {
    /// Centroid of the area, pixels.
    pub centroid: [f64; 2],
    /// Unit vector along the line.
    pub direction: [f64; 2],
}

/// On which side the thumb is, seen with the fingers up. A silhouette does not tell palm from back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Chirality {
    /// Thumb to the right: a right hand's palm or a left hand's back.
    RightPalmOrLeftBack,
    /// Thumb to the left: a left hand's palm or a right hand's back.
    LeftPalmOrRightBack,
}

/// The parts of an open hand. Points and lengths in pixels of the silhouette.
#[derive(Clone, Debug, PartialEq)]
pub struct HandParts {
    /// Thumb, index, middle, ring and little finger.
    pub fingers: [FingerPart; 5],
    /// Hand without fingers and forearm.
    pub palm: Mask,
    /// Largest circle inscribed in the palm.
    pub palm_circle: InscribedCircle,
    /// From the wrist to the web of the middle finger.
    pub palm_length: f64,
    /// Across the palm below the four fingers.
    pub palm_width: f64,
    /// Where the forearm begins: the middle of the cut, or if there is no forearm `wrist_by_axes`.
    pub wrist: [f64; 2],
    /// Mean of the crossings of the hand's inertia axis, the thumb left out, with those of the four fingers.
    pub wrist_by_axes: [f64; 2],
    /// Unit vector from the wrist to the middle of the bases of the four fingers.
    pub axis: [f64; 2],
    /// Inertia axis of the hand, the thumb left out.
    pub inertia: InertiaAxis,
    /// Side of the thumb.
    pub chirality: Chirality,
    /// How clearly the thumb differs from the little finger: 0 not at all, 1 and above clearly.
    pub thumb_margin: f64,
    /// 1 if all fingers show the length they have in a flat open hand, less if they are bent or tilted.
    pub openness: f64,
}

/// Why a silhouette is not taken for an open hand.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum PartsError {
    /// The silhouette is empty or has no palm.
    #[error("no hand in the silhouette")]
    NoHand,
    /// Fingers touch each other.
    #[error("fingers are closed: {found} of 5 stand free; spread them")]
    FingersClosed {
        /// Fingers that stand free.
        found: usize,
    },
    /// Fingers are folded or hidden.
    #[error("fingers are missing: {found} of 5 are seen")]
    FingersMissing {
        /// Fingers seen.
        found: usize,
    },
    /// Part of the hand lies outside the picture.
    #[error("the hand is cut by the border of the picture: {found} of 5 fingers are seen whole")]
    Clipped {
        /// Fingers seen whole.
        found: usize,
    },
    /// The two outer fingers look alike.
    #[error(
        "the thumb cannot be told from the little finger: spread it, or say which hand and which view it is"
    )]
    ThumbUnclear,
}

/// A connected part of the top-hat of a hand.
#[derive(Clone, Debug, PartialEq)]
pub struct Residue {
    /// Its pixels, in the picture.
    pub mask: Mask,
    /// Its number of pixels.
    pub area: u32,
    /// The finger it is, if it is shaped like one.
    pub finger: Option<FingerPart>,
}

/// The top-hat of a hand: the hand less its opening by a disc (Serra 1982).
#[derive(Clone, Debug, PartialEq)]
pub struct TopHat {
    /// The connected parts of what the disc does not fit into, the largest first; small ones are left out.
    pub residues: Vec<Residue>,
    /// Greatest distance of what the disc fits into from the centre of the palm's circle, away from the wrist, in
    /// radii of that circle: far above one where fingers lie side by side.
    pub palm_reach: f64,
}

/// The top-hat of a hand by a disc a little wider than a finger (paper, 5.1).
///
/// # Errors
/// The silhouette is empty or has no palm.
pub fn top_hat(silhouette: &Silhouette, tuning: &PartsTuning) -> Result<TopHat, PartsError> {
    let circle = silhouette.palm.ok_or(PartsError::NoHand)?;
    let hand = &silhouette.hand;
    let bounds = hand.bounds().ok_or(PartsError::NoHand)?;
    // A ring of background all round, so that the picture's border acts like an edge of the hand.
    let margin = 2;
    let rect = PixelRect {
        x0: bounds.x0.saturating_sub(margin),
        y0: bounds.y0.saturating_sub(margin),
        x1: bounds.x1 + margin,
        y1: bounds.y1 + margin,
    };
    let crop = hand.cropped(rect);
    let opened = open_disc(&crop, tuning.top_hat_radius * circle.radius);
    let mut rest = crop;
    rest.subtract(&opened);
    let finder = PartFinder { hand, palm: circle, tuning };
    let parts = Components::of(&rest, false);
    let mut residues: Vec<Residue> = Vec::new();
    for (number, part) in parts.list.iter().enumerate() {
        if f64::from(part.area) < tuning.min_residue * circle.radius * circle.radius {
            continue;
        }
        let mut mask = Mask::new(rest.width(), rest.height());
        parts.draw(&mut mask, |i, _| i == number);
        let mask = placed(&mask, rect, hand);
        residues.push(Residue { area: part.area, finger: finder.finger(&mask), mask });
    }
    residues.sort_by_key(|r| std::cmp::Reverse(r.area));
    Ok(TopHat { residues, palm_reach: finder.palm_reach(&placed(&opened, rect, hand), silhouette) })
}

/// Finds the fingers, the palm and the wrist of an open hand (paper, 5.1 and 5.2).
///
/// # Errors
/// The hand is not open: fingers closed, folded, hidden or cut by the picture.
pub fn find_parts(silhouette: &Silhouette, tuning: &PartsTuning) -> Result<HandParts, PartsError> {
    parts_of(silhouette, &top_hat(silhouette, tuning)?, None, tuning)
}

/// As [`find_parts`], from the [`top_hat`] of the silhouette: fingers are the five largest residues shaped like
/// one, ordered round the palm. `thumb` is its side where that is known: it decides where the
/// two outer fingers look alike.
///
/// # Errors
/// As [`find_parts`].
pub fn parts_of(
    silhouette: &Silhouette,
    top_hat: &TopHat,
    thumb: Option<Chirality>,
    tuning: &PartsTuning,
) -> Result<HandParts, PartsError> {
    let circle = silhouette.palm.ok_or(PartsError::NoHand)?;
    let mut palm = silhouette.hand.clone();
    let mut fingers = Vec::new();
    for (residue, finger) in top_hat.residues.iter().filter_map(|r| Some((r, r.finger?))).take(5) {
        fingers.push(finger);
        palm.subtract(&residue.mask);
    }
    let found = fingers.len();
    if found < 5 {
        return Err(if top_hat.palm_reach > tuning.closed_reach {
            PartsError::FingersClosed { found }
        } else if silhouette.clipped {
            PartsError::Clipped { found }
        } else {
            PartsError::FingersMissing { found }
        });
    }
    arrange(&PartFinder { hand: &silhouette.hand, palm: circle, tuning }, fingers, palm, silhouette, thumb)
}

/// Measures the parts of one hand.
struct PartFinder<'a> {
    hand: &'a Mask,
    palm: InscribedCircle,
    tuning: &'a PartsTuning,
}

impl PartFinder<'_> {
    /// The finger whose free part is `part`; `None` if it is not shaped like one.
    fn finger(&self, part: &Mask) -> Option<FingerPart> {
        let InscribedCircle { centre, radius } = self.palm;
        let tuning = &self.tuning.finger;
        let points = centres(part);
        let mut anchor = mean(&points);
        let mut axis = facing(line_direction(&points)?, minus(anchor, centre));
        let mut radius_found = 0.0;
        for _ in 0..tuning.rounds {
            let along = |p: &[f64; 2]| dot(minus(*p, anchor), axis);
            let (low, high) = extent(points.iter().map(along));
            // The middles of the cross-sections follow the finger's axis better than its moments, which its
            // slanting base turns.
            let mut middles = Vec::new();
            let mut widths = Vec::new();
            for k in 0..tuning.sections {
                let share = (k as f64 + 0.5) / tuning.sections as f64;
                let s = low + (high - low) * (tuning.sections_from + tuning.sections_span * share);
                let at = moved(anchor, axis, s);
                if let Some((left, right)) = cross_section(self.hand, at, axis, tuning.reach * radius) {
                    let m = 0.5 * (left + right);
                    if right - left < tuning.max_width * radius && m.abs() < tuning.max_offset * radius {
                        middles.push(moved(at, quarter_turn(axis), m));
                        widths.push(right - left);
                    }
                }
            }
            if middles.len() < tuning.min_sections {
                return None;
            }
            axis = facing(line_direction(&middles)?, axis);
            anchor = mean(&middles);
            widths.sort_by(f64::total_cmp);
            radius_found = 0.5 * widths.get(widths.len() / 2).copied().unwrap_or(0.0);
        }
        let along = |p: &[f64; 2]| dot(minus(*p, anchor), axis);
        let (mut low, mut high) = extent(points.iter().map(along));
        // The base is where the middle of the finger leaves the palm, not the deepest corner of the residue.
        let near_axis = |p: &&[f64; 2]| {
            dot(minus(**p, anchor), quarter_turn(axis)).abs() < tuning.base_offset * radius_found.max(1.0)
        };
        let (inner_low, inner_high) = extent(points.iter().filter(near_axis).map(along));
        if inner_low < inner_high {
            (low, high) = (inner_low, inner_high);
        }
        // Pixels are squares: the outline lies half a pixel beyond the outermost centre.
        let (low, high) = (low - 0.5, high + 0.5);
        let length = high - low;
        let [base, tip] = [low, high].map(|s| moved(anchor, axis, s));
        let from_palm = |p: [f64; 2]| distance(p, centre) / radius;
        let outward =
            from_palm(tip) > tuning.min_tip && from_palm(tip) > from_palm(base) + tuning.min_outward;
        let [thinnest, thickest] = tuning.radii.map(|r| r * radius);
        let slim = length > tuning.min_elongation * 2.0 * radius_found
            && radius_found < thickest
            && radius_found > thinnest;
        (outward && slim && length > tuning.min_length * radius).then_some(FingerPart {
            base,
            tip,
            axis,
            length,
            radius: radius_found,
        })
    }

    /// [`TopHat::palm_reach`].
    fn palm_reach(&self, opened: &Mask, silhouette: &Silhouette) -> f64 {
        let centre = self.palm.centre;
        let mut most: f64 = 0.0;
        for (x, y) in opened.pixels() {
            let d = minus(pixel_centre(x, y), centre);
            // Without a known wrist, forearm would count as fingers: only what lies ahead does.
            let ahead = silhouette.wrist.is_none_or(|w| dot(w.axis, d) > 0.0);
            if ahead {
                most = most.max(d[0].hypot(d[1]));
            }
        }
        most / self.palm.radius
    }
}

fn extent(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
}

/// `crop`, taken at `rect`, back in a mask of the size of `like`.
fn placed(crop: &Mask, rect: PixelRect, like: &Mask) -> Mask {
    let mut out = Mask::new(like.width(), like.height());
    for y in 0..crop.height() {
        for (start, end) in crop.runs(y) {
            out.fill_span(y + rect.y0, (start + rect.x0) as i32, (end + rect.x0) as i32);
        }
    }
    out
}

/// Centroid and inertia axis of a mask.
fn inertia(mask: &Mask) -> Option<InertiaAxis> {
    Some(InertiaAxis { centroid: mask.centroid()?, direction: line_direction(&centres(mask))? })
}

/// The centres of the pixels of a mask.
fn centres(mask: &Mask) -> Vec<[f64; 2]> {
    mask.pixels().map(|(x, y)| pixel_centre(x, y)).collect()
}

/// Puts five fingers in order and measures what follows from it.
fn arrange(
    finder: &PartFinder<'_>,
    found: Vec<FingerPart>,
    palm: Mask,
    silhouette: &Silhouette,
    thumb: Option<Chirality>,
) -> Result<HandParts, PartsError> {
    let InscribedCircle { centre, radius } = finder.palm;
    let tuning = finder.tuning;
    let outward = |f: &FingerPart| minus(f.base, centre);
    // Away from the wrist if it is known, else towards the middle of the fingers: either way the gap in the
    // circle of fingers lies behind.
    let ahead = match &silhouette.wrist {
        Some(wrist) => wrist.axis,
        None => {
            let sum = found.iter().map(outward).fold([0.0; 2], |s, d| moved(s, d, 1.0));
            unit(sum).ok_or(PartsError::NoHand)?
        }
    };
    let angle = |f: &FingerPart| {
        let d = outward(f);
        cross(ahead, d).atan2(dot(ahead, d))
    };
    let mut sorted = found;
    sorted.sort_by(|a, b| angle(a).total_cmp(&angle(b)));
    let mut fingers: [FingerPart; 5] = sorted.try_into().map_err(|_| PartsError::NoHand)?;

    // How far an outer finger stands off; the middle finger is the third from either side.
    let middle = fingers[2].axis;
    let apart = |a: &FingerPart, b: &FingerPart| {
        let gap = distance(a.base, b.base) / radius;
        let turn = cross(a.axis, b.axis).atan2(dot(a.axis, b.axis)).abs();
        let height = dot(outward(a), middle) / radius;
        gap + tuning.thumb.turn_weight * turn - tuning.thumb.height_weight * height
    };
    let (first, last) = (apart(&fingers[0], &fingers[1]), apart(&fingers[4], &fingers[3]));
    let thumb_margin = (first - last).abs();
    // Angles grow clockwise on the screen: seen with the fingers up, the last in that order is on the right.
    let seen = if last > first { Chirality::RightPalmOrLeftBack } else { Chirality::LeftPalmOrRightBack };
    let chirality = match thumb {
        _ if thumb_margin >= tuning.thumb.min_margin => seen,
        Some(known) => known,
        None => return Err(PartsError::ThumbUnclear),
    };
    if chirality == Chirality::RightPalmOrLeftBack {
        fingers.reverse();
    }

    let thumb = fingers[0];
    let mut rest = finder.hand.clone();
    let beside = |x: u32, y: u32| {
        let d = minus(pixel_centre(x, y), thumb.base);
        dot(d, thumb.axis) > 0.0 && cross(d, thumb.axis).abs() < tuning.thumb.half_width * thumb.radius
    };
    rest.subtract(&Mask::from_fn(rest.width(), rest.height(), beside));
    let mut inertia = inertia(&rest).ok_or(PartsError::NoHand)?;
    inertia.direction = facing(inertia.direction, ahead);
    let axis = inertia.direction;
    let four = &fingers[1..];
    let crossings: Vec<[f64; 2]> = four
        .iter()
        .filter_map(|f| crossing([inertia.centroid, axis], [f.base, f.axis], tuning.min_crossing))
        .filter(|p| {
            let behind = dot(minus(centre, *p), axis) / radius;
            (tuning.crossing_range[0]..tuning.crossing_range[1]).contains(&behind)
        })
        .collect();
    let by_axes = if crossings.is_empty() { moved(centre, axis, -radius) } else { mean(&crossings) };
    let wrist = silhouette.wrist.map_or(by_axes, |w| w.centre);
    let palm_length = distance(fingers[2].base, wrist);
    let webs = mean(&[1, 2, 3, 4].map(|i: usize| fingers[i].base));
    let axis = unit(minus(webs, wrist)).unwrap_or(axis);
    let level = [0, 1].map(|i| 0.5 * (webs[i] + centre[i]));
    let palm_width = cross_section(&palm, level, axis, tuning.width_reach * radius)
        .map_or(2.0 * radius, |(left, right)| right - left);
    let shown =
        fingers.iter().zip(tuning.free_lengths).map(|(f, full)| (f.length / (full * radius)).min(1.0));
    let openness = shown.sum::<f64>() / 5.0;
    Ok(HandParts {
        fingers,
        palm,
        palm_circle: finder.palm,
        palm_length,
        palm_width,
        wrist,
        wrist_by_axes: by_axes,
        axis,
        inertia,
        chirality,
        thumb_margin,
        openness,
    })
}
