//! What the search for palm and wrist can be told.

use crate::tuning::tuning;

tuning! {
    /// How palm and wrist are found in an arm. Palm radii are those of the largest circle inscribed in the palm.
    pub struct WristTuning {
        /// Palm.
        pub palm: PalmTuning,
        /// Direction of an arm that ends within the picture.
        pub blunt_end: BluntEndTuning,
        /// Direction of the forearm.
        pub forearm: ForearmTuning,
        /// Place of the wrist.
        pub cut: CutTuning,
        /// A cross-section that ends this near to the image border may go on beyond it.
        ["pixels", "chosen by eye on the three real clips"]
        pub border: f64 = 2.0,
        /// A hand that reaches the image border no farther than this from the cut is not clipped.
        ["palm radii", "chosen by eye on the three real clips"]
        pub border_margin: f64 = 0.3,
    }
}

tuning! {
    /// How the palm is told from fingers and forearm: by circles inscribed in the arm.
    pub struct PalmTuning {
        /// Smallest radius of the palm's circle.
        ["radii of the largest circle", "chosen by eye on the three real clips"]
        pub min_radius: f64 = 0.6,
        /// Shortest stretch of the image border that an arm enters by: a finger that touches the border is none.
        ["radii of the largest circle", "chosen by eye on the three real clips"]
        pub min_entry: f64 = 0.8,
        /// A circle that no other outgrows within this distance behind it is the palm's, not the root of a finger.
        ["radii of the circle", "chosen by eye on the three real clips"]
        pub lead: f64 = 1.35,
        /// The same behind closed fingers, which are nearly as wide as the palm; the forearm is thinner than the palm
        /// so near to it.
        ["radii of the circle", "chosen by eye on the stills of closed fingers"]
        pub closed_lead: f64 = 2.6,
        /// How much larger a circle must be to be the palm's behind closed fingers.
        ["1", "chosen by eye on the stills of closed fingers"]
        pub closed_growth: f64 = 1.03,
    }
}

tuning! {
    /// At which end of an arm that ends within the picture the hand is: fingers are thin.
    pub struct BluntEndTuning {
        /// Radius of a disc that does not fit into a finger. A finger has a quarter of the palm's radius, the wrist two
        /// thirds of it; the largest circle may be the forearm's.
        ["radii of the largest circle", "paper, 5.1 (a little wider than a finger)"]
        pub finger_radius: f64 = 0.36,
        /// Smallest area of a finger.
        ["squared radii of the largest circle", "a little finger has 0.36; the disc leaves 0.03 of a square corner, 0.16 of one of 45°"]
        pub min_finger_area: f64 = 0.2,
        /// How far from the centre of the largest circle a fist or a hand with closed fingers reaches: what is longer is
        /// its forearm.
        ["radii of the largest circle", "the tip of a middle finger is 145 mm from the centre of a palm of 84 mm: 3.5"]
        pub hand_reach: f64 = 4.0,
        /// Cosine of the angle between the wrist of the frame before and the fingers from which on that wrist was the other
        /// end of the arm: a thumb alone points to the side.
        ["1", "halfway from the side to the opposite: 120°"]
        pub turned: f64 = -0.5,
    }
}

tuning! {
    /// How the direction of the forearm is found: by a line through the middles of its cross-sections.
    pub struct ForearmTuning {
        /// Rounds of cross-sections, each across the direction found by the one before.
        ["rounds", "chosen by eye on the three real clips"]
        pub rounds: usize = 2,
        /// Distance of the first cross-section from the palm's centre.
        ["palm radii", "chosen by eye on the three real clips"]
        pub from: f64 = 1.3,
        /// Distance below which the last lies.
        ["palm radii", "chosen by eye on the three real clips"]
        pub to: f64 = 3.2,
        /// Distance from one to the next.
        ["palm radii", "chosen by eye on the three real clips"]
        pub step: f64 = 0.1,
        /// Length of a cross-section to either side.
        ["palm radii", "chosen by eye on the three real clips"]
        pub reach: f64 = 2.0,
        /// Fewest cross-sections that make a line.
        ["sections", "chosen by eye on the three real clips"]
        pub min_sections: usize = 6,
        /// Cross-sections up to which the line has no weight against the direction of the palm from where the arm
        /// enters the picture.
        ["sections", "chosen by eye on the three real clips"]
        pub weightless_sections: f64 = 4.0,
        /// Cross-sections beyond those at which the line has all the weight.
        ["sections", "chosen by eye on the three real clips"]
        pub full_weight_sections: f64 = 10.0,
    }
}

tuning! {
    /// How the wrist is found: as the cross-section of least cost behind the palm.
    pub struct CutTuning {
        /// Expected distance of the wrist from the palm's centre. The circle of an open hand touches both sides of a
        /// palm some 84 mm wide, and its centre lies some 45 mm above the wrist crease; in a fist the circle is
        /// larger and lies lower.
        ["palm radii", "a palm of 84 mm, the wrist crease 45 mm below its centre"]
        pub distance: f64 = 1.05,
        /// Distance of the first cross-section from the palm's centre.
        ["palm radii", "chosen by eye on the three real clips"]
        pub from: f64 = 0.7,
        /// Distance of the last.
        ["palm radii", "chosen by eye on the three real clips"]
        pub to: f64 = 1.8,
        /// Distance from one to the next.
        ["palm radii", "chosen by eye on the three real clips"]
        pub step: f64 = 0.02,
        /// Length of a cross-section to either side.
        ["palm radii", "chosen by eye on the three real clips"]
        pub reach: f64 = 2.5,
        /// Width of a wrist, for cross-sections that the image border cuts.
        ["palm radii", "chosen by eye on the three real clips"]
        pub hidden_width: f64 = 1.4,
        /// Cost of the width of a cross-section.
        ["1 / palm radius", "chosen by eye on the three real clips"]
        pub width_cost: f64 = 0.5,
        /// Cost of the squared distance from the expected one.
        ["1 / squared palm radius", "chosen by eye on the three real clips"]
        pub distance_cost: f64 = 0.8,
        /// Cost of the squared distance from the cut of the frame before.
        ["1 / squared palm radius", "chosen by eye on the three real clips"]
        pub prior_cost: f64 = 0.6,
        /// Squared distance from the cut of the frame before beyond which the cost stays the same: a jump.
        ["squared palm radii", "chosen by eye on the three real clips"]
        pub prior_limit: f64 = 0.09,
        /// An arm that ends nearer to the palm's centre than this shows no wrist.
        ["expected distances", "chosen by eye on the three real clips"]
        pub min_forearm: f64 = 0.9,
    }
}
