//! How relays are reached.

use std::path::PathBuf;
use std::time::Duration;

use handcast_live::transport::TransportError;
use moq_tokio::{Addrs, Client};
use url::Url;

use crate::transport_error;

/// Longest wait for a relay that is the only one.
const ALONE: Duration = Duration::from_secs(5);

/// How relays are reached, and when what comes from them is too old to show.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct MoqOptions {
    /// PEM files with certificates to trust in place of the system's.
    pub roots: Vec<PathBuf>,
    /// SHA-256 fingerprints of certificates to trust, in hex, in place of all others: for relays with a certificate of their own.
    pub fingerprints: Vec<String>,
    /// A relay that says nothing for so long is gone, and is dialled again.
    pub idle: Duration,
    /// A relay that is not connected within so long is passed over for the next one of the list.
    pub dial: Duration,
    /// Planes captured longer ago are of a cached period: they are not shown.
    pub stale: Duration,
    /// A sender of whom nothing comes for so long is gone.
    pub silence: Duration,
}

impl Default for MoqOptions {
    fn default() -> Self {
        Self {
            roots: Vec::new(),
            fingerprints: Vec::new(),
            idle: Duration::from_millis(1200),
            dial: Duration::from_secs(1),
            stale: Duration::from_secs(2),
            silence: Duration::from_secs(4),
        }
    }
}

impl MoqOptions {
    /// Sets [`Self::roots`].
    #[must_use]
    pub fn with_roots(self, roots: Vec<PathBuf>) -> Self {
        Self { roots, ..self }
    }

    /// Sets [`Self::fingerprints`].
    #[must_use]
    pub fn with_fingerprints(self, fingerprints: Vec<String>) -> Self {
        Self { fingerprints, ..self }
    }

    /// Sets [`Self::idle`].
    #[must_use]
    pub fn with_idle(self, idle: Duration) -> Self {
        Self { idle, ..self }
    }

    /// Sets [`Self::dial`].
    #[must_use]
    pub fn with_dial(self, dial: Duration) -> Self {
        Self { dial, ..self }
    }

    /// Sets [`Self::stale`].
    #[must_use]
    pub fn with_stale(self, stale: Duration) -> Self {
        Self { stale, ..self }
    }

    /// Sets [`Self::silence`].
    #[must_use]
    pub fn with_silence(self, silence: Duration) -> Self {
        Self { silence, ..self }
    }

    /// A client that dials again whenever its session drops, the first of so many relays that answers.
    pub(crate) fn client(&self, relays: usize) -> Result<Client, TransportError> {
        let mut connect = moq_tokio::connect::Config::default();
        connect.tls.root.clone_from(&self.roots);
        connect.tls.fingerprint.clone_from(&self.fingerprints);
        connect.timeout = if relays > 1 { self.dial } else { ALONE };
        connect.backoff.initial = Duration::from_millis(200);
        connect.backoff.max = Duration::from_secs(1);
        // Relays come back.
        connect.backoff.timeout = Duration::ZERO;
        let mut quic = moq_tokio::quic::Config::default();
        quic.idle_timeout = self.idle;
        quic.keep_alive = self.idle / 4;
        connect.init(quic).map_err(|error| transport_error(&error))
    }
}

/// The relays in the order in which they are tried.
pub(crate) fn addresses(relays: &[Url]) -> Result<Addrs, TransportError> {
    let none = || TransportError::Refused { why: "no relay is named".into() };
    Addrs::collect(relays.iter().cloned()).ok_or_else(none)
}

/// The runtime of an end: one thread beside its caller's.
pub(crate) fn runtime() -> Result<tokio::runtime::Runtime, TransportError> {
    Ok(tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?)
}
