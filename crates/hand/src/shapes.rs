//! Hand shapes by name, and their succession in time: finger spelling.
//!
//! The shapes are in `hand-shapes.toml`. Transitions follow the minimum-jerk law of Flash & Hogan
//! (J. Neurosci. 5, 1985); since feasible poses form a convex set, every pose on the way between two
//! feasible ones is feasible.

use std::collections::BTreeMap;

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use serde::Deserialize;
use thiserror::Error;

use super::constraints::DIP_FROM_PIP;
use super::{Domain, Finger, HandPose, JointAngle, JointAngles, Side};

/// Most bytes in a file of shapes.
pub const MAX_BYTES: usize = 1 << 20;

/// Why a shape, or a file of shapes, cannot be used.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum ShapeError {
    /// The file is no table of shapes.
    #[error("shapes: {0}")]
    Syntax(String),
    /// A shape has a wrong number of angles, or a direction of no length.
    #[error("shapes: {shape}: {what}")]
    Value {
        /// The shape.
        shape: String,
        /// What is wrong, and what was allowed.
        what: String,
    },
    /// A shape breaks a constraint.
    #[error("shapes: {shape}: {constraint}: over by {degrees:.1} degrees")]
    Infeasible {
        /// The shape.
        shape: String,
        /// The constraint.
        constraint: String,
        /// By how much.
        degrees: f64,
    },
    /// There is no shape of that name.
    #[error("shapes: no shape is called {name:?}{hint}")]
    Unknown {
        /// The name.
        name: String,
        /// Names like it, in words.
        hint: String,
    },
    /// A character without a shape was to be spelled.
    #[error("shapes: {0:?} cannot be spelled, allowed A to Z, 0 to 9 and space")]
    Letter(char),
}

/// One named shape of a right hand.
#[derive(Clone, Debug, PartialEq)]
pub struct HandShape {
    /// Its joint angles, radians.
    pub angles: JointAngles,
    /// Rotation from the hand frame to the viewer's.
    pub rotation: UnitQuaternion<f64>,
}

impl HandShape {
    /// The shape as a pose of either hand, its wrist at the origin.
    pub fn pose(&self, side: Side) -> HandPose {
        let pose =
            HandPose { rotation: self.rotation, angles: self.angles, ..HandPose::neutral(Side::Right) };
        match side {
            Side::Right => pose,
            Side::Left => pose.mirrored(),
        }
    }
}

/// Shapes by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ShapeLibrary {
    shapes: BTreeMap<String, HandShape>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ShapeEntry {
    thumb: Vec<f64>,
    index: Vec<f64>,
    middle: Vec<f64>,
    ring: Vec<f64>,
    pinky: Vec<f64>,
    #[serde(default = "up")]
    fingers: [f64; 3],
    #[serde(default = "towards_viewer")]
    palm: [f64; 3],
}

fn up() -> [f64; 3] {
    [0.0, 1.0, 0.0]
}

fn towards_viewer() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

impl ShapeLibrary {
    /// The shapes that come with the program.
    ///
    /// # Errors
    /// Those of [`ShapeLibrary::parse`]; the tests see to it that there are none.
    pub fn builtin() -> Result<Self, ShapeError> {
        Self::parse(include_str!("../hand-shapes.toml"))
    }

    /// Reads shapes from TOML, in the form that `hand-shapes.toml` explains.
    ///
    /// # Errors
    /// [`ShapeError::Syntax`], [`ShapeError::Value`] or [`ShapeError::Infeasible`].
    pub fn parse(text: &str) -> Result<Self, ShapeError> {
        if text.len() > MAX_BYTES {
            return Err(ShapeError::Syntax(format!("{} bytes, allowed {MAX_BYTES}", text.len())));
        }
        let entries: BTreeMap<String, ShapeEntry> =
            toml::from_str(text).map_err(|e| ShapeError::Syntax(e.to_string().trim_end().to_owned()))?;
        let domain = Domain::full();
        let mut shapes = BTreeMap::new();
        for (name, entry) in entries {
            let shape = entry.shape().map_err(|what| ShapeError::Value { shape: name.clone(), what })?;
            if let Some(h) = domain.exceeded(&shape.angles, 1e-9).next() {
                return Err(ShapeError::Infeasible {
                    shape: name,
                    constraint: h.name.clone(),
                    degrees: h.excess(&shape.angles).to_degrees(),
                });
            }
            shapes.insert(name, shape);
        }
        Ok(Self { shapes })
    }

