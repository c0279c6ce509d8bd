//! What can be wrong with a network or where it comes from.

use std::path::PathBuf;

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file cannot be read.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file holds no networks, or is damaged.
    #[error("{}: {what}", path.display())]
    Archive {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// A network of a file or archive cannot be read.
    #[error("{}: {source}", path.display())]
    Network {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: Box<Error>,
    },
    /// What an environment variable says is wrong.
    #[error("{name}: {source}")]
    Variable {
        /// The variable.
        name: &'static str,
        /// Why.
        source: Box<Error>,
    },
    /// The bytes are no TensorFlow Lite network.
    #[error("network: {what} at byte {at}")]
    Format {
        /// Where in the file.
        at: usize,
        /// What is wrong.
        what: String,
    },
    /// The network's parts do not fit together.
    #[error("network: {operator}: {what}")]
    Graph {
        /// Which operator, by number and name.
        operator: String,
        /// What is wrong.
        what: String,
    },
    /// Legal, but not among the operators and options this crate runs.
    #[error("network: {operator}: {what} is not supported")]
    Unsupported {
        /// Which operator, by number and name.
        operator: String,
        /// What is not supported.
        what: String,
    },
    /// More than the limits allow.
    #[error("network: {what}: {found}, at most {allowed} are allowed")]
    Limit {
        /// What there is too much of.
        what: &'static str,
        /// How much there is.
        found: u64,
        /// How much may be.
        allowed: u64,
    },
    /// A network runs, but has not the inputs and outputs of the task it is for.
    #[error("{role} network: {what}")]
    Role {
        /// What the network is for.
        role: &'static str,
        /// What is wrong.
        what: String,
    },
    /// Nothing says where networks are, and no installed package has them.
    #[error("no hand networks: neither Python's `mediapipe` nor Node's `@mediapipe/hands` is installed")]
    NotInstalled,
    /// No networks are where they were looked for.
    #[error("no hand networks in {place}: {what}")]
    NotFound {
        /// Where.
        place: String,
        /// What is missing.
        what: String,
    },
}

/// Results of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;
