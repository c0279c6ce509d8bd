//! The pages of `handcast view` in headless Chromium, and the server that hands them out.

use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::common::command::{done, handcast, misused, path, refused, text};
use crate::common::glb::{chromium, motion, node};
use crate::common::shared;
use handcast_formats::poses::{read_poses, write_poses};
use handcast_hand::{
    ClipHand, HandMesh, HandPose, Morphology, PoseClip, PoseHeader, Side, Skeleton, SkinnedSurface,
    TimedPose, linear_from_srgb, skin_tone,
};
use handcast_media::film::{FilmWriter, TICKS};
use handcast_render::{Camera, Projection, Raster, hand_surface};
use image::{Rgb, RgbImage};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde_json::{Value, json};

const FRAMES: usize = 50;
const RATE: f64 = 25.0;

/// Poses of one hand or two side by side, before the camera.
fn poses(folder: &Path, sides: &[Side]) -> (PathBuf, PoseClip) {
    let mut header = PoseHeader { rate: Some(RATE), ..PoseHeader::default() };
    header.hands = sides.iter().map(|&side| ClipHand { side, morphology: None }).collect();
    let place = |t: f64, mut pose: HandPose| {
        let x = match (sides.len(), pose.side) {
            (1, _) => 0.0,
            (_, Side::Left) => -0.13,
            (_, Side::Right) => 0.13,
        };
        pose.translation = Vector3::new(x + 0.02 * t.sin(), -0.08, -0.7);
        pose.rotation = UnitQuaternion::from_euler_angles(0.1, 0.4 * t.sin(), 0.2 * t);
        TimedPose::new(t, pose)
    };
    let frames = sides.iter().flat_map(|&s| motion(s, FRAMES)).map(|(t, pose)| place(t, pose)).collect();
    let file = folder.join(format!("poses{}.jsonl", sides.len()));
    write_poses(&file, &PoseClip { header, frames }).unwrap();
    let clip = read_poses(&file).unwrap();
    (file, clip)
}

/// What the page's camera sees of a clip, drawn by the program.
fn silhouette(clip: &PoseClip, instant: usize, camera: &Value) -> Vec<bool> {
    let number = |v: &Value| v.as_f64().unwrap();
    let vector = |v: &Value| Vector3::from_iterator(v.as_array().unwrap().iter().map(number));
    let (width, height) = (number(&camera["width"]), number(&camera["height"]));
    let axes: Vec<_> = camera["axes"].as_array().unwrap().iter().map(vector).collect();
    let to_world = Rotation3::from_matrix(&Matrix3::from_columns(&axes));
    let view = Isometry3::from_parts(
        Translation3::from(vector(&camera["eye"])),
        UnitQuaternion::from_rotation_matrix(&to_world),
    )
    .inverse();
    let projection = Projection::Perspective { focal: number(&camera["focal"]) };
    let camera = Camera { view, projection, centre: [width / 2.0, height / 2.0] };
    let mut raster = Raster::new(width as u32, height as u32, 3);
    for hand in &clip.header.hands {
        let pose = &clip.of(hand.side).nth(instant).unwrap().pose;
        let mesh = HandMesh::generate(&Morphology::default(), hand.side).refined();
        let mut skinned = SkinnedSurface::default();
        mesh.skin(&Skeleton::new(&Morphology::default(), hand.side).frames(pose), &mut skinned);
        raster.draw(&hand_surface(&mesh, &skinned), &camera);
    }
    raster.coverage(1).into_iter().map(|c| c >= 128).collect()
}

/// Intersection over union of the page's picture and the program's.
fn overlap(picture: &Path, own: &[bool]) -> f64 {
    let theirs = image::open(picture).unwrap().to_rgba8();
    let shown: Vec<bool> = theirs.pixels().map(|p| p.0[3] >= 128).collect();
    assert_eq!(shown.len(), own.len());
    let count = |both: fn(bool, bool) -> bool| shown.iter().zip(own).filter(|(a, b)| both(**a, **b)).count();
    assert!(count(|_, b| b) > 5000, "the hand is too small to compare");
    count(|a, b| a && b) as f64 / count(|a, b| a || b) as f64
}

/// Runs jobs, and makes sure that pages neither complain nor ask for anything.
fn browse(folder: &Path, jobs: &[Value]) -> Vec<Vec<Value>> {
    let chromium = chromium();
    let list = folder.join("jobs.json");
    std::fs::write(&list, serde_json::to_vec(jobs).unwrap()).unwrap();
    let output = node("view.js", &[&chromium, &list]);
    let printed = text(&output.stdout);
    assert!(output.status.success(), "{printed}{}", text(&output.stderr));
    let lines: Vec<Value> = printed.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(lines.len(), jobs.len());
    let steps = lines.into_iter().zip(jobs).map(|(line, job)| {
        assert_eq!(line["messages"], json!([]), "{job}");
        assert_eq!(line["requests"], 1, "only the page itself is loaded: {job}");
        line["steps"].as_array().unwrap().clone()
    });
    steps.collect()
}

