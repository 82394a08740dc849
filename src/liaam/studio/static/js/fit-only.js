// Models that were dropped on the page. With such a guest, the page only fits.

import { api } from "./api.js";
import { button, h, icon } from "./ui.js";

export const isGuest = (project) => project?.model?.source === "guest";

/** Use a model file that was dropped on the page. */
export async function openModel(app, file) {
  const limit = app.state.project.limits.upload_bytes;
  if (file.size > limit) {
    const how = `start the studio with --model ${file.name}`;
    throw new Error(`${file.name} is larger than ${Math.round(limit / 1e6)} MB, the limit for dropped models: ${how}`);
  }
  await api.upload(api.url("model", "guest", { name: file.name }), file);
  await app.state.refresh();
  app.openTab("fit");
}

/** What the Fit tab shows in place of a picture. */
export class EmptyStage {
  constructor(app, onopen) {
    this._app = app;
    this._words = h("p");
    const open = button("Open a picture…", { icon: "upload", kind: "primary", onclick: onopen });
    this.element = h("div.empty.big.fit-empty", icon("image", 56), h("h2", "A picture to fit"), this._words, open);
  }

  show(now) {
    this.element.hidden = !now;
    if (!now) return;
    const listed = this._app.state.project.pictures.length ? "select one on the left, " : "";
    const where = `${listed}drop one here, or open one`;
    this._words.textContent = `Use any picture of the model's object: ${where}. It stays on this machine.`;
  }
}

/** The panel that says that the page only fits, and ends it. */
export class GuestPanel {
  constructor(app) {
    this._app = app;
    this._words = h("p.small.guest-words");
    const leave = button("Leave", {
      small: true, testid: "leave-guest", title: "Use the model of the folder again", onclick: () => this._leave(),
    });
    this.element = h("section.panel", { "aria-label": "Fit only", hidden: true, testid: "guest" },
      h("div.panel-title", h("h2.grow", "Fit only"), leave), this._words);
  }

  show(project) {
    const guest = isGuest(project) ? project.model : null;
    this.element.hidden = !guest;
    if (!guest) return;
    this._words.textContent = `Pictures are fitted with ${guest.name}.liaam (${guest.n_points} points). `
      + "Nothing is trained, and no landmarks are saved.";
  }

  async _leave() {
    await api.delete(api.url("model", "guest"));
    await this._app.state.refresh();
    this._app.openTab("annotate");
  }
}
