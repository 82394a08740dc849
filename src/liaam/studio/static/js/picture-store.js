// Pictures that were fetched, the few last ones, and the sharper ones that zooming in asks for.

const SHOWN_SIZE = 2048; // longest side of what is fetched first
const SHARP_SIZE = 8192; // and when zoomed in on a larger picture
const KEPT = 4;

export class PictureStore {
  constructor({ api, state }) {
    this.api = api;
    this.state = state;
    this.pictures = new Map(); // name -> {bitmap, sharp, width, height, tag: of the file that it was made of}
  }

  /** The picture to show: {bitmap, width, height}, with the size that landmarks are told in. */
  async fetch(name) {
    const known = this.pictures.get(name);
    return known && known.tag === this.tag(name) ? known : this.load(name, SHOWN_SIZE);
  }

  tag(name) {
    return this.state.picture(name)?.tag ?? null;
  }

  /** A sharper bitmap where `scale` (screen pixels for one of the picture) asks for one; null where none is needed. */
  async sharper(name, scale) {
    const picture = this.pictures.get(name);
    if (!picture || picture.sharp) return null;
    const shown = picture.bitmap.width / picture.width; // pixels of the bitmap for one of the picture
    if (shown >= 1 || scale < 1.3 * shown) return null;
    picture.sharp = true; // asked for once
    try {
      return (await this.load(name, SHARP_SIZE)).bitmap;
    } catch {
      picture.sharp = false; // what is shown stays; the next zoom tries again
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
      // Of whole pictures, which may be of a hundred megabytes, one is enough.
      if (this.pictures.size > KEPT || (sharp && picture.sharp)) this.pictures.delete(name);
    }
  }
}
