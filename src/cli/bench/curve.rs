//! Rate over error as a drawing.

use std::fmt::Write as _;

use handcast::fba::plan::RateMode;

use super::baselines::{columns, deltas, rounding_error};
use super::codec::{Motion, RATE, encode};

/// Errors aimed at, degrees RMS.
const AIMS: [f64; 6] = [0.2, 0.3, 0.45, 0.65, 1.0, 1.5];
/// Quantiser indices of plain rounding.
const QUANTS: [u8; 7] = [4, 6, 8, 10, 13, 17, 22];
/// Steps of the integers, degrees.
const STEPS: [f64; 7] = [0.6, 0.9, 1.3, 1.8, 2.5, 3.5, 5.2];
/// Degrees and kbit/s at the ends of the axes.
const AXES: [f64; 2] = [1.6, 6.0];
/// Pixels: whole drawing, and the frame's left, top, right and bottom edges in it.
const SIZE: [f64; 2] = [640.0, 420.0];
const FRAME: [f64; 4] = [60.0, 20.0, 620.0, 370.0];

/// One line of the drawing: errors and rates.
struct Line {
    name: &'static str,
    colour: &'static str,
    points: Vec<[f64; 2]>,
}

/// Mean rate over mean error of several ways to code `motions`, as SVG.
pub fn draw(motions: &[Motion]) -> anyhow::Result<String> {
    let codec = |mode, live| {
        mean(motions, |motion| {
            let report = encode(motion, mode, live)?;
            Ok([report.rms_degrees, report.kbit_per_s()])
        })
    };
    let aims = |live| AIMS.into_iter().map(move |aim| codec(RateMode::TargetRms(aim), live)).collect();
    let quants = QUANTS.into_iter().map(|quant| codec(RateMode::Quant(quant), false)).collect();
    let integers = STEPS.into_iter().map(|step| {
        mean(motions, |motion| {
            let columns = columns(&motion.frames);
            let seconds = motion.frames.len() as f64 / RATE;
            Ok([rounding_error(&columns, step), deltas(&columns, step)? as f64 * 8e-3 / seconds])
        })
    });
    let line = |name, colour, points: anyhow::Result<Vec<[f64; 2]>>| {
        anyhow::Ok(Line { name, colour, points: points? })
    };
    Ok(svg(&[
        line("integer differences, zstd -19", "#888888", integers.collect())?,
        line("FBA, plain rounding", "#c23b22", quants)?,
        line("FBA, live", "#d98e04", aims(true))?,
        line("FBA, planned", "#1f6f8b", aims(false))?,
    ] as &[Line]))
}

fn mean(
    motions: &[Motion],
    measure: impl Fn(&Motion) -> anyhow::Result<[f64; 2]>,
) -> anyhow::Result<[f64; 2]> {
    let mut sum = [0.0; 2];
    for motion in motions {
        let point = measure(motion)?;
        sum[0] += point[0] / motions.len() as f64;
        sum[1] += point[1] / motions.len() as f64;
    }
    Ok(sum)
}

fn svg(lines: &[Line]) -> String {
    let [left, top, right, bottom] = FRAME;
    let x = |degrees: f64| left + (right - left) * degrees / AXES[0];
    let y = |rate: f64| bottom - (bottom - top) * rate / AXES[1];
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\" font-family=\"sans-serif\" font-size=\"13\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n",
        SIZE[0], SIZE[1]
    );
    // Writing to a string cannot fail.
    for step in 0..=8 {
        let degrees = f64::from(step) * 0.2;
        let at = x(degrees);
        let _ = writeln!(
            out,
            "<path d=\"M{at:.1} {top}V{bottom}\" stroke=\"#e4e4e4\"/>\
             <text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{degrees:.1}</text>",
            bottom + 18.0
        );
    }
    for rate in 0..=6 {
        let at = y(f64::from(rate));
        let _ = writeln!(
            out,
            "<path d=\"M{left} {at:.1}H{right}\" stroke=\"#e4e4e4\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{rate}</text>",
            left - 8.0,
            at + 4.0
        );
    }
    let _ = writeln!(
        out,
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">error of the joint angles, degrees RMS</text>\
         <text transform=\"translate(18 {:.1}) rotate(-90)\" text-anchor=\"middle\">kbit/s</text>\n\
         <clipPath id=\"frame\"><rect x=\"{left}\" y=\"{top}\" width=\"{:.1}\" height=\"{:.1}\"/></clipPath>",
        (left + right) / 2.0,
        bottom + 40.0,
        (top + bottom) / 2.0,
        right - left,
        bottom - top
    );
    for (number, line) in lines.iter().enumerate() {
        let colour = line.colour;
        let points: Vec<String> =
            line.points.iter().map(|[degrees, rate]| format!("{:.1},{:.1}", x(*degrees), y(*rate))).collect();
        let _ = writeln!(
            out,
            "<g clip-path=\"url(#frame)\"><polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>",
            points.join(" ")
        );
        for [degrees, rate] in &line.points {
            let _ = writeln!(
                out,
                "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3\" fill=\"{colour}\"/>",
                x(*degrees),
                y(*rate)
            );
        }
        let at = top + 22.0 + 20.0 * number as f64;
        let _ = writeln!(
            out,
            "</g><path d=\"M{:.1} {:.1}h24\" stroke=\"{colour}\" stroke-width=\"2\"/><text x=\"{:.1}\" y=\"{at:.1}\">{}</text>",
            right - 240.0,
            at - 4.0,
            right - 208.0,
            line.name
        );
    }
    out += "</svg>\n";
    out
}
