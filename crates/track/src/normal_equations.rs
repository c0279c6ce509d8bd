//! Normal equations of least squares in the 22 parameters, and their solution under constraints.

use nalgebra::{SMatrix, SVector};

use super::projection::{COLUMNS, FREE, PARAMETERS, parameter};
use handcast_hand::{Finger, FreeAngles, HalfSpace};
use handcast_vision::tuning::tuning;

tuning! {
    /// How normal equations are solved.
    pub struct SolverTuning {
        /// Levenberg-Marquardt damping: share of each diagonal element that is added to it.
        ["1", "chosen by eye"]
        pub damping: f64 = 1e-3,
        /// Weight of a violated constraint, as of a residual: what it still yields is tiny.
        ["rad⁻²", "chosen by eye"]
        pub penalty: f64 = 1e6,
        /// Excess up to which a constraint counts as kept.
        ["rad", "chosen by eye"]
        pub tolerance: f64 = 1e-6,
        /// Times that the equations are solved, at most: those after the first have the constraints that the one before
        /// violated.
        ["1", "chosen by eye"]
        pub solutions: usize = 4,
    }
}

/// The normal equations A x = b of a step x of the parameters: A is the information matrix Σ w g gᵀ of residuals r with
/// gradients g, b is −Σ w r g, so that ½ xᵀ A x − bᵀ x is what the step adds to the cost.
#[derive(Clone, Debug)]
pub(super) struct NormalEquations {
    /// Its lower triangle.
    a: SMatrix<f64, PARAMETERS, PARAMETERS>,
    b: SVector<f64, PARAMETERS>,
}

/// Information that holds a parameter.
const HELD: f64 = 1e12;
/// Most constraints that are looked at.
const MOST_CONSTRAINTS: usize = 64;

impl NormalEquations {
    pub(super) fn new() -> Self {
        Self { a: SMatrix::zeros(), b: SVector::zeros() }
    }

    /// Adds ½ w (residual + gradient · x)² for a gradient given by parameter.
    pub(super) fn add(&mut self, gradient: &[(usize, f64)], residual: f64, weight: f64) {
        for (k, &(i, si)) in gradient.iter().enumerate() {
            self.b[i] -= weight * si * residual;
            for &(j, sj) in &gradient[..=k] {
                self.a[(i.max(j), i.min(j))] += weight * si * sj;
            }
        }
    }

    /// Adds to the second derivative of the cost by two parameters.
    pub(super) fn add_curvature(&mut self, i: usize, j: usize, value: f64) {
        self.a[(i.max(j), i.min(j))] += value;
    }

    /// Adds to the derivative of the cost by a parameter, at the present state.
    pub(super) fn add_gradient(&mut self, i: usize, value: f64) {
        self.b[i] -= value;
    }

    /// The derivative of the cost by a parameter, at the present state.
    #[cfg(test)]
    pub(super) fn gradient(&self, i: usize) -> f64 {
        -self.b[i]
    }

    /// A with damping: the lower triangle.
    fn damped(&self, damping: f64) -> SMatrix<f64, PARAMETERS, PARAMETERS> {
        let mut a = self.a;
        for i in 0..PARAMETERS {
            a[(i, i)] *= 1.0 + damping;
        }
        a
    }

    /// The solutions for these right-hand sides, damped; `None` where A is not positive definite.
    pub(super) fn solve<const N: usize>(
        &self,
        tuning: &SolverTuning,
        sides: &SMatrix<f64, PARAMETERS, N>,
    ) -> Option<SMatrix<f64, PARAMETERS, N>> {
        Some(self.damped(tuning.damping).cholesky()?.solve(sides))
    }

    /// The right-hand side: the gradient at the present state, with the sign turned.
    pub(super) fn right_side(&self) -> &SVector<f64, PARAMETERS> {
        &self.b
    }

    /// Holds the joint angles.
    pub(super) fn hold_angles(&mut self) {
        for i in FREE..PARAMETERS {
            self.a[(i, i)] += HELD;
        }
    }

