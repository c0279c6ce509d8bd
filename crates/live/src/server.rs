//! The embedded server: the page by HTTP and a room by WebSocket, at one port.
//!
//! One thread does all of it and waits for nobody. Sockets do not block; what a reader does not take waits in a buffer of
//! limited length, and a reader whose buffer is full goes on with the next period. The same bytes go to everybody.
//!
//! ```no_run
//! use handcast_live::server::{Server, ServerOptions};
//! use handcast_live::transport::{Hello, Publish};
//! use handcast_live::wire::Plane;
//!
//! let server = Server::start(ServerOptions::new("127.0.0.1:0".parse()?))?;
//! let mut sender = server.publisher()?;
//! sender.hello(&Hello { hands: [false, true], record: Vec::new() })?;
//! sender.planes(&[Plane { payload: vec![0, 0, 1, 0xbb], ..Plane::default() }])?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod answers;
mod client;
mod fanout;
mod http;
mod link;

use std::borrow::Cow;
use std::io;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use mio::Waker;

use crate::transport::{Hello, Publish, TransportError};
use crate::wire::{Parting, Plane};
use fanout::Fanout;

/// What the page and its files may do in a browser (W3C content security policy): use each other, decode, speak with the
/// room, and nothing else. Every answer has it, so that it holds for workers, too.
pub const POLICY: &str = "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; worker-src 'self'; style-src 'self'; \
    connect-src 'self'; img-src data: blob:; media-src blob:; base-uri 'none'; form-action 'none'";

/// A file of the page.
#[derive(Clone, Debug)]
pub struct Part {
    /// Its path without the slash; empty for the page itself, which is at the room's name.
    pub name: Cow<'static, str>,
    /// Its media type.
    pub kind: Cow<'static, str>,
    /// Its bytes.
    pub bytes: Arc<[u8]>,
}

impl Part {
    /// A file of these bytes.
    pub fn new(name: &'static str, kind: &'static str, bytes: impl AsRef<[u8]>) -> Self {
        Self { name: name.into(), kind: kind.into(), bytes: bytes.as_ref().into() }
    }
}

/// Certificate and key of a server.
#[cfg(feature = "tls")]
#[derive(Clone)]
pub struct Tls(Arc<rustls::ServerConfig>);

#[cfg(feature = "tls")]
impl std::fmt::Debug for Tls {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Tls")
    }
}

#[cfg(feature = "tls")]
impl Tls {
    /// A chain of certificates and the key of the first, as PEM.
    ///
    /// # Errors
    /// What is wrong with them.
    pub fn new(certificates: &[u8], key: &[u8]) -> Result<Self, String> {
        use rustls::pki_types::pem::PemObject;
        use rustls::pki_types::{CertificateDer, PrivateKeyDer};
        let chain: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(certificates).collect();
        // What a reader of PEM says has bytes in it where text stood.
        let cut = |error| match error {
            rustls::pki_types::pem::Error::MissingSectionEnd { .. } => {
                "it is cut: a line \"-----END …\" is missing".to_owned()
            }
            other => other.to_string(),
        };
        let chain = chain.map_err(|error| format!("certificate: {}", cut(error)))?;
        if chain.is_empty() {
            return Err("certificate: there is none (PEM is expected)".to_owned());
        }
        let key = PrivateKeyDer::from_pem_slice(key).map_err(|error| match error {
            rustls::pki_types::pem::Error::NoItemsFound => {
                "key: there is none that is not encrypted (PEM is expected)".to_owned()
            }
            other => format!("key: {}", cut(other)),
        })?;
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let config = rustls::ServerConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .and_then(|builder| builder.with_no_client_auth().with_single_cert(chain, key))
            .map_err(|error| error.to_string())?;
        Ok(Self(Arc::new(config)))
    }
}

/// How a server serves.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct ServerOptions {
    /// Where it listens; port 0 takes any that is free.
    pub bind: SocketAddr,
    /// Name of the room: the page's path.
    pub room: String,
    /// What a connection to the room must say; empty for nothing.
    pub token: String,
    /// Names by which the server may be called beside addresses and, at the loopback interface, `localhost`.
    pub hosts: Vec<String>,
    /// The page and its files.
    pub parts: Vec<Part>,
    /// What they may do in a browser; [`POLICY`] where they speak with this server alone.
    pub policy: Cow<'static, str>,
    /// Whether those who come may send.
    pub senders: bool,
    /// Most connections at once, and most of those that are about to ask or are being answered.
    pub connections: [usize; 2],
    /// Time for a request to come in whole.
    pub request_time: Duration,
    /// Time for an answer to be taken in whole; when nothing of it is taken for 20 s it ends before.
    pub answer_time: Duration,
    /// A sender that says nothing for so long is gone; a reader may be silent eight times as long. Pages say something
    /// every second.
    pub silence: Duration,
    /// By TLS.
    #[cfg(feature = "tls")]
    pub tls: Option<Tls>,
}

