//! One input to its stream.

use std::any::Any;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use handcast_codec::{EncodedClip, clip_rate, encode_bridged};
use handcast_formats::atomic::AtomicFile;
use handcast_formats::motion::{Format, Motion, at_even_times, check_span};
use handcast_formats::mp4;
use handcast_formats::whole::read_whole;
use handcast_hand::PoseClip;
use handcast_limits::Limits;
use handcast_media::{OpenOptions, Part, open};
use handcast_track::pipeline::{ClipOptions, FinderSource, track_clip};
use sha2::{Digest, Sha256};

use crate::corpus::{CorpusError, digest_of};
use crate::inputs::Item;
use crate::line::{Failure, Kind, Made, Outcome, Seen, one_line};
use crate::settings::{EncodeSettings, Settings, hex};

/// The folder of streams.
pub(crate) const STREAMS: &str = "streams";

/// A stream's path below the output folder.
pub(crate) fn stream_name(input: &str) -> String {
    format!("{STREAMS}/{input}.fba")
}

/// Does single inputs; any number of threads may share one.
#[derive(Clone, Debug)]
pub struct Worker {
    input: PathBuf,
    output: PathBuf,
    digest: String,
    track: ClipOptions,
    part: Part,
    encode: EncodeSettings,
    limits: Limits,
    places: Option<Places>,
}

/// Tells where the program broke down, of what was caught; a hook of the program may know.
pub type Places = fn(&(dyn Any + Send)) -> Option<String>;

/// Why an input has no stream, in words.
type Reason = String;

/// What is wrong, with its causes.
fn told(error: &dyn std::error::Error) -> Reason {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let more = error.to_string();
        if !text.ends_with(&more) {
            text = format!("{text}: {more}");
        }
        cause = error.source();
    }
    text
}

impl Worker {
    /// A worker for inputs below `input`, with streams below `output`.
    pub fn new(input: impl Into<PathBuf>, output: impl Into<PathBuf>, settings: &Settings) -> Self {
        Self {
            input: input.into(),
            output: output.into(),
            digest: settings.digest(),
            track: settings.track.options(None),
            part: settings.track.part(),
            encode: settings.encode.clone(),
            limits: Limits::default(),
            places: None,
        }
    }

    /// Sets what finds hands; [`TrackSettings::finder`](crate::TrackSettings::finder) names it.
    #[must_use]
    pub fn with_finder(mut self, finder: Option<FinderSource>) -> Self {
        self.track.finder = finder;
        self
    }

    /// Sets what an input may make it hold or do.
    #[must_use]
    pub fn with_limits(mut self, limits: Limits) -> Self {
        self.track.limits = limits.clone();
        self.limits = limits;
        self
    }

    /// Sets what tells where an input breaks down, so that its line says so.
    #[must_use]
    pub fn with_places(mut self, places: Places) -> Self {
        self.places = Some(places);
        self
    }

    /// What is said of an input that breaks down.
    fn broke_down(&self, payload: &(dyn Any + Send)) -> Reason {
        let place = self.places.and_then(|place| place(payload));
        let place = place.map_or_else(String::new, |place| format!(" at {place}"));
        format!("broke down{place}, which is a fault of the program")
    }

    /// Makes the stream of an input, and tells what became of it; what is wrong with the input, a fault of this program that
    /// it shows included, is no error.
    ///
    /// # Errors
    /// [`CorpusError::Output`]: nothing can be written any more.
    pub fn work(&self, item: &Item) -> Result<Outcome, CorpusError> {
        let path = item.path(&self.input);
        let mut sha256 = None;
        let made = catch_unwind(AssertUnwindSafe(|| self.made(&path, &mut sha256)))
            .unwrap_or_else(|payload| Err(self.broke_down(&*payload)));
        let outcome = made.and_then(|made| {
            let stream = stream_name(&item.name);
            let digest = hex(&Sha256::digest(&made.stream));
            let sha256 = sha256.clone().unwrap_or_default();
            let entry = made.entry(item, sha256, stream, digest, &self.digest);
            let to = self.output.join(&entry.stream);
            match write(&to, &made.stream) {
                Ok(()) => Ok(Ok(entry)),
                Err(error) if is_of_the_disk(&error) => {
                    Ok(Err(CorpusError::Output { path: to.display().to_string(), source: error }))
                }
                Err(error) => Err(error.to_string()),
            }
        });
        match outcome {
            Ok(Ok(entry)) => Ok(Outcome::Done(Box::new(entry))),
            Ok(Err(error)) => Err(error),
            Err(reason) => Ok(Outcome::Failed(Box::new(Failure {
                name: item.name.clone(),
                sha256,
                input_bytes: item.bytes,
                modified: item.modified,
                error: one_line(&unplaced(&reason, &path, &item.name)),
                made_by: crate::MADE_BY.into(),
                settings: self.digest.clone(),
            }))),
        }
    }

