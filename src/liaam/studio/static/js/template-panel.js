// The panel beside the picture while the template is edited: instructions, points, paths, and Done.

import { CLICK, several } from "./annotate-words.js";
import { fileOf } from "./api.js";
import * as drafts from "./template.js";
import { button, consume, fileField, h, icon, iconButton, menu, press } from "./ui.js";

const START = `Which points will you place on every picture? ${CLICK} each of them on this one. For points along an outline, press “Draw a curve” first.`;
const OTHER = "Or start with a common set of points, or with the points of a landmark file:";
const CONTINUE = `${CLICK} the next point, or press Done when all are there. Names can be changed below, also later.`;
const DRAW = `${CLICK} along the outline, and on points that the curve goes through. ${CLICK} its first point to close it, or press “Draw a curve” again to end it.`;
const SLIDING = "S: semilandmark, which slides along its curve. Press S to change it.";
const EDIT = `${CLICK} the picture to add points, drag points to move them. Nothing changes in other pictures before you press Done.`;
const LAY_OUT = "Drag the corners of the frame until the points lie on this picture, then drag single points.";
const OFFERED = "Meanwhile a model has placed other points in your pictures. Yours are kept: go on, or press “Use the model's points”.";
const LOOKING = `Looking for faces in these pictures. If there are any, their points are placed for you. If not, ${CLICK.toLowerCase()} your own.`;

/** Common sets of points to start with, by the name of their landmark file. */
const PRESETS = {
  "face-68": "Face, 68 points (iBUG)", "body-17": "Body, 17 points (COCO)", "hand-21": "Hand, 21 points",
  "wing-12": "Fly wing, 12 points on veins",
};
const OF_LANDMARKS = ["body-17", "hand-21", "wing-12"]; // sets whose lines join landmarks; none of these slides

/** isOffered(): whether a model offers points of its own; isLooking(): whether one may do so soon; formats: suffixes of landmark files; onload(file, kind): start with a landmark file, of points of one kind if it is given; onsliders(file); ondone();
 *  onleave(). */
export function createTemplatePanel({ drafting, formats, onload, onsliders, ondone, onleave, isOffered, isLooking }) {
  let busy = false;
  const heading = h("h2.panel-title");
  const intro = h("div.column.template-intro");
  const file = fileField((chosen) => onload(chosen), { id: "template-file", testid: "template-load", tabindex: null });
  const loadPreset = async (set) =>
    onload(new File([await (await fetch(fileOf(`presets/${set}.ljson`))).blob()], `${set}.ljson`),
      OF_LANDMARKS.includes(set) ? "landmark" : null);
  const tool = (label, face, onclick, more = {}) => button(label, { icon: face, small: true, onclick, ...more });
  const path = tool("Draw a curve", "path", () => drafting.togglePath(), {
    shortcut: "N", testid: "template-new-path", pressed: false, title: "Clicks add points to a curve, until you press this again",
  });
  const pathBelow = tool("Draw a curve", "path", () => drafting.togglePath(), { pressed: false, class: "narrow-only" });
  const close = tool("Close it", "curve", () => drafting.close(), {
    shortcut: "C", testid: "template-close-path", title: "Close the curve: join its last point to its first",
  });
  const slidersFile = fileField((chosen) => onsliders(chosen), {
    id: "template-sliders", accept: ".csv,.txt", testid: "template-sliders", tabindex: null,
  });
  const sliders = h("label.button.small", {
    for: "template-sliders", title: "Semilandmarks and curves from a table for geomorph: the numbers of the points before, slide and after",
  }, icon("upload"), "Load semilandmarks…");
  const mirror = tool("In pairs", "mirror", () => drafting.toggleMirror(), {
    shortcut: "X", pressed: false, title: "Left and right: with each point, add its mirror image on the other side of a line",
  });
  const flip = tool("Flip", "swap", () => drafting.flip(), { title: "Flip the points: swap left and right" });
  const done = button("Done", { icon: "check", kind: "primary", testid: "template-done", onclick: ondone });
  const cancel = button("Cancel", { kind: "ghost", onclick: onleave });
  const endLayout = () => drafting.endLayout();
  const settled = button("The points are in place", { kind: "primary", small: true, onclick: endLayout });
  const message = h("p.small.error-text", { role: "status" });
  const points = pointRows(drafting);
  const sliding = h("p.small.muted", { hidden: true }, SLIDING);
  const curves = curveRows(drafting);
  const element = h("div.template-panel",
    h("section.panel", heading, intro, h("div.row", path, close, mirror, flip, slidersFile, sliders)),
    h("section.panel.grow.template-lists",
      h("h2.panel-title", "Points"), points.element, sliding, h("h2.panel-title", "Curves"), curves.element),
    h("section.panel.side-foot", message, h("div.row", done, cancel, pathBelow)));

  /** What to do, above the buttons. */
  function steps() {
    const { draft, saved, layout } = drafting;
    const hint = (text) => [h("p.muted.small", text)];
    if (layout) return [h("p", `Points of ${layout.file}. ${LAY_OUT}`), settled];
    if (saved && draft.path < 0) return hint(EDIT);
    if (draft.path >= 0) return hint(DRAW);
    if (draft.names.length && isOffered()) return hint(OFFERED);
    if (draft.names.length) return hint(CONTINUE);
    if (isLooking()) return hint(LOOKING);
    const label = h("label.button", { for: "template-file", title: formats.join(" ") }, icon("upload"), "Load a landmark file…");
    const other = hint(OTHER);
    const common = menu("Choose a common set…", PRESETS, loadPreset, {
      "aria-label": "Common sets of points", testid: "template-preset",
    });
    return [h("p", START), ...other, h("div.column", common, file, label)];
  }

  function refresh() {
    const { draft, saved, layingOut } = drafting;
    const open = draft.path >= 0;
    heading.textContent = saved ? "Edit the template" : "Template: the points of every picture";
    intro.replaceChildren(...steps());
    path.disabled = layingOut;
    for (const each of [path, pathBelow]) press(each, open);
    pathBelow.disabled = layingOut;
    sliding.hidden = !draft.kinds.some((_, i) => drafts.slides(draft, i));
    sliders.hidden = !draft.names.length || layingOut;
    close.disabled = !open || draft.contours[draft.path].indices.length < (draft.twinPath < 0 ? 3 : 2);
    mirror.disabled = layingOut;
    press(mirror, drafting.axis !== null);
    flip.hidden = !layingOut && !saved;
    done.disabled = busy || draft.names.length === 0;
    cancel.hidden = saved === null && !draft.names.length;
    cancel.lastChild.textContent = saved ? "Cancel" : isOffered() ? "Use the model's points" : "Start over";
    message.textContent = "";
  }

  return {
    element, mark: points.mark, tell: (text) => { message.textContent = text; },
    render() {
      points.render();
      curves.render();
      refresh();
    },
    setBusy(now) {
      busy = now;
      if (busy) refresh();
      else done.disabled = false;
    },
  };
}

