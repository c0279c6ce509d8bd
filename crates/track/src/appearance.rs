//! How well the shading of the model explains the luminance inside the silhouette.
//!
//! Skin is nearly matt, and under any distant light its luminance is close to a linear function of the
//! surface normal (Ramamoorthi & Hanrahan 2001, first order). That function is fitted to the picture for each
//! posture that is compared: what it leaves unexplained tells postures apart that have the same silhouette. Its
//! slope turns the bones. Creases and relief, which it cannot explain, are learnt while the hand is open.

mod surface;

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::cover::{COARSE, Cover};
use super::evidence::Evidence;
use super::projection::{FREE, ProjectedSphere, TURN, Turns, parameter};
use super::register::Quadratic;
use handcast_hand::{Primitive, Shape};
use surface::{CELLS, Surface};

/// Terms of the fit: a constant, the normal, and another constant for the palm.
const TERMS: usize = 5;
/// Luminance that noise and texture leave unexplained, levels.
const NOISE: f32 = 4.0;
/// Errors beyond this are shadows or things the model lacks, levels.
const OUTLIER: f32 = 30.0;
/// Samples that a cell remembers.
const LONGEST_MEMORY: u16 = 200;
/// Every how many squares of the picture one is looked at, each way.
const STRIDE: usize = 2;

/// A model in front of a picture.
#[derive(Clone, Copy)]
pub(super) struct Shaded<'a> {
    pub(super) primitives: &'a [Primitive],
    pub(super) spheres: &'a [ProjectedSphere],
    /// Pixels per metre at the wrist.
    pub(super) scale: f64,
    pub(super) evidence: &'a Evidence,
}

/// A sample of the picture.
#[derive(Clone, Copy, Debug)]
struct Row {
    terms: [f32; TERMS],
    /// Luminance without what is known of its cell.
    value: f32,
    /// The primitive in front.
    part: usize,
    /// The cell of its surface.
    cell: usize,
}

/// What is known of a part of the surface.
#[derive(Clone, Copy, Debug, Default)]
struct Cell {
    /// Mean luminance beyond shading, levels.
    mean: f32,
    seen: u16,
}

/// What shading explains.
#[derive(Clone, Copy, Debug)]
struct Explained {
    /// Luminance for each term.
    light: [f32; TERMS],
    /// Mean square of what is left, levels².
    left: f64,
}

/// Fits shading to luminance. Holds the buffers, and what has been learnt of the hand's look.
#[derive(Clone, Debug, Default)]
pub(super) struct Appearance {
    /// Which part of the model is in front.
    cover: Cover,
    surfaces: Vec<Surface>,
    rows: Vec<Row>,
    /// For each primitive the slope and the square of its turn.
    turned: Vec<(Vector3<f32>, Matrix3<f32>)>,
    /// For each primitive the cells of its surface.
    look: Vec<[Cell; CELLS]>,
}

impl Appearance {
    /// The mean square of luminance left unexplained, levels², robustly; `None` without a picture or model.
    pub(super) fn unexplained(&mut self, shaded: &Shaded<'_>) -> Option<f64> {
        self.explain(shaded).map(|e| e.left)
    }

    /// Adds how what shading leaves unexplained changes when the parts of the model turn, as if the hand were worth
    /// `worth` independent samples. `turns` says how the parameters turn the bones.
    ///
    /// A part that turns by a small vector ω changes its normals n by ω × n and its luminance by
    /// ω · (n × light), so that a vector and a matrix for each part hold all there is to know.
    pub(super) fn pull(&mut self, shaded: &Shaded<'_>, turns: &Turns, worth: f64, quadratic: &mut Quadratic) {
        let Some(Explained { light, left }) = self.explain(shaded) else { return };
        let along = Vector3::new(light[1], light[2], light[3]);
        self.turned.clear();
        self.turned.resize(shaded.primitives.len(), (Vector3::zeros(), Matrix3::zeros()));
        for row in &self.rows {
            let residual = row.value - product(&light, &row.terms);
            let Some((slope, square)) = self.turned.get_mut(row.part).filter(|_| residual.abs() <= OUTLIER)
            else {
                continue;
            };
            let by_turn = along.cross(&Vector3::new(row.terms[1], row.terms[2], row.terms[3]));
            *slope += by_turn * residual;
            *square += by_turn * by_turn.transpose();
        }
        let weight = worth / (self.rows.len() as f64 * left);
        for (part, (slope, square)) in self.turned.iter().enumerate() {
            let whole = (0..3).map(|k| (TURN + k, Vector3::ith(k, 1.0)));
            let bone = Shape::bone(part).into_iter().flat_map(|(finger, bone)| {
                let columns = turns[finger as usize][bone].into_iter().enumerate();
                columns.map(move |(k, axis)| (parameter(finger, FREE + k), axis))
            });
            let axes = whole.chain(bone);
            for (n, (i, a)) in axes.clone().enumerate() {
                quadratic.add_slope(i, weight * f64::from(a.dot(slope)));
                let turned = square * a;
                for (j, b) in axes.clone().take(n + 1) {
                    quadratic.add_square(i, j, weight * f64::from(b.dot(&turned)));
                }
            }
        }
    }

