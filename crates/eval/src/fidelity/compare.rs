//! Two motions of the same hands, joint by joint and instant by instant.

mod track;

use serde::Serialize;

use self::track::{Found, Kind, Track};
use super::summary::{Spread, Worst};
use handcast_codec::{clip_rate, poses_keep};
use handcast_fba::FrameRate;
use handcast_formats::motion::Motion;
use handcast_hand::{Finger, HandPose, Joint, JointAngle, Morphology, PoseClip, Side, Skeleton, TimedPose};

/// The tolerance of [`CompareOptions`] when nothing else is said, degrees: what the encoder keeps every joint angle
/// within at its default settings ([`handcast_fba::plan::PlanOptions::max_error`]).
pub const DEFAULT_TOLERANCE: f64 = 2.5;

/// Degrees of the wrist's rotation that count as much as one of a joint angle: the room the encoder gives them.
pub const WRIST_DEG_PER_DEG: f64 = 4.0;
/// Millimetres of the wrist's position that count as much as a degree of a joint angle: likewise.
pub const WRIST_MM_PER_DEG: f64 = 40.0;

/// What is compared, and how.
#[derive(Clone, Debug, PartialEq)]
pub struct CompareOptions {
    /// Largest difference of a joint angle that still counts as the same, degrees.
    pub tolerance_deg: f64,
    /// The same for the rotation of the wrist, degrees.
    pub wrist_tolerance_deg: f64,
    /// The same for its position, millimetres.
    pub wrist_tolerance_mm: f64,
    /// The joint angles that both motions tell.
    pub angles: Vec<JointAngle>,
    /// Whether both tell where the wrist is; its rotation is always compared.
    pub placed: bool,
    /// Of each motion, whether it is defined between its poses by interpolation.
    pub keyed: [bool; 2],
    /// Of each motion, whether it has poses where a hand is lost, too, held or interpolated ones, since its format cannot
    /// say that it is.
    pub bridged: [bool; 2],
    /// Whether times of both count from the same instant, as those of a clip and of a part of it do, not each from its own first
    /// frame.
    pub same_clock: bool,
    /// Whether the first motion is what the second should be, so that it alone tells which joint angles are ever other
    /// than 0.
    pub reference: bool,
}

impl Default for CompareOptions {
    /// All angles and the wrist of two motions with a pose at every frame.
    fn default() -> Self {
        Self {
            tolerance_deg: DEFAULT_TOLERANCE,
            wrist_tolerance_deg: WRIST_DEG_PER_DEG * DEFAULT_TOLERANCE,
            wrist_tolerance_mm: WRIST_MM_PER_DEG * DEFAULT_TOLERANCE,
            angles: JointAngle::ALL.to_vec(),
            placed: true,
            keyed: [false; 2],
            bridged: [false; 2],
            same_clock: false,
            reference: false,
        }
    }
}

impl CompareOptions {
    /// These, with other tolerances; those of the wrist follow from that of the joint angles.
    #[must_use]
    pub fn with_tolerance(self, degrees: f64) -> Self {
        Self {
            tolerance_deg: degrees,
            wrist_tolerance_deg: WRIST_DEG_PER_DEG * degrees,
            wrist_tolerance_mm: WRIST_MM_PER_DEG * degrees,
            ..self
        }
    }

    /// What two files of these kinds both tell.
    pub fn of(a: &Motion, b: &Motion) -> Self {
        let both = |angle: &JointAngle| a.angles.contains(angle) && b.angles.contains(angle);
        Self {
            angles: JointAngle::ALL.into_iter().filter(both).collect(),
            placed: a.placed && b.placed,
            keyed: [a.keyed, b.keyed],
            bridged: [a, b].map(Motion::bridges_lost),
            ..Self::default()
        }
    }
}

/// One joint angle of one hand.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JointDifference {
    /// Name of the angle.
    pub joint: String,
    /// Root mean square over the instants compared, degrees.
    pub rms_deg: f64,
    /// Where it is largest, degrees.
    pub max: Worst,
}

/// One hand in both motions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HandDifference {
    /// Left or right.
    pub side: Side,
    /// Instants compared.
    pub frames: usize,
    /// The angles compared, in the order of [`JointAngle::ALL`]; none where no instant was.
    pub joints: Vec<JointDifference>,
    /// Root mean square over the angles that are ever further than [`NOUGHT_DEG`] from 0 in either motion, degrees; with
    /// [`CompareOptions::reference`] over those that are ever other than 0 in the first. `None` where no instant was compared.
    pub moving_rms_deg: Option<f64>,
    /// Wrist to middle fingertip along the bones in each motion, millimetres; `None` where not both tell sizes, which are
    /// then those of the other, or of a mean hand.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lengths_mm: Option<[f64; 2]>,
    /// Distance of the five fingertips, wrist on wrist, of hands with these sizes, millimetres; `None` where no instant was
    /// compared.
    pub fingertips_mm: Option<Spread>,
    /// Angle between the rotations of the wrist, degrees; `None` likewise.
    pub wrist_deg: Option<Spread>,
    /// Distance of the wrists, millimetres; `None` likewise, and where one motion does not tell it.
    pub wrist_mm: Option<Spread>,
}

impl HandDifference {
    /// The joint that is furthest off.
    pub fn worst(&self) -> Option<&JointDifference> {
        self.joints.iter().max_by(|a, b| a.max.value.total_cmp(&b.max.value))
    }
}

