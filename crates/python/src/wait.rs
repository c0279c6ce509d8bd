//! Work that Ctrl-C ends the wait for.

use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::Duration;

use pyo3::prelude::*;

use crate::threads::with_threads;

/// Between two looks at Python's signals.
const EVERY: Duration = Duration::from_millis(50);

/// Does work without Python's lock, on a thread of its own. A signal that Python raises for ends the wait at once; the
/// work, which cannot be stopped, goes on unheard.
pub fn apart<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce() -> PyResult<T> + Send + 'static,
) -> PyResult<T> {
    py.detach(move || {
        let (done, result) = sync_channel(1);
        let worker = std::thread::Builder::new().spawn(move || {
            // Nobody hears of it after a signal.
            let _ = done.send(with_threads(work));
        })?;
        loop {
            match result.recv_timeout(EVERY) {
                Ok(result) => return result,
                Err(RecvTimeoutError::Timeout) => Python::attach(|py| py.check_signals())?,
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        // It panicked, and so does this.
        match worker.join() {
            Err(panic) => std::panic::resume_unwind(panic),
            Ok(()) => Err(crate::Error::new_err("the work gave no result")),
        }
    })
}
