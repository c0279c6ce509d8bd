//! The sizes of a person's hands and the tone of the skin as a record of a stream (`spec/fba-bitstream.md`, section 6).
//!
//! Sizes are written as differences from the mean hand of the same length, in steps as fine as the record has room for,
//! group by group in Rice codes.

use handcast_fba::Record;
use handcast_hand::{ClipHand, Finger, Morphology, Side, skin_tone};

/// Version of the record.
const VERSION: u32 = 1;
/// Bits of the version, and of a length of a hand in tenths of a millimetre.
const VERSION_BITS: u32 = 4;
const LENGTH_BITS: u32 = 12;
const LENGTH_STEP: f64 = 1e-4;
/// Metres of a step of joints' places, of flesh, and step of fractions, from fine to coarse.
const STEPS: [[f64; 3]; 4] = [[5e-4, 1e-3, 0.06], [5e-4, 2e-3, 0.12], [1e-3, 2e-3, 0.12], [1e-3, 4e-3, 0.25]];
/// Bits of the number of steps, and of the parameter of a group: 0 is a group without differences.
const STEPS_BITS: u32 = 2;
const RICE_BITS: u32 = 3;
/// Bits of the tone of skin behind the sizes: 0, or nothing, where it is not known.
const TONE_BITS: u32 = 4;
/// Largest number of a Rice code.
const LARGEST: u32 = 1 << 12;

/// What a size is measured in.
#[derive(Clone, Copy)]
enum Unit {
    Joint,
    Flesh,
    Fraction,
}

/// The record of the hands of a clip and of the tone of their skin, 1 to 10: none if neither that nor sizes that a person could
/// have are told.
///
/// ```
/// use handcast_codec::{hands_of_record, record_of, skin_tone_of_record};
/// use handcast_hand::{ClipHand, Morphology, Side};
///
/// let hand = ClipHand { side: Side::Left, morphology: Some(Morphology::average(0.173)) };
/// let record = record_of(&[hand.clone()], Some(4));
/// assert!(record.bytes().len() <= 6);
/// let back = hands_of_record(&record);
/// assert_eq!(back[0].side, Side::Left);
/// assert_eq!(skin_tone_of_record(&record), Some(4));
/// assert!((back[0].morphology.as_ref().unwrap().hand_length - 0.173).abs() < 1e-4);
/// ```
pub fn record_of(hands: &[ClipHand], skin_tone: Option<u8>) -> Record {
    let mut told: Vec<(Side, &Morphology)> = hands
        .iter()
        .filter_map(|hand| Some((hand.side, hand.morphology.as_ref()?)))
        .filter(|(_, sizes)| sizes.validate().is_ok())
        .collect();
    told.sort_by_key(|(side, _)| *side as usize);
    told.dedup_by_key(|(side, _)| *side);
    let skin_tone = skin_tone.filter(is_tone);
    if told.is_empty() && skin_tone.is_none() {
        return Record::default();
    }
    // Where the coarsest steps of all sizes have no room, those of the mean hand stand for the last groups, and where there is none
    // for the places of all joints, both hands of a person are as large as they are on average.
    let ways = |hands: &[(Side, &Morphology)], least: usize| {
        let groups = (least..=GROUPS.len()).rev();
        let mut ways = groups.flat_map(|groups| (0..STEPS.len()).map(move |steps| [groups, steps]));
        ways.find_map(|[groups, steps]| {
            let bytes = write(hands, skin_tone, groups, steps);
            // Sizes at their bounds may be rounded to what no hand has.
            let told = read(&bytes).filter(|(told, _)| told.len() == hands.len());
            told.and_then(|_| Record::new(&bytes).ok())
        })
    };
    let alike = |hands: &[(Side, &Morphology)]| {
        let &[(_, left), (_, right)] = hands else { return None };
        let both = averaged(left, right);
        ways(&[(Side::Left, &both), (Side::Right, &both)], JOINTS)
    };
    let rough = || ways(&told, 0).or_else(|| ways(&[], 0));
    ways(&told, JOINTS).or_else(|| alike(&told)).or_else(rough).unwrap_or_default()
}

/// Sizes half way between those of two hands.
fn averaged(one: &Morphology, other: &Morphology) -> Morphology {
    let (mut out, mut other) = (one.clone(), other.clone());
    out.hand_length = 0.5 * (out.hand_length + other.hand_length);
    for group in GROUPS {
        for ((_, value), (_, other)) in group(&mut out).into_iter().zip(group(&mut other)) {
            *value = 0.5 * (*value + *other);
        }
    }
    out
}

