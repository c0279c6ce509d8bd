//! The tuning constants of what surrounds registration: which part is a hand, from which frame it is tracked.

use handcast_vision::tuning::{Constant, Tuning, tuning};

tuning! {
    /// From silhouettes to hands.
    pub struct ClipTuning {
        /// The first hands of a clip.
        pub start: StartTuning,
        /// Palm or back, of one hand of which that was not told.
        pub contest: ContestTuning,
        /// Parts followed from frame to frame.
        pub trails: TrailTuning,
        /// Which part a hand is looked for in.
        pub hands: HandsTuning,
        /// Hands that a finder sees.
        pub sighted: SightedTuning,
        /// Noise that is taken off pictures.
        pub noise: NoiseTuning,
    }
}

tuning! {
    /// Noise that is taken off pictures.
    pub struct NoiseTuning {
        /// Standard deviation from which a picture has much noise.
        ["levels", "26 rendered clips, three real ones and photographs have 0 to 1.7; a clip of which the networks still see two thirds 16"]
        pub much: f64 = 5.0,
        /// Standard deviation that is left of it.
        ["levels", "chosen: what pictures of good cameras have"]
        pub left: f64 = 3.0,
        /// Widest blur: it rounds off fingers.
        ["pixels", "chosen by eye on pictures of 640 x 360 pixels: the deviation of a Gaussian"]
        pub widest: f64 = 2.0,
        /// Rows and columns that are looked at.
        ["1 / longer side", "chosen for speed: some thousand pixels"]
        pub looks: u32 = 80,
    }
}

tuning! {
    /// The first hands of a clip.
    pub struct StartTuning {
        /// Pictures from which the colours are learnt, of those that wait.
        ["pictures", "chosen by eye on the three real clips"]
        pub learnt: usize = 16,
        /// Pictures of late from which they are learnt anew while no hand is found, as far apart as those.
        ["pictures", "chosen: twice as many, so that most show what was before a hand came"]
        pub remembered: usize = 32,
        /// Frames from the first open one on in which the hand is fitted: it may still be opening.
        ["frames", "handcast bench track CLIP --view back --no-methods --counts fixtures/counting.counts"]
        pub candidates: usize = 12,
        /// Candidates that are fitted where no finder sees joints, the widest first, until the model fits so many.
        ["frames", "handcast run on the real clips: the same frame is chosen as of all"]
        pub fitted: usize = 4,
        /// How many times as far as before the long fingers must reach for a hand to be fitted as well, while it is found out which
        /// it is.
        ["1", "rendered hands by another mesh: half open at first, one opens later"]
        pub farther: f64 = 1.03,
        /// Difference of overlap within which fits are as good.
        ["1", "handcast bench track CLIP --view back --no-methods --counts fixtures/counting.counts"]
        pub alike: f64 = 0.01,
        /// Overlap a fit must reach.
        ["1", "handcast run on the real clips: fits of hands reach 0.95, of faces and arms 0.7"]
        pub least_fit: f64 = 0.80,
        /// The same where hands are sought again: the more is looked at, the likelier something resembles one.
        ["1", "rendered hands that come in after two seconds: 0.905 and more, a cat's fur 0.82"]
        pub least_fit_again: f64 = 0.9,
        /// Frames that are waited for a second hand that is in the picture and not open yet.
        ["frames", "chosen by eye on the pair made of a clip and its mirror image"]
        pub patience: usize = 60,
        /// Smallest second hand, as a share of the arm of the first.
        ["1", "chosen by eye on the pair made of a clip and its mirror image"]
        pub second: f64 = 0.4,
        /// How many times larger one hand of a person may appear than the other.
        ["1", "chosen by eye: hands at arm's length and half of it"]
        pub unlike: f64 = 1.8,
        /// Frames in which a hand is looked for that is open, before it is taken in any posture.
        ["frames", "chosen: as many as colours are learnt from"]
        pub any_after: usize = 48,
        /// Every so many frames a second hand is looked for.
        ["frames", "chosen for speed"]
        pub look: usize = 3,
    }
}

