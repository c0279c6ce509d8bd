//! Rooms at a real socket: joiners, senders that vanish, readers that are slow, clients that mean harm.

#![cfg(feature = "server")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[cfg(feature = "tls")]
#[path = "room/tls.rs"]
mod tls;

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

use handcast_live::client::RoomClient;
use handcast_live::lossy::{LossyOptions, lossy_way};
use handcast_live::server::{Part, Server, ServerOptions};
use handcast_live::transport::{Hello, Publish, Subscribe, TransportError};
use handcast_live::wire::{MAX_SENDERS, Message, Parting, Plane};

const SECOND: Duration = Duration::from_secs(1);
const TOKEN: &str = "abcdefgh";

fn options() -> ServerOptions {
    let parts = vec![Part::new("", "text/html", "the page")];
    ServerOptions::new("127.0.0.1:0".parse().unwrap()).with_room("r").with_token(TOKEN).with_parts(parts)
}

fn server() -> Server {
    Server::start(options()).unwrap()
}

fn join(server: &Server) -> RoomClient {
    RoomClient::connect(server.address(), "r", TOKEN).unwrap()
}

/// A room with a viewer, and a sender who has said hello.
fn viewed() -> (Server, RoomClient, RoomClient) {
    let server = server();
    let viewer = join(&server);
    let mut sender = join(&server);
    sender.hello(&Hello::default()).unwrap();
    (server, viewer, sender)
}

fn plane(period: u16, index: u16, length: usize) -> Plane {
    let mut payload = vec![7; length];
    if index == 0 {
        payload[..4].copy_from_slice(&[0, 0, 1, 0xbb]);
    }
    Plane {
        period,
        index,
        time_ms: u32::from(period) * 330 + u32::from(index) * 33,
        payload,
        ..Plane::default()
    }
}

/// The next plane; other messages are passed over.
fn next_plane(client: &mut RoomClient) -> Plane {
    let end = Instant::now() + 10 * SECOND;
    loop {
        match client.next(SECOND).unwrap() {
            Some(Message::Plane(plane)) => return plane,
            _ => assert!(Instant::now() < end, "no plane comes"),
        }
    }
}

/// The end of a sender; planes are passed over.
fn parting(client: &mut RoomClient) -> Parting {
    let end = Instant::now() + 10 * SECOND;
    loop {
        match client.next(SECOND).unwrap() {
            Some(Message::End { parting, .. }) => return parting,
            _ => assert!(Instant::now() < end, "no end comes"),
        }
    }
}

#[test]
fn two_senders_and_a_viewer() {
    let server = server();
    let mut viewer = join(&server);
    let mut own = server.publisher().unwrap();
    own.hello(&Hello { hands: [true, false], record: vec![1, 2] }).unwrap();
    let mut other = join(&server);
    other.hello(&Hello { hands: [false, true], record: vec![] }).unwrap();
    assert_eq!((own.number(), other.number()), (0, Some(1)));
    own.planes(&[plane(0, 0, 40)]).unwrap();
    assert_eq!(next_plane(&mut viewer), plane(0, 0, 40));
    other.planes(&[plane(9, 0, 30), plane(9, 1, 8)]).unwrap();
    for index in 0..2 {
        let found = next_plane(&mut viewer);
        assert_eq!((found.sender, found.period, found.index), (1, 9, index));
    }
    // A sender hears the others, too.
    assert_eq!(next_plane(&mut other), plane(0, 0, 40));
    viewer.request_intra(0).unwrap();
    viewer.request_intra(1).unwrap();
    let end = Instant::now() + 5 * SECOND;
    let (mut first, mut second) = (false, false);
    while !(first && second) {
        assert!(Instant::now() < end, "{first} {second}");
        first |= own.wants_intra();
        second |= other.wants_intra();
    }
    viewer.request_intra(0).unwrap();
    std::thread::sleep(SECOND / 5);
    assert!(!own.wants_intra(), "asked twice within a second");
    drop(other);
    assert_eq!(parting(&mut viewer), Parting::Gone);
    own.end().unwrap();
    assert_eq!(parting(&mut viewer), Parting::Left);
    assert_eq!(server.counted().payload, 78);
}

