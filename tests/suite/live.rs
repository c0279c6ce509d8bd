//! `handcast live`: clips and pipes to a room, and its page in headless Chromium.

#![cfg(feature = "cli")]
// Signals and limits of the system are tried on Unix alone.
#![cfg_attr(not(unix), allow(dead_code, unused_imports))]

use std::io::{BufRead, BufReader, Read, Write};
use std::net::UdpSocket;
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::time::{Duration, Instant};

use crate::common::command::{done, handcast, misused, path, refused};
use crate::common::glb::{browser_alone, chromium, node};
use handcast_codec::{PoseDecoder, PoseDecoderOptions};
use handcast_fba::DecoderOptions;
use handcast_live::client::RoomClient;
use handcast_live::transport::Subscribe as _;
use handcast_live::wire::{Message, Parting};
use rosc::{OscMessage, OscPacket, OscType};
use serde_json::{Value, json};

const DEMO: &str = "fixtures/demo.avi";

/// A running command, and the address it printed.
struct Live {
    child: Child,
    address: String,
}

impl Live {
    fn start(args: &[&str], stdin: Stdio) -> Self {
        Self::fed(args, stdin, |_| {})
    }

    /// The same, fed before it tells its address: a pipe's pictures say what they are like.
    fn fed(args: &[&str], stdin: Stdio, feed: impl FnOnce(&mut Child)) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_handcast"))
            .args(["live", "--bind", "127.0.0.1:0", "--no-net"])
            .args(args)
            .stdin(stdin)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        feed(&mut child);
        let mut address = String::new();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut address).unwrap();
        assert!(address.starts_with("http://127.0.0.1:"), "{address}");
        Self { child, address: address.trim().to_owned() }
    }

    fn join(&self) -> RoomClient {
        let rest = self.address.strip_prefix("http://").unwrap();
        let (server, room) = rest.split_once('/').unwrap();
        RoomClient::connect(server, room, "").unwrap()
    }

    fn interrupt(&self) {
        self.signal(&["INT"]);
    }

    /// Sends signals right behind one another.
    fn signal(&self, names: &[&str]) {
        let id = self.child.id();
        let script: Vec<String> = names.iter().map(|name| format!("kill -{name} {id}")).collect();
        let killed = Command::new("sh").args(["-c", &script.join(" && ")]).status().unwrap();
        assert!(killed.success());
    }

    /// Waits for its end; gives what it said.
    fn end(mut self) -> String {
        let mut said = String::new();
        self.child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        let status = self.child.wait().unwrap();
        assert!(status.success(), "{said}");
        said
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Reads a room to the end of its sender; gives poses decoded, and how many planes came.
fn watch(client: &mut RoomClient) -> (usize, usize) {
    let conceal = DecoderOptions { conceal: true, ..DecoderOptions::default() };
    let mut decoder = PoseDecoder::new(PoseDecoderOptions::default().with_decoder(conceal));
    let (mut poses, mut planes) = (0, 0);
    let end = Instant::now() + Duration::from_secs(120);
    loop {
        assert!(Instant::now() < end, "{poses} poses in {planes} planes, and no end");
        match client.next(Duration::from_secs(1)) {
            Ok(Some(Message::Plane(plane))) => {
                planes += 1;
                poses += decoder.push_whole(&plane.payload).unwrap().len();
            }
            Ok(Some(Message::End { parting, .. })) => {
                assert_eq!(parting, Parting::Left);
                return (poses, planes);
            }
            Ok(_) => {}
            Err(error) => panic!("{error}"),
        }
    }
}

fn await_plane(viewer: &mut RoomClient) {
    let end = Instant::now() + Duration::from_secs(120);
    while !matches!(viewer.next(Duration::from_secs(1)).unwrap(), Some(Message::Plane(_))) {
        assert!(Instant::now() < end, "no plane");
    }
}

#[cfg(unix)]
#[test]
fn a_clip_at_its_own_pace_is_seen_and_recorded() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["hand.fba", "hand.mp4"] {
        let file = folder.path().join(name);
        let live = Live::start(&[DEMO, "--loop", "--record", path(&file), "--together", "2"], Stdio::null());
        let mut viewer = live.join();
        // A busy machine drops most of the pictures.
        (0..12).for_each(|_| await_plane(&mut viewer));
        live.interrupt();
        watch(&mut viewer);
        let said = live.end();
        let last = said.split("all in all: camera ").nth(1).unwrap_or_else(|| panic!("{said}"));
        let pace: f64 = last.split('/').next().unwrap().parse().unwrap();
        assert!(pace < 26.0 && last.contains("on the wire"), "25 pictures a second: {said}");
        // Who has gone by the end has been there.
        assert!(last.contains("1 viewer at most"), "{said}");
        let text = done(&["decode", path(&file), "-o", "-", "--to", "jsonl"]);
        assert!(text.lines().count() > 12, "{text}");
    }
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 2, "nothing is left beside");
}

