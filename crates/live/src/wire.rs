//! The messages of a room: planes of a stream with when they were captured, and what is said around them.
//!
//! Their bytes are in `spec/live.md`. A datagram, WebSocket message or frame of a transport carries one message, or a few
//! behind one another ([`decode_all`]). Each message can be read for itself, but for the short form of a plane, which goes
//! on from the plane before it: [`Shortener`] writes it, [`Expander`] reads it.
//!
//! ```
//! use handcast_live::wire::{Expander, Message, Plane, Shortener};
//!
//! let first = Plane { sender: 1, period: 7, time_ms: 1000, payload: vec![1, 2, 3], ..Plane::default() };
//! let next = Plane { index: 1, time_ms: 1033, ..first.clone() };
//! let (mut shortener, mut expander) = (Shortener::default(), Expander::default());
//! for plane in [first, next] {
//!     let mut bytes = Vec::new();
//!     shortener.write(&plane, &mut bytes);
//!     let read = expander.read_all(&bytes)?;
//!     assert_eq!(read, [Message::Plane(plane)]);
//! }
//! # Ok::<(), handcast_live::wire::WireError>(())
//! ```

use thiserror::Error;

/// Version of the messages.
pub const VERSION: u8 = 3;
/// Most bytes of a plane.
pub const MAX_PAYLOAD: usize = 8192;
/// Most bytes of a person's record.
pub const MAX_RECORD: usize = 64;
/// Most senders in a room, numbered from 0.
pub const MAX_SENDERS: u8 = 16;
/// Most messages in one message of the transport.
pub const MAX_TOGETHER: usize = 8;
/// Most bytes of one message of the transport.
pub const MAX_BYTES: usize = 2 * (MAX_PAYLOAD + 16);

/// One plane of a sender's stream.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Plane {
    /// Number of the sender in the room, below [`MAX_SENDERS`].
    pub sender: u8,
    /// Number of the period, counted on modulo 2^16. Each opens with an I plane.
    pub period: u16,
    /// Number of the plane in its period; 0 is the I plane.
    pub index: u16,
    /// When its picture was captured, milliseconds of the room's clock modulo 2^32.
    pub time_ms: u32,
    /// Sent again for one who came late: to be decoded, not to be shown.
    pub replay: bool,
    /// Hands whose pose is held because the tracker does not see them, left and right.
    pub lost: [bool; 2],
    /// Whole bytes of the stream: an I plane with the start code and the record before it, or a P plane.
    pub payload: Vec<u8>,
}

impl Plane {
    /// Whether a decoder can start here.
    pub fn opens(&self) -> bool {
        self.index == 0
    }
}

/// Why a sender sends no more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parting {
    /// It said so.
    Left,
    /// Its connection broke, or nothing came for too long.
    Gone,
}

/// Why a room takes no planes from one who said hello.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// Nobody but the room's own machine sends.
    Closed,
    /// It has [`MAX_SENDERS`].
    Full,
}

/// What is said in a room.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Message {
    /// A plane.
    Plane(Plane),
    /// A sender is there, or has changed. To the room's server it asks for a number; then `sender` is ignored.
    Hello {
        /// Number of the sender.
        sender: u8,
        /// Its hands, left and right.
        hands: [bool; 2],
        /// The person's record as the stream carries it, [`MAX_RECORD`] bytes at most; empty where sizes are not known.
        record: Vec<u8>,
    },
    /// The room has given the one who asked this number.
    Welcome {
        /// Number of the sender.
        sender: u8,
    },
    /// A sender sends no more.
    End {
        /// Number of the sender.
        sender: u8,
        /// Why.
        parting: Parting,
    },
    /// An I plane is wanted of a sender.
    Intra {
        /// Number of the sender.
        sender: u8,
    },
    /// Asks for a [`Self::Pong`].
    Ping {
        /// What the answer repeats.
        mark: u64,
    },
    /// Answers a ping.
    Pong {
        /// What was asked with.
        mark: u64,
        /// The room's clock when it was answered, microseconds since 1970.
        clock_us: u64,
    },
    /// The room does not take the one who said hello for a sender; what it sends is passed over.
    Refused {
        /// Why.
        refusal: Refusal,
    },
}

