//! Nothing a stranger sends makes the program fall, hang or swell: hostile files, outputs that are no files, limits of
//! memory, and a program that is ended in the middle.
//!
//! What is built with `panic = "abort"` is held by
//! `CARGO_PROFILE_RELEASE_PANIC=abort cargo build --release --target-dir target/abort`, then
//! `HANDCAST_PANIC=abort HANDCAST_BINARY=$PWD/target/abort/release/handcast cargo test --test suite hold::`.

#![cfg(unix)]

use std::fs;
use std::io::{Read as _, Write as _};
use std::os::unix::fs::{FileTypeExt as _, symlink};
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::common::command::{program, text};
use crate::common::files::Files;

/// What any input may take, KiB, besides four times its size.
const MEMORY: u64 = 64 << 10;
/// Seconds of the processor in which any input is refused.
const REFUSED_IN: u64 = 2;
/// Far more than anything here takes on a busy machine; what hangs is ended.
const PATIENCE: Duration = Duration::from_secs(240);

struct Folder(tempfile::TempDir);

impl Folder {
    /// A folder with a good file of every kind that is needed here.
    fn new() -> Self {
        static GOOD: OnceLock<Files> = OnceLock::new();
        let folder = Self(tempfile::tempdir().unwrap());
        GOOD.get_or_init(|| Files::made(Self::fill)).put(folder.0.path());
        folder
    }

    fn fill(folder: &Path) {
        for line in [
            "spell HI -o good.jsonl",
            "encode good.jsonl -o good.fba",
            "decode good.fba -o good.glb",
            "decode good.fba -o good.bap",
        ] {
            let out = finished(shell_in(folder, &format!("exec \"$0\" {line}")), line);
            assert!(out.status.success(), "{line}: {}", text(&out.stderr));
        }
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        fs::write(self.at(name), bytes).unwrap();
    }

    /// The names of all files but those told, hidden ones too.
    fn others(&self, told: &[&str]) -> Vec<String> {
        let names =
            fs::read_dir(self.0.path()).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
        let mut names: Vec<_> =
            names.filter(|name| !name.starts_with("good.") && !told.contains(&name.as_str())).collect();
        names.sort();
        names
    }

    fn shell(&self, line: &str) -> Command {
        shell_in(self.0.path(), line)
    }

    fn run(&self, line: &str) -> Output {
        finished(self.shell(&format!("exec \"$0\" {line}")), line)
    }

    fn done(&self, line: &str) {
        let out = self.run(line);
        assert!(out.status.success(), "{line}: {}", text(&out.stderr));
    }

    /// Runs a line with as much memory as its inputs may take, and the time that it may take to be refused.
    fn held(&self, line: &str, refused: bool) -> Output {
        let inputs = line.split_whitespace().filter_map(|word| fs::metadata(self.at(word)).ok());
        let size: u64 = inputs.filter(fs::Metadata::is_file).map(|found| found.len()).sum();
        let limit = MEMORY + 4 * size / 1024;
        let limits = format!(
            "ulimit -d {limit}; {}",
            if refused { format!("ulimit -t {REFUSED_IN};") } else { String::new() }
        );
        finished(self.shell(&format!("{limits} exec \"$0\" {line}")), line)
    }

    /// Makes sure that a line fails in the memory and the time it may take, with these words in one line, and leaves nothing.
    fn refused(&self, line: &str, words: &str, told: &[&str]) {
        let out = self.held(line, true);
        let message = text(&out.stderr);
        println!("{line}\n    {message}");
        assert_eq!(out.status.code(), Some(1), "{line}: {} {message}", out.status);
        assert!(message.starts_with("handcast: ") && message.lines().count() == 1, "{line}: {message}");
        assert!(message.contains(words), "{line} should say {words:?}: {message}");
        // What is refused is refused before anything panics, also where a panic would be caught.
        assert!(!message.contains("broke down"), "{line}: {message}");
        assert!(message.len() < 3000, "{line}: {} bytes of message", message.len());
        assert_eq!(self.others(told), Vec::<String>::new(), "{line} left something");
    }
}

/// A shell's line in a folder, with the program's path as its first argument.
fn shell_in(folder: &Path, line: &str) -> Command {
    let mut command = Command::new("sh");
    command.args(["-c", line]).arg(program());
    command.current_dir(folder).env("RAYON_NUM_THREADS", "2").env_remove("RUST_BACKTRACE");
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// Waits for a command, which must end.
fn finished(mut command: Command, line: &str) -> Output {
    let mut child = command.spawn().unwrap();
    let (mut out, mut err) = (child.stdout.take().unwrap(), child.stderr.take().unwrap());
    let reader = std::thread::spawn(move || {
        let mut bytes = Vec::new();
        out.read_to_end(&mut bytes).unwrap();
        bytes
    });
    let errors = std::thread::spawn(move || {
        let mut bytes = Vec::new();
        err.read_to_end(&mut bytes).unwrap();
        bytes
    });
    let status = wait(&mut child, line);
    Output { status, stdout: reader.join().unwrap(), stderr: errors.join().unwrap() }
}

fn wait(child: &mut Child, line: &str) -> std::process::ExitStatus {
    let begin = Instant::now();
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            return status;
        }
        if begin.elapsed() > PATIENCE {
            child.kill().unwrap();
            panic!("{line} hangs");
        }
        sleep(Duration::from_millis(5));
    }
}

fn boxed(kind: &[u8; 4], content: &[u8]) -> Vec<u8> {
    [&(content.len() as u32 + 8).to_be_bytes()[..], kind, content].concat()
}

/// A table: version and flags, then words.
fn table(kind: &[u8; 4], rest: &[u32]) -> Vec<u8> {
    let words: Vec<u8> = [&[0], rest].concat().iter().flat_map(|word| word.to_be_bytes()).collect();
    boxed(kind, &words)
}

