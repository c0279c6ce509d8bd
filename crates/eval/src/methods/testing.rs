//! Problems that every minimiser is tried on.

use std::ops::Range;

use handcast_track::{Optimiser, Problem, Search};

/// The Rosenbrock valley, or a bowl about (2, 2, …), under Σ pᵢ ≤ bound; counts and checks.
pub struct Valley {
    pub steps: Vec<f64>,
    pub bound: f64,
    pub bowl: bool,
    pub outside: f64,
}

impl Valley {
    pub fn bowl(n: usize, bound: f64) -> Self {
        Self { steps: vec![0.5; n], bound, bowl: true, outside: 0.0 }
    }

    pub fn rosenbrock() -> Self {
        Self { steps: vec![0.5; 2], bound: f64::INFINITY, bowl: false, outside: 0.0 }
    }
}

impl Problem for Valley {
    fn steps(&self) -> &[f64] {
        &self.steps
    }

    fn groups(&self) -> Vec<Range<usize>> {
        (0..self.steps.len()).step_by(2).map(|i| i..(i + 2).min(self.steps.len())).collect()
    }

    fn inside(&mut self, from: &[f64], to: &[f64]) -> f64 {
        let (a, b) = (from.iter().sum::<f64>() - self.bound, to.iter().sum::<f64>() - self.bound);
        if b <= 0.0 {
            1.0
        } else if a >= 0.0 {
            0.0
        } else {
            a / (a - b)
        }
    }

    fn value(&mut self, p: &[f64]) -> f64 {
        self.outside = self.outside.max(p.iter().sum::<f64>() - self.bound);
        if self.bowl {
            p.iter().enumerate().map(|(i, v)| (1.0 + i as f64) * (v - 2.0).powi(2)).sum()
        } else {
            (1.0 - p[0]).powi(2) + 100.0 * (p[1] - p[0] * p[0]).powi(2)
        }
    }
}

/// Minimises a free bowl and one cut off by a plane; checks the count, that no point was outside, and
/// how much of the way is left inside and on the border.
pub fn check(optimiser: &mut dyn Optimiser, limit: usize, inside: f64, border: f64) {
    for n in [2, 3, 6] {
        for (bound, near) in [(f64::INFINITY, inside), (1.2 * n as f64, border)] {
            let mut valley = Valley::bowl(n, bound);
            let mut trace = Vec::new();
            let mut point = vec![0.0; n];
            let mut search = Search::new(&mut valley, limit).traced(&mut trace);
            let outcome = optimiser.minimise(&mut search, &mut point);
            let evaluations = search.evaluations();
            assert!(evaluations <= limit, "{evaluations}");
            assert_eq!(trace.len(), evaluations);
            assert!(valley.outside < 1e-9, "{n} {bound}: {} outside", valley.outside);
            assert_eq!(outcome.value, valley.value(&point), "the value is that of the point");
            assert_eq!(Some(&outcome.value), trace.last(), "and the best of all");
            // The bowl's least value on the plane, by Lagrange's multiplier.
            let weights: f64 = (0..n).map(|i| 1.0 / (1.0 + i as f64)).sum();
            let short = (2.0 * n as f64 - bound).max(0.0);
            let least = short * short / weights;
            let first = Valley::bowl(n, bound).value(&vec![0.0; n]);
            let left = (outcome.value - least) / (first - least);
            assert!(left < near, "{n} {bound}: {left} of the way is left after {evaluations}");
        }
    }
}
