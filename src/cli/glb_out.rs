//! Arguments about glTF files that several subcommands share, and the files.

use std::path::{Path, PathBuf};

use anyhow::Context;
use handcast_formats::motion::{Rig, WriteOptions, write_glb};
use handcast_gltf::{CheckedRig, ExportOptions, JointMap, JointNames, NodeAxes, check_rig};
use handcast_hand::{Morphology, PoseClip, Side, skin_tone};

use super::common::{limits, read_input};
use super::poses_out::written;
use super::usage::within;

/// Largest rig that is read, bytes.
const MAX_RIG: u64 = 1 << 29;
/// Largest joint map that is read, bytes.
const MAX_MAP: u64 = 1 << 20;
/// How the argument that says the axes is known; `import` has other axes.
pub const AXES: &str = "glb_axes";
/// Metres of the wrist's translation that count as much as a radian of a joint where keys are dropped.
pub const METRES_PER_RADIAN: f64 = 0.1;

/// Names of joints.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum Names {
    /// index-finger-phalanx-proximal
    Webxr,
    /// Index_Proximal_L, with Palm_L
    Openxr,
    /// leftIndexProximal
    Vrm,
    /// mixamorig:LeftHandIndex1
    Mixamo,
    /// l_metacarpophalangeal_2
    Hanim,
    /// l_index1
    Mpeg4,
}

impl From<Names> for JointNames {
    fn from(names: Names) -> Self {
        match names {
            Names::Webxr => Self::WebXr,
            Names::Openxr => Self::OpenXr,
            Names::Vrm => Self::Vrm,
            Names::Mixamo => Self::Mixamo,
            Names::Hanim => Self::HAnim,
            Names::Mpeg4 => Self::Mpeg4,
        }
    }
}

/// Axes of joints.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum Axes {
    /// +Y along the bone, as Blender's importer takes it
    Bones,
    /// −Z along the bone, +Y out of the back of the hand
    Webxr,
}

/// How a .glb is written.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "glTF")]
pub struct GlbArgs {
    /// Names of the joints (.glb, .bvh): names alone, axes and rest pose stay. Avatars take a .vrma, rigs come with --mesh
    #[arg(long, value_enum, default_value_t = Names::Webxr)]
    pub names: Names,
    /// Axes of the joints (.glb)
    #[arg(id = AXES, long = "glb-axes", alias = "axes", value_enum, value_name = "AXES", default_value_t = Axes::Bones)]
    pub axes: Axes,
    /// Drop keys of the animation that interpolation reproduces within this many degrees, 0 to 90, each joint against the one
    /// above it (.glb, .vrma)
    #[arg(long, value_name = "DEG", default_value_t = 0.0, value_parser = tolerance)]
    pub tolerance: f64,
    /// Joints and animation only, no mesh (.glb)
    #[arg(long, conflicts_with = "mesh")]
    pub anim_only: bool,
    /// Shorts and bytes in place of floats: KHR_mesh_quantization (.glb)
    #[arg(long)]
    pub quantize: bool,
    /// Tone of the skin, 1 (lightest) to 10 (.glb, and pictures where they are written) [default: that of the clip where one
    /// is tracked, else 3]
    #[arg(long, value_name = "1-10", conflicts_with = "mesh", value_parser = tone)]
    pub tone: Option<u8>,
    /// Your own rigged hand (.glb or .gltf) to move in place of the built-in one (.glb)
    #[arg(long, value_name = "FILE")]
    pub mesh: Option<PathBuf>,
    /// Which joint of --mesh is which, where its names, or an avatar's human bones, do not tell (.toml)
    #[arg(long, value_name = "FILE", requires = "mesh")]
    pub map: Option<PathBuf>,
}

/// Reads a map of joints.
pub fn read_map(path: &Path) -> anyhow::Result<JointMap> {
    let bytes = read_input(path, Some(MAX_MAP))?;
    let text = String::from_utf8(bytes).with_context(|| path.display().to_string())?;
    JointMap::parse(&text).with_context(|| path.display().to_string())
}

fn tolerance(text: &str) -> Result<f64, String> {
    within(text, 0.0..=90.0, "degrees")
}

/// A tone of skin.
pub fn tone(text: &str) -> Result<u8, String> {
    text.parse().ok().filter(|tone| skin_tone(*tone).is_some()).ok_or_else(|| "allowed 1 to 10".into())
}

/// What the arguments name, read.
pub struct GlbOut {
    gltf: ExportOptions,
    rig: Option<(Rig, CheckedRig)>,
}

impl GlbArgs {
    /// The map of a file that is read, where there is no rig that it could be of.
    pub fn input_map(&self) -> anyhow::Result<Option<JointMap>> {
        self.map.as_deref().filter(|_| self.mesh.is_none()).map(read_map).transpose()
    }

