//! Hands that a finder sees: where their silhouettes are, which of them is which from frame to frame, and from what
//! they are tracked.

use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;

use nalgebra::{UnitQuaternion, Vector3};

use super::hands::Hand;
use super::start::{Candidate, Waiting, fit_best};
use super::trails::Link;
use super::{ClipOptions, HandStart, SightedTuning, open_hand};
use crate::{ModelState, OpenHand, View};
use handcast_hand::landmarks::TIPS_21;
use handcast_hand::{Finger, Morphology, Side};
use handcast_media::Frame;
use handcast_vision::sighting::{FindError, HandFinder, Sighting};
use handcast_vision::{GuidedSegmenter, Silhouette, VisionError, find_parts};

/// Makes finders of hands, one for each clip that is tracked with these options.
#[derive(Clone)]
pub struct FinderSource(Arc<dyn Fn() -> Box<dyn HandFinder> + Send + Sync>);

impl FinderSource {
    /// Finders made by `make`.
    pub fn new(make: impl Fn() -> Box<dyn HandFinder> + Send + Sync + 'static) -> Self {
        Self(Arc::new(make))
    }

    pub(super) fn make(&self) -> Box<dyn HandFinder> {
        (self.0)()
    }
}

impl fmt::Debug for FinderSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("FinderSource")
    }
}

/// Beyond what a picture's coordinates can be.
const FARTHEST: f64 = 1e6;
/// Overlap of regions from which a sighting may be of the same hand.
const SAME_REGION: f64 = 0.2;

/// Whether two sightings may be of the same hand, by where they were looked for.
fn share_region(a: &Sighting, b: &Sighting) -> bool {
    a.region.overlap(&b.region) > SAME_REGION
}

/// How far the joints of a hand are from those of a sighting before it, hand lengths.
fn away(hand: &Sighting, before: &Sighting) -> f64 {
    before.distance(hand) / (0.5 * hand.region.side).max(1.0)
}

impl SightedTuning {
    /// How far the joints of a hand may have moved that was not seen in so many frames between, hand lengths.
    fn gate_after(&self, missed: usize) -> f64 {
        (self.gate + self.gate_growth * missed as f64).min(self.widest_gate)
    }
}

/// A frame, the hands seen in it and their silhouettes, one each.
pub(super) type Found = (Frame, Vec<Sighting>, Result<Vec<Silhouette>, VisionError>);

/// Finds the silhouettes of hands that a finder sees.
#[derive(Debug)]
pub(super) struct SightedSilhouettes {
    finder: Box<dyn HandFinder>,
    segmenter: Box<GuidedSegmenter>,
    tuning: SightedTuning,
    /// The hands of the last frames.
    last: Vec<Followed>,
    /// Whether something has been seen that is a hand.
    come: bool,
    /// Frames from which colours are to be learnt; the newest ones until a hand has come.
    waiting: Option<VecDeque<(Frame, Vec<Sighting>)>>,
    enough: usize,
    /// Most hands in a frame beside two.
    further: usize,
}

/// A hand that is seen in frames one after the other.
#[derive(Clone, Debug)]
struct Followed {
    hand: Sighting,
    /// Frames since it was seen.
    missed: usize,
    /// Frames in which it was seen, and the sum of its presence in them.
    seen: usize,
    presence: f64,
}

impl Followed {
    /// A hand as a frame shows it, which may be one of the frame next to it.
    fn seen(hand: &Sighting, own: Option<&Self>) -> Self {
        let (seen, presence) = own.map_or((0, 0.0), |own| (own.seen, own.presence));
        Self { hand: hand.clone(), missed: 0, seen: seen + 1, presence: presence + hand.presence }
    }

    /// Whether it is about where this one was looked for.
    fn is_in(&self, hand: &Sighting) -> bool {
        share_region(hand, &self.hand)
    }

