//! What a frame may cost so that the rate is held over any ten seconds.

use std::collections::VecDeque;

/// Seconds over which the rate is held.
const WINDOW: f64 = 10.0;
/// Seconds at the start that no window needs to hold.
const GRACE: f64 = 2.0;
/// Shares of its bits between which every window is kept: a little inside what is promised.
const HELD: [f64; 2] = [0.956, 1.044];
/// Frames from one looked-at end of a window to the next, and number of them.
const STRIDE: u64 = 6;
const AHEAD: u64 = 20;
/// What an I plane that is due may cost more than the last one.
const MARGIN: f64 = 0.06;
/// Share of the band that an I plane out of turn may fill.
const FILLS: f64 = 0.75;
/// Share of a window's bits that an I plane out of turn must leave.
const RESERVE: f64 = 0.02;
/// Share of the usual bits that P planes shall be left with until a window ends, and most they shall have
/// to use up.
const LEAST: f64 = 0.5;
const MOST: f64 = 1.6;

/// Bits of the frames so far, and those still to come that are known: I planes at their times.
#[derive(Clone, Debug)]
pub(super) struct Budget {
    /// Bits per frame, frames of a window, and frames from one I plane to the next.
    target: f64,
    window: u64,
    interval: u64,
    /// First frame that counts.
    first: u64,
    /// Frames so far.
    now: u64,
    /// Bits of all frames before each of the last ones; the last entry is for `now`.
    sums: VecDeque<u64>,
    /// Frame of the next I plane that is due, and its cost as far as it is known.
    due: u64,
    intra: f64,
}

impl Budget {
    pub fn new(target: f64, rate: f64, interval: u64) -> Self {
        Self {
            target,
            window: (WINDOW * rate).round().max(1.0) as u64,
            interval,
            first: (GRACE * rate).floor() as u64,
            now: 0,
            sums: VecDeque::from([0]),
            due: interval,
            intra: 0.0,
        }
    }

    /// Takes in what a frame has cost.
    pub fn spend(&mut self, bits: u64) {
        let total = self.sums.back().copied().unwrap_or(0) + bits;
        self.sums.push_back(total);
        if self.sums.len() as u64 > self.window + 1 {
            self.sums.pop_front();
        }
        self.now += 1;
    }

    /// Says what an I plane that is due costs, and when the next one is.
    pub fn expect(&mut self, intra: f64, due: u64) {
        self.intra = intra;
        self.due = due;
    }

    /// Whether no frame so far counts.
    pub fn is_free(&self) -> bool {
        self.now <= self.first
    }

    /// Number of the frame to come.
    pub fn now(&self) -> u64 {
        self.now
    }

    /// Bits of the frames from `frame` on, as far as they count.
    fn since(&self, frame: u64) -> f64 {
        let kept = self.sums.len() as u64 - 1;
        let back = (self.now.saturating_sub(frame.max(self.first))).min(kept);
        let before = self.sums.get((kept - back) as usize).copied().unwrap_or(0);
        (self.sums.back().copied().unwrap_or(0) - before) as f64
    }

    /// Bits that P planes have of each frame in the long run.
    fn predicted(&self) -> f64 {
        (self.target - self.intra / self.interval as f64).max(0.1 * self.target)
    }

    /// What is left of the window that ends with frame `end`, at the lower and the upper end of its band, when
    /// the I planes until then are paid.
    fn left(&self, end: u64) -> [f64; 2] {
        let due = if end < self.due { 0 } else { 1 + (end - self.due) / self.interval };
        // The frame to come may be one of them.
        let due = due - u64::from(self.due == self.now && due > 0);
        let spent =
            self.since((end + 1).saturating_sub(self.window)) + self.intra * (1.0 + MARGIN) * due as f64;
        HELD.map(|share| share * self.target * self.window as f64 - spent)
    }

    /// Ends of windows to look at.
    fn ends(&self) -> impl Iterator<Item = u64> {
        let nearest = self.now.max(self.first + self.window - 1);
        let due = [self.due, self.due + self.interval].into_iter().filter(move |&due| due >= nearest);
        (0..AHEAD).map(move |step| nearest + step * STRIDE).chain(due)
    }

    /// Least and most that the frame to come may cost.
    pub fn bounds(&self) -> [f64; 2] {
        let usual = self.predicted();
        self.ends().fold([0.0, f64::INFINITY], |[least, most], end| {
            let [low, high] = self.left(end);
            let frames = (end - self.now) as f64;
            [least.max(low - MOST * usual * frames), most.min(high - LEAST * usual * frames)]
        })
    }

    /// Whether an I plane of so many bits can be sent now, out of turn. It must not fill the band, as the windows
    /// in which it is and those in which it no longer is are next to each other.
    pub fn affords(&self, bits: f64) -> bool {
        let window = self.target * self.window as f64;
        let fits = bits <= FILLS * (HELD[1] - HELD[0]) * window || self.now < self.first;
        fits && bits <= self.bounds()[1] - RESERVE * window
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Spending that varies by turns of seconds as much as [`LEAST`] and [`MOST`] have room for (a quarter of the
    /// target on average, then 1.3 times it) keeps every window in its band. What is denser for seconds on end
    /// would have to be spent again ten seconds later, which no bound sees.
    #[test]
    fn bounds_hold_every_window_of_uneven_spending() {
        let mut state = 1u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1u32 << 24)
        };
        for target in [30.0, 50.0, 130.0] {
            let mut budget = Budget::new(target, 30.0, 150);
            let mut spent = Vec::new();
            for frame in 0..3000u64 {
                let bits = if frame % 150 == 0 {
                    let bits = 1000.0 + 20.0 * next();
                    budget.expect(bits, frame + 150);
                    bits as u64
                } else {
                    let [least, most] = budget.bounds();
                    let calm = frame / 200 % 2 == 0;
                    let wish = target * if calm { 0.5 * next() } else { 0.5 + 1.6 * next() };
                    wish.clamp(least.ceil(), most.max(least.ceil()).floor()) as u64
                };
                budget.spend(bits);
                spent.push(bits);
            }
            for window in spent[60..].windows(300) {
                let share = window.iter().sum::<u64>() as f64 / (300.0 * target);
                assert!((0.95..=1.05).contains(&share), "{share} of {target}");
            }
        }
    }
}
