//! Where in one arena each intermediate result lives.

use std::ops::Range;

/// A result: how many numbers, and the steps from the one that makes it to the last that reads it.
#[derive(Clone, Debug)]
pub(super) struct Lifetime {
    pub size: usize,
    pub steps: std::ops::RangeInclusive<usize>,
}

/// Numbers between starts of results are multiples of this: whole cache lines.
const ALIGN: usize = 16;

/// A place for each result so that no two that live at the same time overlap, and the numbers needed in all. Largest
/// first, each at the lowest place that is free as long as it lives.
pub(super) fn plan(lifetimes: &[Lifetime]) -> (Vec<Range<usize>>, usize) {
    let mut order: Vec<usize> = (0..lifetimes.len()).collect();
    order.sort_by_key(|&i| (std::cmp::Reverse(lifetimes[i].size), i));
    let mut places = vec![0..0; lifetimes.len()];
    let mut placed: Vec<usize> = Vec::with_capacity(lifetimes.len());
    let mut total = 0;
    for i in order {
        let mut taken: Vec<Range<usize>> = placed
            .iter()
            .filter(|&&other| meet(&lifetimes[i], &lifetimes[other]))
            .map(|&other| places[other].clone())
            .collect();
        taken.sort_by_key(|range| range.start);
        let mut start = 0;
        for range in taken {
            if start + lifetimes[i].size <= range.start {
                break;
            }
            start = start.max(range.end.next_multiple_of(ALIGN));
        }
        places[i] = start..start + lifetimes[i].size;
        total = total.max(places[i].end);
        placed.push(i);
    }
    (places, total)
}

fn meet(a: &Lifetime, b: &Lifetime) -> bool {
    a.steps.start() <= b.steps.end() && b.steps.start() <= a.steps.end()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn results_that_live_together_do_not_overlap(
            parts in prop::collection::vec((1..200usize, 0..20usize, 0..8usize), 1..40),
        ) {
            let lifetimes: Vec<Lifetime> = parts
                .into_iter()
                .map(|(size, first, length)| Lifetime { size, steps: first..=first + length })
                .collect();
            let (places, total) = plan(&lifetimes);
            for (i, a) in places.iter().enumerate() {
                prop_assert_eq!(a.len(), lifetimes[i].size);
                prop_assert!(a.end <= total);
                for (j, b) in places.iter().enumerate().skip(i + 1) {
                    let apart = a.end <= b.start || b.end <= a.start;
                    prop_assert!(apart || !meet(&lifetimes[i], &lifetimes[j]));
                }
            }
        }
    }

    #[test]
    fn a_chain_takes_the_memory_of_two_results() {
        let chain: Vec<Lifetime> = (0..10).map(|i| Lifetime { size: 100, steps: i..=i + 1 }).collect();
        assert_eq!(plan(&chain).1, 112 + 100);
    }
}
