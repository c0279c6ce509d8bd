//! The second stage: from silhouettes to poses.

use std::time::Duration;

use image::RgbImage;

use super::clock::Instant;
use super::hands::{Hand, Seen, Step, advance, not_yet};
use super::sighted::{SightedTrails, from_sighting};
use super::silhouettes::{Search, Segmented};
use super::skin::SkinSamples;
use super::start::{Candidate, Lookout, Opened, Waiting, alike, fit_best};
use super::trails::{Link, Trails};
use super::{
    ClipError, ClipOptions, ClipSink, FrameHand, HandFrame, HandStart, StageTimes, TrackedFrame, open_hand,
};
use crate::{SizeMismatch, View};
use handcast_vision::{Segmenter, Silhouette, VisionError, find_parts};

/// Most hands.
const HANDS: usize = 2;

/// Tracks the hands in segmented frames. Keeps no frames but those that wait for the first hands.
pub(super) struct HandStage {
    options: ClipOptions,
    trails: Trails,
    sighted: SightedTrails,
    /// Until the first hands are found.
    lookout: Option<Lookout>,
    hands: Vec<Hand>,
    /// Parts that may turn out to be the second hand.
    late: Vec<Candidate>,
    skin: SkinSamples,
    time: Duration,
}

/// A frame of which all is known but the poses.
struct Unposed<'a> {
    index: usize,
    time: f64,
    image: &'a RgbImage,
    parts: Result<&'a [Silhouette], &'a VisionError>,
    spent: StageTimes,
}

impl HandStage {
    pub(super) fn options(&self) -> &ClipOptions {
        &self.options
    }

    pub(super) fn new(options: &ClipOptions) -> Self {
        Self {
            options: options.clone(),
            trails: Trails::new(options.tuning.trails),
            sighted: SightedTrails::new(options.tuning.sighted),
            lookout: Some(Lookout::default()),
            hands: Vec::new(),
            late: Vec::new(),
            skin: SkinSamples::new(),
            time: Duration::ZERO,
        }
    }

    /// The hands found so far, with their sizes as refined so far.
    pub(super) fn hands(&self) -> Vec<HandStart> {
        self.hands.iter().map(Hand::refined).collect()
    }

    /// Tone of the skin of the hands shown so far, 1 to 10, where one was sure.
    pub(super) fn skin_tone(&self) -> Option<u8> {
        self.skin.tone()
    }

    /// Time spent so far.
    pub(super) fn time(&self) -> Duration {
        self.time
    }

    /// Takes the next frame and gives `sink` those that can be tracked.
    pub(super) fn push(&mut self, segmented: Segmented, sink: &mut dyn ClipSink) -> Result<(), ClipError> {
        sink.read(segmented.frame.index).map_err(ClipError::Sink)?;
        let begun = Instant::now();
        if segmented.sightings.is_none() {
            // Ready masks come before a finder.
            self.options.finder = None;
        }
        let (links, known) = match self.options.finder {
            Some(_) => self.sighted.link(segmented.sightings.as_deref().unwrap_or(&[])),
            None => (self.trails.link(segmented.parts.as_deref().unwrap_or(&[])), Vec::new()),
        };
        if let Some(lookout) = &mut self.lookout {
            let enough = lookout.add(segmented, links, known, &self.options)?;
            self.time += begun.elapsed();
            return if enough { self.begin(false, sink) } else { Ok(()) };
        }
        let Segmented { frame, parts, sightings, spent, .. } = segmented;
        let parts = parts.as_deref();
        let seen = Seen {
            parts: parts.unwrap_or(&[]),
            links: &links,
            sightings: sightings.as_deref().unwrap_or(&[]),
            known: &known,
            image: &frame.image,
        };
        self.mend_side(frame.index, &seen, sink);
        self.look_for_another(frame.index, &seen, sink);
        let steps = advance(&mut self.hands, |_| true, &seen, &self.options);
        let steps = steps.map_err(|reason| unlike(frame.index, reason))?;
        let spent = StageTimes { segment: spent, track: begun.elapsed() };
        self.time += spent.track;
        let (index, time, image) = (frame.index, frame.time, &frame.image);
        self.deliver(Unposed { index, time, image, parts, spent }, &steps, sink)
    }

    /// No more frames come: the hands are sought in those that waited.
    pub(super) fn finish(&mut self, sink: &mut dyn ClipSink) -> Result<(), ClipError> {
        self.begin_at_end(true, sink)
    }

    /// How the search for the first hands stands; behind the `last` frame they begin with what is open.
    pub(super) fn search(&mut self, last: bool, sink: &mut dyn ClipSink) -> Result<Search, ClipError> {
        if last && self.lookout.as_ref().is_some_and(Lookout::may_begin) {
            self.begin_at_end(false, sink)?;
        }
        Ok(self.lookout.as_mut().map_or(Search::Over, |lookout| lookout.search(last)))
    }

