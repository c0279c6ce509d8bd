//! The hand model as the tracker sees it: the projection of a state, and its silhouette.

use nalgebra::{Point3, Rotation3};

use super::camera::PinholeCamera;
use super::forearm::Forearm;
use super::raster::{ProjectedDisc, Rasterizer};
use super::state::ModelState;
use handcast_hand::{Finger, Joint, Morphology, Primitive, Shape, Side, Skeleton, palm_from_mcp};
use handcast_vision::Mask;

/// How much forearm is drawn behind the wrist, metres: more than is ever left on the hand's side of a cut.
const FOREARM_LENGTH: f64 = 0.12;
/// Least half breadth of wrist and forearm beside the rounding of their borders, hand lengths.
const NARROWEST: f64 = 1e-3;
/// Where the forearm is as broad as [`Morphology::forearm`] says, hand lengths behind the wrist.
const NECK: f64 = 0.1;

/// Skeleton and shape of one hand, with the buffers to project and rasterise it.
#[derive(Clone, Debug)]
pub struct HandModel {
    morphology: Morphology,
    skeleton: Skeleton,
    shape: Shape,
    /// For each primitive.
    fingers: Vec<Fingers>,
    /// The camera, for perspective within the hand; without, its depth is taken as constant.
    camera: Option<PinholeCamera>,
    /// Scale of the last projection, pixels per metre.
    scale: f64,
    discs: Vec<ProjectedDisc>,
    rasterizer: Rasterizer,
}

impl HandModel {
    /// The primitive model of a hand of these sizes.
    pub fn new(morphology: &Morphology, side: Side) -> Self {
        let shape = Shape::primitives_of(morphology, side);
        Self {
            morphology: morphology.clone(),
            skeleton: Skeleton::new(morphology, side),
            fingers: shape.primitives().iter().map(|p| Fingers::of(p, &shape)).collect(),
            shape,
            camera: None,
            scale: 0.0,
            discs: Vec::new(),
            rasterizer: Rasterizer::new(),
        }
    }

    /// Projects with the perspective of `camera`: parts of the hand nearer to it appear larger.
    #[must_use]
    pub fn with_camera(mut self, camera: PinholeCamera) -> Self {
        self.camera = Some(camera);
        self
    }

    /// Replaces the camera.
    pub fn set_camera(&mut self, camera: PinholeCamera) {
        self.camera = Some(camera);
    }

    /// Replaces the sizes, keeping the buffers.
    pub fn set_morphology(&mut self, morphology: &Morphology) {
        let side = self.side();
        self.morphology.clone_from(morphology);
        self.skeleton = Skeleton::new(morphology, side);
        self.shape.resize(morphology, side);
    }

    /// The sizes.
    pub fn morphology(&self) -> &Morphology {
        &self.morphology
    }

    /// Left or right.
    pub fn side(&self) -> Side {
        self.skeleton.side()
    }

    /// The skeleton.
    pub fn skeleton(&self) -> &Skeleton {
        &self.skeleton
    }

    /// The shape.
    pub(super) fn shape(&self) -> &Shape {
        &self.shape
    }

    /// The camera, with perspective.
    pub(super) fn camera(&self) -> Option<&PinholeCamera> {
        self.camera.as_ref()
    }

    /// The projected spheres of the shape, in the order of [`Shape::spheres`], pixels.
    pub fn project(&mut self, state: &ModelState) -> &[ProjectedDisc] {
        let frames = self.skeleton.local_frames(&state.angles());
        let rotation: Rotation3<f64> = state.rotation.to_rotation_matrix();
        let view = View2d::new(self.camera.as_ref(), state);
        self.scale = state.scale;
        self.discs.clear();
        self.discs.extend(self.shape.placed(&frames).map(|(centre, radius)| {
            let (x, y, scale) = view.project(rotation * centre);
            ProjectedDisc { x, y, radius: scale * radius }
        }));
        &self.discs
    }

    /// Draws the silhouette of the model into `mask` (added to what is there). `origin` is the image
    /// position of the mask's corner, so that a mask may cover a part of the image only.
    pub fn draw(&mut self, state: &ModelState, origin: [f64; 2], mask: &mut Mask) {
        self.project(state);
        self.draw_primitives(|_, _| true, origin, mask);
    }

