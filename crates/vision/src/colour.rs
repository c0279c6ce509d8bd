//! What skin and background look like: histograms over luma and chroma, learnt from pictures.

use image::RgbImage;

use super::tuning::tuning;

tuning! {
    /// How colours of skin are told from others.
    pub struct ColourTuning {
        /// Added to luma before chroma is divided by it: noise in the dark has no chromaticity then.
        ["levels", "chosen by eye on the three real clips"]
        pub luma_floor: f32 = 24.0,
        /// Hue of skin: the angle of the chroma vector from −Cb towards Cr. Skin of all complexions keeps to a narrow
        /// range of hues, since its pigments are the same.
        ["degrees", "Jones & Rehg 2002 for the range; its middle by eye on the three real clips"]
        pub skin_hue: f32 = 57.0,
        /// Standard deviation of the hue of skin; the colour of the light alone turns it by some 15 degrees.
        ["degrees", "chosen by eye on the three real clips"]
        pub skin_hue_deviation: f32 = 19.0,
        /// Least saturation of a colour that skin may have in some light.
        ["1 (chroma over luma)", "chosen by eye on the three real clips"]
        pub possible_saturation: f32 = 0.02,
        /// Hues from the first to below the second are those skin may have in some light.
        ["degrees", "chosen by eye on the three real clips"]
        pub possible_hues: [f32; 2] = [25.0, 105.0],
        /// Least luma of a colour that skin may have in some light.
        ["levels", "chosen by eye on the three real clips"]
        pub possible_luma: f32 = 30.0,
        /// Least mean of the skin-like saturations above Otsu's threshold for pictures that show skin.
        ["1 (chroma over luma)", "chosen by eye on the three real clips"]
        pub min_skin_saturation: f32 = 0.06,
        /// Least difference between the means above and below Otsu's threshold for pictures that show skin.
        ["1 (chroma over luma)", "chosen by eye on the three real clips"]
        pub min_separation: f32 = 0.04,
        /// Log-likelihood ratio between the means below and above Otsu's threshold.
        ["nat", "chosen by eye on the three real clips"]
        pub initial_gain: f32 = 6.0,
        /// Largest absolute log-likelihood ratio of a colour by Otsu's threshold.
        ["nat", "chosen by eye on the three real clips"]
        pub initial_limit: f32 = 3.0,
        /// Largest absolute log-likelihood ratio of a colour by the histograms.
        ["nat", "chosen by eye on the three real clips"]
        pub ratio_limit: f32 = 6.0,
        /// Added to the probability of each colour in skin.
        ["1 (a cell)", "chosen by eye on the three real clips"]
        pub unseen_skin: f32 = 2e-8,
        /// The same for colours that skin may have in some light, where skin was found by its hue alone.
        ["1 (a cell)", "chosen by eye on the three real clips"]
        pub unseen_possible_skin: f32 = 4e-6,
        /// Added to the probability of each colour in the background.
        ["1 (a cell)", "chosen by eye on the three real clips"]
        pub unseen_background: f32 = 2e-7,
        /// Binomial smoothing of the histograms along luma.
        ["passes", "chosen by eye on the three real clips"]
        pub luma_smoothing: usize = 1,
        /// Binomial smoothing of the histograms along Cb and Cr.
        ["passes", "chosen by eye on the three real clips"]
        pub chroma_smoothing: usize = 2,
        /// Binomial smoothing of the histograms of chromaticities.
        ["passes", "chosen by eye on the three real clips"]
        pub chromaticity_smoothing: usize = 1,
        /// Share of the histogram over chromaticity, which holds in shades not yet seen, in the probability of a
        /// colour; the rest is that of the histogram over luma and chroma, which tells a pale wall from pale skin.
        ["1", "paper, 5.1 (hue and saturation); the halves by eye on the three real clips"]
        pub chromaticity_weight: f32 = 0.5,
    }
}

/// Cells along luma, and along each chroma axis.
const LUMA_CELLS: usize = 16;
const CHROMA_CELLS: usize = 64;
const CELLS: usize = LUMA_CELLS * CHROMA_CELLS * CHROMA_CELLS;
/// Cells along each axis of the plane of chromaticities.
const CHROMATICITY_CELLS: usize = 64;
/// Cells of the histogram of skin-like saturation, and the saturation at its end.
const SATURATION_CELLS: usize = 128;
const TOP_SATURATION: f32 = 0.5;

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

/// Chroma over luma: hue is its direction, saturation its length. Shading and the level of light hardly change it.
pub(super) fn chromaticity([y, cb, cr]: [f32; 3], tuning: &ColourTuning) -> [f32; 2] {
    [cb, cr].map(|c| (c - 128.0) / (y + tuning.luma_floor))
}

fn chromaticity_cell(ycc: [f32; 3], tuning: &ColourTuning) -> usize {
    let [u, v] = chromaticity(ycc, tuning);
    let index =
        |t: f32| ((t + 0.5) * CHROMATICITY_CELLS as f32).clamp(0.0, CHROMATICITY_CELLS as f32 - 1.0) as usize;
    index(u) * CHROMATICITY_CELLS + index(v)
}

/// How much a colour looks like skin of any complexion under daylight or lamps, before anything is learnt:
/// saturation, weighted by how near the hue is to skin's.
fn skin_saturation(ycc: [f32; 3], tuning: &ColourTuning) -> f32 {
    let [saturation, hue] = polar(chromaticity(ycc, tuning));
    let off = (hue - tuning.skin_hue) / tuning.skin_hue_deviation;
    saturation * (-0.5 * off * off).exp()
}

/// Saturation and hue, degrees from −Cb towards Cr.
fn polar([u, v]: [f32; 2]) -> [f32; 2] {
    [u.hypot(v), v.atan2(-u).to_degrees()]
}

