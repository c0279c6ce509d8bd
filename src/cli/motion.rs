//! The moving hands of any file with poses, for the subcommands that show them.

use std::path::PathBuf;

use anyhow::Context;
use handcast_codec::mapping::Profile;
use handcast_codec::notices;
use handcast_codec::{PoseDecoderOptions, clip_rate, decode_poses_within};
use handcast_fba::inspect::Inspector;
use handcast_formats::motion::Format;
use handcast_formats::mp4;
use handcast_formats::person::read_person;
use handcast_hand::{Morphology, PoseClip};
use handcast_view::{PlaneCost, StreamCost};

use super::common::{StreamArgs, check_span, limits, read_filled};
use super::given;

/// Intervals longer than this many usual ones are filled in a GLB, whose keys are meant to be joined.
const GAP: f64 = 1.5;

/// What is shown, and how it is read.
#[derive(Debug, clap::Args)]
pub struct MotionArgs {
    /// Stream (.fba, .mp4), BAP text (.bap), animated hand (.glb, .gltf, .vrma; of a rig, the motion), BVH, poses (.jsonl, .json, .csv), or joints of other programs (all that import reads); - for standard input
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
        let person = self.person.as_deref().map(read_person).transpose()?;
        let bytes = read_filled(&self.input)?;
        let format = Format::of(&self.input, &bytes);
        let mut motion = if format.is_some_and(|format| format.id == "fba") {
            // What its planes cost is shown too, and damage may be passed over.
            self.read_stream(&mp4::unwrapped(&bytes).with_context(|| self.input.display().to_string())?)?
        } else {
            let name = self.input.display();
            given::note_idle(format_args!("{name} is no stream"), &["profile", "steps", "ranges", "conceal"]);
            let found = handcast_formats::motion::Motion::parse_within(&self.input, &bytes, limits())?;
            let name = || self.input.display().to_string();
            let clip = if found.keyed { joined(found.clip).with_context(name)? } else { found.clip };
            Motion { notes: found.notes, ..Motion::of(clip) }
        };
        if let Some(person) = person {
            for hand in &mut motion.clip.header.hands {
                hand.morphology = Some(person.morphology.clone());
            }
            motion.morphology = person.morphology;
        }
        Ok(motion)
    }

    fn read_stream(&self, bytes: &[u8]) -> anyhow::Result<Motion> {
        let options = self.stream.options();
        let told = PoseDecoderOptions::default().with_decoder(options).with_limits(limits());
        let decoded = decode_poses_within(bytes, told.with_profile(self.stream.profile.map(Profile::from)))
            .with_context(|| self.input.display().to_string())?;
        // Planes that are damaged have no account.
        let planes = Inspector::new(bytes, options)
            .flatten()
            .map(|plane| PlaneCost {
                time: plane.frame.time,
                bits: plane.bits.total(),
                intra: plane.frame.kind.letter() == 'I',
            })
            .collect();
        let mut motion = Motion::of(decoded.clip);
        motion.stream = Some(StreamCost { bytes: bytes.len(), planes });
        motion.notes = decoded.damage.first().iter().map(ToString::to_string).collect();
        if decoded.damage.further() > 0 {
            motion.notes.push(format!("{} further places are damaged", decoded.damage.further()));
        }
        motion.notes.extend(notices::of_stream(decoded.passed_over, decoded.streams, decoded.trailing));
        if self.person.is_none() {
            motion.notes.extend(notices::of_sizes(&decoded.resized, "the last ones"));
        }
        Ok(motion)
    }
}

impl Motion {
    fn of(clip: PoseClip) -> Self {
        Self { clip, morphology: Morphology::default(), stream: None, notes: Vec::new() }
    }
}

/// Poses at keys, joined at an even rate where keys have been left out.
fn joined(mut clip: PoseClip) -> anyhow::Result<PoseClip> {
    let told = clip.header.rate;
    let rate = clip_rate(&clip);
    let gaps = clip.header.hands.iter().any(|hand| {
        let times: Vec<f64> = clip.of(hand.side).map(|f| f.time).collect();
        times.windows(2).any(|w| (w[1] - w[0]) * rate > GAP)
    });
    clip.header.rate = Some(rate);
    if !gaps {
        return Ok(clip);
    }
    let rate = told.unwrap_or_else(|| rate.round()).clamp(1.0, 240.0);
    check_span(&clip, rate)?;
    Ok(clip.even(rate))
}
