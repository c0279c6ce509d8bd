//! Why poses and streams could not become each other.

use handcast_fba::{EncodeError, ErrorKind, SyntaxError};
use handcast_hand::Side;
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
    #[error("encode: frame rate {rate} per second, allowed 1/16 to 255 15/16")]
    Rate {
        /// Frames per second.
        rate: f64,
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
            Self::Rate { .. } | Self::Hand { .. } => ErrorKind::Request,
            Self::Encode(error) => error.kind(),
        }
    }
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
