//! `handcast bench track`: the paper's comparison of functionals and optimisers, and the default tracker.

pub(super) mod known;
mod measured;
mod report;
mod scaling;
mod sequence;
mod svg;

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::builder::PossibleValuesParser;
use handcast_eval::methods::{Freedom, FunctionalKind, MethodOptions, MethodTracker, OptimiserKind, Order};
use handcast_eval::synth::ScriptedMotion;
use handcast_track::{HandTracker, TrackerOptions, Window};
use handcast_vision::Chamfer;

use self::known::Known;
use self::measured::{Measured, measure, of_pipeline};
use self::report::{Descended, Method, Report, Row};
use self::sequence::{Clip, Sequence, Synthetic};
use crate::cli::common::{Face, Hand, progress, told_kind, write_output};

/// Measures objectives × optimisers × sequences against known poses
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Clips of real hands; without, synthetic sequences
    clips: Vec<PathBuf>,
    /// Synthetic sequences: names as in synth --motion, `paper` (its five), `all`
    #[arg(long, value_delimiter = ',', default_value = "paper", value_parser = sequences())]
    sequences: Vec<String>,
    /// What is minimised [default: all]
    #[arg(long, value_delimiter = ',', value_name = "NAME", value_parser = names(&FunctionalKind::ALL))]
    objectives: Vec<String>,
    /// How it is minimised [default: all]
    #[arg(long, value_delimiter = ',', value_name = "NAME", value_parser = names(&OptimiserKind::ALL))]
    optimisers: Vec<String>,
    /// Leave out the tracker that `handcast run` uses
    #[arg(long)]
    no_default: bool,
    /// Leave out the methods: only the tracker that `handcast run` uses
    #[arg(long, conflicts_with_all = ["no_default", "objectives", "optimisers"])]
    no_methods: bool,
    /// Estimated parameters: position (2), abduction too (7), flexion at the base too (12), scale and rotation
    /// too (16), all (21)
    #[arg(long, default_value = "21", value_parser = names(&Freedom::ALL))]
    freedom: String,
    /// Order of estimation
    #[arg(long, default_value = "fingers", value_parser = names(&Order::ALL))]
    order: String,
    /// Evaluations allowed to one search
    #[arg(long, value_name = "N", default_value_t = MethodOptions::default().evaluations)]
    evaluations: usize,
    /// Simplex and Powell stop when the value gains less than this fraction
    #[arg(long, value_name = "SHARE", default_value_t = MethodOptions::default().tolerance)]
    tolerance: f64,
    /// Searches from larger steps after a poor optimum, at most
    #[arg(long, value_name = "N", default_value_t = MethodOptions::default().restarts)]
    restarts: usize,
    /// What first steps are multiplied by, 0.01 to 100
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    spread: f64,
    /// Distance map of the contour with steps 5-7-11 instead of 3-4
    #[arg(long)]
    fine_chamfer: bool,
    /// Frames of each synthetic sequence [default: 60]; of a clip at most so many [default: all]; 1 to 100000
    #[arg(long, value_name = "N")]
    frames: Option<usize>,
    /// Track every N-th frame only: motion N times as fast, 1 to 1000
    #[arg(long, default_value_t = 1, value_name = "N")]
    every: usize,
    /// Width and height of synthetic pictures, pixels
    #[arg(long, default_value = "320x240", value_name = "WxH", value_parser = crate::cli::synth::size)]
    size: (u32, u32),
    /// Silhouettes of synthetic sequences
    #[arg(long, value_enum, default_value = "model")]
    silhouettes: Silhouettes,
    /// Roughness of their edge, beyond what segmentation leaves: standard deviation, pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 0.0)]
    roughness: f64,
    /// A hand of made-up sizes, chosen by --seed
    #[arg(long)]
    random_hand: bool,
    /// Seed of sequences and of the optimisers that draw lots
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Which hand a clip shows
    #[arg(long, value_enum)]
    hand: Option<Hand>,
    /// Which face of it a clip shows
    #[arg(long, value_enum)]
    view: Option<Face>,
    /// Joints that another tracker found in a clip, with their image positions; one for each clip, in their order.
    /// Measures how far apart the fingertips are in the picture
    #[arg(long, value_name = "FILE.landmarks.jsonl", requires = "clips")]
    reference: Vec<PathBuf>,
    /// Ranges of frames and how many fingers they show, lines such as `120-150 3`; one for each clip, in their
    /// order. Measures in how many of these frames so many fingers are stretched out
    #[arg(long, value_name = "FILE", requires = "clips")]
    counts: Vec<PathBuf>,
    /// Measure instead what a frame costs at several sizes
    #[arg(long, conflicts_with_all = ["clips", "svg"])]
    scaling: bool,
    /// Print the errors of every degree of freedom
    #[arg(long)]
    details: bool,
    /// Everything measured, for machines: into a .json, or without one to standard output, in place of the text
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = "-")]
    json: Option<PathBuf>,
    /// The comparison as a picture
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
}

