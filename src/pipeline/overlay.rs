//! A picture of what the tracker saw and what it made of it.

use image::{Rgb, RgbImage};

use super::TrackedFrame;
use crate::hand::{Finger, Joint};
use crate::track::ModelState;
use crate::vision::{Mask, draw_line, draw_outline};

const SILHOUETTE: Rgb<u8> = Rgb([0, 255, 60]);
const MODEL: Rgb<u8> = Rgb([255, 80, 40]);
const BONES: Rgb<u8> = Rgb([255, 235, 90]);
const LOST: Rgb<u8> = Rgb([160, 160, 160]);

/// The frame with the contour of the silhouette (green), the contour of the projected model (orange) and
/// its bones (yellow); where the hand is lost the last model in grey.
pub fn draw_overlay(frame: &mut TrackedFrame<'_>) -> RgbImage {
    let mut out = frame.image.clone();
    if let Ok(silhouette) = frame.silhouette {
        draw_outline(&mut out, &silhouette.hand, SILHOUETTE);
    }
    let state: &ModelState = &frame.tracked.state;
    let mut mask = Mask::new(out.width(), out.height());
    frame.model.draw(state, [0.0, 0.0], &mut mask);
    draw_outline(&mut out, &mask, if frame.tracked.valid { MODEL } else { LOST });
    let joints = frame.model.joints(state);
    let at = |j: Joint| (joints[j.index()][0], joints[j.index()][1]);
    for finger in Finger::ALL {
        let mut from = Joint::Wrist;
        for &joint in Joint::of(finger) {
            draw_line(&mut out, at(from), at(joint), if frame.tracked.valid { BONES } else { LOST });
            from = joint;
        }
    }
    out
}
