//! Unmodified relays between the two ends.
//!
//! `HANDCAST_MOQ_RELAY` names the relay, `moq-relay` of the search path otherwise: `cargo install moq-relay --version =0.17.10`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use handcast_live::client::RoomClient;
use handcast_live::server::{Server, ServerOptions, clock_ms};
use handcast_live::transport::{Hello, Publish as _, Subscribe as _};
use handcast_live::wire::{Message, Parting, Plane};
use handcast_moq::trial::{
    self, Link, PERIOD, Relay, Sender, options, program, read, shown, urls, wait_for_plane,
};
use handcast_moq::{MoqPublisher, MoqSubscriber};

fn relay(peer: Option<&Relay>) -> Relay {
    Relay::start(&program(), peer.map(|peer| (peer.port, peer))).unwrap()
}

fn at(sorted: &[u32], percent: usize) -> u32 {
    sorted[(sorted.len() - 1) * percent / 100]
}

#[test]
#[ignore = "needs moq-relay"]
fn planes_cross_two_relays_in_order_and_joiners_see_them() {
    let first = relay(None);
    let second = relay(Some(&first));
    let mut sender = Sender::at(&[&first]).unwrap();
    for (name, relay) in [("one relay", &first), ("two relays", &second)] {
        let mut room = trial::viewer(&[relay]).unwrap();
        let hello = room.next(Duration::from_secs(10)).unwrap();
        assert!(matches!(hello, Some(Message::Hello { hands: [true, false], .. })), "{hello:?}");
        let opening = room.next(Duration::from_secs(10)).unwrap();
        assert!(matches!(&opening, Some(Message::Plane(plane)) if plane.opens()), "{opening:?}");
        assert!(
            wait_for_plane(&mut room, Duration::from_secs(10)).unwrap().is_some(),
            "{name}: a plane is shown"
        );
        let mut planes = 0;
        let mut before: Option<Plane> = None;
        for (_, _, message) in read(&mut room, Duration::from_secs(6)).unwrap() {
            if matches!(message, Message::Hello { .. }) {
                continue;
            }
            let Some(plane) = shown(&message) else { panic!("{name}: {message:?}") };
            planes += 1;
            let number = u64::from(plane.period) * u64::from(PERIOD) + u64::from(plane.index);
            assert_eq!(plane.payload[..8], number.to_be_bytes());
            if let Some(before) = before.replace(plane.clone())
                && (before.period, before.index + 1) != (plane.period, plane.index)
            {
                assert_eq!(plane.index, 0, "{name}: what does not follow opens a period");
            }
        }
        assert!(planes > 150, "{name}: {planes} of 180 planes");
        assert_eq!(trial::joins(relay, 8).unwrap().len(), 8);
    }
    sender.stop(true).unwrap();
}

/// A hand that rests sends nothing for longer than the silence after which a sender is gone.
#[test]
#[ignore = "needs moq-relay"]
fn a_hand_that_rests_is_there() {
    let relay = relay(None);
    let mut publisher =
        MoqPublisher::connect(&urls(&[&relay]).unwrap(), "room", "anna", &options(&[&relay])).unwrap();
    assert!(publisher.wait_connected(Duration::from_secs(10)));
    publisher.hello(&Hello { hands: [true, false], record: vec![1] }).unwrap();
    let plane = |index| Plane { index, time_ms: clock_ms(), payload: vec![0, 0, 1, 7], ..Plane::default() };
    let mut room = trial::viewer(&[&relay]).unwrap();
    assert!(room.wait_connected(Duration::from_secs(10)));
    publisher.planes(&[plane(0)]).unwrap();
    assert!(wait_for_plane(&mut room, Duration::from_secs(10)).unwrap().is_some());
    let told = read(&mut room, Duration::from_secs(9)).unwrap();
    let hellos = told.iter().filter(|(.., message)| matches!(message, Message::Hello { .. })).count();
    assert!((6..=10).contains(&hellos) && hellos == told.len(), "{told:?}");
    // And goes on within its period.
    publisher.planes(&[plane(1)]).unwrap();
    assert!(wait_for_plane(&mut room, Duration::from_secs(2)).unwrap().is_some());
    publisher.end().unwrap();
}

#[test]
#[ignore = "needs moq-relay"]
fn losses_between_relays_delay_and_do_not_tear() {
    for (loss, most) in [(0.0, 120), (0.01, 120), (0.05, 200)] {
        let first = relay(None);
        let link = Link::start(first.port, Duration::from_millis(20), loss).unwrap();
        let second = Relay::start(&program(), Some((link.port, &first))).unwrap();
        let _sender = Sender::at(&[&first]).unwrap();
        let ages = trial::ages(&second, Duration::from_secs(20)).unwrap();
        println!(
            "{loss}: {} of 600 planes, age p50 {} ms, p95 {} ms",
            ages.len(),
            at(&ages, 50),
            at(&ages, 95)
        );
        assert!(ages.len() > 500, "{} planes", ages.len());
        // A machine that does other things at once makes these worse, never better.
        assert!(at(&ages, 50) >= 20 && at(&ages, 50) <= most, "p50 {}", at(&ages, 50));
    }
}

