//! What the commands that track a clip share: arguments, progress, overlay and summary.

use std::fs::Metadata;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, bail};
use handcast_corpus::{Settings, TrackSettings};
use handcast_formats::person::read_person;
use handcast_hand::clip::MAX_RATE;
use handcast_hand::smooth::SmoothOptions;
use handcast_hand::{ClipHand, Morphology, Person, PoseClip, PoseHeader, Side, TimedPose};
use handcast_media::{ClipInfo, FrameSource, Part};
use handcast_net::files::Bundle;
use handcast_net::hands::{NetFinder, NetFinderOptions};
use handcast_track::pipeline::{
    ClipEnd, ClipError, ClipOptions, ClipSink, FinderSource, HandStart, Start, TrackedFrame, check_length,
    track_frames,
};
use handcast_vision::VisionError;
use indicatif::{ProgressBar, ProgressStyle};

use super::beside::{Joints, Nearness};
use super::common::{
    FaceOrAuto, HandOrAuto, field_of_view, hand_length, limits, opening, progress, tell_shortfall,
};
use super::given;
use super::length;
use super::message;
use super::net::NetArgs;
use super::overlay::{Finished, Overlay};
use super::poses_out::Lines;
use super::resume::{self, Newest, Resumed};
use super::summary::{HandTally, Speed, Summary, per_second};

/// How a clip is tracked.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Tracking")]
pub struct TrackArgs {
    /// Folder or glob of ready masks, one a frame, white is hand
    #[arg(long, value_name = "DIR", conflicts_with = "net")]
    mask: Option<PathBuf>,
    /// Hand that the clip shows; auto tells it from thumbs and places, and tracks two where there are two
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
    /// second, or off [default when given alone: 1,0.05; of live without it: 5,0.5]
    #[arg(
        long,
        value_name = "MIN_CUTOFF,BETA",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "1,0.05",
        value_parser = Smoothing::parse
    )]
    smooth: Option<Smoothing>,
    /// Wrist to middle fingertip, millimetres, 50 to 400 [default: 189]
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
    /// Degrees the camera sees across the longer side, 5 to 150
    #[arg(long, value_name = "DEG", default_value_t = 60.0, value_parser = field_of_view)]
    fov: f64,
    /// Threads for the trackers of two hands, 1 or 2; the result is the same
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u8).range(1..=2))]
    threads: u8,
    /// Print the report as JSON
    #[arg(long, help_heading = None::<&'static str>)]
    pub json: bool,
    /// Neither progress nor report; warnings are told all the same
    #[arg(short, long, help_heading = None::<&'static str>)]
    pub quiet: bool,
}

/// The options that say how a clip is tracked, which motions that are there already do not ask.
pub const OF_CLIPS: [&str; 13] = [
    "mask",
    "hand",
    "view",
    "mirror",
    "person",
    "start",
    "smooth",
    "hand_length_mm",
    "joints",
    "net",
    "no_net",
    "fov",
    "input_fps",
];

/// What tracking starts from.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum StartArg {
    Open,
    Any,
}

/// A clip whose pictures show no hand that can be tracked.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct Refused(String);

/// The error, of the clip called `name`, with how to get round it, where there is a way; `by_colours` says that nothing but
/// colours and motion told where the hand is, `shortfall` what of the clip could not be shown.
fn advised(error: ClipError, name: &Path, by_colours: bool, shortfall: Option<&str>) -> anyhow::Error {
    use ClipError::{BadFit, Empty, Frames, Learn, NeverOpen, NoHand, Option, Person, Sink};
    if !matches!(
        error,
        NeverOpen { .. } | NoHand { .. } | BadFit { .. } | Learn { .. } | Empty | Option { .. } | Person(_)
    ) {
        // Such a clip may have had poses until then. What reads and what writes name their files.
        let named = matches!(error, Frames(_) | Sink(_));
        let error = anyhow::Error::from(error);
        return if named { error } else { error.context(name.display().to_string()) };
    }
    let never_open = matches!(error, NeverOpen { .. });
    let misled =
        matches!(error, NoHand { .. } | BadFit { .. } | Learn { reason: VisionError::NoHand { .. }, .. });
    let mut advice = String::new();
    if never_open {
        advice += "; the sizes are given by --person FILE, which `handcast fit` makes of one picture";
    }
    if by_colours && (never_open || misled) {
        advice += "; networks, of which `handcast net` tells, find hands by more than colours";
    }
    let shortfall = shortfall.map_or_else(String::new, |told| format!(" ({told})"));
    Refused(format!("{}: {error}{shortfall}{advice}", name.display())).into()
}

