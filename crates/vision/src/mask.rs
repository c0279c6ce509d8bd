//! A binary image packed 64 pixels to a word.

use image::{GrayImage, Luma};

/// A binary image: `width` × `height` pixels, row-major, 64 pixels to a word, the leftmost pixel in
/// the lowest bit. Bits beyond `width` in the last word of a row are always zero, so areas and
/// overlaps are plain population counts.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Mask {
    width: u32,
    height: u32,
    words_per_row: usize,
    words: Vec<u64>,
}

impl Clone for Mask {
    fn clone(&self) -> Self {
        Self { words: self.words.clone(), ..*self }
    }

    /// Keeps the buffer: what a tracker does in each frame allocates nothing.
    fn clone_from(&mut self, source: &Self) {
        (self.width, self.height) = (source.width, source.height);
        self.words_per_row = source.words_per_row;
        self.words.clone_from(&source.words);
    }
}

/// A half-open pixel rectangle: `x0 <= x < x1`, `y0 <= y < y1`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelRect {
    /// Left edge, included.
    pub x0: u32,
    /// Top edge, included.
    pub y0: u32,
    /// Right edge, excluded.
    pub x1: u32,
    /// Bottom edge, excluded.
    pub y1: u32,
}

/// What becomes of pixels of which just half was set ([`Mask::reduce_into`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Halves {
    /// All are set: nothing thin is lost, and shapes become a little larger.
    All,
    /// Every other one is set, as on a chessboard: areas stay what they were.
    EveryOther,
}

impl Mask {
    /// An empty mask of `width` × `height` pixels.
    pub fn new(width: u32, height: u32) -> Self {
        let words_per_row = (width as usize).div_ceil(64);
        Self { width, height, words_per_row, words: vec![0; words_per_row * height as usize] }
    }

    /// A mask whose set pixels are those for which `inside(x, y)` holds.
    pub fn from_fn(width: u32, height: u32, mut inside: impl FnMut(u32, u32) -> bool) -> Self {
        let mut mask = Self::new(width, height);
        for y in 0..height {
            for x in 0..width {
                if inside(x, y) {
                    mask.set(x, y, true);
                }
            }
        }
        mask
    }

    /// The pixels of `image` that are not zero.
    pub fn from_gray(image: &GrayImage) -> Self {
        Self::from_fn(image.width(), image.height(), |x, y| image.get_pixel(x, y).0[0] != 0)
    }

    /// White where set, black elsewhere.
    pub fn to_gray(&self) -> GrayImage {
        GrayImage::from_fn(self.width, self.height, |x, y| Luma([if self.get(x, y) { 255 } else { 0 }]))
    }

    /// Width and height, pixels.
    pub(crate) fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// Width in pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Words in one row.
    pub fn words_per_row(&self) -> usize {
        self.words_per_row
    }

    /// All words, row after row.
    pub fn words(&self) -> &[u64] {
        &self.words
    }

    /// The words of row `y`; empty when `y` is outside.
    pub fn row(&self, y: u32) -> &[u64] {
        let start = y as usize * self.words_per_row;
        self.words.get(start..start + self.words_per_row).unwrap_or(&[])
    }

    /// The words of row `y`, to be written; bits beyond the width must stay zero.
    pub(super) fn row_mut(&mut self, y: u32) -> &mut [u64] {
        let start = y as usize * self.words_per_row;
        self.words.get_mut(start..start + self.words_per_row).unwrap_or(&mut [])
    }

    /// The bits of the last word of a row that lie within the width.
    pub(super) fn last_word_bits(&self) -> u64 {
        match self.width % 64 {
            0 => !0,
            rest => (1 << rest) - 1,
        }
    }

