//! A finer surface through the same vertices.

use std::collections::HashMap;

use nalgebra::Vector3;

use super::{HandMesh, weights};
use crate::Joint;

impl HandMesh {
    /// The same surface with each triangle cut in four. The vertices stay; those between lie on an arc that
    /// the normals at their ends suggest (Boubekeur & Alexa, "Phong tessellation", 2008), so that the outline
    /// is round in large pictures.
    pub fn refined(&self) -> Self {
        let mut fine = self.clone();
        let mut middles = HashMap::new();
        fine.triangles.clear();
        for &[a, b, c] in &self.triangles {
            let [ab, bc, ca] = [(a, b), (b, c), (c, a)]
                .map(|(p, q)| *middles.entry((p.min(q), p.max(q))).or_insert_with(|| fine.push_middle(p, q)));
            fine.triangles.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        fine
    }

    /// Adds the vertex between two others and gives its number.
    fn push_middle(&mut self, a: u32, b: u32) -> u32 {
        let (i, j) = (a as usize, b as usize);
        let mean = |x: f32, y: f32| (x + y) / 2.0;
        let rows = |v: &[[f32; 3]]| [Vector3::from(v[i]), Vector3::from(v[j])];
        let ([p, q], [m, n]) = (rows(&self.positions), rows(&self.normals));
        let middle = (p + q) / 2.0;
        // Half way from the chord to the mean of its middle's feet on the two tangent planes: what an arc would have, to a few
        // hundredths.
        let lift = (m * m.dot(&(p - middle)) + n * n.dot(&(q - middle))) / 4.0;
        self.positions.push((middle + lift).into());
        self.normals.push((m + n).try_normalize(1e-9).unwrap_or(m).into());
        self.uvs.push(std::array::from_fn(|k| mean(self.uvs[i][k], self.uvs[j][k])));
        self.tints.push(std::array::from_fn(|k| mean(self.tints[i][k], self.tints[j][k])));
        self.palms.push(mean(self.palms[i], self.palms[j]));
        let mut row = [0.0; Joint::COUNT];
        for end in [i, j] {
            for (joint, weight) in self.joints[end].into_iter().zip(self.weights[end]) {
                row[usize::from(joint) % Joint::COUNT] += weight / 2.0;
            }
        }
        let (joints, weights) = weights::strongest(&row);
        self.joints.push(joints);
        self.weights.push(weights);
        self.positions.len() as u32 - 1
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{euler_characteristic, welded};
    use super::*;
    use crate::{Morphology, Side};

    #[test]
    fn a_refined_surface_is_closed_round_and_keeps_its_vertices() {
        let coarse = HandMesh::generate(&Morphology::default(), Side::Left);
        let fine = coarse.refined();
        assert_eq!(euler_characteristic(&welded(&fine)), Some(2));
        assert_eq!(fine.triangles.len(), 4 * coarse.triangles.len());
        assert_eq!(fine.positions[..coarse.positions.len()], coarse.positions[..]);
        let lists =
            [fine.normals.len(), fine.tints.len(), fine.palms.len(), fine.uvs.len(), fine.weights.len()];
        assert_eq!(lists, [fine.positions.len(); 5]);
        assert!(fine.weights.iter().all(|w| (w.iter().sum::<f32>() - 1.0).abs() < 1e-5));
    }

    #[test]
    fn middles_of_an_arc_lie_nearly_on_it() {
        let mut mesh = HandMesh::generate(&Morphology::default(), Side::Right);
        for (k, angle) in [0.0f32, 0.4].into_iter().enumerate() {
            let normal = [angle.cos(), angle.sin(), 0.0];
            mesh.positions[k] = normal;
            mesh.normals[k] = normal;
        }
        let at = mesh.push_middle(0, 1) as usize;
        let below = 1.0 - Vector3::from(mesh.positions[at]).norm();
        let chord = 1.0 - 0.2f32.cos();
        assert!(below.abs() < 0.04 * chord, "{below} of {chord}");
    }
}
