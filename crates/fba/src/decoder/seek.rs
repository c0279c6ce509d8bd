//! Where to go on: after damage, in the middle of a stream, and behind an end code.

use super::super::bits::{BitReader, NoTrace, Trace};
use super::super::error::SyntaxError;
use super::super::object::{Clock, ObjectState};
use super::super::syntax::{
    OBJECT_START, OLD_OBJECT_START, OLD_PLANE_START, PLANE_START, PlaneHeader, PlaneKind, SEQUENCE_END,
    SEQUENCE_START, USER_DATA, plane_header,
};
use super::codes::{Ahead, CODE_BITS, RecordEnd};
use super::{Decoder, READ_AHEAD, Stage};
use crate::bap::GROUPS;

/// Planes behind an I plane without start code that must read without a fault before it is believed. The 24
/// markers of its masks alone come about by chance once in 2^34 places, but a few bits beside a true one most of
/// them are met; each plane behind halves what is left of that five times.
const WITNESSES: usize = 6;

/// I planes that do not stand on their own and are passed over before one is believed all the same.
const PATIENCE: u32 = 3;

/// What the beginning of an I plane says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Peek {
    /// It is none.
    Unsound,
    /// It sends this many range arrays.
    Arrays(u32),
}

/// What an attempt to read an I plane came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Attempt {
    Believed,
    Refused,
    /// Too little data to tell.
    Unknown,
}

impl Decoder {
    /// Goes to the next I plane, or to an end code. False when more data are needed.
    pub(super) fn seek<T: Trace>(&mut self, trace: &mut T) -> bool {
        loop {
            let code = self.find_code();
            let end = code.map_or(self.searched, |at| at + 3) as u64 * 8;
            match self.scan(end) {
                Attempt::Believed => {
                    self.stage = Stage::Planes;
                    return true;
                }
                Attempt::Unknown => return false,
                Attempt::Refused => {}
            }
            let Some(at) = code else { return false };
            match self.at_code(at, trace) {
                Some(true) => return true,
                Some(false) => self.position = self.position.max(self.floor as u64 * 8),
                None => return false,
            }
        }
    }

    /// Looks at the start code at byte `at`: whether decoding goes on behind it, or `None` when more data are
    /// needed.
    fn at_code<T: Trace>(&mut self, at: usize, trace: &mut T) -> Option<bool> {
        let start = at as u64 * 8;
        let behind = start + CODE_BITS;
        let code = self.code_at(start)?;
        match code {
            SEQUENCE_END => {
                self.note_code(trace, code, behind);
                self.position = start;
                self.end();
                self.pass_code(behind);
                Some(true)
            }
            // An object start code may have a plane start code behind it: go on from there.
            OBJECT_START | OLD_OBJECT_START | PLANE_START | OLD_PLANE_START => {
                let object = matches!(code, OBJECT_START | OLD_OBJECT_START);
                let ahead = if object { self.look_ahead(behind) } else { Ahead::Plane };
                let mut intra = match ahead {
                    Ahead::Unknown => return None,
                    Ahead::Code(..) => false,
                    Ahead::Plane => *self.data.get(at + 4)? & 0x80 != 0,
                };
                if intra {
                    match self.peek_intra(behind) {
                        None if !self.finished => return None,
                        Some(Peek::Arrays(arrays)) if !self.stands_alone(arrays) => {
                            self.refuse(behind);
                            intra = false;
                        }
                        _ => {}
                    }
                }
                self.objects += u32::from(object && intra);
                if intra {
                    self.note_code(trace, code, behind);
                    self.stage = Stage::Planes;
                    self.foreign = false;
                }
                self.pass_code(behind);
                Some(intra)
            }
            USER_DATA => {
                match self.record_end(at + 4) {
                    RecordEnd::Unknown => return None,
                    RecordEnd::None => self.floor = at + 1,
                    RecordEnd::At(_) => {
                        self.pass_code(behind);
                        self.pass_record();
                    }
                }
                Some(false)
            }
            _ => {
                self.floor = at + 1;
                Some(false)
            }
        }
    }

    /// Tries an I plane at every bit from the position on, up to bit `end` of the data.
    fn scan(&mut self, end: u64) -> Attempt {
        if self.foreign {
            self.position = self.position.max(end);
        }
        while self.position < end {
            let mut attempt = match self.peek_intra(self.position) {
                Some(Peek::Arrays(_)) => self.attempt(self.position),
                Some(Peek::Unsound) => Attempt::Refused,
                None if self.finished => Attempt::Refused,
                None => Attempt::Unknown,
            };
            if let (Attempt::Believed, Some(Peek::Arrays(arrays))) = (attempt, self.peek_intra(self.position))
                && !self.stands_alone(arrays)
            {
                self.refuse(self.position);
                attempt = Attempt::Refused;
            }
            match attempt {
                Attempt::Refused => self.position += 1,
                Attempt::Unknown => return attempt,
                Attempt::Believed => {
                    self.position = self.likeliest_header(self.position);
                    return attempt;
                }
            }
        }
        Attempt::Refused
    }

