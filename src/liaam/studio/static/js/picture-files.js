// Removing pictures from the folder and renaming them, with undo.

import { several } from "./annotate-words.js";
import { dialog, h } from "./ui.js";

/** The picture to show once others are removed: the next that stays, or else the one before. */
function nextAfter(state, names) {
  const { order, current } = state;
  const at = order.indexOf(current);
  const stays = (name) => !names.includes(name);
  return order.slice(at + 1).find(stays) ?? order.slice(0, Math.max(at, 0)).findLast(stays) ?? null;
}

/** Bring removed pictures back. @param {App} app */
async function restore({ state, api, toast }, token) {
  const { pictures } = await state.changeFiles((folder) => api.post(api.url("restored"), { token, folder }));
  toast(`${several(pictures.length, "picture")} restored.`, "good");
  state.select(pictures[0]);
}

/** Remove pictures and their landmarks; resolves to whether that was done. @param {App} app */
export async function removePictures(app, names) {
  const { state, api, toast, saved } = app;
  if (!names.length) return false;
  await saved();
  const next = nextAfter(state, names);
  const { token } = await state.changeFiles((folder) => api.post(api.url("removed"), { pictures: names, folder }), () => {
    if (names.includes(state.current)) state.select(next);
  });
  const what = names.length === 1 ? names[0] : several(names.length, "picture");
  toast(`${what} removed from the folder, with the landmarks.`, "good", { label: "Undo", onclick: () => restore(app, token) });
  return true;
}

/** Rename a picture; resolves to its name. @param {App} app */
async function renameTo(app, name, wanted) {
  const { state, api, saved } = app;
  await saved();
  const answer = await state.changeFiles(
    (folder) => api.post(api.url("renamed"), { picture: name, to: wanted, folder }),
    ({ name: now }) => state.renamed(name, now),
  );
  return answer.name;
}

const stemOf = (name) => name.replace(/^.*\//, "").replace(/\.[^.]*$/, "");

/** Ask for the new name of a picture, and rename it. @param {App} app */
export async function renamePicture(app, name) {
  const field = h("input.text", {
    required: true, maxlength: "100", value: stemOf(name), autocomplete: "off", spellcheck: "false", "aria-label": "New name", testid: "rename",
  });
  const body = h("div.column", h("label.field", "New name; the landmarks and the history go along", field));
  let now = name;
  const work = async () => { if (field.value !== stemOf(name)) now = await renameTo(app, name, field.value); };
  const actions = [{ label: "Cancel", value: null }, { label: "Rename", kind: "primary", value: "rename", checks: true, work, testid: "rename-done" }];
  if ((await dialog(`Rename ${name}`, body, actions)) !== "rename" || now === name) return false;
  app.toast(`${name} is now ${now}.`, "good", { label: "Undo", onclick: () => renameTo(app, now, stemOf(name)) });
  return true;
}
