//! What a stream costs: bits of each frame and of each part of the hand, and the rate over the error.

use serde::Serialize;

use super::round_trip::FidelityError;
use handcast_codec::mapping::{Profile, anchor_baps, bap_angle, global_baps, old_global_baps, wrist_baps};
use handcast_codec::{EncodedClip, StreamToPosesError, TipError, encode_bridged};
use handcast_fba::DecoderOptions;
use handcast_fba::bap::Bap;
use handcast_fba::inspect::Inspector;
use handcast_fba::plan::{PlanOptions, Target};
use handcast_hand::{Finger, JointAngle, PoseClip, Side};

/// Bits of one use or of one part of the hand.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Bits {
    /// What for.
    pub name: String,
    /// How many.
    pub bits: u64,
    /// Share of the whole stream, 0 to 1.
    pub share: f64,
}

/// How far fingertips are off as a viewer sees them, with the wrist's way and on the sizes that the stream carries, over all
/// fingers and frames.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Tips {
    /// Millimetres on average.
    pub mean_mm: f64,
    /// Millimetres that 99 of 100 stay below.
    pub p99_mm: f64,
    /// Millimetres at most.
    pub max_mm: f64,
    /// Millimetres at most that the rounded sizes alone account for.
    pub sizes_mm: f64,
}

impl From<TipError> for Tips {
    fn from(tips: TipError) -> Self {
        // The edge of a bin 1 % wide.
        let p99_mm = (100.0 * tips.p99_mm).round() / 100.0;
        Self { mean_mm: tips.mean_mm, p99_mm, max_mm: tips.max_mm, sizes_mm: tips.sizes_mm }
    }
}

/// What a stream costs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StreamAccount {
    /// Bytes.
    pub bytes: usize,
    /// Kilobits per second.
    pub kbit_per_s: f64,
    /// Seconds.
    pub seconds: f64,
    /// Frames coded.
    pub frames: u64,
    /// Planes sent; the others are skipped.
    pub planes: u64,
    /// I planes among them, at each of which a decoder can start.
    pub intra_planes: u64,
    /// Quantiser index of each I period.
    pub quantiser_indices: Vec<u8>,
    /// Bits of each frame, in order of time; 0 where none was sent.
    pub frame_bits: Vec<u64>,
    /// How far fingertips are off.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tips: Option<Tips>,
    /// By use; the uses add up to the stream.
    pub by_use: Vec<Bits>,
    /// By part of the hand, for the values alone; with what remains these add up to the stream as well.
    pub by_group: Vec<Bits>,
}

/// Takes a stream apart.
///
/// # Errors
/// [`FidelityError::Decode`] where the stream is damaged.
pub fn account(encoded: &EncodedClip, plan: &PlanOptions) -> Result<StreamAccount, FidelityError> {
    let report = &encoded.report;
    let total = 8 * encoded.stream.len() as u64;
    let entry = |name: &str, bits: u64| Bits {
        name: name.to_owned(),
        bits,
        share: bits as f64 / total.max(1) as f64,
    };
    let b = &report.bits;
    let padding = total.saturating_sub(b.total());
    let by_use = [
        ("I values", b.intra_values),
        ("P values", b.predicted_values),
        ("headers", b.headers),
        ("masks", b.masks),
        ("ranges", b.ranges),
        ("flush", b.flush),
        ("start codes, end and stuffing", b.start_codes + padding),
    ];
    let mut groups: Vec<(String, u64)> = Vec::new();
    let options = DecoderOptions { steps: plan.steps, ranges: plan.ranges, ..DecoderOptions::default() };
    for plane in Inspector::new(&encoded.stream, options) {
        for element in plane.map_err(StreamToPosesError::from)?.elements {
            if !matches!(element.name, "bap_i_value" | "bap_p_value") {
                continue;
            }
            let Some(bap) = element.subject.and_then(Bap::new) else { continue };
            let name = group_of(bap, encoded.clip.header.hands.len() > 1);
            match groups.iter_mut().find(|(known, _)| *known == name) {
                Some((_, bits)) => *bits += u64::from(element.width),
                None => groups.push((name, element.width.into())),
            }
        }
    }
    let values: u64 = groups.iter().map(|(_, bits)| bits).sum();
    groups.sort_by_key(|(_, bits)| std::cmp::Reverse(*bits));
    groups.push(("everything but values".into(), total.saturating_sub(values)));
    Ok(StreamAccount {
        bytes: encoded.stream.len(),
        kbit_per_s: report.kbit_per_s(),
        seconds: report.seconds,
        frames: report.frames,
        planes: report.planes,
        intra_planes: report.intra_planes,
        quantiser_indices: report.quants.clone(),
        frame_bits: report.frame_bits.clone(),
        tips: encoded.tips.map(Tips::from),
        by_use: by_use.into_iter().filter(|(_, bits)| *bits > 0).map(|(n, b)| entry(n, b)).collect(),
        by_group: groups.iter().map(|(name, bits)| entry(name, *bits)).collect(),
    })
}

