//! Clips that are cut or damaged, through the program: what is whole of them is tracked, and what is missing is told.

use std::fs;
use std::io::{Cursor, Write as _};
use std::path::Path;
use std::process::{Command, Output};
use std::sync::OnceLock;

use handcast_media::film::{FilmWriter, TICKS};
use handcast_media::{FrameSource, OpenOptions, Part, open};
use image::RgbImage;

use crate::common::command::{program, text};

/// Pictures of each clip.
const COUNT: usize = 40;

/// The first pictures of the built-in clip, an open hand.
fn pictures() -> &'static [RgbImage] {
    static READ: OnceLock<Vec<RgbImage>> = OnceLock::new();
    READ.get_or_init(|| {
        let clip = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/demo.avi");
        let mut source = open(clip, &OpenOptions::default().with_max_side(320)).unwrap();
        (0..COUNT).map(|_| source.next_frame().unwrap().unwrap().image).collect()
    })
}

/// Where a box begins in the bytes of another.
fn place(bytes: &[u8], kind: &[u8; 4]) -> usize {
    bytes.windows(4).position(|word| word == kind).unwrap() - 4
}

/// MP4 with its tables before the pictures, as for the web, and where the pictures begin.
fn mp4() -> (Vec<u8>, usize) {
    let size = pictures()[0].dimensions();
    let mut writer = FilmWriter::new(Cursor::new(Vec::new()), size, 25.0, 700_000).unwrap();
    pictures().iter().for_each(|picture| writer.write(picture, TICKS / 25).unwrap());
    let last = writer.finish().unwrap().into_inner();
    let (mdat, moov) = (place(&last, b"mdat"), place(&last, b"moov"));
    let mut tables = last[moov..].to_vec();
    let shift = tables.len() as u64;
    let (at, width) = match tables.windows(4).position(|word| word == b"co64") {
        Some(at) => (at, 8),
        None => (place(&tables, b"stco") + 4, 4),
    };
    let count = u32::from_be_bytes(tables[at + 8..at + 12].try_into().unwrap()) as usize;
    for chunk in 0..count {
        let entry = &mut tables[at + 12 + chunk * width..][..width];
        let told = entry.iter().fold(0, |sum, &byte| sum << 8 | u64::from(byte)) + shift;
        entry.copy_from_slice(&told.to_be_bytes()[8 - width..]);
    }
    let first = mdat + tables.len();
    ([&last[..mdat], &tables, &last[mdat..moov]].concat(), first)
}

fn avi() -> Vec<u8> {
    use handcast_media::avi::MjpegWriter;
    let size = pictures()[0].dimensions();
    let mut writer = MjpegWriter::new(Cursor::new(Vec::new()), size, (25, 1), 90).unwrap();
    pictures().iter().for_each(|picture| writer.write(picture).unwrap());
    writer.finish().unwrap().into_inner()
}

fn gif() -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = image::codecs::gif::GifEncoder::new_with_speed(&mut bytes, 30);
    for picture in pictures() {
        let picture = image::DynamicImage::from(picture.clone()).to_rgba8();
        let delay = image::Delay::from_numer_denom_ms(40, 1);
        encoder.encode_frame(image::Frame::from_parts(picture, 0, 0, delay)).unwrap();
    }
    drop(encoder);
    bytes
}

fn y4m() -> Vec<u8> {
    let (width, height) = pictures()[0].dimensions();
    let mut bytes = format!("YUV4MPEG2 W{width} H{height} F25:1 Ip C444\n").into_bytes();
    for picture in pictures() {
        bytes.write_all(b"FRAME\n").unwrap();
        let plane = |of: fn([f64; 3]) -> f64| picture.pixels().map(move |p| of(p.0.map(f64::from)) as u8);
        bytes.extend(plane(|[r, g, b]| 16.0 + 0.257 * r + 0.504 * g + 0.098 * b));
        bytes.extend(plane(|[r, g, b]| 128.0 - 0.148 * r - 0.291 * g + 0.439 * b));
        bytes.extend(plane(|[r, g, b]| 128.0 + 0.439 * r - 0.368 * g - 0.071 * b));
    }
    bytes
}

/// Tracks a clip without ffmpeg: how it ended, and the times of the poses.
fn track(folder: &Path, clip: &str) -> (Output, Vec<f64>) {
    let poses = folder.join("poses.jsonl");
    let _ = fs::remove_file(&poses);
    let mut command = Command::new(program());
    command.current_dir(folder).args(["track", clip, "-o", "poses.jsonl", "--no-net", "-q"]);
    let out = command.env("PATH", folder).output().unwrap();
    let lines = fs::read_to_string(poses).unwrap_or_default();
    let time = |line: &str| {
        let value: serde_json::Value = serde_json::from_str(line).unwrap();
        value["t"].as_f64().or_else(|| value["time"].as_f64()).unwrap()
    };
    (out, lines.lines().skip(1).map(time).collect())
}

/// Tracks a clip of which so many pictures are there, and gives what is said of it.
fn shown(folder: &Path, clip: &str, bytes: &[u8], pictures: std::ops::RangeInclusive<usize>) -> String {
    fs::write(folder.join(clip), bytes).unwrap();
    let (out, times) = track(folder, clip);
    let said = text(&out.stderr);
    println!("{clip}: {} poses, {said}", times.len());
    assert_eq!(out.status.code(), Some(0), "{clip}: {said}");
    assert!(pictures.contains(&times.len()), "{clip}: {} poses, {said}", times.len());
    if times.len() == COUNT {
        return said;
    }
    assert!(said.starts_with(&format!("handcast: {clip}: ")) && said.lines().count() == 1, "{said}");
    let [told, counted] = [format!("of the {COUNT} pictures that it tells of"), " pictures are there".into()];
    assert!(said.contains(&told) || said.contains(&format!("{}{counted}", times.len())), "{said}");
    said
}

