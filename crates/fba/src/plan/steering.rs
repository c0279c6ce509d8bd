//! Steers the price of a bit while frames come, so that error or rate meets its aim.

use super::super::state::step;
use super::super::syntax::scale;
use super::budget::{Budget, Room};
use super::options::{PlanOptions, Target, degrees_of};
use crate::bap::{Bap, BapFrame, BapMask, PER_RADIAN, StepTable, Unit};

/// What λ, in squared degrees per bit, follows.
#[derive(Clone, Debug)]
pub(super) enum Steering {
    /// Nothing.
    Fixed(f64),
    /// The error.
    Error(ErrorAim),
    /// The rate.
    Bits(BitAim),
}

impl Steering {
    /// Steering to the aim of `options`.
    pub fn new(options: &PlanOptions) -> Self {
        let rate = options.rate.per_second();
        match options.mode {
            Target::Quant(_) => Self::Fixed(0.0),
            Target::MaxError(degrees) | Target::TipError(degrees) => Self::Fixed(0.5 * degrees * degrees),
            Target::Rms(degrees) => Self::Error(ErrorAim::new(degrees)),
            Target::Bitrate(kbit_per_s) => {
                Self::Bits(BitAim::new(kbit_per_s * 1000.0 / rate, rate, options.intra_seconds * rate))
            }
        }
    }

    /// Squared degrees a bit may cost now.
    pub fn lambda(&self) -> f64 {
        match self {
            Self::Fixed(lambda) => *lambda,
            Self::Error(aim) => aim.lambda,
            Self::Bits(aim) => aim.lambda,
        }
    }

    /// The quantiser index to change to before the next I plane is due, if the rate needs another one and has
    /// room for the I plane.
    pub fn requant(&self, options: &PlanOptions, mask: &BapMask, current: u8) -> Option<u8> {
        let Self::Bits(aim) = self else { return None };
        let quant = live_quant(options, self, mask);
        let times = f64::from(scale(quant).max(1)) / f64::from(scale(current).max(1));
        // Each change costs an I plane and new models, so it must be worth while.
        // Finer ones wait for the next I plane that is due, as their ranges must be sent anew.
        (aim.settled() && times > COARSER && aim.budget.affords(aim.intra)).then_some(quant)
    }

    /// What the next frame may cost if it is not an I plane that is due.
    pub fn room(&self) -> Room {
        match self {
            Self::Bits(aim) => aim.budget.room(),
            _ => Room::ENDLESS,
        }
    }

    /// Most that an I plane of `bits` may cost, if it is one that is due or not. If it `grows`, so do those to come.
    pub fn intra_limit(&self, bits: f64, due: bool, grows: bool) -> f64 {
        match self {
            Self::Bits(aim) if grows => aim.budget.room_if(due, bits).most,
            Self::Bits(aim) => aim.budget.room_if(due, aim.budget.intra()).limit,
            _ => f64::INFINITY,
        }
    }

    /// The rate aimed at, or 0.
    pub fn kbit_per_s(&self) -> f64 {
        if let Self::Bits(aim) = self { aim.target * aim.rate / 1000.0 } else { 0.0 }
    }

    /// Whether ranges may be sent anew out of turn.
    pub fn affords_ranges(&self) -> bool {
        match self {
            Self::Bits(aim) => aim.settled() && aim.budget.affords(RANGES * aim.intra),
            _ => true,
        }
    }

    /// Bits beyond its band that a window may cost for what is not foreseen.
    pub fn spare(&self) -> f64 {
        if let Self::Bits(aim) = self { aim.budget.spare() } else { f64::INFINITY }
    }

    /// Whether there is room for ranges out of turn at all.
    pub fn bears_ranges(&self) -> bool {
        match self {
            Self::Bits(aim) => aim.budget.bears(RANGES * aim.intra),
            _ => true,
        }
    }

    /// Takes note of what an I plane that says everything costs.
    pub fn note_complete(&mut self, bits: f64) {
        if let Self::Bits(aim) = self {
            aim.intra = bits;
        }
    }

    /// Says what the last I plane cost, and that the next one is due after `frames` more frames.
    pub fn expect_intra(&mut self, bits: u64, frames: u64) {
        if let Self::Bits(aim) = self {
            aim.budget.expect(bits as f64, aim.budget.now() + frames - 1);
        }
    }

