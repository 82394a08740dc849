// The Annotate tab: place the points of one picture after another with the help of the model. This module connects its
// parts.

import { createCommands } from "./annotate-commands.js";
import { createKeys, SHORTCUTS } from "./annotate-keys.js";
import { createOpening } from "./annotate-opening.js";
import { createSaving } from "./annotate-saving.js";
import { createTemplates } from "./annotate-template.js";
import { createStatus, createToolbar } from "./annotate-toolbar.js";
import { descriptionOf, placeOf, promptOf, several, tallyOf } from "./annotate-words.js";
import { createAssist } from "./assist.js";
import { drawGesture, drawHint, drawMarking, loupeOver } from "./drawing.js";
import { PointTool } from "./gestures.js";
import { Marking } from "./marking.js";
import { nextMissing } from "./points.js";
import { createPointsPanel } from "./points-panel.js";
import { createReview } from "./review.js";
import { ScaleBar } from "./scale-bar.js";
import { Tracing } from "./tracing.js";
import { h } from "./ui.js";
import { Viewer } from "./viewer.js";

const SAY_AFTER = 350; // milliseconds after the last arrow key until a position is announced
const BUSY = { hovered: -1, gesture: {}, pointer: null }; // the tool, for the marks, while it edits something else

export class Tab {
  shortcuts = SHORTCUTS;
  name = null; // name of the open picture
  visible = false;
  drawn = { names: false, contours: true, ellipses: true };
  boxing = false; // whether dragging selects with a box
  waiting = null; // timer of an announcement
  container = h("div", { testid: "annotate-viewer" });
  prompt = h("div.annotate-prompt", { hidden: true });
  hint = h("canvas.annotate-hint", { hidden: true, "aria-hidden": "true" });
  cover = h("div.annotate-cover", { hidden: true });
  spoken = h("p.visually-hidden", { role: "status", "aria-live": "polite" });
  alternative = h("p.visually-hidden", { id: "annotate-text" });
  side = h("aside.side.annotate-side", { "aria-label": "Points" });
  viewer = new Viewer(this.container, { label: "Picture with landmarks" });

  /** @param {HTMLElement} root; @param {App} app */
  constructor(root, app) {
    this.app = app;
    const { state } = app;
    this.state = state;
    const { viewer } = this;
    app.selection = () => [...this.marking.selection];
    app.saved = () => this.saver.flush();
    viewer.canvas.setAttribute("aria-describedby", "annotate-text");
    this.container.append(this.prompt, this.hint, this.cover, this.alternative, this.spoken);
    this.say = (text) => { this.spoken.textContent = text; };
    this.marking = new Marking({
      template: () => this.template, onchange: () => this.changed(), onselect: () => this.chosen(),
      onpreview: () => viewer.redraw(),
      onplaced: (index) => { // then select the next missing one
        const next = nextMissing(this.marking.points, index);
        this.marking.select([next < 0 ? index : next]);
        this.sayPlace(index, next);
      },
    });
    this.ruler = new ScaleBar(this.marking, {
      onchange: () => this.refresh(),
      onpreview: () => viewer.redraw(), alone: () => state.pictures.length < 2,
      onshare: (bar, anyway) => { // with all that the list can show
        const others = state.pictures.map(({ name }) => name).filter((name) => name !== this.name);
        app.bulk.run("scaled", others, { bar, of: this.name, anyway });
      },
    });
    this.tracing = new Tracing(this.marking, { onchange: () => this.refresh() });
    this.commands = createCommands(this);
    this.status = createStatus(this);
    this.toolbar = createToolbar(this);
    this.panel = createPointsPanel(this);
    this.opening = createOpening(this, () => this.panel.start);
    this.saving = createSaving(this);
    this.saver = this.saving.saver;
    this.templates = createTemplates(this);
    this.key = createKeys(this);
    this.assist = createAssist(app, this.commands);
    this.review = createReview(this);
    this.tool = new PointTool(viewer, () => this.doc, { boxes: () => this.boxing, onend: () => this.refresh() });
    viewer.tool = this.tool;
    viewer.addLayer((ctx) => this.draw(ctx));
    root.classList.add("annotate");
    root.append(h("div.workspace", this.toolbar.element, this.container), this.side);
    this.listen();
    this.expose();
  }

  get template() { return this.state.project?.template ?? null; }
  get editing() { return this.templates.editing; }
  /** Indices of the points of the open picture that may be slips. */
  get wrong() { return this.state.picture(this.name)?.slip_points ?? []; }
  /** What is being drawn: the scale bar, or a contour that is traced; undefined if nothing. */
  get drawing() { return [this.ruler, this.tracing].find(({ on }) => on); }
  /** The document that gestures edit: the template, what is being drawn, or the marks of the picture. */
  get doc() { return this.editing ? this.templates.doc : (this.drawing ?? this.marking); }
  focus() { this.viewer.canvas.focus({ preventScroll: true }); }

  /** Run the action of a button. After a click, return the focus to the picture, so that Enter works there. */
  act(event, work) {
    work();
    if (event.detail > 0) this.focus();
  }

  listen() {
    const { state, saver, opening, commands } = this;
    state.addEventListener("select", (/** @type {any} */ { detail }) => this.selected(detail));
    state.addEventListener("project", () => this.templates.noticed() || opening.refresh());
    state.addEventListener("landmarks", (/** @type {any} */ { detail }) => saver.heard(detail.name, detail.revision));
    state.addEventListener("online", (/** @type {any} */ { detail }) => detail && this.online());
    this.viewer.addEventListener("view", () => opening.sharpen());
    // A gesture in progress is not saved when the page is closed.
    document.addEventListener("visibilitychange", () => document.visibilityState === "hidden" && saver.flush());
    addEventListener("pagehide", () => saver.flush());
    document.addEventListener("keyup", (event) => event.key.toLowerCase() === "h" && commands.hideMarks(false));
    addEventListener("blur", () => commands.hideMarks(false));
    setTimeout(() => this.saving.sendKept(), 500);
  }

