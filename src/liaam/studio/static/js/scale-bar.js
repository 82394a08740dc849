// The scale bar of the open picture: two clicks, or a drag, along a ruler, and the length between them, or what the server finds.
// Gestures edit it while it is drawn; after that it is part of the marks.

import { CLICK } from "./annotate-words.js";
import { COLOURS, drawText, widthOf } from "./drawing.js";
import { Editable, placing } from "./gestures.js";
import { inked, lines } from "./overlays.js";
import { distance, rounded, sameBar } from "./points.js";
import { dialog, h, optionsOf } from "./ui.js";

const UNITS = { "µm": "µm", mm: "mm", cm: "cm", m: "m", in: "inches" };
const KEY = "liaam-studio:scale-bar"; // the last length and unit
const FIND_KEY = "liaam-studio:find-scale"; // what was looked for last, and its length and unit
const KINDS = { ruler: "Ruler: the length from one smallest tick to the next", bar: "Scale bar: its length" };
const CORNER = 24; // css pixels from the corner of the picture
const MARGIN = 4; // css pixels between its text and the border of the view
const TICK = 6; // css pixels on each side of the line
const DRAG = 16; // css pixels from which a press draws the whole bar; less moves the end that it has set
const LEAST = 1; // pixels between the ends
const LENGTHS = [1e-6, 1e9]; // those that can be entered are between
const known = () => JSON.parse(localStorage.getItem(KEY) ?? '{"length": 10, "unit": "mm"}');

export class ScaleBar extends Editable {
  /** @type {import("./marking.js").Marking} */
  #marking;
  #on = false;
  #ends = [null, null];

  /** handlers: onpreview(): an end moves; onchange(): drawing starts or stops; onshare(bar, anyway) ->
   *  {undo(), redo()}, which gives it to the other pictures too, and takes it back there; alone(): whether there are none; onfind({kind, length, unit}): ask the server for the scale of the
   *  picture, which gives a FoundScale, or null after it has said why not.
   *  @param {import("./marking.js").Marking} marking; @param {any} handlers */
  constructor(marking, handlers) {
    super(handlers);
    this.#marking = marking;
  }

