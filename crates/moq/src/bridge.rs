//! Two transports joined.

use std::collections::{HashMap, HashSet};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use handcast_live::transport::{Hello, Publish, Subscribe, TransportError};
use handcast_live::wire::{MAX_TOGETHER, Message, Parting, Plane};

/// Longest wait for a message before it is looked whether to stop.
const WAIT: Duration = Duration::from_millis(200);
/// One who was not let in asks again no sooner: the others wait meanwhile.
const AGAIN: Duration = Duration::from_secs(10);

/// Carries the senders of one room into another, each through a publishing end that `open` makes, as long as `go_on` says so.
///
/// `open` gives the number that the sender has in the other room, if rooms number there; `own` holds such numbers, and senders
/// whose number is in `skip` are not carried: with the `own` of one direction as the `skip` of the other, nothing goes in circles.
/// One that is not let in ([`TransportError::Refused`]) keeps nobody else out, and asks again with a hello ten seconds later or more.
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
    let mut refused: HashMap<u8, Instant> = HashMap::new();
    let mut next = None;
    while go_on() {
        let Some(message) = next.take().map_or_else(|| from.next(WAIT), |next| Ok(Some(next)))? else {
            continue;
        };
        let Some(sender) = message.sender() else { continue };
        if skipped(sender) {
            continue;
        }
        let done = match message {
            Message::Hello { hands, record, .. } => {
                let hello = Hello { hands, record };
                match ends.get_mut(&sender) {
                    Some((end, _)) => end.hello(&hello),
                    None if refused.get(&sender).is_some_and(|at| at.elapsed() < AGAIN) => Ok(()),
                    None => {
                        // The other direction must not see a sender before it is known whose it is.
                        let mut own = own.lock().unwrap_or_else(PoisonError::into_inner);
                        match open(sender, &hello) {
                            Ok(end) => {
                                own.extend(end.1);
                                ends.insert(sender, end);
                            }
                            Err(TransportError::Refused { .. }) => {
                                refused.insert(sender, Instant::now());
                            }
                            Err(error) => return Err(error),
                        }
                        Ok(())
                    }
                }
            }
            Message::Plane(plane) => {
                let planes;
                (planes, next) = together(plane, from);
                ends.get_mut(&sender).map_or(Ok(()), |(end, _)| end.planes(&planes))
            }
            Message::End { parting, .. } => {
                // Another one may have its number next.
                refused.remove(&sender);
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

/// A plane with those of its sender behind it, where it is replayed: periods come out of a relay's cache at once, and go on in
/// few messages; what is live waits for nothing. Also what came behind them.
fn together(plane: Plane, from: &mut dyn Subscribe) -> (Vec<Plane>, Option<Message>) {
    let sender = plane.sender;
    let mut planes = vec![plane];
    while planes.len() < MAX_TOGETHER && planes.last().is_some_and(|plane| plane.replay) {
        match from.next(Duration::ZERO) {
            Ok(Some(Message::Plane(plane))) if plane.sender == sender => planes.push(plane),
            Ok(next) => return (planes, next),
            // It is told when there is nothing else.
            Err(_) => break,
        }
    }
    (planes, None)
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_live::client::RoomClient;
    use handcast_live::server::{Server, ServerOptions};
    use handcast_live::transport::pipe;
    use std::cell::Cell;
    use std::collections::VecDeque;
    use std::sync::Arc;

    /// What is said in a room, and then no more.
    struct Course(VecDeque<Message>);

    impl Subscribe for Course {
        fn next(&mut self, _wait: Duration) -> Result<Option<Message>, TransportError> {
            let end = || TransportError::Closed { why: "the course is over".into() };
            self.0.pop_front().map(Some).ok_or_else(end)
        }

        fn request_intra(&mut self, _sender: u8) -> Result<(), TransportError> {
            Ok(())
        }
    }

    fn hello(sender: u8) -> Message {
        Message::Hello { sender, hands: [true, false], record: Vec::new() }
    }

    fn plane(sender: u8, index: u16) -> Message {
        let payload = vec![0, 0, 1, index as u8];
        Message::Plane(Plane { sender, index, time_ms: 33 * u32::from(index), payload, ..Plane::default() })
    }

    /// A room that takes no senders, or no more, ends no bridge: it is as if it did not let one in.
    #[test]
    fn a_sender_that_a_room_refuses_keeps_no_other_out() {
        let options = ServerOptions::new("127.0.0.1:0".parse().unwrap()).with_senders(false);
        let server = Server::start(options).unwrap();
        let mut course = Course([hello(1), hello(2), plane(1, 0), hello(1), plane(2, 0), hello(2)].into());
        let opened = Cell::new(None);
        let mut tried = 0;
        let (to, mut out) = pipe();
        let mut to = Some(to);
        let open = |sender: u8, hello: &Hello| {
            if sender == 1 {
                tried += 1;
                RoomClient::connect(server.address(), "hand", "")?.hello(hello)?;
            }
            let mut end = to.take().ok_or(TransportError::Closed { why: "once".into() })?;
            end.hello(hello)?;
            opened.set(Some(sender));
            Ok((end, None))
        };
        let sets: [Mutex<HashSet<u8>>; 2] = [Mutex::default(), Mutex::default()];
        let ended = bridge(&mut course, open, &sets[0], &sets[1], || true).unwrap_err();
        assert!(ended.to_string().contains("the course is over"), "{ended}");
        assert_eq!((opened.get(), tried), (Some(2), 1), "not again at once");
        let mut kinds = Vec::new();
        while let Ok(Some(message)) = out.next(WAIT) {
            kinds.push(message.kind());
        }
        assert_eq!(kinds, ["hello", "plane", "hello", "end"], "a repeated hello is passed on");
    }

    #[test]
    fn planes_that_are_replayed_go_on_together() {
        let replay = |index| match plane(3, index) {
            Message::Plane(plane) => Message::Plane(Plane { replay: index < 19, ..plane }),
            other => other,
        };
        let mut course: VecDeque<Message> = (0..20).map(replay).collect();
        course.push_front(hello(3));
        course.extend([plane(4, 0), plane(3, 20), plane(3, 21)]);
        #[derive(Clone, Default)]
        struct End(Arc<Mutex<Vec<usize>>>);
        impl Publish for End {
            fn hello(&mut self, _hello: &Hello) -> Result<(), TransportError> {
                Ok(())
            }
            fn planes(&mut self, planes: &[Plane]) -> Result<(), TransportError> {
                self.0.lock().unwrap().push(planes.len());
                Ok(())
            }
            fn wants_intra(&mut self) -> bool {
                false
            }
            fn end(&mut self) -> Result<(), TransportError> {
                Ok(())
            }
        }
        let end = End::default();
        let sets: [Mutex<HashSet<u8>>; 2] = [Mutex::default(), Mutex::default()];
        let open = |_: u8, _: &Hello| Ok((end.clone(), None));
        assert!(bridge(&mut Course(course), open, &sets[0], &sets[1], || true).is_err());
        assert_eq!(*end.0.lock().unwrap(), [8, 8, 4, 1, 1]);
    }

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
