//! Lines of a text stream, numbered and bounded: the ground of every JSON-lines reader here.

use std::borrow::Cow;
use std::io::{self, BufRead, Read};

/// The byte order mark of UTF-8, which editors and spreadsheets put before a text.
const MARK: &[u8] = b"\xef\xbb\xbf";

/// A text without its byte order mark.
pub(crate) fn unmarked(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(MARK).unwrap_or(bytes)
}

/// How a unit of two bytes is read.
type Unit = fn([u8; 2]) -> u16;
/// The byte order marks of UTF-16, which spreadsheets write as "Unicode text", with how the units behind them are read.
const WIDE_MARKS: [(&[u8], Unit); 2] = [(b"\xff\xfe", u16::from_le_bytes), (b"\xfe\xff", u16::from_be_bytes)];

/// A text without its byte order mark, UTF-16 where that says so, else UTF-8. What is none is U+FFFD.
pub(crate) fn text_of(bytes: &[u8]) -> Cow<'_, str> {
    let wide = WIDE_MARKS.iter().find_map(|(mark, unit)| Some((bytes.strip_prefix(*mark)?, unit)));
    let Some((rest, unit)) = wide else { return String::from_utf8_lossy(unmarked(bytes)) };
    let units = rest.as_chunks().0.iter().map(|pair| unit(*pair));
    char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect::<String>().into()
}

/// Reads lines, skips blank ones and a byte order mark, counts them all, and never holds more than its limit.
pub struct LineReader<R> {
    reader: R,
    buffer: Vec<u8>,
    number: usize,
    bytes: u64,
    max_bytes: usize,
}

/// Why a line could not be read.
#[derive(Debug)]
#[non_exhaustive]
pub enum LineError {
    /// Reading failed.
    Io(io::Error),
    /// It has more bytes than allowed.
    TooLong,
    /// It is no text.
    NotUtf8,
}

impl LineError {
    /// The cause in words, for a message that names the line.
    pub fn describe(&self, max_bytes: usize) -> String {
        match self {
            LineError::Io(error) => error.to_string(),
            LineError::TooLong => format!("longer than the {max_bytes} bytes allowed"),
            LineError::NotUtf8 => "not UTF-8 text".into(),
        }
    }
}

impl<R: BufRead> LineReader<R> {
    /// At most `max_bytes` bytes in a line.
    pub fn new(reader: R, max_bytes: usize) -> Self {
        Self { reader, buffer: Vec::new(), number: 0, bytes: 0, max_bytes }
    }

    /// Number of the line last read, from 1.
    pub fn number(&self) -> usize {
        self.number
    }

    /// Bytes read so far.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Most bytes in one line.
    pub fn max_bytes(&self) -> usize {
        self.max_bytes
    }

    /// The next line that is not blank, without its end; `None` at the end of the stream.
    ///
    /// # Errors
    /// See [`LineError`].
    pub fn next_line(&mut self) -> Result<Option<&str>, LineError> {
        loop {
            self.buffer.clear();
            let limit = self.max_bytes as u64 + 1;
            let n = (&mut self.reader).take(limit).read_until(b'\n', &mut self.buffer);
            self.number += 1;
            let n = n.map_err(LineError::Io)?;
            if n == 0 {
                return Ok(None);
            }
            self.bytes += n as u64;
            if self.buffer.len() > self.max_bytes {
                return Err(LineError::TooLong);
            }
            if self.number == 1 && self.buffer.starts_with(MARK) {
                self.buffer.drain(..MARK.len());
            }
            if !self.buffer.trim_ascii().is_empty() {
                break;
            }
        }
        line_text(&self.buffer, self.max_bytes)
    }
}

/// What a line, given with its end, says; `None` for a blank one.
///
/// # Errors
/// [`LineError::TooLong`], [`LineError::NotUtf8`].
pub(crate) fn line_text(line: &[u8], max_bytes: usize) -> Result<Option<&str>, LineError> {
    if line.len() > max_bytes {
        return Err(LineError::TooLong);
    }
    match line.trim_ascii() {
        [] => Ok(None),
        text => std::str::from_utf8(text).map(Some).map_err(|_| LineError::NotUtf8),
    }
}

/// Reads lines many at a time, to be looked at on several cores: those that a [`LineReader`] has left.
pub(crate) struct BlockReader<R> {
    reader: R,
    /// The start of a line whose rest is still to be read.
    rest: Vec<u8>,
    max_bytes: usize,
}

impl<R: BufRead> BlockReader<R> {
    /// Goes on behind the lines that `lines` has read.
    pub fn behind(lines: LineReader<R>) -> Self {
        Self { reader: lines.reader, rest: Vec::new(), max_bytes: lines.max_bytes }
    }

    /// Puts whole lines into `text`, in place of what is there: as many as `most` bytes have, twice the most of a line at least.
    /// False where no more come. Before an error `text` has the lines in front of it.
    ///
    /// # Errors
    /// [`LineError::Io`], [`LineError::TooLong`], of the line behind `text`; those of the lines in it come of [`line_text`].
    pub fn fill(&mut self, text: &mut Vec<u8>, most: usize) -> Result<bool, LineError> {
        // What has been in `text` before need not be cleared.
        text.resize(most.max(2 * self.max_bytes), 0);
        text[..self.rest.len()].copy_from_slice(&self.rest);
        let mut end = self.rest.len();
        let read = loop {
            match self.reader.read(&mut text[end..]) {
                // Either no more come or there is no room for more.
                Ok(0) => break Ok(end == text.len()),
                Ok(n) => end += n,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => break Err(LineError::Io(error)),
            }
        };
        text.truncate(end);
        self.rest.clear();
        if !matches!(read, Ok(false)) {
            let whole = text.iter().rposition(|&b| b == b'\n').map_or(0, |at| at + 1);
            self.rest.extend(text.drain(whole..));
        }
        if self.rest.len() > self.max_bytes { Err(LineError::TooLong) } else { read }
    }
}

