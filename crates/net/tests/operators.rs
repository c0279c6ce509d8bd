//! Every operator, alone and joined to others, against loops that do what the operator's definition says.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::HashMap;

use handcast_net::Network;
use handcast_net::model::{Activation, Operation, Padding, Sliding};
use handcast_net::testing::Writer;
use proptest::prelude::*;

/// A network and what it should compute, built together.
struct Twin {
    writer: Writer,
    values: HashMap<usize, (Vec<usize>, Vec<f32>)>,
    input: Vec<f32>,
    outputs: Vec<usize>,
    /// The largest sum before an activation: numbers are rounded in proportion to it, whatever is cut off later.
    largest: f64,
    seed: u32,
}

fn relu(activation: Activation, x: f32) -> f32 {
    let (low, high) = activation.range();
    x.max(low).min(high)
}

/// Size of the result and border before, along one axis.
fn slide(size: usize, kernel: usize, stride: usize, dilation: usize, padding: Padding) -> (usize, isize) {
    let reach = (kernel - 1) * dilation + 1;
    match padding {
        Padding::Valid => ((size - reach) / stride + 1, 0),
        Padding::Same => {
            let out = size.div_ceil(stride);
            (out, ((out - 1) * stride + reach).saturating_sub(size) as isize / 2)
        }
    }
}

impl Twin {
    fn new(shape: &[usize], seed: u32) -> (Self, usize) {
        let mut twin = Self {
            writer: Writer::new(),
            values: HashMap::new(),
            input: Vec::new(),
            outputs: Vec::new(),
            largest: 1.0,
            seed: seed | 1,
        };
        let input = twin.writer.input(shape);
        twin.input = twin.random(shape.iter().product());
        twin.values.insert(input, (shape.to_vec(), twin.input.clone()));
        (twin, input)
    }

    /// Numbers from -2 to 2 that 16-bit floats hold exactly.
    fn random(&mut self, count: usize) -> Vec<f32> {
        (0..count)
            .map(|_| {
                self.seed ^= self.seed << 13;
                self.seed ^= self.seed >> 17;
                self.seed ^= self.seed << 5;
                (self.seed % 257) as f32 / 64.0 - 2.0
            })
            .collect()
    }

    fn activated(&mut self, activation: Activation, sum: f64) -> f32 {
        self.largest = self.largest.max(sum.abs());
        relu(activation, sum as f32)
    }

    fn value(&self, tensor: usize) -> (Vec<usize>, Vec<f32>) {
        self.values[&tensor].clone()
    }

    fn made(&mut self, operation: Operation, inputs: &[usize], shape: &[usize], value: Vec<f32>) -> usize {
        let inputs: Vec<Option<usize>> = inputs.iter().map(|&i| Some(i)).collect();
        let tensor = self.writer.operator(operation, &inputs, shape);
        self.values.insert(tensor, (shape.to_vec(), value));
        tensor
    }

    fn convolution(&mut self, input: usize, outputs: usize, kernel: [usize; 2], sliding: Sliding) -> usize {
        let (shape, x) = self.value(input);
        let (rows, columns, channels) = (shape[1], shape[2], shape[3]);
        let weights = self.random(outputs * kernel[0] * kernel[1] * channels);
        let bias = self.random(outputs);
        let w = self.writer.halves(&[outputs, kernel[0], kernel[1], channels], &weights);
        let b = self.writer.floats(&[outputs], &bias);
        let Sliding { stride, dilation, padding, activation } = sliding;
        let (out_rows, top) = slide(rows, kernel[0], stride[0], dilation[0], padding);
        let (out_columns, left) = slide(columns, kernel[1], stride[1], dilation[1], padding);
        let mut made = Vec::new();
        for row in 0..out_rows {
            for column in 0..out_columns {
                for o in 0..outputs {
                    let mut sum = f64::from(bias[o]);
                    for i in 0..kernel[0] {
                        for j in 0..kernel[1] {
                            let y = (row * stride[0] + i * dilation[0]) as isize - top;
                            let z = (column * stride[1] + j * dilation[1]) as isize - left;
                            if y < 0 || z < 0 || y >= rows as isize || z >= columns as isize {
                                continue;
                            }
                            for c in 0..channels {
                                let at = (y as usize * columns + z as usize) * channels + c;
                                let weight = weights[((o * kernel[0] + i) * kernel[1] + j) * channels + c];
                                sum += f64::from(x[at]) * f64::from(weight);
                            }
                        }
                    }
                    made.push(self.activated(activation, sum));
                }
            }
        }
        let shape = [1, out_rows, out_columns, outputs];
        self.made(Operation::Conv(sliding), &[input, w, b], &shape, made)
    }

