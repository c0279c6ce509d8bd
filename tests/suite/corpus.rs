//! A corpus: what a run leaves when it is killed, what the next one does, and what it says.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant, SystemTime};

use crate::common::command::{done, handcast, path, refused, text};
use handcast_corpus::{Choice, Corpus, Outcome, Settings, Worker};
use handcast_limits::Limits;
use serde_json::Value;
use sha2::{Digest, Sha256};

/// A file with a name that a page must escape, where the system lets files have it.
const ODD: &str = if cfg!(windows) { "a/b/xy.csv" } else { "a/b/x<y>.csv" };

/// Clips and motions in folders within folders. All clips are the same, which is made once.
fn inputs(folder: &Path, clips: usize) {
    static MADE: OnceLock<[Vec<u8>; 3]> = OnceLock::new();
    let [clip, fist, hi] = MADE.get_or_init(|| {
        let made = tempfile::tempdir().unwrap();
        let [clip, fist, hi] = ["clip.avi", "fist.jsonl", "hi.glb"].map(|name| made.path().join(name));
        let few = ["--frames", "12", "--size", "240x180", "--poses", path(&fist)];
        done(&[&["synth", "-o", path(&clip)][..], &few].concat());
        done(&["spell", "HI", "-o", path(&hi), "--anim-only"]);
        [clip, fist, hi].map(|file| fs::read(file).unwrap())
    });
    fs::create_dir_all(folder.join("a/b")).unwrap();
    for i in 0..clips {
        fs::write(folder.join(format!("a/clip-{i:02}.avi")), clip).unwrap();
    }
    fs::write(folder.join("a/b/fist.jsonl"), fist).unwrap();
    fs::write(folder.join("hi.glb"), hi).unwrap();
    fs::copy("fixtures/demo.poses.jsonl", folder.join("a/b/demo.poses.jsonl")).unwrap();
    fs::write(folder.join("notes.txt"), "no input").unwrap();
}

fn lines(file: &Path) -> Vec<Value> {
    let text = fs::read_to_string(file).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn names(file: &Path) -> Vec<String> {
    lines(file).iter().map(|line| line["name"].as_str().unwrap().to_owned()).collect()
}

/// All files below a folder, with their content.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path));
        } else {
            found.insert(path.clone(), fs::read(&path).unwrap());
        }
    }
    found
}

/// Streams by their names below the folder of streams.
fn streams(out: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let root = out.join("streams");
    files(&root).into_iter().map(|(path, bytes)| (path.strip_prefix(&root).unwrap().into(), bytes)).collect()
}

fn report(out: &Path) -> Value {
    serde_json::from_slice(&fs::read(out.join("report.json")).unwrap()).unwrap()
}

/// A run that goes on by itself.
fn begun(input: &Path, out: &Path, more: &[&str]) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_handcast"));
    command.args(["corpus", path(input), "-o", path(out)]).args(more).env("HANDCAST_NET", "none");
    command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

