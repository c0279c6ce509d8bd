//! The camera of a picture.

/// A camera without lens distortion, looking along −Z, its axis through the middle of the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PinholeCamera {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Focal length, pixels.
    pub focal: f64,
}

impl PinholeCamera {
    /// A camera whose longer side sees `degrees`. Without calibration 60° is a fair guess for phones
    /// and webcams; only the depth of the hand depends on it.
    pub fn with_field_of_view(width: u32, height: u32, degrees: f64) -> Self {
        let half = 0.5 * f64::from(width.max(height));
        Self { width, height, focal: half / (0.5 * degrees.to_radians()).tan() }
    }

    /// The same camera with images of 1/`factor` of the size; what does not divide on the right
    /// and below counts as a whole pixel.
    #[must_use]
    pub fn reduced(&self, factor: u32) -> Self {
        let factor = factor.max(1);
        Self {
            width: self.width.div_ceil(factor),
            height: self.height.div_ceil(factor),
            focal: self.focal / f64::from(factor),
        }
    }
}
