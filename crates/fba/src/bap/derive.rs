//! BAPs that need not be sent because they follow from others, as a hand's end joint bends with its middle joint.
//!
//! No field of the syntax says that a value is to be derived. The rule is: a stream that sends the driver of a
//! [`Tie`] but not what is driven leaves that to the decoder's model (`spec/NOTES.md`). Our encoder sends what is
//! driven along with what drives it unless told to leave it out, and then, too, where the tie is not firm. Which BAPs are
//! tied is the model's business: the functions here take any list of ties.

use super::{Bap, BapFrame, BapMask};

/// A BAP whose value follows from that of another.
#[derive(Clone, Copy, Debug)]
pub struct Tie {
    /// The BAP that drives.
    pub driver: Bap,
    /// The BAP that is driven.
    pub driven: Bap,
    /// The value of the driven BAP from that of its driver, each in its own unit.
    pub law: fn(i32) -> i32,
    /// Whether what moves keeps to the law so well that an encoder may leave out what is driven.
    pub firm: bool,
}

/// Laws are equal when they are the same function.
impl PartialEq for Tie {
    fn eq(&self, other: &Self) -> bool {
        let same = std::ptr::fn_addr_eq(self.law, other.law);
        same && (self.driver, self.driven, self.firm) == (other.driver, other.driven, other.firm)
    }
}

/// The BAPs that others can drive.
pub fn driven(ties: &[Tie]) -> BapMask {
    ties.iter().map(|tie| tie.driven).collect()
}

/// The BAPs that a decoder derives when just those of `mask` are sent.
///
/// ```
/// use handcast_fba::bap::derive::{Tie, left_to_model};
/// use handcast_fba::bap::{Bap, BapMask};
///
/// let [driver, driven] = ["r_index2_flexion", "r_index3_flexion"].map(|name| Bap::from_name(name).unwrap());
/// let ties = [Tie { driver, driven, law: |value| value / 2, firm: true }];
/// let sent: BapMask = [driver].into_iter().collect();
/// assert_eq!(left_to_model(&ties, &sent).iter().collect::<Vec<_>>(), [driven]);
/// ```
pub fn left_to_model(ties: &[Tie], mask: &BapMask) -> BapMask {
    let left = ties.iter().filter(|tie| mask.contains(tie.driver) && !mask.contains(tie.driven));
    left.map(|tie| tie.driven).collect()
}

/// The BAPs of `mask` driven by others of `mask` that `keep` holds: to be sent with them, lest they be
/// derived.
pub fn companions(ties: &[Tie], mask: &BapMask, keep: &BapMask) -> BapMask {
    let kept = ties.iter().filter(|tie| keep.contains(tie.driver) && mask.contains(tie.driven));
    kept.map(|tie| tie.driven).collect()
}

/// Adds to a frame the BAPs that are left to the model.
pub fn fill_in(ties: &[Tie], frame: &mut BapFrame) {
    let mask = frame.mask;
    for tie in ties.iter().filter(|tie| mask.contains(tie.driver) && !mask.contains(tie.driven)) {
        frame.set(tie.driven, (tie.law)(frame.value(tie.driver)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bap(number: u16) -> Bap {
        Bap::new(number).unwrap()
    }

    fn mask(numbers: &[u16]) -> BapMask {
        numbers.iter().map(|&number| bap(number)).collect()
    }

    /// 1 drives 2, 3 drives 4.
    fn ties() -> [Tie; 2] {
        [[1, 2], [3, 4]].map(|[driver, driven]| Tie {
            driver: bap(driver),
            driven: bap(driven),
            law: |v| 10 * v,
            firm: true,
        })
    }

    #[test]
    fn sets_follow_the_ties() {
        let ties = ties();
        assert_eq!(driven(&ties), mask(&[2, 4]));
        assert_eq!(left_to_model(&ties, &mask(&[1, 3, 4, 5])), mask(&[2]));
        assert_eq!(left_to_model(&ties, &mask(&[2, 4])), BapMask::EMPTY);
        assert_eq!(companions(&ties, &mask(&[1, 2, 3, 4]), &mask(&[1])), mask(&[2]));
        assert_eq!(companions(&ties, &mask(&[1, 3]), &mask(&[1, 3])), BapMask::EMPTY);
        assert_eq!(left_to_model(&[], &mask(&[1, 3])), BapMask::EMPTY);
    }

    #[test]
    fn what_was_sent_is_not_derived() {
        let mut frame: BapFrame = [(bap(1), 7), (bap(3), 8), (bap(4), 9)].into_iter().collect();
        fill_in(&ties(), &mut frame);
        assert_eq!([1, 2, 3, 4].map(|n| frame.get(bap(n))), [7, 70, 8, 9].map(Some));
    }
}
