// What the list of pictures shows: the state of each picture, and which pictures match. Needs no page.

/** The states of pictures: what the list calls them, and what they mean. */
export const STATES = {
  new: { label: "no points", about: "Nothing is placed yet." },
  unchecked: { label: "mean shape", about: "It was left at the mean shape: no points are saved." },
  partial: { label: "placed", about: "Some points are placed, and others are missing." },
  misfit: { label: "points do not fit", about: "The landmark file does not fit the template, or the picture." },
  proposed: { label: "proposed", about: "The model has placed the points, and they are not accepted yet." },
  doubtful: { label: "doubtful", about: "Proposed, but the model is not sure: look at every point." },
  nothing: { label: "nothing found", about: "The model found nothing here: its points are a guess." },
  mixed: { label: "only proposed", about: "Some points were moved. The others are as the model proposed them, and not accepted yet." },
  done: { label: "done", about: "A person has placed or accepted all points. They are measured, and trained on." },
  slip: { label: "possible slip", about: "Done, but points may be misplaced or exchanged." },
  checked: { label: "checked", about: "Done, and then marked as checked by a person." },
  left: { label: "left out", about: "Left out of training: the model does not use it." },
  reading: { label: "reading…", about: "The file is still being read." },
  broken: { label: "cannot be read", about: "The file is not a picture that can be read." },
};

/** @type {Record<string, {label: string, about: string, has: (picture: Picture, left: Record<string, string>) => boolean}>} */
export const FILTERS = {
  all: { label: "All", about: "All pictures", has: () => true },
  todo: { label: "To do", about: "All that are not done", has: ({ state }) => !["done", "broken", "reading"].includes(state) },
  new: { label: "No points", about: STATES.new.about, has: ({ state }) => state === "new" || state === "unchecked" },
  proposed: { label: "Proposed", about: STATES.proposed.about, has: ({ state, proposed }) => state === "proposed" || proposed > 0 },
  doubtful: { label: "Doubtful", about: STATES.doubtful.about, has: ({ doubtful }) => doubtful },
  done: { label: "Done", about: STATES.done.about, has: ({ state }) => state === "done" },
  slips: { label: "Slips", about: STATES.slip.about, has: ({ slip }) => Boolean(slip) },
  unconfirmed: {
    label: "Unconfirmed", about: "Done, but some points were accepted together, and not placed, moved or confirmed (Y) one by one.",
    has: ({ state, unconfirmed }) => state === "done" && unconfirmed > 0,
  },
  review: { label: "Unchecked", about: "Done, but not marked as checked", has: ({ state, checked }) => state === "done" && !checked },
  checked: { label: "Checked", about: STATES.checked.about, has: ({ checked }) => Boolean(checked) },
  left: { label: "Left out", about: STATES.left.about, has: (picture, left) => Boolean(whyLeftOut(picture, left)) },
  broken: { label: "Unreadable", about: STATES.broken.about, has: ({ state }) => state === "broken" },
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

/** Which of STATES a picture is in. @param {Picture} picture; @param {Record<string, string>} left; @returns {keyof typeof STATES} */
function stateOf(picture, left) {
  const { state, proposed, doubtful, nothing_found: nothing, checked, error, slip } = picture;
  if (slip) return "slip";
  if (state !== "broken" && whyLeftOut(picture, left)) return "left";
  if (state === "partial") return error ? "misfit" : proposed ? "mixed" : "partial";
  if (state === "proposed") return nothing ? "nothing" : doubtful ? "doubtful" : "proposed";
  return state === "done" && checked ? "checked" : state;
}

/** The state of a picture in words. @param {Picture} picture; @param {Record<string, string>} left */
export function describe(picture, left) {
  const state = stateOf(picture, left);
  const { label } = STATES[state];
  const number = { partial: picture.placed, mixed: picture.proposed }[state];
  if (number !== undefined) return `${number} ${label}`;
  return (state === "done" || state === "checked") && picture.absent ? `${label}, ${picture.absent} absent` : label;
}

/** What the state of a picture means. @param {Picture} picture; @param {Record<string, string>} left */
export const meaning = (picture, left) => STATES[stateOf(picture, left)].about;

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
  // Where nothing is found, there may be nothing to correct: doubtful ones come before.
  quality: ({ quality, doubtful, slip, nothing_found: nothing }) => {
    if (slip) return -2;
    if (nothing) return 0;
    return quality == null ? 2 : quality - (doubtful ? 1 : 0);
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
