//! Pictures as they come, of which only the newest waits.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use handcast_live::server::clock_ms;
use handcast_media::{
    Address, Camera, CameraOptions, ClipInfo, Frame, FrameSource, OpenOptions, cameras, open, open_camera,
};

use crate::cli::common::tell_shortfall;

/// Where pictures come from.
pub struct Source {
    frames: Box<dyn FrameSource>,
    /// What it is called.
    name: PathBuf,
    /// How a clip is opened again, where it is played at its own pace, and whether it is.
    clip: Option<(OpenOptions, bool)>,
}

impl Source {
    /// What a name on the command line means.
    pub fn choose(
        path: Option<&Path>,
        options: &OpenOptions,
        camera: &CameraOptions,
        again: bool,
    ) -> anyhow::Result<Self> {
        let options = options.clone().with_max_side(640);
        let Some(path) = path else {
            let Some(first) = cameras("ffmpeg".as_ref())?.into_iter().next() else {
                bail!("no camera is found: name one, a clip, or - for Y4M on standard input");
            };
            let frames = open_camera(&first.id, camera, &options)?;
            return Ok(Self { frames, name: first.id.into(), clip: None });
        };
        let of = |frames, clip| Self { frames, name: path.to_owned(), clip };
        if path == Path::new("-") {
            return Ok(of(open(path, &options)?, None));
        }
        let clip = |options: OpenOptions| -> anyhow::Result<Self> {
            Ok(of(open(path, &options)?, Some((options, again))))
        };
        match Address::of(path)? {
            // What is at an address of the web comes faster than it is to be seen.
            Some(Address::Web) => return clip(options),
            Some(_) => return Ok(of(open(path, &options)?, None)),
            None => {}
        }
        if path.is_file() || path.is_dir() {
            return clip(options);
        }
        let name = path.to_string_lossy();
        let known = cameras("ffmpeg".as_ref()).unwrap_or_default();
        let Some(id) = camera_called(&name, path.exists(), known) else {
            // Names of cameras, too, may have what patterns have.
            if name.contains(['*', '?', '[']) {
                return clip(options);
            }
            bail!("{name}: no such file, and no camera");
        };
        let frames =
            open_camera(&id, camera, &options).with_context(|| format!("{name}: neither a clip nor"))?;
        Ok(of(frames, None))
    }

    /// Whether they are of a clip, not of a camera or a pipe.
    pub fn is_clip(&self) -> bool {
        self.clip.is_some()
    }

    pub fn info(&self) -> &ClipInfo {
        self.frames.info()
    }
}

/// The camera that a name means which is no file's, of those that are known; `there` where something of that name is.
fn camera_called(name: &str, there: bool, known: Vec<Camera>) -> Option<String> {
    if let Some(known) = known.into_iter().find(|known| known.name == name || known.id == name) {
        return Some(known.id);
    }
    // What DirectShow calls a camera besides its name: @device_pnp_\\?\usb#….
    let device = there || name.starts_with("@device_") || !name.contains(['.', '/', '*', '?', '[']);
    device.then(|| name.to_owned())
}

/// A picture and when it came.
pub struct Captured {
    pub frame: Frame,
    pub at: Instant,
    /// The same by the room's clock.
    pub time_ms: u32,
}

/// Room for one picture: a newer one takes its place.
#[derive(Default)]
pub struct Slot {
    place: Mutex<Option<Captured>>,
    filled: Condvar,
    ended: AtomicBool,
    came: AtomicU64,
    dropped: AtomicU64,
}

impl Slot {
    fn put(&self, captured: Captured) {
        self.came.fetch_add(1, Ordering::Relaxed);
        let before = self.place.lock().unwrap_or_else(PoisonError::into_inner).replace(captured);
        if before.is_some() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
        self.filled.notify_one();
    }

    fn end(&self) {
        self.ended.store(true, Ordering::Release);
        self.filled.notify_one();
    }

    /// The newest picture, as soon as there is one.
    pub fn take(&self, wait: Duration) -> Option<Captured> {
        let place = self.place.lock().unwrap_or_else(PoisonError::into_inner);
        let empty = |place: &mut Option<Captured>| place.is_none() && !self.ended.load(Ordering::Acquire);
        let waited = self.filled.wait_timeout_while(place, wait, empty);
        waited.unwrap_or_else(PoisonError::into_inner).0.take()
    }

    /// Whether no more come.
    pub fn is_ended(&self) -> bool {
        self.ended.load(Ordering::Acquire)
    }

    /// Pictures that came, and those among them whose place a newer one took.
    pub fn counted(&self) -> [u64; 2] {
        [&self.came, &self.dropped].map(|counter| counter.load(Ordering::Relaxed))
    }
}

/// The thread that reads pictures.
pub struct Capture {
    thread: JoinHandle<anyhow::Result<()>>,
}

impl Capture {
    pub fn start(source: Source, slot: Arc<Slot>, stop: Arc<AtomicBool>) -> anyhow::Result<Self> {
        let work = move || {
            let read = read(source, &slot, &stop);
            slot.end();
            read
        };
        Ok(Self { thread: std::thread::Builder::new().name("camera".into()).spawn(work)? })
    }