/// The hands that a record tells of, with their sizes; none if it tells of none, or is of a later version.
pub fn hands_of_record(record: &Record) -> Vec<ClipHand> {
    read(record.bytes()).unwrap_or_default().0
}

/// The tone of skin, 1 to 10, that a record tells of.
pub fn skin_tone_of_record(record: &Record) -> Option<u8> {
    read(record.bytes())?.1
}

/// Metres beyond which a viewer sees that sizes are others: twice what rounding to the coarsest of [`STEPS`], and hands made
/// alike, take from those of one person.
const SEEN: f64 = 2e-3;

/// Whether hands of these sizes are seen to be others: where joints are, not how thick flesh is, for which a record may have no
/// room.
pub(crate) fn differ(one: &Morphology, other: &Morphology) -> bool {
    let off = |one: f64, other: f64| (one - other).abs() > SEEN;
    let mut fingers = one.fingers.iter().zip(&other.fingers);
    off(one.hand_length, other.hand_length)
        || fingers.any(|(one, other)| {
            let places = one.bones.iter().chain(&one.base).zip(other.bones.iter().chain(&other.base));
            places.into_iter().any(|(one, other)| off(*one, *other))
        })
}

fn is_tone(tone: &u8) -> bool {
    skin_tone(*tone).is_some()
}

/// The sizes of so many of the groups.
fn write(hands: &[(Side, &Morphology)], skin_tone: Option<u8>, groups: usize, steps: usize) -> Vec<u8> {
    let mut bits = Bits::default();
    bits.put(VERSION_BITS, VERSION);
    for side in [Side::Left, Side::Right] {
        bits.put(1, hands.iter().any(|(other, _)| *other == side).into());
    }
    bits.put(STEPS_BITS, steps as u32);
    let mut before: Option<&Morphology> = None;
    for (_, sizes) in hands {
        if let Some(before) = before {
            bits.put(1, (before == *sizes).into());
            if before == *sizes {
                continue;
            }
        }
        let length = (sizes.hand_length / LENGTH_STEP).round() as u32;
        bits.put(LENGTH_BITS, length);
        let mut mean = Morphology::average(f64::from(length) * LENGTH_STEP);
        let mut given = (*sizes).clone();
        for (number, group) in GROUPS.into_iter().enumerate() {
            let wanted: Vec<f64> = group(&mut given).into_iter().map(|(_, value)| *value).collect();
            let mut fields = group(&mut mean);
            let numbers: Vec<u32> = fields
                .iter()
                .zip(&wanted)
                .map(|((unit, mean), wanted)| match number < groups {
                    true => folded(((wanted - **mean) / step(*unit, steps)).round() as i32),
                    false => 0,
                })
                .collect();
            bits.put_group(&numbers);
            for ((unit, value), number) in fields.iter_mut().zip(numbers) {
                **value += f64::from(unfolded(number)) * step(*unit, steps);
            }
            place_metacarpals(number, &mut mean);
        }
        before = Some(sizes);
    }
    if let Some(tone) = skin_tone {
        bits.put(TONE_BITS, tone.into());
    }
    bits.finish()
}

fn read(bytes: &[u8]) -> Option<(Vec<ClipHand>, Option<u8>)> {
    let mut bits = Reader { bytes, at: 0 };
    if bits.take(VERSION_BITS)? != VERSION {
        return None;
    }
    let [left, right] = [bits.take(1)?, bits.take(1)?];
    let steps = bits.take(STEPS_BITS)? as usize;
    let mut hands: Vec<ClipHand> = Vec::new();
    for (side, there) in [(Side::Left, left), (Side::Right, right)] {
        if there == 0 {
            continue;
        }
        if let Some(before) = hands.last().and_then(|hand| hand.morphology.clone())
            && bits.take(1)? == 1
        {
            hands.push(ClipHand { side, morphology: Some(before) });
            continue;
        }
        let mut sizes = Morphology::average(f64::from(bits.take(LENGTH_BITS)?) * LENGTH_STEP);
        for (number, group) in GROUPS.into_iter().enumerate() {
            let mut fields = group(&mut sizes);
            let numbers = bits.take_group(fields.len())?;
            for ((unit, value), number) in fields.iter_mut().zip(numbers) {
                **value += f64::from(unfolded(number)) * step(*unit, steps);
            }
            place_metacarpals(number, &mut sizes);
        }
        sizes.validate().ok()?;
        hands.push(ClipHand { side, morphology: Some(sizes) });
    }
    // Records made before end here, or in less than a byte of zeros.
    let tone = bits.take(TONE_BITS).and_then(|tone| u8::try_from(tone).ok()).filter(is_tone);
    Some((hands, tone))
}

