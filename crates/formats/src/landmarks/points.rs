//! Landmark lines: joint positions of one hand as JSON lines, a header and then one frame a line.
//!
//! ```text
//! {"format":"landmarks21","order":"mediapipe","tips":"inside","unit":"m","fps":30,"hand":"right"}
//! {"t":0.0,"points":[[0.01,-0.2,-0.5],null,…]}
//! {"t":0.0333,"points":null}
//! ```
//!
//! The header may name the [`Axes`] of the points (`"axes":"mediapipe"`). Where it does not they are those of WebXR,
//! unless the frames' pictures show that they point down and away, as MediaPipe's do.
//!
//! `"tips":"inside"` says that tips are where MediaPipe has them, [`TIP_INSIDE`](handcast_hand::landmarks::TIP_INSIDE) of an end bone inside; without it they
//! are the ends of the fingers.
//!
//! `points`, any point in it and any coordinate may be null or, as Python writes it, `NaN`: the point is missing then. Where the source is a picture, a frame may have `"image":[[x,y],null,…]`
//! too, the same points in pixels of the picture, x right, y down. Besides 21 points in `mediapipe` order this reads
//! `landmarks25` in `webxr` order and `landmarks26` in `openxr` order (palm first). Units are `m`, `cm` and `mm`; any
//! other is taken for unknown. Written are 21 points in metres; null are the instants at which the hand was lost.

use std::io::{BufRead, Write};

use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use super::{
    Axes, AxesSource, LandmarkClip, LandmarkFrame, Point, RATE, axes, check_time, documents, null_for_nan,
    place, told_time,
};
use crate::lines::LineReader;
use crate::motion::format::{head, says};
use crate::motion::{
    Content, ContentError, Format, Keeps, Lost, WriteError, WriteOptions, Writer, rounded, sides, skeleton,
};
use crate::poses::json_message;
use handcast_hand::landmarks::mediapipe_21;
use handcast_hand::{Morphology, PoseClip};
use handcast_limits::Limits;

/// Its row.
pub(crate) static FORMAT: Format = Format {
    id: "landmarks",
    name: "joint positions",
    kind: "landmarks",
    ending: ".landmarks.jsonl",
    hands: 1,
    sniff: |bytes| head(bytes).starts_with(b"{") && says(head(bytes), "\"landmarks2"),
    read: |bytes, limits| {
        let clip = parse(bytes, limits).map_err(|(line, what)| ContentError::LandmarkLine { line, what })?;
        Ok(Content::Joints(vec![clip]))
    },
    write: Some(Writer {
        keeps: Keeps { palm: false, ..Keeps::all(Lost::Told) },
        write: |clip, o: &WriteOptions, out| write_landmarks(clip, &o.morphology, out).map(|()| Vec::new()),
    }),
};

/// Most bytes in one line.
pub const MAX_LINE_BYTES: usize = 64 * 1024;
/// The unit that is written.
const METRE: &str = "m";
/// Tips as MediaPipe has them, and at the ends of the fingers.
const TIPS: [&str; 2] = ["inside", "end"];
/// Digits after the point of a coordinate that are written.
const DIGITS: i32 = 7;

/// A set of points.
struct Layout {
    format: &'static str,
    order: &'static str,
    points: usize,
}

/// The layout that is written.
const WRITTEN: Layout = Layout { format: "landmarks21", order: "mediapipe", points: 21 };
/// The layouts that are read.
const LAYOUTS: [Layout; 3] = [
    WRITTEN,
    Layout { format: "landmarks25", order: "webxr", points: 25 },
    Layout { format: "landmarks26", order: "openxr", points: 26 },
];

#[derive(Deserialize)]
struct Header {
    format: Option<String>,
    order: Option<String>,
    unit: Option<String>,
    fps: Option<Value>,
    hand: Option<Value>,
    made_by: Option<String>,
    axes: Option<String>,
    tips: Option<String>,
}

#[derive(Deserialize)]
struct Frame {
    t: Option<f64>,
    points: Option<Vec<Told<3>>>,
    image: Option<Vec<Told<2>>>,
}

/// A point, of which a coordinate may be missing.
type Told<const N: usize> = Option<[Option<f64>; N]>;

