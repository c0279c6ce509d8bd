//! The document of a glTF file, checked for what reading it relies on.

use std::fmt;

use gltf_json::Root;
use gltf_json::mesh::Semantic;
use gltf_json::validation::Checked;
use serde::de::{Deserialize, Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};

use super::GltfError;
use handcast_limits::{Limit, Limits};

/// Most bytes of the text that describes a file, without data that is in it.
const MAX_TEXT: usize = 1 << 24;

/// The document, with no more parts than allowed. What [`gltf`] takes for granted of numbers and words is checked: that the
/// node, sampler and path of a channel, and the positions of a mesh, are there.
///
/// # Errors
/// [`GltfError::Syntax`], [`GltfError::Unsupported`], [`GltfError::Excess`].
pub(super) fn root(text: &[u8], limits: &Limits) -> Result<Root, GltfError> {
    let length = without_data(text);
    if length > MAX_TEXT {
        let what = format!("{length} bytes of JSON, allowed at most {MAX_TEXT}");
        return Err(GltfError::Unsupported { what });
    }
    // Those of its types take lists for objects.
    if !text.trim_ascii_start().starts_with(b"{") {
        return Err(GltfError::Unsupported { what: "invalid glTF: its JSON is no object".into() });
    }
    let syntax = |e| GltfError::Syntax(Box::new(::gltf::Error::Deserialize(e)));
    // A list of empty parts takes a hundred times its text.
    let counts: Counts = serde_json::from_slice(text).map_err(syntax)?;
    let most = counts.all().into_iter().map(|Count(count)| count).max().unwrap_or(0);
    limits.check_count(Limit::Nodes, most)?;
    let root: Root = serde_json::from_slice(text).map_err(syntax)?;
    limits.check_count(Limit::Nodes, root.meshes.iter().map(|mesh| mesh.primitives.len()).sum())?;
    check_animations(&root)?;
    check_positions(&root)?;
    Ok(root)
}

/// Bytes of a text without those of its `data:` URIs, of which no values are made.
fn without_data(text: &[u8]) -> usize {
    const START: &[u8] = b"\"data:";
    let (mut length, mut rest) = (text.len(), text);
    while let Some(at) = rest.windows(START.len()).position(|bytes| bytes == START) {
        rest = rest.get(at + START.len()..).unwrap_or_default();
        let data = rest.iter().position(|byte| *byte == b'"').unwrap_or(rest.len());
        length -= data;
        rest = rest.get(data + 1..).unwrap_or_default();
    }
    length
}

fn check_animations(root: &Root) -> Result<(), GltfError> {
    let wrong = |what: String| Err(GltfError::Unsupported { what });
    let nodes = root.nodes.len();
    for (a, animation) in root.animations.iter().enumerate() {
        for sampler in &animation.samplers {
            if matches!(sampler.interpolation, Checked::Invalid) {
                return wrong(format!("animation {a} has an interpolation that glTF does not know"));
            }
        }
        for channel in &animation.channels {
            let (node, sampler) = (channel.target.node.value(), channel.sampler.value());
            if node >= nodes {
                return wrong(format!("an animation moves node {node} of {nodes}"));
            }
            if matches!(channel.target.path, Checked::Invalid) {
                return wrong(format!("animation {a} moves something of node {node} that is not known here"));
            }
            let samplers = animation.samplers.len();
            if sampler >= samplers {
                return wrong(format!("animation {a} uses sampler {sampler} of {samplers}"));
            }
        }
    }
    Ok(())
}

fn check_positions(root: &Root) -> Result<(), GltfError> {
    for (m, mesh) in root.meshes.iter().enumerate() {
        for primitive in &mesh.primitives {
            let positions = primitive.attributes.get(&Checked::Valid(Semantic::Positions));
            let Some(accessor) = positions.map(|index| index.value()) else { continue };
            let accessors = root.accessors.len();
            if accessor >= accessors {
                let what = format!("mesh {m} has its positions in accessor {accessor} of {accessors}");
                return Err(GltfError::Unsupported { what });
            }
        }
    }
    Ok(())
}

