//! The first hands of a clip: frames are kept until they have been seen open.

use std::borrow::Cow;
use std::cmp::Reverse;
use std::time::Duration;

use image::RgbImage;

use super::contest::Contest;
use super::hands::{Hand, Seen};
use super::sighted::{Known, first_hands, trails_of_hands};
use super::silhouettes::{Search, Segmented};
use super::trails::{Link, Trails, radius};
use super::{ClipError, ClipOptions, Exposure, HandStart, Start, open_hand};
use crate::{Fit, FitOptions, Forearm, OpenHand, PinholeCamera, View, fit_open_hand};
use handcast_hand::Side;
use handcast_vision::sighting::Sighting;
use handcast_vision::{Mask, PartsError, Segmenter, Silhouette, VisionError, Wrist, find_parts};

/// How many of the latest pictures are kept whole: hands mostly begin before there are more. At 640 by 360 that is 177 MB.
const WHOLE: usize = 256;
/// JPEG quality of those that have waited for longer.
const QUALITY: u8 = 88;

/// A picture that is kept.
enum Kept {
    Whole(Box<RgbImage>),
    Jpeg(Vec<u8>),
}

/// A frame that waits for the fit.
pub(super) struct Waiting {
    pub(super) index: usize,
    pub(super) time: f64,
    picture: Kept,
    pub(super) parts: Result<Vec<Silhouette>, VisionError>,
    pub(super) links: Vec<Link>,
    /// What a finder has seen, and what is known of it, for each part; empty without one.
    pub(super) sightings: Vec<Sighting>,
    pub(super) known: Vec<Known>,
    /// Time its segmentation took.
    pub(super) segment: Duration,
}

impl Waiting {
    fn new(segmented: Segmented, links: Vec<Link>, known: Vec<Known>) -> Self {
        let Segmented { frame, parts, sightings, spent, .. } = segmented;
        let sightings = sightings.unwrap_or_default();
        let (index, time) = (frame.index, frame.time);
        let picture = Kept::Whole(Box::new(frame.image));
        Self { index, time, picture, parts, links, sightings, known, segment: spent }
    }

    /// Keeps the picture in less memory.
    fn compress(&mut self) -> Result<(), ClipError> {
        let Kept::Whole(image) = &self.picture else { return Ok(()) };
        let mut jpeg = Vec::new();
        image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, QUALITY)
            .encode_image(image.as_ref())
            .map_err(|error| ClipError::Keep { index: self.index, what: error.to_string() })?;
        self.picture = Kept::Jpeg(jpeg);
        Ok(())
    }

    /// Forgets the parts on these trails, which are no hands.
    fn forget(&mut self, trails: &[usize]) {
        let Ok(parts) = &mut self.parts else { return };
        let is_none = |link: &Link| trails.iter().any(|&trail| *link == Link::One(trail));
        let mut links = self.links.iter();
        parts.retain(|_| links.next().is_none_or(|link| !is_none(link)));
        self.links.retain(|link| !is_none(link));
        if parts.is_empty() {
            self.parts = Err(VisionError::NoHand { what: "what opened like one is none".to_owned() });
        }
    }

    pub(super) fn image(&self) -> Result<Cow<'_, RgbImage>, ClipError> {
        match &self.picture {
            Kept::Whole(image) => Ok(Cow::Borrowed(image)),
            Kept::Jpeg(jpeg) => image::load_from_memory_with_format(jpeg, image::ImageFormat::Jpeg)
                .map(|image| Cow::Owned(image.to_rgb8()))
                .map_err(|error| ClipError::Keep { index: self.index, what: error.to_string() }),
        }
    }

    pub(super) fn seen<'a>(&'a self, image: &'a RgbImage) -> Seen<'a> {
        let parts = self.parts.as_deref().unwrap_or(&[]);
        Seen { parts, links: &self.links, sightings: &self.sightings, known: &self.known, image }
    }
}

/// Which hand it is, how it is seen, and whether that was assumed.
pub(super) type How = (Side, View, bool);

/// A part of a frame that is an open hand.
pub(super) struct Candidate {
    pub(super) index: usize,
    pub(super) trail: usize,
    hand: Mask,
    wrist: Option<Wrist>,
    open: OpenHand,
    /// The fits made of it, by what it was taken for.
    fits: Vec<(Side, View, Option<Fit>)>,
}

impl Candidate {
    pub(super) fn new(index: usize, trail: usize, part: &Silhouette, open: OpenHand) -> Self {
        Self { index, trail, hand: part.hand.clone(), wrist: part.wrist, open, fits: Vec::new() }
    }

