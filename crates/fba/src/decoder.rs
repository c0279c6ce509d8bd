//! A push-style decoder of FBA streams.

mod codes;
mod seek;

use codes::{Ahead, CODE_BITS};

use super::bits::{BitReader, Element, NoTrace, Trace};
use super::error::SyntaxError;
use super::object::{Clock, ObjectState, Plane};
use super::record::Record;
use super::syntax::{
    FrameRate, OBJECT_START, PLANE_START, PlaneHeader, PlaneKind, RangeRule, SEQUENCE_END, USER_DATA,
};
use super::writer::{FLUSH_BITS, PlaneBits};
use crate::bap::{BapFrame, BapMask, StepTable};

/// What a decoder may be made to hold or do by its input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DecoderLimits {
    /// Most bytes waiting to be decoded; a push beyond it is refused.
    pub buffered_bytes: usize,
    /// Most frames a plane header may skip.
    pub skipped_frames: u32,
}

impl Default for DecoderLimits {
    /// 16 MiB of waiting bytes; 65 535 skipped frames (half an hour at 30 frames/s).
    fn default() -> Self {
        Self { buffered_bytes: 16 << 20, skipped_frames: 65_535 }
    }
}

/// How to decode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DecoderOptions {
    /// Base steps the stream was made with; the stream does not say.
    pub steps: StepTable,
    /// How range codes become levels; the stream does not say that either.
    pub ranges: RangeRule,
    /// Bounds on memory and fields.
    pub limits: DecoderLimits,
    /// Deliver a held frame in place of each error after the first I plane; the error is then found
    /// in [`DecodedFrame::damage`].
    pub conceal: bool,
    /// Poses get only the angles that were sent. Otherwise those left to the decoder's model
    /// ([`crate::bap::derive`]) are filled in; frames of BAPs never are.
    pub sent_only: bool,
}

/// One decoded plane.
#[derive(Clone, Debug, PartialEq)]
pub struct DecodedFrame {
    /// Number of the plane in the stream, from 0.
    pub plane: u64,
    /// I or P plane.
    pub kind: PlaneKind,
    /// Time in seconds; the first plane is at 0 unless it has a time code.
    pub time: f64,
    /// Frames skipped after this plane: it stands for them, too.
    pub skipped: u32,
    /// Which parts the plane carries: bit 0 the face, bit 1 the body. Without a body part `baps` holds
    /// the values from before.
    pub object_mask: u8,
    /// Quantiser index in force.
    pub quant: u8,
    /// First bit of the plane header, counted from the start of the stream.
    pub first_bit: u64,
    /// One past the last bit of the plane.
    pub end_bit: u64,
    /// BAPs switched on, and the values of all BAPs.
    pub baps: BapFrame,
    /// Set on a frame that stands in for damaged data and repeats the last pose: what was wrong.
    pub damage: Option<SyntaxError>,
}

/// Where in the stream structure the decoder is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// Before the object start code.
    Start,
    /// Behind the start code of a user data block: looking for the next start code.
    UserData,
    /// Between planes.
    Planes,
    /// After damage, or in the middle of a stream: looking for an I plane.
    Seeking,
    /// Behind the end code, or past the end of the data.
    Ended,
}

