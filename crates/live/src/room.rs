//! A room: its senders, what each has sent in its current period, and who has how much of it.
//!
//! There are no sockets here. The server asks what to write to whom, and writes it.

use std::time::{Duration, Instant};

use crate::transport::Hello;
use crate::wire::{
    MAX_BYTES, MAX_RECORD, MAX_SENDERS, MAX_TOGETHER, Message, Parting, Plane, Shortener, in_messages,
};

/// Most planes of a period that are kept for those who come late, and most bytes.
const MOST_KEPT: usize = 1200;
const MOST_BYTES: usize = 256 << 10;
/// Most bytes of the periods of all senders that one who comes late is told.
const MOST_REPLAYED: usize = MOST_BYTES;
/// I planes are asked of a sender no more often than this.
const BETWEEN_REQUESTS: Duration = Duration::from_secs(1);
/// And for readers that were slow no more often than this: one that always is would have everybody pay for it.
const BETWEEN_MENDINGS: Duration = Duration::from_secs(5);

/// How much of a sender's stream a reader has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Follows {
    /// Not enough: it goes on with the next period.
    #[default]
    Waits,
    /// All of the period.
    All,
}

/// What one reader has of every sender.
pub(crate) type Following = [Follows; MAX_SENDERS as usize];

/// Planes as they are written to readers.
#[derive(Debug)]
pub(crate) struct Delivery {
    pub sender: u8,
    /// For those that have what came before.
    pub bytes: Vec<u8>,
    /// Whether they open a period, so that everybody can read them.
    pub opens: bool,
    /// Bytes of the stream among them.
    pub payload: usize,
}

impl Delivery {
    /// Whether a reader is to get it; `ready` says that it has room.
    pub fn is_for(&self, following: &mut Following, ready: bool) -> bool {
        let Some(follows) = following.get_mut(usize::from(self.sender)) else { return false };
        *follows = match (ready, *follows) {
            (true, Follows::All) => Follows::All,
            (true, Follows::Waits) if self.opens => Follows::All,
            _ => Follows::Waits,
        };
        *follows == Follows::All
    }
}

/// Why planes are refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum RoomError {
    #[error("there are {MAX_SENDERS} senders already")]
    Full,
    #[error("a period opens without a start code")]
    NoStartCode,
    #[error("a record is longer than {MAX_RECORD} bytes")]
    Record,
}

#[derive(Debug)]
struct Sender {
    hello: Hello,
    /// Whether it has said hello.
    announced: bool,
    /// The planes of the current period; empty when it cannot be joined any more.
    planes: Vec<Plane>,
    bytes: usize,
    /// Whether it has sent anything.
    begun: bool,
    /// Period and index of the last plane.
    last: Option<(u16, u16)>,
    asked: Option<Instant>,
    mended: Option<Instant>,
    /// Whether an I plane is wanted that could not be asked for yet, and has not come since.
    wanted: bool,
}

/// The senders of a room.
#[derive(Debug, Default)]
pub(crate) struct Room {
    senders: [Option<Sender>; MAX_SENDERS as usize],
    shortener: Shortener,
}

impl Room {
    /// A number for a new sender.
    pub fn enter(&mut self) -> Result<u8, RoomError> {
        let free = self.senders.iter().position(Option::is_none).ok_or(RoomError::Full)?;
        let hello = Hello::default();
        self.senders[free] = Some(Sender {
            hello,
            announced: false,
            planes: Vec::new(),
            bytes: 0,
            begun: false,
            last: None,
            asked: None,
            mended: None,
            wanted: false,
        });
        Ok(free as u8)
    }

    /// Takes a sender's announcement; what everybody is to be told of it, nothing where it is the same as before.
    pub fn announce(&mut self, number: u8, hello: Hello) -> Result<Vec<u8>, RoomError> {
        if hello.record.len() > MAX_RECORD {
            return Err(RoomError::Record);
        }
        let Some(sender) = self.sender(number) else { return Ok(Vec::new()) };
        let known = std::mem::replace(&mut sender.announced, true) && sender.hello == hello;
        if known {
            return Ok(Vec::new());
        }
        sender.hello = hello;
        Ok(sender.message(number).bytes())
    }

    /// A sender is there no more; what everybody is to be told. Nothing of it is replayed.
    pub fn leave(&mut self, number: u8, parting: Parting) -> Vec<u8> {
        match self.senders.get_mut(usize::from(number)).and_then(Option::take) {
            Some(_) => Message::End { sender: number, parting }.bytes(),
            None => Vec::new(),
        }
    }

