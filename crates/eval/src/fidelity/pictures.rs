//! Pictures for the report: moments worth looking at, and the decoded hand.

use std::io::Cursor;

use image::{ImageFormat, RgbImage, RgbaImage};

use super::clip::{MeasuredClip, Moment};
use super::round_trip::RoundTrip;
use handcast_hand::{
    HandFrames, HandMesh, HandPose, JointAngle, Morphology, PoseClip, Side, Skeleton, TimedPose,
};
use handcast_render::{Camera, Film, Style, render_hands};
use handcast_track::{HandModel, PinholeCamera};

/// A picture and what it shows.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// In a few words.
    pub caption: String,
    /// `image/png` or `image/jpeg`.
    pub mime: &'static str,
    /// The file.
    pub bytes: Vec<u8>,
    /// Width and height, pixels.
    pub size: (u32, u32),
}

/// Pictures that belong together: a moment, what went in and what came out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Group {
    /// What is seen.
    pub title: String,
    /// The pictures.
    pub pictures: Vec<Picture>,
}

/// The pictures of a report.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gallery {
    /// Where tracking is worst: the clip with what was made of it, and the decoded hand seen by the same camera.
    pub tracking: Vec<Group>,
    /// Where coding is worst: the hand before and after.
    pub coding: Vec<Group>,
    /// The decoded hand at even moments.
    pub decoded: Vec<Picture>,
}

/// Moments of the decoded hand.
const SHOWN: usize = 12;
/// Longest side of a picture that comes from a clip, pixels.
const LONGEST: u32 = 360;
/// Width and height of a rendered hand, pixels.
const CELL: (u32, u32) = (240, 270);

fn png(caption: String, picture: RgbaImage) -> Option<Picture> {
    let size = picture.dimensions();
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, ImageFormat::Png).ok()?;
    Some(Picture { caption, mime: "image/png", bytes: bytes.into_inner(), size })
}

/// Photographs are a fifth as large as JPEG.
fn jpeg(caption: String, picture: &RgbImage) -> Option<Picture> {
    let mut bytes = Vec::new();
    let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 85);
    picture.write_with_encoder(encoder).ok()?;
    Some(Picture { caption, mime: "image/jpeg", bytes, size: picture.dimensions() })
}

/// Draws everything there is to see; a hand's sizes are those of its header, or average ones.
pub fn gallery(trip: &RoundTrip, measured: Option<&MeasuredClip>) -> Gallery {
    let decoded = &trip.decoded.clip;
    let mut gallery = Gallery::default();
    for hand in &decoded.header.hands {
        let artist = Artist::new(hand.morphology.as_ref().unwrap_or(&Morphology::default()), hand.side);
        let seen = measured.filter(|m| m.clip.hands.first().is_some_and(|h| h.start.side == hand.side));
        gallery.tracking.extend(seen.map_or_else(Vec::new, |m| artist.tracking(m, decoded)));
        gallery.coding.extend(artist.coding(&trip.encoded.clip, decoded));
        gallery.decoded.extend(artist.moments(decoded));
    }
    gallery
}

struct Artist {
    side: Side,
    mesh: HandMesh,
    skeleton: Skeleton,
    style: Style,
}

impl Artist {
    fn new(morphology: &Morphology, side: Side) -> Self {
        Self {
            side,
            mesh: HandMesh::generate(morphology, side),
            skeleton: Skeleton::new(morphology, side),
            style: Style { background: None, ..Style::default() },
        }
    }

    fn frames(&self, pose: &HandPose) -> HandFrames {
        self.skeleton.frames(pose)
    }

    /// Pictures of these moments by one camera.
    fn film(&self, moments: &[(f64, HandFrames)], size: (u32, u32)) -> Film {
        let shown = moments
            .iter()
            .map(|(time, frames)| handcast_render::Moment { time: *time, hands: vec![(0, frames.clone())] });
        Film::new(std::slice::from_ref(&self.mesh), shown.collect(), size, false)
    }

    /// The decoded hand at even moments, all seen by one camera.
    fn moments(&self, clip: &PoseClip) -> Vec<Picture> {
        let poses: Vec<&TimedPose> = clip.of(self.side).filter(|f| f.valid).collect();
        let count = SHOWN.min(poses.len());
        let last = poses.len().saturating_sub(1);
        let chosen: Vec<(f64, HandFrames)> = (0..count)
            .filter_map(|i| poses.get(i * last / count.saturating_sub(1).max(1)))
            .map(|f| (f.time, self.frames(&f.pose)))
            .collect();
        let film = self.film(&chosen, (CELL.0 * 3 / 4, CELL.1 * 3 / 4));
        chosen
            .iter()
            .enumerate()
            .filter_map(|(i, (time, _))| png(format!("{time:.2} s"), film.picture(i, &self.style)))
            .collect()
    }

    /// The frames in which a joint angle is furthest off, before and after, seen by one camera.
    fn coding(&self, sent: &PoseClip, decoded: &PoseClip) -> Vec<Group> {
        let mut pairs: Vec<(f64, JointAngle, &TimedPose, &TimedPose)> = Vec::new();
        for (a, b) in sent.of(self.side).zip(decoded.of(self.side)).filter(|(a, _)| a.valid) {
            let off = |angle| (a.pose.angle(angle) - b.pose.angle(angle)).abs();
            if let Some(angle) = JointAngle::ALL.into_iter().max_by(|&x, &y| off(x).total_cmp(&off(y))) {
                pairs.push((off(angle), angle, a, b));
            }
        }
        pairs.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut chosen: Vec<(f64, JointAngle, &TimedPose, &TimedPose)> = Vec::new();
        for pair in pairs {
            if chosen.len() < 3 && chosen.iter().all(|other| (other.2.time - pair.2.time).abs() > 0.8) {
                chosen.push(pair);
            }
        }
        let group = |&(off, angle, a, b): &(f64, JointAngle, &TimedPose, &TimedPose)| {
            let poses = [a, b].map(|f| (f.time, self.frames(&f.pose)));
            let film = self.film(&poses, CELL);
            let picture = |i: usize, name: &str| png(name.to_owned(), film.picture(i, &self.style));
            Group {
                title: format!("{:.2} s: {} off by {:.2}°", a.time, angle.name(), off.to_degrees()),
                pictures: [picture(0, "sent"), picture(1, "decoded")].into_iter().flatten().collect(),
            }
        };
        chosen.iter().map(group).collect()
    }

