//! Arguments and small jobs that several subcommands share.

use std::io::{BufRead, BufReader, IsTerminal as _};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::Duration;

use super::usage::{bytes, positive, within};
use anyhow::{Context, bail, ensure};
use handcast_codec::mapping::Profile;
use handcast_codec::notices;
use handcast_corpus::EncodeSettings;
use handcast_eval::fidelity::{HandDifference, sampling};
use handcast_fba::bap::StepTable;
use handcast_fba::plan::{PlanOptions, Target};
use handcast_fba::{DecoderOptions, RangeRule};
use handcast_formats::atomic::AtomicFile;
use handcast_formats::motion::Format;
use handcast_formats::mp4;
use handcast_formats::unfinished::{Kind, Unfinished};
use handcast_formats::whole::{Counted, WholeError, read_piped, read_whole};
use handcast_hand::{MAX_FRAMES, MAX_GAP, PoseClip, Side};
use handcast_limits::{Limit, Limits};
use handcast_media::OpenOptions;
use handcast_track::View;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Which hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Hand {
    Left,
    Right,
}

impl From<Hand> for Side {
    fn from(hand: Hand) -> Self {
        match hand {
            Hand::Left => Side::Left,
            Hand::Right => Side::Right,
        }
    }
}

/// Which hand, or whichever it turns out to be.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum HandOrAuto {
    Left,
    Right,
    Auto,
}

impl HandOrAuto {
    /// The hand, if it is known.
    pub fn known(self) -> Option<Side> {
        match self {
            Self::Left => Some(Side::Left),
            Self::Right => Some(Side::Right),
            Self::Auto => None,
        }
    }
}

/// Which face of the hand the camera sees.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum Face {
    Palm,
    Back,
}

impl From<Face> for View {
    fn from(face: Face) -> Self {
        match face {
            Face::Palm => Self::Palm,
            Face::Back => Self::Back,
        }
    }
}

/// Which face of the hand the camera sees, or whichever it turns out to be.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum FaceOrAuto {
    Palm,
    Back,
    Auto,
}

impl FaceOrAuto {
    /// The view, if it is known.
    pub fn known(self) -> Option<View> {
        match self {
            Self::Palm => Some(View::Palm),
            Self::Back => Some(View::Back),
            Self::Auto => None,
        }
    }
}

/// Base quantiser steps.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum Steps {
    /// The table of the standard
    Standard,
    /// The table of Visage products
    Visage,
}

impl From<Steps> for StepTable {
    fn from(steps: Steps) -> Self {
        match steps {
            Steps::Standard => Self::Standard,
            Steps::Visage => Self::Visage,
        }
    }
}

/// How range codes become levels.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum Ranges {
    /// Divided by the quantiser's scale, as the reference software does it
    Divided,
    /// As they are
    Undivided,
}

impl From<Ranges> for RangeRule {
    fn from(ranges: Ranges) -> Self {
        match ranges {
            Ranges::Divided => Self::Divided,
            Ranges::Undivided => Self::Undivided,
        }
    }
}

/// Where position and rotation of a hand travel.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum ProfileArg {
    /// Extension BAPs 209-218 and 231-240: position and rotation
    Hand,
    /// Wrist BAPs 42-47, for players that know only the 186 standard BAPs: no position
    Arm,
}

impl From<ProfileArg> for Profile {
    fn from(profile: ProfileArg) -> Self {
        match profile {
            ProfileArg::Hand => Self::Hand,
            ProfileArg::Arm => Self::Arm,
        }
    }
}

/// Says what of a clip could not be shown, where there is something.
pub fn tell_shortfall(path: &Path, shortfall: Option<&str>) {
    if let Some(told) = shortfall {
        errln!("handcast: {}: {told}", path.display());
    }
}

/// What a stream does not tell of itself, and what to do with a damaged one.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Streams")]
pub struct StreamArgs {
    /// Where position and rotation of the hand travelled in a stream [default: as its masks tell]
    #[arg(long, value_enum)]
    pub profile: Option<ProfileArg>,
    #[command(flatten)]
    decoding: DecodingArgs,
}

/// How the bits of a stream are read
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Streams")]
pub struct DecodingArgs {
    /// Base quantiser steps a stream was made with; it does not tell
    #[arg(long, value_enum, default_value_t = Steps::Standard)]
    steps: Steps,
    /// Reading of the range codes a stream was made with; it does not tell
    #[arg(long, value_enum, default_value_t = Ranges::Divided)]
    ranges: Ranges,
    /// Go on after damage in a stream, holding the last pose
    #[arg(long)]
    conceal: bool,
}

