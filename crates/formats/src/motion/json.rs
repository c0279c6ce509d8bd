//! Poses as one JSON document: the header of [`crate::poses`] with all of its lines in a list `frames`.
//!
//! ```text
//! {"format":"handcast-poses","version":1,"rate":30.0,"hands":[{"side":"right"}],"frames":[
//!  {"t":0.0333,"hand":"right","wrist":{"translation":[x,y,z],"rotation":[x,y,z,w]},"angles":{"index1_flexion":12.3}},
//!  …]}
//! ```
//!
//! Joint angles are degrees by name; those left out are zero.

use std::fmt::{self, Formatter};
use std::io::Write;

use serde::de::{IgnoredAny, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use serde_json::{Map, Value};

use super::format::{head, names_any, says};
use super::{ContentError, Format, Keeps, Lost, Motion, WriteError, WriteOptions, Writer};
use crate::batches::write_each;
use crate::poses::{
    self, DocumentHead, FrameLine, PoseWriter, PosesError, check_frames, is_lines, push_frame,
};
use handcast_hand::{FrameCheck, PoseClip};
use handcast_limits::{Limit, Limits};

/// Its row.
pub(crate) static FORMAT: Format = Format {
    id: "json",
    name: "poses",
    kind: "poses",
    ending: ".json",
    hands: 2,
    sniff: |bytes| {
        let named = says(head(bytes), poses::NAME);
        head(bytes).starts_with(b"{") && (named && !is_lines(bytes) || !named && has_our_frames(bytes))
    },
    read: |bytes, limits| Ok(Motion::of(&FORMAT, read_within(bytes, limits)?).into()),
    write: Some(Writer {
        keeps: Keeps::all(Lost::Told),
        write: |clip, _: &WriteOptions, out| write_json(clip, out).map(|()| Vec::new()),
    }),
};

/// Whether this is a document whose frames come before its name.
fn has_our_frames(bytes: &[u8]) -> bool {
    says(head(bytes), "\"frames\"") && ["wrist", "translation"].iter().all(|name| names_any(bytes, &[name]))
}

/// The frames of a document, with all that is in them or none.
#[derive(Deserialize)]
struct Frames<T> {
    frames: Option<T>,
}

/// The length of a list.
#[derive(Default)]
struct Count(usize);

impl<'de> Deserialize<'de> for Count {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(Counter)
    }
}

struct Counter;

impl<'de> Visitor<'de> for Counter {
    type Value = Count;

    fn expecting(&self, f: &mut Formatter) -> fmt::Result {
        f.write_str("a sequence")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Count, A::Error> {
        let mut count = 0;
        while list.next_element::<IgnoredAny>()?.is_some() {
            count += 1;
        }
        Ok(Count(count))
    }
}

/// Reads a document.
///
/// # Errors
/// [`ContentError::Json`], [`ContentError::NoFrames`], [`ContentError::UnknownJson`], [`ContentError::Poses`].
pub fn read_json(bytes: &[u8]) -> Result<PoseClip, ContentError> {
    read_within(bytes, &Limits::default())
}

fn read_within(bytes: &[u8], limits: &Limits) -> Result<PoseClip, ContentError> {
    let is_ours = says(head(bytes), poses::NAME);
    // A document without a name comes here by that of its file.
    if !is_ours && head(bytes).starts_with(b"[") {
        return Err(ContentError::UnknownJson);
    }
    let document = serde_json::from_slice::<DocumentHead>(bytes)?;
    if !document.has_frames() {
        return Err(if is_ours { ContentError::NoFrames } else { ContentError::UnknownJson });
    }
    let header = document.header().map_err(|what| PosesError::Line { line: 1, what })?;
    // Counted before poses are made of them.
    let count = serde_json::from_slice::<Frames<Count>>(bytes)?.frames.unwrap_or_default();
    limits.check_count(Limit::Instants, count.0 / header.hands.len().max(1))?;
    let frames = serde_json::from_slice::<Frames<Vec<FrameLine>>>(bytes)?.frames.unwrap_or_default();
    let clip = PoseClip { header, frames: frames.into_iter().map(|FrameLine(frame)| frame).collect() };
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
    let header = PoseWriter::new(Vec::new(), clip.header.clone())?.finish()?;
    let mut document: Map<String, Value> = serde_json::from_slice(&header)?;
    check_frames(clip)?;
    document.insert("frames".into(), Value::Null);
    let mut before = "{";
    for (name, value) in &document {
        write!(out, "{before}{}:", Value::from(name.as_str()))?;
        match name.as_str() {
            "frames" => write_frames(clip, &mut out)?,
            _ => serde_json::to_writer(&mut out, value)?,
        }
        before = ",";
    }
    Ok(out.write_all(b"}\n")?)
}

/// The list of poses, each with what its line has.
fn write_frames(clip: &PoseClip, out: &mut impl Write) -> Result<(), WriteError> {
    out.write_all(b"[")?;
    write_each(&clip.frames, out, |text, number, frame| {
        text.extend_from_slice(if number == 0 { b"" } else { b"," });
        push_frame(text, frame);
    })?;
    Ok(out.write_all(b"]")?)
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
        let mut document: Value = serde_json::from_slice(&text).unwrap();
        let pretty = serde_json::to_string_pretty(&document).unwrap();
        assert_eq!(read_json(pretty.as_bytes()).unwrap(), back);
        let frames = document.as_object_mut().unwrap().remove("frames").unwrap();
        let late = format!("{{\"frames\":{frames},{}", &document.to_string()[1..]);
        assert_eq!(Format::sniffed(late.as_bytes()), Some(&FORMAT));
        assert_eq!(read_json(late.as_bytes()).unwrap(), back);
    }

    #[test]
    fn what_is_wrong_is_named_by_line_or_frame() {
        let document = |frames: &str| {
            let header = r#"{"format":"handcast-poses","version":1,"hands":[{"side":"right"}]"#;
            read_json(format!("{header},\n\"frames\":[\n{frames}]}}").as_bytes()).unwrap_err().to_string()
        };
        let frame = r#"{"t":0,"hand":"right","wrist":{"translation":[0,0,0],"rotation":[0,0,0,1]}}"#;
        for (text, words) in [
            (document("{]"), "line 3"),
            (document(r#"{"hand":"right"}"#), "missing field `t`"),
            (document(r#"{"t":0,"hand":"right"}"#), "missing field `wrist`"),
            (document(&frame.replace("right", "left")), "frame 0: the left hand is not named"),
            (document(&format!("{frame},\n{frame}")), "frame 1: t is 0 s, not after 0 s"),
            (read_json(b"{\"version\":1}").unwrap_err().to_string(), "poses have a list \"frames\""),
            (read_json(b"{\"frames\":[]}").unwrap_err().to_string(), "format is \"\""),
        ] {
            assert!(text.contains(words), "{text}");
        }
    }
}
