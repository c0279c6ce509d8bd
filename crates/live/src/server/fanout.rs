//! The thread that accepts, reads and writes.

use std::io;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use mio::net::{TcpListener, TcpStream};
use mio::{Events, Interest, Poll, Token, Waker};

use super::answers::Answers;
use super::client::{Client, GOING_AWAY, MOST_WAITING, PROTOCOL_ERROR, Stage, broken, frame};
use super::http::{Reply, reply};
use super::link::Link;
use super::{Command, Counted, Counters, RoomPublisher, ServerOptions, clock_us};
use crate::room::Room;
use crate::transport::Hello;
use crate::wire::{Message, Parting, Plane, Refusal};

const LISTENER: Token = Token(0);
const WAKER: Token = Token(1);
/// Tokens of clients begin here.
const FIRST: usize = 2;
/// Connections are looked over so often.
const SWEEP: Duration = Duration::from_millis(250);
/// A reader that takes nothing of what waits for it for so long is closed.
const PATIENCE: Duration = Duration::from_secs(20);
/// Readers may say nothing for so many times as long as senders: browsers hold back the timers of hidden pages.
const READERS_PATIENCE: u32 = 8;
/// Connections that the system keeps until they are accepted.
const BACKLOG: i32 = 1024;

/// The server's thread.
pub(super) struct Fanout {
    options: ServerOptions,
    answers: Answers,
    poll: Poll,
    listener: TcpListener,
    orders: Receiver<Command>,
    counters: Arc<Counters>,
    clients: Vec<Option<Client>>,
    free: Vec<usize>,
    open: usize,
    room: Room,
    /// Senders of this process: where they look whether an I plane is wanted.
    local: Vec<(u8, Arc<AtomicBool>)>,
    buffer: Vec<u8>,
    /// Whether somebody waits to be let in who could not be: the listener tells of newcomers alone.
    unaccepted: bool,
    ended: bool,
}

impl Fanout {
    pub fn new(
        options: ServerOptions,
        orders: Receiver<Command>,
        counters: Arc<Counters>,
    ) -> io::Result<(Self, SocketAddr, Waker)> {
        let poll = Poll::new()?;
        let mut listener = listen(options.bind)?;
        let address = listener.local_addr()?;
        poll.registry().register(&mut listener, LISTENER, Interest::READABLE)?;
        let waker = Waker::new(poll.registry(), WAKER)?;
        let fanout = Self {
            answers: Answers::new(&options),
            options,
            poll,
            listener,
            orders,
            counters,
            clients: Vec::new(),
            free: Vec::new(),
            open: 0,
            room: Room::default(),
            local: Vec::new(),
            buffer: vec![0; 16 << 10],
            unaccepted: false,
            ended: false,
        };
        Ok((fanout, address, waker))
    }

