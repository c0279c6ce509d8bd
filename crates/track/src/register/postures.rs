//! Postures that hands take, drawn small with the person's own hand, to be found by their silhouettes.

use nalgebra::{UnitQuaternion, Vector3};

use super::super::camera::PinholeCamera;
use super::super::model::HandModel;
use super::super::objective::Window;
use super::super::state::{HAND_LENGTH, ModelState};
use super::geometry::spread;
use super::prior::OpenState;
use handcast_hand::shapes::ShapeLibrary;
use handcast_hand::{Domain, Finger, FreeAngles, Side};
use handcast_vision::Mask;
use handcast_vision::tuning::tuning;

/// Side of a small silhouette, cells: the bits of a row.
const SIDE: u32 = u32::BITS;
/// Rows behind the wrist: what is there is forearm, and is not compared.
const BEHIND: u32 = 2;
/// Postures of a long finger, and of the thumb.
const FINGER_POSTURES: usize = 6;
const THUMB_POSTURES: usize = 3;
/// Turns in which postures are compared.
const TURNS: usize = 3;
/// Length in the image, hand lengths, below which the hand points at the camera.
const FORESHORTENED: f64 = 1e-6;

tuning! {
    /// Postures of single fingers, and how whole silhouettes are compared.
    pub struct PostureTuning {
        /// Postures of a long finger: MCP and PIP flexion.
        ["°", "chosen by eye: stretched, half bent, bent, closed, hooked, bent at its base"]
        pub finger: [[f64; 2]; FINGER_POSTURES] =
            [[5.0, 8.0], [20.0, 28.0], [35.0, 50.0], [80.0, 100.0], [10.0, 85.0], [65.0, 20.0]],
        /// Postures of the thumb: CMC flexion, abduction, IP flexion.
        ["°", "chosen by eye: beside the hand, before it, across the palm"]
        pub thumb: [[f64; 3]; THUMB_POSTURES] = [[0.0, 12.0, 5.0], [28.0, 20.0, 15.0], [34.0, 44.0, 40.0]],
        /// How far a hand may be turned in the image, each way, from where it is thought to be: who takes one finger
        /// for its neighbour turns the whole hand.
        ["rad", "spec/experiments.md, Known postures in three orientations"]
        pub turn: f64 = 0.2,
        /// Side of a cell of the small silhouettes.
        ["hand lengths", "chosen by eye: a hand fits in 32 cells"]
        pub cell: f64 = 0.04,
    }
}

impl PostureTuning {
    /// How many postures of `finger` there are.
    pub(super) fn count(&self, finger: Finger) -> usize {
        if finger == Finger::Thumb { self.thumb.len() } else { self.finger.len() }
    }

    /// The free angles of `finger`, radians, in one of its postures; `open` are those of all fingers of the open hand,
    /// whose abduction goes as the finger bends.
    pub(super) fn posture(
        &self,
        finger: Finger,
        which: usize,
        open: &FreeAngles,
    ) -> [f64; Finger::FREE_ANGLES] {
        if finger == Finger::Thumb {
            return self.thumb[which % self.thumb.len()].map(f64::to_radians);
        }
        let [mcp, pip] = self.finger[which % self.finger.len()].map(f64::to_radians);
        [mcp, spread(open[finger.free_abduction()], mcp), pip]
    }

    /// `facing` as it is, and turned in the image a little each way.
    pub(super) fn turned(&self, facing: &ModelState) -> [ModelState; TURNS] {
        [0.0, -self.turn, self.turn].map(|turn| {
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
            ModelState { rotation: turn * facing.rotation, ..facing.clone() }
        })
    }
}

/// A small silhouette: a bit for each cell, row by row from the fingertips to the wrist.
type Small = [u32; SIDE as usize];

/// Postures and their small silhouettes.
#[derive(Clone, Debug, Default)]
pub(super) struct PostureLibrary {
    /// Free angles and the thumb's MCP flexion beyond eq. (5), radians.
    postures: Vec<(FreeAngles, f64)>,
    small: Vec<Small>,
    /// Side of a cell, hand lengths.
    cell: f64,
    /// Distances of the last search, with places among the hands that were asked about and among the postures.
    found: Vec<(u32, u32, u32)>,
}

