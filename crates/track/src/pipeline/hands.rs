//! The hands of a clip: which part of a frame is which hand, and its tracker.

use image::RgbImage;
use nalgebra::Vector3;

use super::sighted::Known;
use super::trails::Link;
use super::{ClipOptions, HandFrame, HandStart, HandsTuning};
use crate::register::Registered;
use crate::{
    Confidence, Forearm, HandModel, HandTracker, ModelState, SizeMismatch, TrackedState, TrackerOptions,
};
use handcast_hand::smooth::PoseSmoother;
use handcast_hand::{Absence, FreeAngles, HandPose};
use handcast_vision::sighting::Sighting;
use handcast_vision::{Mask, PartsTuning, Silhouette, find_parts};

/// Parts that are remembered as others than the hand's.
const MOST_OTHERS: usize = 64;

/// A frame as the hands see it.
pub(super) struct Seen<'a> {
    pub(super) parts: &'a [Silhouette],
    /// The numbers of the parts.
    pub(super) links: &'a [Link],
    /// What a finder has seen, and what is known of it, for each part; empty without one.
    pub(super) sightings: &'a [Sighting],
    pub(super) known: &'a [Known],
    pub(super) image: &'a RgbImage,
}

impl<'a> Seen<'a> {
    /// What a finder has seen of the part; `None` where it is only kept where it was.
    fn sighting(&self, sight: Sight) -> Option<&'a Sighting> {
        let Sight::Part(p) = sight else { return None };
        self.sightings.get(p).filter(|hand| hand.presence > 0.0)
    }
}

/// What one hand found in a frame.
#[derive(Clone, Debug)]
pub(super) struct Step {
    pub(super) tracked: TrackedState,
    pub(super) confidence: f64,
    pub(super) absent: Option<Absence>,
    /// Number of the part it was registered on.
    pub(super) part: Option<usize>,
}

/// What a hand is to look at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sight {
    Part(usize),
    Nothing,
    Touching,
}

/// One hand and its tracker.
pub(super) struct Hand {
    pub(super) start: HandStart,
    tracker: HandTracker,
    confidence: Confidence,
    smoother: Option<PoseSmoother>,
    /// The trail in the frame it starts from, and now.
    home: usize,
    trail: Option<usize>,
    /// Trails seen beside its own: they are something else.
    others: Vec<usize>,
    lost: usize,
    touched: bool,
    /// Whether it has touched the other since the two were last told apart.
    mixed: bool,
    /// Whether it turned out to be one of the other side: it is tracked as that from then on.
    retired: bool,
    /// How an open hand is told, while nothing has shown that it is a hand at all.
    unproven: Option<PartsTuning>,
    /// Confidence that it has until then, at most.
    unproven_confidence: f64,
}

impl Hand {
    /// A hand that starts as `start` says, in the part numbered `trail`.
    pub(super) fn new(start: HandStart, trail: usize, options: &ClipOptions) -> Self {
        let mut tracker_options: TrackerOptions = options.tracker.clone();
        tracker_options.camera = Some(start.camera);
        // The sizes of a known person are known.
        tracker_options.registration.refine_sizes &= options.person.is_none();
        let lost_iou = tracker_options.lost_iou;
        let mut tracker = match &start.fit {
            Some(fit) => HandTracker::new(fit, tracker_options),
            None if let Some(open) = &start.seen => {
                HandTracker::from_state(&start.morphology, start.side, open.clone(), tracker_options)
            }
            None => HandTracker::without_fit(&start.morphology, start.side, start.view, tracker_options),
        };
        if options.finder.is_some() {
            tracker.cut_at_wrist();
        }
        Self {
            tracker,
            confidence: Confidence::tuned(&start.morphology, start.side, lost_iou, options.confidence)
                .within(start.camera.width, start.camera.height),
            smoother: options.smooth.map(PoseSmoother::new),
            home: trail,
            trail: Some(trail),
            others: Vec::new(),
            lost: 0,
            touched: false,
            mixed: false,
            retired: false,
            unproven: (start.fit.is_none() && start.seen.is_none() && options.person.is_none())
                .then_some(options.segment.parts),
            unproven_confidence: options.tuning.hands.unproven,
            start,
        }
    }

