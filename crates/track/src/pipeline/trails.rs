//! Parts of pictures followed from frame to frame by their places.

use super::TrailTuning;
use handcast_vision::Silhouette;

/// One part.
#[derive(Clone, Debug)]
struct Trail {
    id: usize,
    /// Middle of the palm, pixels.
    place: [f64; 2],
    radius: f64,
    area: f64,
    /// Frames since it was last seen.
    missed: usize,
    /// The trail it is one with.
    with: Option<usize>,
    /// Frames for which the two have been much smaller than both.
    hidden: usize,
}

/// What a part of a frame is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Link {
    /// The part of this number.
    One(usize),
    /// Two that were apart and now touch.
    Joined([usize; 2]),
}

impl Link {
    pub(super) fn holds(self, id: usize) -> bool {
        match self {
            Self::One(one) => one == id,
            Self::Joined(two) => two.contains(&id),
        }
    }
}

/// Gives parts numbers that stay the same from frame to frame.
#[derive(Clone, Debug, Default)]
pub(super) struct Trails {
    tuning: TrailTuning,
    list: Vec<Trail>,
    next: usize,
    /// Middle of the part that two trails share, in the last frame.
    shared: Option<[f64; 2]>,
}

fn place(part: &Silhouette) -> [f64; 2] {
    part.palm.map(|palm| palm.centre).or(part.hand.centroid()).unwrap_or([0.0; 2])
}

pub(super) fn radius(part: &Silhouette) -> f64 {
    let disc = (f64::from(part.hand.area()) / std::f64::consts::PI).sqrt();
    part.palm.map_or(0.6 * disc, |palm| palm.radius).max(1.0)
}

fn covers(part: &Silhouette, [x, y]: [f64; 2]) -> bool {
    x >= 0.0 && y >= 0.0 && part.arm.get(x as u32, y as u32)
}

impl Trails {
    pub(super) fn new(tuning: TrailTuning) -> Self {
        Self { tuning, ..Self::default() }
    }

    /// The numbers of the parts of the next frame.
    pub(super) fn link(&mut self, parts: &[Silhouette]) -> Vec<Link> {
        let owner = self.nearest(parts);
        let mut links = Vec::with_capacity(parts.len());
        let mut seen = vec![false; self.list.len()];
        let mut shared = None;
        for (p, part) in parts.iter().enumerate() {
            let own: Option<usize> = owner.iter().position(|&o| o == Some(p));
            match self.joined(part, own, &owner) {
                Some([a, b]) => {
                    shared = part.arm.centroid();
                    self.join(a, b, shared, f64::from(part.arm.area()));
                    (seen[a], seen[b]) = (true, true);
                    links.push(Link::Joined([self.list[a].id, self.list[b].id]));
                }
                None => {
                    let t = own.unwrap_or_else(|| self.begin());
                    let trail = &mut self.list[t];
                    (trail.place, trail.radius) = (place(part), radius(part));
                    trail.area = f64::from(part.arm.area());
                    (trail.missed, trail.with, trail.hidden) = (0, None, 0);
                    links.push(Link::One(trail.id));
                    if let Some(seen) = seen.get_mut(t) {
                        *seen = true;
                    }
                }
            }
        }
        self.shared = shared;
        for (trail, seen) in self.list.iter_mut().zip(seen) {
            if !seen {
                trail.missed += 1;
                trail.with = None;
            }
        }
        let tuning = self.tuning;
        self.list.retain(|t| t.missed < tuning.forgotten);
        links
    }

