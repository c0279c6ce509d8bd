//! A rig's file taken apart: checked, its nodes at rest, and everything it refers to in one buffer.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::Read;
use std::path::{Component, Path};

use ::gltf::accessor::{DataType, Dimensions};
use nalgebra::{
    Isometry3, Matrix4, Quaternion, Rotation3, Similarity3, Translation3, UnitQuaternion, Vector3,
};
use serde_json::{Value, json};

use handcast_limits::Limits;

use super::body::{HIPS, words};
use super::hand::RigHand;
use super::{RigError, weights};
use crate::GltfError;
use crate::container::split;
use crate::root::{refused, root};
use crate::source::Source;
use crate::tracks::{is_even, lies_within};

/// Most bytes of buffers and pictures together.
const MAX_BYTES: usize = 1 << 29;
/// Most rows of floats, and of the weights of all primitives, in all.
pub(super) const MAX_ROWS: usize = 64_000_000;
/// Joints that stand turned by more than this against the one above them, from how their skin is bound, are posed: radians.
const POSED: f64 = 0.02;
/// Extensions that store anything, and meshes, where this program does not look.
pub(crate) const PACKED: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];
const DRACO: &str = "KHR_draco_mesh_compression";

pub(super) fn file(what: impl Into<String>) -> RigError {
    RigError::File { what: what.into() }
}

/// A rig's file.
pub(super) struct RigDocument {
    /// The document; buffers and pictures refer to `bytes`.
    pub(super) json: Value,
    /// The one buffer.
    pub(super) bytes: Vec<u8>,
    /// Names of the nodes.
    pub(super) names: Vec<String>,
    /// Which nodes are joints of a skin.
    pub(super) is_joint: Vec<bool>,
    /// Which nodes something visible hangs on: joints that vertices have weights for, and nodes with a mesh of their own.
    pub(super) carries: Vec<bool>,
    /// What is worth saying of the file.
    pub(super) notes: Vec<String>,
    /// Which nodes have scales that are not equal and positive.
    uneven: Vec<bool>,
    /// The node above each.
    pub(super) parents: Vec<Option<usize>>,
    /// Nodes so that each comes after the one above it.
    pub(super) order: Vec<usize>,
    /// Transforms at rest, relative to the node above.
    pub(super) locals: Vec<Similarity3<f64>>,
    /// Transforms as the nodes stand in the file.
    pub(super) world: Vec<Similarity3<f64>>,
    /// Transforms at rest: as the nodes stand, or where these are posed as the skins are bound.
    pub(super) rest: Vec<Similarity3<f64>>,
}

impl RigDocument {
    pub(super) fn read(bytes: &[u8], folder: Option<&Path>, limits: &Limits) -> Result<Self, GltfError> {
        let (text, chunk) = split(bytes)?;
        let mut root = root(text, limits)?;
        let mut json: Value = serde_json::from_slice(text).map_err(|e| file(format!("no glTF: {e}")))?;
        let compressed = |name: &&String| PACKED.contains(&name.as_str()) || *name == DRACO;
        if let Some(name) = root.extensions_required.iter().find(compressed) {
            return Err(file(format!("needs {name}, which is not read: store the mesh uncompressed")).into());
        }
        // Other extensions concern what is passed on untouched.
        root.extensions_required.clear();
        // Checks every index in the document.
        let document = ::gltf::Document::from_json(root).map_err(refused)?;
        let mut bytes = gathered(&mut json, chunk, folder)?;
        gather_pictures(&mut json, &mut bytes, folder)?;
        check_ranges(&json, bytes.len())?;
        check_floats(&json, &bytes)?;
        check_indices(&json, &bytes)?;
        check_matrices(&json)?;
        let weighed = weights::mend(&mut json, &mut bytes)?;
        let mut out = Self::with_nodes(json, bytes, &document)?;
        weighed.joints.into_iter().for_each(|node| out.carries[node] = true);
        out.notes = weighed.notes;
        Ok(out)
    }

