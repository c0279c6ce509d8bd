//! Checks of every operator against its tensors, joining of operators, packing of weights.

use std::ops::Range;

use half::f16;
use pulp::Arch;

use super::memory::{self, Lifetime};
use super::step::{Step, Work};
use super::{Network, Port};
use crate::error::{Error, Result};
use crate::kernels::{Depthwise, Finish, Gemm, Picture, Resize, Window};
use crate::model::{Activation, Kind, Model, NetworkLimits, Operation, Operator, Padding, Sliding};

/// Registers of the widest processors hold so many floats: weights are padded to this at most.
const LANES: usize = 16;

/// A first convolution is joined to a depthwise one when its result would not stay in the second-level cache.
const JOIN: usize = 96 << 10;

/// Prepares a network.
pub(super) fn network(model: &Model<'_>, limits: &NetworkLimits) -> Result<Network> {
    let mut builder = Builder::new(model, *limits);
    builder.read()?;
    builder.join_additions();
    builder.join_slopes();
    builder.join_depthwise();
    builder.finish()
}

/// Weights of a convolution or matrix product: `outputs` rows of `inputs`.
#[derive(Clone, Debug)]
struct Product {
    weights: Vec<f32>,
    bias: Vec<f32>,
    inputs: usize,
    outputs: usize,
    finish: Finish,
}

impl Product {
    fn pack(self, arch: Arch) -> Gemm {
        Gemm::new(arch, &self.weights, self.inputs, &self.bias, self.outputs, self.finish)
    }
}

#[derive(Clone, Debug)]
struct Channels {
    input: Picture,
    output: Picture,
    window: Window,
    weights: Vec<f32>,
    bias: Vec<f32>,
    finish: Finish,
}

impl Channels {
    fn pack(self, arch: Arch) -> Depthwise {
        Depthwise::new(arch, self.input, self.output, self.window, &self.weights, &self.bias, self.finish)
    }
}

#[derive(Clone, Debug)]
enum Job {
    Product(Product),
    Windows(Picture, Picture, Window, Product),
    Channels { before: Option<Product>, channels: Channels, after: Option<Product> },
    Other(Work),
}

impl Job {
    /// How the last part ends, where something can be joined to it.
    fn finish_mut(&mut self) -> Option<&mut Finish> {
        match self {
            Self::Product(product) | Self::Windows(_, _, _, product) => Some(&mut product.finish),
            Self::Channels { after: Some(product), .. } => Some(&mut product.finish),
            Self::Channels { channels, .. } => Some(&mut channels.finish),
            Self::Other(_) => None,
        }
    }
}

/// A step before weights are packed and memory is planned. Values are numbers of tensors.
#[derive(Clone, Debug)]
struct Draft {
    job: Job,
    input: usize,
    other: Option<usize>,
    output: usize,
}

struct Builder<'m, 'a> {
    model: &'m Model<'a>,
    limits: NetworkLimits,
    drafts: Vec<Option<Draft>>,
    /// For each tensor the one whose memory it shares, once it is known.
    values: Vec<Option<usize>>,
    /// For each tensor the constant it is, as it is or converted.
    constants: Vec<Option<usize>>,
    multiplications: u64,
    weights: u64,
}

impl<'m, 'a> Builder<'m, 'a> {
    fn new(model: &'m Model<'a>, limits: NetworkLimits) -> Self {
        let constants = model.tensors.iter().enumerate().map(|(i, tensor)| tensor.data.map(|_| i)).collect();
        Self {
            model,
            limits,
            drafts: Vec::new(),
            values: vec![None; model.tensors.len()],
            constants,
            multiplications: 0,
            weights: 0,
        }
    }

    fn read(&mut self) -> Result<()> {
        for &input in &self.model.inputs {
            let tensor = &self.model.tensors[input];
            if tensor.kind != Kind::F32 || tensor.data.is_some() {
                return Err(port(input, format!("input {:?} is not of computed 32-bit floats", tensor.name)));
            }
            self.values[input] = Some(input);
        }
        for operator in &self.model.operators {
            self.operator(operator)?;
        }
        for &output in &self.model.outputs {
            if self.values[output].is_none() {
                return Err(port(output, "an output that no operator makes".to_owned()));
            }
        }
        Ok(())
    }