/// Why bytes are no message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum WireError {
    /// A message ends too early.
    #[error("live message: ends after {length} bytes")]
    Short {
        /// Bytes there are.
        length: usize,
    },
    /// Another version.
    #[error("live message: version {version}, expected {VERSION}")]
    Version {
        /// What it says.
        version: u8,
    },
    /// A kind that there is not.
    #[error("live message: kind {kind}, expected 0 to 7")]
    Kind {
        /// What it says.
        kind: u8,
    },
    /// A field outside its range.
    #[error("live message: {what} {value}, allowed are {allowed}")]
    Field {
        /// Which.
        what: &'static str,
        /// What it says.
        value: u64,
        /// What it may be.
        allowed: &'static str,
    },
    /// A short plane that does not go on from the one before it.
    #[error("live message: a short plane of sender {sender} does not go on from the plane before it")]
    Discontinued {
        /// Number of the sender.
        sender: u8,
    },
    /// A plane that follows another in a message in which there is none before it.
    #[error("live message: a plane that follows another has none before it")]
    Alone,
    /// Too many messages in one.
    #[error("live message: more than {MAX_TOGETHER} together")]
    Together,
}

/// First byte of a short plane, and that its payload reaches to the end of the transport's message.
const SHORT: u8 = 0x80;
const TO_THE_END: u8 = 0x40;
/// Milliseconds since the plane before that four bits tell, from this on: pictures at 25 and 30 a second.
const COMMON: u8 = 28;
/// Four bits for another time, which a byte of its own tells.
const OWN_TIME: u8 = 15;
/// The upper two bits of a plane that follows the one before it in the transport's message, and that its payload reaches to
/// the end.
const NEXT: u8 = 0x40;
const NEXT_MASK: u8 = 0xc0;
const NEXT_TO_THE_END: u8 = 0x20;
/// Milliseconds since the plane before that five bits tell, from this on: pictures at 20 to 50 a second.
const NEXT_COMMON: u8 = 20;
/// Five bits for another time, which a byte of its own tells.
const NEXT_OWN_TIME: u8 = 31;

const PLANE: u8 = 0;
const HELLO: u8 = 1;
const WELCOME: u8 = 2;
const END: u8 = 3;
const INTRA: u8 = 4;
const PING: u8 = 5;
const PONG: u8 = 6;
const REFUSED: u8 = 7;

const REPLAY: u8 = 1;
const LOST: [u8; 2] = [2, 4];
const FLAGS: u8 = 7;

impl Message {
    /// The sender it is about.
    pub fn sender(&self) -> Option<u8> {
        match self {
            Self::Plane(plane) => Some(plane.sender),
            Self::Hello { sender, .. }
            | Self::Welcome { sender }
            | Self::End { sender, .. }
            | Self::Intra { sender } => Some(*sender),
            Self::Ping { .. } | Self::Pong { .. } | Self::Refused { .. } => None,
        }
    }

    /// What it is, for people.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Plane(_) => "plane",
            Self::Hello { .. } => "hello",
            Self::Welcome { .. } => "welcome",
            Self::End { .. } => "end",
            Self::Intra { .. } => "wish for an I plane",
            Self::Ping { .. } => "ping",
            Self::Pong { .. } => "pong",
            Self::Refused { .. } => "refusal",
        }
    }

    /// Puts its bytes at the end of `out`. What is longer than allowed is cut.
    pub fn write(&self, out: &mut Vec<u8>) {
        let head = |kind: u8| VERSION << 4 | kind;
        match self {
            Self::Plane(plane) => write_plane(plane, out),
            Self::Hello { sender, hands, record } => {
                let record = record.get(..MAX_RECORD).unwrap_or(record);
                let hands = u8::from(hands[0]) | u8::from(hands[1]) << 1;
                out.extend([head(HELLO), *sender, hands, record.len() as u8]);
                out.extend(record);
            }
            Self::Welcome { sender } => out.extend([head(WELCOME), *sender]),
            Self::End { sender, parting } => {
                out.extend([head(END), *sender, u8::from(*parting == Parting::Gone)]);
            }
            Self::Intra { sender } => out.extend([head(INTRA), *sender]),
            Self::Ping { mark } => {
                out.push(head(PING));
                out.extend(mark.to_be_bytes());
            }
            Self::Pong { mark, clock_us } => {
                out.push(head(PONG));
                out.extend(mark.to_be_bytes());
                out.extend(clock_us.to_be_bytes());
            }
            Self::Refused { refusal } => out.extend([head(REFUSED), u8::from(*refusal == Refusal::Full)]),
        }
    }

    /// Its bytes.
    pub fn bytes(&self) -> Vec<u8> {
        let mut out = Vec::new();
        self.write(&mut out);
        out
    }
}

