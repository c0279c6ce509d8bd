//! Where a value is about to go, and which level to send now with a view to that.
//!
//! Without look-ahead the future of a value is guessed: it goes on as fast as of late, and slows down. Over a
//! short horizon of such a guess the cheapest way is found by dynamic programming, with the symbol costs
//! that the adaptive model has now; its first step is sent. So a moving value is overtaken by half the
//! distance until the next change, which halves the number of changes, and a resting one stays.

use super::super::arith::{Adaptive, Model};

/// Frames looked ahead, the present one included.
const FRAMES: usize = 8;
/// What is left of the velocity after each further frame.
const SLOWING: f64 = 0.85;
/// What the error of each further frame counts for: guesses get worse.
const TRUST: f64 = 0.92;
/// What the error at the end of the horizon counts for in addition, in frames: it stays for a while.
const TAIL: f64 = 3.0;
/// Weight of the newest difference in the velocity.
const NEWEST: f64 = 0.5;
/// Squared degrees per squared degree beyond the bound.
const BEYOND: f64 = 1e3;
/// Levels tried beyond those that the guess passes through.
const MARGIN: i32 = 1;
/// Most levels tried.
const MOST_STATES: usize = 24;

/// Velocity of one value.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Motion {
    last: Option<f64>,
    velocity: f64,
}

impl Motion {
    /// Takes in the value of the next frame.
    pub fn follow(&mut self, value: f64) {
        if let Some(last) = self.last {
            self.velocity += NEWEST * (value - last - self.velocity);
        }
        self.last = Some(value);
    }

    /// The value now and as guessed for the frames after.
    fn guess(&self, value: f64) -> [f64; FRAMES] {
        let mut speed = self.velocity;
        let mut at = value;
        let mut first = true;
        [(); FRAMES].map(|()| {
            if !std::mem::take(&mut first) {
                speed *= SLOWING;
                at += speed;
            }
            at
        })
    }
}

/// One value as the search sees it: differences to what the decoder has.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wish {
    /// Wanted difference, in the unit of the BAP.
    pub difference: f64,
    /// Quantiser step, and degrees per unit.
    pub step: f64,
    pub degrees: f64,
    /// Smallest and largest level.
    pub range: [i32; 2],
    /// Largest error wanted, degrees.
    pub bound: f64,
    /// Squared degrees per bit.
    pub lambda: f64,
}

/// What to send, and what it is worth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Choice {
    pub level: i32,
    /// What sending it instead of leaving out the plane saves, in squared degrees; negative for the zeros
    /// that only keep others company.
    pub gain: f64,
}

/// The level to send now.
pub(super) fn choose(wish: &Wish, motion: &Motion, model: &Adaptive<'_>) -> Choice {
    let guess = motion.guess(wish.difference).map(|value| value / wish.step);
    let (least, most) = guess.iter().fold((0.0f64, 0.0f64), |(a, b), &v| (a.min(v), b.max(v)));
    let low = (least.floor() as i32 - MARGIN).max(-(MOST_STATES as i32) / 2);
    let high = (most.ceil() as i32 + MARGIN).min(low + MOST_STATES as i32 - 1);
    let states = (high - low + 1) as usize;
    let unit = wish.step * wish.degrees;
    let penalty = |frame: usize, level: i32| {
        let off = (guess[frame] - f64::from(level)) * unit;
        let beyond = (off.abs() - wish.bound).max(0.0);
        off * off + BEYOND * beyond * beyond
    };
    let [min, max] = wish.range;
    let total = f64::from(model.total());
    // Costs of the changes that can occur, by change + states − 1.
    let mut bits = [f64::INFINITY; 2 * MOST_STATES];
    for change in min.max(1 - states as i32)..=max.min(states as i32 - 1) {
        let (below, above) = model.bounds((change - min) as usize);
        bits[(change + states as i32 - 1) as usize] = wish.lambda * (total / f64::from(above - below)).log2();
    }
    let change_cost = |from: usize, to: usize| bits[to + states - 1 - from];
    // From the end of the horizon back: least cost from each level on.
    let mut ahead = [0.0; MOST_STATES];
    for (state, cost) in ahead.iter_mut().enumerate().take(states) {
        *cost = TAIL * TRUST.powi(FRAMES as i32 - 1) * penalty(FRAMES - 1, low + state as i32);
    }
    for frame in (1..FRAMES).rev() {
        let weight = TRUST.powi(frame as i32);
        let mut arrived = [0.0; MOST_STATES];
        for (state, cost) in arrived.iter_mut().enumerate().take(states) {
            *cost = ahead[state] + weight * penalty(frame, low + state as i32);
        }
        for (from, cost) in ahead.iter_mut().enumerate().take(states) {
            *cost = (0..states).map(|to| change_cost(from, to) + arrived[to]).fold(f64::INFINITY, f64::min);
        }
    }
    let origin = (-low) as usize;
    let cost = |state: usize| ahead[state] + penalty(0, low + state as i32);
    let best = (0..states)
        .map(|state| (change_cost(origin, state) + cost(state), state))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .unwrap_or((0.0, origin));
    Choice { level: low + best.1 as i32, gain: cost(origin) - best.0 }
}
