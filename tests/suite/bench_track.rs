//! `handcast bench track` from the command line, and the numbers it must reach.

use crate::common::command::program;
use crate::common::shared;
use serde_json::Value;

fn bench(args: &[&str]) -> std::process::Output {
    std::process::Command::new(program()).args(["bench", "track"]).args(args).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn the_comparison_comes_as_text_json_and_svg() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (json, svg) = (at("x.json"), at("x.svg"));
    let quick = [
        "--frames",
        "6",
        "--size",
        "160x120",
        "--sequences",
        "abduction,fist",
        "--optimisers",
        "simplex,powell,tree",
        "--objectives",
        "contour,non-overlap",
        "--evaluations",
        "120",
        "--seed",
        "4",
        "--random-hand",
        "--roughness",
        "1",
        "--details",
    ];
    let run = bench(&[&quick[..], &["--json", &json, "--svg", &svg]].concat());
    let out = text(&run.stdout);
    assert!(run.status.success(), "{}", text(&run.stderr));
    for words in ["Table 1", "63 (32)", "308 (18)", "default tracker", "index2_flexion"] {
        assert!(out.contains(words), "{words}: {out}");
    }
    let report: Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
    assert_eq!(report["sequences"], serde_json::json!(["abduction", "fist"]));
    let methods = report["methods"].as_array().unwrap();
    assert_eq!(methods.len(), 3 * 2 + 1);
    for method in methods {
        assert_eq!(method["results"].as_array().unwrap().len(), 2);
        assert_eq!(method["results"][1]["frames"], 6);
        assert_eq!(method["results"][1]["dofs"].as_array().unwrap().len(), 26);
        assert!(method["summary"]["evaluations"].as_f64().unwrap() > 20.0, "{}", method["name"]);
    }
    assert_eq!(report["descents"].as_array().unwrap().len(), 6 * 3);
    let picture = std::fs::read_to_string(&svg).unwrap();
    assert!(picture.starts_with("<svg ") && picture.ends_with("</svg>\n"));
    assert_eq!(picture.matches("<text ").count(), picture.matches("</text>").count());
}