fn write_plane(plane: &Plane, out: &mut Vec<u8>) {
    let payload = plane.payload.get(..MAX_PAYLOAD).unwrap_or(&plane.payload);
    let lost = |hand: usize| if plane.lost[hand] { LOST[hand] } else { 0 };
    let flags = if plane.replay { REPLAY } else { 0 } | lost(0) | lost(1);
    out.extend([VERSION << 4 | PLANE, plane.sender, flags]);
    out.extend(plane.period.to_be_bytes());
    out.extend(plane.index.to_be_bytes());
    out.extend(plane.time_ms.to_be_bytes());
    write_length(payload.len(), out);
    out.extend(payload);
}

/// A length in seven bits a byte, low ones first, the top bit set where more come.
fn write_length(mut length: usize, out: &mut Vec<u8>) {
    while length >= 0x80 {
        out.push(length as u8 | 0x80);
        length >>= 7;
    }
    out.push(length as u8);
}

/// Bytes that are read.
struct Reader<'a> {
    rest: &'a [u8],
    length: usize,
}

impl<'a> Reader<'a> {
    fn array<const N: usize>(&mut self) -> Result<[u8; N], WireError> {
        let (array, rest) =
            self.rest.split_first_chunk::<N>().ok_or(WireError::Short { length: self.length })?;
        self.rest = rest;
        Ok(*array)
    }

    fn byte(&mut self) -> Result<u8, WireError> {
        self.array::<1>().map(|[byte]| byte)
    }

    fn sender(&mut self) -> Result<u8, WireError> {
        let sender = self.byte()?;
        if sender < MAX_SENDERS { Ok(sender) } else { Err(refused("sender", sender, "0 to 15")) }
    }

    fn bytes(&mut self, length: usize) -> Result<&'a [u8], WireError> {
        let (bytes, rest) =
            self.rest.split_at_checked(length).ok_or(WireError::Short { length: self.length })?;
        self.rest = rest;
        Ok(bytes)
    }

    fn payload(&mut self) -> Result<Vec<u8>, WireError> {
        let mut length = 0;
        for shift in [0, 7, 14] {
            let byte = self.byte()?;
            length |= usize::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                break;
            }
        }
        if length > MAX_PAYLOAD {
            return Err(refused("length of a plane", length as u64, "0 to 8192"));
        }
        self.bytes(length).map(<[u8]>::to_vec)
    }

    /// A payload that reaches to the end.
    fn rest_of_payload(&mut self) -> Result<Vec<u8>, WireError> {
        if self.rest.len() > MAX_PAYLOAD {
            return Err(refused("length of a plane", self.rest.len() as u64, "0 to 8192"));
        }
        Ok(std::mem::take(&mut self.rest).to_vec())
    }
}

fn refused(what: &'static str, value: impl Into<u64>, allowed: &'static str) -> WireError {
    WireError::Field { what, value: value.into(), allowed }
}

/// Reads the message that is at the beginning of `bytes`, which is no short or following plane; gives what is behind it as well.
///
/// # Errors
/// See [`WireError`].
pub fn decode(bytes: &[u8]) -> Result<(Message, &[u8]), WireError> {
    let mut r = Reader { rest: bytes, length: bytes.len() };
    let first = r.byte()?;
    if first & SHORT != 0 {
        return Err(WireError::Discontinued { sender: first & 0x0f });
    }
    if first & NEXT_MASK == NEXT {
        return Err(WireError::Alone);
    }
    if first >> 4 != VERSION {
        return Err(WireError::Version { version: first >> 4 });
    }
    let message = match first & 0x0f {
        PLANE => Message::Plane(read_plane(&mut r)?),
        HELLO => {
            let (sender, hands, length) = (r.sender()?, r.byte()?, r.byte()?);
            if hands > 3 {
                return Err(refused("hands", hands, "0 to 3"));
            }
            if usize::from(length) > MAX_RECORD {
                return Err(refused("length of a record", length, "0 to 64"));
            }
            let record = r.bytes(length.into())?.to_vec();
            Message::Hello { sender, hands: [hands & 1 != 0, hands & 2 != 0], record }
        }
        WELCOME => Message::Welcome { sender: r.sender()? },
        END => {
            let (sender, parting) = (r.sender()?, r.byte()?);
            let parting = match parting {
                0 => Parting::Left,
                1 => Parting::Gone,
                _ => return Err(refused("parting", parting, "0 and 1")),
            };
            Message::End { sender, parting }
        }
        INTRA => Message::Intra { sender: r.sender()? },
        PING => Message::Ping { mark: u64::from_be_bytes(r.array()?) },
        PONG => {
            Message::Pong { mark: u64::from_be_bytes(r.array()?), clock_us: u64::from_be_bytes(r.array()?) }
        }
        REFUSED => Message::Refused {
            refusal: match r.byte()? {
                0 => Refusal::Closed,
                1 => Refusal::Full,
                why => return Err(refused("refusal", why, "0 and 1")),
            },
        },
        kind => return Err(WireError::Kind { kind }),
    };
    Ok((message, r.rest))
}

