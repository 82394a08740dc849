// The frame of the page: tabs, theme, keys, and the status of training and of the connection.

import { answers, api, ApiError, busy } from "./api.js";
import { IS_TOUCH } from "./annotate-words.js";
import { acceptFiles, createAdding } from "./adding.js";
import { expert } from "./expert.js";
import { chosenKeys, chooseKeys, translate } from "./hotkeys.js";
import { FitStore } from "./fit-run.js";
import { PictureStore, Sources } from "./fit-source.js";
import { unsavedWork } from "./unsaved.js";
import { look } from "./look.js";
import { nameIn, opened, remember, State, tabIn } from "./state.js";
import { createSetList } from "./sets.js";
import { sidesInWords } from "./sides.js";
import { mountStrip } from "./strip.js";
import { STATES } from "./strip-filters.js";
import * as ui from "./ui.js";
import { button, consume, h, iconButton, isPlain, isTyping, press, runKey, toast } from "./ui.js";

const TABS = [
  { name: "annotate", label: "Annotate", what: "Place landmarks with the help of the model" },
  { name: "measure", label: "Measure", what: "Measures of all pictures, and their shapes" },
  { name: "fit", label: "Fit", what: "Fit the model to a picture and change its light" },
  { name: "live", label: "Live", what: "Follow the object in the picture of a camera, or in a video" },
  { name: "compare", label: "Compare", what: "Compare two methods side by side" }, // last, since it may be hidden
];

const COMMON_KEYS = [
  { keys: "[ ] PageUp PageDown", what: "Previous, next picture" },
  { keys: "+ - 0", what: "Zoom in, out, whole picture" },
  { keys: "Space drag", what: "Pan (or drag an empty area, use the middle button or two fingers)" },
  { keys: "Wheel", what: "Zoom at the pointer" },
  { keys: "I D Z", what: "Slide away or show the list of pictures, the panel, both" },
  { keys: "A", what: "Change brightness, contrast and gamma for looking" },
  { keys: "G W", what: "Wall of all pictures (PageUp, PageDown: scroll it; Shift+Enter: accept what is in view); open the worst of them" },
  { keys: "F2 Delete", what: "In the list: rename the picture; remove it from the folder, with undo" },
  { keys: "?", what: "Show these keys, and what the states of pictures mean" },
];

const READ_ONLY = "Nothing can be written in this folder: pictures are shown, fitted, relit and measured. Copy the folder to place landmarks.";
const PANELS = { i: ["strip"], d: ["side"], z: ["strip", "side"] }; // by key
const state = new State();
const tabs = new Map(); // name -> {root, tab, button}
let open = null;
let wanted = null; // tab requested while the page was loading

const pictures = new PictureStore(state);
const app = {
  state, api, ui, toast, confirm: ui.confirm, openTab, pictures,
  /** Whether the open tab shows a picture that is not in the folder. */
  /** The picture that the open tab shows, if it is not in the folder, or null. */
  aside: () => (["fit", "compare"].includes(open) && app.sources.current?.file ? app.sources.current : null),
  showsPictures: () => ["fit", "compare"].includes(open) || state.guest || state.readOnly, sources: new Sources(state, pictures),
  fits: new FitStore(state), adding: null, list: null,
  saved: async () => tabs.get("annotate")?.tab.saved?.(),
  points: () => tabs.get("annotate")?.tab.points ?? [],
};
app.adding = createAdding(app);

/** Hooks for browser tests; the tabs add theirs. */
window.liaamStudio = { app, state };

async function start() {
  waiting();
  for (const { name } of TABS) import(`./${name}.js`).catch(() => {}); // mountTabs reports errors
  try {
    await state.open();
  } catch (error) {
    document.getElementById("loading").textContent = error.message;
    setTimeout(() => location.reload(), 4000);
    return;
  }
  document.getElementById("loading").remove();
  document.getElementById("folder").textContent = state.project.folder;
  document.getElementById("folder").title = state.project.folder;
  document.getElementById("folder").after(createSetList(app));
  if (state.readOnly) document.getElementById("folder").after(h("span.badge.warn", { title: READ_ONLY, testid: "read-only" }, "Read only"));
  document.title = `${[state.project.folder, state.project.set].filter(Boolean).join(" – ")} – liaam studio`;
  look.open(state.project.id);
  app.list = mountStrip(document.getElementById("strip"), app);
  status();
  connection();
  actions();
  await mountTabs();
  followTabs();
  state.addEventListener("project", followTabs);
  expert.addEventListener("change", followTabs);
  acceptFiles(app.adding.take);
  if (!open) openTab(wanted ?? tabIn(location.search) ?? "annotate");
  opened();
  addEventListener("popstate", () => {
    const name = nameIn(location.hash);
    openTab(tabIn(location.search) ?? "annotate");
    if (state.picture(name)) state.select(name);
  });
  document.addEventListener("keydown", keys);
}

