//! From a picture to planes.

use std::time::{Duration, Instant};

use handcast_hand::PoseHeader;
use handcast_live::sender::{PoseSender, newest};
use handcast_live::transport::Publish;
use handcast_live::wire::Plane;
use handcast_track::pipeline::{ClipError, ClipOptions, Tracker};

use super::avatar::Avatar;
use super::capture::Captured;
use super::record::Recording;

/// Time that pictures spent, all told.
#[derive(Clone, Copy, Debug, Default)]
pub struct Spent {
    /// Pictures worked on, and those among them in which a hand was seen.
    pub pictures: u64,
    pub seen: u64,
    /// From the camera to the tracker, in the tracker, in the encoder up to the room.
    pub waited: Duration,
    pub tracked: Duration,
    pub encoded: Duration,
}

/// Age from which on the poses that a hand begins with are passed over, and how many are: to find out which hand it is takes as
/// long as the room would then see the first of them stand still.
const STALE: Duration = Duration::from_millis(250);
const PASSED: u32 = 3;

/// How hands begin.
#[derive(Clone, Copy, Debug, Default)]
struct Beginning {
    /// Poses passed over, and whether one was not.
    passed: u32,
    over: bool,
}

impl Beginning {
    /// Whether poses of a picture of this age are passed over.
    fn passes(&mut self, age: Duration) -> bool {
        let stale = !self.over && self.passed < PASSED && age > STALE;
        self.passed += u32::from(stale);
        self.over |= !stale;
        stale
    }
}

/// What became of a stream's end.
pub struct Finished {
    pub recorded: anyhow::Result<()>,
    pub published: anyhow::Result<()>,
}

/// Tracks, encodes and publishes.
pub struct Worker {
    options: ClipOptions,
    tracker: Tracker,
    beginning: Beginning,
    sender: PoseSender,
    together: usize,
    /// Planes that wait for another.
    waiting: Vec<Plane>,
    recording: Option<Recording>,
    /// Why the recording ended before the rest.
    cut: Option<anyhow::Error>,
    avatar: Option<Avatar>,
    /// Seconds and milliseconds of the last picture.
    last: (f64, u32),
    pub spent: Spent,
    /// Why no hand is followed, or what went wrong.
    pub trouble: Option<String>,
    absence: Absence,
}

/// Seconds without a hand after which that is said.
const LONG: f64 = 5.0;

/// How long no hand has been seen, and what was said of it.
#[derive(Default)]
struct Absence {
    /// Seconds of the first picture without one.
    since: Option<f64>,
    /// Whether it was said that there is none, and why the tracker gave up.
    told: [bool; 2],
    given_up: bool,
    /// What is to be said.
    notice: Option<String>,
}

impl Absence {
    /// Takes the next picture, and why no hand is in it.
    fn go_on(&mut self, seconds: f64, seen: bool, why: Option<&str>) {
        if seen {
            *self = Self::default();
            return;
        }
        let since = *self.since.get_or_insert(seconds);
        let told = &mut self.told[usize::from(self.given_up)];
        if seconds - since >= LONG && !std::mem::replace(told, true) {
            let why = why.unwrap_or("it has left the picture, or looks like what is behind it");
            self.notice = Some(format!("no hand has been seen for {:.0} s: {why}", seconds - since));
        }
    }
}

impl Worker {
    pub fn new(
        options: ClipOptions,
        sender: PoseSender,
        together: usize,
        recording: Option<Recording>,
    ) -> Self {
        Self {
            tracker: Tracker::new(options.clone()),
            options,
            beginning: Beginning::default(),
            sender,
            together,
            waiting: Vec::new(),
            recording,
            cut: None,
            avatar: None,
            last: (0.0, 0),
            spent: Spent::default(),
            trouble: Some("spread the five fingers once".into()),
            absence: Absence::default(),
        }
    }

    /// Sends the poses to an avatar as well.
    pub fn with_avatar(self, avatar: Option<Avatar>) -> Self {
        Self { avatar, ..self }
    }

    /// Works on a picture.
    pub fn frame(&mut self, captured: Captured, publisher: &mut impl Publish) -> anyhow::Result<()> {
        let (seconds, time_ms) = (captured.frame.time, captured.time_ms);
        let begun = Instant::now();
        self.spent.pictures += 1;
        self.spent.waited += begun - captured.at;
        self.last = (seconds, time_ms);
        let poses = match self.tracker.push(captured.frame) {
            Ok(poses) => poses,
            Err(error) => {
                self.restart(&error);
                Vec::new()
            }
        };
        let tracked = Instant::now();
        let mut poses = newest(&poses);
        if !poses.is_empty() && self.beginning.passes(tracked - captured.at) {
            poses = &[];
        }
        self.spent.tracked += tracked - begun;
        let seen = poses.iter().any(|pose| pose.valid);
        if seen {
            self.spent.seen += 1;
            self.trouble = None;
        }
        self.absence.go_on(seconds, seen, self.trouble.as_deref());
        if publisher.wants_intra() {
            self.sender.request_intra();
        }
        let known = if poses.is_empty() { PoseHeader::default() } else { self.tracker.header(None) };
        match self.sender.push(seconds, time_ms, poses, &known) {
            Ok(planes) => self.publish(planes, publisher)?,
            Err(error) => self.trouble = Some(error.to_string()),
        }
        if let Some(avatar) = &mut self.avatar {
            avatar.send(seconds, poses, &known.hands);
        }
        self.spent.encoded += tracked.elapsed();
        Ok(())
    }

