//! What bending leaves of a finger: how thick the shown surface is through a joint, and how much flesh it holds.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use handcast_hand::{
    Finger, HandMesh, HandPose, Joint, JointAngle, Morphology, Side, Skeleton, SkinnedSurface,
};
use nalgebra::{Point3, Vector3};

type V = Vector3<f64>;

/// Most that a bent joint may lose of its thickness, its section and the depth of its back, and the hand of its volume.
const MOST: f64 = 0.05;

/// Most that a joint may be thicker or thinner half way there.
const MOST_HALF_WAY: f64 = 0.11;

/// The plane halfway between the bones of a joint: what lies in it.
#[derive(Clone, Copy, Debug)]
struct Section {
    /// From the joint to the skin of the back and to that of the palmar side, metres.
    dorsal: f64,
    palmar: f64,
    /// Of three quarters of the finger's breadth, square metres.
    area: f64,
}

impl Section {
    fn thickness(&self) -> f64 {
        self.dorsal + self.palmar
    }

    /// What a bent joint has more of than this straight one, shares: depth of the back, thickness, area.
    fn gains(&self, bent: &Section) -> [f64; 3] {
        let shares = [bent.dorsal / self.dorsal, bent.thickness() / self.thickness(), bent.area / self.area];
        shares.map(|share| share - 1.0)
    }
}

struct Hand {
    morphology: Morphology,
    mesh: HandMesh,
    skeleton: Skeleton,
}

impl Hand {
    fn new(morphology: Morphology) -> Self {
        let mesh = HandMesh::generate(&morphology, Side::Right);
        let skeleton = Skeleton::new(&morphology, Side::Right);
        Self { morphology, mesh, skeleton }
    }

    fn points(&self, pose: &HandPose) -> Vec<V> {
        let mut skin = SkinnedSurface::default();
        self.mesh.skin(&self.skeleton.frames(pose), &mut skin);
        skin.positions.iter().map(|p| V::from(p.map(f64::from))).collect()
    }

    fn volume(&self, pose: &HandPose) -> f64 {
        let points = self.points(pose);
        let corners = |t: &[u32; 3]| t.map(|i| points[i as usize]);
        self.mesh.triangles.iter().map(corners).map(|[a, b, c]| a.dot(&b.cross(&c)) / 6.0).sum()
    }

    /// Of a joint, by its place among the last four of its finger.
    fn section(&self, pose: &HandPose, finger: Finger, joint: usize) -> Section {
        let points = self.points(pose);
        let joints = Joint::of(finger);
        let joints = &joints[joints.len() - 4..];
        let frames = self.skeleton.frames(pose);
        let child = frames.get(joints[joint]);
        let before = frames.get(joints[joint].parent().unwrap()).rotation;
        let turn = before.slerp(&child.rotation, 0.5);
        let (across, back) = (turn * V::x(), turn * -V::z());
        let centre = Point3::from(child.translation.vector);
        let radius = self.morphology.finger(finger).radii[joint];
        let lines = 31;
        let half = 0.75 * radius;
        let step = 2.0 * half / lines as f64;
        let ends: Vec<(f64, f64)> = (0..lines)
            .map(|k| {
                let u = (k as f64 + 0.5) * step - half;
                inside(&points, &self.mesh.triangles, &(centre + across * u), &across, &back)
            })
            .collect();
        let middle = &ends[lines / 2 - 2..lines / 2 + 3];
        let mean = |pick: fn(&(f64, f64)) -> f64| middle.iter().map(pick).sum::<f64>() / middle.len() as f64;
        Section {
            dorsal: mean(|e| e.1),
            palmar: -mean(|e| e.0),
            area: ends.iter().map(|(low, high)| (high - low) * step).sum(),
        }
    }
}

