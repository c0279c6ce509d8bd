//! Masks and ranges chosen without look-ahead.

use std::sync::LazyLock;

use super::super::super::encoder::degrees_per_unit;
use super::super::super::error::EncodeError;
use super::super::super::reach::{intra_codes, predicted_code, set_ranges};
use super::super::super::state::{Slot, step};
use super::super::super::syntax::{IntraParams, RangeCodes, RangeEnd, range_levels};
use super::super::steering::live_quant;
use super::{AMPLE, LiveEncoder};
use crate::bap::derive::companions;
use crate::bap::{BAP_COUNT, Bap, BapFrame, BapMask};

/// Degrees from which on a BAP is worth sending.
const WORTH_SENDING: f64 = 0.05;
/// What a change that left its range is multiplied with to give the next range.
const WIDENING: f64 = 1.3;
/// The same where planes are sent one by one as they come: an I plane out of turn is ten of the others, and comes late.
const WIDENING_SENT: f64 = 1.6;
/// Share of that for other BAPs of the same kind.
const KINSHIP: f64 = 0.5;
/// What the largest change seen is multiplied with when ranges are chosen anew.
const MARGIN: f64 = 1.3;
/// Share of the speeds of [`Kind::first_speed`] that is allowed for before a BAP is known, for each hand that is sent: an I
/// plane for the sake of one costs as much for the others.
const FIRST: f64 = 0.7;

/// Where the rate is to be held, share of the speeds above that is always allowed for, per kilobit per second, the least
/// it is, and share that is before a BAP is known.
const READY: f64 = 0.3;
const SLOWEST: f64 = 0.66;
const UNKNOWN: f64 = 2.5;

/// Share of the largest change of the input from frame to frame that P ranges allow for there, and of that of
/// other BAPs of the same kind.
const SPEED: f64 = 1.3;
const ALIKE: f64 = 1.0;

/// BAPs that move alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// Knuckles and middle joints.
    Bend,
    /// End joints of the fingers.
    End,
    Pivot,
    Twist,
    Other,
}

impl Kind {
    fn of(bap: Bap) -> Self {
        // By name once: it is asked for every frame.
        static KINDS: LazyLock<[Kind; BAP_COUNT]> = LazyLock::new(|| {
            std::array::from_fn(|index| Bap::from_index(index).map_or(Kind::Other, Kind::named))
        });
        KINDS[bap.index()]
    }

    fn named(bap: Bap) -> Self {
        match bap.info().map_or("", |info| info.name) {
            name if name.ends_with("3_flexion") => Self::End,
            name if name.ends_with("flexion") => Self::Bend,
            name if name.ends_with("pivot") => Self::Pivot,
            name if name.ends_with("twisting") => Self::Twist,
            _ => Self::Other,
        }
    }

    /// Degrees per second that P ranges allow for at first.
    fn first_speed(self) -> f64 {
        match self {
            Self::Bend => 390.0,
            Self::Pivot | Self::Twist => 270.0,
            Self::End => 220.0,
            Self::Other => 250.0,
        }
    }
}

/// Bits of the markers of a range array, and of each of its codes.
const ARRAY_BITS: f64 = 83.0;
const CODE_BITS: f64 = 5.0;
/// Share of the time between I planes that usually passes before one is needed for its ranges.
const LASTS: f64 = 0.7;
/// What the largest and smallest value seen are multiplied with to give an I range that serves several I planes.
const EXTENT: f64 = 1.1;
/// How far apart the values of anchors are, and how far a value is from its anchor before another one takes over.
const NEXT_ANCHOR: i32 = 254;
const FARTHEST: i32 = 1700;
/// Degrees that joints bend, bend backwards and turn, and that a wrist moves from where it was seen first (as
/// [`degrees_per_unit`] counts them).
const BENDS: f64 = 100.0;
const BACKWARDS: f64 = 20.0;
const TURNS: f64 = 40.0;
const WRIST: f64 = 40.0;

impl LiveEncoder {
    /// Widens the ranges of BAPs that outgrew them, both ways, as what goes one way comes back; and those of
    /// the other BAPs of their kind to some degree, as fingers move together.
    pub(super) fn widen(&mut self) {
        let mask = self.mask();
        let widening = if self.options.aligned { WIDENING_SENT } else { WIDENING };
        for &(bap, wanted) in &self.outgrown {
            let wide = (wanted as f64 * widening) as i64;
            let kin = (wide as f64 * KINSHIP) as i64;
            for other in mask.iter().filter(|other| Kind::of(*other) == Kind::of(bap)) {
                let reach = if other == bap { wide } else { kin };
                self.reach.note(other, reach);
                self.reach.note(other, -reach);
            }
        }
    }

