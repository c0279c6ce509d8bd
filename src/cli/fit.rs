//! `handcast fit`: the sizes of a person's hand from one picture of it, open.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use handcast_formats::atomic::AtomicFile;
use handcast_formats::person::{check_name, write_person};
use handcast_hand::anthropometry::{Bounds, CONSTRAINTS, Measure, check};
use handcast_hand::{Finger, Person};
use handcast_media::Part;
use handcast_render::draw_stages;
use handcast_track::pipeline::{Stages, StillFit, StillOptions, StillTimings, fit_still};
use handcast_track::{Fit, View};
use image::RgbImage;
use image::codecs::png::PngEncoder;

use super::common::{FaceOrAuto, HandOrAuto, field_of_view, hand_length, opening};
use super::part::PartArgs;

/// Measures a person's hand in one picture of it, fingers spread, and writes a person file
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Picture of one open hand, palm or back to the camera; of a clip one frame is taken
    image: PathBuf,
    /// Person file to write: .toml or .json
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Which hand; auto tells it from the thumb, for the palm
    #[arg(long, value_enum, default_value = "auto")]
    hand: HandOrAuto,
    /// Which face of the hand the camera sees; auto takes the palm, or what --hand and the thumb tell
    #[arg(long, value_enum, default_value = "auto")]
    view: FaceOrAuto,
    /// Wrist to middle fingertip, millimetres, 50 to 400 [default: 189, the mean]
    #[arg(long, value_name = "MM", value_parser = hand_length)]
    hand_length_mm: Option<f64>,
    /// Picture of the silhouette, white is hand
    #[arg(long, value_name = "FILE", conflicts_with = "sample")]
    mask: Option<PathBuf>,
    /// Where there is skin: a rectangle of the picture in pixels, or another picture with nothing but skin
    #[arg(long, value_name = "X,Y,W,H|FILE")]
    sample: Option<String>,
    /// Degrees the camera sees across the longer side, 5 to 150
    #[arg(long, value_name = "DEG", default_value_t = 60.0, value_parser = field_of_view)]
    fov: f64,
    /// Number of the frame, from 0, when the input is a clip; with --from counted from there
    #[arg(long, value_name = "N", default_value_t = 0)]
    frame: usize,
    /// Folder for a picture of each stage, and fit.png with all of them
    #[arg(long, value_name = "DIR")]
    debug: Option<PathBuf>,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
    /// Neither progress nor report; warnings are told all the same
    #[arg(short, long)]
    quiet: bool,
    #[command(flatten)]
    part: PartArgs,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    check_name(&args.output)?;
    let name = args.image.display();
    let image = picture(&args.image, args.frame, args.part.part()?)?;
    let mut options = StillOptions::default();
    options.side = args.hand.known();
    options.view = args.view.known();
    options.hand_length = args.hand_length_mm.unwrap_or(options.hand_length);
    options.field_of_view = args.fov;
    if let Some(path) = &args.mask {
        options.mask = Some(image::imageops::grayscale(&picture(path, 0, Part::WHOLE)?));
    }
    options.sample = args.sample.as_deref().map(|text| sample(text, &image)).transpose()?;
    let mut stages = Stages::default();
    let found = fit_still(&image, &options, &mut stages);
    if let Some(dir) = &args.debug {
        // Above all when the fit fails: the pictures show where.
        write_pictures(dir, &stages)?;
    }
    let found = found.with_context(|| format!("{name}"))?;
    let person = Person { name: None, hand: Some(found.fit.side), morphology: found.fit.morphology.clone() };
    write_person(&args.output, &person)?;
    let scale = f64::from(image.width()) / f64::from(stages.image.width());
    let report = Report::new(args, &found, &stages, scale);
    // The report says it, too.
    if report.hand_assumed && (args.json || args.quiet) {
        errln!("handcast: {name}: that it is a {} hand is a guess: see --hand and --view", report.hand);
    }
    if args.json {
        outln!("{}", serde_json::to_string_pretty(&report)?);
    } else if !args.quiet {
        out!("{}", report.text());
        outln!("  person      {}", args.output.display());
    }
    Ok(())
}

