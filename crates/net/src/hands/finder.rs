//! The networks as a finder of hands.

use handcast_vision::light::{LightTuning, gain};
use handcast_vision::sighting::{FindError, HandFinder, JOINTS, Region, Sighting};
use image::RgbImage;

use super::crop::{Border, crop};
use super::palms::{self, Decoder, Palm};
use super::scene::Scene;
use crate::error::{Error, Result};
use crate::files::{Bundle, Role};
use crate::graph::Network;

/// Side of the joint network's input.
const SIDE: usize = 224;

/// A palm whose points are nearer to those of a hand than this share of the region's side, on average of place, is that
/// hand's: half a palm's breadth.
const SAME_PALM: f64 = 0.15;

/// Most further hands that are counted in a picture.
const MOST_FURTHER: usize = 4;

/// Joints that are nearer to each other than this share of the region's side, on average, are of the same hand: a
/// seventh of the hand's length, where neighbouring fingers are an eighth apart.
const SAME_JOINTS: f64 = 0.1;

/// A hand that is no longer seen is also looked for by itself, in a square about where it was: sides of its region, how many
/// more for each picture since, and for how many pictures. The detector sees the whole picture at 192 pixels a side, in which
/// the palm of somebody two metres away has ten.
const NEAR_SIDE: f64 = 3.0;
const NEAR_GROWTH: f64 = 0.5;
const NEAR_FOR: usize = 30;
/// Share of the picture's longer side from which on a square shows nothing new.
const NEAR_MOST: f64 = 0.7;

/// While there is room for a hand, one square after the other is looked at as well: its sides as shares of the picture's longer
/// side while no hand is seen, else in sides of the region of the one that is seen, as the other is about as large. Neighbours
/// share this much of a side.
const SCANNED: [f64; 2] = [1.0 / 2.0, 1.0 / 3.0];
const SCAN_SIDE: f64 = 5.0;
const SCAN_SHARED: f64 = 0.25;
/// As [`SAME_PALM`] there: so close up the detector sees palms in the same hand once more.
const SCAN_APART: f64 = 0.5;

/// Length of a hand as a share of its region's side.
const HAND_IN_REGION: f64 = 0.7;

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
    /// Looks for more palms in each so many pictures while some hands, but not all, are followed. While none is, and in
    /// a picture in which one is lost, palms are looked for anyway.
    pub search_every: usize,
    /// The same while nothing but the hands has changed since the last search.
    pub search_still: usize,
    /// Joints that move by less than this share of the hand's length from picture to picture are looked for in every
    /// second picture, and go on as they moved in the others; 0 for in every one.
    pub steady: f64,
    /// How dark pictures become brighter.
    pub light: LightTuning,
}

impl Default for NetFinderOptions {
    fn default() -> Self {
        Self {
            hands: 2,
            palm_score: 0.5,
            presence: 0.5,
            follow: true,
            search_every: 3,
            search_still: 15,
            steady: 0.0,
            light: LightTuning::default(),
        }
    }
}

impl NetFinderOptions {
    /// Those of a finder beside the tracker: joints that move by less than a network's are off by (0.02 of the hand's length)
    /// are looked for in every second picture.
    pub fn for_tracking() -> Self {
        Self::default().with_steady(0.02)
    }

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

    /// Looks for more palms in each so many pictures while some hands, but not all, are followed.
    pub fn with_search_every(mut self, pictures: usize) -> Self {
        self.search_every = pictures;
        self
    }

    /// The same while nothing but the hands has changed since the last search.
    pub fn with_search_still(mut self, pictures: usize) -> Self {
        self.search_still = pictures;
        self
    }

    /// Joints that move by less than this share of the hand's length from picture to picture are looked for in every
    /// second picture.
    pub fn with_steady(mut self, share: f64) -> Self {
        self.steady = share;
        self
    }

