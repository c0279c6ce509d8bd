//! Smoothing of poses while they come: the 1€ filter (Casiez, Roussel & Vogel, "1 € filter: a simple
//! speed-based low-pass filter for noisy input in interactive systems", CHI 2012) on angles.
//!
//! A first-order low-pass whose cut-off frequency grows with speed: what rests is steadied, what moves hardly
//! lags. The joint angles of a finger share the cut-off of the fastest of them, so that the ties among them
//! (spec/hand-model.md) stay as they are. The rotation is filtered as a quaternion, the translation by axis.
//!
//! What is recorded as a whole goes through it in both directions of time ([`smooth_recording`]), so that nothing lags.

use nalgebra::Vector3;

use super::{Domain, Finger, HandPose, JointAngle, JointAngles, TimedPose};

/// How much is smoothed.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct SmoothOptions {
    /// Cut-off frequency at rest, Hz: lower is steadier.
    pub min_cutoff: f64,
    /// Growth of the cut-off with speed, Hz per degree per second; a millimetre of the wrist's place counts as
    /// a degree, as both move a fingertip about as far. In steady motion the lag stays below 1/(2π·`beta`)
    /// degrees.
    pub beta: f64,
    /// Cut-off frequency of the speed itself, Hz.
    pub speed_cutoff: f64,
}

impl Default for SmoothOptions {
    fn default() -> Self {
        Self { min_cutoff: 1.0, beta: 0.05, speed_cutoff: 1.0 }
    }
}

impl SmoothOptions {
    /// For [`smooth_recording`], where nothing lags: cut-off 0.5 Hz at rest, growing by 0.02 Hz per degree per second.
    pub fn recorded() -> Self {
        Self::default().with(0.5, 0.02)
    }

    /// For poses that are sent while they come: cut-off 5 Hz at rest, growing by 0.5 Hz per degree per second, so that in steady
    /// motion they lag by 0.3 degrees at most.
    pub fn live() -> Self {
        Self::default().with(5.0, 0.5)
    }

    /// Sets [`SmoothOptions::min_cutoff`] and [`SmoothOptions::beta`].
    pub fn with(mut self, min_cutoff: f64, beta: f64) -> Self {
        self.min_cutoff = min_cutoff;
        self.beta = beta;
        self
    }

    /// Share of the way to a new value, `dt` seconds after the last, at a speed in degrees per second.
    fn share(&self, speed: f64, dt: f64) -> f64 {
        low_pass(self.min_cutoff + self.beta * speed, dt)
    }
}

/// The weight of a new sample in a first-order low-pass of this cut-off frequency.
fn low_pass(cutoff: f64, dt: f64) -> f64 {
    let tau = 1.0 / (std::f64::consts::TAU * cutoff.max(1e-6));
    1.0 / (1.0 + tau / dt)
}

/// What is remembered of the poses so far.
#[derive(Clone, Debug)]
struct Memory {
    time: f64,
    smooth: HandPose,
    /// Filtered speeds: radians per second of the joint angles, metres per second, rotation vector per second.
    angles: [f64; 29],
    velocity: Vector3<f64>,
    spin: Vector3<f64>,
}

/// Smooths the poses of one hand, one by one, from what came before each alone.
#[derive(Clone, Debug)]
pub struct PoseSmoother {
    options: SmoothOptions,
    domain: Domain,
    memory: Option<Memory>,
}

/// What keeps the tied angles of a pose feasible to the last digits.
const TOLERANCE: f64 = 1e-6;

impl PoseSmoother {
    /// A smoother that has seen nothing.
    pub fn new(options: SmoothOptions) -> Self {
        Self { options, domain: Domain::full(), memory: None }
    }

    /// Forgets what it saw: for gaps that nothing bridges.
    pub fn reset(&mut self) {
        self.memory = None;
    }

    /// The smoothed pose at `time` (seconds). Without a pose (the hand is lost) the last one is held, nothing is
    /// learnt, and the next pose counts as coming after the gap: the longer it was, the less holds it back.
    /// `None` before the first pose.
    pub fn next(&mut self, time: f64, pose: Option<&HandPose>) -> Option<HandPose> {
        let Some(pose) = pose else { return self.memory.as_ref().map(|m| m.smooth.clone()) };
        let still = || Memory {
            time,
            smooth: pose.clone(),
            angles: [0.0; 29],
            velocity: Vector3::zeros(),
            spin: Vector3::zeros(),
        };
        let memory = self.memory.get_or_insert_with(still);
        let dt = time - memory.time;
        if dt > 0.0 {
            memory.advance(&self.options, pose, dt);
            memory.time = time;
            // Fingers that lag differently may leave what middle finger and neighbours allow each other.
            if !self.domain.is_feasible(&memory.smooth.angles, TOLERANCE)
                && self.domain.is_feasible(&pose.angles, TOLERANCE)
            {
                memory.smooth = self.domain.project_pose(&memory.smooth);
            }
        }
        Some(memory.smooth.clone())
    }
}

