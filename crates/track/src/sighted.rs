//! From what a finder has seen to a state of the model.

use nalgebra::Point3;

use super::model::HandModel;
use super::state::ModelState;
use handcast_hand::landmarks::{LANDMARKS_21, PoseSolver, SolverOptions, from_landmarks_21};
use handcast_hand::{Joint, Morphology, Side};
use handcast_vision::sighting::{JOINTS, Sighting};

/// Times that place and size are aligned: perspective depends on both.
const ALIGNMENTS: usize = 3;

/// Makes states of sightings.
#[derive(Clone, Debug)]
pub(super) struct SightedPose {
    solver: PoseSolver,
    hand_length: f64,
}

impl SightedPose {
    pub(super) fn new(morphology: &Morphology, side: Side) -> Self {
        let options = SolverOptions { tie: true, max_steps: 8, ..SolverOptions::default() };
        Self { solver: PoseSolver::new(morphology, side, options), hand_length: morphology.hand_length }
    }

    /// The state whose joints are those of the sighting as far as the constraints allow; its depth where it is there.
    /// Places in pixels of the model's image, times `factor` those of the sighting. `None` without places in space, or
    /// where the palm is degenerate.
    pub(super) fn state(&mut self, model: &HandModel, seen: &Sighting, factor: f64) -> Option<ModelState> {
        let world = seen.world.as_ref()?;
        let scale = self.hand_length / seen.world_length()?.max(1e-3);
        let points: [_; JOINTS] = world.map(|[x, y, z]| Some(Point3::new(scale * x, -scale * y, -scale * z)));
        // Each frame for itself: an error must not be carried on.
        self.solver.reset();
        let pose = self.solver.solve(&from_landmarks_21(&points)).ok()?.pose;
        let seen = seen.points.map(|p| p.map(|v| v / factor));
        let mut state = ModelState { rotation: pose.rotation, ..ModelState::facing(seen[0], 1.0) };
        state = state.with_angles(&pose.angles);
        state.scale = spread(&seen) / spread(&flat(&pose, model)).max(1e-9);
        for _ in 0..ALIGNMENTS {
            align(model, &seen, &mut state);
        }
        Some(state)
    }
}

/// The joints without perspective, metres.
fn flat(pose: &handcast_hand::HandPose, model: &HandModel) -> [[f64; 2]; JOINTS] {
    let frames = model.skeleton().frames(pose);
    LANDMARKS_21.map(|joint| {
        let p = frames.position(joint);
        [p.x, -p.y]
    })
}

fn mean(points: &[[f64; 2]; JOINTS]) -> [f64; 2] {
    [0, 1].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / JOINTS as f64)
}

/// Root mean square distance from the middle.
fn spread(points: &[[f64; 2]; JOINTS]) -> f64 {
    let middle = mean(points);
    let square = |p: &[f64; 2]| (p[0] - middle[0]).powi(2) + (p[1] - middle[1]).powi(2);
    (points.iter().map(square).sum::<f64>() / JOINTS as f64).sqrt()
}

/// Moves, scales and turns `state` in the image to where its joints are nearest to those seen.
fn align(model: &HandModel, seen: &[[f64; 2]; JOINTS], state: &mut ModelState) {
    let joints: [[f64; 2]; Joint::COUNT] = model.joints(state);
    let placed = LANDMARKS_21.map(|joint| joints[joint.index()]);
    let (from, to) = (mean(&placed), mean(seen));
    let (mut straight, mut crossed, mut square) = (0.0, 0.0, 0.0);
    for (p, q) in placed.iter().zip(seen) {
        let (a, b) = ([p[0] - from[0], p[1] - from[1]], [q[0] - to[0], q[1] - to[1]]);
        straight += a[0] * b[0] + a[1] * b[1];
        crossed += a[0] * b[1] - a[1] * b[0];
        square += a[0] * a[0] + a[1] * a[1];
    }
    if square <= 0.0 || straight.hypot(crossed) <= 0.0 {
        return;
    }
    let grown = straight.hypot(crossed) / square;
    let turn = crossed.atan2(straight);
    // Clockwise in the image is negative about the camera's z axis.
    state.rotation = state.turned([0.0, 0.0, -turn]);
    state.scale *= grown;
    let joints = model.joints(state);
    let now = mean(&LANDMARKS_21.map(|joint| joints[joint.index()]));
    state.wrist = [state.wrist[0] + to[0] - now[0], state.wrist[1] + to[1] - now[1]];
}
