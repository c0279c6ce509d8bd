//! What was measured, as text and for machines.

use std::fmt::Write as _;

use handcast_eval::fidelity::{CountReport, TrackingReport};
use serde::Serialize;

use super::Args;
use super::known::KnownReport;
use super::sequence::Sequence;

/// Evaluations and iterations of the paper's fig. 17.
pub const PAPER: [(&str, usize, usize); 2] = [("simplex", 63, 32), ("powell", 308, 18)];

/// The whole comparison. The fields are the keys of the JSON file.
#[derive(Debug, Serialize)]
pub struct Report {
    pub sequences: Vec<String>,
    pub frames: Vec<usize>,
    pub freedom: String,
    pub order: String,
    pub silhouettes: String,
    pub seed: u64,
    pub methods: Vec<Method>,
    /// Of the default tracker: how its errors go with its confidence.
    pub confidence: Vec<Sure>,
    pub descents: Vec<Descended>,
    /// Of the clips, in their order: the reference against the labels; empty without either.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub reference_counts: Vec<Option<CountReport>>,
}

/// One method on all sequences.
#[derive(Debug, Serialize)]
pub struct Method {
    /// Optimiser and objective, `default tracker` or `handcast track`.
    pub name: String,
    pub objective: Option<&'static str>,
    pub optimiser: Option<&'static str>,
    pub summary: Summary,
    /// In the order of the sequences.
    pub results: Vec<TrackingReport>,
    /// Agreement with what is known of the clips, in their order.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub known: Vec<KnownReport>,
}

/// What a row of the comparison is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Row {
    /// Objective and optimiser.
    Method(&'static str, &'static str),
    /// The tracker that `handcast run` uses, from the open hand on.
    Default,
    /// `handcast track`: all frames of a clip, those before the open hand too.
    Pipeline,
}

/// Means over the sequences (each counts the same), sums of frames.
#[derive(Debug, Default, Serialize)]
pub struct Summary {
    pub moving_deg: Option<f64>,
    pub moving_mm: Option<f64>,
    pub angle_deg: Option<f64>,
    pub angle_p95_deg: Option<f64>,
    pub fingertip_mm: Option<f64>,
    pub iou: f64,
    pub evaluations: f64,
    pub ms: f64,
    pub lost: usize,
    pub false_frames: usize,
    pub restarts: usize,
}

/// The frames between two levels of confidence.
#[derive(Debug, Serialize)]
pub struct Sure {
    /// A third of all frames, or all between two levels.
    pub what: &'static str,
    pub from: f64,
    pub to: f64,
    pub frames: usize,
    /// Mean error of the joint angles, degrees.
    pub angle_deg: f64,
}

/// Frames by their confidence: thirds from the least sure, then quarters of the scale.
pub fn by_confidence(tracker: &Method) -> Vec<Sure> {
    let mut frames: Vec<(f64, f64)> =
        tracker.results.iter().flat_map(|r| r.sureness.iter().copied()).collect();
    frames.sort_by(|a, b| a.0.total_cmp(&b.0));
    let row = |what, from, to, part: &[(f64, f64)]| Sure {
        what,
        from,
        to,
        frames: part.len(),
        angle_deg: mean(part.iter().map(|f| f.1)).unwrap_or(0.0),
    };
    let mut rows = Vec::new();
    if frames.len() < 3 {
        return rows;
    }
    for (k, what) in ["least sure third", "middle third", "surest third"].into_iter().enumerate() {
        let part = &frames[k * frames.len() / 3..(k + 1) * frames.len() / 3];
        rows.push(row(what, part[0].0, part[part.len() - 1].0, part));
    }
    for k in 0..4 {
        let (from, to) = (0.25 * f64::from(k), 0.25 * f64::from(k + 1));
        let part: Vec<_> = frames.iter().filter(|f| f.0 >= from && (f.0 < to || k == 3)).copied().collect();
        rows.push(row("confidence", from, to, &part));
    }
    rows
}

/// One registration by one method (fig. 17).
#[derive(Debug, Serialize)]
pub struct Descended {
    pub sequence: String,
    /// The frame whose true state is the start.
    pub from: usize,
    pub frame: usize,
    pub objective: &'static str,
    pub optimiser: &'static str,
    /// Parameters estimated, at once.
    pub parameters: usize,
    pub iterations: usize,
    pub evaluations: usize,
    /// The best value after each evaluation.
    pub trace: Vec<f64>,
}

impl Descended {
    /// Evaluations until the value was within a twentieth of all that was gained.
    pub fn near_end(&self) -> usize {
        let (Some(first), Some(last)) = (self.trace.first(), self.trace.last()) else { return 0 };
        let goal = last + 0.05 * (first - last);
        self.trace.iter().position(|v| *v <= goal).map_or(0, |i| i + 1)
    }
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0usize), |(s, n), v| (s + v, n + 1));
    (count > 0).then(|| sum / count as f64)
}

