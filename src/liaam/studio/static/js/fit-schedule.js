// Scheduling of requests and drawing, independent of the page.

/**
 * Sends one request at a time. While one is running, only the newest of the others is kept. So a drag is answered as
 * fast as the server can, without a queue of outdated requests.
 */
export class LatestWins {
  busy = false;
  #waiting = null;
  #epoch = 0;

  constructor(task, { done, failed = (_error, _request) => {} }) {
    this.task = task;
    this.done = done;
    this.failed = failed;
  }

  ask(request) {
    this.#waiting = { request };
    if (!this.busy) this.#run();
  }

  /** Drop the waiting request, and the answer of a running one. */
  cancel() {
    this.#epoch += 1;
    this.#waiting = null;
  }

  async #run() {
    this.busy = true;
    while (this.#waiting) {
      const { request } = this.#waiting;
      const epoch = this.#epoch;
      this.#waiting = null;
      try {
        const answer = await this.task(request);
        if (epoch === this.#epoch) this.done(answer, request);
      } catch (error) {
        // Report the last failure only, since a newer request may succeed.
        if (epoch === this.#epoch && !this.#waiting) this.failed(error, request);
      }
    }
    this.busy = false;
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