async function mountTabs() {
  const bar = document.getElementById("tabs");
  const loaded = TABS.map(async ({ name, label, what }) => {
    const root = h("section", { id: `tab-${name}`, role: "tabpanel", "aria-label": label, hidden: true });
    const chooser = h("button", {
      type: "button", role: "tab", "aria-controls": root.id, "aria-selected": "false", title: what,
      testid: `tab-${name}`, onclick: () => openTab(name),
    }, label);
    bar.append(chooser);
    document.getElementById("stage").append(root);
    const tab = await import(`./${name}.js`).then(({ Tab }) => new Tab(root, app)).catch((error) => {
      console.error(error);
      root.append(h("p.empty.error-text", `This tab failed to load: ${error.message}`));
      return {}; // the other tabs must still work
    });
    return [name, { root, button: chooser, tab }];
  });
  for (const [name, tab] of await Promise.all(loaded)) tabs.set(name, tab);
  bar.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    consume(event);
    const names = shownTabs().map((tab) => tab.name);
    openTab(names[(names.indexOf(open) + step + names.length) % names.length]);
    tabs.get(open).button.focus();
  });
}

/** Whether no picture can be annotated: a guest only fits, and a folder that can only be read gets no first template. */
const onlyFits = () => state.guest || (state.readOnly && !state.project.template);

/** Whether there are two methods to compare, and the person wants to see methods. */
const compares = () => expert.on && (state.project.model?.methods.length ?? 0) > 1;

const isShown = ({ name }) => (name === "annotate" ? !onlyFits() : name !== "compare" || compares());
const shownTabs = () => TABS.filter(isShown);

/** Hide the tabs of which there is no use now. */
function followTabs() {
  for (const tab of TABS) tabs.get(tab.name).button.hidden = !isShown(tab);
  if (open && !isShown({ name: open })) openTab("fit");
}

function openTab(name, options = {}) {
  app.list?.wall.open(false);
  wanted = name;
  if (!tabs.size) return;
  if (!tabs.has(name)) name = "annotate";
  if (!isShown({ name })) name = "fit";
  if (open === name) return tabs.get(name).tab.show?.(options);
  tabs.get(open)?.tab.hide?.();
  open = name;
  for (const [other, { root, button: chooser }] of tabs) {
    const on = other === name;
    root.hidden = !on;
    chooser.setAttribute("aria-selected", String(on));
    chooser.tabIndex = on ? 0 : -1;
  }
  remember({ tab: name });
  tabs.get(name).tab.show?.(options);
  app.list?.mark();
}

function keys(event) {
  if (event.defaultPrevented || isTyping(event) || document.querySelector("dialog[open]")) return;
  if (open === "annotate" && !tabs.get(open).tab.editing) translate(event);
  if (tabs.get(open)?.tab.key?.(event) || (isPlain(event) && commonKey(event)) || isUndo(event)) event.preventDefault();
}

/** Whether a key would undo or redo what was typed in a field that the focus has left, unseen. */
const isUndo = ({ key, ctrlKey, metaKey }) => (ctrlKey || metaKey) && ["z", "y"].includes(key.toLowerCase());

function commonKey(event) {
  const byNumber = shownTabs().map(({ name }, i) => [i + 1, () => openTab(name)]);
  const panels = Object.entries(PANELS).map(([key, names]) => [key, () => window.liaamPanels(names)]);
  const [back, on] = [() => state.step(-1), () => state.step(1)];
  return runKey(event, {
    ...Object.fromEntries([...byNumber, ...panels]), "?": showKeys, "[": back, pageup: back, "]": on, pagedown: on,
    g: () => app.list.wall.toggle(), w: () => app.list.wall.openWorst(),
  });
}

const statesOfPictures = () => h("section", { testid: "states" }, h("h2", "States of pictures"),
  h("dl", Object.values(STATES).map(({ label, about }) => [h("dt", label), h("dd", about)])));

async function showKeys() {
  const table = (title, rows) => h("section", h("h2", title), h("dl", rows.map(({ keys: names, what }) => [
    h("dt", names.split(" ").map((key) => [h("kbd", key), " "])), h("dd", what)])));
  const shown = shownTabs();
  const byNumber = { keys: shown.map((_, i) => i + 1).join(" "), what: shown.map(({ label }) => label).join(", ") };
  const keysOf = ({ shortcuts = [] }) => shortcuts.filter((row) => expert.on || !row.expert);
  const sections = shown.map(({ name, label }) => table(label, keysOf(tabs.get(name).tab)));
  const own = Object.entries(chosenKeys()).map(([letter, command]) => `${letter.toUpperCase()} for ${command.toUpperCase()}`);
  const note = own.length > 0 && h("p.small", `Your own keys in Annotate: ${own.join(", ")}.`);
  const change = { label: "Change keys…", value: "change", testid: "change-keys" };
  const actions = [change, { label: "Close", kind: "primary", value: null }];
  const states = !onlyFits() && statesOfPictures();
  const everywhere = table("Everywhere", [byNumber, ...COMMON_KEYS]);
  const first = IS_TOUCH ? [states, everywhere] : [everywhere, states];
  const asked = await ui.dialog("Keys, and states of pictures", h("div.column", note, h("div.keys", first, sections)), actions, { wide: true });
  if (asked === "change") await chooseKeys(toast);
}

