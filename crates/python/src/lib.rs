//! The module `handcast._handcast`; what Python sees of it is in `python/handcast/__init__.pyi`.

mod arrays;
mod clip;
mod corpus;
mod keep;
mod live;
mod notices;
mod options;
mod stream;
mod threads;
mod track;
mod wait;

use std::io;
use std::path::Path;

use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;

pyo3::create_exception!(
    handcast,
    Error,
    pyo3::exceptions::PyValueError,
    "What could not be done, in one line."
);
pyo3::create_exception!(
    handcast,
    HandcastWarning,
    pyo3::exceptions::PyUserWarning,
    "What was done, but not quite as asked for: times that were resampled, wrists out of reach, bytes left out."
);

/// What a library says, with its causes, as [`Error`].
fn wrong(error: &(dyn std::error::Error + 'static)) -> PyErr {
    let (mut text, mut cause) = (error.to_string(), error.source());
    while let Some(error) = cause {
        let more = error.to_string();
        if !text.ends_with(&more) {
            text = format!("{text}: {more}");
        }
        cause = error.source();
    }
    Error::new_err(text)
}

/// As [`wrong`]; what the system says of a file at `path` as Python's own error: `FileNotFoundError` and the like.
fn wrong_file(path: &Path, error: &(dyn std::error::Error + 'static)) -> PyErr {
    let mut causes = std::iter::successors(Some(error), |error| error.source());
    let said = causes.find_map(|cause| {
        let cause = cause.downcast_ref::<io::Error>()?;
        Some((cause.raw_os_error()?, cause.to_string()))
    });
    said.map_or_else(|| wrong(error), |(code, text)| os_error(code, &text, path))
}

/// No such file or folder, for all systems.
const ENOENT: i32 = 2;

fn missing_file(path: &Path) -> PyErr {
    os_error(ENOENT, "No such file or directory", path)
}

fn os_error(code: i32, text: &str, path: &Path) -> PyErr {
    let text = text.split(" (os error").next().unwrap_or(text);
    let path = path.as_os_str();
    Python::attach(|py| {
        let kind = py.get_type::<PyOSError>();
        // The class is chosen by the number.
        let made =
            if cfg!(windows) { kind.call1((0, text, path, code)) } else { kind.call1((code, text, path)) };
        made.map_or_else(|error| error, PyErr::from_value)
    })
}

/// Hands in video as numpy arrays, streams and glTF.
#[pymodule]
mod _handcast {
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::clip::{Clip, Hand, Pose};
    #[pymodule_export]
    use super::corpus::{Corpus, Worker, check_run, given_up, net_digest, read_person};
    #[pymodule_export]
    use super::keep::{kept_clip, kept_hand, kept_pose};
    #[pymodule_export]
    use super::live::{LiveDecoder, LiveEncoder};
    #[pymodule_export]
    use super::stream::{decode, encode, load, to_format, to_glb, to_pose_format};
    #[pymodule_export]
    use super::track::{Tracker, track};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        super::threads::settle();
        module.add("Error", module.py().get_type::<super::Error>())?;
        module.add("HandcastWarning", module.py().get_type::<super::HandcastWarning>())?;
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        module.add("ANGLES", handcast::JointAngle::ALL.map(handcast::JointAngle::name))?;
        module.add("JOINTS", handcast::Joint::ALL.map(handcast::Joint::webxr_name))
    }
}
