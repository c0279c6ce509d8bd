//! `handcast render`: pictures of poses without a browser.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use clap::Args as ClapArgs;
use handcast_formats::atomic::AtomicFile;
use handcast_hand::{HandMesh, HandPose, Side, Skeleton, skin_tone, usual_step};
#[cfg(feature = "h264")]
use handcast_media::film::{FilmWriter, TICKS, USUAL_RATE};
use handcast_render::{Film, Moment, Style, WebpAnimation, spread};
use handcast_view::times;
#[cfg(feature = "h264")]
use image::DynamicImage;
use image::codecs::gif::{GifEncoder, Repeat};
use image::codecs::png::PngEncoder;
use image::codecs::webp::WebPEncoder;
use image::{Delay, Frame, RgbaImage};
use indicatif::{ProgressBar, ProgressStyle};

use super::common::{
    Hand, busy, check_seen, check_terminal, counted, ending, progress, told_name, write_output,
};
use super::motion::{Motion, MotionArgs};
use super::poses_out::centre;

/// The endings of names of pictures.
const ENDINGS: &[&str] =
    if cfg!(feature = "h264") { &["png", "gif", "webp", "mp4"] } else { &["png", "gif", "webp"] };
/// Seconds beyond the first and the last pose at which they are still meant.
const BEYOND: f64 = 0.1;
/// How far apart wrists are, metres, from which on hands lie beside one another.
const BESIDE: f64 = 0.1;
/// Width and height of a picture of one hand, and of two beside one another, pixels.
const SIZES: [(u32, u32); 2] = [(320, 360), (640, 360)];
/// Longest side of one picture, pixels.
const MAX_SIDE: u32 = 4096;
/// Longest side of a contact sheet, pixels.
const MAX_SHEET: u64 = 16_384;
/// Pictures on a contact sheet, and in one of its rows.
const SHEET: (usize, u32) = (12, 4);
/// Pictures of a turn round a hand that keeps still, and how many a second.
const TURN: (usize, f64) = (72, 24.0);

/// Draws the moving hands of a stream, a GLB or a pose file
#[derive(Debug, ClapArgs)]
pub struct Args {
    /// Picture to write: .png (contact sheet; - for one on standard output), .mp4, .gif or .webp (animation)
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Width and height of one picture, pixels, 1 to 4096 a side [default: 320x360, of hands beside one another 640x360]
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<(u32, u32)>,
    /// Number of pictures, 1 to 100000, evenly spread: of a contact sheet, by default 12, or of an animation, by
    /// default all
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    frames: Option<u32>,
    /// One picture of the pose at this time, seconds
    #[arg(long, value_name = "S", conflicts_with_all = ["frames", "turntable"], value_parser = instant)]
    at: Option<f64>,
    /// Go once round the hand in the course of the motion; a hand that keeps still is turned in three seconds
    #[arg(long)]
    turntable: bool,
    /// Draw this hand alone
    #[arg(long = "only", alias = "hand", value_enum, value_name = "HAND")]
    hand: Option<Hand>,
    /// Keep the hand in the middle: without the way of the wrist; of two hands, of the middle between them
    #[arg(long)]
    centre: bool,
    /// Tone of the skin, 1 (lightest) to 10 [default: that of the clip where the motion tells it, else 3]
    #[arg(long, value_name = "1-10", value_parser = super::glb_out::tone)]
    tone: Option<u8>,
    /// Transparent background (not in .gif and .mp4)
    #[arg(long)]
    transparent: bool,
    /// Neither progress nor report; warnings are told all the same
    #[arg(short, long)]
    quiet: bool,
    #[command(flatten)]
    motion: MotionArgs,
}

/// `320x360`, pixels.
fn size(text: &str) -> Result<(u32, u32), String> {
    let parsed = super::synth::size(text)?;
    let allowed = |side: u32| (1..=MAX_SIDE).contains(&side);
    if allowed(parsed.0) && allowed(parsed.1) {
        return Ok(parsed);
    }
    Err(format!("allowed 1 to {MAX_SIDE} pixels a side"))
}

/// Seconds.
fn instant(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|t: &f64| t.is_finite()).ok_or_else(|| "allowed is a number of seconds".into())
}

/// An instant at which a hand is seen: number of its mesh, and its pose.
#[derive(Clone)]
struct Instant<'a> {
    time: f64,
    hands: Vec<(usize, &'a HandPose)>,
}

