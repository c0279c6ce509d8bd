//! MANO: joint rotations of its hand, and the 21 joints of programs that find it (HaMeR, WiLoR), as JSON or `.npz`; joints alone
//! as `.npy`.
//!
//! ```text
//! {"is_right":1,"global_orient":[x,y,z],"hand_pose":[45 × radians],"transl":[x,y,z],"fps":30}
//! [{"is_right":0,"wilor_preds":{"pred_keypoints_3d":[[[x,y,z] × 21]],"pred_cam_t_full":[[x,y,z]]}},…]
//! np.savez("hand.npz", hand_pose=…T×45…, global_orient=…T×3…, transl=…T×3…, side="right", fps=30)
//! np.save("hand.npy", …T×21×3, of two hands T×2×21×3…)
//! ```
//!
//! Names, orders and axes are in `spec/landmarks.md`. Joints are read where there are any; else forward kinematics makes
//! joints of the rotations, on a hand of mean sizes whose bones lie as those of MANO's flat hand do (`REST`): no file of
//! MANO is needed. Read only.

use std::fmt::{self, Formatter};
use std::slice::ChunksExact;

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use super::npz::{self, Array};
use super::{
    Axes, LandmarkClip, LandmarkFrame, RATE, Sided, check_size, place, read_document, seconds_of_times,
};
use crate::import::MEAN_HAND_LENGTH;
use crate::motion::format::names_any;
use crate::motion::{Content, ContentError, Format};
use handcast_hand::landmarks::{JointPoints, tell_side};
use handcast_hand::{Finger, Morphology, Side};
use handcast_limits::Limits;

mod tree;

use tree::{Fields, Found, Name};

/// Its rows: as JSON, as arrays of NumPy, and joints as an array.
pub(crate) static FORMAT: Format = Format {
    id: "mano",
    name: "joint rotations or joints (MANO, HaMeR, WiLoR)",
    kind: "landmarks",
    ending: ".json",
    hands: 2,
    sniff: |bytes| names_any(bytes, &NAMES),
    read: |bytes, limits| read_document(&FORMAT, parse, bytes, limits),
    write: None,
};
pub(crate) static NPZ: Format = Format {
    id: "npz",
    name: "joint rotations or joints (MANO, HaMeR, WiLoR) as arrays of NumPy",
    kind: "landmarks",
    ending: ".npz",
    hands: 2,
    sniff: npz::sniff,
    read: |bytes, limits| {
        let clips = parse_npz(bytes, limits);
        Ok(Content::Joints(clips.map_err(|what| ContentError::Foreign { format: NPZ.id, what })?))
    },
    write: None,
};

pub(crate) static NPY: Format = Format {
    id: "npy",
    name: "joints as an array of NumPy",
    kind: "landmarks",
    ending: ".npy",
    hands: 2,
    sniff: npz::is_array,
    read: |bytes, limits| {
        let clips = parse_npy(bytes, limits);
        Ok(Content::Joints(clips.map_err(|what| ContentError::Foreign { format: NPY.id, what })?))
    },
    write: None,
};

/// Names one of which such JSON has early.
const NAMES: [&str; 17] = [
    "hand_pose",
    "handPose",
    "left_hand_pose",
    "right_hand_pose",
    "mano_pose",
    "mano_params",
    "pred_mano_params",
    "global_orient",
    "wilor_preds",
    "pred_keypoints_3d",
    "keypoints_3d",
    "joints_3d",
    "joints3d",
    "handJoints3D",
    "pred_cam_t_full",
    "pose_hand",
    "mano",
];
/// Joints that MANO turns, three a finger, and its fingers in its order.
const TURNS: usize = 15;
const FINGERS: [Finger; 5] = [Finger::Index, Finger::Middle, Finger::Pinky, Finger::Ring, Finger::Thumb];
/// Where the joints of the usual order stand among MANO's: 16 joints, then the tips from the thumb on.
const FROM_MANO: [usize; 21] = [0, 13, 14, 15, 16, 1, 2, 3, 17, 4, 5, 6, 18, 10, 11, 12, 19, 7, 8, 9, 20];
/// Directions of the first and the second bone of each finger, thumb first, in MANO's flat hand, degrees: how far from the
/// direction of the fingers (−x of a right hand) to the thumb's side (+z), and how far to the back of the hand (+y). The
/// end bone goes on as the second. Rounded from what programs that use MANO print of its joints.
const REST: [[[f64; 2]; 2]; 5] = [
    [[50.0, 2.0], [26.0, -12.0]],
    [[4.0, 7.0], [0.0, -3.0]],
    [[-10.0, 3.0], [-10.0, -3.0]],
    [[-10.0, 4.0], [-18.0, -4.0]],
    [[-36.0, 0.0], [-33.0, -2.0]],
];
/// Where the wrist of MANO's right hand lies when it is not moved, metres, to the millimetre.
const WRIST: [f64; 3] = [0.096, 0.006, 0.006];
/// How far a matrix may be from a rotation.
const SKEW: f64 = 1e-2;
/// How much better hands must fit the other way round to be taken for mirrored ones.
const MIRRORED: f64 = 1.1;

/// The hands of a document of JSON.
pub(super) fn parse(text: &[u8], limits: &Limits) -> Result<Vec<LandmarkClip>, String> {
    check_size(text)?;
    clips(tree::json(text, limits)?, text.len(), limits)
}

/// The hands of a file of arrays.
pub(super) fn parse_npz(bytes: &[u8], limits: &Limits) -> Result<Vec<LandmarkClip>, String> {
    clips(tree::arrays(bytes, limits)?, bytes.len(), limits)
}

/// The hands of a lone array: joints.
pub(super) fn parse_npy(bytes: &[u8], limits: &Limits) -> Result<Vec<LandmarkClip>, String> {
    clips(tree::array(bytes, limits)?, bytes.len(), limits)
}

/// What a row says of a hand.
enum Body {
    /// Joints in the usual order, and where this stands for MANO's.
    Joints(Box<[Point3<f64>; 21]>),
    /// Rotations of the wrist, where told, and of the joints in MANO's order.
    Turns(Option<UnitQuaternion<f64>>, Box<[UnitQuaternion<f64>; TURNS]>),
}

/// A hand in an instant.
struct Sample {
    time: f64,
    /// Which of the hands of its row.
    hand: usize,
    side: Option<Side>,
    moved: Option<Vector3<f64>>,
    /// `None` where a number is missing.
    body: Option<Body>,
}

