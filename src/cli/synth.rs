//! `handcast synth`: clips of the model with known poses.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args as ClapArgs;
use clap::builder::PossibleValuesParser;
use handcast_eval::synth::{Background, ScriptedMotion, Synth, SynthOptions, random_morphology};
use handcast_formats::atomic::AtomicFile;
use handcast_formats::person::read_person;
use handcast_formats::poses::{write_lines, write_poses};
use handcast_hand::{ClipHand, PoseClip, PoseHeader, Side, TimedPose};
use handcast_media::avi::MjpegWriter;
use handcast_vision::Mask;
use image::codecs::png::PngEncoder;
use image::{ImageBuffer, PixelWithColorType, RgbImage};

use super::common::{Face, Hand, Scratch, progress, told_name, write_output};
use super::demo_clip;
use super::files::try_file;

/// Renders the hand model along a scripted motion, and writes the true poses beside the clip
#[derive(Debug, ClapArgs)]
pub struct Args {
    /// Clip to write: FILE.avi (Motion JPEG), or a folder for numbered PNG pictures
    #[arg(short, long, value_name = "CLIP")]
    output: PathBuf,
    /// True poses (.jsonl, or - for standard output); by default beside the clip, CLIP.poses.jsonl, unless those of another clip are there
    #[arg(long, value_name = "FILE")]
    poses: Option<PathBuf>,
    /// Folder for the true silhouettes of the hand (PNG, white on black)
    #[arg(long, value_name = "DIR")]
    masks: Option<PathBuf>,
    /// The scripted motion
    #[arg(long, default_value = "demo", value_parser = names(&ScriptedMotion::ALL))]
    motion: String,
    /// Number of frames over which the motion is stretched, 1 to 100000
    #[arg(long, value_name = "N", default_value_t = 150)]
    frames: usize,
    /// Frames per second, 0.01 to 1000
    #[arg(long, value_name = "HZ", default_value_t = 25.0)]
    fps: f64,
    /// Width and height, pixels, 16 to 4096 a side
    #[arg(long, default_value = "480x360", value_name = "WxH", value_parser = size)]
    size: (u32, u32),
    /// Which hand
    #[arg(long, value_enum, default_value = "right")]
    hand: Hand,
    /// Which face of it
    #[arg(long, value_enum, default_value = "palm")]
    view: Face,
    /// How far to the right of the middle it takes place, metres, -5 to 5
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, value_name = "M")]
    aside: f64,
    /// Both hands, the other one on the other side of the middle and moving backwards [default --aside: -0.12 for
    /// a right hand]
    #[arg(long)]
    two_hands: bool,
    /// Come to the middle half way through and go back: two hands touch there
    #[arg(long, requires = "two_hands")]
    meet: bool,
    /// In-plane rotation of the whole motion, degrees, -720 to 720, counter-clockwise
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true)]
    turn: f64,
    /// Distance of the wrist from the camera, metres, 0.2 to 10
    #[arg(long, value_name = "M", default_value_t = SynthOptions::default().distance)]
    distance: f64,
    /// Degrees the camera sees across the longer side, 5 to 150
    #[arg(long, value_name = "DEG", default_value_t = 60.0)]
    fov: f64,
    /// Sizes of the person's hand
    #[arg(long, value_name = "FILE")]
    person: Option<PathBuf>,
    /// What stands behind the hand
    #[arg(long, default_value = "clutter", value_parser = names(&Background::ALL))]
    background: String,
    /// Leave the forearm out
    #[arg(long)]
    no_forearm: bool,
    /// Skin colour, sRGB in hexadecimal
    #[arg(long, default_value = "deaa8e", value_name = "RRGGBB", value_parser = colour)]
    skin: [u8; 3],
    /// Where the light comes from: right, up, towards the viewer
    #[arg(long, value_name = "X,Y,Z", value_parser = direction, allow_hyphen_values = true)]
    light: Option<[f64; 3]>,
    /// Brightness of the light, times the usual one, 0 to 10
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    exposure: f32,
    /// Standard deviation of the sensor noise, 8-bit levels, 0 to 100
    #[arg(long, value_name = "LEVELS", default_value_t = 1.5)]
    noise: f32,
    /// Roughness of the edge of the silhouettes in --masks: standard deviation, pixels, 0 to 20
    #[arg(long, value_name = "PIXELS", default_value_t = 0.0, requires = "masks")]
    roughness: f64,
    /// Seed of background, noise, letters (--motion signs) and hand (--random-hand)
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// A hand of made-up sizes, chosen by --seed
    #[arg(long, conflicts_with = "person")]
    random_hand: bool,
    /// JPEG quality, 1 to 100: of an AVI clip, or of what PNG pictures have been through
    #[arg(long, value_name = "1-100", value_parser = clap::value_parser!(u8).range(1..=100))]
    quality: Option<u8>,
    /// Neither progress nor report; warnings are told all the same
    #[arg(short, long)]
    quiet: bool,
}

