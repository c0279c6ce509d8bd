// What of a sender's planes is live, and what comes out of a relay's cache: as src/freshness.rs.

// Most planes of one period that are held until one of them is live.
const MOST_HELD = 4096;
// Milliseconds: planes captured longer ago are of a cached period; those captured over so long tell by the time they took whether
// they are live.
const [STALE, PACED] = [2000, 500];

// Holds the planes of a period back until one of them is live; those before it are then replayed. Times are moved to this page's
// clock where the sender's differs.
export class Freshness {
  skew = 0;
  held = [];
  passing = false;
  paused = false;
  pace = null;

  // Drops planes up to the next period.
  pause() { this.paused = true; }

  // Takes a plane; gives those that can go on. now: this page's clock, milliseconds since 1970.
  push(plane, now) {
    if (plane.index === 0) {
      this.held = [];
      this.passing = this.paused = false;
      this.pace = null;
    }
    if (this.paused) return [];
    this.passing ||= this.isLive(plane, now);
    if (!this.passing) {
      if (this.held.length < MOST_HELD) this.held.push(plane);
      return [];
    }
    const planes = this.held.map(held => ({ ...held, replay: true }));
    this.held = [];
    planes.push(plane);
    return planes.map(plane => ({ ...plane, time: (plane.time + this.skew) >>> 0 }));
  }

  isLive(plane, now) {
    const age = ((now >>> 0) - plane.time) | 0;
    if (Math.abs(age - this.skew) <= STALE) return true;
    this.pace ??= [now, plane.time];
    const [came, first] = this.pace;
    const captured = (plane.time - first) | 0;
    if (captured < PACED) return false;
    if (2 * (now - came) >= captured) {
      this.skew = age;
      return true;
    }
    this.pace = [now, plane.time];
    return false;
  }
}
