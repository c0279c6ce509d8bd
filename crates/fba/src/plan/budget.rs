//! What a frame may cost so that the rate is held over any ten seconds.

use std::collections::VecDeque;

use super::options::{GRACE, WINDOW};

/// Shares of its bits between which windows are steered; none goes beyond the second, a little below what is promised,
/// as the plane that ends a stream is not foreseen.
const HELD: [f64; 2] = [0.954, 1.028];
/// Share of a window's bits that what is not foreseen may cost beyond that.
const UNFORESEEN: f64 = 0.008;
/// What an I plane that is due may cost more than the last one. If it costs more still, it may have to wait.
const MARGIN: f64 = 0.02;
/// Share of a window's bits that is kept for I planes at most.
const INTRAS: f64 = 0.75;
/// Share of the band that an I plane out of turn may fill.
const FILLS: f64 = 0.75;
/// Share of a window's bits that an I plane out of turn must leave.
const RESERVE: f64 = 0.02;
/// Share of the usual bits that P planes shall be left with until a window ends. It is near 1: bits not spent at some
/// time are missing ten seconds later, when that time leaves the window.
const LEAST: f64 = 0.75;
/// Share of a window that what leaps cost is remembered for.
const LEAPS_SHARE: f64 = 0.5;
/// Seconds without any that are believed at the start.
const PRIOR_SECONDS: f64 = 2.0;

/// What the frame to come may cost, bits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Room {
    /// Most, so that later frames are left with something.
    pub most: f64,
    /// What frames can have of the scarcest window if each has the same.
    pub even: f64,
    /// Most without which a window would cost too much, whatever comes later.
    pub limit: f64,
    /// How many bits the frames to come may cost less, and more, all together, than if each cost the usual.
    pub slack: [f64; 2],
}

impl Room {
    /// Where nothing is held.
    pub const ENDLESS: Self =
        Self { most: f64::INFINITY, even: f64::INFINITY, limit: f64::INFINITY, slack: [f64::INFINITY; 2] };
}

/// Bits of the frames so far, and those still to come that are known: I planes at their times.
#[derive(Clone, Debug)]
pub(super) struct Budget {
    /// Bits per frame, frames of a window, and frames from one I plane to the next.
    target: f64,
    window: u64,
    interval: u64,
    /// First frame that counts.
    first: u64,
    /// Frames so far, and those since one cost anything.
    now: u64,
    idle: u64,
    /// Bits of all frames before each of the last ones; the last entry is for `now`.
    sums: VecDeque<u64>,
    /// Frame of the next I plane that is due, and its cost as far as it is known.
    due: u64,
    intra: f64,
    /// Bits that leaps have cost of late, and frames that they are counted over.
    leaps: [f64; 2],
}