impl StreamArgs {
    /// The decoder's options.
    pub fn options(&self) -> DecoderOptions {
        self.decoding.options()
    }
}

impl DecodingArgs {
    /// The decoder's options.
    pub fn options(&self) -> DecoderOptions {
        DecoderOptions {
            steps: self.steps.into(),
            ranges: self.ranges.into(),
            conceal: self.conceal,
            ..DecoderOptions::default()
        }
    }
}

/// What the encoder aims at; one of the four at most.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Coding")]
pub struct RateArgs {
    /// Root mean square error of the joint angles, degrees [the default, at 0.4]
    #[arg(long, value_name = "DEG", group = "rate", value_parser = positive)]
    pub target_rms: Option<f64>,
    /// No joint angle ever further off than this, degrees, at least 0.15; or, as in 3mm, no fingertip, at least 0.75mm, as a
    /// viewer sees it: with the wrist's way and the rounded sizes that the stream carries
    #[arg(long, value_name = "DEG|MM", group = "rate", value_parser = max_error)]
    pub max_error: Option<Target>,
    /// Bit rate, kilobits per second, held within 5 % over any 10 s after the first 2 s; where the hand rests it
    /// is an upper bound. With --live it is one throughout, and joints lag where it is too low for a motion
    #[arg(long, value_name = "KBPS", group = "rate", value_parser = positive)]
    pub bitrate: Option<f64>,
    /// Quantiser index and plain rounding; higher is coarser
    #[arg(long, value_name = "0-31", group = "rate", value_parser = clap::value_parser!(u8).range(0..=31))]
    pub quant: Option<u8>,
    /// Seconds between I planes, at each of which a viewer can start with --resync
    #[arg(long, value_name = "S", default_value_t = 5.0, value_parser = positive)]
    pub intra: f64,
    /// Code each frame when it comes, without look-ahead
    #[arg(long)]
    pub live: bool,
    /// Start code and all ranges with every I plane, time codes with those on whole seconds, to start there or to resume
    /// after damage; --live has them
    /// anyway
    #[arg(long)]
    pub resync: bool,
    /// None of these with I planes, even with --live: fewer bits, and a reader that joins or has lost something takes longer
    #[arg(long, conflicts_with = "resync")]
    pub no_resync: bool,
    /// Do not send the sizes of the person's hands and the tone of their skin along
    #[arg(long)]
    pub no_sizes: bool,
    /// Send them again with every I plane, for viewers that come later; includes --resync
    #[arg(long, conflicts_with_all = ["no_sizes", "no_resync"])]
    pub repeat_sizes: bool,
    /// Leave out the joint angles that the hand model ties to others (end joints, the thumb's second joint);
    /// the decoder derives them. How far these are off is said, and not held to what is asked of the others
    #[arg(long)]
    pub derive: bool,
    /// Put the stream into an MPEG-4 visual object sequence of this profile and level: 99 is Simple FBA
    /// level 1, 100 level 2
    #[arg(long, value_name = "0-255")]
    pub wrapper: Option<u8>,
    /// Interpolate where a hand is lost or pictures are missing for up to this many seconds between two poses, 0 to 86400;
    /// longer gaps hold the last pose, with 0 all do
    #[arg(long, value_name = "S", default_value_t = MAX_GAP, value_parser = gap, conflicts_with = "live")]
    max_gap: f64,
    /// Where position and rotation of the hand travel
    #[arg(long, value_enum, default_value_t = ProfileArg::Hand)]
    pub profile: ProfileArg,
    /// Base quantiser steps; the decoder must be told the same
    #[arg(long, value_enum, default_value_t = Steps::Standard)]
    pub steps: Steps,
    /// Reading of the range codes; the decoder must be told the same
    #[arg(long, value_enum, default_value_t = Ranges::Divided)]
    pub ranges: Ranges,
}

impl RateArgs {
    /// The planner's options.
    pub fn plan(&self) -> PlanOptions {
        self.plan_of(self.live)
    }

    /// Seconds up to which gaps are bridged; live none is, as what follows is not known.
    pub fn max_gap(&self) -> f64 {
        if self.live { 0.0 } else { self.max_gap }
    }

