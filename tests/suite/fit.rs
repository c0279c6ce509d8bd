//! `handcast fit`: a person file from a picture of the open hand, or a true reason.

use std::path::{Path, PathBuf};

use crate::common::command::{done, handcast, path, refused, text};
use crate::common::shared;
use handcast_eval::synth::{Background, ScriptedMotion, Synth, SynthFrame, SynthOptions};
use handcast_formats::person::read_person;
use handcast_hand::Side;
use handcast_track::View;
use image::{ExtendedColorType, ImageEncoder, Rgb, RgbImage};
use serde_json::Value;

fn open_hand(change: impl FnOnce(&mut SynthOptions)) -> SynthFrame {
    let mut options = SynthOptions::default();
    (options.motion, options.size) = (ScriptedMotion::Still, (640, 480));
    change(&mut options);
    Synth::new(options).unwrap().render(0)
}

fn saved(dir: &Path, name: &str, image: &RgbImage) -> PathBuf {
    let file = dir.join(name);
    image.save(&file).unwrap();
    file
}

/// The JSON report of a fit of `image`; the person file appears as `person.toml` in `dir`.
fn fitted(dir: &Path, image: &Path, more: &[&str]) -> Value {
    let person = dir.join("person.toml");
    let report = done(&[&["fit", path(image), "-o", path(&person), "--json"], more].concat());
    read_person(&person).unwrap();
    serde_json::from_str(&report).unwrap()
}

fn number(report: &Value, key: &str) -> f64 {
    report[key].as_f64().unwrap_or_else(|| panic!("{key} in {report}"))
}

#[test]
fn a_part_of_a_clip_is_looked_at() {
    let dir = tempfile::tempdir().unwrap();
    let person = dir.path().join("person.toml");
    let made = |more: &[&str]| {
        done(&[&["fit", "fixtures/demo.avi", "-o", path(&person), "-q"], more].concat());
        std::fs::read_to_string(&person).unwrap()
    };
    let tenth = made(&["--frame", "10"]);
    assert_eq!(made(&["--from", "0.4"]), tenth);
    assert_eq!(made(&["--from", "0.36", "--frame", "1", "--until", "0:00.44"]), tenth);
    assert_ne!(made(&[]), tenth);
    std::fs::remove_file(&person).unwrap();
    let fit = ["fit", "fixtures/demo.avi", "-o", path(&person)];
    refused(&[&fit[..], &["--from", "5.9", "--frame", "9"]].concat(), &person, &["demo.avi", "frame 9 of 2"]);
    refused(&[&fit[..], &["--from", "7"]].concat(), &person, &["demo.avi"]);
    assert_eq!(handcast(&[&fit[..], &["--from", "2", "--until", "1"]].concat()).status.code(), Some(2));
}

/// Of so many persons, either hand from either side.
fn assert_found(persons: u64) {
    let report = done(&["bench", "fit", "--persons", &persons.to_string(), "--json"]);
    let report: Value = serde_json::from_str(&report).unwrap();
    println!("{report}");
    assert_eq!((report["hands"].as_u64(), report["refused"].as_u64()), (Some(4 * persons), Some(0)));
    assert!(number(&report, "finger_length_error") < 0.04, "{report}");
    assert!(number(&report, "abduction_error_deg") < 3.0, "{report}");
    assert!(number(&report, "wrist_error") < 0.04, "{report}");
    assert!(number(&report, "worst_iou") > 0.94, "{report}");
}

#[test]
fn sizes_of_two_made_up_persons_are_found() {
    assert_found(2);
}

#[test]
#[ignore = "exhaustive: three persons"]
fn sizes_of_three_made_up_persons_are_found() {
    assert_found(3);
}

#[test]
#[ignore = "needs the shared material"]
fn open_hands_on_real_pictures_fit_and_others_are_refused_for_their_reason() {
    let dir = tempfile::tempdir().unwrap();
    for (name, hand) in [("count-5", "left"), ("open-black-cloth-ring", "right")] {
        let still = shared(&format!("data/stills/{name}.jpg"));
        let report = fitted(dir.path(), &still, &[]);
        assert!(number(&report, "iou") >= 0.92, "{name}: {report}");
        assert_eq!((&report["hand"], &report["view_assumed"]), (&hand.into(), &true.into()), "{name}");
    }
    for (name, words) in [
        ("adducted-f_d", "fingers are closed"),
        ("adducted-f_p", "spread them"),
        ("adducted-m_d", "fingers are closed"),
        ("adducted-m_p", "fingers are closed"),
        ("count-1", "fingers are missing: 1 of 5"),
        ("count-2", "fingers are missing: 2 of 5"),
        ("count-3", "fingers are missing: 3 of 5"),
        ("count-4", "fingers are missing: 4 of 5"),
        ("hard-lowcontrast-index", "fingers are missing: 1 of 5"),
    ] {
        let still = shared(&format!("data/stills/{name}.jpg"));
        let none = dir.path().join("none.toml");
        refused(&["fit", path(&still), "-o", path(&none)], &none, &[name, words]);
    }
}