/// Surfaces with their skeletons, and every instant at which a hand is seen.
fn instants(motion: &Motion, hand: Option<Hand>) -> (Vec<(HandMesh, Skeleton)>, Vec<Instant<'_>>) {
    let clip = &motion.clip;
    let wanted = |side: Side| hand.is_none_or(|h| Side::from(h) == side);
    let (mut meshes, mut found) = (Vec::new(), Vec::new());
    for side in [Side::Left, Side::Right] {
        if !wanted(side) || !clip.of(side).any(|f| f.valid) {
            continue;
        }
        let info = clip.header.hand(side).and_then(|h| h.morphology.as_ref());
        let morphology = info.unwrap_or(&motion.morphology);
        let number = meshes.len();
        meshes.push((HandMesh::generate(morphology, side), Skeleton::new(morphology, side)));
        found.extend(clip.of(side).filter(|f| f.valid).map(|f| (f.time, number, &f.pose)));
    }
    let mut all: Vec<Instant> =
        times(clip).into_iter().map(|time| Instant { time, hands: Vec::new() }).collect();
    for (time, number, pose) in found {
        let at = all.partition_point(|m| m.time < time - 1e-6);
        if let Some(instant) = all.get_mut(at) {
            instant.hands.push((number, pose));
        }
    }
    all.retain(|m| !m.hands.is_empty());
    (meshes, all)
}

/// Those of the instants that are shown.
fn choose<'a>(args: &Args, mut all: Vec<Instant<'a>>, animated: bool) -> Vec<Instant<'a>> {
    if let Some(at) = args.at {
        let distance = |m: &Instant| (m.time - at).abs();
        if let (Some(first), Some(last)) = (all.first(), all.last())
            && !(first.time - BEYOND..=last.time + BEYOND).contains(&at)
        {
            errln!(
                "handcast: --at {at} is not between {:.2} and {:.2} s: the pose nearest to it is drawn",
                first.time,
                last.time
            );
        }
        return all.into_iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).into_iter().collect();
    }
    let wanted = args.frames.map(|n| n as usize);
    if let ([still], true) = (all.as_slice(), args.turntable) {
        let count = wanted.unwrap_or(if animated { TURN.0 } else { SHEET.0 });
        let moment = |i: usize| Instant { time: i as f64 / TURN.1, hands: still.hands.clone() };
        return (0..count).map(moment).collect();
    }
    if let Some(wanted) = wanted.filter(|&wanted| wanted > all.len()) {
        errln!(
            "handcast: --frames {wanted}: the motion has {} instants, of which each is drawn once",
            all.len()
        );
    }
    let count = wanted.unwrap_or(if animated { all.len() } else { SHEET.0 });
    let mut chosen = spread(count, all.len()).into_iter().peekable();
    let mut number = 0;
    all.retain(|_| {
        number += 1;
        chosen.next_if_eq(&(number - 1)).is_some()
    });
    all
}

/// Hundredths of a second for which players of GIFs show a picture at least.
const GIF_LEAST: u32 = 2;

/// Leaves instants out, so that the others, each shown for that long at least, keep their pace.
fn thin_out(instants: &mut Vec<Instant<'_>>, seconds: f64) {
    let mut due = instants.first().map_or(0.0, |first| first.time);
    instants.retain(|instant| {
        let shown = instant.time > due - 1e-6;
        if shown {
            due = due.max(instant.time - seconds) + seconds;
        }
        shown
    });
}

/// Latest beginning, seconds: later times are those of a clock, or of a longer clip.
const LATEST: f64 = 10.0;

/// Puts an empty picture before a motion that begins late, by more than a picture: until then no hand was seen.
fn lead(moments: &mut Vec<Moment>) {
    if let [first, second, ..] = moments.as_slice()
        && first.time > second.time - first.time
        && first.time <= LATEST
    {
        moments.insert(0, Moment { time: 0.0, hands: Vec::new() });
    }
}

/// Longest that a picture is shown, seconds: a recording that was left running fills no day. Those of a .gif last as long as its
/// 16 bits tell.
fn longest(ending: &str) -> f64 {
    if ending == "gif" { 655.35 } else { 3600.0 }
}

/// Longest that the last picture is shown, for as long as one in the middle, seconds.
const LAST: f64 = 10.0;

/// That pictures would be shown longer than they can be.
fn cut_short(moments: &[Moment], ending: &str) -> Option<String> {
    let longest = longest(ending);
    let cut = moments.windows(2).filter(|w| w[1].time - w[0].time > longest).count();
    let (are, s) = if cut == 1 { ("is", "") } else { ("are", "s") };
    (cut > 0).then(|| {
        format!("{cut} picture{s} {are} shown for {longest} s, as long as one in a .{ending} is, in place of longer")
    })
}