#[test]
fn the_seed_decides_what_is_drawn_by_lot() {
    let table = |seed: &str| {
        let run = bench(&[
            "--frames",
            "3",
            "--size",
            "120x90",
            "--sequences",
            "fist",
            "--optimisers",
            "selection",
            "--objectives",
            "non-overlap",
            "--evaluations",
            "60",
            "--restarts",
            "0",
            "--no-default",
            "--seed",
            seed,
        ]);
        let out = text(&run.stdout);
        out.lines().filter(|l| l.contains(" / ")).map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(table("5"), table("5"));
    assert_ne!(table("5"), table("6"));
}

#[test]
fn measurements_alone_go_to_standard_output_where_that_is_asked_for() {
    let run =
        bench(&["--frames", "6", "--size", "160x120", "--sequences", "fist", "--no-methods", "--json", "-"]);
    assert!(run.status.success(), "{}", text(&run.stderr));
    let report: Value = serde_json::from_slice(&run.stdout).unwrap();
    assert_eq!(report["sequences"], serde_json::json!(["fist"]));
}

#[test]
fn wrong_requests_are_refused() {
    assert_eq!(bench(&["--optimisers", "newton"]).status.code(), Some(2));
    assert_eq!(bench(&["--sequences", "wave"]).status.code(), Some(2));
    for (code, args, words) in [
        (2, &["--frames", "0"][..], "--frames 0"),
        (2, &["--every", "0"], "--every 0"),
        (2, &["--spread", "nan"], "--spread"),
        (2, &["--size", "8x8"], "width is 8"),
        (1, &["none.mp4"], "none.mp4"),
    ] {
        let run = bench(args);
        assert_eq!(run.status.code(), Some(code), "{args:?}");
        assert!(text(&run.stderr).contains(words), "{args:?}: {}", text(&run.stderr));
    }
}

/// The constrained simplex on the non-overlap rate, the paper's five motions, 320×240, clean silhouettes.
#[test]
fn the_simplex_follows_the_five_motions_of_the_paper() {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("x.json").to_str().unwrap().to_owned();
    let run =
        bench(&["--optimisers", "simplex", "--objectives", "non-overlap", "--no-default", "--json", &json]);
    assert!(run.status.success(), "{}", text(&run.stderr));
    let report: Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
    let summary = &report["methods"][0]["summary"];
    assert!(summary["moving_deg"].as_f64().unwrap() <= 4.0, "{summary}");
    assert!(summary["moving_mm"].as_f64().unwrap() <= 2.0, "{summary}");
    assert_eq!(summary["lost"], 0);
    assert!(summary["restarts"].as_u64().unwrap() > 0, "{summary}");
}

#[test]
#[ignore = "needs the shared material"]
fn methods_run_on_a_real_clip() {
    let clip = shared("data/clips/finger-flexions.mp4");
    let run = bench(&[
        clip.to_str().unwrap(),
        "--frames",
        "24",
        "--optimisers",
        "simplex",
        "--objectives",
        "non-overlap",
        "--evaluations",
        "300",
    ]);
    let out = text(&run.stdout);
    assert!(run.status.success(), "{}", text(&run.stderr));
    assert!(out.contains("silhouettes: clips") && out.contains("mean IoU"), "{out}");
}

/// The beginning of the demo clip, as the file `demo.avi` of a folder, and how many frames it has.
fn beginning(folder: &std::path::Path) -> usize {
    use handcast_media::avi::MjpegWriter;
    const FRAMES: usize = 60;
    let demo = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/demo.avi");
    let mut source = handcast_media::open(demo, &Default::default()).unwrap();
    let size = (source.info().width, source.info().height);
    let file = std::fs::File::create(folder.join("demo.avi")).unwrap();
    let mut writer = MjpegWriter::new(file, size, (25, 1), 95).unwrap();
    for _ in 0..FRAMES {
        writer.write(&source.next_frame().unwrap().unwrap().image).unwrap();
    }
    writer.finish().unwrap();
    FRAMES
}

/// Frames of the demo clip, by their true poses: as a reference and as labels.
#[test]
fn clips_are_measured_against_what_is_known_of_them() {
    use handcast_formats::poses::read_poses;
    use handcast_hand::{HandPose, Joint, Skeleton, count_extended};
    use handcast_track::{HandModel, ModelState, PinholeCamera};

    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let fixtures = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures");
    let mut truth = read_poses(&fixtures.join("demo.poses.jsonl")).unwrap();
    truth.frames.truncate(beginning(folder.path()));
    let info = &truth.header.hands[0];
    let morphology = info.morphology.clone().unwrap();
    let clip = at("demo.avi");
    let clip = clip.as_str();
    let source = handcast_media::open(clip, &Default::default()).unwrap();
    let camera = PinholeCamera::with_field_of_view(source.info().width, source.info().height, 60.0);
    let model = HandModel::new(&morphology, info.side).with_camera(camera);
    let line = |time: f64, pose: &HandPose| {
        let frames = Skeleton::new(&morphology, info.side).frames(pose);
        let seen = model.joints(&ModelState::from_pose(pose, &camera));
        let points: Vec<_> =
            Joint::ALL.iter().map(|&j| <[f64; 3]>::from(frames.position(j).coords)).collect();
        serde_json::json!({ "t": time, "points": points, "image": seen })
    };
    let header = serde_json::json!({ "format": "landmarks25", "unit": "m", "hand": info.side });
    let mut reference = format!("{header}\n");
    let mut counts = String::from("# made from the true poses\n");
    for (i, frame) in truth.frames.iter().enumerate() {
        reference += &format!("{}\n", line(frame.time, &frame.pose));
        counts += &format!("{i} {}\n", count_extended(&frame.pose));
    }
    let (marks, labels, json) = (at("x.landmarks.jsonl"), at("x.counts"), at("x.json"));
    std::fs::write(&marks, &reference).unwrap();
    std::fs::write(&labels, &counts).unwrap();
    let known = ["--reference", &marks, "--counts", &labels];
    let run = bench(&[&[clip, "--no-methods", "--json", &json], &known[..]].concat());
    let out = text(&run.stdout);
    assert!(run.status.success(), "{}", text(&run.stderr));
    for words in ["handcast track, demo", "the reference itself, demo", "fingertips that stand out"] {
        assert!(out.contains(words), "{words}: {out}");
    }
    let report: Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
    assert_eq!(report["reference_counts"][0]["share"], 1.0);
    let rows = report["methods"].as_array().unwrap();
    assert_eq!(rows.iter().map(|r| &r["name"]).collect::<Vec<_>>(), ["default tracker", "handcast track"]);
    let track = &rows[1]["known"][0];
    assert_eq!(track["reference"]["frames"].as_u64().unwrap() as usize, truth.frames.len());
    assert_eq!(track["counts"]["frames"].as_u64().unwrap() as usize, truth.frames.len());
    // The demo is easy, and the reference exact.
    assert!(track["reference"]["tips"]["median"].as_f64().unwrap() < 5.0, "{out}");
    assert!(track["counts"]["share"].as_f64().unwrap() > 0.6, "{out}");

    // Both belong to the whole clip.
    std::fs::write(&labels, "5-100000 3\n").unwrap();
    let run = bench(&[&[clip, "--no-methods"], &known[..]].concat());
    assert_eq!(run.status.code(), Some(1));
    assert!(text(&run.stderr).contains("frames 5-100000: the clip has"), "{}", text(&run.stderr));
    let (short, _) = reference.trim_end().rsplit_once('\n').unwrap();
    std::fs::write(&marks, short).unwrap();
    let run = bench(&[&[clip, "--no-methods"], &known[..2]].concat());
    assert_eq!(run.status.code(), Some(1));
    assert!(text(&run.stderr).contains("frames, the clip has"), "{}", text(&run.stderr));
    std::fs::write(&marks, reference.replace("\"image\"", "\"picture\"")).unwrap();
    let run = bench(&[&[clip, "--no-methods"], &known[..2]].concat());
    assert!(text(&run.stderr).contains("no frame has `image`"), "{}", text(&run.stderr));
}

/// What the default tracker is sure of is right more often.
#[test]
fn errors_fall_with_confidence_and_cost_grows_with_pixels() {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("x.json").to_str().unwrap().to_owned();
    let quick =
        ["--optimisers", "simplex", "--objectives", "contour", "--evaluations", "1", "--freedom", "2"];
    let what = ["--silhouettes", "mesh", "--sequences", "flex-middle,fist,signs", "--frames", "24"];
    let run = bench(&[&quick[..], &what, &["--restarts", "0", "--json", &json]].concat());
    assert!(run.status.success(), "{}", text(&run.stderr));
    assert!(text(&run.stdout).contains("surest third"));
    let report: Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
    let off = |k: usize| report["confidence"][k]["angle_deg"].as_f64().unwrap();
    assert_eq!(report["confidence"][0]["frames"], 24);
    assert!(off(0) > 1.5 * off(2), "{}", report["confidence"]);

    let run = bench(&["--scaling", "--frames", "3", "--json", &json]);
    assert!(run.status.success(), "{}", text(&run.stderr));
    let costs: Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
    let ms = |k: usize| costs[k]["segment_ms"].as_f64().unwrap();
    assert_eq!(costs.as_array().unwrap().len(), 4);
    // 64 times the pixels; the bounds are wide, as machines are busy.
    assert!(ms(3) > 4.0 * ms(0) && ms(3) < 400.0 * ms(0), "{costs}");
}

#[test]
fn frames_left_out_are_not_tracked() {
    let folder = tempfile::tempdir().unwrap();
    let json = folder.path().join("x.json").to_str().unwrap().to_owned();
    let what = ["--no-methods", "--sequences", "translation", "--frames", "25", "--size", "160x120"];
    let run = bench(&[&what[..], &["--every", "4", "--json", &json]].concat());
    assert!(run.status.success(), "{}", text(&run.stderr));
    let report: Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
    assert_eq!(report["frames"], serde_json::json!([7]));
    assert_eq!(report["methods"][0]["results"][0]["frames"], 7);
}
