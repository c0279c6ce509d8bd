//! The two chunks of a GLB file.

use super::GltfError;

/// The JSON text and the binary chunk of a GLB, or the whole of a .gltf file.
///
/// # Errors
/// [`GltfError::Unsupported`] for a container that is cut short or of another version.
pub(super) fn split(file: &[u8]) -> Result<(&[u8], Option<&[u8]>), GltfError> {
    if !file.starts_with(b"glTF") {
        return Ok((file, None));
    }
    let wrong = |what: &str| GltfError::Unsupported { what: format!("no GLB: {what}") };
    let word = |at: usize| -> Option<usize> {
        let bytes = file.get(at..at.checked_add(4)?)?;
        Some(u32::from_le_bytes(bytes.try_into().ok()?) as usize)
    };
    if word(4) != Some(2) {
        return Err(wrong("its version is not 2"));
    }
    let mut at = 12usize;
    let mut next = |kind: &[u8; 4]| -> Option<&[u8]> {
        let data = file.get(at + 8..(at + 8).checked_add(word(at)?)?)?;
        (file.get(at + 4..at + 8)? == kind).then(|| {
            at += 8 + data.len();
            data
        })
    };
    let json = next(b"JSON").ok_or_else(|| wrong("the JSON chunk is missing or cut short"))?;
    let bin = next(b"BIN\0");
    if bin.is_none() && at + 8 <= file.len() && file.get(at + 4..at + 8) == Some(b"BIN\0") {
        return Err(wrong("the binary chunk is cut short"));
    }
    Ok((json, bin))
}
