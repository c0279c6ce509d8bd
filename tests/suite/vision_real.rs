//! Segmentation and parts on real clips and stills.

use std::path::Path;

use handcast_media::{OpenOptions, open};
use handcast_vision::{
    Chirality, HandParts, PartsError, PartsTuning, SegmentOptions, Segmenter, Silhouette, find_parts,
};
use image::RgbImage;

fn frames(path: &Path) -> Vec<RgbImage> {
    let mut source = open(path, &OpenOptions::default().with_max_side(640)).unwrap();
    let mut frames = Vec::new();
    while let Some(frame) = source.next_frame().unwrap() {
        frames.push(frame.image);
    }
    frames
}

/// Silhouettes of all frames; a frame without one fails the test.
fn silhouettes(frames: &[RgbImage]) -> Vec<Silhouette> {
    let samples: Vec<RgbImage> = (0..16).map(|k| frames[k * frames.len() / 16].clone()).collect();
    let mut segmenter = Segmenter::learn(&samples, SegmentOptions::default()).unwrap();
    let segment = |(i, frame)| segmenter.segment(frame).unwrap_or_else(|e| panic!("frame {i}: {e}"));
    frames.iter().enumerate().map(segment).collect()
}

/// The 21 landmarks of each frame in analysis pixels.
fn landmarks(path: &Path, scale: f64) -> Vec<Option<Vec<(f64, f64)>>> {
    let text = std::fs::read_to_string(path).unwrap();
    let line = |line: &str| {
        let value: serde_json::Value = serde_json::from_str(line).unwrap();
        let points = value.get("image")?.as_array()?;
        let at =
            |p: &serde_json::Value, k: usize| p.get(k).and_then(serde_json::Value::as_f64).unwrap() * scale;
        Some(points.iter().map(|p| (at(p, 0), at(p, 1))).collect())
    };
    text.lines().skip(1).map(line).collect()
}

fn distance_to_segment(p: (f64, f64), a: (f64, f64), b: (f64, f64)) -> f64 {
    let d = (b.0 - a.0, b.1 - a.1);
    let t = ((p.0 - a.0) * d.0 + (p.1 - a.1) * d.1) / (d.0 * d.0 + d.1 * d.1).max(1e-9);
    let t = t.clamp(0.0, 1.0);
    (p.0 - a.0 - d.0 * t).hypot(p.1 - a.1 - d.1 * t)
}

const BONES: [(usize, usize); 23] = [
    (0, 1),
    (1, 2),
    (2, 3),
    (3, 4),
    (0, 5),
    (5, 6),
    (6, 7),
    (7, 8),
    (0, 9),
    (9, 10),
    (10, 11),
    (11, 12),
    (0, 13),
    (13, 14),
    (14, 15),
    (15, 16),
    (0, 17),
    (17, 18),
    (18, 19),
    (19, 20),
    (5, 9),
    (9, 13),
    (13, 17),
];

