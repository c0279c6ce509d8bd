//! The two chunks of a GLB file.

use super::GltfError;

/// The JSON text and the binary chunk of a GLB, or the whole of a .gltf file.
///
/// # Errors
/// [`GltfError::Unsupported`] for what is neither, and for a container that is cut short or of another version.
pub(super) fn split(file: &[u8]) -> Result<(&[u8], Option<&[u8]>), GltfError> {
    if !file.starts_with(b"glTF") {
        // The mark of UTF-8 that some editors put first.
        let file = file.strip_prefix(b"\xef\xbb\xbf").unwrap_or(file);
        if file.trim_ascii_start().starts_with(b"{") {
            return Ok((file, None));
        }
        let start = match &file[..file.len().min(8)] {
            [] => "is empty".to_owned(),
            start => format!("starts with \"{}\"", start.escape_ascii()),
        };
        let what = format!("no glTF: the file {start}, a GLB starts with \"glTF\", a .gltf with \"{{\"");
        return Err(GltfError::Unsupported { what });
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_gltf_is_told_by_its_start() {
        let message = |file: &[u8]| split(file).unwrap_err().to_string();
        assert_eq!(
            message(b"hello, world"),
            "gltf: no glTF: the file starts with \"hello, w\", a GLB starts with \"glTF\", a .gltf with \"{\""
        );
        assert!(message(b"\x89PNG\r\n\x1a\n").contains("\"\\x89PNG\\r\\n\\x1a\\n\""));
        assert!(message(b"").contains("the file is empty"));
        assert!(message(b"glTF\x01\0\0\0").contains("version"));
        assert_eq!(split(b" \n{}").unwrap(), (&b" \n{}"[..], None));
        assert_eq!(split(b"\xef\xbb\xbf{}").unwrap(), (&b"{}"[..], None));
    }
}
