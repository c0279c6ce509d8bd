//! How well the shading of the model explains the luminance inside the silhouette.
//!
//! Skin is nearly matt, and under any distant light its luminance is close to a linear function of the
//! surface normal (Ramamoorthi & Hanrahan 2001, first order). That function is fitted to the picture for each
//! posture that is compared: its residuals tell postures apart that have the same silhouette, and their gradient turns
//! the bones. Creases and relief, which it cannot explain, are learnt while the hand is open.

mod surface;

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::cover::{COARSE, Cover};
use super::evidence::Evidence;
use super::normal_equations::NormalEquations;
use super::projection::{FREE, ProjectedSphere, TURN, Turns, parameter};
use handcast_hand::{Primitive, Shape};
use handcast_vision::tuning::tuning;
use surface::{CELLS, Surface};

/// Terms of the fit: a constant, the normal, and another constant for the palm.
const TERMS: usize = 5;

tuning! {
    /// How shading is fitted to luminance, and how much it counts.
    pub struct AppearanceTuning {
        /// Independent samples of luminance as which the hand counts when postures are compared.
        ["samples", "spec/registration.md 5, Choice"]
        pub compared_samples: f64 = 200.0,
        /// Independent samples of luminance as which it counts when bones are turned.
        ["samples", "spec/experiments.md, Refined sizes, limited tilt, weaker shading"]
        pub gradient_samples: f64 = 50.0,
        /// Standard deviation of luminance that noise and texture leave.
        ["levels", "chosen by eye"]
        pub noise: f32 = 4.0,
        /// Residuals beyond this are shadows or things the model lacks.
        ["levels", "chosen by eye"]
        pub outlier: f32 = 30.0,
        /// Added to the diagonal of the fit's normal equations: samples seen of a normal of 0.
        ["samples", "chosen by eye"]
        pub ridge: f32 = 1.0,
        /// Fewest samples that a light is fitted to.
        ["samples", "chosen by eye"]
        pub fewest: usize = 50,
        /// Every how many squares of the picture one is sampled, each way.
        ["squares of 2 pixels", "spec/experiments.md, Speed"]
        pub stride: usize = 2,
        /// Samples that a cell's mean is taken over, at most.
        ["samples", "chosen by eye"]
        pub memory: u16 = 200,
        /// Difference of every joint angle from the open hand within which relief is learnt.
        ["rad", "spec/registration.md 5, Shading"]
        pub learnt_within: f64 = 0.3,
    }
}

/// A model in front of a picture.
#[derive(Clone, Copy)]
pub(super) struct ShadedModel<'a> {
    pub(super) primitives: &'a [Primitive],
    pub(super) spheres: &'a [ProjectedSphere],
    /// Pixels per metre at the wrist.
    pub(super) scale: f64,
    pub(super) evidence: &'a Evidence,
}

/// How well a model explains the picture.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Explained {
    /// The negative logarithm of the likelihood of the picture, but for a constant: that of samples whose variance is
    /// that of the residuals.
    pub(super) cost: f64,
    /// Share of that variance, 0 to 1, that is not noise: where it is small, as in the dark, nothing tells models apart.
    pub(super) beyond_noise: f64,
}

/// A sample of the picture.
#[derive(Clone, Copy, Debug)]
struct LumaSample {
    terms: [f32; TERMS],
    /// Luminance without the relief of its cell.
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
    samples: u16,
}

/// Shading fitted to a picture.
#[derive(Clone, Copy, Debug)]
struct ShadingFit {
    /// Luminance for each term.
    light: [f32; TERMS],
    /// Mean square of the residuals and of the noise, levels².
    variance: f64,
}

/// Fits shading to luminance. Holds the buffers, and the relief that has been learnt of the hand.
#[derive(Clone, Debug, Default)]
pub(super) struct Appearance {
    tuning: AppearanceTuning,
    /// Which part of the model is in front.
    cover: Cover,
    surfaces: Vec<Surface>,
    samples: Vec<LumaSample>,
    /// For each primitive gradient and curvature by its turn.
    by_turn: Vec<(Vector3<f32>, Matrix3<f32>)>,
    pub(super) relief: Relief,
}

/// What shading leaves of a hand: for each primitive the cells of its surface.
#[derive(Clone, Debug, Default)]
pub(super) struct Relief(Vec<[Cell; CELLS]>);

impl Appearance {
    /// An appearance without relief.
    pub(super) fn new(tuning: AppearanceTuning) -> Self {
        Self { tuning, ..Self::default() }
    }

    /// How well the picture is explained. Nothing of it without a picture or model.
    pub(super) fn rate(&mut self, shaded: &ShadedModel<'_>) -> Explained {
        let AppearanceTuning { compared_samples, noise, .. } = self.tuning;
        self.fit(shaded).map_or_else(Explained::default, |fit| Explained {
            cost: 0.5 * compared_samples * fit.variance.ln(),
            beyond_noise: 1.0 - f64::from(noise * noise) / fit.variance,
        })
    }

