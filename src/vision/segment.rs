//! From a picture to the silhouette of the hand.

use image::{GrayImage, Rgb, RgbImage};
use thiserror::Error;

use super::colour::{ColourModel, Counts, cell, ycc};
use super::mask::Mask;
use super::morphology::{Components, DistanceMap, dilate, erode, erode_cross, invert, largest_component};
use super::wrist::{Disc, Wrist, cut_arm};
use crate::io::frames::{Resampler, fit_within};

/// How to segment.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct SegmentOptions {
    /// Pictures are scaled down to this longer side first, in pixels.
    pub max_side: u32,
    /// Smallest hand and arm accepted, as a share of the picture.
    pub min_area: f64,
    /// A second part of at least this share of the largest is taken for another hand.
    pub several: f64,
}

impl Default for SegmentOptions {
    fn default() -> Self {
        Self { max_side: 640, min_area: 0.004, several: 0.45 }
    }
}

impl SegmentOptions {
    /// Sets [`SegmentOptions::max_side`].
    pub fn with_max_side(mut self, side: u32) -> Self {
        self.max_side = side;
        self
    }
}

/// Why a picture has no silhouette.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum VisionError {
    /// Nothing in the picture looks like a hand.
    #[error("no hand: {what}")]
    NoHand {
        /// What was found instead.
        what: String,
    },
    /// More than one part of the picture looks like a hand.
    #[error("{count} hands or other skin-coloured parts of comparable size; one is expected")]
    SeveralHands {
        /// How many.
        count: usize,
    },
    /// The picture, the mask or an option has an impossible size or value.
    #[error("{what}")]
    Parameter {
        /// The value and what is allowed.
        what: String,
    },
}

/// The outline of a hand and its arm, at the analysis size.
#[derive(Clone, Debug, PartialEq)]
pub struct Silhouette {
    /// The hand, cut at the wrist.
    pub hand: Mask,
    /// Hand and forearm.
    pub arm: Mask,
    /// Where they were cut; `None` if no forearm was found.
    pub wrist: Option<Wrist>,
    /// The largest disc in the palm (or fist).
    pub palm: Option<Disc>,
    /// Whether the hand itself reaches the image border, so that part of it may be missing.
    pub clipped: bool,
}

impl Silhouette {
    /// Cuts the forearm off an arm; `prior` is the wrist of the frame before.
    pub fn from_arm(arm: Mask, prior: Option<&Wrist>) -> Self {
        let cut = cut_arm(&arm, prior);
        let clipped = touches_border(&cut.hand, cut.wrist.as_ref(), cut.palm.as_ref());
        Self { hand: cut.hand, arm, wrist: cut.wrist, palm: cut.palm, clipped }
    }

    /// The silhouette in a ready mask: white (128 and above) is hand, with or without its forearm.
    ///
    /// The mask is scaled to the analysis size of `options`.
    ///
    /// # Errors
    /// The mask shows nothing, or several parts of comparable size.
    pub fn from_gray(image: &GrayImage, options: &SegmentOptions) -> Result<Self, VisionError> {
        let size = image.dimensions();
        check_size(size)?;
        let target = fit_within(size.0, size.1, Some(options.max_side));
        let mut scaled = vec![0u8; target.0 as usize * target.1 as usize];
        // Thresholded first: the share of white then decides, whatever the greys of its edge.
        let sharp: Vec<u8> = image.as_raw().iter().map(|&v| if v >= 128 { 255 } else { 0 }).collect();
        Resampler::new(size, target, 1).run(&sharp, &mut scaled);
        let mask = Mask::from_fn(target.0, target.1, |x, y| {
            scaled.get((y * target.0 + x) as usize).is_some_and(|&v| v >= 128)
        });
        let arm = single_part(&mask, options)?;
        Ok(Self::from_arm(arm, None))
    }

