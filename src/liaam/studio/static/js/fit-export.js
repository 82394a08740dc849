// Export of a fit to files, or as landmarks of the folder.

import { api } from "./api.js";
import { roomy } from "./fit-draw.js";
import { lightQuery } from "./relight.js";
import { button, h, saveFile, whileBusy } from "./ui.js";

const EXPORTS = {
  Landmarks: [
    { what: "pts", label: "Landmarks .pts" },
    { what: "ljson", label: "Landmarks .ljson" },
    { what: "csv", label: "Table .csv" },
    { what: "json", label: "Fit .json" },
  ],
  Pictures: [
    { what: "overlay", label: "Picture with the fit" },
    { what: "flat", label: "Without shading", layer: "flat" },
    { what: "shading", label: "Shading", layer: "shading" },
    { what: "relit", label: "Under the new light", layer: "flat" },
  ],
};

export class ExportMenu {
  /** `light()` returns the current light; `annotate()` saves the landmarks of the fit in the folder. */
  constructor({ light, annotate }) {
    this._light = light;
    this._fit = null;
    const onclick = () => this._toggle();
    this.button = roomy(
      button("Export", { icon: "download", small: true, disabled: true, testid: "export-menu", onclick }));
    this.button.setAttribute("aria-expanded", "false");
    this._links = new Map();
    this._annotate = button("Use as annotation", {
      icon: "edit", kind: "ghost", small: true, testid: "export-annotation",
      title: "Save these landmarks beside the picture",
      onclick: () => {
        this.close();
        annotate();
      },
    });
    const groups = Object.entries(EXPORTS).map(([title, items]) =>
      h("div.fit-menu-group", h("h3.small.muted", title), items.map((item) => this._item(item))));
    this.panel = h("div.fit-menu", { hidden: true, role: "group", "aria-label": "Export" },
      groups, h("div.fit-menu-group", this._annotate));
    const onkeydown = (event) => {
      if (event.key !== "Escape" || this.panel.hidden) return;
      event.stopPropagation();
      this.close();
      this.button.focus();
    };
    const closeOutside = (target) => target && !this.element.contains(target) && this.close();
    const onfocusout = (event) => closeOutside(event.relatedTarget);
    this.element = h("div.fit-export", { onkeydown, onfocusout }, this.button, this.panel);
    document.addEventListener("pointerdown", (event) => closeOutside(event.target));
  }

  /** Offer the files of a fit, or null. canAnnotate: whether its landmarks can be saved for a picture of the folder. */
  show(fit, canAnnotate) {
    this._fit = fit;
    this.button.disabled = !fit;
    this._annotate.hidden = !canAnnotate;
    if (!fit) this.close();
  }

  close() {
    this.panel.hidden = true;
    this.button.setAttribute("aria-expanded", "false");
  }

  /** @param {{what: string, label: string, layer?: string}} item */
  _item({ what, label, layer }) {
    const link = h("a.button.ghost.small", {
      download: "", testid: `export-${what}`,
      onclick: (event) => {
        event.preventDefault(); // a plain link would show neither progress nor errors
        whileBusy(link, () => this._save(link));
      },
    }, label);
    this._links.set(what, { link, layer });
    return link;
  }

  /** Fetch a file and save it; the menu stays open until then. */
  async _save(link) {
    saveFile(...(await api.file(link.getAttribute("href"))));
    this.close();
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

/** Save a fit's landmarks for its picture; ask before replacing others. */
export async function useAsAnnotation(app, fit) {
  const { state } = app;
  const known = await api.get(api.url("pictures", fit.picture, "landmarks"));
  const placed = known.source === "file" && known.points.some(Boolean);
  const text = `${fit.picture} already has landmarks (${known.file ?? "in its file"}).`;
  const replace = () =>
    app.confirm("Replace the landmarks?", `${text} They will be replaced by those of the fit.`, "Replace");
  if (placed && !(await replace())) return;
  const saved = await state.saveMarks(fit.picture, {
    points: fit.shape, invisible: placed ? known.invisible : [], revision: known.revision,
    template: state.project.template?.revision,
  });
  state.update(saved.picture);
  app.toast(`Saved as the landmarks of ${fit.picture}.`, "good");
}
