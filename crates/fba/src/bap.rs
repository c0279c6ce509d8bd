//! BAPs (body animation parameters): the table of the standard, frames of values, and text formats.
//!
//! Numbers, names, groups, base steps and default limits follow `spec/bap-table.csv`; the coding
//! order of the groups is that of `spec/fba-bitstream.md` section 1.6.

pub mod derive;
pub mod epf;
mod frames;
mod table;
pub mod text;

pub use derive::Tie;
pub use frames::{BapFrames, Iter as BapFramesIter, TimedBapFrame};

use bitvec::array::BitArray;
use bitvec::order::Lsb0;

/// Number of BAPs a stream can carry: 186 defined and 110 extension BAPs.
pub const BAP_COUNT: usize = 296;
/// Number of BAPs the standard defines.
pub const DEFINED_COUNT: usize = 186;
/// Units of an angle BAP per radian.
pub const PER_RADIAN: f64 = 1e5;
/// Number of coding groups.
pub const GROUP_COUNT: usize = 24;
/// Default limits of an extension BAP in base steps, for I and P planes; the sources give none, so
/// the largest codable range stands in.
const EXTENSION_LIMITS: [i32; 2] = [-1860, 1860];

/// The number of a BAP, 1 to 296.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Bap(u16);

impl Bap {
    /// The BAP with this number, if it is one of 1 to 296.
    pub const fn new(number: u16) -> Option<Self> {
        if number >= 1 && number as usize <= BAP_COUNT { Some(Self(number)) } else { None }
    }

    /// The BAP with this zero-based index (number − 1), if it is below 296.
    pub const fn from_index(index: usize) -> Option<Self> {
        if index < BAP_COUNT { Some(Self(index as u16 + 1)) } else { None }
    }

    /// The BAP with this name, as in the table (`r_index1_flexion`, `extension_187`).
    pub fn from_name(name: &str) -> Option<Self> {
        if let Some(number) = name.strip_prefix("extension_") {
            let number = number.parse().ok()?;
            return Self::new(number).filter(|bap| bap.is_extension());
        }
        let index = table::DEFINED.iter().position(|info| info.name == name)?;
        Self::from_index(index)
    }

    /// All 296 BAPs in ascending order.
    pub fn all() -> impl ExactSizeIterator<Item = Self> + Clone {
        (1..=BAP_COUNT as u16).map(Self)
    }

    /// The number, 1 to 296.
    pub const fn number(self) -> u16 {
        self.0
    }

    /// The zero-based index, 0 to 295.
    pub const fn index(self) -> usize {
        self.0 as usize - 1
    }

    /// Whether this is one of the 110 user-defined extension BAPs (187 to 296).
    pub const fn is_extension(self) -> bool {
        self.0 as usize > DEFINED_COUNT
    }

    /// The row of the standard's table; `None` for extension BAPs.
    pub fn info(self) -> Option<&'static BapInfo> {
        table::DEFINED.get(self.index())
    }

    /// The unit of its value.
    pub fn unit(self) -> Unit {
        self.info().map_or(Unit::Extension, |info| info.unit)
    }

    /// The base quantiser step, in the unit of the value; 1 for extension BAPs.
    pub fn base_step(self, steps: StepTable) -> i32 {
        self.info().map_or(1, |info| match steps {
            StepTable::Standard => info.step_standard,
            StepTable::Visage => info.step_visage,
        })
    }

    /// Default limits of an I value in base steps, `[minimum, maximum]`.
    pub fn intra_limits(self) -> [i32; 2] {
        self.info().map_or(EXTENSION_LIMITS, |info| info.intra_limits)
    }

    /// Default limits of a P difference in base steps, `[minimum, maximum]`.
    pub fn predicted_limits(self) -> [i32; 2] {
        self.info().map_or(EXTENSION_LIMITS, |info| info.predicted_limits)
    }

    /// The coding group, 1 to 24, that lists this BAP.
    pub fn group(self) -> usize {
        GROUPS.iter().position(|members| members.contains(&self.0)).map_or(0, |position| position + 1)
    }
}

