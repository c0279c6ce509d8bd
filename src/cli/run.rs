//! `handcast run` and `handcast demo`: a clip of a hand to a stream and an animated hand, with a report.

use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use handcast_codec::notices;
use handcast_codec::{
    DecodedStream, EncodedClip, PoseDecoderOptions, TipError, clip_rate, decode_poses_within, encode_bridged,
};
use handcast_corpus::RUN_RESULTS;
use handcast_eval::fidelity::{AngleError, angle_error};
use handcast_fba::DecoderOptions;
use handcast_formats::atomic::AtomicFile;
use handcast_formats::motion::Format;
use handcast_formats::person::write_person;
use handcast_formats::poses::write_poses;
use handcast_formats::unfinished::{Kind, Unfinished};
use handcast_hand::{HandMesh, PoseClip, PoseHeader, Skeleton};
use handcast_media::Part;
use handcast_render::{Style, contact_sheet, preview_sheet};
use image::codecs::png::PngEncoder;
use image::{Rgba, RgbaImage};

use super::common::{RateArgs, busy, check_span, ending, limits, warn_of_uneven_times};
use super::decode::stream_facts;
use super::demo_clip;
use super::encode::{off, tips_mm};
use super::glb_out::GlbArgs;
use super::overlay;
use super::part::PartArgs;
use super::poses_out::Journal;
use super::summary::{Summary, per_second};
use super::tracking::{Poses, TrackArgs, Tracked};
use super::unnamed;
use super::usage::positive;

/// Tracks the hands in a clip and writes stream, animated hand, overlay, preview and report
#[derive(Debug, clap::Args)]
pub struct Args {
    /// MP4/MOV, AVI, animated GIF/PNG/WebP, Y4M (- for standard input), a folder, "glob" or %03d pattern of pictures
    clip: PathBuf,
    #[command(flatten)]
    work: Work,
    #[command(flatten)]
    part: PartArgs,
}

/// Does what run does, with the clip built into the program, whose true poses are known
#[derive(Debug, clap::Args)]
pub struct DemoArgs {
    #[command(flatten)]
    work: Work,
}

/// The poses in the output folder.
const POSES: &str = "poses.jsonl";

/// What both do.
#[derive(Debug, clap::Args)]
struct Work {
    /// Folder for the results
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Frames per second of inputs that do not say (folders)
    #[arg(long, value_name = "HZ", default_value_t = 30.0, value_parser = positive)]
    input_fps: f64,
    /// Leave out the overlay and the preview
    #[arg(long)]
    no_pictures: bool,
    #[command(flatten)]
    track: TrackArgs,
    #[command(flatten)]
    rate: RateArgs,
    #[command(flatten)]
    glb: GlbArgs,
}

/// Runs `handcast run`.
pub fn run(mut args: Args) -> anyhow::Result<()> {
    args.work.output.get_or_insert_with(|| unnamed::folder_of(&args.clip));
    let name = args.clip.display().to_string();
    let part = args.part.part()?;
    args.work.in_output(|work| work.run(&args.clip, &name, part, None))
}

/// Runs `handcast demo`.
pub fn demo(mut args: DemoArgs) -> anyhow::Result<()> {
    // The same on every machine, unless networks are given.
    args.work.track.keep_to_given_net();
    args.work.in_output(|work| {
        let clip = work.folder().join("demo.avi");
        demo_clip::write(&clip)?;
        work.run(&clip, "the built-in clip", Part::WHOLE, Some(demo_clip::poses()?))
    })
}

/// What is known of a finished run. The fields are the keys of report.json.
#[derive(Debug, serde::Serialize)]
struct Report {
    #[serde(flatten)]
    tracking: Summary,
    seconds: f64,
    frames_per_second: f64,
    stream_bytes: usize,
    kbit_per_s: f64,
    planes: u64,
    /// Poses interpolated in gaps.
    bridged: usize,
    coding_rms_deg: f64,
    coding_max_deg: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    tips_mm: Option<serde_json::Value>,
    #[serde(skip)]
    tips: Option<TipError>,
    /// Where true poses are known; `null` where none of them is of a hand that was tracked.
    #[serde(skip_serializing_if = "Option::is_none")]
    truth: Option<Option<AngleError>>,
    /// Frames per second of what comes after tracking; of the whole see `tracking_fps`.
    fps: Stages,
    wall_seconds: f64,
}