/// A point with all of its coordinates.
fn whole<const N: usize>(point: Told<N>) -> Option<[f64; N]> {
    let mut all = [0.0; N];
    all.iter_mut().zip(point?).try_for_each(|(to, from)| from.map(|value| *to = value))?;
    Some(all)
}

/// What a line says, with nothing in place of numbers that are none.
fn told<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    let nulled = |error| match null_for_nan(text.as_bytes()) {
        Some(text) => serde_json::from_slice(&text),
        None => Err(error),
    };
    serde_json::from_str(text).or_else(nulled).map_err(|error| json_message(&error))
}

/// Frames a second, as a number or a text.
fn fps(told: &Value) -> Result<f64, String> {
    let rate = told.as_f64().or_else(|| told.as_str()?.trim().parse().ok());
    rate.filter(|rate| *rate > 0.0 && *rate <= 10_000.0)
        .ok_or_else(|| format!("fps is {told}, allowed above 0 to 10000"))
}

pub(super) fn parse(reader: impl BufRead, limits: &Limits) -> Result<LandmarkClip, (usize, String)> {
    let mut lines = LineReader::new(reader, MAX_LINE_BYTES);
    let mut untimed = false;
    let mut next = |clip: &mut Option<LandmarkClip>| -> Result<bool, (usize, String)> {
        let text = match lines.next_line() {
            Ok(Some(text)) => text,
            Ok(None) => return Ok(false),
            Err(e) => return Err((lines.number(), e.describe(MAX_LINE_BYTES))),
        };
        let result = match clip {
            None => parse_header(text).map(|header| *clip = Some(header)),
            Some(clip) => parse_frame(text, clip, &mut untimed).map(|frame| clip.frames.push(frame)),
        };
        let count = clip.as_ref().map_or(0, |clip| clip.frames.len());
        let checked = || limits.check_frames(count, lines.bytes()).map_err(|excess| excess.to_string());
        result.and_then(|()| checked()).map_err(|what| (lines.number(), what)).map(|()| true)
    };
    let mut clip = None;
    while next(&mut clip)? {}
    let mut clip: LandmarkClip = clip.ok_or((1, "the file is empty".to_owned()))?;
    if clip.axes_from != AxesSource::File
        && let Some(axes) = axes::of_pictures(&clip)
    {
        (clip.axes, clip.axes_from) = (axes, AxesSource::Pictures);
    }
    Ok(clip)
}

fn parse_header(text: &str) -> Result<LandmarkClip, String> {
    let header: Header = told(text)?;
    let format = header.format.as_deref().unwrap_or_default();
    let Some(Layout { order, points, .. }) = LAYOUTS.into_iter().find(|l| l.format == format) else {
        let known = LAYOUTS.map(|l| l.format).join(", ");
        return Err(format!("format is {format:?}, allowed {known}"));
    };
    if let Some(given) = header.order
        && given != order
    {
        return Err(format!("order is {given:?}, {format} has {order:?}"));
    }
    let rate = header.fps.as_ref().map(fps).transpose()?;
    let side = |told: &Value| {
        documents::side(told).ok_or_else(|| format!("hand is {told}, allowed \"left\", \"right\" and null"))
    };
    let side = header.hand.as_ref().map(side).transpose()?;
    if let Some(given) = &header.tips
        && !TIPS.contains(&given.as_str())
    {
        return Err(format!("tips are {given:?}, allowed {}", TIPS.join(", ")));
    }
    let metres = match header.unit.as_deref() {
        Some(METRE) => Some(1.0),
        Some("cm") => Some(0.01),
        Some("mm") => Some(0.001),
        _ => None,
    };
    let axes =
        match header.axes.as_deref() {
            None => None,
            Some(name) => Some(Axes::from_name(name).ok_or_else(|| {
                format!("axes are {name:?}, allowed {}", Axes::ALL.map(Axes::name).join(", "))
            })?),
        };
    Ok(LandmarkClip {
        rate,
        side,
        metres,
        made_by: header.made_by,
        points_per_frame: points,
        tips_inside: header.tips.as_deref() == Some(TIPS[0]),
        axes: axes.unwrap_or_default(),
        axes_from: axes.map_or(AxesSource::Format, |_| AxesSource::File),
        ..LandmarkClip::default()
    })
}

