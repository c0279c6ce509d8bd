//! Poses to the file a command was asked for: a row of the table of formats, told by the name's ending or `--to`.

use std::fs::File;
use std::io::{BufRead as _, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, bail};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use handcast_formats::atomic::AtomicFile;
use handcast_formats::motion::{Format, WriteError, Written};
use handcast_formats::poses::{PoseWriter, copy_lines};
use handcast_hand::{
    HandMesh, HandPose, Morphology, PoseClip, PoseHeader, Side, Skeleton, TimedPose, skin_tone,
};
use handcast_render::{Style, preview_sheet, still};
use handcast_track::pipeline::ClipError;
use image::ImageFormat;
use nalgebra::Vector3;

use super::common::{Hand, check_span, ending, write_output};
use super::files::{begin_partial, go_on_with_partial, set_aside};
use super::given;
use super::glb_out::GlbArgs;
use super::out::Stdout;
use super::resume::OtherHands;
use super::tracking::Refused;
use super::usage::within;

/// What a command with poses writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// A motion.
    Motion(&'static Format),
    /// A picture, or a sheet of moments.
    Picture,
}

/// The argument that names the kind of file.
pub const TO: &str = "to";

/// The name and the ending of a picture.
const PICTURE: (&str, &str) = ("png", ".png");

impl Output {
    fn told(path: &Path, to: Option<Self>) -> Option<Self> {
        let written = |format: &&'static Format| Format::written().any(|other| other == *format);
        // What is piped on is poses, a line each.
        if to.is_none() && path.as_os_str() == "-" {
            return Format::by_id("jsonl").map(Self::Motion);
        }
        let named = match ending(path).as_str() {
            png if png == PICTURE.0 => Some(Self::Picture),
            _ => Format::by_name(path).filter(written).map(Self::Motion),
        };
        if let (Some(to), Some(named)) = (to, named)
            && to != named
        {
            let (to, named) = (to.names(), named.names());
            errln!(
                "handcast: {}: --{TO} {} is what is written, though the name ends as one of {} does",
                path.display(),
                to.0,
                named.1
            );
        }
        to.or(named)
    }

    /// Its name on the command line, and its ending.
    fn names(self) -> (&'static str, &'static str) {
        match self {
            Self::Motion(format) => (format.id, format.ending),
            Self::Picture => PICTURE,
        }
    }

    /// Reads a name on the command line: of a motion, or where they are written of a picture.
    pub fn parser(pictures: bool) -> impl TypedValueParser<Value = Self> {
        let formats = Format::written()
            .map(|format| PossibleValue::new(format.id).help(format!("{} ({})", format.name, format.ending)));
        let picture = PossibleValue::new(PICTURE.0).help("A picture, or a sheet of moments (.png)");
        PossibleValuesParser::new(formats.chain(pictures.then_some(picture)))
            .map(|id| Format::by_id(&id).map_or(Self::Picture, Self::Motion))
    }
}

fn refusal(path: &Path, more: &[&str]) -> String {
    let endings = Format::written().map(|format| format.ending);
    let names: Vec<_> = endings.chain(more.iter().copied()).collect();
    let other = match ending(path).as_str() {
        "fba" => "; `handcast encode` writes streams",
        "mp4" => "; `handcast render` draws films, `handcast encode` writes streams in MP4 files",
        "gif" | "webp" | "png" => "; `handcast render` draws pictures and animations",
        "fbx" => "; Blender makes FBX of a .glb or a .bvh",
        "" => "; --to names the kind where no ending does",
        "html" | "htm" => "; `handcast view` writes pages",
        _ => "",
    };
    format!("{}: cannot write this kind, allowed are {}{other}", path.display(), names.join(", "))
}

/// What is written, and how.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "What is written")]
pub struct OutArgs {
    /// Kind of file, where the name's ending does not tell
    #[arg(long = TO, value_name = "FORMAT", value_parser = Output::parser(false))]
    pub to: Option<Output>,
    /// Write this many frames a second, 0.1 to 1000, interpolated, in place of the frames there are
    #[arg(long, value_name = "HZ", value_parser = frame_rate)]
    pub fps: Option<f64>,
    /// Write this hand alone
    #[arg(long, value_enum, value_name = "HAND")]
    pub only: Option<Hand>,
    /// Keep the hand at the origin: without the way of the wrist; of two hands, of the middle between them
    #[arg(long)]
    pub centre: bool,
    #[command(flatten)]
    pub glb: GlbArgs,
}

fn frame_rate(text: &str) -> Result<f64, String> {
    within(text, 0.1..=1000.0, "frames per second")
}

