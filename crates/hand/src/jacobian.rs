//! How points of the hand move with its 29 angles and 6 global values: the analytic Jacobian.
//!
//! Every angle turns all that lies beyond its joint about one axis, so a point p moves by a × (p − q) for
//! each radian, a being the axis and q the joint. Axes and joints can be read off the joint frames.

use nalgebra::{Point3, Vector3};

use super::skeleton::THUMB_PRONATION;
use super::{Finger, HandFrames, HandPose, Joint, JointAngle, Side, Skeleton};

/// Columns of the Jacobian: the 29 angles, then translation x, y, z and rotation x, y, z.
pub const COLUMNS: usize = 35;
/// Column of the wrist's translation along x; y and z follow.
pub const TRANSLATION: usize = 29;
/// Column of a small turn about the camera frame's x axis, applied after the pose's rotation,
/// R ← exp(ω) R, with the wrist held in place; y and z follow.
pub const ROTATION: usize = 32;

/// The joint frames of a pose, with the axis and the centre of each of its 29 angles.
#[derive(Clone, Debug)]
pub struct Jacobian {
    frames: HandFrames,
    axes: [Vector3<f64>; JointAngle::COUNT],
    centres: [Point3<f64>; JointAngle::COUNT],
}

/// The angles that move a point fixed to a joint's frame, from the palm outwards.
pub fn moved_by(joint: Joint) -> &'static [JointAngle] {
    use JointAngle::*;
    const THUMB: [JointAngle; 5] =
        [Thumb1Flexion, Thumb1Abduction, Thumb1Twisting, Thumb2Flexion, Thumb3Flexion];
    const LONG: [[JointAngle; 6]; 4] = [
        [Index0Flexion, Index1Abduction, Index1Flexion, Index1Twisting, Index2Flexion, Index3Flexion],
        [Middle0Flexion, Middle1Abduction, Middle1Flexion, Middle1Twisting, Middle2Flexion, Middle3Flexion],
        [Ring0Flexion, Ring1Abduction, Ring1Flexion, Ring1Twisting, Ring2Flexion, Ring3Flexion],
        [Pinky0Flexion, Pinky1Abduction, Pinky1Flexion, Pinky1Twisting, Pinky2Flexion, Pinky3Flexion],
    ];
    match joint.index() {
        0 => &[],
        i @ 1..=4 => &THUMB[..[3, 4, 5, 5][i - 1]],
        i => &LONG[(i - 5) / 5][..[1, 4, 5, 6, 6][(i - 5) % 5]],
    }
}

impl Jacobian {
    /// The Jacobian at `pose`.
    pub fn new(skeleton: &Skeleton, pose: &HandPose) -> Self {
        Self::from_frames(skeleton.frames(pose), pose)
    }

    /// The Jacobian at `pose`, whose joint frames are `frames` ([`Skeleton::frames`]).
    pub fn from_frames(frames: HandFrames, pose: &HandPose) -> Self {
        let mut axes = [Vector3::zeros(); JointAngle::COUNT];
        let mut centres = [Point3::origin(); JointAngle::COUNT];
        // On a left hand the frames are mirrored: a turn about a frame's y or z axis changes its sense.
        let sense = match pose.side {
            Side::Right => 1.0,
            Side::Left => -1.0,
        };
        let mut put = |angle: JointAngle, axis: Vector3<f64>, joint: Joint| {
            axes[angle.index()] = axis;
            centres[angle.index()] = frames.position(joint);
        };
        for finger in Finger::ALL {
            let base = Joint::base(finger);
            let turn = frames.get(base).rotation;
            let bend = Vector3::x;
            let twisting = pose.angle(finger.twisting());
            // The x axis of the base frame before its twist.
            let untwisted = |twist: f64| {
                let (s, c) = twist.sin_cos();
                turn * Vector3::new(c, 0.0, sense * s)
            };
            put(finger.twisting(), turn * (Vector3::y() * sense), base);
            match finger.palm_flexion() {
                None => {
                    put(finger.base_flexion(), pose.rotation * (Vector3::z() * sense), base);
                    put(finger.abduction(), untwisted(THUMB_PRONATION + twisting), base);
                }
                Some(palm) => {
                    let metacarpal = Joint::of(finger)[0];
                    let bone = frames.get(metacarpal).rotation;
                    put(palm, bone * bend(), metacarpal);
                    let away = match finger {
                        Finger::Ring | Finger::Pinky => sense,
                        _ => -sense,
                    };
                    put(finger.abduction(), bone * (Vector3::z() * away), base);
                    put(finger.base_flexion(), untwisted(twisting), base);
                }
            }
            let [middle, end] = [Joint::ALL[base.index() + 1], Joint::ALL[base.index() + 2]];
            put(finger.middle_flexion(), frames.get(middle).rotation * bend(), middle);
            put(finger.end_flexion(), frames.get(end).rotation * bend(), end);
        }
        Self { frames, axes, centres }
    }