    /// The same as data.
    pub fn settings(&self) -> EncodeSettings {
        EncodeSettings::of(&self.plan(), self.profile.into(), self.no_sizes, self.max_gap())
    }

    /// The planner's options for a stream that is made live, whether or not that was asked for.
    pub fn plan_of(&self, live: bool) -> PlanOptions {
        let mode = match (self.quant, self.max_error, self.bitrate, self.target_rms) {
            (Some(quant), ..) => Target::Quant(quant),
            (_, Some(most), ..) => most,
            (_, _, Some(kbps), _) => Target::Bitrate(kbps),
            (_, _, _, rms) => rms.map_or_else(Target::default, Target::Rms),
        };
        PlanOptions {
            mode,
            live,
            resync: self.resync || self.repeat_sizes || (live && !self.no_resync),
            repeat_record: self.repeat_sizes,
            derive: self.derive,
            wrapper: self.wrapper,
            intra_seconds: self.intra,
            steps: self.steps.into(),
            ranges: self.ranges.into(),
            ..PlanOptions::default()
        }
    }
}

/// A largest error on the command line: degrees, or with the unit mm that of a fingertip. The finest quantiser keeps no less
/// than what is allowed here for all angles of a hand.
fn max_error(text: &str) -> Result<Target, String> {
    match text.strip_suffix("mm") {
        Some(number) => within(number.trim_end(), 0.75..=1000.0, "mm").map(Target::TipError),
        None => within(text, 0.15..=180.0, "degrees, or of fingertips millimetres as in 3mm")
            .map(Target::MaxError),
    }
}

/// Seconds of a gap.
pub fn gap(text: &str) -> Result<f64, String> {
    within(text, 0.0..=86_400.0, "s")
}

/// A hand length in millimetres on the command line, in metres inside.
pub fn hand_length(text: &str) -> Result<f64, String> {
    within(text, 50.0..=400.0, "mm").map(|mm| mm / 1000.0)
}

/// Degrees the camera sees across the longer side.
pub fn field_of_view(text: &str) -> Result<f64, String> {
    within(text, 5.0..=150.0, "degrees")
}

/// Writes a file that appears whole or not at all, or standard output for `-`.
pub fn write_output(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    if path.as_os_str() == "-" {
        use std::io::Write as _;
        return super::out::Stdout.write_all(bytes).context("standard output");
    }
    AtomicFile::write_all_to(path, bytes).context("cannot write")
}

static LIMITS: OnceLock<Limits> = OnceLock::new();

/// What inputs may make this run of the program hold or do.
pub fn limits() -> &'static Limits {
    LIMITS.get_or_init(Limits::default)
}

/// How clips are opened: within the limits of this run.
pub fn opening() -> OpenOptions {
    OpenOptions::default().with_limits(limits().clone())
}

/// Limits of what is read; each is checked before memory is taken
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Limits")]
pub struct LimitArgs {
    /// Bytes of a file [default: 1G], or of a pipe that is read as a whole [default: 32M]; K, M, G are 1024-fold
    #[arg(long, global = true, hide_short_help = true, value_name = "N", value_parser = bytes)]
    max_bytes: Option<u64>,
    /// Instants of a motion, those included that a rate, a gap or a skip makes [default: 110000]
    #[arg(
        long,
        global = true,
        hide_short_help = true,
        value_name = "N",
        value_parser = clap::value_parser!(u64).range(1..=MAX_FRAMES as u64)
    )]
    max_instants: Option<u64>,
    /// Seconds of a motion [default: 86400]
    #[arg(long, global = true, hide_short_help = true, value_name = "S", value_parser = positive)]
    max_seconds: Option<f64>,
    /// Nodes, joints and tracks of a scene [default: 10000]
    #[arg(long, global = true, hide_short_help = true, value_name = "N")]
    max_nodes: Option<u64>,
}

impl LimitArgs {
    /// Makes these the limits of this run.
    pub fn set(&self) {
        let mut limits = Limits::default();
        if let Some(bytes) = self.max_bytes {
            limits = limits.with_bytes(bytes);
        }
        if let Some(instants) = self.max_instants {
            limits = limits.with_instants(instants);
        }
        limits.seconds = self.max_seconds.unwrap_or(limits.seconds);
        limits.nodes = self.max_nodes.unwrap_or(limits.nodes);
        // The first of two calls holds; there is one.
        let _ = LIMITS.set(limits);
    }
}

