//! What the commands that track a clip share: arguments, progress, overlay and summary.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow, bail};
use handcast_corpus::TrackSettings;
use handcast_formats::landmarks::{ImagePoints, LandmarkClip, LandmarkFrame};
use handcast_formats::person::read_person;
use handcast_hand::landmarks::LANDMARKS_21;
use handcast_hand::smooth::SmoothOptions;
use handcast_hand::{Absence, ClipHand, Morphology, Person, PoseClip, PoseHeader, Side};
use handcast_media::{ClipInfo, FrameSource, OpenOptions};
use handcast_net::files::Bundle;
use handcast_net::hands::{NetFinder, NetFinderOptions};
use handcast_render::GOOD_CONFIDENCE;
use handcast_track::View;
use handcast_track::pipeline::{
    ClipError, ClipOptions, ClipSink, FinderSource, HandStart, Start, TrackedClip, TrackedFrame, TrackedHand,
    track_clip,
};
use handcast_vision::sighting::{ReadySightings, Region, Sighting};
use indicatif::{ProgressBar, ProgressStyle};

use super::common::{FaceOrAuto, HandOrAuto, field_of_view, hand_length, progress};
use super::length;
use super::message;
use super::net::NetArgs;
use super::overlay::{Finished, Overlay};
use super::poses_out::Lines;
use super::resume::Resumed;

/// How a clip is tracked.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Tracking")]
pub struct TrackArgs {
    /// Folder or glob of ready masks, one a frame, white is hand
    #[arg(long, value_name = "DIR", conflicts_with = "net")]
    mask: Option<PathBuf>,
    /// Track this hand alone; auto tracks one or two, and tells which is which from thumbs and places
    #[arg(long, value_enum, default_value = "auto")]
    hand: HandOrAuto,
    /// Which face of the hand the camera sees; auto takes the palm, or what hand and thumb tell
    #[arg(long, value_enum, default_value = "auto")]
    view: FaceOrAuto,
    /// The clip is a mirrored selfie view: its pictures are mirrored back before anything else
    #[arg(long)]
    mirror: bool,
    /// Sizes of the person's hands, instead of those measured in the clip; if no hand is ever open, tracking
    /// starts from any posture
    #[arg(long, value_name = "FILE")]
    person: Option<PathBuf>,
    /// Start from the first open hand; with any, from any posture where the first frames show none open
    #[arg(long, value_enum, default_value = "open")]
    start: StartArg,
    /// Smooth the poses as they come (1€ filter): cut-off at rest in Hz, and its growth in Hz per degree per
    /// second [default when given alone: 1,0.05]
    #[arg(
        long,
        value_name = "MIN_CUTOFF,BETA",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "1,0.05",
        value_parser = smoothing
    )]
    smooth: Option<SmoothOptions>,
    /// Wrist to middle fingertip, millimetres [default: 189]
    #[arg(long, value_name = "MM", value_parser = hand_length)]
    hand_length_mm: Option<f64>,
    /// Joints that another tracker found in the clip, with their places in its pictures; they find the hand in place
    /// of networks
    #[arg(long, value_name = "FILE.landmarks.jsonl", conflicts_with_all = ["net", "no_net", "mask", "mirror"])]
    joints: Option<PathBuf>,
    #[command(flatten)]
    net: NetArgs,
    /// Use no networks to find hands, even where they are
    #[arg(long, conflicts_with_all = ["net", "lite"])]
    no_net: bool,
    #[arg(skip)]
    given_net_only: bool,
    /// Degrees the camera sees across the longer side
    #[arg(long, value_name = "DEG", default_value_t = 60.0, value_parser = field_of_view)]
    fov: f64,
    /// Threads for the trackers of two hands, 1 or 2; the result is the same
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u8).range(1..=2))]
    threads: u8,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
    /// No progress bar, no report on standard output
    #[arg(short, long)]
    pub quiet: bool,
}

