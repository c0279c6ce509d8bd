//! gltfpack (npm) as a baseline: run on our GLB, read back through the decoder of three.js.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, bail, ensure};
use handcast_formats::motion::clip_from_glb;
use handcast_gltf::ExportOptions;

use super::formats::glb;
use super::{Measure, Sample};
use crate::cli::bench::baselines::zstd;
use crate::cli::common::Scratch;

/// Bits of a rotation that gltfpack allows.
const BITS: std::ops::RangeInclusive<u32> = 4..=16;

/// gltfpack and what reads it back.
pub struct Packer {
    gltfpack: PathBuf,
    node: PathBuf,
}

impl Packer {
    /// Looks for both: the file given, the packages of the folder `node`, the PATH.
    pub fn find(given: Option<&Path>, node: &Path) -> anyhow::Result<Self> {
        ensure!(node.join("unpack.js").is_file(), "no unpack.js in {} (--node)", node.display());
        let local = node.join("node_modules/.bin/gltfpack");
        let tries = match given {
            Some(path) => vec![path.to_owned()],
            None => vec![local, "gltfpack".into()],
        };
        for gltfpack in tries {
            if Command::new(&gltfpack).arg("-v").output().is_ok_and(|out| out.status.success()) {
                return Ok(Self { gltfpack, node: node.to_owned() });
            }
        }
        bail!("not found in {} nor on the PATH: npm ci --prefix {}", node.display(), node.display())
    }

    /// At the fewest bits a rotation whose error is no larger than `rms` degrees: the GLB as it is, and after zstd.
    pub fn measure(&self, sample: &Sample, rms: f64) -> anyhow::Result<[Measure; 2]> {
        let folder = Scratch::new("sizes")?;
        let source = folder.0.join("in.glb");
        std::fs::write(&source, glb(sample, &ExportOptions::default())?.0)?;
        // The error falls with the bits: the least number that will do is searched by halving.
        let (mut low, mut high) = (*BITS.start(), *BITS.end());
        let mut best = self.pack(sample, &source, high, &folder.0)?;
        while low < high {
            let middle = (low + high) / 2;
            let found = self.pack(sample, &source, middle, &folder.0)?;
            if found[0].rms_deg() <= rms {
                (high, best) = (middle, found);
            } else {
                low = middle + 1;
            }
        }
        Ok(best)
    }

    fn pack(&self, sample: &Sample, source: &Path, bits: u32, folder: &Path) -> anyhow::Result<[Measure; 2]> {
        let (packed, plain) = (folder.join("packed.glb"), folder.join("plain.glb"));
        let rate = sample.clip.header.rate.context("no rate")?;
        let mut command = Command::new(&self.gltfpack);
        // Names and the hand's side are kept, or else nobody knows which joint is which.
        command.args(["-cc", "-kn", "-ke", "-ac", "-ar", &bits.to_string(), "-af", &rate.to_string()]);
        command.arg("-i").arg(source).arg("-o").arg(&packed);
        checked(&mut command)?;
        checked(Command::new("node").arg(self.node.join("unpack.js")).arg(&packed).arg(&plain))?;
        let bytes = std::fs::read(&packed)?;
        let back = clip_from_glb(&std::fs::read(&plain)?)?;
        let as_it_is = Measure::of(sample, bytes.len(), &back, true)?;
        Ok([as_it_is, Measure { bytes: zstd(&bytes)?, ..as_it_is }])
    }
}

fn checked(command: &mut Command) -> anyhow::Result<()> {
    let name = command.get_program().to_string_lossy().into_owned();
    let out = command.output().with_context(|| name.clone())?;
    ensure!(out.status.success(), "{name}: {}", String::from_utf8_lossy(&out.stderr));
    Ok(())
}
