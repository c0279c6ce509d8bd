//! The stored fuzz corpus as ordinary tests.

#[path = "../../fuzz/checks.rs"]
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
fn packets() {
    each("packets", checks::packets);
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

#[test]
fn mp4_clip() {
    each("mp4_clip", checks::readers::clip);
}

#[test]
fn avi_clip() {
    each("avi_clip", checks::readers::clip);
}

#[test]
fn y4m_clip() {
    each("y4m_clip", checks::readers::clip);
}

#[test]
fn picture() {
    each("picture", checks::readers::clip);
}

#[test]
fn glb() {
    each("glb", checks::readers::glb);
}

#[test]
fn rig() {
    each("rig", checks::readers::rig);
}

#[test]
fn bvh() {
    each("bvh", checks::readers::bvh);
}

#[test]
fn table() {
    each("table", checks::readers::table);
}

#[test]
fn poses() {
    each("poses", checks::readers::poses);
}

#[test]
fn landmarks() {
    each("landmarks", checks::readers::landmarks);
}

#[test]
fn npz() {
    each("npz", checks::readers::npz);
}

#[test]
fn pose_format() {
    each("pose_format", checks::readers::pose_format);
}

#[test]
fn stream_mp4() {
    each("stream_mp4", checks::readers::stream_mp4);
}

#[test]
fn wire() {
    each("wire", checks::readers::wire);
}

#[test]
fn words() {
    each("words", checks::readers::words);
}
