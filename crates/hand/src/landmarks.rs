//! From the positions of joints in space, as other trackers give them, to feasible poses and to the sizes
//! of the hand.
//!
//! A pose is found by damped least squares (Levenberg-Marquardt) on the analytic [`Jacobian`]; each step
//! is the exact minimum of the damped model inside the [`Domain`] of feasible angles. Every frame starts
//! from the one before, or from a rigid alignment of the palm when that lies nearer.

mod measure;
mod rays;

pub use measure::{SideTrial, bone_spread, hand_length, measure, measure_posed, tell_side};
use nalgebra::{
    Cholesky, DMatrix, DVector, Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3,
};
pub use rays::placed_on_lines;
use thiserror::Error;

use super::constraints::{DIP_FROM_PIP, palm_slope};
use super::jacobian::moved_by;
use super::pose::mirror_vector;
use super::quadratic::constrained_minimum;
use super::skeleton::THUMB_REST;
use super::{
    Domain, Finger, HandPose, Jacobian, Joint, JointAngle, JointAngles, Morphology, MorphologyError, Side,
    Skeleton, limits, thumb_mcp_slope,
};

/// Positions of the 25 joints in the order of [`Joint::ALL`], metres; `None` where one was not seen.
pub type JointPoints = [Option<Point3<f64>>; Joint::COUNT];

/// Bends of joints, radians; `None` where nothing tells them.
type Bends = [Option<f64>; JointAngle::COUNT];

/// What a solver brings joints to.
#[derive(Clone, Copy)]
enum Targets<'a> {
    /// Places in space.
    Points(&'a JointPoints),
    /// The lines from the origin through these points.
    Rays(&'a JointPoints),
    /// The ends of bones that go the ways of others, and how far joints bend between those.
    Bones(&'a JointPoints, &'a Bends),
}

impl Targets<'_> {
    fn points(&self) -> &JointPoints {
        match self {
            Targets::Points(points) | Targets::Rays(points) | Targets::Bones(points, _) => points,
        }
    }

    /// The part of a displacement that changes the distance from what belongs to this point.
    fn across(&self, point: &Point3<f64>, displacement: Vector3<f64>) -> Vector3<f64> {
        match self {
            Targets::Points(_) | Targets::Bones(..) => displacement,
            Targets::Rays(_) => match point.coords.try_normalize(1e-12) {
                Some(ray) => displacement - ray * ray.dot(&displacement),
                None => displacement,
            },
        }
    }

    /// The joints seen, and where each is away from what it belongs to.
    fn residuals<'b>(
        &'b self,
        position: impl Fn(Joint) -> Point3<f64> + 'b,
    ) -> impl Iterator<Item = (Joint, Point3<f64>, Vector3<f64>)> + 'b {
        seen_joints(self.points())
            .map(move |(joint, point)| (joint, point, self.across(&point, position(joint) - point)))
    }
}

/// The joints of a 21-point hand in the usual order: wrist, then thumb, index, middle, ring and little
/// finger, each from the palm to the tip.
pub const LANDMARKS_21: [Joint; 21] = {
    use Joint::*;
    [
        Wrist,
        ThumbMetacarpal,
        ThumbProximal,
        ThumbDistal,
        ThumbTip,
        IndexProximal,
        IndexIntermediate,
        IndexDistal,
        IndexTip,
        MiddleProximal,
        MiddleIntermediate,
        MiddleDistal,
        MiddleTip,
        RingProximal,
        RingIntermediate,
        RingDistal,
        RingTip,
        PinkyProximal,
        PinkyIntermediate,
        PinkyDistal,
        PinkyTip,
    ]
};

/// The joints of the palm, which moves as one piece but for its bends.
pub const PALM: [Joint; 6] = {
    use Joint::*;
    [Wrist, ThumbMetacarpal, IndexProximal, MiddleProximal, RingProximal, PinkyProximal]
};

/// Places 21 points in the order of [`LANDMARKS_21`].
pub fn from_landmarks_21(points: &[Option<Point3<f64>>; 21]) -> JointPoints {
    let mut out = [None; Joint::COUNT];
    for (joint, point) in LANDMARKS_21.into_iter().zip(points) {
        out[joint.index()] = *point;
    }
    out
}

/// Where the tips of the fingers are among 21 points, each behind the joint before it.
pub const TIPS_21: [usize; Finger::COUNT] = [4, 8, 12, 16, 20];