/// What tracking starts from.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum StartArg {
    Open,
    Any,
}

/// The error with how to get round it, where there is a way.
fn advised(error: ClipError) -> anyhow::Error {
    let advice = "the sizes are given by --person FILE, which `handcast fit` makes of one picture";
    match error {
        ClipError::NeverOpen { .. } => anyhow!("{error}; {advice}"),
        other => other.into(),
    }
}

/// `MIN_CUTOFF,BETA`.
pub fn smoothing(text: &str) -> Result<SmoothOptions, String> {
    let parts: Option<(f64, f64)> =
        text.split_once(',').and_then(|(a, b)| Some((a.trim().parse().ok()?, b.trim().parse().ok()?)));
    match parts {
        Some((cutoff, beta)) if (0.01..=100.0).contains(&cutoff) && (0.0..=10.0).contains(&beta) => {
            Ok(SmoothOptions::default().with(cutoff, beta))
        }
        _ => Err("two numbers: cut-off frequency (0.01 to 100 Hz), growth (0 to 10), as in 1,0.05".into()),
    }
}

/// The joints of a file of landmarks as sightings in the pictures of `clip`.
fn read_sightings(path: &Path, clip: &ClipInfo) -> anyhow::Result<ReadySightings> {
    let landmarks = LandmarkClip::read(path)?;
    let right = landmarks.side.map_or(0.5, |side| if side == Side::Right { SURE } else { 1.0 - SURE });
    let joints = |image: &ImagePoints| {
        let points = LANDMARKS_21.map(|joint| image[joint.index()].map(|p| [p.x, p.y]));
        points.iter().all(Option::is_some).then(|| points.map(Option::unwrap_or_default))
    };
    let sighted = |frame: &LandmarkFrame| {
        let points = joints(frame.image.as_ref()?)?;
        let region = Region::of_joints(&points);
        Some((frame.time, vec![Sighting { points, world: None, presence: 1.0, right, region, age: 0 }]))
    };
    let frames: Vec<_> = landmarks.frames.iter().filter_map(sighted).collect();
    if frames.is_empty() {
        bail!("{}: no frame has `image`, the places of all 21 joints in the picture", path.display());
    }
    let rate = clip.rate.or(landmarks.rate).unwrap_or(FALLBACK_RATE);
    Ok(ReadySightings::new(frames, 0.75 / rate).in_pictures_of(clip.width))
}

/// Probability of a side that a file of landmarks names.
const SURE: f64 = 0.98;
/// Joints that move by less than this share of the hand's length from frame to frame are looked for in every second
/// one: what a network's joints are off by.
const STEADY: f64 = 0.02;
/// Frames per second of clip and landmarks that both do not say.
const FALLBACK_RATE: f64 = 30.0;

/// What made the poses.
fn made_by() -> String {
    format!("handcast {}", env!("CARGO_PKG_VERSION"))
}

/// A tracked clip, and what else came of tracking it.
pub struct Tracked {
    pub clip: TrackedClip,
    /// The overlay, complete but not yet under its name.
    pub overlay: Option<Finished>,
    begun: Instant,
}

/// The frames of a clip, and its ready masks.
pub type Frames = (Box<dyn FrameSource>, Option<Box<dyn FrameSource>>);

impl TrackArgs {
    /// Tracks `path`; `rate` is that of clips which do not say, `overlay` is drawn and `lines` are written while it
    /// goes on. With what a run before has left, and its journal, only the rest is tracked.
    pub fn track(
        &self,
        path: &Path,
        rate: f64,
        overlay: Option<PathBuf>,
        lines: Option<Lines>,
        resumed: Option<(&Resumed, &Path)>,
    ) -> anyhow::Result<Tracked> {
        let begun = Instant::now();
        let (mut source, masks) = self.open(path, rate)?;
        let mut options = self.options(source.info())?;
        if path.as_os_str() == "-" && lines.as_ref().is_some_and(Lines::flow) {
            // What goes from pipe to pipe may be live, and cannot wait for fingers to bend.
            options.tuning.contest.undecided = 0;
        }
        if let Some((resumed, journal)) = resumed {
            source = resumed.rest(source);
            options.person = options.person.or_else(|| resumed.person());
            resumed.keep(journal)?;
        }
        let mut sink = Sink::new(self, path, overlay, lines, rate, source.as_ref());
        if let (Some((resumed, _)), Some((_, header))) = (resumed, &mut sink.lines) {
            header.hands = resumed.hands();
        }
        let clip = track_clip(source, masks, &options, &mut sink).map_err(advised)?;
        let overlay = sink.finish()?;
        Ok(Tracked { clip, overlay, begun })
    }

