//! How far fingertips are off.

use handcast_fba::Record;
use handcast_fba::bap::{BapFrame, BapMask};
use handcast_hand::{ClipHand, HandPose, Side, Skeleton};
use nalgebra::{UnitQuaternion, Vector3};

use crate::mapping::{Profile, pose_from_frame, pose_of_given};
use crate::person::hands_of_record;

/// How far the fingertips of decoded hands are from those of the poses that were encoded, over all fingers and all
/// frames with a valid pose, as a viewer sees them: poses on the person's sizes, decoded ones on those that the stream
/// carries, which are rounded. Where a stream carries none both are taken on the person's, and where these are not known on
/// those of the mean hand.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct TipError {
    /// Millimetres on average.
    pub mean_mm: f64,
    /// Millimetres that 99 of 100 stay below, to 1 %.
    pub p99_mm: f64,
    /// Millimetres at most.
    pub max_mm: f64,
    /// Millimetres at most that the rounded sizes alone account for, in the frames compared; 0 where a stream carries none.
    pub sizes_mm: f64,
    /// Whether the way of the wrist is in them: where it is sent. Its turn always is.
    pub placed: bool,
}

/// Distances counted by size, in constant memory.
#[derive(Clone, Debug)]
struct Tally {
    count: u64,
    /// Metres.
    sum: f64,
    max: f32,
    /// Distances by the leading bits of their `f32`, from [`Self::LEAST`] on.
    bins: Vec<u64>,
}

impl std::ops::AddAssign<&Tally> for Tally {
    fn add_assign(&mut self, other: &Self) {
        self.count += other.count;
        self.sum += other.sum;
        self.max = self.max.max(other.max);
        self.bins.iter_mut().zip(&other.bins).for_each(|(sum, more)| *sum += more);
    }
}

impl Tally {
    /// Bits of an `f32` that a bin leaves open: bins are 1/128 of a power of two wide.
    const OPEN: u32 = 16;
    /// Metres from which on, and below which, bins tell sizes apart: 2⁻²⁰ and 2⁴.
    const LEAST: f32 = 1.0 / (1 << 20) as f32;
    const MOST: f32 = 16.0;

    fn new() -> Self {
        Self { count: 0, sum: 0.0, max: 0.0, bins: vec![0; Self::bin(Self::MOST) + 1] }
    }

    fn bin(metres: f32) -> usize {
        let place = |metres: f32| (metres.to_bits() >> Self::OPEN) as usize;
        place(metres.clamp(Self::LEAST, Self::MOST)) - place(Self::LEAST)
    }

    fn add(&mut self, metres: f32) {
        self.count += 1;
        self.sum += f64::from(metres);
        self.max = self.max.max(metres);
        self.bins[Self::bin(metres)] += 1;
    }

    /// The upper edge of the bin of the distance that this many are not above, metres.
    fn upper(&self, rank: u64) -> f32 {
        let mut below = 0;
        let found = self.bins.iter().position(|bin| {
            below += bin;
            below > rank
        });
        let first = Self::LEAST.to_bits() >> Self::OPEN;
        let edge = |bin: usize| f32::from_bits((first + bin as u32 + 1) << Self::OPEN);
        found.map_or(self.max, edge).min(self.max)
    }

    fn error(&self) -> Option<TipError> {
        let rank = (self.count * 99).div_ceil(100).checked_sub(1)?;
        let [p99, max] = [self.upper(rank), self.max].map(|metres| 1e3 * f64::from(metres));
        Some(TipError {
            mean_mm: 1e3 * self.sum / self.count as f64,
            p99_mm: p99,
            max_mm: max,
            sizes_mm: 0.0,
            placed: false,
        })
    }
}

/// Fingertips, metres in the camera's frame.
type Tips = [[f32; 3]; 5];

/// Those of hands of one side in the same pose.
fn tips<const N: usize>(hands: [&Skeleton; N], pose: &HandPose) -> [Tips; N] {
    Skeleton::tips(hands, pose).map(|tips| tips.map(|tip| tip.coords.map(|v| v as f32).into()))
}

