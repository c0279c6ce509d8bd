//! Mathematical morphology, connected components and distance maps of packed masks.

use super::mask::Mask;

/// Shrinks the set by the 8 neighbours of its complement; what lies outside the image does not count.
pub fn erode_square(mask: &Mask) -> Mask {
    repeat(mask, [true], !0, |a, b| a & b)
}

/// Shrinks the set by the 4 neighbours of its complement; what lies outside the image does not count.
pub fn erode_cross(mask: &Mask) -> Mask {
    repeat(mask, [false], !0, |a, b| a & b)
}

/// Grows the set by about a disc of `radius` pixels (an octagon).
pub fn dilate(mask: &Mask, radius: u32) -> Mask {
    repeat(mask, octagon(radius), 0, |a, b| a | b)
}

/// Shrinks the set by about a disc of `radius` pixels (an octagon).
pub fn erode(mask: &Mask, radius: u32) -> Mask {
    repeat(mask, octagon(radius), !0, |a, b| a & b)
}

/// The steps that make an octagon: whether each is to all 8 neighbours.
fn octagon(radius: u32) -> impl Iterator<Item = bool> {
    (0..radius).map(|step| step % 2 == 1)
}

/// Combines each pixel with its neighbours in each of `steps`, with all 8 where it says so, else with the 4 beside
/// it, 64 pixels at a time; `outside` fills in beyond the border.
fn repeat(
    mask: &Mask,
    steps: impl IntoIterator<Item = bool>,
    outside: u64,
    join: impl Fn(u64, u64) -> u64 + Copy,
) -> Mask {
    let mut out = mask.clone();
    let (count, height) = (mask.words_per_row(), mask.height() as usize);
    if count == 0 {
        return out;
    }
    let tail = mask.last_word_bits();
    // The rows as they are and joined sideways, with one beyond the border above and below.
    let mut rows = vec![outside; count * (height + 2)];
    let mut sideways = rows.clone();
    for square in steps {
        let framed = rows.chunks_exact_mut(count).zip(sideways.chunks_exact_mut(count)).skip(1);
        for (y, (row, joined)) in (0..mask.height()).zip(framed) {
            row.copy_from_slice(out.row(y));
            row[count - 1] |= outside & !tail;
            join_sideways(row, joined, outside, join);
        }
        let upright = if square { &sideways } else { &rows };
        for y in 0..height {
            let around = upright[y * count..][..count].iter().zip(&upright[(y + 2) * count..][..count]);
            let joined = sideways[(y + 1) * count..][..count].iter().zip(around);
            let words = out.row_mut(y as u32);
            for (word, (&here, (&above, &below))) in words.iter_mut().zip(joined) {
                *word = join(join(here, above), below);
            }
            words[count - 1] &= tail;
        }
    }
    out
}

/// Combines each pixel of a row with those beside it.
fn join_sideways(row: &[u64], joined: &mut [u64], outside: u64, join: impl Fn(u64, u64) -> u64) {
    let mut left = outside;
    for (i, (&here, joined)) in row.iter().zip(joined).enumerate() {
        let right = row.get(i + 1).copied().unwrap_or(outside);
        *joined = join(join(here, here << 1 | left >> 63), here >> 1 | right << 63);
        left = here;
    }
}

/// A connected part of a mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Component {
    /// Number of pixels.
    pub area: u32,
    /// A pixel of it: the first in row order.
    pub seed: (u32, u32),
    /// Whether it touches the image border.
    pub on_border: bool,
}

/// The connected parts of a mask, found run by run.
#[derive(Clone, Debug, Default)]
pub struct Components {
    runs: Vec<Run>,
    /// Per run, the number of its component.
    labels: Vec<u32>,
    /// The components, in row order of their seeds.
    pub list: Vec<Component>,
}

#[derive(Clone, Copy, Debug)]
struct Run {
    y: u32,
    start: u32,
    end: u32,
}

impl Components {
    /// Splits `mask`; diagonal neighbours are connected if `diagonal`.
    pub fn of(mask: &Mask, diagonal: bool) -> Self {
        let mut found = Self::default();
        let mut parents: Vec<u32> = Vec::new();
        let reach = u32::from(diagonal);
        let mut above = 0..0;
        for y in 0..mask.height() {
            let first = found.runs.len();
            let mut candidate = above.start;
            for (start, end) in mask.runs(y) {
                let this = found.runs.len() as u32;
                found.runs.push(Run { y, start, end });
                parents.push(this);
                while candidate < above.end && found.runs[candidate].end + reach <= start {
                    candidate += 1;
                }
                let mut other = candidate;
                while other < above.end && found.runs[other].start < end + reach {
                    let (a, b) = (root(&mut parents, other as u32), root(&mut parents, this));
                    // The smaller number wins, so that roots come in row order.
                    parents[a.max(b) as usize] = a.min(b);
                    other += 1;
                }
            }
            above = first..found.runs.len();
        }
        let mut numbers = vec![u32::MAX; found.runs.len()];
        for (i, run) in found.runs.iter().enumerate() {
            let root = root(&mut parents, i as u32) as usize;
            if numbers[root] == u32::MAX {
                numbers[root] = found.list.len() as u32;
                found.list.push(Component { area: 0, seed: (run.start, run.y), on_border: false });
            }
            let number = numbers[root];
            found.labels.push(number);
            let part = &mut found.list[number as usize];
            part.area += run.end - run.start;
            part.on_border |=
                run.y == 0 || run.y + 1 == mask.height() || run.start == 0 || run.end == mask.width();
        }
        found
    }

