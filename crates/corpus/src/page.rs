//! The report as one HTML page without any other file.

use std::fmt::Write as _;

use crate::line::Entry;
use crate::report::{Histogram, Report, Said};

/// How the page looks.
const STYLE: &str = include_str!("page.css");

/// The page. It holds the report's JSON, too, in the element `facts`.
pub(crate) fn page(report: &Report) -> String {
    let title = format!("Corpus {}", escaped(&report.input));
    let mut out = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n\
         <meta name=\"referrer\" content=\"no-referrer\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{}\">\n\
         <title>{title}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n<h1>{title}</h1>\n",
        handcast_view::policy(&[], &[STYLE])
    );
    out += &tiles(report);
    let confidence = histogram("Confidence", &report.confidences, "confidence of a clip, on average");
    let rate = histogram("Rate", &report.rates, "kbit/s of a stream; the last bar has all above");
    let _ = writeln!(out, "<section class=\"pair\">{confidence}{rate}</section>");
    out += &table(
        "Worst clips",
        "Least confidence, times the share of frames in which the hand was tracked.",
        &report.worst,
    );
    out += &table("Highest rates", "What restless or badly tracked hands cost.", &report.costliest);
    let failed = format!("{} inputs, by what was wrong.", report.failures);
    out += &said("<h2 class=\"bad\">Failures</h2>", &failed, &report.reasons);
    let noticed = format!("What is worth knowing of {} of the streams.", report.noticed);
    out += &said("<h2>Notices</h2>", &noticed, &report.notices);
    out += &passed_over(report);
    let facts = serde_json::to_string(report).unwrap_or_default().replace('<', "\\u003c");
    let _ = write!(
        out,
        "<footer>Made by {} · <code>handcast corpus</code>, settings {}. One line a clip: <code>manifest.jsonl</code>, \
         <code>failures.jsonl</code>. The numbers of this page as JSON are in its source, in the element \
         <code>facts</code>.</footer>\n</main>\n<script type=\"application/json\" id=\"facts\">{facts}</script>\n\
         </body>\n</html>\n",
        escaped(&report.made_by),
        escaped(&report.settings)
    );
    out
}

fn tiles(report: &Report) -> String {
    let run = &report.run;
    let mut tiles = vec![
        (
            format!("{}", report.clips),
            "streams",
            format!("{} of clips that were tracked", report.tracked_clips),
        ),
        (
            format!("{}", report.failures),
            "inputs without a stream",
            format!("{} in the last run, {} before", run.failed, run.failed_before),
        ),
        (length(report.seconds), "of motion", format!("{:.2} kbit/s", report.kbit_per_s)),
        (
            bytes(report.bytes),
            "of streams",
            match report.bytes {
                0 => String::new(),
                bytes => {
                    format!("the inputs are {:.0} times as large", report.input_bytes as f64 / bytes as f64)
                }
            },
        ),
    ];
    if let Some(confidence) = report.confidence {
        tiles.push((format!("{confidence:.2}"), "confidence", "on average over time".into()));
    }
    if run.done + run.failed > 0 {
        let workers =
            if run.jobs > 0 { format!("{} at a time", run.jobs) } else { "by workers elsewhere".into() };
        tiles.push((
            run.clips_per_hour().map_or_else(|| "–".into(), |clips| format!("{clips:.0}")),
            "clips an hour",
            format!("{} clips tracked in {}, {workers}", run.done_clips, length(run.wall_seconds)),
        ));
    }
    let mut out = String::from("<section class=\"tiles\">");
    for (value, name, more) in tiles {
        let _ =
            write!(out, "<div class=\"tile\"><b>{value}</b><span>{name}</span><small>{more}</small></div>");
    }
    out + "</section>\n"
}

