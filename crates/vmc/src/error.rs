//! Why packets cannot be sent.

use std::io;
use std::net::SocketAddr;

use thiserror::Error;

/// Why packets cannot be sent.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum VmcError {
    /// The receiver's name is none.
    #[error("{target:?} is no receiver: {what}, expected HOST or HOST:PORT")]
    Target {
        /// What was given.
        target: String,
        /// What is wrong with it.
        what: &'static str,
    },
    /// The receiver's name has no address.
    #[error("cannot resolve {host:?}: {source}")]
    Resolve {
        /// The name.
        host: String,
        /// What the system says.
        source: io::Error,
    },
    /// No socket to that address.
    #[error("cannot open a UDP socket to {address}: {source}")]
    Open {
        /// The receiver.
        address: SocketAddr,
        /// What the system says.
        source: io::Error,
    },
    /// The system did not take a packet.
    #[error("cannot send to {address}: {source}")]
    Send {
        /// The receiver.
        address: SocketAddr,
        /// What the system says.
        source: io::Error,
    },
    /// A packet cannot be written as OSC.
    #[error("cannot write an OSC packet: {what}")]
    Osc {
        /// What the writer says.
        what: String,
    },
}