    /// Takes planes of a sender that belong together, for as many messages as they need. What does not go on from
    /// the planes before it is passed over up to the next period.
    pub fn publish(&mut self, number: u8, planes: Vec<Plane>) -> Result<Vec<Delivery>, RoomError> {
        let mut groups: Vec<Vec<Plane>> = Vec::new();
        for plane in planes {
            let plane = Plane { sender: number, replay: false, ..plane };
            if plane.opens() && !plane.payload.starts_with(&[0, 0, 1]) {
                return Err(RoomError::NoStartCode);
            }
            let Some(sender) = self.sender(number) else { break };
            if !sender.take(&plane) {
                continue;
            }
            match groups.last_mut() {
                Some(group) if !plane.opens() => group.push(plane),
                _ => groups.push(vec![plane]),
            }
        }
        let messages = groups.iter().flat_map(|group| in_messages(group));
        Ok(messages.map(|planes| self.delivery(number, planes)).collect())
    }

    /// Planes that are handed over together.
    fn delivery(&mut self, sender: u8, planes: &[Plane]) -> Delivery {
        let mut bytes = Vec::new();
        self.shortener.write_together(planes, &mut bytes);
        let payload = planes.iter().map(|plane| plane.payload.len()).sum();
        Delivery { sender, bytes, opens: planes.first().is_some_and(Plane::opens), payload }
    }

    /// What one who comes is told: the senders, and of each the current period, all but its last plane not to be shown. Of those
    /// whose period cannot be joined, or is too much after that of others, it waits for the next one: their numbers.
    pub fn welcome(&self, following: &mut Following) -> (Vec<Vec<u8>>, Vec<u8>) {
        let (mut told, mut missing, mut left) = (Vec::new(), Vec::new(), MOST_REPLAYED);
        for ((number, sender), follows) in (0u8..).zip(&self.senders).zip(following) {
            let Some(sender) = sender else { continue };
            told.push(sender.message(number).bytes());
            let fits = sender.bytes <= left;
            if fits && !sender.planes.is_empty() {
                left -= sender.bytes;
                sender.replay(&mut told);
                *follows = Follows::All;
            } else {
                *follows = Follows::Waits;
                if sender.begun {
                    missing.push(number);
                }
            }
        }
        (told, missing)
    }

    /// Whether an I plane is to be asked of a sender now. Where it is too early, [`Self::overdue`] names it later.
    pub fn may_ask(&mut self, number: u8, now: Instant) -> bool {
        let Some(sender) = self.sender(number) else { return false };
        let may = sender.may_ask(now);
        sender.wanted |= !may;
        may
    }

    /// Whether an I plane is to be asked of a sender now for readers that have room again and wait for its next period.
    pub fn may_mend(&mut self, number: u8, now: Instant) -> bool {
        let Some(sender) = self.sender(number) else { return false };
        let due = sender.mended.is_none_or(|mended| now.duration_since(mended) >= BETWEEN_MENDINGS);
        // Who waits on is seen at the next plane.
        let may = due && sender.may_ask(now);
        if may {
            sender.mended = Some(now);
        }
        may
    }

    /// The senders of whom an I plane is to be asked now, since it was too early before.
    pub fn overdue(&mut self, now: Instant) -> Vec<u8> {
        let wanted = |sender: &mut Sender| sender.wanted && sender.may_ask(now);
        let all = (0u8..).zip(&mut self.senders);
        all.filter_map(|(number, sender)| sender.as_mut().is_some_and(wanted).then_some(number)).collect()
    }

    /// Senders in the room.
    pub fn senders(&self) -> usize {
        self.senders.iter().flatten().count()
    }

    fn sender(&mut self, number: u8) -> Option<&mut Sender> {
        self.senders.get_mut(usize::from(number)).and_then(Option::as_mut)
    }
}

impl Sender {
    /// Whether the last request is long enough ago; from here on one more has been made.
    fn may_ask(&mut self, now: Instant) -> bool {
        let may = self.asked.is_none_or(|asked| now.duration_since(asked) >= BETWEEN_REQUESTS);
        if may {
            (self.asked, self.wanted) = (Some(now), false);
        }
        may
    }

    fn message(&self, sender: u8) -> Message {
        let Hello { hands, record } = self.hello.clone();
        Message::Hello { sender, hands, record }
    }

    /// The planes kept, all but the last not to be shown.
    fn replay(&self, told: &mut Vec<Vec<u8>>) {
        let mut shortener = Shortener::default();
        let (mut bytes, mut together) = (Vec::new(), 0);
        for (n, plane) in self.planes.iter().enumerate() {
            if together == MAX_TOGETHER || bytes.len() + plane.payload.len() > MAX_BYTES / 2 && together > 0 {
                told.push(std::mem::take(&mut bytes));
                together = 0;
            }
            together += 1;
            shortener.write(&Plane { replay: n + 1 < self.planes.len(), ..plane.clone() }, &mut bytes);
        }
        if together > 0 {
            told.push(bytes);
        }
    }