fn wait_until(what: &str, mut met: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !met() {
        assert!(begun.elapsed() < Duration::from_secs(120), "{what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn count(file: &Path) -> usize {
    fs::read(file).map_or(0, |bytes| bytes.iter().filter(|b| **b == b'\n').count())
}

#[test]
fn every_input_has_a_stream_and_a_line_that_tells_of_it() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("in"), dir.path().join("out"));
    inputs(&input, 1);
    let said = done(&["corpus", path(&input), "-o", path(&out), "--jobs", "2"]);
    assert!(said.contains("4 inputs; 4 done, 0 failed") && said.contains("kbit/s"), "{said}");
    let manifest = lines(&out.join("manifest.jsonl"));
    let all = ["a/b/demo.poses.jsonl", "a/b/fist.jsonl", "a/clip-00.avi", "hi.glb"];
    assert_eq!(names(&out.join("manifest.jsonl")), all);
    for line in &manifest {
        let (name, stream) = (line["name"].as_str().unwrap(), line["stream"].as_str().unwrap());
        let bytes = fs::read(out.join(stream)).unwrap();
        assert_eq!(line["bytes"], bytes.len(), "{name}");
        assert_eq!(line["input_bytes"], fs::metadata(input.join(name)).unwrap().len());
        let sum = Sha256::digest(fs::read(input.join(name)).unwrap());
        let sum: String = sum.iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(line["sha256"], sum, "{name}");
        let seconds = line["seconds"].as_f64().unwrap();
        let rate = bytes.len() as f64 * 8e-3 / seconds;
        assert!((rate - line["kbit_per_s"].as_f64().unwrap()).abs() < 1e-3 * rate.max(1.0), "{line}");
        assert!(out.join(format!("settings/{}.json", line["settings"].as_str().unwrap())).is_file());
        assert_eq!(line["made_by"], concat!("handcast ", env!("CARGO_PKG_VERSION")));
    }
    let clip = &manifest[2];
    assert_eq!((clip["kind"].as_str(), clip["side"].as_str()), (Some("clip"), Some("right")));
    assert_eq!(clip["rate"].as_f64(), Some(25.0));
    assert!((clip["seconds"].as_f64().unwrap() - 0.48).abs() < 0.05, "{clip}");
    assert!(clip["confidence"].as_f64().unwrap() > 0.3 && clip["overlap"].as_f64().unwrap() > 0.9, "{clip}");
    assert_eq!(fs::read(out.join("failures.jsonl")).unwrap(), b"");

    // The same streams as by the commands for single files.
    let single = dir.path().join("run");
    done(&["run", path(&input.join("a/clip-00.avi")), "-o", path(&single), "--no-pictures"]);
    assert_eq!(
        fs::read(single.join("hand.fba")).unwrap(),
        fs::read(out.join("streams/a/clip-00.avi.fba")).unwrap()
    );
    for (name, other) in [("hi.glb", "hi.fba"), ("a/b/fist.jsonl", "fist.fba")] {
        let other = dir.path().join(other);
        done(&["encode", path(&input.join(name)), "-o", path(&other)]);
        assert_eq!(
            fs::read(&other).unwrap(),
            fs::read(out.join(format!("streams/{name}.fba"))).unwrap(),
            "{name}"
        );
    }

    // What run made of a clip is no input, where it lies among them.
    fs::rename(&single, input.join("a/clip-00-handcast")).unwrap();
    let said = done(&["corpus", path(&input), "-o", path(&out)]);
    assert!(said.contains("4 inputs"), "{said}");
    assert!(said.contains("results of this program in 1 folder: a/clip-00-handcast"), "{said}");
}

#[test]
fn motions_are_imported_as_asked_and_what_is_worth_knowing_of_them_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("in"), dir.path().join("out"));
    inputs(&input, 1);
    done(&["import", "fixtures/demo.poses.jsonl", "-o", path(&input.join("hand.landmarks.jsonl"))]);
    // A pose that is missing; a clip that is cut.
    let fist = input.join("a/b/fist.jsonl");
    let poses = fs::read_to_string(&fist).unwrap();
    let gap = poses.lines().enumerate().filter_map(|(i, line)| (i != 6).then_some(line));
    fs::write(&fist, gap.collect::<Vec<_>>().join("\n")).unwrap();
    let clip = fs::read(input.join("a/clip-00.avi")).unwrap();
    fs::write(input.join("a/clip-00.avi"), &clip[..clip.len() * 4 / 5]).unwrap();
    let run = |more: &[&str]| {
        let output = handcast(&[&["corpus", path(&input), "-o", path(&out)], more].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        let lines = lines(&out.join("manifest.jsonl")).into_iter();
        let lines: BTreeMap<String, Value> =
            lines.map(|line| (line["name"].as_str().unwrap().to_owned(), line)).collect();
        (lines, text(&output.stdout).to_owned(), text(&output.stderr).to_owned())
    };
    let told = |line: &Value, words: &str| {
        let mut notices = line["notices"].as_array().unwrap().iter();
        notices.any(|notice| notice.as_str().unwrap().contains(words))
    };
    let (usual, said, _) = run(&[]);
    let bridged = "1 pose in a gap is interpolated";
    assert!(told(&usual["a/b/fist.jsonl"], bridged), "{usual:?}");
    let cut = &usual["a/clip-00.avi"];
    assert!(told(cut, cut["shortfall"].as_str().unwrap()), "{cut}");
    assert!(said.contains("notices     of 2 of the streams"), "{said}");
    let facts = report(&out);
    assert_eq!(facts["noticed"], 2, "{facts}");
    assert!(fs::read_to_string(out.join("report.html")).unwrap().contains(bridged));

    let (smooth, _, said) = run(&["--smooth", "--mirror", "--match", "*.jsonl"]);
    assert!(said.contains("3 results were made with other settings"), "{said}");
    assert!(said.contains("--mirror applies to clips alone, not to the 3 motion files"), "{said}");
    let [joints, poses] = ["hand.landmarks.jsonl", "a/b/demo.poses.jsonl"];
    let other = |lines: &BTreeMap<String, Value>, name: &str| {
        lines[name]["stream_sha256"] != usual[name]["stream_sha256"]
    };
    assert!(other(&smooth, joints) && !other(&smooth, poses));
    assert!(told(&smooth[poses], "--smooth changes nothing"), "{smooth:?}");
    // Those not asked for are of other settings now.
    let facts = report(&out);
    assert_eq!((&facts["clips"], &facts["otherwise"]), (&3.into(), &2.into()), "{facts}");
    let (part, ..) = run(&["--from", "0.2", "--until", "0.6", "--match", "hand.*"]);
    assert_eq!(part[joints]["seconds"], 0.4);
    let (long, ..) = run(&["--hand-length-mm", "120", "--hand", "right", "--match", "hand.*"]);
    assert!(other(&long, joints));
}