#[test]
fn a_sender_that_never_reads_is_asked_and_told() {
    let (server, mut viewer, mut sender) = viewed();
    for index in 0..100 {
        sender.planes(&[plane(0, index, 40)]).unwrap();
        next_plane(&mut viewer);
    }
    viewer.request_intra(0).unwrap();
    std::thread::sleep(SECOND / 2);
    assert!(sender.wants_intra(), "its own planes come before the wish");
    server.stop().unwrap();
    assert!(server.has_ended());
    std::thread::sleep(SECOND / 5);
    assert!(!sender.wants_intra());
    assert!(sender.planes(&[plane(0, 100, 40)]).is_err());
}

#[test]
fn many_planes_at_once_come_in_several_messages() {
    let server = server();
    let mut viewer = join(&server);
    let mut own = server.publisher().unwrap();
    let mut other = join(&server);
    other.hello(&Hello::default()).unwrap();
    let planes: Vec<Plane> = (0..20).map(|index| plane(0, index, 2000)).collect();
    for sender in [&mut own as &mut dyn Publish, &mut other] {
        sender.planes(&planes).unwrap();
        let found: Vec<u16> = planes.iter().map(|_| next_plane(&mut viewer).index).collect();
        assert_eq!(found, (0..20).collect::<Vec<u16>>());
    }
}

#[test]
fn both_kinds_of_addresses_are_listened_at() {
    let bind = "[::]:0".parse().unwrap();
    // There are machines without IPv6.
    let Ok(server) = Server::start(ServerOptions::new(bind).with_room("r").with_token(TOKEN)) else { return };
    for host in ["127.0.0.1", "::1"] {
        RoomClient::connect((host, server.address().port()), "r", TOKEN).unwrap();
    }
}

#[test]
fn two_hundred_join_at_once_and_see_the_period() {
    let server = server();
    let mut sender = server.publisher().unwrap();
    for index in 0..60 {
        sender.planes(&[plane(0, index, 40)]).unwrap();
    }
    let address = server.address();
    let watch = move || {
        let mut client = RoomClient::connect(address, "r", TOKEN).unwrap();
        let planes: Vec<Plane> = (0..61).map(|_| next_plane(&mut client)).collect();
        assert!(planes.iter().enumerate().all(|(n, p)| usize::from(p.index) == n && p.replay == (n < 59)));
    };
    let watchers: Vec<_> = (0..200).map(|_| std::thread::spawn(watch)).collect();
    let begun = Instant::now();
    while server.counted().viewers < 200 {
        assert!(begun.elapsed() < 20 * SECOND, "{:?}", server.counted());
        std::thread::sleep(SECOND / 50);
    }
    sender.planes(&[plane(0, 60, 40)]).unwrap();
    for watcher in watchers {
        watcher.join().unwrap();
    }
    assert_eq!(server.counted().skipped, 0);
}

#[test]
fn a_killed_sender_is_told_and_not_replayed() {
    let (server, mut viewer, mut sender) = viewed();
    sender.planes(&[plane(0, 0, 40)]).unwrap();
    next_plane(&mut viewer);
    drop(sender);
    assert_eq!(parting(&mut viewer), Parting::Gone);
    let mut late = join(&server);
    assert_eq!(late.next(SECOND / 2).unwrap(), None);
}

#[test]
fn a_silent_sender_is_gone() {
    let options = options().with_times(5 * SECOND, SECOND);
    let server = Server::start(options).unwrap();
    let mut sender = join(&server);
    sender.hello(&Hello::default()).unwrap();
    let (address, begun) = (server.address(), Instant::now());
    let viewer = std::thread::spawn(move || {
        let mut viewer = RoomClient::connect(address, "r", TOKEN).unwrap();
        loop {
            viewer.say(Message::Ping { mark: 1 }.bytes()).unwrap();
            std::thread::sleep(SECOND / 20);
            if let Some(Message::End { parting, .. }) = viewer.next(SECOND / 10).unwrap() {
                return parting;
            }
        }
    });
    assert_eq!(viewer.join().unwrap(), Parting::Gone);
    assert!(begun.elapsed() < 5 * SECOND);
    drop(sender);
}