/// The messages of a packet to an avatar.
fn osc(bytes: &[u8]) -> Vec<OscMessage> {
    let (rest, packet) = rosc::decoder::decode_udp(bytes).unwrap();
    let OscPacket::Bundle(bundle) = packet else { panic!("no bundle: {packet:?}") };
    assert!(rest.is_empty());
    let message = |packet| {
        if let OscPacket::Message(message) = packet { message } else { panic!("a bundle in a bundle") }
    };
    bundle.content.into_iter().map(message).collect()
}

#[cfg(unix)]
#[test]
fn an_avatar_gets_the_poses_while_they_move() {
    let avatar = UdpSocket::bind("127.0.0.1:0").unwrap();
    avatar.set_read_timeout(Some(Duration::from_millis(300))).unwrap();
    let to = avatar.local_addr().unwrap().to_string();
    for (args, first_bone) in
        [(&[][..], "RightHand"), (&["--fingers", "--only", "right"], "RightThumbProximal")]
    {
        let mut live = Live::start(&[&[DEMO, "--loop", "--vmc", &to], args].concat(), Stdio::null());
        let (mut packets, mut bytes, mut told) = (Vec::new(), [0; 2048], false);
        let begun = Instant::now();
        loop {
            match avatar.recv(&mut bytes) {
                Ok(length) => packets.push(osc(&bytes[..length])),
                // What a finished command has sent is here.
                Err(_) if live.child.try_wait().unwrap().is_some() => break,
                Err(_) => assert!(begun.elapsed() < Duration::from_secs(120), "{} packets", packets.len()),
            }
            if packets.len() > 20 && !told {
                told = true;
                live.interrupt();
            }
        }
        let said = live.end();
        let (end, moving) = packets.split_last().unwrap();
        assert!(said.contains(&format!("in {} packets to {to}", packets.len())), "{said}");
        let bones = if first_bone == "RightHand" { 16 } else { 15 };
        // Where the hand is lost for a moment, a packet without bones says so.
        let moving: Vec<_> = moving.iter().filter(|packet| packet.len() > 2).collect();
        assert!(moving.len() > 5, "{}", moving.len());
        for packet in &moving {
            assert_eq!(packet[0].addr, "/VMC/Ext/OK");
            assert_eq!(packet.len(), 2 + bones);
            assert_eq!(packet[2].args[0], OscType::String(first_bone.into()));
        }
        assert!(moving.windows(2).any(|pair| pair[0][2..] != pair[1][2..]), "the hand moves");
        let times: Vec<f32> =
            packets.iter().map(|packet| packet[1].args[0].clone().float().unwrap()).collect();
        assert!(times.windows(2).all(|pair| pair[0] <= pair[1]) && times[0] < *times.last().unwrap());
        assert_eq!((end.len(), &end[0].args[0]), (2, &OscType::Int(0)), "at the end no hand is tracked");
    }
}

/// Writes the demo's pictures over and over, as a busy machine drops most of them, until the pipe breaks.
#[cfg(unix)]
fn feed_the_demo(mut pipe: ChildStdin) {
    let open = || handcast_media::open(DEMO, &handcast_media::OpenOptions::default()).unwrap();
    let mut source = open();
    let info = source.info().clone();
    let _ = writeln!(pipe, "YUV4MPEG2 W{} H{} F25:1 C444", info.width, info.height);
    let yuv = |[r, g, b]: [u8; 3]| {
        let [r, g, b] = [r, g, b].map(f64::from);
        let y = 16.0 + 0.257 * r + 0.504 * g + 0.098 * b;
        let [u, v] = [-0.148 * r - 0.291 * g + 0.439 * b, 0.439 * r - 0.368 * g - 0.071 * b];
        [y, 128.0 + u, 128.0 + v].map(|v| v.round() as u8)
    };
    loop {
        let Some(frame) = source.next_frame().unwrap() else {
            source = open();
            continue;
        };
        let mut planes = b"FRAME\n".to_vec();
        for channel in 0..3 {
            planes.extend(frame.image.pixels().map(|pixel| yuv(pixel.0)[channel]));
        }
        std::thread::sleep(Duration::from_millis(40));
        if pipe.write_all(&planes).is_err() {
            return;
        }
    }
}

