//! Boxes, written.

/// Bytes being written.
#[derive(Default)]
pub struct Out(Vec<u8>);

impl Out {
    pub fn bytes(&mut self, bytes: &[u8]) {
        self.0.extend_from_slice(bytes);
    }

    pub fn zeros(&mut self, count: usize) {
        self.0.resize(self.0.len() + count, 0);
    }

    pub fn u16(&mut self, value: u16) {
        self.bytes(&value.to_be_bytes());
    }

    pub fn u32(&mut self, value: u32) {
        self.bytes(&value.to_be_bytes());
    }

    pub fn u64(&mut self, value: u64) {
        self.bytes(&value.to_be_bytes());
    }

    pub fn len(&self) -> u64 {
        self.0.len() as u64
    }

    pub fn into_bytes(self) -> Vec<u8> {
        self.0
    }

    /// A box with what `fill` writes.
    pub fn of(&mut self, kind: &[u8; 4], fill: impl FnOnce(&mut Self)) {
        let start = self.0.len();
        self.u32(0);
        self.bytes(kind);
        fill(self);
        let length = (self.0.len() - start) as u32;
        self.0[start..start + 4].copy_from_slice(&length.to_be_bytes());
    }

    /// A box of version 0 with flags.
    pub fn full(&mut self, kind: &[u8; 4], flags: u32, fill: impl FnOnce(&mut Self)) {
        self.of(kind, |out| {
            out.u32(flags);
            fill(out);
        });
    }

    /// A time, in 64 bits where the box has long ones.
    pub fn time(&mut self, time: u64, long: bool) {
        if long { self.u64(time) } else { self.u32(time as u32) }
    }

    /// A descriptor of ISO/IEC 14496-1 with what `fill` writes.
    fn descriptor(&mut self, tag: u8, fill: impl FnOnce(&mut Self)) {
        let mut content = Self::default();
        fill(&mut content);
        let length = content.0.len() as u32;
        self.bytes(&[tag]);
        // Seven bits a byte, the highest first, always four.
        for shift in [21, 14, 7, 0] {
            let more = if shift > 0 { 0x80 } else { 0 };
            self.bytes(&[(length >> shift & 0x7f) as u8 | more]);
        }
        self.bytes(&content.0);
    }
}

/// The matrix that turns and moves nothing.
fn matrix(out: &mut Out) {
    [1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30].into_iter().for_each(|v| out.u32(v));
}

/// Whether a time does not fit into 32 bits, all of which set mean that it is not known.
pub fn is_long(time: u64) -> bool {
    time >= u32::MAX.into()
}

/// The version of a full box whose times are long or not, where its flags are.
pub fn version_of(long: bool) -> u32 {
    u32::from(long) << 24
}

/// When a movie or its media were made and changed, its ticks a second and how many of them it lasts, as their headers begin.
pub fn times(out: &mut Out, dates: [u64; 2], timescale: u32, duration: u64, long: bool) {
    dates.into_iter().for_each(|date| out.time(date, long));
    out.u32(timescale);
    out.time(duration, long);
}

pub fn mvhd(out: &mut Out, timescale: u32, duration: u64, next_track: u32) {
    let long = is_long(duration);
    out.full(b"mvhd", version_of(long), |out| {
        times(out, [0; 2], timescale, duration, long);
        out.u32(1 << 16);
        out.u16(1 << 8);
        out.zeros(10);
        matrix(out);
        out.zeros(24);
        out.u32(next_track);
    });
}

/// The header of a track that is on, in the movie and its preview, without a picture.
pub fn tkhd(out: &mut Out, id: u32, duration: u64) {
    let long = is_long(duration);
    out.full(b"tkhd", 7 | version_of(long), |out| {
        [0, 0].into_iter().for_each(|v| out.time(v, long));
        [id, 0].into_iter().for_each(|v| out.u32(v));
        out.time(duration, long);
        out.zeros(16);
        matrix(out);
        out.zeros(8);
    });
}

pub fn mdhd(out: &mut Out, timescale: u32, duration: u64) {
    let long = is_long(duration);
    out.full(b"mdhd", version_of(long), |out| {
        times(out, [0; 2], timescale, duration, long);
        // No language ("und").
        out.u16(0x55c4);
        out.u16(0);
    });
}

pub fn hdlr(out: &mut Out, kind: &[u8; 4], name: &str) {
    out.full(b"hdlr", 0, |out| {
        out.u32(0);
        out.bytes(kind);
        out.zeros(12);
        out.bytes(name.as_bytes());
        out.bytes(&[0]);
    });
}

/// The media are in this file.
pub fn dinf(out: &mut Out) {
    out.of(b"dinf", |out| {
        out.full(b"dref", 0, |out| {
            out.u32(1);
            out.full(b"url ", 1, |_| {});
        });
    });
}

/// Object type of ISO/IEC 14496-2 visual, and visual streams downwards.
pub const VISUAL: [u8; 2] = [0x20, 0x11];
/// Tags of descriptors: of a stream, its decoder's, what its decoder is told, how it is synchronised.
pub const TAGS: [u8; 4] = [3, 4, 5, 6];

/// The entry of a stream with `header` as DecoderSpecificInfo; `longest` sample in bytes, bits a second.
pub fn mp4v(out: &mut Out, header: &[u8], longest: u32, rate: u32) {
    out.of(b"mp4v", |out| {
        out.zeros(6);
        out.u16(1);
        out.zeros(16);
        // Readers divide by width and height; there is no picture.
        out.u16(1);
        out.u16(1);
        [72 << 16, 72 << 16, 0].into_iter().for_each(|v| out.u32(v));
        out.u16(1);
        out.zeros(32);
        out.u16(24);
        out.u16(u16::MAX);
        out.full(b"esds", 0, |out| {
            out.descriptor(TAGS[0], |out| {
                out.zeros(3);
                out.descriptor(TAGS[1], |out| {
                    out.bytes(&VISUAL);
                    out.bytes(&longest.min(0xff_ffff).to_be_bytes()[1..]);
                    out.u32(rate);
                    out.u32(rate);
                    out.descriptor(TAGS[2], |out| out.bytes(header));
                });
                out.descriptor(TAGS[3], |out| out.bytes(&[2]));
            });
        });
    });
}
