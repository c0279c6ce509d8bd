//! The .bap text format, versions 3.1 and 3.2 (`spec/fba-bitstream.md` section 4).
//!
//! Two lines per frame: a mask line of zeros and ones, one per BAP in ascending order, and a value line
//! with the frame number and one value per BAP switched on.

use std::borrow::{Borrow, Cow};
use std::io;

use thiserror::Error;

use super::{BAP_COUNT, Bap, BapFrame, BapMask, DEFINED_COUNT};

/// A .bap file.
#[derive(Clone, Debug, PartialEq)]
pub struct BapFile {
    /// Version in the header, `3.1` or `3.2` (read leniently; other words are kept).
    pub version: String,
    /// Name in the header: one word.
    pub name: String,
    /// Frames per second.
    pub rate: f64,
    /// The frames with their numbers, which ascend.
    pub frames: Vec<(u32, BapFrame)>,
}

/// What is wrong with a .bap file.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum TextError {
    /// No header line.
    #[error("bap: no header line")]
    NoHeader,
    /// A header without version, name, rate and frame count.
    #[error("bap line {line}: the header needs version, name, rate and number of frames")]
    Header {
        /// Line number, from 1.
        line: usize,
    },
    /// A rate that is not a positive number.
    #[error("bap line {line}: rate is {found:?}, must be a positive number")]
    Rate {
        /// Line number, from 1.
        line: usize,
        /// The word found.
        found: String,
    },
    /// A mask entry that is neither 0 nor 1, or too many of them.
    #[error("bap line {line}: mask entry {entry} is {found:?}, allowed are 0 and 1, at most 296 of them")]
    Mask {
        /// Line number, from 1.
        line: usize,
        /// Position in the mask, from 1.
        entry: usize,
        /// The word found.
        found: String,
    },
    /// A mask line without value line.
    #[error("bap line {line}: mask without a value line behind it")]
    NoValues {
        /// Line number of the mask, from 1.
        line: usize,
    },
    /// A value or frame number that is not a number in the 32-bit range.
    #[error("bap line {line}: {found:?} is not a number between -2147483648 and 2147483647")]
    Number {
        /// Line number, from 1.
        line: usize,
        /// The word found.
        found: String,
    },
    /// More values than the mask has ones.
    #[error("bap line {line}: more values than the {expected} baps of the mask")]
    TooManyValues {
        /// Line number, from 1.
        line: usize,
        /// Number of BAPs switched on.
        expected: usize,
    },
    /// Frame numbers that do not ascend.
    #[error("bap line {line}: frame number {found} does not follow {before}")]
    Order {
        /// Line number, from 1.
        line: usize,
        /// The number found.
        found: u32,
        /// The number before it.
        before: u32,
    },
    /// More frames than [`MAX_FRAMES`].
    #[error("bap: more than {MAX_FRAMES} frames")]
    TooManyFrames,
}

/// Most frames a file may hold: above nine hours at 30 frames/s.
pub const MAX_FRAMES: usize = 1_000_000;

/// Reads a .bap file.
///
/// The length of a mask line counts, not the version; real numbers are rounded; blanks at line ends and
/// blank lines are ignored; values missing at the end of a line are 0, as VREng and the vendor take them.
///
/// # Errors
/// What is wrong, and in which line.
///
/// ```
/// let file = handcast_fba::bap::text::read("3.2 wave 25 1\n0 1 1\n0 -100 200\n")?;
/// let values: Vec<_> = file.frames[0].1.iter().map(|(bap, value)| (bap.number(), value)).collect();
/// assert_eq!(values, [(2, -100), (3, 200)]);
/// # Ok::<(), handcast_fba::bap::text::TextError>(())
/// ```
pub fn read(text: &str) -> Result<BapFile, TextError> {
    let mut reader = Reader::new(text)?;
    let frames = reader.by_ref().collect::<Result<_, _>>()?;
    Ok(BapFile {
        version: reader.version.to_owned(),
        name: reader.name.to_owned(),
        rate: reader.rate,
        frames,
    })
}

/// Reads a .bap file frame by frame, as [`read`] does. Nothing comes after an error.
///
/// ```
/// use handcast_fba::bap::text::Reader;
///
/// let mut reader = Reader::new("3.2 wave 25 2\n0 1\n0 -100\n0 1\n1 wide\n")?;
/// assert_eq!((reader.name(), reader.rate()), ("wave", 25.0));
/// assert!(reader.next().is_some_and(|frame| frame.is_ok_and(|(number, _)| number == 0)));
/// assert_eq!(reader.next().unwrap().unwrap_err().to_string(), "bap line 5: \"wide\" is not a number between -2147483648 and 2147483647");
/// assert!(reader.next().is_none());
/// # Ok::<(), handcast_fba::bap::text::TextError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Reader<'a> {
    version: &'a str,
    name: &'a str,
    rate: f64,
    told: Option<u64>,
    lines: Lines<'a>,
    /// Most frames have the mask of the one before, in the same words.
    known: (&'a str, BapMask),
    /// Number of the frame before.
    before: Option<u32>,
    /// Frames that may still come.
    left: usize,
}

