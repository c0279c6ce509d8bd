//! Hand poses to BAP values and back: the only place that knows the standard's signs.
//!
//! Signs follow the drawings and ranges of the standard, as the notes beside the code have them; what had to be chosen
//! there is listed in `spec/NOTES.md`, "Signs".

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

use handcast_fba::bap::{Bap, BapFrame, BapMask, PER_RADIAN};
use handcast_hand::{HandPose, JointAngle, Side};

/// Units of a place BAP per metre: quarters of a millimetre.
const PER_METRE: f64 = 4e3;
/// Units of the place BAPs of streams of version 1 per metre.
const OLD_PER_METRE: f64 = 1e3;
/// Place units from one anchor to the next.
const ANCHOR_STEP: i32 = 2000;
/// Units of an anchor BAP for each step: more than the coarsest quantiser takes away by rounding both ways.
const ANCHOR_UNITS: i32 = 254;
/// Place units from an anchor at which the next one takes over.
const ANCHOR_HOLD: i32 = 1700;
/// Largest number of an anchor.
const LAST_ANCHOR: i32 = 6;
/// Turn from an anchor, radians, from which on the nearest one takes over: a rotation is 90 degrees from its nearest
/// anchor at most.
const TURN_HOLD: f64 = 170.0 / 180.0 * std::f64::consts::PI;
/// How far to each side, up or down, and from the camera a wrist can be, metres. One farther off is brought nearer along
/// its line of sight.
pub const REACH: f64 = 3.46;
/// Units of a rotation extension BAP per radian: tenths of a degree.
fn tenths_per_radian() -> f64 {
    10f64.to_degrees()
}

/// Where the position and rotation of a hand travel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Profile {
    /// Extension BAPs 209–218 (left) and 231–240 (right), all in the camera frame: x, y, z in quarters of a millimetre
    /// from an anchor, a rotation vector from another in tenths of a degree, then the numbers of the anchors. Streams of
    /// version 1 have 187–192 and 193–198 instead, in millimetres and without anchors.
    #[default]
    Hand,
    /// Wrist BAPs 42–47, for players that know only the standard's 186: rotation relative to an upright
    /// forearm whose palm faces the viewer. Translation is dropped.
    Arm,
}

/// BAPs with the numbers `first`, `first + stride` and so on.
#[expect(clippy::unwrap_used, reason = "only evaluated while compiling")]
const fn numbered<const N: usize>(first: u16, stride: u16) -> [Bap; N] {
    let mut baps = [Bap::from_index(0).unwrap(); N];
    let mut i = 0;
    while i < N {
        baps[i] = Bap::new(first + stride * i as u16).unwrap();
        i += 1;
    }
    baps
}

/// The BAPs of each side's joint angles, left and right, in the order of [`JointAngle::ALL`].
const ANGLE_BAPS: [[Bap; JointAngle::ALL.len()]; 2] = [numbered(123, 2), numbered(124, 2)];
/// The extension BAPs of each side.
const GLOBAL_BAPS: [[Bap; 6]; 2] = [numbered(209, 1), numbered(231, 1)];
/// The anchors of x, y, z and of the rotation.
const ANCHOR_BAPS: [[Bap; 4]; 2] = [numbered(215, 1), numbered(237, 1)];
/// The same without anchors in streams of version 1.
const OLD_GLOBAL_BAPS: [[Bap; 6]; 2] = [numbered(187, 1), numbered(193, 1)];
/// The wrist BAPs of each side.
const WRIST_BAPS: [[Bap; 3]; 2] = [numbered(42, 2), numbered(43, 2)];

/// The BAP of a joint angle.
pub fn angle_bap(side: Side, angle: JointAngle) -> Bap {
    ANGLE_BAPS[side as usize][angle.index()]
}

/// The joint angle of a hand BAP, if `bap` is one.
pub fn bap_angle(bap: Bap) -> Option<(Side, JointAngle)> {
    let offset = bap.index().checked_sub(122)?;
    let angle = *JointAngle::ALL.get(offset / 2)?;
    Some((if offset % 2 == 0 { Side::Left } else { Side::Right }, angle))
}

