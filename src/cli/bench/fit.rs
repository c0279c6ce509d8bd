//! `handcast bench fit`: how well the open-hand fit finds the sizes of made-up persons.

use std::time::Duration;

use anyhow::ensure;
use clap::builder::RangedU64ValueParser;
use handcast_eval::synth::{ScriptedMotion, Synth, SynthOptions};
use handcast_hand::anthropometry::{Bounds, check};
use handcast_hand::{Finger, Morphology, Side};
use handcast_track::View;
use handcast_track::pipeline::{Stages, StillOptions, fit_still};

/// Measures error and time of the open-hand fit on rendered hands of random persons
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Persons, at least 1
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    persons: usize,
    /// In-plane rotations of each, at least 1
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    turns: usize,
    /// Seed of persons, poses and noise
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// A line for each hand
    #[arg(short, long)]
    verbose: bool,
    /// Print the means as JSON
    #[arg(long)]
    json: bool,
}

/// What a hand's fit is off by.
#[derive(Clone, Copy, Debug, Default)]
struct Errors {
    /// Of each finger's length, as a share of it.
    lengths: [f64; 5],
    /// Of each finger's angle in the palm's plane, degrees.
    angles: [f64; 5],
    /// Of the wrist, hand lengths.
    wrist: f64,
    iou: f64,
    time: Duration,
}

/// Means over all hands. The fields are the keys of the JSON report.
#[derive(Debug, serde::Serialize)]
struct Summary {
    hands: usize,
    refused: usize,
    finger_length_error: f64,
    finger_length_error_each: [f64; 5],
    abduction_error_deg: f64,
    abduction_error_deg_each: [f64; 5],
    wrist_error: f64,
    mean_iou: f64,
    worst_iou: f64,
    mean_ms: f64,
    worst_ms: f64,
}

/// Runs the measurement.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let mut random = Random(args.seed);
    let mut found = Vec::new();
    let mut refused = 0;
    for person in 0..args.persons {
        let morphology = random.person();
        for turn in 0..args.turns {
            let mut o = SynthOptions::default();
            o.morphology = morphology.clone();
            o.side = if random.below(2) == 0 { Side::Left } else { Side::Right };
            o.view = if random.below(2) == 0 { View::Palm } else { View::Back };
            o.turn = std::f64::consts::TAU * (turn as f64 + random.uniform() - 0.5) / args.turns as f64;
            o.size = (1152, 864);
            o.noise = random.between(0.0, 6.0) as f32;
            o.seed = random.next();
            // The hand opens or closes a little: from wide open to a fifth of the way to closed.
            o.motion = ScriptedMotion::Abduction;
            o.frames = 1000;
            let frame = random.below(140);
            let name = format!("person {person}, turn {:.0}°", o.turn.to_degrees());
            match measure(o, frame as usize)? {
                Ok(errors) => {
                    if args.verbose {
                        outln!("{name}: {}", errors.line());
                    }
                    found.push(errors);
                }
                Err(reason) => {
                    outln!("{name}: refused: {reason}");
                    refused += 1;
                }
            }
        }
    }
    ensure!(!found.is_empty(), "no hand was fitted");
    let summary = Summary::of(&found, refused);
    if args.json {
        outln!("{}", serde_json::to_string_pretty(&summary)?);
    } else {
        summary.print();
    }
    Ok(())
}

fn measure(options: SynthOptions, frame: usize) -> anyhow::Result<Result<Errors, String>> {
    let synth = Synth::new(options)?;
    let o = synth.options();
    let rendered = synth.render(frame);
    let mut still = StillOptions::default();
    still.side = Some(o.side);
    still.hand_length = o.morphology.hand_length;
    still.field_of_view = o.field_of_view;
    let mut stages = Stages::default();
    let found = match fit_still(&rendered.image, &still, &mut stages) {
        Ok(found) => found,
        Err(error) => return Ok(Err(error.to_string())),
    };
    let fit = &found.fit;
    let in_plane = |f: Finger| if f == Finger::Thumb { f.base_flexion() } else { f.abduction() };
    let length = |m: &Morphology, f: Finger| m.finger(f).length();
    let scale =
        f64::from(o.size.0.max(o.size.1)) / f64::from(stages.image.width().max(stages.image.height()));
    let wrist = synth.camera().project(&rendered.pose.translation.into()).unwrap_or_default();
    let hand = o.morphology.hand_length * fit.state.scale;
    let off = [0, 1].map(|k| fit.state.wrist[k] - wrist[k] / scale);
    Ok(Ok(Errors {
        lengths: Finger::ALL.map(|f| length(&fit.morphology, f) / length(&o.morphology, f) - 1.0),
        angles: Finger::ALL.map(|f| (fit.in_plane(f) - rendered.pose.angle(in_plane(f))).to_degrees()),
        wrist: off[0].hypot(off[1]) / hand,
        iou: fit.iou,
        time: stages.timings.total(),
    }))
}

