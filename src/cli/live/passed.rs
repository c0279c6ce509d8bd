//! What goes into a pipe while a room goes on, which waits for nobody who reads.

use std::io::{self, Write};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Pieces that wait at most, beside what the pipe itself holds: more than a minute of planes.
const WAITING: usize = 2048;
/// How long a pipe of which nothing is read is waited for at the end.
const PATIENCE: Duration = Duration::from_secs(5);
/// How often it is looked whether something has been read.
const LOOK: Duration = Duration::from_millis(5);

/// The writing end, with a thread of its own that may be held up.
pub struct Passed {
    /// None once no more is taken.
    pieces: Option<SyncSender<Vec<u8>>>,
    thread: Option<JoinHandle<()>>,
    written: Arc<AtomicUsize>,
    /// Why the thread has ended before the rest.
    failed: Arc<Mutex<Option<io::Error>>>,
}

impl Passed {
    /// Begins to write.
    pub fn new(mut into: Box<dyn Write + Send>) -> io::Result<Self> {
        let (pieces, taken) = sync_channel::<Vec<u8>>(WAITING);
        let (written, failed) = (Arc::new(AtomicUsize::new(0)), Arc::new(Mutex::new(None)));
        let (count, error) = (Arc::clone(&written), Arc::clone(&failed));
        let work = move || {
            for piece in taken {
                if let Err(why) = into.write_all(&piece).and_then(|()| into.flush()) {
                    *error.lock().unwrap_or_else(PoisonError::into_inner) = Some(why);
                    return;
                }
                count.fetch_add(1, Ordering::Relaxed);
            }
        };
        let thread = std::thread::Builder::new().name("recording".into()).spawn(work)?;
        Ok(Self { pieces: Some(pieces), thread: Some(thread), written, failed })
    }

    /// Adds a piece, and waits for nothing. After an error no more is taken.
    pub fn add(&mut self, piece: &[u8]) -> io::Result<()> {
        let Some(pieces) = &self.pieces else { return Err(unread()) };
        let outcome = pieces.try_send(piece.to_vec());
        if outcome.is_err() {
            self.pieces = None;
            if matches!(outcome, Err(TrySendError::Full(_))) {
                // What waits is written if somebody reads on; nobody waits for that.
                self.thread = None;
            }
        }
        match outcome {
            Ok(()) => Ok(()),
            Err(TrySendError::Full(_)) => Err(unread()),
            Err(TrySendError::Disconnected(_)) => self.outcome(),
        }
    }

    fn outcome(&self) -> io::Result<()> {
        self.failed.lock().unwrap_or_else(PoisonError::into_inner).take().map_or(Ok(()), Err)
    }

    /// Waits until all that was taken is written, as long as it is read.
    pub fn finish(&mut self) -> io::Result<()> {
        self.pieces = None;
        let Some(thread) = self.thread.take() else { return Ok(()) };
        let (mut before, mut since) = (self.written.load(Ordering::Relaxed), Instant::now());
        while !thread.is_finished() {
            let now = self.written.load(Ordering::Relaxed);
            if now != before {
                (before, since) = (now, Instant::now());
            } else if since.elapsed() > PATIENCE {
                return Err(unread());
            }
            std::thread::sleep(LOOK);
        }
        self.outcome()
    }
}

fn unread() -> io::Error {
    io::Error::new(io::ErrorKind::TimedOut, "what is in the pipe is not read")
}

#[cfg(test)]
mod tests {
    use std::io::Read as _;

    use super::*;

    /// Pieces until one is not taken; no piece waits for the reader, who then gets all that were taken.
    #[test]
    fn a_pipe_that_nobody_reads_holds_nobody_up() {
        let (mut reader, writer) = io::pipe().unwrap();
        let mut passed = Passed::new(Box::new(writer)).unwrap();
        let begun = Instant::now();
        let taken = (0u32..10_000).take_while(|n| passed.add(&n.to_be_bytes().repeat(64)).is_ok()).count();
        assert!((WAITING..10_000).contains(&taken), "{taken}");
        assert!(passed.add(&[1]).is_err() && passed.finish().is_ok());
        assert!(begun.elapsed() < PATIENCE);
        let mut read = Vec::new();
        reader.read_to_end(&mut read).unwrap();
        let expected: Vec<u8> = (0..taken as u32).flat_map(|n| n.to_be_bytes().repeat(64)).collect();
        assert!(read == expected, "{} bytes of {}", read.len(), expected.len());
    }

    #[test]
    fn what_is_read_late_is_waited_for_and_what_is_not_is_told() {
        let (mut reader, writer) = io::pipe().unwrap();
        let mut passed = Passed::new(Box::new(writer)).unwrap();
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
        let mut passed = Passed::new(Box::new(writer)).unwrap();
        passed.add(&piece).unwrap();
        assert_eq!(passed.finish().unwrap_err().kind(), io::ErrorKind::TimedOut);
        drop(reader);
    }

    #[test]
    fn a_reader_that_leaves_is_told() {
        let (reader, writer) = io::pipe().unwrap();
        let mut passed = Passed::new(Box::new(writer)).unwrap();
        drop(reader);
        let told = (0..1000).find_map(|_| {
            std::thread::sleep(LOOK);
            passed.add(&[1]).err()
        });
        assert_eq!(told.unwrap().kind(), io::ErrorKind::BrokenPipe);
        assert!(passed.finish().is_ok());
    }
}
