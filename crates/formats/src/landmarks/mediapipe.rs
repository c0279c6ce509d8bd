//! Results of MediaPipe's hand trackers as JSON: one result, a list of them, or one after the other (JSON lines).
//!
//! ```text
//! {"timestamp_ms":33,"handedness":[[{"score":0.98,"categoryName":"Right"}]],
//!  "landmarks":[[{"x":0.42,"y":0.61,"z":-0.01},…]],"worldLandmarks":[[{"x":0.01,"y":-0.02,"z":0.005},…]]}
//! ```
//!
//! `landmarks` are shares of the picture's width and height (pixels where they are larger), x right, y down, with z away
//! from the camera in shares of the width; `worldLandmarks` are metres about the hand's middle, x right, y down, z away.
//! Names are those of the tasks for the web and for Python, of the older solutions (`multiHandLandmarks`,
//! `multiHandWorldLandmarks`, `multiHandedness`) and of TensorFlow.js (`keypoints`, `keypoints3D`). Read only.
//! `spec/landmarks.md` has examples of each.

use std::fmt::{self, Formatter};

use nalgebra::{Point2, Point3};
use serde::de::value::MapAccessDeserializer;
use serde::de::{DeserializeSeed, Error, IntoDeserializer, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};

use super::{
    Axes, LandmarkClip, LandmarkFrame, PicturePoints, PictureUnit, Point, RATE, check_time, continuity,
    place, read_document, seconds_of_stamps, seconds_of_times,
};
use crate::motion::Format;
use crate::poses::json_message;
use handcast_hand::Side;
use handcast_limits::Limits;

/// Its row.
pub(crate) static FORMAT: Format = Format {
    id: "mediapipe",
    name: "joint positions (MediaPipe)",
    kind: "landmarks",
    ending: ".json",
    hands: 2,
    sniff,
    read: |bytes, limits| read_document(&FORMAT, parse, bytes, limits),
    write: None,
};

/// Joints of a hand.
const POINTS: usize = 21;
/// Points of a hand, hands of a picture, or categories of a hand, at most.
const MOST: usize = 64;
/// Lists within each other, at most: those of hands and of points.
const DEEPEST: usize = 2;
/// Largest coordinate of a share of the picture; hands may lie partly outside it.
const LARGEST_SHARE: f64 = 8.0;
/// How far into a file its names are looked for, bytes.
const HEAD: usize = 4096;
/// Names one of which a result has, each followed by a list.
const NAMES: [&str; 12] = [
    "landmarks",
    "worldLandmarks",
    "handLandmarks",
    "handWorldLandmarks",
    "hand_landmarks",
    "hand_world_landmarks",
    "multiHandLandmarks",
    "multiHandWorldLandmarks",
    "multi_hand_landmarks",
    "multi_hand_world_landmarks",
    "keypoints",
    "keypoints3D",
];

/// JSON in which a name of a result comes early.
pub(super) fn sniff(bytes: &[u8]) -> bool {
    let start = bytes.trim_ascii_start();
    let start = &start[..start.len().min(HEAD)];
    matches!(start.first(), Some(b'{' | b'[')) && NAMES.iter().any(|name| names_a_list(start, name))
}

/// Whether `"name": [` or `"name": null` is in a text.
fn names_a_list(text: &[u8], name: &str) -> bool {
    let quoted = format!("\"{name}\"");
    text.windows(quoted.len()).enumerate().any(|(at, window)| {
        let rest = text[at + window.len()..].trim_ascii_start();
        let value = rest.strip_prefix(b":").map(<[u8]>::trim_ascii_start);
        window == quoted.as_bytes() && value.is_some_and(|v| matches!(v.first(), Some(b'[' | b'n')))
    })
}

/// A point, a hand, or hands, however they are wrapped.
enum Tree {
    /// Three coordinates, the last of which may be missing.
    Point([f64; 3], bool),
    List(Vec<Tree>),
    Nothing,
}

impl<'de> Deserialize<'de> for Tree {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(TreeVisitor)
    }
}

struct TreeVisitor;

/// An element of a list of points.
enum Element {
    Number(f64),
    Tree(Tree),
}

impl<'de> Deserialize<'de> for Element {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ElementVisitor)
    }
}

struct ElementVisitor;

impl<'de> Visitor<'de> for ElementVisitor {
    type Value = Element;

    fn expecting(&self, f: &mut Formatter) -> fmt::Result {
        f.write_str("a coordinate, a point or a list of points")
    }

    fn visit_f64<E>(self, v: f64) -> Result<Element, E> {
        Ok(Element::Number(v))
    }

    fn visit_i64<E>(self, v: i64) -> Result<Element, E> {
        Ok(Element::Number(v as f64))
    }

    fn visit_u64<E>(self, v: u64) -> Result<Element, E> {
        Ok(Element::Number(v as f64))
    }

