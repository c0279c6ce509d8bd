//! `handcast corpus`: a folder of clips and motions to a folder of streams.

use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{bail, ensure};
use glob::Pattern;
use handcast_corpus::{Choice, Corpus, Item, Outcome, Report, Settings, Worker};
use handcast_formats::motion::Format;
use indicatif::{HumanDuration, ProgressBar, ProgressStyle};

use super::common::{RateArgs, counted, limits, progress};
use super::ending::place_of;
use super::given;
use super::part::PartArgs;
use super::tracking::TrackArgs;

/// Tracks and encodes all clips and motion files of a folder and its subfolders
///
/// OUT/streams has a stream for each input, OUT/manifest.jsonl a line for each stream, OUT/failures.jsonl one for each
/// input that made none, OUT/report.html what is worth looking at. Of motion files too a part and one hand are taken where
/// they are asked for, and sizes and smoothing where poses are solved for. Called again it goes on where it was ended, and
/// does anew what has changed since.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder with clips (MP4, MOV, AVI, GIF, WebP, Y4M; what ffmpeg reads, where it is there) and motion files (all that
    /// encode reads)
    input: PathBuf,
    /// Folder for the results
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Inputs that are worked on at a time, 1 to 1024 [default: one for each core]
    #[arg(short, long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    /// Only inputs whose path below the folder fits this pattern, such as "*.mp4" or "day1/*"; may be repeated
    #[arg(long = "match", alias = "only", value_name = "PATTERN", value_parser = pattern)]
    only: Vec<Pattern>,
    /// Try inputs again that failed
    #[arg(long)]
    retry: bool,
    /// Read all inputs and streams to see what has changed or was damaged; else an input's size and time tell, and a
    /// stream's size
    #[arg(long)]
    checksum: bool,
    #[command(flatten)]
    part: PartArgs,
    #[command(flatten)]
    track: TrackArgs,
    #[command(flatten)]
    rate: RateArgs,
}

fn pattern(text: &str) -> Result<Pattern, String> {
    Pattern::new(text).map_err(|error| error.to_string())
}

/// As many as there are cores.
pub fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let show = !args.track.quiet && !args.track.json;
    let (mut track, finder) = args.track.settings()?;
    let part = args.part.part()?;
    (track.from, track.until) = (part.from, Some(part.until).filter(|until| until.is_finite()));
    let settings = Settings { track, encode: args.rate.settings() };
    let mut choice = Choice::default();
    choice.only.clone_from(&args.only);
    choice.checksum = args.checksum;
    choice.retry = args.retry;
    check_input(&args.input)?;
    let mut corpus = Corpus::open(&args.input, &args.output, &settings, &choice)?;
    let known = corpus.done_before() + corpus.failed_before();
    ensure!(
        corpus.inputs() > 0,
        "{}: no clip and no motion file in it{}",
        args.input.display(),
        if args.only.is_empty() { "" } else { " that --match lets through" }
    );
    tell_of_work(&corpus);
    let worker =
        Worker::new(&args.input, &args.output, &settings).with_finder(finder).with_limits(limits().clone());
    let worker = worker.with_places(place_of);
    let jobs = args.jobs.map_or_else(cores, usize::from);
    let mut shown = Shown::new(show, corpus.todo(), known);
    corpus.run(&worker, jobs, &mut |item, outcome| shown.done(item, outcome))?;
    shown.bar.finish_and_clear();
    let report = corpus.finish()?;
    tell(args, &report)
}

/// Refuses what is no folder, and says what is meant for it.
fn check_input(input: &Path) -> anyhow::Result<()> {
    let name = input.display();
    ensure!(
        !input.is_file(),
        "{name}: a file, and corpus does folders: of one clip `handcast run` makes a stream, of one motion `handcast encode`"
    );
    let is_pattern = |part: &&Path| part.to_string_lossy().contains(['*', '?', '[']);
    if !input.exists()
        && let Some(pattern) = input.ancestors().filter(is_pattern).last()
    {
        let folder = pattern.parent().filter(|folder| !folder.as_os_str().is_empty());
        let folder = folder.unwrap_or(Path::new("."));
        let below = input.strip_prefix(folder).unwrap_or(input).display();
        bail!(
            "{name}: no such folder; a pattern goes with --match: handcast corpus {} --match \"{below}\"",
            folder.display()
        );
    }
    Ok(())
}

