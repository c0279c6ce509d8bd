//! Times of planes that only go on, whatever damage makes of the stream's clock.

use handcast_fba::DecodedFrame;

/// Seconds by which the clock may run ahead of its own ticks where damage is to be passed over.
const LONGEST_LEAP: f64 = 60.0;

/// The times of planes so far.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Timeline {
    last: Option<f64>,
    /// Seconds of the frames that the last plane stands for besides its own.
    skipped: f64,
    /// Seconds that planes come later than the stream says.
    shift: f64,
}

impl Timeline {
    /// Seconds at which `plane` is, behind the one before and all frames that this one stands for, at `rate` frames per
    /// second. With `wary` a clock that runs on by more than [`LONGEST_LEAP`] is not believed.
    pub fn place(&mut self, plane: &DecodedFrame, rate: f64, wary: bool) -> f64 {
        let mut time = plane.time + self.shift;
        if let Some(last) = self.last {
            let next = last + self.skipped + 1.0 / rate;
            if time < next - 0.5 / rate || (wary && time - next > LONGEST_LEAP) {
                self.shift += next - time;
                time = next;
            }
        }
        self.last = Some(time);
        self.skipped = f64::from(plane.skipped) / rate;
        time
    }
}