    /// Fits the model to it, taken for a hand seen like this; a thumb that shows another view leaves it out. What
    /// has been made once is kept.
    pub(super) fn fit(&mut self, (side, view, _): How, options: &ClipOptions) {
        let made = self.fits.iter().any(|&(s, v, _)| (s, v) == (side, view));
        if made || View::of(side, self.open.thumb_right()) != view {
            return;
        }
        let length = options.person.as_ref().map_or(options.hand_length, |p| p.morphology.hand_length);
        let camera = Some(camera_of(&self.hand, options));
        let fit_options =
            FitOptions { hand_length: length, camera, tuning: options.fit, ..FitOptions::default() };
        let forearm = self.wrist.as_ref().map(Forearm::from);
        let fit = fit_open_hand(&self.hand, forearm, &self.open, side, view, &fit_options);
        self.fits.push((side, view, fit));
    }

    /// The fit made of it.
    fn fitted(&self, (side, view, _): How) -> Option<&Fit> {
        self.fits.iter().find(|&&(s, v, _)| (s, v) == (side, view)).and_then(|(.., fit)| fit.as_ref())
    }

    /// Some way down the forearm: hands may cross, elbows hardly do.
    fn elbow(&self) -> f64 {
        match &self.wrist {
            Some(wrist) => wrist.centre[0] - 2.0 * wrist.width * wrist.axis[0],
            None => self.open.wrist[0],
        }
    }
}

/// The frames of a clip until its first hands are found.
#[derive(Default)]
pub(super) struct Lookout {
    waiting: Vec<Waiting>,
    candidates: Vec<Candidate>,
    /// Where each trail was first seen open, in frames that wait.
    opened: Vec<(usize, usize)>,
    /// What was seen instead, to say why nothing came of it.
    nearest: Option<(usize, PartsError)>,
    last_error: Option<VisionError>,
    limited: bool,
    /// What opened and was no hand: its trail, and how far its fingers reached.
    passed: Vec<(usize, f64)>,
    /// Why the first of them was none.
    failure: Option<ClipError>,
    /// Whether hands are sought again.
    again: bool,
    /// Whether other colours are sought while none is found.
    relearns: bool,
    /// Whether the colours are to be learnt anew before a hand begins by them: what opened by them was none; and whether
    /// one waits for that.
    doubtful: bool,
    held: bool,
    /// Between palm and back, once there are enough candidates of one hand of which neither was told.
    contest: Option<Contest>,
    /// What came of it, and whether that is decided.
    view: Option<(View, bool)>,
}

/// The parts of a frame, and the trails that each is on.
type Shown = (Result<Vec<Silhouette>, VisionError>, Vec<Link>);

/// What some of the frames that wait show by other colours.
struct Again {
    lookout: Lookout,
    /// The trails of its hands.
    hands: Vec<usize>,
    trails: Trails,
    /// What finds the silhouettes of the next frame.
    segmenter: Box<Segmenter>,
    /// The number of the first of these frames.
    first: usize,
    seen: Vec<Shown>,
}

/// Candidates of one hand each, by their numbers.
struct Groups {
    chosen: Vec<(Vec<usize>, How)>,
    /// How many hands were open, wanted or not: one, or two.
    open: usize,
}

impl Lookout {
    /// Keeps a frame; tells whether there are now as many as it takes.
    pub(super) fn add(
        &mut self,
        segmented: Segmented,
        links: Vec<Link>,
        known: Vec<Known>,
        options: &ClipOptions,
    ) -> Result<bool, ClipError> {
        let parts = segmented.parts.as_deref().unwrap_or(&[]);
        if options.finder.is_some() {
            return self.add_sighted(segmented, links, known, options);
        }
        self.look(segmented.frame.index, parts, &links, options);
        let more = options.side.is_none() && self.second_in_sight(parts, &links, options.tuning.start.second);
        let found = segmented.parts.is_ok();
        self.relearns = segmented.relearns;
        self.go_on(&segmented, &links, options)?;
        self.keep(segmented, links, known)?;
        let waited = self.waiting.len();
        Ok(match (self.opened.first(), self.opened.last()) {
            (Some((_, first)), Some((_, last))) => {
                let until = last + options.tuning.start.candidates;
                let enough =
                    waited >= if more { until.max(first + options.tuning.start.patience) } else { until };
                self.held = enough && self.doubtful;
                enough && !self.doubtful && self.is_settled(options)?
            }
            _ if options.start == Start::Any && found && waited >= options.tuning.start.any_after => true,
            _ => {
                self.limited = waited >= options.max_lead_in.max(1);
                self.limited
            }
        })
    }

