//! The page of a room in headless Chromium: senders and servers that are killed, and two people who wave.

#![cfg(feature = "cli")]

use std::io::{BufRead, BufReader, Lines};
use std::net::{SocketAddr, TcpListener};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::common::command::path;
use crate::common::glb::{browser_alone, chromium};
use handcast_hand::{ClipHand, HandPose, JointAngle, Morphology, PoseHeader, Side, TimedPose};
use handcast_live::client::RoomClient;
use handcast_live::page;
use handcast_live::sender::{LivePoseEncoderOptions, PoseSender};
use handcast_live::server::{Server, ServerOptions, clock_ms};
use handcast_live::transport::{Publish as _, Subscribe as _};
use handcast_live::wire::Message;
use nalgebra::{UnitQuaternion, Vector3};
use serde_json::{Value, json};

const RATE: f64 = 30.0;

/// A browser at work on a job, of which one learns step by step.
struct Pages {
    child: Child,
    lines: Lines<BufReader<ChildStdout>>,
    _folder: tempfile::TempDir,
}

impl Pages {
    fn open(job: &Value) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("job.json");
        std::fs::write(&file, serde_json::to_vec(job).unwrap()).unwrap();
        let scripts = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/node");
        assert!(scripts.join("node_modules").is_dir(), "packages are missing: npm ci --prefix tests/node");
        let mut child = Command::new("node")
            .arg(scripts.join("live.js"))
            .args([&chromium(), &file])
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        Self { child, lines, _folder: folder }
    }

    /// Waits until a step's condition is true.
    fn step(&mut self, number: usize) {
        assert_eq!(self.lines.next().unwrap().unwrap(), format!("step {number}"));
    }

    /// Waits for so many steps.
    fn after_steps(mut self, many: usize) -> Self {
        (0..many).for_each(|number| self.step(number));
        self
    }

    /// What the pages show in the end.
    fn end(mut self) -> Vec<Value> {
        let told = self.lines.next().unwrap().unwrap();
        assert!(self.child.wait().unwrap().success());
        serde_json::from_str(&told).unwrap()
    }
}

/// A hand that waves: to the right of the picture (1) or to its left (-1).
fn waving(side: Side, towards: f64, seconds: f64) -> TimedPose {
    let swing = (seconds * 1.6 * std::f64::consts::TAU).sin();
    let (turn, lean) = (0.45 * towards, 0.10 * towards - 0.26 * swing);
    let mut pose = HandPose::neutral(side);
    for joint in [
        JointAngle::Index1Flexion,
        JointAngle::Middle1Flexion,
        JointAngle::Ring1Flexion,
        JointAngle::Pinky1Flexion,
    ] {
        pose = pose.with_degrees(joint, 9.0 + 7.0 * swing);
    }
    // About an elbow 24 cm below the wrist, near the other's hand.
    pose.translation = Vector3::new(0.04 * towards - 0.24 * lean.sin(), 0.24 * (lean.cos() - 1.0), -0.6);
    pose.rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), lean)
        * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), turn);
    TimedPose::new(seconds, pose)
}

/// Tone of the skin of the two people.
fn tone(side: Side) -> u8 {
    if side == Side::Right { 3 } else { 8 }
}

/// Somebody who waves until told to stop, or dies without a word.
struct Waver {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Waver {
    fn start(server: SocketAddr, side: Side, towards: f64, length: f64) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let told = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let mut client = RoomClient::connect(server, "hand", "").unwrap();
            let mut sender = PoseSender::new(LivePoseEncoderOptions::default());
            let hands = vec![ClipHand { side, morphology: Some(Morphology::average(length)) }];
            let known = PoseHeader { hands, skin_tone: Some(tone(side)), ..PoseHeader::default() };
            let begun = Instant::now();
            for n in 0.. {
                if told.load(Ordering::Relaxed) {
                    return;
                }
                let seconds = f64::from(n) / RATE;
                std::thread::sleep(Duration::from_secs_f64(seconds).saturating_sub(begun.elapsed()));
                if client.wants_intra() {
                    sender.request_intra();
                }
                let planes =
                    sender.push(seconds, clock_ms(), &[waving(side, towards, seconds)], &known).unwrap();
                if let Some(hello) = sender.take_hello() {
                    client.hello(&hello).unwrap();
                }
                // A server may be killed meanwhile.
                if client.planes(&planes).is_err() {
                    return;
                }
            }
        });
        Self { stop, thread: Some(thread) }
    }

    /// Its connection breaks.
    fn die(mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap();
    }
}