/** The list of the curves, to name, close, continue or delete them. A row stays while its name is typed. */
function curveRows(drafting) {
  const rows = [];
  const element = h("ul.template-paths", { "aria-label": "Curves of the template" });

  function render() {
    const { contours, path } = drafting.draft;
    while (rows.length > contours.length) rows.pop().element.remove();
    while (rows.length < contours.length) add(rows.length);
    rows.forEach((row, k) => {
      const { indices, closed, name = "" } = contours[k];
      const isDrawn = k === path;
      row.element.classList.toggle("chosen", isDrawn);
      if (row.name.value !== name) row.name.value = name;
      row.length.textContent = isDrawn && !indices.length ? "being drawn" : `${several(indices.length, "point")}${isDrawn ? ", being drawn" : ""}`;
      row.closed.hidden = isDrawn || indices.length < 3;
      row.closed.textContent = closed ? "closed" : "open";
      row.closed.setAttribute("aria-label", `${drafts.curveText(contours[k], k)}: closed`);
      press(row.closed, closed);
      row.more.hidden = isDrawn;
    });
    element.dataset.empty = contours.length ? "" : "No curves yet";
  }

  function add(k) {
    const edit = (what, change) => () => drafting.apply(change(drafting.draft, k), what);
    const small = (text, face, onclick, more = {}) => iconButton(`${text} curve ${k + 1}`, face, onclick, { small: true, ...more });
    const name = h("input.text", {
      type: "text", placeholder: `Curve ${k + 1}`, "aria-label": `Name of curve ${k + 1}`, testid: "curve-name", maxlength: "100",
      spellcheck: "false", autocomplete: "off", title: "Name of the curve, such as costa",
      oninput: () => drafting.apply(drafts.nameCurve(drafting.draft, k, name.value), "rename the curve", `rename curve ${k}`),
      onkeydown: (event) => {
        if (event.key !== "Enter") return;
        consume(event);
        name.blur();
      },
    });
    const length = h("span.muted.small");
    const toggle = (draft) => drafts.setClosed(draft, k, !draft.contours[k].closed);
    const closed = button("open", {
      small: true, kind: "ghost", pressed: false, onclick: edit("close the curve", toggle), title: "Whether its last point is joined to its first",
    });
    const more = small("Continue", "edit", edit("continue the curve", (draft) => drafts.continuePath(draft, k)));
    const gone = small("Delete", "trash", edit("delete the curve", (draft) => drafts.removePath(draft, k)), {
      title: "Delete this curve; its points stay" });
    const row = { element: h("li.template-path", name, length, closed, more, gone), name, length, closed, more };
    rows.push(row);
    element.append(row.element);
  }

  return { element, render };
}

