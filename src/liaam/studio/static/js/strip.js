// The list of the folder's pictures, with the state of each. Only the visible items exist, so that the list may be long.

import { api } from "./api.js";
import { h, icon, perFrame } from "./ui.js";

const STATES = {
  reading: "reading…", new: "no points", unchecked: "not checked", partial: "points missing", done: "done",
  proposed: "proposed", broken: "cannot be read",
};

const FILTERS = {
  all: { label: "All", has: () => true },
  todo: { label: "To do", has: ({ state }) => !["done", "broken", "reading"].includes(state) },
  new: { label: "No points", has: ({ state }) => state === "new" || state === "unchecked" },
  proposed: { label: "Proposed", has: ({ state }) => state === "proposed" },
  doubtful: { label: "Doubtful", has: ({ doubtful }) => doubtful },
  done: { label: "Done", has: ({ state }) => state === "done" },
  left: { label: "Left out", has: ({ name, state }, left) => state === "done" && Boolean(left[name]) },
  broken: { label: "Cannot be read", has: ({ state }) => state === "broken" },
};

const ORDERS = { name: "Name", uncertainty: "Uncertainty" };

const BESIDE = matchMedia("(min-width: 900px)"); // otherwise the list is above the picture
const SIZES = { column: 58, row: 66 }; // css pixels of an item along the list
const AHEAD = 6; // items before and after the visible ones
const REST = 90; // milliseconds without scrolling until thumbnails are fetched