/// The part of the hand that a BAP moves.
fn group_of(bap: Bap, two_hands: bool) -> String {
    let part = |angle: JointAngle| Finger::ALL.into_iter().find(|f| angle.name().starts_with(f.name()));
    let (side, name) = match bap_angle(bap) {
        Some((side, angle)) => (Some(side), part(angle).map_or("hand", Finger::name)),
        None => {
            let place = [Side::Left, Side::Right].into_iter().find_map(|side| {
                let at = [global_baps(side), old_global_baps(side)];
                let at = at.iter().find_map(|baps| baps.iter().position(|&b| b == bap));
                let name = at.map(|at| if at < 3 { "wrist position" } else { "wrist rotation" });
                let [place @ .., turn] = anchor_baps(side);
                let name = name.or(place.contains(&bap).then_some("wrist position"));
                let name = name.or((turn == bap).then_some("wrist rotation"));
                let arm = wrist_baps(side).contains(&bap).then_some("wrist rotation");
                name.or(arm).map(|name| (Some(side), name))
            });
            place.unwrap_or((None, "other"))
        }
    };
    match side.filter(|_| two_hands) {
        Some(side) => format!("{} {name}", side.name()),
        None => name.to_owned(),
    }
}

/// One way to code the clip.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RatePoint {
    /// Quantiser index, of plain rounding.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quant: Option<u8>,
    /// Error aimed at, degrees RMS, of planned coding.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub aim_deg: Option<f64>,
    /// Bytes of the stream.
    pub bytes: usize,
    /// Kilobits per second.
    pub kbit_per_s: f64,
    /// Root mean square error of the angles that are ever other than 0, degrees.
    pub rms_deg: f64,
    /// Largest error of an angle, degrees.
    pub max_deg: f64,
}

/// Rate over error.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RateCurve {
    /// Plain rounding at the quantiser indices [`QUANTS`].
    pub quantisers: Vec<RatePoint>,
    /// Planned with look-ahead for the errors [`AIMS`].
    pub planned: Vec<RatePoint>,
    /// The same frame by frame.
    pub live: Vec<RatePoint>,
}

/// Quantiser indices on the curve.
pub const QUANTS: [u8; 10] = [1, 2, 4, 6, 8, 10, 13, 17, 23, 31];
/// Errors aimed at on the curve, degrees RMS.
pub const AIMS: [f64; 6] = [0.2, 0.3, 0.45, 0.65, 1.0, 1.5];

/// Codes a clip at every quantiser index of [`QUANTS`], and for every error of [`AIMS`] with and without look-ahead;
/// with it gaps of up to `max_gap` seconds are bridged.
///
/// # Errors
/// [`FidelityError::Encode`].
pub fn rate_curve(
    clip: &PoseClip,
    profile: Profile,
    plan: &PlanOptions,
    max_gap: f64,
) -> Result<RateCurve, FidelityError> {
    let point = |mode: Target, live: bool| -> Result<RatePoint, FidelityError> {
        let report = encode_bridged(clip, profile, &PlanOptions { mode, live, ..*plan }, max_gap)?.report;
        Ok(RatePoint {
            quant: if let Target::Quant(quant) = mode { Some(quant) } else { None },
            aim_deg: if let Target::Rms(aim) = mode { Some(aim) } else { None },
            bytes: report.bytes,
            kbit_per_s: report.kbit_per_s(),
            rms_deg: report.rms_degrees,
            max_deg: report.max_degrees,
        })
    };
    let aims = |live| -> Result<Vec<RatePoint>, FidelityError> {
        AIMS.into_iter().map(|aim| point(Target::Rms(aim), live)).collect()
    };
    Ok(RateCurve {
        quantisers: QUANTS.into_iter().map(|q| point(Target::Quant(q), false)).collect::<Result<_, _>>()?,
        planned: aims(false)?,
        live: aims(true)?,
    })
}