/// A length of time.
pub(crate) fn length(seconds: f64) -> String {
    match seconds {
        s if s < 120.0 => format!("{s:.1} s"),
        s if s < 7200.0 => format!("{:.1} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

fn bytes(count: u64) -> String {
    match count as f64 {
        n if n < 1e4 => format!("{n} B"),
        n if n < 1e7 => format!("{:.1} kB", n / 1e3),
        n if n < 1e10 => format!("{:.1} MB", n / 1e6),
        n => format!("{:.1} GB", n / 1e9),
    }
}

fn histogram(title: &str, histogram: &Histogram, caption: &str) -> String {
    const WIDTH: f64 = 400.0;
    const HEIGHT: f64 = 120.0;
    let most = histogram.counts.iter().copied().max().unwrap_or(0).max(1) as f64;
    let wide = WIDTH / histogram.counts.len() as f64;
    let mut bars = String::new();
    for (i, &count) in histogram.counts.iter().enumerate().filter(|(_, count)| **count > 0) {
        let high = (HEIGHT * count as f64 / most).max(1.0);
        let _ = write!(
            bars,
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{high:.1}\"><title>{count}</title></rect>",
            i as f64 * wide + 1.0,
            HEIGHT + 12.0 - high,
            wide - 2.0
        );
    }
    format!(
        "<figure><h2>{title}</h2><svg viewBox=\"0 0 400 150\" role=\"img\" aria-label=\"{title}\">{bars}\
         <path d=\"M0 132.5H400\"/><text x=\"0\" y=\"146\">0</text><text x=\"200\" y=\"146\" text-anchor=\"middle\">{}\
         </text><text x=\"400\" y=\"146\" text-anchor=\"end\">{}</text><text x=\"0\" y=\"10\">{most}</text></svg>\
         <figcaption class=\"note\">{caption}</figcaption></figure>",
        histogram.to / 2.0,
        histogram.to
    )
}

fn table(title: &str, note: &str, entries: &[Entry]) -> String {
    if entries.is_empty() {
        return String::new();
    }
    let mut out = format!(
        "<section><h2>{title}</h2><p class=\"note\">{note}</p><div class=\"scroll\"><table><thead><tr><th>input</th>\
         <th>hand</th><th class=\"n\">confidence</th><th class=\"n\">tracked</th><th class=\"n\">overlap</th>\
         <th class=\"n\">length</th><th class=\"n\">kbit/s</th><th class=\"n\">bytes</th><th class=\"n\">error, RMS</th>\
         </tr></thead><tbody>"
    );
    let told = |value: Option<f64>| value.map_or_else(|| "–".into(), |value| format!("{value:.2}"));
    for entry in entries {
        let _ = write!(
            out,
            "<tr><td>{}</td><td>{}</td><td class=\"n\">{}</td><td class=\"n\">{:.0} %</td><td class=\"n\">{}</td>\
             <td class=\"n\">{}</td><td class=\"n\">{:.2}</td><td class=\"n\">{}</td><td class=\"n\">{:.2}°</td></tr>",
            escaped(&entry.name),
            escaped(&entry.side),
            told(entry.confidence),
            entry.tracked * 100.0,
            told(entry.overlap),
            length(entry.seconds),
            entry.kbit_per_s,
            entry.bytes,
            entry.rms_deg
        );
    }
    out + "</tbody></table></div></section>\n"
}

/// Inputs by what is said of them.
fn said(title: &str, note: &str, kinds: &[Said]) -> String {
    if kinds.is_empty() {
        return String::new();
    }
    let mut out = format!("<section>{title}<p class=\"note\">{note}</p>");
    for kind in kinds {
        let summary = format!("<b>{}</b> {}", kind.count, escaped(&kind.words));
        out += &listed(&summary, kind.count, &kind.names);
    }
    out + "</section>\n"
}

/// A line that opens to names, of which there may be more.
fn listed(summary: &str, count: u64, names: &[String]) -> String {
    let names: Vec<_> = names.iter().map(|name| escaped(name)).collect();
    let more = count.saturating_sub(names.len() as u64);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    let names = names.join("<br>");
    format!("<details><summary>{summary}</summary><p class=\"note\">{names}{more}</p></details>")
}

/// What is no input, and streams that are left as they are.
fn passed_over(report: &Report) -> String {
    let run = &report.run;
    let mut parts = String::new();
    if run.others > 0 {
        let summary = format!("<b>{}</b> neither clip nor motion, or hidden", run.others);
        parts += &listed(&summary, run.others, &run.other_names);
    }
    if run.results > 0 {
        let summary = format!("<b>{}</b> folders with results of this program", run.results);
        parts += &listed(&summary, run.results, &run.result_names);
    }
    if report.otherwise > 0 {
        let _ = write!(
            parts,
            "<p class=\"note\">{} streams were made with other settings, of inputs that are gone or were not asked for: they \
             are left as they are, and not counted.</p>",
            report.otherwise
        );
    }
    if parts.is_empty() { parts } else { format!("<section><h2>Passed over</h2>{parts}</section>\n") }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