/// Where screenshots go to be looked at, if anybody wants them.
fn shots() -> Option<PathBuf> {
    std::env::var_os("HANDCAST_TEST_PICTURES").map(PathBuf::from)
}

fn shot(name: &str) -> Value {
    shots().map_or(json!({}), |folder| json!({ "shot": folder.join(name) }))
}

/// Pages of two hands as a stream and as GLB, and of one hand beside its clip.
struct Pages {
    folder: tempfile::TempDir,
    fba: PathBuf,
    glb: PathBuf,
    one: PathBuf,
    /// Poses in the first two, as decoded, and in the third.
    two_hands: PoseClip,
    one_hand: PoseClip,
}

impl Pages {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let (both, _) = poses(folder.path(), &[Side::Left, Side::Right]);
        let (one, one_hand) = poses(folder.path(), &[Side::Right]);
        let name = |name: &str| folder.path().join(name);
        let (fba, glb, decoded) = (name("two.fba"), name("two.glb"), name("two.jsonl"));
        done(&["encode", path(&both), "-o", path(&fba), "--quant", "2"]);
        done(&["decode", path(&fba), "-o", path(&decoded)]);
        done(&["decode", path(&fba), "-o", path(&glb), "--tolerance", "0.2"]);
        // A clip whose pictures tell their number by their grey, at half the rate.
        let pictures = name("pictures");
        std::fs::create_dir(&pictures).unwrap();
        for i in 0..FRAMES / 2 {
            let picture = RgbImage::from_pixel(96, 64, Rgb([8 * i as u8 + 20; 3]));
            picture.save(pictures.join(format!("{i:03}.png"))).unwrap();
        }
        let page = |input: &Path, more: &[&str]| {
            let html = input.with_extension(format!("{}.html", input.extension().unwrap().display()));
            done(&[&["view", path(input), "-o", path(&html)], more].concat());
            html
        };
        let with_clip = ["--clip", path(&pictures), "--input-fps", "12.5"];
        let (fba, glb, one) = (page(&fba, &[]), page(&glb, &[]), page(&one, &with_clip));
        Self { two_hands: read_poses(&decoded).unwrap(), one_hand, fba, glb, one, folder }
    }

    /// Where the picture `k` that a job takes is.
    fn picture(&self, k: usize) -> PathBuf {
        self.folder.path().join(format!("picture-{k}.png"))
    }

    /// The `k`th picture shows the hands where the own renderer does.
    fn assert_shown(&self, k: usize, clip: &PoseClip, step: &Value) {
        let instant = step["instant"].as_u64().unwrap() as usize;
        let same = overlap(&self.picture(k), &silhouette(clip, instant, &step["camera"]));
        println!("picture {k}, instant {instant}: overlap of silhouettes {same:.4}");
        assert!(same > 0.98, "picture {k}, instant {instant}: {same}");
    }
}

/// What a page is as a file: UTF-16, little-endian, behind its byte order mark.
fn page_text(bytes: &[u8]) -> String {
    let units: Vec<u16> = bytes.as_chunks::<2>().0.iter().map(|b| u16::from_le_bytes(*b)).collect();
    let text = String::from_utf16(&units).unwrap();
    text.strip_prefix('\u{feff}').unwrap().to_owned()
}

/// No page is wider than its window.
fn assert_fits(steps: &[Value]) {
    for step in steps {
        assert!(step["overflow"].as_i64().unwrap() <= 0, "the page is wider than the window: {step}");
    }
}

#[test]
fn pages_need_nothing_else() {
    let pages = Pages::new();
    for file in [&pages.fba, &pages.glb, &pages.one] {
        let html = page_text(&std::fs::read(file).unwrap());
        assert!(html.starts_with("<!doctype html>") && html.ends_with("</html>\n"), "{}", file.display());
        for word in ["http://", "https://", "src=\"/", "@import", "url("] {
            assert!(!html.contains(word), "{word} in {}", file.display());
        }
    }
}

