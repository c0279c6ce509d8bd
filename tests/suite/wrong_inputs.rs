//! Files and options that are wrong: every subcommand says what is wrong with which, and leaves everything as it was.

// Devices and links are tried on Unix alone.
#![cfg_attr(not(unix), allow(dead_code, unused_imports))]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

use crate::common::command::{path, program, text};
use crate::common::files::Files;

/// A folder with a good file of every kind, and a damaged or empty one of each.
struct Folder(tempfile::TempDir);

const KINDS: [&str; 6] = ["fba", "glb", "bap", "jsonl", "csv", "bvh"];

impl Folder {
    fn new() -> Self {
        static MADE: OnceLock<Files> = OnceLock::new();
        let folder = Self(tempfile::tempdir().unwrap());
        MADE.get_or_init(|| Files::made(Self::fill)).put(folder.0.path());
        for name in ["folder", "folder.jsonl", "folder.avi", "folder.html"] {
            std::fs::create_dir(folder.at(name)).unwrap();
        }
        folder
    }

    fn fill(folder: &Path) {
        let done = |line: &str| {
            let out = run_in(folder, line);
            assert!(out.status.success(), "{line}: {}", text(&out.stderr));
        };
        done("spell HI -o good.jsonl");
        done("encode good.jsonl -o good.fba");
        for kind in KINDS.iter().filter(|kind| !["fba", "jsonl"].contains(kind)) {
            done(&format!("decode good.fba -o good.{kind}"));
        }
        let write = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).unwrap();
        for kind in KINDS {
            let good = std::fs::read(folder.join(format!("good.{kind}"))).unwrap();
            write(&format!("cut.{kind}"), &good[..good.len() / 2]);
            write(&format!("empty.{kind}"), b"");
            write(&format!("words.{kind}"), b"these are words\n");
        }
        let clip = std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/demo.avi")).unwrap();
        write("clip.avi", &clip);
        write("start.avi", &clip[..4000]);
        write("empty.mp4", b"");
        write("words.mp4", b"these are words\n");
        write("words.counts", b"0-5 1\n# more\n4-8 2\n");
        write("other.json", b"{\"a\": 1, \"b\": [2]}\n");
        write("list.json", b"[1, 2]\n");
        let good = std::fs::read(folder.join("good.jsonl")).unwrap();
        let header = good.split_inclusive(|byte| *byte == b'\n').next().unwrap();
        write("none-seen.jsonl", header);
        write("words.toml", b"these are words\n");
        write("few.toml", b"# no shape\n");
        done("decode good.fba -o units.landmarks.jsonl");
        let points = std::fs::read_to_string(folder.join("units.landmarks.jsonl")).unwrap();
        write("units.landmarks.jsonl", points.replace("\"unit\":\"m\"", "\"unit\":\"mm\"").as_bytes());
        write("bare.jsonl", &[header, b"{\"t\":0,\"hand\":\"right\",\"Wrist\":{}}\n"].concat());
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn run(&self, line: &str) -> Output {
        run_in(self.0.path(), line)
    }

    /// All files, hidden ones too, and what is in them.
    fn state(&self) -> BTreeMap<String, Vec<u8>> {
        let entries = std::fs::read_dir(self.0.path()).unwrap().map(Result::unwrap);
        let name = |entry: &std::fs::DirEntry| entry.file_name().to_string_lossy().into_owned();
        entries.map(|e| (name(&e), std::fs::read(e.path()).unwrap_or_default())).collect()
    }
}

fn run_in(folder: &Path, line: &str) -> Output {
    Command::new(program()).current_dir(folder).args(line.split_whitespace()).output().unwrap()
}

/// Makes sure that each line fails with exit code 1, says its words, and changes nothing.
fn refused(lines: impl IntoIterator<Item = (String, String)>) {
    failed(1, lines);
}

