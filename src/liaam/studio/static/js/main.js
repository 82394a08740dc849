// The frame of the page: tabs, theme, keys, and the status of training and of the connection.

import { nameIn, opened, remember, tabIn } from "./address.js";
import { api, ApiError, busy } from "./api.js";
import { acceptFiles } from "./drops.js";
import { isGuest, openModel } from "./fit-only.js";
import { sourcesOf } from "./fit-source.js";
import { look } from "./look.js";
import { takeWork, unsavedWork } from "./handover.js";
import { State } from "./state.js";
import { mountStrip } from "./strip.js";
import * as ui from "./ui.js";
import { button, dialog, h, isTyping, toast } from "./ui.js";

const TABS = [
  { name: "annotate", label: "Annotate", what: "Place landmarks with the help of the model" },
  { name: "fit", label: "Fit", what: "Fit the model to a picture and change its light" },
  { name: "compare", label: "Compare", what: "Compare two methods side by side" },
  { name: "live", label: "Live", what: "Follow the object in the picture of a camera, or in a video" },
];

const COMMON_KEYS = [
  { keys: "1 2 3 4", what: "Annotate, Fit, Compare, Live" },
  { keys: "[ ]", what: "Previous, next picture" },
  { keys: "+ - 0", what: "Zoom in, out, whole picture" },
  { keys: "Space drag", what: "Pan (or drag an empty area, use the middle button or two fingers)" },
  { keys: "Wheel", what: "Zoom at the pointer" },
  { keys: "I D Z", what: "Slide away or show the list of pictures, the panel, both" },
  { keys: "A", what: "Change brightness, contrast and gamma for looking" },
  { keys: "?", what: "Show these keys" },
];

const PANELS = { i: ["strip"], d: ["side"], z: ["strip", "side"] }; // by key

const state = new State();
const tabs = new Map(); // name -> {root, tab, button}
let open = null;
let wanted = null; // tab requested while the page was loading

const app = { state, api, ui, toast, confirm: ui.confirm, openTab, take };

/** Hooks for browser tests; the tabs add theirs. */
window.liaamStudio = { app, state };

async function start() {
  waiting();
  for (const { name } of TABS) import(`./${name}.js`).catch(() => {}); // load fetches them again and reports errors
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
  document.title = `${state.project.folder} – liaam studio`;
  look.open(state.project.id);
  mountStrip(document.getElementById("strip"), app);
  status();
  connection();
  actions();
  await mountTabs();
  followGuest();
  state.addEventListener("project", followGuest);
  acceptFiles(take);
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
  const stage = document.getElementById("stage");
  const loaded = TABS.map(async ({ name, label, what }) => {
    const root = h("section", { id: `tab-${name}`, role: "tabpanel", "aria-label": label, hidden: true });
    const chooser = h("button", {
      type: "button", role: "tab", "aria-controls": root.id, "aria-selected": "false", title: what,
      dataset: { testid: `tab-${name}` }, onclick: () => openTab(name),
    }, label);
    bar.append(chooser);
    stage.append(root);
    return [name, { root, button: chooser, tab: await load(name, root) }];
  });
  for (const [name, tab] of await Promise.all(loaded)) tabs.set(name, tab);
  bar.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    event.stopPropagation();
    const names = TABS.map((tab) => tab.name);
    openTab(names[(names.indexOf(open) + step + names.length) % names.length]);
    tabs.get(open).button.focus();
  });
}

/** A guest only fits, so the tab Annotate is hidden. */
function followGuest() {
  const guest = isGuest(state.project);
  tabs.get("annotate").button.hidden = guest;
  if (guest && open === "annotate") openTab("fit");
}

async function load(name, root) {
  try {
    return (await import(`./${name}.js`)).mount(root, app);
  } catch (error) { // the other tabs must still work
    console.error(error);
    root.append(h("p", { class: "empty error-text" }, `This tab failed to load: ${error.message}`));
    return { show() {}, hide() {}, shortcuts: [] };
  }
}

function openTab(name, options = {}) {
  if (!tabs.size) {
    wanted = name;
    return;
  }
  if (!tabs.has(name)) name = "annotate";
  if (name === "annotate" && isGuest(state.project)) name = "fit";
  if (open === name) {
    tabs.get(name).tab.show?.(options);
    return;
  }
  if (open) {
    tabs.get(open).tab.hide?.();
    tabs.get(open).root.hidden = true;
  }
  open = name;
  for (const [other, { root, button: chooser }] of tabs) {
    const on = other === name;
    root.hidden = !on;
    chooser.setAttribute("aria-selected", String(on));
    chooser.tabIndex = on ? 0 : -1;
  }
  remember({ tab: name });
  tabs.get(name).tab.show?.(options);
}

function keys(event) {
  if (event.defaultPrevented || isTyping(event) || document.querySelector("dialog[open]")) return;
  const plain = !event.ctrlKey && !event.metaKey && !event.altKey;
  if (tabs.get(open)?.tab.key?.(event)) {
    event.preventDefault();
    return;
  }
  if (!plain) return;
  const number = Number(event.key);
  if (event.key === "?") showKeys();
  else if (number >= 1 && number <= TABS.length) openTab(TABS[number - 1].name);
  else if (PANELS[event.key.toLowerCase()]) window.liaamPanels(PANELS[event.key.toLowerCase()]);
  else if (event.key === "[" || event.key === "PageUp") state.step(-1);
  else if (event.key === "]" || event.key === "PageDown") state.step(1);
  else return;
  event.preventDefault();
}

