// Texts of the Annotate tab: prompts, descriptions, and announcements for screen readers.

/** Screens that are touched have no keys, and are not clicked. */
export const IS_TOUCH = globalThis.matchMedia?.("(pointer: coarse)").matches ?? false;
export const CLICK = IS_TOUCH ? "Tap" : "Click";
/** How the points of a picture are accepted. */
export const DONE_KEY = IS_TOUCH ? "tap Accept" : "press Enter";

export const several = (number, what) => `${number} ${what}${number === 1 ? "" : "s"}`;

/** What a set of landmarks is called; the first one has no name. */
export const calledSet = (name) => name || "Main set";

export const percent = (fraction) => `${(100 * fraction).toFixed(fraction < 0.01 ? 2 : 1)}\u00a0%`;

/** What to do next with the open picture; "" if nothing. */
export function promptOf({ state, book, placing, names, active, missing, absent = [], proposed = 0 }) {
  if (state.source === "proposal") {
    const lacks = absent.length ? ` (${listed(names, absent)} absent: U if not)` : "";
    if (book.nothing) return "The model found nothing here, so these points are a guess: drag them into place, or skip the picture";
    return book.doubtful
      ? `Placed by the model with low confidence${lacks}: look at every point, drag wrong ones, then ${DONE_KEY}`
      : `Placed by the model${lacks}: drag wrong points, then ${DONE_KEY}`;
  }
  if (state.source === "layout") return "Mean shape: move it into place by its frame, then drag single points";
  if (placing) return `${CLICK} ${names[active]}`;
  if (missing.length === 1) return `${names[missing[0]]} is missing: select it in the list, then ${CLICK.toLowerCase()} its position`;
  if (missing.length) return `${missing.length} points are missing: select one in the list, then ${CLICK.toLowerCase()} its position`;
  return proposed ? `${several(proposed, "point")} as proposed: drag wrong ones, then ${DONE_KEY}` : "";
}

/** Which points lie outside a picture of a size, where they are easily lost; "" if none does. */
export function outsideText({ names, points }, { width, height }) {
  // Coordinates are of pixel centres, so the picture ends half a pixel beyond the last.
  const isOutside = ([x, y]) => x < -0.5 || y < -0.5 || x > width - 0.5 || y > height - 0.5;
  const outside = names.map((_, i) => i).filter((i) => points[i] && isOutside(points[i]));
  if (!outside.length) return "";
  const [lie, them] = outside.length === 1 ? ["lies", "it"] : ["lie", "them"];
  return `${listed(names, outside)} ${lie} outside the picture: drag ${them} back, or select ${them} and press U if absent`;
}

export function tallyOf({ points, missing, invisible, state, absent = [] }) {
  if (state.source === "layout") return "mean shape"; // no point has a place of its own
  const more = { invisible: invisible.size, absent: absent.length };
  const words = Object.entries(more).map(([what, count]) => count && `, ${count} ${what}`);
  const isProposed = state.source === "proposal";
  const lacking = missing.length + absent.length;
  const placed = lacking ? `${points.length - lacking} of ${points.length}${isProposed ? " proposed" : ""}`
    : isProposed ? `${points.length} proposed` : several(points.length, "point");
  return [placed, ...words].filter(Boolean).join("");
}

const SOURCES = {
  proposal: "proposed by the model", layout: "from the mean shape", none: "none placed yet", file: "placed or accepted",
};

export function descriptionOf(name, { points, state }) {
  const placed = `${points.filter(Boolean).length} of ${points.length} points, ${SOURCES[state.source]}`;
  const keys = "Tab selects the next point, arrow keys move it. Press Escape, then Tab, to leave the picture.";
  return `${name}: ${placed}. ${keys}`;
}

/** Position of a point; `next`: the point to place next, or -1. */
export function placeOf({ names, points, invisible, absent = [] }, index, next = -1) {
  const lacking = absent.includes(index) ? "absent" : "missing";
  const at = points[index]?.map((v) => v.toFixed(1)).join(", ") ?? lacking;
  const here = `${names[index]}, ${at}${points[index] && invisible.has(index) ? ", invisible" : ""}`;
  return next < 0 ? here : `${here}. Next: ${names[next]}`;
}

const MOST_LISTED = 3;

/** Points by their names; of many, how many there are. */
const listed = (names, indices) => (indices.length > MOST_LISTED ? several(indices.length, "point") : indices.map((i) => names[i]).join(", "));

export const called = (names, indices) => (indices.length === 1 ? names[indices[0]] : `${indices.length} points`);

/** Message about missing points, which may be left out on purpose. */
export function missingText(names, left) {
  const [what, them] = left.length === 1 ? [`'${names[left[0]]}' is`, "it"] : [`${left.length} points are`, "them"];
  return `${what} still missing here. Place ${them}, or ${DONE_KEY} again to continue without ${them}.`;
}

export const UNTOUCHED =
  `This is the mean shape, and no point of it was moved. Move it into place, or ${DONE_KEY} again to leave the ` +
  "picture without points.";
