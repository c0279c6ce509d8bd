//! Frame sources on files: real clips, pictures made here, and files that are wrong.

use std::fs;
use std::io::Cursor;
use std::path::Path;

use handcast_media::avi::MjpegWriter;
use handcast_media::{Frame, FrameError, FrameSource, OpenOptions, Prefetch, open};
use handcast_picture::fit_within;
use image::{Delay, Rgb, RgbImage, Rgba, RgbaImage};

fn all(mut source: impl FrameSource) -> Result<Vec<Frame>, FrameError> {
    let mut frames = Vec::new();
    while let Some(frame) = source.next_frame()? {
        assert_eq!(frame.index, frames.len());
        frames.push(frame);
    }
    Ok(frames)
}

fn picture(step: u32) -> RgbImage {
    RgbImage::from_fn(48, 32, |x, y| Rgb([(x * 5) as u8, (y * 7) as u8, (step * 60) as u8]))
}

#[test]
#[cfg(feature = "h264")]
#[ignore = "needs the shared material"]
fn real_clips_have_all_frames_and_times() {
    let clips = [
        ("finger-flexions", 300, (1280, 720), 30.0, 9.9667),
        ("counting", 493, (544, 960), 29.97, 16.42),
        ("fingerspelling", 160, (620, 1080), 25.0, 6.36),
    ];
    for (name, count, size, rate, last) in clips {
        let path = crate::common::shared(&format!("data/clips/{name}.mp4"));
        let source = open(&path, &OpenOptions::default().with_max_side(640)).unwrap();
        let info = source.info().clone();
        assert_eq!(((info.width, info.height), info.frames), (size, Some(count)));
        assert!((info.rate.unwrap() - rate).abs() < 0.5, "{:?}", info.rate);
        let frames = all(Prefetch::new(source, 4)).unwrap();
        assert_eq!(frames.len(), count);
        assert_eq!(frames[0].image.dimensions(), fit_within(size.0, size.1, Some(640)));
        assert!(frames.windows(2).all(|w| w[0].time < w[1].time));
        assert!((frames[count - 1].time - last).abs() < 0.3, "{}", frames[count - 1].time);
    }
}

#[test]
fn folders_and_patterns_come_in_natural_order() {
    let dir = tempfile::tempdir().unwrap();
    for (step, name) in ["f1.png", "f2.png", "f10.png"].iter().enumerate() {
        picture(step as u32).save(dir.path().join(name)).unwrap();
    }
    fs::write(dir.path().join("notes.txt"), "no picture").unwrap();
    let options = OpenOptions::default().with_rate(10.0);
    for input in [dir.path().to_path_buf(), dir.path().join("f*.png")] {
        let source = open(&input, &options).unwrap();
        assert_eq!(source.info().frames, Some(3));
        let frames = all(source).unwrap();
        assert_eq!(frames.len(), 3);
        for (step, frame) in frames.iter().enumerate() {
            assert_eq!(frame.image, picture(step as u32));
            assert!((frame.time - step as f64 * 0.1).abs() < 1e-12);
        }
    }
    RgbImage::new(9, 9).save(dir.path().join("f11.png")).unwrap();
    assert!(matches!(all(open(dir.path(), &options).unwrap()), Err(FrameError::OtherSize { .. })));
}

#[test]
fn animations_keep_their_delays() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("anim");
    let mut bytes = Vec::new();
    let mut encoder = image::codecs::gif::GifEncoder::new(&mut bytes);
    for (step, delay) in [40u32, 80, 40].into_iter().enumerate() {
        let buffer = RgbaImage::from_pixel(20, 10, Rgba([step as u8 * 100, 50, 0, 255]));
        let delay = Delay::from_numer_denom_ms(delay, 1);
        encoder.encode_frame(image::Frame::from_parts(buffer, 0, 0, delay)).unwrap();
    }
    drop(encoder);
    fs::write(&path, &bytes).unwrap();
    let frames = all(open(&path, &OpenOptions::default()).unwrap()).unwrap();
    let times: Vec<f64> = frames.iter().map(|f| f.time).collect();
    assert_eq!(times.len(), 3);
    assert!(times.iter().zip([0.0, 0.04, 0.12]).all(|(a, b)| (a - b).abs() < 1e-9), "{times:?}");
    for (step, frame) in frames.iter().enumerate() {
        let [r, g, b] = frame.image.get_pixel(3, 3).0.map(i32::from);
        assert!((r - step as i32 * 100).abs() < 9 && (g - 50).abs() < 9 && b < 9, "{:?}", (r, g, b));
    }
}