/// Says which results are done anew, and which options are not for motions.
fn tell_of_work(corpus: &Corpus) {
    let anew = corpus.done_otherwise();
    if anew > 0 {
        let [were, are] = if anew == 1 { ["was", "is"] } else { ["were", "are"] };
        let results = counted(anew, "result");
        errln!(
            "handcast: {results} {were} made with other settings, or by another version, and {are} done anew"
        );
    }
    let is_motion = |item: &&Item| Format::by_name(Path::new(&item.name)).is_some();
    let motions = corpus.todo().iter().filter(is_motion).count();
    if motions == 0 {
        return;
    }
    let motions = counted(motions as u64, "motion file");
    let idle = given::among(&["view", "mirror", "start"]);
    if !idle.is_empty() {
        let apply = if idle.len() > 1 { "apply" } else { "applies" };
        errln!("handcast: {} {apply} to clips alone, not to the {motions} among the inputs", idle.join(", "));
    }
    if !given::among(&["fov"]).is_empty() {
        errln!("handcast: --fov applies to clips, and of the {motions} to joints seen in pictures alone");
    }
}

fn tell(args: &Args, report: &Report) -> anyhow::Result<()> {
    if args.track.json {
        outln!("{}", serde_json::to_string_pretty(report)?);
    } else if !args.track.quiet {
        out!("{report}");
        outln!("  results     {}", args.output.display());
    }
    // One clip's failure is a line; where none works it is more likely the call.
    if report.clips == 0 {
        bail!(
            "none of {} inputs could be done: {}",
            report.failures,
            args.output.join("failures.jsonl").display()
        );
    }
    Ok(())
}

/// How far the work is: a bar on a terminal, elsewhere a line every minute.
struct Shown {
    bar: ProgressBar,
    lines: bool,
    begun: Instant,
    told: Instant,
    bytes: u64,
    all_bytes: u64,
    count: u64,
    all: u64,
    failed: u64,
}

/// Between two lines.
const EVERY: Duration = Duration::from_secs(60);

impl Shown {
    fn new(show: bool, todo: &[Item], known: u64) -> Self {
        // The time a clip takes follows its bytes better than it is the same.
        let all_bytes = todo.iter().map(|item| item.bytes.max(1)).sum();
        let bar = progress(show, Some(all_bytes));
        if let Ok(style) = ProgressStyle::with_template("{msg} {wide_bar} {percent} % {elapsed}, {eta} left")
        {
            bar.set_style(style);
        }
        bar.enable_steady_tick(Duration::from_secs(1));
        let lines = show && !std::io::stderr().is_terminal();
        if lines && known > 0 {
            errln!("handcast: goes on: {known} inputs are known, {} to do", todo.len());
        }
        let (begun, all) = (Instant::now(), todo.len() as u64);
        bar.set_message(format!("0 of {all}"));
        Self { bar, lines, begun, told: begun, bytes: 0, all_bytes, count: 0, all, failed: 0 }
    }

    fn done(&mut self, item: &Item, outcome: &Outcome) {
        self.count += 1;
        self.bytes += item.bytes.max(1);
        if let Outcome::Failed(failure) = outcome {
            self.failed += 1;
            self.bar.println(format!("{}: {}", failure.name, failure.error));
        }
        let failed = if self.failed > 0 { format!(", {} failed", self.failed) } else { String::new() };
        let words = format!("{} of {}{failed}", self.count, self.all);
        if self.lines && self.told.elapsed() >= EVERY {
            self.told = Instant::now();
            let left = self.begun.elapsed().mul_f64((self.all_bytes - self.bytes) as f64 / self.bytes as f64);
            errln!("handcast: {words}; {} left", HumanDuration(left));
        }
        self.bar.set_message(words);
        self.bar.set_position(self.bytes);
    }
}