    /// The nodes of a file whose motion is read. Without skins any node may be a joint; what is visible hangs on joints that
    /// vertices have weights for, where these can be read, else on nodes that move.
    pub(super) fn of_motion(source: &Source) -> Result<Self, GltfError> {
        let mut json: Value = serde_json::from_slice(source.text)?;
        let mut bytes = source.bytes.to_vec();
        // Where everything lies in the one buffer.
        json["bufferViews"] = serde_json::to_value(&source.document.as_json().buffer_views)?;
        let mut out = Self::with_nodes(json, Vec::new(), &source.document)?;
        if source.document.skins().len() == 0 {
            out.is_joint.fill(true);
        }
        let checked = check_ranges(&out.json, bytes.len());
        let weighed = checked.and_then(|()| weights::mend(&mut out.json, &mut bytes)).map(|w| w.joints);
        let channels = source.document.animations().flat_map(|a| a.channels().collect::<Vec<_>>());
        let moved = || channels.map(|channel| channel.target().node().index()).collect();
        let carriers = weighed.ok().filter(|joints| !joints.is_empty()).unwrap_or_else(moved);
        for node in carriers {
            if let Some(carries) = out.carries.get_mut(node) {
                *carries = true;
            }
        }
        Ok(out)
    }

    /// Lets the joints of each hand rest as its skin is bound, where nodes stand in another pose: the one skin that has its palm
    /// and most of its joints, since skins may be bound in poses of their own.
    pub(super) fn at_bound_rest(mut self, source: &Source, hands: &[RigHand]) -> Self {
        for hand in hands {
            let own: BTreeSet<usize> = hand.nodes().map(|(_, node)| node).collect();
            let (mut best, mut most) = (None, own.len() / 2);
            for skin in source.document.skins() {
                let joints: BTreeSet<usize> = skin.joints().map(|joint| joint.index()).collect();
                let count = own.intersection(&joints).count();
                if count > most
                    && hand.palm_nodes().all(|node| joints.contains(&node))
                    && let Some(bound) = bound(&skin, &source.bytes)
                {
                    (best, most) = (Some(bound), count);
                }
            }
            if let Some(rest) = best.and_then(|bound| self.rest_as_bound(&bound)) {
                own.into_iter().for_each(|node| self.rest[node] = rest[node]);
            }
        }
        self
    }

    /// Where nodes rest as the joints of a skin are bound, and with these what hangs on them; `None` where they stand in that
    /// pose, and not in another one: that of the first frame, say.
    fn rest_as_bound(&self, bound: &BTreeMap<usize, Similarity3<f64>>) -> Option<Vec<Similarity3<f64>>> {
        let above = |node: usize| self.parents[node].filter(|above| bound.contains_key(above));
        let pairs = || bound.iter().filter_map(|(&node, here)| Some((node, here, above(node)?)));
        let posed = pairs().any(|(node, here, above)| {
            let turn = bound[&above].isometry.rotation.inverse() * here.isometry.rotation;
            let stands = self.world[above].isometry.rotation.inverse() * self.world[node].isometry.rotation;
            stands.angle_to(&turn) > POSED
        });
        let apart = |a: &Similarity3<f64>, b: &Similarity3<f64>| {
            (a.isometry.translation.vector - b.isometry.translation.vector).norm()
        };
        let bones = pairs().map(|(node, here, above)| {
            [apart(here, &bound[&above]), apart(&self.world[node], &self.world[above])]
        });
        let [length, wanted] = bones.fold([0.0; 2], |sum, bone| [sum[0] + bone[0], sum[1] + bone[1]]);
        if !posed || length < 1e-9 {
            return None;
        }
        // Meshes may be made in other units.
        let unit = wanted / length;
        let (mut rest, mut carried) = (self.world.clone(), vec![false; self.world.len()]);
        for &node in &self.order {
            let above = self.parents[node].filter(|above| carried[*above]);
            rest[node] = match (bound.get(&node), above) {
                (Some(here), _) => {
                    let mut here = here.isometry;
                    here.translation.vector *= unit;
                    Similarity3::from_isometry(here, self.world[node].scaling())
                }
                (None, Some(above)) => rest[above] * self.locals[node],
                (None, None) => continue,
            };
            carried[node] = true;
        }
        Some(rest)
    }

