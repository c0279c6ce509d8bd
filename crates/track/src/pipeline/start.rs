//! The first hands of a clip: frames are kept until they have been seen open.

use std::sync::mpsc::Receiver;

use image::RgbImage;
use rayon::prelude::*;

use super::hands::{Hand, Seen};
use super::silhouettes::Segmented;
use super::trails::{Link, Trails};
use super::{ClipError, ClipOptions, HandStart, LEAST_FIT, Start, open_hand};
use crate::{Camera, FitOptions, Forearm, OpenHand, View, fit_open_hand};
use handcast_hand::Side;
use handcast_vision::{PartsError, PartsTuning, Silhouette, VisionError, find_parts};

/// Frames from the first open one on in which the hand is fitted: it may still be opening.
pub(super) const CANDIDATES: usize = 12;
/// Difference of overlap within which fits are as good.
const ALIKE: f64 = 0.01;
/// Frames that are waited for a second hand that is in the picture and not open yet.
const PATIENCE: usize = 60;
/// Smallest second hand, as a share of the arm of the first.
const SECOND: f64 = 0.4;
/// How many times larger one hand of a person may appear than the other.
const UNLIKE: f64 = 1.8;

/// A frame that waits for the fit.
pub(super) struct Waiting {
    pub(super) index: usize,
    pub(super) time: f64,
    jpeg: Vec<u8>,
    pub(super) parts: Result<Vec<Silhouette>, VisionError>,
    pub(super) links: Vec<Link>,
    /// Of each part, where the fit starts if it is an open hand.
    open: Vec<Option<OpenHand>>,
}

impl Waiting {
    pub(super) fn image(&self) -> Result<RgbImage, ClipError> {
        from_jpeg(&self.jpeg).ok_or_else(|| ClipError::Sink("a kept picture is damaged".into()))
    }

    pub(super) fn seen<'a>(&'a self, image: &'a RgbImage) -> Seen<'a> {
        Seen { parts: self.parts.as_deref().unwrap_or(&[]), links: &self.links, image }
    }
}

/// A part of a frame that is an open hand.
pub(super) struct Candidate<'a> {
    pub(super) index: usize,
    pub(super) trail: usize,
    pub(super) silhouette: &'a Silhouette,
    pub(super) open: &'a OpenHand,
}

/// What was seen while waiting, to say why nothing came of it.
#[derive(Default)]
struct Search {
    /// Where each trail was first seen open, in frames that wait.
    opened: Vec<(usize, usize)>,
    nearest: Option<(usize, PartsError)>,
    last_error: Option<VisionError>,
}

impl Search {
    fn look(
        &mut self,
        at: usize,
        index: usize,
        parts: &[Silhouette],
        links: &[Link],
        tuning: &PartsTuning,
    ) -> Vec<Option<OpenHand>> {
        let mut open = Vec::with_capacity(parts.len());
        for (part, link) in parts.iter().zip(links) {
            let (Link::One(id), true) = (*link, open.len() < parts.len()) else {
                open.push(None);
                continue;
            };
            match find_parts(part, tuning) {
                Ok(found) => {
                    if !self.opened.iter().any(|&(trail, _)| trail == id) {
                        self.opened.push((id, at));
                    }
                    open.push(Some(open_hand(&found)));
                }
                Err(reason) => {
                    if self.nearest.as_ref().is_none_or(|(_, r)| fingers_seen(&reason) > fingers_seen(r)) {
                        self.nearest = Some((index, reason));
                    }
                    open.push(None);
                }
            }
        }
        open
    }

    /// Whether a part that is not open yet may become the second hand.
    fn second_in_sight(&self, parts: &[Silhouette], links: &[Link]) -> bool {
        let opened = |link: &Link| self.opened.iter().any(|&(trail, _)| link.holds(trail));
        let area = |p: usize| parts.get(p).map_or(0.0, |part| f64::from(part.arm.area()));
        let first = (0..links.len()).filter(|&p| opened(&links[p])).map(area).fold(0.0, f64::max);
        self.opened.len() == 1 && (0..links.len()).any(|p| !opened(&links[p]) && area(p) > SECOND * first)
    }
}

