//! Streams in files as they come: damaged, joined in the middle, one behind the other, in MP4; and lossy networks.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::common::command::{done, handcast, misused, path, refused, text};
use crate::common::glb::motion;
use crate::common::shared;
use handcast_formats::motion::{Format, Motion};
use handcast_formats::mp4::stream_in;
use handcast_formats::person::write_person;
use handcast_formats::poses::{read_poses, write_poses};
use handcast_hand::{Morphology, Person, PoseClip, PoseHeader, Side, TimedPose};

/// A folder with the poses of a right hand, six seconds of them.
fn folder() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let frames = motion(Side::Right, 150).into_iter().map(|(t, pose)| TimedPose::new(t, pose));
    let clip = PoseClip { header: PoseHeader::one(Side::Right, None, Some(25.0)), frames: frames.collect() };
    let poses = folder.path().join("poses.jsonl");
    write_poses(&poses, &clip).unwrap();
    (folder, poses)
}

#[test]
fn damage_is_concealed_in_every_format() {
    let (folder, poses) = folder();
    let at = |name: &str| folder.path().join(name);
    done(&["encode", path(&poses), "-o", path(&at("a.fba")), "--intra", "1", "--resync", "-q"]);
    let sound = std::fs::read(at("a.fba")).unwrap();
    for trial in 0..9usize {
        let mut bytes = sound.clone();
        let byte = (trial * 7919 + 50) % bytes.len();
        bytes[byte] ^= 0x55;
        std::fs::write(at("d.fba"), &bytes).unwrap();
        for format in Format::written() {
            let file = at(&format!("d{}", format.ending));
            // No damage reaches the surface, which takes a second to make.
            let bare = trial > 0 && format.id == "glb";
            let more: &[&str] = if bare { &["--conceal", "--anim-only"] } else { &["--conceal"] };
            done(&[&["decode", path(&at("d.fba")), "-o", path(&file)], more].concat());
            let back = Motion::read(&file).unwrap_or_else(|e| panic!("byte {byte}: {e}"));
            assert!(back.clip.frames.len() > 100, "byte {byte}, {}", format.name);
        }
    }
    // Line by line, as the bytes come.
    let lines = done(&["decode", path(&at("d.fba")), "-o", "-", "--conceal"]);
    assert!(lines.lines().count() > 100);
}

#[test]
fn tails_and_what_follows_the_end_are_decoded_and_told() {
    let (folder, poses) = folder();
    let at = |name: &str| folder.path().join(name);
    for resync in [&["--resync"][..], &[]] {
        done(
            &[&["encode", path(&poses), "-o", path(&at("a.fba")), "--intra", "2", "-q"][..], resync].concat(),
        );
        let bytes = std::fs::read(at("a.fba")).unwrap();
        std::fs::write(at("tail.fba"), &bytes[bytes.len() / 4..]).unwrap();
        let tail = at("tail.jsonl");
        if resync.is_empty() {
            // Its I planes lean on ranges sent before.
            refused(
                &["decode", path(&at("tail.fba")), "-o", path(&at("no.jsonl"))],
                &at("no.jsonl"),
                &["not an fba stream"],
            );
        } else {
            let out = handcast(&["decode", path(&at("tail.fba")), "-o", path(&tail)]);
            let said = text(&out.stderr);
            assert!(out.status.success() && said.contains("begins in the middle"), "{said}");
            let frames = read_poses(&tail).unwrap().frames.len();
            assert_eq!(frames, 100, "the next I plane is that at 2 s");
            done(&["inspect", path(&at("tail.fba"))]);
            // It counts beside another one.
            std::fs::write(at("two.fba"), [&bytes[bytes.len() / 4..], &bytes[..]].concat()).unwrap();
            let (two, baps) = (at("two.fba"), at("two.bap"));
            for command in [&["inspect", path(&two)][..], &["decode", path(&two), "-o", path(&baps)]] {
                let said = text(&handcast(command).stderr);
                assert!(said.contains("begins in the middle") && said.contains("2 streams"), "{said}");
            }
            // Behind damage in the last period there is nothing to go on with.
            let mut cut = bytes.clone();
            let from = cut.len() - cut.len() / 8;
            cut[from..from + 20].fill(0xa5);
            std::fs::write(at("cut.fba"), cut).unwrap();
            for output in ["cut.jsonl", "cut.bap"].map(at) {
                let said =
                    handcast(&["decode", path(&at("cut.fba")), "-o", path(&output), "--conceal"]).stderr;
                assert!(
                    text(&said).contains("no I plane that a start code marks follows the damage"),
                    "{}",
                    text(&said)
                );
            }
            done(&["view", path(&at("tail.fba")), "-o", path(&at("tail.html"))]);
        }
        for (more, words, count) in [(&bytes[..], "2 streams", 300), (b"words", "5 bytes behind", 150)] {
            std::fs::write(at("more.fba"), [&bytes[..], more].concat()).unwrap();
            let out = handcast(&["decode", path(&at("more.fba")), "-o", path(&at("more.json"))]);
            let said = text(&out.stderr);
            assert!(out.status.success() && said.contains(words), "{said}");
            assert_eq!(Motion::read(&at("more.json")).unwrap().clip.frames.len(), count);
        }
    }
    std::fs::write(at("none.fba"), b"these are the words of no stream").unwrap();
    let none = at("none.jsonl");
    refused(&["decode", path(&at("none.fba")), "-o", path(&none)], &none, &["not an fba stream"]);
}

