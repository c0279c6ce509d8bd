//! Segmentation and parts on pictures made here, where the truth is known.

use crate::common::hand::{FlatHand, add_noise, wall};
use handcast_vision::{
    Chirality, PartsError, PartsTuning, SegmentOptions, Segmenter, Silhouette, VisionError, WristTuning,
    find_parts,
};
use image::RgbImage;

const SKINS: [[f64; 3]; 3] = [[214.0, 160.0, 132.0], [160.0, 108.0, 82.0], [96.0, 60.0, 44.0]];
const ALL: [bool; 5] = [true; 5];

fn segment(image: &RgbImage) -> Result<Silhouette, VisionError> {
    Segmenter::learn(std::slice::from_ref(image), SegmentOptions::default())?.segment(image)
}

/// The hand with its forearm leaving the picture, whichever way it points.
fn scene(turn: f64, mirrored: bool, shown: [bool; 5]) -> FlatHand {
    let centre = (320.0 - 60.0 * turn.sin(), 240.0 + 60.0 * turn.cos());
    FlatHand::new(centre, turn, 210.0, mirrored, 3.0, shown)
}

#[test]
fn silhouettes_are_right_to_the_pixel() {
    let walls = [[240.0, 240.0, 238.0], [225.0, 214.0, 190.0], [150.0, 160.0, 172.0], [28.0, 27.0, 30.0]];
    for (k, colour) in walls.into_iter().enumerate() {
        for (j, skin) in SKINS.into_iter().enumerate() {
            if k == 3 && j == 2 {
                continue; // Dark brown on black: no contrast to speak of.
            }
            let hand = scene(0.4 * k as f64 - 0.5, j == 1, ALL);
            let mut image = wall(640, 480, colour, true);
            hand.paint(&mut image, skin);
            add_noise(&mut image, 4.0);
            let found = segment(&image).unwrap_or_else(|error| panic!("wall {k} skin {j}: {error}"));
            let truth = hand.mask(640, 480);
            let iou = found.arm.iou(&truth);
            println!("wall {k} skin {j}: IoU {iou:.4}");
            assert!(iou > 0.97, "wall {k} skin {j}: {iou}");
            // No part of the outline may be off by more than two pixels.
            let wrong = found.arm.pixels().filter(|&p| off(&hand, p) > 2.0).count()
                + truth.pixels().filter(|&p| off(&hand, p) < -2.0 && !found.arm.get(p.0, p.1)).count();
            assert!(wrong < 30, "wall {k} skin {j}: {wrong} pixels");
        }
    }
}

fn off(hand: &FlatHand, (x, y): (u32, u32)) -> f64 {
    hand.distance((f64::from(x) + 0.5, f64::from(y) + 0.5))
}

#[test]
fn the_wrist_is_found_in_any_direction_open_or_not() {
    for step in 0..8 {
        let turn = f64::from(step) * std::f64::consts::FRAC_PI_4 + 0.1;
        for shown in [ALL, [false, true, true, false, false], [false; 5]] {
            let hand = scene(turn, false, shown);
            let silhouette = Silhouette::from_arm(hand.mask(640, 480), None, &WristTuning::default());
            let wrist = silhouette.wrist.unwrap();
            let d = (wrist.centre[0] - hand.wrist.0, wrist.centre[1] - hand.wrist.1);
            let along = (d.0 * hand.up.0 + d.1 * hand.up.1) / 210.0;
            let across = (d.0 * hand.up.1 - d.1 * hand.up.0) / 210.0;
            let cos = wrist.axis[0] * hand.up.0 + wrist.axis[1] * hand.up.1;
            assert!(
                along.abs() < 0.12 && across.abs() < 0.05 && cos > 0.97,
                "turn {turn:.1} {shown:?}: along {along:.3} across {across:.3} cos {cos:.3}"
            );
        }
    }
}

#[test]
fn parts_of_open_hands_have_known_axes_and_sides() {
    for step in 0..8 {
        let turn = f64::from(step) * std::f64::consts::FRAC_PI_4 + 0.2;
        for mirrored in [false, true] {
            let hand = scene(turn, mirrored, ALL);
            let silhouette = Silhouette::from_arm(hand.mask(640, 480), None, &WristTuning::default());
            let parts = find_parts(&silhouette, None, &PartsTuning::default())
                .unwrap_or_else(|e| panic!("turn {turn:.1} {mirrored}: {e}"));
            let side = if mirrored { Chirality::LeftPalmOrRightBack } else { Chirality::RightPalmOrLeftBack };
            assert_eq!(parts.chirality, side);
            for (k, (found, truth)) in parts.fingers.iter().zip(&hand.fingers).enumerate() {
                let d = (truth.b.0 - truth.a.0, truth.b.1 - truth.a.1);
                let length = d.0.hypot(d.1);
                let cos = (found.axis[0] * d.0 + found.axis[1] * d.1) / length;
                let tip = (truth.b.0 + d.0 / length * truth.rb, truth.b.1 + d.1 / length * truth.rb);
                let miss = (found.tip[0] - tip.0).hypot(found.tip[1] - tip.1);
                let degrees = cos.clamp(-1.0, 1.0).acos().to_degrees();
                assert!(degrees < 3.0, "turn {turn:.1} finger {k}: axis off by {degrees:.1} degrees");
                assert!(miss < 2.5, "turn {turn:.1} finger {k}: tip off by {miss:.1} pixels");
                let radius = 0.5 * (truth.ra + truth.rb);
                assert!((found.radius / radius - 1.0).abs() < 0.12, "finger {k}: {} {radius}", found.radius);
            }
            assert!(parts.openness > 0.8, "{}", parts.openness);
            let miss = (parts.wrist[0] - hand.wrist.0).hypot(parts.wrist[1] - hand.wrist.1);
            assert!(miss < 0.13 * 210.0, "wrist off by {miss:.1}");
        }
    }
}

