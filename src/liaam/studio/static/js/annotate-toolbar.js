// The Annotate tab's toolbar.

/** act(event, work): runs the action of a button. Returns {element, refresh(), press(name, on)}. */
export function createToolbar({ ui, state, commands, status, act }) {
  const { h, button } = ui;
  const tool = (label, icon, shortcut, work, more = {}) =>
    button(label, { icon, iconOnly: true, kind: "ghost", shortcut, onclick: (event) => act(event, work), ...more });
  const toggle = (label, title, face, shortcut, work, pressed = false) =>
    button(face.text ?? label, {
      icon: face.icon, iconOnly: !face.text, "aria-label": label, kind: "ghost", shortcut, pressed, title,
      onclick: (event) => act(event, work),
    });
  const rule = () => h("span", { class: "rule", "aria-hidden": "true" });
  const undo = tool("Undo", "undo", "Ctrl+Z", () => commands.undo(), { testid: "undo" });
  const redo = tool("Redo", "redo", "Ctrl+Y", () => commands.redo(), { testid: "redo" });
  const names = toggle("Names", "Show the names of all points", { text: "Aa" }, "L", () => commands.flick("names"));
  const contours = toggle(
    "Contours", "Show the contours",
    { icon: "path" },
    "K",
    () => commands.flick("contours"),
    true,
  );
  const ellipses = toggle(
    "Ellipses", "Show ellipses that contain each point with 95 % probability",
    { icon: "target" },
    "E",
    () => commands.flick("ellipses"),
    true,
  );
  const box = tool("Select with a box", "box", "B", () => commands.toggleBox(), { pressed: false });
  const mirror = tool("Move mirrored points together", "mirror", "X", () => commands.toggleMirrored(), { pressed: false });
  const flip = tool("Flip left and right", "swap", "M", () => commands.flip());
  const switches = { names, contours, ellipses, box, mirror };
  const element = h(
    "div",
    { class: "toolbar annotate-toolbar", role: "group", "aria-label": "Annotate" },
    tool("Previous picture", "left", "[", () => state.step(-1)),
    tool("Next picture", "right", "]", () => state.step(1)),
    rule(),
    undo, redo,
    rule(),
    box, mirror, flip,
    rule(),
    h("div", { class: "row tight", role: "group", "aria-label": "Show" }, names, contours, ellipses),
    h("span", { class: "grow" }),
    status.button, status.element,
  );

  return {
    element,
    /** history: for undo, or null; editing: whether the template is edited; marking: whether marks are edited. */
    refresh({ history, editing, marking }) {
      undo.disabled = !history?.canUndo;
      redo.disabled = !history?.canRedo;
      undo.title = `Undo${history?.undoes ? `: ${history.undoes}` : ""} (Ctrl+Z)`;
      redo.title = `Redo${history?.redoes ? `: ${history.redoes}` : ""} (Ctrl+Y)`;
      flip.disabled = !marking;
      mirror.disabled = editing;
    },
    press: (name, on) => switches[name].setAttribute("aria-pressed", String(on)),
  };
}
