//! Files and folders that are to be gone when the program ends early.
//!
//! Dropping them takes them away; a program that is told to end by a signal, or that ends itself, calls [`remove_all`].

use std::collections::BTreeMap;
use std::io;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// What is taken away.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Kind {
    /// A file.
    File,
    /// A folder with all that is in it.
    Folder,
    /// A folder, if nothing is in it.
    EmptyFolder,
}

/// What there is, by number.
#[derive(Debug, Default)]
struct Register {
    next: u64,
    entries: BTreeMap<u64, (Kind, PathBuf)>,
}

static REGISTER: Mutex<Register> = Mutex::new(Register { next: 0, entries: BTreeMap::new() });

fn register() -> MutexGuard<'static, Register> {
    // A thread that broke down has left entries, not a broken map.
    REGISTER.lock().unwrap_or_else(PoisonError::into_inner)
}

/// An entry among what is unfinished, until it is dropped.
#[derive(Debug)]
pub struct Unfinished {
    number: Option<u64>,
}

impl Unfinished {
    /// Makes something by `make` and takes it down, so that it cannot be forgotten between the two; `path` says where it
    /// is.
    pub fn made<T>(
        kind: Kind,
        make: impl FnOnce() -> io::Result<T>,
        path: impl FnOnce(&T) -> PathBuf,
    ) -> (io::Result<T>, Self) {
        let mut register = register();
        let made = make();
        let number = made.as_ref().ok().map(|made| {
            let number = register.next;
            register.next += 1;
            register.entries.insert(number, (kind, path(made)));
            number
        });
        (made, Self { number })
    }

    /// Takes it down as finished while `finish` finishes it.
    pub fn done<T>(mut self, finish: impl FnOnce() -> T) -> T {
        let mut register = register();
        let finished = finish();
        if let Some(number) = self.number.take() {
            register.entries.remove(&number);
        }
        finished
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        if let Some(number) = self.number {
            register().entries.remove(&number);
        }
    }
}

/// Takes away all that is unfinished, and ends the program by `end`; until then nothing can be begun or finished.
pub fn remove_all(end: impl FnOnce() -> std::convert::Infallible) -> std::convert::Infallible {
    let mut register = register();
    // A folder comes after what was made in it.
    for (kind, path) in std::mem::take(&mut register.entries).into_values().rev() {
        // Nothing can be done about what stays.
        let _ = match kind {
            Kind::File => std::fs::remove_file(path),
            Kind::Folder => std::fs::remove_dir_all(path),
            Kind::EmptyFolder => std::fs::remove_dir(path),
        };
    }
    end()
}