    /// Adds how the residuals of shading change when the parts of the model turn. `turns` says how the parameters turn
    /// the bones.
    ///
    /// A part that turns by a small vector ω changes its normals n by ω × n and its luminance by
    /// ω · (n × light), so that a vector and a matrix for each part hold all there is to know.
    pub(super) fn add_to(
        &mut self,
        equations: &mut NormalEquations,
        shaded: &ShadedModel<'_>,
        turns: &Turns,
    ) {
        let Some(ShadingFit { light, variance }) = self.fit(shaded) else { return };
        let along = Vector3::new(light[1], light[2], light[3]);
        self.by_turn.clear();
        self.by_turn.resize(shaded.primitives.len(), (Vector3::zeros(), Matrix3::zeros()));
        let outlier = self.tuning.outlier;
        for sample in &self.samples {
            let residual = sample.value - product(&light, &sample.terms);
            let Some((gradient, square)) =
                self.by_turn.get_mut(sample.part).filter(|_| residual.abs() <= outlier)
            else {
                continue;
            };
            let by_turn = along.cross(&Vector3::new(sample.terms[1], sample.terms[2], sample.terms[3]));
            *gradient += by_turn * residual;
            *square += by_turn * by_turn.transpose();
        }
        let weight = self.tuning.gradient_samples / (self.samples.len() as f64 * variance);
        for (part, (gradient, square)) in self.by_turn.iter().enumerate() {
            let whole = (0..3).map(|k| (TURN + k, Vector3::ith(k, 1.0)));
            let bone = Shape::bone(part).into_iter().flat_map(|(finger, bone)| {
                let columns = turns[finger as usize][bone].into_iter().enumerate();
                columns.map(move |(k, axis)| (parameter(finger, FREE + k), axis))
            });
            let axes = whole.chain(bone);
            for (n, (i, a)) in axes.clone().enumerate() {
                equations.add_gradient(i, weight * f64::from(a.dot(gradient)));
                let turned = square * a;
                for (j, b) in axes.clone().take(n + 1) {
                    equations.add_curvature(i, j, weight * f64::from(b.dot(&turned)));
                }
            }
        }
    }

    /// Learns what shading leaves, creases and the relief of the palm, by cells of the model's surface: to be called
    /// where the posture is certain.
    pub(super) fn learn(&mut self, shaded: &ShadedModel<'_>) {
        let Some(ShadingFit { light, .. }) = self.fit(shaded) else { return };
        let AppearanceTuning { outlier, memory, .. } = self.tuning;
        for sample in &self.samples {
            let residual = (sample.value - product(&light, &sample.terms)).clamp(-outlier, outlier);
            if let Some(cell) =
                self.relief.0.get_mut(sample.part).and_then(|cells| cells.get_mut(sample.cell))
            {
                cell.samples = (cell.samples + 1).min(memory);
                cell.mean += residual / f32::from(cell.samples);
            }
        }
    }

    fn fit(&mut self, shaded: &ShadedModel<'_>) -> Option<ShadingFit> {
        let ShadedModel { primitives, spheres, scale, evidence } = *shaded;
        let (luma, width) = evidence.coarse_luma();
        if luma.is_empty() {
            return None;
        }
        self.cover.draw(primitives, spheres, scale, evidence.window(), self.tuning.stride);
        let origin = evidence.window().origin();
        self.relief.0.resize(primitives.len(), [Cell::default(); CELLS]);
        self.surfaces.clear();
        self.surfaces.extend(primitives.iter().map(|p| Surface::of(p, spheres, origin, scale)));
        self.samples.clear();
        let silhouette = evidence.window().silhouette();
        for (part, [x, y]) in self.cover.squares() {
            let place = [x, y].map(|v| (v as f32 + 0.5) * COARSE as f32);
            if !silhouette.get(place[0] as u32, place[1] as u32) {
                continue;
            }
            let known = self.surfaces.get(part).zip(self.relief.0.get(part)).zip(luma.get(y * width + x));
            let Some(((surface, relief), value)) = known else { continue };
            let n = surface.normal(place);
            let cell = surface.cell(place);
            let known = relief.get(cell).map_or(0.0, |c| c.mean);
            let terms = [1.0, n[0], n[1], n[2], f32::from(u8::from(surface.flat))];
            self.samples.push(LumaSample { terms, value: value - known, part, cell });
        }
        self.solve()
    }

    /// Least squares, once more without the outliers, and the variance of what remains.
    fn solve(&self) -> Option<ShadingFit> {
        let AppearanceTuning { outlier, noise, ridge, fewest, .. } = self.tuning;
        if self.samples.len() < fewest {
            return None;
        }
        let mut solution: Option<[f32; TERMS]> = None;
        for _ in 0..2 {
            let mut a = SMatrix::<f32, TERMS, TERMS>::zeros();
            let mut b = SVector::<f32, TERMS>::zeros();
            for LumaSample { terms, value, .. } in &self.samples {
                if solution.is_some_and(|s| (value - product(&s, terms)).abs() > outlier) {
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
                a[(i, i)] += ridge;
                for j in 0..i {
                    a[(j, i)] = a[(i, j)];
                }
            }
            let x = a.cholesky()?.solve(&b);
            solution = Some(std::array::from_fn(|i| x[i]));
        }
        let light = solution?;
        let left: f32 = self
            .samples
            .iter()
            .map(|LumaSample { terms, value, .. }| {
                (value - product(&light, terms)).powi(2).min(outlier * outlier)
            })
            .sum();
        let variance = f64::from(left / self.samples.len() as f32 + noise * noise);
        Some(ShadingFit { light, variance })
    }
}

fn product(a: &[f32; TERMS], b: &[f32; TERMS]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