    /// Whether nothing can be gained by waiting on: what is open is not one hand of which neither view nor side was
    /// told, or they have been decided, or that takes too long.
    pub(super) fn is_settled(&mut self, options: &ClipOptions) -> Result<bool, ClipError> {
        let t = &options.tuning.contest;
        if t.undecided == 0 {
            return Ok(true);
        }
        if self.contest.is_none() {
            let Some(mut contest) = self.new_contest(options) else { return Ok(true) };
            let unlike = |index| move |reason| ClipError::Unlike { index, reason };
            // Of hands that were found late most frames lie behind, after those that show nothing.
            let most = if self.again { usize::MAX } else { options.tuning.start.candidates };
            let shown = self.waiting.iter().skip_while(|w| w.parts.is_err());
            let before: Vec<_> = shown.filter(|w| contest.is_before(w.index, most)).collect();
            for w in before.into_iter().rev() {
                let image = w.image()?;
                let seen = w.seen(&image);
                contest.look_back(w.index, &seen, self.again, options).map_err(unlike(w.index))?;
            }
            contest.rewind();
            for w in &self.waiting {
                let image = w.image()?;
                contest.look(w.index, &w.seen(&image), options).map_err(unlike(w.index))?;
            }
            self.contest = Some(contest);
        }
        self.view = self.contest.as_ref().and_then(|contest| contest.view(t));
        let opened = self.opened.first().map_or(0, |(_, first)| *first);
        Ok(self.view.is_some_and(|(_, decided)| decided) || self.waiting.len() >= opened + t.undecided)
    }

    /// The contest of the one hand that was open.
    fn new_contest(&mut self, options: &ClipOptions) -> Option<Contest> {
        let Groups { chosen, open: 1 } = self.groups(options) else { return None };
        let (group, (side, view, true)) = chosen.into_iter().next()? else { return None };
        let start = fit_best(&mut self.candidates, &group, (side, view, true), options)?;
        let trail = self.candidates[*group.first()?].trail;
        let same: Vec<usize> =
            group.into_iter().filter(|&i| self.candidates[i].index == start.frame).collect();
        let other = fit_best(&mut self.candidates, &same, (side.other(), View::Back, true), options)?;
        let least = options.tuning.contest.fitted;
        let good = |start: &HandStart| start.fit.as_ref().is_some_and(|fit| fit.iou >= least);
        let all = good(&start) && good(&other);
        all.then(|| Contest::new(Hand::new(start, trail, options), Hand::new(other, trail, options)))
    }

    /// Goes on with the contest in the next frame.
    fn go_on(&mut self, next: &Segmented, links: &[Link], options: &ClipOptions) -> Result<(), ClipError> {
        let Some(contest) = self.contest.as_mut() else { return Ok(()) };
        if !contest.is_due(&options.tuning.contest) {
            return Ok(());
        }
        let parts = next.parts.as_deref().unwrap_or(&[]);
        let image = &next.frame.image;
        let seen = Seen { parts, links, sightings: &[], known: &[], image };
        let index = next.frame.index;
        contest.look(index, &seen, options).map_err(|reason| ClipError::Unlike { index, reason })
    }

    /// The same where a finder sees the hands: one that has been seen for some frames is enough.
    fn add_sighted(
        &mut self,
        segmented: Segmented,
        links: Vec<Link>,
        known: Vec<Known>,
        options: &ClipOptions,
    ) -> Result<bool, ClipError> {
        self.keep(segmented, links, known)?;
        let t = &options.tuning.sighted;
        let is_hand = |known: &Known| known.is_hand(t);
        let waited = self.waiting.len();
        if self.opened.is_empty() && self.waiting.last().is_some_and(|w| w.known.iter().any(is_hand)) {
            self.opened.push((0, waited));
        }
        self.limited = waited >= options.max_lead_in.max(1);
        let settled = |known: &Known| !is_hand(known) || known.odds.abs() >= t.settled_odds;
        let undecided = self.waiting.last().is_some_and(|w| !w.known.iter().all(settled));
        let patience = if undecided { t.undecided } else { options.tuning.start.candidates };
        let enough = self.opened.first().is_some_and(|(_, first)| waited >= first + patience);
        if enough && !self.limited && trails_of_hands(&self.waiting, t).is_empty() {
            // What seemed to be one has come to look less like it: the next is waited for.
            self.opened.clear();
            return Ok(false);
        }
        Ok(self.limited || enough)
    }

    /// Keeps a frame until its turn.
    fn keep(&mut self, segmented: Segmented, links: Vec<Link>, known: Vec<Known>) -> Result<(), ClipError> {
        if let Err(error) = &segmented.parts {
            self.last_error = Some(error.clone());
        }
        self.waiting.push(Waiting::new(segmented, links, known));
        let older = self.waiting.len().checked_sub(WHOLE + 1);
        older.and_then(|i| self.waiting.get_mut(i)).map_or(Ok(()), Waiting::compress)
    }

