//! The end that subscribes.

use std::collections::{HashMap, HashSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use handcast_live::transport::{Subscribe, TransportError};
use handcast_live::wire::{Expander, MAX_SENDERS, Message, Parting};
use moq_net::{Pattern, Patterns, group, origin};
use moq_tokio::Connection;
use tokio::runtime::Runtime;
use tokio::sync::Notify;
use tokio::time::timeout;
use url::Url;

use crate::freshness::Freshness;
use crate::mailbox::Mailbox;
use crate::options::{addresses, runtime};
use crate::{MoqOptions, TRACK, transport_error};

/// Pause before a track that broke off is asked for again.
const AGAIN: Duration = Duration::from_millis(50);

/// Gives what is said in a room on relays. Senders are numbered as they are found.
///
/// When a relay is lost it is dialled again, or the next one of the list; of each sender the planes go on with a period. A sender
/// of whom nothing comes is said to be gone, and back when planes come again. Hellos come again and again, also while nothing has
/// changed. Who comes when there are [`MAX_SENDERS`] is read when one of them has gone.
pub struct MoqSubscriber {
    mailbox: Arc<Mailbox>,
    connection: Connection,
    // The last field: what the others do when dropped needs it.
    runtime: Runtime,
}

impl std::fmt::Debug for MoqSubscriber {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("MoqSubscriber").finish_non_exhaustive()
    }
}

impl MoqSubscriber {
    /// Subscribes to a room at the first of `relays` that answers. Gives back at once; dialling goes on behind.
    ///
    /// # Errors
    /// [`TransportError`] for options or a room that cannot be used.
    pub fn connect(relays: &[Url], room: &str, options: &MoqOptions) -> Result<Self, TransportError> {
        Self::connect_but(relays, room, None, options)
    }

    /// As [`Self::connect`], without the senders whose name begins with `but`: those of one's own.
    ///
    /// # Errors
    /// As [`Self::connect`].
    pub fn connect_but(
        relays: &[Url],
        room: &str,
        but: Option<&str>,
        options: &MoqOptions,
    ) -> Result<Self, TransportError> {
        let addresses = addresses(relays)?;
        let pattern = Pattern::subtree(room).map_err(|error| transport_error(&error))?;
        let runtime = runtime()?;
        let entered = runtime.enter();
        let origin = moq_tokio::origin::spawn();
        let senders = origin.consume().scope("", &Patterns::from(pattern));
        let senders = senders.map_err(|error| transport_error(&error))?;
        let connection = options.client(relays.len())?.with_subscriber(origin).connect(addresses);
        let mailbox = Arc::new(Mailbox::default());
        let reader = Reader {
            room: Arc::new(Room::default()),
            senders,
            mailbox: Arc::clone(&mailbox),
            options: options.clone(),
        };
        runtime.spawn(reader.run(but.map(|but| format!("{room}/{but}"))));
        let (watched, told) = (connection.clone(), Arc::clone(&mailbox));
        runtime.spawn(async move {
            told.close(match watched.closed().await {
                Ok(()) => "the relay closed the connection".into(),
                Err(error) => transport_error(&error).to_string(),
            });
        });
        drop(entered);
        Ok(Self { mailbox, connection, runtime })
    }

    /// Whether a relay is connected.
    pub fn is_connected(&self) -> bool {
        self.connection.connected()
    }

    /// Waits until a relay is connected, at most `wait`; gives whether one is.
    pub fn wait_connected(&self, wait: Duration) -> bool {
        let connection = self.connection.clone();
        let established = async { timeout(wait, connection.established()).await };
        self.runtime.block_on(established).is_ok_and(|done| done.is_ok())
    }
}

impl Subscribe for MoqSubscriber {
    fn next(&mut self, wait: Duration) -> Result<Option<Message>, TransportError> {
        self.mailbox.pop(wait).map_err(|why| TransportError::Closed { why })
    }

    /// Relays give the current period from its beginning: nothing is asked for.
    fn request_intra(&mut self, _sender: u8) -> Result<(), TransportError> {
        Ok(())
    }
}

/// Who is there.
#[derive(Debug, Default)]
struct Room {
    senders: Mutex<Senders>,
    /// That a number is free again.
    freed: Notify,
}

#[derive(Debug, Default)]
struct Senders {
    announced: HashSet<String>,
    /// Numbers of the senders that are read.
    numbers: HashMap<String, u8>,
}

impl Room {
    fn lock(&self) -> MutexGuard<'_, Senders> {
        self.senders.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The number of a sender that is to be read from here on; none where it is read already, or the room is full.
    fn enter(&self, path: &str) -> Option<u8> {
        let mut senders = self.lock();
        senders.announced.insert(path.to_owned());
        if senders.numbers.contains_key(path) {
            return None;
        }
        let number = (0..MAX_SENDERS).find(|n| !senders.numbers.values().any(|m| m == n))?;
        senders.numbers.insert(path.to_owned(), number);
        Some(number)
    }

    fn withdraw(&self, path: &str) {
        self.lock().announced.remove(path);
    }

    /// Gives up the number of a sender that is not announced any more; whether it was.
    fn leave(&self, path: &str) -> bool {
        let mut senders = self.lock();
        let gone = !senders.announced.contains(path);
        if gone {
            senders.numbers.remove(path);
            self.freed.notify_one();
        }
        gone
    }

    /// Those for whom there was no number.
    fn left_out(&self) -> Vec<String> {
        let senders = self.lock();
        senders.announced.iter().filter(|path| !senders.numbers.contains_key(*path)).cloned().collect()
    }
}

/// Finds the senders of a room.
struct Reader {
    room: Arc<Room>,
    senders: origin::Consumer,
    mailbox: Arc<Mailbox>,
    options: MoqOptions,
}

