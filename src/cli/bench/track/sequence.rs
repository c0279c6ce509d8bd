//! What trackers are measured on.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, bail};
use handcast_eval::synth::{ScriptedMotion, Synth, SynthOptions, random_morphology};
use handcast_hand::{HandPose, Side};
use handcast_media::{ClipInfo, Frame, FrameError, FrameSource, OpenOptions, open};
use handcast_track::pipeline::{ClipOptions, ClipSink, HandFrame, HandStart, TrackedFrame, track_clip};
use handcast_track::{Fit, Forearm, PinholeCamera, View};
use handcast_vision::{Mask, SegmentOptions, Segmenter};
use image::RgbImage;

use super::Silhouettes;
use crate::cli::common::tell_shortfall;

/// One frame as trackers see it, and what is known of it.
pub struct Sighting {
    pub silhouette: Mask,
    pub forearm: Option<Forearm>,
    pub image: Option<RgbImage>,
    pub truth: Option<HandPose>,
    pub visible: bool,
}

/// A sequence that begins with the open hand.
pub struct Sequence {
    pub name: String,
    pub fit: Fit,
    pub camera: PinholeCamera,
    pub frames: Vec<Sighting>,
    /// Of a clip, what is known beyond that.
    pub clip: Option<ClipSequence>,
}

/// A clip as `handcast track` sees it.
pub struct ClipSequence {
    /// Number of the frame of the clip that the sequence begins with.
    pub first: usize,
    /// Whether there may be more frames.
    pub cut: bool,
    /// Pixels of the clip in one of the pictures that are analysed.
    pub scale: f64,
    /// Whether there was a silhouette, and what the pipeline found, in all frames: backwards from the open hand
    /// too.
    pub found: Vec<(bool, HandFrame)>,
    /// Seconds a frame took to track.
    pub seconds: f64,
}

/// How synthetic sequences are made.
pub struct Synthetic {
    pub frames: usize,
    pub size: (u32, u32),
    pub seed: u64,
    pub random_hand: bool,
    pub roughness: f64,
    pub silhouettes: Silhouettes,
}

/// Pictures from which colours are learnt.
const LEARNT: usize = 12;

impl Synthetic {
    /// The sequence of a motion. The sizes of the hand and its first state are given to the trackers as
    /// they are: only registration is measured.
    pub fn make(&self, motion: ScriptedMotion) -> anyhow::Result<Sequence> {
        let mut o = SynthOptions::default();
        o.motion = motion;
        o.frames = self.frames;
        o.size = self.size;
        o.seed = self.seed;
        o.roughness = self.roughness;
        o.compression = Some(85);
        if self.random_hand {
            o.morphology = random_morphology(self.seed);
        }
        let synth = Synth::new(o)?;
        let mut segmenter = match self.silhouettes {
            Silhouettes::Picture => Some(self.segmenter(&synth)?),
            _ => None,
        };
        let frames =
            (0..synth.frames()).map(|i| self.frame(&synth, i, segmenter.as_mut())).collect::<Vec<_>>();
        let camera = synth.track_camera();
        let first = frames.first().context("no frames")?;
        let fit = synth.true_fit(&first.silhouette, first.forearm);
        Ok(Sequence { name: motion.name().to_owned(), fit, camera, frames, clip: None })
    }

    fn segmenter(&self, synth: &Synth) -> anyhow::Result<Segmenter> {
        let stride = synth.frames().div_ceil(LEARNT);
        let samples: Vec<_> = (0..synth.frames()).step_by(stride).map(|i| synth.render(i).image).collect();
        Segmenter::learn(&samples, SegmentOptions::default()).context("the colours cannot be learnt")
    }

