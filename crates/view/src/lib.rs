//! A page with the moving hand: everything it needs in one HTML file, drawn by its own WebGL 2.
//!
//! [`page`] puts sizes, motion, joint angles, the account of bits and the clip into the page as compact numbers, and the modules of
//! `handcast-js` that make the surface of a hand of such sizes and decode streams that are dropped on it; style and scripts are
//! those of `src/page/`. The page asks for nothing from anywhere, and its content security policy forbids it to. [`serve`] hands it
//! to a browser on this machine.

mod hand;
mod pack;
mod policy;
mod server;
mod video;

pub use policy::policy;
pub use server::{bind, serve};
pub use video::{Film, Pictures, Video, picture_side};

use std::io;

use serde::Serialize;
use serde_json::json;
use thiserror::Error;

use hand::{PageHand, angle_names, instants};
use handcast_hand::{Morphology, PoseClip, Side};
use handcast_js::{DRAWING, STYLE};
use pack::{array, deflated};
use policy::policy_of_page;

/// Most instants of one page: an hour at 30 frames per second, about 40 MB a hand.
pub const MAX_INSTANTS: usize = handcast_limits::DEFAULT.instants as usize;

/// Why there is no page.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ViewError {
    /// The motion is too long.
    #[error("view: {instants} instants, at most {MAX_INSTANTS} fit on a page")]
    TooLong {
        /// Instants of the motion.
        instants: usize,
    },
    /// The numbers could not be written as JSON.
    #[error("view: {0}")]
    Json(#[from] serde_json::Error),
}

/// What one object plane of a stream costs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneCost {
    /// Seconds.
    pub time: f64,
    /// Bits, the start codes before it included.
    pub bits: u64,
    /// Whether it is an I plane, at which a decoder can start.
    pub intra: bool,
}

/// A stream and what its planes cost.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StreamCost {
    /// Length of the stream.
    pub bytes: usize,
    /// Its planes, in order of time.
    pub planes: Vec<PlaneCost>,
}

/// What a page shows.
#[derive(Debug)]
pub struct Show<'a> {
    /// Name, usually of the file.
    pub title: &'a str,
    /// The motion of one hand or two.
    pub clip: &'a PoseClip,
    /// Sizes of hands whose header says none.
    pub morphology: &'a Morphology,
    /// The account of the stream it comes from.
    pub stream: Option<&'a StreamCost>,
    /// The clip it was made from.
    pub video: Option<&'a Video>,
    /// Remarks to show.
    pub notes: &'a [String],
}

/// Times of the instants a page of `clip` steps through: all at which any hand has a pose, seconds, in order.
pub fn times(clip: &PoseClip) -> Vec<f64> {
    instants(clip)
}

/// The page as one HTML file. A clip without poses gives a page that says so.
///
/// # Errors
/// See [`ViewError`].
pub fn page(show: &Show) -> Result<String, ViewError> {
    let times = instants(show.clip);
    if times.len() > MAX_INSTANTS {
        return Err(ViewError::TooLong { instants: times.len() });
    }
    let hands: Vec<PageHand> = [Side::Left, Side::Right]
        .into_iter()
        .filter(|&side| show.clip.of(side).any(|f| f.valid))
        .map(|side| {
            let info = show.clip.header.hand(side).and_then(|h| h.morphology.as_ref());
            PageHand::new(show.clip, side, info.unwrap_or(show.morphology), &times)
        })
        .collect();
    assemble(&Data {
        title: show.title,
        rate: show.clip.header.rate,
        skin: show.clip.header.skin(),
        times: array(times.iter().copied(), f64::to_le_bytes),
        hands,
        angles: angle_names(),
        stream: show.stream.map(|stream| account(stream, &times)),
        video: show.video,
        notes: show.notes,
        surface: deflated(handcast_js::SURFACE),
        decoder: deflated(handcast_js::DECODER),
    })
}

/// The numbers of a page.
#[derive(Serialize)]
struct Data<'a> {
    title: &'a str,
    rate: Option<f64>,
    /// The colour of the skin (sRGB), where it is known.
    skin: Option<[u8; 3]>,
    times: String,
    hands: Vec<PageHand>,
    angles: Vec<serde_json::Value>,
    stream: Option<serde_json::Value>,
    video: Option<&'a Video>,
    notes: &'a [String],
    /// Modules of WebAssembly, deflated.
    surface: String,
    decoder: String,
}

/// A page that JSON is written into. `<` only occurs inside of strings, where its escape means the same and cannot end the
/// element.
struct InScript<'a>(&'a mut Vec<u8>);

