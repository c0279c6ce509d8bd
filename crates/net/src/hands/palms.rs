//! Palms from the detector's numbers: anchors, decoding, non-maximum suppression.

use handcast_vision::sighting::overlap;

/// Side of the detector's input.
pub(super) const SIDE: usize = 192;
/// Numbers for each anchor: box centre and size, then seven points.
const NUMBERS: usize = 18;
const POINTS: usize = 7;
/// Boxes that overlap by more are of the same palm.
const SAME: f64 = 0.3;

/// A palm; places and sizes are shares of the detector's input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Palm {
    pub centre: [f64; 2],
    pub size: [f64; 2],
    /// Wrist; MCP of index, middle, ring, little finger; CMC and MCP of the thumb.
    pub points: [[f64; 2]; POINTS],
    pub score: f64,
}

impl Palm {
    fn bounds(&self) -> [[f64; 2]; 2] {
        [
            [0, 1].map(|i| self.centre[i] - self.size[i] / 2.0),
            [0, 1].map(|i| self.centre[i] + self.size[i] / 2.0),
        ]
    }
}

/// Centres of the anchors, as shares of the input: two in each cell of 8 pixels, six in each of 16.
pub(super) fn anchors() -> Vec<[f64; 2]> {
    let mut anchors = Vec::with_capacity(2016);
    for (stride, count) in [(8, 2), (16, 6)] {
        let cells = SIDE / stride;
        for cell in 0..cells * cells {
            let place = |i: usize| (i as f64 + 0.5) / cells as f64;
            anchors.extend(std::iter::repeat_n([place(cell % cells), place(cell / cells)], count));
        }
    }
    anchors
}

/// Finds palms in the detector's outputs, in memory kept from picture to picture.
#[derive(Clone, Debug)]
pub(super) struct Decoder {
    anchors: Vec<[f64; 2]>,
    found: Vec<Palm>,
    rest: Vec<Palm>,
}

impl Decoder {
    pub fn new() -> Self {
        let anchors = anchors();
        let room = || Vec::with_capacity(anchors.len());
        Self { found: room(), rest: room(), anchors }
    }

    /// The palms whose score is at least `least`, best first, each the mean of the boxes that overlap it, weighted by
    /// their scores.
    pub fn decode(&mut self, boxes: &[f32], scores: &[f32], least: f64, palms: &mut Vec<Palm>) {
        self.found.clear();
        let numbers = boxes.as_chunks::<NUMBERS>().0;
        for ((numbers, score), anchor) in numbers.iter().zip(scores).zip(&self.anchors) {
            let score = 1.0 / (1.0 + (-f64::from(*score).clamp(-100.0, 100.0)).exp());
            if score >= least {
                self.found.push(palm(numbers, *anchor, score));
            }
        }
        self.found.sort_unstable_by(|a, b| b.score.total_cmp(&a.score));
        palms.clear();
        while let Some(&best) = self.found.first() {
            self.rest.clear();
            let mut sum = Palm { centre: [0.0; 2], size: [0.0; 2], points: [[0.0; 2]; POINTS], score: 0.0 };
            for other in &self.found {
                if overlap(best.bounds(), other.bounds()) > SAME {
                    accumulate(&mut sum, other);
                } else {
                    self.rest.push(*other);
                }
            }
            if sum.score > 0.0 {
                palms.push(mean(&sum, best.score));
            } else {
                // A box without area overlaps nothing, itself included.
                palms.push(best);
                self.rest.retain(|other| *other != best);
            }
            std::mem::swap(&mut self.found, &mut self.rest);
        }
    }
}

fn palm(numbers: &[f32; NUMBERS], anchor: [f64; 2], score: f64) -> Palm {
    let share = |i: usize| f64::from(numbers[i]) / SIDE as f64;
    let place = |i: usize| [share(i) + anchor[0], share(i + 1) + anchor[1]];
    Palm {
        centre: place(0),
        size: [share(2), share(3)],
        points: std::array::from_fn(|p| place(4 + 2 * p)),
        score,
    }
}

fn accumulate(sum: &mut Palm, palm: &Palm) {
    let weight = palm.score;
    sum.score += weight;
    for i in 0..2 {
        sum.centre[i] += weight * palm.centre[i];
        sum.size[i] += weight * palm.size[i];
        for (sum, point) in sum.points.iter_mut().zip(&palm.points) {
            sum[i] += weight * point[i];
        }
    }
}

fn mean(sum: &Palm, score: f64) -> Palm {
    let share = |v: f64| v / sum.score;
    Palm {
        centre: sum.centre.map(share),
        size: sum.size.map(share),
        points: sum.points.map(|point| point.map(share)),
        score,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn anchors_are_as_many_as_the_detector_s_outputs() {
        let anchors = anchors();
        assert_eq!(anchors.len(), 2016);
        assert_eq!(anchors[0], [0.5 / 24.0, 0.5 / 24.0]);
        assert_eq!(anchors[2], [1.5 / 24.0, 0.5 / 24.0]);
        assert_eq!(anchors[24 * 24 * 2 + 6], [1.5 / 12.0, 0.5 / 12.0]);
    }

    /// Outputs with boxes of the given anchors: offset of the centre in pixels, side, score before the sigmoid.
    fn decode(given: &[(usize, f32, f32, f32)]) -> Vec<Palm> {
        let mut boxes = vec![0.0; 2016 * NUMBERS];
        let mut scores = vec![-50.0; 2016];
        for &(anchor, offset, side, score) in given {
            boxes[anchor * NUMBERS] = offset;
            boxes[anchor * NUMBERS + 2] = side;
            boxes[anchor * NUMBERS + 3] = side;
            scores[anchor] = score;
        }
        let mut palms = Vec::new();
        Decoder::new().decode(&boxes, &scores, 0.5, &mut palms);
        palms
    }

    #[test]
    fn boxes_of_one_palm_are_averaged_by_score() {
        let palms = decode(&[
            (0, 0.0, 20.0, 2.0),
            (1, 6.0, 20.0, 1.0),
            (1000, 0.0, 20.0, 3.0),
            (500, 0.0, 9.0, -1.0),
        ]);
        assert_eq!(palms.len(), 2);
        let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
        assert!((palms[0].score - sigmoid(3.0)).abs() < 1e-12);
        assert!((palms[1].score - sigmoid(2.0)).abs() < 1e-12);
        let shift = 6.0 * sigmoid(1.0) / (sigmoid(1.0) + sigmoid(2.0));
        assert!((palms[1].centre[0] * 192.0 - (4.0 + shift)).abs() < 1e-9);
    }

    #[test]
    fn boxes_without_area_end() {
        assert_eq!(decode(&[(0, 0.0, 0.0, 2.0), (1, 0.0, 0.0, 2.0), (9, 0.0, -3.0, 1.0)]).len(), 2);
    }
}
