//! Encoder parameter files, .epf (`spec/fba-bitstream.md` section 4): which frames to code, and how.

use std::fmt;

use thiserror::Error;

use super::{BAP_COUNT, BapMask, GROUPS, group_members};

/// Limits of all BAPs in base steps, by BAP index.
pub type BapLimits = [i32; BAP_COUNT];

/// What one plane is to be: the tags from one `FBM` to the next.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct EpfFrame {
    /// Object mask: bit 0 the face, bit 1 the body.
    pub object_mask: u8,
    /// Frame number in the .bap file.
    pub bap_frame: Option<u32>,
    /// Frame number in the .fap file.
    pub fap_frame: Option<u32>,
    /// Whether it is an I plane.
    pub intra: bool,
    /// Frame rate: whole, sixteenths, and 1 for the factor 1000/1001.
    pub rate: Option<[u8; 3]>,
    /// Time code: hours, minutes, marker, seconds.
    pub time_code: Option<[u8; 4]>,
    /// Frames to skip.
    pub skip: Option<u32>,
    /// BAPs to switch on.
    pub mask: Option<EpfMask>,
    /// Quantiser index.
    pub quant: Option<u8>,
    /// New limits in base steps: I max, I min, P max, P min.
    pub limits: [Option<Box<BapLimits>>; 4],
    /// Suggested gender: true is male.
    pub male: Option<bool>,
    /// Whether DCT coding is asked for.
    pub dct: bool,
}

/// A mask as written: which BAPs, and which groups spell it out though they are full or empty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EpfMask {
    /// BAPs switched on.
    pub baps: BapMask,
    /// Bit per group: all on, but given BAP by BAP.
    pub explicit_full: u32,
    /// Bit per group: all off, but given BAP by BAP.
    pub explicit_empty: u32,
}

/// What is wrong with an .epf file.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum EpfError {
    /// A tag outside a frame.
    #[error("epf: tag {tag} before the first fbm")]
    NoFrame {
        /// The tag.
        tag: String,
    },
    /// A tag nobody knows.
    #[error("epf frame {frame}: unknown tag {tag:?}")]
    Tag {
        /// Number of the frame, from 0.
        frame: usize,
        /// The word found.
        tag: String,
    },
    /// An argument that is missing, not a number or out of range.
    #[error("epf frame {frame}: argument {argument} of {tag} is {found}, allowed is {allowed}")]
    Argument {
        /// Number of the frame, from 0.
        frame: usize,
        /// The tag.
        tag: String,
        /// Position of the argument, from 1.
        argument: usize,
        /// The word found, or `missing`.
        found: String,
        /// What is allowed.
        allowed: Range,
    },
    /// More frames than [`MAX_FRAMES`].
    #[error("epf: more than {MAX_FRAMES} frames")]
    TooManyFrames,
    /// There is none.
    #[error("epf: no frame: the first tag must be FBM")]
    Empty,
}

/// An allowed range, for messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Range(i64, i64);

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} to {}", self.0, self.1)
    }
}

/// Most frames a file may hold.
pub const MAX_FRAMES: usize = 1_000_000;
/// Sizes of the ten FAP groups, to pass over their masks.
const FAP_GROUPS: [usize; 10] = [2, 16, 12, 8, 4, 5, 3, 10, 4, 4];
/// FAPs that have limits.
const FAP_LIMITS: usize = 66;
/// Largest magnitude of a limit in base steps.
const MAX_LIMIT: i64 = 1860;

struct Words<'a> {
    words: Box<dyn Iterator<Item = &'a str> + 'a>,
    frame: usize,
    tag: &'a str,
    argument: usize,
}

impl Words<'_> {
    fn number(&mut self, min: i64, max: i64) -> Result<i64, EpfError> {
        self.argument += 1;
        let word = self.words.next();
        let number = word.and_then(|word| word.parse().ok()).filter(|number| (min..=max).contains(number));
        number.ok_or_else(|| EpfError::Argument {
            frame: self.frame,
            tag: self.tag.to_owned(),
            argument: self.argument,
            found: word.unwrap_or("missing").to_owned(),
            allowed: Range(min, max),
        })
    }

    fn bytes<const N: usize>(&mut self, max: [i64; N]) -> Result<[u8; N], EpfError> {
        let mut out = [0; N];
        for (slot, max) in out.iter_mut().zip(max) {
            *slot = self.number(0, max)? as u8;
        }
        Ok(out)
    }
}

