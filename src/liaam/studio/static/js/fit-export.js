// Export of a fit to files, or as landmarks of the folder.

import { api } from "./api.js";
import { lightQuery } from "./relight.js";
import { button, h, saveFile } from "./ui.js";

const EXPORTS = {
  Landmarks: { pts: "Landmarks .pts", ljson: "Landmarks .ljson", csv: "Table .csv", json: "Fit .json" },
  Pictures: {
    overlay: "Picture with the fit", flat: "Without shading", shading: "Shading", relit: "Under the new light",
  },
};
const NEEDS = { flat: "flat", shading: "shading", relit: "flat" }; // a layer of the fit

export class ExportMenu {
  /** @param {import("./fit.js").Tab} tab */
  constructor(tab) {
    this._tab = tab;
    this._annotate = button("Use as annotation", {
      icon: "edit", kind: "ghost", small: true, testid: "export-annotation",
      title: "Save these landmarks beside the picture",
      onclick: () => {
        this.close();
        useAsAnnotation(tab.app, tab.fit);
      },
    });
    const groups = Object.entries(EXPORTS).map(([title, items]) =>
      h("div.fit-menu-group", h("h3.small.muted", title), Object.entries(items).map((item) => this._item(...item))));
    // The browser closes it with Escape, or by a press elsewhere.
    this.panel = h("div.fit-menu", {
      popover: "auto", role: "group", "aria-label": "Export", onbeforetoggle: () => this._place(),
      ontoggle: ({ newState }) => newState === "open" && this.panel.querySelector("a").focus(),
    }, groups, h("div.fit-menu-group", this._annotate));
    this.button = button("Export", {
      icon: "download", kind: "roomy", small: true, disabled: true, testid: "export-menu", popoverTargetElement: this.panel,
    });
    const onfocusout = ({ relatedTarget: to }) => to && !this.element.contains(to) && this.close();
    this.element = h("div", { onfocusout }, this.button, this.panel);
  }

  show() {
    const { fit, sources: { current }, state, mismatch } = this._tab;
    this.button.disabled = !fit;
    this._annotate.hidden = !current?.ofFolder || state.guest || Boolean(mismatch);
    if (!fit) this.close();
  }

  close() { if (this.panel.isConnected) this.panel.hidePopover(); }

  _item(what, label) {
    const onclick = (event) => {
      event.preventDefault(); // a plain link would show neither progress nor errors
      if (!event.target.ariaBusy) this._save(event.target);
    };
    return h("a.button.ghost.small", { download: "", dataset: { what, testid: `export-${what}` }, onclick }, label);
  }

  async _save(link) {
    link.ariaBusy = "true";
    const file = await api.file(link.getAttribute("href")).finally(() => { link.ariaBusy = null; });
    saveFile(...file);
    this.close();
  }

  _place() {
    const { right, bottom } = this.button.getBoundingClientRect();
    Object.assign(this.panel.style, { right: `${innerWidth - right}px`, top: `${bottom + 6}px` });
    const { fit, view } = this._tab;
    for (const link of fit ? this.panel.querySelectorAll("a") : []) {
      const { what } = link.dataset;
      link.href = api.url("fits", fit.id, "export", { what, ...(what === "relit" && lightQuery(view.light)) });
      link.hidden = what in NEEDS && !fit.layers.includes(NEEDS[what]);
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