    /// The worst moments of a clip, and the decoded hand as its camera would see it; both cut out around the hand.
    fn tracking(&self, measured: &MeasuredClip, decoded: &PoseClip) -> Vec<Group> {
        let clip = &measured.clip;
        let Some(hand) = clip.hands.first() else { return Vec::new() };
        let camera = hand.start.camera;
        let model = HandModel::new(&hand.start.morphology, self.side).with_camera(camera);
        let start = decoded.of(self.side).next().map_or(0.0, |f| f.time);
        let first = clip.times.first().copied().unwrap_or_default();
        let with_truth = measured.seam.frame_deg.is_some();
        let group = |moment: &Moment| {
            let tracked = &hand.frames.get(moment.frame)?.tracked;
            let cut = Cut::around(&model.joints(&tracked.state), &camera);
            let time = moment.time - first + start;
            let off = |f: &TimedPose| (f.time - time).abs();
            let nearest = decoded.of(self.side).min_by(|a, b| off(a).total_cmp(&off(b)))?;
            let picture = render_hands(
                &[(&self.mesh, &self.frames(&nearest.pose))],
                &cut.camera,
                cut.size,
                &self.style,
            );
            let shown = png("decoded from the stream, same camera".into(), picture);
            let seen = jpeg("green: silhouette, orange: model".into(), &cut.of(&moment.overlay));
            let angles = match with_truth {
                true => format!(", joint angles off by {:.1}° on average", moment.badness),
                false => String::new(),
            };
            let Moment { frame, iou, .. } = moment;
            Some(Group {
                title: format!("frame {frame}, {:.2} s: overlap {iou:.3}{angles}", moment.time),
                pictures: [seen, shown].into_iter().flatten().collect(),
            })
        };
        measured.moments.iter().filter_map(group).collect()
    }
}

/// A part of a clip's picture, enlarged.
struct Cut {
    /// Left, top, width and height in the clip's picture, pixels.
    part: [u32; 4],
    /// Width and height afterwards, pixels.
    size: (u32, u32),
    /// The clip's camera, of the part alone.
    camera: Camera,
}

impl Cut {
    /// The part around these joints, with as much again on each side as shows where the hand is.
    fn around(joints: &[[f64; 2]], camera: &PinholeCamera) -> Self {
        let ends = |axis: usize, limit: u32| {
            let along = || joints.iter().map(|j| j[axis]);
            let (low, high) = (along().fold(f64::MAX, f64::min), along().fold(f64::MIN, f64::max));
            let margin = 0.3 * (high - low) + 12.0;
            let limit = f64::from(limit);
            let from = (low - margin).clamp(0.0, (limit - 32.0).max(0.0)).floor();
            (from as u32, ((high + margin).clamp(from + 32.0, limit.max(from + 32.0)) - from).ceil() as u32)
        };
        let ((x, width), (y, height)) = (ends(0, camera.width), ends(1, camera.height));
        let zoom = (f64::from(LONGEST) / f64::from(width.max(height))).min(2.0);
        let scaled = |v: u32| ((f64::from(v) * zoom).round() as u32).max(1);
        let size = (scaled(width), scaled(height));
        let centre = |side: u32, from: u32| (0.5 * f64::from(side) - f64::from(from)) * zoom;
        let mut of_part = Camera::pinhole(size, camera.focal * zoom);
        of_part.centre = [centre(camera.width, x), centre(camera.height, y)];
        Self { part: [x, y, width, height], size, camera: of_part }
    }

    fn of(&self, picture: &RgbImage) -> RgbImage {
        let [x, y, width, height] = self.part;
        let part = image::imageops::crop_imm(picture, x, y, width, height).to_image();
        image::imageops::resize(&part, self.size.0, self.size.1, image::imageops::FilterType::Triangle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cut_holds_the_joints_and_stays_inside() {
        let camera = PinholeCamera { width: 640, height: 360, focal: 554.0 };
        for joints in [[[300.0, 100.0], [360.0, 220.0]], [[-90.0, -50.0], [20.0, 40.0]], [[700.0, 400.0]; 2]]
        {
            let cut = Cut::around(&joints, &camera);
            let [x, y, width, height] = cut.part;
            assert!(x + width <= 640 && y + height <= 360 && width >= 32 && height >= 32, "{:?}", cut.part);
            let picture = cut.of(&RgbImage::new(640, 360));
            assert_eq!(picture.dimensions(), cut.size);
            assert!(cut.size.0.max(cut.size.1) <= LONGEST);
        }
        // A point on the camera's axis falls where the middle of the whole picture is.
        let cut = Cut::around(&[[300.0, 100.0], [360.0, 220.0]], &camera);
        let [u, v] = cut.camera.project(&nalgebra::Point3::new(0.0, 0.0, -1.0)).unwrap();
        let zoom = f64::from(cut.size.0) / f64::from(cut.part[2]);
        assert!((u / zoom + f64::from(cut.part[0]) - 320.0).abs() < 0.5);
        assert!((v / zoom + f64::from(cut.part[1]) - 180.0).abs() < 0.5);
    }
}
