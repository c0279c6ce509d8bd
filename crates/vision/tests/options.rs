//! The options of vision: every constant is shown with unit and source, and none makes it panic.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeSet;

use handcast_vision::tuning::{Constant, Tuning};
use handcast_vision::{
    Contour, ContourTuning, Mask, PartsTuning, SegmentOptions, Segmenter, Silhouette, WristTuning, find_parts,
};
use image::{Rgb, RgbImage};

fn visit(options: &mut SegmentOptions, contour: &mut ContourTuning, visitor: &mut dyn FnMut(Constant<'_>)) {
    options.visit("segment", visitor);
    contour.visit("contour", visitor);
}

#[test]
fn every_constant_is_shown_once_with_meaning_unit_and_source() {
    let (mut options, mut contour) = (SegmentOptions::default(), ContourTuning::default());
    // The leaves of the structs themselves: fields whose value does not begin with the name of a group.
    let written = format!("{options:?} {contour:?}");
    let leaves = written.split(": ").skip(1).filter(|v| !v.starts_with(char::is_uppercase)).count();
    let mut paths = BTreeSet::new();
    visit(&mut options, &mut contour, &mut |c| {
        assert!(!c.unit.trim().is_empty(), "{} has no unit", c.path);
        assert!(c.source.len() > 10, "{} has no source", c.path);
        assert!(c.meaning.contains(' ') && c.meaning.ends_with('.'), "{}: {:?}", c.path, c.meaning);
        assert!(!c.value.values().is_empty() && c.value.values().iter().all(|v| v.is_finite()), "{}", c.path);
        let name = c.path.clone();
        assert!(paths.insert(c.path), "{name} is there twice");
    });
    assert_eq!(paths.len(), leaves, "{paths:?}");
    for known in
        ["segment.max_side", "segment.colour.skin_hue", "segment.wrist.cut.distance", "contour.passes"]
    {
        assert!(paths.contains(known), "{known}");
    }
}

const SIZE: [u32; 2] = [192, 160];

fn capsule(p: [f64; 2], a: [f64; 2], b: [f64; 2], radius: f64) -> bool {
    let d = [b[0] - a[0], b[1] - a[1]];
    let along = (p[0] - a[0]) * d[0] + (p[1] - a[1]) * d[1];
    let t = (along / (d[0] * d[0] + d[1] * d[1])).clamp(0.0, 1.0);
    (p[0] - a[0] - t * d[0]).hypot(p[1] - a[1] - t * d[1]) < radius
}

/// An open hand whose forearm leaves the picture at the bottom.
fn hand() -> Mask {
    let fingers: [([f64; 2], [f64; 2]); 5] = [
        ([80.0, 92.0], [48.0, 66.0]),
        ([82.0, 70.0], [68.0, 22.0]),
        ([95.0, 66.0], [93.0, 14.0]),
        ([107.0, 68.0], [117.0, 20.0]),
        ([117.0, 76.0], [140.0, 38.0]),
    ];
    Mask::from_fn(SIZE[0], SIZE[1], |x, y| {
        let p = [f64::from(x) + 0.5, f64::from(y) + 0.5];
        let palm = capsule(p, [97.0, 84.0], [100.0, 92.0], 24.0);
        palm || capsule(p, [100.0, 96.0], [104.0, 200.0], 15.0)
            || fingers.iter().any(|&(a, b)| capsule(p, a, b, 5.5))
    })
}

/// The hand before a wall, in uneven light and with noise: with a ring, a mole of the wall's colour, a finger half
/// blurred, a block of wood and a shelf of pale skin's colour in the background.
fn picture(hand: &Mask) -> RgbImage {
    const SKIN: [f64; 3] = [205.0, 152.0, 124.0];
    const WALL: [f64; 3] = [150.0, 162.0, 176.0];
    RgbImage::from_fn(SIZE[0], SIZE[1], |x, y| {
        let p = [f64::from(x), f64::from(y)];
        let within = |q: [f64; 2], radius: f64| (p[0] - q[0]).hypot(p[1] - q[1]) < radius;
        let colour = if hand.get(x, y) && !within([94.0, 88.0], 3.0) {
            if capsule(p, [104.0, 48.0], [116.0, 46.0], 3.0) { [196.0, 178.0, 110.0] } else { SKIN }
        } else if capsule(p, [117.0, 20.0], [124.0, 18.0], 5.0) {
            [0, 1, 2].map(|c| 0.55 * SKIN[c] + 0.45 * WALL[c])
        } else if (4..40).contains(&x) && (90..150).contains(&y) {
            [172.0, 118.0, 70.0]
        } else if x > 160 && (60..90).contains(&y) {
            [196.0, 172.0, 158.0]
        } else {
            WALL
        };
        let noise = f64::from((x * 7919 + y * 104_729 + x * y * 31) % 29) - 14.0;
        let light = 1.1 - 0.002 * f64::from(y) - 0.001 * f64::from(x);
        Rgb(colour.map(|v| (v * light + noise) as u8))
    })
}

/// What is found in a picture.
fn find(image: &RgbImage, options: SegmentOptions) -> String {
    let learnt = Segmenter::learn(std::slice::from_ref(image), options);
    let found = learnt.map(|mut s| (s.segment(image), s.segment_all(image), s.posterior().into_raw()));
    format!("{found:?}")
}

/// What is found in a ready silhouette, with its forearm, without, and without any hint of the wrist.
fn find_ready(arm: &Mask, options: &SegmentOptions, contour: ContourTuning) -> String {
    let whole = Silhouette::from_arm(arm.clone(), None, &options.wrist);
    let again = Silhouette::from_arm(arm.clone(), whole.wrist.as_ref(), &options.wrist);
    let alone = Silhouette::from_arm(whole.hand.clone(), None, &options.wrist);
    let mut tracer = Contour::new(contour);
    let mut found = String::new();
    for silhouette in [whole, again, alone] {
        tracer.trace(&silhouette.hand);
        let parts = find_parts(&silhouette, None, &options.parts);
        found += &format!("{silhouette:?} {parts:?} {:?}", tracer.points());
    }
    found
}

#[test]
fn no_constant_makes_it_panic_and_most_change_what_is_found() {
    let hand = hand();
    let image = picture(&hand);
    let (mut options, mut contour) = (SegmentOptions::default(), ContourTuning::default());
    let (seen, ready) = (find(&image, options), find_ready(&hand, &options, contour));
    let mut paths = Vec::new();
    visit(&mut options, &mut contour, &mut |c| paths.push(c.path));
    // One picture shows no motion: these have a test of their own.
    paths.retain(|path| !path.starts_with("segment.swept"));
    let changes = |path: &str| {
        let mut changed = false;
        for factor in [-1.0, 0.0, 0.5, 30.0] {
            let (mut options, mut contour) = (SegmentOptions::default(), ContourTuning::default());
            visit(&mut options, &mut contour, &mut |c| {
                if c.path == path {
                    c.value.scale(factor);
                }
            });
            changed |= find_ready(&hand, &options, contour) != ready;
            let only_shape =
                ["segment.wrist", "segment.parts", "contour"].iter().any(|p| path.starts_with(p));
            changed |= !only_shape && find(&image, options) != seen;
        }
        changed
    };
    let idle_of =
        |paths: &[String]| -> Vec<String> { paths.iter().filter(|path| !changes(path)).cloned().collect() };
    // On two cores.
    let (some, others) = paths.split_at(paths.len() / 2);
    let idle = std::thread::scope(|scope| {
        let some = scope.spawn(|| idle_of(some));
        [idle_of(others), some.join().unwrap()].concat()
    });
    // One hand shows neither closed fingers nor a second hand nor a cloth of the colour of skin.
    assert!(4 * idle.len() < paths.len(), "of {} constants these change nothing: {idle:#?}", paths.len());
}

#[test]
fn the_hand_of_these_tests_is_seen_open() {
    let hand = hand();
    let image = picture(&hand);
    let options = SegmentOptions::default();
    let silhouette =
        Segmenter::learn(std::slice::from_ref(&image), options).unwrap().segment(&image).unwrap();
    assert!(silhouette.arm.iou(&hand) > 0.93, "{}", silhouette.arm.iou(&hand));
    let parts = find_parts(&silhouette, None, &PartsTuning::default()).unwrap();
    assert!(parts.openness > 0.8, "{}", parts.openness);
    // What an option says is what is used: without a band round the coarse outline nothing is refined.
    let mut narrow = options;
    (narrow.outline.band, narrow.outline.blur_band) = (0, 0);
    let coarse = Segmenter::learn(std::slice::from_ref(&image), narrow).unwrap().segment(&image).unwrap();
    assert_ne!(coarse.arm, silhouette.arm);
    let mut wrist = WristTuning::default();
    wrist.cut.distance = 1.5;
    let lower = Silhouette::from_arm(hand.clone(), None, &wrist);
    assert!(lower.hand.area() > Silhouette::from_arm(hand, None, &WristTuning::default()).hand.area());
}
