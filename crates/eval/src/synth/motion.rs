//! Scripted motions: keyframes of feasible poses, joined by minimum-jerk transitions.
//!
//! The feasible set is convex, so every pose between two feasible keyframes is feasible too.

use handcast_hand::random::Random;
use handcast_hand::shapes::{HandShape, ShapeError, ShapeLibrary, minimum_jerk};
use handcast_hand::{Domain, Finger, HandPose, JointAngle, Side};

/// A motion by name. All begin and end with the open hand; five of them are those of the paper
/// ([`ScriptedMotion::PAPER`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScriptedMotion {
    /// Open hand, each finger flexed in turn, fist, open; with a little movement of the whole hand.
    Demo,
    /// The open hand, still.
    Still,
    /// The open hand moved right, left, up and down.
    Translation,
    /// Fingers spread and closed.
    Abduction,
    /// Index finger flexed and stretched.
    FlexIndex,
    /// Middle finger flexed and stretched.
    FlexMiddle,
    /// Ring finger flexed and stretched.
    FlexRing,
    /// Little finger flexed and stretched.
    FlexPinky,
    /// Hand closed to a fist and opened.
    Fist,
    /// The open hand turned in the image plane, 60° either way.
    Rotate,
    /// The open hand tilted out of the image plane, 30° either way, about the image's x and then its y.
    Tilt,
    /// The open hand brought nearer and further: 40 % larger and 40 % smaller.
    Zoom,
    /// Letters of finger spelling, one after the other, chosen by the seed: those that are held still with
    /// the fingers up. Their joint angles are not bound by the ties of the tracker's free angles.
    Signs,
    /// The hand leaves the picture on the right and comes back on the left.
    Leave,
}

/// The letters of [`ScriptedMotion::Signs`].
const LETTERS: [&str; 20] =
    ["A", "B", "C", "D", "E", "F", "I", "K", "L", "M", "N", "O", "R", "S", "T", "U", "V", "W", "X", "Y"];
/// How many of them one clip shows.
const SIGNS: usize = 8;

/// What a motion says of one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct State {
    /// Free joint angles in the order of [`Domain::FREE`], radians.
    pub(super) free: [f64; 15],
    /// What is added to the 29 angles that follow from the free ones, radians.
    pub(super) off: [f64; 29],
    /// Shift of the hand, hand lengths: right, up, towards the camera.
    pub(super) shift: [f64; 3],
    /// In-plane rotation, tilt (about the image's x) and swivel (about its y), radians.
    pub(super) turn: [f64; 3],
    /// How many times larger the hand appears, by coming nearer.
    pub(super) zoom: f64,
    /// 1: just out of the picture on the right, −1: on the left.
    pub(super) out: f64,
}

impl State {
    /// All joint angles, radians: the nearest feasible ones, since ties have bends at their limits and half way
    /// between two shapes may lead beyond.
    pub(super) fn angles(&self) -> [f64; 29] {
        let tied = Domain::expand(&self.free);
        let pose = HandPose {
            angles: std::array::from_fn(|i| tied[i] + self.off[i]),
            ..HandPose::neutral(Side::Right)
        };
        Domain::full().project_pose(&pose).angles
    }
}

/// A motion written out: seconds to reach each keyframe, and the keyframe.
#[derive(Clone, Debug)]
pub(super) struct Script(Vec<(f64, State)>);

impl Script {
    /// The state at `share` (0 to 1) of the whole script.
    pub(super) fn at(&self, share: f64) -> State {
        let total: f64 = self.0.iter().map(|(duration, _)| duration).sum();
        let mut time = share.clamp(0.0, 1.0) * total;
        let Some((_, mut from)) = self.0.first().copied() else { return open() };
        for (duration, to) in &self.0 {
            if time <= *duration {
                let t = if *duration > 0.0 { time / duration } else { 1.0 };
                return blend(&from, to, minimum_jerk(t));
            }
            time -= duration;
            from = *to;
        }
        from
    }
}