fn parse_frame(text: &str, clip: &mut LandmarkClip, untimed: &mut bool) -> Result<LandmarkFrame, String> {
    let frame: Frame = told(text)?;
    let t = time(frame.t, clip, untimed)?;
    check_time(t, clip.frames.last())?;
    let points = match frame.points {
        None => [None; 25],
        Some(points) => {
            let points: Vec<Point> = points.into_iter().map(whole).collect();
            place(&points, clip.points_per_frame)?
        }
    };
    let image = match frame.image {
        None => None,
        Some(image) => {
            let flat: Vec<Point> = image.into_iter().map(|p| whole(p).map(|[x, y]| [x, y, 0.0])).collect();
            let placed = place(&flat, clip.points_per_frame).map_err(|what| format!("image: {what}"))?;
            Some(placed.map(|p| p.map(|p| p.xy())))
        }
    };
    Ok(LandmarkFrame { image, ..LandmarkFrame::of(t, points) })
}

/// The time of the next frame, from its number where no frame tells one.
fn time(told: Option<f64>, clip: &mut LandmarkClip, untimed: &mut bool) -> Result<f64, String> {
    let number = clip.frames.len();
    if let Some(time) = told_time(told, number == 0, untimed, "t")? {
        return Ok(time);
    }
    clip.rate_assumed |= clip.rate.is_none();
    Ok(number as f64 / *clip.rate.get_or_insert(RATE))
}