    /// Says which of these arguments change nothing in a file of this ending, without its dot.
    pub fn note_idle(&self, ending: &str) {
        // The same in JSON.
        let ending = if ending == "gltf" { "glb" } else { ending };
        let given = [
            ("--names", !matches!(self.names, Names::Webxr), ["glb", "bvh"]),
            ("--glb-axes", !matches!(self.axes, Axes::Bones), ["glb"; 2]),
            ("--tolerance", self.tolerance > 0.0, ["glb", "vrma"]),
            ("--anim-only", self.anim_only, ["glb"; 2]),
            ("--quantize", self.quantize, ["glb"; 2]),
            ("--tone", self.tone.is_some(), ["glb", "png"]),
            ("--mesh", self.mesh.is_some(), ["glb"; 2]),
        ];
        let idle = given.into_iter().filter(|(_, given, endings)| *given && !endings.contains(&ending));
        let idle: Vec<&str> = idle.map(|(name, ..)| name).collect();
        if !idle.is_empty() {
            errln!("handcast: .{ending} is written without {}", idle.join(", "));
        }
        // A rig keeps what it is.
        let own = [
            ("--names", !matches!(self.names, Names::Webxr)),
            ("--glb-axes", !matches!(self.axes, Axes::Bones)),
        ];
        for (name, given) in own {
            if given && self.mesh.is_some() && ending == "glb" {
                errln!("handcast: {name} changes nothing of the hand of --mesh");
            }
        }
        if self.anim_only && self.tone.is_some() && ending == "glb" {
            errln!("handcast: --tone changes nothing with --anim-only");
        }
    }

    /// Reads and checks rig and map.
    pub fn read(&self) -> anyhow::Result<GlbOut> {
        let mut options = ExportOptions::default();
        options.limits = limits().clone();
        options.names = self.names.into();
        options.axes = match self.axes {
            Axes::Bones => NodeAxes::Bones,
            Axes::Webxr => NodeAxes::WebXr,
        };
        options.animation_only = self.anim_only;
        options.quantize = self.quantize;
        options.skin = self.tone.and_then(skin_tone);
        options.rotation_tolerance = self.tolerance.to_radians();
        options.translation_tolerance = self.tolerance.to_radians() * METRES_PER_RADIAN;
        let rig = match &self.mesh {
            Some(path) => {
                let map = self.map.as_deref().map(read_map).transpose()?;
                let bytes = read_input(path, Some(MAX_RIG))?;
                let checked = check_rig(&bytes, path.parent(), map.as_ref(), limits())
                    .with_context(|| path.display().to_string())?;
                Some((Rig { path: path.clone(), bytes, map }, checked))
            }
            None => None,
        };
        Ok(GlbOut { gltf: options, rig })
    }
}

impl GlbOut {
    /// The same for skin of this tone, where none is asked for.
    pub fn of_tone(mut self, tone: Option<u8>) -> Self {
        self.gltf.skin = self.gltf.skin.or(tone.and_then(skin_tone));
        self
    }

    /// The same with an animation named after the file that is written; in standard output, `-`, it keeps its name.
    pub fn named(mut self, output: &Path) -> Self {
        if let Some(stem) = output.file_stem().filter(|_| output.as_os_str() != "-") {
            self.gltf.animation = stem.to_string_lossy().into_owned();
        }
        self
    }

    /// Says what is worth saying of the rig.
    pub fn tell_of_rig(&self) {
        let Some((rig, checked)) = &self.rig else { return };
        checked.notes.iter().for_each(|note| errln!("handcast: {}: {note}", rig.path.display()));
    }

    /// Whether the hand of `side` moves in a GLB: the built-in one, or one that the rig has.
    pub fn moves(&self, side: Side) -> bool {
        self.rig.as_ref().is_none_or(|(_, checked)| checked.sides.contains(&side))
    }

    /// Colour of the skin, sRGB, in place of the clip's.
    pub fn skin(&self) -> Option<[u8; 3]> {
        self.gltf.skin
    }

    /// The animated hands of a clip as GLB: valid poses only, with the sizes of the clip's header, or
    /// `morphology` where it has none. `facts` go into the file's `asset.extras`.
    pub fn write(
        &self,
        clip: &PoseClip,
        morphology: &Morphology,
        facts: serde_json::Map<String, serde_json::Value>,
    ) -> anyhow::Result<Vec<u8>> {
        self.tell_of_rig();
        written(write_glb(clip, &self.options(morphology, facts))?)
    }

    /// How poses are written; hands of unknown sizes get `morphology`, and `facts` go into the `asset.extras` of a GLB.
    pub fn options(
        &self,
        morphology: &Morphology,
        facts: serde_json::Map<String, serde_json::Value>,
    ) -> WriteOptions {
        let mut gltf = self.gltf.clone();
        gltf.extras = facts;
        WriteOptions::default()
            .with_morphology(morphology.clone())
            .with_gltf(gltf)
            .with_rig(self.rig.as_ref().map(|(rig, _)| rig.clone()))
            .with_limits(limits().clone())
    }
}
