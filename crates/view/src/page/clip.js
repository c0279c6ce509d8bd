// The original clip, frame by frame.

class Clip {
  constructor(canvas, video) {
    this.canvas = canvas;
    this.video = video;
    this.ready = new Map();
    this.wanted = -1;
    canvas.width = video.width;
    canvas.height = video.height;
    this.context = canvas.getContext("2d");
  }

  // Number of the picture nearest to a time.
  at(time) {
    const list = this.video.times;
    let [low, high] = [0, list.length];
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (list[middle] <= time) low = middle; else high = middle;
    }
    return low + 1 < list.length && list[low + 1] - time < time - list[low] ? low + 1 : low;
  }

  // A decoded picture; a few dozen around the one that is shown are kept.
  picture(i) {
    let picture = this.ready.get(i);
    if (!picture) {
      picture = createImageBitmap(new Blob([bytes(this.video.pictures[i])], { type: "image/jpeg" }));
      picture.then(p => { if (this.ready.has(i)) this.latest(i, p); else p.close(); }, () => {});
      this.ready.set(i, picture);
    }
    return picture;
  }

  latest(i, picture) {
    if (i !== this.wanted) return;
    this.context.drawImage(picture, 0, 0);
    this.shown = i;
  }

  show(time) {
    const i = this.at(time);
    if (i === this.wanted) return;
    this.wanted = i;
    this.picture(i).then(p => this.latest(i, p), () => {});
    for (let k = 1; k <= 4 && i + k < this.video.times.length; k += 1) this.picture(i + k);
    for (const [k, picture] of this.ready) {
      if (this.ready.size <= 32) break;
      if (k >= i && k <= i + 4) continue;
      this.ready.delete(k);
      picture.then(p => p.close(), () => {});
    }
  }
}
