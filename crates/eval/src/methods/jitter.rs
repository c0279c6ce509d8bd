//! Random changes of a point.

use handcast_hand::random::Random;
use handcast_track::Search;

/// A feasible point near the feasible point `from`: each parameter changes with the chance `change`, by a
/// normal deviate of `deviation` steps; one at least changes.
pub(super) fn jittered(
    search: &mut Search,
    from: &[f64],
    deviation: f64,
    change: f64,
    random: &mut Random,
) -> Vec<f64> {
    let always = random.below(from.len());
    let mut to = from.to_vec();
    for (i, v) in to.iter_mut().enumerate() {
        if i == always || f64::from(random.range(0.0, 1.0)) < change {
            *v += deviation * search.step(i) * f64::from(random.gauss());
        }
    }
    search.clip(from, &mut to);
    to
}
