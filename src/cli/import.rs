//! `handcast import`: other trackers' joint positions to poses.

use std::borrow::Cow;
use std::io::BufRead;
use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use clap::Args as ClapArgs;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use handcast_codec::{PosesToStreamError, clip_rate};
use handcast_formats::import::{ImportOptions, ImportReport, import_all, in_one_place};
use handcast_formats::landmarks::{Axes, LandmarkClip};
use handcast_formats::motion::{Content, Format, Motion, WriteError, at_even_times, span};
use handcast_formats::person::{check_name, read_person, write_person};
use handcast_gltf::GltfError;
use handcast_hand::landmarks::{LandmarkError, SolverOptions};
use handcast_hand::smooth::SmoothOptions;
use handcast_hand::{Absence, MAX_GAP, Morphology, Person, PoseClip};
use handcast_limits::Limit;

use super::common::{
    HandOrAuto, check_seen, check_span, field_of_view, gap, hand_length, limits, open_input, read_filled,
    read_input,
};
use super::given;
use super::poses_out::OutArgs;
use super::tracking::smoothing;
use super::usage::within;

/// Turns joint positions (21 landmarks, 25 or 26 XR joints) into poses of the hand model.
#[derive(Debug, ClapArgs)]
pub struct Args {
    /// Landmark JSON lines, .pose, .npz, .npy, .bvh of another program, or JSON of MediaPipe, MANO, HaMeR, WiLoR, Leap Motion,
    /// IWER, OpenXR or WebXR; told by their content; - for standard input. Poses (.jsonl, .json, .csv, .bap, streams with the
    /// standard's steps, .glb and .gltf, and .bvh, .vrma, .webxr.json of this program) are written as they are.
    input: PathBuf,
    /// File to write: poses (.jsonl), or .glb, .gltf, .json, .csv, .bvh, .vrma, .webxr.json, .landmarks.jsonl, .pose, .bap.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Which hand, of two in the file that one; auto takes the file's word, or tries both.
    #[arg(long, value_enum, default_value = "auto")]
    hand: HandOrAuto,
    /// Use this person's sizes instead of measuring them in the recording.
    #[arg(long, value_name = "FILE")]
    person: Option<PathBuf>,
    /// Write the sizes to a person file (.toml or .json).
    #[arg(long, value_name = "FILE")]
    save_person: Option<PathBuf>,
    /// Length of the hand, millimetres, 50 to 400, when the file's unit is unknown or wrong.
    #[arg(long, value_name = "MM", value_parser = hand_length)]
    hand_length_mm: Option<f64>,
    /// Axes of the points, where they are not those that files of this kind have (spec/landmarks.md).
    #[arg(long, alias = "axes", value_name = "AXES", value_parser = axes())]
    input_axes: Option<Axes>,
    /// Size of the picture that joints were found in, pixels, where the file does not tell: puts hands before the camera.
    #[arg(long, value_name = "WxH", value_parser = image_size)]
    image_size: Option<[f64; 2]>,
    /// Degrees the camera sees across the picture's longer side, 5 to 150.
    #[arg(long, value_name = "DEG", default_value_t = 60.0, value_parser = field_of_view)]
    fov: f64,
    /// Frames per second of a file that tells none, 0.1 to 1000; 30 are taken otherwise.
    #[arg(long, value_name = "HZ", value_parser = rate)]
    input_fps: Option<f64>,
    /// Keep the couplings of the tracker's model: end joints of fingers follow middle joints, the palm is cupped as they
    /// bend. For joints of hands that handcast tracked.
    #[arg(long)]
    tie: bool,
    /// Do not let fingers and thumb twist.
    #[arg(long)]
    no_twist: bool,
    /// Static joint limits only, without the couplings between neighbouring fingers.
    #[arg(long)]
    limits_only: bool,
    /// Bridge gaps up to this many seconds, 0 to 86400; those between poses that are written as they are only where this is
    /// given.
    #[arg(long, value_name = "S", default_value_t = MAX_GAP, value_parser = gap)]
    max_gap: f64,
    /// Smooth with a 1€ filter, forwards and then backwards, so that nothing lags: cut-off at rest in Hz, and its growth
    /// in Hz per degree per second [default when given alone: 0.5,0.02].
    #[arg(
        long,
        value_name = "MIN_CUTOFF,BETA",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "0.5,0.02",
        value_parser = smoothing
    )]
    smooth: Option<SmoothOptions>,
    /// Neither progress nor report; warnings are told all the same.
    #[arg(short, long)]
    quiet: bool,
    #[command(flatten)]
    out: OutArgs,
}

