//! Joint positions from other trackers: landmark JSON lines, and WebXR poses as JSON.
//!
//! Landmark lines begin with a header, `{"format":"landmarks21","order":"mediapipe","unit":"m","fps":30,
//! "hand":"right"}`, and go on with one frame a line, `{"t":0.0,"points":[[x,y,z],null,…]}`; `points` or
//! any point in it may be null. Where the source is a picture, a frame may have `"image":[[x,y],null,…]` too,
//! the same points in pixels of the picture, x right, y down. Besides 21 points in `mediapipe` order this reads `landmarks25` in
//! `webxr` order and `landmarks26` in `openxr` order (palm first). Units are `m`, `cm` and `mm`; any
//! other is taken for unknown.
//!
//! A WebXR pose file is an array of objects with `handedness`, `names` and `jointPositions`, 25 points in
//! millimetres in the order of `XRHandJoint`; each object becomes one frame, a second after the one before.
//!
//! WebXR-shaped frames are what [`super::export::webxr`] writes: `{"format":"webxr-hands","unit":"m","fps":30,
//! "frames":[{"time":0.0,"hands":[{"handedness":"right","joints":[{"jointName":"wrist","transform":{"position":
//! {"x":0,"y":0,"z":0}}},…]}]},…]}`, one hand or two; joints may be missing.

mod webxr;

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use nalgebra::{Point2, Point3};
use serde::Deserialize;
use thiserror::Error;

use super::lines::LineReader;
use super::poses::json_message;
use handcast_hand::Side;
use handcast_hand::landmarks::{JointPoints, from_landmarks_21};

/// What WebXR-shaped frames say of their format.
pub const WEBXR_FORMAT: &str = "webxr-hands";
/// Most bytes in one line of landmarks.
pub const MAX_LINE_BYTES: usize = 64 * 1024;
/// Most frames in one file.
pub const MAX_FRAMES: usize = 1_000_000;
/// Most bytes in a WebXR pose file.
pub const MAX_WEBXR_BYTES: u64 = 64 << 20;
/// Largest coordinate, in the file's unit.
const MAX_COORDINATE: f64 = 1e6;

/// One frame of joint positions.
#[derive(Clone, Debug, PartialEq)]
pub struct LandmarkFrame {
    /// Seconds.
    pub time: f64,
    /// Names the source gives this frame, for still poses.
    pub names: Vec<String>,
    /// Positions in the file's unit.
    pub points: JointPoints,
    /// Positions in the picture they were found in, pixels, x right, y down; `None` where the source has none.
    pub image: Option<ImagePoints>,
}

/// Positions of the 25 joints in a picture, in the order of [`Joint::ALL`](handcast_hand::Joint::ALL), pixels;
/// `None` where one was not seen.
pub type ImagePoints = [Option<Point2<f64>>; 25];

/// A recording of the joints of one hand.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LandmarkClip {
    /// Frames per second, where the source says so.
    pub rate: Option<f64>,
    /// Left or right, where the source says so.
    pub side: Option<Side>,
    /// Metres in one unit of the points; `None` when the source does not say.
    pub metres: Option<f64>,
    /// Where the source says it comes from.
    pub made_by: Option<String>,
    /// Number of points in a frame as the source has them: 21, 25 or 26.
    pub points_per_frame: usize,
    /// The frames, in order of time.
    pub frames: Vec<LandmarkFrame>,
}

/// Why landmarks could not be read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum LandmarkFileError {
    /// The file could not be opened or read.
    #[error("landmarks: {path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A line is wrong.
    #[error("landmarks: {path}: line {line}: {what}")]
    Line {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// What is wrong, and what was allowed.
        what: String,
    },
    /// A pose of a WebXR file is wrong, or the file as a whole.
    #[error("webxr: {path}: {what}")]
    Webxr {
        /// The file.
        path: PathBuf,
        /// What is wrong and where.
        what: String,
    },
}

impl LandmarkClip {
    /// Reads a file of any kind that has one hand.
    ///
    /// # Errors
    /// See [`LandmarkFileError`].
    pub fn read(path: &Path) -> Result<Self, LandmarkFileError> {
        let mut hands = Self::read_all(path)?;
        match (hands.pop(), hands.is_empty()) {
            (Some(hand), true) => Ok(hand),
            _ => {
                Err(LandmarkFileError::Webxr { path: path.into(), what: "two hands, allowed is one".into() })
            }
        }
    }

