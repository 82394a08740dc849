// A cache of the folder's pictures, and the picture of the tabs Fit and Compare: one of these, or one that was dropped,
// pasted or opened.

import { api } from "./api.js";
import { TILED_FROM, Tiles } from "./tiles.js";

const SHOWN_SIZE = 2048; // longest side at first
const SHARP_SIZE = 8192; // longest side after zooming in
const KEPT = 4;
const LARGE_FILE = 1e6; // bytes of a picture from which on it may be too large to be decoded by the browser

/** @param {Address<Filing<"GET">>} address */
async function bitmapOf(address) {
  const blob = await api.blob(address);
  return createImageBitmap(blob).catch(() => {
    throw new Error("The browser cannot show this picture: reload the page.");
  });
}

/** The tiles of a picture that is large; null for others. addressOf(level, column, row) -> address of a tile. */
function tilesOf(addressOf, bitmap, width, height) {
  if (width * height < TILED_FROM) return null;
  return new Tiles(width, height, bitmap.width, (level, column, row) => bitmapOf(addressOf(level, column, row)));
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
  /** @type {import("./state.js").State} */
  #state;
  #pictures = new Map(); // name -> {bitmap, sharp, width, height, tag: of the file}

  /** @param {import("./state.js").State} state */
  constructor(state) { this.#state = state; }

  /** Fetch a picture: {bitmap, width, height}, with the size of landmark coordinates. */
  async fetch(name) {
    const known = this.#pictures.get(name);
    return known && known.tag === this.#state.picture(name)?.tag ? known : this.#load(name, SHOWN_SIZE);
  }

  /** Fetch a sharper bitmap if `scale` (screen pixels per picture pixel) needs one; null otherwise. */
  async sharper(name, scale) {
    const picture = this.#pictures.get(name);
    if (!picture || picture.sharp || picture.tiles) return null;
    const shown = picture.bitmap.width / picture.width; // bitmap pixels per picture pixel
    if (shown >= 1 || scale < 1.3 * shown) return null;
    picture.sharp = true; // request it once
    try {
      return (await this.#load(name, SHARP_SIZE)).bitmap;
    } catch {
      picture.sharp = false; // the next zoom retries
      return null;
    }
  }

  async #load(name, size) {
    const { tag } = this.#state.picture(name);
    const bitmap = await bitmapOf(api.url("pictures/{name}/image", { name, size, tag }));
    const { width, height } = await this.#sizeOf(name, bitmap);
    const tiles = tilesOf((level, column, row) => (
      api.url("pictures/{name}/tiles/{level}/{column}/{row}", { name, tag, level, column, row })), bitmap, width, height);
    const isSharp = size > SHOWN_SIZE || tiles !== null;
    const picture = { bitmap, sharp: isSharp, width, height, tag, tiles };
    this.#pictures.get(name)?.tiles?.close();
    this.#pictures.set(name, picture);
    for (const [other, { sharp, tiles: its }] of this.#pictures) { // keep only one sharp picture, which may take a hundred megabytes
      if (other === name || !(this.#pictures.size > KEPT || (sharp && picture.sharp))) continue;
      its?.close();
      this.#pictures.delete(other);
    }
    return picture;
  }

  /** The picture's size, also if the project lacks it: that of the bitmap, unless it was scaled down.
   *  @param {string} name; @param {ImageBitmap} bitmap; @returns {Promise<{width?: number, height?: number}>} */
  async #sizeOf(name, bitmap) {
    const known = this.#state.picture(name);
    if (known?.width) return known;
    const isWhole = Math.max(bitmap.width, bitmap.height) < SHOWN_SIZE;
    return isWhole ? bitmap : api.get(api.url("pictures/{name}/landmarks", { name }));
  }
}

/** A picture to fit. `ready` resolves once the server has it; `image` is the displayed copy. */
export class Source {
  started = performance.now();
  #id = null;
  #file = null;
  #image = null;
  #tiles = null;
  #width = 0;
  #height = 0;
  #method = null;
  /** @type {Fit | null} */
  #fit = null;
  #quality = null;
  #ready = Promise.resolve();

  /** `tag` identifies the contents of the file in the folder, which may be replaced; null: the picture is not there. */
  constructor(name, tag = null) {
    this.name = name;
    this.tag = tag;
    this.key = this.ofFolder ? `picture ${name} ${tag}` : `upload ${(uploads += 1)}`;
  }

  get image() { return this.#image; }
  /** Of a large picture; null for others. */
  get tiles() { return this.#tiles; }
  get width() { return this.#width; }
  get height() { return this.#height; }
  /** That was dropped or chosen, if the picture is not in the folder. */
  get file() { return this.#file; }
  get ready() { return this.#ready; }
  /** Quality of the fit with the upload, or null. */
  get quality() { return this.#quality; }
  get isSent() { return this.#id !== null; }

  /** Let the picture be fitted with its upload. */
  fitWith(method) { this.#method = method; }

  /** The fit with the upload, once. */
  takeFit() {
    const fit = this.#fit;
    this.#fit = null;
    return fit;
  }

  /** Send a file, whose picture this is. */
  send(file) {
    this.#file = file;
    this.#ready = this.#upload();
    return this.#ready;
  }

  async #upload() {
    const address = api.url("uploads", { name: this.name, method: this.#method });
    const { id, width, height, fit = null } = await api.upload(address, this.#file);
    this.#id = id;
    this.#width = width; // landmark coordinates refer to the server's size
    this.#height = height;
    this.#fit = fit;
    this.#quality = fit?.quality ?? null;
  }

  /** Show an image; width and height: those of landmark coordinates. */
  show(image, width, height, tiles = null) {
    this.#image = image;
    this.#width = width;
    this.#height = height;
    this.#tiles = tiles;
  }

  close() { this.#tiles?.close(); }
  get ofFolder() { return this.tag !== null; }
  /** @returns {Pick<FitAll, "picture" | "upload">} */
  get reference() { return this.ofFolder ? { picture: this.name } : { upload: this.#id }; }

  /** Address of the picture in a size: its "image" or its "chroma". @param {"image" | "chroma"} what; @param {number} size */
  address(what, size) {
    if (!this.ofFolder) return api.url(`uploads/{id}/${what}`, { id: this.#id, size });
    return api.url(`pictures/{name}/${what}`, { name: this.name, size, tag: this.tag });
  }

  tileAddress(level, column, row) {
    const { name, tag } = this;
    if (!this.ofFolder) return api.url("uploads/{id}/tiles/{level}/{column}/{row}", { id: this.#id, level, column, row });
    return api.url("pictures/{name}/tiles/{level}/{column}/{row}", { name, tag, level, column, row });
  }
}

let uploads = 0;

/** Holds the current source. Events: "taken" before the upload of a file starts, "change" when another source is shown,
 *  "ready" when the server has it, "failed" with the error. */
export class Sources extends EventTarget {
  /** @type {import("./state.js").State} */
  #state;
  /** @type {PictureStore} */
  #pictures;
  #current = null;
  #watchers = new Set(); // the open tabs that show the source
  #chosen = false; // whether a picture of the folder was selected since a file was opened
  #wanted = null; // the newest source, which may be still opening

  /** @param {import("./state.js").State} state; @param {PictureStore} pictures */
  constructor(state, pictures) {
    super();
    this.#state = state;
    this.#pictures = pictures;
    state.addEventListener("select", () => {
      this.#chosen = true;
      this.#follow();
    });
    state.addEventListener("project", () => this.#isUpload || this.#follow());
  }

  get current() { return this.#current; }

  get #isUpload() { return this.#wanted !== null && !this.#wanted.ofFolder; }

  /** A tab that shows the source is opened. Pictures are loaded only while one is open. */
  watch(tab) {
    this.#watchers.add(tab);
    // An opened file stays until a picture of the folder is selected in any tab.
    if (!this.#isUpload || this.#chosen) this.#follow();
  }

  leave(tab) { this.#watchers.delete(tab); }

  backToFolder() {
    this.#leaveFile();
    this.#current = this.#wanted = null;
    this.#follow();
  }

  #follow() {
    const name = this.#state.current;
    if (!this.#watchers.size || !name) return;
    const { tag } = this.#state.picture(name);
    const isShown = (source) => source?.name === name && source.tag === tag;
    if (isShown(this.#current)) this.#wanted = this.#current; // another one may be opening
    else if (!isShown(this.#wanted)) this.#open(name, tag);
  }

  async #open(name, tag) {
    const source = new Source(name, tag);
    this.#wanted = source;
    try {
      const known = this.#state.picture(name);
      if (known.error) throw new Error(known.error);
      const { bitmap, width, height, tiles } = await this.#pictures.fetch(name);
      source.show(bitmap, width, height, tiles);
      if (this.#wanted === source) this.#show(source);
    } catch (error) {
      if (this.#wanted !== source) return;
      this.#wanted = null; // the next change tries it again
      // The strip shows this picture as selected, so the previous one must not stay.
      this.#show(null);
      this.#say("failed", { error: error.message.includes(name) ? error : new Error(`${name}: ${error.message}`) });
    }
  }

  async take(file) {
    const source = new Source(file.name || "pasted picture.png");
    const limit = this.#state.project.limits.upload_bytes;
    const what = `${source.name} has ${megabytes(file.size)}, more than the limit of ${megabytes(limit)}`;
    if (file.size > limit)
      return this.#say("failed", { error: new Error(`${what}: put it into the folder, or make it smaller.`) });
    const before = this.#current;
    this.#wanted = source;
    this.#chosen = false;
    this.#say("taken", { source });
    source.send(file).then(() => this.#current === source && this.#say("ready"), () => {}); // errors are shown below
    const seen = decoded(file).then((image) => {
      if (this.#wanted !== source || !image) return;
      const { width, height } = source.isSent ? source : image; // that of the image until the server answers
      source.show(image, width, height);
      this.#show(source);
    }, () => {}); // formats that the browser cannot decode are shown after the upload
    try {
      await source.ready;
      await seen;
      if (this.#wanted !== source || source.image) return;
      await this.#fetch(source);
      if (this.#wanted === source) this.#show(source);
    } catch (error) {
      if (this.#wanted !== source) return;
      this.#wanted = before;
      if (this.#current === source) this.#show(before); // the browser can show what the server refuses
      this.#say("failed", { error });
    }
  }

  /** Fetch what is shown of an uploaded picture: a copy, and tiles if it is large. */
  async #fetch(source) {
    const { width, height } = source;
    const isTiled = width * height >= TILED_FROM;
    const image = await bitmapOf(source.address("image", isTiled ? SHOWN_SIZE : SHARP_SIZE));
    const tiles = tilesOf((level, column, row) => source.tileAddress(level, column, row), image, width, height);
    source.show(image, width, height, tiles);
  }

  #show(source) {
    if (source !== this.#current) this.#leaveFile();
    this.#current = source;
    this.#say("change");
  }

  /** Free the tiles of a file that is shown; those of the folder's pictures are kept with these. */
  #leaveFile() { if (this.#current?.file) this.#current.close(); }

  #say(type, detail = {}) { this.dispatchEvent(new CustomEvent(type, { detail })); }
}

/** A tab that fits the current source: Fit and Compare. */
export class SourceTab {
  #visible = false;
  #seen; // the source that was shown last
  #number; // of the model that was used last
  /** What is drawn over the picture; a tab makes it. @type {import("./fit-draw.js").Overlays} */
  overlays;

  /** @param {App} app */
  constructor(app) {
    this.app = app;
    this.state = app.state;
    this.sources = app.sources;
  }

  /** Whether the tab is open. */
  get visible() { return this.#visible; }

  // What a tab does:
  /** There is another source, or none. */
  useSource(_source) {}
  /** Show the fit of a source, while the tab is open. */
  showFit(_source) {}
  /** There is another model, or none: earlier fits are out of date. */
  useModel(/** @type {Model | null} */ _model) {}
  /** Show what can be done with the present source and model. */
  offer() {}
  /** The source cannot be shown. */
  refuse(_error) {}

  /** Follow the source and the model, once the page is built. */
  follow() {
    this.sources.addEventListener("change", () => this.followSource());
    this.sources.addEventListener("failed", (/** @type {any} */ { detail }) => this.#visible && this.refuse(detail.error));
    this.state.addEventListener("project", () => this.#followProject());
    this.#followProject();
  }

  show(_options = {}) {
    this.#visible = true;
    this.sources.watch(this);
    this.followSource();
  }

  hide() {
    this.#visible = false;
    this.sources.leave(this);
  }

  /** There may be another source: show it, and its fit if the tab is open. */
  followSource() {
    const source = this.sources.current;
    if (this.#seen !== source) {
      this.#seen = source;
      this.useSource(source);
    }
    this.offer();
    if (source && this.#visible) this.showFit(source);
  }

  #followProject() {
    const { model } = this.state.project;
    const isAnother = this.#number !== (model?.number ?? null);
    this.#number = model?.number ?? null;
    this.overlays.allowContours(Boolean(model?.contours.length));
    this.offer();
    if (isAnother) this.useModel(model);
  }
}

const megabytes = (bytes) => `${(bytes / 1e6).toFixed(0)} MB`;
