//! Names that are markup, in every field that reaches a page: they are text there, and the page's policy would stop them.

#![cfg(all(feature = "cli", unix))]

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use crate::common::command::{done, misused, path, text};
use crate::common::glb::{chromium, motion, node};
use handcast_eval::fidelity::{FidelityOptions, gallery, measure, page as report_page};
use handcast_formats::person::write_person;
use handcast_formats::poses::write_poses;
use handcast_hand::{ClipHand, Joint, Morphology, Person, PoseClip, PoseHeader, Side, TimedPose};
use handcast_live::client::RoomClient;
use handcast_live::transport::{Hello, Publish as _, Subscribe as _};
use handcast_live::wire::MAX_RECORD;
use handcast_view::{Show, page as view_page};
use serde_json::{Value, json};

/// Ends scripts, styles, texts and attributes, and begins what runs.
const NAME: &str = "</script></style></title>\"'><script>window.hostile=1</script><img src=x \
                    onerror=\"alert(1);window.hostile=2\"><svg onload=alert(2)>&lt;&amp;{{script}}";
/// The same for names of files, which have no slash.
const FILE: &str = "\"'><img src=x onerror=alert(1)><svg onload=window.hostile=3><base href=x>&lt;&amp;";

fn clip(made_by: &str) -> PoseClip {
    let hands = vec![ClipHand { side: Side::Right, morphology: None }];
    let header =
        PoseHeader { rate: Some(25.0), hands, made_by: Some(made_by.into()), ..PoseHeader::default() };
    let frames = motion(Side::Right, 20).into_iter().map(|(t, pose)| TimedPose::new(t, pose)).collect();
    PoseClip { header, frames }
}

/// Pages to open, and a text that each must show.
#[derive(Default)]
struct Jobs {
    jobs: Vec<Value>,
    shown: Vec<String>,
}

impl Jobs {
    fn add(&mut self, url: &str, ready: &str, shown: &str) {
        self.jobs.push(json!({ "url": url, "ready": ready }));
        self.shown.push(shown.into());
    }

    fn add_file(&mut self, page: &Path, ready: &str, shown: &str) {
        // Every character of a path that means something in an address.
        let escape = |c: char| match c {
            'a'..='z' | 'A'..='Z' | '0'..='9' | '/' | '.' | '-' | '_' => c.to_string(),
            _ => c.to_string().bytes().map(|byte| format!("%{byte:02X}")).collect(),
        };
        let url: String = path(page).chars().map(escape).collect();
        self.add(&format!("file://{url}"), ready, shown);
    }

    /// Opens them all: nothing runs, nothing is complained of, and the name is shown. Only where the policy is lifted does
    /// what is put into the page afterwards run.
    fn open(&self, folder: &Path) {
        let list = folder.join("jobs.json");
        fs::write(&list, serde_json::to_vec(&self.jobs).unwrap()).unwrap();
        let output = node("names.js", &[&chromium(), &list]);
        let printed = text(&output.stdout);
        assert!(output.status.success(), "{printed}{}", text(&output.stderr));
        let lines: Vec<Value> = printed.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!(lines.len(), 2 * self.jobs.len());
        for (n, told) in lines.iter().enumerate() {
            let (job, lifted) = (&self.jobs[n / 2], n % 2 == 1);
            assert_eq!(told["lifted"], lifted);
            let nothing = [&told["hostile"], &told["dialogs"], &told["messages"], &told["elements"]];
            assert_eq!(nothing, [&Value::Null, &json!([]), &json!([]), &json!(0)], "{job}: {told}");
            let texts = told["texts"].as_array().unwrap();
            let shown = |text: &Value| text.as_str().unwrap().contains(&self.shown[n / 2]);
            assert!(texts.iter().any(shown), "{job} does not show {:?}: {told}", self.shown[n / 2]);
            let after = [&told["runs"], &told["styled"], &told["fetched"]];
            let policy =
                [&json!(lifted.then_some(true)), &json!(if lifted { "7px" } else { "" }), &json!(lifted)];
            assert_eq!(after, policy, "the policy of {job}: {told}");
        }
    }
}

const VIEW: &str = "Boolean(window.handcast)";
const REPORT: &str = "document.readyState === 'complete'";

/// A folder with poses made by `NAME`, under the name `FILE`.
fn hostile_poses(folder: &Path) -> PathBuf {
    let file = folder.join(format!("{FILE}.jsonl"));
    write_poses(&file, &clip(NAME)).unwrap();
    file
}

/// The motion on a rig whose joints' names are markup.
fn hostile_rig(folder: &Path, poses: &Path) -> PathBuf {
    let name = |name: &str| folder.join(name);
    let (stream, plain, rig, map) = (name("x.fba"), name("plain.glb"), name("rig.glb"), name("map.toml"));
    done(&["encode", path(poses), "-o", path(&stream)]);
    done(&["decode", path(&stream), "-o", path(&plain)]);
    let glb = fs::read(&plain).unwrap();
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let mut document: Value = serde_json::from_slice(&glb[20..20 + length]).unwrap();
    document["asset"].as_object_mut().unwrap().remove("extras");
    document["asset"]["generator"] = NAME.into();
    document["animations"][0]["name"] = NAME.into();
    let mut lines = "hand = \"right\"\n[joints]\n".to_owned();
    for (n, joint) in Joint::ALL.into_iter().enumerate() {
        let name = format!("{NAME}{n}");
        lines += &format!("{} = {:?}\n", json!(name), joint.webxr_name());
        document["nodes"][n]["name"] = name.into();
        document["nodes"][n].as_object_mut().unwrap().remove("extras");
    }
    let mut json = serde_json::to_vec(&document).unwrap();
    json.resize(json.len().next_multiple_of(4), b' ');
    let rest = &glb[20 + length..];
    let word = |n: usize| (n as u32).to_le_bytes();
    let head = [&b"glTF"[..], &word(2), &word(20 + json.len() + rest.len()), &word(json.len()), b"JSON"];
    fs::write(&rig, [&head.concat()[..], &json, rest].concat()).unwrap();
    fs::write(&map, lines).unwrap();
    let out = name(&format!("{FILE}.glb"));
    done(&["decode", path(&stream), "--mesh", path(&rig), "--map", path(&map), "-o", path(&out)]);
    assert!(text(&fs::read(&out).unwrap()).contains("window.hostile=1"), "the names are gone");
    out
}

