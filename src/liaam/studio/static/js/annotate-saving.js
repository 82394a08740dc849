// Saving marks on the server, and resolving conflicts with changes made elsewhere.

import { contentOf, Saver } from "./saving.js";
import { Page, Unsaved } from "./unsaved.js";

const KEEPALIVE = 60_000; // largest body in bytes that a browser still sends after the page is closed

/** Dialogs of conflicts with the file on the server. */
const CHANGED = {
  title: "Changed elsewhere",
  text: (name) =>
    `The landmarks of ${name} were changed in another tab or by another program since this tab read them.`,
  theirs: "Use the other version", mine: "Keep my version",
};
const DELETED = {
  title: "The landmark file was deleted",
  text: (name) =>
    `The landmark file of ${name} was deleted, renamed or moved since this tab read it.`,
  theirs: "Leave it deleted", mine: "Save it again",
};

export class MarksSaving {
  /** onstatus(state, message); onsaved(name): landmarks were saved; onforeign(name): they were changed elsewhere;
   *  ontheirs(name): the user discarded the changes of this page. */
  constructor({ app, onstatus, onsaved, onforeign, ontheirs }) {
    Object.assign(this, { app, state: app.state, ontheirs });
    this.deciding = false;
    this.page = new Page();
    const { project } = app.state;
    this.saver = new Saver({
      put: (name, body) => this.put(name, body),
      unsaved: new Unsaved(localStorage, project.id ?? project.folder, this.page.name),
      template: () => this.template && { names: this.template.names, revision: this.template.revision },
      onTemplate: (name) => this.templateMoved(name), onLost: (name, sentence) => app.toast(sentence, "bad"),
      onStatus: onstatus,
      onSaved: (name, { picture }) => {
        onsaved(name);
        if (picture) this.state.update(picture);
      },
      onConflict: (name) => this.decide(name), onForeign: onforeign,
    });
  }

  get template() {
    return this.state.project?.template ?? null;
  }

  put(name, body) {
    const { api } = this.app;
    const options = { keepalive: JSON.stringify(body).length < KEEPALIVE };
    const address = api.url("pictures", name, "landmarks");
    return this.state.send((folder) => api.put(address, { ...body, folder }, options));
  }

  /** Mark a picture whose mean shape was not moved. */
  async markUnchecked(name) {
    const { revision, points } = await this.fetchMarks(name);
    const body = { points: points.map(() => null), invisible: [], revision, unchecked: true };
    const { picture } = await this.put(name, body);
    this.state.update(picture);
  }

  fetchMarks(name) {
    return this.app.api.get(this.app.api.url("pictures", name, "landmarks"));
  }

  /** Fetch the marks of a picture; null if the request fails. */
  tryToFetch(name) {
    return this.fetchMarks(name).catch(() => null);
  }

  change(name, state) {
    this.saver.change(name, contentOf(state));
    if (this.saver.entry(name).state === "conflict") this.decide(name);
  }

  async decide(name) {
    if (this.deciding || name === null) return;
    this.deciding = true;
    const { title, text, theirs, mine } = this.saver.wasDeleted(name) ? DELETED : CHANGED;
    const choice = await this.app.ui.dialog(title, text(name), [
      { label: theirs, value: "theirs", testid: "conflict-theirs" },
      { label: mine, kind: "primary", value: "mine", testid: "conflict-mine" },
    ]);
    this.deciding = false;
    if (choice === null) return; // undecided: the status line shows a button to decide
    await this.saver.resolveConflict(name, choice);
    if (choice === "theirs") this.ontheirs(name);
  }

  /** The server refused marks of an earlier template: fetch the new one and convert them. */
  async templateMoved(name) {
    const before = this.template?.revision;
    await this.state.refresh().catch(() => {}); // if the server is unreachable, `online` retries
    // If the template has changed, the listener has already converted all unsaved marks.
    if (this.template && this.template.revision === before) await this.rebase([name]);
  }

  /** Convert unsaved marks to the current template. */
  async rebase(names = this.saver.dirty, mapping = null) {
    for (const name of names) {
      const marks = await this.tryToFetch(name);
      if (marks) this.saver.rebase(name, marks, mapping);
    }
  }

  /** The template has changed: convert unsaved marks to it. */
  async keepUnsaved(template, mapping) {
    this.state.project.template = template;
    if (template) await this.rebase(this.saver.dirty, mapping);
  }

  /** Marks that an earlier page could not save; this page saves them from now on. Null if there are none. */
  async inherited(name, marks) {
    if (this.saver.isDirty(name)) return null;
    const kept = this.saver.unsaved.get(name);
    const ours = kept === null || (await this.page.inherits(kept.page));
    if (this.saver.isDirty(name)) return null;
    if (ours) return this.saver.restore(name, marks);
    this.saver.known(name, marks.revision, contentOf(marks), marks); // another tab is saving them
    return null;
  }

  /** Save the marks that an earlier page could not save. reopen(name) -> Promise of whether the picture is open, in
   *  which case it has restored its marks itself. */
  async sendKept(reopen) {
    for (const name of this.saver.unsaved.names()) {
      if (!this.state.picture(name) || !this.template || this.saver.isDirty(name)) continue;
      if (await reopen(name)) continue;
      const marks = await this.tryToFetch(name);
      if (marks) await this.inherited(name, marks);
    }
  }
}