    fn visit_unit<E>(self) -> Result<Element, E> {
        Ok(Element::Tree(Tree::Nothing))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<Element, A::Error> {
        TreeVisitor.visit_seq(list).map(Element::Tree)
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Element, A::Error> {
        TreeVisitor.visit_map(map).map(Element::Tree)
    }
}

impl<'de> Visitor<'de> for TreeVisitor {
    type Value = Tree;

    fn expecting(&self, f: &mut Formatter) -> fmt::Result {
        f.write_str("a point or a list of points")
    }

    fn visit_unit<E>(self) -> Result<Tree, E> {
        Ok(Tree::Nothing)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Tree, A::Error> {
        let (mut numbers, mut trees) = (Vec::new(), Vec::new());
        while let Some(element) = list.next_element()? {
            match element {
                Element::Number(number) => numbers.push(number),
                Element::Tree(tree) if tree.depth() < DEEPEST => trees.push(tree),
                Element::Tree(_) => return Err(A::Error::custom("points in lists of lists of lists")),
            }
            if numbers.len() + trees.len() > MOST {
                return Err(A::Error::custom(format!("a list of more than {MOST} points or hands")));
            }
        }
        match (numbers.as_slice(), trees.is_empty()) {
            // A point whose coordinates are missing.
            _ if (2..=4).contains(&(numbers.len() + trees.len()))
                && !trees.is_empty()
                && trees.iter().all(|tree| matches!(tree, Tree::Nothing)) =>
            {
                Ok(Tree::Nothing)
            }
            ([], _) => Ok(Tree::List(trees)),
            ([x, y], true) => Ok(Tree::Point([*x, *y, 0.0], false)),
            // A fourth number is a confidence.
            ([x, y, z] | [x, y, z, _], true) => Ok(Tree::Point([*x, *y, *z], true)),
            (_, true) => {
                Err(A::Error::custom(format!("a point of {} numbers, allowed 2 to 4", numbers.len())))
            }
            _ => Err(A::Error::custom("numbers and points in one list")),
        }
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Tree, A::Error> {
        #[derive(Default, Deserialize)]
        #[serde(default)]
        struct Named {
            #[serde(deserialize_with = "said")]
            x: Option<Option<f64>>,
            #[serde(deserialize_with = "said")]
            y: Option<Option<f64>>,
            #[serde(deserialize_with = "said")]
            z: Option<Option<f64>>,
            #[serde(alias = "landmarks", alias = "keypoints")]
            landmark: Option<Tree>,
        }
        let named = Named::deserialize(MapAccessDeserializer::new(map))?;
        match (named.x, named.y, named.landmark) {
            (_, _, Some(list)) => Ok(list),
            (Some(x), Some(y), None) => Ok(match (x, y, named.z) {
                (Some(x), Some(y), None) => Tree::Point([x, y, 0.0], false),
                (Some(x), Some(y), Some(Some(z))) => Tree::Point([x, y, z], true),
                _ => Tree::Nothing,
            }),
            _ => Err(A::Error::custom("a point without x and y")),
        }
    }
}

/// What stands under a name that is there, if only `null`.
fn said<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Option<f64>>, D::Error> {
    Option::deserialize(deserializer).map(Some)
}

impl Tree {
    /// Lists within each other.
    fn depth(&self) -> usize {
        match self {
            Self::List(list) => 1 + list.iter().map(Self::depth).max().unwrap_or(0),
            _ => 0,
        }
    }

    /// The points of each hand.
    fn hands(self) -> Vec<Points> {
        let Self::List(list) = self else { return Vec::new() };
        if list.iter().any(|tree| matches!(tree, Self::Point(..))) {
            return vec![Points::of(&list)];
        }
        let hand = |tree: &Self| match tree {
            Self::List(points) => Points::of(points),
            _ => Points::default(),
        };
        list.iter().map(hand).collect()
    }
}

/// The points of a hand.
#[derive(Default)]
struct Points {
    list: Vec<Point>,
    /// Whether each that is there has a third coordinate.
    deep: bool,
}

impl Points {
    fn of(trees: &[Tree]) -> Self {
        let point = |tree: &Tree| match tree {
            Tree::Point(p, _) => Some(*p),
            _ => None,
        };
        let deep = trees.iter().all(|tree| !matches!(tree, Tree::Point(_, false)));
        Self { list: trees.iter().map(point).collect(), deep }
    }
}

/// Side and score of a hand, as far as they are said.
#[derive(Clone, Copy, Default)]
struct Label {
    side: Option<Side>,
    score: Option<f64>,
}

/// A label of each hand, or the categories of one; one that stands alone is a list of one.
#[derive(Default)]
struct Labels(Vec<Label>);

impl Labels {
    fn one(side: Option<Side>, score: Option<f64>) -> Self {
        Self(vec![Label { side, score }])
    }

    /// The likeliest.
    fn best(self) -> Label {
        let score = |label: &Label| label.score.unwrap_or(0.0);
        self.0.into_iter().max_by(|a, b| score(a).total_cmp(&score(b))).unwrap_or_default()
    }
}

impl<'de> Deserialize<'de> for Labels {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(LabelsVisitor)
    }
}

struct LabelsVisitor;

impl<'de> Visitor<'de> for LabelsVisitor {
    type Value = Labels;

    fn expecting(&self, f: &mut Formatter) -> fmt::Result {
        f.write_str("a side, a score, categories or a list of them")
    }

    fn visit_str<E>(self, v: &str) -> Result<Labels, E> {
        let side = [Side::Left, Side::Right].into_iter().find(|side| side.name().eq_ignore_ascii_case(v));
        Ok(Labels::one(side, None))
    }

    fn visit_bool<E>(self, _: bool) -> Result<Labels, E> {
        Ok(Labels::one(None, None))
    }

    fn visit_f64<E>(self, v: f64) -> Result<Labels, E> {
        Ok(Labels::one(None, Some(v)))
    }

    fn visit_i64<E: Error>(self, v: i64) -> Result<Labels, E> {
        self.visit_f64(v as f64)
    }

    fn visit_u64<E: Error>(self, v: u64) -> Result<Labels, E> {
        self.visit_f64(v as f64)
    }

    fn visit_unit<E>(self) -> Result<Labels, E> {
        Ok(Labels::default())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<Labels, A::Error> {
        let hands: Vec<Labels> = at_most(list, "labels")?;
        Ok(Labels(hands.into_iter().map(Labels::best).collect()))
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Labels, A::Error> {
        #[derive(Default, Deserialize)]
        #[serde(default)]
        struct Category {
            classification: Option<Labels>,
            categories: Option<Labels>,
            #[serde(rename = "categoryName")]
            category: Labels,
            category_name: Labels,
            label: Labels,
            #[serde(rename = "displayName")]
            displayed: Labels,
            display_name: Labels,
            score: Labels,
        }
        let one = Category::deserialize(MapAccessDeserializer::new(map))?;
        if let Some(categories) = one.classification.or(one.categories) {
            return Ok(Labels(vec![categories.best()]));
        }
        let names = [one.category, one.category_name, one.label, one.displayed, one.display_name];
        let side = names.into_iter().find_map(|name| name.best().side);
        Ok(Labels::one(side, one.score.best().score))
    }
}

/// A list of at most [`MOST`].
fn at_most<'de, T: Deserialize<'de>, A: SeqAccess<'de>>(mut list: A, what: &str) -> Result<Vec<T>, A::Error> {
    let mut all = Vec::new();
    while let Some(one) = list.next_element()? {
        if all.len() == MOST {
            return Err(A::Error::custom(format!("more than {MOST} {what} in one picture")));
        }
        all.push(one);
    }
    Ok(all)
}

/// The hands of a picture, each of which may be wrapped.
struct Hands(Vec<Hand>);

impl<'de> Deserialize<'de> for Hands {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(HandsVisitor)
    }
}

struct HandsVisitor;

impl<'de> Visitor<'de> for HandsVisitor {
    type Value = Hands;

    fn expecting(&self, f: &mut Formatter) -> fmt::Result {
        f.write_str("a list of hands")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<Hands, A::Error> {
        let nodes: Vec<Wrapped> = at_most(list, "hands")?;
        let hands: Vec<Hand> = nodes.into_iter().flat_map(|Wrapped(hands)| hands).collect();
        if hands.len() > MOST {
            return Err(A::Error::custom(format!("more than {MOST} hands in one picture")));
        }
        Ok(Hands(hands))
    }
}

/// What one node says of hands.
struct Wrapped(Vec<Hand>);

impl<'de> Deserialize<'de> for Wrapped {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        hands_of(Node::deserialize(deserializer)?).map(Self).map_err(D::Error::custom)
    }
}

/// A document, a result, or a hand of TensorFlow.js: what it names tells.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Node {
    #[serde(alias = "time", alias = "time_s", alias = "seconds")]
    t: Option<f64>,
    #[serde(alias = "timestampMs", alias = "timestampInMilliseconds", alias = "timestamp_in_milliseconds")]
    timestamp_ms: Option<f64>,
    #[serde(alias = "timestampUs", alias = "timestampInMicroseconds")]
    timestamp_us: Option<f64>,
    #[serde(alias = "timestampNs", alias = "timestampInNanoseconds")]
    timestamp_ns: Option<f64>,
    timestamp: Option<f64>,
    #[serde(
        alias = "frame_number",
        alias = "frameNumber",
        alias = "frame_index",
        alias = "frameIndex",
        alias = "frame_id",
        deserialize_with = "number"
    )]
    frame: Option<f64>,
    #[serde(alias = "imageWidth", alias = "image_width")]
    width: Option<f64>,
    #[serde(alias = "imageHeight", alias = "image_height")]
    height: Option<f64>,
    #[serde(alias = "imageSize")]
    image_size: Option<[f64; 2]>,
    #[serde(alias = "frameRate", alias = "frame_rate")]
    fps: Option<f64>,
    hands: Option<Hands>,
    keypoints: Option<Tree>,
    #[serde(rename = "keypoints3D", alias = "keypoints3d", alias = "keypoints_3d")]
    keypoints_3d: Option<Tree>,
    #[serde(
        alias = "handLandmarks",
        alias = "hand_landmarks",
        alias = "multiHandLandmarks",
        alias = "multi_hand_landmarks"
    )]
    landmarks: Option<Tree>,
    #[serde(
        rename = "worldLandmarks",
        alias = "handWorldLandmarks",
        alias = "hand_world_landmarks",
        alias = "multiHandWorldLandmarks",
        alias = "multi_hand_world_landmarks"
    )]
    world: Option<Tree>,
    handedness: Option<Labels>,
    handednesses: Option<Labels>,
    #[serde(alias = "multiHandedness")]
    multi_handedness: Option<Labels>,
    score: Option<f64>,
}

