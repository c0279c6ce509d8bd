//! Frames in, poses, bytes, poses out, while it goes on: `cargo run --release --example as_it_happens -- clip.mp4`.

use handcast::{JointAngle, LivePoseEncoder, LivePoseEncoderOptions, PoseDecoder, TimedPose, Tracker, open};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut camera =
        open(std::env::args().nth(1).unwrap_or("fixtures/demo.avi".into()), &Default::default())?;
    let rate = camera.info().rate.unwrap_or(30.0);
    let mut tracker = Tracker::new(Default::default());
    let mut encoder = LivePoseEncoder::new(LivePoseEncoderOptions::default().with_rate(rate));
    let mut decoder = PoseDecoder::new(Default::default());
    loop {
        let frame = camera.next_frame()?;
        let ended = frame.is_none();
        // What the tracker still holds when the camera ends: all of a short clip.
        let poses = match frame {
            Some(frame) => tracker.push(frame)?,
            None => tracker.finish()?,
        };
        if let Some(last) = poses.last() {
            for plane in encoder.push(last.time, &poses, &tracker.header(None))? {
                // Over the wire, and there:
                decoder.push(&plane.bytes)?.iter().for_each(show);
            }
        }
        if ended {
            break;
        }
    }
    for plane in encoder.finish()? {
        decoder.push(&plane.bytes)?.iter().for_each(show);
    }
    decoder.finish()?.iter().for_each(show);
    Ok(())
}

fn show(pose: &TimedPose) {
    let bend = pose.pose.angle(JointAngle::Index1Flexion).to_degrees();
    println!("{:.2} s: index finger bent by {bend:.0}°", pose.time);
}
