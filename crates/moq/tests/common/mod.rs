//! Relays and links between them.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, dead_code)]

use std::collections::VecDeque;
use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::sleep;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use handcast_moq::MoqOptions;
use url::Url;

/// A relay on a free port of its own.
pub struct Relay {
    child: Child,
    pub port: u16,
    pub fingerprint: String,
}

impl Relay {
    /// Starts one, a member of the cluster of `peer`.
    pub fn start(peer: Option<&Relay>) -> Self {
        Self::start_by(peer.map(|peer| (peer.port, peer)))
    }

    /// Starts one that reaches a peer by a port.
    pub fn start_by(peer: Option<(u16, &Relay)>) -> Self {
        let program = std::env::var_os("HANDCAST_MOQ_RELAY").unwrap_or_else(|| "moq-relay".into());
        let port = free_port();
        let address = format!("127.0.0.1:{port}");
        let mut command = Command::new(program);
        command.args(["--listen", &address, "--web-http-listen", &address]);
        command.args(["--listen-tls-generate", "localhost", "--auth-public", "**"]);
        if let Some((port, peer)) = peer {
            let url = format!("https://localhost:{port}/");
            command.args(["--cluster-connect", &url, "--connect-tls-fingerprint", &peer.fingerprint]);
        }
        let child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn();
        let child = child.expect("moq-relay runs: cargo install moq-relay --version =0.17.10");
        let end = Instant::now() + Duration::from_secs(20);
        loop {
            match fingerprint(port) {
                Some(fingerprint) => return Self { child, port, fingerprint },
                None => assert!(Instant::now() < end, "the relay does not answer"),
            }
            sleep(Duration::from_millis(50));
        }
    }

    pub fn url(&self) -> Url {
        format!("https://localhost:{}/", self.port).parse().unwrap()
    }

    pub fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A port that is free for TCP and UDP.
pub fn free_port() -> u16 {
    loop {
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        if UdpSocket::bind(("127.0.0.1", port)).is_ok() {
            return port;
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

pub fn options(relays: &[&Relay]) -> MoqOptions {
    MoqOptions::default().with_fingerprints(relays.iter().map(|relay| relay.fingerprint.clone()).collect())
}

pub fn urls(relays: &[&Relay]) -> Vec<Url> {
    relays.iter().map(|relay| relay.url()).collect()
}

pub fn now_ms() -> u32 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_millis() as u32
}

/// A link that passes packets on after a delay and loses some of them.
pub struct Link {
    pub port: u16,
    stop: Arc<AtomicBool>,
}

impl Link {
    pub fn start(to: u16, delay: Duration, loss: f64) -> Self {
        let [near, far] = [(); 2].map(|()| {
            let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
            socket.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
            Arc::new(socket)
        });
        let port = near.local_addr().unwrap().port();
        let stop = Arc::new(AtomicBool::new(false));
        let client = Arc::new(Mutex::new(None));
        for back in [false, true] {
            let (from, into) = if back { (&far, &near) } else { (&near, &far) };
            let (from, into) = (Arc::clone(from), Arc::clone(into));
            let (stop, client) = (Arc::clone(&stop), Arc::clone(&client));
            std::thread::spawn(move || {
                let mut waiting = VecDeque::new();
                let mut random = 0x2545_f491_4f6c_dd1du64 + u64::from(back);
                let mut bytes = [0; 2048];
                while !stop.load(Ordering::Relaxed) {
                    if let Ok((length, address)) = from.recv_from(&mut bytes) {
                        if !back {
                            *client.lock().unwrap() = Some(address);
                        }
                        random ^= random << 13;
                        random ^= random >> 7;
                        random ^= random << 17;
                        if (random >> 11) as f64 / (1u64 << 53) as f64 >= loss {
                            waiting.push_back((Instant::now() + delay, bytes[..length].to_vec()));
                        }
                    }
                    while waiting.front().is_some_and(|(due, _)| *due <= Instant::now()) {
                        let (_, packet) = waiting.pop_front().unwrap();
                        let there =
                            if back { *client.lock().unwrap() } else { Some(([127, 0, 0, 1], to).into()) };
                        there.map(|there| into.send_to(&packet, there));
                    }
                }
            });
        }
        Self { port, stop }
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}
