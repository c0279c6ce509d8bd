//! Damage of a stream that was passed over.

use handcast_fba::SyntaxError;

/// Damage that was passed over: how often, and the first of it. A stream may be damaged without end.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Damage {
    first: Vec<SyntaxError>,
    count: usize,
    pub(crate) abandoned: u64,
}

impl Damage {
    /// Of how many places is told what was wrong with them.
    pub const MOST: usize = 256;

    /// What was wrong with the first [`Self::MOST`] places, in order.
    pub fn first(&self) -> &[SyntaxError] {
        &self.first
    }

    /// How many places were damaged.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Bytes from damage that no I plane follows up to the end of its stream: what they told is lost.
    pub fn abandoned(&self) -> u64 {
        self.abandoned
    }

    /// How many are not among the first.
    pub fn further(&self) -> usize {
        self.count - self.first.len()
    }

    pub(crate) fn add(&mut self, error: SyntaxError) {
        self.count = self.count.saturating_add(1);
        if self.first.len() < Self::MOST {
            self.first.push(error);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_is_counted_and_the_first_kept() {
        let mut damage = Damage::default();
        let place = |bit: usize| SyntaxError::Implausible { bit: bit as u64 };
        (0..Damage::MOST).for_each(|bit| damage.add(place(bit)));
        assert_eq!((damage.count(), damage.further()), (Damage::MOST, 0));
        (0..1000).for_each(|bit| damage.add(place(bit)));
        assert_eq!((damage.count(), damage.further()), (Damage::MOST + 1000, 1000));
        let expected: Vec<_> = (0..Damage::MOST).map(place).collect();
        assert_eq!(damage.first(), expected);
    }
}
