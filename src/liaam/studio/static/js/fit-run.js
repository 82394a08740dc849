// Asking for fits, remembering them, and saying what came of them.

import { api } from "./api.js";

/** Fits remembered, so that going back to a picture shows its fit at once. The server keeps 64. */
const KEPT = 32;

/** What an error says where the server has forgotten a fit. */
export const isGone = (error) => error?.status === 404;

export class FitStore {
  #kept = new Map();

  constructor(state) {
    this.state = state;
    // Errors are against the landmarks as they were.
    state.addEventListener("landmarks", ({ detail }) => this.#drop((fit) => fit.picture === detail.name));
  }

  /** Fit a source; start: null, {box} or {shape}. */
  async run(source, method, start = null) {
    await source.ready;
    const asked = { ...source.reference, method, start };
    const fit = cleaned(await this.state.send((folder) => api.post(api.url("fits"), { ...asked, folder })));
    const key = this.#key(source, method);
    this.#kept.delete(key);
    this.#kept.set(key, fit);
    if (this.#kept.size > KEPT) this.#kept.delete(this.#kept.keys().next().value);
    return fit;
  }

  /** The newest fit of a source by a method under the present model, or null. */
  recall(source, method) {
    return this.#kept.get(this.#key(source, method)) ?? null;
  }

  forget(fit) {
    this.#drop((kept) => kept.id === fit.id);
  }

  #drop(isStale) {
    for (const [key, kept] of this.#kept) if (isStale(kept)) this.#kept.delete(key);
  }

  #key(source, method) {
    return `${source.key}|${method}|${this.state.project?.model?.trained ?? ""}`;
  }
}

/** A fit whose points are either [x, y] or null: one that has blown up may lack a coordinate. */
export function cleaned(fit) {
  const points = (shape) => shape.map((point) => (point && point.every(Number.isFinite) ? point : null));
  return {
    ...fit,
    shape: points(fit.shape),
    covariances: fit.covariances?.map((each) => (each?.flat().every(Number.isFinite) ? each : null)) ?? null,
    iterations: fit.iterations.map((step) => ({ ...step, shape: points(step.shape) })),
  };
}

const shared = new WeakMap();

/** The one store of an app: what Fit has fitted, Compare need not fit again. */
export function fitsOf(app) {
  if (!shared.has(app)) shared.set(app, new FitStore(app.state));
  return shared.get(app);
}

/** How a fit is to be judged: {kind for its badge, title, advice that names what can be done here or ""}. */
export function verdictOf(fit) {
  const doubtful = fit.found?.doubtful;
  if (!fit.ok) {
    return {
      kind: fit.status === "doubtful" || fit.status === "max iterations" ? "warn" : "bad",
      title: fit.status,
      advice: "Draw a box around the object, or drag the mean shape onto it:",
    };
  }
  if (doubtful) {
    return {
      kind: "warn",
      title: `${fit.status}, found with doubt`,
      advice: "The search was not sure that it saw the object. If the points are off, draw a box around it:",
    };
  }
  return { kind: "good", title: fit.status, advice: "" };
}

/** Seconds for people: "38 ms", "1.2 s". */
export function duration(seconds) {
  if (!Number.isFinite(seconds)) return "–";
  return seconds < 1 ? `${Math.round(1000 * seconds)} ms` : `${seconds.toFixed(1)} s`;
}

/** Number with so many significant digits, without exponents for ordinary sizes; a dash where there is none. */
export function significant(value, digits = 3) {
  if (value == null || !Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  return size >= 1e5 || size < 1e-4 ? value.toExponential(digits - 1) : String(Number(value.toPrecision(digits)));
}

/** An error for people: hundredths say enough of pixels and per cents. */
function short(value) {
  return value < 0.01 ? "< 0.01" : String(Number(value.toFixed(2)));
}

const told = ({ error: { pixels, percent } }) => `${short(pixels)} px (${short(percent)} %)`;

/** Rows [term, value] of what a fit says of itself. */
export function factsOf(fit) {
  const { search, fit: fitting } = fit.seconds ?? {};
  const rows = [];
  if (fit.quality != null) rows.push(["Quality", `${Math.round(100 * fit.quality)} %`]);
  if (fit.error) rows.push(["Error", told(fit)]);
  if (fit.theta_deg != null) rows.push(["θ", `${fit.theta_deg.toFixed(1)}°`]);
  rows.push(["Time", search ? `${duration(search)} search + ${duration(fitting)} fit` : duration(fitting)]);
  return rows;
}

/** Which of two fits to the same picture is nearer to the known landmarks, as a sentence. */
export function comparison(left, right, distance) {
  if (!left || !right) return "";
  if (!left.error || !right.error) {
    return `No landmarks are known of this picture, so there is no error to compare. The two fits lie ${short(distance)} px apart on average.`;
  }
  const [a, b] = [left.error.pixels, right.error.pixels];
  if (left.method === right.method || Math.abs(a - b) < 0.005 * Math.max(a, b)) {
    return `Equally near: ${told(left)} and ${told(right)} from the landmarks.`;
  }
  const [near, far] = a < b ? [left, right] : [right, left];
  return `${near.method} is nearer: ${told(near)} from the landmarks, ${far.method} ${told(far)}.`;
}
