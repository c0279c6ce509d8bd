//! The projected spheres of the model, and their Jacobian.

use nalgebra::{Point3, Vector3};

use super::model::{HandModel, View2d};
use super::raster::ProjectedDisc;
use super::state::ModelState;
use handcast_hand::{
    DIP_FROM_PIP, FREE_ANGLES, Finger, HandPose, Jacobian, Joint, JointAngle, Sphere, moved_by, palm_slope,
    thumb_mcp_slope,
};

/// Place of the logarithm of the scale among the parameters of a step, after the wrist's x and y (pixels).
pub(super) const SCALE: usize = 2;
/// Place of the turn about the camera's x axis, radians; y and z follow.
pub(super) const TURN: usize = SCALE + 1;
/// Place of the first free angle, radians: as many parameters are global.
pub(super) const FREE: usize = TURN + 3;
/// Place of the thumb's MCP flexion beyond eq. (5), radians.
pub(super) const THUMB_MCP: usize = FREE + FREE_ANGLES;
/// How many parameters a step of a [`ModelState`] has.
pub(super) const PARAMETERS: usize = THUMB_MCP + 1;
/// Angles that turn the bones of a finger: its free ones, and of the thumb its MCP flexion.
pub(super) const OWN: usize = Finger::FREE_ANGLES + 1;
/// Columns of the Jacobian of one sphere: the global parameters and those of its finger.
pub(super) const COLUMNS: usize = FREE + OWN;

/// The parameter that a column of a sphere that moves with `finger` belongs to.
pub(super) fn parameter(finger: Finger, column: usize) -> usize {
    match column {
        0..FREE => column,
        FREE..THUMB_COLUMN => FREE + finger.free_base() + column - FREE,
        _ => THUMB_MCP,
    }
}

/// The column of [`THUMB_MCP`].
const THUMB_COLUMN: usize = COLUMNS - 1;

/// A sphere of the shape in the image.
#[derive(Clone, Copy, Debug)]
pub(super) struct ProjectedSphere {
    /// Its outline, pixels.
    pub(super) disc: ProjectedDisc,
    /// Its centre seen from the wrist, metres, camera axes.
    pub(super) centre: Vector3<f64>,
    /// Its radius, metres.
    pub(super) radius: f64,
    /// The finger whose angles move it; `None` for the palm.
    pub(super) finger: Option<Finger>,
    /// Change of x, y and radius, pixels, for each of the [`COLUMNS`].
    pub(super) columns: [[f64; 3]; COLUMNS],
    /// Change of its centre, metres, for each of the columns that its finger has of its own.
    pub(super) moves: [Vector3<f64>; OWN],
}

impl ProjectedSphere {
    /// How much nearer to the camera than the wrist its centre is, metres.
    pub(super) fn depth(&self) -> f64 {
        self.centre.z
    }
}

/// Bones of a finger that its angles turn.
const BONES: usize = 3;

/// How the bones of the fingers turn: by finger, bone from the palm outwards, and free angle of the finger, the
/// rotation vector (camera axes) of a radian.
pub(super) type Turns = [[[Vector3<f32>; OWN]; BONES]; Finger::COUNT];

impl ModelState {
    /// The state after a step of its parameters.
    pub(super) fn stepped(&self, step: &[f64; PARAMETERS]) -> Self {
        Self {
            wrist: [self.wrist[0] + step[0], self.wrist[1] + step[1]],
            scale: self.scale * step[SCALE].exp(),
            rotation: self.turned([step[TURN], step[TURN + 1], step[TURN + 2]]),
            free: std::array::from_fn(|i| self.free[i] + step[FREE + i]),
            thumb_mcp: self.thumb_mcp + step[THUMB_MCP],
        }
    }
}

impl HandModel {
    /// Projects the spheres of the shape, with their Jacobians; gives that of the bones' directions.
    pub(super) fn project_moving(&self, state: &ModelState, out: &mut Vec<ProjectedSphere>) -> Turns {
        let pose = HandPose {
            side: self.side(),
            translation: nalgebra::Vector3::zeros(),
            rotation: state.rotation,
            angles: state.angles(),
        };
        let jacobian = Jacobian::new(self.skeleton(), &pose);
        let view = View2d::new(self.camera(), state);
        out.clear();
        out.extend(self.shape().spheres().iter().map(|s| project_sphere(s, state, &view, &jacobian)));
        Finger::ALL.map(|finger| bone_turns(finger, state, &jacobian))
    }
}

