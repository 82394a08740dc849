// The Fit tab's panels: for the picture, the start and the method, and with the result.

import { entries, modelNeeded, offer } from "./fit-draw.js";
import { factsOf, verdictOf } from "./fit-run.js";
import { button, h, iconButton, segmented } from "./ui.js";

const STARTS = [
  { value: "auto", label: "Automatic", title: "Search the picture for the object", hint: "" },
  {
    value: "box", label: "Box", title: "Draw a box around the object",
    hint: "Draw a box around the object. Arrow keys move it, comma and full stop resize it, Enter fits.",
  },
  {
    value: "mean", label: "Mean shape", title: "Drag the model's mean shape onto the object",
    hint: "Drag the shape onto the object. Its corners resize it, the knob rotates it. Keys: arrows move, " +
      "comma and full stop resize, brackets rotate, Enter fits.",
  },
];

export class SetupPanel {
  /** onback(): show the folder's picture; onopen(): open a file; onstart(value), onmethod(name): chosen; onclick(): a
   *  start was clicked, not chosen by keys; onrun().
   *  @param {{app: App, [handler: string]: any}} options */
  constructor({ app, onback, onopen, onstart, onclick, onmethod, onrun }) {
    this._label = h("span.fit-source-name.grow");
    this._back = iconButton("Back to the folder", "left", onback, { small: true, hidden: true });
    const open = button("Open…", {
      icon: "image", small: true, title: "Open another picture without adding it to the folder", onclick: onopen,
    });
    this._starts = segmented("Start", STARTS, "auto", onstart, "start");
    this._starts.element.addEventListener("click", onclick);
    this._hint = h("p.small.muted", { hidden: true });
    const { methods, default_method: first } = app.state.project;
    const sorted = [...methods].sort((a, b) => Number(b.name === first) - Number(a.name === first));
    const summary = h("p.small.muted.fit-method-summary", { id: "fit-method-summary" });
    const summarise = () => {
      const chosen = methods.find(({ name }) => name === method.value);
      summary.textContent = `${chosen.summary}${chosen.needs_colour ? " Needs colour." : ""}`;
      return chosen.name;
    };
    const method = this._method = h("select.text", {
      "aria-describedby": "fit-method-summary", testid: "fit-method", onchange: () => onmethod(summarise()),
    }, sorted.map(({ name }) => h("option", { value: name }, name)));
    summarise();
    const look = { icon: "target", kind: "primary", shortcut: "Enter", testid: "fit-run" };
    this._run = button("Fit", { ...look, onclick: onrun });
    this._run.append(h("kbd.kbd", "Enter"));
    this._mismatch = h("p.small.error-text", { hidden: true, testid: "fit-mismatch" });
    this._needsModel = h("div.column", modelNeeded(app, "fit-to-annotate"));
    this._withModel = h("div.column",
      h("div.column.tight", this._starts.element, this._hint),
      h("div.row.fit-method", h("label.field.grow", "Method", method), this._run), summary);
    this.element = h("section.panel", { "aria-label": "Fit" },
      h("div.row.fit-source", this._back, this._label, open), this._needsModel, this._mismatch, this._withModel);
  }

  set start(value) {
    this._starts.value = value;
    this._hint.textContent = STARTS.find((start) => start.value === value).hint;
    this._hint.hidden = !this._hint.textContent;
  }

  set canRun(can) { this._run.disabled = !can; }

  /** source: the picture, or null; canGoBack: whether it hides a picture of the folder; mismatch: why the model does
   *  not match the template, or "". */
  show({ source, model, canGoBack, mismatch }) {
    this._label.textContent = this._label.title = source?.name ?? "No picture";
    this._back.hidden = !canGoBack;
    this._needsModel.hidden = Boolean(model);
    this._withModel.hidden = !model;
    offer(this._method, model);
    this._mismatch.textContent = mismatch;
    this._mismatch.hidden = !mismatch;
    this.canRun = Boolean(source);
  }
}

/** The result of a fit, and remedies if it failed or has low confidence. */
export class ResultPanel {
  /** onstart(value): start from a "box" or the "mean" shape; onnext(): fit the picture's next object. */
  constructor({ onstart, onnext }) {
    this._status = h("div.column.tight.fit-status", { role: "status", "aria-live": "polite", testid: "fit-status" });
    this._next = button("Next object", { icon: "right", small: true, onclick: onnext });
    this._remedies = h("div.row.tight.fit-remedies", { hidden: true }, this._next,
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

  /** several: whether the picture shows several objects. */
  show(fit, several = false) {
    this.element.hidden = false;
    const { kind, title, advice } = verdictOf(fit);
    const lines = [
      h("span.badge", { class: kind, dataset: { status: fit.status } }, title),
      h("p.small", fit.message),
      fit.trained_on && h("p.small.muted", "The model was trained on this picture."),
      advice && h("p.small.muted", advice),
    ];
    this._status.replaceChildren(...lines.filter(Boolean));
    this._remedies.hidden = !advice && !several;
    this._next.hidden = !several;
    this._facts.replaceChildren(...entries(factsOf(fit)));
  }
}