    /// Number of the largest component (the first of equals).
    pub fn largest(&self) -> Option<usize> {
        (0..self.list.len()).max_by_key(|&i| (self.list[i].area, std::cmp::Reverse(i)))
    }

    /// Draws the chosen components into `out`.
    pub fn draw(&self, out: &mut Mask, chosen: impl Fn(usize, &Component) -> bool) {
        for (run, &label) in self.runs.iter().zip(&self.labels) {
            if chosen(label as usize, &self.list[label as usize]) {
                out.fill_span(run.y, run.start as i32, run.end as i32);
            }
        }
    }

    /// The spans `(y, start, end)` with the number of their component.
    pub fn spans(&self) -> impl Iterator<Item = (usize, u32, u32, u32)> + '_ {
        self.runs.iter().zip(&self.labels).map(|(r, &label)| (label as usize, r.y, r.start, r.end))
    }
}

fn root(parents: &mut [u32], mut node: u32) -> u32 {
    while parents[node as usize] != node {
        let above = parents[node as usize];
        parents[node as usize] = parents[above as usize];
        node = above;
    }
    node
}

/// The largest 8-connected component.
pub fn largest_component(mask: &Mask) -> Mask {
    let parts = Components::of(mask, true);
    let mut out = Mask::new(mask.width(), mask.height());
    let chosen = parts.largest();
    parts.draw(&mut out, |i, _| Some(i) == chosen);
    out
}

/// The complement.
pub fn invert(mask: &Mask) -> Mask {
    let mut out = Mask::new(mask.width(), mask.height());
    for y in 0..mask.height() {
        out.fill_span(y, 0, mask.width() as i32);
    }
    out.subtract(mask);
    out
}

/// Squared Euclidean distances in pixels.
#[derive(Clone, Debug)]
pub struct DistanceMap {
    width: usize,
    squared: Vec<u32>,
}

/// The value of a distance map when there is nothing to measure to.
pub const FAR: u32 = u32::MAX;

impl DistanceMap {
    /// Distance of every pixel centre to the centre of the nearest pixel whose value is `to`; what lies
    /// outside the image does not count. Exact, in time linear in the number of pixels (Meijster 2000).
    pub fn to_value(mask: &Mask, to: bool) -> Self {
        let (width, height) = (mask.width() as usize, mask.height() as usize);
        let columns = column_distances(mask, to);
        let limit = (width + height) as u32;
        let mut squared = vec![FAR; width * height];
        let mut apexes = Vec::with_capacity(width);
        for y in 0..height {
            row_distances(
                &columns[y * width..][..width],
                limit,
                &mut apexes,
                &mut squared[y * width..][..width],
            );
        }
        Self { width, squared }
    }

    /// Squared distance at a pixel; [`FAR`] if there is nothing to measure to.
    pub fn squared(&self, x: u32, y: u32) -> u32 {
        let index = y as usize * self.width + x as usize;
        if (x as usize) < self.width { self.squared.get(index).copied().unwrap_or(FAR) } else { FAR }
    }

    /// The pixels at a squared distance for which `keep` holds.
    pub fn select(&self, keep: impl Fn(u32) -> bool) -> Mask {
        let height = self.squared.len().checked_div(self.width).unwrap_or(0);
        let mut out = Mask::new(self.width as u32, height as u32);
        for y in 0..height {
            let row = &self.squared[y * self.width..][..self.width];
            for (word, values) in out.row_mut(y as u32).iter_mut().zip(row.chunks(64)) {
                *word = values.iter().rev().fold(0, |bits, &d| bits << 1 | u64::from(keep(d)));
            }
        }
        out
    }
}

