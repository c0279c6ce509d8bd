//! How the program ends early: told to by a signal, by a reader that has had enough, or broken down.

use std::panic::{AssertUnwindSafe, catch_unwind, set_hook};
use std::process::exit;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::Context;
use handcast_formats::unfinished::remove_all;

use super::poses_out::tell_of_journal;

/// Exit code of a program that was told to end, as shells have it for Ctrl-C.
const INTERRUPTED: i32 = 130;

/// Ends the program with this code, and takes away what is unfinished.
pub fn end(code: i32) -> ! {
    match remove_all(|| exit(code)) {}
}

/// What is told of the first signal in place of an end at once.
static TOLD: Mutex<Option<Arc<AtomicBool>>> = Mutex::new(None);

/// Becomes true at the first signal; at a second one the program ends at once.
pub fn told_to_stop() -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    *TOLD.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::clone(&stop));
    stop
}

/// Takes away what is unfinished where the program is interrupted, terminated or loses its terminal.
pub fn on_signals() -> anyhow::Result<()> {
    ctrlc::set_handler(|| {
        let told = TOLD.lock().unwrap_or_else(PoisonError::into_inner).clone();
        if told.is_some_and(|told| !told.swap(true, Ordering::Relaxed)) {
            return;
        }
        tell_of_journal();
        end(INTERRUPTED)
    })
    .context("signals")
}

/// Where the program broke down last.
static BROKEN: Mutex<Option<String>> = Mutex::new(None);

/// Does the work; one that breaks down gives an error in place of a trace, built with `panic = "abort"` (where what a library
/// survives ends the program) too. `RUST_BACKTRACE` brings the trace back.
pub fn without_traces<T>(work: impl FnOnce() -> anyhow::Result<T>) -> anyhow::Result<T> {
    if std::env::var_os("RUST_BACKTRACE").is_some_and(|value| value != "0") {
        return work();
    }
    set_hook(Box::new(|broken| {
        let place = broken.location().map_or_else(String::new, ToString::to_string);
        if cfg!(panic = "abort") {
            errln!("handcast: {}", broke_down(&place));
            end(1);
        }
        *BROKEN.lock().unwrap_or_else(PoisonError::into_inner) = Some(place);
    }));
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| {
        let place = BROKEN.lock().unwrap_or_else(PoisonError::into_inner).take().unwrap_or_default();
        anyhow::bail!(broke_down(&place))
    })
}

fn broke_down(place: &str) -> String {
    format!("broke down at {place}, which is a fault of the program")
}