impl ServerOptions {
    /// A room called `hand` at an address, without a token.
    pub fn new(bind: SocketAddr) -> Self {
        Self {
            bind,
            room: "hand".into(),
            token: String::new(),
            hosts: Vec::new(),
            parts: Vec::new(),
            policy: POLICY.into(),
            senders: true,
            connections: [4096, 256],
            request_time: Duration::from_secs(5),
            answer_time: Duration::from_secs(600),
            silence: Duration::from_secs(15),
            #[cfg(feature = "tls")]
            tls: None,
        }
    }

    /// Sets the name of the room.
    pub fn with_room(self, room: impl Into<String>) -> Self {
        Self { room: room.into(), ..self }
    }

    /// Sets what a connection must say.
    pub fn with_token(self, token: impl Into<String>) -> Self {
        Self { token: token.into(), ..self }
    }

    /// Sets the names of the server.
    pub fn with_hosts(self, hosts: Vec<String>) -> Self {
        Self { hosts, ..self }
    }

    /// Sets the page and its files.
    pub fn with_parts(self, parts: Vec<Part>) -> Self {
        Self { parts, ..self }
    }

    /// Sets what the page and its files may do.
    pub fn with_policy(self, policy: impl Into<Cow<'static, str>>) -> Self {
        Self { policy: policy.into(), ..self }
    }

    /// Sets whether those who come may send.
    pub fn with_senders(self, senders: bool) -> Self {
        Self { senders, ..self }
    }

    /// Sets the times for requests and of silence.
    pub fn with_times(self, request_time: Duration, silence: Duration) -> Self {
        Self { request_time, silence, ..self }
    }

    /// Sets the time for an answer to be taken.
    pub fn with_answer_time(self, answer_time: Duration) -> Self {
        Self { answer_time, ..self }
    }

    /// Sets certificate and key.
    #[cfg(feature = "tls")]
    pub fn with_tls(self, tls: Tls) -> Self {
        Self { tls: Some(tls), ..self }
    }

    /// Whether a request may call the server so.
    fn takes_host(&self, host: &str) -> bool {
        let name = http::without_port(host);
        let named = self.hosts.iter().any(|own| http::is_named(name, own));
        let loopback = http::is_loopback(name);
        named || loopback || !self.bind.ip().is_loopback() && http::address(name).is_some()
    }

    /// Whether this is the token; takes as long for any of its length.
    fn takes_token(&self, token: &str) -> bool {
        let off = self.token.bytes().zip(token.bytes()).fold(0, |off, (a, b)| off | (a ^ b));
        self.token.is_empty() || self.token.len() == token.len() && off == 0
    }
}

/// Makes sure that a room may have this name, which is part of the page's address.
///
/// # Errors
/// What is allowed.
pub fn check_room(name: &str) -> Result<(), String> {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b == b'-' || b == b'_';
    if (1..=64).contains(&name.len()) && name.bytes().all(plain) {
        return Ok(());
    }
    Err("allowed are 1 to 64 letters, digits, - and _".into())
}

/// A token that nobody guesses: 26 letters and digits, 128 bits.
///
/// # Errors
/// The system gives no random numbers.
pub fn random_token() -> io::Result<String> {
    const LETTERS: &[u8; 32] = b"abcdefghijkmnpqrstuvwxyz23456789";
    let mut bytes = [0; 26];
    getrandom::fill(&mut bytes).map_err(io::Error::other)?;
    Ok(bytes.iter().map(|byte| char::from(LETTERS[usize::from(byte & 31)])).collect())
}

/// The room's clock: microseconds since 1970.
pub fn clock_us() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_micros()).unwrap_or_default()
}

/// The room's clock as planes tell it: milliseconds modulo 2^32.
pub fn clock_ms() -> u32 {
    (clock_us() / 1000) as u32
}

/// What a server has done up to a moment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Counted {
    /// Connections to the room.
    pub viewers: usize,
    /// All connections.
    pub connections: usize,
    /// Senders in the room.
    pub senders: usize,
    /// Bytes of streams published.
    pub payload: u64,
    /// Messages they were written in.
    pub messages: u64,
    /// Bytes of these messages, WebSocket's header included.
    pub bytes: u64,
    /// Messages handed to readers.
    pub deliveries: u64,
    /// Messages left out for slow readers.
    pub skipped: u64,
    /// Nanoseconds that handing out took.
    pub fanout_ns: u64,
    /// Connections refused, or closed for a fault.
    pub refused: u64,
}

/// What is counted, as the server's thread and those who ask have it.
type Counters = Mutex<Counted>;

/// What the server's thread is told.
enum Command {
    /// A sender of this process comes, which will say more by these; it gets its end, where there is a place for it.
    Enter(Commands, Sender<Option<RoomPublisher>>),
    Hello(u8, Hello),
    Planes(u8, Vec<Plane>),
    Leave(u8, Parting),
    Stop,
}

/// Commands to the server's thread, which is woken for each.
#[derive(Clone)]
struct Commands {
    queue: Sender<Command>,
    waker: Arc<Waker>,
}

