//! Networks in files, wheels, bundles, packages and folders.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::io::{Cursor, Write};
use std::path::Path;

use handcast_net::Error;
use handcast_net::files::{Bundle, Role, Size};
use handcast_net::model::{Activation, Operation};
use handcast_net::testing::{Writer, joint_network, palm_network};
use sha2::{Digest as _, Sha256};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

/// A zip with these files, deflated or stored.
fn zipped(files: &[(&str, &[u8])], deflated: bool) -> Vec<u8> {
    let method = if deflated { zip::CompressionMethod::Deflated } else { zip::CompressionMethod::Stored };
    let options = SimpleFileOptions::default().compression_method(method);
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in files {
        writer.start_file(*name, options).unwrap();
        writer.write_all(bytes).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

/// A network that takes and gives what none of hands does.
fn other_network() -> Vec<u8> {
    let mut w = Writer::new();
    let x = w.input(&[1, 4]);
    let y = w.operator(Operation::Add(Activation::None), &[Some(x), Some(x)], &[1, 4]);
    w.output(y);
    w.finish()
}

fn wheel() -> Vec<u8> {
    zipped(
        &[
            ("mediapipe/modules/palm_detection/palm_detection_full.tflite", &palm_network()),
            ("mediapipe/modules/hand_landmark/hand_landmark_full.tflite", &joint_network()),
            ("mediapipe/modules/hand_landmark/hand_other.tflite", &other_network()),
            ("mediapipe/modules/face/face.tflite", b"not looked at"),
            (
                "mediapipe-0.10.21.dist-info/METADATA",
                b"Metadata-Version: 2.1\nName: mediapipe\nLicense: Apache 2.0\n\n",
            ),
        ],
        true,
    )
}

fn open(path: &Path) -> Bundle {
    Bundle::open(path, Size::Full).unwrap()
}

fn error(path: &Path) -> String {
    Bundle::open(path, Size::Full).unwrap_err().to_string()
}

#[test]
fn a_wheel_says_entries_and_licence() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("mediapipe-0.10.21-any.whl");
    std::fs::write(&path, wheel()).unwrap();
    let in_folder = open(dir.path());
    for bundle in [open(&path), in_folder] {
        assert_eq!((bundle.palms.role, bundle.landmarks.role), (Role::Palms, Role::Landmarks));
        assert_eq!(bundle.palms.path, path);
        assert!(bundle.palms.entry.as_deref().unwrap().ends_with("palm_detection_full.tflite"));
        assert_eq!(bundle.landmarks.size, joint_network().len());
        assert_eq!(bundle.licence.as_deref(), Some("Apache 2.0"));
        assert_eq!(bundle.palms.digest().len(), 64);
    }
    let bytes = Bundle::read(&wheel(), Size::Full).unwrap();
    assert_eq!(bytes.palms.sha256, open(&path).palms.sha256);
}

#[test]
fn the_digest_is_that_of_the_network() {
    let dir = tempfile::tempdir().unwrap();
    for (name, bytes) in [("palm.tflite", palm_network()), ("hand.tflite", joint_network())] {
        std::fs::write(dir.path().join(name), &bytes).unwrap();
    }
    let bundle = open(dir.path());
    let expected: [u8; 32] = Sha256::digest(palm_network()).into();
    assert_eq!(bundle.palms.sha256, expected);
    assert!(bundle.palms.digest().starts_with(&format!("{:02x}{:02x}", expected[0], expected[1])));
    assert_ne!(bundle.palms.digest(), bundle.landmarks.digest());
    assert_eq!(bundle.left_out, None);
    // A damaged one beside them is told of.
    std::fs::write(dir.path().join("palm_full.tflite"), &palm_network()[..100]).unwrap();
    let told = open(dir.path()).left_out.unwrap();
    assert!(told.contains("palm_full.tflite"), "{told}");
}

#[test]
fn a_task_bundle_is_read_alone_and_in_a_wheel() {
    let files: [(&str, &[u8]); 2] =
        [("hand_detector.tflite", &palm_network()), ("hand_landmarks_detector.tflite", &joint_network())];
    let task = zipped(&files, false);
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("hand_landmarker.task");
    std::fs::write(&path, &task).unwrap();
    assert_eq!(open(&path).landmarks.entry.as_deref(), Some("hand_landmarks_detector.tflite"));
    assert_eq!(open(&path).licence, None);
    let outer = zipped(&[("x/hand_landmarker.task", &task)], true);
    let bundle = Bundle::read(&outer, Size::Lite).unwrap();
    assert_eq!(bundle.palms.entry.as_deref(), Some("x/hand_landmarker.task/hand_detector.tflite"));
    // Bundles in bundles in bundles are not looked for.
    let deeper = zipped(&[("y/hand.task", &outer)], true);
    assert!(matches!(Bundle::read(&deeper, Size::Lite), Err(Error::NotFound { .. })));
}

#[test]
fn the_other_network_is_beside_the_one_given() {
    let dir = tempfile::tempdir().unwrap();
    let [palm, hand] = ["palm_detection", "hand_landmark"].map(|name| {
        let folder = dir.path().join(name);
        std::fs::create_dir(&folder).unwrap();
        folder.join(format!("{name}_full.tflite"))
    });
    std::fs::write(&palm, palm_network()).unwrap();
    assert_eq!(
        error(&palm),
        format!("no hand networks in {}: there is none that finds joints", palm.display())
    );
    std::fs::write(&hand, joint_network()).unwrap();
    for given in [&palm, &hand] {
        let bundle = open(given);
        assert_eq!((bundle.palms.entry, bundle.landmarks.entry), (None, None));
        assert_eq!(bundle.palms.path.file_name(), palm.file_name());
    }
}

#[test]
fn packed_assets_of_the_node_package_are_read() {
    let dir = tempfile::tempdir().unwrap();
    let package = dir.path().join("node_modules/@mediapipe/hands");
    std::fs::create_dir_all(&package).unwrap();
    let (palm, hand) = (palm_network(), joint_network());
    let script = format!(
        r#"load({{"files": [{{"filename": "/palm_detection.tflite", "start": 3, "end": {}}}]}});"#,
        3 + palm.len()
    );
    std::fs::write(package.join("hands_assets_loader.js"), script).unwrap();
    std::fs::write(package.join("hands_assets.data"), [b"abc", &palm[..]].concat()).unwrap();
    std::fs::write(package.join("hand_landmark_full.tflite"), hand).unwrap();
    std::fs::write(package.join("package.json"), r#"{"name": "@mediapipe/hands", "license": "Apache-2.0"}"#)
        .unwrap();
    let bundle = open(dir.path());
    assert_eq!(bundle.palms.entry.as_deref(), Some("/palm_detection.tflite"));
    assert_eq!(bundle.licence.as_deref(), Some("Apache-2.0"));
    // A script that lists more than there is.
    std::fs::write(package.join("hands_assets.data"), [b"abc", &palm[..100]].concat()).unwrap();
    assert!(
        error(dir.path()).contains("/palm_detection.tflite is said to be from byte 3 to"),
        "{}",
        error(dir.path())
    );
}

#[test]
fn wrong_files_are_named_with_what_was_expected() {
    let dir = tempfile::tempdir().unwrap();
    let file = |name: &str, bytes: &[u8]| {
        let path = dir.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    };
    assert!(error(&dir.path().join("none.whl")).contains("none.whl"));
    let text = file("words.txt", b"no network at all");
    let expected = "neither a TensorFlow Lite network nor a zip (wheel, .task) of networks";
    assert_eq!(error(&text), format!("{}: {expected}", text.display()));
    assert!(error(&file("empty.tflite", b"")).contains("neither"));
    let other = file("other.tflite", &other_network());
    let expected = format!("{}: a network that finds neither palms nor the joints of hands", other.display());
    assert_eq!(error(&other), expected);
    // Those beside it are not taken in its place.
    file("palm_detection.tflite", &palm_network());
    file("hand_landmark.tflite", &joint_network());
    assert_eq!(error(&other), expected);
    let palm = palm_network();
    assert!(error(&file("half.tflite", &palm[..palm.len() / 2])).contains("network: "));
    let wheel = wheel();
    assert!(error(&file("half.whl", &wheel[..wheel.len() / 2])).contains("half.whl: "));
    let damaged =
        zipped(&[("hand.tflite", &joint_network()), ("palm.tflite", &palm[..palm.len() / 2])], true);
    assert!(error(&file("damaged.task", &damaged)).contains("network: "));
    let empty = tempfile::tempdir().unwrap();
    assert!(error(empty.path()).contains("there is none that finds palms"));
}

#[test]
fn zips_that_grow_without_end_are_refused() {
    let large = vec![0; 33 << 20];
    let bomb = zipped(&[("hand.tflite", &large)], true);
    assert!(bomb.len() < 100_000);
    assert!(matches!(Bundle::read(&bomb, Size::Full), Err(Error::Limit { what: "bytes of a file", .. })));
    let names: Vec<String> = (0..200).map(|i| format!("hand{i}.tflite")).collect();
    let network = other_network();
    let many: Vec<(&str, &[u8])> = names.iter().map(|name| (name.as_str(), &network[..])).collect();
    let many = Bundle::read(&zipped(&many, true), Size::Full);
    assert!(matches!(many, Err(Error::Limit { what: "networks in one place", .. })));
}

#[test]
fn damaged_zips_give_errors_or_networks() {
    let small = zipped(&[("hand.tflite", &other_network()), ("hand.task", b"PK\x05\x06")], true);
    let mut seed = 1u32;
    let mut below = |n: usize| {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 8) as usize % n
    };
    for _ in 0..20_000 {
        let mut bytes = small.clone();
        for _ in 0..1 + below(4) {
            let at = below(bytes.len());
            match below(3) {
                0 => bytes[at] = below(256) as u8,
                1 => bytes[at] = [0, 1, 0x7f, 0x80, 0xff][below(5)],
                _ => bytes.truncate(at.max(4)),
            }
        }
        let error = Bundle::read(&bytes, Size::Full).unwrap_err();
        assert!(!error.to_string().is_empty());
    }
}
