// The Fit tab's panel for the picture, the start and the method.

import { modelNeeded, offer } from "./fit-draw.js";
import { button, h, iconButton, segmented } from "./ui.js";

const STARTS = [
  {
    value: "auto", label: "Automatic", title: "Search the picture for the object",
    hint: "The model searches the whole picture.",
  },
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
    const method = this._method = h("select.text", {
      "aria-describedby": "fit-method-summary", testid: "fit-method",
      onchange: () => {
        summarise();
        onmethod(method.value);
      },
    }, sorted.map(({ name }) => h("option", { value: name }, name)));
    const summary = h("p.small.muted.fit-method-summary", { id: "fit-method-summary" });
    const summarise = () => {
      const chosen = methods.find(({ name }) => name === method.value);
      summary.textContent = `${chosen.summary}${chosen.needs_colour ? " Needs colour." : ""}`;
    };
    summarise();
    this._run = button("Fit", {
      icon: "target", kind: "primary", shortcut: "Enter", testid: "fit-run", onclick: onrun,
    });
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
    this._hint.hidden = value === "auto";
  }

  set canRun(can) { this._run.disabled = !can; }

  /** source: the picture, or null; canGoBack: whether it hides a picture of the folder; mismatch: why the model does
   *  not match the template, or "". */
  show({ source, model, canGoBack, mismatch }) {
    this._label.textContent = source?.name ?? "No picture";
    this._label.title = source?.name ?? "";
    this._back.hidden = !canGoBack;
    this._needsModel.hidden = Boolean(model);
    this._withModel.hidden = !model;
    offer(this._method, model);
    this._mismatch.textContent = mismatch;
    this._mismatch.hidden = !mismatch;
    this.canRun = Boolean(source);
  }
}
