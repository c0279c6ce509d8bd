//! Decimal numbers with few digits, written fast: most of a motion file is those.

/// Up to this many units of the last digit a number is exact.
const EXACT: f64 = 9e15;

/// Appends `value` rounded to `digits` (at most 9) behind the point, without zeros at its end but one: `12.5`, `3.0`. What
/// is read back is the nearest number to that. Numbers too large for that are written in full.
pub(crate) fn push_number(out: &mut Vec<u8>, value: f64, digits: u32) {
    push(out, value, digits, false);
}

/// Appends `value` rounded to `digits` (at most 9) behind the point, all of them: `12.5000`.
pub(crate) fn push_fixed(out: &mut Vec<u8>, value: f64, digits: u32) {
    push(out, value, digits, true);
}

fn push(out: &mut Vec<u8>, value: f64, digits: u32, all: bool) {
    let unit = 10u64.pow(digits);
    let scaled = (value * unit as f64).round();
    if scaled.is_nan() || scaled.abs() >= EXACT {
        out.extend_from_slice(format!("{value:?}").as_bytes());
        return;
    }
    if scaled < 0.0 {
        out.push(b'-');
    }
    let scaled = scaled.abs() as u64;
    push_whole(out, scaled / unit);
    let mut part = scaled % unit;
    let mut places = digits as usize;
    if !all {
        while places > 1 && part.is_multiple_of(10) {
            part /= 10;
            places -= 1;
        }
    }
    let mut text = *b".000000000";
    for place in text[1..=places].iter_mut().rev() {
        *place = b'0' + (part % 10) as u8;
        part /= 10;
    }
    out.extend_from_slice(&text[..=places]);
}

/// Appends a whole number.
fn push_whole(out: &mut Vec<u8>, mut value: u64) {
    let mut text = [0; 20];
    let mut from = text.len();
    loop {
        from -= 1;
        text[from] = b'0' + (value % 10) as u8;
        value /= 10;
        if value == 0 {
            break;
        }
    }
    out.extend_from_slice(&text[from..]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn text(value: f64, digits: u32, all: bool) -> String {
        let mut out = Vec::new();
        push(&mut out, value, digits, all);
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn few_digits() {
        for (value, digits, short, fixed) in [
            (12.5, 4, "12.5", "12.5000"),
            (-3.0, 2, "-3.0", "-3.00"),
            (-0.000_04, 4, "0.0", "0.0000"),
            (0.000_06, 4, "0.0001", "0.0001"),
            (1e300, 4, "1e300", "1e300"),
        ] {
            assert_eq!((text(value, digits, false), text(value, digits, true)), (short.into(), fixed.into()));
        }
    }

    proptest! {
        /// What standard rounding gives is read back.
        #[test]
        fn numbers_are_read_back(value in prop_oneof![-1e6..1e6f64, -1.0..1.0f64, any::<f64>()], digits in 1u32..9) {
            prop_assume!(value.is_finite());
            let unit = 10f64.powi(digits as i32);
            let rounded = (value * unit).round() / unit;
            let expected = if (value * unit).abs() < EXACT { rounded } else { value };
            for all in [false, true] {
                prop_assert_eq!(text(value, digits, all).parse::<f64>().unwrap(), expected + 0.0);
            }
        }
    }
}
