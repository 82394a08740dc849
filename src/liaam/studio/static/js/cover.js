// A message in place of a picture that cannot be shown: an icon, a title and a remedy.

export class Cover {
  constructor({ h, icon }) {
    Object.assign(this, { h, icon });
    this.element = h("div", { class: "annotate-cover", hidden: true });
  }

  get isShown() {
    return !this.element.hidden;
  }

  /** more: an element below the text, or null. */
  show(icon, title, text, more = null) {
    const { h } = this;
    const words = [h("h2", {}, title), h("p", {}, text), more].filter(Boolean);
    this.element.hidden = false;
    this.element.replaceChildren(h("div", { class: "empty" }, this.icon(icon, 40), ...words));
  }

  hide() {
    this.element.hidden = true;
  }
}
