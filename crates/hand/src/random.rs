//! A small seeded generator (SplitMix64): pictures must not change with a dependency's version.

/// Deterministic random numbers.
pub struct Random(u64);

impl Random {
    /// Stream `stream` of a seed.
    pub fn new(seed: u64, stream: u64) -> Self {
        let mut r = Self(seed ^ stream.wrapping_mul(0xD1B5_4A32_D192_ED03));
        r.bits();
        r
    }

    /// The next 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Uniform in `low..high`.
    pub fn range(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * ((self.bits() >> 40) as f32 / (1u64 << 24) as f32)
    }

    /// Uniform in `0..count`; 0 when `count` is.
    pub fn below(&mut self, count: usize) -> usize {
        (self.bits() % count.max(1) as u64) as usize
    }

    /// Nearly normal with mean 0 and deviation 1: the sum of twelve bytes' worth of uniforms would do;
    /// eight of 16 bits from two draws are closer and cheaper.
    pub fn gauss(&mut self) -> f32 {
        let mut sum = 0u32;
        for _ in 0..2 {
            let v = self.bits();
            for k in 0..4 {
                sum += (v >> (16 * k)) as u16 as u32;
            }
        }
        // Eight uniforms on 0..65535: mean 8 · 32767.5, variance 8 · 65536² / 12.
        (sum as f32 - 262_140.0) / 53_510.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gauss_has_mean_0_and_deviation_1() {
        let mut r = Random::new(5, 0);
        let values: Vec<f64> = (0..40_000).map(|_| f64::from(r.gauss())).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64;
        assert!(mean.abs() < 0.02 && (variance - 1.0).abs() < 0.03, "{mean} {variance}");
    }

    #[test]
    fn streams_differ() {
        assert_ne!(Random::new(1, 0).bits(), Random::new(1, 1).bits());
        assert!((0..1000).all(|i| (2.0..3.0).contains(&Random::new(7, i).range(2.0, 3.0))));
    }
}