    /// Takes in that a frame was left out for want of a pose.
    pub fn pass(&mut self) {
        if let Self::Bits(aim) = self {
            aim.budget.spend(0);
        }
    }

    /// Takes in how the last frame came out and what it cost.
    pub fn follow(&mut self, frame: &BapFrame, values: impl Fn(Bap) -> i32, bits: u64, cause: Cause) {
        match self {
            Self::Fixed(_) => {}
            Self::Error(aim) => aim.follow(frame, values),
            Self::Bits(aim) => aim.follow(bits, cause),
        }
    }
}

/// What a frame cost its bits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cause {
    /// What changed, if anything did.
    Change,
    /// An I plane: one that is due, or that says other ranges or another quantiser.
    Intra,
    /// An I plane for a leap, out of turn.
    Leap,
}

/// Sum of squares and number of values.
#[derive(Clone, Copy, Debug, Default)]
struct Average {
    sum: f64,
    count: f64,
}

impl Average {
    fn add(&mut self, sum: f64, count: f64, keep: f64) {
        self.sum = self.sum * keep + sum;
        self.count = self.count * keep + count;
    }

    fn mean(&self) -> f64 {
        if self.count > 0.0 { self.sum / self.count } else { 0.0 }
    }
}

/// λ at the start, per squared degree of the error aimed at.
const START: f64 = 0.3;
/// What the recent error keeps from frame to frame: a memory of about three seconds.
const KEEP: f64 = 0.989;
/// How fast λ follows the error: relative change per frame for an error that is far off.
const PULL: f64 = 0.05;
/// Bounds of λ over the square of the error aimed at: what is measured is the error of angles that move, and without a bound
/// a hand whose fingers rest would have its wrist as coarse as can be. Motion of fingers does with less than 1.
const BOUNDS: [f64; 2] = [1e-3, 1.0];

/// Keeps the mean square error of the angles that ever move near a target.
#[derive(Clone, Debug)]
pub(super) struct ErrorAim {
    target: f64,
    lambda: f64,
    moving: BapMask,
    /// Squared error and number of values so far, and of late.
    error: [Average; 2],
}

impl ErrorAim {
    fn new(degrees: f64) -> Self {
        let target = degrees * degrees;
        Self { target, lambda: START * target, moving: BapMask::EMPTY, error: Default::default() }
    }

    fn follow(&mut self, frame: &BapFrame, values: impl Fn(Bap) -> i32) {
        let (mut sum, mut count) = (0.0, 0.0);
        for (bap, value) in frame.iter().filter(|(bap, _)| bap.unit() == Unit::Angle) {
            if value != 0 {
                self.moving.insert(bap);
            }
            if self.moving.contains(bap) {
                sum += degrees_of(bap, i64::from(value) - i64::from(values(bap))).powi(2);
                count += 1.0;
            }
        }
        self.error[0].add(sum, count, 1.0);
        self.error[1].add(sum, count, KEEP);
        let [all, late] = self.error.map(|average| average.mean());
        let pull = 1.0 - (0.5 * (all + late)).max(all) / self.target;
        let [least, most] = BOUNDS.map(|share| share * self.target);
        self.lambda = (self.lambda * (PULL * pull).exp()).clamp(least, most);
    }
}