/// Where the flesh around `from` begins and ends along `along`, which is at a right angle to `across`. Flesh that is in flesh counts
/// once.
fn inside(points: &[V], triangles: &[[u32; 3]], from: &Point3<f64>, across: &V, along: &V) -> (f64, f64) {
    let other = along.cross(across);
    let mut crossed: Vec<(f64, i32)> = Vec::new();
    for t in triangles {
        let c = t.map(|i| points[i as usize] - from.coords);
        let flat = c.map(|p| (p.dot(across), p.dot(&other)));
        let cross = |a: (f64, f64), b: (f64, f64)| a.0 * b.1 - a.1 * b.0;
        let shares = [cross(flat[1], flat[2]), cross(flat[2], flat[0]), cross(flat[0], flat[1])];
        let sum: f64 = shares.iter().sum();
        if shares.iter().all(|s| *s > 0.0) || shares.iter().all(|s| *s < 0.0) {
            let at = c.iter().zip(shares).map(|(p, s)| p.dot(along) * s / sum).sum();
            let normal = (c[1] - c[0]).cross(&(c[2] - c[0]));
            crossed.push((at, if normal.dot(along) < 0.0 { 1 } else { -1 }));
        }
    }
    crossed.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut depth, mut start) = (0, f64::NAN);
    for (at, way) in crossed {
        if depth == 0 && way > 0 {
            start = at;
        }
        depth += way;
        if depth == 0 && start <= 0.0 && at >= 0.0 {
            return (start, at);
        }
    }
    panic!("the joint is outside of the flesh");
}

/// A joint that bends: its name, its place among the last four of its finger, its angle, and how far it is bent, degrees.
type Bend = (&'static str, usize, JointAngle, f64);

/// The long fingers' joints at a right angle, the thumb's at most at the ends of their ranges.
fn bends(finger: Finger) -> Vec<Bend> {
    match finger {
        Finger::Thumb => {
            vec![("MCP", 1, JointAngle::Thumb2Flexion, 60.0), ("IP", 2, JointAngle::Thumb3Flexion, 85.0)]
        }
        _ => vec![
            ("MCP", 0, finger.base_flexion(), 90.0),
            ("PIP", 1, finger.middle_flexion(), 90.0),
            ("DIP", 2, finger.end_flexion(), 90.0),
        ],
    }
}

#[test]
fn bent_joints_keep_their_thickness_and_the_hand_its_volume() {
    let hand = Hand::new(Morphology::default());
    let straight = HandPose::neutral(Side::Right);
    let volume = hand.volume(&straight);
    let mut all = straight.clone();
    println!("                back of joint, mm    thickness, mm       area, mm²          hand");
    for finger in Finger::ALL {
        for (name, joint, angle, degrees) in bends(finger) {
            let flat = hand.section(&straight, finger, joint);
            let pose = straight.clone().with_degrees(angle, degrees);
            let bent = hand.section(&pose, finger, joint);
            let gains = flat.gains(&bent);
            let grown = hand.volume(&pose) / volume - 1.0;
            let row = [
                (1e3 * flat.dorsal, 1e3 * bent.dorsal),
                (1e3 * flat.thickness(), 1e3 * bent.thickness()),
                (1e6 * flat.area, 1e6 * bent.area),
            ];
            print!("{:6} {name:3} {degrees}°", finger.name());
            for ((a, b), gain) in row.iter().zip(gains) {
                print!("   {a:5.1} {b:5.1} {:+5.1} %", 100.0 * gain);
            }
            println!("   {:+.2} %", 100.0 * grown);
            assert!(
                gains.iter().chain([&grown]).all(|gain| *gain > -MOST),
                "{} {name}: {gains:?} {grown}",
                finger.name()
            );
            if finger != Finger::Thumb {
                all = all.with_degrees(angle, degrees);
                let half = hand.section(&straight.clone().with_degrees(angle, degrees / 2.0), finger, joint);
                assert!(
                    flat.gains(&half).iter().all(|gain| gain.abs() < MOST_HALF_WAY),
                    "{} {name}",
                    finger.name()
                );
            }
        }
    }
    let grown = hand.volume(&all) / volume - 1.0;
    println!("all of the long fingers at right angles: {:+.2} % of the hand", 100.0 * grown);
    assert!(grown > -MOST, "{grown}");
}
