//! A file whose motion is read: its document, and the buffer that animations lie in.

use std::borrow::Cow;
use std::path::Path;

use serde_json::{Value, json};

use super::GltfError;
use super::container::split;
use super::retarget::{PACKED, gathered};
use super::root::{refused, root};
use super::writer::glb;
use handcast_limits::Limits;

/// A file, taken apart.
pub(super) struct Source<'a> {
    pub(super) document: ::gltf::Document,
    /// The text of the document.
    pub(super) text: &'a [u8],
    /// The one buffer.
    pub(super) bytes: Cow<'a, [u8]>,
}

impl<'a> Source<'a> {
    /// Reads a .glb or .gltf file. `folder` is where buffers lie that it refers to; pictures are passed over, and so is how meshes are
    /// stored: poses lie in the nodes.
    ///
    /// # Errors
    /// [`GltfError::Syntax`], [`GltfError::Unsupported`], [`GltfError::Rig`] for buffers that are missing, [`GltfError::Excess`].
    pub(super) fn read(file: &'a [u8], folder: Option<&Path>, limits: &Limits) -> Result<Self, GltfError> {
        let (text, chunk) = split(file)?;
        let mut json = root(text, limits)?;
        if let Some(name) = json.extensions_required.iter().find(|e| PACKED.contains(&e.as_str())) {
            let what = format!("needs {name}, which is not read: store the animation uncompressed");
            return Err(GltfError::Unsupported { what });
        }
        json.extensions_required.clear();
        let own = json.buffers.len() <= 1 && json.buffers.iter().all(|buffer| buffer.uri.is_none());
        let bytes = if own {
            Cow::Borrowed(chunk.unwrap_or_default())
        } else {
            let mut whole: Value = serde_json::from_slice(text)?;
            let bytes = gathered(&mut whole, chunk, folder)?;
            json.buffer_views = serde_json::from_value(whole["bufferViews"].take()).unwrap_or_default();
            Cow::Owned(bytes)
        };
        Ok(Self { document: ::gltf::Document::from_json(json).map_err(refused)?, text, bytes })
    }
}

/// A .gltf file as a GLB with the buffers that it refers to in `folder`; as it is where it refers to none.
///
/// # Errors
/// [`GltfError::Syntax`], [`GltfError::Unsupported`], [`GltfError::Excess`], [`GltfError::Rig`] for buffers that are missing.
pub fn with_buffers<'a>(file: &'a [u8], folder: &Path, limits: &Limits) -> Result<Cow<'a, [u8]>, GltfError> {
    let (text, chunk) = split(file)?;
    // Values take many times their text.
    root(text, limits)?;
    let mut json: Value = serde_json::from_slice(text)
        .map_err(|e| GltfError::Syntax(Box::new(::gltf::Error::Deserialize(e))))?;
    let lies_beside = |buffer: &Value| buffer["uri"].as_str().is_some_and(|uri| !uri.starts_with("data:"));
    if !json["buffers"].as_array().is_some_and(|buffers| buffers.iter().any(lies_beside)) {
        return Ok(file.into());
    }
    let mut bytes = gathered(&mut json, chunk, Some(folder))?;
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    json["buffers"] = json!([{ "byteLength": bytes.len() }]);
    Ok(glb(serde_json::to_vec(&json)?, &bytes)?.into())
}

/// A GLB as a .gltf file: one document of JSON, with its binary chunk in a `data:` URI of its first buffer. A .gltf file stays
/// what it is, and so does a document without buffers.
///
/// # Errors
/// [`GltfError::Unsupported`] for what is neither, [`GltfError::Json`] for a document that is no JSON.
pub fn as_document(file: &[u8]) -> Result<Vec<u8>, GltfError> {
    let (text, chunk) = split(file)?;
    let mut json: Value = serde_json::from_slice(text)?;
    let buffer =
        json.get_mut("buffers").and_then(|buffers| buffers.get_mut(0)).and_then(Value::as_object_mut);
    if let (Some(buffer), Some(chunk)) = (buffer, chunk) {
        let uri = format!("data:application/octet-stream;base64,{}", base64(chunk));
        buffer.insert("uri".into(), uri.into());
    }
    Ok(serde_json::to_vec(&json)?)
}

/// RFC 4648, section 4.
fn base64(bytes: &[u8]) -> String {
    const SIGNS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let word = three.iter().fold(0, |word, byte| word << 8 | u32::from(*byte)) << (8 * (3 - three.len()));
        for k in 0..4 {
            let sign = SIGNS[(word >> (18 - 6 * k)) as usize & 63];
            out.push(if k <= three.len() { char::from(sign) } else { '=' });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_written() {
        for (bytes, text) in [(&b""[..], ""), (b"f", "Zg=="), (b"fo", "Zm8="), (b"foobar", "Zm9vYmFy")] {
            assert_eq!(base64(bytes), text);
        }
    }

    #[test]
    fn documents_without_buffers_stay_what_they_are() {
        for text in ["[]", "{}", "{\"buffers\":{}}", "{\"buffers\":[1]}", "null"] {
            let file = glb(text.into(), &[0; 4]).unwrap();
            assert_eq!(as_document(&file).unwrap(), text.as_bytes());
        }
    }

    #[test]
    fn a_document_is_checked_before_values_are_made_of_it() {
        let text = format!("{{\"asset\":{{\"version\":\"2.0\"}},\"nodes\":[{}{{}}]}}", "{},".repeat(100));
        let limits = Limits::default().with_nodes(100);
        let message = with_buffers(text.as_bytes(), Path::new("."), &limits).unwrap_err().to_string();
        assert!(message.contains("101 nodes, allowed at most 100"), "{message}");
    }
}
