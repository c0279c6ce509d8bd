//! `handcast bench choices`: what each choice that the bitstream leaves to an encoder is worth.

use anyhow::Context;
use handcast_codec::mapping::Profile;
use handcast_codec::{bap_frames, for_hands};
use handcast_fba::PlaneBits;
use handcast_fba::plan::{Choices, Levels, PlanOptions, PlanReport, Target, TimedBapFrame, encode_clip};

use super::sizes::MotionArgs;

/// Measures what each choice that the bitstream leaves to an encoder is worth: the same motion with each of them switched off alone
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    motion: MotionArgs,
    /// Print the table as JSON
    #[arg(long)]
    json: bool,
}

/// A row of the table.
#[derive(Default, serde::Serialize)]
struct Row {
    choice: &'static str,
    bytes: usize,
    seconds: f64,
    kbit_per_s: f64,
    /// Its size over that of all choices.
    ratio: f64,
    rms_deg: f64,
    max_deg: f64,
    planes_per_s: f64,
    intra_planes_per_s: f64,
    /// Bits per second: headers, masks and flush; range arrays; I values; P values.
    around: f64,
    ranges: f64,
    intra_values: f64,
    predicted_values: f64,
}

/// Prints the table.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let samples = args.motion.samples()?;
    let motions: Vec<Vec<TimedBapFrame>> = samples
        .iter()
        .map(|sample| bap_frames(&sample.clip, Profile::Hand).with_context(|| sample.name.clone()))
        .collect::<anyhow::Result<_>>()?;
    let mut rows: Vec<Row> = Vec::new();
    for (choice, options) in cases(args.motion.target_rms) {
        let reports = motions.iter().map(|frames| Ok(encode_clip(frames, &for_hands(options))?.1));
        rows.push(row(choice, &reports.collect::<anyhow::Result<Vec<_>>>()?));
    }
    let all = rows.first().map_or(1, |row| row.bytes.max(1)) as f64;
    for row in &mut rows {
        row.ratio = row.bytes as f64 / all;
    }
    if args.json {
        outln!("{}", serde_json::to_string_pretty(&rows)?);
        return Ok(());
    }
    let seconds = rows.first().map_or(0.0, |row| row.seconds);
    let (count, fps) = (motions.len(), args.motion.fps);
    let plural = if count == 1 { "" } else { "s" };
    outln!("{count} motion{plural}, {seconds:.1} s at {fps} frames/s, without a record of sizes\n");
    outln!(
        "| choice | bytes | kbit/s | ratio | error, ° RMS | max ° | planes/s | I planes/s | ranges, bit/s | I values | P values | around |"
    );
    outln!("|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|");
    rows.iter().for_each(print);
    Ok(())
}

fn print(row: &Row) {
    outln!(
        "| {} | {} | {:.3} | {:.3} | {:.3} | {:.2} | {:.1} | {:.2} | {:.0} | {:.0} | {:.0} | {:.0} |",
        row.choice,
        row.bytes,
        row.kbit_per_s,
        row.ratio,
        row.rms_deg,
        row.max_deg,
        row.planes_per_s,
        row.intra_planes_per_s,
        row.ranges,
        row.intra_values,
        row.predicted_values,
        row.around
    );
}

/// The rows and how each is made: first with all choices, then without one of them, then with none, then live.
fn cases(rms: f64) -> Vec<(&'static str, PlanOptions)> {
    let all = PlanOptions { mode: Target::Rms(rms), ..PlanOptions::default() };
    let chosen = Choices::default();
    let with = |choices: Choices| PlanOptions { choices, ..all };
    let none = Choices {
        levels: Levels::Rounded,
        narrow_ranges: false,
        masks: false,
        quantisers: false,
        lasting_ranges: false,
        skips: false,
    };
    vec![
        ("all, an I plane every 5 s", all),
        ("levels: frame by frame, with a dead zone", with(Choices { levels: Levels::DeadZone, ..chosen })),
        ("levels: the nearest", with(Choices { levels: Levels::Rounded, ..chosen })),
        ("P ranges hold every change", with(Choices { narrow_ranges: false, ..chosen })),
        ("masks: all BAPs on", with(Choices { masks: false, ..chosen })),
        ("one quantiser for all I periods", with(Choices { quantisers: false, ..chosen })),
        ("all range arrays with each I plane", with(Choices { lasting_ranges: false, ..chosen })),
        ("a plane for each frame", with(Choices { skips: false, ..chosen })),
        ("models reset (I plane) every 1 s", PlanOptions { intra_seconds: 1.0, ..all }),
        ("models reset every 2.5 s", PlanOptions { intra_seconds: 2.5, ..all }),
        ("models reset every 4.5 s", PlanOptions { intra_seconds: 4.5, ..all }),
        ("models reset every 10 s", PlanOptions { intra_seconds: 10.0, ..all }),
        ("models never reset", PlanOptions { intra_seconds: 1e6, ..all }),
        ("none of them", with(none)),
        ("live", PlanOptions { live: true, ..all }),
        ("live, models reset for ranges alone", PlanOptions { live: true, intra_seconds: 1e6, ..all }),
    ]
}

fn row(choice: &'static str, reports: &[PlanReport]) -> Row {
    let sum = |of: fn(&PlanReport) -> f64| reports.iter().map(of).sum::<f64>();
    let seconds = sum(|report| report.seconds).max(1e-9);
    let frames = sum(|report| report.frames as f64).max(1.0);
    let bytes = reports.iter().map(|report| report.bytes).sum();
    let bits = |of: fn(&PlaneBits) -> u64| {
        reports.iter().map(|report| of(&report.bits) as f64).sum::<f64>() / seconds
    };
    Row {
        choice,
        bytes,
        seconds,
        kbit_per_s: bytes as f64 * 8e-3 / seconds,
        rms_deg: (sum(|report| report.rms_degrees.powi(2) * report.frames as f64) / frames).sqrt(),
        max_deg: reports.iter().map(|report| report.max_degrees).fold(0.0, f64::max),
        planes_per_s: sum(|report| report.planes as f64) / seconds,
        intra_planes_per_s: sum(|report| report.intra_planes as f64) / seconds,
        around: bits(|bits| bits.start_codes + bits.headers + bits.masks + bits.flush),
        ranges: bits(|bits| bits.ranges),
        intra_values: bits(|bits| bits.intra_values),
        predicted_values: bits(|bits| bits.predicted_values),
        ..Row::default()
    }
}
