//! Import of other trackers' recordings, on real material.

use std::path::{Path, PathBuf};

use handcast_formats::import::{ImportOptions, ImportReport, import};
use handcast_formats::landmarks::LandmarkClip;
use handcast_hand::landmarks::SolverOptions;
use handcast_hand::shapes::ShapeLibrary;
use handcast_hand::{Domain, Joint, JointAngles, Morphology, PoseClip, Side, Skeleton};

fn recordings(folder: &str) -> Vec<PathBuf> {
    let folder = crate::common::shared(&format!("data/motion/{folder}"));
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    files.sort();
    assert!(!files.is_empty());
    files
}

fn run(path: &Path, options: &ImportOptions) -> (LandmarkClip, PoseClip, ImportReport) {
    let clip = LandmarkClip::read(path).unwrap();
    let (poses, report) = import(&clip, options).unwrap();
    println!("{}: {report:?}", path.display());
    assert_eq!(report.solved, clip.frames.len());
    let domain = Domain::full();
    for frame in &poses.frames {
        assert!(domain.is_feasible(&frame.pose.angles, 1e-9), "{} at {}", path.display(), frame.time);
    }
    (clip, poses, report)
}

#[test]
#[ignore = "needs the shared material"]
fn leap_recordings_fit_within_a_millimetre() {
    for path in recordings("leap") {
        let (clip, poses, report) = run(&path, &ImportOptions::default());
        assert!(report.mean_distance < 1e-3, "{}", report.mean_distance);
        // The report's distances, once more from the poses as written.
        let morphology = poses.header.hands[0].morphology.as_ref().unwrap();
        let skeleton = Skeleton::new(morphology, report.side);
        let (mut sum, mut count) = (0.0, 0);
        for (frame, source) in poses.frames.iter().zip(&clip.frames) {
            let joints = skeleton.frames(&frame.pose);
            for joint in Joint::ALL {
                if let Some(point) = source.points[joint.index()] {
                    sum += (joints.position(joint) - point).norm();
                    count += 1;
                }
            }
        }
        assert!((sum / f64::from(count) - report.mean_distance).abs() < 1e-9);
    }
}

#[test]
#[ignore = "needs the shared material"]
fn mirrored_recordings_are_the_other_hand() {
    for path in recordings("leap") {
        let mut clip = LandmarkClip::read(&path).unwrap();
        let (_, report) = import(&clip, &ImportOptions::default()).unwrap();
        for point in clip.frames.iter_mut().flat_map(|f| &mut f.points).flatten() {
            point.x = -point.x;
        }
        let (_, mirrored) = import(&clip, &ImportOptions::default()).unwrap();
        assert_eq!((report.side, mirrored.side), (Side::Right, Side::Left), "{}", path.display());
        assert!((report.mean_distance - mirrored.mean_distance).abs() < 1e-9);
        assert!(report.trial.unwrap().ratio() > 1.5, "{}: {:?}", path.display(), report.trial);
    }
}

#[test]
#[ignore = "needs the shared material"]
fn tied_poses_of_leap_recordings_fit_within_four_millimetres() {
    let solver = SolverOptions { tie: true, ..SolverOptions::default() };
    let options = ImportOptions { solver, ..ImportOptions::default() };
    for path in recordings("leap") {
        let (_, poses, report) = run(&path, &options);
        assert!(report.mean_distance < 4e-3);
        for frame in &poses.frames {
            assert_eq!(frame.pose.angles, Domain::expand(&Domain::reduce(&frame.pose.angles)));
        }
    }
}

#[test]
#[ignore = "needs the shared material"]
fn skin_markers_fit_within_three_millimetres() {
    for path in recordings("markers") {
        let (_, _, report) = run(&path, &ImportOptions::default());
        assert_eq!(report.side, Side::Right);
        assert!(report.mean_distance < 3e-3);
    }
}

#[test]
#[ignore = "needs the shared material"]
fn still_xr_poses_fit_within_two_millimetres_on_both_hands() {
    let files = recordings("webxr-poses");
    assert_eq!(files.len(), 2);
    for (path, side) in files.iter().zip([Side::Left, Side::Right]) {
        let (clip, _, report) = run(path, &ImportOptions::default());
        assert_eq!(report.side, side);
        assert!(report.mean_distance < 2e-3);
        // The side is told from the shapes alone, too.
        let nameless = LandmarkClip { side: None, ..clip };
        let (_, report) = import(&nameless, &ImportOptions::default()).unwrap();
        assert_eq!(report.side, side);
    }
}

#[test]
#[ignore = "needs the shared material"]
fn each_letter_is_nearest_to_its_recorded_shape() {
    let path = recordings("webxr-poses").into_iter().find(|p| p.ends_with("poses_right.json")).unwrap();
    let names: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    let (_, poses, _) = run(&path, &ImportOptions::default());
    let skeleton = Skeleton::new(&Morphology::default(), Side::Right);
    let places = |angles: &JointAngles| Joint::ALL.map(|j| skeleton.local_frames(angles).position(j));
    let letter = |i: usize| {
        let name = names[i]["names"][0].as_str()?.strip_prefix("asl ")?;
        let mut letters = name.chars().filter(char::is_ascii_lowercase);
        Some(letters.next()?.to_ascii_uppercase()).filter(|_| letters.next().is_none())
    };
    let recorded: Vec<_> = (0..poses.frames.len())
        .filter_map(|i| Some((letter(i)?, places(&poses.frames[i].pose.angles))))
        .collect();
    assert_eq!(recorded.len(), 26);
    let library = ShapeLibrary::builtin().unwrap();
    let mut wrong = Vec::new();
    for letter in 'A'..='Z' {
        let ours = places(&library.get(&format!("asl:{letter}")).unwrap().pose(Side::Right).angles);
        let apart = |other: &[nalgebra::Point3<f64>; Joint::COUNT]| {
            let squares: f64 = ours.iter().zip(other).map(|(a, b)| (a - b).norm_squared()).sum();
            (squares / Joint::COUNT as f64).sqrt() * 1e3
        };
        let mut order: Vec<(f64, char)> = recorded.iter().map(|(l, other)| (apart(other), *l)).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        println!("{letter}: {:.1?}", &order[..3]);
        if order[0].1 != letter {
            wrong.push(letter);
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}
