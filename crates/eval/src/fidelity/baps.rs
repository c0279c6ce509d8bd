//! Two BAP sequences, value by value.

use serde::Serialize;

use handcast_fba::bap::{Bap, BapFrame, Unit};
use handcast_fba::encoder::degrees_per_unit;
use handcast_fba::plan::TimedBapFrame;
use handcast_formats::motion::BapTrack;

/// One BAP in both sequences.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BapDifference {
    /// Its number.
    pub bap: u16,
    /// Its name, of the 186 that have one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<&'static str>,
    /// Frames in which the values differ.
    pub frames: usize,
    /// Largest difference, in the BAP's unit.
    pub max: u32,
    /// Frame of the first sequence where it is largest.
    pub at: usize,
}

/// Where two sequences part.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BapDivergence {
    /// Frame of the first sequence, from 0.
    pub frame: usize,
    /// Its time, seconds.
    pub time: f64,
    /// The first BAP that differs, in ascending order of numbers.
    pub bap: u16,
    /// Its name, of the 186 that have one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<&'static str>,
    /// Its value in the first sequence; `None` where it is masked off.
    pub a: Option<i32>,
    /// Its value in the second sequence.
    pub b: Option<i32>,
}

/// Two sequences compared in BAP units.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct BapComparison {
    /// Frames compared: those of the first sequence at whose time the second has one, or holds one.
    pub frames: usize,
    /// BAPs that are on in some frame of the first sequence only.
    pub only_a: Vec<u16>,
    /// BAPs that are on in some frame of the second only.
    pub only_b: Vec<u16>,
    /// The BAPs of both whose values ever differ.
    pub baps: Vec<BapDifference>,
    /// Where they part.
    pub first_divergence: Option<BapDivergence>,
    /// Largest difference of a BAP that is an angle, degrees.
    pub max_deg: f64,
}

impl BapComparison {
    /// Whether no value differs.
    pub fn is_equal(&self) -> bool {
        self.first_divergence.is_none() && self.frames > 0
    }
}

/// Compares the frames of `a` with those that `b` shows at the same time from its first frame on.
pub fn compare_baps(a: &BapTrack, b: &BapTrack) -> BapComparison {
    let mut out = BapComparison::default();
    let (in_a, in_b) = (a.frames.mask(), b.frames.mask());
    out.only_a = in_a.difference(&in_b).iter().map(Bap::number).collect();
    out.only_b = in_b.difference(&in_a).iter().map(Bap::number).collect();
    let mut differing: Vec<Option<BapDifference>> = vec![None; handcast_fba::bap::BAP_COUNT];
    let start = |track: &BapTrack| track.frames.times().first().copied().unwrap_or(0.0);
    let (start_a, start_b) = (start(a), start(b));
    let slack = 0.5 / b.rate;
    let end = b.frames.times().last().map_or(0.0, |time| time - start_b) + slack;
    let mut others = b.frames.iter().peekable();
    let mut shown = others.next();
    for (index, frame) in a.frames.iter().enumerate() {
        let time = frame.time - start_a;
        while let Some(next) = others.next_if(|next| next.time - start_b <= time + slack) {
            shown = Some(next);
        }
        let Some(other) = shown.filter(|_| time <= end) else { continue };
        out.frames += 1;
        compare_frames(index, &frame, &other.baps, &mut differing, &mut out);
    }
    out.baps = differing.into_iter().flatten().collect();
    out
}

fn compare_frames(
    index: usize,
    frame: &TimedBapFrame,
    other: &BapFrame,
    differing: &mut [Option<BapDifference>],
    out: &mut BapComparison,
) {
    for bap in frame.baps.mask.union(&other.mask).iter() {
        let (a, b) = (frame.baps.get(bap), other.get(bap));
        if a == b {
            continue;
        }
        let name = bap.info().map(|info| info.name);
        out.first_divergence.get_or_insert(BapDivergence {
            frame: index,
            time: frame.time,
            bap: bap.number(),
            name,
            a,
            b,
        });
        let (Some(a), Some(b)) = (a, b) else { continue };
        let off = a.abs_diff(b);
        if bap.unit() == Unit::Angle {
            out.max_deg = out.max_deg.max(f64::from(off) * degrees_per_unit(bap));
        }
        if let Some(slot) = differing.get_mut(bap.index()) {
            let entry =
                slot.get_or_insert(BapDifference { bap: bap.number(), name, frames: 0, max: 0, at: 0 });
            entry.frames += 1;
            if off > entry.max {
                (entry.max, entry.at) = (off, index);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn track(values: &[(f64, i32)]) -> BapTrack {
        let [bend, foot] = ["r_index1_flexion", "l_hip_flexion"].map(|n| Bap::from_name(n).unwrap());
        let frame = |&(time, value): &(f64, i32)| TimedBapFrame {
            time,
            baps: [(bend, value), (foot, 5)].into_iter().collect(),
        };
        BapTrack { rate: 10.0, frames: values.iter().map(frame).collect() }
    }

    #[test]
    fn the_first_value_that_parts_is_named() {
        let a = track(&[(0.0, 0), (0.1, 10), (0.2, 20), (0.3, 30)]);
        assert!(compare_baps(&a, &a).is_equal());
        // The second begins later and leaves out a frame that it would only repeat.
        let b = track(&[(5.0, 0), (5.1, 10), (5.3, 30)]);
        let found = compare_baps(&a, &b);
        let first = found.first_divergence.as_ref().unwrap();
        assert_eq!(
            (first.frame, first.name, first.a, first.b),
            (2, Some("r_index1_flexion"), Some(20), Some(10))
        );
        assert_eq!((found.frames, found.baps.len(), found.baps[0].frames, found.baps[0].max), (4, 1, 1, 10));
        assert!((found.max_deg - 1e-4f64.to_degrees()).abs() < 1e-12);
    }

    #[test]
    fn baps_of_one_alone_are_listed() {
        let a = track(&[(0.0, 0)]);
        let mut more = a.frames.iter().next().unwrap();
        more.baps.set(Bap::new(190).unwrap(), 0);
        let b = BapTrack { rate: a.rate, frames: [more].into_iter().collect() };
        let found = compare_baps(&a, &b);
        assert_eq!((found.only_a.len(), found.only_b.as_slice()), (0, &[190][..]));
        let first = found.first_divergence.unwrap();
        assert_eq!((first.bap, first.name, first.a, first.b), (190, None, None, Some(0)));
    }
}
