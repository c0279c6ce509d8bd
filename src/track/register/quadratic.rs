//! Sums of squares of linear residuals in the 21 parameters, and their minimum under constraints.

use nalgebra::{SMatrix, SVector};

use super::super::projection::{COLUMNS, FREE, PARAMETERS, THUMB_MCP, parameter};
use crate::hand::{Finger, HalfSpace};

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

    /// The same for the slopes of a point of the outline, which may move with two fingers.
    pub(super) fn add_point(
        &mut self,
        slopes: &[(Option<Finger>, [f64; COLUMNS]); 2],
        residual: f64,
        weight: f64,
    ) {
        let mut terms = [(0, 0.0); 2 * COLUMNS - FREE];
        for (k, term) in terms.iter_mut().enumerate().take(FREE) {
            *term = (k, slopes[0].1[k] + slopes[1].1[k]);
        }
        let mut n = FREE;
        for (finger, values) in slopes {
            let Some(finger) = finger else { continue };
            for k in (0..COLUMNS - FREE).filter(|k| values[FREE + k] != 0.0) {
                let parameter = parameter(*finger, FREE + k);
                match terms[FREE..n].iter_mut().find(|t| t.0 == parameter) {
                    Some(term) => term.1 += values[FREE + k],
                    None => {
                        terms[n] = (parameter, values[FREE + k]);
                        n += 1;
                    }
                }
            }
        }
        self.add(&terms[..n], residual, weight);
    }

    /// Holds every parameter but those of `finger`.
    pub(super) fn hold_rest(&mut self, finger: Finger) {
        let first = FREE + 3 * finger as usize;
        let own = |i| (first..first + 3).contains(&i) || i == THUMB_MCP && finger == Finger::Thumb;
        for i in (0..PARAMETERS).filter(|&i| !own(i)) {
            self.a[(i, i)] += HELD;
        }
    }

    /// The step to the minimum. Constraints on `free`, the free angles before the step, that it would violate
    /// are made stiff and the minimum found again; what they still yield is tiny.
    pub(super) fn minimum(&self, free: &[f64; 15], half_spaces: &[HalfSpace]) -> [f64; PARAMETERS] {
        let Self { mut a, mut b } = self.clone();
        for i in 0..PARAMETERS {
            a[(i, i)] *= 1.0 + DAMPING;
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::Domain;

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
    fn held_parameters_do_not_move() {
        let mut quadratic = around(&[0.2; PARAMETERS]);
        quadratic.hold_rest(Finger::Ring);
        let step = quadratic.minimum(&[0.1; 15], &[]);
        for (i, v) in step.into_iter().enumerate() {
            let own = (FREE + 9..FREE + 12).contains(&i);
            assert!((v - if own { 0.2 } else { 0.0 }).abs() < 1e-3, "{i}: {v}");
        }
    }
}