/// A number, where it is one: `frame` may be anything.
fn number<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    Ok(serde_json::Value::deserialize(deserializer)?.as_f64())
}

/// Names of the results of a document.
const RESULTS: [&str; 2] = ["frames", "results"];

/// An object whose results go into a document as they are read; all else is left to its reader.
struct Streamed<'d, 'l, M> {
    map: M,
    document: &'d mut Document<'l>,
    /// Whether it had results.
    results: bool,
    /// Results whose keys are numbers of frames.
    numbered: Vec<(u64, Found)>,
}

impl<'de, M: MapAccess<'de>> Streamed<'_, '_, M> {
    /// Reads the result of a frame.
    fn numbered(&mut self, number: u64) -> Result<(), M::Error> {
        let before = self.document.found.len();
        self.map.next_value_seed(Reader { document: &mut *self.document, place: Place::Alone })?;
        let found = self.document.found.pop();
        let alone = found.filter(|_| self.document.found.len() == before);
        let found = alone.ok_or_else(|| M::Error::custom(format!("not one result under \"{number}\"")))?;
        self.numbered.push((number, found));
        Ok(())
    }
}

impl<'de, M: MapAccess<'de>> MapAccess<'de> for &mut Streamed<'_, '_, M> {
    type Error = M::Error;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, M::Error> {
        while let Some(key) = self.map.next_key::<String>()? {
            if let Ok(number) = key.parse() {
                self.numbered(number)?;
                continue;
            }
            if !RESULTS.contains(&key.as_str()) {
                return seed.deserialize(key.into_deserializer()).map(Some);
            }
            self.results = true;
            self.map.next_value_seed(Reader { document: &mut *self.document, place: Place::Results })?;
        }
        Ok(None)
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, M::Error> {
        self.map.next_value_seed(seed)
    }
}