/// How far inside the end of a finger MediaPipe and those who follow it have the tip, end bones: below the nail, not
/// where the finger ends. Measured on rendered hands, whose ends are known.
pub const TIP_INSIDE: f64 = 0.28;

/// The 21 points that MediaPipe has of a hand, of the joints of a model.
pub fn mediapipe_21(position: impl Fn(Joint) -> Point3<f64>) -> [Point3<f64>; 21] {
    let mut points = LANDMARKS_21.map(position);
    for tip in TIPS_21 {
        points[tip] = points[tip] + (points[tip - 1] - points[tip]) * TIP_INSIDE;
    }
    points
}

/// Moves the tips of [`mediapipe_21`], in space or in a picture, to the ends of the fingers.
pub fn move_tips_to_ends(points: &mut JointPoints) {
    for tip in Finger::ALL.map(Joint::tip).map(Joint::index) {
        if let (Some(inner), Some(inside)) = (points[tip - 1], points[tip]) {
            points[tip] = Some(inner + (inside - inner) / (1.0 - TIP_INSIDE));
        }
    }
}

/// Why landmarks do not give a hand.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum LandmarkError {
    /// Wrist, thumb base and the four knuckles are never seen together.
    #[error("landmarks: no frame shows the wrist, the thumb's base and the four knuckles together")]
    NoPalm,
    /// The hand is too long or too short in the unit that the source has.
    #[error(
        "landmarks: the hand would be {length:.4} m long, and its numbers look like {looks}: allowed are 0.05 to 0.4 m"
    )]
    Unit {
        /// Metres.
        length: f64,
        /// The unit in which it would be as long as hands are.
        looks: &'static str,
    },
    /// Joints are known in a picture alone, and not how large it is.
    #[error("landmarks: joints in a picture alone, whose size in pixels is not told")]
    NoPictureSize,
    /// The palm's points lie on one line or in one place.
    #[error("landmarks: the points of the palm do not span a plane")]
    Degenerate,
    /// Fewer points than fix the hand in space.
    #[error("landmarks: {seen} points of the palm seen, {needed} needed")]
    TooFew {
        /// Points seen.
        seen: usize,
        /// Points needed.
        needed: usize,
    },
    /// The sizes found are not those of a hand.
    #[error("landmarks: {0}")]
    Morphology(#[from] MorphologyError),
}

/// What [`PoseSolver`] may vary.
#[derive(Clone, Debug, PartialEq)]
pub struct SolverOptions {
    /// Keeps equalities (2) and (5) and the cupped palm, so that end joints follow middle joints, the thumb's MCP its CMC,
    /// and palms the knuckles: the paper's 21 parameters. Off, each joint bends as the points say; the static limits and
    /// the inequalities hold either way.
    pub tie: bool,
    /// With `tie`, lets the thumb's MCP bend by itself: the tracker's 22 parameters.
    pub thumb: bool,
    /// Lets fingers and thumb twist; ignored with `tie`.
    pub twists: bool,
    /// Lets the palm bend at the metacarpals' bases; ignored with `tie`.
    pub palm: bool,
    /// Keeps the inequalities (3) and (4). Off, only the static limits hold.
    pub dynamic: bool,
    /// Most steps a frame.
    pub max_steps: usize,
}

impl Default for SolverOptions {
    fn default() -> Self {
        Self { tie: false, thumb: false, twists: true, palm: false, dynamic: true, max_steps: 30 }
    }
}

/// The pose found for one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// The pose.
    pub pose: HandPose,
    /// Mean distance of the joints seen from those of the pose, metres.
    pub mean_distance: f64,
    /// Largest such distance, metres.
    pub max_distance: f64,
    /// Joints seen.
    pub seen: usize,
    /// Steps taken.
    pub steps: usize,
}

/// Finds poses frame by frame, starting from the last.
#[derive(Clone, Debug)]
pub struct PoseSolver {
    options: SolverOptions,
    side: Side,
    /// Everything is solved as a right hand; left hands are mirrored on the way in and out.
    skeleton: Skeleton,
    palm: [Point3<f64>; 6],
    variables: Vec<JointAngle>,
    domain: Domain,
    last: Option<HandPose>,
}

