// Where each point of a picture comes from. A person has placed it, or moved it, or confirmed it where it was; or it was
// accepted with others, or is still as it was proposed, by the model or from the mean shape. Only the first three are a
// person's own: accuracy and agreement between observers count no others. This module is independent of the page.

import { indicesOf, nextOf, samePoint } from "./points.js";

const OWN = ["placed", "moved", "confirmed"];
export const isOwn = (origin) => OWN.includes(origin);

/** The origin of each point of a state, null without a position. Points of files from elsewhere were placed. */
export const originsOf = ({ points, source, origins = null }) => points.map((point, i) => (
  point ? (origins?.[i] ?? (source === "file" ? "placed" : "proposed")) : null));

/** The origins after a step from the state `before` to `points`.
 *  alone: the index of the only point that a person moves, or -1. One that moves along with others keeps its origin.
 *  fresh, changed: origins of points that had no position, and of those that get another one (null: by `alone`).
 *  accepts: whether the step accepts what was proposed. */
export function originsAfter(before, points, { alone = -1, fresh = "placed", changed = null, accepts = false } = {}) {
  const known = originsOf(before);
  return points.map((point, i) => {
    const origin = known[i];
    if (!point) return null;
    if (origin === null) return fresh;
    if (samePoint(point, before.points[i])) return accepts && origin === "proposed" ? "accepted" : origin;
    if (changed) return changed;
    return i === alone && origin !== "placed" ? "moved" : origin;
  });
}

/** The next point after `index`, cyclically, that has a position, and that no person has placed, moved or confirmed; -1
 *  if there is none. */
export function nextToConfirm(origins, index) {
  return nextOf(indicesOf(origins).filter((i) => origins[i] && !isOwn(origins[i])), index);
}
