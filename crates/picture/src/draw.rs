//! Lines and short labels.

use image::{ImageBuffer, Pixel, Rgb, RgbImage};

/// A picture of 8 bits a channel.
type Picture<P> = ImageBuffer<P, Vec<u8>>;

/// Draws a straight line one pixel wide; points are `[x, y]` in pixels.
pub fn draw_line(image: &mut RgbImage, from: [f64; 2], to: [f64; 2], colour: Rgb<u8>) {
    let steps = ((to[0] - from[0]).abs().max((to[1] - from[1]).abs()).ceil() as u32).clamp(1, 1 << 16);
    for k in 0..=steps {
        let t = f64::from(k) / f64::from(steps);
        let (x, y) = (from[0] + (to[0] - from[0]) * t, from[1] + (to[1] - from[1]) * t);
        if x >= 0.0
            && y >= 0.0
            && let Some(pixel) = image.get_pixel_mut_checked(x as u32, y as u32)
        {
            *pixel = colour;
        }
    }
}

/// Draws a line through points (`[x, y]` in pixels, whose centres lie at .5), `width` pixels wide, with round ends and smooth
/// edges.
pub fn draw_stroke<P: Pixel<Subpixel = u8>>(
    picture: &mut Picture<P>,
    points: &[[f64; 2]],
    width: f64,
    colour: P,
) {
    let reach = width.max(0.0) / 2.0 + 0.5;
    // Where segments meet a pixel is covered once, by the one that covers most of it.
    let finite = || points.iter().filter(|p| p.iter().all(|v| v.is_finite()));
    let range = |k: usize, limit: u32| {
        let (low, high) = finite().fold((f64::MAX, f64::MIN), |(a, b), p| (a.min(p[k]), b.max(p[k])));
        let end = |v: f64| v.clamp(0.0, f64::from(limit)) as u32;
        (end((low - reach).floor()), end((high + reach).ceil()))
    };
    let ((left, right), (top, bottom)) = (range(0, picture.width()), range(1, picture.height()));
    let wide = right.saturating_sub(left) as usize;
    let mut covers = vec![0.0; wide * bottom.saturating_sub(top) as usize];
    let place = |x: u32, y: u32| (y - top) as usize * wide + (x - left) as usize;
    for pair in points.windows(2) {
        let [from, to] = [pair[0], pair[1]];
        if from.iter().chain(&to).any(|v| !v.is_finite()) {
            continue;
        }
        let span = |k: usize, limit: u32| {
            let (low, high) = (from[k].min(to[k]) - reach, from[k].max(to[k]) + reach);
            (low.floor().clamp(0.0, f64::from(limit)) as u32)
                ..(high.ceil().clamp(0.0, f64::from(limit)) as u32)
        };
        let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
        let length = dx * dx + dy * dy;
        for y in span(1, picture.height()) {
            for x in span(0, picture.width()) {
                let (px, py) = (f64::from(x) + 0.5 - from[0], f64::from(y) + 0.5 - from[1]);
                let along = if length > 0.0 { ((px * dx + py * dy) / length).clamp(0.0, 1.0) } else { 0.0 };
                let off = (px - along * dx).hypot(py - along * dy);
                let cover = (reach - off).clamp(0.0, 1.0);
                let most = &mut covers[place(x, y)];
                *most = cover.max(*most);
            }
        }
    }
    for y in top..bottom {
        for x in left..right {
            let cover = covers[place(x, y)];
            if cover > 0.0 {
                blend(picture.get_pixel_mut(x, y), &colour, cover);
            }
        }
    }
}

fn blend<P: Pixel<Subpixel = u8>>(pixel: &mut P, colour: &P, cover: f64) {
    for (below, above) in pixel.channels_mut().iter_mut().zip(colour.channels()) {
        let mixed = f64::from(*below) + cover * (f64::from(*above) - f64::from(*below));
        *below = mixed.round() as u8;
    }
}

