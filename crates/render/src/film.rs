//! Motions as pictures: all moments through one camera, or one that goes round.

use std::convert::Infallible;

use image::{Rgba, RgbaImage};
use nalgebra::{Point3, Vector3};

use super::{Camera, Style, camera_around, contact_sheet, posed, render_hands};
use handcast_hand::{HandFrames, HandMesh};
use handcast_picture::draw_label;
use rayon::prelude::*;

/// One instant of a motion.
#[derive(Clone, Debug)]
pub struct Moment {
    /// Seconds.
    pub time: f64,
    /// Joints of each hand that is seen, in the camera frame of the clip: number of its mesh, and its frames.
    pub hands: Vec<(usize, HandFrames)>,
}

/// A motion seen by one camera that has all of it in view, so that movement shows.
pub struct Film {
    meshes: Vec<HandMesh>,
    moments: Vec<Moment>,
    cameras: Vec<Camera>,
    size: (u32, u32),
}

impl Film {
    /// Prepares pictures of `size` pixels of the hands `meshes`. With `turntable` the camera goes round them
    /// once in the course of the motion.
    pub fn new(meshes: &[HandMesh], moments: Vec<Moment>, size: (u32, u32), turntable: bool) -> Self {
        let mut points = Vec::new();
        // A few dozen moments span the motion well enough; the margin takes the rest.
        for moment in moments.iter().step_by(moments.len().div_ceil(48).max(1)) {
            for (mesh, frames) in moment.hands.iter().filter_map(|(i, f)| Some((meshes.get(*i)?, f))) {
                let surface = posed(mesh, frames);
                let some = surface.positions.iter().step_by(7);
                points.extend(some.map(|p| Point3::from(Vector3::from(*p).cast::<f64>())));
            }
        }
        let camera = |angle: f64| {
            let direction = Vector3::new(angle.sin(), 0.0, -angle.cos());
            camera_around(&points, direction, Vector3::y(), size, 0.06)
        };
        let cameras = if turntable {
            let angle = |i: usize| std::f64::consts::TAU * i as f64 / moments.len() as f64;
            (0..moments.len()).map(|i| camera(angle(i))).collect()
        } else {
            vec![camera(0.0)]
        };
        Self { meshes: meshes.iter().map(HandMesh::refined).collect(), moments, cameras, size }
    }

    /// The moments it shows.
    pub fn moments(&self) -> &[Moment] {
        &self.moments
    }

    /// The picture of moment number `index`; empty when there is no such moment.
    pub fn picture(&self, index: usize, style: &Style) -> RgbaImage {
        let camera = self.cameras.get(index).or(self.cameras.first());
        let (Some(moment), Some(camera)) = (self.moments.get(index), camera) else {
            return RgbaImage::new(self.size.0, self.size.1);
        };
        let hands: Vec<_> =
            moment.hands.iter().filter_map(|(i, frames)| Some((self.meshes.get(*i)?, frames))).collect();
        render_hands(&hands, camera, self.size, style)
    }