    /// The names, in alphabetical order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.shapes.keys().map(String::as_str)
    }

    /// The shape of that name, in whatever case; the first part may be left out, as in `a` for `asl:A`.
    ///
    /// # Errors
    /// [`ShapeError::Unknown`].
    pub fn get(&self, name: &str) -> Result<&HandShape, ShapeError> {
        let named = |wanted: &str| {
            self.shapes.iter().find(|(n, _)| n.eq_ignore_ascii_case(wanted)).map(|(_, shape)| shape)
        };
        named(name).or_else(|| named(&format!("asl:{name}"))).ok_or_else(|| {
            let first: Vec<_> = self
                .names()
                .filter(|n| !name.is_empty() && n.to_lowercase().starts_with(&name.to_lowercase()))
                .take(5)
                .collect();
            let hint =
                if first.is_empty() { String::new() } else { format!("; there are {}", first.join(", ")) };
            ShapeError::Unknown { name: name.into(), hint }
        })
    }
}

impl ShapeEntry {
    fn shape(&self) -> Result<HandShape, String> {
        let mut angles = [0.0; JointAngle::COUNT];
        let mut set = |angle: JointAngle, degrees: f64| angles[angle.index()] = degrees.to_radians();
        let lists = [&self.thumb, &self.index, &self.middle, &self.ring, &self.pinky];
        for (finger, list) in Finger::ALL.into_iter().zip(lists) {
            let allowed = if finger == Finger::Thumb { 5..=5 } else { 3..=5 };
            if !allowed.contains(&list.len()) {
                let (a, b) = (allowed.start(), allowed.end());
                return Err(format!("{} has {} angles, allowed {a} to {b}", finger.name(), list.len()));
            }
            set(finger.base_flexion(), list[0]);
            set(finger.abduction(), list[1]);
            if finger == Finger::Thumb {
                set(finger.twisting(), list[2]);
                set(finger.middle_flexion(), list[3]);
                set(finger.end_flexion(), list[4]);
            } else {
                set(finger.middle_flexion(), list[2]);
                set(finger.end_flexion(), list.get(3).copied().unwrap_or(DIP_FROM_PIP * list[2]));
                set(finger.twisting(), list.get(4).copied().unwrap_or(0.0));
            }
        }
        let y = Vector3::from(self.fingers).try_normalize(1e-6).ok_or("fingers point nowhere")?;
        let z = Vector3::from(self.palm);
        let z =
            (z - y * y.dot(&z)).try_normalize(1e-6).ok_or("the palm points along the fingers or nowhere")?;
        let turn = Rotation3::from_basis_unchecked(&[y.cross(&z), y, z]);
        Ok(HandShape { angles, rotation: UnitQuaternion::from_rotation_matrix(&turn) })
    }
}

/// The share of the way covered after the share `t` of the time, with the least jerk.
pub fn minimum_jerk(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * t * (10.0 + t * (6.0 * t - 15.0))
}

/// How finger spelling is timed, seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpellingTempo {
    /// How long a letter is held.
    pub hold: f64,
    /// How long a space is rested.
    pub pause: f64,
    /// Shortest transition.
    pub least: f64,
    /// Time a transition takes for each radian of the joint that moves most.
    pub per_radian: f64,
}

impl Default for SpellingTempo {
    /// Two to three letters a second, as taught to beginners.
    fn default() -> Self {
        Self { hold: 0.22, pause: 0.35, least: 0.14, per_radian: 0.10 }
    }
}

impl SpellingTempo {
    /// Everything faster by `factor`.
    #[must_use]
    pub fn faster(self, factor: f64) -> Self {
        let by = |v: f64| v / factor;
        Self {
            hold: by(self.hold),
            pause: by(self.pause),
            least: by(self.least),
            per_radian: by(self.per_radian),
        }
    }
}

