//! Pictures of what was seen in a frame and what was made of it.

use image::{DynamicImage, Rgb, RgbImage};

use handcast_hand::{Absence, Finger, Joint, Side};
use handcast_picture::{draw_label, draw_label_on, draw_line, draw_stroke};
use handcast_track::pipeline::{Stages, StillFit, TrackedFrame};
use handcast_track::{HandModel, ModelState};
use handcast_vision::{
    Contour, ContourTuning, HandParts, InertiaAxis, Mask, Silhouette, TopHat, draw_outline,
};

const SILHOUETTE: Rgb<u8> = Rgb([0, 255, 60]);
const MODEL: Rgb<u8> = Rgb([255, 80, 40]);
const BONES: Rgb<u8> = Rgb([255, 235, 90]);
const GREY: Rgb<u8> = Rgb([160, 160, 160]);
const BLACK: Rgb<u8> = Rgb([0, 0, 0]);
const WHITE: Rgb<u8> = Rgb([255, 255, 255]);
const GOOD: Rgb<u8> = Rgb([0, 220, 60]);
const DOUBTFUL: Rgb<u8> = Rgb([255, 150, 0]);
const LOST_HAND: Rgb<u8> = Rgb([255, 30, 30]);
const TOUCHING: Rgb<u8> = Rgb([255, 60, 220]);
const AXES: Rgb<u8> = Rgb([80, 160, 255]);
/// Thumb to little finger; of residues the largest to the fifth.
const FINGERS: [Rgb<u8>; 5] =
    [Rgb([255, 60, 60]), Rgb([255, 200, 0]), Rgb([60, 255, 60]), Rgb([0, 200, 255]), Rgb([220, 90, 255])];

/// Confidence from which a hand is drawn as well tracked.
pub const GOOD_CONFIDENCE: f64 = 0.5;

/// The frame with the contours of the silhouettes (white; parts that are no hand grey) and of each hand's model
/// with its bones, coloured by how far it can be trusted: green where its confidence is at least
/// [`GOOD_CONFIDENCE`], orange below, red where the hand is lost (its last pose), pink where it touches the other
/// (held). At the wrist stand `L` or `R` and the confidence, or in its place what the colour says: `R 0.32 doubtful`,
/// `R lost`, `R touching`.
pub fn draw_overlay(frame: &mut TrackedFrame<'_>) -> RgbImage {
    let mut out = frame.image.clone();
    for part in frame.parts.unwrap_or(&[]) {
        let own = |s: &&Silhouette| std::ptr::eq(*s, part);
        let hand = frame.hands.iter().any(|h| h.silhouette.as_ref().is_some_and(own));
        let (mask, colour) = if hand { (&part.hand, WHITE) } else { (&part.arm, GREY) };
        stroke_outline(&mut out, mask, 0.8 * line_width(frame.image), colour);
    }
    let mut labels = Vec::new();
    for hand in &mut frame.hands {
        let found = hand.found;
        let Some((colour, words)) = shown(found.absent, found.confidence) else { continue };
        let state = ModelState::from_pose(&found.pose, &hand.start.camera);
        draw_model(&mut out, hand.model, &state, colour, colour);
        let name = if hand.start.side == Side::Left { 'L' } else { 'R' };
        labels.push((format!("{name} {words}"), state.wrist, colour));
    }
    let (width, height) = out.dimensions();
    let scale = (width.max(height) / 200).clamp(2, 8);
    for (text, [x, y], colour) in labels {
        let size = (text.len() as u32 * 4 * scale, 5 * scale);
        let corner = |v: f64, size: u32, limit: u32| (v.max(0.0) as u32).min(limit.saturating_sub(size + 2));
        let (x, y) = (corner(x + 12.0, size.0, width), corner(y + 8.0, size.1, height));
        draw_label_on(&mut out, &text, [x, y], scale, [colour, BLACK]);
    }
    out
}

/// Colour of a hand, and the words at its wrist, which tell the same to those who see colours otherwise; `None` of one of which
/// nothing is known yet.
fn shown(absent: Option<Absence>, confidence: f64) -> Option<(Rgb<u8>, String)> {
    Some(match absent {
        Some(Absence::NotYet) => return None,
        Some(Absence::Touching) => (TOUCHING, "touching".into()),
        Some(Absence::Lost | Absence::Bridged) => (LOST_HAND, "lost".into()),
        None if confidence < GOOD_CONFIDENCE => (DOUBTFUL, format!("{confidence:.2} doubtful")),
        None => (GOOD, format!("{confidence:.2}")),
    })
}

/// Width of lines, pixels: two to three in pictures of usual sizes.
fn line_width(picture: &RgbImage) -> f64 {
    (f64::from(picture.width().max(picture.height())) / 256.0).clamp(2.0, 6.0)
}

/// The boundary of a mask as smooth lines.
fn stroke_outline(out: &mut RgbImage, mask: &Mask, width: f64, colour: Rgb<u8>) {
    let mut contour = Contour::new(ContourTuning::default());
    contour.trace(mask);
    for curve in contour.curves() {
        let mut points: Vec<[f64; 2]> = curve.iter().map(|point| point.position.map(f64::from)).collect();
        points.extend(points.first().copied());
        draw_stroke(out, &points, width, colour);
    }
}

fn draw_model(
    out: &mut RgbImage,
    model: &mut HandModel,
    state: &ModelState,
    outline: Rgb<u8>,
    bones: Rgb<u8>,
) {
    let mut mask = Mask::new(out.width(), out.height());
    model.draw(state, [0.0, 0.0], &mut mask);
    let width = line_width(out);
    stroke_outline(out, &mask, width, outline);
    let joints = model.joints(state);
    let at = |j: Joint| [joints[j.index()][0], joints[j.index()][1]];
    for finger in Finger::ALL {
        let mut from = Joint::Wrist;
        for &joint in Joint::of(finger) {
            draw_stroke(out, &[at(from), at(joint)], width, bones);
            from = joint;
        }
    }
}

