//! Messages on their way from the network to a reader that may be slow.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use handcast_live::wire::{MAX_SENDERS, Message};

/// Most messages that wait for the reader.
const MOST: usize = 1024;

/// What waits; a reader that is too slow goes on with the next periods.
#[derive(Debug, Default)]
pub(crate) struct Mailbox {
    content: Mutex<Content>,
    more: Condvar,
}

#[derive(Debug, Default)]
struct Content {
    messages: VecDeque<Message>,
    /// Senders whose planes are passed over up to the next period.
    skipped: [bool; MAX_SENDERS as usize],
    closed: Option<String>,
}

impl Mailbox {
    fn lock(&self) -> MutexGuard<'_, Content> {
        self.content.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Never waits.
    pub(crate) fn push(&self, message: Message) {
        let mut content = self.lock();
        // A hello that repeats one that waits says nothing.
        let is_news =
            |before: &&Message| before.sender() == message.sender() && !matches!(before, Message::Plane(_));
        if matches!(message, Message::Hello { .. })
            && content.messages.iter().rfind(is_news) == Some(&message)
        {
            return;
        }
        if content.messages.len() >= MOST {
            content.messages.retain(|message| !matches!(message, Message::Plane(_)));
            content.skipped = [true; MAX_SENDERS as usize];
        }
        if let Message::Plane(plane) = &message
            && let Some(skipped) = content.skipped.get_mut(usize::from(plane.sender))
        {
            *skipped &= !plane.opens();
            if *skipped {
                return;
            }
        }
        content.messages.push_back(message);
        self.more.notify_one();
    }

    /// Nothing comes any more.
    pub(crate) fn close(&self, why: String) {
        self.lock().closed.get_or_insert(why);
        self.more.notify_one();
    }

    /// The next message, none within `wait`, or why none comes any more.
    pub(crate) fn pop(&self, wait: Duration) -> Result<Option<Message>, String> {
        let end = Instant::now() + wait;
        let mut content = self.lock();
        loop {
            if let Some(message) = content.messages.pop_front() {
                return Ok(Some(message));
            }
            if let Some(why) = &content.closed {
                return Err(why.clone());
            }
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(None);
            }
            let waited = self.more.wait_timeout(content, left);
            content = waited.map_or_else(|error| error.into_inner().0, |(content, _)| content);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_live::wire::Plane;

    #[test]
    fn a_slow_reader_goes_on_with_the_next_period() {
        let mailbox = Mailbox::default();
        let plane = |index| Message::Plane(Plane { sender: 1, index, ..Plane::default() });
        for _ in 0..3 {
            mailbox.push(Message::Hello { sender: 1, hands: [true, false], record: Vec::new() });
        }
        for index in 0..MOST as u16 + 10 {
            mailbox.push(plane(index));
        }
        for message in [plane(0), plane(1)] {
            mailbox.push(message);
        }
        let wait = Duration::ZERO;
        assert!(matches!(mailbox.pop(wait), Ok(Some(Message::Hello { .. }))));
        assert_eq!(mailbox.pop(wait), Ok(Some(plane(0))));
        assert_eq!(mailbox.pop(wait), Ok(Some(plane(1))));
        assert_eq!(mailbox.pop(wait), Ok(None));
        mailbox.close("over".into());
        assert_eq!(mailbox.pop(Duration::from_secs(9)), Err("over".into()));
    }
}
