//! The first stage: from frames to silhouettes.

use std::collections::VecDeque;
use std::time::Duration;

use image::imageops::flip_horizontal_in_place;
use image::{GrayImage, RgbImage};

use super::clock::Instant;
use super::noise::quieted;
use super::sighted::{Found, SightedSilhouettes};
use super::{ClipError, ClipOptions, StartTuning};
use handcast_media::Frame;
use handcast_picture::Shrinker;
use handcast_vision::sighting::Sighting;
use handcast_vision::{Mask, Segmenter, Silhouette, VisionError};

/// A frame at the analysis size and the silhouettes in it.
pub(super) struct Segmented {
    pub(super) frame: Frame,
    /// Parts that may be hands, largest first; never empty.
    pub(super) parts: Result<Vec<Silhouette>, VisionError>,
    /// What a finder has seen, for each of them; `None` where none looked.
    pub(super) sightings: Option<Vec<Sighting>>,
    /// Whether other colours are sought while no hand comes of these.
    pub(super) relearns: bool,
    /// Time spent on it.
    pub(super) spent: Duration,
}

/// How the search for the first hands stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Search {
    /// Something that came may be a hand.
    Open,
    /// Nothing did.
    InVain,
    /// What did is no hand.
    Refuted,
    /// Hands have been found.
    Over,
}

/// The stage behind this one.
pub(super) trait Seeker {
    type Error: From<ClipError>;

    /// Takes the next frame.
    fn take(&mut self, segmented: Segmented) -> Result<(), Self::Error>;

    /// How the search stands; behind the `last` frame it is not left open.
    fn search(&mut self, last: bool) -> Result<Search, Self::Error>;

    /// Seeks hands anew in the frames from number `since` on, which it still has, by what was learnt since. Gives that
    /// back where there is one: the frames that follow are to be segmented by it.
    fn seek_again(
        &mut self,
        learnt: Box<Segmenter>,
        since: usize,
    ) -> Result<Option<Box<Segmenter>>, Self::Error>;
}

/// Some of the last frames, from which colours are learnt anew while the search for hands is in vain.
#[derive(Default)]
struct Recent {
    pictures: VecDeque<RgbImage>,
    /// What was found in each.
    found: VecDeque<Mask>,
    /// Frames since colours were learnt.
    frames: usize,
}

impl Recent {
    /// Adds a picture and what was found in it, and forgets all but the `most` newest.
    fn add(&mut self, picture: &RgbImage, parts: &Result<Vec<Silhouette>, VisionError>, most: usize) {
        let mut found = Mask::new(picture.width(), picture.height());
        parts.iter().flatten().for_each(|part| found.union_with(&part.arm));
        self.pictures.push_back(picture.clone());
        self.found.push_back(found);
        let over = self.pictures.len().saturating_sub(most.max(1));
        self.pictures.drain(..over);
        self.found.drain(..over);
    }
}

