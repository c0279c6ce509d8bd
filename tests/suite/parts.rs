//! Parts of clips, numbered pictures, and clips that are longer than a motion may be.

use std::fs;
use std::io::Cursor;
use std::path::Path;

use handcast_media::film::{FilmWriter, TICKS};
use handcast_media::{Frame, FrameError, FrameSource, OpenOptions, Part, open};
use image::{Rgb, RgbImage};

use crate::common::command::{done, handcast, misused, path, refused, text};

const COUNT: usize = 250;
const RATE: f64 = 25.0;

fn picture(number: usize) -> RgbImage {
    RgbImage::from_fn(64, 48, |x, y| Rgb([(x * 4) as u8, (y * 5) as u8, number as u8]))
}

fn all(mut source: Box<dyn FrameSource>) -> Result<Vec<Frame>, FrameError> {
    let mut frames = Vec::new();
    while let Some(frame) = source.next_frame()? {
        frames.push(frame);
    }
    assert_eq!(source.shortfall(), None);
    Ok(frames)
}

fn part(from: f64, until: f64) -> Part {
    Part { from, until, ..Part::WHOLE }
}

/// The same pictures in each container that is read here; the MP4 file has pictures that stand alone in between.
fn clips(folder: &Path) -> [std::path::PathBuf; 4] {
    use handcast_media::avi::MjpegWriter;
    let [avi, mp4, y4m, shots] = ["a.avi", "a.mp4", "a.y4m", "shots"].map(|name| folder.join(name));
    let mut motion = MjpegWriter::new(Cursor::new(Vec::new()), (64, 48), (25, 1), 90).unwrap();
    let mut film = FilmWriter::new(Cursor::new(Vec::new()), (64, 48), RATE, 700_000).unwrap();
    let mut raw = b"YUV4MPEG2 W64 H48 F25:1 Ip Cmono\n".to_vec();
    fs::create_dir(&shots).unwrap();
    for number in 0..COUNT {
        let picture = picture(number);
        motion.write(&picture).unwrap();
        film.write(&picture, TICKS / 25).unwrap();
        raw.extend(b"FRAME\n");
        raw.extend(picture.pixels().map(|pixel| pixel.0[2]));
        picture.save(shots.join(format!("s{:03}.bmp", number + 7))).unwrap();
    }
    fs::write(&avi, motion.finish().unwrap().into_inner()).unwrap();
    fs::write(&mp4, film.finish().unwrap().into_inner()).unwrap();
    fs::write(&y4m, raw).unwrap();
    [avi, mp4, y4m, shots.join("s%03d.bmp")]
}

#[test]
fn a_part_has_the_pictures_times_and_numbers_of_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let clips = clips(folder.path());
    let options = OpenOptions::default().with_rate(RATE).with_ffmpeg(None);
    for clip in &clips {
        let whole = all(open(clip, &options).unwrap()).unwrap();
        assert_eq!(whole.len(), COUNT, "{}", clip.display());
        for (from, until, expected) in
            [(0.0, 0.4, 0..10), (1.0, 2.0, 25..50), (5.21, 5.3, 131..133), (9.9, f64::INFINITY, 248..250)]
        {
            for numbered in [false, true] {
                let part = Part { numbered, ..part(from, until) };
                let source = open(clip, &options.clone().with_part(part)).unwrap();
                let (known, before) = (source.info().frames, source.info().before);
                assert!(known.is_none_or(|n| (before, n) == (expected.start, expected.len())), "{clip:?}");
                assert_eq!(known.is_none(), source.times().is_none());
                let found = all(source).unwrap();
                assert_eq!(found.len(), expected.len(), "{clip:?} {from} {until}");
                for (frame, same) in found.iter().zip(&whole[expected.clone()]) {
                    assert_eq!((frame.index, frame.time), (same.index, same.time), "{clip:?}");
                    assert!(frame.image == same.image, "{clip:?}: picture {} is another", frame.index);
                }
            }
        }
        let beyond = open(clip, &options.clone().with_part(part(10.0, 11.0))).and_then(all).unwrap_err();
        assert!(beyond.to_string().contains("no picture lies from 10.000 s on until 11.000 s"), "{beyond}");
        assert!(beyond.to_string().contains("its last one is at 9.960 s"), "{beyond}");
    }
    for (from, until) in [(2.0, 2.0), (3.0, 1.0), (-1.0, 1.0), (f64::NAN, 1.0)] {
        let empty = open(&clips[0], &options.clone().with_part(part(from, until))).err().unwrap();
        assert!(matches!(empty, FrameError::Option { .. }), "{empty}");
    }
}

