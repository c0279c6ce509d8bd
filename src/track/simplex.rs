//! The downhill simplex of Nelder and Mead in the form of Press et al. (paper 6.3.1, fig. 13), confined to a
//! convex domain by clipping (paper 6.4.4, fig. 18).

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

    /// Minimises `f` from `point`, which is replaced by the best point found.
    ///
    /// The first simplex has the vertices p₀ + λᵢ eᵢ (eq. 9) with λ = `steps`; a vertex that would lie
    /// outside is mirrored to the other side or else clipped. `inside(from, to)` gives how much of the
    /// segment from the feasible point `from` to `to` is feasible, 0..=1. Returns the value at the best
    /// point and the number of evaluations.
    pub fn minimise(
        &mut self,
        point: &mut [f64],
        steps: &[f64],
        mut inside: impl FnMut(&[f64], &[f64]) -> f64,
        mut f: impl FnMut(&[f64]) -> f64,
    ) -> (f64, usize) {
        let n = point.len();
        debug_assert_eq!(n, steps.len());
        self.vertices.clear();
        self.values.clear();
        self.sum.resize(n, 0.0);
        self.trial.resize(n, 0.0);
        self.vertices.extend_from_slice(point);
        self.values.push(f(point));
        for i in 0..n {
            self.trial.copy_from_slice(point);
            self.trial[i] = point[i] + steps[i];
            let forward = inside(point, &self.trial);
            let mut step = forward * steps[i];
            if forward < 1.0 {
                self.trial[i] = point[i] - steps[i];
                let backward = inside(point, &self.trial);
                if backward > forward {
                    step = -backward * steps[i];
                }
            }
            self.trial[i] = point[i] + step;
            self.vertices.extend_from_slice(&self.trial);
            self.values.push(f(&self.trial));
        }
        let mut evaluations = n + 1;
        while evaluations < self.max_evaluations {
            let (mut best, mut worst, mut second) = (0, 0, 0);
            for i in 1..=n {
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
            let (low, high) = (self.values[best], self.values[worst]);
            if 2.0 * (high - low).abs() <= self.tolerance * (high.abs() + low.abs()) + 1e-12 {
                break;
            }
            for k in 0..n {
                self.sum[k] = (0..=n).map(|i| self.vertices[i * n + k]).sum();
            }
            let reflected = self.extrapolate(worst, -1.0, &mut inside, &mut f);
            evaluations += 1;
            if reflected <= low {
                self.extrapolate(worst, 2.0, &mut inside, &mut f);
                evaluations += 1;
            } else if reflected >= self.values[second] {
                let before = self.values[worst];
                let contracted = self.extrapolate(worst, 0.5, &mut inside, &mut f);
                evaluations += 1;
                if contracted >= before {
                    for i in (0..=n).filter(|&i| i != best) {
                        for k in 0..n {
                            let v = 0.5 * (self.vertices[i * n + k] + self.vertices[best * n + k]);
                            self.vertices[i * n + k] = v;
                        }
                        self.values[i] = f(&self.vertices[i * n..(i + 1) * n]);
                    }
                    evaluations += n;
                }
            }
        }
        let best = (0..=n).min_by(|&a, &b| self.values[a].total_cmp(&self.values[b])).unwrap_or(0);
        point.copy_from_slice(&self.vertices[best * n..(best + 1) * n]);
        (self.values[best], evaluations)
    }

    /// Moves the worst vertex through the face opposite to it by `factor` (−1 reflection, 2 expansion,
    /// ½ contraction), clipped at the domain, and keeps the move if it is better. Returns the value tried.
    fn extrapolate(
        &mut self,
        worst: usize,
        factor: f64,
        inside: &mut impl FnMut(&[f64], &[f64]) -> f64,
        f: &mut impl FnMut(&[f64]) -> f64,
    ) -> f64 {
        let n = self.trial.len();
        let vertex = &mut self.vertices[worst * n..(worst + 1) * n];
        let centre = (1.0 - factor) / n as f64;
        for ((trial, sum), old) in self.trial.iter_mut().zip(&self.sum).zip(vertex.iter()) {
            *trial = sum * centre - old * (centre - factor);
        }
        let t = inside(vertex, &self.trial);
        if t < 1.0 {
            for (trial, old) in self.trial.iter_mut().zip(vertex.iter()) {
                *trial = old + t * (*trial - old);
            }
        }
        let value = f(&self.trial);
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

    #[test]
    fn stays_in_a_half_space_and_reaches_its_border() {
        // Minimum of |p - (2, 2)|² under x + y ≤ 2 is (1, 1).
        let excess = |p: &[f64]| p[0] + p[1] - 2.0;
        let inside = |a: &[f64], b: &[f64]| {
            let (a, b) = (excess(a), excess(b));
            if b <= 0.0 {
                1.0
            } else if a >= 0.0 {
                0.0
            } else {
                a / (a - b)
            }
        };
        let mut seen_outside = false;
        let mut point = [0.0, -1.0];
        Downhill::new(1e-12, 2000).minimise(&mut point, &[0.3, 0.3], inside, |p| {
            seen_outside |= excess(p) > 1e-12;
            (p[0] - 2.0).powi(2) + (p[1] - 2.0).powi(2)
        });
        assert!(!seen_outside);
        assert!(excess(&point) > -0.02, "on the border: {point:?}");
    }
}