    /// How dark pictures become brighter.
    pub fn with_light(mut self, light: LightTuning) -> Self {
        self.light = light;
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
    /// Regions and middles of the palms.
    regions: Vec<(Region, [f64; 2])>,
    /// The hands of the last picture.
    last: Vec<Followed>,
    /// Those of the one before, kept for its memory.
    before: Vec<Followed>,
    /// Hands that are no longer seen.
    missing: Vec<Missing>,
    /// Pictures since palms were looked for.
    since: usize,
    /// Squares that were looked at, and how many of them since something but the hands had changed.
    scanned: usize,
    scanned_still: usize,
    /// Hands that there was no room for when they were looked for in the last picture.
    further: usize,
    /// Those and the hands that were given.
    all: Vec<Sighting>,
    /// The picture in which they were.
    scene: Scene,
}

/// A hand that is followed.
#[derive(Clone, Debug)]
struct Followed {
    hand: Sighting,
    /// What its joints move by from picture to picture, pixels; `None` where it is not known yet.
    motion: Option<[[f64; 2]; JOINTS]>,
}

impl Followed {
    /// A hand as seen in this picture, followed from another one.
    fn from(hand: &Sighting, before: Option<&Self>) -> Self {
        let motion = match before {
            Some(before) if hand.age > 0 => before.motion,
            Some(before) => {
                // One that went on by its motion had been seen a picture earlier.
                let Sighting { points, age, .. } = &before.hand;
                let gone = before.motion.filter(|_| *age > 0);
                Some(std::array::from_fn(|i| {
                    [0, 1].map(|k| {
                        let seen = points[i][k] - gone.map_or(0.0, |m| *age as f64 * m[i][k]);
                        (hand.points[i][k] - seen) / (*age + 1) as f64
                    })
                }))
            }
            None => None,
        };
        Self { hand: hand.clone(), motion }
    }

    /// The same hand a picture later, if it was seen in this one and moves by less than `steady` of its length.
    fn gone_on(&self, steady: f64) -> Option<Sighting> {
        let (motion, hand) = (self.motion.as_ref()?, &self.hand);
        let most = steady * HAND_IN_REGION * hand.region.side;
        if hand.age > 0 || !motion.iter().all(|[x, y]| x.hypot(*y) < most) {
            return None;
        }
        let points = std::array::from_fn(|i| [0, 1].map(|k| hand.points[i][k] + motion[i][k]));
        Some(Sighting { points, age: 1, ..hand.clone() })
    }
}

/// A hand that is no longer seen.
#[derive(Clone, Copy, Debug)]
struct Missing {
    /// Where it was looked for when it was seen.
    region: Region,
    /// Pictures since.
    pictures: usize,
}

impl Missing {
    /// About where it may be by now.
    fn square(&self) -> Region {
        let sides = NEAR_SIDE + NEAR_GROWTH * self.pictures as f64;
        Region { side: sides * self.region.side, angle: 0.0, ..self.region }
    }

    /// Whether that is so much less than the picture that the detector sees more there.
    fn is_small_in(&self, picture: &RgbImage) -> bool {
        self.square().side < NEAR_MOST * whole(picture).side
    }