#[test]
#[ignore = "needs Chromium and npm ci --prefix tests/node"]
fn the_page_obeys_and_shows_the_hands_where_the_own_renderer_does() {
    let pages = Pages::new();
    let picture = |k: usize| pages.picture(k);
    let desktop = json!({ "page": pages.fba, "width": 900, "height": 560, "hash": "frame=0", "steps": [
        { "picture": picture(0) },
        { "scrub": 20, "picture": picture(1) },
        { "press": "ArrowRight" },
        { "press": "Shift+ArrowLeft" },
        { "press": "End" },
        { "press": "ArrowRight" },
        { "press": "Home" },
        { "press": "2" },
        { "press": "]" },
        { "click": ["#curves", 0.6] },
        { "click": ["#bits", 0.3] },
        { "drag": [120, -60], "picture": picture(2) },
        { "press": "Shift+d", "wheel": -300, "picture": picture(3) },
        { "press": "0" },
        { "press": "l" },
        // Slow enough that the clip does not end while a busy machine draws.
        { "press": "[" }, { "press": "[" }, { "press": "[" },
        { "press": "Space", "wait": 300 },
    ]});
    let wide = json!({
        "page": pages.fba, "width": 1280, "height": 800, "hash": "frame=9", "steps": [shot("desktop-light.png")]
    });
    let found = browse(pages.folder.path(), &[desktop, wide]);
    let steps = &found[0];
    let instants: Vec<_> = steps.iter().map(|step| step["instant"].as_i64().unwrap()).collect();
    assert_eq!(instants[..9], [0, 20, 21, 0, 49, 49, 0, 0, 0]);
    // The plot begins and ends a little inside of its box.
    assert!((26..=30).contains(&instants[9]) && (10..=14).contains(&instants[10]), "{instants:?}");
    assert_eq!((&steps[6]["finger"], &steps[7]["finger"]), (&json!("all"), &json!("index")));
    assert_eq!((&steps[7]["speed"], &steps[8]["speed"]), (&json!(1), &json!(2)));
    assert_eq!((&steps[13]["loop"], &steps[14]["loop"]), (&json!(true), &json!(false)));
    assert_eq!(steps[17]["speed"], json!(0.25));
    assert!(steps[18]["playing"] == true && instants[18] > instants[17], "{}", steps[18]);
    assert_eq!(steps[0]["labels"], json!(["left", "right"]));
    assert!(steps[0]["facts"].as_str().unwrap().contains("both hands · 50 frames · 2.0 s"), "{}", steps[0]);
    assert_eq!(steps[0]["title"], "two.fba – handcast");
    assert_ne!(steps[0]["camera"]["eye"], steps[11]["camera"]["eye"]);
    assert_eq!(steps[0]["camera"], steps[13]["camera"]);
    found.iter().for_each(|steps| assert_fits(steps));
    for (k, step) in [(0, 0), (1, 1), (2, 11), (3, 12)] {
        pages.assert_shown(k, &pages.two_hands, &steps[step]);
    }
}

#[test]
#[ignore = "needs Chromium and npm ci --prefix tests/node"]
fn the_page_works_on_a_phone_beside_its_clip_and_without_webgl() {
    let pages = Pages::new();
    let picture = |k: usize| pages.picture(k);
    let jobs = [
        json!({ "page": pages.glb, "width": 390, "height": 844, "dark": true, "hash": "frame=41", "steps": [
            { "picture": picture(0) }, { "pinch": 2 }, shot("phone-dark.png"),
        ]}),
        json!({ "page": pages.one, "width": 360, "height": 740, "hash": "frame=30&finger=thumb", "steps": [
            { "picture": picture(1), "wait": 300, "pixel": "#clip" }, shot("phone-light.png"),
        ]}),
        json!({ "page": pages.one, "width": 320, "height": 320, "dark": true, "steps": [{ "wait": 400 }] }),
        json!({ "page": pages.one, "width": 320, "height": 320, "still": true, "steps": [{ "wait": 200 }] }),
        json!({ "page": pages.one, "width": 360, "height": 640, "blind": true, "hash": "frame=3", "steps": [
            { "press": "ArrowRight" }, shot("no-webgl.png"),
        ]}),
    ];
    let found = browse(pages.folder.path(), &jobs);
    let [glb, beside, playing, still, blind] = &found[..] else { panic!("{found:?}") };
    let eye = |step: &Value| -> f64 {
        let squares = step["camera"]["eye"].as_array().unwrap().iter().enumerate();
        let target = [0.0, -0.08, -0.7];
        squares.map(|(k, v)| (v.as_f64().unwrap() - target[k]).powi(2)).sum::<f64>().sqrt()
    };
    assert!(eye(&glb[1]) < 0.7 * eye(&glb[0]), "two fingers bring the hand nearer");
    assert_eq!((&beside[0]["clip"], &beside[0]["finger"]), (&json!(15), &json!("thumb")));
    let grey = beside[0]["pixel"][0].as_i64().unwrap();
    assert!((grey - (8 * 15 + 20)).abs() <= 2, "picture 15 has another grey: {grey}");
    assert!(playing[0]["playing"] == true && playing[0]["instant"].as_i64() > Some(2), "{}", playing[0]);
    assert!(still[0]["playing"] == false && still[0]["instant"] == 0, "{}", still[0]);
    assert!(blind[0]["message"].as_str().unwrap().contains("WebGL 2") && blind[0]["instant"] == 4);
    found.iter().for_each(|steps| assert_fits(steps));
    assert_eq!((&glb[0]["instant"], &beside[0]["instant"]), (&json!(41), &json!(30)));
    pages.assert_shown(0, &pages.two_hands, &glb[0]);
    pages.assert_shown(1, &pages.one_hand, &beside[0]);
}

#[test]
#[ignore = "needs Chromium and npm ci --prefix tests/node"]
fn a_clip_moves_where_drawing_is_slow() {
    let pages = Pages::new();
    let step = json!({ "wait": 2500, "pixel": "#clip" });
    let job =
        json!({ "page": pages.one, "width": 640, "height": 480, "slow": true, "steps": [step, step, step] });
    let found = browse(pages.folder.path(), &[job]);
    for step in &found[0] {
        assert!(step["playing"] == true && step["clip"].is_i64(), "no picture of the clip is shown: {step}");
        assert!(step["pixel"][0].as_i64().unwrap() >= 18, "{step}");
    }
    let shown: BTreeSet<_> = found[0].iter().map(|step| step["clip"].as_i64()).collect();
    assert!(shown.len() > 1, "the clip stands still: {shown:?}");
}

