//! How many frames a clip will have, where its source does not know: an estimate, for the bar alone.

use std::path::Path;
use std::process::{Command, Stdio};

use handcast_media::{ClipInfo, OpenOptions};

/// The number of frames of the clip at `path`, told or estimated; `None` for pipes, and where nothing tells.
pub fn frames(path: &Path, info: &ClipInfo) -> Option<u64> {
    if let Some(frames) = info.frames {
        return Some(frames as u64);
    }
    let file = path.metadata().ok().filter(std::fs::Metadata::is_file)?;
    match info.format.strip_prefix("y4m ") {
        Some(colour) => Some(file.len() / picture_of_y4m(colour, info)),
        None if info.format.ends_with("through ffmpeg") => {
            let frames = seconds(path)? * info.rate?;
            (frames.is_finite() && frames >= 1.0).then_some(frames.round() as u64)
        }
        None => None,
    }
}

/// Bytes of a picture in a Y4M file, its header included.
fn picture_of_y4m(colour: &str, info: &ClipInfo) -> u64 {
    let halves = match colour {
        mono if mono.starts_with("mono") => 2,
        full if full.starts_with("444") => 6,
        half if half.starts_with("422") => 4,
        _ => 3,
    };
    u64::from(info.width) * u64::from(info.height) * halves / 2 + "FRAME\n".len() as u64
}

/// How long a file plays, by the program beside ffmpeg.
fn seconds(path: &Path) -> Option<f64> {
    let ffmpeg = OpenOptions::default().ffmpeg?;
    let mut name = std::ffi::OsString::from("file:");
    name.push(path);
    let told = Command::new(ffmpeg.with_file_name("ffprobe"))
        .args(["-v", "error", "-show_entries", "format=duration", "-of", "csv=p=0", "-i"])
        .arg(name)
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output()
        .ok()?;
    std::str::from_utf8(&told.stdout).ok()?.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_raw_pictures_are_counted_by_their_size() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.y4m");
        for (colour, bytes) in [("420jpeg", 24), ("422", 32), ("444", 48), ("mono", 16)] {
            let mut content = format!("YUV4MPEG2 W4 H4 F25:1 C{colour}\n").into_bytes();
            for _ in 0..40 {
                content.extend(b"FRAME\n");
                content.resize(content.len() + bytes, 7);
            }
            std::fs::write(&path, content).unwrap();
            let info = handcast_media::open(&path, &OpenOptions::default()).unwrap().info().clone();
            assert!(
                frames(&path, &info).is_some_and(|n| (40..=42).contains(&n)),
                "{colour}: {:?}",
                frames(&path, &info)
            );
        }
        let info = ClipInfo { width: 4, height: 4, format: "y4m 444".into(), ..ClipInfo::default() };
        assert_eq!(frames(Path::new("-"), &info), None);
        assert_eq!(frames(Path::new("-"), &ClipInfo { frames: Some(7), ..info }), Some(7));
    }
}
