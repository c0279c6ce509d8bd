//! A clip coded frame by frame, with its account.

use super::super::super::error::EncodeError;
use super::super::super::frame_writer::Still;
use super::super::clip::Clip;
use super::super::options::{PlanOptions, Target};
use super::super::plans::Errors;
use super::super::report::PlanReport;
use super::super::windows::{self, Windows};
use super::LiveEncoder;
use crate::bap::{BapFrame, BapMask, derive};

/// The live encoder at work on a clip whose frames come one by one.
#[derive(Clone, Debug)]
pub(in super::super) struct LiveSession {
    options: PlanOptions,
    encoder: LiveEncoder,
    report: PlanReport,
    errors: Errors,
    reconstruction: BapFrame,
    /// Tick of each frame.
    ticks: Vec<u64>,
    /// Ticks that the encoder has passed.
    passed: u64,
}

impl LiveSession {
    pub fn new(options: &PlanOptions) -> Result<Self, EncodeError> {
        Ok(Self {
            options: *options,
            encoder: LiveEncoder::new(options)?,
            report: PlanReport::default(),
            errors: Errors::default(),
            reconstruction: BapFrame::EMPTY,
            ticks: Vec::new(),
            passed: 0,
        })
    }

    /// Takes the frame at `tick`, in which some values are only held, and puts the bytes finished so far at the end of `out`.
    /// One that cannot be coded counts as left out.
    pub fn push(
        &mut self,
        tick: u64,
        frame: &BapFrame,
        held: &BapMask,
        out: &mut Vec<u8>,
    ) -> Result<(), EncodeError> {
        (self.passed..tick).for_each(|_| self.encoder.skip_frame());
        self.passed = tick;
        let number = self.ticks.len();
        let bits = self.encoder.write_held(frame, held).map_err(|error| error.at(number))?;
        self.passed += 1;
        self.ticks.push(tick);
        if bits.masks > 0 {
            self.report.intra_planes += 1;
            self.report.quants.push(self.encoder.quant());
        }
        self.report.frame_bits.push(bits.total());
        if bits.total() > 0
            && let Some(still) = self.encoder.last_still()
        {
            self.move_still(tick, still);
        }
        self.report.sent = self.report.sent.union(&self.encoder.mask());
        self.errors.leave(self.options.left_to_model(&frame.mask));
        self.reconstruction = self.encoder.reconstruction();
        derive::fill_in(self.options.ties, &mut self.reconstruction);
        self.errors.add(frame.iter().filter(|(bap, _)| !held.contains(*bap)), &self.reconstruction);
        self.take_bytes(out);
        Ok(())
    }

    /// The values a decoder has now, those included that are left to the model.
    pub fn reconstruction(&self) -> &BapFrame {
        &self.reconstruction
    }

    /// Makes the next plane an I plane, as soon as the rate has room for one.
    pub fn request_intra(&mut self) {
        self.encoder.request_intra();
    }

    /// Counts a plane that stands for frames left out as bits of the first of them.
    fn move_still(&mut self, tick: u64, still: Still) {
        let first = tick - u64::from(still.frames);
        let index = self.ticks.partition_point(|&tick| tick <= first).saturating_sub(1);
        if let [.., last] = &mut self.report.frame_bits[..] {
            *last -= still.bits;
        }
        self.report.frame_bits[index] += still.bits;
    }

    fn take_bytes(&mut self, out: &mut Vec<u8>) {
        let before = out.len();
        self.encoder.take_bytes(out);
        self.report.bytes += out.len() - before;
    }

    /// Ends the stream, puts the rest of it at the end of `out` and says what it cost.
    pub fn finish(self, out: &mut Vec<u8>) -> PlanReport {
        let rate = self.options.rate.per_second();
        let mut report = self.report;
        report.frames = self.ticks.len() as u64;
        report.seconds = self.ticks.last().map_or(0.0, |last| (last + 1) as f64 / rate);
        report.lambda = self.encoder.lambda();
        report.planes = self.encoder.planes();
        report.bits = self.encoder.bits();
        let rest = self.encoder.finish();
        report.bytes += rest.len();
        out.extend(rest);
        self.errors.report(&mut report);
        report.window_kbit_per_s = windows::extremes(&self.ticks, &report.frame_bits, rate);
        if let Target::Bitrate(kbit_per_s) = self.options.mode {
            let windows = Windows::at_most(&self.ticks, rate, kbit_per_s);
            report.windows_missed = Some(windows.judge(&report.frame_bits).missed);
        }
        report
    }
}

/// Encodes a clip frame by frame, as if the frames came one by one.
pub(in super::super) fn write_live(
    clip: &Clip,
    options: &PlanOptions,
) -> Result<(Vec<u8>, PlanReport), EncodeError> {
    let mut session = LiveSession::new(options)?;
    let mut stream = Vec::new();
    for (tick, frame, held) in clip.frames() {
        session.push(tick, &frame, &held, &mut stream)?;
    }
    let report = session.finish(&mut stream);
    Ok((stream, report))
}