    /// Opens a clip and its masks.
    pub fn open(&self, path: &Path, rate: f64) -> anyhow::Result<Frames> {
        if !(rate.is_finite() && rate > 0.0) {
            bail!("--input-fps {rate}: allowed are positive rates");
        }
        let open = OpenOptions::default().with_rate(rate);
        let source = handcast_media::open(path, &open)?;
        Ok((source, self.mask.as_ref().map(|dir| handcast_media::open(dir, &open)).transpose()?))
    }

    /// A bar for the frames of a clip, where one is wanted.
    pub fn progress(&self, path: &Path, source: &dyn FrameSource) -> ProgressBar {
        let show = !self.quiet && !self.json;
        progress(show, if show { length::frames(path, source.info()) } else { None })
    }

    /// The options of the pipeline for a clip.
    pub fn options(&self, clip: &ClipInfo) -> anyhow::Result<ClipOptions> {
        let mut options = ClipOptions::default();
        options.person = self.person.as_deref().map(read_person).transpose()?;
        options.side = self.hand.known();
        options.view = self.view.known();
        options.mirror = self.mirror;
        options.start = match self.start {
            StartArg::Open => Start::Open,
            StartArg::Any => Start::Any,
        };
        options.smooth = self.smooth;
        options.threads = self.threads.into();
        if let Some(length) = self.hand_length_mm {
            options.hand_length = length;
        }
        options.field_of_view = self.fov;
        options.finder = self.finder(clip)?;
        Ok(options)
    }
}

impl TrackArgs {
    /// What is asked for as data, for all clips of a corpus, and what finds hands in them.
    pub fn settings(&self) -> anyhow::Result<(TrackSettings, Option<FinderSource>)> {
        if let Some(path) = self.mask.as_ref().or(self.joints.as_ref()) {
            bail!("{}: masks and joints are of one clip, not of a corpus", path.display());
        }
        let bundle = if self.no_net { None } else { self.net.look()? };
        let settings = TrackSettings {
            hand: self.hand.known(),
            view: self.view.known(),
            mirror: self.mirror,
            start_any: matches!(self.start, StartArg::Any),
            person: self.person.as_deref().map(read_person).transpose()?,
            smooth: self.smooth.map(|smooth| [smooth.min_cutoff, smooth.beta]),
            hand_length: self.hand_length_mm.unwrap_or(TrackSettings::default().hand_length),
            field_of_view: self.fov,
            finder: bundle
                .as_ref()
                .map(|found| format!("{} {}", found.palms.digest(), found.landmarks.digest())),
        };
        Ok((settings, bundle.as_ref().map(found_by).transpose()?))
    }

    /// Uses networks only where they are given, not those that the machine has.
    pub fn keep_to_given_net(&mut self) {
        self.given_net_only = true;
    }

    /// What finds hands: joints that are ready, the networks given, or those that are there.
    fn finder(&self, clip: &ClipInfo) -> anyhow::Result<Option<FinderSource>> {
        if let Some(path) = &self.joints {
            let ready = read_sightings(path, clip)?;
            return Ok(Some(FinderSource::new(move || Box::new(ready.clone()))));
        }
        if self.no_net || self.mask.is_some() {
            return Ok(None);
        }
        if self.given_net_only && !self.net.is_given() {
            return Ok(None);
        }
        self.net.look()?.as_ref().map(found_by).transpose()
    }
}

