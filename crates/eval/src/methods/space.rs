//! The parameters of a model state as a point of Rⁿ under the biomechanical constraints.

use std::ops::Range;

use super::functional::Functional;
use handcast_hand::{Domain, FREE_ANGLES, Finger};
use handcast_track::{HAND_LENGTH, HandModel, ModelState, Problem, Window};
use handcast_vision::tuning::tuning;

/// The axis of the camera, of those that a hand turns about.
const OPTICAL_AXIS: usize = 2;
/// Place of abduction among a finger's free angles.
const ABDUCTION: usize = 1;

/// One of the 21 parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parameter {
    /// Position along the image's x, in hand lengths ([`HAND_LENGTH`]).
    X,
    /// Position along the image's y, likewise.
    Y,
    /// Logarithm of the scale.
    Scale,
    /// Rotation about a camera axis, 0 to 2: rotation vector, radians.
    Turn(usize),
    /// A free joint angle, its place in [`Domain::FREE`], radians.
    Angle(usize),
}

impl Parameter {
    /// All 21: position, scale, rotation, then the angles finger by finger.
    pub fn all() -> impl Iterator<Item = Self> {
        let turns = [OPTICAL_AXIS, 0, 1].map(Self::Turn);
        [Self::X, Self::Y, Self::Scale].into_iter().chain(turns).chain((0..FREE_ANGLES).map(Self::Angle))
    }

    /// Its place in the hierarchy: position, scale, rotation, abduction, flexion at the base, at the
    /// joints after it (paper 6.5).
    fn rank(self) -> usize {
        match self {
            Self::X | Self::Y => 0,
            Self::Scale => 1,
            Self::Turn(_) => 2,
            Self::Angle(k) => [4, 3, 5][k % Finger::FREE_ANGLES],
        }
    }

    /// The finger it moves.
    fn finger(self) -> Option<Finger> {
        match self {
            Self::Angle(k) => Finger::ALL.get(k / Finger::FREE_ANGLES).copied(),
            _ => None,
        }
    }
}

tuning! {
    /// λ of eq. 9 for each parameter: the edges of the first simplex, and the steps of the other optimisers.
    pub struct StepTuning {
        /// Of the position.
        ["hand lengths", "handcast bench track"]
        pub position: f64 = 0.04,
        /// Of the logarithm of the scale.
        ["1", "handcast bench track"]
        pub scale: f64 = 0.03,
        /// Of the turn about the optical axis.
        ["rad", "handcast bench track"]
        pub turn: f64 = 0.08,
        /// Of the turns about the other two axes.
        ["rad", "handcast bench track"]
        pub tilt: f64 = 0.15,
        /// Of abduction.
        ["rad", "handcast bench track"]
        pub abduction: f64 = 0.1,
        /// Of flexion.
        ["rad", "handcast bench track"]
        pub flexion: f64 = 0.2,
    }
}

impl StepTuning {
    /// The step of a parameter, in its unit.
    pub fn of(&self, parameter: Parameter) -> f64 {
        match parameter {
            Parameter::X | Parameter::Y => self.position,
            Parameter::Scale => self.scale,
            Parameter::Turn(OPTICAL_AXIS) => self.turn,
            Parameter::Turn(_) => self.tilt,
            Parameter::Angle(k) if k % Finger::FREE_ANGLES == ABDUCTION => self.abduction,
            Parameter::Angle(_) => self.flexion,
        }
    }
}

/// Which parameters are estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Freedom {
    /// Position in the image.
    Two,
    /// And abduction of the five fingers.
    Seven,
    /// Position, abduction, flexion at the base of the fingers: the 12 of the paper's figs. 19 to 23.
    Twelve,
    /// And scale and rotation: the 16 of its hierarchical technique (6.5).
    Sixteen,
    /// All 21.
    #[default]
    All,
}

impl Freedom {
    /// Names and choices, as on the command line.
    pub const ALL: [(&'static str, Self); 5] = [
        ("2", Self::Two),
        ("7", Self::Seven),
        ("12", Self::Twelve),
        ("16", Self::Sixteen),
        ("21", Self::All),
    ];

    fn parameters(self) -> impl Iterator<Item = Parameter> {
        Parameter::all().filter(move |p| match self {
            Self::Two => p.rank() == 0,
            Self::Seven => matches!(p.rank(), 0 | 3),
            Self::Twelve => matches!(p.rank(), 0 | 3 | 4),
            Self::Sixteen => p.rank() < 5,
            Self::All => true,
        })
    }
}

/// In what order the parameters are estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Order {
    /// All at once.
    Whole,
    /// The paper's hierarchy (6.5): first the position, then scale, rotation, abduction and flexion are
    /// added, and at each stage all so far are estimated.
    Hierarchical,
    /// Position, scale and rotation; then one finger after the other; twice.
    #[default]
    Fingers,
}

