// Requests for fits, their cache, and texts about their results.

import { several } from "./annotate-words.js";
import { api } from "./api.js";
import { distance, indicesOf, mean } from "./points.js";

/** @typedef {Pick<Fit, "ok" | "status" | "quality"> & Partial<Pick<Fit, "found" | "n_found" | "nothing_found">> & {fitStatus?: string}} Judged
 *  what a verdict needs of a fit; fitStatus: of a frame, whose status is that of a track */

export const AUTO = "auto"; // of two sides of an object, that which is likelier
const KEPT = 32; // fits, so that an earlier picture shows its fit at once; the server keeps 64

export class FitStore {
  /** @type {Map<string, Fit>} */
  #kept = new Map();
  /** @type {Map<string, Fits>} */
  #all = new Map(); // all specimens of a picture that were fitted together
  #changes = 0; // of landmarks, which the errors of fits refer to

  /** @type {import("./state.js").State} */
  #state;

  /** @param {import("./state.js").State} state */
  constructor(state) {
    this.#state = state;
    state.addEventListener("landmarks", (/** @type {any} */ { detail }) => {
      const { name } = /** @type {LandmarksChanged} */ (detail);
      this.#changes += 1;
      this.#drop((fit) => fit.picture === name);
    });
  }

  /** Fit a picture from a start, null: where it is found.
   *  @param {import("./fit-source.js").Source} source; @param {string} method; @param {Start | null} start; @param {string} side */
  async run(source, method, start = null, side = AUTO) {
    const key = this.#key(source, method, side); // of the model that is asked, which may be replaced meanwhile
    const changes = this.#changes;
    await source.ready;
    const own = source.takeFit(); // with the upload
    /** @type {FitOne} */
    const asked = { method, start, side };
    const fit = cleaned(own?.method === method && !start && side === AUTO ? own
      : await this.#state.send((folder) => api.post(api.url("fits"), { ...asked, ...source.reference, folder })));
    if (changes !== this.#changes) return fit;
    this.#all.delete(key);
    keep(this.#kept, key, fit);
    return fit;
  }

  /** Fit all specimens of a picture.
   *  @param {import("./fit-source.js").Source} source; @param {string} method; @returns {Promise<Fits>} */
  async runAll(source, method, side = AUTO) {
    const [key, changes] = [this.#key(source, method, side), this.#changes];
    await source.ready;
    /** @type {FitAll} */
    const asked = { method, side };
    const { fits, faults } = await this.#state.send(
      (folder) => api.post(api.url("fits/all"), { ...asked, ...source.reference, folder }));
    const all = { fits: fits.map(cleaned), faults };
    if (changes === this.#changes) keep(this.#all, key, all);
    return all;
  }

  /** The newest fit of a source with a method, a side and the current model, or null; of several specimens, that which
   *  was chosen last. */
  recall(source, method, side = AUTO) { return this.#kept.get(this.#key(source, method, side)) ?? null; }

  /** All specimens of a source that were fitted together, unless it was fitted otherwise since, or null. */
  recallAll(source, method, side = AUTO) { return this.#all.get(this.#key(source, method, side)) ?? null; }

  /** One of several specimens was chosen: it is recalled. */
  choose(source, method, side, /** @type {Fit} */ fit) {
    const key = this.#key(source, method, side);
    if (this.#all.get(key)?.fits.includes(fit)) keep(this.#kept, key, fit);
  }

  forget(/** @type {Fit} */ fit) { this.#drop((kept) => kept.id === fit.id); }

  /** @param {(fit: Fit) => boolean} isStale */
  #drop(isStale) {
    for (const [key, kept] of this.#kept) if (isStale(kept)) this.#kept.delete(key);
    for (const [key, { fits }] of this.#all) if (fits.some(isStale)) this.#all.delete(key);
  }

  #key(source, method, side) { return `${source.key}|${method}|${side}|${this.#state.project.model?.number ?? ""}`; }
}

/** Keep what belongs to a key as the newest of a few. */
function keep(map, key, value) {
  map.delete(key);
  map.set(key, value);
  if (map.size > KEPT) map.delete(map.keys().next().value);
}

/** A fit whose points are either [x, y] or null: a diverged fit may lack a coordinate. @param {Fit} fit; @returns {Fit} */
export function cleaned(fit) {
  const points = (/** @type {Point[]} */ shape) => shape.map((point) => (point && point.every(Number.isFinite) ? point : null));
  return {
    ...fit, shape: points(fit.shape),
    covariances: fit.covariances?.map((each) => (each?.flat().every(Number.isFinite) ? each : null)) ?? null,
    iterations: fit.iterations.map((step) => ({ ...step, shape: points(step.shape) })),
  };
}

const percent = (fraction) => `${Math.round(100 * fraction)} %`;
const KINDS = { converged: "good", "light unobservable": "good", doubtful: "warn", "max iterations": "warn" };

/** Kind of a status of a fit, by the rule of FitStatus.colour in fitting/result.py: "good", "warn" or "bad". */
export const kindOf = (status) => KINDS[status] ?? "bad";

/** What a status is called where the words of fitting are not shown. */
const PLAIN = { "max iterations": "not finished", diverged: "lost" };

/** What the model is of, in a word. @param {Pick<Model, "source"> | null | undefined} model */
export const objectOf = (model) => (model?.source === "face" ? "face" : "object");

const capital = (text) => text[0].toUpperCase() + text.slice(1);

/** Assessment of a fit: {kind of its badge, title, advice or ""}. isExpert: whether the title has the words of fitting;
 *  object: what the model is of. A frame of a video also has the status of a track. @param {Judged} fit */
export function verdictOf(fit, isExpert = true, object = "object") {
  const { ok, fitStatus = fit.status, quality } = fit;
  const status = isExpert ? fit.status : (PLAIN[fit.status] ?? fit.status);
  const kind = kindOf(fitStatus);
  if (fit.nothing_found) {
    const title = `No ${object} found`;
    const advice = `The points are only a guess. If there is ${object === "face" ? "a face" : "an object"}, draw a box around it:`;
    return { kind, title: isExpert ? `${title} (${status})` : title, advice };
  }
  if (!ok) return { kind, title: status, advice: "Draw a box around the object, or drag the mean shape onto it:" };
  const known = `quality ${quality == null ? "unknown" : percent(quality)}`;
  const title = isExpert ? `${status}, ${known}` : capital(known);
  if (fit.found?.doubtful) {
    const advice = "The search may not have found the object. If the points are wrong, draw a box around it:";
    return { kind, title: `${title}, search uncertain`, advice };
  }
  const more = (fit.n_found ?? 1) - 1;
  const others = more > 0 ? `${several(more, `more ${object}`)} in the picture. Fit all, or one after the other, or draw a box around one:` : "";
  return { kind, title, advice: others };
}

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
const short = (value) => value < 0.01 ? "< 0.01" : String(Number(value.toFixed(2)));
const errorText = (/** @type {Fit} */ { error: { pixels, percent } }) => `${short(pixels)} px (${short(percent)} %)`;

/** Facts about a fit, by their titles; isExpert: also what only experts of the fitting need. @param {Fit} fit */
export function factsOf(fit, isExpert = true) {
  const { search, fit: fitting } = fit.seconds;
  return [
    isExpert && ["Quality", fit.quality == null ? "unknown" : percent(fit.quality)],
    fit.side && ["Side", fit.side],
    fit.error && ["Error", errorText(fit)],
    isExpert && fit.theta_deg != null && ["θ", `${fit.theta_deg.toFixed(1)}°`],
    isExpert && ["Time", search ? `${duration(search)} search + ${duration(fitting)} fit` : duration(fitting)],
  ].filter(Boolean);
}

/** What is said of the size in which a picture is saved, if it is not whole. @param {Pick<Fit, "width" | "height"> | null} fit; @param {number} most */
export function reducedText(fit, most) {
  if (!fit || fit.width * fit.height <= most) return "";
  const [has, saved] = [fit.width * fit.height, most].map((pixels) => (pixels / 1e6).toFixed(1).replace(/\.0$/, ""));
  return `This picture has ${has} million pixels, and is saved with ${saved} million. “liaam relight” keeps all.`;
}

/** Mean distance between two shapes in pixels, over their common points; NaN without any. */
export function meanDistance(first, second) {
  const both = indicesOf(first).filter((i) => first[i] && second[i]);
  return mean(both.map((i) => distance(first[i], second[i])));
}

/** How two fits to the same picture compare: {by: "error" or "quality", better: one of them, null if they are equal},
 *  or {by: "copy"} if the landmarks are those of a fit; {} if neither is known.
 *  @param {Fit | null} left; @param {Fit | null} right; @returns {{by?: string, better?: Fit | null}} */
function compared(left, right) {
  const pick = (by, gain, least) => ({ by, better: Math.abs(gain) < least ? null : gain > 0 ? left : right });
  if (left?.error && right?.error) {
    const [a, b] = [left.error.pixels, right.error.pixels];
    return Math.min(a, b) < 0.01 ? { by: "copy" } : pick("error", b - a, 0.005 * Math.max(a, b));
  }
  return left?.quality == null || right?.quality == null ? {} : pick("quality", left.quality - right.quality, 0.005);
}

/** The better of two fits to the same picture: by the known landmarks, or else by quality; null if they are equal. */
export const betterOf = (left, right) => compared(left, right).better ?? null;

/** Which of two fits to the same picture is better, in words; distance: mean distance of their points in pixels.
 *  @param {Fit | null} left; @param {Fit | null} right; @param {number} distance */
export function comparison(left, right, distance) {
  if (!left || !right) return "";
  const { by, better = null } = compared(left, right);
  const worse = better === left ? right : left;
  const larger = " The model was trained on this picture, so its errors on new pictures are larger.";
  const trained = left.trained_on ? larger : "";
  const apart = `The two fits are ${short(distance)} px apart on average.`;
  if (by === "copy") {
    const { method } = left.error.pixels < right.error.pixels ? left : right;
    return `The landmarks come from the fit with ${method}, so they do not show which fit is better. ${apart}`;
  }
  if (by === "error") {
    if (!better) return `Equal errors: ${errorText(left)} and ${errorText(right)}.${trained}`;
    const errors = `${errorText(better)}, ${worse.method}: ${errorText(worse)}`;
    return `${better.method} is closer to the landmarks: ${errors}.${trained}`;
  }
  if (by === "quality") {
    if (!better) return `No landmarks to compare with, and equal quality: ${percent(left.quality)}. ${apart}`;
    const values = `quality ${percent(better.quality)}, ${worse.method}: ${percent(worse.quality)}`;
    return `No landmarks to compare with. ${better.method} is more likely to be right: ${values}. ${apart}`;
  }
  const unknown = left.quality == null ? left.method : right.method;
  const why = `This picture has no landmarks, and the quality of ${unknown} is unknown`;
  return `${why}, so neither fit can be called better. ${apart}`;
}
