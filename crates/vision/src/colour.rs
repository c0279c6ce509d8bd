//! What skin and background look like: histograms over luminance and chroma, learnt from pictures.

use image::RgbImage;

/// Cells along luminance, and along each chroma axis.
const LUMA_CELLS: usize = 16;
const CHROMA_CELLS: usize = 64;
const CELLS: usize = LUMA_CELLS * CHROMA_CELLS * CHROMA_CELLS;
/// Cells along each axis of the hue–saturation plane.
const CHROMATICITY_CELLS: usize = 64;
/// Added to luminance before dividing, so that noise in the dark does not look like colour.
const LUMA_FLOOR: f32 = 24.0;
/// Largest log-likelihood ratio one pixel can claim either way.
const RATIO_LIMIT: f32 = 6.0;

/// Luma and chroma of a pixel (full-range BT.601, as in JPEG), 0..=255 each.
pub(super) fn ycc([r, g, b]: [u8; 3]) -> [u8; 3] {
    let (r, g, b) = (i32::from(r), i32::from(g), i32::from(b));
    let y = (19595 * r + 38470 * g + 7471 * b + 32768) >> 16;
    let cb = ((-11059 * r - 21709 * g + 32768 * b + 32768) >> 16) + 128;
    let cr = ((32768 * r - 27439 * g - 5329 * b + 32768) >> 16) + 128;
    [y.clamp(0, 255) as u8, cb.clamp(0, 255) as u8, cr.clamp(0, 255) as u8]
}

/// The cell of a colour; chroma is resolved where natural colours lie, and clamped outside.
pub(super) fn cell([y, cb, cr]: [u8; 3]) -> usize {
    let chroma = |c: u8| (usize::from(c.saturating_sub(64)) / 2).min(CHROMA_CELLS - 1);
    (usize::from(y) / 16 * CHROMA_CELLS + chroma(cb)) * CHROMA_CELLS + chroma(cr)
}

/// Luma and chroma at the middle of a cell.
fn cell_centre(cell: usize) -> [f32; 3] {
    let (cr, rest) = (cell % CHROMA_CELLS, cell / CHROMA_CELLS);
    let (cb, y) = (rest % CHROMA_CELLS, rest / CHROMA_CELLS);
    [y as f32 * 16.0 + 7.5, 64.5 + 2.0 * cb as f32, 64.5 + 2.0 * cr as f32]
}

/// Chroma relative to luminance: hue as its direction, saturation as its length. Shading and the level of
/// light hardly change it.
pub(super) fn chromaticity([y, cb, cr]: [f32; 3]) -> [f32; 2] {
    [cb, cr].map(|c| (c - 128.0) / (y + LUMA_FLOOR))
}

fn chromaticity_cell(ycc: [f32; 3]) -> usize {
    let [u, v] = chromaticity(ycc);
    let index =
        |t: f32| ((t + 0.5) * CHROMATICITY_CELLS as f32).clamp(0.0, CHROMATICITY_CELLS as f32 - 1.0) as usize;
    index(u) * CHROMATICITY_CELLS + index(v)
}

/// How much a colour looks like skin of any complexion under daylight or lamps, before anything is learnt:
/// saturation, weighted by how near the hue is to skin's. Skin of all complexions keeps to a narrow range of
/// hues, since its pigments are the same (Jones & Rehg 2002); light turns it by some 15 degrees.
fn skin_saturation(ycc: [f32; 3]) -> f32 {
    let [u, v] = chromaticity(ycc);
    let hue = v.atan2(-u).to_degrees();
    let off = (hue - 57.0) / 19.0;
    u.hypot(v) * (-0.5 * off * off).exp()
}

/// Whether skin of some kind in some light has this colour.
fn possible_skin(ycc: [f32; 3]) -> bool {
    let [u, v] = chromaticity(ycc);
    let hue = v.atan2(-u).to_degrees();
    u.hypot(v) > 0.02 && (25.0..105.0).contains(&hue) && ycc[0] > 30.0
}

/// Log-likelihood ratios of skin against background for every cell.
#[derive(Clone, Debug)]
pub(super) struct ColourModel {
    ratios: Vec<f32>,
}

