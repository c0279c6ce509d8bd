//! The comparison as a picture: errors and evaluations by method, and the descents of fig. 17.

use std::fmt::Write as _;

use super::report::{Descended, PAPER, Report};

const COLOURS: [&str; 6] = ["#1b6ca8", "#c8553d", "#588157", "#8e6c8a", "#b8860b", "#4a4e69"];
const WIDTH: f64 = 960.0;
const LEFT: f64 = 200.0;
const ROW: f64 = 24.0;

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

fn text(out: &mut String, x: f64, y: f64, anchor: &str, words: &str) {
    let _ = writeln!(out, r#"<text x="{x:.1}" y="{y:.1}" text-anchor="{anchor}">{}</text>"#, escaped(words));
}

/// Draws the report.
pub fn draw(report: &Report) -> String {
    let descents: Vec<&Descended> = report
        .descents
        .iter()
        .filter(|d| d.objective == report.descents[0].objective && d.parameters == 12)
        .collect();
    let bars = 70.0 + ROW * report.methods.len() as f64;
    let height = bars + if descents.is_empty() { 20.0 } else { 380.0 };
    let mut out = String::new();
    let _ = writeln!(
        out,
        r#"<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height}" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif" font-size="12">"#
    );
    let _ = writeln!(out, r#"<rect width="100%" height="100%" fill="white"/>"#);
    draw_bars(&mut out, report);
    if !descents.is_empty() {
        draw_descents(&mut out, &descents, bars + 30.0);
    }
    out.push_str("</svg>\n");
    out
}

/// A pair of bars for each method: error (or what overlap is missing), and evaluations on a logarithmic scale.
fn draw_bars(out: &mut String, report: &Report) {
    let known = report.methods.iter().any(|m| m.summary.moving_deg.is_some());
    let title = if known { "mean error of what moves, degrees" } else { "1 − mean IoU" };
    text(out, LEFT, 24.0, "start", title);
    text(out, 620.0, 24.0, "start", "evaluations a frame (logarithmic)");
    let value =
        |m: &super::Method| if known { m.summary.moving_deg.unwrap_or(0.0) } else { 1.0 - m.summary.iou };
    let most = report.methods.iter().map(value).fold(1e-9, f64::max);
    for (i, m) in report.methods.iter().enumerate() {
        let y = 40.0 + ROW * i as f64;
        let colour = match m.optimiser {
            Some(name) => COLOURS[place(report, name) % COLOURS.len()],
            None => "#222222",
        };
        text(out, LEFT - 8.0, y + 13.0, "end", &m.name);
        let mut bar = |x: f64, length: f64, label: &str| {
            let _ = writeln!(
                out,
                r#"<rect x="{x:.1}" y="{y:.1}" width="{length:.1}" height="{:.1}" fill="{colour}"/>"#,
                ROW - 7.0
            );
            text(out, x + length + 5.0, y + 13.0, "start", label);
        };
        let v = value(m);
        bar(LEFT, 340.0 * v / most, &if known { format!("{v:.2}") } else { format!("{v:.3}") });
        let e = m.summary.evaluations.max(1.0);
        bar(620.0, 60.0 * e.log10(), &format!("{e:.0}"));
    }
}

fn place(report: &Report, optimiser: &str) -> usize {
    let mut seen: Vec<&str> = Vec::new();
    for name in report.methods.iter().filter_map(|m| m.optimiser) {
        if !seen.contains(&name) {
            seen.push(name);
        }
    }
    seen.iter().position(|n| *n == optimiser).unwrap_or(0)
}

/// Value against evaluations, with the counts of the paper's fig. 17 as dotted lines.
fn draw_descents(out: &mut String, descents: &[&Descended], top: f64) {
    let (left, width, height) = (60.0, 700.0, 290.0);
    let bottom = top + 20.0 + height;
    let longest = descents.iter().map(|d| d.trace.len()).max().unwrap_or(1).max(320) as f64;
    let highest = descents.iter().flat_map(|d| d.trace.iter().copied()).fold(1e-9, f64::max);
    let at = |evaluation: f64, value: f64| {
        (left + width * evaluation / longest, bottom - height * value / highest)
    };
    let first = descents[0];
    let title = format!(
        "one registration (fig. 17): {} against evaluations; {}, frame {} from {}, 12 parameters",
        first.objective, first.sequence, first.frame, first.from
    );
    text(out, left, top + 6.0, "start", &title);
    let _ = writeln!(
        out,
        r#"<path d="M{left} {:.1}V{bottom:.1}H{:.1}" fill="none" stroke="black"/>"#,
        top + 20.0,
        left + width
    );
    for tick in (0..=(longest as usize)).step_by(100) {
        text(out, at(tick as f64, 0.0).0, bottom + 16.0, "middle", &tick.to_string());
    }
    for share in [0.0, 0.5, 1.0] {
        let v = share * highest;
        text(out, left - 6.0, at(0.0, v).1 + 4.0, "end", &format!("{v:.3}"));
    }
    for (name, evaluations, _) in PAPER {
        let x = at(evaluations as f64, 0.0).0;
        let _ = writeln!(
            out,
            r#"<path d="M{x:.1} {:.1}V{bottom:.1}" stroke="grey" stroke-dasharray="3 3"/>"#,
            top + 34.0
        );
        text(out, x, top + 30.0, "middle", &format!("{name} in the paper: {evaluations}"));
    }
    for (i, d) in descents.iter().enumerate() {
        let colour = COLOURS[i % COLOURS.len()];
        let mut path = String::new();
        for (k, v) in d.trace.iter().enumerate() {
            let (x, y) = at((k + 1) as f64, *v);
            let _ = write!(path, "{}{x:.1} {y:.1}", if k == 0 { "M" } else { "L" });
        }
        let _ = writeln!(out, r#"<path d="{path}" fill="none" stroke="{colour}" stroke-width="1.5"/>"#);
        let y = top + 44.0 + 18.0 * i as f64;
        let _ = writeln!(
            out,
            r#"<rect x="{:.1}" y="{:.1}" width="14" height="4" fill="{colour}"/>"#,
            left + width + 16.0,
            y - 6.0
        );
        text(out, left + width + 36.0, y, "start", &format!("{}: {}", d.optimiser, d.evaluations));
    }
}
