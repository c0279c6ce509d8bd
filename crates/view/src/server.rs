//! One page for the browsers of this machine.
//!
//! Answering `GET /` with a page kept in memory needs no crate: a request is read up to its blank line within
//! a deadline, and the connection closed after the answer.

use std::collections::BTreeMap;
use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Longest request head.
const MAX_HEAD: usize = 16 << 10;
/// Time for a whole request to come in.
const REQUEST_TIME: Duration = Duration::from_secs(5);
/// Time for one piece of the answer to be taken.
const WRITE_TIME: Duration = Duration::from_secs(20);
/// Most connections at once. For a further one that is closed which has gone on least lately: clients that hold
/// connections without asking, or without taking the answer, keep nobody else out.
const MAX_CONNECTIONS: usize = 200;
/// Bytes of an answer that are handed over at a time.
const PIECE: usize = 1 << 16;
/// Stack of the thread of a connection, bytes.
const STACK: usize = 128 << 10;

/// A listener on the loopback interface, at `port` or any free one for 0.
///
/// # Errors
/// The port is taken or not allowed.
pub fn bind(port: u16) -> io::Result<TcpListener> {
    TcpListener::bind(SocketAddr::from((Ipv4Addr::LOCALHOST, port)))
}

/// Answers `GET /` and `HEAD /` with a [page](crate::page()) for ever, everything else with an error. Requests must name this
/// machine as their host, so that no other site's script can read the page through a name of its own, and where they have
/// an origin it must be the page's own.
///
/// # Errors
/// The listener is of no use any more; faults of single connections are passed over.
pub fn serve(listener: &TcpListener, page: Vec<u8>) -> io::Result<()> {
    let page: Arc<[u8]> = page.into();
    let open = Arc::new(Open::default());
    let mut failures = 0;
    loop {
        let stream = match listener.accept() {
            Ok((stream, _)) => stream,
            Err(error) => {
                // A connection that went away, or no handles left for a moment.
                failures += 1;
                if failures > 100 {
                    return Err(error);
                }
                std::thread::sleep(Duration::from_millis(20));
                continue;
            }
        };
        failures = 0;
        let (page, Ok(slot)) = (Arc::clone(&page), open.slot(&stream)) else { continue };
        let thread = std::thread::Builder::new().stack_size(STACK);
        // Without a thread for it the connection is closed.
        let _ = thread.spawn(move || {
            // A browser that hangs up is no fault of ours.
            let _ = answer(stream, &page, &slot);
        });
    }
}

/// The open connections.
#[derive(Default)]
struct Open(Mutex<Connections>);

#[derive(Default)]
struct Connections {
    next: u64,
    all: BTreeMap<u64, Connection>,
}

struct Connection {
    stream: TcpStream,
    /// When it last went on.
    moved: Instant,
}

impl Open {
    fn lock(&self) -> MutexGuard<'_, Connections> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A place for a connection, for which another one may have to go.
    fn slot(self: &Arc<Self>, stream: &TcpStream) -> io::Result<Slot> {
        let stream = stream.try_clone()?;
        let mut open = self.lock();
        if open.all.len() >= MAX_CONNECTIONS {
            let idlest = open.all.iter().min_by_key(|(_, connection)| connection.moved).map(|(&n, _)| n);
            if let Some(connection) = idlest.and_then(|number| open.all.remove(&number)) {
                // It may have gone already.
                let _ = connection.stream.shutdown(Shutdown::Both);
            }
        }
        let number = open.next;
        open.next += 1;
        open.all.insert(number, Connection { stream, moved: Instant::now() });
        Ok(Slot { open: Arc::clone(self), number })
    }
}

/// A place among the open connections, given back when dropped.
struct Slot {
    open: Arc<Open>,
    number: u64,
}

impl Slot {
    /// Says that the connection goes on.
    fn moves(&self) {
        if let Some(connection) = self.open.lock().all.get_mut(&self.number) {
            connection.moved = Instant::now();
        }
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        self.open.lock().all.remove(&self.number);
    }
}