/// Frames up to those from which the hands are fitted.
pub(super) fn wait_for_open_hands(
    receiver: &Receiver<Segmented>,
    trails: &mut Trails,
    options: &ClipOptions,
    mut read: impl FnMut(usize),
) -> Result<Vec<Waiting>, ClipError> {
    let mut waiting: Vec<Waiting> = Vec::new();
    let mut search = Search::default();
    let mut limited = false;
    while let Ok(Segmented { frame, parts }) = receiver.recv() {
        read(frame.index);
        let all = parts.as_deref().unwrap_or(&[]);
        let links = trails.link(all);
        let open = match options.start {
            Start::Open => search.look(waiting.len(), frame.index, all, &links, &options.segment.parts),
            Start::Any => vec![None; all.len()],
        };
        let more = options.side.is_none() && search.second_in_sight(all, &links);
        if let Err(error) = &parts {
            search.last_error = Some(error.clone());
        }
        let enough = options.start == Start::Any && parts.is_ok();
        let jpeg =
            to_jpeg(&frame.image).ok_or_else(|| ClipError::Sink("a picture could not be kept".into()))?;
        waiting.push(Waiting { index: frame.index, time: frame.time, jpeg, parts, links, open });
        let (first, last) = (search.opened.first(), search.opened.last());
        if let (Some((_, first)), Some((_, last))) = (first, last) {
            let until = last + CANDIDATES;
            if waiting.len() >= if more { until.max(first + PATIENCE) } else { until } {
                break;
            }
        } else if enough {
            break;
        } else if waiting.len() >= options.max_lead_in.max(1) {
            limited = true;
            break;
        }
    }
    let any = options.start == Start::Any || options.person.is_some();
    if !search.opened.is_empty() || any && waiting.iter().any(|w| w.parts.is_ok()) {
        return Ok(waiting);
    }
    let frames = waiting.len();
    Err(match (search.nearest, search.last_error) {
        (Some((nearest, reason)), _) => ClipError::NeverOpen { frames, limited, nearest, reason },
        (None, Some(reason)) => ClipError::NoHand { frames, reason },
        (None, None) => ClipError::Empty,
    })
}

/// The hands in the frames that waited, at least one.
pub(super) fn find_hands(waiting: &[Waiting], options: &ClipOptions) -> Result<Vec<Hand>, ClipError> {
    let mut candidates = Vec::new();
    for w in waiting {
        let parts = w.parts.as_deref().unwrap_or(&[]);
        for ((silhouette, link), open) in parts.iter().zip(&w.links).zip(&w.open) {
            if let (Link::One(trail), Some(open)) = (*link, open) {
                candidates.push(Candidate { index: w.index, trail, silhouette, open });
            }
        }
    }
    if candidates.is_empty() {
        return from_any_posture(waiting, options).map(|hand| vec![hand]);
    }
    let mut groups: Vec<Vec<&Candidate>> = Vec::new();
    for c in &candidates {
        match groups.iter_mut().find(|g| g[0].trail == c.trail) {
            Some(group) => group.push(c),
            None => groups.push(vec![c]),
        }
    }
    // Those open for longest; of equals the one that was first.
    groups.sort_by_key(|g| std::cmp::Reverse(g.len()));
    groups.truncate(2);
    let mut settled = settle(options, &groups.iter().map(|g| Opened::of(g)).collect::<Vec<_>>());
    if options.side.is_some() && groups.len() == 2 {
        let keep = settled.iter().position(|s| Some(s.0) == options.side).unwrap_or(0);
        groups.swap(0, keep);
        settled.swap(0, keep);
        groups.truncate(1);
    }
    let shared = groups.par_iter().zip(&settled);
    let fits: Vec<_> = shared.map(|(group, how)| fit_best(group, *how, options)).collect();
    let mut good: Vec<Hand> = Vec::new();
    let mut worst = None;
    for (group, fit) in groups.iter().zip(fits) {
        let Some(start) = fit else { continue };
        match &start.fit {
            Some(fit) if fit.iou < LEAST_FIT => {
                worst.get_or_insert(ClipError::BadFit { index: start.frame, iou: fit.iou, least: LEAST_FIT });
            }
            _ if good.iter().all(|other| alike(&other.start, &start)) => {
                good.push(Hand::new(start, group[0].trail, options));
            }
            _ => {}
        }
    }
    if let (1, 2, Some(hand)) = (good.len(), settled.len(), good.first()) {
        // Two were open, one was no hand: what is known of the other is told as for one alone.
        let trail = groups.iter().find(|g| hand.claims(g[0].trail)).map(|g| g.iter().collect::<Vec<_>>());
        if let Some(group) = trail {
            let group: Vec<&Candidate> = group.into_iter().copied().collect();
            let how = settle(options, &[Opened::of(&group)]);
            if let Some(start) = how.first().and_then(|how| fit_best(&group, *how, options)) {
                return Ok(vec![Hand::new(start, group[0].trail, options)]);
            }
        }
    }
    if good.is_empty() { Err(worst.unwrap_or(ClipError::Empty)) } else { Ok(good) }
}

/// Whether two hands may be one person's: of like size in the picture, and one left, one right.
pub(super) fn alike(a: &HandStart, b: &HandStart) -> bool {
    let scale = |s: &HandStart| s.fit.as_ref().map(|f| f.state.scale);
    let ratio = scale(a).zip(scale(b)).map_or(1.0, |(a, b)| (a / b).max(b / a));
    a.side != b.side && ratio < UNLIKE
}