async function showKeys() {
  const table = (title, rows) => h("section", {}, h("h2", {}, title), h("dl", {}, rows.map(({ keys: names, what }) => [
    h("dt", {}, names.split(" ").map((key) => [h("kbd", {}, key), " "])), h("dd", {}, what)])));
  const sections = [...tabs].filter(([, { tab }]) => tab.shortcuts?.length)
    .map(([name, { tab }]) => table(TABS.find((each) => each.name === name).label, tab.shortcuts));
  const body = h("div", { class: "keys" }, table("Everywhere", COMMON_KEYS), sections);
  const choice = await dialog("Keys", body, [
    { label: "Open unsaved work…", kind: "ghost", value: "work" }, { label: "Close", kind: "primary", value: null }], { wide: true });
  if (choice !== "work") return;
  const input = h("input", { type: "file", accept: ".json", onchange: () => restore(input.files[0]) });
  input.click();
}

function actions() {
  const theme = window.liaamTheme; // of theme.js
  const face = () => (theme.isDark ? "sun" : "moon");
  const toggle = button("Light or dark", {
    icon: face(), iconOnly: true, kind: "ghost", testid: "theme", onclick: () => theme.toggle(),
  });
  addEventListener("theme", () => toggle.replaceChildren(ui.icon(face())));
  const panels = [["strip", "List of pictures", "I"], ["side", "Panel", "D"]].map(([name, label, shortcut]) =>
    button(label, {
      icon: name, iconOnly: true, kind: "ghost", shortcut, testid: `show-${name}`,
      onclick: () => window.liaamPanels([name]),
    }));
  const press = () => panels.forEach((each) => {
    each.setAttribute("aria-pressed", String(document.documentElement.dataset[each.dataset.testid.slice(5)] !== "away"));
  });
  addEventListener("panels", press);
  press();
  document.getElementById("top-actions").append(
    ...panels,
    button("Keys", { icon: "keyboard", iconOnly: true, kind: "ghost", shortcut: "?", onclick: showKeys }),
    toggle,
  );
}

/** A file was dropped or pasted: fit the picture, follow the video, use the model, or take over unsaved work. */
function take(file) {
  if (file.type.startsWith("video/")) return openTab("live", { file });
  if (/\.json$/i.test(file.name)) return restore(file);
  if (/\.liaam$/i.test(file.name)) return openModel(app, file).catch((error) => toast(error, "bad"));
  if (open === "annotate") openTab("fit");
  return sourcesOf(app).take(file);
}

async function restore(file) {
  try {
    const left = takeWork(localStorage, state.project.id, await file.text(), file.name);
    if (left) toast(`${left} of the items in ${file.name} were left out: this page has unsaved work on them, too.`, "bad");
    else location.reload();
  } catch (error) {
    toast(error, "bad");
  }
}

/** Say above the page that the server is gone, and how to go on. */
function connection() {
  const text = h("span", { class: "grow" });
  const unsaved = () => unsavedWork(localStorage, state.project.id);
  const save = button("Save unsaved work as a file", {
    icon: "download", small: true, testid: "save-work",
    onclick: () => ui.saveFile(new Blob([unsaved()], { type: "application/json" }), "unsaved-work.json"),
  });
  const notice = h("div", { class: "notice", role: "alert", hidden: true, dataset: { testid: "connection" } }, text, save);
  document.querySelector(".top").append(notice); // over the page, so that nothing moves
  const show = () => {
    notice.hidden = state.online;
    save.hidden = !unsaved();
    const what = state.restarted
      ? "The studio was restarted: open its new address, which it printed in the terminal."
      : "The server is not reachable. If you have started the studio again, open the address that it printed.";
    const more = "Unsaved work is kept in this browser. If the new address has another port, save the work as a file, and drop the file on the new page.";
    text.textContent = save.hidden ? what : `${what} ${more}`;
  };
  state.addEventListener("online", show);
  setInterval(() => state.online || show(), 1000); // there may be more unsaved work
}

/** Show a moving line at the top of the page while the user waits. The line has a delay in the style sheet. */
function waiting() {
  const line = h("div", { class: "waiting", role: "progressbar", "aria-label": "Working", hidden: true, dataset: { testid: "busy" } });
  document.body.append(line);
  busy.addEventListener("change", () => { line.hidden = busy.count === 0; });
}

// Status in the top bar: the model and training.

function status() {
  const box = document.getElementById("top-status");
  const training = h("span", { class: "badge accent", hidden: true, dataset: { testid: "top-training" } });
  const model = h("span", { class: "badge", dataset: { testid: "top-model" } });
  box.append(training, model);
  const show = () => {
    const { training: now, model: has } = state.project;
    training.hidden = now?.state !== "running";
    if (now?.state === "running") {
      const percent = now.total ? ` ${Math.round((100 * now.done) / now.total)} %` : "…";
      training.textContent = `${now.phase === "proposals" ? "Placing points" : "Training"}${percent}`;
    }
    const guest = isGuest(state.project);
    model.textContent = guest ? `Fit only: ${has.name}` : has ? `Model: ${has.n_images} pictures` : "No model yet";
    model.className = has ? "badge good" : "badge";
  };
  let before = null;
  state.addEventListener("training", (/** @type {any} */ { detail }) => {
    show();
    if (detail.state === "failed" && before !== "failed") toast(`Training failed: ${detail.error}`, "bad");
    before = detail.state;
  });
  state.addEventListener("project", show);
  show();
}

addEventListener("unhandledrejection", (event) => {
  if (!(event.reason instanceof ApiError)) return;
  event.preventDefault();
  toast(event.reason.message, "bad");
});

start();