/// Where a value stands.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Place {
    Alone,
    /// In a list of hands or of results.
    Listed,
    /// The results of a document.
    Results,
}

/// Reads a result, or a list of results, into a document. A hand in a list is left to that list.
struct Reader<'d, 'l> {
    document: &'d mut Document<'l>,
    place: Place,
}

impl<'de> DeserializeSeed<'de> for Reader<'_, '_> {
    type Value = Option<Hand>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Option<Hand>, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Reader<'_, '_> {
    type Value = Option<Hand>;

    fn expecting(&self, f: &mut Formatter) -> fmt::Result {
        f.write_str("a result or a list of results")
    }

    fn visit_unit<E: Error>(self) -> Result<Option<Hand>, E> {
        if self.place != Place::Results {
            self.document.push(Found::default()).map_err(E::custom)?;
        }
        Ok(None)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Option<Hand>, A::Error> {
        let Self { document, place } = self;
        let inner = if place == Place::Results { Place::Alone } else { Place::Listed };
        let before = document.found.len();
        // A picture without hands, as TensorFlow.js prints it.
        let mut empty = place != Place::Results;
        let mut hands = Vec::new();
        while let Some(hand) = list.next_element_seed(Reader { document: &mut *document, place: inner })? {
            empty = false;
            hands.extend(hand);
            if !hands.is_empty() && document.found.len() > before {
                return Err(A::Error::custom("hands and results in one list"));
            }
            if hands.len() > MOST {
                return Err(A::Error::custom(format!("more than {MOST} hands in one picture")));
            }
        }
        if empty || !hands.is_empty() {
            document.push(Found { hands, ..Found::default() }).map_err(A::Error::custom)?;
        }
        Ok(None)
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Option<Hand>, A::Error> {
        let Self { document, place } = self;
        let mut streamed = Streamed { map, document, results: false, numbered: Vec::new() };
        let node = Node::deserialize(MapAccessDeserializer::new(&mut streamed))?;
        let Streamed { document, results, numbered, .. } = streamed;
        let of_frames = !numbered.is_empty();
        document.add_numbered(numbered).map_err(A::Error::custom)?;
        let added = match (results || of_frames, place) {
            (true, _) => document.header(&node).map(|_| None),
            (false, Place::Listed) if node.is_hand() => hands_of(node).map(|hands| hands.into_iter().next()),
            _ => document.add(node).map(|()| None),
        };
        added.map_err(A::Error::custom)
    }
}

/// A hand of a result.
#[derive(Default)]
struct Hand {
    label: Option<Side>,
    score: Option<f64>,
    picture: Points,
    world: Points,
}

/// A result.
#[derive(Default)]
struct Found {
    /// Its time, and seconds in its unit where that is known.
    time: Option<(f64, Option<f64>)>,
    /// The number of its frame.
    number: Option<f64>,
    hands: Vec<Hand>,
}

/// What a document says, in order.
struct Document<'l> {
    limits: &'l Limits,
    /// Of its text.
    bytes: u64,
    rate: Option<f64>,
    size: Option<[f64; 2]>,
    found: Vec<Found>,
}

/// The hands of a document: one or two recordings.
pub(super) fn parse(text: &[u8], limits: &Limits) -> Result<Vec<LandmarkClip>, String> {
    let mut document =
        Document { limits, bytes: text.len() as u64, rate: None, size: None, found: Vec::new() };
    let mut input = serde_json::Deserializer::from_slice(text);
    while input.end().is_err() {
        let read = Reader { document: &mut document, place: Place::Alone }.deserialize(&mut input);
        read.map_err(|e| format!("line {}: {}", e.line(), json_message(&e)))?;
    }
    document.clips()
}

impl Document<'_> {
    fn push(&mut self, found: Found) -> Result<(), String> {
        self.limits.check_frames(self.found.len() + 1, self.bytes).map_err(|e| e.to_string())?;
        self.found.push(found);
        Ok(())
    }

    /// Takes over results by the numbers of their frames; those between them that have none are empty.
    fn add_numbered(&mut self, mut results: Vec<(u64, Found)>) -> Result<(), String> {
        results.sort_by_key(|(number, _)| *number);
        let mut next = results.first().map_or(0, |(number, _)| *number);
        for (number, found) in results {
            if number < next {
                return Err(format!("frame {number} twice"));
            }
            while next < number {
                self.push(Found::default())?;
                next += 1;
            }
            self.push(found)?;
            next += 1;
        }
        Ok(())
    }

    /// Takes over the rate and the picture's size, and says whether a node has either.
    fn header(&mut self, node: &Node) -> Result<bool, String> {
        if let Some(rate) = node.fps {
            if !(rate > 0.0 && rate <= 10_000.0) {
                return Err(format!("fps is {rate}, allowed above 0 to 10000"));
            }
            self.rate = Some(rate);
        }
        let size = node.image_size.or(node.width.zip(node.height).map(|(w, h)| [w, h]));
        if let Some(size) = size {
            if !size.iter().all(|v| (1.0..=1e6).contains(v)) {
                return Err(format!("the picture is {} × {} pixels, allowed 1 to 1000000", size[0], size[1]));
            }
            self.size = Some(size);
        }
        Ok(size.is_some() || node.fps.is_some())
    }

    fn add(&mut self, node: Node) -> Result<(), String> {
        let header = self.header(&node)?;
        let times = [
            (node.t, Some(1.0)),
            (node.timestamp_ms, Some(1e-3)),
            (node.timestamp_us, Some(1e-6)),
            (node.timestamp_ns, Some(1e-9)),
        ];
        let timed = times.into_iter().chain([(node.timestamp, None)]).find_map(|(t, unit)| Some((t?, unit)));
        let says_hands = node.landmarks.is_some() || node.world.is_some() || node.hands.is_some();
        if timed.is_none() && !says_hands && !node.is_hand() {
            // A header, or a result that is empty.
            return if header { Ok(()) } else { self.push(Found::default()) };
        }
        let (at, number) = (self.found.len(), node.frame);
        let hands = hands_of(node).map_err(|what| format!("result {at}: {what}"))?;
        self.push(Found { time: timed, number, hands })
    }

    /// Seconds of each result. One without a time among those that have some, an empty one, lies evenly between its neighbours.
    fn times(&self) -> Vec<f64> {
        let rate = self.rate.unwrap_or(RATE);
        let stamps: Vec<f64> = self.found.iter().filter_map(|f| f.time.map(|(t, _)| t)).collect();
        if stamps.is_empty()
            && let Some(numbers) = self.found.iter().map(|found| found.number).collect::<Option<Vec<f64>>>()
            && numbers.is_sorted_by(|a, b| a < b)
        {
            return numbers.iter().map(|number| (number - numbers[0]) / rate).collect();
        }
        let (times, guessed) = (seconds_of_times(&stamps), seconds_of_stamps(&stamps));
        let unit = |told: Option<f64>| told.map_or(guessed, |unit| if unit == 1.0 { times } else { unit });
        let seconds = |found: &Found| found.time.map(|(t, told)| t * unit(told));
        let told: Vec<Option<f64>> = self.found.iter().map(seconds).collect();
        let known: Vec<(usize, f64)> =
            told.iter().enumerate().filter_map(|(i, time)| Some((i, (*time)?))).collect();
        let between = |i: usize| {
            let behind = known.partition_point(|(k, _)| *k < i);
            let before = behind.checked_sub(1).and_then(|at| known.get(at));
            match (before, known.get(behind)) {
                (Some((a, from)), Some((b, to))) => from + (to - from) * (i - a) as f64 / (b - a) as f64,
                (Some((a, from)), None) => from + (i - a) as f64 / rate,
                (None, Some((b, to))) => to - (b - i) as f64 / rate,
                (None, None) => i as f64 / rate,
            }
        };
        told.iter().enumerate().map(|(i, time)| time.unwrap_or_else(|| between(i))).collect()
    }

    fn clips(self) -> Result<Vec<LandmarkClip>, String> {
        let times = self.times();
        let rate = self.rate.or(self.found.iter().all(|f| f.time.is_none()).then_some(RATE));
        let (mut tracks, size) = (Tracks::default(), self.size);
        let empty = LandmarkClip {
            rate,
            rate_assumed: self.rate.is_none() && rate.is_some(),
            points_per_frame: POINTS,
            axes: Axes::Mediapipe,
            tips_inside: true,
            centred: true,
            side_unsure: true,
            image_size: self.size,
            metres: Some(1.0),
            made_by: Some("MediaPipe".into()),
            ..LandmarkClip::default()
        };
        let mut clips = [empty.clone(), empty];
        for (i, (found, time)) in self.found.into_iter().zip(times).enumerate() {
            let wrong = |what| format!("result {i}: {what}");
            check_time(time, clips[0].frames.last()).map_err(wrong)?;
            for (slot, hand) in tracks.next(found.hands).into_iter().enumerate() {
                let frame = match hand {
                    None => LandmarkFrame::of(time, [None; 25]),
                    Some(hand) => frame(time, hand, size).map_err(wrong)?,
                };
                clips[slot].frames.push(frame);
            }
        }
        let seen = tracks.sides();
        let hands = clips.into_iter().zip(seen).filter_map(|(clip, seen)| {
            let side = seen?;
            Some(LandmarkClip { side, ..clip })
        });
        let mut hands: Vec<LandmarkClip> = hands.collect();
        continuity::restore(&mut hands);
        if hands.is_empty() { Err("no result has a hand".into()) } else { Ok(hands) }
    }
}

impl Node {
    /// Whether it is a hand of TensorFlow.js.
    fn is_hand(&self) -> bool {
        self.keypoints.is_some() || self.keypoints_3d.is_some()
    }
}

fn hands_of(node: Node) -> Result<Vec<Hand>, String> {
    let hand = node.is_hand();
    if let Some(Hands(hands)) = node.hands {
        return Ok(hands);
    }
    let labels = [node.handedness, node.handednesses, node.multi_handedness];
    let labels = labels.into_iter().flatten().map(|Labels(labels)| labels).find(|labels| !labels.is_empty());
    let mut labels = labels.unwrap_or_default().into_iter();
    if hand {
        let only = |tree: Option<Tree>| tree.and_then(|t| t.hands().into_iter().next()).unwrap_or_default();
        let label = labels.next().unwrap_or_default();
        let [picture, world] = [only(node.keypoints), only(node.keypoints_3d)];
        return Ok(vec![Hand { label: label.side, score: label.score.or(node.score), picture, world }]);
    }
    let pictures = node.landmarks.map(Tree::hands).unwrap_or_default();
    let worlds = node.world.map(Tree::hands).unwrap_or_default();
    if !pictures.is_empty() && !worlds.is_empty() && pictures.len() != worlds.len() {
        return Err(format!("{} hands in the picture, {} in the world", pictures.len(), worlds.len()));
    }
    let count = pictures.len().max(worlds.len());
    let (mut pictures, mut worlds) = (pictures.into_iter(), worlds.into_iter());
    let hands = (0..count).map(|_| {
        let Label { side, score } = labels.next().unwrap_or_default();
        let picture = pictures.next().unwrap_or_default();
        Hand { label: side, score, picture, world: worlds.next().unwrap_or_default() }
    });
    Ok(hands.filter(|hand| !hand.picture.list.is_empty() || !hand.world.list.is_empty()).collect())
}

/// Distance from a place at which no hand has been: above any in a picture.
const NEVER_THERE: f64 = 1e7;

/// Two hands followed from result to result.
#[derive(Default)]
struct Tracks {
    /// Where each was last, in the picture.
    last: [Option<Point2<f64>>; 2],
    /// How often each was called left and right.
    votes: [[usize; 2]; 2],
    seen: [bool; 2],
}

impl Tracks {
    /// The hands of a result in the places of the two: by their names where these differ, else by where they are. Of
    /// more than two hands the surest are taken.
    fn next(&mut self, mut hands: Vec<Hand>) -> [Option<Hand>; 2] {
        hands.sort_by(|a, b| b.score.unwrap_or(0.0).total_cmp(&a.score.unwrap_or(0.0)));
        hands.truncate(2);
        let mut slots = [None, None];
        let mut hands = hands.into_iter();
        let (Some(first), second) = (hands.next(), hands.next()) else { return slots };
        let at = self.slot(&first, second.as_ref());
        for (slot, hand) in [(at, Some(first)), (1 - at, second)] {
            let Some(hand) = hand else { continue };
            self.last[slot] = wrist(&hand).or(self.last[slot]);
            if let Some(side) = hand.label {
                self.votes[slot][side as usize] += 1;
            }
            self.seen[slot] = true;
            slots[slot] = Some(hand);
        }
        slots
    }

