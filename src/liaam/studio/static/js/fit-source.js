// The picture of the tabs Fit and Compare: one of the folder, or one that was dropped, pasted or opened.

import { api, busy } from "./api.js";

/** Longest side of the displayed copy in pixels. */
const SHOWN = 2048;

/** A picture to fit. `ready` resolves once the server has it; `image` is the displayed copy. */
export class Source {
  /** `tag` identifies the contents of the file in the folder, which may be replaced. */
  constructor(kind, name, tag = null) {
    this.kind = kind;
    this.name = name;
    this.tag = tag;
    this.id = null;
    this.image = null;
    this.width = this.height = 0;
    this.ready = null;
    this.opening = false;
    this.started = performance.now();
    this.key = kind === "picture" ? `picture ${name} ${tag}` : `upload ${(uploads += 1)}`;
  }

  get ofFolder() { return this.kind === "picture"; }
  get reference() { return this.ofFolder ? { picture: this.name } : { upload: this.id }; }

  address(what, query = {}) {
    if (!this.ofFolder) return api.url("uploads", this.id, what, query);
    return api.url("pictures", this.name, what, { ...query, tag: this.tag });
  }
}

let uploads = 0;

const shared = new WeakMap();

/** The sources of an app, shared by the tabs Fit and Compare. */
export function sourcesOf(app) {
  if (!shared.has(app)) shared.set(app, new Sources(app.state));
  return shared.get(app);
}

/**
 * Holds the current source. Events: "taken" when the upload of a file starts, "change" when another source is shown,
 * "ready" when the server has it, "failed" with the error.
 */
export class Sources extends EventTarget {
  constructor(state) {
    super();
    this.state = state;
    this.current = null;
    this._watchers = 0;
    this._chosen = false; // whether a picture of the folder was selected since a file was opened
    this._wanted = null;
    state.addEventListener("select", () => {
      this._chosen = true;
      this._follow();
    });
    state.addEventListener("project", () => this.current?.kind !== "upload" && this._follow());
  }

  /** A tab that shows the source is opened (true) or left (false). Pictures are loaded only while one is open. */
  watch(open) {
    this._watchers += open ? 1 : -1;
    // An opened file stays until a picture of the folder is selected in any tab.
    if (open && (this.current?.kind !== "upload" || this._chosen)) this._follow();
  }

  /** Show the selected picture of the folder again after an opened file. */
  backToFolder() {
    this.current = null;
    this._wanted = null;
    this._follow();
    if (!this.state.current) this._say("change");
  }

  _follow() {
    const name = this.state.current;
    if (!this._watchers || !name) return;
    const { tag = null } = this.state.picture(name) ?? {};
    const isOf = (source) => source?.ofFolder && source.name === name && source.tag === tag;
    if (isOf(this.current)) return;
    if (isOf(this._wanted) && this._wanted.opening) return;
    this._open(name, tag);
  }

  async _open(name, tag) {
    const source = new Source("picture", name, tag);
    source.opening = true;
    this._wanted = source;
    source.ready = Promise.resolve(source);
    try {
      const known = this.state.picture(name);
      if (known?.error) throw new Error(known.error);
      const image = await loaded(source.address("image", { size: SHOWN }));
      const size = known?.width ? known : await this._sizeOf(source, image);
      Object.assign(source, { image, width: size.width, height: size.height });
    } catch (error) {
      source.opening = false;
      if (this._wanted !== source) return;
      // The strip shows this picture as selected, so the previous one must not stay.
      this._show(null);
      this._say("failed", { error: namely(error, name), source });
      return;
    }
    source.opening = false;
    if (this._wanted === source) this._show(source);
  }

  /** The picture's size if the project lacks it: that of the copy, unless the copy was scaled down. */
  async _sizeOf(source, image) {
    if (Math.max(image.naturalWidth, image.naturalHeight) < SHOWN) {
      return { width: image.naturalWidth, height: image.naturalHeight };
    }
    return api.get(source.address("landmarks"));
  }

  /** Open a file: show it at once and upload it. */
  async take(file) {
    const source = new Source("upload", file.name || "pasted picture.png");
    const limit = this.state.project?.limits?.upload_bytes;
    if (limit && file.size > limit) {
      const what = `${source.name} has ${megabytes(file.size)}, more than the limit of ${megabytes(limit)}`;
      this._say("failed", { error: new Error(`${what}: put it into the folder, or make it smaller.`), source });
      return null;
    }
    this._wanted = source;
    this._chosen = false;
    source.ready = this._send(source, file);
    this._say("taken", { source });
    const seen = createImageBitmap(file).then((image) => {
      if (this._wanted !== source || source.image) return;
      Object.assign(source, { image, width: image.width, height: image.height });
      this._show(source);
    }, () => null); // formats that the browser cannot decode are shown after the upload
    try {
      await source.ready;
      await seen;
      if (this._wanted !== source) return source;
      if (!source.image) {
        source.image = await loaded(source.address("image", { size: SHOWN }));
        this._show(source);
      }
    } catch (error) {
      if (this._wanted === source) this._say("failed", { error, source });
      return null;
    }
    return source;
  }

  async _send(source, file) {
    const { id, width, height } = await api.upload(api.url("uploads", { name: source.name }), file);
    const known = source.width;
    Object.assign(source, { id, width, height });
    // Landmark coordinates refer to the server's size.
    if (known && this.current === source) this._say("ready", { source });
    return source;
  }

  _show(source) {
    this.current = source;
    this._say("change", { source });
  }

  _say(type, detail = {}) {
    this.dispatchEvent(new CustomEvent(type, { detail }));
  }
}

async function loaded(address) {
  const image = new Image();
  image.src = address;
  try {
    await busy.during(image.decode());
  } catch {
    // An <img> does not give the server's error message: request it.
    await api.buffer(address);
    throw new Error("The browser cannot show this picture: reload the page.");
  }
  return image;
}

function namely(error, name) {
  return error.message.includes(name) ? error : new Error(`${name}: ${error.message}`);
}

const megabytes = (bytes) => `${(bytes / 1e6).toFixed(0)} MB`;