impl ScriptedMotion {
    /// Names and motions, as on the command line.
    pub const ALL: [(&'static str, ScriptedMotion); 14] = [
        ("demo", ScriptedMotion::Demo),
        ("still", ScriptedMotion::Still),
        ("translation", ScriptedMotion::Translation),
        ("abduction", ScriptedMotion::Abduction),
        ("flex-index", ScriptedMotion::FlexIndex),
        ("flex-middle", ScriptedMotion::FlexMiddle),
        ("flex-ring", ScriptedMotion::FlexRing),
        ("flex-pinky", ScriptedMotion::FlexPinky),
        ("fist", ScriptedMotion::Fist),
        ("rotate", ScriptedMotion::Rotate),
        ("tilt", ScriptedMotion::Tilt),
        ("zoom", ScriptedMotion::Zoom),
        ("signs", ScriptedMotion::Signs),
        ("leave", ScriptedMotion::Leave),
    ];

    /// The paper's five motions (figs. 19 to 23).
    pub const PAPER: [ScriptedMotion; 5] = [
        ScriptedMotion::Translation,
        ScriptedMotion::Abduction,
        ScriptedMotion::FlexIndex,
        ScriptedMotion::FlexMiddle,
        ScriptedMotion::FlexRing,
    ];

    /// The name.
    pub fn name(self) -> &'static str {
        Self::ALL.iter().find(|(_, m)| *m == self).map_or("", |(name, _)| name)
    }

    /// The motion of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.iter().find(|(n, _)| *n == name).map(|(_, m)| *m)
    }

    /// The script; `seed` chooses what a motion leaves to chance.
    ///
    /// # Errors
    /// Those of the built-in hand shapes.
    pub(super) fn script(self, seed: u64) -> Result<Script, ShapeError> {
        Ok(Script(if self == ScriptedMotion::Signs { signs(seed)? } else { self.keys() }))
    }

    /// Seconds to reach each keyframe, and the keyframe.
    fn keys(self) -> Vec<(f64, State)> {
        let rest = open();
        let flex = |finger| {
            vec![(0.3, rest), (1.0, flexed(finger)), (0.3, flexed(finger)), (1.0, rest), (0.3, rest)]
        };
        let shift = |x: f64, y: f64, z: f64| State { shift: [x, y, z], ..rest };
        let turn = |roll: f64, tilt: f64, swivel: f64| State {
            turn: [roll, tilt, swivel].map(f64::to_radians),
            ..rest
        };
        match self {
            ScriptedMotion::Still | ScriptedMotion::Signs => vec![(1.0, rest)],
            ScriptedMotion::FlexIndex => flex(Finger::Index),
            ScriptedMotion::FlexMiddle => flex(Finger::Middle),
            ScriptedMotion::FlexRing => flex(Finger::Ring),
            ScriptedMotion::FlexPinky => flex(Finger::Pinky),
            ScriptedMotion::Fist => vec![(0.3, rest), (1.2, fist()), (0.4, fist()), (1.2, rest), (0.3, rest)],
            ScriptedMotion::Translation => vec![
                (0.3, rest),
                (0.8, shift(0.35, 0.0, 0.0)),
                (1.4, shift(-0.35, 0.0, 0.0)),
                (0.8, rest),
                (0.7, shift(0.0, 0.22, 0.0)),
                (1.2, shift(0.0, -0.22, 0.0)),
                (0.7, rest),
            ],
            ScriptedMotion::Abduction => {
                vec![(0.3, rest), (0.9, closed()), (0.3, closed()), (0.9, rest), (0.9, closed()), (0.9, rest)]
            }
            ScriptedMotion::Rotate => {
                vec![(0.3, rest), (1.3, turn(60.0, 0.0, 0.0)), (2.6, turn(-60.0, 0.0, 0.0)), (1.3, rest)]
            }
            ScriptedMotion::Tilt => vec![
                (0.3, rest),
                (1.0, turn(0.0, 30.0, 0.0)),
                (1.6, turn(0.0, -30.0, 0.0)),
                (1.0, rest),
                (1.0, turn(0.0, 0.0, 30.0)),
                (1.6, turn(0.0, 0.0, -30.0)),
                (1.0, rest),
            ],
            ScriptedMotion::Zoom => {
                let zoom = |factor| State { zoom: factor, ..rest };
                vec![(0.3, rest), (1.2, zoom(1.4)), (2.0, zoom(0.6)), (1.2, rest)]
            }
            ScriptedMotion::Leave => {
                let out = |out| State { out, ..rest };
                // From one side to the other while it cannot be seen.
                vec![
                    (0.3, rest),
                    (1.0, out(1.0)),
                    (0.2, out(1.0)),
                    (0.0, out(-1.0)),
                    (1.0, rest),
                    (0.5, rest),
                ]
            }
            ScriptedMotion::Demo => demo(),
        }
    }
}

