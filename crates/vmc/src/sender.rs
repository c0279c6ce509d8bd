//! A socket that poses are sent through.

use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs as _, UdpSocket};

use handcast_hand::{Morphology, Side, TimedPose};

use super::{HandBones, VmcError, packet};

/// The port where receivers listen unless told otherwise.
pub const PORT: u16 = 39539;

/// What has been sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sent {
    /// Poses, each of one hand.
    pub poses: u64,
    /// Packets.
    pub packets: u64,
    /// Bytes of the packets, without headers of UDP and IP.
    pub bytes: u64,
    /// Packets that the receiver's machine reported as unwanted: nothing listened there. Few machines on a network report.
    pub unheard: u64,
}

/// Sends the poses of one hand or two to a receiver.
///
/// A receiver may be started, ended and started again meanwhile.
#[derive(Debug)]
pub struct VmcSender {
    socket: UdpSocket,
    address: SocketAddr,
    hands: [HandBones; 2],
    wrist: bool,
    tracked: [bool; 2],
    sent: Sent,
}

impl VmcSender {
    /// A sender to `HOST` or `HOST:PORT`: a name, an IPv4 address, or an IPv6 address, in brackets where a port follows.
    /// Hands have mean sizes until [`Self::set_sizes`].
    ///
    /// # Errors
    /// [`VmcError::Target`], [`VmcError::Resolve`] and [`VmcError::Open`].
    pub fn connect(target: &str) -> Result<Self, VmcError> {
        let (host, port) = parse(target)?;
        let resolve = |source| VmcError::Resolve { host: host.into(), source };
        let addresses: Vec<SocketAddr> = (host, port).to_socket_addrs().map_err(resolve)?.collect();
        // Of a name with both the one of IPv4, on which avatar programs listen.
        let address = addresses
            .iter()
            .find(|address| address.is_ipv4())
            .or(addresses.first())
            .copied()
            .ok_or_else(|| resolve(io::Error::new(io::ErrorKind::NotFound, "it has no address")))?;
        let socket = open(address).map_err(|source| VmcError::Open { address, source })?;
        let sizes = Morphology::default();
        let hands = [Side::Left, Side::Right].map(|side| HandBones::new(&sizes, side));
        Ok(Self { socket, address, hands, wrist: true, tracked: [false; 2], sent: Sent::default() })
    }

    /// Whether the hand's own rotation is sent (default), or fingers alone.
    #[must_use]
    pub fn with_wrist(mut self, wrist: bool) -> Self {
        self.wrist = wrist;
        self.hands = self.hands.map(|hand| hand.with_wrist(wrist));
        self
    }

    /// Says how large a hand is; only rest offsets depend on it.
    pub fn set_sizes(&mut self, side: Side, sizes: &Morphology) {
        self.hands[side as usize] = HandBones::new(sizes, side).with_wrist(self.wrist);
    }

    /// The address that the receiver's name stands for.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What has been sent so far.
    pub fn sent(&self) -> Sent {
        self.sent
    }

    /// Sends the poses of an instant, those that are valid and finite, a packet each. A hand that is not among `poses` stays as
    /// it was; where neither is tracked any more, a packet without bones says so. `time` is seconds on the sender's clock, which
    /// need not be that of the poses.
    ///
    /// # Errors
    /// [`VmcError::Send`]; the sender can go on. That nothing listens is no error, but counted.
    pub fn send(&mut self, time: f64, poses: &[TimedPose]) -> Result<(), VmcError> {
        for pose in poses {
            self.tracked[pose.pose.side as usize] = usable(pose);
        }
        let tracked = self.tracked.contains(&true);
        for pose in poses.iter().filter(|pose| usable(pose)) {
            let bones = self.hands[pose.pose.side as usize].bones(&pose.pose);
            self.put(&packet(bones, time, tracked)?)?;
            self.sent.poses += 1;
        }
        if tracked { Ok(()) } else { self.end(time) }
    }

    /// Says that no hand is tracked, as at the end.
    ///
    /// # Errors
    /// [`VmcError::Send`].
    pub fn end(&mut self, time: f64) -> Result<(), VmcError> {
        self.tracked = [false; 2];
        self.put(&packet([], time, false)?)
    }

    fn put(&mut self, bytes: &[u8]) -> Result<(), VmcError> {
        let mut done = self.socket.send(bytes);
        if done.as_ref().is_err_and(is_unheard) {
            // The report is about a packet before this one, which has yet to be sent.
            self.sent.unheard += 1;
            done = self.socket.send(bytes);
        }
        match done {
            Err(error) if !is_unheard(&error) => {
                return Err(VmcError::Send { address: self.address, source: error });
            }
            _ => {}
        }
        self.sent.packets += 1;
        self.sent.bytes += bytes.len() as u64;
        Ok(())
    }
}

/// Whether an error is the report that nothing listens, as systems tell it.
fn is_unheard(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::ConnectionRefused | io::ErrorKind::ConnectionReset)
}

fn usable(pose: &TimedPose) -> bool {
    pose.valid && pose.pose.is_finite()
}

fn open(address: SocketAddr) -> io::Result<UdpSocket> {
    let socket = match address {
        SocketAddr::V4(_) => UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?,
        SocketAddr::V6(_) => UdpSocket::bind((Ipv6Addr::UNSPECIFIED, 0))?,
    };
    if address.is_ipv4() {
        // So that the address of all machines of a network may be given.
        socket.set_broadcast(true)?;
    }
    socket.connect(address)?;
    Ok(socket)
}

