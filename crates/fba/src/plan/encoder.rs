//! A whole clip, or frame by frame.

use std::borrow::Borrow;

use super::super::error::EncodeError;
use super::clip::{Clip, ClipBuilder, Ticker};
use super::hold::{Held, held};
use super::live::LiveSession;
use super::options::{NO_FRAMES, PlanOptions, Target};
use super::plans::Plans;
use super::report::PlanReport;
use super::search::{Goal, Planner};
use super::share;
use crate::bap::{BapFrame, BapMask, TimedBapFrame};

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
    Ahead(Box<ClipBuilder>),
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
            Work::Ahead(Box::new(ClipBuilder::new(&options)))
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
        self.push_held(frame, &BapMask::EMPTY)
    }

    /// The same for a frame in which `held` values stand for what is not known: they are coded like the others, but no error
    /// of theirs is reported, and none keeps the stream from what is aimed at.
    ///
    /// # Errors
    /// As [`Self::push`].
    pub fn push_held(&mut self, frame: &TimedBapFrame, held: &BapMask) -> Result<Vec<u8>, EncodeError> {
        let mut out = Vec::new();
        match &mut self.work {
            Work::Live(ticker, session) => {
                session.push(ticker.tick(frame.time)?, &frame.baps, held, &mut out)?;
            }
            Work::Ahead(clip) => clip.push(frame, held)?,
        }
        Ok(out)
    }

    /// Whether there is no tick for a frame of this time, which comes behind the last one: frames come faster than the stream's
    /// ticks, and this one is to be left out.
    pub fn is_ahead(&self, time: f64) -> bool {
        match &self.work {
            Work::Live(ticker, _) => ticker.is_ahead(time),
            Work::Ahead(clip) => clip.is_ahead(time),
        }
    }

    /// Live, makes the next plane an I plane that says everything, as soon as the rate has room for one: for somebody who
    /// has joined, or lost what came before. With look-ahead it changes nothing.
    pub fn request_intra(&mut self) {
        if let Work::Live(_, session) = &mut self.work {
            session.request_intra();
        }
    }

    /// The values that a decoder has after the bytes of the last frame, those included that are left to the model; none
    /// with look-ahead, see [`Self::finish_compared`].
    pub fn reconstruction(&self) -> Option<&BapFrame> {
        match &self.work {
            Work::Live(_, session) => Some(session.reconstruction()),
            Work::Ahead(_) => None,
        }
    }

    /// Ends the stream: gives the bytes still missing, and the account of the whole.
    ///
    /// # Errors
    /// No frames, or, with look-ahead, a value that cannot be coded.
    pub fn finish(self) -> Result<(Vec<u8>, PlanReport), EncodeError> {
        let (rest, report, _) = self.finish_compared(|_, _| ())?;
        Ok((rest, report))
    }

    /// The same, with what `compare` makes of the frames that waited until now, each as it was given, without what it only
    /// held, and as a decoder will have it: of those of one I period after the other, on several cores, and the number of
    /// the first of them.
    ///
    /// # Errors
    /// As [`Self::finish`].
    pub fn finish_compared<T: Send>(
        self,
        compare: impl Fn(usize, &mut dyn Iterator<Item = [BapFrame; 2]>) -> T + Sync + Send,
    ) -> Result<(Vec<u8>, PlanReport, Vec<T>), EncodeError> {
        let options = &self.options;
        let clip = match self.work {
            Work::Live(ticker, session) => {
                ticker.last().ok_or(NO_FRAMES)?;
                let mut rest = Vec::new();
                let report = session.finish(&mut rest);
                return Ok((rest, report, Vec::new()));
            }
            Work::Ahead(clip) => clip.finish()?,
        };
        let compared = |plans: &Plans| {
            plans.each_period(options, |index, coded| {
                let given = clip.rows(index).map(|(given, held)| given.without(&held));
                compare(clip.period(index).start, &mut given.zip(coded).map(|(given, coded)| [given, coded]))
            })
        };
        let plans = match options.mode {
            Target::Quant(quant) => Plans::rounded(&clip, options, quant)?,
            Target::MaxError(degrees) | Target::TipError(degrees) => {
                Planner::new(&clip, options).bounded(degrees)?
            }
            Target::Rms(degrees) => Planner::new(&clip, options).search(Goal::Rms(degrees))?,
            Target::Bitrate(kbit_per_s) => {
                let Held { stream, report, plans } = held(&clip, options, kbit_per_s)?;
                let compared = match &plans {
                    Some(plans) => compared(plans),
                    None => vec![compared_live(&clip, options, compare)?],
                };
                return Ok((stream, report, compared));
            }
        };
        let (written, compared) = share::both(|| plans.write(&clip, options), || compared(&plans));
        let (stream, report) = written?;
        Ok((stream, report, compared))
    }
}

/// What `compare` makes of a clip that is coded frame by frame.
fn compared_live<T>(
    clip: &Clip,
    options: &PlanOptions,
    compare: impl Fn(usize, &mut dyn Iterator<Item = [BapFrame; 2]>) -> T,
) -> Result<T, EncodeError> {
    let mut session = LiveSession::new(options)?;
    let mut bytes = Vec::new();
    Ok(compare(
        0,
        &mut clip.frames().map_while(|(tick, given, held)| {
            session.push(tick, &given, &held, &mut bytes).ok()?;
            bytes.clear();
            Some([given.without(&held), *session.reconstruction()])
        }),
    ))
}
