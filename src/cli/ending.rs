//! How the program ends early: told to by a signal, by a reader that has had enough, or broken down.

use std::any::Any;
use std::panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind, set_hook};
use std::process::exit;
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::ThreadId;
use std::time::{Duration, Instant};

use anyhow::Context;
use handcast_formats::unfinished::remove_all;

use super::poses_out::tell_of_journal;

/// Exit code of a program that was told to end, as shells have it for Ctrl-C.
const INTERRUPTED: i32 = 130;

/// The code with which a signal ends the program.
static AT_SIGNAL: AtomicI32 = AtomicI32::new(INTERRUPTED);

/// From here on all is done, and a signal is how it ends: well.
pub fn ends_well() {
    AT_SIGNAL.store(0, Ordering::Relaxed);
}

/// Ends the program with this code, and takes away what is unfinished.
pub fn end(code: i32) -> ! {
    match remove_all(|| exit(code)) {}
}

/// What is told of the first signal in place of an end at once, and when that came.
static TOLD: Mutex<Option<(Arc<AtomicBool>, Option<Instant>)>> = Mutex::new(None);

/// Signals that come within this of the first are one with it: a terminal that closes sends several, as do the system and
/// a shell that both end.
const ONE: Duration = Duration::from_secs(1);

/// Becomes true at the first signal; at one that comes a second later the program ends at once.
pub fn told_to_stop() -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    *TOLD.lock().unwrap_or_else(PoisonError::into_inner) = Some((Arc::clone(&stop), None));
    stop
}

/// Tells of a signal; false where the program is to end at once.
fn tell_to_stop() -> bool {
    let mut told = TOLD.lock().unwrap_or_else(PoisonError::into_inner);
    told.as_mut().is_some_and(|(stop, first)| {
        stop.store(true, Ordering::Relaxed);
        first.get_or_insert_with(Instant::now).elapsed() < ONE
    })
}

/// Takes away what is unfinished where the program is interrupted, terminated or loses its terminal.
pub fn on_signals() -> anyhow::Result<()> {
    ctrlc::set_handler(|| {
        if tell_to_stop() {
            return;
        }
        tell_of_journal();
        end(AT_SIGNAL.load(Ordering::Relaxed))
    })
    .context("signals")
}

/// A thread that broke down.
struct Broken {
    thread: ThreadId,
    message: Option<String>,
    place: String,
}

/// The last places at which threads broke down, of each thread one.
static BROKEN: Mutex<Vec<Broken>> = Mutex::new(Vec::new());

/// Most threads of which that is kept.
const MOST_BROKEN: usize = 64;

/// Threads that go on beside the work, and of which it learns late or never: what breaks them down is told at once.
const BESIDE: [&str; 3] = ["live", "camera", "recording"];

/// Keeps where this thread breaks down.
fn keep(broken: &PanicHookInfo<'_>, place: String) {
    let thread = std::thread::current();
    if let Some(name) = thread.name().filter(|name| BESIDE.contains(name)) {
        errln!("handcast: the thread {name} {}", broke_down(&place));
    }
    let message = broken.payload_as_str().map(str::to_owned);
    let mut all = BROKEN.lock().unwrap_or_else(PoisonError::into_inner);
    all.retain(|broken| broken.thread != thread.id());
    if all.len() == MOST_BROKEN {
        all.remove(0);
    }
    all.push(Broken { thread: thread.id(), message, place });
}

/// Where what broke down did so, by what it brought with it. That may come from another thread which worked for this one.
pub fn place_of(payload: &(dyn Any + Send)) -> Option<String> {
    let words = payload.downcast_ref::<String>().map(String::as_str);
    let words = words.or_else(|| payload.downcast_ref::<&str>().copied());
    let mut all = BROKEN.lock().unwrap_or_else(PoisonError::into_inner);
    let thread = std::thread::current().id();
    let same = |broken: &Broken| broken.message.as_deref() == words;
    let own = all.iter().rposition(|broken| broken.thread == thread && same(broken));
    let at = own.or_else(|| all.iter().rposition(same))?;
    Some(all.remove(at).place)
}

/// Does the work; one that breaks down gives an error in place of a trace, built with `panic = "abort"` (where what a library
/// survives ends the program) too. `RUST_BACKTRACE` brings the trace back.
pub fn without_traces<T>(work: impl FnOnce() -> anyhow::Result<T>) -> anyhow::Result<T> {
    if std::env::var_os("RUST_BACKTRACE").is_some_and(|value| value != "0") {
        return work();
    }
    keep_places();
    catch_unwind(AssertUnwindSafe(work))
        .unwrap_or_else(|payload| anyhow::bail!(broke_down(&place_of(&*payload).unwrap_or_default())))
}

/// Has the places kept at which threads break down, in place of a trace.
fn keep_places() {
    set_hook(Box::new(|broken| {
        let place = broken.location().map_or_else(String::new, ToString::to_string);
        if cfg!(panic = "abort") {
            errln!("handcast: {}", broke_down(&place));
            end(1);
        }
        keep(broken, place);
    }));
}

fn broke_down(place: &str) -> String {
    format!("broke down at {place}, which is a fault of the program")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one() {
        panic!("one")
    }

    fn two() {
        panic!("two {}", 2)
    }

    /// The hook is the whole process's: one test for all that it does.
    #[test]
    fn each_thread_has_its_place() {
        keep_places();
        let other = std::thread::spawn(two).join().unwrap_err();
        let here = catch_unwind(one).unwrap_err();
        // What a thread broke down for may be another one.
        let [here, there, again] = std::thread::spawn(move || {
            let [here, there] = [&here, &other].map(|payload| place_of(&**payload));
            [here, there, place_of(&*other)]
        })
        .join()
        .unwrap();
        let _ = std::panic::take_hook();
        let [here, there] = [here, there].map(|place| {
            let place = place.unwrap();
            let line = place.replace('\\', "/").strip_prefix("src/cli/ending.rs:").unwrap().to_owned();
            line.split(':').next().unwrap().parse::<u32>().unwrap()
        });
        assert!(there > here && again.is_none(), "{here} {there} {again:?}");
    }
}
