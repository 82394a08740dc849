// The Annotate tab: place the points of one picture after another with the help of the model. This module connects its
// parts.

import { createCommands } from "./annotate-commands.js";
import { createKeys, SHORTCUTS } from "./annotate-keys.js";
import { createOpening } from "./annotate-opening.js";
import { createSaving } from "./annotate-saving.js";
import { createTemplates } from "./annotate-template.js";
import { Shown } from "./annotate-shown.js";
import { createStatus, createToolbar } from "./annotate-toolbar.js";
import { descriptionOf, outsideText, placeOf, promptOf, several } from "./annotate-words.js";
import { api } from "./api.js";
import { createAssist } from "./assist.js";
import { drawGesture, drawHint, drawMarking, loupeOver } from "./drawing.js";
import { PointTool } from "./gestures.js";
import { chosenKeys, meant } from "./hotkeys.js";
import { Marking } from "./marking.js";
import { createMeasured } from "./measured.js";
import { sameBar } from "./points.js";
import { createPointsPanel } from "./points-panel.js";
import { createReview } from "./review.js";
import { ScaleBar } from "./scale-bar.js";
import { Tracing } from "./tracing.js";
import { button, h } from "./ui.js";
import { Viewer } from "./viewer.js";

const SAY_AFTER = 350; // milliseconds after the last arrow key until a position is announced
const SEND_KEPT_AFTER = 500; // milliseconds until marks of an earlier page are saved: first, the page opens
// What marks are drawn with, instead of the tool, while gestures edit something else: no point is near the pointer, and
// a gesture is in progress, so that there is neither a frame nor the name of the next point.
const BUSY = { hovered: -1, gesture: {}, pointer: null };

const NEAR = 24; // css pixels around the sketch of the points, within which the pointer sees through it

