//! A few bytes that travel with a stream and are no part of it: user data of the visual object sequence.

use super::error::EncodeError;

/// What user data that carry a record begin with: others are passed over.
pub(super) const MARK: [u8; 2] = [0xe8, 0xe3];
/// What they end with, so that no zero does.
const END: u8 = 0x80;

/// Bytes of user data that carry a record, start code and mark left out. What they mean is not the stream's business.
///
/// ```
/// use handcast_fba::Record;
///
/// let record = Record::new(&[1, 0, 0, 0, 7])?;
/// assert_eq!(record.bytes(), [1, 0, 0, 0, 7]);
/// assert!(Record::new(&[0; Record::MAX + 1]).is_err());
/// # Ok::<(), handcast_fba::EncodeError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record {
    length: u8,
    bytes: [u8; Self::MAX],
}

impl Default for Record {
    fn default() -> Self {
        Self { length: 0, bytes: [0; Self::MAX] }
    }
}

impl Record {
    /// Most bytes of a record.
    pub const MAX: usize = 42;
    /// Most bytes that they become in a stream.
    pub(super) const MAX_WRITTEN: usize = MARK.len() + Self::MAX * 3 / 2 + 1;

    /// A record of these bytes.
    ///
    /// # Errors
    /// [`EncodeError::Parameter`] for more than [`Self::MAX`].
    pub fn new(bytes: &[u8]) -> Result<Self, EncodeError> {
        let mut out = Self::default();
        let Some(kept) = out.bytes.get_mut(..bytes.len()) else {
            let (what, value, allowed) = ("bytes of a record", bytes.len() as f64, "at most 42");
            return Err(EncodeError::Parameter { what, value, allowed });
        };
        kept.copy_from_slice(bytes);
        out.length = bytes.len() as u8;
        Ok(out)
    }

    /// Its bytes; none of a stream without a record.
    pub fn bytes(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.length)).unwrap_or_default()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.length == 0
    }

    /// What stands behind the start code: the mark, the bytes, with a 3 after any two zeros that something below 4
    /// follows, so that no start code is imitated, and an end.
    pub(super) fn written(&self) -> impl Iterator<Item = u8> + '_ {
        let bytes = self.bytes();
        let mut zeros = 0;
        let escaped = bytes.iter().flat_map(move |&byte| {
            let escape = (zeros == 2 && byte < 4).then_some(3);
            zeros = match (byte, escape) {
                (0, Some(_)) => 1,
                (0, None) => zeros + 1,
                _ => 0,
            };
            escape.into_iter().chain([byte])
        });
        MARK.into_iter().chain(escaped).chain([END])
    }

    /// The record that stands in user data, if there is one.
    pub(super) fn read(data: &[u8]) -> Option<Self> {
        let written = data.strip_prefix(&MARK)?.strip_suffix(&[END])?;
        let mut bytes = Vec::with_capacity(written.len());
        let mut zeros = 0;
        for &byte in written {
            if byte == 3 && zeros == 2 {
                zeros = 0;
                continue;
            }
            zeros = if byte == 0 { zeros + 1 } else { 0 };
            bytes.push(byte);
        }
        Self::new(&bytes).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_written_is_read_and_no_start_code(
            bytes in prop::collection::vec(prop_oneof![Just(0u8), 0u8..5, any::<u8>()], 0..=Record::MAX),
        ) {
            let record = Record::new(&bytes).unwrap();
            let written: Vec<u8> = record.written().collect();
            prop_assert!(written.len() <= Record::MAX_WRITTEN);
            prop_assert!(!written.windows(3).any(|w| w[0] == 0 && w[1] == 0 && w[2] < 3));
            prop_assert!(!written.ends_with(&[0]));
            prop_assert_eq!(Record::read(&written), Some(record));
        }
    }
}