#[test]
fn a_slow_reader_goes_on_with_an_i_plane_and_keeps_nobody_waiting() {
    let server = server();
    let mut sender = server.publisher().unwrap();
    let (mut slow, mut quick) = (join(&server), join(&server));
    slow.next(SECOND / 10).unwrap();
    quick.next(SECOND / 10).unwrap();
    // More than the kernel keeps for a socket, while `slow` reads nothing.
    let mut sent = 0;
    for period in 0..120 {
        for index in 0..10 {
            sender.planes(&[plane(period, index, 8000)]).unwrap();
            let begun = Instant::now();
            let found = next_plane(&mut quick);
            assert_eq!((found.period, found.index), (period, index));
            assert!(begun.elapsed() < 2 * SECOND);
            sent += 1;
        }
    }
    let mut got = Vec::new();
    let end = Instant::now() + 20 * SECOND;
    for period in 120.. {
        for index in 0..10 {
            sender.planes(&[plane(period, index, 20)]).unwrap();
        }
        while let Some(message) = slow.next(SECOND / 20).unwrap() {
            got.extend(if let Message::Plane(plane) = message {
                Some((plane.period, plane.index))
            } else {
                None
            });
        }
        if got.last().is_some_and(|(last, _)| *last == period) {
            break;
        }
        assert!(Instant::now() < end, "the slow reader never catches up");
    }
    assert!(got.len() < sent, "{} of {sent}", got.len());
    for pair in got.windows(2) {
        let goes_on = pair[1].0 == pair[0].0 && pair[1].1 == pair[0].1 + 1;
        assert!(goes_on || pair[1].1 == 0, "{pair:?}");
    }
    assert!(server.counted().skipped > 0);
}

/// It hears nothing of what it misses, and so the room asks for it.
#[test]
fn an_i_plane_is_asked_for_when_a_slow_reader_has_room_again() {
    let server = server();
    let mut sender = server.publisher().unwrap();
    let mut slow = join(&server);
    slow.next(SECOND / 10).unwrap();
    let mut index = 0;
    while server.counted().skipped == 0 {
        assert!(index < 1000, "everything goes somewhere");
        sender.planes(&[plane(0, index, 8000)]).unwrap();
        index += 1;
        std::thread::sleep(SECOND / 1000);
    }
    assert!(!sender.wants_intra(), "a reader that has no room is no reason");
    let end = Instant::now() + 10 * SECOND;
    while !sender.wants_intra() {
        assert!(Instant::now() < end, "nobody asks");
        while slow.next(SECOND / 50).unwrap().is_some() {}
        sender.planes(&[plane(0, index, 20)]).unwrap();
        index += 1;
    }
    sender.planes(&[plane(1, 0, 20)]).unwrap();
    assert_eq!(next_plane(&mut slow).period, 1);
}

/// A connection of which the kernel takes little before it is read.
fn narrow(address: SocketAddr) -> TcpStream {
    let socket = socket2::Socket::new(socket2::Domain::IPV4, socket2::Type::STREAM, None).unwrap();
    socket.set_recv_buffer_size(4096).unwrap();
    socket.connect(&address.into()).unwrap();
    socket.into()
}

/// What a server answers to a request.
fn ask(address: SocketAddr, request: &str) -> String {
    let mut socket = TcpStream::connect(address).unwrap();
    socket.set_read_timeout(Some(5 * SECOND)).unwrap();
    socket.write_all(request.as_bytes()).unwrap();
    let mut text = Vec::new();
    let _ = socket.read_to_end(&mut text);
    String::from_utf8_lossy(&text).into_owned()
}

