//! Cameras, through the `ffmpeg` program as a pipe.

use std::path::Path;
use std::process::{Command, Stdio};

use super::{FrameError, FrameSource, OpenOptions, ffmpeg};

/// How a camera is asked for pictures.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct CameraOptions {
    /// Width and height that are asked for, pixels.
    pub size: [u32; 2],
    /// Pictures per second that are asked for.
    pub rate: f64,
}

impl Default for CameraOptions {
    /// 640 × 480 pixels, which every camera gives, 30 times a second.
    fn default() -> Self {
        Self { size: [640, 480], rate: 30.0 }
    }
}

impl CameraOptions {
    /// Sets width and height.
    pub fn with_size(self, size: [u32; 2]) -> Self {
        Self { size, ..self }
    }

    /// Sets the pictures per second.
    pub fn with_rate(self, rate: f64) -> Self {
        Self { rate, ..self }
    }
}

/// A camera of this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Camera {
    /// What [`open_camera`] takes.
    pub id: String,
    /// What it is called.
    pub name: String,
}

/// The input format of ffmpeg for cameras of this system.
const FORMAT: &str = if cfg!(target_os = "macos") {
    "avfoundation"
} else if cfg!(windows) {
    "dshow"
} else {
    "v4l2"
};

/// Opens a camera by its id or name: of Linux `/dev/video0` or `0`, of macOS and Windows its name or number.
///
/// # Errors
/// The program is missing, or the camera gives no picture: the error tells what the program said.
pub fn open_camera(
    camera: &str,
    how: &CameraOptions,
    options: &OpenOptions,
) -> Result<Box<dyn FrameSource>, FrameError> {
    let [width, height] = how.size;
    let listed = || cameras(options.ffmpeg.as_deref().unwrap_or(Path::new("ffmpeg")));
    let input = input(FORMAT, camera, listed)?;
    let mut args: Vec<String> = Vec::new();
    // Nothing is kept to be analysed: the first picture comes at once.
    args.extend(["-fflags", "nobuffer", "-probesize", "32"].map(String::from));
    args.extend(["-f", FORMAT, "-framerate", &how.rate.to_string()].map(String::from));
    args.extend(["-video_size".to_owned(), format!("{width}x{height}"), "-i".to_owned(), input]);
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    ffmpeg::open_input(&args, &format!("camera {camera}"), FORMAT, "", options)
}

/// What ffmpeg calls a camera in a format; DirectShow has no numbers, so that there one counts those that are `listed`.
fn input(
    format: &str,
    camera: &str,
    listed: impl FnOnce() -> Result<Vec<Camera>, FrameError>,
) -> Result<String, FrameError> {
    let digits = camera.bytes().all(|b| b.is_ascii_digit());
    let number: Option<usize> = camera.parse().ok().filter(|_| digits);
    Ok(match (format, number) {
        ("v4l2", Some(_)) => format!("/dev/video{camera}"),
        ("dshow", Some(number)) => {
            let listed = listed()?;
            let there = listed.len();
            let found = listed.into_iter().nth(number).ok_or_else(|| FrameError::Option {
                what: format!("camera {camera}: there are {there}, counted from 0"),
            })?;
            format!("video={}", found.id)
        }
        ("dshow", None) => format!("video={camera}"),
        _ => camera.to_owned(),
    })
}

/// The cameras of this machine.
///
/// # Errors
/// Where the system's own list cannot be read: that `program` is missing.
pub fn cameras(program: &Path) -> Result<Vec<Camera>, FrameError> {
    if FORMAT == "v4l2" {
        return Ok(listed_by_linux(Path::new("/sys/class/video4linux")));
    }
    let input = if FORMAT == "dshow" { "dummy" } else { "" };
    let output = Command::new(program)
        .args(["-hide_banner", "-f", FORMAT, "-list_devices", "true", "-i", input])
        .stdin(Stdio::null())
        .output()
        .map_err(|error| FrameError::Helper {
            path: "cameras".to_owned(),
            program: program.display().to_string(),
            message: error.to_string(),
        })?;
    let text = String::from_utf8_lossy(&output.stderr);
    Ok(if FORMAT == "dshow" { listed_by_dshow(&text) } else { listed_by_avfoundation(&text) })
}

/// `video0` and its like with their names, in order; a camera's second node, which gives no pictures, is left out.
fn listed_by_linux(folder: &Path) -> Vec<Camera> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut found: Vec<(u32, Camera)> = entries
        .filter_map(|entry| {
            let node = entry.file_name().into_string().ok()?;
            let number = node.strip_prefix("video")?.parse().ok()?;
            let read = |what: &str| std::fs::read_to_string(entry.path().join(what)).ok();
            if read("index").is_some_and(|index| index.trim() != "0") {
                return None;
            }
            let name = read("name").map_or_else(|| node.clone(), |name| name.trim().to_owned());
            Some((number, Camera { id: format!("/dev/{node}"), name }))
        })
        .collect();
    found.sort_by_key(|(number, _)| *number);
    found.into_iter().map(|(_, camera)| camera).collect()
}

