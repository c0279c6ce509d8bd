//! Hands that move before a background that stands still: what they sweep over, and what is behind them.
//!
//! Where a pixel varies by more than noise, a hand has been; around lies background alone. Of what was swept the inner
//! part is hand most of the time, which tells its colours; these tell in which pictures a pixel shows the hand, and
//! the others show what is behind it, which tells the colours better, in a few rounds.

use image::RgbImage;

use super::field::smooth;
use crate::colour::{ColourModel, ColourTuning, Counts, cell, limited, ycc};
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
        /// Difference from a pixel's median colour up to which it is usual there.
        ["standard deviations of the noise", "chosen by eye; a level is added"]
        pub usual: f32 = 4.0,
        /// Shares of the pictures that must show the usual colour for it to be likelier the background's: a hand that
        /// moves does not show the same twice.
        ["1", "chosen: between a hand that rests and one that is everywhere"]
        pub usual_shares: [f32; 2] = [0.3, 0.9],
        /// Log-likelihood ratio of a colour that is not usual there, and against one that is.
        ["nat", "rendered hands: silhouettes of a waving arm overlap by 0.96 in place of 0.57 before wood; with 2 others lose 0.005"]
        pub unusual: f32 = 1.0,
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

/// What pictures of a clip tell of motion.
pub(super) enum Motion {
    /// Something that may be a hand moved before a background that stands still.
    Swept(Swept),
    /// Nothing moved that is large enough for a hand.
    None,
    /// The background does not stand still, or too much moved.
    Everywhere,
}

/// What moved in pictures of a clip.
pub(super) struct Swept {
    /// Where, the inside filled.
    pub(super) mask: Mask,
    /// Standard deviation of a channel where nothing moves, levels.
    noise: f32,
}

impl Motion {
    /// What moved in pictures of one size; of too few, or of several sizes, nothing is told.
    pub(super) fn of(samples: &[RgbImage], tuning: &SweptTuning) -> Self {
        let Some((width, height)) = samples.first().map(RgbImage::dimensions) else {
            return Self::Everywhere;
        };
        if samples.len() < usize::from(tuning.least_seen)
            || samples.iter().any(|s| s.dimensions() != (width, height))
        {
            return Self::Everywhere;
        }
        let deviation = deviations(samples);
        let mut sorted = deviation.clone();
        let quarter = sorted.len() / 4;
        let (_, noise, _) = sorted.select_nth_unstable_by(quarter, f32::total_cmp);
        let noise = noise.max(tuning.least_noise);
        if noise > tuning.most_noise {
            return Self::Everywhere;
        }
        let moved = Mask::from_fn(width, height, |x, y| {
            deviation.get((y * width + x) as usize).is_some_and(|&d| d > tuning.moved * noise)
        });
        // Single pixels are noise; gaps of a few are where hand and background are alike.
        let moved = erode(&dilate(&dilate(&erode(&moved, 1), 1), 2), 2);
        let parts = Components::of(&moved, true);
        let Some(largest) = parts.largest().and_then(|largest| parts.list.get(largest)) else {
            return Self::None;
        };
        let least = tuning.part * f64::from(largest.area);
        let mut mask = Mask::new(width, height);
        parts.draw(&mut mask, |_, part| f64::from(part.area) >= least);
        let pixels = f64::from(width) * f64::from(height);
        // What the border of the picture and an arm enclose is enclosed, too.
        let around = Components::of(&invert(&mask), false);
        around.draw(&mut mask, |_, part| f64::from(part.area) < tuning.enclosed * pixels);
        let [least, most] = tuning.area.map(|share| share * pixels);
        match f64::from(mask.area()) {
            area if area >= most => Self::Everywhere,
            area if area >= least => Self::Swept(Swept { mask, noise }),
            _ => Self::None,
        }
    }

    /// What moved, where that may be a hand.
    pub(super) fn swept(self) -> Option<Swept> {
        match self {
            Self::Swept(swept) => Some(swept),
            Self::None | Self::Everywhere => None,
        }
    }
}

impl Swept {
    /// How much of `parts` was swept over: pixels there, and all.
    pub(super) fn share_of(&self, part: &Mask) -> [f64; 2] {
        [part.overlap(&self.mask), part.area()].map(f64::from)
    }

