//! From a picture to the silhouette of the hand.

mod bars;
pub(crate) mod field;
mod local_colour;
mod options;
mod swept;

pub use bars::BarTuning;
use bars::Bars;
use field::LikelihoodField;
use image::{GrayImage, Rgb, RgbImage};
pub use options::{LearningTuning, OutlineTuning, SegmentOptions};
pub use swept::SweptTuning;
use thiserror::Error;

use super::chamfer::outline;
use super::colour::{ColourModel, Counts, cell, limited, ycc};
use super::mask::{Mask, PixelRect};
use super::morphology::{Components, dilate, erode, invert, largest_component, within};
use super::parts::find_parts;
use super::still::StillBackground;
use super::wrist::{InscribedCircle, Wrist, WristTuning, cut_arm};
use swept::{Motion, Swept};

use handcast_picture::{Resampler, draw_line, fit_within};

/// Shortest side of a picture, pixels.
const MIN_SIDE: u32 = 16;
/// Shortest longer side of the analysis, pixels.
const MIN_ANALYSIS_SIDE: u32 = 64;
/// Level of all three channels from which a pixel is over-exposed, and the least share of such pixels that is told, per
/// cent: as much as a hand covers.
const OVER_EXPOSED: u8 = 250;
const LEAST_OVER_EXPOSED: f64 = 2.0;
/// Fewest pixels of a skin sample.
const MIN_SAMPLE: f32 = 16.0;

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

/// A hand and its arm in a picture, at the analysis size; places in pixels of that size.
#[derive(Clone, Debug, PartialEq)]
pub struct Silhouette {
    /// The hand, cut at the wrist.
    pub hand: Mask,
    /// Hand and forearm.
    pub arm: Mask,
    /// Where they were cut; `None` if no forearm was found.
    pub wrist: Option<Wrist>,
    /// The largest circle inscribed in the palm (or fist).
    pub palm: Option<InscribedCircle>,
    /// Whether the hand itself reaches the image border, so that part of it may be missing.
    pub clipped: bool,
}

impl Silhouette {
    /// Cuts the forearm off an arm; `prior` is the wrist of the frame before.
    pub fn from_arm(arm: Mask, prior: Option<&Wrist>, tuning: &WristTuning) -> Self {
        let cut = cut_arm(&arm, prior, tuning);
        let margin = cut.palm.map_or(0.0, |palm| tuning.border_margin * palm.radius);
        let clipped = touches_border(&cut.hand, cut.wrist.as_ref(), margin);
        Self { hand: cut.hand, arm, wrist: cut.wrist, palm: cut.palm, clipped }
    }

    /// As [`Silhouette::from_arm`] where the picture is what lies within `frame`.
    fn from_arm_within(arm: &Mask, frame: PixelRect, prior: Option<&Wrist>, tuning: &WristTuning) -> Self {
        let corner = [frame.x0, frame.y0].map(f64::from);
        let [left, right] =
            [-1.0, 1.0].map(|sign| move |p: [f64; 2]| [0, 1].map(|i| p[i] + sign * corner[i]));
        let prior = prior.map(|wrist| Wrist { centre: left(wrist.centre), ..*wrist });
        let inner = Self::from_arm(arm.cropped(frame), prior.as_ref(), tuning);
        Self {
            hand: inner.hand.placed(frame, arm.size()),
            arm: inner.arm.placed(frame, arm.size()),
            wrist: inner.wrist.map(|wrist| Wrist { centre: right(wrist.centre), ..wrist }),
            palm: inner.palm.map(|palm| InscribedCircle { centre: right(palm.centre), ..palm }),
            clipped: inner.clipped,
        }
    }

    /// The silhouette in a ready mask: white (128 and above) is hand, with or without its forearm.
    ///
    /// The mask is scaled to the analysis size of `options`.
    ///
    /// # Errors
    /// The mask shows nothing, or several parts of comparable size, or is less than 16 pixels wide or high.
    pub fn from_gray(image: &GrayImage, options: &SegmentOptions) -> Result<Self, VisionError> {
        let mask = scaled_mask(image, options)?;
        let arm = single_part(&mask, options)?;
        Ok(Self::from_arm(arm, None, &options.wrist))
    }