/// Frames of a synthetic sequence.
const FRAMES: usize = 60;

/// What silhouettes trackers are given.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Silhouettes {
    /// Of the tracker's own primitives: only the registration is measured
    Model,
    /// Of the skinned mesh, cut at the wrist
    Mesh,
    /// Segmented from rendered pictures
    Picture,
}

fn names<T>(list: &[(&'static str, T)]) -> PossibleValuesParser {
    PossibleValuesParser::new(list.iter().map(|(name, _)| *name).collect::<Vec<_>>())
}

fn sequences() -> PossibleValuesParser {
    PossibleValuesParser::new(
        ["paper", "all"].into_iter().chain(ScriptedMotion::ALL.iter().map(|(name, _)| *name)),
    )
}

fn named<T: Copy>(list: &[(&'static str, T)], name: &str) -> anyhow::Result<T> {
    list.iter().find(|(n, _)| *n == name).map(|(_, v)| *v).with_context(|| format!("unknown name {name}"))
}

/// The entries of `list` named; all when none is.
fn chosen<T: Copy>(list: &[(&'static str, T)], wanted: &[String]) -> Vec<(&'static str, T)> {
    list.iter().filter(|(n, _)| wanted.is_empty() || wanted.iter().any(|w| w == n)).copied().collect()
}

impl Args {
    /// Whether standard output is for what was measured, so that nothing else is written there.
    fn prints_json(&self) -> bool {
        self.json.as_deref().is_some_and(|path| path.as_os_str() == "-")
    }

    fn motions(&self) -> Vec<ScriptedMotion> {
        let wanted = |name: &str| self.sequences.iter().any(|s| s == name);
        let listed = |name: &str, motion: ScriptedMotion| {
            wanted("all") || wanted(name) || wanted("paper") && ScriptedMotion::PAPER.contains(&motion)
        };
        ScriptedMotion::ALL
            .into_iter()
            .filter(|(name, motion)| listed(name, *motion))
            .map(|(_, motion)| motion)
            .collect()
    }

    fn method(&self) -> anyhow::Result<MethodOptions> {
        let mut o = MethodOptions::default();
        o.freedom = named(&Freedom::ALL, &self.freedom)?;
        o.order = named(&Order::ALL, &self.order)?;
        o.evaluations = self.evaluations;
        o.tolerance = self.tolerance;
        o.restarts = self.restarts;
        o.spread = self.spread;
        o.seed = self.seed;
        if self.fine_chamfer {
            o.chamfer = Chamfer::FiveSevenEleven;
        }
        Ok(o)
    }

    /// The objectives and optimisers compared.
    #[allow(clippy::type_complexity)]
    fn methods(&self) -> (Vec<(&'static str, FunctionalKind)>, Vec<(&'static str, OptimiserKind)>) {
        match self.no_methods {
            true => (Vec::new(), Vec::new()),
            false => (
                chosen(&FunctionalKind::ALL, &self.objectives),
                chosen(&OptimiserKind::ALL, &self.optimisers),
            ),
        }
    }

    /// What is known of the clips, in their order.
    fn known(&self) -> anyhow::Result<Vec<Known>> {
        for (option, files) in [("--reference", &self.reference), ("--counts", &self.counts)] {
            if !files.is_empty() && files.len() != self.clips.len() {
                refuse!(
                    "{option} is given {} times for {} clips, allowed once for each",
                    files.len(),
                    self.clips.len()
                );
            }
        }
        let read = |i| Known::read(self.reference.get(i), self.counts.get(i));
        (0..self.clips.len()).map(read).collect()
    }

    fn sequences(&self) -> anyhow::Result<Vec<Sequence>> {
        if self.clips.is_empty() {
            let how = Synthetic {
                frames: self.frames.unwrap_or(FRAMES),
                size: self.size,
                seed: self.seed,
                random_hand: self.random_hand,
                roughness: self.roughness,
                silhouettes: self.silhouettes,
            };
            return self.motions().into_iter().map(|m| how.make(m)).collect();
        }
        let how =
            Clip { side: self.hand.map(Into::into), view: self.view.map(Into::into), frames: self.frames };
        self.clips.iter().map(|path| how.read(path)).collect()
    }

    /// Measures every method on all sequences.
    fn measure_all(
        &self,
        base: &MethodOptions,
        sequences: &[Sequence],
        known: &[Known],
        report: &mut Report,
    ) -> anyhow::Result<()> {
        let (objectives, optimisers) = self.methods();
        // The pipeline sees all frames.
        let pipeline = !self.no_default && !self.clips.is_empty() && self.every == 1;
        let own = usize::from(!self.no_default) + usize::from(pipeline);
        let rows = objectives.len() * optimisers.len() + own;
        let progress = progress(true, Some((rows * sequences.len()) as u64));
        // One method on all sequences.
        let row = |name: Row, track: &dyn Fn(&Sequence) -> anyhow::Result<Measured>| {
            let mut results = Vec::new();
            for (i, sequence) in sequences.iter().enumerate() {
                let measured = track(sequence)?;
                let known = known.get(i).map(|known| known.measure(sequence, &measured.found));
                results.push((measured.report, known));
                progress.inc(1);
            }
            anyhow::Ok(Method::new(name, results))
        };
        for &(optimiser_name, optimiser) in &optimisers {
            for &(objective_name, functional) in &objectives {
                let mut options = base.clone();
                options.functional = functional;
                options.optimiser = optimiser;
                report.methods.push(row(Row::Method(objective_name, optimiser_name), &|sequence| {
                    let mut options = options.clone();
                    options.camera = Some(sequence.camera);
                    measure(sequence, self.every, &mut MethodTracker::new(&sequence.fit, options))
                })?);
            }
        }
        if !self.no_default {
            let tracker = row(Row::Default, &|sequence| {
                let mut options = TrackerOptions::default();
                options.camera = Some(sequence.camera);
                measure(sequence, self.every, &mut HandTracker::new(&sequence.fit, options))
            })?;
            report.confidence = report::by_confidence(&tracker);
            report.methods.push(tracker);
        }
        if pipeline {
            report.methods.push(row(Row::Pipeline, &|sequence| Ok(of_pipeline(sequence)))?);
        }
        progress.finish_and_clear();
        Ok(())
    }
}

/// Runs the comparison.
pub fn run(args: &Args) -> anyhow::Result<()> {
    // A clip behind --json is meant to be measured.
    if let Some(path) = args.json.as_deref().filter(|path| told_kind(path, &["json"]).is_some()) {
        refuse!("--json {}: allowed is a name in .json; what is measured stands before", path.display());
    }
    if let Some(frames) = args.frames.filter(|n| !(1..=100_000).contains(n)) {
        refuse!("--frames {frames}, allowed 1 to 100000");
    }
    if !(1..=1000).contains(&args.every) {
        refuse!("--every {}, allowed 1 to 1000", args.every);
    }
    if !(args.spread.is_finite() && (0.01..=100.0).contains(&args.spread)) {
        refuse!("--spread {}, allowed 0.01 to 100", args.spread);
    }
    if args.scaling {
        let costs = scaling::measure(args.frames.unwrap_or(FRAMES), args.seed)?;
        if !args.prints_json() {
            out!("{}", scaling::text(&costs));
        }
        return args.json.as_ref().map_or(Ok(()), |path| write_json(path, &costs));
    }
    let base = args.method()?;
    let known = args.known()?;
    let sequences = args.sequences()?;
    for (known, sequence) in known.iter().zip(&sequences) {
        known.check(sequence)?;
    }
    let mut report = Report::new(args, &sequences);
    args.measure_all(&base, &sequences, &known, &mut report)?;
    if !args.reference.is_empty() && !args.counts.is_empty() {
        report.reference_counts = known.iter().map(Known::counts_of_reference).collect();
    }
    let (objectives, optimisers) = args.methods();
    report.descents = descents(&base, &sequences, &objectives, &optimisers);
    if !args.prints_json() {
        out!("{}", report.text(args.details));
    }
    if let Some(path) = &args.json {
        write_json(path, &report)?;
    }
    if let Some(path) = &args.svg {
        let picture = svg::draw(&report);
        write_output(path, picture.as_bytes())?;
    }
    Ok(())
}

fn write_json(path: &Path, value: &impl serde::Serialize) -> anyhow::Result<()> {
    let bytes = serde_json::to_vec_pretty(value)?;
    write_output(path, &bytes)
}

/// One registration by each method, of a frame in the middle of the first movement of `abduction`, or of the
/// last sequence with truth, from a true state some frames before: 2, 7 and the 12 parameters of the paper's
/// figures at once.
fn descents(
    base: &MethodOptions,
    sequences: &[Sequence],
    objectives: &[(&'static str, FunctionalKind)],
    optimisers: &[(&'static str, OptimiserKind)],
) -> Vec<Descended> {
    let known = |s: &&Sequence| s.frames.iter().all(|f| f.truth.is_some());
    let abduction = sequences.iter().find(|s| s.name == ScriptedMotion::Abduction.name());
    let Some(sequence) = abduction.or(sequences.last()).filter(known) else { return Vec::new() };
    let at = sequence.frames.len() / 6;
    let from = at.saturating_sub((sequence.frames.len() / 15).max(1));
    let (Some(frame), Some(before)) = (sequence.frames.get(at), sequence.frames.get(from)) else {
        return Vec::new();
    };
    let (Some(truth), Some(window)) = (&before.truth, Window::around(&frame.silhouette, frame.forearm, 0.35))
    else {
        return Vec::new();
    };
    let start = handcast_track::ModelState::from_pose(truth, &sequence.camera);
    let mut out = Vec::new();
    for &(optimiser_name, optimiser) in optimisers {
        for &(objective_name, functional) in objectives {
            let mut options = base.clone();
            options.functional = functional;
            options.optimiser = optimiser;
            options.order = Order::Whole;
            options.camera = Some(sequence.camera);
            for (parameters, freedom) in [(2, Freedom::Two), (7, Freedom::Seven), (12, Freedom::Twelve)] {
                options.freedom = freedom;
                let mut tracker = MethodTracker::new(&sequence.fit, options.clone());
                let descent = tracker.descent(&start, &window);
                out.push(Descended {
                    sequence: sequence.name.clone(),
                    from,
                    frame: at,
                    objective: objective_name,
                    optimiser: optimiser_name,
                    parameters,
                    iterations: descent.iterations,
                    evaluations: descent.trace.len(),
                    trace: descent.trace,
                });
            }
        }
    }
    out
}
