//! `handcast compare`: how far two motions are apart.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use handcast_eval::fidelity::{
    BapComparison, CompareOptions, Comparison, DEFAULT_TOLERANCE, Extent, HandDifference, Spread, compare,
    compare_baps,
};
use handcast_formats::motion::Motion;

use super::common::{DecodingArgs, check_seen, limits, read_input};
use super::given;
use super::usage::within;

/// Compares two motions of hands: streams, BAP text, animated hands, poses, joint positions
///
/// Exit code 0 when no joint is further off than its tolerance and both have the same hands and frames, at the same rate;
/// 1 when not, or when a file cannot be read. A frame in which one has the hand lost is missing there, but for what a
/// stream, or another format that cannot say so, holds in its place. Each motion counts from its own first frame; where one of
/// them has no lost frames, from where a hand is first seen in both; with --same-clock both count from the same instant.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// First motion: .fba, .bap, .glb, .gltf, .bvh, .jsonl, .json, .csv, .webxr.json, .landmarks.jsonl, .pose
    a: PathBuf,
    /// Second motion, of any kind; one of the two may be - for standard input
    b: PathBuf,
    /// Largest difference of a joint angle, degrees; by default what the encoder's defaults keep to
    #[arg(long, value_name = "DEG", default_value_t = DEFAULT_TOLERANCE, value_parser = degrees)]
    tolerance: f64,
    /// Largest difference of the wrist's rotation, degrees [default: four times --tolerance]
    #[arg(long, value_name = "DEG", value_parser = degrees)]
    wrist_tolerance: Option<f64>,
    /// Largest difference of the wrist's position, millimetres [default: 40 for each degree of --tolerance]
    #[arg(long, value_name = "MM", value_parser = millimetres)]
    position_tolerance: Option<f64>,
    /// Frames or hands that only one of them has do not matter, nor do rates that differ
    #[arg(long)]
    partial: bool,
    /// Times of both count from the same instant, as those of a clip and of a part of it do (`track --from`)
    #[arg(long)]
    same_clock: bool,
    /// Print everything as JSON
    #[arg(long)]
    json: bool,
    /// Print nothing; the exit code tells
    #[arg(short, long, conflicts_with = "json")]
    quiet: bool,
    #[command(flatten)]
    decoding: DecodingArgs,
}

fn degrees(text: &str) -> Result<f64, String> {
    within(text, 0.0..=360.0, "degrees")
}

fn millimetres(text: &str) -> Result<f64, String> {
    within(text, 0.0..=1e6, "mm")
}

/// What is printed as JSON.
#[derive(serde::Serialize)]
struct Account<'a> {
    a: File,
    b: File,
    same: bool,
    /// Without hands on both sides BAPs alone are compared.
    #[serde(flatten)]
    poses: Option<&'a Comparison>,
    #[serde(skip_serializing_if = "Option::is_none")]
    baps: Option<&'a BapComparison>,
}

#[derive(serde::Serialize)]
struct File {
    file: String,
    kind: &'static str,
}