    /// What reading ended with. A thread that waits for a picture is not waited for.
    pub fn end(self) -> anyhow::Result<()> {
        let patience = Instant::now() + Duration::from_millis(500);
        while !self.thread.is_finished() {
            if Instant::now() > patience {
                return Ok(());
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        self.thread.join().unwrap_or_else(|_| bail!("reading pictures failed"))
    }
}

/// Puts pictures into the slot: those of a clip at its pace, others as they come.
fn read(mut source: Source, slot: &Slot, stop: &AtomicBool) -> anyhow::Result<()> {
    let begun = Instant::now();
    // Where the clip's present round begins, and with which picture.
    let (mut offset, mut round) = (0.0, 0);
    let step = source.info().rate.map_or(1.0 / 30.0, f64::recip);
    let (mut last, mut index) = (0.0, 0);
    while !stop.load(Ordering::Relaxed) {
        let next = match source.frames.next_frame() {
            Err(_) if stop.load(Ordering::Relaxed) => return Ok(()),
            next => next?,
        };
        let Some(frame) = next else {
            let shortfall = source.frames.shortfall();
            match (&source.clip, shortfall) {
                // Who sends until told otherwise has not sent all.
                (None, Some(told)) if !stop.load(Ordering::Relaxed) => {
                    bail!("{}: {told}", source.name.display());
                }
                (None, _) => {}
                // Once, not in each round.
                (Some(_), told) if offset == 0.0 => tell_shortfall(&source.name, told.as_deref()),
                _ => {}
            }
            match &source.clip {
                Some((options, true)) if index > round => {
                    source.frames = open(&source.name, options)?;
                    (offset, round) = (last + step, index);
                    continue;
                }
                _ => return Ok(()),
            }
        };
        let time = match &source.clip {
            Some(_) => {
                let due = Duration::from_secs_f64((frame.time + offset).max(0.0));
                std::thread::sleep(due.saturating_sub(begun.elapsed()));
                frame.time + offset
            }
            None => begun.elapsed().as_secs_f64(),
        };
        last = time;
        slot.put(Captured { frame: Frame { index, time, ..frame }, at: Instant::now(), time_ms: clock_ms() });
        index += 1;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_media::FrameError;
    use image::RgbImage;

    /// Two pictures, and what is said of the rest.
    struct Cut(ClipInfo, usize, Option<&'static str>);

    impl FrameSource for Cut {
        fn info(&self) -> &ClipInfo {
            &self.0
        }

        fn set_max_side(&mut self, _side: u32) {}

        fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
            self.1 += 1;
            Ok((self.1 < 3).then(|| captured(self.1).frame))
        }

        fn shortfall(&self) -> Option<String> {
            self.2.map(str::to_owned)
        }
    }

    #[test]
    fn what_ends_by_damage_is_an_error_but_of_clips() {
        let stop = AtomicBool::new(false);
        let ends = |shortfall, clip: bool| {
            let frames = Box::new(Cut(ClipInfo::default(), 0, shortfall));
            let clip = clip.then(|| (OpenOptions::default(), false));
            let slot = Slot::default();
            let read = read(Source { frames, name: "tcp://camera:1".into(), clip }, &slot, &stop);
            assert_eq!(slot.counted()[0], 2);
            read.map_err(|error| error.to_string())
        };
        assert_eq!(ends(Some("damaged: 2"), false).unwrap_err(), "tcp://camera:1: damaged: 2");
        assert_eq!((ends(None, false), ends(Some("damaged: 2"), true)), (Ok(()), Ok(())));
    }

    fn captured(index: usize) -> Captured {
        let frame = Frame { index, time: index as f64, image: RgbImage::new(1, 1) };
        Captured { frame, at: Instant::now(), time_ms: 0 }
    }

    #[test]
    fn names_of_cameras_are_no_patterns() {
        let known = || vec![Camera { id: "id?".into(), name: "USB 2.0 [HD] Camera".into() }];
        let called = |name: &str| camera_called(name, false, known());
        assert_eq!(called("USB 2.0 [HD] Camera").as_deref(), Some("id?"));
        for device in ["0", "id?", r"@device_pnp_\\?\usb#vid_0bda&pid_5"] {
            assert_eq!(called(device).as_deref(), Some(device));
        }
        for other in ["shots/*.png", "shot?", "clip.mp4", "a/b"] {
            assert_eq!(called(other), None, "{other}");
        }
        assert_eq!(camera_called("/dev/video0", true, Vec::new()).as_deref(), Some("/dev/video0"));
    }

    #[test]
    fn only_the_newest_picture_waits() {
        let slot = Slot::default();
        assert!(slot.take(Duration::ZERO).is_none());
        (0..3).for_each(|index| slot.put(captured(index)));
        assert_eq!(slot.take(Duration::ZERO).unwrap().frame.index, 2);
        assert!(slot.take(Duration::ZERO).is_none());
        assert_eq!(slot.counted(), [3, 2]);
        slot.end();
        assert!(slot.is_ended() && slot.take(Duration::from_secs(60)).is_none());
    }
}