    fn shape(&self, tensor: usize) -> &'m [usize] {
        &self.model.tensors[tensor].shape
    }

    /// Input `index` of an operator.
    fn given(&self, operator: &Operator, index: usize) -> Result<usize> {
        operator
            .inputs
            .get(index)
            .copied()
            .flatten()
            .ok_or_else(|| operator.wrong(format!("input {index} is missing")))
    }

    /// Input `index`, which is computed, and the memory it is in.
    fn computed(&self, operator: &Operator, index: usize) -> Result<(usize, usize)> {
        let tensor = self.given(operator, index)?;
        match self.values[tensor] {
            Some(value) => Ok((tensor, value)),
            None if self.constants[tensor].is_some() => {
                Err(operator.unsupported(format!("constant input {index}")))
            }
            None => Err(operator.wrong(format!("input {index} (tensor {tensor}) is used before it is made"))),
        }
    }

    /// Constant input `index` as 32-bit floats.
    fn floats(&self, operator: &Operator, index: usize) -> Result<(usize, Vec<f32>)> {
        let tensor = self.given(operator, index)?;
        let source =
            self.constants[tensor].ok_or_else(|| operator.unsupported(format!("computed input {index}")))?;
        let constant = &self.model.tensors[source];
        let data = constant.data.unwrap_or_default();
        let numbers = match constant.kind {
            Kind::F32 => data.as_chunks::<4>().0.iter().map(|&b| f32::from_le_bytes(b)).collect(),
            Kind::F16 => data.as_chunks::<2>().0.iter().map(|&b| f16::from_le_bytes(b).to_f32()).collect(),
            other => return Err(operator.unsupported(format!("input {index} of {other:?}"))),
        };
        Ok((tensor, numbers))
    }

    /// Constant input `index` as integers.
    fn integers(&self, operator: &Operator, index: usize) -> Result<Vec<i32>> {
        let constant = &self.model.tensors[self.given(operator, index)?];
        match (constant.kind, constant.data) {
            (Kind::I32, Some(data)) => {
                Ok(data.as_chunks::<4>().0.iter().map(|&b| i32::from_le_bytes(b)).collect())
            }
            _ => Err(operator.unsupported(format!("input {index} other than constant integers"))),
        }
    }

    /// A bias of `count` numbers, zeros where it is left out.
    fn bias(&self, operator: &Operator, count: usize) -> Result<Vec<f32>> {
        match operator.inputs.get(2) {
            None | Some(None) => Ok(vec![0.0; count]),
            Some(Some(_)) => {
                let (_, bias) = self.floats(operator, 2)?;
                if bias.len() == count {
                    Ok(bias)
                } else {
                    Err(operator.wrong(format!("{} biases for {count} channels", bias.len())))
                }
            }
        }
    }

    /// A tensor of rows, columns and channels of one picture.
    fn picture(&self, operator: &Operator, tensor: usize) -> Result<Picture> {
        match *self.shape(tensor) {
            [1, rows, columns, channels] => Ok(Picture { rows, columns, channels }),
            ref other => Err(operator.unsupported(format!("a picture of shape {other:?}"))),
        }
    }

    /// That the operator's result is declared as `shape`; it becomes a value of its own.
    fn makes(&mut self, operator: &Operator, shape: &[usize]) -> Result<usize> {
        let declared = self.shape(operator.output);
        if declared != shape {
            return Err(operator.wrong(format!("makes {shape:?} but is declared to make {declared:?}")));
        }
        self.defines(operator, operator.output)?;
        Ok(operator.output)
    }

    fn defines(&mut self, operator: &Operator, value: usize) -> Result<()> {
        let output = operator.output;
        if self.values[output].is_some() || self.constants[output].is_some() {
            return Err(operator.wrong(format!("its output (tensor {output}) has a value already")));
        }
        if self.model.tensors[output].kind != Kind::F32 {
            return Err(operator.unsupported("an output other than of 32-bit floats"));
        }
        self.values[output] = Some(value);
        Ok(())
    }

    fn push(&mut self, job: Job, input: usize, other: Option<usize>, output: usize) {
        self.drafts.push(Some(Draft { job, input, other, output }));
    }

    /// Counts multiplications and packed weights against the limits.
    fn costs(&mut self, multiplications: [usize; 2], weights: [usize; 2]) -> Result<()> {
        let product = |[a, b]: [usize; 2]| (a as u64).saturating_mul(b as u64);
        self.multiplications = self.multiplications.saturating_add(product(multiplications));
        NetworkLimits::check("multiplications", self.multiplications, self.limits.multiplications)?;
        self.weights = self.weights.saturating_add(product(weights));
        NetworkLimits::check("packed weights", self.weights, self.limits.total_elements)
    }

    fn operator(&mut self, operator: &Operator) -> Result<()> {
        match operator.operation {
            Operation::Add(activation) => self.add(operator, activation),
            Operation::Concatenation(axis) => self.concatenation(operator, axis),
            Operation::Conv(sliding) => self.convolution(operator, sliding),
            Operation::DepthwiseConv(sliding) => self.depthwise(operator, sliding),
            Operation::Dequantize => self.dequantize(operator),
            Operation::FullyConnected(activation) => self.fully_connected(operator, activation),
            Operation::Logistic => {
                let (tensor, input) = self.computed(operator, 0)?;
                let output = self.makes(operator, self.shape(tensor))?;
                self.push(Job::Other(Work::Logistic), input, None, output);
                Ok(())
            }
            Operation::MaxPool(sliding, kernel) => self.max_pool(operator, sliding, kernel),
            Operation::Mean => self.mean(operator),
            Operation::Pad => self.pad(operator),
            Operation::Prelu => self.prelu(operator),
            Operation::Reshape => self.reshape(operator),
            Operation::ResizeBilinear => self.resize(operator),
        }
    }

    fn add(&mut self, operator: &Operator, activation: Activation) -> Result<()> {
        let (a, b) = (self.given(operator, 0)?, self.given(operator, 1)?);
        if self.shape(a) != self.shape(b) {
            return Err(operator.unsupported(format!("adding {:?} to {:?}", self.shape(b), self.shape(a))));
        }
        let range = activation.range();
        let constant = match (self.constants[a], self.constants[b]) {
            (None, None) => None,
            (Some(_), _) => Some((1, 0)),
            (None, Some(_)) => Some((0, 1)),
        };
        if let Some((computed, constant)) = constant {
            let (tensor, input) = self.computed(operator, computed)?;
            let (_, constant) = self.floats(operator, constant)?;
            let output = self.makes(operator, self.shape(tensor))?;
            self.push(Job::Other(Work::AddConstant(constant, range)), input, None, output);
            return Ok(());
        }
        let (_, input) = self.computed(operator, 0)?;
        let (_, other) = self.computed(operator, 1)?;
        let output = self.makes(operator, self.shape(a))?;
        self.push(Job::Other(Work::Add(range)), input, Some(other), output);
        Ok(())
    }

    fn concatenation(&mut self, operator: &Operator, axis: i32) -> Result<()> {
        let (first, _) = self.computed(operator, 0)?;
        let shape = self.shape(first);
        let axis = if axis < 0 { axis + shape.len() as i32 } else { axis };
        let axis = usize::try_from(axis)
            .ok()
            .filter(|&a| a < shape.len())
            .ok_or_else(|| operator.wrong(format!("axis {axis} of {shape:?}")))?;
        let mut joined = shape.to_vec();
        joined[axis] = 0;
        let mut parts = Vec::with_capacity(operator.inputs.len());
        for index in 0..operator.inputs.len() {
            let (tensor, value) = self.computed(operator, index)?;
            let other = self.shape(tensor);
            let fits = other.len() == shape.len()
                && other.iter().zip(shape).enumerate().all(|(i, (a, b))| i == axis || a == b);
            if !fits {
                return Err(operator.wrong(format!("{other:?} and {shape:?} along axis {axis}")));
            }
            joined[axis] += other[axis];
            parts.push((value, other[axis..].iter().product::<usize>()));
        }
        let output = self.makes(operator, &joined)?;
        let whole = joined[axis..].iter().product();
        let mut first = 0;
        for (value, part) in parts {
            self.push(Job::Other(Work::Part { part, whole, first }), value, None, output);
            first += part;
        }
        Ok(())
    }

    fn convolution(&mut self, operator: &Operator, sliding: Sliding) -> Result<()> {
        let (tensor, input) = self.computed(operator, 0)?;
        let from = self.picture(operator, tensor)?;
        let (weights_tensor, weights) = self.floats(operator, 1)?;
        let [outputs, rows, columns, channels] = *self.shape(weights_tensor) else {
            return Err(operator.wrong(format!("weights of shape {:?}", self.shape(weights_tensor))));
        };
        if channels != from.channels {
            return Err(operator.wrong(format!("weights for {channels} of {} channels", from.channels)));
        }
        let bias = self.bias(operator, outputs)?;
        let (window, to) = slide(operator, from, sliding, [rows, columns], outputs)?;
        let inputs = rows * columns * channels;
        self.costs([to.len(), inputs], [outputs.next_multiple_of(LANES), inputs])?;
        let finish = clamp(sliding.activation);
        let product = Product { weights, bias, inputs, outputs, finish };
        let output = self.makes(operator, &[1, to.rows, to.columns, to.channels])?;
        let pointwise = window.kernel == [1, 1] && window.stride == [1, 1];
        let job = if pointwise { Job::Product(product) } else { Job::Windows(from, to, window, product) };
        self.push(job, input, None, output);
        Ok(())
    }

    fn depthwise(&mut self, operator: &Operator, sliding: Sliding) -> Result<()> {
        let (tensor, input) = self.computed(operator, 0)?;
        let from = self.picture(operator, tensor)?;
        let (weights_tensor, weights) = self.floats(operator, 1)?;
        let [1, rows, columns, channels] = *self.shape(weights_tensor) else {
            return Err(operator.wrong(format!("weights of shape {:?}", self.shape(weights_tensor))));
        };
        if channels != from.channels {
            let what = format!("{channels} outputs of {} channels", from.channels);
            return Err(operator.unsupported(what));
        }
        let bias = self.bias(operator, channels)?;
        let (window, output) = slide(operator, from, sliding, [rows, columns], channels)?;
        let taps = rows * columns;
        self.costs([output.len(), taps], [channels.next_multiple_of(LANES), taps])?;
        let finish = clamp(sliding.activation);
        let channels = Channels { input: from, output, window, weights, bias, finish };
        let made = self.makes(operator, &[1, output.rows, output.columns, output.channels])?;
        self.push(Job::Channels { before: None, channels, after: None }, input, None, made);
        Ok(())
    }

    fn dequantize(&mut self, operator: &Operator) -> Result<()> {
        let input = self.given(operator, 0)?;
        let (from, to) = (&self.model.tensors[input], &self.model.tensors[operator.output]);
        if from.kind != Kind::F16 || from.data.is_none() {
            return Err(operator.unsupported(format!("converting {:?} that is not constant", from.kind)));
        }
        if from.shape != to.shape || to.kind != Kind::F32 {
            return Err(
                operator.wrong(format!("makes {:?} of {:?} from {:?}", to.kind, to.shape, from.shape))
            );
        }
        if self.values[operator.output].is_some() || self.constants[operator.output].is_some() {
            return Err(operator.wrong("its output has a value already"));
        }
        self.constants[operator.output] = Some(input);
        Ok(())
    }

    fn fully_connected(&mut self, operator: &Operator, activation: Activation) -> Result<()> {
        let (tensor, input) = self.computed(operator, 0)?;
        let (weights_tensor, weights) = self.floats(operator, 1)?;
        let [outputs, inputs] = *self.shape(weights_tensor) else {
            return Err(operator.wrong(format!("weights of shape {:?}", self.shape(weights_tensor))));
        };
        let count = self.model.tensors[tensor].elements();
        if !count.is_multiple_of(inputs) {
            return Err(operator.wrong(format!("weights of {inputs} inputs for {count} numbers")));
        }
        let bias = self.bias(operator, outputs)?;
        self.costs([count / inputs * outputs, inputs], [outputs.next_multiple_of(LANES), inputs])?;
        let declared = self.shape(operator.output);
        let fits = declared.last() == Some(&outputs)
            && declared.iter().product::<usize>() == count / inputs * outputs;
        if !fits {
            return Err(operator.wrong(format!(
                "makes {} x {outputs} but is declared to make {declared:?}",
                count / inputs
            )));
        }
        let output = self.makes(operator, declared)?;
        let product = Product { weights, bias, inputs, outputs, finish: clamp(activation) };
        self.push(Job::Product(product), input, None, output);
        Ok(())
    }

    fn max_pool(&mut self, operator: &Operator, sliding: Sliding, kernel: [usize; 2]) -> Result<()> {
        let (tensor, input) = self.computed(operator, 0)?;
        let from = self.picture(operator, tensor)?;
        let (window, to) = slide(operator, from, sliding, kernel, from.channels)?;
        self.costs([to.len(), kernel[0] * kernel[1]], [0, 0])?;
        let output = self.makes(operator, &[1, to.rows, to.columns, to.channels])?;
        let range = sliding.activation.range();
        self.push(Job::Other(Work::MaxPool { input: from, output: to, window, range }), input, None, output);
        Ok(())
    }

    fn mean(&mut self, operator: &Operator) -> Result<()> {
        let (tensor, input) = self.computed(operator, 0)?;
        let from = self.picture(operator, tensor)?;
        let mut axes = self.integers(operator, 1)?;
        axes.iter_mut().for_each(|axis| *axis += if *axis < 0 { 4 } else { 0 });
        axes.sort_unstable();
        if axes != [1, 2] {
            return Err(operator.unsupported(format!("axes {axes:?} instead of rows and columns")));
        }
        let kept = [1, 1, 1, from.channels];
        let shape: &[usize] = if self.shape(operator.output).len() == 4 { &kept } else { &kept[2..] };
        let output = self.makes(operator, shape)?;
        self.push(Job::Other(Work::Mean), input, None, output);
        Ok(())
    }

    fn pad(&mut self, operator: &Operator) -> Result<()> {
        let (tensor, input) = self.computed(operator, 0)?;
        let sizes = self.shape(tensor);
        let amounts = self.integers(operator, 1)?;
        let (pairs, rest) = amounts.as_chunks::<2>();
        if sizes.len() > 4 || pairs.len() != sizes.len() || !rest.is_empty() {
            return Err(operator.unsupported(format!("{} paddings of {sizes:?}", amounts.len())));
        }
        let (mut shape, mut before, mut padded) = ([1; 4], [0; 4], [1; 4]);
        for (axis, (&[low, high], &size)) in pairs.iter().zip(sizes).enumerate() {
            let amount = |v: i32| {
                usize::try_from(v)
                    .ok()
                    .filter(|&v| v as u64 <= self.limits.elements)
                    .ok_or_else(|| operator.wrong(format!("a padding of {v}")))
            };
            let at = axis + 4 - sizes.len();
            shape[at] = size;
            before[at] = amount(low)?;
            padded[at] = size + before[at] + amount(high)?;
        }
        let output = self.makes(operator, &padded[4 - sizes.len()..])?;
        self.push(Job::Other(Work::Pad { shape, before, padded }), input, None, output);
        Ok(())
    }

    fn prelu(&mut self, operator: &Operator) -> Result<()> {
        let (tensor, input) = self.computed(operator, 0)?;
        let (_, slopes) = self.floats(operator, 1)?;
        if self.shape(tensor).last() != Some(&slopes.len()) {
            let what = format!("{} slopes for {:?}", slopes.len(), self.shape(tensor));
            return Err(operator.unsupported(what));
        }
        let output = self.makes(operator, self.shape(tensor))?;
        self.push(Job::Other(Work::Prelu(slopes)), input, None, output);
        Ok(())
    }

    fn reshape(&mut self, operator: &Operator) -> Result<()> {
        let (tensor, input) = self.computed(operator, 0)?;
        let (from, to) = (self.shape(tensor), self.shape(operator.output));
        if from.iter().product::<usize>() != to.iter().product::<usize>() {
            return Err(operator.wrong(format!("makes {to:?} of {from:?}")));
        }
        self.defines(operator, input)
    }

    fn resize(&mut self, operator: &Operator) -> Result<()> {
        let (tensor, input) = self.computed(operator, 0)?;
        let from = self.picture(operator, tensor)?;
        let sizes = self.integers(operator, 1)?;
        let sizes: Vec<usize> = sizes.iter().filter_map(|&v| usize::try_from(v).ok()).collect();
        let [rows, columns] = sizes[..] else {
            return Err(operator.wrong(format!("sizes {sizes:?}")));
        };
        let to = Picture { rows, columns, ..from };
        let output = self.makes(operator, &[1, rows, columns, from.channels])?;
        self.push(Job::Other(Work::Resize(Resize::new(from, to))), input, None, output);
        Ok(())
    }

    /// The draft that makes `value`, if it can be joined to the only one that reads it.
    fn maker(&self, value: usize) -> Option<usize> {
        let shared = |&&tensor: &&usize| self.values[tensor] == Some(value);
        if self.model.outputs.iter().chain(&self.model.inputs).any(|tensor| shared(&tensor)) {
            return None;
        }
        let drafts = || self.drafts.iter().flatten();
        let reads = |d: &Draft| usize::from(d.input == value) + usize::from(d.other == Some(value));
        if drafts().map(reads).sum::<usize>() != 1 {
            return None;
        }
        self.drafts.iter().position(|d| d.as_ref().is_some_and(|d| d.output == value))
    }

    /// Additions to the result of a convolution become its last step.
    fn join_additions(&mut self) {
        for at in 0..self.drafts.len() {
            let Some(Draft { job: Job::Other(Work::Add(range)), input, other: Some(other), output }) =
                self.drafts[at]
            else {
                continue;
            };
            let joined = [(input, other), (other, input)]
                .into_iter()
                .filter_map(|(value, added)| Some((self.maker(value)?, added)))
                .filter(|(maker, _)| {
                    self.drafts[*maker].as_ref().is_some_and(|d| match &d.job {
                        Job::Product(p) | Job::Windows(_, _, _, p) => d.other.is_none() && plain(&p.finish),
                        _ => false,
                    })
                })
                .max();
            let Some((maker, added)) = joined else { continue };
            if let Some(mut draft) = self.drafts[maker].take() {
                if let Some(finish) = draft.job.finish_mut() {
                    *finish = Finish::Clamp(range.0, range.1);
                }
                self.drafts[at] = Some(Draft { other: Some(added), output, ..draft });
            }
        }
    }

    /// Slopes of negative results become part of what makes them.
    fn join_slopes(&mut self) {
        for at in 0..self.drafts.len() {
            let Some(Draft { job: Job::Other(Work::Prelu(slopes)), input, output, .. }) = &self.drafts[at]
            else {
                continue;
            };
            let (slopes, input, output) = (slopes.clone(), *input, *output);
            let Some(maker) = self.maker(input) else { continue };
            let same = self.drafts[maker].as_mut().and_then(|d| d.job.finish_mut()).filter(|f| plain(f));
            if let Some(finish) = same {
                *finish = Finish::Slopes(slopes);
                self.drafts[at] = self.drafts[maker].take().map(|draft| Draft { output, ..draft });
            }
        }
    }

    /// Convolutions of one pixel before and after a depthwise one become one step with it.
    fn join_depthwise(&mut self) {
        for at in 0..self.drafts.len() {
            let Some(Draft { job: Job::Product(_), input, .. }) = &self.drafts[at] else { continue };
            let Some(maker) = self.maker(*input) else { continue };
            if !matches!(&self.drafts[maker], Some(Draft { job: Job::Channels { after: None, .. }, .. })) {
                continue;
            }
            let (Some(first), Some(second)) = (self.drafts[maker].take(), self.drafts[at].take()) else {
                continue;
            };
            if let (Job::Channels { before, channels, .. }, Job::Product(product)) = (first.job, second.job) {
                let job = Job::Channels { before, channels, after: Some(product) };
                self.drafts[at] = Some(Draft { job, input: first.input, ..second });
            }
        }
        for at in 0..self.drafts.len() {
            let Some(Draft { job: Job::Channels { before: None, channels, .. }, input, .. }) =
                &self.drafts[at]
            else {
                continue;
            };
            if channels.input.len() < JOIN {
                continue;
            }
            let Some(maker) = self.maker(*input) else { continue };
            if !matches!(&self.drafts[maker], Some(Draft { job: Job::Product(_), other: None, .. })) {
                continue;
            }
            let (Some(first), Some(second)) = (self.drafts[maker].take(), self.drafts[at].take()) else {
                continue;
            };
            if let (Job::Product(product), Job::Channels { channels, after, .. }) = (first.job, second.job) {
                let job = Job::Channels { before: Some(product), channels, after };
                self.drafts[at] = Some(Draft { job, input: first.input, ..second });
            }
        }
    }

    fn finish(self) -> Result<Network> {
        let arch = Arch::new();
        let drafts: Vec<Draft> = self.drafts.into_iter().flatten().collect();
        let (places, total) = memory_plan(self.model, &self.values, &drafts);
        NetworkLimits::check("intermediate results", total as u64, self.limits.total_elements)?;
        let place = |value: usize| places[value].clone();
        let mut steps = Vec::with_capacity(drafts.len());
        for draft in drafts {
            let work = match draft.job {
                Job::Product(product) => Work::Gemm(product.pack(arch)),
                Job::Windows(input, output, window, product) => {
                    Work::Windows { input, output, window, gemm: product.pack(arch) }
                }
                Job::Channels { before, channels, after } => Work::Depthwise {
                    before: before.map(|p| p.pack(arch)),
                    depthwise: channels.pack(arch),
                    after: after.map(|p| p.pack(arch)),
                },
                Job::Other(work) => work,
            };
            let (input, other, output) = (place(draft.input), draft.other.map(place), place(draft.output));
            steps.push(Step { work, input, other, output });
        }
        let scratch = steps.iter().map(Step::scratch).max().unwrap_or(0);
        NetworkLimits::check("rows between steps", scratch as u64, self.limits.total_elements)?;
        let ports = |tensors: &[usize]| {
            tensors
                .iter()
                .map(|&t| {
                    let tensor = &self.model.tensors[t];
                    let port = Port { name: tensor.name.to_owned(), shape: tensor.shape.clone() };
                    (port, self.values[t].map_or(0..0, place))
                })
                .collect()
        };
        Ok(Network {
            arch,
            steps,
            arena: vec![0.0; total],
            scratch: vec![0.0; scratch],
            inputs: ports(&self.model.inputs),
            outputs: ports(&self.model.outputs),
            multiplications: self.multiplications,
        })
    }
}

