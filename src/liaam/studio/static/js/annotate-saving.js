// Saving marks on the server, and what is asked where somebody else has saved others meanwhile.

import { contentOf, Page, Saver, Unsaved } from "./saving.js";

const KEEPALIVE = 60_000; // octets that a browser lets outlive a page

/** What is asked where the file is not what this tab read. */
const CHANGED = {
  title: "Changed elsewhere",
  text: (name) =>
    `The landmarks of ${name} were changed in another tab, or by another program, since this tab read them.`,
  theirs: "Take theirs",
  mine: "Keep mine",
};
const DELETED = {
  title: "The landmark file was deleted",
  text: (name) =>
    `The landmark file of ${name} has gone since this tab read it: somebody deleted, renamed or moved it.`,
  theirs: "Leave it deleted",
  mine: "Write it again",
};

export class MarksSaving {
  /** onstatus(state, message); onsaved(name): its landmarks are others; onforeign(name): somebody else has changed
   *  them; ontheirs(name): the person gave up what was done here. */
  constructor({ app, onstatus, onsaved, onforeign, ontheirs }) {
    Object.assign(this, { app, state: app.state, ontheirs });
    this.deciding = false;
    this.page = new Page();
    const { project } = app.state;
    this.saver = new Saver({
      put: (name, body) => this.put(name, body),
      unsaved: new Unsaved(localStorage, project.id ?? project.folder, this.page.name),
      template: () => this.template && { names: this.template.names, revision: this.template.revision },
      onTemplate: (name) => this.templateMoved(name),
      onLost: (name, sentence) => app.toast(sentence, "bad"),
      onStatus: onstatus,
      onSaved: (name, { picture }) => {
        onsaved(name);
        if (picture) this.state.update(picture);
      },
      onConflict: (name) => this.decide(name),
      onForeign: onforeign,
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

  fetchMarks(name) {
    return this.app.api.get(this.app.api.url("pictures", name, "landmarks"));
  }

  /** What the server has of a picture, or null where it cannot be asked. */
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
    if (choice === null) return; // undecided: said in the status line, with a button to decide
    await this.saver.settle(name, choice);
    if (choice === "theirs") this.ontheirs(name);
  }

  /** The server refused marks because they are of a template that is no more: learn the new one, carry them over. */
  async templateMoved(name) {
    const before = this.template?.revision;
    await this.state.refresh().catch(() => {}); // unreachable: `online` tries again
    // Another template came with it: who heard of that has seen to all that is unsaved.
    if (this.template && this.template.revision === before) await this.rebase([name]);
  }

  /** Carry what is not saved yet over to the present template. */
  async rebase(names = this.saver.dirty, mapping = null) {
    for (const name of names) {
      const marks = await this.tryToFetch(name);
      if (marks) this.saver.rebase(name, marks, mapping);
    }
  }

  /** The template is another from now on: what could not be saved before goes along. */
  async keepUnsaved(template, mapping) {
    this.state.project.template = template;
    if (template) await this.rebase(this.saver.dirty, mapping);
  }

  /** What an earlier page could not save of this picture, being saved from now on; null where there is nothing. */
  async inherited(name, marks) {
    if (this.saver.isDirty(name)) return null;
    const kept = this.saver.unsaved.get(name);
    const ours = kept === null || (await this.page.inherits(kept.page));
    if (this.saver.isDirty(name)) return null;
    if (ours) return this.saver.restore(name, marks);
    this.saver.known(name, marks.revision, contentOf(marks), marks); // another tab is at it
    return null;
  }

  /** Pictures that an earlier page could not save are saved now, whether they are opened or not; reopen(name) ->
   *  Promise of whether the picture is open, which has taken it up then. */
  async sendKept(reopen) {
    for (const name of this.saver.unsaved.names()) {
      if (!this.state.picture(name) || !this.template || this.saver.isDirty(name)) continue;
      if (await reopen(name)) continue;
      const marks = await this.tryToFetch(name);
      if (marks) await this.inherited(name, marks);
    }
  }
}