#[cfg(unix)]
#[test]
fn ctrl_c_ends_a_pipe_with_its_recording_finished() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("hand.fba");
    let mut feeding = None;
    let live = Live::fed(&["-", "--record", path(&file)], Stdio::piped(), |child| {
        let pipe = child.stdin.take().unwrap();
        feeding = Some(std::thread::spawn(move || feed_the_demo(pipe)));
    });
    let mut viewer = live.join();
    await_plane(&mut viewer);
    std::thread::sleep(Duration::from_secs(1));
    live.interrupt();
    watch(&mut viewer);
    live.end();
    assert!(std::fs::metadata(&file).unwrap().len() > 50);
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1);
    feeding.unwrap().join().unwrap();
}

#[cfg(unix)]
#[test]
fn a_terminal_that_closes_leaves_a_whole_recording() {
    let folder = tempfile::tempdir().unwrap();
    for (k, signals) in [["HUP", "HUP"], ["HUP", "TERM"], ["HUP", "CONT"]].iter().enumerate() {
        let file = folder.path().join(format!("{k}.fba"));
        let live = Live::start(&[DEMO, "--loop", "--record", path(&file)], Stdio::null());
        let mut viewer = live.join();
        await_plane(&mut viewer);
        live.signal(signals);
        live.end();
        assert!(std::fs::read(&file).unwrap().ends_with(END), "{signals:?}");
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), k + 1, "{signals:?}");
    }
}

/// The code that ends a stream.
const END: &[u8] = &[0, 0, 1, 0xb1];

#[cfg(unix)]
#[test]
fn a_recording_on_a_full_disk_is_cut_with_its_end() {
    let folder = tempfile::tempdir().unwrap();
    for (name, left) in [("hand.fba", "hand.fba"), ("hand.mp4", "hand.partial.fba")] {
        let file = folder.path().join(name);
        // Files get half a kilobyte, and who asks for more an error.
        let script = "trap '' XFSZ; ulimit -f 1; exec \"$0\" live --bind 127.0.0.1:0 --no-net --loop \"$1\" --record \"$2\"";
        let mut child = Command::new("sh")
            .args(["-c", script, path(&crate::common::command::program()), DEMO, path(&file)])
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut said = String::new();
        let mut lines = BufReader::new(child.stderr.take().unwrap());
        while !said.contains("the recording is cut here, the room goes on") {
            assert!(lines.read_line(&mut said).unwrap() > 0, "{said}");
        }
        let live = Live { child, address: String::new() };
        live.interrupt();
        lines.read_to_string(&mut said).unwrap();
        let mut live = live;
        assert_eq!(live.child.wait().unwrap().code(), Some(1), "{said}");
        assert!(said.contains("handcast: the recording is cut: "), "{said}");
        let stream = std::fs::read(folder.path().join(left)).unwrap();
        assert!(stream.len() <= 512 && stream.len() > 300 && stream.ends_with(END), "{} bytes", stream.len());
        // A busy machine drops most of the pictures.
        let found = done(&["decode", path(&folder.path().join(left)), "-o", "-", "--to", "jsonl"]);
        assert!(found.lines().count() > 1, "{found}");
    }
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 2);
}

