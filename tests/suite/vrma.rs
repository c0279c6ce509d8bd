//! `.vrma` files on VRM avatars, in three-vrm.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use crate::common::command::{done, path, text};
use crate::common::glb::{motion, node};
use crate::common::vrm::{Vrm, avatar, worst};
use handcast_formats::poses::{read_poses, write_poses};
use handcast_hand::{ClipHand, JointAngle, Morphology, PoseClip, PoseHeader, Side, TimedPose};

/// Poses of these hands in a file.
fn poses(folder: &Path, sides: &[Side], frames: usize) -> PathBuf {
    let mut header = PoseHeader { rate: Some(25.0), ..PoseHeader::default() };
    let hand = |&side: &Side| ClipHand { side, morphology: Some(Morphology::average(0.18)) };
    header.hands = sides.iter().map(hand).collect();
    let frames = sides.iter().flat_map(|&side| motion(side, frames));
    let frames = frames.map(|(time, pose)| TimedPose::new(time, pose)).collect();
    let file = folder.join("poses.jsonl");
    write_poses(&file, &PoseClip { header, frames }).unwrap();
    file
}

#[test]
fn poses_come_back_but_for_their_places() {
    let folder = tempfile::tempdir().unwrap();
    let file = poses(folder.path(), &[Side::Left, Side::Right], 40);
    let [vrma, back] = ["x.vrma", "back.jsonl"].map(|name| folder.path().join(name));
    done(&["encode", path(&file), "-o", path(&folder.path().join("s.fba")), "--quant", "1"]);
    done(&["decode", path(&folder.path().join("s.fba")), "-o", path(&vrma)]);
    let decoded = folder.path().join("decoded.jsonl");
    done(&["decode", path(&folder.path().join("s.fba")), "-o", path(&decoded)]);
    // What it says goes on like any other motion.
    done(&["encode", path(&vrma), "-o", path(&folder.path().join("again.fba")), "--quant", "1"]);
    done(&["decode", path(&folder.path().join("again.fba")), "-o", path(&back)]);
    let [clip, back] = [&decoded, &back].map(|file| read_poses(file).unwrap());
    for side in [Side::Left, Side::Right] {
        // The last key, in f32, may lie before the last tick.
        assert!(clip.of(side).count() - back.of(side).count() <= 1);
        for (a, b) in clip.of(side).zip(back.of(side)) {
            for finger in ["index", "middle", "ring", "pinky"] {
                for joint in ["2", "3"] {
                    let name = format!("{finger}{joint}_flexion");
                    let angle = JointAngle::ALL.into_iter().find(|angle| angle.name() == name).unwrap();
                    let off = (a.pose.angle(angle) - b.pose.angle(angle)).to_degrees().abs();
                    assert!(off < 0.1, "{name} at {}: {off} degrees", a.time);
                }
            }
        }
    }
}

#[test]
#[ignore = "needs Node and npm ci --prefix tests/node"]
fn avatars_bend_as_the_source_does() {
    for sides in [&[Side::Left, Side::Right][..], &[Side::Right]] {
        let folder = tempfile::tempdir().unwrap();
        let file = poses(folder.path(), sides, 60);
        let clip = read_poses(&file).unwrap();
        let vrma = folder.path().join("x.vrma");
        let written =
            handcast_formats::motion::Format::by_id("vrma").unwrap().write(&clip, &Default::default());
        std::fs::write(&vrma, written.unwrap().bytes).unwrap();
        let words: Vec<&str> = sides.iter().map(|side| side.name()).collect();
        let times: Vec<f64> = clip.of(sides[0]).map(|frame| frame.time).collect();
        for version in [Vrm::Zero, Vrm::One] {
            let glb = folder.path().join(format!("{version:?}.glb"));
            std::fs::write(&glb, avatar(version)).unwrap();
            let mut arguments = vec![glb, vrma.clone(), words.join(",").into()];
            arguments.extend(times.iter().map(|time| PathBuf::from(time.to_string())));
            let arguments: Vec<&Path> = arguments.iter().map(PathBuf::as_path).collect();
            let out = node("vrma.js", &arguments);
            assert!(out.status.success(), "{}", text(&out.stderr));
            let read: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
            assert_eq!(read["version"], if version == Vrm::Zero { "0" } else { "1" });
            assert_eq!(read["messages"], serde_json::json!([]));
            assert!(
                read["tracks"].as_array().unwrap().iter().all(|track| track == "quaternion"),
                "{}",
                read["tracks"]
            );
            assert!((read["duration"].as_f64().unwrap() - times.last().unwrap()).abs() < 1e-3);
            let moments: Vec<HashMap<String, [f64; 3]>> =
                serde_json::from_value(read["moments"].clone()).unwrap();
            assert_eq!(moments.len(), times.len());
            let mut most = [0.0f64; 2];
            for &side in sides {
                for (frame, places) in clip.of(side).zip(&moments) {
                    let found = worst(&frame.pose, places);
                    most = [most[0].max(found[0]), most[1].max(found[1])];
                }
            }
            println!(
                "VRM {version:?}, {words:?}: directions within {:.1e}°, bends within {:.1e}°",
                most[0], most[1]
            );
            assert!(most.iter().all(|&most| most < 0.1), "{version:?}: {most:?} degrees");
        }
    }
}
