//! Poses as arrays.

use std::sync::Arc;

use handcast::hand::ClipHand;
use handcast::{HandPose, Joint, JointAngle, Morphology, PoseClip, PoseHeader, Side, Skeleton, TimedPose};
use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};
use numpy::ndarray::{Array1, Array2, Array3};
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
};
use pyo3::prelude::*;

use crate::options::{rate as checked_rate, side as side_of};
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

/// One hand over time.
#[pyclass(frozen, module = "handcast")]
#[derive(Clone, Debug)]
pub struct Hand {
    side: Side,
    sizes: Option<Morphology>,
    poses: Arc<Vec<TimedPose>>,
}

impl Hand {
    fn skeleton(&self) -> Skeleton {
        Skeleton::new(&self.sizes.clone().unwrap_or_default(), self.side)
    }

    fn rows<T: Copy, const N: usize>(&self, row: impl Fn(&TimedPose) -> [T; N]) -> Vec<T> {
        self.poses.iter().flat_map(row).collect()
    }
}

/// An array of rows.
fn shaped3(count: usize, [rows, columns]: [usize; 2], values: Vec<f64>) -> PyResult<Array3<f64>> {
    Array3::from_shape_vec((count, rows, columns), values).map_err(|error| wrong(&error))
}

/// One of the optional arrays of a hand: as many values as poses.
fn as_many<T: Copy + numpy::Element>(
    what: &str,
    given: Option<&PyReadonlyArray1<'_, T>>,
    count: usize,
) -> PyResult<Option<Vec<T>>> {
    let Some(given) = given else { return Ok(None) };
    let values: Vec<T> = given.as_array().iter().copied().collect();
    if values.len() == count {
        return Ok(Some(values));
    }
    Err(Error::new_err(format!("{what} has {} values, angles {count} rows", values.len())))
}

#[pymethods]
impl Hand {
    #[new]
    #[pyo3(signature = (side, angles, *, wrist=None, times=None, rate=30.0, confidence=None, valid=None, like=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords")]
    fn new(
        side: &str,
        angles: PyReadonlyArray2<'_, f64>,
        wrist: Option<PyReadonlyArray3<'_, f64>>,
        times: Option<PyReadonlyArray1<'_, f64>>,
        rate: f64,
        confidence: Option<PyReadonlyArray1<'_, f64>>,
        valid: Option<PyReadonlyArray1<'_, bool>>,
        like: Option<&Self>,
    ) -> PyResult<Self> {
        let (side, rate) = (side_of(side)?, checked_rate(rate)?);
        let angles = angles.as_array();
        let count = angles.nrows();
        if angles.ncols() != JointAngle::COUNT {
            return Err(Error::new_err(format!(
                "angles has {} columns, allowed {}",
                angles.ncols(),
                JointAngle::COUNT
            )));
        }
        let wrist = wrist.as_ref().map(PyReadonlyArray3::as_array);
        if let Some(wrist) = &wrist
            && wrist.dim() != (count, 4, 4)
        {
            return Err(Error::new_err(format!("wrist is {:?}, allowed ({count}, 4, 4)", wrist.dim())));
        }
        let times = as_many("times", times.as_ref(), count)?;
        let confidence = as_many("confidence", confidence.as_ref(), count)?;
        let valid = as_many("valid", valid.as_ref(), count)?;
        let mut poses = Vec::with_capacity(count);
        for i in 0..count {
            let mut pose = HandPose::neutral(side);
            pose.angles = std::array::from_fn(|k| angles[(i, k)]);
            if let Some(wrist) = &wrist {
                let m = std::array::from_fn(|row| std::array::from_fn(|column| wrist[(i, row, column)]));
                (pose.translation, pose.rotation) = placed(m, i)?;
            }
            let time = times.as_ref().map_or(i as f64 / rate, |times| times[i]);
            let mut timed = TimedPose::new(time, pose);
            timed.confidence = confidence.as_ref().map(|values| values[i]).filter(|value| !value.is_nan());
            timed.valid = valid.as_ref().is_none_or(|values| values[i]);
            poses.push(timed);
        }
        Ok(Self { side, sizes: like.and_then(|hand| hand.sizes.clone()), poses: Arc::new(poses) })
    }

    fn __len__(&self) -> usize {
        self.poses.len()
    }

    fn __repr__(&self) -> String {
        format!("Hand({:?}, {} poses)", self.side.name(), self.poses.len())
    }

