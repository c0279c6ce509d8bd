//! `handcast-moq`: joins the room of an embedded server with a room on relays.

mod bench;

use std::collections::HashSet;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::Context as _;
use clap::{Parser, Subcommand};
use handcast_live::client::RoomClient;
use handcast_live::server::{Server, ServerOptions};
use handcast_live::transport::{Hello, Publish, Subscribe as _, TransportError};
use handcast_live::wire::{Message, Plane};
use handcast_moq::page::Place;
use handcast_moq::{MoqOptions, MoqPublisher, MoqSubscriber, bridge};
use url::Url;

/// Rooms of moving hands over Media over QUIC relays
#[derive(Debug, Parser)]
#[command(name = "handcast-moq", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Carries the senders of a server's room to the relays, and those of the relays into the room
    Join(BridgeArgs),
    /// Carries the senders of a server's room to the relays
    Publish(BridgeArgs),
    /// Carries the senders on the relays into a server's room
    Subscribe(BridgeArgs),
    /// Says once a second what comes from the relays
    Watch(RelayArgs),
    /// Serves, or writes, the page of a room for people whom the relays serve: no server of hands is between
    Page(PageArgs),
    /// Measures relays that it starts on this machine: delays, losses, joiners, and a relay that is killed
    Bench(bench::Args),
}

/// Where the relays are.
#[derive(Clone, Debug, clap::Args)]
struct RelayArgs {
    /// Relay, as https://HOST:PORT/PATH (WebTransport, then WebSocket) or wss://…; given several times, the next where one is lost
    #[arg(long = "relay", value_name = "URL", required = true)]
    relays: Vec<Url>,
    /// Room on the relays
    #[arg(long, value_name = "NAME", default_value = "handcast")]
    room: String,
    /// PEM file with certificates to trust in place of the system's
    #[arg(long = "root", value_name = "FILE")]
    roots: Vec<PathBuf>,
    /// SHA-256 of a relay's own certificate, in hex, as its /certificate.sha256 says
    #[arg(long = "fingerprint", value_name = "HEX")]
    fingerprints: Vec<String>,
}

impl RelayArgs {
    fn options(&self) -> MoqOptions {
        MoqOptions::default().with_roots(self.roots.clone()).with_fingerprints(self.fingerprints.clone())
    }
}

/// Where the relays and the server are.
#[derive(Clone, Debug, clap::Args)]
struct BridgeArgs {
    #[command(flatten)]
    relay: RelayArgs,
    /// Room of an embedded server, as `handcast live` prints it: http://HOST:PORT/ROOM#token=TOKEN
    #[arg(long, value_name = "URL")]
    server: Url,
}

/// The page of a room.
#[derive(Clone, Debug, clap::Args)]
struct PageArgs {
    #[command(flatten)]
    relay: RelayArgs,
    /// Library of the page: npm ci --prefix crates/moq/page && npm run --prefix crates/moq/page bundle
    #[arg(long, value_name = "FILE", default_value = "crates/moq/page/moq-net.js")]
    library: PathBuf,
    /// Where to serve it. Other machines take cameras and WebTransport by HTTPS alone: for them --out and a server of files
    #[arg(long, value_name = "ADDR:PORT", default_value = "127.0.0.1:8748")]
    bind: SocketAddr,
    /// Write the files into this folder, made where it is missing, and serve nothing
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
}

impl BridgeArgs {
    /// Address, room and token of the server.
    fn server(&self) -> Result<(&str, u16, &str, &str), TransportError> {
        let refused = |why| TransportError::Refused { why };
        if self.server.scheme() != "http" {
            return Err(refused(format!(
                "{}: only servers without TLS can be joined, by http://",
                self.server
            )));
        }
        let host = self.server.host_str().unwrap_or_default();
        let room = self.server.path().trim_matches('/');
        let token = self.server.fragment().and_then(|f| f.strip_prefix("token=")).unwrap_or_default();
        if host.is_empty() || room.is_empty() {
            return Err(refused(format!("{}: expected http://HOST:PORT/ROOM#token=TOKEN", self.server)));
        }
        // Brackets of an IPv6 address are the URL's.
        let host = host.trim_start_matches('[').trim_end_matches(']');
        Ok((host, self.server.port_or_known_default().unwrap_or(80), room, token))
    }

    fn enter(&self) -> Result<RoomClient, TransportError> {
        let (host, port, room, token) = self.server()?;
        RoomClient::connect((host, port), room, token)
    }
}

/// A sender of the relays in the server's room. What is said there is let by, or the server would take it for stuck. While its
/// hands rest its hellos keep it there.
struct Guest(RoomClient);

impl Guest {
    fn let_by(&mut self) -> Result<(), TransportError> {
        while self.0.next(Duration::ZERO)?.is_some() {}
        Ok(())
    }
}

impl Publish for Guest {
    fn hello(&mut self, hello: &Hello) -> Result<(), TransportError> {
        self.let_by()?;
        self.0.hello(hello)
    }

    fn planes(&mut self, planes: &[Plane]) -> Result<(), TransportError> {
        self.let_by()?;
        self.0.planes(planes)
    }

    fn wants_intra(&mut self) -> bool {
        self.0.wants_intra()
    }

    fn end(&mut self) -> Result<(), TransportError> {
        self.0.end()
    }
}