    /// How it started, with the sizes as refined since.
    pub(super) fn refined(&self) -> HandStart {
        HandStart { morphology: self.tracker.morphology().clone(), ..self.start.clone() }
    }

    /// Back to where it started, to go in the other direction of time.
    pub(super) fn rewind(&mut self) {
        self.tracker.rewind();
        self.confidence.reset();
        self.trail = Some(self.home);
        self.lost = 0;
        (self.touched, self.mixed) = (false, false);
    }

    /// How it started, and the model, to project or draw it.
    pub(super) fn shown(&mut self) -> (&HandStart, &mut HandModel) {
        (&self.start, self.tracker.model_mut())
    }

    /// What is told of a step; steps must come in order of time.
    pub(super) fn frame(&mut self, time: f64, step: &Step) -> HandFrame {
        let raw = step.tracked.state.to_pose(self.start.side, &self.start.camera);
        let pose = self.smoothed(time, raw, step.tracked.valid);
        HandFrame { tracked: step.tracked.clone(), pose, confidence: step.confidence, absent: step.absent }
    }

    fn smoothed(&mut self, time: f64, raw: HandPose, valid: bool) -> HandPose {
        let Some(smoother) = &mut self.smoother else { return raw };
        smoother.next(time, valid.then_some(&raw)).unwrap_or(raw)
    }

    /// Whether the trail is, or was, this hand's.
    pub(super) fn claims(&self, id: usize) -> bool {
        !self.retired && (self.trail == Some(id) || self.home == id)
    }

    /// Whether it is tracked.
    pub(super) fn is_active(&self) -> bool {
        !self.retired
    }

    /// Gives it up: it is one of the other side.
    pub(super) fn retire(&mut self) {
        self.retired = true;
        self.trail = None;
    }

    /// The number of the part it was last found in.
    pub(super) fn trail(&self) -> Option<usize> {
        self.trail
    }

    /// How the last frame was explained: see [`HandTracker::found`].
    pub(super) fn found(&self) -> Option<Registered> {
        self.tracker.found()
    }

    /// Largest difference of a joint angle from the open hand in the last frame, radians.
    pub(super) fn bent(&self) -> f64 {
        self.tracker.bent()
    }

    /// Its free angles in the last frame, radians.
    pub(super) fn free(&self) -> FreeAngles {
        self.tracker.free()
    }

    fn look(&mut self, sight: Sight, seen: &Seen<'_>) -> Result<Step, SizeMismatch> {
        let camera = self.start.camera;
        let seen_part = match sight {
            Sight::Part(p) => seen.parts.get(p),
            // While it is held the tracker is told that nothing was seen: what comes after is found anew.
            Sight::Nothing | Sight::Touching => None,
        };
        let tracked = match seen_part {
            Some(part) => track(&mut self.tracker, part, seen.sighting(sight), seen.image)?,
            None => self.tracker.track(&Mask::new(camera.width, camera.height), None, None)?,
        };
        let mut confidence = self.confidence.of(&tracked);
        if let Some(parts) = &self.unproven {
            match seen_part.filter(|_| tracked.valid).map(|part| find_parts(part, None, parts)) {
                Some(Ok(_)) => self.unproven = None,
                _ => confidence = confidence.min(self.unproven_confidence),
            }
        }
        let absent = match sight {
            Sight::Touching => Some(Absence::Touching),
            _ => (!tracked.valid).then_some(Absence::Lost),
        };
        self.touched = sight == Sight::Touching;
        self.mixed |= self.touched;
        self.lost = if tracked.valid || self.touched { 0 } else { self.lost + 1 };
        let part = match sight {
            Sight::Part(p) => Some(p),
            _ => None,
        };
        if let (true, Some(Link::One(id))) = (tracked.valid, part.and_then(|p| seen.links.get(p))) {
            self.trail = Some(*id);
            // What is seen while it is only held where it was may be this hand.
            if seen.sightings.is_empty() || seen.sighting(sight).is_some() {
                self.remember_others(*id, seen.links);
            }
        }
        Ok(Step { tracked, confidence, absent, part })
    }