    #[getter]
    fn side(&self) -> &'static str {
        self.side.name()
    }

    #[getter]
    fn times<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        Array1::from_vec(self.rows(|frame| [frame.time])).into_pyarray(py)
    }

    #[getter]
    fn angles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let values = self.rows(|frame| frame.pose.angles);
        let array = Array2::from_shape_vec((self.poses.len(), JointAngle::COUNT), values);
        Ok(array.map_err(|error| wrong(&error))?.into_pyarray(py))
    }

    #[getter]
    fn wrist<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let rows = self.poses.iter().flat_map(|frame| matrix(&frame.pose.isometry()).into_iter().flatten());
        Ok(shaped3(self.poses.len(), [4, 4], rows.collect())?.into_pyarray(py))
    }

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

    #[getter]
    fn confidence<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        Array1::from_vec(self.rows(|frame| [frame.confidence.unwrap_or(f64::NAN)])).into_pyarray(py)
    }

    #[getter]
    fn valid<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<bool>> {
        Array1::from_vec(self.rows(|frame| [frame.valid])).into_pyarray(py)
    }
}

/// One hand at one instant.
#[pyclass(frozen, module = "handcast")]
#[derive(Clone, Debug)]
pub struct Pose {
    timed: TimedPose,
    sizes: Option<Morphology>,
}

impl Pose {
    /// A pose of a hand of these sizes.
    pub fn new(timed: TimedPose, sizes: Option<Morphology>) -> Self {
        Self { timed, sizes }
    }
}

#[pymethods]
impl Pose {
    fn __repr__(&self) -> String {
        format!("Pose({:?}, {:.3} s)", self.timed.pose.side.name(), self.timed.time)
    }

    #[getter]
    fn side(&self) -> &'static str {
        self.timed.pose.side.name()
    }

    #[getter]
    fn time(&self) -> f64 {
        self.timed.time
    }

    #[getter]
    fn angles<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        Array1::from_vec(self.timed.pose.angles.to_vec()).into_pyarray(py)
    }

    #[getter]
    fn wrist<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        numpy::ndarray::arr2(&matrix(&self.timed.pose.isometry())).into_pyarray(py)
    }

    #[getter]
    fn joints<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let skeleton = Skeleton::new(&self.sizes.clone().unwrap_or_default(), self.timed.pose.side);
        let frames = skeleton.frames(&self.timed.pose);
        let rows: [[f64; 3]; Joint::COUNT] =
            std::array::from_fn(|k| frames.position(Joint::ALL[k]).coords.into());
        numpy::ndarray::arr2(&rows).into_pyarray(py)
    }

    #[getter]
    fn confidence(&self) -> f64 {
        self.timed.confidence.unwrap_or(f64::NAN)
    }

    #[getter]
    fn valid(&self) -> bool {
        self.timed.valid
    }
}

/// One hand or two over time.
#[pyclass(frozen, module = "handcast")]
#[derive(Clone, Debug)]
pub struct Clip {
    /// The poses.
    pub poses: Arc<PoseClip>,
}

impl From<PoseClip> for Clip {
    fn from(poses: PoseClip) -> Self {
        Self { poses: Arc::new(poses) }
    }
}

impl Clip {
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
    fn new(hands: Vec<PyRef<'_, Hand>>, rate: Option<f64>, skin_tone: Option<u8>) -> PyResult<Self> {
        let rate = rate.map(checked_rate).transpose()?;
        let entries =
            hands.iter().map(|hand| ClipHand { side: hand.side, morphology: hand.sizes.clone() }).collect();
        let mut frames: Vec<TimedPose> = hands.iter().flat_map(|hand| hand.poses.iter().cloned()).collect();
        // Stable: at one instant in the order of the hands.
        frames.sort_by(|a, b| a.time.total_cmp(&b.time));
        let header = PoseHeader { rate, hands: entries, skin_tone, ..PoseHeader::default() };
        let poses = PoseClip { header, frames };
        poses.check().map_err(|error| wrong(&error))?;
        Ok(poses.into())
    }

    fn __repr__(&self) -> String {
        let hands: Vec<_> = self.poses.header.hands.iter().map(|hand| hand.side.name()).collect();
        format!("Clip({}, {} poses)", hands.join(" and "), self.poses.frames.len())
    }

    #[getter]
    fn rate(&self) -> f64 {
        handcast::codec::clip_rate(&self.poses)
    }

    #[getter]
    fn skin_tone(&self) -> Option<u8> {
        self.poses.header.skin_tone
    }

    #[getter]
    fn hands(&self) -> Vec<Hand> {
        self.poses.header.hands.iter().filter_map(|hand| self.of(hand.side)).collect()
    }

    #[getter]
    fn left(&self) -> Option<Hand> {
        self.of(Side::Left)
    }

    #[getter]
    fn right(&self) -> Option<Hand> {
        self.of(Side::Right)
    }
}
