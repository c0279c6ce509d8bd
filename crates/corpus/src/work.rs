//! One input to its stream.

use std::any::Any;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use handcast_codec::{EncodedClip, clip_rate, encode_bridged, notices};
use handcast_formats::atomic::AtomicFile;
use handcast_formats::import::ImportOptions;
use handcast_formats::motion::{Format, Motion, at_even_times, check_span, even_rate};
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
    import: ImportOptions,
    /// What is told of importing, as options of the command.
    of_solving: Vec<&'static str>,
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
            import: settings.track.import(),
            of_solving: settings.track.of_solving(),
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
        let outcome = made.and_then(|mut made| {
            for notice in &mut made.notices {
                *notice = unplaced(notice, &path, &item.name);
            }
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
                let motion = Motion::parse_imported(path, &content, &self.import, &self.limits);
                drop(content);
                return self.of_motion(motion.map_err(|error| told(&error))?);
            }
        } else {
            *sha256 = Some(digest_of(path).map_err(|error| told(&error))?);
        }
        let opening = OpenOptions::default().with_limits(self.limits.clone()).with_part(self.part);
        let source = open(path, &opening).map_err(|error| told(&error))?;
        let mut notices = source.info().notices();
        let tracked = track_clip(source, None, &self.track, &mut ()).map_err(|error| told(&error))?;
        let clip = PoseClip { header: tracked.header(), frames: tracked.poses() };
        notices.extend(tracked.shortfall.clone());
        notices.extend(tracked.notices(self.track.view));
        let shortfall = tracked.shortfall;
        drop((tracked.hands, tracked.times));
        Ok(Made { shortfall, ..self.of_poses(clip, Kind::Clip, notices)? })
    }

    fn of_motion(&self, mut motion: Motion) -> Result<Made, Reason> {
        let mut notices = std::mem::take(&mut motion.notes);
        if motion.import.is_none() && !self.of_solving.is_empty() {
            let change = if self.of_solving.len() > 1 { "change" } else { "changes" };
            let idle = self.of_solving.join(", ");
            notices.push(format!("it has poses, which are encoded as they are: {idle} {change} nothing"));
        }
        // What is played beside a part of it begins there, too.
        if self.part.from <= 0.0 {
            notices.extend(notices::of_start(&motion.clip));
        }
        if let Some(baps) = motion.baps.as_ref().filter(|_| self.takes_all()) {
            let seen = Seen::of(&motion.clip);
            notices.extend(notices::of_rate(baps.rate));
            if self.encode.no_sizes {
                motion.clip.header.forget_person();
            }
            let plan = self.encode.plan();
            let coded = baps.encode(&motion.clip.header, plan);
            let (stream, report) = coded.map_err(|error| told(&error))?;
            notices.extend(notices::of_report(plan.mode, plan.live, &report, None));
            let (kind, rate) = (Kind::Motion, baps.rate);
            return Ok(Made { kind, stream, rate, report, seen, shortfall: None, notices });
        }
        let mut clip = if motion.keyed {
            notices.extend(notices::of_times(&motion.clip, even_rate(&motion.clip)));
            at_even_times(motion.clip, &self.limits).map_err(|error| told(&error))?
        } else {
            motion.clip
        };
        self.choose(&mut clip)?;
        self.of_poses(clip, Kind::Motion, notices)
    }

    /// Whether all of a motion is encoded.
    fn takes_all(&self) -> bool {
        self.import.side.is_none() && self.part.is_whole()
    }

    /// Leaves of poses the hand and the part that are asked for.
    fn choose(&self, clip: &mut PoseClip) -> Result<(), Reason> {
        if let Some(side) = self.import.side {
            clip.header.hands.retain(|hand| hand.side == side);
            clip.frames.retain(|pose| pose.pose.side == side);
            if clip.frames.is_empty() {
                return Err(format!("no hand is called {}", side.name()));
            }
        }
        if self.part.is_whole() {
            return Ok(());
        }
        let times = || clip.frames.iter().map(|pose| pose.time);
        let (first, last) =
            (times().fold(f64::INFINITY, f64::min), times().fold(f64::NEG_INFINITY, f64::max));
        // Times of a clock say when it was, not where in it.
        let zero = if first >= notices::EARLIEST_CLOCK { first } else { 0.0 };
        clip.frames.retain(|pose| self.part.has(pose.time - zero));
        if clip.frames.is_empty() {
            let Part { from, until, .. } = self.part;
            let until = if until.is_finite() { format!(" until {until} s") } else { String::new() };
            let [first, last] = [first, last].map(|time| time - zero);
            return Err(format!(
                "no pose from {from} s{until}: there are some from {first:.3} to {last:.3} s"
            ));
        }
        Ok(())
    }

    fn of_poses(&self, mut clip: PoseClip, kind: Kind, mut notices: Vec<String>) -> Result<Made, Reason> {
        let seen = Seen::of(&clip);
        let (profile, plan) = (self.encode.profile(), self.encode.plan());
        notices.extend(notices::of_poses(&clip, profile, self.encode.max_gap));
        if self.encode.no_sizes {
            clip.header.forget_person();
        }
        check_span(&clip, clip_rate(&clip), &self.limits).map_err(|error| told(&error))?;
        let encoded = encode_bridged(&clip, profile, &plan, self.encode.max_gap);
        let EncodedClip { stream, report, tips, clip: sent, .. } = encoded.map_err(|error| told(&error))?;
        let rate = clip_rate(&sent);
        notices.extend(notices::of_times(&clip, rate));
        notices.extend(notices::of_report(plan.mode, plan.live, &report, tips));
        Ok(Made { kind, stream, rate, report, seen, shortfall: None, notices })
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
