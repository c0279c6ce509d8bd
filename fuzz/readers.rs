//! Checks of the readers of clips, motions, rigs, live messages and texts.

use std::fmt::Display;
use std::path::PathBuf;

use handcast_formats::landmarks::LandmarkClip;
use handcast_formats::motion::{Format, Motion, WriteOptions, span};
use handcast_formats::mp4::{MuxOptions, mux, stream_in, unwrapped};
use handcast_formats::person::read_person;
use handcast_gltf::{Clip, ExportOptions, HandTrack, ImportOptions, JointMap, check_rig, import, retarget};
use handcast_hand::shapes::ShapeLibrary;
use handcast_hand::{HandPose, Morphology, Side};
use handcast_limits::Limits;
use handcast_live::wire::{Expander, MAX_TOGETHER, Message, Shortener};
use handcast_media::{FrameSource, OpenOptions, open};

/// Frames that are taken of a clip.
const FRAMES: usize = 40;

/// A file that is gone when it is dropped.
struct Scratch(PathBuf);

impl Scratch {
    fn new(data: &[u8], ending: &str) -> Self {
        let thread = format!("{:?}", std::thread::current().id());
        let thread: String = thread.chars().filter(char::is_ascii_digit).collect();
        let name = format!("handcast-fuzz-{}-{thread}{ending}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, data).expect("a temporary file");
        Self(path)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// An error says something, of an input of a megabyte at most.
fn told(error: &dyn Display) {
    let message = error.to_string();
    assert!(!message.is_empty() && message.len() < 1 << 22, "{} bytes: {message:.300}", message.len());
}

/// Smaller limits than the program's, so that no input takes long.
fn limits() -> Limits {
    Limits::default()
        .with_side(2048)
        .with_pixels(1 << 18)
        .with_pictures(2000)
        .with_instants(2000)
        .with_nodes(500)
}

/// Any bytes are refused with a reason, or are a clip whose pictures have the size it says and follow one another.
pub fn clip(data: &[u8]) {
    let file = Scratch::new(data, "");
    let limits = limits();
    for max_side in [None, Some(16)] {
        let mut options = OpenOptions::default().with_ffmpeg(None).with_limits(limits.clone());
        options.max_side = max_side;
        match open(&file.0, &options) {
            Ok(source) => pictures(source, max_side, &limits),
            Err(error) => told(&error),
        }
    }
}

fn pictures(mut source: Box<dyn FrameSource>, max_side: Option<u32>, limits: &Limits) {
    let info = source.info().clone();
    let size = (u64::from(info.width), u64::from(info.height));
    assert!(size.0 > 0 && size.1 > 0 && size.0 * size.1 <= limits.pixels, "{info:?}");
    assert!(size.0.max(size.1) <= limits.side, "{info:?}");
    assert!(info.rate.is_none_or(|rate| rate.is_finite() && rate > 0.0), "{info:?}");
    let (mut last, mut number) = (0.0, 0);
    for _ in 0..FRAMES {
        match source.next_frame() {
            Ok(Some(frame)) => {
                // Damaged pictures are passed over.
                assert!(frame.index >= number, "{} before {number}", frame.index);
                number = frame.index + 1;
                assert!(frame.time.is_finite() && frame.time >= last, "{} after {last}", frame.time);
                last = frame.time;
                let (width, height) = frame.image.dimensions();
                match max_side {
                    None => assert_eq!((width, height), (info.width, info.height)),
                    Some(side) => assert!(width.max(height) <= side),
                }
            }
            end => {
                end.err().iter().for_each(|error| told(error));
                assert!(matches!(source.next_frame(), Ok(None)), "it goes on behind its end");
                return;
            }
        }
    }
}

/// Any bytes are refused with a reason, or are a motion within the limits, whose poses can be written and read again.
fn motion(name: &str, data: &[u8], limits: &Limits) {
    let motion = match Motion::parse_within(name.as_ref(), data, limits) {
        Ok(motion) => motion,
        Err(error) => return told(&error),
    };
    let clip = &motion.clip;
    let hands = clip.header.hands.len();
    assert!(clip.frames.len() as u64 <= limits.instants * hands.max(1) as u64);
    assert!(span(clip) <= limits.seconds);
    clip.check().expect("sound poses");
    if clip.frames.is_empty() {
        return;
    }
    let written = Format::by_id("jsonl").expect("a format").write(clip, &WriteOptions::default());
    let bytes = match written {
        Ok(written) => written.bytes,
        // Lines tell whole microseconds.
        Err(error) => {
            let sides =
                [Side::Left, Side::Right].map(|side| clip.of(side).map(|f| f.time).collect::<Vec<_>>());
            let close = |times: &Vec<f64>| times.windows(2).any(|pair| pair[1] - pair[0] < 2e-6);
            assert!(sides.iter().any(close), "sound poses cannot be written: {error}");
            return told(&error);
        }
    };
    let again = Motion::parse_within("-".as_ref(), &bytes, limits).expect("what is written can be read").clip;
    assert_eq!(again.frames.len(), clip.frames.len());
}

/// Tables.
pub fn table(data: &[u8]) {
    motion("x.csv", data, &limits());
}

/// BVH files.
pub fn bvh(data: &[u8]) {
    motion("x.bvh", data, &limits());
}

/// Poses as a document and in lines.
pub fn poses(data: &[u8]) {
    motion("x.jsonl", data, &limits());
    motion("x.json", data, &limits());
}

/// GLB files of this program.
pub fn glb(data: &[u8]) {
    motion("x.glb", data, &limits());
}

/// Joint positions: landmark lines, WebXR, MediaPipe's results. Few, since each is solved for.
pub fn landmarks(data: &[u8]) {
    let limits = limits().with_instants(12);
    let file = Scratch::new(data, ".json");
    match LandmarkClip::read_all_within(&file.0, &limits) {
        Ok(hands) => assert!(hands.iter().all(|hand| hand.frames.len() as u64 <= limits.instants)),
        Err(error) => told(&error),
    }
    motion("x.landmarks.jsonl", data, &limits);
}

/// Arrays of NumPy: rotations and joints of MANO.
pub fn npz(data: &[u8]) {
    motion("x.npz", data, &limits().with_instants(12));
}

/// `.pose` files.
pub fn pose_format(data: &[u8]) {
    motion("x.pose", data, &limits().with_instants(12));
}

/// Two instants of both hands.
fn two_hands() -> Clip {
    let track = |side| {
        let neutral = HandPose::neutral(side);
        let mut bent = neutral.clone();
        bent.angles.iter_mut().for_each(|angle| *angle += 0.1);
        HandTrack { morphology: Morphology::default(), poses: vec![(0.0, neutral), (0.5, bent)] }
    };
    Clip { hands: [Side::Left, Side::Right].map(track).to_vec(), ..Clip::default() }
}

/// Any bytes are refused as a rig, or are moved, and the file that comes of it can be read.
pub fn rig(data: &[u8]) {
    let limits = limits();
    let checked = check_rig(data, None, None, &limits);
    let mut options = ExportOptions::default();
    options.limits = limits.clone();
    match retarget(&two_hands(), data, None, None, &options) {
        Ok(moved) => {
            checked.expect("what can be moved is a rig");
            assert!(!moved.sides.is_empty());
            // What is read back is told by where joints lie, which a rig may leave open.
            let mut reading = ImportOptions::default();
            reading.limits = limits.clone();
            if let Err(error) = import(&moved.glb, &reading) {
                told(&error);
            }
        }
        Err(error) => {
            told(&error);
            checked.err().iter().for_each(|error| told(error));
        }
    }
}

/// Any bytes are refused with a reason, or are an MP4 file with a stream, or one beside whose tracks a stream can lie.
pub fn stream_mp4(data: &[u8]) {
    match unwrapped(data) {
        Ok(stream) => assert!(stream.len() <= data.len()),
        Err(error) => told(&error),
    }
    let stream = handcast_fba::example_stream();
    match mux(stream, &MuxOptions::default().with_clip(Some(data.to_vec()))) {
        Ok(file) => {
            assert!(file.len() <= data.len() * 2 + 4096 + stream.len(), "{} bytes", file.len());
            let found = stream_in(&file).expect("our own track is sound").expect("it is there");
            assert!(found == stream);
        }
        Err(error) => told(&error),
    }
    motion("x.mp4", data, &limits().with_instants(200));
}

/// Messages of a transport, each with its length before it: any bytes are refused with a reason or are messages that
/// can be written and read again, short ones too.
pub fn wire(data: &[u8]) {
    let (mut expander, mut shortener, mut other) =
        (Expander::default(), Shortener::default(), Expander::default());
    let mut rest = data;
    while let [length, behind @ ..] = rest {
        let (message, behind) = behind.split_at(usize::from(*length).min(behind.len()));
        rest = behind;
        let messages = match expander.read_all(message) {
            Ok(messages) => messages,
            Err(error) => {
                told(&error);
                continue;
            }
        };
        assert!(messages.len() <= MAX_TOGETHER);
        for message in messages {
            let bytes = message.bytes();
            assert_eq!(handcast_live::wire::decode_all(&bytes).as_deref(), Ok([message.clone()].as_slice()));
            if let Message::Plane(plane) = &message {
                let mut bytes = Vec::new();
                shortener.write(plane, &mut bytes);
                assert_eq!(other.read_all(&bytes).as_deref(), Ok([message].as_slice()));
            }
        }
    }
}

/// Person files, joint maps and hand shapes.
pub fn words(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    for ending in [".toml", ".json"] {
        let file = Scratch::new(data, ending);
        match read_person(&file.0) {
            Ok(person) => person.morphology.validate().expect("a reader validates"),
            Err(error) => told(&error),
        }
    }
    if let Err(error) = JointMap::parse(text) {
        told(&error);
    }
    match ShapeLibrary::parse(text) {
        Ok(shapes) => {
            for name in shapes.names() {
                let pose = shapes.get(name).expect("it is named").pose(Side::Left);
                assert!(pose.angles.iter().all(|angle| angle.is_finite()), "{name}");
            }
        }
        Err(error) => told(&error),
    }
}