    /// `image` with the outline of the arm, of the hand and the line of the wrist drawn over it; `image` is
    /// scaled to the size of the silhouette.
    pub fn overlay(&self, image: &RgbImage) -> RgbImage {
        let target = (self.arm.width(), self.arm.height());
        let mut out = resized(image, target);
        draw_outline(&mut out, &self.arm, Rgb([255, 190, 0]));
        draw_outline(&mut out, &self.hand, Rgb([0, 255, 60]));
        if let Some(wrist) = &self.wrist {
            let [a, b] = wrist.ends();
            draw_line(&mut out, a, b, Rgb([255, 0, 200]));
        }
        out
    }
}

/// Colours the pixels of `mask` that have a 4-neighbour outside it.
pub fn draw_outline(image: &mut RgbImage, mask: &Mask, colour: Rgb<u8>) {
    let mut edge = mask.clone();
    edge.subtract(&erode_cross(mask));
    for (x, y) in edge.pixels() {
        if let Some(pixel) = image.get_pixel_mut_checked(x, y) {
            *pixel = colour;
        }
    }
}

/// Draws a straight line one pixel wide.
pub fn draw_line(image: &mut RgbImage, from: (f64, f64), to: (f64, f64), colour: Rgb<u8>) {
    let steps = ((to.0 - from.0).abs().max((to.1 - from.1).abs()).ceil() as u32).clamp(1, 1 << 16);
    for k in 0..=steps {
        let t = f64::from(k) / f64::from(steps);
        let (x, y) = (from.0 + (to.0 - from.0) * t, from.1 + (to.1 - from.1) * t);
        if x >= 0.0
            && y >= 0.0
            && let Some(pixel) = image.get_pixel_mut_checked(x as u32, y as u32)
        {
            *pixel = colour;
        }
    }
}

fn resized(image: &RgbImage, target: (u32, u32)) -> RgbImage {
    if image.dimensions() == target {
        return image.clone();
    }
    let mut out = RgbImage::new(target.0, target.1);
    Resampler::new(image.dimensions(), target, 3).run(image.as_raw(), &mut out);
    out
}

fn check_size(size: (u32, u32)) -> Result<(), VisionError> {
    if size.0 < 16 || size.1 < 16 {
        let what = format!("picture of {} x {} pixels; allowed are 16 or more a side", size.0, size.1);
        return Err(VisionError::Parameter { what });
    }
    Ok(())
}

fn touches_border(hand: &Mask, wrist: Option<&Wrist>, palm: Option<&Disc>) -> bool {
    let (w, h) = (hand.width(), hand.height());
    // Just above the cut the border may run along the wrist without hiding any of the hand.
    let clear = palm.map_or(0.0, |palm| 0.3 * palm.radius);
    hand.bounds().is_some_and(|b| b.x0 == 0 || b.y0 == 0 || b.x1 == w || b.y1 == h)
        && hand.pixels().any(|(x, y)| {
            let border = x == 0 || y == 0 || x + 1 == w || y + 1 == h;
            border && wrist.is_none_or(|wrist| wrist.side(f64::from(x), f64::from(y)) > clear)
        })
}

/// The one hand in a mask.
fn single_part(mask: &Mask, options: &SegmentOptions) -> Result<Mask, VisionError> {
    let parts = Components::of(mask, true);
    let Some(chosen) = parts.largest() else {
        return Err(VisionError::NoHand { what: "nothing is coloured like skin".to_owned() });
    };
    let area = parts.list[chosen].area;
    let all = f64::from(mask.width()) * f64::from(mask.height());
    let share = f64::from(area) / all;
    if share < options.min_area {
        let what =
            format!("the largest part coloured like skin covers {:.2} % of the picture", share * 100.0);
        return Err(VisionError::NoHand { what });
    }
    if share > 0.85 {
        let what = format!("{:.0} % of the picture is coloured like skin", share * 100.0);
        return Err(VisionError::NoHand { what });
    }
    let count = parts.list.iter().filter(|c| f64::from(c.area) >= options.several * f64::from(area)).count();
    if count > 1 {
        return Err(VisionError::SeveralHands { count });
    }
    let mut out = Mask::new(mask.width(), mask.height());
    parts.draw(&mut out, |i, _| i == chosen);
    Ok(out)
}

