//! What a live stream comes to when packets of it are lost on the way.

use std::fmt;

use handcast_codec::mapping::Profile;
use handcast_codec::packets::{Arrival, Packer, Unpacker};
use handcast_codec::{
    PoseDecoder, PoseDecoderOptions, PoseEncoder, PosesToStreamError, Shown, StreamToPosesError, clip_rate,
    poses_on_ticks,
};
use handcast_fba::DecoderOptions;
use handcast_fba::plan::PlanOptions;
use handcast_hand::random::Random;
use handcast_hand::{JointAngle, PoseClip, Side, TimedPose};
use serde::Serialize;
use thiserror::Error;

/// How packets are lost.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct LossOptions {
    /// Share of packets that are lost, 0 to 1.
    pub share: f64,
    /// Mean number of packets that are lost in a row, 1 or more: a two-state chain (Gilbert 1960). 1 loses each
    /// on its own.
    pub burst: f64,
    /// Runs, each with losses of its own.
    pub seeds: u64,
    /// Distances of the copies that each packet has of earlier ones, packets ([`Packer`]); `None` for a transport that
    /// does not number packets, and sends none where there is nothing to say: gaps show by what values betray.
    pub copies: Option<Vec<u8>>,
    /// Packets that a parity is of ([`Packer::with_parity`]), where packets are numbered; 0 for none.
    pub parity: u8,
    /// Where position and rotation of a hand travel.
    pub profile: Profile,
    /// How the stream is made; always frame by frame.
    pub plan: PlanOptions,
}

impl Default for LossOptions {
    /// 5 % of packets, each on its own, 50 runs; each packet has a copy of the one before; an I plane every second with a
    /// start code.
    fn default() -> Self {
        let plan = PlanOptions { live: true, resync: true, intra_seconds: 1.0, ..PlanOptions::default() };
        let copies = Some(vec![1]);
        Self { share: 0.05, burst: 1.0, seeds: 50, copies, parity: 0, profile: Profile::Hand, plan }
    }
}

impl LossOptions {
    /// Sets the share of packets that are lost, 0 to 1.
    #[must_use]
    pub fn with_share(self, share: f64) -> Self {
        Self { share, ..self }
    }

    /// Sets the mean number of packets that are lost in a row.
    #[must_use]
    pub fn with_burst(self, burst: f64) -> Self {
        Self { burst, ..self }
    }

    /// Sets the number of runs.
    #[must_use]
    pub fn with_seeds(self, seeds: u64) -> Self {
        Self { seeds, ..self }
    }

    /// Sets which copies packets have, or that they are not numbered.
    #[must_use]
    pub fn with_copies(self, copies: Option<Vec<u8>>) -> Self {
        Self { copies, ..self }
    }

    /// Sets of how many packets there is a parity; 0 for none.
    #[must_use]
    pub fn with_parity(self, parity: u8) -> Self {
        Self { parity, ..self }
    }

    /// Sets where position and rotation of a hand travel.
    #[must_use]
    pub fn with_profile(self, profile: Profile) -> Self {
        Self { profile, ..self }
    }

    /// Sets how the stream is made.
    #[must_use]
    pub fn with_plan(self, plan: PlanOptions) -> Self {
        Self { plan, ..self }
    }
}

