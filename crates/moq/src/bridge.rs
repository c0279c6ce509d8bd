//! Two transports joined.

use std::collections::{HashMap, HashSet};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use handcast_live::transport::{Hello, Publish, Subscribe, TransportError};
use handcast_live::wire::{Message, Parting};

/// Longest wait for a message before it is looked whether to stop.
const WAIT: Duration = Duration::from_millis(200);

/// Carries the senders of one room into another, each through a publishing end that `open` makes, as long as `go_on` says so.
///
/// `open` gives the number that the sender has in the other room, if rooms number there; `own` holds such numbers, and senders
/// whose number is in `skip` are not carried: with the `own` of one direction as the `skip` of the other, nothing goes in circles.
///
/// # Errors
/// [`TransportError`] of the reading end; a publishing end that fails is opened again with the next hello.
pub fn bridge<P: Publish + Send + 'static>(
    from: &mut dyn Subscribe,
    mut open: impl FnMut(u8, &Hello) -> Result<(P, Option<u8>), TransportError>,
    own: &Mutex<HashSet<u8>>,
    skip: &Mutex<HashSet<u8>>,
    go_on: impl Fn() -> bool,
) -> Result<(), TransportError> {
    let lock = |set: &Mutex<HashSet<u8>>, number: u8, here: bool| {
        let mut set = set.lock().unwrap_or_else(PoisonError::into_inner);
        if here { set.insert(number) } else { set.remove(&number) }
    };
    let skipped = |number: u8| skip.lock().unwrap_or_else(PoisonError::into_inner).contains(&number);
    let mut ends: HashMap<u8, (P, Option<u8>)> = HashMap::new();
    while go_on() {
        let Some(message) = from.next(WAIT)? else { continue };
        let Some(sender) = message.sender() else { continue };
        if skipped(sender) {
            continue;
        }
        let done = match message {
            Message::Hello { hands, record, .. } => {
                let hello = Hello { hands, record };
                match ends.get_mut(&sender) {
                    Some((end, _)) => end.hello(&hello),
                    None => {
                        // The other direction must not see a sender before it is known whose it is.
                        let mut own = own.lock().unwrap_or_else(PoisonError::into_inner);
                        match open(sender, &hello) {
                            Ok(end) => {
                                own.extend(end.1);
                                ends.insert(sender, end);
                            }
                            // One that is not let in asks again with its next hello.
                            Err(TransportError::Refused { .. }) => {}
                            Err(error) => return Err(error),
                        }
                        Ok(())
                    }
                }
            }
            Message::Plane(plane) => match ends.get_mut(&sender) {
                Some((end, _)) => end.planes(&[plane]),
                None => Ok(()),
            },
            Message::End { parting, .. } => {
                if let Some((mut end, number)) = ends.remove(&sender) {
                    number.map(|number| lock(own, number, false));
                    // Saying goodbye takes a while, for which the others should not wait.
                    std::thread::spawn(move || (parting == Parting::Left).then(|| end.end()));
                }
                Ok(())
            }
            _ => Ok(()),
        };
        if done.is_err()
            && let Some((_, Some(number))) = ends.remove(&sender)
        {
            lock(own, number, false);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_live::transport::pipe;
    use handcast_live::wire::Plane;
    use std::cell::Cell;

    #[test]
    fn senders_are_carried_but_for_those_skipped() {
        let (mut publisher, mut reader) = pipe();
        let hello = Hello { hands: [true, false], record: Vec::new() };
        publisher.hello(&hello).unwrap();
        publisher.planes(&[Plane { payload: vec![1], ..Plane::default() }]).unwrap();
        publisher.end().unwrap();
        let sets: [Mutex<HashSet<u8>>; 2] = [Mutex::default(), Mutex::default()];
        let opened = Cell::new(0);
        let (to, mut out) = pipe();
        let mut to = Some(to);
        let open = |_: u8, hello: &Hello| {
            opened.set(opened.get() + 1);
            let mut end = to.take().ok_or(TransportError::Closed { why: "once".into() })?;
            end.hello(hello)?;
            Ok((end, Some(7)))
        };
        // The pipe says that it is closed when all has been read.
        assert!(bridge(&mut reader, open, &sets[0], &sets[1], || true).is_err());
        assert_eq!(opened.get(), 1);
        let mut kinds = Vec::new();
        while let Ok(Some(message)) = out.next(WAIT) {
            kinds.push(message);
        }
        assert!(matches!(kinds[..2], [Message::Hello { .. }, Message::Plane(_)]), "{kinds:?}");

        let (mut publisher, mut reader) = pipe();
        publisher.hello(&hello).unwrap();
        drop(publisher);
        sets[1].lock().unwrap().insert(0);
        let never = |_: u8, _: &Hello| -> Result<(handcast_live::transport::PipePublisher, Option<u8>), _> {
            panic!("sender 0 is skipped")
        };
        assert!(bridge(&mut reader, never, &sets[0], &sets[1], || true).is_err());
    }
}