impl Drop for Waver {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

fn server() -> Server {
    let options = ServerOptions::new("127.0.0.1:0".parse().unwrap()).with_parts(page::parts(true));
    Server::start(options).unwrap()
}

#[test]
#[ignore = "needs Chromium and node"]
fn the_page_tells_that_a_sender_was_killed_and_shows_the_next_one() {
    let _alone = browser_alone();
    let server = server();
    let waver = Waver::start(server.address(), Side::Right, 1.0, 0.18);
    let mut pages = Pages::open(&json!({
        "url": format!("http://{}/hand", server.address()), "seconds": 1, "patience": 60_000,
        "pages": [{ "width": 420, "height": 420 }],
        "steps": [
            "state.hands[0]?.side === 'right' && state.message === null",
            "state.hands.length === 0 && state.message === 'The sender is gone: its connection broke.'",
            "state.hands[0]?.side === 'left' && state.message === null",
        ],
    }));
    pages.step(0);
    waver.die();
    pages.step(1);
    // Nothing of the one that is gone is replayed.
    let mut late = RoomClient::connect(server.address(), "hand", "").unwrap();
    assert_eq!(late.next(Duration::from_millis(500)).unwrap(), None);
    let next = Waver::start(server.address(), Side::Left, -1.0, 0.18);
    pages.step(2);
    let told = pages.end();
    assert_eq!(told[0]["state"]["hands"].as_array().unwrap().len(), 1, "{}", told[0]["state"]);
    assert_eq!(told[0]["messages"], json!([]), "{}", told[0]);
    assert!(matches!(late.next(Duration::from_secs(5)).unwrap(), Some(Message::Hello { .. })));
    next.die();
}

#[test]
#[ignore = "needs Chromium and node"]
fn the_page_of_a_host_who_sends_alone_offers_no_camera() {
    let _alone = browser_alone();
    for senders in [true, false] {
        let options = ServerOptions::new("127.0.0.1:0".parse().unwrap());
        let server = Server::start(options.with_parts(page::parts(senders)).with_senders(senders)).unwrap();
        let mut publisher = server.publisher().unwrap();
        let mut sender = PoseSender::new(LivePoseEncoderOptions::default());
        let known = PoseHeader::one(Side::Right, None, Some(RATE));
        let planes = sender.push(0.0, clock_ms(), &[waving(Side::Right, 1.0, 0.0)], &known).unwrap();
        sender.take_hello().into_iter().for_each(|hello| publisher.hello(&hello).unwrap());
        publisher.planes(&planes).unwrap();
        let pages = Pages::open(&json!({
            "url": format!("http://{}/hand", server.address()), "seconds": 0.5, "patience": 60_000,
            "pages": [{ "width": 420, "height": 420 }],
            "steps": [format!(
                "state.hands.length === 1 && document.getElementById('send').checkVisibility() === {senders} \
                 && document.getElementById('send-now').textContent.includes('its host alone sends') !== {senders}"
            )],
        }));
        let told = pages.after_steps(1).end();
        assert_eq!(told[0]["messages"], json!([]), "{}", told[0]);
    }
}

/// All marks, looked at with the formulas of the shader at places of each triangle: those that its group leaves out show nothing
/// there, and most triangles are of the group without any.
#[test]
#[ignore = "needs node"]
fn marks_are_looked_for_where_they_show() {
    let script = r#"
        const [root] = process.argv.slice(1);
        const { readFileSync } = await import("node:fs");
        const { load, loadSurface } = await import(`${root}/handcast.js`);
        const bytes = name => readFileSync(new URL(`${root}/${name}`));
        const { averageSizes } = await load(bytes("handcast_decoder.wasm"));
        const surface = await loadSurface(bytes("handcast_surface.wasm"));
        const byMarks = new Function(`${bytes("src/page/marks.js")}; return byMarks;`)();
        const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        const clamp = v => Math.min(1, Math.max(0, v));
        const step = (from, to, v) => { const t = clamp((v - from) / (to - from)); return t * t * (3 - 2 * t); };
        const creaseAt = (s, i, p) => {
            const own = s.creases.subarray(4 * i, 4 * i + 12);
            const off = p.map((v, k) => v - own[k]);
            const along = dot(off, own.subarray(4)) / s.crease_width;
            return Math.exp(-along * along) * step(0, 0.8, dot(off, own.subarray(8)) / own[3]) * (1 - step(1.3, 1.6, Math.hypot(...off) / own[3]));
        };
        const lineAt = (s, i, p) => {
            if (i % 8 === 7 || p[2] <= 0) return 0;
            const [ax, ay, bx, by] = s.lines.subarray(2 * i, 2 * i + 4);
            const [dx, dy, x, y] = [bx - ax, by - ay, p[0] - ax, p[1] - ay];
            const t = clamp((x * dx + y * dy) / (dx * dx + dy * dy));
            return Math.exp(-((Math.hypot(x - t * dx, y - t * dy) / (1.2 * s.crease_width)) ** 2));
        };
        const nailAt = (s, i, p) => {
            const [x, y, z] = [0, 1, 2].map(k => dot(s.nails.subarray(4 * (i + k)), p) + s.nails[4 * (i + k) + 3]);
            return z > 0.25 && Math.abs(x) < 1.5 && Math.abs(y) < 1.5 ? 1 : 0;
        };
        const hands = ["left", "right"].flatMap(side => [false, true].flatMap(fine => [0.189, 0.15].map(length => [side, fine, length])));
        const told = hands.map(([side, fine, length]) => {
            const s = surface(side, averageSizes(length), { fine });
            const places = new Int16Array(s.vertices.buffer);
            const place = v => [0, 1, 2].map(k => s.cube[k] + (s.cube[3] * places[16 * v + k]) / 32767);
            const { sorted, ranges } = byMarks(s);
            let missed = 0;
            for (const { first, count, creases, nails, lines } of ranges) {
                for (let at = first; at < first + count; at += 3) {
                    const corners = [...sorted.subarray(at, at + 3)].map(place);
                    for (const w of [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5], [1 / 3, 1 / 3, 1 / 3]]) {
                        const p = [0, 1, 2].map(k => w[0] * corners[0][k] + w[1] * corners[1][k] + w[2] * corners[2][k]);
                        const look = (many, each, [from, to], value) => {
                            for (let i = 0; i < many; i += each) if (i < from || i >= to) missed = Math.max(missed, value(s, i, p));
                        };
                        look(54, 3, creases, creaseAt);
                        look(15, 3, nails, nailAt);
                        look(24, 1, lines, lineAt);
                    }
                }
            }
            const all = ranges.reduce((sum, range) => sum + range.count, 0);
            const same = [...sorted].sort((a, b) => a - b).join() === [...s.triangles].sort((a, b) => a - b).join();
            return { missed, same, all: all === sorted.length, plain: ranges[0].count / all };
        });
        console.log(JSON.stringify(told));
    "#;
    let root = concat!("file://", env!("CARGO_MANIFEST_DIR"), "/crates/js");
    let out = Command::new("node").args(["--input-type=module", "-e", script, root]).output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let told: Vec<Value> = serde_json::from_slice(&out.stdout).unwrap();
    for hand in &told {
        // Of a step of eight bits a crease takes 0.38 of what it is deep.
        assert!(hand["missed"].as_f64().unwrap() < 0.5 / 255.0, "{hand}");
        assert!(
            hand["same"] == true && hand["all"] == true && hand["plain"].as_f64().unwrap() > 0.7,
            "{hand}"
        );
    }
    assert_eq!(told.len(), 8);
}

