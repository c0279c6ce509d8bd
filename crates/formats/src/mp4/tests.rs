use super::*;
use handcast_codec::encode_poses;
use handcast_codec::mapping::Profile;
use handcast_fba::plan::PlanOptions;
use handcast_hand::{HandPose, JointAngle, PoseClip, PoseHeader, Side, TimedPose};
use handcast_iso::{all, needed, path, u32_at, u64_at};
use proptest::prelude::*;

fn stream(resync: bool, wrapper: Option<u8>) -> Vec<u8> {
    let pose = |n: usize| {
        let bend = 30.0 - 30.0 * (n as f64 * 0.1).cos();
        let pose = HandPose::neutral(Side::Right).with_degrees(JointAngle::Index2Flexion, bend);
        TimedPose::new(n as f64 / 25.0, pose)
    };
    let header = PoseHeader::one(Side::Right, None, Some(25.0));
    let clip = PoseClip { header, frames: (0..100).map(pose).collect() };
    let plan = PlanOptions { resync, wrapper, intra_seconds: 1.0, ..PlanOptions::default() };
    encode_poses(&clip, Profile::Hand, &plan).unwrap().stream
}

/// A clip of two samples in two chunks, its media before its movie, the last box to the end of the file where `open`; where
/// `wide` its pictures begin 1.5 s late.
fn clip(wide: bool, open: bool) -> Vec<u8> {
    let mut file = Out::default();
    file.of(b"ftyp", |out| out.bytes(b"isom\0\0\0\0"));
    let media = |out: &mut Out| out.bytes(b"firstsecond");
    let moov = |out: &mut Out, at: u32| {
        out.of(b"moov", |out| {
            boxes::mvhd(out, 600, 1200, 8);
            out.of(b"trak", |out| {
                boxes::tkhd(out, 7, 1200);
                if wide {
                    out.of(b"edts", |out| {
                        let edits = [2, 900, u32::MAX, 1 << 16, 300, 0, 1 << 16];
                        out.full(b"elst", 0, |out| edits.into_iter().for_each(|v| out.u32(v)));
                    });
                }
                out.of(b"mdia", |out| {
                    boxes::hdlr(out, b"vide", "");
                    out.of(b"minf", |out| {
                        out.of(b"stbl", |out| {
                            let kind = if wide { b"co64" } else { b"stco" };
                            out.full(kind, 0, |out| {
                                out.u32(2);
                                for place in [at, at + 5] {
                                    if wide { out.u64(place.into()) } else { out.u32(place) }
                                }
                            });
                        });
                    });
                });
            });
            out.of(b"udta", |out| out.bytes(b"kept"));
        });
    };
    if open {
        let mut length = Out::default();
        moov(&mut length, 0);
        let at = file.len() + length.len() + 8;
        moov(&mut file, at as u32);
        file.u32(0);
        file.bytes(b"mdat");
        media(&mut file);
    } else {
        let at = file.len() as u32 + 8;
        file.of(b"mdat", media);
        moov(&mut file, at);
    }
    file.into_bytes()
}

#[test]
fn streams_come_back_to_the_byte() {
    for resync in [true, false] {
        for wrapper in [None, Some(0x63)] {
            let stream = stream(resync, wrapper);
            for start in [0.0, 1.5] {
                let file = mux(&stream, &MuxOptions::default().with_start(start)).unwrap();
                assert_eq!(stream_in(&file).unwrap().unwrap(), stream);
                assert_eq!(unwrapped(&file).unwrap(), stream);
                assert!((starts_at(&file) - start).abs() < 1e-3, "{start}: {}", starts_at(&file));
                let motion = crate::motion::Motion::parse("x.mp4".as_ref(), &file).unwrap();
                assert!((motion.clip.frames[0].time - start).abs() < 1e-3);
            }
            let cut = samples(&stream, DecoderOptions::default()).unwrap();
            // Frames that were left out make those before them longer.
            let ticks: u32 = cut.list.iter().map(|sample| sample.1 / 16_000).sum();
            assert!(cut.list.iter().all(|sample| sample.1 % 16_000 == 0) && cut.timescale == 400_000);
            assert!(ticks == 100 && cut.list.len() > 50, "{ticks}");
            assert!(stream[..cut.header].ends_with(&[0, 0, 1, 0xba]));
            // A start code begins each sync sample but the first.
            let mut at = cut.header;
            for (number, (length, _, sync)) in cut.list.iter().enumerate() {
                if *sync && number > 0 && resync {
                    assert_eq!(stream[at..at + 4], [0, 0, 1, 0xbb]);
                }
                at += *length as usize;
            }
            let sync = cut.list.iter().filter(|sample| sample.2).count();
            assert!(if resync { sync >= 4 } else { sync == 1 }, "{sync}");
        }
    }
}