    /// What the I plane of a body alone that may begin at `start` says before its ranges: the number of range arrays
    /// it sends, or that its masks are not sound; `None` when more data are needed.
    fn peek_intra(&self, start: u64) -> Option<Peek> {
        let mut at = start;
        let mut bit = || {
            let bit = self.data.get((at / 8) as usize).map(|byte| byte >> (7 - at % 8) & 1 == 1);
            at += 1;
            bit
        };
        if !(bit()? && bit()?) || bit()? {
            return Some(Peek::Unsound);
        }
        let mut reader = BitReader::with_trace(&self.data, start, 0, None, NoTrace);
        let limit = self.options.limits.skipped_frames;
        match plane_header(&mut reader, &PlaneHeader::default(), limit) {
            Ok(_) => {}
            Err(SyntaxError::UnexpectedEnd { .. }) => return None,
            Err(_) => return Some(Peek::Unsound),
        }
        let mut take = |width| reader.take(width).ok();
        take(5)?;
        let mut on = false;
        for members in GROUPS {
            if take(1)? == 0 {
                return Some(Peek::Unsound);
            }
            match take(2)? {
                0 => {}
                1 => {
                    for _ in 0..members.len() {
                        on |= take(1)? == 1;
                    }
                }
                3 => on = true,
                _ => return Some(Peek::Unsound),
            }
        }
        // Gender and coding type.
        take(2)?;
        let arrays = take(4)?.count_ones();
        Some(if on { Peek::Arrays(arrays) } else { Peek::Unsound })
    }

    /// Whether an I plane that sends so many range arrays stands on its own. What it does not send are those sent before,
    /// which may have been lost: a stream that has sent all of them twice does so again, and one that sends some is not
    /// believed unless nothing else comes.
    fn stands_alone(&self, arrays: u32) -> bool {
        match arrays {
            4 => true,
            0 => self.complete < 2 || self.refused >= PATIENCE,
            _ => self.refused >= PATIENCE,
        }
    }

    /// Passes over the I plane at `start`, and other headers that end where its does.
    fn refuse(&mut self, start: u64) {
        self.refused += 1;
        self.position = self.header_at(start).map_or(start, |(_, end)| end);
    }

    /// The plane header at `start`, and where it ends.
    fn header_at(&self, start: u64) -> Option<(PlaneHeader, u64)> {
        let mut reader = BitReader::with_trace(&self.data, start, 0, None, NoTrace);
        let limit = self.options.limits.skipped_frames;
        let header = plane_header(&mut reader, &PlaneHeader::default(), limit).ok()?;
        Some((header, reader.position()))
    }

    /// Where the header of the I plane that may begin at `start` does begin: other headers may end where this one does.
    /// One that says the rate in force is likeliest (or, where none is known, a whole one), then one without time code and
    /// skipped frames.
    fn likeliest_header(&self, start: u64) -> u64 {
        let Some((_, end)) = self.header_at(start) else { return start };
        let likely = |header: &PlaneHeader| {
            let known = (self.planes > 0).then(|| self.clock.rate());
            let rated = header.rate.is_some_and(|rate| match known {
                Some(known) => rate == known,
                None => rate.sixteenths == 0 && (5..=150).contains(&rate.whole),
            });
            (rated, header.time_code.is_none(), header.skipped == 0)
        };
        let starts = (start..end).filter_map(|at| {
            let (header, ends) = self.header_at(at)?;
            let sound = header.kind == PlaneKind::Intra && header.object_mask == 2 && ends == end;
            sound.then_some((likely(&header), at))
        });
        starts.max().map_or(start, |(_, at)| at)
    }

    /// Tries to read an I plane at `start`, and those behind it.
    fn attempt(&mut self, start: u64) -> Attempt {
        let (steps, ranges) = (self.options.steps, self.options.ranges);
        let mut object = self.trial.take().unwrap_or_else(|| Box::new(ObjectState::new(steps, ranges)));
        object.follow(&self.object);
        let attempt = self.attempt_with(&mut object, start);
        self.trial = Some(object);
        attempt
    }

    fn attempt_with(&self, object: &mut ObjectState, start: u64) -> Attempt {
        let mut position = start;
        let mut bodies = 0;
        while bodies <= WITNESSES {
            if bodies > 0 {
                match self.look_ahead(position) {
                    Ahead::Code(..) => return Attempt::Believed,
                    Ahead::Unknown => return self.at_end(),
                    Ahead::Plane => {}
                }
            }
            let mut reader = BitReader::with_trace(&self.data, position, self.dropped * 8, None, NoTrace);
            let read = match object.parse(&mut reader, self.options.limits.skipped_frames) {
                Ok(read) => read,
                Err(SyntaxError::UnexpectedEnd { .. }) if bodies > 0 || !self.finished => {
                    return self.at_end();
                }
                Err(_) => return Attempt::Refused,
            };
            let end = read.end - self.dropped * 8;
            if !self.finished && end + READ_AHEAD > self.bit_count() {
                return Attempt::Unknown;
            }
            if self.check_overrun(position, read.end).is_err() || object.commit(&read).is_err() {
                return Attempt::Refused;
            }
            bodies += usize::from(read.header.has_body());
            position = end;
        }
        Attempt::Believed
    }

    /// What is to be thought of planes that are sound as far as the data go.
    fn at_end(&self) -> Attempt {
        if self.finished { Attempt::Believed } else { Attempt::Unknown }
    }

    /// Behind an end code: begins the next stream if one follows.
    pub(super) fn next_object(&mut self) -> bool {
        let at = ((self.position / 8) as usize).min(self.data.len());
        let rest = self.data.len() - at;
        if rest < 4 && !self.finished {
            return false;
        }
        if let Some(OBJECT_START | OLD_OBJECT_START | SEQUENCE_START) = self.code_at(at as u64 * 8) {
            self.origin += self.clock.end();
            self.clock = Clock::new();
            self.object = ObjectState::new(self.options.steps, self.options.ranges);
            self.stage = Stage::Start;
            return true;
        }
        self.trailing += rest as u64;
        self.position = self.bit_count();
        false
    }
}
