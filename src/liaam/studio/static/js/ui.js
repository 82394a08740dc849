// Elements and controls shared by all tabs.

/** Create an element: h("p.small.muted", "text") or h("button.wide", {onclick: f, "aria-label": "…", testid: "x"},
 *  "text", child). Attributes that are null or false, and such children, are left out.
 *  @param {string} tag name with classes
 *  @param {...any} rest attributes, if there are any, then children
 *  @returns {any} */
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

/** Paths of the icons on a 24 x 24 grid, with a line width of 2. */
const ICONS = {
  undo: "M9 14 4 9l5-5M4 9h10a6 6 0 0 1 0 12h-3", redo: "m15 14 5-5-5-5M20 9H10a6 6 0 0 0 0 12h3",
  plus: "M12 5v14M5 12h14", minus: "M5 12h14", fit: "M4 9V4h5M20 9V4h-5M4 15v5h5M20 15v5h-5", check: "m5 12 5 5 9-10",
  close: "M6 6l12 12M18 6 6 18", left: "m14 6-6 6 6 6", right: "m10 6 6 6-6 6", play: "M7 5v14l12-7z",
  pause: "M8 5v14M16 5v14", brain: "M12 3v18M7 7h10M5 12h14M7 17h10",
  image: "M4 5h16v14H4zM4 16l5-5 4 4 3-3 4 4M15.5 9.5h.01", folder: "M3 6h6l2 2h10v11H3z",
  upload: "M12 16V5M7 10l5-5 5 5M5 19h14", download: "M12 5v11M7 11l5 5 5-5M5 20h14",
  sun: "M12 8a4 4 0 1 0 0 8 4 4 0 0 0 0-8M12 2v2M12 20v2M2 12h2M20 12h2M5 5l1.4 1.4M17.6 17.6 19 19M5 19l1.4-1.4" +
    "M17.6 6.4 19 5",
  moon: "M20 14.5A8 8 0 1 1 9.5 4a6.5 6.5 0 0 0 10.5 10.5z",
  keyboard: "M3 7h18v10H3zM7 11h.01M11 11h.01M15 11h.01M8 14h8", warning: "M12 4 2.5 20h19zM12 10v4M12 17h.01",
  curve: "M3 16h5v5H3zM16 3h5v5h-5zM8 17c8 0 0-11 8-11",
  path: "M5 18c4-12 10 0 14-12M5 18h.01M19 6h.01", mirror: "M12 3v18M9 7 3 18h6zM15 7l6 11h-6z",
  trash: "M5 7h14M10 7V4h4v3M7 7l1 13h8l1-13", edit: "M4 20h4L19 9l-4-4L4 16zM13 7l4 4",
  eye: "M2 12s4-7 10-7 10 7 10 7-4 7-10 7S2 12 2 12zM12 9a3 3 0 1 0 0 6 3 3 0 0 0 0-6",
  "eye-off": "M3 3l18 18M10 5.2A10 10 0 0 1 12 5c6 0 10 7 10 7a17 17 0 0 1-3.4 4M6.5 6.7A16 16 0 0 0 2 12s4 7 10 7" +
    "c1.8 0 3.4-.6 4.8-1.4M9.9 9.9a3 3 0 0 0 4.2 4.2",
  swap: "M7 4 3 8l4 4M3 8h18M17 12l4 4-4 4M21 16H3",
  target: "M12 4a8 8 0 1 0 0 16 8 8 0 0 0 0-16M12 2v4M12 18v4M2 12h4M18 12h4", box: "M5 5h14v14H5z",
  compare: "M12 3v18M4 6h5v12H4zM15 6h5v12h-5z",
  strip: "M4 5h16v14H4zM10 5v14M6.5 8.5h1M6.5 12h1", side: "M4 5h16v14H4zM14 5v14M16.5 8.5h1M16.5 12h1",
  adjust: "M12 4a8 8 0 1 0 0 16zM12 4a8 8 0 0 1 0 16M12 8h6.5M12 12h8M12 16h6.5",
  ruler: "M3 15 15 3l6 6L9 21zM7 11l2 2M10 8l3 3M13 5l2 2", wall: "M4 4h6v6H4zM14 4h6v6h-6zM4 14h6v6H4zM14 14h6v6h-6z", spark: "M12 3l2 6 6 2-6 2-2 6-2-6-6-2 6-2z",
};

