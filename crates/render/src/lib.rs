//! A small software renderer for meshes: previews, overlays and synthetic clips.
//!
//! Triangles go into a supersampled z-buffer ([`Raster`]); what is seen is shaded afterwards
//! ([`shade`]): key light with a shadow map, sky and ground fill, screen-space occlusion, a soft
//! highlight and a rim. Colours are linear inside and sRGB in pictures.
//!
//! What tracking saw and found is drawn over the frames themselves ([`draw_overlay`], [`draw_stages`]).

mod film;
mod overlay;
mod raster;
mod shading;
mod webp;

pub use film::{Film, Moment, preview_sheet, spread, still};
pub use overlay::{GOOD_CONFIDENCE, draw_overlay, draw_stages};
pub use raster::{Camera, Projection, Raster, Surface};
pub use shading::{Shaded, Style, shade, shade_marked};
pub use webp::WebpAnimation;

use image::{Rgba, RgbaImage};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use handcast_hand::{HandFrames, HandMesh, SkinnedSurface};

/// Most pixels along one side of a picture.
pub const MAX_SIDE: u32 = 8192;

/// Draws hands with their joints at the given frames (in the space the camera's `view` starts from) into a
/// picture of `size` (width, height, pixels; at least 1 and at most [`MAX_SIDE`] are used).
pub fn render_hands(
    hands: &[(&HandMesh, &HandFrames)],
    camera: &Camera,
    size: (u32, u32),
    style: &Style,
) -> RgbaImage {
    let skinned: Vec<SkinnedSurface> = hands.iter().map(|(mesh, frames)| posed(mesh, frames)).collect();
    let surfaces: Vec<Surface> =
        hands.iter().zip(&skinned).map(|((mesh, _), skinned)| hand_surface(mesh, skinned)).collect();
    let mut raster = Raster::new(size.0, size.1, style.samples);
    for surface in &surfaces {
        raster.draw(surface, camera);
    }
    let marks: Vec<_> = hands.iter().map(|(mesh, _)| &mesh.marks).collect();
    shade_marked(&raster, &surfaces, &marks, camera, style).to_rgba(style.background)
}

fn posed(mesh: &HandMesh, frames: &HandFrames) -> SkinnedSurface {
    let mut skinned = SkinnedSurface::default();
    mesh.skin(frames, &mut skinned);
    skinned
}

/// The posed hand as something to draw.
pub fn hand_surface<'a>(mesh: &'a HandMesh, skinned: &'a SkinnedSurface) -> Surface<'a> {
    Surface {
        positions: &skinned.positions,
        normals: &skinned.normals,
        triangles: &mesh.triangles,
        tints: &mesh.tints,
        palms: &mesh.palms,
        grain: &mesh.positions,
        layer: 1,
    }
}

/// A perspective camera that looks along `direction` (world) with `up` upwards and has all `points` in
/// a picture of `size`, `margin` (share of the picture) free on each side.
pub fn camera_around(
    points: &[Point3<f64>],
    direction: Vector3<f64>,
    up: Vector3<f64>,
    size: (u32, u32),
    margin: f64,
) -> Camera {
    let mut low = Vector3::repeat(f64::MAX);
    let mut high = Vector3::repeat(f64::MIN);
    for p in points {
        low = low.inf(&p.coords);
        high = high.sup(&p.coords);
    }
    if points.is_empty() {
        (low, high) = (Vector3::repeat(-0.1), Vector3::repeat(0.1));
    }
    let centre = Point3::from((low + high) / 2.0);
    let reach = points.iter().map(|p| (p - centre).norm()).fold(1e-3, f64::max);
    // Far enough that the perspective stays mild.
    let distance = 5.0 * reach;
    // A camera looks along −Z: `face_towards` turns +Z to the direction it is given.
    let turn = UnitQuaternion::face_towards(&-direction, &up).inverse();
    let view = Isometry3::from_parts(Translation3::new(0.0, 0.0, -distance), turn)
        * Translation3::from(-centre.coords);
    let (w, h) = (f64::from(size.0), f64::from(size.1));
    let mut camera = Camera { view, projection: Projection::Perspective { focal: 1.0 }, centre: [0.0, 0.0] };
    let mut box_low = [f64::MAX; 2];
    let mut box_high = [f64::MIN; 2];
    for p in points {
        if let Some(q) = camera.project(p) {
            for k in 0..2 {
                box_low[k] = box_low[k].min(q[k]);
                box_high[k] = box_high[k].max(q[k]);
            }
        }
    }
    if box_low[0] > box_high[0] {
        (box_low, box_high) = ([-0.1; 2], [0.1; 2]);
    }
    let free = 1.0 - 2.0 * margin;
    let focal = (w * free / (box_high[0] - box_low[0]).max(1e-6))
        .min(h * free / (box_high[1] - box_low[1]).max(1e-6));
    camera.projection = Projection::Perspective { focal };
    camera.centre = [
        w / 2.0 - focal * (box_low[0] + box_high[0]) / 2.0,
        h / 2.0 - focal * (box_low[1] + box_high[1]) / 2.0,
    ];
    camera
}

