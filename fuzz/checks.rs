//! What the fuzz targets check, one function each. The stored corpus runs through the same functions as
//! ordinary tests (`tests/suite/fuzz_corpus.rs`).

#![allow(dead_code)]

#[path = "readers.rs"]
pub mod readers;

use handcast_codec::packets::{Arrival, Packer, Unpacker};
use handcast_codec::{PoseDecoder, PoseDecoderOptions};
use handcast_fba::bap::{Bap, BapFrame, StepTable, epf, text};
use handcast_fba::inspect::Inspector;
use handcast_fba::{
    DecodedFrame, Decoder, DecoderLimits, DecoderOptions, Encoder, EncoderConfig, SyntaxError, encode_epf,
};
use handcast_hand::TimedPose;
use handcast_net::files::{Bundle, Size};
use handcast_net::{Network, model};

type Outcome = Vec<Result<DecodedFrame, SyntaxError>>;

fn run(data: &[u8], options: DecoderOptions, cuts: impl Iterator<Item = usize>) -> Outcome {
    let mut decoder = Decoder::new(options);
    let mut outcome = Vec::new();
    let mut drain = |decoder: &mut Decoder| {
        loop {
            match decoder.next_frame() {
                Ok(Some(frame)) => outcome.push(Ok(frame)),
                Ok(None) => break,
                Err(error) => outcome.push(Err(error)),
            }
        }
    };
    let mut rest = data;
    for cut in cuts {
        if rest.is_empty() {
            break;
        }
        let (piece, behind) = rest.split_at(cut.clamp(1, rest.len()));
        rest = behind;
        decoder.push(piece).expect("far below the limit");
        drain(&mut decoder);
    }
    decoder.push(rest).expect("far below the limit");
    drain(&mut decoder);
    decoder.finish();
    drain(&mut decoder);
    assert!(decoder.is_ended());
    outcome
}

/// Any bytes end in frames and errors, with both step tables, concealed or not, inspected or not.
pub fn decode(data: &[u8]) {
    for steps in [StepTable::Standard, StepTable::Visage] {
        for conceal in [false, true] {
            let options = DecoderOptions { steps, conceal, ..DecoderOptions::default() };
            let outcome = run(data, options, std::iter::empty());
            // A plane has at least three bits, an error moves on by at least a byte.
            assert!(outcome.len() <= data.len() * 4 + 1);
        }
    }
    let inspected = Inspector::new(data, DecoderOptions::default()).count();
    assert!(inspected <= data.len() * 4 + 1);
}

/// The poses of any bytes, and how often something was wrong with them.
fn poses(data: &[u8], options: DecoderOptions, size: usize) -> (Vec<TimedPose>, usize) {
    let mut decoder = PoseDecoder::new(PoseDecoderOptions::default().with_decoder(options));
    let (mut poses, mut errors) = (Vec::new(), 0);
    for piece in data.chunks(size).chain([&[][..]]) {
        let mut found = decoder.push(piece);
        while found.is_err() {
            errors += 1;
            found = decoder.push(&[]);
        }
        poses.extend(found.into_iter().flatten());
    }
    // What the end brings to light comes one by one.
    while !decoder.is_ended() {
        match decoder.finish() {
            Ok(found) => poses.extend(found),
            Err(_) => errors += 1,
        }
    }
    poses.extend(decoder.push(&[]).into_iter().flatten());
    (poses, errors)
}

/// How the bytes are cut makes no difference.
pub fn chunking(data: &[u8]) {
    let (sizes, data) = data.split_at(data.len().min(8));
    let whole = run(data, DecoderOptions::default(), std::iter::empty());
    let cut =
        run(data, DecoderOptions::default(), sizes.iter().cycle().map(|&size| usize::from(size) % 17 + 1));
    assert_eq!(whole, cut);
    assert_eq!(whole, run(data, DecoderOptions::default(), std::iter::repeat(1)));
    for conceal in [false, true] {
        // A plane of a few bits may skip half an hour.
        let limits = DecoderLimits { skipped_frames: 20, ..DecoderLimits::default() };
        let options = DecoderOptions { conceal, limits, ..DecoderOptions::default() };
        assert_eq!(poses(data, options, usize::MAX), poses(data, options, 1));
    }
}

/// Pieces of data, each with its length before it.
fn pieces(mut data: &[u8]) -> impl Iterator<Item = &[u8]> {
    std::iter::from_fn(move || {
        let (&length, behind) = data.split_first()?;
        let (piece, behind) = behind.split_at(behind.len().min(length.into()));
        data = behind;
        Some(piece)
    })
}

/// Any packets bring no more bytes than they have, which a decoder takes with its gaps; those of a sender bring its
/// stream in order, whatever is lost, doubled or late, and all of it where nothing is.
pub fn packets(data: &[u8]) {
    let [patience, group, distance, rest @ ..] = data else { return };
    let mut unpacker = Unpacker::new(*patience);
    let limits = DecoderLimits { skipped_frames: 20, ..DecoderLimits::default() };
    let options = DecoderOptions { conceal: true, limits, ..DecoderOptions::default() };
    let mut decoder = PoseDecoder::new(PoseDecoderOptions::default().with_decoder(options));
    let mut bytes = 0;
    for arrival in pieces(rest).flat_map(|packet| unpacker.take(packet)) {
        let mut found = match arrival {
            Arrival::Gap => decoder.lose(),
            Arrival::Bytes(more) => {
                bytes += more.len();
                decoder.push(&more)
            }
        };
        while found.is_err() {
            found = decoder.push(&[]);
        }
    }
    assert!(bytes <= rest.len());
    sent(rest, Packer::new(&[*distance]).with_parity(*group), Unpacker::new(*patience));
}