    /// Looks for open hands; while it is found out which hand it is, for one whose fingers are straighter.
    fn look(&mut self, index: usize, parts: &[Silhouette], links: &[Link], options: &ClipOptions) {
        let thumb = View::told_thumb(options.side, options.view);
        for (part, link) in parts.iter().zip(links) {
            let Link::One(id) = *link else { continue };
            match find_parts(part, thumb, &options.segment.parts) {
                Ok(found) if self.contest.is_some() => {
                    let candidate = Candidate::new(index, id, part, open_hand(&found));
                    let of_trail = || self.candidates.iter().filter(|c| c.trail == id);
                    let farthest = of_trail().map(|c| c.open.reach()).fold(0.0, f64::max);
                    if farthest > 0.0 && candidate.open.reach() > options.tuning.start.farther * farthest {
                        self.candidates.push(candidate);
                    }
                }
                Ok(found) => {
                    let candidate = Candidate::new(index, id, part, open_hand(&found));
                    let reach = self.passed.iter().find(|&&(trail, _)| trail == id).map(|(_, reach)| *reach);
                    if reach.is_some_and(|r| candidate.open.reach() <= options.tuning.start.farther * r) {
                        continue;
                    }
                    if !self.opened.iter().any(|&(trail, _)| trail == id) {
                        // As many wait as came before it.
                        self.opened.push((id, index));
                    }
                    self.candidates.push(candidate);
                }
                Err(reason) => {
                    if self.nearest.as_ref().is_none_or(|(_, r)| fingers_seen(&reason) > fingers_seen(r)) {
                        self.nearest = Some((index, reason));
                    }
                }
            }
        }
    }

    /// Whether a part that is not open yet may become the second hand.
    fn second_in_sight(&self, parts: &[Silhouette], links: &[Link], least: f64) -> bool {
        let opened = |link: &Link| self.opened.iter().any(|&(trail, _)| link.holds(trail));
        let area = |p: usize| parts.get(p).map_or(0.0, |part| f64::from(part.arm.area()));
        let first = (0..links.len()).filter(|&p| opened(&links[p])).map(area).fold(0.0, f64::max);
        self.opened.len() == 1 && (0..links.len()).any(|p| !opened(&links[p]) && area(p) > least * first)
    }

    /// The candidates for each hand: those of the trails that were open for longest; of equals the one that was
    /// first.
    fn groups(&self, options: &ClipOptions) -> Groups {
        let mut groups: Vec<Vec<usize>> = Vec::new();
        for (i, c) in self.candidates.iter().enumerate() {
            match groups.iter_mut().find(|g| self.candidates[g[0]].trail == c.trail) {
                Some(group) => group.push(i),
                None => groups.push(vec![i]),
            }
        }
        groups.sort_by_key(|g| Reverse(g.len()));
        groups.truncate(2);
        let opened: Vec<_> = groups.iter().map(|group| self.opened(group)).collect();
        let open = groups.len();
        let settled = match (self.view, &opened[..]) {
            (Some((view, decided)), [hand]) => vec![(view.side(hand.thumb_right), view, !decided)],
            _ => settle(options, &opened),
        };
        let mut chosen: Vec<_> = groups.into_iter().zip(settled).collect();
        if options.side.is_some() && open == 2 {
            let keep = chosen.iter().position(|(_, how)| Some(how.0) == options.side).unwrap_or(0);
            chosen = vec![chosen.swap_remove(keep)];
        }
        Groups { chosen, open }
    }

    fn opened(&self, group: &[usize]) -> Opened {
        Opened::of(group.iter().map(|&i| &self.candidates[i]))
    }

    /// Whether something is open that may be a hand.
    pub(super) fn is_open(&self) -> bool {
        !self.opened.is_empty()
    }

    /// Whether a hand may begin by the colours that are known.
    pub(super) fn may_begin(&self) -> bool {
        self.is_open() && !self.doubtful
    }

    /// How the search stands; behind the `last` frame it is not left open. It is in vain also where a hand waits for other
    /// colours.
    pub(super) fn search(&mut self, last: bool) -> Search {
        let open = self.is_open();
        if open && !self.held && !last {
            return Search::Open;
        }
        // What waited for other colours begins by these, where no others are learnt.
        (self.doubtful, self.held) = (self.doubtful && !open, false);
        if open || !self.passed.is_empty() { Search::Refuted } else { Search::InVain }
    }

    /// Whether more frames may be waited for where what opened is no hand.
    pub(super) fn goes_on(&self, options: &ClipOptions) -> bool {
        let sought = options.finder.is_none() && options.learn_again;
        sought && self.is_open() && self.waiting.len() < options.max_lead_in.max(1)
    }

