//! One connection: its socket, what waits to be written, and how far it has come.

use std::io::{self, Read, Write};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tungstenite::protocol::{Role, WebSocketConfig, WebSocketContext};

use super::link::Link;
use crate::room::Following;
use crate::wire::{Expander, MAX_BYTES};

/// A reader with more than this waiting goes on with the next period.
pub(super) const MOST_WAITING: usize = 8 << 10;
/// A reader with more than this waiting is closed.
const TOO_MUCH: usize = 512 << 10;
/// Room for so many bytes is kept where none wait: messages of most planes.
const ROOM_KEPT: usize = 512;
/// Bytes of a body that wait at once.
const PIECE: usize = 16 << 10;
/// Bytes that the kernel is asked to keep of an answer: as much as that is under way at once. Of more it would not be seen soon
/// enough that a slow reader takes it.
const ANSWER_BUFFER: usize = 64 << 10;
/// And of messages, which grow old there when they are not read.
const SEND_BUFFER: usize = 8 << 10;
/// Bytes that a connection may send, all at once and a second.
const BURST: f64 = 128.0 * 1024.0;
const PER_SECOND: f64 = 32.0 * 1024.0;
/// Bytes that a message counts besides its own: handing it on to a crowd costs more than reading it. So many that 120 planes a
/// second, one by one, are within what may be sent.
const TURN: f64 = 192.0;

/// How far a connection has come.
pub(super) enum Stage {
    /// Its request is awaited.
    Request(Vec<u8>),
    /// It is answered, then closed.
    Answer,
    /// Messages go both ways.
    Open(Box<Open>),
}

/// What a connection with messages knows.
pub(super) struct Open {
    context: WebSocketContext,
    pub expander: Expander,
    pub following: Following,
    /// Its number as a sender.
    pub sender: Option<u8>,
    /// Whether it wanted to be one in vain: its planes are passed over.
    pub refused: bool,
    /// Whether it has said that it goes.
    pub parted: bool,
}

/// One connection.
pub(super) struct Client {
    pub link: Link,
    pub stage: Stage,
    /// What waits for the socket as it goes over it, from `written` on; then the rest of an answer.
    waiting: Vec<u8>,
    written: usize,
    body: Option<(Arc<[u8]>, usize)>,
    /// When it came, when something came from it, and since when nothing of what waits has been taken.
    pub since: Instant,
    pub heard: Instant,
    stuck: Option<Instant>,
    /// Bytes it may send now.
    allowance: f64,
    counted: Instant,
    /// To be closed once all is written.
    pub leaving: bool,
}

/// Bytes read, and what is answered to them, as WebSocket frames need them.
struct Side<'a> {
    read: &'a [u8],
    answers: Vec<u8>,
}

impl Read for Side<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.read.is_empty() {
            return Err(io::ErrorKind::WouldBlock.into());
        }
        self.read.read(buffer)
    }
}

impl Write for Side<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.answers.extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A binary WebSocket message of a server.
pub(super) fn frame(payload: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(payload.len() + 10);
    out.push(0x82);
    match (u8::try_from(payload.len()), u16::try_from(payload.len())) {
        (Ok(length @ ..126), _) => out.push(length),
        (_, Ok(length)) => {
            out.push(126);
            out.extend(length.to_be_bytes());
        }
        _ => {
            out.push(127);
            out.extend((payload.len() as u64).to_be_bytes());
        }
    }
    out.extend(payload);
    out
}

/// The rules are broken.
pub(super) fn broken(why: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, why)
}

/// A closing WebSocket frame of a server, with a code (RFC 6455, 7.4.1) and words for it.
fn closing(code: u16, why: &str) -> Vec<u8> {
    let why = why.get(..why.floor_char_boundary(LONGEST_REASON)).unwrap_or_default();
    let mut out = vec![0x88, 2 + why.len() as u8];
    out.extend(code.to_be_bytes());
    out.extend(why.as_bytes());
    out
}

/// The room ends; what came breaks the rules.
pub(super) const GOING_AWAY: u16 = 1001;
pub(super) const PROTOCOL_ERROR: u16 = 1002;
/// Bytes of the words at most.
const LONGEST_REASON: usize = 123;

impl Client {
    pub fn new(mut link: Link, now: Instant) -> Self {
        link.keep(ANSWER_BUFFER);
        Self {
            link,
            stage: Stage::Request(Vec::new()),
            waiting: Vec::new(),
            written: 0,
            body: None,
            since: now,
            heard: now,
            stuck: None,
            allowance: BURST,
            counted: now,
            leaving: false,
        }
    }