  /** Whether a bar is being drawn, and its ends so far: [x, y] or null. */
  get on() { return this.#on; }
  get ends() { return this.#ends; }
  /** None that could be moved. */
  get points() { return []; }

  /** @returns {{undo: () => any, redo: () => any}} */
  onshare(_bar, _anyway) { return { undo() {}, redo() {} }; }
  /** @returns {Promise<FoundScale | null>} */
  async onfind(_asked) { return null; }
  alone() { return false; }

  /** @returns {Bar | null} */
  get bar() { return this.#marking.state?.bar ?? null; }
  get history() { return this.#marking.history; }
  get editable() { return this.#marking.editable; }
  /** The open picture. While a dialog is open, its marks may be fetched again, as after a training: what is typed and
   *  confirmed there is for the picture, whichever marks it has by then. */
  get #picture() { return this.#marking.book?.name ?? null; }
  get placing() { return this.editable; }
  get prompt() {
    if (this.ends[1]) return ""; // it is being asked for its length
    return `${CLICK} ${this.ends[0] ? "the other end" : "one end of a ruler or of a known length, or drag along it"}`;
  }

  /** Undo takes back the first end of a bar that is being drawn; without one, it and redo stop drawing, too. */
  travel(way) {
    if (way === "undo" && this.ends[0]) {
      this.preview([null, null]);
      this.onchange();
      return "an end of the scale bar";
    }
    if (this.on && this.history?.[way === "undo" ? "canUndo" : "canRedo"]) this.turn(false);
    return this.#marking.travel(way);
  }

  turn(on) {
    this.#on = on;
    this.#ends = [null, null];
    this.onchange();
  }

  /** The button: draw a bar, stop drawing, or change the bar that is there. */
  async start() {
    if (this.on || !this.bar) return this.turn(!this.on);
    const [{ bar }, picture] = [this, this.#picture];
    const remove = { label: "Remove", value: "remove", testid: "scale-remove" };
    const find = { label: "Find…", value: "find", testid: "scale-find-again" };
    const [answer, change] = await this.ask(bar, [remove, find, { label: "Draw again", value: "draw" }]);
    if (this.#picture !== picture) return;
    if (answer === "remove") this.#marking.change({ bar: null }, "remove the scale bar");
    else if (answer === "draw") this.turn(true);
    else if (answer === "find") this.find();
    else if (answer) this.settle(answer, { ...bar, ...change }, "change the scale bar");
  }

  preview(ends) {
    this.#ends = ends;
    this.onpreview();
  }

  /** A click sets an end; a drag sets both, where it begins and where it ends. start: the place of xy on the screen. */
  adding(xy, start) {
    const [before, first] = [this.ends, rounded(xy)];
    let isDrag = false;
    const endsWith = (end) => (before[0] ? [before[0], end] : isDrag ? [first, end] : [end, null]);
    const show = (place) => this.preview(endsWith(rounded(place)));
    return {
      ...placing(xy, show, () => (this.ends[1] ? this.finish() : this.onchange()), () => this.preview(before)),
      move(at, event) {
        isDrag ||= distance(event.at, start) > DRAG;
        this.loupe = at;
        show(at);
      },
    };
  }

  async finish() {
    const [{ ends }, picture] = [this, this.#picture];
    if (distance(ends[0], ends[1]) < LEAST) return this.preview([ends[0], null]);
    const [answer, bar] = await this.ask(known());
    if (this.#picture !== picture) return;
    this.turn(false);
    if (!answer) return;
    localStorage.setItem(KEY, JSON.stringify({ length: bar.length, unit: bar.unit }));
    this.settle(answer, { ends, ...bar }, "scale bar");
  }

  /** Ask what is in the picture, let the server find it, show it, and ask whether it is right. */
  async find() {
    const picture = this.#picture;
    const [looks, asked] = await this.askKind(JSON.parse(localStorage.getItem(FIND_KEY) ?? '{"kind": "ruler", "length": 1, "unit": "mm"}'));
    if (!looks || this.#picture !== picture) return;
    localStorage.setItem(FIND_KEY, JSON.stringify(asked));
    const found = await this.onfind(asked);
    if (!found || this.#picture !== picture) return;
    this.#on = true; // so that what was found is drawn
    this.#ends = found.bar.ends;
    this.onchange();
    const [answer, anyway] = await this.offer(found);
    if (this.#picture !== picture) return;
    this.turn(false);
    if (answer) this.settle(answer, { ...found.bar, anyway }, "scale bar that was found");
  }

  async askKind(before) {
    const kind = h("select.text", { "aria-label": "What is in the picture", testid: "find-kind" }, optionsOf(KINDS));
    kind.value = before.kind;
    const length = lengthField(before.length, "find-length");
    const unit = unitField(before.unit, "find-unit");
    const body = h("div.column", kind, h("div.row", length, unit),
      h("p.small.muted", "The number beside a scale bar is not read. What is not clear is refused."));
    const find = { label: "Find", kind: "primary", value: true, checks: true, testid: "find-go" };
    const answer = await dialog("Find the scale in the picture", body, [find]);
    /** @type {ScaleQuery} */
    const asked = { kind: kind.value, length: typedNumber(length.value), unit: unit.value };
    return [answer, asked];
  }

  /** Say what was found. Returns "save", "share" or null, and whether to replace other scales too.
   *  @param {FoundScale} found */
  async offer(found) {
    const [anyway, others] = this.forOthers();
    const share = { label: "Same scale for all", value: "share", testid: "found-share" };
    const use = { label: "Use it", kind: "primary", value: "save", testid: "found-use" };
    const body = h("div.column", h("p", { testid: "found-scale" }, foundText(found)),
      h("p.small.muted", "It is drawn on the picture: check that it lies on the ruler."), others);
    const answer = await dialog("Found", body, [{ label: "Cancel", value: null }, ...(others ? [share] : []), use]);
    return [answer, anyway.checked];
  }

  /** The box to replace the scales of other pictures, and its label; null in place of it if there are none. */
  forOthers() {
    const anyway = h("input", { type: "checkbox", testid: "scale-anyway" });
    const label = h("label.check", anyway, "Set it in all pictures, also in those of another size or with another scale");
    return [anyway, this.alone() ? null : label];
  }

  /** With the box, both buttons set the scale in all pictures. */
  settle(answer, { anyway, ...bar }, what) {
    if (answer !== "share" && !anyway) return this.#marking.change({ bar }, what);
    const others = this.onshare(bar, anyway);
    this.#marking.change({ bar }, "same scale for all", null, { beyond: others }); // one step with theirs
    return others.redo();
  }

  async ask(bar, more = []) {
    const length = lengthField(bar.length, "scale-length");
    const unit = unitField(bar.unit, "scale-unit");
    const [anyway, others] = this.forOthers();
    const kept = "Landmark files .ljson and .tps have the scale in them; .pts and .csv cannot.";
    const note = h("p.small.muted", `Measurements of this picture are then in millimetres. ${kept}`);
    const body = h("div.column", h("div.row", length, unit), note, others);
    const share = { label: "Same scale for all", value: "share", checks: true, testid: "scale-share" };
    const save = { label: "Set the scale", kind: "primary", value: "save", checks: true, testid: "scale-save" };
    const answer = await dialog("Length of the scale bar", body, [...more, ...(this.alone() ? [] : [share]), save]);
    return [answer, { length: typedNumber(length.value), unit: unit.value, anyway: anyway.checked }];
  }

  /** Whether the bar was drawn on another picture: it is the scale of this one, but lies on no ruler here. */
  get isShared() {
    const { book } = this.#marking;
    return this.bar !== null && Boolean(book?.sharedBar) && sameBar(this.bar, book.sharedBar);
  }

  /** The ends of the bar on the screen. One of another picture is drawn level, in the lower left corner of this one. */
  #places(viewer) {
    if (this.on || !this.isShared) return (this.on ? this.ends : (this.bar?.ends ?? [])).filter(Boolean).map((end) => viewer.toScreen(end));
    const [x, y] = viewer.toScreen([viewer.mirrored ? viewer.width - 1 : 0, viewer.height - 1]);
    const [left, low] = [Math.max(x, 0) + CORNER, Math.min(y, viewer.container.clientHeight) - CORNER];
    return [[left, low], [left + viewer.scale * distance(...this.bar.ends), low]];
  }

  get #text() { return `${this.bar.length} ${this.bar.unit}${this.isShared ? ", drawn on another picture" : ""}`; }

  /** The middle of the length's text and its width, which does not leave the view: [[x, y, width]]; null without a bar. */
  label(ctx, viewer) {
    const ends = this.#places(viewer);
    if (this.on || !this.bar || !ends.length) return null;
    const [[x0, y0], [x1, y1]] = [ends[0], ends.at(-1)];
    const away = Math.hypot(x1 - x0, y1 - y0) || 1;
    const [nx, ny] = [(TICK * (y1 - y0)) / away, (TICK * (x0 - x1)) / away];
    const wide = widthOf(ctx, this.#text);
    const [least, most] = [wide / 2 + MARGIN, viewer.container.clientWidth - wide / 2 - MARGIN];
    const isSeen = Math.max(x0, x1) > 0 && Math.min(x0, x1) < viewer.container.clientWidth;
    const x = (x0 + x1) / 2 + 2 * Math.abs(nx);
    return [[isSeen ? Math.max(least, Math.min(x, most)) : x, (y0 + y1) / 2 - 2 * Math.abs(ny) - 4, wide]];
  }

  draw(ctx, viewer) {
    const ends = this.#places(viewer);
    if (!ends.length) return;
    const [[x0, y0], [x1, y1]] = [ends[0], ends.at(-1)];
    const away = Math.hypot(x1 - x0, y1 - y0) || 1;
    const [nx, ny] = [(TICK * (y1 - y0)) / away, (TICK * (x0 - x1)) / away];
    const across = nx || (ny ? 0 : TICK); // a single end is a tick
    lines(ctx, [...ends.map(([x, y]) => [[x - across, y - ny], [x + across, y + ny]]), [[x0, y0], [x1, y1]]]);
    inked(ctx, "rgb(0 0 0 / 75%)", 4.5);
    inked(ctx, COLOURS.placed, 2);
    for (const [x, y] of this.label(ctx, viewer) ?? []) drawText(ctx, this.#text, x, y, { align: "center" });
  }
}

/** The number that was typed, perhaps with a decimal comma; NaN if it is none. A comma may separate thousands: "1,250". */
export function typedNumber(text) {
  const typed = text.trim();
  if (isAmbiguous(typed) || !/^[\d.,eE+-]+$/.test(typed)) return NaN;
  return Number(/^\d+,\d+$/.test(typed) ? typed.replace(",", ".") : typed);
}

const isAmbiguous = (typed) => /^[1-9]\d{0,2},\d{3}$/.test(typed);

/** What is wrong with a length that was typed; "" if nothing. */
export function faultOfLength(text) {
  const typed = text.trim();
  if (isAmbiguous(typed)) return `${typed} may be ${typed.replace(",", ".")} or ${typed.replace(",", "")}: write one of these.`;
  const length = typedNumber(typed);
  return length > LENGTHS[0] && length < LENGTHS[1] ? "" : "Enter a length above 0 and below a thousand million, such as 10 or 0.5.";
}

// A field for numbers would leave out a decimal comma without a word, so that 0,5 became 5.
function lengthField(value, testid) {
  const length = h("input.text", {
    type: "text", inputmode: "decimal", autocomplete: "off", value: String(value), testid, "aria-label": "Length",
    oninput: () => length.setCustomValidity(faultOfLength(length.value)),
  });
  return length;
}

function unitField(value, testid) {
  const unit = h("select.text", { "aria-label": "Unit", testid }, optionsOf(UNITS));
  unit.value = value;
  return unit;
}

/** Of a found scale, in words. @param {FoundScale} found */
export function foundText({ bar, pixel, error, ticks }) {
  const what = ticks ? `${ticks} ticks` : "a scale bar";
  const percent = Number((100 * error).toPrecision(1));
  return `${what}: ${Number(pixel.toPrecision(4))} ± ${Number((pixel * error).toPrecision(1))} ${bar.unit} per pixel (${percent} %)`;
}