export function svg(tag, attributes, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, String(value));
  element.append(...children);
  return element;
}

/** An icon as an SVG that is hidden from screen readers. */
export const icon = (name, size = 16) =>
  svg("svg", {
    viewBox: "0 0 24 24", width: size, height: size, fill: "none", stroke: "currentColor",
    "stroke-width": 2, "stroke-linecap": "round", "stroke-linejoin": "round", "aria-hidden": "true",
  }, svg("path", { d: ICONS[name] }));

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

export const iconButton = (label, picture, onclick, options = {}) =>
  button(label, { icon: picture, iconOnly: true, kind: "ghost", onclick, ...options });

export const press = (toggle, on) => toggle.setAttribute("aria-pressed", String(on));

/** The event needs no further handling, neither by the page nor by the browser. */
export function consume(event) {
  event.preventDefault();
  event.stopPropagation();
}

/** The labels in a table of {label}, by name; entries without one are left out. */
export const labelsOf = (table) =>
  Object.fromEntries(Object.entries(table).filter(([, { label }]) => label).map(([name, { label }]) => [name, label]));

/** The options of a list to choose from: labels by value. */
export const optionsOf = (labels) => Object.entries(labels).map(([value, label]) => h("option", { value }, label));

/** A list of actions under a title; onchoose(value). */
export function menu(title, labels, onchoose, attributes = {}) {
  const onchange = () => {
    const { value } = list;
    list.value = "";
    onchoose(value);
  };
  const list = h("select.text", { onchange, ...attributes }, h("option", { value: "" }, title), optionsOf(labels));
  return list;
}

export const slider = (attributes) => h("input.slider", { type: "range", ...attributes });

/** A hidden field for a file, which is opened by its click(); onfile(file, all). */
export function fileField(onfile, attributes = {}) {
  const onchange = () => field.files[0] && onfile(field.files[0], [...field.files]);
  const onclick = () => { field.value = ""; }; // so that the same file can be chosen again
  const field = h("input.visually-hidden", { type: "file", tabindex: "-1", onclick, onchange, ...attributes });
  return field;
}

/** A row of radio buttons: [{value, label, title}]; their test ids start with testid. Returns {element, value}. */
export function segmented(label, choices, value, onchange, testid = null) {
  const choose = (next) => {
    if (next === value) return;
    value = next;
    show();
    onchange(value);
  };
  const buttons = choices.map(({ value: own, label: text, title }) =>
    h("button", {
      type: "button", role: "radio", title, testid: testid && `${testid}-${own}`, dataset: { value: own },
      onclick: () => choose(own),
    }, text));
  const show = () => buttons.forEach((each) => {
    const on = each.dataset.value === value;
    each.setAttribute("aria-checked", String(on));
    each.tabIndex = on ? 0 : -1;
  });
  const onkeydown = (event) => {
    const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    if (!step) return;
    consume(event);
    const at = choices.findIndex((choice) => choice.value === value) + step;
    choose(choices.at(at % choices.length).value);
    buttons.at(at % choices.length).focus();
  };
  show();
  return {
    element: h("div.segmented", { role: "radiogroup", "aria-label": label, onkeydown }, buttons),
    get value() { return value; },
    set value(next) { value = next; show(); },
  };
}

/** A slider's handle that is dragged or moved with keys: onmove(event) while it is dragged; onkey(event) -> whether it
 *  has handled the key. */
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

/** Open a modal dialog; actions: [{label, kind, value, testid, checks: whether its fields must be valid}]; body:
 *  element or text. Resolves to the value of the chosen action, or null if the dialog was closed. */