#[test]
fn streams_that_end_at_rest_follow_one_another() {
    let (folder, poses) = folder();
    let at = |name: &str| folder.path().join(name);
    let mut clip = read_poses(&poses).unwrap();
    let rest = clip.frames[149].clone();
    clip.frames.extend((150..190).map(|i| TimedPose { time: f64::from(i) / 25.0, ..rest.clone() }));
    write_poses(&poses, &clip).unwrap();
    done(&["encode", path(&poses), "-o", path(&at("a.fba")), "-q"]);
    let bytes = std::fs::read(at("a.fba")).unwrap();
    std::fs::write(at("all.fba"), bytes.repeat(5)).unwrap();
    done(&["decode", path(&at("all.fba")), "-o", path(&at("all.jsonl"))]);
    let times: Vec<f64> = read_poses(&at("all.jsonl")).unwrap().frames.iter().map(|f| f.time).collect();
    assert_eq!(times.len(), 5 * 190);
    for (i, time) in times.iter().enumerate() {
        assert!((time - i as f64 / 25.0).abs() < 1e-5, "{i}: {time}");
    }
}

/// What is known of a hand comes before its I planes and travels on when the stream is coded anew.
#[test]
fn streams_are_joined_at_their_records_which_travel_on() {
    let (folder, poses) = folder();
    let at = |name: &str| folder.path().join(name);
    let mut clip = read_poses(&poses).unwrap();
    let sizes = Morphology::average(0.173);
    clip.header.hands[0].morphology = Some(sizes.clone());
    clip.header.skin_tone = Some(4);
    write_poses(&poses, &clip).unwrap();
    let repeated = ["--repeat-sizes", "--intra", "1", "-q"];
    done(&[&["encode", path(&poses), "-o", path(&at("a.fba"))][..], &repeated].concat());
    let bytes = std::fs::read(at("a.fba")).unwrap();
    let records: Vec<usize> =
        (4..bytes.len() - 4).filter(|&i| bytes[i..].starts_with(&[0, 0, 1, 0xb2])).collect();
    assert!(records.len() >= 5, "{records:?}");
    done(&["decode", path(&at("a.fba")), "-o", path(&at("a.jsonl"))]);
    let whole = read_poses(&at("a.jsonl")).unwrap().frames;
    let mut left = whole.len();
    for &record in &records[1..] {
        std::fs::write(at("tail.fba"), &bytes[record..]).unwrap();
        done(&["decode", path(&at("tail.fba")), "-o", path(&at("tail.jsonl"))]);
        let tail = read_poses(&at("tail.jsonl")).unwrap();
        let count = tail.frames.len();
        assert!((1..left).contains(&count), "{count} of {left}");
        left = count;
        let same = |(a, b): (&TimedPose, &TimedPose)| a.pose == b.pose;
        assert!(tail.frames.iter().zip(&whole[whole.len() - count..]).all(same), "{count}");
        let told = tail.header.hands[0].morphology.as_ref().unwrap().hand_length;
        assert!((told - sizes.hand_length).abs() < 1e-3, "{told}");
    }
    done(&["encode", path(&at("a.fba")), "-o", path(&at("b.fba")), "-q"]);
    done(&["encode", path(&at("a.fba")), "-o", path(&at("c.fba")), "-q", "--no-sizes"]);
    done(&["encode", path(&at("a.fba")), "-o", path(&at("d.mp4")), "-q", "--live"]);
    done(&["encode", path(&poses), "-o", path(&at("e.fba")), "-q", "--no-sizes"]);
    let lines = handcast(&["encode", path(&poses), "-o", "-", "-q", "--live", "--no-sizes"]);
    std::fs::write(at("f.fba"), lines.stdout).unwrap();
    for name in ["a.fba", "poses.jsonl"] {
        std::fs::create_dir_all(at("in")).unwrap();
        std::fs::copy(at(name), at("in").join(name)).unwrap();
    }
    done(&["corpus", path(&at("in")), "-o", path(&at("out")), "-q", "--no-sizes"]);
    let told = |name: &str| {
        let out = at("out.jsonl");
        done(&["decode", path(&at(name)), "-o", path(&out)]);
        let header = read_poses(&out).unwrap().header;
        (header.hands[0].morphology.clone(), header.skin_tone)
    };
    for name in ["b.fba", "d.mp4"] {
        let (morphology, tone) = told(name);
        assert!((morphology.unwrap().hand_length - sizes.hand_length).abs() < 1e-3);
        assert_eq!(tone, Some(4), "{name}");
    }
    for name in ["c.fba", "e.fba", "f.fba", "out/streams/a.fba.fba", "out/streams/poses.jsonl.fba"] {
        assert_eq!(told(name), (None, None), "{name}");
    }
}