#[test]
#[ignore = "needs Chromium and npm ci --prefix tests/node"]
fn joints_have_curves_and_a_skeleton() {
    let pages = Pages::new();
    let picture = |k: usize| pages.picture(k);
    // Joint 8 is the last of the index finger before its tip, 9 the tip; 2 the thumb's second.
    let job = json!({ "page": pages.fba, "width": 900, "height": 560, "hash": "frame=12", "steps": [
        {}, { "joint": [0, 7] }, { "joint": [1, 9] }, { "joint": [0, 2] }, { "press": "k", "picture": picture(0) },
        { "press": "6" }, { "check": "#rows [data-row='3']" },
        { "press": "k" },
        shot("skeleton.png"),
    ]});
    let found = browse(pages.folder.path(), &[job]);
    let steps = &found[0];
    let labels = |step: &Value, strong: bool| -> Vec<String> {
        let lines = step["lines"].as_array().unwrap().iter();
        let lines = lines.filter(|line| !strong || line["strong"] == true);
        lines.map(|line| line["label"].as_str().unwrap().to_owned()).collect()
    };
    // A curve a joint: none is a sum.
    for step in steps {
        for line in step["lines"].as_array().unwrap() {
            assert!(line["most"].as_f64().unwrap() < 130.0, "{line}");
        }
    }
    let both =
        |words: &[&str]| -> Vec<String> { words.iter().chain(words).map(|w| (*w).to_owned()).collect() };
    let row = |joint: &str| {
        both(&[
            &format!("Thumb {}", if joint == "PIP" { "MCP" } else { "IP" }),
            &format!("Index {joint}"),
            &format!("Middle {joint}"),
            &format!("Ring {joint}"),
            &format!("Little {joint}"),
        ])
    };
    assert_eq!(labels(&steps[0], false), row("PIP"));
    assert_eq!((&steps[1]["finger"], labels(&steps[1], true)), (&json!("index"), both(&["PIP flexion"])));
    assert_eq!((&steps[2]["finger"], labels(&steps[2], true)), (&json!("index"), both(&["DIP flexion"])));
    assert_eq!((&steps[3]["finger"], labels(&steps[3], true)), (&json!("thumb"), both(&["MCP flexion"])));
    assert_eq!((&steps[5]["finger"], labels(&steps[5], true).len()), (&json!("all"), 0));
    assert_eq!(labels(&steps[6], false), row("DIP"));
    assert_eq!(steps[6]["curves"], "Bend at the end joints");
    // Nothing, a ring, the skeleton.
    let drawn: Vec<u64> = steps.iter().map(|step| step["bones"].as_u64().unwrap()).collect();
    assert_eq!((drawn[0], drawn[7]), (0, 0));
    assert!(drawn[1] > 20 && drawn[4] > 10 * drawn[1], "{drawn:?}");
    pages.assert_shown(0, &pages.two_hands, &steps[4]);
}

#[test]
#[ignore = "needs Chromium and npm ci --prefix tests/node"]
fn files_are_dropped_on_the_page() {
    let pages = Pages::new();
    let picture = |k: usize| pages.picture(k);
    let name = |name: &str| pages.folder.path().join(name);
    std::fs::write(name("broken.fba"), b"no stream at all").unwrap();
    // Hands whose times are their own.
    let mut apart = pages.two_hands.clone();
    apart
        .frames
        .iter_mut()
        .filter(|frame| frame.pose.side == Side::Left)
        .for_each(|frame| frame.time += 0.013);
    write_poses(&name("apart.jsonl"), &apart).unwrap();
    let mut dark = pages.two_hands.clone();
    dark.header.skin_tone = Some(8);
    write_poses(&name("dark.jsonl"), &dark).unwrap();
    done(&["encode", path(&name("dark.jsonl")), "-o", path(&name("dark.fba"))]);
    std::fs::write(name("broken.jsonl"), b"{\"format\":\"handcast-poses\",\"version\":1}\nwords\n").unwrap();
    let job = json!({ "page": pages.one, "width": 900, "height": 560, "hash": "frame=3", "steps": [
        { "drop": name("two.fba") }, { "scrub": 20, "picture": picture(0) },
        { "drop": name("poses1.jsonl") }, { "scrub": 30, "picture": picture(1) },
        { "drop": name("broken.fba") }, { "drop": name("broken.jsonl") },
        { "drop": name("apart.jsonl") }, { "scrub": 41 }, { "scrub": 99 },
        { "drop": name("dark.jsonl") }, { "drop": name("two.fba") }, { "drop": name("dark.fba") },
    ]});
    let found = browse(pages.folder.path(), &[job]);
    let steps = &found[0];
    assert_eq!(steps[0]["title"], "two.fba – handcast");
    assert!(
        steps[0]["facts"].as_str().unwrap().contains("both hands · 50 frames · 2.0 s"),
        "{}",
        steps[0]["facts"]
    );
    assert!(
        steps[0]["hidden"].as_array().unwrap().contains(&json!("clip-panel")),
        "another motion has another clip"
    );
    assert_eq!(steps[2]["title"], "poses1.jsonl – handcast");
    pages.assert_shown(0, &pages.two_hands, &steps[1]);
    pages.assert_shown(1, &pages.one_hand, &steps[3]);
    // What cannot be read leaves what there was.
    for (step, words) in [(&steps[4], "broken.fba: "), (&steps[5], "broken.jsonl: line 2: ")] {
        assert!(step["opening"].as_str().unwrap().starts_with(words), "{}", step["opening"]);
        assert_eq!((&step["title"], &step["count"]), (&json!("poses1.jsonl – handcast"), &json!(50)));
    }
    // Neither is lost where the other has a pose, but before its first and behind its last.
    assert_eq!(steps[6]["count"], 100);
    for (step, labels) in [(&steps[7], ["left", "right"]), (&steps[8], ["left", "right: lost"])] {
        assert_eq!(step["labels"], json!(labels), "{}", step["instant"]);
    }
    // The skin has the tone that the file tells.
    let red = |tone: u8| f64::from(linear_from_srgb(skin_tone(tone).unwrap()[0]));
    for (step, tone) in [(&steps[9], 8), (&steps[10], 3), (&steps[11], 8)] {
        let shown = step["skin"][0].as_f64().unwrap();
        assert!((shown - red(tone)).abs() < 1e-3, "{}: {shown}", step["title"]);
    }
}

