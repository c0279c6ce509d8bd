//! The exports of the WebAssembly modules. `dist/handcast.js` alone calls them.
//!
//! Numbers go in and out as they are, bytes through memory that this side owns: JavaScript asks for the address of a
//! buffer, which holds until the next call. Every function is safe; `unsafe(no_mangle)` vouches only that no other function
//! has its name.

#![cfg_attr(target_family = "wasm", allow(unsafe_code))]

use std::cell::RefCell;

use handcast_hand::{Morphology, Side};

use crate::sizes::{numbers, radii};

#[cfg(feature = "decoder")]
pub mod decoder;
#[cfg(feature = "track")]
pub mod sender;
#[cfg(feature = "surface")]
pub mod surface;

/// What the calls of all parts share.
#[derive(Default)]
struct Shared {
    /// Bytes from JavaScript.
    input: Vec<u8>,
    /// What went wrong in the last call that failed.
    message: String,
    sizes: Vec<f64>,
    radii: Vec<f32>,
}

thread_local! {
    static SHARED: RefCell<Shared> = RefCell::default();
}

fn with<T>(f: impl FnOnce(&mut Shared) -> T) -> T {
    SHARED.with_borrow_mut(f)
}

/// What a function gives where it failed: its message is kept.
#[cfg(any(feature = "decoder", feature = "track"))]
const FAILED: u32 = u32::MAX;

/// 0, or [`FAILED`] with the message kept.
#[cfg(any(feature = "decoder", feature = "track"))]
fn outcome(result: Result<(), impl ToString>) -> u32 {
    match result {
        Ok(()) => 0,
        Err(error) => {
            let message = error.to_string();
            with(|shared| shared.message = message);
            FAILED
        }
    }
}

fn side(right: u32) -> Side {
    if right == 0 { Side::Left } else { Side::Right }
}

/// The bytes that JavaScript has put into the buffer; its memory goes back with [`give_back`].
fn taken() -> Vec<u8> {
    with(|shared| std::mem::take(&mut shared.input))
}

fn give_back(input: Vec<u8>) {
    with(|shared| shared.input = input);
}

/// The sizes that JavaScript has put into the buffer, 64-bit floats.
#[cfg(any(feature = "decoder", feature = "surface"))]
fn given_sizes() -> Option<Morphology> {
    let input = taken();
    let given: Vec<f64> = input.as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect();
    give_back(input);
    crate::sizes::from_numbers(&given)
}

/// Shows sizes to JavaScript: the address of their numbers.
fn show_sizes(sizes: &Morphology) -> *const f64 {
    with(|shared| {
        shared.sizes = numbers(sizes).to_vec();
        shared.radii = radii(sizes).to_vec();
        shared.sizes.as_ptr()
    })
}

/// The address of a buffer of `len` bytes that the next call reads.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn input(len: u32) -> *mut u8 {
    with(|shared| {
        shared.input.clear();
        shared.input.resize(len as usize, 0);
        shared.input.as_mut_ptr()
    })
}

/// The address of the message of the last failure, UTF-8.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn message() -> *const u8 {
    with(|shared| shared.message.as_ptr())
}

/// Its length in bytes.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn message_len() -> u32 {
    with(|shared| shared.message.len() as u32)
}

/// How many numbers sizes have.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn sizes_len() -> u32 {
    crate::sizes::SIZES as u32
}

/// The address of the mean hand's sizes at a length in metres, 64-bit floats.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn sizes_average(hand_length: f64) -> *const f64 {
    show_sizes(&Morphology::average(hand_length))
}

/// The address of the 25 joints' radii for the sizes that were asked for last, 32-bit floats, metres.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn sizes_radii() -> *const f32 {
    with(|shared| shared.radii.as_ptr())
}
