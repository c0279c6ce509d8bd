//! Pictures of a camera to the planes of a live stream, on the thread that brings them.

use handcast_codec::PosesToStreamError;
use handcast_fba::plan::{PlanOptions, Target};
use handcast_hand::smooth::SmoothOptions;
use handcast_hand::{PoseHeader, Side, Skeleton, TimedPose};
use handcast_live::sender::{LivePoseEncoderOptions, PoseSender};
use handcast_live::wire::{Message, Plane};
use handcast_media::Frame;
use handcast_track::View;
use handcast_track::pipeline::{ClipOptions, Start, Tracker};
use image::RgbImage;

use crate::row::write_row;

/// How pictures are tracked and poses sent.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct VideoOptions {
    /// Frames per second of the stream: those that the tracker will do.
    pub rate: f64,
    /// Root mean square error of the angles that is aimed at, degrees.
    pub rms: f64,
    /// Left or right hand, when only that one is wanted.
    pub side: Option<Side>,
    /// Palm or back, when it is known.
    pub view: Option<View>,
    /// Whether pictures are mirrored, as a selfie view is.
    pub mirror: bool,
    /// Tracking starts from any posture, with the mean hand's sizes.
    pub any_start: bool,
    /// Wrist to middle fingertip, metres.
    pub hand_length: f64,
    /// Angle that the longer side of the picture sees, degrees.
    pub field_of_view: f64,
    /// Longer side of the pictures that are looked at, pixels; larger ones are shrunk. At least 64.
    pub analysis_side: u32,
    /// Frames from which the colours of skin are learnt.
    pub learning_frames: usize,
    /// Frames that may pass before a hand opens; then colours are learnt anew.
    pub lead_in: usize,
}

impl Default for VideoOptions {
    /// Both hands at 30 frames/s and 0.5°, from a second of pictures; what waits for the first open hand is four seconds,
    /// 80 MB.
    fn default() -> Self {
        Self {
            rate: 30.0,
            rms: 0.5,
            side: None,
            view: None,
            mirror: false,
            any_start: false,
            hand_length: 0.189,
            field_of_view: 60.0,
            analysis_side: 640,
            learning_frames: 30,
            lead_in: 120,
        }
    }
}

impl VideoOptions {
    fn tracker(&self) -> Tracker {
        let mut options = ClipOptions::default();
        options.side = self.side;
        options.view = self.view;
        options.mirror = self.mirror;
        options.start = if self.any_start { Start::Any } else { Start::Open };
        options.threads = 1;
        options.hand_length = self.hand_length;
        options.field_of_view = self.field_of_view;
        options.segment.max_side = self.analysis_side.max(64);
        options.learning_frames = self.learning_frames;
        options.max_lead_in = self.lead_in;
        // What is sent live cannot wait for fingers to bend.
        options.tuning.contest.undecided = 0;
        options.learn_again = false;
        options.smooth = Some(SmoothOptions::live());
        Tracker::new(options)
    }
}

/// What a picture gave.
#[derive(Clone, Debug, Default)]
pub struct Sent {
    /// Planes that are ready: mostly one, none before a hand has been found.
    pub planes: Vec<Plane>,
    /// The same as messages of a room (`spec/live.md`), with a hello before them where the hands have changed.
    pub messages: Vec<Vec<u8>>,
    /// Times of the poses, seconds since the first picture. Those of the pictures that waited for the first open hand
    /// come with its picture, and of these no planes are made.
    pub times: Vec<f64>,
    /// Rows of the poses.
    pub rows: Vec<f32>,
    /// Why nothing was found in the pictures so far: looking begins anew.
    pub trouble: Option<String>,
}

/// Tracks hands in pictures and makes planes of their poses.
pub struct VideoSender {
    options: VideoOptions,
    tracker: Tracker,
    sender: PoseSender,
    frames: usize,
    /// Milliseconds of the first picture, and of the last.
    times: Option<[f64; 2]>,
    /// Milliseconds of the first picture that the tracker got.
    begun: f64,
}

