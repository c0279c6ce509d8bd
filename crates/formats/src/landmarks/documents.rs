//! Documents of JSON with one frame after another, of which one at a time is held as a tree.

use std::fmt::{self, Formatter};

use serde::de::{DeserializeSeed, Deserializer, MapAccess, SeqAccess, Visitor};
use serde_json::{Map, Number, Value};

use crate::poses::json_message;
use handcast_hand::Side;

/// Most values in a frame, and in all that is no frame.
const MOST_VALUES: usize = 1 << 16;
/// Characters of a text that count as one value.
const TEXT: usize = 32;
/// The list of frames in an object.
const FRAMES: [&str; 2] = ["frames", "data"];

/// What is done with each frame, given what the document said before it.
pub(super) type EachFrame<'a> = dyn FnMut(&Map<String, Value>, Value) -> Result<(), String> + 'a;

/// Gives the frames of a text one by one: the elements of a list, of the list `frames` or `data` of an object, or objects
/// one after the other (JSON lines). What stands beside such a list goes to every frame behind it.
///
/// # Errors
/// What is no JSON, larger than [`MOST_VALUES`] a frame, and what `each` says, behind the frame's number.
pub(super) fn each_frame(text: &[u8], each: &mut EachFrame) -> Result<(), String> {
    let mut sink = Sink { each, count: 0, header: Map::new(), room: MOST_VALUES, error: None };
    let mut input = serde_json::Deserializer::from_slice(text);
    loop {
        let done = match Top(&mut sink).deserialize(&mut input) {
            Ok(()) => input.end().is_ok(),
            Err(error) => {
                let wrong = format!("line {}: {}", error.line(), json_message(&error));
                return Err(sink.error.unwrap_or(wrong));
            }
        };
        if done {
            return Ok(());
        }
    }
}

struct Sink<'a, 'b> {
    each: &'a mut EachFrame<'b>,
    count: usize,
    header: Map<String, Value>,
    /// How many values the header may still have.
    room: usize,
    error: Option<String>,
}

impl Sink<'_, '_> {
    fn take<E: serde::de::Error>(&mut self, frame: Value) -> Result<(), E> {
        let taken = (self.each)(&self.header, frame);
        self.count += 1;
        taken.map_err(|what| {
            self.error = Some(format!("frame {}: {what}", self.count - 1));
            E::custom("a frame")
        })
    }
}

/// A document.
struct Top<'a, 'b, 'c>(&'a mut Sink<'b, 'c>);

impl<'de> DeserializeSeed<'de> for Top<'_, '_, '_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Top<'_, '_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut Formatter) -> fmt::Result {
        f.write_str("an object or a list of frames")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<(), A::Error> {
        loop {
            let mut room = MOST_VALUES;
            match list.next_element_seed(Tree(&mut room))? {
                Some(frame) => self.0.take(frame)?,
                None => return Ok(()),
            }
        }
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        let (mut whole, mut room, mut listed) = (Map::new(), MOST_VALUES, false);
        while let Some(name) = map.next_key::<String>()? {
            if FRAMES.contains(&name.as_str()) {
                listed = true;
                self.0.header.append(&mut whole);
                map.next_value_seed(Top(&mut *self.0))?;
            } else if listed {
                let value = map.next_value_seed(Tree(&mut self.0.room))?;
                self.0.header.insert(name, value);
            } else {
                let value = map.next_value_seed(Tree(&mut room))?;
                whole.insert(name, value);
            }
        }
        if listed { Ok(()) } else { self.0.take(Value::Object(whole)) }
    }
}

/// A tree of so many values at most.
struct Tree<'a>(&'a mut usize);

impl Tree<'_> {
    fn count<E: serde::de::Error>(&mut self, values: usize) -> Result<(), E> {
        match self.0.checked_sub(values) {
            Some(left) => {
                *self.0 = left;
                Ok(())
            }
            None => Err(E::custom(format!("more than the {MOST_VALUES} values allowed in a frame"))),
        }
    }
}

impl<'de> DeserializeSeed<'de> for Tree<'_> {
    type Value = Value;

    fn deserialize<D: Deserializer<'de>>(mut self, deserializer: D) -> Result<Value, D::Error> {
        self.count(1)?;
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Tree<'_> {
    type Value = Value;

    fn expecting(&self, f: &mut Formatter) -> fmt::Result {
        f.write_str("a value")
    }

    fn visit_bool<E>(self, v: bool) -> Result<Value, E> {
        Ok(Value::Bool(v))
    }

    fn visit_i64<E>(self, v: i64) -> Result<Value, E> {
        Ok(v.into())
    }

    fn visit_u64<E>(self, v: u64) -> Result<Value, E> {
        Ok(v.into())
    }

    fn visit_f64<E>(self, v: f64) -> Result<Value, E> {
        Ok(Number::from_f64(v).map_or(Value::Null, Value::Number))
    }

    fn visit_str<E: serde::de::Error>(mut self, v: &str) -> Result<Value, E> {
        self.count(v.len() / TEXT)?;
        Ok(v.into())
    }

    fn visit_unit<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Value, A::Error> {
        let mut out = Vec::new();
        while let Some(value) = list.next_element_seed(Tree(&mut *self.0))? {
            out.push(value);
        }
        Ok(Value::Array(out))
    }

    fn visit_map<A: MapAccess<'de>>(mut self, mut map: A) -> Result<Value, A::Error> {
        let mut out = Map::new();
        while let Some(name) = map.next_key::<String>()? {
            self.count(1 + name.len() / TEXT)?;
            out.insert(name, map.next_value_seed(Tree(&mut *self.0))?);
        }
        Ok(Value::Object(out))
    }
}