/// Why losses could not be measured.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum LossError {
    /// A number is out of range.
    #[error("loss: {what} is {value}, allowed is {allowed}")]
    Option {
        /// Which.
        what: &'static str,
        /// The number.
        value: f64,
        /// What is allowed.
        allowed: &'static str,
    },
    /// The poses became no stream.
    #[error(transparent)]
    Encode(#[from] PosesToStreamError),
    /// The stream became no poses.
    #[error(transparent)]
    Decode(#[from] StreamToPosesError),
}

/// What was shown in all runs, against what is shown without losses.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LossReport {
    /// Share of packets asked to be lost, and mean number in a row.
    pub share: f64,
    /// Mean number of packets lost in a row, as asked for.
    pub burst: f64,
    /// Distances of the copies in each packet, where packets are numbered.
    pub copies: Option<Vec<u8>>,
    /// Packets that a parity is of; 0 for none.
    pub parity: u8,
    /// Runs.
    pub seeds: u64,
    /// Ticks of all runs.
    pub frames: u64,
    /// Packets sent in all runs: one a tick, but where they are not numbered none for a tick that made no whole byte.
    pub packets: u64,
    /// Packets lost.
    pub lost: u64,
    /// Rate of the stream, kilobits per second.
    pub kbit_per_s: f64,
    /// Rate of the packets with their numbers and copies, without what carries them.
    pub packets_kbit_per_s: f64,
    /// I planes a second.
    pub intra_per_s: f64,
    /// Share of ticks that show a hand more than [`WRONG_DEG`] or [`WRONG_MM`] from what is shown without losses, at
    /// that tick or the one before (a frame that is a tick late is not wrong).
    pub wrong_share: f64,
    /// Share of the wrong ones that are not marked as held; `None` where none is wrong.
    pub wrong_unmarked_share: Option<f64>,
    /// Share of ticks that are marked.
    pub marked_share: f64,
    /// Stretches of ticks that are wrong or marked.
    pub stretches: u64,
    /// Their lengths; `None` where there are none.
    pub recovery_s: Option<Recovery>,
    /// Root mean square error of the joint angles over all ticks, degrees.
    pub rms_deg: f64,
    /// The same over ticks that are wrong; `None` where none is.
    pub wrong_rms_deg: Option<f64>,
    /// Largest root mean square error of a joint over all ticks, degrees.
    pub worst_joint_rms_deg: f64,
    /// Largest error of a joint of a wrong hand that is shown unmarked, degrees; `None` where none is.
    pub unmarked_max_deg: Option<f64>,
    /// Farthest a wrist moves from tick to tick, metres.
    pub wrist_leap_m: f64,
    /// The same without losses.
    pub lossless_leap_m: f64,
}

/// How long stretches of ticks are that are wrong or marked, seconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Recovery {
    /// The one in the middle.
    pub median: f64,
    /// What 95 of 100 do not exceed.
    pub p95: f64,
}

/// Degrees of a joint beyond which a shown pose is wrong.
pub const WRONG_DEG: f64 = 2.0;
/// Millimetres of the wrist beyond which it is.
pub const WRONG_MM: f64 = 10.0;

/// What is shown at a tick, left and right.
type Tick = [Option<TimedPose>; 2];

/// Sends the poses of `clip` live through a channel that loses packets, one for each tick that makes bytes, and measures
/// what is shown at each tick ([`Shown`]).
///
/// # Errors
/// See [`LossError`].
pub fn loss(clip: &PoseClip, options: &LossOptions) -> Result<LossReport, LossError> {
    check("share of packets", options.share, 0.0..=0.9, "0 to 0.9")?;
    check("packets in a row", options.burst, 1.0..=1000.0, "1 to 1000")?;
    check("runs", options.seeds as f64, 1.0..=1e6, "1 to a million")?;
    let (packets, mut report) = sent(clip, options)?;
    let rate = clip_rate(clip);
    let truth = received(&packets, &mut std::iter::repeat(false), options, rate)?;
    report.lossless_leap_m = leap(&truth);
    let mut sums = Sums::default();
    for seed in 0..options.seeds {
        let mut drops = Drops::new(seed, options.share, options.burst);
        let shown = received(&packets, &mut drops, options, rate)?;
        report.lost += drops.lost;
        report.wrist_leap_m = report.wrist_leap_m.max(leap(&shown));
        sums.add(&truth, &shown);
    }
    report.packets = options.seeds * packets.iter().filter(|packet| !packet.is_empty()).count() as u64;
    sums.report(&mut report, rate);
    Ok(report)
}

fn check(
    what: &'static str,
    value: f64,
    range: std::ops::RangeInclusive<f64>,
    allowed: &'static str,
) -> Result<(), LossError> {
    if range.contains(&value) { Ok(()) } else { Err(LossError::Option { what, value, allowed }) }
}

