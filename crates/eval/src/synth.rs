//! Synthetic clips of the model with known poses.
//!
//! A scripted motion ([`ScriptedMotion`]) moves the skinned mesh, a forearm and a camera over a made-up
//! background; noise is added as a sensor would. Everything follows from [`SynthOptions`] and its seed:
//! the same options make the same bytes. The true pose and the true silhouettes of every frame are known:
//! a tracker can be given pictures ([`Synth::render`]), the silhouette of the mesh ([`Synth::silhouette`])
//! or that of the tracker's own primitives ([`Synth::model_silhouette`]), clean or with a rough edge.

mod motion;
mod person;
mod rough;
mod scene;
mod signing;

pub use motion::ScriptedMotion;
pub use person::random_morphology;
pub use scene::SynthFrame;
pub use signing::sign_dense;

use nalgebra::{Point3, UnitQuaternion, Vector3};
use thiserror::Error;

use self::motion::Script;

use handcast_hand::random::Random;
use handcast_hand::shapes::{ShapeError, minimum_jerk};
use handcast_hand::{HandMesh, HandPose, Morphology, Side, Skeleton};
use handcast_render::{Camera, Style};
use handcast_track::{Fit, Forearm, HandModel, ModelState, NonOverlap, PinholeCamera, View, Window};
use handcast_vision::Mask;

/// Most frames of one clip.
pub const MAX_FRAMES: usize = 100_000;
/// Most pixels along one side.
pub const MAX_SIDE: u32 = 4096;

/// What stands behind the hand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Background {
    /// One colour.
    Plain,
    /// A soft gradient.
    Gradient,
    /// A gradient with coloured things in front of it, none of them the colour of skin.
    #[default]
    Clutter,
    /// As `Clutter`, some of the things cream, wood and brick: hard for a colour model.
    SkinLike,
}

impl Background {
    /// Names and values, as on the command line.
    pub const ALL: [(&'static str, Background); 4] = [
        ("plain", Background::Plain),
        ("gradient", Background::Gradient),
        ("clutter", Background::Clutter),
        ("skin-like", Background::SkinLike),
    ];
}

/// What to make.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct SynthOptions {
    /// The scripted motion, stretched over the clip.
    pub motion: ScriptedMotion,
    /// Number of frames, 1 to [`MAX_FRAMES`].
    pub frames: usize,
    /// Frames per second.
    pub rate: f64,
    /// Width and height, pixels, 16 to [`MAX_SIDE`].
    pub size: (u32, u32),
    /// Degrees the camera sees across the longer side.
    pub field_of_view: f64,
    /// Distance of the wrist from the camera, metres.
    pub distance: f64,
    /// Which hand.
    pub side: Side,
    /// Which face of it.
    pub view: View,
    /// How far to the right of the middle the whole motion takes place, metres.
    pub aside: f64,
    /// Whether the hand comes to the middle half way through, for a tenth of the time, and goes back: two that
    /// do so from either side touch.
    pub meets: bool,
    /// Whether the motion runs backwards.
    pub backwards: bool,
    /// In-plane rotation added to the whole motion, radians, counter-clockwise in the image.
    pub turn: f64,
    /// The person's sizes.
    pub morphology: Morphology,
    /// Skin colour, sRGB.
    pub skin: [u8; 3],
    /// What stands behind.
    pub background: Background,
    /// Whether a bare forearm continues the wrist.
    pub forearm: bool,
    /// Where the key light comes from, camera space: right, up, towards the viewer.
    pub light: [f64; 3],
    /// Brightness of all light.
    pub exposure: f32,
    /// Standard deviation of the sensor noise, 8-bit levels.
    pub noise: f32,
    /// Quality of a JPEG compression that the pictures go through, 1 to 100.
    pub compression: Option<u8>,
    /// Roughness of silhouettes that are asked for directly: standard deviation of where their edge lies, pixels.
    pub roughness: f64,
    /// Seed of everything made up: background, colours of things, noise, the letters of a motion.
    pub seed: u64,
}

