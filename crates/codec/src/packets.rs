//! A live stream over a transport that loses and reorders packets: offsets tell of gaps, and copies of earlier packets fill
//! most of them (as RFC 2198 does for audio).
//!
//! A packet is the number of bytes of the stream before it, u(16), cut; whether it has a parity u(1); the number of copies
//! u(7); for each copy how many bytes of the stream lie between its beginning and that of the packet, u(16), its length
//! u(16) and its bytes; the parity; then the packet's own bytes. Numbers are in network order. A sender sends one at each
//! tick, empty or not, so that a receiver knows at once when one is missing; an empty one that is lost leaves no gap.
//!
//! A parity is of the packets before this one, as RFC 5109 has it: how many bytes of the stream they have, u(16), how many
//! of them it covers u(8), the length of the longest of these u(16), and the exclusive or of their bytes. It covers those
//! that are neither empty nor longer than that: a parity is as long as the longest it covers, so that the few much longer
//! than the others, I planes, are left out. It brings back one that is lost, at a fraction of what copies of all of them
//! take, but only once the last of them is there.
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
    /// Packets that a parity is of, or 0 for none.
    group: u8,
    /// Offsets and bytes of earlier packets, the newest first.
    earlier: VecDeque<(u64, Vec<u8>)>,
    /// Packets since the last parity.
    since: u8,
}

/// Most copies in a packet, and the bit beside their number that says that there is a parity.
const MOST_COPIES: usize = 127;
const PARITY: u8 = 0x80;
/// Packets this many times as long as the middle one are covered by a parity at most.
const LONGER: usize = 3;

impl Packer {
    /// Packets with copies of those sent so many packets earlier; 0 is passed over.
    pub fn new(distances: &[u8]) -> Self {
        let distances = distances.iter().copied().filter(|&distance| distance > 0).collect();
        Self { offset: 0, distances, group: 0, earlier: VecDeque::new(), since: 0 }
    }

    /// The same, with a parity of so many packets in the packet behind them; 0 for none.
    #[must_use]
    pub fn with_parity(self, packets: u8) -> Self {
        Self { group: packets, ..self }
    }

    /// The parity of the packets since the last one, if it is its turn.
    fn parity(&self) -> Option<Vec<u8>> {
        if self.group == 0 || self.since < self.group {
            return None;
        }
        let group = || self.earlier.iter().take(self.since.into()).map(|(_, bytes)| bytes);
        let length: usize = group().map(Vec::len).sum();
        let mut lengths: Vec<usize> = group().map(Vec::len).filter(|&length| length > 0).collect();
        lengths.sort_unstable();
        let most = LONGER * lengths.get(lengths.len() / 2).copied().unwrap_or(0);
        let covered = lengths.partition_point(|&length| length <= most);
        let longest = covered.checked_sub(1).map_or(0, |last| lengths[last]);
        let mut out = u16::try_from(length).ok()?.to_be_bytes().to_vec();
        out.push(covered as u8);
        out.extend((longest as u16).to_be_bytes());
        let mut sum = vec![0; longest];
        group().filter(|bytes| bytes.len() <= longest).for_each(|bytes| exclusive_or(&mut sum, bytes));
        out.extend(sum);
        Some(out)
    }

    /// The packet that carries these bytes of a stream. Copies that are longer than 65 535 bytes, or begin farther back,
    /// are left out.
    pub fn pack(&mut self, bytes: &[u8]) -> Vec<u8> {
        let copy = |distance: &u8| {
            let (at, copy) = self.earlier.get(usize::from(*distance) - 1)?;
            let back = u16::try_from(self.offset - at).ok()?;
            Some((back, u16::try_from(copy.len()).ok().filter(|&length| length > 0)?, &copy[..]))
        };
        let copies: Vec<(u16, u16, &[u8])> =
            self.distances.iter().filter_map(copy).take(MOST_COPIES).collect();
        let parity = self.parity();
        let mut packet = (self.offset as u16).to_be_bytes().to_vec();
        packet.push(copies.len() as u8 | if parity.is_some() { PARITY } else { 0 });
        for (back, length, copy) in copies {
            packet.extend(back.to_be_bytes());
            packet.extend(length.to_be_bytes());
            packet.extend(copy);
        }
        if let Some(parity) = parity {
            packet.extend(parity);
            self.since = 0;
        }
        packet.extend(bytes);
        self.since = self.since.saturating_add(1);
        self.earlier.push_front((self.offset, bytes.to_vec()));
        self.earlier.truncate(self.distances.iter().copied().fold(self.group, u8::max).into());
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
    /// Bytes behind a gap by offset, and when they or others behind them came.
    waiting: BTreeMap<u64, (Vec<u8>, u64)>,
    /// Packets that came or were brought back lately, which parities are solved with, by offset.
    lately: BTreeMap<u64, Vec<u8>>,
}

/// Packets that are kept for parities.
const KEPT: usize = 256;

/// Adds bytes to a sum without carries, as far as that goes.
fn exclusive_or(sum: &mut [u8], bytes: &[u8]) {
    sum.iter_mut().zip(bytes).for_each(|(sum, byte)| *sum ^= byte);
}

impl Unpacker {
    /// Waits so many packets for one that is missing: the farthest distance of the sender's copies, or the packets that its
    /// parities are of; 0 for none.
    pub fn new(patience: u8) -> Self {
        Self { patience: patience.into(), ..Self::default() }
    }

