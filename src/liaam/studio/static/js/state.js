// The page's copy of the project, updated by the server's events.

import { api, ApiError } from "./api.js";
import { whoAmI } from "./bulk.js";
import { isIn } from "./strip-filters.js";
import { complaints, toast } from "./ui.js";
import { attempt } from "./unsaved.js";

const LOOK_EVERY = 4000; // milliseconds between checks of the folder
const RECONNECT_AFTER = 2000; // milliseconds
const ONE_STEP = 500; // milliseconds; faster changes of the address, as by a held key, are one step of Back

// The page's address holds the tab and the picture: a reload keeps them, and Back and Forward move between them.

let lastChange = -ONE_STEP; // of the address, milliseconds; so long ago that the first change is a step
let isOpen = false; // whether the page has opened its first picture and tab

/** The picture in an address; "" if the address is malformed. */
export const nameIn = (hash) => attempt(() => decodeURIComponent(hash.slice(1)), "");
export const tabIn = (search) => new URLSearchParams(search).get("tab");

/** The page is open: from now on, changes of the address are steps of Back and Forward. */
export function opened() { isOpen = true; }

/** Put the tab or the picture into the address. @param {{tab?: string, name?: string}} what */
export function remember({ tab, name }) {
  const address = new URL(location.href);
  if (tab !== undefined) address.searchParams.set("tab", tab);
  if (name !== undefined) address.hash = name ? encodeURIComponent(name) : "";
  if (address.href === location.href) return; // after Back and Forward
  const isStep = isOpen && performance.now() - lastChange >= ONE_STEP;
  lastChange = performance.now();
  if (isStep) history.pushState(null, "", address);
  else history.replaceState(null, "", address);
}

/** The project as the server has it, and what the page shows of it. Events: "project", "select", "folder", "landmarks",
 *  "measuring", "training", "fitting" and "online" say what has changed. */
export class State extends EventTarget {
  /** @type {Project | null} */
  #project;
  /** @type {string | null} */
  #current = null;
  /** @type {string[]} */
  #order = [];
  #worstFirst = false;
  #folder = "";
  /** @type {Counted | null} */
  #adding = null;
  #online = true;
  #restarted = false;
  #unsure = false; // whether another server, for another folder, may have taken over the port
  #indexed = null; // the project whose pictures are in #byName
  /** @type {Map<string, Picture>} */
  #byName = new Map();
  #refreshing = null; // promise of the fetch in progress
  #fetchAgain = false; // whether to fetch once more after it
  #changing = 0; // requests in progress that remove, restore or rename pictures
  #changed = 0; // how many have ended

  /** @param {Project | null} project what the server has already sent, if it has */
  constructor(project = null) {
    super();
    this.#project = project;
  }