/// Decodes a stream that arrives in pieces of any size.
///
/// Push bytes as they come, then call [`Decoder::next_frame`] until it gives `None`; at the end of the
/// data call [`Decoder::finish`] and drain once more. How the bytes are cut makes no difference to what
/// comes out. After an error the decoder looks for the next I plane, so calling [`Decoder::next_frame`]
/// again resumes there: at a start code with an I plane behind it, or without one where an I plane and some
/// planes behind it read without a fault. Data that begin in the middle of a stream give
/// [`SyntaxError::NoObject`] first, then the same.
///
/// A further stream right behind the end code goes on where the one before ended
/// ([`Decoder::objects`]); what else follows is counted ([`Decoder::trailing`]).
///
/// ```
/// use handcast_fba::decoder::{Decoder, DecoderOptions};
///
/// // The two joints of the worked example in `spec/fba-bitstream.md`: one I and two P planes.
/// let stream = handcast_fba::example_stream();
/// let mut decoder = Decoder::new(DecoderOptions::default());
/// let mut frames = Vec::new();
/// for piece in stream.chunks(10) {
///     decoder.push(piece)?;
///     while let Some(frame) = decoder.next_frame()? {
///         frames.push(frame);
///     }
/// }
/// decoder.finish();
/// while let Some(frame) = decoder.next_frame()? {
///     frames.push(frame);
/// }
/// assert_eq!(frames.len(), 3);
/// assert_eq!(frames[2].time, 0.08);
/// # Ok::<(), handcast_fba::error::SyntaxError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Decoder {
    options: DecoderOptions,
    object: ObjectState,
    clock: Clock,
    stage: Stage,
    data: Vec<u8>,
    /// Bytes of the stream already dropped from the front of `data`.
    dropped: u64,
    /// Next bit to read, within `data`.
    position: u64,
    /// Byte in `data` behind the last start code used; older ones are not looked at again.
    floor: usize,
    /// Start codes are searched from here on: `data` before holds none behind `floor`.
    searched: usize,
    finished: bool,
    /// Whether what was pushed last ends with a plane.
    whole: bool,
    planes: u64,
    damaged: u64,
    last_plane: Option<Plane>,
    /// First bit of the first plane, where the data began in the middle of a stream.
    joined: Option<u64>,
    /// Streams begun.
    objects: u32,
    /// Stream bit at which the damage begins behind which an I plane is sought.
    damage_bit: u64,
    /// As [`Decoder::abandoned`].
    abandoned: u64,
    /// Bytes behind an end code that begin no stream.
    trailing: u64,
    /// Seconds at which the stream that is being decoded began.
    origin: f64,
    /// Room to try an I plane and those behind it.
    trial: Option<Box<ObjectState>>,
    /// Whether a loss is still to be told.
    lost: bool,
    /// I planes that sent all range arrays.
    complete: u32,
    /// I planes passed over since the last damage because they build on others.
    refused: u32,
    /// Whether only start codes tell of planes: the data begin with a code of no FBA stream.
    foreign: bool,
    record: Record,
}

/// Consumed bytes are dropped once there are so many.
const COMPACT_BYTES: usize = 4096;
/// Bits behind a plane that must be there to decode it.
const READ_AHEAD: u64 = 14;

impl Decoder {
    /// A decoder at the start of a stream.
    pub fn new(options: DecoderOptions) -> Self {
        Self {
            options,
            object: ObjectState::new(options.steps, options.ranges),
            clock: Clock::new(),
            stage: Stage::Start,
            data: Vec::new(),
            dropped: 0,
            position: 0,
            floor: 0,
            searched: 0,
            finished: false,
            whole: false,
            planes: 0,
            damaged: 0,
            last_plane: None,
            joined: None,
            objects: 0,
            damage_bit: 0,
            abandoned: 0,
            trailing: 0,
            origin: 0.0,
            trial: None,
            lost: false,
            complete: 0,
            refused: 0,
            foreign: false,
            record: Record::default(),
        }
    }

    /// Takes the next bytes of the stream.
    ///
    /// # Errors
    /// [`SyntaxError::BufferLimit`] when frames are not fetched and too much waits; nothing is taken then.
    pub fn push(&mut self, bytes: &[u8]) -> Result<(), SyntaxError> {
        if self.stage == Stage::Ended && (self.finished || self.trailing > 0) {
            self.trailing += bytes.len() as u64;
            return Ok(());
        }
        self.whole = false;
        self.compact();
        let held = self.data.len().saturating_add(bytes.len());
        if held > self.options.limits.buffered_bytes {
            return Err(SyntaxError::BufferLimit { held, limit: self.options.limits.buffered_bytes });
        }
        self.data.extend_from_slice(bytes);
        Ok(())
    }

    /// Takes the next bytes, which end with a plane, as a transport that sends planes one by one knows: it is decoded
    /// without a look at what follows.
    ///
    /// # Errors
    /// As [`Decoder::push`].
    pub fn push_whole(&mut self, bytes: &[u8]) -> Result<(), SyntaxError> {
        self.push(bytes)?;
        self.whole = true;
        Ok(())
    }

    /// Says that no more bytes will come.
    pub fn finish(&mut self) {
        self.finished = true;
    }

    /// Whether the end code, or the end of the data, has been reached.
    pub fn is_ended(&self) -> bool {
        self.stage == Stage::Ended
    }

    /// Places where damage was found so far.
    pub fn damaged(&self) -> u64 {
        self.damaged
    }

    /// First bit of the first plane, where the data began in the middle of a stream.
    pub fn joined(&self) -> Option<u64> {
        self.joined
    }

