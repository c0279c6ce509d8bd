//! Sections of the page about the stream: joints, bits, rate over error.

use std::fmt::Write as _;

use super::{bars, degrees, figure, groups, over_time};
use crate::fidelity::pictures::Gallery;
use crate::fidelity::plot::{Plot, Series, Shape, escaped};
use crate::fidelity::report::FidelityReport;
use crate::fidelity::stream::{Bits, RatePoint};
use crate::fidelity::summary::percentile;

/// Degrees below which a joint counts as not moved at all.
const STILL: f64 = 1e-9;

pub(super) fn joints(report: &FidelityReport, gallery: &Gallery) -> String {
    let Some(seam) = report.seam("coding") else { return String::new() };
    let mut out = String::from("<section><h2>Coding, joint by joint</h2>");
    for hand in &seam.hands {
        if seam.hands.len() > 1 {
            let _ = write!(out, "<h3>{} hand</h3>", hand.side.name());
        }
        let mut joints: Vec<_> = hand.joints.iter().filter(|j| j.max.value > STILL).collect();
        joints.sort_by(|a, b| b.max.value.total_cmp(&a.max.value));
        let most = joints.first().map_or(1.0, |j| j.max.value);
        out += "<div class=\"scroll\"><table class=\"bars\"><thead><tr><th>joint</th><th class=\"n\">RMS</th>\
                <th class=\"n\">worst</th><th class=\"wide\">RMS, worst</th><th class=\"n\">at</th></tr></thead><tbody>";
        for joint in &joints {
            let width = |v: f64| 100.0 * v / most;
            let _ = write!(
                out,
                "<tr><td>{}</td><td class=\"n\">{:.2}°</td><td class=\"n\">{:.2}°</td><td class=\"wide\">{}</td>\
                 <td class=\"n\">{:.2} s</td></tr>",
                joint.joint,
                joint.rms_deg,
                joint.max.value,
                bars(&[("bar", width(joint.max.value)), ("bar strong", width(joint.rms_deg))]),
                joint.max.time
            );
        }
        let still = hand.joints.len() - joints.len();
        let Some(tips) = &hand.fingertips_mm else { continue };
        let _ = write!(
            out,
            "</tbody></table></div><p class=\"note\">Inner bar: RMS, outer: worst. {still} other joint angles come back \
             exactly. Fingertips, wrist on wrist, are off by {:.2} mm on average, {:.2} mm in 95 % of cases, {:.2} mm at worst \
             (frame {}).</p>",
            tips.mean, tips.p95, tips.max.value, tips.max.frame
        );
    }
    out += &groups("Where it is worst", "groups", &gallery.coding);
    out += "</section>\n";
    out
}

fn share_table(title: &str, bits: &[Bits]) -> String {
    let most = bits.iter().map(|b| b.share).fold(1e-9, f64::max);
    let mut out = format!("<div><h3>{title}</h3><table class=\"bars\"><tbody>");
    for b in bits {
        let _ = write!(
            out,
            "<tr><td>{}</td><td class=\"n\">{}</td><td class=\"wide\">{}</td>\
             <td class=\"n\">{:.1} %</td></tr>",
            escaped(&b.name),
            b.bits,
            bars(&[("bar strong", 100.0 * b.share / most)]),
            100.0 * b.share
        );
    }
    out += "</tbody></table></div>";
    out
}

pub(super) fn bits(report: &FidelityReport) -> String {
    let s = &report.stream;
    let values: Vec<f64> = s.frame_bits.iter().map(|&b| b as f64).collect();
    let most = s.frame_bits.iter().copied().max().unwrap_or(0);
    // I planes are many times as large as the others, which would be flat beside them.
    let usual = percentile(&values, 0.95).max(1.0);
    let cut = most as f64 > 4.0 * usual;
    let caption = if cut {
        format!("Bits of each frame; the tall ones are I planes, of {most} bits at most, and cut off.")
    } else {
        "Bits of each frame.".to_owned()
    };
    let plot = Plot {
        title: "Bits of each frame".into(),
        x: "seconds".into(),
        y: "bits".into(),
        x_from: None,
        from: 0.0,
        to: cut.then(|| (3.0 * usual / 50.0).ceil() * 50.0),
        series: vec![Series {
            name: "bits".into(),
            shape: Shape::Bars,
            points: over_time(&values, report.rate),
        }],
    };
    let quants: Vec<String> = s.quantiser_indices.iter().map(u8::to_string).collect();
    format!(
        "<section><h2>Where the bits go</h2><div class=\"pair\">{}<div><p>{} bytes for {:.2} s: {:.2} kbit/s. {} of \
         {} frames are sent, {} of them as I planes, at which a viewer can start. Quantiser indices: {}.</p></div>\
         {}{}</div></section>\n",
        figure(&plot, &caption),
        s.bytes,
        s.seconds,
        s.kbit_per_s,
        s.planes,
        s.frames,
        s.intra_planes,
        quants.join(", "),
        share_table("By part of the hand", &s.by_group),
        share_table("By use", &s.by_use)
    )
}

pub(super) fn curve(report: &FidelityReport) -> String {
    let Some(curve) = &report.curve else { return String::new() };
    let points = |list: &[RatePoint]| {
        let mut points: Vec<[f64; 2]> = list.iter().map(|p| [p.rms_deg, p.kbit_per_s]).collect();
        points.retain(|p| p[0] <= 2.2);
        points.sort_by(|a, b| a[0].total_cmp(&b[0]));
        points
    };
    let series = |name: &str, list| Series { name: name.into(), shape: Shape::Dots, points: points(list) };
    let plot = Plot {
        title: "Rate over error".into(),
        x: "error of the moving joint angles, degrees RMS".into(),
        y: "kbit/s".into(),
        x_from: Some(0.0),
        from: 0.0,
        to: None,
        series: vec![
            series("planned", &curve.planned),
            series("live", &curve.live),
            series("plain rounding", &curve.quantisers),
        ],
    };
    let mut out = format!(
        "<section><h2>Rate over error</h2><div class=\"pair\">{}<div class=\"scroll\"><table><thead><tr>\
         <th>quantiser index</th><th class=\"n\">kbit/s</th><th class=\"n\">RMS</th><th class=\"n\">worst</th></tr>\
         </thead><tbody>",
        figure(
            &plot,
            "Planned: every I period weighed as a whole. Live: frame by frame. Plain rounding: the quantiser indices \
             of the table, up to 2.2° RMS."
        )
    );
    for point in &curve.quantisers {
        let _ = write!(
            out,
            "<tr><td>{}</td><td class=\"n\">{:.2}</td><td class=\"n\">{}</td><td class=\"n\">{}</td></tr>",
            point.quant.unwrap_or_default(),
            point.kbit_per_s,
            degrees(point.rms_deg),
            degrees(point.max_deg)
        );
    }
    out += "</tbody></table></div></div></section>\n";
    out
}
