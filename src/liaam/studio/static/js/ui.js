// Elements and controls shared by all tabs.

const SVG = "http://www.w3.org/2000/svg";

/** Create an element: h("button", {class: "button", onclick: f, "aria-label": "…", dataset: {testid: "x"}}, "text", child). */
export function h(tag, props = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(props ?? {})) {
    if (value == null || value === false) continue;
    if (name === "class") element.className = value;
    else if (name === "dataset") Object.assign(element.dataset, value);
    else if (name === "style" && typeof value === "object") Object.assign(element.style, value);
    else if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name in element && typeof value !== "string" && !name.startsWith("aria")) element[name] = value;
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.flat(Infinity).filter((child) => child != null && child !== false));
  return element;
}

/** Paths of the icons on a 24 x 24 grid, with a line width of 2. */
const ICONS = {
  undo: "M9 14 4 9l5-5M4 9h10a6 6 0 0 1 0 12h-3", redo: "m15 14 5-5-5-5M20 9H10a6 6 0 0 0 0 12h3",
  plus: "M12 5v14M5 12h14", minus: "M5 12h14", fit: "M4 9V4h5M20 9V4h-5M4 15v5h5M20 15v5h-5", check: "m5 12 5 5 9-10",
  close: "M6 6l12 12M18 6 6 18", left: "m14 6-6 6 6 6", right: "m10 6 6 6-6 6", up: "m6 14 6-6 6 6",
  down: "m6 10 6 6 6-6", play: "M7 5v14l12-7z", pause: "M8 5v14M16 5v14", train: "M4 19V9l8-5 8 5v10M9 19v-6h6v6",
  brain: "M12 3v18M7 7h10M5 12h14M7 17h10", image: "M4 5h16v14H4zM4 16l5-5 4 4 3-3 4 4M15.5 9.5h.01",
  folder: "M3 6h6l2 2h10v11H3z", upload: "M12 16V5M7 10l5-5 5 5M5 19h14", download: "M12 5v11M7 11l5 5 5-5M5 20h14",
  sun: "M12 8a4 4 0 1 0 0 8 4 4 0 0 0 0-8M12 2v2M12 20v2M2 12h2M20 12h2M5 5l1.4 1.4M17.6 17.6 19 19M5 19l1.4-1.4M17.6 6.4 19 5",
  moon: "M20 14.5A8 8 0 1 1 9.5 4a6.5 6.5 0 0 0 10.5 10.5z",
  keyboard: "M3 7h18v10H3zM7 11h.01M11 11h.01M15 11h.01M8 14h8", warning: "M12 4 2.5 20h19zM12 10v4M12 17h.01",
  points: "M5 7h.01M12 5h.01M19 7h.01M7 16h.01M17 16h.01M12 20h.01M5 7l7-2 7 2-2 9-5 4-5-4z",
  path: "M5 18c4-12 10 0 14-12M5 18h.01M19 6h.01", mirror: "M12 3v18M9 7 3 18h6zM15 7l6 11h-6z",
  trash: "M5 7h14M10 7V4h4v3M7 7l1 13h8l1-13", edit: "M4 20h4L19 9l-4-4L4 16zM13 7l4 4",
  eye: "M2 12s4-7 10-7 10 7 10 7-4 7-10 7S2 12 2 12zM12 9a3 3 0 1 0 0 6 3 3 0 0 0 0-6",
  "eye-off": "M3 3l18 18M10 5.2A10 10 0 0 1 12 5c6 0 10 7 10 7a17 17 0 0 1-3.4 4M6.5 6.7A16 16 0 0 0 2 12s4 7 10 7c1.8 0 3.400-.6 4.800-1.400M9.900 9.900a3 3 0 0 0 4.200 4.200",
  swap: "M7 4 3 8l4 4M3 8h18M17 12l4 4-4 4M21 16H3",
  target: "M12 4a8 8 0 1 0 0 16 8 8 0 0 0 0-16M12 2v4M12 18v4M2 12h4M18 12h4", box: "M5 5h14v14H5z",
  menu: "M4 7h16M4 12h16M4 17h16", compare: "M12 3v18M4 6h5v12H4zM15 6h5v12h-5z",
  spark: "M12 3l2 6 6 2-6 2-2 6-2-6-6-2 6-2z",
};

/** An icon as an SVG that is hidden from screen readers. */
export function icon(name, size = 16) {
  const svg = document.createElementNS(SVG, "svg");
  const path = document.createElementNS(SVG, "path");
  for (const [key, value] of Object.entries({
    viewBox: "0 0 24 24", width: size, height: size, fill: "none", stroke: "currentColor",
    "stroke-width": 2, "stroke-linecap": "round", "stroke-linejoin": "round", "aria-hidden": "true",
  })) svg.setAttribute(key, value);
  path.setAttribute("d", ICONS[name] ?? ICONS.points);
  svg.append(path);
  return svg;
}

/**
 * A button. kind: "primary", "danger", "ghost"; small; pressed: true or false for toggles; iconOnly: show the label only
 * to screen readers and in the tooltip; shortcut: shown in the tooltip; testid.
 */
