//! Hands whose names change for some frames: trackers that look at each picture alone now and then call a left hand right. Where
//! a hand is tells which of the two before it is.

use nalgebra::Vector3;

use super::{LandmarkClip, LandmarkFrame};
use handcast_hand::Side;

/// A hand was where it was last seen for so long, seconds, and in the frame after that however long.
const RECENT: f64 = 0.25;
/// How far the points of a hand may be from where they were, in units of how far they are from their middle (root mean squares):
/// a hand that crosses a picture in half a second moves by about one from frame to frame.
const NEAR: f64 = 1.0;
/// The same of points about the hand's own middle, which tell its shape alone: that of a hand in the mirror differs by more.
const SAME_SHAPE: f64 = 0.35;
/// How much farther from its place the other hand must be for a name to be no evidence.
const FARTHER: f64 = 2.0;
/// A hand never seen beside the other that has at most this share of its frames, and never for longer than so many seconds, is
/// an error of names.
const FLICKER: f64 = 0.2;
const FLICKER_FOR: f64 = 0.5;

/// A hand at an instant: which frame of which clip it is.
#[derive(Clone, Copy)]
struct Place {
    clip: usize,
    frame: usize,
}

/// Gives each frame of two hands to the hand that was there before, whatever it is called, and leaves out what is only a name
/// for some frames. Says so in the notes.
pub(super) fn restore(clips: &mut Vec<LandmarkClip>) {
    let [Some(left), Some(right)] = [clips.first(), clips.get(1)].map(|clip| clip.and_then(|clip| clip.side))
    else {
        return;
    };
    if clips.len() != 2 || left == right {
        return;
    }
    let owners = owners(clips);
    let moved = owners.iter().filter(|(place, owner)| place.clip != *owner).count();
    if moved > 0 {
        give(clips, &owners);
        let moved = if name(clips, &owners) { owners.len() - moved } else { moved };
        let s = if moved == 1 { "" } else { "s" };
        let note = format!(
            "in {moved} frame{s} a hand in the place of one is called the other: it is taken for the one"
        );
        clips.iter_mut().for_each(|clip| clip.notes.push(note.clone()));
    }
    leave_out_flicker(clips);
}

fn is_seen(frame: &LandmarkFrame) -> bool {
    frame.points.iter().any(Option::is_some) || frame.picture.is_some() || frame.image.is_some()
}

/// The instants of two recordings: what each sees there.
fn instants(clips: &[LandmarkClip]) -> Vec<(f64, [Option<usize>; 2])> {
    let mut next = [0, 0];
    let mut all = Vec::new();
    loop {
        let times = [0, 1].map(|k| clips[k].frames.get(next[k]).map_or(f64::INFINITY, |frame| frame.time));
        let now = times[0].min(times[1]);
        if now == f64::INFINITY {
            return all;
        }
        let at = [0, 1].map(|k| {
            let here = times[k] == now;
            let seen = here.then_some(next[k]).filter(|&n| is_seen(&clips[k].frames[n]));
            next[k] += usize::from(here);
            seen
        });
        all.push((now, at));
    }
}

/// Which hand each frame with a hand is of.
fn owners(clips: &[LandmarkClip]) -> Vec<(Place, usize)> {
    let mut owners = Vec::new();
    // Where each hand was last, and in which instant.
    let mut last: [Option<(Place, usize)>; 2] = [None; 2];
    let instants = instants(clips);
    for (number, (time, seen)) in instants.iter().enumerate() {
        let away = |place: Place, hand: usize| {
            let (before, at) = last[hand]?;
            let recent = at + 1 == number || time - instants[at].0 <= RECENT;
            recent.then(|| distance(clips, before, place))?
        };
        let here: Vec<Place> = (0..2).filter_map(|clip| Some(Place { clip, frame: seen[clip]? })).collect();
        let exchanged = match here[..] {
            [one] => goes_on(away(one, 1 - one.clip), away(one, one.clip)),
            [one, two] => {
                let crossed = away(one, 1).zip(away(two, 0)).map(|(a, b)| a.max(b));
                let straight = away(one, 0).zip(away(two, 1)).map(|(a, b)| a.max(b));
                straight.is_some() && goes_on(crossed, straight)
            }
            _ => false,
        };
        for place in here {
            let owner = if exchanged { 1 - place.clip } else { place.clip };
            last[owner] = Some((place, number));
            owners.push((place, owner));
        }
    }
    owners
}

/// Whether a hand that is called one is the other, by how far each was from there.
fn goes_on(other: Option<f64>, own: Option<f64>) -> bool {
    other.is_some_and(|other| other < 1.0 && own.is_none_or(|own| own > FARTHER * other))
}