    /// Seeks hands anew in the frames that wait, from number `since` on, by what was learnt since; gives that back where it
    /// shows one.
    pub(super) fn seek_again(
        &mut self,
        learnt: Box<Segmenter>,
        since: usize,
    ) -> Result<Option<Box<Segmenter>>, ClipError> {
        let Some(lookout) = &mut self.lookout else { return Ok(None) };
        let begun = Instant::now();
        let found = lookout.look_again(&learnt, since, &self.options)?;
        self.time += begun.elapsed();
        Ok(found.map(|(trails, segmenter)| {
            self.trails = trails;
            segmenter
        }))
    }

    /// As [`Self::begin`] where no more frames come that could tell palm and back apart.
    fn begin_at_end(&mut self, last: bool, sink: &mut dyn ClipSink) -> Result<(), ClipError> {
        if let Some(lookout) = self.lookout.as_mut().filter(|lookout| lookout.is_open()) {
            let begun = Instant::now();
            lookout.is_settled(&self.options)?;
            self.time += begun.elapsed();
        }
        self.begin(last, sink)
    }

    /// Finds the first hands in the frames that waited and tracks these. Where what is open is none, the search goes on
    /// until the `last` frame.
    fn begin(&mut self, last: bool, sink: &mut dyn ClipSink) -> Result<(), ClipError> {
        let Some(mut lookout) = self.lookout.take() else { return Ok(()) };
        let begun = Instant::now();
        let hands = lookout.hands(&self.options);
        self.time += begun.elapsed();
        self.hands = match hands {
            Err(reason) if !last && lookout.goes_on(&self.options) => {
                lookout.pass_over(reason);
                self.lookout = Some(lookout);
                return Ok(());
            }
            Err(reason) => return Err(lookout.first_failure(reason)),
            Ok(hands) => hands,
        };
        let waiting = lookout.into_waiting();
        for hand in &self.hands {
            sink.fitted(&hand.start);
        }
        self.lead_in(waiting, sink)
    }

    /// Tracks the frames that waited: each hand from where it starts, backwards and forwards.
    fn lead_in(&mut self, waiting: Vec<Waiting>, sink: &mut dyn ClipSink) -> Result<(), ClipError> {
        let mut before: Vec<(Vec<Option<Step>>, Duration)> = Vec::new();
        let latest = self.hands.iter().map(|h| h.start.frame).max().unwrap_or(0);
        for w in waiting.iter().rev().skip_while(|w| latest <= w.index) {
            let image = w.image()?;
            before.push(self.step(w, &image, |h| h.start.frame > w.index)?);
        }
        self.hands.iter_mut().for_each(Hand::rewind);
        for w in waiting {
            let image = w.image()?;
            let (mut steps, mut track) = self.step(&w, &image, |h| h.start.frame <= w.index)?;
            if let Some((earlier, spent)) = before.pop() {
                track += spent;
                for (step, earlier) in steps.iter_mut().zip(earlier) {
                    *step = earlier.or(step.take());
                }
            }
            let spent = StageTimes { segment: w.segment, track };
            let (index, time, parts) = (w.index, w.time, w.parts.as_deref());
            self.deliver(Unposed { index, time, image: &image, parts, spent }, &steps, sink)?;
        }
        Ok(())
    }

    /// A step of the hands that are `active`, on a frame that waited, and the time it took.
    fn step(
        &mut self,
        w: &Waiting,
        image: &RgbImage,
        active: impl Fn(&Hand) -> bool,
    ) -> Result<(Vec<Option<Step>>, Duration), ClipError> {
        let begun = Instant::now();
        let steps = advance(&mut self.hands, active, &w.seen(image), &self.options);
        let steps = steps.map_err(|reason| unlike(w.index, reason))?;
        self.time += begun.elapsed();
        Ok((steps, begun.elapsed()))
    }

    /// Looks for a second hand among the parts that are none so far.
    fn look_for_another(&mut self, index: usize, seen: &Seen<'_>, sink: &mut dyn ClipSink) {
        let active = self.hands.iter().filter(|hand| hand.is_active()).count();
        if active == HANDS || self.options.side.is_some() {
            return;
        }
        if self.hands.iter().any(Hand::is_lost) {
            // What opens may be the hand that was lost.
            self.late.clear();
            return;
        }
        if self.options.finder.is_some() {
            return self.another_seen(index, seen, sink);
        }
        let waited = self.late.first().map_or(0, |first| index - first.index);
        if waited >= self.options.tuning.start.candidates {
            self.begin_another(sink);
            return;
        }
        if !index.is_multiple_of(self.options.tuning.start.look) && self.late.is_empty() {
            return;
        }
        for (part, link) in seen.parts.iter().zip(seen.links) {
            let Link::One(id) = *link else { continue };
            if self.hands.iter().any(|h| h.claims(id)) {
                continue;
            }
            if let Ok(parts) = find_parts(part, None, &self.options.segment.parts) {
                self.late.push(Candidate::new(index, id, part, open_hand(&parts)));
            }
        }
    }

