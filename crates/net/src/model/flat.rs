//! Bounds-checked reading of FlatBuffers: tables, vectors, strings.
//!
//! All numbers are little-endian. A table starts with a signed distance back to its vtable; the vtable holds its own
//! size, the table's size, and for each field its distance from the table's start, 0 where it is absent. Vectors,
//! strings and tables in fields are unsigned distances forward (FlatBuffers internals,
//! <https://flatbuffers.dev/internals/>).

use crate::error::{Error, Result};

fn format(at: usize, what: impl Into<String>) -> Error {
    Error::Format { at, what: what.into() }
}

/// `N` bytes at `at`.
fn array<const N: usize>(bytes: &[u8], at: usize, what: &str) -> Result<[u8; N]> {
    at.checked_add(N)
        .and_then(|end| bytes.get(at..end))
        .and_then(|slice| slice.try_into().ok())
        .ok_or_else(|| format(at, format!("{what} of {N} bytes lies outside of the file of {}", bytes.len())))
}

fn u16_at(bytes: &[u8], at: usize, what: &str) -> Result<u16> {
    array(bytes, at, what).map(u16::from_le_bytes)
}

fn u32_at(bytes: &[u8], at: usize, what: &str) -> Result<u32> {
    array(bytes, at, what).map(u32::from_le_bytes)
}

/// Where the distance stored at `at` leads.
fn follow(bytes: &[u8], at: usize, what: &str) -> Result<usize> {
    let distance = u32_at(bytes, at, what)? as usize;
    at.checked_add(distance)
        .filter(|&target| distance > 0 && target < bytes.len())
        .ok_or_else(|| format(at, format!("{what}: an offset of {distance} leads out of the file")))
}

/// A table and the vtable that says where its fields are.
#[derive(Clone, Copy, Debug)]
pub struct Table<'a> {
    bytes: &'a [u8],
    at: usize,
    vtable: usize,
    fields: usize,
    size: usize,
}

impl<'a> Table<'a> {
    /// The root table of a file with this four-character identifier.
    pub fn root(bytes: &'a [u8], identifier: &[u8; 4]) -> Result<Self> {
        let found: [u8; 4] = array(bytes, 4, "the file identifier")?;
        if &found != identifier {
            return Err(format(
                4,
                format!("the file identifier is {:?}, not {:?}", ascii(&found), ascii(identifier)),
            ));
        }
        Self::at(bytes, follow(bytes, 0, "the root table")?)
    }

    fn at(bytes: &'a [u8], at: usize) -> Result<Self> {
        let back = array(bytes, at, "a table").map(i32::from_le_bytes)?;
        let vtable = (at as i64)
            .checked_sub(i64::from(back))
            .and_then(|v| usize::try_from(v).ok())
            .filter(|&v| v < bytes.len())
            .ok_or_else(|| format(at, format!("a table's vtable is {back} bytes before it")))?;
        let length = usize::from(u16_at(bytes, vtable, "a vtable")?);
        let size = usize::from(u16_at(bytes, vtable + 2, "a vtable")?);
        if length < 4 || length % 2 != 0 || vtable + length > bytes.len() {
            return Err(format(vtable, format!("a vtable of {length} bytes")));
        }
        if size < 4 || at + size > bytes.len() {
            return Err(format(at, format!("a table of {size} bytes")));
        }
        Ok(Self { bytes, at, vtable, fields: (length - 4) / 2, size })
    }

    /// Where the table is in the file.
    pub fn position(&self) -> usize {
        self.at
    }

    /// Where field `id` of `width` bytes is.
    fn field(&self, id: usize, width: usize) -> Result<Option<usize>> {
        if id >= self.fields {
            return Ok(None);
        }
        let offset = usize::from(u16_at(self.bytes, self.vtable + 4 + 2 * id, "a vtable")?);
        match offset {
            0 => Ok(None),
            _ if offset < 4 || offset + width > self.size => {
                Err(format(self.at, format!("field {id} at {offset} of a table of {} bytes", self.size)))
            }
            _ => Ok(Some(self.at + offset)),
        }
    }

    /// An unsigned byte.
    pub fn byte(&self, id: usize, default: u8) -> Result<u8> {
        match self.field(id, 1)? {
            Some(at) => Ok(array::<1>(self.bytes, at, "a byte")?[0]),
            None => Ok(default),
        }
    }

