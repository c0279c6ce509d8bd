//! Silhouettes of hands whose joints are known about: where to look, which colours are the hand's, which part of the
//! picture is it.
//!
//! Each pixel has three witnesses that are added up as log-likelihood ratios: its place beside the joints, its colour
//! against those learnt along the bones and in a ring round the hand, and, where the camera stands still, whether it
//! differs from the background seen there before.

mod figure;

use image::RgbImage;

use super::colour::{ColourModel, Counts, cell, limited, ycc};
use super::geometry::{moved, pixel_centre};
use super::mask::{Mask, PixelRect};
use super::morphology::Components;
use super::segment::field::LikelihoodField;
use super::segment::{SegmentOptions, Silhouette};
use super::sighting::Sighting;
use super::still::{StillBackground, StillTuning};
use super::tuning::tuning;
use super::wrist::{InscribedCircle, Wrist};
use figure::Figure;

tuning! {
    /// Segmentation round joints. Lengths are in lengths of the hand.
    pub struct GuidedTuning {
        /// A background that stands still.
        pub still: StillTuning,
        /// How far round the joints a hand is looked for.
        ["hand lengths", "chosen by eye"]
        pub margin: f64 = 0.35,
        /// Distance from the expected outline at which the place speaks neither for nor against the hand.
        ["hand lengths", "chosen by eye"]
        pub edge: f64 = 0.0,
        /// Distance beyond it that makes the hand e times less likely.
        ["hand lengths", "chosen by eye: joints are seen within 2 %, and widths vary"]
        pub blur: f64 = 0.06,
        /// Largest log-likelihood ratio of a place inside.
        ["nat", "chosen by eye"]
        pub inside: f64 = 2.5,
        /// And outside, where no colour makes it a hand.
        ["nat", "chosen by eye"]
        pub outside: f64 = 9.0,
        /// Largest log-likelihood ratio of colour and background together, either way.
        ["nat", "chosen by eye"]
        pub appearance: f32 = 5.0,
        /// How far inside the expected outline skin is learnt.
        ["hand lengths", "chosen by eye: half a finger's radius"]
        pub core: f64 = 0.02,
        /// The ring, from and to, in which the colours of the background are learnt.
        ["hand lengths", "chosen by eye"]
        pub ring: [f64; 2] = [0.12, 0.4],
        /// How far from the joints nothing of the hand is, when the background is learnt.
        ["hand lengths", "chosen by eye"]
        pub clear: f64 = 0.15,
        /// How much of the counts of colours is kept from picture to picture.
        ["1", "chosen by eye: half after a second"]
        pub kept: f32 = 0.975,
        /// Pictures after which the colours are learnt anew from the counts.
        ["pictures", "chosen for speed"]
        pub renewed: usize = 6,
        /// Smallest length of a hand.
        ["pixels", "chosen: a finger is two pixels wide then"]
        pub least_length: f64 = 24.0,
        /// Share of the hand's core that a separate part must hold to belong to it.
        ["1", "chosen by eye"]
        pub least_share: f64 = 0.02,
        /// How far behind the wrist's joint, as finders see it, the hand is cut from the forearm.
        ["hand lengths", "constant offset of MediaPipe's wrist on rendered hands: 8 %"]
        pub behind: f64 = 0.08,
    }
}

impl GuidedTuning {
    /// The same place, from the hand and from the forearm, as distance from the hand and log-likelihood ratio.
    fn log_odds(&self, [away, arm]: [f32; 2]) -> [f32; 2] {
        let of = |away: f32| (self.edge as f32 - away) / self.blur as f32;
        let (hand, arm) = (of(away), of(arm));
        let arm = if arm < 0.0 { arm } else { 0.0 };
        let place = if hand > arm { hand } else { arm };
        let place = if place < self.inside as f32 { place } else { self.inside as f32 };
        [away, if place > -self.outside as f32 { place } else { -self.outside as f32 }]
    }

    /// What lies inside another hand, this far from it, is of the nearer one.
    fn leave(&self, [away, place]: &mut [f32; 2], theirs: f32) {
        if theirs < self.edge as f32 {
            *place = place.min((theirs - *away) / self.blur as f32);
        }
    }
}

/// Length of the hand of a sighting if it were stretched out and faced the camera, pixels; `None` where its joints
/// are in one place.
pub fn hand_length_in(hand: &Sighting) -> Option<f64> {
    Figure::of(hand).map(|figure| figure.length)
}

