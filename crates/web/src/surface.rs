//! The skin of a hand as blocks of bytes that JavaScript copies out of memory.

use handcast_hand::{HandMesh, Morphology, PackedHand, Side};

/// A surface: see [`PackedHand`].
#[derive(Clone, Debug, Default)]
pub struct Surface {
    /// 32 bytes a vertex.
    pub vertices: Vec<u8>,
    /// Corners of triangles.
    pub triangles: Vec<u32>,
    /// Cube, crease width, creases, nails, lines, offsets of joints, inverse bind matrices.
    pub numbers: Vec<f32>,
    /// Where these seven groups end.
    pub ends: Vec<u32>,
}

impl Surface {
    /// The surface of a hand: some 16 000 vertices where it is `fine`, a quarter of them otherwise.
    pub fn new(sizes: &Morphology, side: Side, fine: bool) -> Self {
        let mesh = HandMesh::generate(sizes, side);
        let packed = PackedHand::new(&if fine { mesh.refined() } else { mesh });
        let (mut numbers, mut ends) = (Vec::new(), Vec::new());
        let groups: [&[f32]; 7] = [
            &packed.cube,
            &[packed.crease_width],
            &packed.creases,
            &packed.nails,
            &packed.lines,
            packed.offsets.as_flattened(),
            packed.inverse_bind.as_flattened(),
        ];
        for group in groups {
            numbers.extend_from_slice(group);
            ends.push(numbers.len() as u32);
        }
        Self { vertices: packed.vertices, triangles: packed.triangles, numbers, ends }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_follow_one_another() {
        let surface = Surface::new(&Morphology::default(), Side::Left, false);
        assert_eq!(surface.vertices.len() % 32, 0);
        let vertices = surface.vertices.len() as u32 / 32;
        assert!(vertices > 2000 && surface.triangles.iter().all(|&corner| corner < vertices));
        assert_eq!(surface.ends[..2], [4, 5]);
        let lengths: Vec<u32> = surface.ends.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert_eq!(lengths[1..], [12 * 18, 12 * 5, 48, 75, 300]);
        assert_eq!(surface.ends[6] as usize, surface.numbers.len());
    }
}
