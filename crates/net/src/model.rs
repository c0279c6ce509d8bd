//! Reading of TensorFlow Lite files, the part of the schema that networks of
//! [the operators listed](Operation) use.
//!
//! Field numbers are those of the published schema, version 3 (`tensorflow/compiler/mlir/lite/schema/schema.fbs`).

mod flat;

use flat::Table;

use crate::error::{Error, Result};

const IDENTIFIER: &[u8; 4] = b"TFL3";

/// What a file may ask for; checked before memory is taken.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct NetworkLimits {
    /// Tensors, and operators.
    pub parts: u64,
    /// Numbers in one tensor.
    pub elements: u64,
    /// Numbers in all weights, and in all intermediate results.
    pub total_elements: u64,
    /// Multiplications of one run.
    pub multiplications: u64,
}

impl Default for NetworkLimits {
    fn default() -> Self {
        Self { parts: 10_000, elements: 1 << 23, total_elements: 1 << 25, multiplications: 20_000_000_000 }
    }
}

impl NetworkLimits {
    /// Tensors, and operators.
    pub fn with_parts(mut self, parts: u64) -> Self {
        self.parts = parts;
        self
    }

    /// Numbers in one tensor.
    pub fn with_elements(mut self, elements: u64) -> Self {
        self.elements = elements;
        self
    }

    /// Numbers in all weights, and in all intermediate results.
    pub fn with_total_elements(mut self, elements: u64) -> Self {
        self.total_elements = elements;
        self
    }

    /// Multiplications of one run.
    pub fn with_multiplications(mut self, multiplications: u64) -> Self {
        self.multiplications = multiplications;
        self
    }

    pub(crate) fn check(what: &'static str, found: u64, allowed: u64) -> Result<()> {
        if found > allowed { Err(Error::Limit { what, found, allowed }) } else { Ok(()) }
    }
}

/// What a tensor's numbers are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// 32-bit floats.
    F32,
    /// 16-bit floats: weights.
    F16,
    /// 32-bit integers: shapes, axes, paddings.
    I32,
    /// Any other type, by its number in the schema.
    Other(u8),
}

impl Kind {
    fn new(code: u8) -> Self {
        match code {
            0 => Self::F32,
            1 => Self::F16,
            2 => Self::I32,
            other => Self::Other(other),
        }
    }

    fn width(self) -> usize {
        match self {
            Self::F32 | Self::I32 => 4,
            Self::F16 => 2,
            Self::Other(_) => 0,
        }
    }
}

/// A tensor: constant when it has data, else the result of an operator or an input.
#[derive(Clone, Debug)]
pub struct Tensor<'a> {
    /// Its name in the file.
    pub name: &'a str,
    /// Sizes; rows first, channels last.
    pub shape: Vec<usize>,
    /// What its numbers are.
    pub kind: Kind,
    /// Little-endian numbers of a constant.
    pub data: Option<&'a [u8]>,
}

impl Tensor<'_> {
    /// How many numbers it has.
    pub fn elements(&self) -> usize {
        self.shape.iter().product()
    }
}

/// What is done at the borders of a window that moves over a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Padding {
    /// Outputs at every stride: borders are filled, the odd one at the right and lower side.
    Same,
    /// Windows lie inside of the picture.
    Valid,
}

/// What is done with every result of an operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// Nothing.
    None,
    /// max(x, 0).
    Relu,
    /// x limited to [-1, 1].
    ReluN1To1,
    /// x limited to [0, 6].
    Relu6,
}

impl Activation {
    /// The interval results are limited to.
    pub fn range(self) -> (f32, f32) {
        match self {
            Self::None => (f32::NEG_INFINITY, f32::INFINITY),
            Self::Relu => (0.0, f32::INFINITY),
            Self::ReluN1To1 => (-1.0, 1.0),
            Self::Relu6 => (0.0, 6.0),
        }
    }
}

/// A window of weights that moves over a picture; sizes are rows, columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sliding {
    /// Borders.
    pub padding: Padding,
    /// Step between windows.
    pub stride: [usize; 2],
    /// Distance of samples inside of a window.
    pub dilation: [usize; 2],
    /// Applied to each result.
    pub activation: Activation,
}

