//! A writer of small `.tflite` files, and two networks that find red squares: tests need no files of others.

use half::f16;

use crate::model::{Activation, Operation, Padding, Sliding};

/// A value in a FlatBuffer, before it is written.
#[derive(Clone, Debug)]
enum Value {
    Byte(u8),
    Int(i32),
    Table(Vec<Option<Value>>),
    Tables(Vec<Value>),
    Ints(Vec<i32>),
    Bytes(Vec<u8>),
}

/// A network in the making. Each method that adds a tensor returns its number.
#[derive(Clone, Debug, Default)]
pub struct Writer {
    tensors: Vec<Value>,
    buffers: Vec<Value>,
    codes: Vec<i32>,
    operators: Vec<Value>,
    inputs: Vec<i32>,
    outputs: Vec<i32>,
}

const F32: u8 = 0;
const F16: u8 = 1;
const I32: u8 = 2;

impl Writer {
    /// An empty network.
    pub fn new() -> Self {
        // Buffer 0 is by convention the empty one of tensors without data.
        Self { buffers: vec![Value::Table(Vec::new())], ..Self::default() }
    }

    fn tensor(&mut self, shape: &[usize], kind: u8, data: Option<Vec<u8>>) -> usize {
        let buffer = data.map_or(0, |data| {
            self.buffers.push(Value::Table(vec![Some(Value::Bytes(data))]));
            self.buffers.len() as i32 - 1
        });
        let number = self.tensors.len();
        self.tensors.push(Value::Table(vec![
            Some(Value::Ints(shape.iter().map(|&s| s as i32).collect())),
            Some(Value::Byte(kind)),
            Some(Value::Int(buffer)),
            Some(Value::Bytes(format!("tensor {number}").into_bytes())),
        ]));
        number
    }

    /// An input of the network.
    pub fn input(&mut self, shape: &[usize]) -> usize {
        let tensor = self.tensor(shape, F32, None);
        self.inputs.push(tensor as i32);
        tensor
    }

    /// A constant of 32-bit floats.
    pub fn floats(&mut self, shape: &[usize], data: &[f32]) -> usize {
        self.tensor(shape, F32, Some(data.iter().flat_map(|x| x.to_le_bytes()).collect()))
    }

    /// A constant of 16-bit floats behind a DEQUANTIZE, as in networks whose weights are stored so.
    pub fn halves(&mut self, shape: &[usize], data: &[f32]) -> usize {
        let data = data.iter().flat_map(|&x| f16::from_f32(x).to_le_bytes()).collect();
        let stored = self.tensor(shape, F16, Some(data));
        self.operator(Operation::Dequantize, &[Some(stored)], shape)
    }

    /// A constant of integers.
    pub fn integers(&mut self, shape: &[usize], data: &[i32]) -> usize {
        self.tensor(shape, I32, Some(data.iter().flat_map(|x| x.to_le_bytes()).collect()))
    }

    /// An operator and the tensor it makes.
    pub fn operator(&mut self, operation: Operation, inputs: &[Option<usize>], shape: &[usize]) -> usize {
        let output = self.tensor(shape, F32, None);
        let code = operation.code();
        let index = self.codes.iter().position(|&c| c == code).unwrap_or_else(|| {
            self.codes.push(code);
            self.codes.len() - 1
        });
        self.operators.push(Value::Table(vec![
            Some(Value::Int(index as i32)),
            Some(Value::Ints(inputs.iter().map(|i| i.map_or(-1, |i| i as i32)).collect())),
            Some(Value::Ints(vec![output as i32])),
            Some(Value::Byte(0)),
            Some(Value::Table(options(operation))),
        ]));
        output
    }

    /// Makes a tensor an output of the network.
    pub fn output(&mut self, tensor: usize) {
        self.outputs.push(tensor as i32);
    }

    /// The file.
    pub fn finish(&self) -> Vec<u8> {
        let codes = self.codes.iter().map(|&code| {
            Value::Table(vec![
                Some(Value::Byte(code as u8)),
                None,
                Some(Value::Int(1)),
                Some(Value::Int(code)),
            ])
        });
        let graph = Value::Table(vec![
            Some(Value::Tables(self.tensors.clone())),
            Some(Value::Ints(self.inputs.clone())),
            Some(Value::Ints(self.outputs.clone())),
            Some(Value::Tables(self.operators.clone())),
        ]);
        let root = Value::Table(vec![
            Some(Value::Int(3)),
            Some(Value::Tables(codes.collect())),
            Some(Value::Tables(vec![graph])),
            None,
            Some(Value::Tables(self.buffers.clone())),
        ]);
        let mut bytes = vec![0; 4];
        bytes.extend(b"TFL3");
        let at = write(&mut bytes, &root);
        bytes[..4].copy_from_slice(&(at as u32).to_le_bytes());
        bytes
    }
}

/// Sides of a palm's box, in the 192 pixels of the palm network's input; the squares it finds are half as wide.
const PALM: f32 = 40.0;

