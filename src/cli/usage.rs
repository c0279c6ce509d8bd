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

/// A number of bytes; K, M and G stand for 1024, 1024² and 1024³ of them.
pub fn bytes(text: &str) -> Result<u64, String> {
    let (number, unit) = match text.char_indices().last() {
        Some((at, 'k' | 'K')) => (&text[..at], 1 << 10),
        Some((at, 'm' | 'M')) => (&text[..at], 1 << 20),
        Some((at, 'g' | 'G')) => (&text[..at], 1 << 30),
        _ => (text, 1),
    };
    let count = number.parse::<u64>().ok().and_then(|number| number.checked_mul(unit));
    count
        .ok_or_else(|| "allowed are whole numbers of bytes, or of their 1024-folds as in 64K, 16M, 2G".into())
}

/// A number above 0.
pub fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err("allowed are numbers above 0".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_counted_in_powers_of_1024() {
        let fine =
            [("0", 0), ("1000", 1000), ("64K", 65_536), ("1m", 1 << 20), ("16M", 16 << 20), ("2G", 2 << 30)];
        for (text, count) in fine {
            assert_eq!(bytes(text), Ok(count), "{text}");
        }
        for wrong in ["", "M", "1.5M", "-1", "1T", "1MB", "é", "99999999999G"] {
            assert!(bytes(wrong).is_err_and(|words| words.contains("16M")), "{wrong}");
        }
    }
}