#[test]
fn the_page_and_who_is_not_let_in() {
    let server = server();
    let address = server.address();
    let get = |path: &str, more: &str| {
        ask(address, &format!("GET {path} HTTP/1.1\r\nHost: {address}\r\n{more}\r\n"))
    };
    assert!(get("/r", "").ends_with("\r\n\r\nthe page"));
    assert!(get("/", "").starts_with("HTTP/1.1 302 Found\r\n"));
    assert!(get("/other", "").starts_with("HTTP/1.1 404 "));
    let upgrade = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: a2V5\r\n";
    assert!(get("/r/live?token=wrong", upgrade).starts_with("HTTP/1.1 403 "));
    let origin = format!("{upgrade}Origin: http://evil.example\r\n");
    assert!(get(&format!("/r/live?token={TOKEN}"), &origin).starts_with("HTTP/1.1 403 "));
    let host = format!("GET /r HTTP/1.1\r\nHost: evil.example\r\n{upgrade}\r\n");
    assert!(ask(address, &host).starts_with("HTTP/1.1 403 "));
    for (room, token) in [("r", "abcdefgi"), ("r", ""), ("q", TOKEN)] {
        let refused = RoomClient::connect(address, room, token);
        assert!(matches!(refused, Err(TransportError::Refused { .. })), "{room} {token}");
    }
    assert_eq!(server.counted().viewers, 0);
}

/// Whether a reader and a sender get through.
fn works(server: &Server) {
    let begun = Instant::now();
    let mut viewer = join(server);
    let mut sender = server.publisher().unwrap();
    sender.planes(&[plane(0, 0, 40)]).unwrap();
    next_plane(&mut viewer);
    sender.end().unwrap();
    assert!(begun.elapsed() < 2 * SECOND, "{:?}", begun.elapsed());
}

#[test]
fn half_open_connections_keep_nobody_out() {
    let server = server();
    let mut silent: Vec<TcpStream> = Vec::new();
    for number in 0..1000 {
        let mut socket = TcpStream::connect(server.address()).unwrap();
        if number % 2 == 0 {
            // Some begin a request, and never end it.
            let _ = socket.write_all(b"GET /r HTTP/1.1\r\nHost: ");
        }
        silent.push(socket);
    }
    works(&server);
    assert!(server.counted().connections <= 300, "{:?}", server.counted());
    drop(silent);
}

#[test]
fn heads_that_trickle_and_long_bodies_are_cut_off() {
    let server = Server::start(options().with_times(SECOND, 15 * SECOND)).unwrap();
    let address = server.address();
    let mut sockets: Vec<TcpStream> = (0..1000).map(|_| TcpStream::connect(address).unwrap()).collect();
    let begun = Instant::now();
    // A letter more now and then, which a deadline for silence alone would bear for ever.
    while begun.elapsed() < 3 * SECOND {
        for socket in &mut sockets {
            let _ = socket.write_all(b"G");
        }
        let page = ask(address, &format!("GET /r HTTP/1.1\r\nHost: {address}\r\n\r\n"));
        assert!(page.ends_with("the page"), "{page}");
        works(&server);
    }
    let end = Instant::now() + 5 * SECOND;
    while server.counted().connections > 0 {
        assert!(Instant::now() < end, "{:?}", server.counted());
        std::thread::sleep(SECOND / 20);
    }
    let mut socket = TcpStream::connect(address).unwrap();
    let head = format!("POST /r HTTP/1.1\r\nHost: {address}\r\nContent-Length: 99999999999\r\n\r\n");
    socket.write_all(head.as_bytes()).unwrap();
    socket.set_write_timeout(Some(SECOND)).unwrap();
    let begun = Instant::now();
    while socket.write_all(&[b'x'; 1 << 14]).is_ok() {
        assert!(begun.elapsed() < 10 * SECOND, "the body is read on and on");
    }
    works(&server);
}

/// Why a client is told that something is not taken.
fn told(client: &mut RoomClient) -> String {
    let end = Instant::now() + 10 * SECOND;
    loop {
        match client.next(SECOND) {
            Err(TransportError::Closed { why } | TransportError::Refused { why }) => return why,
            Err(error) => panic!("{error}"),
            Ok(_) => assert!(Instant::now() < end, "nothing is told"),
        }
    }
}

