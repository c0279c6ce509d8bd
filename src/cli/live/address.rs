//! The address that others open, also as a QR code.

use std::io::IsTerminal as _;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};

use handcast_live::server::Server;
use qrcode::QrCode;
use qrcode::render::unicode::Dense1x2;

use super::Args;

/// Prints the address: itself on standard output, where neither JSON nor a recording is to come, its QR code for phones on
/// the other.
pub fn print(server: &Server, args: &Args, token: &str, secure: bool) {
    let (address, far) = of(server.address(), args, token, secure);
    if args.track.json || args.records_to_standard_output() {
        errln!("{address}");
    } else {
        outln!("{address}");
    }
    if args.track.quiet {
        return;
    }
    if far && let Ok(code) = QrCode::new(address.as_bytes()) {
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

/// The address, and whether another machine can open it: what is on this one alone no phone can.
fn of(at: SocketAddr, args: &Args, token: &str, secure: bool) -> (String, bool) {
    let scheme = if secure { "https" } else { "http" };
    let own = if at.ip().is_unspecified() { own_address(at.ip()) } else { at.ip() };
    let (host, far) = match args.host.first() {
        Some(name) => (format!("{name}:{}", at.port()), !at.ip().is_loopback()),
        None => (SocketAddr::new(own, at.port()).to_string(), !own.is_loopback()),
    };
    // Behind # the token stays out of logs.
    let token = if token.is_empty() { String::new() } else { format!("#token={token}") };
    (format!("{scheme}://{host}/{}{token}", args.room), far)
}

/// The address of this machine on its network: the one it would send from. Nothing is sent. At `[::]` it is listened by IPv6
/// and by IPv4, which a network may have alone.
fn own_address(any: IpAddr) -> IpAddr {
    // Addresses for documentation (RFC 5737, RFC 3849) that nobody has.
    let v4 = || sent_from(Ipv4Addr::UNSPECIFIED.into(), Ipv4Addr::new(192, 0, 2, 1).into());
    let v6 = || sent_from(any, Ipv6Addr::new(0x2001, 0xdb8, 0, 0, 0, 0, 0, 1).into());
    if any.is_ipv4() {
        v4().unwrap_or(Ipv4Addr::LOCALHOST.into())
    } else {
        v6().or_else(|_| v4()).unwrap_or(Ipv6Addr::LOCALHOST.into())
    }
}

/// The address of this machine from which packets to another go.
fn sent_from(own: IpAddr, to: IpAddr) -> std::io::Result<IpAddr> {
    let socket = UdpSocket::bind((own, 0))?;
    socket.connect((to, 9))?;
    Ok(socket.local_addr()?.ip())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_own_address_is_one_that_is_listened_at() {
        assert!(own_address(Ipv4Addr::UNSPECIFIED.into()).is_ipv4());
        assert!(!own_address(Ipv6Addr::UNSPECIFIED.into()).is_unspecified());
    }
}
