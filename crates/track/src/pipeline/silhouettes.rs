//! The first stage: from frames to silhouettes.

use std::collections::VecDeque;
use std::time::Duration;

use image::imageops::flip_horizontal_in_place;
use image::{GrayImage, RgbImage};

use super::clock::Instant;
use super::sighted::{Found, SightedSilhouettes};
use super::{ClipError, ClipOptions};
use handcast_media::Frame;
use handcast_picture::Shrinker;
use handcast_vision::sighting::Sighting;
use handcast_vision::{Segmenter, Silhouette, VisionError};

/// A frame at the analysis size and the silhouettes in it.
pub(super) struct Segmented {
    pub(super) frame: Frame,
    /// Parts that may be hands, largest first; never empty.
    pub(super) parts: Result<Vec<Silhouette>, VisionError>,
    /// What a finder has seen, for each of them; `None` where none looked.
    pub(super) sightings: Option<Vec<Sighting>>,
    /// Time spent on it.
    pub(super) spent: Duration,
}

/// Finds the silhouettes of frames: those of the masks that come with them, else those of skin, whose colours are
/// learnt from the first frames. Keeps no frames but those.
pub(super) struct Silhouettes {
    options: ClipOptions,
    way: Way,
    shrinker: Shrinker,
    mask_shrinker: Shrinker,
    /// Frames that have come, and size and time of the last.
    frames: usize,
    last: Option<((u32, u32), f64)>,
    /// Why nothing could be learnt from frames that have gone on.
    untaught: Option<VisionError>,
    time: Duration,
}

/// Where silhouettes come from.
enum Way {
    /// From colours, of which these frames are to tell.
    Learning(VecDeque<Frame>),
    /// From colours.
    Colour(Box<Segmenter>),
    Masks,
    /// Round hands that a finder sees.
    Sighted(Box<SightedSilhouettes>),
}

impl Silhouettes {
    pub(super) fn new(options: &ClipOptions) -> Self {
        let shrinker = Shrinker::new(Some(options.segment.max_side));
        Self {
            options: options.clone(),
            way: match &options.finder {
                Some(finder) => Way::Sighted(Box::new(SightedSilhouettes::new(finder.make(), options))),
                None => Way::Learning(VecDeque::new()),
            },
            mask_shrinker: shrinker.clone(),
            shrinker,
            frames: 0,
            last: None,
            untaught: None,
            time: Duration::ZERO,
        }
    }

    /// Time spent so far.
    pub(super) fn time(&self) -> Duration {
        self.time
    }

    /// Takes a frame of any size, with its mask where masks are ready, and gives `out` those whose silhouettes are
    /// found: numbered as they came. The first ones wait until there are enough to learn from.
    pub(super) fn push<E: From<ClipError>>(
        &mut self,
        frame: Frame,
        mask: Option<GrayImage>,
        out: impl FnMut(Segmented) -> Result<(), E>,
    ) -> Result<(), E> {
        let begun = Instant::now();
        let frame = self.prepared(frame)?;
        if (frame.index, mask.is_some()) == (0, true) {
            self.way = Way::Masks;
        }
        match (&mut self.way, mask) {
            (Way::Masks, Some(mask)) => self.with_mask(frame, mask, begun, out),
            (Way::Learning(first), None) => {
                first.push_back(frame);
                let enough = first.len() >= self.options.learning_frames.max(1);
                self.time += begun.elapsed();
                if enough { self.learn(false, out) } else { Ok(()) }
            }
            (Way::Sighted(sighted), None) => {
                let index = frame.index;
                let found = sighted.push(frame).map_err(|reason| ClipError::Find { index, reason })?;
                self.hand_all(found, begun, out)
            }
            (Way::Colour(segmenter), None) => {
                let parts = segmenter.segment_all(&frame.image);
                self.hand_over(frame, parts, begun, out)
            }
            _ => Err(ClipError::MixedMasks { index: frame.index }.into()),
        }
    }

    /// No more frames come: those that waited are learnt from as they are.
    pub(super) fn finish<E: From<ClipError>>(
        &mut self,
        out: impl FnMut(Segmented) -> Result<(), E>,
    ) -> Result<(), E> {
        match &mut self.way {
            Way::Sighted(sighted) => {
                let begun = Instant::now();
                let found = sighted.rest();
                self.hand_all(found, begun, out)
            }
            Way::Learning(_) if self.frames > 0 => self.learn(true, out),
            _ => Ok(()),
        }
    }

