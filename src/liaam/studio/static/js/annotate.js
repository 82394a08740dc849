// The Annotate tab: places the points of one picture after another, saves them, and lets the model help.
//
// What is what: a *state* {points, invisible, source} is a value and what undo goes through; source "file" is the
// person's own, "proposal" the model's and "layout" the mean of what is done, both not saved until taken over. A *book*
// is what this page knows of one picture: its history, and what came with it from the server.

import { createAssist, nextToTeach } from "./assist.js";
import {
  drawBox,
  drawFrame,
  drawHint,
  drawLoupe,
  drawMarks,
  drawNames,
  drawPaths,
  drawSpread,
  drawText,
  COLOURS,
} from "./drawing.js";
import { keyEdit, PointTool } from "./gestures.js";
import { History } from "./history.js";
import { PictureStore } from "./picture-store.js";
import { PointList } from "./point-list.js";
import {
  bounds,
  expected,
  fitInto,
  flip,
  flipIndices,
  indicesOf,
  meanLayout,
  missing,
  nextMissing,
  place,
  placed,
  remove,
  sameMarks,
  samePoints,
  toggle,
  withTwins,
} from "./points.js";
import { contentOf, Page, Saver, Unsaved } from "./saving.js";
import { createTemplateEditor } from "./template-editor.js";
import { Viewer } from "./viewer.js";

const LAYOUT_OF = 8; // done pictures that the mean layout is made of
const KEEPALIVE = 60_000; // octets that a browser lets outlive a page
const SAY_AFTER = 350; // milliseconds without a further arrow key before a place is read out
const START_KEY = "liaam-studio:start";

const SHORTCUTS = [
  { keys: "Enter", what: "Accept the points, open the picture that teaches most" },
  { keys: "N", what: "Open it without accepting" },
  { keys: "Tab Shift+Tab", what: "Next, previous point (Escape, then Tab: leave the picture)" },
  { keys: "← → ↑ ↓", what: "Move the chosen points by 1 px; Shift 10, Alt 0.1" },
  { keys: "Ctrl+← Ctrl+→", what: "Turn them by 1°, Shift 5°" },
  { keys: "Ctrl+↑ Ctrl+↓", what: "Scale them by 1 %, Shift 5 %" },
  { keys: "Shift click", what: "Add to the choice; Shift drag: choose with a box" },
  { keys: "Ctrl+A Escape", what: "Choose all, none" },
  { keys: "P", what: "Place the missing point where the others suggest" },
  { keys: "Delete", what: "Take the point's place away" },
  { keys: "V", what: "Visible or not" },
  { keys: "X M", what: "Move twins along; flip left and right" },
  { keys: "B", what: "Dragging draws a box" },
  { keys: "L K E", what: "Names, contours, ellipses" },
  { keys: "H", what: "Hide all while held" },
  { keys: "Ctrl+Z Ctrl+Y", what: "Undo, redo" },
  { keys: "N C X P", what: "In the template: new path, close path, mirror, a point in the middle" },
];

const STATUS = {
  saved: "Saved",
  saving: "Saving…",
  offline: "Not saved – server unreachable, will retry",
  failing: "Not saved – will retry",
  refused: "Not saved",
  conflict: "Not saved – changed elsewhere",
  draft: "The template is saved with Done",
};

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

const sentence = (text) => (/[.!?]$/.test(text) ? text : `${text}.`);

export function mount(root, app) {
  return new AnnotateTab(root, app).api();
}

class AnnotateTab {
  constructor(root, app) {
    this.app = app;
    this.state = app.state;
    this.books = new Map();
    this.pictures = new PictureStore(app);
    this.shapes = new Map(); // name -> {points, width, height} of done pictures, for the layout
    this.book = null;
    this.name = null;
    this.opening = 0;
    this.selection = new Set();
    this.active = -1;
    this.preview = null;
    this.visible = false;
    this.hiding = false;
    this.escaped = false;
    this.nagged = null;
    this.editing = false; // whether the template is
    this.show = { names: false, contours: true, ellipses: true };
    this.mirrored = false;
    this.boxing = false;
    this.templateKey = "";
    this.build(root);
    this.makeSaver();
    this.listen();
    this.expose();
  }

  api() {
    return {
      show: () => this.appear(),
      hide: () => this.disappear(),
      shortcuts: SHORTCUTS,
      key: (event) => this.key(event),
    };
  }

  // The page's parts ------------------------------------------------------------------------------------------------

  build(root) {
    const { h } = this.app.ui;
    root.classList.add("annotate");
    this.container = h("div", { dataset: { testid: "annotate-viewer" } });
    this.prompt = h("div", { class: "annotate-prompt", hidden: true });
    this.hint = h("canvas", { class: "annotate-hint", hidden: true, "aria-hidden": "true" });
    this.cover = h("div", { class: "annotate-cover", hidden: true });
    this.live = h("p", { class: "visually-hidden", role: "status", "aria-live": "polite" });
    this.viewer = new Viewer(this.container, { label: "Picture with landmarks" });
    this.viewer.canvas.setAttribute("aria-describedby", "annotate-text");
    this.alternative = h("p", { class: "visually-hidden", id: "annotate-text" });
    this.container.append(this.prompt, this.hint, this.cover, this.alternative, this.live);
    this.editor = createTemplateEditor({
      app: this.app,
      viewer: this.viewer,
      onchange: () => this.refresh(),
      say: (text) => this.say(text),
      onsave: (work) => this.saveTemplate(work),
      oncancel: () => this.cancelTemplate(),
    });
    this.tool = new PointTool(this.viewer, () => this.doc, { boxes: () => this.boxing, onend: () => this.refresh() });
    this.viewer.tool = this.tool;
    this.viewer.addLayer((ctx) => this.draw(ctx));
    this.assist = createAssist({ app: this.app, accept: () => this.accept(), skip: () => this.skip() });
    this.side = h("aside", { class: "side annotate-side", "aria-label": "Points" });
    this.pointsPanel = this.makePointsPanel();
    root.append(h("div", { class: "workspace" }, this.makeToolbar(), this.container), this.side);
    this.doc = this.makeDoc();
  }

