// Keys of the Annotate tab.

import { keyEdit } from "./gestures.js";
import { placed } from "./points.js";

export const SHORTCUTS = [
  { keys: "Enter", what: "Accept the points and open the picture with the star: the one that helps the model most, or the first of a list by quality" },
  { keys: "Shift+Enter", what: "After a picture opened from the wall: return, and accept what is in view there" },
  { keys: "N", what: "Open it without accepting" },
  { keys: "Tab Shift+Tab", what: "Next, previous point (Escape, then Tab: leave the picture)" },
  { keys: "← → ↑ ↓", what: "Move the selected points, or the mean shape, by 1 px (Shift: 10, Alt: 0.1)" },
  { keys: "Ctrl+← Ctrl+→", what: "Rotate them by 1° (Shift: 5°)" },
  { keys: "Ctrl+↑ Ctrl+↓", what: "Scale them by 1 % (Shift: 5 %)" },
  { keys: "Shift click", what: "Add to the selection (Shift drag: select with a box)" },
  { keys: "Ctrl+A Escape", what: "Select all, none" },
  { keys: "P", what: "Place the missing point at its expected position" },
  { keys: "Shift+P", what: "Copy the points of the last done picture above this one" },
  { keys: "Delete", what: "Clear the point's position" },
  { keys: "V", what: "Mark the point as visible or invisible" },
  { keys: "Y", what: "Confirm a proposed point where it is, and go to the next one" },
  { keys: "U", what: "Mark the point as absent: this object does not have it" },
  { keys: "X M", what: "Move mirrored points together; flip the points left and right" },
  { keys: "B S", what: "Select with a box; draw a scale bar" },
  { keys: "T", what: "Measure the selected points in all pictures; with none selected, show or hide the measures" },
  { keys: "C", what: "Trace a curve by a few clicks; Enter ends it, Backspace removes the last place" },
  { keys: "Shift+C", what: "Space the points of the curve evenly" },
  { keys: "L K E", what: "Show names, curves, ellipses" },
  { keys: "R", what: "Loupe where a click places a point: on, off" },
  { keys: "F", what: "Show this picture mirrored, as a right wing beside left ones; or as it is. Points and files stay as they are" },
  { keys: "H", what: "Hide all points while held" },
  { keys: "Ctrl+Z Ctrl+Y", what: "Undo, redo; after accepting, Ctrl+Z returns to the accepted picture" },
  { keys: "N C X P", what: "In the template: draw or end a curve, close it, mirror, add a point in the middle" },
];

const CONTROLS = "button, a, label, input, summary, [role=tab]";
const WITH_ARROWS = "input, [role=listbox], [role=radiogroup], [role=tab]";
const isIn = (event, selector) => event.target instanceof Element && Boolean(event.target.closest(selector));

/** Handles a key; returns whether it was handled. @param {import("./annotate.js").Tab} tab */
export function createKeys(tab) {
  const { commands, viewer, marking } = tab;
  const always = {
    l: () => commands.flick("names"), k: () => commands.flick("contours"), e: () => commands.flick("ellipses"),
    b: commands.toggleBox, h: () => commands.hideMarks(true), escape: commands.escape, n: commands.skip,
    f: commands.mirrorView,
    r: () => tab.tool.toggleLoupe(),
  };
  const marks = {
    v: commands.toggleInvisible, u: commands.toggleAbsent, y: commands.confirm, x: commands.toggleMirrored, m: commands.flip,
    p: ({ shiftKey }) => (shiftKey ? commands.copyPrevious() : commands.placeChosen()),
    s: commands.ruler, t: commands.measure, delete: commands.removeChosen, backspace: commands.removeChosen,
    c: ({ shiftKey }) => (shiftKey ? commands.space() : commands.trace()),
  };
  const tracing = { c: commands.trace, delete: () => tab.tracing.drop(), backspace: () => tab.tracing.drop() };

  /** Tab selects the next point while the picture has the focus. Past the last, or after Escape, the focus moves on. */
  const tabKey = ({ target, shiftKey }) =>
    target === viewer.canvas && commands.marks && !commands.escaped && commands.stepPoint(shiftKey ? -1 : 1);

  function arrow(event) {
    const { doc, editing } = tab;
    if (isIn(event, WITH_ARROWS) && !tab.panel.isList(event.target)) return false;
    if (!doc.editable || tab.tool.gesture) return true;
    if (!editing && marking.placing) commands.placeChosen();
    if (!editing && !doc.selection.size) marking.select(marking.framed()); // an untouched mean shape is moved as a whole
    const chosen = [...doc.selection].filter((i) => doc.points[i]);
    const before = doc.points;
    if (editing && !chosen.length && tab.templates.doc.shiftAxis(event)) return true;
    const edit = keyEdit(event, before, chosen.length ? chosen : placed(before), chosen, viewer.mirrored);
    if (!edit) return false;
    doc.commit(doc.follow(before, edit.points, chosen), edit.what, edit.key);
    if (chosen.length === 1) tab.tool.nudged(doc.points[chosen[0]]);
    tab.saySoon(chosen);
    return true;
  }

  return (event) => {
    const letter = event.key.toLowerCase();
    const command = event.ctrlKey || event.metaKey;
    if (command && letter === "z") commands.travel(event.shiftKey ? "redo" : "undo");
    else if (command && letter === "y") commands.travel("redo");
    else if (command && letter === "a") commands.chooseAll();
    else if (event.key === "Tab") return tabKey(event);
    else if (event.key.startsWith("Arrow")) return arrow(event);
    else if (event.key === "Enter" && !command) {
      if (isIn(event, CONTROLS)) return false;
      if (!event.shiftKey || tab.editing || !tab.app.list.wall.resume()) commands.accept();
    } else if (command || event.altKey) return false;
    else if (tab.editing && tab.templates.key(event)) return true;
    else {
      const work = always[letter] ?? (tab.tracing.on ? tracing : commands.marks ? marks : {})[letter];
      if (!work) return viewer.key(event);
      work(event);
    }
    return true;
  };
}
