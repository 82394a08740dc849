// A cache of the folder's pictures, and the picture of the tabs Fit and Compare: one of these, or one that was dropped,
// pasted or opened.

import { api } from "./api.js";
import { TILED_FROM, Tiles } from "./tiles.js";

const SHOWN_SIZE = 2048; // longest side at first
const SHARP_SIZE = 8192; // longest side after zooming in
const KEPT = 4;
const LARGE_FILE = 1e6; // bytes of a picture from which on it may be too large to be decoded by the browser

async function bitmapOf(address) {
  const blob = await api.blob(address);
  return createImageBitmap(blob).catch(() => {
    throw new Error("The browser cannot show this picture: reload the page.");
  });
}

/** The tiles of a picture that is large; null for others. addressOf(what) -> address of a part of the picture. */
function tilesOf(addressOf, bitmap, width, height) {
  if (width * height < TILED_FROM) return null;
  return new Tiles(width, height, bitmap.width, (level, column, row) => bitmapOf(addressOf(`tiles/${level}/${column}/${row}`)));
}

/** The picture in a file; null if it is large: whole, it would take up to a gigabyte, so that it is fetched as tiles. */
async function decoded(file) {
  if (file.size > LARGE_FILE) {
    const [image, address] = [new Image(), URL.createObjectURL(file)];
    const isRead = new Promise((resolve, reject) => Object.assign(image, { onload: resolve, onerror: reject }));
    image.src = address; // its pixels are not decoded before it is drawn
    await isRead.finally(() => URL.revokeObjectURL(address));
    if (image.naturalWidth * image.naturalHeight >= TILED_FROM) return null;
  }
  return createImageBitmap(file);
}

/** The last few pictures, which are fetched at a higher resolution for zooming in. */
export class PictureStore {
  constructor(state) {
    this.state = state;
    this.pictures = new Map(); // name -> {bitmap, sharp, width, height, tag: of the file}
  }

  /** Fetch a picture: {bitmap, width, height}, with the size of landmark coordinates. */
  async fetch(name) {
    const known = this.pictures.get(name);
    return known && known.tag === this.state.picture(name)?.tag ? known : this.load(name, SHOWN_SIZE);
  }

  /** Fetch a sharper bitmap if `scale` (screen pixels per picture pixel) needs one; null otherwise. */
  async sharper(name, scale) {
    const picture = this.pictures.get(name);
    if (!picture || picture.sharp || picture.tiles) return null;
    const shown = picture.bitmap.width / picture.width; // bitmap pixels per picture pixel
    if (shown >= 1 || scale < 1.3 * shown) return null;
    picture.sharp = true; // request it once
    try {
      return (await this.load(name, SHARP_SIZE)).bitmap;
    } catch {
      picture.sharp = false; // the next zoom retries
      return null;
    }
  }

  async load(name, size) {
    const { tag } = this.state.picture(name);
    const bitmap = await bitmapOf(api.url("pictures", name, "image", { size, tag }));
    const { width, height } = await this.sizeOf(name, bitmap);
    const tiles = tilesOf((what) => api.url("pictures", name, what, { tag }), bitmap, width, height);
    const isSharp = size > SHOWN_SIZE || tiles !== null;
    const picture = { bitmap, sharp: isSharp, width, height, tag, tiles };
    this.pictures.get(name)?.tiles?.close();
    this.pictures.set(name, picture);
    for (const [other, { sharp, tiles: its }] of this.pictures) { // keep only one sharp picture, which may take a hundred megabytes
      if (other === name || !(this.pictures.size > KEPT || (sharp && picture.sharp))) continue;
      its?.close();
      this.pictures.delete(other);
    }
    return picture;
  }

  /** The picture's size, also if the project lacks it: that of the bitmap, unless it was scaled down. */
  async sizeOf(name, bitmap) {
    const known = this.state.picture(name);
    if (known?.width) return known;
    const isWhole = Math.max(bitmap.width, bitmap.height) < SHOWN_SIZE;
    return isWhole ? bitmap : api.get(api.url("pictures", name, "landmarks"));
  }
}

/** A picture to fit. `ready` resolves once the server has it; `image` is the displayed copy. */
export class Source {
  /** `tag` identifies the contents of the file in the folder, which may be replaced; null: the picture is not there. */
  constructor(name, tag = null) {
    this.name = name;
    this.tag = tag;
    this.id = null;
    this.file = null; // that was dropped or chosen, if the picture is not in the folder
    this.image = null;
    this.tiles = null; // of a large picture
    this.width = this.height = 0;
    this.method = this.fit = null; // how it is to be fitted with its upload, and that fit until it is shown
    this.quality = null; // of that fit
    this.ready = Promise.resolve();
    this.started = performance.now();
    this.key = this.ofFolder ? `picture ${name} ${tag}` : `upload ${(uploads += 1)}`;
  }

  get ofFolder() { return this.tag !== null; }
  get reference() { return this.ofFolder ? { picture: this.name } : { upload: this.id }; }

  address(what, query = {}) {
    if (!this.ofFolder) return api.url("uploads", this.id, what, query);
    return api.url("pictures", this.name, what, { ...query, tag: this.tag });
  }
}

let uploads = 0;

/** Holds the current source. Events: "taken" before the upload of a file starts, "change" when another source is shown,
 *  "ready" when the server has it, "failed" with the error. */