#[test]
fn the_tracks_of_a_clip_come_along_untouched() {
    let stream = stream(true, Some(0x63));
    for (wide, open) in [(false, false), (true, false), (false, true), (true, true)] {
        let clip = clip(wide, open);
        let file = mux(&stream, &MuxOptions::default().with_clip(Some(clip))).unwrap();
        assert_eq!(stream_in(&file).unwrap().unwrap(), stream);
        let outer = handcast_iso::outermost(&file).map(Result::unwrap);
        let moov = outer.filter_map(|found| found.of(b"moov")).next().unwrap();
        assert_eq!(needed(moov, b"udta").unwrap(), b"kept");
        let tracks: Vec<_> = all(moov, b"trak").map(Result::unwrap).collect();
        assert_eq!(tracks.len(), 2);
        let kind = if wide { b"co64" } else { b"stco" };
        let table = path(tracks[0], &[b"mdia", b"minf", b"stbl", kind]).unwrap().unwrap();
        for (chunk, expected) in [&b"first"[..], b"second"].into_iter().enumerate() {
            let at = match wide {
                true => u64_at(table, 8 + chunk * 8).unwrap() as usize,
                false => u32_at(table, 8 + chunk * 4).unwrap() as usize,
            };
            assert_eq!(&file[at..at + expected.len()], expected);
        }
        // Ticks of the clip's movie; 4 s are longer than its 2.
        let mvhd = needed(moov, b"mvhd").unwrap();
        let late = if wide { 900 } else { 0 };
        assert_eq!(u32_at(mvhd, 16), Some(2400 + late));
        assert!((starts_at(&file) - f64::from(late) / 600.0).abs() < 1e-9, "{}", starts_at(&file));
        assert!(mvhd.ends_with(&9u32.to_be_bytes()));
    }
}

/// Rows of a table.
type Rows<'a> = &'a [[i32; 2]];

/// A file of 600 ticks a second with a track of pictures of 1000 that lasts 1200 of the movie's: its edits (duration, where it
/// begins), and the runs of the steps and shifts of its samples.
fn timed(edits: Rows<'_>, steps: Rows<'_>, shifts: Rows<'_>) -> Vec<u8> {
    let rows = |out: &mut Out, kind: &[u8; 4], rows: Rows<'_>, more: &[i32]| {
        out.full(kind, 0, |out| {
            out.u32(rows.len() as u32);
            rows.iter().for_each(|row| row.iter().chain(more).for_each(|v| out.u32(v.cast_unsigned())));
        });
    };
    let mut file = Out::default();
    file.of(b"ftyp", |out| out.bytes(b"isom\0\0\0\0"));
    file.of(b"moov", |out| {
        boxes::mvhd(out, 600, 1200, 8);
        out.of(b"trak", |out| {
            boxes::tkhd(out, 7, 1200);
            if !edits.is_empty() {
                out.of(b"edts", |out| rows(out, b"elst", edits, &[1 << 16]));
            }
            out.of(b"mdia", |out| {
                boxes::mdhd(out, 1000, 2000);
                boxes::hdlr(out, b"vide", "");
                out.of(b"minf", |out| {
                    out.of(b"stbl", |out| {
                        rows(out, b"stts", steps, &[]);
                        if !shifts.is_empty() {
                            rows(out, b"ctts", shifts, &[]);
                        }
                    });
                });
            });
        });
    });
    file.into_bytes()
}