    fn distance(&self, hand: &Sighting) -> f64 {
        let [a, b] = [self.region.centre, hand.region.centre];
        (a[0] - b[0]).hypot(a[1] - b[1])
    }
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
            regions: Vec::new(),
            last: Vec::new(),
            before: Vec::new(),
            missing: Vec::new(),
            since: 0,
            scanned: 0,
            scanned_still: 0,
            further: 0,
            all: Vec::new(),
            scene: Scene::default(),
        })
    }

    /// Finds the regions of the palms in a square of a picture, surest first.
    fn detect(&mut self, picture: &RgbImage, square: &Region) -> Result<()> {
        let light = gain(picture, &self.options.light);
        if let Some(input) = self.detector.input_mut(0) {
            crop(picture, square, (Border::Black, light), palms::SIDE, input);
        }
        self.detector.run()?;
        let boxes = self.detector.output(self.outputs.boxes).unwrap_or_default();
        let scores = self.detector.output(self.outputs.scores).unwrap_or_default();
        self.decoder.decode(boxes, scores, self.options.palm_score, &mut self.palms);
        let regions = self.palms.iter().map(|palm| {
            let size = palm.size.map(|s| s * square.side);
            let points = palm.points.map(|p| square.point(p));
            let [wrist, _, middle, ..] = points;
            (Region::of_palm(square.point(palm.centre), size, wrist, middle), mean(points))
        });
        self.regions.clear();
        self.regions.extend(regions.filter(|(region, _)| usable(region)));
        Ok(())
    }

    /// The joints in a region, whatever their presence; none in a region that is no square of at least a pixel.
    ///
    /// # Errors
    /// None for networks that were read without one.
    pub fn joints(&mut self, picture: &RgbImage, region: &Region) -> Result<Option<Sighting>> {
        if !usable(region) {
            return Ok(None);
        }
        let light = gain(picture, &self.options.light);
        if let Some(input) = self.landmarks.input_mut(0) {
            crop(picture, region, (Border::Nearest, light), SIDE, input);
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
        Ok(Some(Sighting { points, world, presence, right, region: *region, age: 0 }))
    }

    /// Adds the hand in a region, if there is one, or puts it in the place of one seen less surely.
    fn add(&mut self, picture: &RgbImage, region: &Region, hands: &mut Vec<Sighting>) -> Result<()> {
        let Some(seen) = self.joints(picture, region)? else { return Ok(()) };
        let near = |other: &Sighting| seen.distance(other) < SAME_JOINTS * seen.region.side;
        if !(seen.presence >= self.options.presence && usable(&Region::of_joints(&seen.points))) {
            return Ok(());
        }
        match hands.iter_mut().find(|other| near(other)) {
            Some(other) if other.presence < seen.presence => *other = seen,
            Some(_) => {}
            None => hands.push(seen),
        }
        Ok(())
    }

    /// Looks for palms in a square of a picture, and for the joints of those that are of no hand seen: they are `apart` from its
    /// palm by more than this share of its region's side.
    fn search(
        &mut self,
        picture: &RgbImage,
        (square, apart): (&Region, f64),
        hands: &mut Vec<Sighting>,
    ) -> Result<()> {
        self.detect(picture, square)?;
        let mut regions = std::mem::take(&mut self.regions);
        regions.retain(|(_, palm)| {
            let own = |hand: &Sighting| {
                let [x, y] = mean(PALM.map(|joint| hand.points[joint]));
                (palm[0] - x).hypot(palm[1] - y) < apart * hand.region.side
            };
            !hands.iter().any(own)
        });
        let room = self.options.hands.saturating_sub(hands.len());
        let (taken, others) = regions.split_at(room.min(regions.len()));
        let added = taken.iter().try_for_each(|(region, _)| self.add(picture, region, hands));
        let mut all = std::mem::take(&mut self.all);
        all.clone_from(hands);
        // Where there is room, whoever is left was not looked for.
        let looked_for = if hands.len() < self.options.hands { 0 } else { MOST_FURTHER };
        let seen =
            others.iter().take(looked_for).try_for_each(|(region, _)| self.add(picture, region, &mut all));
        self.further = self.further.max(all.len() - hands.len());
        self.all = all;
        self.regions = regions;
        added.and(seen)
    }

    /// Looks at one square more, where there is room for a hand: what is far away is too small in the whole picture. Where
    /// nothing has changed each is looked at once.
    fn scan(&mut self, picture: &RgbImage, changed: bool, hands: &mut Vec<Sighting>) -> Result<()> {
        let whole = whole(picture);
        let seen = hands.iter().map(|hand| SCAN_SIDE * hand.region.side).reduce(f64::min);
        let sides: &[f64] = match &seen {
            Some(side) if *side >= NEAR_MOST * whole.side => &[],
            Some(side) => &[*side],
            None => &SCANNED.map(|share| share * whole.side),
        };
        let squares: usize = sides.iter().map(|side| Squares::of(picture, *side).count()).sum();
        self.scanned_still = if changed { 0 } else { self.scanned_still + 1 };
        if hands.len() >= self.options.hands || self.scanned_still >= squares {
            return Ok(());
        }
        let mut number = self.scanned % squares;
        self.scanned = number + 1;
        for side in sides {
            let squares = Squares::of(picture, *side);
            if let Some(square) = squares.get(number) {
                return self.search(picture, (&square, SCAN_APART), hands);
            }
            number -= squares.count();
        }
        Ok(())
    }

    /// Looks for hands of the last picture, and of those before, where they were, as far as they are not seen anywhere.
    fn search_near(
        &mut self,
        picture: &RgbImage,
        last: &[Followed],
        hands: &mut Vec<Sighting>,
    ) -> Result<()> {
        let mut missing = std::mem::take(&mut self.missing);
        missing.extend(last.iter().map(|followed| Missing { region: followed.hand.region, pictures: 0 }));
        for hand in &*hands {
            // It is the nearest of them, if one was there.
            let away = |missing: &Missing| missing.distance(hand);
            let nearest = (0..missing.len()).min_by(|&a, &b| away(&missing[a]).total_cmp(&away(&missing[b])));
            nearest.map(|nearest| missing.swap_remove(nearest));
        }
        missing.iter_mut().for_each(|missing| missing.pictures += 1);
        missing.retain(|missing| missing.pictures <= NEAR_FOR && missing.is_small_in(picture));
        for missing in &missing {
            if hands.len() < self.options.hands {
                self.search(picture, (&missing.square(), SAME_PALM), hands)?;
            }
        }
        self.missing = missing;
        Ok(())
    }

    /// The hand a picture later: its joints are looked for, or it goes on.
    fn follow(
        &mut self,
        picture: &RgbImage,
        hand: &Followed,
        free: bool,
        hands: &mut Vec<Sighting>,
    ) -> Result<()> {
        match hand.gone_on(self.options.steady).filter(|_| free) {
            Some(gone) => hands.push(gone),
            None => self.add(picture, &Region::of_joints(&hand.hand.points), hands)?,
        }
        Ok(())
    }

    /// Hands that are followed, then new ones.
    fn hands(&mut self, picture: &RgbImage, hands: &mut Vec<Sighting>) -> Result<()> {
        let mut now = std::mem::take(&mut self.before);
        let last = std::mem::take(&mut self.last);
        for (k, hand) in last.iter().enumerate() {
            let near =
                |(o, other): (usize, &Followed)| o != k && hand.hand.region.overlap(&other.hand.region) > 0.0;
            let free = !last.iter().enumerate().any(near);
            self.follow(picture, hand, free, hands)?;
        }
        self.since += 1;
        let at_once = hands.is_empty() || hands.len() < last.len();
        if hands.len() < self.options.hands && (at_once || self.since >= self.options.search_every) {
            let changed = self.scene.has_changed(picture, hands);
            if at_once || changed || self.since >= self.options.search_still {
                self.since = 0;
                self.search(picture, (&whole(picture), SAME_PALM), hands)?;
                self.scan(picture, changed, hands)?;
                self.scene.keep(picture, hands);
            }
        }
        self.search_near(picture, &last, hands)?;
        now.clear();
        if self.options.follow {
            now.extend(hands.iter().map(|hand| {
                let same = |other: &&Followed| hand.distance(&other.hand) < SAME_JOINTS * hand.region.side;
                Followed::from(hand, last.iter().find(same))
            }));
        }
        (self.last, self.before) = (now, last);
        Ok(())
    }
}

