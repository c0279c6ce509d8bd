//! Poses there and back, measured at every seam: BAPs, text, stream, glTF.

use serde::Serialize;
use thiserror::Error;

use super::compare::{CompareOptions, HandDifference, compare};
use super::sampling::sampling;
use handcast_codec::mapping::{Profile, angle_bap};
use handcast_codec::{
    DecodedStream, EncodedClip, PoseDecoderOptions, PosesToStreamError, StreamToPosesError, bap_frames,
    clip_rate, decode_poses_within, encode_bridged, on_ticks, poses_from_frames,
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
    /// A root mean square error of at most this over the joint angles that are ever other than 0, degrees.
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

    /// Root mean square error of the joint angles that are ever other than 0 in what was sent, of the worse hand, degrees.
    pub fn rms_deg(&self) -> f64 {
        self.hands.iter().filter_map(|h| h.moving_rms_deg).fold(0.0, f64::max)
    }

    /// The largest distance of a fingertip, wrist on wrist, millimetres: of hands of the sizes that go into the seam and come
    /// out of it.
    pub fn fingertip_max_mm(&self) -> f64 {
        self.hands
            .iter()
            .filter_map(|h| h.fingertips_mm.as_ref())
            .map(|tips| tips.max.value)
            .fold(0.0, f64::max)
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

/// Sends the poses of `clip` through BAPs, BAP text, a stream, and glTF, and measures at each seam, in the frames in which the
/// clip has the hand: what is held in others is nobody's. BAPs have no sizes, so that both sides of their seams are of the
/// clip's; with look-ahead gaps of up to `max_gap` seconds are bridged. Over all of the way fingertips come out on the sizes that the stream carries, rounded ones.
///
/// # Errors
/// See [`FidelityError`]; a seam that does not keep its promise is no error.
pub fn round_trip(
    clip: &PoseClip,
    profile: Profile,
    plan: &PlanOptions,
    max_gap: f64,
) -> Result<RoundTrip, FidelityError> {
    let rate = clip_rate(clip);
    let (rate, _) = FrameRate::carrying(rate).ok_or(PosesToStreamError::Rate { rate })?;
    let rate = rate.per_second();
    let sampling = sampling(clip, rate);
    let clip = on_ticks(clip, rate, if plan.live { 0.0 } else { max_gap });
    let placed = profile == Profile::Hand;
    let dense = CompareOptions { placed, reference: true, ..CompareOptions::default() };
    let keyed = CompareOptions { keyed: [false, true], ..dense.clone() };

    let frames = bap_frames(&clip, profile)?;
    let (mapped, _) = poses_from_frames(&frames, rate, Some(profile), false);
    let mapped = seen_in(&clip, sized_as(&clip, mapped));
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
        &sized_as(&clip, poses_from_frames(&again.frames, again.rate, Some(profile), false).0),
        &dense,
    )?;

    let encoded = encode_bridged(&clip, profile, plan, max_gap)?;
    let options = DecoderOptions { steps: plan.steps, ranges: plan.ranges, ..DecoderOptions::default() };
    let mut options = PoseDecoderOptions::default().with_decoder(options).with_profile(Some(profile));
    // As long as the clip, whatever is allowed of streams of others.
    (options.instants, options.poses_at_once) = (usize::MAX, usize::MAX);
    let decoded = decode_poses_within(&encoded.stream, options)?;
    let (promise, reason) = coding_promise(&clip, profile, plan);
    let coded = without_held(mapped, &track);
    let coding = Seam::new(
        ["coding", "BAPs → stream → BAPs", reason],
        promise,
        &coded,
        &sized_as(&clip, decoded.clip.clone()),
        &dense,
    )?;

    // No pose is in the surface and its textures, which take a second to make.
    let mut options = ExportOptions::default();
    options.animation_only = true;
    let shown_clip = handcast_gltf::Clip::of(&decoded.clip, &Morphology::default());
    let glb = handcast_gltf::export(&shown_clip, &options)?;
    let shown = clip_from_glb(&glb)?;
    let animation = Seam::new(
        ["glTF", "poses → .glb → poses", "32-bit quaternions, all keys kept"],
        Promise::MaxDeg(GLB_DEG),
        &seen_in(&clip, decoded.clip.clone()),
        &shown,
        &keyed,
    )?;
    let (all, promise) = whole_way(promise, sampling.is_empty());
    let all = Seam::new(all, promise, &clip, &shown, &keyed)?;
    let mut seams = vec![mapping, text, coding, animation, all];
    if !sampling.is_empty() {
        let uneven = [
            "sampling",
            "poses → even ticks → poses",
            "times are uneven: poses are interpolated at the ticks",
        ];
        seams.insert(0, Seam::of(uneven, Promise::Nothing, sampling));
    }
    Ok(RoundTrip { seams, encoded, decoded })
}

/// The words and the promise of all of the way, of which coding promises so much.
fn whole_way(coding: Promise, even: bool) -> ([&'static str; 3], Promise) {
    let promise = match coding {
        Promise::MaxDeg(limit) => Promise::MaxDeg(HALF_UNIT_DEG + limit + GLB_DEG),
        Promise::RmsDeg(limit) => Promise::RmsDeg(HALF_UNIT_DEG + limit + GLB_DEG),
        Promise::Nothing => Promise::Nothing,
    };
    // As `compare` does; between ticks poses of glTF are smoother than what was coded, and nearer.
    let words = match even {
        true => ["all of it", "poses → … → .glb → poses", "the sum of the steps"],
        false => {
            ["all of it", "poses at even ticks → … → .glb → poses", "the sum of the steps after sampling"]
        }
    };
    (words, promise)
}

/// A motion on the sizes of `clip`.
fn sized_as(clip: &PoseClip, mut motion: PoseClip) -> PoseClip {
    for hand in &mut motion.header.hands {
        hand.morphology = clip.header.hand(hand.side).and_then(|told| told.morphology.clone());
    }
    motion
}

/// A motion with the hand lost wherever `clip`, which is on the same ticks, does not have it: what is held there was in no clip.
fn seen_in(clip: &PoseClip, mut motion: PoseClip) -> PoseClip {
    let times = [Side::Left, Side::Right].map(|side| {
        let mut times: Vec<f64> = clip.of(side).filter(|f| f.valid).map(|f| f.time).collect();
        times.sort_by(f64::total_cmp);
        times
    });
    for pose in &mut motion.frames {
        let times = &times[pose.pose.side as usize];
        let at = times.partition_point(|time| *time < pose.time - 1e-6);
        pose.valid &= times.get(at).is_some_and(|time| (time - pose.time).abs() < 1e-6);
    }
    motion
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

/// The promise of the encoder for this aim, and where it comes from. The rate planner counts angles that are ever other than 0
/// over all hands together; of one hand alone they may be more off.
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
        Target::TipError(_) => {
            (Promise::Nothing, "the aim is of fingertips, of which the coding error tells")
        }
        Target::Bitrate(_) => (Promise::Nothing, "the bit rate decides"),
    }
}

/// Half a quantiser step of the coarsest joint angle, and the unit it is rounded to, degrees.
fn half_step(steps: StepTable, quant: u8) -> f64 {
    let step = |angle| step(angle_bap(Side::Right, angle), steps, quant);
    let coarsest = JointAngle::ALL.into_iter().map(step).max().unwrap_or(0);
    (0.5 * f64::from(coarsest) + 1.0) * (1.0 / PER_RADIAN).to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::{HandPose, MAX_GAP, PoseHeader, TimedPose};

    /// Four seconds of a finger that beckons, on sizes that no stream says to the last digit.
    fn beckoning() -> PoseClip {
        let pose = |i: usize| {
            let t = i as f64 / 30.0;
            let pose = HandPose::neutral(Side::Right)
                .with_degrees(JointAngle::Index1Flexion, 30.0 + 30.0 * (3.0 * t).sin())
                .with_degrees(JointAngle::Index2Flexion, 40.0 + 35.0 * (2.1 * t).sin());
            TimedPose::new(t, pose)
        };
        let mut sizes = Morphology::average(0.18312);
        sizes.fingers[1].bones[0] += 0.00023;
        sizes.fingers[3].bones[1] -= 0.00022;
        let header = PoseHeader::one(Side::Right, Some(sizes), Some(30.0));
        PoseClip { header, frames: (0..120).map(pose).collect() }
    }

    fn seam<'a>(trip: &'a RoundTrip, name: &str) -> &'a HandDifference {
        &trip.seams.iter().find(|seam| seam.name == name).unwrap().hands[0]
    }

    #[test]
    fn frames_without_a_hand_count_at_no_seam() {
        let mut clip = beckoning();
        clip.frames[..20].iter_mut().for_each(|frame| frame.valid = false);
        clip.frames[50..].iter_mut().for_each(|frame| frame.valid = false);
        let trip = round_trip(&clip, Profile::Hand, &PlanOptions::default(), MAX_GAP).unwrap();
        for seam in &trip.seams {
            assert_eq!(seam.hands[0].frames, 30, "{}", seam.name);
            assert!(seam.kept, "{seam:?}");
        }
        let [coding, all] = ["coding", "all of it"].map(|name| seam(&trip, name).moving_rms_deg.unwrap());
        assert!((coding - trip.encoded.report.rms_degrees).abs() < 1e-6, "{coding}");
        assert!((coding - all).abs() < 1e-3, "{coding} {all}");
    }

    #[test]
    fn over_all_of_the_way_fingertips_are_on_the_sizes_of_the_stream() {
        let trip = round_trip(&beckoning(), Profile::Hand, &PlanOptions::default(), MAX_GAP).unwrap();
        let tips = |name| seam(&trip, name).fingertips_mm.clone().unwrap().mean;
        assert!(tips("all of it") > tips("coding") + 0.05, "{} {}", tips("all of it"), tips("coding"));
        let lengths = |name| seam(&trip, name).lengths_mm.unwrap();
        let [own, shown] = lengths("all of it");
        assert!((own - shown).abs() > 0.005, "{own} {shown}");
        assert_eq!(lengths("coding"), [own; 2]);
        assert!(lengths("glTF").iter().all(|length| (length - shown).abs() < 1e-3));
    }

    /// Between ticks poses are interpolated, which smooths what coding does: all of the way is measured at the ticks.
    #[test]
    fn all_of_the_way_is_no_shorter_than_one_of_its_steps() {
        let mut clip = beckoning();
        for (i, frame) in clip.frames.iter_mut().enumerate() {
            frame.time += 0.4 / 30.0 * (2.3 * i as f64).sin();
        }
        let trip = round_trip(&clip, Profile::Hand, &PlanOptions::default(), MAX_GAP).unwrap();
        assert_eq!(trip.seams[0].name, "sampling");
        let [coding, all] = ["coding", "all of it"].map(|name| seam(&trip, name).moving_rms_deg.unwrap());
        assert!((coding - all).abs() < 1e-3, "{coding} {all}");
    }
}
