//! The same by TLS, where what is encrypted and not yet sent counts as waiting.

use std::sync::Arc;

use handcast_live::server::Tls;
use handcast_live::wire::Expander;
use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject;
use rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};
use tungstenite::WebSocket;

use super::*;

/// Made by `certificate.sh`.
const CERTIFICATE: &[u8] = include_bytes!("cert.pem");
const KEY: &[u8] = include_bytes!("key.pem");

type Secure = StreamOwned<ClientConnection, TcpStream>;

fn secure(options: ServerOptions) -> Server {
    Server::start(options.with_tls(Tls::new(CERTIFICATE, KEY).unwrap())).unwrap()
}

fn dial(socket: TcpStream) -> Secure {
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_slice(CERTIFICATE).unwrap()).unwrap();
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions().unwrap();
    let config = config.with_root_certificates(roots).with_no_client_auth();
    let connection = ClientConnection::new(Arc::new(config), "localhost".try_into().unwrap()).unwrap();
    StreamOwned::new(connection, socket)
}

/// In the room, by whatever leads there.
fn enter<S: Read + Write>(stream: S, server: &Server) -> WebSocket<S> {
    let uri = format!("ws://{}/r/live?token={TOKEN}", server.address());
    let (socket, _) = tungstenite::client(uri, stream).map_err(|error| error.to_string()).unwrap();
    socket
}

/// The messages that come next, together.
fn messages<S: Read + Write>(socket: &mut WebSocket<S>, expander: &mut Expander) -> Vec<Message> {
    loop {
        match socket.read().unwrap() {
            tungstenite::Message::Binary(bytes) => return expander.read_all(&bytes).unwrap(),
            other => assert!(other.is_ping() || other.is_pong(), "{other}"),
        }
    }
}

#[test]
fn what_is_encrypted_and_not_sent_is_waited_for() {
    let body: Vec<u8> = (0..3_000_000u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let server = secure(options().with_parts(vec![Part::new("", "text/html", &body)]));
    let mut stream = dial(narrow(server.address()));
    let request = format!("GET /r HTTP/1.1\r\nHost: {}\r\n\r\n", server.address());
    stream.write_all(request.as_bytes()).unwrap();
    let (mut came, mut piece) = (Vec::new(), [0; 4096]);
    loop {
        // An end that nobody has told would be an error.
        match stream.read(&mut piece).unwrap() {
            0 => break,
            count => came.extend(&piece[..count]),
        }
        std::thread::sleep(SECOND / 2000);
    }
    assert!(came.ends_with(&body), "{} of {} bytes", came.len(), body.len());
    let end = Instant::now() + 5 * SECOND;
    while server.counted().connections > 0 {
        assert!(Instant::now() < end, "{:?}", server.counted());
        std::thread::sleep(SECOND / 20);
    }
}

#[test]
fn a_sender_and_a_viewer_by_tls() {
    let server = secure(options());
    let mut own = server.publisher().unwrap();
    let mut socket = enter(dial(TcpStream::connect(server.address()).unwrap()), &server);
    let mut expander = Expander::default();
    let say = |socket: &mut WebSocket<Secure>, message: Message| {
        socket.send(tungstenite::Message::Binary(message.bytes().into())).unwrap();
    };
    own.hello(&Hello { hands: [true, false], record: vec![1] }).unwrap();
    own.planes(&[plane(0, 0, 40), plane(0, 1, 8000)]).unwrap();
    let mut came = Vec::new();
    while !matches!(came.last(), Some(Message::Plane(Plane { index: 1, .. }))) {
        came.extend(messages(&mut socket, &mut expander));
    }
    let planes: Vec<_> = came.iter().filter(|message| matches!(message, Message::Plane(_))).collect();
    assert_eq!(planes, [&Message::Plane(plane(0, 0, 40)), &Message::Plane(plane(0, 1, 8000))]);
    say(&mut socket, Message::Hello { sender: 0, hands: [false, true], record: vec![] });
    say(&mut socket, Message::Ping { mark: 7 });
    say(&mut socket, Message::Plane(plane(5, 0, 8000)));
    let mut told = Vec::new();
    while !told.contains(&Message::Plane(Plane { sender: 1, ..plane(5, 0, 8000) })) {
        told.extend(messages(&mut socket, &mut expander));
    }
    assert!(told.contains(&Message::Welcome { sender: 1 }), "{told:?}");
    assert!(told.iter().any(|message| matches!(message, Message::Pong { mark: 7, .. })), "{told:?}");
    server.stop().unwrap();
    let closed = loop {
        match socket.read() {
            Ok(tungstenite::Message::Close(frame)) => break frame,
            other => assert!(other.is_ok(), "{other:?}"),
        }
    };
    assert_eq!(u16::from(closed.unwrap().code), 1001);
    // The end of TLS is told behind it.
    assert_eq!(socket.get_mut().read(&mut [0; 16]).unwrap(), 0);
}

/// Bytes of planes that a reader is sent that reads none of them, before planes are left out for it.
fn sent_before_leaving_out(server: &Server) -> u64 {
    let mut sender = server.publisher().unwrap();
    for index in 0..1000 {
        sender.planes(&[plane(0, index, 500)]).unwrap();
        std::thread::sleep(SECOND / 2000);
        let counted = server.counted();
        if counted.skipped > 0 {
            return counted.deliveries * 500;
        }
    }
    panic!("everything goes somewhere");
}

#[test]
fn a_slow_reader_by_tls_is_no_less_slow() {
    let server = server();
    let _plain = enter(narrow(server.address()), &server);
    let plain = sent_before_leaving_out(&server);
    let server = secure(options());
    let _secure = enter(dial(narrow(server.address())), &server);
    let secure = sent_before_leaving_out(&server);
    assert!(secure <= plain + (8 << 10), "{secure} bytes by TLS, {plain} without");
}

/// What it sends is read also while it takes nothing.
#[test]
fn a_sender_by_tls_that_takes_nothing_is_heard() {
    let server = secure(options());
    let mut viewer = enter(dial(TcpStream::connect(server.address()).unwrap()), &server);
    let mut expander = Expander::default();
    let mut own = server.publisher().unwrap();
    let mut deaf = enter(dial(narrow(server.address())), &server);
    let hello = Message::Hello { sender: 0, hands: [true, false], record: vec![] };
    deaf.send(tungstenite::Message::Binary(hello.bytes().into())).unwrap();
    let mut index = 0;
    while server.counted().skipped == 0 {
        own.planes(&[plane(0, index, 500)]).unwrap();
        messages(&mut viewer, &mut expander);
        index += 1;
    }
    deaf.send(tungstenite::Message::Binary(Message::Plane(plane(3, 0, 40)).bytes().into())).unwrap();
    viewer.get_mut().sock.set_read_timeout(Some(5 * SECOND)).unwrap();
    let heard = Message::Plane(Plane { sender: 1, ..plane(3, 0, 40) });
    while !messages(&mut viewer, &mut expander).contains(&heard) {}
}