    pub fn run(mut self) -> io::Result<()> {
        let mut events = Events::with_capacity(1024);
        let mut swept = Instant::now();
        while !self.ended {
            match self.poll.poll(&mut events, Some(SWEEP)) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                other => other?,
            }
            self.obey();
            for event in &events {
                match event.token() {
                    LISTENER => self.accept(),
                    WAKER => {}
                    Token(token) => self.attend(token - FIRST),
                }
                // Planes do not wait for a crowd to be let in.
                self.obey();
            }
            let now = Instant::now();
            if now.duration_since(swept) >= SWEEP {
                swept = now;
                self.sweep(now);
                if self.unaccepted {
                    self.accept();
                }
                self.count_those_here();
            }
        }
        Ok(())
    }

    fn count(&self, change: impl FnOnce(&mut Counted)) {
        change(&mut self.counters.lock().unwrap_or_else(PoisonError::into_inner));
    }

    fn count_those_here(&self) {
        let viewers = self.clients.iter().flatten().filter(|c| matches!(c.stage, Stage::Open(_))).count();
        self.count(|counted| {
            (counted.viewers, counted.connections) = (viewers, self.open);
            counted.senders = self.room.senders();
        });
    }

    /// Does what this process wants.
    fn obey(&mut self) {
        while let Ok(command) = self.orders.try_recv() {
            match command {
                Command::Enter(commands, reply) => {
                    let publisher = self.room.enter().ok().map(|number| RoomPublisher::new(number, commands));
                    self.local.extend(publisher.iter().map(|own| (own.number, Arc::clone(&own.wanted))));
                    // One that nobody takes is dropped, and leaves.
                    let _ = reply.send(publisher);
                }
                Command::Hello(number, hello) => {
                    if let Ok(told) = self.room.announce(number, hello) {
                        self.tell(&told);
                    }
                }
                Command::Planes(number, planes) => {
                    // Senders of this process send no other planes than the encoder makes.
                    if let Ok(deliveries) = self.room.publish(number, planes) {
                        deliveries.iter().for_each(|delivery| self.deliver(delivery));
                    }
                }
                Command::Leave(number, parting) => {
                    self.local.retain(|(local, _)| *local != number);
                    let told = self.room.leave(number, parting);
                    self.tell(&told);
                }
                Command::Stop => {
                    let now = Instant::now();
                    for client in self.clients.iter_mut().flatten() {
                        client.part(GOING_AWAY, "", now);
                    }
                    self.ended = true;
                }
            }
        }
    }

    fn accept(&mut self) {
        use io::ErrorKind::{ConnectionAborted, ConnectionReset, Interrupted, WouldBlock};
        self.unaccepted = false;
        loop {
            match self.listener.accept() {
                Ok((socket, _)) => {
                    // Nothing is owed to one who comes when there is no room.
                    if self.admit(socket).is_err() {
                        self.count(|counted| counted.refused += 1);
                    }
                }
                // One that went away already.
                Err(error) if [Interrupted, ConnectionAborted, ConnectionReset].contains(&error.kind()) => {}
                Err(error) if error.kind() == WouldBlock => return,
                // Where no handle is left, one is there again behind the oldest that has not asked yet.
                Err(error) if is_out_of_handles(&error) && self.make_room() => {}
                Err(_) => {
                    self.unaccepted = true;
                    return;
                }
            }
        }
    }

    /// Closes the one that has been about to ask, or has taken nothing of its answer, for longest; false where there is none.
    fn make_room(&mut self) -> bool {
        let all = self.clients.iter().enumerate();
        let young =
            all.filter_map(|(n, client)| Some((client.as_ref().filter(|c| c.is_young())?.idle_since(), n)));
        let idlest = young.min().map(|(_, n)| n);
        idlest.into_iter().for_each(|n| self.close(n));
        idlest.is_some()
    }

    fn admit(&mut self, mut socket: TcpStream) -> io::Result<()> {
        let now = Instant::now();
        let [most, most_new] = self.options.connections;
        let count = self.clients.iter().flatten().filter(|client| client.is_young()).count();
        if (self.open >= most || count >= most_new) && !self.make_room() {
            return Err(io::Error::other("full"));
        }
        socket.set_nodelay(true)?;
        let index = self.free.pop().unwrap_or_else(|| {
            self.clients.push(None);
            self.clients.len() - 1
        });
        let interest = Interest::READABLE | Interest::WRITABLE;
        if let Err(error) = self.poll.registry().register(&mut socket, Token(FIRST + index), interest) {
            self.free.push(index);
            return Err(error);
        }
        let link = match self.link(socket) {
            Ok(link) => link,
            Err(error) => {
                self.free.push(index);
                return Err(error);
            }
        };
        self.clients[index] = Some(Client::new(link, now));
        self.open += 1;
        Ok(())
    }

    #[cfg(feature = "tls")]
    fn link(&self, socket: TcpStream) -> io::Result<Link> {
        let link = Link::new(socket);
        let Some(tls) = &self.options.tls else { return Ok(link) };
        let connection = rustls::ServerConnection::new(Arc::clone(&tls.0)).map_err(io::Error::other)?;
        Ok(link.with_tls(connection))
    }

    #[cfg(not(feature = "tls"))]
    #[allow(clippy::unnecessary_wraps)]
    fn link(&self, socket: TcpStream) -> io::Result<Link> {
        Ok(Link::new(socket))
    }

    /// Something can be read or written.
    fn attend(&mut self, index: usize) {
        if let Err(error) = self.exchange(index) {
            self.count(|counted| counted.refused += 1);
            if let Some(Some(client)) = self.clients.get_mut(index) {
                let now = Instant::now();
                if error.kind() == io::ErrorKind::InvalidData {
                    client.part(PROTOCOL_ERROR, &error.to_string(), now);
                }
                // What TLS says of it.
                let _ = client.flush(now);
            }
            self.close(index);
        } else if self
            .clients
            .get(index)
            .is_some_and(|c| c.as_ref().is_some_and(|c| c.leaving && c.is_done()))
        {
            self.close(index);
        }
    }

    fn exchange(&mut self, index: usize) -> io::Result<()> {
        let now = Instant::now();
        let mut buffer = std::mem::take(&mut self.buffer);
        let result = self.exchange_with(index, &mut buffer, now);
        self.buffer = buffer;
        result?;
        match self.clients.get_mut(index) {
            Some(Some(client)) => client.flush(now),
            _ => Ok(()),
        }
    }

    fn exchange_with(&mut self, index: usize, buffer: &mut [u8], now: Instant) -> io::Result<()> {
        loop {
            let Some(Some(client)) = self.clients.get_mut(index) else { return Ok(()) };
            client.flush(now)?;
            let Some(bytes) = client.read(buffer, now)? else { return Ok(()) };
            let messages = match &mut client.stage {
                // What comes behind the request that is being answered is of no interest.
                Stage::Answer => Vec::new(),
                Stage::Request(head) => {
                    head.extend(bytes);
                    let head = std::mem::take(head);
                    self.asked(index, head)?
                }
                Stage::Open(_) => {
                    client.heard = now;
                    client.messages(bytes)?
                }
            };
            for message in messages {
                self.heard(index, &message, now)?;
            }
        }
    }

    /// Answers a request, if it is whole.
    fn asked(&mut self, index: usize, head: Vec<u8>) -> io::Result<Vec<Vec<u8>>> {
        let Some(Some(client)) = self.clients.get_mut(index) else { return Ok(Vec::new()) };
        let Some((reply, length)) = reply(&head, &self.options) else {
            client.stage = Stage::Request(head);
            return Ok(Vec::new());
        };
        let (answer, body) = self.answers.to(&reply);
        if let Reply::Upgrade { .. } = reply {
            client.heard = Instant::now();
            let messages = client.open(&answer, head.get(length..).unwrap_or_default())?;
            self.welcome(index)?;
            return Ok(messages);
        }
        client.answer(&answer, body)?;
        if let Reply::Error(..) = reply {
            self.count(|counted| counted.refused += 1);
        }
        Ok(Vec::new())
    }

    /// Tells one who has come what there is.
    fn welcome(&mut self, index: usize) -> io::Result<()> {
        let Some(Some(client)) = self.clients.get_mut(index) else { return Ok(()) };
        let Stage::Open(open) = &mut client.stage else { return Ok(()) };
        let (told, missing) = self.room.welcome(&mut open.following);
        for message in told {
            client.queue(&frame(&message))?;
        }
        let now = Instant::now();
        for sender in missing {
            self.want_intra(sender, now);
        }
        Ok(())
    }

    /// Does what a client says.
    fn heard(&mut self, index: usize, bytes: &[u8], now: Instant) -> io::Result<()> {
        let Some(Some(client)) = self.clients.get_mut(index) else { return Ok(()) };
        let Stage::Open(open) = &mut client.stage else { return Ok(()) };
        let messages = open.expander.read_all(bytes).map_err(broken)?;
        client.charge(handed_on(&messages))?;
        // Planes one behind the other go on together.
        let mut planes = Vec::new();
        for message in messages {
            if let Message::Plane(plane) = message {
                planes.push(plane);
            } else {
                self.publish(index, std::mem::take(&mut planes))?;
                self.said(index, message, now)?;
            }
        }
        self.publish(index, planes)
    }

    /// Hands on the planes of a client.
    fn publish(&mut self, index: usize, planes: Vec<Plane>) -> io::Result<()> {
        let Some(Some(Client { stage: Stage::Open(open), .. })) = self.clients.get(index) else {
            return Ok(());
        };
        match open.sender {
            _ if planes.is_empty() => {}
            Some(number) => {
                let deliveries = self.room.publish(number, planes).map_err(broken)?;
                deliveries.iter().for_each(|delivery| self.deliver(delivery));
            }
            None if open.refused => {}
            None => return Err(nothing_told("plane")),
        }
        Ok(())
    }

    /// Does what a message says that is no plane.
    fn said(&mut self, index: usize, message: Message, now: Instant) -> io::Result<()> {
        let Some(Some(client)) = self.clients.get_mut(index) else { return Ok(()) };
        let Stage::Open(open) = &mut client.stage else { return Ok(()) };
        match message {
            Message::Ping { mark } => {
                let pong = Message::Pong { mark, clock_us: clock_us() }.bytes();
                client.send(&frame(&pong), now)?;
            }
            Message::Hello { hands, record, .. } => {
                let number = match open.sender {
                    Some(number) => Ok(number),
                    None if self.options.senders => self.room.enter().map_err(|_| Refusal::Full),
                    None => Err(Refusal::Closed),
                };
                let number = match number {
                    Ok(number) => number,
                    Err(refusal) => {
                        open.refused = true;
                        return client.send(&frame(&Message::Refused { refusal }.bytes()), now);
                    }
                };
                (open.sender, open.refused) = (Some(number), false);
                client.send(&frame(&Message::Welcome { sender: number }.bytes()), now)?;
                let told = self.room.announce(number, Hello { hands, record }).map_err(broken)?;
                self.tell(&told);
            }
            Message::End { .. } => {
                // The end of one who was no sender is nothing.
                if let Some(number) = open.sender.take() {
                    let told = self.room.leave(number, Parting::Left);
                    self.tell(&told);
                }
            }
            Message::Intra { sender } => self.want_intra(sender, now),
            other => return Err(nothing_told(other.kind())),
        }
        Ok(())
    }

    /// Asks a sender for an I plane, later where it was asked just now.
    fn want_intra(&mut self, sender: u8, now: Instant) {
        if self.room.may_ask(sender, now) {
            self.ask_intra(sender);
        }
    }

    fn ask_intra(&mut self, sender: u8) {
        if let Some((_, wanted)) = self.local.iter().find(|(local, _)| *local == sender) {
            wanted.store(true, Ordering::Relaxed);
            return;
        }
        let bytes = frame(&Message::Intra { sender }.bytes());
        let is_sender =
            |client: &&mut Client| matches!(&client.stage, Stage::Open(o) if o.sender == Some(sender));
        if let Some(client) = self.clients.iter_mut().flatten().find(is_sender) {
            // One that is at its end is noticed when it is read from.
            let _ = client.send(&bytes, Instant::now());
        }
    }

    /// Hands planes to everybody who can read them.
    fn deliver(&mut self, delivery: &crate::room::Delivery) {
        let begun = Instant::now();
        let bytes = frame(&delivery.bytes);
        let (mut given, mut left_out, mut waits) = (0, 0, false);
        let mut ended = Vec::new();
        for (index, slot) in self.clients.iter_mut().enumerate() {
            let Some(client) = slot else { continue };
            let ready = client.waiting() <= MOST_WAITING;
            let Stage::Open(open) = &mut client.stage else { continue };
            if !delivery.is_for(&mut open.following, ready) {
                left_out += 1;
                waits |= ready;
            } else if client.send(&bytes, begun).is_ok() {
                given += 1;
            } else {
                ended.push(index);
            }
        }
        self.count(|counted| {
            counted.payload += delivery.payload as u64;
            counted.messages += 1;
            counted.bytes += bytes.len() as u64;
            counted.deliveries += given;
            counted.skipped += left_out;
            counted.fanout_ns += u64::try_from(begun.elapsed().as_nanos()).unwrap_or_default();
        });
        ended.into_iter().for_each(|index| self.close(index));
        // One that missed planes of this period, and hears of none, cannot ask by itself.
        if waits && self.room.may_mend(delivery.sender, begun) {
            self.ask_intra(delivery.sender);
        }
    }

    /// Tells everybody something that is no plane.
    fn tell(&mut self, bytes: &[u8]) {
        if bytes.is_empty() {
            return;
        }
        let (bytes, now) = (frame(bytes), Instant::now());
        let mut ended = Vec::new();
        for (index, slot) in self.clients.iter_mut().enumerate() {
            if let Some(client) = slot
                && matches!(client.stage, Stage::Open(_))
                && client.send(&bytes, now).is_err()
            {
                ended.push(index);
            }
        }
        ended.into_iter().for_each(|index| self.close(index));
    }

    /// Ends a connection; a sender behind it has left where it said so, else it is gone.
    fn close(&mut self, index: usize) {
        let Some(mut client) = self.clients.get_mut(index).and_then(Option::take) else { return };
        let _ = self.poll.registry().deregister(client.link.socket());
        let _ = client.link.socket().shutdown(std::net::Shutdown::Write);
        self.free.push(index);
        self.open -= 1;
        if let Stage::Open(open) = &client.stage
            && let Some(number) = open.sender
        {
            let parting = if open.parted { Parting::Left } else { Parting::Gone };
            let told = self.room.leave(number, parting);
            self.tell(&told);
        }
    }

    /// Closes those whose time is over, and asks for what it was too early to ask for.
    fn sweep(&mut self, now: Instant) {
        let options = &self.options;
        let over = |client: &Client| {
            let quiet = match client.stage {
                Stage::Open(ref open) => {
                    let patience = if open.sender.is_some() { 1 } else { READERS_PATIENCE };
                    now.duration_since(client.heard) > patience * options.silence
                }
                Stage::Request(_) => now.duration_since(client.since) > options.request_time,
                Stage::Answer => now.duration_since(client.since) > options.answer_time,
            };
            quiet || client.is_stuck(now, PATIENCE)
        };
        let all = self.clients.iter().enumerate();
        let ended: Vec<usize> =
            all.filter(|(_, client)| client.as_ref().is_some_and(over)).map(|(index, _)| index).collect();
        for index in ended {
            self.count(|counted| counted.refused += 1);
            self.close(index);
        }
        for sender in self.room.overdue(now) {
            self.ask_intra(sender);
        }
    }
}