/// Pull of twists and palm bends towards zero, m²/rad²: 7 mm a radian. It decides where the points do not
/// (a straight finger shows no twist) and keeps their noise out; a bent finger shows twenty times as much.
const PULL_TO_ZERO: f64 = 5e-5;
/// The same for sources that show the metacarpals: headsets give the joints of a rigid hand, without noise.
const XR_PULL_TO_ZERO: f64 = 1e-6;
/// Pull of the other angles towards the starting pose, m²/rad²: only joints nobody sees feel it.
const PULL_TO_START: f64 = 1e-9;
/// The same where only the lines of sight are known, which hardly tell how far a joint bends towards the camera.
const RAYS_PULL_TO_START: f64 = 1e-6;
/// Pull of hinges towards the bends between bones whose lengths change, m²/rad²: 100 mm a radian, twice the length of what
/// a middle joint moves. Learned trackers also bend fingers sideways, which no hinge does: places alone would make up for
/// that by bending further or less.
const PULL_TO_BENDS: f64 = 1e-2;

impl PoseSolver {
    /// A solver for one hand of these sizes.
    pub fn new(morphology: &Morphology, side: Side, options: SolverOptions) -> Self {
        use JointAngle::*;
        let (variables, domain) = if options.tie {
            let own: &[JointAngle] = if options.thumb { &[Thumb2Flexion] } else { &[] };
            let variables = [&Domain::FREE, own].concat();
            let domain = Domain::over(&variables);
            (variables, domain)
        } else {
            let fixed = |a: &JointAngle| match a {
                Index0Flexion | Middle0Flexion | Ring0Flexion | Pinky0Flexion => !options.palm,
                Thumb1Twisting | Index1Twisting | Middle1Twisting | Ring1Twisting | Pinky1Twisting => {
                    !options.twists
                }
                _ => false,
            };
            let variables: Vec<_> = JointAngle::ALL.into_iter().filter(|a| !fixed(a)).collect();
            let domain = Domain::over(&variables);
            (variables, domain)
        };
        let domain = if options.dynamic { domain } else { domain.static_limits() };
        let skeleton = Skeleton::new(morphology, Side::Right);
        let rest = skeleton.local_frames(&[0.0; JointAngle::COUNT]);
        Self { options, side, skeleton, palm: PALM.map(|j| rest.position(j)), variables, domain, last: None }
    }

    /// Forgets the last pose: the next frame starts from its palm.
    pub fn reset(&mut self) {
        self.last = None;
    }

    /// The pose of one frame.
    ///
    /// # Errors
    /// [`LandmarkError::TooFew`] or [`LandmarkError::Degenerate`] when less than three points of the
    /// palm (wrist, thumb base, knuckles) are there to say where the hand is.
    pub fn solve(&mut self, points: &JointPoints) -> Result<Fit, LandmarkError> {
        let points = match self.side {
            Side::Right => *points,
            Side::Left => mirrored_points(points),
        };
        let (pose, steps) = self.solved(Targets::Points(&points))?;
        Ok(self.fitted(pose, steps, Targets::Points(&points)))
    }

    /// The pose of a right hand that is nearest to the targets, and the steps taken.
    fn solved(&self, targets: Targets) -> Result<(HandPose, usize), LandmarkError> {
        let start = self.initial(targets.points())?;
        let mut best = (self.cost(&start, &start, targets), start);
        if let Some(last) = &self.last {
            let cost = self.cost(last, last, targets);
            if cost < best.0 {
                best = (cost, last.clone());
            }
        }
        Ok(self.refine(best.1, targets))
    }

    /// As [`PoseSolver::solve`], of points whose bones change their lengths from frame to frame, as those that learned
    /// trackers find: the palm is laid over them, and each bone, as long as the hand's own, goes the way that they show,
    /// so that joints bend as between them. Distances are from the points as they are.
    ///
    /// # Errors
    /// Those of [`PoseSolver::solve`].
    pub fn solve_along(&mut self, points: &JointPoints) -> Result<Fit, LandmarkError> {
        let of_right = match self.side {
            Side::Right => *points,
            Side::Left => mirrored_points(points),
        };
        let Some((along, bends)) = self.along(&of_right) else { return self.solve(points) };
        let (pose, steps) = self.solved(Targets::Bones(&along, &bends))?;
        Ok(self.fitted(pose, steps, Targets::Points(&of_right)))
    }

