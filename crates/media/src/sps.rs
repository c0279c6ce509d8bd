//! What an H.264 sequence parameter set says of its pictures.

/// `matrix_coefficients`, `video_full_range_flag` and the sample aspect ratio of the VUI (ISO/IEC 14496-10, E.1.1 and
/// E.2.1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Vui {
    /// `None` when unspecified.
    pub(super) bt709: Option<bool>,
    pub(super) full_range: bool,
    /// Width and height of a pixel, in parts of one another; `None` when unspecified.
    pub(super) pixel: Option<[u32; 2]>,
}

/// Table E-1, from `aspect_ratio_idc` 1 on; 255 stands for a ratio that follows.
const ASPECTS: [[u32; 2]; 16] = [
    [1, 1],
    [12, 11],
    [10, 11],
    [16, 11],
    [40, 33],
    [24, 11],
    [20, 11],
    [32, 11],
    [80, 33],
    [18, 11],
    [15, 11],
    [64, 33],
    [160, 99],
    [4, 3],
    [3, 2],
    [2, 1],
];

/// Largest picture of a sequence parameter set (NAL unit with its header byte), before any cropping: width and height,
/// pixels.
///
/// `None` when the set ends early.
pub(super) fn size(nal: &[u8]) -> Option<(u64, u64)> {
    let rbsp = without_emulation_prevention(nal.get(1..)?);
    let mut bits = Bits { bytes: &rbsp, at: 0 };
    let [width, height] = up_to_size(&mut bits)?;
    // Two fields make a frame where not all are frames.
    let fields = 2 - u64::from(bits.u(1)?);
    Some(((u64::from(width) + 1) * 16, (u64::from(height) + 1) * 16 * fields))
}

/// Reads the VUI of a sequence parameter set (NAL unit with its header byte).
///
/// `None` when the set ends early or uses profiles whose syntax differs.
pub(super) fn vui(nal: &[u8]) -> Option<Vui> {
    let rbsp = without_emulation_prevention(nal.get(1..)?);
    let mut bits = Bits { bytes: &rbsp, at: 0 };
    up_to_size(&mut bits)?;
    let frame_mbs_only_flag = bits.u(1)?;
    if frame_mbs_only_flag == 0 {
        bits.u(1)?;
    }
    bits.u(1)?;
    if bits.u(1)? == 1 {
        for _ in 0..4 {
            bits.ue()?;
        }
    }
    let mut vui = Vui::default();
    let vui_parameters_present_flag = bits.u(1)?;
    if vui_parameters_present_flag == 0 {
        return Some(vui);
    }
    // E.1.1 vui_parameters
    if bits.u(1)? == 1 {
        vui.pixel = match bits.u(8)? {
            255 => Some([bits.u(16)?, bits.u(16)?]),
            number => (number as usize).checked_sub(1).and_then(|at| ASPECTS.get(at).copied()),
        };
    }
    if bits.u(1)? == 1 {
        bits.u(1)?;
    }
    let video_signal_type_present_flag = bits.u(1)?;
    if video_signal_type_present_flag == 1 {
        bits.u(3)?;
        vui.full_range = bits.u(1)? == 1;
        if bits.u(1)? == 1 {
            bits.u(16)?;
            // Table E-5: 1 is BT.709; 5 and 6 are BT.601; the others are rare.
            vui.bt709 = match bits.u(8)? {
                1 => Some(true),
                5 | 6 => Some(false),
                _ => None,
            };
        }
    }
    Some(vui)
}

/// Reads a set up to its size: `pic_width_in_mbs_minus1`, `pic_height_in_map_units_minus1`.
fn up_to_size(bits: &mut Bits<'_>) -> Option<[u32; 2]> {
    // 7.3.2.1.1 seq_parameter_set_data
    let profile_idc = bits.u(8)?;
    bits.u(16)?;
    bits.ue()?;
    if matches!(profile_idc, 100 | 110 | 122 | 244 | 44 | 83 | 86 | 118 | 128 | 138 | 139 | 134 | 135) {
        let chroma_format_idc = bits.ue()?;
        if chroma_format_idc == 3 {
            bits.u(1)?;
        }
        bits.ue()?;
        bits.ue()?;
        bits.u(1)?;
        if bits.u(1)? == 1 {
            for list in 0..if chroma_format_idc == 3 { 12 } else { 8 } {
                if bits.u(1)? == 1 {
                    skip_scaling_list(bits, if list < 6 { 16 } else { 64 })?;
                }
            }
        }
    }
    bits.ue()?;
    match bits.ue()? {
        0 => {
            bits.ue()?;
        }
        1 => {
            bits.u(1)?;
            bits.ue()?;
            bits.ue()?;
            for _ in 0..bits.ue()?.min(255) {
                bits.ue()?;
            }
        }
        _ => {}
    }
    bits.ue()?;
    bits.u(1)?;
    Some([bits.ue()?, bits.ue()?])
}

