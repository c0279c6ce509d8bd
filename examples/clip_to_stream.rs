//! A video of a hand to a stream: `cargo run --release --example clip_to_stream -- clip.mp4 hand.fba`.

use handcast::Target;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut words = std::env::args().skip(1);
    let clip = words.next().unwrap_or("fixtures/demo.avi".into());
    let poses = handcast::track(&clip)?;
    let stream = handcast::encode(&poses, Target::default())?;
    println!("{clip}: {} poses in {} bytes", poses.frames.len(), stream.len());
    std::fs::write(words.next().unwrap_or("hand.fba".into()), stream)?;
    Ok(())
}
