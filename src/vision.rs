//! Colour model, segmentation, mathematical morphology, contours, distance maps, finger and palm parts.

mod mask;

pub use mask::{Mask, PixelRect};