/// Side of the cells in which distances from the joints are computed, pixels.
const CELL: u32 = 8;

/// Finds silhouettes round joints, in pictures of one film in order.
#[derive(Clone, Debug)]
pub struct GuidedSegmenter {
    options: SegmentOptions,
    tuning: GuidedTuning,
    skin: Counts,
    background: Counts,
    model: Option<ColourModel>,
    /// Pictures since the colours were learnt.
    since: usize,
    still: StillBackground,
    field: LikelihoodField,
}

impl GuidedSegmenter {
    /// A segmenter that has seen nothing.
    pub fn new(options: SegmentOptions, tuning: GuidedTuning) -> Self {
        Self {
            options,
            tuning,
            skin: Counts::new(),
            background: Counts::new(),
            model: None,
            since: 0,
            still: StillBackground::new(tuning.still),
            field: LikelihoodField::default(),
        }
    }

    /// Learns colours and background from a picture with these hands; what it told before fades. One without presence
    /// only hides the background.
    pub fn learn(&mut self, image: &RgbImage, hands: &[Sighting]) {
        let t = self.tuning;
        let figures: Vec<(Figure, bool)> =
            hands.iter().filter_map(|hand| Some((Figure::of(hand)?, hand.presence > 0.0))).collect();
        if figures.iter().any(|(_, seen)| *seen) {
            self.skin.fade(t.kept);
            self.background.fade(t.kept);
        }
        let mut covered = Mask::new(image.width(), image.height());
        for (figure, seen) in &figures {
            let Some(window) = figure.window(t.margin.max(t.ring[1]), image.dimensions()) else { continue };
            let places = Places::of(figure, window);
            let (clear, core, ring) = (t.clear as f32, t.core as f32, t.ring.map(|r| r as f32));
            let mut row = Vec::new();
            for y in window.y0..window.y1 {
                places.row(y, &mut row);
                for (x, &[away, arm]) in (window.x0..window.x1).zip(&row) {
                    if away < clear || arm < clear {
                        covered.set(x, y, true);
                    }
                    // Every other pixel tells enough.
                    if *seen && (x + y) % 2 == 0 {
                        let count = if away < -core {
                            &mut self.skin
                        } else if (ring[0]..ring[1]).contains(&away) && arm > clear {
                            &mut self.background
                        } else {
                            continue;
                        };
                        count.add(cell(ycc(image.get_pixel(x, y).0)));
                    }
                }
            }
            figure.cover_forearm(t.clear, &mut covered);
        }
        // The hands of others are no background.
        self.still.learn(image, &covered);
        self.since += 1;
        if figures.iter().any(|(_, seen)| *seen) && (self.model.is_none() || self.since >= t.renewed) {
            self.since = 0;
            let model = ColourModel::from_counts(&self.skin, &self.background, false, &self.options.colour);
            self.model = Some(model);
        }
    }

    /// The silhouette of a hand; `None` where nothing of it can be seen, or it is too small.
    /// What is nearer to one of the `others` is of that one.
    pub fn segment(&mut self, image: &RgbImage, hand: &Sighting, others: &[&Sighting]) -> Option<Silhouette> {
        let t = self.tuning;
        let figure = Figure::of(hand).filter(|figure| figure.length >= t.least_length)?;
        let window = figure.window(t.margin, image.dimensions())?;
        let model = self.model.as_ref()?;
        let (width, height) = (window.x1 - window.x0, window.y1 - window.y0);
        let crop = image::imageops::crop_imm(image, window.x0, window.y0, width, height).to_image();
        let places = Places::of(&figure, window);
        let others: Vec<Places> =
            others.iter().filter_map(|other| Some(Places::of(&Figure::of(other)?, window))).collect();
        let mut core = Mask::new(width, height);
        let (mut own, mut other) = (Vec::new(), Vec::new());
        self.field.load_with(&crop, |y, row, ratios| {
            let at_y = window.y0 + y;
            places.row(at_y, &mut own);
            let from = ratios.len();
            ratios.extend(row.ycc.iter().map(|&ycc| model.ratio(cell(ycc))));
            let ratios = &mut ratios[from..];
            self.still.row(window.x0, at_y).add_ratios(row.rgb, ratios);
            ratios.iter_mut().for_each(|ratio| *ratio = limited(*ratio, t.appearance));
            for (word, own) in core.row_mut(y).iter_mut().zip(own.chunks(64)) {
                *word =
                    own.iter().rev().fold(0, |bits, [away, _]| bits << 1 | u64::from(*away < -t.core as f32));
            }
            own.iter_mut().for_each(|place| *place = t.log_odds(*place));
            for places in &others {
                places.row(at_y, &mut other);
                own.iter_mut().zip(&other).for_each(|(place, other)| t.leave(place, other[0]));
            }
            ratios.iter_mut().zip(&own).for_each(|(ratio, place)| *ratio += place[1]);
        });
        let coarse = parts_with(&self.field.coarse(), &core, t.least_share);
        let arm = parts_with(&self.field.refine(&coarse, &self.options.outline), &core, t.least_share);
        if arm.is_empty() {
            return None;
        }
        Some(self.cut(&figure, &arm.placed(window, image.dimensions())))
    }