/// +1 or −1: the standard's sign of an angle that is positive in [`JointAngle`]'s sense.
pub fn angle_sign(side: Side, angle: JointAngle) -> f64 {
    use JointAngle::*;
    let right = match angle {
        // S4 (unknown), S5: mirrored; closing and leaving the palm plane are negative on the right.
        Thumb1Flexion | Thumb1Abduction => -1.0,
        // S2: positive towards the little finger on the right hand, towards the thumb on the left.
        Index1Abduction | Middle1Abduction => -1.0,
        Ring1Abduction | Pinky1Abduction => 1.0,
        // S3, S6: about the bone towards the tip, the same geometric axis on both sides.
        Thumb1Twisting | Index1Twisting | Middle1Twisting | Ring1Twisting | Pinky1Twisting => 1.0,
        // S0, S1: closing is negative on both hands.
        _ => return -1.0,
    };
    if side == Side::Right { right } else { -right }
}

/// The six global extension BAPs of a hand, in the order x, y, z, rotation vector.
pub fn global_baps(side: Side) -> [Bap; 6] {
    GLOBAL_BAPS[side as usize]
}

/// The anchors of x, y, z and of the rotation. Of the first three a BAP of 254 stands for half a metre from the middle.
pub fn anchor_baps(side: Side) -> [Bap; 4] {
    ANCHOR_BAPS[side as usize]
}

/// What [`global_baps`] were in streams of version 1: without anchors, in millimetres.
pub fn old_global_baps(side: Side) -> [Bap; 6] {
    OLD_GLOBAL_BAPS[side as usize]
}

/// The wrist BAPs of a hand: flexion, pivot, twisting.
pub fn wrist_baps(side: Side) -> [Bap; 3] {
    WRIST_BAPS[side as usize]
}

/// All BAPs that carry one hand: 29 angles, its global pose and anchors.
pub fn hand_mask(side: Side, profile: Profile) -> BapMask {
    let mut mask: BapMask = JointAngle::ALL.into_iter().map(|angle| angle_bap(side, angle)).collect();
    match profile {
        Profile::Hand => {
            global_baps(side).into_iter().chain(anchor_baps(side)).for_each(|bap| mask.insert(bap));
        }
        Profile::Arm => wrist_baps(side).into_iter().for_each(|bap| mask.insert(bap)),
    }
    mask
}

/// Rotation of a hand in the standard's neutral pose, where the arms hang and the palms face the body:
/// hand frame to the standard's frame (x to the character's left, y up, z to the front), which for a
/// character that faces the viewer is the camera frame.
pub fn standard_neutral(side: Side) -> UnitQuaternion<f64> {
    // Thumb to the front, fingertips down, palm of the right hand to the character's left.
    let right = Matrix3::from_columns(&[Vector3::z(), -Vector3::y(), Vector3::x()]);
    let rotation = UnitQuaternion::from_matrix(&right);
    match side {
        Side::Right => rotation,
        Side::Left => HandPose { rotation, ..HandPose::neutral(Side::Right) }.mirrored().rotation,
    }
}

/// Turns poses into BAP frames. It remembers the anchors and the last wrist angles of each hand, so that what places it
/// runs on without jumps, which P planes could not follow.
#[derive(Clone, Debug, Default)]
pub struct PoseMapper {
    profile: Profile,
    previous: [Option<Vector3<f64>>; 2],
    /// Anchors of the place of each hand, and of its rotation.
    anchors: [Option<[i32; 3]>; 2],
    turns: [Option<usize>; 2],
}

impl PoseMapper {
    /// A mapper that has seen nothing yet.
    pub fn new(profile: Profile) -> Self {
        Self { profile, previous: [None; 2], anchors: [None; 2], turns: [None; 2] }
    }