  makeToolbar() {
    const { h, button } = this.app.ui;
    const act = (label, icon, shortcut, onclick, more = {}) =>
      button(label, {
        icon,
        iconOnly: true,
        kind: "ghost",
        shortcut,
        onclick: (event) => this.act(event, onclick),
        ...more,
      });
    const toggle = (label, title, face, shortcut, onclick, pressed = false) =>
      button(face.text ?? label, {
        icon: face.icon,
        iconOnly: !face.text,
        "aria-label": label,
        kind: "ghost",
        shortcut,
        pressed,
        title,
        onclick: (event) => this.act(event, onclick),
      });
    const rule = () => h("span", { class: "rule", "aria-hidden": "true" });
    this.undoButton = act("Undo", "undo", "Ctrl+Z", () => this.undo(), { testid: "undo" });
    this.redoButton = act("Redo", "redo", "Ctrl+Y", () => this.redo(), { testid: "redo" });
    this.switches = {
      names: toggle("Names", "Names of all points", { text: "Aa" }, "L", () => this.flick("names")),
      contours: toggle(
        "Contours",
        "Contours: the template's paths",
        { icon: "path" },
        "K",
        () => this.flick("contours"),
        true,
      ),
      ellipses: toggle(
        "Ellipses",
        "Ellipses: where the model expects each point with 95 % probability",
        { icon: "target" },
        "E",
        () => this.flick("ellipses"),
        true,
      ),
    };
    this.boxButton = act("Choose with a box", "box", "B", () => this.toggleBox(), { pressed: false });
    this.mirrorButton = act("Move twins along", "mirror", "X", () => this.toggleMirrored(), { pressed: false });
    this.flipButton = act("Flip left and right", "swap", "M", () => this.flip());
    this.status = h("span", { class: "save-status", dataset: { testid: "save-status", state: "saved" } }, STATUS.saved);
    this.decideButton = button("Decide…", {
      small: true,
      hidden: true,
      onclick: () => this.decide(this.saver.conflicted),
    });
    return h(
      "div",
      { class: "toolbar annotate-toolbar", role: "group", "aria-label": "Annotate" },
      act("Previous picture", "left", "[", () => this.state.step(-1)),
      act("Next picture", "right", "]", () => this.state.step(1)),
      rule(),
      this.undoButton,
      this.redoButton,
      rule(),
      this.boxButton,
      this.mirrorButton,
      this.flipButton,
      rule(),
      h("div", { class: "row tight", role: "group", "aria-label": "Show" }, Object.values(this.switches)),
      h("span", { class: "grow" }),
      this.decideButton,
      this.status,
    );
  }

  /** Buttons give the keyboard back to the picture when they were clicked, so that Enter goes on with the work. */
  act(event, work) {
    work();
    if (event.detail > 0) this.viewer.canvas.focus({ preventScroll: true });
  }

  makePointsPanel() {
    const { h, button, segmented } = this.app.ui;
    this.list = new PointList(this.app.ui, (index, adds) => this.chooseFromList(index, adds));
    this.tally = h("span", { class: "muted small grow" });
    const small = (label, icon, shortcut, onclick) =>
      button(label, { icon, iconOnly: true, small: true, kind: "ghost", shortcut, onclick });
    this.hideButton = small("Visible or not", "eye-off", "V", () => this.toggleInvisible());
    this.removeButton = small("Take the place away", "trash", "Delete", () => this.removeChosen());
    this.startChoice = segmented(
      "How pictures without points begin",
      [
        { value: "layout", label: "Mean shape", title: "Begin with the mean of what is done" },
        { value: "click", label: "Click each", title: "Place the points one after another" },
      ],
      localStorage.getItem(START_KEY) ?? "layout",
      (value) => this.changeStart(value),
    );
    this.editButton = button("Edit template…", {
      icon: "edit",
      small: true,
      testid: "template-edit",
      onclick: () => this.editTemplate(),
    });
    return [
      this.assist.element,
      h(
        "section",
        { class: "panel grow point-panel" },
        h(
          "div",
          { class: "row" },
          h("h2", { class: "panel-title" }, "Points"),
          this.tally,
          this.hideButton,
          this.removeButton,
        ),
        this.list.element,
      ),
      h(
        "section",
        { class: "panel side-foot" },
        h(
          "div",
          { class: "row begin-with" },
          h("span", { class: "small muted grow" }, "Begin with"),
          this.startChoice.element,
        ),
        h("div", { class: "row" }, this.editButton),
      ),
    ];
  }

  // The document that gestures edit ---------------------------------------------------------------------------------

  makeDoc() {
    const tab = this;
    const marks = {
      get editable() {
        return tab.book !== null && !tab.hiding;
      },
      get points() {
        return tab.points;
      },
      get invisible() {
        return tab.invisible;
      },
      get selection() {
        return tab.selection;
      },
      get placing() {
        return tab.placing;
      },
      followsPointer: false,
      select: (indices, active) => tab.select(indices, active),
      preview(points) {
        tab.preview = points;
        tab.viewer.redraw();
      },
      revert() {
        tab.preview = null;
        tab.viewer.redraw();
      },
      commit: (points, what) => tab.commit({ points }, what),
      follow: (before, after, indices) =>
        tab.mirrored ? withTwins(before, after, indices, tab.template.mirror) : after,
      adding: (xy) => tab.adding(xy),
      press: () => false,
      framed: () => tab.framed(),
    };
    return marks;
  }