/// An MP4 file of five pictures that are none, with other tables in place of those of the same kinds.
fn mp4(others: &[Vec<u8>], more: &[u8]) -> Vec<u8> {
    let mut entry = vec![0; 78];
    entry[24..28].copy_from_slice(&[0, 64, 0, 48]);
    entry.extend(boxed(b"avcC", &[1, 66, 0, 30, 0xff, 0xe1, 0, 2, 0x67, 66, 1, 0, 1, 0x68]));
    let stsd = boxed(b"stsd", &[&[0, 0, 0, 0, 0, 0, 0, 1][..], &boxed(b"avc1", &entry)].concat());
    let mut tables = vec![
        stsd,
        table(b"stsz", &[10, 5]),
        table(b"stts", &[1, 5, 1]),
        table(b"stsc", &[1, 1, 5, 1]),
        table(b"stco", &[1, 100]),
    ];
    for other in others {
        tables.retain(|table| table[4..8] != other[4..8]);
        tables.push(other.clone());
    }
    let minf = [boxed(b"dinf", &table(b"dref", &[0])), boxed(b"stbl", &tables.concat())].concat();
    let hdlr = boxed(b"hdlr", &[&[0; 8][..], b"vide", &[0; 13]].concat());
    let mdia = [more.to_vec(), table(b"mdhd", &[0, 0, 25, 5, 0]), hdlr, boxed(b"minf", &minf)].concat();
    let trak =
        [boxed(b"tkhd", &[vec![0; 15], vec![1], vec![0; 68]].concat()), boxed(b"mdia", &mdia)].concat();
    let moov = [boxed(b"mvhd", &[0; 100]), boxed(b"trak", &trak)].concat();
    [boxed(b"ftyp", b"isom\0\0\0\0isom"), boxed(b"moov", &moov), boxed(b"mdat", &[0; 400])].concat()
}

#[test]
fn hostile_tables_of_movies_are_refused() {
    let folder = Folder::new();
    // Where what breaks down ends the program, ffmpeg decodes.
    let aborts = std::env::var_os("HANDCAST_PANIC").is_some_and(|panic| panic == "abort");
    for (others, more, words) in [
        (vec![], &b"\0\0\0\0free"[..], "the inner box free says it has 0 bytes"),
        (vec![table(b"stsz", &[1, 100_000_000])], b"", "100000000 pictures, allowed at most 432000"),
        (vec![table(b"stsz", &[0, 400_000])], b"", "stsz says 400000 entries"),
        (vec![table(b"stts", &[u32::MAX])], b"", "stts says 4294967295 entries"),
        (vec![table(b"stsc", &[1, 2, 5, 1])], b"", "does not begin with the first chunk"),
        (vec![table(b"stsc", &[0])], b"", "does not begin with the first chunk"),
        (vec![table(b"stco", &[0])], b"", "chunks hold fewer samples"),
        (vec![table(b"ctts", &[1, 4, 0])], b"", "ctts is of fewer pictures"),
        (vec![], b"", if aborts { "ffmpeg failed" } else { "frame 0" }),
    ] {
        folder.write("x.mp4", mp4(&others, more));
        folder.refused("track x.mp4 -o x.jsonl", words, &["x.mp4"]);
        folder.refused("view good.jsonl -o x.html --clip x.mp4", words, &["x.mp4"]);
    }
}

/// A GLB file with its JSON changed.
fn changed(glb: &[u8], change: impl FnOnce(&mut serde_json::Value)) -> Vec<u8> {
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let mut json: serde_json::Value = serde_json::from_slice(&glb[20..20 + length]).unwrap();
    change(&mut json);
    let mut text = serde_json::to_vec(&json).unwrap();
    text.resize(text.len().next_multiple_of(4), b' ');
    let rest = &glb[20 + length..];
    let total = (20 + text.len() + rest.len()) as u32;
    let head = [b"glTF", &2u32.to_le_bytes()[..], &total.to_le_bytes(), &(text.len() as u32).to_le_bytes()];
    [&head.concat()[..], b"JSON", &text, rest].concat()
}

