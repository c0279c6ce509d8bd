//! Y4M of pictures.

use image::RgbImage;

/// Y4M at 30 frames/s: 4:2:0 of limited range in BT.709, each chroma sample of the first pixel of its four.
pub fn y4m(pictures: &[RgbImage]) -> Vec<u8> {
    let (w, h) = pictures[0].dimensions();
    let mut out = format!("YUV4MPEG2 W{w} H{h} F30:1 Ip A1:1 C420mpeg2\n").into_bytes();
    for picture in pictures {
        out.extend_from_slice(b"FRAME\n");
        let mut planes: [Vec<u8>; 3] = Default::default();
        for (x, y, p) in picture.enumerate_pixels() {
            let [r, g, b] = p.0.map(|v| f64::from(v) / 255.0);
            let luma = 0.2126 * r + 0.7152 * g + 0.0722 * b;
            planes[0].push((16.0 + 219.0 * luma).round() as u8);
            if x % 2 == 0 && y % 2 == 0 {
                planes[1].push((128.0 + 224.0 * (b - luma) / 1.8556).round() as u8);
                planes[2].push((128.0 + 224.0 * (r - luma) / 1.5748).round() as u8);
            }
        }
        planes.iter().for_each(|plane| out.extend_from_slice(plane));
    }
    out
}