/// Networks as a finder of hands.
fn found_by(bundle: &Bundle) -> anyhow::Result<FinderSource> {
    let finder = NetFinder::new(bundle, NetFinderOptions::default().with_steady(STEADY))?;
    Ok(FinderSource::new(move || Box::new(finder.clone())))
}

impl Tracked {
    /// The poses.
    pub fn poses(&self) -> PoseClip {
        let mut header = self.clip.header();
        header.made_by = Some(made_by());
        PoseClip { header, frames: self.clip.poses() }
    }

    /// Sizes for what has none of its own: those of the first hand.
    pub fn morphology(&self) -> Morphology {
        self.clip.hands.first().map_or_else(Morphology::default, |h| h.start.morphology.clone())
    }

    /// The person, as the best fit tells.
    pub fn person(&self) -> Option<Person> {
        let iou = |h: &&TrackedHand| h.start.fit.as_ref().map_or(0.0, |fit| fit.iou);
        let best = self.clip.hands.iter().rev().max_by(|a, b| iou(a).total_cmp(&iou(b)))?;
        Some(Person { name: None, hand: Some(best.start.side), morphology: best.start.morphology.clone() })
    }

    /// What is to be told of the clip called `name`.
    pub fn summary(&self, name: &str) -> Summary {
        let clip = &self.clip;
        let n = clip.times.len();
        let rate = |time| per_second(n, time);
        let touching = clip.hands.first().map_or_else(Vec::new, |h| ranges(h.absent(Absence::Touching)));
        Summary {
            clip: name.to_owned(),
            frames: n,
            hands: clip.hands.iter().map(HandSummary::new).collect(),
            touching,
            skin_tone: clip.skin_tone,
            tracking_fps: Speed {
                decode: rate(clip.timings.decode),
                segment: rate(clip.timings.segment),
                track: rate(clip.timings.track),
                overlay: self.overlay.as_ref().map(|overlay| rate(overlay.time)),
                whole: rate(self.begun.elapsed()),
            },
        }
    }
}

/// What became of a clip. The fields are the keys of the JSON report.
#[derive(Debug, serde::Serialize)]
pub struct Summary {
    pub clip: String,
    pub frames: usize,
    pub hands: Vec<HandSummary>,
    /// First and last frames of the stretches in which two hands touch, and both are held.
    pub touching: Vec<[usize; 2]>,
    /// The tone of the skin, 1 (lightest) to 10; `null` where no hand was sure.
    pub skin_tone: Option<u8>,
    /// Frames per second of each stage.
    pub tracking_fps: Speed,
}

/// Frames per second of each stage of tracking, and of all up to the poses.
#[derive(Debug, serde::Serialize)]
pub struct Speed {
    pub decode: f64,
    pub segment: f64,
    pub track: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub overlay: Option<f64>,
    pub whole: f64,
}

/// What became of one hand. Stretches of frames are given by their first and last.
#[derive(Debug, serde::Serialize)]
pub struct HandSummary {
    pub hand: &'static str,
    pub view: View,
    pub view_assumed: bool,
    /// The frame from which it is tracked both ways.
    pub start_frame: usize,
    /// Overlap of the fit with the open hand; `null` when tracking started from another posture.
    pub fit_iou: Option<f64>,
    pub tracked_frames: usize,
    pub lost_frames: usize,
    pub mean_iou: f64,
    pub worst_iou: f64,
    pub worst_frame: usize,
    /// Over the frames in which it was tracked.
    pub mean_confidence: f64,
    /// Tracked frames of a confidence below 0.5.
    pub low_confidence: Vec<[usize; 2]>,
    pub lost: Vec<[usize; 2]>,
    /// Frames before it was first seen open, which were not tracked.
    pub not_yet: Vec<[usize; 2]>,
    pub evaluations_per_frame: f64,
    pub restarts: usize,
    /// Unsteadiness of the poses without and with smoothing, degrees.
    pub jitter_deg: Option<[f64; 2]>,
}