#[test]
fn hostile_documents_of_hands_and_rigs_are_refused() {
    let folder = Folder::new();
    let good = fs::read(folder.at("good.glb")).unwrap();
    type Change = fn(&mut serde_json::Value);
    let changes: [(Change, &str); 6] = [
        (
            |json| {
                let primitive = json["meshes"][0]["primitives"][0].clone();
                json["meshes"][0]["primitives"] = vec![primitive; 20_000].into();
            },
            "nodes, allowed at most 10000",
        ),
        (|json| json["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = 999.into(), "accessor 999 of"),
        (|json| json["animations"][0]["channels"][0]["target"]["path"] = "pointer".into(), "not known here"),
        (|json| json["animations"][0]["channels"][0]["target"]["node"] = 999.into(), "moves node 999"),
        (|json| json["animations"][0]["channels"][0]["sampler"] = 999.into(), "sampler 999"),
        (
            |json| json["materials"] = vec![serde_json::json!({}); 300_000].into(),
            "300000 nodes, allowed at most 10000",
        ),
    ];
    for (change, words) in changes {
        folder.write("x.glb", changed(&good, change));
        for line in ["view x.glb -o y.html", "encode x.glb -o y.fba", "decode good.fba --mesh x.glb -o y.glb"]
        {
            folder.refused(line, words, &["x.glb"]);
        }
    }
    // A rig whose numbers are none, and whose parts do not fit together.
    let accessor = |json: &serde_json::Value, of: &str| match of {
        "indices" => json["meshes"][0]["primitives"][0]["indices"].as_u64().unwrap() as usize,
        _ => json["skins"][0]["inverseBindMatrices"].as_u64().unwrap() as usize,
    };
    let (mut few, mut odd) = (good.clone(), good.clone());
    for (glb, of, count) in [(&mut few, "matrices", 3), (&mut odd, "indices", 1000)] {
        *glb = changed(glb, |json| {
            let at = accessor(json, of);
            json["accessors"][at]["count"] = count.into();
        });
    }
    let mut keys = good.clone();
    keys = changed(&keys, |json| {
        let at = json["animations"][0]["samplers"][0]["input"].as_u64().unwrap() as usize;
        let mut fewer = json["accessors"][at].clone();
        fewer["count"] = (fewer["count"].as_u64().unwrap() - 1).into();
        let accessors = json["accessors"].as_array_mut().unwrap();
        accessors.push(fewer);
        let last = accessors.len() - 1;
        json["animations"][0]["samplers"][0]["input"] = last.into();
    });
    for (glb, line, words) in [
        (few, "decode good.fba --mesh x.glb -o y.glb", "3 inverse bind matrices for 25 joints"),
        (odd, "decode good.fba --mesh x.glb -o y.glb", "1000 corners, allowed are three for each triangle"),
        (keys, "encode x.glb -o y.fba", "key times, and values at"),
    ] {
        folder.write("x.glb", glb);
        folder.refused(line, words, &["x.glb"]);
    }
    // Keys that a player would join by an hour of poses and more.
    let mut long = good.clone();
    let length = u32::from_le_bytes(good[12..16].try_into().unwrap()) as usize;
    let json: serde_json::Value = serde_json::from_slice(&good[20..20 + length]).unwrap();
    for sampler in json["animations"][0]["samplers"].as_array().unwrap() {
        let keys = &json["accessors"][sampler["input"].as_u64().unwrap() as usize];
        let view = &json["bufferViews"][keys["bufferView"].as_u64().unwrap() as usize];
        let offset = |v: &serde_json::Value| v["byteOffset"].as_u64().unwrap_or(0) as usize;
        let last = offset(view) + offset(keys) + 4 * (keys["count"].as_u64().unwrap() as usize - 1);
        let at = 28 + length + last;
        long[at..at + 4].copy_from_slice(&50_000f32.to_le_bytes());
    }
    folder.write("x.glb", &long);
    for line in ["view x.glb -o y.html", "render x.glb -o y.gif", "encode x.glb -o y.fba"] {
        folder.refused(line, "instants, allowed at most 110000; --max-instants raises that", &["x.glb"]);
    }
}

#[test]
fn a_pipe_as_a_texture_is_refused() {
    let folder = Folder::new();
    folder.write(
        "x.gltf",
        r#"{"asset":{"version":"2.0"},"nodes":[{}],"images":[{"uri":"pipe.png"}],"textures":[{"source":0}]}"#,
    );
    assert!(Command::new("mkfifo").arg(folder.at("pipe.png")).status().unwrap().success());
    folder.refused(
        "decode good.fba --mesh x.gltf -o y.glb",
        "pipe.png: not a regular file",
        &["x.gltf", "pipe.png"],
    );
}

/// BAP text of one BAP of the right hand, at these frame numbers.
fn bap(rate: &str, numbers: impl Iterator<Item = u32>) -> String {
    let mask: Vec<&str> = (1..=296).map(|number| if number == 150 { "1" } else { "0" }).collect();
    let mask = mask.join(" ");
    let frames: Vec<String> = numbers.map(|n| format!("{mask}\n{n} {}\n", 1000 * (n % 7))).collect();
    format!("3.2 x {rate} {}\n{}", frames.len(), frames.concat())
}

#[test]
fn instants_that_rates_and_skips_imply_are_refused() {
    let folder = Folder::new();
    folder.write("x.bap", bap("1e9", [0, 4_000_000_000].into_iter()));
    for line in
        ["view x.bap -o y.html", "render x.bap -o y.png", "compare x.bap good.bap", "encode x.bap -o y.fba"]
    {
        folder.refused(line, "frames per second, allowed above 0 to 10000", &["x.bap"]);
    }
    folder.write("x.bap", bap("10000", (0..400).map(|n| n * 90_000)));
    for line in ["view x.bap -o y.html", "render x.bap -o y.png", "compare x.bap good.bap"] {
        folder.refused(line, "instants, allowed at most 110000; --max-instants raises that", &["x.bap"]);
    }
    folder.write("x.bap", bap("30", (0..400).map(|n| n * 65_536)));
    folder.refused("view x.bap -o y.html", "seconds, allowed at most 86400", &["x.bap"]);
    // A stream of planes that stand for half an hour each.
    folder.write("x.bap", bap("30", (0..39).map(|n| n * 60_000)));
    folder.done("encode x.bap -o x.fba");
    for line in [
        "decode x.fba -o y.jsonl",
        "decode x.fba -o y.glb",
        "decode x.fba -o -",
        "view x.fba -o y.html",
        "render x.fba -o y.png",
    ] {
        folder.refused(
            line,
            "instants, allowed at most 110000; --max-instants raises that",
            &["x.bap", "x.fba"],
        );
    }
}

#[test]
fn endless_and_long_inputs_are_refused() {
    let folder = Folder::new();
    for line in [
        "inspect /dev/zero",
        "decode /dev/zero -o y.jsonl",
        "view /dev/zero -o y.html",
        "encode /dev/zero -o y.fba",
    ] {
        folder.refused(line, "/dev/zero", &[]);
    }
    let header = fs::read_to_string(folder.at("good.jsonl")).unwrap().lines().next().unwrap().to_owned();
    let lines: Vec<String> =
        (0..400_000).map(|i| format!("{{\"t\":{i}e-2,\"hand\":\"right\",\"valid\":false}}\n")).collect();
    folder.write("x.jsonl", format!("{header}\n{}", lines.concat()));
    folder.write("x.json", format!("{},\"frames\":[{}]}}", header.trim_end_matches('}'), lines.join(",")));
    for file in ["x.jsonl", "x.json"] {
        for line in [
            format!("encode {file} -o y.fba"),
            format!("render {file} -o y.png"),
            format!("view {file} -o y.html"),
        ] {
            folder.refused(
                &line,
                "allowed at most 110000; --max-instants raises that",
                &["x.jsonl", "x.json"],
            );
        }
    }
    fs::remove_file(folder.at("x.json")).unwrap();
    fs::remove_file(folder.at("x.jsonl")).unwrap();
    let head = r#"{"format":"landmarks21","order":"mediapipe","unit":"m"}"#;
    let lines: Vec<String> = (0..400_000).map(|i| format!("{{\"t\":{i}}}\n")).collect();
    folder.write("x.landmarks.jsonl", format!("{head}\n{}", lines.concat()));
    folder.refused("import x.landmarks.jsonl -o y.jsonl", "x.landmarks.jsonl", &["x.landmarks.jsonl"]);
    folder.refused("view x.landmarks.jsonl -o y.html", "x.landmarks.jsonl", &["x.landmarks.jsonl"]);
}

/// A zip of one entry, deflated.
fn zipped(name: &str, content: &[u8]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let options =
        zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Deflated);
    zip.start_file(name, options).unwrap();
    zip.write_all(content).unwrap();
    zip.finish().unwrap().into_inner()
}

#[test]
fn hostile_recordings_are_refused() {
    let folder = Folder::new();
    folder.done("decode good.fba -o good.pose");
    folder.done("decode good.fba -o good.vrma");
    // A thousand bytes for each of the file.
    let header = "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000, 45), }\n";
    let npy = [b"\x93NUMPY\x01\0", &(header.len() as u16).to_le_bytes()[..], header.as_bytes()].concat();
    let bomb = [npy.clone(), vec![0; 45 * 8 * 1_000_000]].concat();
    folder.write("bomb.npz", zipped("hand_pose.npy", &bomb));
    drop(bomb);
    folder.write("cut.npz", zipped("hand_pose.npy", &npy));
    // Four thousand million frames that are not there.
    let mut pose = fs::read(folder.at("good.pose")).unwrap();
    let frames = u32::try_from(fs::read_to_string(folder.at("good.jsonl")).unwrap().lines().count() - 1);
    let rate = pose.windows(4).rposition(|four| four == 30f32.to_le_bytes()).unwrap();
    assert!(frames.is_ok() && pose.len() > rate + 10);
    pose[rate + 4..rate + 8].copy_from_slice(&u32::MAX.to_le_bytes());
    folder.write("x.pose", &pose);
    folder.write(
        "x.vrma",
        changed(&fs::read(folder.at("good.vrma")).unwrap(), |json| {
            json["animations"][0]["channels"][0]["sampler"] = 999.into();
        }),
    );
    // More frames than a file of its size may have, of each kind of JSON.
    let many = |frame: &str| vec![frame; 300_000].join(",");
    let joints = many("{\"joints\":[]}");
    folder.write("xr.json", format!("[{joints}]"));
    folder.write("leap.json", format!("{{\"frames\":[{}]}}", many("{\"timestamp\":1,\"hands\":[]}")));
    folder.write(
        "iwer.json",
        format!(
            "{{\"schema\":[[0,{{\"handedness\":\"right\",\"hasHand\":true,\"jointSequence\":[\"wrist\"]}}]],\"frames\":[{}]}}",
            many("[1]")
        ),
    );
    folder.write("mano.json", format!("[{}]", many("{\"hand_pose\":[0]}")));
    let nothing = "{\"landmarks\":[]}";
    folder.write("results.json", format!("{{\"landmarks\":[],\"frames\":[{}]}}", many("{\"t\":0}")));
    folder.write("listed.json", format!("[{nothing},{}]", many("[]")));
    folder.write("labels.json", format!("[{nothing},{{\"handedness\":[{}]}}]", many("[]")));
    folder.write("hands.json", format!("{{\"landmarks\":[],\"hands\":[{}]}}", many("{}")));
    folder.write("points.json", format!("{{\"landmarks\":[[{}]]}}", many("[1,2]")));
    // A few numbers that stand for many: lists that are missing, and names that are none.
    let missing =
        format!("{{\"hand_pose\":[[{}],{}]}}", vec!["1"; 4500].join(","), vec!["null"; 60_000].join(","));
    folder.write("missing.json", missing);
    let names: Vec<String> = (0..900_000).map(|k| format!("\"{k}\":1")).collect();
    folder.write("names.json", format!("[{{\"hand_pose\":[0]}},{{{}}}]", names.join(",")));
    folder.write("deep.json", format!("{{\"joints\":{}", "[".repeat(1 << 20)));
    folder.write("deep.bvh", "HIERARCHY\nROOT a\n{\n".to_owned() + &"JOINT b\n{\n".repeat(100_000));
    let names = ["bomb.npz", "cut.npz", "x.pose", "x.vrma", "xr.json", "leap.json", "iwer.json", "mano.json"];
    let names =
        [&names[..], &["results.json", "listed.json", "labels.json", "hands.json", "points.json"]].concat();
    let names = [&names[..], &["missing.json", "names.json", "deep.json", "deep.bvh"]].concat();
    for (file, words) in [
        ("bomb.npz", "45000000 numbers, allowed at most"),
        ("cut.npz", "45000000 numbers, allowed at most"),
        ("x.pose", "allowed at most"),
        ("x.vrma", "sampler 999"),
        ("xr.json", "xr.json"),
        ("leap.json", "leap.json"),
        ("iwer.json", "iwer.json"),
        ("results.json", "frames, allowed at most"),
        ("listed.json", "frames, allowed at most"),
        ("labels.json", "more than 64 labels"),
        ("hands.json", "more than 64 hands"),
        ("points.json", "more than 64 points"),
        ("mano.json", "more objects, lists and texts than"),
        ("missing.json", "more objects, lists and texts than"),
        ("names.json", "more objects, lists and texts than"),
        ("deep.json", "deep.json"),
        ("deep.bvh", "deep.bvh"),
    ] {
        for line in [format!("view {file} -o y.html"), format!("encode {file} -o y.fba")] {
            folder.refused(&line, words, &names);
        }
    }
}

#[test]
fn limits_are_raised_by_their_flags() {
    let folder = Folder::new();
    folder.write("x.bap", bap("30", [0, 119, 240, 299].into_iter()));
    folder.refused(
        "view x.bap -o y.html --max-instants 200",
        "300 instants, allowed at most 200",
        &["x.bap"],
    );
    folder.refused(
        "--max-seconds 5 view x.bap -o y.html",
        "allowed at most 5; --max-seconds raises that",
        &["x.bap"],
    );
    folder.refused("view x.bap -o y.html --max-bytes 9", "bytes, allowed at most 9; --max-bytes", &["x.bap"]);
    folder.done("decode good.fba -o good.bvh");
    for line in
        ["decode good.fba -o y.glb --mesh good.glb", "view good.glb -o y.html", "view good.bvh -o y.html"]
    {
        folder.refused(
            &format!("{line} --max-nodes 20"),
            "nodes, allowed at most 20; --max-nodes raises that",
            &["x.bap"],
        );
    }
    // More than a rig may have, until it may.
    let full = changed(&fs::read(folder.at("good.glb")).unwrap(), |json| {
        json["materials"].as_array_mut().unwrap().resize(10_001, serde_json::json!({}));
    });
    folder.write("x.glb", full);
    let line = "decode good.fba -o y.glb --mesh x.glb";
    folder.refused(line, "10001 nodes, allowed at most 10000; --max-nodes raises that", &["x.bap", "x.glb"]);
    folder.done(&format!("{line} --max-nodes 10001"));
    folder.done("view x.bap -o y.html --max-instants 300");
}

#[test]
fn devices_pipes_and_links_are_written_to() {
    let folder = Folder::new();
    folder.done("decode good.fba -o plain.bap");
    let expected = fs::read(folder.at("plain.bap")).unwrap();
    symlink("/dev/null", folder.at("nowhere")).unwrap();
    symlink("plain.bap", folder.at("link")).unwrap();
    symlink("fresh.bap", folder.at("dangling")).unwrap();
    folder.write("plain.bap", b"old");
    for name in ["nowhere", "link", "dangling"] {
        folder.done(&format!("decode good.fba -o {name} --to bap"));
        assert!(fs::symlink_metadata(folder.at(name)).unwrap().is_symlink(), "{name} was replaced");
    }
    assert!(fs::metadata("/dev/null").unwrap().file_type().is_char_device());
    assert_eq!(fs::read(folder.at("plain.bap")).unwrap(), expected);
    assert_eq!(fs::read(folder.at("fresh.bap")).unwrap(), expected);
    assert!(Command::new("mkfifo").arg(folder.at("pipe")).status().unwrap().success());
    for (line, shown) in
        [("decode good.fba -o pipe --to bap", expected.as_slice()), ("encode good.jsonl -o pipe", b"")]
    {
        let pipe = folder.at("pipe");
        let reader = std::thread::spawn(move || fs::read(pipe).unwrap());
        folder.done(line);
        let found = reader.join().unwrap();
        assert!(!found.is_empty() && found.starts_with(shown), "{line}");
        assert!(fs::metadata(folder.at("pipe")).unwrap().file_type().is_fifo());
    }
    let out = folder.run("decode good.fba -o /dev/full --to bap");
    assert_eq!(out.status.code(), Some(1));
    assert!(text(&out.stderr).contains("/dev/full: No space left"), "{}", text(&out.stderr));
    let told = ["nowhere", "link", "dangling", "plain.bap", "fresh.bap", "pipe"];
    assert_eq!(folder.others(&told), Vec::<String>::new());
}

/// Files may not grow beyond some KiB, as on a disk that is full.
#[test]
fn a_full_disk_leaves_no_cut_file_and_is_named() {
    let folder = Folder::new();
    for (line, file) in [
        ("synth -o x --frames 12 --size 480x360", "x/000"),
        ("synth -o x.avi --frames 12 --size 480x360", "x.avi"),
        ("decode good.fba -o x.glb", "x.glb"),
        ("render good.fba -o x.gif", "x.gif"),
    ] {
        let limited = format!("trap '' XFSZ; ulimit -f 40; exec \"$0\" {line}");
        let out = finished(folder.shell(&limited), line);
        let message = text(&out.stderr);
        assert_eq!(out.status.code(), Some(1), "{line}: {message}");
        assert!(message.contains(file) && message.contains("too large"), "{line}: {message}");
        assert_eq!(folder.others(&["x"]), Vec::<String>::new(), "{line}");
        // A clip is there as a whole or not at all.
        assert_eq!(fs::read_dir(folder.at("x")).unwrap().count(), 0, "{line}");
    }
}

/// What was found before the end cannot be written stays beside it.
#[test]
fn poses_outlive_an_overlay_that_cannot_be_written() {
    let folder = Folder::new();
    let line = format!("track {} --no-net -o x.jsonl --overlay x.avi", demo());
    let limited = format!("trap '' XFSZ; ulimit -f 400; exec \"$0\" {line}");
    let out = finished(folder.shell(&limited), &line);
    let message = text(&out.stderr);
    assert_eq!(out.status.code(), Some(1), "{message}");
    assert!(message.contains("too large") && message.contains("x.partial.jsonl"), "{message}");
    assert_eq!(folder.others(&[]), ["x.partial.jsonl"]);
    let kept = fs::read_to_string(folder.at("x.partial.jsonl")).unwrap();
    assert!(kept.lines().filter(|line| line.contains("\"wrist\"")).count() > 10, "{kept}");
    // Without the overlay it goes on from there.
    folder.done(&format!("track {} --no-net -o x.jsonl --resume", demo()));
    assert_eq!(folder.others(&[]), ["x.jsonl"]);
    // No pose file has such a rate, which is said before the work.
    folder.done("synth -o shots --frames 4 --size 64x48 --poses y.jsonl");
    folder.refused(
        "track shots --input-fps 20000 -o z.jsonl",
        "allowed are up to 10000",
        &["shots", "x.jsonl", "y.jsonl"],
    );
}

/// So is what was found before a clip cannot be read further.
#[test]
fn poses_outlive_a_clip_that_cannot_be_read_further() {
    let folder = Folder::new();
    folder.done("synth -o shots --frames 110 --poses y.jsonl");
    let mut pictures: Vec<_> = fs::read_dir(folder.at("shots")).unwrap().map(|e| e.unwrap().path()).collect();
    pictures.retain(|path| path.extension().is_some_and(|ending| ending == "png"));
    pictures.sort();
    // Of another clip.
    image::RgbImage::new(64, 48).save(&pictures[100]).unwrap();
    let out = folder.run("track shots --no-net -o x.jsonl");
    let message = text(&out.stderr);
    assert_eq!(out.status.code(), Some(1), "{message}");
    let words = "the poses until there are in x.partial.jsonl, which encode and import take";
    assert!(message.contains("those of a clip are of one size") && message.contains(words), "{message}");
    assert_eq!(folder.others(&["shots", "y.jsonl"]), ["x.partial.jsonl"]);
    assert!(times(&folder.at("x.partial.jsonl")).len() > 70);
    folder.done("encode x.partial.jsonl -o x.fba");
}

#[test]
fn pictures_that_are_lost_are_told_of() {
    let folder = Folder::new();
    let mut clip = fs::read(demo()).unwrap();
    // Chunks of nothing: the picture before is shown once more, and none is lost.
    let mut chunks = (0..clip.len() - 4).filter(|&at| &clip[at..at + 4] == b"00dc").collect::<Vec<_>>();
    chunks.truncate(60);
    let mut rests = clip.clone();
    for at in chunks.into_iter().skip(50) {
        let size = u32::from_le_bytes(clip[at + 4..at + 8].try_into().unwrap());
        rests[at + 4..at + 12].copy_from_slice(b"\0\0\0\0JUNK");
        rests[at + 12..at + 16].copy_from_slice(&(size - 8).to_le_bytes());
    }
    folder.write("rests.avi", rests);
    let out = folder.run("track rests.avi --no-net -o rests.jsonl");
    assert!(!text(&out.stderr).contains("pictures that it tells of"), "{}", text(&out.stderr));
    let shown = times(&folder.at("rests.jsonl"));
    assert_eq!((shown.len(), shown[49], shown[50]), (140, 1.96, 2.4));
    // Two lists of pictures, as files of more than a gigabyte have, of which the last does not tell where it ends.
    let movi = clip.windows(4).position(|window| window == b"movi").unwrap();
    let cut = (movi..clip.len()).filter(|&at| &clip[at..at + 4] == b"00dc").nth(40).unwrap();
    let index = clip.windows(4).rposition(|window| window == b"idx1").unwrap_or(clip.len());
    let mut lists = clip[..cut].to_vec();
    lists[movi - 4..movi].copy_from_slice(&((cut - movi) as u32).to_le_bytes());
    lists.extend(b"JUNK\x02\0\0\0..RIFF\xff\xff\xff\xffAVIXLIST\xff\xff\xff\xffmovi");
    lists.extend(&clip[cut..index]);
    folder.write("lists.avi", lists);
    folder.done("track lists.avi --no-net -o lists.jsonl");
    let [one, other] = ["whole.jsonl", "lists.jsonl"].map(|name| folder.at(name));
    folder.done(&format!("track {} --no-net -o whole.jsonl", demo()));
    assert_eq!(times(&one), times(&other));
    // Chunks of pictures that are called otherwise.
    let mut chunks = (0..clip.len() - 4).filter(|&at| &clip[at..at + 4] == b"00dc").collect::<Vec<_>>();
    chunks.truncate(60);
    for at in chunks.into_iter().skip(50) {
        clip[at..at + 4].copy_from_slice(b"JUNK");
    }
    folder.write("x.avi", clip);
    let said = |line: &str| text(&folder.run(line).stderr).to_owned();
    let words = "x.avi: of the 150 pictures that it tells of 140 are there";
    assert!(said("track x.avi --no-net -o x.jsonl").contains(words));
    assert!(!said(&format!("track {} --no-net -o y.jsonl", demo())).contains("pictures that it tells of"));
    folder.done("corpus . -o out --only x.avi --no-net");
    let manifest = fs::read_to_string(folder.at("out/manifest.jsonl")).unwrap();
    assert!(manifest.contains("of the 150 pictures that it tells of 140 are there"), "{manifest}");
}

#[test]
fn two_clips_are_not_mixed_in_a_folder() {
    let folder = Folder::new();
    folder.done("synth -o x --frames 4 --size 64x48");
    folder.done("synth -o x --frames 5 --size 64x48");
    let out = folder.run("synth -o x --frames 2 --size 64x48");
    assert_eq!(out.status.code(), Some(1));
    let message = text(&out.stderr);
    assert!(message.contains("is there from another clip, and this one has 2 frames"), "{message}");
}

/// Starts a line, and ends it by a signal as soon as `begun` holds.
fn interrupted(
    folder: &Folder,
    line: &str,
    signal: &str,
    begun: impl Fn() -> bool,
) -> std::process::ExitStatus {
    let mut child = folder.shell(&format!("exec \"$0\" {line}")).spawn().unwrap();
    let begin = Instant::now();
    while !begun() {
        assert!(begin.elapsed() < PATIENCE, "{line} does not begin");
        assert!(child.try_wait().unwrap().is_none(), "{line} ended too soon");
        sleep(Duration::from_millis(2));
    }
    let kill = Command::new("kill").args([&format!("-{signal}"), &child.id().to_string()]).status();
    assert!(kill.unwrap().success());
    wait(&mut child, line)
}

fn demo() -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/demo.avi").display().to_string()
}

