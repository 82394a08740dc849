// Models from elsewhere: dropped on the page, or of the generated heads. With such a guest, the page only fits.

import { api } from "./api.js";
import { button, h, icon, whileBusy } from "./ui.js";

/** Name of the model of the generated heads. */
const HEADS = "generated heads";

const HEAD = "liaam-studio:head"; // the head that is shown, for a reload

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

/** Fit a generated head and show it without its shading. */
async function openHead(app, address) {
  const name = address.split("/").at(-1);
  const [blob] = await Promise.all([api.blob(address), useHeads(app)]);
  sessionStorage.setItem(HEAD, address);
  app.openTab("fit", { view: "flat" });
  await app.sources.take(new File([blob], name, { type: "image/jpeg" }));
}

/** Show the head again that was shown before a reload. */
export function reopenHead(app) {
  const { model, pictures } = app.state.project;
  const address = sessionStorage.getItem(HEAD);
  if (address && !pictures.length && model?.name === HEADS) openHead(app, address);
}

async function useHeads(app) {
  const { model } = app.state.project;
  if (isGuest(app.state.project) && model.name === HEADS) return;
  await api.post(api.url("heads", "model"));
  await app.state.refresh();
}

let heads = null;

/** The generated heads to choose from. The server makes their model when they are first shown. */
function gallery(app) {
  heads ??= api.get(api.url("heads"), { quiet: true });
  const list = h("div.gallery", { role: "group", "aria-label": "Generated heads" });
  const item = (address, i) => h("button.gallery-item", {
    type: "button", title: "Fit this head and take off the light", testid: `head-${i + 1}`,
    onclick: ({ currentTarget: { classList } }) => whileBusy(list, () => {
      classList.add("chosen");
      return openHead(app, address).finally(() => classList.remove("chosen"));
    }),
  }, h("img", { src: address, alt: `Generated head ${i + 1} under hard light`, draggable: false }));
  heads.then(({ pictures }) => list.append(...pictures.map(item)), () => (heads = null));
  return list;
}

/** An invitation for a page on which nothing can be fitted yet. */
export function invitation(app) {
  return h("div.invitation",
    h("p", "Or take the light off a generated head:"), gallery(app),
    h("p.small", "Or drop a model (.liaam) on the page, and then pictures to fit."));
}

/** What the Fit tab shows in place of a picture. */
export class EmptyStage {
  constructor(app, onopen) {
    this._app = app;
    this._words = h("p");
    this._invitation = null;
    const open = button("Open a picture…", { icon: "upload", kind: "primary", onclick: onopen });
    this.element = h("div.empty.big.fit-empty", icon("image", 56), h("h2", "A picture to fit"), this._words, open);
  }

  /** invite: whether to offer the generated heads. */
  show(now, invite) {
    this.element.hidden = !now;
    if (!now) return;
    const listed = this._app.state.project.pictures.length ? "select one on the left, " : "";
    const where = `${listed}drop one here, or open one`;
    this._words.textContent = `Use any picture of the model's object: ${where}. It stays on this machine.`;
    if (invite) this.element.append((this._invitation ??= invitation(this._app)));
    else this._invitation?.remove();
  }
}

/** The panel that says that the page only fits, and ends it. */
export class GuestPanel {
  constructor(app) {
    this._app = app;
    this._words = h("p.small.guest-words");
    this._gallery = h("div", { hidden: true });
    const leave = button("Leave", {
      small: true, testid: "leave-guest", title: "Use the model of the folder again", onclick: () => this._leave(),
    });
    this.element = h("section.panel", { "aria-label": "Fit only", hidden: true, testid: "guest" },
      h("div.panel-title", h("h2.grow", "Fit only"), leave), this._words, this._gallery);
  }

  show(project) {
    const guest = isGuest(project) ? project.model : null;
    this.element.hidden = !guest;
    if (!guest) return;
    const what = guest.name === HEADS ? "the model of the generated heads" : `${guest.name}.liaam`;
    this._words.textContent = `Pictures are fitted with ${what} (${guest.n_points} points). `
      + "Nothing is trained, and no landmarks are saved.";
    this._gallery.hidden = guest.name !== HEADS;
    if (guest.name === HEADS && !this._gallery.firstChild) this._gallery.append(gallery(this._app));
  }

  async _leave() {
    await api.delete(api.url("model", "guest"));
    await this._app.state.refresh();
    this._app.openTab("annotate");
  }
}
