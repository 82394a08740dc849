// The Fit tab's panel with the result of a fit, and remedies if it failed or has low confidence.

import { entries } from "./fit-draw.js";
import { factsOf, verdictOf } from "./fit-run.js";
import { button, h } from "./ui.js";

export class ResultPanel {
  /** onstart(value): start from a "box" or the "mean" shape. */
  constructor({ onstart }) {
    this._status = h("div", {
      class: "column tight fit-status", role: "status", "aria-live": "polite", dataset: { testid: "fit-status" },
    });
    this._remedies = h(
      "div",
      { class: "row tight fit-remedies", hidden: true },
      button("Draw a box", { icon: "box", small: true, onclick: () => onstart("box") }),
      button("Drag the mean shape", { icon: "target", small: true, onclick: () => onstart("mean") }),
    );
    this._facts = h("dl", { class: "fit-facts" });
    this.element = h(
      "section",
      { class: "panel fit-result", "aria-label": "Result" },
      this._status, this._remedies, this._facts,
    );
  }

  /** Show a message in place of a fit; kind: "info" or "bad". */
  showMessage(kind, message) {
    this._status.replaceChildren(h("p", { class: kind === "bad" ? "error-text" : "small" }, message));
    this._remedies.hidden = true;
    this._facts.replaceChildren();
  }

  show(fit) {
    const { kind, title, advice } = verdictOf(fit);
    this._status.replaceChildren(
      ...[
        h("span", { class: `badge ${kind}`, dataset: { status: fit.status } }, title),
        h("p", { class: "small" }, fit.message),
        fit.trained_on && h("p", { class: "small muted" }, "The model was trained on this picture."),
        advice && h("p", { class: "small muted" }, advice),
      ].filter(Boolean),
    );
    this._remedies.hidden = !advice;
    this._facts.replaceChildren(...entries(factsOf(fit)));
  }
}