    fn depthwise(&mut self, input: usize, kernel: [usize; 2], sliding: Sliding) -> usize {
        let (shape, x) = self.value(input);
        let (rows, columns, channels) = (shape[1], shape[2], shape[3]);
        let weights = self.random(kernel[0] * kernel[1] * channels);
        let bias = self.random(channels);
        let w = self.writer.halves(&[1, kernel[0], kernel[1], channels], &weights);
        let b = self.writer.halves(&[channels], &bias);
        let Sliding { stride, dilation, padding, activation } = sliding;
        let (out_rows, top) = slide(rows, kernel[0], stride[0], dilation[0], padding);
        let (out_columns, left) = slide(columns, kernel[1], stride[1], dilation[1], padding);
        let mut made = Vec::new();
        for row in 0..out_rows {
            for column in 0..out_columns {
                for c in 0..channels {
                    let mut sum = f64::from(bias[c]);
                    for i in 0..kernel[0] {
                        for j in 0..kernel[1] {
                            let y = (row * stride[0] + i * dilation[0]) as isize - top;
                            let z = (column * stride[1] + j * dilation[1]) as isize - left;
                            if y >= 0 && z >= 0 && y < rows as isize && z < columns as isize {
                                let at = (y as usize * columns + z as usize) * channels + c;
                                let weight = weights[(i * kernel[1] + j) * channels + c];
                                sum += f64::from(x[at]) * f64::from(weight);
                            }
                        }
                    }
                    made.push(self.activated(activation, sum));
                }
            }
        }
        let shape = [1, out_rows, out_columns, channels];
        self.made(Operation::DepthwiseConv(sliding), &[input, w, b], &shape, made)
    }

    fn max_pool(&mut self, input: usize, kernel: [usize; 2], sliding: Sliding) -> usize {
        let (shape, x) = self.value(input);
        let (rows, columns, channels) = (shape[1], shape[2], shape[3]);
        let (out_rows, top) = slide(rows, kernel[0], sliding.stride[0], 1, sliding.padding);
        let (out_columns, left) = slide(columns, kernel[1], sliding.stride[1], 1, sliding.padding);
        let mut made = Vec::new();
        for row in 0..out_rows {
            for column in 0..out_columns {
                for c in 0..channels {
                    let mut most = f32::NEG_INFINITY;
                    for i in 0..kernel[0] {
                        for j in 0..kernel[1] {
                            let y = (row * sliding.stride[0] + i) as isize - top;
                            let z = (column * sliding.stride[1] + j) as isize - left;
                            if y >= 0 && z >= 0 && y < rows as isize && z < columns as isize {
                                most = most.max(x[(y as usize * columns + z as usize) * channels + c]);
                            }
                        }
                    }
                    made.push(relu(sliding.activation, most));
                }
            }
        }
        let shape = [1, out_rows, out_columns, channels];
        self.made(Operation::MaxPool(sliding, kernel), &[input], &shape, made)
    }

    fn add(&mut self, a: usize, b: usize, activation: Activation) -> usize {
        let (shape, x) = self.value(a);
        let made = x.iter().zip(&self.values[&b].1).map(|(x, y)| relu(activation, x + y)).collect();
        self.made(Operation::Add(activation), &[a, b], &shape, made)
    }

    fn prelu(&mut self, input: usize) -> usize {
        let (shape, x) = self.value(input);
        let channels = shape[shape.len() - 1];
        let slopes = self.random(channels);
        let tensor = self.writer.halves(&[1, 1, channels], &slopes);
        let made =
            x.iter().enumerate().map(|(i, &x)| if x < 0.0 { x * slopes[i % channels] } else { x }).collect();
        self.made(Operation::Prelu, &[input, tensor], &shape, made)
    }