    /// Whether it is no connection with messages yet.
    pub fn is_young(&self) -> bool {
        !matches!(self.stage, Stage::Open(_))
    }

    /// Since when it does not go on, where it is no connection with messages yet: a request is one step, however slowly it
    /// comes.
    pub fn idle_since(&self) -> Instant {
        match self.stage {
            Stage::Answer => self.stuck.unwrap_or(self.since),
            _ => self.since,
        }
    }

    /// Reads what has come, at most `buffer` at once; none when there is no more for the moment.
    ///
    /// # Errors
    /// The connection is at its end, or sends more than it may.
    pub fn read<'a>(&mut self, buffer: &'a mut [u8], now: Instant) -> io::Result<Option<&'a [u8]>> {
        let count = match self.link.read(buffer, &mut self.waiting) {
            // One that asks no more may still take its answer.
            Ok(0) if matches!(self.stage, Stage::Answer) => return Ok(None),
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(count) => count,
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(None),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => 0,
            Err(error) => return Err(error),
        };
        let passed = now.duration_since(self.counted).as_secs_f64();
        self.counted = now;
        self.allowance = (self.allowance + passed * PER_SECOND).min(BURST) - count as f64;
        self.check_allowance()?;
        Ok(buffer.get(..count))
    }

    /// Counts messages against what it may send.
    ///
    /// # Errors
    /// They are more than it may send.
    pub fn charge(&mut self, messages: usize) -> io::Result<()> {
        self.allowance -= messages as f64 * TURN;
        self.check_allowance()
    }

    fn check_allowance(&self) -> io::Result<()> {
        if self.allowance < 0.0 {
            return Err(broken("more than it may send"));
        }
        Ok(())
    }

    /// Becomes a connection with messages, the first bytes of which may have come, behind an answer that says so.
    ///
    /// # Errors
    /// As of [`Self::messages`].
    pub fn open(&mut self, head: &str, first: &[u8]) -> io::Result<Vec<Vec<u8>>> {
        self.link.keep(SEND_BUFFER);
        self.queue(head.as_bytes())?;
        let config = WebSocketConfig::default()
            .read_buffer_size(1024)
            .write_buffer_size(0)
            .max_write_buffer_size(64 << 10)
            .max_message_size(Some(MAX_BYTES))
            .max_frame_size(Some(MAX_BYTES));
        let context = WebSocketContext::new(Role::Server, Some(config));
        self.stage = Stage::Open(Box::new(Open {
            context,
            expander: Expander::default(),
            following: Following::default(),
            sender: None,
            refused: false,
            parted: false,
        }));
        self.messages(first)
    }

    /// The binary messages that bytes make.
    ///
    /// # Errors
    /// It closes, or breaks the rules.
    pub fn messages(&mut self, bytes: &[u8]) -> io::Result<Vec<Vec<u8>>> {
        let Stage::Open(open) = &mut self.stage else { return Ok(Vec::new()) };
        let mut side = Side { read: bytes, answers: Vec::new() };
        let mut found = Vec::new();
        loop {
            match open.context.read(&mut side) {
                Ok(tungstenite::Message::Binary(payload)) => found.push(payload.to_vec()),
                Ok(tungstenite::Message::Text(_)) => return Err(broken("messages of text are none")),
                Ok(tungstenite::Message::Close(_)) => open.parted = true,
                Ok(_) => {}
                Err(tungstenite::Error::Io(error)) if error.kind() == io::ErrorKind::WouldBlock => break,
                // It has said that it goes, and is answered.
                Err(tungstenite::Error::ConnectionClosed) => {
                    self.leaving = true;
                    break;
                }
                Err(error) => return Err(broken(error)),
            }
        }
        // Answers to pings.
        match open.context.flush(&mut side) {
            _ if self.leaving => {}
            Err(tungstenite::Error::ConnectionClosed) => self.leaving = true,
            flushed => flushed.map_err(io::Error::other)?,
        }
        self.queue(&side.answers)?;
        self.check_waiting()?;
        Ok(found)
    }

    /// Bytes that wait to be written.
    pub fn waiting(&self) -> usize {
        self.waiting.len() - self.written
    }

    /// # Errors
    /// Too much waits.
    fn check_waiting(&self) -> io::Result<()> {
        if self.waiting() > TOO_MUCH {
            return Err(io::Error::other("too much waits"));
        }
        Ok(())
    }

    /// Adds bytes to what waits.
    ///
    /// # Errors
    /// The connection is at its end.
    pub fn queue(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.link.seal(bytes, &mut self.waiting)
    }

    /// Adds an answer to what waits, its body last; the connection closes behind it.
    ///
    /// # Errors
    /// The connection is at its end.
    pub fn answer(&mut self, head: &str, body: Arc<[u8]>) -> io::Result<()> {
        self.queue(head.as_bytes())?;
        self.body = Some((body, 0));
        self.stage = Stage::Answer;
        self.leaving = true;
        Ok(())
    }

    /// Writes a frame at once if nothing waits; what is left waits.
    ///
    /// # Errors
    /// The connection is at its end, or too much waits.
    pub fn send(&mut self, frame: &[u8], now: Instant) -> io::Result<()> {
        let waits = self.waiting() > 0;
        self.queue(frame)?;
        if !waits {
            self.flush(now)?;
        }
        self.check_waiting()
    }

    /// Says to one with messages why it is left, as far as it listens.
    pub fn part(&mut self, code: u16, why: &str, now: Instant) {
        if !self.is_young() {
            self.leaving = true;
            let _ = self.queue(&closing(code, why)).and_then(|()| self.flush(now));
        }
    }

    /// Writes what waits, as far as it is taken.
    ///
    /// # Errors
    /// The connection is at its end.
    pub fn flush(&mut self, now: Instant) -> io::Result<()> {
        let done = self.write_waiting();
        self.stuck = match (&done, self.is_done()) {
            (_, true) => None,
            (Ok(true), false) => Some(now),
            _ => Some(self.stuck.unwrap_or(now)),
        };
        done.map(|_| ())
    }

    /// Whether anything was taken.
    fn write_waiting(&mut self) -> io::Result<bool> {
        let mut any = false;
        loop {
            if self.waiting() == 0 {
                self.waiting.clear();
                self.written = 0;
                self.refill()?;
            }
            let Some(rest) = self.waiting.get(self.written..).filter(|rest| !rest.is_empty()) else { break };
            match self.link.socket().write(rest) {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(count) => self.written += count,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(any),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => return Err(error),
            }
            any = true;
            if self.written > MOST_WAITING {
                self.waiting.drain(..self.written);
                self.written = 0;
            }
        }
        self.waiting.shrink_to(ROOM_KEPT);
        Ok(any)
    }

    /// Where nothing waits: the next piece of the body, or, behind everything, that nothing comes any more.
    fn refill(&mut self) -> io::Result<()> {
        let Some((body, at)) = self.body.take() else {
            if self.leaving {
                self.link.seal_end(&mut self.waiting)?;
            }
            return Ok(());
        };
        let end = body.len().min(at + PIECE);
        self.queue(body.get(at..end).unwrap_or_default())?;
        self.body = (end < body.len()).then_some((body, end));
        Ok(())
    }

    /// Whether all is written.
    pub fn is_done(&self) -> bool {
        self.waiting() == 0 && self.body.is_none()
    }

    /// Whether nothing of what waits has been taken for so long.
    pub fn is_stuck(&self, now: Instant, patience: Duration) -> bool {
        self.stuck.is_some_and(|since| now.duration_since(since) > patience)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_of_which_nothing_is_taken_is_stuck() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let mut reader = std::net::TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let (socket, _) = listener.accept().unwrap();
        socket.set_nonblocking(true).unwrap();
        let (begun, second) = (Instant::now(), Duration::from_secs(1));
        let after = |seconds: u32| begun + seconds * second;
        let mut client = Client::new(Link::new(mio::net::TcpStream::from_std(socket)), begun);
        client.answer("head", Arc::from(vec![7; 64 << 20])).unwrap();
        // Until the kernel takes no more.
        for _ in 0..100 {
            client.flush(begun).unwrap();
            std::thread::sleep(Duration::from_millis(1));
        }
        client.flush(after(5)).unwrap();
        assert!(!client.is_done() && !client.is_stuck(after(5), 20 * second));
        assert_eq!(client.idle_since(), begun);
        assert!(client.is_stuck(after(21), 20 * second));
        let mut piece = vec![0; 1 << 20];
        let mut taken = 0;
        while client.idle_since() == begun {
            taken += reader.read(&mut piece).unwrap();
            assert!(taken < 64 << 20, "{taken} are read, and nothing is taken");
            client.flush(after(21)).unwrap();
        }
        assert!(!client.is_stuck(after(41), 20 * second) && client.is_stuck(after(42), 20 * second));
        while !client.is_done() {
            client.flush(after(42)).unwrap();
            if !client.is_done() {
                assert!(reader.read(&mut piece).unwrap() > 0);
            }
        }
        assert!(!client.is_stuck(after(99), 20 * second));
    }
}