  get template() {
    return this.state.project?.template ?? null;
  }
  get marks() {
    return this.book?.history.state ?? null;
  }
  get points() {
    return this.preview ?? this.marks?.points ?? [];
  }
  get invisible() {
    return this.book?.hidden ?? new Set();
  }
  get suggested() {
    return this.marks !== null && (this.marks.source === "proposal" || this.marks.source === "layout");
  }
  get placing() {
    return this.book !== null && this.active >= 0 && this.active < this.points.length && !this.points[this.active];
  }

  framed() {
    if (this.selection.size > 1) return [...this.selection].filter((i) => this.points[i]);
    return this.marks?.source === "layout" ? placed(this.points) : [];
  }

  adding(xy) {
    if (!this.placing) return null;
    const before = this.points;
    const index = this.active;
    let points = place(before, index, xy);
    this.doc.preview(points);
    return {
      loupe: xy,
      move: function (at) {
        points = place(before, index, at);
        this.loupe = at;
      },
      up: () => {
        this.commit({ points }, `place ${this.template.names[index]}`);
        this.goOn(index);
      },
      cancel: () => this.doc.revert(),
    };
  }

  /** After a point was placed: the next that is missing. */
  goOn(index) {
    const next = nextMissing(this.points, index);
    this.select([next < 0 ? index : next]);
    this.sayPlace(index, next);
  }

  /** One step: what changes of the picture's marks. Whatever was suggested is the person's from now on. */
  commit(change, what, key = null) {
    const { points, invisible } = { ...this.marks, ...change };
    this.preview = null;
    const state = { points, invisible: invisible.filter((i) => points[i]), source: "file" };
    if (
      this.marks.source === "file" &&
      samePoints(points, this.marks.points) &&
      state.invisible.join() === this.marks.invisible.join()
    )
      return;
    this.book.history.push(state, what, key);
    this.changed();
  }

  /** The shown state is another: keep it, show it. */
  changed() {
    this.book.hidden = new Set(this.marks.invisible);
    this.saver.change(this.name, contentOf(this.marks));
    if (this.saver.entry(this.name).state === "conflict") this.decide(this.name);
    this.refresh();
  }

  select(indices, active = indices.at(-1) ?? -1) {
    this.selection = new Set(indices);
    this.active = active;
    this.escaped = false;
    this.markList();
    this.showHint();
    this.viewer.redraw();
  }

  // Opening pictures ------------------------------------------------------------------------------------------------

  appear() {
    this.visible = true;
    if (this.name !== this.state.current || !this.book) this.open(this.state.current);
    this.refresh();
    this.viewer.canvas.focus({ preventScroll: true });
  }

  disappear() {
    this.visible = false;
    this.tool.cancel();
    this.saver.flush();
  }

  async open(name) {
    const turn = ++this.opening;
    const before = this.name;
    const { width: wasWide, height: wasHigh } = this.viewer;
    this.tool.cancel();
    this.tool.leave(); // what the pointer was over is gone
    this.preview = null;
    this.select([]);
    if (before && before !== name) this.leavePicture(before);
    this.name = name;
    this.book = null;
    if (this.cannotOpen(name)) return;
    this.setCover(null);
    this.refresh();
    try {
      const [picture, marks] = await Promise.all([
        this.pictures.fetch(name),
        this.template ? this.fetchMarks(name) : null,
      ]);
      if (turn !== this.opening) return;
      const { width, height } = marks ?? picture;
      this.viewer.setPicture(picture.bitmap, width, height);
      if (before !== name || width !== wasWide || height !== wasHigh) this.viewer.fit();
      if (!this.template) this.beginTemplate();
      else await this.take(name, marks, turn);
    } catch (error) {
      if (turn === this.opening) this.failedToOpen(name, error);
    }
  }

  cannotOpen(name) {
    const picture = this.state.picture(name);
    if (!name || !picture) {
      const folder = this.state.project?.folder ?? "the folder";
      this.setCover(
        "folder",
        "No pictures yet",
        `Put pictures (JPEG, PNG, TIFF …) into ${folder}; they appear here by themselves.`,
      );
    } else if (picture.state === "broken") {
      this.setCover("warning", `${name} cannot be used`, picture.error ?? "It cannot be read; replace the file.");
    } else {
      return false;
    }
    this.viewer.setPicture(null, 0, 0);
    this.refresh();
    return true;
  }

  failedToOpen(name, error) {
    if (error.status === 0) {
      this.setCover(
        "warning",
        "The server is not reachable",
        "The picture opens as soon as 'liaam studio' runs again. What you did is kept.",
      );
    } else {
      this.setCover("warning", `${name} cannot be opened`, error.message);
    }
    this.viewer.setPicture(null, 0, 0);
    this.refresh();
  }

  setCover(icon, title = "", text = "") {
    const { h, icon: draw } = this.app.ui;
    this.cover.hidden = icon === null;
    if (icon !== null)
      this.cover.replaceChildren(h("div", { class: "empty" }, draw(icon, 40), h("h2", {}, title), h("p", {}, text)));
  }

  fetchMarks(name) {
    return this.app.api.get(this.app.api.url("pictures", name, "landmarks"));
  }

  /** Zoomed in on a picture that was fetched smaller than it is: fetch it as it is. */
  async sharpen() {
    const { name } = this;
    const bitmap = await this.pictures.sharper(name, this.viewer.scale * devicePixelRatio);
    if (bitmap && this.name === name) this.viewer.setSource(bitmap);
  }

