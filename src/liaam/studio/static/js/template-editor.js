// The editor of the template over one picture: what clicks, keys and the lists at the right do to a draft.

import { COLOURS, drawFrame, drawMarks, drawNames, drawPaths, drawText } from "./drawing.js";
import { History } from "./history.js";
import { axisNormal, bounds, fitInto, flip, indicesOf, place, rounded, withTwins } from "./points.js";
import * as drafts from "./template.js";

const AXIS_REACH = 8; // css pixels within which a point lies on the axis

/** A template that is being made, kept until it is saved: a reload must not cost an hour of clicking. */
class Kept {
  constructor(folder) {
    this.key = `liaam-studio:template:${folder}`;
  }

  get() {
    try {
      const kept = JSON.parse(localStorage.getItem(this.key));
      return kept?.names?.length === kept?.points?.length ? kept : null;
    } catch {
      return null;
    }
  }

  set(draft) {
    try {
      if (draft?.names.length) localStorage.setItem(this.key, JSON.stringify(draft));
      else localStorage.removeItem(this.key);
    } catch {
      // Without storage the draft lives as long as the page.
    }
  }
}

/**
 * The editor of the template over one picture.
 * @param {object} parts
 *  app, viewer; onchange(): something changed, draw again; say(text): to screen readers;
 *  onsave({template, mapping, points, isFresh}): save; oncancel(): leave without.
 */