/// The bytes of each tick.
fn sent(clip: &PoseClip, options: &LossOptions) -> Result<(Vec<Vec<u8>>, LossReport), LossError> {
    let plan = PlanOptions { live: true, ..options.plan };
    let mut encoder = PoseEncoder::for_clip(clip, options.profile, &plan)?;
    let rate = encoder.rate();
    let mut packets: Vec<Vec<u8>> = Vec::new();
    let mut last = f64::NEG_INFINITY;
    for pose in poses_on_ticks(clip, rate, 0.0) {
        if pose.time > last + 0.5 / rate {
            packets.push(Vec::new());
            last = pose.time;
        }
        if let Some(packet) = packets.last_mut() {
            packet.extend(encoder.push(&pose)?);
        }
    }
    let end = encoder.finish()?;
    // The last bits of a plane may wait for the next one.
    if let Some(packet) = packets.last_mut() {
        packet.extend(end.bytes);
    }
    if let Some(distances) = &options.copies {
        let mut packer = Packer::new(distances).with_parity(options.parity);
        packets.iter_mut().for_each(|packet| *packet = packer.pack(packet));
    }
    let bits = packets.iter().map(|packet| packet.len() as f64 * 8.0).sum::<f64>();
    let report = LossReport {
        share: options.share,
        burst: options.burst,
        copies: options.copies.clone(),
        parity: options.parity,
        seeds: options.seeds,
        kbit_per_s: end.report.kbit_per_s(),
        packets_kbit_per_s: bits / 1000.0 / end.report.seconds.max(1e-9),
        intra_per_s: end.report.intra_planes as f64 / end.report.seconds.max(1e-9),
        ..LossReport::default()
    };
    Ok((packets, report))
}

/// What is shown at each tick when the packets for which `drops` gives true are lost.
fn received(
    packets: &[Vec<u8>],
    drops: &mut dyn Iterator<Item = bool>,
    options: &LossOptions,
    rate: f64,
) -> Result<Vec<Tick>, LossError> {
    let concealing = DecoderOptions { conceal: true, ..DecoderOptions::default() };
    let mut decoder = PoseDecoder::new(PoseDecoderOptions::default().with_decoder(concealing));
    let farthest = options.copies.iter().flatten().copied().fold(options.parity, u8::max);
    let mut unpacker = options.copies.as_ref().map(|_| Unpacker::new(farthest));
    let mut shown = Shown::default();
    let mut ticks = Vec::with_capacity(packets.len());
    for packet in packets {
        let mut poses = Vec::new();
        let dropped = !packet.is_empty() && drops.next().unwrap_or(false);
        match &mut unpacker {
            _ if dropped => {}
            None => poses.extend(decoder.push(packet)?),
            Some(unpacker) => {
                for arrival in unpacker.take(packet) {
                    poses.extend(match arrival {
                        Arrival::Gap => decoder.lose()?,
                        Arrival::Bytes(bytes) => decoder.push(&bytes)?,
                    });
                }
            }
        }
        // A packet comes at each tick where they are numbered: that one is missing is known at once.
        let missing = unpacker.as_ref().is_some_and(|unpacker| dropped || unpacker.is_waiting());
        shown.at(1.0 / rate, poses, missing || decoder.is_lost()).for_each(drop);
        ticks.push([Side::Left, Side::Right].map(|side| shown.hand(side).cloned()));
    }
    Ok(ticks)
}

/// Which packets are lost.
struct Drops {
    random: Random,
    bad: bool,
    /// Chances to begin and to end a row of lost packets.
    chances: [f64; 2],
    lost: u64,
}

impl Drops {
    fn new(seed: u64, share: f64, burst: f64) -> Self {
        // Rows of one by chance are those of a chain that forgets.
        let end = if burst > 1.0 { 1.0 / burst } else { 1.0 - share };
        let begin = end * share / (1.0 - share);
        Self { random: Random::new(seed, 0), bad: false, chances: [begin, end], lost: 0 }
    }
}

impl Iterator for Drops {
    type Item = bool;

