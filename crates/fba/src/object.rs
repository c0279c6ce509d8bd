//! Decoding state of one FBA object: parses a plane without changing anything, then takes it over.

use super::bits::{BitReader, Trace};
use super::error::SyntaxError;
use super::fap::FaceState;
use super::state::{Layout, Models, bap_values, reconstruct};
use super::syntax::{
    Fields, FrameRate, IntraMarks, IntraParams, PlaneHeader, PlaneKind, RangeRule, intra_params, plane_header,
};
use crate::bap::{BAP_COUNT, StepTable};

/// A plane as parsed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Plane {
    pub header: PlaneHeader,
    /// Bit offsets in the stream: first bit of the header, of the parts behind it, of the
    /// arithmetic-coded BAP values, and one past the last bit.
    pub start: u64,
    pub body: u64,
    pub marks: IntraMarks,
    pub end: u64,
}

/// State of an object between planes, with room for the plane being parsed.
#[derive(Clone, Debug)]
pub(super) struct ObjectState {
    pub layout: Layout,
    next_layout: Layout,
    pub params: IntraParams,
    models: Models,
    pub levels: Vec<i32>,
    pub values: [i32; BAP_COUNT],
    pub face: FaceState,
    has_body: bool,
}

impl ObjectState {
    pub fn new(steps: StepTable, rule: RangeRule) -> Self {
        Self {
            layout: Layout::new(steps, rule),
            next_layout: Layout::new(steps, rule),
            params: IntraParams::default(),
            models: Models::default(),
            levels: Vec::with_capacity(BAP_COUNT),
            values: [0; BAP_COUNT],
            face: FaceState::new(),
            has_body: false,
        }
    }

    /// Parses one plane at the reader's position. Only scratch is changed; [`Self::commit`] takes the
    /// plane over.
    pub fn parse<T: Trace>(
        &mut self,
        reader: &mut BitReader<'_, T>,
        skip_limit: u32,
    ) -> Result<Plane, SyntaxError> {
        let start = reader.stream_position();
        let header = plane_header(reader, &PlaneHeader::default(), skip_limit)?;
        if header.has_face() {
            self.face.parse(reader, header.kind, start)?;
        }
        let body = reader.stream_position();
        let mut marks = IntraMarks::default();
        if header.has_body() {
            let layout = match header.kind {
                PlaneKind::Intra => {
                    marks = intra_params(reader, &mut self.params)?;
                    self.next_layout.follow(&self.layout, &self.params);
                    &self.next_layout
                }
                PlaneKind::Predicted if self.has_body => &self.layout,
                PlaneKind::Predicted => return Err(SyntaxError::NoIntra { bit: start }),
            };
            self.levels.clear();
            self.levels.resize(layout.slots().len(), 0);
            let coder = reader.arithmetic()?;
            bap_values(coder, header.kind, layout, &self.models, &mut self.levels)?;
        }
        Ok(Plane { header, start, body, marks, end: reader.stream_position() })
    }

    /// Takes over the plane parsed last.
    pub fn commit(&mut self, plane: &Plane) -> Result<(), SyntaxError> {
        let kind = plane.header.kind;
        if plane.header.has_body() {
            let layout = if kind == PlaneKind::Intra { &self.next_layout } else { &self.layout };
            reconstruct(layout, kind, &self.levels, &mut self.values, plane.start)?;
            match kind {
                PlaneKind::Intra => {
                    std::mem::swap(&mut self.layout, &mut self.next_layout);
                    self.models.reset(&self.layout);
                    self.has_body = true;
                }
                PlaneKind::Predicted => self.models.update(&self.layout, &self.levels),
            }
        }
        if plane.header.has_face() {
            self.face.commit(kind);
        }
        Ok(())
    }

    /// Makes this the state of `other` as far as I planes build on it.
    pub fn follow(&mut self, other: &Self) {
        self.layout.clone_from(&other.layout);
        self.values = other.values;
        self.has_body = false;
    }

    /// Forgets that an I plane was seen, so that P planes are refused until the next one.
    pub fn lose(&mut self) {
        self.has_body = false;
        self.face.lose();
    }
}

/// The time of each plane.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clock {
    rate: FrameRate,
    base: f64,
    /// Frames since `base`.
    frames: u64,
    /// Frames that the last plane said are skipped after it.
    skipped: u32,
    started: bool,
    last_code: Option<u32>,
    lost: bool,
}

impl Clock {
    pub fn new() -> Self {
        Self {
            rate: FrameRate::ASSUMED,
            base: 0.0,
            frames: 0,
            skipped: 0,
            started: false,
            last_code: None,
            lost: false,
        }
    }

    pub fn rate(&self) -> FrameRate {
        self.rate
    }

    pub fn now(&self) -> f64 {
        self.base + self.frames as f64 / self.rate.per_second()
    }

    /// Seconds up to which the last plane is shown, the frames that it skips included.
    pub fn end(&self) -> f64 {
        self.now() + (f64::from(self.skipped) + 1.0) / self.rate.per_second()
    }

    /// Counts a tick for a plane that was lost, and gives its time.
    pub fn hold(&mut self) -> f64 {
        self.frames += u64::from(std::mem::take(&mut self.skipped)) + 1;
        self.now()
    }

    /// Tells the clock that planes were lost: the next time code is believed as it stands.
    pub fn lose(&mut self) {
        self.lost = true;
    }

    /// Time of the plane with this header, in seconds. The first plane is at 0, each further one as many frames
    /// after the one before as that one said it skips, and one. A time code sets the clock, unless it only repeats
    /// the last one or names the second the clock is in anyway: codes have no fractions.
    pub fn advance(&mut self, header: &PlaneHeader) -> f64 {
        if header.object_mask == 0 {
            return self.now();
        }
        if self.started {
            self.frames += u64::from(self.skipped) + 1;
        }
        self.started = true;
        self.skipped = header.skipped;
        if let Some(rate) = header.rate.filter(|rate| *rate != self.rate && rate.per_second() > 0.0) {
            self.base = self.now();
            self.frames = 0;
            self.rate = rate;
        }
        if let Some(code) = header.time_code.map(|code| code.in_seconds()) {
            let repeated = self.last_code == Some(code) || self.now() as u32 == code;
            if !repeated || self.lost {
                self.base = code.into();
                self.frames = 0;
            }
            self.last_code = Some(code);
            self.lost = false;
        }
        self.now()
    }
}