fn failed(code: i32, lines: impl IntoIterator<Item = (String, String)>) {
    let folder = Folder::new();
    let before = folder.state();
    for (line, words) in lines {
        let out = folder.run(&line);
        let message = text(&out.stderr);
        println!("{line}\n    {message}");
        assert_eq!(out.status.code(), Some(code), "{line}: {message}");
        assert!(message.starts_with("handcast: ") && message.lines().count() == 1, "{line}: {message}");
        assert!(message.contains(&words), "{line} should say {words:?}: {message}");
        let parts: Vec<&str> = message.trim_end().split(": ").collect();
        assert!(parts.windows(2).all(|pair| pair[0] != pair[1]), "{line} says it twice: {message}");
        assert!(folder.state() == before, "{line} has changed or left something");
    }
}

#[test]
fn wrong_inputs_are_named_by_every_reader() {
    let mut lines = Vec::new();
    let mut add = |line: String, words: &str| lines.push((line, words.to_owned()));
    // What is wrong with the file, by its kind.
    for kind in KINDS {
        for (state, words) in
            [("none", "os error 2"), ("empty", "the file is empty"), ("words", ""), ("cut", "")]
        {
            let file = format!("{state}.{kind}");
            for line in [
                format!("view {file} -o x.html"),
                format!("render {file} -o x.png"),
                format!("compare {file} good.jsonl"),
                format!("compare good.jsonl {file}"),
                format!("fidelity {file} -o x.json"),
            ] {
                add(line.clone(), &file);
                add(line, words);
            }
            add(format!("import {file} -o x.jsonl"), &file);
            match kind {
                "fba" => {
                    add(format!("decode {file} -o x.glb"), &file);
                    add(format!("decode {file} -o x.glb"), words);
                    add(format!("inspect {file}"), words);
                }
                _ => add(format!("encode {file} -o x.fba"), &file),
            }
        }
    }
    for command in ["view words.glb -o x.html", "encode words.glb -o x.fba", "import words.glb -o x.jsonl"] {
        add(command.to_owned(), "no glTF: the file starts with");
    }
    for (file, words) in [
        ("none.mp4", "none.mp4: no such file or folder"),
        ("folder", "folder: the folder holds no picture"),
        ("empty.mp4", "empty.mp4: the file is empty"),
        ("words.mp4", "words.mp4: not a video or a picture (it is text)"),
        ("words.jsonl", "words.jsonl: not a video or a picture (it is text)"),
        // Cut within the first picture.
        ("start.avi", "start.avi: truncated"),
    ] {
        add(format!("track {file} -o x.jsonl --overlay x.avi"), words);
        add(format!("run {file} -o x"), words);
        add(format!("track {file} -o x.jsonl"), words);
        add(format!("bench track {file}"), words);
        add(format!("view good.jsonl -o x.html --clip {file}"), words);
        if file != "words.jsonl" {
            add(format!("fidelity {file} -o x.html"), words);
        }
        if file != "start.avi" {
            add(format!("fit {file} -o x.toml"), words);
        }
    }
    for reader in
        ["decode folder -o x.glb", "inspect folder", "encode folder -o x.fba", "import folder -o x.jsonl"]
    {
        add(reader.to_owned(), "folder");
    }
    refused(lines);
}

#[test]
fn inputs_are_never_overwritten() {
    let overwrites = [
        ("encode good.jsonl -o good.jsonl", "would overwrite the input good.jsonl"),
        ("encode good.jsonl -o folder/../good.jsonl", "would overwrite the input good.jsonl"),
        ("encode good.bap -o words.fba --epf words.fba", "would overwrite the input words.fba"),
        ("encode good.glb -o good.glb", "would overwrite the input good.glb"),
        ("decode good.fba -o good.fba --to bap", "would overwrite the input good.fba"),
        ("import good.jsonl -o good.jsonl", "would overwrite the input good.jsonl"),
        ("view good.jsonl -o good.jsonl", "would overwrite the input good.jsonl"),
        ("render good.jsonl -o good.jsonl", "would overwrite the input good.jsonl"),
        ("fidelity good.jsonl -o good.jsonl", "would overwrite the input good.jsonl"),
        ("track clip.avi -o x.jsonl --overlay clip.avi", "would overwrite the input clip.avi"),
        ("track clip.avi -o x.avi --overlay x.avi", "two outputs of one name"),
        ("run hand.fba -o .", "hand.fba would overwrite the input hand.fba"),
        ("bench track clip.avi --json clip.avi", "would overwrite the input clip.avi"),
    ];
    refused(overwrites.map(|(line, words)| (line.to_owned(), words.to_owned())));
}

