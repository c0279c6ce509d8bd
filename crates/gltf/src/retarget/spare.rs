//! What only the animations of a rig need, which are left out: their accessors, views and bytes.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;

use super::document::{list, number};

/// Beginnings of names of extensions that refer to no accessor and no view.
const HARMLESS: [&str; 12] = [
    "KHR_materials_",
    "KHR_texture_",
    "KHR_mesh_quantization",
    "KHR_lights_punctual",
    "KHR_animation_pointer",
    "KHR_node_",
    "KHR_xmp",
    "EXT_texture_",
    "EXT_materials_",
    "MSFT_texture_dds",
    "VRM",
    "MTOON",
];

/// Takes the animations out of a document, with the data that nothing else uses. Where an extension might use it, the data
/// stays.
pub(super) fn drop_animations(json: &mut Value, bytes: &mut Vec<u8>) {
    let Some(animations) = json.as_object_mut().and_then(|json| json.remove("animations")) else { return };
    let harmless = |name: &Value| HARMLESS.iter().any(|h| name.as_str().is_some_and(|n| n.starts_with(h)));
    if !list(json, "extensionsUsed").all(harmless) {
        return;
    }
    let samplers =
        animations.as_array().into_iter().flatten().flat_map(|animation| list(animation, "samplers"));
    let ends = samplers.flat_map(|sampler| [&sampler["input"], &sampler["output"]]);
    let mut spare: BTreeSet<usize> = ends.filter_map(index).collect();
    each_accessor(json, &mut |accessor| {
        index(accessor).map(|used| spare.remove(&used));
    });
    let spare_views: BTreeSet<usize> = views_of(json, |accessor| spare.contains(&accessor)).collect();
    let used: BTreeSet<usize> = views_of(json, |accessor| !spare.contains(&accessor))
        .chain(list(json, "images").filter_map(|image| index(&image["bufferView"])))
        .collect();
    let spare_views: BTreeSet<usize> = spare_views.difference(&used).copied().collect();
    let accessors = remove(json, "accessors", &spare);
    let views = remove(json, "bufferViews", &spare_views);
    each_accessor(json, &mut |accessor| renumber(accessor, &accessors));
    each_view(json, &mut |view| renumber(view, &views));
    compact(json, bytes);
}

fn index(value: &Value) -> Option<usize> {
    value.as_u64().and_then(|value| usize::try_from(value).ok())
}

/// The views of the accessors that are asked for, by their numbers.
fn views_of(json: &Value, asked: impl Fn(usize) -> bool) -> impl Iterator<Item = usize> {
    let accessors = list(json, "accessors").enumerate().filter(move |(number, _)| asked(*number));
    accessors
        .flat_map(|(_, accessor)| {
            let sparse = &accessor["sparse"];
            [accessor, &sparse["indices"], &sparse["values"]].map(|part| index(&part["bufferView"]))
        })
        .flatten()
}

/// Every number of an accessor, without animations.
fn each_accessor(json: &mut Value, see: &mut dyn FnMut(&mut Value)) {
    for mesh in items(json, "meshes") {
        for primitive in items(mesh, "primitives") {
            let attributes = |of: &mut Value, see: &mut dyn FnMut(&mut Value)| {
                of.as_object_mut().into_iter().flatten().for_each(|(_, accessor)| see(accessor));
            };
            if let Some(of) = primitive.get_mut("attributes") {
                attributes(of, see);
            }
            items(primitive, "targets").for_each(|target| attributes(target, see));
            primitive.get_mut("indices").into_iter().for_each(&mut *see);
        }
    }
    for skin in items(json, "skins") {
        skin.get_mut("inverseBindMatrices").into_iter().for_each(&mut *see);
    }
}

/// Every number of a view.
fn each_view(json: &mut Value, see: &mut dyn FnMut(&mut Value)) {
    for accessor in items(json, "accessors") {
        accessor.get_mut("bufferView").into_iter().for_each(&mut *see);
        let Some(sparse) = accessor.get_mut("sparse") else { continue };
        for part in ["indices", "values"] {
            sparse.get_mut(part).and_then(|part| part.get_mut("bufferView")).into_iter().for_each(&mut *see);
        }
    }
    for image in items(json, "images") {
        image.get_mut("bufferView").into_iter().for_each(&mut *see);
    }
}

fn items<'a>(json: &'a mut Value, name: &str) -> impl Iterator<Item = &'a mut Value> + use<'a> {
    json.get_mut(name).and_then(Value::as_array_mut).into_iter().flatten()
}

/// Takes these out of a list; gives the new number of each that there was, of one that is gone that of the next.
fn remove(json: &mut Value, name: &str, spare: &BTreeSet<usize>) -> Vec<usize> {
    let Some(list) = json.get_mut(name).and_then(Value::as_array_mut) else { return Vec::new() };
    let mut kept = 0;
    let numbers: Vec<usize> = (0..list.len())
        .map(|old| {
            let new = kept;
            kept += usize::from(!spare.contains(&old));
            new
        })
        .collect();
    let mut number = 0..;
    list.retain(|_| number.next().is_none_or(|number| !spare.contains(&number)));
    // A list without items is no glTF.
    if list.is_empty()
        && let Some(json) = json.as_object_mut()
    {
        json.remove(name);
    }
    numbers
}

fn renumber(value: &mut Value, numbers: &[usize]) {
    if let Some(new) = index(value).and_then(|old| numbers.get(old)) {
        *value = (*new).into();
    }
}

/// Leaves out bytes that no view has; places in words of four stay such.
fn compact(json: &mut Value, bytes: &mut Vec<u8>) {
    let range = |view: &Value| {
        let start = number(view, "byteOffset");
        (start, start + number(view, "byteLength"))
    };
    let mut kept: Vec<(usize, usize)> = Vec::new();
    let ranges: BTreeSet<_> = list(json, "bufferViews").map(range).collect();
    for (start, end) in ranges {
        match kept.last_mut() {
            Some((_, last)) if start <= *last => *last = end.max(*last),
            _ => kept.push((start, end)),
        }
    }
    let mut out = Vec::with_capacity(kept.iter().map(|(start, end)| end - start + 4).sum());
    let mut moved = BTreeMap::new();
    for (start, end) in kept {
        let to = out.len() + (start + 4 - out.len() % 4) % 4;
        out.resize(to, 0);
        moved.insert(start, to);
        out.extend_from_slice(bytes.get(start..end).unwrap_or_default());
    }
    for view in items(json, "bufferViews") {
        let old = number(view, "byteOffset");
        if let Some((start, to)) = moved.range(..=old).next_back() {
            view["byteOffset"] = (to + old - start).into();
        }
    }
    *bytes = out;
}