/// Squares that cover a picture, in rows.
struct Squares {
    side: f64,
    size: [f64; 2],
    counts: [usize; 2],
}

impl Squares {
    /// Those of this side.
    fn of(picture: &RgbImage, side: f64) -> Self {
        let size = [picture.width(), picture.height()].map(f64::from);
        let counts = size.map(|length| {
            let steps = ((length - side) / ((1.0 - SCAN_SHARED) * side)).ceil();
            1 + steps.max(0.0) as usize
        });
        Self { side, size, counts }
    }

    fn count(&self) -> usize {
        self.counts[0] * self.counts[1]
    }

    fn get(&self, number: usize) -> Option<Region> {
        let at = [number % self.counts[0], number / self.counts[0]];
        let centre = [0, 1].map(|k| {
            let (length, steps) = (self.size[k], self.counts[k] - 1);
            let room = (length - self.side).max(0.0);
            let shift = if steps > 0 { at[k] as f64 / steps as f64 - 0.5 } else { 0.0 };
            (length + 1.0) / 2.0 + shift * room
        });
        (number < self.count()).then_some(Region { centre, side: self.side, angle: 0.0 })
    }
}

/// The whole picture in the middle of a square, its middle pixel in the middle of the crop.
fn whole(picture: &RgbImage) -> Region {
    let [width, height] = [picture.width(), picture.height()].map(f64::from);
    Region { centre: [(width + 1.0) / 2.0, (height + 1.0) / 2.0], side: width.max(height), angle: 0.0 }
}

/// Joints that the detector marks on a palm.
const PALM: [usize; 7] = [0, 5, 9, 13, 17, 1, 2];

