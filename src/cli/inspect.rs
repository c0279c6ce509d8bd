//! `handcast inspect`: what an FBA stream is made of.

use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::path::PathBuf;

use anyhow::bail;
use handcast_codec::notices;
use handcast_codec::ties::hand_ties;
use handcast_fba::bap::BapMask;
use handcast_fba::bap::derive::left_to_model;
use handcast_fba::inspect::{InspectedPlane, Inspector};
use handcast_fba::{DecoderOptions, PlaneBits, SyntaxError};

use super::common::{Ranges, Steps, read_stream};

/// Lists the object planes of an FBA stream
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The stream (.fba, .mp4, or - for standard input)
    file: PathBuf,
    /// List every syntax element: bit offset, width, name, value
    #[arg(short, long)]
    verbose: bool,
    /// Print one JSON object per plane
    #[arg(long)]
    json: bool,
    /// Base quantiser steps the stream was made with
    #[arg(long, value_enum, default_value_t = Steps::Standard)]
    steps: Steps,
    /// Reading of the range codes the stream was made with; the stream does not tell
    #[arg(long, value_enum, default_value_t = Ranges::Divided)]
    ranges: Ranges,
}

/// Prints the planes of a stream; fails, after printing what could be read, if the stream is damaged.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let (bytes, _) = read_stream(&args.file)?;
    let options =
        DecoderOptions { steps: args.steps.into(), ranges: args.ranges.into(), ..DecoderOptions::default() };
    let mut inspector = Inspector::new(&bytes, options);
    let mut out = io::BufWriter::new(super::out::Stdout);
    let mut total = Total::default();
    let mut failure: Option<SyntaxError> = None;
    // That the data begin in the middle of a stream is no damage if planes follow.
    let mut joining: Option<SyntaxError> = None;
    while let Some(plane) = inspector.next() {
        match plane {
            Ok(plane) => {
                total.add(&plane, inspector.decoder().rate().per_second());
                if args.json {
                    serde_json::to_writer(&mut out, &plane.record(args.verbose, hand_ties()))?;
                    writeln!(out)?;
                } else {
                    print(&mut out, &plane, args.verbose)?;
                }
            }
            Err(error @ SyntaxError::NoObject { .. }) => joining = Some(error),
            // What ends without a plane is no stream.
            Err(_) if joining.is_some() && total.planes + total.empty == 0 => {}
            Err(error) => {
                if args.json {
                    let record = serde_json::json!({ "error": error.to_string() });
                    writeln!(out, "{record}")?;
                } else {
                    writeln!(out, "damage: {error}")?;
                }
                failure.get_or_insert(error);
            }
        }
    }
    if !args.json {
        total.print(&mut out, bytes.len())?;
    }
    out.flush()?;
    let decoder = inspector.decoder();
    let passed_over = decoder.joined().map(|bit| bit / 8);
    for notice in notices::of_stream(passed_over, decoder.objects(), decoder.trailing()) {
        errln!("handcast: {}: {notice}", args.file.display());
    }
    let failure = joining.filter(|_| total.planes + total.empty == 0).or(failure);
    match failure {
        Some(error) => bail!("{}: {error}", args.file.display()),
        None => Ok(()),
    }
}

fn print(out: &mut impl io::Write, plane: &InspectedPlane, verbose: bool) -> io::Result<()> {
    let frame = &plane.frame;
    write!(
        out,
        "{:>6} {} {:>9.3} s  bits {}-{} ({})  quant {}  mask {}",
        frame.plane,
        plane.letter(),
        frame.time,
        frame.first_bit,
        frame.end_bit,
        frame.end_bit - frame.first_bit,
        frame.quant,
        ranges(&frame.baps.mask),
    )?;
    let derived = left_to_model(hand_ties(), &frame.baps.mask);
    if !derived.is_empty() && plane.bits.masks > 0 {
        write!(out, "  left to the hand model {}", ranges(&derived))?;
    }
    if frame.object_mask != 2 {
        write!(out, "  objects {}", frame.object_mask)?;
    }
    if frame.skipped > 0 {
        write!(out, "  skipped {}", frame.skipped)?;
    }
    let names = ["I max", "I min", "P max", "P min"];
    let sent: Vec<&str> =
        names.into_iter().zip(plane.new_ranges).filter(|(_, sent)| *sent).map(|(name, _)| name).collect();
    if !sent.is_empty() {
        write!(out, "  ranges {}", sent.join(", "))?;
    }
    writeln!(out)?;
    if verbose {
        for element in &plane.elements {
            let subject = element.subject.map_or(String::new(), |number| format!("[{number}]"));
            let name = format!("{}{subject}", element.name);
            writeln!(out, "  {:>10} {:>3}  {name:<34} {}", element.bit, element.width, element.value)?;
        }
    }
    Ok(())
}

/// A mask as runs of numbers: `124, 126-130`.
fn ranges(mask: &BapMask) -> String {
    let mut text = String::new();
    let mut numbers = mask.iter().map(|bap| bap.number()).peekable();
    while let Some(first) = numbers.next() {
        // Hands use every second number; a run may have either stride.
        let stride = numbers.peek().map_or(1, |next| next - first);
        let mut last = first;
        if stride <= 2 {
            while let Some(next) = numbers.next_if(|&next| next == last + stride) {
                last = next;
            }
        }
        let separator = if text.is_empty() { "" } else { "," };
        let _ = match (last == first, stride) {
            (true, _) => write!(text, "{separator}{first}"),
            (false, 1) => write!(text, "{separator}{first}-{last}"),
            (false, _) => write!(text, "{separator}{first}-{last}/2"),
        };
    }
    if text.is_empty() { "none".to_owned() } else { text }
}

#[derive(Default)]
struct Total {
    /// Planes of an object, and the I planes among them.
    planes: u64,
    intra: u64,
    /// Planes without any object, which fill up to a byte.
    empty: u64,
    bits: PlaneBits,
    seconds: f64,
    /// Frames per second, of streams one behind the other.
    rates: Vec<f64>,
}

impl Total {
    fn add(&mut self, plane: &InspectedPlane, rate: f64) {
        self.bits += plane.bits;
        if plane.frame.object_mask == 0 {
            self.empty += 1;
        } else {
            self.planes += 1;
            self.intra += u64::from(plane.frame.kind.letter() == 'I');
            self.seconds += (1.0 + f64::from(plane.frame.skipped)) / rate;
        }
        if !self.rates.contains(&rate) {
            self.rates.push(rate);
        }
    }

    fn print(&self, out: &mut impl io::Write, bytes: usize) -> io::Result<()> {
        let seconds = self.seconds;
        let rates: Vec<String> = self.rates.iter().map(|rate| format!("{rate:.3}")).collect();
        write!(out, "{} planes ({} I), {bytes} bytes", self.planes, self.intra)?;
        if self.empty > 0 {
            write!(out, ", {} planes without an object, which fill bytes", self.empty)?;
        }
        if !rates.is_empty() {
            write!(out, ", {} frames/s", rates.join(", then "))?;
        }
        writeln!(out)?;
        if seconds > 0.0 {
            writeln!(out, "{seconds:.3} s, {:.3} kbit/s", bytes as f64 * 8.0 / seconds / 1000.0)?;
        }
        let b = &self.bits;
        writeln!(
            out,
            "bits: start codes {}, headers {}, masks {}, ranges {}, I values {}, P values {}, flush {}",
            b.start_codes, b.headers, b.masks, b.ranges, b.intra_values, b.predicted_values, b.flush
        )
    }
}
