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

/// Tracks, encodes and publishes.
pub struct Worker {
    options: ClipOptions,
    tracker: Tracker,
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
            sender,
            together,
            waiting: Vec::new(),
            recording,
            cut: None,
            avatar: None,
            last: (0.0, 0),
            spent: Spent::default(),
            trouble: Some("spread the five fingers once".into()),
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
        let poses = newest(&poses);
        let tracked = Instant::now();
        self.spent.tracked += tracked - begun;
        if poses.iter().any(|pose| pose.valid) {
            self.spent.seen += 1;
            self.trouble = None;
        }
        if publisher.wants_intra() {
            self.sender.request_intra();
        }
        let known = if poses.is_empty() { PoseHeader::default() } else { self.tracker.header(None) };
        match self.sender.push(seconds, time_ms, poses, &known) {
            Ok(planes) => self.publish(planes, publisher)?,
            Err(error) => self.trouble = Some(error.to_string()),
        }
        if let Some(avatar) = &mut self.avatar
            && let Err(error) = avatar.send(seconds, poses, &known.hands)
        {
            // The room goes on without the avatar.
            self.trouble = Some(error.to_string());
        }
        self.spent.encoded += tracked.elapsed();
        Ok(())
    }

    /// A tracker that has given up gives way to a new one.
    fn restart(&mut self, error: &ClipError) {
        self.trouble = Some(error.to_string());
        self.tracker = Tracker::new(self.options.clone());
    }

    fn publish(&mut self, planes: Vec<Plane>, publisher: &mut impl Publish) -> anyhow::Result<()> {
        if let Some(hello) = self.sender.take_hello() {
            publisher.hello(&hello)?;
        }
        if let Some(recording) = &mut self.recording
            && let Err(error) = recording.add(&planes)
        {
            // Those who watch go on; what is recorded ends here.
            errln!("handcast: {error:#}; the recording ends here, the room goes on");
            self.cut = Some(error);
            let begun = self.recording.take().filter(Recording::is_begun);
            if let Err(error) = begun.map_or(Ok(()), Recording::finish) {
                errln!("handcast: {error:#}");
            }
        }
        // Where the hand rests nothing follows soon.
        let rests = planes.is_empty();
        self.waiting.extend(planes);
        while self.waiting.len() >= self.together || rests && !self.waiting.is_empty() {
            let many = self.together.min(self.waiting.len());
            publisher.planes(&self.waiting.drain(..many).collect::<Vec<_>>())?;
        }
        Ok(())
    }

    /// Ends the stream, and the recording.
    pub fn finish(&mut self, publisher: &mut impl Publish) -> anyhow::Result<()> {
        let end = self.sender.finish(self.last.1)?;
        self.publish(end.into_iter().collect(), publisher)?;
        self.publish(Vec::new(), publisher)?;
        self.recording.take().map_or(Ok(()), Recording::finish)?;
        self.cut.take().map_or(Ok(()), |error| Err(error.context("the recording is not whole")))
    }

    /// The avatar, to be told that it is over, and seconds of the last picture.
    pub fn take_avatar(&mut self) -> Option<(Avatar, f64)> {
        self.avatar.take().map(|avatar| (avatar, self.last.0))
    }
}