/// Finds silhouettes by colours learnt from the clip itself.
#[derive(Clone, Debug)]
pub struct Segmenter {
    options: SegmentOptions,
    model: ColourModel,
    wrist: Option<Wrist>,
    field: Field,
}

/// Per-pixel working data of one picture, kept between frames.
#[derive(Clone, Debug, Default)]
struct Field {
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

impl Segmenter {
    /// Learns the colours of skin and of background from pictures of the clip, a dozen or two spread over it.
    ///
    /// A rough model of skin's hue finds a first silhouette; histograms of what lies within and without it give
    /// a better one, and so on until they agree.
    ///
    /// # Errors
    /// No picture shows anything like a hand.
    pub fn learn(samples: &[RgbImage], options: SegmentOptions) -> Result<Self, VisionError> {
        if options.max_side < 64 {
            let what = format!("analysis size {}; allowed are 64 pixels or more", options.max_side);
            return Err(VisionError::Parameter { what });
        }
        // Learning needs colours, not outlines: half the analysis size is plenty.
        let mut small = Vec::with_capacity(samples.len());
        for sample in samples {
            check_size(sample.dimensions())?;
            let (w, h) = sample.dimensions();
            small.push(resized(sample, fit_within(w, h, Some(options.max_side / 2))));
        }
        let no_hand = |what: &str| VisionError::NoHand { what: what.to_owned() };
        let mut model = ColourModel::first_guess(&small)
            .ok_or_else(|| no_hand("nothing in the clip has the hue of skin"))?;
        let mut field = Field::default();
        for round in 0..5 {
            let (mut skin, mut background) = (Counts::new(), Counts::new());
            // The first guess may miss skin in strong or coloured light. What surely is not skin is then only
            // known along the border, well away from what was found.
            let cautious = round == 0;
            for sample in &small {
                field.load(sample, &model);
                let part = largest_component(&field.coarse());
                let share = f64::from(part.area()) / (field.size.0 * field.size.1) as f64;
                if share < options.min_area {
                    continue;
                }
                for (x, y) in erode(&part, 2).pixels() {
                    skin.add(field.cell(x, y));
                }
                let (w, h) = (part.width(), part.height());
                let outside = if cautious {
                    let far = f64::from(w.max(h)) * 0.12;
                    let mut far = DistanceMap::to_value(&part, true).select(|d| f64::from(d) > far * far);
                    let (bx, by) = (w / 8, h / 8);
                    far.subtract(&Mask::from_fn(w, h, |x, y| {
                        (bx..w - bx).contains(&x) && (by..h - by).contains(&y)
                    }));
                    far
                } else {
                    invert(&dilate(&part, 3))
                };
                for (x, y) in outside.pixels() {
                    background.add(field.cell(x, y));
                }
            }
            if skin.total() < 50.0 {
                return Err(no_hand("nothing large enough is coloured like skin"));
            }
            if background.total() < 50.0 {
                return Err(no_hand("the whole picture is coloured like skin"));
            }
            model = ColourModel::from_counts(&skin, &background, cautious);
        }
        Ok(Self { options, model, wrist: None, field: Field::default() })
    }

    /// The silhouette in one picture. Pictures of a clip should come in order: the wrist is followed.
    ///
    /// # Errors
    /// There is no hand, or more than one.
    pub fn segment(&mut self, image: &RgbImage) -> Result<Silhouette, VisionError> {
        check_size(image.dimensions())?;
        let (w, h) = image.dimensions();
        let target = fit_within(w, h, Some(self.options.max_side));
        if target == (w, h) {
            self.field.load(image, &self.model);
        } else {
            self.field.load(&resized(image, target), &self.model);
        }
        let coarse = self.field.coarse();
        let coarse = single_part(&coarse, &self.options)?;
        let arm = self.field.refine(&coarse);
        let silhouette = Silhouette::from_arm(arm, self.wrist.as_ref());
        self.wrist = silhouette.wrist;
        Ok(silhouette)
    }