#[test]
fn an_interrupted_program_leaves_nothing_unfinished() {
    let folder = Folder::new();
    let temporary = folder.at("tmp");
    fs::create_dir(&temporary).unwrap();
    let entries = |path: &Path| fs::read_dir(path).map_or(0, |entries| entries.count());
    let part = || folder.others(&["tmp"]).iter().any(|name| name.ends_with(".part"));
    for signal in ["INT", "TERM", "HUP"] {
        for line in
            ["synth -o x.avi --frames 9000", "render good.jsonl -o x.gif --size 2000x2000 --frames 2000"]
        {
            let status = interrupted(&folder, line, signal, part);
            assert_eq!(status.code(), Some(130), "{line}");
            assert_eq!(folder.others(&["tmp"]), Vec::<String>::new(), "{line} {signal}");
        }
    }
    let mut child = folder.shell("TMPDIR=tmp exec \"$0\" fidelity --no-net");
    let mut child = child.spawn().unwrap();
    let begin = Instant::now();
    while entries(&temporary) == 0 {
        assert!(begin.elapsed() < PATIENCE);
        sleep(Duration::from_millis(2));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    wait(&mut child, "fidelity");
    assert_eq!(entries(&temporary), 0, "fidelity leaves its folder");
}

#[test]
fn what_was_tracked_outlives_a_killed_program() {
    let folder = Folder::new();
    let clip = demo();
    let journal = folder.at("x.partial.jsonl");
    let lines = || fs::read_to_string(&journal).map_or(0, |text| text.lines().count());
    let status =
        interrupted(&folder, &format!("track {clip} -o x.glb --no-net --quiet"), "KILL", || lines() > 5);
    assert_eq!(status.signal(), Some(9));
    assert!(!folder.at("x.glb").exists());
    let tracked = lines();
    folder.done("decode good.fba -o unrelated.jsonl");
    folder.done("encode x.partial.jsonl -o x.fba");
    assert!(tracked > 5);
    // The next run goes on without minding, and takes its own journal away.
    folder.done(&format!("track {clip} -o x.glb --anim-only --no-net --quiet"));
    assert!(folder.at("x.glb").exists() && !journal.exists());
    // An interrupted one says where its poses are.
    fs::remove_file(folder.at("x.glb")).unwrap();
    interrupted(&folder, &format!("run {clip} -o y --no-net --quiet"), "INT", || {
        fs::read_to_string(folder.at("y/poses.partial.jsonl")).is_ok_and(|text| text.lines().count() > 5)
    });
    let left: Vec<_> = fs::read_dir(folder.at("y")).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left, ["poses.partial.jsonl"]);
}

