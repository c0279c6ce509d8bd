//! A page with the moving hand: everything it needs in one HTML file, drawn by its own WebGL 2.
//!
//! [`page`] puts sizes, motion, joint angles, the account of bits and the clip into the page as compact numbers, and the modules of
//! `handcast-js` that make the surface of a hand of such sizes and decode streams that are dropped on it; markup, style and scripts
//! are those of `src/page/`. The page asks for nothing from anywhere, and its content security policy forbids it to. [`serve`]
//! hands it to a browser on this machine.

mod hand;
mod pack;
mod policy;
mod server;
mod video;

pub use policy::policy;
pub use server::{bind, serve};
pub use video::{Film, Pictures, Video, picture_side};

use flate2::Compression;
use serde::Serialize;
use thiserror::Error;

use hand::{PageHand, angle_names, instants};
use handcast_hand::{Morphology, PoseClip, Side, nearest_in_time};
use handcast_js::{DRAWING, STYLE};
use pack::{PageFile, Part, Parts};
use policy::policy_of_page;

/// Most instants of one page: an hour at 30 frames per second, about 30 MB a hand before they are deflated.
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

/// The page as one HTML file, in UTF-16 from its byte order mark on: its bytes are to be written and sent as they are, and a server
/// that names a character set should say `utf-16le`. A clip without poses gives a page that says so.
///
/// # Errors
/// See [`ViewError`].
pub fn page(show: &Show) -> Result<Vec<u8>, ViewError> {
    let times = instants(show.clip);
    if times.len() > MAX_INSTANTS {
        return Err(ViewError::TooLong { instants: times.len() });
    }
    let mut parts = Parts::default();
    let hands: Vec<PageHand> = [Side::Left, Side::Right]
        .into_iter()
        .filter(|&side| show.clip.of(side).any(|f| f.valid))
        .map(|side| {
            let info = show.clip.header.hand(side).and_then(|h| h.morphology.as_ref());
            PageHand::new(show.clip, side, info.unwrap_or(show.morphology), &times, &mut parts)
        })
        .collect();
    let script = script();
    let data = Data {
        title: show.title,
        rate: show.clip.header.rate,
        skin: show.clip.header.skin(),
        times: parts.numbers(times.iter().copied(), f64::to_le_bytes),
        hands,
        angles: angle_names(),
        stream: show.stream.map(|stream| account(stream, &times, &mut parts)),
        video: show.video,
        notes: show.notes,
        markup: parts.add(include_bytes!("page/markup.html")),
        style: parts.add(STYLE.as_bytes()),
        script: parts.add(script.as_bytes()),
        surface: parts.add(handcast_js::SURFACE),
        decoder: parts.add(handcast_js::DECODER),
    };
    Ok(assemble(&script, &parts.and(&data)?, show.video))
}

/// What a page shows, and where its bytes are.
#[derive(Serialize)]
struct Data<'a> {
    title: &'a str,
    rate: Option<f64>,
    /// The colour of the skin (sRGB), where it is known.
    skin: Option<[u8; 3]>,
    times: Part,
    hands: Vec<PageHand>,
    angles: Vec<serde_json::Value>,
    stream: Option<Account>,
    video: Option<&'a Video>,
    notes: &'a [String],
    /// Texts: elements of the body, its style and the script.
    markup: Part,
    style: Part,
    script: Part,
    /// Modules of WebAssembly.
    surface: Part,
    decoder: Part,
}

/// Bits (`u32`) and kind (a byte: 0 none, 1 P, 2 I) by instant.
#[derive(Serialize)]
struct Account {
    bytes: usize,
    bits: Part,
    kinds: Part,
}

/// The planes of a stream on the instants of a page.
fn account(stream: &StreamCost, times: &[f64], parts: &mut Parts) -> Account {
    let mut bits = vec![0u32; times.len()];
    let mut kinds = vec![0u8; times.len()];
    for plane in &stream.planes {
        let Some(at) = nearest_in_time(times, plane.time, |time| *time) else { break };
        bits[at] = bits[at].saturating_add(u32::try_from(plane.bits).unwrap_or(u32::MAX));
        kinds[at] = kinds[at].max(1 + u8::from(plane.intra));
    }
    Account { bytes: stream.bytes, bits: parts.numbers(bits, u32::to_le_bytes), kinds: parts.add(&kinds) }
}