    /// The runs of set pixels of row `y` as half-open spans, left to right.
    pub fn runs(&self, y: u32) -> impl Iterator<Item = (u32, u32)> + '_ {
        let row = self.row(y);
        let width = self.width;
        let mut at = 0u32;
        std::iter::from_fn(move || {
            let start = next_bit(row, at, false, width);
            if start >= width {
                return None;
            }
            let end = next_bit(row, start, true, width);
            at = end;
            Some((start, end))
        })
    }

    /// Makes it an empty mask of `width` × `height` pixels, keeping its memory.
    pub fn reset(&mut self, width: u32, height: u32) {
        (self.width, self.height) = (width, height);
        self.words_per_row = (width as usize).div_ceil(64);
        self.words.clear();
        self.words.resize(self.words_per_row * height as usize, 0);
    }

    /// Writes to `out` the mask at 1/`factor` of its size: pixels of which more than half was set, and of those of
    /// which just half was, all or every other one.
    pub fn reduce_into(&self, factor: u32, halves: Halves, out: &mut Self) {
        let factor = factor.max(1);
        let (width, height) = (self.width.div_ceil(factor), self.height.div_ceil(factor));
        out.reset(width, height);
        let Some(b) = self.bounds() else { return };
        for y in b.y0 / factor..b.y1.div_ceil(factor) {
            for x in b.x0 / factor..b.x1.div_ceil(factor) {
                let rows = (y * factor)..(y + 1) * factor;
                let set: u32 = rows
                    .map(|v| (x * factor..(x + 1) * factor).map(|u| u32::from(self.get(u, v))).sum::<u32>())
                    .sum();
                let just_half = match halves {
                    Halves::All => 1,
                    Halves::EveryOther => (x + y) % 2,
                };
                if 2 * set + just_half > factor * factor {
                    out.set(x, y, true);
                }
            }
        }
    }

    /// Clears every pixel, keeping the size.
    pub fn clear(&mut self) {
        self.words.fill(0);
    }

    /// Whether the pixel is set; pixels outside the image are not.
    pub fn get(&self, x: u32, y: u32) -> bool {
        x < self.width
            && y < self.height
            && self.words[y as usize * self.words_per_row + x as usize / 64] >> (x % 64) & 1 == 1
    }

    /// Sets or clears a pixel; pixels outside the image are ignored.
    pub fn set(&mut self, x: u32, y: u32, on: bool) {
        if x >= self.width || y >= self.height {
            return;
        }
        let word = &mut self.words[y as usize * self.words_per_row + x as usize / 64];
        let bit = 1u64 << (x % 64);
        if on {
            *word |= bit;
        } else {
            *word &= !bit;
        }
    }

    /// Sets the pixels `x0 <= x < x1` of row `y`, clipped to the image.
    #[inline]
    pub fn fill_span(&mut self, y: u32, x0: i32, x1: i32) {
        if y >= self.height {
            return;
        }
        let x0 = x0.max(0) as usize;
        let x1 = x1.min(self.width as i32).max(0) as usize;
        if x0 >= x1 {
            return;
        }
        let row = &mut self.words[y as usize * self.words_per_row..][..self.words_per_row];
        let (first, last) = (x0 / 64, (x1 - 1) / 64);
        let head = !0u64 << (x0 % 64);
        let tail = !0u64 >> (63 - (x1 - 1) % 64);
        if first == last {
            row[first] |= head & tail;
        } else {
            row[first] |= head;
            row[first + 1..last].fill(!0);
            row[last] |= tail;
        }
    }

    /// Number of set pixels.
    pub fn area(&self) -> u32 {
        self.words.iter().map(|w| w.count_ones()).sum()
    }

    /// Whether no pixel is set.
    pub fn is_empty(&self) -> bool {
        self.words.iter().all(|&w| w == 0)
    }

    /// Number of pixels set in both masks; the masks must have one size, extra rows count as empty.
    pub fn overlap(&self, other: &Self) -> u32 {
        debug_assert_eq!((self.width, self.height), (other.width, other.height));
        self.words.iter().zip(&other.words).map(|(a, b)| (a & b).count_ones()).sum()
    }

    /// Number of set pixels, and of those set in `other` too: in one go, passing over empty words.
    pub fn area_and_overlap(&self, other: &Self) -> (u32, u32) {
        debug_assert_eq!((self.width, self.height), (other.width, other.height));
        let (mut area, mut both) = (0, 0);
        for (a, b) in self.words.iter().zip(&other.words) {
            if *a != 0 {
                area += a.count_ones();
                both += (a & b).count_ones();
            }
        }
        (area, both)
    }

    /// Intersection over union, 0 when both are empty.
    pub fn iou(&self, other: &Self) -> f64 {
        let both = f64::from(self.overlap(other));
        let union = f64::from(self.area()) + f64::from(other.area()) - both;
        if union == 0.0 { 0.0 } else { both / union }
    }

    /// Adds the pixels of `other`.
    pub fn union_with(&mut self, other: &Self) {
        debug_assert_eq!((self.width, self.height), (other.width, other.height));
        for (a, b) in self.words.iter_mut().zip(&other.words) {
            *a |= b;
        }
    }

    /// Keeps only the pixels that `other` has too.
    pub fn intersect_with(&mut self, other: &Self) {
        debug_assert_eq!((self.width, self.height), (other.width, other.height));
        for (a, b) in self.words.iter_mut().zip(&other.words) {
            *a &= b;
        }
    }

    /// Removes the pixels of `other`.
    pub fn subtract(&mut self, other: &Self) {
        debug_assert_eq!((self.width, self.height), (other.width, other.height));
        for (a, b) in self.words.iter_mut().zip(&other.words) {
            *a &= !b;
        }
    }

    /// The set pixels as (x, y), row by row.
    pub fn pixels(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        self.words.iter().enumerate().flat_map(move |(i, &word)| {
            let (y, x0) = (i / self.words_per_row, i % self.words_per_row * 64);
            let mut rest = word;
            std::iter::from_fn(move || {
                (rest != 0).then(|| {
                    let bit = rest.trailing_zeros();
                    rest &= rest - 1;
                    (x0 as u32 + bit, y as u32)
                })
            })
        })
    }

    /// The smallest rectangle holding every set pixel, `None` when empty.
    pub fn bounds(&self) -> Option<PixelRect> {
        let mut bounds: Option<PixelRect> = None;
        for y in 0..self.height {
            let row = self.row(y);
            let (Some(first), Some(last)) =
                (row.iter().position(|&w| w != 0), row.iter().rposition(|&w| w != 0))
            else {
                continue;
            };
            let x0 = first as u32 * 64 + row[first].trailing_zeros();
            let x1 = last as u32 * 64 + 64 - row[last].leading_zeros();
            let b = bounds.get_or_insert(PixelRect { x0, y0: y, x1, y1: y + 1 });
            *b = PixelRect { x0: b.x0.min(x0), x1: b.x1.max(x1), y1: y + 1, ..*b };
        }
        bounds
    }

    /// The part within `rect`, as a mask of that size; what lies outside the image is clear.
    pub fn cropped(&self, rect: PixelRect) -> Self {
        let mut out = Self::new(rect.x1.saturating_sub(rect.x0), rect.y1.saturating_sub(rect.y0));
        for y in rect.y0..rect.y1.min(self.height) {
            for (start, end) in self.runs(y) {
                let left = |x: u32| x as i32 - rect.x0 as i32;
                out.fill_span(y - rect.y0, left(start), left(end));
            }
        }
        out
    }

    /// This mask, [`Self::cropped`] at `rect`, back in one of `width` × `height` pixels.
    pub(crate) fn placed(&self, rect: PixelRect, (width, height): (u32, u32)) -> Self {
        let mut out = Self::new(width, height);
        for y in 0..self.height {
            for (start, end) in self.runs(y) {
                out.fill_span(rect.y0 + y, (rect.x0 + start) as i32, (rect.x0 + end) as i32);
            }
        }
        out
    }

    /// Mean position of the set pixels, `[x, y]` in pixels, pixel centres at .5; `None` when empty.
    pub fn centroid(&self) -> Option<[f64; 2]> {
        let (mut n, mut sx, mut sy) = (0u64, 0u64, 0u64);
        for y in 0..self.height {
            for (start, end) in self.runs(y) {
                let (start, end) = (u64::from(start), u64::from(end));
                n += end - start;
                sx += (start + end - 1) * (end - start) / 2;
                sy += u64::from(y) * (end - start);
            }
        }
        (n > 0).then(|| [sx, sy].map(|sum| sum as f64 / n as f64 + 0.5))
    }
}