    /// Draws the part of the silhouette that the angles of `finger` move (`moving`), or all the rest.
    pub fn draw_finger(
        &mut self,
        state: &ModelState,
        finger: Finger,
        moving: bool,
        origin: [f64; 2],
        mask: &mut Mask,
    ) {
        self.project(state);
        self.draw_primitives(|_, fingers| has(fingers.moving, finger) == moving, origin, mask);
    }

    /// Draws the silhouette without `finger`; the palm, which a finger may move, stays.
    pub fn draw_without(&mut self, state: &ModelState, finger: Finger, origin: [f64; 2], mask: &mut Mask) {
        self.project(state);
        self.draw_primitives(|_, fingers| !has(fingers.owning, finger), origin, mask);
    }

    /// Draws a piece of forearm behind the wrist as last projected: 0.12 m of it, or only to the neck where the rest would
    /// be behind the cut. `origin` as in [`HandModel::draw`].
    pub fn draw_forearm(&mut self, forearm: &Forearm, origin: [f64; 2], mask: &mut Mask) {
        let axis = forearm.axis;
        let neck = self.neck(axis);
        let Self { shape, discs, rasterizer, scale, .. } = self;
        let moved = |d: &ProjectedDisc, back: f64| ProjectedDisc {
            x: d.x - back * axis[0] - origin[0],
            y: d.y - back * axis[1] - origin[1],
            radius: d.radius,
        };
        let wrist = shape.wrist_spheres().into_iter().filter_map(|i| discs.get(i));
        rasterizer.fill_hull(mask, wrist.chain(neck.iter().flatten()).map(|d| moved(d, 0.0)));
        if neck.iter().flatten().any(|d| forearm.side([d.x, d.y]) > -d.radius) {
            let ends = [0.0, FOREARM_LENGTH * *scale];
            rasterizer.fill_hull(mask, neck.iter().flatten().flat_map(|d| ends.map(|back| moved(d, back))));
        }
    }

    /// The two ends of a piece of forearm behind the wrist as last projected, radial and ulnar.
    fn neck(&self, axis: [f64; 2]) -> Option<[ProjectedDisc; 2]> {
        let neck = self.neck_shares();
        let [a, b] = self.shape.wrist_spheres().map(|i| self.discs.get(i));
        let (a, b) = (a?, b?);
        Some([(a, b), (b, a)].map(|(own, other)| neck.disc(own, other, axis, self.scale)))
    }

    /// Where the ends of a piece of forearm are.
    pub(super) fn neck_shares(&self) -> Neck {
        let m = &self.morphology;
        let half = |breadth: f64| (breadth - m.palm_radius).max(NARROWEST * m.hand_length);
        let share = half(m.forearm * m.wrist_half_width) / half(m.wrist_half_width);
        Neck { shares: [0.5 * (1.0 + share), 0.5 * (1.0 - share)], behind: NECK * m.hand_length }
    }

    /// As [`HandModel::project`], followed by the two ends of a piece of forearm when its `axis` is given: see
    /// [`Shape::FOREARM`].
    pub(super) fn project_with_forearm(
        &mut self,
        state: &ModelState,
        axis: Option<[f64; 2]>,
    ) -> &[ProjectedDisc] {
        self.project(state);
        let neck = axis.and_then(|axis| self.neck(axis));
        self.discs.extend(neck.into_iter().flatten());
        &self.discs
    }

    /// Draws the model as last projected, and `forearm` if it is given; what has stood where it stands since
    /// [`Standing::begin`] is not drawn again.
    pub(super) fn draw_beside(
        &mut self,
        standing: &mut Standing,
        forearm: Option<&Forearm>,
        origin: [f64; 2],
        mask: &mut Mask,
    ) {
        let piece = forearm.and_then(|forearm| Some((self.neck(forearm.axis)?, self.scale)));
        let lost = standing.compare(self, piece);
        if lost {
            standing.drawn.reset(mask.width(), mask.height());
            self.draw_primitives(|number, _| standing.still[number], origin, &mut standing.drawn);
            if let Some(forearm) = forearm.filter(|_| standing.arm_is_still) {
                self.draw_forearm(forearm, origin, &mut standing.drawn);
            }
        }
        mask.clone_from(&standing.drawn);
        self.draw_primitives(|number, _| !standing.still[number], origin, mask);
        if let Some(forearm) = forearm.filter(|_| !standing.arm_is_still) {
            self.draw_forearm(forearm, origin, mask);
        }
    }