/// What rounding to the units of a stream takes from where the left hand is, and the right one: moves in steps of [`MOVE`], turns
/// in steps of [`TURN`]. Nothing where no place is sent.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Places([[i8; 6]; 2]);

/// Metres and radians; half the units of a stream are 125 of them.
const MOVE: f64 = 1e-6;
const TURN: f64 = 7e-6;

impl Places {
    /// Of `poses`, which became `frame`.
    pub fn new(poses: &[HandPose], frame: &BapFrame, profile: Profile) -> Self {
        let mut places = Self::default();
        for pose in poses.iter().filter(|_| profile == Profile::Hand) {
            let Some(rounded) = pose_from_frame(frame, pose.side, profile) else { continue };
            let moved = (pose.translation - rounded.translation) / MOVE;
            let turned = (rounded.rotation.inverse() * pose.rotation).scaled_axis() / TURN;
            let steps = [moved.x, moved.y, moved.z, turned.x, turned.y, turned.z];
            // A wrist farther than a stream says is brought nearer, of which the encoder warns.
            places.0[pose.side as usize] = steps.map(|step| step.round() as i8);
        }
        places
    }

    /// Gives a rounded pose back what rounding took.
    fn restore(&self, pose: &mut HandPose) {
        let [x, y, z, a, b, c] = self.0[pose.side as usize].map(f64::from);
        pose.translation += Vector3::new(x, y, z) * MOVE;
        pose.rotation *= UnitQuaternion::new(Vector3::new(a, b, c) * TURN);
    }
}

/// Compares the fingertips of frames with those that a decoder has.
#[derive(Clone, Debug)]
pub(crate) struct TipMeter {
    profile: Profile,
    /// Left and right on the person's sizes.
    skeletons: [Skeleton; 2],
    /// The same as decoders have them, where those are others.
    decoded: [Option<Skeleton>; 2],
    off: Tally,
    /// Metres at most that sizes alone make.
    sizes: f32,
}

/// Of two places of each fingertip how far they are apart, metres.
fn apart(a: Tips, b: Tips) -> [f32; 5] {
    std::array::from_fn(|k| a[k].iter().zip(b[k]).map(|(a, b)| (a - b) * (a - b)).sum::<f32>().sqrt())
}

impl TipMeter {
    /// Of hands of these sizes, in a stream that carries this record.
    pub fn new(profile: Profile, sizes: &[ClipHand], record: &Record) -> Self {
        let sides = [Side::Left, Side::Right];
        let of = |hands: &[ClipHand], side| {
            let told = hands.iter().find(|hand| hand.side == side);
            told.and_then(|hand| hand.morphology.clone()).filter(|sizes| sizes.validate().is_ok())
        };
        let own = sides.map(|side| of(sizes, side).unwrap_or_default());
        let carried = hands_of_record(record);
        let decoded = sides.map(|side| {
            let sizes = of(&carried, side).filter(|sizes| *sizes != own[side as usize]);
            sizes.map(|sizes| Skeleton::new(&sizes, side))
        });
        let skeletons = sides.map(|side| Skeleton::new(&own[side as usize], side));
        Self { profile, skeletons, decoded, off: Tally::new(), sizes: 0.0 }
    }

    /// Takes in what was encoded, but for values that were only `held`, what rounding took from it, and what a decoder has of
    /// it.
    pub fn add(&mut self, places: &Places, [given, coded]: [&BapFrame; 2], held: &BapMask) {
        let known = given.mask.difference(held);
        // What is not sent yet is 0.
        let masks = [known, known.union(&coded.mask)];
        for side in [Side::Left, Side::Right] {
            let of = |n: usize| pose_of_given([given, coded][n], &masks[n], side, self.profile);
            let poses = [of(0), of(1)];
            let [Some(mut given), Some(coded)] = poses else { continue };
            places.restore(&mut given);
            let own = &self.skeletons[side as usize];
            let decoded = self.decoded[side as usize].as_ref().unwrap_or(own);
            let [wanted, resized] = tips([own, decoded], &given);
            self.sizes = apart(wanted, resized).into_iter().fold(self.sizes, f32::max);
            let [shown] = tips([decoded], &coded);
            apart(wanted, shown).into_iter().for_each(|metres| self.off.add(metres));
        }
    }