impl Method {
    pub fn new(row: Row, results: Vec<(TrackingReport, Option<KnownReport>)>) -> Self {
        let (results, known): (Vec<_>, Vec<_>) = results.into_iter().unzip();
        let some = |f: fn(&TrackingReport) -> Option<f64>| mean(results.iter().filter_map(f));
        let all = |f: fn(&TrackingReport) -> f64| mean(results.iter().map(f)).unwrap_or(0.0);
        let sum = |f: fn(&TrackingReport) -> usize| results.iter().map(f).sum();
        let summary = Summary {
            moving_deg: some(|r| r.moving_mean_deg),
            moving_mm: some(|r| r.moving_mean_mm),
            angle_deg: some(|r| r.angle_mean_deg),
            angle_p95_deg: some(|r| r.angle_p95_deg),
            fingertip_mm: some(|r| r.fingertip_mean_mm),
            iou: all(|r| r.iou_mean),
            evaluations: all(|r| r.evaluations_mean),
            ms: all(|r| r.ms_per_frame),
            lost: sum(|r| r.lost_frames),
            false_frames: sum(|r| r.false_frames),
            restarts: sum(|r| r.restarts),
        };
        let (name, objective, optimiser) = match row {
            Row::Method(a, b) => (format!("{b}, {a}"), Some(a), Some(b)),
            Row::Default => ("default tracker".into(), None, None),
            Row::Pipeline => ("handcast track".into(), None, None),
        };
        Self { name, objective, optimiser, summary, results, known: known.into_iter().flatten().collect() }
    }
}

fn number(value: Option<f64>) -> String {
    value.map_or("-".into(), |v| format!("{v:.2}"))
}

impl Report {
    pub fn new(args: &Args, sequences: &[Sequence]) -> Self {
        Self {
            sequences: sequences.iter().map(|s| s.name.clone()).collect(),
            frames: sequences.iter().map(|s| s.frames.len().div_ceil(args.every)).collect(),
            freedom: args.freedom.clone(),
            order: args.order.clone(),
            silhouettes: if args.clips.is_empty() {
                format!("{:?}", args.silhouettes).to_lowercase()
            } else {
                "clips".into()
            },
            seed: args.seed,
            methods: Vec::new(),
            confidence: Vec::new(),
            descents: Vec::new(),
            reference_counts: Vec::new(),
        }
    }

    fn known(&self) -> bool {
        self.methods.iter().any(|m| m.summary.angle_deg.is_some())
    }

    pub fn text(&self, details: bool) -> String {
        let mut t = String::new();
        let frames: usize = self.frames.iter().sum();
        let _ = writeln!(
            t,
            "{} sequences, {frames} frames; {} parameters, order {}; silhouettes: {}; seed {}\n",
            self.sequences.len(),
            self.freedom,
            self.order,
            self.silhouettes,
            self.seed
        );
        self.overview(&mut t);
        self.by_sequence(&mut t);
        self.table_1(&mut t);
        self.figure_17(&mut t);
        self.sureness(&mut t);
        self.agreement(&mut t);
        if details {
            for method in &self.methods {
                for (name, result) in self.sequences.iter().zip(&method.results) {
                    let _ = writeln!(t, "\n{}: {name}\n{result}", method.name);
                }
            }
        }
        t
    }

    fn overview(&self, t: &mut String) {
        let _ = writeln!(
            t,
            "{:<27} {:>8} {:>7} {:>7} {:>7} {:>7} {:>6} {:>7} {:>7} {:>5} {:>8}",
            "method",
            "moving°",
            "moving",
            "joint°",
            "95 %°",
            "tips",
            "IoU",
            "evals/",
            "ms/",
            "lost",
            "restarts"
        );
        let _ = writeln!(
            t,
            "{:<27} {:>8} {:>7} {:>7} {:>7} {:>7} {:>6} {:>7} {:>7}",
            "", "", "mm", "mean", "", "mm", "", "frame", "frame"
        );
        for m in &self.methods {
            let s = &m.summary;
            let _ = writeln!(
                t,
                "{:<27} {:>8} {:>7} {:>7} {:>7} {:>7} {:>6.3} {:>7.0} {:>7.2} {:>5} {:>8}",
                m.name,
                number(s.moving_deg),
                number(s.moving_mm),
                number(s.angle_deg),
                number(s.angle_p95_deg),
                number(s.fingertip_mm),
                s.iou,
                s.evaluations,
                s.ms,
                s.lost,
                s.restarts
            );
        }
    }