    /// That no hand has been seen for long, once.
    pub fn take_notice(&mut self) -> Option<String> {
        self.absence.notice.take()
    }

    /// A tracker that has given up gives way to a new one.
    fn restart(&mut self, error: &ClipError) {
        self.trouble = Some(error.to_string());
        self.absence.given_up = true;
        self.tracker = Tracker::new(self.options.clone());
        self.beginning = Beginning::default();
    }

    fn publish(&mut self, planes: Vec<Plane>, publisher: &mut impl Publish) -> anyhow::Result<()> {
        self.record(&planes);
        if let Some(hello) = self.sender.take_hello() {
            // What waits is of the stream before.
            self.send(1, publisher)?;
            publisher.hello(&hello)?;
        }
        // Where the hand rests nothing follows soon.
        let least = if planes.is_empty() { 1 } else { self.together };
        self.waiting.extend(planes);
        self.send(least, publisher)
    }

    /// Publishes what waits, as long as it is so many planes.
    fn send(&mut self, least: usize, publisher: &mut impl Publish) -> anyhow::Result<()> {
        while self.waiting.len() >= least {
            let many = self.together.min(self.waiting.len());
            publisher.planes(&self.waiting.drain(..many).collect::<Vec<_>>())?;
        }
        Ok(())
    }

    fn record(&mut self, planes: &[Plane]) {
        if self.cut.is_none()
            && let Some(recording) = &mut self.recording
            && let Err(error) = recording.add(planes)
        {
            // Those who watch go on; what is recorded ends here.
            errln!("handcast: {error:#}; the recording is cut here, the room goes on");
            self.cut = Some(error);
            // What waits in a pipe goes on being written, and is waited for at the end.
            let begun = self.recording.take_if(|recording| !recording.is_passed());
            let begun = begun.filter(Recording::is_begun);
            if let Err(error) = begun.map_or(Ok(()), Recording::finish) {
                errln!("handcast: {error:#}");
            }
        }
    }

    /// Ends the stream, tells the room so, and ends the recording, each whatever becomes of the others. The recording is the
    /// last: it may wait for who reads it.
    pub fn finish(&mut self, publisher: &mut impl Publish) -> Finished {
        let (end, ended) = match self.sender.finish(self.last.1) {
            Ok(end) => (end, Ok(())),
            Err(error) => (Vec::new(), Err(error.into())),
        };
        let published = self.publish(end, publisher);
        let published = ended.and(published).and_then(|()| self.send(1, publisher));
        let published = published.and(publisher.end().map_err(Into::into));
        let begun = |recording: &Recording| self.cut.is_none() || recording.is_begun();
        let recorded = self.recording.take().filter(begun).map_or(Ok(()), Recording::finish);
        let whole = self.cut.take().map_or(Ok(()), |error| Err(error.context("the recording is cut")));
        Finished { recorded: recorded.and(whole), published }
    }