/// Runs the subcommand; the exit code tells whether they are the same.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    if args.a.as_os_str() == "-" && args.b.as_os_str() == "-" {
        refuse!("standard input can be one of the two, not both");
    }
    let read = |path: &Path| {
        let bytes = read_input(path, None)?;
        let motion = Motion::parse_decoded(path, &bytes, args.decoding.options(), limits())?;
        for note in motion.notes.iter().filter(|_| motion.format.id == "fba") {
            errln!("handcast: {}: {note}", path.display());
        }
        anyhow::Ok(motion)
    };
    let [a, b] = [read(&args.a)?, read(&args.b)?];
    if a.format.id != "fba" && b.format.id != "fba" {
        given::note_idle("neither is a stream", &["steps", "ranges", "conceal"]);
    }
    let mut options = CompareOptions::of(&a, &b).with_tolerance(args.tolerance);
    options.wrist_tolerance_deg = args.wrist_tolerance.unwrap_or(options.wrist_tolerance_deg);
    options.wrist_tolerance_mm = args.position_tolerance.unwrap_or(options.wrist_tolerance_mm);
    options.same_clock = args.same_clock;
    let has_hands = |motion: &Motion| !motion.clip.frames.is_empty();
    let poses = (has_hands(&a) && has_hands(&b)).then(|| compare(&a.clip, &b.clip, &options));
    let baps = a.baps.as_ref().zip(b.baps.as_ref()).map(|(a, b)| compare_baps(a, b));
    let name = |path: &PathBuf| path.display().to_string();
    if poses.is_none() && baps.is_none() {
        let (path, motion) = if has_hands(&a) { (&args.b, &b) } else { (&args.a, &a) };
        check_seen(path.display(), &motion.clip)?;
    }
    let same = match (&poses, &baps) {
        (Some(found), _) => found.within_tolerance() && (args.partial || found.is_complete()),
        (None, Some(found)) => {
            found.frames > 0
                && found.max_deg <= args.tolerance
                && (args.partial || found.only_a.is_empty() && found.only_b.is_empty())
        }
        (None, None) => false,
    };
    if args.json {
        let file = |path: &PathBuf, motion: &Motion| File { file: name(path), kind: motion.format.kind };
        let account = Account {
            a: file(&args.a, &a),
            b: file(&args.b, &b),
            same,
            poses: poses.as_ref(),
            baps: baps.as_ref(),
        };
        outln!("{}", serde_json::to_string_pretty(&account)?);
    } else if !args.quiet {
        if let Some(found) = &poses {
            print_poses([(&name(&args.a), &a), (&name(&args.b), &b)], found);
        }
        if let Some(found) = &baps {
            print_baps(found);
        }
        outln!("{}", verdict(same, &poses, args));
    }
    Ok(if same { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

fn verdict(same: bool, poses: &Option<Comparison>, args: &Args) -> String {
    let tolerance = args.tolerance;
    match poses {
        _ if same => format!("the same within {tolerance}°"),
        Some(found) if found.hands.is_empty() => "different: no hand in common".to_owned(),
        Some(found) if found.hands.iter().all(|h| h.frames == 0) => {
            "different: no instant in common".to_owned()
        }
        Some(found) if found.within_tolerance() => {
            let why = if found.rates_differ { "rates differ" } else { "frames or hands are missing" };
            format!("different: within {tolerance}°, but {why} (see --partial)")
        }
        _ => "different: beyond tolerance".to_owned(),
    }
}

fn print_poses(files: [(&str, &Motion); 2], found: &Comparison) {
    for (letter, ((name, motion), extent)) in
        ["A", "B"].into_iter().zip(files.into_iter().zip(&found.motions))
    {
        outln!("{letter}  {name}: {}, {}", motion.format.name, in_words(extent));
    }
    let [a, b] = &found.motions;
    if let (Some(one), Some(other)) = (a.rate, b.rate)
        && found.interpolated
    {
        match found.uneven {
            [true, _] => outln!("note: times of A are uneven: it is interpolated at those of B"),
            [_, true] => outln!("note: times of B are uneven: it is interpolated at those of A"),
            _ => outln!(
                "note: rates differ, {one:.3} and {other:.3} frames/s: B is interpolated at the times of A"
            ),
        }
    } else if found.interpolated {
        outln!("note: a glTF file keeps keys only: it is interpolated between them, as players do");
    }
    let carrier = ["A", "B"].into_iter().zip(["B", "A"]).zip(found.carrier).find(|(_, carries)| *carries);
    if let Some(((stream, poses), _)) = carrier {
        outln!(
            "note: {stream} has the rate of the stream that {poses} is sent as, several ticks to a frame: compared are the frames of {poses}"
        );
    }
    if a.frames != b.frames && !found.interpolated && carrier.is_none() {
        outln!("note: frame counts differ, {} and {}", a.frames, b.frames);
    }
    if (a.start - b.start).abs() > 1e-3 {
        outln!(
            "note: A starts at {:.3} s, B at {:.3} s: both are counted from there (--same-clock: from the same instant)",
            a.start,
            b.start
        );
    }
    // Those of two hands are counted together.
    let counted = if found.hands.len() > 1 { "poses" } else { "frames" };
    for (letter, other, k) in [("A", "B", 0), ("B", "A", 1)] {
        let lost = found.lost_in_other[k];
        let missing = found.unmatched_frames[k] - lost;
        if missing > 0 {
            outln!("note: {missing} {counted} of {letter} have none in {other}");
        }
        if lost > 0 {
            outln!("note: in {lost} {counted} of {letter} the hand is lost in {other}");
        }
        for side in &found.unmatched_hands[k] {
            outln!("note: only {letter} has a {} hand", side.name());
        }
    }
    if !found.left_out.is_empty() {
        outln!("note: not compared, since one of the two does not tell them: {}", found.left_out.join(", "));
    }
    for hand in &found.hands {
        print_hand(hand);
    }
    if let Some(at) = &found.first_divergence {
        let side = at.side.name();
        let unit = if at.unit == "deg" { "°" } else { " mm" };
        let values = at.angles_deg.map_or(String::new(), |[a, b]| format!(" ({a:.2}° in A, {b:.2}° in B)"));
        outln!(
            "first divergence: frame {} ({:.3} s), {side} hand, {}: {:.2}{unit} off{values}",
            at.frame,
            at.time,
            at.joint,
            at.off
        );
    }
}

fn in_words(extent: &Extent) -> String {
    let rate = extent.rate.map_or(String::new(), |rate| format!(" at {:.3} frames/s", rate));
    let lost = if extent.lost > 0 { format!(", {} lost", extent.lost) } else { String::new() };
    let what = if extent.rate.is_some() { "frames" } else { "keys" };
    format!("{} {what}{rate}, {:.2} s{lost}", extent.frames, extent.seconds)
}

/// Degrees below which a joint counts as alike in the table.
const ALIKE: f64 = 0.0005;
/// Millimetres below which two hands are as long: streams round four bones by up to half a millimetre each.
const LIKE_LONG: f64 = 2.0;

fn print_hand(hand: &HandDifference) {
    outln!("{} hand, {} frames compared", hand.side.name(), hand.frames);
    if hand.frames == 0 {
        return;
    }
    outln!("  {:<20} {:>9} {:>9}   {:>6} {:>9}", "joint", "rms °", "max °", "frame", "time s");
    let (mut alike, mut shown) = (0, 0);
    for joint in &hand.joints {
        if joint.max.value < ALIKE {
            alike += 1;
            continue;
        }
        shown += 1;
        outln!(
            "  {:<20} {:>9.3} {:>9.3}   {:>6} {:>9.3}",
            joint.joint,
            joint.rms_deg,
            joint.max.value,
            joint.max.frame,
            joint.max.time
        );
    }
    if alike > 0 {
        outln!("  {} of {} joints within {ALIKE}°", alike, alike + shown);
    }
    if let Some(rms) = hand.moving_rms_deg {
        outln!("  {:<20} {rms:>9.3}", "not always 0");
    }
    let line = |name: &str, unit: &str, spread: &Spread| {
        outln!(
            "  {name:<20} mean {:.3} {unit}, 95 % {:.3}, max {:.3} at frame {} ({:.3} s)",
            spread.mean,
            spread.p95,
            spread.max.value,
            spread.max.frame,
            spread.max.time
        );
    };
    if let Some([a, b]) = hand.lengths_mm.filter(|[a, b]| (a - b).abs() >= LIKE_LONG) {
        outln!("  {:<20} {a:.1} mm in A, {b:.1} mm in B", "hand's length");
    }
    let spreads = [
        ("tips, wrist on wrist", "mm", &hand.fingertips_mm),
        ("wrist rotation", "°", &hand.wrist_deg),
        ("wrist position", "mm", &hand.wrist_mm),
    ];
    for (name, unit, spread) in spreads {
        match spread {
            Some(spread) => line(name, unit, spread),
            None => outln!("  {name:<20} not told by both"),
        }
    }
}

/// BAPs listed one by one, at most.
const LISTED: usize = 12;

fn print_baps(found: &BapComparison) {
    for (letter, only) in [("A", &found.only_a), ("B", &found.only_b)] {
        if !only.is_empty() {
            let numbers: Vec<String> = only.iter().map(u16::to_string).collect();
            outln!("note: BAPs that only {letter} sends: {}", numbers.join(" "));
        }
    }
    let Some(at) = &found.first_divergence else {
        outln!("BAPs: the same in all {} frames", found.frames);
        return;
    };
    let value = |v: Option<i32>| v.map_or("masked off".to_owned(), |v| v.to_string());
    outln!(
        "BAPs: they part at frame {} ({:.3} s), BAP {}{}: {} in A, {} in B",
        at.frame,
        at.time,
        at.bap,
        at.name.map_or(String::new(), |n| format!(" ({n})")),
        value(at.a),
        value(at.b)
    );
    let mut baps: Vec<_> = found.baps.iter().collect();
    baps.sort_by_key(|bap| std::cmp::Reverse(bap.max));
    for bap in baps.iter().take(LISTED) {
        outln!(
            "  {:>3} {:<22} differs in {:>5} of {} frames, by {} at most (frame {})",
            bap.bap,
            bap.name.unwrap_or("extension"),
            bap.frames,
            found.frames,
            bap.max,
            bap.at
        );
    }
    if baps.len() > LISTED {
        outln!("  and {} more", baps.len() - LISTED);
    }
}
