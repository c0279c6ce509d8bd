//! Lines and areas over two axes as SVG. Colours and fonts come from the page, or from a style of the drawing's own:
//! classes `s1` to `s4` for the series, `grid` and `axis` for the rest.

use std::fmt::Write as _;

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// A line.
    Line,
    /// A line with a dot at each point.
    Dots,
    /// A bar from zero to each point, as wide as points are apart.
    Bars,
}

/// Points that belong together, in order of x.
#[derive(Clone, Debug)]
pub struct Series {
    /// Name in the legend; no legend if there is one series only.
    pub name: String,
    /// How it is drawn.
    pub shape: Shape,
    /// x and y; what is not finite is left out.
    pub points: Vec<[f64; 2]>,
}

/// A drawing.
#[derive(Clone, Debug)]
pub struct Plot {
    /// What it shows, for those who cannot see it.
    pub title: String,
    /// What runs along.
    pub x: String,
    /// What runs up.
    pub y: String,
    /// Where the x axis begins; by default at the first point.
    pub x_from: Option<f64>,
    /// Where the y axis begins.
    pub from: f64,
    /// Where it ends; by default a round number above the largest value.
    pub to: Option<f64>,
    /// The series, four at most.
    pub series: Vec<Series>,
}

/// Units of the drawing: the whole, and the frame's left, top, right and bottom edges. Small, so that letters can be
/// read when a phone shows it 360 pixels wide.
const SIZE: [f64; 2] = [460.0, 270.0];
const FRAME: [f64; 4] = [42.0, 26.0, 450.0, 228.0];
/// Points drawn of a series at most: more cannot be told apart.
const MOST: usize = 400;

/// Attributes and beginning of a drawing that is a file of its own.
const FILE: [&str; 2] = [
    " xmlns=\"http://www.w3.org/2000/svg\" font-family=\"sans-serif\" font-size=\"12\"",
    "<style>.grid{stroke:#e4e4e4;fill:none}.axis{stroke:#777;fill:none}.line{fill:none;stroke-width:1.8}\
     .line.s1{stroke:#1f6f8b}.dot.s1,.area.s1{fill:#1f6f8b}.line.s2{stroke:#d07a00}.dot.s2,.area.s2{fill:#d07a00}\
     .line.s3{stroke:#b8402a}.dot.s3,.area.s3{fill:#b8402a}.line.s4{stroke:#6a5acd}.dot.s4,.area.s4{fill:#6a5acd}\
     </style><rect width=\"100%\" height=\"100%\" fill=\"white\"/>",
];

impl Plot {
    /// The drawing as an `<svg>` element of a page.
    pub fn svg(&self) -> String {
        self.drawing(["", ""])
    }

    /// The drawing as an SVG file.
    pub fn svg_file(&self) -> String {
        self.drawing(FILE) + "\n"
    }

    fn drawing(&self, [attributes, beginning]: [&str; 2]) -> String {
        let [left, top, right, bottom] = FRAME;
        let all = || self.series.iter().flat_map(|s| &s.points).filter(|p| p.iter().all(|v| v.is_finite()));
        let first = all().map(|p| p[0]).fold(f64::INFINITY, f64::min).min(f64::MAX);
        let x_from = self.x_from.unwrap_or(first);
        let x_to = all().map(|p| p[0]).fold(f64::NEG_INFINITY, f64::max);
        let (x_from, x_to) = if x_to > x_from { (x_from, x_to) } else { (0.0, 1.0) };
        let largest = all().map(|p| p[1]).fold(self.from, f64::max);
        let y_ticks = ticks(self.from, self.to.unwrap_or(largest), 5);
        let step = y_ticks.get(1).map_or(1.0, |t| t - y_ticks[0]);
        let y_to = self.to.unwrap_or_else(|| (largest / step).ceil() * step).max(self.from + 1e-9);
        let x_at = |v: f64| left + (right - left) * (v - x_from) / (x_to - x_from);
        let y_at = |v: f64| bottom - (bottom - top) * ((v - self.from) / (y_to - self.from)).clamp(0.0, 1.02);
        // Writing to a string cannot fail.
        let mut out = format!(
            "<svg{attributes} viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{}\">{beginning}",
            SIZE[0],
            SIZE[1],
            escaped(&self.title)
        );
        for tick in ticks(self.from, y_to, 5) {
            let y = y_at(tick);
            let _ = write!(out, "<path class=\"grid\" d=\"M{left} {y:.1}H{right}\"/>");
            let _ = write!(
                out,
                "<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                left - 6.0,
                y + 4.0,
                number(tick)
            );
        }
        for tick in ticks(x_from, x_to, 6) {
            let _ = write!(
                out,
                "<path class=\"axis\" d=\"M{0:.1} {bottom}v4\"/><text x=\"{0:.1}\" y=\"{1}\" text-anchor=\"middle\">{2}</text>",
                x_at(tick),
                bottom + 17.0,
                number(tick)
            );
        }
        let _ = write!(out, "<path class=\"axis\" d=\"M{left} {bottom}H{right}\"/>");
        for (k, series) in self.series.iter().enumerate() {
            let class = k % 4 + 1;
            let points: Vec<[f64; 2]> =
                thinned(&series.points).into_iter().map(|[x, y]| [x_at(x), y_at(y)]).collect();
            out += &drawn(series.shape, &points, class);
        }
        let _ = write!(
            out,
            "<text x=\"{:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text><text x=\"4\" y=\"12\">{}</text>",
            (left + right) / 2.0,
            bottom + 36.0,
            escaped(&self.x),
            escaped(&self.y)
        );
        if self.series.len() > 1 {
            for (k, series) in self.series.iter().enumerate() {
                let y = top + 12.0 + 17.0 * k as f64;
                let _ = write!(
                    out,
                    "<path class=\"line s{}\" d=\"M{} {}h18\"/><text x=\"{}\" y=\"{y}\" text-anchor=\"end\">{}</text>",
                    k % 4 + 1,
                    right - 20.0,
                    y - 4.0,
                    right - 26.0,
                    escaped(&series.name)
                );
            }
        }
        out += "</svg>";
        out
    }
}