/// The times of a pose file.
fn times(path: &Path) -> Vec<f64> {
    let text = fs::read_to_string(path).unwrap();
    let time = |line: &str| serde_json::from_str::<serde_json::Value>(line).unwrap()["t"].as_f64();
    text.lines().filter_map(time).collect()
}

#[test]
fn tracking_goes_on_where_a_killed_run_stopped() {
    let folder = Folder::new();
    // Sixteen seconds: colours are learnt anew from the first four, and two before the stop are tracked again.
    folder.done("synth -o x.avi --fps 12.5 --frames 200 --size 240x180 --poses good.truth.jsonl");
    let line = "track x.avi -o x.jsonl --no-net --quiet";
    let out = folder.run(&format!("{line} --resume"));
    assert_eq!(out.status.code(), Some(1));
    assert!(text(&out.stderr).contains("there is no x.partial.jsonl"), "{}", text(&out.stderr));
    folder.done("track x.avi -o good.whole.jsonl --no-net --quiet");
    let journal = folder.at("x.partial.jsonl");
    let lines = || fs::read_to_string(&journal).map_or(0, |text| text.lines().count());
    let status = interrupted(&folder, line, "KILL", || lines() > 125);
    assert_eq!(status.signal(), Some(9));
    assert_eq!(folder.others(&["x.avi"]), ["x.partial.jsonl"]);
    // A kill may cut a line.
    let mut cut = fs::read(&journal).unwrap();
    cut.extend(b"{\"t\":9.9");
    fs::write(&journal, &cut).unwrap();
    // What fails keeps the journal.
    let out = folder.run("track none.avi -o x.jsonl --no-net --quiet --resume");
    assert_eq!(out.status.code(), Some(1));
    assert!(lines() > 125);
    // Of another clip, or with other options, it is not gone on with.
    folder.done("synth -o other.avi --fps 12.5 --frames 50 --size 240x180");
    for other in ["other.avi -o x.jsonl --no-net", "x.avi -o x.jsonl --no-net --hand-length-mm 170"] {
        let out = folder.run(&format!("track {other} --quiet --resume"));
        assert_eq!(out.status.code(), Some(1));
        let told = text(&out.stderr);
        assert!(told.contains("is of another clip, or was made with other options"), "{told}");
        assert!(lines() > 125);
    }
    // Ended once more, it still goes on.
    let status = interrupted(&folder, &format!("{line} --resume"), "KILL", || lines() > 160);
    assert_eq!(status.signal(), Some(9));
    let out = folder.run("track x.avi -o x.jsonl --no-net --json --resume");
    assert!(out.status.success(), "{}", text(&out.stderr));
    let report: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    let frames = report["frames"].as_u64().unwrap();
    assert!((50..125).contains(&frames), "{frames} frames of 200 tracked by the last run");
    assert!(report["resumed_at"].as_f64().is_some_and(|at| at > 9.0), "{report}");
    assert!(!journal.exists());
    let (found, whole) = (times(&folder.at("x.jsonl")), times(&folder.at("good.whole.jsonl")));
    assert_eq!(found, whole);
    // As near to the truth as without a stop.
    let off = |file: &str| {
        let out = folder.run(&format!("compare good.truth.jsonl {file} --partial --json"));
        let report: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
        let joints = report["hands"][0]["joints"].as_array().unwrap();
        let squares = joints.iter().map(|joint| joint["rms_deg"].as_f64().unwrap().powi(2));
        (squares.sum::<f64>() / joints.len() as f64).sqrt()
    };
    let (resumed, whole) = (off("x.jsonl"), off("good.whole.jsonl"));
    println!("{frames} frames by the last run; {resumed:.2} degrees off, {whole:.2} without a stop");
    assert!(resumed < whole * 1.1 + 0.1, "{resumed} degrees, {whole} without a stop");
}

