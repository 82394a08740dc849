// What can be taken away from a fit, and back into the folder.

import { api } from "./api.js";
import { roomy } from "./fit-draw.js";
import { lightQuery } from "./relight.js";
import { button, h } from "./ui.js";

const EXPORTS = [
  {
    title: "Landmarks",
    items: [
      { what: "pts", label: "Landmarks .pts" },
      { what: "ljson", label: "Landmarks .ljson" },
      { what: "csv", label: "Table .csv" },
      { what: "json", label: "Everything .json" },
    ],
  },
  {
    title: "Pictures",
    items: [
      { what: "overlay", label: "Picture with the fit" },
      { what: "flat", label: "Without its shading", layer: "flat" },
      { what: "shading", label: "Shading", layer: "shading" },
      { what: "relit", label: "Under the new light", layer: "flat" },
    ],
  },
];

export class ExportMenu {
  /** `light()` gives the light that is set; `annotate(fit)` takes the landmarks into the folder. */
  constructor({ light, annotate }) {
    this._light = light;
    this._fit = null;
    this.button = roomy(
      button("Export", {
        icon: "download",
        small: true,
        disabled: true,
        testid: "export-menu",
        onclick: () => this._toggle(),
      }),
    );
    this.button.setAttribute("aria-expanded", "false");
    this._links = new Map();
    this._annotate = button("Use as annotation", {
      icon: "edit",
      kind: "ghost",
      small: true,
      testid: "export-annotation",
      title: "Save these landmarks beside the picture",
      onclick: () => {
        this.close();
        annotate(this._fit);
      },
    });
    this.panel = h(
      "div",
      { class: "fit-menu", hidden: true, role: "group", "aria-label": "Export" },
      EXPORTS.map(({ title, items }) =>
        h(
          "div",
          { class: "fit-menu-group" },
          h("h3", { class: "small muted" }, title),
          items.map((item) => this._item(item)),
        ),
      ),
      h("div", { class: "fit-menu-group" }, this._annotate),
    );
    this.element = h("div", { class: "fit-export" }, this.button, this.panel);
    this.element.addEventListener("keydown", (event) => {
      if (event.key !== "Escape" || this.panel.hidden) return;
      event.stopPropagation();
      this.close();
      this.button.focus();
    });
    this.element.addEventListener("focusout", (event) => {
      if (event.relatedTarget && !this.element.contains(event.relatedTarget)) this.close();
    });
    document.addEventListener("pointerdown", (event) => {
      if (!this.element.contains(event.target)) this.close();
    });
  }

  /** Offer what a fit has; null: nothing. */
  show(fit, ofFolder) {
    this._fit = fit;
    this.button.disabled = !fit;
    this._annotate.hidden = !ofFolder;
    if (!fit) this.close();
  }

  close() {
    this.panel.hidden = true;
    this.button.setAttribute("aria-expanded", "false");
  }

  _item({ what, label, layer }) {
    const link = h(
      "a",
      { class: "button ghost small", download: "", dataset: { testid: `export-${what}` }, onclick: () => this.close() },
      label,
    );
    this._links.set(what, { link, layer });
    return link;
  }

  _toggle() {
    if (!this.panel.hidden) {
      this.close();
      return;
    }
    for (const [what, { link, layer }] of this._links) {
      const query = what === "relit" ? lightQuery(this._light()) : {};
      link.href = api.url("fits", this._fit.id, "export", { what, ...query });
      link.hidden = Boolean(layer) && !this._fit.layers.includes(layer);
    }
    this.panel.hidden = false;
    this.button.setAttribute("aria-expanded", "true");
    this.panel.querySelector("a").focus();
  }
}

/** Save a fit's landmarks as the picture's annotation; asks where there are some already. Gives whether it was saved. */
export async function useAsAnnotation(app, fit) {
  const address = api.url("pictures", fit.picture, "landmarks");
  const known = await api.get(address);
  const placed = known.source === "file" && known.points.some(Boolean);
  if (placed) {
    const agreed = await app.confirm(
      "Replace the landmarks?",
      `${fit.picture} has landmarks already (${known.file ?? "in its file"}). The fit's take their place.`,
      "Replace",
    );
    if (!agreed) return false;
  }
  const saved = await api.put(address, {
    points: fit.shape,
    invisible: placed ? known.invisible : [],
    revision: known.revision,
  });
  app.state.update(saved.picture);
  return true;
}
