//! The boxes of ISO base media files (ISO/IEC 14496-12), which MP4 and MOV files are made of, and the tables of their tracks.
//!
//! Every number is checked where it is read: boxes lie within what holds them, tables within their boxes; a count takes time
//! or memory only when the bytes behind it are there.

mod tables;
pub mod testing;

use thiserror::Error;

pub use tables::{Edit, Places, Runs, edit, rows};

/// What is wrong with the boxes of a file, and where.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct Damage(pub String);

/// What was read, or what is wrong with it.
pub type Found<T> = Result<T, Damage>;

fn damage<T>(what: impl Into<String>) -> Found<T> {
    Err(Damage(what.into()))
}

/// The number of two bytes at a place, if they are there.
pub fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_be_bytes(bytes.get(at..at.checked_add(2)?)?.try_into().ok()?))
}

/// The number of four bytes at a place, if they are there.
pub fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(bytes.get(at..at.checked_add(4)?)?.try_into().ok()?))
}

/// The number of eight bytes at a place, if they are there.
pub fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_be_bytes(bytes.get(at..at.checked_add(8)?)?.try_into().ok()?))
}

/// The number of four bytes at a place of a box.
///
/// # Errors
/// They are not there.
pub fn number(bytes: &[u8], at: usize) -> Found<u32> {
    u32_at(bytes, at).ok_or_else(|| Damage("a box is cut".to_owned()))
}

/// The number of all of some bytes, at most eight: of a row of a table that may be of either width.
pub fn unsigned(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0, |number, &byte| number << 8 | u64::from(byte))
}

/// What stands behind the two dates of a header: ticks a second of `mvhd` and `mdhd`, the number of the track of `tkhd`.
///
/// # Errors
/// The header is cut.
pub fn behind_dates(header: &[u8]) -> Found<u32> {
    number(header, if header.first() == Some(&1) { 20 } else { 12 })
}

/// How a box begins (4.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Head {
    /// Its type.
    pub kind: [u8; 4],
    /// Bytes of the header itself.
    pub header: usize,
    /// Bytes of the box, those of the header included; none where it goes on to the end of the file.
    pub size: Option<u64>,
}

impl Head {
    /// Reads the header that bytes begin with; none of fewer than eight. A size that should follow and does not is 0.
    pub fn read(bytes: &[u8]) -> Option<Self> {
        let kind = bytes.get(4..8)?.try_into().ok()?;
        let (header, size) = match u32_at(bytes, 0)? {
            0 => (8, None),
            1 => (16, Some(u64_at(bytes, 8).unwrap_or(0))),
            size => (8, Some(size.into())),
        };
        Some(Self { kind, header, size })
    }

    /// The type, for people.
    pub fn name(&self) -> String {
        self.kind.escape_ascii().to_string()
    }
}

/// A box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MediaBox<'a> {
    /// Its type.
    pub kind: [u8; 4],
    /// Byte at which it begins, in what holds it.
    pub at: usize,
    /// What is in it.
    pub content: &'a [u8],
    /// With its header.
    pub whole: &'a [u8],
}

impl<'a> MediaBox<'a> {
    /// What is in it, if it is of a type.
    pub fn of(self, kind: &[u8; 4]) -> Option<&'a [u8]> {
        (&self.kind == kind).then_some(self.content)
    }
}

/// The bytes of a box of a type, of less than 4 GiB.
pub fn boxed(kind: &[u8; 4], content: &[u8]) -> Vec<u8> {
    [&(content.len() as u32 + 8).to_be_bytes()[..], kind, content].concat()
}

/// The outermost boxes of a file, the last of which may leave its size open. Behind the first damage there are none.
pub fn outermost(file: &[u8]) -> impl Iterator<Item = Found<MediaBox<'_>>> {
    walk(file, true)
}

/// The boxes in a box. None may leave its size open (4.2), and four bytes of 0 end them (QuickTime File Format, Sample
/// Description Atoms and User Data Atoms). Behind the first damage there are none.
pub fn children(content: &[u8]) -> impl Iterator<Item = Found<MediaBox<'_>>> {
    walk(content, false)
}

fn walk(bytes: &[u8], is_outermost: bool) -> impl Iterator<Item = Found<MediaBox<'_>>> {
    let mut at = 0;
    // A box has the eight bytes of its header or more, so that each step goes on.
    std::iter::from_fn(move || {
        let rest = bytes.get(at..).filter(|rest| !rest.is_empty())?;
        if !is_outermost && rest == [0; 4] {
            return None;
        }
        let found = first(rest, at, is_outermost);
        at = found.as_ref().map_or(bytes.len(), |found| at + found.whole.len());
        Some(found)
    })
}

fn first(rest: &[u8], at: usize, is_outermost: bool) -> Found<MediaBox<'_>> {
    let Some(head) = Head::read(rest) else {
        return damage(match is_outermost {
            true => format!("a box header at byte {at} is cut"),
            false => "the header of an inner box is cut".to_owned(),
        });
    };
    let size = head.size.unwrap_or(if is_outermost { rest.len() as u64 } else { 0 });
    let whole = usize::try_from(size).ok().and_then(|size| rest.get(..size));
    let Some((whole, content)) = whole.and_then(|whole| Some((whole, whole.get(head.header..)?))) else {
        let (name, left) = (head.name(), rest.len());
        return damage(match is_outermost {
            true => format!("the box {name} at byte {at} says {size} bytes; {left} are left"),
            false => format!("the inner box {name} says it has {size} bytes; {left} are left"),
        });
    };
    Ok(MediaBox { kind: head.kind, at, content, whole })
}

/// The contents of all boxes of a type in a box, up to the first damage.
pub fn all<'a>(content: &'a [u8], kind: &[u8; 4]) -> impl Iterator<Item = Found<&'a [u8]>> {
    children(content).filter_map(|found| found.map(|inner| inner.of(kind)).transpose())
}

/// The content of the first box in a box along a path of types, if there is one.
///
/// # Errors
/// Boxes before those on the path that are damaged.
pub fn path<'a>(content: &'a [u8], kinds: &[&[u8; 4]]) -> Found<Option<&'a [u8]>> {
    let mut here = content;
    for kind in kinds {
        let Some(found) = all(here, kind).next().transpose()? else { return Ok(None) };
        here = found;
    }
    Ok(Some(here))
}

/// The content of the first box of a type in a box, if there is one.
///
/// # Errors
/// Boxes before it that are damaged.
pub fn child<'a>(content: &'a [u8], kind: &[u8; 4]) -> Found<Option<&'a [u8]>> {
    path(content, &[kind])
}

/// The content of the first box of a type in a box.
///
/// # Errors
/// It is not there, or boxes before it are damaged.
pub fn needed<'a>(content: &'a [u8], kind: &[u8; 4]) -> Found<&'a [u8]> {
    let name = || kind.escape_ascii();
    child(content, kind)?.ok_or_else(|| Damage(format!("there is no box {}", name())))
}

/// The boxes in an entry of pictures, in `stsd`, which stand behind 78 bytes of it (12.1.3).
pub fn entry_boxes(entry: &[u8]) -> &[u8] {
    entry.get(78..).unwrap_or_default()
}

/// Whether a track is one of pictures, by its box `mdia` (8.4.3).
///
/// # Errors
/// Boxes before its handler that are damaged.
pub fn is_of_pictures(mdia: &[u8]) -> Found<bool> {
    Ok(child(mdia, b"hdlr")?.and_then(|handler| handler.get(8..12)) == Some(b"vide"))
}

#[cfg(test)]
mod tests;
