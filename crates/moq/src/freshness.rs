//! What of a sender's planes is live, and what comes out of a relay's cache.

use std::time::Duration;

use handcast_live::wire::Plane;

/// Most planes of one period that are held until one of them is live.
const MOST_HELD: usize = 4096;
/// Planes captured over so long tell by the time they took to come whether they are live.
const PACED: i64 = 500;

/// Holds the planes of a period back until one of them is live; those before it are then sent again, to be decoded and not shown.
///
/// A relay may give a joiner a period that ended long ago. A plane is live when the clocks say that it was captured within `stale`
/// of now; where clocks differ, when the planes come no faster than twice as fast as they were captured, which tells how much they
/// differ.
#[derive(Clone, Debug)]
pub(crate) struct Freshness {
    stale: i64,
    /// The room's clock behind this machine's, milliseconds, once the pace has told.
    skew: i64,
    held: Vec<Plane>,
    passing: bool,
    /// Whether planes are dropped up to the next period.
    paused: bool,
    /// When a plane came, and when it was captured.
    pace: Option<(Duration, u32)>,
}

impl Freshness {
    pub(crate) fn new(stale: Duration) -> Self {
        let stale = stale.as_millis().try_into().unwrap_or(i64::from(i32::MAX));
        Self { stale, skew: 0, held: Vec::new(), passing: false, paused: false, pace: None }
    }

    /// Drops planes up to the next period.
    pub(crate) fn pause(&mut self) {
        self.paused = true;
    }

    /// Takes a plane; gives those that can go on. `now` is this machine's clock, since 1970.
    pub(crate) fn push(&mut self, plane: Plane, now: Duration) -> Vec<Plane> {
        if plane.opens() {
            self.held.clear();
            (self.passing, self.paused) = (false, false);
            self.pace = None;
        }
        if self.paused {
            return Vec::new();
        }
        if !self.passing {
            self.passing = self.is_live(&plane, now);
        }
        if !self.passing {
            if self.held.len() < MOST_HELD {
                self.held.push(plane);
            }
            return Vec::new();
        }
        let mut planes: Vec<Plane> = self.held.drain(..).map(|held| Plane { replay: true, ..held }).collect();
        planes.push(plane);
        planes
    }

