// The editor of the template over one picture: its parts put together, files that it begins with, and saving it.

import { Drafting } from "./drafting.js";
import { KeptDraft } from "./kept-draft.js";
import { bounds, fitInto, rounded } from "./points.js";
import { drawDrafting } from "./template-drawing.js";
import { TemplatePanel } from "./template-panel.js";
import * as drafts from "./template.js";

export class TemplateEditor {
  /**
   * @param {object} parts
   *  app, viewer; onchange(): something changed, draw again; say(text): to screen readers;
   *  onsave({template, mapping, points, isFresh}): save; oncancel(): leave without.
   */
  constructor({ app, viewer, onchange, say, onsave, oncancel }) {
    Object.assign(this, { app, viewer, onchange, onsave, oncancel });
    this.kept = new KeptDraft(app.state.project.id ?? app.state.project.folder);
    this.doc = new Drafting({
      viewer,
      onchange: () => this.changed(),
      onselect: () => this.parts.points.mark(),
      say,
    });
    this.parts = new TemplatePanel({
      ui: app.ui,
      drafting: this.doc,
      onload: (file) => this.load(file),
      ondone: () => this.done(),
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
  /** Whether something was made here that is not saved. */
  get hasChanges() {
    return this.doc.saved === null ? this.started : this.history.canUndo;
  }

  /** What to do next, in a sentence. */
  get prompt() {
    if (this.doc.layingOut) return "Put the points in place: drag the frame's handles, then single points";
    if (!this.started) return "Click the first point of your template on this picture";
    return this.draft.path < 0
      ? "Click where the next path begins"
      : "Click the next point of this path – C closes it, N begins another";
  }

  changed() {
    if (this.doc.saved === null) this.kept.set(this.draft);
    this.parts.render();
    this.onchange();
  }

  draw(ctx, tool) {
    drawDrafting(ctx, this.viewer, tool, this.doc);
  }

  // Beginning -------------------------------------------------------------------------------------------------------

  /** Edit `template` (null: make a new one, or go on with one) with its points at `points` on the picture. */
  start(template, points) {
    if (template) this.kept.set(null); // a template that came from elsewhere makes a draft void
    this.parts.showMirror(false);
    this.doc.start(template, points, template ? null : (this.kept.get() ?? drafts.EMPTY));
    this.changed();
  }

  /** The template is another now: what was made becomes a change of that one. */
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
      if (box === null) throw new Error(`${file.name} has no points; choose another file.`);
      const lies = box[0] >= -1 && box[1] >= -1 && box[2] <= width && box[3] <= height;
      const large = Math.max((box[2] - box[0]) / width, (box[3] - box[1]) / height) > 0.2;
      // Often the file is this very picture's; points that fit are left where they are.
      const points = lies && large ? template.points : fitInto(template.points, width, height);
      this.doc.load(
        file.name,
        template,
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
    // As it is now: while the person is asked, the template may be changed elsewhere.
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

  /** Whether the person wants landmark files to be rewritten. */
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
    const sure = () => this.app.confirm("Start over?", "All points of the new template go away.", "Start over");
    if (this.started && !(await sure())) return;
    this.kept.set(null);
    this.start(null, null);
  }

  // Keys ------------------------------------------------------------------------------------------------------------

  /** Act on a key; gives whether it meant something. */
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