/// The middle of places.
fn mean<const N: usize>(places: [[f64; 2]; N]) -> [f64; 2] {
    [0, 1].map(|i| places.iter().map(|p| p[i]).sum::<f64>() / N as f64)
}

/// Whether a region can be cropped at all.
fn usable(region: &Region) -> bool {
    let numbers = [region.centre[0], region.centre[1], region.side, region.angle];
    numbers.iter().all(|v| v.is_finite() && v.abs() < 1e6) && region.side > 1.0
}

impl HandFinder for NetFinder {
    fn find(&mut self, picture: &RgbImage, _time: f64, hands: &mut Vec<Sighting>) -> Result<(), FindError> {
        hands.clear();
        self.further = 0;
        if picture.width() == 0 || picture.height() == 0 {
            return Ok(());
        }
        self.hands(picture, hands).map_err(|error| {
            hands.clear();
            FindError::new(error)
        })
    }

    fn look_back(
        &mut self,
        picture: &RgbImage,
        after: &[Sighting],
        hands: &mut Vec<Sighting>,
    ) -> Result<(), FindError> {
        hands.clear();
        if picture.width() == 0 || picture.height() == 0 {
            return Ok(());
        }
        let mut regions = after.iter().map(|hand| Region::of_joints(&hand.points));
        let found = regions.try_for_each(|region| self.add(picture, &region, hands));
        found.map_err(|error| {
            hands.clear();
            FindError::new(error)
        })
    }

    fn further(&self) -> usize {
        self.further
    }

    fn reset(&mut self) {
        self.last.clear();
        self.missing.clear();
        self.scanned_still = 0;
        self.since = 0;
    }
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;
    use crate::testing::{joint_network, palm_network};

    /// Side of the pictures, and of the red squares that the made-up networks take for palms.
    const PICTURE: u32 = 384;
    const SQUARE: u32 = 40;

    fn finder(options: NetFinderOptions) -> NetFinder {
        let [palms, joints] = [palm_network(), joint_network()].map(|net| Network::read(&net).unwrap());
        NetFinder::of(palms, joints, options).unwrap()
    }

    /// Squares round places; yellow ones are of right hands.
    fn picture(squares: &[(u32, u32, bool)]) -> RgbImage {
        let mut picture = RgbImage::new(PICTURE, PICTURE);
        for &(x, y, right) in squares {
            for (i, j) in (0..SQUARE * SQUARE).map(|n| (n % SQUARE, n / SQUARE)) {
                let colour = Rgb([255, if right { 255 } else { 0 }, 0]);
                picture.put_pixel(x + i - SQUARE / 2, y + j - SQUARE / 2, colour);
            }
        }
        picture
    }

    /// Middles of the squares whose hands are found, and whether they are right ones.
    fn find(finder: &mut NetFinder, squares: &[(u32, u32, bool)]) -> Vec<(f64, f64, bool)> {
        let mut hands = Vec::new();
        finder.find(&picture(squares), 0.0, &mut hands).unwrap();
        let middle = |hand: Sighting| {
            assert!(hand.presence > 0.5 && hand.region.angle.abs() < 1e-3);
            // The wrist is 24 of the crop's pixels below.
            let [x, y] = hand.points[0];
            (x, y - 24.0 * hand.region.side / 224.0, hand.right > 0.5)
        };
        hands.into_iter().map(middle).collect()
    }

    fn assert_at(found: &[(f64, f64, bool)], squares: &[(u32, u32, bool)]) {
        assert_eq!(found.len(), squares.len(), "{found:?} instead of {squares:?}");
        for (f, s) in found.iter().zip(squares) {
            let near = (f.0 - f64::from(s.0)).hypot(f.1 - f64::from(s.1)) < 3.0;
            assert!(near && f.2 == s.2, "{found:?} instead of {squares:?}");
        }
    }

    #[test]
    fn two_hands_are_followed_in_their_order() {
        let mut finder = finder(NetFinderOptions::default());
        let mut first = find(&mut finder, &[(100, 120, true), (284, 200, false)]);
        first.sort_by(|a, b| a.0.total_cmp(&b.0));
        assert_at(&first, &[(100, 120, true), (284, 200, false)]);
        let order = find(&mut finder, &[(100, 120, true), (284, 200, false)]);
        let left_first = order[0].0 < order[1].0;
        for step in 1..8 {
            let mut squares = [(100, 120 + 8 * step, true), (284, 200 - 8 * step, false)];
            if !left_first {
                squares.reverse();
            }
            assert_at(&find(&mut finder, &squares), &squares);
        }
    }

