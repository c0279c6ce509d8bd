//! Poses as one JSON document: the header of [`crate::poses`] with all of its lines in a list `frames`.
//!
//! ```text
//! {"format":"handcast-poses","version":1,"rate":30.0,"hands":[{"side":"right"}],"frames":[
//!  {"t":0.0333,"hand":"right","wrist":{"translation":[x,y,z],"rotation":[x,y,z,w]},"angles":{"index1_flexion":12.3}},
//!  …]}
//! ```
//!
//! Joint angles are degrees by name; those left out are zero.

use std::io::Write;

use serde::Deserialize;
use serde::de::IgnoredAny;
use serde_json::{Map, Value};

use super::format::{head, says};
use super::{ContentError, Format, Motion, WriteError, WriteOptions};
use crate::poses::{self, FrameLine, HeaderLine, PoseWriter, PosesError, Tag, is_lines};
use handcast_hand::clip::MAX_FRAMES;
use handcast_hand::{FrameCheck, PoseClip, TimedPose};

/// Its row.
pub(crate) static FORMAT: Format = Format {
    id: "json",
    name: "poses",
    kind: "poses",
    ending: ".json",
    hands: 2,
    sniff: |bytes| head(bytes).starts_with(b"{") && says(head(bytes), poses::NAME) && !is_lines(bytes),
    read: |bytes| Ok(Motion::of(&FORMAT, read_json(bytes)?)),
    write: Some(|clip, _: &WriteOptions, out| write_json(clip, out).map(|()| Vec::new())),
};

#[derive(Deserialize)]
struct Frames<T> {
    frames: Option<T>,
}

/// Reads a document.
///
/// # Errors
/// [`ContentError::Json`], [`ContentError::NoFrames`], [`ContentError::Poses`].
pub fn read_json(bytes: &[u8]) -> Result<PoseClip, ContentError> {
    if serde_json::from_slice::<Frames<IgnoredAny>>(bytes)?.frames.is_none() {
        return Err(ContentError::NoFrames);
    }
    let wrong = |what: String| PosesError::Line { line: 1, what };
    serde_json::from_slice::<Tag>(bytes)?.check().map_err(wrong)?;
    let header = serde_json::from_slice::<HeaderLine>(bytes)?.header().map_err(|e| wrong(e.to_string()))?;
    let frames = serde_json::from_slice::<Frames<Vec<FrameLine>>>(bytes)?.frames.unwrap_or_default();
    if frames.len() > MAX_FRAMES {
        return Err(PosesError::TooManyFrames.into());
    }
    let clip = PoseClip { header, frames: frames.into_iter().map(TimedPose::from).collect() };
    let mut check = FrameCheck::default();
    for (i, frame) in clip.frames.iter().enumerate() {
        let checked = check.check(&clip.header, frame);
        checked.map_err(|e| PosesError::Frame { frame: i, what: e.to_string() })?;
    }
    Ok(clip)
}

/// Writes a document, which is one line.
///
/// # Errors
/// [`WriteError::Poses`], [`WriteError::Json`], [`WriteError::Io`].
pub fn write_json(clip: &PoseClip, mut out: impl Write) -> Result<(), WriteError> {
    let mut lines = PoseWriter::new(Vec::new(), clip.header.clone())?;
    let mut document: Map<String, Value> = serde_json::from_slice(&lines.take())?;
    document.insert("frames".into(), Value::Null);
    let mut before = "{";
    for (name, value) in &document {
        write!(out, "{before}{}:", Value::from(name.as_str()))?;
        match name.as_str() {
            "frames" => write_frames(clip, &mut lines, &mut out)?,
            _ => serde_json::to_writer(&mut out, value)?,
        }
        before = ",";
    }
    Ok(out.write_all(b"}\n")?)
}

/// The list of poses, each with what its line has.
fn write_frames(
    clip: &PoseClip,
    lines: &mut PoseWriter<Vec<u8>>,
    out: &mut impl Write,
) -> Result<(), WriteError> {
    let mut before: &[u8] = b"[";
    for frame in &clip.frames {
        lines.write(frame)?;
        out.write_all(before)?;
        serde_json::to_writer(&mut *out, &serde_json::from_slice::<Value>(&lines.take())?)?;
        before = b",";
    }
    Ok(out.write_all(if clip.frames.is_empty() { b"[]" } else { b"]" })?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::tests::{clip, worst};
    use handcast_hand::Side;

    #[test]
    fn both_hands_round_trip_as_precisely_as_lines() {
        let both = clip(&[Side::Left, Side::Right]);
        let mut text = Vec::new();
        write_json(&both, &mut text).unwrap();
        let back = read_json(&text).unwrap();
        assert_eq!(back.header, both.header);
        assert!(worst(&both, &back) < 1e-7);
        // However it is laid out.
        let document: Value = serde_json::from_slice(&text).unwrap();
        let pretty = serde_json::to_string_pretty(&document).unwrap();
        assert_eq!(read_json(pretty.as_bytes()).unwrap(), back);
    }

    #[test]
    fn what_is_wrong_is_named_by_line_or_frame() {
        let document = |frames: &str| {
            let header = r#"{"format":"handcast-poses","version":1,"hands":[{"side":"right"}]"#;
            read_json(format!("{header},\n\"frames\":[\n{frames}]}}").as_bytes()).unwrap_err().to_string()
        };
        let frame = r#"{"t":0,"hand":"right"}"#;
        for (text, words) in [
            (document("{]"), "line 3"),
            (document(r#"{"hand":"right"}"#), "missing field `t`"),
            (document(r#"{"t":0,"hand":"left"}"#), "frame 0: the left hand is not named"),
            (document(&format!("{frame},\n{frame}")), "frame 1: t is 0 s, not after 0 s"),
            (read_json(b"{\"version\":1}").unwrap_err().to_string(), "no list \"frames\""),
            (read_json(b"{\"frames\":[]}").unwrap_err().to_string(), "format is \"\""),
        ] {
            assert!(text.contains(words), "{text}");
        }
    }
}
