//! What a file of JSON or of arrays names, as far as it is known: arrays under the names of [`Name`].

use std::cell::Cell;
use std::fmt::{self, Formatter};

use serde::Deserializer;
use serde::de::{DeserializeSeed, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};

use super::super::npz::{self, Array};
use crate::poses::json_message;
use handcast_hand::Side;
use handcast_limits::Limits;

/// What a name stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Name {
    Pose,
    LeftPose,
    RightPose,
    Wrist,
    Moved,
    Joints,
    Right,
    Left,
    Side,
    Rate,
    Time,
    Frame,
    Mean,
    Flat,
    /// What holds further names of the same hand.
    Inner,
    /// The hands of one frame.
    Hands,
    /// One frame after another.
    Frames,
}

/// The names that are known; of several of one meaning in an object the first here is taken.
const KNOWN: [(&str, Name); 65] = [
    ("hand_pose", Name::Pose),
    ("mano_hand_pose", Name::Pose),
    ("mano_pose", Name::Pose),
    ("handPose", Name::Pose),
    ("pose", Name::Pose),
    ("poses", Name::Pose),
    ("theta", Name::Pose),
    ("thetas", Name::Pose),
    ("pose_hand", Name::Pose),
    ("left_hand_pose", Name::LeftPose),
    ("right_hand_pose", Name::RightPose),
    ("global_orient", Name::Wrist),
    ("root_orient", Name::Wrist),
    ("root_pose", Name::Wrist),
    ("mano_rot", Name::Wrist),
    ("rot", Name::Wrist),
    ("pred_cam_t_full", Name::Moved),
    ("cam_t_full", Name::Moved),
    ("cam_t", Name::Moved),
    ("transl", Name::Moved),
    ("trans", Name::Moved),
    ("translation", Name::Moved),
    ("handTrans", Name::Moved),
    ("pred_keypoints_3d", Name::Joints),
    ("keypoints_3d", Name::Joints),
    ("joints_3d", Name::Joints),
    ("joints3d", Name::Joints),
    ("joint_3d", Name::Joints),
    ("handJoints3D", Name::Joints),
    ("hand_joints", Name::Joints),
    ("joints", Name::Joints),
    ("is_right", Name::Right),
    ("right", Name::Right),
    ("left", Name::Left),
    ("side", Name::Side),
    ("hand_side", Name::Side),
    ("mano_side", Name::Side),
    ("handedness", Name::Side),
    ("hand", Name::Side),
    ("fps", Name::Rate),
    ("mocap_framerate", Name::Rate),
    ("mocap_frame_rate", Name::Rate),
    ("frame_rate", Name::Rate),
    ("t", Name::Time),
    ("time", Name::Time),
    ("times", Name::Time),
    ("timestamp", Name::Time),
    ("timestamps", Name::Time),
    ("timestamp_ms", Name::Time),
    ("frame", Name::Frame),
    ("frame_id", Name::Frame),
    ("frame_index", Name::Frame),
    ("hands_mean", Name::Mean),
    ("hand_mean", Name::Mean),
    ("pose_mean", Name::Mean),
    ("flat_hand_mean", Name::Flat),
    ("pred_mano_params", Name::Inner),
    ("mano_params", Name::Inner),
    ("mano", Name::Inner),
    ("params", Name::Inner),
    ("wilor_preds", Name::Inner),
    ("hands", Name::Hands),
    ("predictions", Name::Hands),
    ("frames", Name::Frames),
    ("results", Name::Frames),
];

fn known(name: &str) -> Option<usize> {
    KNOWN.iter().position(|(known, _)| *known == name)
}

/// A value of JSON.
enum Item {
    Array(Array),
    List(Vec<Item>),
    Object(Object),
    Nothing,
}

/// What an object names: values with the number of their name among [`KNOWN`], and values whose names are numbers.
#[derive(Default)]
struct Object {
    named: Vec<(usize, Item)>,
    numbered: Vec<(u64, Item)>,
}

/// The arrays of a hand by their names.
#[derive(Clone, Debug, Default)]
pub(super) struct Fields {
    arrays: Vec<(usize, Array)>,
    side: Option<Side>,
}

impl Fields {
    pub(super) fn get(&self, name: Name) -> Option<&Array> {
        let of_name = self.arrays.iter().filter(|(known, _)| KNOWN[*known].1 == name);
        of_name.min_by_key(|(known, _)| *known).map(|(_, array)| array)
    }

    fn says_a_hand(&self) -> bool {
        [Name::Pose, Name::LeftPose, Name::RightPose, Name::Joints]
            .into_iter()
            .any(|name| self.get(name).is_some())
    }

    /// The side that a word tells.
    pub(super) fn side(&self) -> Result<Option<Side>, String> {
        let Some(word) = self.get(Name::Side).and_then(|a| a.texts.first()) else { return Ok(self.side) };
        match word.to_ascii_lowercase().as_str() {
            "left" | "l" => Ok(Some(Side::Left)),
            "right" | "r" => Ok(Some(Side::Right)),
            _ => Err(format!("the side is {word:.20?}, allowed left or right")),
        }
    }
}

