//! Films as the program writes them: read back, and played in Chromium.

use std::io::Cursor;
use std::path::Path;

use crate::common::command::{done, handcast, misused, path, text};
use crate::common::glb::{chromium, node};
use handcast_media::film::{FilmWriter, TICKS};
use handcast_media::{FrameSource, OpenOptions, open};
use image::{Rgb, RgbImage};
use serde_json::Value;

/// A square that wanders over a ramp.
fn picture(i: u32, size: (u32, u32)) -> RgbImage {
    RgbImage::from_fn(size.0, size.1, |x, y| {
        let inside = x.abs_diff(20 + 3 * i) < 14 && y.abs_diff(30) < 14;
        if inside { Rgb([220, 60, 40]) } else { Rgb([40 + (x / 2) as u8, 90, 60 + (y / 2) as u8]) }
    })
}

#[test]
fn films_are_read_as_they_were_written() {
    for size in [(128, 96), (129, 97)] {
        let mut film = FilmWriter::new(Cursor::new(Vec::new()), size, 25.0, 600_000).unwrap();
        for i in 0..30 {
            film.write(&picture(i, size), if i == 4 { 2 * TICKS / 25 } else { TICKS / 25 }).unwrap();
        }
        let bytes = film.finish().unwrap().into_inner();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.mp4");
        std::fs::write(&path, &bytes).unwrap();
        let mut source = open(&path, &OpenOptions::default().with_ffmpeg(None)).unwrap();
        assert_eq!((source.info().width, source.info().height), (128, 96));
        let mut count = 0;
        while let Some(frame) = source.next_frame().unwrap() {
            let expected = f64::from(count + u32::from(count > 4)) / 25.0;
            assert!((frame.time - expected).abs() < 1e-6, "{count}: {}", frame.time);
            let original = picture(count, size);
            let mut off = 0.0;
            for (x, y, pixel) in frame.image.enumerate_pixels() {
                let there = original.get_pixel(x, y);
                off += (0..3).map(|k| f64::from(pixel[k].abs_diff(there[k]))).sum::<f64>();
            }
            let mean = off / f64::from(3 * 128 * 96);
            assert!(mean < 4.0, "{count}: {mean} levels off");
            count += 1;
        }
        assert_eq!(count, 30);
    }
}

