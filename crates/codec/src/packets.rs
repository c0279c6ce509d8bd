//! A live stream over a transport that loses and reorders packets: offsets tell of gaps, and copies of earlier packets fill
//! most of them (as RFC 2198 does for audio).
//!
//! A packet is the number of bytes of the stream before it, u(16), cut; the number of copies u(8); for each copy how many
//! bytes of the stream lie between its beginning and that of the packet, u(16), its length u(16) and its bytes; then the
//! packet's own bytes. Numbers are in network order. A sender sends one at each tick, empty or not, so that a receiver
//! knows at once when one is missing; an empty one that is lost leaves no gap.
//!
//! ```
//! use handcast_codec::packets::{Arrival, Packer, Unpacker};
//!
//! let mut packer = Packer::new(&[1]);
//! let packets: Vec<Vec<u8>> = [b"ab", b"cd", b"ef"].iter().map(|bytes| packer.pack(&bytes[..])).collect();
//! let mut unpacker = Unpacker::new(1);
//! let mut arrived = unpacker.take(&packets[0]);
//! arrived.extend(unpacker.take(&packets[2])); // the second is lost, and comes as a copy with the third
//! let bytes = |text: &[u8]| Arrival::Bytes(text.to_vec());
//! assert_eq!(arrived, [bytes(b"ab"), bytes(b"cd"), bytes(b"ef")]);
//! ```

use std::collections::{BTreeMap, VecDeque};

/// Says where in the stream packets are, and adds copies of earlier ones.
#[derive(Clone, Debug)]
pub struct Packer {
    /// Bytes of the stream so far.
    offset: u64,
    distances: Vec<u8>,
    /// Offsets and bytes of earlier packets, the newest first.
    earlier: VecDeque<(u64, Vec<u8>)>,
}

impl Packer {
    /// Packets with copies of those sent so many packets earlier; 0 is passed over.
    pub fn new(distances: &[u8]) -> Self {
        let distances = distances.iter().copied().filter(|&distance| distance > 0).collect();
        Self { offset: 0, distances, earlier: VecDeque::new() }
    }

    /// The packet that carries these bytes of a stream. Copies that are longer than 65 535 bytes, or begin farther back,
    /// are left out.
    pub fn pack(&mut self, bytes: &[u8]) -> Vec<u8> {
        let copy = |distance: &u8| {
            let (at, copy) = self.earlier.get(usize::from(*distance) - 1)?;
            let back = u16::try_from(self.offset - at).ok()?;
            Some((back, u16::try_from(copy.len()).ok().filter(|&length| length > 0)?, &copy[..]))
        };
        let copies: Vec<(u16, u16, &[u8])> = self.distances.iter().filter_map(copy).take(255).collect();
        let mut packet = (self.offset as u16).to_be_bytes().to_vec();
        packet.push(copies.len() as u8);
        for (back, length, copy) in copies {
            packet.extend(back.to_be_bytes());
            packet.extend(length.to_be_bytes());
            packet.extend(copy);
        }
        packet.extend(bytes);
        self.earlier.push_front((self.offset, bytes.to_vec()));
        self.earlier.truncate(self.distances.iter().copied().max().unwrap_or(0).into());
        self.offset += bytes.len() as u64;
        packet
    }
}

/// What arrives, in order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// Bytes of the stream.
    Bytes(Vec<u8>),
    /// Bytes are lost here: [`PoseDecoder::lose`](crate::PoseDecoder::lose).
    Gap,
}

/// Puts packets in order, and says where some are lost.
#[derive(Clone, Debug, Default)]
pub struct Unpacker {
    /// Packets to wait for a copy.
    patience: u64,
    /// Bytes of the stream so far, from where the first packet began.
    next: Option<u64>,
    /// Packets taken.
    taken: u64,
    /// Bytes behind a gap by offset, and when they came.
    waiting: BTreeMap<u64, (Vec<u8>, u64)>,
}

impl Unpacker {
    /// Waits so many packets for one that is missing: the farthest distance of the sender's copies, 0 for none.
    pub fn new(patience: u8) -> Self {
        Self { patience: patience.into(), ..Self::default() }
    }