/// Reads an .epf file.
///
/// # Errors
/// What is wrong, in which frame and at which tag.
///
/// ```
/// let frames = handcast_fba::bap::epf::read("FBM 2 BFR 0 ISI 1 BQU 1\nFBM 2 BFR 1 ISI 0 # the second")?;
/// assert_eq!(frames.len(), 2);
/// assert_eq!(frames[0].quant, Some(1));
/// # Ok::<(), handcast_fba::bap::epf::EpfError>(())
/// ```
pub fn read(text: &str) -> Result<Vec<EpfFrame>, EpfError> {
    let words = text.lines().flat_map(|line| line.split('#').next().unwrap_or_default().split_whitespace());
    let mut words = Words { words: Box::new(words), frame: 0, tag: "", argument: 0 };
    let mut frames: Vec<EpfFrame> = Vec::new();
    while let Some(tag) = words.words.next() {
        (words.tag, words.argument) = (tag, 0);
        words.frame = frames.len().saturating_sub(usize::from(tag != "FBM"));
        if tag == "FBM" {
            if frames.len() == MAX_FRAMES {
                return Err(EpfError::TooManyFrames);
            }
            frames.push(EpfFrame { object_mask: words.number(0, 3)? as u8, ..EpfFrame::default() });
            continue;
        }
        let Some(frame) = frames.last_mut() else { return Err(EpfError::NoFrame { tag: tag.to_owned() }) };
        match tag {
            "BFR" => frame.bap_frame = Some(words.number(0, u32::MAX.into())? as u32),
            "FFR" => frame.fap_frame = Some(words.number(0, u32::MAX.into())? as u32),
            "ISI" => frame.intra = words.number(0, 1)? == 1,
            "BRR" | "FRR" => frame.rate = Some(words.bytes([255, 15, 1])?),
            "BTC" | "TC" => frame.time_code = Some(words.bytes([31, 63, 1, 63])?),
            "BSK" | "SKN" => frame.skip = Some(words.number(0, u32::MAX.into())? as u32),
            "BMT" => frame.mask = Some(bap_masks(&mut words)?),
            "FMT" => fap_masks(&mut words)?,
            "BQU" => frame.quant = Some(words.number(0, 31)? as u8),
            "FQU" => {
                words.number(0, 31)?;
            }
            "BIX" => frame.limits[0] = Some(limits(&mut words)?),
            "BIN" => frame.limits[1] = Some(limits(&mut words)?),
            "BPX" => frame.limits[2] = Some(limits(&mut words)?),
            "BPN" => frame.limits[3] = Some(limits(&mut words)?),
            "FIX" | "FIN" | "FPX" | "FPN" => {
                for _ in 0..FAP_LIMITS {
                    words.number(-MAX_LIMIT, MAX_LIMIT)?;
                }
            }
            "GDR" => frame.male = Some(words.number(0, 1)? == 1),
            "CDM" => frame.dct = words.number(0, 1)? == 1,
            _ => return Err(EpfError::Tag { frame: words.frame, tag: tag.to_owned() }),
        }
    }
    if frames.is_empty() { Err(EpfError::Empty) } else { Ok(frames) }
}

fn bap_masks(words: &mut Words<'_>) -> Result<EpfMask, EpfError> {
    let mut mask = EpfMask::default();
    for (group, members) in GROUPS.iter().enumerate() {
        match words.number(0, 3)? {
            0 => {}
            1 => {
                let mut on = 0;
                for bap in group_members(group) {
                    let bit = words.number(0, 1)? == 1;
                    mask.baps.set(bap, bit);
                    on += usize::from(bit);
                }
                mask.explicit_full |= u32::from(on == members.len()) << group;
                mask.explicit_empty |= u32::from(on == 0) << group;
            }
            3 => group_members(group).for_each(|bap| mask.baps.insert(bap)),
            other => {
                return Err(EpfError::Argument {
                    frame: words.frame,
                    tag: words.tag.to_owned(),
                    argument: words.argument,
                    found: other.to_string(),
                    allowed: Range(0, 3),
                });
            }
        }
    }
    Ok(mask)
}

fn fap_masks(words: &mut Words<'_>) -> Result<(), EpfError> {
    for size in FAP_GROUPS {
        if matches!(words.number(0, 3)?, 1 | 2) {
            for _ in 0..size {
                words.number(0, 1)?;
            }
        }
    }
    Ok(())
}

fn limits(words: &mut Words<'_>) -> Result<Box<BapLimits>, EpfError> {
    let mut limits = Box::new([0; BAP_COUNT]);
    for limit in limits.iter_mut() {
        *limit = words.number(-MAX_LIMIT, MAX_LIMIT)? as i32;
    }
    Ok(limits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_named() {
        assert_eq!(read("ISI 1").unwrap_err(), EpfError::NoFrame { tag: "ISI".into() });
        assert_eq!(read("FBM 2 XYZ").unwrap_err(), EpfError::Tag { frame: 0, tag: "XYZ".into() });
        let error = read("FBM 2\nFBM 2 BQU 32").unwrap_err();
        assert_eq!(error.to_string(), "epf frame 1: argument 1 of BQU is 32, allowed is 0 to 31");
        assert!(read("FBM 2 BMT 0 0").unwrap_err().to_string().contains("argument 3 of BMT is missing"));
    }
}
