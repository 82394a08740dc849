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
    this._links = [];
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
    // The browser closes it with Escape, or by a press elsewhere.
    this.panel = h("div.fit-menu", {
      popover: "auto", role: "group", "aria-label": "Export", onbeforetoggle: () => this._place(),
      ontoggle: ({ newState }) => newState === "open" && this._links[0].link.focus(),
    }, groups, h("div.fit-menu-group", this._annotate));
    this.button = roomy(button("Export", {
      icon: "download", small: true, disabled: true, testid: "export-menu", popoverTargetElement: this.panel,
    }));
    const onfocusout = ({ relatedTarget: to }) => to && !this.element.contains(to) && this.close();
    this.element = h("div", { onfocusout }, this.button, this.panel);
  }

  /** Offer the files of a fit, or null. canAnnotate: whether its landmarks can be saved for a picture of the folder. */
  show(fit, canAnnotate) {
    this._fit = fit;
    this.button.disabled = !fit;
    this._annotate.hidden = !canAnnotate;
    if (!fit) this.close();
  }

  close() { if (this.panel.isConnected) this.panel.hidePopover(); }

  /** @param {{what: string, label: string, layer?: string}} item */
  _item({ what, label, layer }) {
    const link = h("a.button.ghost.small", {
      download: "", testid: `export-${what}`,
      onclick: (event) => {
        event.preventDefault(); // a plain link would show neither progress nor errors
        whileBusy(link, async () => {
          saveFile(...(await api.file(link.getAttribute("href"))));
          this.close(); // it stays open until then
        });
      },
    }, label);
    this._links.push({ link, what, layer });
    return link;
  }

  /** Put the menu below its button, with the files of the fit under the current light. */
  _place() {
    const { right, bottom } = this.button.getBoundingClientRect();
    Object.assign(this.panel.style, { right: `${innerWidth - right}px`, top: `${bottom + 6}px` });
    for (const { link, what, layer } of this._fit ? this._links : []) {
      const query = what === "relit" ? lightQuery(this._light()) : {};
      link.href = api.url("fits", this._fit.id, "export", { what, ...query });
      link.hidden = Boolean(layer) && !this._fit.layers.includes(layer);
    }
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
