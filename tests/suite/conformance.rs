//! The streams of `fixtures/conformance`: decoded to the expected values, and encoded to the expected bytes when
//! the same choices are made.

use std::collections::BTreeMap;
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};

use handcast_fba::bap::{self, BAP_COUNT, Bap, BapMask, StepTable};
use handcast_fba::syntax::{IntraParams, PlaneHeader};
use handcast_fba::{DecodedFrame, Decoder, DecoderOptions, FrameRate, PlaneKind, PlaneWriter, TimeCode};
use serde_json::Value;

fn vectors() -> Vec<(PathBuf, Value)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/conformance");
    let manifest: Value = serde_json::from_slice(&fs::read(folder.join("manifest.json")).unwrap()).unwrap();
    manifest["vectors"].as_array().unwrap().iter().map(|vector| (folder.clone(), vector.clone())).collect()
}

fn name(vector: &Value) -> &str {
    vector["name"].as_str().unwrap()
}

fn steps(vector: &Value) -> StepTable {
    if vector["step_table"] == "vendor" { StepTable::Visage } else { StepTable::Standard }
}

fn text(folder: &Path, vector: &Value, extension: &str) -> String {
    let plain = folder.join(format!("{}.{extension}", name(vector)));
    if plain.exists() {
        return fs::read_to_string(plain).unwrap();
    }
    let packed = fs::read(format!("{}.gz", plain.display())).unwrap();
    let mut text = String::new();
    flate2::read::GzDecoder::new(&packed[..]).read_to_string(&mut text).unwrap();
    text
}

fn stream(folder: &Path, vector: &Value) -> Vec<u8> {
    fs::read(folder.join(format!("{}.fba", name(vector)))).unwrap()
}

/// One plane of a `.dec.txt` file.
#[derive(Debug, Default)]
struct Expected {
    intra: bool,
    object_mask: u8,
    tick: u64,
    skip: u64,
    quant: u8,
    bits: (u64, u64),
    values: Option<BTreeMap<u16, i32>>,
    face: Option<Vec<(usize, i32)>>,
}

fn expected(text: &str) -> Vec<Expected> {
    let mut planes: Vec<Expected> = Vec::new();
    let mut mask: Vec<u16> = Vec::new();
    for line in text.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        let field = |key: &str| words.iter().find_map(|word| word.strip_prefix(key)?.strip_prefix('='));
        let numbers = || words[1..].iter().map(|word| word.parse::<i32>().unwrap());
        match words.first() {
            Some(&"P") => {
                let (first, last) = field("bits").unwrap().split_once('-').unwrap();
                planes.push(Expected {
                    intra: words[2] == "I",
                    object_mask: field("mask").unwrap().parse().unwrap(),
                    tick: field("tick").unwrap().parse().unwrap(),
                    skip: field("skip").unwrap().parse().unwrap(),
                    quant: field("quant").unwrap().parse().unwrap(),
                    bits: (first.parse().unwrap(), last.parse().unwrap()),
                    values: None,
                    face: None,
                });
            }
            Some(&"M") => mask = numbers().map(|number| number as u16).collect(),
            Some(&"V") => {
                planes.last_mut().unwrap().values = Some(mask.iter().copied().zip(numbers()).collect());
            }
            Some(&"F") => {
                let pairs = words[1..].iter().map(|word| word.split_once(':').unwrap());
                let pairs = pairs.map(|(fap, value)| (fap.parse().unwrap(), value.parse().unwrap()));
                planes.last_mut().unwrap().face = Some(pairs.collect());
            }
            _ => {}
        }
    }
    planes
}

#[test]
fn face_parts_are_decoded_on_the_way() {
    let mut compared = 0;
    for (folder, vector) in vectors() {
        let expected = expected(&text(&folder, &vector, "dec.txt"));
        let mut decoder = Decoder::new(DecoderOptions { steps: steps(&vector), ..DecoderOptions::default() });
        decoder.push(&stream(&folder, &vector)).unwrap();
        for plane in expected.iter().filter(|plane| plane.object_mask != 0) {
            decoder.next_frame().unwrap().unwrap();
            if let Some(face) = &plane.face {
                assert_eq!(&decoder.face_values().collect::<Vec<_>>(), face, "{}", name(&vector));
                compared += 1;
            }
        }
    }
    assert!(compared > 0);
}