/// Drawn as on a graphics card, hands have smooth edges and are else as without: also when the view has another size, and when
/// the card has been lost. Most poses that are drawn are found drawn, later than it began.
#[test]
#[ignore = "needs Chromium and node"]
fn a_graphics_card_smooths_the_edges_alone() {
    let _alone = browser_alone();
    let server = server();
    let waver = Waver::start(server.address(), Side::Right, 1.0, 0.18);
    let told = Pages::open(&json!({
        "url": format!("http://{}/hand", server.address()), "seconds": 2, "patience": 60_000,
        "pages": [{ "width": 420, "height": 420, "hash": "#buffer=0&card" }],
        "steps": ["state.skinned !== null"], "smooth": [[420, 420], [560, 380]], "lose": true,
    }))
    .after_steps(1)
    .end();
    let pictures = told[0]["smooth"].as_array().unwrap();
    assert_eq!(pictures.len(), 3, "{}", told[0]);
    let of = |picture: &Value, what: &str| picture[what].as_f64().unwrap();
    for picture in pictures {
        assert!(of(picture, "covered") > 2000.0, "{picture}");
        // Only at edges is a pixel covered in part.
        assert!(of(picture, "smooth") > 100.0 && of(picture, "rough") == 0.0, "{picture}");
        assert!(of(picture, "within") < 1.0, "levels inside: {picture}");
        assert!(of(picture, "differ") < 0.005, "share that only one covers: {picture}");
    }
    assert_ne!(pictures[0]["size"], pictures[1]["size"]);
    let drawn = told[0]["drawn"].as_array().unwrap();
    let worn: Vec<&Value> = drawn.iter().filter(|pose| pose["skinned"] == true).collect();
    let found = worn.iter().filter_map(|pose| Some([pose["shown"].as_f64()?, pose["latency"].as_f64()?]));
    let found: Vec<[f64; 2]> = found.collect();
    assert!(2 * found.len() > worn.len() && found.len() > 5, "{} of {}", found.len(), worn.len());
    assert!(found.iter().all(|[shown, began]| shown >= began), "{found:?}");
    assert_eq!(told[0]["messages"], json!([]), "{}", told[0]);
    waver.die();
}

