// Hands as thick lines along their bones, over a palm: what is shown until their skins are there, or where nothing draws those.

// Joints from the palm outwards, finger by finger, and those round the palm.
const FINGERS = [[1, 2, 3, 4], [6, 7, 8, 9], [11, 12, 13, 14], [16, 17, 18, 19], [21, 22, 23, 24]];
const PALM = [0, 1, 6, 11, 16, 21, 20];
// Breadth of a finger, metres.
const BREADTH = 0.017;
// Share of a finger's breadth that its border takes.
const BORDER = 0.12;

class Sketch {
  constructor(canvas) { this.canvas = canvas; }

  // hands: the frames of their joints, colours of their skins (sRGB, 0 to 255), whether they count.
  paint(matrix, hands, width, height, dense) {
    // A canvas waits for the graphics card of a browser that starts: none is asked for before there is a hand.
    if (!hands.length) return this.clear();
    const { canvas } = this;
    canvas.hidden = false;
    [canvas.width, canvas.height] = [width * dense, height * dense].map(Math.round);
    // Drawn without the graphics card, which may not be there yet, or be busy with skins.
    const context = canvas.getContext("2d", { willReadFrequently: true });
    context.scale(dense, dense);
    context.lineCap = context.lineJoin = "round";
    const screen = point => {
      const at = project(matrix, point);
      return at && [((at[0] + 1) / 2) * width, ((1 - at[1]) / 2) * height];
    };
    for (const { frames, colour, valid } of hands) {
      const joints = Array.from({ length: 25 }, (_, j) => screen(jointPlace(frames, j)));
      // The squares of three equal perpendicular steps add up to two in a projection along any direction.
      const wrist = jointPlace(frames, 0);
      const steps = [0, 1, 2].map(k => screen(wrist.map((v, i) => (i === k ? v + BREADTH : v))));
      if (joints.includes(null) || steps.includes(null)) continue;
      const squares = steps.map(step => (step[0] - joints[0][0]) ** 2 + (step[1] - joints[0][1]) ** 2);
      const breadth = Math.sqrt(squares.reduce((a, b) => a + b) / 2);
      const line = (chain, closed) => {
        context.beginPath();
        chain.forEach(j => context.lineTo(...joints[j]));
        if (closed) context.closePath();
      };
      const shape = (wider, style) => {
        context.lineWidth = breadth * (1 + wider);
        context.strokeStyle = context.fillStyle = style;
      };
      const shade = share => `rgb(${colour.map(v => Math.round(v * share)).join(" ")} / ${valid ? 1 : 0.5})`;
      const palm = () => { line(PALM, true); context.fill(); context.stroke(); };
      shape(BORDER, shade(0.72));
      palm();
      for (const finger of FINGERS) {
        shape(BORDER, shade(0.72));
        line(finger, false);
        context.stroke();
        shape(-BORDER, shade(1));
        context.stroke();
      }
      shape(-BORDER, shade(1));
      palm();
    }
    return undefined;
  }

  clear() { this.canvas.hidden = true; }
}
