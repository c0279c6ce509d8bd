//! The weights of a rig's vertices: which joints carry them, and those that do not add up to 1 scaled to do so.

use std::collections::{BTreeMap, BTreeSet};

use handcast_limits::quoted;
use serde_json::Value;

use super::RigError;
use super::document::{MAX_ROWS, file, layout, list, number};

/// Most vertices of a primitive.
const MAX_VERTICES: usize = 4_000_000;
/// How far the weights of a vertex may be from adding up to 1, for each that is not zero (glTF 2.0, 3.7.3.3).
const SLACK: f64 = 2e-7;
/// Most sets of four joints and weights that a vertex has here.
const SETS: usize = 8;

/// What was found.
#[derive(Default)]
pub(super) struct Weighed {
    /// Nodes that vertices have weights for.
    pub(super) joints: BTreeSet<usize>,
    /// What was mended, and where.
    pub(super) notes: Vec<String>,
}

/// The attributes of a skinned primitive.
struct Primitive<'a> {
    /// What messages call it.
    name: &'a str,
    /// Nodes of the joints of its skin.
    skin: &'a [usize],
    weights: Vec<Rows>,
    carriers: Vec<Rows>,
}

/// Rows of four numbers.
#[derive(Clone, Copy)]
struct Rows {
    start: usize,
    stride: usize,
    count: usize,
    /// Bytes of a number.
    size: usize,
    /// Number of the accessor.
    accessor: usize,
    /// What stands for a weight of 1.
    full: f64,
    float: bool,
}

impl Rows {
    /// The rows of an accessor; `None` for one that is sparse, or of another shape.
    fn of(json: &Value, accessor: usize) -> Option<Self> {
        let told = json["accessors"].get(accessor).filter(|told| told["sparse"].is_null())?;
        let (start, stride) = layout(json, told)?;
        let (size, full) = match number(told, "componentType") {
            5121 => (1, 255.0),
            5123 => (2, 65535.0),
            5126 => (4, 1.0),
            _ => return None,
        };
        let row = told["type"] == "VEC4" && stride >= 4 * size;
        row.then(|| Self {
            start,
            stride,
            count: number(told, "count"),
            size,
            accessor,
            full,
            float: size == 4,
        })
    }

    /// One row, of integers as they are stored.
    fn row(&self, bytes: &[u8], vertex: usize) -> [f64; 4] {
        let start = self.start + vertex * self.stride;
        std::array::from_fn(|k| match bytes.get(start + k * self.size..start + (k + 1) * self.size) {
            Some(&[a, b, c, d]) if self.float => f64::from(f32::from_le_bytes([a, b, c, d])),
            Some(&[a]) => f64::from(a),
            Some(&[a, b]) => f64::from(u16::from_le_bytes([a, b])),
            _ => f64::NAN,
        })
    }

    /// Stores a row of numbers as [`Rows::row`] has them.
    fn put(&self, bytes: &mut [u8], vertex: usize, row: &[f64]) {
        for (k, value) in row.iter().enumerate() {
            let start = self.start + vertex * self.stride + k * self.size;
            let Some(slot) = bytes.get_mut(start..start + self.size) else { continue };
            match (self.float, self.size) {
                (true, _) => slot.copy_from_slice(&(*value as f32).to_le_bytes()),
                (false, 1) => slot.copy_from_slice(&[*value as u8]),
                (false, _) => slot.copy_from_slice(&(*value as u16).to_le_bytes()),
            }
        }
    }
}

/// Scales the weights of vertices that do not add up to 1, as viewers do; a vertex without any goes to the first of its
/// joints.
///
/// # Errors
/// Weights that are negative or not finite, joints that the skin does not have.
pub(super) fn mend(json: &mut Value, bytes: &mut [u8]) -> Result<Weighed, RigError> {
    let mut out = Weighed::default();
    let mut changed = BTreeSet::new();
    let (shared, mut rows_left) = (shared(json), MAX_ROWS);
    let skinned = |node: &Value| Some((node["mesh"].as_u64()?, node["skin"].as_u64()?));
    for (mesh, skin) in list(json, "nodes").filter_map(skinned).collect::<BTreeSet<_>>() {
        let joints = json["skins"][skin as usize]["joints"].as_array().into_iter().flatten();
        let joints: Vec<usize> = joints.filter_map(Value::as_u64).map(|node| node as usize).collect();
        let mesh_json = &json["meshes"][mesh as usize];
        let title = mesh_json["name"].as_str().map_or_else(|| mesh.to_string(), quoted);
        let mut checked = BTreeSet::new();
        for (p, primitive) in list(mesh_json, "primitives").enumerate() {
            let [weights, carriers] = ["WEIGHTS", "JOINTS"].map(|word| sets(primitive, word));
            if weights.is_empty() {
                continue;
            }
            if !checked.insert((weights.clone(), carriers.clone())) {
                continue;
            }
            let rows =
                |sets: &[usize]| -> Option<Vec<Rows>> { sets.iter().map(|a| Rows::of(json, *a)).collect() };
            let (Some(weights), Some(carriers)) = (rows(&weights), rows(&carriers)) else {
                // Others are passed on as they are.
                out.joints.extend(&joints);
                continue;
            };
            let name = format!("mesh {title}, primitive {p}");
            let primitive = Primitive { name: &name, skin: &joints, weights, carriers };
            rows_left = rows_left
                .checked_sub(primitive.count() * primitive.weights.len())
                .ok_or_else(|| file(format!("skins have more than {MAX_ROWS} rows of weights")))?;
            let before = changed.len();
            primitive.mend(bytes, &mut out, &mut changed)?;
            if changed.len() > before && primitive.weights.iter().any(|rows| shared.contains(&rows.accessor))
            {
                let what = format!(
                    "{name}: its weights do not add up to 1, and stand in other sets of weights, too"
                );
                return Err(file(what));
            }
        }
    }
    // Bounds are stated at will here.
    for accessor in changed {
        if let Some(accessor) = json["accessors"].get_mut(accessor).and_then(Value::as_object_mut) {
            accessor.remove("min");
            accessor.remove("max");
        }
    }
    Ok(out)
}