/// Finds the silhouettes of frames: those of the masks that come with them, else those of skin, whose colours are
/// learnt from the first frames, and anew as long as no hand is found. Keeps no frames but those it learns from.
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
    /// Until hands have been found by colours.
    recent: Option<Recent>,
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
            recent: (options.finder.is_none() && options.learn_again).then(Recent::default),
            time: Duration::ZERO,
        }
    }

    /// Time spent so far.
    pub(super) fn time(&self) -> Duration {
        self.time
    }

    /// Most hands that a finder saw in a frame beside the two that are tracked at most.
    pub(super) fn further(&self) -> usize {
        match &self.way {
            Way::Sighted(sighted) => sighted.further(),
            _ => 0,
        }
    }

    /// Takes a frame of any size, with its mask where masks are ready, and gives `next` those whose silhouettes are
    /// found: numbered as they came. The first ones wait until there are enough to learn from.
    pub(super) fn push<S: Seeker>(
        &mut self,
        frame: Frame,
        mask: Option<GrayImage>,
        next: &mut S,
    ) -> Result<(), S::Error> {
        let begun = Instant::now();
        let frame = self.prepared(frame)?;
        if (frame.index, mask.is_some()) == (0, true) {
            self.way = Way::Masks;
            self.recent = None;
        }
        match (&mut self.way, mask) {
            (Way::Masks, Some(mask)) => self.with_mask(frame, mask, begun, next),
            (Way::Learning(first), None) => {
                first.push_back(frame);
                let enough = first.len() >= self.options.learning_frames.max(1);
                self.time += begun.elapsed();
                if enough { self.learn(false, next) } else { Ok(()) }
            }
            (Way::Sighted(sighted), None) => {
                let index = frame.index;
                let found = sighted.push(frame).map_err(|reason| ClipError::Find { index, reason })?;
                self.hand_all(found, begun, next)
            }
            (Way::Colour(segmenter), None) => {
                let parts = segmenter.segment_all(&frame.image);
                let start = &self.options.tuning.start;
                if let Some(recent) = &mut self.recent {
                    recent.frames += 1;
                    if frame.index.is_multiple_of(stride(self.options.learning_frames, start)) {
                        recent.add(&frame.image, &parts, start.remembered);
                    }
                }
                self.hand_over(frame, parts, begun, next)?;
                self.learn_again(false, next)
            }
            _ => Err(ClipError::MixedMasks { index: frame.index }.into()),
        }
    }

    /// No more frames come: those that waited are learnt from as they are.
    pub(super) fn finish<S: Seeker>(&mut self, next: &mut S) -> Result<(), S::Error> {
        match &mut self.way {
            Way::Sighted(sighted) => {
                let begun = Instant::now();
                let index = self.frames.saturating_sub(1);
                let found = sighted.rest().map_err(|reason| ClipError::Find { index, reason })?;
                self.hand_all(found, begun, next)
            }
            Way::Learning(_) if self.frames > 0 => self.learn(true, next),
            Way::Colour(_) => self.learn_again(true, next),
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

    /// The frame with its number, at the analysis size, without much noise, mirrored if asked for.
    fn prepared(&mut self, frame: Frame) -> Result<Frame, ClipError> {
        self.check(&frame)?;
        let (index, time, size) = (self.frames, frame.time, frame.image.dimensions());
        self.last = Some((size, time));
        self.frames += 1;
        let image = self.shrinker.rgb(frame.image);
        let mut image = quieted(image, self.options.finder.is_some(), &self.options.tuning.noise);
        if self.options.mirror {
            flip_horizontal_in_place(&mut image);
        }
        Ok(Frame { index, time, image })
    }

    fn with_mask<S: Seeker>(
        &mut self,
        frame: Frame,
        mask: GrayImage,
        begun: Instant,
        next: &mut S,
    ) -> Result<(), S::Error> {
        let mut mask = self.mask_shrinker.gray(mask);
        let (index, picture) = (frame.index, frame.image.dimensions());
        if mask.dimensions() != picture {
            return Err(ClipError::MaskSize { index, mask: mask.dimensions(), picture }.into());
        }
        if self.options.mirror {
            flip_horizontal_in_place(&mut mask);
        }
        let parts = Silhouette::all_from_gray(&mask, &self.options.segment);
        self.hand_over(frame, parts, begun, next)
    }

    /// Learns the colours from the frames that waited, and segments these. Where they tell nothing, as before a hand has
    /// come, the next ones may; behind the last it is an error.
    fn learn<S: Seeker>(&mut self, last: bool, next: &mut S) -> Result<(), S::Error> {
        let Way::Learning(first) = &mut self.way else { return Ok(()) };
        let begun = Instant::now();
        let waiting = std::mem::take(first);
        let start = &self.options.tuning.start;
        let (stride, remembered) = (stride(waiting.len(), start), start.remembered);
        let samples: Vec<RgbImage> = waiting.iter().step_by(stride).map(|f| f.image.clone()).collect();
        let learnt = Segmenter::learn_clip(&samples, self.options.segment);
        self.time += begun.elapsed();
        let mut learnt = match learnt {
            Ok(segmenter) => Ok(Box::new(segmenter)),
            Err(reason)
                if last || !self.options.learn_again || matches!(reason, VisionError::Parameter { .. }) =>
            {
                let reason = self.untaught.take().unwrap_or(reason);
                return Err(ClipError::Learn { frames: self.frames, reason }.into());
            }
            Err(reason) => Err(self.untaught.insert(reason).clone()),
        };
        for (i, frame) in waiting.into_iter().enumerate() {
            let begun = Instant::now();
            let parts = match &mut learnt {
                Ok(segmenter) => segmenter.segment_all(&frame.image),
                Err(reason) => Err(reason.clone()),
            };
            if let Some(recent) = self.recent.as_mut().filter(|_| i.is_multiple_of(stride)) {
                recent.add(&frame.image, &parts, remembered);
            }
            self.hand_over(frame, parts, begun, next)?;
        }
        if let Ok(segmenter) = learnt {
            self.way = Way::Colour(segmenter);
        }
        Ok(())
    }

    /// Learns the colours anew from the frames of late, where there are enough since they were learnt and no hand came of
    /// them: one may have come in since.
    fn learn_again<S: Seeker>(&mut self, last: bool, next: &mut S) -> Result<(), S::Error> {
        let (Way::Colour(segmenter), Some(recent)) = (&mut self.way, &mut self.recent) else { return Ok(()) };
        let due = if last { 1 } else { self.options.learning_frames.max(1) };
        if recent.frames < due {
            return Ok(());
        }
        match next.search(last)? {
            Search::Over => self.recent = None,
            Search::Open => {}
            search @ (Search::InVain | Search::Refuted) => {
                recent.frames = 0;
                let start = &self.options.tuning.start;
                let span = start.remembered * stride(self.options.learning_frames, start);
                let since = self.frames.saturating_sub(span);
                let (pictures, found) =
                    (&*recent.pictures.make_contiguous(), &*recent.found.make_contiguous());
                // The camera may have been put up since the first of them.
                let newest = pictures.len().saturating_sub(start.learnt);
                let all = (newest > 0).then_some((0, false));
                for (from, alone) in all.into_iter().chain([(newest, true)]) {
                    let begun = Instant::now();
                    let (pictures, found) = (&pictures[from..], &found[from..]);
                    // Colours by which something opens that is none may show too much.
                    let found = (search == Search::InVain).then_some(found);
                    let learnt = segmenter.learn_entrance(pictures, found, alone);
                    self.time += begun.elapsed();
                    // That nothing can be learnt is no news: the search was in vain.
                    let Ok(Some(learnt)) = learnt else { continue };
                    if let Some(learnt) = next.seek_again(Box::new(learnt), since)? {
                        *segmenter = learnt;
                        break;
                    }
                }
            }
        }
        Ok(())
    }

    fn hand_over<S: Seeker>(
        &mut self,
        frame: Frame,
        parts: Result<Vec<Silhouette>, VisionError>,
        begun: Instant,
        next: &mut S,
    ) -> Result<(), S::Error> {
        let spent = begun.elapsed();
        self.time += spent;
        next.take(Segmented { frame, parts, sightings: None, relearns: self.recent.is_some(), spent })
    }

    /// Hands over the frames whose hands a finder has seen.
    fn hand_all<S: Seeker>(
        &mut self,
        found: Vec<Found>,
        begun: Instant,
        next: &mut S,
    ) -> Result<(), S::Error> {
        let spent = begun.elapsed() / (found.len().max(1) as u32);
        self.time += begun.elapsed();
        for (frame, sightings, parts) in found {
            next.take(Segmented { frame, parts, sightings: Some(sightings), relearns: false, spent })?;
        }
        Ok(())
    }
}

/// Every so many of so many frames colours are learnt from.
fn stride(frames: usize, start: &StartTuning) -> usize {
    frames.div_ceil(start.learnt.max(1)).max(1)
}