fn clips(found: Found, bytes: usize, limits: &Limits) -> Result<Vec<LandmarkClip>, String> {
    let rate = found.rate.unwrap_or(RATE);
    let mean = mean(&found)?;
    let mut samples = Vec::new();
    for (k, (number, fields)) in found.rows.iter().enumerate() {
        let wrong = |what: String| if found.rows.len() > 1 { format!("hand {k}: {what}") } else { what };
        let rows = Rows { fields, number: *number, rate, mean: mean.as_ref() };
        rows.samples(&mut samples).map_err(wrong)?;
        limits.check_frames(samples.len(), bytes as u64).map_err(|excess| wrong(excess.to_string()))?;
    }
    let mut empty = empty_times(&found, rate)?;
    if found.timed() {
        let mut times: Vec<f64> = samples.iter().map(|s| s.time).collect();
        times.sort_by(f64::total_cmp);
        times.dedup();
        let unit = seconds_of_times(&times);
        samples.iter_mut().map(|s| &mut s.time).chain(&mut empty).for_each(|time| *time *= unit);
    }
    let mut notes = Vec::new();
    let turned = |s: &Sample| matches!(s.body, Some(Body::Turns(..)));
    if samples.iter().any(turned) && found.flat.is_none() && mean.is_none() {
        notes.push("rotations are taken as from MANO's flat hand (flat_hand_mean=True)".to_owned());
    }
    reorder(&mut samples);
    notes.extend(name_two(&mut samples));
    let upright = samples.iter().all(|s| matches!(s.body, Some(Body::Turns(None, _)) | None));
    let timed = found.timed();
    let like = LandmarkClip {
        rate: (!timed).then_some(rate),
        rate_assumed: !timed && found.rate.is_none(),
        metres: Some(1.0),
        points_per_frame: 21,
        made_by: Some("MANO".into()),
        axes: if upright { Axes::Webxr } else { Axes::Mediapipe },
        centred: !samples.iter().any(|s| s.moved.is_some()),
        ..LandmarkClip::default()
    };
    let mut sided = Sided::new(like);
    empty.into_iter().for_each(|time| sided.pass(time));
    for side in [Some(Side::Left), Some(Side::Right), None] {
        let of_side: Vec<&Sample> = samples.iter().filter(|s| s.side == side).collect();
        if of_side.is_empty() {
            continue;
        }
        let kind = Kind::of(&of_side, side);
        if kind.mirrored {
            notes.push("left hands are stored as mirrored right ones, and were turned back".to_owned());
        }
        for sample in of_side {
            let points = sample.points(&kind, upright)?;
            sided.pass(sample.time);
            sided.push(kind.side, LandmarkFrame::of(sample.time, points))?;
        }
    }
    let mut clips = sided.finished()?;
    clips.iter_mut().for_each(|clip| clip.notes.extend_from_slice(&notes));
    Ok(clips)
}

/// Seconds of the frames without a hand, as far as they can be told.
fn empty_times(found: &Found, rate: f64) -> Result<Vec<f64>, String> {
    let at = At { row: 0, rows: 1, hand: 0, hands: 1 };
    let told = |fields: &Fields| !found.timed() || fields.get(Name::Time).is_some();
    let empty = found.empty.iter().filter(|(_, fields)| told(fields));
    empty.map(|(number, fields)| Rows { fields, number: Some(*number), rate, mean: None }.time(at)).collect()
}

/// The mean that is added to rotations, of a right hand; `None` where they are from the flat hand.
fn mean(found: &Found) -> Result<Option<[f64; 3 * TURNS]>, String> {
    let told = found.mean.as_ref().filter(|_| found.flat != Some(true));
    let Some(values) = told else {
        if found.flat == Some(false) {
            return Err("flat_hand_mean is False, and the mean that this takes is missing: 45 values \"hands_mean\", as \
                        MANO's own file has them"
                .into());
        }
        return Ok(None);
    };
    let values = values.data.get(values.data.len().saturating_sub(3 * TURNS)..).unwrap_or_default();
    let mean: [f64; 3 * TURNS] =
        values.try_into().map_err(|_| format!("hands_mean has {} values, expected 45", values.len()))?;
    Ok(Some(if closes(&mean) < 0.0 { mirrored(&mean) } else { mean }))
}

/// How far fingers close, in the sense of a right hand: the sum of the turns about z of all but the thumb.
fn closes(turns: &[f64; 3 * TURNS]) -> f64 {
    turns[..36].iter().skip(2).step_by(3).sum()
}

/// The same of rotations.
fn closes_by(turns: &[UnitQuaternion<f64>; TURNS]) -> f64 {
    closes(&std::array::from_fn(|k| turns[k / 3].scaled_axis()[k % 3]))
}

/// Turns of the other hand.
fn mirrored(turns: &[f64; 3 * TURNS]) -> [f64; 3 * TURNS] {
    std::array::from_fn(|k| if k % 3 == 0 { turns[k] } else { -turns[k] })
}

/// How the hands of a side are stored.
struct Kind {
    side: Option<Side>,
    /// Whether as mirrored right hands.
    mirrored: bool,
}

impl Kind {
    fn of(samples: &[&Sample], told: Option<Side>) -> Self {
        let mut sum = 0.0;
        let mut points: Vec<JointPoints> = Vec::new();
        for sample in samples {
            match &sample.body {
                Some(Body::Turns(_, turns)) => sum += closes_by(turns),
                Some(Body::Joints(joints)) => points.extend(landmarks(joints)),
                None => {}
            }
        }
        let turned = samples.iter().any(|s| matches!(s.body, Some(Body::Turns(..))));
        match told {
            None if turned => {
                Self { side: Some(if sum < 0.0 { Side::Left } else { Side::Right }), mirrored: false }
            }
            Some(Side::Left) if turned => Self { side: told, mirrored: sum > 0.0 },
            Some(Side::Left) => {
                let trial = tell_side(&points);
                let right = trial.is_ok_and(|t| t.side() == Side::Right && t.ratio() > MIRRORED);
                Self { side: told, mirrored: right }
            }
            told => Self { side: told, mirrored: false },
        }
    }
}

/// Joints in the usual order in their places.
fn landmarks(joints: &[Point3<f64>; 21]) -> Option<JointPoints> {
    place(&joints.map(|p| Some(p.into())), 21).ok()
}

