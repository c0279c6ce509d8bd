//! Threads for work that is shared among cores, in processes that were forked as well.

use std::sync::OnceLock;

/// The process that imported the package: its pool of threads is there.
static HOME: OnceLock<u32> = OnceLock::new();

/// To be called at the import.
pub fn settle() {
    HOME.get_or_init(std::process::id);
}

/// Does work that may share itself among threads. In a process that was forked off there are none of those that it believes to
/// have, and it would wait for them for ever: there it gets some of its own.
pub fn with_threads<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    if HOME.get() == Some(&std::process::id()) {
        return work();
    }
    match rayon::ThreadPoolBuilder::new().build() {
        Ok(pool) => pool.install(work),
        Err(_) => work(),
    }
}
