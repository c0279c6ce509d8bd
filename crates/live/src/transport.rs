//! The two ends of a transport: one publishes a sender's planes, the other gives what is said in a room.
//!
//! Between them may be the embedded server, a relay, or nothing but memory ([`pipe`]). A transport keeps the planes of a
//! period in order and leaves none out within it; where it cannot, it goes on with the next period.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use thiserror::Error;

use crate::wire::{Message, Parting, Plane, WireError};

/// Why an end of a transport is of no use any more.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TransportError {
    /// The other side closed it.
    #[error("live: the connection is closed: {why}")]
    Closed {
        /// What is known of it.
        why: String,
    },
    /// The other side does not let this one in.
    #[error("live: refused: {why}")]
    Refused {
        /// What is known of it.
        why: String,
    },
    /// The network's fault.
    #[error("live: {0}")]
    Io(#[from] std::io::Error),
    /// What came is no message.
    #[error(transparent)]
    Wire(#[from] WireError),
}

/// A sender, as it announces itself.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Hello {
    /// Its hands, left and right.
    pub hands: [bool; 2],
    /// The person's record as the stream carries it.
    pub record: Vec<u8>,
}

/// The end that publishes the planes of one sender.
pub trait Publish {
    /// Announces the sender, or what has changed of it.
    ///
    /// # Errors
    /// See [`TransportError`].
    fn hello(&mut self, hello: &Hello) -> Result<(), TransportError>;

    /// Publishes planes that belong together: mostly one, two where they are sent by twos; where a message does not hold all
    /// of them they go in several. One with index 0 opens a
    /// period, and the numbers of periods and planes go on without a gap. The sender's number in them is not used. Never
    /// waits for a reader.
    ///
    /// # Errors
    /// See [`TransportError`].
    fn planes(&mut self, planes: &[Plane]) -> Result<(), TransportError>;

    /// Whether an I plane was asked for since the last call.
    fn wants_intra(&mut self) -> bool;

    /// Says that no more planes come.
    ///
    /// # Errors
    /// See [`TransportError`].
    fn end(&mut self) -> Result<(), TransportError>;
}

/// The end that gives what is said in a room.
pub trait Subscribe {
    /// The next message, or none within `wait`. Planes of one sender come in order; one that does not follow on the
    /// plane before it opens a period.
    ///
    /// # Errors
    /// See [`TransportError`].
    fn next(&mut self, wait: Duration) -> Result<Option<Message>, TransportError>;

    /// Asks for an I plane of a sender; more often than the room allows it is passed over.
    ///
    /// # Errors
    /// See [`TransportError`].
    fn request_intra(&mut self, sender: u8) -> Result<(), TransportError>;
}

/// A transport in memory of one sender, number 0, and one reader: what tests and recordings need. Neither end waits;
/// when the publishing end is dropped before its end, the sender is gone.
pub fn pipe() -> (PipePublisher, PipeSubscriber) {
    let shared = Arc::new(Mutex::new(Pipe::default()));
    (PipePublisher(Arc::clone(&shared)), PipeSubscriber(shared))
}

#[derive(Debug, Default)]
struct Pipe {
    messages: VecDeque<Message>,
    wants_intra: bool,
    ended: bool,
}

fn with<T>(pipe: &Mutex<Pipe>, work: impl FnOnce(&mut Pipe) -> T) -> T {
    work(&mut pipe.lock().unwrap_or_else(PoisonError::into_inner))
}

/// The publishing end of [`pipe`].
#[derive(Debug)]
pub struct PipePublisher(Arc<Mutex<Pipe>>);

impl PipePublisher {
    fn part(&self, parting: Parting) {
        with(&self.0, |pipe| {
            if !std::mem::replace(&mut pipe.ended, true) {
                pipe.messages.push_back(Message::End { sender: 0, parting });
            }
        });
    }
}

impl Publish for PipePublisher {
    fn hello(&mut self, hello: &Hello) -> Result<(), TransportError> {
        let Hello { hands, record } = hello.clone();
        with(&self.0, |pipe| pipe.messages.push_back(Message::Hello { sender: 0, hands, record }));
        Ok(())
    }

    fn planes(&mut self, planes: &[Plane]) -> Result<(), TransportError> {
        let planes = planes.iter().map(|plane| Message::Plane(Plane { sender: 0, ..plane.clone() }));
        with(&self.0, |pipe| pipe.messages.extend(planes));
        Ok(())
    }

    fn wants_intra(&mut self) -> bool {
        with(&self.0, |pipe| std::mem::take(&mut pipe.wants_intra))
    }

    fn end(&mut self) -> Result<(), TransportError> {
        self.part(Parting::Left);
        Ok(())
    }
}

impl Drop for PipePublisher {
    fn drop(&mut self) {
        self.part(Parting::Gone);
    }
}

/// The subscribing end of [`pipe`].
#[derive(Debug)]
pub struct PipeSubscriber(Arc<Mutex<Pipe>>);

impl Subscribe for PipeSubscriber {
    fn next(&mut self, _wait: Duration) -> Result<Option<Message>, TransportError> {
        with(&self.0, |pipe| match pipe.messages.pop_front() {
            None if pipe.ended => Err(TransportError::Closed { why: "the sender has ended".into() }),
            message => Ok(message),
        })
    }

    fn request_intra(&mut self, _sender: u8) -> Result<(), TransportError> {
        with(&self.0, |pipe| pipe.wants_intra = true);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_goes_in_comes_out() {
        let (mut publisher, mut subscriber) = pipe();
        let wait = Duration::ZERO;
        publisher.hello(&Hello { hands: [false, true], record: vec![1] }).unwrap();
        let plane = Plane { sender: 9, period: 3, payload: vec![4], ..Plane::default() };
        publisher.planes(std::slice::from_ref(&plane)).unwrap();
        let hello = Message::Hello { sender: 0, hands: [false, true], record: vec![1] };
        assert_eq!(subscriber.next(wait).unwrap(), Some(hello));
        assert_eq!(subscriber.next(wait).unwrap(), Some(Message::Plane(Plane { sender: 0, ..plane })));
        assert_eq!(subscriber.next(wait).unwrap(), None);
        assert!(!publisher.wants_intra());
        subscriber.request_intra(0).unwrap();
        assert!(publisher.wants_intra() && !publisher.wants_intra());
        drop(publisher);
        let gone = Message::End { sender: 0, parting: Parting::Gone };
        assert_eq!(subscriber.next(wait).unwrap(), Some(gone));
        assert!(subscriber.next(wait).is_err());
    }
}