impl Reader {
    async fn run(self, but: Option<String>) {
        let mut announced = self.senders.announced();
        loop {
            let update = tokio::select! {
                update = announced.next() => update,
                () = self.room.freed.notified() => {
                    self.room.left_out().into_iter().for_each(|path| self.admit(path));
                    continue;
                }
            };
            let Some(update) = update else { return };
            let path = update.prefix.as_str().to_owned();
            if but.as_ref().is_some_and(|but| path.starts_with(but)) {
                continue;
            }
            if update.kind.is_active() {
                self.admit(path);
            } else {
                self.room.withdraw(&path);
            }
        }
    }

    /// Reads a sender, where it is not read and there is a number for it.
    fn admit(&self, path: String) {
        let Some(number) = self.room.enter(&path) else { return };
        let sender = Sender {
            number,
            path,
            mailbox: Arc::clone(&self.mailbox),
            freshness: Freshness::new(self.options.stale),
            silence: self.options.silence,
            hello: None,
            here: false,
            before: None,
        };
        tokio::spawn(sender.run(self.senders.clone(), Arc::clone(&self.room)));
    }
}

/// Why a sender cannot be read on.
enum Broken {
    /// Nothing has come for too long.
    Silent,
    /// The network's fault, or the end of a track.
    Off,
}

async fn within<T>(
    silence: Duration,
    work: impl IntoFuture<Output = Result<T, moq_net::Error>>,
) -> Result<T, Broken> {
    match timeout(silence, work).await {
        Ok(done) => done.map_err(|_| Broken::Off),
        Err(_) => Err(Broken::Silent),
    }
}

/// Reads one sender.
struct Sender {
    number: u8,
    path: String,
    mailbox: Arc<Mailbox>,
    freshness: Freshness,
    silence: Duration,
    hello: Option<Message>,
    /// Whether the reader has been told that it is there.
    here: bool,
    /// Sequence of the last group that was begun.
    before: Option<u64>,
}

impl Sender {
    async fn run(mut self, senders: origin::Consumer, room: Arc<Room>) {
        loop {
            // What breaks off begins again: with the next relay, or when the sender is back.
            if let Err(Broken::Silent) = self.read(&senders).await {
                self.part(Parting::Gone);
            }
            if !self.here && room.leave(&self.path) {
                return;
            }
            tokio::time::sleep(AGAIN).await;
        }
    }

    /// Waits for the track and reads it.
    async fn read(&mut self, senders: &origin::Consumer) -> Result<(), Broken> {
        let silence = self.silence;
        let broadcast = within(silence, senders.routed_broadcast(&self.path)).await?;
        let track = broadcast.track(TRACK).map_err(|_| Broken::Off)?;
        let mut groups = within(silence, track.subscribe(None)).await?.ordered();
        loop {
            let group = match within(silence, groups.next_group()).await {
                Ok(Some(group)) => group,
                Ok(None) => return Ok(()),
                // The subscription stays: the sender may be back.
                Err(Broken::Silent) => {
                    self.part(Parting::Gone);
                    continue;
                }
                Err(Broken::Off) => return Err(Broken::Off),
            };
            // A relay that takes over may begin with what was read from the one before it.
            if self.before.is_some_and(|before| group.sequence <= before) {
                continue;
            }
            self.before = Some(group.sequence);
            self.read_group(group).await;
        }
    }

    /// Reads a group to its end, or to where it breaks off, which the next one follows.
    async fn read_group(&mut self, mut group: group::Consumer) {
        let mut expander = Expander::default();
        loop {
            match within(self.silence, group.read_frame()).await {
                // A frame that is no message is passed over with what hangs on it.
                Ok(Some(frame)) => {
                    for message in expander.read_all(&frame.payload).unwrap_or_default() {
                        self.take(message);
                    }
                }
                Err(Broken::Silent) => self.part(Parting::Gone),
                Ok(None) | Err(Broken::Off) => return,
            }
        }
    }

    fn take(&mut self, message: Message) {
        let sender = self.number;
        match message {
            Message::Hello { hands, record, .. } => {
                let hello = Message::Hello { sender, hands, record };
                // Also one that says nothing new: where hands rest it alone says that they are there.
                if self.here {
                    self.mailbox.push(hello.clone());
                }
                self.hello = Some(hello);
            }
            Message::Plane(plane) => {
                let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
                for plane in self.freshness.push(plane, now) {
                    if !self.here {
                        self.here = true;
                        self.hello.iter().cloned().for_each(|hello| self.mailbox.push(hello));
                    }
                    self.mailbox.push(Message::Plane(handcast_live::wire::Plane { sender, ..plane }));
                }
            }
            Message::End { parting, .. } => self.part(parting),
            _ => {}
        }
    }

    fn part(&mut self, parting: Parting) {
        // Who comes back begins with a period.
        self.freshness.pause();
        if std::mem::take(&mut self.here) {
            self.mailbox.push(Message::End { sender: self.number, parting });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_is_left_out_is_read_when_a_number_is_free() {
        let room = Room::default();
        let path = |n: u8| format!("room/{n}");
        for n in 0..MAX_SENDERS {
            assert_eq!(room.enter(&path(n)), Some(n));
        }
        assert_eq!((room.enter("room/late"), room.enter("room/later")), (None, None));
        assert!(room.enter(&path(3)).is_none() && !room.leave(&path(3)), "it is announced");
        room.withdraw("room/later");
        room.withdraw(&path(3));
        assert_eq!(room.left_out(), ["room/late"]);
        assert!(room.leave(&path(3)));
        assert_eq!(room.enter("room/late"), Some(3));
        assert!(room.left_out().is_empty());
    }
}
