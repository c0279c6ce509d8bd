//! A clip from its silhouettes to its poses.

use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use image::RgbImage;

use super::hands::{Hand, Seen, Step, advance};
use super::silhouettes::Segmented;
use super::start::{
    CANDIDATES, Candidate, Opened, Waiting, alike, find_hands, fit_best, wait_for_open_hands,
};
use super::trails::{Link, Trails};
use super::{
    ClipError, ClipOptions, ClipSink, ClipTimings, FrameHand, FrameTimings, HandFrame, HandTrack, LEAST_FIT,
    TrackedClip, TrackedFrame, open_hand,
};
use crate::{OpenHand, View};
use handcast_hand::Side;
use handcast_vision::{Silhouette, VisionError, find_parts};

/// Every so many frames a second hand is looked for.
const LOOK: usize = 3;
/// Most hands.
const HANDS: usize = 2;

/// A clip being tracked.
pub(super) struct Run<'a> {
    options: &'a ClipOptions,
    sink: &'a mut dyn ClipSink,
    trails: Trails,
    hands: Vec<Hand>,
    found: Vec<Vec<HandFrame>>,
    times: Vec<f64>,
    /// Parts that may turn out to be the second hand: frame, trail, silhouette, where its fit starts.
    late: Vec<(usize, usize, Silhouette, OpenHand)>,
    track: Duration,
    /// The same of single frames.
    steps: Vec<Duration>,
}

impl<'a> Run<'a> {
    pub(super) fn new(options: &'a ClipOptions, sink: &'a mut dyn ClipSink) -> Self {
        Self {
            options,
            sink,
            trails: Trails::default(),
            hands: Vec::new(),
            found: Vec::new(),
            times: Vec::new(),
            late: Vec::new(),
            track: Duration::ZERO,
            steps: Vec::new(),
        }
    }

    /// Tracks what comes; of a second hand that opens late the frames before are left out.
    pub(super) fn clip(
        mut self,
        receiver: &Receiver<Segmented>,
        rate: Option<f64>,
    ) -> Result<TrackedClip, ClipError> {
        let sink = &mut *self.sink;
        let waiting =
            wait_for_open_hands(receiver, &mut self.trails, self.options, |index| sink.read(index))?;
        let begun = Instant::now();
        self.hands = find_hands(&waiting, self.options)?;
        self.track += begun.elapsed();
        self.found = self.hands.iter().map(|_| Vec::new()).collect();
        for hand in &self.hands {
            self.sink.fitted(&hand.start);
        }
        self.lead_in(waiting)?;
        while let Ok(Segmented { frame, parts }) = receiver.recv() {
            self.sink.read(frame.index);
            let begun = Instant::now();
            let links = self.trails.link(parts.as_deref().unwrap_or(&[]));
            let seen = Seen { parts: parts.as_deref().unwrap_or(&[]), links: &links, image: &frame.image };
            self.look_for_another(frame.index, &seen);
            let steps = advance(&mut self.hands, |_| true, &seen, self.options.threads);
            self.charge(begun);
            self.deliver(frame.index, frame.time, &frame.image, parts.as_deref(), &steps)?;
        }
        let frames = FrameTimings { track: self.steps, ..FrameTimings::default() };
        let timings = ClipTimings { track: self.track, frames, ..ClipTimings::default() };
        let hands = self.hands.into_iter().zip(self.found);
        let hands = hands.map(|(hand, frames)| HandTrack { start: hand.finished(), frames }).collect();
        Ok(TrackedClip { hands, times: self.times, rate, timings })
    }

    /// Counts the time spent on a frame.
    fn charge(&mut self, begun: Instant) {
        self.track += begun.elapsed();
        self.steps.push(begun.elapsed());
    }

