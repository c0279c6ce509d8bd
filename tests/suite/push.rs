//! Frames pushed one by one give the poses of the whole clip, whatever their size, and library and command agree.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use crate::common::command::{done, path};
use crate::common::y4m::y4m;
use handcast_eval::synth::{ScriptedMotion, Synth, SynthOptions};

use handcast_formats::poses::{read_poses, write_poses};
use handcast_hand::{PoseClip, Side, TimedPose};
use handcast_media::avi::MjpegWriter;
use handcast_media::{Frame, FrameSource, OpenOptions, open};
use handcast_track::pipeline::{
    ClipError, ClipOptions, ClipSink, HandStart, TrackedClip, TrackedFrame, Tracker, track_clip,
};
use image::imageops::{FilterType, grayscale, resize};
use image::{GrayImage, RgbImage};

/// Pictures of a hand that opens, and its masks.
fn pictures(size: (u32, u32), frames: usize) -> Vec<(RgbImage, GrayImage)> {
    let mut o = SynthOptions::default();
    (o.motion, o.frames, o.size) = (ScriptedMotion::Abduction, frames, size);
    let synth = Synth::new(o).unwrap();
    (0..frames)
        .map(|i| {
            let frame = synth.render(i);
            (frame.image, frame.hand.to_gray())
        })
        .collect()
}

/// In HD, though rendered smaller: that takes less time.
fn in_hd(pictures: &[(RgbImage, GrayImage)]) -> Vec<RgbImage> {
    pictures.iter().map(|(picture, _)| resize(picture, 1280, 720, FilterType::CatmullRom)).collect()
}

fn avi(pictures: &[RgbImage]) -> Vec<u8> {
    let out = std::io::Cursor::new(Vec::new());
    let mut writer = MjpegWriter::new(out, pictures[0].dimensions(), (30, 1), 90).unwrap();
    pictures.iter().for_each(|picture| writer.write(picture).unwrap());
    writer.finish().unwrap().into_inner()
}

/// Counts what it is told.
#[derive(Default)]
struct Counter {
    read: usize,
    tracked: usize,
    fitted: Vec<HandStart>,
    sizes: Vec<(u32, u32)>,
}

impl ClipSink for Counter {
    fn read(&mut self, index: usize) -> Result<(), String> {
        assert_eq!(index, self.read);
        self.read += 1;
        Ok(())
    }

    fn fitted(&mut self, start: &HandStart) {
        self.fitted.push(start.clone());
    }

    fn tracked(&mut self, frame: TrackedFrame<'_>) -> Result<(), String> {
        assert!(frame.index == self.tracked && frame.index < self.read);
        assert_eq!(frame.hands.len(), self.fitted.len());
        self.tracked += 1;
        self.sizes.push(frame.image.dimensions());
        Ok(())
    }
}

fn tracked(clip: &Path, masks: Option<&Path>, options: &ClipOptions) -> TrackedClip {
    let open = |path: &Path| open(path, &OpenOptions::default()).unwrap();
    track_clip(open(clip), masks.map(open), options, &mut Counter::default()).unwrap()
}

/// What a tracker gives of frames of any size.
fn pushed(frames: Vec<(Frame, Option<GrayImage>)>, options: &ClipOptions) -> (Tracker, Vec<TimedPose>) {
    let mut tracker = Tracker::new(options.clone());
    let mut poses = Vec::new();
    for (frame, mask) in frames {
        poses.extend(match mask {
            Some(mask) => tracker.push_with_mask(frame, mask).unwrap(),
            None => tracker.push(frame).unwrap(),
        });
    }
    poses.extend(tracker.finish().unwrap());
    (tracker, poses)
}

/// The frames of a clip as they are in it.
fn frames(clip: &Path) -> Vec<(Frame, Option<GrayImage>)> {
    let mut source = open(clip, &OpenOptions::default()).unwrap();
    std::iter::from_fn(|| source.next_frame().unwrap()).map(|frame| (frame, None)).collect()
}

fn frame(index: usize, image: &RgbImage) -> Frame {
    Frame { index, time: index as f64 / 30.0, image: image.clone() }
}