impl Order {
    /// Names and orders, as on the command line.
    pub const ALL: [(&'static str, Self); 3] =
        [("whole", Self::Whole), ("hierarchical", Self::Hierarchical), ("fingers", Self::Fingers)];

    /// The parameters of each minimisation, one after the other.
    pub fn stages(self, freedom: Freedom) -> Vec<Vec<Parameter>> {
        let all: Vec<Parameter> = freedom.parameters().collect();
        let chosen = |keep: &dyn Fn(Parameter) -> bool| -> Vec<Parameter> {
            all.iter().copied().filter(|&p| keep(p)).collect()
        };
        match self {
            Self::Whole => vec![all],
            Self::Hierarchical => {
                let mut ranks: Vec<usize> = all.iter().map(|p| p.rank()).collect();
                ranks.sort_unstable();
                ranks.dedup();
                ranks.into_iter().map(|rank| chosen(&|p| p.rank() <= rank)).collect()
            }
            Self::Fingers => {
                let global = chosen(&|p| p.finger().is_none());
                let fingers = Finger::ALL.map(|f| chosen(&|p| p.finger() == Some(f)));
                let round: Vec<_> = std::iter::once(global).chain(fingers).collect();
                round.iter().chain(&round).cloned().collect()
            }
        }
    }
}

/// Some parameters of a state, as offsets from where they are, to be minimised over.
pub struct HandProblem<'a> {
    /// The model.
    pub model: &'a mut HandModel,
    /// What is minimised.
    pub functional: &'a mut dyn Functional,
    /// The silhouette.
    pub window: &'a Window,
    /// The feasible joint angles.
    pub domain: &'a Domain,
    origin: ModelState,
    chosen: Vec<Parameter>,
    steps: Vec<f64>,
}

impl<'a> HandProblem<'a> {
    /// The parameters `chosen` about `origin`, with the steps of each.
    pub fn new(
        model: &'a mut HandModel,
        functional: &'a mut dyn Functional,
        window: &'a Window,
        domain: &'a Domain,
        origin: ModelState,
        chosen: Vec<Parameter>,
        steps: Vec<f64>,
    ) -> Self {
        Self { model, functional, window, domain, origin, chosen, steps }
    }

    /// The state at a point.
    pub fn state(&self, point: &[f64]) -> ModelState {
        let mut s = self.origin.clone();
        let hand = HAND_LENGTH * self.origin.scale;
        let mut turn = [0.0; 3];
        for (parameter, &v) in self.chosen.iter().zip(point) {
            match *parameter {
                Parameter::X => s.wrist[0] += hand * v,
                Parameter::Y => s.wrist[1] += hand * v,
                Parameter::Scale => s.scale *= v.exp(),
                Parameter::Turn(k) => turn[k] = v,
                Parameter::Angle(k) => s.free[k] += v,
            }
        }
        if turn != [0.0; 3] {
            s.rotation = self.origin.turned(turn);
        }
        s
    }
}

impl Problem for HandProblem<'_> {
    fn steps(&self) -> &[f64] {
        &self.steps
    }

    fn groups(&self) -> Vec<Range<usize>> {
        let kind = |p: &Parameter| (p.finger(), if p.finger().is_none() { p.rank() } else { 0 });
        let mut groups: Vec<Range<usize>> = Vec::new();
        for (i, p) in self.chosen.iter().enumerate() {
            match groups.last_mut() {
                Some(last) if self.chosen.get(last.start).map(kind) == Some(kind(p)) => last.end = i + 1,
                _ => groups.push(i..i + 1),
            }
        }
        groups
    }

    fn inside(&mut self, from: &[f64], to: &[f64]) -> f64 {
        self.domain.clip_segment(&self.state(from).free, &self.state(to).free)
    }

    fn value(&mut self, point: &[f64]) -> f64 {
        let state = self.state(point);
        self.functional.value(self.model, &state, self.window)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn freedoms_have_the_numbers_of_the_paper() {
        for ((name, freedom), count) in Freedom::ALL.into_iter().zip([2, 7, 12, 16, 21]) {
            assert_eq!(freedom.parameters().count(), count, "{name}");
        }
    }

    #[test]
    fn orders_cover_all_parameters() {
        let count = |order: Order, freedom| order.stages(freedom).iter().map(Vec::len).collect::<Vec<_>>();
        assert_eq!(count(Order::Whole, Freedom::All), [21]);
        assert_eq!(count(Order::Hierarchical, Freedom::All), [2, 3, 6, 11, 16, 21]);
        assert_eq!(count(Order::Hierarchical, Freedom::Twelve), [2, 7, 12]);
        assert_eq!(count(Order::Fingers, Freedom::Sixteen), [6, 2, 2, 2, 2, 2, 6, 2, 2, 2, 2, 2]);
    }
}