    /// Passes over what is open, which is no hand: it is looked at again where its fingers reach farther.
    pub(super) fn pass_over(&mut self, reason: ClipError) {
        self.failure.get_or_insert(reason);
        self.again = true;
        let candidates = std::mem::take(&mut self.candidates);
        self.pass(candidates);
        self.opened.clear();
        self.doubtful = self.relearns;
        (self.contest, self.view) = (None, None);
    }

    /// Notes how far the fingers of what is none reach.
    fn pass(&mut self, candidates: Vec<Candidate>) {
        for candidate in candidates {
            let reach = candidate.open.reach();
            match self.passed.iter_mut().find(|(trail, _)| *trail == candidate.trail) {
                Some((_, farthest)) => *farthest = farthest.max(reach),
                None => self.passed.push((candidate.trail, reach)),
            }
        }
    }

    /// Looks for open hands anew in the frames from number `since` on, by other colours. Where there is one that the model
    /// fits, these are the silhouettes from where it came on, and the frames before show nothing: gives their trails, and
    /// what finds the next ones.
    pub(super) fn look_again(
        &mut self,
        learnt: &Segmenter,
        since: usize,
        options: &ClipOptions,
    ) -> Result<Option<(Trails, Box<Segmenter>)>, ClipError> {
        // Mostly the newest half shows that there is none.
        let middle = since.midpoint(self.waiting.len());
        let Some(newest) = self.seen_by(learnt, middle, options)? else { return Ok(None) };
        let again = self.seen_by(learnt, since, options)?.unwrap_or(newest);
        let before = self.seen_before(&again, learnt, options)?;
        let Again { lookout, hands, trails, segmenter, first, seen } = again;
        // What is seen before the first of them comes is something else.
        let shown = |link: &Link| hands.iter().any(|&id| link.holds(id));
        let come = seen.iter().position(|(_, links)| links.iter().any(shown)).unwrap_or(0);
        let unseen = || VisionError::NoHand { what: "none had come when colours were learnt".to_owned() };
        let earliest = (first + come).saturating_sub(before.len());
        let mut seen = before.into_iter().rev().chain(seen.into_iter().skip(come));
        for w in &mut self.waiting {
            let found = if w.index >= earliest { seen.next() } else { None };
            (w.parts, w.links) = found.unwrap_or_else(|| (Err(unseen()), Vec::new()));
        }
        let waiting = std::mem::take(&mut self.waiting);
        let (failure, last_error) = (self.failure.take(), self.last_error.take());
        *self = Self { waiting, failure, last_error, relearns: self.relearns, ..lookout };
        let (candidates, others) =
            self.candidates.drain(..).partition(|candidate| hands.contains(&candidate.trail));
        self.candidates = candidates;
        self.opened.retain(|(trail, _)| hands.contains(trail));
        self.pass(others);
        Ok(Some((trails, segmenter)))
    }

    /// What the frames from number `since` on show by other colours, if that is a hand.
    fn seen_by(
        &self,
        learnt: &Segmenter,
        since: usize,
        options: &ClipOptions,
    ) -> Result<Option<Again>, ClipError> {
        let (mut segmenter, mut trails) = (Box::new(learnt.clone()), Trails::new(options.tuning.trails));
        let (mut lookout, mut seen) = (Self { again: true, ..Self::default() }, Vec::new());
        for w in self.waiting.iter().filter(|w| w.index >= since) {
            let image = w.image()?;
            let parts = segmenter.segment_all(&image);
            let links = trails.link(parts.as_deref().unwrap_or(&[]));
            lookout.look(w.index, parts.as_deref().unwrap_or(&[]), &links, options);
            seen.push((parts, links));
        }
        let Ok(hands) = lookout.open_hands(options) else { return Ok(None) };
        let hands = hands.iter().filter_map(Hand::trail).collect();
        Ok(Some(Again { lookout, hands, trails, segmenter, first: since, seen }))
    }

    /// The hands followed backwards from the first frame of `again`, as long as that frame and those before it show them: what
    /// these show, the latest first.
    fn seen_before(
        &self,
        again: &Again,
        learnt: &Segmenter,
        options: &ClipOptions,
    ) -> Result<Vec<Shown>, ClipError> {
        let Some((Ok(parts), links)) = again.seen.first() else { return Ok(Vec::new()) };
        let (mut segmenter, mut trails) = (learnt.clone(), Trails::new(options.tuning.trails));
        // Each hand's trails backwards and forwards, and its size.
        let backwards = trails.link(parts);
        let own: Vec<(Link, Link, f64)> = (backwards.into_iter().zip(links).zip(parts))
            .filter(|((_, link), _)| again.hands.iter().any(|&id| **link == Link::One(id)))
            .map(|((back, link), part)| (back, *link, radius(part)))
            .collect();
        let shows = |(part, back): (Silhouette, Link)| {
            let (_, link, size) = own.iter().find(|(own, ..)| *own == back)?;
            let ratio = radius(&part) / size;
            (ratio.max(1.0 / ratio) < options.tuning.start.unlike).then_some((part, *link))
        };
        let mut before: Vec<Shown> = Vec::new();
        for w in self.waiting.iter().filter(|w| w.index < again.first).rev() {
            let parts = segmenter.segment_all(w.image()?.as_ref()).unwrap_or_default();
            let links = trails.link(&parts);
            let (parts, links): (Vec<_>, Vec<_>) = parts.into_iter().zip(links).filter_map(shows).unzip();
            if parts.is_empty() {
                break;
            }
            before.push((Ok(parts), links));
        }
        Ok(before)
    }

