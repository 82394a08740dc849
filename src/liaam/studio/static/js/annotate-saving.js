// Saving marks on the server, and resolving conflicts with changes made elsewhere.

import { contentOf, Saver } from "./saving.js";
import { Page, Unsaved } from "./unsaved.js";

const KEEPALIVE = 60_000; // largest body in bytes that a browser still sends after the page is closed

const CHANGED = {
  title: "Changed elsewhere", theirs: "Use the other version", mine: "Keep my version",
  text: "were changed in another tab or by another program since this tab read them.", what: "landmarks",
};
const DELETED = {
  title: "The landmark file was deleted", theirs: "Leave it deleted", mine: "Save it again",
  text: "was deleted, renamed or moved since this tab read it.", what: "landmark file",
};

/** @param {import("./annotate.js").Tab} tab */
export function createSaving(tab) {
  const { api, state, toast, ui } = tab.app;
  const page = new Page();
  let deciding = false;
  const fetchMarks = (name) => api.get(api.url("pictures/{name}/landmarks", { name }));
  const tryToFetch = (name) => fetchMarks(name).catch(() => null);

  /** @param {string} name; @param {SaveMarks} body */
  const put = (name, body) => state.saveMarks(name, body, { keepalive: JSON.stringify(body).length < KEEPALIVE });

  const saver = new Saver({
    put, unsaved: new Unsaved(localStorage, state.project.id, page.name),
    template: () => tab.template && { names: tab.template.names, revision: tab.template.revision },
    onStatus: (what, message) => tab.status.show(what, message), onConflict: decide, onTemplate: templateMoved,
    onForeign: (name) => tab.opening.foreign(name), onLost: (_name, sentence) => toast(sentence, "bad"),
    onSaved: (name, /** @type {Saved} */ { picture }) => {
      tab.opening.forget(name);
      if (picture) state.update(picture);
    },
  });

  async function markUnchecked(name) {
    const { revision, points } = await fetchMarks(name);
    /** @type {SaveMarks} */
    const body = { points: points.map(() => null), invisible: [], revision, unchecked: true };
    state.update((await put(name, body)).picture);
  }

  function change(name, marks) {
    saver.change(name, contentOf(marks));
    if (saver.isInConflict(name)) decide(name);
  }

  async function decide(name) {
    if (deciding || name === null) return;
    deciding = true;
    const isDeleted = saver.isDeleted(name);
    const { title, what, text, theirs, mine } = isDeleted ? DELETED : CHANGED;
    const choice = await ui.dialog(title, `The ${what} of ${name} ${text}`, [
      { label: theirs, value: "theirs", testid: "conflict-theirs" },
      { label: mine, kind: "primary", value: "mine", testid: "conflict-mine" },
    ], { undecided: !isDeleted }); // it opens by itself: an Enter for the next picture must not decide
    deciding = false;
    if (choice === null) return; // undecided: the status line shows a button to decide
    await saver.resolveConflict(name, choice);
    if (choice === "theirs") tab.opening.foreign(name, true);
  }

  /** The server refused marks of an earlier template: fetch the new one and convert them. */
  async function templateMoved(name) {
    const before = tab.template?.revision;
    await state.refresh().catch(() => {}); // if the server is unreachable, `online` retries
    // If the template has changed, the listener has already converted all unsaved marks.
    if (tab.template && tab.template.revision === before) await rebase([name]);
  }

  async function rebase(names = saver.dirty, mapping = null) {
    for (const name of names) {
      await saver.answered(name); // it has marks of the earlier template, too
      const marks = await tryToFetch(name);
      if (marks) saver.rebase(name, marks, mapping);
    }
  }

  /** Marks that an earlier page could not save; this page saves them from now on. Null if there are none. */
  async function inherited(name, marks) {
    if (saver.isStale(name)) {
      await saver.answered(name);
      saver.rebase(name, marks);
    }
    if (saver.isDirty(name)) return null;
    const kept = saver.kept(name);
    const ours = kept === null || (await page.inherits(kept.page));
    if (saver.isDirty(name)) return null;
    if (ours) return saver.restore(name, marks);
    saver.known(name, marks.revision, contentOf(marks), marks, marks.beside); // another tab is saving them
    return null;
  }

  async function sendKept() {
    for (const name of saver.keptNames) {
      if (!state.picture(name) || !tab.template || saver.isDirty(name)) continue;
      const isOpen = name === tab.name; // then loading its marks restores those that were not saved
      const marks = isOpen ? null : await tryToFetch(name);
      if (marks) await inherited(name, marks);
      if (isOpen && tab.opening.isPristine()) await tab.opening.reload();
    }
  }

  return { saver, fetchMarks, tryToFetch, markUnchecked, change, decide, rebase, inherited, sendKept };
}
