// The Annotate tab: place the points of one picture after another with the help of the model. This module connects its
// parts.

import { createAssist, several } from "./assist.js";
import { Commands } from "./annotate-commands.js";
import { drawGesture, drawMarking } from "./annotate-drawing.js";
import { Keys, SHORTCUTS } from "./annotate-keys.js";
import { Opening } from "./annotate-opening.js";
import { MarksSaving } from "./annotate-saving.js";
import { TemplateSession } from "./annotate-template.js";
import { createToolbar } from "./annotate-toolbar.js";
import { descriptionOf, placeOf, promptOf, Speaker, tallyOf } from "./annotate-words.js";
import { Cover } from "./cover.js";
import { drawHint } from "./drawing.js";
import { PointTool } from "./gestures.js";
import { Marking } from "./marking.js";
import { PictureStore } from "./picture-store.js";
import { nextMissing } from "./points.js";
import { PointsPanel } from "./points-panel.js";
import { SaveStatus } from "./save-status.js";
import { Viewer } from "./viewer.js";

export function mount(root, app) {
  const tab = new AnnotateTab(root, app);
  return {
    show: () => tab.appear(), hide: () => tab.disappear(), shortcuts: SHORTCUTS, key: (event) => tab.keys.down(event),
  };
}

class AnnotateTab {
  constructor(root, app) {
    this.app = app;
    this.state = app.state;
    this.name = null; // name of the open picture
    this.visible = false;
    this.show = { names: false, contours: true, ellipses: true };
    this.boxing = false; // whether dragging selects with a box
    this.makePage();
    this.makeParts();
    this.put(root);
    this.listen();
    this.expose();
  }

  // Parts -----------------------------------------------------------------------------------------------------------

  makePage() {
    const { h } = this.app.ui;
    this.container = h("div", { dataset: { testid: "annotate-viewer" } });
    this.prompt = h("div", { class: "annotate-prompt", hidden: true });
    this.hint = h("canvas", { class: "annotate-hint", hidden: true, "aria-hidden": "true" });
    this.cover = new Cover(this.app.ui);
    this.speaker = new Speaker(h("p", { class: "visually-hidden", role: "status", "aria-live": "polite" }));
    this.viewer = new Viewer(this.container, { label: "Picture with landmarks" });
    this.viewer.canvas.setAttribute("aria-describedby", "annotate-text");
    this.alternative = h("p", { class: "visually-hidden", id: "annotate-text" });
    this.container.append(this.prompt, this.hint, this.cover.element, this.alternative, this.speaker.element);
    this.side = h("aside", { class: "side annotate-side", "aria-label": "Points" });
  }

  makeParts() {
    const { app, state, viewer } = this;
    const { ui } = app;
    this.pictures = new PictureStore(app);
    this.marking = new Marking({
      template: () => this.template, onchange: () => this.changed(), onselect: () => this.chosen(),
      onpreview: () => viewer.redraw(), onplaced: (index) => this.goOn(index),
    });
    this.commands = new Commands(this);
    this.status = new SaveStatus({
      app, say: (text) => this.speaker.say(text), ondecide: () => this.saving.decide(this.saving.saver.conflicted),
    });
    this.toolbar = createToolbar({
      ui, state, commands: this.commands, status: this.status, act: (event, work) => this.act(event, work),
    });
    this.panel = new PointsPanel({
      ui, commands: this.commands, onstart: () => this.startChanged(), onedit: () => this.templates.edit(),
    });
    this.opening = new Opening(this, () => this.panel.start);
    this.saving = new MarksSaving({
      app, onstatus: (what, message) => this.status.show(what, message),
      onsaved: (name) => this.opening.first.forget(name), onforeign: (name) => this.foreign(name),
      ontheirs: (name) => this.foreign(name, true),
    });
    this.templates = new TemplateSession(this);
    this.keys = new Keys(this);
    this.assist = createAssist({
      app, accept: () => this.commands.accept(), skip: () => this.commands.skip(),
      confirm: () => this.commands.confirmLayout(),
    });
    this.tool = new PointTool(viewer, () => this.doc, { boxes: () => this.boxing, onend: () => this.refresh() });
    viewer.tool = this.tool;
    viewer.addLayer((ctx) => this.draw(ctx));
  }

