//! One error for the front door, sorted by what can be done about it.

use handcast_codec::{PosesToStreamError, StreamToPosesError};
use handcast_fba::ErrorKind;
use handcast_gltf::GltfError;
use handcast_media::FrameError;
use handcast_track::pipeline::ClipError;
use thiserror::Error;

/// Why something could not be tracked, encoded, decoded or written. The text says what, where and what was allowed.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Error {
    /// The input could not be opened or read.
    #[error(transparent)]
    Frames(#[from] FrameError),
    /// A clip could not be tracked.
    #[error(transparent)]
    Track(#[from] ClipError),
    /// Poses could not be encoded.
    #[error(transparent)]
    Encode(#[from] PosesToStreamError),
    /// A stream could not be decoded.
    #[error(transparent)]
    Decode(#[from] StreamToPosesError),
    /// A hand could not be written as glTF.
    #[error(transparent)]
    Gltf(#[from] GltfError),
}

impl Error {
    /// What a caller can do about it.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Frames(error) | Self::Track(ClipError::Frames(error)) => of_frames(error),
            Self::Track(ClipError::Excess(_)) => ErrorKind::Limit,
            Self::Track(error) => match error {
                ClipError::Empty
                | ClipError::Learn { .. }
                | ClipError::NeverOpen { .. }
                | ClipError::NoHand { .. }
                | ClipError::BadFit { .. } => ErrorKind::Incomplete,
                _ => ErrorKind::Request,
            },
            Self::Encode(error) => error.kind(),
            Self::Decode(error) => error.kind(),
            Self::Gltf(GltfError::Size { .. } | GltfError::Excess(_)) => ErrorKind::Limit,
            Self::Gltf(_) => ErrorKind::Request,
        }
    }
}

fn of_frames(error: &FrameError) -> ErrorKind {
    match error {
        FrameError::Empty { .. } | FrameError::Truncated { .. } => ErrorKind::Incomplete,
        FrameError::NotAVideo { .. } | FrameError::Malformed { .. } => ErrorKind::Damaged,
        FrameError::Size { .. } | FrameError::Excess { .. } => ErrorKind::Limit,
        FrameError::UnsupportedCodec { .. } => ErrorKind::Unsupported,
        _ => ErrorKind::Request,
    }
}
