//! Bars of one colour at the edges of pictures: films of another shape, lines that a camera or an encoder leaves.

use image::{Rgb, RgbImage};

use crate::mask::{Mask, PixelRect};
use crate::tuning::tuning;

tuning! {
    /// What is a bar at the edge of all pictures of a clip: rows or columns of one colour that end at once, all along. An arm
    /// enters the picture where it comes out of a bar.
    pub struct BarTuning {
        /// Largest difference of a channel within a bar: a wall has more, by noise and light.
        ["levels", "compressed video: 2 within black bars"]
        pub same: u8 = 4,
        /// Share of a bar's row that differs by more all the same.
        ["1", "chosen: what rings beside a bright edge"]
        pub stray: f64 = 0.02,
        /// Difference of a channel that is an edge.
        ["levels", "chosen: four times what is none"]
        pub contrast: u8 = 16,
        /// Share of a row behind the bar that differs by so much, at least: the upper edge of an arm before a plain wall is
        /// no edge of a bar.
        ["1", "chosen: all of it but for what is as dark as the bar"]
        pub edge: f64 = 0.8,
        /// Rows over which the edge of a bar may be blurred.
        ["rows", "a block of compressed video"]
        pub blur: u32 = 8,
        /// Widest bar.
        ["1 (share of the picture's side)", "an upright film of 9:16 in a picture of 16:9 has bars of 0.34"]
        pub widest: f64 = 0.4,
        /// Share of the pictures that must show it; none shows another.
        ["1", "chosen: pictures that are dark as a whole show no edge"]
        pub shown: f64 = 0.5,
        /// What lies this near to a bar is mixed with it.
        ["pixels of the analysis", "chroma has half the rows of luma, and is interpolated"]
        pub mixed: u32 = 2,
        /// Share of the bars that may be coloured like skin where they are not as a whole: a hand is never before a bar.
        ["1", "chosen: colours that ring beside an arm"]
        pub crossed: f64 = 0.02,
    }
}

/// Bars of a clip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bars {
    /// Width and height of the pictures.
    size: (u32, u32),
    /// Widths of the bars on the left, at the top, on the right, at the bottom, pixels of the pictures.
    widths: [u32; 4],
}

impl Bars {
    /// Those that all pictures of one size show; `None` if there are none.
    pub(super) fn of(pictures: &[RgbImage], tuning: &BarTuning) -> Option<Self> {
        let size = pictures.first()?.dimensions();
        if pictures.iter().any(|p| p.dimensions() != size) {
            return None;
        }
        let widths = [0, 1, 2, 3].map(|side| {
            let shown: Vec<u32> =
                pictures.iter().filter_map(|p| Edge { picture: p, side }.bar(tuning)).collect();
            let enough = shown.len() as f64 >= tuning.shown * pictures.len() as f64;
            shown.into_iter().min().filter(|_| enough).unwrap_or(0)
        });
        (widths != [0; 4]).then_some(Self { size, widths })
    }

    /// The picture within the bars, in a picture of the clip that was scaled to `target`.
    pub(super) fn within(&self, target: (u32, u32), tuning: &BarTuning) -> PixelRect {
        let scaled = |side: usize, of: u32, to: u32| {
            let width = self.widths.get(side).copied().unwrap_or(0);
            let mixed = if width > 0 { tuning.mixed } else { 0 };
            (f64::from(width) * f64::from(to) / f64::from(of.max(1))).ceil() as u32 + mixed
        };
        let (w, h) = self.size;
        PixelRect {
            x0: scaled(0, w, target.0).min(target.0),
            y0: scaled(1, h, target.1).min(target.1),
            x1: target.0.saturating_sub(scaled(2, w, target.0)),
            y1: target.1.saturating_sub(scaled(3, h, target.1)),
        }
    }

    /// The same in a picture of which `skin` is coloured like skin; `None` where a part of the bars is, which are none then.
    pub(super) fn beside(&self, skin: &Mask, tuning: &BarTuning) -> Option<PixelRect> {
        let (width, height) = (skin.width(), skin.height());
        let frame = self.within((width, height), tuning);
        let inner = frame.x1.saturating_sub(frame.x0) * frame.y1.saturating_sub(frame.y0);
        let bars = f64::from((width * height).saturating_sub(inner));
        let share = f64::from(skin.area().saturating_sub(skin.cropped(frame).area())) / bars.max(1.0);
        (share <= tuning.crossed || share >= 1.0 - tuning.crossed).then_some(frame)
    }
}

/// A picture seen from one of its sides: the left, the top, the right, the bottom.
#[derive(Clone, Copy)]
struct Edge<'a> {
    picture: &'a RgbImage,
    side: u8,
}