/// Frames per second.
pub fn per_second(frames: usize, time: Duration) -> f64 {
    frames as f64 / time.as_secs_f64().max(1e-9)
}

/// Runs of consecutive numbers.
fn ranges(frames: impl Iterator<Item = usize>) -> Vec<[usize; 2]> {
    let mut out: Vec<[usize; 2]> = Vec::new();
    for i in frames {
        match out.last_mut() {
            Some([_, last]) if *last + 1 == i => *last = i,
            _ => out.push([i, i]),
        }
    }
    out
}

/// Stretches of frames in words: at most so many, then how many more.
fn listed(ranges: &[[usize; 2]]) -> String {
    const MOST: usize = 12;
    let each = ranges.iter().take(MOST);
    let mut text = each
        .map(|[a, b]| if a == b { a.to_string() } else { format!("{a}-{b}") })
        .collect::<Vec<_>>()
        .join(", ");
    if ranges.len() > MOST {
        let _ = write!(text, " and {} more", ranges.len() - MOST);
    }
    text
}

impl HandSummary {
    fn new(hand: &TrackedHand) -> Self {
        let frames = &hand.frames;
        let tracked = hand.tracked_frames();
        let (mean_iou, worst_iou, worst_frame) = hand.iou();
        let valid = || frames.iter().enumerate().filter(|(_, f)| f.tracked.valid);
        let lost = ranges(hand.absent(Absence::Lost));
        Self {
            hand: hand.start.side.name(),
            view: hand.start.view,
            view_assumed: hand.start.assumed,
            start_frame: hand.start.frame,
            fit_iou: hand.start.fit.as_ref().map(|fit| fit.iou),
            tracked_frames: tracked,
            lost_frames: lost.iter().map(|[a, b]| b - a + 1).sum(),
            mean_iou,
            worst_iou,
            worst_frame,
            mean_confidence: valid().map(|(_, f)| f.confidence).sum::<f64>() / tracked.max(1) as f64,
            low_confidence: ranges(valid().filter(|(_, f)| f.confidence < GOOD_CONFIDENCE).map(|(i, _)| i)),
            lost,
            not_yet: ranges(hand.absent(Absence::NotYet)),
            evaluations_per_frame: frames.iter().map(|f| f.tracked.evaluations).sum::<usize>() as f64
                / frames.len().max(1) as f64,
            restarts: frames.iter().filter(|f| f.tracked.restarted).count(),
            jitter_deg: hand.jitter().map(|(before, after)| [before, after]),
        }
    }

    fn text(&self, t: &mut String, smooth: bool) {
        let view = if self.view == View::Palm { "palm" } else { "back" };
        let assumed = if self.view_assumed { " (assumed; see --hand, --view)" } else { "" };
        let start = match self.fit_iou {
            Some(iou) => format!("fitted on frame {}, overlap {iou:.3}", self.start_frame),
            None => format!("started from any posture on frame {}", self.start_frame),
        };
        let _ = writeln!(t, "  hand        {}, {view}{assumed}; {start}", self.hand);
        let _ = write!(t, "    tracked   {} frames", self.tracked_frames);
        for (what, list) in [("lost", &self.lost), ("not seen open before", &self.not_yet)] {
            if !list.is_empty() {
                let _ = write!(t, "; {what} {}", listed(list));
            }
        }
        let _ = writeln!(
            t,
            "\n    overlap   mean IoU {:.3}, worst {:.3} (frame {})",
            self.mean_iou, self.worst_iou, self.worst_frame
        );
        let _ = write!(t, "    sure      confidence {:.2} on average", self.mean_confidence);
        if !self.low_confidence.is_empty() {
            let _ = write!(t, "; below {GOOD_CONFIDENCE} in frames {}", listed(&self.low_confidence));
        }
        let _ = writeln!(t);
        if let (true, Some([before, after])) = (smooth, self.jitter_deg) {
            let _ = writeln!(t, "    smoothed  jitter {before:.2}° before, {after:.2}° after");
        }
    }
}

