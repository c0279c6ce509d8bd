//! Content security policies of pages that hold their scripts and styles themselves.

use sha2::{Digest, Sha256};

/// A content security policy (W3C CSP level 3) for a page that holds all it needs: of its inline scripts and styles these
/// alone count, word for word as they stand between their tags, and pictures only as `data:` and `blob:`. No attribute runs
/// or styles anything, and nothing is fetched, sent or framed.
pub fn policy(scripts: &[&str], styles: &[&str]) -> String {
    format!(
        "default-src 'none'; script-src {}; style-src {}; img-src data: blob:; base-uri 'none'; form-action 'none'",
        hashes(scripts),
        hashes(styles)
    )
}

/// As [`policy`], for the viewer's page, which has modules of WebAssembly in it and plays the film that it holds.
pub(super) fn policy_of_page(scripts: &[&str], styles: &[&str]) -> String {
    format!(
        "default-src 'none'; script-src {} 'wasm-unsafe-eval'; style-src {}; img-src data: blob:; media-src blob:; \
         base-uri 'none'; form-action 'none'",
        hashes(scripts),
        hashes(styles)
    )
}

/// Bytes in base64 (RFC 4648, with padding).
fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let value = group.iter().fold(0u32, |v, &b| v << 8 | u32::from(b)) << (8 * (3 - group.len()));
        for k in 0..4 {
            let digit = ALPHABET[(value >> (18 - 6 * k)) as usize & 63];
            text.push(if k <= group.len() { char::from(digit) } else { '=' });
        }
    }
    text
}

/// Hash sources (CSP level 3, 2.3.1).
fn hashes(elements: &[&str]) -> String {
    if elements.is_empty() {
        return "'none'".into();
    }
    let hash = |element: &&str| {
        // A browser hashes what it has read, in which line ends are line feeds.
        let digest = Sha256::digest(element.replace("\r\n", "\n"));
        format!("'sha256-{}'", base64(&digest))
    };
    elements.iter().map(hash).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_as_in_the_standard() {
        let words = [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")];
        for (plain, coded) in words {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
    }

    /// The example of CSP level 3, 8.3.
    #[test]
    fn a_hash_as_in_the_recommendation() {
        let script = "alert('Hello, world.');";
        assert_eq!(hashes(&[script]), "'sha256-qznLcsROx4GACP2dm0UCKCzCG+HiZ1guq6ZZDob/Tng='");
        assert_eq!(hashes(&["a\r\nb"]), hashes(&["a\nb"]));
        let policy = policy(&[], &["x", "y"]);
        assert!(policy.contains("script-src 'none'; style-src 'sha256-") && !policy.contains("unsafe"));
    }
}
