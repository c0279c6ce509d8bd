//! Left and right: the same motion with the other hand must come out as well.

use serde::Serialize;

use super::compare::{CompareOptions, compare};
use super::round_trip::{FidelityError, RoundTrip, round_trip};
use handcast_codec::mapping::Profile;
use handcast_fba::plan::PlanOptions;
use handcast_hand::{ClipHand, PoseClip, TimedPose};

/// What coding makes of a motion and of its mirror image: first as it is, then mirrored.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Symmetry {
    /// Bytes of the streams.
    pub bytes: [usize; 2],
    /// Root mean square error of the angles that are ever other than 0, degrees.
    pub rms_deg: [f64; 2],
    /// Largest error of an angle, degrees.
    pub max_deg: [f64; 2],
    /// Largest distance of a fingertip, wrist on wrist, millimetres.
    pub fingertip_max_mm: [f64; 2],
    /// Largest difference of a joint angle between what came back and what came back mirrored, degrees.
    pub apart_deg: f64,
}

/// The motion in a mirror: left hands are right hands, angles stay.
pub fn mirrored(clip: &PoseClip) -> PoseClip {
    let mut header = clip.header.clone();
    header.hands = header
        .hands
        .into_iter()
        .map(|h| ClipHand { side: h.side.other(), morphology: h.morphology })
        .collect();
    let frames = clip.frames.iter().map(|f| TimedPose { pose: f.pose.mirrored(), ..f.clone() });
    PoseClip { header, frames: frames.collect() }
}

/// Sends the mirrored motion the same way as `original` went.
///
/// # Errors
/// See [`FidelityError`].
pub fn symmetry(
    clip: &PoseClip,
    profile: Profile,
    plan: &PlanOptions,
    max_gap: f64,
    original: &RoundTrip,
) -> Result<Symmetry, FidelityError> {
    let other = round_trip(&mirrored(clip), profile, plan, max_gap)?;
    let back = mirrored(&other.decoded.clip);
    let options = CompareOptions { placed: profile == Profile::Hand, ..CompareOptions::default() };
    let apart = compare(&original.decoded.clip, &back, &options);
    let of = |trip: &RoundTrip, measure: fn(&super::Seam) -> f64| {
        trip.seams.iter().find(|seam| seam.name == "coding").map_or(0.0, measure)
    };
    let both = |measure: fn(&super::Seam) -> f64| [of(original, measure), of(&other, measure)];
    Ok(Symmetry {
        bytes: [original.encoded.stream.len(), other.encoded.stream.len()],
        rms_deg: both(super::Seam::rms_deg),
        max_deg: both(super::Seam::max_deg),
        fingertip_max_mm: both(super::Seam::fingertip_max_mm),
        apart_deg: apart.max_deg(),
    })
}
