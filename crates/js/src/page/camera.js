// A camera that orbits the hand, and what moves it: mouse, touch.

// Half the height of the picture at a distance of 1: 28 degrees from edge to edge.
const HALF = Math.tan((14 * Math.PI) / 180);
// Flesh around the joints, metres.
const FLESH = 0.024;

class Orbit {
  // reach: for the whole motion and for a hand kept in the middle, the centre and the points around it.
  constructor(reach) {
    this.reach = reach;
    this.follow = false;
    this.centre = reach.all.centre;
    this.reset();
  }

  reset() {
    this.yaw = 0;
    this.pitch = 0;
    this.zoom = 1;
    this.shift = [0, 0, 0];
  }

  // Distance at which the points, seen from the front, fill a picture of this shape up to a margin.
  fit(points, aspect) {
    const inside = 0.94;
    const [across, upright] = [HALF * aspect * inside, HALF * inside];
    let distance = 0.05;
    for (const [x, y, z] of points) {
      const beside = Math.max((Math.abs(x) + FLESH) / across, (Math.abs(y) + FLESH) / upright);
      distance = Math.max(distance, z + beside);
    }
    return distance;
  }

  // For a picture of so many pixels.
  update(width, height) {
    const [sy, cy, sp, cp] = [Math.sin(this.yaw), Math.cos(this.yaw), Math.sin(this.pitch), Math.cos(this.pitch)];
    const back = [sy * cp, sp, cy * cp];
    const right = [cy, 0, -sy];
    const up = cross(back, right);
    const target = add(this.follow ? this.centre : this.reach.all.centre, this.shift);
    const aspect = width / Math.max(1, height);
    const points = this.follow ? this.reach.one.points : this.reach.all.points;
    this.distance = this.fit(points, aspect) / this.zoom;
    this.axes = [right, up, back];
    this.eye = add(target, back, this.distance);
    this.view = viewMatrix(right, up, back, this.eye);
    const far = this.distance + this.reach.all.radius + Math.hypot(...add(target, this.reach.all.centre, -1));
    this.projection = perspective(HALF, aspect, Math.max(0.01, this.distance / 50), far);
    this.matrix = product(this.projection, this.view);
    this.height = height;
  }

  turn(dx, dy) {
    this.yaw -= dx;
    this.pitch = Math.min(1.5, Math.max(-1.5, this.pitch + dy));
  }

  // Moves what is seen by so many pixels, x right, y down.
  move(dx, dy) {
    const metres = (2 * HALF * this.distance) / Math.max(1, this.height);
    const [right, up] = this.axes;
    this.shift = add(add(this.shift, right, -dx * metres), up, dy * metres);
  }

  scale(factor) {
    this.zoom = Math.min(8, Math.max(0.3, this.zoom * factor));
  }
}

// How far a pointer may move in a click, pixels.
const STILL = 4;

// Pointers and wheel on `canvas` move `orbit`; `changed` is told, and `clicked` of a place without a move.
function steer(canvas, orbit, changed, clicked = () => {}) {
  const fingers = new Map();
  let press = null;
  const spread = () => {
    const [a, b] = [...fingers.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, gap: Math.max(10, Math.hypot(a.x - b.x, a.y - b.y)) };
  };
  canvas.addEventListener("contextmenu", event => event.preventDefault());
  canvas.addEventListener("pointerdown", event => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    press = fingers.size === 1 && event.button === 0 ? { x: event.clientX, y: event.clientY } : null;
  });
  canvas.addEventListener("pointerup", event => {
    if (press && fingers.has(event.pointerId)) {
      const box = canvas.getBoundingClientRect();
      clicked(event.clientX - box.left, event.clientY - box.top);
    }
    press = null;
  });
  for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) {
    canvas.addEventListener(kind, event => fingers.delete(event.pointerId));
  }
  canvas.addEventListener("pointermove", event => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const [dx, dy] = [event.clientX - before.x, event.clientY - before.y];
    if (press && Math.hypot(event.clientX - press.x, event.clientY - press.y) <= STILL) return;
    press = null;
    const old = fingers.size === 2 ? spread() : null;
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (old) {
      const now = spread();
      orbit.scale(now.gap / old.gap);
      orbit.move(now.x - old.x, now.y - old.y);
    } else if (event.buttons & 6 || event.shiftKey) {
      orbit.move(dx, dy);
    } else {
      orbit.turn(dx * 0.008, dy * 0.008);
    }
    changed();
  });
  canvas.addEventListener("wheel", event => {
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 30 : 1;
    orbit.scale(Math.exp(-Math.max(-200, Math.min(200, event.deltaY * lines)) * 0.0015));
    changed();
  }, { passive: false });
}