/// The script of the demo.
fn demo() -> Vec<(f64, State)> {
    let rest = open();
    let mut keys = vec![(0.4, rest)];
    for (i, finger) in Finger::LONG.into_iter().enumerate() {
        let lean = [-6.0f64, 4.0, 7.0, 2.0][i].to_radians();
        let side = [0.06, 0.03, -0.04, -0.06][i];
        let moved = |state: State| State { shift: [side, 0.3 * side, 0.0], turn: [lean, 0.0, 0.0], ..state };
        keys.push((0.5, moved(flexed(finger))));
        keys.push((0.15, moved(flexed(finger))));
        keys.push((0.5, moved(rest)));
    }
    keys.extend([(0.8, fist()), (0.3, fist()), (0.8, rest), (0.4, rest)]);
    keys
}

/// Letters chosen by the seed, held for a moment each.
fn signs(seed: u64) -> Result<Vec<(f64, State)>, ShapeError> {
    let library = ShapeLibrary::builtin()?;
    let mut random = Random::new(seed, 2);
    let mut letters = LETTERS;
    let mut keys = vec![(0.3, open())];
    for i in 0..SIGNS {
        let other = i + random.below(LETTERS.len() - i);
        letters.swap(i, other);
        let sign = sign(library.get(&format!("asl:{}", letters[i]))?);
        keys.extend([(0.45, sign), (0.15, sign)]);
    }
    keys.extend([(0.45, open()), (0.2, open())]);
    Ok(keys)
}

/// A shape as a state: of its rotation the part about the image's y axis, which is all the letters have. Shapes say
/// nothing of the palm's flexion: it follows from the fingers.
fn sign(shape: &HandShape) -> State {
    let free = Domain::reduce(&shape.angles);
    let mut tied = Domain::expand(&free);
    for palm in Finger::LONG.into_iter().filter_map(Finger::palm_flexion) {
        tied[palm.index()] = shape.angles[palm.index()];
    }
    let palm = shape.rotation * nalgebra::Vector3::z();
    State {
        free,
        off: std::array::from_fn(|i| shape.angles[i] - tied[i]),
        turn: [0.0, 0.0, palm.x.atan2(palm.z)],
        ..open()
    }
}

fn blend(a: &State, b: &State, t: f64) -> State {
    fn mix<const N: usize>(a: &[f64; N], b: &[f64; N], t: f64) -> [f64; N] {
        std::array::from_fn(|i| a[i] + (b[i] - a[i]) * t)
    }
    State {
        free: mix(&a.free, &b.free, t),
        off: mix(&a.off, &b.off, t),
        shift: mix(&a.shift, &b.shift, t),
        turn: mix(&a.turn, &b.turn, t),
        zoom: a.zoom + (b.zoom - a.zoom) * t,
        out: a.out + (b.out - a.out) * t,
    }
}

/// A still state with these angles in degrees, the others 0.
fn state(angles: &[(JointAngle, f64)]) -> State {
    let mut free = [0.0; 15];
    for (slot, angle) in free.iter_mut().zip(Domain::FREE) {
        if let Some((_, degrees)) = angles.iter().find(|(a, _)| *a == angle) {
            *slot = degrees.to_radians();
        }
    }
    State { free, off: [0.0; 29], shift: [0.0; 3], turn: [0.0; 3], zoom: 1.0, out: 0.0 }
}

