//! `track -`, `encode -` and `decode -` write as they go: what is known comes out while the input is still open.

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use crate::common::command::program;
use crate::common::command::{done, path};
use crate::common::y4m::y4m;
use handcast_media::{OpenOptions, open};
use handcast_track::pipeline::{ClipOptions, Tracker};
use image::RgbImage;

const POSES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/demo.poses.jsonl");
const CLIP: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/demo.avi");
/// Far more than anything takes; a pipe that does not flow would wait for ever.
const PATIENCE: Duration = Duration::from_secs(120);

/// A command whose pieces of output come as they are written.
struct Piped {
    child: Child,
    input: Option<ChildStdin>,
    output: Receiver<Vec<u8>>,
}

impl Piped {
    fn new(arguments: &[&str]) -> Self {
        let mut command = Command::new(program());
        let mut child = command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let (sender, output) = channel();
        let mut from = child.stdout.take().unwrap();
        std::thread::spawn(move || {
            let mut piece = vec![0; 1 << 16];
            while let Ok(count @ 1..) = from.read(&mut piece) {
                if sender.send(piece[..count].to_vec()).is_err() {
                    break;
                }
            }
        });
        Self { input: child.stdin.take(), child, output }
    }

    fn write(&mut self, bytes: &[u8]) {
        let input = self.input.as_mut().unwrap();
        input.write_all(bytes).unwrap();
        input.flush().unwrap();
    }

    /// What has been written so far, at least `least` bytes; the input stays open.
    fn wait_for(&self, least: usize) -> Vec<u8> {
        let mut bytes = Vec::new();
        while bytes.len() < least {
            bytes.extend(self.output.recv_timeout(PATIENCE).expect("output while the input is open"));
        }
        bytes
    }

    /// Closes the input; the rest of the output.
    fn end(mut self) -> Vec<u8> {
        drop(self.input.take());
        let rest = self.output.iter().flatten().collect();
        assert!(self.child.wait().unwrap().success());
        rest
    }
}

/// The pose lines of a file, without its headers.
fn pose_lines(text: &[u8]) -> Vec<String> {
    let lines = text.lines().map(Result::unwrap);
    lines.filter(|line| !line.starts_with("{\"format\"")).collect()
}

/// The first three seconds of the demo.
fn demo_pictures() -> Vec<RgbImage> {
    let mut source = open(CLIP, &OpenOptions::default()).unwrap();
    std::iter::from_fn(|| source.next_frame().unwrap()).map(|frame| frame.image).take(75).collect()
}

#[test]
fn tracked_poses_come_while_frames_do() {
    let pictures = demo_pictures();
    let clip = y4m(&pictures);
    let head = clip.iter().position(|&b| b == b'\n').unwrap() + 1;
    let frame = (clip.len() - head) / pictures.len();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("demo.y4m");
    fs::write(&file, &clip).unwrap();
    // The first frame that can be tracked: the one with which the library knows poses.
    let mut tracker = Tracker::new(ClipOptions::default());
    let mut source = open(&file, &OpenOptions::default()).unwrap();
    let frames = std::iter::from_fn(|| source.next_frame().unwrap());
    let enough =
        frames.map(|frame| tracker.push(frame).unwrap()).position(|poses| !poses.is_empty()).unwrap();

    let mut piped = Piped::new(&["track", "-", "-o", "-", "--quiet"]);
    piped.write(&clip[..head + (enough + 1) * frame]);
    let mut text = piped.wait_for(1000);
    assert!(!pose_lines(&text[..text.iter().rposition(|&b| b == b'\n').unwrap()]).is_empty());
    piped.write(&clip[head + (enough + 1) * frame..]);
    text.extend(piped.end());

    let whole = folder.path().join("poses.jsonl");
    done(&["track", path(&file), "-o", path(&whole), "--quiet"]);
    assert_eq!(pose_lines(&text), pose_lines(&fs::read(&whole).unwrap()));
}

