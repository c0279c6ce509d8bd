//! The end that publishes.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use handcast_live::transport::{Hello, Publish, TransportError};
use handcast_live::wire::{Message, Parting, Plane, Shortener};
use moq_net::{Timestamp, broadcast, group, track};
use moq_tokio::Connection;
use tokio::runtime::Runtime;
use url::Url;

use crate::options::{addresses, runtime};
use crate::{MoqOptions, TRACK, transport_error};

/// Longest wait for what has been said to arrive, at the end.
const PARTING: Duration = Duration::from_secs(1);

/// Publishes the planes of one sender to relays.
///
/// When a relay is lost it is dialled again, or the next one of the list; meanwhile planes are published to nobody. A relay
/// gives every joiner the current period from its beginning, so I planes are not asked for.
pub struct MoqPublisher {
    connection: Connection,
    broadcast: broadcast::Producer,
    track: track::Producer,
    group: Option<group::Producer>,
    /// Number of the next group: goes on from those of a sender of this name before it.
    next: u64,
    last: u64,
    hello: Option<Message>,
    shortener: Shortener,
    /// Why the connection has ended for good.
    ended: Arc<Mutex<Option<String>>>,
    // The last field: what the others do when dropped needs it.
    runtime: Runtime,
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
        drop(entered);
        Ok(Self {
            connection,
            broadcast,
            track,
            group: None,
            next: now_ms(),
            last: 0,
            hello: None,
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

    /// Writes a frame into the current group.
    fn write(&mut self, bytes: Vec<u8>) -> Result<(), TransportError> {
        let Some(group) = &mut self.group else { return Ok(()) };
        // Relays measure the age of groups by this, so it must not go back.
        self.last = self.last.max(now_ms());
        let time = Timestamp::from_millis(self.last).map_err(|error| transport_error(&error))?;
        let frame = moq_net::bytes::Bytes::from(bytes);
        group.write_frame(time, frame).map_err(|error| transport_error(&error))
    }

    /// Ends the group there is and opens the next.
    fn open(&mut self) -> Result<(), TransportError> {
        self.close()?;
        let group = self.track.create_group(self.next.into()).map_err(|error| transport_error(&error))?;
        self.next += 1;
        self.group = Some(group);
        self.shortener = Shortener::default();
        Ok(())
    }

    fn close(&mut self) -> Result<(), TransportError> {
        match self.group.take() {
            Some(group) => group.finish().map_err(|error| transport_error(&error)),
            None => Ok(()),
        }
    }
}

impl Publish for MoqPublisher {
    fn hello(&mut self, hello: &Hello) -> Result<(), TransportError> {
        self.check()?;
        let Hello { hands, record } = hello.clone();
        let hello = Message::Hello { sender: 0, hands, record };
        let bytes = hello.bytes();
        self.hello = Some(hello);
        self.write(bytes)
    }

    fn planes(&mut self, planes: &[Plane]) -> Result<(), TransportError> {
        self.check()?;
        let mut bytes = Vec::new();
        for plane in planes {
            if plane.opens() {
                if !bytes.is_empty() {
                    self.write(std::mem::take(&mut bytes))?;
                }
                self.open()?;
                if let Some(hello) = &self.hello {
                    hello.write(&mut bytes);
                }
            }
            // Before the first period there is nothing that a reader could begin with.
            if self.group.is_some() {
                self.shortener.write(&Plane { sender: 0, ..plane.clone() }, &mut bytes);
            }
        }
        if bytes.is_empty() { Ok(()) } else { self.write(bytes) }
    }

    fn wants_intra(&mut self) -> bool {
        false
    }

    fn end(&mut self) -> Result<(), TransportError> {
        if self.group.is_none() {
            self.open()?;
        }
        self.write(Message::End { sender: 0, parting: Parting::Left }.bytes())?;
        self.close()?;
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