impl ColourModel {
    /// The model to begin with: skin-like saturation, thresholded by Otsu's method.
    /// `None` if nothing in the pictures is tinted like skin.
    pub(super) fn initial(samples: &[RgbImage]) -> Option<Self> {
        const BINS: usize = 128;
        const TOP: f32 = 0.5;
        let table: Vec<f32> = (0..CELLS).map(|c| skin_saturation(cell_centre(c))).collect();
        let mut bins = [0u64; BINS];
        for sample in samples {
            for pixel in sample.pixels() {
                let value = table[cell(ycc(pixel.0))];
                bins[((value / TOP * BINS as f32) as usize).min(BINS - 1)] += 1;
            }
        }
        let (split, low, high) = otsu(&bins)?;
        let scale = |bin: f64| (bin + 0.5) as f32 / BINS as f32 * TOP;
        let (split, low, high) = (scale(split), scale(low), scale(high));
        if high < 0.06 || high - low < 0.04 {
            return None;
        }
        let slope = 6.0 / (high - low);
        let ratios = table.iter().map(|s| ((s - split) * slope).clamp(-3.0, 3.0)).collect();
        Some(Self { ratios })
    }

    /// From colour counts of skin and of background. With `prior`, colours that neither shows are skin
    /// where [`possible_skin`] says so; without, they are background.
    pub(super) fn from_counts(skin: &Counts, background: &Counts, prior: bool) -> Self {
        let (skin, background) = (skin.density(), background.density());
        let ratios = skin
            .iter()
            .zip(&background)
            .enumerate()
            .map(|(c, (&s, &b))| {
                let unseen = if prior && possible_skin(cell_centre(c)) { 4e-6 } else { 2e-8 };
                ((s + unseen) / (b + 2e-7)).ln().clamp(-RATIO_LIMIT, RATIO_LIMIT)
            })
            .collect();
        Self { ratios }
    }

    /// Log-likelihood ratio of a cell: positive for skin.
    pub(super) fn ratio(&self, cell: usize) -> f32 {
        self.ratios.get(cell).copied().unwrap_or(0.0)
    }
}

/// How often each cell was seen.
#[derive(Clone, Debug)]
pub(super) struct Counts {
    cells: Vec<f32>,
}

impl Counts {
    pub(super) fn new() -> Self {
        Self { cells: vec![0.0; CELLS] }
    }

    pub(super) fn add(&mut self, cell: usize) {
        if let Some(count) = self.cells.get_mut(cell) {
            *count += 1.0;
        }
    }

    pub(super) fn total(&self) -> f32 {
        self.cells.iter().sum()
    }

    /// Probability of every cell: half the histogram over luminance and chroma, which tells a pale wall from
    /// pale skin, half the one over hue and saturation alone, which holds in shades not yet seen.
    fn density(&self) -> Vec<f32> {
        let total = self.total().max(1.0);
        let mut fine: Vec<f32> = self.cells.iter().map(|c| c / total).collect();
        let mut chromaticities = vec![0f32; CHROMATICITY_CELLS * CHROMATICITY_CELLS];
        let mut members = vec![0f32; CHROMATICITY_CELLS * CHROMATICITY_CELLS];
        let chromaticity_of: Vec<usize> = (0..CELLS).map(|c| chromaticity_cell(cell_centre(c))).collect();
        for (value, &chromaticity) in fine.iter().zip(&chromaticity_of) {
            chromaticities[chromaticity] += value;
            members[chromaticity] += 1.0;
        }
        blur(&mut fine, CHROMA_CELLS * CHROMA_CELLS, LUMA_CELLS, 1);
        blur(&mut fine, CHROMA_CELLS, CHROMA_CELLS, 2);
        blur(&mut fine, 1, CHROMA_CELLS, 2);
        blur(&mut chromaticities, CHROMATICITY_CELLS, CHROMATICITY_CELLS, 1);
        blur(&mut chromaticities, 1, CHROMATICITY_CELLS, 1);
        fine.iter()
            .zip(&chromaticity_of)
            .map(|(f, &t)| 0.5 * f + 0.5 * chromaticities[t] / members[t].max(1.0))
            .collect()
    }
}

