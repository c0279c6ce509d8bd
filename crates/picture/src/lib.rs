//! RGB pictures: scaling by box filter, drawing lines and labels, linear light.
//!
//! What every stage that handles pictures needs and none of them owns; it knows neither hands nor files.

mod draw;
mod resample;

pub use draw::{draw_label, draw_label_on, draw_line, draw_stroke};
pub use resample::{Resampler, Shrinker, fit_within};
