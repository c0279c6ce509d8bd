//! Lines and short labels.

use image::{ImageBuffer, Pixel, Rgb, RgbImage};

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

/// Writes `text` (digits, `.`, `:`, `s`, `-`, `L`, `R`, space; others stay blank) with its top left corner at
/// (`x`, `y`), each dot of its 3 × 5 font `scale` pixels wide.
pub fn draw_label<P: Pixel<Subpixel = u8>>(
    picture: &mut ImageBuffer<P, Vec<u8>>,
    text: &str,
    x: u32,
    y: u32,
    scale: u32,
    colour: P,
) {
    for (i, c) in text.chars().enumerate() {
        let rows: [u8; 5] = match c {
            '0' => [0b111, 0b101, 0b101, 0b101, 0b111],
            '1' => [0b010, 0b110, 0b010, 0b010, 0b111],
            '2' => [0b111, 0b001, 0b111, 0b100, 0b111],
            '3' => [0b111, 0b001, 0b111, 0b001, 0b111],
            '4' => [0b101, 0b101, 0b111, 0b001, 0b001],
            '5' => [0b111, 0b100, 0b111, 0b001, 0b111],
            '6' => [0b111, 0b100, 0b111, 0b101, 0b111],
            '7' => [0b111, 0b001, 0b010, 0b010, 0b010],
            '8' => [0b111, 0b101, 0b111, 0b101, 0b111],
            '9' => [0b111, 0b101, 0b111, 0b001, 0b111],
            '.' => [0, 0, 0, 0, 0b010],
            ':' => [0, 0b010, 0, 0b010, 0],
            's' => [0, 0b011, 0b010, 0b001, 0b011],
            '-' => [0, 0, 0b111, 0, 0],
            'L' => [0b100, 0b100, 0b100, 0b100, 0b111],
            'R' => [0b110, 0b101, 0b110, 0b101, 0b101],
            _ => [0; 5],
        };
        for (dy, row) in rows.into_iter().enumerate() {
            for dx in 0..3u32 {
                if row >> (2 - dx) & 1 == 1 {
                    for sy in 0..scale {
                        for sx in 0..scale {
                            let px = x + (i as u32 * 4 + dx) * scale + sx;
                            let py = y + dy as u32 * scale + sy;
                            if let Some(p) = picture.get_pixel_mut_checked(px, py) {
                                *p = colour;
                            }
                        }
                    }
                }
            }
        }
    }
}
