// Unsaved marks in the browser's storage, and the pages that save them.

/** Unsaved marks of a folder in the browser's storage, which survive a reload. Tabs share the storage, so each entry
 *  contains the name of its `page`. */
export class Unsaved {
  /** `folder`: the project's id, since names of folders are not unique. */
  constructor(storage, folder, page = "") {
    this.storage = storage;
    this.page = page;
    this.prefix = `liaam-studio:unsaved:${folder}:`;
  }

  set(name, entry) {
    try {
      this.storage.setItem(this.prefix + name, JSON.stringify({ ...entry, page: this.page }));
    } catch {
      // Ignore a full or forbidden storage; the request is sent in any case.
    }
  }

  get(name) {
    try {
      return JSON.parse(this.storage.getItem(this.prefix + name));
    } catch {
      return null;
    }
  }

  delete(name) {
    try {
      this.storage.removeItem(this.prefix + name);
    } catch {
      // As above.
    }
  }

  names() {
    try {
      return Object.keys(this.storage)
        .filter((key) => key.startsWith(this.prefix))
        .map((key) => key.slice(this.prefix.length));
    } catch {
      return [];
    }
  }
}

const LOCK = "liaam-studio:page:";
const LAST = "liaam-studio:last-page";

/** The name of this page, and which other pages are open. Each page holds a lock while it is open, so that its unsaved
 *  marks are not taken for those of a closed page. */
export class Page {
  constructor({ locks = globalThis.navigator?.locks, session = sessionStorage } = {}) {
    this.locks = locks;
    this.name = `${Date.now().toString(36)}-${Math.random().toString(36).slice(2)}`;
    try {
      this.before = session.getItem(LAST); // name of the page in this tab before a reload
      session.setItem(LAST, this.name);
    } catch {
      this.before = null;
    }
    locks?.request(LOCK + this.name, () => new Promise(() => {})).catch(() => {});
  }

  /** Whether `page` is closed, so that this page saves its unsaved marks. */
  async inherits(page) {
    if (page === this.name || page === this.before || !this.locks) return true;
    const { held } = await this.locks.query();
    return !held.some((lock) => lock.name === LOCK + page);
  }
}