impl OutArgs {
    /// What a file of this name holds; `--to` comes first.
    ///
    /// # Errors
    /// Names what is allowed.
    pub fn output(&self, path: &Path) -> anyhow::Result<Output> {
        let Some(output) = Output::told(path, self.to) else { refuse!("{}", refusal(path, &[PICTURE.1])) };
        self.glb.note_idle(match output {
            Output::Motion(format) => {
                given::note_idle(format_args!("{} is no picture", format.ending), &["size"]);
                format.ending.trim_start_matches('.')
            }
            Output::Picture => PICTURE.0,
        });
        Ok(output)
    }

    /// The format of motions that a file of this name holds; `--to` comes first.
    ///
    /// # Errors
    /// Names what is allowed.
    pub fn motion(&self, path: &Path) -> anyhow::Result<&'static Format> {
        let Some(Output::Motion(format)) = Output::told(path, self.to) else {
            refuse!("{}", refusal(path, &[]))
        };
        self.glb.note_idle(format.ending.trim_start_matches('.'));
        Ok(format)
    }

    /// Whether poses are written as they are, all of them.
    pub fn is_all(&self) -> bool {
        self.fps.is_none() && self.only.is_none() && !self.centre
    }

    /// Whether this hand is asked for.
    pub fn wants(&self, side: Side) -> bool {
        self.only.is_none_or(|only| side == only.into())
    }

    /// That there are poses of the one hand asked for.
    pub fn check_found(&self, found: bool) -> anyhow::Result<()> {
        match self.only {
            Some(only) if !found => bail!("there is no {} hand", Side::from(only).name()),
            _ => Ok(()),
        }
    }

    /// The hand and the instants asked for.
    pub fn chosen(&self, mut clip: PoseClip) -> anyhow::Result<PoseClip> {
        clip.header.hands.retain(|hand| self.wants(hand.side));
        clip.frames.retain(|frame| self.wants(frame.pose.side));
        self.check_found(!clip.frames.is_empty())?;
        if self.centre {
            centre(&mut clip);
        }
        let Some(rate) = self.fps else { return Ok(clip) };
        check_span(&clip, rate).context("--fps")?;
        Ok(clip.even(rate))
    }

    /// Writes a file, or to standard output for `-`; the hands that move in it. `facts` go into the extras of a GLB, whose
    /// skin has the tone of the clip where none is asked for.
    pub fn write(
        &self,
        path: &Path,
        clip: PoseClip,
        morphology: &Morphology,
        format: &Format,
        facts: serde_json::Map<String, serde_json::Value>,
    ) -> anyhow::Result<Vec<Side>> {
        let clip = self.chosen(clip)?;
        let glb = self.glb.read()?.named(path);
        let mut sides: Vec<Side> = clip.header.hands.iter().map(|hand| hand.side).collect();
        if format.kind == "glb" {
            glb.tell_of_rig();
            sides.retain(|side| glb.moves(*side));
        }
        let options = glb.options(morphology, facts).with_rate(self.fps);
        let notes = write_whole(path, |out| match format.write_to(&clip, &options, out) {
            Err(error @ WriteError::TwoHands { .. }) => bail!("{error} (--only left, or --only right)"),
            written => Ok(written?),
        })?;
        notes.iter().for_each(|note| errln!("handcast: {note}"));
        Ok(sides)
    }
}

/// Takes out the way of the wrist; of two hands that of the middle between their wrists, as far apart as they were last where one
/// is not seen.
pub fn centre(clip: &mut PoseClip) {
    let mut order: Vec<usize> = (0..clip.frames.len()).filter(|&i| clip.frames[i].valid).collect();
    order.sort_by(|&a, &b| clip.frames[a].time.total_cmp(&clip.frames[b].time));
    let two = clip.header.hands.len() > 1;
    // From the left wrist to the right one.
    let mut apart = Vector3::zeros();
    let mut shifts = vec![Vector3::zeros(); clip.frames.len()];
    for together in order.chunk_by(|&a, &b| clip.frames[b].time - clip.frames[a].time < 1e-6) {
        let wrist = |side: Side| {
            let frame = together.iter().map(|&i| &clip.frames[i].pose).find(|pose| pose.side == side);
            frame.map(|pose| pose.translation)
        };
        let middle = match (wrist(Side::Left), wrist(Side::Right)) {
            (Some(left), Some(right)) => {
                apart = right - left;
                (left + right) / 2.0
            }
            (Some(left), None) if two => left + apart / 2.0,
            (None, Some(right)) if two => right - apart / 2.0,
            (one, other) => one.or(other).unwrap_or_default(),
        };
        together.iter().for_each(|&i| shifts[i] = middle);
    }
    for (frame, shift) in clip.frames.iter_mut().zip(shifts) {
        frame.pose.translation -= shift;
    }
}