/// The operators this crate runs, with their options. Inputs are in the order of the TensorFlow Lite documentation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Operation {
    /// ADD of two tensors of one shape.
    Add(Activation),
    /// CONCATENATION along an axis; a negative one counts from the last.
    Concatenation(i32),
    /// CONV_2D; weights are output channel, row, column, input channel.
    Conv(Sliding),
    /// DEPTHWISE_CONV_2D with one output for each input channel; weights are 1, row, column, channel.
    DepthwiseConv(Sliding),
    /// DEQUANTIZE of constant 16-bit floats.
    Dequantize,
    /// FULLY_CONNECTED; weights are output, input.
    FullyConnected(Activation),
    /// LOGISTIC: 1 / (1 + exp(-x)).
    Logistic,
    /// MAX_POOL_2D with a window of rows, columns.
    MaxPool(Sliding, [usize; 2]),
    /// MEAN over rows and columns.
    Mean,
    /// PAD with zeros.
    Pad,
    /// PRELU: x where positive, else x times a slope for its channel.
    Prelu,
    /// RESHAPE.
    Reshape,
    /// RESIZE_BILINEAR whose samples are at the centres of pixels.
    ResizeBilinear,
}

/// Number in the schema, and name.
const CODES: [(i32, &str); 13] = [
    (0, "ADD"),
    (2, "CONCATENATION"),
    (3, "CONV_2D"),
    (4, "DEPTHWISE_CONV_2D"),
    (6, "DEQUANTIZE"),
    (9, "FULLY_CONNECTED"),
    (14, "LOGISTIC"),
    (17, "MAX_POOL_2D"),
    (22, "RESHAPE"),
    (23, "RESIZE_BILINEAR"),
    (34, "PAD"),
    (40, "MEAN"),
    (54, "PRELU"),
];

impl Operation {
    /// Number in the schema.
    pub fn code(&self) -> i32 {
        match self {
            Self::Add(_) => 0,
            Self::Concatenation(_) => 2,
            Self::Conv(_) => 3,
            Self::DepthwiseConv(_) => 4,
            Self::Dequantize => 6,
            Self::FullyConnected(_) => 9,
            Self::Logistic => 14,
            Self::MaxPool(..) => 17,
            Self::Reshape => 22,
            Self::ResizeBilinear => 23,
            Self::Pad => 34,
            Self::Mean => 40,
            Self::Prelu => 54,
        }
    }

    /// Name in the schema.
    pub fn name(&self) -> &'static str {
        name_of(self.code())
    }
}

fn name_of(code: i32) -> &'static str {
    CODES.iter().find(|(number, _)| *number == code).map_or("an operator", |(_, name)| name)
}

/// One operator of a network.
#[derive(Clone, Debug)]
pub struct Operator {
    /// What it does.
    pub operation: Operation,
    /// Numbers of its input tensors; `None` where an optional one is left out.
    pub inputs: Vec<Option<usize>>,
    /// Number of the tensor it makes.
    pub output: usize,
    /// Number and name, for errors.
    pub label: String,
}

impl Operator {
    /// That the operator does not fit what it is given.
    pub(crate) fn wrong(&self, what: impl Into<String>) -> Error {
        Error::Graph { operator: self.label.clone(), what: what.into() }
    }

    /// That the operator asks for what this crate does not do.
    pub(crate) fn unsupported(&self, what: impl Into<String>) -> Error {
        Error::Unsupported { operator: self.label.clone(), what: what.into() }
    }
}

/// A network as it is in a file.
#[derive(Clone, Debug)]
pub struct Model<'a> {
    /// All tensors.
    pub tensors: Vec<Tensor<'a>>,
    /// Operators in an order in which they can run.
    pub operators: Vec<Operator>,
    /// Numbers of the tensors given.
    pub inputs: Vec<usize>,
    /// Numbers of the tensors asked for.
    pub outputs: Vec<usize>,
}

impl<'a> Model<'a> {
    /// Reads a `.tflite` file.
    ///
    /// # Errors
    /// [`Error::Format`] where an offset, a size or a number is impossible, [`Error::Limit`], [`Error::Unsupported`].
    pub fn read(bytes: &'a [u8], limits: &NetworkLimits) -> Result<Self> {
        let root = Table::root(bytes, IDENTIFIER)?;
        let version = root.unsigned(0, 0)?;
        if version != 3 {
            return Err(bad(root, format!("schema version {version}, not 3")));
        }
        let graphs = root.tables(2, "subgraphs")?;
        if graphs.len() != 1 {
            return Err(bad(root, format!("{} subgraphs, not 1", graphs.len())));
        }
        let graph = graphs.get(0, "subgraph")?;
        let tensors = read_tensors(root, graph, limits)?;
        let operators = read_operators(root, graph, tensors.len(), limits)?;
        let numbers = |id, what| {
            graph
                .ints(id, what)?
                .map(|n| index(n, tensors.len()).ok_or_else(|| bad(graph, format!("{what}: tensor {n}"))))
                .collect::<Result<Vec<_>>>()
        };
        let inputs = numbers(1, "inputs")?;
        let outputs = numbers(2, "outputs")?;
        if inputs.is_empty() || outputs.is_empty() {
            return Err(bad(graph, "a network without inputs or outputs"));
        }
        Ok(Self { tensors, operators, inputs, outputs })
    }
}

