//! The letters of finger spelling, and the fist, on the shown surface: fingers that touch in life do, and nothing is inside another.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod contact;

use contact::{Contact, part};
use handcast_hand::shapes::ShapeLibrary;
use handcast_hand::{Finger, Joint, Morphology, Side};
use nalgebra::Vector3;

/// Most space between fingers that touch in life, and most of one part inside another, metres.
const MOST: f64 = 0.002;

/// Stands for the fist where letters are named.
const FIST: char = '✊';

#[test]
fn neighbours_touch_and_nothing_is_inside_another_part() {
    let library = ShapeLibrary::builtin().unwrap();
    let contact = Contact::new(&Morphology::default());
    let mut wrong = Vec::new();
    let letters = ('A'..='Z').map(|letter| (format!("asl:{letter}"), contact::touching(letter)));
    for (name, touching) in letters.chain([("fist".into(), contact::touching('S'))]) {
        let posed = contact.pose(&library.get(&name).unwrap().pose(Side::Right).angles);
        let (depth, place) = posed.depth();
        let gaps = posed.gaps(touching);
        let widest = gaps.iter().map(|(_, gap)| *gap).fold(0.0, f64::max);
        println!("{name}: {:.1} mm inside ({place}), gaps {:.1} mm", depth * 1e3, widest * 1e3);
        if depth > MOST || widest > MOST {
            wrong.push(name);
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}

#[test]
fn thumbs_are_where_signers_have_them() {
    let library = ShapeLibrary::builtin().unwrap();
    let contact = Contact::new(&Morphology::default());
    let posed = |letter: char| {
        let name = if letter == FIST { "fist".into() } else { format!("asl:{letter}") };
        contact.pose(&library.get(&name).unwrap().pose(Side::Right).angles)
    };
    let thumb = [part(Finger::Thumb, 1), part(Finger::Thumb, 2)];
    let touched = |letter: char, parts: &[usize]| {
        let gap = posed(letter).between(&thumb, parts);
        assert!(gap < MOST, "{letter}: {:.1} mm between thumb and {parts:?}", gap * 1e3);
    };
    // A: upright at the side of the index finger.
    touched('A', &[part(Finger::Index, 0), part(Finger::Index, 1)]);
    let frames = posed('A').frames;
    let end = frames.position(Joint::ThumbTip) - frames.position(Joint::ThumbDistal);
    assert!(end.angle(&Vector3::y()) < 20f64.to_radians(), "{end}");
    // M, N and T: its tip comes out between two fingers, beside their middle joints and not before both.
    for (letter, [radial, ulnar]) in [
        ('M', [Joint::RingIntermediate, Joint::PinkyIntermediate]),
        ('N', [Joint::MiddleIntermediate, Joint::RingIntermediate]),
        ('T', [Joint::IndexIntermediate, Joint::MiddleIntermediate]),
    ] {
        let frames = posed(letter).frames;
        let [tip, radial, ulnar] = [Joint::ThumbTip, radial, ulnar].map(|joint| frames.position(joint));
        assert!(ulnar.x < tip.x && tip.x < radial.x, "{letter}: {tip}");
        assert!(tip.z > 0.0 && tip.z < radial.z.max(ulnar.z), "{letter}: {tip}");
        assert!((tip - nalgebra::center(&radial, &ulnar)).norm() < 0.010, "{letter}: {tip}");
    }
    // Fists, and A: the finger tips are on the palm.
    for letter in [FIST, 'S', 'A'] {
        for finger in Finger::LONG {
            let gap = posed(letter).between(&[part(finger, 2)], &[0]);
            assert!(gap < MOST, "{letter}: {:.1} mm between {} and palm", gap * 1e3, finger.name());
        }
    }
    // E: the finger tips stand on it. S and fist: it lies across the front of the first two fingers.
    for finger in [Finger::Index, Finger::Middle, Finger::Ring] {
        touched('E', &[part(finger, 2)]);
    }
    for finger in [Finger::Index, Finger::Middle] {
        touched('S', &[part(finger, 1)]);
        touched(FIST, &[part(finger, 1)]);
    }
}