#[test]
fn pictures_start_where_the_first_one_is_shown() {
    let even = [[50, 40]];
    // Of pictures that are decoded before those shown ahead of them; the second is shown first.
    let shifts = [[1, 120], [1, 40], [48, 80]];
    let cases: [(Rows<'_>, Rows<'_>, f64); 11] = [
        (&[], &[], 0.0),
        (&[], &shifts, 0.08),
        (&[[1200, 0]], &shifts, 0.08),
        (&[[1200, 80]], &shifts, 0.0),
        (&[[0, 80]], &shifts, 0.0),
        (&[[300, -1], [1200, 80]], &shifts, 0.5),
        (&[[300, -1], [300, -1], [1200, 0]], &shifts, 1.08),
        (&[[300, -1]], &shifts, 0.58),
        // Between two pictures.
        (&[[600, 1001]], &[], 0.039),
        // Later, or too short for any.
        (&[[600, 4000]], &[], 0.0),
        (&[[600, -1], [12, 1001]], &[], 1.0),
    ];
    for (edits, shifts, expected) in cases {
        let found = pictures_start_at(&timed(edits, &even, shifts));
        assert!((found - expected).abs() < 1e-9, "{edits:?} {shifts:?}: {found}, {expected}");
    }
    let end = |edits: Rows<'_>| pictures_end_at(&timed(edits, &even, &shifts)).unwrap();
    assert!((end(&[]) - 2.08).abs() < 1e-9 && (end(&[[1200, 80]]) - 2.0).abs() < 1e-9);
    // Neither memory nor time is that of what tables say.
    assert_eq!(pictures_start_at(&timed(&[[1, i32::MAX]], &[[-1, 1]; 1000], &[[-1, -1]; 1000])), 0.0);
}

/// Times in ticks that do not fit into 32 bits.
#[test]
fn a_stream_begins_long_after_its_clip() {
    for clip in [None, Some(clip(false, false))] {
        let stream = stream(true, Some(1));
        let file = mux(&stream, &MuxOptions { start: 7.2e6, clip, ..MuxOptions::default() }).unwrap();
        assert!((starts_at(&file) - 7.2e6).abs() < 1e-3, "{}", starts_at(&file));
        assert_eq!(stream_in(&file).unwrap().as_deref(), Some(&*stream));
        let moov = path(&file, &[b"moov"]).unwrap().unwrap();
        let mvhd = needed(moov, b"mvhd").unwrap();
        let (scale, duration) = (u32_at(mvhd, 20).unwrap(), u64_at(mvhd, 24).unwrap());
        assert_eq!(mvhd[0], 1);
        assert!((duration as f64 / f64::from(scale) - 7.2e6 - 4.0).abs() < 0.1);
        let track = all(moov, b"trak").last().unwrap().unwrap();
        assert_eq!(needed(track, b"tkhd").unwrap()[..4], [1, 0, 0, 7]);
    }
}

#[test]
fn what_is_no_stream_or_clip_is_refused() {
    let refused = |clip: &[u8]| {
        let options = MuxOptions::default().with_clip(Some(clip.to_vec()));
        mux(&stream(true, None), &options).unwrap_err().to_string()
    };
    assert!(refused(b"words").contains("no MP4 file"));
    let sound = clip(false, false);
    assert!(refused(&sound[..sound.len() - 9]).contains("bytes; "));
    let mut fragments = sound.clone();
    fragments[20..24].copy_from_slice(b"moof");
    assert!(refused(&fragments).contains("fragments"));
    assert!(matches!(mux(b"", &MuxOptions::default()), Err(Mp4Error::Stream(_) | Mp4Error::Empty)));
    assert!(unwrapped(&sound).unwrap_err().to_string().contains("no track"));
    assert_eq!(stream_in(b"no file").unwrap(), None);
}

proptest! {
    #[test]
    fn damaged_files_end_in_a_stream_or_an_error(
        at in any::<prop::sample::Index>(),
        byte in any::<u8>(),
        length in any::<prop::sample::Index>(),
        beside: bool,
    ) {
        let options = MuxOptions::default().with_clip(beside.then(|| clip(false, true)));
        let mut file = mux(handcast_fba::example_stream(), &options).unwrap();
        let at = at.index(file.len());
        file[at] = byte;
        file.truncate(1 + length.index(file.len()));
        let _ = stream_in(&file);
        let _ = mux(handcast_fba::example_stream(), &MuxOptions::default().with_clip(Some(file)));
    }
}