fn main() -> std::process::ExitCode {
    // Relays are dialled for ever: what keeps them from answering is said, on standard error.
    if let Err(error) = moq_tokio::Log::new(tracing::Level::WARN).init() {
        eprintln!("handcast-moq: {error}");
    }
    let done = match Cli::parse().command {
        Command::Join(args) => join(&args, [true, true]),
        Command::Publish(args) => join(&args, [true, false]),
        Command::Subscribe(args) => join(&args, [false, true]),
        Command::Watch(args) => watch(&args),
        Command::Page(args) => page(&args),
        Command::Bench(args) => bench::run(&args),
    };
    match done {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("handcast-moq: {error:#}");
            std::process::ExitCode::FAILURE
        }
    }
}

/// A URL without what may be secret in it.
fn at(url: &Url) -> String {
    url.origin().ascii_serialization()
}

/// Joins the rooms, out of the server's and into it.
fn join(args: &BridgeArgs, [out, into]: [bool; 2]) -> anyhow::Result<()> {
    let options = args.relay.options();
    let (relays, room) = (&args.relay.relays, &args.relay.room);
    // Told apart from other machines in the room, and from an earlier run on this one.
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let me = format!("{:x}-{:x}", now.as_micros(), std::process::id());
    let mut server = args.enter().with_context(|| format!("the server at {}", at(&args.server)))?;
    let [ours, theirs]: [Mutex<HashSet<u8>>; 2] = [Mutex::default(), Mutex::default()];
    let ended = AtomicBool::new(false);
    let go_on = || !ended.load(Ordering::Relaxed);
    eprintln!("joined {} with {room} on {}, Ctrl-C ends it", at(&args.server), at(&relays[0]));
    std::thread::scope(|scope| {
        let end = |done: Result<(), TransportError>| {
            ended.store(true, Ordering::Relaxed);
            done
        };
        let inward = into.then(|| {
            let mut subscriber = MoqSubscriber::connect_but(relays, room, Some(&me), &options);
            let open = |_: u8, hello: &Hello| {
                let mut end = Guest(args.enter()?);
                end.hello(hello)?;
                let number = end.0.number();
                Ok((end, number))
            };
            let (theirs, ours) = (&theirs, &ours);
            scope.spawn(move || match &mut subscriber {
                Ok(subscriber) => end(bridge(subscriber, open, theirs, ours, go_on)),
                Err(error) => end(Err(TransportError::Closed { why: error.to_string() })),
            })
        });
        let outward = out.then(|| {
            let open = |sender: u8, hello: &Hello| {
                let mut end = MoqPublisher::connect(relays, room, &format!("{me}-{sender}"), &options)?;
                end.hello(hello)?;
                Ok((end, None))
            };
            end(bridge(&mut server, open, &ours, &theirs, go_on))
        });
        let inward =
            inward.map(|thread| thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
        for done in [outward, inward].into_iter().flatten() {
            done?;
        }
        Ok(())
    })
}

/// Writes the page, or serves it until it is killed.
fn page(args: &PageArgs) -> anyhow::Result<()> {
    let RelayArgs { relays, room, fingerprints, roots } = &args.relay;
    anyhow::ensure!(
        roots.is_empty(),
        "--root: browsers trust the system's certificates, or those of --fingerprint"
    );
    let place = Place { relays, room, fingerprints };
    let library = std::fs::read(&args.library).with_context(|| {
        format!("{}: npm ci and npm run bundle in crates/moq/page make it", args.library.display())
    })?;
    let parts = place.parts(&library)?;
    let Some(folder) = &args.out else {
        // One room of this name, which nobody enters: all speak with the relays.
        let options =
            ServerOptions::new(args.bind).with_parts(parts).with_policy(place.policy()).with_senders(false);
        let server = Server::start(options).with_context(|| format!("cannot serve at {}", args.bind))?;
        println!("http://{}/hand", server.address());
        loop {
            std::thread::park();
        }
    };
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    for part in parts {
        let file = folder.join(if part.name.is_empty() { "index.html" } else { &part.name });
        std::fs::write(&file, &part.bytes).with_context(|| file.display().to_string())?;
    }
    Ok(())
}

/// Prints what comes.
fn watch(args: &RelayArgs) -> anyhow::Result<()> {
    let mut room = MoqSubscriber::connect(&args.relays, &args.room, &args.options())?;
    let mut told = Instant::now();
    let mut ages: Vec<u32> = Vec::new();
    let mut there = HashSet::new();
    loop {
        match room.next(Duration::from_millis(100))? {
            Some(Message::Plane(plane)) if !plane.replay => {
                let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
                ages.push((now.as_millis() as u32).wrapping_sub(plane.time_ms));
            }
            // They are repeated.
            Some(Message::Hello { sender, .. }) if there.insert(sender) => {
                println!("sender {sender} is there")
            }
            Some(Message::End { sender, parting }) => {
                there.remove(&sender);
                println!("sender {sender}: {parting:?}");
            }
            _ => {}
        }
        if told.elapsed() >= Duration::from_secs(1) {
            told = Instant::now();
            ages.sort_unstable();
            let at = |share: usize| ages.get(ages.len() * share / 100).copied().unwrap_or_default();
            println!("{} planes, age p50 {} ms, p95 {} ms", ages.len(), at(50), at(95));
            ages.clear();
        }
    }
}
