// Drawing of fits for the tabs Fit and Compare.

import { verdictOf } from "./fit-run.js";
import { button, h } from "./ui.js";
import { drawContours, drawEllipses, drawMesh, drawPoints } from "./overlays.js";

export const OVERLAYS = [
  { name: "contours", label: "Contours", key: "C", title: "Show the contours" },
  { name: "landmarks", label: "Points", key: "L", title: "Show the fitted points" },
  { name: "mesh", label: "Mesh", key: "M", title: "Show the model's triangles" },
  { name: "ellipses", label: "Ellipses", key: "E", title: "Show ellipses that contain a point with 95 % probability" },
];

/** A button for each overlay, by name; `shown`: names of the drawn overlays. */
export function overlayButtons(shown, onclick, testid = (_name) => null) {
  return new Map(
    OVERLAYS.map(({ name, label, key, title }) => [
      name,
      button(label, {
        small: true, shortcut: key, title, pressed: shown.has(name), testid: testid(name), onclick: () => onclick(name),
      }),
    ]),
  );
}

export function pressOverlays(buttons, shown) {
  for (const [name, each] of buttons) each.setAttribute("aria-pressed", String(shown.has(name) && !each.disabled));
}

/** A button whose label is hidden if there is little room. */
export function roomy(element) {
  const label = element.lastChild;
  element.setAttribute("aria-label", label.textContent);
  label.replaceWith(h("span", { class: "fit-roomy" }, label.textContent));
  return element;
}

/** Message without a model, with a button to the Annotate tab. */
export function modelNeeded(app, testid = null) {
  return [
    h(
      "p",
      { class: "muted" },
      "There is no model yet. Place points on a few pictures and train one, or drop a model file (.liaam) on the page.",
    ),
    button("Annotate pictures", { icon: "edit", kind: "primary", testid, onclick: () => app.openTab("annotate") }),
  ];
}

/** Terms and values as the entries of a <dl>. */
export const entries = (rows) =>
  rows.map(([term, value]) => h("div", {}, h("dt", {}, term), h("dd", { class: "number" }, value)));

const FAR = 1e4; // css pixels

/** Fits are yellow like all landmarks; failed ones and those of low quality are orange and dashed. */
const GOOD = { colour: "#ffd166", dash: [] };
const UNSURE = { colour: "#ff8c5a", dash: [6, 4] };

/** Draw a fit's shape, or that of an iteration, with the overlays named in a set; opacity: of overlays, by name. */
export function drawFit(ctx, viewer, fit, shown, { shape = fit.shape, final = true, opacity = {} } = {}) {
  const { colour, dash } = verdictOf(fit).isSure ? GOOD : UNSURE;
  const draw = (name, work) => {
    if (!shown.has(name)) return;
    ctx.globalAlpha = opacity[name] ?? 1;
    work();
    ctx.globalAlpha = 1;
  };
  draw("mesh", () => drawMesh(ctx, viewer, shape, fit.triangles));
  // Covariances exist for the result only.
  draw("ellipses", () => final && drawEllipses(ctx, viewer, shape, fit.covariances));
  draw("contours", () => drawContours(ctx, viewer, shape, fit.contours ?? [], { colour, dash }));
  draw("landmarks", () => drawPoints(ctx, viewer, shape, { colour, radius: 3 }));
}

/** Draw known landmarks as crosses, to distinguish them from a fit's points without colour. */
export function drawTruth(ctx, viewer, points, colour = "#6df2a4") {
  const arm = 5;
  ctx.beginPath();
  for (const point of points) {
    if (!point) continue;
    const [x, y] = viewer.toScreen(point);
    ctx.moveTo(x - arm, y - arm);
    ctx.lineTo(x + arm, y + arm);
    ctx.moveTo(x - arm, y + arm);
    ctx.lineTo(x + arm, y - arm);
  }
  for (const [stroke, width] of [
    ["rgb(0 0 0 / 60%)", 3.4], [colour, 1.6],
  ]) {
    ctx.strokeStyle = stroke;
    ctx.lineWidth = width;
    ctx.stroke();
  }
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
  ctx.imageSmoothingEnabled = viewer.scale < 3;
  ctx.globalAlpha = opacity;
  ctx.filter = filter;
  ctx.drawImage(image, viewer.left, viewer.top, viewer.scale * width, viewer.scale * height);
  ctx.restore();
}
