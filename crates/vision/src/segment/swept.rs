//! Hands that move before a background that stands still: what they sweep over, and what is behind them.
//!
//! Where a pixel varies by more than noise, a hand has been; around lies background alone. Of what was swept the inner
//! part is hand most of the time, which tells its colours; these tell in which pictures a pixel shows the hand, and
//! the others show what is behind it, which tells the colours better, in a few rounds.

use image::RgbImage;

use super::field::smooth;
use crate::colour::{ColourModel, ColourTuning, Counts, cell, ycc};
use crate::mask::Mask;
use crate::morphology::{Components, DistanceMap, dilate, erode, invert};
use crate::still::{StillBackground, StillTuning};
use crate::tuning::tuning;

tuning! {
    /// How a hand is learnt that moves before a background that stands still.
    pub struct SweptTuning {
        /// Standard deviation of a pixel in time that is a motion.
        ["standard deviations of the noise", "rendered hands: the area swept over overlaps the true one by 0.95"]
        pub moved: f32 = 3.5,
        /// Least noise.
        ["levels", "chosen by eye: compressed video"]
        pub least_noise: f32 = 0.7,
        /// Most noise of a background that stands still.
        ["levels", "chosen by eye: noise of small cameras"]
        pub most_noise: f32 = 5.0,
        /// Least and largest share of the picture that a hand and its arm sweep over.
        ["1 (share of the picture)", "chosen by eye"]
        pub area: [f64; 2] = [0.01, 0.6],
        /// Least share of the largest part of what was swept over that another part has.
        ["1", "chosen by eye"]
        pub part: f64 = 0.2,
        /// Largest part that is enclosed by what was swept over, and belongs to it: a palm that rests.
        ["1 (share of the picture)", "chosen by eye"]
        pub enclosed: f64 = 0.05,
        /// How far from it the background is like what is behind the hand.
        ["1 (share of the root of its area)", "chosen by eye"]
        pub ring: f64 = 0.35,
        /// Depth from which it is taken for a hand at first.
        ["1 (share of the deepest)", "chosen by eye"]
        pub core: f64 = 0.4,
        /// Rounds in which colours and background are estimated in turns.
        ["rounds", "rendered hands: no change after six"]
        pub rounds: usize = 6,
        /// Probability of a hand below which a pixel shows the background.
        ["1", "chosen by eye"]
        pub background: f32 = 0.3,
        /// Probability from which it shows the hand.
        ["1", "chosen by eye"]
        pub hand: f32 = 0.8,
        /// Pictures that must show the background of a pixel.
        ["pictures", "chosen by eye"]
        pub least_seen: u16 = 3,
        /// Largest standard deviation of a background.
        ["standard deviations of the noise", "chosen by eye: shadows pass over it"]
        pub steady: f32 = 6.0,
        /// Largest log-likelihood ratio of a colour.
        ["nat", "chosen by eye"]
        pub colour: f32 = 5.0,
        /// Log-likelihood ratio of a place that was never swept over.
        ["nat", "chosen by eye"]
        pub unswept: f32 = -6.0,
        /// Log-likelihood ratio of a place per depth, beyond the one of no preference, and its limits.
        ["nat (per the deepest)", "chosen by eye"]
        pub depth: f32 = 4.0,
        /// The depth of no preference.
        ["1 (share of the deepest)", "chosen by eye"]
        pub indifferent: f32 = 0.35,
        /// The limits.
        ["nat", "chosen by eye"]
        pub depth_limits: [f32; 2] = [-0.5, 2.0],
        /// Colours need no help where at least this share of what is coloured like skin was swept over.
        ["1", "rendered hands: from 0.96 on before grey and the sky, to 0.63 before fur and wood; the counting clip 0.69"]
        pub agree: f64 = 0.66,
        /// They tell nothing where less than this share was.
        ["1", "chosen: most of it is no hand"]
        pub tell_nothing: f64 = 0.5,
        /// Pictures in which what moves must be an open hand.
        ["pictures", "rendered hands: 3 and more of 16; by chance 1 in the counting clip"]
        pub least_open: usize = 3,
        /// Every so many pictures the background is learnt on.
        ["pictures", "chosen for speed"]
        pub learn_every: usize = 3,
        /// How far from what is taken for a hand it is learnt.
        ["pixels", "chosen by eye"]
        pub margin: u32 = 6,
        /// A pixel that is as its background was.
        ["nat", "chosen by eye: surer than any colour"]
        pub same_ratio: f32 = -5.0,
    }
}

/// What moved in pictures of a clip.
pub(super) struct Swept {
    /// Where, the inside filled.
    pub(super) mask: Mask,
    /// Standard deviation of a channel where nothing moves, levels.
    noise: f32,
}

