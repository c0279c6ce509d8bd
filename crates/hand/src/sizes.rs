//! A hand's sizes as a row of numbers, in which pages, modules and JavaScript hand them on.

use super::{Finger, Morphology};

/// Numbers of a hand's sizes: of the whole hand, then of each finger, thumb first, in the order of [`Morphology`] and
/// [`super::FingerMorphology`].
pub const SIZES: usize = 11 + 23 * Finger::COUNT;

/// The sizes of a hand as numbers.
pub fn numbers(sizes: &Morphology) -> [f64; SIZES] {
    let mut sizes = sizes.clone();
    let mut numbers = [0.0; SIZES];
    for (number, field) in numbers.iter_mut().zip(fields(&mut sizes)) {
        *number = *field;
    }
    numbers
}

/// The hand that numbers tell of, if there are [`SIZES`] of them and a person could have it.
pub fn from_numbers(numbers: &[f64]) -> Option<Morphology> {
    let mut sizes = Morphology::default();
    if numbers.len() != SIZES {
        return None;
    }
    for (field, number) in fields(&mut sizes).zip(numbers) {
        *field = *number;
    }
    sizes.validate().is_ok().then_some(sizes)
}

fn fields(sizes: &mut Morphology) -> impl Iterator<Item = &mut f64> {
    let whole = [&mut sizes.hand_length, &mut sizes.palm_radius, &mut sizes.wrist_half_width]
        .into_iter()
        .chain(&mut sizes.webs)
        .chain([&mut sizes.web_root, &mut sizes.ulnar_border, &mut sizes.wrist_lateral, &mut sizes.forearm]);
    whole.chain(sizes.fingers.iter_mut().flat_map(|finger| {
        let places = finger.metacarpal.iter_mut().chain(&mut finger.base).chain(&mut finger.bones);
        places.chain(&mut finger.radii).chain(&mut finger.waists).chain(&mut finger.lateral)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_go_there_and_back() {
        let mut sizes = Morphology::average(0.171);
        sizes.fingers[4].lateral[6] = 0.001;
        sizes.webs[3] = 0.5;
        let row = numbers(&sizes);
        assert_eq!(from_numbers(&row), Some(sizes.clone()));
        assert_eq!([row[0], row[6], row[SIZES - 1]], [0.171, 0.5, 0.001]);
        assert!(row[..SIZES - 1].iter().filter(|v| **v == 0.001).count() == 0);
        // Every number counts.
        for at in 0..SIZES {
            let mut wrong = row;
            wrong[at] = f64::NAN;
            assert_eq!(from_numbers(&wrong), None, "{at}");
        }
        assert_eq!(from_numbers(&row[1..]), None);
    }
}
