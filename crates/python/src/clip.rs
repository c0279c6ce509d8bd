//! Poses as arrays.

use std::sync::Arc;

use handcast::formats::motion::BapTrack;
use handcast::hand::{ClipHand, FrameCheck, PoseClipError};
use handcast::{HandPose, Joint, JointAngle, Morphology, PoseClip, PoseHeader, Side, Skeleton, TimedPose};
use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};
use numpy::ndarray::{Array1, Array2, Array3, Ix1, Ix2, Ix3};
use numpy::{Element, IntoPyArray, PyArray1, PyArray2, PyArray3};
use pyo3::prelude::*;

use crate::arrays::array;
use crate::keep::{Kept, Parts, maker, parts};
use crate::options::{rate as checked_rate, side as side_of, whole};
use crate::{Error, wrong};

/// A 4×4 matrix that acts on columns.
fn matrix(place: &Isometry3<f64>) -> [[f64; 4]; 4] {
    let m = place.to_homogeneous();
    std::array::from_fn(|row| std::array::from_fn(|column| m[(row, column)]))
}

/// The wrist's 4×4 matrix as position and rotation. Columns longer or shorter than 1 by more than a thousandth are no
/// rotation.
fn placed(m: [[f64; 4]; 4], frame: usize) -> PyResult<(Vector3<f64>, UnitQuaternion<f64>)> {
    let turned = Matrix3::from_fn(|row, column| m[row][column]);
    let off = (turned.transpose() * turned - Matrix3::identity()).amax();
    let ends = m[3] == [0.0, 0.0, 0.0, 1.0];
    if !(off < 1e-3 && turned.determinant() > 0.0 && ends) {
        return Err(Error::new_err(format!(
            "wrist[{frame}] is no rotation with a place (4x4, last row 0 0 0 1)"
        )));
    }
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&turned));
    Ok((Vector3::new(m[0][3], m[1][3], m[2][3]), rotation))
}

/// One hand over time: T poses of the right or left hand.
///
/// angles: T×29 radians, in the order of ANGLES; wrist: T×4×4, metres; times: T seconds, without them `rate` a second;
/// confidence: T numbers 0 to 1, or NaN; valid: T booleans. times and rate exclude each other; without both there are 30 a second. Lists and arrays of other numbers are taken as well. Sizes are
/// those of `like`, a Hand or Pose, else mean ones.
///
/// Each attribute is a new array. Hands can be pickled, and are equal where their poses and sizes are. Raises Error that names
/// the argument, and the frame where there is one.
#[pyclass(frozen, eq, module = "handcast")]
#[derive(Clone, Debug, PartialEq)]
pub struct Hand {
    /// Left or right.
    pub side: Side,
    /// Those of the person, where they are known.
    pub sizes: Option<Morphology>,
    /// In order of time.
    pub poses: Arc<Vec<TimedPose>>,
}

impl Hand {
    fn skeleton(&self) -> Skeleton {
        Skeleton::new(&self.sizes.clone().unwrap_or_default(), self.side)
    }

    fn rows<T: Copy, const N: usize>(&self, row: impl Fn(&TimedPose) -> [T; N]) -> Vec<T> {
        self.poses.iter().flat_map(row).collect()
    }

    fn header(&self) -> PoseHeader {
        PoseHeader::one(self.side, self.sizes.clone(), None)
    }
}

/// An array of rows.
fn shaped3(count: usize, [rows, columns]: [usize; 2], values: Vec<f64>) -> PyResult<Array3<f64>> {
    Array3::from_shape_vec((count, rows, columns), values).map_err(|error| wrong(&error))
}

/// One of the optional arrays of a hand: as many values as poses.
fn as_many<T: Copy + Element>(
    what: &str,
    kind: &str,
    given: Option<&Bound<'_, PyAny>>,
    count: usize,
) -> PyResult<Option<Vec<T>>> {
    let Some(given) = given else { return Ok(None) };
    let values = array::<T, Ix1>(what, kind, &[Some(count)], given)?;
    Ok(Some(values.as_array().iter().copied().collect()))
}

/// Sizes as a dictionary, as person files have them.
fn sizes_of<'py>(py: Python<'py>, sizes: Option<&Morphology>) -> PyResult<Option<Bound<'py, PyAny>>> {
    let Some(sizes) = sizes else { return Ok(None) };
    let text = serde_json::to_string(sizes).map_err(|error| wrong(&error))?;
    py.import("json")?.call_method1("loads", (text,)).map(Some)
}

