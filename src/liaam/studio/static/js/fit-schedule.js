// Scheduling of requests and drawing, independent of the page.

/**
 * Sends one request at a time, or `atOnce`. Beyond these, only the newest is kept. So a drag is answered as fast as the
 * server can, without a queue of outdated requests. With two at once, the server computes while the page decodes.
 */
export class LatestWins {
  #running = 0;
  #waiting = null;
  #epoch = 0;
  #asked = 0;
  #answered = 0; // number of the newest request that was answered

  constructor(task, { done, failed = (_error, _request) => {}, atOnce = 1 }) {
    this.task = task;
    this.done = done;
    this.failed = failed;
    this.atOnce = atOnce;
  }

  get busy() { return this.#running > 0; }

  ask(request) {
    this.#waiting = { request };
    if (this.#running < this.atOnce) this.#run();
  }

  /** Drop the waiting request, and the answers of running ones. */
  cancel() {
    this.#epoch += 1;
    this.#waiting = null;
  }

  async #run() {
    this.#running += 1;
    while (this.#waiting) {
      const { request } = this.#waiting;
      const [epoch, number] = [this.#epoch, (this.#asked += 1)];
      const isWanted = () => epoch === this.#epoch && number > this.#answered;
      this.#waiting = null;
      try {
        const answer = await this.task(request);
        if (!isWanted()) continue;
        this.done(answer, request);
        this.#answered = number;
      } catch (error) {
        // Report the last failure only, since a newer request may succeed.
        if (isWanted() && !this.#waiting) this.failed(error, request);
      }
    }
    this.#running -= 1;
  }
}

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

  reset() {
    this.#times = [];
  }

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
  // The callback runs before the frame is painted; a task queued there runs after it.
  return new Promise((resolve) => {
    requestAnimationFrame(() => {
      const channel = new MessageChannel();
      channel.port1.onmessage = () => resolve(performance.now());
      channel.port2.postMessage(null);
    });
  });
}