impl Edge<'_> {
    /// Number of rows, and their length.
    fn size(&self) -> (u32, u32) {
        let (w, h) = self.picture.dimensions();
        if self.side.is_multiple_of(2) { (w, h) } else { (h, w) }
    }

    /// The pixels of a row.
    fn row(&self, row: u32) -> impl Iterator<Item = [u8; 3]> + '_ {
        let (rows, length) = self.size();
        (0..length).filter_map(move |k| {
            let (x, y) = match self.side {
                0 => (row, k),
                1 => (k, row),
                2 => (rows - 1 - row, k),
                _ => (k, rows - 1 - row),
            };
            self.picture.get_pixel_checked(x, y).map(|&Rgb(levels)| levels)
        })
    }

    /// Share of a row that is not of a colour, by more than so many levels.
    fn other(&self, row: u32, colour: [u8; 3], levels: u8) -> f64 {
        let differs = |p: &[u8; 3]| p.iter().zip(colour).any(|(a, b)| a.abs_diff(b) > levels);
        self.row(row).filter(differs).count() as f64 / f64::from(self.size().1.max(1))
    }

    /// How wide the bar at this edge is, 0 where there is none. `None` where all is of one colour as far as bars go.
    fn bar(&self, tuning: &BarTuning) -> Option<u32> {
        let (rows, length) = self.size();
        if length == 0 || rows == 0 {
            return Some(0);
        }
        let sum = self.row(0).fold([0u64; 3], |sum, p| [0, 1, 2].map(|c| sum[c] + u64::from(p[c])));
        let colour = sum.map(|v| (v / u64::from(length)) as u8);
        let widest = ((tuning.widest * f64::from(rows)) as u32).min(rows);
        let end = (0..widest).find(|&row| self.other(row, colour, tuning.same) > tuning.stray)?;
        let mut behind = end..end.saturating_add(tuning.blur).min(rows);
        let edge = behind.find(|&row| self.other(row, colour, tuning.contrast) >= tuning.edge);
        Some(edge.filter(|_| end > 0).unwrap_or(0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture with noise, 80 x 60, with a bar of a colour at each side so wide.
    fn barred(widths: [u32; 4], colour: [u8; 3]) -> RgbImage {
        RgbImage::from_fn(80, 60, |x, y| {
            let inside = (widths[0]..80 - widths[2]).contains(&x) && (widths[1]..60 - widths[3]).contains(&y);
            let noise = (x * 7 + y * 13 + x * y) % 40;
            Rgb(if inside {
                [90 + noise as u8, 140, 170 - noise as u8]
            } else {
                colour.map(|v| v + (x % 3) as u8)
            })
        })
    }

    #[test]
    fn bars_are_measured_whatever_their_colour_and_side() {
        let tuning = BarTuning::default();
        for colour in [[0; 3], [240; 3], [20, 60, 200]] {
            for widths in [[0, 7, 0, 7], [10, 0, 10, 0], [0, 0, 0, 2], [3, 2, 0, 9]] {
                let bars = Bars::of(&[barred(widths, colour)], &tuning).unwrap();
                assert_eq!(bars.widths, widths, "{colour:?}");
            }
        }
        let bars = Bars { size: (80, 60), widths: [0, 7, 10, 0] };
        assert_eq!(bars.within((40, 30), &tuning), PixelRect { x0: 0, y0: 6, x1: 33, y1: 30 });
    }

    #[test]
    fn plain_walls_and_dark_pictures_are_no_bars() {
        let tuning = BarTuning::default();
        assert_eq!(Bars::of(&[barred([0; 4], [0; 3])], &tuning), None);
        // An arm across a plain wall: its edge does not reach from side to side.
        let wall = RgbImage::from_fn(80, 60, |x, y| {
            Rgb(if y > 12 && x < 60 { [200, 150, 120] } else { [90, 120, 140] })
        });
        assert_eq!(Bars::of(&[wall], &tuning), None);
        // A wall with a little noise above a table.
        let wall = RgbImage::from_fn(80, 60, |x, y| {
            let noise = ((x * 7 + y * 13 + x * y) % 13) as u8;
            Rgb(if y > 12 { [90, 60, 40] } else { [140 + noise, 165, 190 - noise] })
        });
        assert_eq!(Bars::of(&[wall], &tuning), None);
        // What is called a bar is none where a hand is before it; one of skin's colour is a bar.
        let bars = Bars { size: (80, 60), widths: [0, 20, 0, 0] };
        let hand = |top: u32| Mask::from_fn(80, 60, |x, y| (30..50).contains(&x) && y > top);
        assert_eq!(bars.beside(&hand(10), &tuning), None);
        let frame = PixelRect { x0: 0, y0: 22, x1: 80, y1: 60 };
        assert_eq!(bars.beside(&hand(21), &tuning), Some(frame));
        assert_eq!(bars.beside(&Mask::from_fn(80, 60, |x, y| y < 22 || x < 9), &tuning), Some(frame));
        // What one picture alone shows is in the picture; one that is dark as a whole tells nothing.
        let (bar, none) = (barred([0, 7, 0, 7], [0; 3]), barred([0; 4], [0; 3]));
        assert_eq!(Bars::of(&[bar.clone(), none], &tuning), None);
        let dark = RgbImage::new(80, 60);
        assert_eq!(Bars::of(&[dark.clone(), bar.clone()], &tuning).unwrap().widths, [0, 7, 0, 7]);
        assert_eq!(Bars::of(&[dark.clone(), dark, bar], &tuning), None);
        assert_eq!(Bars::of(&[], &tuning), None);
    }
}