/// Joints of the made-up hand, in the 224 pixels of the joint network's input from the middle of the red square: a hand
/// that points up, whose region is that of its palm.
const HAND: [[f32; 2]; 21] = [
    [0.0, 24.0],
    [-20.0, 5.0],
    [-30.0, -10.0],
    [-38.0, -25.0],
    [-40.0, -35.0],
    [-20.0, -40.0],
    [-20.0, -88.0],
    [-20.0, -110.0],
    [-20.0, -125.0],
    [0.0, -40.0],
    [0.0, -88.0],
    [0.0, -110.0],
    [0.0, -130.0],
    [20.0, -40.0],
    [20.0, -88.0],
    [20.0, -110.0],
    [20.0, -125.0],
    [40.0, -40.0],
    [40.0, -80.0],
    [40.0, -95.0],
    [40.0, -105.0],
];

/// Pixels of the palm network's input for one of the joint network's: a region is 2.6 times a palm's box.
const SCALE: f32 = 2.6 * PALM / 224.0;

const PLAIN: Sliding =
    Sliding { padding: Padding::Valid, stride: [1, 1], dilation: [1, 1], activation: Activation::None };

impl Writer {
    /// The mean of a colour in cells of `cell` pixels, for each of the first `colours` colours.
    fn cells(&mut self, input: usize, [side, cell, colours]: [usize; 3]) -> usize {
        let mut weights = Vec::with_capacity(colours * cell * cell * 3);
        for colour in 0..colours {
            let one = [0, 1, 2].map(|c| if c == colour { 1.0 / (cell * cell) as f32 } else { 0.0 });
            weights.extend(one.iter().copied().cycle().take(3 * cell * cell));
        }
        let weights = self.floats(&[colours, cell, cell, 3], &weights);
        let sliding = Sliding { stride: [cell, cell], ..PLAIN };
        let shape = [1, side / cell, side / cell, colours];
        self.operator(Operation::Conv(sliding), &[Some(input), Some(weights), None], &shape)
    }

    /// A matrix product; `weights` are `outputs` rows.
    fn product(&mut self, input: usize, weights: &[f32], bias: &[f32]) -> usize {
        let outputs = bias.len();
        let weights = self.floats(&[outputs, weights.len() / outputs], weights);
        let bias = self.floats(&[outputs], bias);
        let operation = Operation::FullyConnected(Activation::None);
        self.operator(operation, &[Some(input), Some(weights), Some(bias)], &[1, outputs])
    }
}

/// A network with the inputs and outputs of MediaPipe's palm detector. Its palms are upright and where cells of 8 or 16
/// pixels are more than half red.
pub fn palm_network() -> Vec<u8> {
    let mut w = Writer::new();
    let input = w.input(&[1, 192, 192, 3]);
    let points = [0, 5, 9, 13, 17, 1, 2].map(|joint| HAND[joint].map(|v| v * SCALE));
    let numbers: Vec<f32> = [0.0, 0.0, PALM, PALM].into_iter().chain(points.into_iter().flatten()).collect();
    let parts = [(8, 2), (16, 6)].map(|(cell, count)| {
        let side = 192 / cell;
        let red = w.cells(input, [192, cell, 1]);
        let anchors = side * side * count;
        let mut map = |weight: f32, bias: &[f32]| {
            let outputs = bias.len();
            let weights = w.floats(&[outputs, 1, 1, 1], &vec![weight; outputs]);
            let bias = w.floats(&[outputs], bias);
            let inputs = [Some(red), Some(weights), Some(bias)];
            let made = w.operator(Operation::Conv(PLAIN), &inputs, &[1, side, side, outputs]);
            w.operator(Operation::Reshape, &[Some(made)], &[1, anchors, outputs / count])
        };
        [map(0.0, &numbers.repeat(count)), map(20.0, &vec![-10.0; count])]
    });
    for (index, size) in [18, 1].into_iter().enumerate() {
        let inputs = parts.map(|part| Some(part[index]));
        let joined = w.operator(Operation::Concatenation(1), &inputs, &[1, 2016, size]);
        w.output(joined);
    }
    w.finish()
}