    /// Reads a file of any kind: an array is WebXR poses, a document of [`WEBXR_FORMAT`] WebXR-shaped frames,
    /// anything else landmark lines. At least one hand, and two of WebXR-shaped frames only.
    ///
    /// # Errors
    /// See [`LandmarkFileError`].
    pub fn read_all(path: &Path) -> Result<Vec<Self>, LandmarkFileError> {
        let io_error = |source| LandmarkFileError::Io { path: path.into(), source };
        let mut reader = BufReader::new(File::open(path).map_err(io_error)?);
        let start = reader.fill_buf().map_err(io_error)?.trim_ascii_start();
        let format = start.get(..start.len().min(400)).unwrap_or_default();
        if start.first() == Some(&b'[') {
            return Self::read_webxr(path, reader, |text| parse_webxr(text).map(|clip| vec![clip]));
        }
        if format.windows(WEBXR_FORMAT.len()).any(|word| word == WEBXR_FORMAT.as_bytes()) {
            return Self::read_webxr(path, reader, webxr::parse);
        }
        let clip = read_lines(reader).map_err(|(line, what)| LandmarkFileError::Line {
            path: path.into(),
            line,
            what,
        })?;
        Ok(vec![clip])
    }

    fn read_webxr(
        path: &Path,
        reader: impl Read,
        parse: impl Fn(&[u8]) -> Result<Vec<Self>, String>,
    ) -> Result<Vec<Self>, LandmarkFileError> {
        let error = |what| LandmarkFileError::Webxr { path: path.into(), what };
        let mut text = Vec::new();
        let n = reader.take(MAX_WEBXR_BYTES + 1).read_to_end(&mut text);
        n.map_err(|source| LandmarkFileError::Io { path: path.into(), source })?;
        if text.len() as u64 > MAX_WEBXR_BYTES {
            return Err(error(format!("larger than the {MAX_WEBXR_BYTES} bytes allowed")));
        }
        parse(&text).map_err(error)
    }
}

type Point = Option<[f64; 3]>;

#[derive(Deserialize)]
struct Header {
    format: Option<String>,
    order: Option<String>,
    unit: Option<String>,
    fps: Option<f64>,
    hand: Option<Side>,
    made_by: Option<String>,
}

#[derive(Deserialize)]
struct Frame {
    t: f64,
    points: Option<Vec<Point>>,
    image: Option<Vec<Option<[f64; 2]>>>,
}

/// The layouts read: format, order, number of points.
const LAYOUTS: [(&str, &str, usize); 3] =
    [("landmarks21", "mediapipe", 21), ("landmarks25", "webxr", 25), ("landmarks26", "openxr", 26)];

fn read_lines(reader: impl BufRead) -> Result<LandmarkClip, (usize, String)> {
    let mut lines = LineReader::new(reader, MAX_LINE_BYTES);
    let mut next = |clip: &mut Option<LandmarkClip>| -> Result<bool, (usize, String)> {
        let text = match lines.next_line() {
            Ok(Some(text)) => text,
            Ok(None) => return Ok(false),
            Err(e) => return Err((lines.number(), e.describe(MAX_LINE_BYTES))),
        };
        let result = match clip {
            None => parse_header(text).map(|header| *clip = Some(header)),
            Some(clip) => parse_frame(text, clip).map(|frame| clip.frames.push(frame)),
        };
        result.map_err(|what| (lines.number(), what)).map(|()| true)
    };
    let mut clip = None;
    while next(&mut clip)? {}
    clip.ok_or((1, "the file is empty".into()))
}

fn parse_header(text: &str) -> Result<LandmarkClip, String> {
    let header: Header = serde_json::from_str(text).map_err(|e| json_message(&e))?;
    let format = header.format.as_deref().unwrap_or_default();
    let Some((_, order, count)) = LAYOUTS.into_iter().find(|l| l.0 == format) else {
        let known = LAYOUTS.map(|l| l.0).join(", ");
        return Err(format!("format is {format:?}, allowed {known}"));
    };
    if let Some(given) = header.order
        && given != order
    {
        return Err(format!("order is {given:?}, {format} has {order:?}"));
    }
    if let Some(rate) = header.fps
        && !(rate > 0.0 && rate <= 10_000.0)
    {
        return Err(format!("fps is {rate}, allowed 0 to 10000"));
    }
    let metres = match header.unit.as_deref() {
        Some("m") => Some(1.0),
        Some("cm") => Some(0.01),
        Some("mm") => Some(0.001),
        _ => None,
    };
    Ok(LandmarkClip {
        rate: header.fps,
        side: header.hand,
        metres,
        made_by: header.made_by,
        points_per_frame: count,
        frames: Vec::new(),
    })
}

