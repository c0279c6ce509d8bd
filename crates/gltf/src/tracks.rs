//! How nodes move: the channels of an animation of any program.

use std::collections::{BTreeSet, HashMap};
use std::rc::Rc;

use ::gltf::accessor::{Accessor, DataType, Dimensions};
use ::gltf::animation::util::ReadOutputs;
use ::gltf::animation::{Animation, Channel, Interpolation, Property, Reader};
use nalgebra::{Quaternion, Similarity3, Translation3, UnitQuaternion, Vector3, Vector4};

use super::GltfError;
use super::keys::Key;
use handcast_limits::{Limit, Limits, quoted};

/// Between two keys.
#[derive(Clone, Debug, Default)]
enum Way {
    /// On the shortest way.
    #[default]
    Linear,
    /// The value of the former one.
    Step,
    /// A cubic spline with these tangents before and behind each key, a second.
    Spline(Vec<[Vector4<f64>; 2]>),
}

/// How much later than an instant a step may be that is meant, seconds, and as a share of its time.
const EARLY: [f64; 2] = [1e-6, 2e-7];

/// A value over time, held before the first and after the last key.
#[derive(Clone, Debug)]
struct Curve<K> {
    /// Those of its accessor, which curves share.
    times: Rc<[f64]>,
    keys: Vec<K>,
    way: Way,
}

impl<K> Default for Curve<K> {
    fn default() -> Self {
        Self { times: Rc::default(), keys: Vec::new(), way: Way::default() }
    }
}

impl<K: Key> Curve<K> {
    fn at(&self, time: f64) -> Option<K> {
        // A step is there when its time is, however it was rounded.
        let early = if matches!(self.way, Way::Step) { EARLY[0] + EARLY[1] * time.abs() } else { 0.0 };
        let after = self.times.partition_point(|t| *t <= time + early);
        let (before, next) = match (after.checked_sub(1), self.times.get(after)) {
            (None, _) => return self.keys.first().copied(),
            (Some(before), None) => return self.keys.get(before).copied(),
            (Some(before), Some(next)) => (before, *next),
        };
        let (from, to) = (self.keys.get(before)?, self.keys.get(after)?);
        let span = next - self.times[before];
        let t = (time - self.times[before]) / span;
        Some(match &self.way {
            Way::Step => *from,
            Way::Linear => from.between(to, t),
            Way::Spline(tangents) => {
                let (leave, reach) = (tangents.get(before)?[1] * span, tangents.get(after)?[0] * span);
                let (a, b) = (from.numbers(), to.numbers());
                let (t2, t3) = (t * t, t * t * t);
                K::of_numbers(
                    a * (2.0 * t3 - 3.0 * t2 + 1.0)
                        + leave * (t3 - 2.0 * t2 + t)
                        + b * (3.0 * t2 - 2.0 * t3)
                        + reach * (t3 - t2),
                )
            }
        })
    }
}

/// Values of one node over time; empty where no channel moves it.
#[derive(Clone, Default)]
pub(super) struct NodeTrack {
    turns: Curve<UnitQuaternion<f64>>,
    shifts: Curve<Vector3<f64>>,
    scales: Curve<Vector3<f64>>,
}

impl NodeTrack {
    /// Whether a channel turns the node.
    pub(super) fn turns(&self) -> bool {
        !self.turns.times.is_empty()
    }

    /// How the node is turned against the one above it, where a channel tells.
    pub(super) fn turn_at(&self, time: f64) -> Option<UnitQuaternion<f64>> {
        self.turns.at(time)
    }

    /// Where the node is against the one above it; what no channel tells is as at rest, and so is a scaling that a spline takes
    /// to 0 or below between keys.
    pub(super) fn at(&self, rest: &Similarity3<f64>, time: f64) -> Similarity3<f64> {
        let turn = self.turn_at(time).unwrap_or(rest.isometry.rotation);
        let shift = self.shifts.at(time).unwrap_or(rest.isometry.translation.vector);
        let scale = self.scales.at(time).map(|scale| scale.mean()).filter(|mean| *mean > LEAST_SCALE);
        let scale = scale.unwrap_or_else(|| rest.scaling());
        Similarity3::from_parts(Translation3::from(shift), turn, scale)
    }

