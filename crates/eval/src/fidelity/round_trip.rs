//! Poses there and back, measured at every seam: BAPs, text, stream, glTF.

use serde::Serialize;
use thiserror::Error;

use super::compare::{CompareOptions, HandDifference, compare};
use super::sampling::sampling;
use handcast_codec::mapping::{Profile, angle_bap};
use handcast_codec::{
    DecodedStream, EncodedClip, PoseDecoderOptions, PosesToStreamError, StreamToPosesError, bap_frames,
    clip_rate, decode_poses_within, encode_poses, on_ticks, poses_from_frames,
};
use handcast_fba::bap::text::TextError;
use handcast_fba::bap::{PER_RADIAN, StepTable};
use handcast_fba::plan::{PlanOptions, Target};
use handcast_fba::state::step;
use handcast_fba::{DecoderOptions, FrameRate};
use handcast_formats::motion::{BapTrack, clip_from_glb};
use handcast_gltf::{ExportOptions, GltfError};
use handcast_hand::{JointAngle, Morphology, PoseClip, Side};
use handcast_track::pipeline::ClipError;

/// Why a round trip could not be measured.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum FidelityError {
    /// The clip could not be tracked.
    #[error(transparent)]
    Clip(#[from] ClipError),
    /// The poses could not be encoded.
    #[error(transparent)]
    Encode(#[from] PosesToStreamError),
    /// The stream could not be decoded.
    #[error(transparent)]
    Decode(#[from] StreamToPosesError),
    /// The BAP text could not be read again.
    #[error(transparent)]
    Text(#[from] TextError),
    /// The glTF file could not be written or read again.
    #[error(transparent)]
    Gltf(#[from] GltfError),
    /// Poses got lost on the way.
    #[error("fidelity: {seam}: {found} of {sent} poses came back")]
    Lost {
        /// Which seam.
        seam: &'static str,
        /// Poses sent.
        sent: usize,
        /// Poses that came back.
        found: usize,
    },
}

/// What a seam promises.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Promise {
    /// No joint angle further off than this, degrees.
    MaxDeg(f64),
    /// A root mean square error of the moving joint angles of at most this, degrees.
    RmsDeg(f64),
    /// As far off as the bit rate asks for.
    Nothing,
}

/// One step of the way, and how far off what comes out of it is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Seam {
    /// In one word or two.
    pub name: &'static str,
    /// What goes through what.
    pub way: &'static str,
    /// What it promises.
    pub promise: Promise,
    /// Where the promise comes from.
    pub reason: &'static str,
    /// Whether it is kept.
    pub kept: bool,
    /// What was measured, hand by hand.
    pub hands: Vec<HandDifference>,
}

impl Seam {
    /// The largest error of a joint angle, degrees.
    pub fn max_deg(&self) -> f64 {
        self.hands.iter().filter_map(HandDifference::worst).map(|j| j.max.value).fold(0.0, f64::max)
    }

    /// Root mean square error of the joint angles that move, of the worse hand, degrees.
    pub fn rms_deg(&self) -> f64 {
        self.hands.iter().map(|h| h.moving_rms_deg).fold(0.0, f64::max)
    }

    /// The largest distance of a fingertip, millimetres.
    pub fn fingertip_max_mm(&self) -> f64 {
        self.hands.iter().map(|h| h.fingertips_mm.max.value).fold(0.0, f64::max)
    }

    /// Measures what came back; every pose must.
    fn new(
        names: [&'static str; 3],
        promise: Promise,
        sent: &PoseClip,
        found: &PoseClip,
        options: &CompareOptions,
    ) -> Result<Self, FidelityError> {
        let seam = Self::of(names, promise, compare(sent, found, options).hands);
        let compared: usize = seam.hands.iter().map(|h| h.frames).sum();
        let valid = sent.frames.iter().filter(|f| f.valid).count();
        if compared < valid {
            return Err(FidelityError::Lost { seam: seam.name, sent: valid, found: compared });
        }
        Ok(seam)
    }

    fn of([name, way, reason]: [&'static str; 3], promise: Promise, hands: Vec<HandDifference>) -> Self {
        let mut seam = Self { name, way, promise, reason, kept: true, hands };
        seam.kept = match promise {
            Promise::MaxDeg(limit) => seam.max_deg() <= limit,
            Promise::RmsDeg(limit) => seam.rms_deg() <= limit,
            Promise::Nothing => true,
        };
        seam
    }
}

/// Half a unit of a BAP that is an angle (1e-5 rad), degrees, and a share for the rounding of the measurement itself.
pub const HALF_UNIT_DEG: f64 = 0.5e-5 * 180.0 / std::f64::consts::PI * (1.0 + 1e-6);
/// Largest error of a joint angle through a GLB with all its keys, degrees. Rotations are 32-bit quaternions and off by
/// up to 2e-7 rad. The three angles of a knuckle are off by more the nearer it is to a bend of 90 degrees, where two
/// of its axes meet: by a thousand times that at most, since the import counts what is nearer as one axis.
pub const GLB_DEG: f64 = 0.012;

/// A clip after every step of the way.
#[derive(Clone, Debug)]
pub struct RoundTrip {
    /// The seams in the order of the way; the last is the whole of it.
    pub seams: Vec<Seam>,
    /// What was encoded, and what it cost.
    pub encoded: EncodedClip,
    /// What came out of the stream.
    pub decoded: DecodedStream,
}

/// Sends the poses of `clip` through BAPs, BAP text, a stream, and glTF, and measures at each seam.
///
/// # Errors
/// See [`FidelityError`]; a seam that does not keep its promise is no error.
pub fn round_trip(clip: &PoseClip, profile: Profile, plan: &PlanOptions) -> Result<RoundTrip, FidelityError> {
    let rate = clip_rate(clip);
    let rate = FrameRate::nearest(rate).ok_or(PosesToStreamError::Rate { rate })?.per_second();
    let (sent, clip) = (clip, on_ticks(clip, rate));
    let sampling = sampling(sent, rate);
    let placed = profile == Profile::Hand;
    let dense = CompareOptions { placed, ..CompareOptions::default() };
    let keyed = CompareOptions { keyed: [false, true], placed, ..CompareOptions::default() };

    let frames = bap_frames(&clip, profile)?;
    let (mapped, _) = poses_from_frames(&frames, rate, Some(profile), false);
    let mapping = Seam::new(
        ["mapping", "poses → BAPs → poses", "BAPs count in 1e-5 rad: half a unit is lost"],
        Promise::MaxDeg(HALF_UNIT_DEG),
        &clip,
        &mapped,
        &dense,
    )?;

    let track = BapTrack { rate, frames: frames.into_iter().collect() };
    let again = BapTrack::from_text(&track.to_text("fidelity"))?;
    let text = Seam::new(
        ["BAP text", "BAPs → .bap → BAPs", "integers, written in full"],
        Promise::MaxDeg(0.0),
        &mapped,
        &poses_from_frames(&again.frames, again.rate, Some(profile), false).0,
        &dense,
    )?;

    let encoded = encode_poses(&clip, profile, plan)?;
    let options = DecoderOptions { steps: plan.steps, ranges: plan.ranges, ..DecoderOptions::default() };
    let mut options = PoseDecoderOptions::default().with_decoder(options).with_profile(Some(profile));
    // As long as the clip, whatever is allowed of streams of others.
    (options.instants, options.poses_at_once) = (usize::MAX, usize::MAX);
    let mut decoded = decode_poses_within(&encoded.stream, options)?;
    for hand in &mut decoded.clip.header.hands {
        hand.morphology = clip.header.hand(hand.side).and_then(|h| h.morphology.clone());
    }
    let (promise, reason) = coding_promise(&clip, profile, plan);
    let coded = without_held(mapped.clone(), &track);
    let coding =
        Seam::new(["coding", "BAPs → stream → BAPs", reason], promise, &coded, &decoded.clip, &dense)?;

    // No pose is in the surface and its textures, which take a second to make.
    let mut options = ExportOptions::default();
    options.animation_only = true;
    let shown_clip = handcast_gltf::Clip::of(&decoded.clip, &Morphology::default());
    let glb = handcast_gltf::export(&shown_clip, &options)?;
    let shown = clip_from_glb(&glb)?;
    let animation = Seam::new(
        ["glTF", "poses → .glb → poses", "32-bit quaternions, all keys kept"],
        Promise::MaxDeg(GLB_DEG),
        &decoded.clip,
        &shown,
        &keyed,
    )?;
    let all = ["all of it", "poses → … → .glb → poses", "the sum of the steps"];
    let mut seams = vec![mapping, text, coding, animation];
    if sampling.is_empty() {
        let promise = match promise {
            Promise::MaxDeg(limit) => Promise::MaxDeg(HALF_UNIT_DEG + limit + GLB_DEG),
            // The encoder counts held poses of lost hands, too, which are not compared here.
            Promise::RmsDeg(limit) if clip.frames.iter().all(|pose| pose.valid) => {
                Promise::RmsDeg(HALF_UNIT_DEG + limit + GLB_DEG)
            }
            _ => Promise::Nothing,
        };
        seams.push(Seam::new(all, promise, &clip, &shown, &keyed)?);
    } else {
        let uneven = [
            "sampling",
            "poses → even ticks → poses",
            "times are uneven: poses are interpolated at the ticks",
        ];
        seams.insert(0, Seam::of(uneven, Promise::Nothing, sampling));
        // At instants that are not those of the ticks, the last ones have nothing to be compared with.
        seams.push(Seam::of(all, Promise::Nothing, compare(sent, &shown, &keyed).hands));
    }
    Ok(RoundTrip { seams, encoded, decoded })
}

/// The poses of a clip that frames stand for: what is held where frames were dropped counts for nothing in the encoder's
/// account.
fn without_held(mut clip: PoseClip, track: &BapTrack) -> PoseClip {
    let times = track.frames.times();
    clip.frames.retain(|pose| {
        let at = times.partition_point(|time| *time < pose.time - 0.5 / track.rate);
        times.get(at).is_some_and(|time| (time - pose.time).abs() < 1e-6)
    });
    clip
}

/// The promise of the encoder for this aim, and where it comes from. The rate planner counts moving angles over all
/// hands together; of one hand alone they may be more off.
fn coding_promise(clip: &PoseClip, profile: Profile, plan: &PlanOptions) -> (Promise, &'static str) {
    match plan.mode {
        _ if plan.derive => (Promise::Nothing, "end joints are left to the hand model"),
        _ if plan.live && !matches!(plan.mode, Target::Quant(_)) => {
            (Promise::Nothing, "coded frame by frame, the aim is met on average")
        }
        Target::Rms(_) if profile == Profile::Arm => {
            (Promise::Nothing, "the aim counts the wrist's angles, too")
        }
        Target::Rms(_) if clip.header.hands.len() > 1 => {
            (Promise::Nothing, "the aim is met by both hands together")
        }
        Target::Rms(degrees) => (Promise::RmsDeg(degrees), "the error the encoder was asked for"),
        Target::MaxError(degrees) => {
            (Promise::MaxDeg(degrees), "the largest error the encoder was asked for")
        }
        Target::Quant(quant) => (
            Promise::MaxDeg(half_step(plan.steps, quant)),
            "plain rounding: half a step of the coarsest joint at this quantiser index",
        ),
        _ => (Promise::Nothing, "the bit rate decides"),
    }
}

/// Half a quantiser step of the coarsest joint angle, and the unit it is rounded to, degrees.
fn half_step(steps: StepTable, quant: u8) -> f64 {
    let step = |angle| step(angle_bap(Side::Right, angle), steps, quant);
    let coarsest = JointAngle::ALL.into_iter().map(step).max().unwrap_or(0);
    (0.5 * f64::from(coarsest) + 1.0) * (1.0 / PER_RADIAN).to_degrees()
}