    #[test]
    fn a_hand_in_the_dark_is_found_as_in_the_light() {
        let dark = |square| {
            let mut picture = picture(&[square]);
            picture.iter_mut().for_each(|level| *level = (f64::from(*level) * 0.15) as u8);
            picture
        };
        let mut hands = Vec::new();
        for k in 0..4 {
            let square = (100 + 4 * k, 120, true);
            finder(NetFinderOptions::default()).find(&dark(square), 0.0, &mut hands).unwrap();
            assert_eq!(hands.len(), 1);
        }
        let mut off = LightTuning::default();
        off.most = 1.0;
        let mut blind = finder(NetFinderOptions::default().with_light(off));
        blind.find(&dark((100, 120, true)), 0.0, &mut hands).unwrap();
        assert!(hands.is_empty());
    }

    #[test]
    fn no_more_hands_than_asked_for() {
        let mut finder = finder(NetFinderOptions::default().with_hands(1));
        for _ in 0..5 {
            assert_eq!(find(&mut finder, &[(100, 120, true), (284, 200, false)]).len(), 1);
        }
    }

    #[test]
    fn a_lost_hand_is_looked_for_at_once_and_another_now_and_then() {
        let mut finder = finder(NetFinderOptions::default().with_search_every(3));
        assert_at(&find(&mut finder, &[]), &[]);
        let one = [(100, 120, true)];
        assert_at(&find(&mut finder, &one), &one);
        let two = [(100, 120, true), (284, 200, false)];
        assert_at(&find(&mut finder, &two), &one);
        assert_at(&find(&mut finder, &two), &one);
        assert_at(&find(&mut finder, &two), &two);
        // Where one is missed it is somewhere else.
        let moved = [(100, 120, true), (284, 340, false)];
        assert_at(&find(&mut finder, &moved), &moved);
        assert_at(&find(&mut finder, &[(284, 60, true)]), &[(284, 60, true)]);
        finder.reset();
        assert_at(&find(&mut finder, &[]), &[]);
    }

    /// A large picture with a square that is too small to be seen in the whole of it.
    fn far(places: &[[u32; 2]]) -> RgbImage {
        let mut picture = RgbImage::new(4 * PICTURE, 4 * PICTURE);
        for [x, y] in places {
            for (i, j) in (0..44 * 44).map(|n| (n % 44, n / 44)) {
                picture.put_pixel(x + i - 22, y + j - 22, Rgb([255, 255, 0]));
            }
        }
        picture
    }

    #[test]
    fn hands_far_away_are_found_square_by_square() {
        let mut finder = finder(NetFinderOptions::default());
        let mut hands = Vec::new();
        let squares: usize =
            SCANNED.map(|share| Squares::of(&far(&[]), share * f64::from(4 * PICTURE)).count()).iter().sum();
        let place = [700, 500];
        let looks = (1..=squares).find(|_| {
            finder.find(&far(&[place]), 0.0, &mut hands).unwrap();
            !hands.is_empty()
        });
        assert!(looks.is_some_and(|looks| looks > 1), "{looks:?}");
        let at = |hand: &Sighting, [x, y]: [u32; 2]| {
            let [cx, cy] = hand.region.centre;
            (cx - f64::from(x)).hypot(cy - f64::from(y)) < 60.0
        };
        assert!(at(&hands[0], place));
    }

    #[test]
    fn a_hand_that_is_lost_is_looked_for_about_where_it_was() {
        let mut finder = finder(NetFinderOptions::default());
        let mut hands = Vec::new();
        let mut look = |finder: &mut NetFinder, places: &[[u32; 2]]| {
            finder.find(&far(places), 0.0, &mut hands).unwrap();
            hands.len()
        };
        let place = [700, 500];
        assert!((0..40).any(|_| look(&mut finder, &[place]) == 1) && finder.missing.is_empty());
        let sides: Vec<f64> = (0..NEAR_FOR)
            .map_while(|_| {
                assert_eq!(look(&mut finder, &[]), 0);
                finder.missing.first().map(|missing| missing.square().side)
            })
            .collect();
        // About as far as the square shows more than the whole picture does.
        assert!(!sides.is_empty() && sides.is_sorted(), "{sides:?}");
        assert!(sides.iter().all(|side| *side < NEAR_MOST * f64::from(4 * PICTURE)));
        // One that is found is not missed.
        assert!((0..40).any(|_| look(&mut finder, &[place]) == 1) && finder.missing.is_empty());
    }