/// What is asked of how poses are solved for.
fn solving() -> Vec<String> {
    given::among(&[
        "person",
        "hand_length_mm",
        "input_axes",
        "image_size",
        "tie",
        "no_twist",
        "limits_only",
        "smooth",
    ])
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let format = args.out.motion(&args.output)?;
    args.save_person.as_deref().map_or(Ok(()), check_name)?;
    let hands = match read(args)? {
        Input::Poses(poses) => return written(args, poses, format),
        Input::Joints(hands) => chosen(hands, args)?,
    };
    let assumed = hands.iter().any(|hand| hand.rate_assumed);
    if !assumed {
        given::note_idle(format_args!("{} tells its times", args.input.display()), &["input_fps"]);
    }
    let hands: Vec<LandmarkClip> = match args.input_fps {
        Some(rate) => hands.into_iter().map(|hand| hand.at_rate(rate)).collect(),
        None => hands,
    };
    if let Some(notice) = hands.iter().find_map(LandmarkClip::rate_notice) {
        errln!("handcast: {}: {notice}; --input-fps tells another rate", args.input.display());
    }
    if let Some(notice) = hands.iter().find_map(LandmarkClip::pace_notice) {
        errln!("handcast: {}: {notice}", args.input.display());
    }
    let notes: std::collections::BTreeSet<&String> = hands.iter().flat_map(|hand| &hand.notes).collect();
    for note in notes {
        errln!("handcast: {}: {note}", args.input.display());
    }
    let person = args.person.as_deref().map(read_person).transpose()?;
    let options = ImportOptions {
        side: args.hand.known(),
        morphology: person.map(|p| p.morphology),
        hand_length: args.hand_length_mm,
        solver: SolverOptions {
            tie: args.tie,
            thumb: true,
            twists: !args.no_twist,
            dynamic: !args.limits_only,
            ..SolverOptions::default()
        },
        axes: args.input_axes,
        image_size: args.image_size,
        field_of_view: args.fov.to_radians(),
        max_gap: args.max_gap,
        smooth: args.smooth,
    };
    let imported = import_all(&hands, &options).map_err(|error| match error {
        LandmarkError::NoPictureSize => anyhow::Error::new(error).context("--image-size WxH tells it"),
        error => error.into(),
    });
    let (poses, reports) = imported.with_context(|| args.input.display().to_string())?;
    let long = limits().check(Limit::Seconds, span(&poses));
    long.with_context(|| args.input.display().to_string())?;
    let measured = poses.header.hands.first().cloned();
    args.out.write(&args.output, poses, &Morphology::default(), format, serde_json::Map::new())?;
    if let (Some(path), Some(info)) = (&args.save_person, measured)
        && let Some(morphology) = info.morphology
    {
        write_person(path, &Person { name: None, hand: Some(info.side), morphology })?;
    }
    if let Some(notice) = in_one_place(&hands, &reports) {
        let pictured = hands.iter().flat_map(|hand| &hand.frames).any(|frame| frame.picture.is_some());
        let way = if pictured { "; --image-size WxH of their picture puts them apart" } else { "" };
        errln!("handcast: {}: {notice}{way}", args.input.display());
    }
    for report in &reports {
        tell(report, args);
    }
    Ok(())
}