/// A picture of a part of a clip, by its number in it.
fn picture(path: &Path, frame: usize, part: Part) -> anyhow::Result<RgbImage> {
    let mut source = handcast_media::open(path, &opening().with_part(part))?;
    let (mut first, mut read) = (None, 0);
    while let Some(next) = source.next_frame()? {
        let number = next.index.saturating_sub(*first.get_or_insert(next.index));
        if number == frame {
            return Ok(next.image);
        }
        read = number + 1;
    }
    let shortfall = source.shortfall().map_or_else(String::new, |told| format!(" ({told})"));
    anyhow::bail!("{}: frame {frame} of {read}{shortfall}", path.display())
}

/// The piece of skin that `--sample` names.
fn sample(text: &str, image: &RgbImage) -> anyhow::Result<RgbImage> {
    let numbers: Result<Vec<u32>, _> = text.split(',').map(|part| part.trim().parse::<u32>()).collect();
    let Ok(&[x, y, w, h]) = numbers.as_deref() else {
        return picture(Path::new(text), 0, Part::WHOLE).context("--sample is neither X,Y,W,H nor a picture");
    };
    let inside = |from: u32, length: u32, all: u32| {
        length > 0 && u64::from(from) + u64::from(length) <= u64::from(all)
    };
    ensure!(
        inside(x, w, image.width()) && inside(y, h, image.height()),
        "--sample {text}: allowed are rectangles inside the picture of {} x {} pixels",
        image.width(),
        image.height()
    );
    Ok(image::imageops::crop_imm(image, x, y, w, h).to_image())
}

fn write_pictures(dir: &Path, stages: &Stages) -> anyhow::Result<()> {
    std::fs::create_dir_all(dir).with_context(|| format!("cannot make the folder {}", dir.display()))?;
    for (name, picture) in draw_stages(stages) {
        let path = dir.join(name);
        let mut file = AtomicFile::create(&path)?;
        picture.write_with_encoder(PngEncoder::new(&mut file))?;
        file.commit().context("cannot write")?;
    }
    Ok(())
}

/// What was found. The fields are the keys of the JSON report; lengths in millimetres on the hand, places in
/// pixels of the picture.
#[derive(Debug, serde::Serialize)]
struct Report {
    image: String,
    hand: &'static str,
    view: View,
    /// Whether palm or back is a guess: `--hand` or `--view` settle it.
    view_assumed: bool,
    /// Whether the side is a guess, too: a silhouette tells it for one view alone.
    hand_assumed: bool,
    hand_length_mm: f64,
    /// Whether the length is the mean, for want of `--hand-length-mm`.
    hand_length_assumed: bool,
    fingers: Vec<FingerReport>,
    palm_length_mm: f64,
    palm_width_mm: f64,
    palm_thickness_mm: f64,
    wrist_width_mm: f64,
    wrist: [f64; 2],
    /// Where the inertia axes of hand and fingers cross.
    wrist_by_axes: [f64; 2],
    forearm: bool,
    iou: f64,
    /// The anthropometric constraints that the hand does not keep, in words.
    unusual: Vec<String>,
    constraints: usize,
    ms: Times,
}

#[derive(Debug, serde::Serialize)]
struct FingerReport {
    finger: &'static str,
    /// From its joint in the palm to the tip.
    length_mm: f64,
    /// From its root, where it leaves the palm, to the tip; of the thumb its two phalanges.
    outer_length_mm: f64,
    /// Half the width at the root, the two joints after it and the tip.
    radii_mm: [f64; 4],
    /// In the plane of the palm, away from the middle finger; of the thumb towards it.
    abduction_deg: f64,
}

#[derive(Debug, serde::Serialize)]
struct Times {
    learn: f64,
    segment: f64,
    parts: f64,
    fit: f64,
    total: f64,
}

impl From<&StillTimings> for Times {
    fn from(t: &StillTimings) -> Self {
        let ms = |d: std::time::Duration| 1e3 * d.as_secs_f64();
        Self {
            learn: ms(t.learn),
            segment: ms(t.segment),
            parts: ms(t.parts),
            fit: ms(t.fit),
            total: ms(t.total()),
        }
    }
}