/// Where each value is, by number of its tensor. Inputs and outputs live all the time.
fn memory_plan(model: &Model<'_>, values: &[Option<usize>], drafts: &[Draft]) -> (Vec<Range<usize>>, usize) {
    let end = drafts.len();
    let mut spans: Vec<Option<(usize, usize)>> = vec![None; values.len()];
    let mut touch = |value: usize, step: usize| {
        let (first, last) = spans[value].unwrap_or((step, step));
        spans[value] = Some((first.min(step), last.max(step)));
    };
    for &tensor in model.inputs.iter().chain(&model.outputs) {
        if let Some(value) = values[tensor] {
            touch(value, 0);
            touch(value, end);
        }
    }
    for (step, draft) in drafts.iter().enumerate() {
        [Some(draft.input), draft.other, Some(draft.output)]
            .into_iter()
            .flatten()
            .for_each(|v| touch(v, step));
    }
    let live: Vec<usize> = (0..values.len()).filter(|&v| spans[v].is_some()).collect();
    let lifetimes: Vec<Lifetime> = live
        .iter()
        .filter_map(|&v| {
            spans[v].map(|(first, last)| Lifetime { size: model.tensors[v].elements(), steps: first..=last })
        })
        .collect();
    let (found, total) = memory::plan(&lifetimes);
    let mut places = vec![0..0; values.len()];
    for (value, place) in live.into_iter().zip(found) {
        places[value] = place;
    }
    (places, total)
}

