//! The front door: a clip, a stream and a hand, each in one call.

use std::path::Path;

use handcast_codec::mapping::Profile;
use handcast_codec::{DecodedStream, decode_poses, encode_poses};
use handcast_fba::DecoderOptions;
use handcast_fba::plan::{PlanOptions, Target};
use handcast_gltf::{ExportOptions, Skins};
use handcast_hand::{Morphology, Person, PoseClip};
use handcast_media::{OpenOptions, open};
use handcast_track::pipeline::{ClipOptions, track_clip};

use crate::Error;

/// Tracks the hands in a clip: a video file, an animation, a folder or pattern of pictures, or, for `-`, Y4M on standard
/// input. [`ClipOptions::default`] says how; [`track_clip`] takes other options, and [`Tracker`](crate::Tracker)
/// single frames.
///
/// # Errors
/// [`Error::Frames`] and [`Error::Track`].
pub fn track(input: impl AsRef<Path>) -> Result<PoseClip, Error> {
    let source = open(input, &OpenOptions::default())?;
    let clip = track_clip(source, None, &ClipOptions::default(), &mut ())?;
    Ok(PoseClip { header: clip.header(), frames: clip.poses() })
}

/// The poses of a clip as an FBA stream, at their own rate, with an I plane every five seconds.
///
/// # Errors
/// [`Error::Encode`]: no valid pose, a rate or a target out of range.
pub fn encode(poses: &PoseClip, target: Target) -> Result<Vec<u8>, Error> {
    let plan = PlanOptions { mode: target, ..PlanOptions::default() };
    Ok(encode_poses(poses, Profile::Hand, &plan)?.stream)
}

/// A whole FBA stream as poses.
///
/// # Errors
/// [`Error::Decode`]: the stream is cut, damaged, moves no hand or uses what is not supported.
pub fn decode(stream: &[u8]) -> Result<Decoded, Error> {
    let stream = decode_poses(stream, None, DecoderOptions::default())?;
    let told = stream.clip.header.hands.iter().find_map(|hand| hand.morphology.clone());
    Ok(Decoded { stream, morphology: told.unwrap_or_default(), skins: Skins::default() })
}

/// A decoded stream.
#[derive(Clone, Debug)]
pub struct Decoded {
    stream: DecodedStream,
    morphology: Morphology,
    skins: Skins,
}

impl Decoded {
    /// Gives the hands a person's sizes, in place of those that the stream carries; without either they have the mean ones.
    #[must_use]
    pub fn with_person(mut self, person: &Person) -> Self {
        self.morphology = person.morphology.clone();
        for hand in &mut self.stream.clip.header.hands {
            hand.morphology = Some(person.morphology.clone());
        }
        self
    }

    /// The poses, one for each hand and tick of the stream.
    pub fn clip(&self) -> &PoseClip {
        &self.stream.clip
    }

    /// Frames per second.
    pub fn rate(&self) -> f64 {
        self.stream.rate
    }

    /// An animated, skinned hand for each hand of the stream, as GLB. What does not depend on the motion is made once.
    ///
    /// # Errors
    /// [`Error::Gltf`]: sizes out of range, no valid pose.
    pub fn to_glb(&self) -> Result<Vec<u8>, Error> {
        let clip = handcast_gltf::Clip::of(&self.stream.clip, &self.morphology);
        let mut options = ExportOptions::default();
        options.skins = self.skins.clone();
        Ok(handcast_gltf::export(&clip, &options)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::{Finger, HandPose, Joint, Side, Skeleton, TimedPose};

    #[test]
    fn a_person_s_sizes_come_in_place_of_the_stream_s() -> Result<(), Error> {
        let bent =
            |t: f64| HandPose::neutral(Side::Left).with_degrees(Finger::Index.base_flexion(), 60.0 * t);
        let frames = (0..30).map(|i| TimedPose::new(f64::from(i) / 30.0, bent(f64::from(i) / 30.0)));
        let mut clip = PoseClip::of_frames(frames, Some(30.0));
        clip.header.hands[0].morphology = Some(Morphology::average(0.16));
        let decoded = decode(&encode(&clip, Target::Rms(0.5))?)?;
        let person = Person { morphology: Morphology::average(0.22), ..Person::default() };
        let length = |decoded: &Decoded| {
            let sizes = decoded.clip().header.hands[0].morphology.clone().unwrap_or_default();
            let frames = Skeleton::new(&sizes, Side::Left).frames(&HandPose::neutral(Side::Left));
            (frames.position(Joint::tip(Finger::Middle)) - frames.position(Joint::Wrist)).norm()
        };
        let (before, plain) = (length(&decoded), decoded.to_glb()?);
        let decoded = decoded.with_person(&person);
        assert!(length(&decoded) > 1.3 * before);
        assert_ne!(decoded.to_glb()?, plain);
        Ok(())
    }
}
