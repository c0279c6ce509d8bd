//! The built-in clip and what is to be found in it.
//!
//! In the repository it is a file (fixtures/README.md). The package leaves that out, for its size; there `handcast synth`
//! draws one of the same motion when it is asked for, which takes some seconds (`build.rs` tells which).

use std::path::Path;

use anyhow::Context;
use handcast_eval::synth::{Synth, SynthOptions};
use handcast_formats::atomic::AtomicFile;
use handcast_formats::poses::PoseReader;
use handcast_hand::{PoseClip, PoseHeader, TimedPose};
use handcast_media::avi::MjpegWriter;

/// JPEG quality of clips that are drawn.
pub const QUALITY: u8 = 85;

/// The clip and its poses.
#[cfg(demo_clip)]
const FIXTURE: Option<[&[u8]; 2]> =
    Some([include_bytes!("../../fixtures/demo.avi"), include_bytes!("../../fixtures/demo.poses.jsonl")]);
#[cfg(not(demo_clip))]
const FIXTURE: Option<[&[u8]; 2]> = None;

/// Writes the clip.
///
/// # Errors
/// Where the file cannot be written.
pub fn write(path: &Path) -> anyhow::Result<()> {
    match FIXTURE {
        Some([clip, _]) => Ok(AtomicFile::write_all_to(path, clip)?),
        None => draw(path).with_context(|| path.display().to_string()),
    }
}

fn draw(path: &Path) -> anyhow::Result<()> {
    let synth = Synth::new(SynthOptions::default())?;
    let o = synth.options();
    let file = AtomicFile::create(path)?;
    let mut writer = MjpegWriter::new(file, o.size, MjpegWriter::<AtomicFile>::rate_of(o.rate), QUALITY)?;
    for i in 0..synth.frames() {
        writer.write(&synth.render(i).image)?;
    }
    Ok(writer.finish()?.commit()?)
}

/// Its true poses.
///
/// # Errors
/// None that the clip's own poses cause.
pub fn poses() -> anyhow::Result<PoseClip> {
    match FIXTURE {
        Some([_, poses]) => Ok(PoseReader::new(poses)?.into_clip()?),
        None => drawn_poses(),
    }
}

fn drawn_poses() -> anyhow::Result<PoseClip> {
    let synth = Synth::new(SynthOptions::default())?;
    let o = synth.options();
    let header = PoseHeader::one(o.side, Some(o.morphology.clone()), Some(o.rate));
    let frames = (0..synth.frames()).map(|i| TimedPose::new(synth.time(i), synth.pose(i))).collect();
    Ok(PoseClip { header, frames })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_drawn_is_as_long_as_the_fixture_and_of_the_same_hand() {
        let (drawn, fixture) = (drawn_poses().unwrap(), poses().unwrap());
        assert_eq!((drawn.frames.len(), drawn.header.rate), (fixture.frames.len(), fixture.header.rate));
        assert_eq!(drawn.header.hands[0].side, fixture.header.hands[0].side);
        for (a, b) in drawn.frames.iter().zip(&fixture.frames) {
            assert!((a.time - b.time).abs() < 1e-6 && a.valid && b.valid);
        }
    }
}