    /// The BAPs that an I plane should switch on.
    pub(super) fn wanted_mask(&mut self, frame: &BapFrame) -> BapMask {
        for (bap, value) in frame.iter() {
            // Where the rate is to be held, there may be no room to switch a BAP on later.
            if self.steering.kbit_per_s() >= AMPLE
                || self.options.off(bap, value.into()).abs() > WORTH_SENDING
            {
                self.worthy.insert(bap);
            }
        }
        if self.sparse && !self.holds_rate() {
            let places =
                frame.mask.iter().filter(|bap| bap.is_extension() && !self.options.anchors.contains(*bap));
            self.worthy = self.worthy.union(&fingers_of(&self.worthy)).union(&places.collect());
        }
        for limb in self.options.limbs {
            let of_limb = frame.mask.intersection(limb).difference(&self.options.anchors);
            if of_limb.intersection(&self.worthy).is_empty() {
                of_limb.iter().take(1).for_each(|bap| self.worthy.insert(bap));
            }
        }
        match self.sparse {
            true => frame.mask.intersection(&self.worthy).union(&companions(
                self.options.ties,
                &frame.mask,
                &self.worthy,
            )),
            false => frame.mask,
        }
    }

    /// Quantiser and all ranges anew, for the BAPs of `mask`.
    pub(super) fn complete_params(
        &mut self,
        frame: &BapFrame,
        mask: BapMask,
    ) -> Result<IntraParams, EncodeError> {
        let quant = live_quant(&self.options, &self.steering, &mask);
        let mut params = IntraParams { quant, mask, ..IntraParams::default() };
        set_ranges(&mut params, frame, self.options.steps, |bap| self.wanted_reach(frame, bap, quant))?;
        if self.lasting() || self.leapt {
            self.widen_intra(&mut params, frame)?;
        }
        if self.lasting() {
            self.keep_arrays(&mut params, frame)?;
        }
        if mask.is_empty() {
            params.ranges = [Some([0; BAP_COUNT]); 4];
        }
        Ok(params)
    }

    /// Hands of which joints are sent, or 1.
    fn hands(&self) -> f64 {
        let moving = FINGERS.iter().filter(|fingers| !fingers.intersection(&self.worthy).is_empty());
        moving.count().max(1) as f64
    }

    /// Whether ranges are to serve several I planes: where no decoder is to start at any of them.
    pub(super) fn lasting(&self) -> bool {
        self.sparse && !self.options.resync && !self.holds_rate()
    }

    /// Takes note of the largest and smallest values of each BAP.
    pub(super) fn note_extent(&mut self, frame: &BapFrame) {
        for (bap, value) in frame.iter() {
            let [max, min] = &mut self.extent[bap.index()];
            (*max, *min) = ((*max).max(value), (*min).min(value));
        }
    }

    /// Widens I ranges so that they hold what has been seen, with a margin, and what hands usually need.
    fn widen_intra(&self, params: &mut IntraParams, frame: &BapFrame) -> Result<(), EncodeError> {
        let (steps, quant) = (self.options.steps, params.quant);
        for bap in params.mask.iter() {
            let value = frame.value(bap);
            let extent = self.extent[bap.index()];
            let (span, usual) = if self.options.anchors.contains(bap) {
                // The next one is not far.
                (extent, [extent[0] + NEXT_ANCHOR, extent[1] - NEXT_ANCHOR])
            } else if self.leapt && bap.is_extension() {
                (extent, [FARTHEST, -FARTHEST])
            } else {
                (extent.map(|most| (EXTENT * f64::from(most)) as i32), usual_extent(bap, value))
            };
            for (end, reach) in span.into_iter().zip(usual).enumerate() {
                let sign = if end == 0 { 1 } else { -1 };
                let toward = |reach: i32| reach.saturating_mul(sign);
                let wide = toward(reach.0).max(toward(reach.1)).max(0);
                // One that no I plane carries is not wanted.
                let Ok(wide) = intra_codes(bap, sign * wide, steps, quant) else { continue };
                if let Some(codes) = &mut params.ranges[end] {
                    codes[bap.index()] = codes[bap.index()].max(wide[end]);
                }
            }
        }
        Ok(())
    }

