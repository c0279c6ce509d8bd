//! Sums of squares of linear residuals in the 22 parameters, and their minimum under constraints.

use nalgebra::{SMatrix, SVector};

use super::super::projection::{COLUMNS, FREE, PARAMETERS, parameter};
use handcast_hand::{Finger, HalfSpace};

/// ½ xᵀ A x − bᵀ x for a step x of the parameters.
#[derive(Clone, Debug)]
pub(in super::super) struct Quadratic {
    /// Its lower triangle.
    a: SMatrix<f64, PARAMETERS, PARAMETERS>,
    b: SVector<f64, PARAMETERS>,
}

/// Share added to the diagonal.
const DAMPING: f64 = 1e-3;
/// Weight that holds a parameter.
const HELD: f64 = 1e12;
/// Weight of a violated constraint.
const STIFF: f64 = 1e6;
/// Most constraints that are looked at.
const MOST_CONSTRAINTS: usize = 64;

impl Quadratic {
    pub(super) fn new() -> Self {
        Self { a: SMatrix::zeros(), b: SVector::zeros() }
    }

    /// Adds ½ w (residual + slopes · x)² for slopes given by parameter.
    pub(super) fn add(&mut self, slopes: &[(usize, f64)], residual: f64, weight: f64) {
        for (k, &(i, si)) in slopes.iter().enumerate() {
            self.b[i] -= weight * si * residual;
            for &(j, sj) in &slopes[..=k] {
                self.a[(i.max(j), i.min(j))] += weight * si * sj;
            }
        }
    }

    /// Adds the second derivative by two parameters.
    pub(in super::super) fn add_square(&mut self, i: usize, j: usize, value: f64) {
        self.a[(i.max(j), i.min(j))] += value;
    }

    /// Adds the derivative by a parameter at the present state.
    pub(in super::super) fn add_slope(&mut self, i: usize, value: f64) {
        self.b[i] -= value;
    }

    /// The derivative by a parameter at the present state.
    #[cfg(test)]
    pub(super) fn slope(&self, i: usize) -> f64 {
        -self.b[i]
    }

    /// Its second derivatives, damped: the lower triangle.
    fn damped(&self) -> SMatrix<f64, PARAMETERS, PARAMETERS> {
        let mut a = self.a;
        for i in 0..PARAMETERS {
            a[(i, i)] *= 1.0 + DAMPING;
        }
        a
    }

    /// The right-hand sides divided by its second derivatives; `None` where it has no minimum.
    pub(super) fn solve<const N: usize>(
        &self,
        sides: &SMatrix<f64, PARAMETERS, N>,
    ) -> Option<SMatrix<f64, PARAMETERS, N>> {
        Some(self.damped().cholesky()?.solve(sides))
    }

    /// Its slope at the present state, with the sign turned.
    pub(super) fn downhill(&self) -> &SVector<f64, PARAMETERS> {
        &self.b
    }

    /// Holds the joint angles.
    pub(super) fn hold_fingers(&mut self) {
        for i in FREE..PARAMETERS {
            self.a[(i, i)] += HELD;
        }
    }

