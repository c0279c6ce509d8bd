//! Programs that show an avatar, and whether they listen.

use std::net::SocketAddr;

use handcast_hand::{Morphology, Side, TimedPose};
use handcast_vmc::{Sent, VmcError, VmcSender};

/// Where poses are sent by the VMC protocol: to each the same.
#[derive(Debug)]
pub struct Receivers(Vec<Receiver>);

#[derive(Debug)]
struct Receiver {
    sender: VmcSender,
    listening: Listening,
    /// Whether the last packet could not be sent.
    cut_off: bool,
}

impl Receivers {
    /// The ways to receivers of these names; `wrist` is whether the hand's own rotation is sent.
    pub fn connect(targets: &[String], wrist: bool) -> Result<Self, VmcError> {
        let receiver = |target: &String| -> Result<Receiver, VmcError> {
            let sender = VmcSender::connect(target)?.with_wrist(wrist);
            Ok(Receiver { sender, listening: Listening::default(), cut_off: false })
        };
        targets.iter().map(receiver).collect::<Result<_, _>>().map(Self)
    }

    /// Says how large a hand is.
    pub fn set_sizes(&mut self, side: Side, sizes: &Morphology) {
        self.0.iter_mut().for_each(|receiver| receiver.sender.set_sizes(side, sizes));
    }

    /// Sends the poses of an instant of `time` seconds; `now` is seconds since the sending began. What goes wrong with one is
    /// said, once until it goes well again, and the others get theirs.
    pub fn send(&mut self, time: f64, now: f64, poses: &[TimedPose]) {
        for Receiver { sender, listening, cut_off } in &mut self.0 {
            match sender.send(time, poses) {
                Ok(()) => {
                    *cut_off = false;
                    listening.look(now, sender.sent(), sender.address());
                }
                // A network may be away for a while.
                Err(_) if *cut_off => {}
                Err(error) => {
                    errln!("handcast: {error}; what comes now is lost");
                    *cut_off = true;
                }
            }
        }
    }

    /// Says that no hand is tracked any more; gives the first error.
    pub fn end(&mut self, time: f64) -> Result<(), VmcError> {
        let ended: Vec<_> = self.0.iter_mut().map(|receiver| receiver.sender.end(time)).collect();
        ended.into_iter().collect()
    }

    /// Each with its address, and what was sent to it.
    pub fn sent(&self) -> impl Iterator<Item = (SocketAddr, Sent)> {
        self.0.iter().map(|receiver| (receiver.sender.address(), receiver.sender.sent()))
    }

    /// Says on standard error where nothing listened.
    pub fn tell_unheard(&self) {
        for (address, sent) in self.sent().filter(|(_, sent)| sent.unheard > 0) {
            errln!("handcast: nothing listened at {address} for {} packets", sent.unheard);
        }
    }
}

/// Follows the reports of a receiver's machine, and says when nothing listens there and when something does again.
#[derive(Clone, Copy, Debug, Default)]
struct Listening {
    unheard: u64,
    /// Seconds of the last report, as long as nothing listens.
    deaf: Option<f64>,
}

impl Listening {
    /// Seconds without a report after which something listens: machines on a network report but once in a while.
    const HEARD: f64 = 3.0;

    /// Looks at what was sent up to so many seconds.
    fn look(&mut self, seconds: f64, sent: Sent, address: SocketAddr) {
        if let Some(words) = self.news(seconds, sent.unheard) {
            errln!("handcast: {words} at {address}");
        }
    }

    fn news(&mut self, seconds: f64, unheard: u64) -> Option<&'static str> {
        if unheard > self.unheard {
            self.unheard = unheard;
            return self.deaf.replace(seconds).is_none().then_some("nothing listens");
        }
        let heard = self.deaf.is_some_and(|last| seconds - last > Self::HEARD);
        heard.then(|| self.deaf = None).map(|()| "something listens again")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_and_its_end_are_told_once() {
        let mut listening = Listening::default();
        let told = [(0.0, 0), (0.1, 1), (0.2, 2), (3.0, 2), (3.3, 2), (9.0, 2), (9.1, 3)]
            .map(|(seconds, unheard)| listening.news(seconds, unheard));
        let expected = [
            None,
            Some("nothing listens"),
            None,
            None,
            Some("something listens again"),
            None,
            Some("nothing listens"),
        ];
        assert_eq!(told, expected);
    }
}