impl Errors {
    fn line(&self) -> String {
        let list = |v: [f64; 5], by: f64| v.map(|v| format!("{:6.1}", v * by)).join("");
        format!(
            "lengths{} %, angles{} deg, wrist {:.1} %, overlap {:.3}, {:.0} ms",
            list(self.lengths, 100.0),
            list(self.angles, 1.0),
            100.0 * self.wrist,
            self.iou,
            1e3 * self.time.as_secs_f64()
        )
    }
}

impl Summary {
    fn of(all: &[Errors], refused: usize) -> Self {
        let n = all.len() as f64;
        let mean = |of: &dyn Fn(&Errors) -> f64| all.iter().map(of).sum::<f64>() / n;
        let each = |of: &dyn Fn(&Errors) -> [f64; 5]| {
            std::array::from_fn::<f64, 5, _>(|i| mean(&|e: &Errors| of(e)[i].abs()))
        };
        let lengths = each(&|e| e.lengths);
        let angles = each(&|e| e.angles);
        let ms = |e: &Errors| 1e3 * e.time.as_secs_f64();
        Self {
            hands: all.len(),
            refused,
            finger_length_error: lengths.iter().sum::<f64>() / 5.0,
            finger_length_error_each: lengths,
            abduction_error_deg: angles.iter().sum::<f64>() / 5.0,
            abduction_error_deg_each: angles,
            wrist_error: mean(&|e| e.wrist),
            mean_iou: mean(&|e| e.iou),
            worst_iou: all.iter().map(|e| e.iou).fold(1.0, f64::min),
            mean_ms: mean(&ms),
            worst_ms: all.iter().map(ms).fold(0.0, f64::max),
        }
    }

    fn print(&self) {
        let list = |v: [f64; 5], by: f64| v.map(|v| format!(" {:.2}", v * by)).concat();
        outln!("{} hands fitted, {} refused", self.hands, self.refused);
        outln!(
            "  finger length  {:.2} % (thumb to little finger{})",
            100.0 * self.finger_length_error,
            list(self.finger_length_error_each, 100.0)
        );
        outln!(
            "  abduction      {:.2}° (thumb to little finger{})",
            self.abduction_error_deg,
            list(self.abduction_error_deg_each, 1.0)
        );
        outln!("  wrist          {:.2} % of the hand's length", 100.0 * self.wrist_error);
        outln!("  overlap        {:.3}, worst {:.3}", self.mean_iou, self.worst_iou);
        outln!("  time           {:.0} ms, worst {:.0} ms", self.mean_ms, self.worst_ms);
    }
}

/// A small seeded generator (SplitMix64), so that a seed means the same persons everywhere.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    fn uniform(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    fn below(&mut self, n: u64) -> u64 {
        self.next() % n
    }

    /// A factor up to `share` away from 1, either way.
    fn factor(&mut self, share: f64) -> f64 {
        self.between(1.0 - share, 1.0 + share)
    }

    /// A hand that keeps the 21 anthropometric constraints.
    fn person(&mut self) -> Morphology {
        loop {
            let mut m = Morphology::average(self.between(0.16, 0.21));
            let (broad, thick, long) = (self.factor(0.08), self.factor(0.1), self.factor(0.05));
            m.wrist_half_width *= self.factor(0.1);
            m.palm_radius *= self.factor(0.1);
            // Where fits of rendered and real hands find them.
            m.webs =
                [(0.75, 1.15), (0.36, 0.56), (0.36, 0.56), (0.36, 0.56)].map(|(a, b)| self.between(a, b));
            for (i, f) in m.fingers.iter_mut().enumerate() {
                let stretch = self.factor(0.06);
                f.bones = f.bones.map(|b| b * stretch * self.factor(0.04));
                let slim = thick * self.factor(0.05);
                f.radii = f.radii.map(|r| r * slim);
                f.base = [f.base[0] * broad, f.base[1] * long, f.base[2]];
                f.metacarpal = if i == 0 {
                    f.base
                } else {
                    [f.metacarpal[0] * broad, f.metacarpal[1] * long, f.metacarpal[2]]
                };
            }
            // The hand's length is that of palm and middle finger, whatever they have become.
            let middle = m.finger(Finger::Middle);
            m.hand_length = middle.base[0].hypot(middle.base[1]) + middle.length();
            if check(&m, Bounds::Persons).is_empty() && m.validate().is_ok() {
                return m;
            }
        }
    }
}
