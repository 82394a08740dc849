// The Annotate tab in words: what to do next, what is on the picture, and what is read out to those who do not see it.

const SAY_AFTER = 350; // milliseconds without a further arrow key before a place is read out

/** What to do with the picture that is open, in a sentence; "" where there is nothing to say. */
export function promptOf({ state, book, placing, names, active, missing }) {
  if (state.source === "proposal") {
    return book.doubtful
      ? "The model doubts these points: check each, drag what is off, then press Enter"
      : "Placed by the model: drag what is off, then press Enter";
  }
  if (state.source === "layout") return "The mean shape: put it in place by its frame, then drag single points";
  if (placing) return `Click ${names[active]}`;
  const left = missing.length;
  return left
    ? `${left} ${left === 1 ? "point is" : "points are"} missing: choose one in the list, then click its place`
    : "";
}

/** How many points are placed, and how many of them are invisible. */
export function tallyOf({ points, missing, invisible }) {
  const parts = [`${points.length - missing.length} of ${points.length}`];
  if (invisible.size) parts.push(`${invisible.size} invisible`);
  return parts.join(", ");
}

const SOURCES = {
  proposal: "proposed by the model",
  layout: "the mean shape",
  none: "none placed yet",
  file: "placed by you",
};

/** The picture in words. */
export function descriptionOf(name, { points, missing, state }) {
  const placed = `${points.length - missing.length} of ${points.length} points, ${SOURCES[state.source]}`;
  return `${name}: ${placed}. Tab goes through the points, arrow keys move them; Escape, then Tab, leaves the picture.`;
}

/** Where a point is; `next`: the point that comes after it, or -1. */
export function placeOf({ names, points, invisible }, index, next = -1) {
  const point = points[index];
  const hidden = invisible.has(index) ? ", invisible" : "";
  const here = point
    ? `${names[index]}, ${point.map((v) => v.toFixed(1)).join(", ")}${hidden}`
    : `${names[index]}, missing`;
  return next < 0 ? here : `${here}. Next: ${names[next]}`;
}

/** One point by its name, several by their number. */
export const called = (names, indices) => (indices.length === 1 ? names[indices[0]] : `${indices.length} points`);

/** Why Enter does not go on: points that are left out, perhaps on purpose. */
export function missingText(names, left) {
  const [what, them] =
    left.length === 1 ? [`'${names[left[0]]}' is`, "it"] : [`${left.length} points are`, "them"];
  return `${what} still missing here. Place ${them}, or press Enter again to go on without.`;
}

/** A line that screen readers read out. */
export class Speaker {
  constructor(element) {
    this.element = element;
    this.timer = null;
  }

  say(text) {
    this.element.textContent = text;
  }

  /** After a burst of keys, so that a screen reader is not flooded; text() -> what to say then, or null. */
  soon(text) {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => {
      const now = text();
      if (now !== null) this.say(now);
    }, SAY_AFTER);
  }
}