/// Writes 21 landmarks of the one hand that a clip has; hands of unknown sizes get those of `fallback`.
///
/// # Errors
/// [`WriteError::Empty`], [`WriteError::TwoHands`], [`WriteError::Io`].
pub fn write_landmarks(
    clip: &PoseClip,
    fallback: &Morphology,
    mut out: impl Write,
) -> Result<(), WriteError> {
    let side = match sides(clip).as_slice() {
        [] => return Err(WriteError::Empty),
        [side] => *side,
        _ => return Err(WriteError::TwoHands { format: "landmarks" }),
    };
    let skeleton = skeleton(clip, side, fallback);
    let header = json!({
        "format": WRITTEN.format,
        "order": WRITTEN.order,
        "tips": TIPS[0],
        "unit": METRE,
        "fps": clip.header.rate,
        "hand": side.name(),
        "made_by": clip.header.made_by,
    });
    writeln!(out, "{header}")?;
    for frame in clip.of(side) {
        let points = frame.valid.then(|| {
            let frames = skeleton.frames(&frame.pose);
            mediapipe_21(|joint| frames.position(joint)).map(|p| p.coords.map(|v| rounded(v, DIGITS)))
        });
        let points = points.map(|p| p.map(<[f64; 3]>::from).to_vec());
        writeln!(out, "{}", json!({ "t": frame.time, "points": points }))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::tests::two_hands;
    use handcast_hand::{Joint, Side};
    use nalgebra::Point2;
    use proptest::prelude::*;

    fn parse(text: &[u8]) -> Result<LandmarkClip, (usize, String)> {
        super::parse(text, &Limits::default())
    }

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
            if let Ok(clip) = parse(&bytes[..]) {
                prop_assert!(clip.frames.len() <= 2);
            }
        }
    }

    fn lines(text: &str) -> Result<LandmarkClip, (usize, String)> {
        parse(text.as_bytes())
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
    fn axes_are_told_by_the_header_or_by_the_pictures() {
        let clip = |header: &str, up: f64| {
            let numbers = |y: f64| -> Vec<String> {
                (0..21).map(|i| format!("[{},{}", i % 5, y * f64::from(i / 5))).collect()
            };
            let points = numbers(up).join(",0],") + ",0]";
            let image = numbers(100.0).join("],") + "]";
            lines(&format!("{header}\n{{\"t\":0,\"points\":[{points}],\"image\":[{image}]}}\n")).unwrap()
        };
        let named = HEADER.replace("\"unit\"", "\"axes\":\"unity\",\"unit\"");
        for (header, up, axes, from) in [
            (HEADER, 0.1, Axes::Mediapipe, AxesSource::Pictures),
            (HEADER, -0.1, Axes::Webxr, AxesSource::Format),
            (&named, 0.1, Axes::Unity, AxesSource::File),
        ] {
            let clip = clip(header, up);
            assert_eq!((clip.axes, clip.axes_from), (axes, from), "{header}");
        }
        let (_, what) = lines(&named.replace("unity", "up")).unwrap_err();
        assert!(what.contains("axes are \"up\", allowed webxr, mediapipe, unity, z-up"), "{what}");
    }

    #[test]
    fn lines_without_times_go_by_the_rate() {
        let bare = frame(0.0, 21).replace("\"t\":0,", "");
        let clip = lines(&format!("{HEADER}\n{bare}{{\"points\":null}}\n{bare}")).unwrap();
        assert_eq!((clip.frames[2].time, clip.rate_assumed), (2.0 / 30.0, false));
        let clip = lines(&format!("{}\n{bare}{bare}", HEADER.replace("\"fps\":30,", ""))).unwrap();
        assert!(clip.rate_assumed && clip.rate_notice().unwrap().contains("30 frames a second"));
        assert_eq!(clip.at_rate(60.0).frames[1].time, 1.0 / 60.0);
        for (first, second) in [(&bare, &frame(1.0, 21)), (&frame(1.0, 21), &bare)] {
            let (line, what) = lines(&format!("{HEADER}\n{first}{second}")).unwrap_err();
            assert!(line == 3 && what.contains("which the frames before"), "{what}");
        }
    }

    #[test]
    fn what_other_programs_write_is_understood() {
        let header = |hand: &str, fps: &str| {
            let text = HEADER.replace("\"hand\":null", hand).replace("\"fps\":30", fps);
            lines(&text).map(|clip| (clip.side, clip.rate)).map_err(|(_, what)| what)
        };
        assert_eq!(header("\"hand\":\"Right\"", "\"fps\":\"29.97\""), Ok((Some(Side::Right), Some(29.97))));
        assert_eq!(header("\"hand\":\"L\"", "\"fps\":NaN"), Ok((Some(Side::Left), None)));
        assert!(header("\"hand\":\"both\"", "\"fps\":1").unwrap_err().contains("hand is \"both\", allowed"));
        for fps in ["0", "1e5", "\"fast\""] {
            let what = header("\"hand\":null", &format!("\"fps\":{fps}")).unwrap_err();
            assert!(what.contains("allowed above 0 to 10000"), "{what}");
        }
        let holes = frame(0.0, 21)
            .replace("[3,0,0]", "[NaN,NaN,NaN]")
            .replace("[4,0,0]", "[4,Infinity,0]")
            .replace("[5,0,0]", "[5,0,null]")
            .replace("[6,0,0]", "null");
        let image = frame(1.0, 21).replace(",0]", "]").replace("points", "image").replace("[7,0]", "[NaN,0]");
        let clip = lines(&format!("{HEADER}\n{holes}{image}{{\"t\":2,\"points\":NaN}}\n")).unwrap();
        assert_eq!(clip.frames[0].points.iter().flatten().count(), 17);
        assert_eq!(clip.frames[1].image.unwrap().iter().flatten().count(), 20);
        assert_eq!(clip.frames[2].points, [None; 25]);
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
    fn one_hand_is_written_and_lost_frames_have_no_points() {
        let mut clip = two_hands();
        let refused = write_landmarks(&clip, &Morphology::default(), Vec::new()).unwrap_err().to_string();
        assert!(refused.contains("one hand"), "{refused}");
        clip.frames.retain(|f| f.pose.side == Side::Left);
        clip.frames[4].valid = false;
        let mut text = Vec::new();
        write_landmarks(&clip, &Morphology::default(), &mut text).unwrap();
        let text = String::from_utf8(text).unwrap();
        assert_eq!(text.lines().count(), 41);
        assert!(text.lines().nth(5).unwrap().contains("\"points\":null"));
        let back = lines(&text).unwrap();
        assert_eq!((back.side, back.metres, back.rate), (Some(Side::Left), Some(1.0), Some(25.0)));
        assert_eq!(back.frames[4].points, [None; 25]);
    }
}