fn parse_frame(text: &str, clip: &LandmarkClip) -> Result<LandmarkFrame, String> {
    if clip.frames.len() == MAX_FRAMES {
        return Err(format!("more than the {MAX_FRAMES} frames allowed"));
    }
    let frame: Frame = serde_json::from_str(text).map_err(|e| json_message(&e))?;
    check_time(frame.t, clip.frames.last())?;
    let points = match frame.points {
        None => [None; 25],
        Some(points) => place(&points, clip.points_per_frame)?,
    };
    let image = match frame.image {
        None => None,
        Some(image) => {
            let flat: Vec<Point> = image.into_iter().map(|p| p.map(|[x, y]| [x, y, 0.0])).collect();
            let placed = place(&flat, clip.points_per_frame).map_err(|what| format!("image: {what}"))?;
            Some(placed.map(|p| p.map(|p| p.xy())))
        }
    };
    Ok(LandmarkFrame { time: frame.t, names: Vec::new(), points, image })
}

/// That a frame comes after the one before.
fn check_time(t: f64, before: Option<&LandmarkFrame>) -> Result<(), String> {
    if !(-1e9..=1e9).contains(&t) {
        return Err(format!("t is {t}, allowed -1e9 to 1e9 s"));
    }
    match before {
        Some(before) if t <= before.time => {
            Err(format!("t is {t} s, not after the {} s of the frame before", before.time))
        }
        _ => Ok(()),
    }
}