#[derive(Debug, serde::Serialize)]
struct Stages {
    encode: f64,
    decode_stream: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    gltf: Option<f64>,
}

impl Report {
    fn text(&self, smooth: bool) -> String {
        use std::fmt::Write as _;
        let mut t = self.tracking.text(smooth);
        match &self.truth {
            Some(Some(AngleError { angles, mean_deg, rms_deg, .. })) => {
                let _ = writeln!(
                    t,
                    "  truth       its {angles} joint angles that are not always 0 are {mean_deg:.2}° off on average, \
                     {rms_deg:.2}° RMS"
                );
            }
            Some(None) => t.push_str("  truth       not compared: no true pose is of this hand\n"),
            None => {}
        }
        let _ = writeln!(
            t,
            "  stream      {} bytes, {:.2} kbit/s; coding error {:.2}° RMS, {:.2}° at most",
            self.stream_bytes, self.kbit_per_s, self.coding_rms_deg, self.coding_max_deg
        );
        if let Some(tips) = &self.tips {
            let _ = writeln!(t, "    fingertips {}", off(tips));
        }
        let f = &self.fps;
        let gltf = f.gltf.map_or_else(String::new, |gltf| format!(", glTF {gltf:.0}"));
        let more = format!(", encode {:.0}, decode stream {:.0}{gltf}", f.encode, f.decode_stream);
        t + &self.tracking.speed(&more)
    }
}

impl Work {
    fn folder(&self) -> &Path {
        self.output.as_deref().unwrap_or(Path::new(unnamed::DEMO))
    }

    /// Makes the output folder for the work, and takes it away again if the work fails and leaves it empty.
    fn in_output(&self, work: impl FnOnce(&Self) -> anyhow::Result<()>) -> anyhow::Result<()> {
        let folder = self.folder();
        let ending = ending(folder);
        let names_a_file = ["fba", "mp4", "bap", "png"].contains(&ending.as_str())
            || Format::written().any(|format| format.ending == format!(".{ending}"));
        if (names_a_file || folder.as_os_str() == "-") && !folder.is_dir() {
            refuse!(
                "{}: a folder is written, with stream, animated hand, poses, overlay, preview and report; for one file there \
                 is `handcast track CLIP -o FILE`",
                folder.display()
            );
        }
        let fresh = !folder.exists();
        let make = || std::fs::create_dir_all(folder);
        let (made, guard) = Unfinished::made(Kind::EmptyFolder, make, |()| folder.to_owned());
        made.with_context(|| format!("cannot make the folder {}", folder.display()))?;
        // One that was there stays.
        let _guard = fresh.then_some(guard);
        let result = work(self);
        if result.is_err() && fresh {
            // Fails, as it should, when there is something in it.
            let _ = std::fs::remove_dir(folder);
        }
        result
    }

    /// The surfaces of the hands, where pictures are wanted.
    fn meshes(&self, header: &PoseHeader) -> Vec<HandMesh> {
        let hands = header.hands.iter().filter(|_| !self.no_pictures);
        hands
            .map(|hand| HandMesh::generate(&hand.morphology.clone().unwrap_or_default(), hand.side))
            .collect()
    }

    /// The stream, and the time it took.
    fn encode(&self, poses: &PoseClip) -> anyhow::Result<(EncodedClip, Duration)> {
        let begun = Instant::now();
        let profile = self.rate.profile.into();
        notices::of_poses(poses, profile, self.rate.max_gap())
            .iter()
            .for_each(|notice| errln!("handcast: {notice}"));
        let without = self.rate.no_sizes.then(|| {
            let mut poses = poses.clone();
            poses.header.forget_person();
            poses
        });
        check_span(poses, clip_rate(poses))?;
        let poses_sent = without.as_ref().unwrap_or(poses);
        let encoded = encode_bridged(poses_sent, profile, &self.rate.plan(), self.rate.max_gap())?;
        if let Some(rate) = encoded.clip.header.rate {
            warn_of_uneven_times(poses, rate);
        }
        Ok((encoded, begun.elapsed()))
    }

