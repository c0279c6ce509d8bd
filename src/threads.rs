//! Independent work on several threads.

use std::panic::resume_unwind;
use std::thread::{Builder, available_parallelism};

/// Threads that the machine runs side by side; 1 where it does not say.
pub(crate) fn cores() -> usize {
    available_parallelism().map_or(1, usize::from)
}

/// What `work` makes of each number below `count`, in order, each on a thread of its own. Where the system gives no
/// thread the work is done here; panics go on here.
pub(crate) fn each<T: Send>(count: usize, work: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let work = &work;
    std::thread::scope(|scope| {
        let start = |i| Builder::new().spawn_scoped(scope, move || work(i));
        let others: Vec<_> = (1..count).map(start).collect();
        let here = (count > 0).then(|| work(0));
        let others = (1..).zip(others).map(|(i, worker)| match worker {
            Ok(worker) => worker.join().unwrap_or_else(|panic| resume_unwind(panic)),
            Err(_) => work(i),
        });
        here.into_iter().chain(others).collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_in_order() {
        for count in [0, 1, 2, 9] {
            assert_eq!(each(count, |i| i * i), (0..count).map(|i| i * i).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_panic_goes_on_here() {
        let panicked = std::panic::catch_unwind(|| each(3, |i| assert_ne!(i, 2)));
        assert!(panicked.is_err());
    }
}
