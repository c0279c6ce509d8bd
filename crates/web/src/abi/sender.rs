//! Exports of the sender.

use std::cell::RefCell;

use handcast_hand::Side;
use handcast_track::View;

use super::{give_back, outcome, show_sizes, side, taken};
use crate::sender::{Sent, VideoOptions, VideoSender};

#[derive(Default)]
struct Senders {
    senders: Vec<Option<VideoSender>>,
    sent: Sent,
    /// Five numbers a plane: flags (1 opens a period, 2 the left hand is lost, 4 the right one), period, index, length of its
    /// bytes and of its message.
    planes: Vec<u32>,
    /// Length of the hello before the planes' messages, 0 without one.
    hello: u32,
    /// Bytes of the planes, then of all messages.
    bytes: Vec<u8>,
}

thread_local! {
    static SENDERS: RefCell<Senders> = RefCell::default();
}

fn with<T>(f: impl FnOnce(&mut Senders) -> T) -> T {
    SENDERS.with_borrow_mut(f)
}

impl Senders {
    fn find(&mut self, sender: u32) -> Option<&mut VideoSender> {
        self.senders.get_mut(sender as usize).and_then(Option::as_mut)
    }

    /// Lays out what has been sent for JavaScript.
    fn show(&mut self, sent: Sent) {
        self.planes.clear();
        self.bytes.clear();
        let hellos = sent.messages.len() - sent.planes.len().min(sent.messages.len());
        self.hello = sent.messages[..hellos].iter().map(|message| message.len() as u32).sum();
        for (plane, message) in sent.planes.iter().zip(&sent.messages[hellos..]) {
            let flags =
                u32::from(plane.opens()) | u32::from(plane.lost[0]) << 1 | u32::from(plane.lost[1]) << 2;
            let lengths = [plane.payload.len() as u32, message.len() as u32];
            self.planes.extend([flags, plane.period.into(), plane.index.into(), lengths[0], lengths[1]]);
            self.bytes.extend(&plane.payload);
        }
        self.bytes.extend(sent.messages.iter().flatten());
        self.sent = sent;
    }
}

fn run(sender: u32, f: impl FnOnce(&mut VideoSender) -> Result<Sent, String>) -> u32 {
    let result = with(|all| {
        let sent = all.find(sender).ok_or("sender: it has been freed").map_err(String::from).and_then(f);
        let (sent, result) = match sent {
            Ok(sent) => (sent, Ok(())),
            Err(error) => (Sent::default(), Err(error)),
        };
        all.show(sent);
        result
    });
    outcome(result)
}

/// A sender. `side` and `view`: 0 unknown, 1 left or palm, 2 right or back; bits of `flags`: 1 mirrored pictures, 2 any start.
/// Numbers that are 0 are the defaults.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn sender_new(
    rate: f64,
    rms: f64,
    sees: u32,
    flags: u32,
    hand_length: f64,
    field_of_view: f64,
    analysis_side: u32,
) -> u32 {
    let mut options = VideoOptions::default();
    let set = |field: &mut f64, value: f64| {
        if value.is_finite() && value > 0.0 {
            *field = value;
        }
    };
    set(&mut options.rate, rate);
    set(&mut options.rms, rms);
    set(&mut options.hand_length, hand_length);
    set(&mut options.field_of_view, field_of_view);
    options.side = [None, Some(Side::Left), Some(Side::Right), None][(sees & 3) as usize];
    options.view = [None, Some(View::Palm), Some(View::Back), None][(sees >> 2 & 3) as usize];
    options.mirror = flags & 1 != 0;
    options.any_start = flags & 2 != 0;
    if analysis_side > 0 {
        options.analysis_side = analysis_side.clamp(64, 4096);
    }
    let sender = Some(VideoSender::new(options));
    with(|Senders { senders, .. }| match senders.iter().position(Option::is_none) {
        Some(free) => {
            senders[free] = sender;
            free as u32
        }
        None => {
            senders.push(sender);
            senders.len() as u32 - 1
        }
    })
}

/// Gives a sender's memory back.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn sender_free(sender: u32) {
    with(|all| {
        if let Some(found) = all.senders.get_mut(sender as usize) {
            *found = None;
        }
    });
}

/// Takes the picture of the input, four bytes a pixel, captured at so many milliseconds. 0, or all bits where it failed.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn sender_push(sender: u32, width: u32, height: u32, capture: f64) -> u32 {
    let rgba = taken();
    let result = run(sender, |sender| sender.push(&rgba, width, height, capture));
    give_back(rgba);
    result
}

/// Makes the next plane open a period.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn sender_request_intra(sender: u32) {
    with(|all| {
        if let Some(sender) = all.find(sender) {
            sender.request_intra();
        }
    });
}

/// Ends the stream. 0, or all bits where it failed.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn sender_finish(sender: u32) -> u32 {
    run(sender, VideoSender::finish)
}

/// How many planes the last call made.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn sender_planes() -> u32 {
    with(|all| all.planes.len() as u32 / 5)
}

/// The address of five 32-bit numbers a plane: flags, period, index, lengths of its bytes and of its message.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn sender_table() -> *const u32 {
    with(|all| all.planes.as_ptr())
}

/// The length of the hello that goes before the messages of the planes, 0 without one.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn sender_hello() -> u32 {
    with(|all| all.hello)
}

/// The address of the bytes of the planes, of the hello, and of the planes' messages, one behind the other.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn sender_bytes() -> *const u8 {
    with(|all| all.bytes.as_ptr())
}

/// How many poses the last call made.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn sender_poses() -> u32 {
    with(|all| all.sent.times.len() as u32)
}

/// The address of their times, 64-bit floats.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn sender_times() -> *const f64 {
    with(|all| all.sent.times.as_ptr())
}

/// The address of their rows, 32-bit floats.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn sender_rows() -> *const f32 {
    with(|all| all.sent.rows.as_ptr())
}

/// Makes the reason why nothing was found the message, and gives its length; 0 where there is none.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn sender_trouble() -> u32 {
    match with(|all| all.sent.trouble.clone()) {
        Some(trouble) => {
            let length = trouble.len() as u32;
            outcome(Err(trouble));
            length
        }
        None => 0,
    }
}

/// The tone of the skin, 1 to 10; 0 where no hand has been sure.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn sender_skin_tone(sender: u32) -> u32 {
    let header = with(|all| all.find(sender).map(|sender| sender.header()));
    header.and_then(|header| header.skin_tone).map_or(0, u32::from)
}

/// The address of the sizes of a hand (0 left, 1 right) that has been found, 64-bit floats; 0 before.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn sender_sizes(sender: u32, right: u32) -> *const f64 {
    let header = with(|all| all.find(sender).map(|sender| sender.header()));
    let hand = header.and_then(|header| header.hand(side(right)).cloned());
    match hand.and_then(|hand| hand.morphology) {
        Some(sizes) => show_sizes(&sizes),
        None => std::ptr::null(),
    }
}
