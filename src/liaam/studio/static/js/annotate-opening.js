// Opening pictures in the Annotate tab: fetches them with their marks from the server or from an earlier page.

import { createFirstScreen } from "./first-screen.js";
import { History } from "./history.js";
import { layoutIn, meanLayout, remove, sameMarks } from "./points.js";
import { h, icon } from "./ui.js";

const UNREACHABLE = {
  title: "The server is not reachable",
  text: "Start 'liaam studio' again, and open the address that it prints. Your changes are kept.",
};
const LAYOUT_OF = 8; // number of done pictures in the mean layout

const isSame = (one, other) => one.source === other.source && sameMarks(one, other);
const isSaved = ({ source }) => source === "file";

/** begins() -> the start of pictures without points, "layout" or "click"; cover: the element that a message or the first
 *  screen is shown in, over the view.
 *  @param {import("./annotate.js").Tab} tab; @param {{begins: () => string, cover?: any}} options */
export function createOpening(tab, { begins, cover = null }) {
  const { state, marking, viewer } = tab;
  const fetchMarks = (name) => tab.saving.fetchMarks(name);
  const first = new FirstMarks({ state, fetchMarks, begins });
  const books = new Map(); // name -> book of a picture that was opened on this page
  let opened = null; // name of the open picture
  let begin = null; // the first screen
  let turn = 0; // incremented with each picture, to drop late answers

  async function open(name) {
    const own = ++turn;
    const before = opened;
    const { width: wasWide, height: wasHigh } = viewer;
    tab.tool.cancel();
    tab.tool.leave();
    tab.drawing?.turn(false);
    marking.setShown(null);
    marking.select([]);
    if (before && before !== name) tab.leavePicture(before);
    opened = name;
    marking.open(null);
    const fault = whyNot(name);
    if (fault) return showInstead(fault);
    cover.hidden = true;
    tab.refresh();
    try {
      const key = keyOf(name); // before the marks are fetched: a large picture takes seconds, and marks may change meanwhile
      const requests = [tab.app.pictures.fetch(name), tab.template ? fetchMarks(name) : null];
      const [picture, marks] = await Promise.all(requests);
      if (own !== turn) return;
      const { width, height } = marks ?? picture;
      viewer.setPicture(picture.bitmap, width, height, picture.tiles);
      viewer.mirror(tab.shown.isMirrored(name));
      if (before !== name || width !== wasWide || height !== wasHigh) viewer.fit();
      if (!tab.template || tab.templates.isDrafting) tab.templates.begin();
      else await take(name, marks, own, key);
      if (own === turn && hasNewerMarks()) reload();
    } catch (error) {
      if (own !== turn) return;
      const instead = error.status === 0 ? UNREACHABLE : { title: `${name} cannot be opened`, text: error.message };
      showInstead({ icon: "warning", ...instead });
    }
  }

  /** Why a picture cannot be opened, for the cover; null if it can be. */
  function whyNot(name) {
    const picture = state.picture(name);
    if (!name || !picture) {
      if (!state.project.pictures.length) return { instead: (begin ??= createFirstScreen(tab.app)) };
      return { icon: "folder", title: "No picture is open", text: "Select one in the list." };
    }
    if (picture.state !== "broken") return null;
    const text = picture.error ?? "It cannot be read: replace the file.";
    return { icon: "warning", title: `${name} cannot be used`, text };
  }

  /** Cover the view with a message, or with the element `instead`. */
  function showInstead(/** @type {any} */ { icon: name, title, text, instead = null }) {
    cover.hidden = false;
    cover.replaceChildren(instead ?? h("div.empty", icon(name, 40), h("h2", title), h("p", text)));
    viewer.setPicture(null, 0, 0);
    tab.refresh();
  }

  /** Show a picture's marks from the server, or those that an earlier page could not save.
   *  @param {string} name; @param {Marks} marks */
  async function take(name, marks, own = turn, key = keyOf(name)) {
    const { saver } = tab;
    const kept = (await tab.saving.inherited(name, marks)) ?? saver.pending(name);
    // A scale bar that was drawn, or absent points that were marked, beside suggested points.
    const isOther = kept && marks.source !== "file" && !kept.points.some(Boolean);
    const known = isOther ? { ...marks, bar: kept.bar, absent: kept.absent ?? marks.absent } : marks;
    const shown = kept && !isOther ? { ...kept, source: "file" } : await first.of(name, known);
    if (own !== turn) return;
    const old = books.get(name);
    const tag = state.picture(name)?.tag;
    const before = old?.history.state;
    const same = old && (saver.isDirty(name) || isSame(before, shown));
    const isChanged = old && old.tag === tag && before.points.length === shown.points.length && [before, shown].some(isSaved);
    if (!same && isChanged) old.history.follow(shown, isSame, "the change elsewhere", old === marking.book ? marking.context : null);
    const book = {
      name, history: same || isChanged ? old.history : new History(shown), covariances: marks.covariances ?? null, fitted: marks.fitted ?? [],
      doubtful: marks.doubtful, nothing: state.picture(name)?.nothing_found ?? false, sharedBar: marks.bar_shared ? marks.bar : null,
      pixel: marks.pixel, key, tag, seen: null,
    };
    book.seen = book.history.state; // as it was opened
    books.set(name, book);
    marking.open(book);
    // If points are placed one after another, continue with the first missing one.
    const { source } = marking.state;
    const places = source === "none" || (source === "file" && begins() === "click");
    const missing = places ? marking.nextMissing() : -1;
    marking.select(missing < 0 ? [] : [missing]);
    cover.hidden = true;
    tab.refresh();
  }

  async function reload() {
    const { saver } = tab;
    const name = opened;
    const own = turn;
    if (!name || !tab.template || tab.editing) return;
    const revision = saver.revisionOf(name);
    const key = keyOf(name);
    const marks = await tab.saving.tryToFetch(name); // if the server is unreachable, `online` calls this again
    if (!marks || own !== turn || saver.isDirty(name) || tab.tool.gesture) return;
    const { chosen, active } = marking;
    if (saver.revisionOf(name) !== revision) await reload(); // this page has saved newer marks meanwhile
    else await take(name, marks, own, key);
    if (marking.book && chosen.length && chosen.at(-1) < marking.points.length) marking.select(chosen, active);
  }

  async function sharpen() {
    const name = opened;
    const bitmap = await tab.app.pictures.sharper(name, viewer.scale * devicePixelRatio);
    if (bitmap && opened === name) viewer.setPicture(bitmap, viewer.width, viewer.height);
  }

  const isIdle = () => !tab.saver.isDirty(opened) && !tab.tool.gesture;

  /** Whether no marks are shown that a person has made, so that newer ones may replace them. */
  const isPristine = () => marking.book !== null && !(marking.history.canUndo && isSaved(marking.state)) && isIdle();

  /** Key that changes when the marks of an unchanged picture may have to be reloaded. */
  function keyOf(name) {
    const picture = state.picture(name);
    return `${picture?.state}|${picture?.uncertainty}|${state.project?.model?.trained}`;
  }

  /** Whether the shown marks, which the user has not changed, are older than what the project says of the picture. */
  const hasNewerMarks = () => isPristine() && marking.book.key !== keyOf(opened);

  /** The project was reloaded: the open picture may have been replaced, or the model may have a new proposal. */
  function refresh() {
    const { book } = marking;
    if (!book) {
      const isBroken = state.picture(opened)?.state === "broken";
      if (tab.visible && !tab.editing && !isBroken && !cover.hidden) open(state.current);
    } else if (!tab.editing && isIdle() && book.tag !== state.picture(opened)?.tag) {
      open(opened); // the file was replaced
    } else if (hasNewerMarks()) {
      reload();
    } else if (!tab.editing && isIdle()) {
      const { state: progress = "reading", revision } = state.picture(opened) ?? {};
      if (progress !== "reading" && revision !== tab.saver.revisionOf(opened)) reload(); // by another program
    }
  }

  /** A picture's landmarks were changed elsewhere, or the changes of this page were discarded. */
  function foreign(name, discarded = false) {
    first.forget(name);
    if (discarded) books.delete(name);
    if (name !== opened) return;
    if (discarded && !tab.editing) open(name); // the discarded points must not be edited until then
    else reload();
  }

  const clear = () => {
    books.clear();
    first.clear();
  };
  return {
    open, take, reload, sharpen, refresh, foreign, clear, isPristine,
    /** Name of the open picture. */
    get name() { return opened; },
    /** Whether a message or the first screen covers the view. */
    get isCovered() { return !cover.hidden; },
    /** What the page knows of a picture that was opened on it; undefined of another. */
    bookOf: (name) => books.get(name),
    /** The marks of a picture were changed: others do not begin with the earlier ones. */
    forget: (name) => first.forget(name),
  };
}