impl Sample {
    /// The joints. `upright` stands for hands whose turn is not told: fingers up, the palm to the viewer.
    fn points(&self, kind: &Kind, upright: bool) -> Result<JointPoints, String> {
        let side = if kind.mirrored { Side::Right } else { kind.side.unwrap_or(Side::Right) };
        let mut joints = match &self.body {
            None => return Ok([None; 25]),
            Some(Body::Joints(joints)) => **joints,
            Some(Body::Turns(wrist, turns)) => {
                forward(side, wrist.unwrap_or_default(), turns, self.moved.is_some())
            }
        };
        for p in &mut joints {
            if kind.mirrored {
                p.x = -p.x;
            }
            if upright {
                let across = if kind.side == Some(Side::Left) { -1.0 } else { 1.0 };
                *p = Point3::new(across * p.z, -across * p.x, -p.y);
            }
            *p += self.moved.unwrap_or_default();
        }
        place(&joints.map(|p| Some(p.into())), 21)
    }
}

/// Joints of MANO's flat hand from its wrist, in its axes, in the usual order, of a hand of mean sizes.
fn flat_hand(side: Side) -> [Vector3<f64>; 21] {
    let sizes = Morphology::average(MEAN_HAND_LENGTH);
    let mut out = [Vector3::zeros(); 21];
    for (finger, rest) in Finger::ALL.into_iter().zip(REST) {
        let first = 1 + 4 * finger as usize;
        out[first] = sizes.finger(finger).base_vector();
        for k in 0..3 {
            let [across, back] = rest[k.min(1)].map(f64::to_radians);
            let along = Vector3::new(across.sin() * back.cos(), across.cos() * back.cos(), -back.sin());
            out[first + k + 1] = out[first + k] + along * sizes.finger(finger).bones[k];
        }
    }
    let fingers = if side == Side::Left { 1.0 } else { -1.0 };
    out.map(|p| Vector3::new(fingers * p.y, -p.z, p.x))
}

/// The joints of a hand with these rotations; about its wrist, or where MANO has it.
fn forward(
    side: Side,
    wrist: UnitQuaternion<f64>,
    turns: &[UnitQuaternion<f64>; TURNS],
    in_place: bool,
) -> [Point3<f64>; 21] {
    let flat = flat_hand(side);
    let sign = if side == Side::Left { -1.0 } else { 1.0 };
    let origin = if in_place { Point3::new(sign * WRIST[0], WRIST[1], WRIST[2]) } else { Point3::origin() };
    let mut out = [origin; 21];
    for (finger, turns) in FINGERS.into_iter().zip(turns.chunks_exact(3)) {
        let first = 1 + 4 * finger as usize;
        let mut turn = wrist;
        out[first] = origin + turn * flat[first];
        for (k, by) in turns.iter().enumerate() {
            turn *= by;
            out[first + k + 1] = out[first + k] + turn * (flat[first + k + 1] - flat[first + k]);
        }
    }
    out
}

/// Puts joints in MANO's order into the usual one: in the right one bones are short.
fn reorder(samples: &mut [Sample]) {
    let joints = samples.iter().find_map(|s| match &s.body {
        Some(Body::Joints(joints)) => Some(joints.clone()),
        _ => None,
    });
    let length = |joints: &[Point3<f64>; 21]| -> f64 {
        let bones = (1..21).map(|k| if k % 4 == 1 { (0, k) } else { (k - 1, k) });
        bones.map(|(a, b)| (joints[a] - joints[b]).norm()).sum()
    };
    let usual = |joints: &[Point3<f64>; 21]| FROM_MANO.map(|k| joints[k]);
    if joints.is_some_and(|joints| length(&usual(&joints)) < length(&joints)) {
        for sample in samples {
            if let Some(Body::Joints(joints)) = &mut sample.body {
                **joints = usual(joints);
            }
        }
    }
}

/// Names two hands in each row of which nothing tells the sides: the one that is more like a right hand is it. Gives what is
/// worth saying of that.
fn name_two(samples: &mut [Sample]) -> Option<String> {
    let unnamed = |samples: &[Sample], hand: usize| {
        let of_hand = samples.iter().filter(|s| s.side.is_none() && s.hand == hand);
        let mut points: Vec<JointPoints> = Vec::new();
        let (mut closing, mut count) = (0.0, 0);
        for sample in of_hand {
            count += 1;
            match &sample.body {
                Some(Body::Joints(joints)) => points.extend(landmarks(joints)),
                Some(Body::Turns(_, turns)) => closing += closes_by(turns),
                None => {}
            }
        }
        // Of joints how many times as far off a left hand is; of rotations how far fingers close as those of a right one.
        let joints = tell_side(&points).map_or(0.0, |trial| (trial.left / trial.right).ln());
        (count > 0).then_some(joints + closing)
    };
    let [first, second] = [0, 1].map(|hand| unnamed(samples, hand));
    let right = usize::from(second? > first?);
    for sample in samples.iter_mut().filter(|s| s.side.is_none()) {
        sample.side = Some(if sample.hand == right { Side::Right } else { Side::Left });
    }
    let which = ["first", "second"][right];
    Some(format!("two hands in each row: the {which} one is taken for the right hand, as they fit"))
}

/// The rows of a node's arrays: one instant each.
struct Rows<'a> {
    fields: &'a Fields,
    /// Which frame it is, of those in a list.
    number: Option<usize>,
    rate: f64,
    mean: Option<&'a [f64; 3 * TURNS]>,
}

/// The hands in rows of both (AMASS's `pose_hand`) and of a whole body, in SMPL+H or SMPL-X: they come last, the left one first.
fn both(pose: &Array) -> Option<[Array; 2]> {
    let (width, before) = pose.shape.split_last()?;
    let body = width.checked_sub(6 * TURNS).filter(|body| [0, 66, 75].contains(body))?;
    Some([0, 1].map(|hand| {
        let from = body + hand * 3 * TURNS;
        let rows = pose.data.chunks_exact(*width).flat_map(|row| &row[from..from + 3 * TURNS]);
        let shape = before.iter().copied().chain([3 * TURNS]).collect();
        Array { data: rows.copied().collect(), shape, ..Array::default() }
    }))
}

