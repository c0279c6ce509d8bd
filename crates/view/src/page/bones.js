// The skeleton over the hand, and which joint is meant by a click.

// How near to a joint a click must be, pixels.
const NEAR = 30;

class Bones {
  constructor(canvas) {
    this.canvas = canvas;
    this.on = false;
    this.chosen = null;
    this.places = [];
  }

  // Where the joints are in the picture, for each hand, null behind the camera.
  place(matrix, posed, width, height) {
    this.places = posed.map(p => Array.from({ length: 25 }, (_, j) => {
      const at = project(matrix, jointPlace(p.frames, j));
      return at && [((at[0] + 1) / 2) * width, ((1 - at[1]) / 2) * height];
    }));
  }

  // The joint nearest to a place in the picture, { hand, joint }, if one is near.
  at(x, y) {
    let [best, least] = [null, NEAR];
    this.places.forEach((joints, hand) => joints.forEach((place, joint) => {
      const far = place ? Math.hypot(place[0] - x, place[1] - y) : Infinity;
      if (far < least) [best, least] = [{ hand, joint }, far];
    }));
    return best;
  }

  paint(width, height, dense) {
    this.canvas.width = Math.round(width * dense);
    this.canvas.height = Math.round(height * dense);
    const context = this.canvas.getContext("2d");
    context.scale(dense, dense);
    if (this.on) {
      this.places.forEach((joints, h) => this.skeleton(context, joints, hands[h].parents));
    }
    const { chosen } = this;
    const place = chosen && this.places[chosen.hand]?.[chosen.joint];
    if (!place) return;
    context.lineWidth = 2.5;
    context.strokeStyle = ink("--accent");
    context.beginPath();
    context.arc(place[0], place[1], 9, 0, 2 * Math.PI);
    context.stroke();
  }

  skeleton(context, joints, parents) {
    const lines = (width, colour) => {
      context.lineWidth = width;
      context.lineCap = "round";
      context.strokeStyle = colour;
      context.beginPath();
      joints.forEach((place, j) => {
        const above = joints[parents[j]];
        if (!place || !above) return;
        context.moveTo(...above);
        context.lineTo(...place);
      });
      context.stroke();
    };
    lines(5, ink("--panel"));
    lines(2.5, ink("--ink"));
    for (const place of joints) {
      if (!place) continue;
      context.beginPath();
      context.arc(place[0], place[1], 4, 0, 2 * Math.PI);
      context.fillStyle = ink("--accent");
      context.fill();
      context.lineWidth = 1.5;
      context.strokeStyle = ink("--panel");
      context.stroke();
    }
  }
}
