//! Pictures for the report: moments worth looking at, and the decoded hand.

use std::io::Cursor;

use image::{ImageFormat, RgbImage, RgbaImage};

use super::clip::MeasuredClip;
use super::round_trip::RoundTrip;
use crate::hand::{HandFrames, HandMesh, HandPose, JointAngle, Morphology, Side, Skeleton};
use crate::io::poses::{PoseClip, TimedPose};
use crate::render::{Camera, Film, Style, render_hand};

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
const LONGEST: u32 = 480;
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
        let seen = measured.filter(|m| m.clip.side() == hand.side);
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

    /// The decoded hand at even moments, all seen by one camera.
    fn moments(&self, clip: &PoseClip) -> Vec<Picture> {
        let poses: Vec<&TimedPose> = clip.of(self.side).filter(|f| f.valid).collect();
        let count = SHOWN.min(poses.len());
        let last = poses.len().saturating_sub(1);
        let chosen: Vec<(f64, HandFrames)> = (0..count)
            .filter_map(|i| poses.get(i * last / count.saturating_sub(1).max(1)))
            .map(|f| (f.time, self.frames(&f.pose)))
            .collect();
        let film = Film::new(&self.mesh, &chosen, (CELL.0 * 3 / 4, CELL.1 * 3 / 4), false);
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
            let film = Film::new(&self.mesh, &poses, CELL, false);
            let picture = |i: usize, name: &str| png(name.to_owned(), film.picture(i, &self.style));
            Group {
                title: format!("{:.2} s: {} off by {:.2}°", a.time, angle.name(), off.to_degrees()),
                pictures: [picture(0, "sent"), picture(1, "decoded")].into_iter().flatten().collect(),
            }
        };
        chosen.iter().map(group).collect()
    }

    /// The worst moments of a clip, and the decoded hand as its camera would see it.
    fn tracking(&self, measured: &MeasuredClip, decoded: &PoseClip) -> Vec<Group> {
        let camera = measured.clip.start.camera;
        let shrink = (f64::from(LONGEST) / f64::from(camera.width.max(camera.height))).min(1.0);
        let fit = |side: u32| ((f64::from(side) * shrink).round() as u32).max(1);
        let size = (fit(camera.width), fit(camera.height));
        let start = decoded.of(self.side).next().map_or(0.0, |f| f.time);
        let first = measured.clip.frames.first().map_or(0.0, |f| f.0);
        let with_truth = measured.seam.frame_deg.is_some();
        measured
            .moments
            .iter()
            .map(|moment| {
                let time = moment.time - first + start;
                let nearest = decoded
                    .of(self.side)
                    .min_by(|a, b| (a.time - time).abs().total_cmp(&(b.time - time).abs()));
                let small = image::imageops::thumbnail(&moment.overlay, size.0, size.1);
                let seen = jpeg("green: silhouette, orange: model".into(), &small);
                let shown = nearest.and_then(|f| {
                    let camera = Camera::pinhole(size, camera.focal * shrink);
                    let picture = render_hand(&self.mesh, &self.frames(&f.pose), &camera, size, &self.style);
                    png("decoded from the stream, same camera".into(), picture)
                });
                let angles = if with_truth {
                    format!(", joint angles off by {:.1}° on average", moment.badness)
                } else {
                    String::new()
                };
                Group {
                    title: format!(
                        "frame {}, {:.2} s: overlap {:.3}{angles}",
                        moment.frame, moment.time, moment.iou
                    ),
                    pictures: seen.into_iter().chain(shown).collect(),
                }
            })
            .collect()
    }
}