/// Two people one behind the other.
#[test]
fn streams_of_other_sizes_are_told_with_the_sizes_that_are_shown() {
    let (folder, poses) = folder();
    let at = |name: &str| folder.path().join(name);
    let mut clip = read_poses(&poses).unwrap();
    let streams = [0.15, 0.2].map(|length| {
        clip.header.hands[0].morphology = Some(Morphology::average(length));
        write_poses(&at("sized.jsonl"), &clip).unwrap();
        done(&["encode", path(&at("sized.jsonl")), "-o", path(&at("part.fba")), "-q"]);
        std::fs::read(at("part.fba")).unwrap()
    });
    std::fs::write(at("both.fba"), streams.concat()).unwrap();
    let out = at("out.jsonl");
    let said = text(&handcast(&["decode", path(&at("both.fba")), "-o", path(&out)]).stderr);
    assert!(said.contains("different sizes of the right hand") && said.contains("the last ones"), "{said}");
    let shown = |clip: &PoseClip| clip.header.hands[0].morphology.as_ref().unwrap().hand_length;
    let length = shown(&read_poses(&out).unwrap());
    assert!((length - 0.2).abs() < 1e-3, "{length}");
    // Line by line a header is written before all of them are read.
    let lines = handcast(&["decode", path(&at("both.fba")), "-o", "-"]);
    std::fs::write(&out, lines.stdout).unwrap();
    let length = shown(&read_poses(&out).unwrap());
    assert!([0.15, 0.2].into_iter().any(|told| (length - told).abs() < 1e-3), "{length}");
    let wanted = format!("with those of a hand {:.0} mm long", 1e3 * length);
    assert!(text(&lines.stderr).contains(&wanted), "{wanted}: {}", text(&lines.stderr));
    // A viewer shows them as a file has them.
    let page = at("page.html");
    let viewed = |more: &[&str]| {
        let both = at("both.fba");
        let args = [&["view", path(&both), "-o", path(&page)], more].concat();
        text(&handcast(&args).stderr)
    };
    assert!(viewed(&[]).contains("different sizes"));
    let person = at("person.toml");
    write_person(&person, &Person { morphology: Morphology::average(0.18), ..Person::default() }).unwrap();
    let given = handcast(&["decode", path(&at("both.fba")), "-o", path(&out), "--person", path(&person)]);
    assert!(given.status.success() && !text(&given.stderr).contains("different sizes"));
    assert!(!viewed(&["--person", path(&person)]).contains("different sizes"));
}

