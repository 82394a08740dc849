// Unsaved work in the browser's storage, which survives a reload, and the pages that save it.

/** The result of some work, or `otherwise` if it fails. Without a storage, unsaved work is lost with the page. */
export function attempt(work, otherwise = null) {
  try {
    return work();
  } catch {
    return otherwise;
  }
}

/** Unsaved marks of a folder. Tabs share the storage, so each entry contains the name of its `page`. */
export class Unsaved {
  #storage;
  #page;
  #prefix;

  /** `folder`: the project's id, since names of folders are not unique. */
  constructor(storage, folder, page = "") {
    this.#storage = storage;
    this.#page = page;
    this.#prefix = `liaam-studio:unsaved:${folder}:`;
  }

  set(name, entry) {
    attempt(() => this.#storage.setItem(this.#prefix + name, JSON.stringify({ ...entry, page: this.#page })));
  }

  get(name) { return attempt(() => JSON.parse(this.#storage.getItem(this.#prefix + name))); }
  delete(name) { attempt(() => this.#storage.removeItem(this.#prefix + name)); }

  names() {
    const keys = attempt(() => Object.keys(this.#storage), []);
    return keys.filter((key) => key.startsWith(this.#prefix)).map((key) => key.slice(this.#prefix.length));
  }
}

/** The draft of a new template, stored until it is saved: {get(), set(draft or null)}. */
export function keptDraft(folder) {
  const key = `liaam-studio:template:${folder}`;
  return {
    get() {
      const kept = attempt(() => JSON.parse(localStorage.getItem(key)));
      return kept?.names?.length === kept?.points?.length ? kept : null;
    },
    set: (draft) => attempt(() => (
      draft?.names.length ? localStorage.setItem(key, JSON.stringify(draft)) : localStorage.removeItem(key))),
  };
}

const LOCK = "liaam-studio:page:";
const LAST = "liaam-studio:last-page";

/** The name of this page, and which other pages are open. Each page holds a lock while it is open, so that its unsaved
 *  marks are not taken for those of a closed page. */
export class Page {
  #locks;
  #before;

  /** @param {{locks?: any, session?: Storage}} options */
  constructor({ locks = globalThis.navigator?.locks, session = sessionStorage } = {}) {
    this.#locks = locks;
    this.name = `${Date.now().toString(36)}-${Math.random().toString(36).slice(2)}`;
    this.#before = attempt(() => session.getItem(LAST));
    attempt(() => session.setItem(LAST, this.name));
    locks?.request(LOCK + this.name, () => new Promise(() => {})).catch(() => {});
  }

  /** Name of the page in this tab before a reload. */
  get before() { return this.#before; }

  async inherits(page) {
    if (page === this.name || page === this.#before || !this.#locks) return true;
    const { held } = await this.#locks.query();
    return !held.some((lock) => lock.name === LOCK + page);
  }
}

// Work handed as a file to the page of a studio at another address, with other browser storage.

const KIND = "liaam-studio-unsaved";
const isOf = (folder, key) =>
  key === `liaam-studio:template:${folder}` || key.startsWith(`liaam-studio:unsaved:${folder}:`);

/** The unsaved points and template of a folder as text; "" if there are none. */
export function unsavedWork(storage, folder) {
  const keys = Object.keys(storage).filter((key) => isOf(folder, key));
  const items = Object.fromEntries(keys.map((key) => [key, storage.getItem(key)]));
  return keys.length ? JSON.stringify({ kind: KIND, folder, items }) : "";
}

/** Keep another page's unsaved work for a reload of this one; return the number of items that this page has, too. */
export function takeWork(storage, folder, text, file) {
  const work = attempt(() => JSON.parse(text));
  if (work?.kind !== KIND)
    throw new Error(`${file} is not unsaved work of the studio: drop a picture, or the file that the studio saved.`);
  if (work.folder !== folder) throw new Error(`${file} belongs to another folder: open the studio on that folder.`);
  const items = Object.entries(work.items).filter(([key, value]) => isOf(folder, key) && typeof value === "string");
  const fresh = items.filter(([key]) => storage.getItem(key) === null);
  for (const [key, value] of fresh) storage.setItem(key, value);
  return items.length - fresh.length;
}
