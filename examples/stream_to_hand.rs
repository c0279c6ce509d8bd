//! A stream to an animated glTF hand: `cargo run --release --example stream_to_hand -- hand.fba hand.glb`.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut words = std::env::args().skip(1);
    let bytes = std::fs::read(words.next().unwrap_or("hand.fba".into()))?;
    let hand = handcast::decode(&bytes)?;
    println!("{} poses at {} frames/s", hand.clip().frames.len(), hand.rate());
    std::fs::write(words.next().unwrap_or("hand.glb".into()), hand.to_glb()?)?;
    Ok(())
}
