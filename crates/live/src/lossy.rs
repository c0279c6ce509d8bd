//! A way to a server on which segments are delayed and lost, to test and measure with.
//!
//! TCP gives what was lost later, and what is behind it only then. Hands make a thin stream: a segment is known to be lost
//! when the next one is acknowledged, an interval of planes and a round trip later (RFC 8985 waits for another quarter), and
//! when the second copy is lost as well, only the timer of RFC 6298 helps, 200 ms in common systems.

use std::io::{self, Read as _, Write as _};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

/// How segments fare.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct LossyOptions {
    /// One way, without loss.
    pub delay: Duration,
    /// Share of the segments that are lost.
    pub loss: f64,
    /// Time by which a segment lost once comes later.
    pub again: Duration,
    /// Time by which it comes still later for each further copy that is lost.
    pub timer: Duration,
}

impl Default for LossyOptions {
    /// 20 ms one way without loss, for 30 planes/s: 33 ms, a round trip of 40 ms and its quarter for the second copy.
    fn default() -> Self {
        let [delay, again, timer] = [20, 83, 200].map(Duration::from_millis);
        Self { delay, loss: 0.0, again, timer }
    }
}

impl LossyOptions {
    /// Sets the share of the segments that are lost, 0 to 0.9.
    pub fn with_loss(self, loss: f64) -> Self {
        Self { loss: loss.clamp(0.0, 0.9), ..self }
    }

    /// Sets the time that a segment takes one way.
    pub fn with_delay(self, delay: Duration) -> Self {
        Self { delay, ..self }
    }
}

/// Opens a way to `server`, and gives where it begins. It lasts as long as the process.
///
/// # Errors
/// No port is free.
pub fn lossy_way(server: SocketAddr, options: LossyOptions) -> io::Result<SocketAddr> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let address = listener.local_addr()?;
    std::thread::Builder::new().name("lossy".into()).spawn(move || {
        for (number, near) in (0..).zip(listener.incoming().flatten()) {
            // Who cannot be led on is let go.
            let _ = lead(near, server, options, number);
        }
    })?;
    Ok(address)
}

/// Leads a connection on to the server, both ways.
fn lead(near: TcpStream, server: SocketAddr, options: LossyOptions, number: u64) -> io::Result<()> {
    let far = TcpStream::connect(server)?;
    near.set_nodelay(true)?;
    far.set_nodelay(true)?;
    let back = (far.try_clone()?, near.try_clone()?);
    std::thread::spawn(move || pass(near, far, options, 2 * number + 1));
    std::thread::spawn(move || pass(back.0, back.1, options, 2 * number + 2));
    Ok(())
}

/// Passes on what comes when it is due, what comes behind a lost piece not before that.
fn pass(mut from: TcpStream, mut to: TcpStream, options: LossyOptions, seed: u64) {
    let (pieces, queue) = channel::<(Instant, Vec<u8>)>();
    std::thread::spawn(move || {
        for (due, piece) in queue {
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
            if to.write_all(&piece).is_err() {
                return;
            }
        }
        let _ = to.shutdown(Shutdown::Write);
    });
    let mut fate = Fate(seed);
    let mut piece = [0; 4096];
    while let Ok(count @ 1..) = from.read(&mut piece) {
        let due = Instant::now() + options.delay + fate.stall(&options);
        if pieces.send((due, piece.iter().take(count).copied().collect())).is_err() {
            return;
        }
    }
}

/// What becomes of segments, the same for the same seed: splitmix64 (Steele, Lea and Flood 2014).
struct Fate(u64);

impl Fate {
    /// From 0 to 1.
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn stall(&mut self, options: &LossyOptions) -> Duration {
        let mut stall = Duration::ZERO;
        while self.next() < options.loss {
            stall += if stall.is_zero() { options.again } else { options.timer };
        }
        stall
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_many_are_lost_as_asked() {
        for loss in [0.0, 0.01, 0.05] {
            let options = LossyOptions::default().with_loss(loss);
            let mut fate = Fate(7);
            let stalls: Vec<Duration> = (0..100_000).map(|_| fate.stall(&options)).collect();
            let lost = stalls.iter().filter(|stall| !stall.is_zero()).count() as f64 / 1e5;
            assert!((lost - loss).abs() < 0.1 * loss + 1e-9, "{lost} of {loss}");
            let twice = stalls.iter().filter(|stall| **stall > options.again).count() as f64 / 1e5;
            assert!((twice - loss * loss).abs() < 0.5 * loss * loss + 1e-9, "{twice}");
        }
    }
}