/// Of a card on which a whole picture takes so many milliseconds, on a screen of 60 pictures a second.
#[test]
#[ignore = "needs node"]
fn pictures_are_as_sharp_as_there_is_time() {
    let script = r#"
        const { Sharpness } = await import(process.argv[1]);
        const sharpness = new Sharpness();
        const shares = [[100, 10], [200, 100], [3000, 100], [3000, 10]].map(([pictures, cost]) => {
            for (let i = 0; i < pictures; i += 1) {
                sharpness.next(16.7, false);
                sharpness.next(16.7 * Math.max(1, Math.ceil((cost * sharpness.share ** 2) / 16.7)), true);
            }
            return sharpness.share;
        });
        console.log(JSON.stringify(shares));
    "#;
    let module = concat!("file://", env!("CARGO_MANIFEST_DIR"), "/crates/live/src/page/sharpness.js");
    let out = Command::new("node").args(["--input-type=module", "-e", script, module]).output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let shares: Vec<f64> = serde_json::from_slice(&out.stdout).unwrap();
    assert!(shares[0] == 1.0 && shares[1] < 0.45 && shares[2] < 0.45 && shares[3] == 1.0, "{shares:?}");
}

/// A server that cannot be reached keeps a page for seconds from trying again, not for the minutes that a browser has.
#[test]
#[ignore = "needs node"]
fn the_page_gives_up_what_does_not_answer() {
    let script = r#"
        const made = [];
        let now = 0;
        const timers = new Map();
        globalThis.performance = { timeOrigin: 0, now: () => now };
        globalThis.setTimeout = (call, ms) => { timers.set(timers.size + 1, [now + ms, call, 0]); return timers.size; };
        globalThis.setInterval = (call, ms) => { timers.set(timers.size + 1, [now + ms, call, ms]); return timers.size; };
        globalThis.clearTimeout = id => timers.set(id, [Infinity]);
        const heard = {};
        globalThis.addEventListener = (name, call) => { heard[name] = call; };
        globalThis.document = { hidden: false, addEventListener: (name, call) => { heard[name] = call; } };
        globalThis.location = { pathname: "/hand", protocol: "http:", host: "h", hash: "" };
        globalThis.fetch = async () => undefined;
        globalThis.WebSocket = class extends EventTarget {
            static CONNECTING = 0;
            static OPEN = 1;
            readyState = 0;
            sent = 0;
            constructor() { super(); made.push([now, this]); }
            close() { this.readyState = 3; }
            send() { this.sent += 1; }
            opens() { this.readyState = 1; this.dispatchEvent(new Event("open")); }
        };
        const pass = until => {
            for (;;) {
                const due = [...timers].filter(([, [at]]) => at <= until).sort((a, b) => a[1][0] - b[1][0])[0];
                if (!due) break;
                const [id, [at, call, every]] = due;
                now = at;
                timers.set(id, [every ? at + every : Infinity, call, every]);
                call();
            }
            now = until;
        };
        const { link } = await import(process.argv[1]);
        const words = [];
        const room = { opened: () => words.push("open"), closed: why => words.push(why), heard: () => {}, now: () => now };
        const way = link(room);
        // Nothing answers: it is given up after five seconds each, and tried again later and later.
        pass(20_000);
        const silent = made.map(([at]) => at);
        // The network is back: at once, but for one that was dialled just now.
        pass(22_000);
        heard.online();
        pass(22_300);
        heard.visibilitychange();
        const online = made.at(-1)[0];
        made.at(-1)[1].opens();
        pass(25_200);
        // It opened; what is said then is not answered.
        const answered = way.open;
        pass(30_000);
        console.log(JSON.stringify({ silent, online, answered, after: made.slice(-2).map(([at]) => at), words: [...new Set(words)] }));
        process.exit();
    "#;
    let module = concat!("file://", env!("CARGO_MANIFEST_DIR"), "/crates/live/src/page/link.js");
    let out = Command::new("node").args(["--input-type=module", "-e", script, module]).output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let told: Value = serde_json::from_slice(&out.stdout).unwrap();
    let expected = json!({
        "silent": [0, 5250, 10_750, 16_750], "online": 22_250, "answered": true, "after": [22_250, 27_250],
        "words": ["The room does not answer.", "open"],
    });
    assert_eq!(told, expected);
}