#[test]
fn every_command_reads_a_stream_in_an_mp4_file() {
    let (folder, poses) = folder();
    let at = |name: &str| folder.path().join(name);
    let (mp4, fba) = (at("a.mp4"), at("a.fba"));
    done(&["encode", path(&poses), "-o", path(&mp4), "--intra", "1", "-q"]);
    done(&["encode", path(&poses), "-o", path(&fba), "--intra", "1", "-q", "--resync", "--wrapper", "99"]);
    let stream = stream_in(&std::fs::read(&mp4).unwrap()).unwrap().unwrap();
    assert_eq!(stream, std::fs::read(&fba).unwrap());
    assert_eq!(done(&["inspect", path(&mp4)]), done(&["inspect", path(&fba)]));
    for name in ["x.jsonl", "x.glb", "x.bap"] {
        done(&["decode", path(&mp4), "-o", path(&at(name))]);
        done(&["decode", path(&fba), "-o", path(&at(&format!("y{name}")))]);
    }
    assert_eq!(std::fs::read(at("x.jsonl")).unwrap(), std::fs::read(at("yx.jsonl")).unwrap());
    assert_eq!(done(&["decode", path(&mp4), "-o", "-"]), std::fs::read_to_string(at("x.jsonl")).unwrap());
    done(&["compare", path(&mp4), path(&fba)]);
    done(&["view", path(&mp4), "-o", path(&at("x.html"))]);
    done(&["encode", path(&mp4), "-o", path(&at("again.fba")), "-q"]);
    let report = done(&["fidelity", path(&mp4), "--loss", "5%", "--seeds", "2", "--json"]);
    assert_eq!(serde_json::from_str::<serde_json::Value>(&report).unwrap()["seeds"], 2);
    // Without a stream in it, or cut.
    std::fs::write(at("cut.mp4"), &std::fs::read(&mp4).unwrap()[..900]).unwrap();
    let none = at("none.jsonl");
    refused(&["decode", path(&at("cut.mp4")), "-o", path(&none)], &none, &["cut.mp4", "mp4: "]);
    let wrong = at("x.fba");
    let args = ["encode", path(&poses), "-o", path(&wrong), "--with-video", path(&mp4)];
    misused(&args, &wrong, &["--clip"]);
}

#[test]
fn a_stream_is_taken_over_as_it_is() {
    let (folder, poses) = folder();
    let at = |name: &str| folder.path().join(name);
    for how in [&["--quant", "9"][..], &["--resync", "--intra", "1"]] {
        done(&[&["encode", path(&poses), "-o", path(&at("a.fba")), "-q"][..], how].concat());
        let stream = std::fs::read(at("a.fba")).unwrap();
        let out = handcast(&["encode", path(&at("a.fba")), "-o", path(&at("a.mp4")), "--copy", "--quiet"]);
        assert!(out.status.success() && out.stderr.is_empty(), "{}", text(&out.stderr));
        assert_eq!(stream_in(&std::fs::read(at("a.mp4")).unwrap()).unwrap().unwrap(), stream);
        let out = handcast(&["encode", path(&at("a.mp4")), "-o", path(&at("b.fba")), "--copy"]);
        let said = text(&out.stderr);
        assert!(said.contains(&format!("{} bytes, as they were", stream.len())), "{said}");
        assert_eq!(std::fs::read(at("b.fba")).unwrap(), stream);
    }
    let (fba, none) = (at("a.fba"), at("none.fba"));
    refused(&["encode", path(&poses), "-o", path(&none), "--copy"], &none, &["poses.jsonl", "--copy"]);
    let coded = ["encode", path(&fba), "-o", path(&none), "--copy", "--bitrate", "2"];
    misused(&coded, &none, &["--copy", "--bitrate"]);
    let mut cut = std::fs::read(at("a.fba")).unwrap();
    cut.truncate(cut.len() / 2);
    std::fs::write(at("cut.fba"), cut).unwrap();
    refused(&["encode", path(&at("cut.fba")), "-o", path(&none), "--copy"], &none, &["cut.fba", "sound"]);
}

/// What `ffprobe` says of a file.
fn probed(file: &Path, args: &[&str]) -> String {
    let out = Command::new("ffprobe").args(["-v", "error"]).args(args).arg(file).output().unwrap();
    text(&out.stdout)
}

#[test]
#[ignore = "needs the shared material and ffprobe"]
fn a_clip_comes_along_untouched() {
    let (folder, poses) = folder();
    let clip = shared("data/clips/counting.mp4");
    let both = folder.path().join("both.mp4");
    done(&["encode", path(&poses), "-o", path(&both), "--with-video", path(&clip), "-q"]);
    let streams = probed(&both, &["-show_entries", "stream=codec_name,codec_tag_string", "-of", "csv=p=0"]);
    assert_eq!(streams.lines().collect::<Vec<_>>(), ["h264,avc1", "aac,mp4a", "mpeg4,mp4v"]);
    let packets = ["-select_streams", "v:0", "-show_packets", "-show_data_hash", "md5"];
    let fields = ["-show_entries", "packet=pts,dts,flags,data_hash", "-of", "csv=p=0"];
    let packets = [&packets[..], &fields].concat();
    assert_eq!(probed(&both, &packets), probed(&clip, &packets));
    let sync = probed(&both, &["-select_streams", "v:1", "-show_entries", "packet=flags", "-of", "csv=p=0"]);
    let planes = done(&["inspect", path(&both)]);
    let kinds: Vec<bool> =
        planes.lines().filter_map(|line| line.split_whitespace().nth(1)).map(|kind| kind == "I").collect();
    let flags: Vec<bool> = sync.lines().map(|flags| flags.starts_with('K')).collect();
    assert!(flags.len() > 75 && flags == kinds[..flags.len()], "{planes}");
    assert!(flags.iter().filter(|&&sync| sync).count() >= 2, "{sync}");
    assert_eq!(Motion::read(&both).unwrap().clip.frames.len(), 150);
}

