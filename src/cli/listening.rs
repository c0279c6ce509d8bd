//! Whether anybody listens where packets go.

use std::net::SocketAddr;

use handcast_vmc::Sent;

/// Follows the reports of the receiver's machine, and says when nothing listens there and when something does again.
#[derive(Clone, Copy, Debug, Default)]
pub struct Listening {
    unheard: u64,
    /// Seconds of the last report, as long as nothing listens.
    deaf: Option<f64>,
}

impl Listening {
    /// Seconds without a report after which something listens: machines on a network report but once in a while.
    const HEARD: f64 = 3.0;

    /// Looks at what was sent up to so many seconds.
    pub fn look(&mut self, seconds: f64, sent: Sent, address: SocketAddr) {
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
