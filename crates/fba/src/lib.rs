//! The FBA object bitstream (ISO/IEC 14496-2, face and body animation): syntax, arithmetic coder,
//! encoder, decoder, rate control.
//!
//! Built from the description in `spec/fba-bitstream.md`. The predictive mode is complete; of the DCT
//! mode only its flag is known, and gives a clear error. The text of the standard could not be read, so
//! this follows ISO/IEC 14496-2 as the lineage of the reference software implements it.

pub mod arith;
pub mod bap;
pub mod bits;
pub mod decoder;
pub mod encoder;
pub mod error;
mod fap;
mod frame_writer;
mod from_epf;
pub mod inspect;
mod object;
pub mod plan;
mod reach;
mod record;
pub mod state;
pub mod syntax;
pub mod writer;

pub use decoder::{DecodedFrame, Decoder, DecoderLimits, DecoderOptions};
pub use encoder::{Encoder, EncoderConfig};
pub use error::{EncodeError, ErrorKind, SyntaxError};
pub use from_epf::{EpfEncodeError, encode_epf};
pub use record::Record;
pub use syntax::{FrameRate, PlaneKind, RangeRule, TimeCode};
pub use writer::{PlaneBits, PlaneWriter};

/// The worked example of `spec/fba-bitstream.md` section 1.9: BAPs 162 and 168, one I and two P planes
/// at 25 frames/s.
pub fn example_stream() -> &'static [u8] {
    &EXAMPLE
}

static EXAMPLE: [u8; 78] = [
    0x00, 0x00, 0x01, 0xba, 0xd1, 0x90, 0x01, 0x92, 0x49, 0x24, 0x92, 0x49, 0x25, 0x00, 0x60, 0x92, 0x49,
    0x24, 0x3f, 0xff, 0xff, 0xff, 0xff, 0xff, 0x30, 0x7f, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff,
    0xff, 0xfc, 0xef, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xc8, 0x4f, 0xff, 0xff,
    0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xfe, 0x42, 0x7f, 0xff, 0xff, 0xff, 0xff, 0xe0, 0x07, 0x7f,
    0x48, 0x2a, 0xbc, 0x90, 0xb2, 0x59, 0x00, 0x00, 0x01, 0xb1,
];

#[cfg(test)]
mod tests {
    use super::syntax::{IntraParams, PlaneHeader};
    use super::*;
    use crate::bap::{BAP_COUNT, Bap, BapFrame, StepTable};

    const INPUT: [[i32; 2]; 3] = [[-50_000, -30_000], [-50_640, -31_290], [-52_000, -31_290]];
    const OUTPUT: [[i32; 2]; 3] = [[-50_048, -29_952], [-50_688, -31_232], [-51_968, -31_232]];

    fn frame(values: [i32; 2]) -> BapFrame {
        [162, 168].map(|number| Bap::new(number).unwrap()).into_iter().zip(values).collect()
    }

    #[test]
    fn worked_example_both_ways() {
        let mut writer = PlaneWriter::new(StepTable::Standard);
        let codes = [[6, 1], [19, 23], [4, 4], [4, 4]].map(|[first, second]| {
            let mut codes = [0; BAP_COUNT];
            (codes[161], codes[167]) = (first, second);
            Some(codes)
        });
        let params = IntraParams { mask: frame(INPUT[0]).mask, ranges: codes, ..IntraParams::default() };
        let rate = FrameRate::nearest(25.0);
        let header = PlaneHeader { kind: PlaneKind::Intra, object_mask: 2, rate, ..PlaneHeader::default() };
        let levels = writer.intra_levels(&params, &frame(INPUT[0])).to_vec();
        assert_eq!(levels, [-391, -234]);
        writer.write_intra(&header, false, &params, &levels).unwrap();
        for (input, expected) in INPUT[1..].iter().zip([[-5, -10], [-10, 0]]) {
            let levels = writer.predicted_levels(&frame(*input)).to_vec();
            assert_eq!(levels, expected);
            writer.write_predicted(&header, false, &levels).unwrap();
        }
        assert_eq!(writer.finish(), EXAMPLE);

        let mut decoder = Decoder::new(DecoderOptions::default());
        decoder.push(&EXAMPLE).unwrap();
        let mut bits = Vec::new();
        for expected in OUTPUT {
            let decoded = decoder.next_frame().unwrap().unwrap();
            assert_eq!(decoded.baps, frame(expected));
            bits.push((decoded.first_bit, decoded.end_bit));
        }
        assert_eq!(bits, [(32, 544), (544, 567), (567, 590)]);
        assert_eq!(decoder.next_frame(), Ok(None));
        assert!(decoder.is_ended());
    }
}
