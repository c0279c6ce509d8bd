// How sharp pictures are: a slow graphics card makes up for it, so that hands come in time.

// So many pictures are timed together. In the middle they are slow from so many display intervals on, and swift up to so many.
const PACED = 8;
const [SLOW, SWIFT] = [1.5, 1.2];
// The least share of the screen's sharpness, and of what it is lowered to at a time.
const [LEAST, STEP] = [0.25, 0.75];
// Swift pictures after which it is raised; twice as many each time that was too much, up to the most.
const [PATIENCE, MOST_PATIENCE] = [64, 1024];
// Pictures after which it has been seen whether that was too much.
const TRIED = 4 * PACED;
// Milliseconds from one of the screen's pictures to the next: before it is known, and the most of those that tell.
const [USUAL, MOST_IDLE] = [1000 / 60, 60];

const middle = list => [...list].sort((a, b) => a - b)[list.length >> 1];

export class Sharpness {
  #took = [];
  #idle = [];
  #swift = 0;
  #patience = PATIENCE;
  // Pictures since it was raised.
  #raised = Infinity;
  share = 1;

  get interval() { return this.#idle.length < PACED ? USUAL : middle(this.#idle); }

  // The screen's next picture came so many milliseconds after one; `drawn`: hands were drawn for that.
  next(took, drawn) {
    if (!drawn) {
      this.#idle.push(took);
      if (this.#idle.length > MOST_IDLE) this.#idle.shift();
      return;
    }
    this.#took.push(took);
    this.#raised += 1;
    if (this.#took.length < PACED) return;
    const intervals = middle(this.#took) / this.interval;
    this.#took = [];
    if (this.#raised > TRIED && this.#raised < Infinity) [this.#patience, this.#raised] = [PATIENCE, Infinity];
    if (intervals > SLOW) {
      if (this.#raised <= TRIED) this.#patience = Math.min(MOST_PATIENCE, 2 * this.#patience);
      this.share = Math.max(LEAST, this.share * STEP);
      this.#swift = 0;
    } else if (intervals < SWIFT && this.share < 1) {
      this.#swift += PACED;
      if (this.#swift < this.#patience) return;
      this.share = Math.min(1, this.share / STEP);
      [this.#swift, this.#raised] = [0, 0];
    }
  }
}