    /// The step to the minimum. Constraints on `free`, the free angles before the step, that it would violate
    /// are made stiff and the minimum found again; what they still yield is tiny.
    pub(super) fn minimum(&self, free: &[f64; 15], half_spaces: &[HalfSpace]) -> [f64; PARAMETERS] {
        let (mut a, mut b) = (self.damped(), self.b);
        let mut step = [0.0; PARAMETERS];
        let mut active = [false; MOST_CONSTRAINTS];
        for _ in 0..4 {
            let Some(factor) = a.cholesky() else { return [0.0; PARAMETERS] };
            step.copy_from_slice(factor.solve(&b).as_slice());
            let mut violated = false;
            for (h, active) in half_spaces.iter().zip(&mut active).filter(|(_, a)| !**a) {
                let excess = h.excess(free);
                let then = excess + h.terms.iter().map(|&(i, c)| c * step[FREE + i]).sum::<f64>();
                if then > 1e-6 {
                    (*active, violated) = (true, true);
                    for &(i, ci) in &h.terms {
                        b[FREE + i] -= STIFF * ci * excess;
                        for &(j, cj) in h.terms.iter().filter(|t| t.0 <= i) {
                            a[(FREE + i, FREE + j)] += STIFF * ci * cj;
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

/// The part of a [`Quadratic`] that points of the outline make, gathered in small squares: a point moves with the
/// global parameters and those of its finger, so that most of the large square would be zeros.
#[derive(Clone, Debug)]
pub(super) struct PointSums {
    /// For the points of each finger, and last for those of the palm.
    sums: [PointSum; 6],
    /// What points add that move with two fingers.
    between: Quadratic,
}

#[derive(Clone, Copy, Debug)]
struct PointSum {
    a: [[f64; COLUMNS]; COLUMNS],
    b: [f64; COLUMNS],
}

impl PointSums {
    pub(super) fn new() -> Self {
        let empty = PointSum { a: [[0.0; COLUMNS]; COLUMNS], b: [0.0; COLUMNS] };
        Self { sums: [empty; 6], between: Quadratic::new() }
    }

    /// Adds ½ w (residual + slopes · x)² for the slopes of a point by the columns of the fingers that its two ends
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
        let slopes: [f64; COLUMNS] = std::array::from_fn(|i| one[i] + other[i]);
        let sum = &mut self.sums[finger.map_or(5, |f| f as usize)];
        for ((row, b), slope) in sum.a.iter_mut().zip(&mut sum.b).zip(slopes) {
            let weighted = weight * slope;
            *b -= weighted * residual;
            for (v, other) in row.iter_mut().zip(slopes) {
                *v += weighted * other;
            }
        }
    }

    fn add_between(&mut self, ends: [(Finger, &[f64; COLUMNS]); 2], residual: f64, weight: f64) {
        let mut terms = [(0, 0.0); 2 * COLUMNS - FREE];
        for (k, term) in terms.iter_mut().enumerate() {
            *term = match k {
                0..FREE => (k, ends[0].1[k] + ends[1].1[k]),
                FREE..COLUMNS => (parameter(ends[0].0, k), ends[0].1[k]),
                _ => (parameter(ends[1].0, k - COLUMNS + FREE), ends[1].1[k - COLUMNS + FREE]),
            };
        }
        self.between.add(&terms, residual, weight);
    }

    /// The whole.
    pub(super) fn into_quadratic(self) -> Quadratic {
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
    use handcast_hand::Domain;

    /// A quadratic with its minimum at `target`.
    fn around(target: &[f64; PARAMETERS]) -> Quadratic {
        let mut quadratic = Quadratic::new();
        for (i, t) in target.iter().enumerate() {
            quadratic.add(&[(i, 1.0)], -t, 100.0);
        }
        quadratic
    }

    #[test]
    fn the_minimum_is_found_and_kept_inside_the_constraints() {
        let domain = Domain::free();
        let mut target = [0.01; PARAMETERS];
        let step = around(&target).minimum(&[0.0; 15], domain.half_spaces());
        assert!(step.iter().zip(&target).all(|(a, b)| (a - b).abs() < 1e-4));
        // The index may not bend by 100° while the middle finger stays.
        target[FREE + 3] = 1.75;
        let step = around(&target).minimum(&[0.0; 15], domain.half_spaces());
        assert!(step[FREE + 3] < 1.75 && step[FREE + 6] > 0.02, "{step:?}");
        let free: [f64; 15] = std::array::from_fn(|i| step[FREE + i]);
        assert!(!domain.is_feasible(&target[FREE..], 0.1));
        assert!(domain.is_feasible(&free, 0.01), "{free:?}");
    }

    #[test]
    fn sums_of_points_are_those_of_their_terms() {
        let slopes = |seed: f64| -> [f64; COLUMNS] { std::array::from_fn(|k| (seed + k as f64).sin()) };
        let (thumb, index) = (Some(Finger::Thumb), Some(Finger::Index));
        // The last column is the thumb's alone.
        let of_index =
            |seed: f64| std::array::from_fn(|k| if k + 1 < COLUMNS { slopes(seed)[k] } else { 0.0 });
        let mut palm = slopes(7.0);
        palm[FREE..].fill(0.0);
        let points = [
            [(thumb, slopes(1.0)), (thumb, slopes(2.0))],
            [(None, palm), (index, of_index(3.0))],
            [(index, of_index(4.0)), (thumb, slopes(5.0))],
            [(None, palm), (None, palm)],
        ];
        let (mut sums, mut expected) = (PointSums::new(), Quadratic::new());
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
        let found = sums.into_quadratic();
        assert!((found.a - expected.a).abs().max() < 1e-12 && (found.b - expected.b).abs().max() < 1e-12);
    }

    #[test]
    fn held_angles_do_not_move() {
        let mut quadratic = around(&[0.2; PARAMETERS]);
        quadratic.hold_fingers();
        let step = quadratic.minimum(&[0.1; 15], &[]);
        for (i, v) in step.into_iter().enumerate() {
            assert!((v - if i < FREE { 0.2 } else { 0.0 }).abs() < 1e-3, "{i}: {v}");
        }
    }
}