impl Memory {
    fn advance(&mut self, o: &SmoothOptions, pose: &HandPose, dt: f64) {
        let learn = low_pass(o.speed_cutoff, dt);
        for finger in Finger::ALL {
            let mut fastest = 0.0f64;
            for i in angles_of(finger) {
                let speed = (pose.angles[i] - self.smooth.angles[i]) / dt;
                self.angles[i] += learn * (speed - self.angles[i]);
                fastest = fastest.max(self.angles[i].abs());
            }
            let share = o.share(fastest.to_degrees(), dt);
            for i in angles_of(finger) {
                self.smooth.angles[i] += share * (pose.angles[i] - self.smooth.angles[i]);
            }
        }
        for k in 0..3 {
            let off = pose.translation[k] - self.smooth.translation[k];
            self.velocity[k] += learn * (off / dt - self.velocity[k]);
            self.smooth.translation[k] += o.share(1e3 * self.velocity[k].abs(), dt) * off;
        }
        let turn = (pose.rotation * self.smooth.rotation.inverse()).scaled_axis();
        self.spin += learn * (turn / dt - self.spin);
        let share = o.share(self.spin.norm().to_degrees(), dt);
        self.smooth.rotation =
            nalgebra::UnitQuaternion::from_scaled_axis(share * turn) * self.smooth.rotation;
    }
}

/// Smooths the poses of one hand, in the order of their times, forwards and then backwards: what one direction lags the other
/// takes back. Nothing goes across poses that are not valid, which stay as they are, or across more than `max_gap` seconds.
pub fn smooth_recording(poses: &mut [TimedPose], options: SmoothOptions, max_gap: f64) {
    let together = |a: &TimedPose, b: &TimedPose| a.valid && b.valid && b.time - a.time <= max_gap;
    for run in poses.chunk_by_mut(together).filter(|run| run.iter().all(|pose| pose.valid)) {
        let mut forwards = PoseSmoother::new(options);
        for pose in run.iter_mut() {
            pass(&mut forwards, pose.time, pose);
        }
        let mut backwards = PoseSmoother::new(options);
        for pose in run.iter_mut().rev() {
            pass(&mut backwards, -pose.time, pose);
        }
    }
}

fn pass(smoother: &mut PoseSmoother, time: f64, pose: &mut TimedPose) {
    if let Some(smooth) = smoother.next(time, Some(&pose.pose)) {
        pose.pose = smooth;
    }
}

/// Places of a finger's angles in [`HandPose::angles`].
fn angles_of(finger: Finger) -> impl Iterator<Item = usize> {
    let bends = [finger.base_flexion(), finger.abduction(), finger.twisting(), finger.middle_flexion()];
    let all = bends.into_iter().chain([finger.end_flexion()]).chain(finger.palm_flexion());
    all.map(JointAngle::index)
}

/// How unsteady poses are, degrees: root mean square, over the joint angles that are ever used, of how far an
/// angle lies from the mean of those before and after it.
#[derive(Clone, Debug, Default)]
pub struct Jitter {
    used: [bool; JointAngle::COUNT],
    /// Of all squares, and how many poses have one before and one behind.
    sum: f64,
    count: usize,
    /// The last two, the newest last.
    last: [Option<JointAngles>; 2],
}

impl Jitter {
    /// Takes the next pose; `None` is a frame without one: angles beside it are left out.
    pub fn push(&mut self, pose: Option<&HandPose>) {
        let next = pose.map(|pose| pose.angles);
        for (used, angle) in self.used.iter_mut().zip(next.iter().flatten()) {
            *used |= *angle != 0.0;
        }
        let [before, here] = &self.last;
        if let (Some(a), Some(b), Some(c)) = (before, here, &next) {
            let off = |i: usize| (b[i] - 0.5 * (a[i] + c[i])).to_degrees();
            self.sum += (0..JointAngle::COUNT).map(|i| off(i) * off(i)).sum::<f64>();
            self.count += 1;
        }
        self.last = [*here, next];
    }

