//! What the search for fingers and palm can be told.

use crate::tuning::tuning;

tuning! {
    /// How fingers, palm and wrist of an open hand are found. Palm radii are those of the largest circle inscribed in
    /// the palm.
    pub struct PartsTuning {
        /// Radius of the disc of the top-hat. A finger has a quarter of the palm's radius, two fingers side by side
        /// half of it.
        ["palm radii", "paper, 5.1 (a little wider than a finger)"]
        pub top_hat_radius: f64 = 0.36,
        /// Smallest connected part of the top-hat that is looked at.
        ["squared palm radii", "chosen by eye on real clips and stills"]
        pub min_residue: f64 = 0.08,
        /// What is a finger.
        pub finger: FingerTuning,
        /// How far a palm may reach from its centre; fingers side by side reach farther.
        ["palm radii", "chosen by eye on the stills of closed fingers"]
        pub closed_reach: f64 = 2.0,
        /// Which finger is the thumb.
        pub thumb: ThumbTuning,
        /// Sine of the least angle at which the axes of hand and finger cross.
        ["1", "chosen by eye on real clips and stills"]
        pub min_crossing: f64 = 0.05,
        /// Crossings from the first to below the second distance behind the palm's centre count for the wrist: nearly
        /// parallel axes cross anywhere.
        ["palm radii", "paper, 5.1 for the crossings; their range by eye on real clips and stills"]
        pub crossing_range: [f64; 2] = [-0.5, 4.0],
        /// Length to either side of the cross-section that measures the palm's width.
        ["palm radii", "chosen by eye on real clips and stills"]
        pub width_reach: f64 = 2.0,
        /// Lengths from web to tip of thumb, index, middle, ring and little finger of a flat open hand.
        ["palm radii", "chosen by eye on real clips and stills"]
        pub free_lengths: [f64; 5] = [1.05, 1.45, 1.6, 1.5, 1.1],
    }
}

tuning! {
    /// What shape makes a part of the top-hat a finger: its axis is a line through the middles of its cross-sections.
    pub struct FingerTuning {
        /// Rounds of cross-sections, each across the axis found by the one before.
        ["rounds", "chosen by eye on real clips and stills"]
        pub rounds: usize = 3,
        /// Number of cross-sections.
        ["sections", "chosen by eye on real clips and stills"]
        pub sections: usize = 16,
        /// Where the first begin, from the inner end.
        ["1 (share of the part's length)", "chosen by eye on real clips and stills"]
        pub sections_from: f64 = 0.2,
        /// Length over which they are spread: neither the slanting base nor the round tip shows the axis.
        ["1 (share of the part's length)", "chosen by eye on real clips and stills"]
        pub sections_span: f64 = 0.65,
        /// Length of a cross-section to either side.
        ["palm radii", "chosen by eye on real clips and stills"]
        pub reach: f64 = 1.0,
        /// Width below which a cross-section is that of one finger.
        ["palm radii", "chosen by eye on real clips and stills"]
        pub max_width: f64 = 1.2,
        /// Distance from the axis below which the middle of a cross-section counts.
        ["palm radii", "chosen by eye on real clips and stills"]
        pub max_offset: f64 = 0.5,
        /// Fewest cross-sections that make an axis.
        ["sections", "chosen by eye on real clips and stills"]
        pub min_sections: usize = 6,
        /// The base is where the part ends within this distance of the axis: the middle of the finger, not the deepest
        /// corner of its web.
        ["radii of the finger", "chosen by eye on real clips and stills"]
        pub base_offset: f64 = 0.35,
        /// Least distance of the tip from the palm's centre.
        ["palm radii", "chosen by eye on real clips and stills"]
        pub min_tip: f64 = 1.25,
        /// How much farther than its base the tip is from the palm's centre, at least.
        ["palm radii", "chosen by eye on real clips and stills"]
        pub min_outward: f64 = 0.3,
        /// Least length over width.
        ["1", "chosen by eye on real clips and stills"]
        pub min_elongation: f64 = 1.1,
        /// Smallest and largest radius.
        ["palm radii", "chosen by eye on real clips and stills"]
        pub radii: [f64; 2] = [0.05, 0.45],
        /// Least length.
        ["palm radii", "chosen by eye on real clips and stills"]
        pub min_length: f64 = 0.45,
    }
}

tuning! {
    /// How the thumb is told from the little finger: of the two outer fingers it stands off farther. Its web is wide,
    /// its axis turned away from that of its neighbour, and it leaves the palm lower.
    pub struct ThumbTuning {
        /// How much the angle between the axes of finger and neighbour counts against the distance of their bases.
        ["palm radii / radian", "chosen by eye on real clips and stills"]
        pub turn_weight: f64 = 0.5,
        /// How much the height of the base above the palm's centre, along the middle finger, counts against that
        /// distance.
        ["1", "chosen by eye on real clips and stills"]
        pub height_weight: f64 = 0.7,
        /// How much farther than the little finger the thumb stands off, at least.
        ["palm radii", "chosen by eye on real clips and stills"]
        pub min_margin: f64 = 0.15,
        /// How much farther, at most: what stands off farther is a tatter of the wrist.
        ["palm radii", "chosen: open hands of real clips and stills have 0.3 to 1.4, a tatter had 3.5"]
        pub max_margin: f64 = 2.5,
        /// Half the width of what is left out as thumb where the hand's inertia axis is measured: a spread thumb would
        /// turn the axis of a hand that is nearly as wide as long.
        ["radii of the thumb", "chosen by eye on real clips and stills"]
        pub half_width: f64 = 2.0,
    }
}
