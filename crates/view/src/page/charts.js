// Curves and bars over time, with a cursor at the instant that is shown.

const LEFT = 34;
const BOTTOM = 18;
const TOP = 6;
const RIGHT = 8;

// A round step that cuts `span` into at most `parts`.
function roundStep(span, parts) {
  const rough = span / Math.max(1, parts);
  const ten = 10 ** Math.floor(Math.log10(rough || 1));
  return [1, 2, 5, 10].map(k => k * ten).find(s => s >= rough) ?? 10 * ten;
}

const ink = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

class Chart {
  constructor(box, seek) {
    this.box = box;
    this.canvas = document.createElement("canvas");
    this.cursor = document.createElement("div");
    this.cursor.className = "cursor";
    box.append(this.canvas, this.cursor);
    this.range = [0, 1];
    const go = event => {
      const x = event.clientX - box.getBoundingClientRect().left;
      seek(start + ((x - LEFT) / this.across()) * (end - start));
    };
    box.addEventListener("pointerdown", event => { box.setPointerCapture(event.pointerId); go(event); });
    box.addEventListener("pointermove", event => { if (box.hasPointerCapture(event.pointerId)) go(event); });
    new ResizeObserver(() => this.draw()).observe(box);
  }

  across() { return Math.max(1, this.box.clientWidth - LEFT - RIGHT); }
  x(time) { return LEFT + ((time - start) / Math.max(1e-9, end - start)) * this.across(); }
  y(value) {
    const [low, high] = this.range;
    return TOP + (1 - (value - low) / Math.max(1e-9, high - low)) * (this.height - TOP - BOTTOM);
  }

  place(time) { this.cursor.style.transform = `translateX(${this.x(time).toFixed(1)}px)`; }

  // Grid and labels; gives the context to draw into.
  begin() {
    const [width, height] = [this.box.clientWidth, this.box.clientHeight];
    const dense = Math.min(3, window.devicePixelRatio || 1);
    this.canvas.width = Math.max(1, Math.round(width * dense));
    this.canvas.height = Math.max(1, Math.round(height * dense));
    this.height = height;
    const context = this.canvas.getContext("2d");
    context.scale(dense, dense);
    context.font = "11px system-ui, sans-serif";
    context.fillStyle = ink("--muted");
    context.strokeStyle = ink("--line");
    context.lineWidth = 1;
    const [low, high] = this.range;
    const rise = roundStep(high - low, Math.max(2, height / 34));
    context.textAlign = "right";
    context.textBaseline = "middle";
    for (let v = Math.ceil(low / rise) * rise; v <= high + 1e-9; v += rise) {
      const y = Math.round(this.y(v)) + 0.5;
      context.beginPath();
      context.moveTo(LEFT, y);
      context.lineTo(width - RIGHT, y);
      context.stroke();
      context.fillText(`${Math.round(v)}${this.unit ?? ""}`, LEFT - 5, y);
    }
    context.textAlign = "center";
    context.textBaseline = "alphabetic";
    const pace = roundStep(end - start, Math.max(2, width / 70));
    for (let t = Math.ceil(start / pace) * pace; t <= end + 1e-9; t += pace) {
      const label = `${Number(t.toFixed(3))} s`;
      const half = context.measureText(label).width / 2;
      context.fillText(label, Math.min(width - half - 1, Math.max(half, this.x(t))), height - 4);
    }
    return context;
  }

  draw() {
    if (!count || !this.box.clientWidth) return;
    this.content(this.begin());
    this.place(this.now ?? start);
  }

  show(time) {
    this.now = time;
    this.place(time);
  }
}

class Curves extends Chart {
  unit = "°";
  lines = [];

  // lines: value by instant (degrees), validity by instant, colour, whether dashed, and whether others stand back.
  set(lines) {
    this.lines = lines;
    let [low, high] = [0, 10];
    for (const line of lines) {
      for (let i = 0; i < count; i += 1) {
        const v = line.value(i);
        low = Math.min(low, v);
        high = Math.max(high, v);
      }
    }
    const margin = (high - low) * 0.05;
    this.range = [low - (low < 0 ? margin : 0), high + margin];
    this.draw();
  }

