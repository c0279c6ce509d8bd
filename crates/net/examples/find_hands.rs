//! Hands in a film of raw RGB pictures on standard input: `find_hands NET WIDTH HEIGHT FPS HANDS`.
//!
//! Each line of output is one hand: number of the picture, presence, probability of a right hand, then x and y of each
//! joint in pixels, centres of pixels at whole numbers.

use std::error::Error;
use std::io::{BufWriter, Read, Write};
use std::path::Path;

use handcast_net::files::{Bundle, Size};
use handcast_net::hands::{NetFinder, NetFinderOptions};
use handcast_vision::sighting::HandFinder;
use image::RgbImage;

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().collect();
    let [_, path, width, height, fps, hands] = &args[..] else {
        return Err("find_hands NET WIDTH HEIGHT FPS HANDS".into());
    };
    let bundle = Bundle::open(Path::new(path), Size::Full)?;
    let options = NetFinderOptions::default().with_hands(hands.parse()?);
    let mut finder = NetFinder::new(&bundle, options)?;
    let (width, height, fps): (u32, u32, f64) = (width.parse()?, height.parse()?, fps.parse()?);
    let mut input = std::io::stdin().lock();
    let mut output = BufWriter::new(std::io::stdout().lock());
    let mut spent = std::time::Duration::ZERO;
    let mut number = 0;
    let mut found = Vec::new();
    loop {
        let mut data = vec![0; 3 * (width * height) as usize];
        if input.read_exact(&mut data).is_err() {
            break;
        }
        let picture = RgbImage::from_raw(width, height, data).ok_or("a picture of another size")?;
        let start = std::time::Instant::now();
        finder.find(&picture, f64::from(number) / fps, &mut found)?;
        spent += start.elapsed();
        for hand in &found {
            write!(output, "{number} {} {}", hand.presence, hand.right)?;
            for [x, y] in hand.points {
                write!(output, " {} {}", x - 0.5, y - 0.5)?;
            }
            writeln!(output)?;
        }
        number += 1;
    }
    eprintln!("{number} pictures, {:.2} ms each", spent.as_secs_f64() * 1e3 / f64::from(number.max(1)));
    Ok(())
}