export function createTemplateEditor({ app, viewer, onchange, say, onsave, oncancel }) {
  const { h, button, icon } = app.ui;
  let history = new History(drafts.EMPTY);
  let draft = drafts.EMPTY;
  let shown = null; // points during a gesture
  let selection = new Set();
  let active = -1;
  let axis = null; // x of the mirror line while mirroring
  let saved = null; // the template that is edited, or null for a new one
  let isFresh = true; // whether it was begun without any template
  let loaded = ""; // the file that a new one came from
  let placing = false; // whether the layout as a whole is being put in place
  let busy = false;
  const kept = new Kept(app.state.project.id ?? app.state.project.folder);

  const doc = {
    editable: true,
    get points() {
      return shown ?? draft.points;
    },
    invisible: new Set(),
    get selection() {
      return selection;
    },
    get placing() {
      return !placing;
    },
    get followsPointer() {
      return axis !== null;
    },
    select(indices, next = indices.at(-1) ?? -1) {
      selection = new Set(indices);
      active = next;
      list.mark();
      viewer.redraw();
    },
    preview(points) {
      shown = points;
      viewer.redraw();
    },
    revert() {
      shown = null;
      viewer.redraw();
    },
    commit(points, what) {
      shown = null;
      apply({ ...draft, points }, what);
    },
    follow: (before, after, indices) => (axis === null ? after : withTwins(before, after, indices, draft.mirror)),
    adding,
    press,
    framed: () => (selection.size > 1 ? [...selection] : placing ? indicesOf(draft.points) : []),
  };

  function apply(next, what, key = null) {
    history.push(next, what, key);
    draft = next;
    refresh();
  }

  function refresh() {
    if (saved === null) kept.set(draft);
    selection = new Set([...selection].filter((i) => i < draft.names.length));
    if (active >= draft.names.length) active = -1;
    list.render();
    paths.render();
    buttons();
    onchange();
  }

  function adding(xy) {
    if (axis !== null && isOnGrip(xy)) return draggingAxis();
    if (placing) return null;
    const unplaced = draft.points.findIndex((point) => !point);
    const add = (at) =>
      unplaced >= 0
        ? { ...draft, points: place(draft.points, unplaced, at) }
        : drafts.addPoint(draft, at, { axis, tolerance: AXIS_REACH / viewer.scale });
    const index = unplaced >= 0 ? unplaced : draft.names.length;
    // Drawn as if it were there, so that its line is seen; the step is taken when the pointer goes up.
    return {
      loupe: xy,
      ghost: add(xy),
      move(at) {
        this.loupe = at;
        this.ghost = add(at);
        viewer.redraw();
      },
      up() {
        selection = new Set([index]);
        active = index;
        apply(this.ghost, "add a point");
        say(`${draft.names[index]} added`);
      },
      cancel() {},
    };
  }

  // The axis is dragged by its grip at the top of the picture: elsewhere on the line, points are placed.
  const gripAt = () => viewer.toScreen([axis, 0])[0];
  const gripY = () => Math.min(Math.max(viewer.toScreen([0, 0])[1], 0) + 16, viewer.canvas.clientHeight - 16);

  function isOnGrip(xy) {
    const [x, y] = viewer.toScreen(xy);
    return Math.hypot(x - gripAt(), y - gripY()) <= 20;
  }

  function draggingAxis() {
    const before = axis;
    return {
      loupe: null,
      move([x]) {
        axis = Math.round(x * 10) / 10;
        viewer.redraw();
      },
      up() {},
      cancel() {
        axis = before;
      },
    };
  }

  function press(index, event) {
    if (placing) return false;
    if (event.shiftKey) {
      // run the path through it
      apply(drafts.connect(draft, index), "connect");
      return true;
    }
    const path = draft.contours[draft.path]?.indices;
    if (path && path.length > 2 && path[0] === index) {
      close();
      return true;
    }
    return false;
  }

  function close() {
    if (draft.path < 0) return;
    apply(drafts.closePath(draft), "close path");
    say("Path closed");
  }

  function startPath() {
    if (draft.path < 0) return;
    apply(drafts.newPath(draft), "new path");
    say("The next point begins a new path");
  }

  function mirrorMode(on = axis === null) {
    axis = !on ? null : middle();
    mirrorButton.setAttribute("aria-pressed", String(on));
    say(on ? "Mirroring on: each point gets a twin" : "Mirroring off");
    viewer.redraw();
  }

  /** Where the axis of symmetry is: half-way between twins, on points without twin, or in the middle. */
  function middle() {
    const box = bounds(draft.points);
    const pairs = draft.mirror.filter((twin, i) => twin > i).length;
    if (!pairs || Math.abs(axisNormal(draft.points, draft.mirror)[0]) < 0.9) {
      return box && draft.names.length > 2 ? (box[0] + box[2]) / 2 : (viewer.width - 1) / 2;
    }
    let sum = 0;
    draft.mirror.forEach((twin, i) => {
      if (twin > i) sum += (draft.points[i][0] + draft.points[twin][0]) / 2;
    });
    return sum / pairs;
  }

  /** For those who place by keys: a point where the view is, to be moved from there. */
  function addInTheMiddle() {
    if (placing) return;
    const { clientWidth, clientHeight } = viewer.canvas;
    const index = draft.names.length;
    apply(
      drafts.addPoint(draft, viewer.toImage([clientWidth / 2, clientHeight / 2]), {
        axis,
        tolerance: AXIS_REACH / viewer.scale,
      }),
      "add a point",
    );
    doc.select([index], index);
    say(`${draft.names[index]} added in the middle; arrow keys move it`);
  }

  function deleteChosen(indices = [...selection]) {
    if (indices.length === 0) return;
    const names = indices.map((i) => draft.names[i]);
    selection = new Set();
    active = -1;
    apply(drafts.deletePoints(draft, indices), "delete");
    say(`${names.length === 1 ? names[0] : `${names.length} points`} deleted`);
  }

  function shift(from, to) {
    if (to < 0 || to >= draft.names.length || from === to) return;
    apply(drafts.reorder(draft, from, to), "reorder");
    doc.select([to], to);
    say(`${draft.names[to]} is number ${to + 1} now`);
  }

  // The panel -------------------------------------------------------------------------------------------------------

  const heading = h("h2", { class: "panel-title" });
  const intro = h("div", { class: "column template-intro" });
  const file = h("input", {
    type: "file",
    class: "visually-hidden",
    id: "template-file",
    dataset: { testid: "template-load" },
    onchange: () => file.files[0] && load(file.files[0]),
  });
  const loadLabel = h("label", { class: "button", for: "template-file" }, icon("upload"), "Load from a landmark file");
  const pathButton = button("New path", {
    icon: "path",
    small: true,
    shortcut: "N",
    testid: "template-new-path",
    onclick: startPath,
  });
  const closeButton = button("Close path", {
    icon: "check",
    small: true,
    shortcut: "C",
    testid: "template-close-path",
    onclick: close,
  });
  const mirrorButton = button("Mirror", {
    icon: "mirror",
    small: true,
    shortcut: "X",
    pressed: false,
    onclick: () => mirrorMode(),
    title: "Each point gets a twin on the other side of the line",
  });
  const flipButton = button("Flip", {
    icon: "swap",
    small: true,
    onclick: () => apply({ ...draft, points: flip(draft.points, draft.mirror) }, "flip"),
    title: "Swap left and right",
  });
  const doneButton = button("Done", { icon: "check", kind: "primary", testid: "template-done", onclick: done });
  const cancelButton = button("Cancel", { kind: "ghost", onclick: leave });
  const message = h("p", { class: "small error-text", role: "status" });
  const list = makeList();
  const paths = makePaths();
  const placedButton = button("The points are in place", {
    kind: "primary",
    small: true,
    onclick: () => {
      placing = false;
      doc.select([]);
      refresh();
    },
  });
  const panel = h(
    "div",
    { class: "template-panel" },
    h(
      "section",
      { class: "panel" },
      heading,
      intro,
      h("div", { class: "row" }, pathButton, closeButton, mirrorButton, flipButton),
    ),
    h(
      "section",
      { class: "panel grow template-lists" },
      h("h2", { class: "panel-title" }, "Points"),
      list.element,
      h("h2", { class: "panel-title" }, "Paths"),
      paths.element,
    ),
    h("section", { class: "panel side-foot" }, message, h("div", { class: "row" }, doneButton, cancelButton)),
  );

  function explain() {
    heading.textContent = saved ? "Edit the template" : "Start with a template";
    const steps = placing
      ? [
          h(
            "p",
            {},
            loaded ? `Points of ${loaded}. ` : "",
            "Drag the frame's handles until the points lie on this picture, then move single points.",
          ),
          placedButton,
        ]
      : saved
        ? [
            h(
              "p",
              { class: "muted small" },
              "Click the picture to add points. Shift-click a point to run the path through it. Other pictures change when you press Done.",
            ),
          ]
        : draft.names.length
          ? [
              h(
                "p",
                { class: "muted small" },
                "Clicking goes on with the path; a click on its first point closes it. Shift-click a point to run the path through it. Names can be changed below, now or later.",
              ),
            ]
          : [
              h(
                "p",
                {},
                "Which points will be marked on every picture? Click them on this one, along each outline in turn – clicking goes on with the path.",
              ),
              h("p", { class: "small muted" }, "Or take them from a file that has them (.pts, .ljson, .asf …):"),
              h("div", {}, file, loadLabel),
            ];
    intro.replaceChildren(...steps.flat().filter(Boolean));
  }

  function buttons() {
    explain();
    const open = draft.path >= 0;
    pathButton.disabled = !open;
    closeButton.disabled = !open || draft.contours[draft.path].indices.length < (draft.twinPath < 0 ? 3 : 2);
    mirrorButton.disabled = placing;
    flipButton.hidden = !placing && !saved;
    doneButton.disabled = busy || draft.names.length === 0;
    cancelButton.hidden = saved === null && !draft.names.length;
    cancelButton.lastChild.textContent = saved ? "Cancel" : "Start over";
    message.textContent = "";
  }

  /** The points with their names to type in, to drag into another order, and to delete. */
  function makeList() {
    const element = h("ol", {
      class: "template-points",
      "aria-label": "Points of the template",
      dataset: { testid: "point-list" },
    });
    let rows = [];
    let dragged = -1;

    function makeRow() {
      const at = () => rows.findIndex((row) => row.element === item);
      const number = h("span", { class: "number muted" });
      const name = h("input", {
        type: "text",
        class: "text",
        spellcheck: "false",
        autocomplete: "off",
        onfocus: () => {
          if (!selection.has(at()) || selection.size > 1) doc.select([at()], at());
        },
        oninput: () => apply(drafts.rename(draft, at(), name.value), "rename", `rename ${at()}`),
      });
      const grip = h(
        "span",
        { class: "grip", title: "Drag to reorder (Alt + ↑ ↓ in the name)", "aria-hidden": "true" },
        "⠿",
      );
      const twin = h("span", { class: "twin muted small" });
      const gone = button("Delete", {
        icon: "trash",
        iconOnly: true,
        kind: "ghost",
        small: true,
        onclick: () => deleteChosen([at()]),
      });
      const item = h("li", { class: "template-point" }, grip, number, name, twin, gone);
      grip.addEventListener("pointerdown", (event) => {
        dragged = at();
        grip.setPointerCapture(event.pointerId);
        item.classList.add("dragged");
        event.preventDefault();
      });
      grip.addEventListener("pointermove", (event) => {
        if (dragged < 0) return;
        const over = rows.findIndex((row) => {
          const box = row.element.getBoundingClientRect();
          return event.clientY >= box.top && event.clientY < box.bottom;
        });
        rows.forEach((row, i) => {
          row.element.classList.toggle("drop-above", i === over && over < dragged);
          row.element.classList.toggle("drop-below", i === over && over > dragged);
        });
      });
      const drop = (event) => {
        const over = rows.findIndex(
          (row) => row.element.classList.contains("drop-above") || row.element.classList.contains("drop-below"),
        );
        rows.forEach((row) => row.element.classList.remove("drop-above", "drop-below", "dragged"));
        const from = dragged;
        dragged = -1;
        if (event.type === "pointerup" && over >= 0) shift(from, over);
      };
      grip.addEventListener("pointerup", drop);
      grip.addEventListener("pointercancel", drop);
      name.addEventListener("keydown", (event) => {
        const i = at();
        const step = { ArrowUp: -1, ArrowDown: 1 }[event.key];
        const go = event.key === "Enter" ? 1 : step;
        if (!go) return;
        event.preventDefault();
        event.stopPropagation();
        if (event.altKey && step) shift(i, i + step);
        const next = Math.min(Math.max(i + go, 0), rows.length - 1);
        rows[next].name.focus();
        rows[next].name.select();
      });
      return { element: item, number, name, twin, gone, grip };
    }

    return {
      element,
      render() {
        while (rows.length > draft.names.length) rows.pop().element.remove();
        while (rows.length < draft.names.length) {
          const row = makeRow();
          rows.push(row);
          element.append(row.element);
        }
        rows.forEach((row, i) => {
          row.number.textContent = String(i + 1);
          if (row.name.value !== draft.names[i]) row.name.value = draft.names[i];
          row.name.setAttribute("aria-label", `Name of point ${i + 1}`);
          row.gone.setAttribute("aria-label", `Delete ${draft.names[i]}`);
          const twin = draft.mirror[i];
          row.twin.textContent = twin === i ? "" : `⇄ ${twin + 1}`;
          row.twin.title = twin === i ? "" : `Twin: ${draft.names[twin]}`;
        });
        element.dataset.empty = draft.names.length ? "" : "No points yet";
        this.mark();
      },
      mark() {
        rows.forEach((row, i) => row.element.classList.toggle("chosen", selection.has(i)));
        if (active >= 0) rows[active]?.element.scrollIntoView({ block: "nearest" });
      },
    };
  }

  function makePaths() {
    const element = h("ul", { class: "template-paths", "aria-label": "Paths of the template" });
    const row = ({ indices, closed }, k) => {
      const current = k === draft.path;
      const label = `Path ${k + 1}`;
      return h(
        "li",
        { class: current ? "template-path chosen" : "template-path" },
        h(
          "span",
          { class: "grow" },
          label,
          h("span", { class: "muted small" }, ` ${indices.length} points${current ? ", being drawn" : ""}`),
        ),
        !current &&
          indices.length > 2 &&
          button(closed ? "closed" : "open", {
            small: true,
            kind: "ghost",
            pressed: closed,
            "aria-label": `${label}: closed`,
            onclick: () => apply(drafts.setClosed(draft, k, !closed), "close path"),
          }),
        !current &&
          button(`Go on with ${label.toLowerCase()}`, {
            icon: "edit",
            iconOnly: true,
            small: true,
            kind: "ghost",
            onclick: () => apply(drafts.continuePath(draft, k), "continue path"),
          }),
        button(`Delete ${label.toLowerCase()}`, {
          icon: "trash",
          iconOnly: true,
          small: true,
          kind: "ghost",
          title: "Delete this path; its points stay",
          onclick: () => apply(drafts.removePath(draft, k), "delete path"),
        }),
      );
    };
    return {
      element,
      render() {
        element.dataset.empty = draft.contours.length ? "" : "No paths yet";
        element.replaceChildren(...draft.contours.map(row));
      },
    };
  }

  // Files and saving ------------------------------------------------------------------------------------------------

  async function load(chosen) {
    try {
      const template = await app.api.upload(
        `${app.api.url("template/file")}?name=${encodeURIComponent(chosen.name)}`,
        chosen,
      );
      const box = bounds(template.points ?? []);
      if (box === null) throw new Error(`${chosen.name} has no points; choose another file.`);
      const lies = box[0] >= -1 && box[1] >= -1 && box[2] <= viewer.width && box[3] <= viewer.height;
      const large = Math.max((box[2] - box[0]) / viewer.width, (box[3] - box[1]) / viewer.height) > 0.2;
      // Often the file is this very picture's; points that fit are left where they are.
      const points = lies && large ? template.points : fitInto(template.points, viewer.width, viewer.height);
      placing = true;
      loaded = chosen.name;
      selection = new Set();
      apply(
        {
          ...drafts.draftOf(
            template,
            points.map((p) => p && rounded(p)),
          ),
          origins: template.names.map(() => null),
        },
        "load",
      );
      say(`${template.names.length} points loaded; put them in place`);
    } catch (error) {
      app.toast(error, "bad");
    } finally {
      file.value = ""; // so that the same file can be chosen again
    }
  }

  async function done() {
    const wrong = drafts.fault(draft);
    if (wrong) {
      message.textContent = wrong;
      return;
    }
    const mapping = saved && drafts.rearranges(draft, saved.names.length) ? draft.origins : null;
    // As it is now: while the person is asked, the template may be changed elsewhere.
    const revision = saved ? saved.revision : null;
    const work = { template: { ...drafts.templateOf(draft), revision }, mapping, points: draft.points, isFresh };
    if (mapping && !(await agreed())) return;
    busy = true;
    buttons();
    try {
      await onsave(work);
      kept.set(null);
    } catch (error) {
      message.textContent = error.message;
      app.toast(error, "bad");
    } finally {
      busy = false;
      doneButton.disabled = false;
    }
  }

  async function agreed() {
    const files = app.state.project.pictures.filter(
      (picture) => picture.placed > 0 && picture.state !== "proposed",
    ).length;
    if (files === 0) return true;
    const what = drafts.changes(draft, saved.names.length).join("; ");
    const text = `The landmark files of ${files} ${files === 1 ? "picture" : "pictures"} will be rewritten: ${what}. This cannot be undone.`;
    return app.confirm("Change the template?", text, files === 1 ? "Rewrite 1 file" : `Rewrite ${files} files`);
  }

  async function leave() {
    if (saved) {
      oncancel();
      return;
    }
    if (
      draft.names.length &&
      !(await app.confirm("Start over?", "All points of the new template go away.", "Start over"))
    )
      return;
    kept.set(null);
    start(null, null);
  }

  /** Edit `template` (null: make a new one, or go on with one) with its points at `points` on the picture. */
  function start(template, points) {
    if (template) kept.set(null); // a template that came from elsewhere makes a draft void
    saved = template;
    isFresh = template === null;
    loaded = "";
    placing = false;
    axis = null;
    mirrorButton.setAttribute("aria-pressed", "false");
    selection = new Set();
    active = -1;
    shown = null;
    draft = template ? drafts.draftOf(template, points) : (kept.get() ?? drafts.EMPTY);
    history = new History(draft);
    refresh();
  }

  /** The template is another now: what was made becomes a change of that one. */
  function rebase(template) {
    const before = saved;
    saved = template;
    draft = drafts.rebased(draft, before, template);
    history = new History(drafts.draftOf(template));
    history.push(draft, "what was made before");
    shown = null;
    kept.set(null);
    refresh();
  }

  function travel(state) {
    if (!state) return;
    draft = state;
    shown = null;
    if (!draft.names.length) placing = false;
    refresh();
  }

  // Drawing ---------------------------------------------------------------------------------------------------------

  function draw(ctx, tool) {
    const ghost = tool.gesture?.ghost ?? draft;
    const points = tool.gesture?.ghost ? ghost.points : doc.points;
    if (axis !== null) drawAxis(ctx);
    drawPaths(ctx, viewer, points, ghost.contours, false);
    if (ghost.path >= 0 && !tool.gesture && tool.pointer && tool.hovered < 0 && !placing)
      drawNextLine(ctx, tool.pointer.at);
    drawMarks(ctx, viewer, {
      points,
      invisible: doc.invisible,
      selection,
      active,
      hovered: tool.hovered,
      suggested: false,
    });
    const named = new Set([...selection, tool.hovered]);
    drawNames(
      ctx,
      viewer,
      points,
      ghost.names,
      [...named].filter((i) => i >= 0),
    );
    if (!tool.gesture) drawFrame(ctx, viewer, points, doc.framed());
  }

  /** From the path's last point to the pointer: what a click would draw. */
  function drawNextLine(ctx, at) {
    const last = draft.points[draft.contours[draft.path]?.indices.at(-1)];
    if (!last) return;
    ctx.beginPath();
    ctx.moveTo(...viewer.toScreen(last));
    ctx.lineTo(...at);
    ctx.setLineDash([3, 4]);
    ctx.strokeStyle = COLOURS.placed;
    ctx.lineWidth = 1.2;
    ctx.globalAlpha = 0.7;
    ctx.stroke();
    ctx.setLineDash([]);
    ctx.globalAlpha = 1;
  }

  function drawAxis(ctx) {
    const x = gripAt();
    ctx.beginPath();
    ctx.moveTo(x, 0);
    ctx.lineTo(x, viewer.canvas.clientHeight);
    ctx.setLineDash([8, 5]);
    ctx.strokeStyle = COLOURS.axis;
    ctx.lineWidth = 1.5;
    ctx.stroke();
    ctx.setLineDash([]);
    ctx.beginPath();
    ctx.arc(x, gripY(), 11, 0, 2 * Math.PI);
    ctx.fillStyle = COLOURS.axis;
    ctx.fill();
    drawText(ctx, "⇔", x, gripY(), { align: "center" });
  }

  function key(event) {
    const plain = !event.ctrlKey && !event.metaKey && !event.altKey;
    if (!plain) return false;
    const letter = event.key.toLowerCase();
    if (letter === "n") startPath();
    else if (letter === "c") close();
    else if (letter === "x") mirrorMode();
    else if (letter === "p") addInTheMiddle();
    else if (event.key === "Delete" || event.key === "Backspace") deleteChosen();
    else if (event.key === "Escape") {
      if (selection.size) doc.select([]);
      else startPath();
    } else return false;
    return true;
  }

  return {
    doc,
    panel,
    start,
    rebase,
    draw,
    key,
    get draft() {
      return draft;
    },
    get active() {
      return active;
    },
    get history() {
      return history;
    },
    nudge: (points, what, coalesce) => apply({ ...draft, points }, what, coalesce),
    /** Arrow keys move the axis where no point is chosen. */
    shiftAxis(event) {
      const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (axis === null || !by) return false;
      axis += by * (event.shiftKey ? 10 : 1);
      viewer.redraw();
      return true;
    },
    undo: () => travel(history.undo()),
    redo: () => travel(history.redo()),
    /** Whether changes of the saved template would be lost. */
    get isChanging() {
      return saved !== null && history.canUndo;
    },
    /** Whether something was made here that is not saved. */
    get hasChanges() {
      return saved === null ? draft.names.length > 0 : history.canUndo;
    },
    get started() {
      return draft.names.length > 0;
    },
    get prompt() {
      if (placing) return "Put the points in place: drag the frame's handles, then single points";
      if (!draft.names.length) return "Click the first point of your template on this picture";
      return draft.path < 0
        ? "Click where the next path begins"
        : "Click the next point of this path – C closes it, N begins another";
    },
  };
}