  put(root) {
    const { h } = this.app.ui;
    root.classList.add("annotate");
    root.append(h("div", { class: "workspace" }, this.toolbar.element, this.container), this.side);
  }

  get template() {
    return this.state.project?.template ?? null;
  }

  /** Whether the template is edited instead of a picture's points. */
  get editing() {
    return this.templates.editing;
  }

  get editor() {
    return this.templates.editor;
  }

  /** The document that gestures edit: the template, or the marks of the picture. */
  get doc() {
    return this.editing ? this.editor.doc : this.marking;
  }

  /** Run the action of a button. After a click, return the focus to the picture, so that Enter works there. */
  act(event, work) {
    work();
    if (event.detail > 0) this.viewer.canvas.focus({ preventScroll: true });
  }

  // Events ----------------------------------------------------------------------------------------------------------

  listen() {
    const { state } = this;
    state.addEventListener("select", ({ detail }) => this.selected(detail));
    state.addEventListener("project", () => this.templates.noticed() || this.opening.refresh());
    state.addEventListener("landmarks", ({ detail }) => this.saving.saver.heard(detail.name, detail.revision));
    state.addEventListener("online", ({ detail }) => detail && this.online());
    this.viewer.addEventListener("view", () => this.opening.sharpen());
    document.addEventListener("visibilitychange", () => {
      if (document.visibilityState === "hidden") this.saving.saver.flush();
    });
    addEventListener("pagehide", () => this.saving.saver.flush());
    // A gesture in progress is not saved when the page is closed.
    document.addEventListener("keyup", (event) => {
      if (event.key.toLowerCase() === "h") this.commands.hideMarks(false);
    });
    addEventListener("blur", () => this.commands.hideMarks(false));
    setTimeout(() => this.saving.sendKept((name) => this.reopen(name)), 500);
  }

  appear() {
    this.visible = true;
    if (this.name !== this.state.current || !this.marking.book) this.opening.open(this.state.current);
    this.refresh();
    this.viewer.canvas.focus({ preventScroll: true });
  }

  disappear() {
    this.visible = false;
    this.tool.cancel();
    this.saving.saver.flush();
  }

  online() {
    this.saving.saver.retry();
    if (!this.marking.book && this.visible && !this.editing) this.opening.open(this.state.current);
  }

  selected({ name, before }) {
    if (name === this.name && this.editing) return; // the selection was reverted by mayLeave below
    if (!this.templates.mayLeave(before)) return;
    if (this.visible) this.opening.open(name);
    else this.saving.saver.flush();
  }

  leavePicture(name) {
    this.saving.saver.flush(name).then(() => this.assist.left());
  }

  /** The marks have changed: save and show them. */
  changed() {
    this.saving.change(this.name, this.marking.state);
    this.refresh();
  }

  /** The selection has changed. */
  chosen() {
    this.commands.escaped = false;
    this.panel.mark(this.marking);
    this.showHint();
    this.viewer.redraw();
  }

  /** After a point was placed, select the next missing one. */
  goOn(index) {
    const next = nextMissing(this.marking.points, index);
    this.marking.select([next < 0 ? index : next]);
    this.sayPlace(index, next);
  }

  /** A picture's landmarks were changed elsewhere, or the changes of this page were discarded. */
  foreign(name, discarded = false) {
    this.opening.first.forget(name);
    if (discarded || name !== this.name) this.opening.books.delete(name);
    if (name === this.name) this.opening.reload();
  }

  /** Whether a picture is open; if so, reload it, which restores its unsaved marks. */
  async reopen(name) {
    if (name !== this.name) return false;
    if (this.opening.pristine) await this.opening.reload();
    return true;
  }

  startChanged() {
    const { state } = this.marking;
    if (this.opening.pristine && state.source !== "file" && state.source !== "proposal") this.opening.reload();
  }

  // Display ---------------------------------------------------------------------------------------------------------