    fn made(&self, path: &Path, sha256: &mut Option<String>) -> Result<Made, Reason> {
        let bytes = std::fs::metadata(path).map_err(|error| told(&error))?.len();
        let is_mp4 = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("mp4"));
        if Format::by_name(path).is_some() || is_mp4 && bytes <= mp4::STREAM_ALONE_BYTES {
            // Of a clip, which an MP4 file may be as well, any number of bytes is allowed.
            let most = if is_mp4 { mp4::STREAM_ALONE_BYTES } else { self.limits.bytes };
            let content =
                read_whole(path, &self.limits.clone().with_bytes(most)).map_err(|error| told(&error))?;
            *sha256 = Some(hex(&Sha256::digest(&content)));
            if !is_mp4 || mp4::is_stream_alone(&content) {
                let motion =
                    Motion::parse_within(path, &content, &self.limits).map_err(|error| told(&error))?;
                drop(content);
                return self.of_motion(motion);
            }
        } else {
            *sha256 = Some(digest_of(path).map_err(|error| told(&error))?);
        }
        let opening = OpenOptions::default().with_limits(self.limits.clone()).with_part(self.part);
        let source = open(path, &opening).map_err(|error| told(&error))?;
        let tracked = track_clip(source, None, &self.track, &mut ()).map_err(|error| told(&error))?;
        let clip = PoseClip { header: tracked.header(), frames: tracked.poses() };
        let shortfall = tracked.shortfall;
        drop((tracked.hands, tracked.times));
        Ok(Made { shortfall, ..self.of_poses(clip, Kind::Clip)? })
    }

    fn of_motion(&self, mut motion: Motion) -> Result<Made, Reason> {
        if let Some(baps) = &motion.baps {
            let seen = Seen::of(&motion.clip);
            if self.encode.no_sizes {
                motion.clip.header.forget_person();
            }
            let coded = baps.encode(&motion.clip.header, self.encode.plan());
            let (stream, report) = coded.map_err(|error| told(&error))?;
            return Ok(Made { kind: Kind::Motion, stream, rate: baps.rate, report, seen, shortfall: None });
        }
        let clip = if motion.keyed {
            at_even_times(motion.clip, &self.limits).map_err(|error| told(&error))?
        } else {
            motion.clip
        };
        self.of_poses(clip, Kind::Motion)
    }

    fn of_poses(&self, mut clip: PoseClip, kind: Kind) -> Result<Made, Reason> {
        let seen = Seen::of(&clip);
        if self.encode.no_sizes {
            clip.header.forget_person();
        }
        check_span(&clip, clip_rate(&clip), &self.limits).map_err(|error| told(&error))?;
        let encoded = encode_bridged(&clip, self.encode.profile(), &self.encode.plan(), self.encode.max_gap);
        let EncodedClip { stream, report, clip, .. } = encoded.map_err(|error| told(&error))?;
        Ok(Made { kind, stream, rate: clip_rate(&clip), report, seen, shortfall: None })
    }
}

/// A reason in which an input has its name in place of its path: the line may be read elsewhere.
fn unplaced(reason: &str, path: &Path, name: &str) -> String {
    reason.replace(&path.display().to_string(), name)
}

fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)?;
    }
    AtomicFile::write_all_to(path, bytes)
}

/// Whether an error of writing is that of any file there.
fn is_of_the_disk(error: &io::Error) -> bool {
    use io::ErrorKind::{PermissionDenied, QuotaExceeded, ReadOnlyFilesystem, StorageFull};
    matches!(error.kind(), PermissionDenied | QuotaExceeded | ReadOnlyFilesystem | StorageFull)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_name_inputs_as_their_lines_do() {
        for (path, name) in [("/in/a/b.mp4", "a/b.mp4"), ("/b.mp4", "b.mp4"), (r"C:\in\a\b.mp4", "a/b.mp4")] {
            let reason = format!("{path}: 3 km/h, {path} is cut");
            assert_eq!(unplaced(&reason, Path::new(path), name), format!("{name}: 3 km/h, {name} is cut"));
        }
    }

    #[test]
    fn a_breakdown_says_where() {
        let worker = Worker::new("in", "out", &Settings::default());
        let payload: Box<dyn Any + Send> = Box::new("why");
        assert_eq!(worker.broke_down(&*payload), "broke down, which is a fault of the program");
        let worker =
            worker.with_places(|payload| payload.downcast_ref::<&str>().map(|s| format!("{s}.rs:3")));
        assert_eq!(worker.broke_down(&*payload), "broke down at why.rs:3, which is a fault of the program");
    }
}
