//! What an input may make a program hold or do.
//!
//! Every reader checks its input against a [`Limits`] before it takes memory for it, also for what a frame rate, a time or
//! a count in the input implies without the bytes being there. What is beyond gives an [`Excess`].

use thiserror::Error;

/// A kind of thing that is limited.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Limit {
    /// Bytes of a file.
    Bytes,
    /// Bytes of what does not say how long it is: pipes and devices that are read as a whole.
    PipedBytes,
    /// Instants of a motion, those included that a rate, a gap or a skip makes.
    Instants,
    /// Frames of all BAPs or of joint positions, held at a time where the input itself has fewer than 400 bytes for each.
    Frames,
    /// Seconds of a motion.
    Seconds,
    /// Longer side of a picture, pixels.
    Side,
    /// Pixels of a picture.
    Pixels,
    /// Pictures that a clip's tables list.
    Pictures,
    /// Nodes, joints and tracks of a scene.
    Nodes,
}

impl Limit {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Bytes,
        Self::PipedBytes,
        Self::Instants,
        Self::Frames,
        Self::Seconds,
        Self::Side,
        Self::Pixels,
        Self::Pictures,
        Self::Nodes,
    ];

    /// What is counted, in the plural.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Bytes | Self::PipedBytes => "bytes",
            Self::Instants => "instants",
            Self::Frames => "frames",
            Self::Seconds => "seconds",
            Self::Side => "pixels a side",
            Self::Pixels => "pixels",
            Self::Pictures => "pictures",
            Self::Nodes => "nodes",
        }
    }
}

/// What an input may make a program hold or do; the defaults serve an hour of motion at 30 frames per second and four
/// hours of video.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Limits {
    /// See [`Limit::Bytes`].
    pub bytes: u64,
    /// See [`Limit::PipedBytes`].
    pub piped_bytes: u64,
    /// See [`Limit::Instants`].
    pub instants: u64,
    /// See [`Limit::Frames`].
    pub frames: u64,
    /// See [`Limit::Seconds`].
    pub seconds: f64,
    /// See [`Limit::Side`].
    pub side: u64,
    /// See [`Limit::Pixels`].
    pub pixels: u64,
    /// See [`Limit::Pictures`].
    pub pictures: u64,
    /// See [`Limit::Nodes`].
    pub nodes: u64,
}

/// Bytes of an input that are worth a frame held in memory.
const FRAME_BYTES: u64 = 400;

/// [`Limits::default`] as a constant.
pub const DEFAULT: Limits = Limits {
    bytes: 1 << 30,
    piped_bytes: 1 << 25,
    instants: 110_000,
    frames: 24_000,
    seconds: 86_400.0,
    side: 16_384,
    pixels: 1 << 26,
    pictures: 432_000,
    nodes: 10_000,
};

impl Default for Limits {
    fn default() -> Self {
        DEFAULT
    }
}

/// Something that is more than allowed.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
#[error("{found} {}, allowed at most {allowed}", limit.unit())]
pub struct Excess {
    /// What there is too much of.
    pub limit: Limit,
    /// How much there is, or the least that it is known to be.
    pub found: f64,
    /// How much may be.
    pub allowed: f64,
}

impl Limits {
    /// How much of something may be.
    pub fn allowed(&self, limit: Limit) -> f64 {
        match limit {
            Limit::Bytes => self.bytes as f64,
            Limit::PipedBytes => self.piped_bytes as f64,
            Limit::Instants => self.instants as f64,
            Limit::Frames => self.frames as f64,
            Limit::Seconds => self.seconds,
            Limit::Side => self.side as f64,
            Limit::Pixels => self.pixels as f64,
            Limit::Pictures => self.pictures as f64,
            Limit::Nodes => self.nodes as f64,
        }
    }

    /// Lets `found` pass if it is no more than allowed, and a number.
    ///
    /// # Errors
    /// [`Excess`].
    pub fn check(&self, limit: Limit, found: f64) -> Result<(), Excess> {
        let allowed = self.allowed(limit);
        if found <= allowed { Ok(()) } else { Err(Excess { limit, found, allowed }) }
    }

