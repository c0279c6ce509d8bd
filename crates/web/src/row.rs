//! A pose as a row of numbers.

use handcast_hand::{Joint, JointAngle, Side, Skeleton, TimedPose};
use nalgebra::{Isometry3, Matrix4};

/// Where the joint angles of a row begin: before them are the side (0 left, 1 right), whether the hand is lost (0 or 1),
/// the confidence (−1 where none is told) and a 0.
pub const ANGLES: usize = 4;
/// Where the wrist's matrix begins.
pub const WRIST: usize = ANGLES + JointAngle::COUNT;
/// Where the joints' matrices begin.
pub const JOINTS: usize = WRIST + 16;
/// Numbers of a row.
pub const ROW: usize = JOINTS + 16 * Joint::COUNT;

/// Adds the row of a pose to `rows`: [`ROW`] numbers, angles in radians, matrices column by column, metres.
pub fn write_row(timed: &TimedPose, skeleton: &Skeleton, rows: &mut Vec<f32>) {
    let pose = &timed.pose;
    let flag = |on: bool| f32::from(u8::from(on));
    let confidence = timed.confidence.map_or(-1.0, |sure| sure as f32);
    rows.extend([flag(pose.side == Side::Right), flag(!timed.valid), confidence, 0.0]);
    rows.extend(pose.angles.map(|angle| angle as f32));
    rows.extend(columns(&pose.isometry()));
    rows.extend(skeleton.frames(pose).0.iter().flat_map(columns));
}

fn columns(frame: &Isometry3<f64>) -> [f32; 16] {
    let matrix: Matrix4<f32> = frame.to_homogeneous().cast();
    std::array::from_fn(|i| matrix[(i % 4, i / 4)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::{HandPose, Morphology};
    use nalgebra::{Point3, UnitQuaternion, Vector3};

    #[test]
    fn a_row_places_every_joint() {
        for side in [Side::Left, Side::Right] {
            let mut pose = HandPose::neutral(side).with_degrees(JointAngle::Index1Flexion, 40.0);
            pose.rotation = UnitQuaternion::from_euler_angles(0.3, -0.8, 1.9);
            pose.translation = Vector3::new(0.1, -0.2, -0.7);
            let skeleton = Skeleton::new(&Morphology::default(), side);
            let mut rows = vec![9.0];
            let timed =
                TimedPose { valid: false, confidence: Some(0.25), ..TimedPose::new(1.0, pose.clone()) };
            write_row(&timed, &skeleton, &mut rows);
            let row = &rows[1..];
            assert_eq!(row.len(), ROW);
            assert_eq!(row[..ANGLES], [f32::from(u8::from(side == Side::Right)), 1.0, 0.25, 0.0]);
            let bend = row[ANGLES + JointAngle::Index1Flexion.index()];
            assert!((bend - 40f32.to_radians()).abs() < 1e-6);
            assert_eq!(row[WRIST..JOINTS], row[JOINTS..JOINTS + 16]);
            let frames = skeleton.frames(&pose);
            for (joint, matrix) in Joint::ALL.into_iter().zip(row[JOINTS..].chunks(16)) {
                // A point on the bone, by the matrix and by the frame.
                let point = [0.01f32, 0.03, -0.02];
                let by_row: Vec<f32> = (0..3)
                    .map(|r| (0..3).map(|c| matrix[4 * c + r] * point[c]).sum::<f32>() + matrix[12 + r])
                    .collect();
                let by_frame = frames.get(joint) * Point3::from(point).cast::<f64>();
                for k in 0..3 {
                    assert!((f64::from(by_row[k]) - by_frame[k]).abs() < 1e-6, "{joint:?}");
                }
                assert_eq!([matrix[3], matrix[7], matrix[11], matrix[15]], [0.0, 0.0, 0.0, 1.0]);
            }
        }
    }
}
