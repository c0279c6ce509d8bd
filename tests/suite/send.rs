//! `handcast send`: packets as receivers read them, and what they do to avatars.

use std::collections::HashMap;
use std::io::Write as _;
use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::common::command::{done, handcast, path, text};
use crate::common::glb::{motion, node};
use crate::common::python::with_package;
use crate::common::vrm::{Vrm, avatar, worst};
use handcast_formats::poses::{read_poses, write_poses};
use handcast_hand::{ClipHand, Morphology, PoseClip, PoseHeader, Side, TimedPose};

const SIDES: [Side; 2] = [Side::Left, Side::Right];

/// Poses of both hands in a file; those of the right hand are lost from the middle on, of the left at the end.
fn poses(folder: &Path, frames: usize) -> PathBuf {
    let mut header = PoseHeader { rate: Some(25.0), ..PoseHeader::default() };
    header.hands = SIDES.map(|side| ClipHand { side, morphology: Some(Morphology::average(0.18)) }).into();
    let track = |side: Side| {
        let last = if side == Side::Left { frames - 2 } else { frames / 2 };
        let frame = move |(k, (time, pose))| {
            if k < last { TimedPose::new(time, pose) } else { TimedPose::lost(time, side) }
        };
        motion(side, frames).into_iter().enumerate().map(frame)
    };
    let file = folder.join("poses.jsonl");
    let frames = SIDES.into_iter().flat_map(track).collect();
    write_poses(&file, &PoseClip { header, frames }).unwrap();
    file
}

/// Packets that the command sends with `args`, and what it prints.
fn received(args: &[&str]) -> (Vec<Vec<u8>>, String) {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = socket.local_addr().unwrap().to_string();
    socket.set_read_timeout(Some(Duration::from_millis(300))).unwrap();
    let args: Vec<String> = args.iter().map(|&arg| arg.to_owned()).collect();
    let command = std::thread::spawn(move || {
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        done(&[&["send"], &args[..], &["--vmc", &address]].concat())
    });
    let mut packets = Vec::new();
    let mut bytes = [0; 2048];
    loop {
        match socket.recv(&mut bytes) {
            Ok(length) => packets.push(bytes[..length].to_vec()),
            // What a finished command has sent is here.
            Err(_) if command.is_finished() => return (packets, command.join().unwrap()),
            Err(_) => {}
        }
    }
}

fn hex(packets: &[Vec<u8>]) -> String {
    let line = |packet: &Vec<u8>| packet.iter().map(|b| format!("{b:02x}")).chain(["\n".into()]).collect();
    packets.iter().map(line).collect::<Vec<String>>().concat()
}

fn has(packet: &[u8], word: &str) -> bool {
    packet.windows(word.len()).any(|w| w == word.as_bytes())
}

#[test]
fn hands_are_sent_at_their_own_pace_and_lost_ones_not() {
    let folder = tempfile::tempdir().unwrap();
    let file = poses(folder.path(), 20);
    let begun = Instant::now();
    let (packets, said) = received(&[path(&file), "--speed", "2"]);
    assert!(begun.elapsed() >= Duration::from_millis(380), "20 frames at 50 a second");
    let of = |word: &str| packets.iter().filter(|packet| has(packet, word)).count();
    assert_eq!((of("LeftHand"), of("RightHand")), (18, 10));
    // Two moments at which both are lost, and the end.
    assert_eq!((packets.len(), of("/VMC/Ext/Bone/Pos")), (18 + 10 + 3, 28));
    assert!(packets.iter().all(|p| p.len() < 1452 && has(p, "/VMC/Ext/OK") && has(p, "/VMC/Ext/T")));
    assert!(said.starts_with("28 poses in 31 packets"), "{said}");

    // Fingers of one hand, from a stream.
    let stream = folder.path().join("s.fba");
    done(&["encode", path(&file), "-o", path(&stream)]);
    let args = [path(&stream), "--speed", "20", "--only", "left", "--fingers"];
    let (packets, _) = received(&args);
    let of = |word: &str| packets.iter().filter(|packet| has(packet, word)).count();
    assert_eq!((of("LeftIndexDistal"), of("LeftHand"), of("Right")), (packets.len() - 1, 0, 0));
    assert!(packets.len() > 10);
}

#[test]
fn several_receivers_get_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let file = poses(folder.path(), 20);
    let second = UdpSocket::bind("127.0.0.1:0").unwrap();
    second.set_nonblocking(true).unwrap();
    let address = second.local_addr().unwrap().to_string();
    let (packets, said) = received(&[path(&file), "--vmc", &address, "--speed", "4"]);
    let mut bytes = [0; 2048];
    let others = std::iter::from_fn(|| second.recv(&mut bytes).ok().map(|length| bytes[..length].to_vec()));
    let others: Vec<Vec<u8>> = others.collect();
    assert!(packets.len() > 20 && packets == others, "{} and {}", packets.len(), others.len());
    assert_eq!(said.lines().count(), 2, "{said}");
    assert!(said.starts_with(&format!("{address}: 28 poses in 31 packets")), "{said}");
}

