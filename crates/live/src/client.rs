//! A connection to a room from a program: it sends, or reads, or both.

use std::collections::VecDeque;
use std::io;
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

use tungstenite::protocol::WebSocketConfig;
use tungstenite::{ClientRequestBuilder, WebSocket};

use crate::transport::{Hello, Publish, Subscribe, TransportError};
use crate::wire::{Expander, MAX_BYTES, MAX_SENDERS, Message, Plane, Refusal, Shortener, in_messages};

/// Longest wait for the server's answers.
const ANSWER: Duration = Duration::from_secs(10);
/// Something is said at least so often, where one reads.
const SILENCE: Duration = Duration::from_secs(3);

/// Messages that wait for their reader at most: eight seconds of a full room.
const MOST_WAITING: usize = 4096;

/// What has come and waits to be read. Of one who sends and does not read it keeps the last announcement of each sender.
#[derive(Debug, Default)]
struct Inbox {
    messages: VecDeque<Message>,
    /// Whether there is a reader.
    read: bool,
    /// Senders of whom planes were passed over: they go on with the next period.
    gaps: [bool; MAX_SENDERS as usize],
}

impl Inbox {
    fn put(&mut self, message: Message) {
        if self.messages.len() >= MOST_WAITING {
            let gaps = &mut self.gaps;
            self.messages.retain(|message| match message {
                Message::Plane(plane) => {
                    gaps[usize::from(plane.sender % MAX_SENDERS)] = true;
                    false
                }
                message => message.sender().is_some(),
            });
            self.read = false;
        }
        match &message {
            Message::Plane(plane) => {
                let gap = &mut self.gaps[usize::from(plane.sender % MAX_SENDERS)];
                *gap = !self.read || *gap && !plane.opens();
                if *gap {
                    return;
                }
            }
            other if !self.read => {
                let Some(sender) = other.sender() else { return };
                self.messages.retain(|before| before.sender() != Some(sender));
            }
            _ => {}
        }
        self.messages.push_back(message);
    }
}

/// A connection to the room of an embedded server, without TLS.
///
/// A room tells a sender its own planes, too. Of one who never asks for the next message no planes are kept.
#[derive(Debug)]
pub struct RoomClient {
    socket: WebSocket<TcpStream>,
    expander: Expander,
    shortener: Shortener,
    inbox: Inbox,
    wants_intra: bool,
    /// Why nothing can be read any more, until somebody is told.
    failed: Option<TransportError>,
    /// Number as a sender.
    number: Option<u8>,
    /// When something was said last.
    said: Instant,
}

impl RoomClient {
    /// Connects to a room.
    ///
    /// # Errors
    /// Nobody is there, or the room does not let this one in.
    pub fn connect(server: impl ToSocketAddrs, room: &str, token: &str) -> Result<Self, TransportError> {
        let mut last = io::Error::new(io::ErrorKind::NotFound, "no address");
        for address in server.to_socket_addrs()? {
            match TcpStream::connect_timeout(&address, ANSWER) {
                Ok(socket) => return Self::open(socket, &address.to_string(), room, token),
                Err(error) => last = error,
            }
        }
        Err(last.into())
    }

    fn open(socket: TcpStream, host: &str, room: &str, token: &str) -> Result<Self, TransportError> {
        socket.set_nodelay(true)?;
        socket.set_read_timeout(Some(ANSWER))?;
        socket.set_write_timeout(Some(ANSWER))?;
        let refused = |why: String| TransportError::Refused { why };
        let uri = format!("ws://{host}/{room}/live?token={token}").parse();
        let uri = uri.map_err(|error| refused(format!("{host}/{room}: {error}")))?;
        let config = WebSocketConfig::default()
            .read_buffer_size(4096)
            .write_buffer_size(0)
            .max_message_size(Some(4 * MAX_BYTES))
            .max_frame_size(Some(4 * MAX_BYTES));
        let request = ClientRequestBuilder::new(uri);
        let (socket, _) = tungstenite::client::client_with_config(request, socket, Some(config))
            .map_err(|error| refused(error.to_string()))?;
        Ok(Self {
            socket,
            expander: Expander::default(),
            shortener: Shortener::default(),
            inbox: Inbox::default(),
            wants_intra: false,
            failed: None,
            number: None,
            said: Instant::now(),
        })
    }

    /// Says something.
    ///
    /// # Errors
    /// The connection is closed.
    pub fn say(&mut self, bytes: Vec<u8>) -> Result<(), TransportError> {
        self.said = Instant::now();
        self.socket.send(tungstenite::Message::Binary(bytes.into())).map_err(closed)
    }

    /// Its socket, without what has been read ahead.
    pub(crate) fn into_socket(self) -> TcpStream {
        self.socket.into_inner()
    }

    /// Number as a sender, once the room has given one.
    pub fn number(&self) -> Option<u8> {
        self.number
    }