/// A file that `write` writes piece by piece and that appears whole, or standard output for `-`.
pub fn write_whole<T>(
    path: &Path,
    write: impl FnOnce(&mut dyn Write) -> anyhow::Result<T>,
) -> anyhow::Result<T> {
    let cannot = "cannot write";
    // Numbers are written one by one: a buffer of its own spares the checks of what is below.
    if path.as_os_str() == "-" {
        let mut out = BufWriter::new(Stdout);
        let written = write(&mut out)?;
        out.flush().context("standard output")?;
        return Ok(written);
    }
    let mut file = BufWriter::new(AtomicFile::create(path).context(cannot)?);
    let written = write(&mut file)?;
    let file = file.into_inner().map_err(|error| error.into_error()).context(cannot)?;
    file.commit().context(cannot)?;
    Ok(written)
}

/// Pose lines on standard output or in a journal, passed on as they come.
#[derive(Default)]
pub struct Lines {
    writer: Option<PoseWriter<BufWriter<Box<dyn Write>>>>,
    /// A journal's file, made with the first pose.
    journal: Option<PathBuf>,
    /// Seconds from which on poses are written, behind those that the journal has.
    from: Option<f64>,
}

impl Lines {
    /// Whether somebody reads them while they come.
    pub fn flow(&self) -> bool {
        self.journal.is_none()
    }

    /// The header that was written last.
    pub fn header(&self) -> Option<&PoseHeader> {
        self.writer.as_ref().map(PoseWriter::header)
    }

    /// Writes poses; before the first, and when a further hand has been found, the header.
    pub fn write(
        &mut self,
        header: impl FnOnce() -> PoseHeader,
        poses: impl IntoIterator<Item = TimedPose>,
    ) -> anyhow::Result<()> {
        let from = self.from.unwrap_or(f64::NEG_INFINITY);
        let mut poses = poses.into_iter().filter(|pose| pose.time >= from).peekable();
        if poses.peek().is_none() {
            return Ok(());
        }
        let header = header();
        let journal = &self.journal;
        let open = || -> anyhow::Result<Box<dyn Write>> {
            let Some(path) = journal else { return Ok(Box::new(Stdout)) };
            Ok(Box::new(if from.is_finite() { go_on_with_partial(path)? } else { begin_partial(path)? }))
        };
        let writer = match &mut self.writer {
            Some(writer) => {
                if writer.header().hands.len() != header.hands.len() {
                    writer.announce(header)?;
                }
                writer
            }
            none => none.insert(PoseWriter::new(BufWriter::new(open()?), header)?),
        };
        let written = poses.try_for_each(|pose| writer.write(&pose)).and_then(|()| writer.flush());
        written.with_context(|| match journal {
            Some(path) => format!("cannot write {}", path.display()),
            None => "cannot write to standard output".into(),
        })
    }
}

/// The poses of a clip while it is tracked, a line each as they are found: FILE.partial.jsonl beside what is to be written.
/// It goes when that is complete, or the clip is refused, and stays when the program is ended before, or what it found cannot
/// be written. One that was there before goes only when what is to be written is complete.
pub struct Journal {
    path: PathBuf,
    was_there: bool,
    done: bool,
    refused: bool,
    tracked: bool,
}

/// The journal that is being written, and whether tracking can go on from it.
static JOURNAL: Mutex<Option<(PathBuf, bool)>> = Mutex::new(None);

impl Journal {
    /// The journal beside `output`.
    pub fn beside(output: &Path) -> Self {
        let path = output.with_extension("partial.jsonl");
        *JOURNAL.lock().unwrap_or_else(PoisonError::into_inner) = Some((path.clone(), true));
        Self { was_there: path.is_file(), path, done: false, refused: false, tracked: false }
    }

    /// Its file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Moves one that a run that was ended has left out of the way of this run, which begins anew, and says so.
    pub fn move_rest(&mut self) -> anyhow::Result<()> {
        if self.was_there {
            set_aside(&self.path, "poses")?;
            self.was_there = false;
        }
        Ok(())
    }

    /// Where its lines are written to; with `from` behind what it has, those of instants from there on.
    pub fn lines(&self, from: Option<f64>) -> Lines {
        Lines { writer: None, journal: Some(self.path.clone()), from }
    }

    /// Writes its poses to a file of pose lines, with the header that is known in the end; `before` gives what instants
    /// have of a hand that was found later.
    pub fn copy_to(
        &self,
        path: &Path,
        header: &PoseHeader,
        before: impl Fn(Side, f64) -> Option<TimedPose>,
    ) -> anyhow::Result<()> {
        let lines = File::open(&self.path).with_context(|| self.path.display().to_string())?;
        write_whole(path, |out| Ok(copy_lines(BufReader::new(lines), header, out, before).map(drop)?))
    }

