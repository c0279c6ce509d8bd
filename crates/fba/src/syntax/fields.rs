//! Single syntax elements, read, written or only counted.

use super::super::arith::{self, SymbolCoder};
use super::super::bits::{BitCounter, BitReader, BitWriter, Element, Trace};
use super::super::error::SyntaxError;

/// A field of the syntax.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    /// Its name in the tables.
    pub name: &'static str,
    /// The BAP, FAP or group it belongs to, if any.
    pub subject: Option<u16>,
    /// Width in bits, 1 to 32.
    pub width: u32,
}

/// Reads or writes syntax elements.
pub trait Fields {
    /// Codes the values of one arithmetic-coded part.
    type Coder<'a>: SymbolCoder
    where
        Self: 'a;

    /// An unsigned field, highest bit first.
    ///
    /// # Errors
    /// End of data, or a value too large for the field.
    fn field(&mut self, field: Field, value: u32) -> Result<u32, SyntaxError>;

    /// The same, spelt out.
    ///
    /// # Errors
    /// As [`Self::field`].
    fn u(
        &mut self,
        name: &'static str,
        subject: Option<u16>,
        width: u32,
        value: u32,
    ) -> Result<u32, SyntaxError> {
        self.field(Field { name, subject, width }, value)
    }

    /// Starts an arithmetic-coded part.
    ///
    /// # Errors
    /// End of data.
    fn arithmetic(&mut self) -> Result<Self::Coder<'_>, SyntaxError>;

    /// Bits from the start of the stream.
    fn bit_position(&self) -> u64;

    /// A one-bit field.
    ///
    /// # Errors
    /// End of data.
    fn flag(&mut self, name: &'static str, value: bool) -> Result<bool, SyntaxError> {
        Ok(self.u(name, None, 1, value.into())? == 1)
    }

    /// A bit that must be 1.
    ///
    /// # Errors
    /// End of data, or a 0.
    fn marker(&mut self, place: &'static str) -> Result<(), SyntaxError> {
        let bit = self.bit_position();
        if self.u("marker_bit", None, 1, 1)? == 1 { Ok(()) } else { Err(SyntaxError::Marker { bit, place }) }
    }
}

impl Fields for BitWriter {
    type Coder<'a> = arith::Encoder<'a, BitWriter>;

    fn field(&mut self, field: Field, value: u32) -> Result<u32, SyntaxError> {
        check_width(field, value)?;
        self.put(field.width, value);
        Ok(value)
    }

    fn arithmetic(&mut self) -> Result<Self::Coder<'_>, SyntaxError> {
        Ok(arith::Encoder::new(self))
    }

    fn bit_position(&self) -> u64 {
        self.position()
    }
}

/// Checks that values fit and counts bits, without storing any.
impl Fields for BitCounter {
    type Coder<'a> = arith::Encoder<'a, Self>;

    fn field(&mut self, field: Field, value: u32) -> Result<u32, SyntaxError> {
        check_width(field, value)?;
        self.bits += u64::from(field.width);
        Ok(value)
    }

    fn arithmetic(&mut self) -> Result<Self::Coder<'_>, SyntaxError> {
        Ok(arith::Encoder::new(self))
    }

    fn bit_position(&self) -> u64 {
        self.bits
    }
}

impl<'d, T: Trace> Fields for BitReader<'d, T> {
    type Coder<'a>
        = arith::Decoder<'a, 'd, T>
    where
        Self: 'a;

    fn field(&mut self, Field { name, subject, width }: Field, _value: u32) -> Result<u32, SyntaxError> {
        let bit = self.stream_position();
        let value = self.take(width)?;
        self.trace.element(Element { bit, width, name, subject, value: value.into() });
        Ok(value)
    }

    fn arithmetic(&mut self) -> Result<Self::Coder<'_>, SyntaxError> {
        arith::Decoder::new(self, true)
    }

    fn bit_position(&self) -> u64 {
        self.stream_position()
    }
}

fn check_width(Field { name, width, .. }: Field, value: u32) -> Result<(), SyntaxError> {
    if width < 32 && value >> width != 0 {
        return Err(SyntaxError::FieldOverflow { name, value, width });
    }
    Ok(())
}