#[test]
fn a_still_is_one_frame_whatever_its_name() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("picture.mp4");
    picture(2).save_with_format(&path, image::ImageFormat::Png).unwrap();
    let source = open(&path, &OpenOptions::default().with_max_side(24)).unwrap();
    assert_eq!((source.info().width, source.info().frames), (48, Some(1)));
    let frames = all(source).unwrap();
    assert_eq!(frames.len(), 1);
    assert_eq!(frames[0].image.dimensions(), (24, 16));
}

fn avi(rate: (u32, u32), frames: u32) -> Vec<u8> {
    let mut writer = MjpegWriter::new(Cursor::new(Vec::new()), (48, 32), rate, 95).unwrap();
    for step in 0..frames {
        writer.write(&picture(step)).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

#[test]
fn avi_written_is_avi_read() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.avi");
    fs::write(&path, avi((30000, 1001), 4)).unwrap();
    let source = open(&path, &OpenOptions::default()).unwrap();
    assert_eq!(source.info().frames, Some(4));
    assert!((source.info().rate.unwrap() - 29.97).abs() < 0.001);
    let frames = all(source).unwrap();
    assert_eq!(frames.len(), 4);
    for (step, frame) in frames.iter().enumerate() {
        let worst = frame.image.iter().zip(picture(step as u32).iter()).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(worst.unwrap() < 40, "{worst:?}");
    }
    let whole = fs::read(&path).unwrap();
    fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    let mut source = open(&path, &OpenOptions::default()).unwrap();
    assert_eq!((source.info().frames, source.info().told), (Some(1), Some(4)));
    assert!(source.next_frame().unwrap().is_some() && source.next_frame().unwrap().is_none());
    let said = source.shortfall().unwrap();
    assert!(said.contains("is cut; of the 4 pictures that it tells of 1 are there"), "{said}");
}

#[test]
fn each_fault_has_its_own_error() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| {
        let path = dir.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    };
    let no_helper = OpenOptions::default().with_ffmpeg(None);
    let fails = |path: &Path| open(path, &no_helper).map(|_| ()).unwrap_err();
    assert!(matches!(fails(&dir.path().join("missing.mp4")), FrameError::NotFound { .. }));
    assert!(matches!(fails(&dir.path().join("none*.png")), FrameError::NotFound { .. }));
    assert!(matches!(fails(dir.path()), FrameError::Empty { .. }));
    assert!(matches!(fails(&write("empty.mp4", b"")), FrameError::Empty { .. }));
    let text = fails(&write("text.mp4", "just some t\u{e9}xt\n".as_bytes()));
    assert!(matches!(text, FrameError::NotAVideo { .. }) && text.to_string().contains("text"), "{text}");
    assert!(matches!(fails(&write("noise.mp4", &[7, 0, 200, 1, 2, 3])), FrameError::NotAVideo { .. }));
    let webm = fails(&write("a.webm", b"\x1a\x45\xdf\xa3\x01\x00\x00\x00"));
    assert!(
        matches!(webm, FrameError::UnsupportedCodec { .. }) && webm.to_string().contains("WebM"),
        "{webm}"
    );
    let missing = OpenOptions::default().with_ffmpeg(Some("no-such-program-here".into()));
    let webm = open(dir.path().join("a.webm"), &missing).map(|_| ()).unwrap_err();
    assert!(webm.to_string().contains("ffmpeg"), "{webm}");
    assert!(matches!(
        open(dir.path(), &OpenOptions::default().with_rate(0.0)).map(|_| ()),
        Err(FrameError::Option { .. })
    ));
}