    /// Whether bytes are missing, and may still come as a copy.
    pub fn is_waiting(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Takes a packet, and gives what follows on what it gave so far. Packets that are none are passed over.
    pub fn take(&mut self, packet: &[u8]) -> Vec<Arrival> {
        let Some(Parsed { offset, copies, parity, bytes }) = parse(packet) else { return Vec::new() };
        self.taken += 1;
        // Of all offsets with these low bits the one nearest to what is next.
        let next = *self.next.get_or_insert((1 << 16) + u64::from(offset));
        let Some(at) = next.checked_add_signed(offset.wrapping_sub(next as u16).cast_signed().into()) else {
            return Vec::new();
        };
        for (back, copy) in copies {
            if let Some(at) = at.checked_sub(back.into()) {
                self.wait(at, copy);
                self.keep(at, copy);
            }
        }
        if let Some((lost, found)) = parity.and_then(|parity| self.solve(at, &parity)) {
            self.wait(lost, &found);
            self.keep(lost, &found);
        }
        self.keep(at, bytes);
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
            // One that is brought back was missing since something behind it came; a gap before it has waited as long.
            let behind = self.waiting.range(at..).next();
            let came = behind.map_or(self.taken, |(_, &(_, came))| came);
            self.waiting.insert(at, (bytes.to_vec(), came));
        }
    }

    fn keep(&mut self, at: u64, bytes: &[u8]) {
        if bytes.is_empty() {
            return;
        }
        self.lately.insert(at, bytes.to_vec());
        while self.lately.len() > KEPT {
            self.lately.pop_first();
        }
    }

