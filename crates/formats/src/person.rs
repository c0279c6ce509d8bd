//! Person files: one [`Person`] as TOML or JSON, told apart by the ending of the file's name.
//!
//! ```toml
//! name = "A"
//! hand = "right"
//! [morphology]
//! hand_length = 0.189
//! palm_radius = 0.0136
//! wrist_half_width = 0.0276
//! webs = [0.85, 0.36, 0.36, 0.36]
//! [morphology.fingers.thumb]
//! metacarpal = [0.018, 0.019, 0.008]
//! base = [0.018, 0.019, 0.008]
//! bones = [0.047, 0.037, 0.030]
//! radii = [0.014, 0.011, 0.010, 0.008]
//! # … index, middle, ring, pinky
//! ```
//!
//! Lengths are metres in the hand frame of [`handcast_hand`].

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::atomic::AtomicFile;
use handcast_hand::{MorphologyError, Person};

/// Most bytes in a person file.
pub const MAX_BYTES: u64 = 1 << 20;

/// Why a person file could not be read or written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PersonError {
    /// The file could not be read or written.
    #[error("person: {path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file is larger than [`MAX_BYTES`].
    #[error("person: {path}: larger than the {MAX_BYTES} bytes allowed")]
    TooLarge {
        /// The file.
        path: PathBuf,
    },
    /// The name ends neither in `.toml` nor in `.json`.
    #[error("person: {path}: the name must end in .toml or .json")]
    Ending {
        /// The file.
        path: PathBuf,
    },
    /// The text is no person.
    #[error("person: {path}: {what}")]
    Syntax {
        /// The file.
        path: PathBuf,
        /// What is wrong and where.
        what: String,
    },
    /// A size cannot be that of a hand.
    #[error("person: {path}: {source}")]
    Size {
        /// The file.
        path: PathBuf,
        /// Which size.
        source: MorphologyError,
    },
}

enum Syntax {
    Toml,
    Json,
}

fn syntax(path: &Path) -> Result<Syntax, PersonError> {
    match path.extension().and_then(|e| e.to_str()) {
        Some("toml") => Ok(Syntax::Toml),
        Some("json") => Ok(Syntax::Json),
        _ => Err(PersonError::Ending { path: path.into() }),
    }
}

/// Makes sure that the name of a person file tells its syntax, before there is something to write.
///
/// # Errors
/// [`PersonError::Ending`].
pub fn check_name(path: &Path) -> Result<(), PersonError> {
    syntax(path).map(drop)
}

/// Reads and validates a person file.
///
/// # Errors
/// See [`PersonError`].
pub fn read_person(path: &Path) -> Result<Person, PersonError> {
    let syntax = syntax(path)?;
    let io_error = |source| PersonError::Io { path: path.into(), source };
    let mut text = String::new();
    let file = File::open(path).map_err(io_error)?;
    file.take(MAX_BYTES + 1).read_to_string(&mut text).map_err(io_error)?;
    if text.len() as u64 > MAX_BYTES {
        return Err(PersonError::TooLarge { path: path.into() });
    }
    let person: Result<Person, String> = match syntax {
        Syntax::Toml => toml::from_str(&text).map_err(|e| e.to_string().trim_end().to_owned()),
        Syntax::Json => serde_json::from_str(&text).map_err(|e| e.to_string()),
    };
    let person = person.map_err(|what| PersonError::Syntax { path: path.into(), what })?;
    person.morphology.validate().map_err(|source| PersonError::Size { path: path.into(), source })?;
    Ok(person)
}

/// Writes a person file.
///
/// # Errors
/// See [`PersonError`]; a morphology that a reader would refuse is not written.
pub fn write_person(path: &Path, person: &Person) -> Result<(), PersonError> {
    let syntax = syntax(path)?;
    person.morphology.validate().map_err(|source| PersonError::Size { path: path.into(), source })?;
    let text: Result<String, String> = match syntax {
        Syntax::Toml => toml::to_string(person).map_err(|e| e.to_string()),
        Syntax::Json => serde_json::to_string_pretty(person).map(|t| t + "\n").map_err(|e| e.to_string()),
    };
    let text = text.map_err(|what| PersonError::Syntax { path: path.into(), what })?;
    AtomicFile::write_all_to(path, text.as_bytes())
        .map_err(|source| PersonError::Io { path: path.into(), source })
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::Side;

    #[test]
    fn persons_round_trip_in_both_syntaxes() {
        let dir = tempfile::tempdir().unwrap();
        let mut person = Person { name: Some("A".into()), hand: Some(Side::Left), ..Person::default() };
        person.morphology.fingers[2].bones[1] *= 1.05;
        for name in ["a.toml", "a.json"] {
            let path = dir.path().join(name);
            write_person(&path, &person).unwrap();
            assert_eq!(read_person(&path).unwrap(), person);
        }
        assert!(matches!(read_person(&dir.path().join("a.txt")), Err(PersonError::Ending { .. })));
        assert!(matches!(read_person(&dir.path().join("b.toml")), Err(PersonError::Io { .. })));
    }

    #[test]
    fn errors_name_the_file_and_the_place() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("p.toml");
        write_person(&path, &Person::default()).unwrap();
        let good = std::fs::read_to_string(&path).unwrap();
        let message = |text: &str| {
            std::fs::write(&path, text).unwrap();
            read_person(&path).unwrap_err().to_string()
        };
        let text = message(&good.replace("hand_length", "hand_lenght"));
        assert!(text.contains("hand_lenght") && text.contains("p.toml"), "{text}");
        let text = message(&good.replace("hand_length = 0.189", "hand_length = 1.89"));
        assert!(text.contains("hand_length is 1.89 m, allowed 0.05 to 0.4 m"), "{text}");
    }
}
