// Actions on several pictures of the list, and their undo; and who does them: the name of the person who works here.

import { several } from "./annotate-words.js";
import { removePictures, renamePicture } from "./picture-files.js";
import { saySide } from "./sides.js";
import { button, dialog, h, iconButton, labelsOf, menu } from "./ui.js";

const KEY = "liaam-studio:who";
/** The set of an observer, which is named after the person; "" if the page shows no such set. @param {any} project */
const observerOf = (project) => (project?.set && project.observers.length > 1 ? project.set : "");
const keyOf = (project) => [KEY, observerOf(project)].filter(Boolean).join(":");
/** The name of the person who works here: as entered in this browser, or else in the folder, or that of the observer's
 *  set. @param {any} project */
export const whoAmI = (project) => localStorage.getItem(keyOf(project)) ?? (project?.who || observerOf(project));

/** The name, asked for once if it is needed; "" if it is not given, null if the dialog was closed.
 *  @param {App} app */
async function myName(needed, app) {
  const name = whoAmI(app.state.project);
  return needed && !name && localStorage.getItem(keyOf(app.state.project)) === null ? askName(app) : name;
}

/** Ask for the name, and keep it in the browser and with the folder. @param {App} app */
export async function askName({ api, state }) {
  const { project } = state;
  const input = h("input.text", { maxlength: "60", value: whoAmI(project), "aria-label": "Your name", testid: "who" });
  const why = "The history of each picture says who placed and checked its points. The name is kept with the folder.";
  const actions = [{ label: "Save", kind: "primary", value: "save", testid: "who-save" }];
  if ((await dialog("Your name", h("div.column", why, input), actions)) === null) return null;
  const who = input.value.trim();
  localStorage.setItem(keyOf(project), who);
  await state.send((folder) => api.put(api.url("who"), { who, folder })).catch(() => {}); // the browser has it
  return who;
}

/** By name in the server's log: the label, what was done to so many pictures (in words, and the number), the action that
 *  undoes it, and what that has done, if it is not what that action does otherwise. */
const ACTIONS = {
  checked: { label: "Mark as checked", done: (of) => `${of} marked as checked`, undo: "unchecked" },
  accepted: { label: "Accept proposed points", done: (of, count) => `Points of ${of} accepted: ${count === 1 ? "it is" : "they are"} done`, undo: "deleted", undone: (of) => `Points of ${of} are proposed again, no longer accepted` },
  unchecked: { label: "Mark as not checked", done: (of) => `${of} marked as not checked`, undo: "checked" },
  discarded: { label: "Discard proposed points", done: (of) => `Proposed points of ${of} discarded`, undo: "restored" },
  "left out": { label: "Leave out of training", done: (of) => `${of} left out of training`, undo: "taken in" },
  "taken in": { label: "Use for training", done: (of) => `${of} used for training`, undo: "left out" },
  deleted: { label: "Delete landmarks", done: (of) => `Landmarks of ${of} deleted`, undo: "undeleted" },
  scaled: { done: (_, count) => `Scale set in ${several(count, "further picture")}`, undo: "unscaled" },
  unscaled: { done: (_, count) => `Scale of ${several(count, "further picture")} as before`, undo: "" },
  restored: { done: (of) => `Proposed points of ${of} restored`, undo: "discarded" },
  undeleted: { done: (of) => `Landmarks of ${of} restored`, undo: "deleted" },
};

const pictures = ({ length }) => several(length, "picture");
/** Some pictures, of many the first three. @param {string[]} names */
export const some = (names) => `${names.slice(0, 3).join(", ")}${names.length > 3 ? ` and ${names.length - 3} more` : ""}`;

const doneText = (/** @type {string} */ did, /** @type {string[]} */ names, undoes = "") =>
  (ACTIONS[undoes]?.undone ?? ACTIONS[did].done)(pictures(names), names.length);

/** What an action has done, as a sentence; undoes: the action that it undoes, or "".
 *  @param {string} did; @param {Reviewed} answer; @param {string} undoes */
export function outcome(did, { changed, refused }, undoes = "") {
  const names = Object.keys(refused);
  const reasons = [...new Set(Object.values(refused))].slice(0, 3);
  const because = reasons.map((why) => `${why}${names.length > 1 ? ` (${some(names.filter((name) => refused[name] === why))})` : ""}`);
  const done = changed.length && `${doneText(did, changed, undoes)}.`;
  const not = names.length && `${names.length === 1 ? names[0] : pictures(names)} not changed: ${because.join("; ")}.`;
  return [done, not].filter(Boolean).join(" ");
}