  /** Show what the server has of a picture, or what an earlier page could not save. */
  async take(name, marks, turn = this.opening) {
    const kept = (await this.inherited(name, marks)) ?? this.saver.pending(name);
    const state = kept ? { ...kept, source: "file" } : await this.beginning(marks);
    if (turn !== this.opening) return;
    const old = this.books.get(name);
    const same =
      old &&
      (this.saver.isDirty(name) || (old.history.state.source === state.source && sameMarks(old.history.state, state)));
    const book = {
      history: same ? old.history : new History(state),
      covariances: marks.covariances ?? null,
      doubtful: marks.doubtful,
      quality: marks.quality,
      message: marks.status,
      hidden: null,
      key: this.pictureKey(name),
      tag: this.state.picture(name)?.tag,
      template: this.template.revision,
    };
    book.hidden = new Set(book.history.state.invisible);
    this.books.set(name, book);
    this.book = book;
    // Where points are placed one after another, go on with the first that is missing.
    const places = this.marks.source === "none" || (this.marks.source === "file" && this.startChoice.value === "click");
    const first = places ? nextMissing(this.points) : -1;
    this.select(first < 0 ? [] : [first]);
    this.setCover(null);
    this.refresh();
  }

  async beginning(marks) {
    const fits = marks.points.length === this.template.names.length; // a file may have been made for another template
    if (fits && (marks.source === "file" || marks.source === "proposal")) {
      return { points: marks.points, invisible: marks.invisible ?? [], source: marks.source };
    }
    const nothing = { points: this.template.names.map(() => null), invisible: [], source: "none" };
    if (this.startChoice.value === "click") return nothing;
    const points = await this.layout(marks.width, marks.height);
    return points ? { points, invisible: [], source: "layout" } : nothing;
  }

  /** Mean of what is done, or the template's own layout; null where there is neither. */
  async layout(width, height) {
    const done = this.state.project.pictures
      .filter((picture) => picture.state === "done" && picture.name !== this.name)
      .slice(0, LAYOUT_OF);
    await Promise.all(
      done.map(async ({ name }) => {
        if (this.shapes.has(name)) return;
        const marks = await this.fetchMarks(name).catch(() => null); // one that fails is left out of the mean
        if (marks?.source === "file") this.shapes.set(name, marks);
      }),
    );
    const shapes = done.map(({ name }) => this.shapes.get(name)).filter(Boolean);
    return (
      meanLayout(
        shapes.filter((shape) => shape.points.length === this.template.names.length),
        width,
        height,
      ) ?? this.ownLayout(width, height)
    );
  }

