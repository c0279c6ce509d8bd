//! Words of Python as options. Ranges are those of the command.

use std::path::{Path, PathBuf};

use handcast::formats::person::read_person;
use handcast::hand::smooth::SmoothOptions;
use handcast::tracking::pipeline::FinderSource;
use handcast::{ClipOptions, Side, Start, Target, View};
use handcast_net::files::{Bundle, Size, VARIABLE};
use handcast_net::hands::{NetFinder, NetFinderOptions};
use pyo3::conversion::FromPyObjectOwned;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::{Error, wrong, wrong_file};

/// One of two words.
fn one_of<T>(what: &str, word: &str, [a, b]: [(&str, T); 2]) -> PyResult<T> {
    match word {
        w if w == a.0 => Ok(a.1),
        w if w == b.0 => Ok(b.1),
        _ => Err(Error::new_err(format!("{what} is {word:?}, allowed are {:?} and {:?}", a.0, b.0))),
    }
}

/// `"left"` or `"right"`.
pub fn side(what: &str, word: &str) -> PyResult<Side> {
    one_of(what, word, [("left", Side::Left), ("right", Side::Right)])
}

/// A number within a range.
fn within(what: &str, value: f64, [from, to]: [f64; 2]) -> PyResult<f64> {
    if (from..=to).contains(&value) {
        return Ok(value);
    }
    Err(Error::new_err(format!("{what} is {value}, allowed {from} to {to}")))
}

/// A whole number within a range, of any size that Python has.
pub fn whole(what: &str, value: f64, [from, to]: [u8; 2]) -> PyResult<u8> {
    let ends = [f64::from(from), f64::from(to)];
    if value.fract() == 0.0 {
        return within(what, value, ends).map(|value| value as u8);
    }
    Err(Error::new_err(format!("{what} is {value}, allowed whole numbers {from} to {to}")))
}

/// A number above 0.
fn positive(what: &str, value: f64) -> PyResult<f64> {
    if value > 0.0 && value.is_finite() {
        return Ok(value);
    }
    Err(Error::new_err(format!("{what} is {value}, allowed are numbers above 0")))
}

/// A rate in frames per second.
pub fn rate(what: &str, value: f64) -> PyResult<f64> {
    within(what, value, [0.01, handcast::hand::clip::MAX_RATE])
}

/// Wrist to middle fingertip, metres.
pub fn check_hand_length(value: f64) -> PyResult<f64> {
    within("hand_length", value, [0.05, 0.4])
}

/// Degrees across the longer side.
pub fn check_fov(what: &str, value: f64) -> PyResult<f64> {
    within(what, value, [5.0, 150.0])
}

/// Cut-off and growth of the 1€ filter.
pub fn check_smooth([cutoff, beta]: [f64; 2]) -> PyResult<SmoothOptions> {
    let cutoff = within("smooth[0]", cutoff, [0.01, 100.0])?;
    Ok(SmoothOptions::default().with(cutoff, within("smooth[1]", beta, [0.0, 10.0])?))
}

/// Seconds between I planes.
pub fn check_intra(what: &str, value: f64) -> PyResult<f64> {
    positive(what, value)
}

/// Seconds of a gap that is bridged.
pub fn check_gap(what: &str, value: f64) -> PyResult<f64> {
    within(what, value, [0.0, 86_400.0])
}

/// What the encoder aims at.
pub fn check_target(target: Target) -> PyResult<Target> {
    match target {
        Target::Rms(degrees) => positive("target_rms", degrees),
        Target::MaxError(degrees) => within("max_error", degrees, [0.15, 180.0]),
        Target::TipError(mm) => within("max_error_mm", mm, [0.75, 1000.0]),
        Target::Bitrate(kbps) => positive("bitrate", kbps),
        Target::Quant(index) => within("quant", index.into(), [0.0, 31.0]),
    }?;
    Ok(target)
}

/// What is said of networks.
#[derive(Clone, Debug)]
pub enum Net {
    /// Those that are there, as the command finds them.
    Look,
    /// None.
    Without,
    /// Those in a file or folder.
    At(PathBuf),
}

impl Net {
    /// Of Python's `None`, `False` or a path.
    pub fn of(given: &Bound<'_, PyAny>) -> PyResult<Self> {
        if given.is_none() {
            return Ok(Self::Look);
        }
        if given.extract::<bool>().is_ok_and(|wanted| !wanted) {
            return Ok(Self::Without);
        }
        let path = given.extract().map(Self::At);
        path.map_err(|_| not_allowed("net", given, "a path, None for those that are found, False for none"))
    }

    /// The networks.
    pub fn bundle(&self) -> PyResult<Option<Bundle>> {
        match self {
            Self::Without => Ok(None),
            Self::Look if std::env::var_os(VARIABLE).is_some_and(|value| value == "none") => Ok(None),
            Self::Look => Bundle::look(None, Size::Full).map_err(|error| wrong(&error)),
            Self::At(path) => Bundle::look(Some(path), Size::Full).map_err(|error| wrong_file(path, &error)),
        }
    }
}

