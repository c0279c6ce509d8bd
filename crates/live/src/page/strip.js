// A curve of the last half minute.

const SPAN = 30_000;
const ink = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

export class Strip {
  constructor(box, unit) {
    this.box = box;
    this.unit = unit;
    this.points = [];
    this.canvas = document.createElement("canvas");
    box.append(this.canvas);
    setInterval(() => this.draw(), 250);
  }

  add(value) {
    this.points.push([performance.now(), value]);
  }

  draw() {
    const now = performance.now();
    while (this.points.length && this.points[0][0] < now - SPAN) this.points.shift();
    const [width, height] = [this.box.clientWidth, this.box.clientHeight];
    if (!width || document.hidden) return;
    const dense = Math.min(2, window.devicePixelRatio || 1);
    this.canvas.width = Math.round(width * dense);
    this.canvas.height = Math.round(height * dense);
    const context = this.canvas.getContext("2d");
    context.scale(dense, dense);
    const most = this.points.reduce((a, [, v]) => Math.max(a, v), 1e-9);
    const ten = 10 ** Math.floor(Math.log10(most));
    const top = [1, 2, 5, 10].map(k => k * ten).find(k => k >= most) ?? most;
    const [left, right, below] = [40, width - 4, height - 6];
    const y = v => below - (v / top) * (below - 10);
    context.font = "11px system-ui, sans-serif";
    context.fillStyle = ink("--muted");
    context.strokeStyle = ink("--line");
    context.textAlign = "right";
    context.textBaseline = "middle";
    for (const v of [0, top / 2, top]) {
      context.beginPath();
      context.moveTo(left, y(v));
      context.lineTo(right, y(v));
      context.stroke();
      context.fillText(String(v), left - 4, y(v));
    }
    context.textAlign = "left";
    context.fillText(this.unit, left + 4, y(top) + 8);
    context.strokeStyle = ink("--accent");
    context.lineWidth = 1.5;
    context.beginPath();
    this.points.forEach(([time, v], i) => {
      const x = right - ((now - time) / SPAN) * (right - left);
      if (i) context.lineTo(x, y(v)); else context.moveTo(x, y(v));
    });
    context.stroke();
  }
}
