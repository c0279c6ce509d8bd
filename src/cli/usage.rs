//! Command lines that cannot be followed, whatever is in the files they name.

use std::ops::RangeInclusive;

use thiserror::Error;

/// What is wrong with a command line.
#[derive(Debug, Error)]
#[error("{0}")]
pub struct Usage(pub String);

/// Ends the work with a [`Usage`] error.
macro_rules! refuse {
    ($($words:tt)*) => {
        return Err($crate::cli::usage::Usage(format!($($words)*)).into())
    };
}

/// Whether an error is one of the command line.
pub fn is_usage(error: &anyhow::Error) -> bool {
    use handcast_eval::synth::SynthError;
    use handcast_formats::person::PersonError;
    use handcast_vmc::VmcError;
    error.chain().any(|cause| {
        cause.is::<Usage>()
            || matches!(cause.downcast_ref(), Some(SynthError::Range { .. }))
            || matches!(cause.downcast_ref(), Some(PersonError::Ending { .. }))
            || matches!(cause.downcast_ref(), Some(VmcError::Target { .. }))
    })
}

/// A number in a range, of a unit that may be empty.
pub fn within(text: &str, range: RangeInclusive<f64>, unit: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if range.contains(&value) => Ok(value),
        _ => {
            let blank = if unit.is_empty() { "" } else { " " };
            Err(format!("allowed {} to {}{blank}{unit}", range.start(), range.end()))
        }
    }
}

/// A number above 0.
pub fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err("allowed are numbers above 0".into()),
    }
}
