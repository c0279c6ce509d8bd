//! Skin weights: which joints carry a point of the skin in the bind pose.

use nalgebra::{Point3, Vector3};

use super::field::Part;
use crate::{Finger, HandFrames, Joint, Morphology};

/// Weights of all joints for one vertex, before the four largest are kept.
pub(super) type Row = [f32; Joint::COUNT];

/// One finger's bones from the wrist to the tip, in the bind pose.
struct Chain {
    /// Joint that carries the skin before each station, and after the last.
    joints: Vec<Joint>,
    stations: Vec<Station>,
    bones: Vec<Bone>,
    /// Where the finger leaves the palm: origin, direction and length of its first free bone.
    free: (Point3<f64>, Vector3<f64>, f64),
    /// Reach of shared skin in the palm and on the free finger, metres.
    reach: [f64; 2],
}

/// Where one bone hands over to the next.
struct Station {
    centre: Point3<f64>,
    along: Vector3<f64>,
    /// Out of the palmar side.
    palmar: Vector3<f64>,
    /// Half the length of the transition on the palmar and on the dorsal side.
    band: [f64; 2],
    radius: f64,
}

struct Bone {
    from: Point3<f64>,
    along: Vector3<f64>,
    length: f64,
    radii: [f64; 2],
}

impl Bone {
    /// Distance to the bone's flesh.
    fn distance(&self, p: &Point3<f64>) -> f64 {
        let ap = p - self.from;
        let t = ap.dot(&self.along).clamp(0.0, self.length);
        let share = t / self.length.max(1e-12);
        (ap - self.along * t).norm() - (self.radii[0] + (self.radii[1] - self.radii[0]) * share)
    }
}

fn smooth_step(from: f64, to: f64, x: f64) -> f64 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

impl Chain {
    fn new(m: &Morphology, frames: &HandFrames, finger: Finger) -> Self {
        let f = m.finger(finger);
        let unit = m.hand_length;
        let joints = Joint::of(finger);
        let thumb = finger == Finger::Thumb;
        let mut radii = f.radii.to_vec();
        if !thumb {
            radii.insert(0, 0.9 * m.palm_radius);
        }
        let points: Vec<_> = joints.iter().map(|&j| frames.position(j)).collect();
        let bones: Vec<_> = points
            .windows(2)
            .zip(radii.windows(2))
            .map(|(p, r)| {
                let along = p[1] - p[0];
                let length = along.norm();
                Bone { from: p[0], along: along / length.max(1e-12), length, radii: [r[0], r[1]] }
            })
            .collect();
        let mut stations = Vec::new();
        for (k, bone) in bones.iter().enumerate() {
            let before = if k == 0 { Vector3::y() } else { bones[k - 1].along };
            let radius = radii[k];
            // Sharp on the back of the fingers' own joints, which would cave in otherwise, and in the crease of the thumb's
            // knuckle, so that the web stays out of its flesh. The skin of the other knuckles comes from farther, and a sharp
            // crease of theirs would fold into itself.
            let band = match k {
                0 => [0.075 * unit; 2],
                1 if thumb => [0.35 * radius, 0.9 * radius],
                1 => [1.8 * radius, 1.6 * radius],
                _ => [0.75 * radius, 0.65 * radius],
            };
            stations.push(Station {
                centre: points[k],
                along: (before + bone.along).normalize(),
                palmar: frames.get(joints[k]) * Vector3::z(),
                band,
                radius,
            });
        }
        let root = usize::from(!thumb);
        let mut carriers = vec![Joint::Wrist];
        carriers.extend(&joints[..joints.len() - 1]);
        let free_bone = if thumb { &bones[1] } else { &bones[root] };
        Self {
            joints: carriers,
            free: (free_bone.from, free_bone.along, free_bone.length),
            stations,
            bones,
            reach: [if thumb { 0.091 } else { 0.065 } * unit, 0.010 * unit],
        }
    }

    fn distance(&self, p: &Point3<f64>) -> f64 {
        self.bones.iter().map(|b| b.distance(p)).fold(f64::MAX, f64::min)
    }

    /// Over what difference of distances this finger shares skin with its neighbours at `p`.
    fn reach_at(&self, p: &Point3<f64>) -> f64 {
        let (from, along, length) = &self.free;
        let free = smooth_step(-0.05, 0.45, (p - from).dot(along) / length.max(1e-12));
        self.reach[0] + (self.reach[1] - self.reach[0]) * free
    }

