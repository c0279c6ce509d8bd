//! How far the projected model is from the silhouette of the image (paper 6.2).

use super::forearm::Forearm;
use super::model::{HandModel, Standing};
use super::state::ModelState;
use handcast_hand::Finger;
use handcast_vision::{Mask, PixelRect};

/// Component of a cut's axis along the rows below which the cut follows a row.
const ALONG_ROWS: f64 = 1e-9;

/// A part of a silhouette, cut out so that the work per evaluation depends on the size of the hand in
/// the image and not on the size of the image.
#[derive(Clone, Debug, Default)]
pub struct Window {
    /// Image position of the corner, pixels.
    origin: [f64; 2],
    silhouette: Mask,
    /// Pixels of the whole silhouette.
    area: u32,
    forearm: Option<Forearm>,
    /// The pixels on the hand's side of the forearm's cut.
    side: Mask,
}

impl Window {
    /// The part of `silhouette` inside `rect`. The rectangle should hold the whole silhouette and leave
    /// room for the model around it: model pixels outside of it are not counted.
    pub fn new(silhouette: &Mask, forearm: Option<Forearm>, rect: PixelRect) -> Self {
        let mut window = Self::default();
        window.cut(silhouette, forearm, rect);
        window
    }

    /// The bounds of the silhouette, grown by `margin` of their larger side and clipped to the image;
    /// `None` when the silhouette is empty.
    pub fn around(silhouette: &Mask, forearm: Option<Forearm>, margin: f64) -> Option<Self> {
        let mut window = Self::default();
        window.reload(silhouette, forearm, margin).then_some(window)
    }

    /// As [`Window::around`], in the buffers of this window; false, and nothing changed, when the
    /// silhouette is empty.
    pub fn reload(&mut self, silhouette: &Mask, forearm: Option<Forearm>, margin: f64) -> bool {
        let Some(b) = silhouette.bounds() else { return false };
        let grow = (margin * f64::from((b.x1 - b.x0).max(b.y1 - b.y0))).ceil() as u32;
        let rect = PixelRect {
            x0: b.x0.saturating_sub(grow),
            y0: b.y0.saturating_sub(grow),
            x1: b.x1.saturating_add(grow),
            y1: b.y1.saturating_add(grow),
        };
        self.cut(silhouette, forearm, rect);
        true
    }

    fn cut(&mut self, silhouette: &Mask, forearm: Option<Forearm>, rect: PixelRect) {
        let (x0, y0) = (rect.x0.min(silhouette.width()), rect.y0.min(silhouette.height()));
        let (x1, y1) = (rect.x1.clamp(x0, silhouette.width()), rect.y1.clamp(y0, silhouette.height()));
        self.origin = [f64::from(x0), f64::from(y0)];
        self.area = silhouette.area();
        self.silhouette.reset(x1 - x0, y1 - y0);
        for y in y0..y1 {
            for (start, end) in silhouette.runs(y) {
                self.silhouette.fill_span(y - y0, start as i32 - x0 as i32, end as i32 - x0 as i32);
            }
        }
        self.forearm = forearm;
        if let Some(f) = forearm {
            let width = (x1 - x0) as i32;
            self.side.reset(x1 - x0, y1 - y0);
            for y in 0..y1 - y0 {
                // Along a row the distance to the cut grows evenly.
                let at = |x: f64| f.side([x + 0.5 + self.origin[0], f64::from(y) + 0.5 + self.origin[1]]);
                let crossing = -at(0.0) / f.axis[0];
                let (start, end) = match f.axis[0] {
                    a if a > ALONG_ROWS => (crossing.ceil().clamp(0.0, f64::from(width)) as i32, width),
                    a if a < -ALONG_ROWS => (0, (crossing.floor() + 1.0).clamp(0.0, f64::from(width)) as i32),
                    _ if at(0.0) >= 0.0 => (0, width),
                    _ => (0, 0),
                };
                self.side.fill_span(y, start, end);
            }
        }
    }

    /// Image position of the window's corner, pixels.
    pub fn origin(&self) -> [f64; 2] {
        self.origin
    }

    /// Where the forearm was cut off.
    pub fn forearm(&self) -> Option<&Forearm> {
        self.forearm.as_ref()
    }

    /// The silhouette inside the window.
    pub fn silhouette(&self) -> &Mask {
        &self.silhouette
    }