/// Binomial smoothing with (1, 2, 1) along the axis of `length` cells that are `stride` apart.
fn blur(values: &mut [f32], stride: usize, length: usize, passes: usize) {
    for _ in 0..passes {
        for block in values.chunks_exact_mut(stride * length) {
            for offset in 0..stride {
                let mut before = block[offset];
                for k in 0..length {
                    let here = block[k * stride + offset];
                    let after = if k + 1 < length { block[(k + 1) * stride + offset] } else { here };
                    block[k * stride + offset] = 0.25 * before + 0.5 * here + 0.25 * after;
                    before = here;
                }
            }
        }
    }
}

/// The split of a histogram with the largest variance between the two sides (Otsu 1979), and their means, in
/// bins; `None` if all is in one bin.
fn otsu(bins: &[u64]) -> Option<(f64, f64, f64)> {
    let total: u64 = bins.iter().sum();
    let sum: f64 = bins.iter().enumerate().map(|(i, &n)| i as f64 * n as f64).sum();
    let (mut below, mut sum_below) = (0u64, 0.0);
    let mut best: Option<(f64, (f64, f64, f64))> = None;
    for (i, &n) in bins.iter().enumerate() {
        below += n;
        sum_below += i as f64 * n as f64;
        if below == 0 || below == total {
            continue;
        }
        let (low, high) = (sum_below / below as f64, (sum - sum_below) / (total - below) as f64);
        let between = below as f64 * (total - below) as f64 * (high - low).powi(2);
        if best.is_none_or(|(most, _)| between > most) {
            best = Some((between, (i as f64 + 0.5, low, high)));
        }
    }
    best.map(|(_, split)| split)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn primaries_have_known_luma_and_chroma() {
        assert_eq!(ycc([255, 255, 255]), [255, 128, 128]);
        assert_eq!(ycc([0, 0, 0]), [0, 128, 128]);
        assert_eq!(ycc([255, 0, 0]), [76, 85, 255]);
        assert_eq!(ycc([0, 0, 255]), [29, 255, 107]);
    }

    #[test]
    fn cells_hold_their_centres() {
        for c in (0..CELLS).step_by(37) {
            assert_eq!(cell(cell_centre(c).map(|v| v as u8)), c);
        }
    }

    #[test]
    fn skin_is_told_from_wall_sky_leaf_and_duck() {
        let of = |rgb: [u8; 3]| skin_saturation(ycc(rgb).map(f32::from));
        let skins = [[224, 172, 140], [198, 134, 100], [110, 66, 46], [60, 36, 26], [150, 100, 80]];
        let others =
            [[230, 225, 210], [120, 160, 220], [60, 140, 50], [240, 200, 20], [128, 128, 128], [15, 12, 14]];
        let weakest = skins.map(of).into_iter().fold(1.0, f32::min);
        let strongest = others.map(of).into_iter().fold(0.0, f32::max);
        assert!(weakest > 2.0 * strongest, "{weakest} {strongest}");
    }

    #[test]
    fn otsu_splits_between_two_heaps() {
        let mut bins = [0u64; 20];
        (bins[2], bins[3], bins[14], bins[15]) = (50, 40, 5, 6);
        let (split, low, high) = otsu(&bins).unwrap();
        assert!(split > 3.0 && split < 14.0 && low < 3.0 && high > 14.0);
        assert!(otsu(&[0, 7, 0]).is_none());
    }

    #[test]
    fn learnt_ratios_have_the_right_sign() {
        let (mut skin, mut wall) = (Counts::new(), Counts::new());
        for i in 0..50u8 {
            skin.add(cell(ycc([180 + i / 2, 130 + i / 2, 100 + i / 2])));
            wall.add(cell(ycc([200 + i, 198 + i, 180 + i])));
        }
        let model = ColourModel::from_counts(&skin, &wall, false);
        assert!(model.ratio(cell(ycc([190, 140, 110]))) > 2.0);
        // The same skin in the shade.
        assert!(model.ratio(cell(ycc([95, 70, 55]))) > 0.5);
        assert!(model.ratio(cell(ycc([220, 218, 200]))) < -2.0);
        assert!(model.ratio(cell(ycc([10, 200, 10]))) < 0.0);
    }
}