    /// As [`Silhouette::from_gray`], of every part of a ready mask that is large enough to be a hand: largest
    /// first, [`SegmentOptions::max_parts`] at most.
    ///
    /// # Errors
    /// The mask shows nothing, or is less than 16 pixels wide or high.
    pub fn all_from_gray(image: &GrayImage, options: &SegmentOptions) -> Result<Vec<Self>, VisionError> {
        let mask = scaled_mask(image, options)?;
        Ok(large_parts(&mask, options)?
            .into_iter()
            .map(|arm| Self::from_arm(arm, None, &options.wrist))
            .collect())
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

/// Colours the [`outline`] of `mask`.
pub fn draw_outline(image: &mut RgbImage, mask: &Mask, colour: Rgb<u8>) {
    for (x, y) in outline(mask).pixels() {
        if let Some(pixel) = image.get_pixel_mut_checked(x, y) {
            *pixel = colour;
        }
    }
}

/// `image` scaled down until its longer side has at most `max_side` pixels.
pub fn shrunk(image: &RgbImage, max_side: u32) -> RgbImage {
    resized(image, fit_within(image.width(), image.height(), Some(max_side)))
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
    if size.0 < MIN_SIDE || size.1 < MIN_SIDE {
        let what =
            format!("picture of {} x {} pixels; allowed are {MIN_SIDE} or more a side", size.0, size.1);
        return Err(VisionError::Parameter { what });
    }
    Ok(())
}

/// Whether the hand reaches the image border more than `margin` pixels above the cut: nearer to it the border may
/// run along the wrist without hiding any of the hand.
fn touches_border(hand: &Mask, wrist: Option<&Wrist>, margin: f64) -> bool {
    let (w, h) = (hand.width(), hand.height());
    hand.bounds().is_some_and(|b| b.x0 == 0 || b.y0 == 0 || b.x1 == w || b.y1 == h)
        && hand.pixels().any(|(x, y)| {
            let border = x == 0 || y == 0 || x + 1 == w || y + 1 == h;
            border && wrist.is_none_or(|wrist| wrist.side([f64::from(x), f64::from(y)]) > margin)
        })
}

/// A ready mask at the analysis size.
fn scaled_mask(image: &GrayImage, options: &SegmentOptions) -> Result<Mask, VisionError> {
    let size = image.dimensions();
    check_size(size)?;
    let target = fit_within(size.0, size.1, Some(options.max_side));
    let mut scaled = vec![0u8; target.0 as usize * target.1 as usize];
    // Thresholded first: the share of white then decides, whatever the greys of its edge.
    let sharp: Vec<u8> = image.as_raw().iter().map(|&v| if v >= 128 { 255 } else { 0 }).collect();
    Resampler::new(size, target, 1).run(&sharp, &mut scaled);
    Ok(Mask::from_fn(target.0, target.1, |x, y| {
        scaled.get((y * target.0 + x) as usize).is_some_and(|&v| v >= 128)
    }))
}

/// The number of the largest part of a mask, where it has the size of a hand.
fn hand_sized(mask: &Mask, parts: &Components, options: &SegmentOptions) -> Result<usize, VisionError> {
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
    if share > options.max_area {
        let what = format!("{:.0} % of the picture is coloured like skin", share * 100.0);
        return Err(VisionError::NoHand { what });
    }
    Ok(chosen)
}

/// The parts of a mask that are large enough to be hands, largest first.
fn large_parts(mask: &Mask, options: &SegmentOptions) -> Result<Vec<Mask>, VisionError> {
    let parts = Components::of(mask, true);
    let largest = hand_sized(mask, &parts, options)?;
    let pixels = f64::from(mask.width()) * f64::from(mask.height());
    let least =
        (options.min_relative_area * f64::from(parts.list[largest].area)).max(options.min_area * pixels);
    let mut chosen: Vec<usize> =
        (0..parts.list.len()).filter(|&i| f64::from(parts.list[i].area) >= least).collect();
    // The first of equals first: row order decides.
    chosen.sort_by_key(|&i| std::cmp::Reverse(parts.list[i].area));
    chosen.truncate(options.max_parts);
    let drawn = |chosen: usize| {
        let mut out = Mask::new(mask.width(), mask.height());
        parts.draw(&mut out, |i, _| i == chosen);
        out
    };
    Ok(chosen.into_iter().map(drawn).collect())
}

/// The one hand in a mask.
fn single_part(mask: &Mask, options: &SegmentOptions) -> Result<Mask, VisionError> {
    let parts = Components::of(mask, true);
    let chosen = hand_sized(mask, &parts, options)?;
    let area = parts.list[chosen].area;
    let count =
        parts.list.iter().filter(|c| f64::from(c.area) >= options.comparable_area * f64::from(area)).count();
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
    /// At the edges of all pictures.
    bars: Option<Bars>,
    /// Whether what the colours show has been seen to be what moves.
    sure: bool,
    /// What is behind a hand that was learnt by its motion, and pictures since that was learnt.
    still: Option<(Box<StillBackground>, usize)>,
    /// Of the frame before.
    wrists: Vec<Wrist>,
    field: LikelihoodField,
}

impl Segmenter {
    /// Learns the colours of skin and of background from pictures of the clip, a dozen or two spread over it.
    ///
    /// A threshold on skin's hue and saturation gives a first silhouette; histograms of what lies within and
    /// without it give the next, for a fixed number of rounds.
    ///
    /// # Errors
    /// No picture shows anything like a hand; one is less than 16 pixels wide or high;
    /// [`SegmentOptions::max_side`] is below 64.
    pub fn learn(samples: &[RgbImage], options: SegmentOptions) -> Result<Self, VisionError> {
        Self::learnt(&Self::for_learning(samples, &options)?, samples, options)
    }

    /// As [`Segmenter::learn`], with the pictures at the size for learning.
    fn learnt(
        small: &[RgbImage],
        samples: &[RgbImage],
        options: SegmentOptions,
    ) -> Result<Self, VisionError> {
        let initial = ColourModel::initial(small, &options.colour)
            .ok_or_else(|| over_exposed(small, "nothing in the clip has the hue of skin"))?;
        // The threshold may miss skin in strong or coloured light.
        Ok(Self::refined(small, initial, &Counts::new(), true, options)?.with_bars(samples))
    }

    /// As [`Segmenter::learn`], from pictures in order of time of a camera that may stand still: where much is coloured
    /// like skin that does not move while something else does, the hand is learnt by its motion, if it is then seen open
    /// more often.
    ///
    /// # Errors
    /// As [`Segmenter::learn`].
    pub fn learn_clip(samples: &[RgbImage], options: SegmentOptions) -> Result<Self, VisionError> {
        let small = Self::for_learning(samples, &options)?;
        let by_colour = Self::learnt(&small, samples, options);
        let t = &options.swept;
        let Some(swept) = Motion::of(&small, t).swept() else { return by_colour };
        let agree = by_colour.as_ref().map_or(0.0, |by_colour| by_colour.agreement(&swept, &small));
        if agree >= t.agree {
            return by_colour;
        }
        let full: Vec<RgbImage> = samples.iter().map(|s| shrunk(s, options.max_side)).collect();
        // What hardly moves is no hand, open or not.
        let coloured = match &by_colour {
            Ok(by_colour) if agree >= t.tell_nothing => {
                by_colour.clone().times_open(&full, None, (t.least_open, usize::MAX))
            }
            _ => 0,
        };
        // Where both show it as often, the colours stay: motion takes a part of a hand that rests for background.
        let enough = if coloured > 0 { t.least_open.max(coloured + 1) } else { t.least_open };
        if enough > full.len() {
            return by_colour;
        }
        let by_motion = Self::by_motion((&small, &full), &swept, options).with_bars(samples);
        let open = by_motion.clone().times_open(&full, None, (enough, enough));
        if open >= enough { Ok(by_motion) } else { by_colour }
    }

    /// As [`Segmenter::learn_clip`], from pictures of which no hand has come so far: one may have come in. `found` is what
    /// these colours show in each of them, where nothing speaks against them. `None` where nothing moves before a camera that
    /// stands still, where `found` is what moves, or where too few pictures show an open hand that moves. Of a camera that
    /// moves itself, colours tell, if they may do so `alone`.
    ///
    /// # Errors
    /// A picture is less than 16 pixels wide or high; [`SegmentOptions::max_side`] is below 64.
    pub fn learn_entrance(
        &mut self,
        samples: &[RgbImage],
        found: Option<&[Mask]>,
        alone: bool,
    ) -> Result<Option<Self>, VisionError> {
        let options = self.options;
        let small = Self::for_learning(samples, &options)?;
        let t = &options.swept;
        let swept = match Motion::of(&small, t) {
            Motion::Swept(swept) if self.shows(&swept, found) => return Ok(None),
            Motion::Swept(swept) => Some(swept),
            Motion::Everywhere if alone => None,
            Motion::None | Motion::Everywhere => return Ok(None),
        };
        let full: Vec<RgbImage> = samples.iter().map(|s| shrunk(s, options.max_side)).collect();
        let by_colour = Self::learnt(&small, samples, options).ok();
        let by_motion =
            swept.as_ref().map(|s| Self::by_motion((&small, &full), s, options).with_bars(samples));
        let (mut best, mut most) = (None, t.least_open.saturating_sub(1));
        let mut learnt = [by_colour, by_motion].into_iter().flatten().peekable();
        while let Some(these) = learnt.next() {
            // How often is asked only to tell two apart.
            let enough = if learnt.peek().is_some() { full.len() } else { most + 1 };
            let open = these.clone().times_open(&full, swept.as_ref(), (most + 1, enough));
            if open > most {
                (best, most) = (Some(these), open);
            }
        }
        Ok(best)
    }

    /// Whether what was found by these colours is what moves: all of that was found once, and most of what was found has moved
    /// in these pictures, or had in earlier ones.
    fn shows(&mut self, swept: &Swept, found: Option<&[Mask]>) -> bool {
        let [moved, shown] = found.map_or([0.0; 2], |found| swept.agreement(found));
        self.sure = found.is_some() && (self.sure || moved >= self.options.swept.agree);
        self.sure && shown >= self.options.swept.agree
    }

    /// How much of what is coloured like skin was swept over, 0 to 1.
    fn agreement(&self, swept: &Swept, small: &[RgbImage]) -> f64 {
        let mut field = LikelihoodField::default();
        let [inside, all] = small.iter().fold([0.0; 2], |sum, sample| {
            field.load(sample, &self.model);
            let share = swept.share_of(&field.skin_parts(&self.options));
            [0, 1].map(|i| sum[i] + share[i])
        });
        inside / all.max(1.0)
    }

    /// Learns what moved, in pictures at the size for learning and at that of the analysis.
    fn by_motion(pictures: (&[RgbImage], &[RgbImage]), swept: &Swept, options: SegmentOptions) -> Self {
        let (model, still) = swept::learn(pictures, swept, &options.swept, &options.colour);
        let (field, still) = (LikelihoodField::default(), Some((Box::new(still), 0)));
        Self { options, model, bars: None, sure: false, still, wrists: Vec::new(), field }
    }

    /// In how many pictures a part is an open hand, of parts that moved where that is known: counted up to `enough`, and no
    /// further where there cannot be `least` of them.
    fn times_open(
        mut self,
        pictures: &[RgbImage],
        swept: Option<&Swept>,
        (least, enough): (usize, usize),
    ) -> usize {
        let share = self.options.swept.agree;
        let moved = |part: &Silhouette| swept.is_none_or(|swept| swept.covers(&part.hand) >= share);
        let mut open = 0;
        for (i, picture) in pictures.iter().enumerate() {
            if open >= enough || open + pictures.len() - i < least {
                break;
            }
            let parts = self.segment_all(picture).unwrap_or_default();
            let is_open = |part: &Silhouette| find_parts(part, None, &self.options.parts).is_ok();
            open += usize::from(parts.iter().any(|part| moved(part) && is_open(part)));
        }
        open
    }

    /// As [`Segmenter::learn`], beginning with the colours of a piece of skin: every pixel of `skin` counts.
    ///
    /// # Errors
    /// As [`Segmenter::learn`]; `skin` has fewer than 16 pixels.
    pub fn learn_from(
        skin: &RgbImage,
        samples: &[RgbImage],
        options: SegmentOptions,
    ) -> Result<Self, VisionError> {
        let small = Self::for_learning(samples, &options)?;
        let (mut labelled, mut all) = (Counts::new(), Counts::new());
        skin.pixels().for_each(|p| labelled.add(cell(ycc(p.0))));
        small.iter().flat_map(RgbImage::pixels).for_each(|p| all.add(cell(ycc(p.0))));
        if labelled.total() < MIN_SAMPLE {
            let what =
                format!("skin sample of {} pixels; allowed are {MIN_SAMPLE} or more", labelled.total());
            return Err(VisionError::Parameter { what });
        }
        let initial = ColourModel::from_counts(&labelled, &all, false, &options.colour);
        Ok(Self::refined(&small, initial, &labelled, false, options)?.with_bars(samples))
    }

    /// The pictures at the size at which colours are learnt.
    fn for_learning(samples: &[RgbImage], options: &SegmentOptions) -> Result<Vec<RgbImage>, VisionError> {
        if options.max_side < MIN_ANALYSIS_SIDE {
            let allowed = format!("allowed are {MIN_ANALYSIS_SIDE} pixels or more");
            let what = format!("analysis size {}; {allowed}", options.max_side);
            return Err(VisionError::Parameter { what });
        }
        let side = (options.max_side / options.learning.reduction.max(1)).max(MIN_SIDE);
        samples
            .iter()
            .map(|sample| {
                check_size(sample.dimensions())?;
                let (w, h) = sample.dimensions();
                Ok(resized(sample, fit_within(w, h, Some(side))))
            })
            .collect()
    }

    /// Re-estimates a model on the pictures; `labelled` counts as skin in every round. After a `rough` first model,
    /// background is only sampled along the border, well away from what was found.
    fn refined(
        samples: &[RgbImage],
        mut model: ColourModel,
        labelled: &Counts,
        rough: bool,
        options: SegmentOptions,
    ) -> Result<Self, VisionError> {
        let learning = &options.learning;
        let mut field = LikelihoodField::default();
        for round in 0..learning.rounds {
            let (mut skin, mut background) = (labelled.clone(), Counts::new());
            let conservative = rough && round == 0;
            for sample in samples {
                field.load(sample, &model);
                let part = field.skin_parts(&options);
                let share = f64::from(part.area()) / (f64::from(part.width()) * f64::from(part.height()));
                if share < options.min_area {
                    continue;
                }
                for (x, y) in erode(&part, learning.skin_margin).pixels() {
                    skin.add(field.cell(x, y));
                }
                let outside = if conservative {
                    border_far_from(&part, learning)
                } else {
                    invert(&dilate(&part, learning.background_margin))
                };
                for (x, y) in outside.pixels() {
                    background.add(field.cell(x, y));
                }
            }
            if skin.total() < learning.min_pixels {
                return Err(over_exposed(samples, "nothing large enough is coloured like skin"));
            }
            if background.total() < learning.min_pixels {
                return Err(no_hand("the whole picture is coloured like skin"));
            }
            model = ColourModel::from_counts(&skin, &background, conservative, &options.colour);
        }
        let field = LikelihoodField::default();
        Ok(Self { options, model, bars: None, sure: false, still: None, wrists: Vec::new(), field })
    }

    /// Knows the bars at the edges of pictures of the clip.
    fn with_bars(self, samples: &[RgbImage]) -> Self {
        Self { bars: Bars::of(samples, &self.options.bars), ..self }
    }

    /// What is coloured like skin in the last picture, bars left out, and where they leave the film.
    fn coarse(&self) -> (Mask, Option<PixelRect>) {
        let coarse = self.field.coarse();
        match self.bars.and_then(|bars| bars.beside(&coarse, &self.options.bars)) {
            Some(frame) => (coarse.cropped(frame).placed(frame, coarse.size()), Some(frame)),
            None => (coarse, None),
        }
    }

    /// The hand of an arm in the last picture.
    fn cut(&self, arm: Mask, frame: Option<PixelRect>, prior: Option<&Wrist>) -> Silhouette {
        match frame {
            Some(frame) => Silhouette::from_arm_within(&arm, frame, prior, &self.options.wrist),
            None => Silhouette::from_arm(arm, prior, &self.options.wrist),
        }
    }

    /// The silhouette in one picture. Pictures of a clip should come in order: the wrist is followed.
    ///
    /// # Errors
    /// There is no hand, or more than one, or the picture is less than 16 pixels wide or high.
    pub fn segment(&mut self, image: &RgbImage) -> Result<Silhouette, VisionError> {
        self.load(image)?;
        let (coarse, frame) = self.coarse();
        let coarse = single_part(&coarse, &self.options)?;
        let arm = largest_component(&self.field.refine(&coarse, &self.options.outline));
        let silhouette = self.cut(arm, frame, self.wrists.first());
        self.wrists.clear();
        self.wrists.extend(silhouette.wrist);
        Ok(silhouette)
    }

    /// As [`Segmenter::segment`], of every part that is coloured like skin and large enough to be a hand:
    /// largest first, [`SegmentOptions::max_parts`] at most. Which of them are hands their outlines do not tell.
    ///
    /// # Errors
    /// There is no such part, or the picture is less than 16 pixels wide or high.
    pub fn segment_all(&mut self, image: &RgbImage) -> Result<Vec<Silhouette>, VisionError> {
        self.load(image)?;
        let (coarse, frame) = self.coarse();
        let coarse = large_parts(&coarse, &self.options)?;
        let mut all = Mask::new(self.field.width(), self.field.height());
        coarse.iter().for_each(|part| all.union_with(part));
        let arms = large_parts(&self.field.refine(&all, &self.options.outline), &self.options)?;
        let alone = arms.len() == 1 && self.wrists.len() == 1;
        let before = std::mem::take(&mut self.wrists);
        let mut found = Vec::with_capacity(arms.len());
        for arm in arms {
            let inside = |w: &&Wrist| arm.get(w.centre[0].max(0.0) as u32, w.centre[1].max(0.0) as u32);
            let prior = if alone { before.first() } else { before.iter().find(inside) };
            let silhouette = self.cut(arm, frame, prior);
            self.wrists.extend(silhouette.wrist);
            found.push(silhouette);
        }
        self.learn_behind(image, &found);
        Ok(found)
    }

    /// Goes on learning what is behind the hands.
    fn learn_behind(&mut self, image: &RgbImage, found: &[Silhouette]) {
        let Some((still, since)) = &mut self.still else { return };
        *since += 1;
        if *since < self.options.swept.learn_every
            || image.dimensions() != (self.field.width(), self.field.height())
        {
            return;
        }
        *since = 0;
        let mut covered = Mask::new(image.width(), image.height());
        found.iter().for_each(|part| covered.union_with(&part.arm));
        still.learn(image, &dilate(&covered, self.options.swept.margin));
    }

    /// Loads a picture at the analysis size.
    fn load(&mut self, image: &RgbImage) -> Result<(), VisionError> {
        check_size(image.dimensions())?;
        let (w, h) = image.dimensions();
        let target = fit_within(w, h, Some(self.options.max_side));
        if target == (w, h) {
            self.load_sized(image);
        } else {
            self.load_sized(&resized(image, target));
        }
        Ok(())
    }

    /// Loads a picture of the analysis size.
    fn load_sized(&mut self, image: &RgbImage) {
        let (model, limit) = (&self.model, self.options.swept.colour);
        let Some((still, _)) = &self.still else { return self.field.load(image, model) };
        self.field.load_with(image, |y, row, ratios| {
            let start = ratios.len();
            ratios.extend(row.ycc.iter().map(|&ycc| limited(model.ratio(cell(ycc)), limit)));
            still.row(0, y).add_ratios(row.rgb, ratios.get_mut(start..).unwrap_or(&mut []));
        });
    }

    /// Drops the wrists of the frame before, the priors of the next: to be called at a cut of the clip.
    pub fn reset(&mut self) {
        self.wrists.clear();
    }

    /// Posterior probability of skin for each pixel of the last picture, 0..=255 at the analysis size, where skin
    /// and background have the same prior.
    pub fn posterior(&self) -> GrayImage {
        self.field.posterior()
    }

    /// The pixels of the last picture whose posterior is above one half, at the analysis size.
    pub fn skin_mask(&self) -> Mask {
        self.field.coarse()
    }
}

fn no_hand(what: &str) -> VisionError {
    VisionError::NoHand { what: what.to_owned() }
}

/// There is no hand; where much of the pictures is brighter than the camera can tell, this may be why.
fn over_exposed(samples: &[RgbImage], what: &str) -> VisionError {
    let pixels = || samples.iter().flat_map(RgbImage::pixels);
    let bright = pixels().filter(|p| p.0.iter().all(|&v| v >= OVER_EXPOSED)).count();
    let share = 100.0 * bright as f64 / pixels().count().max(1) as f64;
    if share < LEAST_OVER_EXPOSED {
        return no_hand(what);
    }
    no_hand(&format!(
        "{what}; {share:.0} % of the picture is over-exposed, and skin that is has no colour: less light helps"
    ))
}

/// The border of the picture where it is far from `part`.
fn border_far_from(part: &Mask, tuning: &LearningTuning) -> Mask {
    let (w, h) = (part.width(), part.height());
    let far = f64::from(w.max(h)) * tuning.border_distance;
    let mut far = invert(&within(part, true, far));
    let [inner_x, inner_y] = [w, h].map(|side| {
        let border = (f64::from(side) * tuning.border_width) as u32;
        border..side.saturating_sub(border)
    });
    far.subtract(&Mask::from_fn(w, h, |x, y| inner_x.contains(&x) && inner_y.contains(&y)));
    far
}