export class Tab {
  shortcuts = SHORTCUTS;
  shown = new Shown();
  #visible = false;
  #waiting = null; // timer of an announcement
  #container = h("div", { testid: "annotate-viewer" });
  #prompt = h("div.annotate-prompt", { hidden: true });
  #saidTogether = false;
  #hint = h("canvas.annotate-hint", { hidden: true, "aria-hidden": "true" });
  #spoken = h("p.visually-hidden", { role: "status", "aria-live": "polite" });
  #alternative = h("p.visually-hidden", { id: "annotate-text" });
  #side = h("aside.side.annotate-side", { "aria-label": "Points" });
  #finder; // button of the scale bar
  viewer = new Viewer(this.#container, { label: "Picture with landmarks", mirrors: true });

  /** Announce a text to screen readers. */
  say = (text) => { this.#spoken.textContent = text; };

  /** @param {HTMLElement} root; @param {App} app */
  constructor(root, app) {
    this.app = app;
    const { state } = app;
    this.state = state;
    const { viewer } = this;
    viewer.canvas.setAttribute("aria-describedby", "annotate-text");
    const cover = h("div.annotate-cover", { hidden: true }); // the opening's
    this.#container.append(this.#prompt, this.#hint, cover, this.#alternative, this.#spoken);
    this.#container.addEventListener("pointermove", ({ clientX: x, clientY: y }) => {
      const { left, right, top, bottom } = this.#hint.getBoundingClientRect();
      this.#hint.classList.toggle("under", x > left - NEAR && x < right + NEAR && y > top - NEAR && y < bottom + NEAR);
    });
    this.marking = new Marking({
      template: () => this.template, locked: state.readOnly,
      onchange: () => this.#changed(),
      onselect: () => this.#chosen(),
      onpreview: () => viewer.redraw(),
      onplaced: (index) => this.#placed(index),
      ontogether: () => this.#sayTogether(),
    });
    this.ruler = new ScaleBar(this.marking, {
      onchange: () => this.refresh(),
      onpreview: () => viewer.redraw(),
      alone: () => state.pictures.length < 2,
      onshare: (bar, anyway) => this.#shareBar(bar, anyway),
      onfind: (asked) => this.#findScale(asked),
    });
    this.#finder = button("Find it in the picture…", {
      icon: "ruler", small: true, hidden: true, kind: "annotate-finder", testid: "scale-find",
      onclick: () => {
        this.ruler.turn(false);
        this.ruler.find();
      },
    });
    this.#container.append(this.#finder);
    this.tracing = new Tracing(this.marking, { onchange: () => this.refresh() });
    this.measured = createMeasured(this);
    // In this order: the later ones use the earlier ones.
    this.commands = createCommands(this);
    this.status = createStatus(this);
    this.toolbar = createToolbar(this);
    this.panel = createPointsPanel(this);
    this.opening = createOpening(this, { begins: () => this.panel.start, cover });
    this.saving = createSaving(this);
    this.saver = this.saving.saver;
    this.templates = createTemplates(this);
    this.key = createKeys(this);
    this.assist = createAssist(app, this.commands, () => this.review.exportAll());
    this.review = createReview(this);
    this.tool = new PointTool(viewer, () => this.doc, { onend: () => this.refresh() });
    viewer.use(this.tool);
    this.shown.addEventListener("change", () => viewer.redraw());
    viewer.addLayer((ctx) => this.#draw(ctx));
    root.classList.add("annotate");
    root.append(h("div.workspace", this.toolbar.element, this.#container), this.#side);
    root.addEventListener("mousedown", (event) => this.#keepFocus(event));
    this.#listen();
    this.#expose();
  }

  /** Name of the open picture, or null. */
  get name() { return this.opening.name; }
  /** Whether the tab is open. */
  get visible() { return this.#visible; }
  /** The points as shown: of the picture, or of the template that is being edited. */
  get points() { return this.doc.points; }
  get template() { return this.state.project?.template ?? null; }
  get editing() { return this.templates.editing; }
  /** Indices of the points of the open picture that may be slips. */
  get wrong() { return this.state.picture(this.name)?.slip_points ?? []; }
  /** What is being drawn: the scale bar, or a contour that is traced; undefined if nothing. */
  get drawing() { return [this.ruler, this.tracing].find(({ on }) => on); }
  /** The document that gestures edit: the template, what is being drawn, or the marks of the picture. */
  get doc() { return this.editing ? this.templates.doc : (this.drawing ?? this.marking); }
  /** Resolves once all moved points are saved, or cannot be. */
  saved() { return this.saver.flush(); }
  focus() { this.viewer.canvas.focus({ preventScroll: true }); }

  /** The mouse chooses buttons without taking the focus from the picture, so that Enter accepts afterwards. Only those to
   *  which Tab has led are pressed by Enter. */
  #keepFocus(event) {
    if (this.editing || !(event.target instanceof Element) || event.target.closest("details")) return; // Escape closes those
    if (!event.target.closest("button, summary, label.check, .segmented")) return;
    event.preventDefault();
    this.focus();
  }

  /** Run the action of a button. After a click, return the focus to the picture, so that Enter works there. */
  act(event, work) {
    work();
    if (event.detail > 0) this.focus();
  }

  #listen() {
    const { state, saver, opening, commands } = this;
    state.addEventListener("select", (/** @type {any} */ { detail }) => this.#selected(detail));
    state.addEventListener("project", () => this.templates.noticed() || opening.refresh());
    state.addEventListener("project", () => this.templates.look());
    state.addEventListener("fitting", () => this.templates.look());
    state.addEventListener("landmarks", (/** @type {any} */ { detail }) => {
      const { name, revision, beside } = /** @type {LandmarksChanged} */ (detail);
      saver.heard(name, revision, beside);
    });
    state.addEventListener("online", (/** @type {any} */ { detail }) => detail && this.#online());
    this.viewer.addEventListener("view", () => opening.sharpen());
    this.viewer.addEventListener("mirror", () => commands.mirrorView());
    // A gesture in progress is not saved when the page is closed.
    document.addEventListener("visibilitychange", () => document.visibilityState === "hidden" && saver.flush());
    addEventListener("pagehide", () => saver.flush());
    document.addEventListener("keyup", (event) => meant(event.key, chosenKeys()) === "h" && commands.hideMarks(false));
    addEventListener("blur", () => commands.hideMarks(false));
    setTimeout(() => this.saving.sendKept(), SEND_KEPT_AFTER);
  }

  /** The tab was opened. */
  show() {
    this.#visible = true;
    if (this.name !== this.state.current || !this.marking.book) this.opening.open(this.state.current);
    this.refresh();
    this.focus();
  }

  /** Another tab was opened. */
  hide() {
    this.#visible = false;
    this.tool.cancel();
    this.saver.flush();
  }

  /** The server is reachable again. */
  #online() {
    this.saver.retry();
    if (!this.marking.book && this.visible && !this.editing) this.opening.open(this.state.current);
  }

  /** Another picture was selected in the list. */
  #selected({ name, before }) {
    if (name === this.name && this.editing) return; // the selection was reverted by mayLeave below
    if (!this.templates.mayLeave(before)) return;
    if (this.visible) this.opening.open(name);
    else this.saver.flush();
  }

  /** Save a picture, then train if it is time: the server has its landmarks only then. */
  leavePicture(name) { this.saver.flush(name).then(() => this.assist.left()); }

  /** The marks of the open picture were changed. */
  #changed() {
    this.saving.change(this.name, this.marking.state);
    this.refresh();
  }

  /** Say once what points that are moved together count as. */
  #sayTogether() {
    if (!this.#saidTogether) this.app.toast("Points that are moved together still count as proposed, since nobody looked at each of them. Y confirms a selected one.");
    this.#saidTogether = true;
  }

  /** A point was placed: select the next missing one. */
  #placed(index) {
    const next = this.marking.nextMissing(index);
    this.marking.select([next < 0 ? index : next]);
    this.sayPlace(index, next);
  }

  /** Ask the server for the ruler or the scale bar of the open picture. Say why if there is none.
   *  @param {ScaleQuery} asked */
  async #findScale(asked) {
    try {
      return await api.get(api.url("pictures/{name}/scale", { name: this.name, ...asked }));
    } catch (error) {
      this.app.toast(error, "bad");
      return null;
    }
  }

  /** The scale bar of the open picture in all others of the shown folder, also in those that filters hide: {redo(), undo()}
   *  set it and take it back there. The message of redo() offers to take it back everywhere, also here. */
  #shareBar(bar, anyway) {
    const { name, marking, opening, saving, app: { list: { bulk } } } = this;
    const before = marking.state.bar;
    const others = this.state.pictures.map((picture) => picture.name).filter((other) => other !== name);
    /** @type {Partial<Review>} */
    const more = { bar, of: name, anyway };
    let changed = null; // promise of the others that have it; null if it was taken back
    const step = {
      redo: () => {
        const work = bulk.run("scaled", others, { more, undo: takeBack });
        changed = work.catch(() => []); // the message says why
        return work;
      },
      undo: async () => {
        const names = await changed;
        changed = null;
        if (names?.length) await bulk.run("unscaled", names);
      },
    };
    const takeBack = () => {
      const { history } = opening.bookOf(name);
      const isOpen = name === this.name;
      if (!changed) return undefined;
      if (isOpen && history.beyond("undo") === step) return this.commands.travel("undo"); // also of the others
      if (!sameBar(history.state.bar, bar)) return step.undo(); // another was drawn here since
      if (isOpen) marking.change({ bar: before }, "scale as before", null, { beyond: { undo: step.redo, redo: step.undo } });
      else if (history.beyond("undo") === step) history.undo();
      else history.push({ ...history.state, bar: before }, "scale as before");
      if (!isOpen) saving.change(name, history.state);
      return step.undo();
    };
    return step;
  }

  /** Other points were selected. */
  #chosen() {
    this.commands.stay();
    this.panel.mark(this.marking);
    this.#showHint();
    this.viewer.redraw();
  }

  /** Elements of the side panel. */
  #sideElements() {
    const { assist, editing, panel, templates } = this;
    // The head stays in place, and the points begin at the same height for every picture.
    if (!editing) return [assist.element, panel.points, this.review.element, assist.notes, panel.foot];
    // Before there is a template, notices may say why no landmark file gave one.
    return this.template ? [templates.panel] : [templates.panel, assist.notes];
  }

  /** Show the state of all parts; after each change of the marks, the template, or what is edited. */
  refresh() {
    if (!this.tool) return; // the parts are not complete yet
    const { assist, editing, marking, panel, templates } = this;
    const elements = this.#sideElements();
    if (this.#side.firstChild !== elements[0]) { // else they would lose the focus and the scroll position
      this.#side.replaceChildren(...elements);
      this.#side.scrollTop = 0;
    }
    const isMarking = !editing && marking.book !== null;
    this.toolbar.refresh({ history: this.doc.history, editing, marking: isMarking });
    if (!editing) panel.render(marking, isMarking && !this.tracing.on && !marking.locked);
    assist.offerLayout(marking.state?.source === "layout");
    // A template is saved only with Done, so the status must not say "Saved" before.
    if (editing && templates.doc.started) this.status.show("draft", "");
    else if (this.status.state === "draft") this.saver.report();
    this.#showHint();
    this.#describe();
    this.viewer.redraw();
  }

  /** Show where the next point belongs, as a small drawing of the template, and what to do, as a line of text. */
  #showHint() {
    const { drawing, editing, marking, opening, template } = this;
    const [hint, prompt] = [this.#hint, this.#prompt];
    hint.hidden = editing || drawing || !marking.placing || !template?.points || opening.isCovered;
    if (!hint.hidden) drawHint(hint, template.points, template.contours, marking.active, getComputedStyle(hint));
    const text = this.#promptText();
    prompt.hidden = !text;
    this.#finder.hidden = drawing !== this.ruler || editing || Boolean(this.ruler.ends[0]);
    prompt.dataset.kind = marking.suggested && !editing && !drawing ? "suggested" : "";
    if (prompt.textContent !== text) prompt.textContent = text;
  }

  /** What the user may do next; empty if nothing. */
  #promptText() {
    const { drawing, editing, marking, opening, templates } = this;
    if (opening.isCovered) return "";
    if (editing) return templates.prompt;
    if (!marking.book) return "";
    if (marking.locked) return "This folder can only be read: copy it to place landmarks";
    return drawing?.prompt ?? (promptOf(marking) || outsideText(marking, this.viewer));
  }

  /** Describe the picture to screen readers. */
  #describe() {
    this.#alternative.textContent = this.#descriptionText();
    const { name } = this;
    this.viewer.canvas.setAttribute("aria-label", name ? `${name} with landmarks` : "Picture with landmarks");
  }

  #descriptionText() {
    const { editing, marking, name, templates } = this;
    if (editing) return `Editing the template: ${several(templates.doc.names.length, "point")}.`;
    return marking.book ? descriptionOf(name, marking) : "No picture is open.";
  }

  /** Announce where a point is, and which one comes next, if any. */
  sayPlace(index, next = -1) { this.say(placeOf(this.marking, index, next)); }

  /** Announce moved points after a pause, so that a burst of keys does not flood a screen reader. */
  saySoon(indices) {
    clearTimeout(this.#waiting);
    this.#waiting = setTimeout(() => {
      if (this.doc !== this.marking) return;
      if (indices.length === 1) this.sayPlace(indices[0]);
      else this.say(`${indices.length || "All"} points moved`);
    }, SAY_AFTER);
  }

  /** Layer of the viewer: what is edited, and the gesture in progress. */
  #draw(ctx) {
    const { viewer, tool, marking } = this;
    if (!viewer.width || marking.hidden) return;
    if (this.editing) this.templates.draw(ctx, tool);
    else if (marking.book) {
      if (this.tracing.on) this.tracing.draw(ctx, viewer);
      drawMarking(ctx, viewer, this.doc === marking ? tool : BUSY, marking, this.shown.drawn, this.wrong);
      this.measured.draw(ctx);
      this.ruler.draw(ctx, viewer);
    }
    drawGesture(ctx, viewer, tool, marking.suggested);
  }

  /** Hooks for browser tests: positions of points in the picture and on the page. */
  #expose() {
    const annotate = {
      viewer: this.viewer,
      /** Points as shown: of the picture, or of the template that is being edited. */
      points: () => this.points.map((point) => point && point.slice()),
      /** Position of a point, or of any [x, y] of the picture, on the page: [clientX, clientY] or null. */
      toClient: (what) => {
        const point = Array.isArray(what) ? what : this.doc.points[what];
        return point ? this.viewer.toClient(point) : null;
      },
      /** "file", "proposal", "layout", "none", or "template" while it is edited; null while a picture opens. */
      source: () => (this.editing ? "template" : (this.marking.state?.source ?? null)),
      name: () => this.name,
      wrong: () => this.wrong,
      selection: () => [...this.doc.selection],
      invisible: () => [...this.marking.invisible],
      bar: () => this.ruler.bar,
      /** Which points have an ellipse. */
      ellipses: () => this.marking.uncertain.map((point, i) => Boolean(point && this.marking.book.covariances?.[i])),
      undoSteps: () => this.doc.history?.steps ?? 0,
      isDirty: () => this.saver.dirty.length > 0,
      /** The loupe: {xy under its centre, centre on the screen, scale}, or null. */
      loupe: () => this.tool.loupe && { xy: this.tool.loupe, ...loupeOver(this.viewer, this.tool.pointer) },
    };
    Object.assign(window.liaamStudio, { annotate });
  }
}