impl Rows<'_> {
    fn samples(&self, out: &mut Vec<Sample>) -> Result<(), String> {
        let side = self.fields.side()?;
        if let Some(joints) = self.fields.get(Name::Joints) {
            return self.joints(joints, out);
        }
        for (name, side) in
            [(Name::Pose, side), (Name::LeftPose, Some(Side::Left)), (Name::RightPose, Some(Side::Right))]
        {
            match self.fields.get(name) {
                Some(pose) if let Some(hands) = both(pose) => {
                    for (pose, side) in hands.iter().zip([Side::Left, Side::Right]) {
                        self.turns(pose, Some(side), false, out)?;
                    }
                }
                Some(pose) => self.turns(pose, side, name == Name::Pose, out)?,
                None => {}
            }
        }
        Ok(())
    }

    /// Whether it is the right one of each row, or the side of all.
    fn side(&self, at: At) -> Result<Option<Side>, String> {
        let told = self.fields.get(Name::Right).map(|a| a.data.as_slice()).filter(|data| !data.is_empty());
        let Some(list) = told else {
            return match self.fields.side()? {
                Some(side) if at.hands > 1 => Err(format!(
                    "two hands in each row, and the side is {}; is_right may have a value for each",
                    side.name()
                )),
                side => Ok(side),
            };
        };
        let right =
            if list.len() == at.hands { list.get(at.hand) } else { at.part(list, 1).map(|part| &part[0]) };
        right
            .map(|right| Some(of_right(*right)))
            .ok_or_else(|| format!("is_right has {} values for {at}", list.len()))
    }

    /// Seconds of a row.
    fn time(&self, at: At) -> Result<f64, String> {
        let of = |name: Name| match self.fields.get(name).map(|a| a.data.as_slice()) {
            None | Some([]) => Ok(None),
            Some([one]) if at.rows == 1 => Ok(Some(*one)),
            Some(list) if list.len() == at.rows => Ok(Some(list[at.row])),
            Some(list) => Err(format!("{} times for {at}", list.len())),
        };
        if let Some(time) = of(Name::Time)? {
            return Ok(time);
        }
        let number = of(Name::Frame)?.unwrap_or((self.number.unwrap_or(0) + at.row) as f64);
        Ok(number / self.rate)
    }

    fn moved(&self, at: At) -> Result<Option<Vector3<f64>>, String> {
        let Some(by) = self.fields.get(Name::Moved) else { return Ok(None) };
        let part = if by.data.len() == 3 { Some(by.data.as_slice()) } else { at.part(&by.data, 3) };
        let part = part.ok_or_else(|| {
            format!("the translation has {} values for {at}, expected 3 a row", by.data.len())
        })?;
        Ok(Some(Vector3::from_column_slice(part)).filter(|v| v.iter().all(|v| v.is_finite())))
    }

    fn joints(&self, joints: &Array, out: &mut Vec<Sample>) -> Result<(), String> {
        let expected = "expected 21 × 3 in each row, and of two hands 2 × 21 × 3 or 42 × 3";
        let wrong = || format!("joints of shape {}, {expected}", shape(&joints.shape));
        let (before, hands) = match joints.shape.as_slice() {
            [before @ .., 21, 3] => (before, None),
            [before @ .., 42, 3] => (before, Some(2)),
            _ => return Err(wrong()),
        };
        for (at, values) in At::each(before, hands, joints.data.chunks_exact(63)).ok_or_else(wrong)? {
            // Of a hand that is not there some programs write noughts.
            let whole = values.iter().all(|v| v.is_finite()) && values.iter().any(|v| *v != 0.0);
            let points = || Box::new(std::array::from_fn(|k| Point3::from_slice(&values[3 * k..3 * k + 3])));
            out.push(Sample {
                time: self.time(at)?,
                hand: at.hand,
                side: self.side(at)?,
                moved: self.moved(at)?,
                body: whole.then(|| Body::Joints(points())),
            });
        }
        Ok(())
    }

    fn turns(
        &self,
        pose: &Array,
        side: Option<Side>,
        own: bool,
        out: &mut Vec<Sample>,
    ) -> Result<(), String> {
        let wrong = || {
            format!(
                "rotations of shape {}, expected 45, 48, 15 × 3 or 15 × 3 × 3 in each row, of two hands 2 × as many or 90, of \
                 a body 156 (SMPL+H) or 165 (SMPL-X); \
                 principal components (use_pca) are turned into rotations by MANO's own file alone",
                shape(&pose.shape)
            )
        };
        let (before, width, with_wrist) = match pose.shape.as_slice() {
            [before @ .., 15, 3, 3] => (before, 9 * TURNS, false),
            [before @ .., 16, 3, 3] => (before, 9 * TURNS + 9, true),
            [before @ .., 15, 3] | [before @ .., 45] => (before, 3 * TURNS, false),
            [before @ .., 16, 3] | [before @ .., 48] => (before, 3 * TURNS + 3, true),
            _ => return Err(wrong()),
        };
        let matrices = width >= 9 * TURNS;
        let step = if matrices { 9 } else { 3 };
        for (at, values) in At::each(before, None, pose.data.chunks_exact(width)).ok_or_else(wrong)? {
            let (wrist, joints) = values.split_at(if with_wrist { step } else { 0 });
            let told = if with_wrist {
                Some(turn(wrist)?)
            } else if own {
                self.wrist(at)?
            } else {
                None
            };
            let side = if own { self.side(at)?.or(side) } else { side };
            let turns = self.all_turns(joints, step, side)?;
            let whole = turns.iter().chain(&told).all(|q| q.coords.iter().all(|v| v.is_finite()));
            out.push(Sample {
                time: self.time(at)?,
                hand: at.hand,
                side,
                moved: if own { self.moved(at)? } else { None },
                body: whole.then(|| Body::Turns(told, Box::new(turns))),
            });
        }
        Ok(())
    }

    fn all_turns(
        &self,
        joints: &[f64],
        step: usize,
        side: Option<Side>,
    ) -> Result<[UnitQuaternion<f64>; TURNS], String> {
        let mut turns = [UnitQuaternion::identity(); TURNS];
        let mean = self.mean.filter(|_| step == 3).map(|mean| match side {
            Some(Side::Left) => mirrored(mean),
            _ => *mean,
        });
        for (k, (to, values)) in turns.iter_mut().zip(joints.chunks_exact(step)).enumerate() {
            *to = match mean {
                Some(mean) => turn(&[0, 1, 2].map(|i| values[i] + mean[3 * k + i]))?,
                None => turn(values)?,
            };
        }
        Ok(turns)
    }

    /// The rotation of the wrist in a row, where it is told.
    fn wrist(&self, at: At) -> Result<Option<UnitQuaternion<f64>>, String> {
        let Some(wrist) = self.fields.get(Name::Wrist) else { return Ok(None) };
        let part = at.part(&wrist.data, 3).or_else(|| at.part(&wrist.data, 9));
        let part = part.ok_or_else(|| {
            format!("the global rotation has {} values for {at}, expected 3 or 9 a row", wrist.data.len())
        })?;
        turn(part).map(Some)
    }
}

/// Which hand of an array it is: the row, and which of the one or two hands in it.
#[derive(Clone, Copy)]
struct At {
    row: usize,
    rows: usize,
    hand: usize,
    hands: usize,
}

impl fmt::Display for At {
    fn fmt(&self, f: &mut Formatter) -> fmt::Result {
        write!(f, "{} rows", self.rows)?;
        if self.hands > 1 { write!(f, " of {} hands", self.hands) } else { Ok(()) }
    }
}