#[test]
#[cfg(feature = "h264")]
#[ignore = "needs the shared material"]
fn silhouettes_of_the_clips_agree_with_the_landmarks() {
    for (name, side) in [("finger-flexions", 1280.0), ("counting", 960.0), ("fingerspelling", 1080.0)] {
        let clip = crate::common::shared(&format!("data/clips/{name}.mp4"));
        let points = crate::common::shared(&format!("data/motion/landmarks/{name}.landmarks.jsonl"));
        let frames = frames(&clip);
        let found = silhouettes(&frames);
        let points = landmarks(&points, 640.0 / side);
        let (mut inside, mut total, mut explained, mut area) = (0usize, 0usize, 0usize, 0usize);
        let mut wrist_off = Vec::new();
        for (silhouette, points) in found.iter().zip(&points) {
            let Some(points) = points else { continue };
            let scale = (points[0].0 - points[9].0).hypot(points[0].1 - points[9].1);
            let near = handcast_vision::morphology::dilate(&silhouette.arm, (0.05 * scale) as u32);
            for p in points {
                let visible = p.0 >= 0.0
                    && p.1 >= 0.0
                    && p.0 < f64::from(near.width())
                    && p.1 < f64::from(near.height());
                if visible {
                    total += 1;
                    inside += usize::from(near.get(p.0 as u32, p.1 as u32));
                }
            }
            for (x, y) in silhouette.hand.pixels().filter(|p| p.0 % 7 == 0 && p.1 % 7 == 0) {
                let p = (f64::from(x) + 0.5, f64::from(y) + 0.5);
                area += 1;
                let bone =
                    |&(a, b): &(usize, usize)| distance_to_segment(p, points[a], points[b]) < 0.4 * scale;
                explained += usize::from(BONES.iter().any(bone));
            }
            if let Some(wrist) = silhouette.wrist {
                wrist_off.push((wrist.side([points[0].0, points[0].1]) / scale).abs());
            }
        }
        wrist_off.sort_by(f64::total_cmp);
        let share = inside as f64 / total as f64;
        let known = explained as f64 / area as f64;
        let p90 = wrist_off[wrist_off.len() * 9 / 10];
        println!(
            "{name}: {:.2} % of landmarks inside, {:.2} % of hand pixels near a bone, wrist off by {p90:.3} hand units (90 %), {} of {} with a wrist",
            share * 100.0,
            known * 100.0,
            wrist_off.len(),
            found.len()
        );
        assert!(share > 0.97, "{name}: {share}");
        assert!(known > 0.97, "{name}: {known}");
        assert!(p90 < 0.3, "{name}: {p90}");
    }
}

fn parts_of(path: &Path) -> Result<HandParts, PartsError> {
    let image = frames(path);
    let silhouette = Segmenter::learn(&image, SegmentOptions::default()).unwrap().segment(&image[0]).unwrap();
    find_parts(&silhouette, None, &PartsTuning::default())
}

#[test]
#[ignore = "needs the shared material"]
fn stills_are_open_or_refused_for_the_right_reason() {
    use Chirality::{LeftPalmOrRightBack, RightPalmOrLeftBack};
    let missing = |found| Err(PartsError::FingersMissing { found });
    let cases = [
        ("count-1", missing(1)),
        ("count-2", missing(2)),
        ("count-3", missing(3)),
        ("count-4", missing(4)),
        ("count-5", Ok(LeftPalmOrRightBack)),
        ("open-black-cloth-ring", Ok(RightPalmOrLeftBack)),
        ("hard-lowcontrast-index", missing(1)),
        ("adducted-f_d", Err(PartsError::FingersClosed { found: 1 })),
        ("adducted-f_p", Err(PartsError::FingersClosed { found: 1 })),
        ("adducted-m_d", Err(PartsError::FingersClosed { found: 1 })),
        ("adducted-m_p", Err(PartsError::FingersClosed { found: 1 })),
    ];
    for (name, want) in cases {
        let path = crate::common::shared(&format!("data/stills/{name}.jpg"));
        assert_eq!(parts_of(&path).map(|p| p.chirality), want, "{name}");
    }
}

#[test]
#[cfg(feature = "h264")]
#[ignore = "needs the shared material"]
fn clips_show_open_hands_of_the_right_side() {
    let flexions = silhouettes(&frames(&crate::common::shared("data/clips/finger-flexions.mp4")));
    let first = find_parts(&flexions[0], None, &PartsTuning::default()).unwrap();
    assert_eq!(first.chirality, Chirality::RightPalmOrLeftBack);
    assert!(first.openness > 0.85);
    let counting = silhouettes(&frames(&crate::common::shared("data/clips/counting.mp4")));
    for silhouette in &counting[175..200] {
        assert_eq!(
            find_parts(silhouette, None, &PartsTuning::default()).unwrap().chirality,
            Chirality::LeftPalmOrRightBack
        );
    }
    for silhouette in &counting[..140] {
        assert!(find_parts(silhouette, None, &PartsTuning::default()).is_err());
    }
}