impl VideoSender {
    /// One that has seen nothing.
    pub fn new(options: VideoOptions) -> Self {
        let usual = LivePoseEncoderOptions::default();
        let plan = PlanOptions { mode: Target::Rms(options.rms), ..usual.plan };
        let sender = PoseSender::new(usual.with_rate(options.rate).with_plan(plan));
        Self { options, tracker: options.tracker(), sender, frames: 0, times: None, begun: 0.0 }
    }

    /// Takes a picture, `width` × `height` pixels of four bytes (red, green, blue, any), captured at `capture` (milliseconds
    /// of the room's clock, later than the picture before).
    ///
    /// # Errors
    /// Text for people: a picture of another size than it has bytes, a time that goes back, a stream that cannot be made.
    /// That no hand is found is none ([`Sent::trouble`]).
    pub fn push(&mut self, rgba: &[u8], width: u32, height: u32, capture: f64) -> Result<Sent, String> {
        let image = picture(rgba, width, height)?;
        let [first, last] = self.times.unwrap_or([capture, f64::NEG_INFINITY]);
        if !(capture.is_finite() && capture > last) {
            return Err(format!("a picture captured at {capture} ms after one at {last} ms"));
        }
        self.times = Some([first, capture]);
        if self.frames == 0 {
            self.begun = capture;
        }
        let frame = Frame { index: self.frames, time: (capture - self.begun) / 1000.0, image };
        self.frames += 1;
        let mut sent = Sent::default();
        let poses = self.tracker.push(frame).unwrap_or_else(|error| {
            sent.trouble = Some(error.to_string());
            self.tracker = self.options.tracker();
            self.frames = 0;
            Vec::new()
        });
        self.send(&poses, capture, &mut sent).map_err(|error| error.to_string())?;
        Ok(sent)
    }

    fn send(&mut self, poses: &[TimedPose], capture: f64, sent: &mut Sent) -> Result<(), PosesToStreamError> {
        let first = self.times.map_or(capture, |[first, _]| first);
        // Without poses nothing is known, but that hands which were sent are lost.
        let header = if poses.is_empty() { PoseHeader::default() } else { self.tracker.header(None) };
        let skeletons = [Side::Left, Side::Right].map(|side| {
            let told = header.hand(side).and_then(|hand| hand.morphology.as_ref());
            told.map(|sizes| Skeleton::new(sizes, side))
        });
        for timed in poses {
            if let Some(skeleton) = &skeletons[timed.pose.side as usize] {
                sent.times.push(timed.time + (self.begun - first) / 1000.0);
                write_row(timed, skeleton, &mut sent.rows);
            }
        }
        let time_ms = room_time(capture);
        // Of pictures that waited only the newest is sent.
        let planes = self.sender.push((capture - first) / 1000.0, time_ms, poses, &header)?;
        if let Some(hello) = self.sender.take_hello() {
            let hello = Message::Hello { sender: 0, hands: hello.hands, record: hello.record };
            sent.messages.push(hello.bytes());
        }
        sent.messages.extend(planes.iter().map(|plane| Message::Plane(plane.clone()).bytes()));
        sent.planes = planes;
        Ok(())
    }

    /// Makes the next plane open a period.
    pub fn request_intra(&mut self) {
        self.sender.request_intra();
    }

    /// Ends the stream: its last planes.
    ///
    /// # Errors
    /// Text for people, where the stream cannot be ended.
    pub fn finish(&mut self) -> Result<Sent, String> {
        let capture = self.times.map_or(0.0, |[_, last]| last);
        let planes = self.sender.finish(room_time(capture)).map_err(|error| error.to_string())?;
        let messages = planes.iter().map(|plane| Message::Plane(plane.clone()).bytes()).collect();
        Ok(Sent { planes, messages, ..Sent::default() })
    }