    /// Leaves out the arrays for which those in force will do, where these cost less than sending new ones.
    fn keep_arrays(&self, params: &mut IntraParams, frame: &BapFrame) -> Result<(), EncodeError> {
        let layout = self.out.writer.layout();
        if self.out.planes() == 0 || layout.quant() != params.quant || layout.mask() != params.mask {
            return Ok(());
        }
        let planes = self.usual_planes();
        let mut waste = [-ARRAY_BITS; 4];
        for slot in layout.slots() {
            let needed = self.needed_codes(frame, slot.bap, params.quant)?;
            let known = in_force(slot);
            for end in 0..4 {
                let Some(codes) = &params.ranges[end] else { continue };
                let wanted = range_levels(codes[slot.bap.index()], params.quant);
                let [old, new] = [known[end], wanted].map(|levels| f64::from(levels + known[end ^ 1] + 1));
                let wider =
                    if end < 2 { (old / new).log2() } else { spread(planes, old) - spread(planes, new) };
                let holds = range_levels(needed[end], params.quant) <= known[end];
                waste[end] += if holds { wider - CODE_BITS } else { f64::INFINITY };
            }
        }
        for (codes, waste) in params.ranges.iter_mut().zip(waste) {
            *codes = codes.filter(|_| waste >= 0.0);
        }
        Ok(())
    }

    /// P planes that ranges usually serve.
    fn usual_planes(&self) -> f64 {
        let sent = self.out.planes() as f64 / self.out.frames().max(1) as f64;
        LASTS * self.interval as f64 * sent.min(1.0)
    }

    /// The least range codes that hold a value, and the changes seen.
    fn needed_codes(&self, frame: &BapFrame, bap: Bap, quant: u8) -> Result<[u8; 4], EncodeError> {
        let steps = self.options.steps;
        let [max, min] = intra_codes(bap, frame.value(bap), steps, quant)?;
        if self.options.anchors.contains(bap) {
            return Ok([max, min, 0, 0]);
        }
        let [up, down] = self.reach.seen(bap).map(|reach| predicted_code(bap, reach, steps, quant));
        Ok([max, min, up, down])
    }

    /// What P ranges should reach, upwards and downwards.
    fn wanted_reach(&self, frame: &BapFrame, bap: Bap, quant: u8) -> [i32; 2] {
        let first = Kind::of(bap).first_speed() / self.options.rate.per_second();
        if self.options.anchors.contains(bap) {
            return [0; 2];
        }
        let first = (first / self.options.degrees(bap)) as i32;
        let step = step(bap, self.options.steps, quant);
        let known = self.reach.knows(bap);
        let seen = self.reach.seen(bap).map(|reach| (f64::from(reach) * MARGIN) as i32);
        if self.holds_rate() {
            // There may be no room for other ranges until the next I plane is due, but wide ones cost much.
            let rests = frame.value(bap) == 0;
            let share =
                if known || rests { (READY * self.steering.kbit_per_s()).max(SLOWEST) } else { UNKNOWN };
            let least = step.max((share * f64::from(first)) as i32);
            let mask = self.mask();
            let kin = mask.iter().filter(|other| Kind::of(*other) == Kind::of(bap));
            let kin = kin.flat_map(|other| self.reach.seen(other)).max().unwrap_or(0);
            let least = least.max((ALIKE * f64::from(kin)) as i32);
            return self.reach.seen(bap).map(|speed| ((SPEED * f64::from(speed)) as i32).max(least));
        }
        let first = (FIRST * self.hands() * f64::from(first)) as i32;
        seen.map(|reach| reach.max(if known { step } else { first.max(step) }))
    }

