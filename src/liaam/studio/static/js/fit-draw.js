// Drawing of fits for the tabs Fit and Compare.

/** @typedef {Pick<Fit, "shape" | "triangles" | "contours" | "covariances"> & Partial<Pick<Fit, "absent" | "specimen">>} Drawn
 *  what is drawn of a fit, or of that to a frame */

import { drawText } from "./drawing.js";
import { verdictOf } from "./fit-run.js";
import { discs, drawContours, drawEllipses, drawMesh, drawPoints, lines, stroked } from "./overlays.js";
import { button, h, press } from "./ui.js";

const OVERLAYS = [
  { name: "contours", label: "Contours", key: "C", title: "Show the contours" },
  { name: "landmarks", label: "Points", key: "L", title: "Show the fitted points" },
  { name: "mesh", label: "Mesh", key: "M", title: "Show the model's triangles" },
  { name: "ellipses", label: "Ellipses", key: "E", title: "Show ellipses that contain a point with 95 % probability" },
];

/** What is drawn over a picture, with a button for each overlay. */
export class Overlays {
  #onchange;
  #shown = new Set();

  /** shown: names of the drawn overlays; onchange(): they have changed; test ids start with testid. */
  constructor(shown, onchange, testid) {
    this.#onchange = onchange;
    this.buttons = OVERLAYS.map(({ name, label, key, title }) => button(label, {
      small: true, shortcut: key, title, pressed: false, testid: `${testid}-${name}`, dataset: { name },
      onclick: () => this.toggle(name),
    }));
    this.show(new Set(shown));
  }

