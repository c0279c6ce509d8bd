//! What is told of a clip that was tracked, counted while its frames pass.

use std::fmt::Write as _;
use std::time::Duration;

use handcast_hand::Absence;
use handcast_hand::smooth::Jitter;
use handcast_render::GOOD_CONFIDENCE;
use handcast_track::View;
use handcast_track::pipeline::{HandFrame, HandStart};

/// What became of a clip. The fields are the keys of the JSON report.
#[derive(Debug, serde::Serialize)]
pub struct Summary {
    pub clip: String,
    /// Of a run that went on from another one: seconds up to which poses are those of that one, of which nothing else here
    /// tells.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub resumed_at: Option<f64>,
    pub frames: usize,
    pub hands: Vec<HandSummary>,
    /// First and last frames of the stretches in which two hands touch, and both are held.
    pub touching: Vec<[usize; 2]>,
    /// The tone of the skin, 1 (lightest) to 10; `null` where no hand was sure.
    pub skin_tone: Option<u8>,
    /// Frames per second of each stage.
    pub tracking_fps: Speed,
}

/// Frames per second of each stage of tracking, and of all up to the poses.
#[derive(Debug, serde::Serialize)]
pub struct Speed {
    pub decode: f64,
    pub segment: f64,
    pub track: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub overlay: Option<f64>,
    pub whole: f64,
}

/// What became of one hand. Stretches of frames are given by their first and last.
#[derive(Debug, serde::Serialize)]
pub struct HandSummary {
    pub hand: &'static str,
    pub view: View,
    pub view_assumed: bool,
    /// The frame from which it is tracked both ways.
    pub start_frame: usize,
    /// Overlap of the fit with the open hand; `null` when tracking started from another posture.
    pub fit_iou: Option<f64>,
    pub tracked_frames: usize,
    pub lost_frames: usize,
    /// Over the frames in which it was tracked, as are the next three.
    pub mean_iou: f64,
    pub worst_iou: f64,
    pub worst_frame: usize,
    pub mean_confidence: f64,
    /// Tracked frames of a confidence below 0.5.
    pub low_confidence: Vec<[usize; 2]>,
    pub lost: Vec<[usize; 2]>,
    /// Frames before it was first seen open, which were not tracked.
    pub not_yet: Vec<[usize; 2]>,
    pub evaluations_per_frame: f64,
    pub restarts: usize,
    /// Unsteadiness of the poses without and with smoothing, degrees.
    pub jitter_deg: Option<[f64; 2]>,
}

/// Frames per second.
pub fn per_second(frames: usize, time: Duration) -> f64 {
    frames as f64 / time.as_secs_f64().max(1e-9)
}

/// Stretches of frames in words: at most so many, then how many more.
fn listed(ranges: &[[usize; 2]]) -> String {
    const MOST: usize = 12;
    let each = ranges.iter().take(MOST);
    let mut text = each
        .map(|[a, b]| if a == b { a.to_string() } else { format!("{a}-{b}") })
        .collect::<Vec<_>>()
        .join(", ");
    if ranges.len() > MOST {
        let _ = write!(text, " and {} more", ranges.len() - MOST);
    }
    text
}

/// Runs of consecutive numbers, by their first and last.
#[derive(Clone, Default)]
pub struct Ranges(pub Vec<[usize; 2]>);

impl Ranges {
    fn push(&mut self, number: usize) {
        match self.0.last_mut() {
            Some([_, last]) if *last + 1 == number => *last = number,
            _ => self.0.push([number, number]),
        }
    }
}

/// What is counted of a hand while its frames pass.
pub struct HandTally {
    /// What frames have of the hand before it was found.
    pub not_yet: HandFrame,
    /// Frames so far, those before the hand was found included.
    pub frames: usize,
    pub touching: Ranges,
    lost: Ranges,
    not_yet_in: Ranges,
    doubtful: Ranges,
    tracked: usize,
    /// Sums over frames: of the overlap and how many have one, of the confidence where the hand was tracked.
    iou: f64,
    with_iou: usize,
    confidence: f64,
    /// The smallest overlap, and its frame.
    worst: (f64, usize),
    evaluations: usize,
    restarts: usize,
    /// As registered, and as smoothed.
    jitter: [Jitter; 2],
}

impl HandTally {
    /// Of a hand that is found behind so many frames.
    pub fn new(start: &HandStart, before: usize) -> Self {
        Self {
            not_yet: start.not_yet(),
            frames: before,
            touching: Ranges::default(),
            lost: Ranges::default(),
            not_yet_in: Ranges((before > 0).then(|| [0, before - 1]).into_iter().collect()),
            doubtful: Ranges::default(),
            tracked: 0,
            iou: 0.0,
            with_iou: 0,
            confidence: 0.0,
            worst: (1.0, 0),
            evaluations: 0,
            restarts: 0,
            jitter: [Jitter::default(), Jitter::default()],
        }
    }