#[test]
#[ignore = "needs Chromium and npm ci --prefix tests/node"]
fn a_film_is_on_the_page_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let (file, _) = poses(folder.path(), &[Side::Right]);
    let film = folder.path().join("clip.mp4");
    let mut writer = FilmWriter::new(std::io::Cursor::new(Vec::new()), (96, 64), RATE, 300_000).unwrap();
    for i in 0..FRAMES {
        writer.write(&RgbImage::from_pixel(96, 64, Rgb([4 * i as u8 + 20; 3])), TICKS / RATE as u32).unwrap();
    }
    std::fs::write(&film, writer.finish().unwrap().into_inner()).unwrap();
    let html = folder.path().join("page.html");
    done(&["view", path(&file), "--clip", path(&film), "-o", path(&html)]);
    let job = json!({ "page": html, "width": 900, "height": 560, "hash": "frame=0", "steps": [
        { "film": 0.2, "pixel": "#film" },
        { "scrub": 30 }, { "film": 0.3, "pixel": "#film" },
        { "press": "Space", "wait": 600 }, { "press": "Space" }, { "film": 0.3, "pixel": "#film" },
    ]});
    let found = browse(folder.path(), &[job]);
    for step in [0, 2, 5] {
        let instant = found[0][step]["instant"].as_i64().unwrap();
        let grey = found[0][step]["pixel"][0].as_i64().unwrap();
        assert!((grey - (4 * instant + 20)).abs() <= 3, "step {step}: instant {instant} has grey {grey}");
    }
    assert!(found[0][5]["instant"].as_i64().unwrap() != 30, "it has played");
}

/// Servers that know better of which characters it is, programs that write it anew, and places where it is cut or changed.
#[test]
#[ignore = "needs Chromium and npm ci --prefix tests/node"]
fn a_page_stays_whole_on_its_way_or_says_that_it_is_not() {
    let pages = Pages::new();
    let page = std::fs::read(&pages.one).unwrap();
    let text = page_text(&page);
    let name = |name: &str| pages.folder.path().join(name);
    // Where the bytes of an element begin, in the file.
    let inside =
        |id: &str| 2 * (1 + text.split(&format!("id=\"{id}\"")).next().unwrap().encode_utf16().count());
    let changed = |id: &str| {
        let mut page = page.clone();
        page[inside(id) + 3000] ^= 1;
        page
    };
    std::fs::write(name("utf-8.html"), &text).unwrap();
    std::fs::write(name("changed.html"), changed("bytes")).unwrap();
    std::fs::write(name("cut.html"), &page[..inside("bytes") + 9000]).unwrap();
    std::fs::write(name("clip.html"), changed("clip-bytes")).unwrap();
    let steps = json!([{ "picture": pages.picture(0), "wait": 300, "pixel": "#clip" }]);
    let whole = |page: &Path, served: Option<&str>| json!({ "page": page, "served": served, "width": 360, "height": 740, "hash": "frame=30", "steps": steps });
    let damaged =
        |page: &str| json!({ "page": name(page), "damaged": true, "width": 360, "height": 740, "steps": [] });
    let jobs = [
        whole(&pages.one, Some("text/html; charset=utf-8")),
        whole(&pages.one, Some("text/html; charset=iso-8859-1")),
        whole(&name("utf-8.html"), Some("text/html")),
        whole(&name("utf-8.html"), None),
        damaged("changed.html"),
        damaged("cut.html"),
        json!({ "page": name("clip.html"), "width": 360, "height": 740, "hash": "frame=30", "steps": [{}] }),
    ];
    let found = browse(pages.folder.path(), &jobs);
    for steps in &found[..4] {
        assert_eq!((&steps[0]["instant"], &steps[0]["clip"]), (&json!(30), &json!(15)));
        let grey = steps[0]["pixel"][0].as_i64().unwrap();
        assert!((grey - (8 * 15 + 20)).abs() <= 2, "picture 15 has another grey: {grey}");
    }
    pages.assert_shown(0, &pages.one_hand, &found[3][0]);
    for steps in &found[4..6] {
        assert_eq!(
            steps[0],
            "This page cannot be shown: it is damaged. It must be passed on whole, as a file."
        );
    }
    let step = &found[6][0];
    assert_eq!(
        (&step["instant"], &step["notes"]),
        (&json!(30), &json!(["the clip in this page is damaged"]))
    );
    assert!(step["hidden"].as_array().unwrap().contains(&json!("clip-panel")));
}