fn step(unit: Unit, steps: usize) -> f64 {
    let [joint, flesh, fraction] = STEPS[steps.min(STEPS.len() - 1)];
    match unit {
        Unit::Joint => joint,
        Unit::Flesh => flesh,
        Unit::Fraction => fraction,
    }
}

type Group = fn(&mut Morphology) -> Vec<(Unit, &mut f64)>;

/// The sizes in the order in which they are written; metacarpals behind bases, as they follow from those.
const GROUPS: [Group; 8] = [
    |m| m.fingers.iter_mut().flat_map(|f| &mut f.bones).map(|v| (Unit::Joint, v)).collect(),
    |m| m.fingers.iter_mut().flat_map(|f| &mut f.base).map(|v| (Unit::Joint, v)).collect(),
    |m| m.fingers.iter_mut().flat_map(|f| &mut f.metacarpal).map(|v| (Unit::Joint, v)).collect(),
    |m| {
        let palm = [&mut m.palm_radius, &mut m.wrist_half_width, &mut m.ulnar_border, &mut m.wrist_lateral];
        palm.into_iter().map(|v| (Unit::Flesh, v)).collect()
    },
    |m| {
        let root = [&mut m.web_root, &mut m.forearm];
        m.webs.iter_mut().chain(root).map(|v| (Unit::Fraction, v)).collect()
    },
    |m| m.fingers.iter_mut().flat_map(|f| &mut f.radii).map(|v| (Unit::Flesh, v)).collect(),
    |m| m.fingers.iter_mut().flat_map(|f| &mut f.waists).map(|v| (Unit::Fraction, v)).collect(),
    |m| m.fingers.iter_mut().flat_map(|f| &mut f.lateral).map(|v| (Unit::Flesh, v)).collect(),
];

/// Groups that say where joints are, by which fingertips are.
const JOINTS: usize = 2;

/// Number of the group of bases, behind which metacarpals are where they begin when nobody measured them.
const BASES: usize = 1;

fn place_metacarpals(group: usize, sizes: &mut Morphology) {
    if group == BASES {
        for (finger, sizes) in Finger::ALL.into_iter().zip(&mut sizes.fingers) {
            sizes.place_metacarpal(finger);
        }
    }
}

/// Signs folded in.
fn folded(number: i32) -> u32 {
    ((number << 1) ^ (number >> 31)) as u32
}

fn unfolded(number: u32) -> i32 {
    (number >> 1) as i32 ^ -((number & 1) as i32)
}

/// Bits to bytes, the highest first.
#[derive(Default)]
struct Bits {
    bytes: Vec<u8>,
    used: u32,
}

impl Bits {
    fn put(&mut self, width: u32, value: u32) {
        for shift in (0..width).rev() {
            if self.used.is_multiple_of(8) {
                self.bytes.push(0);
            }
            if let Some(last) = self.bytes.last_mut() {
                *last |= ((value >> shift & 1) as u8) << (7 - self.used % 8);
            }
            self.used += 1;
        }
    }

    /// Numbers in Rice codes of the best parameter.
    fn put_group(&mut self, numbers: &[u32]) {
        if numbers.iter().all(|&number| number == 0) {
            return self.put(RICE_BITS, 0);
        }
        let bits = |low: u32| numbers.iter().map(|number| (number >> low) + 1 + low).sum::<u32>();
        let low = (0..(1 << RICE_BITS) - 1).min_by_key(|&low| bits(low)).unwrap_or(0);
        self.put(RICE_BITS, low + 1);
        for number in numbers {
            (0..number >> low).for_each(|_| self.put(1, 1));
            self.put(1, 0);
            self.put(low, number & ((1 << low) - 1));
        }
    }

    fn finish(self) -> Vec<u8> {
        self.bytes
    }
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: u32,
}

