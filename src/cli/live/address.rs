//! The address that others open, also as a QR code.

use std::io::IsTerminal as _;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};

use handcast_live::server::Server;
use qrcode::QrCode;
use qrcode::render::unicode::Dense1x2;

use super::Args;

/// Prints the address: itself on standard output, where no JSON is to come, its QR code for phones on the other.
pub fn print(server: &Server, args: &Args, token: &str, secure: bool) {
    let address = of(server.address(), args, token, secure);
    if args.track.json {
        errln!("{address}");
    } else {
        outln!("{address}");
    }
    if args.track.quiet {
        return;
    }
    // What is on this machine alone no phone can open.
    if !server.address().ip().is_loopback()
        && let Ok(code) = QrCode::new(address.as_bytes())
    {
        errln!("{}", on_white(&code.render::<Dense1x2>().build()));
    }
    errln!("Ctrl-C ends it");
}

/// Black on white, which not every phone reads the other way round, whatever colours the terminal has.
fn on_white(code: &str) -> String {
    if !std::io::stderr().is_terminal() {
        return code.to_owned();
    }
    code.lines().map(|line| format!("\x1b[38;5;16;48;5;231m{line}\x1b[0m\n")).collect()
}

fn of(at: SocketAddr, args: &Args, token: &str, secure: bool) -> String {
    let scheme = if secure { "https" } else { "http" };
    let host = match args.host.first() {
        Some(name) => format!("{name}:{}", at.port()),
        None if at.ip().is_unspecified() => SocketAddr::new(own_address(), at.port()).to_string(),
        None => at.to_string(),
    };
    // Behind # the token stays out of logs.
    let token = if token.is_empty() { String::new() } else { format!("#token={token}") };
    format!("{scheme}://{host}/{}{token}", args.room)
}

/// The address of this machine on its network: the one it would send from. Nothing is sent.
fn own_address() -> IpAddr {
    let found = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).and_then(|socket| {
        // An address for documentation (RFC 5737) that nobody has.
        socket.connect((Ipv4Addr::new(192, 0, 2, 1), 9))?;
        socket.local_addr()
    });
    found.map_or(Ipv4Addr::LOCALHOST.into(), |address| address.ip())
}