/// The first position from `from` on whose bit, flipped if `flip`, is set; `width` if there is none.
fn next_bit(row: &[u64], from: u32, flip: bool, width: u32) -> u32 {
    let flipped = if flip { !0u64 } else { 0 };
    let mut index = from as usize / 64;
    let Some(&first) = row.get(index) else { return width };
    let mut word = (first ^ flipped) & (!0u64 << (from % 64));
    while word == 0 {
        index += 1;
        let Some(&next) = row.get(index) else { return width };
        word = next ^ flipped;
    }
    (index as u32 * 64 + word.trailing_zeros()).min(width)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn spans_match_pixel_by_pixel(width in 1u32..200, x0 in -80i32..260, x1 in -80i32..260) {
            let mut mask = Mask::new(width, 2);
            mask.fill_span(1, x0, x1);
            let slow = Mask::from_fn(width, 2, |x, y| y == 1 && (x0..x1).contains(&(x as i32)));
            prop_assert_eq!(mask, slow);
        }

        #[test]
        fn counts_match_pixel_by_pixel(bits in prop::collection::vec(any::<(bool, bool)>(), 7 * 70)) {
            let at = |x: u32, y: u32| bits[(y * 70 + x) as usize];
            let a = Mask::from_fn(70, 7, |x, y| at(x, y).0);
            let b = Mask::from_fn(70, 7, |x, y| at(x, y).1);
            let both = bits.iter().filter(|p| p.0 && p.1).count() as u32;
            let any = bits.iter().filter(|p| p.0 || p.1).count() as u32;
            prop_assert_eq!(a.overlap(&b), both);
            prop_assert_eq!(a.area_and_overlap(&b), (a.area(), both));
            prop_assert!((a.iou(&b) - f64::from(both) / f64::from(any.max(1))).abs() < 1e-12);
            prop_assert_eq!(a.pixels().count() as u32, a.area());
            let from_runs: Vec<_> =
                (0..7).flat_map(|y| a.runs(y).flat_map(move |(s, e)| (s..e).map(move |x| (x, y)))).collect();
            prop_assert_eq!(from_runs, a.pixels().collect::<Vec<_>>());
            let rect = PixelRect { x0: 3, y0: 2, x1: 90, y1: 6 };
            let slow = Mask::from_fn(87, 4, |x, y| a.get(x + 3, y + 2));
            prop_assert_eq!(a.cropped(rect), slow);
            let inside = |x: u32, y: u32| (rect.x0..rect.x1).contains(&x) && (rect.y0..rect.y1).contains(&y);
            let within = Mask::from_fn(a.width(), a.height(), |x, y| inside(x, y) && a.get(x, y));
            prop_assert_eq!(a.cropped(rect).placed(rect, a.size()), within);
            let slow = a.pixels().map(|(x, y)| PixelRect { x0: x, y0: y, x1: x + 1, y1: y + 1 }).reduce(|a, b| {
                let (x0, y0) = (a.x0.min(b.x0), a.y0.min(b.y0));
                PixelRect { x0, y0, x1: a.x1.max(b.x1), y1: a.y1.max(b.y1) }
            });
            prop_assert_eq!(a.bounds(), slow);
            let count = f64::from(a.area());
            let mean = |pick: fn((u32, u32)) -> u32| a.pixels().map(|p| f64::from(pick(p)) + 0.5).sum::<f64>() / count;
            if let Some([x, y]) = a.centroid() {
                prop_assert!((x - mean(|p| p.0)).abs() < 1e-9 && (y - mean(|p| p.1)).abs() < 1e-9);
            }
            prop_assert_eq!(Mask::from_gray(&a.to_gray()), a);
        }
    }

    #[test]
    fn bounds_and_centroid_of_a_box() {
        let mask = Mask::from_fn(100, 50, |x, y| (60..70).contains(&x) && (10..20).contains(&y));
        assert_eq!(mask.bounds(), Some(PixelRect { x0: 60, y0: 10, x1: 70, y1: 20 }));
        assert_eq!(mask.centroid(), Some([65.0, 15.0]));
        assert_eq!(Mask::new(3, 3).bounds(), None);
    }
}