/// How far from the middle two hands are, metres.
const APART: f64 = 0.12;

fn names<T>(list: &[(&'static str, T)]) -> PossibleValuesParser {
    PossibleValuesParser::new(list.iter().map(|(name, _)| *name).collect::<Vec<_>>())
}

/// `WIDTHxHEIGHT`.
pub(super) fn size(text: &str) -> Result<(u32, u32), String> {
    let parts = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    parts.ok_or_else(|| format!("{text} is not WIDTHxHEIGHT"))
}

/// `X,Y,Z`.
fn direction(text: &str) -> Result<[f64; 3], String> {
    let numbers: Vec<f64> = text.split(',').filter_map(|v| v.trim().parse().ok()).collect();
    <[f64; 3]>::try_from(numbers).map_err(|_| format!("{text} is not X,Y,Z"))
}

/// `RRGGBB`.
pub(super) fn colour(text: &str) -> Result<[u8; 3], String> {
    let text = text.trim_start_matches('#');
    match (text.len(), u32::from_str_radix(text, 16)) {
        (6, Ok(v)) => Ok([(v >> 16) as u8, (v >> 8) as u8, v as u8]),
        _ => Err(format!("{text} is not RRGGBB")),
    }
}

/// Where frames go.
enum Sink {
    Avi(Box<MjpegWriter<AtomicFile>>),
    Folder(Pictures),
}

/// Pictures on their way to a folder, which holds all of them at the end or none.
struct Pictures {
    folder: PathBuf,
    /// Where they are until then, on the same disk.
    made: Scratch,
    count: usize,
}

impl Pictures {
    fn create(folder: &Path, frames: usize) -> anyhow::Result<Self> {
        fs::create_dir_all(folder)?;
        check_numbers(folder, frames)?;
        Ok(Self { folder: folder.to_owned(), made: Scratch::within(folder, "pictures")?, count: 0 })
    }

    /// Writes the next one.
    fn save<P>(&mut self, picture: &ImageBuffer<P, Vec<u8>>) -> anyhow::Result<()>
    where
        P: PixelWithColorType<Subpixel = u8>,
    {
        let (name, mut bytes) = (numbered(self.count), Vec::new());
        let written = picture.write_with_encoder(PngEncoder::new(&mut bytes)).map_err(anyhow::Error::from);
        let written = written.and_then(|()| Ok(fs::write(self.made.0.join(&name), bytes)?));
        written.with_context(|| self.folder.join(&name).display().to_string())?;
        self.count += 1;
        Ok(())
    }

    fn finish(self) -> anyhow::Result<()> {
        for name in (0..self.count).map(numbered) {
            let place = self.folder.join(&name);
            fs::rename(self.made.0.join(&name), &place).with_context(|| place.display().to_string())?;
        }
        Ok(())
    }
}

impl Sink {
    fn create(path: &Path, synth: &Synth, quality: u8) -> anyhow::Result<Self> {
        let o = synth.options();
        if path.as_os_str() == "-" {
            refuse!("a clip is not written to standard output: give FILE.avi, or a folder for PNG pictures");
        }
        match path.extension().and_then(|e| e.to_str()) {
            Some(e) if e.eq_ignore_ascii_case("avi") => {
                let file = AtomicFile::create(path)?;
                let writer =
                    MjpegWriter::new(file, o.size, MjpegWriter::<AtomicFile>::rate_of(o.rate), quality)?;
                Ok(Self::Avi(Box::new(writer)))
            }
            None => Ok(Self::Folder(Pictures::create(path, synth.frames())?)),
            Some(e) => refuse!("cannot write .{e} clips: give FILE.avi, or a folder for PNG pictures"),
        }
    }

    fn write(&mut self, image: &RgbImage) -> anyhow::Result<()> {
        match self {
            Self::Avi(writer) => writer.write(image)?,
            Self::Folder(pictures) => pictures.save(image)?,
        }
        Ok(())
    }

    fn finish(self) -> anyhow::Result<()> {
        match self {
            Self::Avi(writer) => Ok(writer.finish()?.commit()?),
            Self::Folder(pictures) => pictures.finish(),
        }
    }
}

/// Name of a frame's picture.
fn numbered(frame: usize) -> String {
    format!("{frame:05}.png")
}

/// That no pictures of a longer clip are in the folder: they would be taken for the end of this one.
fn check_numbers(folder: &Path, frames: usize) -> anyhow::Result<()> {
    for entry in fs::read_dir(folder)? {
        let name = entry?.file_name();
        let number = Path::new(&name).file_stem().and_then(|stem| stem.to_str()?.parse::<usize>().ok());
        if let Some(number) = number.filter(|&number| number >= frames && name == *numbered(number)) {
            bail!("{} is there from another clip, and this one has {frames} frames", numbered(number));
        }
    }
    Ok(())
}

impl Args {
    fn options(&self) -> anyhow::Result<SynthOptions> {
        let named =
            |list: &[(&str, Background)]| list.iter().find(|(n, _)| *n == self.background).map(|b| b.1);
        let mut o = SynthOptions::default();
        o.motion = ScriptedMotion::from_name(&self.motion).context("unknown motion")?;
        o.background = named(&Background::ALL).context("unknown background")?;
        o.frames = self.frames;
        o.rate = self.fps;
        o.size = self.size;
        o.field_of_view = self.fov;
        o.distance = self.distance;
        o.side = self.hand.into();
        o.view = self.view.into();
        o.aside = match (self.two_hands && self.aside == 0.0, o.side) {
            (false, _) => self.aside,
            (true, Side::Right) => -APART,
            (true, Side::Left) => APART,
        };
        o.meets = self.meet;
        o.turn = self.turn.to_radians();
        if let Some(path) = &self.person {
            o.morphology = read_person(path)?.morphology;
        }
        if self.random_hand {
            o.morphology = random_morphology(self.seed);
        }
        o.skin = self.skin;
        o.forearm = !self.no_forearm;
        o.light = self.light.unwrap_or(o.light);
        o.exposure = self.exposure;
        o.noise = self.noise;
        o.roughness = self.roughness;
        o.seed = self.seed;
        if self.output.extension().is_none() {
            o.compression = self.quality;
        }
        Ok(o)
    }

    /// Where the true poses go. A folder and an .avi of one name have the same place for them, where those of the other
    /// are not replaced.
    fn truth(&self, poses: &PoseClip) -> anyhow::Result<PathBuf> {
        if let Some(path) = &self.poses {
            return Ok(path.clone());
        }
        let beside = self.output.with_extension("poses.jsonl");
        let other = self.output.with_extension(if self.output.extension().is_none() { "avi" } else { "" });
        if other.exists() && beside.exists() && fs::read(&beside).ok() != Some(write_lines(poses)?) {
            bail!(
                "{} may have the true poses of {}: --poses says where those of {} go",
                beside.display(),
                other.display(),
                self.output.display()
            );
        }
        try_file(&beside)?;
        Ok(beside)
    }
}

/// The true poses of all hands.
fn poses(synth: &Synth, other: Option<&Synth>) -> PoseClip {
    let o = synth.options();
    let mut header = PoseHeader::one(o.side, Some(o.morphology.clone()), Some(o.rate));
    header.made_by = Some(format!("handcast synth, motion {}, seed {}", o.motion.name(), o.seed));
    if let Some(other) = other {
        let side = other.options().side;
        header.hands.push(ClipHand { side, morphology: Some(o.morphology.clone()) });
    }
    let hands = || [Some(synth), other].into_iter().flatten();
    let at = |i: usize| hands().map(move |hand| TimedPose::new(hand.time(i), hand.pose(i)));
    PoseClip { header, frames: (0..synth.frames()).flat_map(at).collect() }
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let synth = Synth::new(args.options()?)?;
    let other = args.two_hands.then(|| synth.other_hand()).transpose()?;
    let o = synth.options();
    let poses = poses(&synth, other.as_ref());
    let truth = args.truth(&poses)?;
    let mut sink = Sink::create(&args.output, &synth, args.quality.unwrap_or(demo_clip::QUALITY))
        .with_context(|| format!("{}", args.output.display()))?;
    let masks = args
        .masks
        .as_ref()
        .map(|folder| Pictures::create(folder, synth.frames()).with_context(|| folder.display().to_string()));
    let mut masks = masks.transpose()?;
    let progress = progress(!args.quiet, Some(synth.frames() as u64));
    for i in 0..synth.frames() {
        let frames = match &other {
            Some(other) => synth.render_with(other, i).into(),
            None => vec![synth.render(i)],
        };
        sink.write(&frames[0].image).with_context(|| format!("{}", args.output.display()))?;
        if let Some(masks) = &mut masks {
            let rough = |synth: &Synth, seen: &Mask| {
                if o.roughness > 0.0 { synth.silhouette(i) } else { seen.clone() }
            };
            let mut mask = rough(&synth, &frames[0].hand);
            if let (Some(other), Some(frame)) = (&other, frames.get(1)) {
                mask.union_with(&rough(other, &frame.hand));
            }
            masks.save(&mask.to_gray())?;
        }
        progress.inc(1);
    }
    progress.finish_and_clear();
    sink.finish().with_context(|| format!("{}", args.output.display()))?;
    masks.map_or(Ok(()), Pictures::finish)?;
    if truth.as_os_str() == "-" {
        write_output(&truth, &write_lines(&poses)?)?;
    } else {
        write_poses(&truth, &poses)?;
    }
    if !args.quiet {
        let told = match args.output.extension() {
            None => format!("; no picture tells the rate: read them with --input-fps {}", o.rate),
            Some(_) => String::new(),
        };
        let (clip, frames) = (args.output.display(), synth.frames());
        let truth = told_name(&truth);
        errln!("{clip}: {frames} frames; true poses in {truth}{told}");
    }
    Ok(())
}