/** The list of the points, to rename, reorder or delete them. */
function pointRows(drafting) {
  const rows = [];
  let dragged = -1;
  const element = h("ol.template-points", { "aria-label": "Points of the template", testid: "point-list" });

  function mark() {
    const { selection, active } = drafting;
    rows.forEach((row, i) => row.element.classList.toggle("chosen", selection.has(i)));
    if (active >= 0) rows[active]?.element.scrollIntoView({ block: "nearest" });
  }

  function render() {
    const { names, draft } = drafting;
    while (rows.length > names.length) rows.pop().element.remove();
    while (rows.length < names.length) add();
    rows.forEach((row, i) => {
      row.number.textContent = String(i + 1);
      if (row.name.value !== names[i]) row.name.value = names[i];
      row.name.setAttribute("aria-label", `Name of point ${i + 1}`);
      row.gone.setAttribute("aria-label", `Delete ${names[i]}`);
      const twin = draft.mirror[i];
      row.twin.textContent = twin === i ? "" : `⇄ ${twin + 1}`;
      row.twin.title = twin === i ? "" : `Mirrored point: ${names[twin]}`;
      row.kind.hidden = !draft.contours.some(({ indices }) => indices.includes(i));
      press(row.kind, drafts.slides(draft, i));
      row.kind.setAttribute("aria-label", `${names[i]} is a semilandmark`);
    });
    element.dataset.empty = names.length ? "" : "No points yet";
    mark();
  }

  function add() {
    const at = () => rows.indexOf(row);
    let isEntered = false; // whether this press is the one that goes to the name
    const name = h("input.text", {
      type: "text", spellcheck: "false", autocomplete: "off", onkeydown: (event) => key(event, at()),
      onfocus: () => {
        if (!drafting.selection.has(at()) || drafting.selection.size > 1) drafting.select([at()], at());
      },
      oninput: () => drafting.apply(drafts.rename(drafting.draft, at(), name.value), "rename", `rename ${at()}`),
      onpointerdown: () => { isEntered = document.activeElement !== name; },
      onclick: () => { if (isEntered && name.selectionStart === name.selectionEnd) name.select(); }, // typing replaces it
    });
    const grip = h("span.grip", {
      title: "Drag to reorder (Alt + ↑ ↓ in the name)", "aria-hidden": "true",
      onpointermove: drag, onpointerup: drop, onpointercancel: drop,
      onpointerdown: (event) => {
        dragged = at();
        grip.setPointerCapture(event.pointerId);
        row.element.classList.add("dragged");
        event.preventDefault();
      },
    }, "⠿");
    const [number, twin] = [h("span.number.muted"), h("span.twin.muted.small")];
    // Tab goes from name to name, by S where a point may slide; the key Delete does the same in the picture.
    const gone = iconButton("Delete", "trash", () => drafting.deleteChosen([at()]), { small: true, tabindex: "-1" });
    const kind = button("S", {
      kind: "ghost", small: true, pressed: false, onclick: () => drafting.changeKind(at()),
      title: "Semilandmark: tracing its curve, or spacing its points evenly, moves it",
    });
    const row = { element: h("li.template-point", grip, number, name, twin, kind, gone), number, name, twin, kind, gone };
    rows.push(row);
    element.append(row.element);
  }

  const under = ({ clientY }) => {
    const boxes = rows.map((row) => row.element.getBoundingClientRect());
    return boxes.findIndex((box) => clientY >= box.top && clientY < box.bottom);
  };

  function drag(event) {
    if (dragged < 0) return;
    const over = under(event);
    rows.forEach((row, i) => {
      row.element.classList.toggle("drop-above", i === over && over < dragged);
      row.element.classList.toggle("drop-below", i === over && over > dragged);
    });
  }

  function drop(event) {
    const [from, over] = [dragged, under(event)];
    dragged = -1;
    for (const row of rows) row.element.classList.remove("drop-above", "drop-below", "dragged");
    if (event.type === "pointerup" && from >= 0 && over >= 0) drafting.shift(from, over);
  }

  /** In a name, up, down and Enter go to another one; with Alt they move the point. */
  function key(event, i) {
    const step = { ArrowUp: -1, ArrowDown: 1 }[event.key];
    const go = event.key === "Enter" ? 1 : step;
    if (!go) return;
    consume(event);
    if (event.altKey && step) drafting.shift(i, i + step);
    const next = rows[Math.min(Math.max(i + go, 0), rows.length - 1)].name;
    next.focus();
    next.select();
  }

  return { element, render, mark };
}
