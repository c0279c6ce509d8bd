//! What the files of a format cannot tell of poses, in words.

use handcast_codec::{gaps, notices};
use handcast_hand::landmarks::{LANDMARKS_21, PoseSolver, SolverOptions};
use handcast_hand::{Finger, PoseClip, Side, TimedPose};

use super::{WriteOptions, skeleton};

/// What a format has of poses besides their angles.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Keeps {
    pub lost: Lost,
    pub times: Times,
    /// Whether it tells how the palm bends.
    pub palm: bool,
    /// Whether it tells a person's sizes.
    pub sizes: bool,
}

impl Keeps {
    /// All but what becomes of lost hands.
    pub const fn all(lost: Lost) -> Self {
        Self { lost, times: Times::Told, palm: true, sizes: true }
    }

    /// What is worth saying of a clip in a file of such an ending.
    pub fn notes(self, clip: &PoseClip, options: &WriteOptions, ending: &str) -> Vec<String> {
        let mut notes: Vec<String> = self.lost.notes(clip, ending).into_iter().collect();
        if self.lost == Lost::Bridged {
            notes.extend(late(clip, ending));
            // What skips frames leaves them out.
            notes
                .extend((self.times != Times::Skipping).then(|| missing(clip, ending)).into_iter().flatten());
        }
        notes.extend(self.times.notes(clip, options, ending));
        if !self.palm {
            notes.extend(palm(clip, options, ending));
        }
        let sized = clip.header.hands.iter().any(|hand| hand.morphology.is_some());
        notes.extend((!self.sizes && sized).then(|| {
            format!(
                "{ending} has no place for the person's sizes: read again, the hand has those of a mean one"
            )
        }));
        notes
    }
}

/// What a file has of the times of poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Times {
    /// Each pose's own.
    Told,
    /// Those of even frames from the first pose on, of which none is left out.
    Even,
    /// The same, and some may be left out.
    Skipping,
}

impl Times {
    fn notes(self, clip: &PoseClip, options: &WriteOptions, ending: &str) -> Vec<String> {
        if self == Self::Told {
            return Vec::new();
        }
        let start = clip.frames.iter().map(|frame| frame.time).fold(f64::INFINITY, f64::min);
        let begin = notices::of_start(clip).map(|_| {
            format!("the poses begin at {start:.2} s, which {ending} cannot tell: its first frame is the first of them")
        });
        let Ok(rate) = options.rate_of(clip) else { return begin.into_iter().collect() };
        begin.into_iter().chain(notices::of_times(clip, rate)).collect()
    }
}

/// That hands have no poses for a while.
fn missing(clip: &PoseClip, ending: &str) -> Vec<String> {
    let of = |side: Side| {
        let frames = gaps(clip, side).iter().map(|gap| gap.frames).sum::<usize>();
        (frames > 0).then(|| {
            format!(
                "{frames} frames have no pose of the {} hand, which {ending} cannot tell: it moves on meanwhile",
                side.name()
            )
        })
    };
    [Side::Left, Side::Right].into_iter().filter_map(of).collect()
}

/// Turn of the wrist from which on it is told, radians.
const TURNED: f64 = 2.0 * std::f64::consts::PI / 180.0;

/// That points that do not tell how the palm bends give another turn of the wrist, and by how much in the pose whose palm
/// bends most.
fn palm(clip: &PoseClip, options: &WriteOptions, ending: &str) -> Option<String> {
    let bend = |frame: &TimedPose| {
        let bends = Finger::LONG.into_iter().filter_map(Finger::palm_flexion);
        bends.map(|angle| frame.pose.angle(angle).abs()).fold(0.0, f64::max)
    };
    let turned = |side: Side| {
        let most = clip.of(side).filter(|frame| frame.valid).max_by(|a, b| bend(a).total_cmp(&bend(b)))?;
        let skeleton = skeleton(clip, side, &options.morphology);
        let frames = skeleton.frames(&most.pose);
        let mut points = [None; 25];
        LANDMARKS_21.into_iter().for_each(|joint| points[joint.index()] = Some(frames.position(joint)));
        let sizes = clip.header.hand(side).and_then(|hand| hand.morphology.as_ref());
        let mut solver =
            PoseSolver::new(sizes.unwrap_or(&options.morphology), side, SolverOptions::default());
        let turned = solver.solve(&points).ok()?.pose.rotation.angle_to(&most.pose.rotation);
        Some((bend(most), turned))
    };
    let [bend, turned] = [Side::Left, Side::Right]
        .into_iter()
        .filter_map(turned)
        .fold([0.0f64; 2], |[a, b], (bend, turned)| [a.max(bend), b.max(turned)]);
    (bend > 0.0 && turned > TURNED).then(|| {
        format!(
            "the palm bends by up to {:.0}°, which {ending} cannot tell: read again, the wrist is turned by up to {:.0}° instead",
            bend.to_degrees(),
            turned.to_degrees()
        )
    })
}

/// What becomes of the poses of a lost hand in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lost {
    /// It says that the hand was lost then.
    Told,
    /// They are not in it.
    LeftOut,
    /// The hand is there all the time: it rests, or goes on from the pose before to the one behind.
    Bridged,
}