/// That all angles are finite, else which is not.
fn check_angles(angles: &[f64; JointAngle::COUNT], frame: usize) -> PyResult<()> {
    match JointAngle::ALL.into_iter().zip(angles).find(|(_, value)| !value.is_finite()) {
        Some((angle, value)) => {
            let name = angle.name();
            Err(Error::new_err(format!("angles: {name} of frame {frame} is {value}, allowed finite radians")))
        }
        None => Ok(()),
    }
}

/// A hand or a pose: what has sizes.
#[derive(FromPyObject)]
pub enum Given<'py> {
    /// Poses over time.
    Hand(PyRef<'py, Hand>),
    /// One.
    Pose(PyRef<'py, Pose>),
}

impl Given<'_> {
    /// Which hand, and its sizes.
    pub fn person(&self) -> (Side, Option<Morphology>) {
        match self {
            Self::Hand(hand) => (hand.side, hand.sizes.clone()),
            Self::Pose(pose) => (pose.timed.pose.side, pose.sizes.clone()),
        }
    }

    /// Its poses.
    pub fn poses(&self) -> &[TimedPose] {
        match self {
            Self::Hand(hand) => &hand.poses,
            Self::Pose(pose) => std::slice::from_ref(&pose.timed),
        }
    }
}

#[pymethods]
impl Hand {
    #[new]
    #[pyo3(signature = (side, angles, *, wrist=None, times=None, rate=None, confidence=None, valid=None, like=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords")]
    fn new(
        side: &str,
        angles: &Bound<'_, PyAny>,
        wrist: Option<&Bound<'_, PyAny>>,
        times: Option<&Bound<'_, PyAny>>,
        rate: Option<f64>,
        confidence: Option<&Bound<'_, PyAny>>,
        valid: Option<&Bound<'_, PyAny>>,
        like: Option<Given<'_>>,
    ) -> PyResult<Self> {
        let side = side_of("side", side)?;
        if let (Some(_), Some(rate)) = (times, rate) {
            return Err(Error::new_err(format!("rate is {rate} beside times, allowed is one of the two")));
        }
        let spaced = if times.is_some() { "times" } else { "rate" };
        let rate = checked_rate("rate", rate.unwrap_or(30.0))?;
        let angles = array::<f64, Ix2>("angles", "radians", &[None, Some(JointAngle::COUNT)], angles)?;
        let angles = angles.as_array();
        let count = angles.nrows();
        let placing = [Some(count), Some(4), Some(4)];
        let wrist = wrist.map(|given| array::<f64, Ix3>("wrist", "numbers", &placing, given)).transpose()?;
        let wrist = wrist.as_ref().map(|wrist| wrist.as_array());
        let times = as_many::<f64>("times", "seconds", times, count)?;
        let confidence = as_many::<f64>("confidence", "numbers 0 to 1", confidence, count)?;
        let valid = as_many::<bool>("valid", "booleans", valid, count)?;
        let sizes = like.and_then(|like| like.person().1);
        let header = PoseHeader::one(side, sizes, None);
        let (mut poses, mut check) = (Vec::with_capacity(count), FrameCheck::default());
        for i in 0..count {
            let mut pose = HandPose::neutral(side);
            pose.angles = std::array::from_fn(|k| angles[(i, k)]);
            check_angles(&pose.angles, i)?;
            if let Some(wrist) = &wrist {
                let m = std::array::from_fn(|row| std::array::from_fn(|column| wrist[(i, row, column)]));
                (pose.translation, pose.rotation) = placed(m, i)?;
            }
            let time = times.as_ref().map_or(i as f64 / rate, |times| times[i]);
            let mut timed = TimedPose::new(time, pose);
            timed.confidence = confidence.as_ref().map(|values| values[i]).filter(|value| !value.is_nan());
            timed.valid = valid.as_ref().is_none_or(|values| values[i]);
            let checked = check.check(&header, &timed);
            checked.map_err(|error| {
                let what = match &error {
                    PoseClipError::Time { .. } | PoseClipError::Order { .. } => spaced,
                    PoseClipError::Share { what, .. } => what,
                    PoseClipError::NotFinite => "wrist",
                    PoseClipError::Range { what } if what.starts_with("wrist") => "wrist",
                    _ => "angles",
                };
                Error::new_err(format!("{what}: frame {i}: {error}"))
            })?;
            poses.push(timed);
        }
        let sizes = header.hands.into_iter().next().and_then(|hand| hand.morphology);
        Ok(Self { side, sizes, poses: Arc::new(poses) })
    }

    fn __len__(&self) -> usize {
        self.poses.len()
    }

    fn __repr__(&self) -> String {
        format!("Hand({:?}, {} poses)", self.side.name(), self.poses.len())
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> Kept<'py, Parts<'py>> {
        Ok((maker(py, "_hand")?, parts(py, &self.header(), &self.poses)?))
    }

    /// "left" or "right".
    #[getter]
    fn side(&self) -> &'static str {
        self.side.name()
    }