    fn pad(&mut self, input: usize, amounts: [[usize; 2]; 4]) -> usize {
        let (shape, x) = self.value(input);
        let padded: Vec<usize> = shape.iter().zip(amounts).map(|(s, [a, b])| s + a + b).collect();
        let mut made = vec![0.0; padded.iter().product()];
        for (i, x) in x.iter().enumerate() {
            let (mut rest, mut at, mut step) = (i, 0, 1);
            for axis in (0..4).rev() {
                at += (rest % shape[axis] + amounts[axis][0]) * step;
                step *= padded[axis];
                rest /= shape[axis];
            }
            made[at] = *x;
        }
        let flat: Vec<i32> = amounts.iter().flatten().map(|&v| v as i32).collect();
        let tensor = self.writer.integers(&[4, 2], &flat);
        self.made(Operation::Pad, &[input, tensor], &padded, made)
    }

    fn resize(&mut self, input: usize, rows: usize, columns: usize) -> usize {
        let (shape, x) = self.value(input);
        let [_, h, w, channels] = shape[..] else { panic!("a picture") };
        let mut made = Vec::new();
        let sample = |i: usize, to: usize, from: usize| {
            let at = ((i as f64 + 0.5) * from as f64 / to as f64 - 0.5).clamp(0.0, from as f64 - 1.0);
            (at.floor() as usize, (at.floor() as usize + 1).min(from - 1), at - at.floor())
        };
        for row in 0..rows {
            let (top, bottom, down) = sample(row, rows, h);
            for column in 0..columns {
                let (left, right, over) = sample(column, columns, w);
                for c in 0..channels {
                    let at = |y: usize, z: usize| f64::from(x[(y * w + z) * channels + c]);
                    let upper = at(top, left) * (1.0 - over) + at(top, right) * over;
                    let lower = at(bottom, left) * (1.0 - over) + at(bottom, right) * over;
                    made.push((upper * (1.0 - down) + lower * down) as f32);
                }
            }
        }
        let size = self.writer.integers(&[2], &[rows as i32, columns as i32]);
        self.made(Operation::ResizeBilinear, &[input, size], &[1, rows, columns, channels], made)
    }

    fn mean(&mut self, input: usize) -> usize {
        let (shape, x) = self.value(input);
        let channels = shape[3];
        let pixels = x.len() / channels;
        let made = (0..channels)
            .map(|c| x.iter().skip(c).step_by(channels).map(|&x| f64::from(x)).sum::<f64>() / pixels as f64)
            .map(|x| x as f32)
            .collect();
        let axes = self.writer.integers(&[2], &[1, 2]);
        self.made(Operation::Mean, &[input, axes], &[1, channels], made)
    }

    fn fully_connected(&mut self, input: usize, outputs: usize, activation: Activation) -> usize {
        let (_, x) = self.value(input);
        let weights = self.random(outputs * x.len());
        let bias = self.random(outputs);
        let w = self.writer.halves(&[outputs, x.len()], &weights);
        let b = self.writer.floats(&[outputs], &bias);
        let made = (0..outputs)
            .map(|o| {
                let row = &weights[o * x.len()..][..x.len()];
                let sum = x.iter().zip(row).map(|(x, w)| f64::from(*x) * f64::from(*w)).sum::<f64>();
                self.activated(activation, sum + f64::from(bias[o]))
            })
            .collect();
        self.made(Operation::FullyConnected(activation), &[input, w, b], &[1, outputs], made)
    }

    fn logistic(&mut self, input: usize) -> usize {
        let (shape, x) = self.value(input);
        let made = x.iter().map(|&x| (1.0 / (1.0 + f64::from(-x).exp())) as f32).collect();
        self.made(Operation::Logistic, &[input], &shape, made)
    }

    fn reshape(&mut self, input: usize, shape: &[usize]) -> usize {
        let (_, x) = self.value(input);
        self.made(Operation::Reshape, &[input], shape, x)
    }

    fn concatenation(&mut self, inputs: &[usize], axis: usize) -> usize {
        let values: Vec<_> = inputs.iter().map(|&i| self.value(i)).collect();
        let mut shape = values[0].0.clone();
        shape[axis] = values.iter().map(|v| v.0[axis]).sum();
        let outer: usize = shape[..axis].iter().product();
        let mut made = Vec::new();
        for i in 0..outer {
            for (shape, x) in &values {
                let run: usize = shape[axis..].iter().product();
                made.extend(&x[i * run..(i + 1) * run]);
            }
        }
        self.made(Operation::Concatenation(axis as i32), inputs, &shape, made)
    }

    fn output(&mut self, tensor: usize) {
        self.writer.output(tensor);
        self.outputs.push(tensor);
    }