#[test]
#[cfg(unix)]
fn a_killed_run_goes_on_and_ends_as_if_nothing_had_been() {
    let dir = tempfile::tempdir().unwrap();
    let [input, out, whole] = ["in", "out", "whole"].map(|name| dir.path().join(name));
    inputs(&input, 6);
    done(&["corpus", path(&input), "-o", path(&whole), "-j", "2"]);
    let all = names(&whole.join("manifest.jsonl"));
    assert_eq!(all.len(), 9);
    let manifest = out.join("manifest.jsonl");
    let mut before: BTreeMap<String, SystemTime> = BTreeMap::new();
    for least in [3, 5] {
        let mut run = begun(&input, &out, &["-j", "2"]);
        wait_until("streams", || count(&manifest) >= least);
        // Kill -9: nothing can be put in order.
        run.kill().unwrap();
        assert!(!run.wait().unwrap().success(), "it was done before it was killed");
        // What stands there is whole.
        for (name, bytes) in streams(&out) {
            let hidden = name.file_name().unwrap().to_str().unwrap().starts_with('.');
            assert!(hidden || streams(&whole)[&name] == bytes, "{}", name.display());
        }
        // A line that was cut, as a full disk or a power cut leaves it.
        let mut cut = fs::read(&manifest).unwrap();
        cut.extend(b"{\"name\":\"a/clip-05.avi\",\"sha2");
        fs::write(&manifest, cut).unwrap();
        for (name, time) in &before {
            assert_eq!(
                fs::metadata(out.join(name)).unwrap().modified().unwrap(),
                *time,
                "{name} was done twice"
            );
        }
        let text = fs::read_to_string(&manifest).unwrap();
        let whole_lines = text.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
        before = whole_lines
            .map(|line| {
                let stream = line["stream"].as_str().unwrap().to_owned();
                let time = fs::metadata(out.join(&stream)).unwrap().modified().unwrap();
                (stream, time)
            })
            .collect();
        assert!(before.len() >= least && before.len() < all.len(), "{} lines", before.len());
    }
    fs::write(out.join("streams/a/.clip-04.avi.fba.xyz123.part"), "half").unwrap();
    done(&["corpus", path(&input), "-o", path(&out), "-j", "2"]);
    for (name, time) in &before {
        assert_eq!(fs::metadata(out.join(name)).unwrap().modified().unwrap(), *time, "{name} was done twice");
    }
    let run = &report(&out)["run"];
    assert_eq!(run["before"], before.len());
    assert_eq!(run["done"], all.len() - before.len());
    assert_eq!(fs::read(&manifest).unwrap(), fs::read(whole.join("manifest.jsonl")).unwrap());
    assert!(streams(&out) == streams(&whole), "the streams differ, or something half is left");
}