/// How long each picture is shown, in units of `unit` seconds and at least `least` of them, at most `longest` seconds; rounding
/// does not add up.
fn durations(moments: &[Moment], unit: f64, least: u32, longest: f64, last: Option<f64>) -> Vec<u32> {
    let times: Vec<f64> = moments.iter().map(|moment| moment.time).collect();
    let last = last.or(usual_step(&times)).map_or(1.0 / TURN.1, |step| step.min(LAST));
    let steps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).collect();
    let (mut time, mut told) = (0.0, 0.0);
    steps
        .into_iter()
        .chain([last])
        .map(|step| {
            time += step.min(longest) / unit;
            let units = ((time - told).round() as u32).max(least);
            told += f64::from(units);
            units
        })
        .collect()
}

/// Seconds that pictures are shown, each for so many units of `unit` seconds.
fn whole(shown: &[u32], unit: f64) -> f64 {
    shown.iter().map(|&units| f64::from(units) * unit).sum()
}

/// Writes all pictures as a film; gives its seconds.
#[cfg(feature = "h264")]
fn write_film(drawing: &Drawing<'_>, file: &mut AtomicFile) -> anyhow::Result<f64> {
    let shown = durations(drawing.film.moments(), 1.0 / f64::from(TICKS), 1, longest("mp4"), drawing.last);
    let seconds = whole(&shown, 1.0 / f64::from(TICKS));
    let rate = (shown.len() as f64 / seconds).clamp(0.1, 1000.0);
    let mut video = FilmWriter::new(file, drawing.size, rate, USUAL_RATE)?;
    drawing.in_order(|i, picture| video.write(&DynamicImage::from(picture).into_rgb8(), shown[i]))?;
    video.finish()?;
    Ok(seconds)
}

/// What is drawn, and how.
struct Drawing<'a> {
    film: &'a Film,
    /// Width and height of one picture.
    size: (u32, u32),
    style: &'a Style,
    bar: &'a ProgressBar,
    /// How long the last picture is shown, seconds, where it is not the usual step between pictures.
    last: Option<f64>,
}

impl Drawing<'_> {
    /// Draws all pictures, and hands each to `take`.
    fn in_order<E>(&self, mut take: impl FnMut(usize, RgbaImage) -> Result<(), E>) -> Result<(), E> {
        self.film.in_order(self.style, |i, picture| {
            self.bar.set_position(i as u64 + 1);
            take(i, picture)
        })
    }

    /// Writes a sheet, or the one picture, as PNG.
    fn write_png(&self, into: impl Write) -> anyhow::Result<()> {
        let (width, height) = self.size;
        let count = self.film.moments().len();
        let rows = count.div_ceil(SHEET.1 as usize) as u64;
        let side = (rows * u64::from(height + width / 32)).max(u64::from(SHEET.1 * (width + width / 32)));
        ensure!(
            count == 1 || side <= MAX_SHEET,
            "a sheet of {side} pixels, allowed {MAX_SHEET}: fewer --frames"
        );
        let picture = match count {
            1 => self.film.picture(0, self.style),
            _ => self.film.sheet(SHEET.1, self.style),
        };
        Ok(picture.write_with_encoder(PngEncoder::new(into))?)
    }

    /// Writes what has this name, or to standard output for `-`; gives the seconds that it lasts where it moves.
    fn write(&self, ending: &str, output: &Path) -> anyhow::Result<Option<f64>> {
        if output.as_os_str() == "-" {
            let mut bytes = Vec::new();
            self.write_png(&mut bytes)?;
            write_output(output, &bytes)?;
            return Ok(None);
        }
        let mut file = AtomicFile::create(output).context("cannot write")?;
        let seconds = self.write_file(ending, &mut file)?;
        file.commit().context("cannot write")?;
        Ok(seconds)
    }

    fn write_file(&self, ending: &str, file: &mut AtomicFile) -> anyhow::Result<Option<f64>> {
        let moments = self.film.moments();
        let single = moments.len() == 1;
        match ending {
            "png" => self.write_png(file).map(|()| None),
            "webp" if single => {
                self.film.picture(0, self.style).write_with_encoder(WebPEncoder::new_lossless(file))?;
                Ok(None)
            }
            "webp" => {
                let mut animation = WebpAnimation::new(self.size)?;
                let shown = durations(moments, 1e-3, 1, longest(ending), self.last);
                self.in_order(|i, picture| animation.push(&picture, shown[i]))?;
                animation.write(file)?;
                Ok(Some(whole(&shown, 1e-3)))
            }
            "gif" => {
                let mut encoder = GifEncoder::new_with_speed(file, 10);
                encoder.set_repeat(Repeat::Infinite)?;
                // Hundredths of a second; browsers take less than 2 for 10.
                let shown = durations(moments, 1e-2, GIF_LEAST, longest(ending), self.last);
                self.in_order(|i, picture| {
                    let delay = Delay::from_numer_denom_ms(10 * shown[i], 1);
                    encoder.encode_frame(Frame::from_parts(picture, 0, 0, delay))
                })?;
                Ok(Some(whole(&shown, 1e-2)))
            }
            #[cfg(feature = "h264")]
            "mp4" => write_film(self, file).map(Some),
            other => bail!("cannot write .{other}"),
        }
    }
}