/// Pictures in rows of `columns`, `gutter` pixels between and around them, on `background`. All cells
/// are as large as the largest picture.
pub fn contact_sheet(pictures: &[RgbaImage], columns: u32, gutter: u32, background: Rgba<u8>) -> RgbaImage {
    let columns = columns.max(1);
    let width = pictures.iter().map(RgbaImage::width).max().unwrap_or(1);
    let height = pictures.iter().map(RgbaImage::height).max().unwrap_or(1);
    let rows = (pictures.len() as u32).div_ceil(columns).max(1);
    let mut sheet = RgbaImage::from_pixel(
        columns.min(pictures.len().max(1) as u32) * (width + gutter) + gutter,
        rows * (height + gutter) + gutter,
        background,
    );
    for (i, picture) in pictures.iter().enumerate() {
        let (column, row) = (i as u32 % columns, i as u32 / columns);
        let (x, y) = (gutter + column * (width + gutter), gutter + row * (height + gutter));
        image::imageops::overlay(&mut sheet, picture, i64::from(x), i64::from(y));
    }
    sheet
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::{HandPose, Joint, Morphology, Side, Skeleton};

    fn hand() -> (HandMesh, HandFrames) {
        let m = Morphology::default();
        let mesh = HandMesh::generate(&m, Side::Right);
        let pose = HandPose::neutral(Side::Right);
        (mesh, Skeleton::new(&m, Side::Right).frames(&pose))
    }

    #[test]
    fn the_camera_shows_all_of_the_hand_and_joints_lie_inside_its_silhouette() {
        let (mesh, frames) = hand();
        let size = (160, 200);
        let points: Vec<_> = posed(&mesh, &frames)
            .positions
            .iter()
            .map(|p| Point3::from(Vector3::from(*p).cast::<f64>()))
            .collect();
        let camera = camera_around(&points, -Vector3::z(), Vector3::y(), size, 0.1);
        let style = Style { background: None, ..Style::default() };
        let picture = render_hands(&[(&mesh, &frames)], &camera, size, &style);
        let border = picture
            .enumerate_pixels()
            .filter(|(x, y, p)| p[3] > 0 && (*x < 4 || *y < 4 || *x >= size.0 - 4 || *y >= size.1 - 4));
        assert_eq!(border.count(), 0);
        for joint in Joint::ALL {
            let tip = joint.webxr_name().ends_with("tip");
            let [x, y] = camera.project(&frames.position(joint)).unwrap();
            if !tip {
                assert_eq!(picture.get_pixel(x as u32, y as u32)[3], 255, "{}", joint.webxr_name());
            }
        }
    }

    #[test]
    fn sheets_have_room_for_every_picture() {
        let pictures = vec![RgbaImage::from_pixel(10, 8, Rgba([1, 2, 3, 255])); 5];
        let sheet = contact_sheet(&pictures, 3, 2, Rgba([255; 4]));
        assert_eq!(sheet.dimensions(), (3 * 12 + 2, 2 * 10 + 2));
        let painted = sheet.pixels().filter(|p| p[0] == 1).count();
        assert_eq!(painted, 5 * 80);
    }
}
