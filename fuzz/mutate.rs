//! Mutations that keep what frames a file whole: lengths of boxes and chunks, check sums, words of text. Bytes changed at
//! random hardly ever get past these.

use std::ops::Range;

use libfuzzer_sys::fuzzer_mutate;

/// A piece of a file with its own length field.
struct Part {
    /// All of it, with its head.
    item: Range<usize>,
    /// What the length counts.
    content: Range<usize>,
    /// Where the length stands; 4 bytes.
    length: usize,
    big_endian: bool,
    /// Whether it has no parts of its own.
    leaf: bool,
    text: bool,
}

/// Numbers at which readers tend to fail.
const NUMBERS: [u64; 20] = [
    0,
    1,
    2,
    3,
    4,
    7,
    8,
    16,
    100,
    0x7f,
    0x80,
    0xff,
    0x100,
    0x7fff,
    0xffff,
    0x10000,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    u64::MAX,
];

/// Words of the same kind.
const WORDS: &str = "0 1 -1 2 3 0.5 1e9 1e-9 1e308 -1e308 1e999 NaN null true \"\" [] {} 255 256 65536 4294967295 4294967296 \
                     9007199254740993 18446744073709551616 -0";

/// A generator of numbers (SplitMix64).
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    /// Below `count`; 0 where that is 0.
    fn below(&mut self, count: usize) -> usize {
        (self.next() % count.max(1) as u64) as usize
    }

    fn one_of<'a, T>(&mut self, list: &'a [T]) -> Option<&'a T> {
        list.get(self.below(list.len()))
    }
}

/// Puts what a mutation made in place of the input, or lets the fuzzer change it anywhere.
fn put(data: &mut [u8], size: usize, max: usize, made: Option<Vec<u8>>) -> usize {
    match made {
        Some(made) if made.len() <= max && !made.is_empty() && made != data[..size] => {
            data[..made.len()].copy_from_slice(&made);
            made.len()
        }
        _ => fuzzer_mutate(data, size, max),
    }
}

/// MP4 files.
pub fn boxes(data: &mut [u8], size: usize, max: usize, seed: u32) -> usize {
    let mut parts = Vec::new();
    box_parts(data, 0..size, 0, &mut parts);
    let made = framed(&data[..size], &parts, seed);
    put(data, size, max, made)
}

fn box_parts(data: &[u8], within: Range<usize>, depth: usize, parts: &mut Vec<Part>) {
    let mut at = within.start;
    while at + 8 <= within.end && parts.len() < 400 {
        let length = u32::from_be_bytes([data[at], data[at + 1], data[at + 2], data[at + 3]]) as usize;
        let end = at.saturating_add(length);
        if length < 8 || end > within.end {
            return;
        }
        let inner = match &data[at + 4..at + 8] {
            b"moov" | b"trak" | b"mdia" | b"minf" | b"stbl" | b"mvex" | b"moof" | b"traf" | b"edts" => {
                Some(8)
            }
            b"stsd" => Some(16),
            b"avc1" | b"mp4v" => Some(86),
            _ => None,
        };
        let inner = inner.filter(|inner| *inner < length && depth < 10);
        let leaf = inner.is_none();
        // The length of a box counts its head.
        parts.push(Part {
            item: at..end,
            content: at + 8..end,
            length: at,
            big_endian: true,
            leaf,
            text: false,
        });
        if let Some(inner) = inner {
            box_parts(data, at + inner..end, depth + 1, parts);
        }
        at = end;
    }
}

/// AVI and WebP.
pub fn riff(data: &mut [u8], size: usize, max: usize, seed: u32) -> usize {
    let mut parts = Vec::new();
    riff_parts(data, 0..size, 0, &mut parts);
    let made = framed(&data[..size], &parts, seed);
    put(data, size, max, made)
}

fn riff_parts(data: &[u8], within: Range<usize>, depth: usize, parts: &mut Vec<Part>) {
    let mut at = within.start;
    while at + 8 <= within.end && parts.len() < 400 {
        let length = u32::from_le_bytes([data[at + 4], data[at + 5], data[at + 6], data[at + 7]]) as usize;
        let end = (at + 8).saturating_add(length).min(within.end);
        let leaf = !matches!(&data[at..at + 4], b"RIFF" | b"LIST") || depth > 6;
        parts.push(Part {
            item: at..end,
            content: at + 8..end,
            length: at + 4,
            big_endian: false,
            leaf,
            text: false,
        });
        if !leaf {
            riff_parts(data, at + 12..end, depth + 1, parts);
        }
        at = end + length % 2;
    }
}

