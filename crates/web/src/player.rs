//! The bytes of a stream to rows of poses.

use std::collections::VecDeque;

use handcast_codec::{PoseDecoder, PoseDecoderOptions, StreamToPosesError};
use handcast_fba::DecoderOptions;
use handcast_fba::bap::StepTable;
use handcast_hand::{HandPose, JointAngle, Morphology, Side, Skeleton, TimedPose};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::row::{ROW, write_row};

/// Why bytes gave no poses: the decoder's own reason.
pub type PlayerError = StreamToPosesError;

/// How a stream is decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct PlayerOptions {
    /// Damage is passed over: hands keep their last pose and count as lost up to the next I plane. Otherwise it is an
    /// error.
    pub conceal: bool,
    /// The stream was made with the base steps of visage's encoder.
    pub vendor_steps: bool,
    /// Poses get only the angles that were sent, and the hand model adds none.
    pub sent_only: bool,
}

impl Default for PlayerOptions {
    /// As a live stream wants it: damage passed over.
    fn default() -> Self {
        Self { conceal: true, vendor_steps: false, sent_only: false }
    }
}

impl PlayerOptions {
    /// Sets whether damage is passed over.
    pub fn with_conceal(self, conceal: bool) -> Self {
        Self { conceal, ..self }
    }

    /// Sets whether the stream was made with the vendor's base steps.
    pub fn with_vendor_steps(self, vendor_steps: bool) -> Self {
        Self { vendor_steps, ..self }
    }

    /// Sets whether poses get only the angles that were sent.
    pub fn with_sent_only(self, sent_only: bool) -> Self {
        Self { sent_only, ..self }
    }

    fn decoder(self) -> PoseDecoder {
        let steps = if self.vendor_steps { StepTable::Visage } else { StepTable::default() };
        let planes = DecoderOptions {
            conceal: self.conceal,
            sent_only: self.sent_only,
            steps,
            ..DecoderOptions::default()
        };
        PoseDecoder::new(PoseDecoderOptions::default().with_decoder(planes).with_poses_at_once(MOST_POSES))
    }
}

/// Most poses that wait to be taken: an hour of both hands at 30 frames/s.
const MOST_POSES: usize = 216_000;

/// What is known of a stream besides its poses.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct StreamFacts {
    /// Frames per second in force.
    pub rate: f64,
    /// Values are not to be believed: between damage and the next I plane.
    pub lost: bool,
    /// The end code, or the end of the data, has been reached.
    pub ended: bool,
    /// Planes so far, I planes among them, and their bits.
    pub planes: usize,
    /// I planes among them.
    pub intra_planes: usize,
    /// Bits of all planes.
    pub bits: u64,
    /// How often damage was passed over.
    pub damage: usize,
    /// The tone of the skin, 1 to 10, where the stream has told it.
    pub skin_tone: Option<u8>,
}

/// A hand as the player knows it.
#[derive(Clone, Debug)]
struct Hand {
    sizes: Morphology,
    skeleton: Skeleton,
    /// How often the sizes changed: 0 while they are the mean hand's.
    version: u32,
}

impl Hand {
    fn new(sizes: Morphology, side: Side, version: u32) -> Self {
        Self { skeleton: Skeleton::new(&sizes, side), sizes, version }
    }
}

/// Decodes a stream, whose bytes may begin anywhere and come in any pieces, to rows of numbers ([`ROW`]). Hands have the
/// sizes that the stream's record tells, and the mean hand's until it does.
#[derive(Clone, Debug)]
pub struct StreamPlayer {
    decoder: PoseDecoder,
    hands: [Hand; 2],
    waiting: VecDeque<TimedPose>,
    skin_tone: Option<u8>,
}

impl StreamPlayer {
    /// A player at the start of a stream.
    pub fn new(options: PlayerOptions) -> Self {
        Self {
            decoder: options.decoder(),
            hands: [Side::Left, Side::Right].map(|side| Hand::new(Morphology::default(), side, 0)),
            waiting: VecDeque::new(),
            skin_tone: None,
        }
    }