/// The first instant at which a joint is further off than its tolerance; of several joints the one that is furthest
/// beyond it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Divergence {
    /// Left or right.
    pub side: Side,
    /// Name of the joint angle, `wrist_rotation` or `wrist_position`.
    pub joint: String,
    /// Number of the instant among all of the first motion, or of the second where the first is interpolated, or has several
    /// ticks to a frame of the second.
    pub frame: usize,
    /// Seconds from the first frame.
    pub time: f64,
    /// How far off, in `unit`.
    pub off: f64,
    /// `deg` or `mm`.
    pub unit: &'static str,
    /// The joint angle in the first and in the second motion, degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub angles_deg: Option<[f64; 2]>,
}

/// What one motion is, in numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Extent {
    /// Instants at which any hand has a pose.
    pub frames: usize,
    /// Among them instants at which a hand is lost.
    pub lost: usize,
    /// Frames per second; `None` for keyed motions.
    pub rate: Option<f64>,
    /// Time that is counted from, seconds: as a rule that of the first frame.
    pub start: f64,
    /// From the first frame to the last, seconds.
    pub seconds: f64,
}

/// Two motions compared.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Degrees up to which joint angles count as the same.
    pub tolerance_deg: f64,
    /// The two motions.
    pub motions: [Extent; 2],
    /// The hands that both have.
    pub hands: Vec<HandDifference>,
    /// Hands that only one of them has.
    pub unmatched_hands: [Vec<Side>; 2],
    /// Frames of each that have no counterpart in the other: a valid pose where that has none, or has the hand lost.
    pub unmatched_frames: [usize; 2],
    /// Among them those at which the other one has the hand lost.
    pub lost_in_other: [usize; 2],
    /// Whether both have a rate, not the same, and poses at other times: neither then has the frames of the other.
    pub rates_differ: bool,
    /// Whether poses of the second were interpolated to the instants of the first (or the other way round).
    pub interpolated: bool,
    /// Which of them was, since its times are uneven and those of the other are not.
    pub uneven: [bool; 2],
    /// Which of them has the rate of the stream that the other is sent as, with several ticks to a frame, since no stream has
    /// its own: they are compared at the times of the other.
    pub carrier: [bool; 2],
    /// Joint angles left out because one of the motions does not tell them.
    pub left_out: Vec<String>,
    /// The first instant above the tolerance.
    pub first_divergence: Option<Divergence>,
}

impl Comparison {
    /// The largest difference of any joint angle, degrees.
    pub fn max_deg(&self) -> f64 {
        self.hands.iter().filter_map(HandDifference::worst).map(|j| j.max.value).fold(0.0, f64::max)
    }

    /// Whether no joint is further off than its tolerance, and something was compared.
    pub fn within_tolerance(&self) -> bool {
        self.first_divergence.is_none() && self.hands.iter().any(|h| h.frames > 0)
    }

    /// Whether both have the same hands at the same instants.
    pub fn is_complete(&self) -> bool {
        !self.rates_differ
            && self.unmatched_frames == [0, 0]
            && self.unmatched_hands.iter().all(Vec::is_empty)
    }
}

/// Degrees up to which an angle counts as 0 where neither motion is the reference: what a rotation of 32-bit numbers makes of 0.
pub const NOUGHT_DEG: f64 = super::GLB_DEG;
/// Seconds by which times differ that are the same: many formats tell milliseconds.
const SAME_INSTANT: f64 = 1.5e-3;
/// Frames per second by which rates differ that are the same, as streams write the nearest sixteenth.
const SAME_RATE: f64 = 1.0 / 32.0 + 1e-9;

/// Seconds that times of one instant differ by at most in files of single precision.
pub(super) const SAME_TIME: f64 = 1e-3;

/// Compares the poses of `a` and `b`, each counted from its own first frame unless they have the
/// [same clock](CompareOptions::same_clock). Some files have no lost frames: where a hand is then
/// first seen at different times, and at the same time if both are counted from the first frame of any, or one of them from 0,
/// they are.
///
/// At the same rate each frame is compared with the nearest of the other motion, at most half an interval away, and so is each
/// frame with the nearest tick of a stream that has several of them to a frame, as no stream has the frames' rate; at
/// different rates, or where one is keyed, the second is interpolated at the instants of the first (of the one that is
/// not keyed; of two keyed ones at the keys of both). One whose times are uneven beside even ones is interpolated at those, as
/// an encoder does, unless they are nearer without, as where a format without times took its poses over. Lost frames are not
/// compared; where the other motion has the hand they count as unmatched in that one.
pub fn compare(a: &PoseClip, b: &PoseClip, options: &CompareOptions) -> Comparison {
    let mut extents = [extent(a, options.keyed[0]), extent(b, options.keyed[1])];
    let starts = extents.map(|extent| extent.start);
    let origins = if options.same_clock { [starts[0].min(starts[1]); 2] } else { origins([a, b], starts) };
    extents.iter_mut().zip(origins).for_each(|(extent, origin)| extent.start = origin);
    let same_rate = match (extents[0].rate, extents[1].rate) {
        (Some(one), Some(other)) => (one / other - 1.0).abs() < 2e-3,
        _ => false,
    };
    let nearest = paired([a, b], options, extents, same_rate, [false; 2]);
    let uneven = uneven([a, b], extents.map(|extent| extent.rate.filter(|_| same_rate)));
    if !uneven.contains(&true) {
        return nearest;
    }
    let interpolated = paired([a, b], options, extents, same_rate, uneven);
    let frames = |found: &Comparison| found.hands.iter().map(|hand| hand.frames).sum::<usize>();
    let of = |hand: &HandDifference| {
        let mean = |spread: &Option<Spread>| spread.as_ref().map_or(0.0, |spread| spread.mean);
        hand.moving_rms_deg.unwrap_or_default()
            + mean(&hand.wrist_deg) / WRIST_DEG_PER_DEG
            + mean(&hand.wrist_mm) / WRIST_MM_PER_DEG
    };
    let off = |found: &Comparison| found.hands.iter().map(of).sum::<f64>();
    let nearer = off(&nearest) < off(&interpolated) && frames(&nearest) >= frames(&interpolated);
    if nearer { nearest } else { interpolated }
}