impl std::fmt::Display for Bap {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.info() {
            Some(info) => write!(f, "{} ({})", self.0, info.name),
            None => write!(f, "{} (extension_{})", self.0, self.0),
        }
    }
}

/// What a BAP value counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Unit {
    /// 1e-5 radian.
    Angle,
    /// Millimetre.
    Millimetre,
    /// Whatever the producer of an extension BAP means by it.
    Extension,
}

/// One row of the standard's BAP table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BapInfo {
    /// Name, for example `r_index1_flexion`.
    pub name: &'static str,
    /// Unit of the value.
    pub unit: Unit,
    /// Base quantiser step of the standard's table.
    pub step_standard: i32,
    /// Base quantiser step that the vendor's products use.
    pub step_visage: i32,
    /// Default I limits in base steps, `[minimum, maximum]`.
    pub intra_limits: [i32; 2],
    /// Default P limits in base steps, `[minimum, maximum]`.
    pub predicted_limits: [i32; 2],
}

/// Which table of base quantiser steps a stream was made with. The stream itself does not say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum StepTable {
    /// The table printed with the standard.
    #[default]
    Standard,
    /// The table compiled into the vendor's encoder and decoder: 170 in place of 64 and 128, and 2
    /// for the three root translations.
    Visage,
}

/// The 24 coding groups: BAP numbers in the order in which masks, ranges and values are coded.
pub static GROUPS: [&[u16]; GROUP_COUNT] = [
    &[1, 2, 3],
    &[4, 6, 10, 14],
    &[5, 7, 11, 15],
    &[8, 12, 16, 18, 20, 22],
    &[9, 13, 17, 19, 21, 23],
    &[32, 34, 36, 38, 42],
    &[33, 35, 37, 39, 43],
    &[24, 26, 28, 30, 40, 44, 46],
    &[25, 27, 29, 31, 41, 45, 47],
    &[48, 49, 50, 60, 61, 62, 87, 88, 89, 114, 115, 116],
    &[54, 55, 56, 72, 73, 74, 99, 100, 101, 108, 109, 110, 120, 121, 122],
    &[57, 58, 59, 66, 67, 68, 81, 82, 83, 93, 94, 95, 105, 106, 107, 117, 118, 119],
    &[63, 64, 65, 69, 70, 71, 75, 76, 77, 90, 91, 92, 102, 103, 104, 111, 112, 113],
    &[51, 52, 53, 78, 79, 80, 84, 85, 86, 96, 97, 98],
    &[125, 131, 133, 137, 143, 145, 149, 155, 157, 161, 167, 169, 171, 173, 177, 179],
    &[126, 132, 134, 138, 144, 146, 150, 156, 158, 162, 168, 170, 172, 174, 178, 180],
    &[123, 127, 129, 135, 139, 141, 147, 151, 153, 159, 163, 165, 175],
    &[124, 128, 130, 136, 140, 142, 148, 152, 154, 160, 164, 166, 176],
    &[181, 182, 183, 184, 185, 186],
    &EXTENSION_1,
    &EXTENSION_2,
    &EXTENSION_3,
    &EXTENSION_4,
    &EXTENSION_5,
];

static EXTENSION_1: [u16; 22] = consecutive(187);
static EXTENSION_2: [u16; 22] = consecutive(209);
static EXTENSION_3: [u16; 22] = consecutive(231);
static EXTENSION_4: [u16; 22] = consecutive(253);
static EXTENSION_5: [u16; 22] = consecutive(275);

const fn consecutive(first: u16) -> [u16; 22] {
    let mut numbers = [0; 22];
    let mut i = 0;
    while i < 22 {
        numbers[i] = first + i as u16;
        i += 1;
    }
    numbers
}

/// The members of group `group` (0 to 23 for groups 1 to 24) in coding order; empty beyond.
pub fn group_members(group: usize) -> impl Iterator<Item = Bap> + Clone {
    GROUPS.get(group).copied().unwrap_or_default().iter().map(|&number| Bap(number))
}