impl Swept {
    /// What moved in pictures of one size; `None` where the background does not stand still, or where too little or too
    /// much moved.
    pub(super) fn of(samples: &[RgbImage], tuning: &SweptTuning) -> Option<Self> {
        let (width, height) = samples.first()?.dimensions();
        if samples.len() < usize::from(tuning.least_seen)
            || samples.iter().any(|s| s.dimensions() != (width, height))
        {
            return None;
        }
        let deviation = deviations(samples);
        let mut sorted = deviation.clone();
        let quarter = sorted.len() / 4;
        let (_, noise, _) = sorted.select_nth_unstable_by(quarter, f32::total_cmp);
        let noise = noise.max(tuning.least_noise);
        if noise > tuning.most_noise {
            return None;
        }
        let moved = Mask::from_fn(width, height, |x, y| {
            deviation.get((y * width + x) as usize).is_some_and(|&d| d > tuning.moved * noise)
        });
        // Single pixels are noise; gaps of a few are where hand and background are alike.
        let moved = erode(&dilate(&dilate(&erode(&moved, 1), 1), 2), 2);
        let parts = Components::of(&moved, true);
        let least = tuning.part * f64::from(parts.list.get(parts.largest()?)?.area);
        let mut mask = Mask::new(width, height);
        parts.draw(&mut mask, |_, part| f64::from(part.area) >= least);
        let pixels = f64::from(width) * f64::from(height);
        // What the border of the picture and an arm enclose is enclosed, too.
        let around = Components::of(&invert(&mask), false);
        around.draw(&mut mask, |_, part| f64::from(part.area) < tuning.enclosed * pixels);
        let [least, most] = tuning.area.map(|share| share * pixels);
        (least..most).contains(&f64::from(mask.area())).then_some(Self { mask, noise })
    }

    /// How much of `parts` was swept over: pixels there, and all.
    pub(super) fn share_of(&self, part: &Mask) -> [f64; 2] {
        [part.overlap(&self.mask), part.area()].map(f64::from)
    }
}

/// The standard deviation in time of each pixel, that of the channel that varies most, after smoothing.
fn deviations(samples: &[RgbImage]) -> Vec<f32> {
    let Some(first) = samples.first() else { return Vec::new() };
    let size = (first.width() as usize, first.height() as usize);
    let mut out = vec![0.0f32; size.0 * size.1];
    let (mut plane, mut scratch) = (Vec::new(), Vec::new());
    for channel in 0..3 {
        let mut sums = vec![[0.0f32; 2]; out.len()];
        for sample in samples {
            plane.clear();
            plane.extend(sample.as_raw().as_chunks::<3>().0.iter().map(|p| f32::from(p[channel])));
            smooth(&mut plane, &mut scratch, size);
            for (sum, &value) in sums.iter_mut().zip(&plane) {
                // About the middle of the range, to keep the digits.
                let v = value - 128.0;
                *sum = [sum[0] + v, sum[1] + v * v];
            }
        }
        let count = samples.len() as f32;
        for (out, [sum, squares]) in out.iter_mut().zip(sums) {
            let mean = sum / count;
            *out = out.max((squares / count - mean * mean).max(0.0).sqrt());
        }
    }
    out
}

/// Colours and background in the making.
struct Rounds<'a> {
    samples: &'a [RgbImage],
    cells: Vec<Vec<u32>>,
    swept: &'a Swept,
    /// Log-likelihood ratio of each place.
    places: Vec<f32>,
    ring: Mask,
    /// Probability that a pixel shows the hand, for each picture.
    hand: Vec<Vec<f32>>,
    tuning: &'a SweptTuning,
    colour: &'a ColourTuning,
}

/// The background of a pixel.
#[derive(Clone, Copy, Debug, Default)]
struct Behind {
    mean: [f32; 3],
    squares: f32,
    seen: u16,
}

impl<'a> Rounds<'a> {
    fn new(
        samples: &'a [RgbImage],
        swept: &'a Swept,
        tuning: &'a SweptTuning,
        colour: &'a ColourTuning,
    ) -> Self {
        let mask = &swept.mask;
        let depth = DistanceMap::to_value(mask, false);
        let outside = DistanceMap::to_value(mask, true);
        let far = tuning.ring * tuning.ring * f64::from(mask.area());
        // Two pixels out no hand is mixed in.
        let ring = outside.select(|d| d > 4 && f64::from(d) < far);
        let (w, h) = (mask.width(), mask.height());
        let all = (0..h).flat_map(|y| (0..w).map(move |x| (x, y)));
        let depths: Vec<f32> = all
            .map(|(x, y)| if mask.get(x, y) { (depth.squared(x, y) as f32).sqrt() } else { 0.0 })
            .collect();
        let deepest = depths.iter().copied().fold(1.0, f32::max);
        let [low, high] = tuning.depth_limits;
        let place = |&d: &f32| match d > 0.0 {
            true => (tuning.depth * (d / deepest - tuning.indifferent)).clamp(low, high),
            false => tuning.unswept,
        };
        let core = tuning.core as f32 * deepest;
        let first: Vec<f32> = depths.iter().map(|&d| (d / core).min(1.0)).collect();
        let cells = |sample: &RgbImage| {
            sample.as_raw().as_chunks::<3>().0.iter().map(|&p| cell(ycc(p)) as u32).collect()
        };
        Self {
            samples,
            cells: samples.iter().map(cells).collect(),
            swept,
            places: depths.iter().map(place).collect(),
            ring,
            hand: vec![first; samples.len()],
            tuning,
            colour,
        }
    }

