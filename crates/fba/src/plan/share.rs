//! Independent work, on several cores where the feature `parallel` is on.

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
pub fn both<A: Send, B: Send>(one: impl FnOnce() -> A + Send, other: impl FnOnce() -> B + Send) -> (A, B) {
    #[cfg(feature = "parallel")]
    let made = rayon::join(one, other);
    #[cfg(not(feature = "parallel"))]
    let made = (one(), other());
    made
}