fn decode(bytes: &[u8], steps: StepTable, chunk: usize) -> Vec<DecodedFrame> {
    let mut decoder = Decoder::new(DecoderOptions { steps, ..DecoderOptions::default() });
    let mut frames = Vec::new();
    for piece in bytes.chunks(chunk) {
        decoder.push(piece).unwrap();
        while let Some(frame) = decoder.next_frame().unwrap() {
            frames.push(frame);
        }
    }
    decoder.finish();
    while let Some(frame) = decoder.next_frame().unwrap() {
        frames.push(frame);
    }
    frames
}

#[test]
fn decodes_to_the_expected_values() {
    for (folder, vector) in vectors() {
        let name = name(&vector);
        let frames = decode(&stream(&folder, &vector), steps(&vector), usize::MAX);
        let mut expected = expected(&text(&folder, &vector, "dec.txt"));
        expected.retain(|plane| plane.object_mask != 0);
        assert_eq!(frames.len(), expected.len(), "{name}");
        for (number, (frame, plane)) in frames.iter().zip(&expected).enumerate() {
            assert_eq!(frame.kind == PlaneKind::Intra, plane.intra, "{name} plane {number}");
            assert_eq!(frame.object_mask, plane.object_mask, "{name} plane {number}");
            assert_eq!((frame.first_bit, frame.end_bit), plane.bits, "{name} plane {number}");
            if let Some(values) = &plane.values {
                assert_eq!(frame.quant, plane.quant, "{name} plane {number}");
                let given: BTreeMap<u16, i32> =
                    frame.baps.iter().map(|(bap, value)| (bap.number(), value)).collect();
                assert_eq!(&given, values, "{name} plane {number}");
            }
            // The clock of the reference stands still after a time code; ours counts planes.
            if !name.contains("time_code") {
                let rate = rate_of(&vector).map_or(30.0, FrameRate::per_second);
                assert!((frame.time - plane.tick as f64 / rate).abs() < 1e-9, "{name} plane {number}");
                assert_eq!(u64::from(frame.skipped), plane.skip, "{name} plane {number}");
            }
        }
    }
}

#[test]
fn the_result_does_not_depend_on_how_bytes_are_cut() {
    for (folder, vector) in vectors() {
        let bytes = stream(&folder, &vector);
        let whole = decode(&bytes, steps(&vector), usize::MAX);
        for chunk in [1, 3, 1000] {
            assert_eq!(
                decode(&bytes, steps(&vector), chunk),
                whole,
                "{} in pieces of {chunk}",
                name(&vector)
            );
        }
    }
}

fn rate_of(vector: &Value) -> Option<FrameRate> {
    rate(&vector["plane_parameters"][0]["rate"])
}

fn rate(value: &Value) -> Option<FrameRate> {
    let part = |index: usize| value[index].as_u64().unwrap() as u8;
    (!value.is_null()).then(|| FrameRate { whole: part(0), sixteenths: part(1), offset: part(2) == 1 })
}

fn time_code(value: &Value) -> Option<TimeCode> {
    let part = |index: usize| value[index].as_u64().unwrap() as u8;
    (!value.is_null()).then(|| TimeCode {
        hours: part(0),
        minutes: part(1),
        marker: part(2) == 1,
        seconds: part(3),
    })
}

fn params(value: &Value) -> IntraParams {
    let mask: Vec<Bap> = value["bap_mask"]
        .as_array()
        .unwrap()
        .iter()
        .map(|number| Bap::new(number.as_u64().unwrap() as u16).unwrap())
        .collect();
    let codes = |key: &str| {
        let list = value[key].as_array()?;
        let mut codes = [0; BAP_COUNT];
        for (bap, code) in mask.iter().zip(list) {
            codes[bap.index()] = code.as_u64().unwrap() as u8;
        }
        Some(codes)
    };
    IntraParams {
        quant: value["bap_quant"].as_u64().unwrap() as u8,
        mask: mask.iter().copied().collect::<BapMask>(),
        ranges: ["i_max_codes", "i_min_codes", "p_max_codes", "p_min_codes"].map(codes),
        ..IntraParams::default()
    }
}

