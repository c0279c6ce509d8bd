//! Powell's direction set (paper 6.3.2, after Press et al.), with line searches confined to the domain.

use handcast_track::{Optimiser, Outcome, Search};

/// Powell's method: minimisation along one direction after the other; then along the whole way covered
/// (eq. 10), which takes the place of the direction that gained most.
#[derive(Clone, Debug)]
pub struct Powell {
    /// Stop when a round over all directions gains less than this fraction of the value.
    pub tolerance: f64,
    /// A line search ends when the minimum is known to this share of a step.
    pub line_tolerance: f64,
}

impl Default for Powell {
    fn default() -> Self {
        Self { tolerance: 1e-3, line_tolerance: 0.002 }
    }
}

impl Optimiser for Powell {
    fn minimise(&mut self, search: &mut Search, point: &mut [f64]) -> Outcome {
        let n = point.len();
        let mut directions: Vec<Vec<f64>> =
            (0..n).map(|i| (0..n).map(|k| if i == k { search.step(i) } else { 0.0 }).collect()).collect();
        let mut value = search.value(point);
        let mut iterations = 0;
        while !search.spent() {
            let (before, from) = (value, point.to_vec());
            let mut most = (0.0, 0);
            for (i, direction) in directions.iter().enumerate() {
                let last = value;
                value = self.along(search, point, direction, value);
                iterations += 1;
                if last - value > most.0 {
                    most = (last - value, i);
                }
            }
            if 2.0 * (before - value) <= self.tolerance * (before.abs() + value.abs()) + ROUNDING {
                break;
            }
            if n > 1 {
                let covered: Vec<f64> = point.iter().zip(&from).map(|(a, b)| a - b).collect();
                value = self.along(search, point, &covered, value);
                iterations += 1;
                directions[most.1] = covered;
            }
        }
        Outcome { value, iterations }
    }
}

/// A point on the line: how many directions from the start, and the value there.
type Sample = (f64, f64);

/// The golden section: how much a bracket grows, and what share of it a step takes.
const GOLDEN: f64 = 1.618_034;
const SECTION: f64 = 0.381_966;
/// Evaluations of one line search, at most.
const MOST_EVALUATIONS: usize = 40;
/// Directions below which a line has no length.
const NO_ROOM: f64 = 1e-9;
/// Difference of values that is rounding.
const ROUNDING: f64 = 1e-12;

impl Powell {
    /// Goes to the minimum along `direction` in the domain; gives the value there.
    fn along(&self, search: &mut Search, point: &mut [f64], direction: &[f64], value: f64) -> f64 {
        let at = |t: f64| -> Vec<f64> { point.iter().zip(direction).map(|(p, d)| p + t * d).collect() };
        // Far enough to reach any limit, near enough that the share of it is exact.
        const REACH: f64 = 64.0;
        let low = -REACH * search.inside(point, &at(-REACH));
        let high = REACH * search.inside(point, &at(REACH));
        let mut f = |t: f64| search.value(&at(t));
        let Some((a, b, c)) = bracket(&mut f, value, low, high) else { return value };
        let best = brent(&mut f, a, b, c, self.line_tolerance);
        if best.1 >= value {
            return value;
        }
        let there = at(best.0);
        point.copy_from_slice(&there);
        best.1
    }
}

/// Three places in `low..=high` with the least value in the middle one, or at the end where the domain
/// ends. `None` when there is no room.
fn bracket(
    f: &mut impl FnMut(f64) -> f64,
    value: f64,
    low: f64,
    high: f64,
) -> Option<(Sample, Sample, Sample)> {
    let zero = (0.0, value);
    let mut next = |t: f64| {
        let t = t.clamp(low, high);
        (t, f(t))
    };
    if high - low < NO_ROOM {
        return None;
    }
    let first = next(if high > NO_ROOM { 1.0 } else { -1.0 });
    let (mut back, mut here) = if first.1 < value { (zero, first) } else { (first, zero) };
    loop {
        let ahead = next(here.0 + GOLDEN * (here.0 - back.0));
        // At a limit, or uphill again.
        if ahead.0 == here.0 || ahead.1 >= here.1 {
            return Some((back, here, ahead));
        }
        (back, here) = (here, ahead);
    }
}

/// Brent's method: parabolas through the three best places, golden sections where they do not help.
fn brent(f: &mut impl FnMut(f64) -> f64, a: Sample, b: Sample, c: Sample, tolerance: f64) -> Sample {
    let (mut low, mut high) = (a.0.min(c.0), a.0.max(c.0));
    let (mut best, mut second, mut third) = if a.1 < c.1 { (b, a, c) } else { (b, c, a) };
    let (mut step, mut last) = (high - low, high - low);
    for _ in 0..MOST_EVALUATIONS {
        let middle = 0.5 * (low + high);
        if high - low <= 2.0 * tolerance || (best.0 - middle).abs() + 0.5 * (high - low) <= 2.0 * tolerance {
            break;
        }
        let r = (best.0 - second.0) * (best.1 - third.1);
        let q = (best.0 - third.0) * (best.1 - second.1);
        let mut p = (best.0 - third.0) * q - (best.0 - second.0) * r;
        let mut q = 2.0 * (q - r);
        if q > 0.0 {
            p = -p;
        }
        q = q.abs();
        let fits = p.abs() < (0.5 * q * last).abs() && p > q * (low - best.0) && p < q * (high - best.0);
        last = step;
        if fits {
            step = p / q;
        } else {
            last = if best.0 >= middle { low - best.0 } else { high - best.0 };
            step = SECTION * last;
        }
        if step.abs() < tolerance {
            step = tolerance.copysign(step);
        }
        let t = (best.0 + step).clamp(low, high);
        if t == best.0 {
            break;
        }
        let tried = (t, f(t));
        if !tried.1.is_finite() {
            break;
        }
        if tried.1 <= best.1 {
            if t >= best.0 {
                low = best.0
            } else {
                high = best.0
            }
            (best, second, third) = (tried, best, second);
        } else {
            if t < best.0 {
                low = t
            } else {
                high = t
            }
            if tried.1 <= second.1 || second.0 == best.0 {
                (second, third) = (tried, second);
            } else if tried.1 <= third.1 || third.0 == best.0 || third.0 == second.0 {
                third = tried;
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Valley, check};
    use super::*;

    #[test]
    fn finds_minima_inside_and_nears_the_border() {
        // A direction that leads out of the domain is of no use at its border.
        check(&mut Powell { tolerance: 1e-7, line_tolerance: 1e-3 }, 3000, 1e-3, 0.6);
    }

    #[test]
    fn follows_the_valley_of_rosenbrock() {
        let mut valley = Valley::rosenbrock();
        let mut point = [-1.2, 1.0];
        let mut powell = Powell { tolerance: 1e-9, line_tolerance: 1e-4 };
        let outcome = powell.minimise(&mut Search::new(&mut valley, 3000), &mut point);
        assert!(outcome.value < 1e-4, "{outcome:?} at {point:?}");
    }
}