    /// Whether it is a hand, whichever.
    fn is_hand(&self, tuning: &SightedTuning) -> bool {
        let presence = self.presence / self.seen.max(1) as f64;
        Known { odds: 0.0, seen: self.seen, presence }.is_hand(tuning)
    }
}

/// Most hands that are tracked.
const TRACKED: usize = 2;

impl SightedSilhouettes {
    pub(super) fn new(finder: Box<dyn HandFinder>, options: &ClipOptions) -> Self {
        let tuning = options.tuning.sighted;
        let segmenter = GuidedSegmenter::new(options.segment, options.guided);
        Self {
            finder,
            segmenter: Box::new(segmenter),
            tuning,
            last: Vec::new(),
            come: false,
            waiting: Some(VecDeque::new()),
            enough: options.learning_frames.max(1),
            further: 0,
        }
    }

    /// Most hands that were seen in a frame beside those that are tracked at most.
    pub(super) fn further(&self) -> usize {
        self.further
    }

    /// Takes a frame; gives those whose silhouettes are found.
    pub(super) fn push(&mut self, frame: Frame) -> Result<Vec<Found>, FindError> {
        let hands = self.look(&frame)?;
        self.come |= self.last.iter().any(|followed| followed.is_hand(&self.tuning));
        let Some(waiting) = &mut self.waiting else {
            if frame.index.is_multiple_of(self.tuning.learn_every.max(1)) {
                self.segmenter.learn(&frame.image, &hands);
            }
            return Ok(vec![self.segmented(frame, hands)]);
        };
        waiting.push_back((frame, hands));
        if waiting.len() < self.enough {
            return Ok(Vec::new());
        }
        let shown = |(_, hands): &(Frame, Vec<Sighting>)| hands.iter().any(|hand| hand.presence > 0.0);
        if self.come || waiting.front().is_some_and(shown) {
            return self.rest();
        }
        // Before somebody has come the newest frames wait: they may show a hand that is seen only later.
        let gone: Vec<_> = waiting.drain(..=waiting.len() - self.enough).collect();
        Ok(gone.into_iter().map(|(frame, hands)| self.learnt(frame, hands)).collect())
    }

    /// The frames that wait.
    pub(super) fn rest(&mut self) -> Result<Vec<Found>, FindError> {
        let mut waiting = self.waiting.take().unwrap_or_default();
        self.look_back(&mut waiting)?;
        // While frames wait each of them tells something new.
        waiting.iter().for_each(|(frame, hands)| self.segmenter.learn(&frame.image, hands));
        Ok(waiting.into_iter().map(|(frame, hands)| self.segmented(frame, hands)).collect())
    }

    /// Adds to frames that wait the hands of those behind them that the finder did not see there: it finds a fist less easily
    /// than it follows one.
    fn look_back(&mut self, waiting: &mut VecDeque<(Frame, Vec<Sighting>)>) -> Result<(), FindError> {
        let mut behind: Vec<Followed> = Vec::new();
        let mut found = Vec::new();
        for (frame, hands) in waiting.iter_mut().rev() {
            let is_missed = |followed: &&Followed| {
                let again = |hand: &Sighting| hand.presence > 0.0 && followed.is_in(hand);
                followed.is_hand(&self.tuning) && !hands.iter().any(again)
            };
            let missed: Vec<Sighting> =
                behind.iter().filter(is_missed).map(|followed| followed.hand.clone()).collect();
            if !missed.is_empty() {
                self.finder.look_back(&frame.image, &missed, &mut found)?;
                // One that moves fast may be seen already, farther away.
                let is_new = |hand: &Sighting| {
                    !hands.iter().any(|seen| seen.presence > 0.0 && share_region(hand, seen))
                };
                found.retain(|hand| is_sound(hand) && is_new(hand));
                // In the place of those that were kept where they had been.
                let own = |held: &Sighting| found.iter().any(|hand| share_region(hand, held));
                hands.retain(|hand| hand.presence > 0.0 || !own(hand));
                hands.append(&mut found);
            }
            let seen = hands.iter().filter(|hand| hand.presence > 0.0);
            let own = |hand: &Sighting| behind.iter().find(|followed| followed.is_in(hand));
            behind = seen.map(|hand| Followed::seen(hand, own(hand))).collect();
        }
        Ok(())
    }