    /// Refuses keys that scale the node along its axes by what is not equal and positive: what is below would be sheared.
    ///
    /// # Errors
    /// [`GltfError::Unsupported`].
    pub(super) fn check_scales(&self, node: usize, name: &str) -> Result<(), GltfError> {
        if self.scales.keys.iter().all(is_even) {
            return Ok(());
        }
        let name = quoted(name);
        Err(unsupported(format!("node {node} ({name}) is scaled by amounts that are not equal and positive")))
    }
}

/// How far a node's scales along its axes may differ.
const UNEVEN: f64 = 1e-3;
/// Scales that are not above this are none.
const LEAST_SCALE: f64 = 1e-9;

/// Whether scales along the three axes are equal and positive.
pub(super) fn is_even(scale: &Vector3<f64>) -> bool {
    (scale.max() - scale.min()).abs() <= UNEVEN * scale.max() && scale.min() > LEAST_SCALE
}

/// How some nodes move.
pub(super) struct Tracks {
    /// Of each node that was asked for.
    pub(super) nodes: Vec<NodeTrack>,
    /// All times of their keys, in order.
    pub(super) times: Vec<f64>,
    /// Whether values lie on the shortest way between keys.
    straight: bool,
}

/// The animation that is read, and what is worth saying of the choice: the first that turns one of the hands' `own` nodes, or
/// else that moves one of `nodes`.
pub(super) fn moving<'a>(
    document: &'a ::gltf::Document,
    own: &BTreeSet<usize>,
    nodes: &BTreeSet<usize>,
) -> Result<(Animation<'a>, Option<String>), GltfError> {
    let count = document.animations().len();
    let turns = |channel: Channel| {
        let target = channel.target();
        target.property() == Property::Rotation && own.contains(&target.node().index())
    };
    // Weights of morph targets move no joint.
    let moves = |channel: Channel| {
        let target = channel.target();
        target.property() != Property::MorphTargetWeights && nodes.contains(&target.node().index())
    };
    let first = document.animations().find(|animation| animation.channels().any(turns));
    let first = first.or_else(|| document.animations().find(|animation| animation.channels().any(moves)));
    let Some(animation) = first else {
        let what = match count {
            0 => "no animation".to_owned(),
            count => format!("none of the animations, of which there are {count}, moves a hand"),
        };
        return Err(GltfError::Unsupported { what });
    };
    let number = animation.index() + 1;
    let name = animation.name().map_or_else(String::new, |name| format!(", {}", quoted(name)));
    let note = (count > 1)
        .then(|| format!("animation {number} of {count}{name}, is read: the first that moves a hand"));
    Ok((animation, note))
}

/// Keys of all channels together, for each instant that is allowed; and bytes of a file that tell of one more.
const KEYS_PER_INSTANT: u64 = 50;
const BYTES_PER_KEY: u64 = 4;

/// How an animation moves each of `nodes`.
pub(super) fn read_tracks(
    animation: &Animation,
    blob: &[u8],
    nodes: &[usize],
    limits: &Limits,
) -> Result<Tracks, GltfError> {
    let place: HashMap<usize, usize> = nodes.iter().enumerate().map(|(i, n)| (*n, i)).collect();
    let mut out =
        Tracks { nodes: vec![NodeTrack::default(); nodes.len()], times: Vec::new(), straight: true };
    // Channels may share their accessors, and accessors their bytes.
    let most = limits.instants.saturating_mul(KEYS_PER_INSTANT).max(blob.len() as u64 / BYTES_PER_KEY);
    let (mut keys, mut times) = (0u64, HashMap::new());
    for channel in animation.channels() {
        let (node, path) = (channel.target().node().index(), channel.target().property());
        let Some(track) = place.get(&node).and_then(|&i| out.nodes.get_mut(i)) else { continue };
        if path == Property::MorphTargetWeights {
            continue;
        }
        let (what, known) = match path {
            Property::Rotation => ("turn", &track.turns.times),
            Property::Scale => ("scale", &track.scales.times),
            _ => ("shift", &track.shifts.times),
        };
        if !known.is_empty() {
            return Err(unsupported(format!("two channels {what} node {node}, allowed is one")));
        }
        limits.check_count(
            Limit::Instants,
            channel.sampler().input().count().max(channel.sampler().output().count() / 3),
        )?;
        keys = keys.saturating_add(channel.sampler().output().count() as u64);
        if keys > most {
            let what = format!("{keys} keys in the channels of an animation, allowed at most {most}");
            return Err(unsupported(what));
        }
        check_channel(&channel, blob.len())?;
        out.straight &= channel.sampler().interpolation() == Interpolation::Linear;
        let input = channel.sampler().input().index();
        let known = match times.get(&input) {
            Some(known) => Rc::clone(known),
            None => {
                let read = read_times(&channel, blob)?;
                out.times.extend(&*read);
                times.insert(input, Rc::clone(&read));
                read
            }
        };
        read_channel(&channel, known, blob, track)?;
        // Tracks share most of their times: what is twice does not pile up.
        if out.times.len() as u64 > limits.instants.saturating_mul(2) {
            tidy(&mut out.times);
            limits.check_count(Limit::Instants, out.times.len())?;
        }
    }
    tidy(&mut out.times);
    limits.check_count(Limit::Instants, out.times.len())?;
    let span = out.times.first().zip(out.times.last()).map_or(0.0, |(first, last)| last - first);
    limits.check(Limit::Seconds, span)?;
    Ok(out)
}

