//! Files with networks: where they are, which of them find hands, what they are.
//!
//! The networks of MediaPipe Hands come in wheels of the Python package `mediapipe`, in `.task` bundles, in the npm
//! package `@mediapipe/hands`, and as `.tflite` files. None is part of this crate.

mod archive;
mod places;

use std::path::{Path, PathBuf};

use archive::Found;
use sha2::{Digest, Sha256};

use crate::error::{Error, Result};
use crate::graph::Network;

/// The environment variable that says where the networks are.
pub const VARIABLE: &str = "HANDCAST_NET";

/// No network or bundle of hands is larger.
const MAX_BYTES: u64 = 32 << 20;

/// What a network is for, known from its inputs and outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Finds palms in a whole picture: 192² pixels to 2016 boxes and scores.
    Palms,
    /// Finds the joints of one hand in a picture of it: 224² pixels to 21 points.
    Landmarks,
}

impl Role {
    /// The role of a network with these inputs and outputs.
    pub fn of(network: &Network) -> Option<Self> {
        let sizes = |shape: &[usize]| shape.iter().product::<usize>();
        let outputs: Vec<usize> = network.outputs().map(|port| sizes(&port.shape)).collect();
        let count = |size| outputs.iter().filter(|&&s| s == size).count();
        match network.inputs().map(|port| &port.shape[..]).collect::<Vec<_>>()[..] {
            [[1, 192, 192, 3]] if count(2016 * 18) == 1 && count(2016) == 1 => Some(Self::Palms),
            [[1, 224, 224, 3]] if count(63) >= 1 && count(1) == 2 => Some(Self::Landmarks),
            _ => None,
        }
    }
}

/// One network's file.
#[derive(Clone, Debug)]
pub struct NetFile {
    /// What it is for.
    pub role: Role,
    /// The file on disk.
    pub path: PathBuf,
    /// Its name inside of that, where it is an archive.
    pub entry: Option<String>,
    /// How many bytes the network has.
    pub size: usize,
    /// SHA-256 of the network.
    pub sha256: [u8; 32],
    /// Multiplications of one run: the larger of two networks for the same is the more exact one.
    pub multiplications: u64,
    network: Network,
}

impl NetFile {
    /// The network, if it is one that finds hands.
    fn read(path: &Path, entry: Option<String>, bytes: &[u8]) -> Result<Option<Self>> {
        let network = Network::read(bytes)?;
        Ok(Role::of(&network).map(|role| Self {
            role,
            path: path.to_owned(),
            entry,
            size: bytes.len(),
            sha256: Sha256::digest(bytes).into(),
            multiplications: network.multiplications(),
            network,
        }))
    }

    /// The network, ready to run.
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// SHA-256 in hexadecimal digits.
    pub fn digest(&self) -> String {
        self.sha256.iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

/// Which of several networks for the same purpose is taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Size {
    /// The larger, more exact one.
    #[default]
    Full,
    /// The smaller, faster one.
    Lite,
}

/// The two networks that find hands together.
#[derive(Clone, Debug)]
pub struct Bundle {
    /// Finds palms.
    pub palms: NetFile,
    /// Finds joints.
    pub landmarks: NetFile,
    /// The licence that the package they came in states.
    pub licence: Option<String>,
    /// What is wrong with the first network of the place that could not be read, in whose stead another one may have been
    /// taken.
    pub left_out: Option<String>,
}

impl Bundle {
    /// The networks in a wheel, a `.task` bundle, a folder (with all that is in it), or beside a `.tflite` file.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Archive`] and [`Error::Network`] where something cannot be read and one of the two is
    /// missing, [`Error::NotFound`] where one is just missing.
    pub fn open(path: &Path, size: Size) -> Result<Self> {
        let Found { networks, error, .. } = Found::at(path)?;
        let left_out = error.as_ref().map(ToString::to_string);
        let bundle = Self::choose(networks, size, &path.display().to_string())
            .map_err(|missing| error.unwrap_or(missing))?;
        let licence = archive::licence(&bundle.landmarks.path);
        Ok(Self { licence, left_out, ..bundle })
    }

    /// The networks in the bytes of a wheel or `.task` bundle.
    ///
    /// # Errors
    /// As [`Bundle::open`]; a single network is not enough.
    pub fn read(bytes: &[u8], size: Size) -> Result<Self> {
        let Found { networks, error, .. } = Found::of(bytes)?;
        Self::choose(networks, size, "the bytes given").map_err(|missing| error.unwrap_or(missing))
    }

    /// The networks at `given`, else where [`VARIABLE`] says, else where `pip` and `npm` put them; none where nothing
    /// says where they are and no installed package has them.
    ///
    /// # Errors
    /// As [`Bundle::open`] for `given`, within [`Error::Variable`] for what the variable says.
    pub fn look(given: Option<&Path>, size: Size) -> Result<Option<Self>> {
        if let Some(path) = given {
            return Self::open(path, size).map(Some);
        }
        if let Some(path) = std::env::var_os(VARIABLE).filter(|path| !path.is_empty()) {
            return Self::open(Path::new(&path), size)
                .map(Some)
                .map_err(|source| Error::Variable { name: VARIABLE, source: Box::new(source) });
        }
        Ok(places::installed().iter().find_map(|place| Self::open(place, size).ok()))
    }

    /// As [`Bundle::look`], for those who cannot do without.
    ///
    /// # Errors
    /// As [`Bundle::look`]; [`Error::NotInstalled`] where there are none.
    pub fn find(given: Option<&Path>, size: Size) -> Result<Self> {
        Self::look(given, size)?.ok_or(Error::NotInstalled)
    }

    fn choose(found: Vec<NetFile>, size: Size, place: &str) -> Result<Self> {
        let best = |role| {
            let candidates = found.iter().filter(|file| file.role == role);
            match size {
                Size::Full => candidates.max_by_key(|file| file.multiplications),
                Size::Lite => candidates.min_by_key(|file| file.multiplications),
            }
            .cloned()
        };
        let missing = |role: &str| Error::NotFound {
            place: place.to_owned(),
            what: format!("there is none that finds {role}"),
        };
        Ok(Self {
            palms: best(Role::Palms).ok_or_else(|| missing("palms"))?,
            landmarks: best(Role::Landmarks).ok_or_else(|| missing("joints"))?,
            licence: None,
            left_out: None,
        })
    }
}