    /// Adds `share` of the vertex to the joints along this finger.
    fn add(&self, p: &Point3<f64>, share: f64, row: &mut Row) {
        let mut passed = share;
        for (station, joint) in self.stations.iter().zip(&self.joints) {
            let q = p - station.centre;
            let side = smooth_step(-0.7, 0.7, q.dot(&station.palmar) / station.radius.max(1e-12));
            let band = station.band[1] + (station.band[0] - station.band[1]) * side;
            let beyond = passed * smooth_step(-band, band, q.dot(&station.along));
            row[joint.index()] += (passed - beyond) as f32;
            passed = beyond;
        }
        if let Some(last) = self.joints.last() {
            row[last.index()] += passed as f32;
        }
    }
}

/// Weights of every point around the joints `frames` of a right hand, smoothed over the triangles. Points that `parts`
/// gives to a finger are carried by it alone.
pub(super) fn rows(
    m: &Morphology,
    frames: &HandFrames,
    points: &[Point3<f64>],
    parts: &[Part],
    triangles: &[[u32; 3]],
) -> Vec<Row> {
    let chains = Finger::ALL.map(|f| Chain::new(m, frames, f));
    let mut rows: Vec<Row> = points
        .iter()
        .zip(parts)
        .map(|(p, part)| {
            if let Part::Finger(finger) = part {
                let mut row = [0.0; Joint::COUNT];
                chains[*finger as usize].add(p, 1.0, &mut row);
                return row;
            }
            let distances: [f64; 5] = std::array::from_fn(|i| chains[i].distance(p));
            let (nearest, least) = distances
                .iter()
                .copied()
                .enumerate()
                .fold((0, f64::MAX), |best, (i, d)| if d < best.1 { (i, d) } else { best });
            let reach = chains[nearest].reach_at(p);
            let shares = distances.map(|d| (1.0 - (d - least) / reach).max(0.0).powi(2));
            let total: f64 = shares.iter().sum();
            let mut row = [0.0; Joint::COUNT];
            for (chain, share) in chains.iter().zip(shares) {
                if share > 0.0 {
                    chain.add(p, share / total, &mut row);
                }
            }
            row
        })
        .collect();
    smooth(&mut rows, triangles, 6, |_| true);
    // More of it would carry a knuckle's back along with its neighbours.
    smooth(&mut rows, triangles, 4, |i| parts[i] == Part::Palm);
    rows
}

/// Averages each row of `which` with its neighbours': transitions follow the skin, never jump a gap.
fn smooth(rows: &mut [Row], triangles: &[[u32; 3]], passes: usize, which: impl Fn(usize) -> bool) {
    for _ in 0..passes {
        let mut sums = vec![([0.0f32; Joint::COUNT], 0.0f32); rows.len()];
        for t in triangles {
            for k in 0..3 {
                let (here, next) = (t[k] as usize, t[(k + 1) % 3] as usize);
                for (sum, value) in sums[here].0.iter_mut().zip(&rows[next]) {
                    *sum += value;
                }
                sums[here].1 += 1.0;
            }
        }
        for (_, (row, (sum, count))) in rows.iter_mut().zip(&sums).enumerate().filter(|(i, _)| which(*i)) {
            for (value, s) in row.iter_mut().zip(sum) {
                *value = 0.6 * *value + 0.4 * s / count.max(1.0);
            }
        }
    }
}

/// The four largest weights as multiples of 2⁻¹⁶ that add up to exactly 1, largest first; joints of
/// weight 0 are 0.
pub(super) fn strongest(row: &Row) -> ([u8; 4], [f32; 4]) {
    const ONE: f32 = 65536.0;
    let mut order: [u8; Joint::COUNT] = std::array::from_fn(|i| i as u8);
    order.sort_by(|&a, &b| row[usize::from(b)].total_cmp(&row[usize::from(a)]));
    let top: [u8; 4] = std::array::from_fn(|i| order[i]);
    let values = top.map(|j| row[usize::from(j)].max(0.0));
    let total: f32 = values.iter().sum();
    let mut weights = values.map(|v| if total > 0.0 { (v / total * ONE).round() } else { 0.0 });
    // Whatever rounding left over goes to the largest.
    weights[0] = ONE - weights[1] - weights[2] - weights[3];
    let joints = std::array::from_fn(|i| if weights[i] > 0.0 { top[i] } else { 0 });
    (joints, weights.map(|w| w / ONE))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn strongest_weights_add_up_to_exactly_one(values in prop::collection::vec(0.0f32..1.0, 25)) {
            let row: Row = std::array::from_fn(|i| values[i]);
            let (joints, weights) = strongest(&row);
            prop_assert_eq!(weights.iter().sum::<f32>(), 1.0);
            prop_assert!(weights.windows(2).all(|w| w[0] >= w[1] - 1e-4));
            for (j, w) in joints.iter().zip(weights) {
                prop_assert!(w > 0.0 || *j == 0);
            }
        }
    }
}