    /// Runs the network twice, as what one run leaves in memory must not change the next.
    fn check(self) {
        let mut network = Network::read(&self.writer.finish()).unwrap();
        for _ in 0..2 {
            network.input_mut(0).unwrap().copy_from_slice(&self.input);
            network.run().unwrap();
        }
        for (number, tensor) in self.outputs.iter().enumerate() {
            let (_, expected) = &self.values[tensor];
            let found = network.output(number).unwrap();
            assert_eq!(expected.len(), found.len());
            let most = 1e-5 * self.largest;
            for (i, (a, b)) in expected.iter().zip(found).enumerate() {
                assert!(f64::from(a - b).abs() <= most, "output {number}, number {i}: {b} instead of {a}");
            }
        }
    }
}

fn sliding(stride: [usize; 2], padding: Padding, activation: Activation) -> Sliding {
    Sliding { padding, stride, dilation: [1, 1], activation }
}

const PLAIN: Sliding =
    Sliding { padding: Padding::Same, stride: [1, 1], dilation: [1, 1], activation: Activation::None };

fn activations() -> impl Strategy<Value = Activation> {
    prop::sample::select(vec![Activation::None, Activation::Relu, Activation::ReluN1To1, Activation::Relu6])
}

fn paddings() -> impl Strategy<Value = Padding> {
    prop::sample::select(vec![Padding::Same, Padding::Valid])
}

