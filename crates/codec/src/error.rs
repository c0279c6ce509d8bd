//! Why poses and streams could not become each other.

use handcast_fba::{EncodeError, ErrorKind, SyntaxError};
use handcast_hand::{HandPose, MAX_FRAMES, Side, TimedPose};
use thiserror::Error;

/// Why poses could not be encoded.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PosesToStreamError {
    /// There is no pose to encode.
    #[error("encode: no valid pose among {frames} frames")]
    Empty {
        /// Frames given.
        frames: usize,
    },
    /// The frame rate cannot be written in a stream.
    #[error("encode: frame rate {rate} per second, allowed {}", if *rate > 1.0 { "at most 255 15/16" } else { "at least 1/128" })]
    Rate {
        /// Frames per second.
        rate: f64,
    },
    /// The poses are spread over more instants than a stream is made of.
    #[error("encode: {seconds:.0} s at {rate} per second are {} instants, allowed at most {MAX_FRAMES}", (seconds * rate).floor())]
    Span {
        /// From the first pose to the last.
        seconds: f64,
        /// Frames per second.
        rate: f64,
    },
    /// A pose has a number that is none.
    #[error("encode: pose {index}: {what} is {value}, allowed are finite numbers")]
    NotFinite {
        /// Its number, from 0, among those given.
        index: usize,
        /// What of it.
        what: &'static str,
        /// What it is.
        value: f64,
    },
    /// A time is no number, or goes back.
    #[error("encode: the time of {what} {index} is {time} s, allowed are {}", allowed_times(*before))]
    Time {
        /// What comes at that time.
        what: &'static str,
        /// Its number, from 0, among those given.
        index: usize,
        /// Seconds.
        time: f64,
        /// Seconds of the one before it.
        before: Option<f64>,
    },
    /// A pose is of a hand that the stream is not made for.
    #[error("encode: a pose of the {} hand, which is none of the stream's hands", side.name())]
    Hand {
        /// Which hand.
        side: Side,
    },
    /// The encoder refused.
    #[error(transparent)]
    Encode(#[from] EncodeError),
}

impl PosesToStreamError {
    /// What a caller can do about it.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Empty { .. } => ErrorKind::Incomplete,
            Self::Rate { .. }
            | Self::Span { .. }
            | Self::Hand { .. }
            | Self::NotFinite { .. }
            | Self::Time { .. } => ErrorKind::Request,
            Self::Encode(error) => error.kind(),
        }
    }

    /// That the numbers of a pose are finite.
    pub(crate) fn check(index: usize, timed: &TimedPose) -> Result<(), Self> {
        let HandPose { translation, rotation, angles, .. } = &timed.pose;
        let time = std::iter::once(("the time", timed.time));
        let place = translation.iter().map(|v| ("a coordinate of the wrist", *v));
        let turn = rotation.coords.iter().map(|v| ("a part of the rotation", *v));
        // What is lost has no pose.
        let pose = place
            .chain(turn)
            .chain(angles.iter().map(|v| ("a joint angle", *v)))
            .filter(|_| timed.is_shown());
        match time.chain(pose).find(|(_, value)| !value.is_finite()) {
            Some((what, value)) => Err(Self::NotFinite { index, what, value }),
            None => Ok(()),
        }
    }
}

/// The times that may follow one.
fn allowed_times(before: Option<f64>) -> String {
    before.map_or_else(
        || "finite numbers".into(),
        |before| format!("finite numbers from {before} s on, as time does not go back"),
    )
}

/// Whether an error before the first plane may say no more than that the data do not begin where a stream does. `wary`
/// where that is known already, or damage is to be passed over.
pub(crate) fn is_passed_over(error: &SyntaxError, wary: bool) -> bool {
    let damaged = matches!(error.kind(), ErrorKind::Damaged | ErrorKind::Incomplete);
    damaged && (wary || matches!(error, SyntaxError::NoObject { .. }))
}

/// Why a stream could not be decoded to poses.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum StreamToPosesError {
    /// The stream is damaged or uses what is not supported.
    #[error(transparent)]
    Syntax(#[from] SyntaxError),
    /// The stream holds no plane at all.
    #[error("decode: the stream holds no object plane")]
    NoPlane,
    /// The stream moves no hand.
    #[error("decode: none of the {planes} planes has a joint angle of a hand")]
    NoHand {
        /// Planes decoded.
        planes: usize,
    },
    /// A few bits can say that ticks without number were skipped.
    #[error("decode: the stream goes on behind {limit} instants, allowed at most {limit}")]
    TooManyPoses {
        /// The limit.
        limit: usize,
    },
}

impl StreamToPosesError {
    /// What a caller can do about it.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Syntax(error) => error.kind(),
            Self::NoPlane => ErrorKind::Incomplete,
            Self::NoHand { .. } => ErrorKind::Unsupported,
            Self::TooManyPoses { .. } => ErrorKind::Limit,
        }
    }
}