    /// The stream as it comes out of its file, the file's length, and the time that decoding took: from here on only
    /// what the file holds counts.
    fn decoded(&self, path: &Path, poses: &PoseClip) -> anyhow::Result<(DecodedStream, usize, Duration)> {
        let begun = Instant::now();
        let bytes = std::fs::read(path)?;
        let options = DecoderOptions {
            steps: self.rate.steps.into(),
            ranges: self.rate.ranges.into(),
            ..DecoderOptions::default()
        };
        let mut decoded = decode_poses_within(
            &bytes,
            PoseDecoderOptions::default()
                .with_decoder(options)
                .with_profile(Some(self.rate.profile.into()))
                .with_limits(limits()),
        )?;
        let time = begun.elapsed();
        for hand in &mut decoded.clip.header.hands {
            hand.morphology = poses.header.hand(hand.side).and_then(|h| h.morphology.clone());
        }
        decoded.clip.header.made_by = Some(format!("handcast {}", env!("CARGO_PKG_VERSION")));
        Ok((decoded, bytes.len(), time))
    }

    fn write_preview(&self, preview: &RgbaImage) -> anyhow::Result<()> {
        let path = self.folder().join("preview.png");
        let mut file = AtomicFile::create(&path)?;
        preview.write_with_encoder(PngEncoder::new(&mut file))?;
        file.commit().context("cannot write")
    }

    /// Writes what tracking found: the poses, which it gives, sizes, if there are any, and the overlay.
    fn keep_tracked(&self, tracked: &mut Tracked, journal: Journal) -> anyhow::Result<(PoseClip, bool)> {
        let poses = tracked.take_poses();
        write_poses(&self.folder().join(POSES), &poses)?;
        journal.done();
        let person = tracked.person();
        if let Some(person) = &person {
            write_person(&self.folder().join("person.toml"), person)?;
        }
        if let Some(overlay) = tracked.overlay.take() {
            overlay.file.commit()?;
        }
        Ok((poses, person.is_some()))
    }

    fn run(&self, path: &Path, name: &str, part: Part, truth: Option<PoseClip>) -> anyhow::Result<()> {
        let begun = Instant::now();
        // What is wrong with a rig is said before the work.
        self.glb.read()?;
        let overlay =
            (!self.no_pictures).then(|| self.folder().join(format!("overlay.{}", overlay::ENDINGS[0])));
        let mut journal = Journal::beside(&self.folder().join(POSES));
        journal.move_rest()?;
        // All of them are encoded together.
        let poses = Poses { lines: Some(journal.lines(None)), keep: true };
        let mut tracked = journal.of(self.track.track(path, self.input_fps, part, overlay, poses, None))?;
        let bar = busy(!self.track.quiet && !self.track.json, "encoding");
        let mut summary = tracked.summary(name);
        let glb_out = self.glb.read()?.of_tone(tracked.end.skin_tone).named(path);

        let (poses, has_person) = self.keep_tracked(&mut tracked, journal)?;
        // What the preview is drawn of does not depend on the stream.
        let (meshes, encoded) = both(|| self.meshes(&poses.header), || self.encode(&poses));
        let (encoded, encode) = encoded?;
        let plan = &encoded.report;
        let stream_path = self.folder().join("hand.fba");
        AtomicFile::write_all_to(&stream_path, &encoded.stream)?;

        let (decoded, bytes, decode_stream) = self.decoded(&stream_path, &poses)?;
        let coding = angle_error(&encoded.clip, &decoded.clip, decoded.rate);
        let sent = encoded.clip.frames.iter().filter(|f| f.valid).count();
        if coding.frames < sent {
            bail!("only {} of {sent} poses came back out of the stream", coding.frames);
        }

        bar.set_message("drawing");
        let export = || -> anyhow::Result<_> {
            let stage = Instant::now();
            let facts = stream_facts(&decoded, bytes);
            let glb = glb_out.write(&decoded.clip, &tracked.morphology(), facts)?;
            AtomicFile::write_all_to(self.folder().join("hand.glb"), &glb)?;
            Ok(stage.elapsed())
        };
        let (exported, preview) = both(export, || preview(&decoded.clip, &meshes, glb_out.skin()));
        if let Some(preview) = preview {
            self.write_preview(&preview)?;
        }

        bar.finish_and_clear();
        let n = summary.frames;
        let per_second = |time| per_second(n, time);
        let wall = begun.elapsed();
        summary.tracking_fps.whole = per_second(wall);
        let report = Report {
            tracking: summary,
            seconds: plan.seconds,
            frames_per_second: decoded.rate,
            stream_bytes: bytes,
            kbit_per_s: plan.kbit_per_s(),
            planes: plan.planes,
            bridged: encoded.bridged,
            coding_rms_deg: coding.rms_deg,
            coding_max_deg: coding.max_deg,
            tips_mm: encoded.tips.map(|tips| tips_mm(&tips)),
            tips: encoded.tips,
            truth: truth.map(|truth| off_truth(&truth, &poses, decoded.rate)),
            fps: Stages {
                encode: per_second(encode),
                decode_stream: per_second(decode_stream),
                gltf: exported.as_ref().ok().copied().map(per_second),
            },
            wall_seconds: wall.as_secs_f64(),
        };
        self.tell(&report)?;
        self.tell_of_leftovers(has_person, exported.is_ok());
        // A rig may have none of the hands that were found, which is known only now; the rest is written.
        exported.map(drop)
    }