    /// One frame with all BAPs of each hand in `poses`. Numbers that are not finite become 0; magnitudes
    /// beyond the 32-bit range are clamped, wrists beyond [`REACH`] brought nearer.
    ///
    /// ```
    /// use handcast_fba::bap::Bap;
    /// use handcast_codec::mapping::{PoseMapper, Profile, pose_from_frame};
    /// use handcast_hand::{HandPose, JointAngle, Side};
    ///
    /// let pose = HandPose::neutral(Side::Right).with_degrees(JointAngle::Index2Flexion, 90.0);
    /// let frame = PoseMapper::new(Profile::Hand).frame(&[pose]);
    /// let bap = Bap::from_name("r_index2_flexion").unwrap();
    /// assert_eq!(frame.get(bap), Some(-157_080));
    /// let back = pose_from_frame(&frame, Side::Right, Profile::Hand).unwrap();
    /// assert!((back.angle(JointAngle::Index2Flexion).to_degrees() - 90.0).abs() < 1e-3);
    /// ```
    pub fn frame(&mut self, poses: &[HandPose]) -> BapFrame {
        let mut frame = BapFrame::EMPTY;
        for pose in poses {
            for angle in JointAngle::ALL {
                let value = angle_sign(pose.side, angle) * pose.angle(angle) * PER_RADIAN;
                frame.set(angle_bap(pose.side, angle), value.round() as i32);
            }
            let previous = &mut self.previous[pose.side as usize];
            let mut set = |bap: Bap, value: f64| frame.set(bap, value.round() as i32);
            match self.profile {
                Profile::Hand => {
                    let turn =
                        self.turns[pose.side as usize].get_or_insert_with(|| nearest_turn(&pose.rotation));
                    if anchored(&pose.rotation, *turn).norm() > TURN_HOLD {
                        *turn = nearest_turn(&pose.rotation);
                    }
                    let [a, b, c] = (anchored(&pose.rotation, *turn) * tenths_per_radian()).into();
                    let place: [f64; 3] = (within_reach(&pose.translation) * PER_METRE).into();
                    let anchors = self.anchors[pose.side as usize].get_or_insert(place.map(nearest_anchor));
                    let mut fine = place;
                    for (fine, anchor) in fine.iter_mut().zip(anchors.iter_mut()) {
                        if (*fine - f64::from(*anchor * ANCHOR_STEP)).abs() > f64::from(ANCHOR_HOLD) {
                            *anchor = nearest_anchor(*fine);
                        }
                        *fine -= f64::from(*anchor * ANCHOR_STEP);
                    }
                    let [x, y, z] = fine;
                    let values: [f64; 6] = [x, y, z, a, b, c];
                    global_baps(pose.side).into_iter().zip(values).for_each(|(bap, value)| set(bap, value));
                    let numbers = anchors.iter().copied().chain([turn_number(*turn)]).map(f64::from);
                    anchor_baps(pose.side)
                        .into_iter()
                        .zip(numbers)
                        .for_each(|(bap, anchor)| set(bap, anchor * f64::from(ANCHOR_UNITS)));
                }
                Profile::Arm => {
                    let angles = continued_wrist_angles(pose, *previous);
                    *previous = Some(angles);
                    let values: [f64; 3] = (angles * PER_RADIAN).into();
                    wrist_baps(pose.side).into_iter().zip(values).for_each(|(bap, value)| set(bap, value));
                }
            }
        }
        frame
    }
}

/// The number of the anchor nearest to a coordinate in place units.
fn nearest_anchor(place: f64) -> i32 {
    ((place / f64::from(ANCHOR_STEP)).round() as i32).clamp(-LAST_ANCHOR, LAST_ANCHOR)
}

/// The place of a wrist, metres, or the nearest to it on its line of sight that can be sent.
fn within_reach(place: &Vector3<f64>) -> Vector3<f64> {
    let farthest = place.amax();
    if farthest > REACH { place * (REACH / farthest) } else { *place }
}

/// The pose of one hand in a frame; BAPs that are not given count as 0. `None` when the frame gives
/// nothing of that hand: see [`sides`].
pub fn pose_from_frame(frame: &BapFrame, side: Side, profile: Profile) -> Option<HandPose> {
    pose_of_given(frame, &frame.mask, side, profile)
}

