//! A whole clip, or frame by frame.

use std::borrow::Borrow;

use super::super::error::EncodeError;
use super::clip::{Clip, ClipBuilder, Ticker};
use super::live::LiveSession;
use super::options::{NO_FRAMES, PlanOptions, Target};
use super::plans::Plans;
use super::report::PlanReport;
use super::search::{Goal, Planner};
use super::{hold, windows};
use crate::bap::TimedBapFrame;

/// Encodes a clip with look-ahead.
///
/// # Errors
/// A parameter outside its range, no frames, frames out of order, or a value that cannot be coded.
///
/// ```
/// use handcast_fba::bap::{Bap, BapFrame};
/// use handcast_fba::plan::{PlanOptions, TimedBapFrame, encode_clip};
///
/// let bend = Bap::from_name("r_index1_flexion").unwrap();
/// let frames: Vec<TimedBapFrame> = (0..90)
///     .map(|frame| {
///         let value = -70_000.0 * (f64::from(frame) * 0.05).sin().powi(2);
///         TimedBapFrame { time: f64::from(frame) / 30.0, baps: [(bend, value as i32)].into_iter().collect() }
///     })
///     .collect();
/// let (stream, report) = encode_clip(&frames, &PlanOptions::default())?;
/// assert!(report.rms_degrees <= 0.5);
/// assert_eq!(report.bytes, stream.len());
/// # Ok::<(), handcast_fba::error::EncodeError>(())
/// ```
pub fn encode_clip(
    frames: impl IntoIterator<Item: Borrow<TimedBapFrame>>,
    options: &PlanOptions,
) -> Result<(Vec<u8>, PlanReport), EncodeError> {
    let mut encoder = ClipEncoder::new(options)?;
    let mut stream = Vec::new();
    for frame in frames {
        stream.extend(encoder.push(frame.borrow())?);
    }
    let (rest, report) = encoder.finish()?;
    stream.extend(rest);
    Ok((stream, report))
}

/// Encodes a clip whose frames come one by one. Live each gives the bytes of its plane at once; with look-ahead all
/// frames wait, a few bytes for each value, until the clip is whole.
///
/// ```
/// use handcast_fba::bap::Bap;
/// use handcast_fba::plan::{ClipEncoder, PlanOptions, TimedBapFrame};
///
/// let bend = Bap::from_name("r_index1_flexion").unwrap();
/// let mut encoder = ClipEncoder::new(&PlanOptions { live: true, ..PlanOptions::default() })?;
/// let mut stream = Vec::new();
/// for frame in 0..30 {
///     let baps = [(bend, -1_000 * frame)].into_iter().collect();
///     stream.extend(encoder.push(&TimedBapFrame { time: f64::from(frame) / 30.0, baps })?);
/// }
/// let (rest, report) = encoder.finish()?;
/// assert_eq!(report.bytes, stream.len() + rest.len());
/// # Ok::<(), handcast_fba::error::EncodeError>(())
/// ```
#[derive(Clone, Debug)]
pub struct ClipEncoder {
    options: PlanOptions,
    work: Work,
}

/// What becomes of the frames of a clip.
#[derive(Clone, Debug)]
enum Work {
    /// They are coded when they come.
    Live(Ticker, Box<LiveSession>),
    /// They are gathered to be planned.
    Ahead(ClipBuilder),
}

impl ClipEncoder {
    /// An encoder of a clip without frames.
    ///
    /// # Errors
    /// A parameter outside its range.
    pub fn new(options: &PlanOptions) -> Result<Self, EncodeError> {
        options.check()?;
        let options = PlanOptions { mode: options.mode.of_baps(options.live), ..*options };
        let work = if options.live {
            Work::Live(Ticker::new(options.rate), Box::new(LiveSession::new(&options)?))
        } else {
            Work::Ahead(ClipBuilder::new(&options))
        };
        Ok(Self { options, work })
    }