impl Default for SynthOptions {
    fn default() -> Self {
        Self {
            motion: ScriptedMotion::Demo,
            frames: 150,
            rate: 25.0,
            size: (480, 360),
            field_of_view: 60.0,
            distance: 0.42,
            side: Side::Right,
            view: View::Palm,
            aside: 0.0,
            meets: false,
            backwards: false,
            turn: 0.0,
            morphology: Morphology::default(),
            skin: [222, 170, 142],
            background: Background::Clutter,
            forearm: true,
            light: Style::default().light.into(),
            exposure: 1.0,
            noise: 1.5,
            compression: None,
            roughness: 0.0,
            seed: 1,
        }
    }
}

/// Why a clip cannot be made.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SynthError {
    /// A number is out of range.
    #[error("synth: {what} is {value}, allowed {min} to {max}")]
    Range {
        /// Which number.
        what: &'static str,
        /// Its value.
        value: f64,
        /// Smallest allowed.
        min: f64,
        /// Largest allowed.
        max: f64,
    },
    /// The person's sizes are out of range.
    #[error("synth: {0}")]
    Morphology(#[from] handcast_hand::MorphologyError),
    /// The hand shapes of the letters cannot be read.
    #[error("synth: {0}")]
    Shapes(#[from] ShapeError),
}

/// A clip in the making: poses and frames on demand, in any order.
pub struct Synth {
    options: SynthOptions,
    camera: Camera,
    mesh: HandMesh,
    skeleton: Skeleton,
    script: Script,
    background: Vec<[f32; 3]>,
}

impl Synth {
    /// Checks the options, makes mesh and background.
    ///
    /// # Errors
    /// [`SynthError`] when a number is out of range.
    pub fn new(options: SynthOptions) -> Result<Self, SynthError> {
        let check = |what, value: f64, min: f64, max: f64| {
            let fine = (min..=max).contains(&value);
            if fine { Ok(()) } else { Err(SynthError::Range { what, value, min, max }) }
        };
        check("number of frames", options.frames as f64, 1.0, MAX_FRAMES as f64)?;
        check("frame rate", options.rate, 0.01, 1000.0)?;
        check("width", options.size.0.into(), 16.0, MAX_SIDE.into())?;
        check("height", options.size.1.into(), 16.0, MAX_SIDE.into())?;
        check("field of view (degrees)", options.field_of_view, 5.0, 150.0)?;
        check("distance (m)", options.distance, 0.2, 10.0)?;
        check("distance from the middle (m)", options.aside, -5.0, 5.0)?;
        check("turn (degrees)", options.turn.to_degrees(), -720.0, 720.0)?;
        check("exposure", options.exposure.into(), 0.0, 10.0)?;
        for v in options.light {
            check("direction of the light", v, -1e3, 1e3)?;
        }
        check("length of the light's direction", Vector3::from(options.light).norm(), 1e-3, 2e3)?;
        check("noise", options.noise.into(), 0.0, 100.0)?;
        check("quality of the compression", options.compression.unwrap_or(1).into(), 1.0, 100.0)?;
        check("roughness", options.roughness, 0.0, 20.0)?;
        options.morphology.validate()?;
        let focal =
            PinholeCamera::with_field_of_view(options.size.0, options.size.1, options.field_of_view).focal;
        Ok(Self {
            camera: Camera::pinhole(options.size, focal),
            mesh: HandMesh::generate(&options.morphology, options.side),
            skeleton: Skeleton::new(&options.morphology, options.side),
            script: options.motion.script(options.seed)?,
            background: scene::background(&options),
            options,
        })
    }

    /// The options.
    pub fn options(&self) -> &SynthOptions {
        &self.options
    }

    /// The camera: at the origin, looking along −Z.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.options.frames
    }

    /// Time of a frame, seconds.
    pub fn time(&self, frame: usize) -> f64 {
        frame as f64 / self.options.rate
    }

    /// The true pose of a frame.
    pub fn pose(&self, frame: usize) -> HandPose {
        let o = &self.options;
        let share = frame as f64 / o.frames.saturating_sub(1).max(1) as f64;
        let state = self.script.at(if o.backwards { 1.0 - share } else { share });
        let axis = |v, a| UnitQuaternion::from_axis_angle(&v, a);
        let facing = match o.view {
            View::Palm => UnitQuaternion::identity(),
            View::Back => axis(nalgebra::Vector3::y_axis(), std::f64::consts::PI),
        };
        let [roll, tilt, swivel] = state.turn;
        let rotation = axis(nalgebra::Vector3::z_axis(), roll + o.turn)
            * axis(nalgebra::Vector3::x_axis(), tilt)
            * axis(nalgebra::Vector3::y_axis(), swivel)
            * facing;
        // The middle of the hand, not the wrist, is held in the middle of the picture.
        let middle = axis(nalgebra::Vector3::z_axis(), roll + o.turn)
            * nalgebra::Vector3::new(0.0, 0.45 * o.morphology.hand_length, 0.0);
        let [x, y, z] = state.shift;
        let distance = o.distance / state.zoom;
        // Half of what the camera sees at that distance, and half of a hand whichever way it is turned.
        let half_view = 0.5 * f64::from(o.size.0) * distance / self.track_camera().focal;
        let out = Vector3::new(state.out * (half_view + 0.75 * o.morphology.hand_length), 0.0, 0.0);
        let aside = if o.meets { o.aside * (1.0 - meeting(share)) } else { o.aside };
        let translation =
            Vector3::new(x, y, z) * o.morphology.hand_length + out + Vector3::new(aside, 0.0, 0.0)
                - middle
                - Vector3::new(0.0, 0.0, distance);
        HandPose { side: o.side, translation, rotation, angles: state.angles() }
    }

    /// The camera as the tracker knows it.
    pub fn track_camera(&self) -> PinholeCamera {
        let o = &self.options;
        PinholeCamera::with_field_of_view(o.size.0, o.size.1, o.field_of_view)
    }

    /// The true state of a frame in the tracker's terms; angles that the tracker does not know are dropped.
    pub fn state(&self, frame: usize) -> ModelState {
        ModelState::from_pose(&self.pose(frame), &self.track_camera())
    }

    /// The silhouette of the hand from the wrist on, as [`SynthFrame::hand`], with a rough edge when the
    /// options ask for one.
    pub fn silhouette(&self, frame: usize) -> Mask {
        let clean = scene::silhouette(self, frame);
        self.roughened(clean, frame)
    }

    /// The silhouette that the tracker's own primitives make in the true state, seen with the same
    /// perspective, with a rough edge when the options ask for one.
    pub fn model_silhouette(&self, frame: usize) -> Mask {
        let o = &self.options;
        let mut mask = Mask::new(o.size.0, o.size.1);
        let mut model = HandModel::new(&o.morphology, o.side).with_camera(self.track_camera());
        model.draw(&self.state(frame), [0.0, 0.0], &mut mask);
        self.roughened(mask, frame)
    }

    /// The truth of the first frame as a fit, judged on a silhouette of it: for trackers that are to be
    /// measured apart from the fit.
    pub fn true_fit(&self, first: &Mask, forearm: Option<Forearm>) -> Fit {
        let (morphology, side, state) = (self.options.morphology.clone(), self.options.side, self.state(0));
        let iou = Window::around(first, forearm, 0.35).map_or(0.0, |window| {
            let mut model = HandModel::new(&morphology, side).with_camera(self.track_camera());
            let mut overlap = NonOverlap::default();
            overlap.rate(&mut model, &state, &window);
            overlap.last_iou(&window)
        });
        Fit { morphology, side, state, forearm, iou, evaluations: 0 }
    }

    /// A silhouette of a frame with the rough edge that the options ask for.
    pub fn roughened(&self, mask: Mask, frame: usize) -> Mask {
        let o = &self.options;
        rough::roughened(mask, o.roughness, &mut Random::new(o.seed, 0x5_0000_0000 + frame as u64))
    }

    /// Where [`Synth::silhouette`] is cut from the forearm; `None` when that line cannot be seen.
    pub fn forearm(&self, frame: usize) -> Option<Forearm> {
        let pose = self.pose(frame);
        let at = |y: f64| self.camera.project(&(pose.isometry() * Point3::new(0.0, y, 0.0)));
        let below = -scene::WRIST * self.options.morphology.palm_radius;
        let (cut, hand) = (at(below)?, at(below + 0.1 * self.options.morphology.hand_length)?);
        let axis = [hand[0] - cut[0], hand[1] - cut[1]];
        let length = axis[0].hypot(axis[1]);
        (length > 1.0).then(|| Forearm { cut, axis: axis.map(|v| v / length) })
    }

    /// Renders a frame.
    pub fn render(&self, frame: usize) -> SynthFrame {
        scene::render(self, frame)
    }

    /// The person's other hand: on the other side of the middle, moving backwards in time, in front of the
    /// same background.
    ///
    /// # Errors
    /// Those of [`Synth::new`].
    pub fn other_hand(&self) -> Result<Self, SynthError> {
        let o = self.options.clone();
        let (side, aside, backwards) = (o.side.other(), -o.aside, !o.backwards);
        Self::new(SynthOptions { side, aside, backwards, ..o })
    }

    /// Renders a frame with two hands, `other` in front of this one; both frames have the whole picture, each
    /// its own pose and masks of what is seen of it.
    pub fn render_with(&self, other: &Self, frame: usize) -> [SynthFrame; 2] {
        scene::render_pair(self, other, frame)
    }
}