impl Reader<'_> {
    fn take(&mut self, width: u32) -> Option<u32> {
        (0..width).try_fold(0, |value, _| {
            let byte = self.bytes.get((self.at / 8) as usize)?;
            let bit = byte >> (7 - self.at % 8) & 1;
            self.at += 1;
            Some(value << 1 | u32::from(bit))
        })
    }

    fn take_group(&mut self, count: usize) -> Option<Vec<u32>> {
        let low = self.take(RICE_BITS)?;
        let Some(low) = low.checked_sub(1) else { return Some(vec![0; count]) };
        let mut number = || {
            let mut high = 0;
            while self.take(1)? == 1 {
                high += 1;
                if high > LARGEST >> low {
                    return None;
                }
            }
            Some(high << low | self.take(low)?)
        };
        (0..count).map(|_| number()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A hand whose sizes are off the mean by so many millimetres, or hundredths, at most.
    fn person(length: f64, off: f64, seed: u32) -> Morphology {
        let mut state = seed;
        let mut sizes = Morphology::average(length);
        for (number, group) in GROUPS.into_iter().enumerate() {
            for (unit, value) in group(&mut sizes) {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let unit = if matches!(unit, Unit::Fraction) { 1e-2 } else { 1e-3 };
                *value += off * unit * (f64::from(state >> 8) / f64::from(1 << 23) - 1.0);
            }
            place_metacarpals(number, &mut sizes);
        }
        sizes
    }

    fn hand(side: Side, sizes: &Morphology) -> ClipHand {
        ClipHand { side, morphology: Some(sizes.clone()) }
    }

    proptest! {
        #[test]
        fn sizes_come_back(length in 0.15f64..0.21, off in 0.0f64..2.0, seed: u32, other in 0usize..3, tone in 0u8..12) {
            let sizes = person(length, off, seed);
            let hands = match other {
                0 => vec![hand(Side::Right, &sizes)],
                1 => vec![hand(Side::Left, &sizes), hand(Side::Right, &sizes)],
                _ => vec![hand(Side::Right, &sizes), hand(Side::Left, &Morphology::average(length))],
            };
            let told = (1..=10).contains(&tone).then_some(tone);
            let record = record_of(&hands, Some(tone));
            prop_assert!(!record.is_empty());
            prop_assert_eq!(skin_tone_of_record(&record), told);
            let back = hands_of_record(&record);
            prop_assert_eq!(back.len(), hands.len());
            for hand in hands {
                let mut wanted = hand.morphology.unwrap();
                let mut found = back.iter().find(|b| b.side == hand.side).unwrap().morphology.clone().unwrap();
                for group in GROUPS {
                    for ((unit, found), (_, wanted)) in group(&mut found).into_iter().zip(group(&mut wanted)) {
                        let most = match unit { Unit::Joint => 0.6e-3, Unit::Flesh => 2.1e-3, Unit::Fraction => 0.13 };
                        prop_assert!((*found - *wanted).abs() <= most, "{} for {}", found, wanted);
                    }
                }
            }
        }

        #[test]
        fn any_bytes_are_survived(bytes in prop::collection::vec(any::<u8>(), 0..=Record::MAX)) {
            let hands = hands_of_record(&Record::new(&bytes).unwrap());
            prop_assert!(hands.iter().all(|hand| hand.morphology.as_ref().unwrap().validate().is_ok()));
        }
    }

    /// Of two hands far from the mean bones and bases are kept, whatever becomes of their flesh.
    #[test]
    fn what_has_no_room_is_left_to_the_mean_hand() {
        for seed in 0..20 {
            let [left, right] = [0, 1].map(|hand| person(0.18, 9.0, 2 * seed + hand));
            let hands = [hand(Side::Left, &left), hand(Side::Right, &right)];
            let hands: Vec<_> = hands
                .into_iter()
                .filter(|hand| hand.morphology.as_ref().unwrap().validate().is_ok())
                .collect();
            let record = record_of(&hands, Some(6));
            assert_eq!(skin_tone_of_record(&record), Some(6));
            let back = hands_of_record(&record);
            assert_eq!(back.len(), hands.len());
            for (wanted, found) in hands.iter().zip(&back) {
                let [wanted, found] = [wanted, found].map(|hand| hand.morphology.as_ref().unwrap());
                for (wanted, found) in wanted.fingers.iter().zip(&found.fingers) {
                    for (wanted, found) in wanted.bones.iter().zip(&found.bones) {
                        assert!((wanted - found).abs() < 1e-3, "{seed}: {found} for {wanted}");
                    }
                }
            }
        }
    }

    #[test]
    fn hands_without_sizes_need_no_record() {
        let unknown = [ClipHand { side: Side::Left, morphology: None }];
        assert!(record_of(&unknown, None).is_empty());
        let toned = record_of(&unknown, Some(10));
        assert_eq!((toned.bytes().len(), skin_tone_of_record(&toned)), (2, Some(10)));
        assert!(hands_of_record(&toned).is_empty());
        assert!(hands_of_record(&Record::default()).is_empty());
        let later = Record::new(&[0x2f, 1, 2, 3]).unwrap();
        assert!(hands_of_record(&later).is_empty());
    }
}