/// Host and port of a receiver's name.
fn parse(target: &str) -> Result<(&str, u16), VmcError> {
    let wrong = |what| VmcError::Target { target: target.into(), what };
    if target.contains("://") {
        return Err(wrong("it is written like a web address"));
    }
    if target.contains(|c: char| c == ',' || c.is_whitespace()) {
        return Err(wrong("it holds a blank or a comma; one receiver is taken"));
    }
    let (host, port) = match target.strip_prefix('[') {
        Some(rest) => {
            let (host, rest) = rest.split_once(']').ok_or_else(|| wrong("a bracket is not closed"))?;
            match rest.strip_prefix(':') {
                Some(port) => (host, Some(port)),
                None if rest.is_empty() => (host, None),
                None => return Err(wrong("something other than a port follows the bracket")),
            }
        }
        // More than one colon is an IPv6 address.
        None => match target.split_once(':') {
            Some((host, port)) if !port.contains(':') => (host, Some(port)),
            _ => (target, None),
        },
    };
    if host.is_empty() {
        return Err(wrong("there is no host"));
    }
    // Resolvers take a number for an address.
    if host.bytes().all(|byte| byte.is_ascii_digit()) {
        return Err(wrong("the host is a number alone; a port stands behind it, as in 127.0.0.1:39539"));
    }
    let port = match port {
        None => PORT,
        Some(text) => match text.parse() {
            Ok(port) if port > 0 => port,
            _ => return Err(wrong("the port is not a number from 1 to 65535")),
        },
    };
    Ok((host, port))
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::HandPose;
    use rosc::{OscPacket, OscType};
    use std::time::Duration;

    #[test]
    fn receivers_are_hosts_with_or_without_a_port() {
        let good = [
            ("localhost", "localhost", PORT),
            ("10.0.0.2:40000", "10.0.0.2", 40000),
            ("::1", "::1", PORT),
            ("[::1]", "::1", PORT),
            ("[::1]:7", "::1", 7),
        ];
        for (target, host, port) in good {
            assert_eq!(parse(target).unwrap(), (host, port), "{target}");
        }
        for (target, word) in [
            ("", "no host"),
            (":39539", "no host"),
            ("a:0", "1 to 65535"),
            ("a:70000", "1 to 65535"),
            ("a:", "1 to 65535"),
            ("[::1", "not closed"),
            ("[::1]7", "follows"),
        ] {
            let message = parse(target).unwrap_err().to_string();
            assert!(message.contains(word), "{target}: {message}");
        }
        let unknown = VmcSender::connect("no.such.host.invalid:39539").unwrap_err();
        assert!(
            matches!(&unknown, VmcError::Resolve { host, .. } if host == "no.such.host.invalid"),
            "{unknown}"
        );
    }

    fn receive(socket: &UdpSocket) -> Vec<(String, Vec<OscType>)> {
        let mut bytes = [0; 2048];
        let length = socket.recv(&mut bytes).unwrap();
        let (_, packet) = rosc::decoder::decode_udp(&bytes[..length]).unwrap();
        let OscPacket::Bundle(bundle) = packet else { panic!("no bundle") };
        let messages = bundle.content.into_iter().map(|packet| match packet {
            OscPacket::Message(message) => (message.addr, message.args),
            OscPacket::Bundle(_) => panic!("a bundle in a bundle"),
        });
        messages.collect()
    }

    #[test]
    fn two_hands_are_two_packets_and_a_lost_one_is_not_sent() {
        let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
        receiver.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let mut sender = VmcSender::connect(&receiver.local_addr().unwrap().to_string()).unwrap();
        let [left, right] = [Side::Left, Side::Right].map(|s| TimedPose::new(0.0, HandPose::neutral(s)));
        let first_bone = |packet: &[(String, Vec<OscType>)]| packet.get(2).map(|(_, args)| args[0].clone());
        let name = |name: &str| Some(OscType::String(name.into()));
        let ok = |packet: &[(String, Vec<OscType>)]| packet[0].1[0].clone();

        sender.send(0.0, &[left.clone(), right]).unwrap();
        let packets = [receive(&receiver), receive(&receiver)];
        assert_eq!(packets.each_ref().map(|p| first_bone(p)), [name("LeftHand"), name("RightHand")]);

        sender.send(0.1, &[left, TimedPose::lost(0.1, Side::Right)]).unwrap();
        let packet = receive(&receiver);
        assert_eq!((first_bone(&packet), ok(&packet)), (name("LeftHand"), OscType::Int(1)));

        // Nothing is said of the left hand, which stays tracked.
        sender.send(0.2, &[TimedPose::lost(0.2, Side::Right)]).unwrap();
        sender.send(0.3, &[TimedPose::lost(0.3, Side::Left)]).unwrap();
        let packet = receive(&receiver);
        assert_eq!((first_bone(&packet), ok(&packet)), (None, OscType::Int(0)));
        assert_eq!(packet[1].1, [OscType::Float(0.3)]);
        let sent = sender.sent();
        assert_eq!((sent.poses, sent.packets, sent.unheard), (3, 4, 0));
    }

    #[test]
    fn systems_tell_in_two_ways_that_nobody_listens() {
        use io::ErrorKind::{ConnectionRefused, ConnectionReset, NetworkUnreachable};
        let unheard =
            [ConnectionRefused, ConnectionReset, NetworkUnreachable].map(|kind| is_unheard(&kind.into()));
        assert_eq!(unheard, [true, true, false]);
    }

    #[test]
    fn nobody_listening_is_counted() {
        let closed = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let mut sender = VmcSender::connect(&closed.to_string()).unwrap();
        for k in 0..5 {
            sender.send(f64::from(k), &[TimedPose::new(0.0, HandPose::neutral(Side::Left))]).unwrap();
        }
        assert_eq!(sender.sent().packets, 5);
        if cfg!(target_os = "linux") {
            assert!(sender.sent().unheard > 0);
        }
    }
}
