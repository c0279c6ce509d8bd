//! Minimisation without derivatives: a problem, and its evaluations counted.

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