/// A network with the inputs and outputs of MediaPipe's hand landmark model. It finds a hand whose palm is the red
/// square in a region, if more than half of the square is there; a right one if the square is green, too.
pub fn joint_network() -> Vec<u8> {
    let mut w = Writer::new();
    let input = w.input(&[1, 224, 224, 3]);
    let cells = w.cells(input, [224, 16, 2]);
    let cells = w.operator(Operation::Reshape, &[Some(cells)], &[1, 14 * 14 * 2]);
    let whole = (PALM / 2.0 / SCALE / 16.0).powi(2);
    let colour = |colour: usize, weight: &dyn Fn(usize) -> f32| -> Vec<f32> {
        (0..14 * 14 * 2).map(|i| if i % 2 == colour { weight(i / 2) / whole } else { 0.0 }).collect()
    };
    let middle = |cell: usize| 16.0 * cell as f32 + 8.0;
    let axes = [colour(0, &|i| middle(i % 14)), colour(0, &|i| middle(i / 14)), vec![0.0; 14 * 14 * 2]];
    let places: Vec<f32> = HAND.iter().flat_map(|&[x, y]| [x, y, 0.0]).collect();
    let points = w.product(cells, &axes.concat().repeat(21), &places);
    w.output(points);
    for c in [0, 1] {
        let share = w.product(cells, &colour(c, &|_| 30.0), &[-15.0]);
        let probability = w.operator(Operation::Logistic, &[Some(share)], &[1, 1]);
        w.output(probability);
    }
    let metres: Vec<f32> = places.iter().map(|v| v * 1e-3).collect();
    let world = w.product(cells, &[0.0; 63 * 14 * 14 * 2], &metres);
    w.output(world);
    w.finish()
}

/// Fields of an operator's options, by the numbers of the schema.
fn options(operation: Operation) -> Vec<Option<Value>> {
    let activation = |a: Activation| {
        Some(Value::Byte(match a {
            Activation::None => 0,
            Activation::Relu => 1,
            Activation::ReluN1To1 => 2,
            Activation::Relu6 => 3,
        }))
    };
    let int = |v: usize| Some(Value::Int(v as i32));
    let moves = |s: &Sliding| {
        vec![Some(Value::Byte(u8::from(s.padding == Padding::Valid))), int(s.stride[1]), int(s.stride[0])]
    };
    match operation {
        Operation::Add(a) | Operation::FullyConnected(a) => vec![activation(a)],
        Operation::Concatenation(axis) => vec![Some(Value::Int(axis)), activation(Activation::None)],
        Operation::Conv(s) => {
            let rest = [activation(s.activation), int(s.dilation[1]), int(s.dilation[0])];
            moves(&s).into_iter().chain(rest).collect()
        }
        Operation::DepthwiseConv(s) => {
            let rest = [int(1), activation(s.activation), int(s.dilation[1]), int(s.dilation[0])];
            moves(&s).into_iter().chain(rest).collect()
        }
        Operation::MaxPool(s, kernel) => {
            let rest = [int(kernel[1]), int(kernel[0]), activation(s.activation)];
            moves(&s).into_iter().chain(rest).collect()
        }
        Operation::ResizeBilinear => vec![None, None, Some(Value::Byte(0)), Some(Value::Byte(1))],
        Operation::Dequantize
        | Operation::Logistic
        | Operation::Mean
        | Operation::Pad
        | Operation::Prelu
        | Operation::Reshape => Vec::new(),
    }
}

/// Appends a table with its vtable before and what it refers to behind it. Returns where it is.
fn write(bytes: &mut Vec<u8>, value: &Value) -> usize {
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    let start = bytes.len();
    let mut later = Vec::new();
    match value {
        Value::Table(fields) => {
            let count = fields.len();
            let vtable = (4 + 2 * count).next_multiple_of(4);
            let numbers = fields.iter().flatten().count();
            bytes.extend((4 + 2 * count as u16).to_le_bytes());
            bytes.extend((4 + 4 * numbers as u16).to_le_bytes());
            let mut offset = 0u16;
            for field in fields {
                offset += 4 * u16::from(field.is_some());
                bytes.extend(if field.is_some() { offset } else { 0 }.to_le_bytes());
            }
            bytes.resize(start + vtable, 0);
            bytes.extend((vtable as i32).to_le_bytes());
            for field in fields.iter().flatten() {
                match field {
                    Value::Byte(v) => bytes.extend([*v, 0, 0, 0]),
                    Value::Int(v) => bytes.extend(v.to_le_bytes()),
                    other => {
                        later.push((bytes.len(), other));
                        bytes.extend([0; 4]);
                    }
                }
            }
            refer(bytes, &later);
            return start + vtable;
        }
        Value::Tables(tables) => {
            bytes.extend((tables.len() as u32).to_le_bytes());
            for table in tables {
                later.push((bytes.len(), table));
                bytes.extend([0; 4]);
            }
        }
        Value::Ints(numbers) => {
            bytes.extend((numbers.len() as u32).to_le_bytes());
            bytes.extend(numbers.iter().flat_map(|n| n.to_le_bytes()));
        }
        Value::Bytes(data) => {
            bytes.extend((data.len() as u32).to_le_bytes());
            bytes.extend(data);
        }
        Value::Byte(_) | Value::Int(_) => {}
    }
    refer(bytes, &later);
    start
}

/// Appends what is referred to, and says so where it is.
fn refer(bytes: &mut Vec<u8>, later: &[(usize, &Value)]) {
    for (place, value) in later {
        let at = write(bytes, value);
        bytes[*place..place + 4].copy_from_slice(&((at - place) as u32).to_le_bytes());
    }
}
