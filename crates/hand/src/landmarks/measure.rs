//! The sizes of a hand, and whether it is left or right, from a recording of its joints.

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::{JointPoints, LandmarkError, PALM, PoseSolver, SolverOptions, align, mirrored_points};
use crate::morphology::metacarpal_of;
use crate::pose::mirror_vector;
use crate::{Finger, HandPose, Joint, JointAngle, Morphology, Side, Skeleton};

/// Most frames that [`measure`] and [`tell_side`] look at, spread evenly over a recording.
const SAMPLED_FRAMES: usize = 400;
/// Frames that [`tell_side`] solves as either hand.
const TRIED_FRAMES: usize = 48;

/// The sizes of a hand from a recording: bone lengths are medians over the frames, the palm is the median
/// of its points after rigid alignment, laid over the mean palm. What no frame shows keeps the mean
/// proportions. Positions are in metres; see [`hand_length`] for other scales.
///
/// # Errors
/// [`LandmarkError::NoPalm`], [`LandmarkError::Degenerate`], [`LandmarkError::Morphology`].
pub fn measure(frames: &[JointPoints], side: Side) -> Result<Morphology, LandmarkError> {
    let frames: Vec<JointPoints> = sample(frames, SAMPLED_FRAMES)
        .map(|points| match side {
            Side::Right => *points,
            Side::Left => mirrored_points(points),
        })
        .collect();
    let mut morphology = Morphology::average(hand_length(&frames).ok_or(LandmarkError::NoPalm)?);
    let palm = mean_palm(&frames)?;
    // The mean palm's proportions say which way it lies; its size is the hand's own.
    let rest = Skeleton::new(&morphology, Side::Right).local_frames(&[0.0; JointAngle::COUNT]);
    let at = |joint: Joint| palm[joint.index()].ok_or(LandmarkError::NoPalm);
    let wrist = at(Joint::Wrist)?;
    let mut pairs = Vec::with_capacity(PALM.len());
    for joint in PALM {
        pairs.push((at(joint)?, rest.position(joint)));
    }
    let laid = align(&pairs).ok_or(LandmarkError::Degenerate)?.rotation;
    let laid = middle_finger_forward(&frames, &palm, &laid) * laid;
    let in_hand = |p: Point3<f64>| <[f64; 3]>::from(laid * (p - wrist));
    for finger in Finger::ALL {
        let joints = Joint::of(finger);
        let base = Joint::base(finger).index();
        let f = &mut morphology.fingers[finger as usize];
        f.base = in_hand(at(Joint::base(finger))?);
        f.metacarpal = match palm[joints[0].index()] {
            Some(p) => in_hand(p),
            None => metacarpal_of(f.base),
        };
        for k in 0..3 {
            let lengths = frames.iter().filter_map(|p| Some((p[base + k]? - p[base + k + 1]?).norm()));
            if let Some(length) = median(lengths) {
                f.bones[k] = length;
            }
        }
    }
    let middle = morphology.finger(Finger::Middle);
    morphology.hand_length = middle.base[1] + middle.length();
    morphology.validate()?;
    Ok(morphology)
}

/// The sizes of a hand from joints whose pose is known, metres: medians over the frames of where each joint lies in the hand
/// when nothing is bent. Frames that lack a joint do not count.
///
/// # Errors
/// [`LandmarkError::NoPalm`] without a whole frame, [`LandmarkError::Morphology`].
pub fn measure_posed<'a>(
    frames: impl Iterator<Item = (&'a HandPose, &'a JointPoints)>,
    side: Side,
) -> Result<Morphology, LandmarkError> {
    let frames: Vec<_> = frames.filter(|(_, points)| points.iter().all(Option::is_some)).collect();
    // Which way a joint turns depends on no size.
    let skeleton = Skeleton::new(&Morphology::default(), side);
    let rest = skeleton.local_frames(&[0.0; JointAngle::COUNT]);
    let step = frames.len().div_ceil(SAMPLED_FRAMES).max(1);
    let unbent = frames.iter().step_by(step).filter_map(|(pose, points)| {
        let turned = skeleton.frames(pose);
        let mut at = [Point3::origin(); Joint::COUNT];
        for joint in Joint::ALL {
            let Some(above) = joint.parent() else { continue };
            let bone = points[joint.index()]? - points[above.index()]?;
            let bone = turned.get(above).rotation.inverse_transform_vector(&bone);
            at[joint.index()] = at[above.index()] + rest.get(above).rotation * bone;
        }
        Some(at.map(|p| if side == Side::Left { Point3::from(mirror_vector(p.coords)) } else { p }))
    });
    let unbent: Vec<[Point3<f64>; Joint::COUNT]> = unbent.collect();
    let place = |joint: Joint| -> Result<[f64; 3], LandmarkError> {
        let axis = |k: usize| median(unbent.iter().map(|p| p[joint.index()][k])).ok_or(LandmarkError::NoPalm);
        Ok([axis(0)?, axis(1)?, axis(2)?])
    };
    let bone =
        |a: usize| median(unbent.iter().map(|p| (p[a + 1] - p[a]).norm())).ok_or(LandmarkError::NoPalm);
    let length = place(Joint::MiddleProximal)?[1]
        + (0..3).map(|k| bone(Joint::MiddleProximal.index() + k)).sum::<Result<f64, _>>()?;
    let mut morphology = Morphology::average(length);
    for finger in Finger::ALL {
        let base = Joint::base(finger);
        let f = &mut morphology.fingers[finger as usize];
        f.base = place(base)?;
        f.metacarpal = place(Joint::of(finger)[0])?;
        for k in 0..3 {
            f.bones[k] = bone(base.index() + k)?;
        }
    }
    morphology.hand_length = length;
    morphology.validate()?;
    Ok(morphology)
}

