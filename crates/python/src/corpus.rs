//! What `handcast.corpus` needs: the run that keeps the lines, and workers for single inputs. Lines cross as JSON.

use std::path::PathBuf;
use std::sync::Mutex;

use glob::Pattern;
use handcast::tracking::pipeline::FinderSource;
use handcast_corpus::{Choice, Item, Outcome, Settings};
use pyo3::prelude::*;

use crate::options::{
    Net, check_fov, check_gap, check_hand_length, check_intra, check_smooth, check_target, finder, name_of,
};
use crate::threads::with_threads;
use crate::{Error, wrong};

/// Settings of JSON, within the ranges of the command.
fn settings_of(text: &str) -> PyResult<Settings> {
    let named = |error: &dyn std::fmt::Display| Error::new_err(format!("settings: {error}"));
    let settings: Settings = serde_json::from_str(text).map_err(|error| named(&error))?;
    let check = || {
        let Settings { track, encode } = &settings;
        track.hand_length.map(check_hand_length).transpose()?;
        check_fov("field_of_view", track.field_of_view)?;
        track.smooth.map(check_smooth).transpose()?;
        let part = track.part();
        if part.from.is_nan() || part.from < 0.0 || part.until <= part.from {
            let (from, until) = (part.from, part.until);
            return Err(Error::new_err(format!(
                "until is {until}, allowed is more than from, which is {from}"
            )));
        }
        track.person.as_ref().map_or(Ok(()), |person| person.morphology.validate()).map_err(|e| wrong(&e))?;
        check_intra("intra_seconds", encode.intra_seconds)?;
        check_gap("max_gap", encode.max_gap)?;
        check_target(encode.aim.into())
    };
    check().map_err(|error| Python::attach(|py| named(error.value(py))))?;
    Ok(settings)
}

fn patterns(only: &[String]) -> PyResult<Vec<Pattern>> {
    let parse =
        |text: &String| Pattern::new(text).map_err(|error| Error::new_err(format!("only: {text}: {error}")));
    only.iter().map(parse).collect()
}

fn item_of(text: &str) -> PyResult<Item> {
    serde_json::from_str(text).map_err(|error| Error::new_err(format!("item: {error}")))
}

fn text_of(value: &impl serde::Serialize) -> PyResult<String> {
    serde_json::to_string(value).map_err(|error| wrong(&error))
}

/// A run: holds the output folder and keeps its lines.
#[pyclass(frozen, module = "handcast")]
pub struct Corpus {
    // None once it has ended.
    run: Mutex<Option<handcast_corpus::Corpus>>,
}

impl Corpus {
    /// Works on the run without Python's lock; another thread waits for its turn.
    fn with<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut handcast_corpus::Corpus) -> PyResult<T> + Send,
    ) -> PyResult<T> {
        py.detach(|| {
            let mut run = self.run.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            work(run.as_mut().ok_or_else(|| Error::new_err("the run has ended"))?)
        })
    }
}

#[pymethods]
impl Corpus {
    #[new]
    fn new(
        py: Python<'_>,
        input: PathBuf,
        output: PathBuf,
        settings: &str,
        only: Vec<String>,
        checksum: bool,
        retry: bool,
    ) -> PyResult<Self> {
        let mut choice = Choice::default();
        choice.only = patterns(&only)?;
        (choice.checksum, choice.retry) = (checksum, retry);
        let settings = settings_of(settings)?;
        let run = py
            .detach(|| handcast_corpus::Corpus::open(&input, &output, &settings, &choice))
            .map_err(|error| wrong(&error))?;
        Ok(Self { run: Mutex::new(Some(run)) })
    }

    /// Inputs to do, each as JSON.
    fn todo(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        self.with(py, |run| run.todo().iter().map(text_of).collect())
    }

    /// Inputs with a stream, and inputs that failed and are not tried again.
    fn known(&self, py: Python<'_>) -> PyResult<(u64, u64)> {
        self.with(py, |run| Ok((run.done_before(), run.failed_before())))
    }