    /// Streams begun so far: more than one where a further one follows an end code.
    pub fn objects(&self) -> u32 {
        self.objects
    }

    /// Bytes from damage that no I plane follows up to the end of its stream: what they told is lost.
    pub fn abandoned(&self) -> u64 {
        self.abandoned
    }

    /// Bytes behind an end code that begin no further stream.
    pub fn trailing(&self) -> u64 {
        self.trailing
    }

    /// Says that data were lost here, as a transport that numbers its packets knows: what comes next is no
    /// continuation of what came before. Bytes that have made no plane are dropped; the next frame is the error
    /// [`SyntaxError::Lost`], and decoding goes on at the next I plane.
    pub fn lose(&mut self) {
        if self.stage == Stage::Ended {
            return;
        }
        self.damage(self.bit_count());
        self.floor = self.data.len();
        self.searched = self.floor;
        self.lost = true;
    }

    /// Says that the frame delivered last is damaged, though its syntax is sound: decoding goes on at the next
    /// I plane behind it.
    pub fn distrust(&mut self) {
        if self.stage == Stage::Planes {
            self.damaged += 1;
            self.damage(self.position);
        }
    }

    /// The frame rate in force.
    pub fn rate(&self) -> FrameRate {
        self.clock.rate()
    }

    /// Numbers (3 to 68) and values of the low-level face parameters, if the stream has a face part. They
    /// are decoded to get past them; nothing here animates a face.
    pub fn face_values(&self) -> impl Iterator<Item = (usize, i32)> + '_ {
        self.object.face.values()
    }

    /// The record that came with the stream last; an empty one before any.
    pub fn record(&self) -> &Record {
        &self.record
    }

    /// BAPs switched on.
    pub fn mask(&self) -> BapMask {
        self.object.layout.mask()
    }

    /// The next frame, or `None` when more data are needed or the stream has ended
    /// ([`Decoder::is_ended`] tells which). Planes with object mask 0 are passed over.
    ///
    /// # Errors
    /// What is wrong with the stream; a later call resumes at the next I plane. Data
    /// that end without an end code give [`SyntaxError::UnexpectedEnd`], once, after all whole planes.
    pub fn next_frame(&mut self) -> Result<Option<DecodedFrame>, SyntaxError> {
        loop {
            match self.next_plane(&mut NoTrace)? {
                Some(frame) if frame.object_mask == 0 => {}
                other => return Ok(other),
            }
        }
    }

    /// Like [`Decoder::next_frame`], but with planes of object mask 0 as well, and telling `trace` every
    /// syntax element of each plane. Elements of a plane that is tried again when more data have come
    /// are told again.
    pub(super) fn next_plane<T: Trace>(
        &mut self,
        trace: &mut T,
    ) -> Result<Option<DecodedFrame>, SyntaxError> {
        let result = self.advance(trace);
        let Err(error) = result else { return result };
        self.damaged += 1;
        if self.options.conceal && self.planes > 0 && self.stage != Stage::Ended {
            return Ok(Some(self.held_frame(error)));
        }
        Err(error)
    }

    /// Where the bits of the plane delivered last went, when the one before ended at bit `last_end`.
    pub(super) fn plane_bits(&self, last_end: u64) -> PlaneBits {
        let Some(plane) = &self.last_plane else { return PlaneBits::default() };
        let mut bits = PlaneBits {
            start_codes: plane.start.saturating_sub(last_end),
            headers: plane.body - plane.start,
            ..PlaneBits::default()
        };
        if !plane.header.has_body() {
            return bits;
        }
        bits.flush = FLUSH_BITS;
        if plane.header.kind == PlaneKind::Intra {
            bits.masks = plane.marks.masks - plane.body;
            bits.ranges = plane.marks.ranges - plane.marks.masks;
            bits.intra_values = plane.end - plane.marks.ranges - FLUSH_BITS;
        } else {
            bits.predicted_values = plane.end - plane.body - FLUSH_BITS;
        }
        bits
    }

    /// Which range arrays the plane delivered last sent.
    pub(super) fn new_ranges(&self) -> [bool; 4] {
        let intra = self
            .last_plane
            .is_some_and(|plane| plane.header.kind == PlaneKind::Intra && plane.header.has_body());
        self.object.params.ranges.each_ref().map(|codes| intra && codes.is_some())
    }

    fn advance<T: Trace>(&mut self, trace: &mut T) -> Result<Option<DecodedFrame>, SyntaxError> {
        if std::mem::take(&mut self.lost) {
            return Err(SyntaxError::Lost { bit: self.stream_bit(self.position) });
        }
        loop {
            match self.stage {
                Stage::Ended => {
                    if !self.next_object() {
                        return Ok(None);
                    }
                }
                Stage::Start => {
                    if !self.start(trace)? {
                        return self.wait();
                    }
                }
                Stage::UserData => match self.find_code() {
                    Some(at) => {
                        self.keep_record(self.floor..at);
                        self.position = at as u64 * 8;
                        self.stage = Stage::Start;
                    }
                    None => return self.wait(),
                },
                Stage::Seeking => {
                    if !self.seek(trace) {
                        return self.wait();
                    }
                }
                Stage::Planes => {
                    let start = match self.look_ahead(self.position) {
                        Ahead::Unknown if !self.finished && !self.whole => return Ok(None),
                        // The data end in what may be the beginning of a start code, or a plane.
                        Ahead::Unknown => match self.parse_tail(self.position, &mut NoTrace) {
                            Some(_) => self.position,
                            None => return self.wait(),
                        },
                        Ahead::Plane => self.position,
                        Ahead::Code(code, behind) => {
                            self.note_code(trace, code, behind);
                            self.pass_code(behind);
                            match code {
                                SEQUENCE_END => {
                                    self.stage = Stage::Ended;
                                    continue;
                                }
                                USER_DATA => {
                                    self.pass_record();
                                    continue;
                                }
                                _ => continue,
                            }
                        }
                    };
                    match self.plane(start, trace) {
                        Ok(Some(frame)) => return Ok(Some(frame)),
                        Ok(None) => return self.wait(),
                        Err(error) => {
                            self.damage(start);
                            return Err(error);
                        }
                    }
                }
            }
        }
    }

    /// Nothing more to be had from the data so far.
    fn wait(&mut self) -> Result<Option<DecodedFrame>, SyntaxError> {
        if !self.finished {
            return Ok(None);
        }
        self.position = self.bit_count();
        self.end();
        Err(SyntaxError::UnexpectedEnd { bit: self.stream_bit(self.data.len() as u64 * 8) })
    }

    /// The stream ends at the position.
    pub(super) fn end(&mut self) {
        // Before the first plane nothing is damaged, but a stream joined late.
        if self.stage == Stage::Seeking && self.planes > 0 {
            self.abandoned += self.stream_bit(self.position).saturating_sub(self.damage_bit).div_ceil(8);
        }
        self.stage = Stage::Ended;
    }

    /// Decodes the plane at `start`; `None` when more data are needed.
    fn plane<T: Trace>(&mut self, start: u64, trace: &mut T) -> Result<Option<DecodedFrame>, SyntaxError> {
        let plane = match self.parse(start, None, trace) {
            Err(SyntaxError::UnexpectedEnd { .. }) if self.finished || self.whole => {
                match self.parse_tail(start, trace) {
                    Some(plane) => plane,
                    None => return Ok(None),
                }
            }
            Err(SyntaxError::UnexpectedEnd { .. }) => return Ok(None),
            other => other?,
        };
        // An empty plane reads nothing ahead; whether a start code lies over it shows only with what follows.
        let ends = self.finished || self.whole;
        if !ends && plane.end - self.dropped * 8 + READ_AHEAD > self.bit_count() {
            return Ok(None);
        }
        self.check_overrun(start, plane.end)?;
        self.object.commit(&plane)?;
        let time = self.origin + self.clock.advance(&plane.header);
        if self.planes == 0 && self.damaged > 0 {
            self.joined = Some(plane.start);
            // It counts, though its start code has not been seen.
            self.objects = self.objects.max(1);
        }
        if plane.header.kind == PlaneKind::Intra && plane.header.has_body() {
            self.complete += u32::from(self.object.params.ranges.iter().all(Option::is_some));
            self.refused = 0;
        }
        self.position = plane.end - self.dropped * 8;
        self.last_plane = Some(plane);
        Ok(Some(self.frame(&plane, time)))
    }

    fn parse<T: Trace>(
        &mut self,
        start: u64,
        padding: Option<bool>,
        trace: &mut T,
    ) -> Result<Plane, SyntaxError> {
        let base = self.dropped * 8;
        let mut reader = BitReader::with_trace(&self.data, start, base, padding, Forward(trace));
        self.object.parse(&mut reader, self.options.limits.skipped_frames)
    }

    /// Decodes the last plane of data without an end code, whose read-ahead reaches beyond the end. It
    /// is whole if it ends within the data and comes out the same whatever might have followed; both
    /// extremes of that are tried.
    fn parse_tail<T: Trace>(&mut self, start: u64, trace: &mut T) -> Option<Plane> {
        let end = self.stream_bit(self.bit_count());
        let ones = self.parse(start, Some(true), &mut NoTrace).ok()?;
        let levels = self.object.levels.clone();
        let zeros = self.parse(start, Some(false), trace).ok()?;
        (ones == zeros && zeros.end <= end && levels == self.object.levels).then_some(zeros)
    }

    /// Fails if a start code lies over the plane from `start` to stream position `end`. Only codes within
    /// the bits read for the plane are seen, so that the answer does not depend on what has arrived.
    fn check_overrun(&self, start: u64, end: u64) -> Result<(), SyntaxError> {
        let end = end - self.dropped * 8;
        let from = ((start / 8) as usize).saturating_sub(3).max(self.floor);
        let last = end.div_ceil(8).min((end + READ_AHEAD).saturating_sub(CODE_BITS) / 8 + 1);
        for at in from..last as usize {
            let code = at as u64 * 8;
            if code < end
                && code + CODE_BITS <= end + READ_AHEAD
                && matches!(self.code_at(code), Some(OBJECT_START | PLANE_START | SEQUENCE_END))
            {
                let [bit, code] = [start, code].map(|position| self.stream_bit(position));
                return Err(SyntaxError::Overrun { bit, code });
            }
        }
        Ok(())
    }

    fn frame(&mut self, plane: &Plane, time: f64) -> DecodedFrame {
        let number = self.planes;
        self.planes += 1;
        DecodedFrame {
            plane: number,
            kind: plane.header.kind,
            time,
            skipped: plane.header.skipped,
            object_mask: plane.header.object_mask,
            quant: self.object.layout.quant(),
            first_bit: plane.start,
            end_bit: plane.end,
            baps: BapFrame::with_values(self.object.layout.mask(), self.object.values),
            damage: None,
        }
    }

    fn held_frame(&mut self, error: SyntaxError) -> DecodedFrame {
        let bit = self.stream_bit(self.position);
        let marks = super::syntax::IntraMarks::default();
        let header = PlaneHeader { object_mask: 2, ..PlaneHeader::default() };
        let time = self.origin + self.clock.hold();
        let plane = Plane { header, start: bit, body: bit, marks, end: bit };
        DecodedFrame { damage: Some(error), ..self.frame(&plane, time) }
    }

    /// Gives up the plane at `start` and everything up to the next I plane.
    fn damage(&mut self, start: u64) {
        if self.stage != Stage::Seeking {
            self.damage_bit = self.stream_bit(start);
        }
        self.stage = Stage::Seeking;
        self.refused = 0;
        self.object.lose();
        self.clock.lose();
        // A start code may begin up to three bytes before the damaged plane, if the plane before ran
        // into it unnoticed.
        self.floor = self.floor.max(((start / 8) as usize).saturating_sub(3));
        self.searched = self.floor;
        self.position = start;
    }

    fn bit_count(&self) -> u64 {
        self.data.len() as u64 * 8
    }

    fn stream_bit(&self, position: u64) -> u64 {
        self.dropped * 8 + position
    }

    /// Drops bytes that will not be looked at again.
    fn compact(&mut self) {
        let keep = match self.stage {
            Stage::Seeking => self.searched.max(self.floor).min((self.position / 8) as usize),
            Stage::UserData => self.searched.max(self.floor),
            _ => (self.position / 8) as usize,
        };
        let drop = keep.saturating_sub(3).min(self.data.len());
        if drop < COMPACT_BYTES {
            return;
        }
        self.data.drain(..drop);
        self.dropped += drop as u64;
        self.position = self.position.saturating_sub(drop as u64 * 8);
        self.floor = self.floor.saturating_sub(drop);
        self.searched = self.searched.saturating_sub(drop);
    }
}

/// Hands elements on to a trace that is borrowed.
struct Forward<'a, T>(&'a mut T);

impl<T: Trace> Trace for Forward<'_, T> {
    fn element(&mut self, element: Element) {
        self.0.element(element);
    }
}