/// Distance of every pixel to the nearest in its column whose value is `to`; width and height together, or more, where
/// there is none.
fn column_distances(mask: &Mask, to: bool) -> Vec<u32> {
    let (width, height) = (mask.width() as usize, mask.height() as usize);
    let limit = (width + height) as u32;
    let [inside, outside] = if to { [0, limit] } else { [limit, 0] };
    let mut columns = vec![outside; width * height];
    for y in 0..height {
        for (start, end) in mask.runs(y as u32) {
            columns[y * width + start as usize..y * width + end as usize].fill(inside);
        }
        if y > 0 {
            let (above, here) = columns[(y - 1) * width..].split_at_mut(width);
            for (value, above) in here.iter_mut().zip(above) {
                *value = (*value).min(*above + 1);
            }
        }
    }
    for y in (0..height.saturating_sub(1)).rev() {
        let (here, below) = columns[y * width..].split_at_mut(width);
        for (value, below) in here.iter_mut().zip(below) {
            *value = (*value).min(*below + 1);
        }
    }
    columns
}

/// Squared distances along a row from the distances along its columns. Pixels at distance 0 part the row: between two of
/// them nothing beyond is nearer. `apexes` is scratch.
fn row_distances(column: &[u32], limit: u32, apexes: &mut Vec<(usize, i64)>, row: &mut [u32]) {
    let width = column.len();
    let mut begin = 0;
    while begin < width {
        if column[begin] == 0 {
            row[begin] = 0;
            begin += 1;
            continue;
        }
        let end = begin + column[begin..].iter().take_while(|&&g| g > 0).count();
        let (first, last) = (begin.saturating_sub(1), (end + 1).min(width));
        lower_envelope(&column[first..last], limit, apexes, &mut row[first..last]);
        begin = end;
    }
}

/// Squared distances along a piece of a row: the lower envelope of a parabola for each pixel whose column distance is below
/// `limit`. `apexes` is scratch.
fn lower_envelope(column: &[u32], limit: u32, apexes: &mut Vec<(usize, i64)>, row: &mut [u32]) {
    let width = column.len();
    let at = |x: i64, u: usize| {
        let g = i64::from(column[u]);
        (x - u as i64) * (x - u as i64) + g * g
    };
    apexes.clear();
    for u in 0..width {
        if column[u] >= limit {
            continue;
        }
        let mut start = 0i64;
        while let Some(&(v, from)) = apexes.last() {
            if at(from, v) > at(from, u) {
                apexes.pop();
                continue;
            }
            // The first pixel where the parabola at u lies below the one at v.
            let (gu, gv) = (i64::from(column[u]), i64::from(column[v]));
            let (a, b) = (u as i64, v as i64);
            start = (a * a - b * b + gu * gu - gv * gv).div_euclid(2 * (a - b)) + 1;
            break;
        }
        if apexes.is_empty() {
            start = 0;
        }
        if start < width as i64 {
            apexes.push((u, start));
        }
    }
    for (k, &(u, from)) in apexes.iter().enumerate() {
        let until = apexes.get(k + 1).map_or(width as i64, |next| next.1);
        for x in from..until {
            row[x as usize] = at(x, u) as u32;
        }
    }
}

/// Opening by a disc of `radius` pixels: what is left where the disc fits in.
pub fn open_disc(mask: &Mask, radius: f64) -> Mask {
    let eroded = invert(&within(mask, false, radius));
    if eroded.is_empty() {
        return eroded;
    }
    // A pixel of the eroded set keeps everything nearer than the background it was tested against.
    let mut opened = within(&eroded, true, radius);
    opened.intersect_with(mask);
    opened
}

