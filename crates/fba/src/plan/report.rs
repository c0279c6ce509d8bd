//! What a stream costs and how far off it is.

use super::super::writer::PlaneBits;
use crate::bap::BapMask;

/// What an encoded clip costs and how far off it is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlanReport {
    /// Input frames.
    pub frames: u64,
    /// Planes sent.
    pub planes: u64,
    /// I planes among them.
    pub intra_planes: u64,
    /// Length in seconds: frames of the stream, skipped ones included, by its rate.
    pub seconds: f64,
    /// Bytes of the stream.
    pub bytes: usize,
    /// Where the bits went.
    pub bits: PlaneBits,
    /// Bits among them that say nothing and only keep a rate from falling.
    pub filler: u64,
    /// Bits spent on each input frame; 0 where none was sent.
    pub frame_bits: Vec<u64>,
    /// Least and most kilobits per second over any ten seconds after the first two; none in a shorter clip.
    pub window_kbit_per_s: Option<[f64; 2]>,
    /// Windows of ten seconds after the first two, one from each frame on and one from right behind it, that cost over
    /// five percent more than a bit rate asked for, or less; 0 in a clip too short for one. Offline, frames that
    /// rest ([`PlanReport::resting_seconds`]) do not count as too little.
    pub windows_missed: Option<u64>,
    /// Seconds in which the finest quantiser has less to say than the bit rate asked for offline has room for.
    pub resting_seconds: f64,
    /// Quantiser index of each I period.
    pub quants: Vec<u8>,
    /// λ in squared degrees per bit; 0 when plain rounding was asked for.
    pub lambda: f64,
    /// BAPs sent in at least one plane.
    pub sent: BapMask,
    /// Root mean square error in degrees over the angles that are ever different from 0 in the input,
    /// over all input frames that give them and do not only hold them.
    pub rms_degrees: f64,
    /// The same over all angles the input gives.
    pub rms_all_degrees: f64,
    /// Largest error of any angle, degrees.
    pub max_degrees: f64,
    /// Root mean square and largest error in degrees of angles that are left to the decoder's model
    /// ([`PlanOptions::derive`](super::PlanOptions::derive)), which do not count in those above; none where all are sent.
    pub derived_degrees: Option<[f64; 2]>,
}

impl PlanReport {
    /// Kilobits per second.
    pub fn kbit_per_s(&self) -> f64 {
        if self.seconds > 0.0 { self.bytes as f64 * 8.0 / self.seconds / 1000.0 } else { 0.0 }
    }
}