    /// The same encoder, with the frames it has, with another aim: for one with look-ahead.
    ///
    /// # Errors
    /// A parameter outside its range.
    pub fn aimed_at(&self, mode: Target) -> Result<Self, EncodeError> {
        let options = PlanOptions { mode, ..self.options };
        options.check()?;
        let options = PlanOptions { mode: mode.of_baps(options.live), ..options };
        Ok(Self { options, work: self.work.clone() })
    }

    /// Takes the next frame and gives the bytes that are finished: none with look-ahead. Live, the last bits of a
    /// plane may share a byte with the plane after it, and come with that, unless [`PlanOptions::aligned`].
    ///
    /// # Errors
    /// A time before that of the last frame, or too far behind it; live, [`EncodeError::OutOfRange`] for a value
    /// that cannot be coded.
    pub fn push(&mut self, frame: &TimedBapFrame) -> Result<Vec<u8>, EncodeError> {
        let mut out = Vec::new();
        match &mut self.work {
            Work::Live(ticker, session) => session.push(ticker.tick(frame.time)?, &frame.baps, &mut out)?,
            Work::Ahead(clip) => clip.push(frame)?,
        }
        Ok(out)
    }

    /// Live, makes the next plane an I plane that says everything, as soon as the rate has room for one: for somebody who
    /// has joined, or lost what came before. With look-ahead it changes nothing.
    pub fn request_intra(&mut self) {
        if let Work::Live(_, session) = &mut self.work {
            session.request_intra();
        }
    }

    /// Ends the stream: gives the bytes still missing, and the account of the whole.
    ///
    /// # Errors
    /// No frames, or, with look-ahead, a value that cannot be coded.
    pub fn finish(self) -> Result<(Vec<u8>, PlanReport), EncodeError> {
        let (rest, report, _) = self.finish_with_frames()?;
        Ok((rest, report))
    }

    /// The same, with the frames that were kept until now, all of them or none.
    ///
    /// # Errors
    /// As [`Self::finish`].
    pub fn finish_with_frames(self) -> Result<(Vec<u8>, PlanReport, ClipFrames), EncodeError> {
        let rate = self.options.rate.per_second();
        match self.work {
            Work::Live(ticker, session) => {
                ticker.last().ok_or(NO_FRAMES)?;
                let mut rest = Vec::new();
                let report = session.finish(&mut rest);
                Ok((rest, report, ClipFrames { clip: None, rate }))
            }
            Work::Ahead(clip) => {
                let clip = clip.finish()?;
                let (stream, report) = write_planned(&clip, &self.options)?;
                Ok((stream, report, ClipFrames { clip: Some(clip), rate }))
            }
        }
    }
}

/// Frames that were kept to be planned.
#[derive(Clone, Debug)]
pub struct ClipFrames {
    clip: Option<Clip>,
    rate: f64,
}

impl ClipFrames {
    /// Each frame at the time of its tick, from 0.
    pub fn iter(&self) -> impl Iterator<Item = TimedBapFrame> + '_ {
        let frames = self.clip.iter().flat_map(Clip::frames);
        frames.map(|(tick, baps)| TimedBapFrame { time: tick as f64 / self.rate, baps })
    }
}

/// Encodes a clip with look-ahead.
fn write_planned(clip: &Clip, options: &PlanOptions) -> Result<(Vec<u8>, PlanReport), EncodeError> {
    let (stream, mut report) = match options.mode {
        Target::Quant(quant) => Plans::rounded(clip, options, quant)?.write(clip, options)?,
        Target::MaxError(degrees) | Target::TipError(degrees) => {
            Planner::new(clip, options).bounded(degrees)?.write(clip, options)?
        }
        Target::Rms(degrees) => {
            Planner::new(clip, options).search(Goal::Rms(degrees))?.write(clip, options)?
        }
        Target::Bitrate(kbit_per_s) => hold::held(clip, options, kbit_per_s)?,
    };
    let rate = options.rate.per_second();
    report.window_kbit_per_s = windows::extremes(&clip.ticks, &report.frame_bits, rate);
    Ok((stream, report))
}