fn drawn(shape: Shape, points: &[[f64; 2]], class: usize) -> String {
    let mut out = String::new();
    if shape == Shape::Bars {
        let bottom = FRAME[3];
        let width =
            points.windows(2).map(|w| w[1][0] - w[0][0]).fold(f64::INFINITY, f64::min).clamp(0.6, 12.0);
        let mut path = String::new();
        for [x, y] in points.iter().filter(|p| bottom - p[1] > 0.05) {
            let _ = write!(path, "M{:.1} {bottom}V{y:.1}h{width:.1}V{bottom}", x - width / 2.0);
        }
        let _ = write!(out, "<path class=\"area s{class}\" d=\"{path}\"/>");
        return out;
    }
    let words: Vec<String> = points.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
    let _ = write!(out, "<polyline class=\"line s{class}\" points=\"{}\"/>", words.join(" "));
    if shape == Shape::Dots {
        for [x, y] in points {
            let _ = write!(out, "<circle class=\"dot s{class}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.2\"/>");
        }
    }
    out
}

/// At most [`MOST`] points: of each run that is drawn as one, the lowest and the highest.
fn thinned(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let sound: Vec<[f64; 2]> = points.iter().copied().filter(|p| p.iter().all(|v| v.is_finite())).collect();
    if sound.len() <= MOST {
        return sound;
    }
    let run = sound.len().div_ceil(MOST / 2);
    let mut out = Vec::with_capacity(MOST);
    for chunk in sound.chunks(run) {
        let by_height = |a: &&[f64; 2], b: &&[f64; 2]| a[1].total_cmp(&b[1]);
        let ends = [chunk.iter().min_by(by_height), chunk.iter().max_by(by_height)];
        let mut pair: Vec<[f64; 2]> = ends.into_iter().flatten().copied().collect();
        pair.sort_by(|a, b| a[0].total_cmp(&b[0]));
        out.extend(pair);
    }
    out
}

/// Round numbers from `from` to `to`, about `count` of them, steps of 1, 2 or 5 times a power of ten.
fn ticks(from: f64, to: f64, count: usize) -> Vec<f64> {
    let span = (to - from).max(1e-9);
    let rough = span / count as f64;
    let power = 10f64.powf(rough.log10().floor());
    let step =
        [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|s| *s >= rough * 0.999).unwrap_or(rough);
    let first = (from / step - 1e-6).ceil() as i64;
    let last = (to / step + 1e-6).floor() as i64;
    (first..=last.min(first.saturating_add(50))).map(|i| i as f64 * step).collect()
}

/// As few digits as tell it.
fn number(value: f64) -> String {
    let text = format!("{value:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// Text in HTML or in an attribute.
pub(super) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(ticks(0.0, 1.0, 5), [0.0, 0.2, 0.4, 0.6000000000000001, 0.8, 1.0]);
        assert_eq!(ticks(0.0, 6.0, 6), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        assert_eq!(ticks(0.93, 1.0, 3).len(), 2);
        assert_eq!(ticks(3.0, 3.0, 5).len(), 1);
        assert_eq!([number(0.6000000000000001), number(1500.0), number(-0.0)], ["0.6", "1500", "0"]);
    }

    #[test]
    fn many_points_keep_their_extremes() {
        let mut points: Vec<[f64; 2]> = (0..10_000).map(|i| [f64::from(i), 1.0]).collect();
        points[4321][1] = 9.0;
        points[7000][1] = f64::NAN;
        let few = thinned(&points);
        assert!(few.len() <= MOST && few.contains(&[4321.0, 9.0]));
        assert!(few.windows(2).all(|w| w[0][0] <= w[1][0]));
    }

    #[test]
    fn empty_and_odd_series_are_drawn_without_complaint() {
        for points in [vec![], vec![[1.0, 1.0]], vec![[0.0, f64::INFINITY], [1.0, 0.0]]] {
            let series = |shape| Series { name: "a<b".into(), shape, points: points.clone() };
            let plot = Plot {
                title: "\"t\"".into(),
                x: "x".into(),
                y: "y".into(),
                x_from: None,
                from: 0.0,
                to: None,
                series: [Shape::Line, Shape::Dots, Shape::Bars].map(series).to_vec(),
            };
            assert!(plot.svg_file().starts_with("<svg xmlns="));
            let svg = plot.svg();
            assert!(svg.ends_with("</svg>") && !svg.contains("NaN") && !svg.contains("inf"), "{svg}");
            assert!(svg.contains("a&lt;b") && svg.contains("&quot;t&quot;"));
        }
    }
}