    /// The joint frames, in the camera frame.
    pub fn frames(&self) -> &HandFrames {
        &self.frames
    }

    /// The unit vector about which `angle` turns, in the camera frame.
    pub fn axis(&self, angle: JointAngle) -> &Vector3<f64> {
        &self.axes[angle.index()]
    }

    /// Metres a radian of `angle` moves a point that is fixed to a frame moved by it ([`moved_by`]);
    /// point and result in the camera frame.
    pub fn by_angle(&self, angle: JointAngle, point: &Point3<f64>) -> Vector3<f64> {
        self.axes[angle.index()].cross(&(point - self.centres[angle.index()]))
    }

    /// Metres a radian of turn about the camera frame's x, y and z axes moves a point.
    pub fn by_rotation(&self, point: &Point3<f64>) -> [Vector3<f64>; 3] {
        let arm = point - self.frames.position(Joint::Wrist);
        [Vector3::x().cross(&arm), Vector3::y().cross(&arm), Vector3::z().cross(&arm)]
    }

    /// All [`COLUMNS`] derivatives of a point (camera frame) fixed to the frame of `joint`.
    pub fn point(&self, joint: Joint, point: &Point3<f64>) -> [Vector3<f64>; COLUMNS] {
        let mut columns = [Vector3::zeros(); COLUMNS];
        for &angle in moved_by(joint) {
            columns[angle.index()] = self.by_angle(angle, point);
        }
        columns[TRANSLATION..ROTATION].copy_from_slice(&[Vector3::x(), Vector3::y(), Vector3::z()]);
        columns[ROTATION..].copy_from_slice(&self.by_rotation(point));
        columns
    }

    /// All [`COLUMNS`] derivatives of the position of `joint`.
    pub fn joint(&self, joint: Joint) -> [Vector3<f64>; COLUMNS] {
        self.point(joint, &self.frames.position(joint))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Morphology;
    use nalgebra::UnitQuaternion;
    use proptest::prelude::*;

    fn moved(pose: &HandPose, column: usize, by: f64) -> HandPose {
        let mut pose = pose.clone();
        let mut v = Vector3::zeros();
        match column {
            0..TRANSLATION => pose.angles[column] += by,
            TRANSLATION..ROTATION => pose.translation[column - TRANSLATION] += by,
            _ => {
                v[column - ROTATION] = by;
                pose.rotation = UnitQuaternion::from_scaled_axis(v) * pose.rotation;
            }
        }
        pose
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn equals_central_differences(
            angles in prop::array::uniform29(-1.5f64..1.5),
            global in prop::array::uniform6(-2.0f64..2.0),
            offset in prop::array::uniform3(-0.02f64..0.02),
            left in any::<bool>(),
        ) {
            let pose = HandPose {
                side: if left { Side::Left } else { Side::Right },
                translation: Vector3::new(global[0], global[1], global[2]),
                rotation: UnitQuaternion::from_scaled_axis(Vector3::new(global[3], global[4], global[5])),
                angles,
            };
            let skeleton = Skeleton::new(&Morphology::default(), pose.side);
            let jacobian = Jacobian::new(&skeleton, &pose);
            let offset = Point3::from(offset);
            let h = 1e-6;
            for column in 0..COLUMNS {
                let plus = skeleton.frames(&moved(&pose, column, h));
                let minus = skeleton.frames(&moved(&pose, column, -h));
                for joint in Joint::ALL {
                    let difference = (plus.position(joint) - minus.position(joint)) / (2.0 * h);
                    prop_assert!((jacobian.joint(joint)[column] - difference).amax() < 1e-8);
                    let point = jacobian.frames().get(joint) * offset;
                    let difference = (plus.get(joint) * offset - minus.get(joint) * offset) / (2.0 * h);
                    prop_assert!((jacobian.point(joint, &point)[column] - difference).amax() < 1e-8);
                }
            }
        }
    }
}