#[test]
#[cfg(feature = "h264")]
#[ignore = "needs the shared material"]
fn cut_and_damaged_movies_are_read_as_far_as_they_go() {
    let whole = fs::read(crate::common::shared("data/clips/fingerspelling.mp4")).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("cut.mp4");
    for length in [6, 20, 1000, whole.len() / 2, whole.len() - 1] {
        fs::write(&path, &whole[..length]).unwrap();
        match open(&path, &OpenOptions::default().with_ffmpeg(None)) {
            Ok(source) => println!("{length}: {:?}", source.info()),
            Err(error) => assert!(
                matches!(error, FrameError::Truncated { .. } | FrameError::NotAVideo { .. }),
                "{length}: {error}"
            ),
        }
    }
    // One damaged byte anywhere: an error or a picture, never a panic that escapes.
    let mut state = 1u64;
    for _ in 0..60 {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        let mut broken = whole.clone();
        let at = (state >> 33) as usize % 4096;
        let at = if state & 1 == 0 { whole.len() - 1 - at } else { at };
        broken[at] ^= (state >> 20) as u8 | 1;
        fs::write(&path, &broken).unwrap();
        let ours = OpenOptions::default().with_max_side(64).with_ffmpeg(None);
        if let Ok(mut source) = open(&path, &ours) {
            for _ in 0..3 {
                if source.next_frame().is_err() {
                    break;
                }
            }
        }
    }
}

/// The decoder's panics are caught, but where panics abort: these would not have to be.
#[test]
#[cfg(feature = "h264")]
#[ignore = "needs the shared material"]
fn changed_bits_of_pictures_do_not_break_the_decoder_down() {
    let whole = fs::read(crate::common::shared("data/clips/fingerspelling.mp4")).unwrap();
    let after = |kind: &[u8]| whole.windows(4).position(|word| word == kind).unwrap() + 4;
    let (sets, pictures) = (after(b"avcC"), after(b"mdat"));
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("changed.mp4");
    let mut state = 11u64;
    let mut next = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) as usize
    };
    let (mut fine, mut errors) = (0, 0);
    for round in 0..400 {
        let mut changed = whole.clone();
        for _ in 0..1 + next() % 4 {
            // Parameter sets, heads of slices, and what is behind them.
            let at = match round % 4 {
                0 => sets + next() % 60,
                1 => pictures + next() % 200,
                _ => pictures + next() % 60_000,
            };
            changed[at] ^= 1 << (next() % 8);
        }
        fs::write(&path, &changed).unwrap();
        let first = |mut source: Box<dyn FrameSource>| {
            let mut indices = Vec::new();
            while let (0..5, Some(frame)) = (indices.len(), source.next_frame()?) {
                indices.push(frame.index);
            }
            Ok((indices, source.shortfall()))
        };
        match open(&path, &OpenOptions::default().with_max_side(64).with_ffmpeg(None)).and_then(first) {
            Ok((indices, None)) if indices == [0, 1, 2, 3, 4] => fine += 1,
            Ok((_, said)) => {
                assert!(!said.is_some_and(|said| said.contains("broke down")), "round {round}");
                errors += 1;
            }
            Err(error) => {
                assert!(!error.to_string().contains("broke down"), "round {round}: {error}");
                errors += 1;
            }
        }
    }
    println!("{fine} decoded, {errors} refused");
    assert!(fine > 50 && errors > 50, "{fine} {errors}");
}

/// MPEG-4 part 2, which nothing here decodes in the process.
#[test]
fn addresses_without_the_helper_program_say_so() {
    for address in ["http://localhost/clip.mp4", "HTTPS://localhost/clip.mp4"] {
        let refused =
            |options: OpenOptions| open(address, &options).err().expect("no helper program").to_string();
        let missing = refused(OpenOptions::default().with_ffmpeg(Some("no-such-program-here".into())));
        assert!(missing.contains(address) && missing.contains("install ffmpeg, or download it"), "{missing}");
        let none = refused(OpenOptions::default().with_ffmpeg(None));
        assert!(none.contains("an address of the web is not decoded here; download it first"), "{none}");
    }
}