/// The command between two servers.
struct Join(Child);

impl Join {
    fn start(server: &Server, relay: &Relay) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_handcast-moq"));
        command.args(["join", "--relay", relay.url().unwrap().as_str(), "--fingerprint", &relay.fingerprint]);
        command.args(["--server", &format!("http://{}/r#token=t", server.address())]);
        Self(command.stderr(Stdio::null()).spawn().unwrap())
    }
}

impl Drop for Join {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
#[ignore = "needs moq-relay"]
fn rooms_of_two_machines_are_one() {
    let relays = relay(None);
    let relays = [relay(Some(&relays)), relays];
    let servers = [(); 2].map(|()| {
        let options = ServerOptions::new("127.0.0.1:0".parse().unwrap()).with_room("r").with_token("t");
        Server::start(options).unwrap()
    });
    let _joined = [0, 1].map(|k| Join::start(&servers[k], &relays[k]));
    let mut senders = servers.each_ref().map(|server| server.publisher().unwrap());
    let mut readers =
        servers.each_ref().map(|server| RoomClient::connect(server.address(), "r", "t").unwrap());
    for (k, sender) in senders.iter_mut().enumerate() {
        sender.hello(&Hello { hands: [k == 0, k == 1], record: vec![k as u8] }).unwrap();
    }
    let begun = Instant::now();
    let mut seen = [[0usize; 2]; 2];
    let mut most = 0;
    for k in 0..240u16 {
        sleep((Duration::from_millis(u64::from(k) * 33)).saturating_sub(begun.elapsed()));
        for (s, sender) in senders.iter_mut().enumerate() {
            let (period, index, payload) = (k / 30, k % 30, vec![0, 0, 1, s as u8]);
            let plane = Plane { period, index, time_ms: clock_ms(), payload, ..Plane::default() };
            sender.planes(&[plane]).unwrap();
        }
        for (reader, seen) in readers.iter_mut().zip(&mut seen) {
            while let Some(message) = reader.next(Duration::ZERO).unwrap() {
                if let Message::Plane(plane) = &message {
                    most = most.max(plane.sender);
                    seen[usize::from(plane.payload[3])] += 1;
                }
            }
        }
    }
    println!("planes of the senders in the two rooms: {seen:?}");
    assert!(seen.iter().flatten().all(|&count| (100..=250).contains(&count)), "{seen:?}");
    assert_eq!(most, 1, "nobody goes in circles");
}

#[test]
#[ignore = "needs moq-relay"]
fn viewers_are_back_soon_after_a_relay_was_killed() {
    for (k, viewer) in trial::kill(&program()).unwrap().into_iter().enumerate() {
        println!("viewer {k}: {viewer:?}");
        assert!(viewer.gap > Duration::from_millis(100), "viewer {k} noticed the kill");
        assert!(viewer.back < Duration::from_secs(3) && !viewer.parted, "viewer {k}: {viewer:?}");
    }
}

#[test]
#[ignore = "needs moq-relay"]
fn a_sender_that_vanished_is_gone_and_its_period_not_shown() {
    let relay = relay(None);
    let known = options(&[&relay]).with_silence(Duration::from_secs(2));
    let publisher = MoqPublisher::connect(&urls(&[&relay]).unwrap(), "room", "anna", &known).unwrap();
    let mut sender = Sender::start(publisher).unwrap();
    let mut room = MoqSubscriber::connect(&urls(&[&relay]).unwrap(), "room", &known).unwrap();
    assert!(wait_for_plane(&mut room, Duration::from_secs(10)).unwrap().is_some());
    sender.stop(false).unwrap();
    let told = read(&mut room, Duration::from_secs(5)).unwrap();
    let end = Message::End { sender: 0, parting: Parting::Gone };
    assert_eq!(told.last().map(|(.., message)| message), Some(&end));
    assert_eq!(told.iter().filter(|(.., message)| *message == end).count(), 1);
    let mut late = MoqSubscriber::connect(&urls(&[&relay]).unwrap(), "room", &known).unwrap();
    assert!(late.wait_connected(Duration::from_secs(10)));
    assert_eq!(read(&mut late, Duration::from_secs(3)).unwrap(), [], "nothing of what a cache may hold");

    // It is back under its name, and says goodbye.
    let publisher = MoqPublisher::connect(&urls(&[&relay]).unwrap(), "room", "anna", &known).unwrap();
    let mut sender = Sender::start(publisher).unwrap();
    for room in [&mut room, &mut late] {
        assert!(matches!(room.next(Duration::from_secs(10)).unwrap(), Some(Message::Hello { .. })));
        assert!(wait_for_plane(room, Duration::from_secs(10)).unwrap().is_some());
    }
    sender.stop(true).unwrap();
    for room in [&mut room, &mut late] {
        let told = read(room, Duration::from_secs(3)).unwrap();
        let end = Message::End { sender: 0, parting: Parting::Left };
        assert_eq!(told.last().map(|(.., message)| message), Some(&end));
    }
}