#[test]
fn outputs_that_cannot_be_are_named() {
    let missing = [
        "encode good.jsonl -o none/x.fba",
        "decode good.fba -o none/x.glb",
        "view good.jsonl -o none/x.html",
        "render good.jsonl -o none/x.png",
        "fidelity good.jsonl --no-curve --no-symmetry -o none/x.json",
        "pose asl:A -o none/x.glb",
        "spell HI -o none/x.glb",
        "synth --frames 2 --size 64x48 -o none/x.avi",
    ];
    let kinds = [
        ("decode good.fba -o x.xyz", "x.xyz: cannot write this kind, allowed are .glb"),
        ("decode good.fba -o x", "x: cannot write this kind, allowed are .glb"),
        ("render good.jsonl -o folder", "allowed are .png, .gif, .webp, .mp4"),
        ("track clip.avi -o x.xyz", "x.xyz: cannot write this kind"),
        ("fidelity good.jsonl -o x.txt", "allowed are .html and .json"),
        ("synth -o x.xyz", "give FILE.avi, or a folder"),
    ];
    let missing = missing.map(|line| (line.to_owned(), "none/x.".to_owned()));
    let folders = [
        ("encode good.jsonl -o folder", "folder: the output path is a directory"),
        // Before the work, of which nothing is left.
        ("track clip.avi --no-net -o folder.jsonl", "folder.jsonl: the output path is a directory"),
        (
            "track clip.avi --no-net -o x.jsonl --overlay folder.avi/",
            "folder.avi/: the output path is a directory",
        ),
        ("fidelity good.jsonl -o folder.html", "folder.html: the output path is a directory"),
    ];
    let owned = |(line, words): (&str, &str)| (line.to_owned(), words.to_owned());
    refused(missing.into_iter().chain(folders.map(owned)));
    failed(2, kinds.map(owned));
}

#[test]
fn what_to_do_instead_is_told() {
    let owned = |(line, words): (&str, &str)| (line.to_owned(), words.to_owned());
    let track = "`handcast track` makes poses";
    let clips = [
        "import clip.avi -o x.jsonl",
        "encode clip.avi -o x.fba",
        "decode clip.avi -o x.glb",
        "render clip.avi -o x.png",
        "send clip.avi --vmc 127.0.0.1:9",
        "compare good.fba clip.avi",
        "view clip.avi -o x.html",
    ];
    let conceal = "; --conceal goes on behind damage";
    let elsewhere = "; `handcast decode --conceal` makes poses of what is whole";
    let ways = [
        ("decode cut.fba -o x.glb", conceal),
        ("view cut.fba -o x.html", conceal),
        ("encode cut.fba -o x.fba", elsewhere),
        ("compare cut.fba good.fba", conceal),
        ("import none-seen.jsonl -o x.glb", "none-seen.jsonl: there is no pose of a hand in it"),
        ("import none-seen.jsonl -o x.csv", "none-seen.jsonl: there is no pose of a hand in it"),
        ("encode none-seen.jsonl -o x.fba", "none-seen.jsonl: there is no pose of a hand in it"),
        ("encode none-seen.jsonl --live -o -", "none-seen.jsonl: there is no pose of a hand in it"),
        ("render none-seen.jsonl -o x.png", "none-seen.jsonl: there is no pose of a hand in it"),
        ("send none-seen.jsonl --vmc 127.0.0.1:9", "none-seen.jsonl: there is no pose of a hand in it"),
        ("import units.landmarks.jsonl -o x.jsonl", "numbers look like metres"),
        (
            "encode units.landmarks.jsonl -o x.fba",
            "; `handcast import --hand-length-mm 190` brings a file of any unit",
        ),
        ("encode bare.jsonl -o x.fba", "line 2: missing field `wrist`"),
        ("compare good.fba none-seen.jsonl", "none-seen.jsonl: there is no pose of a hand in it"),
    ];
    refused(clips.map(|line| (line.to_owned(), track.to_owned())).into_iter().chain(ways.map(owned)));
    let misused = [
        (
            "encode good.jsonl -o x_hand.fbx",
            "x_hand.fbx: a stream is no .fbx file, allowed are .fba, .mp4 and -",
        ),
        ("view good.jsonl -o x.txt", "x.txt: a page is no .txt file, allowed are .html and -"),
        ("import good.jsonl -o x.fba", "; `handcast encode` writes streams"),
        (
            "decode good.fba -o x.mp4",
            "; `handcast render` draws films, `handcast encode` writes streams in MP4",
        ),
        (
            "bench live --chromium none --script none.js",
            "none.js: no such script; --script names tests/node/live.js",
        ),
    ];
    failed(2, misused.map(owned));
    let out = run_in(Folder::new().0.path(), "bench labels good.jsonl");
    assert_eq!(out.status.code(), Some(2));
    assert!(text(&out.stderr).contains("<--counts <FILE>|--letters <FILE>>"), "{}", text(&out.stderr));
}