#[test]
#[cfg(feature = "h264")]
#[ignore = "needs the shared material"]
fn open_frames_of_clips_fit() {
    let dir = tempfile::tempdir().unwrap();
    for (name, frame) in [("finger-flexions", "0"), ("counting", "185")] {
        let clip = shared(&format!("data/clips/{name}.mp4"));
        let report = fitted(dir.path(), &clip, &["--frame", frame]);
        assert!(number(&report, "iou") >= 0.92, "{name}: {report}");
        assert_eq!(report["forearm"], true);
    }
}

#[test]
fn every_stage_is_drawn_as_far_as_it_came() {
    let dir = tempfile::tempdir().unwrap();
    let pictures = |folder: &Path| {
        let mut names: Vec<_> =
            folder.read_dir().unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    };
    let hand = saved(dir.path(), "hand.png", &open_hand(|_| ()).image);
    let debug = dir.path().join("debug");
    let report = fitted(dir.path(), &hand, &["--debug", path(&debug)]);
    assert!(number(&report, "iou") > 0.95);
    let all = [
        "1-skin-likelihood.png",
        "2-raw-mask.png",
        "3-clean-mask.png",
        "4-forearm-cut.png",
        "5-finger-residues.png",
        "6-parts.png",
        "7-model.png",
        "fit.png",
    ];
    assert_eq!(pictures(&debug), all);
    let mut options = SynthOptions::default();
    (options.motion, options.frames) = (ScriptedMotion::Fist, 3);
    let fist = saved(dir.path(), "fist.png", &Synth::new(options).unwrap().render(1).image);
    let (none, debug) = (dir.path().join("none.toml"), dir.path().join("debug-fist"));
    refused(&["fit", path(&fist), "-o", path(&none), "--debug", path(&debug)], &none, &["of 5"]);
    assert_eq!(pictures(&debug), all[..5]);
}

#[test]
fn several_hands_and_none_are_told() {
    let dir = tempfile::tempdir().unwrap();
    let none = dir.path().join("none.toml");
    let right = open_hand(|o| (o.background, o.forearm) = (Background::Plain, false)).image;
    let left = image::imageops::flip_horizontal(&right);
    let mut both = RgbImage::new(1280, 480);
    image::imageops::replace(&mut both, &right, 0, 0);
    image::imageops::replace(&mut both, &left, 640, 0);
    let both = saved(dir.path(), "both.png", &both);
    refused(&["fit", path(&both), "-o", path(&none)], &none, &["both.png", "2 hands"]);
    let plain = saved(dir.path(), "plain.png", &RgbImage::from_pixel(320, 240, Rgb([120, 130, 140])));
    refused(&["fit", path(&plain), "-o", path(&none)], &none, &["plain.png", "no hand"]);
    let text = dir.path().join("words.jpg");
    std::fs::write(&text, "no picture").unwrap();
    refused(&["fit", path(&text), "-o", path(&none)], &none, &["words.jpg"]);
}

#[test]
fn hand_and_view_are_told_by_the_thumb_and_what_is_known() {
    let dir = tempfile::tempdir().unwrap();
    let back = open_hand(|o| (o.side, o.view) = (Side::Right, View::Back)).image;
    let hand = saved(dir.path(), "hand.png", &back);
    let told = |more: &[&str]| {
        let r = fitted(dir.path(), &hand, more);
        (r["hand"].clone(), r["view"].clone(), r["view_assumed"].clone())
    };
    let is = |hand: &str, view: &str, assumed: bool| (hand.into(), view.into(), assumed.into());
    assert_eq!(told(&[]), is("left", "palm", true));
    assert_eq!(told(&["--hand", "right"]), is("right", "back", false));
    assert_eq!(told(&["--view", "back"]), is("right", "back", false));
    assert_eq!(told(&["--hand", "right", "--view", "back"]), is("right", "back", false));
    let none = dir.path().join("none.toml");
    let wrong = ["fit", path(&hand), "-o", path(&none), "--hand", "right", "--view", "palm"];
    refused(&wrong, &none, &["palm of a right hand", "thumb on the right"]);
    let out = handcast(&["fit", path(&hand), "-o", path(&none)]);
    assert!(
        text(&out.stdout).contains(
            "a guess: the back of a right hand has the same silhouette; --hand or --view settles it"
        ),
        "{}",
        text(&out.stdout)
    );
}