    /// Says which results in the folder are of a run before this one, which has made none of that name.
    fn tell_of_leftovers(&self, has_person: bool, has_glb: bool) {
        let pictures = !self.no_pictures;
        let overlay = format!("overlay.{}", overlay::ENDINGS[0]);
        let is_old = |name: &&str| match *name {
            "person.toml" => !has_person,
            "hand.glb" => !has_glb,
            "preview.png" => !pictures,
            name if name.starts_with("overlay") => !pictures || name != overlay,
            _ => false,
        };
        let old: Vec<&str> =
            RUN_RESULTS.into_iter().filter(is_old).filter(|name| self.folder().join(name).exists()).collect();
        if !old.is_empty() {
            errln!("handcast: {}: {} left by an earlier run", self.folder().display(), old.join(", "));
        }
    }

    /// Writes the report, and prints it.
    fn tell(&self, report: &Report) -> anyhow::Result<()> {
        let json = serde_json::to_string_pretty(report)?;
        AtomicFile::write_all_to(self.folder().join("report.json"), json.as_bytes())?;
        let text = report.text(self.track.smooths());
        AtomicFile::write_all_to(self.folder().join("report.txt"), text.as_bytes())?;
        if self.track.json {
            outln!("{json}");
        } else if !self.track.quiet {
            out!("{text}");
            outln!("  results     {}", self.folder().display());
        }
        Ok(())
    }
}

/// How far poses are off the true ones; `None` where these are of no hand that was tracked.
fn off_truth(truth: &PoseClip, poses: &PoseClip, rate: f64) -> Option<AngleError> {
    Some(angle_error(truth, poses, rate)).filter(|error| error.frames > 0)
}

/// Does two things at the same time, the first on a thread of its own.
fn both<A: Send, B>(beside: impl FnOnce() -> A + Send, here: impl FnOnce() -> B) -> (A, B) {
    std::thread::scope(|scope| {
        let beside = scope.spawn(beside);
        let here = here();
        (beside.join().unwrap_or_else(|panic| resume_unwind(panic)), here)
    })
}

/// A contact sheet of the decoded hands, one below the other; `None` without meshes.
fn preview(decoded: &PoseClip, meshes: &[HandMesh], skin: Option<[u8; 3]>) -> Option<RgbaImage> {
    let style = Style { skin: skin.unwrap_or(Style::default().skin), ..Style::default() };
    let mut sheets = Vec::new();
    for hand in &decoded.header.hands {
        let Some(mesh) = meshes.iter().find(|mesh| mesh.side == hand.side) else { continue };
        let skeleton = Skeleton::new(&hand.morphology.clone().unwrap_or_default(), hand.side);
        let frames: Vec<_> = decoded.of(hand.side).map(|f| (f.time, skeleton.frames(&f.pose))).collect();
        sheets.push(preview_sheet(mesh, &frames, 12, 4, (320, 320), &style));
    }
    match sheets.len() {
        0 | 1 => sheets.pop(),
        _ => Some(contact_sheet(&sheets, 1, 0, Rgba([255, 255, 255, 255]))),
    }
}
