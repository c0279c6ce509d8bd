//! Relays on this machine with losses between them, to test and measure with.

use std::collections::VecDeque;
use std::io::{self, Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{JoinHandle, sleep};
use std::time::{Duration, Instant};

use handcast_live::transport::{Hello, Publish as _, Subscribe as _, TransportError};
use handcast_live::wire::{Message, Plane};
use url::Url;

use crate::publisher::now_ms;
use crate::{MoqOptions, MoqPublisher, MoqSubscriber};

/// Planes a second.
const RATE: u64 = 30;
/// Planes in a period.
pub const PERIOD: u16 = 30;
/// Longest wait for a relay, and for a plane.
const PATIENCE: Duration = Duration::from_secs(10);
/// Room of the trials.
const ROOM: &str = "room";

/// The relay: what `HANDCAST_MOQ_RELAY` names, else `moq-relay` of the search path.
pub fn program() -> PathBuf {
    std::env::var_os("HANDCAST_MOQ_RELAY").map_or_else(|| "moq-relay".into(), PathBuf::from)
}

fn refused(why: &str) -> TransportError {
    TransportError::Refused { why: why.into() }
}

/// An unmodified relay on a free port of the loopback interface, with a certificate of its own. It ends when dropped.
#[derive(Debug)]
pub struct Relay {
    child: Child,
    /// Its port, of UDP and TCP.
    pub port: u16,
    /// SHA-256 of its certificate, in hex.
    pub fingerprint: String,
}

impl Relay {
    /// Starts one, a member of the cluster of `peer`, which it reaches by that port.
    ///
    /// # Errors
    /// The program does not run, or does not answer.
    pub fn start(program: &Path, peer: Option<(u16, &Self)>) -> Result<Self, TransportError> {
        let port = free_port()?;
        let address = format!("127.0.0.1:{port}");
        let mut command = Command::new(program);
        command.args(["--listen", &address, "--web-http-listen", &address]);
        command.args(["--listen-tls-generate", "localhost", "--auth-public", "**"]);
        if let Some((port, peer)) = peer {
            let url = format!("https://localhost:{port}/");
            command.args(["--cluster-connect", &url, "--connect-tls-fingerprint", &peer.fingerprint]);
        }
        let child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn();
        let child = child.map_err(|error| {
            refused(&format!("{}: {error}; cargo install moq-relay --version =0.17.10", program.display()))
        })?;
        let mut relay = Self { child, port, fingerprint: String::new() };
        let end = Instant::now() + 2 * PATIENCE;
        while relay.fingerprint.is_empty() {
            if Instant::now() > end {
                return Err(refused("the relay does not answer"));
            }
            sleep(Duration::from_millis(50));
            relay.fingerprint = fingerprint(port).unwrap_or_default();
        }
        Ok(relay)
    }

    /// Where it is, `localhost` by name as its certificate says.
    pub fn url(&self) -> Result<Url, TransportError> {
        format!("https://localhost:{}/", self.port).parse().map_err(|_| refused("a URL"))
    }

    /// Kills it without a word to its clients.
    ///
    /// # Errors
    /// It cannot be killed.
    pub fn kill(&mut self) -> io::Result<()> {
        self.child.kill()?;
        self.child.wait().map(drop)
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        let _ = self.kill();
    }
}

/// A port that is free for TCP and UDP.
fn free_port() -> io::Result<u16> {
    loop {
        let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
        if UdpSocket::bind(("127.0.0.1", port)).is_ok() {
            return Ok(port);
        }
    }
}

/// What a relay says of its certificate.
fn fingerprint(port: u16) -> Option<String> {
    let mut socket = TcpStream::connect(("127.0.0.1", port)).ok()?;
    let request = "GET /certificate.sha256 HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
    socket.write_all(request.as_bytes()).ok()?;
    let mut answer = String::new();
    socket.read_to_string(&mut answer).ok()?;
    let body = answer.split("\r\n\r\n").nth(1)?.trim();
    (body.len() == 64).then(|| body.to_owned())
}

/// What trusts these relays.
pub fn options(relays: &[&Relay]) -> MoqOptions {
    MoqOptions::default().with_fingerprints(relays.iter().map(|relay| relay.fingerprint.clone()).collect())
}

/// Addresses of relays, in their order.
///
/// # Errors
/// None in practice.
pub fn urls(relays: &[&Relay]) -> Result<Vec<Url>, TransportError> {
    relays.iter().map(|relay| relay.url()).collect()
}

/// A link that passes packets on after a delay and loses some of them. It ends when dropped.
#[derive(Debug)]
pub struct Link {
    /// The port at which it begins.
    pub port: u16,
    stop: Arc<AtomicBool>,
}

impl Link {
    /// Opens one to a port of the loopback interface, which loses this share of the packets each way.
    ///
    /// # Errors
    /// No port is free.
    pub fn start(to: u16, delay: Duration, loss: f64) -> io::Result<Self> {
        let socket = || {
            let socket = UdpSocket::bind("127.0.0.1:0")?;
            socket.set_read_timeout(Some(Duration::from_millis(1)))?;
            Ok::<_, io::Error>(Arc::new(socket))
        };
        let (near, far) = (socket()?, socket()?);
        let port = near.local_addr()?.port();
        let stop = Arc::new(AtomicBool::new(false));
        let client = Arc::new(Mutex::new(None));
        let there = SocketAddr::from(([127, 0, 0, 1], to));
        for back in [false, true] {
            let (from, into) = if back { (&far, &near) } else { (&near, &far) };
            let way = Way { from: Arc::clone(from), into: Arc::clone(into), delay, loss, back };
            let (stop, client) = (Arc::clone(&stop), Arc::clone(&client));
            std::thread::Builder::new().name("link".into()).spawn(move || way.pass(&stop, &client, there))?;
        }
        Ok(Self { port, stop })
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

/// One direction of a link.
struct Way {
    from: Arc<UdpSocket>,
    into: Arc<UdpSocket>,
    delay: Duration,
    loss: f64,
    back: bool,
}

impl Way {
    fn pass(&self, stop: &AtomicBool, client: &Mutex<Option<SocketAddr>>, there: SocketAddr) {
        let client = || client.lock().unwrap_or_else(PoisonError::into_inner);
        let mut waiting = VecDeque::new();
        let mut random = 0x2545_f491_4f6c_dd1du64 + u64::from(self.back);
        let mut bytes = [0; 2048];
        while !stop.load(Ordering::Relaxed) {
            if let Ok((length, address)) = self.from.recv_from(&mut bytes) {
                if !self.back {
                    *client() = Some(address);
                }
                // xorshift64 (Marsaglia 2003).
                random ^= random << 13;
                random ^= random >> 7;
                random ^= random << 17;
                if (random >> 11) as f64 / (1u64 << 53) as f64 >= self.loss {
                    waiting.push_back((
                        Instant::now() + self.delay,
                        bytes.get(..length).unwrap_or_default().to_vec(),
                    ));
                }
            }
            while waiting.front().is_some_and(|(due, _)| *due <= Instant::now()) {
                let packet = waiting.pop_front().map(|(_, packet)| packet).unwrap_or_default();
                let to = if self.back { *client() } else { Some(there) };
                // What cannot be passed on is lost.
                let _ = to.map(|to| self.into.send_to(&packet, to));
            }
        }
    }
}

/// A sender of made planes at its pace on a thread of its own. Each plane begins with its number, eight bytes.
#[derive(Debug)]
pub struct Sender {
    stop: Arc<AtomicBool>,
    polite: Arc<AtomicBool>,
    thread: Option<JoinHandle<Result<(), TransportError>>>,
}

impl Sender {
    /// Starts it, when its publisher is connected.
    ///
    /// # Errors
    /// It is not within ten seconds.
    pub fn start(publisher: MoqPublisher) -> Result<Self, TransportError> {
        if !publisher.wait_connected(PATIENCE) {
            return Err(refused("the publisher is not connected"));
        }
        let [stop, polite] = [false, true].map(|v| Arc::new(AtomicBool::new(v)));
        let (stopped, is_polite) = (Arc::clone(&stop), Arc::clone(&polite));
        let thread = std::thread::spawn(move || send(publisher, &stopped, &is_polite));
        Ok(Self { stop, polite, thread: Some(thread) })
    }

    /// As [`Self::start`], in the room of the trials, by the first of these relays that answers.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn at(relays: &[&Relay]) -> Result<Self, TransportError> {
        Self::start(MoqPublisher::connect(&urls(relays)?, ROOM, "anna", &options(relays))?)
    }

    /// Ends it, with a goodbye or without.
    ///
    /// # Errors
    /// What it failed by.
    pub fn stop(&mut self, polite: bool) -> Result<(), TransportError> {
        self.polite.store(polite, Ordering::Relaxed);
        self.stop.store(true, Ordering::Relaxed);
        let done = self.thread.take().map(JoinHandle::join);
        done.map_or(Ok(()), |done| done.unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    }
}

impl Drop for Sender {
    fn drop(&mut self) {
        let _ = self.stop(true);
    }
}

fn send(mut publisher: MoqPublisher, stop: &AtomicBool, polite: &AtomicBool) -> Result<(), TransportError> {
    publisher.hello(&Hello { hands: [true, false], record: vec![1, 2, 3] })?;
    let begun = Instant::now();
    for k in 0.. {
        sleep((Duration::from_millis(k * 1000 / RATE)).saturating_sub(begun.elapsed()));
        if stop.load(Ordering::Relaxed) {
            break;
        }
        let (period, index) = ((k / u64::from(PERIOD)) as u16, (k % u64::from(PERIOD)) as u16);
        let payload = k.to_be_bytes().repeat(if index == 0 { 12 } else { 2 });
        publisher.planes(&[Plane {
            period,
            index,
            time_ms: now_ms() as u32,
            payload,
            ..Plane::default()
        }])?;
    }
    if polite.load(Ordering::Relaxed) { publisher.end() } else { Ok(()) }
}

/// A viewer of the room of the trials, at the first of these relays that answers.
///
/// # Errors
/// As [`MoqSubscriber::connect`].
pub fn viewer(relays: &[&Relay]) -> Result<MoqSubscriber, TransportError> {
    MoqSubscriber::connect(&urls(relays)?, ROOM, &options(relays))
}

/// A message, when it came, and the milliseconds from its plane's capture to then.
pub type Seen = (Instant, u32, Message);

/// What a reader is given within `span`.
///
/// # Errors
/// Its connection has ended.
pub fn read(room: &mut MoqSubscriber, span: Duration) -> Result<Vec<Seen>, TransportError> {
    let end = Instant::now() + span;
    let mut messages = Vec::new();
    while let Some(left) = end.checked_duration_since(Instant::now()) {
        if let Some(message) = room.next(left)? {
            let age = if let Message::Plane(plane) = &message {
                (now_ms() as u32).wrapping_sub(plane.time_ms)
            } else {
                0
            };
            messages.push((Instant::now(), age, message));
        }
    }
    Ok(messages)
}

/// The plane of a message, if it is to be shown.
pub fn shown(message: &Message) -> Option<&Plane> {
    match message {
        Message::Plane(plane) if !plane.replay => Some(plane),
        _ => None,
    }
}

/// Reads until a plane is shown, at most `most`; gives how long that was.
///
/// # Errors
/// Its connection has ended.
pub fn wait_for_plane(room: &mut MoqSubscriber, most: Duration) -> Result<Option<Duration>, TransportError> {
    let begun = Instant::now();
    while begun.elapsed() < most {
        if room.next(most)?.as_ref().and_then(shown).is_some() {
            return Ok(Some(begun.elapsed()));
        }
    }
    Ok(None)
}

/// Milliseconds from nothing to the first plane shown, in rising order, of so many who join one after the other.
///
/// # Errors
/// One of them sees nothing for ten seconds.
pub fn joins(relay: &Relay, many: usize) -> Result<Vec<u32>, TransportError> {
    let join = |_| {
        let begun = Instant::now();
        let seen = wait_for_plane(&mut viewer(&[relay])?, PATIENCE)?;
        seen.map(|_| begun.elapsed().as_millis() as u32).ok_or_else(|| refused("a joiner sees no hand"))
    };
    let mut joins = (0..many).map(join).collect::<Result<Vec<u32>, _>>()?;
    joins.sort_unstable();
    Ok(joins)
}

/// Milliseconds from capture to reading of what is shown within `span`, in rising order.
///
/// # Errors
/// No plane comes, or the connection ends.
pub fn ages(relay: &Relay, span: Duration) -> Result<Vec<u32>, TransportError> {
    let mut room = viewer(&[relay])?;
    wait_for_plane(&mut room, PATIENCE)?.ok_or_else(|| refused("a viewer sees no hand"))?;
    // The first second is that of the handshake.
    read(&mut room, Duration::from_secs(1))?;
    let seen = read(&mut room, span)?;
    let mut ages: Vec<u32> =
        seen.iter().filter(|(.., m)| shown(m).is_some()).map(|(_, age, _)| *age).collect();
    ages.sort_unstable();
    Ok(ages)
}

/// What a viewer notices of a relay that is killed.
#[derive(Clone, Copy, Debug)]
pub struct Gap {
    /// The longest time without a plane.
    pub gap: Duration,
    /// From the kill to the plane behind it.
    pub back: Duration,
    /// Whether the viewer was told that the sender has ended.
    pub parted: bool,
}

/// Kills the first of two relays of a cluster, at which the sender is and three viewers, and gives what they notice, and a
/// fourth who is at the second alone.
///
/// # Errors
/// Somebody is not connected to begin with, or a viewer sees nothing.
pub fn kill(program: &Path) -> Result<Vec<Gap>, TransportError> {
    let mut first = Relay::start(program, None)?;
    let second = Relay::start(program, Some((first.port, &first)))?;
    let mut sender = Sender::at(&[&first, &second])?;
    let known = options(&[&first, &second]);
    let (both, one) = (urls(&[&first, &second])?, urls(&[&second])?);
    let lists = [&both, &both, &both, &one];
    let rooms = lists.map(|list| MoqSubscriber::connect(list, ROOM, &known));
    let mut rooms: Vec<MoqSubscriber> = rooms.into_iter().collect::<Result<_, _>>()?;
    for room in &mut rooms {
        wait_for_plane(room, PATIENCE)?.ok_or_else(|| refused("a viewer sees no hand"))?;
    }
    sleep(Duration::from_millis(1500));
    let killed = Instant::now();
    first.kill()?;
    let watch = move |mut room: MoqSubscriber| {
        let messages = read(&mut room, Duration::from_secs(8))?;
        let parted = messages.iter().any(|(.., m)| matches!(m, Message::End { .. }));
        let planes = messages.iter().filter(|(.., m)| shown(m).is_some()).map(|(came, ..)| *came);
        let planes: Vec<Instant> = planes.collect();
        let longest = planes.windows(2).map(|pair| (pair[1] - pair[0], pair[1])).max();
        let (gap, end) = longest.ok_or_else(|| refused("a viewer is not back"))?;
        Ok(Gap { gap, back: end.saturating_duration_since(killed), parted })
    };
    let threads: Vec<_> = rooms.into_iter().map(|room| std::thread::spawn(move || watch(room))).collect();
    let joined = threads
        .into_iter()
        .map(|thread| thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
    let gaps = joined.collect();
    sender.stop(true)?;
    gaps
}