    fn with_nodes(json: Value, bytes: Vec<u8>, document: &::gltf::Document) -> Result<Self, RigError> {
        let count = document.nodes().len();
        let mut out = Self {
            json,
            bytes,
            names: document.nodes().map(|n| n.name().unwrap_or_default().to_owned()).collect(),
            is_joint: vec![false; count],
            carries: document.nodes().map(|n| n.mesh().is_some() && n.skin().is_none()).collect(),
            notes: Vec::new(),
            uneven: vec![false; count],
            parents: vec![None; count],
            order: Vec::with_capacity(count),
            locals: Vec::with_capacity(count),
            world: vec![Similarity3::identity(); count],
            rest: Vec::new(),
        };
        for joint in document.skins().flat_map(|s| s.joints().map(|j| j.index()).collect::<Vec<_>>()) {
            out.is_joint[joint] = true;
        }
        for node in document.nodes() {
            let (t, [x, y, z, w], scale) = node.transform().decomposed();
            let finite = t.iter().chain(&[x, y, z, w]).chain(&scale).all(|v| v.is_finite());
            let scale = Vector3::from(scale).cast::<f64>();
            if !finite {
                return Err(file(format!("node {} has a transform that is not finite", node.index())));
            }
            out.uneven[node.index()] = !is_even(&scale);
            let turn = UnitQuaternion::try_new(Quaternion::new(w, x, y, z).cast::<f64>(), 1e-6)
                .ok_or_else(|| file(format!("node {} has a rotation of length 0", node.index())))?;
            let shift = Translation3::from(Vector3::from(t).cast::<f64>());
            let scale = scale.mean().abs().max(1e-9);
            out.locals.push(Similarity3::from_isometry(Isometry3::from_parts(shift, turn), scale));
            for child in node.children() {
                if out.parents[child.index()].replace(node.index()).is_some() {
                    return Err(file(format!("node {} has two parents", child.index())));
                }
            }
        }
        let mut children = vec![Vec::new(); count];
        for (child, parent) in out.parents.iter().enumerate() {
            if let Some(parent) = parent {
                children[*parent].push(child);
            }
        }
        let mut next: Vec<usize> = (0..count).filter(|&n| out.parents[n].is_none()).collect();
        while let Some(node) = next.pop() {
            out.order.push(node);
            let above = out.parents[node].map_or_else(Similarity3::identity, |p| out.world[p]);
            out.world[node] = placed(&above, &out.locals[node]).ok_or_else(|| vanishing(node))?;
            next.append(&mut children[node]);
        }
        if out.order.len() < count {
            return Err(file("nodes that are their own ancestors"));
        }
        out.rest.clone_from(&out.world);
        Ok(out)
    }

    /// Whether `node` lies below `above`.
    pub(super) fn is_below(&self, node: usize, above: usize) -> bool {
        let up = |n: &usize| self.parents.get(*n).copied().flatten();
        std::iter::successors(up(&node), up).any(|n| n == above)
    }

    /// The hips that an arm hangs on, by their names, or else the joint that all others hang on.
    pub(super) fn hips(&self, arm: usize) -> usize {
        let up = |n: &usize| self.parents.get(*n).copied().flatten();
        let above = || std::iter::successors(Some(arm), up);
        let is_hips =
            |node: &usize| words(&self.names[*node]).iter().any(|word| HIPS.contains(&word.as_str()));
        above().find(is_hips).or_else(|| above().filter(|node| self.is_joint[*node]).last()).unwrap_or(arm)
    }