    /// The errors sequence by sequence; of clips the overlap.
    fn by_sequence(&self, t: &mut String) {
        if !self.known() {
            self.of_sequences(t, "IoU", |r| format!("{:.3}", r.iou_mean));
            return;
        }
        let what = "mean error of what moves (degrees, or mm where only the position moves)";
        self.of_sequences(t, what, |r| match (r.moving_mean_deg, r.moving_mean_mm) {
            (Some(d), _) => format!("{d:.2}"),
            (None, Some(mm)) => format!("{mm:.2} mm"),
            (None, None) => "-".into(),
        });
        let what = "mean error of all joint angles (degrees) and of fingertips (mm)";
        self.of_sequences(t, what, |r| {
            format!("{} {:>5}", number(r.angle_mean_deg), number(r.fingertip_mean_mm))
        });
    }

    /// A row for each method, a column for each sequence.
    fn of_sequences(&self, t: &mut String, what: &str, cell: impl Fn(&TrackingReport) -> String) {
        let row = |name: &str, cells: Vec<String>| {
            format!("{name:<27}{}", cells.iter().map(|c| format!(" {c:>12}")).collect::<String>())
        };
        let _ = writeln!(t, "\n{what}:\n{}", row("method", self.sequences.clone()));
        for m in &self.methods {
            let _ = writeln!(t, "{}", row(&m.name, m.results.iter().map(&cell).collect()));
        }
    }

    fn names(&self, of: fn(&Method) -> Option<&'static str>) -> Vec<&'static str> {
        let mut names: Vec<&'static str> = Vec::new();
        for name in self.methods.iter().filter_map(of) {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        names
    }

    /// The paper's Table 1, with what it left empty.
    fn table_1(&self, t: &mut String) {
        let (objectives, optimisers) = (self.names(|m| m.objective), self.names(|m| m.optimiser));
        if objectives.is_empty() {
            return;
        }
        let what = if self.known() { "mean error of what moves, degrees" } else { "mean IoU" };
        let _ = writeln!(t, "\nTable 1 of the paper, filled in: {what} / evaluations a frame");
        let _ =
            writeln!(t, "{:<14}{}", "", objectives.iter().map(|o| format!(" {o:>16}")).collect::<String>());
        for optimiser in optimisers {
            let _ = write!(t, "{optimiser:<14}");
            for &objective in &objectives {
                let found = self
                    .methods
                    .iter()
                    .find(|m| m.optimiser == Some(optimiser) && m.objective == Some(objective));
                let cell = found.map_or("-".into(), |m| {
                    let value = if self.known() {
                        number(m.summary.moving_deg)
                    } else {
                        format!("{:.3}", m.summary.iou)
                    };
                    format!("{value} / {:.0}", m.summary.evaluations)
                });
                let _ = write!(t, " {cell:>16}");
            }
            let _ = writeln!(t);
        }
    }

    fn sureness(&self, t: &mut String) {
        if self.confidence.is_empty() {
            return;
        }
        let _ = writeln!(t, "\nmean error of the joint angles by confidence, default tracker:");
        for s in &self.confidence {
            let range = format!("{:.2} to {:.2}", s.from, s.to);
            let _ = writeln!(t, "{:<17} {range:<13} {:>6} frames {:>7.2}°", s.what, s.frames, s.angle_deg);
        }
    }

    fn figure_17(&self, t: &mut String) {
        let Some(first) = self.descents.first() else { return };
        let _ = writeln!(
            t,
            "\nFig. 17: evaluations (iterations) of one registration ({}, frame {} from frame {}), all parameters at once",
            first.sequence, first.frame, first.from
        );
        let _ = writeln!(
            t,
            "{:<27} {:>14} {:>14} {:>14} {:>10} {:>9} {:>9}  paper",
            "method", "2 parameters", "7", "12", "95 % after", "from", "to"
        );
        // Three descents, with more and more parameters, for each method.
        for of_method in self.descents.chunks(3) {
            let Some(d) = of_method.last() else { continue };
            let _ = write!(t, "{:<27}", format!("{}, {}", d.optimiser, d.objective));
            for d in of_method {
                let _ = write!(t, " {:>14}", format!("{} ({})", d.evaluations, d.iterations));
            }
            let paper = PAPER
                .iter()
                .find(|(name, ..)| *name == d.optimiser && d.objective == "non-overlap")
                .map(|(_, e, i)| format!("{e} ({i})"))
                .unwrap_or_default();
            let (from, to) =
                (d.trace.first().copied().unwrap_or(0.0), d.trace.last().copied().unwrap_or(0.0));
            let _ = writeln!(t, " {:>10} {from:>9.4} {to:>9.4}  {paper}", d.near_end());
        }
    }
}