/// What Chromium says of a film: its size, length, and the pictures at some times as levels of three places.
fn played(film: &Path, times: &[f64]) -> Value {
    let times: Vec<std::path::PathBuf> = times.iter().map(|time| time.to_string().into()).collect();
    let chromium = chromium();
    let mut arguments: Vec<&Path> = vec![&chromium, film];
    arguments.extend(times.iter().map(|time| time.as_path()));
    let output = node("film.js", &arguments);
    assert!(output.status.success(), "{}{}", text(&output.stdout), text(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn the_turntable_is_a_film() {
    let folder = tempfile::tempdir().unwrap();
    let [film, avi] = ["turn.mp4", "turn.avi"].map(|name| folder.path().join(name));
    let demo = "fixtures/demo.poses.jsonl";
    done(&["render", demo, "-o", path(&film), "--turntable", "--size", "160x180", "--frames", "24"]);
    let mut source = open(&film, &OpenOptions::default().with_ffmpeg(None)).unwrap();
    let mut pictures = Vec::new();
    while let Some(frame) = source.next_frame().unwrap() {
        pictures.push(frame);
    }
    assert_eq!((pictures.len(), pictures[0].image.dimensions()), (24, (160, 180)));
    // The motion's own length, 150 frames at 25 a second.
    assert!((5.0..6.1).contains(&pictures[23].time), "{}", pictures[23].time);
    assert_ne!(pictures[0].image, pictures[12].image);
    let clear = folder.path().join("clear.mp4");
    misused(&["render", demo, "-o", path(&avi)], &avi, &["allowed are .png, .gif, .webp, .mp4"]);
    misused(&["render", demo, "-o", path(&clear), "--transparent"], &clear, &["has a background"]);
}

#[test]
fn pictures_go_to_standard_output() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("x.png");
    let demo = "fixtures/demo.poses.jsonl";
    for how in [&["--frames", "3"][..], &["--at", "1", "--transparent"]] {
        let drawn = |output: &str| {
            let out = handcast(&[&["render", demo, "-o", output, "--size", "60x70"], how].concat());
            assert!(out.status.success(), "{}", text(&out.stderr));
            (out.stdout, text(&out.stderr))
        };
        drawn(path(&file));
        let (bytes, said) = drawn("-");
        assert!(bytes == std::fs::read(&file).unwrap() && said.starts_with("standard output: "), "{said}");
    }
}

/// Until the first pose there is nothing to be seen.
#[test]
fn films_keep_the_time_before_the_first_pose() {
    let folder = tempfile::tempdir().unwrap();
    let [late, glb, film] = ["late.jsonl", "late.glb", "late.mp4"].map(|name| folder.path().join(name));
    let text = std::fs::read_to_string("fixtures/demo.poses.jsonl").unwrap();
    let later = |line: &str| {
        let mut pose: Value = serde_json::from_str(line).unwrap();
        let time = pose["t"].as_f64().unwrap();
        pose["t"] = (time + 1.2).into();
        pose.to_string()
    };
    let lines: Vec<String> = text.lines().skip(1).take(20).map(later).collect();
    std::fs::write(&late, format!("{}\n{}\n", text.lines().next().unwrap(), lines.join("\n"))).unwrap();
    done(&["import", path(&late), "-o", path(&glb), "--anim-only"]);
    for input in [&late, &glb] {
        done(&["render", path(input), "-o", path(&film), "--size", "64x64"]);
        let mut source = open(&film, &OpenOptions::default().with_ffmpeg(None)).unwrap();
        let mut pictures = Vec::new();
        while let Some(frame) = source.next_frame().unwrap() {
            pictures.push(frame);
        }
        assert_eq!(pictures.len(), 21);
        assert_eq!(pictures[0].time, 0.0);
        assert!((pictures[1].time - 1.2).abs() < 1e-3, "{}", pictures[1].time);
        let levels =
            |i: usize| pictures[i].image.pixels().map(|p| p[0]).collect::<std::collections::BTreeSet<_>>();
        assert!(levels(0).len() < 8 && levels(1).len() > 20, "{} {}", levels(0).len(), levels(1).len());
    }
}

#[test]
#[ignore = "needs Chromium and npm ci --prefix tests/node"]
fn chromium_plays_the_overlay() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    done(&["demo", "-o", path(&out)]);
    let film = out.join("overlay.mp4");
    // Six seconds; ten are to stay below a megabyte.
    let bytes = std::fs::metadata(&film).unwrap().len();
    println!("overlay of six seconds: {bytes} bytes");
    assert!(bytes < 600_000, "{bytes}");
    let found = played(&film, &[0.02, 3.0]);
    assert!((found["duration"].as_f64().unwrap() - 6.0).abs() < 0.05, "{found}");
    let mut source = open(&film, &OpenOptions::default().with_ffmpeg(None)).unwrap();
    let info = source.info().clone();
    assert_eq!((&found["width"], &found["height"]), (&info.width.into(), &info.height.into()));
    // Colours are those that were written.
    let first = source.next_frame().unwrap().unwrap().image;
    // In the middle are thin lines, over which decoders spread colours each in its way.
    for (place, levels) in [(0.1, &found["levels"][0][0]), (0.9, &found["levels"][0][2])] {
        let at = |share: f64, length: u32| ((share * f64::from(length)) as u32).min(length - 1);
        let own = first.get_pixel(at(place, info.width), at(place, info.height));
        for k in 0..3 {
            let theirs = levels[k].as_f64().unwrap();
            assert!((theirs - f64::from(own[k])).abs() < 12.0, "{place}: {own:?} {levels}");
        }
    }
}
