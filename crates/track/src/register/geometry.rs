//! Small geometry that several parts of registration share.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{UnitQuaternion, Vector3};

/// Abduction of a finger whose base is bent by `flexion`, where that of the open hand is `open`, radians: eq. (3), a
/// finger at a right angle to the palm does not spread.
pub(super) fn spread(open: f64, flexion: f64) -> f64 {
    open * (1.0 - flexion / FRAC_PI_2).clamp(0.0, 1.0)
}

/// The part of a rotation that turns about the optical axis.
pub(super) fn in_plane(rotation: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    let turn = 2.0 * rotation.k.atan2(rotation.w);
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn)
}

/// The scalar product.
pub(super) fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}
