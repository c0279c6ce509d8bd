//! The model as a user meets it: the command on hand shapes, spelling and imports, and the tables in spec.

use std::path::Path;
use std::process::{Command, Output};

use crate::common::command::{program, text};
use handcast_formats::poses::read_poses;
use handcast_hand::anthropometry::{Bounds, check};
use handcast_hand::shapes::ShapeLibrary;
use handcast_hand::{Domain, Joint, JointAngle, Morphology, Side, Skeleton, limits};

fn handcast(args: &[&str], dir: &Path) -> Output {
    Command::new(program()).args(args).current_dir(dir).output().unwrap()
}

/// Runs it successfully.
fn done(args: &[&str], dir: &Path) -> Output {
    let out = handcast(args, dir);
    assert!(out.status.success(), "{args:?}: {}", text(&out.stderr));
    out
}

#[test]
fn limits_are_those_of_the_spec() {
    let text = include_str!("../../spec/hand-model.md");
    let rows = text.lines().skip_while(|l| !l.starts_with("## 3")).filter(|l| l.starts_with("| `"));
    let mut seen = Vec::new();
    for row in rows.take_while(|l| !l.contains("offset")) {
        let cells: Vec<_> = row.trim_matches('|').split('|').map(str::trim).collect();
        let number = |s: &str| s.replace('−', "-").parse::<f64>().unwrap();
        let (min, max) = (number(cells[1]), number(cells[2]));
        for name in cells[0].split(',').map(|n| n.trim().trim_matches('`')) {
            let names: Vec<String> = match name.strip_prefix('x') {
                Some(rest) => ["index", "middle", "ring", "pinky"].map(|f| format!("{f}{rest}")).into(),
                None => vec![name.into()],
            };
            for name in names {
                let l = limits(JointAngle::from_name(&name).unwrap());
                assert!((l.min.to_degrees() - min).abs() < 1e-9, "{name}");
                assert!((l.max.to_degrees() - max).abs() < 1e-9, "{name}");
                seen.push(name);
            }
        }
    }
    seen.sort();
    seen.dedup();
    assert_eq!(seen.len(), 29);
}

/// The standard's neutral arm hangs, the palm to the thigh: x to the body's left, y up, z forward, the left
/// hand. Fingers point down, the thumb forward, and the palm to the right.
#[test]
fn the_suggested_body_is_the_neutral_shape() {
    let mut rows = include_str!("../../spec/suggested-joints.csv").lines().skip(1).map(|row| {
        let (name, place) = row.split_once(',').unwrap();
        let place: Vec<f64> = place.split(',').map(|v| v.parse().unwrap()).collect();
        (name, [place[0], place[1], place[2]])
    });
    let (name, wrist) = rows.next().unwrap();
    assert_eq!(name, "wrist");
    let joints: Vec<_> =
        Joint::ALL.into_iter().filter(|j| *j != Joint::Wrist && !j.webxr_name().ends_with("tip")).collect();
    let morphology = Morphology::suggested_body();
    morphology.validate().unwrap();
    assert_eq!(check(&morphology, Bounds::Persons).len(), 4, "why it is not the default");
    let [left, right] =
        [Side::Left, Side::Right].map(|s| Skeleton::new(&morphology, s).local_frames(&[0.0; 29]));
    let mut count = 0;
    for (joint, (name, place)) in joints.iter().zip(rows) {
        let finger = name.trim_end_matches(|c: char| c.is_ascii_digit());
        assert!(joint.webxr_name().starts_with(finger), "{name} is not {}", joint.webxr_name());
        let [x, y, z] = [0, 1, 2].map(|k| place[k] - wrist[k]);
        for (frames, radial) in [(&left, -1.0), (&right, 1.0)] {
            let found = frames.position(*joint).coords - nalgebra::Vector3::new(radial * z, -y, -x);
            assert!(found.norm() < 5e-5, "{name}: off by {found:?}");
        }
        count += 1;
    }
    assert_eq!((count, joints.len()), (19, 19));
}

#[test]
fn the_mean_hand_is_a_hand() {
    assert_eq!(check(&Morphology::default(), Bounds::Persons), []);
}

#[test]
fn shapes_are_written_as_pictures_models_and_poses() {
    let dir = tempfile::tempdir().unwrap();
    let run = |args: &[&str]| done(args, dir.path());
    run(&["pose", "asl:A", "-o", "a.png", "--size", "96x96"]);
    let picture = image::open(dir.path().join("a.png")).unwrap().to_rgb8();
    assert_eq!(picture.dimensions(), (96, 96));
    let colours: std::collections::BTreeSet<_> = picture.pixels().map(|p| p.0).collect();
    assert!(colours.len() > 100, "a shaded hand, not a plain field");
    run(&["pose", "f", "-o", "f.glb", "--hand", "left"]);
    let bytes = std::fs::read(dir.path().join("f.glb")).unwrap();
    assert_eq!(&bytes[..4], b"glTF");
    run(&["pose", "ASL:d", "-o", "d.jsonl"]);
    let clip = read_poses(&dir.path().join("d.jsonl")).unwrap();
    let expected = ShapeLibrary::builtin().unwrap().get("asl:D").unwrap().pose(Side::Right);
    for (a, b) in clip.frames[0].pose.angles.iter().zip(&expected.angles) {
        assert!((a - b).abs() < 1e-6);
    }
    assert_eq!(text(&run(&["pose", "--list"]).stdout).lines().count(), 43);
}