#[test]
fn odd_options_are_refused_with_what_is_allowed() {
    let values = [
        ("decode good.fba -o x.glb --only left", "there is no left hand"),
        ("decode good.fba -o x.bap --only left", "there is no left hand"),
        ("decode good.fba -o x.glb --mesh words.glb", "words.glb"),
        ("decode good.fba -o x.glb --person none.toml", "none.toml"),
        ("fidelity --truth words.jsonl", "words.jsonl: poses: line 1: not JSON"),
        ("track clip.avi -o x.jsonl --mask none", "none: no such file"),
        ("track clip.avi -o x.jsonl --person words.toml", "words.toml"),
        ("pose asl:A -o x.glb --shapes few.toml", "handcast pose --list --shapes few.toml tells all names"),
        ("decode good.jsonl -o x.glb", "good.jsonl: no stream, but poses, which encode and import take"),
        ("decode good.glb -o x.jsonl", "good.glb: no stream, but "),
        ("decode good.bap -o - --to jsonl", "good.bap: no stream, but "),
        ("inspect good.bvh", "good.bvh: no stream, but "),
        (
            "bench track clip.avi --counts words.jsonl",
            "words.jsonl: line 1: \"these are words\", expected FIRST-LAST",
        ),
        ("bench track clip.avi --counts words.counts", "words.counts: line 3: begins at frame 4"),
        ("bench track clip.avi --reference words.jsonl", "words.jsonl: line 1: not JSON"),
        ("bench codec folder", "folder"),
        (
            "import other.json -o x.jsonl",
            "other.json: JSON with the names \"a\", \"b\" is none of the formats that are read; tried were",
        ),
        (
            "import list.json -o x.jsonl",
            "list.json: JSON with no names in it, is none of the formats that are read",
        ),
        (
            "encode other.json -o x.fba",
            "other.json: JSON with the names \"a\", \"b\" is none of the formats that are read; tried were poses",
        ),
        ("encode list.json -o x.fba", "list.json: JSON with no names in it, is none of the formats"),
        ("encode good.bap --epf empty.bap -o x.fba", "empty.bap: epf: no frame: the first tag must be FBM"),
        ("decode good.fba -o x.glb --max-seconds 0.5", "allowed at most 0.5; --max-seconds raises that"),
    ];
    let owned = |(line, words): (&str, &str)| (line.to_owned(), words.to_owned());
    refused(values.map(owned));
}