    /// The place of the first hand; the other is for the second.
    fn slot(&self, first: &Hand, second: Option<&Hand>) -> usize {
        let other = second.and_then(|second| second.label);
        match (first.label, other) {
            (Some(a), Some(b)) if a != b => a as usize,
            (Some(a), None) if second.is_none() => a as usize,
            _ => {
                let away = |hand: Option<&Hand>, slot: usize| match (hand.and_then(wrist), self.last[slot]) {
                    (Some(a), Some(b)) => (a - b).norm(),
                    (Some(_), None) => NEVER_THERE,
                    (None, _) => 0.0,
                };
                let straight = away(Some(first), 0) + away(second, 1);
                let crossed = away(Some(first), 1) + away(second, 0);
                match straight.total_cmp(&crossed) {
                    std::cmp::Ordering::Less => 0,
                    std::cmp::Ordering::Greater => 1,
                    std::cmp::Ordering::Equal => first.label.map_or(0, |side| side as usize),
                }
            }
        }
    }

    /// Of each place whether there was a hand, and which it was called more often.
    fn sides(&self) -> [Option<Option<Side>>; 2] {
        std::array::from_fn(|slot| {
            let [left, right] = self.votes[slot];
            self.seen[slot].then_some(match left.cmp(&right) {
                std::cmp::Ordering::Greater => Some(Side::Left),
                std::cmp::Ordering::Less => Some(Side::Right),
                std::cmp::Ordering::Equal => None,
            })
        })
    }
}

/// Where a hand is in the picture.
fn wrist(hand: &Hand) -> Option<Point2<f64>> {
    let [x, y, _] = (*hand.picture.list.first()?)?;
    Some(Point2::new(x, y))
}

fn frame(time: f64, hand: Hand, size: Option<[f64; 2]>) -> Result<LandmarkFrame, String> {
    let world = match hand.world.list.as_slice() {
        [] => [None; 25],
        points => place(points, POINTS).map_err(|what| format!("in the world: {what}"))?,
    };
    let picture = match hand.picture.list.as_slice() {
        [] => None,
        flat => {
            let placed = place(flat, POINTS).map_err(|what| format!("in the picture: {what}"))?;
            let largest = flat.iter().flatten().flat_map(|p| [p[0].abs(), p[1].abs()]).fold(0.0, f64::max);
            let unit = if largest > LARGEST_SHARE { PictureUnit::Pixels } else { PictureUnit::Shares };
            Some(Box::new(PicturePoints { unit, deep: hand.picture.deep, points: placed }))
        }
    };
    let image = picture.as_deref().and_then(|picture| picture.pixels(size));
    let image = image.map(|points| points.map(|p| p.map(|p: Point3<f64>| p.xy())));
    let confidence = hand.score.filter(|score| (0.0..=1.0).contains(score));
    Ok(LandmarkFrame { image, picture, confidence, ..LandmarkFrame::of(time, world) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use serde_json::{Value, json};

    fn read(text: &str) -> Result<Vec<LandmarkClip>, String> {
        assert!(sniff(text.as_bytes()), "{text}");
        parse(text.as_bytes(), &Limits::default())
    }

    /// 21 points, the first at `x`.
    fn points(x: f64) -> Vec<Value> {
        (0..21)
            .map(|i| json!({ "x": x + 0.01 * f64::from(i), "y": 0.5, "z": -0.01, "visibility": 0 }))
            .collect()
    }

    fn category(name: &str, score: f64) -> Value {
        json!([{ "score": score, "index": 0, "categoryName": name, "displayName": name }])
    }

    fn web(t: f64) -> Value {
        json!({
            "timestampMs": t,
            "landmarks": [points(0.2), points(0.6)],
            "worldLandmarks": [points(0.0), points(0.0)],
            "handedness": [category("Right", 0.9), category("Left", 0.8)],
            "handednesses": [category("Right", 0.9), category("Left", 0.8)],
        })
    }

    #[test]
    fn results_of_the_tasks_are_read_alone_in_lists_and_in_lines() {
        let (one, two) = (web(0.0), web(40.0));
        for text in [
            json!([one, two]).to_string(),
            serde_json::to_string_pretty(&json!({ "width": 1280, "height": 720, "frames": [one, two] }))
                .unwrap(),
            format!("{{\"imageSize\":[1280,720]}}\n{one}\n{two}\n"),
        ] {
            let clips = read(&text).unwrap();
            assert_eq!(
                clips.iter().map(|c| c.side).collect::<Vec<_>>(),
                [Some(Side::Left), Some(Side::Right)]
            );
            let right = &clips[1];
            assert_eq!((right.axes, right.centred, right.metres), (Axes::Mediapipe, true, Some(1.0)));
            assert_eq!(right.frames[1].time, 0.04);
            assert_eq!(right.frames[1].confidence, Some(0.9));
            assert_eq!(right.frames[0].points[0], Some(Point3::new(0.0, 0.5, -0.01)));
            let told = text.contains("720");
            assert_eq!(right.image_size, told.then_some([1280.0, 720.0]));
            let wrist = right.frames[0].image.and_then(|image| image[0]);
            assert_eq!(wrist, told.then_some(Point2::new(256.0, 360.0)));
        }
        let python = json!({
            "hand_landmarks": [points(0.2)], "hand_world_landmarks": [points(0.0)],
            "handedness": [[{ "index": 1, "score": 0.7, "display_name": "Left", "category_name": "Left" }]],
        });
        let clips = read(&python.to_string()).unwrap();
        assert_eq!((clips.len(), clips[0].side, clips[0].rate), (1, Some(Side::Left), Some(30.0)));
    }

    #[test]
    fn older_solutions_and_tensorflow_js_are_read() {
        let legacy = json!({
            "multiHandedness": [{ "index": 0, "score": 0.6, "label": "Left" }],
            "multiHandLandmarks": [points(0.1)],
            "multiHandWorldLandmarks": [points(0.0)],
        });
        let message = json!({
            "multi_handedness": [{ "classification": [{ "index": 0, "score": 0.6, "label": "Left" }] }],
            "multi_hand_landmarks": [{ "landmark": points(0.1) }],
            "multi_hand_world_landmarks": [{ "landmark": points(0.0) }],
        });
        let [legacy, message] = [legacy, message].map(|value| read(&value.to_string()).unwrap());
        assert_eq!(legacy, message);
        assert_eq!((legacy[0].side, legacy[0].frames[0].confidence), (Some(Side::Left), Some(0.6)));
        let keypoints: Vec<Value> = (0..21).map(|i| json!({ "x": 100 + i, "y": 50, "name": "a" })).collect();
        let hand = json!({ "keypoints": keypoints, "keypoints3D": points(0.0), "handedness": "Right", "score": 0.5 });
        // Two pictures, the second without a hand.
        let clips = read(&json!([[hand], []]).to_string()).unwrap();
        assert_eq!((clips.len(), clips[0].frames.len(), clips[0].side), (1, 2, Some(Side::Right)));
        assert_eq!(clips[0].frames[0].image.unwrap()[0], Some(Point2::new(100.0, 50.0)));
        assert!(clips[0].frames[1].points.iter().all(Option::is_none));
        assert_eq!(read(&json!([hand]).to_string()).unwrap()[0].frames.len(), 1);
        // Points as lists of numbers.
        let flat: Vec<Value> = (0..21).map(|i| json!([0.3, 0.01 * f64::from(i)])).collect();
        let clips = read(&json!({ "landmarks": flat }).to_string()).unwrap();
        assert!(!clips[0].frames[0].picture.as_ref().unwrap().deep);
    }

    #[test]
    fn numbers_of_frames_are_times_where_nothing_else_is() {
        let result = |n: i32| json!({ "frame_number": n, "worldLandmarks": [points(0.1)], "handedness": [category("Right", 0.9)] });
        let text = |numbers: [i32; 3]| json!({ "fps": 20, "results": numbers.map(result) }).to_string();
        let times =
            |numbers| read(&text(numbers)).unwrap()[0].frames.iter().map(|f| f.time).collect::<Vec<_>>();
        assert_eq!(times([4, 6, 16]), [0.0, 0.1, 0.6]);
        // No numbers of frames.
        assert_eq!(times([4, 4, 4]), [0.0, 0.05, 0.1]);
    }

    #[test]
    fn results_by_the_numbers_of_their_frames() {
        let result =
            |x: f64| json!({ "worldLandmarks": [points(x)], "handedness": [category("Right", 0.9)] });
        // As text they are in another order; two frames have none.
        let keyed = json!({ "10": result(0.3), "7": result(0.1), "8": null });
        let listed = json!([result(0.1), null, null, result(0.3)]);
        let clips = read(&listed.to_string()).unwrap();
        assert_eq!((clips.len(), clips[0].frames.len()), (1, 4));
        assert_eq!(read(&keyed.to_string()).unwrap(), clips);
        assert_eq!(
            read(&json!({ "fps": 30, "frames": keyed }).to_string()).unwrap()[0].frames,
            clips[0].frames
        );
        let twice = format!("{{\"7\": {0}, \"07\": {0}}}", result(0.1));
        assert!(read(&twice).unwrap_err().contains("frame 7 twice"));
        let both = json!({ "7": [result(0.1), result(0.1)] });
        assert!(read(&both.to_string()).unwrap_err().contains("not one result under \"7\""));
        let far = json!({ "0": result(0.1), "9000000000": result(0.1) });
        assert!(read(&far.to_string()).is_err());
    }

    #[test]
    fn hands_keep_their_places_when_both_have_one_name() {
        let result = |t: f64, xs: [f64; 2], names: [&str; 2]| {
            json!({
                "t": t, "landmarks": [points(xs[0]), points(xs[1])],
                "handedness": [category(names[0], 0.9), category(names[1], 0.5)],
            })
        };
        let text = json!([
            result(0.0, [0.1, 0.6], ["Left", "Right"]),
            result(0.1, [0.6, 0.1], ["Left", "Left"]),
            result(0.2, [0.1, 0.6], ["Left", "Right"]),
        ]);
        let clips = read(&text.to_string()).unwrap();
        for (clip, x) in clips.iter().zip([0.1, 0.6]) {
            for frame in &clip.frames {
                assert_eq!(frame.picture.as_ref().unwrap().points[0].unwrap().x, x);
            }
        }
        assert_eq!(clips[1].frames[1].time, 0.1);
    }

    #[test]
    fn a_hand_without_a_name_is_one_hand() {
        let results: Vec<Value> =
            (0..3).map(|i| json!({ "landmarks": [points(0.1 + 0.05 * f64::from(i))] })).collect();
        let clips = read(&json!(results).to_string()).unwrap();
        assert_eq!((clips.len(), clips[0].side), (1, None));
        assert!(clips[0].frames.iter().all(|frame| frame.picture.is_some()));
    }

    #[test]
    fn empty_results_lie_between_those_with_times() {
        let hand = |t: f64| json!({ "timestamp": t, "worldLandmarks": [points(0.0)] });
        for empty in [json!(null), json!({})] {
            let results = json!([empty, hand(1520.0), empty, empty, hand(1640.0), empty]);
            let clips = parse(results.to_string().as_bytes(), &Limits::default()).unwrap();
            let times: Vec<f64> = clips[0].frames.iter().map(|frame| frame.time).collect();
            let expected = [1.52 - 1.0 / 30.0, 1.52, 1.56, 1.6, 1.64, 1.64 + 1.0 / 30.0];
            assert!(times.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{times:?}");
        }
    }

    #[test]
    fn times_without_a_unit_are_told_by_their_steps() {
        for (step, second) in [(0.04, 1.0), (40.0, 1e-3), (40_000.0, 1e-6)] {
            let results: Vec<Value> = (0..3)
                .map(|i| json!({ "timestamp": f64::from(i) * step, "worldLandmarks": [points(0.0)] }))
                .collect();
            let clips = read(&json!(results).to_string()).unwrap();
            assert!((clips[0].frames[2].time - 2.0 * step * second).abs() < 1e-12);
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        let short = json!({ "landmarks": [points(0.1)[..20].to_vec()] }).to_string();
        let twice = json!([{ "t": 1, "landmarks": [points(0.1)] }, { "t": 1, "landmarks": [] }]).to_string();
        let unequal =
            json!({ "landmarks": [points(0.1)], "worldLandmarks": [points(0.0), points(0.0)] }).to_string();
        let many = json!({ "landmarks": vec![json!([]); 65] }).to_string();
        let labels = json!({ "handedness": vec![json!([]); 65], "landmarks": [] }).to_string();
        let mixed = json!([{ "keypoints": [] }, { "landmarks": [] }]).to_string();
        for (text, words) in [
            (short.as_str(), "result 0: in the picture: 20 points, expected 21"),
            (twice.as_str(), "result 1: t is 1 s, not after"),
            (unequal.as_str(), "result 0: 1 hands in the picture, 2 in the world"),
            ("{\"landmarks\":[]}", "no result has a hand"),
            ("{\"landmarks\":[[{\"x\":1}]]}", "a point without x and y"),
            ("{\"landmarks\":[[[1,2,3,4,5]]]}", "a point of 5 numbers, allowed 2 to 4"),
            ("{\"fps\":0,\"landmarks\":[]}", "fps is 0, allowed above 0 to 10000"),
            ("{\"width\":0,\"height\":1,\"landmarks\":[]}", "pixels, allowed 1 to 1000000"),
            ("{\"landmarks\":[\n[}", "line 2"),
            ("{\"landmarks\":[[[[[1,2]]]]]}", "points in lists of lists of lists"),
            (many.as_str(), "a list of more than 64 points or hands"),
            (labels.as_str(), "more than 64 labels in one picture"),
            (mixed.as_str(), "hands and results in one list"),
        ] {
            let message = read(text).unwrap_err();
            assert!(message.contains(words), "{message}");
        }
    }

    proptest! {
        #[test]
        fn damaged_files_are_refused_or_read_but_never_panic(
            at in 0usize..9000,
            byte in any::<u8>(),
            cut in 0usize..9000,
        ) {
            let mut bytes = format!("{}\n{}", web(0.0), web(30.0)).into_bytes();
            let n = bytes.len();
            bytes[at % n] = byte;
            if let Ok(clips) = parse(&bytes, &Limits::default()) {
                prop_assert!(clips.len() <= 2);
            }
            bytes.truncate(n - cut % n);
            let _ = parse(&bytes, &Limits::default());
        }
    }
}