#[test]
fn library_command_and_single_frames_agree_on_an_hd_clip() {
    let dir = tempfile::tempdir().unwrap();
    let hd = in_hd(&pictures((320, 180), 10));
    let options = ClipOptions::default();
    for (name, bytes) in [("clip.y4m", y4m(&hd)), ("clip.avi", avi(&hd))] {
        let clip = dir.path().join(name);
        fs::write(&clip, bytes).unwrap();
        let by_library = tracked(&clip, None, &options);
        assert_eq!(by_library.hands[0].start.camera.width, 640);
        assert_eq!(by_library.hands[0].tracked_frames(), 10, "{name}");
        let out = clip.with_extension("jsonl");
        done(&["track", path(&clip), "-o", path(&out), "-q"]);
        let by_command = read_poses(&out).unwrap();
        // As the file has them: rounded.
        let again = dir.path().join("library.jsonl");
        let mut header = by_library.header();
        header.made_by.clone_from(&by_command.header.made_by);
        write_poses(&again, &PoseClip { header, frames: by_library.poses() }).unwrap();
        assert_eq!(fs::read_to_string(&again).unwrap(), fs::read_to_string(&out).unwrap(), "{name}");
        if name == "clip.avi" {
            // Its pictures are in RGB, and shrink in full size as in the source.
            let (tracker, poses) = pushed(frames(&clip), &options);
            assert_eq!(poses, by_library.poses());
            assert_eq!(tracker.header(by_library.rate), by_library.header());
            assert_eq!(tracker.hands()[0].frame, by_library.hands[0].start.frame);
        }
    }
}

/// Colours of a made scene.
struct Scene {
    wall: [u8; 3],
    /// Levels of its grain.
    grain: u32,
    /// What a thing and a hand are multiplied with.
    thing: [f64; 3],
    hand: [f64; 3],
}

/// A hand that comes after a while, on the right, with `shown` of 100 frames of a motion; what is shaped like one and is none
/// stands on the left all the time.
fn coming(
    scene: &Scene,
    alone: usize,
    motion: ScriptedMotion,
    shown: impl Iterator<Item = usize>,
) -> Vec<RgbImage> {
    let mut o = SynthOptions::default();
    (o.motion, o.frames, o.size) = (motion, 100, (320, 240));
    let synth = Synth::new(o).unwrap();
    let thing = synth.render(10);
    let tinted = |pixel: &image::Rgb<u8>, tint: [f64; 3]| {
        image::Rgb(std::array::from_fn(|c| (f64::from(pixel[c]) * tint[c]) as u8))
    };
    // Half as wide, and higher than a hand is.
    let of_thing = |x: u32, y: u32| {
        let (x, y) = (2.0 * f64::from(x) - 160.0, 240.0 - (240.0 - f64::from(y)) / 1.2);
        let inside = (0.0..320.0).contains(&x) && (0.0..240.0).contains(&y);
        let at = (x as u32, y as u32);
        (inside && thing.skin.get(at.0, at.1)).then(|| tinted(thing.image.get_pixel(at.0, at.1), scene.thing))
    };
    let picture = |frame: Option<usize>| {
        let hand = frame.map(|frame| synth.render(frame));
        let of_hand = |x: u32, y: u32| {
            let hand = hand.as_ref()?;
            hand.skin.get(x, y).then(|| tinted(hand.image.get_pixel(x, y), scene.hand))
        };
        let seed = frame.unwrap_or(100) as u32;
        RgbImage::from_fn(640, 240, |x, y| {
            let grain = (x * 7 + y * 13 + x * y + seed * 29) % scene.grain;
            let shown = if x < 320 { of_thing(x, y) } else { of_hand(x - 320, y) };
            let wall = image::Rgb(scene.wall.map(|v| v + grain as u8));
            shown.unwrap_or(wall)
        })
    };
    (0..alone).map(|_| picture(None)).chain(shown.map(|i| picture(Some(i)))).collect()
}

#[test]
fn colours_are_learnt_anew_until_a_hand_comes() {
    const ALONE: usize = 60;
    let dir = tempfile::tempdir().unwrap();
    let clip = dir.path().join("coming.y4m");
    let scene = Scene { wall: [90, 110, 130], grain: 5, thing: [1.0; 3], hand: [1.0; 3] };
    let pictures = coming(&scene, ALONE, ScriptedMotion::Abduction, 0..100);
    fs::write(&clip, y4m(&pictures)).unwrap();
    let options = ClipOptions::default();
    let whole = tracked(&clip, None, &options);
    let poses = whole.poses();
    let first = poses.iter().position(|p| p.valid).unwrap();
    assert!((ALONE..ALONE + 3).contains(&first), "{first}");
    assert!(poses[first..].iter().all(|p| p.valid && p.pose.side == Side::Right));
    let (tracker, pushed) = pushed(frames(&clip), &options);
    assert_eq!((tracker.hands().len(), pushed), (1, poses));
    // With nobody in it, it is refused.
    fs::write(&clip, y4m(&vec![pictures[0].clone(); 2 * ALONE])).unwrap();
    let source = open(&clip, &OpenOptions::default()).unwrap();
    let nobody = track_clip(source, None, &options, &mut Counter::default());
    assert!(matches!(nobody, Err(ClipError::NeverOpen { .. } | ClipError::NoHand { .. })), "{nobody:?}");
}

