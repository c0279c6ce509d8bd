//! Which part of a clip is read.

use handcast_media::Part;

/// The part of a clip that is looked at; times of poses count from the clip's first picture all the same.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Part of the clip")]
pub struct PartArgs {
    /// Begin at this time of the clip: seconds, MM:SS or HH:MM:SS, all with fractions; times of poses go on counting from
    /// the clip's first picture
    #[arg(long, value_name = "TIME", value_parser = time)]
    from: Option<f64>,
    /// End before the picture at this time of the clip, written alike
    #[arg(long, value_name = "TIME", value_parser = time)]
    until: Option<f64>,
}

impl PartArgs {
    /// The part; it must not be empty.
    pub fn part(&self) -> anyhow::Result<Part> {
        let (from, until) = (self.from.unwrap_or(0.0), self.until.unwrap_or(f64::INFINITY));
        if until <= from {
            refuse!("--until {until} is no later than --from {from}: there is nothing between");
        }
        Ok(Part { from, until, ..Part::WHOLE })
    }
}

/// Seconds, `MM:SS` or `HH:MM:SS`.
fn time(text: &str) -> Result<f64, String> {
    let wrong = || "allowed are seconds, MM:SS and HH:MM:SS, as in 12.5, 1:02.5 and 1:00:00".to_owned();
    let parts: Vec<&str> = text.split(':').collect();
    let (last, whole) = parts.split_last().ok_or_else(wrong)?;
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit() || b == b'.');
    let number = |text: &str| text.parse::<f64>().ok().filter(|n| digits(text) && n.is_finite());
    let below = |n: &f64, first: bool| first || *n < 60.0;
    let mut sum = 0.0;
    for (place, part) in whole.iter().enumerate() {
        let part: u32 = part.parse().map_err(|_| wrong())?;
        sum = 60.0 * (sum + Some(f64::from(part)).filter(|n| below(n, place == 0)).ok_or_else(wrong)?);
    }
    let last = number(last).filter(|n| below(n, whole.is_empty())).ok_or_else(wrong)?;
    if whole.len() > 2 { Err(wrong()) } else { Ok(sum + last) }
}

#[cfg(test)]
mod tests {
    use super::time;

    #[test]
    fn times_are_seconds_or_clocks() {
        for (text, seconds) in [
            ("0", 0.0),
            ("12.5", 12.5),
            ("90", 90.0),
            ("1:02.5", 62.5),
            ("01:00:01", 3601.0),
            ("75:00", 4500.0),
        ] {
            assert_eq!(time(text), Ok(seconds), "{text}");
        }
        for text in ["", "-1", "x", "1:60", "1:2:3:4", "1::2", "inf", "nan", "1e3", "1:", ":1", "1:61:00"] {
            assert!(time(text).is_err(), "{text}");
        }
    }
}