    /// A signed number of 32 bits.
    pub fn int(&self, id: usize, default: i32) -> Result<i32> {
        match self.field(id, 4)? {
            Some(at) => array(self.bytes, at, "a number").map(i32::from_le_bytes),
            None => Ok(default),
        }
    }

    /// An unsigned number of 32 bits.
    pub fn unsigned(&self, id: usize, default: u32) -> Result<u32> {
        match self.field(id, 4)? {
            Some(at) => u32_at(self.bytes, at, "a number"),
            None => Ok(default),
        }
    }

    /// An unsigned number of 64 bits.
    pub fn long(&self, id: usize, default: u64) -> Result<u64> {
        match self.field(id, 8)? {
            Some(at) => array(self.bytes, at, "a number").map(u64::from_le_bytes),
            None => Ok(default),
        }
    }

    /// A table.
    pub fn table(&self, id: usize) -> Result<Option<Table<'a>>> {
        match self.field(id, 4)? {
            Some(at) => Self::at(self.bytes, follow(self.bytes, at, "a table")?).map(Some),
            None => Ok(None),
        }
    }

    /// Elements of `width` bytes each; `what` names them in errors.
    fn vector(&self, id: usize, width: usize, what: &str) -> Result<Option<Vector<'a>>> {
        let Some(at) = self.field(id, 4)? else { return Ok(None) };
        let start = follow(self.bytes, at, what)?;
        let count = u32_at(self.bytes, start, what)? as usize;
        let first = start + 4;
        count
            .checked_mul(width)
            .and_then(|length| first.checked_add(length))
            .filter(|&end| end <= self.bytes.len())
            .map(|end| Some(Vector { bytes: self.bytes, first, count, data: &self.bytes[first..end] }))
            .ok_or_else(|| {
                format(start, format!("{what}: {count} elements of {width} bytes reach beyond the file"))
            })
    }

    /// Bytes.
    pub fn bytes(&self, id: usize, what: &str) -> Result<Option<&'a [u8]>> {
        Ok(self.vector(id, 1, what)?.map(|v| v.data))
    }

    /// Text; not UTF-8 is an error.
    pub fn text(&self, id: usize, what: &str) -> Result<&'a str> {
        match self.vector(id, 1, what)? {
            Some(v) => std::str::from_utf8(v.data).map_err(|_| format(v.first, format!("{what}: not UTF-8"))),
            None => Ok(""),
        }
    }

    /// Signed numbers of 32 bits; empty where the field is absent.
    pub fn ints(&self, id: usize, what: &str) -> Result<impl ExactSizeIterator<Item = i32> + 'a> {
        let data = self.vector(id, 4, what)?.map_or(&[][..], |v| v.data);
        Ok(data.as_chunks::<4>().0.iter().map(|&b| i32::from_le_bytes(b)))
    }

    /// Tables; empty where the field is absent.
    pub fn tables(&self, id: usize, what: &'static str) -> Result<Tables<'a>> {
        Ok(Tables(self.vector(id, 4, what)?.unwrap_or(Vector {
            bytes: self.bytes,
            first: 0,
            count: 0,
            data: &[],
        })))
    }
}

fn ascii(bytes: &[u8]) -> String {
    bytes.escape_ascii().to_string()
}

#[derive(Clone, Copy, Debug)]
struct Vector<'a> {
    bytes: &'a [u8],
    first: usize,
    count: usize,
    data: &'a [u8],
}

/// A vector of tables.
#[derive(Clone, Copy, Debug)]
pub struct Tables<'a>(Vector<'a>);

impl<'a> Tables<'a> {
    /// How many.
    pub fn len(&self) -> usize {
        self.0.count
    }

    /// Table `index`, which must be there.
    pub fn get(&self, index: usize, what: &str) -> Result<Table<'a>> {
        if index >= self.0.count {
            return Err(format(
                self.0.first,
                format!("{what} {index} does not exist: there are {}", self.0.count),
            ));
        }
        Table::at(self.0.bytes, follow(self.0.bytes, self.0.first + 4 * index, what)?)
    }

    /// All of them, in order.
    pub fn iter(&self, what: &'static str) -> impl Iterator<Item = Result<Table<'a>>> + use<'a> {
        let tables = *self;
        (0..tables.len()).map(move |index| tables.get(index, what))
    }
}
