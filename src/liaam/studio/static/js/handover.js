// Unsaved work of a folder, handed as a file to the page of a studio at another address with other browser storage.

import { attempt } from "./unsaved.js";

const KIND = "liaam-studio-unsaved";
const isOf = (folder, key) =>
  key === `liaam-studio:template:${folder}` || key.startsWith(`liaam-studio:unsaved:${folder}:`);

/** The unsaved points and template of a folder as text; "" if there are none. */
export function unsavedWork(storage, folder) {
  const keys = Object.keys(storage).filter((key) => isOf(folder, key));
  const items = Object.fromEntries(keys.map((key) => [key, storage.getItem(key)]));
  return keys.length ? JSON.stringify({ kind: KIND, folder, items }) : "";
}

/** Keep unsaved work of another page in the storage of this one, which a reload restores. Returns the number of items
 *  that were left out, because this page has unsaved work of its own on them. */
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
