//! Exports of the surface.

use std::cell::RefCell;

use super::{given_sizes, side};
use crate::surface::Surface;

thread_local! {
    static SURFACE: RefCell<Surface> = RefCell::default();
}

/// Makes the surface of a hand of the input's sizes and gives the number of its vertices; 0 where no person could have
/// them.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn surface(right: u32, fine: u32) -> u32 {
    let made = given_sizes().map(|sizes| Surface::new(&sizes, side(right), fine != 0)).unwrap_or_default();
    let vertices = made.vertices.len() as u32 / 32;
    SURFACE.set(made);
    vertices
}

/// The address of the vertices, 32 bytes each.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn surface_vertices() -> *const u8 {
    SURFACE.with_borrow(|surface| surface.vertices.as_ptr())
}

/// The address of the corners of triangles, 32-bit numbers.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn surface_triangles() -> *const u32 {
    SURFACE.with_borrow(|surface| surface.triangles.as_ptr())
}

/// How many corners there are.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn surface_corners() -> u32 {
    SURFACE.with_borrow(|surface| surface.triangles.len() as u32)
}

/// The address of the other numbers, 32-bit floats, in seven groups.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn surface_numbers() -> *const f32 {
    SURFACE.with_borrow(|surface| surface.numbers.as_ptr())
}

/// The address of where the groups end, seven 32-bit numbers.
#[cfg_attr(target_family = "wasm", unsafe(no_mangle))]
pub extern "C" fn surface_ends() -> *const u32 {
    SURFACE.with_borrow(|surface| surface.ends.as_ptr())
}