  show() {
    this.visible = true;
    if (this.name !== this.state.current || !this.marking.book) this.opening.open(this.state.current);
    this.refresh();
    this.focus();
  }

  hide() {
    this.visible = false;
    this.tool.cancel();
    this.saver.flush();
  }

  online() {
    this.saver.retry();
    if (!this.marking.book && this.visible && !this.editing) this.opening.open(this.state.current);
  }

  selected({ name, before }) {
    if (name === this.name && this.editing) return; // the selection was reverted by mayLeave below
    if (!this.templates.mayLeave(before)) return;
    if (this.visible) this.opening.open(name);
    else this.saver.flush();
  }

  leavePicture(name) { this.saver.flush(name).then(() => this.assist.left()); }

  changed() {
    this.saving.change(this.name, this.marking.state);
    this.refresh();
  }

  chosen() {
    this.commands.escaped = false;
    this.panel.mark(this.marking);
    this.showHint();
    this.viewer.redraw();
  }

  refresh() {
    if (!this.tool) return; // the parts are not complete yet
    const { assist, editing, marking, panel, templates } = this;
    const making = this.template ? [templates.panel] : [templates.panel, assist.notes];
    const shown = editing ? making : [assist.element, this.review, assist.notes, ...panel.elements];
    if (this.side.firstChild !== shown[0]) {
      this.side.replaceChildren(...shown);
      this.side.scrollTop = 0;
    }
    const isMarking = !editing && marking.book !== null;
    this.toolbar.refresh({ history: this.doc.history, editing, marking: isMarking });
    panel.edit.disabled = !isMarking || this.tracing.on;
    if (!editing) panel.render(marking);
    assist.sure.hidden = marking.state?.source !== "layout";
    panel.tally.textContent = marking.book ? tallyOf(marking) : "";
    // A template is saved only with Done, so the status must not say "Saved" before.
    if (editing && templates.doc.started) this.status.show("draft", "");
    else if (this.status.state === "draft") this.saver.report();
    this.showHint();
    this.describe();
    this.viewer.redraw();
  }

  showHint() {
    const { cover, drawing, editing, hint, marking, prompt, template } = this;
    hint.hidden = editing || drawing || !marking.placing || !template?.points || !cover.hidden;
    if (!hint.hidden) drawHint(hint, template.points, template.contours, marking.active, getComputedStyle(hint));
    const own = () => (!marking.book ? "" : drawing?.prompt ?? promptOf(marking));
    const text = !cover.hidden ? "" : editing ? this.templates.prompt : own();
    prompt.hidden = !text;
    prompt.dataset.kind = marking.suggested && !editing && !drawing ? "suggested" : "";
    if (prompt.textContent !== text) prompt.textContent = text;
  }

  describe() {
    const { editing, marking, name, templates } = this;
    this.alternative.textContent = editing ? `Editing the template: ${several(templates.doc.names.length, "point")}.`
      : marking.book ? descriptionOf(name, marking) : "No picture is open.";
    this.viewer.canvas.setAttribute("aria-label", name ? `${name} with landmarks` : "Picture with landmarks");
  }

  sayPlace(index, next = -1) { this.say(placeOf(this.marking, index, next)); }

  /** Announce moved points after a pause, so that a burst of keys does not flood a screen reader. */
  saySoon(indices) {
    clearTimeout(this.waiting);
    this.waiting = setTimeout(() => {
      if (this.doc !== this.marking) return;
      if (indices.length === 1) this.sayPlace(indices[0]);
      else this.say(`${indices.length || "All"} points moved`);
    }, SAY_AFTER);
  }

  draw(ctx) {
    const { viewer, tool, marking } = this;
    if (!viewer.width || marking.hidden) return;
    if (this.editing) this.templates.draw(ctx, tool);
    else if (marking.book) {
      if (this.tracing.on) this.tracing.draw(ctx, viewer);
      drawMarking(ctx, viewer, this.doc === marking ? tool : BUSY, marking, this.drawn, this.wrong);
      this.ruler.draw(ctx, viewer);
    }
    drawGesture(ctx, viewer, tool, marking.suggested);
  }

  /** Hooks for browser tests: positions of points in the picture and on the page. */
  expose() {
    const annotate = {
      viewer: this.viewer,
      /** Points as shown: of the picture, or of the template that is being edited. */
      points: () => this.doc.points.map((point) => point && point.slice()),
      /** Position of a point, or of any [x, y] of the picture, on the page: [clientX, clientY] or null. */
      toClient: (what) => {
        const point = Array.isArray(what) ? what : this.doc.points[what];
        return point ? this.viewer.toClient(point) : null;
      },
      /** "file", "proposal", "layout", "none", or "template" while it is edited; null while a picture opens. */
      source: () => (this.editing ? "template" : (this.marking.state?.source ?? null)), name: () => this.name,
      wrong: () => this.wrong,
      selection: () => [...this.doc.selection], invisible: () => [...this.marking.invisible], bar: () => this.ruler.bar,
      undoSteps: () => this.doc.history?.past.length ?? 0, isDirty: () => this.saver.dirty.length > 0,
      /** The loupe: {xy under its centre, centre on the screen, scale}, or null. */
      loupe: () => this.tool.loupe && { xy: this.tool.loupe, ...loupeOver(this.viewer, this.tool.pointer) },
    };
    Object.assign(window.liaamStudio, { annotate });
  }
}
