//! Hands of made-up people.

use handcast_hand::Morphology;
use handcast_hand::anthropometry::{Bounds, check};
use handcast_hand::random::Random;

/// A hand of human size and proportions, chosen by `seed`: all 21 anthropometric constraints hold
/// ([`Bounds::Persons`]). The same seed makes the same hand.
pub fn random_morphology(seed: u64) -> Morphology {
    let mut random = Random::new(seed, 3);
    for _ in 0..100 {
        let m = draw(&mut random);
        if m.validate().is_ok() && check(&m, Bounds::Persons).is_empty() {
            return m;
        }
    }
    Morphology::default()
}

fn draw(random: &mut Random) -> Morphology {
    let length = f64::from(random.range(0.165, 0.208));
    let mut m = Morphology::average(length);
    let mut vary = |share: f64| 1.0 + share * f64::from(random.gauss()).clamp(-2.0, 2.0);
    let (breadth, thick) = (vary(0.05), vary(0.08));
    m.palm_radius *= vary(0.06);
    m.wrist_half_width *= vary(0.06);
    for web in &mut m.webs {
        *web *= vary(0.12);
    }
    for (i, f) in m.fingers.iter_mut().enumerate() {
        let (long, wide) = (vary(0.035), thick * vary(0.04));
        f.bones = f.bones.map(|b| b * long * vary(0.02));
        f.radii = f.radii.map(|r| r * wide);
        if i > 0 {
            f.base[0] *= breadth;
            f.metacarpal[0] *= breadth;
        }
    }
    // The length is measured to the tip of the middle finger.
    let middle = &m.fingers[2];
    let found = middle.base[1] + middle.length();
    let mut m = m.scaled(length / found);
    m.hand_length = length;
    m
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hands_are_possible_and_differ() {
        let hands: Vec<Morphology> = (0..20).map(random_morphology).collect();
        for (i, m) in hands.iter().enumerate() {
            assert!(m.validate().is_ok() && check(m, Bounds::Persons).is_empty(), "{i}");
            let middle = &m.fingers[2];
            assert!((middle.base[1] + middle.length() - m.hand_length).abs() < 1e-9);
            assert!(hands[..i].iter().all(|other| other != m));
        }
        assert_eq!(hands[7], random_morphology(7));
        assert_ne!(hands[0], Morphology::default());
    }
}