    /// Takes in what another one has.
    pub fn merge(&mut self, other: &Self) {
        self.off += &other.off;
        self.sizes = self.sizes.max(other.sizes);
    }

    /// What came of it; none if no hand was compared.
    pub fn error(&self) -> Option<TipError> {
        let placed = self.profile == Profile::Hand;
        let sizes_mm = 1e3 * f64::from(self.sizes);
        self.off.error().map(|error| TipError { placed, sizes_mm, ..error })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::mapping::PoseMapper;
    use crate::person::record_of;
    use crate::{
        PoseDecoder, PoseDecoderOptions, PoseEncoder, PoseEncoderOptions, decode_poses, encode_poses,
    };
    use handcast_fba::DecoderOptions;
    use handcast_fba::plan::{PlanOptions, Target};
    use handcast_hand::{JointAngle, Morphology, PoseClip, PoseHeader, TimedPose};

    /// A hand that waves and beckons, with a ring finger that follows late.
    fn poses() -> Vec<HandPose> {
        let pose = |frame: u32| {
            let t = f64::from(frame) / 30.0;
            let mut pose = HandPose::neutral(Side::Right)
                .with_degrees(JointAngle::Index2Flexion, 40.0 + 35.0 * (2.1 * t).sin())
                .with_degrees(JointAngle::Index3Flexion, 20.0 + 18.0 * (2.1 * t).sin())
                .with_degrees(
                    JointAngle::Ring1Flexion,
                    if frame < 100 { 0.0 } else { 25.0 * (0.7 * t).sin() },
                )
                .with_degrees(JointAngle::Thumb2Flexion, 15.0 + 15.0 * (1.3 * t).cos());
            pose.translation = [0.1 * t.sin(), 0.02 * (3.0 * t).cos(), 0.5 + 0.01 * t].into();
            pose
        };
        (0..480).map(pose).collect()
    }

    /// What the encoder says, and what comes out of a decoder.
    fn told_and_shown(mode: Target, live: bool, sizes: &[ClipHand]) -> [TipError; 2] {
        let plan = PlanOptions { mode, live, ..PlanOptions::default() };
        let options = PoseEncoderOptions::default().with_plan(plan).with_sizes(sizes);
        let mut encoder = PoseEncoder::new(options).unwrap();
        let given = poses();
        let mut stream = Vec::new();
        for (frame, pose) in given.iter().enumerate() {
            stream.extend(encoder.push(&TimedPose::new(frame as f64 / 30.0, pose.clone())).unwrap());
        }
        let end = encoder.finish().unwrap();
        stream.extend(end.bytes);
        let mut decoder = PoseDecoder::new(PoseDecoderOptions::default());
        let mut shown = decoder.push(&stream).unwrap();
        shown.extend(decoder.finish().unwrap());
        assert_eq!(shown.len(), given.len());
        let mut meter = TipMeter::new(Profile::Hand, sizes, &record_of(sizes, None));
        for (given, shown) in given.iter().zip(&shown) {
            let mut mapper = PoseMapper::new(Profile::Hand);
            let frames = [given, &shown.pose].map(|pose| mapper.frame(std::slice::from_ref(pose)));
            let place = Places::new(std::slice::from_ref(given), &frames[0], Profile::Hand);
            meter.add(&place, frames.each_ref(), &BapMask::EMPTY);
        }
        [end.tips.unwrap(), meter.error().unwrap()]
    }

    /// A person whose sizes lie between what a stream says.
    fn person() -> Morphology {
        let mut sizes = Morphology::average(0.1813);
        for (k, finger) in sizes.fingers.iter_mut().enumerate() {
            finger.bones.iter_mut().for_each(|bone| *bone += 0.00021 + 0.0001 * k as f64);
        }
        sizes
    }

    /// What a viewer sees, worked out from files alone.
    #[test]
    fn a_bound_of_fingertips_holds_on_the_sizes_that_are_shown() {
        let clip = PoseClip {
            header: PoseHeader::one(Side::Right, Some(person()), Some(30.0)),
            frames: poses()
                .into_iter()
                .enumerate()
                .map(|(i, p)| TimedPose::new(i as f64 / 30.0, p))
                .collect(),
        };
        for bound in [1.5, 3.0] {
            let plan = PlanOptions { mode: Target::TipError(bound), ..PlanOptions::default() };
            let encoded = encode_poses(&clip, Profile::Hand, &plan).unwrap();
            let shown = decode_poses(&encoded.stream, None, DecoderOptions::default()).unwrap().clip;
            let sizes = shown.header.hands[0].morphology.clone().unwrap();
            let skeletons = [person(), sizes].map(|sizes| Skeleton::new(&sizes, Side::Right));
            let mut most = 0.0f32;
            for (given, shown) in clip.frames.iter().zip(&shown.frames) {
                let [[given], [shown]] =
                    [(0, given), (1, shown)].map(|(k, f)| tips([&skeletons[k]], &f.pose));
                most = apart(given, shown).into_iter().fold(most, f32::max);
            }
            let told = encoded.tips.unwrap();
            assert!((1e3 * f64::from(most) - told.max_mm).abs() < 0.01, "{most} {told:?}");
            assert!(told.max_mm <= bound && told.max_mm > 0.8 * bound, "{bound}: {told:?}");
        }
    }

    #[test]
    fn what_an_encoder_says_of_fingertips_is_what_a_decoder_shows() {
        let modes = [Target::Quant(8), Target::MaxError(2.0), Target::TipError(3.0), Target::Rms(0.5)];
        let planned = modes.into_iter().chain([0.3, 0.6].map(Target::Bitrate)).map(|mode| (mode, false));
        let live = [Target::Rms(0.5), Target::Bitrate(1.0)].map(|mode| (mode, true));
        let person = [ClipHand { side: Side::Right, morphology: Some(person()) }];
        for (mode, live) in planned.chain(live) {
            let [told, shown] = told_and_shown(mode, live, &[]);
            assert_eq!(told.sizes_mm, 0.0);
            let [sized, seen] = told_and_shown(mode, live, &person);
            assert!((sized.mean_mm - seen.mean_mm).abs() < 1e-3, "{mode:?} {live}: {sized:?}, {seen:?}");
            assert!((sized.max_mm - seen.max_mm).abs() < 0.01, "{mode:?} {live}: {sized:?}, {seen:?}");
            assert!((0.2..1.5).contains(&sized.sizes_mm), "{sized:?}");
            assert!(told.mean_mm > 0.05, "{mode:?}: {told:?}");
            assert!((told.mean_mm - shown.mean_mm).abs() < 1e-3, "{mode:?} {live}: {told:?}, {shown:?}");
            assert!((told.max_mm - shown.max_mm).abs() < 0.01, "{mode:?} {live}: {told:?}, {shown:?}");
        }
    }

    #[test]
    fn a_tally_tells_what_sorting_does() {
        let mut metres: Vec<f32> =
            (0u32..5003).map(|n| 1e-7 * 1.004f32.powf((n * 2741 % 5003) as f32)).collect();
        let mut tally = Tally::new();
        assert_eq!(tally.error(), None);
        metres.iter().for_each(|&m| tally.add(m));
        metres.sort_by(f32::total_cmp);
        let told = tally.error().unwrap();
        let mean = metres.iter().map(|&m| f64::from(m)).sum::<f64>() / 5.003;
        assert!((told.mean_mm / mean - 1.0).abs() < 1e-9);
        assert_eq!(told.max_mm, 1e3 * f64::from(metres[5002]));
        for (rank, &exact) in
            metres.iter().enumerate().filter(|(_, m)| (Tally::LEAST..Tally::MOST).contains(*m))
        {
            let upper = tally.upper(rank as u64);
            assert!((1.0..=1.0 + 1.0 / 128.0).contains(&(upper / exact)), "{rank}: {exact} {upper}");
        }
    }
}
