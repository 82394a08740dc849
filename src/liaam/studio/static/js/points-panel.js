// The panel beside the picture: its points, what to do with those that are chosen, and how pictures begin.

import { PointList } from "./point-list.js";

const START_KEY = "liaam-studio:start";

export class PointsPanel {
  /** onstart(): pictures begin otherwise from now on; onedit(): the template is to be edited. */
  constructor({ ui, commands, onstart, onedit }) {
    const { h, button, segmented } = ui;
    this.list = new PointList(ui, (index, adds) => commands.chooseFromList(index, adds));
    this.tally = h("span", { class: "muted small grow" });
    const small = (label, icon, shortcut, onclick) =>
      button(label, { icon, iconOnly: true, small: true, kind: "ghost", shortcut, onclick });
    this.hideButton = small("Visible or not", "eye-off", "V", () => commands.toggleInvisible());
    this.removeButton = small("Take the place away", "trash", "Delete", () => commands.removeChosen());
    this.startChoice = segmented(
      "How pictures without points begin",
      [
        { value: "layout", label: "Mean shape", title: "Begin with the mean of what is done" },
        { value: "click", label: "Click each", title: "Place the points one after another" },
      ],
      localStorage.getItem(START_KEY) ?? "layout",
      (value) => {
        localStorage.setItem(START_KEY, value);
        onstart();
      },
    );
    this.editButton = button("Edit template…", {
      icon: "edit",
      small: true,
      testid: "template-edit",
      onclick: onedit,
    });
    const title = h("h2", { class: "panel-title" }, "Points");
    const begin = h("span", { class: "small muted grow" }, "Begin with");
    this.elements = [
      h(
        "section",
        { class: "panel grow point-panel" },
        h("div", { class: "row" }, title, this.tally, this.hideButton, this.removeButton),
        this.list.element,
      ),
      h(
        "section",
        { class: "panel side-foot" },
        h("div", { class: "row begin-with" }, begin, this.startChoice.element),
        h("div", { class: "row" }, this.editButton),
      ),
    ];
  }

  /** How pictures without points begin: "layout" or "click". */
  get start() {
    return this.startChoice.value;
  }

  render(marking) {
    this.list.render(marking.book ? marking.names : [], (i) => marking.stateOf(i));
    this.mark(marking);
  }

  /** Show which points are chosen. */
  mark({ selection, active }) {
    this.list.mark(selection, active);
    this.hideButton.disabled = this.removeButton.disabled = selection.size === 0;
  }
}