    /// Whether a frame can come next.
    pub(super) fn check(&self, frame: &Frame) -> Result<(), ClipError> {
        let (index, time, size) = (self.frames, frame.time, frame.image.dimensions());
        if !time.is_finite() {
            return Err(ClipError::Time { index, time });
        }
        if let Some((first, before)) = self.last {
            if size != first {
                return Err(ClipError::Size { index, size, first });
            }
            if time < before {
                return Err(ClipError::Order { index, time, before });
            }
        }
        Ok(())
    }

    /// The frame with its number, at the analysis size, mirrored if asked for.
    fn prepared(&mut self, frame: Frame) -> Result<Frame, ClipError> {
        self.check(&frame)?;
        let (index, time, size) = (self.frames, frame.time, frame.image.dimensions());
        self.last = Some((size, time));
        self.frames += 1;
        let mut image = self.shrinker.rgb(frame.image);
        if self.options.mirror {
            flip_horizontal_in_place(&mut image);
        }
        Ok(Frame { index, time, image })
    }

    fn with_mask<E: From<ClipError>>(
        &mut self,
        frame: Frame,
        mask: GrayImage,
        begun: Instant,
        out: impl FnMut(Segmented) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut mask = self.mask_shrinker.gray(mask);
        let (index, picture) = (frame.index, frame.image.dimensions());
        if mask.dimensions() != picture {
            return Err(ClipError::MaskSize { index, mask: mask.dimensions(), picture }.into());
        }
        if self.options.mirror {
            flip_horizontal_in_place(&mut mask);
        }
        let parts = Silhouette::all_from_gray(&mask, &self.options.segment);
        self.hand_over(frame, parts, begun, out)
    }

    /// Learns the colours from the frames that waited, and segments these. Where they tell nothing, as before a hand has
    /// come, the next ones may; behind the last it is an error.
    fn learn<E: From<ClipError>>(
        &mut self,
        last: bool,
        mut out: impl FnMut(Segmented) -> Result<(), E>,
    ) -> Result<(), E> {
        let Way::Learning(first) = &mut self.way else { return Ok(()) };
        let begun = Instant::now();
        let waiting = std::mem::take(first);
        let stride = waiting.len().div_ceil(self.options.tuning.start.learnt.max(1)).max(1);
        let samples: Vec<RgbImage> = waiting.iter().step_by(stride).map(|f| f.image.clone()).collect();
        let learnt = Segmenter::learn_clip(&samples, self.options.segment);
        drop(samples);
        self.time += begun.elapsed();
        let mut segmenter = match learnt {
            Ok(segmenter) => Box::new(segmenter),
            Err(reason)
                if last || !self.options.learn_again || matches!(reason, VisionError::Parameter { .. }) =>
            {
                let reason = self.untaught.take().unwrap_or(reason);
                return Err(ClipError::Learn { frames: self.frames, reason }.into());
            }
            Err(reason) => {
                self.untaught = Some(reason.clone());
                for frame in waiting {
                    self.hand_over(frame, Err(reason.clone()), Instant::now(), &mut out)?;
                }
                return Ok(());
            }
        };
        for frame in waiting {
            let begun = Instant::now();
            let parts = segmenter.segment_all(&frame.image);
            self.hand_over(frame, parts, begun, &mut out)?;
        }
        self.way = Way::Colour(segmenter);
        Ok(())
    }

    fn hand_over<E>(
        &mut self,
        frame: Frame,
        parts: Result<Vec<Silhouette>, VisionError>,
        begun: Instant,
        mut out: impl FnMut(Segmented) -> Result<(), E>,
    ) -> Result<(), E> {
        let spent = begun.elapsed();
        self.time += spent;
        out(Segmented { frame, parts, sightings: None, spent })
    }

    /// Hands over the frames whose hands a finder has seen.
    fn hand_all<E>(
        &mut self,
        found: Vec<Found>,
        begun: Instant,
        mut out: impl FnMut(Segmented) -> Result<(), E>,
    ) -> Result<(), E> {
        let spent = begun.elapsed() / (found.len().max(1) as u32);
        self.time += begun.elapsed();
        for (frame, sightings, parts) in found {
            out(Segmented { frame, parts, sightings: Some(sightings), spent })?;
        }
        Ok(())
    }
}
