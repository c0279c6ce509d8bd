//! A genetic algorithm over the parameters (Ohya & Kishino 1994; paper 6.1).

use super::jitter::jittered;
use handcast_hand::random::Random;
use handcast_track::{Optimiser, Outcome, Search};

/// A population of postures around the start. Each generation keeps the best, pairs the winners of small
/// tournaments, mixes them (which stays in the convex domain) and mutates the children less and less.
/// It works until the evaluations allowed are used up. Seeded: the same search gives the same result.
#[derive(Clone, Debug)]
pub struct Genetic {
    /// Postures in a generation.
    pub population: usize,
    /// Best postures that go on unchanged.
    pub elite: usize,
    /// Standard deviation of the first generation, and of the first mutations, in steps.
    pub deviation: f64,
    /// Chance that a parameter of a child mutates.
    pub mutation: f64,
    /// What mutations are multiplied by from one generation to the next.
    pub cooling: f64,
    /// Seed.
    pub seed: u64,
}

impl Default for Genetic {
    fn default() -> Self {
        Self { population: 40, elite: 2, deviation: 1.0, mutation: 0.35, cooling: 0.93, seed: 1 }
    }
}

/// Postures in a tournament.
const TOURNAMENT: usize = 3;
/// The random numbers of this method, apart from those of others with the same seed.
const STREAM: u64 = 11;

/// A posture and its value.
type Member = (f64, Vec<f64>);

impl Optimiser for Genetic {
    fn minimise(&mut self, search: &mut Search, point: &mut [f64]) -> Outcome {
        let mut random = Random::new(self.seed, STREAM);
        let count = self.population.max(4);
        let start = point.to_vec();
        let mut people: Vec<Member> = vec![(search.value(&start), start.clone())];
        while people.len() < count && !search.spent() {
            let p = jittered(search, &start, self.deviation, 1.0, &mut random);
            people.push((search.value(&p), p));
        }
        people.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (mut deviation, mut generations) = (0.5 * self.deviation, 0);
        while !search.spent() {
            generations += 1;
            let mut next: Vec<Member> = people[..self.elite.clamp(1, people.len())].to_vec();
            while next.len() < count && !search.spent() {
                // Sorted by value: the smallest place wins.
                let mut winner = || (0..TOURNAMENT).map(|_| random.below(people.len())).min().unwrap_or(0);
                let (a, b) = (winner(), winner());
                let child: Vec<f64> = people[a]
                    .1
                    .iter()
                    .zip(&people[b].1)
                    .map(|(a, b)| a + f64::from(random.range(0.0, 1.0)) * (b - a))
                    .collect();
                // A blend parameter by parameter may leave the domain, where the line between does not.
                let mut inside = child;
                search.clip(&people[a].1, &mut inside);
                let child = jittered(search, &inside, deviation, self.mutation, &mut random);
                next.push((search.value(&child), child));
            }
            next.sort_by(|a, b| a.0.total_cmp(&b.0));
            people = next;
            deviation *= self.cooling;
        }
        let (value, best) = &people[0];
        point.copy_from_slice(best);
        Outcome { value: *value, iterations: generations }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Valley, check};
    use super::*;

    #[test]
    fn nears_minima_inside_and_on_the_border() {
        check(&mut Genetic { deviation: 2.0, ..Genetic::default() }, 3000, 0.02, 0.05);
    }

    #[test]
    fn the_seed_decides() {
        let run = |seed| {
            let mut point = [0.0; 3];
            let mut genetic = Genetic { seed, ..Genetic::default() };
            genetic.minimise(&mut Search::new(&mut Valley::bowl(3, 4.0), 300), &mut point);
            point
        };
        assert_eq!(run(5), run(5));
        assert_ne!(run(5), run(6));
    }
}
