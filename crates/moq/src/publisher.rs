//! The end that publishes.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use handcast_live::transport::{Hello, Publish, TransportError};
use handcast_live::wire::{MAX_BYTES, MAX_TOGETHER, Message, Parting, Plane, Shortener};
use moq_net::{Timestamp, broadcast, group, track};
use moq_tokio::Connection;
use tokio::runtime::Runtime;
use tokio::time::Instant;
use url::Url;

use crate::options::{addresses, runtime};
use crate::{MoqOptions, TRACK, transport_error};

/// Longest wait for what has been said to arrive, at the end.
const PARTING: Duration = Duration::from_secs(1);
/// Bytes of a plane besides its payload, at most.
const HEAD: usize = 16;
/// The hello is said again where nothing was said for so long: less than the silence after which a sender is gone.
const REPEAT: Duration = Duration::from_secs(1);

/// Publishes the planes of one sender to relays.
///
/// When a relay is lost it is dialled again, or the next one of the list; meanwhile planes are published to nobody. A relay
/// gives every joiner the current period from its beginning, so I planes are not asked for. While no planes come, as of hands
/// that rest, the hello is repeated once a second, so that the sender is not taken for gone.
pub struct MoqPublisher {
    connection: Connection,
    broadcast: broadcast::Producer,
    track: track::Producer,
    said: Arc<Mutex<Said>>,
    /// Number of the next group: goes on from those of a sender of this name before it.
    next: u64,
    shortener: Shortener,
    /// Why the connection has ended for good.
    ended: Arc<Mutex<Option<String>>>,
    // The last field: what the others do when dropped needs it.
    runtime: Runtime,
}

/// What was said last, and where more goes.
struct Said {
    group: Option<group::Producer>,
    hello: Option<Message>,
    /// When a frame was written, also in milliseconds since 1970.
    at: Instant,
    at_ms: u64,
}

impl Said {
    /// Writes a frame into the current group.
    fn write(&mut self, bytes: Vec<u8>) -> Result<(), TransportError> {
        self.at = Instant::now();
        let Some(group) = &mut self.group else { return Ok(()) };
        // Relays measure the age of groups by this, so it must not go back.
        self.at_ms = self.at_ms.max(now_ms());
        let time = Timestamp::from_millis(self.at_ms).map_err(|error| transport_error(&error))?;
        let frame = moq_net::bytes::Bytes::from(bytes);
        group.write_frame(time, frame).map_err(|error| transport_error(&error))
    }

    /// Ends the group there is.
    fn close(&mut self) -> Result<(), TransportError> {
        match self.group.take() {
            Some(group) => group.finish().map_err(|error| transport_error(&error)),
            None => Ok(()),
        }
    }

    /// Says the hello again where nothing was said for long; gives when that is due next.
    fn repeat(&mut self) -> Instant {
        let due = self.hello.as_ref().filter(|_| self.at.elapsed() >= REPEAT).map(Message::bytes);
        if let Some(hello) = due {
            // What is wrong with it, who says more is told.
            let _ = self.write(hello);
        }
        Instant::now() + REPEAT.saturating_sub(self.at.elapsed()).max(REPEAT / 10)
    }
}

fn lock(said: &Mutex<Said>) -> MutexGuard<'_, Said> {
    said.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Repeats the hello as long as there is a publisher.
async fn repeat(said: Weak<Mutex<Said>>) {
    while let Some(due) = said.upgrade().map(|said| lock(&said).repeat()) {
        tokio::time::sleep_until(due).await;
    }
}

impl std::fmt::Debug for MoqPublisher {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("MoqPublisher").field("next", &self.next).finish_non_exhaustive()
    }
}

impl MoqPublisher {
    /// Publishes as `ROOM/NAME` to the first of `relays` that answers. Gives back at once; dialling goes on behind.
    ///
    /// # Errors
    /// [`TransportError`] for options or a name that cannot be used.
    pub fn connect(
        relays: &[Url],
        room: &str,
        name: &str,
        options: &MoqOptions,
    ) -> Result<Self, TransportError> {
        let addresses = addresses(relays)?;
        let runtime = runtime()?;
        let entered = runtime.enter();
        let origin = moq_tokio::origin::spawn();
        let wrong = |error: moq_net::Error| transport_error(&error);
        let broadcast = origin.create_broadcast(format!("{room}/{name}")).map_err(wrong)?;
        let track = broadcast.create_track(TRACK, None).map_err(wrong)?;
        broadcast.announce(Default::default()).map_err(wrong)?;
        let connection = options.client(relays.len())?.with_publisher(&origin).connect(addresses);
        let ended = Arc::new(Mutex::new(None));
        let (watched, told) = (connection.clone(), Arc::clone(&ended));
        runtime.spawn(async move {
            let why = match watched.closed().await {
                Ok(()) => "the relay closed the connection".to_owned(),
                Err(error) => transport_error(&error).to_string(),
            };
            *told.lock().unwrap_or_else(PoisonError::into_inner) = Some(why);
        });
        let said = Said { group: None, hello: None, at: Instant::now(), at_ms: 0 };
        let said = Arc::new(Mutex::new(said));
        runtime.spawn(repeat(Arc::downgrade(&said)));
        drop(entered);
        Ok(Self {
            connection,
            broadcast,
            track,
            said,
            next: now_ms(),
            shortener: Shortener::default(),
            ended,
            runtime,
        })
    }