fn read_plane(r: &mut Reader<'_>) -> Result<Plane, WireError> {
    let (sender, flags) = (r.sender()?, r.byte()?);
    if flags & !FLAGS != 0 {
        return Err(refused("flags", flags, "0 to 7"));
    }
    Ok(Plane {
        sender,
        period: u16::from_be_bytes(r.array()?),
        index: u16::from_be_bytes(r.array()?),
        time_ms: u32::from_be_bytes(r.array()?),
        replay: flags & REPLAY != 0,
        lost: LOST.map(|lost| flags & lost != 0),
        payload: r.payload()?,
    })
}

/// Reads all messages of one message of the transport, without short planes.
///
/// # Errors
/// See [`WireError`].
pub fn decode_all(bytes: &[u8]) -> Result<Vec<Message>, WireError> {
    Expander::default().read_all(bytes)
}

/// What a short plane goes on from.
#[derive(Clone, Copy, Debug)]
struct Before {
    period: u16,
    index: u16,
    time_ms: u32,
    replay: bool,
    lost: [bool; 2],
}

impl Before {
    fn of(plane: &Plane) -> Self {
        let Plane { period, index, time_ms, replay, lost, .. } = *plane;
        Self { period, index, time_ms, replay, lost }
    }
}

/// Most bytes of a plane beside its payload.
#[cfg(any(feature = "server", test))]
const MAX_HEAD: usize = 16;

/// Planes in groups that each fit into a message of the transport: [`MAX_TOGETHER`] planes, [`MAX_BYTES`] bytes.
#[cfg(any(feature = "server", test))]
pub(crate) fn in_messages(planes: &[Plane]) -> impl Iterator<Item = &[Plane]> {
    let mut rest = planes;
    std::iter::from_fn(move || {
        let mut bytes = 0;
        let fits = |plane: &&Plane| {
            bytes += plane.payload.len().min(MAX_PAYLOAD) + MAX_HEAD;
            bytes <= MAX_BYTES
        };
        let count = rest.iter().take(MAX_TOGETHER).take_while(fits).count();
        let group = rest.split_off(..count)?;
        (!group.is_empty()).then_some(group)
    })
}

/// Writes the planes of one connection, short where they go on from the one before, shorter still behind that in a message.
#[derive(Clone, Debug, Default)]
pub struct Shortener {
    before: [Option<Before>; MAX_SENDERS as usize],
}

impl Shortener {
    /// Puts the bytes of a plane at the end of `out`; behind it others may follow.
    pub fn write(&mut self, plane: &Plane, out: &mut Vec<u8>) {
        self.put(plane, false, false, out);
    }

    /// Puts the bytes of planes at the end of `out`, with which a message of the transport ends.
    pub fn write_together(&mut self, planes: &[Plane], out: &mut Vec<u8>) {
        let mut before = None;
        for (n, plane) in planes.iter().enumerate() {
            self.put(plane, before == Some(plane.sender), n + 1 == planes.len(), out);
            before = Some(plane.sender);
        }
    }

    /// `beside`: right behind a plane of the same sender in a message; `last`: with which the message ends.
    fn put(&mut self, plane: &Plane, beside: bool, last: bool, out: &mut Vec<u8>) {
        let before = self.before.get_mut(usize::from(plane.sender));
        match before.as_deref().copied().flatten().and_then(|before| passed_since(&before, plane)) {
            Some(passed) => write_short(plane, passed, beside, last, out),
            None => write_plane(plane, out),
        }
        if let Some(before) = before {
            *before = Some(Before::of(plane));
        }
    }
}