/// The script that shows the motion.
fn script() -> String {
    let script = [
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
    without_comments(&script)
}

/// A script without the comments that have lines of their own: they are for who reads the source, and an eighth of the
/// deflated script.
fn without_comments(script: &str) -> String {
    let mut in_block = false;
    let code = script.lines().filter(|line| {
        let line = line.trim_start();
        let comment = in_block || line.starts_with("/*");
        in_block = comment && !line.ends_with("*/");
        !comment && !line.starts_with("//")
    });
    code.collect::<Vec<_>>().join("\n")
}

/// The file of a page whose script is `script`: what makes it out of its bytes, these, and those of the clip.
fn assemble(script: &str, body: &[u8], video: Option<&Video>) -> Vec<u8> {
    const UNPACK: &str = include_str!("page/unpack.js");
    let mut file = PageFile::new();
    let mut rest = include_str!("page/page.html");
    for mark in ["{{policy}}", "{{unpack}}", "{{packed}}"] {
        let (before, after) = rest.split_once(mark).unwrap_or((rest, ""));
        file.text(before);
        match mark {
            "{{policy}}" => file.text(&policy_of_page(&[UNPACK, script], &[STYLE])),
            "{{unpack}}" => file.text(UNPACK),
            _ => {
                file.bytes("bytes", body, Compression::best());
                if let Some(video) = video {
                    // Films and JPEG have been compressed.
                    file.bytes("clip-bytes", video.bytes(), Compression::none());
                }
            }
        }
        rest = after;
    }
    file.text(rest);
    file.finish()
}

#[cfg(test)]
mod tests {
    use super::pack::testing;
    use super::*;
    use handcast_hand::{HandPose, TimedPose};

    /// The text of a page, and what is in its body as text.
    fn show(clip: &PoseClip) -> (String, String) {
        let morphology = Morphology::default();
        let title = "</script><b>x";
        let show = Show { title, clip, morphology: &morphology, stream: None, video: None, notes: &[] };
        let text = testing::text(&page(&show).unwrap());
        let body = testing::packed(&text, "bytes");
        (text, String::from_utf8_lossy(&body).into_owned())
    }

    #[test]
    fn a_page_holds_all_its_parts_and_no_name_is_in_its_text() {
        let mut clip = PoseClip::default();
        clip.frames.push(TimedPose::new(0.0, HandPose::neutral(Side::Right)));
        let (text, body) = show(&clip);
        assert!(!text.contains("{{") && !text.contains("<b>x"), "a part is missing, or a name is markup");
        assert!(text.starts_with("<!doctype html>") && text.trim_end().ends_with("</html>"));
        assert!(body.contains("</script><b>x") && body.contains("<main id=\"main\">"));
        assert!(text.contains("script-src 'sha256-") && !text.contains("unsafe-inline"));
        assert!(!text.contains("'unsafe-eval'"));
        for word in ["http:", "https:", "//cdn", "src=\"/", "@import", "url("] {
            assert!(!text.contains(word) && !body.contains(word), "the page names {word}");
        }
        // For Node, which the page is not; its policy would not have it.
        assert_eq!((text.matches("import(").count(), body.matches("import(").count()), (0, 1));
        assert!(body.contains("import(/* webpackIgnore: true */ /* @vite-ignore */ `node:"));
    }

    #[test]
    fn comments_of_whole_lines_are_left_out() {
        let script =
            "/** One. */\nf(/* kept */ 1); // kept\n  // out\n  /**\n   * out\n   */\nconst g = 'a // b';";
        assert_eq!(without_comments(script), "f(/* kept */ 1); // kept\nconst g = 'a // b';");
    }

    #[test]
    fn motions_without_poses_and_too_long_ones() {
        assert!(show(&PoseClip::default()).1.contains("\"hands\":[]"));
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
        let mut parts = Parts::default();
        let account = account(&stream, &[0.0, 0.04, 0.08, 0.12], &mut parts);
        assert_eq!(parts.of(&account.kinds), [2, 1, 0, 1]);
        assert_eq!(parts.of(&account.bits), [100u32, 20, 0, 30].map(u32::to_le_bytes).as_flattened());
    }
}