/// Cuts a text behind ends of lines into pieces of `bytes` bytes and what is left of a line: with 0 into its lines.
pub(crate) fn pieces(mut text: &[u8], bytes: usize) -> impl Iterator<Item = &[u8]> {
    std::iter::from_fn(move || {
        let mut behind = text.get(bytes..).unwrap_or_default();
        // Slices are read without errors.
        let further = behind.skip_until(b'\n').unwrap_or(0);
        let (piece, rest) = text.split_at(text.len().min(bytes + further));
        text = rest;
        (!piece.is_empty()).then_some(piece)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn blank_lines_are_skipped_and_counted() {
        let mut lines = LineReader::new("\n  \na\r\n\nb".as_bytes(), 10);
        assert_eq!(lines.next_line().unwrap(), Some("a"));
        assert_eq!(lines.number(), 3);
        assert_eq!(lines.next_line().unwrap(), Some("b"));
        assert_eq!(lines.number(), 5);
        assert_eq!(lines.next_line().unwrap(), None);
    }

    #[test]
    fn a_byte_order_mark_is_no_part_of_the_first_line() {
        let mut lines = LineReader::new("\u{feff}a\n\u{feff}b".as_bytes(), 10);
        assert_eq!(lines.next_line().unwrap(), Some("a"));
        assert_eq!(lines.next_line().unwrap(), Some("\u{feff}b"));
        let mut lines = LineReader::new("\u{feff}\na".as_bytes(), 10);
        assert_eq!(lines.next_line().unwrap(), Some("a"));
    }

    #[test]
    fn long_and_foreign_lines_are_refused() {
        assert!(matches!(LineReader::new("12345678901".as_bytes(), 10).next_line(), Err(LineError::TooLong)));
        assert!(matches!(LineReader::new(&b"\xff\xfe"[..], 10).next_line(), Err(LineError::NotUtf8)));
        assert_eq!(LineReader::new("123456789\n".as_bytes(), 10).next_line().unwrap(), Some("123456789"));
    }

    /// A reader that gives a few bytes at a time, and an error in the end where it is told to.
    struct Bit<'a> {
        left: &'a [u8],
        sizes: Vec<usize>,
        broken: bool,
        turn: usize,
    }

    impl Read for Bit<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            self.turn += 1;
            if self.turn.is_multiple_of(3) {
                return Err(io::ErrorKind::Interrupted.into());
            }
            if self.left.is_empty() && self.broken {
                return Err(io::Error::other("gone"));
            }
            let most = self.sizes[self.turn % self.sizes.len()].min(buffer.len());
            self.left.read(&mut buffer[..most])
        }
    }

    /// Lines with their numbers, and the first error with that of its line.
    type Told = (Vec<(usize, String)>, Option<(usize, String)>);

    fn one_by_one(reader: impl BufRead, max: usize) -> Told {
        let (mut lines, mut told) = (LineReader::new(reader, max), Vec::new());
        loop {
            let line = lines.next_line().map(|line| line.map(str::to_owned));
            match line {
                Ok(Some(line)) => told.push((lines.number(), line)),
                Ok(None) => return (told, None),
                Err(error) => return (told, Some((lines.number(), error.describe(max)))),
            }
        }
    }

    fn in_pieces(reader: impl BufRead, max: usize, block: usize, piece: usize) -> Told {
        let mut blocks = BlockReader::behind(LineReader::new(reader, max));
        let (mut text, mut told, mut number) = (Vec::new(), Vec::new(), 0);
        loop {
            let read = blocks.fill(&mut text, block);
            for line in pieces(&text, piece).flat_map(|piece| pieces(piece, 0)) {
                number += 1;
                match line_text(line, max) {
                    Ok(line) => told.extend(line.map(|line| (number, line.to_owned()))),
                    Err(error) => return (told, Some((number, error.describe(max)))),
                }
            }
            match read {
                Ok(true) => {}
                Ok(false) => return (told, None),
                Err(error) => return (told, Some((number + 1, error.describe(max)))),
            }
        }
    }

    proptest! {
        /// Blank lines, other ends of lines, none at the end, lines that are too long or no text, a reader that breaks.
        #[test]
        fn pieces_are_the_lines_one_by_one(
            parts in prop::collection::vec(
                prop_oneof![
                    8 => "[a-z ]{0,12}\n",
                    2 => "[a-z]{0,5}\r\n",
                    2 => "\n{1,9}",
                    1 => "[a-z]{15,80}\n",
                    1 => Just("x".repeat(15) + "\n"),
                ],
                0..60,
            ),
            end in "[a-z]{0,18}",
            foreign in prop::option::weighted(0.2, any::<prop::sample::Index>()),
            sizes in prop::collection::vec(1usize..70, 1..5),
            broken in prop::bool::weighted(0.2),
            (block, piece) in (0usize..200, 0usize..50),
        ) {
            let mut text = (parts.concat() + &end).into_bytes();
            if let (Some(foreign), false) = (foreign, text.is_empty()) {
                let at = foreign.index(text.len());
                text[at] = 0xff;
            }
            let reader = || io::BufReader::with_capacity(8, Bit { left: &text, sizes: sizes.clone(), broken, turn: 0 });
            prop_assert_eq!(in_pieces(reader(), 16, block, piece), one_by_one(reader(), 16));
        }
    }
}
