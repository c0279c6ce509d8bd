// A curve of the last half minute, drawn once a second while it can be seen.

const SPAN = 30_000;
const ink = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

export class Strip {
  // least: the smallest value at the top of the axis.
  constructor(box, unit, least) {
    this.box = box;
    this.unit = unit;
    this.least = least;
    this.points = [];
    this.canvas = document.createElement("canvas");
    // Drawn without the graphics card, which hands are to have for themselves.
    this.context = this.canvas.getContext("2d", { willReadFrequently: true });
    box.append(this.canvas);
    this.seen = false;
    new IntersectionObserver(entries => {
      this.seen = entries.at(-1).isIntersecting;
      if (this.seen) this.draw();
    }).observe(box);
  }

  add(value) {
    this.points.push([performance.now(), value]);
  }

  draw() {
    const now = performance.now();
    while (this.points.length && this.points[0][0] < now - SPAN) this.points.shift();
    if (!this.seen || document.hidden) return;
    const [width, height] = [this.box.clientWidth, this.box.clientHeight];
    if (!width) return;
    const dense = Math.min(2, window.devicePixelRatio || 1);
    const size = [Math.round(width * dense), Math.round(height * dense)];
    const { canvas, context } = this;
    if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
    context.setTransform(dense, 0, 0, dense, 0, 0);
    context.clearRect(0, 0, width, height);
    const most = this.points.reduce((a, [, v]) => Math.max(a, v), this.least);
    const ten = 10 ** Math.floor(Math.log10(most));
    const top = [1, 2, 5, 10].map(k => k * ten).find(k => k >= most) ?? most;
    const [left, right, below] = [40, width - 4, height - 6];
    const y = v => below - (v / top) * (below - 10);
    context.font = "11px system-ui, sans-serif";
    context.fillStyle = ink("--muted");
    context.strokeStyle = ink("--line");
    context.lineWidth = 1;
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
