//! Masks and ranges chosen without look-ahead.

use super::super::super::error::EncodeError;
use super::super::super::reach::{intra_codes, predicted_code, set_ranges};
use super::super::super::state::step;
use super::super::super::syntax::{IntraParams, RangeCodes, RangeEnd, range_levels};
use super::super::steering::live_quant;
use super::LiveEncoder;
use crate::bap::derive::companions;
use crate::bap::{BAP_COUNT, Bap, BapFrame, BapMask};

/// Kilobits per second from which on all BAPs are switched on at once.
const AMPLE: f64 = 2.0;
/// Degrees from which on a BAP is worth sending.
const WORTH_SENDING: f64 = 0.05;
/// What a change that left its range is multiplied with to give the next range.
const WIDENING: f64 = 1.5;
/// Share of that for other BAPs of the same kind.
const KINSHIP: f64 = 0.4;
/// What the largest change seen is multiplied with when ranges are chosen anew.
const MARGIN: f64 = 1.3;

/// Where the rate is to be held, share of the speeds above that is always allowed for, per kilobit per second, and
/// share that is before a BAP is known.
const READY: f64 = 0.9;
const UNKNOWN: f64 = 2.5;

/// Share of the largest change of the input from frame to frame that P ranges allow for there, and of that of
/// other BAPs of the same kind.
const SPEED: f64 = 1.3;
const ALIKE: f64 = 0.7;

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
            Self::Other => 110.0,
        }
    }
}

impl LiveEncoder {
    /// Widens the ranges of BAPs that outgrew them, both ways, as what goes one way comes back; and those of
    /// the other BAPs of their kind to some degree, as fingers move together.
    pub(super) fn widen(&mut self) {
        let mask = self.mask();
        for &(bap, wanted) in &self.outgrown {
            let wide = (wanted as f64 * WIDENING) as i64;
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
        if mask.is_empty() {
            params.ranges = [Some([0; BAP_COUNT]); 4];
        }
        Ok(params)
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
            let share = if known || rests { READY * self.steering.kbit_per_s() } else { UNKNOWN };
            let least = step.max((share * f64::from(first)) as i32);
            let mask = self.mask();
            let kin = mask.iter().filter(|other| Kind::of(*other) == Kind::of(bap));
            let kin = kin.flat_map(|other| self.reach.seen(other)).max().unwrap_or(0);
            let least = least.max((ALIKE * f64::from(kin)) as i32);
            return self.reach.seen(bap).map(|speed| ((SPEED * f64::from(speed)) as i32).max(least));
        }
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
        for slot in self.out.writer.layout().slots() {
            let bap = slot.bap;
            let intra = intra_codes(bap, frame.value(bap), steps, quant)?;
            let seen = self.reach.seen(bap).map(|reach| predicted_code(bap, reach, steps, quant));
            let reach =
                self.wanted_reach(frame, bap, quant).map(|reach| predicted_code(bap, reach, steps, quant));
            let needed = [intra[0], intra[1], seen[0], seen[1]];
            let codes = [intra[0], intra[1], reach[0], reach[1]];
            // What persists are levels: a coarser quantiser makes them reach further.
            let known = [slot.intra[1], -slot.intra[0], slot.predicted[1], -slot.predicted[0]];
            for end in RangeEnd::ALL.map(|end| end as usize) {
                wanted[end][bap.index()] = codes[end];
                outgrown[end] |= known[end] < range_levels(needed[end], quant);
            }
        }
        for (range, (codes, outgrown)) in params.ranges.iter_mut().zip(wanted.into_iter().zip(outgrown)) {
            *range = outgrown.then_some(codes);
        }
        Ok(params)
    }
}