    /// The hand's own bones along those of points, and the bends between these; joints behind one that is not seen are
    /// left out.
    fn along(&self, points: &JointPoints) -> Option<(JointPoints, Bends)> {
        let pairs: Vec<_> =
            PALM.iter().zip(&self.palm).filter_map(|(j, p)| Some((*p, points[j.index()]?))).collect();
        if pairs.len() < 3 {
            return None;
        }
        let laid = align(&pairs)?;
        let rest = self.skeleton.local_frames(&[0.0; JointAngle::COUNT]);
        let mut out = [None; Joint::COUNT];
        let mut bends = [None; JointAngle::COUNT];
        for joint in PALM {
            out[joint.index()] = Some(laid * rest.position(joint));
        }
        for finger in Finger::ALL {
            // How the thumb's hinges lie follows from its base, those of the fingers lie across the palm.
            if finger != Finger::Thumb {
                let bones = bones(finger, &laid, points);
                bends[finger.middle_flexion().index()] = hinged(bones[0], bones[1]);
                bends[finger.end_flexion().index()] = hinged(bones[1], bones[2]);
            }
            let base = Joint::base(finger).index();
            for k in base..base + 3 {
                let length = (rest.position(Joint::ALL[k + 1]) - rest.position(Joint::ALL[k])).norm();
                out[k + 1] = match (out[k], points[k], points[k + 1]) {
                    (Some(from), Some(a), Some(b)) => (b - a).try_normalize(1e-9).map(|d| from + d * length),
                    _ => None,
                };
            }
        }
        Some((out, bends))
    }

    /// Keeps the pose found of a right hand, and tells how far its joints are from what was seen.
    fn fitted(&mut self, pose: HandPose, steps: usize, targets: Targets) -> Fit {
        let (mut sum, mut max_distance, mut seen) = (0.0, 0.0f64, 0usize);
        let frames = self.skeleton.frames(&pose);
        for (_, _, residual) in targets.residuals(|joint| frames.position(joint)) {
            let distance = residual.norm();
            sum += distance;
            max_distance = max_distance.max(distance);
            seen += 1;
        }
        self.last = Some(pose.clone());
        let pose = match self.side {
            Side::Right => pose,
            Side::Left => pose.mirrored(),
        };
        Fit { pose, mean_distance: sum / seen.max(1) as f64, max_distance, seen, steps }
    }

    /// The palm laid over the points seen of it, and each finger bent the way its bones point.
    fn initial(&self, points: &JointPoints) -> Result<HandPose, LandmarkError> {
        let pairs: Vec<_> =
            PALM.iter().zip(&self.palm).filter_map(|(j, p)| Some((*p, points[j.index()]?))).collect();
        if pairs.len() < 3 {
            return Err(LandmarkError::TooFew { seen: pairs.len(), needed: 3 });
        }
        let rigid = align(&pairs).ok_or(LandmarkError::Degenerate)?;
        let mut pose = HandPose::neutral(Side::Right);
        pose.translation = rigid.translation.vector;
        pose.rotation = rigid.rotation;
        if let Some(last) = &self.last {
            pose.angles = last.angles;
        }
        for finger in Finger::ALL {
            bend(finger, &rigid, points, &mut pose);
        }
        let values: Vec<f64> = self.variables.iter().map(|a| pose.angle(*a)).collect();
        pose.angles = self.expanded(&self.domain.project(&values));
        Ok(pose)
    }

    /// All angles from the variables; those that are not varied are zero or tied.
    fn expanded(&self, values: &[f64]) -> JointAngles {
        let varied = |mut angles: JointAngles| {
            for (angle, value) in self.variables.iter().zip(values) {
                angles[angle.index()] = *value;
            }
            angles
        };
        let angles = varied([0.0; JointAngle::COUNT]);
        if self.options.tie { varied(Domain::expand(&Domain::reduce(&angles))) } else { angles }
    }

    /// For each angle the variable that drives it, and how strongly at this pose.
    fn drivers(&self, angles: &JointAngles) -> [Option<(usize, f64)>; JointAngle::COUNT] {
        let mut out = [None; JointAngle::COUNT];
        let at = |angle| self.variables.iter().position(|v| *v == angle);
        if self.options.tie {
            for finger in Finger::LONG {
                out[finger.end_flexion().index()] = at(finger.middle_flexion()).map(|i| (i, DIP_FROM_PIP));
                if let Some(palm) = finger.palm_flexion() {
                    let base = finger.base_flexion();
                    out[palm.index()] = at(base).map(|i| (i, palm_slope(finger, angles[base.index()])));
                }
            }
            let (cmc, mcp) = (JointAngle::Thumb1Flexion, JointAngle::Thumb2Flexion);
            out[mcp.index()] = at(cmc).map(|i| (i, thumb_mcp_slope(angles[cmc.index()])));
        }
        // What is varied follows nothing else.
        for (i, angle) in self.variables.iter().enumerate() {
            out[angle.index()] = Some((i, 1.0));
        }
        out
    }