    fn is_live(&mut self, plane: &Plane, now: Duration) -> bool {
        let clock = now.as_millis() as u32;
        // Half the range before, half after.
        let age = i64::from(clock.wrapping_sub(plane.time_ms) as i32);
        if (age - self.skew).abs() <= self.stale {
            return true;
        }
        let (came, captured) = *self.pace.get_or_insert((now, plane.time_ms));
        let captured = i64::from(plane.time_ms.wrapping_sub(captured) as i32);
        if captured < PACED {
            return false;
        }
        let took = now.saturating_sub(came).as_millis() as i64;
        if 2 * took >= captured {
            self.skew = age;
            return true;
        }
        self.pace = Some((now, plane.time_ms));
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(index: u16, time_ms: u32) -> Plane {
        Plane { period: 4, index, time_ms, ..Plane::default() }
    }

    const NOW: Duration = Duration::from_millis(1_790_000_000_123);

    fn captured(ms_ago: u64) -> u32 {
        (NOW.as_millis() as u64 - ms_ago) as u32
    }

    #[test]
    fn what_is_live_passes_and_what_was_before_it_is_replayed() {
        let mut fresh = Freshness::new(Duration::from_secs(2));
        assert_eq!(fresh.push(plane(0, captured(20)), NOW), [plane(0, captured(20))]);
        // Late, but of the period that was live.
        assert_eq!(fresh.push(plane(1, captured(5000)), NOW).len(), 1);
        // A joiner gets the period from its beginning.
        assert!(fresh.push(plane(0, captured(2900)), NOW).is_empty());
        assert!(fresh.push(plane(1, captured(2100)), NOW).is_empty());
        let passed = fresh.push(plane(2, captured(1900)), NOW);
        assert_eq!(
            passed.iter().map(|p| (p.index, p.replay)).collect::<Vec<_>>(),
            [(0, true), (1, true), (2, false)]
        );
        assert_eq!(fresh.push(plane(3, captured(0)), NOW), [plane(3, captured(0))]);
    }

    #[test]
    fn after_a_pause_it_goes_on_with_a_period() {
        let mut fresh = Freshness::new(Duration::from_secs(2));
        assert_eq!(fresh.push(plane(0, captured(20)), NOW).len(), 1);
        fresh.pause();
        assert!(fresh.push(plane(1, captured(10)), NOW).is_empty());
        assert_eq!(fresh.push(plane(0, captured(0)), NOW), [plane(0, captured(0))]);
    }

    #[test]
    fn an_old_period_is_dropped() {
        let mut fresh = Freshness::new(Duration::from_secs(2));
        for k in 0..600 {
            let came = NOW + Duration::from_millis(u64::from(k) / 10);
            assert!(fresh.push(plane(k, captured(40_000 - 33 * u64::from(k))), came).is_empty(), "{k}");
        }
        assert_eq!(fresh.push(plane(0, captured(10)), NOW), [plane(0, captured(10))]);
    }

    #[test]
    fn clocks_that_differ_are_told_by_the_pace() {
        for ahead in [-3_600_000i64, 3_600_000] {
            let mut fresh = Freshness::new(Duration::from_secs(2));
            let time = |k: u64| (captured(0) as i64 + ahead + 33 * k as i64) as u32;
            let mut begun = None;
            // Three seconds out of the cache at once, then live ones.
            for k in 0..200u64 {
                let came = NOW + Duration::from_millis(33 * k.saturating_sub(90));
                if !fresh.push(plane(k as u16, time(k)), came).is_empty() {
                    begun.get_or_insert(k);
                }
            }
            let begun = begun.unwrap();
            assert!(
                (106..=125).contains(&begun),
                "half a second to a second after the live ones begin: {begun}"
            );
            // The next period is known to be live at once.
            let came = NOW + Duration::from_millis(33 * 110);
            assert_eq!(fresh.push(plane(0, time(200)), came).len(), 1);
        }
    }

    /// Planes with when they come, and those that pass: number, whether replayed, and time, moved to this machine's clock.
    type Told = Vec<(u16, bool, u32)>;

    /// A cached period at once, then one from a sender whose clock is an hour ahead, out of the cache up to now and on.
    fn course() -> Vec<(Plane, Duration)> {
        let ahead = 3_600_000;
        let cached = (0..60).map(|k| (plane(k, captured(40_000 - 33 * u64::from(k))), NOW));
        let other = (0..200u64).map(move |k| {
            let came = NOW + Duration::from_millis(33 * k.saturating_sub(90));
            (plane(k as u16, (captured(0) as u64 + ahead + 33 * k) as u32), came)
        });
        let next = NOW + Duration::from_millis(33 * 111);
        let late = (0..3u16)
            .map(move |k| (plane(k, (captured(0) as u64 + ahead + 6600 + 33 * u64::from(k)) as u32), next));
        cached.chain(other).chain(late).collect()
    }

    #[test]
    #[ignore = "needs node"]
    fn the_page_tells_the_same() {
        let mut fresh = Freshness::new(Duration::from_secs(2));
        let told: Told = course()
            .into_iter()
            .flat_map(|(plane, now)| {
                let passed = fresh.push(plane, now);
                let skew = fresh.skew;
                passed.into_iter().map(move |p| (p.index, p.replay, (i64::from(p.time_ms) + skew) as u32))
            })
            .collect();
        assert!(told.len() > 200);
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("freshness.mjs"), include_str!("page/freshness.js")).unwrap();
        let course: Vec<_> =
            course().iter().map(|(p, now)| (p.index, p.time_ms, now.as_millis() as u64)).collect();
        let script = format!(
            "import {{ Freshness }} from './freshness.mjs';\nconst fresh = new Freshness();\n\
             const told = {}.flatMap(([index, time, now]) => fresh.push({{ index, time }}, now));\n\
             console.log(JSON.stringify(told.map(p => [p.index, Boolean(p.replay), p.time])));",
            serde_json::to_string(&course).unwrap()
        );
        std::fs::write(folder.path().join("tell.mjs"), script).unwrap();
        let output = std::process::Command::new("node").arg(folder.path().join("tell.mjs")).output().unwrap();
        let page: Told = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(page, told);
    }
}
