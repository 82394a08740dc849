// The list of the folder's pictures on the left, with the state of each.

import { api } from "./api.js";
import { h, icon, segmented } from "./ui.js";

const STATES = {
  new: "no points",
  unchecked: "not checked",
  partial: "points missing",
  done: "done",
  proposed: "proposed",
  broken: "cannot be read",
};

const FILTERS = {
  all: () => true,
  todo: (picture) => picture.state !== "done" && picture.state !== "broken",
  done: (picture) => picture.state === "done",
};

export function mountStrip(root, state) {
  let filter = "all";
  const items = new Map(); // name -> {element, key}
  const count = h("p", { class: "small muted", "aria-live": "polite" });
  const list = h("ul", { class: "strip-list", role: "listbox", tabindex: "0", "aria-label": "Pictures", dataset: { testid: "strip" } });
  const choice = segmented("Filter", [
    { value: "all", label: "All" },
    { value: "todo", label: "To do" },
    { value: "done", label: "Done" },
  ], filter, (value) => { filter = value; show(); });
  root.append(h("div", { class: "strip-head" }, choice.element, count), list);

  list.addEventListener("click", (event) => {
    const item = event.target.closest("[data-name]");
    if (item) state.select(item.dataset.name);
  });
  list.addEventListener("keydown", (event) => {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    event.stopPropagation();
    const names = shown().map((picture) => picture.name);
    const at = names.indexOf(state.current);
    if (names.length) state.select(names[Math.min(Math.max(at + step, 0), names.length - 1)]);
  });

  const shown = () => (state.project?.pictures ?? []).filter(FILTERS[filter]);

  const leftOut = (picture) => state.project.model?.left_out?.[picture.name];

  function describe(picture) {
    if (picture.state === "done" && leftOut(picture)) return "left out";
    if (picture.state === "partial") return `${picture.placed} placed`;
    if (picture.state === "proposed" && picture.doubtful) return "doubtful";
    return STATES[picture.state] ?? picture.state;
  }

  const thumbnail = ({ name, tag }) => api.url("pictures", name, "thumbnail", { tag });

  function make(picture) {
    const face = picture.state === "broken"
      ? h("span", { class: "no-picture" }, icon("warning", 20))
      : h("img", { loading: "lazy", alt: "", draggable: false, src: thumbnail(picture) });
    return h("li", {
      class: "strip-item",
      role: "option",
      id: `strip-${encodeURIComponent(picture.name)}`,
      title: picture.error ?? (leftOut(picture) ? `${picture.name}: left out of the model, because ${leftOut(picture)}` : picture.name),
      "aria-label": `${picture.name}, ${describe(picture)}${picture.rank === 1 ? ", helps the model most" : ""}`,
      dataset: { name: picture.name, state: picture.state },
    }, h("span", { class: "strip-face" }, face,
      picture.rank === 1 && h("span", { class: "strip-next", title: "Helps the model most" }, icon("spark", 12))),
    h("span", { class: "strip-text" },
      h("span", { class: "strip-name", style: { display: "block" } }, picture.name),
      h("span", { class: "strip-state" }, h("span", { class: `dot ${leftOut(picture) ? "left-out" : picture.state}` }), describe(picture))));
  }

  function show() {
    const pictures = shown();
    const all = (state.project?.pictures ?? []).filter((picture) => picture.state !== "broken");
    const done = all.filter((picture) => picture.state === "done").length;
    count.textContent = all.length ? `${done} of ${all.length} done` : "No pictures yet";
    const kept = new Set(pictures.map((picture) => picture.name));
    for (const [name, { element }] of items) if (!kept.has(name)) { element.remove(); items.delete(name); }
    pictures.forEach((picture, i) => {
      const { state: progress, placed, doubtful, rank, error, tag } = picture;
      const key = [progress, placed, doubtful, rank === 1, error, tag, leftOut(picture)].join("|");
      const known = items.get(picture.name);
      if (!known || known.key !== key) {
        const element = make(picture);
        if (known) known.element.replaceWith(element);
        items.set(picture.name, { element, key });
      }
      const { element } = items.get(picture.name);
      if (list.children[i] !== element) list.insertBefore(element, list.children[i] ?? null);
    });
    mark();
  }

  function mark() {
    for (const [name, { element }] of items) {
      const on = name === state.current;
      element.setAttribute("aria-selected", String(on));
      if (on) {
        list.setAttribute("aria-activedescendant", element.id);
        element.scrollIntoView({ block: "nearest" });
      }
    }
  }

  state.addEventListener("project", show);
  state.addEventListener("select", mark);
  show();
}
