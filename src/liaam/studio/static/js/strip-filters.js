// What the list of pictures shows: the state of each picture, and which pictures match. Needs no page.

const STATES = {
  reading: "reading…", new: "no points", unchecked: "mean shape", done: "done", proposed: "proposed",
  broken: "cannot be read",
};

/** @type {Record<string, {label: string, has: (picture: Picture, left: Record<string, string>) => boolean}>} */
export const FILTERS = {
  all: { label: "All", has: () => true },
  todo: { label: "To do", has: ({ state }) => !["done", "broken", "reading"].includes(state) },
  new: { label: "No points", has: ({ state }) => state === "new" || state === "unchecked" },
  proposed: { label: "Proposed", has: ({ state, proposed }) => state === "proposed" || proposed > 0 },
  doubtful: { label: "Doubtful", has: ({ doubtful }) => doubtful },
  done: { label: "Done", has: ({ state }) => state === "done" },
  slips: { label: "Slips", has: ({ slip }) => Boolean(slip) },
  review: { label: "To review", has: ({ state, checked }) => state === "done" && !checked },
  unconfirmed: { label: "Accepted", has: ({ state, unconfirmed }) => state === "done" && unconfirmed > 0 },
  checked: { label: "Checked", has: ({ checked }) => Boolean(checked) },
  left: { label: "Left out", has: (picture, left) => Boolean(whyLeftOut(picture, left)) },
  broken: { label: "Unreadable", has: ({ state }) => state === "broken" },
};

export const ORDERS = { name: "Name", quality: "Quality", uncertainty: "Uncertain" };
export const folderOf = (name) => name.slice(0, Math.max(name.lastIndexOf("/"), 0));
export const isIn = (name, folder) => !folder || name.startsWith(`${folder}/`);
export const baseOf = (name) => name.slice(name.lastIndexOf("/") + 1);

/** Why a picture is not used for training; null if it is. left: reasons of the current model, by name.
 *  @param {Picture} picture; @param {Record<string, string>} left */
export function whyLeftOut({ name, state, left_out: who }, left) {
  return who ? `${who} left it out of training` : (state === "done" && left[name]) || null;
}

/** The state of a picture in words. @param {Picture} picture; @param {Record<string, string>} left */
export function describe(picture, left) {
  const { state, placed, proposed, doubtful, nothing_found: nothing, checked, error, slip, absent } = picture;
  if (slip) return "possible slip";
  if (state !== "broken" && whyLeftOut(picture, left)) return "left out";
  if (state === "partial") return error ? "points do not fit" : proposed ? `${proposed} only proposed` : `${placed} placed`;
  if (state === "proposed" && nothing) return "nothing found";
  if (state === "proposed" && doubtful) return "doubtful";
  const is = checked ? "checked" : (STATES[state] ?? state);
  return state === "done" && absent ? `${is}, ${absent} absent` : is;
}

/** The labels of the subfolders of all pictures, with those between, by name. */
export function foldersOf(pictures) {
  const counts = new Map();
  for (const { name } of pictures)
    for (let folder = folderOf(name); folder; folder = folderOf(folder))
      counts.set(folder, (counts.get(folder) ?? 0) + 1);
  const names = [...counts.keys()].sort((a, b) => a.localeCompare(b, undefined, { numeric: true }));
  return Object.fromEntries(names.map((name) => [name, `${name} (${counts.get(name)})`]));
}

/** Keys to sort by, smallest first. @type {Record<string, (picture: Picture) => number>} */
const KEYS = {
  // Where nothing is found, there is nothing to correct.
  quality: ({ quality, doubtful, slip, nothing_found: nothing }) => {
    if (slip) return -2;
    return quality == null || nothing ? 2 : quality - (doubtful ? 1 : 0);
  },
  uncertainty: ({ uncertainty, doubtful }) => -(uncertainty ?? -1) - (doubtful ? 1e6 : 0),
};

/** The pictures to show, in order. wanted: {text, filter, folder, order}.
 *  @param {Picture[]} pictures; @param {Record<string, string>} wanted; @param {Record<string, string>} left */
export function matching(pictures, { text, filter, folder, order }, left) {
  const { has } = FILTERS[filter];
  const found = pictures.filter(
    (picture) => has(picture, left) && isIn(picture.name, folder) && picture.name.toLowerCase().includes(text),
  );
  const key = KEYS[order];
  return key ? found.sort((a, b) => key(a) - key(b)) : found;
}

/** Pictures with work left: those with a possible slip, and those that are not done. */
export const openIn = (/** @type {Picture[]} */ pictures) =>
  pictures.filter(({ state, slip }) => slip || !["done", "broken", "reading"].includes(state));

/** The names from one to another in a list, both included; only the second if the first is not there. */
export function between(names, first, last) {
  const [from, to] = [names.indexOf(first), names.indexOf(last)];
  return from < 0 ? [last] : names.slice(Math.min(from, to), Math.max(from, to) + 1);
}