#[test]
fn who_may_not_send_is_told_and_goes_on_viewing() {
    let hello = || Message::Hello { sender: 0, hands: [true, false], record: Vec::new() }.bytes();
    for (alone, why) in [(true, "takes no senders"), (false, "no place for a further sender")] {
        let server = Server::start(options().with_senders(!alone)).unwrap();
        let senders = if alone { 1 } else { usize::from(MAX_SENDERS) };
        let mut own: Vec<_> = (0..senders).map(|_| server.publisher().unwrap()).collect();
        let mut viewer = join(&server);
        viewer.say(hello()).unwrap();
        assert!(told(&mut viewer).contains(why));
        // As one who is not let in: it is no fault of the connection.
        let refused = join(&server).hello(&Hello::default());
        assert!(matches!(&refused, Err(TransportError::Refused { why: told }) if told.contains(why)));
        viewer.say(Message::Plane(plane(0, 0, 20)).bytes()).unwrap();
        viewer.say(Message::End { sender: 0, parting: Parting::Left }.bytes()).unwrap();
        own[0].planes(&[plane(3, 0, 40)]).unwrap();
        assert_eq!(next_plane(&mut viewer), plane(3, 0, 40));
        if let Some(mut last) = own.pop().filter(|_| !alone) {
            last.end().unwrap();
            let sender = MAX_SENDERS - 1;
            let gone = Message::End { sender, parting: Parting::Left };
            assert!((0..9).any(|_| viewer.next(SECOND).unwrap().as_ref() == Some(&gone)));
            viewer.say(hello()).unwrap();
            viewer.say(Message::Plane(plane(5, 0, 20)).bytes()).unwrap();
            let found = next_plane(&mut viewer);
            assert_eq!((found.sender, found.period), (sender, 5));
        }
    }
}

#[test]
fn who_breaks_the_rules_is_told_how() {
    let server = server();
    for (bytes, why) in [
        (vec![0x3f], "kind 15, expected 0 to 7"),
        (vec![0x20, 0], "version 2, expected 3"),
        (Message::Intra { sender: 0 }.bytes().repeat(9), "more than 8 together"),
        (Message::Plane(plane(0, 0, 20)).bytes(), "nothing that a room is told: plane"),
        (Message::Welcome { sender: 3 }.bytes(), "nothing that a room is told: welcome"),
    ] {
        let mut client = join(&server);
        client.say(bytes).unwrap();
        let said = told(&mut client);
        assert!(said.contains(why), "{said}");
    }
    works(&server);
}

#[test]
fn huge_frames_and_floods_are_cut_off() {
    let server = server();
    let mut talker = join(&server);
    // A message longer than any, then one that is none.
    let flood = |client: &mut RoomClient, bytes: Vec<u8>| {
        for _ in 0..200 {
            if client.say(bytes.clone()).and_then(|()| client.next(Duration::ZERO)).is_err() {
                return true;
            }
        }
        false
    };
    assert!(flood(&mut talker, vec![0; 100_000]), "a huge message is taken");
    let mut talker = join(&server);
    assert!(flood(&mut talker, vec![0xff; 30]), "noise is taken");
    let mut sender = join(&server);
    sender.hello(&Hello::default()).unwrap();
    let mut cut = false;
    for index in 1..200 {
        cut |= sender.planes(&[plane(0, index, 8192)]).is_err();
    }
    let end = Instant::now() + 5 * SECOND;
    while !cut && Instant::now() < end {
        cut = sender.next(SECOND).is_err();
    }
    assert!(cut, "a flood of planes is taken: {:?}", server.counted());
    works(&server);
}