tuning! {
    /// Palm or back, of one hand of which that was not told.
    pub struct ContestTuning {
        /// Frames from the first open one on that are waited for a decision; with 0 a palm is assumed at once.
        ["frames", "chosen: three seconds of video"]
        pub undecided: usize = 90,
        /// Overlap that both fits must reach: one of a silhouette that shows more than the hand has other sizes.
        ["1", "45 rendered and real clips: before wood fits of 0.87 were decided wrongly, others reach 0.92"]
        pub fitted: f64 = 0.9,
        /// Difference of a joint angle from the open hand from which on a finger is before the palm or behind it, and
        /// the frame counts.
        ["rad", "45 rendered and real clips: by 0.6 hands that tilt count as well, and err; from 0.7 to 1.1 none is wrong"]
        pub bent: f64 = 0.8,
        /// The same from which on every frame is looked at.
        ["rad", "chosen by eye"]
        pub stirs: f64 = 0.4,
        /// Every so many frames are looked at until then.
        ["frames", "chosen for speed"]
        pub every: usize = 3,
        /// Overlap that one of both must have for a frame to count: a silhouette that shows more or less than the
        /// hand tells nothing of its view.
        ["1", "rendered and real clips: from 0.945 on a bending hand hardly counts; without, hands before skin-coloured things are decided wrongly"]
        pub explained: f64 = 0.94,
        /// Difference of a joint angle from all frames that have counted from which on a frame counts in full, less in
        /// proportion: what one posture looks like it says once.
        ["rad", "45 rendered and real clips: right sums grow fastest against wrong ones from 0.2 to 0.5; without, a posture held for half a second decides"]
        pub new_posture: f64 = 0.3,
        /// Difference of costs that counts as log-odds of 1: a picture's errors are not independent.
        ["nat", "rendered and real clips: right views are better by 20 to 50 on average"]
        pub alike: f64 = 10.0,
        /// How much more a palm costs that is one: fingers before it cast shadows, which the model lacks.
        /// In proportion to what of the residuals is not noise.
        ["nat", "70 rendered, real and degraded clips: from 18 to 22 none is wrong; without the proportion backs in the dark are palms"]
        pub shadows: f64 = 20.0,
        /// Largest log-odds that one frame gives.
        ["nat", "chosen by eye"]
        pub most_odds: f64 = 3.0,
        /// Sum from which on it is decided.
        ["nat", "45 rendered and real clips: by 10 one is wrong, from 12 to 15 none; right sums of hands that bend reach 19 and more"]
        pub settled_odds: f64 = 12.0,
        /// Largest share of that sum which other frames may say to the contrary.
        ["1", "the same: wrong ones are contradicted by 0.32 and 0.5, right ones by 0.29 at most where two are left open"]
        pub opposed: f64 = 0.3,
        /// Sum from which on the likelier view is assumed where none is decided.
        ["nat", "70 rendered, real and recompressed clips: right sums for a back that were left open reach 10, wrong ones 6"]
        pub leaning_odds: f64 = 8.0,
    }
}

tuning! {
    /// Parts followed from frame to frame.
    pub struct TrailTuning {
        /// How far a part may move between two frames, radii of its palm.
        ["radii", "chosen by eye on the three real clips"]
        pub gate: f64 = 2.5,
        /// How much more for each frame missed.
        ["radii per frame", "chosen by eye on the three real clips"]
        pub gate_growth: f64 = 0.25,
        /// The most of it.
        ["radii", "chosen by eye on the three real clips"]
        pub widest_gate: f64 = 8.0,
        /// Frames after which a part that is not seen is forgotten.
        ["frames", "chosen: three seconds of video"]
        pub forgotten: usize = 90,
        /// Frames in which a part that is no longer seen may have become one with another.
        ["frames", "handcast synth --two-hands --meet"]
        pub joins_within: usize = 2,
        /// Share of the sum of two areas that the two together have at least when they have just become one.
        ["1", "handcast synth --two-hands --meet"]
        pub together: f64 = 0.85,
        /// The same while they are one and neither hides much of the other.
        ["1", "handcast synth --two-hands --meet"]
        pub overlapping: f64 = 0.7,
        /// Frames for which one may hide most of the other; after that it is taken to have gone.
        ["frames", "chosen: a second of video"]
        pub hidden: usize = 30,
        /// Smallest part that may be one of two that come apart, as a share of its area before.
        ["1", "handcast synth --two-hands --meet"]
        pub come_apart: f64 = 0.4,
        /// How much farther a part counts for each frame in which its trail was missed.
        ["radii per frame", "handcast synth --two-hands --meet"]
        pub absence: f64 = 0.5,
    }
}

tuning! {
    /// Which part a hand is looked for in.
    pub struct HandsTuning {
        /// Frames for which a lost hand is looked for in its own part alone.
        ["frames", "chosen: half a second of video"]
        pub faithful: usize = 15,
        /// Most confidence in what has never been seen open nor by a finder: a face is overlapped as well.
        ["1", "handcast track CLIP --start any on clips of faces: overlap 0.90"]
        pub unproven: f64 = 0.45,
        /// Overlap by which hands must fit better exchanged, after they touched, to be exchanged.
        ["1", "handcast synth --two-hands --meet"]
        pub exchange: f64 = 0.05,
    }
}