#[test]
fn live_streams_and_their_poses_flow() {
    let text = fs::read(POSES).unwrap();
    let half = text.iter().enumerate().filter(|(_, b)| **b == b'\n').nth(75).unwrap().0 + 1;
    let folder = tempfile::tempdir().unwrap();
    let whole = folder.path().join("live.fba");
    done(&["encode", POSES, "-o", path(&whole), "--live", "--quiet"]);

    let mut encoder = Piped::new(&["encode", "-", "-o", "-", "--live", "--quiet"]);
    encoder.write(&text[..half]);
    let mut stream = encoder.wait_for(60);
    encoder.write(&text[half..]);
    stream.extend(encoder.end());
    assert_eq!(stream, fs::read(&whole).unwrap());

    let mut decoder = Piped::new(&["decode", "-", "-o", "-", "--quiet"]);
    decoder.write(&stream[..stream.len() / 2]);
    let mut decoded = decoder.wait_for(1000);
    decoder.write(&stream[stream.len() / 2..]);
    decoded.extend(decoder.end());
    let file = folder.path().join("decoded.jsonl");
    done(&["decode", path(&whole), "-o", path(&file), "--quiet"]);
    assert_eq!(pose_lines(&decoded), pose_lines(&fs::read(&file).unwrap()));
}

/// As when the second hand of a clip opens later, or networks find that a hand is of the other side.
#[test]
fn a_hand_that_is_found_later_travels_in_a_stream_of_both() {
    let text = String::from_utf8(fs::read(POSES).unwrap()).unwrap();
    let (header, lines) = text.split_once('\n').unwrap();
    let mut both: serde_json::Value = serde_json::from_str(header).unwrap();
    let mut left = both["hands"][0].clone();
    left["side"] = "left".into();
    both["hands"].as_array_mut().unwrap().insert(0, left);
    let mut piped = Piped::new(&["encode", "-", "-o", "-", "--live", "--quiet"]);
    // A header may come in pieces.
    piped.write(&header.as_bytes()[..300]);
    std::thread::sleep(Duration::from_millis(300));
    piped.write(format!("{}\n", &header[300..]).as_bytes());
    for (i, line) in lines.lines().enumerate() {
        if i == 60 {
            piped.write(format!("{both}\n").as_bytes());
        }
        if i >= 60 {
            piped.write(format!("{}\n", line.replace("\"right\"", "\"left\"")).as_bytes());
        }
        piped.write(format!("{line}\n").as_bytes());
        if i == 50 {
            assert!(!piped.wait_for(60).is_empty());
        }
    }
    let stream = piped.end();
    let mut decoder = Piped::new(&["decode", "-", "-o", "-", "--quiet"]);
    decoder.write(&stream);
    let poses = pose_lines(&decoder.end());
    let of = |side: &str| poses.iter().filter(|pose| pose.contains(&format!("\"hand\":\"{side}\""))).count();
    assert_eq!(of("left"), 90);
}

#[test]
fn streams_and_motions_are_read_from_standard_input() {
    let folder = tempfile::tempdir().unwrap();
    let stream = folder.path().join("a.fba");
    done(&["encode", POSES, "-o", path(&stream), "--quiet"]);
    let from_input = |arguments: &[&str]| {
        let mut piped = Piped::new(arguments);
        piped.write(&fs::read(&stream).unwrap());
        piped.end()
    };
    assert!(!from_input(&["inspect", "-"]).is_empty());
    assert!(!from_input(&["compare", "-", path(&stream), "--tolerance", "0.001"]).is_empty());
    for output in ["hand.png", "page.html"] {
        let file = folder.path().join(output);
        let command = if Path::new(output).extension().unwrap() == "png" { "render" } else { "view" };
        from_input(&[command, "-", "-o", path(&file)]);
        assert!(fs::metadata(&file).unwrap().len() > 1000, "{output}");
    }
}

/// A clip at its own pace: the first pose comes long before the clip is over.
#[test]
#[ignore = "needs ffmpeg"]
fn a_paced_clip_gives_poses_before_it_is_over() {
    let mut camera = Command::new("ffmpeg")
        .args(["-v", "error", "-re", "-i", CLIP, "-pix_fmt", "yuv420p", "-f", "yuv4mpegpipe", "-"])
        .stdout(Stdio::piped())
        .spawn()
        .expect("ffmpeg on the path");
    let mut tracker = Command::new(program())
        .args(["track", "-", "-o", "-", "--quiet"])
        .stdin(camera.stdout.take().unwrap())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(tracker.stdout.take().unwrap()).lines();
    assert!(lines.next().unwrap().unwrap().contains("handcast-poses"));
    assert!(lines.next().unwrap().unwrap().starts_with("{\"t\":"));
    assert!(camera.try_wait().unwrap().is_none(), "the clip is over");
    assert_eq!(lines.count(), 149);
    assert!(camera.wait().unwrap().success() && tracker.wait().unwrap().success());
}
