//! What is minimised: the non-overlap rate, the contour distance, and their sum (paper 6.2).

use handcast_track::{HandModel, ModelState, NonOverlap, Window};
use handcast_vision::morphology::erode_square;
use handcast_vision::tuning::tuning;
use handcast_vision::{Chamfer, ChamferMap, Mask, outline};

/// How far a model state is from a silhouette.
pub trait Functional {
    /// Gets ready for the silhouette in `window`.
    fn look_at(&mut self, window: &Window);

    /// The value of a state for the silhouette looked at.
    fn value(&mut self, model: &mut HandModel, state: &ModelState, window: &Window) -> f64;
}

tuning! {
    /// What the paper leaves open of functionals.
    pub struct FunctionalTuning {
        /// Weight of the contour distance in the combined functional, in sides of a square of the silhouette's area.
        ["1", "spec/registration.md 2; handcast bench track"]
        pub contour_weight: f64 = 3.0,
    }
}

/// A functional by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FunctionalKind {
    /// Eq. 7: the pixels of one silhouette only over the sum of both areas.
    #[default]
    NonOverlap,
    /// Eq. 8: the mean distance of the model's occluding contour to the contour of the image.
    Contour,
    /// Eq. 7 plus eq. 8, the distance measured in sides of a square of the silhouette's area, three times.
    Combined,
}

