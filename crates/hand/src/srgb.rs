//! Colours of skin: sRGB in pictures and options, linear light where tints multiply them.

/// sRGB transfer function, 0..=255 to 0..=1.
pub fn linear_from_srgb(v: u8) -> f32 {
    let v = f32::from(v) / 255.0;
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// Inverse sRGB transfer function, 0..=1 (clamped) to 0..=255.
pub fn srgb_from_linear(v: f32) -> f32 {
    let v = v.clamp(0.0, 1.0);
    255.0 * if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}