export function button(label, options = {}) {
  const { icon: picture, onclick, kind = "", shortcut, small, pressed, iconOnly, disabled, title, testid, ...others } = options;
  return h(
    "button",
    {
      type: "button", class: ["button", kind, small && "small", iconOnly && "icon-only"].filter(Boolean).join(" "),
      onclick, disabled: Boolean(disabled), "aria-pressed": pressed == null ? null : String(pressed),
      "aria-label": iconOnly ? label : null, "aria-keyshortcuts": shortcut ?? null,
      title: [title ?? (iconOnly ? label : ""), shortcut && `(${shortcut})`].filter(Boolean).join(" ") || null,
      dataset: testid ? { testid } : {}, ...others,
    },
    picture && icon(picture),
    !iconOnly && label,
  );
}

/** A row of radio buttons: [{value, label, title}]; returns {element, value (get, set)}. */
export function segmented(label, choices, value, onchange) {
  const buttons = choices.map((choice) =>
    h("button", { type: "button", role: "radio", title: choice.title, dataset: { value: choice.value } }, choice.label),
  );
  const element = h("div", { class: "segmented", role: "radiogroup", "aria-label": label }, buttons);
  const show = () => buttons.forEach((each) => {
    const on = each.dataset.value === value;
    each.setAttribute("aria-checked", String(on));
    each.tabIndex = on ? 0 : -1;
  });
  const choose = (next, focus = false) => {
    if (next === value) return;
    value = next;
    show();
    if (focus) buttons.find((each) => each.dataset.value === value)?.focus();
    onchange(value);
  };
  element.addEventListener("click", (event) => {
    const chosen = event.target.closest("button");
    if (chosen) choose(chosen.dataset.value);
  });
  element.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    event.stopPropagation();
    const at = choices.findIndex((choice) => choice.value === value);
    choose(choices[(at + step + choices.length) % choices.length].value, true);
  });
  show();
  return {
    element,
    get value() { return value; },
    set value(next) { value = next; show(); },
  };
}

/**
 * Open a modal dialog; actions: [{label, kind, value, testid}]; body: element or text. Resolves to the value of the
 * chosen action, or null if the dialog was closed.
 */
export function dialog(title, body, actions = [{ label: "Close", value: null }], { wide = false } = {}) {
  return new Promise((resolve) => {
    const box = h("dialog", { class: wide ? "dialog wide" : "dialog", "aria-labelledby": "dialog-title" });
    let chosen = null;
    const close = (value) => { chosen = value; box.close(); };
    box.append(
      h("div", { class: "dialog-head" }, h("h2", { id: "dialog-title" }, title),
        button("Close", { icon: "close", iconOnly: true, kind: "ghost", small: true, onclick: () => close(null) })),
      h("div", { class: "dialog-body" }, typeof body === "string" ? h("p", {}, body) : body),
      h("div", { class: "dialog-foot" }, actions.map(({ label, kind, value, testid }) =>
        button(label, { kind, testid, onclick: () => close(value) }))),
    );
    // Do not trigger keys of the page behind the dialog.
    box.addEventListener("keydown", (event) => event.stopPropagation());
    box.addEventListener("close", () => { box.remove(); resolve(chosen); });
    document.body.append(box);
    box.showModal();
    // Show the beginning of a long body, regardless of the focus.
    box.querySelector(".dialog-foot .primary, .dialog-foot button")?.focus({ preventScroll: true });
    box.scrollTop = 0;
    box.querySelector(".dialog-body").scrollTop = 0;
  });
}

/** Ask for confirmation of an action that cannot be undone. */
export async function confirm(title, text, action, kind = "danger") {
  return (await dialog(title, text, [{ label: "Cancel", value: false }, { label: action, kind, value: true, testid: "confirm" }])) === true;
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

/** Show a message at the bottom of the page; errors stay until they are closed. Returns a function that removes it. */
export function toast(message, kind = "info") {
  const box = document.getElementById("toasts");
  const text = message instanceof Error ? message.message : String(message);
  for (const other of box.children) if (other.dataset.text === text) other.remove();
  const item = h("div", { class: `toast ${kind}`, dataset: { text }, role: kind === "bad" ? "alert" : null }, h("span", { class: "grow" }, text),
    button("Dismiss", { icon: "close", iconOnly: true, kind: "ghost", small: true, onclick: () => item.remove() }));
  box.append(item);
  while (box.children.length > 4) box.firstChild.remove();
  if (kind !== "bad") setTimeout(() => item.remove(), 5000);
  return () => item.remove();
}

/** Whether the event's target is a text field. */
export function isTyping(event) {
  const target = event.target;
  return target instanceof HTMLElement
    && (target.isContentEditable || target.matches("textarea, select, input:not([type=range], [type=checkbox], [type=radio], [type=button])"));
}

/** Call a function at most once per frame, with the newest arguments. */
export function perFrame(work) {
  let waiting = null;
  return (...args) => {
    if (waiting === null) requestAnimationFrame(() => { const newest = waiting; waiting = null; work(...newest); });
    waiting = args;
  };
}
