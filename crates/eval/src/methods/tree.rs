//! Search of a tree over the discretised space (Gavrila & Davis 1996; paper 6.1).

use handcast_track::{Optimiser, Outcome, Search};

/// The space is cut into a lattice about the start. A level of the tree settles one group of parameters,
/// coarse groups first; a node's children are the lattice points of that group next to the node's, and a
/// few best nodes of a level are followed. At the leaves the lattice is made finer and the tree is
/// searched again from the best leaf.
#[derive(Clone, Debug)]
pub struct Tree {
    /// Nodes of a level that are followed.
    pub beam: usize,
    /// Parameters that are varied together; a larger group becomes several levels.
    pub together: usize,
    /// What the lattice's spacing is multiplied by for the next search.
    pub refinement: f64,
    /// The search ends when the spacing has become this share of a step.
    pub least: f64,
}

impl Default for Tree {
    fn default() -> Self {
        Self { beam: 3, together: 2, refinement: 0.5, least: 0.03 }
    }
}

type Node = (f64, Vec<f64>);

impl Optimiser for Tree {
    fn minimise(&mut self, search: &mut Search, point: &mut [f64]) -> Outcome {
        let levels: Vec<Vec<usize>> = search
            .groups()
            .into_iter()
            .flat_map(|g| {
                g.collect::<Vec<_>>().chunks(self.together.max(1)).map(<[usize]>::to_vec).collect::<Vec<_>>()
            })
            .collect();
        let mut best: Node = (search.value(point), point.to_vec());
        let (mut spacing, mut trees) = (1.0, 0);
        while spacing >= self.least && !search.spent() {
            trees += 1;
            let before = best.0;
            let mut nodes = vec![best.clone()];
            for level in &levels {
                nodes = self.expand(search, nodes, level, spacing);
            }
            best = nodes.swap_remove(0);
            // A tree that found something better is searched again at the same spacing.
            if best.0 >= before {
                spacing *= self.refinement;
            }
        }
        point.copy_from_slice(&best.1);
        Outcome { value: best.0, iterations: trees }
    }
}

impl Tree {
    /// The best of the nodes and their children along the parameters of a level.
    fn expand(&self, search: &mut Search, nodes: Vec<Node>, level: &[usize], spacing: f64) -> Vec<Node> {
        let children = 3usize.saturating_pow(level.len() as u32);
        let mut found = Vec::new();
        for node in nodes {
            for code in 1..children {
                let mut p = node.1.clone();
                let mut rest = code;
                for &i in level {
                    // 0 stays, 1 goes up, 2 goes down.
                    p[i] += [0.0, 1.0, -1.0][rest % 3] * spacing * search.step(i);
                    rest /= 3;
                }
                if search.spent() || search.inside(&node.1, &p) < 1.0 {
                    continue;
                }
                found.push((search.value(&p), p));
            }
            found.push(node);
        }
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        found.dedup_by(|a, b| a.1 == b.1);
        found.truncate(self.beam.max(1));
        found
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::check;
    use super::*;

    #[test]
    fn finds_minima_inside_and_nears_the_border() {
        check(&mut Tree { least: 1e-3, ..Tree::default() }, 6000, 1e-3, 0.6);
    }
}
