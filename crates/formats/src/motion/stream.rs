//! FBA streams: ISO/IEC 14496-2 face and body animation, as [`handcast_codec`] writes them.
//!
//! The bits are in `spec/fba-bitstream.md`; a stream begins with a start code, `00 00 01`; or it is a
//! track of an MP4 file ([`crate::mp4`]). Base steps, range rule and
//! profile are those a stream has by default; who knows others decodes it by [`handcast_codec::decode_poses`].

use super::{BapTrack, ContentError, Format, Motion};
use crate::mp4::{starts_at, stream_in, unwrapped};
use handcast_codec::{decode_baps, hands_of_record, notices, skin_tone_of_record};
use handcast_fba::DecoderOptions;
use handcast_limits::Limits;

/// Its row.
pub(crate) static FORMAT: Format = Format {
    id: "fba",
    name: "FBA stream",
    kind: "stream",
    ending: ".fba",
    hands: 2,
    sniff: |bytes| bytes.starts_with(&[0, 0, 1]) || matches!(stream_in(bytes), Ok(Some(_)) | Err(_)),
    read: |bytes, limits| Ok(read(bytes, DecoderOptions::default(), limits)?.into()),
    // With its own options: see `handcast_codec`.
    write: None,
};

/// A stream that is decoded as `options` say.
pub(super) fn read(bytes: &[u8], options: DecoderOptions, limits: &Limits) -> Result<Motion, ContentError> {
    let decoded = decode_baps(&unwrapped(bytes)?, options, limits)?;
    let track = BapTrack { rate: decoded.rate, frames: decoded.frames };
    let mut motion = Motion::from_baps(&FORMAT, track, limits)?;
    let header = &mut motion.clip.header;
    for told in hands_of_record(&decoded.record) {
        header.hands.iter_mut().filter(|hand| hand.side == told.side).for_each(|hand| *hand = told.clone());
    }
    header.skin_tone = skin_tone_of_record(&decoded.record);
    motion.clip.shift(starts_at(bytes));
    motion.notes = notices::of_damage(&decoded.damage, "values are");
    motion.notes.extend(notices::of_stream(decoded.passed_over, decoded.streams, decoded.trailing));
    motion.notes.extend(notices::of_sizes(&decoded.resized, "the last ones"));
    Ok(motion)
}