#[test]
fn a_hand_found_late_is_followed_back_to_where_it_came() {
    const ALONE: usize = 60;
    let dir = tempfile::tempdir().unwrap();
    let clip = dir.path().join("fist.y4m");
    // A dark fist for longer than pictures are remembered, which opens at the end; the thing is orange.
    let shown = (0..130).map(|i| 45 + i % 10).chain(50..100);
    let (thing, hand) = ([1.0, 0.6, 0.35], [0.4, 0.4, 0.45]);
    let scene = Scene { wall: [150, 125, 100], grain: 5, thing, hand };
    fs::write(&clip, y4m(&coming(&scene, ALONE, ScriptedMotion::Fist, shown))).unwrap();
    let poses = tracked(&clip, None, &ClipOptions::default()).poses();
    let first = poses.iter().position(|p| p.valid).unwrap();
    assert!((ALONE..ALONE + 3).contains(&first), "{first}");
    assert!(poses[first..].iter().all(|p| p.valid && p.pose.side == Side::Right));
}

#[test]
fn poses_come_as_soon_as_they_are_known() {
    let dir = tempfile::tempdir().unwrap();
    let pictures: Vec<RgbImage> = pictures((240, 180), 30).into_iter().map(|(p, _)| p).collect();
    let clip = dir.path().join("clip.avi");
    fs::write(&clip, avi(&pictures)).unwrap();
    let mut options = ClipOptions::default();
    options.learning_frames = 6;
    // Which view it is would be waited for as well.
    options.tuning.contest.undecided = 0;
    let whole = tracked(&clip, None, &options);
    let mut tracker = Tracker::new(options);
    assert!(tracker.hands().is_empty());
    let mut counter = Counter::default();
    let mut counts = String::new();
    for (frame, _) in frames(&clip) {
        tracker.push_to(frame, None, &mut counter).unwrap();
        write!(counts, "{}/{} ", counter.read, counter.tracked).unwrap();
    }
    tracker.finish_to(&mut counter).unwrap();
    assert!(
        counts.starts_with("0/0 0/0 0/0 0/0 0/0 6/0 7/0 "),
        "colours are learnt from six frames: {counts}"
    );
    assert!(counts.contains("11/0 12/12 13/13 "), "twelve open hands are waited for: {counts}");
    assert!(counts.ends_with("29/29 30/30 "), "{counts}");
    assert_eq!(counter.fitted.len(), 1);
    assert!(counter.sizes.iter().all(|&size| size == (240, 180)));
    assert!(tracker.times().segment.as_nanos() > 0 && tracker.times().track.as_nanos() > 0);
    let spent = &whole.timings.frames;
    assert_eq!((spent.decode.len(), spent.segment.len(), spent.track.len()), (30, 30, 30));
    assert!(spent.track.iter().all(|t| t.as_nanos() > 0), "{spent:?}");
    assert!(matches!(tracker.push(frame(30, &pictures[0])), Err(ClipError::Ended)));
}

#[test]
fn two_hands_are_pushed_like_one() {
    let mut o = SynthOptions::default();
    (o.motion, o.frames, o.size) = (ScriptedMotion::Abduction, 16, (320, 192));
    (o.field_of_view, o.aside) = (75.0, -0.12);
    let one = Synth::new(o).unwrap();
    let other = one.other_hand().unwrap();
    let pictures: Vec<RgbImage> =
        (0..16).map(|i| one.render_with(&other, i).into_iter().next().unwrap().image).collect();
    let dir = tempfile::tempdir().unwrap();
    for (i, picture) in pictures.iter().enumerate() {
        picture.save(dir.path().join(format!("{i:02}.png"))).unwrap();
    }
    let mut options = ClipOptions::default();
    options.field_of_view = 75.0;
    let whole = tracked(dir.path(), None, &options);
    for threads in [1, 2] {
        options.threads = threads;
        let (tracker, poses) = pushed(frames(dir.path()), &options);
        assert_eq!(poses, whole.poses(), "{threads} threads");
        let sides: Vec<Side> = tracker.hands().iter().map(|hand| hand.side).collect();
        assert!(sides.contains(&Side::Left) && sides.contains(&Side::Right) && sides.len() == 2);
        assert_eq!(tracker.header(Some(30.0)), whole.header());
    }
}