    /// Counts the next frame.
    pub fn push(&mut self, frame: &HandFrame, start: &HandStart) {
        let (number, tracked) = (self.frames, &frame.tracked);
        self.frames += 1;
        match frame.absent {
            Some(Absence::Touching) => self.touching.push(number),
            Some(Absence::NotYet) => self.not_yet_in.push(number),
            Some(Absence::Lost | Absence::Bridged) => self.lost.push(number),
            None => {}
        }
        // Where it is lost there may be no hand to lie over.
        if frame.absent.is_none() {
            self.iou += tracked.iou;
            self.with_iou += 1;
            if tracked.iou < self.worst.0 {
                self.worst = (tracked.iou, number);
            }
        }
        self.evaluations += tracked.evaluations;
        self.restarts += usize::from(tracked.restarted);
        let registered = tracked.valid.then(|| tracked.state.to_pose(start.side, &start.camera));
        let [before, after] = &mut self.jitter;
        before.push(registered.as_ref());
        after.push(tracked.valid.then_some(&frame.pose));
        if tracked.valid {
            self.tracked += 1;
            self.confidence += frame.confidence;
            if frame.confidence < GOOD_CONFIDENCE {
                self.doubtful.push(number);
            }
        }
    }

    /// What is told of the hand.
    pub fn summary(&self, start: &HandStart) -> HandSummary {
        let [before, after] = self.jitter.each_ref().map(Jitter::degrees);
        HandSummary {
            hand: start.side.name(),
            view: start.view,
            view_assumed: start.assumed,
            start_frame: start.frame,
            fit_iou: start.fit.as_ref().map(|fit| fit.iou),
            tracked_frames: self.tracked,
            lost_frames: self.lost.0.iter().map(|[a, b]| b - a + 1).sum(),
            mean_iou: self.iou / self.with_iou.max(1) as f64,
            worst_iou: if self.with_iou > 0 { self.worst.0 } else { 0.0 },
            worst_frame: self.worst.1,
            mean_confidence: self.confidence / self.tracked.max(1) as f64,
            low_confidence: self.doubtful.0.clone(),
            lost: self.lost.0.clone(),
            not_yet: self.not_yet_in.0.clone(),
            evaluations_per_frame: self.evaluations as f64 / self.frames.max(1) as f64,
            restarts: self.restarts,
            jitter_deg: before.zip(after).map(|(before, after)| [before, after]),
        }
    }
}

impl HandSummary {
    fn text(&self, t: &mut String, smooth: bool) {
        let view = self.view.name();
        let assumed = if self.view_assumed { " (assumed; see --hand, --view)" } else { "" };
        let start = match self.fit_iou {
            Some(iou) => format!("fitted on frame {}, overlap {iou:.3}", self.start_frame),
            None => format!("started from any posture on frame {}", self.start_frame),
        };
        let _ = writeln!(t, "  hand        {}, {view}{assumed}; {start}", self.hand);
        let _ = write!(t, "    tracked   {} frames", self.tracked_frames);
        for (what, list) in [("lost", &self.lost), ("not seen open before", &self.not_yet)] {
            if !list.is_empty() {
                let _ = write!(t, "; {what} {}", listed(list));
            }
        }
        let _ = writeln!(
            t,
            "\n    overlap   mean IoU {:.3}, worst {:.3} (frame {})",
            self.mean_iou, self.worst_iou, self.worst_frame
        );
        let _ = write!(t, "    sure      confidence {:.2} on average", self.mean_confidence);
        if !self.low_confidence.is_empty() {
            let _ = write!(t, "; below {GOOD_CONFIDENCE} in frames {}", listed(&self.low_confidence));
        }
        let _ = writeln!(t);
        if let (true, Some([before, after])) = (smooth, self.jitter_deg) {
            let _ = writeln!(t, "    smoothed  jitter {before:.2}° before, {after:.2}° after");
        }
    }
}

impl Summary {
    /// For people, of poses that were smoothed or not.
    pub fn text(&self, smooth: bool) -> String {
        let mut t = String::new();
        let tracked: usize = self.hands.iter().map(|h| h.tracked_frames).sum();
        match &self.hands[..] {
            [_] => {
                let _ = writeln!(t, "{}: {tracked} of {} frames tracked", self.clip, self.frames);
            }
            hands => {
                let _ = writeln!(t, "{}: {} hands in {} frames", self.clip, hands.len(), self.frames);
            }
        }
        if let Some(at) = self.resumed_at {
            let _ = writeln!(
                t,
                "  resumed     poses up to {at:.2} s are those of the run before; all else here is of the frames tracked now"
            );
        }
        for hand in &self.hands {
            hand.text(&mut t, smooth);
        }
        if !self.touching.is_empty() {
            let _ = writeln!(t, "  touching    frames {}: both hands held", listed(&self.touching));
        }
        if let Some(tone) = self.skin_tone {
            let _ = writeln!(t, "  skin        tone {tone} of 10");
        }
        t
    }

    /// The line about speed, for people; `more` are further stages.
    pub fn speed(&self, more: &str) -> String {
        let f = &self.tracking_fps;
        format!(
            "  frames/s    decode {:.0}, segment {:.0}, track {:.0}{more}; whole run {:.1}\n",
            f.decode, f.segment, f.track, f.whole
        )
    }
}
