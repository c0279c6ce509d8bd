//! The line that says how it goes.

use std::fmt::{self, Display, Formatter};
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
    /// Whether what was counted in all is printed as JSON.
    json: bool,
    /// On a terminal: cut to its width.
    bar: Option<ProgressBar>,
    begun: Option<Moment>,
    last: Option<Moment>,
    /// Viewers at once, at most.
    most: usize,
}

impl Status {
    pub fn new(quiet: bool, json: bool) -> Self {
        let terminal = !quiet && std::io::stderr().is_terminal();
        let style = || {
            ProgressStyle::with_template("{wide_msg}").unwrap_or_else(|_| ProgressStyle::default_spinner())
        };
        let bar = terminal.then(|| ProgressBar::new_spinner().with_style(style()));
        Self { quiet, json, bar, begun: None, last: None, most: 0 }
    }

    /// Says how it goes, if it is time, and that no hand is seen.
    pub fn tell(&mut self, worker: &mut Worker, slot: &Slot, server: &Server) {
        self.most = self.most.max(server.counted().viewers);
        if let Some(notice) = worker.take_notice() {
            let say = || errln!("handcast: {notice}");
            self.bar.as_ref().map_or_else(say, |bar| bar.suspend(say));
        }
        let every = Duration::from_secs(if self.bar.is_some() { 1 } else { 5 });
        if self.last.is_some_and(|last| last.at.elapsed() < every) {
            return;
        }
        let now = moment(worker, slot, server);
        if let Some(last) = self.last.replace(now)
            && !self.quiet
        {
            let rates = Rates::between(&last, &now);
            let line = match (&worker.trouble, &self.bar) {
                (None, _) => rates.to_string(),
                // A terminal cuts what is behind.
                (Some(trouble), Some(_)) => format!("{trouble}; {rates}"),
                (Some(trouble), None) => format!("{rates}; {trouble}"),
            };
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
        let mut rates = Rates::between(self.begun.as_ref().unwrap_or(&now), &now);
        rates.viewers = self.most.max(rates.viewers);
        self.bar.iter().for_each(ProgressBar::finish_and_clear);
        if self.begun.is_some() && !self.quiet {
            errln!("all in all: {rates} at most");
        }
        if self.json {
            outln!("{}", serde_json::json!(rates));
        }
    }
}

fn moment(worker: &Worker, slot: &Slot, server: &Server) -> Moment {
    Moment { at: Instant::now(), spent: worker.spent, frames: slot.counted(), room: server.counted() }
}

/// How it went from one moment to another. The fields are the keys of the JSON.
#[derive(serde::Serialize)]
struct Rates {
    seconds: f64,
    /// Pictures, those tracked, and those with a hand in them.
    camera_per_s: f64,
    tracked_per_s: f64,
    hand_per_s: f64,
    kbit_per_s: f64,
    wire_kbit_per_s: f64,
    /// Of a picture, on average.
    wait_ms: f64,
    track_ms: f64,
    encode_ms: f64,
    viewers: usize,
}

impl Rates {
    fn between(a: &Moment, b: &Moment) -> Self {
        let seconds = (b.at - a.at).as_secs_f64();
        let rate = |from: u64, to: u64| (to - from) as f64 / seconds.max(1e-3);
        let pictures = (b.spent.pictures - a.spent.pictures).max(1) as f64;
        let ms = |from: Duration, to: Duration| (to - from).as_secs_f64() * 1000.0 / pictures;
        let kbit = |from: u64, to: u64| rate(from, to) * 8.0 / 1000.0;
        let wire = |room: &Counted| room.bytes + room.messages * TCP_IP;
        Self {
            seconds,
            camera_per_s: rate(a.frames[0], b.frames[0]),
            tracked_per_s: rate(a.spent.pictures, b.spent.pictures),
            hand_per_s: rate(a.spent.seen, b.spent.seen),
            kbit_per_s: kbit(a.room.payload, b.room.payload),
            wire_kbit_per_s: kbit(wire(&a.room), wire(&b.room)),
            wait_ms: ms(a.spent.waited, b.spent.waited),
            track_ms: ms(a.spent.tracked, b.spent.tracked),
            encode_ms: ms(a.spent.encoded, b.spent.encoded),
            viewers: b.room.viewers,
        }
    }
}

impl Display for Rates {
    fn fmt(&self, f: &mut Formatter) -> fmt::Result {
        let Self { camera_per_s, tracked_per_s, hand_per_s, kbit_per_s, wire_kbit_per_s, .. } = self;
        let Self { wait_ms, track_ms, encode_ms, viewers, .. } = self;
        let s = if *viewers == 1 { "" } else { "s" };
        write!(
            f,
            "camera {camera_per_s:.1}/s, tracked {tracked_per_s:.1}/s, hand {hand_per_s:.1}/s; {kbit_per_s:.2} kbit/s, \
             {wire_kbit_per_s:.1} on the wire; wait {wait_ms:.1}, track {track_ms:.1}, encode {encode_ms:.2} ms; \
             {viewers} viewer{s}"
        )
    }
}