/// What is said of smoothing poses as they come.
#[derive(Clone, Copy, Debug)]
enum Smoothing {
    Off,
    By(SmoothOptions),
}

impl Smoothing {
    /// `MIN_CUTOFF,BETA` or `off`.
    fn parse(text: &str) -> Result<Self, String> {
        if text == "off" { Ok(Self::Off) } else { smoothing(text).map(Self::By).map_err(|e| e + ", or off") }
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

/// That there is a mask for each frame, where it is known before they are read how many there are.
fn check_masks(masks: &Path, have: &ClipInfo, clip: &Path, want: &ClipInfo) -> anyhow::Result<()> {
    let numbered = want.frames.map(|frames| want.before + frames);
    let Some((have, frames)) = have.frames.zip(numbered).filter(|(have, frames)| have < frames) else {
        return Ok(());
    };
    bail!("{}: {have} masks for the {frames} frames of {}", masks.display(), clip.display());
}

/// What made the poses.
fn made_by() -> String {
    format!("handcast {}", env!("CARGO_PKG_VERSION"))
}

/// A tracked clip, and what else came of tracking it.
pub struct Tracked {
    pub end: ClipEnd,
    /// The poses, where they are kept.
    frames: Vec<TimedPose>,
    tallies: Vec<HandTally>,
    /// The overlay, complete but not yet under its name.
    pub overlay: Option<Finished>,
    /// Width and height of the clip's pictures, pixels.
    pub clip_size: (u32, u32),
    begun: Instant,
}

/// Where poses go while a clip is tracked.
pub struct Poses {
    /// Lines that are passed on as they come.
    pub lines: Option<Lines>,
    /// Whether they are kept besides.
    pub keep: bool,
}

/// The frames of a clip, and its ready masks.
pub type Frames = (Box<dyn FrameSource>, Option<Box<dyn FrameSource>>);

impl TrackArgs {
    /// Tracks `path`; `rate` is that of clips which do not say, `overlay` is drawn and lines are written while it
    /// goes on. With what a run before has left, and its journal, only the rest is tracked.
    pub fn track(
        &self,
        path: &Path,
        rate: f64,
        part: Part,
        overlay: Option<PathBuf>,
        poses: Poses,
        resumed: Option<(&Resumed, &Path)>,
    ) -> anyhow::Result<Tracked> {
        let begun = Instant::now();
        let (mut source, masks) = self.open_part(path, rate, part)?;
        let joints = self.joints(source.as_ref(), part)?;
        let (finder, named) = self.finder(joints.as_ref())?.unzip();
        let mut options = self.options_with(finder)?;
        let work = self.work(path, source.info(), part, named, options.person.clone());
        if path.as_os_str() == "-" && poses.lines.as_ref().is_some_and(Lines::flow) {
            // What goes from pipe to pipe may be live, and cannot wait for fingers to bend.
            options.tuning.contest.undecided = 0;
        }
        if let Some((resumed, journal)) = resumed {
            resumed.check(&work, journal)?;
            source = resumed.rest(source);
            resumed.keep(journal)?;
        }
        let clip_size = (source.info().width, source.info().height);
        let by_colours = options.finder.is_none() && masks.is_none();
        let of_masks = masks.as_ref().and_then(|masks| masks.info().frames);
        let mut sink = Sink::new(self, path, overlay, poses, rate, source.as_ref());
        sink.nearness = joints.map(Nearness::new);
        let newest = Newest::default();
        if let Some((lines, header)) = &mut sink.lines {
            header.hands = resumed.map(|(resumed, _)| resumed.hands()).unwrap_or_default();
            if !lines.flow() {
                sink.journal = Some((work, newest.clone()));
            }
        }
        let end = track_frames(newest.watch(source), masks, &options, &mut sink);
        let end = end.map_err(|error| advised(error, path, by_colours, newest.shortfall()))?;
        tell_shortfall(path, end.shortfall.as_deref());
        if let Some(notice) = sink.nearness.as_ref().and_then(Nearness::notice) {
            errln!("handcast: {notice}");
        }
        let notices = end.notices(self.view.known());
        notices.iter().for_each(|notice| errln!("handcast: {}: {notice}", path.display()));
        if let (Some(dir), Some(masks), true) = (&self.mask, of_masks, part.is_whole())
            && masks > sink.read
        {
            let (dir, name, unused) = (dir.display(), path.display(), masks - sink.read);
            errln!(
                "handcast: {dir}: {masks} masks for the {} frames of {name}: {unused} are not used",
                sink.read
            );
        }
        let (frames, tallies) =
            (std::mem::take(&mut sink.kept).unwrap_or_default(), std::mem::take(&mut sink.tallies));
        let overlay = sink.finish()?;
        if let Some((resumed, journal)) = resumed {
            let sides: Vec<_> = end.hands.iter().map(|start| start.side).collect();
            let same = resumed.check_hands(&sides, journal);
            same.map_err(anyhow::Error::from).or_else(|error| resumed.keep(journal).and(Err(error)))?;
        }
        Ok(Tracked { end, frames, tallies, overlay, clip_size, begun })
    }

    /// The one hand that the clip is said to show.
    pub fn told_side(&self) -> Option<Side> {
        self.hand.known()
    }

    /// How poses are smoothed, where nothing is said of it as usual.
    pub fn smooth_or(&self, usual: Option<SmoothOptions>) -> Option<SmoothOptions> {
        match self.smooth {
            Some(Smoothing::Off) => None,
            Some(Smoothing::By(options)) => Some(options),
            None => usual,
        }
    }

    /// Whether poses are smoothed.
    pub fn smooths(&self) -> bool {
        self.smooth_or(None).is_some()
    }

    /// Opens a clip and its masks.
    pub fn open(&self, path: &Path, rate: f64) -> anyhow::Result<Frames> {
        self.open_part(path, rate, Part::WHOLE)
    }

    /// Opens a part of a clip, and the masks of all of it.
    fn open_part(&self, path: &Path, rate: f64, part: Part) -> anyhow::Result<Frames> {
        let open = opening().with_rate(rate);
        // Masks are told by numbers.
        let part = Part { numbered: self.mask.is_some(), ..part };
        let source = handcast_media::open(path, &open.clone().with_part(part))?;
        // Before networks are loaded, and of all of it where the rest alone is tracked.
        check_length(source.as_ref(), limits()).with_context(|| path.display().to_string())?;
        given::note_idle_rate(path.display(), source.info().rate, rate, "input_fps");
        if let Some(rate) = source.info().rate.filter(|rate| *rate > MAX_RATE) {
            bail!("{}: {rate} pictures per second, allowed are up to {MAX_RATE}", path.display());
        }
        let told = source.info().notices();
        told.iter().for_each(|notice| errln!("handcast: {}: {notice}", path.display()));
        let masks = self.mask.as_ref().map(|dir| handcast_media::open(dir, &open)).transpose()?;
        if let (Some(dir), Some(masks)) = (&self.mask, &masks) {
            check_masks(dir, masks.info(), path, source.info())?;
        }
        Ok((source, masks))
    }

    /// A bar for the frames of a clip, where one is wanted.
    pub fn progress(&self, path: &Path, source: &dyn FrameSource) -> ProgressBar {
        let show = !self.quiet && !self.json;
        progress(show, if show { length::frames(path, source.info()) } else { None })
    }

    /// The joints that are given for a clip, of which `source` reads a part.
    pub fn joints(&self, source: &dyn FrameSource, part: Part) -> anyhow::Result<Option<Joints>> {
        self.joints.as_ref().map(|path| Joints::read(path, source, part)).transpose()
    }

    /// The options of the pipeline for a clip, for which `joints` are given.
    pub fn options(&self, joints: Option<&Joints>) -> anyhow::Result<ClipOptions> {
        self.options_with(self.finder(joints)?.map(|(finder, _)| finder))
    }

    fn options_with(&self, finder: Option<FinderSource>) -> anyhow::Result<ClipOptions> {
        let mut options = ClipOptions::default();
        options.person = self.person.as_deref().map(read_person).transpose()?;
        options.side = self.hand.known();
        options.view = self.view.known();
        options.mirror = self.mirror;
        options.start = match self.start {
            StartArg::Open => Start::Open,
            StartArg::Any => Start::Any,
        };
        options.smooth = self.smooth_or(None);
        options.threads = self.threads.into();
        if let Some(length) = self.hand_length_mm {
            options.hand_length = length;
        }
        options.field_of_view = self.fov;
        options.finder = finder;
        options.limits = limits().clone();
        Ok(options)
    }
}

impl TrackArgs {
    /// What is asked for as data, for all clips of a corpus, and what finds hands in them.
    pub fn settings(&self) -> anyhow::Result<(TrackSettings, Option<FinderSource>)> {
        if let Some(path) = self.mask.as_ref().or(self.joints.as_ref()) {
            refuse!("{}: masks and joints are of one clip, not of a corpus", path.display());
        }
        let bundle = if self.no_net { None } else { self.net.look()? };
        let person = self.person.as_deref().map(read_person).transpose()?;
        let settings = self.settings_with(bundle.as_ref().map(name_of), person);
        Ok((settings, bundle.as_ref().map(found_by).transpose()?))
    }

    /// What is asked for as data; `finder` names what finds hands.
    fn settings_with(&self, finder: Option<String>, person: Option<Person>) -> TrackSettings {
        TrackSettings {
            hand: self.hand.known(),
            view: self.view.known(),
            mirror: self.mirror,
            start_any: matches!(self.start, StartArg::Any),
            person,
            smooth: self.smooth_or(None).map(|smooth| [smooth.min_cutoff, smooth.beta]),
            hand_length: self.hand_length_mm,
            field_of_view: self.fov,
            finder,
            ..TrackSettings::default()
        }
    }

    /// What is tracked, in words that tell it from other clips and from other ways to track it.
    fn work(
        &self,
        path: &Path,
        clip: &ClipInfo,
        part: Part,
        finder: Option<String>,
        person: Option<Person>,
    ) -> String {
        let track = self.settings_with(finder, person);
        let settings = Settings { track, ..Settings::default() }.digest();
        let frames = clip.frames.map_or_else(String::new, |frames| format!(", {frames} frames"));
        let rate = clip.rate.map_or_else(String::new, |rate| format!(", {rate:.3} frames/s"));
        let until = if part.until.is_finite() { format!(" until {} s", part.until) } else { String::new() };
        let part = if part.is_whole() { String::new() } else { format!(", from {} s{until}", part.from) };
        // What is at an address, or a folder, has no size.
        let bytes = std::fs::metadata(path).ok().filter(Metadata::is_file);
        let bytes = bytes.map_or_else(String::new, |file| format!(", {} bytes", file.len()));
        format!(
            "{}, of {}{bytes}, {}x{}{frames}{rate}{part}, options {settings}",
            made_by(),
            clip.format,
            clip.width,
            clip.height
        )
    }

    /// Uses networks only where they are given, not those that the machine has.
    pub fn keep_to_given_net(&mut self) {
        self.given_net_only = true;
    }

    /// What finds hands, and its name: joints that are ready, the networks given, or those that are there.
    fn finder(&self, joints: Option<&Joints>) -> anyhow::Result<Option<(FinderSource, String)>> {
        if let Some(joints) = joints {
            return Ok(Some((joints.finder(), joints.name())));
        }
        if self.no_net || self.mask.is_some() {
            return Ok(None);
        }
        if self.given_net_only && !self.net.is_given() {
            return Ok(None);
        }
        let bundle = self.net.look()?;
        bundle.map(|bundle| Ok((found_by(&bundle)?, name_of(&bundle)))).transpose()
    }
}

/// What tells networks from others.
fn name_of(bundle: &Bundle) -> String {
    format!("{} {}", bundle.palms.digest(), bundle.landmarks.digest())
}

/// Networks as a finder of hands.
fn found_by(bundle: &Bundle) -> anyhow::Result<FinderSource> {
    let finder = NetFinder::new(bundle, NetFinderOptions::for_tracking())?;
    Ok(FinderSource::new(move || Box::new(finder.clone())))
}

impl Tracked {
    /// The header of the poses.
    pub fn header(&self) -> PoseHeader {
        PoseHeader { made_by: Some(made_by()), ..self.end.header() }
    }

    /// The poses that were kept, which are moved out.
    pub fn take_poses(&mut self) -> PoseClip {
        PoseClip { header: self.header(), frames: std::mem::take(&mut self.frames) }
    }

    /// What an instant has of a hand before it was found.
    pub fn not_yet(&self, side: Side, time: f64) -> Option<TimedPose> {
        let hands = self.end.hands.iter().zip(&self.tallies);
        let mut of_side = hands.filter(|(start, _)| start.side == side);
        of_side.next().map(|(_, tally)| tally.not_yet.timed(time))
    }

    /// Sizes for what has none of its own: those of the first hand.
    pub fn morphology(&self) -> Morphology {
        self.end.hands.first().map_or_else(Morphology::default, |start| start.morphology.clone())
    }

    /// The person, as the best fit tells.
    pub fn person(&self) -> Option<Person> {
        let iou = |start: &&HandStart| start.fit.as_ref().map_or(0.0, |fit| fit.iou);
        let best = self.end.hands.iter().rev().max_by(|a, b| iou(a).total_cmp(&iou(b)))?;
        Some(Person { name: None, hand: Some(best.side), morphology: best.morphology.clone() })
    }

    /// What is to be told of the clip called `name`.
    pub fn summary(&self, name: &str) -> Summary {
        let ClipEnd { timings, .. } = &self.end;
        // Each hand has all frames.
        let first = self.tallies.first();
        let n = first.map_or(0, |tally| tally.frames);
        let rate = |time| per_second(n, time);
        let hands = self.end.hands.iter().zip(&self.tallies);
        Summary {
            clip: name.to_owned(),
            resumed_at: None,
            frames: n,
            hands: hands.map(|(start, tally)| tally.summary(start)).collect(),
            touching: first.map_or_else(Vec::new, |tally| tally.touching.0.clone()),
            skin_tone: self.end.skin_tone,
            tracking_fps: Speed {
                decode: rate(timings.decode),
                segment: rate(timings.segment),
                track: rate(timings.track),
                overlay: self.overlay.as_ref().map(|overlay| rate(overlay.time)),
                whole: rate(self.begun.elapsed()),
            },
        }
    }
}

/// The progress bar and the overlay.
struct Sink {
    bar: ProgressBar,
    /// Poses on standard output while they are found, where that is wanted.
    lines: Option<(Lines, PoseHeader)>,
    /// What a journal is of, and how far the clip has been read.
    journal: Option<(String, Newest)>,
    /// Frames read.
    read: usize,
    /// All poses, where they are wanted at the end.
    kept: Option<Vec<TimedPose>>,
    tallies: Vec<HandTally>,
    /// `None` when no overlay is wanted.
    overlay: Option<Overlay>,
    /// Of the joints that are given.
    nearness: Option<Nearness>,
}

impl Sink {
    fn new(
        args: &TrackArgs,
        path: &Path,
        overlay: Option<PathBuf>,
        poses: Poses,
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
        Self {
            bar,
            lines: poses.lines.map(|lines| (lines, header)),
            journal: None,
            read: 0,
            kept: poses.keep.then(Vec::new),
            tallies: Vec::new(),
            overlay: overlay.map(|path| Overlay::new(path, rate)),
            nearness: None,
        }
    }

    fn finish(self) -> anyhow::Result<Option<Finished>> {
        self.bar.finish_and_clear();
        let finished = self.overlay.map(|overlay| overlay.finish().context("overlay")).transpose()?;
        Ok(finished.flatten())
    }
}

impl ClipSink for Sink {
    fn read(&mut self, index: usize) -> Result<(), String> {
        self.read = index + 1;
        self.bar.set_position(self.read as u64);
        Ok(())
    }

    fn fitted(&mut self, start: &HandStart) {
        self.bar.set_message("tracking");
        let frames = self.tallies.first().map_or(0, |tally| tally.frames);
        let tally = HandTally::new(start, frames);
        if let Some(kept) = &mut self.kept {
            // The hand that is there before is of each instant.
            let before = std::mem::take(kept);
            let more = |pose: TimedPose| {
                let time = pose.time;
                [pose, tally.not_yet.timed(time)]
            };
            kept.extend(before.into_iter().flat_map(more));
        }
        self.tallies.push(tally);
        if let Some(((_, header), (work, newest))) = self.lines.as_mut().zip(self.journal.as_ref()) {
            header.made_by = Some(resume::told(work, newest.time()));
        }
        if let Some((_, header)) = &mut self.lines
            && header.hand(start.side).is_none()
        {
            header.hands.push(ClipHand { side: start.side, morphology: Some(start.morphology.clone()) });
        }
    }

    fn tracked(&mut self, mut frame: TrackedFrame<'_>) -> Result<(), String> {
        for (tally, hand) in self.tallies.iter_mut().zip(&frame.hands) {
            tally.push(hand.found, hand.start);
        }
        if let Some(kept) = &mut self.kept {
            kept.extend(frame.hands.iter().map(|hand| hand.found.timed(frame.time)));
        }
        if let Some((lines, header)) = &mut self.lines {
            let poses = frame.hands.iter().map(|hand| hand.found.timed(frame.time));
            lines.write(|| header.clone(), poses).map_err(|e| message(&e))?;
        }
        if let Some(nearness) = &mut self.nearness {
            nearness.add(&frame);
        }
        match &mut self.overlay {
            Some(overlay) => overlay.draw(&mut frame).map_err(|e| format!("overlay: {}", message(&e))),
            None => Ok(()),
        }
    }
}