/// Makes sure that a hand is seen in the motion of this name.
pub fn check_seen(name: impl std::fmt::Display, clip: &PoseClip) -> anyhow::Result<()> {
    let count = clip.frames.len();
    let lost = if count > 0 { format!(": all {count} are of a lost hand") } else { String::new() };
    ensure!(clip.frames.iter().any(|frame| frame.valid), "{name}: there is no pose of a hand in it{lost}");
    Ok(())
}

/// Makes sure that `rate` makes no more instants of a clip than allowed.
pub fn check_span(clip: &PoseClip, rate: f64) -> anyhow::Result<()> {
    Ok(handcast_formats::motion::check_span(clip, rate, limits())?)
}

/// Reads a whole file, or standard input for `-`; `most` bytes where that is less than any file may have.
pub fn read_input(path: &Path, most: Option<u64>) -> anyhow::Result<Vec<u8>> {
    let limits = most.map(|most| limits().clone().with_bytes(most.min(limits().bytes)));
    let limits = limits.as_ref().unwrap_or_else(|| self::limits());
    let name = path.display();
    if path.as_os_str() == "-" {
        return read_piped(std::io::stdin().lock(), limits).context("standard input");
    }
    read_whole(path, limits).map_err(|error| match error {
        WholeError::Io(error) => anyhow::Error::from(error).context(format!("cannot read {name}")),
        other => anyhow::anyhow!("{name}: {other}"),
    })
}

/// Reads a file, or standard input, in which there must be something.
pub fn read_filled(path: &Path) -> anyhow::Result<Vec<u8>> {
    let bytes = read_input(path, None)?;
    match path.as_os_str() == "-" {
        true => ensure!(!bytes.is_empty(), "standard input is empty"),
        false => ensure!(!bytes.is_empty(), "{}: the file is empty", path.display()),
    }
    Ok(bytes)
}

/// That the first bytes of the file at `path` are not those of a motion in another format, whatever its name says.
pub fn check_is_stream(path: &Path, head: &[u8]) -> anyhow::Result<()> {
    match Format::sniffed(head).filter(|format| format.id != "fba") {
        Some(other) => {
            bail!("{}: no stream, but {}, which encode and import take", path.display(), other.name)
        }
        None => Ok(()),
    }
}

/// Reads a stream, from an MP4 file if it is in one, and the seconds at which it begins there.
pub fn read_stream(path: &Path) -> anyhow::Result<(Vec<u8>, f64)> {
    let bytes = read_filled(path)?;
    if !mp4::is_mp4(&bytes) {
        check_is_stream(path, &bytes)?;
        return Ok((bytes, 0.0));
    }
    let stream = mp4::unwrapped(&bytes).with_context(|| path.display().to_string())?.into_owned();
    Ok((stream, mp4::starts_at(&bytes)))
}

/// The rest of an input that was opened to be read piece by piece.
pub fn read_piece(input: Box<dyn BufRead>, path: &Path) -> anyhow::Result<Vec<u8>> {
    let name = path.display();
    // A file says how long it is, and is held to that where it is opened.
    let limits = if path.is_file() { limits().clone().with_bytes(limits().bytes) } else { limits().clone() };
    read_piped(input, &limits).with_context(|| format!("cannot read {name}"))
}

/// Bytes of a file that are read at a time.
const FILE_BUFFER: usize = 1 << 16;

/// Opens a file to be read piece by piece, or standard input for `-`.
pub fn open_input(path: &Path) -> anyhow::Result<Box<dyn BufRead>> {
    if let Ok(found) = std::fs::metadata(path)
        && found.is_file()
    {
        let checked = limits().check(Limit::Bytes, found.len() as f64);
        checked.map_err(|excess| anyhow::anyhow!("{}: {excess}", path.display()))?;
    }
    if path.as_os_str() == "-" {
        return Ok(Box::new(BufReader::new(Counted::new(std::io::stdin(), limits()))));
    }
    let reader = std::fs::File::open(path).with_context(|| format!("cannot read {}", path.display()))?;
    Ok(Box::new(BufReader::with_capacity(FILE_BUFFER, Counted::new(reader, limits()))))
}