/// The strokes of a character in a cell 3 wide and 5 high; of one that is not known none.
#[rustfmt::skip]
fn strokes(character: char) -> &'static [&'static [[f64; 2]]] {
    match character {
        '0' => &[&[
            [1.5, 0.0], [2.5, 0.4], [3.0, 1.5], [3.0, 3.5], [2.5, 4.6], [1.5, 5.0], [0.5, 4.6], [0.0, 3.5],
            [0.0, 1.5], [0.5, 0.4], [1.5, 0.0],
        ]],
        '1' => &[&[[0.5, 1.0], [1.7, 0.0], [1.7, 5.0]]],
        '2' => &[&[[0.1, 1.3], [0.4, 0.4], [1.5, 0.0], [2.6, 0.4], [2.9, 1.4], [2.4, 2.5], [0.0, 5.0], [3.0, 5.0]]],
        '3' => &[
            &[[0.1, 1.0], [0.5, 0.3], [1.5, 0.0], [2.5, 0.3], [2.8, 1.2], [2.4, 2.1], [1.3, 2.4]],
            &[[1.3, 2.4], [2.6, 2.8], [3.0, 3.7], [2.5, 4.7], [1.5, 5.0], [0.4, 4.7], [0.0, 3.9]],
        ],
        '4' => &[&[[2.3, 5.0], [2.3, 0.0], [0.0, 3.5], [3.0, 3.5]]],
        '5' => &[&[
            [2.8, 0.0], [0.5, 0.0], [0.3, 2.2], [1.5, 1.8], [2.6, 2.2], [3.0, 3.4], [2.5, 4.6], [1.4, 5.0],
            [0.4, 4.7], [0.0, 4.0],
        ]],
        '6' => &[&[
            [2.6, 0.4], [1.7, 0.0], [0.6, 0.6], [0.0, 2.2], [0.0, 3.6], [0.5, 4.6], [1.5, 5.0], [2.5, 4.6],
            [3.0, 3.5], [2.5, 2.5], [1.5, 2.1], [0.5, 2.5], [0.0, 3.4],
        ]],
        '7' => &[&[[0.0, 0.0], [3.0, 0.0], [1.1, 5.0]]],
        '8' => &[
            &[
                [1.5, 2.3], [0.5, 1.9], [0.3, 1.0], [0.6, 0.3], [1.5, 0.0], [2.4, 0.3], [2.7, 1.0], [2.5, 1.9],
                [1.5, 2.3],
            ],
            &[
                [1.5, 2.3], [0.4, 2.8], [0.0, 3.7], [0.5, 4.7], [1.5, 5.0], [2.5, 4.7], [3.0, 3.7], [2.6, 2.8],
                [1.5, 2.3],
            ],
        ],
        '9' => &[&[
            [0.4, 4.6], [1.3, 5.0], [2.4, 4.4], [3.0, 2.8], [3.0, 1.4], [2.5, 0.4], [1.5, 0.0], [0.5, 0.4],
            [0.0, 1.5], [0.5, 2.5], [1.5, 2.9], [2.5, 2.5], [3.0, 1.6],
        ]],
        '.' => &[&[[1.5, 4.9], [1.5, 5.0]]],
        ':' => &[&[[1.5, 1.5], [1.5, 1.6]], &[[1.5, 4.0], [1.5, 4.1]]],
        's' => &[&[
            [2.5, 2.3], [1.5, 1.9], [0.6, 2.2], [0.6, 3.0], [1.5, 3.4], [2.4, 3.8], [2.5, 4.5], [1.5, 5.0],
            [0.4, 4.6],
        ]],
        'b' => &[
            &[[0.4, 0.0], [0.4, 5.0]],
            &[[0.4, 2.5], [1.4, 1.9], [2.3, 2.3], [2.7, 3.4], [2.3, 4.6], [1.4, 5.0], [0.4, 4.4]],
        ],
        'c' => &[&[[2.6, 2.5], [1.6, 1.9], [0.7, 2.3], [0.3, 3.4], [0.7, 4.6], [1.6, 5.0], [2.6, 4.5]]],
        'd' => &[
            &[[2.6, 0.0], [2.6, 5.0]],
            &[[2.6, 2.5], [1.6, 1.9], [0.7, 2.3], [0.3, 3.4], [0.7, 4.6], [1.6, 5.0], [2.6, 4.4]],
        ],
        'f' => &[&[[2.6, 0.3], [1.9, 0.0], [1.2, 0.6], [1.2, 5.0]], &[[0.3, 2.1], [2.4, 2.1]]],
        'g' => &[
            &[[2.6, 1.9], [2.6, 4.3], [1.8, 5.0], [0.5, 4.8]],
            &[[2.6, 2.3], [1.6, 1.9], [0.7, 2.1], [0.4, 2.8], [0.7, 3.6], [1.6, 3.8], [2.6, 3.4]],
        ],
        'h' => &[&[[0.4, 0.0], [0.4, 5.0]], &[[0.4, 2.6], [1.5, 1.9], [2.3, 2.2], [2.6, 3.0], [2.6, 5.0]]],
        'i' => &[&[[1.5, 0.5], [1.5, 0.6]], &[[1.5, 2.0], [1.5, 5.0]]],
        'l' => &[&[[1.2, 0.0], [1.2, 4.3], [1.6, 5.0], [2.4, 4.9]]],
        'n' => &[&[[0.4, 1.9], [0.4, 5.0]], &[[0.4, 2.6], [1.5, 1.9], [2.3, 2.2], [2.6, 3.0], [2.6, 5.0]]],
        'o' => &[&[
            [1.5, 1.9], [2.4, 2.3], [2.7, 3.4], [2.4, 4.6], [1.5, 5.0], [0.6, 4.6], [0.3, 3.4], [0.6, 2.3],
            [1.5, 1.9],
        ]],
        't' => &[&[[1.2, 0.6], [1.2, 4.3], [1.6, 5.0], [2.5, 4.8]], &[[0.3, 1.9], [2.4, 1.9]]],
        'u' => &[&[[0.4, 1.9], [0.4, 4.2], [0.9, 4.9], [1.6, 5.0], [2.6, 4.3]], &[[2.6, 1.9], [2.6, 5.0]]],
        '-' => &[&[[0.4, 2.6], [2.6, 2.6]]],
        'L' => &[&[[0.2, 0.0], [0.2, 5.0], [2.8, 5.0]]],
        'R' => &[
            &[[0.1, 5.0], [0.1, 0.0], [1.7, 0.0], [2.6, 0.4], [2.8, 1.3], [2.5, 2.2], [1.6, 2.6], [0.1, 2.6]],
            &[[1.4, 2.6], [2.9, 5.0]],
        ],
        _ => &[],
    }
}

