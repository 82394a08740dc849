// Opening pictures in the Annotate tab: fetches them with their marks from the server or from an earlier page.

import { FirstMarks } from "./first-marks.js";
import { invitation } from "./fit-only.js";
import { History } from "./history.js";
import { nextMissing, sameMarks } from "./points.js";

export class Opening {
  /** tab: the Annotate tab; begins() -> the start of pictures without points, "layout" or "click". */
  constructor(tab, begins) {
    Object.assign(this, { tab, state: tab.state, marking: tab.marking, begins });
    this.first = new FirstMarks({ state: tab.state, fetchMarks: (name) => tab.saving.fetchMarks(name), begins });
    this.books = new Map(); // name -> book of a picture that was opened on this page
    this.turn = 0; // incremented with each picture, to drop late answers
  }

  /** The landmarks of a picture have changed. */
  forget(name) {
    this.books.delete(name);
    this.first.forget(name);
  }

  clear() {
    this.books.clear();
    this.first.clear();
  }

  async open(name) {
    const { tab, marking } = this;
    const { viewer } = tab;
    const turn = ++this.turn;
    const before = tab.name;
    const { width: wasWide, height: wasHigh } = viewer;
    tab.tool.cancel();
    tab.tool.leave();
    marking.shown = null;
    marking.select([]);
    if (before && before !== name) tab.leavePicture(before);
    tab.name = name;
    marking.open(null);
    if (this.cannotOpen(name)) return;
    tab.cover.hide();
    tab.refresh();
    try {
      const [picture, marks] = await Promise.all([
        tab.pictures.fetch(name),
        tab.template ? tab.saving.fetchMarks(name) : null,
      ]);
      if (turn !== this.turn) return;
      const { width, height } = marks ?? picture;
      viewer.setPicture(picture.bitmap, width, height);
      if (before !== name || width !== wasWide || height !== wasHigh) viewer.fit();
      if (!tab.template) tab.templates.begin();
      else await this.take(name, marks, turn);
    } catch (error) {
      if (turn === this.turn) this.failed(name, error);
    }
  }

  cannotOpen(name) {
    const { cover } = this.tab;
    const picture = this.state.picture(name);
    if (!name || !picture) {
      const folder = this.state.project?.folder ?? "the folder";
      const what = `Put pictures (JPEG, PNG, TIFF …) into ${folder}. They appear here automatically.`;
      cover.show("folder", "No pictures yet", what, this.invited());
    } else if (picture.state === "broken") {
      cover.show("warning", `${name} cannot be used`, picture.error ?? "It cannot be read: replace the file.");
    } else {
      return false;
    }
    this.showNothing();
    return true;
  }

  /** Generated heads to try the studio on, in a folder without pictures. */
  invited() {
    if (this.state.project?.pictures.length) return null;
    this.invitation ??= invitation(this.tab.app);
    return this.invitation;
  }

  failed(name, error) {
    const { cover } = this.tab;
    if (error.status === 0) {
      const what = "Start 'liaam studio' again, and the picture opens. Your changes are kept.";
      cover.show("warning", "The server is not reachable", what);
    } else {
      cover.show("warning", `${name} cannot be opened`, error.message);
    }
    this.showNothing();
  }

  showNothing() {
    this.tab.viewer.setPicture(null, 0, 0);
    this.tab.refresh();
  }

  /** Show a picture's marks from the server, or those that an earlier page could not save. */
  async take(name, marks, turn = this.turn) {
    const { tab, marking } = this;
    const { saver } = tab.saving;
    const kept = (await tab.saving.inherited(name, marks)) ?? saver.pending(name);
    const state = kept ? { ...kept, source: "file" } : await this.first.of(name, marks);
    if (turn !== this.turn) return;
    const old = this.books.get(name);
    const before = old?.history.state;
    const same = old && (saver.isDirty(name) || (before.source === state.source && sameMarks(before, state)));
    const book = {
      history: same ? old.history : new History(state), covariances: marks.covariances ?? null,
      doubtful: marks.doubtful, key: this.keyOf(name), tag: this.state.picture(name)?.tag,
    };
    this.books.set(name, book);
    marking.open(book);
    // If points are placed one after another, continue with the first missing one.
    const { source } = marking.state;
    const places = source === "none" || (source === "file" && this.begins() === "click");
    const first = places ? nextMissing(marking.points) : -1;
    marking.select(first < 0 ? [] : [first]);
    tab.cover.hide();
    tab.refresh();
  }

  /** Show the server's current marks of the open picture. */
  async reload() {
    const { tab, marking, turn } = this;
    const { name } = tab;
    if (!name || !tab.template || tab.editing) return;
    const marks = await tab.saving.tryToFetch(name); // if the server is unreachable, `online` calls this again
    if (!marks || turn !== this.turn || tab.saving.saver.isDirty(name) || tab.tool.gesture) return;
    const chosen = [...marking.selection];
    const { active } = marking;
    await this.take(name, marks, turn);
    if (marking.book && chosen.length && Math.max(...chosen) < marking.points.length) marking.select(chosen, active);
  }

  /** Fetch the picture at a higher resolution if the zoom needs it. */
  async sharpen() {
    const { viewer, pictures, name } = this.tab;
    const bitmap = await pictures.sharper(name, viewer.scale * devicePixelRatio);
    if (bitmap && this.tab.name === name) viewer.setSource(bitmap);
  }

  /** Whether the user has not changed anything, so that newer marks may replace the shown ones. */
  get pristine() {
    return this.marking.book !== null && !this.marking.history.canUndo && this.idle;
  }

  /** Whether neither a gesture nor a save is in progress. */
  get idle() {
    return !this.tab.saving.saver.isDirty(this.tab.name) && !this.tab.tool.gesture;
  }

  /** Key that changes when the marks of an unchanged picture may have to be reloaded. */
  keyOf(name) {
    const picture = this.state.picture(name);
    return `${picture?.state}|${picture?.uncertainty}|${this.state.project?.model?.trained}`;
  }

  /** The project was reloaded: the open picture may have been replaced, or the model may have a new proposal. */
  refresh() {
    const { tab, state } = this;
    const { book } = this.marking;
    if (!book) {
      const isBroken = state.picture(tab.name)?.state === "broken";
      if (tab.visible && !tab.editing && !isBroken && tab.cover.isShown) this.open(state.current);
    } else if (!tab.editing && this.idle && book.tag !== state.picture(tab.name)?.tag) {
      this.open(tab.name); // the file was replaced
    } else if (this.pristine && book.key !== this.keyOf(tab.name)) {
      book.key = this.keyOf(tab.name);
      this.reload();
    }
  }
}