/// The accessors of a primitive's sets of weights, or of joints.
fn sets(primitive: &Value, word: &str) -> Vec<usize> {
    let at = |k| primitive["attributes"][format!("{word}_{k}")].as_u64();
    (0..SETS).map_while(at).map(|accessor| accessor as usize).collect()
}

/// Accessors that are in several sets of weights, or are joints as well: scaled for one they would be wrong for another.
fn shared(json: &Value) -> BTreeSet<usize> {
    let mut used: BTreeMap<usize, BTreeSet<Vec<usize>>> = BTreeMap::new();
    let mut shared = BTreeSet::new();
    for primitive in list(json, "meshes").flat_map(|mesh| list(mesh, "primitives")) {
        let weights = sets(primitive, "WEIGHTS");
        for accessor in &weights {
            used.entry(*accessor).or_default().insert(weights.clone());
        }
        shared.extend(sets(primitive, "JOINTS"));
    }
    shared.extend(used.into_iter().filter(|(_, sets)| sets.len() > 1).map(|(accessor, _)| accessor));
    shared
}

impl Primitive<'_> {
    /// Vertices that have weights and joints.
    fn count(&self) -> usize {
        self.weights.iter().chain(&self.carriers).map(|rows| rows.count).min().unwrap_or(0)
    }

    fn mend(
        &self,
        bytes: &mut [u8],
        out: &mut Weighed,
        changed: &mut BTreeSet<usize>,
    ) -> Result<(), RigError> {
        let count = self.count();
        if count > MAX_VERTICES {
            let what = format!("{} has {count} vertices, allowed at most {MAX_VERTICES}", self.name);
            return Err(file(what));
        }
        let mut carries = vec![false; self.skin.len()];
        let mut first: Option<(usize, f64)> = None;
        let mut wrong = 0;
        for vertex in 0..count {
            let shares = self.shares(bytes, vertex)?;
            let carriers = self.carriers.iter().flat_map(|rows| rows.row(bytes, vertex));
            for (k, joint) in carriers.enumerate() {
                if !(0.0..self.skin.len() as f64).contains(&joint) {
                    let joints = self.skin.len();
                    let what = format!("{}, vertex {vertex}: joint {joint} of a skin of {joints}", self.name);
                    return Err(file(what));
                }
                carries[joint as usize] |= shares.get(k).is_some_and(|share| *share > 0.0);
            }
            let used = shares.iter().filter(|share| **share != 0.0).count().max(1);
            let sum: f64 = shares.iter().sum();
            if (sum - 1.0).abs() > SLACK * used as f64 {
                first = first.or(Some((vertex, sum)));
                wrong += 1;
                self.scale(bytes, vertex, sum);
                changed.extend(self.weights.iter().map(|rows| rows.accessor));
            }
        }
        out.joints
            .extend(self.skin.iter().zip(carries).filter(|(_, carries)| *carries).map(|(node, _)| *node));
        if let Some((vertex, sum)) = first {
            out.notes.push(format!(
                "{}: weights of {wrong} of {count} vertices are scaled to add up to 1 (those of vertex {vertex} add up to {sum})",
                self.name
            ));
        }
        Ok(())
    }

    /// All weights of a vertex, shares of 1.
    fn shares(&self, bytes: &[u8], vertex: usize) -> Result<Vec<f64>, RigError> {
        let of = |rows: &Rows| rows.row(bytes, vertex).map(|value| value / rows.full);
        let shares: Vec<f64> = self.weights.iter().flat_map(of).collect();
        match shares.iter().find(|share| !(0.0..f64::INFINITY).contains(*share)) {
            Some(share) => {
                let what = format!("{}, vertex {vertex}: weight {share}, allowed from 0 on", self.name);
                Err(file(what))
            }
            None => Ok(shares),
        }
    }

    /// Scales the weights of a vertex that add up to `sum`.
    fn scale(&self, bytes: &mut [u8], vertex: usize, sum: f64) {
        let mut rows: Vec<[f64; 4]> = self.weights.iter().map(|rows| rows.row(bytes, vertex)).collect();
        if sum > 0.0 {
            rows.iter_mut().flatten().for_each(|value| *value /= sum);
        } else if let Some(value) = rows.first_mut().map(|row| &mut row[0]) {
            *value = self.weights[0].full;
        }
        // What rounding to integers takes or adds goes to the largest weight, when all are in the same steps.
        let full = self.weights[0].full;
        if self.weights.iter().all(|rows| !rows.float && rows.full == full) {
            rows.iter_mut().flatten().for_each(|value| *value = value.round());
            let rest = full - rows.iter().flatten().sum::<f64>();
            if let Some(largest) = rows.iter_mut().flatten().max_by(|a, b| a.total_cmp(b)) {
                *largest += rest;
            }
        }
        for (to, row) in self.weights.iter().zip(&rows) {
            to.put(bytes, vertex, row);
        }
    }
}
