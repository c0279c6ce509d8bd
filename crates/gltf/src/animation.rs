//! Channels of the one animation of a file.

use std::collections::HashMap;

use gltf_json::Index;
use gltf_json::accessor::{Accessor, ComponentType, Type};
use gltf_json::animation::{Animation, Channel, Interpolation, Property, Sampler, Target};
use gltf_json::scene::Node;
use gltf_json::validation::Checked;
use nalgebra::{UnitQuaternion, Vector3};

use super::ExportOptions;
use super::keys::{self, Key};
use super::writer::{Layout, Writer};

/// Rotations (radians) and translations (metres) that stay this close to a value keep still.
const STILL: f64 = 1e-6;
/// How far storing a rotation as four normalised shorts can turn it, radians: twice the length of half a
/// step in four components.
const SHORT_ERROR: f64 = 4.0 * 0.5 / 32767.0;

/// What a further list of times takes beside the times, bytes: an accessor and a buffer view in the document.
const LIST: usize = 160;

/// Whether any key leaves `rest`.
pub(super) fn moves<K: Key>(keys: &[K], rest: &K, still: f64) -> bool {
    keys.iter().any(|k| k.distance(rest) > still)
}

/// Whether the keys differ from one another by more than `still`.
fn changes<K: Key>(keys: &[K], still: f64) -> bool {
    keys.first().is_some_and(|first| moves(keys, first, still))
}

/// The times of some keys as they are stored, as bits.
fn times_of(times: &[f64], kept: &[usize]) -> Vec<u32> {
    kept.iter().map(|&k| (times[k] as f32).to_bits()).collect()
}

/// Channels and samplers in the making; equal lists of times are stored once.
pub(super) struct Channels<'a> {
    options: &'a ExportOptions,
    channels: Vec<Channel>,
    samplers: Vec<Sampler>,
    times: HashMap<Vec<u32>, Index<Accessor>>,
}

impl<'a> Channels<'a> {
    pub(super) fn new(options: &'a ExportOptions) -> Self {
        Self { options, channels: Vec::new(), samplers: Vec::new(), times: HashMap::new() }
    }

    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.channels.len()
    }

    /// A track of translations, `metre` of whose units are a metre of the world; of keys that are all alike the first
    /// and last stay, which keep the duration of the clip.
    pub(super) fn translation(
        &mut self,
        writer: &mut Writer,
        times: &[f64],
        keys: &[Vector3<f64>],
        metre: f64,
        node: Index<Node>,
    ) {
        let still = STILL * metre;
        let tolerance = if changes(keys, still) { self.options.translation_tolerance * metre } else { still };
        let kept = self.kept(times, keys, tolerance, size_of::<[f32; 3]>());
        let rows = kept.iter().map(|&k| keys[k].cast::<f32>().into());
        let output = writer.floats::<3>(rows, Layout::floats(Type::Vec3));
        self.push(writer, times, &kept, output, node, Property::Translation);
    }

    /// A track of rotations.
    pub(super) fn rotation(
        &mut self,
        writer: &mut Writer,
        times: &[f64],
        mut keys: Vec<UnitQuaternion<f64>>,
        node: Index<Node>,
    ) {
        keys::make_continuous(&mut keys);
        let spent = if self.options.quantize { SHORT_ERROR } else { 0.0 };
        let tolerance =
            if changes(&keys, STILL) { (self.options.rotation_tolerance - spent).max(0.0) } else { STILL };
        let bytes = if self.options.quantize { size_of::<[i16; 4]>() } else { size_of::<[f32; 4]>() };
        let kept = self.kept(times, &keys, tolerance, bytes);
        let output = if self.options.quantize {
            let short = |v: f64| ((v * 32767.0).round() as i16).to_le_bytes();
            let data: Vec<u8> =
                kept.iter().flat_map(|&k| <[f64; 4]>::from(keys[k].coords)).flat_map(short).collect();
            let layout =
                Layout { component: ComponentType::I16, normalized: true, ..Layout::floats(Type::Vec4) };
            writer.accessor(&data, kept.len(), layout)
        } else {
            let rows = kept.iter().map(|&k| keys[k].coords.cast::<f32>().into());
            writer.floats::<4>(rows, Layout::floats(Type::Vec4))
        };
        self.push(writer, times, &kept, output, node, Property::Rotation);
    }

    /// Numbers of the keys to keep, of `bytes` each: all of them where a list of their own times would take more than is
    /// spared.
    fn kept<K: Key>(&self, times: &[f64], keys: &[K], tolerance: f64, bytes: usize) -> Vec<usize> {
        let kept = keys::reduce(times, keys, tolerance);
        let stored = self.times.contains_key(&times_of(times, &kept));
        let list = if stored { 0 } else { LIST + kept.len() * size_of::<f32>() };
        if kept.len() * bytes + list < keys.len() * bytes || !changes(keys, tolerance) {
            return kept;
        }
        (0..keys.len()).collect()
    }

    fn push(
        &mut self,
        writer: &mut Writer,
        times: &[f64],
        kept: &[usize],
        output: Index<Accessor>,
        node: Index<Node>,
        property: Property,
    ) {
        let bits = times_of(times, kept);
        let rows: Vec<[f32; 1]> = bits.iter().map(|bits| [f32::from_bits(*bits)]).collect();
        let input = *self
            .times
            .entry(bits)
            .or_insert_with(|| writer.bounded_floats(&rows, Layout::floats(Type::Scalar)));
        let sampler = Index::new(self.samplers.len() as u32);
        self.samplers.push(Sampler {
            extensions: None,
            extras: None,
            input,
            interpolation: Checked::Valid(Interpolation::Linear),
            output,
        });
        self.channels.push(Channel {
            sampler,
            target: Target { extensions: None, extras: None, node, path: Checked::Valid(property) },
            extensions: None,
            extras: None,
        });
    }

    /// The animation.
    pub(super) fn finish(self) -> Animation {
        Animation {
            extensions: None,
            extras: None,
            channels: self.channels,
            name: Some(self.options.animation.clone()),
            samplers: self.samplers,
        }
    }
}