/// A sphere in the image, with its Jacobian.
fn project_sphere(
    sphere: &Sphere,
    state: &ModelState,
    view: &View2d,
    jacobian: &Jacobian,
) -> ProjectedSphere {
    let centre = jacobian.frames().get(sphere.joint) * sphere.offset;
    let finger = Finger::ALL.into_iter().find(|&f| Joint::of(f).contains(&sphere.joint));
    let (x, y, scale) = view.project(centre);
    let mut columns = [[0.0; 3]; COLUMNS];
    let mut moves = [Vector3::zeros(); OWN];
    let nearer = scale / state.scale;
    columns[0] = [nearer, 0.0, 0.0];
    columns[1] = [0.0, nearer, 0.0];
    columns[SCALE] = view.by_scale(&centre, sphere.radius);
    for (column, by) in columns[TURN..FREE].iter_mut().zip(jacobian.by_rotation(&centre)) {
        *column = view.by_motion(&centre, sphere.radius, by);
    }
    if let Some(finger) = finger {
        let moved_by = moved_by(sphere.joint);
        let mut add = |k: usize, angle: JointAngle, factor: f64| {
            if moved_by.contains(&angle) && factor != 0.0 {
                let by = factor * jacobian.by_angle(angle, &centre);
                moves[k] += by;
                let by = view.by_motion(&centre, sphere.radius, by);
                for (to, v) in columns[FREE + k].iter_mut().zip(by) {
                    *to += v;
                }
            }
        };
        add(0, finger.base_flexion(), 1.0);
        add(1, finger.abduction(), 1.0);
        if finger == Finger::Thumb {
            add(0, finger.middle_flexion(), thumb_mcp_slope(state.free[finger.free_base()]));
            add(3, finger.middle_flexion(), 1.0);
            add(2, finger.end_flexion(), 1.0);
        } else {
            if let Some(palm) = finger.palm_flexion() {
                add(0, palm, palm_slope(finger, state.free[finger.free_base()]));
            }
            add(2, finger.middle_flexion(), 1.0);
            add(2, finger.end_flexion(), DIP_FROM_PIP);
        }
    }
    let disc = ProjectedDisc { x, y, radius: scale * sphere.radius };
    ProjectedSphere { disc, centre: centre.coords, radius: sphere.radius, finger, columns, moves }
}

/// How the bones of a finger turn: see [`Turns`].
fn bone_turns(finger: Finger, state: &ModelState, jacobian: &Jacobian) -> [[Vector3<f32>; OWN]; BONES] {
    let axis = |angle| jacobian.axis(angle).cast::<f32>();
    let (base, middle, end) =
        (axis(finger.base_flexion()), axis(finger.middle_flexion()), axis(finger.end_flexion()));
    let abduction = axis(finger.abduction());
    let flexion = state.free[finger.free_base()];
    let still = Vector3::zeros();
    if finger == Finger::Thumb {
        let bent = base + middle * thumb_mcp_slope(flexion) as f32;
        [[base, abduction, still, still], [bent, abduction, still, middle], [bent, abduction, end, middle]]
    } else {
        let slope = palm_slope(finger, flexion) as f32;
        let base = finger.palm_flexion().map_or(base, |palm| base + axis(palm) * slope);
        let outer = middle + end * DIP_FROM_PIP as f32;
        [still, middle, outer].map(|bent| [base, abduction, bent, still])
    }
}

impl HandModel {
    /// Adds the two ends of a piece of forearm to the spheres `out` of `state`; `axis` is the unit vector in the image
    /// from the forearm to the hand. See [`handcast_hand::Shape::FOREARM`].
    pub(super) fn add_forearm(&self, state: &ModelState, axis: [f64; 2], out: &mut Vec<ProjectedSphere>) {
        let neck = self.neck_shares();
        let [Some(a), Some(b)] = self.shape().wrist_spheres().map(|i| out.get(i).copied()) else { return };
        for (own, other) in [(a, b), (b, a)] {
            let disc = neck.disc(&own.disc, &other.disc, axis, state.scale);
            let mut columns: [[f64; 3]; COLUMNS] = std::array::from_fn(|c| {
                std::array::from_fn(|k| neck.mix(own.columns[c][k], other.columns[c][k]))
            });
            for (slope, along) in columns[SCALE].iter_mut().zip(axis) {
                *slope -= neck.behind * state.scale * along;
            }
            out.push(ProjectedSphere { disc, columns, ..own });
        }
    }
}

