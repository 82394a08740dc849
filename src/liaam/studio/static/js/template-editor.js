// The editor of the template over a picture: connects its parts, loads files, and saves the template.

import { Drafting } from "./drafting.js";
import { KeptDraft } from "./kept-draft.js";
import { bounds, fitInto, rounded } from "./points.js";
import { drawDrafting } from "./template-drawing.js";
import { TemplatePanel } from "./template-panel.js";
import * as drafts from "./template.js";

export class TemplateEditor {
  /**
   * @param {object} parts
   *  app, viewer; onchange(): something changed, draw again; say(text): announce to screen readers;
   *  onsave({template, mapping, points, isFresh}): save; oncancel(): leave without saving.
   */
  constructor({ app, viewer, onchange, say, onsave, oncancel }) {
    Object.assign(this, { app, viewer, onchange, onsave, oncancel });
    this.kept = new KeptDraft(app.state.project.id ?? app.state.project.folder);
    this.doc = new Drafting({ viewer, onchange: () => this.changed(), onselect: () => this.parts.points.mark(), say });
    this.parts = new TemplatePanel({
      ui: app.ui, drafting: this.doc, onload: (file) => this.load(file), ondone: () => this.done(),
      onleave: () => this.leave(),
    });
  }

  get panel() {
    return this.parts.element;
  }
  get draft() {
    return this.doc.draft;
  }
  get history() {
    return this.doc.history;
  }
  get started() {
    return this.draft.names.length > 0;
  }
  /** Whether changes of the saved template would be lost. */
  get isChanging() {
    return this.doc.saved !== null && this.history.canUndo;
  }
  /** Whether there are unsaved changes. */
  get hasChanges() {
    return this.doc.saved === null ? this.started : this.history.canUndo;
  }

  get prompt() {
    if (this.doc.layingOut) return "Move the points into place: drag the frame's handles, then single points";
    if (!this.started) return "Click the first point of your template on this picture";
    return this.draft.path < 0
      ? "Click the first point of the next path"
      : "Click the next point of this path – C closes it, N starts another";
  }

  changed() {
    if (this.doc.saved === null) this.kept.set(this.draft);
    this.parts.render();
    this.onchange();
  }

  draw(ctx, tool) {
    drawDrafting(ctx, this.viewer, tool, this.doc);
  }

  // Starting --------------------------------------------------------------------------------------------------------

  /** Edit `template` with its points at `points` on the picture, or, if it is null, a new or stored draft. */
  start(template, points) {
    if (template) this.kept.set(null); // a saved template invalidates the draft of a new one
    this.parts.showMirror(false);
    this.doc.start(template, points, template ? null : (this.kept.get() ?? drafts.EMPTY));
    this.changed();
  }

  /** The saved template has changed: turn the draft into a change of the new one. */
  rebase(template) {
    this.kept.set(null);
    this.doc.rebase(template);
  }

  async load(file) {
    const { api } = this.app;
    const { width, height } = this.viewer;
    try {
      const address = `${api.url("template/file")}?name=${encodeURIComponent(file.name)}`;
      const template = await api.upload(address, file);
      const box = bounds(template.points ?? []);
      if (box === null) throw new Error(`${file.name} has no points: choose another file.`);
      const lies = box[0] >= -1 && box[1] >= -1 && box[2] <= width && box[3] <= height;
      const large = Math.max((box[2] - box[0]) / width, (box[3] - box[1]) / height) > 0.2;
      // The file often belongs to this picture, so points that fit are left unchanged.
      const points = lies && large ? template.points : fitInto(template.points, width, height);
      this.doc.load(
        file.name, template,
        points.map((p) => p && rounded(p)),
      );
    } catch (error) {
      this.app.toast(error, "bad");
    } finally {
      this.parts.file.value = ""; // so that the same file can be chosen again
    }
  }

  // Ending ----------------------------------------------------------------------------------------------------------

  async done() {
    const { draft, doc, parts } = this;
    const { saved, isFresh } = doc;
    const wrong = drafts.fault(draft);
    if (wrong) {
      parts.message.textContent = wrong;
      return;
    }
    const mapping = saved && drafts.rearranges(draft, saved.names.length) ? draft.origins : null;
    // Taken now, because the template may be changed elsewhere while the dialog is open.
    const revision = saved ? saved.revision : null;
    const work = { template: { ...drafts.templateOf(draft), revision }, mapping, points: draft.points, isFresh };
    if (mapping && !(await this.agreed())) return;
    parts.setBusy(true);
    try {
      await this.onsave(work);
      this.kept.set(null);
    } catch (error) {
      parts.message.textContent = error.message;
      this.app.toast(error, "bad");
    } finally {
      parts.setBusy(false);
    }
  }

  /** Ask whether landmark files may be rewritten. */
  async agreed() {
    const files = this.app.state.project.pictures.filter(
      (picture) => picture.placed > 0 && picture.state !== "proposed",
    ).length;
    if (files === 0) return true;
    const what = drafts.changes(this.draft, this.doc.saved.names.length).join("; ");
    const text = `The landmark files of ${files} ${files === 1 ? "picture" : "pictures"} will be rewritten: ${what}. This cannot be undone.`;
    return this.app.confirm("Change the template?", text, files === 1 ? "Rewrite 1 file" : `Rewrite ${files} files`);
  }

  async leave() {
    if (this.doc.saved) {
      this.oncancel();
      return;
    }
    const sure = () => this.app.confirm("Start over?", "All points of the new template will be deleted.", "Start over");
    if (this.started && !(await sure())) return;
    this.kept.set(null);
    this.start(null, null);
  }

  // Keys ------------------------------------------------------------------------------------------------------------

  /** Handle a key; return whether it was handled. */
  key(event) {
    const { doc } = this;
    if (event.ctrlKey || event.metaKey || event.altKey) return false;
    const letter = event.key.toLowerCase();
    if (letter === "n") doc.startPath();
    else if (letter === "c") doc.close();
    else if (letter === "x") this.parts.toggleMirror();
    else if (letter === "p") doc.addInTheMiddle();
    else if (event.key === "Delete" || event.key === "Backspace") doc.deleteChosen();
    else if (event.key === "Escape") {
      if (doc.selection.size) doc.select([]);
      else doc.startPath();
    } else return false;
    return true;
  }
}