/// Compares poses instant by instant; those of a motion that is `uneven` are interpolated at the instants of the other.
fn paired(
    [a, b]: [&PoseClip; 2],
    options: &CompareOptions,
    extents: [Extent; 2],
    same_rate: bool,
    uneven: [bool; 2],
) -> Comparison {
    let carrier = match (extents[0].rate, extents[1].rate) {
        (Some(one), Some(other)) if !same_rate => [carries(one, other), carries(other, one)],
        _ => [false; 2],
    };
    let nearest = same_rate || carrier.contains(&true);
    let mut out = Comparison {
        tolerance_deg: options.tolerance_deg,
        motions: extents,
        hands: Vec::new(),
        unmatched_hands: [Vec::new(), Vec::new()],
        unmatched_frames: [0, 0],
        lost_in_other: [0, 0],
        rates_differ: match (extents[0].rate, extents[1].rate) {
            (Some(one), Some(other)) => {
                let near = nearest || (one - other).abs() <= SAME_RATE;
                !near && !at_same_instants([a, b], extents)
            }
            _ => false,
        },
        interpolated: !nearest || uneven.contains(&true),
        uneven,
        carrier,
        left_out: Vec::new(),
        first_divergence: None,
    };
    let left_out = JointAngle::ALL.into_iter().filter(|angle| !options.angles.contains(angle));
    out.left_out = left_out.map(|angle| angle.name().to_owned()).collect();
    // Frames are counted over all hands.
    let instants = instants(if extents[0].rate.is_none() || uneven[0] || carrier[0] { b } else { a });
    for side in [Side::Left, Side::Right] {
        let kind =
            |k: usize| Kind { nearest, uneven: uneven[k], carries: carrier[k], bridges: options.bridged[k] };
        let track = |clip, k: usize| Track::new(clip, side, extents[k], kind(k));
        let tracks = [track(a, 0), track(b, 1)];
        match [tracks[0].poses.is_empty(), tracks[1].poses.is_empty()] {
            [true, true] => {}
            [true, false] => out.unmatched_hands[1].push(side),
            [false, true] => out.unmatched_hands[0].push(side),
            [false, false] => {
                let sizes = [a, b].map(|clip| clip.header.hand(side).and_then(|h| h.morphology.as_ref()));
                let mut pairing = Pairing::new(side, sizes, options);
                pairing.run(&tracks, &instants, &mut out);
                out.hands.push(pairing.result());
            }
        }
    }
    out
}

/// Whether a stream of `rate` frames a second is what a motion is sent as that has another one, which none can have.
fn carries(rate: f64, own: f64) -> bool {
    FrameRate::carrying(own)
        .is_some_and(|(found, ticks)| ticks > 1 && (found.per_second() / rate - 1.0).abs() < 1e-6)
}

/// The times from which two motions are counted that begin at `starts`.
fn origins(clips: [&PoseClip; 2], starts: [f64; 2]) -> [f64; 2] {
    // What both have: one may be without the hand that comes first.
    let has = |clip: &PoseClip, side: Side| clip.of(side).any(|f| f.valid);
    let both = [Side::Left, Side::Right].map(|side| clips.iter().all(|clip| has(clip, side)));
    let counts = |side: Side| both[side as usize] || both == [false; 2];
    let seen = clips.map(|clip| {
        let valid = clip.frames.iter().filter(|f| f.valid && counts(f.pose.side));
        valid.map(|f| f.time).fold(f64::INFINITY, f64::min)
    });
    let first = starts[0].min(starts[1]);
    let ways = [starts, [first; 2], [starts[0], 0.0], [0.0, starts[1]]];
    let agree = |way: &[f64; 2]| ((seen[0] - way[0]) - (seen[1] - way[1])).abs() < SAME_TIME;
    ways.into_iter().find(agree).unwrap_or(starts)
}

/// Which of two motions of the same rate has times that are no ticks of it, where the other's are.
fn uneven(clips: [&PoseClip; 2], rates: [Option<f64>; 2]) -> [bool; 2] {
    let ([a, b], [Some(one), Some(other)]) = (clips, rates) else { return [false; 2] };
    let [a, b] = [poses_keep(a, one), poses_keep(b, other)];
    [!a && b, !b && a]
}

/// The times at which any hand has a pose, in order.
fn instants(clip: &PoseClip) -> Vec<f64> {
    distinct(&clip.frames)
}