/// Whether skin of some kind in some light has this colour.
fn possible_skin(ycc: [f32; 3], tuning: &ColourTuning) -> bool {
    let [saturation, hue] = polar(chromaticity(ycc, tuning));
    let [from, to] = tuning.possible_hues;
    saturation > tuning.possible_saturation && (from..to).contains(&hue) && ycc[0] > tuning.possible_luma
}

/// Log-likelihood ratios of skin against background for every cell.
#[derive(Clone, Debug)]
pub(super) struct ColourModel {
    ratios: Vec<f32>,
}

impl ColourModel {
    /// The model to begin with: skin-like saturation, thresholded by Otsu's method.
    /// `None` if nothing in the pictures is tinted like skin.
    pub(super) fn initial(samples: &[RgbImage], tuning: &ColourTuning) -> Option<Self> {
        let table: Vec<f32> = (0..CELLS).map(|c| skin_saturation(cell_centre(c), tuning)).collect();
        let mut bins = [0u64; SATURATION_CELLS];
        for sample in samples {
            for pixel in sample.pixels() {
                let value = table[cell(ycc(pixel.0))];
                let bin = (value / TOP_SATURATION * SATURATION_CELLS as f32) as usize;
                bins[bin.min(SATURATION_CELLS - 1)] += 1;
            }
        }
        let (split, low, high) = otsu(&bins)?;
        let scale = |bin: f64| (bin + 0.5) as f32 / SATURATION_CELLS as f32 * TOP_SATURATION;
        let (split, low, high) = (scale(split), scale(low), scale(high));
        if high < tuning.min_skin_saturation || high - low < tuning.min_separation {
            return None;
        }
        let slope = tuning.initial_gain / (high - low);
        let ratios = table.iter().map(|s| limited((s - split) * slope, tuning.initial_limit)).collect();
        Some(Self { ratios })
    }

    /// From colour counts of skin and of background. With `prior`, colours that neither shows are skin
    /// where [`possible_skin`] says so; without, they are background.
    pub(super) fn from_counts(
        skin: &Counts,
        background: &Counts,
        prior: bool,
        tuning: &ColourTuning,
    ) -> Self {
        let (skin, background) = (skin.density(tuning), background.density(tuning));
        let ratios = skin
            .iter()
            .zip(&background)
            .enumerate()
            .map(|(c, (&s, &b))| {
                let possible = prior && possible_skin(cell_centre(c), tuning);
                let unseen = if possible { tuning.unseen_possible_skin } else { tuning.unseen_skin };
                limited(((s + unseen) / (b + tuning.unseen_background)).ln(), tuning.ratio_limit)
            })
            .collect();
        Self { ratios }
    }

    /// Log-likelihood ratio of a cell: positive for skin.
    pub(super) fn ratio(&self, cell: usize) -> f32 {
        self.ratios.get(cell).copied().unwrap_or(0.0)
    }
}

/// `ratio`, at most `limit` either way. Comparisons, not `min`, which asks for NaN: this runs for every pixel.
pub(super) fn limited(ratio: f32, limit: f32) -> f32 {
    let ratio = if ratio < limit { ratio } else { limit };
    if ratio > -limit { ratio } else { -limit }
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

    /// Keeps this share of what was counted.
    pub(super) fn fade(&mut self, kept: f32) {
        self.cells.iter_mut().for_each(|count| *count *= kept);
    }

    pub(super) fn total(&self) -> f32 {
        self.cells.iter().sum()
    }

    /// Probability of every cell: a mixture of the histogram over luma and chroma and the one over chromaticity.
    fn density(&self, tuning: &ColourTuning) -> Vec<f32> {
        let total = self.total().max(1.0);
        let mut fine: Vec<f32> = self.cells.iter().map(|c| c / total).collect();
        let mut chromaticities = vec![0f32; CHROMATICITY_CELLS * CHROMATICITY_CELLS];
        let mut members = vec![0f32; CHROMATICITY_CELLS * CHROMATICITY_CELLS];
        let chromaticity_of: Vec<usize> =
            (0..CELLS).map(|c| chromaticity_cell(cell_centre(c), tuning)).collect();
        for (value, &chromaticity) in fine.iter().zip(&chromaticity_of) {
            chromaticities[chromaticity] += value;
            members[chromaticity] += 1.0;
        }
        blur(&mut fine, CHROMA_CELLS * CHROMA_CELLS, LUMA_CELLS, tuning.luma_smoothing);
        blur(&mut fine, CHROMA_CELLS, CHROMA_CELLS, tuning.chroma_smoothing);
        blur(&mut fine, 1, CHROMA_CELLS, tuning.chroma_smoothing);
        blur(&mut chromaticities, CHROMATICITY_CELLS, CHROMATICITY_CELLS, tuning.chromaticity_smoothing);
        blur(&mut chromaticities, 1, CHROMATICITY_CELLS, tuning.chromaticity_smoothing);
        let weight = tuning.chromaticity_weight;
        fine.iter()
            .zip(&chromaticity_of)
            .map(|(f, &t)| (1.0 - weight) * f + weight * chromaticities[t] / members[t].max(1.0))
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
        let of = |rgb: [u8; 3]| skin_saturation(ycc(rgb).map(f32::from), &ColourTuning::default());
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
        let model = ColourModel::from_counts(&skin, &wall, false, &ColourTuning::default());
        assert!(model.ratio(cell(ycc([190, 140, 110]))) > 2.0);
        // The same skin in the shade.
        assert!(model.ratio(cell(ycc([95, 70, 55]))) > 0.5);
        assert!(model.ratio(cell(ycc([220, 218, 200]))) < -2.0);
        assert!(model.ratio(cell(ycc([10, 200, 10]))) < 0.0);
    }
}