  ownLayout(width, height) {
    const points = this.template.points;
    const box = points && bounds(points);
    if (!box) return null;
    const fits =
      box[0] >= 0 &&
      box[1] >= 0 &&
      box[2] < width &&
      box[3] < height &&
      Math.max((box[2] - box[0]) / width, (box[3] - box[1]) / height) > 0.2;
    return fits ? points : fitInto(points, width, height);
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

  leavePicture(name) {
    this.saver.flush(name).then(() => this.assist.left());
  }

  pictureKey(name) {
    const picture = this.state.picture(name);
    return `${picture?.state}|${picture?.uncertainty}|${this.state.project?.model?.trained}`;
  }

  /** Whether the person has done nothing here: then newer marks may replace what is shown. */
  get pristine() {
    return this.book !== null && !this.book.history.canUndo && this.idle;
  }

  /** Whether nothing is under way: neither a gesture nor a save. */
  get idle() {
    return !this.saver.isDirty(this.name) && !this.tool.gesture;
  }

  async reload() {
    const { name } = this;
    const turn = this.opening;
    if (!name || !this.template || this.editing) return;
    const marks = await this.fetchMarks(name).catch(() => null); // unreachable: `online` brings us back here
    if (!marks || turn !== this.opening || this.saver.isDirty(name) || this.tool.gesture) return;
    const chosen = [...this.selection];
    const active = this.active;
    await this.take(name, marks, turn);
    if (this.book && chosen.length && Math.max(...chosen) < this.points.length) this.select(chosen, active);
  }

  changeStart(value) {
    localStorage.setItem(START_KEY, value);
    if (this.book && this.pristine && this.marks.source !== "file" && this.marks.source !== "proposal") this.reload();
  }

  // Saving ----------------------------------------------------------------------------------------------------------

  makeSaver() {
    const { api } = this.app;
    this.page = new Page();
    this.saver = new Saver({
      put: (name, body) => {
        const options = { keepalive: JSON.stringify(body).length < KEEPALIVE };
        const send = () => api.put(api.url("pictures", name, "landmarks"), body, options);
        return this.state.unsure ? this.state.sure().then(send) : send(); // at once, where the page is going away
      },
      unsaved: new Unsaved(localStorage, this.state.project.id ?? this.state.project.folder, this.page.name),
      template: () => this.template && { names: this.template.names, revision: this.template.revision },
      onTemplate: (name) => this.templateMoved(name),
      onLost: (name, sentence) => this.app.toast(sentence, "bad"),
      onStatus: (state, message) => this.showStatus(state, message),
      onSaved: (name, answer) => this.saved(name, answer),
      onConflict: (name, current) => this.decide(name, current),
      onForeign: (name) => this.foreign(name),
    });
  }

  saved(name, { picture }) {
    this.shapes.delete(name);
    if (picture) this.state.update(picture);
  }

  showStatus(state, message) {
    const { status } = this;
    const before = status.dataset.state;
    status.dataset.state = state;
    status.textContent =
      state === "offline" && message
        ? "Not saved, but kept – open the address that 'liaam studio' printed"
        : STATUS[state];
    status.title = message || status.textContent;
    this.complain(state === "refused" || state === "failing" ? `Not saved: ${message}` : "");
    this.decideButton.hidden = state !== "conflict";
    // Read out what went wrong and that it is well again, not every save.
    const wrong = ["offline", "failing", "refused", "conflict"];
    if (wrong.includes(state) && before !== state) this.say(status.title);
    if (wrong.includes(before) && state === "saved") this.say(STATUS.saved);
  }

  /** Say why nothing is saved, once; it goes when there is nothing to complain about. */
  complain(text) {
    if (text === this.complaint?.text) return;
    this.complaint?.close();
    this.complaint = text ? { text, close: this.app.toast(text, "bad") } : null;
  }

  /** A template is not saved before it is done; nothing should look as if it were. */
  showDraft() {
    const draft = this.editing && this.editor.started;
    if (draft) this.showStatus("draft", "");
    else if (this.status.dataset.state === "draft") this.saver.report();
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
    if (choice === "mine") return;
    this.books.delete(name);
    if (name === this.name) this.reload();
  }

  foreign(name) {
    this.shapes.delete(name);
    if (name === this.name) this.reload();
    else this.books.delete(name);
  }

  /** The server refused marks because they are of a template that is no more: learn the new one, carry them over. */
  async templateMoved(name) {
    const before = this.template?.revision;
    await this.state.refresh().catch(() => {}); // unreachable: `online` tries again
    // Another template came with it: `projectChanged` has seen to all that is unsaved.
    if (this.template && this.template.revision === before) await this.rebase([name]);
  }

  /** Carry what is not saved yet over to the present template. */
  async rebase(names = this.saver.dirty, mapping = null) {
    for (const name of names) {
      const marks = await this.fetchMarks(name).catch(() => null);
      if (marks) this.saver.rebase(name, marks, mapping);
    }
  }

  /** The template was made or changed elsewhere; what is being done here goes on under the new one. */
  async templateChanged(before) {
    const drafting = this.editing && this.editor.hasChanges;
    this.book = null;
    if (drafting) {
      this.editor.rebase(this.template);
      this.app.toast("The template was changed elsewhere. What you made is still here: look at it, then press Done.");
    } else if (before) {
      this.app.toast("The template was changed elsewhere, and is shown as it is now.");
    }
    await this.rebase();
    if (drafting) return;
    this.leaveTemplate();
    if (this.visible) await this.open(this.name);
  }

  cancelTemplate() {
    this.leaveTemplate();
    if (!this.book && this.visible) this.open(this.name);
  }

  /** Pictures that an earlier page could not save are saved now, whether they are opened or not. */
  async sendKept() {
    for (const name of this.saver.unsaved.names()) {
      if (!this.state.picture(name) || !this.template || this.saver.isDirty(name)) continue;
      if (name === this.name) {
        if (this.pristine) await this.reload();
        continue;
      }
      const marks = await this.fetchMarks(name).catch(() => null);
      if (marks) await this.inherited(name, marks);
    }
  }

  listen() {
    const { state } = this;
    state.addEventListener("select", ({ detail }) => this.selected(detail));
    state.addEventListener("project", () => this.projectChanged());
    state.addEventListener("landmarks", ({ detail }) => this.saver.heard(detail.name, detail.revision));
    state.addEventListener("online", ({ detail }) => {
      if (!detail) return;
      this.saver.retry();
      if (!this.book && this.visible && !this.editing) this.open(state.current);
    });
    this.templateKey = JSON.stringify(this.template);
    this.viewer.addEventListener("view", () => this.sharpen());
    document.addEventListener("visibilitychange", () => {
      if (document.visibilityState === "hidden") this.saver.flush();
    });
    addEventListener("pagehide", () => this.saver.flush());
    // A gesture is lost when the page goes away; what it showed was not the person's yet.
    document.addEventListener("keyup", (event) => {
      if (event.key.toLowerCase() === "h") this.hideMarks(false);
    });
    addEventListener("blur", () => this.hideMarks(false));
    setTimeout(() => this.sendKept(), 500);
  }

  selected({ name, before }) {
    if (name === this.name && this.editing) return; // sent back, see below
    if (this.editing && this.editor.isChanging && this.state.picture(before)) {
      // The template is being changed on the picture before: what was done there must not be lost by a click.
      this.app.toast("First finish the template: Done or Cancel at the right.");
      this.state.select(before);
      return;
    }
    if (this.editing && this.template) this.leaveTemplate();
    if (this.visible) this.open(name);
    else this.saver.flush();
  }

  projectChanged() {
    const key = JSON.stringify(this.template);
    if (key !== this.templateKey) {
      const before = this.templateKey !== "null";
      this.templateKey = key;
      this.shapes.clear();
      this.books.clear();
      if (this.template && !this.saving) {
        this.templateChanged(before);
        return;
      }
    }
    if (
      !this.book &&
      !this.editing &&
      this.visible &&
      this.state.picture(this.name)?.state !== "broken" &&
      !this.cover.hidden
    )
      this.open(this.state.current);
    else if (this.book && !this.editing && this.idle && this.book.tag !== this.state.picture(this.name)?.tag) {
      this.open(this.name); // the file was replaced
    } else if (this.book && this.pristine && this.book.key !== this.pictureKey(this.name)) {
      this.book.key = this.pictureKey(this.name);
      this.reload();
    }
  }

  // The template ----------------------------------------------------------------------------------------------------

  beginTemplate() {
    const running = this.editing && this.editor.started;
    this.editing = true;
    this.doc = this.editor.doc;
    if (!running) this.editor.start(null, null); // changing pictures keeps what was begun
    this.refresh();
  }

  editTemplate() {
    if (!this.book) return;
    const { width, height } = this.viewer;
    const layout = this.template.points ?? this.points;
    const known = placed(this.points).length ? expected(layout, this.points) : this.ownLayout(width, height);
    const points = this.points.map((point, i) => point ?? known?.[i] ?? null);
    this.saver.flush();
    this.tool.cancel();
    this.editing = true;
    this.doc = this.editor.doc;
    this.editor.start(this.template, points);
    this.refresh();
  }

  leaveTemplate() {
    this.editing = false;
    this.doc = this.makeDoc();
    this.select([]);
    this.refresh();
    this.viewer.canvas.focus({ preventScroll: true });
  }

  async saveTemplate({ template, mapping, points, isFresh }) {
    const { api, state } = this.app;
    const isNew = !this.template;
    // Editing the template does not place what was missing on this picture, but for points that are new.
    await this.saver.flush();
    const before = this.marks ?? (isNew ? null : await this.fetchMarks(this.name));
    const hadFile = before?.source === "file";
    this.saving = true;
    try {
      const saved = await api.put(api.url("template"), mapping ? { ...template, mapping } : template);
      await this.keepUnsaved(saved, mapping);
      this.templateKey = JSON.stringify(saved);
      this.books.clear();
      this.shapes.clear();
      await state.refresh();
      this.templateKey = JSON.stringify(this.template);
      const marks = await this.fetchMarks(this.name);
      this.leaveTemplate();
      await this.take(this.name, marks);
      if (isFresh && marks.source !== "file") this.commit({ points }, "template");
      else if (hadFile) this.commitEdited(points, mapping ?? indicesOf(points), before);
      await this.saver.flush(this.name);
    } catch (error) {
      if (error.status !== 409 || !error.body?.template) throw error;
      // What was made stays in the editor, on top of what the template is now.
      this.saving = false;
      this.templateKey = ""; // whatever has come meanwhile
      await state.refresh();
      throw new Error(`${sentence(error.message)} What you made is still here: look at it, then press Done again.`);
    } finally {
      this.saving = false;
    }
    this.app.toast(isNew ? "Template saved, and with it the points of this picture." : "Template saved.", "good");
  }

  /** The template is another from now on: what could not be saved before goes along. */
  async keepUnsaved(template, mapping) {
    this.state.project.template = template;
    if (template) await this.rebase(this.saver.dirty, mapping);
  }

  commitEdited(points, mapping, before) {
    const next = points.map((point, i) => (mapping[i] !== null && !before.points[mapping[i]] ? null : point));
    this.commit({ points: next }, "edit the template");
  }

  // Edits by buttons and keys ---------------------------------------------------------------------------------------

  get history() {
    return this.editing ? this.editor.history : (this.book?.history ?? null);
  }

  undo() {
    this.travel("undo");
  }
  redo() {
    this.travel("redo");
  }

  travel(way) {
    this.tool.cancel();
    if (this.editing) {
      this.editor[way]();
      return;
    }
    const what = way === "undo" ? this.history?.undoes : this.history?.redoes;
    if (!this.history?.[way]()) return;
    this.preview = null;
    this.changed();
    this.markList();
    this.say(`${way === "undo" ? "Undone" : "Redone"}: ${what}`);
  }

  flick(what, on = !this.show[what]) {
    this.show[what] = on;
    this.switches[what].setAttribute("aria-pressed", String(on));
    this.viewer.redraw();
  }

  hideMarks(on) {
    if (this.hiding === on) return;
    this.hiding = on;
    this.viewer.redraw();
  }

  toggleBox() {
    this.boxing = !this.boxing;
    this.boxButton.setAttribute("aria-pressed", String(this.boxing));
  }

  toggleMirrored() {
    if (!this.template?.mirror) {
      this.app.toast(
        "The template has no twins. Edit the template with Mirror on, or load one whose names tell left from right.",
      );
      return;
    }
    this.mirrored = !this.mirrored;
    this.mirrorButton.setAttribute("aria-pressed", String(this.mirrored));
    this.say(this.mirrored ? "Twins move along" : "Twins stay");
  }

  flip() {
    if (this.editing || !this.book) return;
    const { mirror } = this.template;
    this.commit({ points: flip(this.points, mirror), invisible: flipIndices(this.marks.invisible, mirror) }, "flip");
    this.say("Flipped left and right");
  }

  get chosen() {
    return [...this.selection].sort((a, b) => a - b);
  }

  toggleInvisible() {
    const chosen = this.chosen.filter((i) => this.points[i]);
    if (this.editing || !this.book || !chosen.length) return;
    const invisible = toggle(this.marks.invisible, chosen);
    this.commit({ invisible }, "visibility");
    this.say(`${this.nameOf(chosen)} ${invisible.includes(chosen[0]) ? "invisible" : "visible"}`);
  }

  removeChosen() {
    const chosen = this.chosen.filter((i) => this.points[i]);
    if (this.editing || !this.book || !chosen.length) return;
    this.commit({ points: remove(this.points, chosen) }, "take away");
    this.select(chosen, chosen[0]);
    this.say(`${this.nameOf(chosen)} has no place now`);
  }

  placeChosen() {
    const index = this.placing ? this.active : nextMissing(this.points, this.active);
    if (index < 0) return;
    const { width, height } = this.viewer;
    const guess = this.template.points ? expected(this.template.points, this.points)[index] : null;
    const inside = guess && guess[0] >= 0 && guess[1] >= 0 && guess[0] < width && guess[1] < height;
    this.commit(
      { points: place(this.points, index, inside ? guess : [width / 2, height / 2]) },
      `place ${this.template.names[index]}`,
    );
    this.select([index]);
    this.sayPlace(index);
  }

  stepPoint(by) {
    const count = this.points.length;
    const next = this.active < 0 ? (by > 0 ? 0 : count - 1) : this.active + by;
    if (next < 0 || next >= count) {
      this.select([]);
      return false; // the focus goes on with the page
    }
    this.select([next]);
    this.reveal(next);
    this.sayPlace(next);
    return true;
  }

  /** Bring a point into view where the picture is zoomed in. */
  reveal(index) {
    const point = this.points[index];
    if (!point) return;
    const [x, y] = this.viewer.toScreen(point);
    const { clientWidth: w, clientHeight: h } = this.viewer.canvas;
    if (x < 20 || y < 20 || x > w - 20 || y > h - 20) this.viewer.panBy(w / 2 - x, h / 2 - y);
  }

  accept() {
    if (this.editing || !this.book) return;
    if (this.suggested) this.commit({ points: this.points }, "accept");
    const left = missing(this.points);
    if (left.length && this.nagged !== this.name) {
      this.nagged = this.name; // said once: points may be left out on purpose
      this.select([left[0]]);
      this.app.toast(
        `${left.length === 1 ? `'${this.template.names[left[0]]}' is` : `${left.length} points are`} still missing here. Place ${left.length === 1 ? "it" : "them"}, or press Enter again to go on without.`,
      );
      return;
    }
    this.goNext();
  }

  skip() {
    if (!this.editing && this.book) this.goNext();
  }

  goNext() {
    this.nagged = null;
    const { name } = this;
    const next = nextToTeach(this.state.project.pictures, name);
    if (next) {
      this.state.select(next.name);
      this.viewer.canvas.focus({ preventScroll: true });
      return;
    }
    this.leavePicture(name);
    const open = this.state.project.pictures.some(
      (picture) => picture.name !== name && picture.state !== "done" && picture.state !== "broken",
    );
    if (!open) this.app.toast("All pictures are done. Open Fit to see what the model makes of them.", "good");
  }

  key(event) {
    const controls =
      event.target instanceof Element && event.target.closest("button, a, label, input, summary, [role=tab]");
    const letter = event.key.toLowerCase();
    const command = event.ctrlKey || event.metaKey;
    if (command && letter === "z") this[event.shiftKey ? "redo" : "undo"]();
    else if (command && letter === "y") this.redo();
    else if (command && letter === "a") this.chooseAll();
    else if (event.key === "Tab") return this.tabKey(event);
    else if (event.key.startsWith("Arrow")) return this.arrowKey(event);
    else if (event.key === "Enter" && !command) {
      if (controls) return false;
      this.accept();
    } else if (command || event.altKey) return false;
    else if (this.editing && this.editor.key(event)) return true;
    else return this.plainKey(event, letter) || this.viewer.key(event);
    return true;
  }

  plainKey(event, letter) {
    const keys = {
      l: () => this.flick("names"),
      k: () => this.flick("contours"),
      e: () => this.flick("ellipses"),
      b: () => this.toggleBox(),
      h: () => this.hideMarks(true),
      escape: () => this.escape(),
    };
    const marks = {
      v: () => this.toggleInvisible(),
      x: () => this.toggleMirrored(),
      m: () => this.flip(),
      n: () => this.skip(),
      p: () => this.placeChosen(),
      delete: () => this.removeChosen(),
      backspace: () => this.removeChosen(),
    };
    const work = keys[letter] ?? (this.editing || !this.book ? null : marks[letter]);
    if (!work) return false;
    work();
    return true;
  }

  escape() {
    this.tool.cancel();
    this.select([]);
    this.escaped = true;
  }

  chooseAll() {
    this.doc.select(placed(this.doc.points), -1);
    this.say(`${this.doc.selection.size} points chosen`);
  }

  /** Tab goes through the points while the picture has the focus; past the last, or after Escape, it goes on. */
  tabKey(event) {
    if (event.target !== this.viewer.canvas || this.editing || !this.book || this.escaped) return false;
    return this.stepPoint(event.shiftKey ? -1 : 1);
  }

  arrowKey(event) {
    const target = event.target;
    if (
      target instanceof Element &&
      target.closest("input, [role=listbox], [role=radiogroup], [role=tab]") &&
      target !== this.list.element
    )
      return false;
    const { doc } = this;
    if (!doc.editable || this.tool.gesture) return true;
    if (!this.editing && this.placing) this.placeChosen();
    const chosen = [...doc.selection].filter((i) => doc.points[i]);
    const before = doc.points;
    if (this.editing && !chosen.length && this.editor.shiftAxis(event)) return true;
    const edit = keyEdit(event, before, chosen.length ? chosen : placed(before), chosen);
    if (!edit) return false;
    const points = doc.follow(before, edit.points, chosen);
    if (this.editing) this.editor.nudge(points, edit.what, edit.key);
    else this.commit({ points }, edit.what, edit.key);
    this.saySoon(chosen);
    return true;
  }

  // The list of points ----------------------------------------------------------------------------------------------

  chooseFromList(index, adds) {
    if (!adds) this.select([index]);
    else this.select(this.selection.has(index) ? this.chosen.filter((i) => i !== index) : [...this.chosen, index]);
    this.reveal(index);
    this.sayPlace(index);
  }

  pointState(i) {
    if (!this.points[i]) return "missing";
    if (this.invisible.has(i)) return "invisible";
    return this.suggested ? "proposed" : "placed";
  }

  renderList() {
    this.list.render(this.book ? this.template.names : [], (i) => this.pointState(i));
    this.markList();
  }

  markList() {
    if (!this.list) return; // while the parts are being made
    this.list.mark(this.selection, this.active);
    this.hideButton.disabled = this.removeButton.disabled = this.selection.size === 0;
  }

  // What is shown ---------------------------------------------------------------------------------------------------

  refresh() {
    if (!this.assist) return; // while the parts are being made
    const panel = this.editing ? [this.editor.panel] : this.pointsPanel;
    if (this.side.firstChild !== panel[0]) this.side.replaceChildren(...panel);
    const { history } = this;
    this.undoButton.disabled = !history?.canUndo;
    this.redoButton.disabled = !history?.canRedo;
    this.undoButton.title = `Undo${history?.undoes ? `: ${history.undoes}` : ""} (Ctrl+Z)`;
    this.redoButton.title = `Redo${history?.redoes ? `: ${history.redoes}` : ""} (Ctrl+Y)`;
    const marking = !this.editing && this.book !== null;
    this.flipButton.disabled = !marking;
    this.mirrorButton.disabled = this.editing;
    this.editButton.disabled = !marking;
    if (!this.editing) this.renderList();
    this.showDraft();
    this.showTally();
    this.showPrompt();
    this.showHint();
    this.describe();
    this.viewer.redraw();
  }

  showTally() {
    const left = missing(this.points).length;
    const hidden = this.invisible.size;
    const parts = [`${this.points.length - left} of ${this.points.length}`, hidden && `${hidden} invisible`];
    this.tally.textContent = this.book ? parts.filter(Boolean).join(", ") : "";
  }

  showPrompt() {
    const text = !this.cover.hidden ? "" : this.editing ? this.editor.prompt : this.book ? this.promptText() : "";
    this.prompt.hidden = !text;
    this.prompt.dataset.kind = this.suggested && !this.editing ? "suggested" : "";
    if (this.prompt.textContent !== text) this.prompt.textContent = text;
  }

  promptText() {
    const { source } = this.marks;
    if (source === "proposal") {
      return this.book.doubtful
        ? "The model doubts these points: check each, drag what is off, then press Enter"
        : "Placed by the model: drag what is off, then press Enter";
    }
    if (source === "layout") return "The mean shape: put it in place by its frame, then drag single points";
    if (this.placing) return `Click ${this.template.names[this.active]}`;
    const left = missing(this.points).length;
    return left
      ? `${left} ${left === 1 ? "point is" : "points are"} missing: choose one in the list, then click its place`
      : "";
  }

  showHint() {
    const on = !this.editing && this.placing && Boolean(this.template?.points) && this.cover.hidden;
    this.hint.hidden = !on;
    if (on) drawHint(this.hint, this.template.points, this.template.contours, this.active, getComputedStyle(this.hint));
    if (!this.editing && this.book) this.showPrompt();
  }

  /** The picture in words, for those who do not see it. */
  describe() {
    const left = missing(this.points).length;
    const what = {
      proposal: "proposed by the model",
      layout: "the mean shape",
      none: "none placed yet",
      file: "placed by you",
    };
    this.alternative.textContent = this.editing
      ? `Making the template: ${this.editor.draft.names.length} points so far.`
      : this.book
        ? `${this.name}: ${this.points.length - left} of ${this.points.length} points, ${what[this.marks.source]}. Tab goes through the points, arrow keys move them; Escape, then Tab, leaves the picture.`
        : "No picture is open.";
    this.viewer.canvas.setAttribute("aria-label", this.name ? `${this.name} with landmarks` : "Picture with landmarks");
  }

  say(text) {
    this.live.textContent = text;
  }

  sayPlace(index, next = -1) {
    const point = this.points[index];
    const hidden = this.invisible.has(index) ? ", invisible" : "";
    const here = point
      ? `${this.template.names[index]}, ${point.map((v) => v.toFixed(1)).join(", ")}${hidden}`
      : `${this.template.names[index]}, missing`;
    this.say(next < 0 ? here : `${here}. Next: ${this.template.names[next]}`);
  }

  /** After a burst of keys, so that a screen reader is not flooded. */
  saySoon(indices) {
    clearTimeout(this.sayTimer);
    this.sayTimer = setTimeout(() => {
      if (this.editing) return;
      if (indices.length === 1) this.sayPlace(indices[0]);
      else this.say(`${indices.length || "All"} points moved`);
    }, SAY_AFTER);
  }

  nameOf(indices) {
    return indices.length === 1 ? this.template.names[indices[0]] : `${indices.length} points`;
  }

  draw(ctx) {
    const { viewer, tool } = this;
    if (!viewer.width || this.hiding) return;
    if (this.editing) this.editor.draw(ctx, tool);
    else if (this.book) this.drawPicture(ctx);
    if (tool.gesture?.box) drawBox(ctx, viewer, tool.gesture.box);
    if (tool.gesture?.loupe && tool.pointer)
      drawLoupe(ctx, viewer, tool.gesture.loupe, tool.pointer, this.suggested ? COLOURS.proposed : COLOURS.placed);
  }

  drawPicture(ctx) {
    const { viewer, tool, points, suggested, template } = this;
    const spread = this.marks.source === "proposal" && this.show.ellipses;
    if (spread) drawSpread(ctx, viewer, points, this.book.covariances);
    if (this.show.contours) drawPaths(ctx, viewer, points, template.contours, suggested);
    drawMarks(ctx, viewer, {
      points,
      invisible: this.invisible,
      selection: this.selection,
      active: this.active,
      hovered: tool.hovered,
      suggested,
      radius: points.length > 150 ? 3 : 4,
    });
    if (!tool.gesture) drawFrame(ctx, viewer, points, this.framed());
    const few = this.selection.size <= 6 ? [...this.selection] : [];
    const named = this.show.names ? indicesOf(points) : [...new Set([...few, tool.hovered].filter((i) => i >= 0))];
    drawNames(ctx, viewer, points, template.names, named);
    if (this.placing && tool.pointer && !tool.gesture && tool.hovered < 0) {
      drawText(ctx, template.names[this.active], tool.pointer.at[0] + 14, tool.pointer.at[1] + 16);
    }
  }

  /** Hooks for tests of the page, kept stable: where points are, on the picture and on the page. */
  expose() {
    const tab = this;
    window.liaamStudio = Object.assign(window.liaamStudio ?? {}, {
      annotate: {
        viewer: this.viewer,
        /** Points as shown: of the picture, or of the template that is being made. */
        points: () => tab.doc.points.map((point) => point && point.slice()),
        /** Where a point, or any [x, y] of the picture, is on the page: [clientX, clientY], null without place. */
        toClient: (what) => {
          const point = Array.isArray(what) ? what : tab.doc.points[what];
          return point ? tab.viewer.toClient(point) : null;
        },
        /** "file", "proposal", "layout", "none", or "template" while one is made; null while a picture opens. */
        source: () => (tab.editing ? "template" : (tab.marks?.source ?? null)),
        name: () => tab.name,
        selection: () => [...tab.doc.selection],
        invisible: () => [...tab.invisible],
        undoSteps: () => tab.history?.past.length ?? 0,
        isDirty: () => tab.saver.anyDirty,
      },
    });
  }
}