    /// Draws the primitives that are wanted, by their numbers and fingers, as last projected.
    fn draw_primitives(
        &mut self,
        wanted: impl Fn(usize, Fingers) -> bool,
        origin: [f64; 2],
        mask: &mut Mask,
    ) {
        let Self { shape, fingers, discs, rasterizer, .. } = self;
        let primitives = shape.primitives().iter().zip(fingers.iter()).enumerate();
        for (_, (primitive, _)) in primitives.filter(|(number, (_, fingers))| wanted(*number, **fingers)) {
            let hull = primitive
                .spheres
                .iter()
                .filter_map(|&s| discs.get(s as usize))
                .map(|d| ProjectedDisc { x: d.x - origin[0], y: d.y - origin[1], radius: d.radius });
            rasterizer.fill_hull(mask, hull);
        }
    }

    /// Image positions of the joints, pixels, in the order of [`Joint::ALL`].
    pub fn joints(&self, state: &ModelState) -> [[f64; 2]; Joint::COUNT] {
        let frames = self.skeleton.local_frames(&state.angles());
        let view = View2d::new(self.camera.as_ref(), state);
        Joint::ALL.map(|joint| {
            let (x, y, _) = view.project(state.rotation * frames.position(joint));
            [x, y]
        })
    }
}

/// The ends of a piece of forearm, from the two spheres at the wrist.
pub(super) struct Neck {
    /// What each end has of the sphere on its own side, and of the other.
    shares: [f64; 2],
    /// How far behind those it is, metres.
    pub(super) behind: f64,
}

impl Neck {
    /// What an end has of a value of the sphere on its own side and of the other's.
    pub(super) fn mix(&self, own: f64, other: f64) -> f64 {
        self.shares[0] * own + self.shares[1] * other
    }

    /// An end in the image; `axis` is the unit vector from the forearm to the hand, `scale` pixels per metre.
    pub(super) fn disc(
        &self,
        own: &ProjectedDisc,
        other: &ProjectedDisc,
        axis: [f64; 2],
        scale: f64,
    ) -> ProjectedDisc {
        let back = self.behind * scale;
        ProjectedDisc {
            x: self.mix(own.x, other.x) - back * axis[0],
            y: self.mix(own.y, other.y) - back * axis[1],
            radius: self.mix(own.radius, other.radius),
        }
    }
}

/// Most that perspective magnifies a part of the hand: one that reaches the camera is out of focus anyway.
pub(super) const NEAREST: f64 = 5.0;

/// The projection of points given relative to the wrist, metres, in camera axes.
pub(super) struct View2d {
    pub(super) wrist: [f64; 2],
    pub(super) middle: [f64; 2],
    pub(super) scale: f64,
    /// Distance of the wrist from the camera; infinite without perspective.
    pub(super) depth: f64,
}

impl View2d {
    pub(super) fn new(camera: Option<&PinholeCamera>, state: &ModelState) -> Self {
        Self {
            wrist: state.wrist,
            middle: camera.map_or([0.0; 2], |c| [0.5 * f64::from(c.width), 0.5 * f64::from(c.height)]),
            scale: state.scale,
            depth: camera.map_or(f64::INFINITY, |c| c.focal / state.scale),
        }
    }

    /// The image position without perspective.
    pub(super) fn flat(&self, p: &Point3<f64>) -> [f64; 2] {
        [self.wrist[0] + self.scale * p.x, self.wrist[1] - self.scale * p.y]
    }

    /// How much larger than at the wrist things appear at `z`.
    pub(super) fn nearer(&self, z: f64) -> f64 {
        if self.depth.is_infinite() { 1.0 } else { (1.0 - z / self.depth).max(1.0 / NEAREST).recip() }
    }

