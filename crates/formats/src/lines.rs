//! Lines of a text stream, numbered and bounded: the ground of every JSON-lines reader here.

use std::io::{self, BufRead, Read};

/// The byte order mark of UTF-8, which editors and spreadsheets put before a text.
const MARK: &[u8] = b"\xef\xbb\xbf";

/// A text without its byte order mark.
pub(crate) fn unmarked(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(MARK).unwrap_or(bytes)
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
        let text = std::str::from_utf8(self.buffer.trim_ascii()).map_err(|_| LineError::NotUtf8)?;
        Ok(Some(text))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