#[test]
fn a_broken_clip_is_a_line_and_the_others_are_done() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("in"), dir.path().join("out"));
    inputs(&input, 2);
    let clip = fs::read(input.join("a/clip-01.avi")).unwrap();
    // No picture is whole.
    fs::write(input.join("a/clip-01.avi"), &clip[..1500]).unwrap();
    fs::write(input.join("words.mp4"), "this is no video").unwrap();
    fs::write(input.join(ODD), "these are words\n").unwrap();
    let said = done(&["corpus", path(&input), "-o", path(&out)]);
    assert!(said.contains("4 done, 3 failed"), "{said}");
    let failures = lines(&out.join("failures.jsonl"));
    assert_eq!(names(&out.join("failures.jsonl")), [ODD, "a/clip-01.avi", "words.mp4"]);
    for failure in &failures {
        let error = failure["error"].as_str().unwrap();
        assert!(error.len() > 10 && !error.contains('\n') && !error.contains(path(&input)), "{error}");
        assert_eq!(failure["sha256"].as_str().unwrap().len(), 64);
        let name = failure["name"].as_str().unwrap();
        assert!(!out.join(format!("streams/{name}.fba")).exists(), "{name}");
    }
    assert_eq!(count(&out.join("manifest.jsonl")), 4);
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.contains("Content-Security-Policy") && page.contains("script-src 'none'"));
    assert!(cfg!(windows) || page.contains("x&lt;y&gt;.csv") && !page.contains("x<y>"), "names are escaped");

    // Not tried again, unless asked for, or mended.
    let said = done(&["corpus", path(&input), "-o", path(&out)]);
    assert!(said.contains("3 failed before, which --retry tries again"), "{said}");
    let run = |key: &str| report(&out)["run"][key].as_u64().unwrap();
    assert_eq!([run("before"), run("failed_before"), run("done"), run("failed")], [4, 3, 0, 0]);
    done(&["corpus", path(&input), "-o", path(&out), "--retry"]);
    assert_eq!([run("before"), run("failed_before"), run("done"), run("failed")], [4, 0, 0, 3]);
    fs::write(input.join("a/clip-01.avi"), &clip).unwrap();
    fs::remove_file(input.join("words.mp4")).unwrap();
    done(&["corpus", path(&input), "-o", path(&out)]);
    assert_eq!([run("before"), run("failed_before"), run("done"), run("failed")], [4, 1, 1, 0]);
    assert_eq!(names(&out.join("failures.jsonl")), [ODD]);
}

/// How many inputs a run has found done before, done, and failed at.
fn counted(input: &Path, out: &Path, more: &[&str]) -> [u64; 3] {
    done(&[&["corpus", path(input), "-o", path(out)], more].concat());
    let run = report(out)["run"].clone();
    ["before", "done", "failed"].map(|key| run[key].as_u64().unwrap())
}

#[test]
fn a_part_of_each_clip_is_done_anew_with_other_bounds() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("in"), dir.path().join("out"));
    inputs(&input, 2);
    let run = |more: &[&str]| counted(&input, &out, more);
    let seconds = |name: &str| {
        let lines = lines(&out.join("manifest.jsonl"));
        lines.iter().find(|line| line["name"] == name).unwrap()["seconds"].as_f64().unwrap()
    };
    assert_eq!(run(&[]), [0, 5, 0]);
    let (whole, motion) = (seconds("a/clip-00.avi"), seconds("a/b/fist.jsonl"));
    let part = ["--from", "0.12", "--until", "0:00.32"];
    assert_eq!(run(&part), [0, 5, 0]);
    assert!((seconds("a/clip-00.avi") - 0.2).abs() < 1e-9 && whole > 0.4, "{whole}");
    assert!((seconds("a/b/fist.jsonl") - 0.2).abs() < 1e-9 && motion > 0.4, "{motion}");
    // As `run` makes it of one clip.
    let alone = dir.path().join("alone");
    done(&[&["run", path(&input.join("a/clip-00.avi")), "-o", path(&alone), "-q"], &part[..]].concat());
    assert!(
        fs::read(alone.join("hand.fba")).unwrap() == fs::read(out.join("streams/a/clip-00.avi.fba")).unwrap()
    );
    assert_eq!(run(&part), [5, 0, 0]);
    assert_eq!(run(&["--from", "0.12"]), [0, 5, 0]);
    // Behind the clips' end.
    assert_eq!(handcast(&["corpus", path(&input), "-o", path(&out), "--from", "99"]).status.code(), Some(1));
    let failures = lines(&out.join("failures.jsonl"));
    assert!(failures[1]["error"].as_str().unwrap().starts_with("no pose from 99 s"), "{failures:?}");
    assert!(failures[2]["error"].as_str().unwrap().contains("a/clip-00.avi"), "{failures:?}");
    assert_eq!(
        handcast(&["corpus", path(&input), "-o", path(&out), "--from", "2", "--until", "2"]).status.code(),
        Some(2)
    );
}