    /// A node above this one whose scales are not equal and positive: what is below would be sheared.
    pub(super) fn sheared_by(&self, node: usize) -> Option<usize> {
        let up = |n: &usize| self.parents.get(*n).copied().flatten();
        std::iter::successors(up(&node), up).find(|&n| self.uneven[n])
    }

    /// Gives a node translation, rotation and scale in place of a matrix, which must not be animated.
    pub(super) fn make_movable(&mut self, node: usize) {
        let local = self.locals[node];
        if let Some(object) = self.json["nodes"].get_mut(node).and_then(Value::as_object_mut)
            && object.remove("matrix").is_some()
        {
            let q = local.isometry.rotation.coords;
            let s = local.scaling();
            object.insert("translation".into(), json!(<[f64; 3]>::from(local.isometry.translation.vector)));
            object.insert("rotation".into(), json!([q.x, q.y, q.z, q.w]));
            object.insert("scale".into(), json!([s, s, s]));
        }
    }
}

/// Least scaling in the world.
const LEAST_SCALING: f64 = 1e-30;

/// Where a node is in the world that is `here` against the one `above`; `None` where scales add up to nothing, or beyond numbers.
pub(super) fn placed(above: &Similarity3<f64>, here: &Similarity3<f64>) -> Option<Similarity3<f64>> {
    let scaling = above.scaling() * here.scaling();
    (scaling.is_finite() && scaling >= LEAST_SCALING).then(|| above * here)
}

pub(super) fn vanishing(node: usize) -> RigError {
    file(format!(
        "node {node} is scaled by less than {LEAST_SCALING:e} in all, or by more than there are numbers"
    ))
}

/// Where the joints of a skin are when it is bound; `None` where it does not say, or that is no pose.
fn bound(skin: &::gltf::Skin, bytes: &[u8]) -> Option<BTreeMap<usize, Similarity3<f64>>> {
    let accessor = skin.inverse_bind_matrices()?;
    let sound = accessor.dimensions() == Dimensions::Mat4
        && accessor.data_type() == DataType::F32
        && accessor.sparse().is_none()
        && lies_within(&accessor, bytes.len());
    if !sound {
        return None;
    }
    let matrices = skin.reader(|buffer| (buffer.index() == 0).then_some(bytes)).read_inverse_bind_matrices();
    let place = |(joint, columns): (::gltf::Node, [[f32; 4]; 4])| {
        let matrix = Matrix4::from(columns).cast::<f64>().try_inverse()?;
        let axes = matrix.fixed_view::<3, 3>(0, 0).into_owned();
        let scale = Vector3::from_fn(|k, _| axes.column(k).norm());
        if !(is_even(&scale) && axes.determinant() > 0.0) {
            return None;
        }
        let turn = Rotation3::from_matrix_unchecked(axes / scale.mean());
        let shift = Translation3::from(matrix.fixed_view::<3, 1>(0, 3).into_owned());
        let here = Isometry3::from_parts(shift, UnitQuaternion::from_rotation_matrix(&turn));
        Some((joint.index(), Similarity3::from_isometry(here, 1.0)))
    };
    skin.joints().zip(matrices?).map(place).collect()
}

pub(super) fn list<'a>(json: &'a Value, name: &str) -> impl Iterator<Item = &'a Value> + use<'a> {
    json[name].as_array().into_iter().flatten()
}

pub(super) fn number(value: &Value, key: &str) -> usize {
    value[key].as_u64().and_then(|v| usize::try_from(v).ok()).unwrap_or(0)
}

