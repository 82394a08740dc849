// Undo and redo with snapshots. States are immutable, so a snapshot is a reference. With each state goes its context:
// all else that the next click depends on, such as the active point. Undo and redo restore both.

const LIMIT = 500; // maximum number of steps
const NEAR = 20; // steps that a person takes back, by a held key, before they are saved and another tab hears of them
const BURST = 800; // milliseconds within which steps with the same key are merged

export class History {
  #state;
  #context = null; // of the state that was undone or redone last
  #past = [];
  #future = [];
  #last = { key: null, time: 0 };
  #limit;
  #burst;
  #now;

  /** @param {any} state the first state
   *  @param {{limit?: number, burst?: number, now?: () => number}} options */
  constructor(state, { limit = LIMIT, burst = BURST, now = () => performance.now() } = {}) {
    this.#state = state;
    this.#limit = limit;
    this.#burst = burst;
    this.#now = now;
  }

  get state() { return this.#state; }
  get context() { return this.#context; }
  /** The number of steps that can be undone. */
  get steps() { return this.#past.length; }

  /** Add a state. Steps with the same `key` in quick succession (held arrow keys) are merged. context: of the state
   *  before the step; beyond: {undo(), redo()} of what the step has changed beyond the state, or null. */
  push(state, what = "", key = null, context = null, beyond = null) {
    if (state === this.#state) return;
    const time = this.#now();
    const joins = key !== null && key === this.#last.key && time - this.#last.time < this.#burst && this.#past.length > 0;
    if (!joins) this.#past.push({ state: this.#state, what, context, beyond });
    if (this.#past.length > this.#limit) this.#past.shift();
    this.#state = state;
    this.#future = [];
    this.#last = { key, time };
  }

  get canUndo() { return this.#past.length > 0; }
  get canRedo() { return this.#future.length > 0; }

  get undoes() { return this.#past.at(-1)?.what ?? ""; }
  get redoes() { return this.#future.at(-1)?.what ?? ""; }
  /** What the step that can be undone, or redone, has changed beyond the state; null if nothing. */
  beyond(way) { return (way === "undo" ? this.#past : this.#future).at(-1)?.beyond ?? null; }
  /** context: of the present state. */
  undo(context = null) { return this.#travel(this.#past, this.#future, context); }
  redo(context = null) { return this.#travel(this.#future, this.#past, context); }

  /** Follow another tab, which has saved a state: what it has undone or redone is undone or redone here, and all else is
   *  one more step, so that Undo takes back the same in both. context: of the present state. */
  follow(state, isSame, what, context = null) {
    const find = (list) => [...list].reverse().slice(0, NEAR).findIndex((step) => isSame(step.state, state)) + 1;
    const [undone, redone] = [find(this.#past), find(this.#future)];
    if (!undone && !redone) return this.push(state, what, null, context);
    const isUndone = undone && (!redone || undone <= redone);
    for (let i = 0; i < (isUndone ? undone : redone); i += 1) {
      if (isUndone) this.undo(context);
      else this.redo(context);
    }
    return undefined;
  }

  #travel(from, to, now) {
    if (!from.length) return null;
    const { state, what, context, beyond } = from.pop();
    to.push({ state: this.#state, what, context: now, beyond });
    this.#state = state;
    this.#context = context;
    this.#last = { key: null, time: 0 };
    return state;
  }
}