/// A picture for each stage of a fit, as far as it came, with a file name that sorts in their order; `fit.png`
/// shows silhouette, parts, axes and the outline of the fitted model together.
pub fn draw_stages(stages: &Stages) -> Vec<(&'static str, RgbImage)> {
    let mut pictures = Vec::new();
    if let Some(likelihood) = &stages.likelihood {
        pictures.push(("1-skin-likelihood.png", DynamicImage::ImageLuma8(likelihood.clone()).to_rgb8()));
    }
    if let Some(raw) = &stages.raw {
        pictures.push(("2-raw-mask.png", white_on_black(raw)));
    }
    let Some(silhouette) = &stages.silhouette else { return pictures };
    pictures.push(("3-clean-mask.png", white_on_black(&silhouette.arm)));
    pictures.push(("4-forearm-cut.png", silhouette.overlay(&stages.image)));
    if let Some(top_hat) = &stages.top_hat {
        pictures.push(("5-finger-residues.png", draw_residues(&silhouette.hand, top_hat)));
    }
    let Some(parts) = &stages.parts else { return pictures };
    let mut picture = stages.image.clone();
    draw_parts(&mut picture, parts);
    pictures.push(("6-parts.png", picture));
    let Some(found) = &stages.fit else { return pictures };
    let mut picture = stages.image.clone();
    draw_fit(&mut picture, found);
    pictures.push(("7-model.png", picture));
    let mut picture = stages.image.clone();
    draw_outline(&mut picture, &silhouette.hand, SILHOUETTE);
    draw_parts(&mut picture, parts);
    draw_fit(&mut picture, found);
    pictures.push(("fit.png", picture));
    pictures
}

fn draw_fit(out: &mut RgbImage, found: &StillFit) {
    let mut model = HandModel::new(&found.fit.morphology, found.fit.side).with_camera(found.camera);
    draw_model(out, &mut model, &found.fit.state, MODEL, BONES);
}

fn white_on_black(mask: &Mask) -> RgbImage {
    DynamicImage::ImageLuma8(mask.to_gray()).to_rgb8()
}

/// The residues of the top-hat numbered by size: in colour those taken for fingers, in grey the others.
fn draw_residues(hand: &Mask, top_hat: &TopHat) -> RgbImage {
    let mut out = white_on_black(hand);
    let mut colours = FINGERS.into_iter();
    for residue in &top_hat.residues {
        let colour = residue.finger.and_then(|_| colours.next()).unwrap_or(GREY);
        for (x, y) in residue.mask.pixels() {
            out.put_pixel(x, y, colour);
        }
    }
    for (number, residue) in top_hat.residues.iter().enumerate() {
        if let Some([x, y]) = residue.mask.centroid() {
            let corner = |v: f64, half: u32| (v as u32).saturating_sub(half);
            draw_label(&mut out, &(number + 1).to_string(), corner(x, 5), corner(y, 7), 2, BLACK);
        }
    }
    out
}

/// The palm's outline, axes, bases and tips of the fingers, the inertia axes of hand and four fingers to
/// where they cross (blue), the wrist and the palm's axis (pink).
fn draw_parts(out: &mut RgbImage, parts: &HandParts) {
    const WRIST: Rgb<u8> = Rgb([255, 0, 200]);
    draw_outline(out, &parts.palm, Rgb([255, 255, 255]));
    let along = |p: [f64; 2], d: [f64; 2], s: f64| [p[0] + d[0] * s, p[1] + d[1] * s];
    let InertiaAxis { centroid, direction: axis } = parts.inertia;
    let reach = 1.2 * (centroid[0] - parts.wrist[0]).hypot(centroid[1] - parts.wrist[1]);
    draw_line(out, along(centroid, axis, -reach), along(centroid, axis, reach), AXES);
    for finger in &parts.fingers[1..] {
        let [dx, dy] = [0, 1].map(|i| finger.base[i] - parts.wrist_by_axes[i]);
        let back = dx.hypot(dy);
        draw_line(out, along(finger.base, finger.axis, -back), finger.base, AXES);
    }
    for (finger, colour) in parts.fingers.iter().zip(FINGERS) {
        draw_line(out, finger.base, finger.tip, colour);
        for end in [finger.base, finger.tip] {
            let across = [-finger.axis[1], finger.axis[0]];
            draw_line(out, along(end, across, -finger.radius), along(end, across, finger.radius), colour);
        }
    }
    draw_line(out, parts.wrist, along(parts.wrist, parts.axis, parts.palm_length), WRIST);
    for (p, colour) in [(parts.wrist, WRIST), (parts.wrist_by_axes, AXES)] {
        draw_line(out, [p[0] - 4.0, p[1]], [p[0] + 4.0, p[1]], colour);
        draw_line(out, [p[0], p[1] - 4.0], [p[0], p[1] + 4.0], colour);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_tell_what_colours_do() {
        let words = |absent, confidence| shown(absent, confidence).map(|(_, words)| words);
        assert_eq!(words(None, 0.81).as_deref(), Some("0.81"));
        assert_eq!(words(None, 0.32).as_deref(), Some("0.32 doubtful"));
        assert_eq!(words(Some(Absence::Lost), 0.0).as_deref(), Some("lost"));
        assert_eq!(words(Some(Absence::Touching), 0.0).as_deref(), Some("touching"));
        assert_eq!(words(Some(Absence::NotYet), 0.0), None);
    }
}