    /// The digest of the settings.
    fn settings(&self, py: Python<'_>) -> PyResult<String> {
        self.with(py, |run| Ok(run.settings().to_owned()))
    }

    /// Keeps an outcome; says whether there is a stream.
    fn record(&self, py: Python<'_>, outcome: &str) -> PyResult<bool> {
        let outcome: Outcome =
            serde_json::from_str(outcome).map_err(|error| Error::new_err(format!("outcome: {error}")))?;
        self.with(py, |run| run.record(&outcome).map_err(|error| wrong(&error)))?;
        Ok(outcome.is_done())
    }

    /// Puts the lines in order and writes the report: its text, and its facts as JSON.
    fn finish(&self, py: Python<'_>) -> PyResult<(String, String)> {
        py.detach(|| {
            let run = self.run.lock().unwrap_or_else(std::sync::PoisonError::into_inner).take();
            let run = run.ok_or_else(|| Error::new_err("the run has ended"))?;
            let report = run.finish().map_err(|error| wrong(&error))?;
            Ok((report.to_string(), text_of(&report)?))
        })
    }
}

/// Does single inputs.
#[pyclass(frozen, module = "handcast")]
pub struct Worker {
    worker: handcast_corpus::Worker,
}

#[pymethods]
impl Worker {
    #[new]
    #[pyo3(signature = (input, output, settings, net=None))]
    fn new(
        py: Python<'_>,
        input: PathBuf,
        output: PathBuf,
        settings: &str,
        net: Option<PathBuf>,
    ) -> PyResult<Self> {
        let settings = settings_of(settings)?;
        let net = net.map_or(Net::Look, Net::At);
        let finder =
            py.detach(|| settings.track.finder.as_deref().map(|name| named(name, &net)).transpose())?;
        let worker = handcast_corpus::Worker::new(input, output, &settings).with_finder(finder);
        Ok(Self { worker })
    }

    /// The outcome of an input, as JSON.
    fn work(&self, py: Python<'_>, item: &str) -> PyResult<String> {
        let item = item_of(item)?;
        let outcome =
            py.detach(|| with_threads(|| self.worker.work(&item))).map_err(|error| wrong(&error))?;
        text_of(&outcome)
    }
}

/// The networks of this name.
fn named(name: &str, net: &Net) -> PyResult<FinderSource> {
    match net.bundle()? {
        Some(bundle) if name_of(&bundle) == name => finder(&bundle),
        Some(_) => Err(Error::new_err("the networks here are others than those of the run")),
        None => Err(Error::new_err("the networks of the run are not here")),
    }
}

/// Raises Error where a run with these settings and patterns could do nothing; touches nothing.
#[pyfunction]
pub fn check_run(settings: &str, only: Vec<String>) -> PyResult<()> {
    settings_of(settings)?;
    patterns(&only).map(|_| ())
}

/// The outcome of an input on which workers died, as JSON.
#[pyfunction]
pub fn given_up(item: &str, settings: &str, error: &str) -> PyResult<String> {
    text_of(&Outcome::given_up(&item_of(item)?, settings, error))
}

/// What tells networks from others, those given or those that are there; None without.
#[pyfunction]
#[pyo3(signature = (net=None))]
pub fn net_digest(py: Python<'_>, net: Option<&Bound<'_, PyAny>>) -> PyResult<Option<String>> {
    let net = net.map_or(Ok(Net::Look), Net::of)?;
    Ok(py.detach(|| net.bundle())?.as_ref().map(name_of))
}

/// A person file as JSON.
#[pyfunction]
pub fn read_person(py: Python<'_>, path: PathBuf) -> PyResult<String> {
    let person = py.detach(|| handcast::formats::person::read_person(&path));
    text_of(&person.map_err(|error| wrong(&error))?)
}