/// The pixels whose centres are at most `radius` pixels from that of the nearest pixel whose value is `to`: what
/// [`DistanceMap::to_value`] tells, without the distances.
pub(crate) fn within(mask: &Mask, to: bool, radius: f64) -> Mask {
    let (width, height) = (mask.width() as usize, mask.height() as usize);
    let mut out = Mask::new(mask.width(), mask.height());
    // Less than what a column without such a pixel has, more than any distance.
    let longest = (width + height).saturating_sub(1) as f64;
    let limit = radius.min(longest).powi(2).floor();
    // How far a pixel reaches along its row, by its distance to the nearest in its column.
    let reach = |g: u32| (limit - f64::from(g).powi(2)).sqrt() as usize;
    let reaches: Vec<usize> = (0..).take_while(|&g| f64::from(g).powi(2) <= limit).map(reach).collect();
    let columns = column_distances(mask, to);
    let mut steps = vec![0i32; width + 1];
    for y in 0..height {
        steps.fill(0);
        for (x, &g) in columns[y * width..][..width].iter().enumerate() {
            if let Some(&reach) = reaches.get(g as usize) {
                steps[x.saturating_sub(reach)] += 1;
                steps[(x + reach + 1).min(width)] -= 1;
            }
        }
        let mut over = 0;
        for (word, steps) in out.row_mut(y as u32).iter_mut().zip(steps[..width].chunks(64)) {
            for (x, step) in steps.iter().enumerate() {
                over += step;
                *word |= u64::from(over > 0) << x;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn masks() -> impl Strategy<Value = Mask> {
        (1u32..140, 1u32..20, any::<u64>(), 1u32..16).prop_map(|(w, h, seed, density)| {
            let mut state = seed;
            Mask::from_fn(w, h, |_, _| {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (state >> 60) as u32 >= density
            })
        })
    }

    fn neighbour_rule(mask: &Mask, square: bool, grow: bool) -> Mask {
        Mask::from_fn(mask.width(), mask.height(), |x, y| {
            let mut any = false;
            let mut all = true;
            for dy in -1i64..=1 {
                for dx in -1i64..=1 {
                    let (u, v) = (i64::from(x) + dx, i64::from(y) + dy);
                    let inside = u >= 0 && v >= 0 && u < mask.width().into() && v < mask.height().into();
                    if inside && (square || dx == 0 || dy == 0) {
                        let on = mask.get(u as u32, v as u32);
                        any |= on;
                        all &= on;
                    }
                }
            }
            if grow { any } else { all }
        })
    }

    proptest! {
        #[test]
        fn neighbourhoods_match_pixel_by_pixel(mask in masks()) {
            prop_assert_eq!(dilate(&mask, 1), neighbour_rule(&mask, false, true));
            prop_assert_eq!(erode_square(&mask), neighbour_rule(&mask, true, false));
            prop_assert_eq!(erode_cross(&mask), neighbour_rule(&mask, false, false));
            prop_assert_eq!(invert(&invert(&mask)), mask);
        }

        #[test]
        fn components_match_flood_fill(mask in masks(), diagonal in any::<bool>()) {
            let found = Components::of(&mask, diagonal);
            let mut left = mask.clone();
            for (number, part) in found.list.iter().enumerate() {
                let mut stack = vec![part.seed];
                let mut filled = Mask::new(mask.width(), mask.height());
                let mut border = false;
                while let Some((x, y)) = stack.pop() {
                    if !left.get(x, y) { continue; }
                    left.set(x, y, false);
                    filled.set(x, y, true);
                    border |= x == 0 || y == 0 || x + 1 == mask.width() || y + 1 == mask.height();
                    for dy in -1i64..=1 { for dx in -1i64..=1 {
                        let (u, v) = (i64::from(x) + dx, i64::from(y) + dy);
                        if (diagonal || dx == 0 || dy == 0) && u >= 0 && v >= 0 {
                            stack.push((u as u32, v as u32));
                        }
                    } }
                }
                let mut drawn = Mask::new(mask.width(), mask.height());
                found.draw(&mut drawn, |i, _| i == number);
                prop_assert_eq!(&drawn, &filled);
                prop_assert_eq!((part.area, part.on_border), (filled.area(), border));
            }
            prop_assert!(left.is_empty());
        }

        #[test]
        fn distances_match_the_definition(mask in masks(), to in any::<bool>()) {
            let map = DistanceMap::to_value(&mask, to);
            let targets: Vec<(i64, i64)> = (0..mask.height()).flat_map(|y| (0..mask.width()).map(move |x| (x, y)))
                .filter(|&(x, y)| mask.get(x, y) == to).map(|(x, y)| (i64::from(x), i64::from(y))).collect();
            for y in 0..mask.height() { for x in 0..mask.width() {
                let want = targets.iter().map(|t| (t.0 - i64::from(x)).pow(2) + (t.1 - i64::from(y)).pow(2)).min();
                prop_assert_eq!(map.squared(x, y), want.map_or(FAR, |d| d as u32));
            } }
        }
    }

    proptest! {
        #[test]
        fn what_is_within_a_radius_is_what_distances_tell(
            mask in masks(), to in any::<bool>(), radius in 0.0f64..30.0, whole in any::<bool>()
        ) {
            let radius = if whole { radius.round() } else { radius };
            let map = DistanceMap::to_value(&mask, to);
            let near = map.select(|d| d != FAR && f64::from(d) <= radius * radius);
            prop_assert_eq!(within(&mask, to, radius), near);
        }
    }

    #[test]
    fn nothing_is_opened_to_nothing() {
        assert_eq!(open_disc(&Mask::new(0, 0), f64::INFINITY), Mask::new(0, 0));
    }

    #[test]
    fn opening_by_a_disc_removes_what_is_thinner() {
        let mask = Mask::from_fn(100, 60, |x, y| {
            let palm = (x as f64 - 30.0).hypot(y as f64 - 30.0) < 20.0;
            palm || ((40..95).contains(&x) && (27..33).contains(&y))
        });
        let opened = open_disc(&mask, 5.0);
        assert!(!opened.get(80, 30) && opened.get(30, 30) && opened.get(30, 12));
        let mut rest = mask.clone();
        rest.subtract(&opened);
        assert!(Components::of(&rest, true).list.iter().any(|c| c.area > 200));
    }
}
