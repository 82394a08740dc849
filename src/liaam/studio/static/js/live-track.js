// The track of a video: the row of each frame as the server writes it. This module is independent of the page.

import { several } from "./annotate-words.js";
import { kindOf, verdictOf } from "./fit-run.js";

const FACTS = 10; // columns before those of the points
const PER_POINT = 7; // x, y, fitted x and y, variances and covariance
const MOST = 480_000; // pixels of a frame that is sent: at four bytes each, less than the server's limit of 2 MB
const JUMP = 0.5; // seconds between two frames from which on the object is searched anew
const APART = JUMP; // seconds between two frames that were watched apart from which on nothing is known between them
const SLOW = 15; // frames per second below which the user sees a message

export function sentSize(width, height) {
  const factor = Math.min(1, Math.sqrt(MOST / (width * height)));
  return { width: Math.floor(width * factor), height: Math.floor(height * factor) };
}

/** Whether a frame does not follow the one before (seconds, or null), so that the motion before does not apply. */
export const isJump = (before, time) => before === null || time <= before || time - before > JUMP;
const numberIn = (cell) => (cell === "" ? null : Number(cell));

/** A row as a fit to draw and to judge; a lost frame has no points. */
export function parseRow(row) {
  const cells = row.trimEnd().split(",");
  const ok = !row.includes(",lost,");
  const points = [];
  if (ok)
    for (let i = FACTS; i < cells.length; i += PER_POINT) points.push(cells.slice(i, i + PER_POINT).map(Number));
  return {
    status: cells[2], fitStatus: cells[3], ok, quality: numberIn(cells[4]),
    roll: numberIn(cells[6]), size: numberIn(cells[7]), centre: [cells[8], cells[9]].map(numberIn),
    shape: points.map(([x, y]) => [x, y]),
    covariances: points.map(([, , , , xx, xy, yy]) => [[xx, xy], [xy, yy]]),
  };
}

const key = (time) => Math.round(1000 * time);

/** What to say of a frame and its fit: {kind: "warn" or as that of a fit, text}; asked: whether the frame was sent to
 *  remove its shading; rate: frames per second that are fitted, null while too few are counted; object: what the model is
 *  of; wasFound: whether it was found in any frame. */
export function verdictOfFrame({ fit, flat, asked }, { isFile, isFlat, rate, object = "object", wasFound = true }) {
  const warn = (text) => ({ kind: "warn", text });
  const remedy = isFile ? "" : ` Move the ${object} into the picture, facing the camera.`;
  if (!fit.ok && !wasFound) return warn(`No ${object} was found yet.${remedy}`);
  if (!fit.ok) return warn(`The ${object} is lost${isFile ? " in this frame" : ""}.${remedy}`);
  if (isFlat && asked && !flat)
    return warn("The shading cannot be removed: the video and the model must have colour.");
  if (rate !== null && rate < SLOW)
    return warn(`This machine is slow: ${rate.toFixed(1)} frames per second are fitted.`);
  const { kind, title } = verdictOf(fit);
  return { kind, text: `The ${object} is ${title}.` };
}

/** Rows of a table with a header, by their time in seconds. */
export class Track {
  #header;
  #rows = new Map();
  #end = 0;
  #run = 0; // of the frames that are watched one after the other

  constructor(header = "") { this.#header = header; }

  get header() { return this.#header; }
  /** By milliseconds: {row, time, and what graphs show of it}. */
  get rows() { return this.#rows; }
  /** Time of the row that was added last, in seconds. */
  get end() { return this.#end; }
  /** The run to which the frames belong that are shown now. */
  get run() { return this.#run; }

  /** The person goes to another time: what lies between was not watched. */
  leap() { this.#run += 1; }

  /** Number of watched frames that have no row, if frames come in equal intervals. */
  get skipped() {
    const { times, interval } = this.#times;
    const watched = times.slice(1).map((time, i) => (this.#isUnwatched(this.#rows.get(times[i]), this.#rows.get(time)) ? interval : time - times[i]));
    return times.length < 2 ? 0 : Math.round(watched.reduce((sum, each) => sum + each, 0) / interval) + 1 - times.length;
  }

  /** Whether what lies between two frames that follow each other in time was not watched. */
  #isUnwatched(before, after) { return before.run !== after.run && after.time - before.time > APART; }

  /** What is said when the table of a video is saved; "" if no frame was skipped. */
  get gaps() {
    const { skipped, rows: { size } } = this;
    return skipped && `The table has ${several(size, "frame")}; ${skipped} between them were skipped, since this machine is slower than the video. ` +
      "Play the video again to fill the gaps, or use “liaam track”, which skips none.";
  }

  get lost() { return [...this.#rows.values()].filter(({ shape }) => !shape.length).length; }

  /** Add the row of a frame, of the run in which it was shown; returns it as a fit. */
  set(time, row, run = this.#run) {
    const fit = parseRow(row);
    this.#end = time;
    const { fitStatus, quality, roll, size, shape } = fit;
    this.#rows.set(key(time), { row, time, run, fitStatus, quality, roll, size, shape: Float32Array.from(shape.flat()) });
    return fit;
  }

  at(time) { return this.#rows.get(key(time))?.row ?? null; }

  /** Time in seconds and kind of each frame: that of its fit, and "bad" where the object is lost. */
  marks() {
    const kind = ({ shape, fitStatus }) => (shape.length ? kindOf(fitStatus) : "bad");
    return [...this.#rows.values()].map((frame) => [frame.time, kind(frame)]);
  }

  /** Times, and values of each of some functions of a frame, from a time on, for graphs. A lost frame has none, nor has
   *  the middle of what was not watched, so that no line is drawn there. */
  graphs(values, since = -Infinity) {
    const known = [...this.#rows.values()].filter(({ time }) => time >= since).sort((a, b) => a.time - b.time);
    const frames = known.flatMap((frame, i) => (i > 0 && this.#isUnwatched(known[i - 1], frame)
      ? [{ time: (known[i - 1].time + frame.time) / 2, shape: [] }, frame] : [frame]));
    const seen = (of) => frames.map((frame) => (frame.shape.length ? of(frame) : null));
    return [frames.map(({ time }) => time), ...values.map(seen)];
  }

  /** Times of all rows in milliseconds, in order, and the shortest interval between two. */
  get #times() {
    const times = [...this.#rows.keys()].sort((a, b) => a - b);
    return { times, interval: times.slice(1).reduce((least, time, i) => Math.min(least, time - times[i]), Infinity) };
  }

  /** The table in the order of time. Frames are counted by the shortest interval, since some may have been skipped. */
  csv() {
    const { times, interval } = this.#times;
    const number = (time) => Math.round((time - times[0]) / interval);
    return this.#header + times.map((time) => this.#rows.get(time).row.replace(/^\d+/, number(time))).join("");
  }
}

/** The distance of two points, by index, in a frame of graphs. */
export const distanceOf = ([i, j]) => ({ shape }) =>
  Math.hypot(shape[2 * i] - shape[2 * j], shape[2 * i + 1] - shape[2 * j + 1]);

/** The two points, by index, whose distance is shown at first: the first of these pairs of names or numbers that exist,
 *  or the first two points. */
export function firstPair(names, pairs) {
  const indexOf = (what) => (names[what - 1] === undefined ? names.indexOf(what) : what - 1);
  const known = pairs.map((pair) => pair.map(indexOf));
  return known.find(([i, j]) => i >= 0 && j >= 0 && i !== j) ?? [0, 1];
}