  get project() { return this.#project; }
  /** Name of the selected picture. */
  get current() { return this.#current; }
  /** Names of the pictures as the list shows them. */
  get order() { return this.#order; }
  /** Whether that is by quality. */
  get worstFirst() { return this.#worstFirst; }
  /** The subfolder that the list shows; "" for all. */
  get folder() { return this.#folder; }
  /** {done, total} of the files that are being added, or null. */
  get adding() { return this.#adding; }
  get online() { return this.#online; }
  /** Whether a new server refuses this page, which has the token of an earlier one. */
  get restarted() { return this.#restarted; }

  async open() {
    const wanted = nameIn(location.hash); // before the first picture is selected
    await this.refresh();
    this.select(this.picture(wanted) ? wanted : this.#firstToOpen());
    this.#followEvents();
    this.#watchFolder();
  }

  /** Whether a model was dropped on the page, which then only fits. */
  get guest() { return this.#project?.model?.source === "guest"; }

  /** Whether nothing can be written in the folder, so that its pictures are only shown, fitted and relit. */
  get readOnly() { return this.#project?.read_only ?? false; }

  /** The picture of a name, by default the selected one; null if there is none. */
  picture(name = this.#current) {
    if (this.#indexed !== this.#project) {
      this.#indexed = this.#project;
      this.#byName = new Map(this.#project.pictures.map((picture) => [picture.name, picture]));
    }
    return this.#byName.get(name) ?? null;
  }

  /** Fetch the project again. However many calls there are during a fetch, one more follows it, since it may have begun
   *  before the change that they are about. */
  refresh() {
    if (this.#refreshing) {
      this.#fetchAgain = true;
      return this.#refreshing;
    }
    this.#refreshing = this.#fetch().finally(() => {
      const again = this.#fetchAgain;
      this.#refreshing = null;
      this.#fetchAgain = false;
      if (again) this.refresh().catch(() => {});
    });
    return this.#refreshing;
  }

  /** Fetch the project until the states of all pictures are known. */
  async settled() {
    await this.#refreshing?.catch(() => {}); // it may have begun before the last change
    do {
      await this.refresh().catch(() => {});
    } while (this.#project.pictures.some(({ state }) => state === "reading"));
  }

  select(name) {
    if (name === this.#current) return;
    const before = this.#current;
    this.#current = name;
    remember({ name: name ?? "" });
    this.#emit("select", { name, before });
  }

  /** Select the picture `by` positions further in the list, among those that can be opened. */
  step(by) {
    const names = this.order.filter((name) => this.picture(name)?.state !== "broken");
    if (!names.length) return;
    const position = names.indexOf(this.#current) + by;
    const last = names.length - 1;
    this.select(names[Math.min(Math.max(position, 0), last)]);
  }

  /** A picture has another name: it stays selected if it was. @param {string} before; @param {string} now */
  renamed(before, now) {
    const picture = this.picture(before);
    if (!picture) return;
    picture.name = now;
    this.#indexed = null;
    if (this.#current === before) this.select(now);
  }

  /** The list shows pictures in this order; worstFirst: whether that is by quality. */
  setOrder(names, { worstFirst = false } = {}) {
    this.#order = names;
    this.#worstFirst = worstFirst;
  }

  /** The pictures of the subfolder that is shown. */
  get pictures() { return this.#project.pictures.filter(({ name }) => isIn(name, this.#folder)); }

  /** Let the list show a subfolder; "" for all. */
  showFolder(folder) {
    this.#folder = folder;
    this.#emit("folder");
  }

  /** Save the marks of a picture. @param {string} name; @param {SaveMarks} marks; @param {Options} options */
  saveMarks(name, marks, options = {}) {
    const address = api.url("pictures/{name}/landmarks", { name });
    return this.send((folder) => api.put(address, { ...marks, folder, who: whoAmI(this.#project) }, options));
  }

  /** Take over what the server has answered about one picture. @param {Picture} picture */
  update(picture) {
    const current = this.picture(picture.name);
    if (!current) return;
    Object.assign(current, picture);
    this.#emit("project");
  }

  /** Take over the template that the server has saved; its pictures follow by `refresh`. @param {Template} template */
  takeTemplate(template) { this.#project.template = template; }

  /** Change what is measured of the pictures. The server sends the project after it. @param {SaveMeasuring} change */
  async changeMeasuring(change) {
    this.#project.measuring = await this.send((folder) => api.put(api.url("measuring"), { ...change, folder }));
    this.#emit("measuring");
  }

  /** Take over the state of a training, or of placing points.
   *  @template {"training" | "fitting"} Work; @param {Work} work; @param {Events[Work]} now */
  takeWork(work, now) {
    Object.assign(this.#project, { [work]: now });
    this.#emit(work, now);
  }

  /** Files are being added; null: no longer. @param {Counted | null} progress */
  setAdding(progress) {
    this.#adding = progress;
    this.#emit("fitting");
  }

  /** The connection was lost: another server may have taken over the port, so that the next request asks first. */
  doubt() { this.#unsure = true; }

  /** Check the folder for changes by other programs, which send no events, while the page is visible. */
  async #lookForChanges() {
    if (document.hidden || this.#refreshing || !this.#project) return;
    const began = this.#changed;
    const project = await api.get(api.url("project", { stamp: this.#project.stamp }), { quiet: true });
    if (!("unchanged" in project) && !this.#refreshing) this.#take(project, began);
  }

  #watchFolder() {
    const complain = complaints();
    const look = async () => {
      try {
        await this.#lookForChanges();
        complain("");
      } catch ({ status, message }) {
        if (status === 503) complain(message); // the folder is gone; a lost connection is reported by the event stream
      }
    };
    addEventListener("focus", look);
    document.addEventListener("visibilitychange", look);
    setInterval(look, LOOK_EVERY);
  }

  /** Send a request with the id of the page's folder. A server of another folder refuses it, and the page reloads.
   *  @template T; @param {(folder: string) => Promise<T>} request; @returns {Promise<T>} */
  async send(request) {
    if (this.#unsure) await this.refresh(); // otherwise send at once, since the page may be closing
    try {
      return await request(this.#project.id);
    } catch (error) {
      const isForAnotherFolder = Boolean(/** @type {ApiError} */ (error).body?.folder);
      if (isForAnotherFolder) await this.refresh();
      throw error;
    }
  }

  /** Send a request that removes, restores or renames pictures. The server says that its folder has changed before it
   *  answers. No project is taken over until `follow` has selected what the answer leaves, so that nothing is missed.
   *  @template T; @param {(folder: string) => Promise<T>} request; @param {(answer: T) => void} [follow]; @returns {Promise<T>} */
  async changeFiles(request, follow = () => {}) {
    this.#changing += 1;
    try {
      const answer = await this.send(request);
      follow(answer);
      return answer;
    } finally {
      this.#changing -= 1;
      this.#changed += 1;
      await this.#refreshing?.catch(() => {}); // it may have begun before
      await this.refresh().catch(() => {});
    }
  }

  /** Take over the project that the server has sent. Of another folder or version, the page is loaded again.
   *  @param {Project} project; @param {number} began how many changes of files had ended when it was asked for */
  #take(project, began) {
    const isAnother = this.#project && (this.#project.id !== project.id || this.#project.version !== project.version);
    if (isAnother) {
      location.reload(); // unsaved marks are kept with the id of their folder
      throw new ApiError("The studio now serves another folder, or is of another version.", 0);
    }
    this.#unsure = false;
    if (this.#changing || began !== this.#changed) return; // another is fetched after the change
    this.#project = project;
    if (!this.picture()) {
      if (this.#current) toast(`${this.#current} is no longer in the folder.`);
      this.select(this.#firstToOpen());
    }
    this.#emit("project");
  }

  async #fetch() {
    const quiet = Boolean(this.#project); // once a project is shown, a lost connection is shown beside it instead
    const began = this.#changed;
    try {
      this.#take(/** @type {Project} */ (await api.get(api.url("project"), { quiet })), began);
      this.#setOnline(true);
    } catch (error) {
      const isRefused = error.status === 401;
      if (error.unreachable || isRefused) this.#setOnline(false, isRefused);
      throw error;
    }
  }

  /** The first picture that is not done, or else the first; null if none can be opened. */
  #firstToOpen() {
    const pictures = this.#project.pictures.filter(({ state }) => state !== "broken");
    const first = pictures.find(({ state }) => state !== "done") ?? pictures[0];
    return first?.name ?? null;
  }

  #followEvents() {
    const source = new EventSource(api.url("events"));
    let lost = false;
    source.addEventListener("open", () => {
      this.#setOnline(true);
      if (lost) this.refresh().catch(() => {});
      lost = false;
    });
    source.addEventListener("error", () => {
      lost = true;
      this.doubt();
      this.#setOnline(false, this.#restarted);
      this.refresh().catch(() => {}); // an event source does not give the status: ask whether the server was restarted
      // A browser does not reconnect after an error status, such as from a new server with another token.
      if (source.readyState === EventSource.CLOSED) setTimeout(() => this.#followEvents(), RECONNECT_AFTER);
    });
    source.addEventListener("project", () => this.refresh().catch(() => {}));
    for (const work of /** @type {("training" | "fitting")[]} */ (["training", "fitting"])) {
      source.addEventListener(work, (/** @type {any} */ { data }) => {
        this.takeWork(work, JSON.parse(data));
      });
    }
    source.addEventListener("landmarks", ({ data }) => {
      /** @type {Events["landmarks"]} */
      const changed = JSON.parse(data); // of one picture, or of several
      for (const each of Array.isArray(changed) ? changed : [changed]) this.#emit("landmarks", each);
    });
    addEventListener("pagehide", () => source.close());
  }

  #setOnline(online, restarted = false) {
    if (online === this.#online && restarted === this.#restarted) return;
    this.#online = online;
    this.#restarted = restarted;
    this.#emit("online", online);
  }

  #emit(type, detail = null) { this.dispatchEvent(new CustomEvent(type, { detail })); }
}
