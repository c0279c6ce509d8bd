//! Local perturbation of single degrees of freedom (Mochimaru & Yamazaki 1994, Kuch & Huang 1995; paper 6.1).

use handcast_track::{Optimiser, Outcome, Search};

/// Each parameter in turn is changed by a small step; as long as the value falls the step is repeated,
/// otherwise its direction is inverted. When no parameter helps any more the steps are made smaller.
#[derive(Clone, Debug)]
pub struct Perturbation {
    /// What the steps are multiplied by when they no longer help.
    pub shrink: f64,
    /// The search ends when the steps have become this share of what they were.
    pub least: f64,
}

impl Default for Perturbation {
    fn default() -> Self {
        Self { shrink: 0.5, least: 0.03 }
    }
}

impl Optimiser for Perturbation {
    fn minimise(&mut self, search: &mut Search, point: &mut [f64]) -> Outcome {
        let mut value = search.value(point);
        // The direction that helped last is tried first.
        let mut signs = vec![1.0; point.len()];
        let (mut share, mut iterations) = (1.0, 0);
        let mut trial = point.to_vec();
        while share >= self.least && !search.spent() {
            let before = value;
            iterations += 1;
            for i in 0..point.len() {
                for _ in 0..2 {
                    let mut moved = false;
                    loop {
                        trial.copy_from_slice(point);
                        trial[i] += signs[i] * share * search.step(i);
                        search.clip(point, &mut trial);
                        if trial[i] == point[i] {
                            break;
                        }
                        let tried = search.value(&trial);
                        if tried >= value {
                            break;
                        }
                        value = tried;
                        point.copy_from_slice(&trial);
                        moved = true;
                    }
                    if moved {
                        break;
                    }
                    signs[i] = -signs[i];
                }
            }
            if value >= before {
                share *= self.shrink;
            }
        }
        Outcome { value, iterations }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::check;
    use super::*;

    #[test]
    fn finds_minima_inside_and_nears_the_border() {
        // Where the domain ends it cannot slide along the border: that takes two parameters at once.
        check(&mut Perturbation { least: 1e-3, ..Perturbation::default() }, 3000, 1e-3, 0.6);
    }
}
