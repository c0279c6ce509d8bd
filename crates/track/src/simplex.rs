//! The downhill simplex of Nelder and Mead in the form of Press et al. (paper 6.3.1, fig. 13), confined to a
//! convex domain by clipping (paper 6.4.4, fig. 18).

use super::search::{Optimiser, Outcome, Problem, Search};

/// Difference of values that is rounding.
const ROUNDING: f64 = 1e-12;
/// What the worst vertex is moved by through the face opposite to it (Press et al.).
const REFLECTION: f64 = -1.0;
const EXPANSION: f64 = 2.0;
const CONTRACTION: f64 = 0.5;

/// The downhill simplex. Keeps its vertices between calls so that repeated minimisations of one
/// dimension allocate nothing.
#[derive(Clone, Debug)]
pub struct Downhill {
    /// Stop when the values at the best and the worst vertex differ by less than this fraction.
    pub tolerance: f64,
    /// Stop after this many evaluations.
    pub max_evaluations: usize,
    vertices: Vec<f64>,
    values: Vec<f64>,
    sum: Vec<f64>,
    trial: Vec<f64>,
}

impl Default for Downhill {
    fn default() -> Self {
        Self::new(1e-4, 400)
    }
}

impl Downhill {
    /// A simplex with these stopping rules.
    pub fn new(tolerance: f64, max_evaluations: usize) -> Self {
        Self {
            tolerance,
            max_evaluations,
            vertices: Vec::new(),
            values: Vec::new(),
            sum: Vec::new(),
            trial: Vec::new(),
        }
    }

    /// Minimises `f` from `point`, which is replaced by the best point found, without a count from outside.
    ///
    /// The first simplex has the vertices p₀ + λᵢ eᵢ (eq. 9) with λ = `steps`. `inside(from, to)` gives how
    /// much of the segment from the feasible point `from` to `to` is feasible, 0..=1. Returns the value at
    /// the best point and the number of evaluations.
    pub fn minimise(
        &mut self,
        point: &mut [f64],
        steps: &[f64],
        inside: impl FnMut(&[f64], &[f64]) -> f64,
        value: impl FnMut(&[f64]) -> f64,
    ) -> (f64, usize) {
        debug_assert_eq!(point.len(), steps.len());
        let mut problem = Closures { steps, inside, value };
        let mut search = Search::new(&mut problem, usize::MAX);
        let outcome = self.run(&mut search, point);
        (outcome.value, search.evaluations())
    }

    /// The first simplex; a vertex that would lie outside is mirrored to the other side or else clipped.
    fn start(&mut self, search: &mut Search, point: &[f64]) {
        let n = point.len();
        self.vertices.clear();
        self.values.clear();
        self.sum.resize(n, 0.0);
        self.trial.resize(n, 0.0);
        self.vertices.extend_from_slice(point);
        self.values.push(search.value(point));
        for i in 0..n {
            let whole = search.step(i);
            self.trial.copy_from_slice(point);
            self.trial[i] = point[i] + whole;
            let forward = search.inside(point, &self.trial);
            let mut step = forward * whole;
            if forward < 1.0 {
                self.trial[i] = point[i] - whole;
                let backward = search.inside(point, &self.trial);
                if backward > forward {
                    step = -backward * whole;
                }
            }
            self.trial[i] = point[i] + step;
            self.vertices.extend_from_slice(&self.trial);
            self.values.push(search.value(&self.trial));
        }
    }

