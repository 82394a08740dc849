// Requests for fits, their cache, and texts about their results.

import { api } from "./api.js";

/** Number of cached fits, so that an earlier picture shows its fit at once. The server keeps 64. */
const KEPT = 32;

/** Whether an error says that the server no longer has a fit. */
export const isGone = (error) => error?.status === 404;

export class FitStore {
  #kept = new Map();

  constructor(state) {
    this.state = state;
    // Errors of cached fits refer to the earlier landmarks.
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

  /** The newest fit of a source with a method and the current model, or null. */
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

/** A fit whose points are either [x, y] or null: a diverged fit may lack a coordinate. */
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

/** The store of an app, shared by the tabs Fit and Compare. */
export function fitsOf(app) {
  if (!shared.has(app)) shared.set(app, new FitStore(app.state));
  return shared.get(app);
}

/** Assessment of a fit: {kind of its badge, title, advice or ""}. */
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
      title: `${fit.status}, search uncertain`,
      advice: "The search may not have found the object. If the points are wrong, draw a box around it:",
    };
  }
  return { kind: "good", title: fit.status, advice: "" };
}

/** Seconds as text: "38 ms", "1.2 s". */
export function duration(seconds) {
  if (!Number.isFinite(seconds)) return "–";
  return seconds < 1 ? `${Math.round(1000 * seconds)} ms` : `${seconds.toFixed(1)} s`;
}

/** Number with significant digits, without an exponent for ordinary values; a dash if it is not finite. */
export function significant(value, digits = 3) {
  if (value == null || !Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  return size >= 1e5 || size < 1e-4 ? value.toExponential(digits - 1) : String(Number(value.toPrecision(digits)));
}

/** An error in pixels or percent, to two decimals. */
function short(value) {
  return value < 0.01 ? "< 0.01" : String(Number(value.toFixed(2)));
}

const errorText = ({ error: { pixels, percent } }) => `${short(pixels)} px (${short(percent)} %)`;

/** Facts about a fit as rows [term, value]. */
export function factsOf(fit) {
  const { search, fit: fitting } = fit.seconds ?? {};
  const rows = [];
  if (fit.quality != null) rows.push(["Quality", `${Math.round(100 * fit.quality)} %`]);
  if (fit.error) rows.push(["Error", errorText(fit)]);
  if (fit.theta_deg != null) rows.push(["θ", `${fit.theta_deg.toFixed(1)}°`]);
  rows.push(["Time", search ? `${duration(search)} search + ${duration(fitting)} fit` : duration(fitting)]);
  return rows;
}

/** Which of two fits to the same picture is closer to the known landmarks. */
export function comparison(left, right, distance) {
  if (!left || !right) return "";
  if (!left.error || !right.error) {
    return `This picture has no landmarks, so the errors are unknown. The two fits are ${short(distance)} px apart on average.`;
  }
  const [a, b] = [left.error.pixels, right.error.pixels];
  if (left.method === right.method || Math.abs(a - b) < 0.005 * Math.max(a, b)) {
    return `Equal errors: ${errorText(left)} and ${errorText(right)}.`;
  }
  const [near, far] = a < b ? [left, right] : [right, left];
  return `${near.method} is closer to the landmarks: ${errorText(near)}, ${far.method}: ${errorText(far)}.`;
}