    fn next(&mut self) -> Option<bool> {
        let [begin, end] = self.chances;
        let chance = f64::from(self.random.range(0.0, 1.0));
        self.bad = if self.bad { chance >= end } else { chance < begin };
        self.lost += u64::from(self.bad);
        Some(self.bad)
    }
}

/// Farthest a wrist moves from tick to tick, metres.
fn leap(ticks: &[Tick]) -> f64 {
    let steps = ticks.windows(2).flat_map(|pair| {
        let hand = |side: usize| pair[0][side].as_ref().zip(pair[1][side].as_ref());
        [hand(0), hand(1)].into_iter().flatten()
    });
    steps.map(|(a, b)| (b.pose.translation - a.pose.translation).norm()).fold(0.0, f64::max)
}

/// What the runs add up to.
#[derive(Default)]
struct Sums {
    frames: u64,
    marked: u64,
    wrong: u64,
    unmarked: u64,
    /// Lengths of stretches, ticks.
    stretches: Vec<u32>,
    /// Squared degrees of each angle, over all ticks with a hand; of all of them over the wrong ones.
    squares: [f64; JointAngle::ALL.len()],
    wrong_squares: f64,
    hands: u64,
    wrong_hands: u64,
    unmarked_max: Option<f64>,
}

impl Sums {
    fn add(&mut self, truth: &[Tick], shown: &[Tick]) {
        let mut stretch = 0;
        for (number, (truth_here, shown)) in truth.iter().zip(shown).enumerate() {
            let before = &truth[number.saturating_sub(1)];
            let (mut marked, mut wrong) = (false, false);
            for side in 0..2 {
                let Some(wanted) = &truth_here[side] else { continue };
                let Some(found) = &shown[side] else {
                    // Nothing to be seen yet is no wrong hand.
                    marked = true;
                    continue;
                };
                let late = before[side].as_ref().is_some_and(|wanted| !is_wrong(wanted, found));
                let hand_wrong = is_wrong(wanted, found) && !late;
                self.note(wanted, found, hand_wrong);
                marked |= !found.valid;
                wrong |= hand_wrong;
            }
            self.frames += 1;
            self.marked += u64::from(marked);
            self.wrong += u64::from(wrong);
            self.unmarked += u64::from(wrong && !marked);
            if marked || wrong {
                stretch += 1;
            } else if stretch > 0 {
                self.stretches.push(std::mem::take(&mut stretch));
            }
        }
        if stretch > 0 {
            self.stretches.push(stretch);
        }
    }

    fn note(&mut self, wanted: &TimedPose, found: &TimedPose, wrong: bool) {
        self.hands += 1;
        self.wrong_hands += u64::from(wrong);
        for (square, angle) in self.squares.iter_mut().zip(JointAngle::ALL) {
            let off = (wanted.pose.angle(angle) - found.pose.angle(angle)).to_degrees();
            *square += off * off;
            self.wrong_squares += if wrong { off * off } else { 0.0 };
            if found.valid && wrong {
                self.unmarked_max = Some(self.unmarked_max.map_or(off.abs(), |most| most.max(off.abs())));
            }
        }
    }

    fn report(mut self, report: &mut LossReport, rate: f64) {
        self.stretches.sort_unstable();
        let quantile = |share: f64| {
            let at = (share * self.stretches.len().saturating_sub(1) as f64).round() as usize;
            self.stretches.get(at).map(|&ticks| f64::from(ticks) / rate)
        };
        let ratio = |a: u64, b: u64| a as f64 / b.max(1) as f64;
        let root = |sum: f64, count: u64| (sum / count.max(1) as f64).sqrt();
        // Angles that are never off are not averaged in.
        let moving: Vec<f64> = self.squares.iter().copied().filter(|&square| square > 0.0).collect();
        let angles = moving.len().max(1) as u64;
        report.frames = self.frames;
        report.wrong_share = ratio(self.wrong, self.frames);
        report.wrong_unmarked_share = (self.wrong > 0).then(|| ratio(self.unmarked, self.wrong));
        report.marked_share = ratio(self.marked, self.frames);
        report.stretches = self.stretches.len() as u64;
        report.recovery_s = quantile(0.5).zip(quantile(0.95)).map(|(median, p95)| Recovery { median, p95 });
        report.rms_deg = root(moving.iter().fold(0.0, |sum, square| sum + square), self.hands * angles);
        report.wrong_rms_deg =
            (self.wrong_hands > 0).then(|| root(self.wrong_squares, self.wrong_hands * angles));
        report.worst_joint_rms_deg = root(moving.iter().copied().fold(0.0, f64::max), self.hands);
        report.unmarked_max_deg = self.unmarked_max;
    }
}