    /// Learns from a frame and segments it.
    fn learnt(&mut self, frame: Frame, hands: Vec<Sighting>) -> Found {
        self.segmenter.learn(&frame.image, &hands);
        self.segmented(frame, hands)
    }

    /// The hands in the frame. One that has just been lost is kept where it was for a few frames, with no presence.
    fn look(&mut self, frame: &Frame) -> Result<Vec<Sighting>, FindError> {
        let mut hands = Vec::new();
        self.finder.find(&frame.image, frame.time, &mut hands)?;
        hands.retain(is_sound);
        let seen = hands.len();
        self.further = self.further.max(seen.saturating_sub(TRACKED) + self.finder.further());
        let before = std::mem::take(&mut self.last);
        let owners = owners(&hands, &before, &self.tuning);
        let own = |owner: &Option<usize>| owner.and_then(|i| before.get(i));
        self.last.extend(hands.iter().zip(&owners).map(|(hand, owner)| Followed::seen(hand, own(owner))));
        for (i, held) in before.into_iter().enumerate() {
            let again = owners.contains(&Some(i)) || hands[..seen].iter().any(|hand| held.is_in(hand));
            if !again && held.missed < self.tuning.held {
                hands.push(Sighting { presence: 0.0, ..held.hand.clone() });
                self.last.push(Followed { missed: held.missed + 1, ..held });
            }
        }
        Ok(hands)
    }

    fn segmented(&mut self, frame: Frame, hands: Vec<Sighting>) -> Found {
        let (mut sightings, mut parts) = (Vec::new(), Vec::new());
        for (k, hand) in hands.iter().enumerate() {
            let others: Vec<&Sighting> = (0..hands.len()).filter(|&o| o != k).map(|o| &hands[o]).collect();
            if let Some(part) = self.segmenter.segment(&frame.image, hand, &others) {
                sightings.push(hand.clone());
                parts.push(part);
            }
        }
        let parts = match parts.is_empty() {
            true => Err(VisionError::NoHand { what: "the finder sees none".to_owned() }),
            false => Ok(parts),
        };
        (frame, sightings, parts)
    }
}

/// Which of the hands before each of these is: one that was looked for there, or else the nearest that is none of the others.
fn owners(hands: &[Sighting], before: &[Followed], tuning: &SightedTuning) -> Vec<Option<usize>> {
    let mut owners: Vec<_> =
        hands.iter().map(|hand| before.iter().position(|followed| followed.is_in(hand))).collect();
    let elsewhere: Vec<usize> = (0..hands.len()).filter(|&k| owners[k].is_none()).collect();
    for k in elsewhere {
        let reach = |i: usize| (i, away(&hands[k], &before[i].hand));
        let near = |&(i, away): &(usize, f64)| away < tuning.gate_after(before[i].missed);
        let free = (0..before.len()).filter(|i| !owners.contains(&Some(*i))).map(reach).filter(near);
        owners[k] = free.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(i, _)| i);
    }
    owners
}

/// Whether all numbers of a sighting are numbers, and its joints somewhere near the picture.
fn is_sound(hand: &Sighting) -> bool {
    let region = [hand.region.centre[0], hand.region.centre[1], hand.region.side, hand.region.angle];
    let near = |v: &f64| v.abs() < FARTHEST;
    hand.points.iter().flatten().chain(&region).all(near)
        && hand.world.iter().flatten().flatten().all(near)
        && hand.presence.is_finite()
        && hand.right.is_finite()
}

