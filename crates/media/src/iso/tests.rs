use super::*;
use handcast_iso::boxed;
use handcast_iso::testing::{table, words};
use std::io::Cursor;

/// The tables of a track, each of which may be another one.
struct Tables {
    stsz: Vec<u8>,
    stts: Vec<u8>,
    stsc: Vec<u8>,
    stco: Vec<u8>,
    ctts: Vec<u8>,
    more: Vec<u8>,
}

impl Default for Tables {
    /// Five pictures of ten bytes, three in the first chunk, at 25 a second; the second and third change places.
    fn default() -> Self {
        Self {
            stsz: table(b"stsz", &[10, 5]),
            stts: table(b"stts", &[2, 1, 1, 4, 1]),
            stsc: table(b"stsc", &[2, 1, 3, 1, 2, 2, 1]),
            stco: table(b"stco", &[2, 100, 200]),
            ctts: table(b"ctts", &[4, 1, 0, 1, 1, 1, u32::MAX, 2, 0]),
            more: Vec::new(),
        }
    }
}

impl Tables {
    fn track(&self) -> Vec<u8> {
        let mut entry = vec![0; 78];
        entry[24..28].copy_from_slice(&[0, 64, 0, 48]);
        entry.extend(boxed(b"avcC", &[1, 66, 0, 30, 0xff, 0xe1, 0, 2, 0x67, 66, 1, 0, 1, 0x68]));
        let stsd = boxed(b"stsd", &[words(&[0, 1]), boxed(b"avc1", &entry)].concat());
        let stbl = [&stsd, &self.stsz, &self.stts, &self.stsc, &self.stco, &self.ctts, &self.more];
        let stbl = boxed(b"stbl", &stbl.map(Vec::as_slice).concat());
        let mut tkhd = vec![0; 84];
        tkhd[15] = 1;
        tkhd[40..44].copy_from_slice(&[0, 1, 0, 0]);
        let mdia = [table(b"mdhd", &[0, 0, 25, 5]), boxed(b"minf", &stbl)].concat();
        boxed(b"trak", &[boxed(b"tkhd", &tkhd), boxed(b"mdia", &mdia)].concat())
    }

    fn file(&self) -> Vec<u8> {
        let mvex = boxed(b"mvex", &table(b"trex", &[1, 1, 1, 10, 0]));
        [boxed(b"moov", &[self.track(), mvex].concat()), boxed(b"mdat", &[0; 400])].concat()
    }

    fn read(&self) -> Found<Movie> {
        read_all(&self.file())
    }
}

fn read_all(file: &[u8]) -> Found<Movie> {
    read(&mut Cursor::new(file), file.len() as u64, &Limits::default())
}

#[test]
fn pictures_are_where_the_tables_say() {
    let movie = Tables::default().read().unwrap();
    assert_eq!((movie.width, movie.height, movie.timescale, movie.length_size), (64, 48, 25, 4));
    assert_eq!((movie.sequence_sets, movie.picture_sets), (vec![vec![0x67, 66]], vec![vec![0x68]]));
    assert_eq!((movie.matrix, movie.pixel), ([1 << 16, 0, 0, 0], None));
    let found: Vec<_> = movie.pictures.iter().map(|p| (p.offset, p.size, p.time)).collect();
    assert_eq!(found, [(100, 10, 0), (110, 10, 2), (120, 10, 1), (200, 10, 3), (210, 10, 4)]);
    let listed = Tables { stsz: table(b"stsz", &[0, 5, 1, 2, 3, 4, 5]), ..Tables::default() }.read().unwrap();
    let found: Vec<_> = listed.pictures.iter().map(|p| (p.offset, p.size)).collect();
    assert_eq!(found, [(100, 1), (101, 2), (103, 3), (200, 4), (204, 5)]);
}

#[test]
fn fragments_go_on_where_the_tables_end() {
    let run = |flags: u32, rest: &[u32]| boxed(b"trun", &words(&[&[flags], rest].concat()));
    let traf = |tfhd: Vec<u8>, rest: &[Vec<u8>]| boxed(b"traf", &[tfhd, rest.concat()].concat());
    let tfhd = |flags: u32, rest: &[u32]| boxed(b"tfhd", &words(&[&[flags], rest].concat()));
    let begun = Tables::default().file();
    let at = begun.len() as u64;
    let fragment = |from: u32| {
        let others = traf(tfhd(0, &[9]), &[run(0x201, &[2, from, 7, 8])]);
        let runs = [table(b"tfdt", &[100]), run(0, &[2]), run(0xa00, &[1, 4, 6])];
        boxed(b"moof", &[others, traf(tfhd(0x8, &[1, 3]), &runs)].concat())
    };
    let file = |from: u32| [&begun[..], &fragment(from), &boxed(b"mdat", &[0; 300])].concat();
    let movie = read_all(&file(50)).unwrap();
    let found: Vec<_> = movie.pictures[5..].iter().map(|p| (p.offset - at, p.size, p.time)).collect();
    // Behind the other track's two pictures, from byte 50 of the fragment on.
    assert_eq!(found, [(65, 10, 100), (75, 10, 103), (85, 4, 112)]);
    assert_eq!((movie.cut, movie.told), (None, None));
    // A recording that broke off within the last of these pictures.
    let file = file(160);
    let cut = read_all(&file[..begun.len() + 160 + 15 + 20 + 3]).unwrap();
    assert_eq!(cut.pictures, read_all(&file).unwrap().pictures[..7]);
    assert_eq!(cut.told, Some(8));
    assert!(cut.cut.as_deref().is_some_and(|what| what.starts_with("the box mdat at byte")), "{:?}", cut.cut);
    // Within the tables of a fragment nothing is known of it.
    let before = read_all(&file[..begun.len() + 20]).unwrap();
    assert_eq!((before.pictures.len(), before.told), (5, None));
    assert!(before.cut.is_some_and(|what| what.contains("the box moof")));
    // One that is damaged ends what is told.
    let mut damaged = file.clone();
    damaged[begun.len() + 8 + 3] = 0xff;
    let before = read_all(&damaged).unwrap();
    assert_eq!((before.pictures.len(), before.told), (5, None));
    assert!(before.cut.is_some_and(|what| what.contains("the fragment at byte")));
}