    /// The part nearest to each trail, each part given once, the nearest pair first.
    fn nearest(&self, parts: &[Silhouette]) -> Vec<Option<usize>> {
        let tuning = &self.tuning;
        let mut pairs = Vec::new();
        for (t, trail) in self.list.iter().enumerate() {
            let (gate, least) = match trail.with {
                Some(_) => (tuning.widest_gate, tuning.come_apart * trail.area),
                None => {
                    ((tuning.gate + tuning.gate_growth * trail.missed as f64).min(tuning.widest_gate), 0.0)
                }
            };
            for (p, part) in parts.iter().enumerate() {
                let [x, y] = place(part);
                let away = (x - trail.place[0]).hypot(y - trail.place[1]) / trail.radius;
                if away <= gate && f64::from(part.arm.area()) >= least {
                    // One that has not been seen for long gives way.
                    pairs.push((away + tuning.absence * trail.missed as f64, t, p));
                }
            }
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut owner = vec![None; self.list.len()];
        for (_, t, p) in pairs {
            if owner[t].is_none() && !owner.contains(&Some(p)) {
                owner[t] = Some(p);
            }
        }
        owner
    }

    /// The two trails that `part` is both of, if it is: two that have no other part, and lie in it or have just
    /// disappeared where it grew.
    fn joined(&self, part: &Silhouette, own: Option<usize>, owner: &[Option<usize>]) -> Option<[usize; 2]> {
        let area = f64::from(part.arm.area());
        let free: Vec<usize> = (0..self.list.len())
            .filter(|&t| owner.get(t) == Some(&None))
            .filter(|&t| self.list[t].with.is_some() || self.list[t].missed < self.tuning.joins_within)
            .collect();
        let both = |a: usize, b: usize| {
            let (s, t) = (&self.list[a], &self.list[b]);
            let already = s.with == Some(t.id);
            let together = self.tuning.together * (s.area + t.area);
            let near = |trail: &Trail| {
                let [x, y] = place(part);
                (x - trail.place[0]).hypot(y - trail.place[1]) < self.tuning.widest_gate * trail.radius
            };
            let covered = |trail: &Trail| covers(part, trail.place);
            already && s.hidden < self.tuning.hidden
                || covered(s) && covered(t)
                || area >= together && near(s) && near(t)
        };
        match own {
            Some(own) => free.into_iter().find(|&t| both(own, t)).map(|t| [own.min(t), own.max(t)]),
            None => {
                let pairs =
                    free.iter().enumerate().flat_map(|(i, &a)| free[i + 1..].iter().map(move |&b| [a, b]));
                pairs.into_iter().find(|&[a, b]| both(a, b))
            }
        }
    }

    /// Makes two trails one; their places move with it.
    fn join(&mut self, a: usize, b: usize, middle: Option<[f64; 2]>, area: f64) {
        let thin = area < self.tuning.overlapping * (self.list[a].area + self.list[b].area);
        let moved = match (self.shared, middle) {
            (Some(before), Some(now)) => [now[0] - before[0], now[1] - before[1]],
            _ => [0.0; 2],
        };
        for (t, other) in [(a, b), (b, a)] {
            let with = self.list[other].id;
            let trail = &mut self.list[t];
            if trail.with.is_some() {
                trail.place = [trail.place[0] + moved[0], trail.place[1] + moved[1]];
            }
            (trail.with, trail.missed) = (Some(with), 0);
            trail.hidden = if thin { trail.hidden + 1 } else { 0 };
        }
    }

    fn begin(&mut self) -> usize {
        let id = self.next;
        self.next += 1;
        self.list.push(Trail {
            id,
            place: [0.0; 2],
            radius: 1.0,
            area: 0.0,
            missed: 0,
            with: None,
            hidden: 0,
        });
        self.list.len() - 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_vision::{Mask, WristTuning};

    /// Fists on arms that rise from the bottom, at these places.
    fn parts(fists: &[(i32, i32)]) -> Vec<Silhouette> {
        use handcast_vision::morphology::Components;
        let mask = Mask::from_fn(400, 300, |x, y| {
            fists.iter().any(|&(cx, cy)| {
                let (dx, dy) = (x as i32 - cx, y as i32 - cy);
                dx * dx + dy * dy < 30 * 30 || dx.abs() < 16 && dy > 0
            })
        });
        let found = Components::of(&mask, true);
        let drawn = |chosen: usize| {
            let mut out = Mask::new(400, 300);
            found.draw(&mut out, |i, _| i == chosen);
            Silhouette::from_arm(out, None, &WristTuning::default())
        };
        (0..found.list.len()).map(drawn).collect()
    }

    fn id(links: &[Link], parts: &[Silhouette], x: f64) -> usize {
        let p = parts.iter().position(|s| (place(s)[0] - x).abs() < 20.0).unwrap();
        match links[p] {
            Link::One(id) => id,
            Link::Joined(_) => panic!("joined"),
        }
    }

    #[test]
    fn parts_keep_their_numbers_and_new_ones_get_new() {
        let mut trails = Trails::default();
        let first = parts(&[(100, 120), (300, 120)]);
        let links = trails.link(&first);
        let (left, right) = (id(&links, &first, 100.0), id(&links, &first, 300.0));
        assert_ne!(left, right);
        for step in 1..8 {
            // Up and down, so that the order of the parts changes.
            let next = parts(&[(100 + 4 * step, 120 + 15 * (step % 2)), (300, 126)]);
            let links = trails.link(&next);
            assert_eq!(id(&links, &next, f64::from(100 + 4 * step)), left);
            assert_eq!(id(&links, &next, 300.0), right);
        }
        assert!(trails.link(&[]).is_empty());
        let back = parts(&[(128, 124)]);
        assert_eq!(trails.link(&back), [Link::One(left)]);
        let all = parts(&[(128, 124), (300, 120), (215, 60)]);
        let links = trails.link(&all);
        assert!(id(&links, &all, 215.0) > right && id(&links, &all, 300.0) == right);
    }

    #[test]
    fn touching_parts_are_told_and_come_apart_as_they_were() {
        let mut trails = Trails::default();
        let apart = parts(&[(140, 120), (260, 120)]);
        let links = trails.link(&apart);
        let (left, right) = (id(&links, &apart, 140.0), id(&links, &apart, 260.0));
        for x in [150, 160, 165] {
            let parts = parts(&[(x, 120), (400 - x, 120)]);
            assert_eq!(trails.link(&parts).len(), 2);
        }
        for x in [172, 176, 180, 176, 172] {
            // Together they move to the right.
            let parts = parts(&[(x + 8, 120), (408 - x, 120)]);
            assert_eq!(parts.len(), 1);
            let links = trails.link(&parts);
            assert!(
                matches!(links[..], [Link::Joined([a, b])] if (a, b) == (left.min(right), left.max(right)))
            );
        }
        let parts = parts(&[(160, 120), (245, 120)]);
        let links = trails.link(&parts);
        assert_eq!((id(&links, &parts, 160.0), id(&links, &parts, 245.0)), (left, right));
    }

    #[test]
    fn one_that_hides_the_other_is_told_for_a_while() {
        let mut trails = Trails::default();
        for x in [120, 130, 140, 150, 160, 170, 180] {
            trails.link(&parts(&[(x, 120), (400 - x, 120)]));
        }
        let alone = parts(&[(200, 120)]);
        let told: Vec<bool> = (0..40).map(|_| matches!(trails.link(&alone)[..], [Link::Joined(_)])).collect();
        assert!(told[..TrailTuning::default().hidden].iter().all(|&t| t) && !told[39], "{told:?}");
    }

    #[test]
    fn a_part_that_leaves_does_not_touch_the_other() {
        let mut trails = Trails::default();
        let apart = parts(&[(140, 120), (300, 120)]);
        let links = trails.link(&apart);
        let left = id(&links, &apart, 140.0);
        let alone = parts(&[(142, 120)]);
        for _ in 0..5 {
            assert_eq!(trails.link(&alone), [Link::One(left)]);
        }
    }
}