#[test]
fn masks_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let run = |line: &str| {
        let out = run_in(folder.path(), line);
        println!("{line}\n    {}", text(&out.stderr));
        (out.status.code(), text(&out.stderr).to_owned())
    };
    for more in ["x.avi --masks m", "shots"] {
        assert_eq!(run(&format!("synth -o {more} --frames 12 --size 240x180 -q")).0, Some(0));
    }
    let mask = |number: usize| folder.path().join(format!("m/{number:05}.png"));
    std::fs::copy(mask(11), mask(12)).unwrap();
    let (code, told) = run("track x.avi --mask m -o x.jsonl -q");
    assert_eq!(code, Some(0));
    assert!(told.contains("m: 13 masks for the 12 frames of x.avi: 1 are not used"), "{told}");
    for number in [11, 12] {
        std::fs::remove_file(mask(number)).unwrap();
    }
    assert_eq!(run("synth -o half.avi --masks h --frames 12 --size 120x90 -q").0, Some(0));
    let (code, said) = run("track x.avi --mask h -o y.jsonl -q");
    assert_eq!(code, Some(1));
    assert!(said.contains("; a mask is as wide and as high as its frame, in pixels"), "{said}");
    // Of AVI files the pictures are counted, whatever their headers tell.
    let told = "m: 11 masks for the 12 frames of";
    for clip in ["x.avi", "shots"] {
        let (code, said) = run(&format!("track {clip} --mask m -o y.jsonl -q"));
        assert_eq!(code, Some(1));
        assert!(said.contains(&format!("{told} {clip}")) && said.lines().count() == 1, "{said}");
    }
}

#[test]
fn clips_without_a_hand_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let grey = image::RgbImage::from_pixel(64, 48, image::Rgb([90, 90, 90]));
    for number in 0..3 {
        std::fs::create_dir_all(folder.path().join("grey")).unwrap();
        grey.save(folder.path().join(format!("grey/{number}.png"))).unwrap();
    }
    let out = run_in(folder.path(), "track grey --no-net -o x.jsonl -q");
    let told = text(&out.stderr);
    assert_eq!(out.status.code(), Some(1), "{told}");
    assert!(told.starts_with("handcast: grey: ") && told.matches("grey").count() == 1, "{told}");
}

#[test]
fn wrong_usage_is_told_apart() {
    let owned = |(line, words): (&str, &str)| (line.to_owned(), words.to_owned());
    let misused = [
        ("synth -o x.avi --frames 0", "allowed 1 to 100000"),
        ("synth -o x.avi --turn 1e30", "allowed -720 to 720"),
        ("encode good.jsonl -o x.glb", "x.glb: a stream is no animated hand (glTF) file"),
        ("encode good.jsonl -o x.landmarks.jsonl", "allowed are .fba, .mp4 and -"),
        ("fidelity good.jsonl --truth good.jsonl", "--truth goes with clips"),
        ("synth -o - --frames 2", "not written to standard output"),
        ("bench track clip.avi --counts none --counts none", "--counts is given 2 times for 1 clips"),
        ("encode good.jsonl -o x.fba --epf words.fba", "--epf goes with a .bap file"),
        ("encode good.jsonl -o x.fba --clip clip.avi", "in an .mp4 alone"),
        ("track clip.avi -o - --resume", "--resume goes on from a file"),
        (
            "track clip.avi -o x.jsonl --person words.jsonl",
            "words.jsonl: the name must end in .toml or .json",
        ),
        // What could not be written is said before what cannot be read.
        ("fit none.jpg -o x.glb", "x.glb: the name must end in .toml or .json"),
        ("import none.jsonl -o x.jsonl --save-person x.glb", "x.glb: the name must end in .toml or .json"),
        ("view none.fba -o x.vrma", "x.vrma: a page is no"),
        ("view none.fba -o x.png", "x.png: a page is no picture file, allowed are .html and -"),
        ("encode good.jsonl -o x.mkv", "x.mkv: a stream is no film file, allowed are .fba, .mp4 and -"),
        ("run clip.avi -o x.glb", "x.glb: a folder is written"),
        ("run clip.avi -o -", "-: a folder is written"),
        ("track clip.avi -o x.csv --hand left --only right", "--hand left tracks no other hand"),
        ("encode none.jsonl -o x.html", "x.html: a stream is no page file, allowed are .fba, .mp4 and -"),
        ("send none.fba --vmc localhost:70000", "--vmc: \"localhost:70000\" is no receiver: the port is not"),
        ("live clip.avi --vmc :39539", "--vmc: \":39539\" is no receiver: there is no host"),
        ("spell H! -o x.glb", "'!' cannot be spelled, allowed A to Z"),
        ("pose nothing -o x.glb", "no shape is called \"nothing\"; handcast pose --list tells all names"),
    ];
    failed(2, misused.map(owned));
}