/// The instants of poses, in order.
fn distinct<'a>(poses: impl IntoIterator<Item = &'a TimedPose>) -> Vec<f64> {
    let mut times: Vec<f64> = poses.into_iter().map(|pose| pose.time).collect();
    times.sort_by(f64::total_cmp);
    times.dedup_by(|a, b| (*a - *b).abs() < 1e-6);
    times
}

/// Whether two motions have their poses at the same times, whatever rates they tell.
fn at_same_instants(clips: [&PoseClip; 2], extents: [Extent; 2]) -> bool {
    let [a, b] = clips.map(instants);
    let [start, other] = extents.map(|extent| extent.start);
    let near = |(a, b): (&f64, &f64)| ((a - start) - (b - other)).abs() < SAME_INSTANT;
    a.len() == b.len() && a.iter().zip(&b).all(near)
}

/// How far the wrists are turned from each other, radians: exactly 0 where they are turned alike.
fn turned(a: &HandPose, b: &HandPose) -> f64 {
    if a.rotation.coords == b.rotation.coords { 0.0 } else { a.rotation.angle_to(&b.rotation) }
}

/// Whether two poses are the same within the tolerances.
fn alike(a: &HandPose, b: &HandPose, options: &CompareOptions) -> bool {
    let near =
        |angle: &JointAngle| (a.angle(*angle) - b.angle(*angle)).to_degrees().abs() <= options.tolerance_deg;
    let moved = 1e3 * (a.translation - b.translation).norm();
    options.angles.iter().all(near)
        && turned(a, b).to_degrees() <= options.wrist_tolerance_deg
        && (!options.placed || moved <= options.wrist_tolerance_mm)
}

fn extent(clip: &PoseClip, keyed: bool) -> Extent {
    let times = instants(clip);
    let (Some(first), Some(last)) = (times.first(), times.last()) else { return Extent::default() };
    Extent {
        frames: times.len(),
        lost: distinct(clip.frames.iter().filter(|f| !f.valid)).len(),
        rate: (!keyed).then(|| clip_rate(clip)),
        start: *first,
        seconds: last - first,
    }
}

/// The joint that is furthest beyond its tolerance.
#[derive(Default)]
struct Furthest {
    /// By how much, as a share of the tolerance.
    beyond: f64,
    joint: &'static str,
    off: f64,
    unit: &'static str,
    angles_deg: Option<[f64; 2]>,
}

impl Furthest {
    fn add(
        &mut self,
        off: f64,
        tolerance: f64,
        joint: &'static str,
        unit: &'static str,
        angles: Option<[f64; 2]>,
    ) {
        let beyond = (off - tolerance) / tolerance.max(1e-12);
        if beyond > self.beyond {
            *self = Self { beyond, joint, off, unit, angles_deg: angles };
        }
    }
}

/// Collects the differences of one hand.
struct Pairing<'o> {
    options: &'o CompareOptions,
    side: Side,
    skeletons: [Skeleton; 2],
    lengths_mm: Option<[f64; 2]>,
    frames: usize,
    /// For each angle compared: sum of squares, largest, whether it is ever other than 0.
    angles: Vec<(f64, Worst, bool)>,
    tips: Spread,
    rotation: Spread,
    position: Spread,
}

impl<'o> Pairing<'o> {
    fn new(side: Side, sizes: [Option<&Morphology>; 2], options: &'o CompareOptions) -> Self {
        let mean = Morphology::default();
        let of_either = [sizes[0].or(sizes[1]), sizes[1].or(sizes[0])];
        let length = |sizes: &Morphology| {
            let middle = sizes.finger(Finger::Middle);
            1e3 * (middle.base[1] + middle.length())
        };
        let lengths_mm = sizes[0].zip(sizes[1]).map(|(a, b)| [a, b].map(length));
        Self {
            options,
            side,
            skeletons: of_either.map(|sizes| Skeleton::new(sizes.unwrap_or(&mean), side)),
            lengths_mm,
            frames: 0,
            angles: vec![(0.0, Worst::default(), false); options.angles.len()],
            tips: Spread::default(),
            rotation: Spread::default(),
            position: Spread::default(),
        }
    }

    /// Compares one hand in both; frames are numbered as in `numbers`, the times of the motion whose instants count.
    fn run(&mut self, tracks: &[Track; 2], numbers: &[f64], out: &mut Comparison) {
        let [a, b] = tracks;
        let times = |track: &Track| -> Vec<(usize, f64)> {
            let number = |time: f64| numbers.partition_point(|n| *n < time - 1e-6);
            track.poses.iter().enumerate().map(|(i, p)| (number(p.time), track.time(i))).collect()
        };
        let instants = match (a.follows(), b.follows()) {
            (true, false) => times(b),
            (true, true) => {
                let mut all: Vec<f64> =
                    [times(a), times(b)].concat().into_iter().map(|(_, time)| time).collect();
                all.sort_by(f64::total_cmp);
                all.dedup_by(|a, b| (*a - *b).abs() < 1e-5);
                all.into_iter().enumerate().collect()
            }
            _ => times(a),
        };
        for (frame, time) in instants {
            let (Found::Pose(one), Found::Pose(other)) = (a.at(time), b.at(time)) else {
                continue;
            };
            if let Some(found) = self.add(frame, time, &one, &other)
                && out.first_divergence.as_ref().is_none_or(|first| found.time < first.time)
            {
                out.first_divergence = Some(found);
            }
        }
        for (k, [one, other]) in [[a, b], [b, a]].into_iter().enumerate() {
            let missing = one.without(other, self.options);
            out.unmatched_frames[k] += missing.frames;
            out.lost_in_other[k] += missing.lost;
        }
    }