/// Keys at fewer instants a second are too few for poses between them to be joined.
const SPARSE: f64 = 20.0;
/// Instants a second in their place, at least, and where keys have no beat.
const DENSE: f64 = 30.0;
const BEATLESS: f64 = 60.0;
/// Most keys a second that are a beat.
const FASTEST: f64 = 240.0;

impl Tracks {
    /// Instants at which to take poses of a file that another program wrote: the keys, or where these are few or not joined by
    /// the shortest way, even ones among which keys lie as long as they have a beat, and how many a second.
    ///
    /// # Errors
    /// [`GltfError::Excess`].
    pub(super) fn instants(&self, limits: &Limits) -> Result<(Vec<f64>, Option<f64>), GltfError> {
        let steps = self.times.windows(2).map(|pair| pair[1] - pair[0]);
        let Some(step) = steps.reduce(f64::min) else { return Ok((self.times.clone(), None)) };
        let (first, last) = (self.times[0], self.times[self.times.len() - 1]);
        let beat = Some(1.0 / step).filter(|beat| *beat <= FASTEST);
        if self.straight && beat.is_none_or(|beat| beat >= SPARSE) {
            return Ok((self.times.clone(), None));
        }
        let rate = beat.map_or(BEATLESS, |beat| {
            let nearly = (beat - beat.round()).abs() < 1e-3 * beat;
            let beat = if nearly { beat.round() } else { beat };
            if beat >= SPARSE { beat } else { beat * (DENSE / beat).ceil() }
        });
        limits.check_span(last - first, rate)?;
        let count = ((last - first) * rate - 0.01).ceil() as usize;
        Ok(((0..=count).map(|k| (first + k as f64 / rate).min(last)).collect(), Some(rate)))
    }
}

fn unsupported(what: impl Into<String>) -> GltfError {
    GltfError::Unsupported { what: what.into() }
}

fn short() -> GltfError {
    unsupported("an animation sampler lies outside of the binary chunk")
}

