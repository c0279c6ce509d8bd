//! The moving hands of any file with poses, for the subcommands that show them.

use std::path::{Path, PathBuf};

use anyhow::Context;
use handcast::bap::mapping::Profile;
use handcast::codec::{clip_rate, decode_poses};
use handcast::fba::inspect::Inspector;
use handcast::gltf::import_poses;
use handcast::hand::Morphology;
use handcast::io::import::{ImportOptions, import};
use handcast::io::landmarks::LandmarkClip;
use handcast::io::person::read_person;
use handcast::io::poses::{HandTrackInfo, PoseClip, TimedPose};
use handcast::view::{PlaneCost, StreamCost};

use super::common::{StreamArgs, ending, read_input};

/// Most bytes of a GLB file or stream that are read.
const MAX_BYTES: u64 = 256 << 20;
/// Intervals longer than this many usual ones are filled in a GLB, whose keys are meant to be joined.
const GAP: f64 = 1.5;

/// What is shown, and how it is read.
#[derive(Debug, clap::Args)]
pub struct MotionArgs {
    /// Stream (.fba), animated hand made by this program (.glb), poses (.jsonl), or joint positions of
    /// other trackers (21 landmarks, WebXR joints)
    pub input: PathBuf,
    /// Sizes of the person's hand, instead of the file's
    #[arg(long, value_name = "FILE")]
    person: Option<PathBuf>,
    #[command(flatten)]
    stream: StreamArgs,
}

/// Hands and how they move.
pub struct Motion {
    pub clip: PoseClip,
    /// Sizes of hands whose header says none.
    pub morphology: Morphology,
    /// What a stream's planes cost.
    pub stream: Option<StreamCost>,
    /// Damage that was passed over.
    pub notes: Vec<String>,
}

impl MotionArgs {
    /// Reads the file.
    pub fn read(&self) -> anyhow::Result<Motion> {
        let name = || format!("{}", self.input.display());
        let person = self.person.as_deref().map(read_person).transpose()?;
        let mut motion = match ending(&self.input).as_str() {
            "glb" => {
                let bytes = read_input(&self.input, MAX_BYTES)?;
                Motion::of(from_glb(&bytes).with_context(name)?)
            }
            "fba" => self.read_stream().with_context(name)?,
            _ => Motion::of(from_text(&self.input)?),
        };
        if let Some(person) = person {
            for hand in &mut motion.clip.header.hands {
                hand.morphology = Some(person.morphology.clone());
            }
            motion.morphology = person.morphology;
        }
        Ok(motion)
    }

    fn read_stream(&self) -> anyhow::Result<Motion> {
        let bytes = read_input(&self.input, MAX_BYTES)?;
        let options = self.stream.options();
        let decoded = decode_poses(&bytes, self.stream.profile.map(Profile::from), options)?;
        // Planes that are damaged have no account.
        let planes = Inspector::new(&bytes, options)
            .flatten()
            .map(|plane| PlaneCost {
                time: plane.frame.time,
                bits: plane.bits.total(),
                intra: plane.frame.kind.letter() == 'I',
            })
            .collect();
        let mut motion = Motion::of(decoded.clip);
        motion.stream = Some(StreamCost { bytes: bytes.len(), planes });
        motion.notes = decoded.damage.iter().map(ToString::to_string).collect();
        Ok(motion)
    }
}

impl Motion {
    fn of(clip: PoseClip) -> Self {
        Self { clip, morphology: Morphology::default(), stream: None, notes: Vec::new() }
    }
}

/// The poses of a GLB this program wrote, joined at an even rate where keys have been left out.
fn from_glb(bytes: &[u8]) -> anyhow::Result<PoseClip> {
    let mut clip = PoseClip::default();
    for hand in import_poses(bytes)? {
        clip.header.hands.push(HandTrackInfo { side: hand.side, morphology: hand.morphology });
        clip.frames.extend(hand.poses.into_iter().map(|(time, pose)| TimedPose::new(time, pose)));
    }
    let rate = clip_rate(&clip);
    let gaps = clip.header.hands.iter().any(|hand| {
        let times: Vec<f64> = clip.of(hand.side).map(|f| f.time).collect();
        times.windows(2).any(|w| (w[1] - w[0]) * rate > GAP)
    });
    clip.header.rate = Some(rate);
    Ok(if gaps { clip.even(rate.round().clamp(1.0, 240.0)) } else { clip })
}

/// Poses, or joint positions that poses are found for.
fn from_text(path: &Path) -> anyhow::Result<PoseClip> {
    let poses = PoseClip::read(path);
    let Err(error) = poses else { return Ok(poses?) };
    match LandmarkClip::read(path) {
        Ok(landmarks) => {
            let (clip, _) = import(&landmarks, &ImportOptions::default())
                .with_context(|| format!("{}", path.display()))?;
            Ok(clip)
        }
        // Neither: as poses are what is asked for, what keeps them from being read is what to say.
        Err(_) => Err(error).with_context(|| format!("{}", path.display())),
    }
}