/// Puts all buffers behind one another, in which the views of the document then lie.
pub(crate) fn gathered(
    json: &mut Value,
    chunk: Option<&[u8]>,
    folder: Option<&Path>,
) -> Result<Vec<u8>, RigError> {
    let mut bytes = Vec::new();
    let mut buffers = Vec::new();
    for (i, buffer) in list(json, "buffers").enumerate() {
        let length = number(buffer, "byteLength");
        let read;
        let data = match buffer["uri"].as_str() {
            Some(uri) => {
                read = resolve(uri, folder)?;
                read.as_slice()
            }
            None if i == 0 => chunk.ok_or_else(|| file("buffer 0 has no data"))?,
            None => return Err(file(format!("buffer {i} has no data"))),
        };
        let data = data
            .get(..length)
            .ok_or_else(|| file(format!("buffer {i} has {} bytes, {length} announced", data.len())))?;
        buffers.push((store(&mut bytes, data)?, length));
    }
    for view in json["bufferViews"].as_array_mut().into_iter().flatten() {
        let (offset, length) = (number(view, "byteOffset"), number(view, "byteLength"));
        let (start, size) =
            buffers.get(number(view, "buffer")).ok_or_else(|| file("a buffer view without its buffer"))?;
        if offset.checked_add(length).is_none_or(|end| end > *size) {
            return Err(file(format!("a buffer view ends beyond its buffer of {size} bytes")));
        }
        view["buffer"] = 0.into();
        view["byteOffset"] = (start + offset).into();
    }
    Ok(bytes)
}