#[cfg(unix)]
#[test]
fn recordings_go_into_pipes() {
    let decoded = |stream: &[u8]| {
        assert!(stream.ends_with(END));
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("hand.fba");
        std::fs::write(&file, stream).unwrap();
        // A busy machine drops most of the pictures.
        assert!(done(&["decode", path(&file), "-o", "-", "--to", "jsonl"]).lines().count() > 1);
    };
    for name in ["/dev/stdout", "-"] {
        let live =
            ["live", "--bind", "127.0.0.1:0", "--no-net", DEMO, "--loop", "--seconds", "9", "--record", name];
        let out = handcast(&live);
        let said = crate::common::command::text(&out.stderr);
        assert!(out.status.success() && said.contains("http://127.0.0.1:"), "{said}");
        decoded(&out.stdout);
    }
    misused(&["live", DEMO, "--record", "-", "--json"], Path::new("no-file"), &["--json", "standard output"]);
    let folder = tempfile::tempdir().unwrap();
    let fifo = folder.path().join("hand");
    assert!(Command::new("mkfifo").arg(&fifo).status().unwrap().success());
    let from = fifo.clone();
    let reader = std::thread::spawn(move || std::fs::read(from).unwrap());
    let live = Live::start(&[DEMO, "--loop", "--seconds", "9", "--record", path(&fifo)], Stdio::null());
    live.end();
    decoded(&reader.join().unwrap());
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1);
}

/// An ffmpeg that notes what it is asked for and gives the pictures of a file.
#[cfg(unix)]
#[test]
fn streams_of_the_network_come_through_ffmpeg() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mut source = handcast_media::open(DEMO, &handcast_media::OpenOptions::default()).unwrap();
    let pictures = std::iter::from_fn(|| source.next_frame().unwrap()).map(|frame| frame.image).take(20);
    let pictures: Vec<_> = pictures.collect();
    std::fs::write(at("clip.y4m"), crate::common::y4m::y4m(&pictures)).unwrap();
    let script = format!("#!/bin/sh\necho \"$@\" > {0}/asked\ncat {0}/clip.y4m\n", folder.path().display());
    std::fs::write(at("ffmpeg"), script).unwrap();
    std::fs::set_permissions(at("ffmpeg"), std::fs::Permissions::from_mode(0o755)).unwrap();
    let live = |address: &str| {
        let path_of = std::env::var("PATH").unwrap();
        Command::new(crate::common::command::program())
            .args(["live", "--bind", "127.0.0.1:0", "--no-net", address])
            .env("PATH", format!("{}:{path_of}", folder.path().display()))
            .output()
            .unwrap()
    };
    for address in ["rtsp://camera:554/1", "http://camera/clip.mjpg"] {
        let out = live(address);
        assert!(out.status.success(), "{}", crate::common::command::text(&out.stderr));
        let asked = std::fs::read_to_string(at("asked")).unwrap();
        assert!(asked.contains(&format!("-i {address} ")) && !asked.contains("file,"), "{asked}");
    }
    let said = crate::common::command::text(&live("ftp://camera/clip.mp4").stderr);
    assert!(said.contains("nothing is read from ftp://; allowed are") && said.contains("rtsp://"), "{said}");
    let output = folder.path().join("none");
    misused(&["live", "rtsp://camera/1", "--loop"], &output, &["--loop", "a stream is gone"]);
}

/// Of a pipe that breaks nothing more comes, which is no end as any other.
#[test]
fn a_pipe_that_breaks_is_said() {
    let pictures = vec![image::RgbImage::from_pixel(64, 48, image::Rgb([90; 3])); 5];
    let mut bytes = crate::common::y4m::y4m(&pictures);
    let live = |bytes: &[u8]| {
        let mut child = Command::new(crate::common::command::program())
            .args(["live", "--bind", "127.0.0.1:0", "--no-net", "-"])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        child.stdin.take().unwrap().write_all(bytes).unwrap();
        let out = child.wait_with_output().unwrap();
        (out.status.code(), crate::common::command::text(&out.stderr))
    };
    let (code, said) = live(&bytes);
    assert!(code == Some(0) && !said.contains("damaged"), "{said}");
    bytes.extend([7; 300]);
    let (code, said) = live(&bytes);
    assert!(code == Some(1) && said.contains("handcast: -: damaged: frame 5"), "{said}");
}