    #[test]
    fn squares_cover_the_picture() {
        for (size, side) in [((960, 540), 480.0), ((540, 960), 320.0), ((1000, 100), 500.0), ((7, 7), 9.0)] {
            let squares = Squares::of(&RgbImage::new(size.0, size.1), side);
            let all: Vec<Region> = (0..squares.count()).filter_map(|k| squares.get(k)).collect();
            assert!(all.len() == squares.count() && squares.get(all.len()).is_none());
            for (x, y) in [(0, 0), (size.0 - 1, 0), (size.0 / 2, size.1 / 3), (size.0 - 1, size.1 - 1)] {
                let inside = |square: &Region| {
                    let [cx, cy] = square.centre;
                    (f64::from(x) + 0.5 - cx).abs() <= side / 2.0 + 0.5
                        && (f64::from(y) + 0.5 - cy).abs() <= side / 2.0 + 0.5
                };
                assert!(all.iter().any(inside), "{size:?} {side} {x} {y}");
            }
        }
    }

    #[test]
    fn two_regions_on_one_hand_become_one() {
        let mut finder = finder(NetFinderOptions::default());
        let two = [(120, 200, true), (270, 200, true)];
        assert_eq!(find(&mut finder, &two).len(), 2);
        let one = [(195, 200, true)];
        assert_at(&find(&mut finder, &one), &one);
        assert_at(&find(&mut finder, &one), &one);
    }

    #[test]
    fn without_following_every_picture_is_the_first() {
        let mut finder = finder(NetFinderOptions::default().with_follow(false));
        for square in [(100, 100, true), (280, 280, false), (100, 280, true)] {
            assert_at(&find(&mut finder, &[square]), &[square]);
        }
    }

    #[test]
    fn a_hand_is_followed_back_without_its_palm_being_looked_for() {
        // None is sure enough to be a palm.
        let mut finder = finder(NetFinderOptions::default().with_palm_score(1.1));
        let mut sure = self::finder(NetFinderOptions::default());
        let mut hands = Vec::new();
        sure.find(&picture(&[(108, 120, true)]), 0.0, &mut hands).unwrap();
        let mut before = Vec::new();
        for (square, shown) in [((100, 120, true), true), ((284, 300, true), false)] {
            assert_at(&find(&mut finder, &[square]), &[]);
            finder.look_back(&picture(&[square]), &hands, &mut before).unwrap();
            assert_eq!(before.len(), usize::from(shown), "{square:?}");
        }
        finder.look_back(&RgbImage::new(0, 0), &hands, &mut before).unwrap();
        assert!(before.is_empty());
        // What was looked for there is not followed.
        assert_at(&find(&mut finder, &[(100, 120, true)]), &[]);
    }

    #[test]
    fn odd_pictures_show_no_hands() {
        let mut finder = finder(NetFinderOptions::default());
        let mut hands = Vec::new();
        for (width, height) in [(0, 0), (0, 5), (1, 1), (1, 3000), (3000, 1), (17, 9)] {
            finder.find(&RgbImage::new(width, height), 0.0, &mut hands).unwrap();
            assert!(hands.is_empty());
        }
        for number in [0.0, -1.0, 1e9, f64::INFINITY, f64::NAN] {
            let region = Region { centre: [number, 3.0], side: 1.0 / number, angle: 0.0 };
            assert!(finder.joints(&picture(&[]), &region).unwrap().is_none());
        }
    }

    #[test]
    fn networks_are_told_apart() {
        let [palms, joints] = [palm_network(), joint_network()].map(|net| Network::read(&net).unwrap());
        let error = NetFinder::of(joints, palms, NetFinderOptions::default()).unwrap_err();
        assert!(matches!(error, Error::Role { role: "palm", .. }), "{error}");
    }
}
