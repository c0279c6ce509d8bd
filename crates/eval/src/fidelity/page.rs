//! The report as one HTML page without any other file: plots as SVG, pictures in it, light and dark.

mod coding;

use std::fmt::Write as _;

use super::clip::TrackingSeam;
use super::compare::HandDifference;
use super::pictures::{Gallery, Group, Picture};
use super::plot::{Plot, Series, Shape, escaped};
use super::report::FidelityReport;
use super::round_trip::{Promise, Seam};
use super::summary::Spread;

/// How the page looks.
const STYLE: &str = include_str!("page.css");

/// The page. It holds the report's JSON, too, in the element `facts`.
pub fn page(report: &FidelityReport, gallery: &Gallery) -> String {
    let title = format!("Fidelity of {}", escaped(&report.source));
    let mut out = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n\
         <meta name=\"referrer\" content=\"no-referrer\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{}\">\n\
         <title>{title}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n",
        handcast_view::policy(&[], &[STYLE])
    );
    out += &head(report, &title);
    out += &seams(report);
    out += &tracking(report, gallery);
    out += &coding::joints(report, gallery);
    out += &coding::bits(report);
    out += &coding::curve(report);
    out += &latency(report);
    out += &symmetry(report);
    out += &decoded(gallery);
    let facts = serde_json::to_string(report).unwrap_or_default().replace('<', "\\u003c");
    let _ = write!(
        out,
        "<footer>Made by {} · <code>handcast fidelity</code>. The numbers of this page as JSON are in its source, \
         in the element <code>facts</code>.</footer>\n</main>\n\
         <script type=\"application/json\" id=\"facts\">{facts}</script>\n</body>\n</html>\n",
        escaped(&report.made_by)
    );
    out
}

fn head(report: &FidelityReport, title: &str) -> String {
    let stream = &report.stream;
    let mut tiles: Vec<(String, String, String)> = Vec::new();
    if let Some(tracking) = &report.tracking {
        let r = &tracking.report;
        tiles.push((
            format!("{:.3}", r.iou_mean),
            "overlap of model and silhouette".into(),
            format!("worst {:.3}", r.iou_min),
        ));
        if let (Some(mean), Some(p95)) = (r.angle_mean_deg, r.angle_p95_deg) {
            tiles.push((
                format!("{mean:.2}°"),
                format!("joint angles against the truth of {} frames", r.truth_frames),
                format!("95 %: {p95:.1}°"),
            ));
        }
    }
    if let Some(import) = &report.import {
        tiles.push((
            format!("{:.1} mm", import.mean_mm),
            "joints from the recorded points".into(),
            format!("worst {:.1} mm", import.max_mm),
        ));
    }
    if let Some(seam) = report.seam("coding") {
        tiles.push((
            format!("{:.2}°", seam.rms_deg()),
            "coding error, RMS".into(),
            format!("worst {:.2}°", seam.max_deg()),
        ));
    }
    if let Some(tips) = report.seams.last().and_then(|s| s.hands.first()?.fingertips_mm.as_ref()) {
        tiles.push((
            format!("{:.2} mm", tips.mean),
            "fingertips wrist on wrist, poses to glTF".into(),
            format!("worst {:.1} mm", tips.max.value),
        ));
    }
    tiles.push((
        format!("{:.2} kbit/s", stream.kbit_per_s),
        format!("{} bytes", stream.bytes),
        format!("for {:.1} s", stream.seconds),
    ));
    let total: f64 = report.latency.iter().map(|l| l.mean_ms).sum();
    let worst: f64 = report.latency.iter().map(|l| l.p95_ms).sum();
    tiles.push((
        format!("{total:.1} ms"),
        "a frame, all stages one after the other".into(),
        format!("95 %: {worst:.1} ms"),
    ));
    let kept = if report.all_kept() {
        "Every seam keeps what it promises.".to_owned()
    } else {
        let broken: Vec<_> = report.seams.iter().filter(|s| !s.kept).map(|s| s.name).collect();
        format!("<strong class=\"bad\">Not kept: {}.</strong>", broken.join(", "))
    };
    let mut out = format!(
        "<header><h1>{title}</h1><p>{} hand, {} frames at {} frames/s, there and back: {}. {kept}</p></header>\n\
         <section class=\"tiles\">",
        report.hands.join(" and "),
        report.frames,
        short(report.rate),
        if report.tracking.is_some() {
            "pixels → poses → BAPs → stream → BAPs → poses → glTF"
        } else {
            "poses → BAPs → stream → BAPs → poses → glTF"
        }
    );
    for (value, name, more) in tiles {
        let _ =
            write!(out, "<div class=\"tile\"><b>{value}</b><span>{name}</span><small>{more}</small></div>");
    }
    out += "</section>\n";
    out
}