    /// The pixels on the hand's side of the forearm's cut.
    pub fn hand_side(&self) -> Option<&Mask> {
        self.forearm.is_some().then_some(&self.side)
    }
}

/// The non-overlap rate (eq. 7): pixels in exactly one of the two silhouettes over the sum of their
/// areas. 0 when they coincide, 1 when they do not meet.
#[derive(Clone, Debug, Default)]
pub struct NonOverlap {
    drawn: Mask,
    rest: Mask,
    standing: Standing,
    evaluations: usize,
}

impl NonOverlap {
    /// Evaluations so far.
    pub fn evaluations(&self) -> usize {
        self.evaluations
    }

    /// The model as drawn last, in the window it was drawn for.
    pub fn drawn(&self) -> &Mask {
        &self.drawn
    }

    /// The rate for the whole model.
    pub fn rate(&mut self, model: &mut HandModel, state: &ModelState, window: &Window) -> f64 {
        self.drawn.reset(window.silhouette.width(), window.silhouette.height());
        model.draw(state, window.origin, &mut self.drawn);
        self.add_forearm(model, window);
        self.compare(window)
    }

    /// What comes next is a first state for [`NonOverlap::rate_beside`], in any window.
    pub fn begin(&mut self) {
        self.standing.begin();
    }

    /// As [`NonOverlap::rate`], of models and states in one window that differ in few parts of the hand: what has stood
    /// where it stands since [`NonOverlap::begin`] is not drawn again.
    pub fn rate_beside(&mut self, model: &mut HandModel, state: &ModelState, window: &Window) -> f64 {
        self.drawn.reset(window.silhouette.width(), window.silhouette.height());
        model.project(state);
        model.draw_beside(&mut self.standing, window.forearm.as_ref(), window.origin, &mut self.drawn);
        if window.forearm.is_some() {
            self.drawn.intersect_with(&window.side);
        }
        self.compare(window)
    }

    /// Draws everything that the angles of `finger` do not move, for [`NonOverlap::rate_of_finger`].
    pub fn hold_rest(&mut self, model: &mut HandModel, state: &ModelState, finger: Finger, window: &Window) {
        self.rest.reset(window.silhouette.width(), window.silhouette.height());
        model.draw_finger(state, finger, false, window.origin, &mut self.rest);
        if let Some(forearm) = &window.forearm {
            model.draw_forearm(forearm, window.origin, &mut self.rest);
        }
    }

    /// The rate when only the angles of `finger` differ from the state given to
    /// [`NonOverlap::hold_rest`]: equals [`NonOverlap::rate`], at a fraction of the cost.
    pub fn rate_of_finger(
        &mut self,
        model: &mut HandModel,
        state: &ModelState,
        finger: Finger,
        window: &Window,
    ) -> f64 {
        self.drawn.clone_from(&self.rest);
        model.draw_finger(state, finger, true, window.origin, &mut self.drawn);
        if window.forearm.is_some() {
            self.drawn.intersect_with(&window.side);
        }
        self.compare(window)
    }

    /// Intersection over union of the model drawn last with the silhouette.
    pub fn last_iou(&self, window: &Window) -> f64 {
        let both = f64::from(self.drawn.overlap(&window.silhouette));
        let union = f64::from(self.drawn.area()) + f64::from(window.area) - both;
        if union == 0.0 { 0.0 } else { both / union }
    }

    fn add_forearm(&mut self, model: &mut HandModel, window: &Window) {
        if let Some(forearm) = &window.forearm {
            model.draw_forearm(forearm, window.origin, &mut self.drawn);
            self.drawn.intersect_with(&window.side);
        }
    }