    /// The avatar, to be told that it is over, and seconds of the last picture.
    pub fn take_avatar(&mut self) -> Option<(Avatar, f64)> {
        self.avatar.take().map(|avatar| (avatar, self.last.0))
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read as _;
    use std::path::Path;

    use handcast_hand::{HandPose, Side, TimedPose};
    use handcast_live::sender::LivePoseEncoderOptions;
    use handcast_live::transport::{Hello, TransportError};

    use super::super::passed::Pipe;
    use super::super::record::Place;
    use super::*;

    /// Notes what it is told, as far as there is a room.
    #[derive(Default)]
    struct Room {
        gone: bool,
        told: Vec<String>,
    }

    impl Room {
        fn tell(&mut self, what: &str) -> Result<(), TransportError> {
            if self.gone {
                return Err(TransportError::Closed { why: "gone".into() });
            }
            self.told.push(what.into());
            Ok(())
        }
    }

    impl Publish for Room {
        fn hello(&mut self, hello: &Hello) -> Result<(), TransportError> {
            self.tell(&format!("{:?}", hello.hands))
        }

        fn planes(&mut self, planes: &[Plane]) -> Result<(), TransportError> {
            planes.iter().try_for_each(|plane| self.tell(&format!("{}.{}", plane.period, plane.index)))
        }

        fn wants_intra(&mut self) -> bool {
            false
        }

        fn end(&mut self) -> Result<(), TransportError> {
            self.tell("end")
        }
    }

    fn worker(together: usize, recording: Option<Recording>) -> Worker {
        let sender = PoseSender::new(LivePoseEncoderOptions::default());
        Worker::new(ClipOptions::default(), sender, together, recording)
    }

    /// Goes on with the poses of these hands.
    fn go_on(worker: &mut Worker, n: u32, sides: &[Side], room: &mut Room) -> anyhow::Result<()> {
        let seconds = f64::from(n) / 30.0;
        let poses = sides.iter().map(|&side| TimedPose::new(seconds, HandPose::neutral(side)));
        let poses: Vec<TimedPose> = poses.collect();
        let planes = worker.sender.push(seconds, n * 33, &poses, &PoseHeader::default())?;
        worker.publish(planes, room)
    }

    /// A plane behind the first one.
    fn next() -> Plane {
        Plane { index: 1, ..Plane::default() }
    }

    fn recording(folder: &Path) -> Option<Recording> {
        Some(Recording::create(Place::File(folder.join("hand.fba"))).unwrap())
    }

    #[test]
    fn hands_begin_with_the_newest_of_their_poses_unless_all_are_late() {
        let [late, prompt] = [900, 40].map(Duration::from_millis);
        let mut beginning = Beginning::default();
        assert_eq!([late, late, prompt, late].map(|age| beginning.passes(age)), [true, true, false, false]);
        let mut beginning = Beginning::default();
        let passed = [late; 5].map(|age| beginning.passes(age));
        assert_eq!(passed, [true, true, true, false, false]);
    }

    #[test]
    fn that_no_hand_is_seen_is_said_once_a_spell() {
        let mut absence = Absence::default();
        let mut said = Vec::new();
        for second in 0..40 {
            absence.given_up |= second == 12;
            let why = if second < 20 { Some("spread the fingers") } else { None };
            absence.go_on(f64::from(second), second == 20, why);
            said.extend(absence.notice.take());
        }
        assert_eq!(said.len(), 3, "{said:?}");
        assert!(
            said[0] == "no hand has been seen for 5 s: spread the fingers" && said[1].contains("12 s"),
            "{said:?}"
        );
        assert!(said[2].starts_with("no hand has been seen for 5 s: it has left"), "{said:?}");
    }

    #[test]
    fn a_recording_ends_whole_where_the_room_is_gone() {
        let folder = tempfile::tempdir().unwrap();
        let mut worker = worker(1, recording(folder.path()));
        let mut room = Room::default();
        go_on(&mut worker, 0, &[Side::Right], &mut room).unwrap();
        room.gone = true;
        assert!(worker.publish(vec![next()], &mut room).is_err());
        let Finished { recorded, published } = worker.finish(&mut room);
        assert!(recorded.is_ok() && published.unwrap_err().to_string().contains("gone"));
        let stream = std::fs::read(folder.path().join("hand.fba")).unwrap();
        assert!(stream.ends_with(&[0, 0, 1, 0xb1]), "its end is in it");
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1);
    }

    /// The room is told of all planes and of the end; the pipe gets whole those that were taken before it was full.
    #[test]
    fn a_pipe_of_which_nothing_is_read_holds_no_room_up() {
        let (mut reader, writer) = std::io::pipe().unwrap();
        let pipe = Pipe { name: "a pipe".into(), into: Box::new(writer), quiet: true };
        let mut worker = worker(1, Some(Recording::create(Place::Passed(pipe)).unwrap()));
        let mut room = Room::default();
        let planes = 10_000u32;
        for n in 0..planes {
            let payload = n.to_be_bytes().repeat(64);
            worker.publish(vec![Plane { index: 1, payload, ..Plane::default() }], &mut room).unwrap();
        }
        assert!(room.told.len() == planes as usize && worker.cut.is_some());
        let read = std::thread::spawn(move || {
            let mut read = Vec::new();
            reader.read_to_end(&mut read).map(|_| read)
        });
        let Finished { recorded, published } = worker.finish(&mut room);
        let told = format!("{:#}", recorded.unwrap_err());
        assert!(told.contains("the recording is cut: the recording into a pipe: nobody reads it"), "{told}");
        assert!(published.is_ok() && room.told.last().unwrap() == "end");
        let read = read.join().unwrap().unwrap();
        let expected: Vec<u8> = (0..planes).flat_map(|n| n.to_be_bytes().repeat(64)).collect();
        let same = read.iter().zip(&expected).take_while(|(a, b)| a == b).count();
        assert!(same == read.len() && same >= 2048 * 256 && same % 256 == 0, "{same} of {}", read.len());
    }

    #[test]
    fn what_waits_goes_before_a_new_announcement() {
        let mut worker = worker(4, None);
        let mut room = Room::default();
        go_on(&mut worker, 0, &[Side::Right], &mut room).unwrap();
        worker.publish(vec![next()], &mut room).unwrap();
        assert_eq!(room.told, ["[false, true]"]);
        go_on(&mut worker, 1, &[Side::Right, Side::Left], &mut room).unwrap();
        let second = room.told.iter().position(|told| told == "[true, true]").unwrap();
        assert_eq!(room.told[1..second], ["0.0", "0.1"], "{:?}", room.told);
        assert!(worker.finish(&mut room).published.is_ok());
        assert!(room.told.len() > second + 1 && worker.waiting.is_empty());
    }
}