    /// Whether a relay is connected.
    pub fn is_connected(&self) -> bool {
        self.connection.connected()
    }

    /// Waits until a relay is connected, at most `wait`; gives whether one is.
    pub fn wait_connected(&self, wait: Duration) -> bool {
        let connection = self.connection.clone();
        let established = async { tokio::time::timeout(wait, connection.established()).await };
        self.runtime.block_on(established).is_ok_and(|done| done.is_ok())
    }

    fn check(&self) -> Result<(), TransportError> {
        match &*self.ended.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(why) => Err(TransportError::Closed { why: why.clone() }),
            None => Ok(()),
        }
    }

    /// Ends the group there is and opens the next.
    fn open(&mut self, said: &mut Said) -> Result<(), TransportError> {
        said.close()?;
        let group = self.track.create_group(self.next.into()).map_err(|error| transport_error(&error))?;
        self.next += 1;
        said.group = Some(group);
        self.shortener = Shortener::default();
        Ok(())
    }
}

impl Publish for MoqPublisher {
    fn hello(&mut self, hello: &Hello) -> Result<(), TransportError> {
        self.check()?;
        let Hello { hands, record } = hello.clone();
        let hello = Message::Hello { sender: 0, hands, record };
        let mut said = lock(&self.said);
        said.write(hello.bytes())?;
        said.hello = Some(hello);
        Ok(())
    }

    fn planes(&mut self, planes: &[Plane]) -> Result<(), TransportError> {
        self.check()?;
        // Nothing comes between a period's hello and its I plane.
        let said = Arc::clone(&self.said);
        let mut said = lock(&said);
        let (mut frame, mut together) = (Vec::new(), 0);
        for plane in planes {
            let is_full = together == MAX_TOGETHER || frame.len() + plane.payload.len() + HEAD > MAX_BYTES;
            if (plane.opens() || is_full) && together > 0 {
                said.write(std::mem::take(&mut frame))?;
                together = 0;
            }
            if plane.opens() {
                self.open(&mut said)?;
                if let Some(hello) = &said.hello {
                    hello.write(&mut frame);
                    together = 1;
                }
            }
            // Before the first period there is nothing that a reader could begin with.
            if said.group.is_some() {
                self.shortener.write(&Plane { sender: 0, ..plane.clone() }, &mut frame);
                together += 1;
            }
        }
        if together > 0 { said.write(frame) } else { Ok(()) }
    }

    fn wants_intra(&mut self) -> bool {
        false
    }

    fn end(&mut self) -> Result<(), TransportError> {
        let said = Arc::clone(&self.said);
        let mut said = lock(&said);
        if said.group.is_none() {
            self.open(&mut said)?;
        }
        said.write(Message::End { sender: 0, parting: Parting::Left }.bytes())?;
        said.close()?;
        drop(said);
        // The last frame is let through before the path is withdrawn.
        let connection = self.connection.clone();
        let track = self.track.finish();
        self.runtime.block_on(async {
            tokio::time::sleep(Duration::from_millis(100)).await;
            self.broadcast.close();
            // What the relay has not taken by then is lost.
            let _ = tokio::time::timeout(PARTING, connection.close()).await;
        });
        track.map_err(|error| transport_error(&error))
    }
}

/// Milliseconds since 1970.
pub(crate) fn now_ms() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    now.as_millis().try_into().unwrap_or(u64::MAX)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use handcast_live::wire::Expander;

    /// Without a relay all is said to nobody.
    #[test]
    fn who_rests_says_its_hello_again() {
        let nobody: Url = "https://127.0.0.1:9/".parse().unwrap();
        let mut publisher = MoqPublisher::connect(&[nobody], "r", "a", &MoqOptions::default()).unwrap();
        let plane = |index| Plane { index, payload: vec![0, 0, 1, 7], ..Plane::default() };
        publisher.hello(&Hello { hands: [true, false], record: vec![1] }).unwrap();
        let planes: Vec<Plane> = (0..20).map(plane).collect();
        publisher.planes(&planes).unwrap();
        let mut frames = lock(&publisher.said).group.as_ref().unwrap().consume();
        std::thread::sleep(REPEAT * 5 / 2);
        publisher.planes(&[plane(20)]).unwrap();
        publisher.end().unwrap();
        let (mut expander, mut told) = (Expander::default(), Vec::new());
        let read = async {
            while let Some(frame) = frames.read_frame().await.unwrap() {
                let messages = expander.read_all(&frame.payload).unwrap();
                told.push((messages.len(), messages[0].kind()));
            }
        };
        publisher.runtime.block_on(read);
        let expected =
            [(8, "hello"), (8, "plane"), (5, "plane"), (1, "hello"), (1, "hello"), (1, "plane"), (1, "end")];
        assert_eq!(told, expected);
    }
}