  content(context) {
    context.lineJoin = "round";
    // Where more than three points share a pixel, a curve would fill all that it reaches.
    const draw = count > 3 * this.across() ? this.envelope : this.curve;
    for (const line of this.lines) {
      context.strokeStyle = context.fillStyle = ink(line.colour);
      context.lineWidth = line.strong ? 2.75 : 1.75;
      context.globalAlpha = line.faint ? 0.3 : 1;
      context.setLineDash(line.dashed ? [5, 3] : []);
      draw.call(this, context, line);
    }
    context.setLineDash([]);
    context.globalAlpha = 1;
  }

  curve(context, line) {
    context.beginPath();
    let down = false;
    for (let i = 0; i < count; i += 1) {
      if (!line.valid(i)) { down = false; continue; }
      const [x, y] = [this.x(times[i]), this.y(line.value(i))];
      if (down) context.lineTo(x, y); else context.moveTo(x, y);
      down = true;
    }
    context.stroke();
  }

  // What a line reaches from and to in each pixel, lightly, and its mean.
  envelope(context, line) {
    const runs = [];
    let run = null;
    for (let i = 0; i < count; i += 1) {
      if (!line.valid(i)) { run = null; continue; }
      if (!run) runs.push(run = []);
      const [x, value] = [Math.floor(this.x(times[i])), line.value(i)];
      const last = run[run.length - 1];
      if (last?.x !== x) run.push({ x, low: value, high: value, sum: value, n: 1 });
      else Object.assign(last, { low: Math.min(last.low, value), high: Math.max(last.high, value), sum: last.sum + value, n: last.n + 1 });
    }
    const alpha = context.globalAlpha;
    for (const columns of runs) {
      context.globalAlpha = alpha * 0.1;
      context.beginPath();
      for (const { x, high } of columns) context.lineTo(x + 0.5, this.y(high));
      for (const { x, low } of columns.toReversed()) context.lineTo(x + 0.5, this.y(low));
      context.fill();
      context.globalAlpha = alpha;
      context.lineWidth = line.strong ? 2 : 1;
      context.beginPath();
      for (const { x, sum, n } of columns) context.lineTo(x + 0.5, this.y(sum / n));
      context.stroke();
    }
  }
}

class Bars extends Chart {
  // bits and kind (0 none, 1 P, 2 I) of each instant.
  set({ bits, kinds }) {
    this.bits = bits;
    this.kinds = kinds;
    // I planes cost many times as much as P planes: their bars end at the top, with the number beside.
    const most = kind => bits.reduce((top, b, i) => (kinds[i] === kind ? Math.max(top, b) : top), 0);
    this.range = [0, 1.3 * Math.min(2.2 * (most(1) || most(2)), Math.max(most(1), most(2), 8))];
    this.draw();
  }

  content(context) {
    if (!this.bits) return;
    // The tallest bar of each pixel stands for it; I planes are in front.
    const columns = new Map();
    for (let i = 0; i < count; i += 1) {
      const x = Math.floor(this.x(times[i]));
      const column = columns.get(x) ?? { p: 0, i: 0 };
      const key = this.kinds[i] === 2 ? "i" : "p";
      column[key] = Math.max(column[key], this.bits[i]);
      columns.set(x, column);
    }
    const wide = Math.max(1, Math.min(12, Math.floor(this.across() / count) - 1));
    const floor = this.y(0);
    const [plain, intra] = [ink("--bars"), ink("--accent")];
    let busy = -1;
    for (const [x, { p, i }] of columns) {
      context.fillStyle = plain;
      context.fillRect(x, this.y(p), wide, floor - this.y(p));
      if (!i) continue;
      context.fillStyle = intra;
      const w = Math.max(2, wide);
      const top = Math.max(TOP, this.y(i));
      context.fillRect(x, top, w, floor - top);
      const label = `I ${i}`;
      if (x < busy) continue;
      const left = x + w + context.measureText(label).width + 6 > this.box.clientWidth;
      context.textAlign = left ? "right" : "left";
      context.fillText(label, left ? x - 4 : x + w + 4, top + 9);
      busy = x + w + context.measureText(label).width + 10;
    }
  }
}