    fn run(&mut self, search: &mut Search, point: &mut [f64]) -> Outcome {
        let n = point.len();
        self.start(search, point);
        let mut iterations = 0;
        while search.evaluations() < self.max_evaluations && !search.spent() {
            let (best, worst, second) = self.ranked();
            let (low, high) = (self.values[best], self.values[worst]);
            if 2.0 * (high - low).abs() <= self.tolerance * (high.abs() + low.abs()) + ROUNDING {
                break;
            }
            iterations += 1;
            for k in 0..n {
                self.sum[k] = (0..=n).map(|i| self.vertices[i * n + k]).sum();
            }
            let reflected = self.extrapolate(search, worst, REFLECTION);
            if reflected <= low {
                self.extrapolate(search, worst, EXPANSION);
            } else if reflected >= self.values[second] {
                let before = self.values[worst];
                if self.extrapolate(search, worst, CONTRACTION) >= before {
                    self.contract(search, best);
                }
            }
        }
        let best = (0..=n).min_by(|&a, &b| self.values[a].total_cmp(&self.values[b])).unwrap_or(0);
        point.copy_from_slice(&self.vertices[best * n..(best + 1) * n]);
        Outcome { value: self.values[best], iterations }
    }

    /// The best vertex, the worst, and the worst but one.
    fn ranked(&self) -> (usize, usize, usize) {
        let (mut best, mut worst, mut second) = (0, 0, 0);
        for i in 1..self.values.len() {
            if self.values[i] <= self.values[best] {
                best = i;
            }
            if self.values[i] > self.values[worst] {
                second = worst;
                worst = i;
            } else if i != worst && (second == worst || self.values[i] > self.values[second]) {
                second = i;
            }
        }
        (best, worst, second)
    }

    /// Brings every vertex half the way to the best (contraction in n dimensions).
    fn contract(&mut self, search: &mut Search, best: usize) {
        let n = self.trial.len();
        for i in (0..=n).filter(|&i| i != best) {
            for k in 0..n {
                self.vertices[i * n + k] = 0.5 * (self.vertices[i * n + k] + self.vertices[best * n + k]);
            }
            self.values[i] = search.value(&self.vertices[i * n..(i + 1) * n]);
        }
    }

    /// Moves the worst vertex through the face opposite to it by `factor`, clipped at the domain, and keeps the move if it is better. Returns the value tried.
    fn extrapolate(&mut self, search: &mut Search, worst: usize, factor: f64) -> f64 {
        let n = self.trial.len();
        let vertex = &mut self.vertices[worst * n..(worst + 1) * n];
        let centre = (1.0 - factor) / n as f64;
        for ((trial, sum), old) in self.trial.iter_mut().zip(&self.sum).zip(vertex.iter()) {
            *trial = sum * centre - old * (centre - factor);
        }
        search.clip(vertex, &mut self.trial);
        let value = search.value(&self.trial);
        if value < self.values[worst] {
            self.values[worst] = value;
            for ((sum, old), new) in self.sum.iter_mut().zip(vertex).zip(&self.trial) {
                *sum += new - *old;
                *old = *new;
            }
        }
        value
    }
}

impl Optimiser for Downhill {
    fn minimise(&mut self, search: &mut Search, point: &mut [f64]) -> Outcome {
        self.run(search, point)
    }
}

/// A problem given as two functions.
struct Closures<'a, I, V> {
    steps: &'a [f64],
    inside: I,
    value: V,
}

impl<I: FnMut(&[f64], &[f64]) -> f64, V: FnMut(&[f64]) -> f64> Problem for Closures<'_, I, V> {
    fn steps(&self) -> &[f64] {
        self.steps
    }

    fn inside(&mut self, from: &[f64], to: &[f64]) -> f64 {
        (self.inside)(from, to)
    }

    fn value(&mut self, point: &[f64]) -> f64 {
        (self.value)(point)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rosenbrock(p: &[f64]) -> f64 {
        (1.0 - p[0]).powi(2) + 100.0 * (p[1] - p[0] * p[0]).powi(2)
    }

    #[test]
    fn finds_the_valley_of_rosenbrock() {
        let mut point = [-1.2, 1.0];
        let (value, evaluations) =
            Downhill::new(1e-10, 1000).minimise(&mut point, &[0.5, 0.5], |_, _| 1.0, rosenbrock);
        assert!(value < 1e-8 && evaluations < 1000, "{value} after {evaluations}");
        assert!((point[0] - 1.0).abs() < 1e-3 && (point[1] - 1.0).abs() < 1e-3);
    }
}
