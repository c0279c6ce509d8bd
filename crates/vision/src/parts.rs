//! Fingers, palm and wrist of an open hand, from its silhouette.

use thiserror::Error;

mod arrange;
mod finger;
mod options;

use arrange::arrange;
pub use options::{FingerTuning, PartsTuning, ThumbTuning};

use super::geometry::{dot, minus, pixel_centre};
use super::mask::{Mask, PixelRect};
use super::morphology::{Components, open_disc};
use super::segment::Silhouette;
use super::wrist::InscribedCircle;

/// One finger of the open hand's silhouette. Points and lengths in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FingerPart {
    /// Middle of the finger where it leaves the palm (the web, not the knuckle).
    pub base: [f64; 2],
    /// End of the finger on its axis.
    pub tip: [f64; 2],
    /// Unit vector from base to tip: the line through the middles of its cross-sections.
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
    /// How much farther than the little finger the thumb stands off ([`ThumbTuning`]), palm radii.
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
    let parts = Components::of(&rest, false);
    let mut residues: Vec<Residue> = Vec::new();
    for (number, part) in parts.list.iter().enumerate() {
        if f64::from(part.area) < tuning.min_residue * circle.radius * circle.radius {
            continue;
        }
        let mut mask = Mask::new(rest.width(), rest.height());
        parts.draw(&mut mask, |i, _| i == number);
        let mask = mask.placed(rect, hand.size());
        let finger = finger::measure(hand, &circle, &mask, &tuning.finger);
        residues.push(Residue { area: part.area, finger, mask });
    }
    residues.sort_by_key(|r| std::cmp::Reverse(r.area));
    Ok(TopHat { residues, palm_reach: palm_reach(&opened.placed(rect, hand.size()), &circle, silhouette) })
}

/// Finds the fingers, the palm and the wrist of an open hand (paper, 5.1 and 5.2). `thumb` is the thumb's side where that is
/// known: it decides where the two outer fingers look alike.
///
/// # Errors
/// The hand is not open: fingers closed, folded, hidden or cut by the picture.
pub fn find_parts(
    silhouette: &Silhouette,
    thumb: Option<Chirality>,
    tuning: &PartsTuning,
) -> Result<HandParts, PartsError> {
    parts_of(silhouette, &top_hat(silhouette, tuning)?, thumb, tuning)
}

/// As [`find_parts`], from the [`top_hat`] of the silhouette: fingers are the five largest residues shaped like
/// one, ordered round the palm.
///
/// # Errors
/// As [`find_parts`].
pub fn parts_of(
    silhouette: &Silhouette,
    top_hat: &TopHat,
    thumb: Option<Chirality>,
    tuning: &PartsTuning,
) -> Result<HandParts, PartsError> {
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
    let fingers: [FingerPart; 5] = fingers.try_into().map_err(|_| PartsError::NoHand)?;
    arrange(silhouette, fingers, palm, thumb, tuning)
}

/// [`TopHat::palm_reach`].
fn palm_reach(opened: &Mask, palm: &InscribedCircle, silhouette: &Silhouette) -> f64 {
    let mut most: f64 = 0.0;
    for (x, y) in opened.pixels() {
        let d = minus(pixel_centre(x, y), palm.centre);
        // What lies towards the wrist is heel of the hand or forearm.
        if silhouette.wrist.is_none_or(|w| dot(w.axis, d) > 0.0) {
            most = most.max(d[0].hypot(d[1]));
        }
    }
    most / palm.radius
}

/// The centres of the pixels of a mask.
fn centres(mask: &Mask) -> Vec<[f64; 2]> {
    mask.pixels().map(|(x, y)| pixel_centre(x, y)).collect()
}