fn assert_same_bytes(folder: &Path, vector: &Value, ours: &[u8]) {
    assert!(ours == stream(folder, vector), "{}: other bytes", name(vector));
}

#[test]
fn encodes_to_the_same_bytes() {
    for (folder, vector) in vectors() {
        if vector["tags"].as_array().unwrap().iter().any(|tag| tag == "fap") {
            continue;
        }
        let mut choices: BTreeMap<usize, &Value> = BTreeMap::new();
        for plane in vector["plane_parameters"].as_array().unwrap() {
            choices.insert(plane["plane"].as_u64().unwrap() as usize, plane);
        }
        let mut writer = PlaneWriter::new(steps(&vector));
        let skip = |choice: Option<&&Value>| choice.and_then(|choice| choice["skip"].as_u64());
        let file = bap::text::read(&text(&folder, &vector, "bap")).unwrap();
        for (number, (_, frame)) in file.frames.iter().enumerate() {
            let choice = choices.get(&number);
            if let Some(choice) = choice.filter(|choice| choice["intra"] == 1) {
                let header = PlaneHeader {
                    kind: PlaneKind::Intra,
                    object_mask: 2,
                    rate: rate(&choice["rate"]),
                    time_code: time_code(&choice["time_code"]),
                    skipped: skip(Some(choice)).unwrap_or(0) as u32,
                    explicit_skip: skip(Some(choice)).is_some(),
                };
                let params = params(choice);
                let levels = writer.intra_levels(&params, frame).to_vec();
                writer.write_intra(&header, false, &params, &levels).unwrap();
            } else {
                let header = PlaneHeader {
                    object_mask: 2,
                    skipped: skip(choice).unwrap_or(0) as u32,
                    explicit_skip: skip(choice).is_some(),
                    ..PlaneHeader::default()
                };
                let levels = writer.predicted_levels(frame).to_vec();
                writer.write_predicted(&header, false, &levels).unwrap();
            }
        }
        assert_same_bytes(&folder, &vector, &writer.finish());
    }
}

#[test]
fn encodes_to_the_same_bytes_from_parameter_files() {
    for (folder, vector) in vectors() {
        let file = bap::text::read(&text(&folder, &vector, "bap")).unwrap();
        let epf = bap::epf::read(&text(&folder, &vector, "epf")).unwrap();
        let result = handcast_fba::encode_epf(&file, &epf, steps(&vector));
        if vector["tags"].as_array().unwrap().iter().any(|tag| tag == "fap") {
            assert!(matches!(result, Err(handcast_fba::EpfEncodeError::Unsupported { .. })));
        } else {
            assert_same_bytes(&folder, &vector, &result.unwrap());
        }
    }
}

/// Damaged streams end in errors, after whatever planes are whole.
#[test]
fn corrupt_streams_are_survived() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/conformance/corrupt");
    let mut outcomes = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let mut decoder = Decoder::new(DecoderOptions::default());
        decoder.push(&fs::read(&path).unwrap()).unwrap();
        decoder.finish();
        let (mut frames, mut errors) = (0, Vec::new());
        loop {
            match decoder.next_frame() {
                Ok(Some(_)) => frames += 1,
                Ok(None) => break,
                Err(error) => errors.push(error.to_string()),
            }
        }
        outcomes.insert(path.file_stem().unwrap().to_str().unwrap().to_owned(), (frames, errors));
    }
    for (name, frames, error) in [
        ("c01_empty", 0, "unexpected end"),
        ("c02_only_start_code", 0, "unexpected end"),
        ("c04_cut_in_ranges", 0, "unexpected end"),
        ("c06_no_end_code", 75, "unexpected end"),
        ("c07_bad_start_code", 0, "not an fba stream"),
        ("c09_marker_zero", 0, "marker bit"),
        ("c10_dct_flag", 0, "dct coding"),
        ("c12_p_plane_first", 0, "p plane without an i plane"),
    ] {
        let (found, errors) = &outcomes[name];
        assert_eq!(*found, frames, "{name}: {errors:?}");
        assert!(errors[0].contains(error), "{name}: {errors:?}");
    }
    let (frames, errors) = &outcomes["c14_garbage_after_end"];
    assert!(*frames > 0 && errors.is_empty(), "{errors:?}");
}