/// How far a hand is from another place, as a share of what is near.
fn distance(clips: &[LandmarkClip], from: Place, to: Place) -> Option<f64> {
    let [a, b] = [from, to].map(|place| &clips[place.clip].frames[place.frame]);
    let pictures = a.picture.as_ref().zip(b.picture.as_ref()).filter(|(a, b)| a.unit == b.unit);
    let (a, b): (Vec<_>, Vec<_>) = match pictures {
        Some((a, b)) => {
            let flat = |p: &Option<nalgebra::Point3<f64>>| p.map(|p| Vector3::new(p.x, p.y, 0.0));
            (a.points.iter().map(flat).collect(), b.points.iter().map(flat).collect())
        }
        None => {
            let point = |p: &Option<nalgebra::Point3<f64>>| p.map(|p| p.coords);
            (a.points.iter().map(point).collect(), b.points.iter().map(point).collect())
        }
    };
    let pairs: Vec<_> = a.into_iter().zip(b).filter_map(|(a, b)| a.zip(b)).collect();
    let count = pairs.len() as f64;
    let middle =
        pairs.iter().fold([Vector3::zeros(); 2], |sum, (a, b)| [sum[0] + a / count, sum[1] + b / count]);
    let squares = |sum: f64| (sum / count).sqrt();
    let spread = squares(pairs.iter().map(|(_, b)| (b - middle[1]).norm_squared()).sum());
    let shape = pictures.is_none() && clips[to.clip].centred;
    // Of points about the hand's own middle only how they lie to each other tells.
    let (shift, near) = if shape { (middle[1] - middle[0], SAME_SHAPE) } else { (Vector3::zeros(), NEAR) };
    let moved = squares(pairs.iter().map(|(a, b)| (a + shift - b).norm_squared()).sum()) / near;
    (spread > 0.0).then_some(moved / spread).filter(|distance| distance.is_finite())
}

/// Moves frames to the hands that they are of.
fn give(clips: &mut [LandmarkClip], owners: &[(Place, usize)]) {
    let mut frames: [Vec<LandmarkFrame>; 2] = [Vec::new(), Vec::new()];
    for &(place, owner) in owners {
        let frame = &mut clips[place.clip].frames[place.frame];
        let empty = LandmarkFrame::of(frame.time, [None; 25]);
        frames[owner].push(std::mem::replace(frame, empty));
    }
    for (clip, seen) in clips.iter_mut().zip(frames) {
        // What is left of a clip are the instants without its hand.
        let mut seen = seen.into_iter().peekable();
        let mut all = Vec::with_capacity(clip.frames.len());
        for empty in std::mem::take(&mut clip.frames) {
            while let Some(frame) = seen.next_if(|frame| frame.time < empty.time) {
                all.push(frame);
            }
            all.push(seen.next_if(|frame| frame.time == empty.time).unwrap_or(empty));
        }
        all.extend(seen);
        clip.frames = all;
    }
}

/// Calls each hand what its frames call it mostly, and leaves out one that has none; tells whether names were exchanged.
fn name(clips: &mut Vec<LandmarkClip>, owners: &[(Place, usize)]) -> bool {
    let sides: Vec<Option<Side>> = clips.iter().map(|clip| clip.side).collect();
    let called =
        |hand: usize, clip: usize| owners.iter().filter(|(p, o)| *o == hand && p.clip == clip).count();
    let other = [0, 1].map(|hand| called(hand, 1 - hand) > called(hand, hand));
    let none = [0, 1].map(|hand| called(hand, 0) + called(hand, 1) == 0);
    let exchanged = (0..2).all(|hand| other[hand] || none[hand]);
    if exchanged {
        clips.iter_mut().zip(sides.iter().rev()).for_each(|(clip, side)| clip.side = *side);
    }
    let mut hands = none.iter();
    clips.retain(|_| !hands.next().is_some_and(|none| *none));
    clips.sort_by_key(|clip| clip.side.map_or(2, |side| side as usize));
    exchanged
}

