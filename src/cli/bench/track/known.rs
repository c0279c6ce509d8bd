//! What is known of clips from elsewhere, and how far a tracker agrees with it.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::bail;
use handcast_eval::fidelity::{
    CountLabels, CountReport, RangeCounts, ReferenceMeter, ReferenceReport, Said, TipDistance,
    length_in_pictures,
};
use handcast_formats::landmarks::LandmarkClip;
use handcast_hand::{Finger, count_extended, count_extended_of};
use handcast_track::HandModel;
use serde::Serialize;

use super::measured::Found;
use super::report::Report;
use super::sequence::Sequence;

/// What is known of one clip.
pub struct Known {
    reference: Option<(PathBuf, LandmarkClip)>,
    counts: Option<(PathBuf, CountLabels)>,
}

/// How far a tracker agrees with what is known of a clip.
#[derive(Debug, Serialize)]
pub struct KnownReport {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reference: Option<ReferenceReport>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub counts: Option<CountReport>,
}

/// Makes sure that no labels of `what` lie beyond a clip of so many frames.
pub fn check_ranges(
    what: &str,
    path: &Path,
    mut ranges: impl Iterator<Item = [usize; 2]>,
    frames: usize,
) -> anyhow::Result<()> {
    match ranges.find(|[_, last]| *last >= frames) {
        Some([first, last]) => {
            bail!("{what}: {}: frames {first}-{last}: the clip has {frames} frames", path.display())
        }
        None => Ok(()),
    }
}

impl Known {
    pub fn read(reference: Option<&PathBuf>, counts: Option<&PathBuf>) -> anyhow::Result<Self> {
        Ok(Self {
            reference: reference
                .map(|path| read_reference(path).map(|clip| (path.clone(), clip)))
                .transpose()?,
            counts: counts
                .map(|path| CountLabels::read(path).map(|labels| (path.clone(), labels)))
                .transpose()?,
        })
    }

    /// Makes sure that what is known is known of this clip.
    pub fn check(&self, sequence: &Sequence) -> anyhow::Result<()> {
        let Some(clip) = &sequence.clip else { return Ok(()) };
        let frames = clip.found.len();
        // Frames are matched by their numbers: the times of other trackers are often nominal.
        if let Some((path, reference)) = &self.reference {
            let has = reference.frames.len();
            if has < frames || has > frames && !clip.cut {
                bail!("reference: {}: {has} frames, the clip has {frames}", path.display());
            }
        }
        match &self.counts {
            Some((path, labels)) if !clip.cut => {
                check_ranges("counts", path, labels.ranges().iter().map(|r| [r.first, r.last]), frames)
            }
            _ => Ok(()),
        }
    }

    /// Measures what a tracker found in the clip.
    pub fn measure(&self, sequence: &Sequence, found: &[Found]) -> KnownReport {
        let reference = self.reference.as_ref().and_then(|(_, reference)| {
            let mut meter = ReferenceMeter::new(reference)?;
            let model =
                HandModel::new(&sequence.fit.morphology, sequence.fit.side).with_camera(sequence.camera);
            let scale = sequence.clip.as_ref().map_or(1.0, |clip| clip.scale);
            for f in found {
                let joints = model.joints(&f.state).map(|p| p.map(|v| v * scale));
                meter.add(f.frame, &f.pose, &joints);
            }
            Some(meter.report())
        });
        let counts = self.counts.as_ref().map(|(_, labels)| {
            labels.score(|frame| {
                let at = found.binary_search_by_key(&frame, |f| f.frame).ok()?;
                found.get(at).map(|f| count_extended(&f.pose))
            })
        });
        KnownReport { reference, counts }
    }

    /// What the reference itself says where the number of fingers is known: how far it can be trusted.
    pub fn counts_of_reference(&self) -> Option<CountReport> {
        let ((_, reference), (_, labels)) = (self.reference.as_ref()?, self.counts.as_ref()?);
        Some(labels.score(|frame| count_extended_of(&reference.frames.get(frame)?.points)))
    }
}

fn read_reference(path: &Path) -> anyhow::Result<LandmarkClip> {
    let clip = LandmarkClip::read(path)?;
    if length_in_pictures(&clip).is_none() {
        bail!(
            "reference: {}: no frame has `image`, the positions of the joints in the picture",
            path.display()
        );
    }
    Ok(clip)
}