/// What a file says.
#[derive(Default)]
pub(super) struct Found {
    pub(super) rate: Option<f64>,
    pub(super) mean: Option<Array>,
    pub(super) flat: Option<bool>,
    /// Each hand with the number of its frame, where it stands in a list.
    pub(super) rows: Vec<(Option<usize>, Fields)>,
    /// Frames without a hand: the number of each, and what it says of its time.
    pub(super) empty: Vec<(usize, Fields)>,
    /// What the latest object without a hand says.
    bare: Option<Fields>,
}

/// Where in a file something stands.
#[derive(Clone, Copy, Default)]
struct Place {
    number: Option<usize>,
    side: Option<Side>,
}

/// Values of objects, texts, and what lists hold besides numbers, that any file may have, and the bytes of a larger one
/// that each must be worth.
const MOST_PARTS: usize = 1 << 16;
const PART_BYTES: usize = 40;
/// Numbers for what is missing that count as such a value.
const NUMBERS: usize = 16;

/// What a document of JSON says, or several one after the other.
pub(super) fn json(text: &[u8], limits: &Limits) -> Result<Found, String> {
    let room = Cell::new(MOST_PARTS.max(text.len() / PART_BYTES));
    let mut input = serde_json::Deserializer::from_slice(text);
    let mut documents = Vec::new();
    loop {
        let item = ItemSeed(&room).deserialize(&mut input);
        documents.push(item.map_err(|e| format!("line {}: {}", e.line(), json_message(&e)))?);
        limits.check_frames(documents.len(), text.len() as u64).map_err(|excess| excess.to_string())?;
        if input.end().is_ok() {
            break;
        }
    }
    let mut found = Found::default();
    match (documents.pop(), documents.is_empty()) {
        (Some(one), true) => found.add(one, Place::default(), true)?,
        (last, _) => found.frames(documents.into_iter().chain(last).enumerate(), Place::default())?,
    }
    found.checked()
}

/// What a file of arrays says.
pub(super) fn arrays(bytes: &[u8], limits: &Limits) -> Result<Found, String> {
    let arrays = npz::arrays(bytes, |name| known(name).is_some(), limits)?;
    let named = arrays.into_iter().filter_map(|(name, array)| Some((known(&name)?, Item::Array(array))));
    let mut found = Found::default();
    found.object(Object { named: named.collect(), numbered: Vec::new() }, Place::default())?;
    found.checked()
}

/// What a lone array says: joints.
pub(super) fn array(bytes: &[u8], limits: &Limits) -> Result<Found, String> {
    let array = npz::alone(bytes, limits)?;
    let at = KNOWN.iter().position(|(_, name)| *name == Name::Joints).unwrap_or_default();
    let fields = Fields { arrays: vec![(at, array)], side: None };
    Ok(Found { rows: vec![(None, fields)], ..Found::default() })
}

impl Found {
    /// Whether rows say their times.
    pub(super) fn timed(&self) -> bool {
        self.rows.iter().any(|(_, fields)| fields.get(Name::Time).is_some())
    }

    fn checked(self) -> Result<Self, String> {
        if self.rows.is_empty() {
            return Err(
                "it has neither rotations (hand_pose …) nor joints (pred_keypoints_3d …) of a hand".into()
            );
        }
        match self.rate {
            Some(rate) if !(rate > 0.0 && rate <= 10_000.0) => {
                Err(format!("fps is {rate}, allowed above 0 to 10000"))
            }
            _ => Ok(self),
        }
    }

    /// A value; a list is one of frames (`frames`), or of the hands in one.
    fn add(&mut self, item: Item, at: Place, frames: bool) -> Result<(), String> {
        match item {
            Item::Object(object) => self.object(object, at),
            Item::List(list) if frames => self.frames(list.into_iter().enumerate(), at),
            Item::List(list) => list.into_iter().try_for_each(|one| self.add(one, at, false)),
            Item::Array(_) | Item::Nothing => Ok(()),
        }
    }

    fn frames(&mut self, mut items: impl Iterator<Item = (usize, Item)>, at: Place) -> Result<(), String> {
        items.try_for_each(|(k, item)| {
            let before = self.rows.len();
            self.bare = None;
            self.add(item, Place { number: Some(k), ..at }, false)?;
            if self.rows.len() == before {
                self.empty.push((k, self.bare.take().unwrap_or_default()));
            }
            Ok(())
        })
    }