export function mountStrip(root, state) {
  const wanted = { text: "", filter: "all", order: "name" };
  const items = new Map(); // name -> {element, key} of the items that exist
  let pictures = []; // as filtered and sorted
  let resting = 0; // timer until the list rests

  const choice = (label, options, key) =>
    h("select", { class: "text", "aria-label": label, dataset: { testid: `strip-${key}` },
      onchange: ({ target }) => { wanted[key] = target.value; show(); } },
    Object.entries(options).map(([value, { label: text = options[value] }]) => h("option", { value }, text)));
  const search = h("input", { class: "text", type: "search", placeholder: "Search by name", "aria-label": "Search by name",
    dataset: { testid: "strip-search" }, oninput: () => { wanted.text = search.value.trim().toLowerCase(); show(); } });
  const count = h("p", { class: "small muted", "aria-live": "polite" });
  const space = h("div", { class: "strip-space", role: "presentation" });
  const list = h("div", { class: "strip-list", role: "listbox", tabindex: "0", "aria-label": "Pictures", dataset: { testid: "strip" } }, space);
  root.append(h("div", { class: "strip-head" }, search, choice("Show", FILTERS, "filter"), choice("Sort", ORDERS, "order"), count), list);

  list.addEventListener("click", (event) => {
    const item = event.target.closest("[data-name]");
    if (item) state.select(item.dataset.name);
  });
  list.addEventListener("keydown", (event) => {
    const step = { ArrowDown: 1, ArrowRight: 1, ArrowUp: -1, ArrowLeft: -1 }[event.key];
    if (!step || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    event.stopPropagation();
    const at = pictures.findIndex(({ name }) => name === state.current);
    if (pictures.length) state.select(pictures[Math.min(Math.max(at + step, 0), pictures.length - 1)].name);
  });

  const leftOut = () => state.project.model?.left_out ?? {};

  function describe(picture) {
    if (picture.state === "done" && leftOut()[picture.name]) return "left out";
    if (picture.state === "partial") return `${picture.placed} placed`;
    if (picture.state === "proposed" && picture.doubtful) return "doubtful";
    return STATES[picture.state] ?? picture.state;
  }

  function make(picture) {
    const { name, tag, rank, error } = picture;
    const why = leftOut()[name];
    const what = describe(picture);
    const face = picture.state === "broken"
      ? h("span", { class: "no-picture" }, icon("warning", 20))
      : h("img", { alt: "", draggable: false, dataset: { src: api.url("pictures", name, "thumbnail", { tag }) } });
    return h("div", {
      class: "strip-item", role: "option", id: `strip-${encodeURIComponent(name)}`,
      title: error ?? (why ? `${name}: left out of the model, because ${why}` : name),
      "aria-label": `${name}, ${what}${rank === 1 ? ", helps the model most" : ""}`,
      dataset: { name, state: picture.state },
    }, h("span", { class: "strip-face" }, face,
      rank === 1 && h("span", { class: "strip-next", title: "Helps the model most" }, icon("spark", 12)),
      h("span", { class: `dot ${why ? "left-out" : picture.state}` })),
    h("span", { class: "strip-text" }, h("span", { class: "strip-name" }, name), h("span", { class: "strip-state" }, what)));
  }

  /** The item of a picture, made again if the picture has changed. */
  function itemOf(picture) {
    const { name, state: progress, placed, doubtful, rank, error, tag } = picture;
    const key = [progress, placed, doubtful, rank === 1, error, tag, leftOut()[name]].join("|");
    const known = items.get(name);
    if (known?.key === key) return known.element;
    known?.element.remove();
    const element = make(picture);
    items.set(name, { element, key });
    return element;
  }

  const along = () => (BESIDE.matches ? { size: SIZES.column, at: list.scrollTop, room: list.clientHeight }
    : { size: SIZES.row, at: list.scrollLeft, room: list.clientWidth });

  /** Put the visible items into the list. */
  function render() {
    const { size, at, room } = along();
    const first = Math.max(0, Math.floor(at / size) - AHEAD);
    const shown = pictures.slice(first, Math.ceil((at + room) / size) + AHEAD);
    const names = new Set(shown.map(({ name }) => name));
    for (const [name, { element }] of items) if (!names.has(name)) { element.remove(); items.delete(name); }
    shown.forEach((picture, i) => {
      const element = itemOf(picture);
      element.style.setProperty("--at", `${(first + i) * size}px`);
      element.setAttribute("aria-posinset", String(first + i + 1));
      element.setAttribute("aria-setsize", String(pictures.length));
      element.setAttribute("aria-selected", String(picture.name === state.current));
      if (space.children[i] !== element) space.insertBefore(element, space.children[i] ?? null);
    });
    const selected = items.get(state.current)?.element;
    if (selected) list.setAttribute("aria-activedescendant", selected.id);
    else list.removeAttribute("aria-activedescendant");
    clearTimeout(resting);
    resting = setTimeout(fetchFaces, REST);
  }

  function fetchFaces() {
    for (const image of space.querySelectorAll("img:not([src])")) image.src = image.dataset.src;
  }

  /** Scroll the selected picture into view. */
  function reveal() {
    const index = pictures.findIndex(({ name }) => name === state.current);
    const { size, at, room } = along();
    if (index < 0 || (index * size >= at && (index + 1) * size <= at + room)) return;
    const to = index * size < at ? index * size : (index + 1) * size - room;
    list.scrollTo(BESIDE.matches ? { top: to } : { left: to });
  }

  function show() {
    const all = state.project?.pictures ?? [];
    const { has } = FILTERS[wanted.filter];
    const left = leftOut();
    pictures = all.filter((picture) => has(picture, left) && picture.name.toLowerCase().includes(wanted.text));
    const doubt = ({ uncertainty, doubtful }) => (uncertainty ?? -1) + (doubtful ? 1e6 : 0);
    if (wanted.order === "uncertainty") pictures.sort((a, b) => doubt(b) - doubt(a));
    state.order = pictures.map(({ name }) => name);
    const usable = all.filter((picture) => picture.state !== "broken");
    const done = usable.filter((picture) => picture.state === "done").length;
    const some = pictures.length < all.length ? `${pictures.length} shown, ` : "";
    count.textContent = all.length ? `${some}${done} of ${usable.length} done` : "No pictures yet";
    space.style.setProperty("--length", `${pictures.length * along().size}px`);
    render();
  }

  list.addEventListener("scroll", perFrame(render), { passive: true });
  new ResizeObserver(() => { show(); reveal(); }).observe(list);
  state.addEventListener("project", show);
  state.addEventListener("select", () => { reveal(); render(); });
  show();
  reveal();
}