function actions() {
  const theme = window.liaamTheme; // of theme.js
  const face = () => (theme.isDark ? "sun" : "moon");
  const toggle = iconButton("Light or dark", face(), () => theme.toggle(), { testid: "theme" });
  addEventListener("theme", () => toggle.replaceChildren(ui.icon(face())));
  const panel = (name, label, shortcut) => {
    const shower = iconButton(label, name, () => window.liaamPanels([name]), { shortcut, testid: `show-${name}` });
    const show = () => press(shower, document.documentElement.dataset[name] !== "away");
    addEventListener("panels", show);
    show();
    return shower;
  };
  document.getElementById("top-actions").append(
    panel("strip", "List of pictures", "I"), panel("side", "Panel", "D"),
    iconButton("Keys, and states of pictures", "keyboard", showKeys, { shortcut: "?" }), toggle);
}

/** Say above the page that the server is gone, and how to go on. */
function connection() {
  const text = h("span.grow");
  const unsaved = () => unsavedWork(localStorage, state.project.id);
  const save = button("Save unsaved work as a file", {
    icon: "download", small: true, testid: "save-work",
    onclick: () => ui.saveFile(new Blob([unsaved()], { type: "application/json" }), "unsaved-work.json"),
  });
  const notice = h("div.notice", { role: "alert", hidden: true, testid: "connection" }, text, save);
  document.querySelector(".top").append(notice); // over the page, so that nothing moves
  const show = () => {
    notice.hidden = state.online;
    save.hidden = !unsaved();
    const what = state.restarted
      ? "The studio was restarted: open its new address, which it printed in the terminal."
      : "The server is not reachable. If you have started the studio again, open the address that it printed.";
    const more = "Unsaved work is kept in this browser. If the new address has another port, save the work as a " +
      "file, and drop the file on the new page.";
    text.textContent = save.hidden ? what : `${what} ${more}`;
  };
  state.addEventListener("online", show);
  setInterval(() => state.online || show(), 1000); // there may be more unsaved work
}

/** Show a moving line at the top of the page while the user waits. The line has a delay in the style sheet. */
function waiting() {
  const line = h("div.waiting", { role: "progressbar", "aria-label": "Working", hidden: true, testid: "busy" });
  document.body.append(line);
  busy.addEventListener("change", () => { line.hidden = busy.count === 0; });
}

function status() {
  const training = h("span.badge.accent", { hidden: true, testid: "top-training" });
  const saveModel = async () => ui.saveFile(...(await api.file(api.url("model/file"))));
  const model = h("button.badge", { type: "button", testid: "top-model", onclick: saveModel });
  document.getElementById("top-status").append(training, model);
  const show = () => {
    const { training: learning, fitting, model: has } = state.project;
    const { adding } = state;
    const now = adding ?? fitting ?? learning;
    const percent = now.total ? ` ${Math.round((100 * now.done) / now.total)} %` : "…";
    training.hidden = now === learning && learning.state !== "running";
    training.textContent = training.hidden ? "" : `${adding ? "Adding" : fitting ? "Placing points" : "Training"}${percent}`;
    const guest = state.guest;
    model.textContent = guest ? `Fit only: ${has.name}` : has?.source === "face" ? "Face model" : has ? `Model: ${has.n_images} pictures` : "No model yet";
    model.className = has ? "badge good" : "badge";
    model.disabled = !has || guest; // a file that was dropped is there already
    const about = has?.sides ? sidesInWords(has.sides) : "";
    model.title = [about, !model.disabled && "Click to save the model as a file (.liaam)."].filter(Boolean).join(" ");
  };
  let before = null;
  state.addEventListener("training", (/** @type {any} */ { detail }) => {
    show();
    if (detail.state === "failed" && before !== "failed") toast(`Training failed: ${detail.error}`, "bad");
    before = detail.state;
  });
  for (const event of ["project", "fitting"]) state.addEventListener(event, show);
  show();
}

addEventListener("unhandledrejection", (event) => {
  if (event.reason instanceof ApiError) event.preventDefault(); // others are faults of the page, for its console
  if (event.reason?.message) complain(event.reason);
});

answers.addEventListener("good", (/** @type {any} */ { detail }) => ui.settleErrors(detail));

/** Say what failed. If points have to be accepted first, the wall is offered, and the message goes once some are. */
function complain(error) {
  const proposed = error.body?.proposed;
  const close = toast(error, "bad", proposed && { label: "Show them all", onclick: () => app.list.wall.open(true) });
  if (!proposed) return;
  const follow = () => {
    if (!state.project.pictures.some(({ placed }) => placed)) return;
    state.removeEventListener("project", follow);
    close();
  };
  state.addEventListener("project", follow);
}

start();