fn port(tensor: usize, what: String) -> Error {
    Error::Graph { operator: format!("tensor {tensor}"), what }
}

fn clamp(activation: Activation) -> Finish {
    let (low, high) = activation.range();
    Finish::Clamp(low, high)
}

/// Whether results are stored as they are.
fn plain(finish: &Finish) -> bool {
    matches!(finish, Finish::Clamp(low, high) if *low == f32::NEG_INFINITY && *high == f32::INFINITY)
}

/// The window and the picture it makes.
fn slide(
    operator: &Operator,
    from: Picture,
    sliding: Sliding,
    kernel: [usize; 2],
    channels: usize,
) -> Result<(Window, Picture)> {
    let Sliding { padding, stride, dilation, .. } = sliding;
    let mut before = [0; 2];
    let mut sizes = [0; 2];
    for (axis, size) in [from.rows, from.columns].into_iter().enumerate() {
        if kernel[axis] > 1024 {
            return Err(operator.unsupported(format!("a window of {kernel:?}")));
        }
        let reach = (kernel[axis] - 1) * dilation[axis] + 1;
        match padding {
            Padding::Same => {
                sizes[axis] = size.div_ceil(stride[axis]);
                before[axis] = ((sizes[axis] - 1) * stride[axis] + reach).saturating_sub(size) / 2;
            }
            Padding::Valid if reach <= size => sizes[axis] = (size - reach) / stride[axis] + 1,
            Padding::Valid => {
                return Err(operator.wrong(format!("a window of {reach} pixels on a picture of {size}")));
            }
        }
    }
    let window = Window { kernel, stride, dilation, before };
    Ok((window, Picture { rows: sizes[0], columns: sizes[1], channels }))
}