#[test]
fn what_has_changed_is_done_anew_and_nothing_else() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("in"), dir.path().join("out"));
    inputs(&input, 1);
    let run = |more: &[&str]| counted(&input, &out, more);
    assert_eq!(run(&[]), [0, 4, 0]);
    let first = lines(&out.join("manifest.jsonl"));
    // Another time alone changes nothing but the line's time.
    let fist = input.join("a/b/fist.jsonl");
    let touch =
        |time: SystemTime| fs::File::options().append(true).open(&fist).unwrap().set_modified(time).unwrap();
    let time = fs::metadata(&fist).unwrap().modified().unwrap();
    touch(time + Duration::from_secs(5));
    assert_eq!(run(&[]), [4, 0, 0]);
    touch(time);
    assert_eq!(run(&[]), [4, 0, 0]);
    assert_eq!(lines(&out.join("manifest.jsonl")), first);
    // Other content.
    let poses = fs::read_to_string(&fist).unwrap();
    let shorter: Vec<&str> = poses.lines().take(8).collect();
    fs::write(&fist, shorter.join("\n")).unwrap();
    assert_eq!(run(&[]), [3, 1, 0]);
    let second = lines(&out.join("manifest.jsonl"));
    assert_eq!(second.len(), 4);
    assert_ne!(first[1]["sha256"], second[1]["sha256"]);
    assert!(second[1]["seconds"].as_f64() < first[1]["seconds"].as_f64());
    // Other content of the same length and time is seen by its checksum alone.
    let time = fs::metadata(&fist).unwrap().modified().unwrap();
    let same_length = fs::read_to_string(&fist).unwrap().replacen("0.1", "0.2", 1);
    fs::write(&fist, same_length).unwrap();
    touch(time);
    assert_eq!(run(&[]), [4, 0, 0]);
    assert_eq!(run(&["--checksum"]), [3, 1, 0]);
    // So is a stream that was damaged.
    let (stream, whole) = (out.join("streams/hi.glb.fba"), streams(&out));
    let mut damaged = fs::read(&stream).unwrap();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 0x10;
    fs::write(&stream, &damaged).unwrap();
    assert_eq!(run(&[]), [4, 0, 0]);
    assert!(fs::read(&stream).unwrap() == damaged);
    assert_eq!(run(&["--checksum"]), [3, 1, 0]);
    assert!(streams(&out) == whole, "the stream is not as it was");
    assert_eq!(run(&["--checksum"]), [4, 0, 0]);
    // A stream that is gone; other settings; an input that is gone, whose stream stays.
    fs::remove_file(out.join("streams/hi.glb.fba")).unwrap();
    assert_eq!(run(&[]), [3, 1, 0]);
    assert_eq!(run(&["--quant", "12"]), [0, 4, 0]);
    assert_eq!(fs::read_dir(out.join("settings")).unwrap().count(), 2);
    fs::remove_file(input.join("hi.glb")).unwrap();
    assert_eq!(run(&["--quant", "12"]), [3, 0, 0]);
    assert_eq!(count(&out.join("manifest.jsonl")), 4);
    assert_eq!(run(&["--quant", "12", "--match", "*.avi"]), [1, 0, 0]);
    assert!(out.join("streams/hi.glb.fba").is_file());
    // A run with other settings that is ended before it has made a stream takes none away.
    let twelve = (lines(&out.join("manifest.jsonl")), streams(&out));
    let settings = Settings::default();
    let opened = Corpus::open(&input, &out, &settings, &Choice::default()).unwrap();
    assert_eq!(opened.todo().len(), 3);
    drop(opened);
    assert!((lines(&out.join("manifest.jsonl")), streams(&out)) == twelve);
    assert_eq!(run(&["--quant", "12"]), [3, 0, 0]);
    // What fails now has no stream any more.
    fs::write(&fist, "none").unwrap();
    assert_eq!(run(&["--quant", "12"]), [2, 0, 1]);
    assert!(!out.join("streams/a/b/fist.jsonl.fba").exists());
    assert_eq!(count(&out.join("manifest.jsonl")), 3);
}