    /// Takes it away: what it stands for is written.
    pub fn done(mut self) {
        self.done = true;
    }

    /// What tracking gave. Of a clip that is refused nothing is kept.
    pub fn of<T>(&mut self, tracked: anyhow::Result<T>) -> anyhow::Result<T> {
        self.tracked = true;
        if let Err(error) = &tracked {
            self.refused = error.is::<Refused>();
            // Where a clip cannot be read, or shows other hands, the next run stops, too.
            let unread =
                matches!(error.downcast_ref(), Some(ClipError::Frames(_) | ClipError::Unlike { .. }))
                    || error.is::<OtherHands>();
            if let Some((_, resumable)) = &mut *JOURNAL.lock().unwrap_or_else(PoisonError::into_inner) {
                *resumable = !unread;
            }
        }
        tracked
    }

    /// Whether a hand was seen in what it has.
    fn has_poses(&self) -> bool {
        let Ok(file) = File::open(&self.path) else { return false };
        let mut lines = BufReader::new(file).lines().skip(1).map_while(Result::ok);
        lines.any(|line| !line.contains("\"valid\":false"))
    }
}

impl Drop for Journal {
    fn drop(&mut self) {
        // What a run before has left is told of by this one only when it has gone on with it.
        let own = self.tracked || !self.was_there;
        if own && !(self.done || self.refused) && self.has_poses() {
            // It is told of behind what went wrong.
            return;
        }
        *JOURNAL.lock().unwrap_or_else(PoisonError::into_inner) = None;
        if self.done || !self.was_there {
            // There is none of a clip without a hand.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Says where the poses are that were found before the program ended.
pub fn tell_of_journal() {
    let journal = JOURNAL.lock().unwrap_or_else(PoisonError::into_inner).take();
    let Some((path, resumable)) = journal.filter(|(path, _)| path.exists()) else { return };
    let name = path.display();
    if resumable {
        let output = path.with_extension("").with_extension("jsonl");
        errln!(
            "handcast: the poses tracked so far are in {name}; track --resume -o {} (without --overlay and --mask) goes on \
             from there",
            output.display()
        );
    } else {
        errln!("handcast: the poses until there are in {name}, which encode and import take");
    }
}

/// The content of a file, after what is worth saying of it was said.
pub fn written(file: Written) -> anyhow::Result<Vec<u8>> {
    for note in &file.notes {
        errln!("handcast: {note}");
    }
    Ok(file.bytes)
}

/// One hand and how it moves.
pub struct Motion {
    pub side: Side,
    pub morphology: Morphology,
    pub poses: Vec<(f64, HandPose)>,
    /// Frames per second, of more than one pose.
    pub rate: Option<f64>,
}

/// Pictures on a sheet of moments, and in one of its rows.
const MOMENTS: (usize, u32) = (24, 6);

/// Writes any kind of [`Output`].
pub fn write(motion: Motion, path: &Path, out: &OutArgs, cell: (u32, u32)) -> anyhow::Result<()> {
    let output = out.output(path)?;
    let mut header = PoseHeader::one(motion.side, Some(motion.morphology.clone()), motion.rate);
    header.made_by = Some(format!("handcast {}", env!("CARGO_PKG_VERSION")));
    let frames = motion.poses.into_iter().map(|(t, pose)| TimedPose::new(t, pose)).collect();
    let clip = PoseClip { header, frames };
    if let Output::Motion(format) = output {
        let mut facts = serde_json::Map::new();
        facts.insert("frames_per_second".into(), motion.rate.into());
        return out.write(path, clip, &motion.morphology, format, facts).map(drop);
    }
    let mesh = HandMesh::generate(&motion.morphology, motion.side);
    let skeleton = Skeleton::new(&motion.morphology, motion.side);
    let clip = out.chosen(clip)?;
    let frames: Vec<_> = clip.frames.iter().map(|f| (f.time, skeleton.frames(&f.pose))).collect();
    let style =
        Style { skin: out.glb.tone.and_then(skin_tone).unwrap_or(Style::default().skin), ..Style::default() };
    let picture = match frames.as_slice() {
        [(_, frames)] => still(&mesh, frames, cell, &style),
        several => preview_sheet(&mesh, several, MOMENTS.0, MOMENTS.1, cell, &style),
    };
    let mut bytes = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut bytes, ImageFormat::Png).with_context(|| path.display().to_string())?;
    write_output(path, &bytes.into_inner())
}