/// A bar for so many frames on standard error; hidden unless it is to be shown and that is a terminal.
pub fn progress(show: bool, frames: Option<u64>) -> ProgressBar {
    let show = show && std::io::stderr().is_terminal();
    let target = if show { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
    ProgressBar::with_draw_target(frames, target)
}

/// A sign on standard error that work goes on, and for how long, where there is no telling how far it is.
pub fn busy(show: bool, what: &'static str) -> ProgressBar {
    let bar = progress(show, None);
    if let Ok(style) = ProgressStyle::with_template("{msg:10} {spinner} {elapsed}") {
        bar.set_style(style);
    }
    bar.set_message(what);
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

/// Endings of files that are neither motions nor pages, and what these are.
const OTHER_KINDS: [(&str, &str); 15] = [
    ("png", "picture"),
    ("jpg", "picture"),
    ("jpeg", "picture"),
    ("gif", "animation"),
    ("webp", "animation"),
    ("svg", "drawing"),
    ("mp4", "film"),
    ("mov", "film"),
    ("avi", "film"),
    ("mkv", "film"),
    ("webm", "film"),
    ("m4v", "film"),
    ("zip", "archive"),
    ("html", "page"),
    ("toml", "person"),
];

/// What a file would be by its name's ending, where that is none of `own`; a name without one, a pipe and a device may be anything.
pub fn told_kind(path: &Path, own: &[&str]) -> Option<String> {
    let ending = ending(path);
    let passed_on = std::fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir());
    if ending.is_empty() || own.contains(&ending.as_str()) || passed_on {
        return None;
    }
    let other = || OTHER_KINDS.into_iter().find(|(known, _)| *known == ending).map(|(_, kind)| kind);
    let known = Format::by_name(path).map(|format| format.name).or_else(other);
    Some(known.map_or_else(|| format!(".{ending}"), str::to_owned))
}

/// An output's name in words.
pub fn told_name(path: &Path) -> String {
    if path.as_os_str() == "-" { "standard output".into() } else { path.display().to_string() }
}

/// So many of what has this name: `1 frame`, `2 frames`.
pub fn counted<N: std::fmt::Display + PartialEq + From<u8>>(count: N, what: &str) -> String {
    let s = if count == N::from(1) { "" } else { "s" };
    format!("{count} {what}{s}")
}

/// Refuses to write `what`, which is no text, to a terminal.
///
/// # Errors
/// The output is standard output, and that a terminal.
pub fn check_terminal(output: &Path, what: &str) -> anyhow::Result<()> {
    if output.as_os_str() == "-" && std::io::stdout().is_terminal() {
        refuse!("{what} is no text for a terminal: name a file, or pass it on through a pipe");
    }
    Ok(())
}

/// The ending of a file name, in lower case.
pub fn ending(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase()
}

/// A new folder, taken away at the end.
pub struct Scratch(pub PathBuf, #[expect(dead_code, reason = "held until the folder is gone")] Unfinished);

impl Scratch {
    /// Makes the folder among the system's temporary ones; `what` is part of its name.
    pub fn new(what: &str) -> anyhow::Result<Self> {
        Self::within(&std::env::temp_dir(), what)
    }

    /// Makes it in another folder.
    pub fn within(folder: &Path, what: &str) -> anyhow::Result<Self> {
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
        let name = format!("handcast-{what}-{}-{}", std::process::id(), now.subsec_nanos());
        let path = folder.join(name);
        let make = || std::fs::create_dir(&path);
        let (made, guard) = Unfinished::made(Kind::Folder, make, |()| path.clone());
        made.with_context(|| path.display().to_string())?;
        Ok(Self(path, guard))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // Nothing can be done about a folder that stays.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Warns of times so uneven that poses are interpolated, and says what that costs.
pub fn warn_of_uneven_times(clip: &PoseClip, rate: f64) {
    let Some(notice) = notices::of_times(clip, rate) else { return };
    let hands = sampling(clip, rate);
    if hands.is_empty() {
        errln!("handcast: {notice}");
        return;
    }
    let worst = |of: fn(&HandDifference) -> f64| hands.iter().map(of).fold(0.0, f64::max);
    errln!(
        "handcast: {notice}, which changes joints by {:.2}° RMS, {:.1}° at most",
        worst(|hand| hand.moving_rms_deg.unwrap_or_default()),
        worst(|hand| hand.worst().map_or(0.0, |joint| joint.max.value))
    );
}
