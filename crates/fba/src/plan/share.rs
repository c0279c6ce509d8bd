//! Independent work, on several cores where the feature `parallel` is on.

#[cfg(not(feature = "parallel"))]
use std::collections::VecDeque;
#[cfg(feature = "parallel")]
use std::sync::mpsc::channel;

#[cfg(feature = "parallel")]
use rayon::prelude::*;

/// Workers that run side by side.
pub(super) fn workers() -> usize {
    #[cfg(feature = "parallel")]
    let workers = rayon::current_num_threads();
    #[cfg(not(feature = "parallel"))]
    let workers = 1;
    workers
}

/// What `work` makes of each number below `count`, in order.
pub(super) fn each<T: Send>(count: usize, work: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    #[cfg(feature = "parallel")]
    let all = (0..count).into_par_iter();
    #[cfg(not(feature = "parallel"))]
    let all = 0..count;
    all.map(work).collect()
}

/// What both make, side by side; where no core is free, or without the feature `parallel`, one after the other.
pub(super) fn both<A: Send, B: Send>(
    one: impl FnOnce() -> A + Send,
    other: impl FnOnce() -> B + Send,
) -> (A, B) {
    #[cfg(feature = "parallel")]
    let made = rayon::join(one, other);
    #[cfg(not(feature = "parallel"))]
    let made = (one(), other());
    made
}

/// Batches of [`relay`] that are under way.
const UNDER_WAY: usize = 4;

/// Lets a few batches go round: `turn` takes what has become of one, fills it anew and says whether it goes on, `work` works on
/// it; on two cores where the feature `parallel` is on, in the same order with and without.
pub fn relay<T: Default + Send>(mut turn: impl FnMut(&mut T) -> bool + Send, mut work: impl FnMut(&mut T)) {
    let fresh = |turn: &mut dyn FnMut(&mut T) -> bool| {
        let mut batch = T::default();
        turn(&mut batch).then_some(batch)
    };
    #[cfg(feature = "parallel")]
    std::thread::scope(|scope| {
        let (forth, filled) = channel();
        let (back, worked) = channel::<T>();
        scope.spawn(move || {
            let begun = (0..UNDER_WAY).map_while(|_| fresh(&mut turn)).map(|batch| forth.send(batch));
            let mut under_way = begun.take_while(Result::is_ok).count();
            while under_way > 0
                && let Ok(mut batch) = worked.recv()
            {
                let goes_on = turn(&mut batch) && forth.send(batch).is_ok();
                under_way -= usize::from(!goes_on);
            }
        });
        for mut batch in filled {
            work(&mut batch);
            if back.send(batch).is_err() {
                break;
            }
        }
    });
    #[cfg(not(feature = "parallel"))]
    {
        let mut filled: VecDeque<T> = (0..UNDER_WAY).map_while(|_| fresh(&mut turn)).collect();
        while let Some(mut batch) = filled.pop_front() {
            work(&mut batch);
            if turn(&mut batch) {
                filled.push_back(batch);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each batch goes round in order, and none is lost when no more come.
    #[test]
    fn batches_go_round_in_order() {
        for last in [0, 1, 3, 4, 5, 100] {
            let (mut next, mut back, mut seen) = (0, Vec::new(), Vec::new());
            relay(
                |batch: &mut Option<u32>| {
                    back.extend(batch.take());
                    *batch = (next < last).then_some(next);
                    next += 1;
                    batch.is_some()
                },
                |batch| seen.extend(*batch),
            );
            let all: Vec<u32> = (0..last).collect();
            assert_eq!((&seen, &back), (&all, &all));
        }
    }
}