    /// Why there is no hand: what opened first was none, if anything did.
    pub(super) fn first_failure(self, last: ClipError) -> ClipError {
        self.failure.unwrap_or(last)
    }

    /// The frames that waited, without what is no hand.
    pub(super) fn into_waiting(mut self) -> Vec<Waiting> {
        let none = self.no_hands();
        self.waiting.iter_mut().for_each(|w| w.forget(&none));
        self.waiting
    }

    /// The trails that were passed over and have not opened again.
    fn no_hands(&self) -> Vec<usize> {
        let opened = |trail: usize| self.opened.iter().any(|&(id, _)| id == trail);
        self.passed.iter().map(|&(trail, _)| trail).filter(|&trail| !opened(trail)).collect()
    }

    /// The hands in the frames that waited, at least one.
    pub(super) fn hands(&mut self, options: &ClipOptions) -> Result<Vec<Hand>, ClipError> {
        if options.finder.is_some() && self.waiting.iter().any(|w| !w.sightings.is_empty()) {
            let hands = first_hands(&self.waiting, options);
            return if hands.is_empty() { Err(self.nothing()) } else { Ok(hands) };
        }
        let any_posture = match self.is_open() {
            true => match self.open_hands(options) {
                Err(_) if options.start == Start::Any => {
                    return Ok(from_any_posture(&self.waiting, &self.no_hands(), options)
                        .into_iter()
                        .collect());
                }
                hands => return hands,
            },
            // What opened and was no hand is none in another posture.
            false => options.start == Start::Any || options.person.is_some() && self.failure.is_none(),
        };
        let hand = any_posture.then(|| from_any_posture(&self.waiting, &self.no_hands(), options)).flatten();
        hand.map(|hand| vec![hand]).ok_or_else(|| self.nothing())
    }

    /// Why there is no hand.
    fn nothing(&mut self) -> ClipError {
        let (frames, limited) = (self.waiting.len(), self.limited);
        let at = self.nearest.as_ref().map(|(nearest, _)| *nearest);
        let shown = self.waiting.iter().rfind(|w| at.is_none_or(|at| w.index == at));
        let exposure = |w: &Waiting| {
            let parts = w.parts.as_deref().unwrap_or(&[]);
            w.image().map_or_else(|_| Exposure::default(), |image| Exposure::of(&image, parts))
        };
        let exposure = shown.map(exposure).unwrap_or_default();
        match (self.nearest.take(), self.last_error.take()) {
            (Some((nearest, reason)), _) => {
                ClipError::NeverOpen { frames, limited, nearest, reason, exposure }
            }
            (None, Some(reason)) => ClipError::NoHand { frames, limited, reason, exposure },
            (None, None) if frames > 0 => ClipError::NoHand {
                frames,
                limited,
                reason: VisionError::NoHand { what: "none is seen for long enough".to_owned() },
                exposure,
            },
            (None, None) => ClipError::Empty,
        }
    }

    /// The hands that were open.
    fn open_hands(&mut self, options: &ClipOptions) -> Result<Vec<Hand>, ClipError> {
        let Groups { chosen, open } = self.groups(options);
        let mut good: Vec<(HandStart, &[usize])> = Vec::new();
        let mut worst = None;
        let tuning = &options.tuning.start;
        let least = if self.again { tuning.least_fit_again } else { tuning.least_fit };
        for (group, how) in &chosen {
            let Some(start) = fit_best(&mut self.candidates, group, *how, options) else { continue };
            match &start.fit {
                Some(fit) if fit.iou < least => {
                    let bad = ClipError::BadFit { index: start.frame, iou: fit.iou, least };
                    worst.get_or_insert(bad);
                }
                _ if good.iter().all(|(other, _)| alike(other, &start, options)) => good.push((start, group)),
                _ => {}
            }
        }
        if let (2, [(start, group)]) = (open, &mut good[..]) {
            // Two were open, one was no hand: what is known of the other is told as for one alone.
            let alone = settle(options, &[self.opened(group)]);
            if let Some(how) = alone.first()
                && let Some(again) = fit_best(&mut self.candidates, group, *how, options)
            {
                *start = again;
            }
        }
        if good.is_empty() {
            let what = || "what opens like a hand is none that the model fits".to_owned();
            let none = || ClipError::NoHand {
                frames: self.waiting.len(),
                limited: self.limited,
                reason: VisionError::NoHand { what: what() },
                exposure: Exposure::default(),
            };
            return Err(worst.unwrap_or_else(none));
        }
        let trail = |group: &[usize]| self.candidates[group[0]].trail;
        Ok(good.into_iter().map(|(start, group)| Hand::new(start, trail(group), options)).collect())
    }
}