    /// Image position and the scale there, pixels per metre.
    pub(super) fn project(&self, p: Point3<f64>) -> (f64, f64, f64) {
        let [u, v] = self.flat(&p);
        let nearer = self.nearer(p.z);
        if nearer == 1.0 {
            return (u, v, self.scale);
        }
        let from = |middle: f64, v: f64| middle + (v - middle) * nearer;
        (from(self.middle[0], u), from(self.middle[1], v), self.scale * nearer)
    }
}

/// What of a model has stood where it stands, and is drawn, since a first projection.
#[derive(Clone, Debug, Default)]
pub(super) struct Standing {
    /// Spheres as projected first.
    discs: Vec<ProjectedDisc>,
    /// The ends of the piece of forearm then, and the scale.
    arm: Option<([ProjectedDisc; 2], f64)>,
    /// For each primitive whether it has not moved since.
    still: Vec<bool>,
    arm_is_still: bool,
    /// These primitives, and the piece of forearm if it has not moved.
    drawn: Mask,
}

impl Standing {
    /// What comes next is the first projection.
    pub(super) fn begin(&mut self) {
        self.discs.clear();
    }

    /// Finds what has moved; whether what still stands has to be drawn.
    fn compare(&mut self, model: &HandModel, arm: Option<([ProjectedDisc; 2], f64)>) -> bool {
        if self.discs.is_empty() {
            self.discs.clone_from(&model.discs);
            self.arm = arm;
            self.still.clear();
            self.still.resize(model.shape.primitives().len(), true);
            self.arm_is_still = true;
            return true;
        }
        let stands = |index: usize| self.discs.get(index) == model.discs.get(index);
        let mut lost = false;
        for (still, primitive) in self.still.iter_mut().zip(model.shape.primitives()) {
            let moved = *still && !primitive.spheres.iter().all(|&sphere| stands(sphere.into()));
            *still &= !moved;
            lost |= moved;
        }
        let moved =
            self.arm_is_still && !(self.arm == arm && model.shape.wrist_spheres().into_iter().all(stands));
        self.arm_is_still &= !moved;
        lost | moved
    }
}

/// The fingers of a primitive: bit `Finger as u8`.
#[derive(Clone, Copy, Debug, Default)]
struct Fingers {
    /// Those that have spheres in it beyond their first joint.
    owning: u8,
    /// Those whose angles move it: these, and those whose first joint's sphere is in it and moves as they cup the
    /// palm.
    moving: u8,
}

impl Fingers {
    fn of(primitive: &Primitive, shape: &Shape) -> Self {
        let mut fingers = Self::default();
        for s in primitive.spheres.iter().filter_map(|&i| shape.spheres().get(usize::from(i))) {
            let Some(finger) = Finger::ALL.into_iter().find(|&f| Joint::of(f).contains(&s.joint)) else {
                continue;
            };
            let beyond = s.joint != Joint::base(finger) || s.offset.y > 0.0;
            fingers.owning |= u8::from(beyond) << finger as u8;
            fingers.moving |= u8::from(beyond || palm_from_mcp(finger, 1.0) > 0.0) << finger as u8;
        }
        fingers
    }
}

fn has(fingers: u8, finger: Finger) -> bool {
    fingers >> finger as u8 & 1 == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_open_right_palm_stands_above_its_wrist_with_the_thumb_to_the_right() {
        let morphology = Morphology::default();
        let mut model = HandModel::new(&morphology, Side::Right);
        let state = ModelState::facing([160.0, 220.0], 1000.0);
        let mut mask = Mask::new(320, 240);
        model.draw(&state, [0.0, 0.0], &mut mask);
        let bounds = mask.bounds().unwrap();
        assert!((f64::from(bounds.y0) - (220.0 - 189.0)).abs() <= 1.0, "{bounds:?}");
        let thumb = model.joints(&state)[Joint::ThumbTip.index()];
        assert!(thumb[0] > 220.0 && mask.get(thumb[0] as u32 - 5, thumb[1] as u32 + 5));
        let mut crop = Mask::new(128, 100);
        model.draw(&state, [100.0, 50.0], &mut crop);
        for y in 0..100 {
            for x in 0..128 {
                assert_eq!(crop.get(x, y), mask.get(x + 100, y + 50));
            }
        }
    }
}