  refresh() {
    if (!this.assist) return; // the parts are not complete yet
    const { editing, editor, marking, toolbar } = this;
    const panel = editing ? [editor.panel] : [this.assist.element, ...this.panel.elements];
    if (this.side.firstChild !== panel[0]) this.side.replaceChildren(...panel);
    const isMarking = !editing && marking.book !== null;
    toolbar.refresh({ history: editing ? editor.history : marking.history, editing, marking: isMarking });
    this.panel.editButton.disabled = !isMarking;
    if (!editing) this.panel.render(marking);
    this.assist.sure.hidden = marking.state?.source !== "layout";
    this.panel.tally.textContent = marking.book ? tallyOf(marking) : "";
    this.showDraft();
    this.showPrompt();
    this.showHint();
    this.describe();
    this.viewer.redraw();
  }

  /** A template is saved only with Done, so the status must not say "Saved" before. */
  showDraft() {
    if (this.editing && this.editor.started) this.status.show("draft", "");
    else if (this.status.state === "draft") this.saving.saver.report();
  }

  showPrompt() {
    const { editing, marking } = this;
    const own = () => (marking.book ? promptOf(marking) : "");
    const text = this.cover.isShown ? "" : editing ? this.editor.prompt : own();
    this.prompt.hidden = !text;
    this.prompt.dataset.kind = marking.suggested && !editing ? "suggested" : "";
    if (this.prompt.textContent !== text) this.prompt.textContent = text;
  }

  showHint() {
    const { editing, marking, template } = this;
    const on = !editing && marking.placing && Boolean(template?.points) && !this.cover.isShown;
    this.hint.hidden = !on;
    if (on) drawHint(this.hint, template.points, template.contours, marking.active, getComputedStyle(this.hint));
    if (!editing && marking.book) this.showPrompt();
  }

  /** Describe the picture for screen readers. */
  describe() {
    const { marking, name } = this;
    const own = marking.book ? descriptionOf(name, marking) : "No picture is open.";
    this.alternative.textContent = this.editing
      ? `Editing the template: ${several(this.editor.draft.names.length, "point")}.`
      : own;
    this.viewer.canvas.setAttribute("aria-label", name ? `${name} with landmarks` : "Picture with landmarks");
  }

  sayPlace(index, next = -1) {
    this.speaker.say(placeOf(this.marking, index, next));
  }

  saySoon(indices) {
    this.speaker.soon(() => {
      if (this.editing) return null;
      return indices.length === 1 ? placeOf(this.marking, indices[0]) : `${indices.length || "All"} points moved`;
    });
  }

  draw(ctx) {
    const { viewer, tool, marking } = this;
    if (!viewer.width || marking.hidden) return;
    if (this.editing) this.editor.draw(ctx, tool);
    else if (marking.book) drawMarking(ctx, viewer, tool, marking, this.show);
    drawGesture(ctx, viewer, tool, marking.suggested);
  }

  /** Hooks for browser tests: positions of points in the picture and on the page. */
  expose() {
    const tab = this;
    window.liaamStudio = Object.assign(window.liaamStudio ?? {}, {
      annotate: {
        viewer: this.viewer,
        /** Points as shown: of the picture, or of the template that is being edited. */
        points: () => tab.doc.points.map((point) => point && point.slice()),
        /** Position of a point, or of any [x, y] of the picture, on the page: [clientX, clientY] or null. */
        toClient: (what) => {
          const point = Array.isArray(what) ? what : tab.doc.points[what];
          return point ? tab.viewer.toClient(point) : null;
        },
        /** "file", "proposal", "layout", "none", or "template" while it is edited; null while a picture opens. */
        source: () => (tab.editing ? "template" : (tab.marking.state?.source ?? null)), name: () => tab.name,
        selection: () => [...tab.doc.selection], invisible: () => [...tab.marking.invisible],
        undoSteps: () => (tab.editing ? tab.editor.history : tab.marking.history)?.past.length ?? 0,
        isDirty: () => tab.saving.saver.anyDirty,
        /** The position under the loupe of a gesture, or null. */
        loupe: () => tab.tool.gesture?.loupe ?? null,
      },
    });
  }
}