    fn pull(&self, angle: JointAngle, start: &HandPose, targets: Targets) -> (f64, f64) {
        use JointAngle::*;
        let to_start = match targets {
            Targets::Bones(_, bends) => match bends[angle.index()] {
                Some(bend) => return (PULL_TO_BENDS, bend),
                None => PULL_TO_START,
            },
            Targets::Points(_) => PULL_TO_START,
            Targets::Rays(_) => RAYS_PULL_TO_START,
        };
        match angle {
            Index0Flexion | Middle0Flexion | Ring0Flexion | Pinky0Flexion | Thumb1Twisting
            | Index1Twisting | Middle1Twisting | Ring1Twisting | Pinky1Twisting => {
                (if self.options.palm { XR_PULL_TO_ZERO } else { PULL_TO_ZERO }, 0.0)
            }
            _ => (to_start, start.angle(angle)),
        }
    }

    /// Sum of squared distances, m², and the pulls.
    fn cost(&self, pose: &HandPose, start: &HandPose, targets: Targets) -> f64 {
        let frames = self.skeleton.frames(pose);
        let distances: f64 =
            targets.residuals(|joint| frames.position(joint)).map(|(_, _, r)| r.norm_squared()).sum();
        let pulls: f64 = self
            .variables
            .iter()
            .map(|a| {
                let (weight, to) = self.pull(*a, start, targets);
                weight * (pose.angle(*a) - to).powi(2)
            })
            .sum();
        distances + pulls
    }

    /// Levenberg-Marquardt from `start`; the pose found and the steps taken.
    fn refine(&self, start: HandPose, targets: Targets) -> (HandPose, usize) {
        let n = self.variables.len();
        let mut pose = start.clone();
        let mut cost = self.cost(&pose, &start, targets);
        let mut damping = 1e-4;
        let mut steps = 0;
        while steps < self.options.max_steps {
            let (normal, gradient) = self.normal_equations(&pose, &start, targets);
            let mut improved = None;
            while improved.is_none() && damping < 1e4 && steps < self.options.max_steps {
                steps += 1;
                let mut damped = normal.clone();
                for i in 0..n + 6 {
                    damped[(i, i)] += damping * normal[(i, i)] + 1e-12;
                }
                let candidate = Cholesky::new(damped).and_then(|factor| {
                    let target = self.state(&pose) - factor.solve(&gradient);
                    constrained_minimum(Some(&factor), target, self.domain.half_spaces())
                });
                if let Some(candidate) = candidate.map(|x| self.moved(&pose, &x)) {
                    let new = self.cost(&candidate, &start, targets);
                    if new <= cost {
                        improved = Some((candidate, new));
                        damping = (damping * 0.1).max(1e-9);
                        continue;
                    }
                }
                damping *= 8.0;
            }
            let Some((candidate, new)) = improved else { break };
            let gain = cost - new;
            pose = candidate;
            cost = new;
            if gain <= 1e-5 * cost + 1e-12 {
                break;
            }
        }
        (pose, steps)
    }

    /// The variables of a pose, then six zeros for the global part.
    fn state(&self, pose: &HandPose) -> DVector<f64> {
        let n = self.variables.len();
        DVector::from_fn(n + 6, |i, _| if i < n { pose.angle(self.variables[i]) } else { 0.0 })
    }

    /// `pose` with new variables, moved and turned by the last six values of `state`.
    fn moved(&self, pose: &HandPose, state: &DVector<f64>) -> HandPose {
        let n = self.variables.len();
        let triple = |i: usize| Vector3::new(state[i], state[i + 1], state[i + 2]);
        let mut rotation = UnitQuaternion::from_scaled_axis(triple(n + 3)) * pose.rotation;
        rotation.renormalize_fast();
        HandPose {
            side: pose.side,
            translation: pose.translation + triple(n),
            rotation,
            angles: self.expanded(&state.as_slice()[..n]),
        }
    }

