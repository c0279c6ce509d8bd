//! Palm or back, of one hand of which neither view nor side was told: both are tracked until one explains the
//! frames better.
//!
//! An open hand and its mirror image in depth have the same silhouette. Fingers that bend do not: those that come before
//! the palm look larger, hide it and catch another light; those behind it disappear.

use super::hands::{Hand, Seen, Step, advance};
use super::{ClipOptions, ContestTuning};
use crate::register::{Registered, largest_difference};
use crate::{SizeMismatch, View};
use handcast_hand::FreeAngles;

/// Two hands that start alike: the first as the palm of a hand, the second as the back of one of the other side.
pub(super) struct Contest {
    hands: [Hand; 2],
    /// Free angles of both in each frame that has counted.
    postures: Vec<[FreeAngles; 2]>,
    odds: Odds,
    /// Frames until the next look.
    wait: usize,
}

impl Contest {
    /// A contest that nothing has been seen of.
    pub(super) fn new(palm: Hand, back: Hand) -> Self {
        Self { hands: [palm, back], postures: Vec::new(), odds: Odds::default(), wait: 0 }
    }

    /// Tracks both in a frame before them, back from where they start; only some frames tell what they look like. It may
    /// count as evidence.
    ///
    /// # Errors
    /// The picture has another size than its silhouettes.
    pub(super) fn look_back(
        &mut self,
        index: usize,
        seen: &Seen<'_>,
        counts: bool,
        options: &ClipOptions,
    ) -> Result<(), SizeMismatch> {
        let steps = advance(&mut self.hands, |hand| index < hand.start.frame, seen, options)?;
        if counts {
            self.weigh(&steps, &options.tuning.contest);
        }
        Ok(())
    }

    /// Whether a frame comes before one of them, by so many frames at most.
    pub(super) fn is_before(&self, index: usize, most: usize) -> bool {
        let starts = self.hands.each_ref().map(|hand| hand.start.frame);
        let [first, last] = [starts[0].min(starts[1]), starts[0].max(starts[1])];
        index < last && index.saturating_add(most) >= first
    }

    /// Ends the way back.
    pub(super) fn rewind(&mut self) {
        self.hands.iter_mut().for_each(Hand::rewind);
    }

    /// Largest difference of a joint angle from the open hand in either, radians.
    fn bent(&self) -> f64 {
        self.hands.iter().map(Hand::bent).fold(0.0, f64::max)
    }

    /// Whether the next frame is to be looked at: while no finger bends only some are.
    pub(super) fn is_due(&mut self, tuning: &ContestTuning) -> bool {
        let due = self.wait == 0;
        self.wait = if !due {
            self.wait - 1
        } else if self.bent() > tuning.stirs {
            0
        } else {
            tuning.every.saturating_sub(1)
        };
        due
    }

    /// Tracks both in the next frame, where they have started.
    ///
    /// # Errors
    /// Those of [`Contest::look_back`].
    pub(super) fn look(
        &mut self,
        index: usize,
        seen: &Seen<'_>,
        options: &ClipOptions,
    ) -> Result<(), SizeMismatch> {
        let steps = advance(&mut self.hands, |hand| hand.start.frame <= index, seen, options)?;
        self.weigh(&steps, &options.tuning.contest);
        Ok(())
    }

    /// Counts a frame that both were tracked in, where it tells anything.
    fn weigh(&mut self, steps: &[Option<Step>], t: &ContestTuning) {
        let found = steps.iter().all(|step| step.as_ref().is_some_and(|step| step.tracked.valid));
        let explained = steps.iter().flatten().any(|step| step.tracked.iou >= t.explained);
        if let ([Some(palm), Some(back)], true) = (self.hands.each_ref().map(Hand::found), found && explained)
            && self.bent() > t.bent
        {
            let posture = self.hands.each_ref().map(Hand::free);
            self.odds.add(novelty(&posture, &self.postures, t) * odds_of(&palm, &back, t));
            self.postures.push(posture);
        }
    }

    /// Which view the frames speak for, and whether that is decided; `None` while the sum is small.
    pub(super) fn view(&self, tuning: &ContestTuning) -> Option<(View, bool)> {
        self.odds.view(tuning)
    }
}