/// A server of the web, until the test ends, that gives files as a whole alone.
fn served(file: impl Fn(&str) -> Option<Vec<u8>> + Send + 'static) -> std::net::SocketAddr {
    use std::io::{Read, Write};
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    // The helper program may ask more than once.
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = stream.unwrap();
            let mut request = [0; 4096];
            let length = stream.read(&mut request).unwrap_or(0);
            let request = String::from_utf8_lossy(&request[..length]);
            let found = request.strip_prefix("GET /").and_then(|rest| file(rest.split(' ').next()?));
            let status = if found.is_some() { "200 OK" } else { "404 Not Found" };
            let body = found.unwrap_or_default();
            let head =
                format!("HTTP/1.1 {status}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n", body.len());
            let _ = stream.write_all(head.as_bytes()).and_then(|()| stream.write_all(&body));
        }
    });
    address
}

#[test]
#[ignore = "needs ffmpeg"]
fn a_server_that_gives_whole_files_alone_is_told_where_tables_are_last() {
    let dir = tempfile::tempdir().unwrap();
    let made = |name: &str, flags: &str| {
        let path = dir.path().join(name);
        made_by_ffmpeg(&path, "testsrc=size=320x240:rate=25:duration=4", &["-movflags", flags]);
        path
    };
    let (first, last) = (made("first.mp4", "+faststart"), made("last.mp4", "0"));
    let address = served(move |name| fs::read(if name == "first.mp4" { &first } else { &last }).ok());
    let open = |name: &str| open(format!("http://{address}/{name}"), &OpenOptions::default());
    assert_eq!(all(open("first.mp4").unwrap()).unwrap().len(), 100);
    let said = open("last.mp4").err().expect("tables at the end").to_string();
    assert!(said.contains("last.mp4") && said.contains("tables") && said.contains("download"), "{said}");
}

#[test]
#[ignore = "needs ffmpeg"]
fn what_is_at_an_address_is_read_through_the_helper_program() {
    let address = served(|name| {
        let clip = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/demo.avi");
        (name == "demo.avi").then(|| fs::read(clip).unwrap())
    });
    let source = open(format!("http://{address}/demo.avi"), &OpenOptions::default()).unwrap();
    assert_eq!(source.info().format, "web through ffmpeg");
    assert_eq!(all(source).unwrap().len(), 150);
    let missing =
        open(format!("http://{address}/none.avi"), &OpenOptions::default()).err().unwrap().to_string();
    assert!(missing.contains("none.avi") && missing.contains("404"), "{missing}");
}

/// A clip that ffmpeg makes of `source` and has to decode.
fn made_by_ffmpeg(path: &Path, source: &str, more: &[&str]) -> Box<dyn FrameSource> {
    let made = std::process::Command::new("ffmpeg")
        .args(["-nostdin", "-v", "error", "-y", "-f", "lavfi", "-i", source])
        .args(more)
        .args(["-c:v", "mpeg4", "-q:v", "2"])
        .arg(path)
        .output()
        .expect("ffmpeg runs");
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let clip = open(path, &OpenOptions::default()).unwrap();
    assert!(clip.info().format.contains("ffmpeg"), "{:?}", clip.info());
    clip
}

#[test]
#[ignore = "needs ffmpeg"]
fn other_codecs_come_through_a_pipe() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("other.mp4");
    let source = made_by_ffmpeg(&path, "color=c=0xd02860:size=96x64:rate=10:duration=1.2", &[]);
    assert_eq!((source.info().width, source.info().height), (96, 64));
    let frames = all(source).unwrap();
    assert_eq!(frames.len(), 12);
    assert!(frames.iter().all(|frame| frame.image.dimensions() == (96, 64)));
    for (index, frame) in frames.iter().enumerate() {
        assert!((frame.time - index as f64 / 10.0).abs() < 1e-6, "{index}: {}", frame.time);
    }
    for pixel in frames.iter().flat_map(|frame| frame.image.pixels()) {
        let near = pixel.0.iter().zip([0xd0, 0x28, 0x60]).all(|(&c, wanted)| c.abs_diff(wanted) <= 8);
        assert!(near, "{pixel:?}");
    }
}