/// A pose to reach and to hold.
#[derive(Clone, Debug, PartialEq)]
struct Station {
    pose: HandPose,
    arrive: f64,
    leave: f64,
    /// The letter or digit that it shows.
    shows: Option<char>,
}

/// A letter or digit that is held.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShownLetter {
    /// In capitals.
    pub letter: char,
    /// Seconds from the first pose on at which the hand has its shape.
    pub from: f64,
    /// Seconds at which it begins to leave it.
    pub to: f64,
}

/// A text as poses over time: from rest through its letters and back to rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Spelling {
    stations: Vec<Station>,
}

/// How far a hand opens towards rest between two equal letters.
const REOPENING: f64 = 0.35;

impl Spelling {
    /// Spells `text` (letters, digits, spaces) with one hand.
    ///
    /// # Errors
    /// [`ShapeError::Letter`] for any other character, [`ShapeError::Unknown`] when the library lacks a
    /// shape.
    pub fn new(
        library: &ShapeLibrary,
        text: &str,
        side: Side,
        tempo: SpellingTempo,
    ) -> Result<Self, ShapeError> {
        let rest = library.get("rest")?.pose(side);
        let mut spelling = Self {
            stations: vec![Station { pose: rest.clone(), arrive: 0.0, leave: tempo.pause, shows: None }],
        };
        let mut last = None;
        for c in text.trim().chars() {
            let letter = c.to_ascii_uppercase();
            match letter {
                ' ' => spelling.reach(rest.clone(), tempo.pause, None, tempo),
                'A'..='Z' | '0'..='9' => {
                    let pose = library.get(&format!("asl:{letter}"))?.pose(side);
                    if last == Some(letter) {
                        spelling.reach(pose.interpolated(&rest, REOPENING), 0.0, None, tempo);
                    }
                    spelling.reach(pose, tempo.hold, Some(letter), tempo);
                }
                _ => return Err(ShapeError::Letter(c)),
            }
            last = Some(letter);
        }
        spelling.reach(rest, tempo.pause, None, tempo);
        Ok(spelling)
    }

    fn reach(&mut self, pose: HandPose, hold: f64, shows: Option<char>, tempo: SpellingTempo) {
        let (from, travel) = match self.stations.last() {
            None => (0.0, 0.0),
            Some(s) => {
                let bend = (0..29).map(|i| (s.pose.angles[i] - pose.angles[i]).abs()).fold(0.0, f64::max);
                (s.leave, bend.max(s.pose.rotation.angle_to(&pose.rotation)))
            }
        };
        let arrive = from + tempo.least + tempo.per_radian * travel;
        self.stations.push(Station { pose, arrive, leave: arrive + hold, shows });
    }

    /// Seconds from the first pose to the last.
    pub fn duration(&self) -> f64 {
        self.stations.last().map_or(0.0, |s| s.leave)
    }

    /// The letters and digits, in their order.
    pub fn shown(&self) -> impl Iterator<Item = ShownLetter> {
        let shown = |s: &Station| Some(ShownLetter { letter: s.shows?, from: s.arrive, to: s.leave });
        self.stations.iter().filter_map(shown)
    }