    /// JᵀJ and Jᵀr of distances and pulls, the variables first, then translation and rotation.
    fn normal_equations(
        &self,
        pose: &HandPose,
        start: &HandPose,
        targets: Targets,
    ) -> (DMatrix<f64>, DVector<f64>) {
        let n = self.variables.len();
        let mut normal = DMatrix::zeros(n + 6, n + 6);
        let mut gradient = DVector::zeros(n + 6);
        let jacobian = Jacobian::new(&self.skeleton, pose);
        let drivers = self.drivers(&pose.angles);
        let mut columns: Vec<(usize, Vector3<f64>)> = Vec::with_capacity(12);
        for (joint, point, residual) in targets.residuals(|joint| jacobian.frames().position(joint)) {
            let position = jacobian.frames().position(joint);
            columns.clear();
            for &angle in moved_by(joint) {
                if let Some((variable, strength)) = drivers[angle.index()] {
                    columns.push((variable, jacobian.by_angle(angle, &position) * strength));
                }
            }
            for (i, turn) in jacobian.by_rotation(&position).into_iter().enumerate() {
                columns.push((n + i, Vector3::ith(i, 1.0)));
                columns.push((n + 3 + i, turn));
            }
            for (_, column) in &mut columns {
                *column = targets.across(&point, *column);
            }
            for (i, a) in &columns {
                gradient[*i] += a.dot(&residual);
                for (j, b) in &columns {
                    normal[(*i, *j)] += a.dot(b);
                }
            }
        }
        for (i, angle) in self.variables.iter().enumerate() {
            let (weight, to) = self.pull(*angle, start, targets);
            normal[(i, i)] += weight;
            gradient[i] += weight * (pose.angle(*angle) - to);
        }
        (normal, gradient)
    }
}

fn seen_joints(points: &JointPoints) -> impl Iterator<Item = (Joint, Point3<f64>)> {
    Joint::ALL.into_iter().zip(points).filter_map(|(j, p)| Some((j, (*p)?)))
}

fn mirrored_points(points: &JointPoints) -> JointPoints {
    points.map(|p| p.map(|p| Point3::from(mirror_vector(p.coords))))
}

/// The rotation and translation that bring the first points of the pairs nearest to the second ones
/// (Kabsch, Acta Cryst. A32, 1976); `None` when they span no plane.
fn align(pairs: &[(Point3<f64>, Point3<f64>)]) -> Option<Isometry3<f64>> {
    let n = pairs.len() as f64;
    let from = pairs.iter().map(|p| p.0.coords).sum::<Vector3<f64>>() / n;
    let to = pairs.iter().map(|p| p.1.coords).sum::<Vector3<f64>>() / n;
    let mut covariance = Matrix3::zeros();
    for (a, b) in pairs {
        covariance += (b.coords - to) * (a.coords - from).transpose();
    }
    let svd = covariance.try_svd(true, true, f64::EPSILON, 200)?;
    let (u, mut v) = (svd.u?, svd.v_t?);
    let (largest, second) = (svd.singular_values[0], svd.singular_values[1]);
    if !(second > 1e-6 * largest && largest > 0.0) {
        return None;
    }
    if (u.determinant() * v.determinant()) < 0.0 {
        v.row_mut(2).neg_mut();
    }
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * v));
    Some(Isometry3::from_parts(Translation3::from(to - rotation * from), rotation))
}

/// Directions of a finger's bones in the palm's frame.
fn bones(finger: Finger, palm: &Isometry3<f64>, points: &JointPoints) -> [Option<Vector3<f64>>; 3] {
    let base = Joint::base(finger).index();
    std::array::from_fn(|k| {
        let bone = points[base + k + 1]? - points[base + k]?;
        palm.rotation.inverse_transform_vector(&bone).try_normalize(1e-9)
    })
}

/// The angle between two bones of a finger of a right hand, less than zero where it is bent backwards.
fn hinged(a: Option<Vector3<f64>>, b: Option<Vector3<f64>>) -> Option<f64> {
    let (a, b) = (a?, b?);
    Some(a.angle(&b).copysign(a.cross(&b).x))
}

