// Elements and controls shared by all tabs.

import { ICONS } from "../vendor/lucide/lucide.js";

/** Create an element: h("p.small.muted", "text") or h("button.wide", {onclick: f, "aria-label": "…", testid: "x"},
 *  "text", child). Attributes that are null or false, and such children, are left out.
 *  @param {string} tag; @param {...any} rest; @returns {any} */
export function h(tag, ...rest) {
  const [name, ...classes] = tag.split(".");
  const element = document.createElement(name);
  const props = rest[0]?.constructor === Object ? rest.shift() : {};
  for (const [key, value] of Object.entries(props)) {
    if (value == null || value === false) continue;
    if (key === "class") classes.push(value);
    else if (key === "testid") element.dataset.testid = value;
    else if (key === "dataset") Object.assign(element.dataset, value);
    else if (key === "style" && typeof value === "object") Object.assign(element.style, value);
    else if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (key in element && typeof value !== "string" && !key.startsWith("aria")) element[key] = value;
    else element.setAttribute(key, value === true ? "" : String(value));
  }
  if (classes.length) element.className = classes.filter(Boolean).join(" ");
  element.append(...rest.flat(Infinity).filter((child) => child != null && child !== false));
  return element;
}

export function svg(tag, attributes, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, String(value));
  element.append(...children);
  return element;
}

export const icon = (name, size = 16) =>
  svg("svg", {
    viewBox: "0 0 24 24", width: size, height: size, fill: "none", stroke: "currentColor",
    "stroke-width": 2, "stroke-linecap": "round", "stroke-linejoin": "round", "aria-hidden": "true",
  }, ...ICONS[name].map(([tag, attributes]) => svg(tag, attributes)));

/** A button. kind: "primary", "danger", "ghost"; small; pressed: true or false for toggles; iconOnly: show the label
 *  only to screen readers and in the tooltip; shortcut: shown in the tooltip; testid.
 *  @param {string} label; @param {Record<string, any>} options; @returns {HTMLButtonElement} */
export function button(label, options = {}) {
  const { icon: picture, kind = "", shortcut, small, pressed, iconOnly, disabled, title, ...others } = options;
  return h("button.button", {
    type: "button", class: [kind, small && "small", iconOnly && "icon-only"].filter(Boolean).join(" "),
    disabled, "aria-pressed": pressed == null ? null : String(pressed),
    "aria-label": iconOnly ? label : null, "aria-keyshortcuts": shortcut,
    title: [title ?? (iconOnly ? label : ""), shortcut && `(${shortcut})`].filter(Boolean).join(" ") || null,
    ...others,
  }, picture && icon(picture), !iconOnly && label);
}

export const listOf = (lines) => h("ul.assist-lines", lines.map((line) => h("li", line)));

export const iconButton = (label, picture, onclick, options = {}) =>
  button(label, { icon: picture, iconOnly: true, kind: "ghost", onclick, ...options });

export const press = (toggle, on) => toggle.setAttribute("aria-pressed", String(on));

/** The event needs no further handling, neither by the page nor by the browser. */
export function consume(event) {
  event.preventDefault();
  event.stopPropagation();
}

export const labelsOf = (table) =>
  Object.fromEntries(Object.entries(table).filter(([, { label }]) => label).map(([name, { label }]) => [name, label]));

export const optionsOf = (labels) => Object.entries(labels).map(([value, label]) => h("option", { value }, label));

/** Show options and the chosen one in a list. If they are the same, they stay, since the list may be open. */
export function relist(list, labels, value) {
  const next = h("select", optionsOf(labels));
  if (next.innerHTML !== list.innerHTML) list.replaceChildren(...next.children);
  list.value = value;
}

/** Whether a key chooses in a closed list without opening it. */
export const isChoosing = ({ key, ctrlKey, metaKey, altKey }) => {
  if (ctrlKey || metaKey || altKey) return false;
  return key.length === 1 || /^(Arrow|Page)/.test(key) || ["Home", "End", "Enter"].includes(key);
};

/** A list of actions under a title; onchoose(value). */
export function menu(title, labels, onchoose, attributes = {}) {
  const onchange = () => {
    const { value } = list;
    list.value = "";
    onchoose(value);
  };
  // What a key chooses would be done at once, so that it opens the list instead, where the browser lets it.
  const onkeydown = (event) => {
    if (!list.showPicker || !isChoosing(event)) return;
    consume(event);
    list.showPicker();
  };
  const list = h("select.text", { onchange, onkeydown, ...attributes }, h("option", { value: "" }, title), optionsOf(labels));
  return list;
}

export const slider = (attributes) => h("input.slider", { type: "range", ...attributes });