impl io::Write for InScript<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        for (n, part) in bytes.split(|&byte| byte == b'<').enumerate() {
            if n > 0 {
                self.0.extend_from_slice(b"\\u003c");
            }
            self.0.extend_from_slice(part);
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Bits and kind (0 none, 1 P, 2 I) by instant.
fn account(stream: &StreamCost, times: &[f64]) -> serde_json::Value {
    let mut bits = vec![0u32; times.len()];
    let mut kinds = vec![0u8; times.len()];
    for plane in &stream.planes {
        let after = times.partition_point(|t| *t < plane.time);
        let before = after.saturating_sub(1);
        let distance = |i: usize| times.get(i).map_or(f64::INFINITY, |t| (t - plane.time).abs());
        let at = if distance(before) < distance(after) { before } else { after };
        if let (Some(sum), Some(kind)) = (bits.get_mut(at), kinds.get_mut(at)) {
            *sum = sum.saturating_add(u32::try_from(plane.bits).unwrap_or(u32::MAX));
            *kind = (*kind).max(1 + u8::from(plane.intra));
        }
    }
    json!({ "bytes": stream.bytes, "bits": array(bits, u32::to_le_bytes), "kinds": deflated(&kinds) })
}

/// The page's parts in their places.
fn assemble(data: &Data) -> Result<String, ViewError> {
    let script = [
        "\n",
        // A module of its own, whose names those of the block may cover.
        handcast_js::SCRIPT,
        "\n{\n",
        include_str!("page/data.js"),
        DRAWING,
        include_str!("page/charts.js"),
        include_str!("page/bones.js"),
        include_str!("page/clip.js"),
        include_str!("page/open.js"),
        include_str!("page/app.js"),
        "\n}\n",
    ]
    .concat();
    let mut page = Vec::new();
    let mut rest = include_str!("page/page.html");
    for mark in ["{{policy}}", "{{style}}", "{{data}}", "{{script}}"] {
        let (before, after) = rest.split_once(mark).unwrap_or((rest, ""));
        page.extend_from_slice(before.as_bytes());
        match mark {
            "{{policy}}" => page.extend_from_slice(policy_of_page(&[&script], &[STYLE]).as_bytes()),
            "{{style}}" => page.extend_from_slice(STYLE.as_bytes()),
            "{{data}}" => serde_json::to_writer(InScript(&mut page), data)?,
            _ => page.extend_from_slice(script.as_bytes()),
        }
        rest = after;
    }
    page.extend_from_slice(rest.as_bytes());
    // Text all of it, so that nothing is lost.
    Ok(String::from_utf8(page).unwrap_or_else(|error| String::from_utf8_lossy(error.as_bytes()).into_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::{HandPose, TimedPose};

    fn show(clip: &PoseClip) -> String {
        let morphology = Morphology::default();
        let title = "</script><b>x";
        page(&Show { title, clip, morphology: &morphology, stream: None, video: None, notes: &[] }).unwrap()
    }

    #[test]
    fn a_page_holds_all_its_parts_and_no_name_ends_its_script() {
        let mut clip = PoseClip::default();
        clip.frames.push(TimedPose::new(0.0, HandPose::neutral(Side::Right)));
        let text = show(&clip);
        assert!(!text.contains("{{") && !text.contains("<b>x"), "a part is missing, or a name is markup");
        assert!(text.contains("\\u003c/script>\\u003cb>x"));
        assert!(text.trim_end().ends_with("</html>"));
        assert!(text.contains("script-src 'sha256-") && !text.contains("unsafe-inline"));
        assert!(!text.contains("'unsafe-eval'"));
        for word in ["http:", "https:", "//cdn"] {
            assert!(!text.contains(word), "the page names {word}");
        }
        // For Node, which the page is not; its policy would not have it.
        assert_eq!(text.matches("import(").count(), 1);
        assert!(text.contains("import(/* @vite-ignore */ \"node:fs/promises\")"));
    }

    #[test]
    fn motions_without_poses_and_too_long_ones() {
        assert!(show(&PoseClip::default()).contains("\"hands\":[]"));
        let mut clip = PoseClip::default();
        let pose = HandPose::neutral(Side::Right);
        clip.frames = (0..=MAX_INSTANTS).map(|i| TimedPose::lost(i as f64, pose.side)).collect();
        let morphology = Morphology::default();
        let show =
            Show { title: "", clip: &clip, morphology: &morphology, stream: None, video: None, notes: &[] };
        assert!(matches!(page(&show), Err(ViewError::TooLong { .. })));
    }

    #[test]
    fn planes_go_to_the_nearest_instant() {
        let planes = [(0.0, 100, true), (0.041, 20, false), (0.119, 30, false)]
            .map(|(time, bits, intra)| PlaneCost { time, bits, intra });
        let stream = StreamCost { bytes: 19, planes: planes.to_vec() };
        let value = account(&stream, &[0.0, 0.04, 0.08, 0.12]);
        assert_eq!(pack::inflated(value["kinds"].as_str().unwrap()), [2, 1, 0, 1]);
        assert_eq!(value["bits"], array([100, 20, 0, 30], u32::to_le_bytes));
    }
}
