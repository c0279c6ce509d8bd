//! The files of the npm package `handcast` as constants, for pages that carry or serve them, and what such pages draw with.
//!
//! `crates/web/build.sh` makes the modules out of `handcast-web`; the README beside this crate tells what they do.

/// `handcast.js`: decoder and surface for browsers and Node.
pub const SCRIPT: &str = include_str!("../handcast.js");
/// `handcast-sender.js`: a camera's pictures to the planes of a live stream.
pub const SENDER_SCRIPT: &str = include_str!("../handcast-sender.js");
/// `sender-worker.js`: the thread that the sender tracks on.
pub const SENDER_WORKER: &str = include_str!("../sender-worker.js");
/// `handcast_decoder.wasm`: streams to joint angles and matrices.
pub const DECODER: &[u8] = include_bytes!("../handcast_decoder.wasm");
/// `handcast_surface.wasm`: the skin of a hand of given sizes.
pub const SURFACE: &[u8] = include_bytes!("../handcast_surface.wasm");
/// `handcast_sender.wasm`: tracker and encoder; needs 128-bit SIMD.
pub const SENDER: &[u8] = include_bytes!("../handcast_sender.wasm");

/// The scripts with which pages draw hands and steer the camera: `Painter`, `Orbit`, `steer`, and the vectors and matrices they
/// work with.
pub const DRAWING: &str = concat!(
    include_str!("page/maths.js"),
    include_str!("page/marks.js"),
    include_str!("page/draw.js"),
    include_str!("page/camera.js")
);
/// The pages' style: colours, type, charts, and how they go together on a phone.
pub const STYLE: &str = include_str!("page/style.css");