/// An error of [`gltf`], the first of many.
pub(super) fn refused(error: ::gltf::Error) -> GltfError {
    let ::gltf::Error::Validation(errors) = error else { return GltfError::Syntax(Box::new(error)) };
    let (count, first) = (errors.len(), errors.into_iter().next());
    let first = first.map_or_else(String::new, |(path, error)| format!("{path}: {error}"));
    let more = if count > 1 { format!(", and {} more", count - 1) } else { String::new() };
    GltfError::Unsupported { what: format!("invalid glTF: {first}{more}") }
}

/// How many parts of each kind a document has.
#[derive(serde::Deserialize)]
#[serde(default)]
#[derive(Default)]
struct Counts {
    #[serde(rename = "asset")]
    _asset: Option<Part>,
    accessors: Count,
    animations: Count,
    buffers: Count,
    #[serde(rename = "bufferViews")]
    buffer_views: Count,
    cameras: Count,
    images: Count,
    materials: Count,
    meshes: Count,
    nodes: Count,
    samplers: Count,
    scenes: Count,
    skins: Count,
    textures: Count,
}

impl Counts {
    fn all(self) -> [Count; 13] {
        [
            self.accessors,
            self.animations,
            self.buffers,
            self.buffer_views,
            self.cameras,
            self.images,
            self.materials,
            self.meshes,
            self.nodes,
            self.samplers,
            self.scenes,
            self.skins,
            self.textures,
        ]
    }
}

/// The length of a list.
#[derive(Default)]
struct Count(usize);

impl<'de> Deserialize<'de> for Count {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(Counter)
    }
}

struct Counter;

impl<'de> Visitor<'de> for Counter {
    type Value = Count;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("a list")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Count, A::Error> {
        let mut count = 0;
        while list.next_element::<Part>()?.is_some() {
            count += 1;
        }
        Ok(Count(count))
    }
}

/// An object: a list in its place would be taken for one.
struct Part;

impl<'de> Deserialize<'de> for Part {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(Parts)
    }
}

struct Parts;

impl<'de> Visitor<'de> for Parts {
    type Value = Part;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Part, A::Error> {
        while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
        Ok(Part)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(text: &str) -> String {
        let checked = root(text.as_bytes(), &Limits::default().with_nodes(100));
        let document = checked.and_then(|root| ::gltf::Document::from_json(root).map_err(refused));
        document.map_or_else(|error| error.to_string(), |_| String::new())
    }

    #[test]
    fn data_is_no_text() {
        assert_eq!(without_data(b"{\"uri\":\"data:abc\",\"b\":\"data:\"}"), 27);
        assert_eq!(without_data(b"\"data:abc"), 6);
        assert_eq!(without_data(b"[]"), 2);
    }

    #[test]
    fn what_reading_relies_on_is_checked() {
        let file = |rest: &str| format!("{{\"asset\":{{\"version\":\"2.0\"}},{rest}}}");
        let sampler = "{\"input\":0,\"output\":0}";
        let moves = |channel: &str, sampler: &str| {
            file(&format!(
                "\"nodes\":[{{}}],\"animations\":[{{\"channels\":[{channel}],\"samplers\":[{sampler}]}}]"
            ))
        };
        for (text, words) in [
            (file("\"nodes\":[{}]"), ""),
            (file(&format!("\"nodes\":[{}{{}}]", "{},".repeat(100))), "101 nodes, allowed at most 100"),
            (
                moves("{\"sampler\":0,\"target\":{\"node\":1,\"path\":\"rotation\"}}", sampler),
                "moves node 1 of 1",
            ),
            (
                moves("{\"sampler\":0,\"target\":{\"node\":0,\"path\":\"pointer\"}}", sampler),
                "not known here",
            ),
            (
                moves("{\"sampler\":1,\"target\":{\"node\":0,\"path\":\"rotation\"}}", sampler),
                "sampler 1 of 1",
            ),
            (file("\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":7}}]}]"), "accessor 7 of 0"),
            (file("\"scenes\":[{\"nodes\":[1,2,3,4,5]}]"), "and 4 more"),
            ("[]".to_owned(), "its JSON is no object"),
            ("{\"asset\":[null,null,null,null,null,\"2.0\"]}".to_owned(), "expected an object"),
            (file("\"bufferViews\":[[0,4]]"), "expected an object"),
        ] {
            let found = message(&text);
            assert!(found.contains(words) && found.is_empty() == words.is_empty(), "{text}: {found:?}");
            assert!(found.len() < 300, "{found}");
        }
    }
}