/** Apply an action to pictures, with `more` data; resolves to the names that changed. `undo` is offered with the message,
 *  `undoes` is the action that it undoes.
 *  @param {App} app; @param {string} did; @param {string[]} names;
 *  @param {{more?: Partial<Review>, undo?: any, undoes?: string}} options */
export async function act(app, did, names, { more = {}, undo = null, undoes = "" } = {}) {
  const { state, api, toast, saved } = app;
  await saved(); // points that were just moved, or the action would be a change elsewhere to them
  const who = await myName(did === "checked", app);
  if (who === null) return [];
  /** @type {Review} */
  const asked = { pictures: names, did, who };
  const answer = await state.send((folder) => api.post(api.url("review"), { ...asked, ...more, folder }));
  toast(outcome(did, answer, undoes), answer.changed.length ? "good" : "info", answer.changed.length > 0 && undo && { label: "Undo", onclick: () => undo(answer.changed) });
  await state.refresh();
  return answer.changed;
}

/** The bar of actions; chosen() -> names; onall(): choose all; onend(): choose none; ondone(): after an action.
 *  @param {{app: App, chosen: () => string[], onall: () => any, onend: () => any, ondone: () => any}} options */
export function createBulk({ app, chosen, onall, onend, ondone }) {
  let last = null; // {undo()}: takes the last action back
  const count = h("span.small.grow", { "aria-live": "polite" });
  const ofFiles = {
    rename: () => renamePicture(app, chosen()[0]), remove: () => removePictures(app, chosen()),
  };
  const ofSides = { left: "left", right: "right", noSide: "" };
  const sides = { left: "Left side of the object", right: "Right side", noSide: "Side by name or shape" };
  const labels = { ...labelsOf(ACTIONS), ...sides, rename: "Rename…", remove: "Remove from the folder" };
  const choice = menu("Action…", labels, async (did) => {
    if (did in ofFiles) return changeFiles(ofFiles[did]);
    if (did in ofSides) return saySide(app, chosen(), ofSides[did]);
    if (did !== "deleted" || (await mayDelete(chosen()))) await run(did, chosen());
    return undefined;
  }, { "aria-label": "Action on the selected pictures", testid: "bulk-action" });
  const takeBack = (did) => ACTIONS[did].undo && ((names) => run(ACTIONS[did].undo, names, { undoes: did }));
  const undo = iconButton("Undo", "undo", () => last.undo(), {
    kind: "", small: true, disabled: true, testid: "bulk-undo",
  });
  const small = (label, onclick, testid) => button(label, { small: true, kind: "ghost", onclick, testid });
  const element = h("div.strip-bulk", { hidden: true },
    h("div.row", count, small("All", onall, "bulk-all"), small("Done", onend, "bulk-end")),
    h("div.row", choice, undo));

  function mayDelete(names) {
    const some = names.map((name) => app.state.picture(name)).filter((one) => one?.placed || one?.state === "reading");
    const text = `The landmarks of ${pictures(some)} will be deleted. Undo brings them back.`;
    return !some.length || app.confirm("Delete landmarks?", text, "Delete");
  }

  /** Apply an action; takesBack(names) undoes it, and `more` and `undoes` are those of `act`. Resolves to the names that changed.
   *  @param {string} did; @param {string[]} names; @param {{more?: Partial<Review>, undo?: any, undoes?: string}} options */
  async function run(did, names, { more = {}, undo: takesBack = takeBack(did), undoes = "" } = {}) {
    const changed = await act(app, did, names, { more, undo: takesBack, undoes });
    ondone();
    if (!changed.length) return changed;
    last = { undo: () => takesBack(changed) };
    undo.disabled = !takesBack;
    undo.title = `Undo: ${doneText(did, changed, undoes)}`;
    return changed;
  }

  /** Remove or rename pictures by work(), which resolves to whether that was done. */
  async function changeFiles(work) {
    if (await work()) onend(); // the selected names are gone; the message offers to undo it
  }

  const show = (on) => {
    element.hidden = !on;
    count.textContent = `${chosen().length} selected`;
    choice.disabled = !chosen().length;
  };
  return { element, run, show, changeFiles };
}