fn bad(table: Table<'_>, what: impl Into<String>) -> Error {
    Error::Format { at: table.position(), what: what.into() }
}

fn index(number: i32, count: usize) -> Option<usize> {
    usize::try_from(number).ok().filter(|&n| n < count)
}

fn read_tensors<'a>(root: Table<'a>, graph: Table<'a>, limits: &NetworkLimits) -> Result<Vec<Tensor<'a>>> {
    let buffers = root.tables(4, "buffers")?;
    let tables = graph.tables(0, "tensors")?;
    NetworkLimits::check("tensors", tables.len() as u64, limits.parts)?;
    let mut weights = 0;
    let mut tensors = Vec::with_capacity(tables.len());
    for table in tables.iter("tensor") {
        let table = table?;
        let name = table.text(3, "a tensor's name")?;
        let sizes = table.ints(0, "a tensor's shape")?;
        if sizes.len() > 6 {
            return Err(bad(table, format!("tensor {name:?} has {} dimensions", sizes.len())));
        }
        let shape = sizes
            .map(|size| {
                usize::try_from(size)
                    .ok()
                    .filter(|&size| size > 0)
                    .ok_or_else(|| bad(table, format!("tensor {name:?} has a dimension of {size}")))
            })
            .collect::<Result<Vec<usize>>>()?;
        let elements = shape.iter().fold(1u64, |n, &size| n.saturating_mul(size as u64));
        NetworkLimits::check("numbers in a tensor", elements, limits.elements)?;
        let kind = Kind::new(table.byte(1, 0)?);
        let data =
            read_data(table, name, buffers.get(table.unsigned(2, 0)? as usize, "buffer")?, kind, elements)?;
        weights += if data.is_some() { elements } else { 0 };
        NetworkLimits::check("weights", weights, limits.total_elements)?;
        tensors.push(Tensor { name, shape, kind, data });
    }
    Ok(tensors)
}

fn read_data<'a>(
    tensor: Table<'a>,
    name: &str,
    buffer: Table<'a>,
    kind: Kind,
    elements: u64,
) -> Result<Option<&'a [u8]>> {
    if buffer.long(1, 0)? > 1 {
        return Err(bad(buffer, format!("the data of tensor {name:?} lie outside of the tables")));
    }
    match buffer.bytes(0, "a buffer")? {
        None | Some([]) => Ok(None),
        Some(_) if kind.width() == 0 => {
            Err(bad(tensor, format!("tensor {name:?} is of {kind:?}, not of f32, f16 or i32")))
        }
        Some(data) if data.len() as u64 != elements * kind.width() as u64 => Err(bad(
            tensor,
            format!(
                "tensor {name:?} has {elements} numbers of {} bytes in {} bytes",
                kind.width(),
                data.len()
            ),
        )),
        Some(data) => Ok(Some(data)),
    }
}

