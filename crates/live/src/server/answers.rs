//! What requests are answered: a head, and the files of the page as they are or gzipped.

use std::borrow::Cow;
use std::io::Write;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock, Weak};

use flate2::Compression;
use flate2::write::GzEncoder;

use super::http::{NOT_FOUND, Reply};
use super::{Part, ServerOptions};

/// The gzipped copies of files, in their order; none where it would not be smaller. They are made while files are served
/// already: at first of the page and of what it names, of the others, which are most of the work and may never be wanted,
/// once the page has been asked for.
type Packed = [OnceLock<Option<Arc<[u8]>>>];

/// The answers of a server.
pub(super) struct Answers {
    policy: Cow<'static, str>,
    parts: Vec<Part>,
    packed: Arc<Packed>,
    /// Whether the page has been asked for.
    asked: AtomicBool,
}

impl Answers {
    pub fn new(options: &ServerOptions) -> Self {
        let parts = options.parts.clone();
        let packed: Arc<Packed> = parts.iter().map(|_| OnceLock::new()).collect();
        let answers = Self { policy: options.policy.clone(), parts, packed, asked: AtomicBool::new(false) };
        answers.pack(|part| is_named(&options.parts, part));
        answers
    }

    /// Packs the files that are `wanted`.
    fn pack(&self, wanted: impl Fn(&Part) -> bool) {
        let files = self.parts.iter().enumerate().filter(|(_, part)| wanted(part));
        let files: Vec<(usize, Part)> = files.map(|(index, part)| (index, part.clone())).collect();
        let copies = Arc::downgrade(&self.packed);
        // Without a thread for it all are served as they are.
        let _ = std::thread::Builder::new().name("gzip".into()).spawn(move || pack(&files, &copies));
    }

    /// Head and body of the answer to a request.
    pub fn to(&self, reply: &Reply) -> (String, Arc<[u8]>) {
        let no_body = || Arc::from(&[][..]);
        match reply {
            Reply::Part { index, head_only, gzip } => {
                let Some(part) = self.parts.get(*index) else { return self.to(&NOT_FOUND) };
                if is_page(part) && !self.asked.swap(true, Ordering::Relaxed) {
                    self.pack(|part| !is_named(&self.parts, part));
                }
                let packed = self.packed.get(*index).and_then(OnceLock::get).and_then(Option::as_ref);
                let (body, coding) = match packed.filter(|_| *gzip) {
                    Some(packed) => (packed, "Content-Encoding: gzip\r\n"),
                    None => (&part.bytes, ""),
                };
                let head = self.head(
                    "200 OK",
                    &part.kind,
                    body.len(),
                    &format!("{coding}Vary: Accept-Encoding\r\n"),
                );
                (head, if *head_only { no_body() } else { Arc::clone(body) })
            }
            Reply::Upgrade { key } => {
                let accept = tungstenite::handshake::derive_accept_key(key.as_bytes());
                let head = format!(
                    "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
                     Sec-WebSocket-Accept: {accept}\r\n\r\n"
                );
                (head, no_body())
            }
            Reply::Moved(to) => {
                (self.head("302 Found", "text/plain", 0, &format!("Location: {to}\r\n")), no_body())
            }
            Reply::Error(status, text) => {
                let head = self.head(&format!("{status} {text}"), "text/plain", text.len(), "");
                (head, Arc::from(text.as_bytes()))
            }
        }
    }

    fn head(&self, status: &str, kind: &str, length: usize, more: &str) -> String {
        let policy = &self.policy;
        format!(
            "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\nCache-Control: no-store\r\n\
             X-Content-Type-Options: nosniff\r\nX-Frame-Options: DENY\r\nReferrer-Policy: no-referrer\r\n\
             Cross-Origin-Resource-Policy: same-origin\r\nContent-Security-Policy: {policy}; frame-ancestors 'none'\r\n\
             {more}Connection: close\r\n\r\n"
        )
    }
}

fn is_page(part: &Part) -> bool {
    part.name.is_empty()
}

/// Whether a file is asked for with the page, which names it: of files without a page each.
fn is_named(parts: &[Part], part: &Part) -> bool {
    let named = |page: &Part| {
        let name = format!("\"{}\"", part.name);
        is_page(part) || page.bytes.windows(name.len()).any(|window| window == name.as_bytes())
    };
    parts.iter().find(|part| is_page(part)).is_none_or(named)
}

/// Packs files one after the other, as long as somebody serves them.
fn pack(files: &[(usize, Part)], packed: &Weak<Packed>) {
    for (index, part) in files {
        let smaller = gzipped(&part.bytes).filter(|copy| copy.len() < part.bytes.len());
        let Some(packed) = packed.upgrade() else { return };
        if let Some(place) = packed.get(*index) {
            let _ = place.set(smaller.map(Arc::from));
        }
    }
}

/// Bytes in gzip's format (RFC 1952).
fn gzipped(bytes: &[u8]) -> Option<Vec<u8>> {
    let mut out = GzEncoder::new(Vec::new(), Compression::best());
    out.write_all(bytes).ok()?;
    out.finish().ok()
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use super::*;

    #[test]
    fn what_the_page_does_not_name_is_packed_once_it_was_asked_for() {
        let long = |name: &'static str| Part::new(name, "text/plain", [b'x'; 2000]);
        let page = Part::new("", "text/html", format!("<script src=\"a.js\"></script>{}", " ".repeat(2000)));
        let options = ServerOptions::new(([127, 0, 0, 1], 0).into());
        let answers = Answers::new(&options.clone().with_parts(vec![page, long("a.js"), long("b.js")]));
        let packed = |answers: &Answers, index: usize| {
            let reply = Reply::Part { index, head_only: false, gzip: true };
            answers.to(&reply).0.contains("gzip")
        };
        let wait = |answers: &Answers, index: usize| {
            let begun = Instant::now();
            while !packed(answers, index) {
                assert!(begun.elapsed() < Duration::from_secs(20), "{index}");
                std::thread::sleep(Duration::from_millis(5));
            }
        };
        wait(&answers, 1);
        std::thread::sleep(Duration::from_millis(50));
        assert!(!packed(&answers, 2));
        wait(&answers, 0);
        wait(&answers, 2);
        let answers = Answers::new(&options.with_parts(vec![long("a.js"), long("b.js")]));
        wait(&answers, 0);
        wait(&answers, 1);
    }
}