#[test]
fn what_cannot_be_sent_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |args: &[&str], code: i32, words: &[&str]| {
        let out = handcast(&[&["send"], args].concat());
        let said = text(&out.stderr);
        assert_eq!(out.status.code(), Some(code), "{args:?}: {said}");
        for word in words {
            assert!(said.contains(word), "{args:?} should say {word:?}: {said}");
        }
    };
    let file = poses(folder.path(), 6);
    refused(&[path(&file), "--vmc", "no.such.host.invalid:39539"], 1, &["resolve", "no.such.host.invalid"]);
    refused(&[path(&file), "--vmc", "localhost:99999"], 2, &["localhost:99999", "1 to 65535"]);
    refused(&[path(&file), "--vmc", "127.0.0.1", "--speed", "0"], 2, &["0.01 to 100"]);
    refused(&[path(&file)], 2, &["--vmc"]);
    refused(&["none.fba", "--vmc", "127.0.0.1"], 1, &["none.fba"]);
    let lost = folder.path().join("lost.jsonl");
    let frames = vec![TimedPose::lost(0.0, Side::Left), TimedPose::lost(0.1, Side::Left)];
    write_poses(&lost, &PoseClip::of_frames(frames, None)).unwrap();
    refused(&[path(&lost), "--vmc", "127.0.0.1"], 1, &["lost.jsonl", "no pose"]);
}

#[test]
#[ignore = "needs Python and its package index"]
fn python_osc_reads_every_packet() {
    let folder = tempfile::tempdir().unwrap();
    let (packets, _) = received(&[path(&poses(folder.path(), 60)), "--speed", "10"]);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/vmc.py");
    let mut child = Command::new(with_package("python-osc", "1.10.2", "pythonosc"))
        .arg(script)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("python runs");
    let (mut stdin, lines) = (child.stdin.take().unwrap(), hex(&packets));
    // It answers while it reads.
    let writer = std::thread::spawn(move || stdin.write_all(lines.as_bytes()));
    let out = child.wait_with_output().unwrap();
    writer.join().unwrap().unwrap();
    assert!(out.status.success());
    let read: Vec<Vec<Vec<serde_json::Value>>> =
        text(&out.stdout).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!((read.len(), packets.len()), (packets.len(), 58 + 30 + 3));
    let mut before = 0.0;
    for messages in &read {
        let tracked = i64::from(messages.len() > 2);
        let ok = serde_json::json!(["/VMC/Ext/OK", tracked, 3, 0, tracked]);
        assert_eq!(serde_json::Value::from(messages[0].clone()), ok);
        assert_eq!(messages[1][0], "/VMC/Ext/T");
        let time = messages[1][1].as_f64().unwrap();
        assert!(time >= before, "{time} after {before}");
        before = time;
        assert!(messages.len() == 2 || messages.len() == 2 + 16);
        for bone in &messages[2..] {
            assert_eq!((&bone[0], bone.len()), (&"/VMC/Ext/Bone/Pos".into(), 9));
            let norm: f64 = bone[5..].iter().map(|v| v.as_f64().unwrap().powi(2)).sum();
            assert!((norm - 1.0).abs() < 1e-5, "{bone:?}");
        }
    }
}

#[test]
#[ignore = "needs Node and npm ci --prefix tests/node"]
fn avatars_bend_as_the_source_does() {
    let folder = tempfile::tempdir().unwrap();
    let file = poses(folder.path(), 60);
    let (packets, _) = received(&[path(&file), "--speed", "10"]);
    let lines = folder.path().join("packets.txt");
    std::fs::write(&lines, hex(&packets)).unwrap();
    let mut sent: Vec<TimedPose> = read_poses(&file).unwrap().frames;
    sent.retain(|frame| frame.valid);
    sent.sort_by(|a, b| a.time.total_cmp(&b.time));
    for version in [Vrm::Zero, Vrm::One] {
        let glb = folder.path().join(format!("{version:?}.glb"));
        std::fs::write(&glb, avatar(version)).unwrap();
        let out = node("vrm.js", &[&glb, &lines]);
        assert!(out.status.success(), "{}", text(&out.stderr));
        let read: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
        assert_eq!(read["version"], if version == Vrm::Zero { "0" } else { "1" });
        let moments: Vec<HashMap<String, [f64; 3]>> =
            serde_json::from_value(read["moments"].clone()).unwrap();
        assert_eq!(moments.len(), sent.len());
        let mut most = [0.0f64; 2];
        for (frame, places) in sent.iter().zip(&moments) {
            let found = worst(&frame.pose, places);
            most = [most[0].max(found[0]), most[1].max(found[1])];
        }
        println!("VRM {version:?}: directions within {:.1e}°, bends within {:.1e}°", most[0], most[1]);
        assert!(most.iter().all(|&most| most < 0.1), "{version:?}: {most:?} degrees");
    }
}