/// The number of fingers said, how often each: `3×25 2×6`.
fn said(said: &Said) -> String {
    let mut counts: Vec<(usize, usize)> = said.iter().copied().enumerate().filter(|c| c.1 > 0).collect();
    counts.sort_by_key(|c| std::cmp::Reverse(c.1));
    counts.iter().map(|(fingers, frames)| format!(" {fingers}×{frames}")).collect()
}

pub fn percent(share: Option<f64>) -> String {
    share.map_or("-".into(), |share| format!("{:.1} %", 100.0 * share))
}

impl Report {
    /// All methods on all clips of which something is known.
    fn known_of(&self) -> impl Iterator<Item = (&str, &str, &KnownReport)> {
        self.methods.iter().flat_map(|m| {
            self.sequences.iter().zip(&m.known).map(|(name, known)| (m.name.as_str(), name.as_str(), known))
        })
    }

    /// Tables of the agreement with what is known.
    pub fn agreement(&self, t: &mut String) {
        self.tip_distances(t);
        self.extended(t);
    }

    fn tip_distances(&self, t: &mut String) {
        let rows: Vec<_> =
            self.known_of().filter_map(|(m, clip, k)| Some((m, clip, k.reference.as_ref()?))).collect();
        if rows.is_empty() {
            return;
        }
        let _ = writeln!(
            t,
            "\nfingertips that stand out, distance in the picture from the reference (another tracker, with error),\n\
             percent of the hand's length: median / mean / 90th percentile (tips); joint angles: median, mean\n\
             {:<27} {:<16} {:>27}   angles",
            "method", "clip", "all fingers"
        );
        let cell = |d: &TipDistance| format!("{:.1} / {:.1} / {:.1} ({})", d.median, d.mean, d.p90, d.tips);
        for (method, clip, r) in rows {
            let angles = match (r.angle_median_deg, r.angle_mean_deg) {
                (Some(median), Some(mean)) => format!("{median:.1}° {mean:.1}°"),
                _ => "-".into(),
            };
            let _ = writeln!(t, "{method:<27} {clip:<16} {:>27}   {angles}", cell(&r.tips));
            for (finger, d) in Finger::ALL.into_iter().zip(&r.fingers).filter(|(_, d)| d.tips > 0) {
                let _ = writeln!(t, "{:<27} {:<16} {:>27}", "", finger.name(), cell(d));
            }
        }
    }

    fn extended(&self, t: &mut String) {
        for (method, clip, known) in self.known_of() {
            if let Some(e) = known.reference.as_ref().map(|r| &r.extended).filter(|e| e.frames > 0) {
                let (share, frames) = (percent(e.share), e.frames);
                let _ = writeln!(
                    t,
                    "\n{method}, {clip}: as many fingers stretched out as in the reference in {share} of {frames} frames"
                );
                for (fingers, by) in
                    e.by_reference.iter().enumerate().filter(|(_, by)| by.iter().any(|n| *n > 0))
                {
                    let _ = writeln!(t, "  reference {fingers}: said{}", said(by));
                }
            }
            if let Some(counts) = &known.counts {
                labelled(t, method, clip, counts);
            }
        }
        for (clip, counts) in self.sequences.iter().zip(&self.reference_counts) {
            if let Some(counts) = counts {
                labelled(t, "the reference itself", clip, counts);
            }
        }
    }
}

pub fn labelled(t: &mut String, who: &str, clip: &str, counts: &CountReport) {
    let (share, frames, without) = (percent(counts.share), counts.frames, without(counts.missed));
    let _ = writeln!(
        t,
        "\n{who}, {clip}: as many fingers stretched out as labelled in {share} of {frames} frames{without}"
    );
    for r in &counts.ranges {
        let _ = writeln!(t, "{}", range_line(r));
    }
}

/// How many of labelled frames show no hand.
pub fn without(missed: usize) -> String {
    if missed > 0 { format!(", {missed} without a hand") } else { String::new() }
}

fn range_line(r: &RangeCounts) -> String {
    let frames = format!("{}-{}", r.first, r.last);
    let share = percent(Some(r.right as f64 / r.frames.max(1) as f64));
    format!(
        "  {frames:>11}: {} shown, right in {share:>7} of {:>3} frames{}, said{}",
        r.fingers,
        r.frames,
        without(r.missed),
        said(&r.said)
    )
}