    fn object(&mut self, object: Object, at: Place) -> Result<(), String> {
        let mut fields = Fields { side: at.side, ..Fields::default() };
        let mut below = Vec::new();
        let mut named = object.named;
        // Names within names of the same hand.
        while let Some((known, item)) = named.pop() {
            match (KNOWN[known].1, item) {
                (Name::Inner, Item::Object(inner)) => named.extend(inner.named),
                (Name::Inner, Item::List(mut list)) if list.len() == 1 => {
                    if let Some(Item::Object(inner)) = list.pop() {
                        named.extend(inner.named);
                    }
                }
                (Name::Rate, Item::Array(array)) => self.rate = array.data.first().copied().or(self.rate),
                (Name::Mean, Item::Array(array)) => self.mean = Some(array),
                (Name::Flat, Item::Array(array)) => self.flat = array.data.first().map(|flat| *flat > 0.5),
                (_, Item::Array(array)) => fields.arrays.push((known, array)),
                (name, item) => below.push((name, item)),
            }
        }
        if fields.says_a_hand() {
            self.rows.push((at.number, fields));
        } else {
            self.bare = Some(fields);
        }
        for (name, item) in below {
            let side = match name {
                Name::Left => Some(Side::Left),
                Name::Right => Some(Side::Right),
                _ => at.side,
            };
            self.add(item, Place { side, ..at }, name == Name::Frames)?;
        }
        let mut numbered = object.numbered;
        numbered.sort_by_key(|(number, _)| *number);
        let first = numbered.first().map_or(0, |(number, _)| *number);
        self.frames(numbered.into_iter().map(|(number, item)| ((number - first) as usize, item)), at)
    }
}

/// Reads a value of as many parts as there is room for.
#[derive(Clone, Copy)]
struct ItemSeed<'a>(&'a Cell<usize>);

impl ItemSeed<'_> {
    fn take<E: Error>(self, parts: usize) -> Result<(), E> {
        let left = self.0.get().checked_sub(parts);
        let few = || E::custom("more objects, lists and texts than a file of this size may have");
        self.0.set(left.ok_or_else(few)?);
        Ok(())
    }

    /// Numbers for what is missing of lists of so many.
    fn missing<E: Error>(self, lists: usize, numbers: usize) -> Result<usize, E> {
        let numbers = lists.saturating_mul(numbers);
        self.take(numbers / NUMBERS)?;
        Ok(numbers)
    }
}

impl<'de> DeserializeSeed<'de> for ItemSeed<'_> {
    type Value = Item;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Item, D::Error> {
        deserializer.deserialize_any(self)
    }
}

fn number(value: f64) -> Item {
    Item::Array(Array { data: vec![value], ..Array::default() })
}

impl<'de> Visitor<'de> for ItemSeed<'_> {
    type Value = Item;

    fn expecting(&self, f: &mut Formatter) -> fmt::Result {
        f.write_str("numbers, texts, lists or objects")
    }

    fn visit_bool<E>(self, v: bool) -> Result<Item, E> {
        Ok(number(f64::from(u8::from(v))))
    }

    fn visit_i64<E>(self, v: i64) -> Result<Item, E> {
        Ok(number(v as f64))
    }

    fn visit_u64<E>(self, v: u64) -> Result<Item, E> {
        Ok(number(v as f64))
    }

    fn visit_f64<E>(self, v: f64) -> Result<Item, E> {
        Ok(number(v))
    }

    fn visit_str<E: Error>(self, v: &str) -> Result<Item, E> {
        self.take(1)?;
        Ok(Item::Array(Array { texts: vec![v.to_owned()], ..Array::default() }))
    }

    fn visit_unit<E>(self) -> Result<Item, E> {
        Ok(Item::Nothing)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Item, A::Error> {
        let (mut all, mut count, mut others) = (Array::default(), 0usize, Vec::new());
        while let Some(item) = list.next_element_seed(self)? {
            match item {
                Item::Array(array) if count == 0 => {
                    // What was missing before it.
                    let missing = others.iter().take_while(|other| matches!(other, Item::Nothing)).count();
                    others.drain(..missing);
                    let numbers = self.missing(missing, array.data.len())?;
                    all = Array { data: vec![f64::NAN; numbers], ..array.clone() };
                    all.data.extend(array.data);
                    count += missing;
                }
                Item::Array(array)
                    if array.shape == all.shape && array.texts.is_empty() == all.texts.is_empty() =>
                {
                    all.data.extend(array.data);
                    all.texts.extend(array.texts);
                }
                Item::Array(_) => return Err(A::Error::custom("lists of unequal lengths in one list")),
                Item::Nothing if count > 0 => {
                    self.take(1)?;
                    let numbers = self.missing(1, all.data.len() / count)?;
                    all.data.resize(all.data.len() + numbers, f64::NAN);
                }
                other => {
                    self.take(1)?;
                    others.push(other);
                    continue;
                }
            }
            count += 1;
        }
        match (count, others.is_empty()) {
            (0, _) => Ok(Item::List(others)),
            (_, true) => {
                all.shape.insert(0, count);
                all.shape.shrink_to_fit();
                all.data.shrink_to_fit();
                Ok(Item::Array(all))
            }
            _ => Err(A::Error::custom("numbers and objects in one list")),
        }
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Item, A::Error> {
        let mut out = Object::default();
        while let Some(name) = map.next_key::<String>()? {
            match (known(&name), name.parse::<u64>()) {
                (Some(known), _) => out.named.push((known, map.next_value_seed(self)?)),
                (None, Ok(number)) => out.numbered.push((number, map.next_value_seed(self)?)),
                _ => {
                    map.next_value::<IgnoredAny>()?;
                    continue;
                }
            }
            self.take(1)?;
        }
        out.named.shrink_to_fit();
        out.numbered.shrink_to_fit();
        Ok(Item::Object(out))
    }
}