impl At {
    /// The hands of an array with these lengths `before` those of its `hands`, or where these are not told of one: rows, and in
    /// each row one hand or two; `None` where there are more.
    fn each<'a>(
        before: &[usize],
        hands: Option<usize>,
        values: ChunksExact<'a, f64>,
    ) -> Option<impl Iterator<Item = (Self, &'a [f64])>> {
        let (before, hands) = match (before, hands) {
            (before, Some(hands)) => (before, hands),
            ([rows @ .., 2], None) if !rows.is_empty() => (rows, 2),
            (before, None) => (before, 1),
        };
        // A list of one is one as well.
        if before.iter().filter(|n| **n != 1).count() > 1 {
            return None;
        }
        let rows = values.len() / hands;
        Some(
            values
                .enumerate()
                .map(move |(k, values)| (Self { row: k / hands, rows, hand: k % hands, hands }, values)),
        )
    }

    /// So many numbers of a list that has as many for each hand, or for each row.
    fn part(self, list: &[f64], width: usize) -> Option<&[f64]> {
        let at = match list.len() {
            n if n == width * self.rows * self.hands => self.row * self.hands + self.hand,
            n if n == width * self.rows => self.row,
            _ => return None,
        };
        list.get(width * at..width * (at + 1))
    }
}

/// The lengths of an array in words.
fn shape(lengths: &[usize]) -> String {
    lengths.iter().map(usize::to_string).collect::<Vec<_>>().join(" × ")
}

fn of_right(value: f64) -> Side {
    if value > 0.5 { Side::Right } else { Side::Left }
}