/// Options that change nothing are told of, with the reason; those that change something are not.
#[test]
fn idle_options_are_told_of() {
    let folder = Folder::new();
    for (line, told) in [
        (
            "fidelity good.jsonl --no-curve --view back --fov 40 -q",
            "good.jsonl is no clip: --view, --fov change nothing",
        ),
        (
            "encode good.bap -o x.fba --profile arm",
            "good.bap has its values in BAPs of its own: --profile changes nothing",
        ),
        (
            "encode good.jsonl -o x.mp4 --no-resync",
            "a start code at each I plane: --no-resync changes nothing",
        ),
        ("decode good.fba -o x.bap --profile arm", "--profile changes nothing"),
        ("decode good.fba -o x.csv --profile arm", "its masks carry the wrist as --profile hand has it"),
        ("render good.jsonl -o x.png --steps standard", "good.jsonl is no stream: --steps changes nothing"),
        ("render good.fba -o x.png --steps standard", ""),
        ("encode good.jsonl -o x.fba --profile arm", ""),
        ("import good.jsonl -o x.csv --input-fps 20", "--input-fps changes nothing"),
        ("pose A -o x.jsonl --size 99x99", "--size changes nothing"),
    ] {
        let out = folder.run(line);
        let message = text(&out.stderr);
        assert_eq!(out.status.code(), Some(0), "{line}: {message}");
        assert!(message.contains(told), "{line} should say {told:?}: {message}");
        assert!(!told.is_empty() || !message.contains("nothing"), "{line}: {message}");
    }
}

#[test]
fn values_that_no_option_takes_are_wrong_usage() {
    let folder = Folder::new();
    let before = folder.state();
    for line in [
        "",
        "nonsense",
        "encode good.jsonl",
        "encode good.jsonl -o x.fba --quant 32",
        "encode good.jsonl -o x.fba --target-rms 0",
        "encode good.jsonl -o x.fba --target-rms nan",
        "encode good.jsonl -o x.fba --max-error 0",
        "encode good.jsonl -o x.fba --max-error=-3mm",
        "encode good.jsonl -o x.fba --max-error 0.001",
        "encode good.jsonl -o x.fba --max-error 0.1 --live",
        "encode good.jsonl -o x.fba --max-error 1e9",
        "encode good.jsonl -o x.fba --max-error 0.6mm",
        "live clip.avi --room a/b",
        "live clip.avi --room=",
        "encode good.jsonl -o x.fba --bitrate inf",
        "encode good.jsonl -o x.fba --intra nan",
        "view good.jsonl -o x.html --clip clip.avi --clip-rate 0",
        "spell   -o x.glb",
        "encode good.jsonl -o x.fba --quant 3 --bitrate 2",
        "decode good.fba -o x.glb --fps 1e9",
        "decode good.fba -o x.glb --tolerance nan",
        "render good.jsonl -o x.png --frames 100000000",
        "render good.jsonl -o x.png --size 0x0",
        "render good.jsonl -o x.png --size 4097x10",
        "synth -o x.avi --turn 1e30",
        "synth -o x.avi --turn nan",
        "synth -o x.avi --aside inf",
        "import good.jsonl -o x.jsonl --max-gap nan",
        "import good.jsonl -o x.jsonl --max-gap=-1",
        "import good.jsonl -o x.jsonl --max-gap 1e30",
        "view good.jsonl -o x.html --max-seconds nan",
        "fidelity good.jsonl -o x.json --loss 5% --burst nan",
        "fidelity good.jsonl -o x.json --loss 5% --seeds 0",
        "fidelity good.jsonl -o x.html --loss 5%",
        "compare - -",
        "fit clip.avi -o x.toml --hand-length-mm 49",
        "fit clip.avi -o x.toml --hand-length-mm 1e30",
        "run clip.avi -o x --hand-length-mm nan",
        "demo -o x --hand-length-mm 401",
        "corpus folder -o x --hand-length-mm 0",
        "corpus folder -o x --mask folder",
        "live clip.avi --hand-length-mm inf",
        "fidelity clip.avi --hand-length-mm 1",
        "import good.jsonl -o x.jsonl --hand-length-mm 20",
        "render good.jsonl -o x.png --at nan",
        "compare good.jsonl",
        "compare good.jsonl good.fba --tolerance nan",
        "track clip.avi -o x.jsonl --fps 0",
        "track clip.avi -o x.jsonl --smooth=0,0",
        "track clip.avi -o x.jsonl --hand-length-mm 1",
        "track clip.avi -o x.jsonl --fov 200",
        "spell HI -o x.glb --speed 0",
        "import good.jsonl -o x.jsonl --hand-length-mm nan",
        "bench track --reference good.jsonl",
        "bench track clip.avi --no-methods --no-default",
    ] {
        let out = folder.run(line);
        assert_eq!(out.status.code(), Some(2), "{line}: {}", text(&out.stderr));
        assert!(folder.state() == before, "{line} has changed or left something");
    }
}