impl Report {
    /// `scale` is the size of the picture over that at which it was analysed.
    fn new(args: &Args, found: &StillFit, stages: &Stages, scale: f64) -> Self {
        let fit = &found.fit;
        let m = &fit.morphology;
        let mm = |metres: f64| 1e3 * metres;
        let measure = |measure: Measure| mm(measure.of(m));
        let by_axes = stages.parts.as_ref().map_or([0.0; 2], |p| p.wrist_by_axes);
        Self {
            image: args.image.display().to_string(),
            hand: fit.side.name(),
            view: found.view,
            view_assumed: found.assumed,
            hand_assumed: found.assumed && args.hand.known().is_none(),
            hand_length_mm: mm(m.hand_length),
            hand_length_assumed: args.hand_length_mm.is_none(),
            fingers: Finger::ALL.map(|f| FingerReport::new(fit, f)).into(),
            palm_length_mm: measure(Measure::PalmLength),
            palm_width_mm: measure(Measure::PalmWidth),
            palm_thickness_mm: mm(2.0 * m.palm_radius),
            wrist_width_mm: mm(2.0 * m.wrist_half_width),
            wrist: fit.state.wrist.map(|v| v * scale),
            wrist_by_axes: by_axes.map(|v| v * scale),
            forearm: fit.forearm.is_some(),
            iou: fit.iou,
            unusual: check(m, Bounds::Persons).iter().map(ToString::to_string).collect(),
            constraints: CONSTRAINTS.len(),
            ms: Times::from(&stages.timings),
        }
    }

    fn text(&self) -> String {
        let mut t = String::new();
        let view = self.view.name();
        let assumed = if self.view_assumed {
            let other = if self.hand == "right" { "left" } else { "right" };
            format!(
                " (a guess: the back of a {other} hand has the same silhouette; --hand or --view settles it)"
            )
        } else {
            String::new()
        };
        let _ = writeln!(t, "{}: {} hand, {view}{assumed}", self.image, self.hand);
        let from = if self.hand_length_assumed { " (the mean; see --hand-length-mm)" } else { "" };
        let _ = writeln!(t, "  hand        {:.1} mm long{from}", self.hand_length_mm);
        let _ = writeln!(
            t,
            "  palm        {:.1} mm long, {:.1} mm wide, {:.1} mm thick",
            self.palm_length_mm, self.palm_width_mm, self.palm_thickness_mm
        );
        for f in &self.fingers {
            let radii = f.radii_mm.map(|r| format!("{r:.1}")).join(" ");
            let _ = writeln!(
                t,
                "  {:<11} {:5.1} mm long ({:.1} from the root), radii {radii} mm, abduction {:.1}°",
                f.finger, f.length_mm, f.outer_length_mm, f.abduction_deg
            );
        }
        let [x, y] = self.wrist;
        let [ax, ay] = self.wrist_by_axes;
        let _ = writeln!(
            t,
            "  wrist       at {x:.0}, {y:.0} px, {:.1} mm wide{}; axes cross at {ax:.0}, {ay:.0} px",
            self.wrist_width_mm,
            if self.forearm { ", cut from the forearm" } else { "" }
        );
        let _ = writeln!(t, "  overlap     {:.3}", self.iou);
        let kept = self.constraints - self.unusual.len();
        let _ = writeln!(t, "  proportions {kept} of {} anthropometric constraints kept", self.constraints);
        for line in &self.unusual {
            let _ = writeln!(t, "    {line}");
        }
        let ms = &self.ms;
        let _ = writeln!(
            t,
            "  time        {:.0} ms: colours {:.0}, silhouette {:.0}, parts {:.0}, model {:.0}",
            ms.total, ms.learn, ms.segment, ms.parts, ms.fit
        );
        t
    }
}

impl FingerReport {
    fn new(fit: &Fit, finger: Finger) -> Self {
        let f = fit.morphology.finger(finger);
        let i = finger as usize;
        Self {
            finger: ["thumb", "index", "middle", "ring", "little"][i],
            length_mm: 1e3 * f.length(),
            outer_length_mm: 1e3 * Measure::FingerLength(finger).of(&fit.morphology),
            radii_mm: f.radii.map(|r| 1e3 * r),
            abduction_deg: fit.in_plane(finger).to_degrees(),
        }
    }
}