#[test]
#[ignore = "needs ffmpeg"]
fn a_part_through_the_helper_program_has_the_times_of_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let [_, mp4, ..] = clips(folder.path());
    for name in ["a.mkv", "a.ts"] {
        let clip = folder.path().join(name);
        let mut copy = std::process::Command::new("ffmpeg");
        copy.args(["-nostdin", "-v", "error", "-i"]).arg(&mp4).args(["-c", "copy"]).arg(&clip);
        assert!(copy.status().unwrap().success());
        let whole = all(open(&clip, &OpenOptions::default()).unwrap()).unwrap();
        let found = open(&clip, &OpenOptions::default().with_part(part(6.0, 7.0))).and_then(all).unwrap();
        assert_eq!(found.len(), 25, "{name}");
        for (frame, same) in found.iter().zip(&whole[150..]) {
            assert_eq!(frame.index, same.index, "{name}");
            assert!((frame.time - same.time).abs() < 1e-3, "{name}: {} {}", frame.time, same.time);
            assert!(frame.image == same.image, "{name}: picture {} is another", frame.index);
        }
    }
}

#[test]
fn parts_are_tracked_with_their_masks_and_limits_hold_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (clip, masks, out) = (at("clip"), at("masks"), at("x.jsonl"));
    done(&["synth", "-o", path(&clip), "--frames", "40", "--masks", path(&masks)]);
    let of_masks = ["--mask", path(&masks)];
    for more in [&[][..], &of_masks] {
        let part = ["track", path(&clip), "-o", path(&out), "--from", "0:00.5", "--until", "1"];
        done(&[&part[..], more].concat());
        let lines = fs::read_to_string(&out).unwrap();
        assert_eq!(lines.lines().count(), 1 + 15, "{more:?}");
        assert!(lines.lines().nth(1).unwrap().starts_with("{\"t\":0.5,"), "{lines}");
        fs::remove_file(&out).unwrap();
    }
    let track = |more: &[&str], words: &[&str]| {
        refused(&[&["track", path(&clip), "-o", path(&out)], more].concat(), &out, words);
    };
    track(&["--from", "7"], &["no picture lies from 7.000 s on; its last one is at 1.300 s"]);
    track(&["--max-instants", "39"], &["40 instants, allowed at most 39; --max-instants raises that"]);
    track(&["--max-seconds", "1"], &["seconds, allowed at most 1; --max-seconds raises that"]);
    done(&[
        "track",
        path(&clip),
        "-o",
        path(&out),
        "--max-instants",
        "10",
        "--from",
        "0.5",
        "--until",
        "0.8",
    ]);
    fs::remove_file(&out).unwrap();
    misused(&["track", path(&clip), "-o", path(&out), "--from", "2", "--until", "1"], &out, &["--until 1"]);
    misused(&["track", path(&clip), "-o", path(&out), "--from", "1:75"], &out, &["HH:MM:SS"]);
    let run = at("run");
    refused(&["run", path(&clip), "-o", path(&run), "--max-seconds", "1"], &run, &["allowed at most 1"]);
    fs::remove_file(masks.join("00039.png")).unwrap();
    track(&of_masks, &["39 masks for the 40 frames"]);
}

/// Of a clip that does not tell how long it is what was tracked until then is kept.
#[test]
fn a_clip_that_becomes_too_long_leaves_its_poses() {
    let folder = tempfile::tempdir().unwrap();
    let clip = folder.path().join("clip.gif");
    let demo = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/demo.avi");
    let mut source = open(demo, &OpenOptions::default().with_max_side(240)).unwrap();
    let mut encoder = image::codecs::gif::GifEncoder::new_with_speed(fs::File::create(&clip).unwrap(), 30);
    for _ in 0..100 {
        let picture = image::DynamicImage::from(source.next_frame().unwrap().unwrap().image).to_rgba8();
        let delay = image::Delay::from_numer_denom_ms(40, 1);
        encoder.encode_frame(image::Frame::from_parts(picture, 0, 0, delay)).unwrap();
    }
    drop(encoder);
    let out = folder.path().join("x.jsonl");
    let ended = handcast(&["track", path(&clip), "-o", path(&out), "--max-seconds", "3.9"]);
    let said = text(&ended.stderr);
    assert_eq!(ended.status.code(), Some(1), "{said}");
    assert!(said.contains("allowed at most 3.9; --max-seconds raises that"), "{said}");
    assert!(said.contains("x.partial.jsonl") && !out.exists(), "{said}");
    assert!(fs::read_to_string(folder.path().join("x.partial.jsonl")).unwrap().lines().count() > 50);
}

#[test]
fn numbered_pictures_are_named_as_ffmpeg_does() {
    let folder = tempfile::tempdir().unwrap();
    let pattern = folder.path().join("p%02d.png");
    let open = || open(&pattern, &OpenOptions::default());
    assert!(matches!(open().err(), Some(FrameError::NotFound { .. })));
    for (name, number) in [("p97.png", 97), ("p98.png", 98), ("p100.png", 100), ("q99.png", 0), ("p7.png", 0)]
    {
        picture(number).save(folder.path().join(name)).unwrap();
    }
    let source = open().unwrap();
    let notes = source.info().notices();
    assert!(
        notes.iter().any(|note| note.starts_with("1 number is missing, the first behind p98.png")),
        "{notes:?}"
    );
    let frames = all(source).unwrap();
    assert_eq!(frames.iter().map(|f| f.image.get_pixel(0, 0).0[2]).collect::<Vec<_>>(), [97, 98, 100]);
}