tuning! {
    /// Hands that a finder sees.
    pub struct SightedTuning {
        /// Frames for which one that is no longer seen is looked for where it was.
        ["frames", "chosen by eye"]
        pub held: usize = 5,
        /// Every so many frames colours and background are learnt, once there are enough.
        ["frames", "chosen for speed"]
        pub learn_every: usize = 3,
        /// How far the joints of a hand may move between two frames.
        ["hand lengths", "chosen by eye"]
        pub gate: f64 = 0.7,
        /// How much more for each frame missed.
        ["hand lengths per frame", "chosen by eye"]
        pub gate_growth: f64 = 0.1,
        /// The most of it.
        ["hand lengths", "chosen by eye"]
        pub widest_gate: f64 = 2.0,
        /// How much farther a hand counts that looks like one of the other side.
        ["hand lengths", "chosen by eye"]
        pub other_side: f64 = 0.4,
        /// How much farther before the palm than the mean hand's the thumb's base is.
        ["hand lengths", "CMC joints of recordings with headset and markers, and of rendered hands: 8 to 15 % before the plane of wrist and knuckles, the mean hand's is 4 %"]
        pub thumb_palmar: f64 = 0.042,
        /// The thumb's abduction from which another costs, in a hand that was not seen open.
        ["rad", "median of recordings with headset, markers and depth sensor: 6 to 34 degrees"]
        pub thumb_abduction: f64 = 0.26,
        /// Frames after which one that is not seen is forgotten.
        ["frames", "chosen: a second of video"]
        pub forgotten: usize = 30,
        /// Largest log-odds of a side that one frame gives.
        ["nat", "chosen by eye"]
        pub most_odds: f64 = 3.0,
        /// Log-odds of a side by how far the fingertips are before the palm: fingers bend to the palm's side.
        ["nat per hand length", "handedness of rendered hands before four backgrounds: all 24 clips right"]
        pub curl_odds: f64 = 30.0,
        /// Largest of these in a frame: of straight fingers a finder's depths tell little.
        ["nat", "29 rendered and real clips and 11 pictures: two right hands seen open from behind, and the first frames of three clips, were taken for left ones from 4 on; sums of clips are the same down to 2.5"]
        pub most_curl_odds: f64 = 2.5,
        /// Largest sum of them.
        ["nat", "chosen: a wrong start is mended within two seconds"]
        pub most_sum: f64 = 60.0,
        /// Sum from which on a hand of the other side is another hand.
        ["nat", "chosen by eye"]
        pub sure_odds: f64 = 6.0,
        /// Sum from which on the side is settled: frames that are alike err alike.
        ["nat", "chosen: ten frames that are sure; a hanging hand was wrong by 17"]
        pub settled_odds: f64 = 30.0,
        /// Frames that are waited for that.
        ["frames", "chosen: three seconds of video"]
        pub undecided: usize = 90,
        /// Fewest frames in which a hand is seen before it is tracked.
        ["frames", "chosen by eye"]
        pub least_seen: usize = 8,
        /// Least mean presence in them.
        ["1", "chosen by eye"]
        pub least_presence: f64 = 0.7,
        /// Cosine of the largest tilt of a palm that counts as open.
        ["1", "chosen by eye"]
        pub open_facing: f64 = 0.85,
        /// Largest bend of a finger that counts as stretched.
        ["rad", "chosen by eye"]
        pub open_bend: f64 = 1.0,
        /// Least distance of a stretched finger's ends in the picture over the sum of its bones.
        ["1", "chosen by eye"]
        pub open_straight: f64 = 0.96,
        /// Palm over middle finger of an open hand that faces the camera.
        ["1", "spread of hands: 0.8 to 1, and what finders err"]
        pub open_palm: [f64; 2] = [0.7, 1.11],
        /// Breadth of the knuckles over the middle finger.
        ["1", "spread of hands: 0.6 to 0.75, and what finders err"]
        pub open_breadth: [f64; 2] = [0.5, 0.82],
        /// Least distance of neighbouring fingertips of an open hand.
        ["hand lengths", "chosen by eye"]
        pub open_apart: f64 = 0.1,
        /// Half the breadth of a finger.
        ["hand lengths", "Greiner 1991"]
        pub finger_radius: f64 = 0.045,
    }
}

impl super::ClipOptions {
    /// Shows every tuning constant of tracking, stage by stage, under the paths by which `spec/tuning.md` lists them.
    pub fn visit(&mut self, visitor: &mut dyn FnMut(Constant<'_>)) {
        self.segment.visit("segment", visitor);
        self.guided.visit("guided", visitor);
        self.fit.visit("fit", visitor);
        self.tracker.registration.tuning.visit("registration", visitor);
        self.tracker.tuning.visit("tracker", visitor);
        self.confidence.visit("confidence", visitor);
        self.tuning.visit("clip", visitor);
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::super::ClipOptions;

    #[test]
    fn every_constant_is_shown_once_with_unit_and_source() {
        let mut paths = BTreeSet::new();
        ClipOptions::default().visit(&mut |c| {
            assert!(!c.meaning.is_empty() && !c.unit.is_empty() && !c.source.is_empty(), "{}", c.path);
            assert!(!c.value.values().is_empty(), "{}", c.path);
            assert!(paths.insert(c.path.clone()), "{} twice", c.path);
        });
        assert!(paths.len() > 150, "{}", paths.len());
    }
}
