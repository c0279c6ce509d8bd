//! What a viewer shows of a live stream.

use handcast_hand::{Side, TimedPose};

use crate::decoder::FADE;

/// Fastest that a hand is brought from where it was held to where it is, metres per second.
const RETURN_SPEED: f64 = 4.5;

/// The hands as a viewer shows them at each of its instants: the newest poses while they are to be believed; after
/// damage the last ones, fading, and from these back to the decoded ones without a leap.
///
/// ```
/// use handcast_codec::{PoseDecoder, PoseDecoderOptions, Shown};
/// use handcast_fba::DecoderOptions;
///
/// let options = DecoderOptions { conceal: true, ..DecoderOptions::default() };
/// let mut decoder = PoseDecoder::new(PoseDecoderOptions::default().with_decoder(options));
/// let mut shown = Shown::default();
/// # let packets: [(&[u8], bool); 1] = [(handcast_fba::example_stream(), false)];
/// for (bytes, gap_before) in packets {
///     let lost = if gap_before { decoder.lose()? } else { Vec::new() };
///     let poses = decoder.push(bytes)?;
///     for hand in shown.at(1.0 / 30.0, lost.into_iter().chain(poses), decoder.is_lost()) {
///         println!("{:?}, sure by {:?}", hand.pose.side, hand.confidence);
///     }
/// }
/// # Ok::<(), handcast_codec::StreamToPosesError>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct Shown {
    hands: [Option<Hand>; 2],
}

/// A hand as it is shown, and where it is to go.
#[derive(Clone, Debug)]
struct Hand {
    shown: TimedPose,
    decoded: TimedPose,
    /// Whether it is on its way back from a held pose.
    returning: bool,
}

impl Shown {
    /// The hands at an instant `seconds` after the one before, when `poses` have been decoded since. `lost`: whether the
    /// decoder believes nothing at the moment ([`PoseDecoder::is_lost`](crate::PoseDecoder::is_lost)). A pose that is not
    /// valid is held or on its way back; the confidence in a held one falls from 1 to 0 in [`FADE`] seconds.
    pub fn at(
        &mut self,
        seconds: f64,
        poses: impl IntoIterator<Item = TimedPose>,
        lost: bool,
    ) -> impl Iterator<Item = &TimedPose> {
        for pose in poses.into_iter().filter(|pose| pose.valid) {
            match &mut self.hands[pose.pose.side as usize] {
                Some(hand) => hand.decoded = pose,
                none => *none = Some(Hand { shown: pose.clone(), decoded: pose, returning: false }),
            }
        }
        self.hands.iter_mut().flatten().map(move |hand| hand.step(seconds, lost))
    }

    /// The hand of a side as it was shown last.
    pub fn hand(&self, side: Side) -> Option<&TimedPose> {
        self.hands[side as usize].as_ref().map(|hand| &hand.shown)
    }
}

impl Hand {
    fn step(&mut self, seconds: f64, lost: bool) -> &TimedPose {
        if lost {
            let sure = self.shown.confidence.unwrap_or(1.0) - seconds / FADE;
            self.shown.time += seconds;
            self.shown.confidence = Some(sure.max(0.0));
            self.shown.valid = false;
            self.returning = true;
            return &self.shown;
        }
        let way = (self.decoded.pose.translation - self.shown.pose.translation).norm();
        let reach = RETURN_SPEED * seconds;
        if self.returning && way > reach {
            self.shown.pose = self.shown.pose.interpolated(&self.decoded.pose, reach / way);
            self.shown.time = self.decoded.time;
            return &self.shown;
        }
        self.returning = false;
        self.shown.clone_from(&self.decoded);
        &self.shown
    }
}
