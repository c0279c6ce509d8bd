//! The line that says how it goes.

use std::io::IsTerminal as _;
use std::time::{Duration, Instant};

use handcast_live::server::{Counted, Server};
use indicatif::{ProgressBar, ProgressStyle};

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
    /// On a terminal: cut to its width.
    bar: Option<ProgressBar>,
    begun: Option<Moment>,
    last: Option<Moment>,
}

impl Status {
    pub fn new(quiet: bool) -> Self {
        let terminal = !quiet && std::io::stderr().is_terminal();
        let style = || {
            ProgressStyle::with_template("{wide_msg}").unwrap_or_else(|_| ProgressStyle::default_spinner())
        };
        let bar = terminal.then(|| ProgressBar::new_spinner().with_style(style()));
        Self { quiet, bar, begun: None, last: None }
    }

    /// Says how it goes, if it is time.
    pub fn tell(&mut self, worker: &Worker, slot: &Slot, server: &Server) {
        let every = Duration::from_secs(if self.bar.is_some() { 1 } else { 5 });
        if self.last.is_some_and(|last| last.at.elapsed() < every) {
            return;
        }
        let now = moment(worker, slot, server);
        if let Some(last) = self.last.replace(now)
            && !self.quiet
        {
            let line = line(&last, &now, worker.trouble.as_deref());
            match &self.bar {
                Some(bar) => {
                    bar.set_message(line);
                    bar.tick();
                }
                None => errln!("{line}"),
            }
        }
        self.begun.get_or_insert(now);
    }

    /// Says how it went.
    pub fn end(&mut self, worker: &Worker, slot: &Slot, server: &Server) {
        let now = moment(worker, slot, server);
        if let (Some(begun), false) = (self.begun, self.quiet) {
            self.bar.iter().for_each(ProgressBar::finish_and_clear);
            errln!("all in all: {}", line(&begun, &now, None));
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