    fn compare(&mut self, window: &Window) -> f64 {
        self.evaluations += 1;
        let (area, both) = self.drawn.area_and_overlap(&window.silhouette);
        let (both, sum) = (f64::from(both), f64::from(area) + f64::from(window.area));
        if sum == 0.0 { 1.0 } else { 1.0 - 2.0 * both / sum }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::{FREE_ANGLES, Morphology, Side};

    fn state(x: f64) -> ModelState {
        ModelState { free: [0.1; FREE_ANGLES], ..ModelState::facing([x, 200.0], 900.0) }
    }

    #[test]
    fn rate_counts_pixels_as_equation_7_says() {
        let mut model = HandModel::new(&Morphology::default(), Side::Right);
        let mut image = Mask::new(320, 240);
        model.draw(&state(150.0), [0.0, 0.0], &mut image);
        let mut drawn = Mask::new(320, 240);
        model.draw(&state(163.0), [0.0, 0.0], &mut drawn);
        let only = |a: &Mask, b: &Mask| a.pixels().filter(|&(x, y)| !b.get(x, y)).count() as f64;
        let sum = f64::from(image.area() + drawn.area());
        let expected = only(&image, &drawn) / sum + only(&drawn, &image) / sum;
        let window = Window::around(&image, None, 0.5).unwrap();
        let mut objective = NonOverlap::default();
        let rate = objective.rate(&mut model, &state(163.0), &window);
        assert!((rate - expected).abs() < 1e-12, "{rate} {expected}");
        assert!((objective.last_iou(&window) - drawn.iou(&image)).abs() < 1e-12);
        assert_eq!(objective.rate(&mut model, &state(150.0), &window), 0.0);
        assert_eq!(objective.evaluations(), 2);
    }

    #[test]
    fn the_rate_of_a_finger_equals_the_rate_of_the_whole() {
        let mut model = HandModel::new(&Morphology::default(), Side::Left);
        let mut image = Mask::new(320, 240);
        model.draw(&state(150.0), [0.0, 0.0], &mut image);
        let forearm = Forearm { cut: [150.0, 210.0], axis: [0.0, -1.0] };
        let window = Window::around(&image, Some(forearm), 0.3).unwrap();
        let mut objective = NonOverlap::default();
        for finger in Finger::ALL {
            let mut moved = state(152.0);
            objective.hold_rest(&mut model, &moved, finger, &window);
            for k in 0..Finger::FREE_ANGLES {
                moved.free[finger.free_base() + k] = 0.5 + 0.1 * k as f64;
            }
            let part = objective.rate_of_finger(&mut model, &moved, finger, &window);
            assert_eq!(part, objective.rate(&mut model, &moved, &window), "{}", finger.name());
        }
    }

    /// Sizes, place and angles change one after the other, as in a fit.
    #[test]
    fn the_rate_beside_others_equals_the_rate() {
        let start = Morphology::default();
        let mut model = HandModel::new(&start, Side::Right);
        let mut image = Mask::new(320, 240);
        model.draw(&state(150.0), [0.0, 0.0], &mut image);
        let forearm = Forearm { cut: [150.0, 210.0], axis: [0.0, -1.0] };
        let mut objective = NonOverlap::default();
        for forearm in [None, Some(forearm)] {
            let window = Window::around(&image, forearm, 0.3).unwrap();
            objective.begin();
            for change in 0..40 {
                let (mut sizes, mut state) = (start.clone(), state(150.0));
                let by = 1.0 + 0.02 * f64::from(change % 3);
                match change / 3 {
                    0 => {}
                    1 => sizes.fingers[1].base[0] *= by,
                    2 => sizes.fingers[1].bones[2] *= by,
                    3 => sizes.webs[1] *= by,
                    4 => state.free[Finger::Index.free_abduction()] *= by,
                    5 => sizes.wrist_half_width *= by,
                    6 => sizes.palm_radius *= by,
                    7 => sizes.forearm *= by,
                    8 => state.wrist[0] *= by,
                    _ => state.scale *= by,
                }
                model.set_morphology(&sizes);
                let beside = objective.rate_beside(&mut model, &state, &window);
                assert_eq!(beside, objective.rate(&mut model, &state, &window), "change {change}");
            }
        }
    }

    #[test]
    fn where_the_forearm_is_cut_does_not_matter() {
        let mut model = HandModel::new(&Morphology::default(), Side::Right);
        let mut arm = Mask::new(320, 400);
        model.draw(&state(150.0), [0.0, 0.0], &mut arm);
        let uncut = Forearm { cut: [150.0, 400.0], axis: [0.0, -1.0] };
        model.draw_forearm(&uncut, [0.0, 0.0], &mut arm);
        let mut objective = NonOverlap::default();
        for y in [195, 205, 220, 250] {
            let hand = Mask::from_fn(320, 400, |px, py| py < y && arm.get(px, py));
            let forearm = Forearm { cut: [150.0, f64::from(y)], axis: [0.0, -1.0] };
            let window = Window::around(&hand, Some(forearm), 0.3).unwrap();
            assert_eq!(objective.rate(&mut model, &state(150.0), &window), 0.0, "cut at {y}");
        }
    }
}