/// How far on its way to the middle a hand is that comes there and goes back: 0 to 1.
fn meeting(share: f64) -> f64 {
    let ramp = |from: f64, to: f64| minimum_jerk(((share - from) / (to - from)).clamp(0.0, 1.0));
    ramp(0.35, 0.45) - ramp(0.55, 0.65)
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::Domain;
    use handcast_hand::SkinnedSurface;
    use handcast_render::{Projection, Raster, hand_surface};

    fn small(motion: ScriptedMotion) -> SynthOptions {
        SynthOptions { motion, frames: 60, size: (160, 120), ..SynthOptions::default() }
    }

    #[test]
    fn every_motion_stays_inside_the_constraints_and_is_smooth() {
        for (name, motion) in ScriptedMotion::ALL {
            let synth = Synth::new(small(motion)).unwrap();
            let mut last: Option<HandPose> = None;
            for i in 0..synth.frames() {
                let pose = synth.pose(i);
                let domain = Domain::full();
                let exceeded: Vec<_> = domain.exceeded(&pose.angles, 1e-9).collect();
                assert!(exceeded.is_empty(), "{name} frame {i}: {exceeded:?}");
                // A hand that is out of sight may be put elsewhere.
                if let Some(last) = last.filter(|_| !synth.silhouette(i).is_empty()) {
                    let step = last.angles.iter().zip(&pose.angles).map(|(a, b)| (a - b).abs());
                    assert!(step.fold(0.0, f64::max) < 0.9, "{name} frame {i}");
                    assert!((last.translation - pose.translation).norm() < 0.05);
                }
                last = Some(pose);
            }
        }
    }

    #[test]
    fn same_options_same_picture_and_seeds_differ() {
        let picture = |seed| {
            let options = SynthOptions { seed, ..small(ScriptedMotion::Demo) };
            Synth::new(options).unwrap().render(7).image.into_raw()
        };
        assert_eq!(picture(3), picture(3));
        assert_ne!(picture(3), picture(4));
    }

    #[test]
    fn silhouettes_hold_the_hand_and_leave_the_arm() {
        for view in [View::Palm, View::Back] {
            for side in [Side::Right, Side::Left] {
                let synth = Synth::new(SynthOptions { view, side, ..small(ScriptedMotion::Demo) }).unwrap();
                let frame = synth.render(0);
                let joints = synth.skeleton.frames(&frame.pose);
                for joint in handcast_hand::Joint::ALL {
                    let tip = joint.webxr_name().ends_with("tip");
                    let [x, y] = synth.camera().project(&joints.position(joint)).unwrap();
                    assert!(tip || frame.hand.get(x as u32, y as u32), "{}", joint.webxr_name());
                }
                assert_eq!(frame.hand.overlap(&frame.skin), frame.hand.area(), "the hand is skin");
                assert!(frame.skin.area() > frame.hand.area() + 50, "the arm is skin, not hand");
                let bounds = frame.skin.bounds().unwrap();
                assert_eq!(bounds.y1, 120, "the arm leaves the picture at the bottom");
            }
        }
    }

    /// Orthographic silhouettes of mesh (from the wrist on) and primitive model.
    fn both_silhouettes(morphology: &Morphology, free: &[f64; 15]) -> (Mask, Mask) {
        let size = (260, 300);
        let scale = 1200.0 * 0.189 / morphology.hand_length;
        let wrist = [130.0, 270.0];
        let mut pose = HandPose::neutral(Side::Right);
        pose.angles = Domain::expand(free);
        let mesh = HandMesh::generate(morphology, Side::Right);
        let mut skinned = SkinnedSurface::default();
        mesh.skin(&Skeleton::new(morphology, Side::Right).frames(&pose), &mut skinned);
        let surface = hand_surface(&mesh, &skinned);
        let camera = Camera {
            view: nalgebra::Isometry3::identity(),
            projection: Projection::Orthographic { scale },
            centre: wrist,
        };
        let mut raster = Raster::new(size.0, size.1, 2);
        raster.draw(&surface, &camera);
        let cut = (-0.4 * morphology.palm_radius) as f32;
        let coverage = raster.coverage_where(1, &[surface], |p| p[1] >= cut);
        let smooth = Mask::from_fn(size.0, size.1, |x, y| coverage[(y * size.0 + x) as usize] >= 128);
        let mut simple = Mask::new(size.0, size.1);
        let state = ModelState { free: *free, ..ModelState::facing(wrist, scale) };
        HandModel::new(morphology, Side::Right).draw(&state, [0.0, 0.0], &mut simple);
        (smooth, simple)
    }

    #[test]
    fn mesh_and_primitives_have_nearly_the_same_silhouette() {
        let mut slim = Morphology::average(0.17);
        for f in &mut slim.fingers {
            f.radii = f.radii.map(|r| 0.88 * r);
        }
        slim.webs = [0.7, 0.45, 0.42, 0.4];
        for (i, morphology) in [Morphology::default(), slim].iter().enumerate() {
            for (motion, share) in [
                (ScriptedMotion::Still, 0.0),
                (ScriptedMotion::FlexMiddle, 0.5),
                (ScriptedMotion::Fist, 0.45),
            ] {
                let (smooth, simple) =
                    both_silhouettes(morphology, &motion.script(1).unwrap().at(share).free);
                let iou = smooth.iou(&simple);
                println!("{} {i}: {iou:.3}", motion.name());
                if let Some(folder) = std::env::var_os("HANDCAST_TEST_PICTURES") {
                    let name = format!("silhouettes-{}-{i}.png", motion.name());
                    let picture = image::RgbImage::from_fn(260, 300, |x, y| {
                        image::Rgb([smooth.get(x, y), simple.get(x, y), false].map(|v| 255 * u8::from(v)))
                    });
                    picture.save(std::path::Path::new(&folder).join(name)).unwrap();
                }
                assert!(iou > 0.9, "{} {i}: {iou}", motion.name());
            }
        }
    }

    #[test]
    fn two_hands_are_apart_and_meet() {
        let options = SynthOptions { aside: -0.12, meets: true, ..small(ScriptedMotion::Still) };
        let right = Synth::new(options).unwrap();
        let left = right.other_hand().unwrap();
        let [a, b] = right.render_with(&left, 0);
        assert_eq!((a.pose.side, b.pose.side), (Side::Right, Side::Left));
        assert_eq!(a.image, b.image);
        assert_eq!(a.skin.overlap(&b.skin), 0);
        let middle = |frame: &SynthFrame| frame.hand.centroid().unwrap()[0];
        assert!(middle(&a) < 60.0 && middle(&b) > 100.0);
        assert!((middle(&a) - (160.0 - middle(&b))).abs() < 1.0, "mirror images");
        let (a, b) = (right.pose(30).translation.x, left.pose(30).translation.x);
        assert!(a.abs() < 0.01 && b.abs() < 0.01, "{a} {b}");
    }

    #[test]
    fn silhouettes_had_directly_are_those_of_the_picture() {
        let synth = Synth::new(small(ScriptedMotion::Demo)).unwrap();
        let frame = synth.render(20);
        assert_eq!(synth.silhouette(20), frame.hand);
        assert!(synth.model_silhouette(20).iou(&frame.hand) > 0.85);
        // The cut passes through the lower end of the silhouette.
        let forearm = synth.forearm(20).unwrap();
        let behind = frame.hand.pixels().filter(|&(x, y)| {
            let d = [f64::from(x) + 0.5 - forearm.cut[0], f64::from(y) + 0.5 - forearm.cut[1]];
            d[0] * forearm.axis[0] + d[1] * forearm.axis[1] < -1.5
        });
        assert_eq!(behind.count(), 0);
    }

    #[test]
    fn rough_silhouettes_are_seeded_and_keep_their_area() {
        let rough = |seed, roughness| {
            let options = SynthOptions { seed, roughness, size: (480, 360), ..small(ScriptedMotion::Fist) };
            Synth::new(options).unwrap().model_silhouette(9)
        };
        let clean = rough(1, 0.0);
        assert_eq!(rough(1, 1.5), rough(1, 1.5));
        assert_ne!(rough(1, 1.5), rough(2, 1.5));
        assert!((0.85..0.99).contains(&rough(1, 1.5).iou(&clean)));
        assert!(rough(1, 3.0).iou(&clean) < rough(1, 1.0).iou(&clean));
        let share = f64::from(rough(1, 1.5).area()) / f64::from(clean.area());
        assert!((share - 1.0).abs() < 0.06, "{share}");
    }

    #[test]
    fn motions_reach_what_they_promise() {
        let extremes = |motion, measure: &dyn Fn(&Synth, usize) -> f64| {
            let synth = Synth::new(SynthOptions { frames: 201, ..small(motion) }).unwrap();
            let all: Vec<f64> = (0..201).map(|i| measure(&synth, i)).collect();
            (all.iter().copied().fold(f64::MAX, f64::min), all.iter().copied().fold(f64::MIN, f64::max))
        };
        let roll = |s: &Synth, i: usize| s.pose(i).rotation.scaled_axis().z.to_degrees();
        let (low, high) = extremes(ScriptedMotion::Rotate, &roll);
        assert!((low + 60.0).abs() < 0.5 && (high - 60.0).abs() < 0.5, "{low} {high}");
        let tilt = |s: &Synth, i: usize| s.pose(i).rotation.scaled_axis().x.to_degrees();
        let (low, high) = extremes(ScriptedMotion::Tilt, &tilt);
        assert!((low + 30.0).abs() < 0.5 && (high - 30.0).abs() < 0.5, "{low} {high}");
        let (low, high) = extremes(ScriptedMotion::Zoom, &|s, i| s.state(i).scale / s.state(0).scale);
        assert!((low - 0.6).abs() < 0.01 && (high - 1.4).abs() < 0.01, "{low} {high}");
        let (low, high) = extremes(ScriptedMotion::Leave, &|s, i| f64::from(s.silhouette(i).area()));
        assert!(low == 0.0 && high > 1000.0, "{low} {high}");
    }

    #[test]
    fn compression_changes_the_picture_only() {
        let frame = |compression| {
            Synth::new(SynthOptions { compression, ..small(ScriptedMotion::Still) }).unwrap().render(0)
        };
        let (plain, hard) = (frame(None), frame(Some(20)));
        assert_eq!(plain.hand, hard.hand);
        let apart =
            plain.image.iter().zip(hard.image.iter()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum::<u64>();
        assert!(apart > 10_000, "{apart}");
    }

    #[test]
    fn wrong_options_are_named() {
        let message = |o| Synth::new(o).err().unwrap().to_string();
        let d = SynthOptions::default;
        assert!(message(SynthOptions { frames: 0, ..d() }).contains("number of frames is 0"));
        assert!(message(SynthOptions { rate: f64::NAN, ..d() }).contains("frame rate"));
        assert!(message(SynthOptions { size: (8, 100), ..d() }).contains("width is 8"));
    }
}
