//! Synthetic clips of the model with known poses.
//!
//! A scripted motion ([`Motion`]) moves the skinned mesh, a forearm and a camera over a made-up
//! background; noise is added as a sensor would. Everything follows from [`SynthOptions`] and its seed:
//! the same options make the same bytes. The true pose and the true silhouettes of every frame are known.

mod motion;
mod random;
mod scene;
mod signing;

pub use motion::Motion;
pub use scene::SynthFrame;
pub use signing::sign_dense;

use nalgebra::UnitQuaternion;
use thiserror::Error;

use crate::hand::{Domain, HandMesh, HandPose, Morphology, Side, Skeleton};
use crate::render::Camera;
use crate::track::View;

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
    pub motion: Motion,
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
    /// Standard deviation of the sensor noise, 8-bit levels.
    pub noise: f32,
    /// Seed of everything made up: background, colours of things, noise.
    pub seed: u64,
}

impl Default for SynthOptions {
    fn default() -> Self {
        Self {
            motion: Motion::Demo,
            frames: 150,
            rate: 25.0,
            size: (480, 360),
            field_of_view: 60.0,
            distance: 0.42,
            side: Side::Right,
            view: View::Palm,
            turn: 0.0,
            morphology: Morphology::default(),
            skin: [222, 170, 142],
            background: Background::Clutter,
            forearm: true,
            noise: 1.5,
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
    Morphology(#[from] crate::hand::MorphologyError),
}

/// A clip in the making: poses and frames on demand, in any order.
pub struct Synth {
    options: SynthOptions,
    camera: Camera,
    mesh: HandMesh,
    skeleton: Skeleton,
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
        check("turn (radians)", options.turn, -10.0, 10.0)?;
        check("noise", options.noise.into(), 0.0, 100.0)?;
        options.morphology.validate()?;
        let half = 0.5 * f64::from(options.size.0.max(options.size.1));
        let focal = half / (0.5 * options.field_of_view.to_radians()).tan();
        Ok(Self {
            camera: Camera::pinhole(options.size, focal),
            mesh: HandMesh::generate(&options.morphology, options.side),
            skeleton: Skeleton::new(&options.morphology, options.side),
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
        let state = o.motion.at(share);
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
        let translation = nalgebra::Vector3::new(x, y, z) * o.morphology.hand_length - middle
            + nalgebra::Vector3::new(0.0, 0.0, -o.distance);
        HandPose { side: o.side, translation, rotation, angles: Domain::expand(&state.free) }
    }

    /// Renders a frame.
    pub fn render(&self, frame: usize) -> SynthFrame {
        scene::render(self, frame)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::SkinnedSurface;
    use crate::render::{Projection, Raster, hand_surface};
    use crate::track::{HandModel, ModelState};
    use crate::vision::Mask;

    fn small(motion: Motion) -> SynthOptions {
        SynthOptions { motion, frames: 60, size: (160, 120), ..SynthOptions::default() }
    }

    #[test]
    fn every_motion_stays_inside_the_constraints_and_is_smooth() {
        for (name, motion) in Motion::ALL {
            let synth = Synth::new(small(motion)).unwrap();
            let mut last: Option<HandPose> = None;
            for i in 0..synth.frames() {
                let pose = synth.pose(i);
                assert!(Domain::full().is_feasible(&pose.angles, 1e-9), "{name} frame {i}");
                if let Some(last) = last {
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
            let options = SynthOptions { seed, ..small(Motion::Demo) };
            Synth::new(options).unwrap().render(7).image.into_raw()
        };
        assert_eq!(picture(3), picture(3));
        assert_ne!(picture(3), picture(4));
    }

    #[test]
    fn silhouettes_hold_the_hand_and_leave_the_arm() {
        for view in [View::Palm, View::Back] {
            for side in [Side::Right, Side::Left] {
                let synth = Synth::new(SynthOptions { view, side, ..small(Motion::Demo) }).unwrap();
                let frame = synth.render(0);
                let joints = synth.skeleton.frames(&frame.pose);
                for joint in crate::hand::Joint::ALL {
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
        let state = ModelState { wrist, scale, rotation: UnitQuaternion::identity(), free: *free };
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
            for (motion, share) in [(Motion::Still, 0.0), (Motion::FlexMiddle, 0.5), (Motion::Fist, 0.45)] {
                let (smooth, simple) = both_silhouettes(morphology, &motion.at(share).free);
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
    fn wrong_options_are_named() {
        let message = |o| Synth::new(o).err().unwrap().to_string();
        let d = SynthOptions::default;
        assert!(message(SynthOptions { frames: 0, ..d() }).contains("number of frames is 0"));
        assert!(message(SynthOptions { rate: f64::NAN, ..d() }).contains("frame rate"));
        assert!(message(SynthOptions { size: (8, 100), ..d() }).contains("width is 8"));
    }
}