/// All 296 BAPs in coding order: group by group, list order inside a group.
pub fn coding_order() -> impl Iterator<Item = Bap> + Clone {
    GROUPS.iter().flat_map(|members| members.iter().map(|&number| Bap(number)))
}

// Words of 32 bits: those of 64 are no bit store on 32-bit machines, wasm among them.
type Bits = BitArray<[u32; 10], Lsb0>;

/// A set of BAPs.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct BapMask(Bits);

impl BapMask {
    /// The empty set.
    pub const EMPTY: Self = Self(Bits::ZERO);

    /// Whether `bap` is in the set.
    pub fn contains(&self, bap: Bap) -> bool {
        let word = self.0.as_raw_slice().get(bap.index() / 32);
        word.is_some_and(|word| word >> (bap.index() % 32) & 1 == 1)
    }

    /// Puts `bap` in the set (`on`) or takes it out.
    pub fn set(&mut self, bap: Bap, on: bool) {
        self.0.set(bap.index(), on);
    }

    /// Puts `bap` in the set.
    pub fn insert(&mut self, bap: Bap) {
        self.set(bap, true);
    }

    /// Number of BAPs in the set.
    pub fn len(&self) -> usize {
        self.0.count_ones()
    }

    /// Whether the set is empty.
    pub fn is_empty(&self) -> bool {
        self.0.as_raw_slice().iter().all(|&word| word == 0)
    }

    /// The members in ascending order of number.
    pub fn iter(&self) -> impl Iterator<Item = Bap> + '_ {
        // Word by word: sets are gone through for every frame.
        let mut words = self.0.as_raw_slice();
        let (mut first, mut left) = (0, 0);
        std::iter::from_fn(move || {
            while left == 0 {
                let (word, behind) = words.split_first()?;
                (words, left) = (behind, *word);
                first += 32;
            }
            let bit = left.trailing_zeros() as usize;
            left &= left - 1;
            Bap::from_index(first - 32 + bit)
        })
    }

    /// The members in coding order.
    pub fn in_coding_order(&self) -> impl Iterator<Item = Bap> + '_ {
        coding_order().filter(|&bap| self.contains(bap))
    }

    /// The members of either set.
    pub fn union(&self, other: &Self) -> Self {
        self.by_words(other, |a, b| a | b)
    }

    /// The members of both sets.
    pub fn intersection(&self, other: &Self) -> Self {
        self.by_words(other, |a, b| a & b)
    }

    /// The members of this set that are not in `other`.
    pub fn difference(&self, other: &Self) -> Self {
        self.by_words(other, |a, b| a & !b)
    }

    /// Word by word, as [`Self::iter`].
    fn by_words(mut self, other: &Self, combine: impl Fn(u32, u32) -> u32) -> Self {
        let words = self.0.as_raw_mut_slice().iter_mut().zip(other.0.as_raw_slice());
        words.for_each(|(word, other)| *word = combine(*word, *other));
        self
    }
}

impl Default for BapMask {
    fn default() -> Self {
        Self::EMPTY
    }
}

impl FromIterator<Bap> for BapMask {
    fn from_iter<I: IntoIterator<Item = Bap>>(baps: I) -> Self {
        let mut mask = Self::EMPTY;
        baps.into_iter().for_each(|bap| mask.insert(bap));
        mask
    }
}

impl std::fmt::Debug for BapMask {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_set().entries(self.iter().map(Bap::number)).finish()
    }
}

/// The values of one instant: which BAPs are given, and the value of each in its own unit (1e-5 rad,
/// millimetres, or the extension's own).
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct BapFrame {
    /// The BAPs that are given.
    pub mask: BapMask,
    values: [i32; BAP_COUNT],
}

impl BapFrame {
    /// A frame that gives nothing.
    pub const EMPTY: Self = Self { mask: BapMask::EMPTY, values: [0; BAP_COUNT] };

    /// A frame of these values, by BAP index, of which those in `mask` are given.
    pub fn with_values(mask: BapMask, values: [i32; BAP_COUNT]) -> Self {
        Self { mask, values }
    }