fn short(value: f64) -> String {
    let text = format!("{value:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// An error in degrees: small ones in powers of ten.
fn degrees(value: f64) -> String {
    match value {
        // Less than the rounding of the measurement itself.
        v if v < 1e-9 => "0".into(),
        v if v < 0.001 => {
            let power = v.log10().floor();
            format!("{:.1}·10<sup>{power:.0}</sup>°", v / 10f64.powf(power))
        }
        v if v < 0.1 => format!("{v:.4}°"),
        v => format!("{v:.2}°"),
    }
}

fn promise(seam: &Seam) -> String {
    match seam.promise {
        Promise::MaxDeg(limit) => format!("≤ {}", degrees(limit)),
        Promise::RmsDeg(limit) => format!("≤ {} RMS", degrees(limit)),
        Promise::Nothing => "–".into(),
    }
}

fn seams(report: &FidelityReport) -> String {
    let mut out = String::from(
        "<section><h2>Seam by seam</h2><p>What each step changes in the joint angles, and what it promises.</p>\
         <table class=\"seams\"><thead><tr><th>step</th><th class=\"n\">RMS</th><th class=\"n\">worst</th>\
         <th class=\"n\">fingertip</th><th class=\"n\">wrist</th><th class=\"n\">promised</th><th>kept</th></tr></thead>\
         <tbody>",
    );
    for seam in &report.seams {
        let most = |of: fn(&HandDifference) -> Option<&Spread>| {
            seam.hands.iter().filter_map(of).map(|spread| spread.max.value).fold(0.0, f64::max)
        };
        let [wrist, place] = [most(|h| h.wrist_deg.as_ref()), most(|h| h.wrist_mm.as_ref())];
        let kept = if seam.kept { ("good", "✓") } else { ("bad", "✗") };
        // The labels are shown where the table is too wide for the screen.
        let cell = |label: &str, value: String, more: String| {
            let more = if more.is_empty() { more } else { format!("<br><small>{more}</small>") };
            format!("<td class=\"n\" data-label=\"{label}\">{value}{more}</td>")
        };
        let cells = [
            cell("RMS", degrees(seam.rms_deg()), String::new()),
            cell("worst", degrees(seam.max_deg()), String::new()),
            cell("fingertip", format!("{:.2} mm", seam.fingertip_max_mm()), String::new()),
            cell("wrist", degrees(wrist), format!("{place:.1} mm")),
            cell("promised", promise(seam), seam.reason.to_owned()),
        ];
        let _ = write!(
            out,
            "<tr><td><b>{}</b><br><small>{}</small></td>{}<td class=\"{}\">{}</td></tr>",
            seam.name,
            seam.way,
            cells.concat(),
            kept.0,
            kept.1
        );
    }
    out += "</tbody></table><p class=\"note\">RMS over the angles that are ever other than 0; worst, fingertip and wrist are \
            the largest of all frames, fingertips wrist on wrist.</p></section>\n";
    out
}

fn figure(plot: &Plot, caption: &str) -> String {
    format!("<figure>{}<figcaption>{caption}</figcaption></figure>", plot.svg())
}

fn over_time(values: &[f64], rate: f64) -> Vec<[f64; 2]> {
    values.iter().enumerate().map(|(i, &v)| [i as f64 / rate, v]).collect()
}

/// How the tracker did, in a sentence.
fn tracked(seam: &TrackingSeam) -> String {
    let view = seam.view.name();
    let assumed = if seam.view_assumed { " (assumed)" } else { "" };
    let lost = match seam.lost.len() {
        0 => "never lost".to_owned(),
        1 => "lost in one frame".to_owned(),
        n => format!("lost in {n} frames"),
    };
    let start = match seam.fit_iou {
        Some(iou) => format!("fitted on frame {} with an overlap of {iou:.3}", seam.open_frame),
        None => format!("found in frame {} without having been seen open", seam.open_frame),
    };
    let other = if seam.hands > 1 { " (the first of two hands)" } else { "" };
    let evaluations = seam.report.evaluations_mean;
    format!("{} {view}{assumed}{other}, {start}; {lost}; {evaluations:.0} evaluations a frame.", seam.hand)
}

/// Overlap and, where the true angles are known, errors over time.
fn tracking_plots(seam: &TrackingSeam, rate: f64) -> String {
    let line = |name: &str, values: &[f64]| {
        vec![Series { name: name.into(), shape: Shape::Line, points: over_time(values, rate) }]
    };
    let floor = (seam.frame_iou.iter().copied().fold(1.0, f64::min) * 20.0 - 0.5).floor().max(0.0) / 20.0;
    let overlap = Plot {
        title: "Overlap over time".into(),
        x: "seconds".into(),
        y: "overlap".into(),
        x_from: None,
        from: floor,
        to: Some(1.0),
        series: line("overlap", &seam.frame_iou),
    };
    let mut out = figure(
        &overlap,
        &format!(
            "Intersection over union of model and silhouette, {:.3} on average, {:.3} at worst (frame {}).",
            seam.report.iou_mean, seam.report.iou_min, seam.worst_overlap.frame
        ),
    );
    if let (Some(off), Some(worst)) = (&seam.frame_deg, &seam.worst_angles) {
        let angles = Plot {
            title: "Error of the joint angles over time".into(),
            x: "seconds".into(),
            y: "degrees".into(),
            x_from: None,
            from: 0.0,
            to: None,
            series: line("error", off),
        };
        out += &figure(
            &angles,
            &format!(
                "Mean error of the 20 tracked joint angles against the true ones, {:.1}° at worst (frame {}).",
                worst.value, worst.frame
            ),
        );
    }
    out
}

fn tracking(report: &FidelityReport, gallery: &Gallery) -> String {
    let Some(seam) = &report.tracking else { return String::new() };
    let r = &seam.report;
    let mut out = format!(
        "<section><h2>Tracking</h2><p>{}</p><div class=\"pair\">{}</div>",
        tracked(seam),
        tracking_plots(seam, report.rate)
    );
    if let (Some(mean), Some(p95)) = (r.fingertip_mean_mm, r.fingertip_p95_mm) {
        let _ = write!(
            out,
            "<p>Fingertips are {mean:.1} mm from where they are, wrist on wrist (95 %: {p95:.1} mm).</p>\
             <details><summary>Each degree of freedom</summary><div class=\"scroll\"><table><thead><tr><th>angle</th>\
             <th class=\"n\">range</th><th class=\"n\">mean off</th><th class=\"n\">95 %</th><th class=\"n\">worst</th>\
             </tr></thead><tbody>"
        );
        for d in &r.dofs {
            let unit = if d.unit == "deg" { "°" } else { " mm" };
            let class = if d.moving { "" } else { " class=\"still\"" };
            let _ = write!(
                out,
                "<tr{class}><td>{}</td><td class=\"n\">{:.0}{unit}</td><td class=\"n\">{:.2}{unit}</td>\
                 <td class=\"n\">{:.2}{unit}</td><td class=\"n\">{:.2}{unit}</td></tr>",
                d.name, d.range, d.mean, d.p95, d.max
            );
        }
        out += "</tbody></table></div></details>";
    }
    out += &groups("Where it is worst", "groups wide", &gallery.tracking);
    out += "</section>\n";
    out
}

fn groups(title: &str, class: &str, groups: &[Group]) -> String {
    if groups.is_empty() {
        return String::new();
    }
    let mut out = format!("<h3>{title}</h3><div class=\"{class}\">");
    for group in groups {
        let _ =
            write!(out, "<div class=\"group\"><h4>{}</h4><div class=\"pictures\">", escaped(&group.title));
        out.extend(group.pictures.iter().map(picture));
        out += "</div></div>";
    }
    out += "</div>";
    out
}

fn picture(picture: &Picture) -> String {
    let Picture { caption, mime, bytes, size } = picture;
    let caption = escaped(caption);
    format!(
        "<figure><img src=\"data:{mime};base64,{}\" width=\"{}\" height=\"{}\" alt=\"{caption}\">\
         <figcaption>{caption}</figcaption></figure>",
        base64(bytes),
        size.0,
        size.1
    )
}

/// Bars one over the other: the class of each, and its length in percent. The page's policy lets no attribute style them.
fn bars(bars: &[(&str, f64)]) -> String {
    let bar = |(class, percent): &(&str, f64)| {
        format!("<rect class=\"{class}\" width=\"{percent:.1}%\" height=\"14\" rx=\"3\"/>")
    };
    format!("<svg class=\"bars\" aria-hidden=\"true\">{}</svg>", bars.iter().map(bar).collect::<String>())
}

/// A time of some milliseconds, or of microseconds.
fn milliseconds(ms: f64) -> String {
    if ms < 0.1 { format!("{:.1} µs", 1e3 * ms) } else { format!("{ms:.2} ms") }
}

fn latency(report: &FidelityReport) -> String {
    let most = report.latency.iter().map(|l| l.p95_ms).fold(1e-9, f64::max);
    let mut out = String::from(
        "<section><h2>Latency</h2><p>Time each stage works on a frame, on the machine that made this page.</p>\
         <div class=\"scroll\"><table class=\"bars\"><thead><tr><th>stage</th><th class=\"n\">mean</th>\
         <th class=\"n\">median</th><th class=\"n\">95 %</th><th class=\"wide\">mean, 95 %</th></tr></thead><tbody>",
    );
    for l in &report.latency {
        let width = |ms: f64| (100.0 * ms / most).min(100.0);
        let _ = write!(
            out,
            "<tr><td>{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td>\
             <td class=\"wide\">{}</td></tr>",
            l.stage,
            milliseconds(l.mean_ms),
            milliseconds(l.p50_ms),
            milliseconds(l.p95_ms),
            bars(&[("bar", width(l.p95_ms)), ("bar strong", width(l.mean_ms))])
        );
    }
    out += "</tbody></table></div><p class=\"note\">Inner bar: mean, outer: 95 %. Encoding is the live encoder, frame by \
            frame; skipped frames are not decoded.</p></section>\n";
    out
}

fn symmetry(report: &FidelityReport) -> String {
    let mirror = report.tracking.as_ref().and_then(|t| t.mirror.as_ref());
    if mirror.is_none() && report.symmetry.is_none() {
        return String::new();
    }
    let mut out = String::from(
        "<section><h2>Left and right</h2><p>The same in the mirror, with the other hand, must come out as well.</p>\
         <div class=\"scroll\"><table><thead><tr><th>measure</th><th class=\"n\">as it is</th><th class=\"n\">mirrored</th>\
         </tr></thead><tbody>",
    );
    let mut row = |name: &str, values: [String; 2]| {
        let _ = write!(
            out,
            "<tr><td>{name}</td><td class=\"n\">{}</td><td class=\"n\">{}</td></tr>",
            values[0], values[1]
        );
    };
    if let Some(m) = mirror {
        row("tracking: overlap, mean", m.iou_mean.map(|v| format!("{v:.4}")));
        row("tracking: overlap, worst", m.iou_min.map(|v| format!("{v:.4}")));
        row("tracking: frames lost", m.lost.map(|v| v.to_string()));
        if let Some(both) = m.angle_mean_deg {
            row("tracking: joint angles off", both.map(|v| format!("{v:.2}°")));
        }
        row("tracking: found apart, mean", ["–".into(), format!("{:.2}°", m.apart_mean_deg)]);
    }
    if let Some(s) = &report.symmetry {
        row("stream: bytes", s.bytes.map(|v| v.to_string()));
        row("coding: RMS", s.rms_deg.map(degrees));
        row("coding: worst", s.max_deg.map(degrees));
        row("coding: fingertip, worst", s.fingertip_max_mm.map(|v| format!("{v:.2} mm")));
        row("coding: decoded apart, worst", ["–".into(), degrees(s.apart_deg)]);
    }
    out += "</tbody></table></div></section>\n";
    out
}

fn decoded(gallery: &Gallery) -> String {
    if gallery.decoded.is_empty() {
        return String::new();
    }
    let mut out = String::from("<section><h2>The decoded hand</h2><div class=\"film\">");
    out.extend(gallery.decoded.iter().map(picture));
    out += "</div></section>\n";
    out
}

/// RFC 4648, section 4.
fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let at = |i: usize| u32::from(chunk.get(i).copied().unwrap_or(0));
        let word = at(0) << 16 | at(1) << 8 | at(2);
        for k in 0..4 {
            let letter = LETTERS[(word >> (18 - 6 * k) & 63) as usize];
            out.push(if k <= chunk.len() { char::from(letter) } else { '=' });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_that_of_the_rfc() {
        for (text, expected) in
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")]
        {
            assert_eq!(base64(text.as_bytes()), expected);
        }
    }

    #[test]
    fn small_errors_are_written_in_powers_of_ten() {
        assert_eq!(degrees(0.000286), "2.9·10<sup>-4</sup>°");
        assert_eq!([degrees(0.0), degrees(0.0123), degrees(1.5)], ["0", "0.0123°", "1.50°"]);
    }
}
