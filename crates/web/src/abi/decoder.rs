//! Exports of the decoder.

use std::cell::RefCell;

use super::{FAILED, give_back, given_sizes, outcome, show_sizes, side, taken};
use crate::{PlayerError, PlayerOptions, StreamPlayer};

#[derive(Default)]
struct Players {
    players: Vec<Option<StreamPlayer>>,
    times: Vec<f64>,
    rows: Vec<f32>,
    facts: [f64; 10],
}

thread_local! {
    static PLAYERS: RefCell<Players> = RefCell::default();
}

fn with<T>(f: impl FnOnce(&mut Players) -> T) -> T {
    PLAYERS.with_borrow_mut(f)
}

impl Players {
    fn find(&mut self, decoder: u32) -> Option<&mut StreamPlayer> {
        self.players.get_mut(decoder as usize).and_then(Option::as_mut)
    }
}

fn run(decoder: u32, f: impl FnOnce(&mut StreamPlayer) -> Result<(), PlayerError>) -> u32 {
    match with(|players| players.find(decoder).map(f)) {
        Some(result) => outcome(result),
        None => outcome(Err("decoder: it has been freed")),
    }
}

/// A decoder; bits of `flags`: 1 damage is an error, 2 the vendor's steps, 4 only what was sent.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn decoder_new(flags: u32) -> u32 {
    let options = PlayerOptions::default()
        .with_conceal(flags & 1 == 0)
        .with_vendor_steps(flags & 2 != 0)
        .with_sent_only(flags & 4 != 0);
    let player = Some(StreamPlayer::new(options));
    with(|Players { players, .. }| match players.iter().position(Option::is_none) {
        Some(free) => {
            players[free] = player;
            free as u32
        }
        None => {
            players.push(player);
            players.len() as u32 - 1
        }
    })
}

/// Gives a decoder's memory back.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn decoder_free(decoder: u32) {
    with(|Players { players, .. }| {
        if let Some(player) = players.get_mut(decoder as usize) {
            *player = None;
        }
    });
}

/// Takes the bytes of the input. 0, or all bits where it failed.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn decoder_push(decoder: u32) -> u32 {
    let bytes = taken();
    let result = run(decoder, |player| player.push(&bytes));
    give_back(bytes);
    result
}

/// Takes the bytes of the input, which end with a plane. 0, or all bits where it failed.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn decoder_push_plane(decoder: u32) -> u32 {
    let bytes = taken();
    let result = run(decoder, |player| player.push_plane(&bytes));
    give_back(bytes);
    result
}

/// Says that bytes were lost. 0, or all bits where it failed.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn decoder_lose(decoder: u32) -> u32 {
    run(decoder, StreamPlayer::lose)
}

/// Says that no more bytes come. 0, or all bits where it failed.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn decoder_finish(decoder: u32) -> u32 {
    run(decoder, StreamPlayer::finish)
}

/// Makes rows of the next poses, `most` at most, and says how many.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn decoder_take(decoder: u32, most: u32) -> u32 {
    with(|all| {
        let Players { players, times, rows, .. } = all;
        times.clear();
        rows.clear();
        if let Some(player) = players.get_mut(decoder as usize).and_then(Option::as_mut) {
            player.take(most as usize, times, rows);
        }
        times.len() as u32
    })
}

/// The address of the times of these poses, 64-bit floats.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn decoder_times() -> *const f64 {
    with(|all| all.times.as_ptr())
}

/// The address of their rows, 32-bit floats.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn decoder_rows() -> *const f32 {
    with(|all| all.rows.as_ptr())
}

/// The address of what is known of a stream, as 64-bit floats: rate, lost, ended, planes, I planes, bits, damage; then of
/// left and right how often the sizes changed, and the tone of the skin, 0 where it is not known.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn decoder_facts(decoder: u32) -> *const f64 {
    with(|all| {
        all.facts = [0.0; 10];
        if let Some(player) = all.find(decoder) {
            let version = |side| f64::from(player.sizes(side).1);
            let versions = [0, 1].map(|right| version(side(right)));
            let facts = player.facts();
            let [lost, ended] = [facts.lost, facts.ended].map(|on| f64::from(u8::from(on)));
            let counts = [facts.planes, facts.intra_planes, facts.bits as usize, facts.damage];
            let [planes, intra, bits, damage] = counts.map(|count| count as f64);
            let tone = f64::from(facts.skin_tone.unwrap_or_default());
            let [left, right] = versions;
            all.facts = [facts.rate, lost, ended, planes, intra, bits, damage, left, right, tone];
        }
        all.facts.as_ptr()
    })
}

/// The colour of skin of a tone of 1 to 10 as 0xRRGGBB (sRGB), or all bits where there is no such tone.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn decoder_skin(tone: u32) -> u32 {
    let skin = u8::try_from(tone).ok().and_then(handcast_hand::skin_tone);
    skin.map_or(FAILED, |[r, g, b]| u32::from_be_bytes([0, r, g, b]))
}

/// The address of a hand's sizes (0 left, 1 right), 64-bit floats; of the mean hand where there is no such decoder.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn decoder_sizes(decoder: u32, right: u32) -> *const f64 {
    let sizes = with(|all| all.find(decoder).map(|player| player.sizes(side(right)).0.clone()));
    show_sizes(&sizes.unwrap_or_default())
}

/// The address of the row of a pose of a hand (0 left, 1 right), 32-bit floats. The input is 29 joint angles (radians), the wrist's
/// place (metres) and its rotation (x, y, z, w), 64-bit floats; a number that is none counts as 0.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn decoder_pose(decoder: u32, right: u32) -> *const f32 {
    let input = taken();
    let numbers: Vec<f64> = input.as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect();
    give_back(input);
    with(|all| {
        all.rows.clear();
        let mut row = Vec::new();
        if let Some(player) = all.find(decoder) {
            player.write_pose(side(right), &numbers, &mut row);
        }
        all.rows = row;
        all.rows.as_ptr()
    })
}

/// Gives a hand the sizes of the input. 0, or all bits where no person could have them.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn decoder_set_sizes(decoder: u32, right: u32) -> u32 {
    let Some(sizes) = given_sizes() else { return FAILED };
    run(decoder, |player| {
        player.set_sizes(side(right), sizes);
        Ok(())
    })
}