    /// Sizes of the hand in metres, as the morphology of a person file; None where they are not known.
    #[getter]
    fn sizes<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        sizes_of(py, self.sizes.as_ref())
    }

    /// T: seconds from the start of the clip.
    #[getter]
    fn times<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        Array1::from_vec(self.rows(|frame| [frame.time])).into_pyarray(py)
    }

    /// T×29: radians, in the order of ANGLES. Flexion is positive when a finger closes, abduction when it leaves the middle
    /// finger, on both hands.
    #[getter]
    fn angles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let values = self.rows(|frame| frame.pose.angles);
        let array = Array2::from_shape_vec((self.poses.len(), JointAngle::COUNT), values);
        Ok(array.map_err(|error| wrong(&error))?.into_pyarray(py))
    }

    /// T×4×4: from the hand's frame to the camera's, metres; acts on columns. The unturned hand shows its palm to the viewer,
    /// fingers up.
    #[getter]
    fn wrist<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let rows = self.poses.iter().flat_map(|frame| matrix(&frame.pose.isometry()).into_iter().flatten());
        Ok(shaped3(self.poses.len(), [4, 4], rows.collect())?.into_pyarray(py))
    }

    /// T×25×3: places of the joints in the camera's frame, metres, in the order of JOINTS.
    #[getter]
    fn joints<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let skeleton = self.skeleton();
        let mut values = Vec::with_capacity(self.poses.len() * Joint::COUNT * 3);
        for frame in self.poses.iter() {
            let frames = skeleton.frames(&frame.pose);
            values.extend(
                Joint::ALL.into_iter().flat_map(|joint| <[f64; 3]>::from(frames.position(joint).coords)),
            );
        }
        Ok(shaped3(self.poses.len(), [Joint::COUNT, 3], values)?.into_pyarray(py))
    }

    /// T: 0 to 1, from 0.5 on little doubt; NaN where nothing is known.
    #[getter]
    fn confidence<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        Array1::from_vec(self.rows(|frame| [frame.confidence.unwrap_or(f64::NAN)])).into_pyarray(py)
    }

    /// T: false where the hand was lost, and the pose is a guess.
    #[getter]
    fn valid<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<bool>> {
        Array1::from_vec(self.rows(|frame| [frame.valid])).into_pyarray(py)
    }
}

/// One hand at one instant, as a Tracker gives it. Poses can be pickled and compared.
#[pyclass(frozen, eq, module = "handcast")]
#[derive(Clone, Debug, PartialEq)]
pub struct Pose {
    timed: TimedPose,
    sizes: Option<Morphology>,
}

impl Pose {
    /// A pose of a hand of these sizes.
    pub fn new(timed: TimedPose, sizes: Option<Morphology>) -> Self {
        Self { timed, sizes }
    }

    /// When and how it is.
    pub fn timed(&self) -> &TimedPose {
        &self.timed
    }
}

#[pymethods]
impl Pose {
    fn __repr__(&self) -> String {
        format!("Pose({:?}, {:.3} s)", self.timed.pose.side.name(), self.timed.time)
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> Kept<'py, Parts<'py>> {
        let header = PoseHeader::one(self.timed.pose.side, self.sizes.clone(), None);
        Ok((maker(py, "_pose")?, parts(py, &header, std::slice::from_ref(&self.timed))?))
    }

    /// "left" or "right".
    #[getter]
    fn side(&self) -> &'static str {
        self.timed.pose.side.name()
    }

    /// Sizes of the hand in metres, as Hand.sizes: those that were known when it was found.
    #[getter]
    fn sizes<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        sizes_of(py, self.sizes.as_ref())
    }

    /// Seconds.
    #[getter]
    fn time(&self) -> f64 {
        self.timed.time
    }

    /// 29: radians, as Hand.angles.
    #[getter]
    fn angles<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        Array1::from_vec(self.timed.pose.angles.to_vec()).into_pyarray(py)
    }

    /// 4×4, as Hand.wrist.
    #[getter]
    fn wrist<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        numpy::ndarray::arr2(&matrix(&self.timed.pose.isometry())).into_pyarray(py)
    }

    /// 25×3: metres, as Hand.joints.
    #[getter]
    fn joints<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let skeleton = Skeleton::new(&self.sizes.clone().unwrap_or_default(), self.timed.pose.side);
        let frames = skeleton.frames(&self.timed.pose);
        let rows: [[f64; 3]; Joint::COUNT] =
            std::array::from_fn(|k| frames.position(Joint::ALL[k]).coords.into());
        numpy::ndarray::arr2(&rows).into_pyarray(py)
    }

    /// 0 to 1, or NaN.
    #[getter]
    fn confidence(&self) -> f64 {
        self.timed.confidence.unwrap_or(f64::NAN)
    }

    /// False where the hand was lost, and the pose is a guess.
    #[getter]
    fn valid(&self) -> bool {
        self.timed.valid
    }
}

