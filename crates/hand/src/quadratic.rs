//! The exact minimum of a convex quadratic under linear constraints: the dual active-set method of Goldfarb &
//! Idnani (Mathematical Programming 27, 1983).
//!
//! It serves where the answer must keep the constraints to rounding, whatever the point is and however many
//! variables there are: projections onto a [`Domain`](super::Domain), and poses from landmarks. Registration of a
//! silhouette solves a like problem dozens of times a frame, but only for a step that is shortened and clipped
//! afterwards: it has a penalty method of its own, of fixed size and without allocations
//! (`NormalEquations::constrained_step` in the tracker), whose answers differ from these by what the penalty yields.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::HalfSpace;

/// Excess, radians, up to which a constraint counts as kept.
const TOLERANCE: f64 = 1e-12;
/// Share of a row's square below which what the active rows do not span of it is rounding.
const DEPENDENT: f64 = 1e-14;
/// Changes of the active set allowed for each constraint, and besides: only round-off needs more than a few.
const CHANGES: usize = 10;

/// The x inside all `half_spaces` that minimises (x − target)ᵀ H (x − target), `factor` being the Cholesky
/// factor of H, or none for H = 1. `None` when the half-spaces have no common point, or when round-off
/// keeps the method from ending.
pub(super) fn constrained_minimum(
    factor: Option<&Cholesky<f64, Dyn>>,
    target: DVector<f64>,
    half_spaces: &[HalfSpace],
) -> Option<DVector<f64>> {
    let n = target.len();
    let mut x = target;
    // For each active constraint: its row in the space where H is 1 (L⁻¹ c), and its multiplier.
    let mut active: Vec<(usize, DVector<f64>, f64)> = Vec::new();
    for _ in 0..CHANGES * (half_spaces.len() + 1) {
        let worst = half_spaces
            .iter()
            .enumerate()
            .map(|(i, h)| (i, h.excess(x.as_slice())))
            .filter(|(i, _)| active.iter().all(|(a, ..)| a != i))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((p, mut excess)) = worst.filter(|w| w.1 > TOLERANCE) else { return Some(x) };
        let mut row = DVector::zeros(n);
        for &(i, c) in &half_spaces[p].terms {
            row[i] += c;
        }
        if let Some(factor) = factor {
            factor.l_dirty().solve_lower_triangular_mut(&mut row);
        }
        let mut multiplier = 0.0;
        loop {
            // The part of the row that the active ones do not span, and its coefficients on them.
            let (mut free, coefficients) = match coefficients(&active, &row) {
                Some(c) => (active.iter().zip(c.iter()).fold(row.clone(), |w, (a, c)| w - &a.1 * *c), c),
                None => (row.clone(), DVector::zeros(0)),
            };
            let square = free.norm_squared();
            let full = if square > DEPENDENT * row.norm_squared() { excess / square } else { f64::INFINITY };
            let blocking = active
                .iter()
                .zip(coefficients.iter())
                .enumerate()
                .filter(|(_, (_, c))| **c > 0.0)
                .map(|(j, (a, c))| (j, a.2 / c))
                .min_by(|a, b| a.1.total_cmp(&b.1));
            let step = full.min(blocking.map_or(f64::INFINITY, |b| b.1));
            if !step.is_finite() {
                return None;
            }
            for (a, c) in active.iter_mut().zip(coefficients.iter()) {
                a.2 -= step * c;
            }
            multiplier += step;
            if full.is_finite() {
                excess -= step * square;
                if let Some(factor) = factor {
                    factor.l_dirty().tr_solve_lower_triangular_mut(&mut free);
                }
                x.axpy(-step, &free, 1.0);
            }
            match blocking {
                Some((j, t)) if t < full => {
                    active.swap_remove(j);
                }
                _ => break,
            }
        }
        active.push((p, row, multiplier));
    }
    None
}

/// The combination of the active rows nearest to `row`; `None` when there are none.
fn coefficients(active: &[(usize, DVector<f64>, f64)], row: &DVector<f64>) -> Option<DVector<f64>> {
    if active.is_empty() {
        return None;
    }
    let m = active.len();
    let gram = DMatrix::from_fn(m, m, |i, j| active[i].1.dot(&active[j].1));
    let right = DVector::from_fn(m, |i, _| active[i].1.dot(row));
    gram.cholesky().map(|c| c.solve(&right))
}
