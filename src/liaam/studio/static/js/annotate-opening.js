// Opening pictures in the Annotate tab: fetching them, with what the server or an earlier page has of their marks.

import { FirstMarks } from "./first-marks.js";
import { History } from "./history.js";
import { nextMissing, sameMarks } from "./points.js";

export class Opening {
  /** tab: the Annotate tab; begins() -> how pictures without points begin, "layout" or "click". */
  constructor(tab, begins) {
    Object.assign(this, { tab, state: tab.state, marking: tab.marking, begins });
    this.first = new FirstMarks({ state: tab.state, fetchMarks: (name) => tab.saving.fetchMarks(name), begins });
    this.books = new Map(); // name -> book, of pictures that were open on this page
    this.turn = 0; // counts up, so that what comes late is not shown
  }

  /** The landmarks of a picture are others. */
  forget(name) {
    this.books.delete(name);
    this.first.forget(name);
  }

  /** The template is another. */
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
    tab.tool.leave(); // what the pointer was over is gone
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
      const what = `Put pictures (JPEG, PNG, TIFF …) into ${folder}; they appear here by themselves.`;
      cover.show("folder", "No pictures yet", what);
    } else if (picture.state === "broken") {
      cover.show("warning", `${name} cannot be used`, picture.error ?? "It cannot be read; replace the file.");
    } else {
      return false;
    }
    this.showNothing();
    return true;
  }

  failed(name, error) {
    const { cover } = this.tab;
    if (error.status === 0) {
      const what = "The picture opens as soon as 'liaam studio' runs again. What you did is kept.";
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

  /** Show what the server has of a picture, or what an earlier page could not save. */
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
      history: same ? old.history : new History(state),
      covariances: marks.covariances ?? null,
      doubtful: marks.doubtful,
      key: this.keyOf(name),
      tag: this.state.picture(name)?.tag,
    };
    this.books.set(name, book);
    marking.open(book);
    // Where points are placed one after another, go on with the first that is missing.
    const { source } = marking.state;
    const places = source === "none" || (source === "file" && this.begins() === "click");
    const first = places ? nextMissing(marking.points) : -1;
    marking.select(first < 0 ? [] : [first]);
    tab.cover.hide();
    tab.refresh();
  }

  /** Show what the server has now of the picture that is open. */
  async reload() {
    const { tab, marking, turn } = this;
    const { name } = tab;
    if (!name || !tab.template || tab.editing) return;
    const marks = await tab.saving.tryToFetch(name); // unreachable: `online` brings us back here
    if (!marks || turn !== this.turn || tab.saving.saver.isDirty(name) || tab.tool.gesture) return;
    const chosen = [...marking.selection];
    const { active } = marking;
    await this.take(name, marks, turn);
    if (marking.book && chosen.length && Math.max(...chosen) < marking.points.length) marking.select(chosen, active);
  }

  /** Zoomed in on a picture that was fetched smaller than it is: fetch it as it is. */
  async sharpen() {
    const { viewer, pictures, name } = this.tab;
    const bitmap = await pictures.sharper(name, viewer.scale * devicePixelRatio);
    if (bitmap && this.tab.name === name) viewer.setSource(bitmap);
  }

  /** Whether the person has done nothing here: then newer marks may replace what is shown. */
  get pristine() {
    return this.marking.book !== null && !this.marking.history.canUndo && this.idle;
  }

  /** Whether nothing is under way: neither a gesture nor a save. */
  get idle() {
    return !this.tab.saving.saver.isDirty(this.tab.name) && !this.tab.tool.gesture;
  }

  /** What the marks of a picture that nobody has touched depend on. */
  keyOf(name) {
    const picture = this.state.picture(name);
    return `${picture?.state}|${picture?.uncertainty}|${this.state.project?.model?.trained}`;
  }

  /** The project is told anew: the picture that is open may be another, or the model may know more of it. */
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
