//! The pixels of one picture while its silhouette is sought.

use image::{GrayImage, RgbImage};

use super::local_colour::LocalColour;
use super::{ColourModel, Mask, OutlineTuning, SegmentOptions};
use crate::colour::{cell, chromaticity, limited, ycc};
use crate::morphology::{Components, dilate, erode, invert};

/// Per-pixel working data of one picture, kept between frames.
#[derive(Clone, Debug, Default)]
pub(crate) struct LikelihoodField {
    size: (usize, usize),
    /// Luma and chroma.
    colours: Vec<[u8; 3]>,
    /// Log-likelihood ratio of skin.
    ratios: Vec<f32>,
    smooth: Vec<f32>,
    scratch: Vec<f32>,
    skin: LocalColour,
    background: LocalColour,
}

/// One row of a picture: luma and chroma, and the colours themselves.
pub(crate) struct Row<'a> {
    pub(crate) ycc: &'a [[u8; 3]],
    pub(crate) rgb: &'a [[u8; 3]],
}

impl LikelihoodField {
    pub(super) fn load(&mut self, image: &RgbImage, model: &ColourModel) {
        self.load_with(image, |_, row, ratios| {
            ratios.extend(row.ycc.iter().map(|&colour| model.ratio(cell(colour))));
        });
    }