impl Summary {
    /// For people.
    pub fn text(&self, args: &TrackArgs) -> String {
        let mut t = String::new();
        let tracked: usize = self.hands.iter().map(|h| h.tracked_frames).sum();
        match &self.hands[..] {
            [_] => {
                let _ = writeln!(t, "{}: {tracked} of {} frames tracked", self.clip, self.frames);
            }
            hands => {
                let _ = writeln!(t, "{}: {} hands in {} frames", self.clip, hands.len(), self.frames);
            }
        }
        for hand in &self.hands {
            hand.text(&mut t, args.smooth.is_some());
        }
        if !self.touching.is_empty() {
            let _ = writeln!(t, "  touching    frames {}: both hands held", listed(&self.touching));
        }
        if let Some(tone) = self.skin_tone {
            let _ = writeln!(t, "  skin        tone {tone} of 10");
        }
        t
    }

    /// The line about speed, for people; `more` are further stages.
    pub fn speed(&self, more: &str) -> String {
        let f = &self.tracking_fps;
        format!(
            "  frames/s    decode {:.0}, segment {:.0}, track {:.0}{more}; whole run {:.1}\n",
            f.decode, f.segment, f.track, f.whole
        )
    }
}

/// The progress bar and the overlay.
struct Sink {
    bar: ProgressBar,
    /// Poses on standard output while they are found, where that is wanted.
    lines: Option<(Lines, PoseHeader)>,
    /// `None` when no overlay is wanted.
    overlay: Option<Overlay>,
}

impl Sink {
    fn new(
        args: &TrackArgs,
        path: &Path,
        overlay: Option<PathBuf>,
        lines: Option<Lines>,
        rate: f64,
        source: &dyn FrameSource,
    ) -> Self {
        let bar = args.progress(path, source);
        // How long it will take is known where the number of frames is.
        let template = match bar.length() {
            Some(_) => "{msg:10} {wide_bar} {pos}/{len} {per_sec} {eta}",
            None => "{msg:10} {spinner} {pos} frames, {per_sec}, {elapsed}",
        };
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        bar.set_message("looking");
        let header =
            PoseHeader { rate: source.info().rate, made_by: Some(made_by()), ..PoseHeader::default() };
        let rate = source.info().rate.unwrap_or(rate);
        let lines = lines.map(|lines| (lines, header));
        Self { bar, lines, overlay: overlay.map(|path| Overlay::new(path, rate)) }
    }

    fn finish(self) -> anyhow::Result<Option<Finished>> {
        self.bar.finish_and_clear();
        let finished = self.overlay.map(|overlay| overlay.finish().context("overlay")).transpose()?;
        Ok(finished.flatten())
    }
}

impl ClipSink for Sink {
    fn read(&mut self, index: usize) -> Result<(), String> {
        self.bar.set_position(index as u64 + 1);
        Ok(())
    }

    fn fitted(&mut self, start: &HandStart) {
        self.bar.set_message("tracking");
        if let Some((_, header)) = &mut self.lines
            && header.hand(start.side).is_none()
        {
            header.hands.push(ClipHand { side: start.side, morphology: Some(start.morphology.clone()) });
        }
    }

    fn tracked(&mut self, mut frame: TrackedFrame<'_>) -> Result<(), String> {
        if let Some((lines, header)) = &mut self.lines {
            let poses = frame.hands.iter().map(|hand| hand.found.timed(frame.time));
            lines.write(|| header.clone(), poses).map_err(|e| message(&e))?;
        }
        match &mut self.overlay {
            Some(overlay) => overlay.draw(&mut frame).map_err(|e| format!("overlay: {}", message(&e))),
            None => Ok(()),
        }
    }
}