/// How often messages that came together are handed on or answered: planes behind one another go on as one.
fn handed_on(messages: &[Message]) -> usize {
    let goes_on =
        |pair: &&[Message]| matches!(pair, [Message::Plane(_), Message::Plane(plane)] if !plane.opens());
    messages.len() - messages.windows(2).filter(goes_on).count()
}

/// What came is of a kind that only rooms say, or comes without a hello.
fn nothing_told(kind: &str) -> io::Error {
    broken(format!("nothing that a room is told: {kind}"))
}

/// A socket that listens; at `[::]` by IPv4 as well, which not every system does by itself.
fn listen(at: SocketAddr) -> io::Result<TcpListener> {
    use socket2::{Domain, Protocol, Socket, Type};
    let SocketAddr::V6(v6) = at else { return TcpListener::bind(at) };
    let socket = Socket::new(Domain::IPV6, Type::STREAM, Some(Protocol::TCP))?;
    if v6.ip().is_unspecified() {
        // A system that has not both listens by IPv6 alone.
        let _ = socket.set_only_v6(false);
    }
    // Where a server was a moment ago; on Windows it would let two listen at one port.
    if cfg!(not(windows)) {
        socket.set_reuse_address(true)?;
    }
    socket.bind(&at.into())?;
    socket.listen(BACKLOG)?;
    socket.set_nonblocking(true)?;
    Ok(TcpListener::from_std(socket.into()))
}

/// Whether a process, or the system, can open no more files and sockets.
fn is_out_of_handles(error: &io::Error) -> bool {
    // WSAEMFILE; ENFILE and EMFILE.
    let codes: &[i32] = if cfg!(windows) { &[10024] } else { &[23, 24] };
    error.raw_os_error().is_some_and(|code| codes.contains(&code))
}