/// What a guest may say within its bytes keeps a crowd of readers from nothing.
#[test]
fn tiny_messages_are_cut_off_and_planes_at_their_pace_are_not() {
    let server = server();
    let hello = |right| Message::Hello { sender: 0, hands: [false, right], record: Vec::new() };
    let opening = |period| Message::Plane(plane(period, 0, 4));
    let floods: [&dyn Fn(u16) -> Vec<u8>; 3] = [
        &|n| [hello(n % 2 == 0), hello(n % 2 == 1)].iter().flat_map(Message::bytes).collect(),
        &|n| (0..8).flat_map(|k| opening(8 * n + k).bytes()).collect(),
        &|n| Message::Ping { mark: u64::from(n) }.bytes(),
    ];
    for flood in floods {
        let mut talker = join(&server);
        talker.hello(&Hello::default()).unwrap();
        let (mut sent, mut cut) = (0, false);
        while !cut && sent < 128 << 10 {
            let bytes = flood((sent % 8000) as u16);
            sent += bytes.len() + 8;
            cut = talker.say(bytes).and_then(|()| talker.next(Duration::ZERO)).is_err();
        }
        // What was said before it was noticed.
        let end = Instant::now() + 5 * SECOND;
        while !cut && Instant::now() < end {
            cut = talker.next(SECOND / 10).is_err();
        }
        assert!(cut, "{sent} bytes are taken");
    }
    // Ten seconds that came at once, by eights as they go together, and 120 planes a second one by one.
    let mut sender = join(&server);
    sender.hello(&Hello::default()).unwrap();
    let planes: Vec<Plane> = (0..1200).map(|index| plane(0, index, 25)).collect();
    planes.chunks(8).for_each(|planes| sender.planes(planes).unwrap());
    let begun = Instant::now();
    for index in 1200..1680u16 {
        let due = SECOND / 120 * u32::from(index - 1199);
        std::thread::sleep(due.saturating_sub(begun.elapsed()));
        sender.planes(&[plane(0, index, 25)]).unwrap();
        while sender.next(Duration::ZERO).unwrap().is_some() {}
    }
    works(&server);
}

/// A joiner that comes right behind another request gets its I plane all the same, and a crowd asks for one alone.
#[test]
fn joiners_ask_no_more_often_than_others_and_are_not_forgotten() {
    let server = server();
    let mut sender = server.publisher().unwrap();
    sender.planes(&[plane(0, 0, 40), plane(0, 2, 40)]).unwrap();
    let mut asked = || {
        let begun = Instant::now();
        while !sender.wants_intra() {
            assert!(begun.elapsed() < 5 * SECOND, "nobody asks");
            std::thread::sleep(SECOND / 100);
        }
        Instant::now()
    };
    let _first = join(&server);
    let first = asked();
    let _crowd: Vec<RoomClient> = (0..30).map(|_| join(&server)).collect();
    let second = asked();
    assert!(second - first > SECOND / 2 && second - first < 2 * SECOND, "{:?}", second - first);
    std::thread::sleep(SECOND / 2);
    assert!(!sender.wants_intra(), "asked for each");
}

/// As the browser of a page that is closed does.
#[test]
fn who_says_that_it_goes_has_left() {
    let (server, mut viewer, sender) = viewed();
    drop(sender);
    assert_eq!(parting(&mut viewer), Parting::Gone);
    let address = server.address();
    let request = format!("ws://{address}/r/live?token={TOKEN}");
    let (mut socket, _) = tungstenite::client(request, TcpStream::connect(address).unwrap()).unwrap();
    let hello = Message::Hello { sender: 0, hands: [true, false], record: Vec::new() }.bytes();
    socket.send(tungstenite::Message::Binary(hello.into())).unwrap();
    socket.close(None).unwrap();
    assert_eq!(parting(&mut viewer), Parting::Left);
}