/// Seconds' worth of bits of room to spare below which λ grows, by up to so many powers of e: small errors then wait,
/// so that something is left for large ones.
const SCARCE: f64 = 1.0;
const PRESSURE: f64 = 1.5;
/// How much of what the scarcest window leaves each frame is aimed at, at most.
const SCARCE_EVEN: f64 = 1.15;
/// Bits of a P plane go with λ to minus this power.
const POWER: f64 = 0.31;
/// Seconds that what a motion costs is remembered for, long and short, that it is believed at the start, and over which the
/// band is steered back to its middle.
const MEMORY_SECONDS: [f64; 2] = [12.0, 3.0];
const PRIOR_SECONDS: [f64; 2] = [5.0, 1.0];
const RETURN_SECONDS: f64 = 6.0;
/// Seconds' worth of bits that are to be spared rather than spent from which on bits are scarce, and are as scarce as can be.
const SCARCE_SECONDS: [f64; 2] = [1.0, 1.4];
/// Share of the usual bits below which no quantiser is chosen for.
const LEAST_WANTED: f64 = 0.7;
/// How much lower than while something moves λ is at most where a hand rests, lest its next motion begin with all the
/// bits there are; and seconds that this is remembered for.
const REST: f64 = 2.0;
const MOVING_SECONDS: f64 = 30.0;
/// Share of the usual bits below which a hand rests, and what such frames count for.
const RESTING: f64 = 0.3;
const RESTING_WEIGHT: f64 = 0.1;
/// λ at the start for one kilobit per second.
pub(super) const FIRST_LAMBDA: f64 = 0.8;
/// Seconds of which λ of late is the mean, and how far, as a logarithm, it may be above the lasting one before the
/// quantiser follows it.
const LATE_SECONDS: f64 = 0.5;
const FAR: f64 = 2.0;
/// Ratio of steps from which on another quantiser is worth an I plane.
const COARSER: f64 = 6.0;
/// Frames from one I plane to the next change of quantiser.
const SETTLING: u32 = 60;
/// What an I plane that changes ranges costs, as a share of one that says everything.
const RANGES: f64 = 1.0;
/// Bounds of λ.
const LAMBDAS: [f64; 2] = [1e-3, 64.0];

/// Keeps λ where what moved of late would cost what a window leaves; I planes that are due are known beforehand.
#[derive(Clone, Debug)]
pub(super) struct BitAim {
    /// Bits per frame.
    target: f64,
    /// Frames per second.
    rate: f64,
    lambda: f64,
    /// λ without what scarcity adds, and as what moved in the long run asks for.
    middle: f64,
    lasting: f64,
    /// Means of its logarithm: of λ of late, and of λ without what scarcity adds while something moved.
    late: f64,
    moving: f64,
    /// Bits of a P frame of late.
    lately: f64,
    /// Bits of P planes of late as they would be at λ = 1, in a long memory and in a short one.
    activity: [Average; 2],
    /// Frames since the last I plane, and cost of the last one that said everything.
    since_intra: u32,
    intra: f64,
    budget: Budget,
}

impl BitAim {
    fn new(target: f64, rate: f64, interval: f64) -> Self {
        let kbit_per_s = target * rate / 1000.0;
        let lambda = (FIRST_LAMBDA / kbit_per_s.powi(3)).clamp(LAMBDAS[0], LAMBDAS[1]);
        Self {
            target,
            rate,
            lambda,
            middle: lambda,
            lasting: lambda,
            late: lambda.ln(),
            moving: lambda.ln(),
            lately: target,
            activity: PRIOR_SECONDS.map(|seconds| Average {
                sum: target * lambda.powf(POWER) * seconds * rate,
                count: seconds * rate,
            }),
            since_intra: 0,
            intra: 0.0,
            budget: Budget::new(target, rate, interval as u64),
        }
    }

    /// Whether the models have had time to learn since the last I plane.
    fn settled(&self) -> bool {
        self.since_intra >= SETTLING
    }

    /// The λ that a quantiser is chosen for: the lasting one, or what it has been of late if that is far above.
    fn level(&self) -> f64 {
        self.lasting.max((self.late - FAR).exp())
    }