/// A small clip, x.avi, and what a run of it has left that was ended.
fn with_a_journal() -> (Folder, Vec<u8>) {
    let folder = Folder::new();
    folder.done("synth -o x.avi --frames 12 --size 240x180 -q");
    let poses = fs::read(folder.at("good.jsonl")).unwrap();
    fs::write(folder.at("x.partial.jsonl"), &poses).unwrap();
    (folder, poses)
}

#[test]
fn a_new_run_moves_the_journal_of_an_ended_one_aside() {
    let (folder, before) = with_a_journal();
    let out = folder.run("track x.avi -o x.jsonl --no-net");
    assert!(
        out.status.success() && text(&out.stderr).contains("x.partial.old.jsonl"),
        "{}",
        text(&out.stderr)
    );
    assert_eq!(fs::read(folder.at("x.partial.old.jsonl")).unwrap(), before);
    assert!(!folder.at("x.partial.jsonl").exists() && folder.at("x.jsonl").exists());
}

#[test]
fn two_runs_do_not_share_a_journal() {
    let (folder, poses) = with_a_journal();
    let other = fs::File::open(folder.at("x.partial.jsonl")).unwrap();
    other.lock().unwrap();
    for more in ["", "--resume"] {
        let out = folder.run(&format!("track x.avi -o x.jsonl --no-net {more}"));
        assert_eq!(out.status.code(), Some(1));
        assert!(text(&out.stderr).contains("another run is writing it"), "{}", text(&out.stderr));
    }
    assert_eq!(fs::read(folder.at("x.partial.jsonl")).unwrap(), poses);
    assert!(!folder.at("x.partial.old.jsonl").exists() && !folder.at("x.jsonl").exists());
}