  /** Names of the overlays that are drawn. */
  get shown() { return this.#shown; }

  show(shown) {
    this.#shown = shown;
    for (const each of this.buttons) press(each, shown.has(each.dataset.name) && !each.disabled);
  }

  toggle(name) {
    if (!this.#shown.delete(name)) this.#shown.add(name);
    this.show(this.#shown);
    this.#onchange();
  }

  key({ key }) {
    const overlay = OVERLAYS.find((each) => each.key === key.toUpperCase());
    if (overlay) this.toggle(overlay.name);
    return Boolean(overlay);
  }

  /** Whether the model has contours; without, their button cannot be pressed. */
  allowContours(has) {
    const contours = this.buttons.find((each) => each.dataset.name === "contours");
    contours.disabled = !has;
    contours.title = has ? "Show the contours (C)" : "This model has no contours: define them in the template";
    this.show(this.#shown);
  }
}

/** What a tab shows while there is no model: why, and a button that leads to annotation. */
export function modelNeeded(app, testid = null) {
  const how = "Place points on a few pictures and train one, or drop a model file (.liaam) on the page.";
  return [
    h("p.muted", `There is no model yet. ${how}`),
    button("Annotate pictures", { icon: "edit", kind: "primary", testid, onclick: () => app.openTab("annotate") }),
  ];
}

/** Offer the methods that the model was trained for. @param {HTMLSelectElement} select; @param {Model | null} model */
export function offer(select, model) {
  for (const option of select.options) {
    option.disabled = Boolean(model) && !model.methods.includes(option.value);
    option.textContent = option.value + (option.disabled ? " (not trained)" : "");
  }
}

/** The entries of a list of facts (dl), of rows [term, value]. */
export const entries = (rows) => rows.map(([term, value]) => h("div", h("dt", term), h("dd.number", value)));

const FAR = 1e4; // css pixels, beyond any screen
const CROSS = 5; // half the width of a true point's cross, css pixels
const SHARP_FROM = 3; // zoom from which pixels are shown as squares, as the viewer shows its picture's

/** Fits that may be used are yellow like all landmarks; others are orange and dashed. */
const GOOD = { colour: "#ffd166", dash: [] };
const UNSURE = { colour: "#ff8c5a", dash: [6, 4] };
const ABSENT = "#ff2828"; // rings around the places of landmarks that are not there

/** Draw a fit's shape, or that of an iteration, with the overlays in a set of names; opacity: of overlays, by name.
 *  @param {CanvasRenderingContext2D} ctx; @param {any} viewer; @param {Drawn & import("./fit-run.js").Judged} fit; @param {Set<string>} shown
 *  @param {{shape?: Point[], final?: boolean, opacity?: Record<string, number>}} options */
export function drawFit(ctx, viewer, fit, shown, { shape = fit.shape, final = true, opacity = {} } = {}) {
  const { colour, dash } = verdictOf(fit).kind === "good" ? GOOD : UNSURE;
  const draw = (name, work) => {
    ctx.globalAlpha = opacity[name] ?? 1;
    if (shown.has(name)) work();
    ctx.globalAlpha = 1;
  };
  draw("mesh", () => drawMesh(ctx, viewer, shape, fit.triangles));
  // Covariances exist for the result only.
  draw("ellipses", () => final && drawEllipses(ctx, viewer, shape, fit.covariances));
  draw("contours", () => drawContours(ctx, viewer, shape, fit.contours, { colour, dash }));
  // Iterations are of all landmarks; which are absent is known of the result only.
  const absent = new Set(final ? fit.absent ?? [] : []);
  draw("landmarks", () => {
    drawPoints(ctx, viewer, shape.filter((_, i) => !absent.has(i)), { colour, radius: 3 });
    discs(ctx, viewer, shape.filter((_, i) => absent.has(i)), 5);
    stroked(ctx, ABSENT, 1.6);
  });
}

const PALE = 0.55; // opacity of the specimens that are not selected

/** Draw the specimens that are not selected paler, and the names of all above them.
 *  @param {CanvasRenderingContext2D} ctx; @param {any} viewer; @param {Fit} chosen; @param {Fit[]} others; @param {Set<string>} shown
 *  @param {Record<string, number>} opacity */
export function drawSpecimens(ctx, viewer, chosen, others, shown, opacity) {
  if (!others.length) return;
  const pale = Object.fromEntries(OVERLAYS.map(({ name }) => [name, PALE * (opacity[name] ?? 1)]));
  const outlines = new Set([...shown].filter((name) => name !== "mesh" && name !== "ellipses"));
  for (const fit of others) drawFit(ctx, viewer, fit, outlines, { opacity: pale });
  for (const { shape, specimen } of [chosen, ...others]) {
    const points = shape.filter(Boolean).map((point) => viewer.toScreen(point));
    if (!points.length || !specimen) continue;
    const xs = points.map(([x]) => x);
    const ys = points.map(([, y]) => y);
    const middle = (Math.min(...xs) + Math.max(...xs)) / 2;
    drawText(ctx, specimen.name, middle, Math.min(...ys) - 8, { align: "center" });
  }
}

/** Draw the true points as crosses; those without a position (null) are left out. */
export function drawTruth(ctx, viewer, points) {
  const strokes = [];
  for (const point of points.filter(Boolean)) {
    const [x, y] = viewer.toScreen(point);
    strokes.push([[x - CROSS, y - CROSS], [x + CROSS, y + CROSS]]);
    strokes.push([[x - CROSS, y + CROSS], [x + CROSS, y - CROSS]]);
  }
  lines(ctx, strokes);
  stroked(ctx, "#6df2a4", 1.6);
}

/** Draw an image over the viewer's picture, to the right of the line `from` (css pixels) if given. covered: [width,
 *  height] of the part of the picture that the image shows, from the upper left, in its pixels; null: all of it. */
export function drawOver(ctx, viewer, image, { from = null, covered = null, opacity = 1, filter = "none" } = {}) {
  const [width, height] = covered ?? [viewer.width, viewer.height];
  ctx.save();
  if (from !== null) {
    ctx.beginPath();
    ctx.rect(from, -FAR, 2 * FAR, 2 * FAR); // the canvas may be larger than the viewer
    ctx.clip();
  }
  ctx.imageSmoothingEnabled = viewer.scale < SHARP_FROM;
  ctx.globalAlpha = opacity;
  ctx.filter = filter;
  ctx.drawImage(image, viewer.left, viewer.top, viewer.scale * width, viewer.scale * height);
  ctx.restore();
}
