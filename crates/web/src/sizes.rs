//! A hand's sizes as JavaScript gets them.

use handcast_hand::{Finger, Joint, Morphology};

pub use handcast_hand::sizes::{SIZES, from_numbers, numbers};

/// Radii of the 25 joints, metres: those of the flesh; of the wrist and the metacarpals half the palm's thickness.
pub fn radii(sizes: &Morphology) -> [f32; Joint::COUNT] {
    let mut radii = [sizes.palm_radius as f32; Joint::COUNT];
    for finger in Finger::ALL {
        let joints = Joint::of(finger);
        for (joint, radius) in joints[joints.len() - 4..].iter().zip(sizes.finger(finger).radii) {
            radii[joint.index()] = radius as f32;
        }
    }
    radii
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joints_are_as_thick_as_the_flesh() {
        let sizes = Morphology::default();
        let radii = radii(&sizes);
        assert_eq!(radii[Joint::Wrist.index()], sizes.palm_radius as f32);
        assert_eq!(radii[Joint::RingMetacarpal.index()], sizes.palm_radius as f32);
        assert_eq!(radii[Joint::ThumbMetacarpal.index()], sizes.fingers[0].radii[0] as f32);
        assert_eq!(radii[Joint::PinkyTip.index()], sizes.fingers[4].radii[3] as f32);
    }
}