/// Lines such as `[AVFoundation indev @ 0x7f8] [0] FaceTime HD Camera`, up to the audio devices.
fn listed_by_avfoundation(text: &str) -> Vec<Camera> {
    let video = text.lines().skip_while(|line| !line.contains("AVFoundation video devices")).skip(1);
    let lines = video.take_while(|line| !line.contains("AVFoundation audio devices"));
    let camera = |line: &str| {
        let (number, name) = line.split_once("] [")?.1.split_once("] ")?;
        number.parse::<u32>().ok()?;
        Some(Camera { id: number.to_owned(), name: name.trim().to_owned() })
    };
    lines.filter_map(camera).collect()
}

/// Lines such as `[dshow @ 0000] "Integrated Camera" (video)`.
fn listed_by_dshow(text: &str) -> Vec<Camera> {
    let camera = |line: &str| {
        let (name, kind) = line.split_once('"')?.1.rsplit_once('"')?;
        let name = name.to_owned();
        kind.trim().starts_with("(video").then(|| Camera { id: name.clone(), name })
    };
    text.lines().filter_map(camera).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(id: &str, name: &str) -> Camera {
        Camera { id: id.into(), name: name.into() }
    }

    #[test]
    fn lists_of_other_systems() {
        let mac = "[AVFoundation indev @ 0x1] AVFoundation video devices:\n\
                   [AVFoundation indev @ 0x1] [0] FaceTime HD Camera\n\
                   [AVFoundation indev @ 0x1] [1] Capture screen 0\n\
                   [AVFoundation indev @ 0x1] AVFoundation audio devices:\n\
                   [AVFoundation indev @ 0x1] [0] Microphone\n";
        assert_eq!(
            listed_by_avfoundation(mac),
            [camera("0", "FaceTime HD Camera"), camera("1", "Capture screen 0")]
        );
        let windows = "[dshow @ 0001] \"Integrated \"HD\" Camera\" (video)\n\
                       [dshow @ 0001]   Alternative name \"@device_pnp\"\n\
                       [dshow @ 0001] \"Microphone\" (audio)\n";
        let name = "Integrated \"HD\" Camera";
        assert_eq!(listed_by_dshow(windows), [camera(name, name)]);
    }

    #[test]
    fn numbers_of_cameras() {
        let listed = || Ok(vec![camera("A", "A"), camera("B 2", "B 2")]);
        let called = |format: &str, name: &str| input(format, name, listed).unwrap();
        assert_eq!(called("v4l2", "1"), "/dev/video1");
        assert_eq!(called("v4l2", "/dev/video2"), "/dev/video2");
        assert_eq!(called("avfoundation", "1"), "1");
        assert_eq!(called("dshow", "1"), "video=B 2");
        assert_eq!(called("dshow", "C"), "video=C");
        let error = input("dshow", "2", listed).unwrap_err().to_string();
        assert!(error.contains("camera 2: there are 2"), "{error}");
    }

    #[test]
    fn nodes_of_linux_that_give_pictures() {
        let folder = std::env::temp_dir().join(format!("handcast-cameras-{}", std::process::id()));
        for (node, index, name) in [("video10", "0", "B"), ("video2", "0", "A"), ("video3", "1", "A")] {
            let node = folder.join(node);
            std::fs::create_dir_all(&node).unwrap();
            std::fs::write(node.join("index"), index).unwrap();
            std::fs::write(node.join("name"), format!("{name}\n")).unwrap();
        }
        assert_eq!(listed_by_linux(&folder), [camera("/dev/video2", "A"), camera("/dev/video10", "B")]);
        std::fs::remove_dir_all(&folder).unwrap();
        assert!(listed_by_linux(&folder).is_empty());
    }

    #[test]
    fn a_camera_that_is_not_there() {
        let options = OpenOptions::default().with_ffmpeg(Some("no-such-program".into()));
        let error = open_camera("0", &CameraOptions::default(), &options).err().unwrap();
        // DirectShow's cameras have names, which the program must list first.
        let said = if cfg!(windows) { "cameras: no-such-program" } else { "camera 0" };
        assert!(error.to_string().contains(said), "{error}");
        assert!(open_camera("0", &CameraOptions::default(), &OpenOptions::default()).is_err());
    }
}