#[test]
fn hands_that_are_not_open_are_refused_for_the_right_reason() {
    for shown in 0..5usize {
        let mut fingers = [false; 5];
        for finger in fingers.iter_mut().skip(1).take(shown) {
            *finger = true;
        }
        let hand = scene(0.1, false, fingers);
        let silhouette = Silhouette::from_arm(hand.mask(640, 480), None, &WristTuning::default());
        assert_eq!(
            find_parts(&silhouette, None, &PartsTuning::default()),
            Err(PartsError::FingersMissing { found: shown })
        );
    }
    let mut closed = scene(0.0, false, ALL);
    // Index to little finger side by side.
    for k in 1..5 {
        let finger = &mut closed.fingers[k];
        finger.b = (320.0 + (finger.a.0 - 320.0) * 0.85, finger.a.1 - 85.0);
        (finger.ra, finger.rb) = (finger.ra * 1.12, finger.ra * 0.95);
    }
    let silhouette = Silhouette::from_arm(closed.mask(640, 480), None, &WristTuning::default());
    let found = find_parts(&silhouette, None, &PartsTuning::default()).map(|parts| parts.fingers);
    assert!(matches!(found, Err(PartsError::FingersClosed { .. })), "{found:?}, palm {:?}", silhouette.palm);
}

#[test]
fn no_hand_and_several_hands_are_told() {
    let mut empty = wall(640, 480, [225.0, 214.0, 190.0], false);
    add_noise(&mut empty, 4.0);
    assert!(matches!(segment(&empty), Err(VisionError::NoHand { .. })), "{:?}", segment(&empty).err());
    let mut two = wall(640, 480, [150.0, 160.0, 172.0], false);
    FlatHand::new((170.0, 330.0), 0.0, 200.0, false, 3.0, ALL).paint(&mut two, SKINS[0]);
    FlatHand::new((470.0, 330.0), 0.0, 200.0, true, 3.0, ALL).paint(&mut two, SKINS[0]);
    assert_eq!(segment(&two).err(), Some(VisionError::SeveralHands { count: 2 }));
}

#[test]
fn ready_masks_are_taken_as_they_are() {
    let hand = scene(0.0, false, ALL);
    let truth = hand.mask(640, 480);
    let found = Silhouette::from_gray(&truth.to_gray(), &SegmentOptions::default()).unwrap();
    assert_eq!(found.arm, truth);
    let half =
        Silhouette::from_gray(&truth.to_gray(), &SegmentOptions::default().with_max_side(320)).unwrap();
    assert_eq!((half.arm.width(), half.arm.height()), (320, 240));
    assert!((f64::from(half.arm.area()) * 4.0 / f64::from(truth.area()) - 1.0).abs() < 0.02);
    let nothing = image::GrayImage::new(640, 480);
    assert!(matches!(
        Silhouette::from_gray(&nothing, &SegmentOptions::default()),
        Err(VisionError::NoHand { .. })
    ));
}

#[test]
fn every_hand_is_found_and_furniture_is_not_learnt() {
    let mut image = wall(640, 480, [150.0, 160.0, 172.0], true);
    // A box of wood, about as large as a hand.
    for y in 300..440 {
        for x in 260..380 {
            image.put_pixel(x, y, image::Rgb([150, 104, 66]));
        }
    }
    let hands = [FlatHand::new((140.0, 240.0), 0.1, 170.0, false, 3.0, ALL), {
        FlatHand::new((500.0, 250.0), -0.1, 170.0, true, 3.0, ALL)
    }];
    hands.iter().for_each(|hand| hand.paint(&mut image, SKINS[0]));
    add_noise(&mut image, 4.0);
    let mut segmenter = Segmenter::learn(std::slice::from_ref(&image), SegmentOptions::default()).unwrap();
    let found = segmenter.segment_all(&image).unwrap();
    assert_eq!(found.len(), 2, "{:?}", found.iter().map(|s| s.arm.bounds()).collect::<Vec<_>>());
    for hand in &hands {
        let truth = hand.mask(640, 480);
        let best = found.iter().map(|s| s.arm.iou(&truth)).fold(0.0, f64::max);
        assert!(best > 0.97, "{best}");
    }
    let mut both = hands[0].mask(640, 480);
    both.union_with(&hands[1].mask(640, 480));
    let ready = Silhouette::all_from_gray(&both.to_gray(), &SegmentOptions::default()).unwrap();
    assert_eq!(ready.len(), 2);
    assert!(matches!(
        Silhouette::from_gray(&both.to_gray(), &SegmentOptions::default()),
        Err(VisionError::SeveralHands { count: 2 })
    ));
}