fn answer(mut stream: TcpStream, page: &[u8], slot: &Slot) -> io::Result<()> {
    stream.set_write_timeout(Some(WRITE_TIME))?;
    let reply = match read_head(&mut stream)? {
        Some(head) => reply(&head),
        None => Reply::error(400, "Bad Request"),
    };
    let (body, kind) = match reply.message {
        Some(message) => (message.as_bytes(), "text/plain; charset=utf-8"),
        None => (page, "text/html; charset=utf-16le"),
    };
    let head = format!(
        "HTTP/1.1 {} {}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nCache-Control: no-store\r\n\
         X-Content-Type-Options: nosniff\r\nX-Frame-Options: DENY\r\nReferrer-Policy: no-referrer\r\n\
         Cross-Origin-Resource-Policy: same-origin\r\n\
         Content-Security-Policy: frame-ancestors 'none'; base-uri 'none'; form-action 'none'\r\nConnection: close\r\n\r\n",
        reply.status,
        reply.message.unwrap_or("OK"),
        body.len()
    );
    stream.write_all(head.as_bytes())?;
    if !reply.head_only {
        for piece in body.chunks(PIECE) {
            stream.write_all(piece)?;
            slot.moves();
        }
    }
    stream.shutdown(Shutdown::Write)?;
    // What the other side still sends is read, or closing would reset the connection under the answer.
    let mut rest = [0; 1024];
    stream.set_read_timeout(Some(Duration::from_millis(200)))?;
    let end = Instant::now() + Duration::from_secs(1);
    while Instant::now() < end && stream.read(&mut rest)? > 0 {}
    Ok(())
}

/// The request up to its blank line; `None` if it is too long or no text.
fn read_head(stream: &mut TcpStream) -> io::Result<Option<String>> {
    let end = Instant::now() + REQUEST_TIME;
    let mut head = Vec::new();
    let mut piece = [0; 2048];
    loop {
        let left = end.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        stream.set_read_timeout(Some(left))?;
        match stream.read(&mut piece)? {
            0 => return Err(io::ErrorKind::UnexpectedEof.into()),
            n => head.extend(piece.iter().take(n)),
        }
        if head.windows(4).any(|w| w == b"\r\n\r\n") {
            return Ok(String::from_utf8(head).ok());
        }
        if head.len() > MAX_HEAD {
            return Ok(None);
        }
    }
}

/// What is answered: the page if there is no message.
#[derive(Debug, PartialEq)]
struct Reply {
    status: u16,
    message: Option<&'static str>,
    head_only: bool,
}

impl Reply {
    fn error(status: u16, message: &'static str) -> Self {
        Self { status, message: Some(message), head_only: false }
    }
}

fn reply(head: &str) -> Reply {
    let mut lines = head.split("\r\n");
    let mut words = lines.next().unwrap_or_default().split(' ');
    let (Some(method), Some(target), Some(version), None) =
        (words.next(), words.next(), words.next(), words.next())
    else {
        return Reply::error(400, "Bad Request");
    };
    if !version.starts_with("HTTP/1.") {
        return Reply::error(400, "Bad Request");
    }
    let fields: Vec<(&str, &str)> = lines.filter_map(|line| line.split_once(':')).collect();
    let all = |wanted: &'static str| {
        let named = fields.iter().filter(move |(name, _)| name.eq_ignore_ascii_case(wanted));
        named.map(|(_, value)| value.trim())
    };
    // A field that comes twice is refused: who reads which would be open.
    let (mut hosts, mut origins) = (all("host"), all("origin"));
    let lets_in = match (hosts.next(), hosts.next(), origins.next(), origins.next()) {
        (Some(host), None, origin, None) => {
            let own =
                |origin: &str| origin.strip_prefix("http://").is_some_and(|o| o.eq_ignore_ascii_case(host));
            is_this_machine(host) && origin.is_none_or(own)
        }
        _ => false,
    };
    if !lets_in {
        return Reply::error(403, "Forbidden");
    }
    if !["GET", "HEAD"].contains(&method) {
        return Reply::error(405, "Method Not Allowed");
    }
    let path = target.split('?').next().unwrap_or_default();
    if path != "/" {
        return Reply::error(404, "Not Found");
    }
    Reply { status: 200, message: None, head_only: method == "HEAD" }
}