#[test]
fn pages_are_small() {
    let folder = tempfile::tempdir().unwrap();
    let demo = Path::new("fixtures/demo.poses.jsonl");
    let html = folder.path().join("page.html");
    done(&["view", path(demo), "-o", path(&html)]);
    let gzipped = |bytes: &[u8]| {
        let mut out = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        out.write_all(bytes).unwrap();
        out.finish().unwrap().len()
    };
    let page = std::fs::read(&html).unwrap();
    println!("without a clip: {} bytes, gzipped {}", page.len(), gzipped(&page));
    assert!(gzipped(&page) < 175_000);
}

/// With each of the shared clips.
#[test]
fn pages_are_at_most_half_as_large_again_as_their_clips() {
    let folder = tempfile::tempdir().unwrap();
    let html = folder.path().join("page.html");
    for name in ["fingerspelling", "finger-flexions", "counting"] {
        let clip = shared(&format!("data/clips/{name}.mp4"));
        done(&["view", "fixtures/demo.poses.jsonl", "--clip", path(&clip), "-o", path(&html)]);
        let size = |file: &Path| std::fs::metadata(file).unwrap().len() as f64;
        let share = size(&html) / size(&clip);
        println!("{name}: {share:.3} times the clip");
        assert!(share < 1.5, "{name}: {share}");
    }
}

#[test]
#[ignore = "needs Chromium and npm ci --prefix tests/node"]
fn axe_finds_nothing() {
    let pages = Pages::new();
    let report = pages.folder.path().join("report.html");
    done(&["fidelity", "fixtures/demo.poses.jsonl", "-o", path(&report)]);
    let chromium = chromium();
    let output = node("axe.js", &[&chromium, &pages.fba, &pages.one, &report]);
    let printed = text(&output.stdout);
    assert!(output.status.success(), "{printed}{}", text(&output.stderr));
    assert_eq!(printed.lines().filter(|line| line.contains("\"found\":[]")).count(), 3, "{printed}");
}

#[test]
#[ignore = "needs Chromium and npm ci --prefix tests/node"]
fn a_file_without_poses_gives_a_page_that_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let (file, html) = (folder.path().join("none.jsonl"), folder.path().join("none.html"));
    let clip = PoseClip { header: PoseHeader::one(Side::Left, None, None), frames: Vec::new() };
    write_poses(&file, &clip).unwrap();
    done(&["view", path(&file), "-o", path(&html)]);
    let job = json!({ "page": html, "width": 800, "height": 600, "steps": [{ "press": "Space" }] });
    let found = browse(folder.path(), &[job]);
    assert_eq!(found[0][0]["message"], "There is no pose in this file.");
}

/// Head and body of what the server answers.
fn ask(at: &str, request: &str) -> (String, Vec<u8>) {
    let mut stream = TcpStream::connect(at).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    let end = answer.windows(4).position(|four| four == b"\r\n\r\n").unwrap();
    (text(&answer[..end + 2]), answer.split_off(end + 4))
}

/// A running `handcast view`, and where it listens.
struct Served {
    child: Child,
    at: String,
}

