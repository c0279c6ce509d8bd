//! Lists what a stream is made of: every plane, where its bits go, and every syntax element.

use serde::Serialize;

use super::bits::Element;
use super::decoder::{DecodedFrame, Decoder, DecoderOptions};
use super::error::SyntaxError;
use super::writer::PlaneBits;
use crate::bap::derive::left_to_model;
use crate::bap::{Bap, Tie};

/// One plane of a stream.
#[derive(Clone, Debug)]
pub struct InspectedPlane {
    /// What a decoder delivers for it, planes with object mask 0 included.
    pub frame: DecodedFrame,
    /// Where its bits go. Face parts count as headers.
    pub bits: PlaneBits,
    /// Range arrays it sends, in stream order: I max, I min, P max, P min.
    pub new_ranges: [bool; 4],
    /// Its syntax elements, start codes in front of it included.
    pub elements: Vec<Element>,
}

/// Walks through the planes of a stream held in memory.
///
/// ```
/// use handcast_fba::inspect::Inspector;
///
/// let planes: Vec<_> =
///     Inspector::new(handcast_fba::example_stream(), Default::default()).collect::<Result<_, _>>()?;
/// assert_eq!(planes.len(), 3);
/// assert_eq!(planes[1].bits.predicted_values, 17);
/// assert_eq!(planes[0].elements[1].name, "is_intra");
/// # Ok::<(), handcast_fba::error::SyntaxError>(())
/// ```
#[derive(Debug)]
pub struct Inspector<'a> {
    decoder: Decoder,
    rest: &'a [u8],
    /// End of the plane before, to tell how many bits lie between planes.
    last_end: u64,
    finished: bool,
}

/// Bytes handed to the decoder at a time.
const PIECE: usize = 4096;

impl<'a> Inspector<'a> {
    /// An inspector of the stream `bytes`.
    pub fn new(bytes: &'a [u8], options: DecoderOptions) -> Self {
        Self { decoder: Decoder::new(options), rest: bytes, last_end: 0, finished: false }
    }

    /// The decoder behind it: rate, mask, damage count.
    pub fn decoder(&self) -> &Decoder {
        &self.decoder
    }
}

impl Iterator for Inspector<'_> {
    type Item = Result<InspectedPlane, SyntaxError>;

    /// The next plane; after an error the walk resumes at the next start code with an I plane.
    fn next(&mut self) -> Option<Self::Item> {
        let mut elements = Vec::new();
        loop {
            match self.decoder.next_plane(&mut elements) {
                Ok(Some(frame)) => {
                    let bits = self.decoder.plane_bits(self.last_end);
                    self.last_end = frame.end_bit;
                    let new_ranges = self.decoder.new_ranges();
                    return Some(Ok(InspectedPlane {
                        elements: once_each(elements, &frame),
                        frame,
                        bits,
                        new_ranges,
                    }));
                }
                Ok(None) if self.rest.is_empty() && self.finished => return None,
                Ok(None) if self.rest.is_empty() => {
                    self.decoder.finish();
                    self.finished = true;
                }
                Ok(None) => {
                    let (piece, rest) = self.rest.split_at(self.rest.len().min(PIECE));
                    self.rest = rest;
                    if let Err(error) = self.decoder.push(piece) {
                        self.rest = &[];
                        return Some(Err(error));
                    }
                }
                Err(error) => return Some(Err(error)),
            }
        }
    }
}

/// Drops what was told twice because a plane was tried before all its data had come.
fn once_each(mut elements: Vec<Element>, frame: &DecodedFrame) -> Vec<Element> {
    let first = |element: &Element| element.bit == frame.first_bit && element.name == "is_intra";
    if let Some(last_try) = elements.iter().rposition(first) {
        let plane = elements.split_off(last_try);
        elements.retain(|element| element.name.ends_with("start_code"));
        elements.dedup();
        elements.extend(plane);
    }
    elements
}