/// Puts all pictures behind the buffers.
fn gather_pictures(json: &mut Value, bytes: &mut Vec<u8>, folder: Option<&Path>) -> Result<(), RigError> {
    let uris: Vec<Option<String>> =
        list(json, "images").map(|i| i["uri"].as_str().map(str::to_owned)).collect();
    for (i, uri) in uris.into_iter().enumerate() {
        let Some(uri) = uri else { continue };
        let data = resolve(&uri, folder)?;
        let kind = match data.as_slice() {
            [0x89, b'P', b'N', b'G', ..] => "image/png",
            [0xff, 0xd8, ..] => "image/jpeg",
            [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => "image/webp",
            [0xab, b'K', b'T', b'X', ..] => "image/ktx2",
            _ => return Err(file(format!("image {i} is neither PNG, JPEG, WebP nor KTX2"))),
        };
        let offset = store(bytes, &data)?;
        let view = json["bufferViews"].as_array().map_or(0, Vec::len);
        super::append(
            json,
            "bufferViews",
            json!({ "buffer": 0, "byteOffset": offset, "byteLength": data.len() }),
        );
        if let Some(image) = json["images"].get_mut(i).and_then(Value::as_object_mut) {
            image.remove("uri");
            image.insert("bufferView".into(), view.into());
            image.insert("mimeType".into(), kind.into());
        }
    }
    Ok(())
}

/// Appends `data` on a multiple of four; the offset.
fn store(bytes: &mut Vec<u8>, data: &[u8]) -> Result<usize, RigError> {
    let start = bytes.len().next_multiple_of(4);
    if start.saturating_add(data.len()) > MAX_BYTES {
        return Err(file(format!("more than {MAX_BYTES} bytes of buffers and pictures")));
    }
    bytes.resize(start, 0);
    bytes.extend_from_slice(data);
    Ok(start)
}

/// The bytes behind a `data:` URI, or of a file in the rig's folder or below.
fn resolve(uri: &str, folder: Option<&Path>) -> Result<Vec<u8>, RigError> {
    if let Some(data) = uri.strip_prefix("data:") {
        let (kind, text) = data.split_once(',').ok_or_else(|| file("a data URI without a comma"))?;
        if !kind.ends_with(";base64") {
            return Err(file("a data URI that is not base64"));
        }
        return base64(text).ok_or_else(|| file("a data URI with damaged base64"));
    }
    let name = percent_decoded(uri).ok_or_else(|| file(format!("{uri:?} is no file name")))?;
    let path = Path::new(&name);
    let inside = path.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
    if !inside || name.contains(':') || name.contains('\\') {
        return Err(file(format!("refers to {name:?}, allowed are files in its own folder")));
    }
    let folder = folder.ok_or_else(|| file(format!("refers to {name:?}, which cannot be looked up")))?;
    let error = |e: std::io::Error| file(format!("{}: {e}", folder.join(path).display()));
    let mut bytes = Vec::new();
    // Opening a pipe would wait for what it is given.
    if !std::fs::metadata(folder.join(path)).map_err(error)?.is_file() {
        return Err(file(format!("{}: not a regular file", folder.join(path).display())));
    }
    let opened = File::open(folder.join(path)).map_err(error)?;
    opened.take(MAX_BYTES as u64 + 1).read_to_end(&mut bytes).map_err(error)?;
    Ok(bytes)
}

fn percent_decoded(uri: &str) -> Option<String> {
    let mut out = Vec::with_capacity(uri.len());
    let mut rest = uri.bytes();
    while let Some(byte) = rest.next() {
        out.push(match byte {
            b'%' => {
                let digits = [rest.next()?, rest.next()?];
                u8::from_str_radix(std::str::from_utf8(&digits).ok()?, 16).ok()?
            }
            other => other,
        });
    }
    String::from_utf8(out).ok()
}

/// RFC 4648, section 4.
fn base64(text: &str) -> Option<Vec<u8>> {
    let text = text.trim_end_matches('=');
    let mut out = Vec::with_capacity(text.len() / 4 * 3 + 3);
    let (mut held, mut bits) = (0u32, 0);
    for byte in text.bytes() {
        let value = match byte {
            b'A'..=b'Z' => byte - b'A',
            b'a'..=b'z' => byte - b'a' + 26,
            b'0'..=b'9' => byte - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            _ => return None,
        };
        held = held << 6 | u32::from(value);
        bits += 6;
        if bits >= 8 {
            bits -= 8;
            out.push((held >> bits) as u8);
            held &= (1 << bits) - 1;
        }
    }
    Some(out)
}

/// Bytes of one component.
fn component_size(accessor: &Value) -> usize {
    match number(accessor, "componentType") {
        5120 | 5121 => 1,
        5122 | 5123 => 2,
        _ => 4,
    }
}

fn row_size(accessor: &Value) -> usize {
    let components = match accessor["type"].as_str() {
        Some("VEC2") => 2,
        Some("VEC3") => 3,
        Some("VEC4" | "MAT2") => 4,
        Some("MAT3") => 9,
        Some("MAT4") => 16,
        _ => 1,
    };
    components * component_size(accessor)
}

/// Where the rows of an accessor lie: offset of the first, and bytes from one to the next.
pub(super) fn layout(json: &Value, accessor: &Value) -> Option<(usize, usize)> {
    let view = json["bufferViews"].get(accessor["bufferView"].as_u64()? as usize)?;
    let stride = match number(view, "byteStride") {
        0 => row_size(accessor),
        stride => stride,
    };
    Some((number(view, "byteOffset").checked_add(number(accessor, "byteOffset"))?, stride))
}

/// Every accessor lies in its view, every view in the buffer.
fn check_ranges(json: &Value, size: usize) -> Result<(), RigError> {
    for (i, accessor) in list(json, "accessors").enumerate() {
        let count = number(accessor, "count");
        let Some(view) = accessor["bufferView"].as_u64() else { continue };
        let end = layout(json, accessor).and_then(|(start, stride)| {
            start.checked_add(count.checked_sub(1)?.checked_mul(stride)?)?.checked_add(row_size(accessor))
        });
        let view = &json["bufferViews"][view as usize];
        let allowed = number(view, "byteOffset").saturating_add(number(view, "byteLength")).min(size);
        if count > 0 && end.is_none_or(|end| end > allowed) {
            return Err(file(format!("accessor {i} ends beyond its buffer view")));
        }
    }
    Ok(())
}

/// Floats are finite.
fn check_floats(json: &Value, bytes: &[u8]) -> Result<(), RigError> {
    let floats = list(json, "accessors").enumerate().filter(|(_, a)| number(a, "componentType") == 5126);
    // Accessors may share their numbers.
    let (mut checked, mut numbers) = (BTreeSet::new(), 0);
    for (i, accessor) in floats {
        let Some((start, stride)) = layout(json, accessor) else { continue };
        let (size, count) = (row_size(accessor), number(accessor, "count"));
        if !checked.insert((start, stride, size, count)) {
            continue;
        }
        numbers += count;
        if numbers > MAX_ROWS {
            return Err(file(format!("accessors have more than {MAX_ROWS} rows of floats")));
        }
        for row in 0..count {
            let at = start + row * stride;
            let numbers = bytes.get(at..at + size).unwrap_or_default().chunks_exact(4);
            let mut numbers = numbers.map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
            if let Some(wrong) = numbers.find(|number| !number.is_finite()) {
                return Err(file(format!("accessor {i}, row {row}: {wrong} is not finite")));
            }
        }
    }
    Ok(())
}

/// Indices are those of vertices, three for each triangle.
fn check_indices(json: &Value, bytes: &[u8]) -> Result<(), RigError> {
    let mut checked = BTreeSet::new();
    for (m, mesh) in list(json, "meshes").enumerate() {
        for primitive in list(mesh, "primitives") {
            let accessor = |index: &Value| Some(&json["accessors"][index.as_u64()? as usize]);
            let vertices = accessor(&primitive["attributes"]["POSITION"]).map_or(0, |a| number(a, "count"));
            let indices = accessor(&primitive["indices"]);
            let count = indices.map_or(vertices, |indices| number(indices, "count"));
            let triangles = primitive["mode"].as_u64().unwrap_or(4) == 4;
            if triangles && count % 3 != 0 {
                return Err(file(format!(
                    "mesh {m} has {count} corners, allowed are three for each triangle"
                )));
            }
            let Some(indices) = indices else { continue };
            if !checked.insert((primitive["indices"].as_u64(), vertices)) {
                continue;
            }
            let Some((start, stride)) = layout(json, indices) else { continue };
            let index = |row: usize| {
                let at = start + row * stride;
                let mut wide = [0; 4];
                let data = bytes.get(at..at + component_size(indices))?;
                wide.get_mut(..data.len())?.copy_from_slice(data);
                Some(u32::from_le_bytes(wide))
            };
            let beyond = (0..count).filter_map(index).find(|index| *index as usize >= vertices);
            if let Some(index) = beyond {
                return Err(file(format!("mesh {m} uses vertex {index} of {vertices}")));
            }
        }
    }
    Ok(())
}

/// Each joint of a skin has an inverse bind matrix, where there are any.
fn check_matrices(json: &Value) -> Result<(), RigError> {
    for (s, skin) in list(json, "skins").enumerate() {
        let Some(matrices) = skin["inverseBindMatrices"].as_u64() else { continue };
        let accessor = &json["accessors"][matrices as usize];
        let joints = skin["joints"].as_array().map_or(0, Vec::len);
        let count = number(accessor, "count");
        if count < joints || accessor["type"] != "MAT4" {
            return Err(file(format!("skin {s} has {count} inverse bind matrices for {joints} joints")));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_read() {
        for (text, bytes) in [("", &b""[..]), ("Zg==", b"f"), ("Zm8=", b"fo"), ("Zm9vYmFy", b"foobar")] {
            assert_eq!(base64(text).as_deref(), Some(bytes));
        }
        assert_eq!(base64("Zm9*"), None);
    }

    #[test]
    fn only_files_of_its_own_folder_are_opened() {
        let folder = Path::new("/nowhere");
        for uri in ["../x.bin", "/etc/x", "a/../../x", "%2e%2e/x", "http://host/x", "..\\x"] {
            let message = resolve(uri, Some(folder)).unwrap_err().to_string();
            assert!(message.contains("allowed are files in its own folder"), "{message}");
        }
        assert!(resolve("a%20b.bin", Some(folder)).unwrap_err().to_string().contains("a b.bin"));
        assert!(resolve("x.bin", None).is_err());
    }
}