/// B pictures are shown later than they are decoded; an edit list takes that back, where there is one.
#[cfg(feature = "h264")]
#[test]
#[ignore = "needs ffmpeg and ffprobe"]
fn the_stream_begins_with_the_first_picture_of_the_clip_beside_it() {
    use handcast_media::FrameSource as _;
    let (folder, poses) = folder();
    let at = |name: &str| folder.path().join(name);
    let coded = ["-t", "4", "-c:v", "libx264", "-preset", "ultrafast", "-pix_fmt", "yuv420p"];
    let cases: [(&[&str], f64); 4] = [
        (&["-vf", "fps=10", "-bf", "0"], 0.0),
        (&["-vf", "fps=10", "-bf", "3"], 0.0),
        (&["-vf", "fps=10", "-bf", "3", "-use_editlist", "0"], 0.2),
        (&["-vf", "fps=10,setpts=PTS+1.5/TB", "-bf", "3"], 1.5),
    ];
    for (how, expected) in cases {
        let (clip, both) = (at("clip.mp4"), at("both.mp4"));
        let made = Command::new("ffmpeg")
            .args(["-nostdin", "-v", "error", "-y"])
            .args(["-i", "fixtures/demo.avi"])
            .args(coded)
            .args(how)
            .arg(&clip)
            .output()
            .unwrap();
        assert!(made.status.success(), "{}", text(&made.stderr));
        let told = handcast_media::open(&clip, &Default::default()).unwrap().info().start;
        assert!((told - expected).abs() < 2e-3, "{how:?}: {told}");
        // From the poses, and from the file that then has both.
        let again = at("again.mp4");
        for (from, to) in [(&poses, &both), (&both, &again)] {
            done(&["encode", path(from), "-o", path(to), "--clip", path(&clip), "-q"]);
            let starts = probed(to, &["-show_entries", "stream=start_time", "-of", "csv=p=0"]);
            let starts: Vec<f64> =
                starts.lines().map(|line| line.trim_end_matches(',').parse().unwrap()).collect();
            assert_eq!(starts.len(), 2);
            assert!(starts.iter().all(|start| (start - expected).abs() < 2e-3), "{how:?}: {starts:?}");
        }
    }
}

/// FFmpeg cannot copy the track: the way that `spec/usage.md` tells is round it.
#[test]
#[ignore = "needs the shared material, ffmpeg and ffprobe"]
fn ffmpeg_copies_a_clip_from_beside_its_stream_which_is_put_back() {
    let (folder, poses) = folder();
    let at = |name: &str| folder.path().join(name);
    let clip = shared("data/clips/counting.mp4");
    let (x, fba) = (at("x.mp4"), at("hand.fba"));
    done(&["encode", path(&poses), "-o", path(&x), "--clip", path(&clip), "-q"]);
    done(&["encode", path(&x), "-o", path(&fba), "--copy", "-q"]);
    let stream = |file: &Path| stream_in(&std::fs::read(file).unwrap()).unwrap();
    assert_eq!(stream(&x).unwrap(), std::fs::read(&fba).unwrap());
    for without in [&["-map", "0", "-map", "-0:m:handler_name:FBA stream"][..], &[]] {
        let (y, z) = (at("y.mp4"), at("z.mp4"));
        let mut ffmpeg = Command::new("ffmpeg");
        ffmpeg.args(["-nostdin", "-v", "error", "-y", "-i"]).arg(&x).args(without);
        let made = ffmpeg.args(["-c", "copy"]).arg(&y).output().unwrap();
        assert!(made.status.success(), "{}", text(&made.stderr));
        assert_eq!(stream(&y), None);
        done(&["encode", path(&fba), "-o", path(&z), "--clip", path(&y), "--copy", "-q"]);
        assert_eq!(stream(&z), stream(&x));
        let codecs = probed(&z, &["-show_entries", "stream=codec_name", "-of", "csv=p=0"]);
        assert_eq!(codecs.lines().collect::<Vec<_>>(), ["h264", "aac", "mpeg4"]);
    }
}