    /// Loads a picture with the log-likelihood ratios that `append` gives for each of its rows.
    pub(crate) fn load_with(
        &mut self,
        image: &RgbImage,
        mut append: impl FnMut(u32, Row<'_>, &mut Vec<f32>),
    ) {
        self.size = (image.width() as usize, image.height() as usize);
        let width = self.size.0.max(1);
        let pixels = image.as_raw().as_chunks().0;
        self.colours.clear();
        self.colours.extend(pixels.iter().map(|&p| ycc(p)));
        self.ratios.clear();
        self.ratios.reserve(pixels.len());
        for (y, (ycc, rgb)) in self.colours.chunks(width).zip(pixels.chunks(width)).enumerate() {
            append(y as u32, Row { ycc, rgb }, &mut self.ratios);
        }
        self.smooth.clone_from(&self.ratios);
        smooth(&mut self.smooth, &mut self.scratch, self.size);
    }

    pub(super) fn cell(&self, x: u32, y: u32) -> usize {
        self.colours.get(y as usize * self.size.0 + x as usize).map_or(0, |&c| cell(c))
    }

    pub(super) fn width(&self) -> u32 {
        self.size.0 as u32
    }

    pub(super) fn height(&self) -> u32 {
        self.size.1 as u32
    }

    /// The largest part of [`Self::coarse`], with others of comparable area that have its hue and saturation: a second
    /// hand, not a piece of furniture.
    pub(super) fn skin_parts(&self, options: &SegmentOptions) -> Mask {
        let mask = self.coarse();
        let parts = Components::of(&mask, true);
        let mut out = Mask::new(mask.width(), mask.height());
        let Some(largest) = parts.largest() else { return out };
        let mut chromaticities = vec![[0.0f32; 2]; parts.list.len()];
        for (number, y, start, end) in parts.spans() {
            let row = y as usize * self.size.0;
            for &c in self.colours.get(row + start as usize..row + end as usize).unwrap_or(&[]) {
                let [u, v] = chromaticity(c.map(f32::from), &options.colour);
                chromaticities[number] = [chromaticities[number][0] + u, chromaticities[number][1] + v];
            }
        }
        let mean = |i: usize| chromaticities[i].map(|sum| sum / parts.list[i].area.max(1) as f32);
        let [u, v] = mean(largest);
        let least = options.comparable_area * f64::from(parts.list[largest].area);
        parts.draw(&mut out, |i, part| {
            let [a, b] = mean(i);
            i == largest
                || f64::from(part.area) >= least && (a - u).hypot(b - v) < options.learning.same_chromaticity
        });
        out
    }

    /// The pixels whose smoothed log-likelihood ratio is positive.
    pub(crate) fn coarse(&self) -> Mask {
        self.above(0.0)
    }

    /// Posterior probability of skin, 0..=255, with the same prior for skin and background.
    pub(super) fn posterior(&self) -> GrayImage {
        let (w, h) = (self.size.0 as u32, self.size.1 as u32);
        GrayImage::from_fn(w, h, |x, y| {
            let ratio = self.smooth.get(y as usize * self.size.0 + x as usize).copied().unwrap_or(0.0);
            image::Luma([(255.0 / (1.0 + (-ratio).exp())) as u8])
        })
    }

    /// The pixels whose smoothed log-likelihood ratio is above `limit`.
    fn above(&self, limit: f32) -> Mask {
        let mut mask = Mask::new(self.size.0 as u32, self.size.1 as u32);
        for (y, row) in self.smooth.chunks_exact(self.size.0.max(1)).enumerate() {
            for (word, values) in mask.row_mut(y as u32).iter_mut().zip(row.chunks(64)) {
                *word = values.iter().rev().fold(0, |bits, &v| bits << 1 | u64::from(v > limit));
            }
        }
        mask
    }

    /// Moves the outline to where the colour changes from the skin beside it to the background beside it.
    ///
    /// Each pixel near the coarse outline is taken for a mixture of the mean colours of skin and background
    /// nearby, and belongs to the hand if at least half of it is skin. Where the two hardly differ the learnt
    /// ratio decides.
    pub(crate) fn refine(&mut self, coarse: &Mask, tuning: &OutlineTuning) -> Mask {
        let coarse = self.fill_false_holes(coarse, tuning);
        let (inner, outer) = (erode(&coarse, tuning.band), dilate(&coarse, tuning.band));
        self.skin.gather(&erode(&coarse, tuning.skin_margin), &self.colours, self.size.0, tuning);
        let mixed = self.above(tuning.mixed_ratio);
        let mut pure = invert(&outer);
        pure.subtract(&mixed);
        self.background.gather(&pure, &self.colours, self.size.0, tuning);
        // A finger blurred by its motion is half background in colour: where mixed colours lead on from the
        // outline, the band widens.
        let mut band = mixed;
        band.intersect_with(&dilate(&outer, tuning.blur_band));
        band.union_with(&outer);
        band.subtract(&inner);
        let weights = tuning.noise.map(|deviation| 1.0 / (deviation * deviation));
        self.scratch.clear();
        self.scratch.resize(self.colours.len(), 0.0);
        for y in 0..band.height() {
            for (start, end) in band.runs(y) {
                for x in start..end {
                    let i = y as usize * self.size.0 + x as usize;
                    let (skin, background) = (self.skin.at(x, y), self.background.at(x, y));
                    let (mut along, mut contrast) = (0.0, 0.0);
                    for c in 0..3 {
                        let step = skin[c] - background[c];
                        along += weights[c] * (f32::from(self.colours[i][c]) - background[c]) * step;
                        contrast += weights[c] * step * step;
                    }
                    let mixture = along / contrast.max(1e-6) - 0.5;
                    let weight = contrast / (contrast + tuning.contrast);
                    let by_mixture = limited(tuning.mixture_gain * mixture, tuning.ratio_limit);
                    let by_histograms = limited(self.smooth[i], tuning.ratio_limit);
                    self.scratch[i] = weight * by_mixture + (1.0 - weight) * by_histograms;
                }
            }
        }
        let mut mask = inner;
        for y in 0..band.height() {
            for (start, end) in band.runs(y) {
                for x in start..end {
                    if self.scratch[y as usize * self.size.0 + x as usize] > 0.0 {
                        mask.set(x, y, true);
                    }
                }
            }
        }
        self.fill_false_holes(&mask, tuning)
    }

    /// Hole filling (paper, 5.1) of holes that are small or not coloured like the background: rings, nails,
    /// highlights.
    fn fill_false_holes(&self, mask: &Mask, tuning: &OutlineTuning) -> Mask {
        let parts = Components::of(&invert(mask), false);
        let mut sums = vec![0.0f32; parts.list.len()];
        for (number, y, start, end) in parts.spans() {
            let enclosed = parts.list.get(number).is_some_and(|part| !part.on_border);
            let row = y as usize * self.size.0;
            if let (true, Some(sum), Some(values)) =
                (enclosed, sums.get_mut(number), self.smooth.get(row + start as usize..row + end as usize))
            {
                *sum += values.iter().sum::<f32>();
            }
        }
        let mut out = mask.clone();
        parts.draw(&mut out, |number, part| {
            let mean = sums.get(number).map_or(0.0, |sum| sum / part.area as f32);
            !part.on_border && (part.area < tuning.small_hole || mean > tuning.hole_ratio)
        });
        out
    }
}

/// Binomial smoothing over 3 × 3 pixels.
pub(super) fn smooth(values: &mut [f32], scratch: &mut Vec<f32>, (width, height): (usize, usize)) {
    scratch.resize(values.len(), 0.0);
    let mix = |before: f32, here: f32, after: f32| 0.25 * (before + after) + 0.5 * here;
    for (row, out) in values.chunks_exact(width).zip(scratch.chunks_exact_mut(width)) {
        if let (&[first, .., last], [start, .., end]) = (row, &mut *out) {
            (*start, *end) = (mix(first, first, row[1]), mix(row[width - 2], last, last));
        } else {
            out.copy_from_slice(row);
        }
        let inner = row.iter().zip(&row[1..]).zip(row.iter().skip(2));
        for (value, ((&before, &here), &after)) in out.iter_mut().skip(1).zip(inner) {
            *value = mix(before, here, after);
        }
    }
    for y in 0..height {
        let row = |y: usize| &scratch[y * width..][..width];
        let (above, here, below) = (row(y.saturating_sub(1)), row(y), row((y + 1).min(height - 1)));
        let around = above.iter().zip(here).zip(below);
        for (value, ((&above, &here), &below)) in values[y * width..][..width].iter_mut().zip(around) {
            *value = mix(above, here, below);
        }
    }
}