/// A camera that drops frames, and one that keeps no beat at all: every picture once, at its time.
#[test]
#[ignore = "needs ffmpeg"]
fn pictures_through_a_pipe_keep_uneven_times() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("uneven.mkv");
    let dropped = |n: u32| (5..=11).contains(&(n % 20));
    for (times, expected) in [
        ("N/30", (0..60).filter(|n| !dropped(*n)).map(|n| f64::from(n) / 30.0).collect::<Vec<_>>()),
        ("N/30+0.011*mod(N,3)", {
            let time = |n: u32| f64::from(n) / 30.0 + 0.011 * f64::from(n % 3);
            (0..60).filter(|n| !dropped(*n)).map(time).collect()
        }),
    ] {
        let filters = format!("settb=1/90000,setpts='({times})*90000',select='not(between(mod(n,20),5,11))'");
        let keep = ["-vf", &filters, "-vsync", "vfr", "-enc_time_base", "1:1000"];
        let source = made_by_ffmpeg(&path, "testsrc=size=96x64:rate=30:duration=2", &keep);
        let found: Vec<f64> = all(source).unwrap().iter().map(|frame| frame.time).collect();
        assert_eq!(found.len(), expected.len(), "{times}: {found:?}");
        for (found, expected) in found.iter().zip(&expected) {
            assert!((found - expected).abs() < 2e-3, "{times}: {found}, {expected}");
        }
    }
}

#[test]
fn jpegs_that_are_cut_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.jpg");
    image::RgbImage::from_fn(64, 48, |x, y| image::Rgb([(x * 4) as u8, (y * 5) as u8, (x * y) as u8]))
        .save(&path)
        .unwrap();
    let read = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        let mut source = open(&path, &OpenOptions::default())?;
        source.next_frame()
    };
    let whole = fs::read(&path).unwrap();
    assert!(read(&whole).unwrap().is_some());
    // Cameras leave things behind the picture: zeros, a film that may begin and end like one, another picture.
    let film = [&b"\0\0\0\x18ftypmp42"[..], &[0xff, 0xd9, 7, 0xff, 0xda, 7]].concat();
    for behind in [&[0; 100][..], &film, &whole, &whole[..whole.len() / 2]] {
        assert!(read(&[&whole[..], behind].concat()).unwrap().is_some());
    }
    // A picture within it has an end of its own: a preview, which programs for pictures keep.
    let preview = [&[0xff, 0xd8, 0xff, 0xe1][..], &(whole.len() as u16 + 2).to_be_bytes(), &whole].concat();
    assert!(read(&[&preview[..], &whole[2..]].concat()).unwrap().is_some());
    let error = read(&[&preview[..], &whole[2..whole.len() - 9]].concat()).unwrap_err();
    assert!(error.to_string().contains("it has no end"), "{error}");
    for share in [0.5, 0.8, 0.99] {
        let error = read(&whole[..(share * whole.len() as f64) as usize]).unwrap_err();
        assert!(error.to_string().contains("it has no end"), "{error}");
    }
}

/// A sparse file takes no room on the disk.
#[cfg(unix)]
#[test]
fn jpegs_are_read_as_far_as_they_go_and_no_more_bytes_than_allowed() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.jpg");
    picture(1).save(&path).unwrap();
    let whole = fs::metadata(&path).unwrap().len();
    let lengthen = |bytes| fs::File::options().write(true).open(&path).unwrap().set_len(bytes).unwrap();
    let read = |bytes| {
        let limits = handcast_limits::Limits::default().with_bytes(bytes);
        open(&path, &OpenOptions::default().with_limits(limits))?.next_frame()
    };
    lengthen(3 << 29);
    assert!(read(whole).unwrap().is_some());
    let told = |error: FrameError| error.to_string();
    let expected = format!("1610612736 bytes, allowed at most {}", whole - 1);
    assert!(told(read(whole - 1).unwrap_err()).ends_with(&expected));
    // The end is cut off, and zeros follow.
    lengthen(whole - 2);
    lengthen(1 << 24);
    assert!(told(read(1 << 30).unwrap_err()).contains("it has no end"));
    assert!(told(read(1 << 23).unwrap_err()).ends_with("16777216 bytes, allowed at most 8388608"));
}