    fn remember_others(&mut self, own: usize, links: &[Link]) {
        self.others.retain(|&id| id != own);
        for link in links {
            if let Link::One(id) = *link
                && id != own
                && !self.others.contains(&id)
            {
                if self.others.len() == MOST_OTHERS {
                    self.others.remove(0);
                }
                self.others.push(id);
            }
        }
    }

    /// Whether it was not found in the last frame.
    pub(super) fn is_lost(&self) -> bool {
        !self.retired && (self.lost > 0 || self.touched)
    }

    /// The overlap it would reach in a part.
    fn overlap_in(
        &self,
        part: &Silhouette,
        sighting: Option<&Sighting>,
        image: &RgbImage,
    ) -> Result<f64, SizeMismatch> {
        Ok(track(&mut self.tracker.clone(), part, sighting, image)?.iou)
    }
}

/// What there is to tell of a frame before the hand had been seen open.
pub(super) fn not_yet(start: &HandStart) -> HandFrame {
    let far = Vector3::new(0.0, 0.0, -1.0);
    let neutral = HandPose { translation: far, ..HandPose::neutral(start.side) };
    let pose = match &start.fit {
        Some(fit) => fit.state.to_pose(start.side, &start.camera),
        None => neutral,
    };
    let state = ModelState::from_pose(&pose, &start.camera);
    let tracked =
        TrackedState { state, iou: 0.0, valid: false, evaluations: 0, restarted: false, joints_away: None };
    HandFrame { tracked, pose, confidence: 0.0, absent: Some(Absence::NotYet) }
}

fn track(
    tracker: &mut HandTracker,
    part: &Silhouette,
    sighting: Option<&Sighting>,
    image: &RgbImage,
) -> Result<TrackedState, SizeMismatch> {
    let forearm = part.wrist.as_ref().map(Forearm::from);
    tracker.track_sighted(&part.hand, forearm, Some(image), sighting)
}

/// Each of the hands that are `active` looks at the frame: at its own part, or at one that may be it when it has
/// none. Gives a step for each active hand. Two hands look at the same time when [`ClipOptions::threads`] allows.
pub(super) fn advance(
    hands: &mut [Hand],
    active: impl Fn(&Hand) -> bool,
    seen: &Seen<'_>,
    options: &ClipOptions,
) -> Result<Vec<Option<Step>>, SizeMismatch> {
    let wanted: Vec<bool> = hands.iter().map(active).collect();
    let tuning = &options.tuning.hands;
    exchange_after_touch(hands, seen, tuning)?;
    let sights = sights(hands, &wanted, seen, options)?;
    let look =
        |(hand, sight): (&mut Hand, Option<Sight>)| sight.map(|sight| hand.look(sight, seen)).transpose();
    if options.threads > 1
        && sights.iter().flatten().count() > 1
        && let ([first, second], [one, two]) = (&mut *hands, &sights[..])
    {
        let (one, two) = (*one, *two);
        let done = std::thread::scope(|scope| {
            let other = std::thread::Builder::new().spawn_scoped(scope, || look((&mut *second, two)));
            let here = look((&mut *first, one));
            other.map(|other| (here, other.join()))
        });
        return match done {
            Ok((here, Ok(there))) => Ok(vec![here?, there?]),
            // A thread that died has said why; its hand is lost in this frame.
            Ok((here, Err(_))) => Ok(vec![here?, look((second, two.map(|_| Sight::Nothing)))?]),
            Err(_) => Ok(vec![look((first, one))?, look((second, two))?]),
        };
    }
    hands.iter_mut().zip(sights).map(look).collect()
}