impl Lost {
    fn notes(self, clip: &PoseClip, ending: &str) -> Option<String> {
        let what = match self {
            Self::Told => return None,
            Self::LeftOut => "they are left out",
            Self::Bridged => "it rests or moves on meanwhile, as if it had been seen",
        };
        let lost = clip.frames.iter().filter(|frame| !frame.valid).count();
        let all = clip.frames.len();
        (lost > 0)
            .then(|| format!("{lost} of {all} poses are of a lost hand, which {ending} cannot tell: {what}"))
    }
}

/// How much later than the clip a hand comes, or how much earlier it goes, for that to be told, seconds.
const LATE: f64 = 0.1;

/// That a hand comes later than the clip begins, or goes earlier than it ends.
fn late(clip: &PoseClip, ending: &str) -> Option<String> {
    let span = |frames: &mut dyn Iterator<Item = f64>| {
        frames.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], time| [a.min(time), b.max(time)])
    };
    let [first, last] = span(&mut clip.frames.iter().map(|frame| frame.time));
    let there = |side: Side| {
        let [from, to] = span(&mut clip.of(side).map(|frame| frame.time));
        (from.is_finite() && (from > first + LATE || to < last - LATE))
            .then(|| format!("the {} hand is there from {from:.2} to {to:.2} s", side.name()))
    };
    let hands: Vec<String> = [Side::Left, Side::Right].into_iter().filter_map(there).collect();
    (!hands.is_empty()).then(|| {
        let hands = hands.join(", ");
        format!("{hands}, which {ending} cannot tell: it rests before and behind")
    })
}

#[cfg(test)]
mod tests {
    use super::super::tests::feasible;
    use super::super::{Format, WriteOptions};
    use handcast_hand::{JointAngle, Morphology, PoseClip, Side};

    fn notes(id: &str, clip: &PoseClip) -> Vec<String> {
        let mut options = WriteOptions::default();
        options.gltf.animation_only = true;
        Format::by_id(id).unwrap().write(clip, &options).unwrap().notes
    }

    fn says(id: &str, clip: &PoseClip, words: &str) -> bool {
        notes(id, clip).iter().any(|note| note.contains(words))
    }

    #[test]
    fn nothing_is_said_of_what_all_files_keep() {
        let mut clip = feasible(Side::Left);
        assert!(says("vrma", &clip, "the way of the wrist is left out"));
        let place = clip.frames[0].pose.translation;
        clip.frames.iter_mut().for_each(|frame| frame.pose.translation = place);
        for format in Format::written() {
            assert_eq!(notes(format.id, &clip), [""; 0], "{}", format.id);
        }
    }

    #[test]
    fn times_that_a_file_cannot_tell_are_told() {
        let mut late = feasible(Side::Left);
        late.frames.iter_mut().for_each(|frame| frame.time += 2.5);
        let mut gap = feasible(Side::Left);
        gap.frames.drain(8..15);
        let mut uneven = feasible(Side::Left);
        uneven.header.rate = None;
        for (i, frame) in uneven.frames.iter_mut().enumerate() {
            frame.time += 0.4 / 25.0 * (2.3 * i as f64).sin();
        }
        for format in Format::written() {
            let id = format.id;
            let even = ["bvh", "bap", "pose"].contains(&id);
            assert_eq!(
                says(id, &late, "the poses begin at 2.50 s, which "),
                even,
                "{id}: {:?}",
                notes(id, &late)
            );
            assert_eq!(says(id, &uneven, "are interpolated at "), even, "{id}: {:?}", notes(id, &uneven));
            // BAP text numbers its frames, and others have none where there is no pose.
            let told = says(id, &gap, "7 frames have no pose of the left hand, which ");
            let bridges = ["bvh", "glb", "gltf", "vrma"].contains(&id);
            assert_eq!(told, bridges, "{id}: {:?}", notes(id, &gap));
            assert!(!says(id, &uneven, "have no pose"), "{id}: {:?}", notes(id, &uneven));
        }
    }

    #[test]
    fn palms_and_sizes_that_a_file_has_no_place_for_are_told() {
        let mut cupped = feasible(Side::Right);
        cupped.header.hands[0].morphology = Some(Morphology::average(0.18));
        for frame in &mut cupped.frames {
            frame.pose.set(JointAngle::Pinky0Flexion, 0.25);
            frame.pose.set(JointAngle::Ring0Flexion, 0.15);
        }
        for format in Format::written() {
            let id = format.id;
            let palm = says(id, &cupped, "the palm bends by up to 14°, which ");
            assert_eq!(palm, ["landmarks", "pose"].contains(&id), "{id}: {:?}", notes(id, &cupped));
            let sizes = says(id, &cupped, "has no place for the person's sizes");
            assert_eq!(sizes, ["csv", "bap"].contains(&id), "{id}: {:?}", notes(id, &cupped));
        }
        // As little as nobody sees.
        cupped.frames.iter_mut().for_each(|frame| {
            frame.pose.set(JointAngle::Pinky0Flexion, 0.01);
            frame.pose.set(JointAngle::Ring0Flexion, 0.0);
        });
        assert_eq!(notes("pose", &cupped), [""; 0]);
    }
}
