//! TensorFlow Lite networks in pure Rust, and hands found with them.
//!
//! [`Network`] reads a `.tflite` file of [the operators listed](model::Operation) and runs it; [`files`] finds the networks of
//! MediaPipe Hands on disk; [`hands`] finds hands in pictures with them.
//!
//! ```no_run
//! use handcast_net::files::{Bundle, Size};
//! use handcast_net::hands::{NetFinder, NetFinderOptions};
//! use handcast_vision::sighting::HandFinder;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let bundle = Bundle::find(None, Size::Full)?;
//! let mut finder = NetFinder::new(&bundle, NetFinderOptions::default().with_hands(1))?;
//! # let pictures: Vec<image::RgbImage> = Vec::new();
//! let mut hands = Vec::new();
//! for (number, picture) in pictures.iter().enumerate() {
//!     finder.find(picture, number as f64 / 30.0, &mut hands)?;
//!     for hand in &hands {
//!         println!("wrist at {:?}, presence {:.2}", hand.points[0], hand.presence);
//!     }
//! }
//! # Ok(())
//! # }
//! ```

mod error;
pub mod files;
mod graph;
pub mod hands;
mod kernels;
pub mod model;
pub mod testing;

pub use error::{Error, Result};
pub use graph::{Network, Port};