#[test]
fn readers_that_trickle_are_served_to_the_end() {
    let parts = vec![Part::new("", "text/html", vec![b'x'; 400_000])];
    let server = Server::start(options().with_parts(parts)).unwrap();
    let address = server.address();
    let mut slow = TcpStream::connect(address).unwrap();
    slow.write_all(format!("GET /r HTTP/1.1\r\nHost: {address}\r\n\r\n").as_bytes()).unwrap();
    works(&server);
    let (mut length, mut piece) = (0, [0; 4000]);
    loop {
        match slow.read(&mut piece).unwrap() {
            0 => break,
            count => length += count,
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(length > 400_000, "{length}");
}

/// A server with one file of this many bytes, which gzip makes no smaller, and one who has asked for it.
fn asked_for(length: u32, options: ServerOptions) -> (Server, TcpStream) {
    let body: Vec<u8> = (0..length).map(|n| (n.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let server = Server::start(options.with_parts(vec![Part::new("", "text/html", body)])).unwrap();
    let mut socket = narrow(server.address());
    socket.set_read_timeout(Some(5 * SECOND)).unwrap();
    socket.write_all(format!("GET /r HTTP/1.1\r\nHost: {}\r\n\r\n", server.address()).as_bytes()).unwrap();
    (server, socket)
}

#[test]
fn an_answer_may_take_longer_than_a_request() {
    let (_server, mut slow) = asked_for(4_000_000, options().with_times(SECOND / 10, 15 * SECOND));
    let (mut length, mut piece, begun) = (0, [0; 16_384], Instant::now());
    loop {
        match slow.read(&mut piece).unwrap() {
            0 => break,
            count => length += count,
        }
        std::thread::sleep(SECOND / 200);
    }
    assert!(length > 4_000_000 && begun.elapsed() > SECOND, "{length} in {:?}", begun.elapsed());
}

#[test]
fn an_answer_has_its_end_however_steadily_it_is_taken() {
    let (server, mut slow) = asked_for(100_000_000, options().with_answer_time(SECOND));
    let (mut piece, begun) = ([0; 1024], Instant::now());
    while slow.read(&mut piece).is_ok_and(|count| count > 0) && server.counted().refused == 0 {
        assert!(begun.elapsed() < 10 * SECOND, "{:?}", server.counted());
        std::thread::sleep(SECOND / 100);
    }
    assert!(begun.elapsed() > SECOND, "{:?}", begun.elapsed());
    works(&server);
}

#[test]
fn one_who_says_no_more_than_a_request_is_answered() {
    let (_server, mut half) = asked_for(4_000_000, options());
    half.shutdown(std::net::Shutdown::Write).unwrap();
    let mut answer = Vec::new();
    half.read_to_end(&mut answer).unwrap();
    assert!(answer.len() > 4_000_000, "{}", answer.len());
}

/// Of many who are answered the one goes that takes nothing, not the one who came first.
#[test]
fn who_takes_an_answer_slowly_keeps_its_place() {
    let mut options = options();
    options.connections = [4096, 20];
    let (server, mut slow) = asked_for(4_000_000, options);
    let address = server.address();
    let stop = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut held = Vec::new();
            while !stop.load(std::sync::atomic::Ordering::Relaxed) {
                held.push(TcpStream::connect(address).unwrap());
                std::thread::sleep(SECOND / 100);
            }
        });
        let (mut length, mut piece) = (0, [0; 16_384]);
        while let Ok(count @ 1..) = slow.read(&mut piece) {
            length += count;
            std::thread::sleep(SECOND / 300);
        }
        stop.store(true, std::sync::atomic::Ordering::Relaxed);
        assert!(length > 4_000_000, "{length}");
    });
}

#[test]
fn files_are_gzipped_for_those_who_take_it() {
    let text = "hands ".repeat(10_000);
    let parts = vec![Part::new("", "text/html", &text), Part::new("tiny", "text/plain", "x")];
    let server = Server::start(options().with_parts(parts)).unwrap();
    let address = server.address();
    let ask = |method: &str, path: &str, takes: &str| {
        let mut socket = TcpStream::connect(address).unwrap();
        let head = format!("{method} {path} HTTP/1.1\r\nHost: {address}\r\nAccept-Encoding: {takes}\r\n\r\n");
        socket.write_all(head.as_bytes()).unwrap();
        let mut answer = Vec::new();
        socket.read_to_end(&mut answer).unwrap();
        let end = answer.windows(4).position(|bytes| bytes == b"\r\n\r\n").unwrap();
        let body = answer.split_off(end + 4);
        (String::from_utf8(answer).unwrap(), body)
    };
    let has = |head: &str, line: &str| head.lines().any(|found| found == line);
    let is_packed = |head: &str| has(head, "Content-Encoding: gzip");
    // It is packed while it is served already.
    let end = Instant::now() + 10 * SECOND;
    let (head, body) = loop {
        let (head, body) = ask("GET", "/r", "br, gzip");
        assert!(
            has(&head, "Vary: Accept-Encoding") && has(&head, &format!("Content-Length: {}", body.len()))
        );
        if is_packed(&head) {
            break (head, body);
        }
        assert!(body == text.as_bytes() && Instant::now() < end, "{head}");
    };
    assert!(body.len() < text.len() / 20, "{}", body.len());
    let mut plain = String::new();
    flate2::read::GzDecoder::new(&body[..]).read_to_string(&mut plain).unwrap();
    assert_eq!(plain, text);
    assert_eq!(ask("HEAD", "/r", "gzip"), (head, Vec::new()));
    for takes in ["", "gzip;q=0", "br"] {
        let (head, body) = ask("GET", "/r", takes);
        assert!(!is_packed(&head) && has(&head, "Vary: Accept-Encoding"), "{head}");
        assert!(has(&head, "Content-Length: 60000") && body == text.as_bytes(), "{head}");
    }
    let (head, body) = ask("GET", "/tiny", "gzip");
    assert!(!is_packed(&head) && body == b"x", "{head}");
}