    /// Learns what shading leaves unexplained, creases and the relief of the palm, by cells of the model's surface:
    /// to be called where the posture is certain.
    pub(super) fn learn(&mut self, shaded: &Shaded<'_>) {
        let Some(Explained { light, .. }) = self.explain(shaded) else { return };
        for row in &self.rows {
            let more = (row.value - product(&light, &row.terms)).clamp(-OUTLIER, OUTLIER);
            if let Some(cell) = self.look.get_mut(row.part).and_then(|cells| cells.get_mut(row.cell)) {
                cell.seen = (cell.seen + 1).min(LONGEST_MEMORY);
                cell.mean += more / f32::from(cell.seen);
            }
        }
    }

    fn explain(&mut self, shaded: &Shaded<'_>) -> Option<Explained> {
        let Shaded { primitives, spheres, scale, evidence } = *shaded;
        let (luma, width) = evidence.coarse_luma();
        if luma.is_empty() {
            return None;
        }
        self.cover.draw(primitives, spheres, scale, evidence.window(), STRIDE);
        let origin = evidence.window().origin();
        self.look.resize(primitives.len(), [Cell::default(); CELLS]);
        self.surfaces.clear();
        self.surfaces.extend(primitives.iter().map(|p| Surface::of(p, spheres, origin, scale)));
        self.rows.clear();
        let silhouette = evidence.window().silhouette();
        for (part, [x, y]) in self.cover.squares() {
            let place = [x, y].map(|v| (v as f32 + 0.5) * COARSE as f32);
            if !silhouette.get(place[0] as u32, place[1] as u32) {
                continue;
            }
            let known = self.surfaces.get(part).zip(self.look.get(part)).zip(luma.get(y * width + x));
            let Some(((surface, look), value)) = known else { continue };
            let n = surface.normal(place);
            let cell = surface.cell(place);
            let known = look.get(cell).map_or(0.0, |c| c.mean);
            let terms = [1.0, n[0], n[1], n[2], f32::from(u8::from(surface.flat))];
            self.rows.push(Row { terms, value: value - known, part, cell });
        }
        self.fit()
    }

    /// Least squares, once more without the outliers, and what remains.
    fn fit(&self) -> Option<Explained> {
        if self.rows.len() < 50 {
            return None;
        }
        let mut solution: Option<[f32; TERMS]> = None;
        for _ in 0..2 {
            let mut a = SMatrix::<f32, TERMS, TERMS>::zeros();
            let mut b = SVector::<f32, TERMS>::zeros();
            for Row { terms, value, .. } in &self.rows {
                if solution.is_some_and(|s| (value - product(&s, terms)).abs() > OUTLIER) {
                    continue;
                }
                for i in 0..TERMS {
                    b[i] += terms[i] * value;
                    for j in 0..=i {
                        a[(i, j)] += terms[i] * terms[j];
                    }
                }
            }
            for i in 0..TERMS {
                a[(i, i)] += 1.0;
                for j in 0..i {
                    a[(j, i)] = a[(i, j)];
                }
            }
            let x = a.cholesky()?.solve(&b);
            solution = Some(std::array::from_fn(|i| x[i]));
        }
        let solution = solution?;
        let left: f32 = self
            .rows
            .iter()
            .map(|Row { terms, value, .. }| {
                (value - product(&solution, terms)).powi(2).min(OUTLIER * OUTLIER)
            })
            .sum();
        let left = f64::from(left / self.rows.len() as f32 + NOISE * NOISE);
        Some(Explained { light: solution, left })
    }
}

fn product(a: &[f32; TERMS], b: &[f32; TERMS]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
