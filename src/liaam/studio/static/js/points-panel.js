// The panel beside the picture: its points, actions on the selected ones, and the start of new pictures.

import { PointList } from "./point-list.js";

const START_KEY = "liaam-studio:start";

export class PointsPanel {
  /** onstart(): the start of new pictures has changed; onedit(): edit the template. */
  constructor({ ui, commands, onstart, onedit }) {
    const { h, button, segmented } = ui;
    this.list = new PointList(ui, (index, adds) => commands.chooseFromList(index, adds));
    this.tally = h("span", { class: "muted small grow" });
    const small = (label, icon, shortcut, onclick) =>
      button(label, { icon, iconOnly: true, small: true, kind: "ghost", shortcut, onclick });
    this.hideButton = small("Visible or invisible", "eye-off", "V", () => commands.toggleInvisible());
    this.removeButton = small("Clear position", "trash", "Delete", () => commands.removeChosen());
    this.startChoice = segmented(
      "Start of pictures without points",
      [
        { value: "layout", label: "Mean shape", title: "Start with the mean shape of the done pictures" },
        { value: "click", label: "Click each", title: "Click the points one after another" },
      ],
      localStorage.getItem(START_KEY) ?? "layout",
      (value) => {
        localStorage.setItem(START_KEY, value);
        onstart();
      },
    );
    this.editButton = button("Edit template…", { icon: "edit", small: true, testid: "template-edit", onclick: onedit });
    const title = h("h2", { class: "panel-title" }, "Points");
    const begin = h("span", { class: "small muted grow" }, "Start with");
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

  /** Start of pictures without points: "layout" or "click". */
  get start() {
    return this.startChoice.value;
  }

  render(marking) {
    this.list.render(marking.book ? marking.names : [], (i) => marking.stateOf(i));
    this.mark(marking);
  }

  mark({ selection, active }) {
    this.list.mark(selection, active);
    this.hideButton.disabled = this.removeButton.disabled = selection.size === 0;
  }
}