/// A rotation from an axis times an angle, or from a matrix by rows; not finite where a number is not.
fn turn(values: &[f64]) -> Result<UnitQuaternion<f64>, String> {
    match values {
        [x, y, z] => Ok(UnitQuaternion::from_scaled_axis(Vector3::new(*x, *y, *z))),
        values if !values.iter().all(|v| v.is_finite()) => {
            Ok(UnitQuaternion::from_scaled_axis(Vector3::repeat(f64::NAN)))
        }
        values => {
            let matrix = Matrix3::from_row_slice(values);
            let off = (matrix.transpose() * matrix - Matrix3::identity()).abs().max();
            if off > SKEW || matrix.determinant() < 0.0 {
                return Err(format!("a matrix that is no rotation: it is off by {off:.2}"));
            }
            Ok(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix)))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::{ImportOptions, import_all};
    use crate::landmarks::npz::tests::{doubles, zipped};
    use handcast_hand::{JointAngle, PoseClip};
    use nalgebra::{Matrix4, Rotation3};
    use serde_json::{Value, json};

    fn parse(text: &str) -> Result<Vec<LandmarkClip>, String> {
        super::parse(text.as_bytes(), &Limits::default())
    }

    fn one(value: &Value) -> LandmarkClip {
        parse(&value.to_string()).unwrap().remove(0)
    }

    /// Joint rotations of a right hand that closes and opens, other axes included.
    fn motion(i: usize) -> [f64; 45] {
        std::array::from_fn(|k| {
            let s = 0.5 - 0.5 * (0.3 * i as f64 + 0.1 * k as f64).cos();
            match k % 3 {
                2 if k < 36 => 0.9 * s,
                _ => 0.1 * s,
            }
        })
    }

    const WRIST: [f64; 3] = [0.3, -2.1, 0.4];

    /// The joints of a pose by products of 4 × 4 matrices, one chain after the other: a plain twin of [`forward`].
    fn twin(side: Side, wrist: [f64; 3], turns: &[f64; 45]) -> [Point3<f64>; 21] {
        let flat = flat_hand(side);
        let turn = |v: &[f64]| Rotation3::from_scaled_axis(Vector3::from_column_slice(v)).to_homogeneous();
        let shift = |from: usize, to: usize| Matrix4::new_translation(&(flat[to] - flat[from]));
        let at = |m: Matrix4<f64>| Point3::new(m[(0, 3)], m[(1, 3)], m[(2, 3)]);
        let mut out = [Point3::origin(); 21];
        for (finger, first) in [(0, 5), (1, 9), (2, 17), (3, 13), (4, 1)] {
            let mut chain = turn(&wrist) * shift(0, first);
            out[first] = at(chain);
            for k in 0..3 {
                let from = 9 * finger + 3 * k;
                chain = chain * turn(&turns[from..from + 3]) * shift(first + k, first + k + 1);
                out[first + k + 1] = at(chain);
            }
        }
        out
    }

    fn same(clip: &LandmarkClip, i: usize, expected: &[Point3<f64>; 21]) {
        let expected = landmarks(expected).unwrap();
        for (found, expected) in clip.frames[i].points.iter().zip(expected) {
            match (found, expected) {
                (Some(a), Some(b)) => assert!((a - b).norm() < 1e-9, "frame {i}: {a} and {b}"),
                (a, b) => assert_eq!(a.is_some(), b.is_some()),
            }
        }
    }

    fn mirror(p: Point3<f64>) -> Point3<f64> {
        Point3::new(-p.x, p.y, p.z)
    }

    #[test]
    fn rotations_become_the_joints_of_forward_kinematics() {
        let document =
            |i: usize| json!({ "global_orient": WRIST, "hand_pose": motion(i).as_slice(), "is_right": 1 });
        let lines: Vec<String> = (0..12).map(|i| document(i).to_string()).collect();
        let rows: Vec<Vec<f64>> = (0..12).map(|i| [&WRIST[..], &motion(i)[..]].concat()).collect();
        let apart: Vec<Value> = (0..12).map(|i| json!(motion(i).chunks(3).collect::<Vec<_>>())).collect();
        for text in [
            lines.join("\n"),
            format!("[{}]", lines.join(",")),
            json!({ "pose": rows, "side": "right" }).to_string(),
            json!({ "hand_pose": apart, "global_orient": vec![WRIST; 12], "fps": 30 }).to_string(),
            json!({ "frames": (0..12).map(|i| json!({ "right": document(i) })).collect::<Vec<_>>() })
                .to_string(),
            json!({ "0": (0..12).map(|i| (i.to_string(), document(i))).collect::<serde_json::Map<_, _>>() })
                .to_string(),
        ] {
            let clip = parse(&text).unwrap().remove(0);
            assert_eq!(
                (clip.side, clip.frames.len(), clip.axes),
                (Some(Side::Right), 12, Axes::Mediapipe),
                "{text:.80}"
            );
            for i in 0..12 {
                assert!((clip.frames[i].time - i as f64 / 30.0).abs() < 1e-9);
                same(&clip, i, &twin(Side::Right, WRIST, &motion(i)));
            }
        }
    }

    #[test]
    fn names_that_flicker_are_told() {
        let right = |i: usize| u8::from(i % 20 != 10);
        let row = |i: usize| json!({ "hand_pose": motion(i % 12).as_slice(), "is_right": right(i) });
        let document = json!((0..60).map(row).collect::<Vec<_>>()).to_string();
        let clips = parse(&document).unwrap();
        let told = |clip: &LandmarkClip| clip.notes.iter().any(|note| note.contains("3 frames"));
        assert!(
            clips.len() == 1 && clips[0].side == Some(Side::Right) && told(&clips[0]),
            "{:?}",
            clips[0].notes
        );
    }

    #[test]
    fn numbers_of_frames_tell_their_times() {
        let document = |i: usize| json!({ "hand_pose": motion(i).as_slice(), "is_right": 1 });
        let numbered: serde_json::Map<_, _> =
            [12, 7, 8].map(|i| (i.to_string(), document(i))).into_iter().collect();
        let clip = parse(&json!(numbered).to_string()).unwrap().remove(0);
        let frames: Vec<f64> = clip.frames.iter().map(|frame| (frame.time * 30.0).round()).collect();
        assert_eq!(frames, [0.0, 1.0, 5.0]);
    }

    #[test]
    fn hands_of_a_body_are_read() {
        let plain = |side: Side, i: usize| json!({ "hand_pose": motion(i).as_slice(), "is_right": side == Side::Right });
        let alone = [Side::Left, Side::Right].map(|side| {
            let rows: Vec<Value> =
                (0..12).map(|i| plain(side, if side == Side::Right { i } else { 11 - i })).collect();
            parse(&json!(rows).to_string()).unwrap().remove(0)
        });
        for (name, body) in [("pose_hand", 0), ("poses", 66), ("poses", 75)] {
            let row = |i: usize| [&vec![0.3; body][..], &motion(11 - i), &motion(i)].concat();
            let rows: Vec<Vec<f64>> = (0..12).map(row).collect();
            let both = parse(&json!({ name: rows, "fps": 30 }).to_string()).unwrap();
            assert_eq!(both.len(), 2, "{name}");
            for (hand, alone) in both.iter().zip(&alone) {
                assert_eq!((hand.side, hand.frames.len()), (alone.side, 12));
                let points = |clip: &LandmarkClip| clip.frames.iter().map(|f| f.points).collect::<Vec<_>>();
                assert_eq!(points(hand), points(alone), "{name} {body}");
            }
        }
    }

    #[test]
    fn times_in_milliseconds_are_told_by_their_steps() {
        for name in ["time", "timestamp", "timestamps", "timestamp_ms"] {
            let row = |i: usize| json!({ "hand_pose": motion(i).as_slice(), "is_right": 1, name: 40 * i });
            let clip = parse(&json!((0..12).map(row).collect::<Vec<_>>()).to_string()).unwrap().remove(0);
            assert!((clip.frames[11].time - 0.44).abs() < 1e-9, "{name}: {}", clip.frames[11].time);
        }
    }

    #[test]
    fn matrices_mean_what_axes_and_angles_mean() {
        let rows = |v: &[f64]| -> Value {
            let matrix = Rotation3::from_scaled_axis(Vector3::from_column_slice(v)).into_inner();
            json!((0..3).map(|r| (0..3).map(|c| matrix[(r, c)]).collect::<Vec<f64>>()).collect::<Vec<_>>())
        };
        let turns: Vec<Value> = motion(5).chunks(3).map(rows).collect();
        let clip = one(
            &json!([{ "pred_mano_params": { "hand_pose": [turns], "global_orient": [[rows(&WRIST)]] } }]),
        );
        same(&clip, 0, &twin(Side::Right, WRIST, &motion(5)));
        let mut skewed = turns;
        skewed[4][0][0] = json!(1.7);
        let message = parse(&json!({ "hand_pose": skewed }).to_string()).unwrap_err();
        assert!(message.contains("no rotation"), "{message}");
    }

    #[test]
    fn left_hands_are_mirror_images_however_they_are_stored() {
        let left: [f64; 45] = mirrored(&motion(4));
        let wrist = [WRIST[0], -WRIST[1], -WRIST[2]];
        let expected = twin(Side::Right, WRIST, &motion(4)).map(mirror);
        let own = one(&json!({ "hand_pose": left.as_slice(), "global_orient": wrist, "side": "left" }));
        same(&own, 0, &expected);
        for (ours, mirrored) in twin(Side::Left, wrist, &left).iter().zip(&expected) {
            assert!((ours - mirrored).norm() < 1e-12);
        }
        // As the network of HaMeR gives it: a right hand in the mirror.
        let raw = one(&json!({ "hand_pose": motion(4).as_slice(), "global_orient": WRIST, "is_right": 0 }));
        same(&raw, 0, &expected);
        assert!(raw.notes.iter().any(|note| note.contains("mirrored")), "{:?}", raw.notes);
        // Without a word for the side its fingers tell.
        assert_eq!(one(&json!({ "hand_pose": left.as_slice() })).side, Some(Side::Left));
        assert_eq!(one(&json!({ "hand_pose": motion(4).as_slice() })).side, Some(Side::Right));
    }

    #[test]
    fn the_mean_is_added_where_rotations_are_from_it() {
        let mean: [f64; 45] = std::array::from_fn(|k| if k % 3 == 2 { 0.3 } else { 0.05 });
        let whole: [f64; 45] = std::array::from_fn(|k| mean[k] + motion(3)[k]);
        let expected = twin(Side::Right, WRIST, &whole);
        let document = |side: &str, pose: &[f64; 45], wrist: [f64; 3]| json!({ "hand_pose": pose.as_slice(), "global_orient": wrist, "hands_mean": mean.as_slice(), "flat_hand_mean": false, "side": side });
        same(&one(&document("right", &motion(3), WRIST)), 0, &expected);
        let left = document("left", &mirrored(&motion(3)), [WRIST[0], -WRIST[1], -WRIST[2]]);
        same(&one(&left), 0, &expected.map(mirror));
        let mut flat = document("right", &motion(3), WRIST);
        flat["flat_hand_mean"] = json!(true);
        same(&one(&flat), 0, &twin(Side::Right, WRIST, &motion(3)));
        let lost = json!({ "hand_pose": motion(3).as_slice(), "flat_hand_mean": false }).to_string();
        assert!(parse(&lost).unwrap_err().contains("45 values \"hands_mean\""));
    }

    #[test]
    fn joints_are_read_in_either_order_and_moved() {
        let joints = twin(Side::Right, WRIST, &motion(6));
        let list = |joints: &[Point3<f64>; 21]| json!(joints.map(|p| [p.x, p.y, p.z]));
        let moved = joints.map(|p| p + Vector3::new(0.1, 0.2, 0.9));
        let wilor = json!([[{ "hand_bbox": [1, 2, 3, 4], "is_right": 1.0, "wilor_preds": {
            "pred_keypoints_3d": [list(&joints)], "pred_cam_t_full": [[0.1, 0.2, 0.9]], "hand_pose": [motion(1).as_slice()] } }]]);
        let clip = one(&wilor);
        same(&clip, 0, &moved);
        assert!(!clip.centred && clip.side == Some(Side::Right));
        // MANO's own order.
        let mut own = [Point3::origin(); 21];
        for (k, from) in FROM_MANO.into_iter().enumerate() {
            own[from] = joints[k];
        }
        same(&one(&json!({ "handJoints3D": list(&own), "side": "right" })), 0, &joints);
        // A left hand in the mirror.
        let raw =
            json!((0..12).map(|i| {
            json!({ "pred_keypoints_3d": list(&twin(Side::Right, WRIST, &motion(i))), "is_right": 0 })
        }).collect::<Vec<_>>());
        same(&one(&raw), 6, &joints.map(mirror));
        // Frames without one are instants at which it is away.
        let hand = |i: usize| {
            json!([{ "wilor_preds": { "pred_keypoints_3d": list(&twin(Side::Right, WRIST, &motion(i))) },
                     "is_right": 1 }])
        };
        let gaps = one(&json!([[], hand(0), [], null, hand(3), { "hands": [] }, hand(5), []]));
        let times: Vec<f64> = gaps.frames.iter().map(|frame| (frame.time * 30.0).round()).collect();
        assert_eq!(times, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        let seen: Vec<bool> =
            gaps.frames.iter().map(|frame| frame.points.iter().any(Option::is_some)).collect();
        assert_eq!(seen, [true, false, false, true, false, true]);
        // Two hands in each frame.
        let two = json!(
            (0..3)
                .map(|i| {
                    let joints = twin(Side::Right, WRIST, &motion(i));
                    json!([{ "pred_keypoints_3d": list(&joints), "is_right": 1 },
                   { "pred_keypoints_3d": list(&joints.map(mirror)), "is_right": 0 }])
                })
                .collect::<Vec<_>>()
        );
        let clips = parse(&two.to_string()).unwrap();
        assert_eq!(
            clips.iter().map(|c| (c.side, c.frames.len())).collect::<Vec<_>>(),
            [(Some(Side::Left), 3), (Some(Side::Right), 3)]
        );
    }

    #[test]
    fn arrays_of_numpy_are_read() {
        let rows: Vec<f64> = (0..7).flat_map(motion).collect();
        let file = zipped(&[
            ("hand_pose", doubles("(7, 15, 3)", &rows)),
            ("global_orient", doubles("(7, 3)", &WRIST.repeat(7))),
            ("transl", doubles("(7, 3)", &[0.0, 0.1, 0.6].repeat(7))),
            ("fps", doubles("()", &[60.0])),
            ("betas", doubles("(10,)", &[0.0; 10])),
        ]);
        let clip = parse_npz(&file, &Limits::default()).unwrap().remove(0);
        assert_eq!((clip.rate, clip.side, clip.centred), (Some(60.0), Some(Side::Right), false));
        for i in 0..7 {
            let place = Vector3::new(super::WRIST[0], super::WRIST[1] + 0.1, super::WRIST[2] + 0.6);
            same(&clip, i, &twin(Side::Right, WRIST, &motion(i)).map(|p| p + place));
        }
        let message = parse_npz(&zipped(&[("x", doubles("(1,)", &[0.0]))]), &Limits::default()).unwrap_err();
        assert!(message.contains("neither rotations"), "{message}");
    }

    /// Two hands in each row, the first one left.
    #[test]
    fn rows_of_two_hands_are_two_hands() {
        let [left, right] = [Side::Left, Side::Right].map(|side| {
            (0..5)
                .map(|i| {
                    let joints = twin(Side::Right, WRIST, &motion(i));
                    if side == Side::Left { joints.map(mirror) } else { joints }
                })
                .collect::<Vec<_>>()
        });
        let numbers =
            |joints: &[Point3<f64>; 21]| joints.iter().flat_map(|p| [p.x, p.y, p.z]).collect::<Vec<_>>();
        let rows = |first: &[[Point3<f64>; 21]], second: &[[Point3<f64>; 21]]| -> Vec<f64> {
            first.iter().zip(second).flat_map(|(a, b)| [numbers(a), numbers(b)].concat()).collect()
        };
        let check = |clips: Vec<LandmarkClip>| {
            let found: Vec<_> = clips.iter().map(|clip| (clip.side, clip.frames.len())).collect();
            assert_eq!(found, [(Some(Side::Left), 5), (Some(Side::Right), 5)]);
            for i in 0..5 {
                same(&clips[0], i, &left[i]);
                same(&clips[1], i, &right[i]);
                assert!((clips[0].frames[i].time - i as f64 / 30.0).abs() < 1e-9);
            }
            clips[0].notes.clone()
        };
        let lone = |shape: &str, data: &[f64]| parse_npy(&doubles(shape, data), &Limits::default());
        for shape in ["(5, 42, 3)", "(5, 2, 21, 3)"] {
            let notes = check(lone(shape, &rows(&left, &right)).unwrap());
            assert!(
                notes.iter().any(|note| note.contains("the second one is taken for the right hand")),
                "{notes:?}"
            );
            check(lone(shape, &rows(&right, &left)).unwrap());
            let zip = zipped(&[
                ("joints", doubles(shape, &rows(&right, &left))),
                ("is_right", doubles("(2,)", &[1.0, 0.0])),
            ]);
            assert_eq!(check(parse_npz(&zip, &Limits::default()).unwrap()), [""; 0]);
        }
        let nested: Vec<Value> =
            (0..5).map(|i| json!([left[i].map(<[f64; 3]>::from), right[i].map(<[f64; 3]>::from)])).collect();
        check(parse(&json!({ "joints": nested }).to_string()).unwrap());
        // Rotations as well.
        let turns: Vec<Value> =
            (0..5).map(|i| json!([mirrored(&motion(i)).to_vec(), motion(i).to_vec()])).collect();
        let clips = parse(&json!({ "hand_pose": turns }).to_string()).unwrap();
        let found: Vec<_> = clips.iter().map(|clip| (clip.side, clip.frames.len())).collect();
        assert_eq!(found, [(Some(Side::Left), 5), (Some(Side::Right), 5)]);
        // One hand a row, in lists of one.
        let one: Vec<f64> = right.iter().flat_map(numbers).collect();
        for shape in ["(5, 21, 3)", "(5, 1, 21, 3)", "(1, 5, 21, 3)"] {
            let clips = lone(shape, &one).unwrap();
            assert_eq!((clips.len(), clips[0].frames.len(), clips[0].rate_assumed), (1, 5, true), "{shape}");
            let fast = clips[0].clone().at_rate(60.0);
            assert!((fast.frames[4].time - 4.0 / 60.0).abs() < 1e-9 && fast.rate == Some(60.0));
        }
        for (shape, told) in [("(5, 63)", "5 × 63"), ("(15, 7, 3)", "15 × 7 × 3")] {
            let message = lone(shape, &one).unwrap_err();
            assert!(
                message.contains(&format!(
                    "joints of shape {told}, expected 21 × 3 in each row, and of two hands"
                )),
                "{message}"
            );
        }
        let three = doubles("(5, 3, 21, 3)", &one.repeat(3));
        let message = parse_npy(&three, &Limits::default()).unwrap_err();
        assert!(message.contains("joints of shape 5 × 3 × 21 × 3, expected"), "{message}");
        let told = zipped(&[
            ("joints", doubles("(5, 42, 3)", &rows(&left, &right))),
            ("is_right", doubles("(1,)", &[1.0])),
        ]);
        assert!(
            parse_npz(&told, &Limits::default())
                .unwrap_err()
                .contains("is_right has 1 values for 5 rows of 2 hands")
        );
    }

    /// The joints of two hands in one list: one frame of them alone, and a frame for each object.
    #[test]
    fn joints_of_two_hands_are_one_instant() {
        let right = |i: usize| twin(Side::Right, WRIST, &motion(i));
        let both = |i: usize| -> Vec<[f64; 3]> {
            right(i).map(mirror).iter().chain(&right(i)).map(|p| [p.x, p.y, p.z]).collect()
        };
        let frames: Vec<Value> = (0..5).map(|i| json!({ "joints_3d": both(i) })).collect();
        let lone = doubles("(42, 3)", &both(0).concat());
        for (clips, count) in [
            (parse_npy(&lone, &Limits::default()).unwrap(), 1),
            (parse(&json!(frames).to_string()).unwrap(), 5),
        ] {
            let found: Vec<_> = clips.iter().map(|clip| (clip.side, clip.frames.len())).collect();
            assert_eq!(found, [(Some(Side::Left), count), (Some(Side::Right), count)]);
            for i in 0..count {
                same(&clips[0], i, &right(i).map(mirror));
                same(&clips[1], i, &right(i));
            }
        }
    }

    fn poses(clips: &[LandmarkClip]) -> PoseClip {
        import_all(clips, &ImportOptions::default()).unwrap().0
    }

    #[test]
    fn bends_of_the_index_are_its_flexions() {
        let bent = |at: usize, by: f64| {
            let mut pose = [0.0; 45];
            pose[3 * at + 2] = by;
            json!({ "hand_pose": pose.as_slice(), "global_orient": [0, 0, 0], "side": "right" })
        };
        let angles = |document: &Value| {
            let clip = poses(&[one(document)]);
            let pose = &clip.frames[0].pose;
            [JointAngle::Index1Flexion, JointAngle::Index2Flexion, JointAngle::Index3Flexion]
                .map(|a| pose.angle(a))
        };
        let flat = angles(&bent(0, 0.0));
        for joint in 0..3 {
            let found = angles(&bent(joint, 0.8));
            for k in 0..3 {
                let expected = flat[k] + if k == joint { 0.8 } else { 0.0 };
                assert!((found[k] - expected).abs() < 0.03, "joint {joint}: {found:?} from {flat:?}");
            }
        }
    }

    #[test]
    fn hands_whose_turn_is_not_told_stand_upright() {
        for side in [Side::Left, Side::Right] {
            let turns = if side == Side::Left { mirrored(&motion(5)) } else { motion(5) };
            let clip = poses(&[one(&json!({ "hand_pose": turns.as_slice(), "side": side.name() }))]);
            // Measured sizes have +Y along the middle finger, which MANO's flat hand turns by 10°.
            let pose = &clip.frames[0].pose;
            assert!(pose.rotation.angle() < 0.22, "{}", pose.rotation.angle());
            assert!(pose.angle(JointAngle::Middle2Flexion) > 0.1);
        }
    }

    #[test]
    fn wrong_files_are_refused() {
        for (text, words) in [
            ("{\"hand_pose\":[1,2,3]}", "rotations of shape 3, expected 45, 48"),
            ("{\"hand_pose\":[[1,2],[3]]}", "lists of unequal lengths"),
            ("{\"betas\":[1]}", "neither rotations (hand_pose …) nor joints"),
            ("{\"joints_3d\":[[1,2,3]]}", "joints of shape 1 × 3, expected 21 × 3"),
            ("{\"hand_pose\":[1,{}]}", "numbers and objects in one list"),
            ("{\"hand_pose\":", "line 1: "),
        ] {
            let message = parse(text).unwrap_err();
            assert!(message.contains(words), "{message}");
        }
        let pose = json!(motion(0).as_slice());
        for (field, value, words) in [
            ("fps", json!(0), "fps is 0"),
            ("side", json!("both"), "the side is \"both\""),
            ("is_right", json!([1, 0]), "is_right has 2 values for 1 rows"),
            ("transl", json!([1, 2]), "the translation has 2 values"),
            ("global_orient", json!([1, 2]), "the global rotation has 2 values"),
            ("t", json!([1, 2]), "2 times for 1 rows"),
        ] {
            let message = parse(&json!({ "hand_pose": pose, field: value }).to_string()).unwrap_err();
            assert!(message.contains(words), "{message}");
        }
        let many = format!("{{\"hand_pose\":[{}]}}", vec!["{}"; 70_000].join(","));
        assert!(parse(&many).unwrap_err().contains("more objects, lists and texts"));
    }

    #[test]
    fn lost_frames_are_kept_as_such() {
        let clip = one(
            &json!({ "hand_pose": [null, motion(1).as_slice(), null, motion(3).as_slice()], "side": "right" }),
        );
        let seen: Vec<bool> = clip.frames.iter().map(|f| f.points[0].is_some()).collect();
        assert_eq!(seen, [false, true, false, true]);
        assert!((clip.frames[3].time - 0.1).abs() < 1e-9);
    }
}