#[test]
fn masks_of_any_size_are_pushed_with_their_frames() {
    let dir = tempfile::tempdir().unwrap();
    let made = pictures((320, 180), 8);
    let (clip, masks) = (dir.path().join("clip"), dir.path().join("masks"));
    fs::create_dir(&clip).unwrap();
    fs::create_dir(&masks).unwrap();
    let large = |mask: &GrayImage| resize(mask, 1280, 720, FilterType::Triangle);
    let mut pairs = Vec::new();
    for (i, (picture, mask)) in made.iter().enumerate() {
        let (picture, mask) = (resize(picture, 1280, 720, FilterType::Triangle), large(mask));
        let name = format!("{i:02}.png");
        picture.save(clip.join(&name)).unwrap();
        // In colour, as sources give them.
        let mask = RgbImage::from_fn(1280, 720, |x, y| image::Rgb([mask.get_pixel(x, y).0[0]; 3]));
        mask.save(masks.join(&name)).unwrap();
        pairs.push((frame(i, &picture), Some(grayscale(&mask))));
    }
    for mirror in [false, true] {
        let mut options = ClipOptions::default();
        options.mirror = mirror;
        let whole = tracked(&clip, Some(&masks), &options);
        let (_, poses) = pushed(pairs.clone(), &options);
        assert_eq!(poses, whole.poses());
        assert!(poses.iter().all(|p| p.valid && p.iou.unwrap() > 0.85), "{poses:?}");
    }
    // The last mask is missing.
    fs::remove_file(masks.join("07.png")).unwrap();
    let open = |path: &Path| open(path, &OpenOptions::default()).unwrap();
    let short = track_clip(open(&clip), Some(open(&masks)), &ClipOptions::default(), &mut Counter::default());
    assert!(matches!(short, Err(ClipError::NoMask { index: 7, .. })), "{short:?}");
}

#[test]
fn frames_that_do_not_fit_together_are_refused() {
    let picture = |w: u32, h: u32| RgbImage::from_fn(w, h, |x, y| image::Rgb([x as u8, y as u8, 90]));
    // `over` tells whether that is the tracker's end.
    let pushed = |frames: Vec<(Frame, Option<GrayImage>)>, over: bool| {
        let mut tracker = Tracker::new(ClipOptions::default());
        let mut results = Vec::new();
        for (frame, mask) in frames {
            results.push(match mask {
                Some(mask) => tracker.push_with_mask(frame, mask),
                None => tracker.push(frame),
            });
        }
        let error = results.pop().unwrap().unwrap_err();
        assert!(results.iter().all(|earlier| earlier.as_ref().is_ok_and(Vec::is_empty)));
        let next = tracker.push(frame(99, &picture(64, 48)));
        assert_eq!(matches!(next, Err(ClipError::Ended)), over);
        assert_eq!(matches!(tracker.finish(), Err(ClipError::Ended)), over);
        error.to_string()
    };
    let at = |time: f64| Frame { index: 7, time, image: picture(64, 48) };
    let mask = |w, h| Some(GrayImage::new(w, h));
    let said = pushed(vec![(at(0.0), None), (frame(1, &picture(48, 64)), None)], false);
    assert_eq!(said, "frame 1: picture of 48 x 64 pixels after pictures of 64 x 48");
    let said = pushed(vec![(at(1.0), None), (at(1.0), None), (at(0.5), None)], false);
    assert_eq!(said, "frame 2: its time, 0.5 s, is before that of the frame ahead of it, 1 s");
    let said = pushed(vec![(at(f64::NAN), None)], false);
    assert_eq!(said, "frame 0: its time is NaN; allowed are finite numbers of seconds");
    let said = pushed(vec![(at(0.0), mask(64, 48)), (at(0.1), None)], true);
    assert_eq!(said, "frame 1: all frames must come with a mask, or none");
    let said = pushed(vec![(at(0.0), None), (at(0.1), mask(64, 48))], true);
    assert_eq!(said, "frame 1: all frames must come with a mask, or none");
    let said = pushed(vec![(at(0.0), mask(48, 64))], true);
    assert!(said.starts_with("mask 0 has another shape than the frame: 48 x 64 and 64 x 48"), "{said}");
    assert!(matches!(Tracker::new(ClipOptions::default()).finish(), Err(ClipError::Empty)));
}