/** A slider with its label and its value in words: {element, show(value, words)}; onvalue(number). */
export function labelledSlider(label, onvalue, { class: name = null, title = null, ...attributes }) {
  const input = slider({ ...attributes, oninput: () => onvalue(Number(input.value)) });
  const text = h("span.number");
  const show = (value, words) => {
    input.value = String(value);
    text.textContent = words;
    input.setAttribute("aria-valuetext", words);
  };
  return { element: h("label", { class: name, title }, h("span", label), input, text), show };
}

/** A hidden field for a file, which is opened by its click(); onfile(file, all). */
export function fileField(onfile, attributes = {}) {
  const onchange = () => field.files[0] && onfile(field.files[0], [...field.files]);
  const onclick = () => { field.value = ""; }; // so that the same file can be chosen again
  const field = h("input.visually-hidden", { type: "file", tabindex: "-1", onclick, onchange, ...attributes });
  return field;
}

/** A row of radio buttons: [{value, label, title}]; their test ids start with testid. Returns {element, value}. */
export function segmented(label, choices, value, onchange, testid = null) {
  const inputs = choices.map(({ value: own, label: text, title }) => h("input", {
    type: "radio", name: label, value: own, checked: own === value, title, "aria-label": text,
    testid: testid && `${testid}-${own}`, onchange: () => onchange(own),
  }));
  const onkeydown = (event) => event.key.startsWith("Arrow") && event.stopPropagation(); // they choose
  return {
    element: h("div.segmented", { role: "radiogroup", "aria-label": label, onkeydown }, inputs),
    get value() { return inputs.find(({ checked }) => checked).value; },
    set value(next) { for (const each of inputs) each.checked = each.value === next; },
  };
}

/** A slider's handle that is dragged, onmove(event), or moved with keys, onkey(event) -> whether it was one for it. */
export function grip(tag, { onmove, onkey, ...attributes }, ...children) {
  const element = h(tag, {
    role: "slider", tabindex: "0", ...attributes, onkeydown: (event) => onkey(event) && consume(event),
    onpointerdown: (event) => {
      if (event.button !== 0) return;
      element.setPointerCapture(event.pointerId);
      element.focus({ preventScroll: true });
      event.preventDefault();
    },
    onpointermove: (event) => element.hasPointerCapture(event.pointerId) && onmove(event),
  }, children);
  return element;
}

const FIELDS = "input:not([type=hidden], [type=checkbox], [type=radio], [type=file]):enabled, textarea:enabled";

/** Open a modal dialog, with the focus in its first field, or else on its main button; actions: [{label, kind, value, testid,
 *  checks: whether its fields must be valid, work: what is done before it closes; an error is said in the dialog, which stays}]; body:
 *  element or text. Resolves to the value of the chosen action, or null if the dialog was closed. */
export function dialog(title, body, actions = [{ label: "Close", value: null }], { wide = false, undecided = false } = {}) {
  return new Promise((resolve) => {
    let chosen = null;
    const fault = h("p.error-text.small", { role: "alert", hidden: true, testid: "dialog-fault" });
    const say = (text) => {
      fault.hidden = !text;
      fault.textContent = text;
    };
    let isWorking = false;
    const close = async (value, { checks = false, work = null } = {}) => {
      if (isWorking || (checks && !content.reportValidity())) return;
      isWorking = true;
      say("");
      const wrong = work && (await work().then(() => null, (error) => error));
      isWorking = false;
      if (wrong) return void say(wrong.message);
      chosen = value;
      box.close();
    };
    const onsubmit = (event) => { // by Enter in a field
      event.preventDefault();
      foot.querySelector(".primary")?.click();
    };
    const content = h("form.dialog-body", { onsubmit }, typeof body === "string" ? h("p", body) : body);
    const foot = h("div.dialog-foot",
      actions.map(({ label, value, checks, work, ...more }) =>
        button(label, { ...more, onclick: () => close(value, { checks, work }) })));
    const head = h("div.dialog-head", h("h2", { id: "dialog-title" }, title),
      iconButton("Close", "close", () => close(null), { small: true }));
    const box = h("dialog.dialog", {
      tabindex: "-1", class: wide && "wide", "aria-labelledby": "dialog-title", onclose: () => { box.remove(); resolve(chosen); },
      onkeydown: (event) => event.stopPropagation(), // do not trigger keys of the page behind the dialog
    }, head, content, fault, foot);
    document.body.append(box);
    box.showModal();
    // A field is there to be filled in. Show the beginning of a long body, regardless of the focus.
    const field = /** @type {any} */ (content.querySelector(FIELDS));
    const first = undecided ? box : (field ?? foot.querySelector(".primary") ?? foot.querySelector("button"));
    first?.focus({ preventScroll: true });
    if (first === field) field?.select?.();
    box.scrollTop = content.scrollTop = 0;
  });
}

