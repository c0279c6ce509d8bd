//! Arguments as arrays.

use numpy::ndarray::Dimension;
use numpy::{Element, PyReadonlyArray, dtype};
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict as _, PyBytes, PyMemoryView};

use crate::Error;

/// A length of an array: this one, or any.
pub type Length = Option<usize>;

/// `given` as an array of this shape, of all that numpy casts to the type without loss: other numbers, lists.
pub fn array<'py, T: Element, D: Dimension>(
    what: &str,
    kind: &str,
    shape: &[Length],
    given: &Bound<'py, PyAny>,
) -> PyResult<PyReadonlyArray<'py, T, D>> {
    let py = given.py();
    let refused = |found: &str| {
        let allowed: Vec<_> = shape.iter().map(|n| n.map_or_else(|| "T".into(), |n| n.to_string())).collect();
        Error::new_err(format!("{what} is {found}, allowed {} {kind}", allowed.join(" x ")))
    };
    let made = py.import("numpy")?.call_method1("asarray", (given,));
    let made = made.map_err(|_| refused(&format!("no array but {}", given.get_type())))?;
    let found: Vec<usize> = made.getattr("shape")?.extract()?;
    let told = || -> PyResult<String> {
        let lengths: Vec<_> = found.iter().map(usize::to_string).collect();
        Ok(format!("{} of {}", lengths.join(" x "), made.getattr("dtype")?))
    };
    let fits = found.len() == shape.len() && shape.iter().zip(&found).all(|(n, m)| n.is_none_or(|n| n == *m));
    if !fits {
        return Err(refused(&told()?));
    }
    let how = [("casting", "safe")].into_py_dict(py)?;
    how.set_item("copy", false)?;
    match made.call_method("astype", (dtype::<T>(py),), Some(&how)) {
        Ok(cast) => cast.extract().map_err(|_| Error::new_err(format!("{what} is borrowed for writing"))),
        Err(_) => Err(refused(&told()?)),
    }
}

/// The bytes of an argument: `bytes`, `bytearray`, `memoryview` and all else that has a buffer.
pub fn bytes(what: &str, given: &Bound<'_, PyAny>) -> PyResult<Vec<u8>> {
    if let Ok(bytes) = given.cast::<PyBytes>() {
        return Ok(bytes.as_bytes().to_vec());
    }
    let view = PyMemoryView::from(given).map_err(|_| {
        pyo3::exceptions::PyTypeError::new_err(format!(
            "{what} is {}, allowed bytes, bytearray, memoryview",
            given.get_type()
        ))
    })?;
    Ok(view.call_method0("tobytes")?.cast::<PyBytes>()?.as_bytes().to_vec())
}