/// Whether two hands may be one person's: of like size in the picture, and one left, one right.
pub(super) fn alike(a: &HandStart, b: &HandStart, options: &ClipOptions) -> bool {
    let scale = |s: &HandStart| s.fit.as_ref().map(|f| f.state.scale);
    let ratio = scale(a).zip(scale(b)).map_or(1.0, |(a, b)| (a / b).max(b / a));
    a.side != b.side && ratio < options.tuning.start.unlike
}

/// The fit of the hand of some candidates, good or bad: of those on which the model fits about best, the one that is
/// spread over most of the picture. The widest are fitted, until the model fits enough of them. A hand that is still opening is
/// overlapped as well, by a thumb that is in the wrong place later.
pub(super) fn fit_best(
    candidates: &mut [Candidate],
    group: &[usize],
    how: How,
    options: &ClipOptions,
) -> Option<HandStart> {
    let tuning = &options.tuning.start;
    let mut widest = group.to_vec();
    widest.sort_by(|&a, &b| candidates[b].open.spread().total_cmp(&candidates[a].open.spread()));
    if options.finder.is_none() {
        // Of what is none, none is fitted well.
        widest.truncate(tuning.candidates.max(1));
    }
    let mut good = 0;
    for i in widest {
        candidates[i].fit(how, options);
        good += usize::from(candidates[i].fitted(how).is_some_and(|fit| fit.iou >= tuning.least_fit));
        // Joints that a finder sees are too far off to tell which hand is widest.
        if good == tuning.fitted && options.finder.is_none() {
            break;
        }
    }
    let fits: Vec<(&Candidate, &Fit)> =
        group.iter().filter_map(|&i| Some((&candidates[i], candidates[i].fitted(how)?))).collect();
    let best = fits.iter().map(|(_, fit)| fit.iou).fold(0.0, f64::max);
    // One that is good enough is not given up for one that is not.
    let least = (best - tuning.alike).max(best.min(tuning.least_fit));
    // Of equals the first.
    let (candidate, fit) = fits
        .into_iter()
        .rev()
        .filter(|(_, fit)| fit.iou >= least)
        .max_by(|(a, _), (b, _)| a.open.spread().total_cmp(&b.open.spread()))?;
    let mut fit = fit.clone();
    if let Some(person) = &options.person {
        fit.morphology = person.morphology.clone();
    }
    let (side, view, assumed) = how;
    let (morphology, camera) = (fit.morphology.clone(), camera_of(&candidate.hand, options));
    let fit = Some(fit);
    Some(HandStart { frame: candidate.index, fit, seen: None, side, view, assumed, morphology, camera })
}

pub(super) fn camera_of(hand: &Mask, options: &ClipOptions) -> PinholeCamera {
    PinholeCamera::with_field_of_view(hand.width(), hand.height(), options.field_of_view)
}

/// What the outline of an open hand tells of which hand it is.
pub(super) struct Opened {
    /// The thumb is on the right when the fingers point up.
    pub(super) thumb_right: bool,
    /// Where the arm comes from, pixels from the left.
    elbow: f64,
}

impl Opened {
    /// What most candidates for one hand tell.
    pub(super) fn of<'a>(group: impl Iterator<Item = &'a Candidate>) -> Self {
        let (mut right, mut elbows) = (0, Vec::new());
        for candidate in group {
            right += usize::from(candidate.open.thumb_right());
            elbows.push(candidate.elbow());
        }
        elbows.sort_by(f64::total_cmp);
        Self {
            thumb_right: 2 * right > elbows.len(),
            elbow: elbows.get(elbows.len() / 2).copied().unwrap_or(0.0),
        }
    }
}