#[cfg(unix)]
#[test]
fn a_kill_leaves_what_was_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let (file, partial) = (folder.path().join("hand.mp4"), folder.path().join("hand.partial.fba"));
    let live = Live::start(&[DEMO, "--loop", "--record", path(&file)], Stdio::null());
    let mut viewer = live.join();
    await_plane(&mut viewer);
    let poses = tempfile::tempdir().unwrap();
    let poses = poses.path().join("poses.jsonl");
    let recorded = || {
        let read = handcast(&["decode", path(&partial), "-o", path(&poses), "--conceal"]);
        read.status.success() && std::fs::read_to_string(&poses).unwrap().lines().count() > 10
    };
    let begun = Instant::now();
    while !recorded() {
        assert!(begun.elapsed() < Duration::from_secs(60), "ten poses in a minute");
        std::thread::sleep(Duration::from_millis(20));
    }
    // Of another one beside it, whatever its kind.
    let other = folder.path().join("hand.fba");
    let beside = ["live", "--bind", "127.0.0.1:0", DEMO, "--record", path(&other)];
    refused(&beside, &other, &["hand.partial.fba: another run is writing it"]);
    drop(live);
    assert!(!file.exists());
    assert!(recorded());
    // The next one moves it aside, and leaves none.
    refused(&["live", "no-such-clip.mp4", "--record", path(&file)], &file, &["no such file"]);
    let live = Live::start(&[DEMO, "--loop", "--record", path(&file)], Stdio::null());
    await_plane(&mut live.join());
    live.interrupt();
    live.end();
    done(&["inspect", path(&file)]);
    let mut left: Vec<_> =
        std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    left.sort();
    assert_eq!(left, ["hand.mp4", "hand.partial.old.fba"]);
}

/// Who comes is let in, however many have come before and say nothing.
#[cfg(target_os = "linux")]
#[test]
fn a_room_without_handles_lets_in_who_asks() {
    let script = "ulimit -n 48; exec \"$0\" live --bind 127.0.0.1:0 --no-net --quiet --loop \"$1\"";
    let child = Command::new("sh")
        .args(["-c", script, path(&crate::common::command::program()), DEMO])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut live = Live { child, address: String::new() };
    BufReader::new(live.child.stdout.as_mut().unwrap()).read_line(&mut live.address).unwrap();
    live.address.truncate(live.address.trim_end().len());
    let at = live.address.strip_prefix("http://").unwrap().split_once('/').unwrap().0.to_owned();
    let silent: Vec<_> = (0..100).map(|_| std::net::TcpStream::connect(&at).unwrap()).collect();
    // Without a word from those who are silent, and before their time is over.
    let begun = Instant::now();
    let viewers: Vec<RoomClient> = (0..3).map(|_| live.join()).collect();
    assert!(begun.elapsed() < Duration::from_secs(4), "{:?}", begun.elapsed());
    drop((viewers, silent));
    live.interrupt();
    live.end();
}

#[cfg(target_os = "linux")]
#[test]
fn a_clip_may_have_any_name() {
    use std::os::unix::ffi::OsStrExt as _;
    let folder = tempfile::tempdir().unwrap();
    let clip = folder.path().join(std::ffi::OsStr::from_bytes(b"clip\xff.avi"));
    std::fs::copy(DEMO, &clip).unwrap();
    let live = Command::new(crate::common::command::program())
        .args(["live", "--bind", "127.0.0.1:0", "--no-net", "--quiet", "--seconds", "0.5"])
        .arg(&clip)
        .output()
        .unwrap();
    assert!(live.status.success(), "{}", String::from_utf8_lossy(&live.stderr));
}

#[test]
fn what_cannot_be_sent_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("hand.fba");
    let live = |args: &[&str], words: &[&str]| {
        let args = [&["live", "--bind", "127.0.0.1:0", "--record", path(&file)], args].concat();
        refused(&args, &file, words);
    };
    live(&["no-such-clip.mp4"], &["no-such-clip.mp4", "no such file, and no camera"]);
    let picture = folder.path().join("one.png");
    image::RgbImage::from_pixel(64, 48, image::Rgb([90; 3])).save(&picture).unwrap();
    live(&[path(&picture)], &["one.png: a single picture, in which nothing moves", "nothing to record"]);
    let avatar = ["no room is opened", "resolve", "no.such.host.invalid"];
    live(&[DEMO, "--vmc", "no.such.host.invalid:39539"], &avatar);
    let misuse = |args: &[&str], words: &[&str]| {
        let args = [&["live", "--bind", "127.0.0.1:0", "--record", path(&file)], args].concat();
        misused(&args, &file, words);
    };
    misuse(&[DEMO, "--room", "a/b"], &["--room", "a/b", "1 to 64 letters"]);
    misuse(&[DEMO, "--vmc", "localhost:0"], &["--vmc", "1 to 65535"]);
    misuse(&[DEMO, "--input-fps", "0"], &["--input-fps", "above 0"]);
    misuse(&[DEMO, "--mask", "no-masks"], &["--mask is of one clip"]);
    misuse(&[DEMO, "--target-rms", "nan"], &["--target-rms", "above 0"]);
    for token in ["a b", ""] {
        let token = ["live", "--bind", "127.0.0.1:0", DEMO, "--token", token];
        misused(&token, &file, &["token", "letters"]);
    }
    for host in ["", "a b", "hands.example:443", "a/b"] {
        misuse(&[DEMO, "--host", host], &["--host", "without a port"]);
    }
    live(&[DEMO, "--tls", "no-cert.pem", "no-key.pem"], &["no-cert.pem"]);
    let avi = folder.path().join("hand.avi");
    misused(&["live", DEMO, "--record", path(&avi)], &avi, &["hand.avi", ".fba or .mp4"]);
    // Other systems ask ffmpeg.
    if cfg!(target_os = "linux") {
        done(&["live", "--list"]);
    }
}