/// Pictures: PNG with its check sums, WebP; the others as they are.
pub fn picture(data: &mut [u8], size: usize, max: usize, seed: u32) -> usize {
    if data[..size].starts_with(b"RIFF") {
        return riff(data, size, max, seed);
    }
    if !data[..size].starts_with(b"\x89PNG\r\n\x1a\n") {
        return bytes(data, size, max, seed);
    }
    let mut parts = Vec::new();
    let mut at = 8;
    while at + 12 <= size && parts.len() < 400 {
        let length = u32::from_be_bytes([data[at], data[at + 1], data[at + 2], data[at + 3]]) as usize;
        let end = (at + 12).saturating_add(length);
        if end > size {
            break;
        }
        let content = at + 8..end - 4;
        parts.push(Part { item: at..end, content, length: at, big_endian: true, leaf: true, text: false });
        at = end;
    }
    let made = framed(&data[..size], &parts, seed).map(|mut made| {
        checked(&mut made);
        made
    });
    put(data, size, max, made)
}

/// Puts the check sum of every chunk of a PNG file right.
fn checked(png: &mut [u8]) {
    let mut at = 8;
    while at + 12 <= png.len() {
        let length = u32::from_be_bytes([png[at], png[at + 1], png[at + 2], png[at + 3]]) as usize;
        let end = (at + 8).saturating_add(length);
        if end.saturating_add(4) > png.len() {
            return;
        }
        let sum = crc32(&png[at + 4..end]);
        png[end..end + 4].copy_from_slice(&sum.to_be_bytes());
        at = end + 4;
    }
}

/// ISO 3309, as PNG has it.
fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32, _| if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 };
    !bytes.iter().fold(!0u32, |crc, &byte| (0..8).fold(crc ^ u32::from(byte), step))
}

/// GLB files: words of the JSON, bytes of the binary chunk.
pub fn glb(data: &mut [u8], size: usize, max: usize, seed: u32) -> usize {
    if !data[..size].starts_with(b"glTF") {
        return text(data, size, max, seed);
    }
    let mut parts = Vec::new();
    let mut at = 12;
    while at + 8 <= size {
        let length = u32::from_le_bytes([data[at], data[at + 1], data[at + 2], data[at + 3]]) as usize;
        let end = (at + 8).saturating_add(length).min(size);
        let text = &data[at + 4..at + 8] == b"JSON";
        let content = at + 8..end;
        parts.push(Part { item: at..end, content, length: at, big_endian: false, leaf: true, text });
        at = end;
    }
    // Mostly the JSON: what is behind it are numbers.
    if seed % 4 > 0 {
        parts.truncate(1);
    }
    parts.push(Part { item: 0..0, content: 0..size, length: 8, big_endian: false, leaf: false, text: false });
    let made = framed(&data[..size], &parts, seed);
    put(data, size, max, made)
}

/// Zips of stored entries: numbers of what an entry holds, words of its first line, with the check sums to match.
pub fn archive(data: &mut [u8], size: usize, max: usize, seed: u32) -> usize {
    let mut dice = Dice(seed.into());
    let file = &data[..size];
    let field =
        |at: usize| file.get(at..at + 4).map(|f| u32::from_le_bytes([f[0], f[1], f[2], f[3]]) as usize);
    let short = |at: usize| file.get(at..at + 2).map(|f| usize::from(f[0]) | usize::from(f[1]) << 8);
    // Where an entry of the directory is, its local header, and what it holds.
    let entry = |at: usize| {
        let (length, header) = (field(at + 20)?, field(at + 42)?);
        let start =
            header.checked_add(30)?.checked_add(short(header + 26)?)?.checked_add(short(header + 28)?)?;
        let end = start.checked_add(length).filter(|&end| end <= size)?;
        Some((at, header, start..end))
    };
    let listed = (0..size.saturating_sub(45)).filter(|&at| file[at..].starts_with(b"PK\x01\x02"));
    let entries: Vec<_> = listed.filter_map(entry).collect();
    let made = dice.one_of(&entries).cloned().filter(|_| seed % 8 > 0).map(|(directory, header, content)| {
        let old = &file[content.clone()];
        let mut new = if dice.below(2) == 0 {
            let line = line_at(old, 0);
            [&reworded(&old[line.clone()], &mut dice)[..], &old[line.end..]].concat()
        } else {
            renumbered(old, size, &mut dice)
        };
        // Places of what follows stay.
        new.resize(old.len(), b' ');
        let mut made = file.to_vec();
        let sum = crc32(&new).to_le_bytes();
        made[content].copy_from_slice(&new);
        for at in [header + 14, directory + 16] {
            made[at..at + 4].copy_from_slice(&sum);
        }
        made
    });
    put(data, size, max, made)
}