impl PostureLibrary {
    /// The postures of the built-in shapes and of all combinations of a few postures of single fingers, as
    /// `model` shows them when it faces the camera as the open hand does.
    pub(super) fn new(tuning: &PostureTuning, model: &HandModel, open: &OpenState, domain: &Domain) -> Self {
        let cells_per_metre = 1.0 / (tuning.cell * HAND_LENGTH);
        let mut model = model.clone();
        if let Some(camera) = model.camera() {
            let focal = camera.focal / open.state.scale * cells_per_metre;
            model.set_camera(PinholeCamera { width: SIDE, height: SIDE, focal });
        }
        let up = up(&open.state);
        // Turned in the image so that its fingers point up.
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), up[0].atan2(-up[1]));
        let mut state = ModelState {
            wrist: [0.5 * f64::from(SIDE), f64::from(SIDE - BEHIND)],
            scale: cells_per_metre,
            rotation: turn * open.state.rotation,
            free: open.state.free,
            thumb_mcp: 0.0,
        };
        let mut library = Self { cell: tuning.cell, ..Self::default() };
        let mut mask = Mask::new(SIDE, SIDE);
        let mut add = |free: FreeAngles, thumb_mcp: f64| {
            (state.free, state.thumb_mcp) = (free, thumb_mcp);
            state.bring_inside(domain, &open.state.free);
            mask.clear();
            model.draw(&state, [0.0, 0.0], &mut mask);
            library.postures.push((state.free, state.thumb_mcp));
            library.small.push(std::array::from_fn(|y| mask.row(y as u32).first().map_or(0, |&w| w as u32)));
        };
        let shapes = ShapeLibrary::parse(include_str!("../../postures.toml")).unwrap_or_default();
        for shape in shapes.names().filter_map(|name| shapes.get(name).ok()) {
            let shown = open.state.clone().with_angles(&shape.pose(Side::Right).angles);
            add(shown.free, shown.thumb_mcp);
        }
        let combinations: usize = Finger::ALL.into_iter().map(|f| tuning.count(f)).product();
        for code in 0..combinations {
            let mut free = open.state.free;
            let mut rest = code;
            for finger in Finger::ALL {
                free[finger.range()].copy_from_slice(&tuning.posture(finger, rest, &open.state.free));
                rest /= tuning.count(finger);
            }
            add(free, 0.0);
        }
        library.found.reserve(library.postures.len());
        library
    }

    /// The `n` postures whose silhouettes are most like that in `window`, best first, each with that of `facings`, where
    /// the hand is, in which it is most like it.
    pub(super) fn nearest<'a>(
        &'a mut self,
        window: &Window,
        facings: &'a [ModelState; TURNS],
        n: usize,
    ) -> impl Iterator<Item = (&'a (FreeAngles, f64), &'a ModelState)> {
        self.found.clear();
        let seen = facings.each_ref().map(|facing| small(window, facing, self.cell));
        for (place, small) in self.small.iter().enumerate() {
            let distance = |seen: &Small| {
                let rows = small.iter().zip(seen).take((SIDE - BEHIND) as usize);
                rows.map(|(a, b)| (a ^ b).count_ones()).sum::<u32>()
            };
            let least = (0..).zip(&seen).map(|(facing, seen)| (distance(seen), facing)).min();
            self.found.extend(least.map(|(distance, facing)| (distance, facing, place as u32)));
        }
        let n = n.min(self.found.len());
        if n < self.found.len() {
            self.found.select_nth_unstable(n);
        }
        self.found[..n].sort_unstable();
        let Self { found, postures, .. } = self;
        found[..n].iter().filter_map(|&(_, facing, place)| {
            Some((postures.get(place as usize)?, facings.get(facing as usize)?))
        })
    }
}

/// The unit vector in the image, y down, to which the hand of `state` points.
fn up(state: &ModelState) -> [f64; 2] {
    let along = state.rotation * Vector3::y();
    let length = along.x.hypot(along.y);
    if length < FORESHORTENED { [0.0, -1.0] } else { [along.x / length, -along.y / length] }
}

/// The silhouette in the cells of a small one around the hand of `facing`; `cell` is the side of a cell, hand lengths.
fn small(window: &Window, facing: &ModelState, cell: f64) -> Small {
    let [ux, uy] = up(facing);
    let cell = cell * HAND_LENGTH * facing.scale;
    let [x0, y0] = window.origin();
    let silhouette = window.silhouette();
    std::array::from_fn(|row| {
        let ahead = (f64::from(SIDE - BEHIND) - row as f64 - 0.5) * cell;
        let mut bits = 0;
        for column in 0..SIDE {
            let right = (f64::from(column) + 0.5 - 0.5 * f64::from(SIDE)) * cell;
            let x = facing.wrist[0] + ahead * ux - right * uy - x0;
            let y = facing.wrist[1] + ahead * uy + right * ux - y0;
            if x >= 0.0 && y >= 0.0 && silhouette.get(x as u32, y as u32) {
                bits |= 1 << column;
            }
        }
        bits
    })
}