    /// Reads a message that comes within `wait`; false if none has. So that the room does not take it for gone, it
    /// says something now and then.
    fn read(&mut self, wait: Duration) -> Result<bool, TransportError> {
        if self.said.elapsed() > SILENCE {
            self.say(Message::Ping { mark: 0 }.bytes())?;
        }
        let wait = wait.min(SILENCE);
        self.socket.get_ref().set_read_timeout(Some(wait.max(Duration::from_micros(100))))?;
        match self.socket.read() {
            Ok(tungstenite::Message::Binary(bytes)) => {
                for message in self.expander.read_all(&bytes)? {
                    match message {
                        Message::Welcome { sender } => self.number = Some(sender),
                        Message::Intra { .. } => self.wants_intra = true,
                        Message::Refused { refusal } => {
                            let why = match refusal {
                                Refusal::Closed => "the room takes no senders",
                                Refusal::Full => "the room has no place for a further sender",
                            };
                            return Err(TransportError::Refused { why: why.to_owned() });
                        }
                        other => self.inbox.put(other),
                    }
                }
                Ok(true)
            }
            Ok(tungstenite::Message::Close(Some(frame))) if !frame.reason.is_empty() => {
                Err(TransportError::Closed { why: frame.reason.to_string() })
            }
            Ok(_) => Ok(true),
            Err(tungstenite::Error::Io(error))
                if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) =>
            {
                Ok(false)
            }
            Err(error) => Err(closed(error)),
        }
    }
}

fn closed(error: tungstenite::Error) -> TransportError {
    match error {
        tungstenite::Error::Io(error) => error.into(),
        other => TransportError::Closed { why: other.to_string() },
    }
}

impl Subscribe for RoomClient {
    fn next(&mut self, wait: Duration) -> Result<Option<Message>, TransportError> {
        self.inbox.read = true;
        let end = Instant::now() + wait;
        loop {
            if let Some(message) = self.inbox.messages.pop_front() {
                return Ok(Some(message));
            }
            if let Some(error) = self.failed.take() {
                return Err(error);
            }
            let left = end.saturating_duration_since(Instant::now());
            self.read(left)?;
            if self.inbox.messages.is_empty() && Instant::now() >= end {
                return Ok(None);
            }
        }
    }

    fn request_intra(&mut self, sender: u8) -> Result<(), TransportError> {
        self.say(Message::Intra { sender }.bytes())
    }
}

impl Publish for RoomClient {
    fn hello(&mut self, hello: &Hello) -> Result<(), TransportError> {
        let Hello { hands, record } = hello.clone();
        self.say(Message::Hello { sender: 0, hands, record }.bytes())?;
        let end = Instant::now() + ANSWER;
        while self.number.is_none() {
            if Instant::now() > end {
                return Err(TransportError::Refused { why: "the room gives no number".into() });
            }
            self.read(Duration::from_millis(50))?;
        }
        Ok(())
    }

    fn planes(&mut self, planes: &[Plane]) -> Result<(), TransportError> {
        if let Some(error) = self.failed.take() {
            return Err(error);
        }
        let planes: Vec<Plane> = planes.iter().map(|plane| Plane { sender: 0, ..plane.clone() }).collect();
        for together in in_messages(&planes) {
            let mut bytes = Vec::new();
            self.shortener.write_together(together, &mut bytes);
            self.say(bytes)?;
        }
        Ok(())
    }

    fn wants_intra(&mut self) -> bool {
        // What has come is looked at without waiting for more; what is wrong with it, the next planes are told.
        while self.failed.is_none() {
            match self.read(Duration::ZERO) {
                Ok(true) => {}
                Ok(false) => break,
                Err(error) => self.failed = Some(error),
            }
        }
        std::mem::take(&mut self.wants_intra)
    }

    fn end(&mut self) -> Result<(), TransportError> {
        self.number = None;
        self.say(Message::End { sender: 0, parting: crate::wire::Parting::Left }.bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(sender: u8, period: u16, index: u16) -> Message {
        Message::Plane(Plane { sender, period, index, ..Plane::default() })
    }

    fn hello(sender: u8, right: bool) -> Message {
        Message::Hello { sender, hands: [false, right], record: Vec::new() }
    }

    #[test]
    fn who_does_not_read_keeps_announcements_alone() {
        let mut inbox = Inbox::default();
        for n in 0..5000 {
            inbox.put(hello(n as u8 % 2, n > 2500));
            inbox.put(plane(0, n, 0));
            inbox.put(plane(0, n, 1));
            inbox.put(Message::Pong { mark: 0, clock_us: 0 });
        }
        assert_eq!(inbox.messages, [hello(0, true), hello(1, true)]);
        inbox.read = true;
        inbox.put(plane(0, 5000, 1));
        inbox.put(plane(0, 5001, 0));
        assert_eq!(inbox.messages.split_off(2), [plane(0, 5001, 0)], "from the next period on");
    }

    #[test]
    fn a_reader_that_comes_no_more_is_forgotten() {
        let mut inbox = Inbox { read: true, ..Inbox::default() };
        for n in 0..3 * MOST_WAITING {
            inbox.put(plane(3, 0, n as u16));
            assert!(inbox.messages.len() <= MOST_WAITING);
        }
        inbox.read = true;
        inbox.put(plane(3, 0, 9));
        assert!(inbox.messages.is_empty(), "{}", inbox.messages.len());
        inbox.put(plane(3, 1, 0));
        assert_eq!(inbox.messages, [plane(3, 1, 0)]);
    }
}
