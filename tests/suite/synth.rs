//! `handcast synth` and `handcast render` from the command line.

use crate::common::command::program;
use handcast_eval::synth::{Synth, SynthOptions};
use handcast_formats::poses::read_poses;
use handcast_media::avi::MjpegWriter;
use handcast_media::{OpenOptions, open};
use image::RgbImage;
use std::path::Path;
use std::process::Command;

fn handcast() -> Command {
    Command::new(program())
}

/// Runs it successfully.
fn done(command: &mut Command) {
    let out = command.output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
}

#[test]
fn a_clip_its_poses_and_its_masks_agree_in_number_and_size() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    done(
        handcast()
            .args([
                "synth", "--frames", "7", "--size", "120x90", "--motion", "fist", "--hand", "left", "-q",
                "-o",
            ])
            .arg(at("clip.avi"))
            .arg("--masks")
            .arg(at("masks")),
    );
    let poses = read_poses(&at("clip.poses.jsonl")).unwrap();
    assert_eq!(poses.frames.len(), 7);
    assert!(poses.header.hands[0].morphology.is_some());
    let mut source = open(at("clip.avi"), &OpenOptions::default()).unwrap();
    let mut frames = 0;
    while let Some(frame) = source.next_frame().unwrap() {
        assert_eq!(frame.image.dimensions(), (120, 90));
        frames += 1;
    }
    assert_eq!(frames, 7);
    assert_eq!(std::fs::read_dir(at("masks")).unwrap().count(), 7);

    done(
        handcast()
            .arg("render")
            .arg(at("clip.poses.jsonl"))
            .args(["--frames", "3", "--size", "60x70", "-o"])
            .arg(at("sheet.png")),
    );
    assert_eq!(image::open(at("sheet.png")).unwrap().width(), 3 * 61 + 1);
    done(
        handcast()
            .arg("render")
            .arg(at("clip.poses.jsonl"))
            .args(["--size", "60x70", "--turntable", "-o"])
            .arg(at("turn.gif")),
    );
}

#[test]
fn true_poses_of_another_clip_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let synth = |more: &[&str]| {
        let small = ["synth", "--frames", "3", "--size", "32x24", "-q"];
        handcast().current_dir(folder.path()).args(small).args(more).output().unwrap()
    };
    let truth = || std::fs::read(folder.path().join("clip.poses.jsonl")).unwrap();
    assert!(synth(&["-o", "clip.avi"]).status.success());
    let first = truth();
    // The same motion is the same truth.
    assert!(synth(&["-o", "clip/"]).status.success());
    for line in [&["-o", "clip/", "--motion", "fist"][..], &["-o", "clip.avi", "--turn", "10"]] {
        let refused = synth(line);
        let message = String::from_utf8(refused.stderr).unwrap();
        assert_eq!(refused.status.code(), Some(1), "{message}");
        assert!(message.contains("clip.poses.jsonl may have the true poses of clip"), "{message}");
        assert!(message.contains("--poses"), "{message}");
        assert!(truth() == first);
    }
    assert!(synth(&["-o", "clip/", "--motion", "fist", "--poses", "fist.jsonl"]).status.success());
    assert!(truth() == first);
    assert!(synth(&["-o", "clip.avi", "--turn", "10", "--poses", "clip.poses.jsonl"]).status.success());
    assert!(truth() != first);
    // A clip alone is made anew with its truth.
    std::fs::remove_dir_all(folder.path().join("clip")).unwrap();
    assert!(synth(&["-o", "clip.avi"]).status.success());
    assert!(truth() == first);
}

/// The frames of the built-in clip, and these pictures from it: the same to the eye.
fn assert_built_in(pictures: impl Iterator<Item = (usize, RgbImage)>) -> usize {
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/demo.avi");
    let mut kept = open(fixture, &OpenOptions::default()).unwrap();
    let mut frames = 0;
    for (number, picture) in pictures {
        let mut frame = kept.next_frame().unwrap().unwrap();
        while frame.index < number {
            frame = kept.next_frame().unwrap().unwrap();
        }
        let differences = picture.iter().zip(frame.image.iter()).map(|(a, b)| f64::from(a.abs_diff(*b)));
        let mean = differences.sum::<f64>() / picture.len() as f64;
        assert!(mean < 0.05, "frame {number} differs by {mean:.3} levels on average");
        frames += 1;
    }
    frames
}

fn pictures_of(clip: &Path) -> impl Iterator<Item = (usize, RgbImage)> {
    let mut source = open(clip, &OpenOptions::default()).unwrap();
    std::iter::from_fn(move || source.next_frame().unwrap()).map(|frame| frame.image).enumerate()
}

/// The built-in clip is made by the surface of today.
#[test]
fn frames_of_the_built_in_clip_are_what_is_drawn_now() {
    const EVERY: usize = 6;
    let folder = tempfile::tempdir().unwrap();
    let made = folder.path().join("some.avi");
    let synth = Synth::new(SynthOptions::default()).unwrap();
    let file = std::fs::File::create(&made).unwrap();
    let mut writer = MjpegWriter::new(file, synth.options().size, (25, 1), 85).unwrap();
    for number in (0..synth.frames()).step_by(EVERY) {
        writer.write(&synth.render(number).image).unwrap();
    }
    writer.finish().unwrap();
    let numbered = pictures_of(&made).map(|(i, picture)| (EVERY * i, picture));
    assert_eq!(assert_built_in(numbered), 150 / EVERY);
}

/// All of it, as `fixtures/README.md` says.
#[test]
#[ignore = "exhaustive: every frame"]
fn the_built_in_clip_is_what_its_command_makes() {
    let folder = tempfile::tempdir().unwrap();
    let made = folder.path().join("demo.avi");
    let poses = folder.path().join("demo.poses.jsonl");
    done(
        handcast()
            .args(["synth", "--frames", "150", "--fps", "25", "--size", "480x360", "-q", "-o"])
            .arg(&made)
            .arg("--poses")
            .arg(&poses),
    );
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures");
    let (of, kept) = (read_poses(&poses).unwrap(), read_poses(&fixtures.join("demo.poses.jsonl")).unwrap());
    assert_eq!((of.header, of.frames.len()), (kept.header, kept.frames.len()));
    assert_eq!(assert_built_in(pictures_of(&made)), 150);
}

#[test]
fn wrong_requests_fail_plainly_and_leave_nothing() {
    let folder = tempfile::tempdir().unwrap();
    for (arguments, message) in [
        (vec!["--frames", "0"], "number of frames is 0"),
        (vec!["--quality", "0"], "1..=100"),
        (vec!["--distance", "99"], "distance"),
    ] {
        let output = handcast()
            .arg("synth")
            .args(&arguments)
            .arg("-o")
            .arg(folder.path().join("x.avi"))
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(2));
        let text = String::from_utf8(output.stderr).unwrap();
        assert!(text.contains(message), "{text}");
    }
    let output = handcast().args(["synth", "-o"]).arg(folder.path().join("x.mp4")).output().unwrap();
    assert!(String::from_utf8(output.stderr).unwrap().contains("cannot write .mp4"));
    let output =
        handcast().args(["render", "missing.jsonl", "-o"]).arg(folder.path().join("x.png")).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}