/// Rows, columns and channels on both sides of the widths of registers and tiles.
fn pictures() -> impl Strategy<Value = [usize; 3]> {
    (1..20usize, 1..20usize, prop_oneof![1..50usize, Just(64usize)]).prop_map(|(h, w, c)| [h, w, c])
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn convolution(
        [rows, columns, channels] in pictures(), outputs in 1..70usize, kernel in [1..5usize, 1..5usize],
        stride in [1..4usize, 1..4usize], dilation in [1..3usize, 1..3usize], padding in paddings(),
        activation in activations(), seed: u32,
    ) {
        let reach = [0, 1].map(|i| (kernel[i] - 1) * dilation[i] + 1);
        prop_assume!(padding == Padding::Same || (rows >= reach[0] && columns >= reach[1]));
        let (mut twin, x) = Twin::new(&[1, rows, columns, channels], seed);
        let y = twin.convolution(x, outputs, kernel, Sliding { padding, stride, dilation, activation });
        twin.output(y);
        twin.check();
    }

    #[test]
    fn depthwise_convolution(
        [rows, columns, channels] in pictures(), size in prop_oneof![Just([3, 3]), Just([5, 5]), [1..6usize, 1..6usize]],
        stride in prop_oneof![Just([1, 1]), Just([2, 2]), [1..4usize, 1..4usize]],
        dilation in prop_oneof![Just([1, 1]), [1..3usize, 1..3usize]], padding in paddings(),
        activation in activations(), seed: u32,
    ) {
        let reach = [0, 1].map(|i| (size[i] - 1) * dilation[i] + 1);
        prop_assume!(padding == Padding::Same || (rows >= reach[0] && columns >= reach[1]));
        let (mut twin, x) = Twin::new(&[1, rows, columns, channels], seed);
        let y = twin.depthwise(x, size, Sliding { padding, stride, dilation, activation });
        twin.output(y);
        twin.check();
    }

    #[test]
    fn depthwise_joined_to_convolutions(
        [rows, columns, channels] in pictures(), wide in prop_oneof![1..60usize, Just(672usize)],
        size in prop_oneof![Just(3usize), Just(5)], stride in 1..3usize, outputs in 1..50usize, inner in activations(),
        slopes: bool, twice: bool, seed: u32,
    ) {
        let (mut twin, x) = Twin::new(&[1, rows, columns, channels], seed);
        let a = twin.convolution(x, wide, [1, 1], sliding([1, 1], Padding::Same, inner));
        let b = twin.depthwise(a, [size, size], sliding([stride, stride], Padding::Same, Activation::None));
        let b = if slopes { twin.prelu(b) } else { b };
        let c = twin.convolution(b, outputs, [1, 1], PLAIN);
        twin.output(c);
        if twice {
            twin.output(a);
        }
        twin.check();
    }

    #[test]
    fn additions_and_slopes_joined_to_convolutions(
        [rows, columns, channels] in pictures(), kernel in [1..4usize, 1..4usize], own in activations(),
        activation in activations(), slopes: bool, order: bool, depthwise: bool, seed: u32,
    ) {
        let (mut twin, x) = Twin::new(&[1, rows, columns, channels], seed);
        let a = if depthwise { twin.depthwise(x, [3, 3], PLAIN) } else { x };
        let a = twin.convolution(a, channels, kernel, sliding([1, 1], Padding::Same, own));
        let b = if order { twin.add(a, x, activation) } else { twin.add(x, a, activation) };
        let b = if slopes { twin.prelu(b) } else { b };
        twin.output(b);
        twin.check();
    }

    #[test]
    fn max_pool(
        [rows, columns, channels] in pictures(), kernel in [1..4usize, 1..4usize], stride in [1..4usize, 1..4usize],
        padding in paddings(), activation in activations(), seed: u32,
    ) {
        prop_assume!(padding == Padding::Same || (rows >= kernel[0] && columns >= kernel[1]));
        let (mut twin, x) = Twin::new(&[1, rows, columns, channels], seed);
        let y = twin.max_pool(x, kernel, sliding(stride, padding, activation));
        twin.output(y);
        twin.check();
    }

    #[test]
    fn a_residual_with_more_channels([rows, columns, channels] in pictures(), more in 0..20usize, seed: u32) {
        let (mut twin, x) = Twin::new(&[1, 2 * rows, 2 * columns, channels], seed);
        let a = twin.depthwise(x, [5, 5], sliding([2, 2], Padding::Same, Activation::None));
        let a = twin.convolution(a, channels + more, [1, 1], PLAIN);
        let b = twin.max_pool(x, [2, 2], sliding([2, 2], Padding::Same, Activation::None));
        let b = twin.pad(b, [[0, 0], [0, 0], [0, 0], [0, more]]);
        let c = twin.add(b, a, Activation::None);
        let c = twin.prelu(c);
        twin.output(c);
        twin.check();
    }

    #[test]
    fn pad([rows, columns, channels] in pictures(), amounts in [[0..3usize, 0..3usize], [0..3usize, 0..3usize]], seed: u32) {
        let (mut twin, x) = Twin::new(&[1, rows, columns, channels], seed);
        let y = twin.pad(x, [[0, 0], amounts[0], amounts[1], [1, 2]]);
        twin.output(y);
        twin.check();
    }

    #[test]
    fn resize([rows, columns, channels] in pictures(), to in [1..40usize, 1..40usize], seed: u32) {
        let (mut twin, x) = Twin::new(&[1, rows, columns, channels], seed);
        let y = twin.resize(x, to[0], to[1]);
        twin.output(y);
        twin.check();
    }

    #[test]
    fn slopes_and_additions_alone([rows, columns, channels] in pictures(), activation in activations(), seed: u32) {
        let (mut twin, x) = Twin::new(&[1, rows, columns, channels], seed);
        let a = twin.prelu(x);
        let b = twin.add(a, x, activation);
        let c = twin.add(b, b, Activation::None);
        twin.output(c);
        twin.output(b);
        twin.check();
    }

    #[test]
    fn heads([rows, columns, channels] in pictures(), outputs in 1..70usize, activation in activations(), seed: u32) {
        let (mut twin, x) = Twin::new(&[1, rows, columns, channels], seed);
        let mean = twin.mean(x);
        let y = twin.fully_connected(mean, outputs, activation);
        let z = twin.fully_connected(mean, 1, Activation::None);
        let z = twin.logistic(z);
        twin.output(y);
        twin.output(z);
        twin.check();
    }

    #[test]
    fn anchors([rows, columns, channels] in pictures(), sizes in [1..20usize, 1..20usize], seed: u32) {
        let (mut twin, x) = Twin::new(&[1, rows, columns, channels], seed);
        let parts = sizes.map(|size| {
            let y = twin.convolution(x, 2 * size, [1, 1], PLAIN);
            let half = rows * columns * 2;
            let y = twin.reshape(y, &[1, half, size]);
            twin.pad_free(y)
        });
        let joined = twin.concatenation(&parts, 2);
        let again = twin.concatenation(&[joined, joined], 1);
        twin.output(joined);
        twin.output(again);
        twin.check();
    }
}

impl Twin {
    /// A result that is read twice, so that nothing is joined to it.
    fn pad_free(&mut self, tensor: usize) -> usize {
        let (shape, _) = self.value(tensor);
        self.reshape(tensor, &shape)
    }
}