/// A bar for the pictures of an animation; of a sheet a sign that it is drawn.
fn drawn(show: bool, ending: &str, pictures: usize) -> ProgressBar {
    if ending == "png" {
        return busy(show, "drawing");
    }
    let bar = progress(show, Some(pictures as u64));
    if let Ok(style) = ProgressStyle::with_template("{msg:10} {wide_bar} {pos}/{len} {per_sec} {eta}") {
        bar.set_style(style);
    }
    bar.set_message("drawing");
    bar
}

/// Whether two hands are seen beside one another.
fn beside(all: &[Instant]) -> bool {
    let across = |instant: &Instant| {
        let wrists = instant.hands.iter().map(|(_, pose)| pose.translation.x);
        wrists.clone().fold(f64::MIN, f64::max) - wrists.fold(f64::MAX, f64::min)
    };
    all.iter().any(|instant| across(instant) > BESIDE)
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let piped = args.output.as_os_str() == "-";
    let extension = if piped { "png".to_owned() } else { ending(&args.output) };
    check_terminal(&args.output, "a picture")?;
    if !ENDINGS.contains(&extension.as_str()) {
        refuse!(
            "{}: cannot write this kind of picture, allowed are .{} and -{}",
            args.output.display(),
            ENDINGS.join(", ."),
            if cfg!(feature = "h264") { "" } else { "; for .mp4 this program lacks H.264" }
        );
    }
    let opaque = ["gif", "mp4"].contains(&extension.as_str());
    if args.transparent && opaque {
        refuse!("a .{extension} has a background: no --transparent");
    }
    let mut motion = args.motion.read()?;
    if args.centre {
        centre(&mut motion.clip);
    }
    let (meshes, all) = instants(&motion, args.hand);
    let (width, height) = args.size.unwrap_or(if beside(&all) { SIZES[1] } else { SIZES[0] });
    for note in &motion.notes {
        errln!("handcast: {}: {note}", args.motion.input.display());
    }
    let hand = args.hand.map_or(String::new(), |h| format!(" of a {} hand", Side::from(h).name()));
    check_seen(args.motion.input.display(), &motion.clip)?;
    ensure!(!all.is_empty(), "{}: no pose{hand} in it", args.motion.input.display());
    if extension == "mp4" && (width % 2 == 1 || height % 2 == 1) {
        let [w, h] = [width & !1, height & !1];
        errln!(
            "handcast: pictures of H.264 have even sizes: they are {w}x{h} pixels, the last column or row is left out"
        );
    }
    let background = if args.transparent { None } else { Style::default().background };
    let skin =
        args.tone.or(motion.clip.header.skin_tone).and_then(skin_tone).unwrap_or(Style::default().skin);
    let style = Style { background, skin, ..Style::default() };
    // Of some pictures of a motion the last one stands for as little of it as all would.
    let times: Vec<f64> = all.iter().map(|instant| instant.time).collect();
    let last = args.frames.and_then(|_| usual_step(&times));
    let mut chosen = choose(args, all, extension != "png");
    if extension == "gif" {
        thin_out(&mut chosen, f64::from(GIF_LEAST) / 100.0);
    }
    let joints = |&(number, pose): &(usize, &HandPose)| Some((number, meshes.get(number)?.1.frames(pose)));
    let moment = |i: &Instant| Moment { time: i.time, hands: i.hands.iter().filter_map(joints).collect() };
    let mut moments: Vec<Moment> = chosen.iter().map(moment).collect();
    if extension != "png" && args.frames.is_none() {
        lead(&mut moments);
    }
    let surfaces: Vec<HandMesh> = meshes.iter().map(|(mesh, _)| mesh.clone()).collect();
    let film = Film::new(&surfaces, moments, (width, height), args.turntable);
    if extension != "png"
        && let Some(note) = cut_short(film.moments(), &extension)
    {
        errln!("handcast: {}: {note}", args.output.display());
    }
    let count = film.moments().len();
    let bar = drawn(!args.quiet, &extension, count);
    let drawing = Drawing { film: &film, size: (width, height), style: &style, bar: &bar, last };
    let seconds = drawing.write(&extension, &args.output);
    bar.finish_and_clear();
    let seconds = seconds?;
    if !args.quiet {
        let pictures = counted(count as u64, "picture");
        let lasts = seconds.map_or_else(String::new, |seconds| format!(", {seconds:.1} s"));
        errln!("{}: {pictures}{lasts}", told_name(&args.output));
    }
    Ok(())
}