impl Budget {
    pub fn new(target: f64, rate: f64, interval: u64) -> Self {
        Self {
            target,
            window: (WINDOW * rate).round().max(1.0) as u64,
            interval: interval.max(1),
            first: (GRACE * rate).floor() as u64,
            now: 0,
            idle: 0,
            sums: VecDeque::from([0]),
            due: interval,
            intra: 0.0,
            leaps: [0.0, PRIOR_SECONDS * rate],
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
        self.idle = if bits > 0 { 0 } else { self.idle + 1 };
    }

    /// Takes in what the frame that was just spent on has cost for a leap: those to come will cost much the same.
    pub fn note_leap(&mut self, bits: u64) {
        let keep = 1.0 - 1.0 / (LEAPS_SHARE * self.window as f64);
        self.leaps = [self.leaps[0] * keep + bits as f64, self.leaps[1] * keep + 1.0];
    }

    /// Says what an I plane that is due costs, and when the next one is.
    pub fn expect(&mut self, intra: f64, due: u64) {
        self.intra = intra;
        self.due = due;
    }

    /// What an I plane that is due costs, as far as it is known.
    pub fn intra(&self) -> f64 {
        self.intra
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
    pub fn predicted(&self) -> f64 {
        (self.target - self.intra / self.interval as f64 - self.leaps()).max(0.1 * self.target)
    }

    /// Bits per frame that leaps have cost of late.
    fn leaps(&self) -> f64 {
        self.leaps[0] / self.leaps[1]
    }

    /// I planes due after the frame to come, up to frame `end`. One that is late is sent with the frame to come or
    /// the one after it.
    fn due_until(&self, end: u64, intra_now: bool) -> u64 {
        let late = self.due <= self.now;
        let next = if late { self.due + self.interval } else { self.due };
        let regular = if end < next { 0 } else { 1 + (end - next) / self.interval };
        regular + u64::from(late && !intra_now && end > self.now)
    }

    /// What the frame to come may cost, if it is not an I plane that is due.
    pub fn room(&self) -> Room {
        self.room_if(false, self.intra)
    }

    /// What the frame to come may cost if I planes that are due cost `intra` from now on; `intra_now` says whether
    /// it is one of them.
    pub fn room_if(&self, intra_now: bool, intra: f64) -> Room {
        let (usual, leaps) = (self.predicted(), self.leaps());
        let bits = self.target * self.window as f64;
        let nearest = self.now.max(self.first + self.window - 1);
        let mut room = Room::ENDLESS;
        if self.now < self.first {
            return room;
        }
        for end in nearest..self.now + self.window {
            let due = intra * (1.0 + MARGIN) * self.due_until(end, intra_now) as f64;
            // Where the rate does not do for them all, some wait.
            let due = due.min(INTRAS * bits);
            let spent = self.since(end + 1 - self.window) + due;
            let frames = (end - self.now) as f64;
            let [low, high] = HELD.map(|share| share * bits - spent);
            room.limit = room.limit.min(high);
            // Leaps to come have theirs.
            let [low, high] = [low, high].map(|bits| bits - leaps * frames);
            room.most = room.most.min(high - LEAST * usual * frames);
            room.even = room.even.min(high / (frames + 1.0));
            let usual = usual * (frames + 1.0);
            room.slack = [room.slack[0].min(usual - low), room.slack[1].min(high - usual)];
        }
        // What is scarce is shared evenly, by the planes that are sent.
        room.most = room.most.max(room.even * (self.idle + 1) as f64);
        room
    }

    /// Bits beyond the band that break no promise.
    pub fn spare(&self) -> f64 {
        UNFORESEEN * self.target * self.window as f64
    }

    /// Whether so many bits can be spent now and leave something for the frames to come.
    pub fn bears(&self, bits: f64) -> bool {
        bits <= self.room().most
    }

    /// Whether an I plane of so many bits can be sent now, out of turn. It must not fill the band, as the windows
    /// in which it is and those in which it no longer is are next to each other.
    pub fn affords(&self, bits: f64) -> bool {
        let window = self.target * self.window as f64;
        let fits = bits <= FILLS * (HELD[1] - HELD[0]) * window || self.now < self.first;
        fits && bits <= self.room().most - RESERVE * window
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whatever is wished for, down to nothing and up to all there is, no window costs too much.
    #[test]
    fn no_window_costs_too_much_whatever_is_wished_for() {
        let mut state = 1u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1u32 << 24)
        };
        for target in [15.0, 30.0, 50.0, 130.0] {
            for turn in [1, 7, 45, 200, 400, 700] {
                let mut budget = Budget::new(target, 30.0, 150);
                let (mut spent, mut since) = (Vec::new(), 150);
                for frame in 0..4000u64 {
                    let limit = budget.room().limit;
                    let intra = 1000.0 + 20.0 * next();
                    let bits = if since >= 150 && intra <= budget.room_if(true, intra).limit {
                        since = frame % 150;
                        budget.expect(intra, frame - since + 150);
                        intra as u64
                    } else {
                        let wish = if frame / turn % 2 == 0 { 0.0 } else { 20.0 * target * next() };
                        wish.min(limit.max(0.0)) as u64
                    };
                    since += 1;
                    budget.spend(bits);
                    spent.push(bits);
                }
                for window in spent[60..].windows(300) {
                    let share = window.iter().sum::<u64>() as f64 / (300.0 * target);
                    assert!(share <= 1.05, "{share} of {target}, turns of {turn}");
                }
            }
        }
    }
}