/// What tells networks from others.
pub fn name_of(bundle: &Bundle) -> String {
    format!("{} {}", bundle.palms.digest(), bundle.landmarks.digest())
}

/// Networks as a finder of hands.
pub fn finder(bundle: &Bundle) -> PyResult<FinderSource> {
    let finder = NetFinder::new(bundle, NetFinderOptions::for_tracking()).map_err(|error| wrong(&error))?;
    Ok(FinderSource::new(move || Box::new(finder.clone())))
}

fn not_allowed(what: &str, given: &Bound<'_, PyAny>, allowed: &str) -> PyErr {
    PyTypeError::new_err(format!("{what} is {given}, allowed {allowed}"))
}

/// A keyword's value.
fn word<'py, T: FromPyObjectOwned<'py>>(
    words: &Bound<'py, PyDict>,
    what: &str,
    allowed: &str,
) -> PyResult<T> {
    let given = words.as_any().get_item(what)?;
    given.extract().map_err(|_| not_allowed(what, &given, allowed))
}

/// Two numbers in whatever has two.
fn pair(what: &str, given: &Bound<'_, PyAny>) -> PyResult<Option<[f64; 2]>> {
    if given.is_none() {
        return Ok(None);
    }
    let numbers =
        given.try_iter().and_then(|all| all.map(|one| one?.extract()).collect::<PyResult<Vec<f64>>>());
    match numbers.as_deref() {
        Ok(&[a, b]) => Ok(Some([a, b])),
        _ => Err(Error::new_err(format!("{what} is {given}, allowed two numbers, as in (1.0, 0.05)"))),
    }
}

/// How a clip is tracked, as keywords.
#[derive(Debug)]
pub struct TrackWords {
    hand: Option<String>,
    view: Option<String>,
    mirror: bool,
    start: String,
    smooth: Option<[f64; 2]>,
    person: Option<PathBuf>,
    hand_length: f64,
    fov: f64,
    net: Net,
}

impl TrackWords {
    /// Of Python's keywords.
    pub fn of(words: &Bound<'_, PyDict>) -> PyResult<Self> {
        Ok(Self {
            hand: word(words, "hand", "\"left\", \"right\" and None")?,
            view: word(words, "view", "\"palm\", \"back\" and None")?,
            mirror: word(words, "mirror", "True and False")?,
            start: word(words, "start", "\"open\" and \"any\"")?,
            smooth: pair("smooth", &words.as_any().get_item("smooth")?)?,
            person: word(words, "person", "a path and None")?,
            hand_length: word(words, "hand_length", "0.05 to 0.4")?,
            fov: word(words, "fov", "5 to 150")?,
            net: Net::of(&words.as_any().get_item("net")?)?,
        })
    }

    /// The options of the pipeline. Files are read without Python's lock.
    pub fn options(&self, py: Python<'_>) -> PyResult<ClipOptions> {
        py.detach(|| self.read())
    }

    fn read(&self) -> PyResult<ClipOptions> {
        let mut options = ClipOptions::default();
        options.side = self.hand.as_deref().map(|word| side("hand", word)).transpose()?;
        let view = |word| one_of("view", word, [("palm", View::Palm), ("back", View::Back)]);
        options.view = self.view.as_deref().map(view).transpose()?;
        options.mirror = self.mirror;
        options.start = one_of("start", &self.start, [("open", Start::Open), ("any", Start::Any)])?;
        options.smooth = self.smooth.map(check_smooth).transpose()?;
        let person = |path: &Path| read_person(path).map_err(|error| wrong_file(path, &error));
        options.person = self.person.as_deref().map(person).transpose()?;
        options.hand_length = check_hand_length(self.hand_length)?;
        options.field_of_view = check_fov("fov", self.fov)?;
        options.finder = self.net.bundle()?.as_ref().map(finder).transpose()?;
        Ok(options)
    }
}

/// What the encoder aims at; one of them at most.
pub fn target(
    rms: Option<f64>,
    max_error: Option<f64>,
    max_error_mm: Option<f64>,
    bitrate: Option<f64>,
    quant: Option<f64>,
) -> PyResult<Target> {
    let quant = quant.map(|index| whole("quant", index, [0, 31])).transpose()?;
    let given = [
        rms.map(Target::Rms),
        max_error.map(Target::MaxError),
        max_error_mm.map(Target::TipError),
        bitrate.map(Target::Bitrate),
        quant.map(Target::Quant),
    ];
    let mut given = given.into_iter().flatten();
    match (given.next(), given.next()) {
        (None, _) => Ok(Target::default()),
        (Some(target), None) => check_target(target),
        _ => Err(Error::new_err("target_rms, max_error, max_error_mm, bitrate, quant: one of them at most")),
    }
}
