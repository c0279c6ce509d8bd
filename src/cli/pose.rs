//! `handcast pose`: a hand shape by name.

use std::path::PathBuf;

use anyhow::{Context, anyhow, bail};
use clap::Args as ClapArgs;
use handcast_formats::person::read_person;
use handcast_hand::shapes::{MAX_BYTES, ShapeError, ShapeLibrary};
use handcast_hand::{Morphology, Side};

use super::common::{Hand, read_input};
use super::poses_out::{Motion, OutArgs, write};
use super::usage::Usage;

/// Makes a picture, a glTF file or a pose file of a hand shape, e.g. "asl:A".
#[derive(Debug, ClapArgs)]
pub struct Args {
    /// Name of the shape; asl: may be left out.
    #[arg(required_unless_present = "list")]
    name: Option<String>,
    /// File to write: .png, .glb, .gltf, .jsonl, .json, .csv, .bvh, .vrma, .webxr.json, .landmarks.jsonl, .pose or .bap.
    #[arg(short, long, value_name = "FILE", required_unless_present = "list")]
    output: Option<PathBuf>,
    /// List the names instead.
    #[arg(long)]
    list: bool,
    /// Size of the picture, pixels, 16 to 4096 a side.
    #[arg(long, value_name = "WxH", default_value = "640x640", value_parser = size)]
    size: (u32, u32),
    #[command(flatten)]
    hand: HandArgs,
    #[command(flatten)]
    out: OutArgs,
}

/// Whose hand, and where its shapes come from.
#[derive(Debug, ClapArgs)]
pub struct HandArgs {
    /// Which hand.
    #[arg(long, value_enum, default_value = "right")]
    hand: Hand,
    /// A person's sizes (.toml or .json).
    #[arg(long, value_name = "FILE")]
    person: Option<PathBuf>,
    /// Other shapes than those built in (.toml).
    #[arg(long, value_name = "FILE")]
    shapes: Option<PathBuf>,
}

impl HandArgs {
    pub fn side(&self) -> Side {
        self.hand.into()
    }

    pub fn morphology(&self) -> anyhow::Result<Morphology> {
        Ok(match &self.person {
            Some(path) => read_person(path)?.morphology,
            None => Morphology::default(),
        })
    }

    pub fn library(&self) -> anyhow::Result<ShapeLibrary> {
        match &self.shapes {
            Some(path) => {
                let bytes = read_input(path, Some(MAX_BYTES as u64))?;
                let text = String::from_utf8(bytes).with_context(|| path.display().to_string())?;
                ShapeLibrary::parse(&text).with_context(|| path.display().to_string())
            }
            None => Ok(ShapeLibrary::builtin()?),
        }
    }

    /// Why there is no such shape: of those built in, whatever is in any file.
    pub fn no_shape(&self, error: ShapeError) -> anyhow::Error {
        let more = match (&error, &self.shapes) {
            (ShapeError::Unknown { .. }, None) => "; handcast pose --list tells all names".to_owned(),
            (ShapeError::Unknown { .. }, Some(path)) => {
                format!("; handcast pose --list --shapes {} tells all names", path.display())
            }
            _ => String::new(),
        };
        let told = format!("{error}{more}");
        if self.shapes.is_none() { Usage(told).into() } else { anyhow!(told) }
    }
}

/// Parses `640x480`.
pub fn size(text: &str) -> Result<(u32, u32), String> {
    let parse = |s: &str| s.parse::<u32>().ok().filter(|v| (16..=4096).contains(v));
    text.split_once('x')
        .and_then(|(w, h)| Some((parse(w)?, parse(h)?)))
        .ok_or_else(|| "allowed WxH with sides of 16 to 4096 pixels".into())
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let library = args.hand.library()?;
    if args.list {
        for name in library.names() {
            outln!("{name}");
        }
        return Ok(());
    }
    let (Some(name), Some(output)) = (&args.name, &args.output) else { bail!("a name and -o are needed") };
    let side = args.hand.side();
    let pose = library.get(name).map_err(|error| args.hand.no_shape(error))?.pose(side);
    let motion = Motion { side, morphology: args.hand.morphology()?, poses: vec![(0.0, pose)], rate: None };
    write(motion, output, &args.out, args.size)
}
