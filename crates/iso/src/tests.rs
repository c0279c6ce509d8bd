use super::testing::{table, words};
use super::*;

/// A box whose size has 64 bits.
fn wide(kind: &[u8; 4], content: &[u8]) -> Vec<u8> {
    let size = (content.len() as u64 + 16).to_be_bytes();
    [&[0, 0, 0, 1], &kind[..], &size, content].concat()
}

#[test]
fn boxes_follow_one_another() {
    let file = [boxed(b"ftyp", b"isom"), wide(b"moov", b"12"), words(&[0]), b"mdatrest".to_vec()].concat();
    let found: Vec<_> = outermost(&file).map(|found| found.unwrap()).collect();
    let told: Vec<_> = found.iter().map(|b| (&b.kind, b.at, b.content)).collect();
    let expected: [(&[u8; 4], usize, &[u8]); 3] =
        [(b"ftyp", 0, b"isom"), (b"moov", 12, b"12"), (b"mdat", 30, b"rest")];
    assert_eq!(told, expected);
    assert_eq!(found.iter().flat_map(|b| b.whole).copied().collect::<Vec<_>>(), file);
    let inner = [boxed(b"aaaa", &boxed(b"bbbb", b"x")), wide(b"aaaa", b"")].concat();
    assert_eq!(path(&inner, &[b"aaaa", b"bbbb"]), Ok(Some(b"x".as_slice())));
    assert_eq!((path(&inner, &[b"cccc"]), all(&inner, b"aaaa").count()), (Ok(None), 2));
    assert_eq!(needed(&inner, b"cccc").unwrap_err().to_string(), "there is no box cccc");
}

#[test]
fn four_bytes_of_zero_end_the_boxes_in_a_box_as_quicktime_writes_them() {
    let inner = [boxed(b"avcC", b"x"), vec![0; 4]].concat();
    assert_eq!((child(&inner, b"pasp"), child(&inner, b"avcC")), (Ok(None), Ok(Some(b"x".as_slice()))));
    for wrong in [[0, 0, 0, 1, 0].as_slice(), &[0, 0, 1], &[0, 0, 0, 8]] {
        assert!(child(&[&inner[..9], wrong].concat(), b"pasp").is_err(), "{wrong:?}");
    }
    assert!(outermost(&inner).any(|found| found.is_err()));
}

#[test]
fn boxes_that_do_not_fit_are_refused() {
    let sizes: [&[u32]; 6] = [&[2], &[7], &[9], &[1, 0, 8], &[1, 0, 99], &[1, 1 << 31, 0]];
    for size in sizes {
        let (first, more) = size.split_first().unwrap();
        let bytes = [words(&[*first]), b"abcd".to_vec(), words(more)].concat();
        let bytes = [boxed(b"good", b""), bytes].concat();
        for found in [outermost(&bytes).collect::<Vec<_>>(), children(&bytes).collect()] {
            let [Ok(_), Err(damage)] = found.as_slice() else { panic!("{size:?}: {found:?}") };
            assert!(damage.0.contains("box abcd") && damage.0.contains(" bytes; "), "{size:?}: {damage}");
        }
    }
    let empty = boxed(b"abcd", b"");
    for cut in 1..8 {
        let found: Vec<_> = children(&empty[..cut]).collect();
        assert!(matches!(found.as_slice(), [Err(damage)] if damage.0.contains("is cut")), "{cut}: {found:?}");
    }
    // Only the last one of a file may go on to its end.
    let open = [words(&[0]), b"abcd".to_vec()].concat();
    assert!(outermost(&open).all(|found| found.is_ok()) && children(&open).all(|found| found.is_err()));
    let endless = [words(&[1]), b"abcd".to_vec(), vec![0xff; 8]].concat();
    assert!(outermost(&endless).all(|found| found.is_err()) && outermost(&endless).count() == 1);
}

/// The tables of where samples lie.
#[derive(Clone, Copy)]
struct Told<'a> {
    stsz: &'a [u32],
    stsc: &'a [u32],
    stco: &'a [u32],
    co64: &'a [u32],
}

/// Five samples of ten bytes, three in the first chunk.
const TOLD: Told<'_> = Told { stsz: &[10, 5], stsc: &[2, 1, 3, 1, 2, 2, 1], stco: &[2, 100, 200], co64: &[] };

impl Told<'_> {
    fn places(&self) -> Found<Vec<(u64, u32)>> {
        let tables = [(b"stsz", self.stsz), (b"stsc", self.stsc), (b"stco", self.stco), (b"co64", self.co64)];
        let told = tables.iter().filter(|(_, rest)| !rest.is_empty());
        let stbl: Vec<u8> = told.flat_map(|(kind, rest)| table(kind, rest)).collect();
        let places = Places::of(&stbl)?;
        assert_eq!(
            (places.samples(), places.least()),
            (self.stsz[1], u64::from(self.stsz[0]) * u64::from(self.stsz[1]))
        );
        places.collect()
    }
}

