//! What several tests of registration begin with.

use super::super::state::ModelState;
use super::prior::OpenState;
use handcast_hand::{FREE_ANGLES, Finger};

/// An open hand, its fingers a little apart.
pub(super) fn open() -> OpenState {
    let mut free = [0.0; FREE_ANGLES];
    for (finger, degrees) in Finger::LONG.into_iter().zip([10.0f64, 0.0, 8.0, 18.0]) {
        free[finger.free_abduction()] = degrees.to_radians();
    }
    let state = ModelState { free, ..ModelState::facing([160.0, 210.0], 900.0) };
    OpenState { state, behind: None }
}