/// Opens pages as a job says.
fn pages(job: &Value) -> Vec<Value> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("job.json");
    std::fs::write(&file, serde_json::to_vec(job).unwrap()).unwrap();
    let output = node("live.js", &[&chromium(), &file]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn shot(name: &str) -> Option<String> {
    let folder = std::env::var_os("HANDCAST_TEST_PICTURES")?;
    Some(path(&Path::new(&folder).join(name)).to_owned())
}

#[test]
#[ignore = "needs Chromium and node"]
fn the_page_shows_the_hand_and_says_when_its_sender_has_left() {
    let _alone = browser_alone();
    let live = Live::start(&[DEMO, "--loop", "--seconds", "60"], Stdio::null());
    let page =
        |width: u32, height: u32, name: &str| json!({ "width": width, "height": height, "shot": shot(name) });
    let job = json!({
        "url": live.address, "seconds": 4, "patience": 90_000,
        "pages": [page(900, 600, "live.png"), page(390, 800, "live-phone.png")],
    });
    for told in pages(&job) {
        let state = &told["state"];
        assert_eq!(state["hands"].as_array().unwrap().len(), 1, "{state}");
        assert_eq!(
            (&state["hands"][0]["side"], &state["senders"]),
            (&json!("right"), &json!([0])),
            "{state}"
        );
        assert!(state["planes"].as_u64().unwrap() > 5 && state["hands"][0]["sizes"] == 1, "{state}");
        assert!(told["drawn"].as_array().unwrap().len() > 2, "{told}");
        assert_eq!((&told["messages"], &told["overflow"]), (&json!([]), &json!(0)), "{told}");
        let asked = told["requests"].as_array().unwrap();
        assert!(asked.iter().all(|url| url.as_str().unwrap().starts_with(&live.address[..20])), "{told}");
    }
}

#[test]
#[ignore = "needs Chromium, node and ffmpeg"]
fn two_people_send_from_their_pages() {
    let _alone = browser_alone();
    let folder = tempfile::tempdir().unwrap();
    let video = folder.path().join("clip.y4m");
    let made = Command::new("ffmpeg")
        .args(["-v", "error", "-i", DEMO, "-vf", "scale=640:-2", "-pix_fmt", "yuv420p", "-r", "30"])
        .arg(&video)
        .status()
        .unwrap();
    assert!(made.success());
    // The room's own clip is sender 0, the pages are the others.
    let live = Live::start(&[DEMO, "--loop", "--seconds", "240"], Stdio::null());
    let page = |hands: u32, name: &str| json!({ "width": 640, "height": 420, "send": true, "hands": hands, "shot": shot(name) });
    let job = json!({
        "url": live.address, "seconds": 5, "patience": 180_000, "video": path(&video),
        "pages": [page(2, "live-first.png"), page(3, "live-second.png")],
    });
    let told = pages(&job);
    for (told, number) in told.iter().zip([1, 2]) {
        let state = &told["state"];
        assert_eq!(state["own"], number, "{state}");
        assert!(state["sending"]["rate"].as_f64().unwrap() > 0.0, "{state}");
        assert_eq!(told["messages"], json!([]), "{told}");
    }
    assert_eq!(told[1]["state"]["hands"].as_array().unwrap().len(), 3, "{}", told[1]["state"]);
}