/// Writes poses as they are, but for gaps that are to be bridged.
fn written(args: &Args, mut poses: PoseClip, format: &Format) -> anyhow::Result<()> {
    let name = args.input.display();
    if let Some(side) = args.hand.known() {
        poses.header.hands.retain(|hand| hand.side == side);
        poses.frames.retain(|pose| pose.pose.side == side);
        ensure!(!poses.frames.is_empty(), "{name}: no hand is called {}", side.name());
    }
    if args.save_person.is_some() && poses.header.hands.len() > 1 {
        refuse!("{name}: two hands, and --save-person saves one: choose it with --hand");
    }
    let person = poses.person();
    ensure!(args.save_person.is_none() || person.is_some(), "{name}: it tells no sizes for --save-person");
    if !given::among(&["max_gap"]).is_empty() {
        let rate = clip_rate(&poses);
        check_span(&poses, rate).with_context(|| format!("{name}"))?;
        poses = poses.bridged(rate, args.max_gap);
        let bridged = poses.frames.iter().filter(|pose| pose.why == Some(Absence::Bridged)).count();
        if !args.quiet {
            errln!("{name}: {bridged} poses interpolated in gaps");
        }
    }
    // Lines may be of lost hands alone.
    let seen = check_seen(&name, &poses);
    let written = args.out.write(&args.output, poses, &Morphology::default(), format, serde_json::Map::new());
    written.map_err(|error| if is_empty(&error) { seen.err().unwrap_or(error) } else { error })?;
    match (&args.save_person, person) {
        (Some(path), Some(person)) => Ok(write_person(path, &person)?),
        _ => Ok(()),
    }
}

/// Whether an error is that no pose is there to write.
fn is_empty(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        matches!(
            cause.downcast_ref(),
            Some(
                WriteError::Empty
                    | WriteError::Glb(GltfError::Empty { .. })
                    | WriteError::Baps(PosesToStreamError::Empty { .. })
            )
        )
    })
}

/// What a file has.
enum Input {
    /// Poses of the hand model, to be written as they are.
    Poses(PoseClip),
    /// Joint positions, for which poses are solved.
    Joints(Vec<LandmarkClip>),
}

fn read(args: &Args) -> anyhow::Result<Input> {
    let path = &args.input;
    let piped = path.as_os_str() == "-";
    // What comes through a pipe can be read once.
    if piped || std::fs::metadata(path).is_ok_and(|found| !found.is_file()) {
        let bytes = read_filled(path)?;
        let name = if piped { Path::new("standard input") } else { path };
        return match told(args, name, Format::sniffed(&bytes), || Ok(bytes.as_slice().into()))? {
            Some(input) => Ok(input),
            None => Ok(Input::Joints(LandmarkClip::read_all_from(name, bytes.as_slice(), limits())?)),
        };
    }
    let mut input = open_input(path)?;
    let head = input.fill_buf().with_context(|| format!("cannot read {}", path.display()))?;
    // Lines that nothing is known of are read as joint positions.
    let named = || Format::by_name(path).filter(|format| !["jsonl", "json"].contains(&format.id));
    let format = Format::sniffed(head).or_else(named);
    match told(args, path, format, || Ok(read_input(path, None)?.into()))? {
        Some(input) => Ok(input),
        // A long recording is read piece by piece.
        None => Ok(Input::Joints(LandmarkClip::read_all_within(path, limits())?)),
    }
}

