// The original clip: frame by frame out of pictures, or as the film that it is.

class Clip {
  constructor(canvas, video) {
    this.canvas = canvas;
    this.video = video;
    this.ready = new Map();
    this.wanted = -1;
    this.shown = null;
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
      picture = createImageBitmap(this.video.bytes.slice(this.video.ends[i - 1] ?? 0, this.video.ends[i], "image/jpeg"));
      picture.then(p => { if (this.ready.has(i)) this.draw(i, p); else p.close(); }, () => {});
      this.ready.set(i, picture);
    }
    return picture;
  }

  // Where drawing is slow the wanted picture comes too late: the nearest one that is there stands for it.
  draw(i, picture) {
    if (this.wanted < 0 || !this.ready.has(i)) return;
    const off = k => Math.abs(k - this.wanted);
    if (i !== this.wanted && this.shown !== null && off(i) >= off(this.shown)) return;
    this.context.drawImage(picture, 0, 0);
    this.shown = i;
  }

  show(time) {
    const i = this.at(time);
    if (i === this.wanted) return;
    this.wanted = i;
    this.picture(i).then(p => this.draw(i, p), () => {});
    for (let k = 1; k <= 4 && i + k < this.video.times.length; k += 1) this.picture(i + k);
    for (const [k, picture] of this.ready) {
      if (this.ready.size <= 32) break;
      if (k >= i && k <= i + 4) continue;
      this.ready.delete(k);
      picture.then(p => p.close(), () => {});
    }
  }

  play() {}
  end() { this.wanted = -1; }
}

// How far a film may run ahead or lag while it plays, seconds.
const APART = 0.12;

class Film {
  // failed: told where the browser cannot play it.
  constructor(player, video, failed) {
    this.player = player;
    this.playing = false;
    // Times of the motion count from the clip's first picture, which need not be at 0.
    this.first = 0;
    this.shown = null;
    this.address = URL.createObjectURL(video.bytes.slice(0, video.bytes.size, video.film));
    player.addEventListener("error", () => failed(), { once: true });
    this.ready = false;
    const begin = first => {
      if (this.ready) return;
      Object.assign(this, { first, ready: true, shown: 0 });
      if (this.wanted !== undefined) this.play(this.playing, player.playbackRate);
    };
    const tell = (_, { mediaTime }) => {
      begin(mediaTime);
      this.shown = mediaTime - this.first;
      player.requestVideoFrameCallback(tell);
    };
    player.requestVideoFrameCallback?.(tell);
    // Where the browser does not tell which picture it shows, the first is at 0.
    player.addEventListener("loadeddata", () => setTimeout(begin, 300, 0), { once: true });
    player.muted = true;
    player.src = this.address;
  }

  show(time) {
    this.wanted = time;
    if (!this.ready) return;
    // Seeking to where a picture begins may end at the one before.
    const to = Math.min(time + this.first + Math.min(0.01, step / 4), this.player.duration || Infinity);
    const off = Math.abs(this.player.currentTime - to);
    if (this.playing ? off > APART * Math.max(1, this.player.playbackRate) : off > 1e-3) this.player.currentTime = to;
    // A film that has ended, or ran ahead of a page in the background, stands still.
    if (this.playing && this.player.paused && to < this.player.duration) this.player.play().catch(() => {});
  }

  play(on, speed) {
    this.playing = on;
    this.player.playbackRate = speed;
    if (!this.ready) return;
    if (on) this.player.play().catch(() => {});
    else {
      this.player.pause();
      if (this.wanted !== undefined) this.show(this.wanted);
    }
  }

  end() {
    this.player.removeAttribute("src");
    this.player.load();
    URL.revokeObjectURL(this.address);
  }
}