/// Words, lines and brackets of any text.
pub fn text(data: &mut [u8], size: usize, max: usize, seed: u32) -> usize {
    let mut dice = Dice(seed.into());
    let made = (dice.below(4) > 0).then(|| reworded(&data[..size], &mut dice));
    put(data, size, max, made)
}

/// Numbers in bytes.
pub fn bytes(data: &mut [u8], size: usize, max: usize, seed: u32) -> usize {
    let mut dice = Dice(seed.into());
    let made = (dice.below(3) == 0).then(|| renumbered(&data[..size], size, &mut dice));
    put(data, size, max, made)
}

/// One part changed, left out, doubled or exchanged, with the lengths around it.
fn framed(data: &[u8], parts: &[Part], seed: u32) -> Option<Vec<u8>> {
    let mut dice = Dice(seed.into());
    let part = dice.one_of(parts)?;
    let item = &data[part.item.clone()];
    match dice.below(12) {
        0 => None,
        1 => Some(replaced(data, parts, part.item.clone(), &[])),
        2 => Some(replaced(data, parts, part.item.clone(), &[item, item].concat())),
        3 => {
            let other = dice.one_of(parts)?;
            Some(replaced(data, parts, part.item.clone(), &data[other.item.clone()]))
        }
        _ => {
            let leaves: Vec<&Part> = parts.iter().filter(|part| part.leaf).collect();
            let leaf = *dice.one_of(&leaves)?;
            let old = &data[leaf.content.clone()];
            let mut new = match dice.below(3) {
                _ if leaf.text => reworded(old, &mut dice),
                0 => {
                    let mut room = old.to_vec();
                    room.resize(old.len() + 64, 0);
                    let length = fuzzer_mutate(&mut room, old.len(), old.len() + 64);
                    room.truncate(length);
                    room
                }
                _ => renumbered(old, data.len(), &mut dice),
            };
            if new.len() % 2 != old.len() % 2 && !leaf.text {
                new.push(0);
            }
            Some(replaced(data, parts, leaf.content.clone(), &new))
        }
    }
}

/// A file with other bytes in a place, and the lengths of what they lie in to match.
fn replaced(data: &[u8], parts: &[Part], range: Range<usize>, new: &[u8]) -> Vec<u8> {
    let mut made = [&data[..range.start], new, &data[range.end..]].concat();
    for part in parts {
        if part.content.start > range.start || part.content.end < range.end || part.item == range {
            continue;
        }
        let Some(field) = data.get(part.length..part.length + 4) else { continue };
        let field = [field[0], field[1], field[2], field[3]];
        let told = if part.big_endian { u32::from_be_bytes(field) } else { u32::from_le_bytes(field) };
        let told = told.wrapping_add(new.len() as u32).wrapping_sub(range.len() as u32);
        let field = if part.big_endian { told.to_be_bytes() } else { told.to_le_bytes() };
        made[part.length..part.length + 4].copy_from_slice(&field);
    }
    made
}