impl Served {
    fn start(file: &Path) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_handcast"))
            .args(["view", path(file)])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let at = line.trim().strip_prefix("http://").and_then(|l| l.strip_suffix('/')).unwrap().to_owned();
        assert!(at.starts_with("127.0.0.1:"), "{line}");
        Self { child, at }
    }

    /// Gives the page to an honest client within two seconds.
    fn answers(&self) {
        let begun = Instant::now();
        let (head, body) = ask(&self.at, &format!("GET / HTTP/1.1\r\nHost: {}\r\n\r\n", self.at));
        assert!(head.starts_with("HTTP/1.1 200 OK\r\n") && page_text(&body).ends_with("</html>\n"), "{head}");
        assert!(begun.elapsed() < Duration::from_secs(2), "{:?}", begun.elapsed());
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn a_thousand_clients_keep_no_honest_one_waiting() {
    let folder = tempfile::tempdir().unwrap();
    let (file, _) = poses(folder.path(), &[Side::Left]);
    let served = Served::start(&file);
    let head = format!("GET / HTTP/1.1\r\nHost: {}\r\n", served.at);
    let mut held: Vec<TcpStream> = Vec::new();
    for number in 0..1000 {
        let mut socket = TcpStream::connect(&served.at).unwrap();
        // Silent ones, heads that are never ended, pages that nobody takes, and bodies that nobody wants. Some are shut
        // out while they write.
        let _ = match number % 4 {
            0 => Ok(()),
            1 => socket.write_all(head.as_bytes()),
            2 => socket.write_all(format!("{head}\r\n").as_bytes()),
            _ => socket.write_all(b"POST / HTTP/1.1\r\nContent-Length: 999999999\r\n\r\nx"),
        };
        held.push(socket);
        if number % 200 == 199 {
            served.answers();
        }
    }
    for _ in 0..5 {
        // Those whose heads trickle in.
        for socket in &mut held {
            let _ = socket.write_all(b"X: y\r\n");
        }
        served.answers();
    }
}

#[test]
fn long_bodies_are_not_read_to_their_end() {
    let folder = tempfile::tempdir().unwrap();
    let (file, _) = poses(folder.path(), &[Side::Left]);
    let served = Served::start(&file);
    let mut socket = TcpStream::connect(&served.at).unwrap();
    let head = format!("POST / HTTP/1.1\r\nHost: {}\r\nContent-Length: 99999999999\r\n\r\n", served.at);
    socket.write_all(head.as_bytes()).unwrap();
    let begun = Instant::now();
    while socket.write_all(&[b'x'; 1 << 16]).is_ok() {
        assert!(begun.elapsed() < Duration::from_secs(10), "the body is read on and on");
    }
    served.answers();
}

#[test]
fn the_server_prints_its_address_gives_the_page_and_ends_when_told() {
    let folder = tempfile::tempdir().unwrap();
    let (file, _) = poses(folder.path(), &[Side::Left]);
    let mut served = Served::start(&file);
    let at = served.at.clone();
    let get = |target: &str, host: &str| ask(&at, &format!("GET {target} HTTP/1.1\r\nHost: {host}\r\n\r\n"));
    let (head, body) = get("/", &at);
    assert!(head.starts_with("HTTP/1.1 200 OK\r\n"), "{head}");
    assert!(head.contains("\r\nContent-Type: text/html; charset=utf-16le\r\n"), "{head}");
    let html = folder.path().join("page.html");
    done(&["view", path(&file), "-o", path(&html)]);
    assert!(body == std::fs::read(&html).unwrap(), "the page is the one that is written");
    let status = |target: &str, host: &str| get(target, host).0.lines().next().unwrap().to_owned();
    assert_eq!(status("/favicon.ico", &at), "HTTP/1.1 404 Not Found");
    assert_eq!(status("/", "handcast.example"), "HTTP/1.1 403 Forbidden");
    assert_eq!(status("/", &format!("{at}\r\nOrigin: http://handcast.example")), "HTTP/1.1 403 Forbidden");
    let port = at.strip_prefix("127.0.0.1:").unwrap();
    let taken = handcast(&["view", path(&file), "--port", port]);
    assert_eq!(taken.status.code(), Some(1));
    let words = format!("cannot serve on port {port} of 127.0.0.1 (--port names another");
    assert!(text(&taken.stderr).contains(&words), "{}", text(&taken.stderr));
    // What Ctrl-C sends. Shells start what runs in the background deaf to it.
    let told = Command::new("kill").args(["-INT", &served.child.id().to_string()]).status();
    let end = Instant::now() + Duration::from_secs(2);
    while told.as_ref().is_ok_and(|s| s.success()) && Instant::now() < end {
        if let Some(status) = served.child.try_wait().unwrap() {
            assert_eq!(status.code(), Some(0), "a page that is served ends so, well");
            break;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    drop(served);
    assert!(TcpStream::connect(&at).is_err());
}

#[test]
fn bad_inputs_are_named_and_leave_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let name = |name: &str| folder.path().join(name);
    let (good, _) = poses(folder.path(), &[Side::Right]);
    let file = |file: &str, bytes: &[u8]| {
        std::fs::write(name(file), bytes).unwrap();
        name(file)
    };
    let html = name("page.html");
    let view = |input: &Path, more: &[&str], words: &[&str]| {
        refused(&[&["view", path(input), "-o", path(&html)], more].concat(), &html, words);
    };
    view(&name("none.fba"), &[], &["none.fba"]);
    view(&file("bad.fba", b"this is no stream"), &[], &["bad.fba"]);
    view(&file("bad.glb", b"glTF and nothing else"), &[], &["bad.glb"]);
    view(&file("bad.jsonl", b"{\"format\":\"something\"}\n"), &[], &["bad.jsonl", "none of the formats"]);
    view(&good, &["--clip", path(&name("none.mp4"))], &["none.mp4"]);
    view(&good, &["--clip", path(&file("words.mp4", b"no video"))], &["words.mp4"]);
    let picture = name("x.png");
    let render = |more: &[&str], words: &[&str]| {
        refused(&[&["render", path(&good), "-o", path(&picture)], more].concat(), &picture, words);
    };
    let large = ["render", path(&good), "-o", path(&picture), "--size", "9000x10"];
    misused(&large, &picture, &["9000", "1 to 4096"]);
    render(&["--hand", "left"], &["no pose of a left hand"]);
    misused(
        &["render", path(&good), "-o", path(&name("x.bmp"))],
        &name("x.bmp"),
        &["allowed are .png, .gif, .webp"],
    );
    for wrong in [["--port", "80"], ["--clip-size", "300"]] {
        let out = handcast(&[&["view", path(&good), "-o", path(&html)], &wrong[..]].concat());
        assert_eq!(out.status.code(), Some(2), "{wrong:?}");
    }
}

#[test]
fn pictures_have_the_size_number_and_times_asked_for() {
    use image::AnimationDecoder;
    let folder = tempfile::tempdir().unwrap();
    let name = |name: &str| folder.path().join(name);
    let (both, _) = poses(folder.path(), &[Side::Left, Side::Right]);
    let (stream, glb) = (name("two.fba"), name("two.glb"));
    done(&["encode", path(&both), "-o", path(&stream)]);
    done(&["decode", path(&stream), "-o", path(&glb)]);
    let draw = |input: &Path, out: &str, more: &[&str]| {
        let size = ["--size", "96x80"];
        done(&[&["render", path(input), "-o", path(&name(out))], &size[..], more].concat());
        std::io::Cursor::new(std::fs::read(name(out)).unwrap())
    };
    let still = |input: &Path, out: &str, more: &[&str]| {
        draw(input, out, more);
        image::open(name(out)).unwrap().to_rgba8()
    };
    let gutter = 96 / 32;
    let sheet = still(&both, "sheet.png", &["--frames", "6"]);
    assert_eq!(sheet.dimensions(), (4 * (96 + gutter) + gutter, 2 * (80 + gutter) + gutter));
    let one = still(&stream, "one.webp", &["--at", "1", "--transparent"]);
    assert_eq!(one.dimensions(), (96, 80));
    // Both hands are there, left and right of the middle.
    for half in 0..2 {
        assert!(one.enumerate_pixels().filter(|(x, _, p)| x / 48 == half && p[3] > 0).count() > 300);
    }
    assert_eq!(still(&glb, "glb.png", &["--at", "1", "--transparent"]).dimensions(), (96, 80));
    let landmarks = name("right.landmarks.jsonl");
    done(&["decode", path(&stream), "-o", path(&landmarks), "--only", "right"]);
    assert_eq!(still(&landmarks, "landmarks.png", &["--at", "1"]).dimensions(), (96, 80));
    let turned = still(&both, "turned.png", &["--frames", "6", "--turntable"]);
    assert_ne!(turned, sheet);

    let delays = |frames: image::Frames| -> Vec<u32> {
        frames.map(|f| f.unwrap().delay().numer_denom_ms()).map(|(a, b)| a / b).collect()
    };
    let gif = draw(&stream, "x.gif", &["--hand", "left", "--frames", "10"]);
    let found = delays(image::codecs::gif::GifDecoder::new(gif).unwrap().into_frames());
    assert_eq!(found.len(), 10);
    assert!((found[..9].iter().sum::<u32>() as i64 - 1960).abs() <= 10, "{found:?}");
    let webp = draw(&glb, "x.webp", &[]);
    let found = delays(image::codecs::webp::WebPDecoder::new(webp).unwrap().into_frames());
    assert_eq!(found, vec![40; FRAMES]);
    let one = name("one.jsonl");
    done(&["pose", "asl:L", "-o", path(&one)]);
    let turn = draw(&one, "turn.webp", &["--turntable", "--frames", "8"]);
    let found = delays(image::codecs::webp::WebPDecoder::new(turn).unwrap().into_frames());
    assert_eq!(found.len(), 8);

    // A hand that is away for long is away as long in the picture.
    let (clip, away) = (name("clip.jsonl"), name("away.jsonl"));
    let mut gap = read_poses(&both).unwrap();
    gap.frames.retain(|frame| frame.pose.side == Side::Left);
    gap.header.hands.truncate(1);
    gap.frames.truncate(6);
    gap.frames[3..].iter_mut().for_each(|frame| frame.time += 25.0);
    write_poses(&away, &gap).unwrap();
    let webp = draw(&away, "away.webp", &[]);
    let found = delays(image::codecs::webp::WebPDecoder::new(webp).unwrap().into_frames());
    assert_eq!(found, [40, 40, 25040, 40, 40, 40]);
    gap.frames[3..].iter_mut().for_each(|frame| frame.time += 700.0);
    write_poses(&clip, &gap).unwrap();
    let out = handcast(&["render", path(&clip), "-o", path(&name("cut.gif")), "--size", "96x80"]);
    assert!(text(&out.stderr).contains("1 picture is shown for 655.35 s, as long as one in a .gif is"));
}
