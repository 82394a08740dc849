// The Annotate tab's toolbar, with the status of saving.

import { button, complaints, h, iconButton, press } from "./ui.js";

/** @param {import("./annotate.js").Tab} tab */
export function createToolbar(tab) {
  const { state, commands, shown, status } = tab;
  const tool = (label, icon, shortcut, work, more = {}) =>
    iconButton(label, icon, (event) => tab.act(event, work), { shortcut, ...more });
  const show = (name, title, face, shortcut, pressed) =>
    button(face.text ?? name, {
      icon: face.icon, iconOnly: !face.text, "aria-label": name, kind: "ghost", shortcut, pressed, title,
      onclick: (event) => tab.act(event, () => commands.flick(face.what ?? name.toLowerCase())),
    });
  const rule = () => h("span.rule", { "aria-hidden": "true" });
  const undo = tool("Undo", "undo", "Ctrl+Z", () => commands.travel("undo"), { testid: "undo" });
  const redo = tool("Redo", "redo", "Ctrl+Y", () => commands.travel("redo"), { testid: "redo" });
  const names = show("Names", "Show the names of all points", { text: "Aa" }, "L", false);
  const contours = show("Curves", "Show the curves", { icon: "path", what: "contours" }, "K", true);
  const around = "Show ellipses that contain each point with 95 % probability";
  const ellipses = show("Ellipses", around, { icon: "target" }, "E", true);
  const measures = button("mm", {
    "aria-label": "Measures", kind: "ghost", shortcut: "T", pressed: true, testid: "measures",
    title: "Measure the selected points in all pictures; with none selected, show or hide the measures",
    onclick: (event) => tab.act(event, commands.measure),
  });
  const box = tool("Select with a box", "box", "B", commands.toggleBox, { pressed: false });
  const mirror = tool("Move mirrored points together", "mirror", "X", commands.toggleMirrored, { pressed: false });
  const flip = tool("Flip the points left and right", "swap", "M", commands.flip, {
    title: "Flip the points left and right. The picture stays: F shows it mirrored",
  });
  const ruler = tool("Scale bar", "ruler", "S", commands.ruler, {
    pressed: false, testid: "scale-bar", title: "Scale bar: click both ends of a ruler, or drag along it, and enter its length",
  });
  const trace = tool("Trace a curve", "curve", "C", commands.trace, {
    pressed: false, testid: "trace", title: "Trace a curve: click a few places along it, and its points are placed evenly",
  });
  const drawing = { names, contours, ellipses, measures };
  const modes = { box, mirror };
  const pressDrawn = () => { for (const [what, on] of Object.entries(shown.drawn)) press(drawing[what], on); };
  shown.addEventListener("change", pressDrawn);
  pressDrawn();
  const element = h("div.toolbar.annotate-toolbar", { role: "group", "aria-label": "Annotate" },
    tool("Previous picture", "left", "[", () => state.step(-1)),
    tool("Next picture", "right", "]", () => state.step(1)),
    rule(), undo, redo, rule(), box, mirror, flip, trace, ruler, rule(),
    h("div.row.tight", { role: "group", "aria-label": "Show" }, names, contours, ellipses, measures),
    h("span.grow"), status.button, status.element);

  return {
    element,
    /** history: for undo, or null; editing: whether the template is edited; marking: whether marks are edited. */
    refresh({ history, editing, marking }) {
      const { cameFrom } = commands;
      undo.disabled = !history?.canUndo && !cameFrom;
      redo.disabled = !history?.canRedo;
      undo.title = cameFrom ? `Back to ${cameFrom}, which was accepted (Ctrl+Z)` : `Undo${history?.undoes ? `: ${history.undoes}` : ""} (Ctrl+Z)`;
      redo.title = `Redo${history?.redoes ? `: ${history.redoes}` : ""} (Ctrl+Y)`;
      flip.disabled = ruler.disabled = !marking || tab.tracing.on;
      trace.disabled = !marking || !state.project.template?.contours.length;
      mirror.disabled = editing;
      press(ruler, tab.ruler.on);
      press(trace, tab.tracing.on);
    },
    /** Show whether "box" or "mirror" is on. */
    press: (mode, on) => press(modes[mode], on),
  };
}

const TEXTS = {
  saved: "Saved", saving: "Saving…", offline: "Not saved – server not reachable, retrying",
  failing: "Not saved – retrying", refused: "Not saved", conflict: "Not saved – changed elsewhere",
  draft: "Press Done to save",
};
const WRONG = ["offline", "failing", "refused", "conflict"];

/** The status line of saving. @param {import("./annotate.js").Tab} tab */
export function createStatus(tab) {
  const element = h("span.save-status", { dataset: { testid: "save-status", state: "saved" } }, TEXTS.saved);
  const decide = button("Decide…", {
    small: true, hidden: true, onclick: () => tab.saving.decide(tab.saver.conflicted),
  });
  const complain = complaints();
  let now = ["saved", ""]; // state and message
  tab.state.addEventListener("online", () => tell(...now));

  /** While the server is away, nothing new is saved, so that "Saved" alone would be understood wrongly. */
  function textOf(state, message) {
    if (state === "saved" && !tab.state.online) return "All changes were saved; server not reachable";
    return state === "offline" && message ? "Not saved, but kept in the browser" : TEXTS[state];
  }

  function tell(state, message) {
    now = [state, message];
    element.dataset.state = state;
    element.classList.toggle("away", !tab.state.online);
    element.textContent = textOf(state, message);
    element.title = message || element.textContent;
  }

  return {
    element, button: decide,
    get state() { return element.dataset.state; },
    show(state, message) {
      const before = element.dataset.state;
      tell(state, message);
      complain(state === "refused" || state === "failing" ? `Not saved: ${message}` : "");
      decide.hidden = state !== "conflict";
      // Announce problems and their end, not every save.
      if (WRONG.includes(state) && before !== state) tab.say(element.title);
      if (WRONG.includes(before) && state === "saved") tab.say(TEXTS.saved);
    },
  };
}