/// Milliseconds since the plane before, where a plane goes on from it and can be short.
fn passed_since(before: &Before, plane: &Plane) -> Option<u8> {
    let same = (before.period, before.replay, before.lost) == (plane.period, plane.replay, plane.lost);
    let next = same && !plane.opens() && before.index.checked_add(1) == Some(plane.index);
    let passed = u8::try_from(plane.time_ms.wrapping_sub(before.time_ms)).ok()?;
    next.then_some(passed)
}

fn write_short(plane: &Plane, passed: u8, beside: bool, last: bool, out: &mut Vec<u8>) {
    let payload = plane.payload.get(..MAX_PAYLOAD).unwrap_or(&plane.payload);
    let (from, own) = if beside { (NEXT_COMMON, NEXT_OWN_TIME) } else { (COMMON, OWN_TIME) };
    let common = passed.checked_sub(from).filter(|&time| time < own);
    let time = common.unwrap_or(own);
    if beside {
        out.push(NEXT | if last { NEXT_TO_THE_END } else { 0 } | time);
    } else {
        let to_the_end = if last { TO_THE_END } else { 0 };
        out.push(SHORT | to_the_end | (plane.period as u8 & 3) << 4 | plane.sender & 0x0f);
        out.push((plane.index as u8 & 0x0f) << 4 | time);
    }
    if common.is_none() {
        out.push(passed);
    }
    if !last {
        write_length(payload.len(), out);
    }
    out.extend(payload);
}

/// Reads the messages of one connection, short planes among them.
#[derive(Clone, Debug, Default)]
pub struct Expander {
    before: [Option<Before>; MAX_SENDERS as usize],
}

impl Expander {
    /// All messages of one message of the transport.
    ///
    /// # Errors
    /// See [`WireError`]. After [`WireError::Discontinued`] the planes of that sender can be read again from its next
    /// long one on.
    pub fn read_all(&mut self, bytes: &[u8]) -> Result<Vec<Message>, WireError> {
        let mut messages: Vec<Message> = Vec::new();
        let mut rest = bytes;
        loop {
            if messages.len() == MAX_TOGETHER {
                return Err(WireError::Together);
            }
            let beside = match messages.last() {
                Some(Message::Plane(plane)) => Some(plane.sender),
                _ => None,
            };
            let (message, behind) = self.read(rest, beside)?;
            messages.push(message);
            if behind.is_empty() {
                return Ok(messages);
            }
            rest = behind;
        }
    }