    /// Adds an instant; tells the joint that is furthest off, if it is beyond the tolerance.
    fn add(&mut self, frame: usize, time: f64, a: &HandPose, b: &HandPose) -> Option<Divergence> {
        self.frames += 1;
        let tolerance = self.options.tolerance_deg;
        let mut furthest = Furthest::default();
        for (&angle, (squares, worst, moving)) in self.options.angles.iter().zip(&mut self.angles) {
            let off = (b.angle(angle) - a.angle(angle)).to_degrees().abs();
            *squares += off * off;
            worst.add(off, frame, time);
            *moving |= match self.options.reference {
                true => a.angle(angle) != 0.0,
                false => [a, b].iter().any(|pose| pose.angle(angle).to_degrees().abs() > NOUGHT_DEG),
            };
            furthest.add(
                off,
                tolerance,
                angle.name(),
                "deg",
                Some([a, b].map(|p| p.angle(angle).to_degrees())),
            );
        }
        let [one, other] = &self.skeletons;
        let joints = [one.local_frames(&a.angles), other.local_frames(&b.angles)];
        for finger in Finger::ALL {
            let [one, other] = joints.each_ref().map(|j| j.position(Joint::tip(finger)));
            self.tips.add(1e3 * (one - other).norm(), frame, time);
        }
        let turned = turned(a, b).to_degrees();
        self.rotation.add(turned, frame, time);
        furthest.add(turned, self.options.wrist_tolerance_deg, "wrist_rotation", "deg", None);
        let moved = 1e3 * (a.translation - b.translation).norm();
        self.position.add(moved, frame, time);
        if self.options.placed {
            furthest.add(moved, self.options.wrist_tolerance_mm, "wrist_position", "mm", None);
        }
        let Furthest { beyond, joint, off, unit, angles_deg } = furthest;
        (beyond > 0.0).then(|| Divergence {
            side: self.side,
            joint: joint.to_owned(),
            frame,
            time,
            off,
            unit,
            angles_deg,
        })
    }

