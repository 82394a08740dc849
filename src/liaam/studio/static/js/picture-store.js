// A cache of the last few pictures, which are fetched at a higher resolution for zooming in.

import { api } from "./api.js";

export const SHOWN_SIZE = 2048; // longest side at first
const SHARP_SIZE = 8192; // longest side after zooming in
const KEPT = 4;

export async function bitmapOf(address) {
  const blob = await api.blob(address);
  return createImageBitmap(blob).catch(() => {
    throw new Error("The browser cannot show this picture: reload the page.");
  });
}

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
    const { tag } = this.state.picture(name);
    const bitmap = await bitmapOf(api.url("pictures", name, "image", { size, tag }));
    const { width, height } = await this.sizeOf(name, bitmap);
    const picture = { bitmap, sharp: size > SHOWN_SIZE, width, height, tag };
    this.pictures.set(name, picture);
    for (const [other, { sharp }] of this.pictures) // keep only one sharp picture, which may take a hundred megabytes
      if (other !== name && (this.pictures.size > KEPT || (sharp && picture.sharp))) this.pictures.delete(other);
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