/// A clip of pictures in a folder whose name is markup.
fn hostile_clip(folder: &Path) -> PathBuf {
    let pictures = folder.join(FILE);
    fs::create_dir(&pictures).unwrap();
    for n in 0..3 {
        image::RgbImage::new(32, 24).save(pictures.join(format!("{n}.png"))).unwrap();
    }
    pictures
}

/// A running command, and the address that it printed.
struct Served(Child, String);

impl Served {
    fn start(args: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_handcast"));
        command.args(args).env("HANDCAST_NET", "none").stdin(Stdio::null()).stderr(Stdio::null());
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        assert!(line.starts_with("http://127.0.0.1:"), "{line}");
        Self(child, line.trim().to_owned())
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
#[ignore = "needs Chromium and npm ci --prefix tests/node"]
fn names_are_text_on_pages_of_motions() {
    let folder = tempfile::tempdir().unwrap();
    let (poses, pictures) = (hostile_poses(folder.path()), hostile_clip(folder.path()));
    let glb = hostile_rig(folder.path(), &poses);
    let person = folder.path().join(format!("{FILE}.toml"));
    let named = Person { name: Some(NAME.into()), hand: Some(Side::Right), ..Person::default() };
    write_person(&person, &named).unwrap();
    let html = |n: u32| folder.path().join(format!("{n}.html"));
    let mut jobs = Jobs::default();
    let clip_args = ["--clip", path(&pictures), "--person", path(&person)];
    done(&[&["view", path(&poses), "-o", path(&html(0))], &clip_args[..]].concat());
    jobs.add_file(&html(0), VIEW, FILE);
    done(&["view", path(&glb), "-o", path(&html(1))]);
    jobs.add_file(&html(1), VIEW, FILE);
    // What no file can be called.
    let (clip, morphology) = (clip(NAME), Morphology::default());
    let notes = [NAME.to_owned()];
    let show = |title| Show {
        title,
        clip: &clip,
        morphology: &morphology,
        stream: None,
        video: None,
        notes: &notes,
    };
    fs::write(html(2), view_page(&show(NAME)).unwrap()).unwrap();
    jobs.add_file(&html(2), VIEW, NAME);
    fs::write(html(3), view_page(&show("")).unwrap()).unwrap();
    jobs.add_file(&html(3), VIEW, NAME);
    let served = Served::start(&["view", path(&poses)]);
    jobs.add(&format!("{}#finger={FILE}&speed=<script>", served.1), VIEW, FILE);
    jobs.open(folder.path());
}

#[test]
#[ignore = "needs Chromium and npm ci --prefix tests/node"]
fn names_are_text_in_reports() {
    let folder = tempfile::tempdir().unwrap();
    let poses = hostile_poses(folder.path());
    let glb = hostile_rig(folder.path(), &poses);
    let html = |n: u32| folder.path().join(format!("{n}.html"));
    let mut jobs = Jobs::default();
    for (n, input) in [&poses, &glb].into_iter().enumerate() {
        let page = html(n as u32);
        done(&["fidelity", path(input), "-o", path(&page), "--no-symmetry", "--no-curve"]);
        jobs.add_file(&page, REPORT, FILE);
    }
    let options = FidelityOptions { curve: false, mirror: false, ..FidelityOptions::default() };
    let (mut report, trip) = measure(NAME, &clip(NAME), &options).unwrap();
    report.made_by = NAME.into();
    fs::write(html(2), report_page(&report, &gallery(&trip, None))).unwrap();
    jobs.add_file(&html(2), REPORT, NAME);
    jobs.open(folder.path());
}

#[test]
#[ignore = "needs Chromium and npm ci --prefix tests/node"]
fn names_are_text_on_pages_of_rooms() {
    let folder = tempfile::tempdir().unwrap();
    let args =
        ["live", "fixtures/demo.avi", "--loop", "--seconds", "240", "--bind", "127.0.0.1:0", "--no-net"];
    let served = Served::start(&args);
    let (server, room) = served.1.strip_prefix("http://").unwrap().split_once('/').unwrap();
    let mut sender = RoomClient::connect(server, room, "").unwrap();
    let record = b"</script>\"'><img src=x onerror=window.hostile=4>&amp;".to_vec();
    assert!(record.len() <= MAX_RECORD);
    sender.hello(&Hello { hands: [true, true], record }).unwrap();
    let heard = format!("Boolean(window.handcast?.state().senders.includes({}))", sender.number().unwrap());
    // Until the room is gone.
    let sending = std::thread::spawn(move || while sender.next(Duration::from_secs(1)).is_ok() {});
    let mut jobs = Jobs::default();
    jobs.add(&served.1, &heard, room);
    jobs.add(&format!("{}#token={FILE}&buffer={FILE}", served.1), &heard, room);
    jobs.open(folder.path());
    drop(served);
    sending.join().unwrap();
    let record = folder.path().join("x.fba");
    for room in [FILE, "<b>", "a b", "a\"b"] {
        let line =
            ["live", "fixtures/demo.avi", "--bind", "127.0.0.1:0", "--room", room, "--record", path(&record)];
        misused(&line, &record, &["letters"]);
    }
}