impl Commands {
    fn say(&self, command: Command) -> Result<(), TransportError> {
        let closed = || TransportError::Closed { why: "the server has ended".into() };
        self.queue.send(command).map_err(|_| closed())?;
        self.waker.wake().map_err(|_| closed())
    }
}

/// A server that runs until it is dropped.
pub struct Server {
    address: SocketAddr,
    commands: Commands,
    counters: Arc<Counters>,
    thread: Mutex<Option<JoinHandle<io::Result<()>>>>,
}

impl std::fmt::Debug for Server {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Server").field("address", &self.address).finish_non_exhaustive()
    }
}

impl Server {
    /// Begins to serve.
    ///
    /// # Errors
    /// The address is taken or not allowed, a room's name that is no part of a path.
    pub fn start(options: ServerOptions) -> io::Result<Self> {
        check_room(&options.room).map_err(|allowed| {
            let what = format!("room {:?}: {allowed}", options.room);
            io::Error::new(io::ErrorKind::InvalidInput, what)
        })?;
        let (queue, orders): (_, Receiver<Command>) = channel();
        let counters = Arc::new(Counters::default());
        let (fanout, address, waker) = Fanout::new(options, orders, Arc::clone(&counters))?;
        let thread = std::thread::Builder::new().name("live".into()).spawn(move || fanout.run())?;
        let commands = Commands { queue, waker: Arc::new(waker) };
        Ok(Self { address, commands, counters, thread: Mutex::new(Some(thread)) })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What it has done so far.
    pub fn counted(&self) -> Counted {
        *self.counters.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A sender of this process. When it is dropped before its end, it is gone.
    ///
    /// # Errors
    /// The room is full, or the server has ended.
    pub fn publisher(&self) -> Result<RoomPublisher, TransportError> {
        let (reply, publisher) = channel();
        self.commands.say(Command::Enter(self.commands.clone(), reply))?;
        match publisher.recv_timeout(Duration::from_secs(10)) {
            Ok(Some(publisher)) => Ok(publisher),
            Ok(None) => Err(TransportError::Refused { why: "the room has all the senders it takes".into() }),
            Err(_) => Err(TransportError::Closed { why: "the server has ended".into() }),
        }
    }

    /// Whether it serves no more, though nobody has stopped it: [`Self::stop`] says why.
    pub fn has_ended(&self) -> bool {
        let thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner);
        thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Ends it, and says what it ended with.
    ///
    /// # Errors
    /// Why it had ended before.
    pub fn stop(&self) -> io::Result<()> {
        let _ = self.commands.say(Command::Stop);
        let thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take();
        thread.map_or(Ok(()), |thread| {
            thread.join().unwrap_or_else(|_| Err(io::Error::other("the server's thread broke down")))
        })
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.stop();
    }
}

/// A sender in the process of the server.
pub struct RoomPublisher {
    number: u8,
    wanted: Arc<AtomicBool>,
    commands: Commands,
    ended: bool,
}

impl std::fmt::Debug for RoomPublisher {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RoomPublisher").field("number", &self.number).finish_non_exhaustive()
    }
}

impl RoomPublisher {
    fn new(number: u8, commands: Commands) -> Self {
        Self { number, wanted: Arc::default(), commands, ended: false }
    }

    /// Its number in the room.
    pub fn number(&self) -> u8 {
        self.number
    }
}

impl Publish for RoomPublisher {
    fn hello(&mut self, hello: &Hello) -> Result<(), TransportError> {
        self.commands.say(Command::Hello(self.number, hello.clone()))
    }

    fn planes(&mut self, planes: &[Plane]) -> Result<(), TransportError> {
        self.commands.say(Command::Planes(self.number, planes.to_vec()))
    }

    fn wants_intra(&mut self) -> bool {
        self.wanted.swap(false, Ordering::Relaxed)
    }

    fn end(&mut self) -> Result<(), TransportError> {
        self.ended = true;
        self.commands.say(Command::Leave(self.number, Parting::Left))
    }
}

impl Drop for RoomPublisher {
    fn drop(&mut self) {
        if !self.ended {
            let _ = self.commands.say(Command::Leave(self.number, Parting::Gone));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::MAX_SENDERS;

    #[test]
    fn who_waits_no_more_for_a_place_leaves_it() {
        let server = Server::start(ServerOptions::new("127.0.0.1:0".parse().unwrap())).unwrap();
        for _ in 0..MAX_SENDERS {
            let (reply, _) = channel();
            server.commands.say(Command::Enter(server.commands.clone(), reply)).unwrap();
        }
        // Whoever was let in says that it leaves when it has been.
        let end = std::time::Instant::now() + Duration::from_secs(5);
        let mut publishers = Vec::new();
        while publishers.len() < usize::from(MAX_SENDERS) {
            publishers.extend(server.publisher().ok());
            assert!(std::time::Instant::now() < end, "{} of {MAX_SENDERS}", publishers.len());
        }
    }
}