    /// Draws all pictures, on all processors, and hands each with its number to `take`, in their order.
    ///
    /// # Errors
    /// The first of `take`, which ends the work.
    pub fn in_order<E>(
        &self,
        style: &Style,
        mut take: impl FnMut(usize, RgbaImage) -> Result<(), E>,
    ) -> Result<(), E> {
        let workers = rayon::current_num_threads();
        let count = self.moments.len();
        let some = |first: usize| -> Vec<RgbaImage> {
            (first..count.min(first + workers)).into_par_iter().map(|i| self.picture(i, style)).collect()
        };
        let mut pictures = some(0);
        for first in (0..count).step_by(workers) {
            // The next ones are drawn while these are taken.
            pictures = std::thread::scope(|scope| {
                let next = scope.spawn(|| some(first + workers));
                (first..).zip(pictures).try_for_each(|(i, picture)| take(i, picture))?;
                Ok(next.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
            })?;
        }
        Ok(())
    }

    /// All pictures in rows of `columns`, each with its time in seconds.
    pub fn sheet(&self, columns: u32, style: &Style) -> RgbaImage {
        let scale = (self.size.1 / 120).max(1);
        let mut pictures = Vec::with_capacity(self.moments.len());
        let Ok(()) = self.in_order(style, |i, mut picture| {
            let time = format!("{:.2} s", self.moments[i].time);
            draw_label(&mut picture, &time, 3 * scale, 3 * scale, scale, Rgba([110, 110, 120, 255]));
            pictures.push(picture);
            Ok::<_, Infallible>(())
        });
        let around = if style.background.is_some() { Rgba([255; 4]) } else { Rgba([0; 4]) };
        contact_sheet(&pictures, columns, self.size.0 / 32, around)
    }
}

/// One picture of `size` pixels of one hand, seen from the front.
pub fn still(mesh: &HandMesh, frames: &HandFrames, size: (u32, u32), style: &Style) -> RgbaImage {
    let moment = Moment { time: 0.0, hands: vec![(0, frames.clone())] };
    Film::new(std::slice::from_ref(mesh), vec![moment], size, false).picture(0, style)
}

/// Numbers of at most `count` of `length` things, evenly spread from the first to the last.
pub fn spread(count: usize, length: usize) -> Vec<usize> {
    let count = count.min(length);
    (0..count).map(|i| i * (length - 1) / count.saturating_sub(1).max(1)).collect()
}

/// A contact sheet of evenly spaced moments of a motion of one hand: `count` pictures of `cell` pixels in
/// rows of `columns`, the same camera for all so that movement shows, each with its time in seconds.
///
/// `poses` are times and joint frames in the camera frame of the clip.
pub fn preview_sheet(
    mesh: &HandMesh,
    poses: &[(f64, HandFrames)],
    count: usize,
    columns: u32,
    cell: (u32, u32),
    style: &Style,
) -> RgbaImage {
    let chosen = spread(count, poses.len()).into_iter().filter_map(|i| poses.get(i));
    let moments = chosen.map(|(time, frames)| Moment { time: *time, hands: vec![(0, frames.clone())] });
    Film::new(std::slice::from_ref(mesh), moments.collect(), cell, false).sheet(columns, style)
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::{HandPose, Morphology, Side, Skeleton};

    #[test]
    fn moments_are_spread_from_end_to_end() {
        assert_eq!(spread(3, 10), [0, 4, 9]);
        assert_eq!(spread(12, 2), [0, 1]);
        assert_eq!(spread(1, 5), [0]);
        assert!(spread(3, 0).is_empty() && spread(0, 3).is_empty());
    }

    #[test]
    fn two_hands_share_a_picture_and_a_turntable_shows_their_backs() {
        let m = Morphology::default();
        let meshes = [Side::Left, Side::Right].map(|side| HandMesh::generate(&m, side));
        let hand = |side: Side, x: f64| {
            let mut pose = HandPose::neutral(side);
            pose.translation.x = x;
            Skeleton::new(&m, side).frames(&pose)
        };
        let both = vec![(0, hand(Side::Left, -0.12)), (1, hand(Side::Right, 0.12))];
        let moments = vec![Moment { time: 0.0, hands: both.clone() }, Moment { time: 1.0, hands: both }];
        let style = Style { background: None, samples: 1, ..Style::default() };
        let film = Film::new(&meshes, moments, (120, 80), true);
        let [front, back] = [0, 1].map(|i| film.picture(i, &style));
        let inked = |picture: &RgbaImage, from: u32| {
            picture.enumerate_pixels().filter(|(x, _, p)| p[3] > 0 && *x / 60 == from).count()
        };
        for picture in [&front, &back] {
            assert!(inked(picture, 0) > 500 && inked(picture, 1) > 500);
        }
        assert_ne!(front, back);
        let mut drawn = Vec::new();
        let mut take = |i: usize, picture: RgbaImage| {
            drawn.push(picture);
            if i == 1 { Err("enough") } else { Ok(()) }
        };
        assert_eq!(film.in_order(&style, &mut take), Err("enough"));
        assert_eq!(drawn, [front, back]);
    }
}