/// Wrist to middle fingertip along the bones, in the unit of the points: the median over the frames that
/// show each bone. `None` when one is never seen.
pub fn hand_length(frames: &[JointPoints]) -> Option<f64> {
    use Joint::*;
    let chain = [Wrist, MiddleProximal, MiddleIntermediate, MiddleDistal, MiddleTip].map(Joint::index);
    chain
        .windows(2)
        .map(|w| {
            let (a, b) = (w[0], w[1]);
            median(frames.iter().filter_map(|p| Some((p[a]? - p[b]?).norm())))
        })
        .sum()
}

/// How much the bones of the long fingers change their lengths over a recording, as a share of them: the range between
/// the quartiles over the median, in the middle of the bones. Rigid skeletons have next to none (Leap 0.0002), markers on
/// the skin up to 0.05, learned trackers 0.1 to 0.3. `None` when no bone is seen.
pub fn bone_spread(frames: &[JointPoints]) -> Option<f64> {
    let bones =
        Finger::LONG.into_iter().flat_map(|finger| [0, 1, 2].map(|k| Joint::base(finger).index() + k));
    let spreads = bones.filter_map(|k| {
        let mut lengths: Vec<f64> = frames
            .iter()
            .filter_map(|p| Some((p[k]? - p[k + 1]?).norm()))
            .filter(|v| v.is_finite())
            .collect();
        lengths.sort_by(f64::total_cmp);
        let quartile = |q: usize| lengths.get(q * lengths.len() / 4).copied();
        let middle = quartile(2).filter(|v| *v > 0.0)?;
        Some((quartile(3)? - quartile(1)?) / middle)
    });
    median(spreads)
}

/// Left or right by trial: the mean distances, metres, when a recording is solved as either hand. A hand
/// taken for the other would have to bend its fingers backwards, so the better fit tells the side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SideTrial {
    /// Mean distance as a left hand.
    pub left: f64,
    /// Mean distance as a right hand.
    pub right: f64,
}

impl SideTrial {
    /// The side with the smaller distance.
    pub fn side(&self) -> Side {
        if self.left < self.right { Side::Left } else { Side::Right }
    }

    /// Larger over smaller distance: 1 when there is nothing to tell the sides apart.
    pub fn ratio(&self) -> f64 {
        let (a, b) = (self.left.min(self.right), self.left.max(self.right));
        b / a.max(1e-9)
    }
}

/// Tries both sides on a recording.
///
/// # Errors
/// Those of [`measure`].
pub fn tell_side(frames: &[JointPoints]) -> Result<SideTrial, LandmarkError> {
    let trial = |side| -> Result<f64, LandmarkError> {
        let options = SolverOptions { twists: false, ..SolverOptions::default() };
        let mut solver = PoseSolver::new(&measure(frames, side)?, side, options);
        let (mut sum, mut count) = (0.0, 0);
        for points in sample(frames, TRIED_FRAMES) {
            // Frames lie far apart here, and a wrong hand must not drag along.
            solver.reset();
            if let Ok(fit) = solver.solve(points) {
                sum += fit.mean_distance;
                count += 1;
            }
        }
        if count == 0 { Err(LandmarkError::NoPalm) } else { Ok(sum / f64::from(count)) }
    };
    Ok(SideTrial { left: trial(Side::Left)?, right: trial(Side::Right)? })
}

