// The list of the folder's pictures, with the state of each. Only the visible items exist, so it may be long. Several
// pictures can be selected, for actions on all of them.

import { nextOf } from "./assist.js";
import { createBulk } from "./bulk.js";
import { removePictures, renamePicture } from "./picture-files.js";
import * as filters from "./strip-filters.js";
import { consume, h, icon, iconButton, labelsOf, optionsOf, perFrame, press, relist } from "./ui.js";
import { createWall } from "./wall.js";

const BESIDE = matchMedia("(min-width: 900px)"); // otherwise the list is above the picture
const SIZES = { column: 58, row: 66, wall: 172 }; // css pixels of an item along the list
const COLUMN = 150; // least css pixels of a column of the wall
const AHEAD = 6; // items before and after the visible ones
const THUMBNAIL = 160; // pixels of the longest side
const REST = 90; // milliseconds without scrolling until thumbnails are fetched

/** Show the list in `root`; what others may ask of it. @param {HTMLElement} root; @param {App} app */
export function mountStrip(root, app) {
  const { api, state } = app;
  const items = new Map(); // name -> {element, key} of the items that exist
  /** @type {Picture[]} */
  let pictures = []; // as filtered and sorted
  let resting = 0; // timer until the list rests
  let selecting = false; // whether a click selects several pictures
  const chosen = new Set(); // their names
  let anchor = null; // where a range of them begins
  let wallTop = 0; // how far the wall was scrolled
  let ownOrder = null; // that of the list before the wall sorted it by quality

  const choose = (label, name, labels = {}, title = null) =>
    h("select.text", {
      "aria-label": label, title, testid: `strip-${name}`,
      onchange: ({ target }) => {
        if (target === order) {
          ownOrder = null;
          pictures = []; // they keep no places
        }
        state.showFolder(folders.value);
        wall.forget();
        show();
      },
    }, optionsOf(labels));
  const filter = choose("Show", "filter", labelsOf(filters.FILTERS));
  const order = choose("Sort", "order", filters.ORDERS);
  const whose = "Pictures of subfolders are shown because the folder itself has none";
  const folders = choose("Subfolder", "folder", {}, whose);
  const search = h("input.text", {
    type: "search", placeholder: "Search by name", "aria-label": "Search by name", testid: "strip-search",
    oninput: () => show(),
  });
  const several = iconButton("Select several", "check", () => select(!selecting), {
    small: true, pressed: false, testid: "strip-several",
  });
  const adder = iconButton("Add pictures", "plus", () => app.adding.choose(), {
    small: true, testid: "add-pictures", title: "Add pictures, landmark files, a model or a video; or drop them on the page",
  });
  const wall = createWall({
    app, shown: () => pictures, accept: (names) => bulk.run("accepted", names), onchange: rebuild,
    onworst: sortAnew,
    turn: () => {
      const { at, columns, room, size } = along();
      const rows = Math.floor(room / size);
      const first = Math.round(at / size) * columns;
      const isLast = at + room >= list.scrollHeight - 1;
      list.scrollTop += rows * size;
      return pictures.slice(first, isLast ? undefined : first + rows * columns);
    },
  });
  let next = null; // name of the picture that opens next, which has the star
  const count = h("p.small.muted.grow", { "aria-live": "polite" });
  const bulk = createBulk({ app, chosen: () => [...chosen], onend: () => select(false),
    onall: () => mark(state.order), ondone: () => wall.on && list.focus({ preventScroll: true }) });
  const space = h("div.strip-space", { role: "presentation" });
  const list = h("div.strip-list", {
    role: "listbox", tabindex: "0", "aria-label": "Pictures", testid: "strip", onclick: click, onkeydown: key,
  }, space);
  root.append(
    h("div.strip-head", h("div.row.strip-search", search, wall.toggler), folders, filter, order,
      h("div.row.strip-count", count, adder, several)),
    wall.element, bulk.element, list);

  function select(on) {
    selecting = on;
    press(several, on);
    list.ariaMultiSelectable = on ? "true" : null;
    mark(on && state.current ? [state.current] : []);
  }

  function mark(names) {
    chosen.clear();
    for (const name of names) chosen.add(name);
    bulk.show(selecting || wall.on);
    render();
  }

  const findNext = () => { next = state.project.model ? nextOf(state, state.pictures)?.name ?? null : null; };

  /** Pictures keep no places. */
  function sortAnew() {
    pictures = [];
    show();
  }

  /** The wall was opened, or closed. Its order stays on the way through its pictures. */
  function rebuild(goesOn) {
    if (wall.on && !wall.onWay) {
      wallTop = 0;
      ownOrder ??= order.value;
      order.value = "quality";
      pictures = []; // sorted anew, and then it stays
    } else if (!wall.on && !goesOn) {
      wall.forget();
      order.value = ownOrder ?? order.value;
      ownOrder = null;
      pictures = [];
    }
    items.clear();
    space.replaceChildren();
    bulk.show(selecting || wall.on);
    show();
    if (!wall.on) return reveal();
    list.scrollTop = wallTop;
    return list.focus({ preventScroll: true });
  }

  function add(name, range) {
    if (!selecting) select(true);
    if (range) mark([...chosen, ...filters.between(state.order, anchor ?? state.current, name)]);
    else mark(chosen.has(name) ? [...chosen].filter((other) => other !== name) : [...chosen, name]);
    anchor = name;
  }

  function click(event) {
    const name = event.target.closest("[data-name]")?.dataset.name;
    if (!name) return;
    if (selecting || event.shiftKey || event.ctrlKey || event.metaKey) add(name, event.shiftKey);
    else enter(name);
  }

  /** The picture that the page shows; null if it is not in the folder. */
  const shownName = () => (app.aside() ? null : state.current);

  function enter(name) {
    wall.leave();
    if (app.aside() && name === state.current) app.sources.backToFolder();
    state.select(name);
  }

  function key(event) {
    if (event.key === "F2" && state.current) {
      consume(event);
      return void bulk.changeFiles(() => renamePicture(app, state.current));
    }
    if (event.key === "Delete" && state.current) {
      consume(event);
      const names = selecting && chosen.size ? [...chosen] : [state.current];
      return void bulk.changeFiles(() => removePictures(app, names));
    }
    if (wall.on && event.key === "Enter" && state.current) {
      consume(event);
      if (event.shiftKey) wall.acceptPage();
      else enter(state.current);
      return;
    }
    const { columns, room, size } = along();
    const page = wall.on ? columns * Math.floor(room / size) : 0; // otherwise the keys are those of the next picture
    const step = {
      ArrowDown: columns, ArrowRight: 1, ArrowUp: -columns, ArrowLeft: -1, PageDown: page, PageUp: -page,
    }[event.key];
    const isAll = event.key === "a" && (event.ctrlKey || event.metaKey);
    const isMark = event.key === " " || (event.key === "Escape" && selecting);
    if (!isAll && !isMark && (!step || event.ctrlKey || event.altKey || event.metaKey)) return;
    consume(event);
    if (isAll) {
      select(true);
      mark(state.order);
    } else if (event.key === "Escape") select(false);
    else if (event.key === " ") add(state.current, false);
    else if (pictures.length) {
      const at = state.order.indexOf(state.current);
      const name = state.order[Math.min(Math.max(at + step, 0), pictures.length - 1)];
      if (event.shiftKey) add(name, true);
      state.select(name);
    }
  }

  const leftOut = () => state.project.model?.left_out ?? {};

  /** @param {Picture} picture; @param {string | null} why */
  function make(picture, why) {
    const { name, tag, error, checked, slip, quality, side } = picture;
    const isNext = name === next;
    const what = [filters.describe(picture, leftOut()), side, quality != null && `${Math.round(100 * quality)} %`].filter(Boolean).join(", ");
    const folder = filters.folderOf(name);
    const face = picture.state === "broken"
      ? h("span.no-picture", icon("warning", 20))
      : h("img", { alt: "", draggable: false, dataset: { src: api.url("pictures/{name}/image", { name, tag, size: THUMBNAIL }) } });
    return h("div.strip-item", {
      role: "option", id: `strip-${encodeURIComponent(name)}`,
      title: error ?? slip ?? (why ? `${name}: left out, because ${why}` : checked ? `${name}: checked by ${checked}` : `${name}: ${filters.meaning(picture, leftOut())}`),
      "aria-label": `${name}, ${what}${isNext ? ", opens next" : ""}`,
      dataset: { name, state: picture.state },
    }, h("span.strip-face", face,
      isNext && h("span.strip-next", { title: state.worstFirst ? "Opens next: the first of those left" : "Opens next: it helps the model most" }, icon("spark", 12)),
      h("span.dot", { class: slip ? "slip" : why ? "left-out" : checked ? "checked" : picture.state })),
    h("span.strip-text", h("span.strip-name", filters.baseOf(name)),
      h("span.strip-state", folder ? `${what} · ${folder}` : what)));
  }

  /** The item of a picture, made again if the picture has changed. @param {Picture} picture */
  function itemOf(picture) {
    const { name, state: progress, placed, proposed, doubtful, nothing_found: nothing, error, tag, checked, slip, quality, absent, side } = picture;
    const why = filters.whyLeftOut(picture, leftOut());
    const key = [progress, placed, proposed, doubtful, nothing, name === next, error, tag, checked, why, slip, quality, absent, side].join("|");
    const known = items.get(name);
    if (known?.key === key) return known.element;
    known?.element.remove();
    items.set(name, { element: make(picture, why), key });
    return items.get(name).element;
  }

  /** Size of an item along the list, where the visible part begins, its length, and the number of columns. */
  function along() {
    const down = { at: list.scrollTop, room: list.clientHeight };
    if (wall.on) return { ...down, size: SIZES.wall, columns: Math.max(1, Math.floor(list.clientWidth / COLUMN)) };
    if (BESIDE.matches) return { ...down, size: SIZES.column, columns: 1 };
    return { size: SIZES.row, at: list.scrollLeft, room: list.clientWidth, columns: 1 };
  }

  function render() {
    const { size, at, room, columns } = along();
    const first = Math.max(0, Math.floor(at / size) - AHEAD) * columns;
    const inView = pictures.slice(first, (Math.ceil((at + room) / size) + AHEAD) * columns);
    const shown = shownName();
    space.style.setProperty("--columns", String(columns));
    const names = new Set(inView.map(({ name }) => name));
    for (const [name, { element }] of items) if (!names.has(name)) { element.remove(); items.delete(name); }
    inView.forEach((picture, i) => {
      const { name } = picture;
      const element = itemOf(picture);
      element.style.setProperty("--at", `${Math.floor((first + i) / columns) * size}px`);
      element.style.setProperty("--column", String((first + i) % columns));
      element.setAttribute("aria-posinset", String(first + i + 1));
      element.setAttribute("aria-setsize", String(pictures.length));
      element.setAttribute("aria-selected", String(selecting ? chosen.has(name) : name === shown));
      element.setAttribute("aria-current", String(name === shown));
      if (space.children[i] !== element) space.insertBefore(element, space.children[i] ?? null);
    });
    list.setAttribute("aria-activedescendant", items.get(shown)?.element.id ?? "");
    clearTimeout(resting);
    resting = setTimeout(fetchFaces, REST);
  }

  function fetchFaces() {
    for (const image of space.querySelectorAll("img:not([src])")) image.src = image.dataset.src;
    if (!wall.on) return;
    for (const item of space.children) wall.outline(state.picture(item.dataset.name), item.firstChild);
  }

  function reveal() {
    const { size, at, room, columns } = along();
    const index = Math.floor(state.order.indexOf(state.current) / columns);
    if (index < 0 || (index * size >= at && (index + 1) * size <= at + room)) return;
    const to = index * size < at ? index * size : (index + 1) * size - room;
    list.scrollTo(BESIDE.matches || wall.on ? { top: to } : { left: to });
  }

  /** While files are added or fitted, and on the way through the wall, pictures keep their places, before new ones. */
  function inPlace(found) {
    if (!state.adding && !state.project.fitting && !wall.on && !wall.onWay) return found;
    const places = new Map(pictures.map(({ name }, i) => [name, i]));
    return found.sort((a, b) => (places.get(a.name) ?? places.size) - (places.get(b.name) ?? places.size));
  }

  function showFolders(all) {
    const found = filters.foldersOf(all);
    if (state.folder && !found[state.folder]) state.showFolder("");
    relist(folders, { "": "All subfolders", ...found }, state.folder);
    folders.hidden = !Object.keys(found).length;
  }

  function show() {
    const all = state.project.pictures;
    document.documentElement.dataset.pictures = all.length ? "some" : "none";
    showFolders(all);
    filter.title = filters.FILTERS[filter.value].about;
    const [text, { folder }] = [search.value.trim().toLowerCase(), state];
    const wanted = { text, filter: filter.value, folder, order: order.value };
    pictures = inPlace(filters.matching(all, wanted, leftOut()));
    state.setOrder(pictures.map(({ name }) => name), { worstFirst: order.value === "quality" });
    findNext();
    for (const name of chosen) if (!state.picture(name)) chosen.delete(name);
    const usable = all.filter((picture) => picture.state !== "broken");
    const done = usable.filter((picture) => picture.state === "done").length;
    const some = pictures.length < all.length ? `${pictures.length} shown, ` : "";
    count.textContent = all.length ? `${some}${done} of ${usable.length} done` : "No pictures yet";
    const { size, columns } = along();
    space.style.setProperty("--length", `${Math.ceil(pictures.length / columns) * size}px`);
    wall.show();
    render();
  }

  document.addEventListener("keydown", ({ key: pressed }) => {
    if (pressed === "Escape") selecting ? select(false) : wall.open(false);
  });
  list.addEventListener("scroll", perFrame(render), { passive: true });
  list.addEventListener("scroll", () => { if (wall.on) wallTop = list.scrollTop; }, { passive: true });
  new ResizeObserver(() => { show(); if (!wall.on) reveal(); }).observe(list);
  state.addEventListener("project", show);
  state.addEventListener("fitting", () => state.adding || state.project.fitting || show());
  state.addEventListener("select", () => { findNext(); reveal(); render(); });
  app.sources.addEventListener("change", render);
  show();
  reveal();
  return {
    wall, bulk,
    /** Mark the picture that the page shows now. */
    mark: render,
    sortByQuality() {
      ownOrder = null;
      order.value = "quality";
      show();
    },
    /** Show the pictures that are done and not checked, and open the first. */
    review() {
      filter.value = "review";
      show();
      state.step(-Infinity);
    },
  };
}