#[test]
fn tables_that_say_more_than_there_is_are_refused() {
    let five = Tables::default;
    let cases = [
        (Tables { stsz: table(b"stsz", &[1, 100_000_000]), ..five() }, "pictures, allowed at most"),
        (Tables { stsz: table(b"stsz", &[1000, 400_000]), ..five() }, "lie beyond the end"),
        (Tables { stts: table(b"stts", &[u32::MAX, 1, 1]), ..five() }, "stts says 4294967295 entries"),
        (Tables { stts: table(b"stts", &[3, 0, 1, 0, 1, 4, 1]), ..five() }, "stts is of fewer pictures"),
        (Tables { ctts: table(b"ctts", &[1, 4, 0]), ..five() }, "ctts is of fewer pictures"),
        (Tables { stco: table(b"stco", &[2, u32::MAX, 100]), ..five() }, "frame 0 of 5 lies beyond"),
        (Tables { stco: table(b"co64", &[2, u32::MAX, u32::MAX, u32::MAX, u32::MAX]), ..five() }, "beyond"),
        (Tables { stsz: words(&[0, 0x7374_737a]), ..five() }, "the inner box stsz says it has 0 bytes"),
    ];
    for (i, (tables, words)) in cases.iter().enumerate() {
        let fault = tables.read().unwrap_err();
        let excess = if let Fault::Excess(excess) = &fault { excess.to_string() } else { String::new() };
        let text = format!("{fault:?} {excess}");
        assert!(text.contains(words), "{i} should say {words:?}: {text}");
    }
}

/// Every byte made 0, 1 or 255, every size made 0 and every cut: an answer, and no panic.
#[test]
fn whatever_stands_there_there_is_an_answer() {
    let file = Tables::default().file();
    let tables = file.len() - 408;
    for at in 0..tables {
        for value in [0, 1, 127, 255] {
            let mut changed = file.clone();
            changed[at] = value;
            let _ = read_all(&changed);
        }
        for value in [0, 1, u32::MAX] {
            let mut changed = file.clone();
            changed[at..at + 4].copy_from_slice(&value.to_be_bytes());
            let _ = read_all(&changed);
        }
        let _ = read_all(&file[..at]);
    }
}

/// The file of the default tables, with an edit list, in a movie of 50 ticks a second.
fn edited(parts: &[[u32; 3]]) -> Vec<u8> {
    let rows: Vec<u32> = [parts.len() as u32].into_iter().chain(parts.iter().flatten().copied()).collect();
    let edts = boxed(b"edts", &table(b"elst", &rows));
    let track = Tables::default().track();
    let trak = boxed(b"trak", &[&track[8..], &edts].concat());
    let mvhd = table(b"mvhd", &[0, 0, 50, 10]);
    [boxed(b"moov", &[mvhd, trak].concat()), boxed(b"mdat", &[0; 400])].concat()
}

#[test]
fn an_edit_list_hides_what_is_before_and_behind_it() {
    let shown = |parts: &[[u32; 3]]| -> Vec<Option<i64>> {
        let movie = read_all(&edited(parts)).unwrap();
        movie.pictures.iter().map(|p| p.shown.then_some(p.time)).collect()
    };
    let all = [Some(0), Some(2), Some(1), Some(3), Some(4)];
    let rate = 1 << 16;
    assert_eq!(shown(&[[0, 0, rate]]), all);
    assert_eq!(shown(&[[0, 2, rate]]), [None, Some(0), None, Some(1), Some(2)]);
    // Three ticks of the movie are one and a half of the track.
    assert_eq!(shown(&[[3, 1, rate]]), [None, Some(1), Some(0), None, None]);
    // A wait before it shows nothing else.
    assert_eq!(shown(&[[50, u32::MAX, rate], [0, 2, rate]]), [None, Some(0), None, Some(1), Some(2)]);
    // What shows parts twice is read as a whole.
    assert_eq!(shown(&[[2, 3, rate], [2, 0, rate]]), all);
    let start = |parts: &[[u32; 3]]| read_all(&edited(parts)).unwrap().start;
    assert_eq!(start(&[[0, 0, rate]]), 0.0);
    assert_eq!(start(&[[50, u32::MAX, rate], [25, u32::MAX, rate], [0, 2, rate]]), 1.5);
}
