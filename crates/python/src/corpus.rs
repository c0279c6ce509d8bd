//! What `handcast.corpus` needs: the run that keeps the lines, and workers for single inputs. Lines cross as JSON.

use std::path::PathBuf;
use std::sync::Mutex;

use glob::Pattern;
use handcast_corpus::{Choice, Item, Outcome, Settings};
use pyo3::prelude::*;

use crate::options::{bundle, finder};
use crate::{Error, wrong};

fn settings_of(text: &str) -> PyResult<Settings> {
    serde_json::from_str(text).map_err(|error| Error::new_err(format!("settings: {error}")))
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
        for pattern in only {
            let parsed = Pattern::new(&pattern);
            let parsed = parsed.map_err(|error| Error::new_err(format!("{pattern}: {error}")))?;
            choice.only.push(parsed);
        }
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
        let finder = py.detach(|| net.map(|path| finder(&bundle(&path)?)).transpose())?;
        let worker = handcast_corpus::Worker::new(input, output, &settings_of(settings)?).with_finder(finder);
        Ok(Self { worker })
    }

    /// The outcome of an input, as JSON.
    fn work(&self, py: Python<'_>, item: &str) -> PyResult<String> {
        let item = item_of(item)?;
        let outcome = py.detach(|| self.worker.work(&item)).map_err(|error| wrong(&error))?;
        text_of(&outcome)
    }
}

/// The outcome of an input on which workers died, as JSON.
#[pyfunction]
pub fn given_up(item: &str, settings: &str, error: &str) -> PyResult<String> {
    text_of(&Outcome::given_up(&item_of(item)?, settings, error))
}

/// What tells networks from others.
#[pyfunction]
pub fn net_digest(py: Python<'_>, path: PathBuf) -> PyResult<String> {
    let bundle = py.detach(|| bundle(&path))?;
    Ok(format!("{} {}", bundle.palms.digest(), bundle.landmarks.digest()))
}

/// A person file as JSON.
#[pyfunction]
pub fn read_person(py: Python<'_>, path: PathBuf) -> PyResult<String> {
    let person = py.detach(|| handcast::formats::person::read_person(&path));
    text_of(&person.map_err(|error| wrong(&error))?)
}