#[test]
#[cfg(target_os = "linux")]
fn nobody_to_tell_is_no_fault() {
    let folder = Folder::new();
    let full = || fs::File::options().write(true).open("/dev/full").unwrap();
    let run = |line: &str, out: bool| {
        let mut command = Command::new(program());
        command.args(line.split_whitespace()).current_dir(folder.at("."));
        command.stdout(if out { full().into() } else { Stdio::null() });
        command.stderr(if out { Stdio::null() } else { full().into() });
        command.status().unwrap().code()
    };
    assert_eq!(run("decode good.fba -o y.jsonl", false), Some(0));
    assert!(folder.at("y.jsonl").exists());
    assert_eq!(run("decode none.fba -o z.jsonl", false), Some(1));
    assert_eq!(run("completions bash", true), Some(1));
}

#[test]
#[cfg(unix)]
fn what_is_replaced_stays_as_private_as_it_was() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = Folder::new();
    fs::write(folder.at("y.jsonl"), "").unwrap();
    fs::set_permissions(folder.at("y.jsonl"), fs::Permissions::from_mode(0o600)).unwrap();
    folder.done("decode good.fba -o y.jsonl -q");
    assert_eq!(fs::metadata(folder.at("y.jsonl")).unwrap().permissions().mode() & 0o777, 0o600);
}

#[test]
fn outputs_are_tried_before_the_work() {
    let folder = Folder::new();
    // Nothing but the output is looked at: the inputs are missing, too.
    for line in [
        "fidelity none.jsonl -o none/x.html",
        "fidelity none.avi -o none/x.json",
        "track none.avi -o none/x.glb",
        "track none.avi -o x.glb --overlay none/x.avi",
        "encode none.jsonl -o none/x.fba",
        "bench track none.avi --json none/x.json",
    ] {
        let words = if line.contains("overlay") { "none/x.avi: No such file" } else { "none/x." };
        folder.refused(line, words, &[]);
    }
}

#[test]
fn messages_are_short_and_tell_sizes_as_they_are() {
    let folder = Folder::new();
    folder.write("x.toml", format!("hand = \"{}\"\n", "left".repeat(125_000)));
    folder.refused("decode good.fba -o y.glb --person x.toml", "x.toml", &["x.toml"]);
    folder.refused("decode good.fba -o y.glb --mesh good.glb --map x.toml", "x.toml", &["x.toml"]);
    fs::remove_file(folder.at("x.toml")).unwrap();
    // A picture's header alone.
    let mut header = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR".to_vec();
    header.extend([30_000u32, 30_000].iter().flat_map(|side| side.to_be_bytes()));
    header.extend([8, 2, 0, 0, 0]);
    let crc = crc32(&header[12..]);
    header.extend(crc.to_be_bytes());
    header.extend(b"\0\0\0\0IDAT");
    folder.write("x.png", &header);
    folder.refused("fit x.png -o y.toml", "30000 x 30000", &["x.png"]);
}

/// ISO 3309, as PNG has it.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, &byte| {
        (0..8).fold(
            crc ^ u32::from(byte),
            |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 },
        )
    })
}

/// Good files of every kind, within the memory that their sizes allow.
#[test]
fn honest_files_take_no_more_memory_than_they_may() {
    let folder = Folder::new();
    folder.done("encode good.jsonl -o good.mp4");
    let made = ["bvh", "csv", "json", "webxr.json", "landmarks.jsonl", "pose", "vrma"];
    for ending in made {
        folder.done(&format!("decode good.fba -o good.{ending}"));
    }
    for ending in [&made[..], &["fba", "glb", "bap", "jsonl", "mp4"]].concat() {
        for line in [format!("compare good.{ending} good.{ending}"), format!("view good.{ending} -o x.html")]
        {
            let out = folder.held(&line, false);
            assert!(out.status.success(), "{line}: {} {}", out.status, text(&out.stderr));
        }
    }
}

