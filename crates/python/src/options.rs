//! Words of Python as options.

use std::path::PathBuf;

use handcast::formats::person::read_person;
use handcast::hand::smooth::SmoothOptions;
use handcast::tracking::pipeline::FinderSource;
use handcast::{ClipOptions, Side, Start, Target, View};
use handcast_net::files::{Bundle, Size};
use handcast_net::hands::{NetFinder, NetFinderOptions};
use pyo3::prelude::*;

use crate::{Error, wrong};

/// One of two words.
fn one_of<T>(what: &str, word: &str, [a, b]: [(&str, T); 2]) -> PyResult<T> {
    match word {
        w if w == a.0 => Ok(a.1),
        w if w == b.0 => Ok(b.1),
        _ => Err(Error::new_err(format!("{what} is {word:?}, allowed are {:?} and {:?}", a.0, b.0))),
    }
}

/// `"left"` or `"right"`.
pub fn side(word: &str) -> PyResult<Side> {
    one_of("hand", word, [("left", Side::Left), ("right", Side::Right)])
}

/// A number within a range.
fn within(what: &str, value: f64, [from, to]: [f64; 2]) -> PyResult<f64> {
    if (from..=to).contains(&value) {
        return Ok(value);
    }
    Err(Error::new_err(format!("{what} is {value}, allowed {from} to {to}")))
}

/// A rate in frames per second.
pub fn rate(value: f64) -> PyResult<f64> {
    within("fps", value, [0.01, handcast::hand::clip::MAX_RATE])
}

/// The networks in a file or folder.
pub fn bundle(path: &std::path::Path) -> PyResult<Bundle> {
    Bundle::find(Some(path), Size::Full).map_err(|error| wrong(&error))
}

/// Joints that move by less than this share of the hand's length are looked for in every second frame, as the command has
/// it.
const STEADY: f64 = 0.02;

/// Networks as a finder of hands.
pub fn finder(bundle: &Bundle) -> PyResult<FinderSource> {
    let finder = NetFinder::new(bundle, NetFinderOptions::default().with_steady(STEADY))
        .map_err(|error| wrong(&error))?;
    Ok(FinderSource::new(move || Box::new(finder.clone())))
}

/// How a clip is tracked, as keywords.
#[derive(Debug, FromPyObject)]
#[pyo3(from_item_all)]
pub struct TrackWords {
    hand: Option<String>,
    view: Option<String>,
    mirror: bool,
    start: String,
    smooth: Option<(f64, f64)>,
    person: Option<PathBuf>,
    hand_length: f64,
    fov: f64,
    net: Option<PathBuf>,
}

impl TrackWords {
    /// The options of the pipeline. Files are read without Python's lock.
    pub fn options(&self, py: Python<'_>) -> PyResult<ClipOptions> {
        py.detach(|| self.read())
    }

    fn read(&self) -> PyResult<ClipOptions> {
        let mut options = ClipOptions::default();
        options.side = self.hand.as_deref().map(side).transpose()?;
        let view = |word| one_of("view", word, [("palm", View::Palm), ("back", View::Back)]);
        options.view = self.view.as_deref().map(view).transpose()?;
        options.mirror = self.mirror;
        options.start = one_of("start", &self.start, [("open", Start::Open), ("any", Start::Any)])?;
        if let Some((cutoff, beta)) = self.smooth {
            let cutoff = within("smooth[0]", cutoff, [0.01, 100.0])?;
            options.smooth =
                Some(SmoothOptions::default().with(cutoff, within("smooth[1]", beta, [0.0, 10.0])?));
        }
        options.person =
            self.person.as_deref().map(read_person).transpose().map_err(|error| wrong(&error))?;
        options.hand_length = within("hand_length", self.hand_length, [0.05, 0.4])?;
        options.field_of_view = within("fov", self.fov, [5.0, 150.0])?;
        options.finder = self.net.as_deref().map(|path| finder(&bundle(path)?)).transpose()?;
        Ok(options)
    }
}

/// What the encoder aims at; one of them at most.
pub fn target(
    rms: Option<f64>,
    max_error: Option<f64>,
    max_error_mm: Option<f64>,
    bitrate: Option<f64>,
    quant: Option<u8>,
) -> PyResult<Target> {
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
        (Some(target), None) => Ok(target),
        _ => Err(Error::new_err("target_rms, max_error, max_error_mm, bitrate, quant: one of them at most")),
    }
}