/// A copy of the program in the folder, and who runs it: somebody who may not do everything.
#[cfg(unix)]
fn bound_by_permissions(folder: &Folder, everything: bool) -> Command {
    use std::os::unix::fs::PermissionsExt as _;
    use std::os::unix::process::CommandExt as _;
    let copy = folder.at("handcast");
    if !copy.exists() {
        // Not by this process: what other tests start meanwhile would have it open to be written, too, so that it would
        // not start.
        assert!(Command::new("cp").arg(program()).arg(&copy).status().unwrap().success());
    }
    let mut command = Command::new(&copy);
    command.current_dir(folder.0.path()).env("HANDCAST_NET", "none");
    if everything {
        // Another user, who has to come as far as the files.
        std::fs::set_permissions(folder.0.path(), std::fs::Permissions::from_mode(0o755)).unwrap();
        command.uid(65_534);
    }
    command
}

#[test]
#[cfg(unix)]
fn a_folder_that_cannot_be_written_is_named_before_the_work() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = Folder::new();
    let kept = folder.at("folder");
    std::fs::set_permissions(&kept, std::fs::Permissions::from_mode(0o555)).unwrap();
    let everything = std::fs::File::create(kept.join("x")).is_ok();
    let _ = std::fs::remove_file(kept.join("x"));
    for line in [
        "run none.avi -o folder",
        "demo -o folder",
        "corpus none -o folder",
        "fit none.jpg -o /dev/null --debug folder",
        "fit none.jpg -o /dev/null --debug folder/stages",
        "synth --frames 100000 -o folder",
        "synth --frames 100000 -o folder/clip",
        "man -o folder",
    ] {
        let mut command = bound_by_permissions(&folder, everything);
        let out = command.args(line.split_whitespace()).output().unwrap();
        let message = text(&out.stderr);
        assert_eq!(out.status.code(), Some(1), "{line}: {message}");
        assert!(message.contains("cannot write: folder/") && message.contains("denied"), "{line}: {message}");
    }
    assert_eq!(std::fs::read_dir(&kept).unwrap().count(), 0);
    std::fs::set_permissions(&kept, std::fs::Permissions::from_mode(0o755)).unwrap();
}

#[test]
#[cfg(unix)]
fn an_unreadable_input_is_named() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = Folder::new();
    let file = folder.at("good.fba");
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o000)).unwrap();
    let everything = std::fs::File::open(&file).is_ok();
    for line in [["inspect", path(&file)], ["fidelity", path(&file)]] {
        let out = bound_by_permissions(&folder, everything).args(line).output().unwrap();
        assert_eq!(out.status.code(), Some(1));
        assert!(text(&out.stderr).contains("good.fba: Permission denied"), "{}", text(&out.stderr));
    }
}