    /// The step to the minimum under constraints on `free`, the free angles before the step, by the penalty method:
    /// constraints that the step would violate become residuals of great weight, and it is solved for again. No step
    /// where A is not positive definite.
    ///
    /// The exact method of `hand::quadratic` solves the same problem; this one is of fixed size, allocates nothing, and
    /// is exact enough for a step that is shortened and brought inside the constraints afterwards.
    pub(super) fn constrained_step(
        &self,
        tuning: &SolverTuning,
        free: &FreeAngles,
        half_spaces: &[HalfSpace],
    ) -> [f64; PARAMETERS] {
        let (mut a, mut b) = (self.damped(tuning.damping), self.b);
        let mut step = [0.0; PARAMETERS];
        let mut active = [false; MOST_CONSTRAINTS];
        for _ in 0..tuning.solutions {
            let Some(factor) = a.cholesky() else { return [0.0; PARAMETERS] };
            step.copy_from_slice(factor.solve(&b).as_slice());
            let mut violated = false;
            for (h, active) in half_spaces.iter().zip(&mut active).filter(|(_, a)| !**a) {
                let excess = h.excess(free);
                let then = excess + h.terms.iter().map(|&(i, c)| c * step[FREE + i]).sum::<f64>();
                if then > tuning.tolerance {
                    (*active, violated) = (true, true);
                    for &(i, ci) in &h.terms {
                        b[FREE + i] -= tuning.penalty * ci * excess;
                        for &(j, cj) in h.terms.iter().filter(|t| t.0 <= i) {
                            a[(FREE + i, FREE + j)] += tuning.penalty * ci * cj;
                        }
                    }
                }
            }
            if !violated {
                break;
            }
        }
        step
    }
}

/// The part of [`NormalEquations`] that points of the model make, gathered in small squares: a point moves with the
/// global parameters and those of its finger, so that most of the large square would be zeros.
#[derive(Clone, Debug)]
pub(super) struct PointSums {
    /// For the points of each finger, and last for those of the palm.
    sums: [PointSum; Finger::COUNT + 1],
    /// What points add that move with two fingers.
    between: NormalEquations,
}

/// Place of the palm's sum.
const PALM: usize = Finger::COUNT;

#[derive(Clone, Copy, Debug)]
struct PointSum {
    a: [[f64; COLUMNS]; COLUMNS],
    b: [f64; COLUMNS],
}

impl PointSums {
    pub(super) fn new() -> Self {
        let empty = PointSum { a: [[0.0; COLUMNS]; COLUMNS], b: [0.0; COLUMNS] };
        Self { sums: [empty; Finger::COUNT + 1], between: NormalEquations::new() }
    }

    /// Adds ½ w (residual + gradient · x)² for the gradient of a point by the columns of the fingers that its two ends
    /// move with.
    pub(super) fn add(
        &mut self,
        [(first, one), (second, other)]: &[(Option<Finger>, [f64; COLUMNS]); 2],
        residual: f64,
        weight: f64,
    ) {
        let finger = match (*first, *second) {
            (Some(a), Some(b)) if a != b => {
                return self.add_between([(a, one), (b, other)], residual, weight);
            }
            (a, b) => a.or(b),
        };
        let gradient: [f64; COLUMNS] = std::array::from_fn(|i| one[i] + other[i]);
        let sum = &mut self.sums[finger.map_or(PALM, |f| f as usize)];
        for ((row, b), slope) in sum.a.iter_mut().zip(&mut sum.b).zip(gradient) {
            let weighted = weight * slope;
            *b -= weighted * residual;
            for (v, other) in row.iter_mut().zip(gradient) {
                *v += weighted * other;
            }
        }
    }

    fn add_between(&mut self, ends: [(Finger, &[f64; COLUMNS]); 2], residual: f64, weight: f64) {
        let mut gradient = [(0, 0.0); 2 * COLUMNS - FREE];
        for (k, term) in gradient.iter_mut().enumerate() {
            *term = match k {
                0..FREE => (k, ends[0].1[k] + ends[1].1[k]),
                FREE..COLUMNS => (parameter(ends[0].0, k), ends[0].1[k]),
                _ => (parameter(ends[1].0, k - COLUMNS + FREE), ends[1].1[k - COLUMNS + FREE]),
            };
        }
        self.between.add(&gradient, residual, weight);
    }