/// Leaves out a hand that is there for some frames now and then, and never beside the other.
fn leave_out_flicker(clips: &mut Vec<LandmarkClip>) {
    if clips.len() != 2 {
        return;
    }
    let instants = instants(clips);
    let count = |k: usize| instants.iter().filter(|(_, seen)| seen[k].is_some()).count();
    let minor = usize::from(count(1) < count(0));
    let (few, many) = (count(minor), count(1 - minor));
    let beside = instants.iter().any(|(_, seen)| seen[0].is_some() && seen[1].is_some());
    let brief = instants.chunk_by(|a, b| a.1[minor].is_some() == b.1[minor].is_some()).all(|run| {
        let ends = run.first().zip(run.last());
        run[0].1[minor].is_none() || ends.is_some_and(|(a, b)| b.0 - a.0 <= FLICKER_FOR)
    });
    if beside || !brief || few as f64 > FLICKER * many as f64 {
        return;
    }
    let names = [minor, 1 - minor].map(|k| clips[k].side.map_or("unknown", Side::name));
    let s = if few == 1 { "" } else { "s" };
    let note = format!(
        "{few} frame{s} with a hand called {}, never beside the {} one and never for long, are left out",
        names[0], names[1]
    );
    clips.remove(minor);
    clips[0].notes.push(note);
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    /// A hand at `x`, in metres, of a right hand's looks.
    fn frame(time: f64, x: f64) -> LandmarkFrame {
        let points = std::array::from_fn(|k| {
            let (row, column) = (k as f64 % 5.0, k as f64 / 5.0);
            Some(Point3::new(x + 0.02 * column, 0.03 * row + 0.01 * column * column, 0.0))
        });
        LandmarkFrame::of(time, points)
    }

    /// What is seen in each frame: names of hands with their places.
    fn clips(frames: &[&[(Side, f64)]]) -> Vec<LandmarkClip> {
        let clip = |side: Side| {
            let of = |(i, hands): (usize, &&[(Side, f64)])| {
                let time = i as f64 / 30.0;
                let hand = hands.iter().find(|hand| hand.0 == side);
                hand.map_or(LandmarkFrame::of(time, [None; 25]), |hand| frame(time, hand.1))
            };
            LandmarkClip {
                side: Some(side),
                frames: frames.iter().enumerate().map(of).collect(),
                ..LandmarkClip::default()
            }
        };
        vec![clip(Side::Left), clip(Side::Right)]
    }

    fn seen(clip: &LandmarkClip) -> Vec<bool> {
        clip.frames.iter().map(is_seen).collect()
    }

    use Side::{Left, Right};

    #[test]
    fn a_lone_hand_stays_one_hand_and_has_the_name_that_it_mostly_has() {
        for names in [[Right, Left, Left, Right, Right], [Left, Right, Right, Right, Right]] {
            let frames: Vec<[(Side, f64); 1]> =
                names.iter().enumerate().map(|(i, side)| [(*side, 0.01 * i as f64)]).collect();
            let mut clips = clips(&frames.iter().map(|f| &f[..]).collect::<Vec<_>>());
            restore(&mut clips);
            assert_eq!((clips.len(), clips[0].side), (1, Some(Right)), "{names:?}");
            assert_eq!(seen(&clips[0]), [true; 5]);
            let wrong = names.iter().filter(|name| **name == Left).count();
            assert!(clips[0].notes[0].starts_with(&format!("in {wrong} frame")), "{:?}", clips[0].notes);
        }
    }

    #[test]
    fn two_hands_keep_their_places() {
        let both: &[(Side, f64)] = &[(Left, -0.3), (Right, 0.3)];
        let crossed: &[(Side, f64)] = &[(Left, 0.3), (Right, -0.3)];
        let lone: &[(Side, f64)] = &[(Left, 0.3)];
        let mut clips = clips(&[both, both, crossed, lone, lone, both, &[(Right, 0.31)]]);
        restore(&mut clips);
        assert_eq!(seen(&clips[0]), [true, true, true, false, false, true, false]);
        assert_eq!(seen(&clips[1]), [true; 7]);
        let at = |clip: &LandmarkClip| clip.frames[2].points[0].map(|p| p.x);
        assert_eq!((at(&clips[0]), at(&clips[1])), (Some(-0.3), Some(0.3)));
        assert!(clips[0].notes[0].starts_with("in 4 frames a hand"), "{:?}", clips[0].notes);
    }

    #[test]
    fn what_is_far_away_or_comes_later_is_another_hand() {
        let right: &[(Side, f64)] = &[(Right, 0.3)];
        let left: &[(Side, f64)] = &[(Left, -0.3)];
        let before = clips(&[right, right, left, left, left, right]);
        let mut after = before.clone();
        restore(&mut after);
        assert_eq!(before, after);
        let mut flicker = clips(&[right; 20]);
        flicker[0].frames[9] = frame(0.3, -0.4);
        flicker[1].frames[9] = LandmarkFrame::of(0.3, [None; 25]);
        restore(&mut flicker);
        assert_eq!((flicker.len(), flicker[0].side), (1, Some(Right)));
        assert!(flicker[0].notes[0].starts_with("1 frame with a hand called left"), "{:?}", flicker[0].notes);
    }
}
