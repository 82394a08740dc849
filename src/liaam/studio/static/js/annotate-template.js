// The template in the Annotate tab: creating, editing and saving it, and following changes made elsewhere.

import { CLICK, IS_TOUCH } from "./annotate-words.js";
import { drawDrafting } from "./drawing.js";
import { Drafting } from "./drafting.js";
import { expected, indicesOf, layoutIn, placed, rounded } from "./points.js";
import { createTemplatePanel } from "./template-panel.js";
import * as drafts from "./template.js";
import { runKey } from "./ui.js";
import { keptDraft } from "./unsaved.js";

const KEPT = "Your changes are still here: check them, then press Done";
const sentence = (text) => (/[.!?]$/.test(text) ? text : `${text}.`);

/** @param {import("./annotate.js").Tab} tab */
export function createTemplates(tab) {
  const { app, state, marking, viewer } = tab;
  const { api, toast, confirm } = app;
  const kept = keptDraft(state.project.id);
  const onselect = () => { panel.mark(); viewer.redraw(); };
  const doc = new Drafting({ viewer, onchange: changed, onselect, say: tab.say });
  const panel = createTemplatePanel({
    drafting: doc, formats: state.project.formats.landmarks, onload: load, onsliders: loadSliders, ondone: done, onleave: stop,
    isOffered: () => state.project.offered, isLooking,
  });
  let editing = false;
  let saving = false; // whether this page is changing the template
  let looked = false; // whether the page says that faces are looked for
  let known = JSON.stringify(tab.template); // the template that is shown

  /** Whether it may turn out that the face model knows the points: pictures arrive, or faces are looked for in them. */
  function isLooking() { return !tab.template && (state.adding !== null || state.project.looking); }

  /** Whether points of a new template were placed, but not saved. They stay, whatever points a model offers meanwhile. */
  const isDrafting = () => (!tab.template || state.project.offered) && Boolean(kept.get()?.names.length);

  function changed() {
    if (doc.saved === null) kept.set(doc.draft);
    panel.render();
    tab.refresh();
  }

  /** Edit `template` with its points at `points` on the picture, or, if it is null, a new or stored draft. */
  function start(template, points) {
    editing = true;
    looked = isLooking();
    if (template) kept.set(null); // a saved template invalidates the draft of a new one
    doc.start(template, points, template ? null : (kept.get() ?? drafts.EMPTY));
    changed();
  }

  /** There is no template yet, or points of a new one were placed: create it on the open picture. A draft is kept when the
   *  picture changes. */
  function begin() {
    if (!editing || !doc.started) start(null, null);
    else tab.refresh();
  }

  function edit() {
    if (!marking.book) return;
    const { points, template } = marking;
    const guess = placed(points).length ? expected(template.points ?? points, points)
      : layoutIn(template.points, viewer.width, viewer.height);
    tab.saver.flush();
    tab.tool.cancel();
    start(template, points.map((point, i) => point ?? guess?.[i] ?? null));
  }

  function leave() {
    editing = false;
    marking.select([]);
    tab.refresh();
    tab.focus();
  }

  /** Leave without saving, or delete the draft of a new template. */
  async function stop() {
    if (doc.saved) {
      leave();
      if (!marking.book && tab.visible) tab.opening.open(tab.name);
      return;
    }
    const text = "All points of the new template will be deleted.";
    const title = tab.template ? "Use the model's points?" : "Start over?";
    if (doc.started && !(await confirm(title, text, tab.template ? "Use the model's points" : "Start over"))) return;
    kept.set(null);
    if (!tab.template) return start(null, null);
    leave();
    return tab.opening.open(tab.name);
  }

  async function loadSliders(file) {
    if (doc.loadSliders(await file.text())) return;
    toast(`${file.name} is no sliders file for these points: choose a table of the numbers before, slide and after.`, "bad");
  }

  /** kinds: "landmark" if all points are. */
  async function load(file, kind = null) {
    const { width, height } = viewer;
    const template = await api.upload(api.url("template/file", { name: file.name }), file);
    const points = layoutIn(template.points, width, height, 1); // unchanged if the file belongs to this picture
    if (!points) return toast(`${file.name} has no points: choose another file.`, "bad");
    const kinds = kind ? template.names.map(() => kind) : template.kinds;
    return doc.load(file.name, template, points.map((p) => p && rounded(p)), kinds);
  }

  async function done() {
    const { draft, saved, isFresh, isUnmoved } = doc;
    const wrong = drafts.fault(draft);
    if (wrong) return panel.tell(wrong);
    const mapping = saved && drafts.rearranges(draft, saved.names.length) ? draft.origins : null;
    // Taken now, because the template may be changed elsewhere while the dialog is open.
    /** @type {SaveTemplate} */
    const template = drafts.templateOf(draft);
    template.revision = saved?.revision ?? null;
    const lost = saved && drafts.consequences(draft, saved.names, state.project);
    const text = `${lost} This cannot be undone.`;
    if (lost && !(await confirm("Change the template?", text, "Change the template"))) return;
    panel.setBusy(true);
    try {
      await save(template, mapping, draft.points, { isFresh, isUnmoved, isLoaded: Boolean(draft.loaded) });
      kept.set(null);
    } catch (error) {
      panel.tell(error.message);
      toast(error, "bad");
    } finally {
      panel.setBusy(false);
    }
  }

  /** isFresh: the points are those of this picture, too, unless they are where they were loaded (isUnmoved). Those that
   *  were loaded (isLoaded) and moved together were not placed one by one. */
  async function save(template, mapping, points, { isFresh, isUnmoved, isLoaded }) {
    const isNew = !tab.template;
    // Editing the template places new points on this picture, but not those that were missing.
    await tab.saver.flush();
    const before = marking.state ?? (isNew ? null : await tab.saving.fetchMarks(tab.name));
    saving = true;
    try {
      /** @type {SaveTemplate} */
      const change = { ...template };
      if (mapping) change.mapping = mapping;
      const saved = await state.send((folder) => api.put(api.url("template"), { ...change, folder }));
      state.takeTemplate(saved);
      await tab.saving.rebase(tab.saver.dirty, mapping);
      known = JSON.stringify(saved);
      tab.opening.clear();
      await state.refresh();
      known = JSON.stringify(tab.template);
      const marks = await tab.saving.fetchMarks(tab.name);
      leave();
      await tab.opening.take(tab.name, marks);
      if (isFresh && !isUnmoved && marks.source !== "file") {
        const origins = points.map((point) => point && (isLoaded ? "accepted" : "placed"));
        marking.change({ points, origins }, "template");
      } else if (before?.source === "file") {
        const origins = mapping ?? indicesOf(points);
        const isMissing = (i) => origins[i] !== null && !before.points[origins[i]];
        marking.commit(points.map((point, i) => (isMissing(i) ? null : point)), "edit the template");
      }
      await tab.saver.flush(tab.name);
    } catch (error) {
      const { status, body } = /** @type {import("./api.js").ApiError} */ (error);
      if (status !== 409 || !body?.template) throw error;
      // Keep the changes in the editor, on top of the current template.
      saving = false;
      known = ""; // follow the template of the server in any case
      await state.refresh();
      throw new Error(`${sentence(error.message)} ${KEPT} again.`);
    } finally {
      saving = false;
    }
    toast(isNew && !isUnmoved ? "Template and points of this picture saved." : "Template saved.", "good");
  }

  /** Follow a template that was changed elsewhere; return whether it was. */
  function noticed() {
    const now = JSON.stringify(tab.template);
    if (now === known) return false;
    const isFirst = known === "null";
    known = now;
    tab.opening.clear();
    if (saving) return false;
    if (!tab.template) {
      if (tab.visible && tab.name) tab.opening.open(tab.name);
      return true;
    }
    if (editing && isDrafting()) { // points of one's own are being defined
      panel.render();
      return true;
    }
    follow(isFirst);
    return true;
  }

  async function follow(isFirst) {
    const drafting = editing && (doc.saved === null ? doc.started : doc.history.canUndo);
    marking.open(null);
    if (drafting) {
      kept.set(null);
      doc.rebase(tab.template);
      toast(`The template was changed elsewhere. ${KEPT}.`);
    } else if (!isFirst) toast("The template was changed elsewhere. The new version is shown.");
    await tab.saving.rebase();
    if (drafting) return;
    leave();
    if (tab.visible) await tab.opening.open(tab.name);
  }

  /** Whether another picture may be opened. A change of the template must be finished first, on its own picture. */
  function mayLeave(before) {
    if (!editing) return true;
    if (isUnsaved() && state.picture(before)) {
      toast("Finish the template first: press Done or Cancel on the right.");
      state.select(before);
      return false;
    }
    if (tab.template && !isDrafting()) leave();
    return true;
  }

  // Changes of a saved template are stored nowhere before Done.
  const isUnsaved = () => editing && doc.saved !== null && doc.history.canUndo;
  addEventListener("beforeunload", (event) => { if (isUnsaved()) event.preventDefault(); });

  const keys = {
    n: () => doc.togglePath(), c: () => doc.close(), x: () => doc.toggleMirror(), p: () => doc.addInTheMiddle(),
    delete: () => doc.deleteChosen(), backspace: () => doc.deleteChosen(),
    escape: () => (doc.selection.size ? doc.select([]) : doc.endPath()),
  };

  return {
    doc, panel: panel.element, begin, edit, noticed, mayLeave,
    /** Faces may be looked for, or no longer. */
    look() {
      if (!editing || looked === isLooking()) return;
      looked = isLooking();
      panel.render();
      tab.refresh();
    },
    draw: (ctx, tool) => drawDrafting(ctx, viewer, tool, doc),
    get editing() { return editing; },
    get isDrafting() { return isDrafting(); },
    get prompt() {
      if (isLooking() && !doc.started) return "Looking for faces in these pictures…";
      if (doc.layingOut) return "Move the points into place: drag the frame's handles, then single points";
      if (doc.draft.path >= 0) return `${CLICK} the next point of this curve${IS_TOUCH ? "" : " – N ends it, C closes it"}`;
      return `${CLICK} the ${doc.started ? "next" : "first"} point${IS_TOUCH ? "" : " – N draws a curve"}`;
    },
    key: (event) => runKey(event, keys),
  };
}