    /// The one packet of a parity in the packet at `at` that did not come, and where it is in the stream.
    fn solve(&self, at: u64, parity: &Parity<'_>) -> Option<(u64, Vec<u8>)> {
        let start = at.checked_sub(parity.length.into())?;
        let mut sum = parity.sum.to_vec();
        let (mut end, mut lost, mut count) = (start, None, 1);
        for (&here, bytes) in self.lately.range(start..at) {
            if here > end && lost.replace((end, here)).is_some() || here < end {
                return None;
            }
            end = here + bytes.len() as u64;
            if bytes.len() <= parity.sum.len() {
                exclusive_or(&mut sum, bytes);
                count += 1;
            }
        }
        if end < at && lost.replace((end, at)).is_some() {
            return None;
        }
        let (from, to) = lost?;
        let length = usize::try_from(to - from).ok()?;
        let solved = count == parity.covered && sum.get(length..)?.iter().all(|&byte| byte == 0);
        sum.truncate(length);
        solved.then_some((from, sum))
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

/// The exclusive or of some packets, how many bytes they have together, and how many of them it covers.
struct Parity<'a> {
    length: u16,
    covered: u8,
    sum: &'a [u8],
}

/// What a packet says.
struct Parsed<'a> {
    offset: u16,
    copies: Vec<Copy<'a>>,
    parity: Option<Parity<'a>>,
    bytes: &'a [u8],
}

fn parse(packet: &[u8]) -> Option<Parsed<'_>> {
    let number = |bytes: &mut &[u8]| {
        let (number, rest) = bytes.split_first_chunk::<2>()?;
        *bytes = rest;
        Some(u16::from_be_bytes(*number))
    };
    let mut rest = packet;
    let offset = number(&mut rest)?;
    let (&told, behind) = rest.split_first()?;
    rest = behind;
    let count = usize::from(told & !PARITY);
    let mut copies = Vec::with_capacity(count);
    for _ in 0..count {
        let (back, length) = (number(&mut rest)?, number(&mut rest)?);
        let (copy, behind) = rest.split_at_checked(length.into())?;
        copies.push((back, copy));
        rest = behind;
    }
    let parity = if told & PARITY == 0 {
        None
    } else {
        let length = number(&mut rest)?;
        let (&covered, mut behind) = rest.split_first()?;
        let longest = number(&mut behind)?;
        let (sum, behind) = behind.split_at_checked(longest.into())?;
        rest = behind;
        Some(Parity { length, covered, sum })
    };
    Some(Parsed { offset, copies, parity, bytes: rest })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Some are empty, and every eleventh is long.
    fn payload(number: usize) -> Vec<u8> {
        vec![number as u8; if number % 11 == 7 { 40 } else { number % 5 }]
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

    /// What shall arrive of packets with [`payload`] and six behind them, where those `comes` says come somehow.
    fn expected(lost: &[bool], comes: impl Fn(usize) -> bool) -> Vec<Arrival> {
        let first = lost.iter().position(|lost| !lost).unwrap_or(lost.len());
        let arrivals = (first..lost.len() + 6).filter_map(|n| {
            let bytes = if n < lost.len() { payload(n) } else { b"end".to_vec() };
            match comes(n) {
                _ if bytes.is_empty() => None,
                true => Some(Arrival::Bytes(bytes)),
                false => Some(Arrival::Gap),
            }
        });
        joined(arrivals)
    }

    /// What arrives of them.
    fn arrived(lost: &[bool], mut packer: Packer, mut unpacker: Unpacker) -> Vec<Arrival> {
        let mut packets: Vec<Vec<u8>> = (0..lost.len()).map(|n| packer.pack(&payload(n))).collect();
        packets.extend((0..6).map(|_| packer.pack(b"end")));
        let came = (0..packets.len()).filter(|&n| lost.get(n) != Some(&true));
        let arrived = joined(came.flat_map(|n| unpacker.take(&packets[n])));
        assert!(!unpacker.is_waiting());
        arrived
    }

    /// What a parity brings back does not make the gap before it wait once more.
    #[test]
    fn a_gap_waits_once() {
        let mut packer = Packer::new(&[]).with_parity(5);
        let packets: Vec<Vec<u8>> = (0..12).map(|_| packer.pack(b"pose")).collect();
        let mut unpacker = Unpacker::new(5);
        // The last of one group, and the first of the next, with the parity that would bring it back.
        let arrived: Vec<Arrival> =
            (0..11).filter(|n| ![4, 5].contains(n)).flat_map(|n| unpacker.take(&packets[n])).collect();
        assert!(!unpacker.is_waiting());
        let bytes = |poses: usize| Arrival::Bytes(b"pose".repeat(poses));
        assert_eq!(joined(arrived), [bytes(4), Arrival::Gap, bytes(6)]);
    }

    proptest! {
        /// What comes is in order, whole up to each gap, and complete where copies reach.
        #[test]
        fn gaps_are_filled_or_told(
            lost in prop::collection::vec(prop::bool::weighted(0.3), 1..400),
            distances in prop::collection::vec(1u8..6, 0..3),
            offset in 0u64..70_000,
        ) {
            let packer = Packer { offset, ..Packer::new(&distances) };
            let unpacker = Unpacker::new(distances.iter().copied().max().unwrap_or(0));
            let came = |n: usize| lost.get(n) != Some(&true);
            let comes = |n: usize| came(n) || distances.iter().any(|&d| came(n + usize::from(d)));
            prop_assert_eq!(arrived(&lost, packer, unpacker), expected(&lost, comes));
        }

        /// A parity that comes brings back the only packet with bytes that is missing of its group.
        #[test]
        fn a_parity_brings_one_back(
            lost in prop::collection::vec(prop::bool::weighted(0.15), 1..400),
            group in 1usize..6,
            offset in 0u64..70_000,
        ) {
            let packer = Packer { offset, ..Packer::new(&[]) }.with_parity(group as u8);
            let came = |n: usize| lost.get(n) != Some(&true);
            let sent = |n: usize| if n < lost.len() { payload(n) } else { b"end".to_vec() };
            let comes = |n: usize| {
                let start = n / group * group;
                let full = (start..start + group).filter(|&other| !sent(other).is_empty());
                let mut lengths: Vec<usize> = full.clone().map(|other| sent(other).len()).collect();
                lengths.sort_unstable();
                let covered = lengths.is_empty() || sent(n).len() <= LONGER * lengths[lengths.len() / 2];
                came(n) || covered && came(start + group) && full.filter(|&other| other != n).all(came)
            };
            prop_assert_eq!(arrived(&lost, packer, Unpacker::new(group as u8)), expected(&lost, comes));
        }

        #[test]
        fn anything_is_taken(
            packets in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..40), 0..40),
        ) {
            let mut unpacker = Unpacker::new(3);
            for packet in packets {
                unpacker.take(&packet);
                prop_assert!(unpacker.waiting.len() <= 9 * 40);
            }
        }
    }
}
