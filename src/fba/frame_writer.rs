//! Planes written frame by frame: what encoders that code each frame when it comes have in common.

use super::error::EncodeError;
use super::syntax::{IntraParams, PlaneHeader};
use super::writer::{PlaneBits, PlaneWriter};
use crate::bap::{BAP_COUNT, BapFrame};

/// A plane writer with the levels of the next plane and the account of frames, planes and bits so far.
#[derive(Clone, Debug)]
pub(super) struct FrameWriter {
    pub(super) writer: PlaneWriter,
    /// Levels of the plane to be written, in coding order.
    pub(super) levels: Vec<i32>,
    frames: u64,
    /// Frames left out since the last plane.
    skipped: u32,
    planes: u64,
    bits: PlaneBits,
}

impl FrameWriter {
    pub(super) fn new(writer: PlaneWriter) -> Self {
        let levels = Vec::with_capacity(BAP_COUNT);
        Self { writer, levels, frames: 0, skipped: 0, planes: 0, bits: PlaneBits::default() }
    }

    /// Frames given so far, those left out included.
    pub(super) fn frames(&self) -> u64 {
        self.frames
    }

    /// Planes written so far.
    pub(super) fn planes(&self) -> u64 {
        self.planes
    }

    /// Where the bits went so far.
    pub(super) fn bits(&self) -> PlaneBits {
        self.bits
    }

    /// The values a decoder has now.
    pub(super) fn reconstruction(&self) -> BapFrame {
        BapFrame::with_values(self.writer.layout().mask(), *self.writer.values())
    }

    /// Leaves one frame out; the next plane says so.
    pub(super) fn skip(&mut self) {
        self.frames += 1;
        if self.planes > 0 {
            self.skipped += 1;
        }
    }

    /// Writes `levels` as an I plane with `params`, or without them as a P plane; how many frames were left
    /// out is filled into the header.
    pub(super) fn write(
        &mut self,
        header: &PlaneHeader,
        start_code: bool,
        params: Option<&IntraParams>,
    ) -> Result<PlaneBits, EncodeError> {
        let header = PlaneHeader { skipped: self.skipped, ..*header };
        let bits = self.writer.write_plane(&header, start_code, params, &mut self.levels)?;
        self.frames += 1;
        self.planes += 1;
        self.skipped = 0;
        self.bits += bits;
        Ok(bits)
    }

    /// Writes `levels` as a P plane.
    pub(super) fn write_predicted(&mut self) -> Result<PlaneBits, EncodeError> {
        self.write(&PlaneHeader { object_mask: 2, ..PlaneHeader::default() }, false, None)
    }

    /// Ends the stream and returns the bytes not taken yet. If the last frames were left out, a plane
    /// without change stands for the last of them, so that the stream has its full length.
    pub(super) fn finish(mut self) -> Vec<u8> {
        if self.skipped > 0 && self.planes > 0 {
            self.skipped -= 1;
            self.levels.clear();
            self.levels.resize(self.writer.layout().slots().len(), 0);
            // No change is always in range, so this cannot fail.
            let _ = self.write_predicted();
        }
        self.writer.finish()
    }
}