    /// The value of `bap`, if it is given.
    pub fn get(&self, bap: Bap) -> Option<i32> {
        self.mask.contains(bap).then(|| self.value(bap))
    }

    /// The stored value of `bap`, whether it is given or not (0 if never set).
    pub fn value(&self, bap: Bap) -> i32 {
        self.values.get(bap.index()).copied().unwrap_or(0)
    }

    /// The stored values of all BAPs, by BAP index.
    pub fn values(&self) -> &[i32; BAP_COUNT] {
        &self.values
    }

    /// Gives `bap` the value `value`.
    pub fn set(&mut self, bap: Bap, value: i32) {
        self.mask.insert(bap);
        self.set_value(bap, value);
    }

    /// Stores a value without changing which BAPs are given.
    pub(crate) fn set_value(&mut self, bap: Bap, value: i32) {
        if let Some(slot) = self.values.get_mut(bap.index()) {
            *slot = value;
        }
    }

    /// The same frame, which does not give those in `mask`.
    pub fn without(&self, mask: &BapMask) -> Self {
        Self { mask: self.mask.difference(mask), ..*self }
    }

    /// The given BAPs and their values in ascending order of number.
    pub fn iter(&self) -> impl Iterator<Item = (Bap, i32)> + '_ {
        self.mask.iter().map(|bap| (bap, self.value(bap)))
    }
}

impl Default for BapFrame {
    fn default() -> Self {
        Self::EMPTY
    }
}

impl FromIterator<(Bap, i32)> for BapFrame {
    fn from_iter<I: IntoIterator<Item = (Bap, i32)>>(values: I) -> Self {
        let mut frame = Self::EMPTY;
        values.into_iter().for_each(|(bap, value)| frame.set(bap, value));
        frame
    }
}

impl std::fmt::Debug for BapFrame {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_map().entries(self.iter().map(|(bap, value)| (bap.number(), value))).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CSV: &str = include_str!("../../../spec/bap-table.csv");

    #[test]
    fn table_and_groups_equal_the_csv() {
        let mut rows = 0;
        for line in CSV.lines().skip(1) {
            let cells: Vec<&str> = line.split(',').collect();
            let number = |column: usize| cells[column].parse::<i32>().unwrap();
            let bap = Bap::new(number(0) as u16).unwrap();
            let info = bap.info().unwrap();
            assert_eq!(info.name, cells[1]);
            assert_eq!(Bap::from_name(cells[1]), Some(bap));
            assert_eq!(bap.group(), number(2) as usize);
            assert_eq!(GROUPS[number(2) as usize - 1][number(3) as usize - 1], bap.number());
            assert_eq!(info.unit == Unit::Millimetre, cells[4] == "mm");
            assert_eq!(bap.base_step(StepTable::Standard), number(5));
            assert_eq!(bap.base_step(StepTable::Visage), number(6));
            assert_eq!(bap.intra_limits(), [number(7), number(8)]);
            assert_eq!(bap.predicted_limits(), [number(9), number(10)]);
            rows += 1;
        }
        assert_eq!(rows, DEFINED_COUNT);
    }

    #[test]
    fn groups_list_every_bap_once() {
        let mut seen = BapMask::EMPTY;
        for bap in coding_order() {
            assert!(!seen.contains(bap), "{bap} twice");
            seen.insert(bap);
        }
        assert_eq!(seen.len(), BAP_COUNT);
        assert_eq!(group_members(14).chain(group_members(16)).count(), 29);
    }

    #[test]
    fn mask_sets() {
        let [a, b, c] = [1, 64, 296].map(|n| Bap::new(n).unwrap());
        let first: BapMask = [a, b].into_iter().collect();
        let second: BapMask = [b, c].into_iter().collect();
        assert_eq!(first.union(&second).len(), 3);
        assert_eq!(first.intersection(&second).iter().collect::<Vec<_>>(), [b]);
        assert_eq!(first.difference(&second).iter().collect::<Vec<_>>(), [a]);
        assert_eq!(Bap::new(0), None);
        assert_eq!(Bap::new(297), None);
    }
}