#[test]
fn samples_lie_where_the_tables_say() {
    let places = |starts: [u64; 5], sizes: [u32; 5]| Ok(starts.into_iter().zip(sizes).collect::<Vec<_>>());
    assert_eq!(TOLD.places(), places([100, 110, 120, 200, 210], [10; 5]));
    let listed = Told { stsz: &[0, 5, 1, 2, 3, 4, 5], ..TOLD };
    assert_eq!(listed.places(), places([100, 101, 103, 200, 204], [1, 2, 3, 4, 5]));
    let far = Told { stco: &[], co64: &[2, 1, 0, 2, 7], ..TOLD }.places().unwrap();
    assert_eq!((far[0].0, far[3].0), (1 << 32, (2 << 32) + 7));
    // A chunk without samples, and more chunks than are needed.
    let idle = Told { stsc: &[3, 1, 3, 1, 2, 0, 1, 3, 2, 1], stco: &[4, 100, 150, 200, 250], ..TOLD };
    assert_eq!(idle.places(), TOLD.places());
    // Places do not run over.
    let end = Told { stco: &[], co64: &[2, u32::MAX, u32::MAX, 0, 0], ..TOLD }.places().unwrap();
    assert!(end[..3].iter().all(|place| place.0 == u64::MAX));
}

#[test]
fn tables_that_say_more_than_they_have_are_refused() {
    let cases = [
        (Told { stsz: &[0, 400_000, 1], ..TOLD }, "stsz says 400000 entries"),
        (Told { stsz: &[0, u32::MAX], ..TOLD }, "stsz says 4294967295 entries"),
        (Told { stsc: &[1, 2, 3, 1], ..TOLD }, "first chunk"),
        (Told { stsc: &[1, 0, 0, 1], ..TOLD }, "chunks hold fewer"),
        (Told { stsc: &[3, 1, 3, 1], ..TOLD }, "stsc says 3 entries"),
        (Told { stsc: &[], ..TOLD }, "there is no box stsc"),
        (Told { stco: &[1, 100], ..TOLD }, "chunks hold fewer"),
        (Told { stco: &[3, 100, 200], ..TOLD }, "stco says 3 entries"),
        (Told { stco: &[], co64: &[2, 0, 0, 0], ..TOLD }, "co64 says 2 entries"),
        (Told { stco: &[], ..TOLD }, "neither a box stco nor co64"),
    ];
    for (told, words) in cases {
        let damage = told.places().unwrap_err();
        assert!(damage.0.contains(words), "{words:?}: {damage}");
    }
    // Behind the damage there is nothing, however many samples are told of.
    let stbl =
        [table(b"stsz", &[1, u32::MAX]), table(b"stsc", &[1, 1, 1, 1]), table(b"stco", &[1, 0])].concat();
    let found: Vec<_> = Places::of(&stbl).unwrap().collect();
    assert!(matches!(found.as_slice(), [Ok((0, 1)), Err(_)]), "{found:?}");
}

#[test]
fn runs_give_each_sample_its_value() {
    let runs = |words_: &[u32]| words(&[&[0], words_].concat());
    let bytes = runs(&[4, 2, 7, 0, 9, 1, 8, u32::MAX, 6]);
    let mut found = Runs::of(&bytes, "stts").unwrap();
    assert_eq!(found.by_ref().take(3).collect::<Vec<_>>(), [7, 7, 8]);
    assert_eq!(found.run(), Some((u32::MAX, 6)));
    found.pass(u32::MAX - 1);
    assert_eq!((found.run(), found.next(), found.next(), found.run()), (Some((1, 6)), Some(6), None, None));
    let few = runs(&[2, 1, 7]);
    assert_eq!(Runs::of(&few, "stts").unwrap_err().0, "the table stts says 2 entries, more than it has");
    assert!(rows(&runs(&[u32::MAX]), "", 20).is_err() && rows(&[0; 7], "", 8).is_err());
}

#[test]
fn the_first_part_that_is_shown_is_found() {
    let track = |elst: Vec<u8>| boxed(b"edts", &elst);
    let of = |rows: &[[u32; 3]]| {
        let count = [rows.len() as u32];
        edit(&track(table(b"elst", &[&count[..], rows.as_flattened()].concat()))).unwrap().unwrap()
    };
    let (wait, rate) = (u32::MAX, 1 << 16);
    assert_eq!(edit(b""), Ok(None));
    assert_eq!(of(&[[3, 1, rate]]), Edit { at: 0, start: 1, duration: 3, parts: 1 });
    assert_eq!(
        of(&[[5, wait, 0], [6, wait, 0], [0, 2, rate]]),
        Edit { at: 11, start: 2, duration: 0, parts: 1 }
    );
    assert_eq!(of(&[[2, 3, rate], [2, 0, rate]]), Edit { at: 0, start: 3, duration: 2, parts: 2 });
    assert_eq!(of(&[[7, wait, rate]]), Edit { at: 7, ..Edit::default() });
    let long = boxed(b"elst", &words(&[1 << 24, 1, 1, 0, u32::MAX - 1, 7, rate]));
    assert_eq!(edit(&track(long)).unwrap(), Some(Edit { at: 1 << 32, ..Edit::default() }));
    assert!(edit(&track(table(b"elst", &[2, 0, 0, rate]))).unwrap_err().0.contains("elst says 2 entries"));
    // Three ticks of the movie are one and a half of the track.
    assert_eq!(of(&[[3, 1, rate]]).shown(25, 50), 1..3);
    assert_eq!(of(&[[0, 1, rate]]).shown(25, 50), 1..i64::MAX);
    assert_eq!(Edit { duration: u64::MAX, ..Edit::default() }.shown(u32::MAX, 0), 0..i64::MAX);
}