export class Sources extends EventTarget {
  constructor(state, pictures) {
    super();
    this.state = state;
    this._pictures = pictures;
    this.current = null;
    this._watchers = new Set(); // the open tabs that show the source
    this._chosen = false; // whether a picture of the folder was selected since a file was opened
    this._wanted = null; // the newest source, which may be still opening
    state.addEventListener("select", () => {
      this._chosen = true;
      this._follow();
    });
    state.addEventListener("project", () => this._isUpload || this._follow());
  }

  get _isUpload() { return this._wanted !== null && !this._wanted.ofFolder; }

  /** A tab that shows the source is opened. Pictures are loaded only while one is open. */
  watch(tab) {
    this._watchers.add(tab);
    // An opened file stays until a picture of the folder is selected in any tab.
    if (!this._isUpload || this._chosen) this._follow();
  }

  leave(tab) { this._watchers.delete(tab); }

  backToFolder() {
    this._leaveFile();
    this.current = this._wanted = null;
    this._follow();
  }

  _follow() {
    const name = this.state.current;
    if (!this._watchers.size || !name) return;
    const { tag } = this.state.picture(name);
    const isShown = (source) => source?.name === name && source.tag === tag;
    if (isShown(this.current)) this._wanted = this.current; // another one may be opening
    else if (!isShown(this._wanted)) this._open(name, tag);
  }

  async _open(name, tag) {
    const source = new Source(name, tag);
    this._wanted = source;
    try {
      const known = this.state.picture(name);
      if (known.error) throw new Error(known.error);
      const { bitmap: image, width, height, tiles } = await this._pictures.fetch(name);
      Object.assign(source, { image, width, height, tiles });
      if (this._wanted === source) this._show(source);
    } catch (error) {
      if (this._wanted !== source) return;
      this._wanted = null; // the next change tries it again
      // The strip shows this picture as selected, so the previous one must not stay.
      this._show(null);
      this._say("failed", { error: error.message.includes(name) ? error : new Error(`${name}: ${error.message}`) });
    }
  }

  async take(file) {
    const source = new Source(file.name || "pasted picture.png");
    const limit = this.state.project.limits.upload_bytes;
    const what = `${source.name} has ${megabytes(file.size)}, more than the limit of ${megabytes(limit)}`;
    if (file.size > limit)
      return this._say("failed", { error: new Error(`${what}: put it into the folder, or make it smaller.`) });
    const before = this.current;
    source.file = file;
    this._wanted = source;
    this._chosen = false;
    this._say("taken", { source });
    source.ready = this._send(source, file);
    const seen = decoded(file).then((image) => {
      if (this._wanted !== source || !image) return;
      source.image = image;
      if (!source.id) Object.assign(source, { width: image.width, height: image.height }); // until the server answers
      this._show(source);
    }, () => {}); // formats that the browser cannot decode are shown after the upload
    try {
      await source.ready;
      await seen;
      if (this._wanted !== source || source.image) return;
      await this._fetch(source);
      if (this._wanted === source) this._show(source);
    } catch (error) {
      if (this._wanted !== source) return;
      this._wanted = before;
      if (this.current === source) this._show(before); // the browser can show what the server refuses
      this._say("failed", { error });
    }
  }

  /** Fetch what is shown of an uploaded picture: a copy, and tiles if it is large. */
  async _fetch(source) {
    const { width, height } = source;
    const isTiled = width * height >= TILED_FROM;
    source.image = await bitmapOf(source.address("image", { size: isTiled ? SHOWN_SIZE : SHARP_SIZE }));
    source.tiles = tilesOf((what) => source.address(what), source.image, width, height);
  }

  async _send(source, file) {
    const { name, method } = source;
    Object.assign(source, await api.upload(api.url("uploads", { name, method }), file)); // id, width, height and fit
    source.quality = source.fit?.quality ?? null;
    // Landmark coordinates refer to the server's size.
    if (this.current === source) this._say("ready");
  }

  _show(source) {
    if (source !== this.current) this._leaveFile();
    this.current = source;
    this._say("change");
  }

  /** Free the tiles of a file that is shown; those of the folder's pictures are kept with these. */
  _leaveFile() { if (this.current?.file) this.current.tiles?.close(); }

  _say(type, detail = {}) { this.dispatchEvent(new CustomEvent(type, { detail })); }
}

/** A tab that fits the current source: Fit and Compare. */
export class SourceTab {
  visible = false;

  /** @param {App} app */
  constructor(app) {
    this.app = app;
    this.state = app.state;
    this.sources = app.sources;
  }

  /** Follow the source and the model, once the page is built. @this {any} */
  follow() {
    this.sources.addEventListener("change", () => this._source());
    this.sources.addEventListener("failed", ({ detail }) => this.visible && this._refused(detail.error));
    this.state.addEventListener("project", () => this._project());
    this._project();
  }

  show() {
    this.visible = true;
    this.sources.watch(this);
    this._source();
  }

  hide() {
    this.visible = false;
    this.sources.leave(this);
  }

  /** There may be another source: show it, and its fit if the tab is open. @this {any} */
  _source() {
    const source = this.sources.current;
    if (this._seen !== source) this._another((this._seen = source));
    this._emptiness();
    if (source && this.visible) this._showFit(source);
  }

  /** The project has changed, perhaps its model; then earlier fits are out of date. @this {any} */
  _project() {
    const { model } = this.state.project;
    const isAnother = this._number !== (model?.number ?? null);
    this._number = model?.number ?? null;
    this.overlays.hasContours = Boolean(model?.contours.length);
    this._emptiness();
    if (isAnother) this._anotherModel(model);
  }
}

const megabytes = (bytes) => `${(bytes / 1e6).toFixed(0)} MB`;