/// The limit is of single files, and bytes beyond it are not written, as on a disk that is full; bash counts it in KiB.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_leaves_whole_lines_and_the_next_run_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let (input, out) = (folder.path().join("in"), folder.path().join("out"));
    fs::create_dir_all(&input).unwrap();
    let manifest = out.join("manifest.jsonl");
    for i in 0..40 {
        fs::copy("fixtures/demo.poses.jsonl", input.join(format!("{i:02}.jsonl"))).unwrap();
    }
    let limited = "trap '' XFSZ; ulimit -f 8; exec \"$0\" corpus \"$1\" -o \"$2\" --jobs 2";
    let run = Command::new("bash")
        .args(["-c", limited, env!("CARGO_BIN_EXE_handcast"), path(&input), path(&out)])
        .env("HANDCAST_NET", "none")
        .output()
        .unwrap();
    assert!(!run.status.success());
    let said = text(&run.stderr);
    assert!(said.contains("manifest.jsonl: File too large"), "{said}");
    let (left, count) = (fs::read(&manifest).unwrap(), names(&manifest).len());
    assert!(left.len() <= 8 << 10 && left.ends_with(b"}\n") && (4..40).contains(&count), "{count}");
    done(&["corpus", path(&input), "-o", path(&out)]);
    assert_eq!(names(&manifest).len(), 40);
}

/// A clip of grey pictures, in which there is no hand.
fn grey(frames: usize) -> Vec<u8> {
    use handcast_media::avi::MjpegWriter;
    let picture = image::RgbImage::from_pixel(64, 48, image::Rgb([90; 3]));
    let mut writer = MjpegWriter::new(std::io::Cursor::new(Vec::new()), (64, 48), (25, 1), 90).unwrap();
    (0..frames).for_each(|_| writer.write(&picture).unwrap());
    writer.finish().unwrap().into_inner()
}

#[test]
fn limits_hold_before_the_work_and_those_of_bytes_are_not_of_clips() {
    let folder = tempfile::tempdir().unwrap();
    let (input, out) = (folder.path().join("in"), folder.path().join("out"));
    inputs(&input, 1);
    fs::write(input.join("grey.avi"), grey(120)).unwrap();
    let most = ["--max-instants", "100", "--max-bytes", "1K"];
    done(&[&["corpus", path(&input), "-o", path(&out)], &most[..]].concat());
    assert_eq!(names(&out.join("manifest.jsonl")), ["a/clip-00.avi"]);
    let failures = lines(&out.join("failures.jsonl"));
    let error = |name: &str| {
        let line = failures.iter().find(|line| line["name"] == name).unwrap();
        line["error"].as_str().unwrap().to_owned()
    };
    // Tracking would tell that there is no hand.
    assert_eq!(error("grey.avi"), "120 instants, allowed at most 100");
    assert!(error("a/b/fist.jsonl").ends_with("bytes, allowed at most 1024"));
    assert_eq!(failures.len(), 4);

    let clip = input.join("grey.avi");
    let fidelity = handcast(&["fidelity", path(&clip), "--max-instants", "100"]);
    let said = text(&fidelity.stderr);
    assert!(
        said.contains("grey.avi: 120 instants, allowed at most 100; --max-instants raises that"),
        "{said}"
    );
}

#[test]
fn clips_are_opened_within_the_limits_of_a_worker() {
    let folder = tempfile::tempdir().unwrap();
    let (input, out) = (folder.path().join("in"), folder.path().join("out"));
    fs::create_dir(&input).unwrap();
    fs::write(input.join("grey.avi"), grey(30)).unwrap();
    let settings = Settings::default();
    let corpus = Corpus::open(&input, &out, &settings, &Choice::default()).unwrap();
    let error = |limits: Limits| {
        let worker = Worker::new(&input, &out, &settings).with_limits(limits);
        match worker.work(&corpus.todo()[0]).unwrap() {
            Outcome::Failed(failure) => failure.error,
            Outcome::Done(_) => panic!("there is no hand in it"),
        }
    };
    let limits = Limits::default();
    assert!(error(limits.clone()).contains("no hand"));
    let told = error(limits.clone().with_pixels(3000));
    assert!(
        told.contains("picture of 64 x 48 pixels; allowed are 1 to 16384 a side and 3000 in all"),
        "{told}"
    );
    let told = error(limits.with_pictures(20));
    assert!(told.ends_with("21 pictures, allowed at most 20"), "{told}");
}