/// At most `count` of the frames, evenly spread.
fn sample(frames: &[JointPoints], count: usize) -> impl Iterator<Item = &JointPoints> {
    frames.iter().step_by(frames.len().div_ceil(count).max(1))
}

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// The turn about the palm's normal that makes the middle finger point along +Y in the middle of a
/// recording: it is the axis from which abduction is counted, and sources differ in where they see the
/// wrist. Frames with that finger bent far say little and do not count.
fn middle_finger_forward(
    frames: &[JointPoints],
    palm: &JointPoints,
    laid: &UnitQuaternion<f64>,
) -> UnitQuaternion<f64> {
    let swings = frames.iter().filter_map(|points| {
        let pairs: Vec<_> =
            PALM.iter().filter_map(|j| Some((laid * palm[j.index()]?, points[j.index()]?))).collect();
        let bone = points[Joint::MiddleIntermediate.index()]? - points[Joint::MiddleProximal.index()]?;
        let d = align(&pairs)?.rotation.inverse_transform_vector(&bone);
        (d.y > bone.norm() * 0.7).then(|| f64::atan2(-d.x, d.y))
    });
    let limit = f64::to_radians(20.0);
    let swing = median(swings).unwrap_or(0.0).clamp(-limit, limit);
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -swing)
}

/// The joints of the palm after the frames have been laid on each other: their median positions.
fn mean_palm(frames: &[JointPoints]) -> Result<JointPoints, LandmarkError> {
    use Joint::*;
    let carried = [IndexMetacarpal, MiddleMetacarpal, RingMetacarpal, PinkyMetacarpal];
    let whole: Vec<&JointPoints> =
        frames.iter().filter(|p| PALM.iter().all(|j| p[j.index()].is_some())).collect();
    let mut mean = **whole.first().ok_or(LandmarkError::NoPalm)?;
    for _ in 0..4 {
        let laid: Vec<JointPoints> = whole
            .iter()
            .filter_map(|points| {
                let pairs: Vec<_> =
                    PALM.iter().filter_map(|j| Some((points[j.index()]?, mean[j.index()]?))).collect();
                let motion = align(&pairs)?;
                Some(points.map(|p| p.map(|p| motion * p)))
            })
            .collect();
        if laid.is_empty() {
            return Err(LandmarkError::Degenerate);
        }
        for joint in PALM.into_iter().chain(carried).map(Joint::index) {
            let axis = |k: usize| median(laid.iter().filter_map(|p| Some(p[joint]?[k])));
            mean[joint] = match (axis(0), axis(1), axis(2)) {
                (Some(x), Some(y), Some(z)) => Some(Point3::new(x, y, z)),
                _ => None,
            };
        }
    }
    Ok(mean)
}

#[cfg(test)]
mod tests {
    use super::super::tests::points_of;
    use super::*;
    use crate::HandPose;

    #[test]
    fn sizes_and_side_come_back_from_a_moving_hand() {
        let mut morphology = Morphology::average(0.2);
        morphology.fingers[1].bones = [0.050, 0.025, 0.021];
        morphology.fingers[4].base[0] -= 0.004;
        for side in [Side::Left, Side::Right] {
            let frames: Vec<JointPoints> = (0..40)
                .map(|i| {
                    let s = 0.5 - 0.5 * (0.3 * f64::from(i)).cos();
                    let mut pose = HandPose::neutral(side);
                    pose.rotation = UnitQuaternion::from_euler_angles(s, 2.0 * s, -s);
                    for finger in Finger::LONG {
                        pose.set(finger.base_flexion(), s);
                        pose.set(finger.middle_flexion(), 1.2 * s);
                    }
                    points_of(&morphology, &pose)
                })
                .collect();
            let trial = tell_side(&frames).unwrap();
            assert_eq!(trial.side(), side);
            assert!(trial.ratio() > 2.0, "{trial:?}");
            let found = measure(&frames, side).unwrap();
            assert!((found.hand_length - 0.2).abs() < 0.002);
            assert!(bone_spread(&frames).unwrap() < 1e-9);
            for (a, b) in found.fingers.iter().zip(&morphology.fingers) {
                for k in 0..3 {
                    assert!((a.bones[k] - b.bones[k]).abs() < 1e-9);
                    assert!((a.base[k] - b.base[k]).abs() < 0.004);
                }
            }
        }
    }
}