/// What is known of one hand seen from frame to frame.
#[derive(Clone, Debug)]
struct SightedTrail {
    id: usize,
    last: Sighting,
    missed: usize,
    /// Frames in which it was seen.
    seen: usize,
    /// Sum of the log-odds that it is a right hand.
    odds: f64,
    presence: f64,
}

/// Gives sightings numbers that stay the same from frame to frame.
#[derive(Clone, Debug, Default)]
pub(super) struct SightedTrails {
    tuning: SightedTuning,
    list: Vec<SightedTrail>,
    next: usize,
}

/// What the sightings of one hand so far tell of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Known {
    /// Sum of the log-odds that it is a right hand.
    pub(super) odds: f64,
    /// Frames in which it was seen.
    pub(super) seen: usize,
    /// Mean presence in these.
    pub(super) presence: f64,
}

impl SightedTrails {
    pub(super) fn new(tuning: SightedTuning) -> Self {
        Self { tuning, ..Self::default() }
    }

    /// The numbers of the hands of the next frame, and what is known of them.
    pub(super) fn link(&mut self, hands: &[Sighting]) -> (Vec<Link>, Vec<Known>) {
        let t = self.tuning;
        let mut pairs = Vec::new();
        for (i, trail) in self.list.iter().enumerate() {
            for (k, hand) in hands.iter().enumerate() {
                let other = trail.odds * odds_of(hand, &t) < 0.0;
                let away = away(hand, &trail.last) + if other { t.other_side } else { 0.0 };
                if away < t.gate_after(trail.missed) {
                    pairs.push((away, i, k));
                }
            }
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut owner = vec![None; hands.len()];
        for (_, i, k) in pairs {
            if owner[k].is_none() && !owner.contains(&Some(i)) {
                owner[k] = Some(i);
            }
        }
        self.list.iter_mut().for_each(|trail| trail.missed += 1);
        let mut known = Vec::with_capacity(hands.len());
        let links = hands.iter().zip(owner).map(|(hand, owner)| {
            let i = owner.unwrap_or_else(|| {
                let id = self.next;
                self.next += 1;
                let last = hand.clone();
                self.list.push(SightedTrail { id, last, missed: 0, seen: 0, odds: 0.0, presence: 0.0 });
                self.list.len() - 1
            });
            let trail = &mut self.list[i];
            trail.last.clone_from(hand);
            if hand.presence > 0.0 {
                trail.missed = 0;
                trail.seen += 1;
                trail.presence += hand.presence;
                let limit = t.most_sum;
                // What goes on from an earlier frame is no evidence of its own.
                let odds = if hand.age == 0 { hand.presence * odds_of(hand, &t) } else { 0.0 };
                trail.odds = (trail.odds + odds).clamp(-limit, limit);
            }
            let presence = trail.presence / trail.seen.max(1) as f64;
            known.push(Known { odds: trail.odds, seen: trail.seen, presence });
            Link::One(trail.id)
        });
        let links = links.collect();
        self.list.retain(|trail| trail.missed < t.forgotten);
        (links, known)
    }
}

/// Log-odds that it is a right hand: what the finder says, and to which side of the palm the fingers bend.
fn odds_of(hand: &Sighting, tuning: &SightedTuning) -> f64 {
    let p = hand.right.clamp(1e-6, 1.0 - 1e-6);
    let said = (p / (1.0 - p)).ln();
    let bent = tuning.curl_odds * curl(hand).unwrap_or(0.0);
    let bent = bent.clamp(-tuning.most_curl_odds, tuning.most_curl_odds);
    (said + bent).clamp(-tuning.most_odds, tuning.most_odds)
}

/// How far the fingertips are in front of the palm of a right hand, which is behind that of a left one: mean over the
/// long fingers, in hand lengths. `None` without places in space.
fn curl(hand: &Sighting) -> Option<f64> {
    let world = hand.world.as_ref()?;
    let at = |k: usize| Vector3::from(world[k]);
    let normal = (at(5) - at(0)).cross(&(at(17) - at(0))).try_normalize(1e-9)?;
    let ahead = [5, 9, 13, 17].map(|k| (at(k + 3) - at(k)).dot(&normal)).iter().sum::<f64>();
    Some(0.25 * ahead / hand.world_length()?.max(1e-6))
}

/// Which side log-odds tell.
fn side_of(odds: f64) -> Side {
    if odds >= 0.0 { Side::Right } else { Side::Left }
}

impl Known {
    /// Whether it has been seen for long enough, and surely enough, to be a hand.
    pub(super) fn is_hand(&self, tuning: &SightedTuning) -> bool {
        self.seen >= tuning.least_seen && self.presence >= tuning.least_presence
    }