/// The open, spread hand.
fn open() -> State {
    use JointAngle::*;
    state(&[
        (Thumb1Abduction, 12.0),
        (Thumb1Flexion, -3.0),
        (Index1Abduction, 9.0),
        (Ring1Abduction, 7.0),
        (Pinky1Abduction, 17.0),
        (Index1Flexion, 3.0),
        (Middle1Flexion, 2.0),
        (Ring1Flexion, 4.0),
        (Pinky1Flexion, 5.0),
        (Index2Flexion, 6.0),
        (Middle2Flexion, 6.0),
        (Ring2Flexion, 7.0),
        (Pinky2Flexion, 7.0),
    ])
}

/// Straight fingers side by side, thumb alongside.
fn closed() -> State {
    use JointAngle::*;
    state(&[(Thumb1Flexion, 20.0), (Thumb1Abduction, 10.0), (Index1Abduction, -1.0), (Pinky1Abduction, -1.0)])
}

/// The open hand with one long finger flexed; its neighbours come along as far as constraint (4) asks.
fn flexed(finger: Finger) -> State {
    let mut out = open();
    let mut set = |angle: JointAngle, degrees: f64| {
        for (slot, a) in out.free.iter_mut().zip(Domain::FREE) {
            if a == angle {
                *slot = degrees.to_radians();
            }
        }
    };
    set(finger.base_flexion(), 62.0);
    set(finger.middle_flexion(), 92.0);
    set(finger.abduction(), 0.0);
    match finger {
        Finger::Index => set(JointAngle::Middle1Flexion, 38.0),
        Finger::Ring => {
            set(JointAngle::Middle1Flexion, 20.0);
            set(JointAngle::Pinky1Flexion, 24.0);
            set(JointAngle::Pinky2Flexion, 20.0);
        }
        _ => {}
    }
    out
}

/// The fist, thumb across the fingers.
fn fist() -> State {
    use JointAngle::*;
    state(&[
        (Index1Flexion, 78.0),
        (Middle1Flexion, 80.0),
        (Ring1Flexion, 80.0),
        (Pinky1Flexion, 80.0),
        (Index2Flexion, 98.0),
        (Middle2Flexion, 98.0),
        (Ring2Flexion, 98.0),
        (Pinky2Flexion, 98.0),
        (Thumb1Flexion, 18.0),
        (Thumb1Abduction, 40.0),
        (Thumb3Flexion, 45.0),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_found() {
        for (name, motion) in ScriptedMotion::ALL {
            assert_eq!(ScriptedMotion::from_name(name), Some(motion));
            assert_eq!(motion.name(), name);
        }
        assert_eq!(ScriptedMotion::from_name("wave"), None);
    }

    #[test]
    fn keyframes_are_feasible_and_scripts_begin_and_end_open() {
        let domain = Domain::full();
        for (name, motion) in ScriptedMotion::ALL {
            let script = motion.script(3).unwrap();
            for (_, key) in &script.0 {
                assert!(domain.is_feasible(&key.angles(), 1e-9), "{name}");
            }
            for end in [script.at(0.0), script.at(1.0)] {
                let numbers =
                    |s: &State| [&s.angles()[..], &s.shift[..], &s.turn[..], &[s.zoom, s.out]].concat();
                let (end, open) = (numbers(&end), numbers(&open()));
                let apart = end.iter().zip(&open).map(|(a, b)| (a - b).abs());
                assert!(apart.fold(0.0, f64::max) < 1e-9, "{name}");
            }
        }
    }

    #[test]
    fn the_seed_chooses_the_letters_and_each_comes_once() {
        let held = |seed| -> Vec<State> {
            let keys = signs(seed).unwrap();
            keys[1..keys.len() - 2].chunks(2).map(|pair| pair[1].1).collect()
        };
        assert_eq!(held(4), held(4));
        assert_ne!(held(4), held(5));
        let letters = held(4);
        for (i, a) in letters.iter().enumerate() {
            assert!(letters[..i].iter().all(|b| a != b), "letter {i} comes twice");
        }
    }
}
