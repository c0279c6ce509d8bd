//! What is done with each input, as data: part of the result, and sent to workers elsewhere.

use handcast_codec::mapping::Profile;
use handcast_fba::RangeRule;
use handcast_fba::bap::StepTable;
use handcast_fba::plan::{PlanOptions, Target};
use handcast_formats::import::ImportOptions;
use handcast_hand::smooth::SmoothOptions;
use handcast_hand::{MAX_GAP, Person, Side};
use handcast_media::Part;
use handcast_track::View;
use handcast_track::pipeline::{ClipOptions, FinderSource, Start};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// What is done with each input.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// How clips are tracked.
    pub track: TrackSettings,
    /// How poses are encoded.
    pub encode: EncodeSettings,
}

/// How clips are tracked; see [`ClipOptions`]. What of it is known to the import of joint positions holds for these as well.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackSettings {
    /// This hand alone.
    pub hand: Option<Side>,
    /// The face that the camera sees.
    pub view: Option<View>,
    /// The clips are mirrored.
    pub mirror: bool,
    /// Start from any posture ([`Start::Any`]).
    pub start_any: bool,
    /// The sizes of all persons.
    pub person: Option<Person>,
    /// Cut-off at rest (Hz) and its growth (Hz per degree per second) of the 1€ filter.
    pub smooth: Option<[f64; 2]>,
    /// Wrist to middle fingertip, metres; where it is not told, that of a mean hand in clips, that of the file in motions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hand_length: Option<f64>,
    /// Degrees the camera sees across the longer side.
    pub field_of_view: f64,
    /// Seconds of each clip, from its first picture on, from which it is tracked; of each motion, as it tells its times.
    #[serde(skip_serializing_if = "is_beginning")]
    pub from: f64,
    /// Seconds at which a clip or a motion has ended; its own end where there are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub until: Option<f64>,
    /// What finds hands, as a name that tells it from others (the SHA-256 of its files); the finder itself is given to
    /// [`Worker::with_finder`](crate::Worker::with_finder).
    pub finder: Option<String>,
}

/// Whether a part begins with its clip; then it is not named, and settings are told as they were before there were parts.
// serde asks with a reference.
#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_beginning(from: &f64) -> bool {
    *from <= 0.0
}

impl Default for TrackSettings {
    fn default() -> Self {
        let options = ClipOptions::default();
        Self {
            hand: None,
            view: None,
            mirror: false,
            start_any: false,
            person: None,
            smooth: None,
            hand_length: None,
            field_of_view: options.field_of_view,
            from: 0.0,
            until: None,
            finder: None,
        }
    }
}

impl TrackSettings {
    /// The part that is done of each clip and motion.
    pub fn part(&self) -> Part {
        Part { from: self.from, until: self.until.unwrap_or(f64::INFINITY), ..Part::WHOLE }
    }

    /// The options of the pipeline; a clip keeps to one thread of trackers, as clips go side by side.
    pub fn options(&self, finder: Option<FinderSource>) -> ClipOptions {
        let mut options = ClipOptions::default();
        options.person.clone_from(&self.person);
        options.side = self.hand;
        options.view = self.view;
        options.mirror = self.mirror;
        options.start = if self.start_any { Start::Any } else { Start::Open };
        options.smooth = self.smoothing();
        options.threads = 1;
        options.hand_length = self.hand_length.unwrap_or(options.hand_length);
        options.field_of_view = self.field_of_view;
        options.finder = finder;
        options
    }

    /// How poses of joint positions are solved for.
    pub fn import(&self) -> ImportOptions {
        ImportOptions {
            side: self.hand,
            morphology: self.person.as_ref().map(|person| person.morphology.clone()),
            hand_length: self.hand_length,
            field_of_view: self.field_of_view.to_radians(),
            smooth: self.smoothing(),
            ..ImportOptions::default()
        }
    }

    fn smoothing(&self) -> Option<SmoothOptions> {
        self.smooth.map(|[cutoff, beta]| SmoothOptions::default().with(cutoff, beta))
    }

    /// The options of the command that say how poses are solved for, and are told.
    pub(crate) fn of_solving(&self) -> Vec<&'static str> {
        let told = [
            ("--person", self.person.is_some()),
            ("--hand-length-mm", self.hand_length.is_some()),
            ("--smooth", self.smooth.is_some()),
        ];
        told.into_iter().filter_map(|(option, told)| told.then_some(option)).collect()
    }
}

/// What the encoder aims at; see [`Target`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Aim {
    /// Root mean square error, degrees.
    Rms(f64),
    /// Largest error, degrees.
    MaxError(f64),
    /// Largest error of a fingertip, millimetres.
    TipError(f64),
    /// Kilobits per second.
    Bitrate(f64),
    /// Quantiser index.
    Quant(u8),
}

impl From<Target> for Aim {
    fn from(target: Target) -> Self {
        match target {
            Target::Rms(degrees) => Self::Rms(degrees),
            Target::MaxError(degrees) => Self::MaxError(degrees),
            Target::TipError(mm) => Self::TipError(mm),
            Target::Bitrate(kbps) => Self::Bitrate(kbps),
            Target::Quant(index) => Self::Quant(index),
        }
    }
}