/// What a sender packs of the pieces arrives in order; the low bits of each piece's first byte say what becomes of its
/// packet on the way.
fn sent(data: &[u8], mut packer: Packer, mut unpacker: Unpacker) {
    let (mut stream, mut arrived, mut late) = (Vec::<u8>::new(), Vec::new(), None);
    let mut sound = true;
    for piece in pieces(data) {
        // Offsets of 16 bits tell no more than that.
        if stream.len() + piece.len() > usize::from(u16::MAX / 2) {
            break;
        }
        stream.extend(piece);
        let packet = packer.pack(piece);
        let fate = piece.first().map_or(7, |byte| byte % 8);
        sound &= fate > 2;
        match fate {
            0 => {}
            1 => arrived.extend([&packet, &packet].into_iter().flat_map(|packet| unpacker.take(packet))),
            2 => late = Some(packet),
            _ => {
                arrived.extend(unpacker.take(&packet));
                arrived.extend(late.take().into_iter().flat_map(|packet| unpacker.take(&packet)));
            }
        }
    }
    if sound {
        assert!(!unpacker.is_waiting() && arrived.iter().all(|arrival| *arrival != Arrival::Gap));
    }
    let runs = arrived.split(|arrival| *arrival == Arrival::Gap).map(|run| {
        let bytes =
            run.iter().map(|arrival| if let Arrival::Bytes(bytes) = arrival { &bytes[..] } else { &[] });
        bytes.collect::<Vec<_>>().concat()
    });
    let mut behind = &stream[..];
    for run in runs.filter(|run| !run.is_empty()) {
        let at = behind.windows(run.len()).position(|window| window == run).expect("bytes of the stream");
        behind = &behind[at + run.len()..];
        assert!(!sound || (at == 0 && behind.is_empty()));
    }
}

/// What is encoded is decoded to what the encoder says.
pub fn round_trip(data: &[u8]) {
    let [quant, interval, flags, count, rest @ ..] = data else { return };
    let config = EncoderConfig {
        quant: quant % 32,
        intra_interval: u32::from(interval % 16),
        resync: flags & 1 != 0,
        wrapper: (flags & 4 != 0).then_some(0x63),
        ..EncoderConfig::default()
    };
    let mut encoder = Encoder::new(config).expect("valid configuration");
    let mut expected = Vec::new();
    let size = usize::from(count % 24) + 1;
    for words in rest.chunks_exact(size * 4) {
        let frame: BapFrame = words
            .chunks_exact(4)
            .filter_map(|word| {
                let bap = Bap::new(u16::from_le_bytes([word[0], word[1]]) % 300)?;
                Some((bap, i32::from(i16::from_le_bytes([word[2], word[3]]))))
            })
            .collect();
        let planes = encoder.planes();
        if encoder.write_frame(&frame).is_ok() && encoder.planes() > planes {
            expected.push(encoder.reconstruction());
        }
    }
    let planes = encoder.planes();
    let stream = encoder.finish();
    let outcome = run(&stream, DecoderOptions::default(), std::iter::empty());
    let decoded: Vec<BapFrame> =
        outcome.into_iter().map(|frame| frame.expect("our own stream is sound").baps).collect();
    // Frames left out at the end are stood for by one plane more.
    assert!(decoded.len() as u64 - planes <= 1);
    assert_eq!(decoded[..expected.len()], expected);
}

/// Any text is refused or read, and what is read can be written and read again.
pub fn bap_text(data: &[u8]) {
    let Ok(input) = std::str::from_utf8(data) else { return };
    if let Ok(file) = text::read(input) {
        let again = text::read(&text::write(&file)).expect("our own text is sound");
        assert_eq!(again.frames, file.frames);
        assert_eq!(again.rate, file.rate);
    }
}

/// Any text is refused or read; what is read can be tried on a clip.
pub fn epf_text(data: &[u8]) {
    let Ok(input) = std::str::from_utf8(data) else { return };
    if let Ok(frames) = epf::read(input) {
        let clip = text::read("3.1 x 25 2\n1 1 1\n0 64 128 -64\n1 1 1\n1 0 0 0\n").expect("sound");
        if let Ok(stream) = encode_epf(&clip, &frames, StepTable::Standard) {
            decode(&stream);
        }
    }
}

/// Any bytes are refused with a reason, or are a network that runs, the second time as the first.
pub fn network(data: &[u8]) {
    let limits = model::NetworkLimits::default()
        .with_elements(1 << 12)
        .with_total_elements(1 << 14)
        .with_multiplications(1 << 20);
    match Network::read_within(data, &limits) {
        Ok(mut network) => {
            let mut run = || {
                network.run().expect("its memory was planned");
                let outputs = (0..network.outputs().len()).filter_map(|i| network.output(i)).flatten();
                outputs.map(|x| x.to_bits()).collect::<Vec<_>>()
            };
            assert_eq!(run(), run());
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
    // As an archive they are none of hands: those are larger.
    let error = Bundle::read(data, Size::Full).expect_err("too small");
    assert!(!error.to_string().is_empty());
}
