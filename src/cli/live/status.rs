//! The line that says how it goes.

use std::io::{IsTerminal as _, Write as _};
use std::time::{Duration, Instant};

use handcast_live::server::{Counted, Server};

use super::capture::Slot;
use super::work::{Spent, Worker};

/// Bytes of TCP and IP around a message of its own: 20 and 20, and 12 of time stamps.
pub const TCP_IP: u64 = 52;

/// What was counted up to a moment.
#[derive(Clone, Copy)]
struct Moment {
    at: Instant,
    spent: Spent,
    frames: [u64; 2],
    room: Counted,
}

/// The status line on standard error.
pub struct Status {
    quiet: bool,
    terminal: bool,
    begun: Option<Moment>,
    last: Option<Moment>,
}

impl Status {
    pub fn new(quiet: bool) -> Self {
        Self { quiet, terminal: std::io::stderr().is_terminal(), begun: None, last: None }
    }

    /// Says how it goes, if it is time.
    pub fn tell(&mut self, worker: &Worker, slot: &Slot, server: &Server) {
        let every = Duration::from_secs(if self.terminal { 1 } else { 5 });
        if self.last.is_some_and(|last| last.at.elapsed() < every) {
            return;
        }
        let now = moment(worker, slot, server);
        if let Some(last) = self.last.replace(now)
            && !self.quiet
        {
            let line = line(&last, &now, worker.trouble.as_deref());
            let mut out = std::io::stderr().lock();
            // Nobody is told that standard error is closed.
            let _ = if self.terminal { write!(out, "\r\x1b[K{line}") } else { writeln!(out, "{line}") };
            let _ = out.flush();
        }
        self.begun.get_or_insert(now);
    }

    /// Says how it went.
    pub fn end(&mut self, worker: &Worker, slot: &Slot, server: &Server) {
        let now = moment(worker, slot, server);
        if let (Some(begun), false) = (self.begun, self.quiet) {
            let gap = if self.terminal { "\r\x1b[K" } else { "" };
            errln!("{gap}all in all: {}", line(&begun, &now, None));
        }
    }
}

fn moment(worker: &Worker, slot: &Slot, server: &Server) -> Moment {
    Moment { at: Instant::now(), spent: worker.spent, frames: slot.counted(), room: server.counted() }
}

fn line(a: &Moment, b: &Moment, trouble: Option<&str>) -> String {
    let seconds = (b.at - a.at).as_secs_f64().max(1e-3);
    let rate = |from: u64, to: u64| (to - from) as f64 / seconds;
    let pictures = (b.spent.pictures - a.spent.pictures).max(1) as f64;
    let ms = |from: Duration, to: Duration| (to - from).as_secs_f64() * 1000.0 / pictures;
    let kbit = |from: u64, to: u64| rate(from, to) * 8.0 / 1000.0;
    let wire = |room: &Counted| room.bytes + room.messages * TCP_IP;
    let viewers = b.room.viewers;
    format!(
        "camera {:.1}/s, tracked {:.1}/s, hand {:.1}/s; {:.2} kbit/s, {:.1} on the wire; wait {:.1}, track {:.1}, \
         encode {:.2} ms; {viewers} viewer{}{}",
        rate(a.frames[0], b.frames[0]),
        rate(a.spent.pictures, b.spent.pictures),
        rate(a.spent.seen, b.spent.seen),
        kbit(a.room.payload, b.room.payload),
        kbit(wire(&a.room), wire(&b.room)),
        ms(a.spent.waited, b.spent.waited),
        ms(a.spent.tracked, b.spent.tracked),
        ms(a.spent.encoded, b.spent.encoded),
        if viewers == 1 { "" } else { "s" },
        trouble.map_or_else(String::new, |trouble| format!("; {trouble}")),
    )
}
