// The list of the template's paths, to continue, close or delete them.

import { several } from "./assist.js";

export class TemplatePaths {
  constructor({ h, button }, drafting) {
    Object.assign(this, { h, button, drafting });
    this.element = h("ul", { class: "template-paths", "aria-label": "Paths of the template" });
  }

  render() {
    const { contours } = this.drafting.draft;
    this.element.dataset.empty = contours.length ? "" : "No paths yet";
    this.element.replaceChildren(...contours.map((contour, k) => this.row(contour, k)));
  }

  row({ indices, closed }, k) {
    const { h, button, drafting } = this;
    const current = k === drafting.draft.path;
    const label = `Path ${k + 1}`;
    const length = ` ${several(indices.length, "point")}${current ? ", being drawn" : ""}`;
    return h(
      "li",
      { class: current ? "template-path chosen" : "template-path" },
      h("span", { class: "grow" }, label, h("span", { class: "muted small" }, length)),
      !current &&
        indices.length > 2 &&
        button(closed ? "closed" : "open", {
          small: true, kind: "ghost", pressed: closed, "aria-label": `${label}: closed`,
          onclick: () => drafting.setClosed(k, !closed),
        }),
      !current &&
        button(`Continue ${label.toLowerCase()}`, {
          icon: "edit", iconOnly: true, small: true, kind: "ghost", onclick: () => drafting.continuePath(k),
        }),
      button(`Delete ${label.toLowerCase()}`, {
        icon: "trash", iconOnly: true, small: true, kind: "ghost", title: "Delete this path; its points stay",
        onclick: () => drafting.removePath(k),
      }),
    );
  }
}