/// Whether a `Host` field means the loopback interface, with any port.
fn is_this_machine(host: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if !port.is_empty() && port.bytes().all(|b| b.is_ascii_digit()) => name,
        _ => host,
    };
    name == "127.0.0.1" || name.eq_ignore_ascii_case("localhost")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn status(request: &str) -> u16 {
        reply(request).status
    }

    #[test]
    fn only_the_page_and_only_for_this_machine() {
        let get = |path: &str, host: &str| status(&format!("GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n"));
        for host in ["127.0.0.1:4000", "localhost:80", "LocalHost", "127.0.0.1"] {
            assert_eq!(get("/", host), 200, "{host}");
        }
        for host in ["evil.example", "evil.example:4000", "127.0.0.1.evil.example", "localhost:80:1x", ""] {
            assert_eq!(get("/", host), 403, "{host}");
        }
        assert_eq!(get("/?x=1", "localhost"), 200);
        assert_eq!(get("/favicon.ico", "localhost"), 404);
        assert_eq!(get("/../etc/passwd", "localhost"), 404);
        assert_eq!(status("POST / HTTP/1.1\r\nHost: localhost\r\n\r\n"), 405);
        assert!(reply("HEAD / HTTP/1.1\r\nHost: localhost\r\n\r\n").head_only);
        assert_eq!(status("GET / HTTP/1.1\r\n\r\n"), 403);
        assert_eq!(status("GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n"), 403);
        for (origin, code) in [("http://localhost", 200), ("http://evil.example", 403), ("null", 403)] {
            let origin = format!("GET / HTTP/1.1\r\nHost: localhost\r\nOrigin: {origin}\r\n\r\n");
            assert_eq!(status(&origin), code, "{origin}");
        }
        for request in ["", "GET", "GET /", "GET / x HTTP/1.1", "GET / FTP/1\r\nHost: localhost\r\n\r\n"] {
            assert_eq!(status(request), 400, "{request:?}");
        }
    }

    #[test]
    fn a_client_that_says_nothing_keeps_nobody_waiting() {
        let listener = bind(0).unwrap();
        let at = listener.local_addr().unwrap();
        std::thread::spawn(move || serve(&listener, "the page".into()));
        let _silent: Vec<TcpStream> = (0..4).map(|_| TcpStream::connect(at).unwrap()).collect();
        let ask = |request: &str| {
            let mut stream = TcpStream::connect(at).unwrap();
            stream.write_all(request.as_bytes()).unwrap();
            let mut text = String::new();
            stream.read_to_string(&mut text).unwrap();
            text
        };
        let begin = Instant::now();
        let text = ask(&format!("GET / HTTP/1.1\r\nHost: {at}\r\n\r\n"));
        assert!(text.starts_with("HTTP/1.1 200 OK\r\n") && text.ends_with("\r\n\r\nthe page"), "{text}");
        assert!(ask("HEAD / HTTP/1.1\r\nHost: localhost\r\n\r\n").ends_with("\r\n\r\n"));
        let long = format!("GET / HTTP/1.1\r\nX: {}", "y".repeat(2 * MAX_HEAD));
        assert!(ask(&long).starts_with("HTTP/1.1 400"));
        assert!(begin.elapsed() < REQUEST_TIME, "{:?}", begin.elapsed());
    }

    /// Clients that hold connections, take a new one whenever one is closed, and never ask.
    #[test]
    fn clients_that_come_again_and_again_keep_nobody_out() {
        let listener = bind(0).unwrap();
        let at = listener.local_addr().unwrap();
        std::thread::spawn(move || serve(&listener, vec![b'x'; 1 << 20]));
        let over = Arc::new(std::sync::atomic::AtomicBool::new(false));
        let hostile = |_| {
            let over = Arc::clone(&over);
            std::thread::spawn(move || {
                let mut held: Vec<TcpStream> = Vec::new();
                while !over.load(std::sync::atomic::Ordering::Relaxed) {
                    let Ok(mut stream) = TcpStream::connect(at) else { continue };
                    let _ = stream.write_all(b"GET / HTTP/1.1\r\n");
                    held.push(stream);
                    if held.len() > 10 {
                        held.remove(0);
                    }
                }
            })
        };
        let threads: Vec<_> = (0..50).map(hostile).collect();
        let ask = || -> io::Result<usize> {
            let mut stream = TcpStream::connect(at)?;
            stream.set_read_timeout(Some(Duration::from_secs(20)))?;
            stream.write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")?;
            let mut bytes = Vec::new();
            stream.read_to_end(&mut bytes)?;
            Ok(bytes.len())
        };
        let answers: Vec<_> = (0..40).map(|_| ask()).collect();
        over.store(true, std::sync::atomic::Ordering::Relaxed);
        threads.into_iter().for_each(|thread| thread.join().unwrap());
        assert!(answers.iter().all(|answer| answer.as_ref().is_ok_and(|&n| n > 1 << 20)), "{answers:?}");
    }
}
