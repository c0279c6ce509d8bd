//! Rate over error as a drawing.

use handcast_eval::fidelity::{Plot, Series, Shape};
use handcast_fba::plan::Target;

use super::baselines::{columns, deltas, rounding_error};
use super::codec::{CodedMotion, RATE, encode};

/// Errors aimed at, degrees RMS.
const AIMS: [f64; 6] = [0.2, 0.3, 0.45, 0.65, 1.0, 1.5];
/// Quantiser indices of plain rounding.
const QUANTS: [u8; 7] = [4, 6, 8, 10, 13, 17, 22];
/// Steps of the integers, degrees.
const STEPS: [f64; 7] = [0.6, 0.9, 1.3, 1.8, 2.5, 3.5, 5.2];
/// Rate at the end of its axis, kbit/s; what is above is left out.
const HIGHEST: f64 = 6.0;

/// Mean rate over mean error of several ways to code `motions`, as SVG.
pub fn draw(motions: &[CodedMotion]) -> anyhow::Result<String> {
    let codec = |mode, live| {
        mean(motions, |motion| {
            let report = encode(motion, mode, live)?;
            Ok([report.rms_degrees, report.kbit_per_s()])
        })
    };
    let aims = |live| AIMS.into_iter().map(move |aim| codec(Target::Rms(aim), live)).collect();
    let quants = QUANTS.into_iter().map(|quant| codec(Target::Quant(quant), false)).collect();
    let integers = STEPS.into_iter().map(|step| {
        mean(motions, |motion| {
            let columns = columns(&motion.frames);
            let seconds = motion.frames.len() as f64 / RATE;
            Ok([rounding_error(&columns, step), deltas(&columns, step)? as f64 * 8e-3 / seconds])
        })
    });
    let series = |name: &str, points: anyhow::Result<Vec<[f64; 2]>>| {
        let mut points = points?;
        points.retain(|[_, rate]| *rate <= HIGHEST);
        anyhow::Ok(Series { name: name.to_owned(), shape: Shape::Dots, points })
    };
    let plot = Plot {
        title: "rate over error".to_owned(),
        x: "error of the joint angles, degrees RMS".to_owned(),
        y: "kbit/s".to_owned(),
        x_from: Some(0.0),
        from: 0.0,
        to: Some(HIGHEST),
        series: vec![
            series("FBA, planned", aims(false))?,
            series("FBA, live", aims(true))?,
            series("FBA, plain rounding", quants)?,
            series("integer differences, zstd -19", integers.collect())?,
        ],
    };
    Ok(plot.svg_file())
}

fn mean(
    motions: &[CodedMotion],
    measure: impl Fn(&CodedMotion) -> anyhow::Result<[f64; 2]>,
) -> anyhow::Result<[f64; 2]> {
    let mut sum = [0.0; 2];
    for motion in motions {
        let point = measure(motion)?;
        sum[0] += point[0] / motions.len() as f64;
        sum[1] += point[1] / motions.len() as f64;
    }
    Ok(sum)
}