#[test]
fn planes_before_the_end_in_one_message_are_handed_on() {
    let (_server, mut viewer, mut sender) = viewed();
    let together = |messages: &[Message]| messages.iter().flat_map(Message::bytes).collect::<Vec<u8>>();
    let hello = Message::Hello { sender: 0, hands: [true, true], record: Vec::new() };
    let end = Message::End { sender: 0, parting: Parting::Left };
    sender
        .say(together(&[
            Message::Plane(plane(0, 0, 40)),
            hello,
            Message::Plane(plane(0, 1, 20)),
            Message::Plane(plane(0, 2, 20)),
            end.clone(),
        ]))
        .unwrap();
    let mut came = Vec::new();
    while came.last() != Some(&end) {
        came.extend(viewer.next(5 * SECOND).unwrap());
    }
    let kinds: Vec<&str> = came.iter().map(Message::kind).collect();
    assert_eq!(kinds, ["hello", "plane", "hello", "plane", "plane", "end"], "{came:?}");
    // It may come again.
    sender.say(together(&[Message::Hello { sender: 0, hands: [true, true], record: Vec::new() }])).unwrap();
    sender.say(together(&[Message::Plane(plane(1, 0, 40))])).unwrap();
    assert_eq!(next_plane(&mut viewer), plane(1, 0, 40));
}

/// Planes come whole and in order where packets are lost and late.
fn assert_come(loss: f64) {
    const PLANES: u16 = 240;
    let server = server();
    let options = LossyOptions::default().with_loss(loss);
    let way = || lossy_way(server.address(), options).unwrap();
    let mut viewer = RoomClient::connect(way(), "r", TOKEN).unwrap();
    let address = way();
    let sending = std::thread::spawn(move || {
        let mut sender = RoomClient::connect(address, "r", TOKEN).unwrap();
        sender.hello(&Hello::default()).unwrap();
        let mut sent = Vec::new();
        for number in 0..PLANES {
            sent.push(Instant::now());
            sender.planes(&[plane(number / 30, number % 30, 20)]).unwrap();
            std::thread::sleep(Duration::from_millis(20));
        }
        sender.end().unwrap();
        std::thread::sleep(SECOND);
        sent
    });
    let mut came = Vec::new();
    for number in 0..PLANES {
        let found = next_plane(&mut viewer);
        came.push(Instant::now());
        let expected = plane(number / 30, number % 30, 20);
        assert_eq!(
            (found.period, found.index, &found.payload),
            (expected.period, expected.index, &expected.payload)
        );
        assert_eq!(found.time_ms, expected.time_ms, "short planes tell the time as long ones do");
    }
    assert_eq!(parting(&mut viewer), Parting::Left);
    let sent = sending.join().unwrap();
    let mut late: Vec<f64> =
        came.iter().zip(&sent).map(|(came, sent)| (*came - *sent).as_secs_f64() * 1000.0).collect();
    late.sort_by(f64::total_cmp);
    // Two ways one after the other.
    assert!(late[0] >= 40.0, "{late:?}");
    let at = |share: f64| late[(share * (late.len() - 1) as f64) as usize];
    println!("loss {:.0} % on both ways: p50 {:.0}, p95 {:.0} ms", loss * 100.0, at(0.5), at(0.95));
}

#[test]
fn loss_and_delay_on_the_way_cost_time_and_nothing_else() {
    // What takes its time is the way: one waits while the other does.
    std::thread::scope(|scope| {
        for loss in [0.01, 0.05] {
            scope.spawn(move || assert_come(loss));
        }
    });
}
