//! One motion in each format, and what comes back.

use anyhow::Context;
use handcast_codec::mapping::Profile;
use handcast_codec::{bap_frames, decode_poses, encode_poses, poses_from_frames};
use handcast_fba::DecoderOptions;
use handcast_fba::plan::{PlanOptions, Target, TimedBapFrame};
use handcast_formats::motion::{BapTrack, clip_from_glb, read_bvh, write_bvh};
use handcast_gltf::{ExportOptions, JointNames, export};
use handcast_hand::{HandPose, Morphology, PoseClip, TimedPose};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::gltfpack::Packer;
use super::{Measure, Sample};
use crate::cli::bench::baselines::{Baselines, columns, deltas_error, half_error};
use crate::cli::glb_out::METRES_PER_RADIAN;

/// The row that all others are compared with.
pub const OURS: &str = "FBA stream";

/// The rows of the table for one motion.
pub fn measure(
    sample: &Sample,
    rms: f64,
    packer: Option<&Packer>,
) -> anyhow::Result<Vec<(&'static str, Measure)>> {
    let aimed = PlanOptions { mode: Target::Rms(rms), ..PlanOptions::default() };
    let ours = stream(sample, &aimed)?;
    let live = stream(sample, &PlanOptions { live: true, ..aimed })?;
    // As the formats of whole files: nobody can join later.
    let whole = stream(sample, &PlanOptions { intra_seconds: 1e6, ..aimed })?;
    let aim = ours.rms_deg();
    let clip = &sample.clip;
    let frames = bap_frames(clip, Profile::Hand)?;
    let mut rows = vec![
        ("raw f32, JSON", json(sample)?),
        (".bap text", bap_text(sample, &frames)?),
        ("BVH", biovision(sample)?),
        ("GLB, animation alone", glb(sample, &ExportOptions::default())?.1),
        ("GLB, keys dropped, shorts", smallest_glb(sample, aim)?),
    ];
    if let Some(packer) = packer {
        let [packed, with_zstd] = packer.measure(sample, aim)?;
        rows.push(("GLB through gltfpack -cc", packed));
        rows.push(("the same through zstd -19", with_zstd));
    }
    let columns = columns(&frames);
    let others = Baselines::measure(&frames, aim)?;
    let count = sample.frames();
    rows.extend([
        ("raw f32, binary", Measure::new(others.f32, count, [0.0; 2])),
        ("f16, zstd -19", Measure::new(others.f16_zstd, count, half_error(&columns))),
        (
            "integer differences, zstd -19",
            Measure::new(others.deltas_zstd, count, deltas_error(&columns, aim)?),
        ),
        ("FBA stream, live", live),
        ("FBA stream, one I plane", whole),
        (OURS, ours),
    ]);
    Ok(rows)
}

fn stream(sample: &Sample, options: &PlanOptions) -> anyhow::Result<Measure> {
    let encoded = encode_poses(&sample.clip, Profile::Hand, options)?;
    let back = decode_poses(&encoded.stream, None, DecoderOptions::default())?;
    Measure::of(sample, encoded.stream.len(), &back.clip, false)
}

/// Angles in radians, then the wrist's translation and rotation, a list for each pose.
fn json(sample: &Sample) -> anyhow::Result<Measure> {
    let rows: Vec<Vec<f32>> = sample
        .clip
        .frames
        .iter()
        .map(|f| {
            let place = f.pose.translation.iter().chain(f.pose.rotation.coords.iter());
            f.pose.angles.iter().chain(place).map(|&v| v as f32).collect()
        })
        .collect();
    let bytes = serde_json::to_vec(&rows)?;
    let read: Vec<Vec<f32>> = serde_json::from_slice(&bytes)?;
    let mut back = PoseClip { header: sample.clip.header.clone(), frames: Vec::new() };
    for (frame, row) in sample.clip.frames.iter().zip(read) {
        let mut values = row.into_iter().map(f64::from);
        let mut next = || values.next().context("a value is missing");
        let mut pose = HandPose::neutral(frame.pose.side);
        for angle in &mut pose.angles {
            *angle = next()?;
        }
        pose.translation = Vector3::new(next()?, next()?, next()?);
        let (x, y, z, w) = (next()?, next()?, next()?, next()?);
        pose.rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        back.frames.push(TimedPose::new(frame.time, pose));
    }
    Measure::of(sample, bytes.len(), &back, false)
}

fn rate(sample: &Sample) -> anyhow::Result<f64> {
    sample.clip.header.rate.context("no rate")
}

fn bap_text(sample: &Sample, frames: &[TimedBapFrame]) -> anyhow::Result<Measure> {
    let track = BapTrack { rate: rate(sample)?, frames: frames.iter().copied().collect() };
    let written = track.to_text("motion");
    let back = BapTrack::from_text(&written)?;
    let (clip, _) = poses_from_frames(&back.frames, back.rate, None, false);
    Measure::of(sample, written.len(), &clip, false)
}

fn biovision(sample: &Sample) -> anyhow::Result<Measure> {
    let mut text = Vec::new();
    write_bvh(&sample.clip, &Morphology::default(), JointNames::WebXr, rate(sample)?, &mut text)?;
    let text = String::from_utf8(text)?;
    Measure::of(sample, text.len(), &read_bvh(&text)?, false)
}

/// The motion of the hands, with joints but without a mesh.
pub fn glb(sample: &Sample, options: &ExportOptions) -> anyhow::Result<(Vec<u8>, Measure)> {
    let mut options = options.clone();
    options.animation_only = true;
    let bytes = export(&handcast_gltf::Clip::of(&sample.clip, &Morphology::default()), &options)?;
    let measure = Measure::of(sample, bytes.len(), &clip_from_glb(&bytes)?, true)?;
    Ok((bytes, measure))
}

/// The smallest GLB of our own whose error is no larger than `rms` degrees: keys that interpolation gives back are
/// dropped, rotations are shorts.
fn smallest_glb(sample: &Sample, rms: f64) -> anyhow::Result<Measure> {
    let with = |degrees: f64| {
        let mut options = ExportOptions::default();
        options.quantize = true;
        options.rotation_tolerance = degrees.to_radians();
        options.translation_tolerance = degrees.to_radians() * METRES_PER_RADIAN;
        Ok::<_, anyhow::Error>(glb(sample, &options)?.1)
    };
    let (mut low, mut high) = (0.0, 8.0 * rms);
    let mut best = with(low)?;
    for _ in 0..8 {
        let middle = 0.5 * (low + high);
        let found = with(middle)?;
        if found.rms_deg() <= rms {
            (low, best) = (middle, found);
        } else {
            high = middle;
        }
    }
    Ok(best)
}
