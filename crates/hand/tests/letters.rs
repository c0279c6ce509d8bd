//! The letters of finger spelling on the shown surface: fingers that touch in life do, and nothing is inside another.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod contact;

use contact::Contact;
use handcast_hand::shapes::ShapeLibrary;
use handcast_hand::{Morphology, Side};

/// Most space between fingers that touch in life, and most of one part inside another, metres.
const MOST: f64 = 0.002;

#[test]
fn neighbours_touch_and_nothing_is_inside_another_part() {
    let library = ShapeLibrary::builtin().unwrap();
    let contact = Contact::new(&Morphology::default());
    let mut wrong = Vec::new();
    for letter in 'A'..='Z' {
        let pose = library.get(&format!("asl:{letter}")).unwrap().pose(Side::Right);
        let posed = contact.pose(&pose.angles);
        let (depth, place) = posed.depth();
        let gaps = posed.gaps(contact::touching(letter));
        let widest = gaps.iter().map(|(_, gap)| *gap).fold(0.0, f64::max);
        println!("{letter}: {:.1} mm inside ({place}), gaps {:.1} mm", depth * 1e3, widest * 1e3);
        if depth > MOST || widest > MOST {
            wrong.push(letter);
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}
