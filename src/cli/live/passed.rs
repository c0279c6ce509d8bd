//! What goes into a pipe while a room goes on, which waits for nobody who reads.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Pieces that wait at most, beside what the pipe itself holds: 68 s of planes, 30 a second.
const WAITING: usize = 2048;
/// How long a pipe that takes no piece is waited for at the end. A full one takes more only when a whole page of it, 4096
/// bytes on Linux, has been read, which at the pace of a hand's planes (0.5 kB/s) is every eight seconds.
const PATIENCE: Duration = Duration::from_secs(30);
/// How often it is looked whether something has been read.
const LOOK: Duration = Duration::from_millis(5);
/// How long is waited without a word.
const SILENT: Duration = Duration::from_millis(500);

/// Where a recording goes on being read.
pub struct Pipe {
    pub name: String,
    pub into: Box<dyn Write + Send>,
    /// Whether it is not said that it is waited for.
    pub quiet: bool,
}

/// The writing end, with a thread of its own that may be held up.
pub struct Passed {
    name: String,
    quiet: bool,
    patience: Duration,
    /// None once no more is taken.
    pieces: Option<SyncSender<Vec<u8>>>,
    /// None once it has been told how it ended.
    thread: Option<JoinHandle<io::Result<()>>>,
    written: Arc<AtomicUsize>,
}

impl Passed {
    /// Begins to write.
    pub fn new(Pipe { name, mut into, quiet }: Pipe) -> io::Result<Self> {
        let (pieces, taken) = sync_channel::<Vec<u8>>(WAITING);
        let written = Arc::new(AtomicUsize::new(0));
        let count = Arc::clone(&written);
        let work = move || {
            for piece in taken {
                into.write_all(&piece).and_then(|()| into.flush())?;
                count.fetch_add(1, Ordering::Relaxed);
            }
            Ok(())
        };
        let thread = std::thread::Builder::new().name("recording".into()).spawn(work)?;
        Ok(Self { name, quiet, patience: PATIENCE, pieces: Some(pieces), thread: Some(thread), written })
    }

    pub fn name(&self) -> &str {
        &self.name
    }

    /// Adds a piece, and waits for nothing. After an error no more is taken; what waits is written as it is read.
    pub fn add(&mut self, piece: &[u8]) -> io::Result<()> {
        let Some(pieces) = &self.pieces else { return Err(full()) };
        let outcome = pieces.try_send(piece.to_vec());
        if outcome.is_err() {
            self.pieces = None;
        }
        match outcome {
            Ok(()) => Ok(()),
            Err(TrySendError::Full(_)) => Err(full()),
            // It goes on as long as there may be pieces: it failed.
            Err(TrySendError::Disconnected(_)) => self.outcome().and_then(|()| Err(broken())),
        }
    }

    /// How the thread ended, once.
    fn outcome(&mut self) -> io::Result<()> {
        let Some(thread) = self.thread.take() else { return Ok(()) };
        thread.join().unwrap_or_else(|_| Err(broken()))
    }

    /// Waits until all that was taken is written, as long as the pipe takes more of it.
    pub fn finish(&mut self) -> io::Result<()> {
        self.pieces = None;
        let begun = Instant::now();
        let (mut before, mut since) = (self.written.load(Ordering::Relaxed), begun);
        let mut silent = !self.quiet;
        while self.thread.as_ref().is_some_and(|thread| !thread.is_finished()) {
            let now = self.written.load(Ordering::Relaxed);
            if now != before {
                (before, since) = (now, Instant::now());
            } else if since.elapsed() > self.patience {
                let seconds = self.patience.as_secs();
                let why = format!("in {seconds} s nothing more was read; what waits in it is lost");
                return Err(io::Error::new(io::ErrorKind::TimedOut, why));
            }
            if silent && begun.elapsed() > SILENT {
                silent = false;
                errln!("waiting until {} has been read", self.name);
            }
            std::thread::sleep(LOOK);
        }
        self.outcome()
    }
}

fn full() -> io::Error {
    let why = format!("nobody reads it: {WAITING} planes wait, which is the most");
    io::Error::new(io::ErrorKind::TimedOut, why)
}

fn broken() -> io::Error {
    io::Error::other("the thread that writes it broke down")
}

#[cfg(test)]
mod tests {
    use std::io::Read as _;

    use super::*;

    fn passed(into: impl Write + Send + 'static) -> Passed {
        Passed::new(Pipe { name: "a pipe".into(), into: Box::new(into), quiet: true }).unwrap()
    }

    /// Pieces until one is not taken; no piece waits for the reader, who then gets all that were taken, however the program
    /// ends: it waits for that.
    #[test]
    fn a_pipe_that_nobody_reads_holds_nobody_up() {
        let (mut reader, writer) = io::pipe().unwrap();
        let mut passed = passed(writer);
        let begun = Instant::now();
        let taken = (0u32..10_000).take_while(|n| passed.add(&n.to_be_bytes().repeat(64)).is_ok()).count();
        assert!((WAITING..10_000).contains(&taken), "{taken}");
        assert!(passed.add(&[1]).unwrap_err().to_string().contains("2048 planes wait"));
        assert!(begun.elapsed() < Duration::from_secs(5));
        let late = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(200));
            let mut read = Vec::new();
            reader.read_to_end(&mut read).map(|_| read)
        });
        passed.finish().unwrap();
        let read = late.join().unwrap().unwrap();
        let expected: Vec<u8> = (0..taken as u32).flat_map(|n| n.to_be_bytes().repeat(64)).collect();
        assert!(read == expected, "{} bytes of {}", read.len(), expected.len());
    }

    #[test]
    fn what_is_read_late_is_waited_for_and_what_is_not_is_told() {
        let (mut reader, writer) = io::pipe().unwrap();
        let mut passed = passed(writer);
        let piece = vec![7; 1 << 20];
        passed.add(&piece).unwrap();
        let late = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(200));
            let mut read = Vec::new();
            reader.read_to_end(&mut read).map(|_| read)
        });
        passed.finish().unwrap();
        assert!(late.join().unwrap().unwrap() == piece);
        let (reader, writer) = io::pipe().unwrap();
        let mut passed = self::passed(writer);
        passed.patience = Duration::from_millis(100);
        passed.add(&piece).unwrap();
        assert_eq!(passed.finish().unwrap_err().kind(), io::ErrorKind::TimedOut);
        drop(reader);
    }

    #[test]
    fn a_reader_that_leaves_is_told() {
        let (reader, writer) = io::pipe().unwrap();
        let mut passed = passed(writer);
        drop(reader);
        let told = (0..1000).find_map(|_| {
            std::thread::sleep(LOOK);
            passed.add(&[1]).err()
        });
        assert_eq!(told.unwrap().kind(), io::ErrorKind::BrokenPipe);
        assert!(passed.finish().is_ok());
    }

    /// Breaks down at the first piece.
    struct Faulty;

    impl Write for Faulty {
        fn write(&mut self, _: &[u8]) -> io::Result<usize> {
            panic!("on purpose")
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_thread_that_breaks_down_is_no_success() {
        let mut at_the_end = passed(Faulty);
        at_the_end.add(&[1]).unwrap();
        assert!(at_the_end.finish().unwrap_err().to_string().contains("broke down"));
        let mut before = passed(Faulty);
        let told = (0..1000).find_map(|_| {
            std::thread::sleep(LOOK);
            before.add(&[1]).err()
        });
        assert!(told.unwrap().to_string().contains("broke down") && before.finish().is_ok());
    }
}
