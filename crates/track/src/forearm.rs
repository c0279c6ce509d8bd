//! Where the silhouette was cut from the forearm.

use super::state::{HAND_LENGTH, ModelState};
use handcast_vision::Wrist;

/// Where the silhouette was cut from the forearm. The cut is never exactly at the wrist of the model, so
/// the model is continued by a piece of forearm and cut at the same line: where the line lies then
/// makes no difference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Forearm {
    /// A point of the cut, pixels.
    pub cut: [f64; 2],
    /// Unit vector from the forearm to the hand.
    pub axis: [f64; 2],
}

impl Forearm {
    /// The cut in an image of 1/`factor` of the size.
    #[must_use]
    pub fn reduced(&self, factor: u32) -> Self {
        Self { cut: self.cut.map(|v| v / f64::from(factor)), axis: self.axis }
    }

    /// Signed distance of a point to the cut, pixels: positive on the hand's side.
    pub fn side(&self, at: [f64; 2]) -> f64 {
        (at[0] - self.cut[0]) * self.axis[0] + (at[1] - self.cut[1]) * self.axis[1]
    }

    /// How far the model's wrist is from the cut towards the fingers, in hand lengths ([`HAND_LENGTH`]).
    pub fn behind(&self, state: &ModelState) -> f64 {
        self.side(state.wrist) / (HAND_LENGTH * state.scale)
    }
}

impl From<&Wrist> for Forearm {
    fn from(wrist: &Wrist) -> Self {
        Self { cut: wrist.centre, axis: wrist.axis }
    }
}