/// The lines that say something, with their numbers from 1.
#[derive(Clone, Debug)]
struct Lines<'a>(std::iter::Enumerate<std::str::Lines<'a>>);

impl<'a> Iterator for Lines<'a> {
    type Item = (usize, &'a str);

    fn next(&mut self) -> Option<Self::Item> {
        let mut told = self.0.by_ref().map(|(index, line)| (index + 1, line.trim()));
        told.find(|(_, line)| !line.is_empty() && !line.starts_with('#'))
    }
}

impl<'a> Reader<'a> {
    /// Reads the header.
    ///
    /// # Errors
    /// [`TextError::NoHeader`], [`TextError::Header`], [`TextError::Rate`].
    pub fn new(text: &'a str) -> Result<Self, TextError> {
        let mut lines = Lines(text.lines().enumerate());
        let (line, header) = lines.next().ok_or(TextError::NoHeader)?;
        let words: Vec<&str> = header.split_whitespace().collect();
        let [version, name, rate, count] = words[..] else { return Err(TextError::Header { line }) };
        let rate = match rate.parse::<f64>() {
            Ok(rate) if rate > 0.0 && rate.is_finite() => rate,
            _ => return Err(TextError::Rate { line, found: rate.to_owned() }),
        };
        let known = ("", BapMask::EMPTY);
        Ok(Self {
            version,
            name,
            rate,
            told: count.parse().ok(),
            lines,
            known,
            before: None,
            left: MAX_FRAMES,
        })
    }

    /// Name in the header.
    pub fn name(&self) -> &'a str {
        self.name
    }

    /// Frames per second.
    pub fn rate(&self) -> f64 {
        self.rate
    }

    /// Number of frames that the header tells, where it is a number; how many follow counts.
    pub fn told(&self) -> Option<u64> {
        self.told
    }

    fn frame(&mut self, mask_line: usize, mask: &'a str) -> Result<(u32, BapFrame), TextError> {
        if self.known.0 != mask {
            self.known = (mask, read_mask(mask, mask_line)?);
        }
        let mask = self.known.1;
        let mut frame = BapFrame::EMPTY;
        // Values that are missing are 0.
        frame.mask = mask;
        let (line, values) = self.lines.next().ok_or(TextError::NoValues { line: mask_line })?;
        let mut words = values.split_whitespace();
        let number = words.next().unwrap_or_default();
        let number: u32 = number.parse().map_err(|_| TextError::Number { line, found: number.to_owned() })?;
        if let Some(before) = self.before.filter(|before| number <= *before) {
            return Err(TextError::Order { line, found: number, before });
        }
        for (bap, word) in mask.iter().zip(words.by_ref()) {
            frame.set(bap, value(word).ok_or_else(|| TextError::Number { line, found: word.to_owned() })?);
        }
        if words.next().is_some() {
            return Err(TextError::TooManyValues { line, expected: mask.len() });
        }
        self.left = self.left.checked_sub(1).ok_or(TextError::TooManyFrames)?;
        self.before = Some(number);
        Ok((number, frame))
    }
}

impl Iterator for Reader<'_> {
    /// Number and values of a frame.
    type Item = Result<(u32, BapFrame), TextError>;

    fn next(&mut self) -> Option<Self::Item> {
        let (line, mask) = self.lines.next()?;
        let frame = self.frame(line, mask);
        if frame.is_err() {
            self.lines = Lines("".lines().enumerate());
        }
        Some(frame)
    }
}

/// As [`read`], of bytes: what is not UTF-8 is a word that is not allowed.
///
/// # Errors
/// Those of [`read`].
pub fn read_bytes(bytes: &[u8]) -> Result<BapFile, TextError> {
    read(&text_of(bytes))
}

/// Bytes as text; what is not UTF-8 is U+FFFD, which no word has.
pub fn text_of(bytes: &[u8]) -> Cow<'_, str> {
    // Checking is much faster than replacing.
    std::str::from_utf8(bytes).map_or_else(|_| String::from_utf8_lossy(bytes), Cow::Borrowed)
}

fn read_mask(words: &str, line: usize) -> Result<BapMask, TextError> {
    let mut mask = BapMask::EMPTY;
    for (index, word) in words.split_whitespace().enumerate() {
        match (Bap::from_index(index), word) {
            (Some(_), "0") => {}
            (Some(bap), "1") => mask.insert(bap),
            _ => return Err(TextError::Mask { line, entry: index + 1, found: word.to_owned() }),
        }
    }
    Ok(mask)
}

/// A value: an integer, or a real number rounded to one.
fn value(word: &str) -> Option<i32> {
    if let Ok(value) = word.parse() {
        return Some(value);
    }
    let value = word.parse::<f64>().ok()?.round();
    (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&value).then_some(value as i32)
}