fn is_wrong(wanted: &TimedPose, found: &TimedPose) -> bool {
    let off = |angle| (wanted.pose.angle(angle) - found.pose.angle(angle)).abs().to_degrees();
    let moved = (wanted.pose.translation - found.pose.translation).norm() * 1000.0;
    moved > WRONG_MM || JointAngle::ALL.into_iter().any(|angle| off(angle) > WRONG_DEG)
}

impl fmt::Display for LossReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let percent = |share: f64| 100.0 * share;
        let mut packets = match self.copies.as_deref() {
            None => "unnumbered packets".to_owned(),
            Some([]) => "numbered packets".to_owned(),
            Some(copies) => format!("numbered packets with copies of those {copies:?} before"),
        };
        if self.parity > 0 && self.copies.is_some() {
            packets += &format!(", a parity of each {}", self.parity);
        }
        writeln!(
            f,
            "loss of {:.1} % in rows of {:.1}, {packets}, {} runs: {} of {} packets lost",
            percent(self.share),
            self.burst,
            self.seeds,
            self.lost,
            self.packets
        )?;
        writeln!(
            f,
            "  stream      {:.2} kbit/s, packets {:.2} kbit/s, {:.2} I planes a second",
            self.kbit_per_s, self.packets_kbit_per_s, self.intra_per_s
        )?;
        writeln!(
            f,
            "  wrong       {:.2} % of frames{}; {:.1} % of frames marked",
            percent(self.wrong_share),
            self.wrong_unmarked_share.map_or_else(String::new, |share| {
                let most =
                    self.unmarked_max_deg.map_or_else(String::new, |most| format!(" (up to {most:.1}°)"));
                format!(", {:.2} % of the wrong ones unmarked{most}", percent(share))
            }),
            percent(self.marked_share)
        )?;
        match self.recovery_s {
            Some(Recovery { median, p95 }) => writeln!(
                f,
                "  recovery    {median:.2} s (median), {p95:.2} s (95 %), {} stretches",
                self.stretches
            )?,
            None => writeln!(f, "  recovery    –: no frame is wrong or marked")?,
        }
        let wrong =
            self.wrong_rms_deg.map_or_else(String::new, |rms| format!(", {rms:.2}° over wrong frames"));
        writeln!(
            f,
            "  shown       {:.2}° RMS{wrong}, {:.2}° the worst joint",
            self.rms_deg, self.worst_joint_rms_deg
        )?;
        writeln!(
            f,
            "  wrist       {:.3} m at most from frame to frame, {:.3} m without losses",
            self.wrist_leap_m, self.lossless_leap_m
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::{HandPose, PoseHeader};
    use nalgebra::{UnitQuaternion, Vector3};

    fn clip() -> PoseClip {
        let pose =
            |n: usize| {
                let t = n as f64 / 30.0;
                let mut pose = HandPose::neutral(Side::Right);
                for (k, angle) in JointAngle::ALL.into_iter().enumerate().filter(|(_, angle)| {
                    angle.name().ends_with("flexion") && !angle.name().starts_with("thumb")
                }) {
                    pose.set(angle, 0.25 + 0.2 * (2.0 * t + k as f64).sin());
                }
                pose.translation = Vector3::new(0.2 * t.sin(), 0.0, -0.5);
                pose.rotation = UnitQuaternion::from_euler_angles(0.0, 0.3 * t.sin(), 0.0);
                TimedPose::new(t, pose)
            };
        let header = PoseHeader::one(Side::Right, None, Some(30.0));
        PoseClip { header, frames: (0..240).map(pose).collect() }
    }

    #[test]
    fn without_losses_nothing_is_wrong() {
        for copies in [None, Some(vec![]), Some(vec![1, 3])] {
            let options = LossOptions::default().with_share(0.0).with_seeds(1).with_copies(copies);
            let report = loss(&clip(), &options).unwrap();
            assert_eq!((report.lost, report.wrong_share, report.rms_deg), (0, 0.0, 0.0));
            assert_eq!(report.wrist_leap_m, report.lossless_leap_m);
            // What there is none of has no numbers.
            assert_eq!((report.wrong_unmarked_share, report.wrong_rms_deg), (None, None));
            assert_eq!((report.unmarked_max_deg, report.stretches), (None, 0));
            assert!(report.recovery_s.is_none() && report.to_string().contains("recovery    –"), "{report}");
        }
    }

    #[test]
    fn losses_are_marked_and_copies_make_up_for_them() {
        let options = LossOptions::default().with_seeds(10);
        let measured = |options: &LossOptions| loss(&clip(), options).unwrap();
        let median = |report: &LossReport| report.recovery_s.unwrap().median;
        let [bare, copied] =
            [vec![], vec![1]].map(|copies| measured(&options.clone().with_copies(Some(copies))));
        assert_eq!(bare.lost, copied.lost);
        assert!(bare.lost > 60 && bare.wrong_share > 0.2, "{bare:?}");
        for report in [&bare, &copied] {
            assert_eq!(report.wrong_unmarked_share, Some(0.0), "{report:?}");
            assert!(report.wrist_leap_m < 0.2, "{report:?}");
        }
        assert!(median(&copied) <= 0.5 && copied.wrong_share < bare.wrong_share / 4.0, "{copied:?}");
        let parity = measured(&options.clone().with_copies(Some(vec![])).with_parity(6));
        assert!(median(&parity) <= 0.5 && parity.wrong_share < bare.wrong_share / 2.0, "{parity:?}");
        assert!(parity.packets_kbit_per_s < copied.packets_kbit_per_s, "{parity:?}");
        assert_eq!(parity.wrong_unmarked_share, Some(0.0), "{parity:?}");
        let bursts = measured(&options.clone().with_burst(4.0).with_copies(Some(vec![1, 5])));
        assert!(median(&bursts) <= 0.5 && bursts.wrong_unmarked_share == Some(0.0), "{bursts:?}");
        // Where nothing numbers packets, values betray most of it.
        let unnumbered = measured(&options.with_copies(None));
        assert!(
            unnumbered.wrong_unmarked_share < Some(0.1) && unnumbered.wrist_leap_m < 0.2,
            "{unnumbered:?}"
        );
    }

    #[test]
    fn losses_come_as_often_and_in_such_rows_as_asked() {
        for (share, burst) in [(0.05, 1.0), (0.05, 4.0), (0.3, 2.5)] {
            let mut drops = Drops::new(3, share, burst);
            let lost: Vec<bool> = drops.by_ref().take(100_000).collect();
            let rows = lost.chunk_by(|a, b| a == b).filter(|row| row[0]).count() as f64;
            assert!((drops.lost as f64 / 1e5 / share - 1.0).abs() < 0.1, "{share}: {}", drops.lost);
            // Rows of single losses run into each other by chance.
            let expected = if burst > 1.0 { burst } else { 1.0 / (1.0 - share) };
            assert!((drops.lost as f64 / rows / expected - 1.0).abs() < 0.1, "{burst}");
        }
    }

    #[test]
    fn options_are_checked() {
        for options in [
            LossOptions::default().with_share(f64::NAN),
            LossOptions::default().with_burst(0.5),
            LossOptions::default().with_seeds(0),
        ] {
            assert!(matches!(loss(&clip(), &options), Err(LossError::Option { .. })));
        }
    }
}