    /// The whole.
    pub(super) fn into_equations(self) -> NormalEquations {
        let mut whole = self.between;
        for (sum, finger) in self.sums.iter().zip(Finger::ALL.map(Some).into_iter().chain([None])) {
            let place = |column| finger.map_or(column, |f| parameter(f, column));
            for column in 0..if finger.is_some() { COLUMNS } else { FREE } {
                let i = place(column);
                whole.b[i] += sum.b[column];
                for other in 0..=column {
                    let j = place(other);
                    whole.a[(i.max(j), i.min(j))] += sum.a[column][other];
                }
            }
        }
        whole
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::{Domain, FREE_ANGLES};

    /// Equations whose solution is `target`.
    fn around(target: &[f64; PARAMETERS]) -> NormalEquations {
        let mut equations = NormalEquations::new();
        for (i, t) in target.iter().enumerate() {
            equations.add(&[(i, 1.0)], -t, 100.0);
        }
        equations
    }

    #[test]
    fn the_step_is_found_and_kept_inside_the_constraints() {
        let (domain, tuning) = (Domain::free(), SolverTuning::default());
        let mut target = [0.01; PARAMETERS];
        let step = around(&target).constrained_step(&tuning, &[0.0; FREE_ANGLES], domain.half_spaces());
        assert!(step.iter().zip(&target).all(|(a, b)| (a - b).abs() < 1e-4));
        // The index may not bend by 100° while the middle finger stays.
        let [index, middle] = [Finger::Index, Finger::Middle].map(|f| FREE + f.free_base());
        target[index] = 1.75;
        let step = around(&target).constrained_step(&tuning, &[0.0; FREE_ANGLES], domain.half_spaces());
        assert!(step[index] < 1.75 && step[middle] > 0.02, "{step:?}");
        let free: FreeAngles = std::array::from_fn(|i| step[FREE + i]);
        assert!(!domain.is_feasible(&target[FREE..], 0.1));
        assert!(domain.is_feasible(&free, 0.01), "{free:?}");
    }

    #[test]
    fn sums_of_points_are_those_of_their_terms() {
        let gradient = |seed: f64| -> [f64; COLUMNS] { std::array::from_fn(|k| (seed + k as f64).sin()) };
        let (thumb, index) = (Some(Finger::Thumb), Some(Finger::Index));
        // The last column is the thumb's alone.
        let of_index =
            |seed: f64| std::array::from_fn(|k| if k + 1 < COLUMNS { gradient(seed)[k] } else { 0.0 });
        let mut palm = gradient(7.0);
        palm[FREE..].fill(0.0);
        let points = [
            [(thumb, gradient(1.0)), (thumb, gradient(2.0))],
            [(None, palm), (index, of_index(3.0))],
            [(index, of_index(4.0)), (thumb, gradient(5.0))],
            [(None, palm), (None, palm)],
        ];
        let (mut sums, mut expected) = (PointSums::new(), NormalEquations::new());
        for (k, point) in points.iter().enumerate() {
            let (residual, weight) = (0.3 - k as f64, 1.5 + k as f64);
            sums.add(point, residual, weight);
            let mut dense = [0.0; PARAMETERS];
            for (finger, values) in point {
                for (column, v) in values.iter().enumerate().filter(|(_, v)| **v != 0.0) {
                    dense[finger.map_or(column, |f| parameter(f, column))] += v;
                }
            }
            let terms: [_; PARAMETERS] = std::array::from_fn(|i| (i, dense[i]));
            expected.add(&terms, residual, weight);
        }
        let found = sums.into_equations();
        assert!((found.a - expected.a).abs().max() < 1e-12 && (found.b - expected.b).abs().max() < 1e-12);
    }

    #[test]
    fn held_angles_do_not_move() {
        let mut equations = around(&[0.2; PARAMETERS]);
        equations.hold_angles();
        let step = equations.constrained_step(&SolverTuning::default(), &[0.1; FREE_ANGLES], &[]);
        for (i, v) in step.into_iter().enumerate() {
            assert!((v - if i < FREE { 0.2 } else { 0.0 }).abs() < 1e-3, "{i}: {v}");
        }
    }
}
