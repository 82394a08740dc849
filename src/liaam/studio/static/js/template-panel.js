// The panel beside the picture while the template is edited: instructions, points, paths, and Done.

import { TemplatePaths } from "./template-paths.js";
import { TemplatePoints } from "./template-points.js";

export class TemplatePanel {
  /** onload(file): start with a landmark file; ondone(); onleave(). */
  constructor({ ui, drafting, onload, ondone, onleave }) {
    const { h, button, icon } = ui;
    Object.assign(this, { h, drafting });
    this.busy = false;
    this.heading = h("h2", { class: "panel-title" });
    this.intro = h("div", { class: "column template-intro" });
    this.file = h("input", {
      type: "file", class: "visually-hidden", id: "template-file", dataset: { testid: "template-load" },
      onchange: () => this.file.files[0] && onload(this.file.files[0]),
    });
    const from = "Load a landmark file";
    this.loadLabel = h("label", { class: "button", for: "template-file" }, icon("upload"), from);
    this.pathButton = button("New path", {
      icon: "path", small: true, shortcut: "N", testid: "template-new-path", onclick: () => drafting.startPath(),
    });
    this.closeButton = button("Close path", {
      icon: "check", small: true, shortcut: "C", testid: "template-close-path", onclick: () => drafting.close(),
    });
    this.mirrorButton = button("Mirror", {
      icon: "mirror", small: true, shortcut: "X", pressed: false, onclick: () => this.toggleMirror(),
      title: "Add a mirrored point on the other side of the line with each point",
    });
    this.flipButton = button("Flip", {
      icon: "swap", small: true, onclick: () => drafting.flip(), title: "Swap left and right",
    });
    this.doneButton = button("Done", { icon: "check", kind: "primary", testid: "template-done", onclick: ondone });
    this.cancelButton = button("Cancel", { kind: "ghost", onclick: onleave });
    this.message = h("p", { class: "small error-text", role: "status" });
    this.points = new TemplatePoints(ui, drafting);
    this.paths = new TemplatePaths(ui, drafting);
    this.placedButton = button("The points are in place", {
      kind: "primary", small: true, onclick: () => drafting.endLayout(),
    });
    const tools = h("div", { class: "row" }, this.pathButton, this.closeButton, this.mirrorButton, this.flipButton);
    const lists = h(
      "section",
      { class: "panel grow template-lists" },
      h("h2", { class: "panel-title" }, "Points"),
      this.points.element,
      h("h2", { class: "panel-title" }, "Paths"),
      this.paths.element,
    );
    const foot = h("div", { class: "row" }, this.doneButton, this.cancelButton);
    this.element = h(
      "div",
      { class: "template-panel" },
      h("section", { class: "panel" }, this.heading, this.intro, tools),
      lists,
      h("section", { class: "panel side-foot" }, this.message, foot),
    );
  }

  render() {
    this.points.render();
    this.paths.render();
    this.refresh();
  }

  /** Update the buttons and the instructions. */
  refresh() {
    const { draft, saved, layingOut } = this.drafting;
    this.heading.textContent = saved ? "Edit the template" : "Start with a template";
    this.intro.replaceChildren(...this.steps());
    const open = draft.path >= 0;
    this.pathButton.disabled = !open;
    this.closeButton.disabled = !open || draft.contours[draft.path].indices.length < (draft.twinPath < 0 ? 3 : 2);
    this.mirrorButton.disabled = layingOut;
    this.flipButton.hidden = !layingOut && !saved;
    this.doneButton.disabled = this.busy || draft.names.length === 0;
    this.cancelButton.hidden = saved === null && !draft.names.length;
    this.cancelButton.lastChild.textContent = saved ? "Cancel" : "Start over";
    this.message.textContent = "";
  }

  steps() {
    const { h } = this;
    const { draft, saved, layingOut, loaded } = this.drafting;
    const muted = (text) => h("p", { class: "muted small" }, text);
    if (layingOut) {
      const how = "Drag the frame's handles until the points lie on this picture, then move single points.";
      return [h("p", {}, loaded ? `Points of ${loaded}. ` : "", how), this.placedButton];
    }
    if (saved) {
      return [
        muted(
          "Click the picture to add points. Shift-click a point to connect the path to it. Other pictures change when you press Done.",
        ),
      ];
    }
    if (draft.names.length) {
      return [
        muted(
          "Click to continue the path, or click its first point to close it. Shift-click a point to connect the path to it. You can change names below, now or later.",
        ),
      ];
    }
    const what =
      "Which points will be placed on every picture? Click them on this picture, one contour after another. Each click continues the path.";
    return [
      h("p", {}, what),
      muted("Or load them from a landmark file (.pts, .ljson, .asf …):"),
      h("div", {}, this.file, this.loadLabel),
    ];
  }

  toggleMirror() {
    this.showMirror(this.drafting.toggleMirror());
  }

  showMirror(on) {
    this.mirrorButton.setAttribute("aria-pressed", String(on));
  }

  /** Disable Done while the template is being saved. */
  setBusy(busy) {
    this.busy = busy;
    if (busy) this.refresh();
    else this.doneButton.disabled = false;
  }
}
