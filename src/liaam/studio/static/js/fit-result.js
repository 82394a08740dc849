// The Fit tab's panel with the result of a fit, and remedies if it failed or has low confidence.

import { entries } from "./fit-draw.js";
import { factsOf, verdictOf } from "./fit-run.js";
import { button, h } from "./ui.js";

export class ResultPanel {
  /** onstart(value): start from a "box" or the "mean" shape. */
  constructor({ onstart }) {
    this._status = h("div.column.tight.fit-status", { role: "status", "aria-live": "polite", testid: "fit-status" });
    this._remedies = h("div.row.tight.fit-remedies", { hidden: true },
      button("Draw a box", { icon: "box", small: true, onclick: () => onstart("box") }),
      button("Drag the mean shape", { icon: "target", small: true, onclick: () => onstart("mean") }));
    this._facts = h("dl.fit-facts");
    this.element = h("section.panel.fit-result", { "aria-label": "Result" }, this._status, this._remedies, this._facts);
  }

  /** Show a message in place of a fit, or nothing for ""; kind: "info" or "bad". */
  showMessage(kind, message) {
    this.element.hidden = !message;
    this._status.replaceChildren(h(kind === "bad" ? "p.error-text" : "p.small", message));
    this._remedies.hidden = true;
    this._facts.replaceChildren();
  }

  show(fit) {
    this.element.hidden = false;
    const { kind, title, advice } = verdictOf(fit);
    const lines = [
      h("span.badge", { class: kind, dataset: { status: fit.status } }, title),
      h("p.small", fit.message),
      fit.trained_on && h("p.small.muted", "The model was trained on this picture."),
      advice && h("p.small.muted", advice),
    ];
    this._status.replaceChildren(...lines.filter(Boolean));
    this._remedies.hidden = !advice;
    this._facts.replaceChildren(...entries(factsOf(fit)));
  }
}