    /// The hands found so far, with their sizes.
    pub fn header(&self) -> PoseHeader {
        self.tracker.header(Some(self.options.rate))
    }
}

/// Milliseconds modulo 2^32.
fn room_time(capture: f64) -> u32 {
    capture.rem_euclid(4_294_967_296.0) as u32
}

fn picture(rgba: &[u8], width: u32, height: u32) -> Result<RgbImage, String> {
    let (wanted, given) = (u128::from(width) * u128::from(height) * 4, rgba.len());
    if wanted == 0 {
        return Err(format!("a picture of {width} × {height} pixels is none"));
    }
    if wanted != given as u128 {
        return Err(format!("a picture of {width} × {height} pixels has {given} bytes, must have {wanted}"));
    }
    let rgb = rgba.as_chunks::<4>().0.iter().flat_map(|&[r, g, b, _]| [r, g, b]).collect();
    RgbImage::from_raw(width, height, rgb).ok_or_else(|| "a picture beyond memory".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_pictures_are_refused() {
        let mut sender = VideoSender::new(VideoOptions::default());
        let grey = vec![90; 96 * 64 * 4];
        assert!(sender.push(&grey, 96, 64, 1000.0).unwrap().planes.is_empty());
        for (width, height, capture, words) in [
            (96, 63, 1040.0, "96 × 63 pixels has 24576 bytes"),
            (u32::MAX, u32::MAX, 1040.0, "must have"),
            (0, 0, 1040.0, "0 × 0 pixels is none"),
            (96, 64, 1000.0, "captured at 1000 ms after one at 1000 ms"),
            (96, 64, f64::NAN, "captured at NaN"),
        ] {
            let error = sender.push(&grey, width, height, capture).unwrap_err();
            assert!(error.contains(words), "{error}");
        }
        assert!(sender.push(&grey, 96, 64, 1040.0).is_ok());
        assert!(sender.finish().unwrap().planes.is_empty());
    }

    /// Without a hand looking begins anew, however long it takes.
    #[test]
    fn nothing_to_see_is_told() {
        let options = VideoOptions { learning_frames: 5, lead_in: 20, ..VideoOptions::default() };
        let mut sender = VideoSender::new(options);
        let grey = vec![90; 96 * 64 * 4];
        let troubles: Vec<String> = (0..60)
            .filter_map(|n| sender.push(&grey, 96, 64, f64::from(n) * 33.0).unwrap().trouble)
            .collect();
        assert!(troubles.len() >= 2 && !troubles[0].is_empty(), "{troubles:?}");
    }

    /// A picture of another size ends the tracker, not what is told of the hands.
    #[test]
    fn hands_are_told_lost_where_the_camera_turns() {
        let clip = concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/demo.avi");
        let mut source = handcast_media::open(clip, &handcast_media::OpenOptions::default()).unwrap();
        let options = VideoOptions { learning_frames: 30, lead_in: 120, ..VideoOptions::default() };
        let mut sender = VideoSender::new(options);
        let (mut planes, mut size, mut capture) = (Vec::new(), (0, 0), 1000.0);
        for _ in 0..60 {
            let image = source.next_frame().unwrap().unwrap().image;
            size = image.dimensions();
            let rgba: Vec<u8> = image.pixels().flat_map(|p| [p.0[0], p.0[1], p.0[2], 255]).collect();
            planes.extend(sender.push(&rgba, size.0, size.1, capture).unwrap().planes);
            capture += 40.0;
        }
        assert_eq!(planes.last().unwrap().lost, [false; 2]);
        let turned = vec![90; (size.0 * size.1 * 4) as usize];
        let sent = sender.push(&turned, size.1, size.0, capture).unwrap();
        assert!(sent.trouble.is_some());
        assert!(sent.planes.iter().any(|plane| plane.lost != [false; 2]), "{:?}", sent.planes);
    }

    #[test]
    fn times_of_the_room_wrap() {
        assert_eq!(room_time(4_294_967_296.0 * 3.0 + 7.5), 7);
    }
}