/// Bytes with one number in them made another.
fn renumbered(old: &[u8], whole: usize, dice: &mut Dice) -> Vec<u8> {
    let mut new = old.to_vec();
    let width = [1, 2, 4, 4, 4, 8][dice.below(6)];
    if new.len() < width {
        return new;
    }
    // Fields begin at even places as a rule.
    let at = (dice.below(new.len() - width + 1) & !(width.min(4) - 1)).min(new.len() - width);
    let big_endian = dice.below(2) == 0;
    let field = &mut new[at..at + width];
    let before = field.iter().enumerate().fold(0u64, |sum, (i, &byte)| {
        sum | u64::from(byte) << (8 * if big_endian { width - 1 - i } else { i })
    });
    let value = match dice.below(8) {
        0 => before.wrapping_add(1),
        1 => before.wrapping_sub(1),
        2 => before.wrapping_mul(2),
        3 => whole as u64,
        4 => old.len() as u64,
        5 => dice.next() % 64,
        _ => dice.one_of(&NUMBERS).copied().unwrap_or(0),
    };
    for (i, byte) in field.iter_mut().enumerate() {
        *byte = (value >> (8 * if big_endian { width - 1 - i } else { i })) as u8;
    }
    new
}

/// Text with a word, a line or what stands in brackets changed.
fn reworded(old: &[u8], dice: &mut Dice) -> Vec<u8> {
    let spliced = |range: Range<usize>, new: &[u8]| {
        [&old[..range.start], new, &old[range.end.min(old.len())..]].concat()
    };
    let word = word_at(old, dice.below(old.len()));
    match dice.below(12) {
        0 | 1 => spliced(word, &old[word_at(old, dice.below(old.len()))]),
        2 => {
            let line = line_at(old, dice.below(old.len()));
            spliced(line.clone(), &[&old[line.clone()], &old[line]].concat())
        }
        3 => spliced(line_at(old, dice.below(old.len())), b""),
        4 => {
            let line = line_at(old, dice.below(old.len()));
            spliced(line_at(old, dice.below(old.len())), &old[line])
        }
        5 => spliced(bracket_at(old, dice.below(old.len())), b"[]"),
        6 => {
            let bracket = bracket_at(old, dice.below(old.len()));
            spliced(bracket.clone(), &[&old[bracket.clone()], b",", &old[bracket]].concat())
        }
        7 => {
            let bracket = bracket_at(old, dice.below(old.len()));
            spliced(bracket_at(old, dice.below(old.len())), &old[bracket])
        }
        8 => {
            let mut room = old[word.clone()].to_vec();
            let length = room.len();
            room.resize(length + 8, b'0');
            let length = fuzzer_mutate(&mut room, length, length + 8);
            spliced(word, &room[..length])
        }
        _ => {
            let words: Vec<&str> = WORDS.split(' ').collect();
            let new = dice.one_of(&words).copied().unwrap_or_default();
            spliced(word, new.as_bytes())
        }
    }
}

/// The word or number at a place or behind it.
fn word_at(text: &[u8], at: usize) -> Range<usize> {
    let inside = |byte: &u8| byte.is_ascii_alphanumeric() || b"+-._".contains(byte) || *byte > 127;
    let start = text.get(at..).and_then(|rest| rest.iter().position(inside)).map_or(text.len(), |n| at + n);
    let before = text[..start].iter().rev().take_while(|byte| inside(byte)).count();
    let behind = text[start..].iter().take_while(|byte| inside(byte)).count();
    start - before..start + behind
}

fn line_at(text: &[u8], at: usize) -> Range<usize> {
    let start = text[..at.min(text.len())].iter().rposition(|byte| *byte == b'\n').map_or(0, |n| n + 1);
    let end = text[start..].iter().position(|byte| *byte == b'\n').map_or(text.len(), |n| start + n + 1);
    start..end
}

/// What stands in brackets at a place or behind it, with them.
fn bracket_at(text: &[u8], at: usize) -> Range<usize> {
    let opens = |byte: &u8| b"[{".contains(byte);
    let Some(start) = text.get(at..).and_then(|rest| rest.iter().position(opens)).map(|n| at + n) else {
        return word_at(text, at);
    };
    let mut depth = 0usize;
    for (n, byte) in text[start..].iter().enumerate() {
        depth += usize::from(opens(byte));
        depth -= usize::from(b"]}".contains(byte));
        if depth == 0 {
            return start..start + n + 1;
        }
    }
    start..text.len()
}