/// Poses of 20 frames without a hand, 30 with one, and 10 without: a finger bends all the time.
fn late(folder: &Folder) {
    let line = |i: usize| {
        let valid = (20..50).contains(&i);
        let t = i as f64 / 25.0;
        format!(
            r#"{{"t":{t},"hand":"right","wrist":{{"translation":[0.01,0.02,-0.5],"rotation":[0,0,0,1]}},"angles":{{"index1_flexion":{i}}},"valid":{valid}}}"#
        )
    };
    let header = r#"{"format":"handcast-poses","version":1,"rate":25,"hands":[{"side":"right"}]}"#;
    let lines = std::iter::once(header.to_owned()).chain((0..60).map(line));
    fs::write(folder.at("late.jsonl"), lines.collect::<Vec<_>>().join("\n") + "\n").unwrap();
}

#[test]
fn lost_frames_stay_lost_and_keep_their_time() {
    let folder = Folder::new();
    late(&folder);
    let lost = |file: &str| {
        let text = fs::read_to_string(folder.at(file)).unwrap();
        (text.lines().count() - 1, text.matches("\"valid\":false").count())
    };
    for (rate, expected) in [("25", (60, 30)), ("50", (119, 60))] {
        folder.done(&format!("import late.jsonl -o even.jsonl --fps {rate}"));
        assert_eq!(lost("even.jsonl"), expected);
    }
    // Formats with a row a tick have all of them, others times.
    for ending in ["csv", "json", "bvh", "pose", "glb", "webxr.json", "vrma"] {
        let bare = if ending == "glb" { "--anim-only" } else { "" };
        folder.done(&format!("import late.jsonl -o late.{ending} {bare}"));
        let out = folder.run(&format!("compare late.jsonl late.{ending} --partial --json"));
        let report: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
        let of = |n: usize, what: &str| report["motions"][n][what].as_f64().unwrap();
        match ending {
            "bvh" => assert_eq!((of(1, "frames"), of(1, "lost")), (60.0, 0.0)),
            "pose" => assert_eq!((of(1, "frames"), of(1, "lost")), (60.0, 30.0)),
            _ => assert!(of(1, "frames") >= 30.0),
        }
        let hand = &report["hands"][0];
        assert!(hand["frames"].as_u64().unwrap() >= 30, "{ending}: {report}");
        assert!(hand["moving_rms_deg"].as_f64().unwrap() < 0.2, "{ending}: {report}");
    }
    // There is nothing to solve.
    let out = folder.run("import late.jsonl -o x.glb --smooth");
    assert_eq!(out.status.code(), Some(2));
    assert!(text(&out.stderr).contains("--smooth goes with joint positions"), "{}", text(&out.stderr));
    // Before the first pose a row holds it.
    let bvh = fs::read_to_string(folder.at("late.bvh")).unwrap();
    let rows: Vec<&str> = bvh.lines().rev().take(60).collect();
    assert!(rows[59] == rows[39] && rows[39] != rows[38] && rows[0] == rows[10] && rows[10] != rows[11]);
}

#[test]
fn pose_lines_on_standard_output_are_what_is_asked_for() {
    let folder = Folder::new();
    late(&folder);
    folder.done("encode late.jsonl -o late.fba");
    let lines = |line: &str| text(&folder.run(line).stdout).to_owned();
    folder.done("decode late.fba -o file.jsonl --centre --quiet");
    let file = fs::read_to_string(folder.at("file.jsonl")).unwrap();
    assert_eq!(lines("decode late.fba -o - --centre"), file);
    assert_ne!(lines("decode late.fba -o -"), file);
    for to in ["-", "left.jsonl"] {
        let out = folder.run(&format!("decode late.fba -o {to} --only left"));
        assert_eq!(out.status.code(), Some(1));
        assert!(text(&out.stderr).contains("there is no left hand"), "{}", text(&out.stderr));
    }
    // Streams of two rates one behind the other.
    folder.done("import late.jsonl -o fast.jsonl --fps 50");
    folder.done("encode fast.jsonl -o fast.fba");
    let streams = ["late.fba", "fast.fba"].map(|file| fs::read(folder.at(file)).unwrap());
    fs::write(folder.at("streams.fba"), streams.concat()).unwrap();
    let told = lines("inspect streams.fba");
    assert!(told.contains(", 25.000, then 50.000 frames/s\n4.780 s, "), "{told}");
    // Of two hands one that is never seen is left out.
    let two = fs::read_to_string(folder.at("late.jsonl")).unwrap();
    let mut both: Vec<String> = Vec::new();
    for line in two.lines() {
        match line.starts_with("{\"format\"") {
            true => both.push(line.replace("[{", "[{\"side\":\"left\"},{")),
            false => {
                both.push(line.replace("right", "left").replace("true", "false"));
                both.push(line.to_owned());
            }
        }
    }
    fs::write(folder.at("both.jsonl"), both.join("\n")).unwrap();
    folder.done("encode both.jsonl -o both.fba");
    let out = folder.run("compare late.fba both.fba");
    assert_eq!(out.status.code(), Some(0), "{}", text(&out.stdout));
}

#[test]
fn times_before_zero_and_of_clocks_are_taken() {
    let folder = Folder::new();
    late(&folder);
    let poses = fs::read_to_string(folder.at("late.jsonl")).unwrap();
    for (name, shift) in [("early", -2.0), ("clock", 1.7e9)] {
        let moved: Vec<String> = poses
            .lines()
            .enumerate()
            .map(|(n, line)| {
                let t = (n as f64 - 1.0) / 25.0;
                line.replace(&format!("\"t\":{t},"), &format!("\"t\":{:.2},", t + shift))
            })
            .collect();
        fs::write(folder.at(&format!("{name}.jsonl")), moved.join("\n")).unwrap();
        for ending in ["glb", "vrma", "bvh", "csv", "fba"] {
            let command = if ending == "fba" { "encode" } else { "import" };
            let bare = if ending == "glb" { "--anim-only" } else { "" };
            folder.done(&format!("{command} {name}.jsonl -o {name}.{ending} {bare}"));
            let out = folder.run(&format!("compare {name}.jsonl {name}.{ending} --partial --json"));
            let report: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
            let rms = report["hands"][0]["moving_rms_deg"].as_f64().unwrap();
            assert!(rms < if ending == "fba" { 1.0 } else { 0.2 }, "{name}.{ending}: {report}");
        }
    }
}