/// Log-odds of the frames that speak for a palm, and of those that speak for a back; both 0 or more.
#[derive(Clone, Copy, Debug, Default)]
struct Odds {
    palm: f64,
    back: f64,
}

impl Odds {
    /// Adds the log-odds of a palm in a frame.
    fn add(&mut self, odds: f64) {
        *if odds > 0.0 { &mut self.palm } else { &mut self.back } += odds.abs();
    }

    /// See [`Contest::view`]: where frames contradict each other nothing is decided.
    fn view(&self, tuning: &ContestTuning) -> Option<(View, bool)> {
        let Self { palm, back } = *self;
        let view = if palm > back { View::Palm } else { View::Back };
        let sum = (palm - back).abs();
        let decided = sum >= tuning.settled_odds && palm.min(back) <= tuning.opposed * palm.max(back);
        (sum >= tuning.leaning_odds).then_some((view, decided))
    }
}

/// Log-odds of a palm in one frame, by how it is explained as a palm and as a back.
fn odds_of(palm: &Registered, back: &Registered, tuning: &ContestTuning) -> f64 {
    let shadows = tuning.shadows * palm.beyond_noise.min(back.beyond_noise);
    ((back.cost - palm.cost + shadows) / tuning.alike).clamp(-tuning.most_odds, tuning.most_odds)
}

/// What a frame counts, 0 to 1, by how far both hands' postures are from those that have counted: frames that are
/// alike err alike.
fn novelty(posture: &[FreeAngles; 2], counted: &[[FreeAngles; 2]], tuning: &ContestTuning) -> f64 {
    let far = |before: &[FreeAngles; 2]| {
        let [palm, back] = [0, 1].map(|i| largest_difference(&posture[i], &before[i]));
        palm.max(back)
    };
    let nearest = counted.iter().map(far).fold(f64::INFINITY, f64::min);
    (nearest / tuning.new_posture).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::FREE_ANGLES;

    #[test]
    fn a_posture_counts_once() {
        let t = ContestTuning::default();
        let posture = |palm: f64, back: f64| [[palm; FREE_ANGLES], [back; FREE_ANGLES]];
        let half = 0.5 * t.new_posture;
        assert_eq!(novelty(&posture(0.0, 0.0), &[], &t), 1.0);
        let counted = [posture(0.0, 0.0), posture(2.0, 1.0)];
        assert_eq!(novelty(&counted[1], &counted, &t), 0.0);
        assert!((novelty(&posture(2.0, 1.0 + half), &counted, &t) - 0.5).abs() < 1e-12);
        assert_eq!(novelty(&posture(1.0, 1.0), &counted, &t), 1.0);
    }

    fn explained(cost: f64, beyond_noise: f64) -> Registered {
        Registered { rate: 0.0, iou: 1.0, cost, beyond_noise }
    }

    #[test]
    fn one_frame_decides_nothing_and_a_palm_may_cost_what_shadows_do() {
        let t = ContestTuning::default();
        let odds =
            |palm: f64, back: f64, beyond| odds_of(&explained(palm, beyond), &explained(back, beyond), &t);
        assert!(odds(100.0, 1e6, 1.0) <= t.most_odds && t.most_odds < t.settled_odds);
        assert_eq!(odds(100.0 + t.shadows, 100.0, 1.0), 0.0);
        assert!(odds(110.0 + t.shadows, 100.0, 1.0) < 0.0);
        // In the dark nothing speaks for a palm, nor for a back.
        assert_eq!(odds(100.0, 100.0, 0.0), 0.0);
    }

    #[test]
    fn frames_that_contradict_each_other_decide_nothing() {
        let t = ContestTuning::default();
        let view = |frames: &[f64]| {
            let mut odds = Odds::default();
            frames.iter().for_each(|&frame| odds.add(frame));
            odds.view(&t)
        };
        assert_eq!(view(&[t.settled_odds]), Some((View::Palm, true)));
        assert_eq!(view(&[2.0, -2.0 - t.settled_odds]), Some((View::Back, true)));
        assert_eq!(view(&[2.0 * t.settled_odds, -t.settled_odds]), Some((View::Palm, false)));
        assert_eq!(view(&[2.0, -2.0 - t.leaning_odds]), Some((View::Back, false)));
        assert_eq!(view(&[2.0, -1.0 - t.leaning_odds]), None);
    }
}