    /// The pose at a time, seconds; before the start and after the end the hand rests.
    pub fn pose(&self, time: f64) -> HandPose {
        let next = self.stations.partition_point(|s| s.leave < time);
        let Some(to) = self.stations.get(next).or(self.stations.last()) else {
            return HandPose::neutral(Side::Right);
        };
        match next.checked_sub(1).and_then(|i| self.stations.get(i)) {
            Some(from) if time < to.arrive => {
                let t = (time - from.leave) / (to.arrive - from.leave);
                from.pose.interpolated(&to.pose, minimum_jerk(t))
            }
            _ => to.pose.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_library_has_letters_numbers_and_plain_shapes() {
        let library = ShapeLibrary::builtin().unwrap();
        for name in ["rest", "flat", "spread", "fist", "pinch", "point"] {
            library.get(name).unwrap();
        }
        for letter in 'A'..='Z' {
            assert_eq!(library.get(&format!("asl:{letter}")), library.get(&letter.to_string()));
        }
        for number in 0..=10 {
            library.get(&format!("ASL:{number}")).unwrap();
        }
        assert_eq!(library.names().count(), 6 + 26 + 11);
        let message = library.get("asl:Ä").unwrap_err().to_string();
        assert_eq!(message, "shapes: no shape is called \"asl:Ä\"");
        assert!(library.get("asl:").unwrap_err().to_string().contains("there are asl:0, asl:1"));
    }

    #[test]
    fn wrong_shapes_are_named() {
        let four = "index=[0,0,0]\nmiddle=[0,0,0]\nring=[0,0,0]\npinky=[0,0,0]";
        let parse = |text: &str| ShapeLibrary::parse(&format!("[x]\n{text}")).unwrap_err().to_string();
        assert!(parse(four).contains("thumb"));
        let whole = format!("thumb=[0,0,0,0,0]\n{four}");
        assert!(
            parse(&whole.replace("index=[0,0,0]", "index=[0,0]")).contains("index has 2 angles, allowed 3")
        );
        let text = parse(&whole.replace("index=[0,0,0]", "index=[120,0,0]"));
        assert!(text.contains("x: index1_flexion maximum: over by 10.0 degrees"), "{text}");
        assert!(parse(&format!("{whole}\npalm=[0,2,0]")).contains("along the fingers"));
        assert!(parse(&format!("{whole}\nelbow=[0]")).contains("elbow"));
    }

    #[test]
    fn directions_turn_the_hand() {
        let library = ShapeLibrary::builtin().unwrap();
        let g = library.get("asl:G").unwrap().pose(Side::Right).rotation;
        assert!((g * Vector3::y() - Vector3::x()).norm() < 1e-9);
        assert!((g * Vector3::z() + Vector3::z()).norm() < 1e-9);
        let left = library.get("asl:G").unwrap().pose(Side::Left).rotation;
        assert!((left * Vector3::y() + Vector3::x()).norm() < 1e-9);
        assert!((left * Vector3::z() + Vector3::z()).norm() < 1e-9);
    }

    #[test]
    fn spelling_is_feasible_smooth_and_shows_every_letter() {
        let library = ShapeLibrary::builtin().unwrap();
        let domain = Domain::full();
        let spelling =
            Spelling::new(&library, "hello WORLD 2026", Side::Left, SpellingTempo::default()).unwrap();
        let dt = 0.005;
        let poses: Vec<_> =
            (0..(spelling.duration() / dt) as usize).map(|i| spelling.pose(i as f64 * dt)).collect();
        let mut shown = std::collections::BTreeSet::new();
        for pair in poses.windows(2) {
            assert!(domain.is_feasible(&pair[0].angles, 1e-9));
            let step = (0..29).map(|i| (pair[0].angles[i] - pair[1].angles[i]).abs()).fold(0.0, f64::max);
            assert!(step < 0.12, "{step}");
            for name in library.names() {
                if library.get(name).unwrap().pose(Side::Left).angles == pair[0].angles {
                    shown.insert(name.to_owned());
                }
            }
        }
        for letter in "HELOWRD026".chars() {
            assert!(shown.contains(&format!("asl:{letter}")), "{letter}");
        }
        let word: String = spelling.shown().map(|shown| shown.letter).collect();
        assert_eq!(word, "HELLOWORLD2026");
        for ShownLetter { letter, from, to } in spelling.shown() {
            let shape = library.get(&letter.to_string()).unwrap().pose(Side::Left);
            for time in [from, 0.5 * (from + to), to] {
                assert_eq!(spelling.pose(time).angles, shape.angles, "{letter} at {time} s");
            }
        }
        let error = Spelling::new(&library, "a?", Side::Left, SpellingTempo::default()).unwrap_err();
        assert_eq!(error, ShapeError::Letter('?'));
    }

    #[test]
    fn minimum_jerk_starts_and_ends_at_rest() {
        let h = 1e-4;
        assert_eq!((minimum_jerk(0.0), minimum_jerk(0.5), minimum_jerk(1.0)), (0.0, 0.5, 1.0));
        assert!(minimum_jerk(h) < 1e-10 && 1.0 - minimum_jerk(1.0 - h) < 1e-10);
    }
}