/// The same where the frame gives those in `mask`.
pub(crate) fn pose_of_given(
    frame: &BapFrame,
    mask: &BapMask,
    side: Side,
    profile: Profile,
) -> Option<HandPose> {
    let new = is_new(mask, side);
    if !new && !has_angles(mask, side) {
        return None;
    }
    let mut pose = HandPose::neutral(side);
    let get = |bap: Bap| if mask.contains(bap) { f64::from(frame.value(bap)) } else { 0.0 };
    for angle in JointAngle::ALL {
        pose.set(angle, angle_sign(side, angle) * get(angle_bap(side, angle)) / PER_RADIAN);
    }
    match profile {
        Profile::Hand => {
            let (place, [a, b, c], turn) = if new {
                let [x, y, z, a, b, c] = global_baps(side).map(get);
                let number = |bap: Bap| (get(bap) / f64::from(ANCHOR_UNITS)).round();
                let [along, up, off, turn] = anchor_baps(side).map(number);
                let place = Vector3::new(x, y, z) + Vector3::new(along, up, off) * f64::from(ANCHOR_STEP);
                (place / PER_METRE, [a, b, c], turn_of_number(turn as i32))
            } else {
                let [x, y, z, a, b, c] = old_global_baps(side).map(get);
                (Vector3::new(x, y, z) / OLD_PER_METRE, [a, b, c], 0)
            };
            pose.translation = place;
            pose.rotation =
                UnitQuaternion::new(Vector3::new(a, b, c) / tenths_per_radian()) * turn_anchor(turn);
        }
        Profile::Arm => {
            let angles = Vector3::from(wrist_baps(side).map(get)) / PER_RADIAN;
            pose.rotation = wrist_rotation(side, &angles);
        }
    }
    Some(pose)
}

/// Whether a frame gives position and rotation of a hand with anchors.
fn is_new(mask: &BapMask, side: Side) -> bool {
    global_baps(side).into_iter().chain(anchor_baps(side)).any(|bap| mask.contains(bap))
}

/// Whether a frame gives joint angles of a hand.
fn has_angles(mask: &BapMask, side: Side) -> bool {
    ANGLE_BAPS[side as usize].into_iter().any(|bap| mask.contains(bap))
}

/// The sides of which a frame gives at least one joint angle, or position or rotation with anchors, which nothing else has: the
/// fingers of a hand may be at rest throughout.
pub fn sides(mask: &BapMask) -> impl Iterator<Item = Side> {
    let mask = *mask;
    [Side::Left, Side::Right].into_iter().filter(move |&side| is_new(&mask, side) || has_angles(&mask, side))
}

/// How many rotations are anchors.
const TURNS: usize = 12;

/// An anchor of rotations: of the rotations of a tetrahedron none, the half turns about x, y and z, then the third turns
/// about the diagonals of space.
fn turn_anchor(turn: usize) -> UnitQuaternion<f64> {
    let sign = |bit: usize| if (turn - 4) >> bit & 1 == 0 { 0.5 } else { -0.5 };
    let [w, x, y, z] = match turn {
        0 => [1.0, 0.0, 0.0, 0.0],
        1 => [0.0, 1.0, 0.0, 0.0],
        2 => [0.0, 0.0, 1.0, 0.0],
        3 => [0.0, 0.0, 0.0, 1.0],
        _ => [0.5, sign(0), sign(1), sign(2)],
    };
    UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z))
}

/// The anchor nearest to a rotation.
fn nearest_turn(rotation: &UnitQuaternion<f64>) -> usize {
    let near = |turn: &usize| turn_anchor(*turn).coords.dot(&rotation.coords).abs();
    (0..TURNS).max_by(|a, b| near(a).total_cmp(&near(b))).unwrap_or(0)
}

/// A rotation as a rotation vector from an anchor, radians.
fn anchored(rotation: &UnitQuaternion<f64>, turn: usize) -> Vector3<f64> {
    (rotation * turn_anchor(turn).inverse()).scaled_axis()
}

