//! Motion as dense as signing, made of still poses.

use handcast_hand::shapes::minimum_jerk;
use handcast_hand::{Finger, HandPose, JointAngle};

use handcast_hand::random::Random;

/// Noise on each moving angle, degrees.
const NOISE: f64 = 0.4;

/// Motion as dense as signing, at `rate` frames per second: `poses` in random order, minimum-jerk
/// transitions of 0.15 to 0.5 s between them, holds of 0.1 to 0.6 s, noise of 0.4° on the 20 angles that a
/// tracker moves; the hand stays where it is. The same seed gives the same motion. Empty without poses.
///
/// ```
/// use handcast_hand::{HandPose, JointAngle, Side};
/// use handcast_eval::synth::sign_dense;
///
/// let open = HandPose::neutral(Side::Right);
/// let bent = open.clone().with_degrees(JointAngle::Index2Flexion, 80.0);
/// let motion = sign_dense(&[open, bent], 2.0, 30.0, 1);
/// assert_eq!(motion.len(), 60);
/// assert_eq!(motion[30].0, 1.0);
/// ```
pub fn sign_dense(poses: &[HandPose], seconds: f64, rate: f64, seed: u64) -> Vec<(f64, HandPose)> {
    let Some(first) = poses.first() else { return Vec::new() };
    let mut random = Random::new(seed, 0);
    let moving: Vec<JointAngle> = Finger::ALL
        .into_iter()
        .flat_map(|finger| {
            [finger.base_flexion(), finger.abduction(), finger.middle_flexion(), finger.end_flexion()]
        })
        .collect();
    let frames = (seconds * rate).max(0.0) as usize;
    let mut out = Vec::with_capacity(frames);
    let (mut from, mut to) = (first, first);
    let (mut start, mut end, mut hold) = (0.0, 0.0, 0.3);
    for frame in 0..frames {
        let time = frame as f64 / rate;
        while time >= end + hold {
            start = end + hold;
            end = start + f64::from(random.range(0.15, 0.5));
            hold = f64::from(random.range(0.1, 0.6));
            from = to;
            to = poses.get(random.bits() as usize % poses.len()).unwrap_or(first);
        }
        let share =
            if end > start { minimum_jerk(((time - start) / (end - start)).clamp(0.0, 1.0)) } else { 1.0 };
        let mut pose = HandPose::neutral(first.side);
        for &angle in &moving {
            let noise = (NOISE * f64::from(random.gauss())).to_radians();
            pose.set(angle, from.angle(angle) + share * (to.angle(angle) - from.angle(angle)) + noise);
        }
        out.push((time, pose));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::Side;

    #[test]
    fn it_moves_and_repeats() {
        let open = HandPose::neutral(Side::Left);
        let bent = open.clone().with_degrees(JointAngle::Ring2Flexion, 60.0);
        let shapes = [open, bent];
        let motion = sign_dense(&shapes, 20.0, 30.0, 3);
        assert_eq!(motion, sign_dense(&shapes, 20.0, 30.0, 3));
        assert_ne!(motion, sign_dense(&shapes, 20.0, 30.0, 4));
        let bends: Vec<f64> =
            motion.iter().map(|(_, pose)| pose.angle(JointAngle::Ring2Flexion).to_degrees()).collect();
        assert!(bends.iter().any(|&bend| bend > 58.0) && bends.iter().any(|&bend| bend < 2.0));
        assert!(motion.iter().all(|(_, pose)| pose.angle(JointAngle::Ring0Flexion) == 0.0));
        assert!(sign_dense(&[], 20.0, 30.0, 3).is_empty());
    }
}
