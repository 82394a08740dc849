// The list of the template's points, to rename, reorder or delete them.

export class TemplatePoints {
  constructor({ h, button }, drafting) {
    Object.assign(this, { h, button, drafting });
    this.rows = [];
    this.dragged = -1;
    this.element = h("ol", {
      class: "template-points", "aria-label": "Points of the template", dataset: { testid: "point-list" },
    });
  }

  render() {
    const { rows } = this;
    const { names, draft } = this.drafting;
    while (rows.length > names.length) rows.pop().element.remove();
    while (rows.length < names.length) this.add();
    rows.forEach((row, i) => {
      row.number.textContent = String(i + 1);
      if (row.name.value !== names[i]) row.name.value = names[i];
      row.name.setAttribute("aria-label", `Name of point ${i + 1}`);
      row.gone.setAttribute("aria-label", `Delete ${names[i]}`);
      const twin = draft.mirror[i];
      row.twin.textContent = twin === i ? "" : `⇄ ${twin + 1}`;
      row.twin.title = twin === i ? "" : `Mirrored point: ${names[twin]}`;
    });
    this.element.dataset.empty = names.length ? "" : "No points yet";
    this.mark();
  }

  mark() {
    const { selection, active } = this.drafting;
    this.rows.forEach((row, i) => row.element.classList.toggle("chosen", selection.has(i)));
    if (active >= 0) this.rows[active]?.element.scrollIntoView({ block: "nearest" });
  }

  add() {
    const { h, button, drafting } = this;
    const row = { number: h("span", { class: "number muted" }), twin: h("span", { class: "twin muted small" }) };
    const at = () => this.rows.indexOf(row);
    row.name = h("input", {
      type: "text", class: "text", spellcheck: "false", autocomplete: "off",
      onfocus: () => {
        if (!drafting.selection.has(at()) || drafting.selection.size > 1) drafting.select([at()], at());
      },
      oninput: () => drafting.rename(at(), row.name.value),
    });
    const title = "Drag to reorder (Alt + ↑ ↓ in the name)";
    const grip = h("span", { class: "grip", title, "aria-hidden": "true" }, "⠿");
    row.gone = button("Delete", {
      icon: "trash", iconOnly: true, kind: "ghost", small: true, onclick: () => drafting.deleteChosen([at()]),
    });
    row.element = h("li", { class: "template-point" }, grip, row.number, row.name, row.twin, row.gone);
    row.name.addEventListener("keydown", (event) => this.key(event, at()));
    this.makeDraggable(row, grip, at);
    this.rows.push(row);
    this.element.append(row.element);
  }

  makeDraggable(row, grip, at) {
    grip.addEventListener("pointerdown", (event) => {
      this.dragged = at();
      grip.setPointerCapture(event.pointerId);
      row.element.classList.add("dragged");
      event.preventDefault();
    });
    grip.addEventListener("pointermove", (event) => this.drag(event));
    grip.addEventListener("pointerup", (event) => this.drop(event));
    grip.addEventListener("pointercancel", (event) => this.drop(event));
  }

  drag(event) {
    const { dragged, rows } = this;
    if (dragged < 0) return;
    const over = rows.findIndex(({ element }) => {
      const box = element.getBoundingClientRect();
      return event.clientY >= box.top && event.clientY < box.bottom;
    });
    rows.forEach(({ element }, i) => {
      element.classList.toggle("drop-above", i === over && over < dragged);
      element.classList.toggle("drop-below", i === over && over > dragged);
    });
  }

  drop(event) {
    const marks = ["drop-above", "drop-below"];
    const over = this.rows.findIndex(({ element }) => marks.some((mark) => element.classList.contains(mark)));
    this.rows.forEach(({ element }) => element.classList.remove(...marks, "dragged"));
    const from = this.dragged;
    this.dragged = -1;
    if (event.type === "pointerup" && over >= 0) this.drafting.shift(from, over);
  }

  /** In a name, up, down and Enter go to another one; with Alt they move the point. */
  key(event, i) {
    const step = { ArrowUp: -1, ArrowDown: 1 }[event.key];
    const go = event.key === "Enter" ? 1 : step;
    if (!go) return;
    event.preventDefault();
    event.stopPropagation();
    if (event.altKey && step) this.drafting.shift(i, i + step);
    const next = Math.min(Math.max(i + go, 0), this.rows.length - 1);
    this.rows[next].name.focus();
    this.rows[next].name.select();
  }
}