/// Writes a .bap file: version 3.1 with 186 mask entries, or 3.2 with 296 when an extension BAP is on in
/// any frame. The version in `file` is not used.
///
/// ```
/// use handcast_fba::bap::text;
///
/// let file = text::read("3.2 wave 25 2\n0 1 1\n0 -100 200\n0 1 0\n1 -90\n")?;
/// let again = text::read(&text::write(&file))?;
/// assert_eq!(again.frames, file.frames);
/// # Ok::<(), text::TextError>(())
/// ```
pub fn write(file: &BapFile) -> String {
    let mut out = Vec::new();
    // Writing to memory does not fail, and what is written is ASCII but for the name.
    let _ = write_to(file, &mut out);
    String::from_utf8_lossy(&out).into_owned()
}

/// As [`write()`], into `out`, frame by frame.
///
/// # Errors
/// Those of `out`.
pub fn write_to(file: &BapFile, out: impl io::Write) -> io::Result<()> {
    let frames = file.frames.iter().map(|(number, frame)| (*number, frame));
    write_frames(&file.name, file.rate, frames, out)
}

/// As [`write_to`], of frames that are elsewhere, with their numbers; they are gone through twice.
///
/// # Errors
/// Those of `out`.
pub fn write_frames(
    name: &str,
    rate: f64,
    frames: impl Iterator<Item = (u32, impl Borrow<BapFrame>)> + Clone,
    mut out: impl io::Write,
) -> io::Result<()> {
    let (count, extended) = frames.clone().fold((0, false), |(count, extended), (_, frame)| {
        (count + 1, extended || frame.borrow().mask.iter().any(Bap::is_extension))
    });
    let (version, entries) = if extended { ("3.2", BAP_COUNT) } else { ("3.1", DEFINED_COUNT) };
    let mut name: String = name.split_whitespace().collect::<Vec<_>>().join("_");
    if name.is_empty() {
        name.push_str("unnamed");
    }
    writeln!(out, "{version} {name} {rate} {count}")?;
    let (mut mask_line, mut of) = (String::new(), None);
    let mut values = String::new();
    let mut digits = itoa::Buffer::new();
    for (number, frame) in frames {
        let frame: &BapFrame = frame.borrow();
        if of != Some(frame.mask) {
            of = Some(frame.mask);
            mask_line.clear();
            for bap in Bap::all().take(entries) {
                mask_line.push_str(if bap.index() == 0 { "" } else { " " });
                mask_line.push(if frame.mask.contains(bap) { '1' } else { '0' });
            }
            mask_line.push('\n');
        }
        values.clear();
        values.push_str(digits.format(number));
        for (_, value) in frame.iter() {
            values.push(' ');
            values.push_str(digits.format(value));
        }
        values.push('\n');
        out.write_all(mask_line.as_bytes())?;
        out.write_all(values.as_bytes())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn leniencies() {
        let file = read("# made by hand\n\n3.1 x 15.5 9  \n1 0 1   \n 0 1.6 -0 \n\n1 1\n7 5\n").unwrap();
        assert_eq!(file.rate, 15.5);
        let values = |index: usize| -> Vec<i32> { file.frames[index].1.iter().map(|pair| pair.1).collect() };
        assert_eq!(values(0), [2, 0]);
        assert_eq!(file.frames[1].0, 7);
        assert_eq!(values(1), [5, 0]);
    }

    #[test]
    fn faults_are_named_with_their_line() {
        let error = |text: &str| read(text).unwrap_err();
        assert_eq!(error(""), TextError::NoHeader);
        assert_eq!(error("3.1 x 25"), TextError::Header { line: 1 });
        assert!(matches!(error("3.1 x -1 0"), TextError::Rate { line: 1, .. }));
        assert!(matches!(error("3.1 x 25 1\n0 2\n0"), TextError::Mask { line: 2, entry: 2, .. }));
        assert_eq!(error("3.1 x 25 1\n0 1"), TextError::NoValues { line: 2 });
        assert!(matches!(error("3.1 x 25 1\n1\n0 9999999999"), TextError::Number { line: 3, .. }));
        assert!(matches!(error("3.1 x 25 1\n1\n0 nan"), TextError::Number { line: 3, .. }));
        assert_eq!(error("3.1 x 25 1\n1\n0 1 2"), TextError::TooManyValues { line: 3, expected: 1 });
        assert_eq!(error("3.1 x 25 1\n1\n5 1\n1\n5 1"), TextError::Order { line: 5, found: 5, before: 5 });
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(
            frames in prop::collection::vec(
                prop::collection::btree_map(1u16..=296, any::<i32>(), 0..20), 0..10),
            rate in 0.1f64..1000.0,
        ) {
            let frames = frames.iter().enumerate().map(|(number, values)| {
                let values = values.iter().map(|(&bap, &value)| (Bap::new(bap).unwrap(), value));
                (number as u32 * 3, values.collect())
            });
            let file = BapFile {
                version: "3.2".into(), name: "some name".into(), rate, frames: frames.collect(),
            };
            let again = read(&write(&file)).unwrap();
            prop_assert_eq!(again.frames, file.frames);
            prop_assert_eq!(again.rate, rate);
        }

        #[test]
        fn any_text_is_read_or_refused(text in "[-0-9.# \n]{0,80}|\\PC{0,80}") {
            let _ = read(&format!("3.1 x 25 1\n{text}"));
            let _ = read(&text);
        }
    }
}