/// The fit of one hand, good or bad: of those candidates on which the model fits about best, the one that is spread
/// over most of the picture. A hand that is still opening is overlapped as well, by a thumb that is in the wrong place
/// later.
pub(super) fn fit_best(
    group: &[&Candidate<'_>],
    (side, view, assumed): (Side, View, bool),
    options: &ClipOptions,
) -> Option<HandStart> {
    let length = options.person.as_ref().map_or(options.hand_length, |p| p.morphology.hand_length);
    let shown = group.iter().filter(|c| View::of(side, c.open.thumb_right()) == view);
    let fits: Vec<_> = shown
        .filter_map(|c| {
            let camera = camera_of(c.silhouette, options);
            let fit_options =
                FitOptions { hand_length: length, camera: Some(camera), ..FitOptions::default() };
            let forearm = c.silhouette.wrist.as_ref().map(Forearm::from);
            let fit = fit_open_hand(&c.silhouette.hand, forearm, c.open, side, view, &fit_options)?;
            Some((c, fit, camera))
        })
        .collect();
    let best = fits.iter().map(|(_, fit, _)| fit.iou).fold(0.0, f64::max);
    // One that is good enough is not given up for one that is not.
    let least = (best - ALIKE).max(best.min(LEAST_FIT));
    // Of equals the first.
    let (candidate, mut fit, camera) = fits
        .into_iter()
        .rev()
        .filter(|(_, fit, _)| fit.iou >= least)
        .max_by(|(a, ..), (b, ..)| a.open.spread().total_cmp(&b.open.spread()))?;
    if let Some(person) = &options.person {
        fit.morphology = person.morphology.clone();
    }
    let morphology = fit.morphology.clone();
    Some(HandStart { frame: candidate.index, fit: Some(fit), side, view, assumed, morphology, camera })
}

fn camera_of(silhouette: &Silhouette, options: &ClipOptions) -> Camera {
    let hand = &silhouette.hand;
    Camera::with_field_of_view(hand.width(), hand.height(), options.field_of_view)
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
    pub(super) fn of(group: &[&Candidate<'_>]) -> Self {
        let right = group.iter().filter(|c| c.open.thumb_right()).count();
        let mut elbows: Vec<f64> = group.iter().map(|c| elbow(c)).collect();
        elbows.sort_by(f64::total_cmp);
        Self {
            thumb_right: 2 * right > group.len(),
            elbow: elbows.get(elbows.len() / 2).copied().unwrap_or(0.0),
        }
    }
}

/// Some way down the forearm: hands may cross, elbows hardly do.
fn elbow(candidate: &Candidate<'_>) -> f64 {
    match &candidate.silhouette.wrist {
        Some(wrist) => wrist.centre[0] - 2.0 * wrist.width * wrist.axis[0],
        None => candidate.open.wrist[0],
    }
}

/// Side and view of the hands that were seen open, and whether they were assumed.
///
/// The thumb of one hand tells its side if the view is known and the other way round; without either it is taken
/// for a palm. Two hands are one left and one right. If the view is known the thumbs tell which is which; if it is
/// not, or if both thumbs tell the same (one shows its palm, the other its back), the places do: people face
/// the camera, so the arm on the left of the picture is the right one.
pub(super) fn settle(options: &ClipOptions, hands: &[Opened]) -> Vec<(Side, View, bool)> {
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

/// A hand that is never open: the part that is there for longest, in the first frame that shows it.
fn from_any_posture(waiting: &[Waiting], options: &ClipOptions) -> Result<Hand, ClipError> {
    let mut seen: Vec<(usize, u64)> = Vec::new();
    for w in waiting {
        for (part, link) in w.parts.iter().flatten().zip(&w.links) {
            let Link::One(id) = *link else { continue };
            let area = u64::from(part.arm.area());
            match seen.iter_mut().find(|(trail, _)| *trail == id) {
                Some((_, sum)) => *sum += area,
                None => seen.push((id, area)),
            }
        }
    }
    // Of equals the first.
    let trail = seen.iter().rev().max_by_key(|(_, sum)| *sum).map(|(id, _)| *id).ok_or(ClipError::Empty)?;
    let first = waiting.iter().find_map(|w| {
        let p = w.links.iter().position(|link| *link == Link::One(trail))?;
        Some((w.index, w.parts.as_ref().ok()?.get(p)?))
    });
    let (frame, silhouette) = first.ok_or(ClipError::Empty)?;
    let person = options.person.as_ref();
    let side = options.side.or(person.and_then(|p| p.hand));
    let start = HandStart {
        frame,
        fit: None,
        side: side.unwrap_or(Side::Right),
        view: options.view.unwrap_or(View::Palm),
        assumed: side.is_none() || options.view.is_none(),
        morphology: person.map_or_else(
            || handcast_hand::Morphology::average(options.hand_length),
            |p| p.morphology.clone(),
        ),
        camera: camera_of(silhouette, options),
    };
    Ok(Hand::new(start, trail, options))
}

/// How many free fingers stood in the way of an open hand.
fn fingers_seen(reason: &PartsError) -> usize {
    match reason {
        PartsError::FingersClosed { found } | PartsError::FingersMissing { found } => *found,
        _ => 0,
    }
}

fn to_jpeg(image: &RgbImage) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 88).encode_image(image).ok()?;
    Some(bytes)
}

fn from_jpeg(bytes: &[u8]) -> Option<RgbImage> {
    Some(image::load_from_memory_with_format(bytes, image::ImageFormat::Jpeg).ok()?.to_rgb8())
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
}