/// Points of any layout, checked and put in the order of the 25 joints.
fn place(points: &[Point], count: usize) -> Result<JointPoints, String> {
    if points.len() != count {
        return Err(format!("{} points, expected {count}", points.len()));
    }
    let mut checked = [None; 26];
    for (i, (to, from)) in checked.iter_mut().zip(points).enumerate() {
        let Some(p) = from else { continue };
        if let Some(v) = p.iter().find(|v| !(-MAX_COORDINATE..=MAX_COORDINATE).contains(*v)) {
            return Err(format!("point {i} has coordinate {v}, allowed -1e6 to 1e6"));
        }
        *to = Some(Point3::from(*p));
    }
    Ok(match count {
        21 => from_landmarks_21(&std::array::from_fn(|i| checked[i])),
        // OpenXR's first joint is the middle of the palm, which follows from the others.
        26 => std::array::from_fn(|i| checked[i + 1]),
        _ => std::array::from_fn(|i| checked[i]),
    })
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct WebxrPose {
    #[serde(default)]
    names: Vec<String>,
    handedness: Side,
    joint_positions: Vec<Point>,
}

fn parse_webxr(text: &[u8]) -> Result<LandmarkClip, String> {
    let poses: Vec<WebxrPose> = serde_json::from_slice(text).map_err(|e| e.to_string())?;
    let side = poses.first().ok_or("the array is empty")?.handedness;
    let mut clip = LandmarkClip {
        rate: Some(1.0),
        side: Some(side),
        metres: Some(0.001),
        points_per_frame: 25,
        ..LandmarkClip::default()
    };
    for (i, pose) in poses.into_iter().enumerate() {
        if pose.handedness != side {
            return Err(format!("pose {i}: {} hand among {} ones", pose.handedness.name(), side.name()));
        }
        let points = place(&pose.joint_positions, 25).map_err(|what| format!("pose {i}: {what}"))?;
        clip.frames.push(LandmarkFrame { time: i as f64, names: pose.names, points, image: None });
    }
    Ok(clip)
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::Joint;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn damaged_files_are_refused_or_read_but_never_panic(
            at in 0usize..600,
            byte in any::<u8>(),
            cut in 0usize..600,
        ) {
            let mut bytes = format!("{HEADER}\n{}{}", frame(0.0, 21), frame(1.0, 21)).into_bytes();
            let n = bytes.len();
            bytes[at % n] = byte;
            bytes.truncate(n - cut % n);
            if let Ok(clip) = read_lines(&bytes[..]) {
                prop_assert!(clip.frames.len() <= 2);
            }
            let _ = parse_webxr(&bytes);
        }
    }

    fn lines(text: &str) -> Result<LandmarkClip, (usize, String)> {
        read_lines(text.as_bytes())
    }

    fn frame(t: f64, count: usize) -> String {
        let points: Vec<_> = (0..count).map(|i| format!("[{i},0,0]")).collect();
        format!("{{\"t\":{t},\"points\":[{}]}}\n", points.join(","))
    }

    const HEADER: &str = r#"{"format":"landmarks21","order":"mediapipe","unit":"mm","fps":30,"hand":null}"#;

    #[test]
    fn points_go_to_their_joints() {
        let text = format!("{HEADER}\n{}{{\"t\":1,\"points\":null}}\n", frame(0.0, 21));
        let clip = lines(&text).unwrap();
        assert_eq!((clip.metres, clip.side, clip.rate), (Some(0.001), None, Some(30.0)));
        let x = |joint: Joint| clip.frames[0].points[joint.index()].map(|p| p.x);
        assert_eq!(x(Joint::IndexProximal), Some(5.0));
        assert_eq!(x(Joint::PinkyTip), Some(20.0));
        assert_eq!(x(Joint::IndexMetacarpal), None);
        assert_eq!(clip.frames[1].points, [None; 25]);
        let image = frame(0.0, 21).replace(",0]", "]").replace("points", "image");
        let clip = lines(&format!("{HEADER}\n{image}")).unwrap();
        assert_eq!(clip.frames[0].points, [None; 25]);
        assert_eq!(clip.frames[0].image.unwrap()[Joint::PinkyTip.index()], Some(Point2::new(20.0, 0.0)));
        let openxr = format!("{{\"format\":\"landmarks26\",\"order\":\"openxr\"}}\n{}", frame(0.0, 26));
        let clip = lines(&openxr).unwrap();
        assert_eq!(clip.frames[0].points[Joint::Wrist.index()].map(|p| p.x), Some(1.0));
        assert_eq!(clip.metres, None);
    }

    #[test]
    fn errors_name_line_and_allowance() {
        assert_eq!(lines("").unwrap_err(), (1, "the file is empty".into()));
        let (line, what) = lines("\n{\"format\":\"x\"}").unwrap_err();
        assert_eq!(line, 2);
        assert!(what.contains("landmarks21, landmarks25, landmarks26"));
        let bad = |body: String| lines(&format!("{HEADER}\n{body}")).unwrap_err();
        assert_eq!(bad(frame(0.0, 20)), (2, "20 points, expected 21".into()));
        assert_eq!(bad(frame(1.0, 21) + &frame(1.0, 21)).0, 3);
        assert!(bad("{".into()).1.contains("column"));
        assert_eq!(bad(r#"{"t":0,"image":[[1,2]]}"#.into()), (2, "image: 1 points, expected 21".into()));
        assert!(bad(frame(0.0, 21).replace("[3,", "[3e7,")).1.contains("point 3 has coordinate 30000000"));
    }

    #[test]
    fn webxr_arrays_are_read() {
        let points: Vec<_> = (0..25).map(|i| format!("[{i},0,0]")).collect();
        let pose = |side: &str, n: usize| {
            let points = points[..n].join(",");
            format!("{{\"names\":[\"a\"],\"handedness\":\"{side}\",\"jointPositions\":[{points}]}}")
        };
        let clip = parse_webxr(format!("[{},{}]", pose("left", 25), pose("left", 25)).as_bytes()).unwrap();
        assert_eq!(clip.frames.len(), 2);
        assert_eq!(clip.side, Some(Side::Left));
        assert_eq!(clip.frames[1].names, ["a"]);
        assert!(parse_webxr(b"[]").unwrap_err().contains("empty"));
        let mixed = format!("[{},{}]", pose("left", 25), pose("right", 25));
        assert!(parse_webxr(mixed.as_bytes()).unwrap_err().contains("pose 1: right hand among left ones"));
        let short = format!("[{}]", pose("left", 24));
        assert!(parse_webxr(short.as_bytes()).unwrap_err().contains("24 points, expected 25"));
    }
}
