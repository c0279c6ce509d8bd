//! What segmentation and the search for parts can be told.

use super::bars::BarTuning;
use super::swept::SweptTuning;
use crate::colour::ColourTuning;
use crate::parts::PartsTuning;
use crate::tuning::tuning;
use crate::wrist::WristTuning;

tuning! {
    /// How to segment pictures into silhouettes of hands, and those into parts.
    pub struct SegmentOptions {
        /// Pictures are scaled down to this longer side first.
        ["pixels", "handcast bench track --scaling (cost grows with the pixels); the side by eye on the three real clips"]
        pub max_side: u32 = 640,
        /// Smallest hand and arm accepted.
        ["1 (share of the picture)", "chosen by eye on the three real clips"]
        pub min_area: f64 = 0.004,
        /// Largest hand and arm accepted: more is no hand before a background.
        ["1 (share of the picture)", "chosen by eye on the three real clips"]
        pub max_area: f64 = 0.85,
        /// A second part of at least this area is another hand where one is expected, and its colours are learnt
        /// with those of the largest if their chromaticity is the same.
        ["1 (share of the largest part)", "chosen by eye on the three real clips"]
        pub comparable_area: f64 = 0.45,
        /// Where several hands may be: smallest part accepted.
        ["1 (share of the largest part)", "chosen by eye on the three real clips"]
        pub min_relative_area: f64 = 0.2,
        /// Where several hands may be: most parts accepted.
        ["parts", "two hands, a face, a background object"]
        pub max_parts: usize = 4,
        /// Colours of skin and background.
        pub colour: ColourTuning,
        /// Learning them.
        pub learning: LearningTuning,
        /// Bars at the edges of pictures.
        pub bars: BarTuning,
        /// Hands that are learnt by their motion.
        pub swept: SweptTuning,
        /// The outline of what is coloured like skin.
        pub outline: OutlineTuning,
        /// Palm and wrist.
        pub wrist: WristTuning,
        /// Fingers and palm of an open hand.
        pub parts: PartsTuning,
    }
}

impl SegmentOptions {
    /// Sets [`SegmentOptions::max_side`].
    pub fn with_max_side(mut self, side: u32) -> Self {
        self.max_side = side;
        self
    }
}

tuning! {
    /// How the colours of skin and background are learnt from pictures of a clip.
    pub struct LearningTuning {
        /// Colours are learnt at the analysis size divided by this.
        ["1", "colours, not outlines, are learnt; by eye on the three real clips"]
        pub reduction: u32 = 2,
        /// Rounds in which silhouettes and histograms are estimated in turns.
        ["rounds", "chosen by eye on the three real clips"]
        pub rounds: usize = 5,
        /// Distance of mean chromaticities up to which two parts may be skin of one person: wood, brick and cream
        /// differ by more.
        ["1 (chroma over luma)", "chosen by eye on the three real clips"]
        pub same_chromaticity: f32 = 0.045,
        /// Skin is sampled this far within the silhouette.
        ["pixels", "chosen by eye on the three real clips"]
        pub skin_margin: u32 = 2,
        /// Background is sampled this far outside the silhouette.
        ["pixels", "chosen by eye on the three real clips"]
        pub background_margin: u32 = 3,
        /// In the first round, after a threshold on hue and saturation, background is sampled this far from the
        /// silhouette.
        ["1 (share of the longer side)", "chosen by eye on the three real clips"]
        pub border_distance: f64 = 0.12,
        /// And this near to the border of the picture.
        ["1 (share of each side)", "chosen by eye on the three real clips"]
        pub border_width: f64 = 0.125,
        /// Fewest pixels of skin, and of background, to learn from.
        ["pixels", "chosen by eye on the three real clips"]
        pub min_pixels: f32 = 50.0,
    }
}

tuning! {
    /// How the outline is moved to where the colour changes from the skin beside it to the background beside it.
    pub struct OutlineTuning {
        /// Half the width of the band round the coarse outline in which pixels are classified again.
        ["pixels", "chosen by eye on the three real clips"]
        pub band: u32 = 4,
        /// How far beyond the band pixels of mixed colour are classified: a finger blurred by its motion.
        ["pixels", "chosen by eye on the three real clips"]
        pub blur_band: u32 = 24,
        /// Smoothed log-likelihood ratio from which a pixel may be skin mixed with background.
        ["nat", "chosen by eye on the three real clips"]
        pub mixed_ratio: f32 = -2.5,
        /// The local colour of skin is that of pixels this far within the coarse outline.
        ["pixels", "chosen by eye on the three real clips"]
        pub skin_margin: u32 = 2,
        /// Side of the cells over which local colours are averaged.
        ["pixels", "chosen by eye on the three real clips"]
        pub cell: usize = 8,
        /// Weight of the mean over larger surroundings in that of a cell.
        ["pixels", "chosen by eye on the three real clips"]
        pub coarser_weight: f32 = 6.0,
        /// Standard deviation of noise and shading in Y, Cb and Cr: shading changes luma more.
        ["levels", "chosen by eye on the three real clips"]
        pub noise: [f32; 3] = [12.0, 3.0, 3.0],
        /// Squared contrast of skin and background, in standard deviations, at which the mixture of their colours
        /// and the log-likelihood ratio weigh the same.
        ["1", "chosen by eye on the three real clips"]
        pub contrast: f32 = 12.0,
        /// Log-likelihood ratio of a pixel all of skin, over that of one half of skin, by the mixture of colours.
        ["2 nat", "chosen by eye on the three real clips"]
        pub mixture_gain: f32 = 6.0,
        /// Largest absolute log-likelihood ratio of either.
        ["nat", "chosen by eye on the three real clips"]
        pub ratio_limit: f32 = 3.0,
        /// Largest hole that is filled whatever its colour: noise rather than a gap between fingers.
        ["pixels", "paper, 5.1 (holes due to noise are filled); the size by eye on the three real clips"]
        pub small_hole: u32 = 60,
        /// Mean log-likelihood ratio above which a larger hole is filled: colours never seen have −2.3.
        ["nat", "chosen by eye on the three real clips"]
        pub hole_ratio: f32 = -3.0,
    }
}