/// What a file tells that may tell poses. Where joints have both places and turns, what is asked of solving decides.
fn told<'a>(
    args: &Args,
    path: &Path,
    format: Option<&Format>,
    bytes: impl FnOnce() -> anyhow::Result<Cow<'a, [u8]>>,
) -> anyhow::Result<Option<Input>> {
    let glb = &args.out.glb;
    if glb.map.is_some() && glb.mesh.is_none() && format.is_none_or(|format| format.kind != "glb") {
        refuse!("--map without --mesh names joints of a .glb or .gltf: {} is none", path.display());
    }
    let Some(format) = format else { return Ok(None) };
    let both = format.id == "webxr";
    let solving = solving();
    if both && !solving.is_empty() || format.kind == "landmarks" && !both {
        return Ok(None);
    }
    let motion = match glb.input_map()? {
        Some(map) => Motion::parse_mapped(path, &bytes()?, &map, limits())?,
        None => match Content::parse_within(path, &bytes()?, limits())? {
            Content::Poses(motion) => *motion,
            Content::Joints(hands) => return Ok(Some(Input::Joints(hands))),
        },
    };
    if let Some(option) = solving.first() {
        refuse!(
            "{option} goes with joint positions: {} has poses, which are written as they are",
            path.display()
        );
    }
    let idle: &[&str] = if motion.rate_assumed { &["fov"] } else { &["fov", "input_fps"] };
    given::note_idle(format_args!("{} has poses, which are written as they are", path.display()), idle);
    let mut motion = match args.input_fps {
        Some(rate) => motion.at_rate(rate),
        None => motion,
    };
    if let Some(notice) = motion.rate_notice() {
        motion.notes.retain(|note| *note != notice);
        errln!("handcast: {}: {notice}; --input-fps tells another rate", path.display());
    }
    motion.notes.iter().for_each(|note| errln!("handcast: {}: {note}", path.display()));
    // Keys are joined, as players do.
    let clip = if motion.keyed {
        at_even_times(motion.clip, limits()).with_context(|| path.display().to_string())?
    } else {
        motion.clip
    };
    Ok(Some(Input::Poses(clip)))
}

/// The hand asked for, of several.
fn chosen(mut hands: Vec<LandmarkClip>, args: &Args) -> anyhow::Result<Vec<LandmarkClip>> {
    if let Some(side) = args.hand.known()
        && hands.len() > 1
    {
        hands.retain(|hand| hand.side == Some(side));
        ensure!(hands.len() == 1, "{}: no hand is called {}", args.input.display(), side.name());
    }
    if args.save_person.is_some() && hands.len() > 1 {
        refuse!("{}: two hands, and --save-person saves one: choose it with --hand", args.input.display());
    }
    Ok(hands)
}

/// What solving found.
fn tell(report: &ImportReport, args: &Args) {
    let side = report.side.name();
    if let Some(notice) = report.notice() {
        let axes =
            if report.exchanged && report.named_surely { ", --input-axes tells other axes" } else { "" };
        errln!("handcast: {notice}; --hand overrules{axes}");
    }
    if args.smooth.is_none()
        && let Some(trembling) = report.trembling()
    {
        errln!("handcast: {side} hand: {trembling}; --smooth steadies them");
    }
    if args.quiet {
        return;
    }
    let seen = if report.flat {
        format!("seen in pictures alone, by a camera of {}°", args.fov)
    } else {
        format!("axes {} ({})", report.axes.name(), report.axes_from.words())
    };
    errln!(
        "{side} hand: {} frames solved, {} bridged, {} lost, {} points missing; joints {:.2} mm from the \
         points on average, {:.1} mm at most; {seen}",
        report.solved,
        report.bridged,
        report.lost,
        report.missing_points,
        report.mean_distance * 1e3,
        report.max_distance * 1e3
    );
}

fn rate(text: &str) -> Result<f64, String> {
    within(text, 0.1..=1000.0, "frames per second")
}

fn axes() -> impl TypedValueParser<Value = Axes> {
    PossibleValuesParser::new(Axes::ALL.map(Axes::name))
        .map(|name| Axes::from_name(&name).unwrap_or_default())
}

fn image_size(text: &str) -> Result<[f64; 2], String> {
    let side = |text: &str| text.parse::<u32>().ok().filter(|v| (1..=1_000_000).contains(v)).map(f64::from);
    let sides = text.split_once(['x', 'X', '×']).and_then(|(w, h)| Some([side(w)?, side(h)?]));
    sides.ok_or_else(|| "expected WIDTHxHEIGHT in pixels, as in 1280x720".into())
}
