//! Selection among random postures with a transition prior (Shimada et al. 1995, 1998; paper 6.1).

use super::jitter::jittered;
use handcast_hand::random::Random;
use handcast_track::{Optimiser, Outcome, Search};

/// Candidate postures are drawn around those kept of the stage before, the first around the last frame's
/// posture, and judged by their value and by how likely the transition to them is: a normal law about the
/// last frame's posture. Each stage keeps a few and draws nearer to them. Works until the evaluations
/// allowed are used up. Seeded: the same search gives the same result.
#[derive(Clone, Debug)]
pub struct Selection {
    /// Candidates of a stage.
    pub candidates: usize,
    /// How many of them are kept.
    pub kept: usize,
    /// Standard deviation of the first stage, in steps; it is also that of the transition law.
    pub deviation: f64,
    /// What the deviation is multiplied by from stage to stage.
    pub narrowing: f64,
    /// Chance that a candidate differs in a parameter.
    pub change: f64,
    /// Cost of a transition, for each parameter one deviation away.
    pub prior: f64,
    /// Seed.
    pub seed: u64,
}

impl Default for Selection {
    fn default() -> Self {
        Self { candidates: 60, kept: 5, deviation: 1.0, narrowing: 0.8, change: 0.4, prior: 1e-4, seed: 1 }
    }
}

/// The random numbers of this method, apart from those of others with the same seed.
const STREAM: u64 = 12;

struct Candidate {
    cost: f64,
    value: f64,
    point: Vec<f64>,
}

impl Optimiser for Selection {
    fn minimise(&mut self, search: &mut Search, point: &mut [f64]) -> Outcome {
        let mut random = Random::new(self.seed, STREAM);
        let start = point.to_vec();
        let wide: Vec<f64> = (0..start.len()).map(|i| self.deviation * search.step(i)).collect();
        let prior = self.prior;
        let judge = |search: &mut Search, p: Vec<f64>| {
            let value = search.value(&p);
            let far: f64 = p.iter().zip(&start).zip(&wide).map(|((a, b), w)| ((a - b) / w).powi(2)).sum();
            Candidate { cost: value + 0.5 * prior * far, value, point: p }
        };
        let mut kept = vec![judge(search, start.clone())];
        let (mut deviation, mut stages) = (self.deviation, 0);
        while !search.spent() {
            stages += 1;
            for _ in 0..self.candidates.max(1) {
                if search.spent() {
                    break;
                }
                let from = &kept[random.below(kept.len().min(self.kept.max(1)))].point;
                let candidate = jittered(search, from, deviation, self.change, &mut random);
                let judged = judge(search, candidate);
                kept.push(judged);
            }
            kept.sort_by(|a, b| a.cost.total_cmp(&b.cost));
            kept.truncate(self.kept.max(1));
            deviation *= self.narrowing;
        }
        point.copy_from_slice(&kept[0].point);
        Outcome { value: kept[0].value, iterations: stages }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Valley, check};
    use super::*;

    #[test]
    fn nears_minima_inside_and_on_the_border() {
        check(&mut Selection { deviation: 2.0, prior: 0.0, ..Selection::default() }, 3000, 0.02, 0.05);
    }

    #[test]
    fn the_prior_keeps_the_posture_near() {
        let run = |prior| {
            let mut point = [0.0; 3];
            let mut selection = Selection { prior, ..Selection::default() };
            selection.minimise(&mut Search::new(&mut Valley::bowl(3, 9.0), 600), &mut point);
            point.iter().map(|v| v * v).sum::<f64>()
        };
        assert!(run(1.0) < 0.8 * run(0.0));
    }
}