    /// Forgets the wrist of the frame before: to be called where the clip jumps.
    pub fn forget(&mut self) {
        self.wrist = None;
    }
}

impl Field {
    fn load(&mut self, image: &RgbImage, model: &ColourModel) {
        self.size = (image.width() as usize, image.height() as usize);
        self.colours.clear();
        self.colours.extend(image.pixels().map(|p| ycc(p.0)));
        self.ratios.clear();
        self.ratios.extend(self.colours.iter().map(|&c| model.ratio(cell(c))));
        self.smooth.clone_from(&self.ratios);
        smooth(&mut self.smooth, &mut self.scratch, self.size);
    }

    fn cell(&self, x: u32, y: u32) -> usize {
        self.colours.get(y as usize * self.size.0 + x as usize).map_or(0, |&c| cell(c))
    }

    /// Everything that looks more like skin than not.
    fn coarse(&self) -> Mask {
        self.above(0.0)
    }

    /// The pixels whose smoothed ratio is above `limit`.
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
    fn refine(&mut self, coarse: &Mask) -> Mask {
        let coarse = self.without_false_holes(coarse);
        let (inner, outer) = (erode(&coarse, BAND), dilate(&coarse, BAND));
        self.skin.gather(&erode(&coarse, 2), &self.colours, self.size);
        let doubtful = self.above(DOUBTFUL);
        let mut clear = invert(&outer);
        clear.subtract(&doubtful);
        self.background.gather(&clear, &self.colours, self.size);
        // A finger blurred by its motion is half background in colour; where doubt leads on from the outline,
        // the band widens.
        let mut band = doubtful;
        band.intersect_with(&dilate(&outer, BLUR));
        band.union_with(&outer);
        band.subtract(&inner);
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
                        along += WEIGHTS[c] * (f32::from(self.colours[i][c]) - background[c]) * step;
                        contrast += WEIGHTS[c] * step * step;
                    }
                    let mixture = along / contrast.max(1e-6) - 0.5;
                    let trust = contrast / (contrast + 12.0);
                    let score = trust * (6.0 * mixture).clamp(-3.0, 3.0)
                        + (1.0 - trust) * self.smooth[i].clamp(-3.0, 3.0);
                    self.scratch[i] = score;
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
        largest_component(&self.without_false_holes(&mask))
    }

    /// Fills holes that are small, or not clearly coloured like the background: rings, nails, highlights.
    fn without_false_holes(&self, mask: &Mask) -> Mask {
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
            !part.on_border && (part.area < SMALL_HOLE || mean > CLEAR_BACKGROUND)
        });
        out
    }
}

/// Half the width of the band in which the outline is sought, in pixels.
const BAND: u32 = 4;
/// How far beyond the band doubtful pixels are looked at, in pixels.
const BLUR: u32 = 24;
/// Smoothed ratio from which a pixel may be skin mixed with background.
const DOUBTFUL: f32 = -2.5;
/// Largest hole, in pixels, that is noise rather than a gap between fingers.
const SMALL_HOLE: u32 = 60;
/// Mean log-likelihood ratio above which a hole is not clearly background: colours never seen have -2.3.
const CLEAR_BACKGROUND: f32 = -3.0;
/// One over the variance of noise and shading in luma and chroma: shading changes luma more.
const WEIGHTS: [f32; 3] = [1.0 / 144.0, 1.0 / 9.0, 1.0 / 9.0];
/// Side of a grid cell in pixels.
const CELL: usize = 8;

/// Mean colour of part of the picture, known everywhere: near the part its own local mean, farther off that
/// of ever larger surroundings.
#[derive(Clone, Debug, Default)]
struct LocalColour {
    /// Per level, columns, rows, and per cell the mean with the weight last.
    levels: Vec<(usize, usize, Vec<[f32; 4]>)>,
}