    /// The quantiser, and only the range arrays in which a BAP outgrew its code; those are renewed as a
    /// whole.
    pub(super) fn changed_params(&self, frame: &BapFrame, quant: u8) -> Result<IntraParams, EncodeError> {
        let mask = self.mask();
        let mut params = IntraParams { quant, mask, ..IntraParams::default() };
        let steps = self.options.steps;
        let mut wanted: [RangeCodes; 4] = [[0; BAP_COUNT]; 4];
        let mut outgrown = [false; 4];
        let (planes, coarser) = (self.usual_planes(), quant > self.quant());
        let mut waste = [-ARRAY_BITS; 4];
        for slot in self.out.writer.layout().slots() {
            let bap = slot.bap;
            let needed = self.needed_codes(frame, bap, quant)?;
            let reach =
                self.wanted_reach(frame, bap, quant).map(|reach| predicted_code(bap, reach, steps, quant));
            let codes = [needed[0], needed[1], reach[0], reach[1]];
            // What persists are levels: a coarser quantiser makes them reach further.
            let known = in_force(slot);
            for end in RangeEnd::ALL.map(|end| end as usize) {
                wanted[end][bap.index()] = codes[end];
                outgrown[end] |= known[end] < range_levels(needed[end], quant);
                if coarser && end >= 2 {
                    let [old, new] = [known[end], range_levels(codes[end], quant)]
                        .map(|levels| f64::from(levels + known[end ^ 1] + 1));
                    waste[end] += spread(planes, old) - spread(planes, new) - CODE_BITS;
                }
            }
        }
        // Those that reach much too far cost more than new ones.
        outgrown.iter_mut().zip(waste).for_each(|(outgrown, waste)| *outgrown |= waste > 0.0);
        for (range, (codes, outgrown)) in params.ranges.iter_mut().zip(wanted.into_iter().zip(outgrown)) {
            *range = outgrown.then_some(codes);
        }
        if self.lasting() || self.leapt {
            self.widen_intra(&mut params, frame)?;
        }
        Ok(params)
    }
}

/// The joints of the hands of which a finger joint is among `moving`, but for the bends of the palm, which many hands
/// keep still: to switch one on later takes an I plane with all ranges.
fn fingers_of(moving: &BapMask) -> BapMask {
    let moves = FINGERS.iter().filter(|fingers| !fingers.intersection(moving).is_empty());
    moves.fold(BapMask::EMPTY, |all, fingers| all.union(fingers))
}

/// The finger joints of each side, without the bends of the palm.
static FINGERS: LazyLock<[BapMask; 2]> =
    LazyLock::new(|| ["l", "r"].map(|side| Bap::all().filter(|bap| finger(*bap) == Some(side)).collect()));

/// The side of a finger joint that is no bend of the palm.
fn finger(bap: Bap) -> Option<&'static str> {
    let (side, joint) = bap.info()?.name.split_once('_')?;
    let of_finger = ["thumb", "index", "middle", "ring", "pinky"].iter().any(|name| joint.starts_with(name));
    (of_finger && !joint.ends_with("0_flexion")).then_some(side)
}

/// Levels that the ranges in force reach to, as magnitudes, by [`RangeEnd`].
fn in_force(slot: &Slot) -> [i32; 4] {
    [slot.intra[1], -slot.intra[0], slot.predicted[1], -slot.predicted[0]]
}

/// Bits of an adaptive model with so many symbols for `total` of them in all, as far as they depend on the number of
/// symbols: the logarithm of `(total + symbols − 1)! / (symbols − 1)!`, by Stirling's formula.
fn spread(total: f64, symbols: f64) -> f64 {
    let factorial =
        |n: f64| if n < 1.0 { 0.0 } else { n * (n / std::f64::consts::E).log2() + 0.5 * n.log2() + 1.325 };
    factorial(total + symbols - 1.0) - factorial(symbols - 1.0)
}

/// Largest and smallest value that a BAP usually comes to when it has one.
fn usual_extent(bap: Bap, value: i32) -> [i32; 2] {
    let around = |degrees: f64| {
        let units = (degrees / degrees_per_unit(bap)) as i32;
        [units, -units]
    };
    let bend = bap.info().is_some_and(|info| info.name.ends_with("flexion"));
    match Kind::of(bap) {
        Kind::Bend | Kind::End if bend && bap.intra_limits()[0] < -bap.intra_limits()[1] => {
            [around(BACKWARDS)[0], around(BENDS)[1]]
        }
        Kind::Bend | Kind::End if bend && bap.intra_limits()[1] > -bap.intra_limits()[0] => {
            [around(BENDS)[0], around(BACKWARDS)[1]]
        }
        Kind::Bend | Kind::End => around(BENDS),
        Kind::Pivot | Kind::Twist => around(TURNS),
        Kind::Other => around(WRIST).map(|units| value.saturating_add(units)),
    }
}
