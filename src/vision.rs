//! Colour model, segmentation, mathematical morphology, contours, distance maps, finger and palm parts.

mod colour;
mod contour;
mod mask;
pub mod morphology;
mod parts;
mod segment;
mod wrist;

pub use contour::{Contour, ContourPoint};
pub use mask::{Mask, PixelRect};
pub use parts::{Chirality, Finger, HandParts, PartsError, find_parts};
pub use segment::{SegmentOptions, Segmenter, Silhouette, VisionError, draw_line, draw_outline};
pub use wrist::{Disc, Wrist, cut_forearm};
