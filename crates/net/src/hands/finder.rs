//! The networks as a finder of hands.

use image::RgbImage;

use super::crop::{Border, crop};
use super::palms::{self, Decoder, Palm};
use super::{HandFinder, JOINTS, Region, Sighting};
use crate::error::{Error, Result};
use crate::files::{Bundle, Role};
use crate::graph::Network;

/// Side of the joint network's input.
const SIDE: usize = 224;

/// Regions that overlap by more are of the same hand.
const SAME: f64 = 0.5;

/// How hands are found.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct NetFinderOptions {
    /// At most so many hands.
    pub hands: usize,
    /// A palm is one from this score on, 0 to 1.
    pub palm_score: f64,
    /// Joints are of a hand from this presence on, 0 to 1.
    pub presence: f64,
    /// Looks for joints where the last picture's were before it looks for palms.
    pub follow: bool,
}

impl Default for NetFinderOptions {
    fn default() -> Self {
        Self { hands: 2, palm_score: 0.5, presence: 0.5, follow: true }
    }
}

impl NetFinderOptions {
    /// At most so many hands.
    pub fn with_hands(mut self, hands: usize) -> Self {
        self.hands = hands;
        self
    }

    /// A palm is one from this score on, 0 to 1.
    pub fn with_palm_score(mut self, score: f64) -> Self {
        self.palm_score = score;
        self
    }

    /// Joints are of a hand from this presence on, 0 to 1.
    pub fn with_presence(mut self, presence: f64) -> Self {
        self.presence = presence;
        self
    }

    /// Looks for joints where the last picture's were before it looks for palms.
    pub fn with_follow(mut self, follow: bool) -> Self {
        self.follow = follow;
        self
    }
}

/// Finds hands with a network for palms and one for joints.
#[derive(Clone, Debug)]
pub struct NetFinder {
    options: NetFinderOptions,
    detector: Network,
    landmarks: Network,
    outputs: Outputs,
    decoder: Decoder,
    palms: Vec<Palm>,
    /// Where hands were found in the last picture, after their joints.
    last: Vec<Region>,
}

/// Which outputs are which.
#[derive(Clone, Copy, Debug)]
struct Outputs {
    boxes: usize,
    scores: usize,
    points: usize,
    presence: usize,
    right: usize,
    world: Option<usize>,
}

impl NetFinder {
    /// A finder with the networks of a bundle.
    ///
    /// # Errors
    /// As [`NetFinder::of`].
    pub fn new(bundle: &Bundle, options: NetFinderOptions) -> Result<Self> {
        Self::of(bundle.palms.network().clone(), bundle.landmarks.network().clone(), options)
    }

    /// A finder with two networks.
    ///
    /// # Errors
    /// [`Error::Role`] where a network's inputs and outputs are not those of its task.
    pub fn of(palms: Network, landmarks: Network, options: NetFinderOptions) -> Result<Self> {
        for (network, role, name) in [(&palms, Role::Palms, "palm"), (&landmarks, Role::Landmarks, "joint")] {
            if Role::of(network) != Some(role) {
                return Err(Error::Role {
                    role: name,
                    what: format!(
                        "inputs {:?} and outputs {:?} are not those of its task",
                        network.inputs().map(|p| &p.shape).collect::<Vec<_>>(),
                        network.outputs().map(|p| &p.shape).collect::<Vec<_>>()
                    ),
                });
            }
        }
        let of_size = |network: &Network, size: usize, nth: usize| {
            let sizes = network.outputs().map(|port| port.shape.iter().product::<usize>());
            sizes.enumerate().filter(|(_, s)| *s == size).map(|(i, _)| i).nth(nth)
        };
        let missing = || Error::Role { role: "hand", what: "an output is missing".to_owned() };
        let outputs = Outputs {
            boxes: of_size(&palms, 2016 * 18, 0).ok_or_else(missing)?,
            scores: of_size(&palms, 2016, 0).ok_or_else(missing)?,
            points: of_size(&landmarks, 3 * JOINTS, 0).ok_or_else(missing)?,
            presence: of_size(&landmarks, 1, 0).ok_or_else(missing)?,
            right: of_size(&landmarks, 1, 1).ok_or_else(missing)?,
            world: of_size(&landmarks, 3 * JOINTS, 1),
        };
        Ok(Self {
            options,
            detector: palms,
            landmarks,
            outputs,
            decoder: Decoder::new(),
            palms: Vec::new(),
            last: Vec::new(),
        })
    }