/// One hand or two over time.
///
/// hands: one Hand, or a left and a right one; rate: frames per second, where they are even; skin_tone: 1 (lightest) to 10.
/// Clips can be pickled, and are equal where hands, rate and tone are. Raises Error for hands of one side.
#[pyclass(frozen, eq, module = "handcast")]
#[derive(Clone, Debug)]
pub struct Clip {
    /// The poses.
    pub poses: Arc<PoseClip>,
    /// The BAPs that they were read from: encoded anew as they are.
    pub baps: Option<Arc<BapTrack>>,
}

impl From<PoseClip> for Clip {
    fn from(poses: PoseClip) -> Self {
        Self::with_baps(poses, None)
    }
}

impl PartialEq for Clip {
    fn eq(&self, other: &Self) -> bool {
        let ([a, b], [of_a, of_b]) = ([&self.poses, &other.poses], [&self.poses.header, &other.poses.header]);
        (of_a.rate, &of_a.hands, of_a.skin_tone) == (of_b.rate, &of_b.hands, of_b.skin_tone)
            && a.frames == b.frames
    }
}

impl Clip {
    /// Poses, and the BAPs behind them.
    pub fn with_baps(poses: PoseClip, baps: Option<BapTrack>) -> Self {
        Self { poses: Arc::new(poses), baps: baps.map(Arc::new) }
    }

    fn of(&self, side: Side) -> Option<Hand> {
        let poses: Vec<TimedPose> = self.poses.of(side).cloned().collect();
        let sizes = self.poses.header.hand(side).and_then(|hand| hand.morphology.clone());
        (!poses.is_empty()).then(|| Hand { side, sizes, poses: Arc::new(poses) })
    }
}

#[pymethods]
impl Clip {
    #[new]
    #[pyo3(signature = (hands, rate=None, *, skin_tone=None))]
    fn new(hands: Vec<PyRef<'_, Hand>>, rate: Option<f64>, skin_tone: Option<f64>) -> PyResult<Self> {
        let rate = rate.map(|rate| checked_rate("rate", rate)).transpose()?;
        let skin_tone = skin_tone.map(|tone| whole("skin_tone", tone, [1, 10])).transpose()?;
        let entries =
            hands.iter().map(|hand| ClipHand { side: hand.side, morphology: hand.sizes.clone() }).collect();
        let mut frames: Vec<TimedPose> = hands.iter().flat_map(|hand| hand.poses.iter().cloned()).collect();
        // Stable: at one instant in the order of the hands.
        frames.sort_by(|a, b| a.time.total_cmp(&b.time));
        let header = PoseHeader { rate, hands: entries, skin_tone, ..PoseHeader::default() };
        let poses = PoseClip { header, frames };
        poses.check().map_err(|error| match error {
            PoseClipError::Hands { .. } | PoseClipError::Twice { .. } => {
                Error::new_err(format!("hands: {error}"))
            }
            error => wrong(&error),
        })?;
        Ok(poses.into())
    }

    fn __repr__(&self) -> String {
        let hands: Vec<_> = self.poses.header.hands.iter().map(|hand| hand.side.name()).collect();
        format!("Clip({}, {} poses)", hands.join(" and "), self.poses.frames.len())
    }

    fn __reduce__<'py>(
        &self,
        py: Python<'py>,
    ) -> Kept<'py, (String, Bound<'py, PyArray2<f64>>, Option<String>)> {
        let (header, rows) = parts(py, &self.poses.header, &self.poses.frames)?;
        let baps = self.baps.as_ref().map(|baps| baps.to_text("clip"));
        Ok((maker(py, "_clip")?, (header, rows, baps)))
    }

    /// Frames per second.
    #[getter]
    fn rate(&self) -> f64 {
        handcast::codec::clip_rate(&self.poses)
    }

    /// Tone of the skin, 1 (lightest) to 10, where it is known: glTF files have it.
    #[getter]
    fn skin_tone(&self) -> Option<u8> {
        self.poses.header.skin_tone
    }

    /// The hands that have poses: one or two.
    #[getter]
    fn hands(&self) -> Vec<Hand> {
        self.poses.header.hands.iter().filter_map(|hand| self.of(hand.side)).collect()
    }

    /// The left Hand, or None.
    #[getter]
    fn left(&self) -> Option<Hand> {
        self.of(Side::Left)
    }

    /// The right Hand, or None.
    #[getter]
    fn right(&self) -> Option<Hand> {
        self.of(Side::Right)
    }
}