/// Pictures go on where the room's clock is set back, and are by it again after a while; forwards they follow at once.
#[test]
#[ignore = "needs node"]
fn a_clock_that_is_set_back_holds_no_picture_up() {
    let script = r#"
        const { OwnHands } = await import(process.argv[1]);
        const told = [0, 10_000].map(back => {
            const room = { offset: 0 };
            const own = new OwnHands(room, {}, () => {}, () => {});
            const times = [];
            [own.on, own.last, own.own, own.distance] = [true, 0, 0, -Infinity];
            own.worker = { push: (_, captured) => times.push(captured) };
            for (let k = 0; k < 4000; k += 1) {
                if (k === 100) room.offset = -back;
                if (k === 3900) room.offset = 500;
                own.take({}, 40 * k);
            }
            const steps = times.slice(1).map((time, k) => time - times[k]);
            const at = k => times[k] - performance.timeOrigin - 40 * k;
            return { least: Math.min(...steps), before: at(99), soon: at(125), late: at(3800), forward: at(3950) };
        });
        console.log(JSON.stringify(told));
    "#;
    let folder = tempfile::tempdir().unwrap();
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("crates/live/src/page");
    for name in ["send.js", "room.js", "wire.js"] {
        std::fs::copy(page.join(name), folder.path().join(name)).unwrap();
    }
    std::fs::write(folder.path().join("handcast-sender.js"), "export class SenderWorker {}").unwrap();
    let module = format!("file://{}/send.js", folder.path().display());
    let out = Command::new("node").args(["--input-type=module", "-e", script, &module]).output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let told: Vec<Value> = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(told[0], json!({ "least": 40, "before": 0, "soon": 0, "late": 0, "forward": 500 }));
    assert_eq!(told[1], json!({ "least": 36, "before": 0, "soon": -104, "late": -10_000, "forward": 500 }));
}

#[test]
#[ignore = "needs Chromium and node"]
fn the_page_tells_that_one_has_gone_while_others_stay() {
    let _alone = browser_alone();
    let server = server();
    let stays = Waver::start(server.address(), Side::Right, 1.0, 0.18);
    let mut seen = RoomClient::connect(server.address(), "hand", "").unwrap();
    while !matches!(seen.next(Duration::from_secs(1)).unwrap(), Some(Message::Hello { .. })) {}
    let goes = Waver::start(server.address(), Side::Left, -1.0, 0.18);
    let mut pages = Pages::open(&json!({
        "url": format!("http://{}/hand", server.address()), "seconds": 0, "patience": 60_000,
        "pages": [{ "width": 420, "height": 420 }],
        "steps": [
            "state.senders.length === 2 && state.message === null",
            "state.hands.length === 1 && state.facts.includes('Sender 2 is gone: its connection broke')",
            "state.hands.length === 1 && !state.facts.includes('gone')",
        ],
    }));
    pages.step(0);
    goes.die();
    pages.step(1);
    pages.step(2);
    let told = pages.end();
    assert_eq!(told[0]["state"]["message"], Value::Null, "{}", told[0]["state"]);
    stays.die();
}

/// The command at a port that was free.
struct Live(Child);

impl Live {
    fn start(address: SocketAddr) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_handcast"))
            .args([
                "live",
                "fixtures/demo.avi",
                "--loop",
                "--no-net",
                "--quiet",
                "--bind",
                &address.to_string(),
            ])
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut said = String::new();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut said).unwrap();
        assert!(said.starts_with("http://"), "{said}");
        Self(child)
    }
}