    /// Goes on with a hand as one of the other side, where the sightings so far tell that it is.
    fn mend_side(&mut self, index: usize, seen: &Seen<'_>, sink: &mut dyn ClipSink) {
        // Once: there is room for two hands.
        let [hand] = &mut self.hands[..] else { return };
        if self.options.finder.is_none() || self.options.side.is_some() {
            return;
        }
        let own = |link: &Link| hand.trail().is_some_and(|id| *link == Link::One(id));
        let Some(p) = seen.links.iter().position(own) else { return };
        let (Some(known), Some(part), Some(sighting)) =
            (seen.known.get(p), seen.parts.get(p), seen.sightings.get(p))
        else {
            return;
        };
        let side = hand.start.side;
        if sighting.presence <= 0.0 || known.against(side) < self.options.tuning.sighted.settled_odds {
            return;
        }
        let Some(id) = hand.trail() else { return };
        hand.retire();
        let start = from_sighting(index, part, sighting, side.other(), &self.options);
        sink.fitted(&start);
        self.hands.push(Hand::new(start, id, &self.options));
    }

    /// Begins the second hand with one that a finder has seen for some frames, of the other side.
    fn another_seen(&mut self, index: usize, seen: &Seen<'_>, sink: &mut dyn ClipSink) {
        // One that turned out to be of the other side keeps its place.
        if self.hands.len() == HANDS {
            return;
        }
        let t = self.options.tuning.sighted;
        let Some(side) = self.hands.iter().find(|h| h.is_active()).map(|h| h.start.side.other()) else {
            return;
        };
        for (p, (link, known)) in seen.links.iter().zip(seen.known).enumerate() {
            let Link::One(id) = *link else { continue };
            let free = !self.hands.iter().any(|hand| hand.claims(id));
            if known.is_hand(&t)
                && free
                && known.against(side) <= t.sure_odds
                && let (Some(part), Some(hand)) = (seen.parts.get(p), seen.sightings.get(p))
                && hand.presence > 0.0
            {
                let start = from_sighting(index, part, hand, side, &self.options);
                sink.fitted(&start);
                self.hands.push(Hand::new(start, id, &self.options));
                return;
            }
        }
    }

    /// Begins the second hand with what was found, if it is one.
    fn begin_another(&mut self, sink: &mut dyn ClipSink) {
        let mut candidates = std::mem::take(&mut self.late);
        let Some(trail) = candidates.last().map(|c| c.trail) else { return };
        if self.hands.iter().any(|h| h.claims(trail)) {
            return;
        }
        let Some(first) = self.hands.first() else { return };
        let (group, how) = second(&candidates, trail, &first.start);
        let Some(start) = fit_best(&mut candidates, &group, how, &self.options) else { return };
        if start.fit.as_ref().is_none_or(|fit| fit.iou < self.options.tuning.start.least_fit)
            || !alike(&first.start, &start, &self.options)
        {
            return;
        }
        sink.fitted(&start);
        self.hands.push(Hand::new(start, trail, &self.options));
    }

    fn deliver(
        &mut self,
        frame: Unposed<'_>,
        steps: &[Option<Step>],
        sink: &mut dyn ClipSink,
    ) -> Result<(), ClipError> {
        let Unposed { index, time, image, parts, spent } = frame;
        let found: Vec<HandFrame> = self
            .hands
            .iter_mut()
            .zip(steps)
            .map(|(hand, step)| match step {
                Some(step) => hand.frame(time, step),
                None => not_yet(&hand.start),
            })
            .collect();
        let hands = self.hands.iter_mut().zip(steps).zip(&found).map(|((hand, step), found)| {
            let part = step.as_ref().and_then(|s| s.part);
            let silhouette = part.and_then(|p| parts.ok()?.get(p));
            let (start, model) = hand.shown();
            FrameHand { silhouette, found, start, model }
        });
        let hands = hands.collect();
        let frame = TrackedFrame { index, time, image, parts, hands, spent };
        self.skin.take(&frame);
        sink.tracked(frame).map_err(ClipError::Sink)
    }
}

fn unlike(index: usize, reason: SizeMismatch) -> ClipError {
    ClipError::Unlike { index, reason }
}

/// The candidates on one trail for a second hand beside the first, and what it is taken for.
fn second(candidates: &[Candidate], trail: usize, first: &HandStart) -> (Vec<usize>, super::start::How) {
    let group: Vec<usize> = (0..candidates.len()).filter(|&i| candidates[i].trail == trail).collect();
    let thumb_right = Opened::of(group.iter().map(|&i| &candidates[i])).thumb_right;
    let side = first.side.other();
    (group, (side, View::of(side, thumb_right), first.assumed))
}
