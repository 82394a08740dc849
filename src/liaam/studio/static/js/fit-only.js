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
export function emptyStage({ state }, onopen) {
  const words = h("p");
  const open = button("Open a picture…", { icon: "upload", kind: "primary", onclick: onopen });
  const element = h("div.empty.big.fit-empty", icon("image", 56), h("h2", "A picture to fit"), words, open);
  const show = (now) => {
    element.hidden = !now;
    const where = `${state.project.pictures.length ? "select one on the left, " : ""}drop one here, or open one`;
    words.textContent = `Use any picture of the model's object: ${where}. It stays on this machine.`;
  };
  return { element, show };
}

/** The panel that says that the page only fits, and ends it. */
export function guestPanel(app) {
  const words = h("p.small.guest-words");
  const onclick = async () => {
    await api.delete(api.url("model", "guest"));
    await app.state.refresh();
    app.openTab("annotate");
  };
  const leave = button("Leave", {
    small: true, testid: "leave-guest", title: "Use the model of the folder again", onclick,
  });
  const element = h("section.panel", { "aria-label": "Fit only", hidden: true, testid: "guest" },
    h("div.panel-title", h("h2.grow", "Fit only"), leave), words);
  const show = (project) => {
    element.hidden = !isGuest(project);
    const { name, n_points: count } = project.model ?? {};
    words.textContent = `Pictures are fitted with ${name}.liaam (${count} points). Nothing is trained, and no ` +
      "landmarks are saved.";
  };
  return { element, show };
}