    fn follow(&mut self, bits: u64, cause: Cause) {
        self.budget.spend(bits);
        self.budget.note_leap(if cause == Cause::Leap { bits } else { 0 });
        self.since_intra = if cause == Cause::Intra { 0 } else { self.since_intra.saturating_add(1) };
        let usual = self.budget.predicted();
        if cause == Cause::Change {
            self.lately += (bits as f64 - self.lately) / (LATE_SECONDS * self.rate);
            // A hand that rests says little about what its next motion costs.
            let weight = if self.lately < RESTING * usual { RESTING_WEIGHT } else { 1.0 };
            for (activity, seconds) in self.activity.iter_mut().zip(MEMORY_SECONDS) {
                let keep = (-weight / (seconds * self.rate)).exp();
                activity.add(weight * bits as f64 * self.lambda.powf(POWER), weight, keep);
            }
        }
        let second = self.target * self.rate;
        let room = self.budget.room();
        let [below, above] = room.slack.map(|bits| bits.clamp(-second, second));
        let wanted = usual + (above - below) / (2.0 * RETURN_SECONDS * self.rate);
        let wanted = wanted.min(SCARCE_EVEN * room.even).clamp(0.2 * usual, 2.0 * usual);
        let [long, short] = self.activity.map(|activity| (activity.mean() / wanted).max(1e-9));
        let least = self.moving.exp() / REST;
        let middle = |ratio: f64| ratio.powf(1.0 / POWER).max(least).clamp(LAMBDAS[0], LAMBDAS[1]);
        // A quantiser stays for longer than bits are scarce.
        self.lasting = middle(long * wanted / wanted.max(LEAST_WANTED * usual));
        // The scarcer bits are, the more what has been costly of late is believed to go on.
        let [from, to] = SCARCE_SECONDS.map(|seconds| seconds * second);
        let scarce = ((below - above - from) / (to - from)).clamp(0.0, 1.0);
        self.middle = middle(long * (short / long).max(1.0).powf(scarce));
        if bits > 0 {
            self.moving += (self.middle.ln() - self.moving) / (MOVING_SECONDS * self.rate);
        }
        let spare = (room.most - usual) / second;
        let pressure = PRESSURE * (1.0 - spare / SCARCE).clamp(0.0, 1.0);
        self.lambda = (self.middle * pressure.exp()).clamp(LAMBDAS[0], LAMBDAS[1]);
        self.late += (self.lambda.ln() - self.late) / (LATE_SECONDS * self.rate);
    }
}

/// λ over the squared step of a finger bend. Planning whole clips ends at 0.35; without look-ahead a finer step
/// makes less error at the same rate.
const LAMBDA_PER_STEP: f64 = 0.07;
/// Quantiser indices that are chosen live.
pub(super) const QUANTS: std::ops::RangeInclusive<u8> = 1..=31;

/// The quantiser index that goes with the aim: its step for a finger bend is in a fixed relation to the
/// error wanted, but no step among `mask` is so coarse that rounding alone breaks the bound;
/// where the rate is to be held, errors grow with the step.
pub(super) fn live_quant(options: &PlanOptions, steering: &Steering, mask: &BapMask) -> u8 {
    let degrees = match (options.mode, steering) {
        (Target::Quant(quant), _) => return quant,
        (Target::MaxError(degrees), _) => 1.2 * degrees,
        (Target::Rms(degrees), _) => 2.5 * degrees,
        (_, Steering::Bits(aim)) => (aim.level() / LAMBDA_PER_STEP).sqrt(),
        (_, Steering::Fixed(lambda)) => (lambda / LAMBDA_PER_STEP).sqrt(),
        (_, Steering::Error(aim)) => (aim.lambda / LAMBDA_PER_STEP).sqrt(),
    };
    let wanted = index_of_step(degrees, options.steps);
    if matches!(options.mode, Target::Bitrate(_)) {
        return wanted;
    }
    let coarsest = |quant: u8| {
        let angles = mask.iter().filter(|bap| bap.unit() == Unit::Angle);
        angles.map(|bap| degrees_of(bap, step(bap, options.steps, quant).into())).fold(0.0, f64::max)
    };
    (*QUANTS.start()..=wanted).rev().find(|&quant| coarsest(quant) <= 2.0 * options.bound()).unwrap_or(1)
}

/// The step of a finger bend at a quantiser index, degrees.
pub(super) fn bend_step(quant: u8, steps: StepTable) -> f64 {
    let base = Bap::from_name("r_index1_flexion").map_or(128, |bap| bap.base_step(steps));
    f64::from(base * scale(quant)) * (1.0 / PER_RADIAN).to_degrees()
}

/// The quantiser index whose step for a finger bend is nearest to `degrees`.
fn index_of_step(degrees: f64, steps: StepTable) -> u8 {
    let off = |quant: u8| (bend_step(quant, steps) / degrees).ln().abs();
    QUANTS.min_by(|&a, &b| off(a).total_cmp(&off(b))).unwrap_or(*QUANTS.start())
}
