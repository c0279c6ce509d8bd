//! From the operators of a file to steps that run: shapes checked, constants unpacked, operators joined, memory planned.

mod build;
mod memory;
mod step;

use std::ops::Range;

use pulp::Arch;

use crate::error::{Error, Result};
use crate::model::{Model, NetworkLimits};
use step::Step;

/// Name and sizes of an input or output.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Port {
    /// Its name in the file.
    pub name: String,
    /// Sizes; rows first, channels last.
    pub shape: Vec<usize>,
}

/// A network that is ready to run.
///
/// ```no_run
/// # fn main() -> handcast_net::Result<()> {
/// let mut network = handcast_net::Network::read(&std::fs::read("palm.tflite").unwrap_or_default())?;
/// if let Some(input) = network.input_mut(0) {
///     input.fill(0.5);
/// }
/// network.run()?;
/// println!("{:?}", network.output(0));
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct Network {
    arch: Arch,
    steps: Vec<Step>,
    /// All intermediate results, each in its range.
    arena: Vec<f32>,
    /// Rows on their way between the parts of one step.
    scratch: Vec<f32>,
    inputs: Vec<(Port, Range<usize>)>,
    outputs: Vec<(Port, Range<usize>)>,
    multiplications: u64,
}

impl Network {
    /// Reads a `.tflite` file within the default limits.
    ///
    /// # Errors
    /// [`Error::Format`] and [`Error::Graph`] where the file is malformed, [`Error::Unsupported`] where it asks for more
    /// than this crate does, [`Error::Limit`] where it asks for too much.
    pub fn read(bytes: &[u8]) -> Result<Self> {
        Self::read_within(bytes, &NetworkLimits::default())
    }

    /// Reads a `.tflite` file.
    ///
    /// # Errors
    /// As [`Network::read`].
    pub fn read_within(bytes: &[u8], limits: &NetworkLimits) -> Result<Self> {
        Self::new(&Model::read(bytes, limits)?, limits)
    }

    /// Prepares a network that was read.
    ///
    /// # Errors
    /// As [`Network::read`].
    pub fn new(model: &Model<'_>, limits: &NetworkLimits) -> Result<Self> {
        build::network(model, limits)
    }

    /// What it takes.
    pub fn inputs(&self) -> impl ExactSizeIterator<Item = &Port> {
        self.inputs.iter().map(|(port, _)| port)
    }

    /// What it gives.
    pub fn outputs(&self) -> impl ExactSizeIterator<Item = &Port> {
        self.outputs.iter().map(|(port, _)| port)
    }

    /// Where the numbers of input `index` are to be written; they stay until they are overwritten.
    pub fn input_mut(&mut self, index: usize) -> Option<&mut [f32]> {
        let (_, range) = self.inputs.get(index)?;
        self.arena.get_mut(range.clone())
    }

    /// The numbers of output `index` after [`Network::run`].
    pub fn output(&self, index: usize) -> Option<&[f32]> {
        let (_, range) = self.outputs.get(index)?;
        self.arena.get(range.clone())
    }

    /// Multiplications of one run.
    pub fn multiplications(&self) -> u64 {
        self.multiplications
    }

    /// Numbers held for intermediate results.
    pub fn memory(&self) -> usize {
        self.arena.len() + self.scratch.len()
    }

    /// Computes the outputs. It allocates nothing.
    ///
    /// # Errors
    /// None for a network that was read without one.
    pub fn run(&mut self) -> Result<()> {
        for step in &self.steps {
            step.run(self.arch, &mut self.arena, &mut self.scratch).map_err(|_| Error::Graph {
                operator: step.name().to_owned(),
                what: "its results overlap its inputs".to_owned(),
            })?;
        }
        Ok(())
    }

    /// Runs, and calls `each` with number, name and duration of every step.
    #[doc(hidden)]
    pub fn profile(&mut self, mut each: impl FnMut(usize, &str, std::time::Duration)) {
        for (number, step) in self.steps.iter().enumerate() {
            let start = std::time::Instant::now();
            let _ = step.run(self.arch, &mut self.arena, &mut self.scratch);
            each(number, step.name(), start.elapsed());
        }
    }
}