    /// The same for a count.
    ///
    /// # Errors
    /// [`Excess`].
    pub fn check_count(&self, limit: Limit, found: usize) -> Result<(), Excess> {
        self.check(limit, found as f64)
    }

    /// The instants, at `rate` a second, of a motion of so many `seconds`.
    ///
    /// # Errors
    /// [`Excess`] of instants or seconds.
    pub fn check_span(&self, seconds: f64, rate: f64) -> Result<(), Excess> {
        self.check(Limit::Seconds, seconds)?;
        self.check(Limit::Instants, (seconds * rate).floor())
    }

    /// How many frames an input of so many `bytes` may have: [`Limit::Frames`], or as many as its bytes are worth.
    ///
    /// # Errors
    /// [`Excess`].
    pub fn check_frames(&self, frames: usize, bytes: u64) -> Result<(), Excess> {
        let allowed = self.frames.max(bytes / FRAME_BYTES).min(self.instants);
        if frames as u64 <= allowed {
            return Ok(());
        }
        Err(Excess { limit: Limit::Frames, found: frames as f64, allowed: allowed as f64 })
    }

    /// Sets [`Limits::bytes`], and [`Limits::piped_bytes`] with it.
    #[must_use]
    pub fn with_bytes(self, bytes: u64) -> Self {
        Self { bytes, piped_bytes: bytes, ..self }
    }

    /// Sets [`Limits::instants`], and [`Limits::frames`] with it.
    #[must_use]
    pub fn with_instants(self, instants: u64) -> Self {
        Self { instants, frames: instants, ..self }
    }

    /// Sets [`Limits::seconds`].
    #[must_use]
    pub fn with_seconds(self, seconds: f64) -> Self {
        Self { seconds, ..self }
    }

    /// Sets [`Limits::pixels`].
    #[must_use]
    pub fn with_pixels(self, pixels: u64) -> Self {
        Self { pixels, ..self }
    }

    /// Sets [`Limits::side`].
    #[must_use]
    pub fn with_side(self, side: u64) -> Self {
        Self { side, ..self }
    }

    /// Sets [`Limits::pictures`].
    #[must_use]
    pub fn with_pictures(self, pictures: u64) -> Self {
        Self { pictures, ..self }
    }

    /// Sets [`Limits::nodes`].
    #[must_use]
    pub fn with_nodes(self, nodes: u64) -> Self {
        Self { nodes, ..self }
    }
}

/// Characters of a word of an input that messages show.
const SHOWN: usize = 40;

/// A word of an input as messages show it: in quotation marks, with escapes, cut behind 40 characters.
pub fn quoted(word: &str) -> String {
    format!("{:?}", word.chars().take(SHOWN).collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_words_are_cut_in_messages() {
        assert_eq!(quoted("wrist\n"), r#""wrist\n""#);
        assert_eq!(quoted(&"é".repeat(1000)), format!("\"{}\"", "é".repeat(40)));
    }

    #[test]
    fn what_is_allowed_passes_and_what_is_beyond_is_told() {
        let limits = Limits::default();
        for limit in Limit::ALL {
            let allowed = limits.allowed(limit);
            assert_eq!(limits.check(limit, allowed), Ok(()));
            for found in [allowed + 1.0, f64::INFINITY, f64::NAN] {
                let excess = limits.check(limit, found).unwrap_err();
                assert_eq!((excess.limit, excess.allowed), (limit, allowed));
            }
        }
        let text = limits.check(Limit::Instants, 1e9).unwrap_err().to_string();
        assert_eq!(text, "1000000000 instants, allowed at most 110000");
    }

    #[test]
    fn a_rate_implies_instants() {
        let limits = Limits::default().with_instants(100).with_seconds(20.0);
        assert_eq!(limits.check_span(10.0, 10.0), Ok(()));
        assert_eq!(limits.check_span(10.0, 1e9).unwrap_err().limit, Limit::Instants);
        assert_eq!(limits.check_span(21.0, 1e-3).unwrap_err().limit, Limit::Seconds);
        assert!(limits.check_span(f64::NAN, 1.0).is_err() && limits.check_span(1.0, f64::NAN).is_err());
    }
}