    /// Sum of the log-odds that it is of the other side than `side`.
    pub(super) fn against(&self, side: Side) -> f64 {
        if side == Side::Right { -self.odds } else { self.odds }
    }
}

/// Palm or back, of a hand of this side.
fn view_of(hand: &Sighting, side: Side) -> View {
    View::of_joints(&hand.points, side).0
}

/// The joints of the bones by which a finger is straight or not: the thumb's last two, all three of the others.
fn bones(finger: usize) -> [usize; 2] {
    let first = 1 + 4 * finger;
    [first + usize::from(finger == 0), first + 3]
}

/// Whether all fingers are straight in the picture.
fn is_straight(hand: &Sighting, tuning: &SightedTuning) -> bool {
    let p = &hand.points;
    let apart = |a: usize, b: usize| (p[a][0] - p[b][0]).hypot(p[a][1] - p[b][1]);
    (0..5).map(bones).all(|[first, tip]| {
        let along: f64 = (first..tip).map(|k| apart(k, k + 1)).sum();
        apart(first, tip) / along.max(1e-9) >= tuning.open_straight
    })
}

/// Whether they are in space, as far as the finder tells.
fn is_unbent(hand: &Sighting, tuning: &SightedTuning) -> bool {
    let Some(world) = &hand.world else { return false };
    let bone = |k: usize| Vector3::from(world[k + 1]) - Vector3::from(world[k]);
    (0..5).map(bones).all(|[first, tip]| bone(first).angle(&bone(tip - 1)) <= tuning.open_bend)
}

/// The hand as the open hand of a fit, if it is open and faces the camera; the finder has wrists so many hand lengths
/// ahead.
fn opened(hand: &Sighting, tuning: &SightedTuning, wrist_ahead: f64) -> Option<OpenHand> {
    let world = hand.world.as_ref()?;
    let at = |k: usize| Vector3::from(world[k]);
    let normal = (at(5) - at(0)).cross(&(at(17) - at(0))).try_normalize(1e-9)?;
    let straight = is_straight(hand, tuning) && is_unbent(hand, tuning);
    if hand.presence <= 0.0 || normal.z.abs() < tuning.open_facing || !straight {
        return None;
    }
    let p = &hand.points;
    let length = handcast_vision::hand_length_in(hand)?;
    let apart = |a: usize, b: usize| (p[a][0] - p[b][0]).hypot(p[a][1] - p[b][1]);
    let [palm, breadth] = [apart(0, 9), apart(5, 17)].map(|v| v / apart(9, 12).max(1.0));
    let proper = |value: f64, [from, to]: [f64; 2]| (from..to).contains(&value);
    if !proper(palm, tuning.open_palm) || !proper(breadth, tuning.open_breadth) {
        return None;
    }
    let tips = TIPS_21.map(|k| p[k]);
    for pair in tips.windows(2) {
        if (pair[0][0] - pair[1][0]).hypot(pair[0][1] - pair[1][1]) < tuning.open_apart * length {
            return None;
        }
    }
    // A thumb before the palm stands for none beside it.
    let from_index = |k: usize| [0, 1].map(|c| p[k][c] - p[5][c]);
    let ([x, y], [little_x, little_y]) = (from_index(4), from_index(17));
    if x * little_x + y * little_y > 0.0 {
        return None;
    }
    let direction = |k: usize| {
        let [x, y] = [0, 1].map(|c| p[k][c] - p[k - 2][c]);
        let norm = x.hypot(y).max(1e-9);
        [x / norm, y / norm]
    };
    Some(OpenHand {
        wrist: wrist_of(hand, length, wrist_ahead),
        tips,
        directions: TIPS_21.map(direction),
        radii: [tuning.finger_radius * length; Finger::COUNT],
    })
}

/// The wrist, which finders have too far ahead.
fn wrist_of(hand: &Sighting, length: f64, ahead: f64) -> [f64; 2] {
    let p = &hand.points;
    let knuckles = hand.knuckles();
    let along = [0, 1].map(|c| knuckles[c] - p[0][c]);
    let norm = along[0].hypot(along[1]).max(1e-9);
    // Foreshortened like the palm.
    let back = (ahead * length).min(0.5 * norm);
    [0, 1].map(|c| p[0][c] - back * along[c] / norm)
}

/// What the open hand of a sighting would look like there.
fn open_state(hand: &Sighting, view: View, morphology: &Morphology) -> ModelState {
    let p = &hand.points;
    let knuckles = hand.knuckles();
    let turn = (knuckles[0] - p[0][0]).atan2(p[0][1] - knuckles[1]);
    let facing = match view {
        View::Palm => 0.0,
        View::Back => std::f64::consts::PI,
    };
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -turn)
        * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), facing);
    let length = handcast_vision::hand_length_in(hand).unwrap_or(0.4 * hand.region.side);
    let mut state = ModelState { rotation, ..ModelState::facing(p[0], length / morphology.hand_length) };
    for (finger, degrees) in Finger::LONG.into_iter().zip([7.0f64, 0.0, 5.0, 12.0]) {
        state.free[finger.free_abduction()] = degrees.to_radians();
    }
    state
}