    /// That of all poses so far; `None` when nothing can be said.
    pub fn degrees(&self) -> Option<f64> {
        // An angle that is never used is never off.
        let count = self.count * self.used.iter().filter(|used| **used).count();
        (count > 0).then(|| (self.sum / count as f64).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Side;
    use crate::random::Random;
    use nalgebra::UnitQuaternion;

    const RATE: f64 = 30.0;

    fn bent(degrees: f64) -> HandPose {
        HandPose::neutral(Side::Right)
            .with_degrees(JointAngle::Index2Flexion, degrees)
            .with_degrees(JointAngle::Index3Flexion, degrees / 1.5)
    }

    fn run(options: SmoothOptions, poses: &[Option<HandPose>]) -> Vec<Option<HandPose>> {
        let mut smoother = PoseSmoother::new(options);
        poses.iter().enumerate().map(|(i, p)| smoother.next(i as f64 / RATE, p.as_ref())).collect()
    }

    fn jitter(poses: &[Option<HandPose>]) -> Option<f64> {
        let mut jitter = Jitter::default();
        poses.iter().for_each(|pose| jitter.push(pose.as_ref()));
        jitter.degrees()
    }

    fn index(pose: &Option<HandPose>) -> f64 {
        pose.as_ref().unwrap().angle(JointAngle::Index2Flexion).to_degrees()
    }

    #[test]
    fn a_constant_pose_is_untouched() {
        let mut pose = bent(40.0);
        pose.translation = Vector3::new(0.1, -0.2, -0.5);
        pose.rotation = UnitQuaternion::from_euler_angles(0.3, -0.2, 1.0);
        for smooth in run(SmoothOptions::default(), &vec![Some(pose.clone()); 20]) {
            let smooth = smooth.unwrap();
            assert_eq!(smooth.angles, pose.angles);
            assert_eq!(smooth.translation, pose.translation);
            assert!(smooth.rotation.angle_to(&pose.rotation) < 1e-7);
        }
    }

    #[test]
    fn a_step_is_followed_without_overshoot_and_ties_stay() {
        let steps: Vec<_> = (0..60).map(|i| Some(bent(if i < 10 { 0.0 } else { 60.0 }))).collect();
        let out = run(SmoothOptions::default(), &steps);
        for pair in out[9..].windows(2) {
            assert!(index(&pair[1]) >= index(&pair[0]) && index(&pair[1]) <= 60.0);
        }
        assert!(index(&out[12]) > 54.0, "nine tenths after 0.1 s: {}", index(&out[12]));
        assert!(index(&out[59]) > 59.99);
        for pose in out.iter().flatten() {
            let (two, three) = (pose.angle(JointAngle::Index2Flexion), pose.angle(JointAngle::Index3Flexion));
            assert!((two - 1.5 * three).abs() < 1e-12);
        }
    }

    #[test]
    fn the_lag_of_a_ramp_is_bounded() {
        for speed in [20.0, 100.0, 300.0] {
            let options = SmoothOptions::default();
            let ramp: Vec<_> = (0..30).map(|i| Some(bent(speed * f64::from(i) / RATE - 20.0))).collect();
            let out = run(options, &ramp);
            let lag = index(&ramp[29]) - index(&out[29]);
            assert!(lag > 0.0 && lag < 1.0 / (std::f64::consts::TAU * options.beta), "{speed}: {lag}");
        }
    }

    #[test]
    fn a_recording_is_smoothed_without_lag() {
        let options = SmoothOptions::recorded();
        let mut random = Random::new(11, 0);
        // A finger that goes to and fro by 60 degrees in three seconds, found with an error of three.
        let truth = |i: u32| 30.0 - 30.0 * (std::f64::consts::TAU * f64::from(i) / (3.0 * RATE)).cos();
        let noisy = |random: &mut Random, i: u32| {
            TimedPose::new(f64::from(i) / RATE, bent(truth(i) + 3.0 * f64::from(random.gauss())))
        };
        let raw: Vec<_> = (0..240).map(|i| noisy(&mut random, i)).collect();
        let mut smooth = raw.clone();
        smooth_recording(&mut smooth, options, 0.25);
        let at = |pose: &TimedPose| pose.pose.angle(JointAngle::Index2Flexion).to_degrees();
        let off = |poses: &[TimedPose], lag: u32| {
            let inner = (30..210).map(|i| at(&poses[i as usize]) - truth(i - lag));
            (inner.map(|off| off * off).sum::<f64>() / 180.0).sqrt()
        };
        // One direction lags two frames and more.
        let causal: Vec<_> = run(options, &raw.iter().map(|p| Some(p.pose.clone())).collect::<Vec<_>>())
            .into_iter()
            .flatten()
            .map(|pose| TimedPose::new(0.0, pose))
            .collect();
        assert!(off(&causal, 2) < off(&causal, 0), "{} {}", off(&causal, 2), off(&causal, 0));
        assert!(off(&smooth, 0) < off(&smooth, 1) && off(&smooth, 0) < 0.7 * off(&causal, 0));
        assert!(
            off(&smooth, 0) < 0.7 * off(&raw, 0),
            "{} {} {}",
            off(&smooth, 0),
            off(&raw, 0),
            off(&causal, 0)
        );
    }

    #[test]
    fn a_recording_is_not_smoothed_across_gaps() {
        let at = |time: f64, degrees: f64| TimedPose::new(time, bent(degrees));
        let mut poses = vec![at(0.0, 10.0), at(0.1, 10.0), at(1.0, 70.0), TimedPose::lost(1.1, Side::Right)];
        poses.extend([at(1.2, 10.0), at(1.3, 10.0)]);
        let before = poses.clone();
        smooth_recording(&mut poses, SmoothOptions::recorded(), 0.25);
        assert_eq!(poses, before);
        smooth_recording(&mut poses, SmoothOptions::recorded(), 2.0);
        assert!(poses[2] != before[2] && poses[3..] == before[3..]);
        smooth_recording(&mut [], SmoothOptions::recorded(), 0.25);
    }

    #[test]
    fn jitter_falls_and_a_firmer_filter_takes_more() {
        let mut random = Random::new(3, 0);
        let noisy: Vec<_> = (0..300).map(|_| Some(bent(30.0 + f64::from(random.gauss())))).collect();
        let before = jitter(&noisy).unwrap();
        let default = jitter(&run(SmoothOptions::default(), &noisy)).unwrap();
        let firm = jitter(&run(SmoothOptions::default().with(0.3, 0.0), &noisy)).unwrap();
        assert!(default < 0.45 * before && firm < 0.5 * default, "{before} {default} {firm}");
    }

    #[test]
    fn rotation_and_translation_are_steadied() {
        let mut random = Random::new(5, 0);
        let (mut raw, mut smooth) = (Vec::new(), Vec::new());
        let mut smoother = PoseSmoother::new(SmoothOptions::default());
        for i in 0..200 {
            let mut noise = || 0.01 * f64::from(random.gauss());
            let mut pose = bent(0.0);
            pose.translation = Vector3::new(noise(), noise(), noise() - 0.5);
            pose.rotation = UnitQuaternion::from_scaled_axis(Vector3::new(1.0 + noise(), noise(), noise()));
            let out = smoother.next(f64::from(i) / RATE, Some(&pose)).unwrap();
            raw.push(pose);
            smooth.push(out);
        }
        let still = bent(0.0).rotation * UnitQuaternion::from_scaled_axis(Vector3::x());
        let off = |list: &[HandPose]| list[20..].iter().map(|p| p.rotation.angle_to(&still)).sum::<f64>();
        assert!(off(&smooth) < 0.6 * off(&raw));
        let depth = |list: &[HandPose]| list[20..].iter().map(|p| (p.translation.z + 0.5).abs()).sum::<f64>();
        assert!(depth(&smooth) < 0.6 * depth(&raw));
    }

    #[test]
    fn lost_frames_hold_and_do_not_pull() {
        let mut poses: Vec<_> = (0..10).map(|_| Some(bent(10.0))).collect();
        assert_eq!(PoseSmoother::new(SmoothOptions::default()).next(0.0, None), None);
        poses.extend((0..60).map(|_| None));
        poses.extend((0..3).map(|_| Some(bent(70.0))));
        let out = run(SmoothOptions::default(), &poses);
        assert!((10..70).all(|i| index(&out[i]) == 10.0));
        assert!(index(&out[70]) > 65.0, "after two seconds the old pose hardly counts: {}", index(&out[70]));
        assert_eq!(jitter(&poses[5..12]), Some(0.0));
        assert_eq!(jitter(&[None, None]), None);
    }

    #[test]
    fn feasible_poses_stay_feasible() {
        let domain = Domain::full();
        let mut smoother = PoseSmoother::new(SmoothOptions::recorded().with(0.5, 0.035));
        for i in 0..200 {
            let mut pose = HandPose::neutral(Side::Left);
            for (k, angle) in pose.angles.iter_mut().enumerate() {
                *angle = ((f64::from(i) * (k + 3) as f64) * 0.31).sin() * 2.0;
            }
            let pose = domain.project_pose(&pose);
            let out = smoother.next(f64::from(i) * 0.02, Some(&pose)).unwrap();
            assert!(domain.is_feasible(&out.angles, 1e-5));
        }
    }
}