    /// Tracks the frames that waited: each hand from where it starts, backwards and forwards.
    fn lead_in(&mut self, waiting: Vec<Waiting>) -> Result<(), ClipError> {
        let threads = self.options.threads;
        let mut before: Vec<Vec<Option<Step>>> = Vec::new();
        let latest = self.hands.iter().map(|h| h.start.frame).max().unwrap_or(0);
        for w in waiting.iter().rev().skip_while(|w| latest <= w.index) {
            let image = w.image()?;
            let begun = Instant::now();
            before.push(advance(&mut self.hands, |h| h.start.frame > w.index, &w.seen(&image), threads));
            self.charge(begun);
        }
        self.hands.iter_mut().for_each(Hand::rewind);
        for w in waiting {
            let image = w.image()?;
            let begun = Instant::now();
            let mut steps = advance(&mut self.hands, |h| h.start.frame <= w.index, &w.seen(&image), threads);
            for (step, earlier) in steps.iter_mut().zip(before.pop().unwrap_or_default()) {
                *step = earlier.or(step.take());
            }
            self.charge(begun);
            self.deliver(w.index, w.time, &image, w.parts.as_deref(), &steps)?;
        }
        Ok(())
    }

    /// Looks for a second hand among the parts that are none so far.
    fn look_for_another(&mut self, index: usize, seen: &Seen<'_>) {
        if self.hands.len() == HANDS || self.options.side.is_some() {
            return;
        }
        if self.hands.iter().any(Hand::is_lost) {
            // What opens may be the hand that was lost.
            self.late.clear();
            return;
        }
        let waited = self.late.first().map_or(0, |(first, ..)| index - first);
        if waited >= CANDIDATES {
            self.begin_another();
            return;
        }
        if !index.is_multiple_of(LOOK) && self.late.is_empty() {
            return;
        }
        for (part, link) in seen.parts.iter().zip(seen.links) {
            let Link::One(id) = *link else { continue };
            if self.hands.iter().any(|h| h.claims(id)) {
                continue;
            }
            if let Ok(parts) = find_parts(part, &self.options.segment.parts) {
                self.late.push((index, id, part.clone(), open_hand(&parts)));
            }
        }
    }

    /// Fits the second hand to what was found, if it is one.
    fn begin_another(&mut self) {
        let late = std::mem::take(&mut self.late);
        let candidates: Vec<Candidate> = late
            .iter()
            .map(|(index, trail, silhouette, open)| Candidate {
                index: *index,
                trail: *trail,
                silhouette,
                open,
            })
            .collect();
        let Some(trail) = candidates.last().map(|c| c.trail) else { return };
        if self.hands.iter().any(|h| h.claims(trail)) {
            return;
        }
        let group: Vec<&Candidate> = candidates.iter().filter(|c| c.trail == trail).collect();
        let Some(first) = self.hands.first() else { return };
        let thumb_right = Opened::of(&group).thumb_right;
        let side: Side = first.start.side.other();
        let how = (side, View::of(side, thumb_right), first.start.assumed);
        let Some(start) = fit_best(&group, how, self.options) else { return };
        if start.fit.as_ref().is_none_or(|fit| fit.iou < LEAST_FIT) || !alike(&first.start, &start) {
            return;
        }
        self.sink.fitted(&start);
        let hand = Hand::new(start, trail, self.options);
        self.found.push(vec![hand.not_yet(); self.times.len()]);
        self.hands.push(hand);
    }

    fn deliver(
        &mut self,
        index: usize,
        time: f64,
        image: &RgbImage,
        parts: Result<&[Silhouette], &VisionError>,
        steps: &[Option<Step>],
    ) -> Result<(), ClipError> {
        self.times.push(time);
        for ((hand, found), step) in self.hands.iter_mut().zip(&mut self.found).zip(steps) {
            found.push(match step {
                Some(step) => hand.frame(time, step),
                None => hand.not_yet(),
            });
        }
        let mut hands = Vec::with_capacity(self.hands.len());
        for ((hand, found), step) in self.hands.iter_mut().zip(&self.found).zip(steps) {
            let Some(last) = found.last() else { continue };
            let part = step.as_ref().and_then(|s| s.part);
            let silhouette = part.and_then(|p| parts.ok()?.get(p));
            let (start, model) = hand.shown();
            hands.push(FrameHand { silhouette, found: last, start, model });
        }
        let frame = TrackedFrame { index, time, image, parts, hands };
        self.sink.tracked(frame).map_err(ClipError::Sink)
    }
}