/// Writes `text` (digits, `.`, `:`, `-`, `L`, `R`, the letters of `bcdfghilnostu`, space; others stay blank) with its
/// top left corner at (`x`, `y`), each character 3 × 5 units of `scale` pixels and a unit apart, in lines of some
/// pixels with smooth edges.
pub fn draw_label<P: Pixel<Subpixel = u8>>(
    picture: &mut Picture<P>,
    text: &str,
    x: u32,
    y: u32,
    scale: u32,
    colour: P,
) {
    write(picture, text, [x, y], scale, 0.7 * f64::from(scale), colour);
}

/// As [`draw_label`], on a rim of another colour, which makes it readable before any picture.
pub fn draw_label_on<P: Pixel<Subpixel = u8>>(
    picture: &mut Picture<P>,
    text: &str,
    [x, y]: [u32; 2],
    scale: u32,
    colours: [P; 2],
) {
    let width = 0.7 * f64::from(scale);
    write(picture, text, [x, y], scale, width + 3.0, colours[1]);
    write(picture, text, [x, y], scale, width, colours[0]);
}

fn write<P: Pixel<Subpixel = u8>>(
    picture: &mut Picture<P>,
    text: &str,
    [x, y]: [u32; 2],
    scale: u32,
    width: f64,
    colour: P,
) {
    let scale = f64::from(scale);
    // What the lines' width adds stays inside of the cell.
    let inset = 0.35 * scale;
    let [wide, high] = [3.0, 5.0].map(|units| (units * scale - 2.0 * inset) / units);
    for (i, character) in text.chars().enumerate() {
        let left = f64::from(x) + inset + 4.0 * scale * i as f64;
        let top = f64::from(y) + inset;
        for stroke in strokes(character) {
            let points: Vec<_> = stroke.iter().map(|[u, v]| [left + u * wide, top + v * high]).collect();
            draw_stroke(picture, &points, width, colour);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strokes_are_as_wide_as_asked_and_smooth() {
        let mut picture = RgbImage::new(60, 40);
        draw_stroke(&mut picture, &[[10.0, 20.25], [50.0, 20.25]], 2.5, Rgb([255; 3]));
        // Over a column the light adds up to the width.
        let sum: u32 = (0..40).map(|y| u32::from(picture.get_pixel(30, y)[0])).sum();
        assert!((f64::from(sum) / 255.0 - 2.5).abs() < 0.02, "{sum}");
        assert!((0..40).any(|y| (1..255).contains(&picture.get_pixel(30, y)[0])));
        assert_eq!(picture.get_pixel(5, 20)[0], 0);
        // Beyond the picture, and what is no number.
        draw_stroke(&mut picture, &[[-1e9, 5.0], [1e9, 5.0], [f64::NAN, 1.0]], 3.0, Rgb([255; 3]));
        assert_eq!(picture.get_pixel(0, 5)[0], 255);
    }

    #[test]
    fn lines_in_pieces_are_as_wide_as_whole_ones() {
        let points: Vec<[f64; 2]> = (0..=80).map(|i| [10.0 + 0.5 * f64::from(i), 20.25]).collect();
        let [whole, pieces] = [vec![points[0], points[80]], points].map(|points| {
            let mut picture = RgbImage::new(60, 40);
            draw_stroke(&mut picture, &points, 2.0, Rgb([255; 3]));
            picture
        });
        assert_eq!(whole, pieces);
    }

    #[test]
    fn characters_are_told_apart_and_stay_in_their_cells() {
        let known: Vec<char> = "0123456789.:-LRbcdfghilnostu".chars().collect();
        let drawn = |c: char, scale: u32| {
            let mut picture = RgbImage::new(6 * scale, 7 * scale);
            draw_label(&mut picture, &c.to_string(), scale, scale, scale, Rgb([255; 3]));
            picture
        };
        for (i, &c) in known.iter().enumerate() {
            let picture = drawn(c, 3);
            for (x, y, pixel) in picture.enumerate_pixels() {
                let inside = (2..13).contains(&x) && (2..19).contains(&y);
                assert!(inside || pixel[0] == 0, "{c:?} at {x}, {y}");
            }
            assert!(known[..i].iter().all(|&other| drawn(other, 3) != picture), "{c:?}");
        }
        assert_eq!(drawn(' ', 3), drawn('x', 3));
    }
}
