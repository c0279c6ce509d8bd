//! Standard output. A reader that closes its end, as `head` does, has had enough: the program then ends
//! quietly, with exit code 0.

use std::fmt::Arguments;
use std::io::{self, ErrorKind, Write};

use super::ending::end;

/// Standard output.
#[derive(Clone, Copy, Debug)]
pub struct Stdout;

fn unless_closed<T>(result: io::Result<T>) -> io::Result<T> {
    if matches!(&result, Err(error) if error.kind() == ErrorKind::BrokenPipe) {
        end(0);
    }
    result
}

impl Write for Stdout {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        unless_closed(io::stdout().lock().write(bytes))
    }

    fn flush(&mut self) -> io::Result<()> {
        unless_closed(io::stdout().lock().flush())
    }
}

/// Prints; what cannot be written ends the program with exit code 1.
pub fn print(text: Arguments<'_>) {
    if let Err(error) = Stdout.write_fmt(text) {
        say(format_args!("handcast: standard output: {error}"));
        end(1);
    }
}

/// Says something on standard error; where nobody can be told the work goes on.
pub fn say(text: Arguments<'_>) {
    let _ = io::stderr().lock().write_fmt(format_args!("{text}\n"));
}

/// `eprintln!` that never fails.
macro_rules! errln {
    ($($text:tt)*) => { $crate::cli::out::say(format_args!($($text)*)) };
}

/// `print!` to [`Stdout`].
macro_rules! out {
    ($($text:tt)*) => { $crate::cli::out::print(format_args!($($text)*)) };
}

/// `println!` to [`Stdout`].
macro_rules! outln {
    () => { $crate::cli::out::print(format_args!("\n")) };
    ($($text:tt)*) => { $crate::cli::out::print(format_args!("{}\n", format_args!($($text)*))) };
}