impl FunctionalKind {
    /// Names and functionals, as on the command line.
    pub const ALL: [(&'static str, Self); 3] =
        [("non-overlap", Self::NonOverlap), ("contour", Self::Contour), ("combined", Self::Combined)];

    /// The functional.
    pub fn make(self, chamfer: Chamfer, tuning: &FunctionalTuning) -> Box<dyn Functional> {
        match self {
            Self::NonOverlap => Box::new(NonOverlap::default()),
            Self::Contour => Box::new(ContourDistance::new(chamfer)),
            Self::Combined => {
                Box::new(Combined { contour: ContourDistance::new(chamfer), weight: tuning.contour_weight })
            }
        }
    }
}

impl Functional for NonOverlap {
    fn look_at(&mut self, _: &Window) {}

    fn value(&mut self, model: &mut HandModel, state: &ModelState, window: &Window) -> f64 {
        self.rate(model, state, window)
    }
}

/// Eq. 8: DC(M, I) = 1/|M| Σ distance(m, I) over the pixels m of the model's occluding contour, pixels.
///
/// The distances are read from a chamfer map of the image's contour. Of the model's contours those are
/// taken that have background behind them. Where the forearm was cut off, and at the image's border,
/// there is no contour.
#[derive(Clone, Debug)]
pub struct ContourDistance {
    overlap: NonOverlap,
    map: ChamferMap,
    /// The pixels that may belong to a contour, when the forearm was cut off.
    allowed: Option<Mask>,
}

impl ContourDistance {
    /// A functional that measures distances along these paths.
    pub fn new(chamfer: Chamfer) -> Self {
        Self { overlap: NonOverlap::default(), map: ChamferMap::new(chamfer), allowed: None }
    }

    /// The mean distance of the contour of `drawn`; without a contour, as far as can be in the window.
    fn of(&self, drawn: &Mask) -> f64 {
        let (mut sum, mut count) = (0u64, 0u64);
        let last = drawn.words_per_row().saturating_sub(1);
        let end = 1u64 << (drawn.width().wrapping_sub(1) % 64);
        for y in 0..drawn.height() {
            let row = drawn.row(y);
            let above = (y > 0).then(|| drawn.row(y - 1));
            let below = (y + 1 < drawn.height()).then(|| drawn.row(y + 1));
            let distances = self.map.row(y);
            let allowed = self.allowed.as_ref().map(|a| a.row(y));
            for (i, &word) in row.iter().enumerate() {
                if word == 0 {
                    continue;
                }
                let of = |r: Option<&[u64]>| r.and_then(|r| r.get(i)).copied().unwrap_or(!0);
                let before = i.checked_sub(1).and_then(|k| row.get(k)).map_or(1, |w| w >> 63);
                let after = row.get(i + 1).map_or(1 << 63, |w| w << 63);
                let left = word << 1 | before;
                let right = word >> 1 | after | if i == last { end } else { 0 };
                let mut rest = word & !(of(above) & of(below) & left & right) & of(allowed);
                while rest != 0 {
                    let x = 64 * i + rest.trailing_zeros() as usize;
                    sum += u64::from(distances.get(x).copied().unwrap_or(0));
                    count += 1;
                    rest &= rest - 1;
                }
            }
        }
        if count == 0 {
            return f64::from(drawn.width() + drawn.height());
        }
        sum as f64 / (count as f64 * self.map.per_pixel())
    }
}

impl Functional for ContourDistance {
    fn look_at(&mut self, window: &Window) {
        // Two pixels: the cut of image and model need not fall on the same row.
        self.allowed = window.hand_side().map(|side| erode_square(&erode_square(side)));
        let mut contour = outline(window.silhouette());
        if let Some(allowed) = &self.allowed {
            contour.intersect_with(allowed);
        }
        self.map.measure(&contour);
    }

    fn value(&mut self, model: &mut HandModel, state: &ModelState, window: &Window) -> f64 {
        self.overlap.rate(model, state, window);
        self.of(self.overlap.drawn())
    }
}

/// Non-overlap rate and contour distance together.
#[derive(Clone, Debug)]
struct Combined {
    contour: ContourDistance,
    /// What the distance, over the side of a square of the silhouette's area, is multiplied by.
    weight: f64,
}

impl Functional for Combined {
    fn look_at(&mut self, window: &Window) {
        self.contour.look_at(window);
    }

    fn value(&mut self, model: &mut HandModel, state: &ModelState, window: &Window) -> f64 {
        let rate = self.contour.overlap.rate(model, state, window);
        let side = f64::from(window.silhouette().area()).sqrt().max(1.0);
        rate + self.weight * self.contour.of(self.contour.overlap.drawn()) / side
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::{FREE_ANGLES, Morphology, Side};
    use handcast_track::Forearm;

    fn state(x: f64) -> ModelState {
        ModelState { free: [0.1; FREE_ANGLES], ..ModelState::facing([x, 200.0], 900.0) }
    }

    /// Eq. 8 by its words: contour pixels by their neighbours, distances by trying all contour pixels.
    fn slow(drawn: &Mask, image: &Mask) -> f64 {
        let contour = |m: &Mask| -> Vec<(u32, u32)> {
            let beside =
                |x: u32, y: u32| [(x.wrapping_sub(1), y), (x + 1, y), (x, y.wrapping_sub(1)), (x, y + 1)];
            let inside = |x: u32, y: u32| x < m.width() && y < m.height();
            m.pixels()
                .filter(|&(x, y)| beside(x, y).iter().any(|&(u, v)| inside(u, v) && !m.get(u, v)))
                .collect()
        };
        let (of_model, of_image) = (contour(drawn), contour(image));
        let distance = |(x, y): (u32, u32), (u, v): (u32, u32)| {
            let (dx, dy) = (x.abs_diff(u), y.abs_diff(v));
            f64::from(4 * dx.min(dy) + 3 * dx.abs_diff(dy)) / 3.0
        };
        let nearest = |m: (u32, u32)| of_image.iter().map(|&i| distance(m, i)).fold(f64::INFINITY, f64::min);
        of_model.iter().map(|&m| nearest(m)).sum::<f64>() / of_model.len() as f64
    }

    #[test]
    fn contour_distance_is_equation_8() {
        let mut model = HandModel::new(&Morphology::default(), Side::Right);
        let draw = |model: &mut HandModel, x| {
            let mut mask = Mask::new(320, 240);
            model.draw(&state(x), [0.0, 0.0], &mut mask);
            mask
        };
        let image = draw(&mut model, 150.0);
        // At 318 the model leaves the image: there it has no contour.
        let window = Window::new(&image, None, handcast_vision::PixelRect { x0: 0, y0: 0, x1: 320, y1: 240 });
        let mut functional = ContourDistance::new(Chamfer::ThreeFour);
        functional.look_at(&window);
        for x in [150.0, 157.0, 120.0, 250.0] {
            let found = functional.value(&mut model, &state(x), &window);
            let drawn = draw(&mut model, x);
            assert!((found - slow(&drawn, &image)).abs() < 1e-9, "{x}: {found}");
        }
        assert_eq!(functional.value(&mut model, &state(150.0), &window), 0.0);
        assert_eq!(functional.value(&mut model, &state(2000.0), &window), 560.0, "nothing to be seen");
    }

    #[test]
    fn the_cut_of_the_forearm_is_no_contour() {
        let mut model = HandModel::new(&Morphology::default(), Side::Right);
        let mut arm = Mask::new(320, 260);
        model.draw(&state(150.0), [0.0, 0.0], &mut arm);
        let cut_at = |y: f64| Forearm { cut: [150.0, y], axis: [0.0, -1.0] };
        model.draw_forearm(&cut_at(260.0), [0.0, 0.0], &mut arm);
        let hand = Mask::from_fn(320, 260, |x, y| y < 215 && arm.get(x, y));
        let window = Window::around(&hand, Some(cut_at(215.0)), 0.3).unwrap();
        for (name, kind) in FunctionalKind::ALL {
            let mut functional = kind.make(Chamfer::FiveSevenEleven, &FunctionalTuning::default());
            functional.look_at(&window);
            assert_eq!(functional.value(&mut model, &state(150.0), &window), 0.0, "{name}");
            let (near, far) = (
                functional.value(&mut model, &state(153.0), &window),
                functional.value(&mut model, &state(165.0), &window),
            );
            assert!(0.0 < near && near < far, "{name}: {near} {far}");
        }
    }
}