#[test]
fn clips_that_are_cut_are_tracked_to_their_end_and_say_so() {
    let folder = tempfile::tempdir().unwrap();
    for (clip, bytes, first) in
        [("a.avi", avi(), 200), ("a.gif", gif(), 800), ("a.y4m", y4m(), 40), ("a.mp4", mp4().0, mp4().1)]
    {
        assert_eq!(shown(folder.path(), clip, &bytes, COUNT..=COUNT), "", "{clip}");
        for percent in [61, 93] {
            let cut = first + (bytes.len() - first) * percent / 100;
            let most = COUNT * (percent + 15) / 100;
            shown(folder.path(), clip, &bytes[..cut], COUNT / 4..=most.min(COUNT - 1));
        }
        // Before the first picture is whole nothing can be done with it.
        fs::write(folder.path().join(clip), &bytes[..first + 20]).unwrap();
        let (out, times) = track(folder.path(), clip);
        let said = text(&out.stderr);
        assert!(out.status.code() == Some(1) && times.is_empty(), "{clip}: {said}");
        assert!(said.contains(clip) && said.lines().count() == 1, "{said}");
    }
}

/// As with `--mask`, whose pictures go by numbers.
#[test]
fn a_clip_whose_pictures_need_their_numbers_tells_as_much() {
    let folder = tempfile::tempdir().unwrap();
    let clip = folder.path().join("cut.mp4");
    let (bytes, first) = mp4();
    fs::write(&clip, &bytes[..first + (bytes.len() - first) / 2]).unwrap();
    let [plain, numbered] = [Part::WHOLE, Part { numbered: true, ..Part::WHOLE }].map(|part| {
        let mut source = open(&clip, &OpenOptions::default().with_part(part)).unwrap();
        while source.next_frame().unwrap().is_some() {}
        (source.info().told, source.shortfall())
    });
    assert!(plain.0 == Some(COUNT) && plain.1.is_some(), "{plain:?}");
    assert_eq!(numbered, plain);
}

#[test]
fn a_damaged_picture_is_passed_over_and_the_others_keep_their_times() {
    let folder = tempfile::tempdir().unwrap();
    // The start of a JPEG.
    let mut clip = avi();
    let chunk = (0..clip.len() - 4).filter(|&at| &clip[at..at + 4] == b"00dc").nth(25).unwrap();
    clip[chunk + 8..chunk + 400].fill(0);
    let said = shown(folder.path(), "a.avi", &clip, COUNT - 1..=COUNT - 1);
    assert!(said.contains("frame 25 at 1.000 s"), "{said}");
    let (_, times) = track(folder.path(), "a.avi");
    assert!(times.windows(2).all(|pair| pair[1] > pair[0]) && times.last() == Some(&1.56), "{times:?}");
    // The head of a chunk, behind which the next one has to be looked for.
    let mut clip = avi();
    clip[chunk - 60..chunk + 20].fill(0);
    let said = shown(folder.path(), "a.avi", &clip, COUNT - 2..=COUNT - 1);
    assert!(said.contains("damaged"), "{said}");
    // A length in a picture of H.264: those behind it have what they refer to all the same.
    let (mut clip, first) = mp4();
    let tables = place(&clip, b"stsz") + 20;
    let sizes: Vec<usize> = (0..25)
        .map(|n| u32::from_be_bytes(clip[tables + 4 * n..][..4].try_into().unwrap()) as usize)
        .collect();
    let at = first + 16 + sizes.iter().sum::<usize>();
    clip[at..at + 4].fill(0xff);
    let said = shown(folder.path(), "a.mp4", &clip, COUNT / 2..=COUNT - 1);
    assert!(said.contains("could not be decoded") && said.contains("frame 25 at 1.000 s"), "{said}");
    // A picture of a folder.
    let pictures_in = folder.path().join("pictures");
    fs::create_dir(&pictures_in).unwrap();
    for (number, picture) in pictures().iter().enumerate() {
        picture.save(pictures_in.join(format!("p{number:03}.png"))).unwrap();
    }
    let whole = fs::read(pictures_in.join("p020.png")).unwrap();
    fs::write(pictures_in.join("p020.png"), &whole[..whole.len() / 2]).unwrap();
    let (out, times) = track(folder.path(), "pictures");
    let said = text(&out.stderr);
    assert_eq!((out.status.code(), times.len()), (Some(0), COUNT - 1), "{said}");
    assert!(said.contains("p020.png: truncated") && said.contains("of the 40 pictures"), "{said}");
}

#[test]
#[ignore = "needs ffmpeg"]
fn what_the_decoder_cannot_do_goes_on_through_the_helper_program() {
    let folder = tempfile::tempdir().unwrap();
    let (mut clip, first) = mp4();
    let at = first + (clip.len() - first) / 2;
    clip[at..at + 200].fill(0);
    let mut moved = mp4().0;
    moved[5] ^= 0xff;
    for (bytes, words) in [(clip, "from there on it was read through ffmpeg"), (moved, "")] {
        let path = folder.path().join("a.mp4");
        fs::write(&path, bytes).unwrap();
        let mut source = open(&path, &OpenOptions::default()).unwrap();
        let mut read = 0;
        while let Some(frame) = source.next_frame().unwrap() {
            assert!((frame.time - frame.index as f64 / 25.0).abs() < 1e-6, "{}: {}", frame.index, frame.time);
            read += 1;
        }
        let said = source.shortfall().unwrap_or_default();
        assert!(read >= COUNT - 2 && said.contains(words), "{read}: {said}");
    }
}