    fn frame(&self, synth: &Synth, i: usize, segmenter: Option<&mut Segmenter>) -> Sighting {
        let truth = Some(synth.pose(i));
        if let Some(segmenter) = segmenter {
            let picture = synth.render(i);
            let visible = !picture.hand.is_empty();
            let (silhouette, forearm) = match segmenter.segment(&picture.image) {
                Ok(s) => (synth.roughened(s.hand, i), s.wrist.as_ref().map(Forearm::from)),
                Err(_) => (Mask::new(self.size.0, self.size.1), None),
            };
            return Sighting { silhouette, forearm, image: Some(picture.image), truth, visible };
        }
        let (silhouette, forearm) = match self.silhouettes {
            Silhouettes::Model => (synth.model_silhouette(i), None),
            _ => (synth.silhouette(i), synth.forearm(i)),
        };
        let visible = !silhouette.is_empty();
        Sighting { silhouette, forearm, image: None, truth, visible }
    }
}

/// How clips are read.
pub struct Clip {
    pub side: Option<Side>,
    pub view: Option<View>,
    /// At most so many frames.
    pub frames: Option<usize>,
}

impl Clip {
    /// Tracks a clip as `handcast track` does; the sequence begins with the open hand.
    pub fn read(&self, path: &Path) -> anyhow::Result<Sequence> {
        let source = open(path, &OpenOptions::default())?;
        let width = source.info().width;
        let mut options = ClipOptions::default();
        options.side = self.side;
        options.view = self.view;
        let mut keeper = Keeper::default();
        let limit = self.frames.unwrap_or(usize::MAX);
        let clip = track_clip(Limited { source, left: limit }, None, &options, &mut keeper)
            .with_context(|| path.display().to_string())?;
        tell_shortfall(path, clip.shortfall.as_deref());
        let (Some(start), Some(track)) = (keeper.start, clip.hands.into_iter().next()) else {
            bail!("{}: no hand", path.display());
        };
        let fit = start.fit.with_context(|| format!("{}: no open hand", path.display()))?;
        let seconds = clip.timings.frames.track.iter().map(Duration::as_secs_f64).sum::<f64>();
        let clip = ClipSequence {
            first: start.frame,
            cut: clip.times.len() == limit,
            scale: f64::from(width) / f64::from(start.camera.width.max(1)),
            seconds: seconds / clip.times.len().max(1) as f64,
            found: keeper.frames.iter().map(|f| f.visible).zip(track.frames).collect(),
        };
        let frames = keeper.frames.into_iter().skip(start.frame).collect();
        let name = path.file_stem().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        Ok(Sequence { name, fit, camera: start.camera, frames, clip: Some(clip) })
    }
}

/// The first frames of a source.
struct Limited<S> {
    source: S,
    left: usize,
}

impl<S: FrameSource> FrameSource for Limited<S> {
    fn info(&self) -> &ClipInfo {
        self.source.info()
    }

    fn set_max_side(&mut self, side: u32) {
        self.source.set_max_side(side);
    }

    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        if self.left == 0 {
            return Ok(None);
        }
        self.left -= 1;
        self.source.next_frame()
    }

    fn shortfall(&self) -> Option<String> {
        self.source.shortfall()
    }
}

/// Keeps what the pipeline sees.
#[derive(Default)]
struct Keeper {
    start: Option<HandStart>,
    frames: Vec<Sighting>,
}

impl ClipSink for Keeper {
    fn fitted(&mut self, start: &HandStart) {
        self.start.get_or_insert_with(|| start.clone());
    }

    fn tracked(&mut self, frame: TrackedFrame<'_>) -> Result<(), String> {
        let (silhouette, forearm) = match frame.hands.first().and_then(|hand| hand.silhouette) {
            Some(s) => (s.hand.clone(), s.wrist.as_ref().map(Forearm::from)),
            None => (Mask::new(frame.image.width(), frame.image.height()), None),
        };
        let visible = !silhouette.is_empty();
        self.frames.push(Sighting {
            silhouette,
            forearm,
            image: Some(frame.image.clone()),
            truth: None,
            visible,
        });
        Ok(())
    }
}