impl Live {
    /// Told to end, it tells the room.
    fn end(mut self) {
        let kill = Command::new("kill").arg(self.0.id().to_string()).status().unwrap();
        assert!(kill.success() && self.0.wait().unwrap().success());
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
#[ignore = "needs Chromium and node"]
fn the_page_comes_back_to_a_server_that_was_killed() {
    let _alone = browser_alone();
    let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let live = Live::start(address);
    let mut pages = Pages::open(&json!({
        "url": format!("http://{address}/hand"), "seconds": 1, "patience": 90_000,
        "pages": [{ "width": 420, "height": 420 }],
        "steps": [
            "state.hands.length === 1 && state.message === null",
            "!state.open && state.hands.length === 0 && state.message !== null",
            "state.open && state.hands.length === 1 && state.message === null",
            "!state.open && state.hands.length === 0 && state.message !== null",
            "state.open && state.hands.length === 1 && state.message === null",
        ],
    }));
    pages.step(0);
    drop(live);
    pages.step(1);
    // The page asks every few seconds at most.
    std::thread::sleep(Duration::from_secs(2));
    let live = Live::start(address);
    pages.step(2);
    live.end();
    pages.step(3);
    let live = Live::start(address);
    pages.step(4);
    let told = pages.end();
    let state = &told[0]["state"];
    assert_eq!(state["senders"], json!([0]), "{state}");
    // Who has left is there again.
    assert!(!state["facts"].as_str().unwrap().contains("Sender 1"), "{state}");
    drop(live);
}

/// With `HANDCAST_TEST_PICTURES` this is the README's picture.
#[test]
#[ignore = "needs Chromium and node"]
fn two_people_wave_at_each_other() {
    let _alone = browser_alone();
    let server = server();
    let people = [(Side::Right, 1.0, 0.19), (Side::Left, -1.0, 0.17)];
    let mut wavers = Vec::new();
    for (number, (side, towards, length)) in people.into_iter().enumerate() {
        wavers.push(Waver::start(server.address(), side, towards, length));
        // In this order they stand beside one another.
        let begun = Instant::now();
        while server.counted().senders <= number {
            assert!(begun.elapsed() < Duration::from_secs(20));
            std::thread::sleep(Duration::from_millis(10));
        }
    }
    let folder = std::env::var_os("HANDCAST_TEST_PICTURES");
    // For the picture curves fill their half minute.
    let seconds = if folder.is_some() { 36 } else { 3 };
    let picture = |name: &str| folder.as_ref().map(|folder| path(&Path::new(folder).join(name)).to_owned());
    let (shot, tall) = (picture("live-preview.png"), picture("live-phone.png"));
    let told = Pages::open(&json!({
        "url": format!("http://{}/hand", server.address()), "seconds": seconds, "patience": 60_000,
        "pages": [
            { "width": 900, "height": 440, "hands": 2, "shot": shot },
            { "width": 390, "height": 844, "hands": 2, "shot": tall },
        ],
    }))
    .end();
    let state = &told[0]["state"];
    let hands = state["hands"].as_array().unwrap();
    let sides: Vec<_> = hands.iter().map(|hand| (&hand["sender"], &hand["side"])).collect();
    assert_eq!(sides, [(&json!(0), &json!("right")), (&json!(1), &json!("left"))], "{state}");
    let across = |hand: &Value| hand["wrist"][0].as_f64().unwrap();
    assert!(across(&hands[0]) < across(&hands[1]), "beside one another: {state}");
    // Where the stage is high, above one another.
    let high = told[1]["state"]["hands"].as_array().unwrap();
    let up = |hand: &Value| hand["wrist"][1].as_f64().unwrap();
    assert!(up(&high[0]) > up(&high[1]) + 0.2, "above one another: {}", told[1]["state"]);
    assert!((up(&hands[0]) - up(&hands[1])).abs() < 0.2, "beside one another: {state}");
    assert!(hands.iter().all(|hand| hand["valid"] == true && hand["sizes"] == 1), "{state}");
    let tones: Vec<_> = hands.iter().map(|hand| hand["tone"].clone()).collect();
    assert_eq!(tones, [tone(Side::Right), tone(Side::Left)], "{state}");
    assert_eq!(told[0]["messages"], json!([]), "{}", told[0]);
    wavers.into_iter().for_each(Waver::die);
}