/// What each of the wanted hands looks at.
fn sights(
    hands: &[Hand],
    wanted: &[bool],
    seen: &Seen<'_>,
    options: &ClipOptions,
) -> Result<Vec<Option<Sight>>, SizeMismatch> {
    let (tuning, sighted) = (&options.tuning.hands, &options.tuning.sighted);
    let part_of = |id: usize| seen.links.iter().position(|link| link.holds(id));
    let mut sights: Vec<Option<Sight>> = Vec::with_capacity(hands.len());
    for (h, hand) in hands.iter().enumerate() {
        if hand.retired {
            sights.push(Some(Sight::Nothing));
            continue;
        }
        let own = hand.trail.and_then(part_of).filter(|_| hand.lost < tuning.faithful);
        sights.push(own.map(|p| match seen.links[p] {
            Link::Joined(two) => {
                let both = hands.iter().enumerate().any(|(k, other)| {
                    k != h && two.iter().any(|&id| Some(id) == other.trail && Some(id) != hand.trail)
                });
                if both { Sight::Touching } else { Sight::Part(p) }
            }
            Link::One(_) => Sight::Part(p),
        }));
    }
    let taken = |p: usize, sights: &[Option<Sight>]| sights.contains(&Some(Sight::Part(p)));
    for h in 0..hands.len() {
        if sights[h].is_some() || !wanted[h] {
            continue;
        }
        let other = |p: usize| {
            options.side.is_none()
                && seen.known.get(p).is_some_and(|k| k.against(hands[h].start.side) > sighted.sure_odds)
        };
        let may_be = |p: &usize| match seen.links[*p] {
            _ if other(*p) => false,
            Link::One(id) => !hands[h].others.contains(&id),
            Link::Joined(_) => hands.len() == 1,
        };
        let free: Vec<usize> = (0..seen.parts.len()).filter(|&p| !taken(p, &sights)).filter(may_be).collect();
        sights[h] = Some(match free[..] {
            [] => Sight::Nothing,
            [only] => Sight::Part(only),
            _ => {
                let overlap = |&p: &usize| {
                    let sighting = seen.sighting(Sight::Part(p));
                    Ok((hands[h].overlap_in(&seen.parts[p], sighting, seen.image)?, p))
                };
                let overlaps = free.iter().map(overlap).collect::<Result<Vec<_>, _>>()?;
                let best = overlaps.into_iter().max_by(|a, b| a.0.total_cmp(&b.0));
                best.map_or(Sight::Nothing, |(_, p)| Sight::Part(p))
            }
        });
    }
    for (sight, wanted) in sights.iter_mut().zip(wanted) {
        sight.take_if(|_| !wanted);
    }
    Ok(sights)
}

/// Where two hands come apart after touching, their places may be exchanged: if each fits better in the other's
/// part, it is the other.
fn exchange_after_touch(
    hands: &mut [Hand],
    seen: &Seen<'_>,
    tuning: &HandsTuning,
) -> Result<(), SizeMismatch> {
    let [a, b] = hands else { return Ok(()) };
    let apart: Vec<(usize, &Silhouette)> = seen
        .links
        .iter()
        .zip(seen.parts)
        .filter_map(|(link, part)| match link {
            Link::One(id) => Some((*id, part)),
            Link::Joined(_) => None,
        })
        .collect();
    if !(a.mixed && b.mixed) {
        return Ok(());
    }
    let own = |hand: &Hand| apart.iter().find(|(id, _)| hand.trail == Some(*id)).copied();
    let (of_a, of_b) = match (own(a), own(b), &apart[..]) {
        (Some(of_a), Some(of_b), _) if of_a.0 != of_b.0 => (of_a, of_b),
        (_, _, &[one, two]) => (one, two),
        _ => return Ok(()),
    };
    let overlap = |hand: &Hand, part: &Silhouette| hand.overlap_in(part, None, seen.image);
    let straight = overlap(a, of_a.1)? + overlap(b, of_b.1)?;
    let crossed = overlap(a, of_b.1)? + overlap(b, of_a.1)?;
    let crossed = crossed > straight + tuning.exchange;
    (a.trail, b.trail) = if crossed { (Some(of_b.0), Some(of_a.0)) } else { (Some(of_a.0), Some(of_b.0)) };
    for hand in [a, b] {
        hand.mixed = false;
        hand.others.clear();
        hand.lost = hand.lost.min(1);
    }
    Ok(())
}
