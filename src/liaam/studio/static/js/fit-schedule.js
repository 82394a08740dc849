// Scheduling of requests and drawing, independent of the page.

/**
 * Sends one request at a time. While one is running, only the newest of the others is kept. So a drag is answered as
 * fast as the server can, without a queue of outdated requests.
 */
export class LatestWins {
  #task;
  #done;
  #failed;
  #waiting = null;
  #running = false;
  #epoch = 0;

  constructor(task, { done, failed = () => {} }) {
    this.#task = task;
    this.#done = done;
    this.#failed = failed;
  }

  get busy() {
    return this.#running;
  }

  ask(request) {
    this.#waiting = { request };
    if (!this.#running) this.#run();
  }

  /** Drop the waiting request, and the answer of a running one. */
  cancel() {
    this.#epoch += 1;
    this.#waiting = null;
  }

  async #run() {
    this.#running = true;
    while (this.#waiting) {
      const { request } = this.#waiting;
      const epoch = this.#epoch;
      this.#waiting = null;
      try {
        const answer = await this.#task(request);
        if (epoch === this.#epoch) this.#done(answer, request);
      } catch (error) {
        // Report the last failure only, since a newer request may succeed.
        if (epoch === this.#epoch && !this.#waiting) this.#failed(error, request);
      }
    }
    this.#running = false;
  }
}

/** Frames per second of the `most` newest frames of one drag. A pause of more than `gap` milliseconds starts another. */
export class FrameMeter {
  #times = [];
  #gap;
  #most;

  constructor(gap = 400, most = 600) {
    this.#gap = gap;
    this.#most = most;
  }

  tick(now = performance.now()) {
    const last = this.#times.at(-1);
    if (last !== undefined && now - last > this.#gap) this.#times = [];
    this.#times.push(now);
    if (this.#times.length > this.#most) this.#times.shift();
  }

  rate() {
    const n = this.#times.length;
    if (n < 2) return 0;
    return (1000 * (n - 1)) / (this.#times[n - 1] - this.#times[0]);
  }

  reset() {
    this.#times = [];
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
