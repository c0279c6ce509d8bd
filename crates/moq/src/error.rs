//! Faults of the network in the words of the trait.

use handcast_live::transport::TransportError;

/// An error of Media over QUIC with its causes: refused where the relay says so, closed otherwise.
pub fn transport_error(error: &(dyn std::error::Error + 'static)) -> TransportError {
    let mut why = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let text = error.to_string();
        if !why.contains(&text) {
            why = format!("{why}: {text}");
        }
        cause = error.source();
    }
    match why.contains("unauthorized") || why.contains("forbidden") {
        true => TransportError::Refused { why },
        false => TransportError::Closed { why },
    }
}
