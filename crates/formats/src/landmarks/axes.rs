//! Which way the axes of joint positions point, and the camera that saw the joints.

use nalgebra::{Point2, Point3};

use super::{LandmarkClip, PicturePoints, PictureUnit};
use handcast_hand::landmarks::JointPoints;

/// Which way x, y and z point, seen by the camera or the viewer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Axes {
    /// x right, y up, z towards the viewer: WebXR, OpenXR, glTF, and this program's own.
    #[default]
    Webxr,
    /// x right, y down, z away: MediaPipe, OpenCV.
    Mediapipe,
    /// x right, y up, z away, left-handed: Unity.
    Unity,
    /// x right, y away, z up: Blender, ROS's world.
    ZUp,
}

/// What told the axes of a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum AxesSource {
    /// Files of this format have them so.
    #[default]
    Format,
    /// The file says so.
    File,
    /// Where the file's joints lie in its pictures.
    Pictures,
    /// Who asked.
    Asked,
}

impl AxesSource {
    /// In words, behind the name of the axes.
    pub fn words(self) -> &'static str {
        match self {
            Self::Format => "as files of this format have them",
            Self::File => "as the file says",
            Self::Pictures => "as its joints lie in the pictures",
            Self::Asked => "as asked",
        }
    }
}

impl Axes {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Webxr, Self::Mediapipe, Self::Unity, Self::ZUp];

    /// Short name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Webxr => "webxr",
            Self::Mediapipe => "mediapipe",
            Self::Unity => "unity",
            Self::ZUp => "z-up",
        }
    }

    /// The axes of this short name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|axes| axes.name() == name)
    }

    /// A point in the axes of WebXR.
    pub fn to_webxr(self, p: Point3<f64>) -> Point3<f64> {
        match self {
            Self::Webxr => p,
            Self::Mediapipe => Point3::new(p.x, -p.y, -p.z),
            Self::Unity => Point3::new(p.x, p.y, -p.z),
            Self::ZUp => Point3::new(p.x, p.z, -p.y),
        }
    }
}

/// Correlation of heights in space and in the picture that tells which way y points.
const SURE: f64 = 0.8;

/// The axes of points that stand beside their places in pictures, where x goes right and y goes down: those of MediaPipe
/// where y goes down in space, too, and x right. `None` where the pictures do not tell.
pub(super) fn of_pictures(clip: &LandmarkClip) -> Option<Axes> {
    let correlation = |axis: usize| {
        let (mut both, mut ours, mut theirs) = (0.0, 0.0, 0.0);
        for frame in &clip.frames {
            let Some(image) = &frame.image else { continue };
            let pairs = frame.points.iter().zip(image).filter_map(|(a, b)| Some(((*a)?[axis], (*b)?[axis])));
            let pairs: Vec<(f64, f64)> = pairs.collect();
            let n = pairs.len().max(1) as f64;
            let (a0, b0) = pairs.iter().fold((0.0, 0.0), |s, p| (s.0 + p.0 / n, s.1 + p.1 / n));
            // Every frame counts alike, however large the hand is in its picture.
            let spread = pairs.iter().map(|p| (p.1 - b0).powi(2)).sum::<f64>().sqrt().max(1e-12);
            for (a, b) in pairs {
                both += (a - a0) * (b - b0) / spread;
                ours += (a - a0).powi(2);
                theirs += ((b - b0) / spread).powi(2);
            }
        }
        both / (ours * theirs).sqrt()
    };
    (correlation(0) > SURE && correlation(1) > SURE).then_some(Axes::Mediapipe)
}

/// A pinhole camera at the origin that looks along −z, with square pixels and the optical axis through the middle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Width and height of its pictures, pixels.
    size: [f64; 2],
    /// Focal length, pixels.
    focal: f64,
}

impl Camera {
    /// A camera with pictures of this size (pixels) that sees so many radians across their longer side.
    pub fn new(size: [f64; 2], field_of_view: f64) -> Self {
        let half = 0.5 * size[0].max(size[1]);
        Self { size, focal: half / (0.5 * field_of_view).tan() }
    }

    /// A point of the line on which this place in the picture (pixels, y down) lies, a metre deep.
    pub fn ray(&self, at: Point2<f64>) -> Point3<f64> {
        let [w, h] = self.size;
        Point3::new((at.x - 0.5 * w) / self.focal, (0.5 * h - at.y) / self.focal, -1.0)
    }

    /// Where a point before the camera is in the picture, pixels, y down.
    pub fn seen(&self, p: Point3<f64>) -> Point2<f64> {
        let [w, h] = self.size;
        Point2::new(0.5 * w - self.focal * p.x / p.z, 0.5 * h + self.focal * p.y / p.z)
    }

    /// Focal length, pixels.
    pub fn focal(&self) -> f64 {
        self.focal
    }
}

impl PicturePoints {
    /// The points in pixels, depths too; `None` of shares of a picture whose size is not known.
    pub fn pixels(&self, size: Option<[f64; 2]>) -> Option<JointPoints> {
        let [w, h] = match self.unit {
            PictureUnit::Pixels => [1.0, 1.0],
            PictureUnit::Shares => size?,
        };
        Some(self.points.map(|p| p.map(|p| Point3::new(p.x * w, p.y * h, p.z * w))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_are_told_by_name_and_kept_right_handed_or_turned() {
        let p = Point3::new(1.0, 2.0, 3.0);
        for (axes, expected) in [
            (Axes::Webxr, [1.0, 2.0, 3.0]),
            (Axes::Mediapipe, [1.0, -2.0, -3.0]),
            (Axes::Unity, [1.0, 2.0, -3.0]),
            (Axes::ZUp, [1.0, 3.0, -2.0]),
        ] {
            assert_eq!(axes.to_webxr(p), Point3::from(expected));
            assert_eq!(Axes::from_name(axes.name()), Some(axes));
        }
        assert_eq!(Axes::from_name("up"), None);
    }

    #[test]
    fn what_a_camera_sees_lies_on_its_ray() {
        let camera = Camera::new([640.0, 480.0], 60f64.to_radians());
        let p = Point3::new(0.1, -0.05, -0.7);
        let seen = camera.seen(p);
        assert!(seen.x > 320.0 && seen.y > 240.0, "right and below: {seen}");
        assert!((camera.ray(seen) * 0.7 - p).norm() < 1e-12);
        // The longer side is seen under the angle given.
        let edge = camera.ray(Point2::new(640.0, 240.0));
        assert!((edge.x.atan2(-edge.z).to_degrees() - 30.0).abs() < 1e-9);
    }
}