/// Flexion and abduction of a finger's base from the direction of its first bone, and the bends after it
/// from the angles between bones; joints that are not seen leave the pose as it is.
fn bend(finger: Finger, palm: &Isometry3<f64>, points: &JointPoints, pose: &mut HandPose) {
    let bones = bones(finger, palm, points);
    if let Some(d) = bones[0] {
        let (flexion, abduction) = match finger {
            Finger::Thumb => (f64::atan2(-d.x, d.y) + THUMB_REST, d.z.clamp(-1.0, 1.0).asin()),
            _ => {
                // Beyond a right angle the bone points back to the wrist.
                let back = if d.y < 0.0 { -1.0 } else { 1.0 };
                let swing = f64::atan2(-d.x * back, d.y * back);
                let sign = if matches!(finger, Finger::Ring | Finger::Pinky) { 1.0 } else { -1.0 };
                (f64::atan2(d.z, back * d.x.hypot(d.y)), sign * swing)
            }
        };
        let l = limits(finger.abduction());
        pose.set(finger.base_flexion(), flexion);
        pose.set(finger.abduction(), abduction.clamp(l.min, l.max));
    }
    for (k, angle) in [finger.middle_flexion(), finger.end_flexion()].into_iter().enumerate() {
        if let (Some(a), Some(b)) = (bones[k], bones[k + 1]) {
            pose.set(angle, a.angle(&b));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FREE_ANGLES;
    use proptest::prelude::*;

    /// A feasible pose anywhere in space.
    fn feasible_pose() -> impl Strategy<Value = HandPose> {
        (prop::array::uniform15(-1.0f64..2.0), prop::array::uniform6(-2.0f64..2.0), any::<bool>()).prop_map(
            |(free, global, left)| {
                let domain = Domain::free();
                let t = domain.clip_segment(&[0.0; FREE_ANGLES], &free);
                HandPose {
                    side: if left { Side::Left } else { Side::Right },
                    translation: Vector3::new(global[0], global[1], global[2]),
                    rotation: UnitQuaternion::from_scaled_axis(Vector3::new(global[3], global[4], global[5])),
                    angles: Domain::expand(&free.map(|v| 0.95 * v * t)),
                }
            },
        )
    }

    pub(super) fn points_of(morphology: &Morphology, pose: &HandPose) -> JointPoints {
        let frames = Skeleton::new(morphology, pose.side).frames(pose);
        let mut points = [None; Joint::COUNT];
        for joint in LANDMARKS_21 {
            points[joint.index()] = Some(frames.position(joint));
        }
        points
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn exact_points_give_the_pose_back(pose in feasible_pose(), thumb in -0.2f64..1.0) {
            let morphology = Morphology::average(0.18);
            for (tie, own) in [(false, true), (true, false), (true, true)] {
                let options = SolverOptions { tie, thumb: own, ..SolverOptions::default() };
                let mut solver = PoseSolver::new(&morphology, pose.side, options);
                let mut pose = pose.clone();
                if own {
                    pose.set(JointAngle::Thumb2Flexion, thumb);
                }
                // Untied, the palm is held flat.
                for palm in Finger::LONG.into_iter().filter_map(Finger::palm_flexion).filter(|_| !tie) {
                    pose.set(palm, 0.0);
                }
                let fit = solver.solve(&points_of(&morphology, &pose)).unwrap();
                prop_assert!(fit.mean_distance < 2e-4, "{} mm", fit.mean_distance * 1e3);
                prop_assert!(Domain::full().is_feasible(&fit.pose.angles, 1e-9));
                prop_assert_eq!(fit.pose.side, pose.side);
            }
        }

        #[test]
        fn noisy_points_keep_the_pose_feasible(
            pose in feasible_pose(),
            noise in prop::collection::vec(prop::array::uniform3(-0.01f64..0.01), Joint::COUNT),
            missing in prop::collection::vec(0..Joint::COUNT, 0..6),
        ) {
            let morphology = Morphology::default();
            let mut points = points_of(&morphology, &pose);
            for (p, n) in points.iter_mut().zip(noise) {
                *p = p.map(|p| p + Vector3::from(n));
            }
            for joint in missing {
                if !PALM.iter().any(|j| j.index() == joint) {
                    points[joint] = None;
                }
            }
            let mut solver = PoseSolver::new(&morphology, pose.side, SolverOptions::default());
            let fit = solver.solve(&points).unwrap();
            prop_assert!(fit.mean_distance < 0.012);
            prop_assert!(Domain::full().is_feasible(&fit.pose.angles, 1e-9));
        }
    }

    #[test]
    fn the_25_joints_of_xr_give_palm_bends_and_twists_back() {
        let morphology = Morphology::average(0.19);
        let options = SolverOptions { palm: true, ..SolverOptions::default() };
        for side in [Side::Left, Side::Right] {
            let mut solver = PoseSolver::new(&morphology, side, options.clone());
            let mut pose = HandPose::neutral(side);
            pose.rotation = UnitQuaternion::from_euler_angles(0.4, -1.0, 2.0);
            for (i, finger) in Finger::ALL.into_iter().enumerate() {
                pose.set(finger.base_flexion(), 0.3 + 0.05 * i as f64);
                pose.set(finger.abduction(), 0.1);
                pose.set(finger.twisting(), 0.08 * i as f64 - 0.15);
                pose.set(finger.middle_flexion(), 0.6);
                pose.set(finger.end_flexion(), 0.3);
            }
            pose.set(JointAngle::Ring0Flexion, 0.2);
            pose.set(JointAngle::Pinky0Flexion, 0.4);
            let frames = Skeleton::new(&morphology, side).frames(&pose);
            let fit = solver.solve(&Joint::ALL.map(|j| Some(frames.position(j)))).unwrap();
            assert!(fit.max_distance < 5e-4, "{} mm", fit.max_distance * 1e3);
            for (angle, (a, b)) in JointAngle::ALL.iter().zip(fit.pose.angles.iter().zip(&pose.angles)) {
                assert!((a - b).abs() < 0.03, "{}: {a} {b}", angle.name());
            }
        }
    }

    #[test]
    fn bones_of_changing_length_bend_as_they_point() {
        let morphology = Morphology::average(0.19);
        for side in [Side::Left, Side::Right] {
            let mut solver = PoseSolver::new(&morphology, side, SolverOptions::default());
            let mut pose = HandPose::neutral(side);
            pose.translation = Vector3::new(0.1, 0.2, -0.6);
            for finger in Finger::LONG {
                pose.set(finger.middle_flexion(), 0.9);
                pose.set(finger.end_flexion(), 0.5);
            }
            // Bent backwards.
            pose.set(Finger::Index.end_flexion(), -0.2);
            let mut points = points_of(&morphology, &pose);
            for finger in Finger::LONG {
                let base = Joint::base(finger).index();
                let mut joints: Vec<Point3<f64>> = (base..base + 4).filter_map(|k| points[k]).collect();
                let bones: Vec<Vector3<f64>> = joints.windows(2).map(|w| w[1] - w[0]).collect();
                for (k, (bone, stretch)) in bones.iter().zip([0.8, 1.3, 0.6]).enumerate() {
                    joints[k + 1] = joints[k] + bone * stretch;
                    points[base + k + 1] = Some(joints[k + 1]);
                }
            }
            let along = solver.solve_along(&points).unwrap();
            solver.reset();
            let plain = solver.solve(&points).unwrap();
            let off = |fit: &Fit| {
                let angles = Finger::LONG.map(|finger| (fit.pose.angle(finger.middle_flexion()) - 0.9).abs());
                angles.into_iter().fold(0.0, f64::max).to_degrees()
            };
            let ends = Finger::LONG.map(|f| {
                (along.pose.angle(f.end_flexion()) - pose.angle(f.end_flexion())).abs().to_degrees()
            });
            assert!(ends.into_iter().all(|off| off < 0.5), "{ends:?}");
            assert!(off(&along) < 0.5 && off(&plain) > 1.0, "{}° {}°", off(&along), off(&plain));
            assert!(along.max_distance > 2e-3, "from the points as they are: {along:?}");
        }
    }

    #[test]
    fn too_little_is_refused() {
        let mut solver = PoseSolver::new(&Morphology::default(), Side::Right, SolverOptions::default());
        let mut points: JointPoints = [None; Joint::COUNT];
        assert_eq!(solver.solve(&points), Err(LandmarkError::TooFew { seen: 0, needed: 3 }));
        for joint in PALM {
            points[joint.index()] = Some(Point3::new(0.01 * joint.index() as f64, 0.0, 0.0));
        }
        assert_eq!(solver.solve(&points), Err(LandmarkError::Degenerate));
        assert_eq!(measure(&[[None; Joint::COUNT]], Side::Left), Err(LandmarkError::NoPalm));
    }
}