    /// Forgets where hands were.
    pub fn reset(&mut self) {
        self.last.clear();
    }

    /// The regions of the palms in a picture, surest first.
    ///
    /// # Errors
    /// None for networks that were read without one.
    pub fn regions(&mut self, picture: &RgbImage) -> Result<Vec<Region>> {
        let (width, height) = (f64::from(picture.width()), f64::from(picture.height()));
        // The whole picture in the middle of a black square.
        let whole = Region { centre: [width / 2.0, height / 2.0], side: width.max(height), angle: 0.0 };
        if let Some(input) = self.detector.input_mut(0) {
            crop(picture, &whole, Border::Black, palms::SIDE, input);
        }
        self.detector.run()?;
        let boxes = self.detector.output(self.outputs.boxes).unwrap_or_default();
        let scores = self.detector.output(self.outputs.scores).unwrap_or_default();
        self.decoder.decode(boxes, scores, self.options.palm_score, &mut self.palms);
        let regions = self.palms.iter().take(self.options.hands).map(|palm| {
            let size = palm.size.map(|s| s * whole.side);
            let [wrist, _, middle, ..] = palm.points.map(|p| whole.point(p));
            Region::of_palm(whole.point(palm.centre), size, wrist, middle)
        });
        Ok(regions.filter(usable).collect())
    }

    /// The joints in a region, whatever their presence.
    ///
    /// # Errors
    /// None for networks that were read without one.
    pub fn joints(&mut self, picture: &RgbImage, region: &Region) -> Result<Sighting> {
        if let Some(input) = self.landmarks.input_mut(0) {
            crop(picture, region, Border::Nearest, SIDE, input);
        }
        self.landmarks.run()?;
        let triples = |output| self.landmarks.output(output).unwrap_or_default().as_chunks::<3>().0;
        let single =
            |output| self.landmarks.output(output).and_then(|v| v.first()).map_or(0.0, |&v| f64::from(v));
        let mut points = [[0.0; 2]; JOINTS];
        for (to, [x, y, _]) in points.iter_mut().zip(triples(self.outputs.points)) {
            *to = region.point([x, y].map(|v| f64::from(*v) / SIDE as f64));
        }
        let (sin, cos) = region.angle.sin_cos();
        let world = self.outputs.world.map(|output| {
            let mut world = [[0.0; 3]; JOINTS];
            for (to, from) in world.iter_mut().zip(triples(output)) {
                let [x, y, z] = from.map(f64::from);
                *to = [x * cos - y * sin, x * sin + y * cos, z];
            }
            world
        });
        let (presence, right) = (single(self.outputs.presence), single(self.outputs.right));
        Ok(Sighting { points, world, presence, right, region: *region })
    }
}

/// Whether a region can be cropped at all.
fn usable(region: &Region) -> bool {
    let numbers = [region.centre[0], region.centre[1], region.side, region.angle];
    numbers.iter().all(|v| v.is_finite() && v.abs() < 1e6) && region.side > 1.0
}

/// Adds a region, which stands for all those before it that are of the same hand.
fn add(regions: &mut Vec<Region>, region: Region) {
    regions.retain(|other| other.overlap(&region) <= SAME);
    regions.push(region);
}

impl HandFinder for NetFinder {
    fn find(&mut self, picture: &RgbImage, _time: f64) -> Result<Vec<Sighting>> {
        if picture.width() == 0 || picture.height() == 0 {
            return Ok(Vec::new());
        }
        let mut regions = Vec::with_capacity(2 * self.options.hands);
        if !self.options.follow {
            self.last.clear();
        }
        if self.last.len() < self.options.hands {
            for region in self.regions(picture)? {
                add(&mut regions, region);
            }
        }
        // What is known from joints is better than what palms say.
        for region in std::mem::take(&mut self.last) {
            add(&mut regions, region);
        }
        let mut found = Vec::with_capacity(regions.len());
        for region in regions {
            let sighting = self.joints(picture, &region)?;
            if sighting.presence >= self.options.presence {
                let next = Region::of_joints(&sighting.points);
                if usable(&next) && self.last.len() < self.options.hands {
                    self.last.push(next);
                }
                found.push(sighting);
            }
        }
        Ok(found)
    }
}