impl View2d {
    /// Change of x, y and radius of a sphere for a change of its centre.
    fn by_motion(&self, centre: &Point3<f64>, radius: f64, by: nalgebra::Vector3<f64>) -> [f64; 3] {
        let near = self.nearer(centre.z);
        // Growth of the scale with nearness; none where the projection is clamped or parallel.
        let growth = self.growth(near) * by.z;
        let [u, v] = self.flat(centre);
        [
            self.scale * by.x * near + (u - self.middle[0]) * growth,
            -self.scale * by.y * near + (v - self.middle[1]) * growth,
            self.scale * radius * growth,
        ]
    }

    /// The same for a change of the logarithm of the scale.
    fn by_scale(&self, centre: &Point3<f64>, radius: f64) -> [f64; 3] {
        let near = self.nearer(centre.z);
        // Depth is focal length over scale: a larger hand is nearer, and its depth tells more.
        let growth = self.growth(near) * centre.z;
        let [u, v] = self.flat(centre);
        [
            self.scale * centre.x * near + (u - self.middle[0]) * growth,
            -self.scale * centre.y * near + (v - self.middle[1]) * growth,
            self.scale * radius * (near + growth),
        ]
    }

    fn growth(&self, near: f64) -> f64 {
        if self.depth.is_infinite() || near >= super::model::NEAREST { 0.0 } else { near * near / self.depth }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PinholeCamera;
    use handcast_hand::{Morphology, Side};
    use nalgebra::UnitQuaternion;

    #[test]
    fn derivatives_equal_central_differences() {
        let camera = PinholeCamera::with_field_of_view(320, 240, 60.0);
        let state = ModelState {
            wrist: [140.0, 190.0],
            scale: 800.0,
            rotation: UnitQuaternion::from_euler_angles(0.2, -0.3, 0.4),
            free: std::array::from_fn(|i| 0.07 * i as f64 - 0.2),
            thumb_mcp: 0.3,
        };
        for (side, camera) in [(Side::Right, Some(camera)), (Side::Left, None)] {
            let mut model = HandModel::new(&Morphology { forearm: 0.8, ..Morphology::default() }, side);
            if let Some(camera) = camera {
                model = model.with_camera(camera);
            }
            let mut spheres = Vec::new();
            model.project_moving(&state, &mut spheres);
            let axis = [0.6, -0.8];
            model.add_forearm(&state, axis, &mut spheres);
            let plain = model.project_with_forearm(&state, Some(axis)).to_vec();
            assert_eq!(spheres.len(), plain.len());
            for (s, p) in spheres.iter().zip(&plain) {
                assert!((s.disc.x - p.x).abs() < 1e-9 && (s.disc.radius - p.radius).abs() < 1e-9);
            }
            let h = 1e-6;
            for parameter in 0..PARAMETERS {
                let mut step = [0.0; PARAMETERS];
                step[parameter] = h;
                let plus = model.project_with_forearm(&state.stepped(&step), Some(axis)).to_vec();
                step[parameter] = -h;
                let minus = model.project_with_forearm(&state.stepped(&step), Some(axis)).to_vec();
                for (i, s) in spheres.iter().enumerate() {
                    let column = (0..COLUMNS)
                        .filter(|&c| c < FREE || s.finger.is_some())
                        .find(|&c| s.finger.map_or(c, |f| super::parameter(f, c)) == parameter)
                        .map_or([0.0; 3], |c| s.columns[c]);
                    let slope = |a: f64, b: f64| (a - b) / (2.0 * h);
                    let expected = [
                        slope(plus[i].x, minus[i].x),
                        slope(plus[i].y, minus[i].y),
                        slope(plus[i].radius, minus[i].radius),
                    ];
                    for (a, b) in column.iter().zip(expected) {
                        assert!((a - b).abs() < 1e-4, "parameter {parameter} sphere {i}: {a} {b}");
                    }
                }
            }
        }
    }
}
