//! Accessors, buffer views and the GLB container.

use gltf_json::accessor::{Accessor, ComponentType, GenericComponentType, Type};
use gltf_json::buffer::{Buffer, Target, View};
use gltf_json::image::MimeType;
use gltf_json::validation::{Checked, USize64};
use gltf_json::{Image, Index, Root};

use super::GltfError;

/// A glTF document with its binary chunk in the making.
pub(super) struct Writer {
    pub(super) root: Root,
    bytes: Vec<u8>,
}

/// How the numbers of an accessor are kept.
#[derive(Clone, Copy)]
pub(super) struct Layout {
    pub(super) kind: Type,
    pub(super) component: ComponentType,
    pub(super) normalized: bool,
    pub(super) target: Option<Target>,
    /// Bytes from row to row where the rows are padded.
    pub(super) stride: Option<usize>,
}

impl Layout {
    /// `f32` numbers outside of meshes.
    pub(super) fn floats(kind: Type) -> Self {
        Self { kind, component: ComponentType::F32, normalized: false, target: None, stride: None }
    }

    /// `f32` vertex data.
    pub(super) fn vertices(kind: Type) -> Self {
        Self { target: Some(Target::ArrayBuffer), ..Self::floats(kind) }
    }
}

impl Writer {
    pub(super) fn new(generator: String) -> Self {
        let root = Root {
            asset: gltf_json::Asset { generator: Some(generator), ..Default::default() },
            ..Default::default()
        };
        Self { root, bytes: Vec::new() }
    }

    /// A new accessor in a buffer view of its own.
    pub(super) fn accessor(&mut self, data: &[u8], count: usize, layout: Layout) -> Index<Accessor> {
        while !self.bytes.len().is_multiple_of(4) {
            self.bytes.push(0);
        }
        let view = self.root.push(View {
            buffer: Index::new(0),
            byte_length: USize64::from(data.len()),
            byte_offset: Some(USize64::from(self.bytes.len())),
            byte_stride: layout.stride.map(gltf_json::buffer::Stride),
            name: None,
            target: layout.target.map(Checked::Valid),
            extensions: None,
            extras: None,
        });
        self.bytes.extend_from_slice(data);
        self.root.push(Accessor {
            buffer_view: Some(view),
            byte_offset: None,
            count: USize64::from(count),
            component_type: Checked::Valid(GenericComponentType(layout.component)),
            extensions: None,
            extras: None,
            type_: Checked::Valid(layout.kind),
            min: None,
            max: None,
            name: None,
            normalized: layout.normalized,
            sparse: None,
        })
    }

    /// A picture in a buffer view of its own.
    pub(super) fn picture(&mut self, png: &[u8], name: &str) -> Index<Image> {
        while !self.bytes.len().is_multiple_of(4) {
            self.bytes.push(0);
        }
        let view = self.root.push(View {
            buffer: Index::new(0),
            byte_length: USize64::from(png.len()),
            byte_offset: Some(USize64::from(self.bytes.len())),
            byte_stride: None,
            name: None,
            target: None,
            extensions: None,
            extras: None,
        });
        self.bytes.extend_from_slice(png);
        self.root.push(Image {
            buffer_view: Some(view),
            mime_type: Some(MimeType("image/png".into())),
            name: Some(name.into()),
            uri: None,
            extensions: None,
            extras: None,
        })
    }

    /// An accessor of `f32` rows.
    pub(super) fn floats<const N: usize>(
        &mut self,
        rows: impl ExactSizeIterator<Item = [f32; N]>,
        layout: Layout,
    ) -> Index<Accessor> {
        let count = rows.len();
        let data: Vec<u8> = rows.flatten().flat_map(f32::to_le_bytes).collect();
        self.accessor(&data, count, layout)
    }

    /// As [`Writer::floats`], with `min` and `max`, which glTF wants for positions and times.
    pub(super) fn bounded_floats<const N: usize>(
        &mut self,
        rows: &[[f32; N]],
        layout: Layout,
    ) -> Index<Accessor> {
        let index = self.floats(rows.iter().copied(), layout);
        self.set_bounds(index, rows);
        index
    }

    /// States `min` and `max` of an accessor with these rows.
    pub(super) fn set_bounds<const N: usize>(&mut self, index: Index<Accessor>, rows: &[[f32; N]]) {
        let bound = |pick: fn(f32, f32) -> f32| -> serde_json::Value {
            (0..N).map(|k| rows.iter().map(|r| r[k]).reduce(pick).unwrap_or(0.0)).collect()
        };
        if let Some(accessor) = self.root.accessors.get_mut(index.value()) {
            accessor.min = Some(bound(f32::min));
            accessor.max = Some(bound(f32::max));
        }
    }

    /// The document without its buffer, and the binary chunk.
    pub(super) fn into_parts(self) -> (Root, Vec<u8>) {
        (self.root, self.bytes)
    }

    /// The GLB file.
    pub(super) fn finish(mut self) -> Result<Vec<u8>, GltfError> {
        while !self.bytes.len().is_multiple_of(4) {
            self.bytes.push(0);
        }
        self.root.buffers = vec![Buffer {
            byte_length: USize64::from(self.bytes.len()),
            name: None,
            uri: None,
            extensions: None,
            extras: None,
        }];
        glb(serde_json::to_vec(&self.root)?, &self.bytes)
    }
}

/// A GLB container around a document and its binary chunk, whose length is a multiple of four.
pub(super) fn glb(mut json: Vec<u8>, bytes: &[u8]) -> Result<Vec<u8>, GltfError> {
    const HEADER: usize = 12;
    const CHUNK: usize = 8;
    while !json.len().is_multiple_of(4) {
        json.push(b' ');
    }
    let total = HEADER + 2 * CHUNK + json.len() + bytes.len();
    let size = |n: usize| u32::try_from(n).map_err(|_| GltfError::Size { bytes: total });
    let mut out = Vec::with_capacity(total);
    out.extend_from_slice(b"glTF");
    out.extend_from_slice(&2u32.to_le_bytes());
    out.extend_from_slice(&size(total)?.to_le_bytes());
    for (kind, chunk) in [(b"JSON", json.as_slice()), (b"BIN\0", bytes)] {
        out.extend_from_slice(&size(chunk.len())?.to_le_bytes());
        out.extend_from_slice(kind);
        out.extend_from_slice(chunk);
    }
    Ok(out)
}
