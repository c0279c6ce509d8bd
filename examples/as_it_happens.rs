//! Frames in, poses, bytes, poses out, while it goes on: `cargo run --release --example as_it_happens -- clip.mp4`.

use handcast::{JointAngle, LivePoseEncoder, LivePoseEncoderOptions, PoseDecoder, Tracker, open};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut camera =
        open(std::env::args().nth(1).unwrap_or("fixtures/demo.avi".into()), &Default::default())?;
    let rate = camera.info().rate.unwrap_or(30.0);
    let mut tracker = Tracker::new(Default::default());
    let mut encoder = LivePoseEncoder::new(LivePoseEncoderOptions::default().with_rate(rate));
    let mut decoder = PoseDecoder::new(Default::default());
    while let Some(frame) = camera.next_frame()? {
        let time = frame.time;
        let poses = tracker.push(frame)?;
        for plane in encoder.push(time, &poses, &tracker.header(None))? {
            // Over the wire, and there:
            for pose in decoder.push(&plane.bytes)? {
                let bend = pose.pose.angle(JointAngle::Index1Flexion).to_degrees();
                println!("{:.2} s: index finger bent by {bend:.0}°", pose.time);
            }
        }
    }
    // What ends the stream.
    if let Some(plane) = encoder.finish()? {
        decoder.push(&plane.bytes)?;
    }
    Ok(())
}