fn reader<'a, 's>(
    channel: &Channel<'a>,
    blob: &'s [u8],
) -> Reader<'a, 's, impl Clone + Fn(::gltf::Buffer<'a>) -> Option<&'s [u8]>> {
    channel.reader(move |buffer| (buffer.index() == 0).then_some(blob))
}

/// The times of the keys of a channel that was checked.
fn read_times(channel: &Channel, blob: &[u8]) -> Result<Rc<[f64]>, GltfError> {
    let times: Rc<[f64]> = reader(channel, blob).read_inputs().ok_or_else(short)?.map(seconds).collect();
    if !times.is_sorted() || times.iter().any(|t| !t.is_finite()) {
        return Err(unsupported("key times that do not increase"));
    }
    Ok(times)
}

/// A time of single precision as the shortest decimal that stands for it: 0.04 for what 0.04 was rounded to.
fn seconds(time: f32) -> f64 {
    time.to_string().parse().unwrap_or_else(|_| f64::from(time))
}

/// Refuses keys of another shape, and those that do not lie within so many bytes.
fn check_channel(channel: &Channel, length: usize) -> Result<(), GltfError> {
    check_keys(channel)?;
    let sampler = channel.sampler();
    let within = [sampler.input(), sampler.output()].iter().all(|keys| lies_within(keys, length));
    if within { Ok(()) } else { Err(short()) }
}

/// The keys of a channel that was checked, at these times.
fn read_channel(
    channel: &Channel,
    times: Rc<[f64]>,
    blob: &[u8],
    track: &mut NodeTrack,
) -> Result<(), GltfError> {
    let way = channel.sampler().interpolation();
    let reader = reader(channel, blob);
    match reader.read_outputs().ok_or_else(short)? {
        ReadOutputs::Rotations(values) => {
            let unit = |numbers: Vector4<f64>| {
                let near = (numbers.norm() - 1.0).abs() < NEAR_UNIT;
                UnitQuaternion::try_new(Quaternion::from(numbers), 1e-3)
                    .filter(|_| near)
                    .ok_or_else(|| unsupported("a rotation that is no unit quaternion"))
            };
            let rows = values.into_f32().map(|row| Vector4::from(row).cast::<f64>()).collect();
            track.turns = curve(times, rows, way, unit)?;
        }
        ReadOutputs::Translations(values) => {
            let rows = values.map(|[x, y, z]| Vector4::new(x, y, z, 0.0).cast::<f64>()).collect();
            track.shifts = curve(times, rows, way, |row| Ok(row.xyz()))?;
        }
        ReadOutputs::Scales(values) => {
            let rows = values.map(|[x, y, z]| Vector4::new(x, y, z, 0.0).cast::<f64>()).collect();
            track.scales = curve(times, rows, way, |row| Ok(row.xyz()))?;
        }
        ReadOutputs::MorphTargetWeights(_) => {}
    }
    Ok(())
}

fn curve<K>(
    times: Rc<[f64]>,
    rows: Vec<Vector4<f64>>,
    way: Interpolation,
    key: impl Fn(Vector4<f64>) -> Result<K, GltfError>,
) -> Result<Curve<K>, GltfError> {
    if rows.iter().any(|row| !row.iter().all(|v| v.is_finite())) {
        return Err(unsupported("a key that is not finite"));
    }
    let (values, way) = match way {
        Interpolation::Linear => (rows, Way::Linear),
        Interpolation::Step => (rows, Way::Step),
        // Tangent, value, tangent.
        Interpolation::CubicSpline => {
            let (threes, _) = rows.as_chunks::<3>();
            let tangents = threes.iter().map(|[before, _, behind]| [*before, *behind]).collect();
            (threes.iter().map(|[_, value, _]| *value).collect(), Way::Spline(tangents))
        }
    };
    let keys = values.into_iter().map(key).collect::<Result<_, _>>()?;
    Ok(Curve { times, keys, way })
}

/// Refuses keys of a shape that glTF does not allow, or that no tool writes in animations.
fn check_keys(channel: &Channel) -> Result<(), GltfError> {
    let turns = channel.target().property() == Property::Rotation;
    let shape = if turns { Dimensions::Vec4 } else { Dimensions::Vec3 };
    let sound = |accessor: &Accessor, shape: Dimensions, packed: bool| {
        let data = accessor.data_type();
        let strides = accessor.view().is_none_or(|view| view.stride().is_none_or(|s| s >= accessor.size()));
        let data = data == DataType::F32 || packed && data != DataType::U32;
        accessor.dimensions() == shape
            && data
            && strides
            && accessor.count() > 0
            && accessor.sparse().is_none()
    };
    let (sampler, node) = (channel.sampler(), channel.target().node().index());
    let (times, values) = (sampler.input(), sampler.output());
    let each = if sampler.interpolation() == Interpolation::CubicSpline { 3 } else { 1 };
    if times.count().checked_mul(each) != Some(values.count()) {
        let (times, values) = (times.count(), values.count());
        return Err(unsupported(format!("node {node} has {times} key times, and values at {values}")));
    }
    if sound(&times, Dimensions::Scalar, false) && sound(&values, shape, turns) {
        return Ok(());
    }
    Err(unsupported(format!("keys of node {node} have another shape")))
}

/// Whether the rows of an accessor lie within so many bytes.
pub(super) fn lies_within(accessor: &Accessor, length: usize) -> bool {
    let end = || {
        let view = accessor.view()?;
        let stride = view.stride().unwrap_or_else(|| accessor.size());
        let rows = accessor.count().checked_sub(1)?.checked_mul(stride)?;
        let start = view.offset().checked_add(accessor.offset())?;
        let within = accessor.offset().checked_add(rows)?.checked_add(accessor.size())? <= view.length();
        start.checked_add(rows)?.checked_add(accessor.size()).filter(|_| within)
    };
    end().is_some_and(|end| end <= length)
}

/// How far the norm of a rotation may be from 1: bytes round it by less.
const NEAR_UNIT: f64 = 0.05;
/// Least time between two instants, seconds: what other formats tell apart.
const APART: f64 = 2e-6;

/// Times in order, each once.
fn tidy(times: &mut Vec<f64>) {
    times.sort_by(f64::total_cmp);
    times.dedup_by(|later, earlier| *later - *earlier < APART);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn along(way: Way) -> Curve<Vector3<f64>> {
        Curve { times: [1.0, 2.0].into(), keys: vec![Vector3::zeros(), Vector3::x()], way }
    }

    #[test]
    fn curves_hold_their_ends() {
        for (time, x, stepped) in [(0.0, 0.0, 0.0), (1.25, 0.25, 0.0), (2.0, 1.0, 1.0), (9.0, 1.0, 1.0)] {
            assert_eq!(along(Way::Linear).at(time).unwrap().x, x);
            assert_eq!(along(Way::Step).at(time).unwrap().x, stepped);
        }
        assert_eq!(along(Way::Step).at(2.0 - 1e-7).unwrap().x, 1.0);
        assert!(Curve::<Vector3<f64>>::default().at(0.0).is_none());
    }

    #[test]
    fn splines_leave_and_reach_keys_by_their_tangents() {
        let level = along(Way::Spline(vec![[Vector4::zeros(); 2]; 2]));
        assert!((level.at(1.25).unwrap().x - 0.15625).abs() < 1e-12);
        let straight = along(Way::Spline(vec![[Vector4::x(); 2]; 2]));
        assert!((straight.at(1.7).unwrap().x - 0.7).abs() < 1e-12);
    }

    #[test]
    fn a_spline_that_scales_by_nothing_scales_as_at_rest() {
        let tangents = [-4.0, 4.0].map(|along| [Vector4::repeat(along), Vector4::repeat(along)]);
        let scales = Curve {
            times: [0.0, 1.0].into(),
            keys: vec![Vector3::repeat(1.0); 2],
            way: Way::Spline(tangents.to_vec()),
        };
        let track = NodeTrack { scales, ..NodeTrack::default() };
        assert!(track.scales.at(0.5).unwrap().norm() < 1e-12);
        let rest = Similarity3::from_scaling(2.0);
        assert_eq!(track.at(&rest, 0.5).scaling(), 2.0);
        assert_eq!(track.at(&rest, 0.0).scaling(), 1.0);
        assert!(track.check_scales(3, "wrist").is_ok());
    }

    #[test]
    fn few_keys_are_filled_on_their_beat() {
        let of = |times: &[f64], straight: bool| {
            let tracks = Tracks { nodes: Vec::new(), times: times.to_vec(), straight };
            let (instants, rate) = tracks.instants(&Limits::default()).unwrap();
            (instants.len(), rate)
        };
        let keys: Vec<f64> = (0..10).map(|k| f64::from(k) / 25.0).collect();
        assert_eq!(of(&keys, true), (10, None));
        assert_eq!(of(&keys, false), (10, Some(25.0)));
        assert_eq!(of(&[0.5], true), (1, None));
        assert_eq!(of(&[0.0, 10.0], true).0, 301);
        assert_eq!(of(&[1.0, 1.5, 3.0], true), (61, Some(30.0)));
        // No beat.
        assert_eq!(of(&[0.0, 0.001, 1.0], false), (61, Some(60.0)));
    }
}