/// The trails in frames that waited which are of hands, by what is known of them in the last frame that shows them.
pub(super) fn trails_of_hands(waiting: &[Waiting], tuning: &SightedTuning) -> Vec<(usize, Known)> {
    let mut trails: Vec<(usize, Known)> = Vec::new();
    for w in waiting {
        for (link, known) in w.links.iter().zip(&w.known) {
            let Link::One(id) = *link else { continue };
            match trails.iter_mut().find(|(trail, _)| *trail == id) {
                Some((_, last)) => *last = *known,
                None => trails.push((id, *known)),
            }
        }
    }
    let least = tuning.least_seen.min(waiting.len().div_ceil(2));
    trails.retain(|(_, known)| known.seen >= least && known.presence >= tuning.least_presence);
    trails
}

/// The hands in frames that waited: those that were seen in most of them, one or two, one of each side.
pub(super) fn first_hands(waiting: &[Waiting], options: &ClipOptions) -> Vec<Hand> {
    let t = &options.tuning.sighted;
    let mut trails = trails_of_hands(waiting, t);
    trails.sort_by_key(|(_, known)| std::cmp::Reverse(known.seen));
    trails.truncate(if options.side.is_some() { trails.len() } else { 2 });
    let at = |w: &Waiting, id: usize| {
        w.links.iter().zip(&w.sightings).any(|(link, hand)| *link == Link::One(id) && hand.presence > 0.0)
    };
    if let [(a, known), (b, other)] = trails[..]
        && known.odds * other.odds >= 0.0
        && !waiting.iter().any(|w| at(w, a) && at(w, b))
    {
        // One hand that was out of sight for a while.
        trails.truncate(1);
    }
    let chosen: Vec<(usize, Side, bool)> = match (options.side, &trails[..]) {
        (Some(side), all) => {
            let best = all.iter().min_by(|a, b| a.1.against(side).total_cmp(&b.1.against(side)));
            best.map(|(id, _)| (*id, side, false)).into_iter().collect()
        }
        (None, [(a, known), (b, other)]) => {
            let first = side_of(known.odds - other.odds);
            let unsure = (known.odds - other.odds).abs() < t.settled_odds;
            vec![(*a, first, unsure), (*b, first.other(), unsure)]
        }
        (None, all) => all
            .iter()
            .map(|(id, known)| (*id, side_of(known.odds), known.odds.abs() < t.settled_odds))
            .collect(),
    };
    let started = |(id, side, unsure): (usize, Side, bool)| {
        let start = start(waiting, id, side, options)?;
        Some(Hand::new(HandStart { assumed: unsure, ..start }, id, options))
    };
    chosen.into_iter().filter_map(started).collect()
}