    /// How much of what was found in the pictures, one mask for each, was swept over, and how much of what was swept over was
    /// found once; 0 to 1.
    pub(super) fn agreement(&self, found: &[Mask]) -> [f64; 2] {
        let [inside, all] = found.iter().fold([0.0; 2], |[inside, all], part| {
            let area = f64::from(part.area());
            [inside + area * self.covers(part), all + area]
        });
        let [w, h] = [self.mask.width(), self.mask.height()].map(|side| side.max(1));
        let once = |&(x, y): &(u32, u32)| {
            found.iter().any(|part| part.get(x * part.width() / w, y * part.height() / h))
        };
        let shown = self.mask.pixels().filter(once).count() as f64;
        [inside / all.max(1.0), shown / f64::from(self.mask.area().max(1))]
    }

    /// The share of a mask of any size that was swept over, 0 to 1.
    pub(super) fn covers(&self, part: &Mask) -> f64 {
        let size = [part.width(), part.height()].map(|side| side.max(1));
        let [w, h] = [self.mask.width(), self.mask.height()];
        let swept = |(x, y): &(u32, u32)| self.mask.get(x * w / size[0], y * h / size[1]);
        part.pixels().filter(swept).count() as f64 / f64::from(part.area().max(1))
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
    /// Log-likelihood ratio of what is usual at a place or is not, for each picture.
    usual: Vec<Vec<f32>>,
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
            true => (tuning.depth * (d / deepest - tuning.indifferent)).max(low).min(high),
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
            usual: usual(samples, &swept.mask, swept.noise, tuning),
            ring,
            hand: vec![first; samples.len()],
            tuning,
            colour,
        }
    }

    /// The colours of hand and background, as far as it is known which is which.
    fn colours(&self, first: bool) -> ColourModel {
        let (mut skin, mut background) = (Counts::new(), Counts::new());
        for ((cells, hand), usual) in self.cells.iter().zip(&self.hand).zip(&self.usual) {
            for (x, y) in self.ring.pixels() {
                background.add(cells[(y * self.ring.width() + x) as usize] as usize);
            }
            for (x, y) in self.swept.mask.pixels() {
                let i = (y * self.ring.width() + x) as usize;
                let is_hand = match first {
                    true => hand[i] >= 1.0 && usual[i] >= 0.0,
                    false => hand[i] > self.tuning.hand,
                };
                if is_hand {
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
        let pictures = self.samples.iter().zip(&self.cells).zip(&self.usual);
        for (((sample, cells), usual), hand) in pictures.zip(&mut self.hand) {
            ratios.clear();
            ratios.extend(cells.iter().map(|&c| limited(model.ratio(c as usize), t.colour)));
            smooth(&mut ratios, &mut scratch, size);
            for (i, (ratio, rgb)) in ratios.iter().zip(sample.as_raw().as_chunks::<3>().0).enumerate() {
                let still = behind.and_then(|b| b.get(i)).filter(|b| b.seen > 0).map_or(0.0, |b| {
                    let off: f32 = (0..3).map(|c| (f32::from(rgb[c]) - b.mean[c]).powi(2)).sum();
                    (-2.5 + scale * off).min(3.0)
                });
                hand[i] = 1.0 / (1.0 + (-(ratio + still + usual[i] + self.places[i])).exp());
            }
        }
    }
}

/// For each picture, the log-likelihood ratio of a hand at each pixel by whether its colour is usual there.
fn usual(samples: &[RgbImage], swept: &Mask, noise: f32, tuning: &SweptTuning) -> Vec<Vec<f32>> {
    let mut out = vec![vec![0.0; swept.width() as usize * swept.height() as usize]; samples.len()];
    let limit = tuning.usual * noise + 1.0;
    let [least, most] = tuning.usual_shares.map(|share| share * samples.len() as f32);
    let mut values: Vec<[u8; 3]> = Vec::with_capacity(samples.len());
    let mut channel: Vec<u8> = Vec::with_capacity(samples.len());
    for (x, y) in swept.pixels() {
        values.clear();
        values.extend(samples.iter().map(|sample| sample.get_pixel(x, y).0));
        let median: [f32; 3] = std::array::from_fn(|c| {
            channel.clear();
            channel.extend(values.iter().map(|v| v[c]));
            channel.sort_unstable();
            channel.get(channel.len() / 2).map_or(0.0, |&v| f32::from(v))
        });
        let is_usual = |v: &[u8; 3]| (0..3).all(|c| (f32::from(v[c]) - median[c]).abs() < limit);
        let count = values.iter().filter(|v| is_usual(v)).count() as f32;
        if (least..most).contains(&count) {
            let i = (y * swept.width() + x) as usize;
            for (out, value) in out.iter_mut().zip(&values) {
                out[i] = if is_usual(value) { -tuning.unusual } else { tuning.unusual };
            }
        }
    }
    out
}

/// Colours of what moved in `small` pictures, and the background in the same pictures at full size.
pub(super) fn learn(
    (small, full): (&[RgbImage], &[RgbImage]),
    swept: &Swept,
    tuning: &SweptTuning,
    colour: &ColourTuning,
) -> (ColourModel, StillBackground) {
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
    (model, still)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tuning::Tuning;

    /// A bar of skin's hue that swings before stripes of about its colour, with noise; where it is.
    fn scene(step: u32, still: bool) -> (RgbImage, Mask) {
        let left = 30 + if still { 0 } else { 3 * (step % 9) };
        let mask = Mask::from_fn(120, 90, |x, y| (left..left + 24).contains(&x) && y > 20);
        let image = RgbImage::from_fn(120, 90, |x, y| {
            let noise = ((x * 7 + y * 13 + step * 29) % 5) as u8;
            let colour = match mask.get(x, y) {
                true => [205 + ((x - left) % 4) as u8, 150 + (y % 8) as u8, 125],
                false if (x / 6 + y / 6) % 2 == 0 => [190, 165, 120],
                false => [160, 120, 80],
            };
            image::Rgb(colour.map(|c| c + noise))
        });
        (image, mask)
    }

    #[test]
    fn what_moves_before_its_own_colour_is_found_with_what_is_behind_it() {
        let (pictures, masks): (Vec<_>, Vec<_>) = (0..16).map(|step| scene(step, false)).unzip();
        let (t, colour) = (SweptTuning::default(), ColourTuning::default());
        let swept = Motion::of(&pictures, &t).swept().unwrap();
        let mut union = Mask::new(120, 90);
        masks.iter().for_each(|mask| union.union_with(mask));
        assert!(swept.mask.iou(&union) > 0.9, "{}", swept.mask.iou(&union));
        let (model, still) = learn((&pictures, &pictures), &swept, &t, &colour);
        for (picture, mask) in pictures.iter().zip(&masks) {
            let found = Mask::from_fn(120, 90, |x, y| {
                let rgb = picture.get_pixel(x, y).0;
                let mut ratio = [limited(model.ratio(cell(ycc(rgb))), t.colour)];
                still.row(x, y).add_ratios(&[rgb], &mut ratio);
                ratio[0] > 0.0
            });
            assert!(found.iou(mask) > 0.9, "{}", found.iou(mask));
        }
    }

    #[test]
    fn no_constant_makes_it_panic() {
        let pictures: Vec<_> = (0..6).map(|step| scene(step, false).0).collect();
        let mut paths = Vec::new();
        SweptTuning::default().visit("swept", &mut |c| paths.push(c.path));
        for path in paths {
            for factor in [-1.0, 0.0, 0.5, 30.0] {
                let mut t = SweptTuning::default();
                t.visit("swept", &mut |c| {
                    if c.path == path {
                        c.value.scale(factor);
                    }
                });
                t.rounds = t.rounds.min(3);
                if let Motion::Swept(swept) = Motion::of(&pictures, &t) {
                    let (_, still) = learn((&pictures, &pictures), &swept, &t, &ColourTuning::default());
                    assert!((0.0..=1.0).contains(&still.known()), "{path} {factor}");
                }
            }
        }
    }

    #[test]
    fn nothing_is_swept_by_what_rests_nor_by_a_camera_that_moves() {
        let t = SweptTuning::default();
        let still: Vec<_> = (0..16).map(|step| scene(step, true).0).collect();
        assert!(matches!(Motion::of(&still, &t), Motion::None));
        let panned: Vec<_> = (0..16)
            .map(|step| {
                RgbImage::from_fn(120, 90, |x, y| image::Rgb([((x + 5 * step) * 11 % 200) as u8, y as u8, 9]))
            })
            .collect();
        for untold in [&panned[..], &still[..1], &[]] {
            assert!(matches!(Motion::of(untold, &t), Motion::Everywhere));
        }
    }
}