/// The number an anchor is sent as: from 0 to 7, then from −1 to −4, since a BAP has room for those.
fn turn_number(turn: usize) -> i32 {
    if turn < 8 { turn as i32 } else { 7 - turn as i32 }
}

/// The anchor of a number; none for one that is not sent.
fn turn_of_number(number: i32) -> usize {
    match number {
        0..=7 => number as usize,
        -4..=-1 => (7 - number) as usize,
        _ => 0,
    }
}

/// Angle of the wrist beyond which it is counted from the other side, radians: an I value reaches 4.76.
const MOST_TURNED: f64 = 4.5;

/// Wrist flexion, pivot and twisting, radians with the standard's signs, nearest to `previous`, within [`MOST_TURNED`].
///
/// The chain is twist, bend, pivot, hand; in the hand frame of a right hand their normals
/// are +Y, −X and −Z (carried over by [`standard_neutral`]). A left hand is taken as the
/// mirror image.
fn continued_wrist_angles(pose: &HandPose, previous: Option<Vector3<f64>>) -> Vector3<f64> {
    let rotation = match pose.side {
        Side::Right => pose.rotation,
        Side::Left => pose.mirrored().rotation,
    };
    let m = rotation.to_rotation_matrix().into_inner();
    let bend = (-m[(1, 2)]).clamp(-1.0, 1.0).asin();
    let twist = m[(0, 2)].atan2(m[(2, 2)]);
    let pivot = m[(1, 0)].atan2(m[(1, 1)]);
    let turn = std::f64::consts::PI;
    let first = Vector3::new(-bend, -pivot, twist);
    let second = Vector3::new(bend - turn, -pivot - turn, twist + turn);
    let Some(previous) = previous else { return first };
    let near = |angles: Vector3<f64>| {
        angles.zip_map(&previous, |angle, before| {
            angle - ((angle - before) / std::f64::consts::TAU).round() * std::f64::consts::TAU
        })
    };
    let [first, second] = [near(first), near(second)];
    let nearer = if (first - previous).norm() <= (second - previous).norm() { first } else { second };
    nearer.map(
        |angle| {
            if angle.abs() > MOST_TURNED { angle - angle.signum() * std::f64::consts::TAU } else { angle }
        },
    )
}