#[test]
fn masks_and_samples_take_the_place_of_guessing() {
    let dir = tempfile::tempdir().unwrap();
    // Skin of a colour that no rule knows.
    let frame = open_hand(|o| (o.skin, o.background) = ([90, 150, 200], Background::Plain));
    let hand = saved(dir.path(), "blue.png", &frame.image);
    let mask = dir.path().join("mask.png");
    frame.skin.to_gray().save(&mask).unwrap();
    let by_mask = fitted(dir.path(), &hand, &["--mask", path(&mask)]);
    let [x, y] = frame.hand.centroid().unwrap();
    let rectangle = format!("{},{},20,20", x as u32 - 10, y as u32 - 10);
    let by_sample = fitted(dir.path(), &hand, &["--sample", &rectangle]);
    for report in [&by_mask, &by_sample] {
        assert!(number(report, "iou") > 0.94, "{report}");
        assert!((number(report, "palm_width_mm") / number(&by_mask, "palm_width_mm") - 1.0).abs() < 0.05);
    }
    let none = dir.path().join("none.toml");
    let beyond = ["fit", path(&hand), "-o", path(&none), "--sample", "600,10,100,10"];
    refused(&beyond, &none, &["600,10,100,10", "640 x 480"]);
    let other = saved(dir.path(), "other.png", &RgbImage::from_pixel(100, 300, Rgb([255; 3])));
    refused(&["fit", path(&hand), "-o", path(&none), "--mask", path(&other)], &none, &["skin"]);
}

/// A JPEG that asks to be turned a quarter clockwise (orientation 6), as phones write portraits.
fn turned_jpeg(upright: &RgbImage) -> Vec<u8> {
    let stored = image::imageops::rotate270(upright);
    let mut jpeg = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 92)
        .write_image(stored.as_raw(), stored.width(), stored.height(), ExtendedColorType::Rgb8)
        .unwrap();
    let mut exif = b"Exif\0\0MM\0\x2a\0\0\0\x08\0\x01".to_vec();
    exif.extend([0x01, 0x12, 0, 3, 0, 0, 0, 1, 0, 6, 0, 0, 0, 0, 0, 0]);
    let length = (exif.len() as u16 + 2).to_be_bytes();
    let segment = [&[0xff, 0xe1, length[0], length[1]], exif.as_slice()].concat();
    [&jpeg[..2], &segment, &jpeg[2..]].concat()
}

#[test]
fn pictures_of_phones_are_turned_upright() {
    let dir = tempfile::tempdir().unwrap();
    let upright = open_hand(|_| ()).image;
    let plain = fitted(dir.path(), &saved(dir.path(), "plain.png", &upright), &[]);
    let phone = dir.path().join("phone.jpg");
    std::fs::write(&phone, turned_jpeg(&upright)).unwrap();
    let turned = fitted(dir.path(), &phone, &[]);
    for k in 0..2 {
        let off = turned["wrist"][k].as_f64().unwrap() - plain["wrist"][k].as_f64().unwrap();
        assert!(off.abs() < 6.0, "{turned} {plain}");
    }
}

#[test]
fn a_person_serves_every_command_and_a_bad_one_none() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let frame = open_hand(|o| o.morphology = handcast_hand::Morphology::average(0.17));
    let hand = saved(dir.path(), "hand.png", &frame.image);
    let (json, toml) = (at("p.json"), at("p.toml"));
    for person in [&json, &toml] {
        done(&["fit", path(&hand), "-o", path(person), "--hand-length-mm", "170"]);
    }
    let person = read_person(&toml).unwrap();
    assert_eq!(read_person(&json).unwrap(), person);
    assert!((person.morphology.hand_length - 0.17).abs() < 1e-9);

    let clip = at("clip.avi");
    done(&["synth", "-o", path(&clip), "--frames", "8", "--motion", "still", "--person", path(&toml)]);
    done(&["run", path(&clip), "-o", path(&at("out")), "--person", path(&toml), "--no-pictures"]);
    assert_eq!(read_person(&at("out/person.toml")).unwrap().morphology, person.morphology);
    let fba = at("out/hand.fba");
    let poses = at("out/poses.jsonl");
    let commands: [(&str, &[&str]); 4] = [
        ("pose", &["asl:A", "--anim-only"]),
        ("spell", &["HI", "--anim-only"]),
        ("decode", &[path(&fba), "--anim-only"]),
        ("render", &[path(&poses)]),
    ];
    for (command, arguments) in commands {
        let out = at(if command == "render" { "made.png" } else { "made.glb" });
        let good = if command == "pose" { &json } else { &toml };
        let bad = at("bad.toml");
        let with = |person| [&[command], arguments, &["-o", path(&out), "--person", path(person)]].concat();
        done(&with(good));
        std::fs::remove_file(&out).unwrap();
        let text = std::fs::read_to_string(&toml).unwrap();
        let all = [
            ("hand_length = 0.17", "hand_length = 17.0", "hand_length is 17 m, allowed 0.05 to 0.4 m"),
            ("hand_length = 0.17", "hand_length = nan", "hand_length is NaN m"),
            ("palm_radius", "palm_radios", "palm_radios"),
            ("[morphology.fingers.ring]", "[morphology.fingers.toe]", "toe"),
        ];
        for (from, to, words) in &all[..if command == "pose" { 4 } else { 1 }] {
            std::fs::write(&bad, text.replace(from, to)).unwrap();
            refused(&with(&bad), &out, &["bad.toml", words]);
        }
    }
}