/// A name in lower case, letters and digits alone: programs write `PrevJoint`, `prev_joint` and `prevJoint`.
fn plain(name: &str) -> impl Iterator<Item = char> + '_ {
    name.chars().filter(char::is_ascii_alphanumeric).map(|c| c.to_ascii_lowercase())
}

/// The value of the first of these names, each in lower case, letters and digits alone, that an object has.
pub(super) fn get<'a>(value: &'a Value, names: &[&str]) -> Option<&'a Value> {
    get_in(value.as_object()?, names)
}

/// As [`get`].
pub(super) fn get_in<'a>(map: &'a Map<String, Value>, names: &[&str]) -> Option<&'a Value> {
    let of = |name: &str| map.iter().find(|(key, value)| !value.is_null() && plain(key).eq(name.chars()));
    names.iter().find_map(|name| of(name)).map(|(_, value)| value)
}

/// The first coordinates of a list, or `x`, `y` and `z` of an object.
pub(super) fn point(value: &Value) -> Option<[f64; 3]> {
    match value {
        Value::Array(list) => match list.as_slice() {
            [x, y, z, ..] => Some([x.as_f64()?, y.as_f64()?, z.as_f64()?]),
            _ => None,
        },
        object => {
            let of = |name| get(object, &[name])?.as_f64();
            Some([of("x")?, of("y")?, of("z")?])
        }
    }
}

/// Left or right, as words, letters or whether it is the right or the left one say.
pub(super) fn side(value: &Value) -> Option<Side> {
    side_named(value.as_str()?)
}

/// As [`side`], of a text.
pub(crate) fn side_named(text: &str) -> Option<Side> {
    let text = text.to_ascii_lowercase();
    match text.rsplit(['_', '.', ' ']).next()? {
        "left" | "l" | "lh" => Some(Side::Left),
        "right" | "r" | "rh" => Some(Side::Right),
        _ => None,
    }
}

/// A time stamp of a frame: seconds in its unit where its name tells that.
pub(super) fn stamp(frame: &Value) -> Option<(f64, Option<f64>)> {
    let named = |names: &[&str], unit| Some((get(frame, names)?.as_f64()?, unit));
    named(&["t", "times", "seconds", "timesec"], Some(1.0))
        .or_else(|| named(&["timestampms", "timems", "milliseconds"], Some(1e-3)))
        .or_else(|| named(&["timestampus", "timeus"], Some(1e-6)))
        .or_else(|| named(&["timestampns", "timens", "xrtime"], Some(1e-9)))
        .or_else(|| named(&["time", "timestamp"], None))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(text: &str) -> Result<Vec<String>, String> {
        let mut out = Vec::new();
        each_frame(text.as_bytes(), &mut |header, frame| {
            out.push(format!("{} {frame}", Value::Object(header.clone())));
            if frame == "wrong" { Err("no frame".into()) } else { Ok(()) }
        })?;
        Ok(out)
    }

    #[test]
    fn frames_are_given_one_by_one() {
        assert_eq!(frames("[1, [2], {\"a\": null}]").unwrap(), ["{} 1", "{} [2]", "{} {\"a\":null}"]);
        assert_eq!(frames("{\"a\": 1}\n{\"b\": true}\n").unwrap(), ["{} {\"a\":1}", "{} {\"b\":true}"]);
        let document = "{\"fps\": 30, \"frames\": [0.5, \"x\"], \"end\": -1}";
        assert_eq!(frames(document).unwrap(), ["{\"fps\":30} 0.5", "{\"fps\":30} \"x\""]);
    }

    #[test]
    fn what_is_wrong_is_told_with_its_place() {
        assert_eq!(frames("[1, \"wrong\"]").unwrap_err(), "frame 1: no frame");
        assert!(frames("[1,\n 2").unwrap_err().starts_with("line 2: "));
        assert!(frames("").unwrap_err().starts_with("line 1: "));
        let large = format!("[[{}0]]", "0,".repeat(MOST_VALUES));
        assert!(frames(&large).unwrap_err().contains("65536 values allowed"));
        let text = format!("[\"{}\"]", "x".repeat(TEXT * MOST_VALUES + TEXT));
        assert!(frames(&text).unwrap_err().contains("65536 values allowed"));
    }
}