    /// The message at the beginning of `bytes`, right behind a plane of the sender `beside`, and what is behind it.
    fn read<'a>(&mut self, bytes: &'a [u8], beside: Option<u8>) -> Result<(Message, &'a [u8]), WireError> {
        let mut r = Reader { rest: bytes, length: bytes.len() };
        let (message, rest) = match bytes.first() {
            Some(first) if first & SHORT != 0 => (Message::Plane(self.read_short(&mut r)?), r.rest),
            Some(first) if first & NEXT_MASK == NEXT => {
                let sender = beside.ok_or(WireError::Alone)?;
                (Message::Plane(self.read_next(sender, &mut r)?), r.rest)
            }
            _ => decode(bytes)?,
        };
        if let Message::Plane(plane) = &message
            && let Some(before) = self.before.get_mut(usize::from(plane.sender))
        {
            *before = Some(Before::of(plane));
        }
        Ok((message, rest))
    }

    fn read_short(&mut self, r: &mut Reader<'_>) -> Result<Plane, WireError> {
        let [first, second] = r.array()?;
        let passed = match second & 0x0f {
            OWN_TIME => r.byte()?,
            time => COMMON + time,
        };
        let payload = if first & TO_THE_END == 0 { r.payload()? } else { r.rest_of_payload()? };
        let sender = first & 0x0f;
        let plane = self.behind(sender, passed, payload)?;
        if (plane.period as u8 & 3, plane.index as u8 & 0x0f) != (first >> 4 & 3, second >> 4) {
            return Err(WireError::Discontinued { sender });
        }
        Ok(plane)
    }

    fn read_next(&mut self, sender: u8, r: &mut Reader<'_>) -> Result<Plane, WireError> {
        let first = r.byte()?;
        let passed = match first & 0x1f {
            NEXT_OWN_TIME => r.byte()?,
            time => NEXT_COMMON + time,
        };
        let payload = if first & NEXT_TO_THE_END == 0 { r.payload()? } else { r.rest_of_payload()? };
        self.behind(sender, passed, payload)
    }

    /// The plane that goes on from the last one of its sender, which is forgotten.
    fn behind(&mut self, sender: u8, passed: u8, payload: Vec<u8>) -> Result<Plane, WireError> {
        let before = self.before.get_mut(usize::from(sender)).and_then(Option::take);
        let discontinued = WireError::Discontinued { sender };
        let Before { period, index, time_ms, replay, lost } = before.ok_or(discontinued)?;
        let index = index.checked_add(1).ok_or(discontinued)?;
        let time_ms = time_ms.wrapping_add(passed.into());
        Ok(Plane { sender, period, index, time_ms, replay, lost, payload })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn payload() -> impl Strategy<Value = Vec<u8>> {
        prop_oneof![prop::collection::vec(any::<u8>(), 0..300), Just(vec![7; MAX_PAYLOAD])]
    }

    fn plane() -> impl Strategy<Value = Plane> {
        (
            0..MAX_SENDERS,
            any::<u16>(),
            any::<u16>(),
            any::<u32>(),
            any::<bool>(),
            any::<[bool; 2]>(),
            payload(),
        )
            .prop_map(|(sender, period, index, time_ms, replay, lost, payload)| Plane {
                sender,
                period,
                index,
                time_ms,
                replay,
                lost,
                payload,
            })
    }

    #[test]
    fn many_planes_are_several_messages() {
        for (length, expected) in [(0, vec![8, 8, 4]), (3000, vec![5, 5, 5, 5]), (MAX_PAYLOAD, vec![2; 10])] {
            let plane = |index| Plane { index, payload: vec![7; length], ..Plane::default() };
            let planes: Vec<Plane> = (0..20).map(plane).collect();
            let groups: Vec<&[Plane]> = in_messages(&planes).collect();
            assert_eq!(groups.iter().map(|group| group.len()).collect::<Vec<_>>(), expected);
            assert_eq!(groups.concat(), planes);
            let (mut shortener, mut expander) = (Shortener::default(), Expander::default());
            for group in groups {
                let mut bytes = Vec::new();
                shortener.write_together(group, &mut bytes);
                assert!(bytes.len() <= MAX_BYTES);
                assert_eq!(expander.read_all(&bytes).unwrap().len(), group.len());
            }
        }
        assert_eq!(in_messages(&[]).count(), 0);
    }

    fn message() -> impl Strategy<Value = Message> {
        let sender = 0..MAX_SENDERS;
        let record = prop::collection::vec(any::<u8>(), 0..=MAX_RECORD);
        prop_oneof![
            plane().prop_map(Message::Plane),
            (sender.clone(), any::<[bool; 2]>(), record).prop_map(|(sender, hands, record)| Message::Hello {
                sender,
                hands,
                record
            }),
            sender.clone().prop_map(|sender| Message::Welcome { sender }),
            (sender.clone(), any::<bool>()).prop_map(|(sender, gone)| Message::End {
                sender,
                parting: if gone { Parting::Gone } else { Parting::Left }
            }),
            sender.prop_map(|sender| Message::Intra { sender }),
            any::<u64>().prop_map(|mark| Message::Ping { mark }),
            any::<[u64; 2]>().prop_map(|[mark, clock_us]| Message::Pong { mark, clock_us }),
        ]
    }

    /// Planes that mostly go on from one another, of a few senders.
    fn run() -> impl Strategy<Value = Vec<Plane>> {
        let step = (0u8..3, 0u16..12, 0u32..300, prop::bool::weighted(0.1), payload());
        prop::collection::vec(step, 1..60).prop_map(|steps| {
            let mut at = [(65_534u16, 0u16, u32::MAX - 500); 3];
            let of = |(sender, kind, passed, lost, payload): (u8, u16, u32, bool, Vec<u8>)| {
                let (period, index, time_ms) = &mut at[usize::from(sender)];
                match kind {
                    0 => (*period, *index) = (period.wrapping_add(1), 0),
                    1 => *index = index.wrapping_add(2),
                    2 => *index = u16::MAX,
                    _ => *index = index.wrapping_add(1),
                }
                *time_ms = time_ms.wrapping_add(passed);
                let (period, index, time_ms) = (*period, *index, *time_ms);
                Plane { sender, period, index, time_ms, replay: false, lost: [lost, false], payload }
            };
            steps.into_iter().map(of).collect()
        })
    }

    #[test]
    fn bytes_as_in_the_specification() {
        let first = Plane {
            sender: 2,
            period: 0x0102,
            index: 0,
            time_ms: 0x0a0b_0c0d,
            replay: true,
            lost: [false, true],
            payload: vec![0xee; 130],
        };
        let mut shortener = Shortener::default();
        let mut bytes = Vec::new();
        shortener.write(&first, &mut bytes);
        assert_eq!(bytes[..13], [0x30, 2, 5, 1, 2, 0, 0, 10, 11, 12, 13, 0x82, 1]);
        assert_eq!(bytes.len(), 13 + 130);
        bytes.clear();
        let next = Plane { index: 1, time_ms: first.time_ms + 33, payload: vec![9; 3], ..first };
        shortener.write(&next, &mut bytes);
        assert_eq!(bytes, [0xa2, 0x15, 3, 9, 9, 9]);
        bytes.clear();
        let third = Plane { index: 2, time_ms: next.time_ms + 43, ..next };
        shortener.write(&third, &mut bytes);
        let fourth = Plane { index: 3, time_ms: third.time_ms + 28, ..third };
        shortener.write_together(std::slice::from_ref(&fourth), &mut bytes);
        assert_eq!(bytes, [0xa2, 0x2f, 43, 3, 9, 9, 9, 0xe2, 0x30, 9, 9, 9]);
        bytes.clear();
        let after = |plane: &Plane, ms: u32| Plane {
            index: plane.index + 1,
            time_ms: plane.time_ms + ms,
            ..plane.clone()
        };
        let fifth = after(&fourth, 33);
        let (sixth, seventh) = (after(&fifth, 50), after(&after(&fifth, 50), 51));
        shortener.write_together(&[fifth, sixth, seventh], &mut bytes);
        assert_eq!(bytes, [0xa2, 0x45, 3, 9, 9, 9, 0x5e, 3, 9, 9, 9, 0x7f, 51, 9, 9, 9]);
        let hello = Message::Hello { sender: 1, hands: [true, false], record: vec![8, 9] };
        assert_eq!(hello.bytes(), [0x31, 1, 1, 2, 8, 9]);
        assert_eq!(Message::Welcome { sender: 3 }.bytes(), [0x32, 3]);
        assert_eq!(Message::End { sender: 3, parting: Parting::Gone }.bytes(), [0x33, 3, 1]);
        assert_eq!(Message::Intra { sender: 0 }.bytes(), [0x34, 0]);
        assert_eq!(Message::Ping { mark: 5 }.bytes(), [0x35, 0, 0, 0, 0, 0, 0, 0, 5]);
        assert_eq!(Message::Pong { mark: 5, clock_us: 6 }.bytes()[9..], [0, 0, 0, 0, 0, 0, 0, 6]);
        for (refusal, why) in [(Refusal::Closed, 0), (Refusal::Full, 1)] {
            let refused = Message::Refused { refusal };
            assert_eq!(refused.bytes(), [0x37, why]);
            assert_eq!(decode_all(&refused.bytes()).unwrap(), [refused]);
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        let error = |bytes: &[u8]| decode_all(bytes).unwrap_err().to_string();
        assert_eq!(error(&[]), "live message: ends after 0 bytes");
        assert_eq!(error(&[0x15, 0]), "live message: version 1, expected 3");
        assert_eq!(error(&[0x3f]), "live message: kind 15, expected 0 to 7");
        assert_eq!(error(&[0x34, 16]), "live message: sender 16, allowed are 0 to 15");
        assert_eq!(error(&[0x31, 0, 0, 65]), "live message: length of a record 65, allowed are 0 to 64");
        assert_eq!(error(&[0x35, 0]), "live message: ends after 2 bytes");
        assert_eq!(error(&[0x37, 2]), "live message: refusal 2, allowed are 0 and 1");
        let long = [0x30, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x81, 0x40];
        assert_eq!(error(&long), "live message: length of a plane 8193, allowed are 0 to 8192");
        assert!(error(&[0xa2, 0x15, 0]).contains("sender 2 does not go on"));
        assert!(error(&[0x5e, 0]).contains("has none before it"));
        assert!(error(&[0x32, 3, 0x5e, 0]).contains("has none before it"));
        assert_eq!(error(&[0x34, 0].repeat(9)), "live message: more than 8 together");
    }

    proptest! {
        #[test]
        fn messages_are_read_as_written(messages in prop::collection::vec(message(), 1..=MAX_TOGETHER)) {
            let bytes: Vec<u8> = messages.iter().flat_map(Message::bytes).collect();
            prop_assert_eq!(decode_all(&bytes), Ok(messages));
            prop_assert!(decode_all(&bytes[..bytes.len() - 1]).is_err());
        }

        #[test]
        fn short_planes_are_read_as_written(planes in run()) {
            let (mut shortener, mut expander) = (Shortener::default(), Expander::default());
            for plane in planes {
                let (mut bytes, long) = (Vec::new(), Message::Plane(plane.clone()).bytes().len());
                let last = plane.time_ms % 2 == 0;
                if last {
                    shortener.write_together(std::slice::from_ref(&plane), &mut bytes);
                } else {
                    shortener.write(&plane, &mut bytes);
                }
                // A length has one byte or two; a short plane tells its time in a byte of its own or not.
                let saved = if last { 9..=11 } else { 8..=9 };
                prop_assert!(bytes.len() == long || saved.contains(&(long - bytes.len())));
                prop_assert_eq!(expander.read_all(&bytes), Ok(vec![Message::Plane(plane)]));
            }
        }

        #[test]
        fn planes_together_are_read_as_written(planes in run(), together in 1..=MAX_TOGETHER) {
            let (mut shortener, mut expander) = (Shortener::default(), Expander::default());
            for planes in planes.chunks(together) {
                let mut bytes = Vec::new();
                shortener.write_together(planes, &mut bytes);
                let planes: Vec<Message> = planes.iter().cloned().map(Message::Plane).collect();
                prop_assert_eq!(expander.read_all(&bytes), Ok(planes));
            }
        }

        /// A reader that misses some reads long planes, and short ones behind the plane that it read last; others it refuses
        /// up to the next long one, but for those whose period and index, as far as they tell them, are the next.
        #[test]
        fn missing_planes_are_noticed(planes in run(), kept in prop::collection::vec(any::<bool>(), 60)) {
            let (mut shortener, mut expander) = (Shortener::default(), Expander::default());
            let mut last: [Option<(u16, u16)>; 3] = [None; 3];
            for (plane, kept) in planes.into_iter().zip(kept) {
                let mut bytes = Vec::new();
                shortener.write(&plane, &mut bytes);
                if !kept {
                    continue;
                }
                let last = &mut last[usize::from(plane.sender)];
                let told = |(period, index): (u16, u16)| (period % 4, index % 16);
                let at = (plane.period, plane.index);
                let next = last.and_then(|(period, index)| Some((period, index.checked_add(1)?)));
                let expected = if bytes[0] & SHORT == 0 { Some(at) } else { next.filter(|&next| told(next) == told(at)) };
                let read = expander.read_all(&bytes);
                if let Some(expected) = expected {
                    let Ok([Message::Plane(read)]) = read.as_deref() else { panic!("{read:?}") };
                    prop_assert_eq!((read.period, read.index), expected);
                    prop_assert_eq!(&read.payload, &plane.payload);
                } else {
                    prop_assert_eq!(read, Err(WireError::Discontinued { sender: plane.sender }));
                }
                *last = expected;
            }
        }

        #[test]
        fn anything_is_taken(pieces in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..60), 0..20)) {
            let mut expander = Expander::default();
            for piece in pieces {
                if let Ok(messages) = expander.read_all(&piece) {
                    prop_assert!(messages.len() <= MAX_TOGETHER);
                    let lengths = messages.iter().map(|m| if let Message::Plane(p) = m { p.payload.len() } else { 0 });
                    prop_assert!(lengths.sum::<usize>() <= piece.len());
                }
            }
        }

        #[test]
        fn any_message_of_the_right_version_is_taken(kind in 0u8..8, rest in prop::collection::vec(any::<u8>(), 0..40)) {
            let bytes = [vec![VERSION << 4 | kind], rest].concat();
            if let Ok((message, rest)) = decode(&bytes) {
                let length = bytes.len() - rest.len();
                prop_assert_eq!(decode(&message.bytes()).map(|(m, _)| m), Ok(message));
                prop_assert!(length <= bytes.len());
            }
        }
    }
}