impl LocalColour {
    /// Means over the pixels of `part`.
    fn gather(&mut self, part: &Mask, colours: &[[u8; 3]], size: (usize, usize)) {
        let (columns, rows) = (size.0.div_ceil(CELL), size.1.div_ceil(CELL));
        self.levels.clear();
        let mut cells = vec![[0f32; 4]; columns * rows];
        for y in 0..part.height() {
            let row = y as usize * size.0;
            let cell_row = y as usize / CELL * columns;
            for (start, end) in part.runs(y) {
                for x in start as usize..end as usize {
                    let colour = colours[row + x];
                    let sum = &mut cells[cell_row + x / CELL];
                    for c in 0..3 {
                        sum[c] += f32::from(colour[c]);
                    }
                    sum[3] += 1.0;
                }
            }
        }
        self.levels.push((columns, rows, cells));
        while let Some((columns, rows, cells)) = self.levels.last() {
            if *columns <= 1 && *rows <= 1 {
                break;
            }
            let (w, h) = (columns.div_ceil(2), rows.div_ceil(2));
            let mut above = vec![[0f32; 4]; w * h];
            for (i, cell) in cells.iter().enumerate() {
                let sum = &mut above[i / columns / 2 * w + i % columns / 2];
                for c in 0..4 {
                    sum[c] += cell[c];
                }
            }
            self.levels.push((w, h, above));
        }
        // Downwards, sums become means; a cell with few pixels leans on the level above.
        for level in (0..self.levels.len()).rev() {
            let (lower, upper) = self.levels.split_at_mut(level + 1);
            let Some((columns, _, cells)) = lower.last_mut() else { continue };
            for (i, cell) in cells.iter_mut().enumerate() {
                let (x, y) = (i % *columns, i / *columns);
                let (wide, weight) = match upper.first() {
                    Some(above) => (interpolate(above, x as f32 * 0.5 - 0.25, y as f32 * 0.5 - 0.25), LEAN),
                    None => ([128.0; 3], 1e-3),
                };
                let total = cell[3] + weight;
                for c in 0..3 {
                    cell[c] = (cell[c] + weight * wide[c]) / total;
                }
            }
        }
    }

    /// The mean colour round a pixel.
    fn at(&self, x: u32, y: u32) -> [f32; 3] {
        let cell = |v: u32| (v as f32 + 0.5) / CELL as f32 - 0.5;
        self.levels.first().map_or([128.0; 3], |level| interpolate(level, cell(x), cell(y)))
    }
}

/// Weight of the level above, in pixels.
const LEAN: f32 = 6.0;

fn interpolate((columns, rows, cells): &(usize, usize, Vec<[f32; 4]>), x: f32, y: f32) -> [f32; 3] {
    let (x, y) = (x.clamp(0.0, (columns - 1) as f32), y.clamp(0.0, (rows - 1) as f32));
    let (x0, y0) = (x as usize, y as usize);
    let (x1, y1) = ((x0 + 1).min(columns - 1), (y0 + 1).min(rows - 1));
    let (fx, fy) = (x - x0 as f32, y - y0 as f32);
    let (a, b) = (cells[y0 * columns + x0], cells[y0 * columns + x1]);
    let (c, d) = (cells[y1 * columns + x0], cells[y1 * columns + x1]);
    std::array::from_fn(|k| {
        let (top, bottom) = (a[k] + (b[k] - a[k]) * fx, c[k] + (d[k] - c[k]) * fx);
        top + (bottom - top) * fy
    })
}

/// Binomial smoothing over 3 × 3 pixels.
fn smooth(values: &mut [f32], scratch: &mut Vec<f32>, (width, height): (usize, usize)) {
    scratch.resize(values.len(), 0.0);
    for (row, out) in values.chunks_exact(width).zip(scratch.chunks_exact_mut(width)) {
        for x in 0..width {
            let (left, right) = (row[x.saturating_sub(1)], row[(x + 1).min(width - 1)]);
            out[x] = 0.25 * (left + right) + 0.5 * row[x];
        }
    }
    for y in 0..height {
        let row = |y: usize| &scratch[y * width..][..width];
        let (above, here, below) = (row(y.saturating_sub(1)), row(y), row((y + 1).min(height - 1)));
        for (x, value) in values[y * width..][..width].iter_mut().enumerate() {
            *value = 0.25 * (above[x] + below[x]) + 0.5 * here[x];
        }
    }
}
