//! `handcast net`: the networks that find hands.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use clap::Args as ClapArgs;
use handcast_media::OpenOptions;
use handcast_net::files::{Bundle, NetFile, Size, VARIABLE};
use handcast_net::hands::{NetFinder, NetFinderOptions};
use handcast_vision::sighting::HandFinder as _;

use super::common::Scratch;
use super::demo_clip;

/// What the variable says where no networks are wanted.
const NONE: &str = "none";

/// Where the networks are.
#[derive(Debug, ClapArgs)]
pub struct NetArgs {
    /// Wheel, .task, .tflite or folder with the networks of MediaPipe Hands, or a pattern that one such path
    /// fits. Without it $HANDCAST_NET, else where pip and npm put them.
    #[arg(long, value_name = "FILE")]
    net: Option<PathBuf>,
    /// The smaller networks, where there are two sizes.
    #[arg(long)]
    lite: bool,
}

impl NetArgs {
    fn size(&self) -> Size {
        if self.lite { Size::Lite } else { Size::Full }
    }

    /// Whether the command line says where they are.
    pub fn is_given(&self) -> bool {
        self.net.is_some()
    }

    /// Whether no networks are wanted.
    fn is_none(&self) -> bool {
        self.net.is_none() && std::env::var_os(VARIABLE).is_some_and(|value| value == NONE)
    }

    /// The networks given, or those that are there; none where there are none, or the variable says [`NONE`].
    pub fn look(&self) -> anyhow::Result<Option<Bundle>> {
        if self.is_none() {
            return Ok(None);
        }
        Ok(Bundle::look(self.given()?.as_deref(), self.size())?)
    }

    /// The path on the command line. A pattern is what it stands for, as some shells hand it over as it is.
    fn given(&self) -> anyhow::Result<Option<PathBuf>> {
        self.net.as_deref().map(expanded).transpose()
    }
}

/// A path, or the one path that fits a pattern.
fn expanded(path: &Path) -> anyhow::Result<PathBuf> {
    let pattern = path.to_string_lossy();
    if path.exists() || !pattern.contains(['*', '?', '[']) {
        return Ok(path.to_owned());
    }
    let found = glob::glob(&pattern).with_context(|| format!("--net {pattern}"))?;
    let found: Vec<PathBuf> = found.collect::<Result<_, _>>().with_context(|| format!("--net {pattern}"))?;
    match found.as_slice() {
        [one] => Ok(one.clone()),
        [] => bail!("--net {pattern}: no file fits this pattern"),
        [first, second, ..] => bail!(
            "--net {pattern}: {} files fit this pattern, one is expected: {}, {} …",
            found.len(),
            first.display(),
            second.display()
        ),
    }
}

/// Says which networks that find hands are there, and runs them on the built-in clip.
#[derive(Debug, ClapArgs)]
pub struct Args {
    #[command(flatten)]
    net: NetArgs,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// What the networks found in the built-in clip.
#[derive(Debug, Default, serde::Serialize)]
struct Seen {
    frames: usize,
    frames_with_hand: usize,
    mean_presence: f64,
    mean_right: f64,
    ms_per_frame: f64,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    if args.net.is_none() {
        bail!("{VARIABLE} is {NONE}: no networks are used; --net FILE looks at some");
    }
    let bundle = Bundle::find(args.net.given()?.as_deref(), args.net.size())?;
    if let Some(what) = &bundle.left_out {
        errln!("handcast: {what}; that network is left out, those below are whole");
    }
    let seen = demo(&bundle)?;
    if args.json {
        let file = |file: &NetFile| {
            serde_json::json!({
                "path": file.path,
                "entry": file.entry,
                "bytes": file.size,
                "sha256": file.digest(),
                "multiplications": file.multiplications,
            })
        };
        let record = serde_json::json!({
            "palms": file(&bundle.palms),
            "joints": file(&bundle.landmarks),
            "licence": bundle.licence,
            "demo": seen,
        });
        outln!("{record}");
        return Ok(());
    }
    for (name, file) in [("palms", &bundle.palms), ("joints", &bundle.landmarks)] {
        outln!("{name:8}{}", file.path.display());
        if let Some(entry) = &file.entry {
            outln!("        {entry}");
        }
        outln!("        {} bytes, SHA-256 {}", file.size, file.digest());
        outln!("        {:.0} million multiplications", file.multiplications as f64 / 1e6);
    }
    outln!("licence {}", bundle.licence.as_deref().unwrap_or("not stated beside the networks"));
    outln!(
        "demo    a hand in {} of {} frames, presence {:.2}, right hand {:.2}, {:.1} ms a frame",
        seen.frames_with_hand,
        seen.frames,
        seen.mean_presence,
        seen.mean_right,
        seen.ms_per_frame
    );
    Ok(())
}

fn demo(bundle: &Bundle) -> anyhow::Result<Seen> {
    let folder = Scratch::new("net")?;
    let path = folder.0.join("demo.avi");
    demo_clip::write(&path)?;
    let mut source = handcast_media::open(&path, &OpenOptions::default())?;
    let mut finder = NetFinder::new(bundle, NetFinderOptions::default().with_hands(1))?;
    let mut seen = Seen::default();
    let mut hands = Vec::new();
    let mut spent = Duration::ZERO;
    while let Some(frame) = source.next_frame()? {
        let start = Instant::now();
        finder.find(&frame.image, frame.time, &mut hands)?;
        spent += start.elapsed();
        seen.frames += 1;
        if let Some(hand) = hands.first() {
            seen.frames_with_hand += 1;
            seen.mean_presence += hand.presence;
            seen.mean_right += hand.right;
        }
    }
    let hands = seen.frames_with_hand.max(1) as f64;
    seen.mean_presence /= hands;
    seen.mean_right /= hands;
    seen.ms_per_frame = spent.as_secs_f64() * 1e3 / seen.frames.max(1) as f64;
    Ok(seen)
}
