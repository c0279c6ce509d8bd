//! Silhouettes of hands whose joints are known about: where to look, which colours are the hand's, which part of the
//! picture is it.
//!
//! Each pixel has three witnesses that are added up as log-likelihood ratios: its place beside the joints, its colour
//! against those learnt along the bones and in a ring round the hand, and, where the camera stands still, whether it
//! differs from the background seen there before.

mod figure;

use image::RgbImage;

use super::colour::{ColourModel, Counts, cell, ycc};
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
            for y in window.y0..window.y1 {
                for x in window.x0..window.x1 {
                    let (away, arm) = places.at(x, y);
                    if away < t.clear || arm < t.clear {
                        covered.set(x, y, true);
                    }
                    // Every other pixel tells enough.
                    if *seen && (x + y) % 2 == 0 {
                        let count = if away < -t.core {
                            &mut self.skin
                        } else if (t.ring[0]..t.ring[1]).contains(&away) && arm > t.clear {
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
        self.field.load_with(&crop, |y, row, ratios| {
            let at_y = window.y0 + y;
            let still = self.still.row(at_y);
            ratios.extend(row.ycc.iter().zip(row.rgb).zip(0..).map(|((&ycc, &rgb), x)| {
                let at_x = window.x0 + x;
                let (away, arm) = places.at(at_x, at_y);
                if away < -t.core {
                    core.set(x, y, true);
                }
                let appearance = model.ratio(cell(ycc)) + still.ratio(at_x as usize, rgb);
                let place = -(away - t.edge) / t.blur;
                let on_arm = -(arm - t.edge) / t.blur;
                let mut place = place.max(on_arm.min(0.0)).clamp(-t.outside, t.inside);
                for other in &others {
                    let (theirs, _) = other.at(at_x, at_y);
                    if theirs < t.edge {
                        place = place.min((theirs - away) / t.blur);
                    }
                }
                appearance.clamp(-t.appearance, t.appearance) + place as f32
            }));
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

    /// Share of the picture whose background is known, 0 to 1.
    pub fn background_known(&self) -> f64 {
        self.still.known()
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

    /// From the hand and from the forearm, negative inside.
    fn at(&self, x: u32, y: u32) -> (f64, f64) {
        let (dx, dy) = (x - self.window.x0, y - self.window.y0);
        let first = (dy / CELL) as usize * self.columns + (dx / CELL) as usize;
        let (u, v) = ((dx % CELL) as f32 / CELL as f32, (dy % CELL) as f32 / CELL as f32);
        let cell = |i: usize| self.cells.get(i).copied().unwrap_or_default();
        let [a, b, c, d] =
            [cell(first), cell(first + 1), cell(first + self.columns), cell(first + self.columns + 1)];
        let mixed = |k: usize| (1.0 - v) * ((1.0 - u) * a[k] + u * b[k]) + v * ((1.0 - u) * c[k] + u * d[k]);
        (f64::from(mixed(0)), f64::from(mixed(1)))
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