fn read_operators(
    root: Table<'_>,
    graph: Table<'_>,
    tensors: usize,
    limits: &NetworkLimits,
) -> Result<Vec<Operator>> {
    let codes = root.tables(1, "operator codes")?;
    let tables = graph.tables(3, "operators")?;
    NetworkLimits::check("operators", tables.len() as u64, limits.parts)?;
    let mut operators = Vec::with_capacity(tables.len());
    for (number, table) in tables.iter("operator").enumerate() {
        let table = table?;
        let code = codes.get(table.unsigned(0, 0)? as usize, "operator code")?;
        // Codes below 127 are in the older, narrow field as well, and files of older converters have only that.
        let code = code.int(3, 0)?.max(i32::from(code.byte(0, 0)?));
        let label = format!("operator {number} ({})", name_of(code));
        let inputs = table.ints(1, "an operator's inputs")?;
        let outputs = table.ints(2, "an operator's outputs")?;
        if inputs.len() > 64 || outputs.len() != 1 {
            return Err(bad(table, format!("{label}: {} inputs, {} outputs", inputs.len(), outputs.len())));
        }
        let inputs = inputs
            .map(|n| match n {
                -1 => Ok(None),
                n => index(n, tensors).map(Some).ok_or_else(|| bad(table, format!("{label}: tensor {n}"))),
            })
            .collect::<Result<Vec<_>>>()?;
        let output = outputs.last().unwrap_or(-1);
        let output = index(output, tensors).ok_or_else(|| bad(table, format!("{label}: tensor {output}")))?;
        let options = Options { table: table.table(4)?, position: table.position(), label: &label };
        let operation = options.operation(code)?;
        operators.push(Operator { operation, inputs, output, label });
    }
    Ok(operators)
}

/// An operator's options: each field has a default, and so has the whole table.
struct Options<'a> {
    table: Option<Table<'a>>,
    position: usize,
    label: &'a str,
}

impl Options<'_> {
    fn operation(&self, code: i32) -> Result<Operation> {
        Ok(match code {
            0 => Operation::Add(self.activation(0)?),
            2 => {
                self.linear(1)?;
                Operation::Concatenation(self.int(0, 0)?)
            }
            3 => Operation::Conv(self.sliding(3, Some(4))?),
            4 => Operation::DepthwiseConv(self.sliding(4, Some(5))?),
            6 => Operation::Dequantize,
            9 => {
                if self.byte(1, 0)? != 0 {
                    return Err(self.unsupported("a shuffled weight format"));
                }
                Operation::FullyConnected(self.activation(0)?)
            }
            14 => Operation::Logistic,
            17 => Operation::MaxPool(self.sliding(5, None)?, [self.positive(4)?, self.positive(3)?]),
            22 => Operation::Reshape,
            23 => {
                if self.byte(2, 0)? != 0 || self.byte(3, 0)? == 0 {
                    return Err(self.unsupported("sampling other than at the centres of pixels"));
                }
                Operation::ResizeBilinear
            }
            34 => Operation::Pad,
            40 => Operation::Mean,
            54 => Operation::Prelu,
            other => return Err(self.unsupported(format!("operator code {other}"))),
        })
    }

    fn byte(&self, id: usize, default: u8) -> Result<u8> {
        self.table.map_or(Ok(default), |table| table.byte(id, default))
    }

    fn int(&self, id: usize, default: i32) -> Result<i32> {
        self.table.map_or(Ok(default), |table| table.int(id, default))
    }

    /// A size from 1 to 1024.
    fn positive(&self, id: usize) -> Result<usize> {
        self.size(id, 0)
    }

    fn size(&self, id: usize, default: i32) -> Result<usize> {
        let value = self.int(id, default)?;
        usize::try_from(value).ok().filter(|v| (1..=1024).contains(v)).ok_or_else(|| Error::Format {
            at: self.position,
            what: format!("{}: option {id} is {value}, not from 1 to 1024", self.label),
        })
    }

    fn activation(&self, id: usize) -> Result<Activation> {
        match self.byte(id, 0)? {
            0 => Ok(Activation::None),
            1 => Ok(Activation::Relu),
            2 => Ok(Activation::ReluN1To1),
            3 => Ok(Activation::Relu6),
            other => Err(self.unsupported(format!("activation {other}"))),
        }
    }

    /// That there is no activation.
    fn linear(&self, id: usize) -> Result<()> {
        match self.activation(id)? {
            Activation::None => Ok(()),
            other => Err(self.unsupported(format!("activation {other:?}"))),
        }
    }

    fn sliding(&self, activation: usize, dilation: Option<usize>) -> Result<Sliding> {
        Ok(Sliding {
            padding: match self.byte(0, 0)? {
                0 => Padding::Same,
                1 => Padding::Valid,
                other => return Err(self.unsupported(format!("padding {other}"))),
            },
            stride: [self.positive(2)?, self.positive(1)?],
            dilation: match dilation {
                Some(id) => [self.size(id + 1, 1)?, self.size(id, 1)?],
                None => [1, 1],
            },
            activation: self.activation(activation)?,
        })
    }

    fn unsupported(&self, what: impl Into<String>) -> Error {
        Error::Unsupported { operator: self.label.to_owned(), what: what.into() }
    }
}
