//! What every optimiser needs: a problem to evaluate, counted.

use std::ops::Range;

/// A function of a few parameters over a convex domain.
pub trait Problem {
    /// For each parameter the step that makes a moderate difference (λ of eq. 9).
    fn steps(&self) -> &[f64];

    /// Parameters that belong together, coarse ones first; together they are all parameters. One group
    /// unless the problem says otherwise.
    fn groups(&self) -> Vec<Range<usize>> {
        std::iter::once(0..self.steps().len()).collect()
    }

    /// How much of the segment from the feasible point `from` to `to` is feasible, 0..=1.
    fn inside(&mut self, from: &[f64], to: &[f64]) -> f64;

    /// The value at a feasible point.
    fn value(&mut self, point: &[f64]) -> f64;
}

/// A problem under search: counts evaluations, refuses those beyond a limit, and remembers the best value
/// after each when asked to.
pub struct Search<'a> {
    problem: &'a mut dyn Problem,
    evaluations: usize,
    limit: usize,
    best: f64,
    trace: Option<&'a mut Vec<f64>>,
}

impl<'a> Search<'a> {
    /// A search that may evaluate `limit` times.
    pub fn new(problem: &'a mut dyn Problem, limit: usize) -> Self {
        Self { problem, evaluations: 0, limit, best: f64::INFINITY, trace: None }
    }

    /// Appends the best value so far to `trace` at each evaluation.
    #[must_use]
    pub fn traced(mut self, trace: &'a mut Vec<f64>) -> Self {
        self.trace = Some(trace);
        self
    }

    /// Number of parameters.
    pub fn dimension(&self) -> usize {
        self.problem.steps().len()
    }

    /// The problem's step of a parameter.
    pub fn step(&self, i: usize) -> f64 {
        self.problem.steps().get(i).copied().unwrap_or(0.0)
    }

    /// See [`Problem::groups`].
    pub fn groups(&self) -> Vec<Range<usize>> {
        self.problem.groups()
    }

    /// The value at a feasible point; infinite, and not evaluated, once the limit is reached.
    pub fn value(&mut self, point: &[f64]) -> f64 {
        if self.spent() {
            return f64::INFINITY;
        }
        self.evaluations += 1;
        let value = self.problem.value(point);
        self.best = self.best.min(value);
        if let Some(trace) = &mut self.trace {
            trace.push(self.best);
        }
        value
    }

    /// See [`Problem::inside`].
    pub fn inside(&mut self, from: &[f64], to: &[f64]) -> f64 {
        self.problem.inside(from, to)
    }

    /// Moves `to` back to where the way from the feasible point `from` leaves the domain (paper 6.4.4).
    pub fn clip(&mut self, from: &[f64], to: &mut [f64]) {
        let t = self.problem.inside(from, to);
        if t < 1.0 {
            for (to, from) in to.iter_mut().zip(from) {
                *to = from + t * (*to - from);
            }
        }
    }

    /// Evaluations so far.
    pub fn evaluations(&self) -> usize {
        self.evaluations
    }

    /// Whether the limit is reached.
    pub fn spent(&self) -> bool {
        self.evaluations >= self.limit
    }
}

/// How a minimisation ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// The value at the best point.
    pub value: f64,
    /// Iterations: what one is depends on the method.
    pub iterations: usize,
}

/// A minimiser without derivatives. Evaluations are counted by the [`Search`]; all of them are at feasible points.
pub trait Optimiser {
    /// Minimises from the feasible `point`, which is replaced by the best point found.
    fn minimise(&mut self, search: &mut Search, point: &mut [f64]) -> Outcome;
}

#[cfg(test)]
pub(crate) mod testing {
    use super::*;

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
}
