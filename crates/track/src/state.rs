//! The state of the model in image terms.

use nalgebra::{UnitQuaternion, Vector3};

use super::camera::PinholeCamera;
use handcast_hand::{
    Domain, FREE_ANGLES, Finger, FreeAngles, HandPose, JointAngle, JointAngles, Side, limits,
    thumb_mcp_from_cmc,
};

/// The length in which places are measured, metres: about that of a mean hand, wrist to middle fingertip.
pub const HAND_LENGTH: f64 = 0.19;

/// Depth at which wrists in front of the camera begin, metres.
const NEAREST_WRIST: f64 = 1e-3;

/// Position, scale, orientation and free joint angles of the model: the 21 parameters of the paper,
/// with the wrist's depth given by its scale.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelState {
    /// The wrist in the image, pixels.
    pub wrist: [f64; 2],
    /// Pixels per metre at the wrist.
    pub scale: f64,
    /// Hand frame to camera frame.
    pub rotation: UnitQuaternion<f64>,
    /// Free joint angles in the order of [`Domain::FREE`], radians.
    pub free: FreeAngles,
    /// How much more the thumb's MCP joint is bent than eq. (5) has it, radians. The paper's methods leave it 0.
    pub thumb_mcp: f64,
}

impl ModelState {
    /// The flat hand, all angles 0, its palm to the camera and its fingers up: the wrist in pixels, the scale in
    /// pixels per metre.
    pub fn facing(wrist: [f64; 2], scale: f64) -> Self {
        Self { wrist, scale, rotation: UnitQuaternion::identity(), free: [0.0; FREE_ANGLES], thumb_mcp: 0.0 }
    }

    /// The pose in the camera frame, metres: depth follows from the scale.
    pub fn to_pose(&self, side: Side, camera: &PinholeCamera) -> HandPose {
        let x = (self.wrist[0] - 0.5 * f64::from(camera.width)) / self.scale;
        let y = (0.5 * f64::from(camera.height) - self.wrist[1]) / self.scale;
        HandPose {
            side,
            translation: Vector3::new(x, y, -camera.focal / self.scale),
            rotation: self.rotation,
            angles: self.angles(),
        }
    }

    /// All joint angles, radians: the free ones and those that follow from them.
    pub fn angles(&self) -> JointAngles {
        let mut angles = Domain::expand(&self.free);
        angles[JointAngle::Thumb2Flexion.index()] += self.thumb_mcp;
        angles
    }

    /// The state that projects `pose`; angles that are not free, but for the thumb's MCP flexion, are dropped.
    pub fn from_pose(pose: &HandPose, camera: &PinholeCamera) -> Self {
        let scale = camera.focal / (-pose.translation.z).max(NEAREST_WRIST);
        Self {
            wrist: [
                0.5 * f64::from(camera.width) + scale * pose.translation.x,
                0.5 * f64::from(camera.height) - scale * pose.translation.y,
            ],
            scale,
            rotation: pose.rotation,
            ..Self::facing([0.0; 2], 1.0).with_angles(&pose.angles)
        }
    }

    /// The same hand with other joint angles, radians; those that are not free, but for the thumb's MCP flexion,
    /// are dropped.
    #[must_use]
    pub(super) fn with_angles(self, angles: &JointAngles) -> Self {
        let free = Domain::reduce(angles);
        let thumb_mcp =
            angles[JointAngle::Thumb2Flexion.index()] - thumb_mcp_from_cmc(free[Finger::Thumb.free_base()]);
        Self { free, thumb_mcp, ..self }
    }

    /// Brings the free angles inside `domain`, on the way to the feasible `inside`.
    pub(super) fn bring_inside(&mut self, domain: &Domain, inside: &FreeAngles) {
        let t = domain.clip_segment(inside, &self.free);
        for (v, from) in self.free.iter_mut().zip(inside) {
            *v = from + t * (*v - from);
        }
        let (tied, limits) =
            (thumb_mcp_from_cmc(self.free[Finger::Thumb.free_base()]), limits(JointAngle::Thumb2Flexion));
        self.thumb_mcp = (tied + self.thumb_mcp).clamp(limits.min, limits.max) - tied;
    }

    /// The state in an image of 1/`factor` of the size.
    #[must_use]
    pub fn reduced(&self, factor: f64) -> Self {
        Self { wrist: self.wrist.map(|v| v / factor), scale: self.scale / factor, ..self.clone() }
    }

    /// The rotation turned by a small rotation vector given in camera axes, radians.
    pub fn turned(&self, by: [f64; 3]) -> UnitQuaternion<f64> {
        UnitQuaternion::from_scaled_axis(Vector3::from(by)) * self.rotation
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_and_poses_convert_both_ways() {
        let camera = PinholeCamera::with_field_of_view(640, 360, 60.0);
        let state = ModelState {
            wrist: [400.0, 200.0],
            scale: 700.0,
            rotation: UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3),
            free: std::array::from_fn(|i| 0.01 * i as f64),
            thumb_mcp: 0.1,
        };
        let back = ModelState::from_pose(&state.to_pose(Side::Left, &camera), &camera);
        assert!((back.scale - state.scale).abs() < 1e-9);
        assert!((back.wrist[0] - 400.0).abs() < 1e-9 && (back.wrist[1] - 200.0).abs() < 1e-9);
        assert_eq!(back.free, state.free);
    }
}