    fn result(mut self) -> HandDifference {
        for spread in [&mut self.tips, &mut self.rotation, &mut self.position] {
            spread.settle();
        }
        let count = self.frames.max(1) as f64;
        let (mut squares, mut moving) = (0.0, 0.0);
        for (sum, _, _) in self.angles.iter().filter(|(_, _, moves)| *moves) {
            squares += sum;
            moving += count;
        }
        let joint = |(&angle, &(sum, max, _)): (&JointAngle, &(f64, Worst, bool))| JointDifference {
            joint: angle.name().to_owned(),
            rms_deg: (sum / count).sqrt(),
            max,
        };
        let any = self.frames > 0;
        let joints = self.options.angles.iter().zip(&self.angles).filter(|_| any);
        HandDifference {
            side: self.side,
            frames: self.frames,
            joints: joints.map(joint).collect(),
            lengths_mm: self.lengths_mm,
            moving_rms_deg: any.then(|| if moving > 0.0 { f64::sqrt(squares / moving) } else { 0.0 }),
            fingertips_mm: any.then_some(self.tips),
            wrist_deg: any.then_some(self.rotation),
            wrist_mm: (any && self.options.placed).then_some(self.position),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::{PoseHeader, TimedPose};

    const BEND: JointAngle = JointAngle::Index2Flexion;

    fn clip(side: Side, rate: f64, count: usize, degrees: impl Fn(f64) -> f64) -> PoseClip {
        let frames = (0..count).map(|i| {
            let t = i as f64 / rate;
            TimedPose::new(t, HandPose::neutral(side).with_degrees(BEND, degrees(t)))
        });
        PoseClip { header: PoseHeader::one(side, None, Some(rate)), frames: frames.collect() }
    }

    fn ramp(count: usize) -> PoseClip {
        clip(Side::Right, 30.0, count, |t| 30.0 * t)
    }

    #[test]
    fn files_without_lost_frames_are_compared_in_time() {
        let mut a = ramp(60);
        a.frames[..20].iter_mut().for_each(|frame| frame.valid = false);
        a.frames[50..].iter_mut().for_each(|frame| frame.valid = false);
        let mut b = a.clone();
        b.frames.retain(|frame| frame.valid);
        for [one, other] in [[&a, &b], [&b, &a]] {
            let found = compare(one, other, &CompareOptions::default());
            assert!(found.within_tolerance() && found.is_complete(), "{found:?}");
            assert_eq!(found.hands[0].frames, 30);
        }
        // A stream holds the first pose before it, and begins at 0.
        let held = clip(Side::Right, 30.0, 60, |t| 30.0 * t.max(20.0 / 30.0));
        a.frames.iter_mut().for_each(|frame| frame.time += 7.0);
        let found = compare(&a, &held, &CompareOptions::default());
        assert!(found.within_tolerance(), "{found:?}");
    }

    /// What an encoder makes of a recording without a beat is that recording.
    #[test]
    fn uneven_times_are_interpolated_at_even_ones() {
        let mut recorded = clip(Side::Right, 30.0, 90, |_| 0.0);
        for (number, frame) in recorded.frames.iter_mut().enumerate() {
            frame.time += 0.45 / 30.0 * (2.3 * number as f64).sin();
            frame.pose.set(BEND, (50.0 * (3.0 * frame.time).sin()).to_radians());
        }
        let even = handcast_codec::on_ticks(&recorded, 30.0, 0.0);
        assert!(even.frames.windows(2).all(|pair| (pair[1].time - pair[0].time - 1.0 / 30.0).abs() < 1e-9));
        for (a, b, uneven) in [(&recorded, &even, [true, false]), (&even, &recorded, [false, true])] {
            let found = compare(a, b, &CompareOptions::default());
            assert_eq!((found.uneven, found.interpolated), (uneven, true));
            assert!(found.is_complete() && found.hands[0].frames == even.frames.len(), "{found:?}");
            assert!(found.max_deg() < 1e-6, "{found:?}");
        }
        let found = compare(&recorded, &recorded, &CompareOptions::default());
        assert_eq!((found.uneven, found.interpolated, found.max_deg()), ([false; 2], false, 0.0));
    }

    /// A stream of a rate that none has holds each frame for some ticks.
    #[test]
    fn frames_are_compared_with_their_own_ticks() {
        for rate in [6.67, 20.0 / 3.0, 9.09, 100.0 / 11.0] {
            let poses = clip(Side::Right, rate, 60, |t| 50.0 * (3.0 * t).sin());
            let (carried, ticks) = FrameRate::carrying(rate).unwrap();
            let tick = carried.per_second().recip();
            assert!(ticks > 1);
            let header = PoseHeader::one(Side::Right, None, Some(carried.per_second()));
            let mut held = PoseClip { header, frames: Vec::new() };
            for number in 0..60 * ticks as usize {
                let time = number as f64 * tick;
                let frame = poses.frames.iter().rfind(|frame| frame.time < time + 0.5 * tick).unwrap();
                held.frames.push(TimedPose { time, ..frame.clone() });
            }
            for [a, b] in [[&held, &poses], [&poses, &held]] {
                let found = compare(a, b, &CompareOptions::default());
                assert!(found.max_deg() < 1e-9 && found.is_complete(), "{rate}: {found:?}");
                assert_eq!((found.hands[0].frames, found.interpolated), (60, false));
                assert!(found.carrier.contains(&true));
            }
            let mut off = held.clone();
            let wrong = &mut off.frames[20 * ticks as usize].pose;
            wrong.set(BEND, wrong.angle(BEND) + 0.2);
            let found = compare(&off, &poses, &CompareOptions::default()).first_divergence.unwrap();
            assert_eq!((found.frame, found.joint.as_str()), (20, "index2_flexion"));
        }
    }

    #[test]
    fn each_motion_has_its_own_sizes() {
        let sized = |length: f64| {
            let mut clip = ramp(60);
            clip.header.hands[0].morphology = Some(Morphology::average(length));
            clip
        };
        let found = compare(&sized(0.18), &sized(0.15), &CompareOptions::default());
        let hand = &found.hands[0];
        assert!(found.within_tolerance() && hand.fingertips_mm.as_ref().unwrap().mean > 15.0, "{hand:?}");
        assert_eq!(hand.lengths_mm.map(|both| both.map(f64::round)), Some([180.0, 150.0]));
        let found = compare(&sized(0.18), &ramp(60), &CompareOptions::default());
        let hand = &found.hands[0];
        assert_eq!((hand.fingertips_mm.as_ref().unwrap().mean, hand.lengths_mm), (0.0, None));
    }

    #[test]
    fn the_worst_and_the_first_divergence_are_found() {
        let a = ramp(60);
        let mut b = ramp(60);
        for (frame, off) in [(12, 2.0), (20, 3.0), (40, -9.0)] {
            let pose = &mut b.frames[frame].pose;
            pose.set(BEND, pose.angle(BEND) + f64::to_radians(off));
        }
        let found = compare(&a, &b, &CompareOptions::default());
        let hand = &found.hands[0];
        let worst = hand.worst().unwrap();
        assert_eq!((worst.joint.as_str(), worst.max.frame), ("index2_flexion", 40));
        assert!((worst.max.value - 9.0).abs() < 1e-9 && (worst.max.time - 40.0 / 30.0).abs() < 1e-9);
        let rms = f64::sqrt((4.0 + 9.0 + 81.0) / 60.0);
        assert!((worst.rms_deg - rms).abs() < 1e-9 && (hand.moving_rms_deg.unwrap() - rms).abs() < 1e-9);
        let first = found.first_divergence.as_ref().unwrap();
        assert_eq!((first.frame, first.joint.as_str()), (20, "index2_flexion"));
        let [one, other] = first.angles_deg.unwrap();
        assert!((other - one - 3.0).abs() < 1e-9 && (first.off - 3.0).abs() < 1e-9 && first.unit == "deg");
        assert!(!found.within_tolerance() && found.is_complete());
        let lenient = CompareOptions::default().with_tolerance(9.1);
        assert!(compare(&a, &b, &lenient).within_tolerance());
        let tips = hand.fingertips_mm.as_ref().unwrap();
        assert!(tips.max.value > 1.0 && tips.max.frame == 40);
    }

    #[test]
    fn a_wrist_elsewhere_is_a_divergence() {
        let a = ramp(20);
        let mut turned = ramp(20);
        turned.frames[7].pose.rotation = nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.3, 0.0);
        let first = compare(&a, &turned, &CompareOptions::default()).first_divergence.unwrap();
        assert_eq!((first.joint.as_str(), first.frame, first.angles_deg), ("wrist_rotation", 7, None));
        let mut moved = ramp(20);
        moved.frames[9].pose.translation.x = 0.2;
        let first = compare(&a, &moved, &CompareOptions::default()).first_divergence.unwrap();
        assert_eq!((first.joint.as_str(), first.frame, first.unit), ("wrist_position", 9, "mm"));
        let unplaced = CompareOptions { placed: false, ..CompareOptions::default() };
        assert!(compare(&a, &moved, &unplaced).within_tolerance());
    }

    #[test]
    fn what_one_has_and_the_other_has_not_is_counted() {
        let found = compare(&ramp(60), &ramp(50), &CompareOptions::default());
        assert_eq!((found.unmatched_frames, found.hands[0].frames), ([10, 0], 50));
        assert!(found.within_tolerance() && !found.is_complete());
        let left = clip(Side::Left, 30.0, 60, |_| 0.0);
        let found = compare(&ramp(60), &left, &CompareOptions::default());
        assert_eq!(found.unmatched_hands, [vec![Side::Right], vec![Side::Left]]);
        assert!(found.hands.is_empty() && !found.within_tolerance());
        // A frame that is lost is not compared, and where the other has the hand it is missing.
        let mut lost = ramp(60);
        lost.frames[3].valid = false;
        let found = compare(&ramp(60), &lost, &CompareOptions::default());
        assert_eq!((found.hands[0].frames, found.motions[1].lost), (59, 1));
        assert_eq!((found.unmatched_frames, found.lost_in_other), ([1, 0], [1, 0]));
        let found = compare(&lost, &ramp(60), &CompareOptions::default());
        assert_eq!((found.unmatched_frames, found.lost_in_other), ([0, 1], [0, 1]));
        assert!(compare(&lost, &lost, &CompareOptions::default()).is_complete());
    }

    /// A stream holds poses where the hand is lost, and cannot say that it is.
    #[test]
    fn what_bridges_lost_frames_is_no_other_motion() {
        let whole = clip(Side::Right, 30.0, 90, |t| 40.0 * (5.0 * t).sin());
        let mut lost = whole.clone();
        lost.frames[..10].iter_mut().for_each(|frame| frame.valid = false);
        lost.frames[30..80].iter_mut().for_each(|frame| frame.valid = false);
        let mut held = whole.clone();
        for i in (0..10).chain(30..80) {
            held.frames[i].pose = whole.frames[if i < 10 { 10 } else { 29 }].pose.clone();
        }
        for swap in [false, true] {
            let run = |other: &PoseClip, bridged: bool| {
                let (clips, bridged) = if swap {
                    ([other, &lost], [bridged, false])
                } else {
                    ([&lost, other], [false, bridged])
                };
                let options = CompareOptions { bridged, ..CompareOptions::default() };
                compare(clips[0], clips[1], &options)
            };
            assert!(run(&held, true).is_complete());
            assert_eq!(run(&held, false).unmatched_frames.iter().sum::<usize>(), 60);
            // What moves where the hand was lost holds nothing; poses pass that happen to be near what would be held.
            let found = run(&whole, true);
            assert!((40..60).contains(&found.lost_in_other[usize::from(!swap)]), "{found:?}");
        }
    }

    #[test]
    fn either_motion_tells_which_angles_count_unless_one_is_the_reference() {
        let still = clip(Side::Right, 30.0, 60, |_| 0.0);
        let found = |a: &PoseClip, b: &PoseClip, reference: bool| {
            let options = CompareOptions { reference, ..CompareOptions::default() };
            compare(a, b, &options).hands[0].moving_rms_deg.unwrap()
        };
        let off = found(&ramp(60), &still, false);
        assert!(off > 10.0 && (off - found(&still, &ramp(60), false)).abs() < 1e-9);
        assert_eq!((found(&ramp(60), &still, true), found(&still, &ramp(60), true)), (off, 0.0));
    }

    /// A second hand that comes late is told by the frames of the motion.
    #[test]
    fn frames_are_counted_over_both_hands() {
        let mut both = ramp(60);
        let mut late = clip(Side::Left, 30.0, 60, |t| 30.0 * t);
        both.header.hands.extend(late.header.hands.clone());
        both.frames.extend(late.frames.drain(..).skip(50));
        let mut other = both.clone();
        other.frames[63].pose.set(BEND, 1.5);
        let first = compare(&both, &other, &CompareOptions::default()).first_divergence.unwrap();
        assert_eq!((first.side, first.frame), (Side::Left, 53));
        assert!((first.time - 53.0 / 30.0).abs() < 1e-9);
    }

    #[test]
    fn rates_that_differ_are_a_difference_whichever_comes_first() {
        let half = clip(Side::Right, 15.0, 30, |t| 30.0 * t);
        for (a, b) in [(&ramp(59), &half), (&half, &ramp(59))] {
            let found = compare(a, b, &CompareOptions::default());
            assert!(found.rates_differ && found.within_tolerance() && !found.is_complete(), "{found:?}");
        }
        // Times tell more than what is said of them.
        let mut told = ramp(59);
        told.header.rate = Some(31.0);
        assert!(compare(&ramp(59), &told, &CompareOptions::default()).is_complete());
        // A stream writes the nearest sixteenth.
        let slow = clip(Side::Right, 10.04, 30, |t| 30.0 * t);
        let nearly = clip(Side::Right, 10.0625, 30, |t| 30.0 * t);
        assert!(!compare(&slow, &nearly, &CompareOptions::default()).rates_differ);
    }

    #[test]
    fn poses_held_over_dropped_frames_are_not_missing() {
        let whole = clip(Side::Right, 30.0, 60, |t| 20.0 * t);
        let mut dropping = whole.clone();
        dropping.frames.drain(20..23);
        let mut held = whole.clone();
        for i in 20..23 {
            held.frames[i].pose = held.frames[19].pose.clone();
        }
        let unmatched =
            |a: &PoseClip, b: &PoseClip| compare(a, b, &CompareOptions::default()).unmatched_frames;
        assert_eq!(unmatched(&dropping, &held), [0, 0]);
        assert_eq!(unmatched(&held, &dropping), [0, 0]);
        assert_eq!(unmatched(&dropping, &whole), [0, 3]);
        // Behind the end of the other one they are.
        let still = clip(Side::Right, 30.0, 60, |_| 20.0);
        let mut short = still.clone();
        short.frames.truncate(50);
        assert_eq!(unmatched(&still, &short), [10, 0]);
    }

    #[test]
    fn keys_move_where_the_other_has_no_poses() {
        let keyed = CompareOptions { keyed: [false, true], ..CompareOptions::default() };
        let mut gap = ramp(60);
        gap.frames.drain(20..30);
        let found = compare(&gap, &gap, &keyed);
        assert_eq!((found.unmatched_frames, found.max_deg()), ([0, 10], 0.0));
        assert!(compare(&ramp(60), &ramp(60), &keyed).is_complete());
        // A hand that keeps still tells nothing that could be missing.
        let mut still = clip(Side::Right, 30.0, 60, |_| 20.0);
        still.frames.drain(20..30);
        assert!(compare(&still, &still, &keyed).is_complete());
    }

    #[test]
    fn other_rates_and_keys_are_interpolated() {
        let fast = clip(Side::Right, 75.0, 150, |t| 30.0 * t);
        let found = compare(&ramp(59), &fast, &CompareOptions::default());
        assert!(found.interpolated && found.max_deg() < 1e-9, "{found:?}");
        assert_eq!(found.unmatched_frames, [0, 3]);
        // Two keys say as much as sixty frames.
        let mut keys = ramp(60);
        keys.frames = vec![keys.frames[0].clone(), keys.frames[59].clone()];
        for swap in [false, true] {
            let (a, b) = if swap { (&keys, &ramp(60)) } else { (&ramp(60), &keys) };
            let options = CompareOptions { keyed: [swap, !swap], ..CompareOptions::default() };
            let found = compare(a, b, &options);
            assert_eq!(found.hands[0].frames, 60);
            assert!(found.max_deg() < 1e-9 && found.is_complete());
        }
    }

    #[test]
    fn times_count_from_the_first_frame_and_may_be_uneven() {
        let mut late = ramp(60);
        for (i, frame) in late.frames.iter_mut().enumerate() {
            frame.time += 7.0 + if i % 3 == 1 { 0.01 } else { 0.0 };
        }
        let found = compare(&ramp(60), &late, &CompareOptions::default());
        assert!(found.max_deg() < 1e-9 && found.is_complete());
        assert!((found.motions[1].start - 7.0).abs() < 1e-9);
    }

    #[test]
    fn a_part_has_the_clock_of_the_whole() {
        let whole = ramp(60);
        let part = PoseClip { frames: whole.frames[20..40].to_vec(), ..whole.clone() };
        let options = CompareOptions { same_clock: true, ..CompareOptions::default() };
        for (a, b, more) in [(&whole, &part, [40, 0]), (&part, &whole, [0, 40])] {
            let found = compare(a, b, &options);
            assert_eq!((found.hands[0].frames, found.unmatched_frames), (20, more));
            assert!(found.max_deg() < 1e-9, "{found:?}");
        }
        assert!(compare(&whole, &part, &CompareOptions::default()).max_deg() > 1.0);
    }

    #[test]
    fn nothing_to_compare_is_no_agreement() {
        let found = compare(&PoseClip::default(), &PoseClip::default(), &CompareOptions::default());
        assert!(!found.within_tolerance());
        // Nor is a hand that is lost where the other motion has it.
        let [mut one, mut other] = [ramp(20), ramp(20)];
        one.frames[10..].iter_mut().for_each(|frame| frame.valid = false);
        other.frames[..10].iter_mut().for_each(|frame| frame.valid = false);
        let found = compare(&one, &other, &CompareOptions::default());
        let hand = &found.hands[0];
        assert_eq!((hand.frames, hand.joints.len(), hand.moving_rms_deg), (0, 0, None));
        assert!(hand.fingertips_mm.is_none() && hand.wrist_mm.is_none());
        assert!(!found.within_tolerance() && found.unmatched_frames == [10, 10]);
    }
}
