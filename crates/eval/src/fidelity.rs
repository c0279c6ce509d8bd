//! Error measures: of two motions ([`compare()`]), of the round trip at each of its seams ([`measure`]), of a tracker
//! against known poses ([`TrackingMeter`]), another tracker's joints ([`ReferenceMeter`]) and known numbers of
//! fingers ([`CountLabels`]) and letters ([`LetterLabels`]); and the report with its page ([`FidelityReport`], [`page()`]).

mod baps;
mod clip;
mod compare;
mod counts;
mod latency;
mod letters;
mod loss;
mod page;
mod pictures;
mod plot;
mod reference;
mod report;
mod round_trip;
mod sampling;
mod stream;
mod summary;
mod symmetry;
mod tracking;

pub use baps::{BapComparison, BapDifference, BapDivergence, compare_baps};
pub use clip::{MeasuredClip, MirroredTracking, Moment, TrackingSeam, measure_clip, measure_mirrored};
pub use compare::{
    CompareOptions, Comparison, DEFAULT_TOLERANCE, Divergence, Extent, HandDifference, JointDifference,
    NOUGHT_DEG, compare,
};
pub use counts::{CountAgreement, CountLabels, CountRange, CountReport, LabelError, RangeCounts, Said};
pub use latency::{StageLatency, of_link, of_tracking};
pub use letters::{LetterCounts, LetterLabels, LetterRange, LetterReport, Letters};
pub use loss::{LossError, LossOptions, LossReport, Recovery, WRONG_DEG, WRONG_MM, loss};
pub use page::page;
pub use pictures::{Gallery, Group, Picture, gallery};
pub use plot::{Plot, Series, Shape};
pub use reference::{ReferenceMeter, ReferenceReport, TipDistance, length_in_pictures, standing_out};
pub use report::{FidelityOptions, FidelityReport, ImportSeam, measure};
pub use round_trip::{FidelityError, GLB_DEG, HALF_UNIT_DEG, Promise, RoundTrip, Seam, round_trip};
pub use sampling::sampling;
pub use stream::{AIMS, Bits, QUANTS, RateCurve, RatePoint, StreamAccount, account, rate_curve};
pub use summary::{Spread, Worst};
pub use symmetry::{Symmetry, mirrored, symmetry};
pub use tracking::{DofError, Observation, TrackingMeter, TrackingReport};

use handcast_hand::{JointAngle, PoseClip, Side, TimedPose};

/// How far joint angles are from those of a reference: poses that were encoded, or true ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct AngleError {
    /// Joint angles of a hand that are measured: those that are ever other than 0 in the reference ([`ever_other_than_0`]); of
    /// two hands the most.
    pub angles: usize,
    /// Mean magnitude over these and all frames, degrees.
    pub mean_deg: f64,
    /// Root mean square over the same, degrees.
    pub rms_deg: f64,
    /// Largest error of any of them, degrees.
    pub max_deg: f64,
    /// Frames compared.
    pub frames: usize,
}

/// Compares the joint angles of `found` with those of `reference`, hand by hand, at the times of the
/// reference: each valid pose of the reference is compared with the pose of `found` at the same time
/// (within half an interval of `rate` frames per second; what is missing is not compared).
pub fn angle_error(reference: &PoseClip, found: &PoseClip, rate: f64) -> AngleError {
    let mut error = AngleError::default();
    let (mut sum, mut magnitudes, mut count) = (0.0, 0.0, 0usize);
    let start = |clip: &PoseClip| clip.frames.iter().map(|f| f.time).fold(f64::INFINITY, f64::min);
    let (start_a, start_b) = (start(reference), start(found));
    for hand in &reference.header.hands {
        let truth: Vec<&TimedPose> = reference.of(hand.side).collect();
        let other: Vec<&TimedPose> = found.of(hand.side).collect();
        let measured = ever_other_than_0(reference, hand.side);
        error.angles = error.angles.max(measured.len());
        let mut at = 0;
        for a in truth.iter().filter(|f| f.valid) {
            let time = a.time - start_a + start_b;
            while at + 1 < other.len() && (other[at + 1].time - time).abs() <= (other[at].time - time).abs() {
                at += 1;
            }
            let Some(b) = other.get(at).filter(|b| (b.time - time).abs() <= 0.5 / rate + 1e-6) else {
                continue;
            };
            error.frames += 1;
            for &angle in &measured {
                let d = (a.pose.angle(angle) - b.pose.angle(angle)).to_degrees();
                sum += d * d;
                magnitudes += d.abs();
                count += 1;
                error.max_deg = error.max_deg.max(d.abs());
            }
        }
    }
    error.rms_deg = (sum / count.max(1) as f64).sqrt();
    error.mean_deg = magnitudes / count.max(1) as f64;
    error
}

/// The joint angles of one hand that are ever other than 0 in a motion, whether they move or stand still: in the order of
/// [`JointAngle::ALL`].
pub fn ever_other_than_0(clip: &PoseClip, side: Side) -> Vec<JointAngle> {
    let is = |angle: &JointAngle| clip.of(side).any(|f| f.valid && f.pose.angle(*angle) != 0.0);
    JointAngle::ALL.into_iter().filter(is).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::{HandPose, PoseHeader};

    fn clip(degrees: &[f64]) -> PoseClip {
        let frames = degrees.iter().enumerate().map(|(i, &d)| {
            let pose = HandPose::neutral(Side::Right).with_degrees(JointAngle::Index2Flexion, d);
            TimedPose::new(i as f64 / 30.0, pose)
        });
        PoseClip { header: PoseHeader::one(Side::Right, None, Some(30.0)), frames: frames.collect() }
    }

    #[test]
    fn errors_are_those_of_the_angles_that_are_ever_other_than_0() {
        let error = angle_error(&clip(&[10.0, 20.0, 30.0, 40.0]), &clip(&[10.0, 22.0, 30.0, 40.0]), 30.0);
        assert!((error.max_deg - 2.0).abs() < 1e-9);
        assert!((error.rms_deg - 1.0).abs() < 1e-9);
        assert_eq!((error.frames, error.angles), (4, 1));
    }

    #[test]
    fn frames_that_are_missing_are_not_compared() {
        let mut found = clip(&[10.0, 20.0, 30.0, 40.0]);
        found.frames.truncate(2);
        assert_eq!(angle_error(&clip(&[10.0, 20.0, 30.0, 40.0]), &found, 30.0).frames, 2);
    }
}