/** Marks that a picture opens with: its own, the model's proposal, or the mean of the done pictures. */
export class FirstMarks {
  /** @type {import("./state.js").State} */
  #state;
  #fetchMarks;
  #begins;
  /** @type {Map<string, Promise<Marks | null>>} */
  #shapes = new Map(); // of done pictures by name

  /** begins() -> "layout" or "click".
   *  @param {{state: import("./state.js").State, fetchMarks: (name: string) => Promise<Marks>, begins: () => string}} options */
  constructor({ state, fetchMarks, begins }) {
    this.#state = state;
    this.#fetchMarks = fetchMarks;
    this.#begins = begins;
  }

  forget(name) { this.#shapes.delete(name); }
  clear() { this.#shapes.clear(); }

  /** @param {string} name; @param {Marks} marks */
  async of(name, { points, invisible, absent = [], origins = null, source, width, height, bar = null }) {
    const { names } = this.#state.project.template;
    const fits = points.length === names.length; // a file may belong to another template
    const lacks = fits ? absent : [];
    const without = (all) => (lacks.length ? remove(all, lacks) : all);
    if (fits && (source === "file" || source === "proposal"))
      return { points: without(points), invisible: invisible ?? [], absent: lacks, origins, source, bar };
    const layout = this.#begins() === "click" || this.#state.readOnly ? null : await this.#layout(name, width, height);
    const own = layout ? { points: without(layout), source: "layout" } : { points: names.map(() => null), source: "none" };
    return { ...own, invisible: [], absent: lacks, origins: null, bar };
  }

  /** Mean of the done pictures, or else the template's layout; null if there is neither. */
  async #layout(name, width, height) {
    const { template, pictures } = this.#state.project;
    const done = pictures.filter((picture) => picture.state === "done" && picture.name !== name).slice(0, LAYOUT_OF);
    const shapes = await Promise.all(done.map((picture) => this.#learn(picture.name)));
    const whole = shapes.filter((shape) => shape?.source === "file" && shape.points.length === template.names.length);
    return meanLayout(whole, width, height) ?? layoutIn(template.points, width, height);
  }

  /** Marks of a done picture; null if they cannot be fetched, so that it is left out of the mean. */
  #learn(name) {
    const fetched = () => this.#fetchMarks(name).catch(() => { this.#shapes.delete(name); return null; });
    if (!this.#shapes.has(name)) this.#shapes.set(name, fetched());
    return this.#shapes.get(name);
  }
}