/// One hand: from an open one of its frames, if the model fits it, or from the first that shows it.
fn start(waiting: &[Waiting], id: usize, side: Side, options: &ClipOptions) -> Option<HandStart> {
    let t = &options.tuning.sighted;
    let wrist_ahead = options.tracker.registration.tuning.landmarks.wrist_ahead;
    let shown = || {
        waiting.iter().filter_map(move |w| {
            let p = w.links.iter().position(|link| *link == Link::One(id))?;
            Some((w, w.parts.as_ref().ok()?.get(p)?, w.sightings.get(p)?))
        })
    };
    let mut candidates: Vec<Candidate> = Vec::new();
    let mut first = None;
    // Joints are surer of what is open, outlines see more that is: straight fingers that a finder has bent in space.
    let by_joints =
        shown().filter_map(|(w, part, hand)| Some((w, part, hand, opened(hand, t, wrist_ahead)?)));
    let by_outline = shown().filter_map(|(w, part, hand)| {
        let straight = hand.presence > 0.0 && is_straight(hand, t);
        let open = straight.then(|| find_parts(part, None, &options.segment.parts).ok())??;
        let open = open_hand(&open);
        let agrees = View::of(side, open.thumb_right()) == view_of(hand, side);
        agrees.then_some((w, part, hand, open))
    });
    let mut open: Vec<_> = by_joints.take(options.tuning.start.candidates).collect();
    if open.is_empty() {
        open.extend(by_outline.take(options.tuning.start.candidates));
    }
    for (w, part, hand, open) in open {
        let index = w.index;
        first.get_or_insert(hand);
        candidates.push(Candidate::new(index, id, part, open));
    }
    if let Some(first) = first {
        let view = view_of(first, side);
        let group: Vec<usize> = (0..candidates.len()).collect();
        let best = fit_best(&mut candidates, &group, (side, view, false), options);
        let good = |start: &HandStart| {
            start.fit.as_ref().is_some_and(|fit| fit.iou >= options.tuning.start.least_fit)
        };
        if let Some(start) = best.filter(good) {
            return Some(with_palmar_thumb(start, options));
        }
    }
    let (w, part, hand) = shown().find(|(.., hand)| hand.presence > 0.0)?;
    Some(from_sighting(w.index, part, hand, side, options))
}

/// A hand that begins as a sighting shows it.
pub(super) fn from_sighting(
    frame: usize,
    part: &Silhouette,
    hand: &Sighting,
    side: Side,
    options: &ClipOptions,
) -> HandStart {
    let view = view_of(hand, side);
    let person = options.person.as_ref().map(|p| p.morphology.clone());
    let morphology = person.unwrap_or_else(|| Morphology::average(options.hand_length));
    let camera = super::start::camera_of(&part.hand, options);
    let mut open = open_state(hand, view, &morphology);
    open.free[Finger::Thumb.free_abduction()] = options.tuning.sighted.thumb_abduction;
    let start =
        HandStart { frame, fit: None, seen: Some(open), side, view, assumed: false, morphology, camera };
    with_palmar_thumb(start, options)
}