#[test]
fn a_second_run_in_the_same_folder_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let (input, out) = (dir.path().join("in"), dir.path().join("out"));
    inputs(&input, 3);
    let mut first = begun(&input, &out, &["-j", "1"]);
    wait_until("the first run", || count(&out.join("manifest.jsonl")) > 0);
    let second = handcast(&["corpus", path(&input), "-o", path(&out)]);
    assert!(first.try_wait().unwrap().is_none(), "the first was done too early to tell");
    assert_eq!(second.status.code(), Some(1));
    assert!(text(&second.stderr).contains("another run is at work"), "{}", text(&second.stderr));
    assert!(first.wait().unwrap().success());
    assert_eq!(count(&out.join("manifest.jsonl")), 6);
    done(&["corpus", path(&input), "-o", path(&out)]);
}

#[test]
fn wrong_calls_are_told() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    fs::create_dir(at("empty")).unwrap();
    fs::create_dir(at("bad")).unwrap();
    fs::write(at("bad/words.mp4"), "words").unwrap();
    fs::write(at("bad/notes.txt"), "words").unwrap();
    let none = at("none");
    refused(&["corpus", path(&none), "-o", path(&at("o1"))], &at("o1"), &["none", "no such folder"]);
    refused(
        &["corpus", "fixtures/demo.avi", "-o", path(&at("o1"))],
        &at("o1"),
        &["a file", "`handcast run`"],
    );
    let pattern = at("bad/*.avi");
    refused(&["corpus", path(&pattern), "-o", path(&at("o1"))], &at("o1"), &["no such folder", "--match"]);
    fs::copy("fixtures/demo.avi", at("bad/clip.avi")).unwrap();
    for clips in [&pattern, &at("bad")] {
        refused(&["run", path(clips), "-o", path(&at("o1"))], &at("o1"), &["one clip", "`handcast corpus`"]);
    }
    fs::remove_file(at("bad/clip.avi")).unwrap();
    let out = handcast(&["corpus", path(&at("empty")), "-o", path(&at("o2"))]);
    assert_eq!(out.status.code(), Some(1));
    assert!(text(&out.stderr).contains("no clip and no motion file"), "{}", text(&out.stderr));
    let out = handcast(&["corpus", path(&at("bad")), "-o", path(&at("o3"))]);
    assert_eq!(out.status.code(), Some(1));
    assert!(text(&out.stderr).contains("none of 1 inputs"), "{}", text(&out.stderr));
    let out = handcast(&["corpus", path(&at("bad")), "-o", path(&at("o4")), "--mask", "masks"]);
    assert!(
        out.status.code() == Some(2) && text(&out.stderr).contains("of one clip"),
        "{}",
        text(&out.stderr)
    );
    for wrong in [&["--jobs", "0"][..], &["--only", "[x"]] {
        let out = handcast(&[&["corpus", path(&at("bad")), "-o", path(&at("o5"))], wrong].concat());
        assert_eq!(out.status.code(), Some(2), "{wrong:?}");
    }
    // A manifest that is none is not overwritten.
    fs::write(at("o3/manifest.jsonl"), "{\"name\":1}\n").unwrap();
    let out = handcast(&["corpus", path(&at("bad")), "-o", path(&at("o3"))]);
    assert!(text(&out.stderr).contains("manifest.jsonl: line 1"), "{}", text(&out.stderr));
    assert_eq!(fs::read(at("o3/manifest.jsonl")).unwrap(), b"{\"name\":1}\n");
}

#[test]
fn the_bench_tells_time_and_bytes() {
    let dir = tempfile::tempdir().unwrap();
    inputs(&dir.path().join("in"), 1);
    let said = done(&["bench", "corpus", path(&dir.path().join("in")), "--json"]);
    let cost: Value = serde_json::from_str(&said).unwrap();
    let of = |key: &str| cost[key].as_f64().unwrap();
    assert!(of("inputs") == 4.0 && of("failed") == 0.0, "{said}");
    assert!(of("stream_bytes") < of("pose_zstd_bytes") && of("pose_zstd_bytes") < of("pose_bytes"), "{said}");
    assert!(of("clips_per_hour") > 0.0, "{said}");
    // Other systems do not tell it.
    assert!(!cfg!(target_os = "linux") || of("cpu_seconds") > 0.0, "{said}");
}