fn skip_scaling_list(bits: &mut Bits<'_>, size: usize) -> Option<()> {
    // 7.3.2.1.1.1 scaling_list
    let (mut last, mut next) = (8i64, 8i64);
    for _ in 0..size {
        if next != 0 {
            next = (last + bits.se()? + 256).rem_euclid(256);
        }
        if next != 0 {
            last = next;
        }
    }
    Some(())
}

fn without_emulation_prevention(bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(bytes.len());
    let mut zeros = 0;
    for &byte in bytes {
        if zeros >= 2 && byte == 3 {
            zeros = 0;
            continue;
        }
        zeros = if byte == 0 { zeros + 1 } else { 0 };
        out.push(byte);
    }
    out
}

struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Bits<'_> {
    fn u(&mut self, count: u32) -> Option<u32> {
        let mut value = 0u32;
        for _ in 0..count {
            let byte = *self.bytes.get(self.at / 8)?;
            value = value << 1 | u32::from(byte >> (7 - self.at % 8) & 1);
            self.at += 1;
        }
        Some(value)
    }

    fn ue(&mut self) -> Option<u32> {
        let mut zeros = 0;
        while self.u(1)? == 0 {
            zeros += 1;
            if zeros > 31 {
                return None;
            }
        }
        Some((1u32 << zeros) - 1 + self.u(zeros)?)
    }

    fn se(&mut self) -> Option<i64> {
        let k = i64::from(self.ue()?);
        Some(if k % 2 == 1 { (k + 1) / 2 } else { -(k / 2) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Writes the fields of a baseline sequence parameter set bit by bit.
    fn baseline(aspect: &str, signal: &str) -> Vec<u8> {
        let bits = [
            "01000010",
            "0000000000011110",
            "1", // profile 66, constraints and level, id 0
            "1",
            "1",
            "1", // log2_max_frame_num 4, poc type 0, its size 4
            "1",
            "0",
            "00101",
            "00101", // reference frames 0, gaps, width 4 + 1, height 4 + 1
            "1",
            "1",
            "0",
            "1", // frames only, direct 8x8, no cropping, VUI follows
            aspect,
            "0",
            signal,
            "1",
        ]
        .concat();
        let mut bytes = vec![0x67];
        for chunk in bits.as_bytes().chunks(8) {
            let text = format!("{:0<8}", std::str::from_utf8(chunk).unwrap());
            bytes.push(u8::from_str_radix(&text, 2).unwrap());
        }
        bytes
    }

    #[test]
    fn sizes_are_found() {
        assert_eq!(size(&baseline("0", "0")), Some((80, 80)));
        assert_eq!(size(&[0x67, 66]), None);
    }

    #[test]
    fn colour_descriptions_are_found() {
        let cases = [
            ("0", None, false),
            ("1 101 1 0", None, true),
            ("1 101 0 1 00000001 00000001 00000001", Some(true), false),
            ("1 101 1 1 00000110 00000110 00000110", Some(false), true),
        ];
        for (signal, bt709, full_range) in cases {
            let nal = baseline("0", &signal.replace(' ', ""));
            assert_eq!(vui(&nal), Some(Vui { bt709, full_range, pixel: None }), "{signal}");
        }
        assert_eq!(vui(&[0x67, 66]), None);
        assert_eq!(vui(&[]), None);
    }

    #[test]
    fn shapes_of_pixels_are_found() {
        let cases = [
            ("0", None),
            ("1 00000000", None),
            ("1 00000010", Some([12, 11])),
            ("1 00010000", Some([2, 1])),
            ("1 00010001", None),
            ("1 11111111 0000000011010101 0000000010100000", Some([213, 160])),
        ];
        for (aspect, pixel) in cases {
            let nal = baseline(&aspect.replace(' ', ""), "1 101 1 0".replace(' ', "").as_str());
            assert_eq!(vui(&nal), Some(Vui { bt709: None, full_range: true, pixel }), "{aspect}");
        }
    }
}
