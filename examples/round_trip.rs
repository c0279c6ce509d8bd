//! What coding costs at several aims: `cargo run --release --example round_trip -- poses.jsonl`.

use handcast::formats::motion::Motion;
use handcast::{JointAngle, Side, Target};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let file = std::env::args().nth(1).unwrap_or("fixtures/demo.poses.jsonl".into());
    let poses = Motion::read(file.as_ref())?.clip;
    for target in [Target::Rms(0.2), Target::Rms(0.5), Target::MaxError(3.0), Target::Bitrate(1.0)] {
        let stream = handcast::encode(&poses, target)?;
        let back = handcast::decode(&stream)?;
        let pairs: Vec<_> = poses.of(Side::Right).zip(back.clip().of(Side::Right)).collect();
        let off = |a| pairs.iter().map(move |(x, y)| (x.pose.angle(a) - y.pose.angle(a)).abs());
        let worst = JointAngle::ALL.into_iter().flat_map(off).fold(0.0, f64::max).to_degrees();
        println!("{target:?}: {} bytes, {worst:.2}° at most", stream.len());
    }
    Ok(())
}