/// A plane as one JSON object.
#[derive(Debug, Serialize)]
pub struct PlaneRecord {
    /// Number of the plane, from 0.
    pub plane: u64,
    /// `"I"` or `"P"`; `"-"` of a plane without any object, which fills up to a byte.
    pub kind: char,
    /// Time in seconds.
    pub time: f64,
    /// Object mask: bit 0 the face, bit 1 the body.
    pub object_mask: u8,
    /// Frames skipped after it.
    pub skipped: u32,
    /// First bit, and one past the last.
    pub bits: [u64; 2],
    /// Quantiser index in force.
    pub quant: u8,
    /// Numbers of the BAPs switched on.
    pub mask: Vec<u16>,
    /// Numbers of BAPs that are not sent because the decoder's model derives them from those that are.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub left_to_hand_model: Vec<u16>,
    /// Bits by use, in the order start codes, headers, masks, ranges, I values, P values, flush.
    pub bits_by_use: [u64; 7],
    /// Values of the BAPs switched on, in the order of `mask`.
    pub values: Vec<i32>,
    /// Syntax elements, if asked for.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub elements: Vec<ElementRecord>,
}

/// A syntax element as one JSON object.
#[derive(Debug, Serialize)]
pub struct ElementRecord {
    /// Bit offset.
    pub bit: u64,
    /// Width in bits.
    pub width: u32,
    /// Name.
    pub name: &'static str,
    /// BAP, FAP or group number.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub subject: Option<u16>,
    /// Value.
    pub value: i64,
}

impl InspectedPlane {
    /// How it is coded, `I` or `P`; `-` where it is of no object.
    pub fn letter(&self) -> char {
        if self.frame.object_mask == 0 { '-' } else { self.frame.kind.letter() }
    }

    /// The plane as a record for printing, with its elements if `verbose`. `ties` are those of the model that the
    /// decoder derives BAPs with.
    pub fn record(&self, verbose: bool, ties: &[Tie]) -> PlaneRecord {
        let PlaneBits { start_codes, headers, masks, ranges, intra_values, predicted_values, flush } =
            self.bits;
        let elements = if verbose { self.elements.as_slice() } else { &[] };
        PlaneRecord {
            plane: self.frame.plane,
            kind: self.letter(),
            time: self.frame.time,
            object_mask: self.frame.object_mask,
            skipped: self.frame.skipped,
            bits: [self.frame.first_bit, self.frame.end_bit],
            quant: self.frame.quant,
            mask: self.frame.baps.mask.iter().map(Bap::number).collect(),
            left_to_hand_model: left_to_model(ties, &self.frame.baps.mask).iter().map(Bap::number).collect(),
            bits_by_use: [start_codes, headers, masks, ranges, intra_values, predicted_values, flush],
            values: self.frame.baps.iter().map(|(_, value)| value).collect(),
            elements: elements
                .iter()
                .map(|&Element { bit, width, name, subject, value }| ElementRecord {
                    bit,
                    width,
                    name,
                    subject,
                    value,
                })
                .collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example_stream;

    /// Elements lie one behind the other without gap or overlap, and the parts add up.
    #[test]
    fn elements_cover_every_bit() {
        for plane in Inspector::new(example_stream(), DecoderOptions::default()) {
            let plane = plane.unwrap();
            let start = plane.elements.first().unwrap().bit;
            let mut at = start;
            for element in &plane.elements {
                assert_eq!(element.bit, at, "{element:?}");
                at += u64::from(element.width);
            }
            assert_eq!(at + 2, plane.frame.end_bit);
            assert_eq!(plane.bits.total(), plane.frame.end_bit - start);
        }
    }

    #[test]
    fn planes_that_fill_up_to_a_byte_are_told_as_such() {
        // Its last plane ends two bits before its end code, in which three bits of 0 and stuffing go.
        let [planes @ .., _, 0, 0, 1, 0xb1] = example_stream() else { panic!() };
        let filled = [planes, &[0x58, 0x3f, 0, 0, 1, 0xb1]].concat();
        let letters = |stream: &[u8]| -> Vec<char> {
            let planes = Inspector::new(stream, DecoderOptions::default());
            planes.map(|plane| plane.unwrap().record(false, &[]).kind).collect()
        };
        assert_eq!(letters(example_stream()), ['I', 'P', 'P']);
        assert_eq!(letters(&filled), ['I', 'P', 'P', '-']);
    }
}