    /// Keeps a plane for those who come late; false if it does not go on from what came before.
    fn take(&mut self, plane: &Plane) -> bool {
        self.begun = true;
        if plane.opens() {
            self.planes.clear();
            self.bytes = 0;
            self.wanted = false;
        } else if self.last != plane.index.checked_sub(1).map(|before| (plane.period, before)) {
            self.last = None;
            self.planes.clear();
            return false;
        }
        self.last = Some((plane.period, plane.index));
        self.bytes += plane.payload.len();
        let joinable = plane.opens() || !self.planes.is_empty();
        if joinable && self.planes.len() < MOST_KEPT && self.bytes <= MOST_BYTES {
            self.planes.push(plane.clone());
        } else {
            self.planes.clear();
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::Expander;

    fn plane(period: u16, index: u16) -> Plane {
        let payload = if index == 0 { vec![0, 0, 1, 0xbb, 9] } else { vec![index as u8; 12] };
        Plane {
            period,
            index,
            time_ms: u32::from(period) * 1000 + u32::from(index) * 33,
            payload,
            ..Plane::default()
        }
    }

    /// What a reader gets of deliveries, as planes.
    fn read(expander: &mut Expander, bytes: &[u8]) -> Vec<Plane> {
        let messages = expander.read_all(bytes).unwrap();
        let plane = |message| if let Message::Plane(plane) = message { Some(plane) } else { None };
        messages.into_iter().filter_map(plane).collect()
    }

    #[test]
    fn a_late_reader_gets_the_period_unseen_and_goes_on() {
        let mut room = Room::default();
        let number = room.enter().unwrap();
        for index in 0..21 {
            room.publish(number, vec![plane(3, index)]).unwrap();
        }
        let (mut following, mut expander) = (Following::default(), Expander::default());
        let (told, missing) = room.welcome(&mut following);
        assert!(missing.is_empty());
        let planes: Vec<Plane> = told.iter().flat_map(|bytes| read(&mut expander, bytes)).collect();
        assert_eq!(planes.len(), 21);
        assert!(
            planes.iter().enumerate().all(|(n, plane)| plane.replay == (n < 20) && plane.index == n as u16)
        );
        let next = room.publish(number, vec![plane(3, 21), plane(3, 22)]).unwrap();
        assert_eq!(next.len(), 1);
        assert!(next[0].is_for(&mut following, true));
        let live = read(&mut expander, &next[0].bytes);
        assert_eq!(live, [plane(3, 21), plane(3, 22)]);
        assert_eq!(next[0].bytes.len(), 3 + 12 + 1 + 12, "a short one, and one that follows it");
    }

    #[test]
    fn a_slow_reader_goes_on_with_the_next_period() {
        let mut room = Room::default();
        let number = room.enter().unwrap();
        let mut following = Following::default();
        let mut got = Vec::new();
        let mut expander = Expander::default();
        for n in 0..40 {
            let (period, index) = (n / 10, n % 10);
            for delivery in room.publish(number, vec![plane(period, index)]).unwrap() {
                if delivery.is_for(&mut following, n != 13) {
                    got.extend(read(&mut expander, &delivery.bytes).into_iter().map(|p| (p.period, p.index)));
                }
            }
        }
        let expected: Vec<(u16, u16)> =
            (0..40).filter(|n| !(13..20).contains(n)).map(|n| (n / 10, n % 10)).collect();
        assert_eq!(got, expected);
    }

    #[test]
    fn planes_for_more_than_a_message_are_several() {
        let mut room = Room::default();
        let number = room.enter().unwrap();
        let long = |index| Plane { payload: vec![index as u8; 3000], ..plane(0, index) };
        let planes: Vec<Plane> = std::iter::once(plane(0, 0)).chain((1..31).map(long)).collect();
        let deliveries = room.publish(number, planes.clone()).unwrap();
        let (mut following, mut expander) = (Following::default(), Expander::default());
        let mut got = Vec::new();
        for (n, delivery) in deliveries.iter().enumerate() {
            assert!(delivery.bytes.len() <= MAX_BYTES && delivery.opens == (n == 0));
            assert!(delivery.is_for(&mut following, true));
            got.extend(read(&mut expander, &delivery.bytes));
        }
        assert_eq!(got, planes);
    }

    #[test]
    fn who_has_gone_is_not_replayed() {
        let mut room = Room::default();
        let [first, second] = [room.enter().unwrap(), room.enter().unwrap()];
        room.publish(first, vec![plane(0, 0)]).unwrap();
        room.publish(second, vec![plane(0, 0)]).unwrap();
        let end = room.leave(first, Parting::Gone);
        assert_eq!(end, Message::End { sender: first, parting: Parting::Gone }.bytes());
        assert!(room.leave(first, Parting::Gone).is_empty());
        let (told, _) = room.welcome(&mut Following::default());
        assert_eq!(told.len(), 2, "one hello, one period");
        assert_eq!(room.senders(), 1);
        assert_eq!(room.enter().unwrap(), first, "its number is free");
    }

    #[test]
    fn gaps_and_endless_periods_are_not_joined() {
        let mut room = Room::default();
        let number = room.enter().unwrap();
        room.publish(number, vec![plane(0, 0), plane(0, 1)]).unwrap();
        assert!(room.publish(number, vec![plane(0, 3)]).unwrap().is_empty());
        assert!(room.publish(number, vec![plane(0, 4)]).unwrap().is_empty());
        assert_eq!(room.welcome(&mut Following::default()).0.len(), 1);
        assert_eq!(room.publish(number, vec![plane(1, 0)]).unwrap().len(), 1);
        for index in 1..=MOST_KEPT as u16 {
            assert_eq!(room.publish(number, vec![plane(1, index)]).unwrap().len(), 1);
        }
        assert_eq!(room.welcome(&mut Following::default()).1, [number]);
        let wrong = Plane { payload: vec![1], ..plane(2, 0) };
        assert_eq!(room.publish(number, vec![wrong]).unwrap_err(), RoomError::NoStartCode);
    }

    #[test]
    fn i_planes_are_asked_now_and_then_and_none_is_forgotten() {
        let mut room = Room::default();
        let number = room.enter().unwrap();
        let now = Instant::now();
        let later = now + BETWEEN_REQUESTS;
        assert!(room.may_ask(number, now) && room.overdue(now).is_empty());
        assert!(!room.may_ask(number, now + BETWEEN_REQUESTS / 2));
        assert!(room.overdue(now + BETWEEN_REQUESTS / 2).is_empty());
        assert_eq!(room.overdue(later), [number]);
        assert!(room.overdue(later + BETWEEN_REQUESTS).is_empty(), "asked once");
        // One that comes meanwhile is what was wanted.
        assert!(!room.may_ask(number, later));
        room.publish(number, vec![plane(0, 0)]).unwrap();
        assert!(room.overdue(later + BETWEEN_REQUESTS).is_empty());
        // A slow reader has room again right behind a request of others, whose I plane it may have missed.
        let slow = later + BETWEEN_REQUESTS / 2;
        assert!(!room.may_mend(number, slow) && room.overdue(slow + BETWEEN_REQUESTS).is_empty());
        let mended = later + BETWEEN_REQUESTS;
        assert!(room.may_mend(number, mended));
        assert!(!room.may_mend(number, mended + BETWEEN_MENDINGS - BETWEEN_REQUESTS));
        assert!(room.may_mend(number, mended + BETWEEN_MENDINGS));
    }

    #[test]
    fn a_hello_that_says_nothing_new_is_told_to_nobody() {
        let mut room = Room::default();
        let number = room.enter().unwrap();
        let hello = |right| Hello { hands: [false, right], record: vec![3] };
        // The first is news, whatever it says.
        for (said, is_told) in
            [(Hello::default(), true), (Hello::default(), false), (hello(true), true), (hello(true), false)]
        {
            let told = room.announce(number, said.clone()).unwrap();
            let Hello { hands, record } = said;
            let expected = Message::Hello { sender: number, hands, record }.bytes();
            assert_eq!(told, if is_told { expected } else { Vec::new() });
        }
        assert!(!room.announce(number, hello(false)).unwrap().is_empty());
    }

    #[test]
    fn long_periods_of_many_are_not_all_replayed() {
        let mut room = Room::default();
        for number in 0..MAX_SENDERS {
            assert_eq!(room.enter(), Ok(number));
            let long = |index| Plane { payload: vec![1; 8000], ..plane(0, index) };
            let planes = std::iter::once(plane(0, 0)).chain((1..20).map(long));
            room.publish(number, planes.collect()).unwrap();
        }
        let mut following = Following::default();
        let (told, missing) = room.welcome(&mut following);
        assert!(told.iter().map(Vec::len).sum::<usize>() < MOST_REPLAYED + 10_000);
        assert_eq!(missing, (1..MAX_SENDERS).collect::<Vec<_>>());
        let next = room.publish(1, vec![plane(0, 20)]).unwrap();
        assert!(!next[0].is_for(&mut following, true));
        let next = room.publish(1, vec![plane(1, 0)]).unwrap();
        assert!(next[0].is_for(&mut following, true));
    }

    #[test]
    fn a_room_has_a_number_of_places() {
        let mut room = Room::default();
        assert!((0..MAX_SENDERS).all(|n| room.enter() == Ok(n)));
        assert_eq!(room.enter(), Err(RoomError::Full));
    }
}