    /// The arm cut at the wrist.
    fn cut(&self, figure: &Figure, arm: &Mask) -> Silhouette {
        let wrist = figure.axis.map(|axis| Wrist {
            centre: moved(figure.wrist, axis, -self.tuning.behind * figure.length),
            axis,
            width: figure.wrist_width(),
        });
        let mut hand = arm.clone();
        if let (Some(wrist), Some(bounds)) = (&wrist, arm.bounds()) {
            for y in bounds.y0..bounds.y1 {
                for x in bounds.x0..bounds.x1 {
                    if wrist.side(pixel_centre(x, y)) <= 0.0 {
                        hand.set(x, y, false);
                    }
                }
            }
        }
        let (w, h) = (hand.width(), hand.height());
        let clipped = hand.bounds().is_some_and(|b| b.x0 == 0 || b.y0 == 0 || b.x1 == w || b.y1 == h);
        let palm = InscribedCircle { centre: figure.palm_centre(), radius: figure.palm_radius() };
        Silhouette { hand, arm: arm.clone(), wrist, palm: Some(palm), clipped }
    }
}

/// Distances from a hand and from its forearm, in hand lengths, on a coarse grid.
struct Places {
    window: PixelRect,
    columns: usize,
    cells: Vec<[f32; 2]>,
}

impl Places {
    fn of(figure: &Figure, window: PixelRect) -> Self {
        let columns = ((window.x1 - window.x0).div_ceil(CELL) + 1) as usize;
        let rows = ((window.y1 - window.y0).div_ceil(CELL) + 1) as usize;
        let mut cells = Vec::with_capacity(columns * rows);
        for row in 0..rows as u32 {
            for column in 0..columns as u32 {
                let at = pixel_centre(window.x0 + CELL * column, window.y0 + CELL * row);
                cells.push([figure.away(at) as f32, figure.forearm_away(at) as f32]);
            }
        }
        Self { window, columns, cells }
    }

    /// Along a row of the picture, from the hand and from the forearm, negative inside.
    fn row(&self, y: u32, out: &mut Vec<[f32; 2]>) {
        let dy = y - self.window.y0;
        let first = (dy / CELL) as usize * self.columns;
        let v = (dy % CELL) as f32 / CELL as f32;
        let cells = |from: usize| self.cells.get(from..from + self.columns).unwrap_or(&[]);
        let (above, below) = (cells(first), cells(first + self.columns));
        let between = |k: usize| -> [f32; 2] {
            let ([a, b], [c, d]) = (above[k], below[k]);
            [(1.0 - v) * a + v * c, (1.0 - v) * b + v * d]
        };
        out.clear();
        let width = (self.window.x1 - self.window.x0) as usize;
        for k in 1..above.len().min(below.len()) {
            let ([a, b], [c, d]) = (between(k - 1), between(k));
            out.extend((0..CELL).map(|x| {
                let u = x as f32 / CELL as f32;
                [(1.0 - u) * a + u * c, (1.0 - u) * b + u * d]
            }));
        }
        out.truncate(width);
    }
}

/// The parts of `mask` that hold at least `share` of `core`.
fn parts_with(mask: &Mask, core: &Mask, share: f64) -> Mask {
    let parts = Components::of(mask, true);
    let mut held = vec![0u32; parts.list.len()];
    for (number, y, start, end) in parts.spans() {
        let inside: u32 = core.runs(y).map(|(a, b)| b.min(end).saturating_sub(a.max(start))).sum();
        held[number] += inside;
    }
    let least = (share * f64::from(core.area())).max(1.0);
    let mut out = Mask::new(mask.width(), mask.height());
    parts.draw(&mut out, |i, _| held.get(i).is_some_and(|&h| f64::from(h) >= least));
    out
}
