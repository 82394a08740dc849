// The template in the Annotate tab: creating, editing and saving it, and following changes made elsewhere.

import { expected, indicesOf, layoutIn, placed } from "./points.js";
import { TemplateEditor } from "./template-editor.js";

const sentence = (text) => (/[.!?]$/.test(text) ? text : `${text}.`);

export class TemplateSession {
  constructor(tab) {
    Object.assign(this, { tab, state: tab.state, marking: tab.marking });
    this.editing = false;
    this.saving = false;
    this.key = JSON.stringify(tab.template);
    this.editor = new TemplateEditor({
      app: tab.app, viewer: tab.viewer, onchange: () => tab.refresh(), say: (text) => tab.speaker.say(text),
      onsave: (work) => this.save(work), oncancel: () => this.cancel(),
    });
  }

  // Starting and ending ---------------------------------------------------------------------------------------------

  /** There is no template yet: create one on the open picture. */
  begin() {
    const running = this.editing && this.editor.started;
    this.editing = true;
    if (!running) this.editor.start(null, null); // a draft is kept when the picture changes
    this.tab.refresh();
  }

  edit() {
    const { tab, marking } = this;
    if (!marking.book) return;
    const { points, template } = marking;
    const { width, height } = tab.viewer;
    const layout = template.points ?? points;
    const known = placed(points).length ? expected(layout, points) : layoutIn(template.points, width, height);
    tab.saving.saver.flush();
    tab.tool.cancel();
    this.editing = true;
    this.editor.start(
      template,
      points.map((point, i) => point ?? known?.[i] ?? null),
    );
    tab.refresh();
  }

  leave() {
    const { tab } = this;
    this.editing = false;
    this.marking.select([]);
    tab.refresh();
    tab.viewer.canvas.focus({ preventScroll: true });
  }

  cancel() {
    this.leave();
    if (!this.marking.book && this.tab.visible) this.tab.opening.open(this.tab.name);
  }

  // Saving ----------------------------------------------------------------------------------------------------------

  async save({ template, mapping, points, isFresh }) {
    const { tab, state, marking } = this;
    const { api } = tab.app;
    const isNew = !tab.template;
    // Editing the template places new points on this picture, but not those that were missing.
    await tab.saving.saver.flush();
    const before = marking.state ?? (isNew ? null : await tab.saving.fetchMarks(tab.name));
    const hadFile = before?.source === "file";
    this.saving = true;
    try {
      const change = mapping ? { ...template, mapping } : template;
      const saved = await state.send((folder) => api.put(api.url("template"), { ...change, folder }));
      await tab.saving.keepUnsaved(saved, mapping);
      this.key = JSON.stringify(saved);
      tab.opening.clear();
      await state.refresh();
      this.key = JSON.stringify(tab.template);
      const marks = await tab.saving.fetchMarks(tab.name);
      this.leave();
      await tab.opening.take(tab.name, marks);
      if (isFresh && marks.source !== "file") marking.change({ points }, "template", null, true);
      else if (hadFile) this.commitEdited(points, mapping ?? indicesOf(points), before);
      await tab.saving.saver.flush(tab.name);
    } catch (error) {
      if (error.status !== 409 || !error.body?.template) throw error;
      // Keep the changes in the editor, on top of the current template.
      this.saving = false;
      this.key = ""; // follow the template of the server in any case
      await state.refresh();
      throw new Error(`${sentence(error.message)} Your changes are still here: check them, then press Done again.`);
    } finally {
      this.saving = false;
    }
    tab.app.toast(isNew ? "Template and points of this picture saved." : "Template saved.", "good");
  }

  commitEdited(points, mapping, before) {
    const next = points.map((point, i) => (mapping[i] !== null && !before.points[mapping[i]] ? null : point));
    this.marking.commit(next, "edit the template");
  }

  // Changes made elsewhere ------------------------------------------------------------------------------------------

  /** Follow a template that was changed elsewhere; return whether it was. */
  noticed() {
    const { tab } = this;
    const key = JSON.stringify(tab.template);
    if (key === this.key) return false;
    const before = this.key !== "null";
    this.key = key;
    tab.opening.clear();
    if (!tab.template || this.saving) return false;
    this.changed(before);
    return true;
  }

  async changed(before) {
    const { tab } = this;
    const drafting = this.editing && this.editor.hasChanges;
    this.marking.open(null);
    if (drafting) {
      this.editor.rebase(tab.template);
      tab.app.toast("The template was changed elsewhere. Your changes are still here: check them, then press Done.");
    } else if (before) {
      tab.app.toast("The template was changed elsewhere. The new version is shown.");
    }
    await tab.saving.rebase();
    if (drafting) return;
    this.leave();
    if (tab.visible) await tab.opening.open(tab.name);
  }

  /** Whether another picture may be opened. A change of the template must be finished first, on its own picture. */
  mayLeave(before) {
    if (!this.editing) return true;
    if (this.editor.isChanging && this.state.picture(before)) {
      this.tab.app.toast("Finish the template first: press Done or Cancel on the right.");
      this.state.select(before);
      return false;
    }
    if (this.tab.template) this.leave();
    return true;
  }
}
