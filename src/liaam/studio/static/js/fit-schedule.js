// Timing of drawing, independent of the page.

const GAP = 400; // milliseconds without a frame after which another drag begins

/** Frames per second of the `most` newest frames of one drag; gap: milliseconds that end it. */
export class FrameMeter {
  #times = [];

  constructor(most = 600, gap = GAP) {
    this.most = most;
    this.gap = gap;
  }

  /** Whether enough frames are counted. */
  get isFull() { return this.#times.length === this.most; }
  reset() { this.#times = []; }

  tick(now = performance.now()) {
    if (now - this.#times.at(-1) > this.gap) this.reset();
    this.#times.push(now);
    if (this.#times.length > this.most) this.#times.shift();
  }

  rate() {
    const n = this.#times.length;
    if (n < 2) return 0;
    return (1000 * (n - 1)) / (this.#times[n - 1] - this.#times[0]);
  }
}

/** Promise that resolves when the requested drawing has been painted. */
export function afterPaint() {
  const channel = new MessageChannel();
  // The callback runs before the frame is painted; a task queued there runs after it.
  requestAnimationFrame(() => channel.port2.postMessage(null));
  return new Promise((resolve) => { channel.port1.onmessage = () => resolve(performance.now()); });
}