    /// Whether bytes are missing, and may still come as a copy.
    pub fn is_waiting(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Takes a packet, and gives what follows on what it gave so far. Packets that are none are passed over.
    pub fn take(&mut self, packet: &[u8]) -> Vec<Arrival> {
        let Some((offset, copies, bytes)) = parse(packet) else { return Vec::new() };
        self.taken += 1;
        // Of all offsets with these low bits the one nearest to what is next.
        let next = *self.next.get_or_insert((1 << 16) + u64::from(offset));
        let Some(at) = next.checked_add_signed(offset.wrapping_sub(next as u16).cast_signed().into()) else {
            return Vec::new();
        };
        for (back, copy) in copies {
            if let Some(at) = at.checked_sub(back.into()) {
                self.wait(at, copy);
            }
        }
        // An empty one that lies ahead tells of a gap, too.
        self.wait(at, bytes);
        let mut arrived = Vec::new();
        self.drain(&mut arrived);
        arrived
    }

    fn wait(&mut self, at: u64, bytes: &[u8]) {
        let next = self.next.unwrap_or(at);
        let has = self.waiting.get(&at).is_some_and(|(known, _)| !known.is_empty());
        if (at > next || (at == next && !bytes.is_empty())) && !has {
            self.waiting.insert(at, (bytes.to_vec(), self.taken));
        }
    }

    fn drain(&mut self, arrived: &mut Vec<Arrival>) {
        while let (Some(next), Some((&first, (_, came)))) = (self.next, self.waiting.first_key_value()) {
            if first > next {
                if self.taken - came + 1 < self.patience {
                    return;
                }
                arrived.push(Arrival::Gap);
            }
            if let Some((bytes, _)) = self.waiting.remove(&first) {
                self.next = Some(next.max(first + bytes.len() as u64));
                if first >= next && !bytes.is_empty() {
                    arrived.push(Arrival::Bytes(bytes));
                }
            }
        }
    }
}

/// Bytes of a stream, and how far before the packet's own they begin.
type Copy<'a> = (u16, &'a [u8]);

/// Offset, copies and bytes of a packet.
fn parse(packet: &[u8]) -> Option<(u16, Vec<Copy<'_>>, &[u8])> {
    let number = |bytes: &mut &[u8]| {
        let (number, rest) = bytes.split_first_chunk::<2>()?;
        *bytes = rest;
        Some(u16::from_be_bytes(*number))
    };
    let mut rest = packet;
    let offset = number(&mut rest)?;
    let (&count, behind) = rest.split_first()?;
    rest = behind;
    let mut copies = Vec::with_capacity(count.into());
    for _ in 0..count {
        let (back, length) = (number(&mut rest)?, number(&mut rest)?);
        let (copy, behind) = rest.split_at_checked(length.into())?;
        copies.push((back, copy));
        rest = behind;
    }
    Some((offset, copies, rest))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn payload(number: usize) -> Vec<u8> {
        vec![number as u8; number % 5]
    }

    /// Bytes that came without a gap between them as one.
    fn joined(arrived: impl IntoIterator<Item = Arrival>) -> Vec<Arrival> {
        let mut out: Vec<Arrival> = Vec::new();
        for arrival in arrived {
            match (out.last_mut(), arrival) {
                (Some(Arrival::Bytes(bytes)), Arrival::Bytes(more)) => bytes.extend(more),
                (Some(Arrival::Gap), Arrival::Gap) => {}
                (_, arrival) => out.push(arrival),
            }
        }
        out
    }

    proptest! {
        /// What comes is in order, whole up to each gap, and complete where copies reach.
        #[test]
        fn gaps_are_filled_or_told(
            lost in prop::collection::vec(prop::bool::weighted(0.3), 1..400),
            distances in prop::collection::vec(1u8..6, 0..3),
            offset in 0u64..70_000,
        ) {
            let mut packer = Packer { offset, ..Packer::new(&distances) };
            let mut unpacker = Unpacker::new(distances.iter().copied().max().unwrap_or(0));
            let mut packets: Vec<Vec<u8>> = (0..lost.len()).map(|n| packer.pack(&payload(n))).collect();
            packets.extend((0..6).map(|_| packer.pack(b"end")));
            let came = |n: usize| lost.get(n) != Some(&true);
            let arrived = joined((0..packets.len()).filter(|&n| came(n)).flat_map(|n| unpacker.take(&packets[n])));
            let comes = |n: usize| came(n) || distances.iter().any(|&d| came(n + usize::from(d)));
            let first = (0..lost.len()).find(|&n| came(n)).unwrap_or(lost.len());
            let expected = (first..packets.len()).filter_map(|n| {
                let bytes = if n < lost.len() { payload(n) } else { b"end".to_vec() };
                match comes(n) {
                    _ if bytes.is_empty() => None,
                    true => Some(Arrival::Bytes(bytes)),
                    false => Some(Arrival::Gap),
                }
            });
            prop_assert_eq!(arrived, joined(expected));
            prop_assert!(!unpacker.is_waiting());
        }

        #[test]
        fn anything_is_taken(
            packets in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..40), 0..40),
        ) {
            let mut unpacker = Unpacker::new(3);
            for packet in packets {
                unpacker.take(&packet);
                prop_assert!(unpacker.waiting.len() <= 8 * 40);
            }
        }
    }
}