fn wrist_rotation(side: Side, angles: &Vector3<f64>) -> UnitQuaternion<f64> {
    let about = |axis: Vector3<f64>, angle: f64| UnitQuaternion::new(axis * angle);
    let rotation =
        about(Vector3::y(), angles.z) * about(-Vector3::x(), angles.x) * about(-Vector3::z(), angles.y);
    match side {
        Side::Right => rotation,
        Side::Left => HandPose { rotation, ..HandPose::neutral(Side::Right) }.mirrored().rotation,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn angle_baps_have_the_angles_names() {
        for side in [Side::Left, Side::Right] {
            for angle in JointAngle::ALL {
                let bap = angle_bap(side, angle);
                let letter = if side == Side::Left { "l_" } else { "r_" };
                let expected = format!("{letter}{}", angle.name().replace("abduction", "pivot"));
                assert_eq!(bap.info().unwrap().name, expected);
                assert_eq!(bap_angle(bap), Some((side, angle)));
            }
        }
        assert_eq!(bap_angle(Bap::new(122).unwrap()), None);
        assert_eq!(bap_angle(Bap::new(181).unwrap()), None);
    }

    /// The standard's default ranges are wider on the side to which a joint moves further.
    #[test]
    fn signs_agree_with_the_asymmetry_of_the_ranges() {
        for side in [Side::Left, Side::Right] {
            for angle in JointAngle::ALL {
                let [min, max] = angle_bap(side, angle).intra_limits();
                // The left row of the thumb roll is probably a misprint (S6).
                let twist = angle.name().ends_with("twisting");
                if min + max != 0 && !twist {
                    assert_eq!(angle_sign(side, angle) > 0.0, max > -min, "{side:?} {angle:?}");
                }
            }
        }
    }

    #[test]
    fn neutral_rotation_points_the_fingers_down() {
        for (side, palm) in [(Side::Right, 1.0), (Side::Left, -1.0)] {
            let rotation = standard_neutral(side);
            assert!((rotation * Vector3::y() + Vector3::y()).norm() < 1e-12);
            assert!((rotation * Vector3::z() - Vector3::x() * palm).norm() < 1e-12);
        }
    }

    /// Turned nearly all the way round, it jumps where the anchor of its rotation changes: twice.
    #[test]
    fn a_turning_hand_makes_no_jumps_but_with_its_anchor() {
        let anchor = anchor_baps(Side::Right)[3];
        for profile in [Profile::Hand, Profile::Arm] {
            let mut mapper = PoseMapper::new(profile);
            let mut before: Option<BapFrame> = None;
            let mut changes = 0;
            for step in 0..=200 {
                let mut pose = HandPose::neutral(Side::Right);
                let angle = f64::from(step - 100) * 0.031;
                pose.rotation = UnitQuaternion::new(Vector3::y() * angle);
                let frame = mapper.frame(&[pose]);
                let changed = before.filter(|before| before.get(anchor) != frame.get(anchor)).is_some();
                changes += usize::from(changed);
                if let Some(before) = before.filter(|_| !changed) {
                    for (bap, value) in frame.iter() {
                        let step = (value - before.value(bap)).abs();
                        assert!(step <= if profile == Profile::Hand { 20 } else { 3200 }, "{bap} {step}");
                    }
                }
                before = Some(frame);
            }
            assert_eq!(changes, if profile == Profile::Hand { 2 } else { 0 });
        }
    }

    #[test]
    fn a_wrist_out_of_reach_is_brought_nearer_along_its_line_of_sight() {
        for (place, sent) in
            [([0.4, 0.1, -1.8], [0.4, 0.1, -1.8]), ([0.5, -0.25, -6.92], [0.25, -0.125, -3.46])]
        {
            let pose = HandPose { translation: Vector3::from(place), ..HandPose::neutral(Side::Left) };
            let frame = PoseMapper::new(Profile::Hand).frame(&[pose]);
            let back = pose_from_frame(&frame, Side::Left, Profile::Hand).unwrap();
            assert!((back.translation - Vector3::from(sent)).amax() < 1e-9, "{:?}", back.translation);
        }
    }

    /// Anchors change seldom, and whatever a quantiser makes of them they stand for the same place.
    #[test]
    fn anchors_are_told_apart_at_any_quantiser() {
        let mut mapper = PoseMapper::new(Profile::Hand);
        let mut changes = 0;
        let mut before = None;
        for step in 0..400 {
            let x = 3.4 * (f64::from(step) * 0.05).sin();
            let pose = HandPose { translation: Vector3::new(x, 0.1, -x), ..HandPose::neutral(Side::Left) };
            let frame = mapper.frame(&[pose]);
            let anchors = anchor_baps(Side::Left).map(|bap| frame.value(bap));
            changes += usize::from(before.replace(anchors).is_some_and(|before| before != anchors));
            assert!(global_baps(Side::Left).into_iter().all(|bap| frame.value(bap).abs() <= 1860));
            for scale in [1, 14, 31, 113, 127] {
                let mut coarse = frame;
                for bap in anchor_baps(Side::Left) {
                    let level = (f64::from(frame.value(bap)) / f64::from(scale)).round();
                    coarse.set(bap, level as i32 * scale);
                    assert!(coarse.value(bap).abs() <= 1860);
                }
                let back = pose_from_frame(&coarse, Side::Left, Profile::Hand).unwrap();
                assert!((back.translation - Vector3::new(x, 0.1, -x)).amax() < 2e-4, "{step} {scale}");
            }
        }
        assert!(changes > 20 && changes < 120, "{changes}");
    }

    /// Streams of version 1 give millimetres in other BAPs.
    #[test]
    fn places_of_version_1_are_read() {
        let values = [-100, 20, -600, 0, 0, 900];
        let given = old_global_baps(Side::Right).into_iter().zip(values);
        let frame: BapFrame = given.chain([(Bap::new(124).unwrap(), 5)]).collect();
        let pose = pose_from_frame(&frame, Side::Right, Profile::Hand).unwrap();
        assert!((pose.translation - Vector3::new(-0.1, 0.02, -0.6)).norm() < 1e-12);
        assert!((pose.rotation.scaled_axis() - Vector3::z() * std::f64::consts::FRAC_PI_2).norm() < 1e-9);
    }

    /// A hand keeps the anchor of its rotation from wherever it starts for more than a quarter turn each way.
    #[test]
    fn a_hand_that_wavers_makes_no_jumps() {
        let diagonal = Vector3::new(0.3, 0.1, 0.9).normalize();
        for axis in [Vector3::z(), Vector3::y(), diagonal] {
            for start in (0..360).step_by(15) {
                let mut mapper = PoseMapper::new(Profile::Hand);
                let frame = |step: i32| {
                    let degrees = f64::from(start) + 59.0 * (f64::from(step) / 5.0).sin();
                    let rotation = UnitQuaternion::new(axis * degrees.to_radians());
                    mapper.frame(&[HandPose { rotation, ..HandPose::neutral(Side::Right) }])
                };
                let frames: Vec<BapFrame> = (0..40).map(frame).collect();
                for pair in frames.windows(2) {
                    let off = pair[1].iter().map(|(bap, value)| (value - pair[0].value(bap)).abs()).max();
                    assert!(off < Some(250), "{axis} from {start}: {off:?}");
                }
            }
        }
    }

    #[test]
    fn anchors_of_rotations_are_told_by_their_numbers_and_near_everywhere() {
        for turn in 0..TURNS {
            assert_eq!(turn_of_number(turn_number(turn)), turn);
            assert_eq!(nearest_turn(&turn_anchor(turn)), turn);
            assert!(turn_number(turn).abs() * ANCHOR_UNITS <= 1860 - 63);
        }
        let mut farthest: f64 = 0.0;
        for step in 0..20_000 {
            let [a, b, c] = [1.0, 2f64.sqrt(), 3f64.sqrt()].map(|slope| f64::from(step) * slope);
            let rotation = UnitQuaternion::from_euler_angles(a, b, c);
            farthest = farthest.max(anchored(&rotation, nearest_turn(&rotation)).norm().to_degrees());
        }
        assert!((80.0..=90.0 + 1e-6).contains(&farthest), "{farthest}");
    }

    proptest! {
        #[test]
        fn poses_come_back(
            angles in prop::array::uniform29(-2.0f64..2.0),
            position in prop::array::uniform3(-1.5f64..1.5),
            turns in prop::collection::vec(prop::array::uniform3(-3.0f64..3.0), 1..5),
            left: bool,
            arm: bool,
        ) {
            let side = if left { Side::Left } else { Side::Right };
            let profile = if arm { Profile::Arm } else { Profile::Hand };
            let mut mapper = PoseMapper::new(profile);
            for turn in turns {
                let mut pose = HandPose::neutral(side);
                pose.angles = angles;
                pose.translation = position.into();
                pose.rotation = UnitQuaternion::new(Vector3::from(turn));
                let frame = mapper.frame(std::slice::from_ref(&pose));
                prop_assert_eq!(frame.mask, hand_mask(side, profile));
                prop_assert_eq!(sides(&frame.mask).collect::<Vec<_>>(), vec![side]);
                let back = pose_from_frame(&frame, side, profile).unwrap();
                prop_assert!(back.rotation.angle_to(&pose.rotation) < 2e-3);
                for angle in JointAngle::ALL {
                    prop_assert!((back.angle(angle) - pose.angle(angle)).abs() <= 0.51e-5);
                }
                if profile == Profile::Hand {
                    prop_assert!((back.translation - pose.translation).amax() <= 0.126e-3);
                }
            }
        }
    }
}
