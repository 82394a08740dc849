// The panel beside the picture: its points with their states, actions on the selected ones, and the start of pictures.

import { tallyOf } from "./annotate-words.js";
import { makeSet } from "./sets.js";
import { createSideList } from "./sides.js";
import { button, consume, h, iconButton, segmented } from "./ui.js";

const QUIET = ["placed", "proposed"]; // states that only the dot shows
const START_KEY = "liaam-studio:start";
const STARTS = [
  { value: "layout", label: "Mean shape", title: "Start with the mean shape of the done pictures" },
  { value: "click", label: "Click each", title: "Click the points one after another" },
];

/** @param {import("./annotate.js").Tab} tab */
export function createPointsPanel(tab) {
  const { commands } = tab;
  const list = pointList(commands.chooseFromList);
  const tally = h("span.small.grow", { testid: "tally" });
  const act = (label, icon, shortcut, work) => iconButton(label, icon, work, { small: true, shortcut });
  const hide = act("Visible or invisible", "eye-off", "V", commands.toggleInvisible);
  const confirm = act("Confirm where it is", "check", "Y", commands.confirm);
  const absent = act("Absent", "minus", "U", commands.toggleAbsent);
  const remove = act("Clear position", "trash", "Delete", commands.removeChosen);
  const space = act("Space the curve's points evenly", "curve", "Shift+C", commands.space);
  // Another observer places points: those of a mean shape would be no one's own.
  const { set, observers } = tab.state.project;
  const isObserver = set !== "" && observers.length > 1;
  const key = isObserver ? `${START_KEY}:${set}` : START_KEY;
  const kept = localStorage.getItem(key) ?? (isObserver ? "click" : "layout");
  const start = segmented("Start of pictures without points", STARTS, kept, (value) => {
    localStorage.setItem(key, value);
    const isOwn = ["file", "proposal"].includes(tab.marking.state?.source);
    if (tab.opening.isPristine() && !isOwn) tab.opening.reload();
  });
  const edit = button("Edit template…", {
    icon: "edit", small: true, testid: "template-edit", onclick: () => tab.templates.edit(),
  });
  const more = button("New set…", {
    small: true, kind: "ghost", testid: "set-new", title: "Other points on these pictures, or the same points by another observer",
    onclick: () => makeSet(tab.app),
  });
  const mark = ({ selection, active }) => {
    list.mark(selection, active);
    hide.disabled = remove.disabled = absent.disabled = selection.size === 0;
    confirm.disabled = selection.size !== 1;
    space.disabled = selection.size === 0 || !tab.template?.contours.length;
  };
  return {
    mark,
    /** Whether an element is the list of the points. */
    isList: (element) => element === list.element,
    points: h("section.panel.grow.point-panel",
      h("div.row.point-head", h("h2.visually-hidden", "Points"), tally, confirm, space, hide, absent, remove), list.element),
    foot: h("section.panel.side-foot",
      h("div.row.begin-with", h("span.small.muted.grow", "Start with"), start.element), createSideList(tab), h("div.row", edit, more)),
    /** Start of pictures without points: "layout" or "click". */
    get start() { return start.value; },
    /** mayEdit: whether the template may be edited. */
    render(marking, mayEdit) {
      edit.disabled = !mayEdit;
      tally.textContent = marking.book ? tallyOf(marking) : "";
      tally.title = tally.textContent; // there may be no room for all
      list.render(marking.book ? marking.names : [], (i) => marking.stateOf(i));
      mark(marking);
    },
  };
}

/** The list of the points, selected by mouse or keyboard. onchoose(index, adds): in addition to others if `adds`. */
function pointList(onchoose) {
  let current = -1;
  let shown = ""; // names and states
  const element = h("ul.point-list", {
    role: "listbox", tabindex: "0", "aria-label": "Points", "aria-multiselectable": "true", testid: "point-list",
    onclick: (event) => {
      const item = event.target.closest("[role=option]");
      if (item) onchoose(Number(item.dataset.index), event.ctrlKey || event.metaKey || event.shiftKey);
    },
    onkeydown: (event) => {
      const last = element.children.length - 1;
      const goes = { ArrowDown: current + 1, ArrowUp: current - 1, Home: 0, End: last };
      if (!(event.key in goes) || event.ctrlKey || event.metaKey || event.altKey || last < 0) return;
      consume(event);
      onchoose(Math.min(Math.max(goes[event.key], 0), last), false);
    },
  });

  const item = (name, state, i) => h("li.point", {
    role: "option", id: `point-${i}`, dataset: { index: i, state }, "aria-label": `${name}, ${state}`,
  },
  h("span.point-dot", { "aria-hidden": "true" }), h("span.number.muted", name === String(i + 1) ? "" : String(i + 1)),
  h("span.point-name.grow", name), h("span.point-state.small.muted", !QUIET.includes(state) && state));

  return {
    element,
    render(names, stateOf) {
      const items = names.map((name, i) => [name, stateOf(i)]);
      if (shown === (shown = JSON.stringify(items))) return;
      element.replaceChildren(...items.map(([name, state], i) => item(name, state, i)));
    },
    mark(selection, active) {
      current = active;
      [...element.children].forEach((each, i) => each.setAttribute("aria-selected", String(selection.has(i))));
      const row = element.children[active];
      if (!row) return element.removeAttribute("aria-activedescendant");
      element.setAttribute("aria-activedescendant", row.id);
      // On narrow pages the whole panel scrolls, and would hide the buttons above the list.
      if (element.scrollHeight > element.clientHeight) row.scrollIntoView({ block: "nearest" });
    },
  };
}