/// The same with the thumb's base before the palm, where joints show it; outlines alone do not, and fit a flat thumb.
fn with_palmar_thumb(mut start: HandStart, options: &ClipOptions) -> HandStart {
    if options.person.is_none() {
        let forward = |m: &mut Morphology| {
            let palmar = options.tuning.sighted.thumb_palmar * m.hand_length;
            let thumb = &mut m.fingers[Finger::Thumb as usize];
            thumb.base[2] += palmar;
            thumb.place_metacarpal(Finger::Thumb);
        };
        forward(&mut start.morphology);
        if let Some(fit) = &mut start.fit {
            forward(&mut fit.morphology);
        }
    }
    start
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::HandModel;
    use handcast_hand::JointAngle;
    use handcast_hand::landmarks::LANDMARKS_21;
    use handcast_hand::shapes::ShapeLibrary;
    use handcast_vision::sighting::Region;

    /// What a finder says of an open right hand that holds its palm before the camera, its straight thumb flexed by so
    /// many degrees.
    fn sighting(thumb: f64) -> Sighting {
        let library = ShapeLibrary::builtin().unwrap();
        let model = HandModel::new(&Morphology::default(), Side::Right);
        let mut pose = library.get("spread").unwrap().pose(Side::Right);
        pose.angles[JointAngle::Thumb1Flexion.index()] = thumb.to_radians();
        pose.rotation = UnitQuaternion::identity();
        let frames = model.skeleton().frames(&pose);
        let world = LANDMARKS_21.map(|joint| {
            let p = frames.position(joint);
            [p.x, -p.y, -p.z]
        });
        let points = world.map(|[x, y, _]| [320.0 + 1500.0 * x, 360.0 + 1500.0 * y]);
        Sighting {
            points,
            world: Some(world),
            presence: 1.0,
            right: 1.0,
            region: Region::of_joints(&points),
            age: 0,
        }
    }

    #[test]
    fn a_sure_finder_is_believed_before_its_depths() {
        let t = SightedTuning::default();
        let mut hand = sighting(0.0);
        hand.right = 0.967;
        assert!(odds_of(&hand, &t) > 2.0);
        // Fingers that bend to the side of the palm's back, or of the palm.
        let world = hand.world.as_mut().unwrap();
        for finger in 1..5 {
            let base = world[1 + 4 * finger];
            for k in 2 + 4 * finger..5 + 4 * finger {
                world[k][2] -= [0.0, 0.1, 0.4, 1.0][(k - 1) % 4] * (world[k][1] - base[1]);
            }
        }
        assert!(curl(&hand).unwrap().abs() > 0.15, "{:?}", curl(&hand));
        let side = odds_of(&hand, &t);
        hand.world.as_mut().unwrap().iter_mut().for_each(|p| p[2] = -p[2]);
        assert!(side > 0.0 && odds_of(&hand, &t) > 0.0, "{side} {}", odds_of(&hand, &t));
        // Nor do they bend fingers that are straight in the picture.
        assert!(is_straight(&hand, &t) && !is_unbent(&hand, &t));
        // Of an unsure one they tell.
        hand.right = 0.5;
        let side = odds_of(&hand, &t);
        hand.world.as_mut().unwrap().iter_mut().for_each(|p| p[2] = -p[2]);
        assert!(side * odds_of(&hand, &t) < -1.0);
    }

    #[test]
    fn a_hand_with_its_thumb_before_the_palm_is_not_open() {
        let t = SightedTuning::default();
        let [open, across] = [-20.0, 75.0].map(sighting);
        assert!(opened(&open, &t, 0.0).unwrap().thumb_right());
        assert!(opened(&across, &t, 0.0).is_none());
        for hand in [open, across] {
            assert_eq!(view_of(&hand, Side::Right), View::Palm);
            assert_eq!(view_of(&hand, Side::Left), View::Back);
        }
    }
}