/// Side and view of the hands that were seen open, and whether they were assumed.
///
/// The thumb of one hand tells its side if the view is known and the other way round; without either it is taken
/// for a palm. Two hands are one left and one right. If the view is known the thumbs tell which is which; if it is
/// not, or if both thumbs tell the same (one shows its palm, the other its back), the places do: people face
/// the camera, so the arm on the left of the picture is the right one.
fn settle(options: &ClipOptions, hands: &[Opened]) -> Vec<How> {
    let [a, b] = hands else {
        return hands.iter().map(|h| View::settle(options.side, options.view, h.thumb_right)).collect();
    };
    let told = options.view.map(|view| view.side(a.thumb_right));
    let first = match told {
        Some(side) if a.thumb_right != b.thumb_right => side,
        _ if a.elbow < b.elbow => Side::Right,
        _ => Side::Left,
    };
    let assumed = options.view.is_none();
    [(first, a), (first.other(), b)]
        .map(|(side, hand)| (side, View::of(side, hand.thumb_right), assumed))
        .into()
}

/// A hand that is never open: the part that is there for longest, in the first frame that shows it, and on none of the trails
/// of what is no hand.
fn from_any_posture(waiting: &[Waiting], none: &[usize], options: &ClipOptions) -> Option<Hand> {
    let mut seen: Vec<(usize, u64)> = Vec::new();
    for w in waiting {
        for (part, link) in w.parts.iter().flatten().zip(&w.links) {
            let Link::One(id) = *link else { continue };
            if none.contains(&id) {
                continue;
            }
            let area = u64::from(part.arm.area());
            match seen.iter_mut().find(|(trail, _)| *trail == id) {
                Some((_, sum)) => *sum += area,
                None => seen.push((id, area)),
            }
        }
    }
    // Of equals the first.
    let trail = seen.iter().rev().max_by_key(|(_, sum)| *sum).map(|(id, _)| *id)?;
    let (frame, silhouette) = waiting.iter().find_map(|w| {
        let p = w.links.iter().position(|link| *link == Link::One(trail))?;
        Some((w.index, w.parts.as_ref().ok()?.get(p)?))
    })?;
    let person = options.person.as_ref();
    let side = options.side.or(person.and_then(|p| p.hand));
    let start = HandStart {
        frame,
        fit: None,
        seen: None,
        side: side.unwrap_or(Side::Right),
        view: options.view.unwrap_or(View::Palm),
        assumed: side.is_none() || options.view.is_none(),
        morphology: person.map_or_else(
            || handcast_hand::Morphology::average(options.hand_length),
            |p| p.morphology.clone(),
        ),
        camera: camera_of(&silhouette.hand, options),
    };
    Some(Hand::new(start, trail, options))
}

/// How many free fingers stood in the way of an open hand.
fn fingers_seen(reason: &PartsError) -> usize {
    match reason {
        PartsError::FingersClosed { found } | PartsError::FingersMissing { found } => *found,
        _ => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_hands_are_a_left_and_a_right_one() {
        let hand = |thumb_right, elbow| Opened { thumb_right, elbow };
        let sides = |view, a, b| {
            let options = ClipOptions { view, ..ClipOptions::default() };
            let settled = settle(&options, &[a, b]);
            (settled[0].0, settled[0].1, settled[1].0, settled[1].1)
        };
        use Side::{Left, Right};
        use View::{Back, Palm};
        // Thumbs inwards: palms of someone who faces the camera, or the backs of one's own hands.
        let inwards = || (hand(true, 100.0), hand(false, 300.0));
        let (a, b) = inwards();
        assert_eq!(sides(None, a, b), (Right, Palm, Left, Palm));
        let (a, b) = inwards();
        assert_eq!(sides(Some(Back), a, b), (Left, Back, Right, Back));
        // Outwards: backs of someone who faces the camera.
        assert_eq!(sides(None, hand(false, 100.0), hand(true, 300.0)), (Right, Back, Left, Back));
        assert_eq!(sides(None, hand(true, 300.0), hand(false, 100.0)), (Left, Back, Right, Back));
        // The same thumbs: one palm, one back.
        assert_eq!(sides(Some(Palm), hand(true, 100.0), hand(true, 300.0)), (Right, Palm, Left, Back));
        assert_eq!(sides(None, hand(false, 300.0), hand(false, 100.0)), (Left, Palm, Right, Back));
    }

    /// Masks are what they are; of colours others are learnt before a hand begins by them, if there are others.
    #[test]
    fn after_what_was_none_a_hand_begins_where_no_colours_are_to_come() {
        for relearns in [false, true] {
            let mut lookout = Lookout { opened: vec![(0, 3)], relearns, ..Lookout::default() };
            lookout.pass_over(ClipError::Empty);
            assert!(!lookout.is_open());
            lookout.opened.push((1, 20));
            assert_eq!(lookout.may_begin(), !relearns);
            lookout.held = true;
            assert_eq!(lookout.search(false), Search::Refuted);
            assert!(lookout.may_begin());
        }
    }
}