export function dialog(title, body, actions = [{ label: "Close", value: null }], { wide = false, undecided = false } = {}) {
  return new Promise((resolve) => {
    let chosen = null;
    const close = (value, checks = false) => {
      if (checks && [...content.querySelectorAll("input")].some((field) => !field.reportValidity())) return;
      chosen = value;
      box.close();
    };
    const content = h("div.dialog-body", typeof body === "string" ? h("p", body) : body);
    const foot = h("div.dialog-foot",
      actions.map(({ label, value, checks, ...more }) =>
        button(label, { ...more, onclick: () => close(value, checks) })));
    const head = h("div.dialog-head", h("h2", { id: "dialog-title" }, title),
      iconButton("Close", "close", () => close(null), { small: true }));
    const box = h("dialog.dialog", {
      tabindex: "-1", class: wide && "wide", "aria-labelledby": "dialog-title", onclose: () => { box.remove(); resolve(chosen); },
      onkeydown: (event) => event.stopPropagation(), // do not trigger keys of the page behind the dialog
    }, head, content, foot);
    document.body.append(box);
    box.showModal();
    // Show the beginning of a long body, regardless of the focus.
    const first = undecided ? box : (foot.querySelector(".primary") ?? foot.querySelector("button"));
    first?.focus({ preventScroll: true });
    box.scrollTop = content.scrollTop = 0;
  });
}

/** Ask for confirmation of an action that cannot be undone. */
export async function confirm(title, text, action, kind = "danger") {
  const actions = [{ label: "Cancel", value: false }, { label: action, kind, value: true, testid: "confirm" }];
  return (await dialog(title, text, actions)) === true;
}

/** Save a blob as a file of the user. */
export function saveFile(blob, name) {
  const address = URL.createObjectURL(blob);
  const link = h("a", { href: address, download: name });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(address), 60_000); // the browser may not have read it yet
}

/** Show a message at the bottom of the page; errors stay until they are closed. `action`: {label, onclick} of a
 *  button. Returns a function that removes it. */
export function toast(message, kind = "info", action = null) {
  if (message?.unreachable) return () => {}; // the notice above the page says so
  const box = document.getElementById("toasts");
  const text = message instanceof Error ? message.message : String(message);
  for (const other of box.querySelectorAll(".toast")) if (other.firstChild.textContent === text) other.remove();
  const remove = () => item.remove();
  const item = h("div.toast", { class: kind, role: kind === "bad" ? "alert" : null }, h("span.grow", text),
    action && button(action.label, { small: true, testid: "toast-action", onclick: () => { remove(); action.onclick(); } }),
    iconButton("Dismiss", "close", remove, { small: true }));
  box.append(item);
  while (box.children.length > 4) box.firstChild.remove();
  if (kind !== "bad") setTimeout(remove, action ? 10_000 : 5000);
  return remove;
}

/** Returns a function that shows an error until it is called with another text, or with "". */
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
  !ctrlKey && !metaKey && !altKey && !(key === "Enter" && target.matches?.("button, a, [role=radio]"));

/** Run the action of a key, if there is one; return whether there is. */
export function runKey({ key }, actions) {
  const action = actions[key.toLowerCase()];
  action?.();
  return Boolean(action);
}

const TYPED = "textarea, select, input:not([type=range], [type=checkbox], [type=radio], [type=button])";

/** Whether the event's target is a text field. */
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

  constructor(most = 600, gap = GAP) {
    this.most = most;
    this.gap = gap;
  }

  /** Whether enough frames are counted. */
  get isFull() { return this.#times.length === this.most; }
  reset() { this.#times = []; }

  tick(now = performance.now()) {
    if (now - this.#times.at(-1) > this.gap) this.reset();
    this.#times.push(now);
    if (this.#times.length > this.most) this.#times.shift();
  }

  rate() {
    const n = this.#times.length;
    if (n < 2) return 0;
    return (1000 * (n - 1)) / (this.#times[n - 1] - this.#times[0]);
  }
}

/** Promise that resolves when the requested drawing has been painted. */
export function afterPaint() {
  const channel = new MessageChannel();
  // The callback runs before the frame is painted; a task queued there runs after it.
  requestAnimationFrame(() => channel.port2.postMessage(null));
  return new Promise((resolve) => { channel.port1.onmessage = () => resolve(performance.now()); });
}
