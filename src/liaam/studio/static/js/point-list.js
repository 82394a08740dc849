// The list of a picture's points with their states; points are selected by mouse or keyboard.

export class PointList {
  /** onchoose(index, adds): a point was selected, in addition to others if `adds`. */
  constructor({ h }, onchoose) {
    this.h = h;
    this.onchoose = onchoose;
    this.items = [];
    this.active = -1;
    this.element = h("ul", {
      class: "point-list", role: "listbox", tabindex: "0", "aria-label": "Points", "aria-multiselectable": "true",
      dataset: { testid: "point-list" },
    });
    this.element.addEventListener("click", (event) => {
      const item = event.target.closest("[role=option]");
      if (item) onchoose(Number(item.dataset.index), event.ctrlKey || event.metaKey || event.shiftKey);
    });
    this.element.addEventListener("keydown", (event) => this.key(event));
  }

  key(event) {
    const last = this.items.length - 1;
    const goes = { ArrowDown: this.active + 1, ArrowUp: this.active - 1, Home: 0, End: last };
    if (!(event.key in goes) || event.ctrlKey || event.metaKey || event.altKey || last < 0) return;
    event.preventDefault();
    event.stopPropagation();
    this.onchoose(Math.min(Math.max(goes[event.key], 0), last), false);
  }

  /** Update the items whose state has changed. */
  render(names, stateOf) {
    while (this.items.length > names.length) this.items.pop().element.remove();
    names.forEach((name, i) => {
      if (!this.items[i]) this.add(i);
      const item = this.items[i];
      const state = stateOf(i);
      if (item.key === `${state}|${name}`) return;
      item.key = `${state}|${name}`;
      item.element.dataset.state = state;
      item.name.textContent = name;
      item.state.textContent = state === "placed" || state === "proposed" ? "" : state;
      item.element.setAttribute("aria-label", `${name}, ${state}`);
    });
  }

  add(i) {
    const { h } = this;
    const name = h("span", { class: "point-name grow" });
    const state = h("span", { class: "point-state small muted" });
    const dot = h("span", { class: "point-dot", "aria-hidden": "true" });
    const number = h("span", { class: "number muted" }, String(i + 1));
    const options = {
      class: "point", role: "option", id: `point-${i}`, dataset: { index: String(i) }, "aria-selected": "false",
    };
    const element = h("li", options, dot, number, name, state);
    this.items[i] = { element, name, state, key: "" };
    this.element.append(element);
  }

  mark(selection, active) {
    this.active = active;
    this.items.forEach(({ element }, i) => {
      const on = selection.has(i);
      if ((element.getAttribute("aria-selected") === "true") !== on) element.setAttribute("aria-selected", String(on));
    });
    const item = this.items[active]?.element;
    if (!item) {
      this.element.removeAttribute("aria-activedescendant");
      return;
    }
    this.element.setAttribute("aria-activedescendant", item.id);
    item.scrollIntoView({ block: "nearest" });
  }
}
