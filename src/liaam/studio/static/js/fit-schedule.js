// When to ask and when to draw. Nothing in this module touches the page.

/**
 * Asks for the newest of many wishes, one at a time: what was wished for while an answer was under way is dropped in
 * favour of the last wish. So a drag is answered as fast as the server can, and never by a queue of old answers.
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

  ask(wish) {
    this.#waiting = { wish };
    if (!this.#running) this.#run();
  }

  /** Forget what is wished for; an answer that is under way is dropped. */
  cancel() {
    this.#epoch += 1;
    this.#waiting = null;
  }

  async #run() {
    this.#running = true;
    while (this.#waiting) {
      const { wish } = this.#waiting;
      const epoch = this.#epoch;
      this.#waiting = null;
      try {
        const answer = await this.#task(wish);
        if (epoch === this.#epoch) this.#done(answer, wish);
      } catch (error) {
        // A newer wish may well succeed: only the last failure is worth telling.
        if (epoch === this.#epoch && !this.#waiting) this.#failed(error, wish);
      }
    }
    this.#running = false;
  }
}

/** Rate of the frames drawn during one drag, frames per second. A pause of more than `gap` ms begins another drag. */
export class FrameMeter {
  #times = [];
  #gap;

  constructor(gap = 400) {
    this.#gap = gap;
  }

  tick(now = performance.now()) {
    const last = this.#times.at(-1);
    if (last !== undefined && now - last > this.#gap) this.#times = [];
    this.#times.push(now);
    if (this.#times.length > 600) this.#times.shift();
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

/** Promise of the moment when what was asked to be drawn by now has been painted. */
export function afterPaint() {
  // The first callback runs before the frame is painted; a task queued there runs after it.
  return new Promise((resolve) => {
    requestAnimationFrame(() => {
      const channel = new MessageChannel();
      channel.port1.onmessage = () => resolve(performance.now());
      channel.port2.postMessage(null);
    });
  });
}
