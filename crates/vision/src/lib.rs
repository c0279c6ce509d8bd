//! Colour model, segmentation, mathematical morphology, contours, distance maps, finger and palm parts; hands as finders see them.

mod chamfer;
mod colour;
mod contour;
mod geometry;
mod guided;
pub mod light;
mod mask;
pub mod morphology;
mod parts;
mod pyramid;
mod segment;
pub mod sighting;
mod still;
pub mod tuning;
mod wrist;

pub use chamfer::{Chamfer, ChamferMap, outline};
pub use colour::ColourTuning;
pub use contour::{Contour, ContourPoint, ContourTuning};
pub use guided::{GuidedSegmenter, GuidedTuning, hand_length_in};
pub use mask::{Halves, Mask, PixelRect};
pub use parts::{
    Chirality, FingerPart, FingerTuning, HandParts, InertiaAxis, PartsError, PartsTuning, Residue,
    ThumbTuning, TopHat, find_parts, parts_of, top_hat,
};
pub use pyramid::{Pyramid, PyramidSample};
pub use segment::{
    BarTuning, LearningTuning, OutlineTuning, SegmentOptions, Segmenter, Silhouette, SweptTuning,
    VisionError, draw_outline, shrunk,
};
pub use still::{StillBackground, StillTuning};
pub use wrist::{
    BluntEndTuning, CutTuning, ForearmTuning, InscribedCircle, PalmTuning, Wrist, WristTuning, cut_forearm,
};
