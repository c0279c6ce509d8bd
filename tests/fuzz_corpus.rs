//! The stored fuzz corpus as ordinary tests.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "../fuzz/checks.rs"]
mod checks;

fn each(target: &str, check: fn(&[u8])) {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(target);
    let mut count = 0;
    for entry in std::fs::read_dir(&folder).unwrap() {
        let data = std::fs::read(entry.unwrap().path()).unwrap();
        check(&data);
        // And with every byte in turn made something else.
        for at in 0..data.len().min(200) {
            let mut changed = data.clone();
            changed[at] ^= 1 << (at % 8);
            check(&changed);
            check(&data[..at]);
        }
        count += 1;
    }
    assert!(count > 0, "{} is empty", folder.display());
}

#[test]
fn decode() {
    each("decode", checks::decode);
}

#[test]
fn chunking() {
    each("chunking", checks::chunking);
}

#[test]
fn round_trip() {
    each("round_trip", checks::round_trip);
}

#[test]
fn bap_text() {
    each("bap_text", checks::bap_text);
}

#[test]
fn epf_text() {
    each("epf_text", checks::epf_text);
}

#[test]
fn network() {
    each("network", checks::network);
}
