// A cache of the last few pictures, which are fetched at a higher resolution for zooming in.

const SHOWN_SIZE = 2048; // longest side at first
const SHARP_SIZE = 8192; // longest side after zooming in
const KEPT = 4;

export class PictureStore {
  constructor({ api, state }) {
    this.api = api;
    this.state = state;
    this.pictures = new Map(); // name -> {bitmap, sharp, width, height, tag: of the file}
  }

  /** Fetch a picture: {bitmap, width, height}, with the size of landmark coordinates. */
  async fetch(name) {
    const known = this.pictures.get(name);
    return known && known.tag === this.tag(name) ? known : this.load(name, SHOWN_SIZE);
  }

  tag(name) {
    return this.state.picture(name)?.tag ?? null;
  }

  /** Fetch a sharper bitmap if `scale` (screen pixels per picture pixel) needs one; null otherwise. */
  async sharper(name, scale) {
    const picture = this.pictures.get(name);
    if (!picture || picture.sharp) return null;
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
    const tag = this.tag(name);
    const blob = await this.api.blob(this.api.url("pictures", name, "image", { size, tag }));
    const bitmap = await createImageBitmap(blob);
    const { width, height } = this.state.picture(name) ?? {};
    const sharp = size > SHOWN_SIZE;
    const picture = { bitmap, sharp, width: width ?? bitmap.width, height: height ?? bitmap.height, tag };
    this.pictures.set(name, picture);
    this.forget(name);
    return picture;
  }

  forget(newest) {
    const sharp = this.pictures.get(newest).sharp;
    for (const [name, picture] of this.pictures) {
      if (name === newest) continue;
      // Keep only one sharp picture, which may take a hundred megabytes.
      if (this.pictures.size > KEPT || (sharp && picture.sharp)) this.pictures.delete(name);
    }
  }
}