impl From<Aim> for Target {
    fn from(aim: Aim) -> Self {
        match aim {
            Aim::Rms(degrees) => Self::Rms(degrees),
            Aim::MaxError(degrees) => Self::MaxError(degrees),
            Aim::TipError(mm) => Self::TipError(mm),
            Aim::Bitrate(kbps) => Self::Bitrate(kbps),
            Aim::Quant(index) => Self::Quant(index),
        }
    }
}

/// How poses are encoded; see [`PlanOptions`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EncodeSettings {
    /// What is aimed at.
    pub aim: Aim,
    /// Seconds between I planes.
    pub intra_seconds: f64,
    /// Without look-ahead.
    pub live: bool,
    /// Each I plane can be started at.
    pub resync: bool,
    /// Leave out the person's sizes.
    pub no_sizes: bool,
    /// The sizes again with each I plane.
    pub repeat_sizes: bool,
    /// Leave out what the decoder derives.
    pub derive: bool,
    /// Profile and level of a visual object sequence.
    pub wrapper: Option<u8>,
    /// The wrist in BAPs 42 to 47 ([`Profile::Arm`]).
    pub arm: bool,
    /// Base steps of Visage products.
    pub visage_steps: bool,
    /// Range codes are taken as they are.
    pub undivided_ranges: bool,
    /// Seconds up to which gaps are bridged; of 0 none.
    pub max_gap: f64,
}

impl Default for EncodeSettings {
    fn default() -> Self {
        Self::of(&PlanOptions::default(), Profile::Hand, false, MAX_GAP)
    }
}

impl EncodeSettings {
    /// The settings that are these options.
    pub fn of(plan: &PlanOptions, profile: Profile, no_sizes: bool, max_gap: f64) -> Self {
        Self {
            aim: plan.mode.into(),
            intra_seconds: plan.intra_seconds,
            live: plan.live,
            resync: plan.resync,
            no_sizes,
            repeat_sizes: plan.repeat_record,
            derive: plan.derive,
            wrapper: plan.wrapper,
            arm: profile == Profile::Arm,
            visage_steps: plan.steps == StepTable::Visage,
            undivided_ranges: plan.ranges == RangeRule::Undivided,
            max_gap,
        }
    }

    /// The planner's options.
    pub fn plan(&self) -> PlanOptions {
        PlanOptions {
            steps: if self.visage_steps { StepTable::Visage } else { StepTable::Standard },
            ranges: if self.undivided_ranges { RangeRule::Undivided } else { RangeRule::Divided },
            mode: self.aim.into(),
            live: self.live,
            intra_seconds: self.intra_seconds,
            resync: self.resync,
            derive: self.derive,
            wrapper: self.wrapper,
            repeat_record: self.repeat_sizes,
            ..PlanOptions::default()
        }
    }

    /// Where the wrist travels.
    pub fn profile(&self) -> Profile {
        if self.arm { Profile::Arm } else { Profile::Hand }
    }
}

impl Settings {
    /// Sixteen hexadecimal digits that tell these settings from others.
    pub fn digest(&self) -> String {
        let text = serde_json::to_string(self).unwrap_or_default();
        let mut digits = hex(&Sha256::digest(text));
        digits.truncate(16);
        digits
    }
}

/// Bytes in hexadecimal.
pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::with_capacity(2 * bytes.len()), |mut text, byte| {
        use std::fmt::Write as _;
        // A string takes everything.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_the_same_as_text_and_told_apart() {
        let mut other = Settings::default();
        other.encode.aim = Aim::Bitrate(1.5);
        other.track.hand = Some(Side::Left);
        (other.track.from, other.track.until) = (1.5, Some(4.0));
        for settings in [Settings::default(), other.clone()] {
            let text = serde_json::to_string(&settings).unwrap();
            assert_eq!(serde_json::from_str::<Settings>(&text).unwrap(), settings);
        }
        assert_ne!(other.digest(), Settings::default().digest());
        let mut longer = other.clone();
        longer.track.until = None;
        assert_ne!(longer.digest(), other.digest());
        // Those of all of a clip are told as before there were parts.
        let whole = serde_json::to_string(&Settings::default()).unwrap();
        assert!(!whole.contains("from") && !whole.contains("until"), "{whole}");
        assert!(Settings::default().track.part().is_whole());
        assert_eq!(other.digest().len(), 16);
        assert!(serde_json::from_str::<Settings>(r#"{"trak":{}}"#).is_err());
    }

    #[test]
    fn the_defaults_are_those_of_tracker_import_and_planner() {
        let settings = Settings::default();
        assert_eq!(settings.encode.plan(), PlanOptions::default());
        let (options, expected) = (settings.track.options(None), ClipOptions::default());
        assert_eq!(options.hand_length, expected.hand_length);
        assert_eq!(options.field_of_view, expected.field_of_view);
        assert_eq!((options.side, options.view, options.start), (None, None, Start::Open));
        assert_eq!(settings.track.import(), ImportOptions::default());
    }
}