#[test]
fn spelled_words_are_feasible_clips() {
    let dir = tempfile::tempdir().unwrap();
    done(&["spell", "HELLO", "-o", "h.jsonl", "--fps", "50"], dir.path());
    let clip = read_poses(&dir.path().join("h.jsonl")).unwrap();
    assert_eq!(clip.header.rate, Some(50.0));
    assert!(clip.frames.len() > 100);
    let domain = Domain::full();
    for frame in &clip.frames {
        // Files carry 1e-5 degree.
        assert!(domain.is_feasible(&frame.pose.angles, 1e-6));
    }
}

#[test]
fn a_spelled_word_is_a_sheet_of_its_letters() {
    let dir = tempfile::tempdir().unwrap();
    let sheet = |args: &[&str]| {
        done(&[&["spell", "-o", "x.png", "--size", "60x70"], args].concat(), dir.path());
        image::open(dir.path().join("x.png")).unwrap().into_rgb8()
    };
    let places = |sheet: &image::RgbImage| (sheet.width() / 60) * (sheet.height() / 70);
    // A picture of each letter, and none of what is between two: the last row alone may have places left.
    let (one, four, eight) = (sheet(&["A"]), sheet(&["ABCD"]), sheet(&["HANDCAST"]));
    assert_eq!(one.dimensions(), (60, 70));
    assert!((4..8).contains(&places(&four)) && four.height() < 2 * 70, "{:?}", four.dimensions());
    assert!((8..13).contains(&places(&eight)), "{:?}", eight.dimensions());
    assert_eq!(sheet(&["A", "--hand", "right"]), one);
    assert_ne!(sheet(&["A", "--hand", "left"]), one);
    assert_ne!(sheet(&["B"]), one);
    // Of as many moments as a second has.
    assert!(places(&sheet(&["AB", "--fps", "10"])) > 8);
}

#[test]
fn wrong_requests_are_refused_and_leave_no_file() {
    let dir = tempfile::tempdir().unwrap();
    let refused = |args: &[&str]| {
        let output = handcast(args, dir.path());
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0, "{args:?}");
        (output.status.code(), text(&output.stderr))
    };
    let (code, message) = refused(&["pose", "asl:Ö", "-o", "x.png"]);
    assert!(code == Some(2) && message.contains("no shape is called"), "{message}");
    let (code, message) = refused(&["pose", "rest", "-o", "x.bmp"]);
    assert!(code == Some(2) && message.contains("allowed are .glb, .jsonl"), "{message}");
    let (code, message) = refused(&["spell", "a!", "-o", "x.jsonl"]);
    assert!(code == Some(2) && message.contains("'!' cannot be spelled"), "{message}");
    let (code, _) = refused(&["spell", "a", "-o", "x.jsonl", "--rate", "0"]);
    assert_eq!(code, Some(2));
    let (code, message) = refused(&["import", "missing.jsonl", "-o", "x.jsonl"]);
    assert!(code == Some(1) && message.contains("missing.jsonl"), "{message}");
}

#[test]
#[ignore = "needs the shared material"]
fn imports_tell_the_hand_and_keep_its_sizes() {
    let source = crate::common::shared("data/motion/leap/pinch.landmarks.jsonl");
    let dir = tempfile::tempdir().unwrap();
    let source = source.to_str().unwrap();
    let args = ["import", source, "-o", "p.jsonl", "--save-person", "p.toml"];
    let message = text(&done(&args, dir.path()).stderr);
    assert!(
        message.starts_with("right hand: 133 frames solved, 0 bridged, 0 lost, 0 points missing"),
        "{message}"
    );
    let clip = read_poses(&dir.path().join("p.jsonl")).unwrap();
    let person = handcast_formats::person::read_person(&dir.path().join("p.toml")).unwrap();
    assert_eq!(clip.header.hands[0].morphology.as_ref(), Some(&person.morphology));
    let args = ["import", source, "-o", "q.jsonl", "--person", "p.toml", "--quiet"];
    assert_eq!(text(&done(&args, dir.path()).stderr), "");
    assert_eq!(read_poses(&dir.path().join("q.jsonl")).unwrap(), clip);
}