export async function confirm(title, text, action, kind = "danger") {
  const actions = [{ label: "Cancel", value: false }, { label: action, kind, value: true, testid: "confirm" }];
  return (await dialog(title, text, actions)) === true;
}

/** Save files, [blob, name] each, and say so; note: what is said after the names. */
export function saveFiles(files, note = "") {
  for (const [blob, name] of files) download(blob, name);
  if (files.length) toast(`Saved ${files.map(([, name]) => name).join(", ")}${note}`, "good");
}

/** @param {Blob} blob; @param {string} name; @param {string} note */
export const saveFile = (blob, name, note = "") => saveFiles([[blob, name]], note);

function download(blob, name) {
  const address = URL.createObjectURL(blob);
  const link = h("a", { href: address, download: name });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(address), 60_000); // the browser may not have read it yet
}

const TOASTS = 2; // at a time, since they lie over the picture

/** How much a message must stay: an error most of all. @param {Element} item */
const weight = (item) => (item.matches(".bad") ? 2 : item.querySelector("[data-testid=toast-action]") ? 1 : 0);

/** Remove errors about what now has succeeded. @param {string} about as of an ApiError */
export function settleErrors(about) {
  for (const item of /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll(".toast[data-about]"))) if (item.dataset.about === about) item.remove();
}

/** Show a message; errors stay until they are closed, or what failed has succeeded. `action`: {label, onclick}. Returns
 *  what removes it. */
export function toast(message, kind = "info", action = null) {
  if (message?.unreachable) return () => {}; // the notice above the page says so
  const box = document.getElementById("toasts");
  const text = message instanceof Error ? message.message : String(message);
  for (const other of box.querySelectorAll(".toast")) if (other.firstChild.textContent === text) other.remove();
  const remove = () => item.remove();
  const item = h("div.toast", { class: kind, role: kind === "bad" ? "alert" : null, dataset: message?.about ? { about: message.about } : {} }, h("span.grow", text),
    action && button(action.label, { small: true, testid: "toast-action", onclick: () => { remove(); action.onclick(); } }),
    iconButton("Dismiss", "close", remove, { small: true }));
  box.append(item);
  while (box.children.length > TOASTS) {
    const others = [...box.children].filter((other) => other !== item);
    others.reduce((least, other) => (weight(other) < weight(least) ? other : least)).remove();
  }
  if (kind !== "bad" && !action?.stays) setTimeout(remove, action ? 10_000 : 5000);
  return remove;
}

/** A function that shows an error until it is called with another text, or with "". */
export function complaints(show = toast) {
  let shown = { text: "", close() {} };
  return (text) => {
    if (text === shown.text) return;
    shown.close();
    shown = { text, close: text ? show(text, "bad") : () => {} };
  };
}

/** Whether a key has no modifier but Shift, and is not the Enter that a button needs. */
export const isPlain = ({ key, ctrlKey, metaKey, altKey, target }) =>
  !ctrlKey && !metaKey && !altKey && !(key === "Enter" && target.matches?.("button, a"));

export function runKey({ key }, actions) {
  const action = actions[key.toLowerCase()];
  action?.();
  return Boolean(action);
}

const TYPED = "textarea, select, input:not([type=range], [type=checkbox], [type=radio], [type=button])";

export const isTyping = ({ target }) =>
  target instanceof HTMLElement && (target.isContentEditable || target.matches(TYPED));

/** Call a function at most once per frame, with the newest arguments. */
export function perFrame(work) {
  let waiting = null;
  return (...args) => {
    if (waiting === null) requestAnimationFrame(() => { const newest = waiting; waiting = null; work(...newest); });
    waiting = args;
  };
}

const GAP = 400; // milliseconds without a frame after which another drag begins

/** Frames per second of the `most` newest frames of one drag; gap: milliseconds that end it. */
export class FrameMeter {
  #times = [];
  #most;
  #gap;

  constructor(most = 600, gap = GAP) {
    this.#most = most;
    this.#gap = gap;
  }

  get isFull() { return this.#times.length === this.#most; }
  reset() { this.#times = []; }

  tick(now = performance.now()) {
    if (now - this.#times.at(-1) > this.#gap) this.reset();
    this.#times.push(now);
    if (this.#times.length > this.#most) this.#times.shift();
  }

  rate() {
    const n = this.#times.length;
    return n < 2 ? 0 : (1000 * (n - 1)) / (this.#times[n - 1] - this.#times[0]);
  }
}

/** Promise that resolves when the requested drawing has been painted. */
export function afterPaint() {
  const channel = new MessageChannel();
  // The callback runs before the frame is painted; a task queued there runs after it.
  requestAnimationFrame(() => channel.port2.postMessage(null));
  return new Promise((resolve) => { channel.port1.onmessage = () => resolve(performance.now()); });
}
