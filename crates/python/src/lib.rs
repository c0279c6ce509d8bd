//! The module `handcast._handcast`; what Python sees of it is in `python/handcast/__init__.pyi`.

mod clip;
mod corpus;
mod options;
mod stream;
mod track;

use pyo3::prelude::*;

pyo3::create_exception!(
    handcast,
    Error,
    pyo3::exceptions::PyValueError,
    "What could not be done, in one line."
);

/// What a library says, with its causes, as [`Error`]; a file that is not there as Python's own.
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

/// Hands in video as numpy arrays, streams and glTF.
#[pymodule]
mod _handcast {
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::clip::{Clip, Hand, Pose};
    #[pymodule_export]
    use super::corpus::{Corpus, Worker, given_up, net_digest, read_person};
    #[pymodule_export]
    use super::stream::{decode, encode, load, to_format};
    #[pymodule_export]
    use super::track::{Tracker, track};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("Error", module.py().get_type::<super::Error>())?;
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        module.add("ANGLES", handcast::JointAngle::ALL.map(handcast::JointAngle::name))?;
        module.add("JOINTS", handcast::Joint::ALL.map(handcast::Joint::webxr_name))
    }
}