    /// The colours of hand and background, as far as it is known which is which.
    fn colours(&self, first: bool) -> ColourModel {
        let (mut skin, mut background) = (Counts::new(), Counts::new());
        for (cells, hand) in self.cells.iter().zip(&self.hand) {
            for (x, y) in self.ring.pixels() {
                background.add(cells[(y * self.ring.width() + x) as usize] as usize);
            }
            for (x, y) in self.swept.mask.pixels() {
                let i = (y * self.ring.width() + x) as usize;
                if hand[i] > if first { 0.99 } else { self.tuning.hand } {
                    skin.add(cells[i] as usize);
                } else if !first && hand[i] < self.tuning.background {
                    background.add(cells[i] as usize);
                }
            }
        }
        ColourModel::from_counts(&skin, &background, false, self.colour)
    }

    /// What is behind the hand, where that was seen, and around it.
    fn behind(&self) -> Vec<Behind> {
        let mut behind = vec![Behind::default(); self.places.len()];
        for (sample, hand) in self.samples.iter().zip(&self.hand) {
            let pixels = behind.iter_mut().zip(sample.as_raw().as_chunks::<3>().0).zip(hand);
            for ((behind, rgb), &hand) in pixels {
                if hand < self.tuning.background {
                    let rgb = rgb.map(f32::from);
                    (0..3).for_each(|c| behind.mean[c] += rgb[c]);
                    behind.squares += rgb.iter().map(|v| v * v).sum::<f32>();
                    behind.seen += 1;
                }
            }
        }
        let most = (self.tuning.steady * self.swept.noise).powi(2);
        for pixel in &mut behind {
            let count = f32::from(pixel.seen.max(1));
            pixel.mean = pixel.mean.map(|v| v / count);
            let mean = pixel.mean.iter().map(|v| v * v).sum::<f32>();
            if (pixel.squares / count - mean) / 3.0 > most || pixel.seen < self.tuning.least_seen {
                pixel.seen = 0;
            }
        }
        behind
    }

    /// What each pixel of each picture shows.
    fn classify(&mut self, model: &ColourModel, behind: Option<&[Behind]>) {
        let size = (self.ring.width() as usize, self.ring.height() as usize);
        let (mut ratios, mut scratch) = (Vec::new(), Vec::new());
        let t = self.tuning;
        let scale = 0.5 / 3.0 / (4.0 * self.swept.noise).powi(2);
        for ((sample, cells), hand) in self.samples.iter().zip(&self.cells).zip(&mut self.hand) {
            ratios.clear();
            ratios.extend(cells.iter().map(|&c| model.ratio(c as usize).clamp(-t.colour, t.colour)));
            smooth(&mut ratios, &mut scratch, size);
            for (i, (ratio, rgb)) in ratios.iter().zip(sample.as_raw().as_chunks::<3>().0).enumerate() {
                let still = behind.and_then(|b| b.get(i)).filter(|b| b.seen > 0).map_or(0.0, |b| {
                    let off: f32 = (0..3).map(|c| (f32::from(rgb[c]) - b.mean[c]).powi(2)).sum();
                    (-2.5 + scale * off).min(3.0)
                });
                hand[i] = 1.0 / (1.0 + (-(ratio + still + self.places[i])).exp());
            }
        }
    }
}

/// Colours of what moved in `small` pictures, and the background in the same pictures at full size.
pub(super) fn learn(
    (small, full): (&[RgbImage], &[RgbImage]),
    swept: &Swept,
    tuning: &SweptTuning,
    colour: &ColourTuning,
) -> Option<(ColourModel, StillBackground)> {
    let mut rounds = Rounds::new(small, swept, tuning, colour);
    let mut model = rounds.colours(true);
    rounds.classify(&model, None);
    for _ in 1..tuning.rounds.max(1) {
        model = rounds.colours(false);
        let behind = rounds.behind();
        rounds.classify(&model, Some(&behind));
    }
    let mut options = StillTuning::default();
    options.same_ratio = tuning.same_ratio;
    options.known_after = tuning.least_seen;
    options.least_noise = options.least_noise.max(2.0 * swept.noise);
    let mut still = StillBackground::new(options);
    for (image, hand) in full.iter().zip(&rounds.hand) {
        let (w, h) = image.dimensions();
        let (sw, sh) = (swept.mask.width(), swept.mask.height());
        let covered = Mask::from_fn(w, h, |x, y| {
            let (sx, sy) = ((x * sw / w.max(1)).min(sw - 1), (y * sh / h.max(1)).min(sh - 1));
            hand.get((sy * sw + sx) as usize).is_some_and(|&p| p >= tuning.background)
        });
        still.learn(image, &dilate(&covered, 2));
    }
    Some((model, still))
}
