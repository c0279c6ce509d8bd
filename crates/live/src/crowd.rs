//! Many readers of a room on one thread, to measure with.

use std::io::{self, Read};
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use mio::net::TcpStream;
use mio::{Events, Interest, Poll, Token};

use crate::client::RoomClient;
use crate::transport::TransportError;

/// When each numbered payload was handed over: the last four bytes of a message are its number.
pub type SentTimes = Arc<Mutex<Vec<Instant>>>;

/// Readers that look at nothing but when messages come.
#[derive(Debug)]
pub struct Crowd {
    poll: Poll,
    readers: Vec<Reader>,
}

#[derive(Debug)]
struct Reader {
    socket: TcpStream,
    /// Bytes of a message that has not come whole.
    rest: Vec<u8>,
}

impl Crowd {
    /// So many readers join.
    ///
    /// # Errors
    /// One is not let in.
    pub fn join(server: SocketAddr, room: &str, token: &str, many: usize) -> Result<Self, TransportError> {
        let poll = Poll::new()?;
        let mut readers = Vec::with_capacity(many);
        for index in 0..many {
            let socket = RoomClient::connect(server, room, token)?.into_socket();
            socket.set_nonblocking(true)?;
            let mut socket = TcpStream::from_std(socket);
            poll.registry().register(&mut socket, Token(index), Interest::READABLE)?;
            readers.push(Reader { socket, rest: Vec::new() });
        }
        Ok(Self { poll, readers })
    }

    /// Reads until `end`, and gives what each numbered message took to each reader, microseconds.
    ///
    /// # Errors
    /// A reader is cut off.
    pub fn read(&mut self, sent: &SentTimes, end: Instant) -> io::Result<Vec<u32>> {
        let mut events = Events::with_capacity(1024);
        let (mut took, mut buffer) = (Vec::new(), [0; 4096]);
        while Instant::now() < end {
            self.poll.poll(&mut events, Some(Duration::from_millis(20)))?;
            for event in &events {
                let Some(reader) = self.readers.get_mut(event.token().0) else { continue };
                loop {
                    match reader.socket.read(&mut buffer) {
                        Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
                        Ok(count) => reader.rest.extend(buffer.iter().take(count)),
                        Err(error) if error.kind() == io::ErrorKind::WouldBlock => break,
                        Err(error) => return Err(error),
                    }
                }
                let now = Instant::now();
                let sent = sent.lock().unwrap_or_else(PoisonError::into_inner);
                reader.messages(|number| {
                    let at = sent.get(number as usize);
                    took.extend(at.map(|at| now.duration_since(*at).as_micros() as u32));
                });
            }
        }
        Ok(took)
    }
}

impl Reader {
    /// Passes on the numbers of the messages that have come whole.
    fn messages(&mut self, mut number: impl FnMut(u32)) {
        let mut at = 0;
        while let Some(&[_, short]) = self.rest.get(at..).and_then(|rest| rest.first_chunk()) {
            let (head, length) = match short {
                126 => {
                    let Some(long) = self.rest.get(at + 2..).and_then(|rest| rest.first_chunk()) else {
                        break;
                    };
                    (4, usize::from(u16::from_be_bytes(*long)))
                }
                length => (2, usize::from(length)),
            };
            let Some(message) = self.rest.get(at + head..at + head + length) else { break };
            if let Some(last) = message.last_chunk() {
                number(u32::from_be_bytes(*last));
            }
            at += head + length;
        }
        self.rest.drain(..at);
    }
}