    /// Takes the next bytes.
    ///
    /// # Errors
    /// As [`PoseDecoder::push`]; poses known before are there to be taken, and the next call goes on at the next I plane.
    pub fn push(&mut self, bytes: &[u8]) -> Result<(), PlayerError> {
        let poses = self.decoder.push(bytes);
        self.learn(poses)
    }

    /// Takes the next bytes, which end with a plane: its poses do not wait for what follows.
    ///
    /// # Errors
    /// As [`Self::push`].
    pub fn push_plane(&mut self, bytes: &[u8]) -> Result<(), PlayerError> {
        let poses = self.decoder.push_whole(bytes);
        self.learn(poses)
    }

    /// Says that bytes were lost here.
    ///
    /// # Errors
    /// As [`PoseDecoder::lose`].
    pub fn lose(&mut self) -> Result<(), PlayerError> {
        let poses = self.decoder.lose();
        self.learn(poses)
    }

    /// Says that no more bytes come.
    ///
    /// # Errors
    /// As [`PoseDecoder::finish`].
    pub fn finish(&mut self) -> Result<(), PlayerError> {
        let poses = self.decoder.finish();
        self.learn(poses)
    }

    fn learn(&mut self, poses: Result<Vec<TimedPose>, PlayerError>) -> Result<(), PlayerError> {
        let header = self.decoder.header();
        self.skin_tone = header.skin_tone.or(self.skin_tone);
        for told in header.hands {
            let hand = &mut self.hands[told.side as usize];
            if let Some(sizes) = told.morphology.filter(|sizes| *sizes != hand.sizes) {
                *hand = Hand::new(sizes, told.side, hand.version + 1);
            }
        }
        self.waiting.extend(poses?);
        Ok(())
    }

    /// Adds the times (seconds) and the rows of the next poses, `most` of them at most, in the order of the stream.
    pub fn take(&mut self, most: usize, times: &mut Vec<f64>, rows: &mut Vec<f32>) {
        let count = most.min(self.waiting.len());
        times.reserve(count);
        rows.reserve(count * ROW);
        for timed in self.waiting.drain(..count) {
            times.push(timed.time);
            write_row(&timed, &self.hands[timed.pose.side as usize].skeleton, rows);
        }
    }

    /// Gives a hand sizes, until the stream tells others.
    pub fn set_sizes(&mut self, side: Side, sizes: Morphology) {
        let hand = &mut self.hands[side as usize];
        *hand = Hand::new(sizes, side, hand.version + 1);
    }

    /// Adds the row of a pose of a hand: `numbers` are 29 joint angles (radians), the wrist's place (metres) and its rotation
    /// (x, y, z, w). Numbers that are missing or not finite count as 0, a rotation of length 0 as none.
    pub fn write_pose(&self, side: Side, numbers: &[f64], rows: &mut Vec<f32>) {
        let number = |at: usize| numbers.get(at).copied().filter(|v| v.is_finite()).unwrap_or(0.0);
        let mut pose = HandPose::neutral(side);
        pose.angles = std::array::from_fn(number);
        let [x, y, z, i, j, k, w] = std::array::from_fn(|at| number(JointAngle::COUNT + at));
        pose.translation = Vector3::new(x, y, z);
        pose.rotation = UnitQuaternion::try_new(Quaternion::new(w, i, j, k), 1e-9).unwrap_or_default();
        write_row(&TimedPose::new(0.0, pose), &self.hands[side as usize].skeleton, rows);
    }

    /// The sizes of a hand, and how often they have changed.
    pub fn sizes(&self, side: Side) -> (&Morphology, u32) {
        let hand = &self.hands[side as usize];
        (&hand.sizes, hand.version)
    }

    /// What is known of the stream.
    pub fn facts(&self) -> StreamFacts {
        let totals = self.decoder.totals();
        StreamFacts {
            rate: self.decoder.rate(),
            lost: self.decoder.is_lost(),
            ended: self.decoder.is_ended(),
            planes: totals.planes,
            intra_planes: totals.intra_planes,
            bits: totals.bits,
            damage: self.decoder.damage().count(),
            skin_tone: self.skin_tone,
        }
    }
}
